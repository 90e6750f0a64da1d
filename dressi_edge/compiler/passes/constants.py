"""What a node is where some of its inputs are known constants, from facts of the op table alone (`Op.when`, `Op.chooses`)."""
from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..graph.ir import Node, is_int
from ..graph.optable import EMPTY, NEGATIVE, ZERO

_IS = {ZERO: lambda x: (x == 0).all(), NEGATIVE: lambda x: (x < 0).all(), EMPTY: lambda x: x[0] >= x[1]}


def constant_value(node: Node, known: Mapping[Node, np.ndarray]) -> np.ndarray | None:
    """The constant value (channels,) of a node given constant inputs, or None."""
    if not (node.op.when or node.op.chooses) and any(x not in known and x.op.stage != "inline" for x in node.inputs):
        return None
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
