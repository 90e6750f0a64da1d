"""Which texels of each substage are drawn: one pass for all four ways to leave work out.

In: the stages of a plan. Out: the same, each substage with its `Domain`, found from facts of the op table alone. A guard is an int under
which, where it is zero, every output is a known constant: `Op.when` and `Op.chooses` carry zeros through, everything else must be
constant to give a constant. The texels are then discarded before the work or, where the guard has one texel for a tile, the tile is not
drawn; attachments are cleared to the constants, but for what is of no use there (`Op.named`, `Op.covers`). What has the extent of a list is
drawn as far as the list goes. A plan that gives copies back ("leave") writes in place: what is not drawn keeps what was there.
"""
from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from ...cache.errors import PackError
from ..graph.ir import Extent, Node, is_int, topological
from ..graph.optable import COUNT, OWN, TILE, VERTEX
from .apart import Apart, find_apart
from .known import Known, number
from .plans import LEAVE, PlanGraph
from .substage import KEPT, LISTED, TEXELS, TILES, Domain, Stage, Substage

MIN_COST = 40  # work worth a test


@dataclass(frozen=True)
class Guard:
    """Where `node` is 0 output k is `constants[k]` in every channel, 0, or -1 for integers, or None where nothing reads it. `cone`: what
    computes the node here. `tile`: the node comes from outside and has one texel for so many of the substage's; whole tiles are then left
    undrawn."""

    node: Node
    cone: tuple[Node, ...]
    constants: tuple[int | None, ...]
    tile: tuple[int, int] | None = None


def _cone(node: Node, inside: set[Node], order: tuple[Node, ...]) -> tuple[Node, ...]:
    keep, stack = {node}, [node]
    while stack:
        for x in stack.pop().inputs:
            if x in inside and x not in keep:
                keep.add(x)
                stack.append(x)
    return tuple(n for n in order if n in keep)


def find_guard(stage: Substage, known: Known, least: int = MIN_COST, apart: Apart = Apart(),  # noqa: B008  (frozen)
               unread: Callable[[Node, Node], bool] = lambda x, by: False) -> Guard | None:
    """The guard that leaves most work out, by tiles if it can be, before all by those that the graph keeps apart; or None. One that leaves
    out less than `least` is none. apart: of the plan; unread: whether nothing reads x, an output, where a guard is zero."""
    if stage.raster or stage.kernel:
        return None
    inside = set(stage.nodes)
    total = sum(n.op.cost for n in stage.nodes)
    conditions = dict.fromkeys(n.inputs[0] for n in stage.nodes if n.op.chooses)  # in the stage's order: the first of equals is taken
    conditions |= dict.fromkeys(n.inputs[when.input] for n in stage.nodes for when in n.op.when if when.flag)
    tiles = {x: n.attrs["tile"] for n in stage.nodes for k, x in enumerate(n.inputs) if n.op.read(k) == TILE}
    own = {apart.tiles[n] for n in stage.nodes if n in apart.tiles} if all(n in apart.tiles for n in stage.outputs) else set()
    tiles |= {x: apart.size[x] for x in own}
    conditions |= dict.fromkeys(own)
    best = None
    for c in (c for c in conditions if is_int(c.vtype) and c.channels == 1 and (c.extent == stage.extent or c in tiles)):
        values = known.where_zero(c, stage.extent)
        constants = tuple(number(n, values.get(n)) for n in stage.outputs)
        if any(x is None and not unread(n, c) for x, n in zip(constants, stage.outputs)):
            continue
        cone = _cone(c, inside, stage.nodes) if c in inside else ()
        saved = total - sum(n.op.cost for n in cone)
        rank = (c in tiles, c in own, saved)  # tiles that are not drawn cost nothing anywhere
        if saved >= least and (best is None or rank > best[0]):
            best = (rank, Guard(c, cone, constants, tiles.get(c)))
    return best and best[1]


def find_domains(plan: PlanGraph, stages: Sequence[Stage], guards: bool = True) -> tuple[Stage, ...]:
    """The stages of a plan with their domains; without `guards`, a simple twin of the same bits, only geometry leaves anything undrawn, and
    what must keep what it does not write. Raises PackError where copies cannot be given back in place."""
    totals = {**plan.totals, **_totals(stages)} if guards else {}
    order = topological(plan.roots)
    known = Known(order)
    apart = find_apart(order, set(plan.roots), known)
    use = _Use(plan.roots, stages, known)

    def domain(s: Substage) -> Domain:
        if s.raster:
            return Domain(outside=(s.nodes[0].op.clear,))
        if s.kernel:
            return Domain(outside=(None,))
        if s.extent in totals and plan.kind != LEAVE:
            return Domain(LISTED, totals[s.extent], outside=tuple(map(use.after_the_last, s.outputs)))
        guard = find_guard(s, known, 0) if plan.kind == LEAVE else find_guard(s, known, MIN_COST, apart, use.unread) if guards else None
        if plan.kind == LEAVE:
            return _in_place(plan, s, guard)
        if guard is None:
            return Domain(outside=(None,) * len(s.outputs))
        outside = [None if use.none_outside(n, guard, s.extent) else x for n, x in zip(s.outputs, guard.constants)]
        return Domain(TILES if guard.tile else TEXELS, guard.node, guard.tile, guard.cone, tuple(outside))

    result = []
    for stage in reversed(stages):  # readers first
        substages = []
        for s in reversed(stage.substages):
            substages.insert(0, replace(s, domain=domain(s)))
            use.drawn(substages[0])
        result.insert(0, Stage(stage.extent, tuple(substages)))
    return tuple(result)


def _in_place(plan: PlanGraph, s: Substage, guard: Guard | None) -> Domain:
    if guard is None:
        raise PackError(f"plan {plan.name}: nothing says which texels of {' '.join(n.name for n in s.outputs)} were copied, and all "
                        "would be written; a defect of the compiler: compile with sparse_texels=None, and report it")
    return Domain(TILES if guard.tile else TEXELS, guard.node, guard.tile, guard.cone, (KEPT,) * len(s.outputs))


def _totals(stages: Sequence[Stage]) -> dict[Extent, Node]:
    """Of the extents of lists that these stages make, what says how many entries there are."""
    return {n.extent: x for stage in stages for s in stage.substages for n in s.nodes if n.extent.partial
            for k, x in enumerate(n.inputs) if n.op.read(k) == COUNT}


class _Use:
    """Which outputs of a substage nothing reads where they are left out."""

    def __init__(self, roots: Sequence[Node], stages: Sequence[Stage], known: Known):
        self.known = known
        self.roots, self.reads, self.readers = set(roots), {}, {}
        for n in (n for stage in stages for s in stage.substages for n in s.nodes):
            for k, x in enumerate(n.inputs):
                self.reads.setdefault(x, []).append((n, k))

    def drawn(self, s: Substage) -> None:
        """Takes note of a substage whose domain is known."""
        for x, mode in s.reads:
            self.readers.setdefault(x, []).append((mode, s.domain.by if s.domain.kind == TILES else None))

    def unread(self, x: Node, by: Node) -> bool:
        """Whether nothing reads x in tiles where `by` is zero, as far as readers were taken note of: all of them come later."""
        return x not in self.roots and all(mode == OWN and tiles is by for mode, tiles in self.readers.get(x, [(None, None)]))

    def none_outside(self, x: Node, guard: Guard, extent: Extent) -> bool:
        """Whether x, one of the outputs, is of use only where something is named by an image that names nothing where the guard is zero
        (`Op.named`, `Op.covers`)."""
        values = self.known.where_zero(guard.node, extent)
        named = {n: number(n, value) for n, value in values.items()}
        if guard.node.op.covers:
            covered, value = guard.node.op.covers
            named[guard.node.inputs[covered]] = value

        def of_no_use(n: Node, k: int) -> bool:
            mine, other, none = n.op.named or (-1, 0, 0)
            by = n.inputs[other]
            return k == mine and named.get(by.inputs[0] if by.op.regroups else by) == none
        return x not in self.roots and all(of_no_use(n, k) for n, k in self.reads[x])

    def after_the_last(self, x: Node) -> int | None:
        """What an output of a list has to be after its entries: draws may run over all there could be."""
        drawn = x in self.roots or any(n.op.read(k) == VERTEX for n, k in self.reads[x])
        return -1 if x.vtype == "int" and drawn else None
