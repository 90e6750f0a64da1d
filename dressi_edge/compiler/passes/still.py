"""What an image that changes is read by at places that rest, read in another way: from lists that are made once (`Op.still`).

In: a group of plans. Out: the same; nodes whose op knows such a way are replaced where all that they read at the own texel rests in every
plan of the group and what they read elsewhere does not. Only groups of a phase: others draw once, and lists would cost more than they save.
"""
from __future__ import annotations

from dataclasses import replace

from ..graph.ir import Node, rebuild, remade
from ..graph.optable import OWN
from .groups import Group
from .simplify import simplify
from .specialize import dependence


def find_still(group: Group) -> Group:
    """The group with what rests used."""
    if not any(spec.updates for spec in group.specs):
        return group
    roots = [root for roots in group.roots for root in roots]
    dynamic = frozenset().union(*(spec.dynamic for spec in group.specs))
    dirty = {n for n, names in dependence(roots).items() if names & dynamic}

    def rests(n: Node) -> bool:
        changing = [n.op.read(k) for k, x in enumerate(n.inputs) if x in dirty]
        return n.op.still is not None and changing and OWN not in changing

    def rewrite(n: Node, inputs: tuple[Node, ...]) -> Node:
        made = remade(n, inputs)
        return n.op.still(made) if rests(n) else made

    new = rebuild(roots, rewrite)
    if not any(new[n] is not n for n in new):
        return group
    return replace(group, roots=tuple(tuple(simplify([new[root] for root in roots])) for roots in group.roots))
