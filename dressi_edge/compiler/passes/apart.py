"""What gets passes of its own: work that counts in some tiles only, and that the graph asks to keep apart.

In: the nodes of a plan in order, its roots. Out: for each node that belongs to such work the image of its tiles. A gate, which is
`inside_tiles` with `apart`, starts it. What is zero (of integers, or -1) where no tile is marked belongs to these tiles: the gate, and the
backward of what lies before it. So does what only that reads: the forward. Without this all pixelwise work of one level is one shader,
which is drawn wherever any of it counts: two parts of a scene cost in each other's tiles what they cost in their own.
"""
from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from ..graph.ir import Node
from ..graph.optable import OWN, TILE
from .known import Known, number
from .substage import edges, is_inline, is_leaf

WORTH = 24  # less work that reads nothing of such tiles stays where what it reads is


@dataclass(frozen=True)
class Apart:
    """tiles: for each node with passes of its own the image of the tiles where it counts. size: of each such image the pixels of a tile."""

    tiles: Mapping[Node, Node] = field(default_factory=dict)
    size: Mapping[Node, tuple[int, int]] = field(default_factory=dict)

    def edges(self, n: Node) -> list[tuple[Node, str]]:
        """The images that a node needs, each with how it is read; its tiles are one of them."""
        return [*edges(n), (self.tiles[n], TILE)] if n in self.tiles else edges(n)

    def ordered(self, order: Sequence[Node]) -> list[Node]:
        """The nodes with all that they need before them."""
        done: dict[Node, None] = {}
        for root in order:
            stack = [root]
            while stack:
                missing = [x for x, _ in self.edges(stack[-1]) if x not in done]
                if missing:
                    stack += missing
                else:
                    done[stack.pop()] = None
        return list(done)


def find_apart(order: Sequence[Node], roots: set[Node], known: Known) -> Apart:
    """What belongs to several images of tiles goes to the first of them in order."""
    gates = [n for n in order if n.attrs.get("apart")]
    tiles: dict[Node, Node] = {}
    for by, extent in dict.fromkeys((n.inputs[1], n.extent) for n in gates):
        for n, value in known.where_zero(by, extent).items():
            if n is not by and number(n, value) is not None:
                tiles.setdefault(n, by)
    for piece in _pieces(_only_read_by(order, roots, tiles), order):
        reads = {x for n in piece for x in n.inputs}
        own = next(iter(piece.values()))
        if sum(n.op.cost for n in piece) > WORTH or any(tiles.get(x) is own for x in reads):
            tiles.update(piece)
    return Apart(tiles, {n.inputs[1]: n.attrs["tile"] for n in gates})


def _only_read_by(order: Sequence[Node], roots: set[Node], tiles: Mapping[Node, Node]) -> dict[Node, Node]:
    """The nodes that only what belongs to one image of tiles reads, at their own texels, and so on up."""
    if not tiles:
        return {}
    users: dict[Node, set[Node | None]] = {}
    only: dict[Node, Node] = {}
    for n in reversed(order):
        if n not in tiles and n not in roots and n.op.stage == "pixel" and not is_leaf(n) and not is_inline(n):
            found = users.get(n, {None})
            if len(found) == 1 and None not in found:
                only[n], = found
        mine = tiles.get(n, only.get(n))
        for x, mode in edges(n):
            near = mode == OWN and x.extent == n.extent and n.op.stage == "pixel"
            users.setdefault(x, set()).add(mine if near else None)
    return only


def _pieces(only: Mapping[Node, Node], order: Sequence[Node]) -> list[dict[Node, Node]]:
    """What is connected, of one image of tiles."""
    beside: dict[Node, list[Node]] = {}
    for n in (n for n in order if n in only):
        for x in n.inputs:
            if only.get(x) is only[n]:
                beside.setdefault(n, []).append(x)
                beside.setdefault(x, []).append(n)
    pieces, seen = [], set()
    for n in (n for n in order if n in only):
        piece, stack = {}, [n]
        while stack:
            x = stack.pop()
            if x not in seen:
                seen.add(x)
                piece[x] = only[x]
                stack += beside.get(x, ())
        if piece:
            pieces.append(piece)
    return pieces
