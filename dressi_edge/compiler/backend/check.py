"""The verifier of each level: what a pass gives must be what the next one may rely on.

In: a value of any level (`dump.py` prints the same ones), the profile, the options. Out: nothing, or a `DefectError` that names the
first thing wrong: no input of a user can cause one. What users can do wrong is checked where it comes in.
"""
from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import singledispatch

from ...cache.bundle_check import check_description
from ...cache.copies import OUTPUT, kinds
from ...cache.errors import DressiError
from ...cache.profile import Profile
from ..graph.ir import Node, is_int
from ..graph.program import Program
from ..passes.compute import hindrance
from ..passes.groups import Group
from ..passes.plans import ENTER, LEAVE, PHASE, PREPARE, PackedPlan, PlanGraph
from ..passes.substage import FULL, KEPT, LISTED, TEXELS, TILES, Substage, excess, is_alone, is_inline, is_leaf
from .allocate import Allocation


class DefectError(DressiError):
    """A pass gave something that is not well formed: a defect of the compiler."""


@dataclass(frozen=True)
class Sound:
    """Nodes that were looked at already, which no pass can change; grows. typed: they have the type and extent that their op infers; drawn:
    a shader can do them. A node is in with all that it is made of."""

    typed: set[Node] = field(default_factory=set)
    drawn: set[Node] = field(default_factory=set)


def _that(holds: bool, what: str) -> None:
    if not holds:
        raise DefectError(f"{what}; a defect of the compiler: report it with the problem that shows it")


@singledispatch
def check(value, profile: Profile, naive: bool = False, sound: Sound | None = None) -> None:
    """A value of any level. sound: what was found of values before it, which need not be looked at again."""
    sound = sound or Sound()
    for x in value:
        check(x, profile, naive, sound)
    plans = [x.graph if isinstance(x, PackedPlan) else x for x in value if isinstance(x, PackedPlan | PlanGraph)]
    for k, plan in enumerate(plans):
        before = [p.name for p in plans[:k]]
        ordered = [name for name in before if name in plan.needs]
        _that(plan.name not in before, f"two plans are named {plan.name}")
        _that(ordered == list(plan.needs), f"plan {plan.name} needs {plan.needs}, of which before it in this order are {ordered}")
        _that(plan.kind != LEAVE or plans[k - 1].kind == ENTER, f"plan {plan.name} leaves what no plan before it enters")


@check.register
def _program(program: Program, profile: Profile, naive: bool = False, sound: Sound | None = None) -> None:
    for spec in program.plans:
        _graph(spec.name, (*spec.updates.values(), *spec.outputs.values()), sound or Sound())


@check.register
def _group(group: Group, profile: Profile, naive: bool = False, sound: Sound | None = None) -> None:
    for spec, roots in zip(group.specs, group.roots):
        _that(len(roots) == len(spec.updates) + len(spec.outputs), f"plan {spec.name} has {len(roots)} roots")
        _graph(spec.name, roots, sound or Sound(), drawn=True)


@check.register
def _plan(plan: PlanGraph, profile: Profile, naive: bool = False, sound: Sound | None = None) -> None:
    _that(len(plan.roots) == len(plan.targets), f"plan {plan.name} has {len(plan.roots)} roots for {len(plan.targets)} targets")
    _that((plan.kind in (PHASE, ENTER, LEAVE)) == bool(plan.updates), f"plan {plan.name} is a {plan.kind}, and updates {plan.updates}")
    _that((plan.kind in (PHASE, OUTPUT)) or not plan.outputs, f"plan {plan.name} is a {plan.kind}, and gives {plan.outputs}")
    _that(plan.kind == PREPARE or set(plan.updates) | set(plan.outputs) <= {
        x if isinstance(x, str) else x.attrs["name"] for x in plan.targets}, f"plan {plan.name} has no target for all that it gives")
    for root, target in zip(plan.roots, plan.targets):
        if isinstance(target, Node):
            _that(root.vtype == target.vtype and root.extent in (target.extent, root.extent if is_inline(root) else None),
                  f"plan {plan.name} writes {root!r} to {target!r}")
    _graph(plan.name, plan.roots, sound or Sound(), drawn=True)


@check.register
def _packed(plan: PackedPlan, profile: Profile, naive: bool = False, sound: Sound | None = None) -> None:
    graph, there = plan.graph, set()
    for k, stage in enumerate(plan.stages):
        _that(len(stage.substages) == 1 or not any(is_alone(s.nodes[0]) for s in stage.substages),
              f"{graph.name}: stage {k} merges draws of geometry, or kernels")
        _that(stage.compute or not stage.substages[0].kernel, f"{graph.name}: stage {k} draws a kernel")
        for s in stage.substages:
            where = f"{graph.name}: stage {k} ({' '.join(n.op.name for n in s.outputs)})"
            _that((s.extent.width, s.extent.height) == (stage.extent.width, stage.extent.height), f"{where} is of another size")
            lines = [x for x in [hindrance(stage, profile)] if x] if s.compute else [] if naive else excess(s, profile)
            _that(not lines, f"{where} {'; '.join(lines)}")
            _domain(where, s, graph.kind == LEAVE)
            _that(all(is_leaf(x) or x in there for x in s.images), f"{where} reads what is not written before it")
            there.update(s.outputs)
    _that(set(graph.roots) <= there, f"plan {graph.name} does not compute all of its roots")


def _domain(where: str, s: Substage, in_place: bool) -> None:
    domain = s.domain
    _that(len(domain.outside) == len(s.outputs), f"{where} has no word of what some outputs are where nothing is drawn")
    _that(all((x == KEPT) == in_place for x in domain.outside), f"{where} is to keep what it does not write, or is not to")
    _that(all(x in (0, None, KEPT) or x == -1 and is_int(n.vtype) for x, n in zip(domain.outside, s.outputs)),
          f"{where} is cleared to {domain.outside}")
    _that((domain.by is None) == (domain.kind == FULL), f"{where} has a domain {domain.kind} by {domain.by}")
    if domain.kind in (TEXELS, TILES):
        _that(is_int(domain.by.vtype) and domain.by.channels == 1, f"{where} is guarded by {domain.by!r}")
    if domain.kind == TEXELS:
        nodes, cone = set(s.nodes), set(domain.cone)
        _that((domain.by in cone) == (domain.by in nodes) and cone <= nodes, f"{where} cannot compute its guard first")
    if domain.kind == TILES:
        width, height = domain.tile
        size = -(-s.extent.width // width), -(-s.extent.height // height)
        _that(size == (domain.by.extent.width, domain.by.extent.height), f"{where} has tiles of {domain.tile} by {domain.by!r}")
    _that(domain.kind != LISTED or bool(s.extent.partial), f"{where} is drawn as a list and is none")


@check.register
def _allocation(places: Allocation, profile: Profile, naive: bool = False, sound: Sound | None = None) -> None:
    taken = list(places.values.values())
    _that(len(set(taken)) == len(taken), "two values share an image")
    for p, plan in enumerate(places.plans):
        since: set[int] = set()  # written since the last wait
        for k, stage in enumerate(plan.stages):
            _that(len(set(stage.attachments)) == len(stage.attachments), f"plan {p} stage {k} attaches an image twice")
            since = set() if stage.wait else since
            _that(since.isdisjoint(stage.attachments), f"plan {p} stage {k} writes what may still be written")
            since.update(stage.attachments)


@check.register
def _description(description: dict, profile: Profile, naive: bool = False, sound: Sound | None = None) -> None:
    blobs = 1 + max([*description["shaders"], *(x[key] for of, key in (("images", "data"), ("values", "initial"))
                                                for x in description[of] if type(x[key]) is int)], default=-1)
    check_description({**description, "blobs": [[0, 0, bytes(32)]] * blobs})


def check_kinds(description: dict, plans: Iterable[PackedPlan]) -> None:
    """That a reader of the bundle takes each plan for what it is."""
    for plan, kind in zip(plans, kinds(description)):
        _that(kind == (OUTPUT if plan.graph.kind == PREPARE else plan.graph.kind), f"plan {plan.graph.name}, of kind {plan.graph.kind}, "
              f"would be taken for {kind}")


def _graph(name: str, roots: Iterable[Node], sound: Sound, drawn: bool = False) -> None:
    """Every node is of the type and extent that its op infers; drawn: and of an op that a shader can do."""
    known, fresh, left = sound.drawn if drawn else sound.typed, [], list(roots)
    while left:
        n = left.pop()
        if n not in known:
            known.add(n)
            fresh.append(n)
            left += n.inputs
    for n in sorted(fresh, key=lambda n: n.serial):  # as they were made: inputs first
        if n not in sound.typed or not drawn:
            found = n.op.infer(n.op.name, n.inputs, n.attrs)
            if found != (n.vtype, n.extent):
                _that(False, f"plan {name}: {n!r} is {found[0]} {found[1]} by its op")
        _that(not drawn or n.op.stage != "composite", f"plan {name} has ops that no shader can do")
