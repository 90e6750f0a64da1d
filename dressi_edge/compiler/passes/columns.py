"""Long lists in as few columns as a profile has rows for: what is near in number is then near in memory.

In: the plans of a `Group`. Out: the same; a list that an op laid in several columns of as many rows as every device has
(`ops/mip_lists.py: columns`) lies in fewer, longer ones. The numbers are the same.
"""
from __future__ import annotations

from dataclasses import replace

from ..graph.ir import COLUMN, Extent, Node, intern, rebuild, topological
from ..graph.ops.mip_lists import MAX_SIDE, columns
from .groups import Group


def tall(group: Group, rows: int) -> Group:
    """The plans of a group with lists in images of at most so many rows."""
    long: dict[Extent, Extent] = {}
    roots = [root for roots in group.roots for root in roots]
    for n in topological(roots):
        e = n.extent
        if e.partial and e.column == COLUMN < e.width and e.height == MAX_SIDE < rows and e.count == e.width * e.height:
            long[e] = replace(columns(e.count, rows), partial=e.partial)
    if not long:
        return group

    def laid(n: Node, inputs: tuple[Node, ...]) -> Node:
        attrs = {k: long.get(x, x) if isinstance(x, Extent) else x for k, x in n.attrs.items()}
        return intern(n.op, inputs, attrs, n.vtype, long.get(n.extent, n.extent))

    new = rebuild(roots, laid)
    return replace(group, roots=tuple(tuple(new[root] for root in roots) for roots in group.roots))
