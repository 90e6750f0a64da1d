"""How many numbers a substage holds at once: what its shader needs of registers, before any compiler has seen it.

In: nodes of a substage in order, and its outputs. Out: a count of 32-bit numbers, a function of the nodes alone. It is near what vendors'
compilers allot (docs/drivers.md), though temporaries of single functions are not in it: a profile's bound (`max_live`) says where its
compiler begins to spill.
"""
from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from ..graph.ir import UNIT, Node
from ..graph.optable import OWN
from .substage import edges


class Peak(NamedTuple):
    """The place where most numbers are needed: how many, and the values computed before it whose every use is after it."""

    count: int
    across: tuple[Node, ...]


def statements(nodes: Sequence[Node]) -> list[list[Node]]:
    """These nodes in the order in which the shader computes them: all that needs no loop, then the loops that need nothing else, as one
    entry, and so on."""
    depth: dict[Node, int] = {}
    for n in nodes:
        depth[n] = max((depth[x] for x in n.inputs if x in depth), default=0) + (n.op.loop is not None)
    result: list[list[Node]] = []
    for level in range(max(depth.values(), default=-1) + 1):
        at = [n for n in nodes if depth[n] == level]
        loops = [n for n in at if n.op.loop is not None]
        result += [loops] * bool(loops) + [[n] for n in at if n.op.loop is None]
    return result


def peak(nodes: Sequence[Node], outputs: Iterable[Node]) -> Peak:
    """Counted are values computed before a place and read after it, what that place reads and computes itself, and results, which are
    written at the end; what is the same at every texel is not."""
    order = statements(nodes)
    first: dict[Node, int] = {}
    uses: dict[Node, list[int]] = {}
    for k, together in enumerate(order):
        for n in together:
            first.setdefault(n, k)
            for x, mode in edges(n):
                if mode == OWN and x.extent != UNIT or x in first:
                    first.setdefault(x, k)
                    uses.setdefault(x, []).append(k)
    for n in outputs:
        uses.setdefault(n, []).append(len(order))
    change = [0] * (len(order) + 2)
    for n, k in first.items():
        change[k] += n.channels
        change[max(uses.get(n, [k])) + 1] -= n.channels
    most = now = at = 0
    for k, x in enumerate(change):
        now += x
        if now > most:
            most, at = now, k
    inside = set(nodes)
    return Peak(most, tuple(n for n, k in first.items() if n in inside and k < at < min(uses.get(n, [0]))))
