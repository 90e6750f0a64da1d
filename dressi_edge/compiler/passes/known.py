"""What is known of a plan's values where one of them is zero: at the same texel, or in the tile that it marks.

In: nodes in order. Out: for a node that is zero the constants that follow, by facts of the op table alone: `Op.when` and `Op.chooses` carry
zeros through, everything else must have constant inputs to be constant.
"""
from __future__ import annotations

import heapq
from collections.abc import Mapping, Sequence

import numpy as np

from ..graph.ir import Extent, Node, is_int
from .constants import constant_value


def number(node: Node, value: np.ndarray | None) -> int | None:
    """What an attachment can be cleared to where a node has this value: 0, or -1 for integers; else None."""
    if value is None:
        return None
    return 0 if not value.any() else -1 if is_int(node.vtype) and (value == -1).all() else None


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
