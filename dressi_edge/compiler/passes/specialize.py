"""The reactive cache, ahead of time: split a plan into what changes every run and what is computed once.

In: roots and the names of the leaves that change (dynamic). Out: roots whose clean parts are `cached` leaves, and for each of
those the clean node to compute beforehand (the paper's full rebuild, done offline). Cheap clean values are left in place.
What is computed beforehand is split again by the leaves it depends on, so that a new value of one runs no more than depends on it
(the paper's fast rebuild).
"""
from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence

from ...cache.bundle_plans import MAX_NEEDS
from ..graph.ir import Node, intern, topological
from ..graph.optable import OWN, apply

KEEP_COST = 12  # a clean value this cheap that fetches nothing is computed again


def dependence(roots: Iterable[Node]) -> dict[Node, frozenset[str]]:
    """The names of the inputs and states that each node depends on."""
    names: dict[Node, frozenset[str]] = {}
    for n in topological(roots):
        own = {n.attrs["name"]} if n.op.held else set()
        names[n] = frozenset(own.union(*(names[x] for x in n.inputs)))
    return names


def specialize(roots: Sequence[Node], dynamic: frozenset[str], prefix: str, cached: dict[Node, Node]) -> list[Node]:
    """New roots. `cached` (clean node -> its cached leaf) is shared by the plans of a group, and grows."""
    return _cut(roots, {n for n, names in dependence(roots).items() if names & dynamic}, prefix, cached)


def prepare(prefix: str, cached: dict[Node, Node], most: int = MAX_NEEDS) -> list[tuple[list[Node], list[Node]]]:
    """The plans that compute what is cached, in running order, each as its roots and the cached leaves they fill: one for each
    set of inputs and states that something depends on. What depends on fewer is cached in turn, so `cached` grows. More than `most`
    sets are one."""
    names, plans = dependence(cached), {}
    while left := {names[n] for n in cached} - plans.keys():
        widest = max(left, key=lambda s: (len(s), sorted(s)))
        nodes = [n for n in cached if names[n] == widest]
        plans[widest] = _cut(nodes, {n for n in names if names[n] == widest}, prefix, cached), [cached[n] for n in nodes]
    if len(plans) > most:
        return [(list(cached), list(cached.values()))]
    return list(plans.values())[::-1]


def _cut(roots: Sequence[Node], dirty: set[Node], prefix: str, cached: dict[Node, Node]) -> list[Node]:
    """The roots, with cached leaves for what is not dirty."""
    cost: dict[Node, float] = {}
    order = topological(roots)
    for n in order:
        if n.op.held:
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
        if n.op.stage in ("leaf", "inline") or cost[n] <= KEEP_COST or new[n].op.stage == "leaf":
            return new[n]
        if n.op.part and parts[n.inputs[0]] > 1:  # one image instead of several
            new[n] = intern(n.op, (keep(n.inputs[0]),), n.attrs, n.vtype, n.extent)
            return new[n]
        if n not in cached:
            stored = {} if n.half is None else {"half": n.half}
            cached[n] = apply("cached", name=f"{prefix}.cached{len(cached)}", vtype=n.vtype, extent=n.extent, **stored)
        new[n] = cached[n]
        return new[n]

    for n in order:
        if n in dirty:
            inputs = tuple(new[x] if x in dirty or x.op.stage == "inline" else keep(x) for x in n.inputs)
            new[n] = intern(n.op, inputs, n.attrs, n.vtype, n.extent)
        else:
            new[n] = n
    return [new[r] if r in dirty else keep(r) for r in roots]
