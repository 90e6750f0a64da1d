"""Leaves: literals, constant tables, inputs, state, and what a texel knows of its own place."""
from __future__ import annotations

import math

import numpy as np

from ....cache.errors import GraphError
from ....cache.layout import beyond_fp32
from ..ir import CHANNELS, UNIT, Data, Extent, is_int, vector_type
from ..optable import apply, op


def _leaf(name, inputs, attrs):
    return attrs["vtype"], attrs["extent"]


def _literal(name, inputs, attrs):
    value = attrs["value"]
    parts = value if isinstance(value, tuple) else (value,)
    if not parts or any(isinstance(x, bool) or not isinstance(x, int | float) or isinstance(x, int) != isinstance(parts[0], int)
                        for x in parts):
        raise GraphError(f"literal {value!r:.60}: whole numbers, or floats, are needed")
    if isinstance(parts[0], int):
        if not all(-2 ** 31 <= x < 2 ** 31 for x in parts):
            raise GraphError(f"literal {str(value):.60}: whole numbers from -2^31 to 2^31 - 1 are allowed")
    elif beyond_fp32(parts).any():
        raise GraphError(f"literal {value}: numbers that are finite in fp32 are allowed")
    return vector_type(len(parts), isinstance(parts[0], int)), UNIT


def literal_glsl(value: int | float | tuple) -> str:
    """A number or vector as GLSL, rounded to fp32."""
    if isinstance(value, tuple):
        return f"{vector_type(len(value), isinstance(value[0], int))}({', '.join(map(literal_glsl, value))})"
    if isinstance(value, int):
        return str(value) if value > -2 ** 31 else "(-2147483647 - 1)"
    return repr(float(np.float32(value)))


def _size(array) -> float:
    """log2 of the largest magnitude; minus infinity for zero."""
    largest = float(np.abs(array).max(initial=0))
    return math.log2(largest) if largest else -math.inf


op("literal", "", infer=_literal, stage="inline", cost=0, size=lambda node, sizes: _size(node.attrs["value"]),
   ref=lambda value: np.atleast_1d(np.array(value))[None, None],
   glsl=lambda node: f"{{y}} = {literal_glsl(node.attrs['value'])};", doc="A number, or a tuple of them as a vector.")


def _constant(name, inputs, attrs):
    data: Data = attrs["data"]
    if data.array.shape != (attrs["extent"].height, attrs["extent"].width, CHANNELS[attrs["vtype"]]):
        raise GraphError(f"constant of shape {data.array.shape} does not fit {attrs['vtype']} {attrs['extent']}")
    if not is_int(attrs["vtype"]) and beyond_fp32(data.array).any():
        raise GraphError("constant with NaN, Inf or numbers beyond the range of fp32; numbers that are finite in fp32 are allowed")
    return attrs["vtype"], attrs["extent"]


op("constant", "", attrs="data vtype extent", infer=_constant, stage="leaf", size=lambda node, sizes: _size(node.attrs["data"].array),
   ref=lambda data, **_: data.array,
   doc="Numbers known when the graph is built; they travel in the bundle.")
op("input", "", attrs="name vtype extent half?", infer=_leaf, stage="leaf", held=True, ref=None,
   doc="An image that the session sets by name.")
op("state", "", attrs="name vtype extent half?", infer=_leaf, stage="leaf", held=True, ref=None,
   doc="An image that lives on the device from step to step: parameters, moments, counters.")

op("texel_index", "", infer=lambda name, inputs, attrs: ("int", attrs["extent"]), cost=1,
   ref=lambda extent: np.arange(extent.width * extent.height).reshape(extent.height, extent.width, 1),
   glsl="{y} = {i};", doc="Row-major index of the own texel.")


def _cells(vtype):
    """The type given over an extent of whole cells."""
    def infer(name, inputs, attrs):
        e, w, h = attrs["extent"], attrs["cell_w"], attrs["cell_h"]
        if min(w, h) < 1 or e.width % w or e.height % h:
            raise GraphError(f"{name}: {e} is not made of whole cells of {w} x {h}")
        return vtype, e
    return infer


def _grid(extent: Extent) -> tuple[np.ndarray, np.ndarray]:
    return np.arange(extent.width)[None, :, None], np.arange(extent.height)[:, None, None]


def _cell_position(extent, cell_w, cell_h):
    x, y = _grid(extent)
    x, y = x % cell_w + 0.5 - cell_w / 2, y % cell_h + 0.5 - cell_h / 2
    return np.concatenate(np.broadcast_arrays(x, y), axis=2)


def _cell_index(extent, cell_w, cell_h):
    x, y = _grid(extent)
    return x // cell_w + (y // cell_h) * (extent.width // cell_w)


def _position_of(number, width, cell_w, cell_h):
    n = np.maximum(number, 0)
    return np.concatenate([n % width % cell_w + 0.5 - cell_w / 2, n // width % cell_h + 0.5 - cell_h / 2], 2)


op("cell_position_of", "number", infer=lambda name, inputs, attrs: ("vec2", inputs[0].extent), ref=_position_of, cost=6,
   size=lambda node, sizes: math.log2(max(node.attrs["cell_w"], node.attrs["cell_h"]) / 2),
   glsl="{ int n_ = max({number}, 0); {y} = vec2(ivec2(n_ % {width}, n_ / {width}) % ivec2({cell_w}, {cell_h}))"
        " + vec2(0.5 - 0.5 * float({cell_w}), 0.5 - 0.5 * float({cell_h})); }",
   sample=lambda rng: ([rng.integers(0, 60, (4, 5, 1))], {"width": 10, "cell_w": 5, "cell_h": 3}),
   doc="cell_position of the pixels with these numbers, row by row in an atlas `width` wide.")
op("cell_position", "", infer=_cells("vec2"), ref=_cell_position, cost=2,
   numbered=lambda node, numbers: apply("cell_position_of", numbers, width=node.extent.width, cell_w=node.attrs["cell_w"],
                                        cell_h=node.attrs["cell_h"]),
   size=lambda node, sizes: math.log2(max(node.attrs["cell_w"], node.attrs["cell_h"]) / 2),
   glsl="{y} = vec2({p} % ivec2({cell_w}, {cell_h})) + vec2(0.5 - 0.5 * float({cell_w}), 0.5 - 0.5 * float({cell_h}));",
   doc="Pixel centre relative to the centre of its view's cell of the atlas, in pixels.")
op("cell_index", "", infer=_cells("int"), ref=_cell_index, cost=2,
   glsl="{y} = {p}.x / {cell_w} + ({p}.y / {cell_h}) * ({w} / {cell_w});",
   doc="View of the own pixel in an atlas.")
op("cached", "", attrs="name vtype extent half?", infer=_leaf, stage="leaf", ref=None,
   doc="A value that another plan has left on the device (reactive cache).")
