"""Which faces come near each tile: the second level of `bins.py`, tiles of bins in the place of bins of views.

In: boxes in the order of the bins' list, the bins' ranges in it. Words of a bin's tiles, 32 entries of its list each, lie tile by tile from
the bin's `base` on; those of the tiles' columns and rows from a quarter of it on. Out: the list of all tiles, and each tile's range.
"""
from __future__ import annotations

import numpy as np

from ..ir import table
from ..optable import op
from .bins import (
    _BIN_PLACE,
    _FIND,
    _GRID,
    _SPANNED,
    MARK,
    SIDE,
    WORD,
    _bin_list_ref,
    _bin_ranges_ref,
    _corner,
    _filled,
    _listed,
    _marks_ref,
    _packed,
    _sample_boxes,
    _sample_grid,
    _scanned,
    _slots_ref,
    _some,
    _spans,
    _words_of,
)
from .lookup import to_table


def _tile_words_of(ranges: np.ndarray) -> np.ndarray:
    """Words of each bin's tiles."""
    return (ranges[:, 1] - ranges[:, 0] + WORD - 1) // WORD * SIDE * SIDE


def _each_bin(ranges, bases, views, bins_x, bins_y):
    """(bin, its view, column, row, range, words of a tile, first word) of each."""
    for c, (first, end) in enumerate(ranges.reshape(-1, 2)[:views * bins_x * bins_y]):
        view, rest = divmod(c, bins_x * bins_y)
        yield view, rest % bins_x, rest // bins_x, first, end, -(-(end - first) // WORD), bases.reshape(-1)[c]


def _put(out: np.ndarray, at: int, words: np.ndarray) -> None:
    words = words[:max(len(out) - at, 0)]
    out[at:at + len(words)] = words


def _tile_sides_ref(boxes, ranges, bases, needed, slots, views, face_count, cell_w, cell_h, columns, bins_x, bins_y, words, tile_w, tile_h):
    out, boxes = np.zeros(slots, np.int64), boxes.reshape(-1, 4)
    for view, a, b, first, end, n, base in _each_bin(ranges, bases, views, bins_x, bins_y):
        corner = np.array(_corner(view, cell_w, cell_h, columns)) + (a * tile_w * SIDE, b * tile_h * SIDE)
        for k in range(2 * SIDE):
            axis, width = k // SIDE, (tile_w, tile_h)[k // SIDE]
            flags = np.zeros(n * WORD, bool)
            flags[:end - first] = _spans(boxes[first:end], axis, corner[axis] + k % SIDE * width, width)
            _put(out, base // 4 + k * n, _packed(flags))
    return to_table(out)


def _tile_words_ref(sides, ranges, bases, needed, slots, views, bins_x, bins_y):
    out, sides = np.zeros(slots, np.int64), sides.reshape(-1)
    for *_, n, base in _each_bin(ranges, bases, views, bins_x, bins_y):
        own = np.zeros(2 * SIDE * n, np.int64)
        _put(own, 0, sides[base // 4:base // 4 + len(own)])
        own = own.reshape(2 * SIDE, n)
        _put(out, base, (own[None, :SIDE] & own[SIDE:, None]).reshape(-1))
    return to_table(out)


# a / n of what is not negative, without the division of integers that many machines do one number after the other.
_FUNCTIONS = """
int tile_quotient(int a, int n) {
    int q = int(float(a) / float(n));
    q -= q * n > a ? 1 : 0;
    return (q + 1) * n <= a ? q + 1 : q;
}
"""

# The bin of word w_ of the tiles: c_, from c_ to before top_; with its range r_, words a tile n_.
_OF_BIN = """while (top_ - c_ > 1) { int mid_ = (c_ + top_) >> 1; if ({bases_at}(mid_) <= w_) c_ = mid_; else top_ = mid_; }
    ivec2 r_ = {ranges_at}(c_);
    int n_ = (r_.y - r_.x + 31) / 32;"""


def _tile_sample(rng, slots=400):
    """Faces of bins, ranges, bases; the boxes of those faces; how many words tiles have."""
    grid = _sample_grid()
    boxes = _sample_boxes(rng, grid)
    words = _words_of(boxes, grid)
    starts, spilled, total = _scanned(words, slots)
    attrs = _some(grid, "views", "face_count", "bins_x", "bins_y")
    faces = _bin_list_ref(words, starts, spilled, total, None, None, slots=slots, per_bin=grid.words, **attrs)
    ranges = _bin_ranges_ref(starts, spilled, total, words=grid.words, **attrs)
    n = _tile_words_of(ranges.reshape(-1, 2)[:grid.views * grid.bins[0] * grid.bins[1]])
    return grid, [faces, ranges, to_table(np.cumsum(n) - n)], to_table(boxes.reshape(-1, 4)[faces.reshape(-1)]), int(n.sum())


_BINS = ("views", "bins_x", "bins_y")


def _tile_sides_sample(rng):
    grid, inputs, boxes, count = _tile_sample(rng)
    return [boxes, *inputs[1:], np.array([[[count]]])], {**grid.attrs, "slots": count // 4 + 20}


def _tile_words_sample(rng):
    grid, inputs, boxes, count = _tile_sample(rng)
    sides = _tile_sides_ref(boxes, *inputs[1:], None, **grid.attrs, slots=count // 4)
    return [sides, *inputs[1:], np.array([[[count]]])], {**_some(grid, *_BINS), "slots": count + 20}


op("tile_sides", "boxes ranges bases needed", attrs="slots " + _GRID, reads="texel texel texel texel", ref=_tile_sides_ref, cost=300,
   functions=_FUNCTIONS,
   infer=lambda name, inputs, attrs: ("int", table(attrs["slots"])), sample=_tile_sides_sample,
   glsl="""{ int w_ = {i} * 4, c_ = 0, top_ = w_ < {needed}(ivec2(0)) ? {bases_n} : 0;
    """ + _OF_BIN + _BIN_PLACE.replace("q_", "o_") + """
    int at_ = {i} - {bases_at}(c_) / 4, t_ = n_ > 0 ? tile_quotient(max(at_, 0), n_) : 16;
    int first_ = r_.x + (at_ - t_ * n_) * 32, axis_ = t_ < 8 ? 0 : 1;
    int q_ = axis_ == 0 ? o_.x + t_ * {tile_w} : o_.y + (t_ - 8) * {tile_h}, e_ = q_ + (axis_ == 0 ? {tile_w} : {tile_h});
    n_ = t_ < 16 && {i} < {n} ? min(r_.y - first_, 32) : 0;
    """ + _SPANNED + """ }""",
   doc="For each of the eight columns and the eight rows of tiles of a bin and 32 entries of its list a word: bit k is set if box k, in "
       "the order of the list, meets it. Words of a bin lie from a quarter of `bases` on, `needed` / 4 in all.")
op("tile_words", "sides ranges bases needed", attrs="slots views bins_x bins_y", reads="texel texel texel texel", ref=_tile_words_ref,
   cost=40, functions=_FUNCTIONS, infer=lambda name, inputs, attrs: ("int", table(attrs["slots"])), sample=_tile_words_sample,
   glsl="""{ int w_ = {i}, c_ = 0, top_ = w_ < {needed}(ivec2(0)) ? {bases_n} : 0;
    """ + _OF_BIN + """
    int base_ = {bases_at}(c_), at_ = w_ - base_, t_ = n_ > 0 ? tile_quotient(max(at_, 0), n_) : 64, g_ = base_ / 4 + at_ - t_ * n_;
    {y} = t_ < 64 && {i} < {n} ? {sides_at}(g_ + t_ % 8 * n_) & {sides_at}(g_ + (8 + t_ / 8) * n_) : 0; }""",
   doc="For each tile and 32 entries of its bin's list a word: bit k is set if box k, in the order of the list, meets the tile: its column "
       "and its row. Words of a bin's 64 tiles lie from `bases` on, `needed` in all.")


def _mark_bins_ref(marks, bases, bins):
    flat = bases.reshape(-1)[:bins]
    return np.clip(np.searchsorted(flat, marks, side="right") - 1, 0, None)


def _tile_list_ref(words, starts, spilled, total, marks, of_marks, faces, ranges, bases, drawn, slots, views, bins_x, bins_y, tiles_x,
                   tiles_y, partial=0):
    if spilled.reshape(-1)[0]:
        listed = _filled(faces.reshape(-1), slots)
        return np.concatenate([listed, np.full_like(listed, -1)], 2)
    word, bit = _slots_ref(words, total)
    bins = views * bins_x * bins_y
    ranges, bases = ranges.reshape(-1, 2)[:bins], bases.reshape(-1)[:bins]
    c = np.searchsorted(bases, word, side="right") - 1
    n = (ranges[c, 1] - ranges[c, 0] + WORD - 1) // WORD
    t, (view, rest) = (word - bases[c]) // n, np.divmod(c, bins_x * bins_y)
    tile = (view * tiles_y + rest // bins_x * SIDE + t // SIDE) * tiles_x + rest % bins_x * SIDE + t % SIDE
    listed = faces.reshape(-1)[ranges[c, 0] + (word - bases[c]) % n * WORD + bit]
    return np.concatenate([_filled(listed, slots), _filled(tile, slots)], 2)


def _tile_list_sample(rng, slots=1200):
    grid, inputs, boxes, count = _tile_sample(rng)
    sides = _tile_sides_ref(boxes, *inputs[1:], None, **grid.attrs, slots=count // 4)
    words = _tile_words_ref(sides, *inputs[1:], None, **_some(grid, *_BINS), slots=count + 20)
    scanned = _scanned(words, slots)
    marks, count = _marks_ref(*scanned, slots), grid.views * grid.bins[0] * grid.bins[1]
    return [words, *scanned, marks, _mark_bins_ref(marks, inputs[2], count), *inputs, np.array([[[0]]])], {
        "slots": slots, **_some(grid, *_BINS), "tiles_x": grid.tiles[0], "tiles_y": grid.tiles[1]}


op("mark_bins", "marks bases", attrs="bins", reads="own texel", ref=_mark_bins_ref, cost=30,
   infer=lambda name, inputs, attrs: ("int", inputs[0].extent),
   sample=lambda rng: ([to_table(np.sort(rng.integers(0, 90, 15))), to_table(np.sort(rng.integers(0, 90, 9) * (np.arange(9) > 0)))],
                       {"bins": 9}),
   glsl="""{ int w_ = {marks}, top_ = {bins};
    {y} = 0;
    while (top_ - {y} > 1) { int mid_ = ({y} + top_) >> 1; if ({bases_at}(mid_) <= w_) {y} = mid_; else top_ = mid_; } }""",
   doc="The bin whose words hold each marked one: the last that begins there or before.")
op("tile_list", "words starts spilled total marks of_marks faces ranges bases drawn",
   attrs="slots views bins_x bins_y tiles_x tiles_y partial?", reads="texel " * 9 + "count", ref=_tile_list_ref, cost=150,
   sample=_tile_list_sample, functions=_FUNCTIONS, infer=_listed("ivec2"),
   glsl="""{ int s_ = {i}, end_ = {spilled}(ivec2(0)) == 0 ? {total}(ivec2(0)) : 0;
    """ + _FIND + """
    int w_ = low_, c_ = s_ < end_ ? {of_marks_at}(s_ / MARK) : 0, top_ = s_ < end_ ? {of_marks_at}(s_ / MARK + 1) + 1 : 0;
    """.replace("MARK", f"{MARK}") + _OF_BIN + """
    {y} = ivec2(-1);
    int at_ = w_ - {bases_at}(c_), t_ = tile_quotient(max(at_, 0), max(n_, 1));
    int v_ = c_ / ({bins_x} * {bins_y}), in_ = c_ - v_ * ({bins_x} * {bins_y});
    ivec2 tile_ = ivec2(in_ % {bins_x}, in_ / {bins_x}) * 8 + ivec2(t_ % 8, t_ / 8);
    if (high_ > 0) {y} = ivec2({faces_at}(r_.x + (at_ - t_ * n_) * 32 + bit_), (v_ * {tiles_y} + tile_.y) * {tiles_x} + tile_.x);
    if ({spilled}(ivec2(0)) != 0 && s_ < {faces_n}) {y} = ivec2({faces_at}(s_), -1); }""",
   doc="The faces (over views) of every tile, tile by tile, ascending, and which tile. Those of every bin, and -1, where that is "
       "`spilled`. Drawn for as many entries as `drawn` says, undefined after them.")


def _tile_ranges_ref(starts, spilled, total, ranges, bases, tiles_x, tiles_y, views, bins_x, bins_y):
    v, b, a = np.indices((views, tiles_y, tiles_x)).reshape(3, -1)
    c = (v * bins_y + b // SIDE) * bins_x + a // SIDE
    ranges = ranges.reshape(-1, 2)
    if spilled.reshape(-1)[0]:
        return to_table(ranges[c])
    n = (ranges[c, 1] - ranges[c, 0] + WORD - 1) // WORD
    at = bases.reshape(-1)[c] + (b % SIDE * SIDE + a % SIDE) * n
    padded = np.append(starts.reshape(-1), total.reshape(-1)[0])
    ends = [padded[np.minimum(k, starts.size)] for k in (at, at + n)]
    return to_table(np.where(n[:, None] > 0, np.stack(ends, 1), 0))


def _tile_ranges_sample(rng):
    inputs, attrs = _tile_list_sample(rng)
    return [*inputs[1:4], *inputs[7:9]], {key: attrs[key] for key in (*_BINS, "tiles_x", "tiles_y")}


op("tile_ranges", "starts spilled total ranges bases", attrs="tiles_x tiles_y views bins_x bins_y", reads=" ".join(["texel"] * 5),
   ref=_tile_ranges_ref, cost=30, sample=_tile_ranges_sample,
   infer=lambda name, inputs, attrs: ("ivec2", table(attrs["views"] * attrs["tiles_x"] * attrs["tiles_y"])),
   glsl="""{ int at_ = min({i}, {n} - 1), v_ = at_ / ({tiles_x} * {tiles_y}), in_ = at_ - v_ * ({tiles_x} * {tiles_y});
    ivec2 t_ = ivec2(in_ % {tiles_x}, in_ / {tiles_x});
    int c_ = (v_ * {bins_y} + t_.y / 8) * {bins_x} + t_.x / 8;
    ivec2 r_ = {ranges_at}(c_);
    int n_ = (r_.y - r_.x + 31) / 32, w_ = {bases_at}(c_) + (t_.y % 8 * 8 + t_.x % 8) * n_;
    {y} = ivec2(0);
    if ({spilled}(ivec2(0)) != 0) {y} = r_;
    else if (n_ > 0) {y} = ivec2({starts_at}(min(w_, {starts_n} - 1)),
                                 w_ + n_ < {starts_n} ? {starts_at}(min(w_ + n_, {starts_n} - 1)) : {total}(ivec2(0))); }""",
   doc="Which range of the list of faces each tile has; that of its bin where the list is `spilled`.")
