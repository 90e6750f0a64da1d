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
    levels: dict[int, tuple[list[Node], list[Node]]] = {}  # loops, and all else
    for n in nodes:
        depth[n] = max([depth[x] for x in n.inputs if x in depth], default=0) + (n.op.loop is not None)
        levels.setdefault(depth[n], ([], []))[n.op.loop is None].append(n)
    result: list[list[Node]] = []
    for level in sorted(levels):
        loops, rest = levels[level]
        result += [loops] * bool(loops) + [[n] for n in rest]
    return result


def reads(n: Node) -> list[tuple[Node, bool]]:
    """What it reads of images, and whether that is a number of this texel wherever it comes from."""
    return [(x, mode == OWN and x.extent != UNIT) for x, mode in edges(n)]


def peak(nodes: Sequence[Node], outputs: Iterable[Node], known: dict[Node, list[tuple[Node, bool]]] | None = None) -> Peak:
    """Counted are values computed before a place and read after it, what that place reads and computes itself, and results, which are
    written at the end; what is the same at every texel is not. known: `reads` of nodes, which grows, for who asks often."""
    order, known = statements(nodes), {} if known is None else known
    made: dict[Node, int] = {}  # value -> where it is computed, or first read; where it is read first and last
    begin: dict[Node, int] = {}
    end: dict[Node, int] = {}
    for k, together in enumerate(order):
        for n in together:
            made.setdefault(n, k)
            if n not in known:
                known[n] = reads(n)
            for x, own in known[n]:
                if own or x in made:
                    made.setdefault(x, k)
                    begin.setdefault(x, k)
                    end[x] = k
    for n in outputs:
        begin.setdefault(n, len(order))
        end[n] = len(order)
    change = [0] * (len(order) + 2)
    for n, k in made.items():
        change[k] += n.channels
        change[end.get(n, k) + 1] -= n.channels
    most = now = at = 0
    for k, x in enumerate(change):
        now += x
        if now > most:
            most, at = now, k
    inside = set(nodes)
    return Peak(most, tuple(n for n, k in made.items() if n in inside and k < at < begin.get(n, 0)))
