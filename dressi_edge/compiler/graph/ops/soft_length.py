"""How long lists by tile are: of each pixel's tile, and in which tiles of the atlas some are longer than one invocation goes through."""
from __future__ import annotations

import math

import numpy as np

from ..ir import Node, image
from ..optable import apply, op
from .bins import Grid
from .lookup import to_table
from .reduce import TILE
from .soft import _GRID, _TILES, _tiles_attrs, over_pixels


def list_length(ranges: Node, grid: Grid, extent) -> Node:
    """How many entries the list of each pixel's tile has."""
    cells = {"cell_w": grid.cell_w, "cell_h": grid.cell_h, "columns": grid.columns}
    return apply("soft_length", ranges, **_tiles_attrs(grid, extent), **cells)


def _length_ref(ranges, extent, views, tiles_x, tiles_y, tile_w, tile_h, cell_w, cell_h, columns):
    y, x = np.indices((extent.height, extent.width))
    view = y // cell_h * columns + x // cell_w
    tile = (view * tiles_y + y % cell_h // tile_h) * tiles_x + x % cell_w // tile_w
    flat = ranges.reshape(-1, 2)
    found = flat[np.minimum(tile, len(flat) - 1)]
    return np.where(view < views, found[..., 1] - found[..., 0], 0)[..., None]


def _length_sample(rng):
    ranges = np.sort(rng.integers(0, 99, (_GRID.views * _GRID.tiles[0] * _GRID.tiles[1], 2)), 1)
    cells = {"cell_w": _GRID.cell_w, "cell_h": _GRID.cell_h, "columns": _GRID.columns}
    return [to_table(ranges)], {**_tiles_attrs(_GRID, image(26, 11)), **cells}


def _length_infer(name, inputs, attrs):
    return over_pixels("int", 0)(name, inputs, attrs)


op("soft_length", "ranges", attrs=f"{_TILES} cell_w cell_h columns", infer=_length_infer, reads="texel", ref=_length_ref, cost=12,
   sample=_length_sample,
   glsl="""{ ivec2 cell_ = {p} / ivec2({cell_w}, {cell_h}), in_ = {p} - cell_ * ivec2({cell_w}, {cell_h});
    int view_ = cell_.y * {columns} + cell_.x, tile_ = (view_ * {tiles_y} + in_.y / {tile_h}) * {tiles_x} + in_.x / {tile_w};
    ivec2 r_ = {ranges_at}(view_ < {views} ? tile_ : 0);
    {y} = view_ < {views} ? r_.y - r_.x : 0; }""",
   doc="How many entries the list of each pixel's tile has.")


def long_lists(ranges: Node, grid: Grid, extent, over: int) -> Node:
    """1 for each TILE x TILE pixels of the atlas some of which have a list of more than `over` entries, else 0."""
    cells = {"cell_w": grid.cell_w, "cell_h": grid.cell_h, "columns": grid.columns}
    step_x, step_y = (math.gcd(t, c, TILE) for t, c in zip(grid.tile, (grid.cell_w, grid.cell_h)))  # borders of lists' tiles lie on these
    return apply("soft_long", ranges, **_tiles_attrs(grid, extent), **cells, over=over, step_x=step_x, step_y=step_y)


def _long_ref(ranges, over, step_x, step_y, extent, **attrs):
    long = _length_ref(ranges, extent, **attrs)[..., 0] > over
    height, width = -(-extent.height // TILE), -(-extent.width // TILE)
    padded = np.zeros((height * TILE, width * TILE), int)
    padded[:extent.height, :extent.width] = long
    return padded.reshape(height, TILE, width, TILE).max((1, 3))[..., None]


def _long_infer(name, inputs, attrs):
    _, extent = _length_infer(name, inputs, attrs)
    return "int", image(-(-extent.width // TILE), -(-extent.height // TILE))


def _long_sample(rng):
    inputs, attrs = _length_sample(rng)
    return inputs, {**attrs, "over": 40, "step_x": 1, "step_y": 1}


op("soft_long", "ranges", attrs=f"{_TILES} cell_w cell_h columns over step_x step_y", infer=_long_infer, reads="texel",
   ref=_long_ref, cost=100, sample=_long_sample,
   glsl="""{y} = 0;
{ int across_ = SIDE / {step_x};
for (int k_ = 0; k_ < across_ * (SIDE / {step_y}); ++k_) {
    ivec2 p_ = {p} * SIDE + ivec2(k_ % across_ * {step_x}, k_ / across_ * {step_y});
    ivec2 cell_ = p_ / ivec2({cell_w}, {cell_h}), in_ = p_ - cell_ * ivec2({cell_w}, {cell_h});
    int view_ = cell_.y * {columns} + cell_.x, tile_ = (view_ * {tiles_y} + in_.y / {tile_h}) * {tiles_x} + in_.x / {tile_w};
    bool there_ = cell_.x < {columns} && view_ < {views};
    ivec2 r_ = {ranges_at}(there_ ? tile_ : 0);
    if (there_ && r_.y - r_.x > {over}) {y} = 1;
} }""".replace("SIDE", str(TILE)),
   doc="Whether one of the lists of each 16 x 16 pixels, those of the tiles that meet it, has more than `over` entries. Borders of the "
       "lists' tiles lie `step_x` and `step_y` pixels apart, or multiples of that.")
