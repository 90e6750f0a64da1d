"""Lists by tile that are too long for one invocation: drivers end loops of 65,535 turns, so that an invocation goes through so many
entries and no more (`soft.EACH`).

In: lists by tile. Out: a *unit* for each further part of a list, in a list of its own that is as long as there are such parts: none, on
most pictures, and then nothing is drawn for them. The ops of `soft.py` are worked out for each pixel of each unit's tile, in tables; the
pixels of a tile with a long list then put its parts together, one after the other.
"""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ....cache.errors import GraphError
from ..ir import Node, image, table
from ..optable import Loop, apply, op
from . import soft_reference as reference
from .bins import Grid
from .lookup import constant_table, to_table
from .scan import exclusive_scan
from .soft import _ALPHA, _GRID, _SUMS, _TILES, ALPHA_BODY, LEAST, MOST_BODY, PAIR, SUMS_BODY, _need_faces, _tiles_attrs, sample_of
from .soft_glsl import FUNCTIONS, TILE, UNIT
from .tile_lists import Binned

WHOLE = 4  # times as many entries as one invocation goes through: lists of all faces of a view are gone through where there are no more


@dataclass(frozen=True)
class Parts:
    """`units`: (tile, part) of each further part, tile by tile; `starts`: of each tile, where its begin; `drawn`, `pixels`: how many units
    and pixels of units there are, at most `slots` units."""

    units: Node
    starts: Node
    drawn: Node
    pixels: Node
    slots: int


def capacity(grid: Grid, lists: Binned, each: int) -> int:
    """Units that there is room for: no fewer than lists of tiles can have, and lists of bins where those of tiles have no room; with few
    faces all that there could be."""
    tiles = grid.views * grid.tiles[0] * grid.tiles[1]
    every = tiles * max(-(-grid.faces // each) - 1, 0)
    listed = (lists.faces.extent.count + 64 * lists.bins) // each
    return max(min(every, every if grid.faces <= WHOLE * each else listed), 1)


def find_parts(lists: Binned, grid: Grid, each: int) -> Parts:
    """The further parts of all lists."""
    slots, tiles = capacity(grid, lists, each), lists.ranges.extent.count
    more = apply("max", apply("idiv", lists.ranges.y - lists.ranges.x - 1, each), 0)
    starts, last = exclusive_scan(more), constant_table(np.array([tiles - 1]))
    drawn = apply("min", apply("lookup", starts, last) + apply("lookup", more, last), slots)
    units = apply("part_units", starts, drawn, slots=slots, tiles=tiles, partial=starts.serial)
    return Parts(units, starts, drawn, drawn * (grid.tile[0] * grid.tile[1]), slots)


def in_parts(name: str, inputs: Sequence[Node], parts: Parts, grid: Grid, each: int, **attrs) -> Node:
    """An op over lists of each pixel of each unit."""
    return apply(f"{name}_parts", *inputs, parts.units, parts.pixels, slots=parts.slots, each=each, partial=parts.units.serial,
                 **_some(grid), **attrs)


def join_parts(name: str, own: Sequence[Node], ranges: Node, others: Sequence[Node], parts: Parts, grid: Grid, extent, each: int,
               **attrs) -> Node:
    """What pixels have of the first parts of their lists, and of the others."""
    cells = {"cell_w": grid.cell_w, "cell_h": grid.cell_h, "columns": grid.columns}
    return apply(name, *own, ranges, parts.starts, *others, slots=parts.slots, each=each, **_tiles_attrs(grid, extent), **cells, **attrs)


def _some(grid: Grid) -> dict:
    attrs = _tiles_attrs(grid, None)
    return {key: attrs[key] for key in attrs if key != "extent"}


def _units_ref(starts, drawn, slots, tiles, partial=0):
    first = starts.reshape(-1)[:tiles]
    tile = np.searchsorted(first, np.arange(slots), side="right") - 1
    return to_table(np.stack([tile, np.arange(slots) - first[tile] + 1], 1))


op("part_units", "starts drawn", attrs="slots tiles partial?", reads="texel count", ref=_units_ref, cost=60,
   infer=lambda name, inputs, attrs: ("ivec2", replace(table(attrs["slots"]), partial=attrs.get("partial", 0))),
   sample=lambda rng: ([to_table(np.array([0, 0, 2, 2, 5, 9])), np.array([[[11]]])], {"slots": 13, "tiles": 6}),
   glsl="""{ int low_ = 0, high_ = {tiles};
    while (high_ - low_ > 1) { int mid_ = (low_ + high_) >> 1; if ({starts_at}(mid_) <= {i}) low_ = mid_; else high_ = mid_; }
    {y} = ivec2(low_, {i} - {starts_at}(low_) + 1); }""",
   doc="Which tile each unit is a part of, and which part, from 1: the last tile whose units start there or before. Drawn for as many as "
       "`drawn` says, undefined after them.")


# ---- of each pixel of a unit

_UNITS = "slots views tiles_x tiles_y tile_w tile_h each"


def _parts_infer(vtype: str, tables: int):
    def infer(name, inputs, attrs):
        _need_faces(name, inputs[:tables], attrs["views"], attrs)
        ranges, units = inputs[tables], inputs[-2]
        if ranges.extent.count != attrs["views"] * attrs["tiles_x"] * attrs["tiles_y"] or units.extent.count < attrs["slots"]:
            raise GraphError(f"{name}: ranges are {ranges!r}, units {units!r}; those of {attrs['tiles_x']} x {attrs['tiles_y']} tiles of "
                             f"{attrs['views']} views and of {attrs['slots']} units are needed")
        return vtype, replace(table(attrs["slots"] * attrs["tile_w"] * attrs["tile_h"]), partial=attrs.get("partial", 0))
    return infer


def _parts_ref(of, tables: int):
    def ref(*inputs, **attrs):
        ranges, faces = inputs[tables + 1:tables + 3]
        pairs = reference.at_units(reference.near_pairs(*inputs[:3], inputs[tables], **attrs), ranges, faces, inputs[-2], **attrs)
        out = of(pairs, (1, attrs["slots"] * attrs["tile_w"] * attrs["tile_h"]), *inputs[3:tables], **attrs)
        return to_table(out[0])
    return ref


def _parts_sample(colors: bool):
    def sample(rng):
        arguments, attrs = sample_of(colors)(rng)
        lists, each = arguments[-4], 2
        length = lists.reshape(-1, 2)[:_GRID.views * _GRID.tiles[0] * _GRID.tiles[1]] @ (-1, 1)
        more = np.maximum((length - 1) // each, 0)
        units = _units_ref(to_table(np.cumsum(more) - more), None, int(more.sum()), len(more))
        attrs = {**{key: attrs[key] for key in (*PAIR.split(), *_some(_GRID))}, "slots": int(more.sum()), "each": each}
        return [*arguments, units, np.array([[[0]]])], attrs | ({"gamma": 0.05, "base": 1.05, "least": LEAST - 1.05} if colors else {})
    return sample


for _name, _colors, _vtype, _loop, _of, _doc in (
        ("soft_alpha", "", "float", Loop(_ALPHA.replace(TILE, UNIT), *ALPHA_BODY), reference.alpha_of, "alpha"),
        ("soft_sums", "c0 c1 c2 ", "vec4", Loop(_SUMS.replace(TILE, UNIT), *SUMS_BODY), reference.sums_of, "sums of colours and weights"),
        ("soft_most", "c0 c1 c2 ", "vec2", Loop(_SUMS.replace(TILE, UNIT), *MOST_BODY), reference.most_of, "largest depth and alpha")):
    _tables = 6 if _colors else 3
    op(f"{_name}_parts", f"v0 v1 v2 {_colors}boxes ranges faces masks spilled units drawn",
       attrs=f"{_UNITS} {PAIR}{' least gamma base' if _colors else ''} partial?", reads="texel " * (_tables + 6) + "count", cost=2000,
       infer=_parts_infer(_vtype, _tables + 1), ref=_parts_ref(_of, _tables), functions=FUNCTIONS, sample=_parts_sample(bool(_colors)),
       loop=_loop,
       doc=f"Of each pixel of each unit's tile, row by row, the {_doc} of the part of the list that the unit is; as of {_name}. Drawn for "
           "as many as `drawn` says, undefined after them.")

# ---- all of a pixel

# The units of the pixel's tile: many_, from u_ on, the pixel the k_-th of each; none where there was no room for all, lost_.
_OF_TILE = """{ ivec2 size_ = ivec2({cell_w}, {cell_h}), cell_ = {p} / size_, in_ = {p} - cell_ * size_, tile_ = ivec2({tile_w}, {tile_h});
    int view_ = cell_.y * {columns} + cell_.x, t_ = (view_ * {tiles_y} + in_.y / {tile_h}) * {tiles_x} + in_.x / {tile_w};
    ivec2 all_ = view_ < {views} ? {ranges_at}(t_) : ivec2(0), of_ = in_ % tile_;
    int many_ = max((all_.y - all_.x - 1) / {each}, 0), u_ = many_ > 0 ? {starts_at}(t_) : 0, k_ = of_.y * {tile_w} + of_.x;
    bool lost_ = u_ + many_ > {slots};
    {y} = INIT;
    for (int n_ = lost_ ? many_ : 0; n_ < many_; ++n_) { int s_ = (u_ + n_) * ({tile_w} * {tile_h}) + k_; BODY }
    if (lost_) {y} = {type}(intBitsToFloat(0x7f800000)); }"""
# Sums so far and of a part, both relative to their largest depths, 0 where there is no face: how much each counts.
_NEARER = """float after_ = {most_parts_at}(s_).x; after_ = after_ < 0.0 ? after_ : -1e30;
    float before_ = nearest_ < 0.0 ? nearest_ : -1e30, top_ = max(before_, after_);
    nearest_ = top_ > -1e29 ? top_ : 0.0;
    """


def _joined(init: str, body: str, before: str = "") -> str:
    return _OF_TILE.replace("INIT", init).replace("BODY", body).replace("{y} = ", before + "{y} = ", 1)


def _tile_of(extent, views, tiles_x, tiles_y, tile_w, tile_h, cell_w, cell_h, columns):
    """Of each pixel its tile, -1 beside all views, and which of the tile's pixels it is."""
    y, x = np.indices((extent.height, extent.width))
    view, (y, x) = y // cell_h * columns + x // cell_w, (y % cell_h, x % cell_w)
    tile = (view * tiles_y + y // tile_h) * tiles_x + x // tile_w
    return np.where(view < views, tile, -1), y % tile_h * tile_w + x % tile_w


def _join_ref(step):
    """The join of images `own` by step(values so far, those of the parts), values being lists."""
    def ref(own, ranges, starts, parts, slots, each, extent, gamma=0.0, **attrs):
        tile, k = _tile_of(extent, **attrs)
        spans = ranges.reshape(-1, 2)
        many = np.where(tile < 0, 0, np.maximum((spans[tile, 1] - spans[tile, 0] - 1) // each, 0))
        first = np.where(many > 0, starts.reshape(-1)[tile], 0)
        lost, found = first + many > slots, own
        for n in range(int(np.where(lost, 0, many).max())):
            more = (n < many) & ~lost
            at = np.where(more, (first + n) * (attrs["tile_w"] * attrs["tile_h"]) + k, 0)
            new = step(found, [x.reshape(-1, x.shape[2])[at] for x in parts], gamma)
            found = [np.where(more[..., None], a, b) for a, b in zip(new, found)]
        return [np.where(lost[..., None], np.inf, x) for x in found]
    return ref


def _both_alphas(a, b, gamma):
    return [1 - (1 - a[0]) * (1 - b[0])]


def _both_sums(a, b, gamma):
    before, after = (np.where(m[..., :1] < 0, m[..., :1], -1e30) for m in (a[1], b[1]))
    top = np.maximum(before, after)
    s, t = (np.exp(np.maximum((x - top) / gamma, -1e4)) for x in (before, after))
    return [a[0] * s + b[0] * t, np.concatenate([np.where(top > -1e29, top, 0), 1 - (1 - a[1][..., 1:]) * (1 - b[1][..., 1:])], 2)]


def _join_infer(name, inputs, attrs):
    ranges = inputs[1 if name != "soft_join_sums" else 2]
    if ranges.extent.count != attrs["views"] * attrs["tiles_x"] * attrs["tiles_y"]:
        raise GraphError(f"{name}: ranges are {ranges!r}; those of {attrs['tiles_x']} x {attrs['tiles_y']} tiles of {attrs['views']} views "
                         "are needed")
    return inputs[0].vtype, attrs["extent"]


def _join_sample(kind: str):
    def sample(rng):
        extent, tiles, each, area = image(26, 11), _GRID.views * _GRID.tiles[0] * _GRID.tiles[1], 3, _GRID.tile[0] * _GRID.tile[1]
        ends = np.cumsum(rng.integers(0, 11, tiles))
        ranges = np.stack([np.append(0, ends[:-1]), ends], 1)
        more = np.maximum((ranges @ (-1, 1) - 1) // each, 0)
        slots = int(more.sum()) - 1  # none for the last
        cells = {"cell_w": _GRID.cell_w, "cell_h": _GRID.cell_h, "columns": _GRID.columns}
        attrs = {"slots": slots, "each": each, **_tiles_attrs(_GRID, extent), **cells}

        def values(*shape):
            near = -rng.uniform(0.1, 0.9, shape)
            sums, most = rng.uniform(0, 1, (*shape, 4)), np.stack([near * (rng.random(shape) < 0.8), rng.uniform(0, 1, shape)], -1)
            return {"alpha": [most[..., 1:]], "most": [most], "sums": [sums, most]}[kind]
        own, parts = values(11, 26), [to_table(x) for x in values(slots * area)]
        return [*own, to_table(ranges), to_table(np.cumsum(more) - more), *parts], attrs | ({} if kind == "alpha" else {"gamma": 0.3})
    return sample


_JOIN = f"slots each {_TILES} cell_w cell_h columns"
_WHAT = "the others are in units from where `starts` says; infinite where there was no room for them"

op("soft_join_alpha", "alpha ranges starts alpha_parts", attrs=_JOIN, infer=_join_infer, reads="own texel texel texel", cost=10,
   ref=lambda alpha, ranges, starts, parts, **attrs: _join_ref(_both_alphas)([alpha], ranges, starts, [parts], **attrs)[0],
   sample=_join_sample("alpha"), glsl=_joined("{alpha}", "{y} = 1.0 - (1.0 - {y}) * (1.0 - {alpha_parts_at}(s_));"),
   doc=f"alpha of all parts of the pixel's list: alpha of the first, {_WHAT}.")
op("soft_join_most", "most ranges starts most_parts", attrs=_JOIN + " gamma", infer=_join_infer, reads="own texel texel texel", cost=10,
   ref=lambda most, ranges, starts, parts, **attrs: _join_ref(lambda a, b, gamma: _both_sums([a[0] * 0, *a], [b[0] * 0, *b], gamma)[1:])(
       [most], ranges, starts, [parts], **attrs)[0],
   sample=_join_sample("most"),
   glsl=_joined("{most}", "float nearest_ = {y}.x; " + _NEARER
                + "{y} = vec2(nearest_, 1.0 - (1.0 - {y}.y) * (1.0 - {most_parts_at}(s_).y));"),
   doc=f"The largest depth and alpha of all parts of the pixel's list: those of the first, {_WHAT}.")
op("soft_join_sums", "sums most ranges starts sums_parts most_parts", attrs=_JOIN + " gamma", infer=_join_infer,
   reads="own own texel texel texel texel", cost=10, sample=_join_sample("sums"),
   ref=lambda sums, most, ranges, starts, *parts, **attrs: _join_ref(_both_sums)([sums, most], ranges, starts, parts, **attrs)[0],
   glsl=_joined("{sums}", _NEARER + "{y} = {y} * exp(max((before_ - top_) / float({gamma}), -1e4)) "
                "+ {sums_parts_at}(s_) * exp(max((after_ - top_) / float({gamma}), -1e4));", "float nearest_ = {most}.x;\n    "),
   doc=f"Sums of colours and weights of all parts of the pixel's list: those of the first, {_WHAT}; relative to the largest depth of all.")
