"""What is known of a plan's values where one of them is zero: at the same texel, or in the tile that it marks.

In: nodes in order. Out: for a node that is zero the constants that follow, by facts of the op table alone: `Op.when` and `Op.chooses` carry
zeros through, everything else must have constant inputs to be constant.
"""
from __future__ import annotations

import heapq
from collections.abc import Mapping, Sequence

import numpy as np

from ..graph.ir import Extent, Node, is_int
from ..graph.optable import EMPTY, NEGATIVE, ZERO

_IS = {ZERO: lambda x: (x == 0).all(), NEGATIVE: lambda x: (x < 0).all(), EMPTY: lambda x: x[0] >= x[1]}


def constant_value(node: Node, known: Mapping[Node, np.ndarray]) -> np.ndarray | None:
    """The constant value (channels,) of a node given constant inputs, or None."""
    inputs = [x.op.ref(**x.attrs)[0, 0] if x.op.stage == "inline" else known.get(x) for x in node.inputs]
    channels = np.zeros(node.channels, np.int64 if is_int(node.vtype) else np.float64)
    for when in node.op.when:
        if inputs[when.input] is not None and _IS[when.what](inputs[when.input]):
            return channels + when.result
    if node.op.chooses:
        by, *options = inputs
        if by is not None and by.size == 1:
            taken = options[0] if by[0] else options[1]
            return None if taken is None else channels + taken
        if all(x is not None for x in options) and np.array_equal(*np.broadcast_arrays(*options)):
            return channels + options[0]
    if node.op.stage != "pixel" or node.op.loop or not inputs or any(x is None for x in inputs) or "texel" in node.op.reads:
        return None
    value = np.asarray(node.op.ref(*(x[None, None] for x in inputs), **node.attrs))[0, 0]
    return channels + value if np.isfinite(value).all() else None


def number(node: Node, value: np.ndarray | None) -> int | None:
    """What an attachment can be cleared to where a node has this value: 0, or -1 for integers; else None."""
    if value is None:
        return None
    return 0 if (value == 0).all() else -1 if is_int(node.vtype) and (value == -1).all() else None


class Known:
    """order: the nodes of a plan, inputs first."""

    def __init__(self, order: Sequence[Node]):
        self.order, self.at = order, {n: k for k, n in enumerate(order)}
        self._users: dict[Node, list[int]] = {}
        for k, n in enumerate(order):
            for x in n.inputs:
                self._users.setdefault(x, []).append(k)
        self._found: dict[tuple[Node, Extent], dict[Node, np.ndarray]] = {}

    def where_zero(self, by: Node, extent: Extent) -> Mapping[Node, np.ndarray]:
        """The constant values (channels,) of nodes of this extent at the texels where `by` is zero; itself among them."""
        if (by, extent) not in self._found:
            known = {by: np.zeros(1, np.int64)}
            waiting = list(self._users.get(by, ()))
            heapq.heapify(waiting)
            last = -1
            while waiting:
                k = heapq.heappop(waiting)
                n = self.order[k]
                if k == last or n.extent != extent or n in known:
                    continue
                last = k
                value = constant_value(n, known)
                if value is not None:
                    known[n] = value
                    for user in self._users.get(n, ()):
                        heapq.heappush(waiting, user)
            self._found[by, extent] = known
        return self._found[by, extent]
