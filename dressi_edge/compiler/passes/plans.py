"""Groups of plans to graphs of plans: what changes, what is computed once and kept, what fills lists and empties them.

In: `Group`s. Out: `PlanGraph`s in running order, each with an explicit kind, its roots, and where these go. `stored` gives every root
an image of its own. From here on nothing is added to what a plan computes.
"""
from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from ...cache.bundle_plans import MAX_NEEDS
from ...cache.copies import ENTER, LEAVE, OUTPUT, PHASE
from ..graph.ir import Extent, Node, topological
from ..graph.optable import apply
from ..graph.program import PlanSpec, Program
from .groups import Group, Lists
from .specialize import counts, late, prepare, specialize
from .substage import Stage

PREPARE = "prepare"  # to a bundle an output like others: it updates nothing
__all__ = ["ENTER", "LEAVE", "OUTPUT", "PHASE", "PREPARE", "PackedPlan", "PlanGraph", "plan_graphs", "stored"]


@dataclass(frozen=True)
class PlanGraph:
    """What one plan computes. kind: a "phase" updates states, an "output" gives numbers out, a "prepare" fills leaves that others read, an
    "enter" fills a list and copies of states, a "leave" gives these back in place. targets: of each root the leaf in whose image it
    goes, or the name of an output. updates, outputs: names, as in `targets`. needs: names of the plans to bring up to date before,
    in their order. totals: of extents of lists that others made, the leaf whose last texel says how many entries there are."""

    name: str
    kind: str
    roots: tuple[Node, ...]
    targets: tuple[Node | str, ...]
    updates: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()
    steps: int = 0
    totals: Mapping[Extent, Node] = field(default_factory=dict)

    def slot(self, target: Node | str) -> int:
        """Which image of a state or copy is written: the one that is current afterwards, unless in place."""
        return int(isinstance(target, Node) and target.op.held and self.kind != LEAVE)


@dataclass(frozen=True)
class PackedPlan:
    """A plan and its stages in running order."""

    graph: PlanGraph
    stages: tuple[Stage, ...]


def plan_graphs(groups: Sequence[Group], program: Program, cache: bool = True) -> tuple[PlanGraph, ...]:
    """The plans of all groups. Without `cache` each computes all that it needs in every run."""
    plans = [plan for group in groups for plan in _of_group(group, program, cache)]
    done: dict[str, PlanGraph] = {}
    filled: dict[Node, str] = {}  # leaf -> the plan that fills it before others read it
    for plan in plans:
        direct = {filled[n] for n in topological(plan.roots) if n in filled}
        needed = direct.union(*(done[name].needs for name in direct))
        done[plan.name] = replace(plan, needs=tuple(name for name in done if name in needed))
        if plan.kind in (PREPARE, ENTER):
            filled.update(dict.fromkeys(plan.targets, plan.name))
    return tuple(done.values())


def _of_group(group: Group, program: Program, cache: bool) -> list[PlanGraph]:
    plans, rooted, totals = [], [list(roots) for roots in group.roots], {x.extent: x.total for x in group.lists}
    if cache:
        cached: dict[Node, Node] = {}
        moving = frozenset().union(*(spec.moving for spec in group.specs))
        rooted = [specialize(roots, spec.dynamic, group.name, cached, moving) for spec, roots in zip(group.specs, rooted)]
        entered = [specialize(list(x.enter.values()), frozenset(x.copies), group.name, cached) for x in group.lists]
        totals |= counts([n for roots in group.roots for n in roots], [n for roots in rooted for n in roots], group.name, cached)
        dynamic = frozenset().union(*(spec.dynamic for spec in group.specs))
        last = late(rooted, dynamic, cached) if moving else ()
        beforehand = prepare(group.name, cached, MAX_NEEDS - len(group.lists), moving, last)
        for k, (roots, leaves) in enumerate(beforehand, 1):
            name = f"{group.name}.prepare" + (f".{k}" if k < len(beforehand) else "")
            plans.append(PlanGraph(name, PREPARE, tuple(roots), tuple(leaves)))
        for x, roots in zip(group.lists, entered):
            plans += _of_lists(group.name, x, roots, program)
    return plans + [_of_spec(spec, roots, program, group.lists, totals) for spec, roots in zip(group.specs, rooted)]


def _of_lists(group: str, x: Lists, entered: Sequence[Node], program: Program) -> list[PlanGraph]:
    """The plan that fills a list and the copies of its states, and the one that gives them back."""
    number = x.number if x.number > 1 else ""
    copies = tuple(copy.attrs["name"] for copy in x.copies.values())
    return [PlanGraph(f"{group}.enter{number}", ENTER, tuple(entered), tuple(x.enter), copies),
            PlanGraph(f"{group}.leave{number}", LEAVE, tuple(x.leave.values()), tuple(program.values[name].node for name in x.leave),
                      tuple(x.leave))]


def _of_spec(spec: PlanSpec, roots: Sequence[Node], program: Program, lists: Sequence[Lists], totals: Mapping) -> PlanGraph:
    copies = {copy.attrs["name"]: copy for x in lists for copy in x.copies.values()}
    targets = [copies[name] if name in copies else program.values[name].node for name in spec.updates]
    return PlanGraph(spec.name, PHASE if spec.updates else OUTPUT, tuple(roots), (*targets, *spec.outputs), tuple(spec.updates),
                     tuple(spec.outputs), (), spec.steps, totals)


def stored(plan: PlanGraph, program: Program) -> PlanGraph:
    """The plan with roots that no other image holds: copies of leaves, of literals, of what is stored rounded, and of roots before."""
    roots: dict[Node, None] = {}
    for root, target in zip(plan.roots, plan.targets):
        extent = (program.values[target].node if isinstance(target, str) else target).extent
        if root.op.stage in ("leaf", "inline") or root.half is not None and not (isinstance(target, Node) and target.half == root.half) \
                or root in roots:
            root = apply("copy", root if root.extent == extent else apply("broadcast", root, extent=extent))
        while root in roots:
            root = apply("copy", root)
        roots[root] = None
    return replace(plan, roots=tuple(roots))
