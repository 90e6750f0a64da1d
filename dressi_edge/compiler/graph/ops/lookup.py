"""Lookups by index and their exact transposes.

Where the index is constant (faces, vertices, neighbours) the transpose is a compile-time sparse matrix in compressed rows, read
in fixed order: exact and deterministic, no atomics. Where it is computed (pixel -> face) the transpose gathers over a box of
pixels: `pixels.py`. See docs/design.md, "Scatters are gathers".
"""
from __future__ import annotations

import functools

import numpy as np

from ....cache.errors import GraphError
from ..ir import UNIT, Data, Extent, Node, table, vector_type
from ..optable import Loop, apply, as_node, negative, op, product

MAX_ROW = 256  # longer rows are summed in two levels, to keep every lane busy


def numbers(what: str, array, kinds: str = "iubf") -> np.ndarray:
    """An array of numbers, or of integers alone (kinds "iub"). Raises GraphError."""
    try:
        array = np.asarray(array)
    except ValueError:
        raise GraphError(f"{what} of rows of unequal length; an array is needed") from None
    if array.dtype.kind not in kinds and array.size:
        raise GraphError(f"{what} of type {array.dtype}; {'numbers' if 'f' in kinds else 'integers'} are needed")
    return array


def constant(array: np.ndarray, extent: Extent | None = None) -> Node:
    """A constant image from (height, width, channels), or with `table=True` extent from (n, channels) or (n,)."""
    array = numbers("constant", array)
    kind = np.int32 if array.dtype.kind in "iub" else np.float64
    if array.ndim != 3:
        raise GraphError(f"constant of shape {array.shape}; (height, width, channels) is allowed, or use constant_table")
    if kind is np.int32 and array.size and not -2 ** 31 <= int(array.min()) <= int(array.max()) < 2 ** 31:
        raise GraphError("constant with values beyond the range of int32")
    extent = extent or Extent(array.shape[1], array.shape[0], array.shape[0] * array.shape[1])
    return apply("constant", data=Data(array.astype(kind)), vtype=vector_type(array.shape[2], kind is np.int32), extent=extent)


def to_table(array: np.ndarray, fill: float = 0) -> np.ndarray:
    """(n, channels) laid out as the image of `table(n)`, padded with `fill`."""
    array = numbers("a table", array)
    if array.ndim == 0 or not array.size:
        raise GraphError(f"a table of shape {array.shape}; (n, channels) or (n,), with at least one entry, is needed")
    if not isinstance(fill, int | float | np.number):
        raise GraphError(f"a table is filled up with {type(fill).__name__}; a number is needed")
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
    x, rows, cols = as_node(x), numbers("gather_sum: rows", rows, "iub"), numbers("gather_sum: columns", cols, "iub")
    if rows.ndim != 2 or rows.shape[1] != 2 or cols.ndim != 1:
        raise GraphError(f"gather_sum: rows {rows.shape} and columns {cols.shape}; (n, 2) and (m,) are needed")
    rows, cols = rows.astype(np.int64), cols.astype(np.int64)
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
    data = [None if part is None else part.attrs["data"] for part in (rows, cols, weights)]
    parts = _transpose(*data, rows.extent.count, x.extent.count)
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


def _gather_infer(name, inputs, attrs):
    """Constant columns are checked here; computed ones are the caller's."""
    rows, cols, entries = inputs[1], inputs[2], inputs[3 if name == "gather_listed" else 0]
    if rows.vtype != "ivec2" or cols.vtype != "int":
        raise GraphError(f"{name}: rows as ivec2 and columns as int are needed, got {rows!r} and {cols!r}")
    if cols.op.name == "constant" and rows.op.name == "constant":
        used, flat = (x.attrs["data"].array.reshape(-1, x.channels)[:x.extent.count] for x in (rows, cols))
        if used.size and not 0 <= used.min() <= used.max() <= len(flat):
            raise GraphError(f"{name}: rows {used.min()} to {used.max()} of {cols!r}")
        flat = flat[:used.max(initial=0)]
        if flat.size and not 0 <= flat.min() <= flat.max() < entries.extent.count:
            raise GraphError(f"{name}: columns {flat.min()} to {flat.max()} of {entries!r}; 0 to {entries.extent.count - 1} are allowed")
    return inputs[0].vtype, rows.extent


_ROW = "for (int k_ = {rows}.x; k_ < {rows}.y; ++k_) { int j_ = {cols_at}(k_);"
op("gather_sum", "x rows cols", attrs="", infer=_gather_infer, reads="texel own texel", ref=_gather_ref, vjp=_gather_vjp, cost=30,
   loop=Loop(_ROW, "{y} += {x_at}(j_);"), sample=_gather_sample(False), doc="Constant sparse rows of ones times a table.")
op("weighted_gather_sum", "x rows cols weights", attrs="", infer=_gather_infer, alike=((3, 2),), reads="texel own texel texel",
   ref=_gather_ref, vjp=_gather_vjp, cost=30, size=product, loop=Loop(_ROW, "{y} += {weights_at}(k_) * {x_at}(j_);"),
   sample=_gather_sample(True),
   doc="A constant sparse matrix times a table.")
op("gather_listed", "x rows cols slots", attrs="", infer=_gather_infer, reads="texel own texel texel", ref=_gather_listed_ref, cost=30,
   loop=Loop(_ROW, "for (int s_ = {slots_at}(j_), end_ = s_ + int(s_ >= 0); s_ < end_; ++s_) {y} += {x_at}(s_);"),
   sample=lambda rng: ([*_gather_sample(False)(rng)[0][:3], to_table(np.array([4, -1, 0, 2, -1, 8, 1, 3, -1, 7]), -1)], {}),
   doc="gather_sum of a list, where `slots` says of each column at which place of it that is; -1 for those that are not in it.")


def lookup(entries: Node, index: Node | np.ndarray, box: Node | None = None) -> Node:
    """`y = entries[index]`, zero where the index is negative.

    A constant index (array of n) has its exact transpose at compile time. A computed index needs `box`, for each entry the half-open
    pixel box (x0, y0, x1, y1) that holds every pixel naming it, or no gradient is asked for.
    """
    entries = as_node(entries)
    if not isinstance(index, Node):
        index = numbers("lookup: an index", index, "iub").reshape(-1)
        if len(index) and not -1 <= index.min() <= index.max() < entries.extent.count:
            bad = int(np.argmax((index >= entries.extent.count) | (index < -1)))
            raise GraphError(f"lookup: index {index[bad]} at {bad}; -1 to {entries.extent.count - 1} are allowed")
        index = constant_table(index.astype(np.int64), -1)
    if entries.extent == UNIT and index.op.name == "constant" and (index.attrs["data"].array.reshape(-1)[:index.extent.count] == 0).all():
        return apply("broadcast", entries, extent=index.extent)
    return apply("lookup", entries, index) if box is None else apply("lookup_boxed", entries, index, box)


def lookup_ref(entries, index, *_, **attrs):
    """Entries by index, zero where it is negative; held at the last."""
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


def lookup_infer(name, inputs, attrs):
    """Entries by an int index: their type over its extent."""
    if inputs[1].vtype != "int":
        raise GraphError(f"{name}: the index {inputs[1]!r} is no int; convert it with to_int")
    return inputs[0].vtype, inputs[1].extent


LOOKUP = "{y} = {type}(0); if ({index} >= 0) {y} = {entries_at}(min({index}, {entries_w} * {entries_h} - 1));"
op("lookup", "entries index", attrs="", when=negative(1), infer=lookup_infer, reads="texel own", ref=lookup_ref, vjp=_lookup_vjp,
   cost=8, glsl=LOOKUP, sample=_lookup_sample, doc="A table's entry by index; zero where the index is negative.")


def _listed_vjp(g, y, entries, index, names, slots):
    flat = names.attrs["data"].array.reshape(-1)[:names.extent.count]
    return (_laid_out(gather_sum(g, *_rows_of(flat, entries.extent.count), slots=slots), entries.extent), None, None, None)


def _listed_sample(rng):
    names, listed = rng.integers(0, 9, 13), np.array([1, 2, 5, 6, 11])
    slots = np.full(13, -1)
    slots[listed] = np.arange(5)
    return [to_table(rng.normal(size=(9, 3))), to_table(np.append(names[listed], -1), -1), constant_table(names), to_table(slots, -1)], {}


op("lookup_listed", "entries index names slots", attrs="", when=negative(1), infer=lookup_infer, reads="texel own texel texel",
   ref=lookup_ref, cost=8, glsl=LOOKUP, sample=_listed_sample, vjp=_listed_vjp,
   doc="A table's entry by an index that is a list of some of the constants `names`; `slots`: where in it each of them is, or -1.")
