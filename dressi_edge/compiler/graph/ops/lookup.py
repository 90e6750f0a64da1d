"""Lookups by index and their exact transposes.

Where the index is constant (faces, vertices, neighbours) the transpose is a compile-time sparse matrix in compressed rows, read
in fixed order: exact and deterministic, no atomics. Where it is computed (pixel -> face) the transpose gathers over a box of
pixels that is known to hold every pixel that can name the entry. See docs/design.md, "Scatters are gathers".
"""
from __future__ import annotations

import functools

import numpy as np

from ....cache.errors import GraphError
from ..ir import UNIT, Data, Extent, Node, table, vector_type
from ..optable import Loop, apply, at, op, product
from .reduce import tiles_of

BIN = 8  # pixels a side of a bin of names
MAX_ROW = 256  # longer rows are summed in two levels, to keep every lane busy


def constant(array: np.ndarray, extent: Extent | None = None) -> Node:
    """A constant image from (height, width, channels), or with `table=True` extent from (n, channels) or (n,)."""
    array = np.asarray(array)
    kind = np.int32 if array.dtype.kind in "iub" else np.float64
    if array.ndim != 3:
        raise GraphError(f"constant of shape {array.shape}; (height, width, channels) is allowed, or use constant_table")
    extent = extent or Extent(array.shape[1], array.shape[0], array.shape[0] * array.shape[1])
    return apply("constant", data=Data(array.astype(kind)), vtype=vector_type(array.shape[2], kind is np.int32), extent=extent)


def to_table(array: np.ndarray, fill: float = 0) -> np.ndarray:
    """(n, channels) laid out as the image of `table(n)`, padded with `fill`."""
    array = np.asarray(array)
    array = array.reshape(len(array), -1)
    extent = table(len(array))
    out = np.full((extent.width * extent.height, array.shape[1]), fill, array.dtype)
    out[:len(array)] = array
    return out.reshape(extent.height, extent.width, -1)


def constant_table(array: np.ndarray, fill: float = 0) -> Node:
    """A constant table from (n, channels) or (n,)."""
    return constant(to_table(array, fill), table(len(array)))


def _rows_of(index: np.ndarray, entries: int) -> tuple[np.ndarray, np.ndarray]:
    """Compressed rows of the transpose of `index`: for each entry the positions that name it, ascending."""
    order = np.argsort(index, kind="stable")
    order = order[index[order] >= 0]
    start = np.searchsorted(index[order], np.arange(entries + 1))
    return np.stack([start[:-1], start[1:]], 1), order


@functools.lru_cache(maxsize=64)
def _transpose(rows: Data, cols: Data, weights: Data | None, outputs: int, inputs: int):
    flat = rows.array.reshape(-1, 2)[:outputs]
    lengths = flat[:, 1] - flat[:, 0]
    owner = np.repeat(np.arange(outputs), lengths)
    source = cols.array.reshape(-1)[:len(owner)]
    order = np.argsort(source, kind="stable")
    start = np.searchsorted(source[order], np.arange(inputs + 1))
    w = None if weights is None else weights.array.reshape(-1)[:len(owner)][order]
    return np.stack([start[:-1], start[1:]], 1), owner[order], w


def gather_sum(x: Node, rows: np.ndarray, cols: np.ndarray, weights: np.ndarray | None = None, slots: Node | None = None) -> Node:
    """`y[i] = sum over k in [rows[i, 0], rows[i, 1]) of weights[k] x[cols[k]]`: a constant sparse matrix times a table.

    rows (n, 2) int with rows laid end to end, cols (m,) int entries of x, weights (m,) or None for ones. Result: table of n.
    slots: x is a list, of which cols[k] is at slots[cols[k]]; -1 if it is not in it. Then there are no weights, and no gradient.
    """
    rows, cols = np.asarray(rows, np.int64), np.asarray(cols, np.int64)
    lengths = rows[:, 1] - rows[:, 0]
    if len(cols) != lengths.sum() or (len(rows) and not np.array_equal(rows[:, 0], np.cumsum(lengths) - lengths)):
        raise GraphError("gather_sum: rows must lie end to end and cover every column")
    entries = (x if slots is None else slots).extent.count
    if len(cols) and not 0 <= cols.min() <= cols.max() < entries:
        raise GraphError(f"gather_sum: column {cols.max()} of {x!r}; 0 to {entries - 1} are allowed")
    if len(lengths) and lengths.max() > MAX_ROW:
        pieces = -(-lengths // MAX_ROW)
        first = np.repeat(rows[:, 0], pieces)
        local = np.arange(pieces.sum()) - np.repeat(np.cumsum(pieces) - pieces, pieces)
        start = first + local * MAX_ROW
        end = np.minimum(start + MAX_ROW, np.repeat(rows[:, 1], pieces))
        partial = gather_sum(x, np.stack([start, end], 1), cols, weights, slots)
        ends = np.cumsum(pieces)
        return gather_sum(partial, np.stack([ends - pieces, ends], 1), np.arange(pieces.sum()))
    if not len(cols):
        cols, weights = np.zeros(1, np.int64), None
    nodes = [x, constant_table(rows), constant_table(cols)]
    if slots is not None:
        return apply("gather_listed", *nodes, slots)
    if weights is None:
        return apply("gather_sum", *nodes)
    return apply("weighted_gather_sum", *nodes, constant_table(np.asarray(weights, np.float64)))


def _gather_ref(x, rows, cols, weights=None):
    x, start, end = x.reshape(-1, x.shape[2]), rows[..., 0].ravel(), rows[..., 1].ravel()
    lengths = end - start
    owner = np.repeat(np.arange(len(lengths)), lengths)
    k = np.repeat(start - (np.cumsum(lengths) - lengths), lengths) + np.arange(lengths.sum())
    terms = x[cols.reshape(-1)[k]]
    if weights is not None:
        terms = terms * weights.reshape(-1)[k, None]
    out = np.zeros((len(lengths), x.shape[1]), x.dtype)
    np.add.at(out, owner, terms)
    return out.reshape(rows.shape[0], rows.shape[1], -1)


def _laid_out(entries: Node, extent: Extent) -> Node:
    """A table of as many entries in another extent, row by row."""
    return entries if entries.extent == extent else apply("lookup", entries, apply("texel_index", extent=extent))


def _gather_vjp(g, y, x, rows, cols, weights=None):
    if rows.op.name != "constant" or cols.op.name != "constant":
        raise GraphError("gather_sum: rows and columns must be constants for a gradient")
    parts = _transpose(rows.attrs["data"], cols.attrs["data"], weights and weights.attrs["data"], rows.extent.count, x.extent.count)
    return (_laid_out(gather_sum(g, *parts), x.extent),) + (None,) * (2 if weights is None else 3)


def _gather_sample(weighted):
    def sample(rng):
        lengths = np.array([0, 3, 1, 2, 0, 4, 1])
        ends = np.cumsum(lengths)
        cols = rng.integers(0, 9, ends[-1])
        arrays = [to_table(rng.normal(size=(9, 3))), constant_table(np.stack([ends - lengths, ends], 1)), constant_table(cols)]
        return arrays + ([constant_table(rng.normal(size=len(cols)))] if weighted else []), {}
    return sample


def _gather_listed_ref(x, rows, cols, slots):
    place = slots.reshape(-1)[cols.reshape(-1)]
    values = np.where(place[:, None] >= 0, x.reshape(-1, x.shape[2])[place], 0.0)
    return _gather_ref(values[:, None], rows, np.arange(len(place)))


_ROW = "for (int k_ = {rows}.x; k_ < {rows}.y; ++k_) { int j_ = {cols_at}(k_);"
op("gather_sum", "x rows cols", infer=at(1), reads="texel own texel", ref=_gather_ref, vjp=_gather_vjp, cost=30,
   loop=Loop(_ROW, "{y} += {x_at}(j_);"), sample=_gather_sample(False), doc="Constant sparse rows of ones times a table.")
op("weighted_gather_sum", "x rows cols weights", infer=at(1), reads="texel own texel texel", ref=_gather_ref, vjp=_gather_vjp,
   cost=30, size=product, loop=Loop(_ROW, "{y} += {weights_at}(k_) * {x_at}(j_);"), sample=_gather_sample(True),
   doc="A constant sparse matrix times a table.")
op("gather_listed", "x rows cols slots", infer=at(1), reads="texel own texel texel", ref=_gather_listed_ref, cost=30,
   loop=Loop(_ROW, "for (int s_ = {slots_at}(j_), end_ = s_ + int(s_ >= 0); s_ < end_; ++s_) {y} += {x_at}(s_);"),
   sample=lambda rng: ([*_gather_sample(False)(rng)[0][:3], to_table(np.array([4, -1, 0, 2, -1, 8, 1, 3, -1, 7]), -1)], {}),
   doc="gather_sum of a list, where `slots` says of each column at which place of it that is; -1 for those that are not in it.")


def lookup(entries: Node, index: Node | np.ndarray, box: Node | None = None) -> Node:
    """`y = entries[index]`, zero where the index is negative.

    A constant index (array of n) has its exact transpose at compile time. A computed index needs `box`, for each entry the half-open
    pixel box (x0, y0, x1, y1) that holds every pixel naming it, or no gradient is asked for.
    """
    if not isinstance(index, Node):
        index = np.asarray(index).reshape(-1)
        if len(index) and not -1 <= index.min() <= index.max() < entries.extent.count:
            bad = int(np.argmax((index >= entries.extent.count) | (index < -1)))
            raise GraphError(f"lookup: index {index[bad]} at {bad}; -1 to {entries.extent.count - 1} are allowed")
        index = constant_table(index.astype(np.int64), -1)
    if entries.extent == UNIT and index.op.name == "constant" and (index.attrs["data"].array.reshape(-1)[:index.extent.count] == 0).all():
        return apply("broadcast", entries, extent=index.extent)
    return apply("lookup", entries, index) if box is None else apply("lookup_boxed", entries, index, box)


def lookup_ref(entries, index, *_, **attrs):
    flat = entries.reshape(-1, entries.shape[2])
    return np.where(index >= 0, flat[np.clip(index[..., 0], 0, len(flat) - 1)], 0)


def _lookup_vjp(g, y, entries, index):
    if index.extent == UNIT:
        own = apply("texel_index", extent=entries.extent)
        return apply("select", apply("equal", own, index), g, 0.0), None
    if index.op.name != "constant":
        raise GraphError(f"lookup in {entries!r} by the computed index {index!r} has no gradient; give lookup() the box "
                         "of pixels of each entry, or cut the path with stop_gradient")
    flat = index.attrs["data"].array.reshape(-1)[:index.extent.count]
    rows, cols = _rows_of(flat, entries.extent.count)
    return _laid_out(gather_sum(g, rows, cols), entries.extent), None


def _lookup_sample(rng):
    return [to_table(rng.normal(size=(9, 3))), constant_table(rng.integers(-1, 9, 13), -1)], {}


LOOKUP = "{y} = {type}(0); if ({index} >= 0) {y} = {entries_at}({index});"
op("lookup", "entries index", absorbs_negative=(1,), infer=at(1), reads="texel own", ref=lookup_ref, vjp=_lookup_vjp, cost=8, glsl=LOOKUP,
   sample=_lookup_sample, doc="A table's entry by index; zero where the index is negative.")


def _listed_vjp(g, y, entries, index, names, slots):
    flat = names.attrs["data"].array.reshape(-1)[:names.extent.count]
    return (_laid_out(gather_sum(g, *_rows_of(flat, entries.extent.count), slots=slots), entries.extent), None, None, None)


def _listed_sample(rng):
    names, listed = rng.integers(0, 9, 13), np.array([1, 2, 5, 6, 11])
    slots = np.full(13, -1)
    slots[listed] = np.arange(5)
    return [to_table(rng.normal(size=(9, 3))), to_table(np.append(names[listed], -1), -1), constant_table(names), to_table(slots, -1)], {}


op("lookup_listed", "entries index names slots", absorbs_negative=(1,), infer=at(1), reads="texel own texel texel", ref=lookup_ref, cost=8,
   glsl=LOOKUP, sample=_listed_sample, vjp=_listed_vjp,
   doc="A table's entry by an index that is a list of some of the constants `names`; `slots`: where in it each of them is, or -1.")


def _boxed_sample(rng):
    index = rng.integers(-1, 6, (8, 9, 1))
    box = np.tile(np.array([0, 0, 9, 8]), (6, 1))
    return [to_table(rng.normal(size=(6, 3))), index, to_table(box)], {}


def _segment_ref(values, index, box, *_, **attrs):
    out = np.zeros((box.shape[0] * box.shape[1], values.shape[2]))
    ys, xs = np.nonzero(index[..., 0] >= 0)
    entry = index[ys, xs, 0]
    b = box.reshape(-1, 4)[entry]
    inside = (xs >= b[:, 0]) & (ys >= b[:, 1]) & (xs < b[:, 2]) & (ys < b[:, 3])
    np.add.at(out, entry[inside], np.broadcast_to(values, index.shape[:2] + values.shape[2:])[ys, xs][inside])
    return out.reshape(box.shape[0], box.shape[1], -1)


op("lookup_boxed", "entries index box", absorbs_negative=(1,), infer=at(1), reads="texel own texel", ref=lookup_ref, cost=8,
   glsl=LOOKUP, sample=_boxed_sample,
   vjp=lambda g, y, entries, index, box: (
       apply("segment_sum", g, index, box, apply("bin_names", index)), None, None),
   doc="A table's entry by a computed index; `box` bounds, for each entry, the pixels that may name it.")


def _any_ref(test):
    def ref(index, width, height):
        h, w, _ = index.shape
        padded = np.zeros((-(-h // height) * height, -(-w // width) * width), bool)
        padded[:h, :w] = test(index[..., 0])
        return padded.reshape(padded.shape[0] // height, height, -1, width).any((1, 3)).astype(np.int64)[..., None]
    return ref


for _name, _glsl, _test, _covers, _what in (("occupied", ">= 0", lambda x: x >= 0, (0, -1), "index is not negative"),
                                            ("vacant", "< 0", lambda x: x < 0, None, "index is negative"),
                                            ("marked", "> 0", lambda x: x > 0, None, "mask is positive")):
    op(_name, "index", reads="texel", ref=_any_ref(_test), covers=_covers, cost=64,
       infer=lambda name, inputs, attrs: ("int", tiles_of(inputs[0].extent, attrs["width"], attrs["height"])),
       glsl="""{ ivec2 size_ = ivec2({width}, {height}), lo_ = {p} * size_, hi_ = min(lo_ + size_, ivec2({index_w}, {index_h}));
    {y} = 0;
    for (int b_ = lo_.y; b_ < hi_.y && {y} == 0; ++b_)
    for (int a_ = lo_.x; a_ < hi_.x && {y} == 0; ++a_) {y} = {index}(ivec2(a_, b_)) TEST ? 1 : 0; }""".replace(
           "TEST", _glsl),
       sample=lambda rng: ([rng.integers(-60, 3, (17, 20, 1))], {"width": 8, "height": 8}),
       doc=f"1 for each tile of width x height pixels in which some {_what}.")

def _bin_names_ref(index):
    h, w, _ = index.shape
    out = np.zeros((-(-h // BIN), -(-w // BIN), 4), np.int64)
    for y, x in np.argwhere(index[..., 0] >= 0):
        k = index[y, x, 0]
        out[y // BIN, x // BIN, k >> 5 & 3] |= 1 << (k & 31)
    return (out + 2 ** 31) % 2 ** 32 - 2 ** 31


_NAME_BIT = "ivec4 name_bit(int k) { return ivec4(equal(ivec4(k >> 5 & 3), ivec4(0, 1, 2, 3))) * (1 << (k & 31)); }"
op("bin_names", "index", reads="texel", ref=_bin_names_ref, cost=64, functions=_NAME_BIT,
   infer=lambda name, inputs, attrs: ("ivec4", tiles_of(inputs[0].extent, BIN, BIN)),
   glsl=f"""{{ ivec2 lo_ = {{p}} * {BIN}, hi_ = min(lo_ + {BIN}, ivec2({{index_w}}, {{index_h}}));
    {{y}} = ivec4(0);
    for (int b_ = lo_.y; b_ < hi_.y; ++b_) for (int a_ = lo_.x; a_ < hi_.x; ++a_) {{
    int k_ = {{index}}(ivec2(a_, b_));
    if (k_ >= 0) {{y}} |= name_bit(k_); }} }}""",
   sample=lambda rng: ([rng.integers(-300, 300, (17, 20, 1))], {}),
   doc=f"For each bin of {BIN} x {BIN} pixels which entries some pixel names: bit k mod 128 is set for each entry k.")

# Bin by bin, those skipped in which nothing can name the entry, from pixel to pixel that does. Machines that run several entries at once
# turn as often as the longest needs, and those that cannot branch around a body run it once for each pixel added, not for each tried.
_BINS = f"""{{ ivec4 mine_ = name_bit({{i}});
ivec2 bin_ = ivec2({{box}}.x / {BIN} - 1, {{box}}.y / {BIN}), q_ = ivec2(0), lo_ = ivec2(0), hi_ = ivec2(0);
for (;;) {{
bool found_ = false;
for (bool left_ = true; left_ && !found_;) {{
if (++q_.x >= hi_.x) {{ ++q_.y; q_.x = lo_.x; }}
if (q_.y >= hi_.y) {{
if (++bin_.x * {BIN} >= {{box}}.z) {{ bin_.x = {{box}}.x / {BIN}; ++bin_.y; }}
left_ = bin_.y * {BIN} < {{box}}.w;
lo_ = max(bin_ * {BIN}, {{box}}.xy);
hi_ = left_ && any(notEqual({{bins}}(bin_) & mine_, ivec4(0))) ? min(bin_ * {BIN} + {BIN}, {{box}}.zw) : ivec2(0);
q_ = lo_;
}}
found_ = q_.y < hi_.y && {{index}}(q_) == {{i}};
}}
if (!found_) break;"""
op("segment_sum", "values index box bins", sums=(0,), named=(0, 1, -1), infer=at(2), reads="texel texel own texel",
   ref=_segment_ref, cost=400, functions=_NAME_BIT,
   vjp=lambda g, y, values, index, box, bins: (apply("lookup", g, index), None, None, None),
   loop=Loop(_BINS, "{y} += {values}(q_);", "} }"),
   sample=lambda rng: ([rng.normal(size=(8, 9, 3)), rng.integers(-1, 6, (8, 9, 1)),
                        to_table(np.tile(np.array([0, 0, 9, 8]), (6, 1))), np.full((1, 2, 4), -1)], {}),
   doc="Transpose of lookup_boxed: for each entry the sum, over the bins of its box that may hold any (`bin_names`), of the pixels that "
       "name it.")

# Rows of a capsule: the slab within `reach` of the segment's line, wider by more than rounding; the whole box where the line is nearly
# level. All pixels in one loop: machines that run several entries at once then turn as often as the longest needs, not its longest row
# times its most rows.
_CAPSULE = """{ vec2 d_ = {segment}.zw - {segment}.xy;
bool level_ = abs(d_.y) < 0.25;
float slope_ = level_ ? 0.0 : d_.x / d_.y, wide_ = level_ ? 1e6 : float({reach}) * length(d_) / abs(d_.y) + 0.02 + 2e-3 * abs(slope_);
int b_ = {box}.y - 1;
for (int a_ = 0, end_ = 0; ; ++a_) {
if (a_ >= end_) {
if (++b_ >= {box}.w) break;
float at_ = {center}.x + {segment}.x + (float(b_) + 0.5 - {center}.y - {segment}.y) * slope_ - 0.5;
ivec2 row_ = ivec2(clamp(vec2(ceil(at_ - wide_), floor(at_ + wide_) + 1.0), vec2({box}.xx), vec2({box}.zz)));
a_ = row_.x; end_ = row_.y;
if (a_ >= end_) continue;
}
ivec2 q_ = ivec2(a_, b_); ivec4 named_ = ivec4({places}(q_));"""


def _capsules(rng):
    """Pixels that name the nearest of some segments, within 2; arguments after the values, with no name out of reach."""
    ends = np.array([(-4, -3, 3, 2), (2, 3, 2, -3), (-5, 4, 4, 4.1), (-1, 3, -3, -3)], float)
    ys, xs = np.mgrid[:10, :12] + 0.5 - np.array([5.0, 6.0])[:, None, None]
    p = np.stack([xs, ys], -1)[..., None, :]
    d = ends[:, 2:] - ends[:, :2]
    t = np.clip(((p - ends[:, :2]) * d).sum(-1) / (d * d).sum(-1), 0, 1)
    far = np.linalg.norm(ends[:, :2] + t[..., None] * d - p, axis=-1)
    places = np.where(far.min(-1) <= 2, far.argmin(-1) + 1, 0)[..., None]
    box = np.array([np.concatenate([np.floor(np.minimum(e[:2], e[2:]) + (4, 3)), np.ceil(np.maximum(e[:2], e[2:]) + (8, 7))])
                    for e in ends]).clip(0, [12, 10, 12, 10]).astype(int)
    return places, to_table(box), to_table(ends), to_table(np.tile([6.0, 5.0], (4, 1)))


def _near_ref(entries, places, *_, channel, reach):
    return lookup_ref(entries, places[..., channel:channel + 1] - 1)


op("lookup_near", "entries places box segment center", absorbs=(1,), infer=at(1), reads="texel own texel texel texel",
   size=lambda node, sizes: sizes[0], ref=_near_ref, cost=8,
   glsl="{ int at_ = ivec4({places})[{channel}] - 1; {y} = {type}(0); if (at_ >= 0) {y} = {entries_at}(at_); }",
   vjp=lambda g, y, entries, places, box, segment, center, **attrs: (
       apply("capsule_sum", g, places, box, segment, center, **attrs), None, None, None, None),
   sample=lambda rng: ([to_table(rng.normal(size=(4, 3))), *_capsules(rng)], {"reach": 2.0, "channel": 0}),
   doc="lookup_boxed for entries that are segments, relative to `center`, and pixels within `reach` of the one that a channel of "
       "`places`, int or ivec4, names, counted from 1, 0 for none: sums over several channels share one loop.")
op("capsule_sum", "values places box segment center", sums=(0,), named=(0, 1, 0), infer=at(2), reads="texel texel own own own", cost=300,
   ref=lambda values, places, box, *_, channel, reach: _segment_ref(values, places[..., channel:channel + 1] - 1, box),
   vjp=lambda g, y, values, places, *where, **attrs: (apply("lookup_near", g, places, *where, **attrs), None, None, None, None),
   loop=Loop(_CAPSULE, "if (named_[{channel}] == {i} + 1) {y} += {values}(q_);", "} }"),
   sample=lambda rng: ([rng.normal(size=(10, 12, 3)), *_capsules(rng)], {"reach": 2.0, "channel": 0}),
   doc="Transpose of lookup_near: for each segment the sum over the pixels of its box and within `reach` that name it.")

op("fetch", "source xy", infer=at(1), reads="texel own", cost=6,
   ref=lambda source, xy: source[np.clip(xy[..., 1], 0, source.shape[0] - 1), np.clip(xy[..., 0], 0, source.shape[1] - 1)],
   glsl="{y} = {source}(clamp({xy}, ivec2(0), ivec2({source_w} - 1, {source_h} - 1)));",
   sample=lambda rng: ([rng.normal(size=(4, 5, 3)), rng.integers(0, 4, (6, 7, 2))], {}),
   doc="The texel at a computed place, clamped to the image; no gradient.")
