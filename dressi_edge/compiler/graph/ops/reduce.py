"""Reductions and their transposes. `sum` is one op to the AD; `lower` turns it into passes of `block_sum`."""
from __future__ import annotations

from math import log2

import numpy as np

from ....cache.errors import GraphError
from ..ir import UNIT, Extent, Node, image
from ..optable import Loop, apply, as_node, at, flag, op, zero

BLOCK = 32


def _valid(extent_or_shape, count=None):
    h, w = extent_or_shape
    return (np.arange(h * w) < (h * w if count is None else count)).reshape(h, w, 1)


op("sum", "a", infer=lambda name, inputs, attrs: (inputs[0].vtype, UNIT), stage="composite", reads="texel",
   size=lambda node, sizes: sizes[0] + log2(node.inputs[0].extent.count),
   ref=lambda a, count=None: np.where(_valid(a.shape[:2], count), a, 0).sum((0, 1), keepdims=True),
   vjp=lambda g, y, a, count=None: (g,), doc="Sum over the texels of an image, padding left out; 1 x 1.")


def total(a: Node) -> Node:
    """Sum over the image."""
    a = as_node(a)
    return a if a.extent == UNIT else apply("sum", a, count=a.extent.count)


def mean(a: Node) -> Node:
    """Mean over the image's texels."""
    a = as_node(a)
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
   size=lambda node, sizes: sizes[0] + log2(node.attrs["bw"] * node.attrs["bh"]),
   loop=Loop("for (int b_ = {p}.y * {bh}; b_ < min({p}.y * {bh} + {bh}, {a_h}); ++b_) "
             "for (int a_ = {p}.x * {bw}; a_ < min({p}.x * {bw} + {bw}, {a_w}); ++a_) "
             "if (b_ * {a_w} + a_ < {count}) {", "{y} += {a}(ivec2(a_, b_));"),
   sample=lambda rng: ([rng.normal(size=(7, 9, 3))], {"bw": 4, "bh": 3, "count": 60}),
   doc="Sum over blocks of bw x bh texels.")


LEAST = float(np.finfo(np.float32).min)


def _block_max_ref(a, bw, bh, count):
    h, w, c = a.shape
    padded = np.full((-(-h // bh) * bh, -(-w // bw) * bw, c), LEAST)
    padded[:h, :w] = np.where(_valid((h, w), count), a, LEAST)
    return padded.reshape(padded.shape[0] // bh, bh, -1, bw, c).max((1, 3))


op("block_max", "a", infer=_blocks, reads="texel", ref=_block_max_ref, cost=500,
   glsl="{ {y} = {type}(" + repr(LEAST) + """);
    ivec2 f_ = {p} * ivec2({bw}, {bh}), l_ = min(f_ + ivec2({bw}, {bh}), ivec2({a_w}, {a_h}));
    for (int b_ = f_.y; b_ < l_.y; ++b_) for (int a_ = f_.x; a_ < l_.x; ++a_)
    if (b_ * {a_w} + a_ < {count}) {y} = max({y}, {a}(ivec2(a_, b_))); }""",
   sample=lambda rng: ([rng.normal(size=(7, 9, 3))], {"bw": 4, "bh": 3, "count": 60}),
   doc="The largest of blocks of bw x bh texels, each channel for itself; no gradient.")


def largest(a: Node) -> Node:
    """Of each channel the largest number of an image's texels, padding left out; of extent 1x1, without gradient."""
    a = as_node(a)
    count = a.extent.count
    while a.extent != UNIT:
        e = a.extent
        a = apply("block_max", a, bw=min(BLOCK, e.width), bh=min(BLOCK, e.height), count=count)
        count = a.extent.count
    return a


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


TILE = 16  # pixels a side of a tile of the atlas


def tiles_of(extent: Extent, width: int = TILE, height: int = TILE) -> Extent:
    """The extent of an image with one texel a tile."""
    return image(-(-extent.width // width), -(-extent.height // height))


def spread(tiles: np.ndarray, width: int, height: int, tile: tuple[int, int]) -> np.ndarray:
    """Tiles (th, tw, 1) at every texel of a width x height image."""
    return tiles.repeat(tile[1], 0).repeat(tile[0], 1)[:height, :width]


def _bits(front: np.ndarray, steps: bool) -> np.ndarray:
    """2 where a pixel is covered, 1 where it is not; with `steps` 3 where it is an edge by itself, which is -2."""
    return np.where(front >= 0, 2, np.where(front == -1, 1, 3) if steps else 1)


def _with_bits(glsl: str):
    return lambda node: glsl.replace("BITS", "{front}(ivec2(a_, b_)) >= 0 ? 2 : " + (
        "({front}(ivec2(a_, b_)) == -1 ? 1 : 3)" if node.attrs.get("steps") else "1"))


def _edge_tiles_ref(front, reach, tile, steps=False):
    bits = _bits(front, steps)[..., 0]
    h, w = bits.shape
    out = [[np.bitwise_or.reduce(bits[max(y - reach, 0):y + tile[1] + reach, max(x - reach, 0):x + tile[0] + reach], axis=None) == 3
            for x in range(0, w, tile[0])] for y in range(0, h, tile[1])]
    return np.array(out, np.int64)[..., None]


op("edge_tiles", "front", infer=lambda name, inputs, attrs: ("int", tiles_of(inputs[0].extent, *attrs["tile"])), reads="texel",
   ref=_edge_tiles_ref, cost=400, attrs="reach tile steps?",
   glsl=_with_bits("""{ ivec2 size_ = ivec2{tile}, lo_ = max({p} * size_ - {reach}, ivec2(0));
    ivec2 hi_ = min({p} * size_ + size_ + {reach}, ivec2({front_w}, {front_h}));
    int near_ = 0;
    for (int b_ = lo_.y; b_ < hi_.y; ++b_) for (int a_ = lo_.x; a_ < hi_.x; ++a_) near_ |= BITS;
    {y} = near_ == 3 ? 1 : 0; }"""),
   sample=lambda rng: ([np.where(np.add.outer(np.arange(20), np.arange(35)) > 30, 3, -1)[..., None]], {"reach": 2, "tile": (16, 8)}),
   doc="1 for tiles that have covered and other pixels within `reach` pixels: only those can hold pixels of the edge mask.")


def _meets_ref(box, tiles, tile):
    out = np.zeros((len(box.reshape(-1, 4)), 1), np.int64)
    for i, (x0, y0, x1, y1) in enumerate(box.reshape(-1, 4)):
        if x0 < x1 and y0 < y1:
            out[i] = tiles[y0 // tile[1]:-(-y1 // tile[1]), x0 // tile[0]:-(-x1 // tile[0])].any()
    return out.reshape(*box.shape[:2], 1)


op("meets_tiles", "box tiles", infer=at(0, vtype="int"), reads="own texel", ref=_meets_ref, cost=60,
   glsl="""{y} = 0;
{ ivec2 size_ = ivec2{tile};
  for (int d_ = {box}.y / size_.y; d_ * size_.y < {box}.w && d_ < {tiles_h}; ++d_)
  for (int c_ = {box}.x / size_.x; c_ * size_.x < {box}.z && c_ < {tiles_w} && {y} == 0; ++c_) {y} = {tiles}(ivec2(c_, d_)); }""",
   sample=lambda rng: ([np.array([(0, 0, 0, 0), (1, 1, 9, 4), (30, 8, 33, 16), (0, 0, 35, 20)])[None], np.eye(3, dtype=int)[..., None]],
                       {"tile": (16, 8)}),
   doc="1 for boxes, half open, with pixels in a marked tile.")

_WINDOW = "dx dy cell_w cell_h tile"


def _window_infer(name, inputs, attrs):
    e, w, h = inputs[0].extent, attrs["cell_w"], attrs["cell_h"]
    if min(w, h) < 1 or e.width % w or e.height % h:
        raise GraphError(f"{name}: {inputs[0]!r} is not made of whole cells of {w} x {h}")
    return "int", e


_BOUNDS = """ivec2 c_ = {p} / ivec2({cell_w}, {cell_h}) * ivec2({cell_w}, {cell_h});
    ivec2 lo_ = max({p} - ivec2({dx}, {dy}), c_), hi_ = min({p} + ivec2({dx}, {dy}), c_ + ivec2({cell_w} - 1, {cell_h} - 1));"""


def _covered_window_ref(front, tiles, tile, steps=False, **attrs):
    return _window_ref(_bits(front, steps), **attrs) * spread(tiles, front.shape[1], front.shape[0], tile)


def _edge_mask_ref(across, tiles, tile, **attrs):
    return ((_window_ref(across, **attrs) == 3) & (spread(tiles, across.shape[1], across.shape[0], tile) != 0)).astype(np.int64)


op("covered_window", "front tiles", attrs=_WINDOW + " steps?", infer=_window_infer, reads="texel tile", cost=50,
   when=flag(1), ref=_covered_window_ref,
   glsl=_with_bits("{ " + _BOUNDS + """
    {y} = 0;
    for (int b_ = lo_.y; b_ <= hi_.y; ++b_) for (int a_ = lo_.x; a_ <= hi_.x; ++a_) {y} |= BITS;
    if ({tiles} == 0) {y} = 0; }"""),
   sample=lambda rng: ([rng.integers(-1, 2, (12, 10, 1)), rng.integers(0, 2, (1, 1, 1))],
                       {"dx": 2, "dy": 1, "cell_w": 5, "cell_h": 6, "tile": (16, 16)}),
   doc="Window of the frontal stencil S^H: bit 1 where a covered pixel is in it, bit 0 where an uncovered one is.")
op("edge_mask", "across tiles", attrs=_WINDOW, infer=_window_infer, reads="texel tile", cost=50, when=flag(1),
   ref=_edge_mask_ref, glsl="{ " + _BOUNDS + """
    int near_ = 0;
    for (int b_ = lo_.y; b_ <= hi_.y; ++b_) for (int a_ = lo_.x; a_ <= hi_.x; ++a_) near_ |= {across}(ivec2(a_, b_));
    {y} = near_ == 3 && {tiles} != 0 ? 1 : 0; }""",
   sample=lambda rng: ([rng.integers(1, 4, (12, 10, 1)), rng.integers(0, 2, (1, 1, 1))],
                       {"dx": 0, "dy": 1, "cell_w": 5, "cell_h": 6, "tile": (16, 16)}),
   doc="Edge mask E (paper 3.4.3): covered and other pixels in the window. Rows first by covered_window, then columns here.")

op("inside_tiles", "value tiles", infer=lambda name, inputs, attrs: (inputs[0].vtype, inputs[0].extent), reads="own tile", cost=2,
   when=flag(1) + zero(0), glsl="{y} = {tiles} != 0 ? {value} : {type}(0);",
   ref=lambda value, tiles, tile, apart=False: np.where(spread(tiles, value.shape[1], value.shape[0], tile) != 0, value, 0),
   vjp=lambda g, y, value, tiles, **how: (apply("inside_tiles", g, tiles, **how), None),
   sample=lambda rng: ([rng.normal(size=(20, 35, 3)), rng.integers(0, 2, (2, 3, 1))], {"tile": (16, 16)}),
   doc="A value inside the tiles that are marked, zero outside: what depends on it is drawn for those tiles alone. With apart=True in "
       "passes of its own (passes/apart.py).")
