"""Which faces come near each tile of pixels: lists by tile, in face order, of any length, without atomics and without the host.

In: a half-open box of pixels for each face of each view. Out: a flat list of faces and, for each tile, the range of it that is the tile's.
Two levels, each a count, a scan and a fill. *Bins* are squares of 8 x 8 tiles: one bit says whether a face meets a bin, 32 bits are a
word, the words of a bin lie next to each other. The numbers of set bits are summed up a tree and down again (`exclusive_scan`), so each
slot of the list finds its word by bisection and in it its bit. Then the same for the tiles of each bin and the faces of its list.
The order of a list is that of the words: bin (or tile), then face.

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


def _bin_words_ref(boxes, views, face_count, cell_w, cell_h, columns, bins_x, bins_y, words, tile_w, tile_h):
    boxes = boxes.reshape(-1, 4)[:views * face_count].reshape(views, face_count, 4)
    flags = np.zeros((views, bins_y, bins_x, words * WORD), bool)
    w, h = tile_w * SIDE, tile_h * SIDE
    for v, b, a in np.ndindex(views, bins_y, bins_x):
        x, y = _corner(v, cell_w, cell_h, columns)
        flags[v, b, a, :face_count] = _meets(boxes[v], x + a * w, y + b * h, w, h)
    return to_table(_packed(flags))


def _bin_words_infer(name, inputs, attrs):
    if inputs[0].vtype != "ivec4" or inputs[0].extent.count != attrs["views"] * attrs["face_count"]:
        raise GraphError(f"{name}: boxes are {inputs[0]!r}; an ivec4 table of {attrs['views']} views of {attrs['face_count']} faces is "
                         "needed")
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


def _words_sample(rng):
    grid = _sample_grid()
    return [_sample_boxes(rng, grid)], grid.attrs


op("bin_words", "boxes", attrs=_GRID, infer=_bin_words_infer, reads="texel", ref=_bin_words_ref, cost=200, sample=_words_sample,
   glsl="""{ int c_ = {i} / {words}, first_ = ({i} - c_ * {words}) * 32;
    """ + _BIN_PLACE + """
    ivec2 e_ = q_ + ivec2(8 * {tile_w}, 8 * {tile_h});
    int n_ = v_ < {views} ? min({face_count} - first_, 32) : 0;
    {y} = 0;
    for (int k_ = 0; k_ < n_; ++k_) {
        ivec4 b_ = {boxes_at}(v_ * {face_count} + first_ + k_);
        if (b_.x < e_.x && b_.z > q_.x && b_.y < e_.y && b_.w > q_.y) {y} |= 1 << k_;
    } }""",
   doc="For each bin and 32 faces of its view a word: bit k is set if the box of face k meets the bin.")


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

# The slot's word (the last that starts at it or before) and in it the bit of that number.
_FIND = """int low_ = 0, high_ = s_ < end_ ? {words_n} : 0;
    while (high_ - low_ > 1) { int mid_ = (low_ + high_) >> 1; if ({starts_at}(mid_) <= s_) low_ = mid_; else high_ = mid_; }
    int set_ = high_ > 0 ? {words_at}(low_) : 0, rank_ = high_ > 0 ? s_ - {starts_at}(low_) : 0, bit_ = 0;
    for (int h_ = high_ > 0 ? 16 : 0; h_ > 0; h_ >>= 1) {
        int n_ = bitCount(set_ >> bit_ & ((1 << h_) - 1));
        if (rank_ >= n_) { rank_ -= n_; bit_ += h_; }
    }"""


def _slots_ref(words, total):
    """(word, bit) of each set bit in order."""
    word, bit = np.nonzero(_bits(words.reshape(-1)))
    assert len(word) == total.reshape(-1)[0]
    return word, bit


def _filled(entries: np.ndarray, slots: int) -> np.ndarray:
    return to_table(np.concatenate([entries[:slots], np.full(max(slots - len(entries), 0), -1, np.int64)]), -1)


def _bin_list_ref(words, starts, spilled, total, slots, views, face_count, bins_x, bins_y, per_bin):
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
    words = _bin_words_ref(_sample_boxes(rng, grid), **grid.attrs)
    attrs = {key: grid.attrs[key] for key in ("views", "face_count", "bins_x", "bins_y")}
    return [words, *_scanned(words, slots)], {**attrs, "per_bin": grid.words, "slots": slots}


op("bin_list", "words starts spilled total", attrs="slots views face_count bins_x bins_y per_bin", reads="texel texel texel texel",
   ref=_bin_list_ref, cost=120, infer=lambda name, inputs, attrs: ("int", table(attrs["slots"])), sample=_bin_list_sample,
   glsl="""{ int s_ = {i}, end_ = {spilled}(ivec2(0)) == 0 ? {total}(ivec2(0)) : 0;
    """ + _FIND + """
    {y} = high_ > 0 ? low_ / ({per_bin} * {bins_x} * {bins_y}) * {face_count} + low_ % {per_bin} * 32 + bit_ : -1;
    if ({spilled}(ivec2(0)) != 0 && s_ < {views} * {face_count}) {y} = s_; }""",
   doc="The faces (over views) of every bin, bin by bin, ascending; -1 after the last. All faces of all views where that is `spilled`.")


def _tile_words_of(ranges: np.ndarray) -> np.ndarray:
    """Words of each bin's tiles."""
    return (ranges[:, 1] - ranges[:, 0] + WORD - 1) // WORD * SIDE * SIDE


def _tile_words_ref(boxes, ranges, bases, slots, views, face_count, cell_w, cell_h, columns, bins_x, bins_y, words, tile_w, tile_h):
    out, boxes = np.zeros(slots, np.int64), boxes.reshape(-1, 4)
    ranges, bases = ranges.reshape(-1, 2)[:views * bins_x * bins_y], bases.reshape(-1)
    for c, (first, end) in enumerate(ranges):
        view, rest = divmod(c, bins_x * bins_y)
        x, y = _corner(view, cell_w, cell_h, columns)
        x, y = x + rest % bins_x * tile_w * SIDE, y + rest // bins_x * tile_h * SIDE
        of_bin = boxes[first:end]
        n = -(-(end - first) // WORD)
        for b, a in np.ndindex(SIDE, SIDE):
            flags = np.zeros(n * WORD, bool)
            flags[:end - first] = _meets(of_bin, x + a * tile_w, y + b * tile_h, tile_w, tile_h)
            at = bases[c] + (b * SIDE + a) * n
            packed = _packed(flags)[:max(slots - at, 0)]
            out[at:at + len(packed)] = packed
    return to_table(out)


# The bin of word w of the tiles: c_, with its range r_, words a tile n_.
_OF_BIN = """int c_ = 0;
    for (int top_ = {bases_n}; top_ - c_ > 1;) { int mid_ = (c_ + top_) >> 1; if ({bases_at}(mid_) <= w_) c_ = mid_; else top_ = mid_; }
    ivec2 r_ = {ranges_at}(c_);
    int n_ = (r_.y - r_.x + 31) / 32;"""


def _tile_sample(rng, slots=400):
    """Faces of bins, ranges, bases; the boxes of those faces; how many words tiles have."""
    grid = _sample_grid()
    boxes = _sample_boxes(rng, grid)
    words = _bin_words_ref(boxes, **grid.attrs)
    starts, spilled, total = _scanned(words, slots)
    attrs = {key: grid.attrs[key] for key in ("views", "face_count", "bins_x", "bins_y")}
    faces = _bin_list_ref(words, starts, spilled, total, slots=slots, per_bin=grid.words, **attrs)
    ranges = _bin_ranges_ref(starts, spilled, total, words=grid.words, **attrs)
    n = _tile_words_of(ranges.reshape(-1, 2)[:grid.views * grid.bins[0] * grid.bins[1]])
    return grid, [faces, ranges, to_table(np.cumsum(n) - n)], to_table(boxes.reshape(-1, 4)[faces.reshape(-1)]), int(n.sum())


def _tile_words_sample(rng):
    grid, inputs, boxes, count = _tile_sample(rng)
    return [boxes, *inputs[1:]], {**grid.attrs, "slots": count + 20}


op("tile_words", "boxes ranges bases", attrs="slots " + _GRID, reads="texel texel texel", ref=_tile_words_ref, cost=300,
   infer=lambda name, inputs, attrs: ("int", table(attrs["slots"])), sample=_tile_words_sample,
   glsl="""{ int w_ = {i};
    """ + _OF_BIN + _BIN_PLACE + """
    int at_ = w_ - {bases_at}(c_), t_ = n_ > 0 ? at_ / n_ : 64, first_ = r_.x + (at_ - t_ * n_) * 32;
    q_ += ivec2(t_ % 8, t_ / 8) * ivec2({tile_w}, {tile_h});
    ivec2 e_ = q_ + ivec2({tile_w}, {tile_h});
    int m_ = t_ < 64 && {i} < {n} ? min(r_.y - first_, 32) : 0;
    {y} = 0;
    for (int k_ = 0; k_ < m_; ++k_) {
        ivec4 b_ = {boxes_at}(first_ + k_);
        if (b_.x < e_.x && b_.z > q_.x && b_.y < e_.y && b_.w > q_.y) {y} |= 1 << k_;
    } }""",
   doc="For each tile and 32 entries of its bin's list a word: bit k is set if box k, in the order of the list, meets the tile. "
       "Words of a bin's 64 tiles lie from `bases` on.")


def _tile_list_ref(words, starts, spilled, total, faces, ranges, bases, drawn, slots, bins, partial=0):
    if spilled.reshape(-1)[0]:
        return _filled(faces.reshape(-1), slots)
    word, bit = _slots_ref(words, total)
    ranges, bases = ranges.reshape(-1, 2)[:bins], bases.reshape(-1)[:bins]
    c = np.searchsorted(bases, word, side="right") - 1
    n = (ranges[c, 1] - ranges[c, 0] + WORD - 1) // WORD
    return _filled(faces.reshape(-1)[ranges[c, 0] + (word - bases[c]) % n * WORD + bit], slots)


def _tile_list_sample(rng, slots=1200):
    grid, inputs, boxes, count = _tile_sample(rng)
    words = _tile_words_ref(boxes, *inputs[1:], **grid.attrs, slots=count + 20)
    return [words, *_scanned(words, slots), *inputs, np.array([[[0]]])], {"slots": slots, "bins": grid.views * grid.bins[0] * grid.bins[1]}


op("tile_list", "words starts spilled total faces ranges bases drawn", attrs="slots bins partial?", reads="texel " * 7 + "count",
   ref=_tile_list_ref, cost=150, sample=_tile_list_sample,
   infer=lambda name, inputs, attrs: ("int", replace(table(attrs["slots"]), partial=attrs.get("partial", 0))),
   glsl="""{ int s_ = {i}, end_ = {spilled}(ivec2(0)) == 0 ? {total}(ivec2(0)) : 0;
    """ + _FIND + """
    int w_ = low_;
    """ + _OF_BIN + """
    {y} = -1;
    if (high_ > 0) {y} = {faces_at}(r_.x + (w_ - {bases_at}(c_)) % max(n_, 1) * 32 + bit_);
    if ({spilled}(ivec2(0)) != 0 && s_ < {faces_n}) {y} = {faces_at}(s_); }""",
   doc="The faces (over views) of every tile, tile by tile, ascending. Those of every bin where that is `spilled`. Drawn for as many "
       "entries as `drawn` says, undefined after them.")


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
    grid, inputs, boxes, count = _tile_sample(rng)
    words = _tile_words_ref(boxes, *inputs[1:], **grid.attrs, slots=count + 20)
    attrs = {key: grid.attrs[key] for key in ("views", "bins_x", "bins_y")}
    return [*_scanned(words, 1200), *inputs[1:]], {**attrs, "tiles_x": grid.tiles[0], "tiles_y": grid.tiles[1]}


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
