"""What the plans of a `Scene.vjp` compute again, and what they keep for each other.

Its parameters move in each round of a caller's loop, so all that depends on them is new in each: pictures, then gradients. To keep every
number of a pixel that the gradient reads would cost more than to compute it again beside it, from what was drawn. So only that is kept
which a texel cannot make by itself at little cost (what is drawn, lists, tables, sums), and what is worked out in few tiles but belongs to
a picture of all pixels: that is drawn in those tiles, by itself, and laid into the picture.

In: roots, and which of their nodes move but are no part of what changes in every run. Out: which of these to compute again.
"""
from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence

import numpy as np

from ..graph.ir import Node, intern, rebuild, remade, topological
from ..graph.optable import OWN, TILE, apply, as_node
from .constants import constant_value

AGAIN_COST = 50  # an op up to this is done again: lookups and samples, too
APART_COST = 60  # work in few tiles that is worth an image of its own


def _light(n: Node) -> bool:
    return n.op.stage == "pixel" and n.op.loop is None and n.op.cost <= AGAIN_COST


def again(roots: Sequence[Node], order: Sequence[Node], dirty: Collection[Node], moving: Collection[Node]) -> set[Node]:
    """The nodes to compute again, in the plan of these roots: those that move and are read at the own texel. order: all nodes below."""
    found: set[Node] = set()

    def ask(n: Node) -> None:
        if n in moving and n not in dirty and _light(n) and not _in_few_tiles(n):
            found.add(n)

    for root in roots:
        ask(root)
    for n in reversed(order):
        if n in dirty or n in found:
            for k, x in enumerate(n.inputs):
                if n.op.read(k) == OWN:
                    ask(x)
    return found


def heavy(nodes: Iterable[Node], others: Iterable[Node], among: Collection[Node]) -> set[Node]:
    """What both take and neither should make twice."""
    others = set(others)
    return {n for n in nodes if n in others and n in among and n.op.stage != "leaf" and not _light(n)}


def _own(n: Node) -> list[Node]:
    return [x for k, x in enumerate(n.inputs) if n.op.read(k) == OWN]


def _work(n: Node, but: Collection[Node] = ()) -> set[Node]:
    """What a texel of n takes by itself, n included."""
    work, stack = set(), [n]
    while stack:
        x = stack.pop()
        if x not in work and x not in but and _light(x):
            work.add(x)
            stack += _own(x)
    return work


def _cost(nodes: Collection[Node]) -> int:
    return sum(n.op.cost for n in nodes)


def _tiles(n: Node) -> Node | None:
    """What says in which tiles it is anything."""
    return next((x for k, x in enumerate(n.inputs) if n.op.read(k) == TILE), None)


def _in_few_tiles(n: Node) -> bool:
    """Whether much work is nothing outside of some tiles."""
    return _tiles(n) is not None and _cost(_work(n)) >= APART_COST


def in_its_tiles(n: Node, leaf: Node, keep: Callable[[Node], Node]) -> Node:
    """What a plan reads in place of n, which is kept in a leaf: where n is nothing outside of some tiles, so is that, and readers need not
    be drawn there either."""
    gate = [n.op.read(k) for k in range(len(n.inputs))] == [OWN, TILE]
    return apply("inside_tiles", leaf, keep(_tiles(n)), tile=n.attrs["tile"]) if gate and _in_few_tiles(n) else leaf


def apart(roots: Sequence[Node], moving: Collection[Node]) -> list[Node]:
    """Roots that move, with choices taken apart in which one side is much work and is taken in some tiles alone: what is chosen in those
    tiles is then a node of its own, which `again` leaves to be kept, and elsewhere the other side is."""
    return [_split(root) if root in moving else root for root in roots]


def _split(root: Node) -> Node:
    order = topological([root])
    known: dict[Node, np.ndarray] = {x: np.zeros(1, np.int64) for x in map(_tiles, order) if x is not None}
    for n in order:
        if n not in known and (value := constant_value(n, known)) is not None:
            known[n] = value

    kept = set(topological([n for n in order if _in_few_tiles(n)]))  # in tiles already

    def rewrite(n: Node, inputs: tuple[Node, ...]) -> Node:
        new = remade(n, inputs)
        if n in kept or not (n.op.chooses and n.inputs[0] in known and not known[n.inputs[0]].any()):
            return new
        by, there, elsewhere = n.inputs
        beside = _work(by)
        tiled = [m for m in order if m in beside and _tiles(m) is not None]
        if not tiled or _cost(_work(there, beside | _work(elsewhere))) < APART_COST:
            return new
        tiles, how = _tiles(tiled[0]), {"tile": tiled[0].attrs["tile"]}
        inside = apply("inside_tiles", apply("broadcast", as_node(1), extent=n.extent), tiles, **how)
        return intern(n.op, (inside, apply("inside_tiles", new, tiles, **how), inputs[2]), n.attrs, n.vtype, n.extent)

    return rebuild([root], rewrite)[root]
