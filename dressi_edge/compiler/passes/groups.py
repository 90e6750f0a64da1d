"""The plans of a program in groups that share what is computed beforehand, as roots of graph.

In: a `Program`. Out: `Group`s in order of their first plans; `lowered` ones have no composite ops and are simplified.
"""
from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from ...cache.layout import Layout
from ..graph.ir import Extent, Node
from ..graph.program import PlanSpec, Program
from .simplify import lower, simplify


@dataclass(frozen=True)
class Lists:
    """What a phase works on in place of images of one extent (`passes/lists.py`), `number` in its group from 1. copies: by state name,
    the leaf that stands for it. enter: what fills the copies and the leaves that the other plans read. leave: by state name, the
    value of its listed texels, zero elsewhere, where `places` is zero. total: the leaf whose last texel says how many entries there
    are."""

    number: int
    extent: Extent
    copies: Mapping[str, Node]
    enter: Mapping[Node, Node]
    leave: Mapping[str, Node]
    total: Node

    def layout(self, copy: Node) -> Layout:
        """In which a copy is given out."""
        return Layout("image", copy.vtype, self.extent.width, self.extent.height)


def on_copies(specs: Sequence[PlanSpec], copies: Mapping[str, Node]) -> tuple[PlanSpec, ...]:
    """The specs of a group whose phase updates copies, by state name, in place of the states."""
    names = {name: copy.attrs["name"] for name, copy in copies.items()}
    return tuple(replace(spec, dynamic=spec.dynamic.union(names.values()),
                         updates={names.get(name, name): node for name, node in spec.updates.items()}) for spec in specs)


@dataclass(frozen=True)
class Group:
    """Plans between whose runs the same leaves change. roots: of each, its updates, then its outputs. lists: on which they work; their
    copies are then among what plans update. told: by phase, each sampled image that it updates, and how."""

    name: str
    specs: tuple[PlanSpec, ...]
    roots: tuple[tuple[Node, ...], ...]
    lists: tuple[Lists, ...] = ()
    told: Mapping[str, Mapping[str, str]] = field(default_factory=dict)


def grouped(program: Program) -> tuple[Group, ...]:
    """The plans of a program as they were built."""
    groups: dict[tuple, list[PlanSpec]] = {}
    for spec in program.plans:
        groups.setdefault((spec.group, spec.dynamic), []).append(spec)
    return tuple(Group(name, tuple(specs), tuple((*spec.updates.values(), *spec.outputs.values()) for spec in specs))
                 for (name, _), specs in groups.items())


def lowered(groups: Sequence[Group], room: int | None = None) -> tuple[Group, ...]:
    """Without composite ops, simplified. room: as `lower` takes it."""
    return tuple(replace(group, roots=tuple(tuple(simplify(lower(roots, room))) for roots in group.roots)) for group in groups)
