"""Sums over the pixels of entries that may show many are made in bands of rows, which run side by side and are added afterwards.

One invocation that goes over a whole picture keeps the others waiting, and llvmpipe ends all loops of an invocation after 65,535 turns
and says nothing. How large boxes are is told by the values that the program starts with; a sum whose boxes are small is left as it is, to
the bit.
In: `Group`s without composite ops. Out: `Group`s.
"""
from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..graph.ir import Node, rebuild, remade, topological
from ..graph.optable import stored
from ..graph.program import Program
from ..graph.reference import evaluate
from .groups import Group

PIXELS = 20000  # of one loop: three turns for each of these are fewer than llvmpipe allows
GROWTH = 4  # times as many pixels as at the start are kept in mind
ENTRIES = 2_000_000  # of more boxes none is large, or to find out takes too long


def banded(groups: Sequence[Group], program: Program) -> tuple[Group, ...]:
    """With what can be (`Op.banded`) in bands wherever boxes are large."""
    roots = [n for group in groups for some in group.roots for n in some]
    sums = [n for n in topological(roots) if n.op.banded is not None]
    bands = {n: _bands(n, most) for n, most in zip(sums, _largest([n.inputs[2] for n in sums], program))}
    if all(count == 1 for count in bands.values()):
        return tuple(groups)

    def rewrite(node: Node, inputs: tuple[Node, ...]) -> Node:
        if bands.get(node, 1) == 1:
            return remade(node, stored(node.op, inputs))
        return node.op.banded(*inputs, bands=bands[node])

    new = rebuild(roots, rewrite)
    return tuple(replace(group, roots=tuple(tuple(new[n] for n in some) for some in group.roots)) for group in groups)


def _largest(boxes: Sequence[Node], program: Program) -> list[float]:
    """Of each table of boxes how many pixels the largest has at the start; infinite where no values tell."""
    start = {name: value for name, value in program.values.items() if value.initial is not None}
    known, found = [], dict.fromkeys(boxes, np.inf)
    for box in found:
        leaves = [n for n in topological([box]) if n.op.held]
        if box.extent.count <= ENTRIES and all(n.name in start for n in leaves):
            known.append(box)
    needed = {n.name for n in topological(known) if n.op.held}
    feed = {name: start[name].layout.to_image(start[name].initial, name) for name in needed}
    for box, value in zip(known, evaluate(known, feed)):
        found[box] = float(np.prod(np.maximum(value[..., 2:] - value[..., :2], 0), -1).max())
    return [found[box] for box in boxes]


def _bands(node: Node, pixels: float) -> int:
    """In how many bands: none has more pixels than a loop may, and all of them together are not more entries than there are pixels."""
    values, _, boxes, _ = node.inputs
    if pixels * GROWTH <= PIXELS:
        return 1
    wanted = math.ceil(min(pixels * GROWTH, values.extent.count) / PIXELS)
    return max(1, min(wanted, values.extent.count // boxes.extent.count))
