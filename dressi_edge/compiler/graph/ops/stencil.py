"""Neighbours within a cell: shift, convolution, halving and doubling, each with its exact transpose.

An image is cut in cells of `cell_w` x `cell_h` texels, the views of an atlas; nothing reads across their borders. What lies outside a
cell is its nearest texel (edge "clamp") or zero (edge "zero").
"""
from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ....cache.errors import GraphError
from ..ir import Node, image
from ..optable import apply, op
from .leaf import literal_glsl

EDGES = ("clamp", "zero")
MAX_TAPS = 129


def _cells(name, inputs, attrs):
    """The input's extent, cut in whole cells."""
    x, w, h = inputs[0], attrs["cell_w"], attrs["cell_h"]
    if any(isinstance(n, bool) or not isinstance(n, int) or n < 1 for n in (w, h)):
        raise GraphError(f"{name}: cells of {w!r} x {h!r}; whole numbers from 1 on are needed")
    e = x.extent
    if e.width % w or e.height % h or e.count != e.width * e.height:
        raise GraphError(f"{name}: {x!r} is not made of whole cells of {w} x {h}")
    return e


def _checked(name, inputs, attrs):
    if attrs.get("edge", "zero") not in EDGES:
        raise GraphError(f"{name}: edge {attrs['edge']!r:.40}; {' or '.join(EDGES)} is allowed")
    return inputs[0].vtype, _cells(name, inputs, attrs)


def _cut(x: np.ndarray, cell_w: int, cell_h: int) -> np.ndarray:
    """(rows, cell_h, columns, cell_w, channels)."""
    h, w, c = x.shape
    return x.reshape(h // cell_h, cell_h, w // cell_w, cell_w, c)


def _sources(size: int, by: int, edge: str) -> np.ndarray:
    """Of each texel along an axis the one that shifts onto it; -1 for none."""
    at = np.arange(size) - by
    return np.clip(at, 0, size - 1) if edge == "clamp" else np.where((at >= 0) & (at < size), at, -1)


def _matrix(size: int, taps: Sequence[float], edge: str) -> np.ndarray:
    """The convolution along an axis of `size` texels as a matrix."""
    out, reach = np.zeros((size, size)), len(taps) // 2
    for k, tap in enumerate(taps):
        at = _sources(size, k - reach, edge)
        np.add.at(out, (np.flatnonzero(at >= 0), at[at >= 0]), tap)
    return out


def _along(x: np.ndarray, axis: int, matrix: np.ndarray, cell_w: int, cell_h: int) -> np.ndarray:
    return np.einsum("ij,rjaxc->riaxc" if axis else "ij,rhajc->rhaic", matrix, _cut(x, cell_w, cell_h)).reshape(x.shape)


def _cell_of(x: Node, cell: tuple[int, int] | None) -> dict:
    if cell is None:
        cell = x.extent.width, x.extent.height
    if not isinstance(cell, tuple | list) or len(cell) != 2:
        raise GraphError(f"cells of {cell!r:.60}; width and height are needed")
    w, h = cell
    return {"cell_w": w, "cell_h": h}


def _node(name: str, x) -> Node:
    if not isinstance(x, Node):
        raise GraphError(f"{name}: an image is needed, got {type(x).__name__}; wrap arrays with constant()")
    return x


# Of the own texel p: its cell's first texel c_ and p relative to it; the cell's size z_.
_OWN = "ivec2 z_ = ivec2({cell_w}, {cell_h}), c_ = {p} / z_ * z_, q_ = {p} - c_;"
# Texels of an axis that read the own one when the image moves by d_: the one, and those beyond an end, held at it.
_READERS = """ivec2 f_ = max(ivec2(q_.x == 0 ? 0 : q_.x + {dx}, q_.y == 0 ? 0 : q_.y + {dy}), ivec2(0));
    ivec2 l_ = min(ivec2(q_.x == z_.x - 1 ? q_.x : q_.x + {dx}, q_.y == z_.y - 1 ? q_.y : q_.y + {dy}), z_ - 1);"""


# ---- shift

def _shift_ref(x, dx, dy, edge, cell_w, cell_h):
    cells = _cut(x, cell_w, cell_h)
    ys, xs = _sources(cell_h, dy, edge), _sources(cell_w, dx, edge)
    out = cells[:, np.maximum(ys, 0)][:, :, :, np.maximum(xs, 0)]
    return np.where((ys >= 0)[:, None, None, None] & (xs >= 0)[:, None], out, 0).reshape(x.shape)


def _shift_glsl(node: Node) -> str:
    inside = "" if node.attrs["edge"] == "clamp" else "if (s_ != clamp(s_, ivec2(0), z_ - 1)) {y} = {type}(0);"
    return "{ " + _OWN + " ivec2 s_ = q_ - ivec2({dx}, {dy}); {y} = {x}(c_ + clamp(s_, ivec2(0), z_ - 1)); " + inside + " }"


def _shift_vjp(g, y, x, dx, dy, edge, cell_w, cell_h):
    if edge == "zero":
        return (apply("shift", g, dx=-dx, dy=-dy, edge=edge, cell_w=cell_w, cell_h=cell_h),)
    return (apply("shift_transposed", g, dx=dx, dy=dy, cell_w=cell_w, cell_h=cell_h),)


def _shift_transposed_ref(x, dx, dy, cell_w, cell_h):
    def spread(size, by):
        matrix = np.zeros((size, size))
        matrix[_sources(size, by, "clamp"), np.arange(size)] = 1
        return matrix

    return _along(_along(x, 0, spread(cell_w, dx), cell_w, cell_h), 1, spread(cell_h, dy), cell_w, cell_h)


op("shift", "x", infer=_checked, reads="texel", cost=8, ref=_shift_ref, glsl=_shift_glsl, vjp=_shift_vjp,
   sample=lambda rng: ([rng.normal(size=(8, 10, 3))], {"dx": 2, "dy": -1, "edge": "clamp", "cell_w": 5, "cell_h": 4}),
   doc="Every cell moved by dx texels to the right and dy down.")
op("shift_transposed", "x", infer=_checked, reads="texel", cost=16, ref=_shift_transposed_ref,
   glsl="{ " + _OWN + _READERS + """
    {y} = {type}(0);
    for (int b_ = f_.y; b_ <= l_.y; ++b_) for (int a_ = f_.x; a_ <= l_.x; ++a_) {y} += {x}(c_ + ivec2(a_, b_)); }""",
   vjp=lambda g, y, x, **attrs: (apply("shift", g, edge="clamp", **attrs),),
   sample=lambda rng: ([rng.normal(size=(8, 10, 3))], {"dx": -2, "dy": 3, "cell_w": 5, "cell_h": 4}),
   doc="Transpose of shift with edge clamp: a border texel gets the sum of all that it was copied to.")


def shift(x: Node, dx: int, dy: int, edge: str = "clamp", cell: tuple[int, int] | None = None) -> Node:
    """The image moved by dx texels to the right and dy down: y at (i, j) is x at (i - dx, j - dy), beyond an edge the nearest texel
    ("clamp") or zero ("zero"). cell: (width, height) of the views of an atlas, each moved on its own; None: the whole image."""
    for key, by in (("dx", dx), ("dy", dy)):
        if isinstance(by, bool) or not isinstance(by, int | np.integer) or abs(by) > 1 << 14:
            raise GraphError(f"shift: {key} is {by!r:.40}; a whole number of at most {1 << 14} texels is needed")
    return apply("shift", _node("shift", x), dx=int(dx), dy=int(dy), edge=edge, **_cell_of(x, cell))


# ---- convolution along one axis

def _taps(node: Node) -> str:
    taps = node.attrs["taps"]
    return f"float w_[{len(taps)}] = float[]({', '.join(map(literal_glsl, taps))});"


def _convolve_infer(name, inputs, attrs):
    taps = attrs["taps"]
    if len(taps) % 2 == 0 or len(taps) > MAX_TAPS:
        raise GraphError(f"{name}: a kernel of {len(taps)} numbers; an odd number up to {MAX_TAPS} is allowed")
    return _checked(name, inputs, attrs)


def _convolve_glsl(node: Node) -> str:
    reach, along = len(node.attrs["taps"]) // 2, "ivec2(0, d_)" if node.attrs["axis"] else "ivec2(d_, 0)"
    inside = "" if node.attrs["edge"] == "clamp" else "if (s_ == clamp(s_, ivec2(0), z_ - 1)) "
    return "{ " + _OWN + _taps(node) + f""" {{y}} = {{type}}(0);
    for (int d_ = -{reach}; d_ <= {reach}; ++d_) {{
    ivec2 s_ = q_ - {along}; {inside}{{y}} += w_[d_ + {reach}] * {{x}}(c_ + clamp(s_, ivec2(0), z_ - 1)); }} }}"""


def _convolve_vjp(g, y, x, axis, taps, edge, cell_w, cell_h):
    if edge == "zero":
        return (apply("convolve", g, axis=axis, taps=taps[::-1], edge=edge, cell_w=cell_w, cell_h=cell_h),)
    return (apply("convolve_transposed", g, axis=axis, taps=taps, cell_w=cell_w, cell_h=cell_h),)


def _convolve_transposed_glsl(node: Node) -> str:
    reach, axis = len(node.attrs["taps"]) // 2, "xy"[node.attrs["axis"]]
    at = "ivec2(q_.x, a_)" if node.attrs["axis"] else "ivec2(a_, q_.y)"
    own, end = f"q_.{axis}", f"z_.{axis} - 1"
    return "{ " + _OWN + _taps(node) + f""" {{y}} = {{type}}(0);
    for (int d_ = -{reach}; d_ <= {reach}; ++d_) {{
    int f_ = {own} == 0 ? 0 : max({own} + d_, 0), l_ = {own} == {end} ? {own} : min({own} + d_, {end});
    for (int a_ = f_; a_ <= l_; ++a_) {{y}} += w_[d_ + {reach}] * {{x}}(c_ + {at}); }} }}"""


op("convolve", "x", infer=_convolve_infer, reads="texel", cost=100, glsl=_convolve_glsl, vjp=_convolve_vjp,
   ref=lambda x, axis, taps, edge, cell_w, cell_h: _along(x, axis, _matrix((cell_w, cell_h)[axis], taps, edge), cell_w, cell_h),
   sample=lambda rng: ([rng.normal(size=(8, 10, 3))],
                       {"axis": 1, "taps": (0.5, -1.0, 2.0, 0.25, 1.5), "edge": "clamp", "cell_w": 5, "cell_h": 4}),
   doc="Convolution of each cell along one axis (0: across, 1: down) with an odd number of constants.")
op("convolve_transposed", "x", infer=_convolve_infer, reads="texel", cost=150, glsl=_convolve_transposed_glsl,
   ref=lambda x, axis, taps, cell_w, cell_h: _along(x, axis, _matrix((cell_w, cell_h)[axis], taps, "clamp").T, cell_w, cell_h),
   vjp=lambda g, y, x, **attrs: (apply("convolve", g, edge="clamp", **attrs),),
   sample=lambda rng: ([rng.normal(size=(8, 10, 3))], {"axis": 0, "taps": (0.5, -1.0, 2.0, 0.25, 1.5), "cell_w": 5, "cell_h": 4}),
   doc="Transpose of convolve with edge clamp.")


def convolve(x: Node, kernel, edge: str = "clamp", cell: tuple[int, int] | None = None) -> Node:
    """Separable convolution with constants: `kernel` is an odd number of weights for both axes, or a pair of such (across, down). As
    in np.convolve, weight k moves the image by k - middle. Edges and cells as in `shift`; two passes, no texture."""
    pair = kernel if isinstance(kernel, tuple | list) and len(kernel) == 2 and all(np.ndim(k) == 1 for k in kernel) else (kernel, kernel)
    for axis, taps in enumerate(pair):
        try:
            taps = np.asarray(taps, np.float64)
        except (TypeError, ValueError):
            raise GraphError("convolve: a kernel that is not made of numbers") from None
        if taps.ndim != 1 or not np.isfinite(taps).all():
            raise GraphError(f"convolve: a kernel of shape {taps.shape}; finite numbers (n,), n odd, are needed")
        x = apply("convolve", _node("convolve", x), axis=axis, taps=tuple(map(float, taps)), edge=edge, **_cell_of(x, cell))
    return x


# ---- halves

def _half(n: int) -> int:
    return -(-n // 2)


def _pool_infer(name, inputs, attrs):
    e = _cells(name, inputs, attrs)
    w, h = attrs["cell_w"], attrs["cell_h"]
    return inputs[0].vtype, image(e.width // w * _half(w), e.height // h * _half(h))


def _blocks(cell_w, cell_h):
    """How many texels of a cell each texel of its half stands for, (h / 2, 1, w / 2)."""
    ys, xs = (np.minimum(2, n - 2 * np.arange(_half(n))) for n in (cell_h, cell_w))
    return (ys[:, None] * xs)[:, None, :, None]


def _pool_ref(x, mean, cell_w, cell_h):
    cells = _cut(x, cell_w, cell_h)
    padded = np.pad(cells, ((0, 0), (0, cell_h % 2), (0, 0), (0, cell_w % 2), (0, 0)))
    r, h, a, w, c = padded.shape
    out = padded.reshape(r, h // 2, 2, a, w // 2, 2, c).sum((2, 5)) / (_blocks(cell_w, cell_h) if mean else 1)
    return out.reshape(r * h // 2, a * w // 2, c)


def _unpool_infer(name, inputs, attrs):
    w, h = attrs["cell_w"], attrs["cell_h"]
    if any(isinstance(n, bool) or not isinstance(n, int) or n < 1 for n in (w, h)):
        raise GraphError(f"{name}: cells of {w!r} x {h!r}; whole numbers from 1 on are needed")
    e = _cells(name, inputs, {"cell_w": _half(w), "cell_h": _half(h)})
    return inputs[0].vtype, image(e.width // _half(w) * w, e.height // _half(h) * h)


def _unpool_ref(x, mean, cell_w, cell_h):
    cells = _cut(x, _half(cell_w), _half(cell_h)) / (_blocks(cell_w, cell_h) if mean else 1)
    out = cells.repeat(2, 1).repeat(2, 3)[:, :cell_h, :, :cell_w]
    return out.reshape(out.shape[0] * cell_h, -1, x.shape[2])


_POOL = """{ ivec2 z_ = ivec2({cell_w}, {cell_h}), h_ = (z_ + 1) / 2, v_ = {p} / h_, f_ = ({p} - v_ * h_) * 2, l_ = min(f_ + 2, z_);
    {y} = {type}(0);
    for (int b_ = f_.y; b_ < l_.y; ++b_) for (int a_ = f_.x; a_ < l_.x; ++a_) {y} += {x}(v_ * z_ + ivec2(a_, b_));
    if ({mean} != 0) {y} /= {type}((l_.x - f_.x) * (l_.y - f_.y)); }"""
_UNPOOL = """{ ivec2 z_ = ivec2({cell_w}, {cell_h}), v_ = {p} / z_, f_ = ({p} - v_ * z_) / 2, l_ = min(ivec2(2), z_ - f_ * 2);
    {y} = {x}(v_ * ((z_ + 1) / 2) + f_);
    if ({mean} != 0) {y} /= {type}(l_.x * l_.y); }"""
op("pool", "x", infer=_pool_infer, reads="texel", cost=20, ref=_pool_ref, glsl=_POOL,
   vjp=lambda g, y, x, **attrs: (apply("unpool", g, **attrs),),
   sample=lambda rng: ([rng.normal(size=(8, 10, 3))], {"mean": 1, "cell_w": 5, "cell_h": 4}),
   doc="Sum, or mean, of 2 x 2 texels in each cell; at the far ends of odd cells of those that are there.")
op("unpool", "x", infer=_unpool_infer, reads="texel", cost=12, ref=_unpool_ref, glsl=_UNPOOL,
   vjp=lambda g, y, x, **attrs: (apply("pool", g, **attrs),),
   sample=lambda rng: ([rng.normal(size=(4, 6, 3))], {"mean": 1, "cell_w": 5, "cell_h": 4}),
   doc="Transpose of pool: for each texel the value of the one that stands for it, divided by how many it stands for where `mean`.")


def downsample(x: Node, cell: tuple[int, int] | None = None) -> Node:
    """The mean of 2 x 2 texels: a cell of w x h becomes one of ceil(w / 2) x ceil(h / 2); at odd ends the mean is of those there are."""
    return apply("pool", _node("downsample", x), mean=1, **_cell_of(x, cell))


def upsample(x: Node, cell: tuple[int, int]) -> Node:
    """Each texel of `cell` = (width, height) gets the value of that of its half: what `downsample` halves, as large as before."""
    if cell is None:
        raise GraphError("upsample: the cell, (width, height) of what was halved, is needed: a half does not say whether it was odd")
    return apply("unpool", _node("upsample", x), mean=0, **_cell_of(x, cell))
