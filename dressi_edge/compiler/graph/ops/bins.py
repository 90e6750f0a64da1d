"""Which faces come near each tile of pixels: lists by tile, in face order, of any length, without atomics and without the host.

In: a half-open box of pixels for each face of each view. Out: a flat list of faces and, for each tile, the range of it that is the tile's.
Two levels, each a count, a scan and a fill. *Bins* are squares of 8 x 8 tiles: one bit says whether a face meets a bin, 32 bits are a
word. A box meets a bin if it meets its column and its row, so there are words of those alone, of four columns or rows side by side a texel
(`sides`); a bin's word is the one and the other. Eight words are a *run*: the numbers of bits in runs are summed up a tree and down again
(`exclusive_scan`), so each slot of the list finds its run by bisection, of few where one of 32 slots has found its own before
(`list_marks`), in it its word and in that its bit. Then the same for the tiles of each bin and the faces of its list. The order of a list
is that of the words: bin (or tile), then face. This module has the first level, `tiles.py` the second.

Every size but those of the two lists is known at compile time. A list that is too short is not cut: where the second would overflow, each
tile gets the faces of its bin, where the first would, those of its view. So nothing is ever left out; it only takes longer.
"""
from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ....cache.errors import GraphError
from ..ir import Node, table
from ..optable import integers, op
from .lookup import to_table

SIDE = 8  # tiles a side of a bin
WORD = 32
RUN = 8  # words whose bits are counted together
FOUR = 4  # columns or rows a texel of `sides` has words of


def _signed(words: np.ndarray) -> np.ndarray:
    return (np.asarray(words, np.int64) + 2 ** 31) % 2 ** 32 - 2 ** 31


def _bits(words: np.ndarray) -> np.ndarray:
    """(n, 32) 0 or 1 of each bit."""
    return (words.reshape(-1, 1) >> np.arange(WORD)) & 1


def fours(count: int) -> int:
    """Texels of four that hold so many columns or rows."""
    return -(-count // FOUR)


op("bit_count", "a", infer=integers, glsl="{y} = bitCount({a});", cost=2,
   ref=lambda a: ((a[..., None] >> np.arange(WORD)) & 1).sum(-1), sample=lambda rng: ([rng.integers(-2 ** 31, 2 ** 31, (4, 5, 2))], {}),
   doc="How many of the 32 bits of an integer are set.")


@dataclass(frozen=True)
class Grid:
    """Views of cell_w x cell_h pixels, `columns` in a row of the atlas, of `faces` faces each, in tiles of so many pixels. Tiles and bins
    are numbered view by view and within a view row by row; those at the right and lower border may be larger than what is left."""

    views: int
    faces: int
    cell_w: int
    cell_h: int
    columns: int
    tile: tuple[int, int]

    def _across(self, width: int, height: int) -> tuple[int, int]:
        return -(-self.cell_w // width), -(-self.cell_h // height)

    @property
    def tiles(self) -> tuple[int, int]:
        """Tiles across and down a view."""
        return self._across(*self.tile)

    @property
    def bins(self) -> tuple[int, int]:
        """Bins across and down a view."""
        return self._across(*self.bin)

    @property
    def bin(self) -> tuple[int, int]:
        """Pixels of a bin."""
        return self.tile[0] * SIDE, self.tile[1] * SIDE

    @property
    def words(self) -> int:
        """Words of a bin, one for 32 faces of its view, in whole runs."""
        return self.runs * RUN

    @property
    def runs(self) -> int:
        """Runs of a bin."""
        return -(-self.faces // (WORD * RUN))

    @property
    def attrs(self) -> dict:
        """As the ops want them."""
        return {"views": self.views, "face_count": self.faces, "cell_w": self.cell_w, "cell_h": self.cell_h, "columns": self.columns,
                "bins_x": self.bins[0], "bins_y": self.bins[1], "words": self.words, "tile_w": self.tile[0], "tile_h": self.tile[1]}


_GRID = "views face_count cell_w cell_h columns bins_x bins_y words tile_w tile_h"


def _corner(view: int, cell_w: int, cell_h: int, columns: int) -> tuple[int, int]:
    return view % columns * cell_w, view // columns * cell_h


def _packed(flags: np.ndarray) -> np.ndarray:
    """(n, 32 k) flags as n k words."""
    return _signed((flags.reshape(-1, WORD).astype(np.int64) << np.arange(WORD)).sum(1))


def _spans(boxes: np.ndarray, axis: int, first: int, width: int) -> np.ndarray:
    return (boxes[..., axis] < first + width) & (boxes[..., axis + 2] > first)


def _bin_sides_ref(boxes, views, face_count, cell_w, cell_h, columns, bins_x, bins_y, words, tile_w, tile_h):
    boxes, across = boxes.reshape(-1, 4)[:views * face_count].reshape(views, face_count, 4), FOUR * fours(bins_x)
    out = np.zeros((views, fours(bins_x) + fours(bins_y), words, FOUR), np.int64)
    for v, k in np.ndindex(views, across + FOUR * fours(bins_y)):
        axis, flags = int(k >= across), np.zeros(words * WORD, bool)
        width = (tile_h if axis else tile_w) * SIDE
        first = _corner(v, cell_w, cell_h, columns)[axis] + (k - axis * across) * width
        flags[:face_count] = _spans(boxes[v], axis, first, width)
        out[v, k // FOUR, :, k % FOUR] = _packed(flags)
    return to_table(out.reshape(-1, FOUR))


def _crossed(sides: np.ndarray, across: int) -> np.ndarray:
    """Words (..., row, column, word) of sides (..., texels, word, 4), of which the first `across` are columns."""
    of = np.moveaxis(sides, -1, -2)
    columns, rows = (x.reshape(*x.shape[:-3], x.shape[-3] * FOUR, x.shape[-1]) for x in (of[..., :across, :, :], of[..., across:, :, :]))
    return rows[..., :, None, :] & columns[..., None, :, :]


def _bin_words(sides, views, bins_x, bins_y, words):
    """(view, row, column, word), four times as many rows and columns as texels of them."""
    across, down = fours(bins_x), fours(bins_y)
    return _crossed(sides.reshape(-1, FOUR)[:views * (across + down) * words].reshape(views, across + down, words, FOUR), across)


def _run_bits(words: np.ndarray) -> np.ndarray:
    """How many bits are set in each run (..., words)."""
    return _bits(words).sum(1).reshape(*words.shape[:-1], -1, RUN).sum(-1)


def _bin_counts_ref(sides, views, bins_x, bins_y, words):
    counts = _run_bits(_bin_words(sides, views, bins_x, bins_y, words)[:, :bins_y])
    return to_table(np.moveaxis(counts.reshape(views, bins_y, -1, FOUR, words // RUN), 3, -1).reshape(-1, FOUR))


def _bin_runs_ref(counts, views, bins_x, bins_y, words):
    across, runs = fours(bins_x), words // RUN
    counts = counts.reshape(-1, FOUR)[:views * bins_y * across * runs].reshape(views, bins_y, across, runs, FOUR)
    return to_table(np.moveaxis(counts, -1, 3).reshape(views, bins_y, -1, runs)[:, :, :bins_x].reshape(-1))


def _bin_sides_infer(name, inputs, attrs):
    if inputs[0].vtype != "ivec4" or inputs[0].extent.count != attrs["views"] * attrs["face_count"]:
        raise GraphError(f"{name}: boxes are {inputs[0]!r}; an ivec4 table of {attrs['views']} views of {attrs['face_count']} faces is "
                         "needed")
    return "ivec4", table(attrs["views"] * (fours(attrs["bins_x"]) + fours(attrs["bins_y"])) * attrs["words"])


def _needs(name: str, x: Node, what: str, count: int) -> None:
    if x.vtype != "ivec4" or x.extent.count < count:
        raise GraphError(f"{name}: {what} are {x!r}; an ivec4 table of at least {count} entries is needed")


def _bin_counts_infer(name, inputs, attrs):
    views, x, y = attrs["views"], fours(attrs["bins_x"]), attrs["bins_y"]
    _needs(name, inputs[0], "sides", views * (x + fours(y)) * attrs["words"])
    return "ivec4", table(views * y * x * (attrs["words"] // RUN))


def _bin_runs_infer(name, inputs, attrs):
    views, x, y, runs = attrs["views"], attrs["bins_x"], attrs["bins_y"], attrs["words"] // RUN
    _needs(name, inputs[0], "counts", views * y * fours(x) * runs)
    return "int", table(views * x * y * runs)


# Where bin c lies in the atlas, as q_ (its first pixel).
_BIN_PLACE = """int v_ = c_ / ({bins_x} * {bins_y}), in_ = c_ - v_ * ({bins_x} * {bins_y});
    ivec2 q_ = ivec2(v_ % {columns} * {cell_w}, v_ / {columns} * {cell_h})
             + ivec2(in_ % {bins_x}, in_ / {bins_x}) * ivec2(8 * {tile_w}, 8 * {tile_h});"""


def _sample_grid(views: int = 2, faces: int = 70) -> Grid:
    return Grid(views, faces, 150, 76, 2, (8, 8))


def _sample_boxes(rng, grid: Grid) -> np.ndarray:
    """Boxes within cells, some of them empty."""
    size = np.array([grid.cell_w, grid.cell_h])
    lo = rng.integers(0, size - 10, (grid.views, grid.faces, 2))
    hi = np.minimum(lo + rng.integers(1, 30, lo.shape), size)
    corner = np.array([_corner(v, grid.cell_w, grid.cell_h, grid.columns) for v in range(grid.views)])[:, None]
    boxes = np.concatenate([lo + corner, hi + corner], 2).reshape(-1, 4)
    return to_table(np.where(rng.random((len(boxes), 1)) < 0.1, 0, boxes))


def _sides_sample(rng):
    grid = _sample_grid(faces=300)
    return [_sample_boxes(rng, grid)], grid.attrs


def _some(grid: Grid, *names: str) -> dict:
    return {key: grid.attrs[key] for key in names}


_BINS = ("views", "bins_x", "bins_y")


def _runs_of(boxes: np.ndarray, grid: Grid) -> list[np.ndarray]:
    """Sides and the number of bits of each run."""
    sides, attrs = _bin_sides_ref(boxes, **grid.attrs), _some(grid, *_BINS, "words")
    return [sides, _bin_runs_ref(_bin_counts_ref(sides, **attrs), **attrs)]


def _counts_sample(rng):
    boxes, attrs = _sides_sample(rng)
    return [_bin_sides_ref(*boxes, **attrs)], {key: attrs[key] for key in (*_BINS, "words")}


def _bin_runs_sample(rng):
    sides, attrs = _counts_sample(rng)
    return [_bin_counts_ref(*sides, **attrs)], attrs


# Which of n_ boxes from first_ on meet what lies from q_ on, wide_ pixels each, along an axis: four at once, for a box is what is read.
_SPANNED = """{y} = ivec4(0);
    for (int k_ = 0; k_ < n_; ++k_) {
        ivec4 b_ = {boxes_at}(first_ + k_);
        ivec2 s_ = axis_ == 0 ? b_.xz : b_.yw;
        {y} |= (ivec4(lessThan(ivec4(s_.x), q_ + wide_)) & ivec4(greaterThan(ivec4(s_.y), q_))) << k_;
    }"""
# The bits of a run: the words from x_ on of columns and from y_ on of rows.
_COUNTED = """for (int k_ = 0; k_ < n_; ++k_) {y} += bitCount(WHICH({sides_at}(x_ + k_)) & bins_one({sides_at}(y_ + k_), b_));"""

# Component k of a vector: what drivers have for that is not in every shader that a reader of bundles takes.
_ONE = "int bins_one(ivec4 v, int k) { return k == 0 ? v.x : k == 1 ? v.y : k == 2 ? v.z : v.w; }\n"

op("bin_sides", "boxes", attrs=_GRID, infer=_bin_sides_infer, reads="texel", ref=_bin_sides_ref, cost=200, sample=_sides_sample,
   glsl="""{ int of_ = ({bins_x} + 3) / 4, all_ = of_ + ({bins_y} + 3) / 4, at_ = {i} / {words}, view_ = at_ / all_;
    int side_ = at_ - view_ * all_, axis_ = side_ < of_ ? 0 : 1, face_ = ({i} - at_ * {words}) * 32, first_ = view_ * {face_count} + face_;
    int wide_ = axis_ == 0 ? 8 * {tile_w} : 8 * {tile_h}, cell_ = axis_ == 0 ? view_ % {columns} * {cell_w} : view_ / {columns} * {cell_h};
    int n_ = view_ < {views} ? min({face_count} - face_, 32) : 0;
    ivec4 q_ = cell_ + (4 * (side_ - axis_ * of_) + ivec4(0, 1, 2, 3)) * wide_;
    """ + _SPANNED + """ }""",
   doc="For each column and each row of bins and 32 faces of its view a word: bit k is set if the box of face k meets it. Four columns or "
       "rows side by side a texel.")
op("bin_counts", "sides", attrs="views bins_x bins_y words", infer=_bin_counts_infer, reads="texel", ref=_bin_counts_ref, cost=60,
   sample=_counts_sample, functions=_ONE,
   glsl="""{y} = ivec4(0);
{ int runs_ = {words} / 8, of_ = ({bins_x} + 3) / 4, c_ = {i} / runs_, v_ = c_ / (of_ * {bins_y}), in_ = c_ - v_ * (of_ * {bins_y});
    int row_ = in_ / of_, at_ = v_ * (of_ + ({bins_y} + 3) / 4), b_ = row_ & 3, g_ = ({i} - c_ * runs_) * 8, n_ = {i} < {n} ? 8 : 0;
    int x_ = (at_ + in_ - row_ * of_) * {words} + g_, y_ = (at_ + of_ + row_ / 4) * {words} + g_;
    """ + _COUNTED.replace("WHICH", "") + """ }""",
   doc="For each run of words of the bins of a view how many bits are set, where a face meets the bin: its column and its row. Row by row "
       "of bins, four side by side a texel.")
op("bin_runs", "counts", attrs="views bins_x bins_y words", infer=_bin_runs_infer, reads="texel", ref=_bin_runs_ref, cost=20,
   sample=_bin_runs_sample, functions=_ONE,
   glsl="""{ int runs_ = {words} / 8, c_ = {i} / runs_, row_ = c_ / {bins_x}, column_ = c_ - row_ * {bins_x};
    {y} = {i} < {n} ? bins_one({counts_at}((row_ * (({bins_x} + 3) / 4) + column_ / 4) * runs_ + {i} - c_ * runs_), column_ & 3) : 0; }""",
   doc="The same numbers one a texel, bin by bin.")


def _bin_ranges_ref(starts, spilled, total, views, face_count, bins_x, bins_y, runs):
    bins = views * bins_x * bins_y
    first = starts.reshape(-1)[np.arange(bins) * runs]
    end = np.append(first[1:], total.reshape(-1)[0])
    if spilled.reshape(-1)[0]:
        first = np.arange(bins) // (bins_x * bins_y) * face_count
        end = first + face_count
    return to_table(np.stack([first, end], 1))


op("bin_ranges", "starts spilled total", attrs="views face_count bins_x bins_y runs", reads="texel texel texel", ref=_bin_ranges_ref,
   cost=10, infer=lambda name, inputs, attrs: ("ivec2", table(attrs["views"] * attrs["bins_x"] * attrs["bins_y"])),
   glsl="""{ int all_ = {views} * {bins_x} * {bins_y}, c_ = min({i}, all_ - 1), v_ = c_ / ({bins_x} * {bins_y}) * {face_count};
    {y} = ivec2({starts_at}(c_ * {runs}), c_ + 1 < all_ ? {starts_at}(min(c_ + 1, all_ - 1) * {runs}) : {total}(ivec2(0)));
    if ({spilled}(ivec2(0)) != 0) {y} = ivec2(v_, v_ + {face_count}); }""",
   sample=lambda rng: ([to_table(np.sort(rng.integers(0, 90, 24))), np.array([[[0]]]), np.array([[[95]]])],
                       {"views": 2, "face_count": 70, "bins_x": 2, "bins_y": 2, "runs": 3}),
   doc="Which range of the list of faces each bin has; that of its view's faces where the list is `spilled`.")

MARK = 32  # slots of which the first has its run found beforehand


def _marks_ref(starts, spilled, total, count, slots):
    first, count = np.arange(-(-slots // MARK) + 1) * MARK, count.reshape(-1)[0]
    flat = starts.reshape(-1)[:count]
    return to_table(np.where(first < total.reshape(-1)[0], np.searchsorted(flat, first, side="right") - 1, count - 1))


def _marks_sample(rng):
    return [to_table(np.sort(rng.integers(0, 90, 24) * (np.arange(24) > 0))), np.array([[[0]]]), np.array([[[95]]]), np.array([[[23]]])], {
        "slots": 120}


op("list_marks", "starts spilled total count", attrs="slots", reads="texel texel texel texel", ref=_marks_ref, cost=60,
   sample=_marks_sample, infer=lambda name, inputs, attrs: ("int", table(-(-attrs["slots"] // MARK) + 1)),
   glsl="""{ int s_ = {i} * """ + f"{MARK}" + """, end_ = min({count}(ivec2(0)), {starts_n}), low_ = 0;
    int high_ = {spilled}(ivec2(0)) == 0 && s_ < {total}(ivec2(0)) ? end_ : 0;
    {y} = high_ > 0 ? 0 : end_ - 1;
    while (high_ - low_ > 1) { int mid_ = (low_ + high_) >> 1; if ({starts_at}(mid_) <= s_) low_ = mid_; else high_ = mid_; }
    {y} = high_ > 0 ? low_ : {y}; }""",
   doc="Of each 32nd slot of a list the run in which its entry is: the last of `count` that starts at it or before; past the end the last.")

# The slot's run: the last that starts at it or before.
_FIND = """int low_ = s_ < end_ ? {marks_at}(s_ / MARK) : 0, high_ = s_ < end_ ? {marks_at}(s_ / MARK + 1) + 1 : 0;
    while (high_ - low_ > 1) { int mid_ = (low_ + high_) >> 1; if ({starts_at}(mid_) <= s_) low_ = mid_; else high_ = mid_; }
""".replace("MARK", f"{MARK}")
# In it its word: the j_-th from x_ on of column a_ and from y_ on of row b_. In that the bit of the slot's number.
_IN_RUN = """
    int rank_ = high_ > 0 ? s_ - {starts_at}(low_) : 0, last_ = high_ > 0 ? 7 : 0, j_ = 0, bit_ = 0, up_;
    int set_ = high_ > 0 ? WORD : 0, m_ = bitCount(set_);
    while (rank_ >= m_ && j_ < last_) { rank_ -= m_; ++j_; set_ = WORD; m_ = bitCount(set_); }
""".replace("WORD", "bins_one({sides_at}(x_ + j_), a_) & bins_one({sides_at}(y_ + j_), b_)") + "".join("""
    m_ = bitCount(set_ >> bit_ & ((1 << HALF) - 1)); up_ = rank_ >= m_ ? 1 : 0; rank_ -= up_ * m_; bit_ += up_ * HALF;
    """.replace("HALF", str(half)) for half in (16, 8, 4, 2, 1))


def _slots_ref(words, total):
    """(word, bit) of each set bit in order."""
    word, bit = np.nonzero(_bits(words.reshape(-1)))
    assert len(word) == total.reshape(-1)[0]
    return word, bit


def _filled(entries: np.ndarray, slots: int) -> np.ndarray:
    return to_table(np.concatenate([entries[:slots], np.full(max(slots - len(entries), 0), -1, np.int64)]), -1)


def _bin_list_ref(sides, starts, spilled, total, marks, drawn, slots, views, face_count, bins_x, bins_y, words, partial=0):
    if spilled.reshape(-1)[0]:
        return _filled(np.arange(views * face_count), slots)
    word, bit = _slots_ref(_bin_words(sides, views, bins_x, bins_y, words)[:, :bins_y, :bins_x], total)
    c, g = np.divmod(word, words)
    return _filled(c // (bins_x * bins_y) * face_count + g * WORD + bit, slots)


def _scanned(counts: np.ndarray, slots: int) -> list[np.ndarray]:
    """starts, spilled, total of the numbers of bits of runs."""
    flat = counts.reshape(-1)
    total = int(flat.sum())
    return [(np.cumsum(flat) - flat).reshape(counts.shape), np.array([[[int(total > slots)]]]), np.array([[[total]]])]


def _bin_list_sample(rng, slots=400):
    grid = _sample_grid()
    sides, runs = _runs_of(_sample_boxes(rng, grid), grid)
    scanned = _scanned(runs, slots)
    marks = _marks_ref(*scanned, np.array(grid.views * grid.bins[0] * grid.bins[1] * grid.runs), slots)
    return [sides, *scanned, marks, np.array([[[0]]])], {**_some(grid, *_BINS, "face_count", "words"), "slots": slots}


def _listed(vtype: str):
    return lambda name, inputs, attrs: (vtype, replace(table(attrs["slots"]), partial=attrs.get("partial", 0)))


op("bin_list", "sides starts spilled total marks drawn", attrs="slots views face_count bins_x bins_y words partial?",
   reads="texel " * 5 + "count", ref=_bin_list_ref, cost=120, infer=_listed("int"), sample=_bin_list_sample,
   functions=_ONE,
   glsl="""{ int s_ = {i}, end_ = {spilled}(ivec2(0)) == 0 ? {total}(ivec2(0)) : 0;
    """ + _FIND + """
    int runs_ = {words} / 8, of_ = ({bins_x} + 3) / 4, all_ = {bins_x} * {bins_y}, c_ = low_ / runs_, v_ = c_ / all_, in_ = c_ - v_ * all_;
    int row_ = in_ / {bins_x}, column_ = in_ - row_ * {bins_x}, at_ = v_ * (of_ + ({bins_y} + 3) / 4), g_ = (low_ - c_ * runs_) * 8;
    int x_ = (at_ + column_ / 4) * {words} + g_, y_ = (at_ + of_ + row_ / 4) * {words} + g_, a_ = column_ & 3, b_ = row_ & 3;
    """ + _IN_RUN + """
    {y} = high_ > 0 ? v_ * {face_count} + (g_ + j_) * 32 + bit_ : -1;
    if ({spilled}(ivec2(0)) != 0 && s_ < {views} * {face_count}) {y} = s_; }""",
   doc="The faces (over views) of every bin, bin by bin, ascending. All faces of all views where that is `spilled`. Drawn for as many "
       "entries as `drawn` says, undefined after them.")
