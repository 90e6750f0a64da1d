"""Reductions and their transposes. `sum` is one op to the AD; `lower` turns it into passes of `block_sum`."""
from __future__ import annotations

import numpy as np

from ...cache.errors import GraphError
from ..ir import UNIT, Extent, Node, image
from ..optable import Loop, apply, op

BLOCK = 32


def _valid(extent_or_shape, count=None):
    h, w = extent_or_shape
    return (np.arange(h * w) < (h * w if count is None else count)).reshape(h, w, 1)


op("sum", "a", infer=lambda name, inputs, attrs: (inputs[0].vtype, UNIT), stage="composite", reads="texel",
   ref=lambda a, count=None: np.where(_valid(a.shape[:2], count), a, 0).sum((0, 1), keepdims=True),
   vjp=lambda g, y, a, count=None: (g,), doc="Sum over the texels of an image, padding left out; 1 x 1.")


def total(a: Node) -> Node:
    """Sum over the image."""
    return a if a.extent == UNIT else apply("sum", a, count=a.extent.count)


def mean(a: Node) -> Node:
    """Mean over the image's texels."""
    return total(a) * (1.0 / a.extent.count)


def _blocks(name, inputs, attrs):
    e = inputs[0].extent
    return inputs[0].vtype, image(-(-e.width // attrs["bw"]), -(-e.height // attrs["bh"]))


def _block_ref(a, bw, bh, count):
    h, w, c = a.shape
    padded = np.zeros((-(-h // bh) * bh, -(-w // bw) * bw, c), a.dtype)
    padded[:h, :w] = np.where(_valid((h, w), count), a, 0)
    return padded.reshape(padded.shape[0] // bh, bh, -1, bw, c).sum((1, 3))


op("block_sum", "a", infer=_blocks, reads="texel", ref=_block_ref, cost=500,
   loop=Loop("for (int b_ = {p}.y * {bh}; b_ < min({p}.y * {bh} + {bh}, {a_h}); ++b_) "
             "for (int a_ = {p}.x * {bw}; a_ < min({p}.x * {bw} + {bw}, {a_w}); ++a_) "
             "if (b_ * {a_w} + a_ < {count}) {", "{y} += {a}(ivec2(a_, b_));"),
   sample=lambda rng: ([rng.normal(size=(7, 9, 3))], {"bw": 4, "bh": 3, "count": 60}),
   doc="Sum over blocks of bw x bh texels.")


def lower_sum(a: Node, count: int) -> Node:
    """The passes of a full sum: blocks of 32 x 32 until one texel is left."""
    while a.extent != UNIT:
        e = a.extent
        a = apply("block_sum", a, bw=min(BLOCK, e.width), bh=min(BLOCK, e.height), count=count)
        count = a.extent.count
    return a


def _broadcast_infer(name, inputs, attrs):
    if inputs[0].extent not in (UNIT, attrs["extent"]):
        raise GraphError(f"broadcast: {inputs[0]!r} to {attrs['extent']}; only 1x1 can be broadcast")
    return inputs[0].vtype, attrs["extent"]


op("broadcast", "a", infer=_broadcast_infer, cost=0, glsl="{y} = {a};",
   ref=lambda a, extent: np.broadcast_to(a, (extent.height, extent.width, a.shape[2])), vjp=lambda g, y, a, extent: (g,),
   sample=lambda rng: ([rng.normal(size=(1, 1, 3))], {"extent": Extent(5, 4, 20)}),
   doc="A 1 x 1 value at every texel.")


def _window_ref(a, dx, dy, cell_w, cell_h):
    h, w, _ = a.shape
    cells = a.reshape(h // cell_h, cell_h, w // cell_w, cell_w)
    out = np.zeros_like(cells)
    for oy in range(-dy, dy + 1):
        for ox in range(-dx, dx + 1):
            ys, yd = slice(max(oy, 0), cell_h + min(oy, 0)), slice(max(-oy, 0), cell_h + min(-oy, 0))
            xs, xd = slice(max(ox, 0), cell_w + min(ox, 0)), slice(max(-ox, 0), cell_w + min(-ox, 0))
            if ys.start < ys.stop and xs.start < xs.stop:
                out[:, yd, :, xd] |= cells[:, ys, :, xs]
    return out.reshape(a.shape)


op("window_or", "a", infer=lambda name, inputs, attrs: ("int", inputs[0].extent), reads="texel", ref=_window_ref, cost=30,
   glsl="""{ ivec2 c_ = {p} / ivec2({cell_w}, {cell_h}) * ivec2({cell_w}, {cell_h});
    ivec2 lo_ = max({p} - ivec2({dx}, {dy}), c_), hi_ = min({p} + ivec2({dx}, {dy}), c_ + ivec2({cell_w} - 1, {cell_h} - 1));
    {y} = 0;
    for (int b_ = lo_.y; b_ <= hi_.y; ++b_) for (int a_ = lo_.x; a_ <= hi_.x; ++a_) {y} |= {a}(ivec2(a_, b_)); }""",
   sample=lambda rng: ([(rng.random((12, 10, 1)) < 0.1).astype(np.int64) * 5], {"dx": 2, "dy": 1, "cell_w": 5, "cell_h": 6}),
   doc="Bitwise or over a window of 2 dx + 1 by 2 dy + 1 pixels that stays in the pixel's view: edge detection and dilation.")


op("hard_window", "code", infer=lambda name, inputs, attrs: ("int", inputs[0].extent), reads="texel", cost=30,
   ref=lambda code, **attrs: _window_ref(np.where((code[..., :1] >= 0) & (code[..., :1] & 1 == 1), 2, 1), **attrs),
   glsl=lambda node: """{ ivec2 c_ = {p} / ivec2({cell_w}, {cell_h}) * ivec2({cell_w}, {cell_h});
    ivec2 lo_ = max({p} - ivec2({dx}, {dy}), c_), hi_ = min({p} + ivec2({dx}, {dy}), c_ + ivec2({cell_w} - 1, {cell_h} - 1));
    {y} = 0;
    for (int b_ = lo_.y; b_ <= hi_.y; ++b_) for (int a_ = lo_.x; a_ <= hi_.x; ++a_) {
        int s_ = {code}(ivec2(a_, b_))CHANNEL; {y} |= s_ >= 0 && (s_ & 1) == 1 ? 2 : 1; } }""".replace(
       "CHANNEL", "" if node.inputs[0].channels == 1 else ".x"),
   sample=lambda rng: ([rng.integers(-1, 9, (12, 10, 1))], {"dx": 2, "dy": 1, "cell_w": 5, "cell_h": 6}),
   doc="window_or of the frontal stencil S^H of a raster code: bit 1 where a hard face is in the window, bit 0 where none is.")
