"""The reactive cache, ahead of time: split a plan into what changes every run and what is computed once.

In: roots and the names of the leaves that change (dynamic). Out: roots whose clean parts are `cached` leaves, and for each of
those the clean node to compute beforehand (the paper's full rebuild, done offline). Cheap clean values are left in place.
What is computed beforehand is split again by the leaves it depends on, so that a new value of one runs no more than depends on it
(the paper's fast rebuild).

Of what depends on `moving` leaves less is kept: `passes/again.py`.
"""
from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence

from ...cache.bundle_plans import MAX_NEEDS
from ..graph.ir import Extent, Node, remade, topological
from ..graph.optable import COUNT, OWN, apply
from .again import again, apart, heavy, in_its_tiles

KEEP_COST = 12  # a clean value this cheap that fetches nothing is computed again


def dependence(roots: Iterable[Node]) -> dict[Node, frozenset[str]]:
    """The names of the inputs and states that each node depends on."""
    names: dict[Node, frozenset[str]] = {}
    for n in topological(roots):
        own = {n.attrs["name"]} if n.op.held else set()
        names[n] = frozenset(own.union(*(names[x] for x in n.inputs)))
    return names


def specialize(roots: Sequence[Node], dynamic: frozenset[str], prefix: str, cached: dict[Node, Node],
               moving: frozenset[str] = frozenset()) -> list[Node]:
    """New roots. `cached` (clean node -> its cached leaf) is shared by the plans of a group, and grows. moving: leaves that change too,
    but less often."""
    if moving:
        names = dependence(roots)
        roots = apart(roots, {n for n in names if names[n] & moving and not names[n] & dynamic})
    names = dependence(roots)
    return _cut(roots, {n for n in names if names[n] & dynamic}, {n for n in names if names[n] & moving}, prefix, cached)


def counts(roots: Sequence[Node], new: Sequence[Node], prefix: str, cached: dict[Node, Node]) -> dict[Extent, Node]:
    """Of the extents of lists that a plan with these new roots works on but does not make, the cached leaf that says how many entries there
    are. `cached` grows."""
    made = {n.extent: x for n in topological(roots) if n.extent.partial for k, x in enumerate(n.inputs) if n.op.read(k) == COUNT}
    order = topological(new)
    own = {n.extent for n in order for k in range(len(n.inputs)) if n.op.read(k) == COUNT}
    used = dict.fromkeys(n.extent for n in order if n.extent in made and n.extent not in own and n.op.stage == "pixel")
    return {extent: _leaf(made[extent], prefix, cached) for extent in used}


def late(rooted: Sequence[Sequence[Node]], dynamic: frozenset[str], cached: Mapping[Node, Node]) -> set[Node]:
    """Of what is cached, what no plan needs that changes in every run: the pictures of a vjp, not its gradients. rooted: the new roots of
    each plan."""
    leaves = {leaf: n for n, leaf in cached.items()}
    changing = [roots for roots in rooted if any(n.op.held and n.attrs["name"] in dynamic for n in topological(roots))]
    needed = [leaves[n] for roots in changing for n in topological(roots) if n in leaves]
    return cached.keys() - set(topological(needed)) if changing else set()


def prepare(prefix: str, cached: dict[Node, Node], most: int = MAX_NEEDS, moving: frozenset[str] = frozenset(),
            last: Collection[Node] = ()) -> list[tuple[list[Node], list[Node]]]:
    """The plans that compute what is cached, in running order, each as its roots and the cached leaves they fill: one for each
    set of inputs and states that something depends on, and one more for those of `last`. What depends on fewer is cached in turn, so
    `cached` grows. More than `most` plans are one."""
    names, plans = dependence(cached), {}

    def key(n: Node) -> tuple[frozenset[str], bool]:
        return names[n], n in last

    while left := {key(n) for n in cached} - plans.keys():
        widest, after = max(left, key=lambda k: (len(k[0]), sorted(k[0]), k[1]))
        nodes = [n for n in cached if key(n) == (widest, after)]
        own, restless = {n for n in names if names[n] == widest}, {n for n in names if names[n] & moving}
        if after:
            before = [n for n in cached if key(n) == (widest, False)]
            own -= {*before, *heavy(topological(nodes), topological(before), own)}
        plans[widest, after] = _cut(nodes, own, restless, prefix, cached), [cached[n] for n in nodes]
    if len(plans) > most:
        return [(list(cached), list(cached.values()))]
    return list(plans.values())[::-1]


def _leaf(n: Node, prefix: str, cached: dict[Node, Node]) -> Node:
    """Its cached leaf."""
    if n not in cached:
        stored = {} if n.half is None else {"half": n.half}
        cached[n] = apply("cached", name=f"{prefix}.cached{len(cached)}", vtype=n.vtype, extent=n.extent, **stored)
    return cached[n]


def _cut(roots: Sequence[Node], dirty: set[Node], moving: set[Node], prefix: str, cached: dict[Node, Node]) -> list[Node]:
    """The roots, with cached leaves for what is not dirty, or of what moves for what is not computed again."""
    cost: dict[Node, float] = {}
    order = topological(roots)
    dirty = dirty | again(roots, order, dirty, moving)
    for n in order:
        if n.op.held or n.op.keeps:
            cost[n] = 1
        elif n.op.stage == "pixel" and n.op.loop is None and all(n.op.read(k) == OWN for k in range(len(n.inputs))):
            cost[n] = n.op.cost + sum(cost[x] for x in n.inputs)
        else:
            cost[n] = float("inf") if n.inputs else n.op.cost
    new: dict[Node, Node] = {}
    wanted = {*(x for n in order if n in dirty for x in n.inputs), *roots} - dirty
    parts = Counter(x.inputs[0] for x in wanted if x.op.part)  # how many of its channels a clean vector is wanted for

    def keep(n: Node) -> Node:
        """n itself, rebuilt, or its cached leaf."""
        if n.op.stage in ("leaf", "inline") or new[n].op.stage == "leaf":
            return new[n]
        if cost[n] <= KEEP_COST and not n.op.keeps:
            new[n] = remade(n, tuple(map(keep, n.inputs)))  # what it keeps lies below
            return new[n]
        if n.op.part and parts[n.inputs[0]] > 1:  # one image instead of several
            new[n] = remade(n, (keep(n.inputs[0]),))
            return new[n]
        new[n] = in_its_tiles(n, _leaf(n, prefix, cached), keep) if n in moving else _leaf(n, prefix, cached)
        return new[n]

    for n in order:
        if n in dirty:
            inputs = tuple(new[x] if x in dirty or x.op.stage == "inline" else keep(x) for x in n.inputs)
            new[n] = remade(n, inputs)
        else:
            new[n] = n
    return [new[r] if r in dirty else keep(r) for r in roots]
