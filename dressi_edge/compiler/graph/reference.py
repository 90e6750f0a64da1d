"""Run any graph in NumPy float64: the oracle of every test, and `run --device reference`."""
from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from ...cache.errors import GraphError
from .ir import CHANNELS, Node, is_int, topological


def evaluate(roots: Iterable[Node], feed: Mapping[str, np.ndarray] | None = None) -> list[np.ndarray]:
    """Values of the roots, each (height, width, channels) float64 or int64. `feed` gives inputs and states by name.

    Raises GraphError for a leaf that is missing or of another shape.
    """
    roots, feed = list(roots), feed or {}
    values: dict[Node, np.ndarray] = {}
    for node in topological(roots):
        if node.op.name in ("input", "state"):
            values[node] = _leaf(node, feed)
            continue
        with np.errstate(over="ignore", under="ignore"):
            value = node.op.ref(*(values[x] for x in node.inputs), **node.attrs) if node.op.name != "constant" else node.op.ref(
                data=node.attrs["data"])
        shape = (node.extent.height, node.extent.width, CHANNELS[node.vtype])
        values[node] = np.broadcast_to(np.asarray(value, np.int64 if is_int(node.vtype) else np.float64), shape)
    return [values[root] for root in roots]


def _leaf(node: Node, feed: Mapping[str, np.ndarray]) -> np.ndarray:
    name = node.attrs["name"]
    shape = (node.extent.height, node.extent.width, CHANNELS[node.vtype])
    if name not in feed:
        raise GraphError(f"no value for {node.op.name} {name}: {node!r}")
    value = np.asarray(feed[name], np.int64 if is_int(node.vtype) else np.float64)
    if value.shape != shape:
        raise GraphError(f"{name} has shape {value.shape}; {shape} is needed")
    return value
