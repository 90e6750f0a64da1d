"""Tables side by side: several parts of a scene in one table, a view at a time, and back. No indices are stored.

A table of `rows` x n entries is n entries for each row (view). `join` puts the entries of two such tables next to each other in each
row; `portion` takes `count` of them from `start` on; `padded` puts them back among zeros.
"""
from __future__ import annotations

import numpy as np

from ....cache.errors import GraphError
from ..ir import Node, table
from ..optable import apply, op
from .lookup import to_table


def _entries(x: np.ndarray, rows: int, n: int) -> np.ndarray:
    return x.reshape(-1, x.shape[2])[:rows * n].reshape(rows, n, -1)


def _join_infer(name, inputs, attrs):
    a, b = inputs
    rows = attrs["rows"]
    if a.vtype != b.vtype:
        raise GraphError(f"join: {a!r} and {b!r} have different types; one type is needed")
    if rows < 1 or (a.extent.count, b.extent.count) != (rows * attrs["na"], rows * attrs["nb"]):
        raise GraphError(f"join: {a!r} and {b!r} are not both {rows} rows of entries")
    return a.vtype, table(a.extent.count + b.extent.count)


def _join_ref(a, b, rows, na, nb):
    joined = np.concatenate([_entries(a, rows, na), _entries(b, rows, nb)], 1)
    return to_table(joined.reshape(-1, joined.shape[2]))


op("join", "a b", infer=_join_infer, reads="texel texel", cost=10, ref=_join_ref,
   glsl="""{ int at_ = min({i}, {n} - 1), row_ = at_ / ({na} + {nb}), k_ = at_ % ({na} + {nb});
    if (k_ < {na}) {y} = {a_at}(row_ * {na} + k_); else {y} = {b_at}(row_ * {nb} + k_ - {na}); }""",
   vjp=lambda g, y, a, b, rows, na, nb: (portion(g, 0, na, rows), portion(g, na, nb, rows)),
   sample=lambda rng: ([to_table(rng.normal(size=(12, 3))), to_table(rng.normal(size=(8, 3)))], {"rows": 2, "na": 6, "nb": 4}),
   doc="In each of `rows` rows the na entries of a, then the nb of b.")


def _portion_infer(name, inputs, attrs):
    x, rows, start, count, stride = inputs[0], *(attrs[k] for k in ("rows", "start", "count", "stride"))
    if x.extent.count != rows * stride or start < 0 or count < 1 or start + count > stride:
        raise GraphError(f"portion: entries {start} to {start + count} of {rows} rows of {stride}; {x!r} has {x.extent.count} entries")
    return x.vtype, table(rows * count)


def _portion_ref(x, rows, start, count, stride):
    part = _entries(x, rows, stride)[:, start:start + count]
    return to_table(part.reshape(-1, part.shape[2]))


op("portion", "x", infer=_portion_infer, reads="texel", cost=8, ref=_portion_ref,
   glsl="{ int at_ = min({i}, {n} - 1); {y} = {x_at}(at_ / {count} * {stride} + {start} + at_ % {count}); }",
   vjp=lambda g, y, x, **where: (apply("padded", g, **where),),
   sample=lambda rng: ([to_table(rng.normal(size=(16, 3)))], {"rows": 2, "start": 2, "count": 4, "stride": 8}),
   doc="`count` entries from `start` on of each of `rows` rows of `stride` entries.")


def _padded_infer(name, inputs, attrs):
    x, rows, start, count, stride = inputs[0], *(attrs[k] for k in ("rows", "start", "count", "stride"))
    if x.extent.count != rows * count or start < 0 or start + count > stride:
        raise GraphError(f"padded: {rows} rows of {count} entries at {start} of {stride}; {x!r} has {x.extent.count} entries")
    return x.vtype, table(rows * stride)


def _padded_ref(x, rows, start, count, stride):
    out = np.zeros((rows, stride, x.shape[2]), x.dtype)
    out[:, start:start + count] = _entries(x, rows, count)
    return to_table(out.reshape(-1, x.shape[2]))


op("padded", "x", infer=_padded_infer, reads="texel", cost=8, ref=_padded_ref,
   glsl="""{ int k_ = {i} % {stride} - {start}; {y} = {type}(0);
    if (k_ >= 0 && k_ < {count} && {i} < {n}) {y} = {x_at}({i} / {stride} * {count} + k_); }""",
   vjp=lambda g, y, x, **where: (apply("portion", g, **where),),
   sample=lambda rng: ([to_table(rng.normal(size=(8, 3)))], {"rows": 2, "start": 2, "count": 4, "stride": 8}),
   doc="Transpose of portion: `count` entries in each row of `stride`, zeros around them.")


def join(a: Node, b: Node, rows: int = 1) -> Node:
    """Two tables of one type as one: in each of `rows` rows the entries of a, then those of b. Raises GraphError."""
    return apply("join", a, b, rows=rows, na=a.extent.count // max(rows, 1), nb=b.extent.count // max(rows, 1))


def portion(x: Node, start: int, count: int, rows: int = 1) -> Node:
    """`count` entries from `start` on, in each of `rows` rows of the table x. Raises GraphError."""
    return apply("portion", x, rows=rows, start=start, count=count, stride=x.extent.count // max(rows, 1))
