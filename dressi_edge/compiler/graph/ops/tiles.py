"""Which faces come near each tile: the second level of `bins.py`, tiles of bins in the place of bins of views.

In: boxes in the order of the bins' list, the bins' ranges in it. Runs of a bin's 64 tiles, 256 entries of its list each, are numbered tile
by tile from the bin's `base` on; words of the tiles' columns and rows, four side by side a texel, lie from half of it on. Out: the list of
all tiles, and each tile's range.
"""
from __future__ import annotations

import numpy as np

from ..ir import table
from ..optable import op
from .bins import (
    _BIN_PLACE,
    _BINS,
    _COUNTED,
    _FIND,
    _GRID,
    _IN_RUN,
    _ONE,
    _SPANNED,
    FOUR,
    MARK,
    RUN,
    SIDE,
    WORD,
    _bin_list_ref,
    _bin_ranges_ref,
    _corner,
    _crossed,
    _filled,
    _listed,
    _marks_ref,
    _packed,
    _run_bits,
    _runs_of,
    _sample_boxes,
    _sample_grid,
    _scanned,
    _slots_ref,
    _some,
    _spans,
)
from .lookup import to_table

TILES = SIDE * SIDE  # of a bin


def _each_bin(ranges, bases, views, bins_x, bins_y):
    """(bin, its view, column, row, range, runs of a tile, first run) of each."""
    for c, (first, end) in enumerate(ranges.reshape(-1, 2)[:views * bins_x * bins_y]):
        view, rest = divmod(c, bins_x * bins_y)
        yield view, rest % bins_x, rest // bins_x, first, end, -(-(end - first) // (WORD * RUN)), bases.reshape(-1)[c]


def _put(out: np.ndarray, at: int, rows: np.ndarray) -> None:
    rows = rows[:max(len(out) - at, 0)]
    out[at:at + len(rows)] = rows


def _tile_sides_ref(boxes, ranges, bases, drawn, slots, views, face_count, cell_w, cell_h, columns, bins_x, bins_y, words, tile_w, tile_h,
                    partial=0):
    out, boxes = np.zeros((slots, FOUR), np.int64), boxes.reshape(-1, 4)
    for view, a, b, first, end, n, base in _each_bin(ranges, bases, views, bins_x, bins_y):
        corner = np.array(_corner(view, cell_w, cell_h, columns)) + (a * tile_w * SIDE, b * tile_h * SIDE)
        own = np.zeros((2 * SIDE, n * RUN), np.int64)
        for k in range(2 * SIDE):
            axis, width = k // SIDE, (tile_w, tile_h)[k // SIDE]
            flags = np.zeros(n * RUN * WORD, bool)
            flags[:end - first] = _spans(boxes[first:end], axis, corner[axis] + k % SIDE * width, width)
            own[k] = _packed(flags)
        _put(out, base // 2, own.reshape(2 * SIDE // FOUR, FOUR, n * RUN).transpose(0, 2, 1).reshape(-1, FOUR))
    return to_table(out)


def _tile_words(sides, base, n):
    """(row, column, word) of a bin whose tiles have n runs, the first of them `base`."""
    own = np.zeros((2 * SIDE // FOUR * n * RUN, FOUR), np.int64)
    _put(own, 0, sides.reshape(-1, FOUR)[base // 2:base // 2 + len(own)])
    return _crossed(own.reshape(2 * SIDE // FOUR, n * RUN, FOUR), SIDE // FOUR)


def _tile_runs_ref(sides, ranges, bases, drawn, slots, views, bins_x, bins_y, partial=0):
    out = np.zeros(slots, np.int64)
    for *_, n, base in _each_bin(ranges, bases, views, bins_x, bins_y):
        _put(out, base, _run_bits(_tile_words(sides, base, n)).reshape(-1))
    return to_table(out)


# a / n of what is not negative, without the division of integers that many machines do one number after the other.
_FUNCTIONS = """
int tile_quotient(int a, int n) {
    int q = int(float(a) / float(n));
    q -= q * n > a ? 1 : 0;
    return (q + 1) * n <= a ? q + 1 : q;
}
"""

# The bin of run w_ of the tiles: c_, from c_ to before top_; with its range r_, runs a tile n_.
_OF_BIN = """while (top_ - c_ > 1) { int mid_ = (c_ + top_) >> 1; if ({bases_at}(mid_) <= w_) c_ = mid_; else top_ = mid_; }
    ivec2 r_ = {ranges_at}(c_);
    int n_ = (r_.y - r_.x + 255) / 256;"""
# Its tile t_, and where the words of that run lie: of columns from x_ on, of rows from y_ on.
_OF_TILE = """int base_ = {bases_at}(c_), at_ = w_ - base_, t_ = tile_quotient(max(at_, 0), max(n_, 1)), g_ = (at_ - t_ * n_) * 8;
    int a_ = t_ & 3, b_ = t_ >> 3 & 3, x_ = base_ / 2 + (t_ >> 2 & 1) * n_ * 8 + g_, y_ = base_ / 2 + (2 + (t_ >> 5)) * n_ * 8 + g_;"""


def _tile_sample(rng, slots=400, faces=70):
    """Faces of bins, ranges, bases; the boxes of those faces; how many runs tiles have."""
    grid = _sample_grid(faces=faces)
    boxes = _sample_boxes(rng, grid)
    sides, runs = _runs_of(boxes, grid)
    scanned = _scanned(runs, slots)
    attrs = _some(grid, *_BINS, "face_count")
    faces = _bin_list_ref(sides, *scanned, None, None, slots=slots, words=grid.words, **attrs)
    ranges = _bin_ranges_ref(*scanned, runs=grid.runs, **attrs)
    n = [TILES * k for *_, k, _ in _each_bin(ranges, np.zeros(99, int), *(attrs[key] for key in _BINS))]
    return grid, [faces, ranges, to_table(np.cumsum(n) - n)], to_table(boxes.reshape(-1, 4)[faces.reshape(-1)]), int(np.sum(n))


def _drawn(count: int) -> np.ndarray:
    return np.array([[[count]]])


def _tile_sides_sample(rng):
    grid, inputs, boxes, count = _tile_sample(rng, 2400, 400)
    return [boxes, *inputs[1:], _drawn(count // 2)], {**grid.attrs, "slots": count // 2 + 20}


def _tile_runs_sample(rng):
    grid, inputs, boxes, count = _tile_sample(rng, 2400, 400)
    sides = _tile_sides_ref(boxes, *inputs[1:], None, **grid.attrs, slots=count // 2)
    return [sides, *inputs[1:], _drawn(count)], {**_some(grid, *_BINS), "slots": count + 20}


op("tile_sides", "boxes ranges bases drawn", attrs="slots partial? " + _GRID, reads="texel texel texel count", ref=_tile_sides_ref,
   cost=300, functions=_FUNCTIONS, infer=_listed("ivec4"), sample=_tile_sides_sample,
   glsl="""{ int w_ = {i} * 2, c_ = 0, top_ = {bases_n};
    """ + _OF_BIN + _BIN_PLACE.replace("q_", "o_") + """
    int at_ = {i} - {bases_at}(c_) / 2, t_ = n_ > 0 ? tile_quotient(max(at_, 0), n_ * 8) : 4;
    int first_ = r_.x + (at_ - t_ * n_ * 8) * 32, axis_ = t_ < 2 ? 0 : 1, wide_ = axis_ == 0 ? {tile_w} : {tile_h};
    ivec4 q_ = (axis_ == 0 ? o_.x : o_.y) + ((t_ & 1) * 4 + ivec4(0, 1, 2, 3)) * wide_;
    n_ = t_ < 4 && {i} < {n} ? min(r_.y - first_, 32) : 0;
    """ + _SPANNED + """ }""",
   doc="For each of the eight columns and the eight rows of tiles of a bin and 32 entries of its list a word: bit k is set if box k, in "
       "the order of the list, meets it. Four of them a texel; those of a bin lie from half of `bases` on. Drawn for as many as `drawn` "
       "says, undefined after them.")
op("tile_runs", "sides ranges bases drawn", attrs="slots views bins_x bins_y partial?", reads="texel texel texel count",
   ref=_tile_runs_ref, cost=60, functions=_ONE + _FUNCTIONS, infer=_listed("int"), sample=_tile_runs_sample,
   glsl="""{ int w_ = {i}, c_ = 0, top_ = {bases_n};
    """ + _OF_BIN + _OF_TILE + """
    {y} = 0;
    n_ = at_ >= 0 && t_ < 64 && n_ > 0 && {i} < {n} ? 8 : 0;
    """ + _COUNTED.replace("WHICH({sides_at}(x_ + k_))", "bins_one({sides_at}(x_ + k_), a_)") + """ }""",
   doc="For each tile and 256 entries of its bin's list how many of those meet the tile: its column and its row. Those of a bin's 64 tiles "
       "lie from `bases` on. Drawn for as many as `drawn` says, undefined after them.")


def _mark_bins_ref(marks, bases, bins):
    flat = bases.reshape(-1)[:bins]
    return np.clip(np.searchsorted(flat, marks, side="right") - 1, 0, None)


def _tile_list_ref(sides, starts, spilled, total, marks, of_marks, faces, ranges, bases, drawn, slots, views, bins_x, bins_y, tiles_x,
                   tiles_y, partial=0):
    if spilled.reshape(-1)[0]:
        listed = _filled(faces.reshape(-1), slots)
        return np.concatenate([listed, np.full_like(listed, -1)], 2)
    listed, tiles = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    for view, a, b, first, _, n, base in _each_bin(ranges, bases, views, bins_x, bins_y):
        words = _tile_words(sides, base, n)
        word, bit = _slots_ref(words, words * 0 + _run_bits(words).sum()) if n else (tiles[0], tiles[0])
        t = word // max(n * RUN, 1)
        listed.append(faces.reshape(-1)[first + word % max(n * RUN, 1) * WORD + bit])
        tiles.append((view * tiles_y + b * SIDE + t // SIDE) * tiles_x + a * SIDE + t % SIDE)
    return np.concatenate([_filled(np.concatenate(x), slots) for x in (listed, tiles)], 2)


def _tile_list_sample(rng, slots=1200):
    grid, inputs, boxes, count = _tile_sample(rng)
    sides = _tile_sides_ref(boxes, *inputs[1:], None, **grid.attrs, slots=count // 2)
    runs = _tile_runs_ref(sides, *inputs[1:], None, **_some(grid, *_BINS), slots=count)
    scanned = _scanned(runs, slots)
    marks, count = _marks_ref(*scanned, np.array(count), slots), grid.views * grid.bins[0] * grid.bins[1]
    return [sides, *scanned, marks, _mark_bins_ref(marks, inputs[2], count), *inputs, _drawn(0)], {
        "slots": slots, **_some(grid, *_BINS), "tiles_x": grid.tiles[0], "tiles_y": grid.tiles[1]}


op("mark_bins", "marks bases", attrs="bins", reads="own texel", ref=_mark_bins_ref, cost=30,
   infer=lambda name, inputs, attrs: ("int", inputs[0].extent),
   sample=lambda rng: ([to_table(np.sort(rng.integers(0, 90, 15))), to_table(np.sort(rng.integers(0, 90, 9) * (np.arange(9) > 0)))],
                       {"bins": 9}),
   glsl="""{ int w_ = {marks}, top_ = {bins};
    {y} = 0;
    while (top_ - {y} > 1) { int mid_ = ({y} + top_) >> 1; if ({bases_at}(mid_) <= w_) {y} = mid_; else top_ = mid_; } }""",
   doc="The bin whose runs hold each marked one: the last that begins there or before.")
op("tile_list", "sides starts spilled total marks of_marks faces ranges bases drawn",
   attrs="slots views bins_x bins_y tiles_x tiles_y partial?", reads="texel " * 9 + "count", ref=_tile_list_ref, cost=150,
   sample=_tile_list_sample, functions=_ONE + _FUNCTIONS, infer=_listed("ivec2"),
   glsl="""{ int s_ = {i}, end_ = {spilled}(ivec2(0)) == 0 ? {total}(ivec2(0)) : 0;
    """ + _FIND + """
    int w_ = low_, c_ = s_ < end_ ? {of_marks_at}(s_ / MARK) : 0, top_ = s_ < end_ ? {of_marks_at}(s_ / MARK + 1) + 1 : 0;
    """.replace("MARK", f"{MARK}") + _OF_BIN + _OF_TILE + _IN_RUN + """
    {y} = ivec2(-1);
    int v_ = c_ / ({bins_x} * {bins_y}), in_ = c_ - v_ * ({bins_x} * {bins_y});
    ivec2 tile_ = ivec2(in_ % {bins_x}, in_ / {bins_x}) * 8 + ivec2(t_ % 8, t_ / 8);
    if (high_ > 0) {y} = ivec2({faces_at}(r_.x + (g_ + j_) * 32 + bit_), (v_ * {tiles_y} + tile_.y) * {tiles_x} + tile_.x);
    if ({spilled}(ivec2(0)) != 0 && s_ < {faces_n}) {y} = ivec2({faces_at}(s_), -1); }""",
   doc="The faces (over views) of every tile, tile by tile, ascending, and which tile. Those of every bin, and -1, where that is "
       "`spilled`. Drawn for as many entries as `drawn` says, undefined after them.")


def _tile_ranges_ref(starts, spilled, total, ranges, bases, needed, tiles_x, tiles_y, views, bins_x, bins_y):
    v, b, a = np.indices((views, tiles_y, tiles_x)).reshape(3, -1)
    c = (v * bins_y + b // SIDE) * bins_x + a // SIDE
    ranges = ranges.reshape(-1, 2)
    if spilled.reshape(-1)[0]:
        return to_table(ranges[c])
    n = (ranges[c, 1] - ranges[c, 0] + WORD * RUN - 1) // (WORD * RUN)
    at, count = bases.reshape(-1)[c] + (b % SIDE * SIDE + a % SIDE) * n, needed.reshape(-1)[0]
    padded = np.append(starts.reshape(-1)[:count], total.reshape(-1)[0])
    ends = [padded[np.minimum(k, len(padded) - 1)] for k in (at, at + n)]
    return to_table(np.where(n[:, None] > 0, np.stack(ends, 1), 0))


def _tile_ranges_sample(rng):
    inputs, attrs = _tile_list_sample(rng)
    needed = TILES * sum(n for *_, n, _ in _each_bin(*inputs[7:9], *(attrs[key] for key in _BINS)))
    return [*inputs[1:4], *inputs[7:9], _drawn(needed)], {key: attrs[key] for key in (*_BINS, "tiles_x", "tiles_y")}


op("tile_ranges", "starts spilled total ranges bases needed", attrs="tiles_x tiles_y views bins_x bins_y", reads=" ".join(["texel"] * 6),
   ref=_tile_ranges_ref, cost=30, sample=_tile_ranges_sample,
   infer=lambda name, inputs, attrs: ("ivec2", table(attrs["views"] * attrs["tiles_x"] * attrs["tiles_y"])),
   glsl="""{ int at_ = min({i}, {n} - 1), v_ = at_ / ({tiles_x} * {tiles_y}), in_ = at_ - v_ * ({tiles_x} * {tiles_y});
    ivec2 t_ = ivec2(in_ % {tiles_x}, in_ / {tiles_x});
    int c_ = (v_ * {bins_y} + t_.y / 8) * {bins_x} + t_.x / 8;
    ivec2 r_ = {ranges_at}(c_);
    int n_ = (r_.y - r_.x + 255) / 256, w_ = {bases_at}(c_) + (t_.y % 8 * 8 + t_.x % 8) * n_, end_ = min({needed}(ivec2(0)), {starts_n});
    {y} = ivec2(0);
    if ({spilled}(ivec2(0)) != 0) {y} = r_;
    else if (n_ > 0) {y} = ivec2({starts_at}(min(w_, {starts_n} - 1)),
                                 w_ + n_ < end_ ? {starts_at}(min(w_ + n_, {starts_n} - 1)) : {total}(ivec2(0))); }""",
   doc="Which range of the list of faces each tile has; that of its bin where the list is `spilled`. needed: how many runs there are.")
