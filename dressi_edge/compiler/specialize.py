"""The reactive cache, ahead of time: split a plan into what changes every run and what is computed once.

In: roots and the names of the leaves that change (dynamic). Out: roots whose clean parts are `cached` leaves, and for each of
those the clean node to compute beforehand (the paper's full rebuild, done offline). Cheap clean values are left in place.
"""
from __future__ import annotations

from collections.abc import Sequence

from .ir import Node, intern, topological
from .optable import OWN, apply

KEEP_COST = 12  # a clean value this cheap that fetches nothing is computed again


def specialize(roots: Sequence[Node], dynamic: frozenset[str], prefix: str, cached: dict[Node, Node]) -> list[Node]:
    """New roots. `cached` (clean node -> its cached leaf) is shared by the plans of a group, and grows."""
    order = topological(roots)
    dirty: set[Node] = set()
    cost: dict[Node, float] = {}
    for n in order:
        if n.op.name in ("input", "state"):
            if n.attrs["name"] in dynamic:
                dirty.add(n)
            cost[n] = 1
        elif any(x in dirty for x in n.inputs):
            dirty.add(n)
        elif n.op.stage == "pixel" and n.op.loop is None and all(n.op.read(k) == OWN for k in range(len(n.inputs))):
            cost[n] = n.op.cost + sum(cost[x] for x in n.inputs)
        else:
            cost[n] = float("inf") if n.inputs else n.op.cost
    new: dict[Node, Node] = {}

    def keep(n: Node) -> Node:
        """n itself, rebuilt, or its cached leaf."""
        if n.op.stage in ("leaf", "inline") or cost.get(n, 0) <= KEEP_COST or new[n].op.name == "cached":
            return new[n]
        if n not in cached:
            cached[n] = apply("cached", name=f"{prefix}.cached{len(cached)}", vtype=n.vtype, extent=n.extent)
        new[n] = cached[n]
        return new[n]

    for n in order:
        if n in dirty:
            inputs = tuple(new[x] if x in dirty or x.op.stage == "inline" else keep(x) for x in n.inputs)
            new[n] = intern(n.op, inputs, n.attrs, n.vtype, n.extent)
        else:
            new[n] = n
    return [new[r] if r in dirty else keep(r) for r in roots]
