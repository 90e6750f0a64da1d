"""Tables put together, cut and laid out anew: concat, slice, pad (of `join.py`, in one row), and reshape.

Entries are counted row by row, so an image is the table of its texels, and a 1 x 1 value a table of one entry.
"""
from __future__ import annotations

import numpy as np

from ....cache.errors import GraphError
from ..ir import Extent, Node, image, table
from ..optable import apply, as_node, op
from .join import join, portion


def _reshape_infer(name, inputs, attrs):
    if inputs[0].extent.count != attrs["extent"].count:
        raise GraphError(f"{name}: {inputs[0]!r} has {inputs[0].extent.count} entries, {attrs['extent']} has {attrs['extent'].count}; "
                         "equal numbers are needed")
    return inputs[0].vtype, attrs["extent"]


def _reshape_ref(x, extent):
    out = np.zeros((extent.width * extent.height, x.shape[2]), x.dtype)
    out[:extent.count] = x.reshape(-1, x.shape[2])[:extent.count]
    return out.reshape(extent.height, extent.width, -1)


op("reshape", "x", infer=_reshape_infer, reads="texel", cost=2, ref=_reshape_ref,
   glsl="{y} = {i} < {n} ? {x_at}({i}) : {type}(0);",
   vjp=lambda g, y, x, extent: (reshape(g, x.extent),),
   sample=lambda rng: ([rng.normal(size=(5, 3, 3))], {"extent": table(15)}),
   doc="The same entries, row by row, in another extent.")


def reshape(x: Node, extent: Extent) -> Node:
    """The same entries, row by row, in another extent of as many."""
    x = as_node(x)
    if not isinstance(extent, Extent):
        raise GraphError(f"reshape: an extent is needed, got {type(extent).__name__}; to_image() and to_table() make them")
    return x if x.extent == extent else apply("reshape", x, extent=extent)


def to_image(x: Node, width: int, height: int) -> Node:
    """An image of the entries of a table, row by row."""
    return reshape(x, image(_whole("to_image", "width", width, 1), _whole("to_image", "height", height, 1)))


def to_table(x: Node) -> Node:
    """The table of an image's texels, row by row."""
    x = as_node(x)
    return reshape(x, table(x.extent.count))


def concat(*parts: Node) -> Node:
    """The entries of all these tables, one after the other, as one table. The gradient of each part is its slice. Raises GraphError
    where types differ."""
    if not parts:
        raise GraphError("concat: no tables are given; at least one is needed")
    if any(not isinstance(x, Node) for x in parts):
        raise GraphError(f"concat: nodes are needed, got {', '.join(type(x).__name__ for x in parts):.200}; wrap arrays with "
                         "constant_table()")
    left = [to_table(x) for x in parts]
    while len(left) > 1:
        left = [join(*left[k:k + 2]) if k + 1 < len(left) else left[k] for k in range(0, len(left), 2)]
    return left[0]


def _whole(name: str, key: str, value, least: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise GraphError(f"{name}: {key} is {value!r:.40}; a whole number from {least} on is needed")
    return int(value)


def slice_table(x: Node, start: int, count: int) -> Node:
    """Entries start to start + count - 1, as a table of `count`; gradient zero for the others. Raises GraphError beyond the end."""
    x, start, count = as_node(x), _whole("slice_table", "start", start, 0), _whole("slice_table", "count", count, 1)
    if start + count > x.extent.count:
        raise GraphError(f"slice_table: entries {start} to {start + count - 1} of {x!r}, which has {x.extent.count}")
    return portion(to_table(x), start, count)


def pad(x: Node, start: int, count: int) -> Node:
    """A table of `count` entries: x's from entry `start` on, zeros before and after. Raises GraphError where they do not fit."""
    x, start = as_node(x), _whole("pad", "start", start, 0)
    count = _whole("pad", "count", count, start + x.extent.count)
    return apply("padded", to_table(x), rows=1, start=start, count=x.extent.count, stride=count)
