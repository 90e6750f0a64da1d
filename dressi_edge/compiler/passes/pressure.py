"""How many numbers a substage holds at once: what its shader needs of registers, before any compiler has seen it.

In: nodes of a substage in order, and its outputs. Out: a count of 32-bit numbers, a function of the nodes alone. It is near what vendors'
compilers allot (docs/drivers.md), though temporaries of single functions but loops are not in it: a profile's bound (`max_live`) says
where its compiler begins to spill.
"""
from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from functools import cache
from typing import NamedTuple

from ..graph.ir import UNIT, Node
from ..graph.optable import OWN, Loop
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


class Needs(NamedTuple):
    """What a node needs while it is computed. reads: of images, and whether that is a number of this texel wherever it comes from. loop:
    equal for nodes that share a loop. fetched: what its turns read at other texels."""

    reads: tuple[tuple[Node, bool], ...]
    loop: tuple
    fetched: tuple[Node, ...]


@cache
def _named(loop: Loop) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The marks in a loop's header, and the inputs that its body fetches."""
    return tuple(dict.fromkeys(re.findall(r"\{(\w+)\}", loop.header))), tuple(re.findall(r"\{(\w+?)(?:_at)?\}\(", loop.body))


def needs(n: Node) -> Needs:
    """What a node needs while it is computed."""
    found = tuple((x, mode == OWN and x.extent != UNIT) for x, mode in edges(n))
    if n.op.loop is None:
        return Needs(found, (), ())
    given, (marks, fetched) = dict(zip(n.op.params, n.inputs)), _named(n.op.loop)
    stands = {x + end: of for x, node in given.items() for end, of in (
        ("", node), ("_at", node), *((end, node.extent) for end in ("_w", "_h", "_n")))} | n.attrs
    return Needs(found, (n.op.loop.header, *map(stands.get, marks)), tuple(given[x] for x in fetched))


def _turn(loops: Sequence[Node], known: dict[Node, Needs]) -> int:
    """Numbers that the dearest of some loops holds beside results: its own, and what all that share it fetch in a turn, which compilers
    do before they add any of it."""
    shared: dict[tuple, set[Node]] = {}
    holds: dict[tuple, int] = {}
    for n in loops:
        shared.setdefault(known[n].loop, set()).update(known[n].fetched)
        holds[known[n].loop] = max(n.op.loop.holds, holds.get(known[n].loop, 0))
    return max(holds[loop] + sum(x.channels for x in fetched) for loop, fetched in shared.items())


def peak(nodes: Sequence[Node], outputs: Iterable[Node], known: dict[Node, Needs] | None = None) -> Peak:
    """Counted are values computed before a place and read after it, what that place reads, fetches and computes itself, and results, which
    are written at the end; what is the same at every texel is not. known: `needs` of nodes, which grows, for who asks often."""
    order, known = statements(nodes), {} if known is None else known
    made: dict[Node, int] = {}  # value -> where it is computed, or first read; where it is read first and last
    begin: dict[Node, int] = {}
    end: dict[Node, int] = {}
    for k, together in enumerate(order):
        for n in together:
            made.setdefault(n, k)
            if n not in known:
                known[n] = needs(n)
            for x, own in known[n].reads:
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
    for k, together in enumerate(order):
        if together[0].op.loop is not None:
            turn = _turn(together, known)
            change[k] += turn
            change[k + 1] -= turn
    most = now = at = 0
    for k, x in enumerate(change):
        now += x
        if now > most:
            most, at = now, k
    inside = set(nodes)
    return Peak(most, tuple(n for n, k in made.items() if n in inside and k < at < begin.get(n, 0)))


def keeps(nodes: Sequence[Node], outputs: Iterable[Node], most: int | None) -> bool:
    """Whether loops have room for what is the same in all turns, where a shader may hold so many numbers at once."""
    if most is None:
        return True
    kept = sum(dict((needs(n).loop, n.op.loop.lean[1]) for n in nodes if n.op.loop is not None).values())
    return not kept or peak(nodes, outputs).count + kept <= most
