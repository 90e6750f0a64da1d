"""Lists as a profile has room for them, and each once.

In: the plans of a `Group`. Out: the same. A list that an op laid in several columns of as many rows as every device has
(`ops/mip_lists.py: columns`) lies in fewer, longer ones, so that what is near in number is near in memory. Lists that are made alike, one
before and one after a pass rewrote what they list, are one, the older. The numbers are the same.
"""
from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from ..graph.ir import COLUMN, Extent, Node, intern, rebuild, remade, topological
from ..graph.ops.mip_lists import columns
from .groups import Group


def fewest(count: int, most: int) -> Extent:
    """Room for so many entries in as few columns of 64 texels as there can be with at most so many rows, all of one length."""
    rows = -(-count // COLUMN)
    wide = -(-rows // most)
    rows = -(-rows // wide)
    return Extent(COLUMN * wide, rows, COLUMN * wide * rows)


def laid(group: Group, rows: int) -> Group:
    """The plans of a group with lists in images of at most so many rows. Those that phases work on are laid already (`passes/lists.py`)."""
    done = {replace(x.extent, partial=0) for x in group.lists}
    roots = [root for roots in group.roots for root in roots]
    named = {n for n in topological(roots) if n.extent.partial or "partial" in n.attrs
             or any(isinstance(x, Extent) and x.partial for x in n.attrs.values())}
    if not named:
        return group

    def tall(e: Extent) -> Extent:
        long = COLUMN < e.width and e == replace(columns(e.count), partial=e.partial) and replace(e, partial=0) not in done
        return replace(fewest(e.count, rows), partial=e.partial) if long else e

    def written(n: Node, inputs: tuple[Node, ...], number: Callable[[int], int]) -> Node:
        """The node with the lists' numbers."""
        def extent(e: Extent) -> Extent:
            return replace(tall(e), partial=number(e.partial)) if e.partial else e

        if n not in named:
            return remade(n, inputs)
        attrs = {key: extent(x) if isinstance(x, Extent) else number(x) if key == "partial" else x for key, x in n.attrs.items()}
        return intern(n.op, inputs, attrs, n.vtype, extent(n.extent))

    numbers: dict[int, int] = {}
    made: dict[Node, int] = {}

    def find(n: Node, inputs: tuple[Node, ...]) -> Node:
        """Rewrites with the number of the first list that is made alike; the least takes its place in the end."""
        own = n.extent.partial
        if own and own not in numbers:  # what makes the list, for its inputs come first
            alone = written(n, inputs, lambda x: 0 if x == own else numbers[x])
            numbers[own] = made.setdefault(alone, own)
        return written(n, inputs, numbers.__getitem__)

    rebuild(roots, find)
    least = {first: min(own for own, x in numbers.items() if x == first) for first in set(numbers.values())}
    new = rebuild(roots, lambda n, inputs: written(n, inputs, lambda x: least[numbers[x]]))
    return replace(group, roots=tuple(tuple(new[root] for root in roots) for roots in group.roots))
