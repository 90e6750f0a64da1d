"""Which faces come near each tile of pixels: lists by tile, in face order, of any length, without atomics and without the host.

In: a half-open box of pixels for each face of each view. Out: a flat list of faces and, for each tile, the range of it that is the tile's.
Two levels, each a count, a scan and a fill. *Bins* are squares of 8 x 8 tiles: one bit says whether a face meets a bin, 32 bits are a
word, the words of a bin lie next to each other. A box meets a bin if it meets its column and its row, so there are words of those
(`sides`), and a bin's word is the one and the other. The numbers of set bits are summed up a tree and down again (`exclusive_scan`), so
each slot of the list finds its word by bisection, of few words where one of 32 slots has found its own before (`list_marks`), and in it
its bit. Then the same for the tiles of each bin and the faces of its list. The order of a list is that of the words: bin (or tile), then
face. This module has the first level, `tiles.py` the second.

Every size but those of the two lists is known at compile time. A list that is too short is not cut: where the second would overflow, each
tile gets the faces of its bin, where the first would, those of its view. So nothing is ever left out; it only takes longer.
"""
from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ....cache.errors import GraphError
from ..ir import table
from ..optable import integers, op
from .lookup import to_table

SIDE = 8  # tiles a side of a bin
WORD = 32


def _signed(words: np.ndarray) -> np.ndarray:
    return (np.asarray(words, np.int64) + 2 ** 31) % 2 ** 32 - 2 ** 31


def _bits(words: np.ndarray) -> np.ndarray:
    """(n, 32) 0 or 1 of each bit."""
    return (words.reshape(-1, 1) >> np.arange(WORD)) & 1


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
        """Words of a bin: one for 32 faces of its view."""
        return -(-self.faces // WORD)

    @property
    def attrs(self) -> dict:
        """As the ops want them."""
        return {"views": self.views, "face_count": self.faces, "cell_w": self.cell_w, "cell_h": self.cell_h, "columns": self.columns,
                "bins_x": self.bins[0], "bins_y": self.bins[1], "words": self.words, "tile_w": self.tile[0], "tile_h": self.tile[1]}


_GRID = "views face_count cell_w cell_h columns bins_x bins_y words tile_w tile_h"


def _meets(boxes: np.ndarray, x: int, y: int, width: int, height: int) -> np.ndarray:
    return (boxes[:, 0] < x + width) & (boxes[:, 2] > x) & (boxes[:, 1] < y + height) & (boxes[:, 3] > y)


def _corner(view: int, cell_w: int, cell_h: int, columns: int) -> tuple[int, int]:
    return view % columns * cell_w, view // columns * cell_h


def _packed(flags: np.ndarray) -> np.ndarray:
    """(n, 32 k) flags as n k words."""
    return _signed((flags.reshape(-1, WORD).astype(np.int64) << np.arange(WORD)).sum(1))


def _spans(boxes: np.ndarray, axis: int, first: int, width: int) -> np.ndarray:
    return (boxes[..., axis] < first + width) & (boxes[..., axis + 2] > first)


def _bin_sides_ref(boxes, views, face_count, cell_w, cell_h, columns, bins_x, bins_y, words, tile_w, tile_h):
    boxes = boxes.reshape(-1, 4)[:views * face_count].reshape(views, face_count, 4)
    flags = np.zeros((views, bins_x + bins_y, words * WORD), bool)
    for v, k in np.ndindex(views, bins_x + bins_y):
        axis = int(k >= bins_x)
        width = (tile_h if axis else tile_w) * SIDE
        first = _corner(v, cell_w, cell_h, columns)[axis] + (k - axis * bins_x) * width
        flags[v, k, :face_count] = _spans(boxes[v], axis, first, width)
    return to_table(_packed(flags))


def _bin_words_ref(sides, views, bins_x, bins_y, words):
    sides = sides.reshape(-1)[:views * (bins_x + bins_y) * words].reshape(views, bins_x + bins_y, words)
    return to_table((sides[:, None, :bins_x] & sides[:, bins_x:, None]).reshape(-1))


def _bin_sides_infer(name, inputs, attrs):
    if inputs[0].vtype != "ivec4" or inputs[0].extent.count != attrs["views"] * attrs["face_count"]:
        raise GraphError(f"{name}: boxes are {inputs[0]!r}; an ivec4 table of {attrs['views']} views of {attrs['face_count']} faces is "
                         "needed")
    return "int", table(attrs["views"] * (attrs["bins_x"] + attrs["bins_y"]) * attrs["words"])


def _bin_words_infer(name, inputs, attrs):
    count = attrs["views"] * (attrs["bins_x"] + attrs["bins_y"]) * attrs["words"]
    if inputs[0].vtype != "int" or inputs[0].extent.count < count:
        raise GraphError(f"{name}: sides are {inputs[0]!r}; an int table of at least {count} words is needed")
    return "int", table(attrs["views"] * attrs["bins_x"] * attrs["bins_y"] * attrs["words"])


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
    grid = _sample_grid()
    return [_sample_boxes(rng, grid)], grid.attrs


def _some(grid: Grid, *names: str) -> dict:
    return {key: grid.attrs[key] for key in names}


def _words_of(boxes: np.ndarray, grid: Grid) -> np.ndarray:
    return _bin_words_ref(_bin_sides_ref(boxes, **grid.attrs), **_some(grid, "views", "bins_x", "bins_y", "words"))


def _words_sample(rng):
    grid = _sample_grid()
    return [_bin_sides_ref(_sample_boxes(rng, grid), **grid.attrs)], _some(grid, "views", "bins_x", "bins_y", "words")


# Which of n_ boxes from first_ on meet what lies from q_ to e_ along an axis.
_SPANNED = """{y} = 0;
    for (int k_ = 0; k_ < n_; ++k_) {
        ivec4 b_ = {boxes_at}(first_ + k_);
        ivec2 s_ = axis_ == 0 ? b_.xz : b_.yw;
        if (s_.x < e_ && s_.y > q_) {y} |= 1 << k_;
    }"""

op("bin_sides", "boxes", attrs=_GRID, infer=_bin_sides_infer, reads="texel", ref=_bin_sides_ref, cost=200, sample=_sides_sample,
   glsl="""{ int at_ = {i} / {words}, view_ = at_ / ({bins_x} + {bins_y}), side_ = at_ - view_ * ({bins_x} + {bins_y});
    int axis_ = side_ < {bins_x} ? 0 : 1, face_ = ({i} - at_ * {words}) * 32, first_ = view_ * {face_count} + face_;
    int wide_ = axis_ == 0 ? 8 * {tile_w} : 8 * {tile_h}, cell_ = axis_ == 0 ? view_ % {columns} * {cell_w} : view_ / {columns} * {cell_h};
    int q_ = cell_ + (side_ - axis_ * {bins_x}) * wide_, e_ = q_ + wide_, n_ = view_ < {views} ? min({face_count} - face_, 32) : 0;
    """ + _SPANNED + """ }""",
   doc="For each column and each row of bins and 32 faces of its view a word: bit k is set if the box of face k meets it.")
op("bin_words", "sides", attrs="views bins_x bins_y words", infer=_bin_words_infer, reads="texel", ref=_bin_words_ref, cost=20,
   sample=_words_sample,
   glsl="""{ int c_ = {i} / {words}, g_ = {i} - c_ * {words}, v_ = c_ / ({bins_x} * {bins_y}), in_ = c_ - v_ * ({bins_x} * {bins_y});
    int at_ = v_ * ({bins_x} + {bins_y}), row_ = in_ / {bins_x}, column_ = in_ - row_ * {bins_x};
    {y} = {i} < {n} ? {sides_at}((at_ + column_) * {words} + g_) & {sides_at}((at_ + {bins_x} + row_) * {words} + g_) : 0; }""",
   doc="For each bin and 32 faces of its view a word: bit k is set if face k meets the bin: its column and its row.")


def _bin_ranges_ref(starts, spilled, total, views, face_count, bins_x, bins_y, words):
    bins = views * bins_x * bins_y
    first = starts.reshape(-1)[np.arange(bins) * words]
    end = np.append(first[1:], total.reshape(-1)[0])
    if spilled.reshape(-1)[0]:
        first = np.arange(bins) // (bins_x * bins_y) * face_count
        end = first + face_count
    return to_table(np.stack([first, end], 1))


op("bin_ranges", "starts spilled total", attrs="views face_count bins_x bins_y words", reads="texel texel texel", ref=_bin_ranges_ref,
   cost=10, infer=lambda name, inputs, attrs: ("ivec2", table(attrs["views"] * attrs["bins_x"] * attrs["bins_y"])),
   glsl="""{ int all_ = {views} * {bins_x} * {bins_y}, c_ = min({i}, all_ - 1), v_ = c_ / ({bins_x} * {bins_y}) * {face_count};
    {y} = ivec2({starts_at}(c_ * {words}), c_ + 1 < all_ ? {starts_at}(min(c_ + 1, all_ - 1) * {words}) : {total}(ivec2(0)));
    if ({spilled}(ivec2(0)) != 0) {y} = ivec2(v_, v_ + {face_count}); }""",
   sample=lambda rng: ([to_table(np.sort(rng.integers(0, 90, 24))), np.array([[[0]]]), np.array([[[95]]])],
                       {"views": 2, "face_count": 70, "bins_x": 2, "bins_y": 2, "words": 3}),
   doc="Which range of the list of faces each bin has; that of its view's faces where the list is `spilled`.")

MARK = 32  # slots of which the first has its word found beforehand


def _marks_ref(starts, spilled, total, slots):
    first = np.arange(-(-slots // MARK) + 1) * MARK
    flat = starts.reshape(-1)
    return to_table(np.where(first < total.reshape(-1)[0], np.searchsorted(flat, first, side="right") - 1, len(flat) - 1))


def _marks_sample(rng):
    return [to_table(np.sort(rng.integers(0, 90, 24) * (np.arange(24) > 0))), np.array([[[0]]]), np.array([[[95]]])], {"slots": 120}


op("list_marks", "starts spilled total", attrs="slots", reads="texel texel texel", ref=_marks_ref, cost=60, sample=_marks_sample,
   infer=lambda name, inputs, attrs: ("int", table(-(-attrs["slots"] // MARK) + 1)),
   glsl="""{ int s_ = {i} * """ + f"{MARK}" + """, low_ = 0, high_ = {spilled}(ivec2(0)) == 0 && s_ < {total}(ivec2(0)) ? {starts_n} : 0;
    {y} = high_ > 0 ? 0 : {starts_n} - 1;
    while (high_ - low_ > 1) { int mid_ = (low_ + high_) >> 1; if ({starts_at}(mid_) <= s_) low_ = mid_; else high_ = mid_; }
    {y} = high_ > 0 ? low_ : {y}; }""",
   doc="Of each 32nd slot of a list the word in which its entry is: the last that starts at it or before; past the end the last word.")

# The slot's word (the last that starts at it or before) and in it the bit of that number.
_FIND = """int low_ = s_ < end_ ? {marks_at}(s_ / MARK) : 0, high_ = s_ < end_ ? {marks_at}(s_ / MARK + 1) + 1 : 0;
    while (high_ - low_ > 1) { int mid_ = (low_ + high_) >> 1; if ({starts_at}(mid_) <= s_) low_ = mid_; else high_ = mid_; }
    int set_ = high_ > 0 ? {words_at}(low_) : 0, rank_ = high_ > 0 ? s_ - {starts_at}(low_) : 0, bit_ = 0, m_, up_;
""".replace("MARK", f"{MARK}") + "".join("""
    m_ = bitCount(set_ >> bit_ & ((1 << HALF) - 1)); up_ = rank_ >= m_ ? 1 : 0; rank_ -= up_ * m_; bit_ += up_ * HALF;
    """.replace("HALF", str(half)) for half in (16, 8, 4, 2, 1))


def _slots_ref(words, total):
    """(word, bit) of each set bit in order."""
    word, bit = np.nonzero(_bits(words.reshape(-1)))
    assert len(word) == total.reshape(-1)[0]
    return word, bit


def _filled(entries: np.ndarray, slots: int) -> np.ndarray:
    return to_table(np.concatenate([entries[:slots], np.full(max(slots - len(entries), 0), -1, np.int64)]), -1)


def _bin_list_ref(words, starts, spilled, total, marks, drawn, slots, views, face_count, bins_x, bins_y, per_bin, partial=0):
    if spilled.reshape(-1)[0]:
        return _filled(np.arange(views * face_count), slots)
    word, bit = _slots_ref(words, total)
    c, g = np.divmod(word, per_bin)
    return _filled(c // (bins_x * bins_y) * face_count + g * WORD + bit, slots)


def _scanned(words: np.ndarray, slots: int) -> list[np.ndarray]:
    """starts, spilled, total of words."""
    counts = _bits(words.reshape(-1)).sum(1)
    total = int(counts.sum())
    return [(np.cumsum(counts) - counts).reshape(words.shape), np.array([[[int(total > slots)]]]), np.array([[[total]]])]


def _bin_list_sample(rng, slots=400):
    grid = _sample_grid()
    words = _words_of(_sample_boxes(rng, grid), grid)
    attrs, scanned = _some(grid, "views", "face_count", "bins_x", "bins_y"), _scanned(words, slots)
    return [words, *scanned, _marks_ref(*scanned, slots), np.array([[[0]]])], {**attrs, "per_bin": grid.words, "slots": slots}


def _listed(vtype: str):
    return lambda name, inputs, attrs: (vtype, replace(table(attrs["slots"]), partial=attrs.get("partial", 0)))


op("bin_list", "words starts spilled total marks drawn", attrs="slots views face_count bins_x bins_y per_bin partial?",
   reads="texel " * 5 + "count", ref=_bin_list_ref, cost=120, infer=_listed("int"), sample=_bin_list_sample,
   glsl="""{ int s_ = {i}, end_ = {spilled}(ivec2(0)) == 0 ? {total}(ivec2(0)) : 0;
    """ + _FIND + """
    {y} = high_ > 0 ? low_ / ({per_bin} * {bins_x} * {bins_y}) * {face_count} + low_ % {per_bin} * 32 + bit_ : -1;
    if ({spilled}(ivec2(0)) != 0 && s_ < {views} * {face_count}) {y} = s_; }""",
   doc="The faces (over views) of every bin, bin by bin, ascending. All faces of all views where that is `spilled`. Drawn for as many "
       "entries as `drawn` says, undefined after them.")
