"""Which part of its tile each entry of a list comes near: 64 cells, 8 across and 8 down, a bit each: pixels pass over what is not near.

In: corners as in `soft.py`, lists by tile (`bins.py`). Out: for each 32 entries and each cell a word, bit k that of entry k, four cells
side by side a texel, so that a pixel looks at 32 entries at once. A bit may be set where nothing is near, never the other way round: a cell
is left out if it lies, by more than the reach, on the outer side of one of the face's edges, or outside its box. Faces that are large or
cross the near plane have all bits.
"""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ....cache.errors import GraphError
from ..ir import Node, table
from ..optable import apply, op
from .bins import FOUR, SIDE, WORD, Grid, _signed
from .lookup import to_table
from .soft_glsl import FUNCTIONS
from .tile_lists import Binned

SLACK = 0.05  # pixels that fp32 may be off
LARGE = 4096.0  # pixels from the middle of the picture: beyond it rounding may be more


def soft_masks(corners: Sequence[Node], lists: Binned, grid: Grid, reach: float) -> Node:
    """Masks of the entries of lists; corners: of each view's faces, vec4 tables; reach: pixels within which a face counts."""
    attrs = {key: grid.attrs[key] for key in ("cell_w", "cell_h", "tile_w", "tile_h")}
    masks = apply("soft_mask", lists.faces, lists.tiles, *corners, **attrs, tiles_x=grid.tiles[0], tiles_y=grid.tiles[1],
                  reach=float(reach + SLACK))
    of_words = apply("shift_left", apply("shift_right", lists.drawn + (WORD - 1), 5), 4)
    return apply("mask_words", masks, of_words, partial=masks.serial)


def _infer(name, inputs, attrs):
    faces, tiles, *corners = inputs
    if faces.vtype != "int" or tiles.vtype != "int" or faces.extent != tiles.extent or any(v.vtype != "vec4" for v in corners):
        raise GraphError(f"{name}: {faces!r}, {tiles!r} and corners {corners!r:.80} do not belong together")
    return "ivec2", faces.extent


def _mask_ref(faces, tiles, v0, v1, v2, cell_w, cell_h, tile_w, tile_h, tiles_x, tiles_y, reach):
    face = np.clip(faces.reshape(-1), 0, v0.shape[0] * v0.shape[1] - 1)
    tile = np.maximum(tiles.reshape(-1), 0) % (tiles_x * tiles_y)
    v = np.stack([x.reshape(-1, 4)[face] for x in (v0, v1, v2)], 1)
    size = np.array([-(-tile_w // SIDE), -(-tile_h // SIDE)])
    middle = np.stack([tile % tiles_x * tile_w, tile // tiles_x * tile_h], 1) - np.array([cell_w, cell_h]) / 2
    cells = np.stack(np.meshgrid(np.arange(SIDE), np.arange(SIDE)), -1).reshape(1, -1, 2)
    q = middle[:, None] + (cells + 0.5) * size
    wide = reach + (np.linalg.norm(size - 1.0) / 2)
    plain = ((v[..., 2] > 0) & (v[..., 2] <= 1)).all(1) & (np.abs(v[..., :2]) < LARGE).all((1, 2))
    e = np.roll(v[..., :2], -1, 1) - v[..., :2]
    facing = np.where(e[:, 0, 0] * -e[:, 2, 1] + e[:, 0, 1] * e[:, 2, 0] < 0, -1.0, 1.0)
    out = ((q >= (v[..., :2].min(1) - wide)[:, None]) & (q <= (v[..., :2].max(1) + wide)[:, None])).all(-1)
    for k in range(3):
        away = q - v[:, None, k, :2]
        side = (e[:, None, k, 0] * away[..., 1] - e[:, None, k, 1] * away[..., 0]) * facing[:, None]
        out &= side >= -wide * np.linalg.norm(e[:, k], axis=-1)[:, None]
    out |= ~plain[:, None]
    words = (out.reshape(-1, 2, 32).astype(np.int64) << np.arange(32)).sum(2)
    words = (words + 2 ** 31) % 2 ** 32 - 2 ** 31
    return np.where(tiles.reshape(-1, 1) < 0, -1, words).reshape(*faces.shape[:2], 2)


def _words_ref(masks, drawn, partial=0):
    count = masks.shape[0] * masks.shape[1]
    words = np.zeros((-(-count // WORD) * WORD, 2), np.int64)
    words[:count] = masks.reshape(-1, 2)
    cells = ((words[:, :, None] >> np.arange(WORD)) & 1).reshape(-1, WORD, SIDE * SIDE)  # (32 entries, one of them, cell)
    return to_table(_signed((cells << np.arange(WORD)[:, None]).sum(1)).reshape(-1, FOUR))


def _words_infer(name, inputs, attrs):
    entries = inputs[0].extent.width * inputs[0].extent.height
    return "ivec4", replace(table(-(-entries // WORD) * (SIDE * SIDE // FOUR)), partial=attrs.get("partial", 0))


op("mask_words", "masks drawn", reads="texel count", attrs="partial?", ref=_words_ref, cost=300, infer=_words_infer,
   sample=lambda rng: ([to_table(rng.integers(-2 ** 31, 2 ** 31, (75, 2))), np.array([[[0]]])], {}),
   glsl="""{ int first_ = {i} / 16 * 32, four_ = {i} & 15, up_ = (four_ & 7) * 4, last_ = {masks_w} * {masks_h} - 1;
    {y} = ivec4(0);
    for (int k_ = 0; k_ < 32 && first_ + k_ <= last_; ++k_) {
        ivec2 m_ = {masks_at}(first_ + k_);
        {y} |= (ivec4(four_ < 8 ? m_.x : m_.y) >> (up_ + ivec4(0, 1, 2, 3)) & 1) << k_;
    } }""",
   doc="Masks of 32 entries, a word for each of the 64 cells of their tiles: bit k is that of entry k. Four cells side by side a texel. "
       "Drawn for as many texels as `drawn` says, undefined after them.")


def _sample(rng):
    grid = Grid(1, 30, 40, 24, 1, (8, 8))
    spots = rng.uniform((-20, -12), (20, 12), (30, 1, 2)) + rng.uniform(-7, 7, (30, 3, 2))
    v = np.concatenate([spots, rng.uniform(0.3, 0.9, (30, 3, 1)), rng.uniform(-1, 0, (30, 3, 1))], 2)
    v[3, 1, 2], v[5, 0, 0], v[7] = -0.4, 1e6, v[7, :1]
    n = 57
    return [to_table(rng.integers(0, 30, n)), to_table(rng.integers(-1, 15, n)), *(to_table(v[:, k]) for k in range(3))], {
        **{key: grid.attrs[key] for key in ("cell_w", "cell_h", "tile_w", "tile_h")}, "tiles_x": 5, "tiles_y": 3, "reach": 1.55}


op("soft_mask", "faces tiles v0 v1 v2", alike=((3, 2), (4, 2)), attrs="cell_w cell_h tile_w tile_h tiles_x tiles_y reach", infer=_infer,
   reads="own own texel texel texel", ref=_mask_ref, functions=FUNCTIONS, cost=600, sample=_sample,
   glsl="""{ int f_ = max({faces}, 0), t_ = max({tiles}, 0) % ({tiles_x} * {tiles_y});
    vec4 v0_ = {v0_at}(f_), v1_ = {v1_at}(f_), v2_ = {v2_at}(f_);
    vec2 size_ = vec2((ivec2({tile_w}, {tile_h}) + 7) / 8);
    vec2 o_ = vec2(ivec2(t_ % {tiles_x} * {tile_w}, t_ / {tiles_x} * {tile_h})) - 0.5 * vec2(ivec2({cell_w}, {cell_h}));
    float wide_ = float({reach}) + 0.5 * length(size_ - 1.0);
    vec2 lo_ = min(min(v0_.xy, v1_.xy), v2_.xy), hi_ = max(max(v0_.xy, v1_.xy), v2_.xy), e0_ = v1_.xy - v0_.xy, e1_ = v2_.xy - v1_.xy;
    vec2 e2_ = v0_.xy - v2_.xy;
    float facing_ = e0_.x * -e2_.y + e0_.y * e2_.x < 0.0 ? -1.0 : 1.0;
    bool plain_ = soft_front(v0_.z) && soft_front(v1_.z) && soft_front(v2_.z)
               && max(max(hi_.x, hi_.y), max(-lo_.x, -lo_.y)) < """ + repr(LARGE) + """;
    vec3 by_x_ = vec3(-e0_.y, -e1_.y, -e2_.y) * facing_, by_y_ = vec3(e0_.x, e1_.x, e2_.x) * facing_;
    vec3 far_ = wide_ * vec3(length(e0_), length(e1_), length(e2_));
    ivec2 first_ = ivec2(clamp(ceil((lo_ - wide_ - o_) / size_ - 0.5), vec2(0.0), vec2(8.0)));
    ivec2 end_ = ivec2(clamp(floor((hi_ + wide_ - o_) / size_ - 0.5) + 1.0, vec2(0.0), vec2(8.0)));
    int wide_cells_ = end_.x - first_.x, many_ = plain_ && {tiles} >= 0 && wide_cells_ > 0 ? wide_cells_ * max(end_.y - first_.y, 0) : 0;
    ivec2 c_ = first_;
    {y} = ivec2(plain_ && {tiles} >= 0 ? 0 : -1);
    for (int k_ = 0; k_ < many_; ++k_) {
        vec2 q_ = o_ + (vec2(c_) + 0.5) * size_, a0_ = q_ - v0_.xy, a1_ = q_ - v1_.xy, a2_ = q_ - v2_.xy;
        vec3 side_ = by_x_ * vec3(a0_.x, a1_.x, a2_.x) + by_y_ * vec3(a0_.y, a1_.y, a2_.y) + far_;
        int bit_ = min(min(side_.x, side_.y), side_.z) >= 0.0 ? 1 << ((c_.y & 3) * 8 + c_.x) : 0;
        {y} |= ivec2(c_.y < 4 ? bit_ : 0, c_.y < 4 ? 0 : bit_);
        c_ = c_.x + 1 < end_.x ? ivec2(c_.x + 1, c_.y) : ivec2(first_.x, c_.y + 1);
    } }""",
   doc="Of each entry, a face in a tile, which of the tile's 8 x 8 cells (of pixels, where tiles have no more than 64) may have "
       "pixels within `reach` of the face: rows 0 to 3 in the first word, 4 to 7 in the second, 8 bits each. All bits where there is "
       "no tile, where the face crosses the near plane, or has a corner far away.")
