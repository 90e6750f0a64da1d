"""Constant matrices times tables, and their exact transposes: dense, packed four coefficients a texel, and sparse.

    dense:  x (k floats) -> pack4 -> matmul, one lane an entry of the result, k / 4 reads of the matrix each
    its transpose:  g -> matmul_transposed, LANES partial sums for each four of x -> block_sum -> unpack4

The matrix is one image, read by both: coefficients 4 j to 4 j + 3 of channel c of entry i are texel (j C + c) n + i. Lanes of either
pass that run side by side read texels side by side. Every sum has a fixed order: two runs agree bit for bit.
"""
from __future__ import annotations

import numpy as np

from ....cache.errors import GraphError
from ....cache.layout import beyond_fp32
from ..ir import CHANNELS, Data, Node, image, is_int, table, vector_type
from ..optable import apply, op
from .lookup import gather_sum

LANES = 512  # partial sums that share the entries of the result
MAX_COLUMNS = 1 << 14  # a block of four is a row of the partial sums
MAX_TEXELS = 1 << 24  # of the matrix: what the smallest devices hold in one image
AXES = "xyzw"


def _blocks(k: int) -> int:
    return -(-k // 4)


def _float_table(name, x):
    if x.vtype != "float":
        raise GraphError(f"{name}: a table of floats is needed, got {x!r}")


def _pack_infer(name, inputs, attrs):
    _float_table(name, inputs[0])
    return "vec4", table(_blocks(inputs[0].extent.count))


def _pack_ref(x, count):
    extent = table(_blocks(count))
    out = np.zeros((extent.width * extent.height * 4, 1))
    out[:count] = x.reshape(-1, 1)[:count]
    return out.reshape(extent.height, extent.width, 4)


def _unpack_infer(name, inputs, attrs):
    if inputs[0].vtype != "vec4" or inputs[0].extent.count != _blocks(attrs["count"]):
        raise GraphError(f"{name}: {attrs['count']} floats of {inputs[0]!r}; a vec4 for each four is needed")
    return "float", table(attrs["count"])


def _unpack_ref(x, count):
    extent = table(count)
    out = np.zeros((extent.width * extent.height, 1))
    out[:count] = x.reshape(-1, 1)[:count]
    return out.reshape(extent.height, extent.width, 1)


def _own_count(infer):
    def check(name, inputs, attrs):
        if attrs["count"] != inputs[0].extent.count:
            raise GraphError(f"{name}: count is {attrs['count']}; {inputs[0]!r} has {inputs[0].extent.count}")
        return infer(name, inputs, attrs)
    return check


op("pack4", "x", infer=_own_count(_pack_infer), reads="texel", cost=8, ref=_pack_ref,
   glsl="{ int k_ = 4 * {i}; {y} = vec4(k_ < {count} ? {x_at}(k_) : 0.0, k_ + 1 < {count} ? {x_at}(k_ + 1) : 0.0,\n"
        "    k_ + 2 < {count} ? {x_at}(k_ + 2) : 0.0, k_ + 3 < {count} ? {x_at}(k_ + 3) : 0.0); }",
   vjp=lambda g, y, x, count: (_as_laid(apply("unpack4", g, count=count), x),),
   sample=lambda rng: ([rng.normal(size=(2, 5, 1))], {"count": 10}),
   doc="A table of floats as one of vec4, zeros after the last.")
op("unpack4", "x", infer=_unpack_infer, reads="texel", cost=4, ref=_unpack_ref,
   glsl="{ vec4 x_ = {x_at}(min({i}, {count} - 1) >> 2); {y} = {i} < {count} ? x_[{i} & 3] : 0.0; }",
   vjp=lambda g, y, x, count: (_as_laid(apply("pack4", g, count=count), x),),
   sample=lambda rng: ([rng.normal(size=(3, 1, 4))], {"count": 10}),
   doc="The first `count` floats of a table of vec4.")


def _as_laid(g: Node, x: Node) -> Node:
    return g if g.extent == x.extent else apply("reshape", g, extent=x.extent)


def _matrix_of(name, inputs, attrs):
    """Channels of an entry, entries, and blocks of four coefficients."""
    matrix, c, n = inputs[0], CHANNELS[attrs["vtype"]], attrs["count"]
    if matrix.vtype != "vec4" or is_int(attrs["vtype"]) or matrix.extent.count % (c * n):
        raise GraphError(f"{name}: the matrix {matrix!r} does not hold {n} entries of {attrs['vtype']}")
    return c, n, matrix.extent.count // (c * n)


def _matmul_infer(name, inputs, attrs):
    _, n, blocks = _matrix_of(name, inputs, attrs)
    if inputs[1].vtype != "vec4" or inputs[1].extent.count != blocks:
        raise GraphError(f"{name}: {blocks} vec4 are needed, got {inputs[1]!r}")
    return attrs["vtype"], table(n)


def _matmul_ref(matrix, x, vtype, count, blocks):
    m = matrix.reshape(-1, 4)[:blocks * CHANNELS[vtype] * count].reshape(blocks, -1, count, 4)
    extent = table(count)
    out = np.zeros((extent.width * extent.height, m.shape[1]))
    out[:count] = np.einsum("jcik,jk->ic", m, x.reshape(-1, 4)[:blocks], optimize=True)
    return out.reshape(extent.height, extent.width, -1)


def _matmul_glsl(node: Node) -> str:
    c = node.channels
    parts = [f"{{y}}{'' if c == 1 else '.' + AXES[k]} += dot({{matrix_at}}((j_ * {c} + {k}) * {{n}} + {{i}}), x_);" for k in range(c)]
    return "{y} = {type}(0); if ({i} < {n}) for (int j_ = 0; j_ < {blocks}; ++j_) { vec4 x_ = {x_at}(j_); " + " ".join(parts) + " }"


def _matmul_vjp(g, y, matrix, x, vtype, count, blocks):
    lanes = min(LANES, count)
    partial = apply("matmul_transposed", matrix, g, vtype=vtype, count=count, blocks=blocks, lanes=lanes)
    while partial.extent.width > 1:
        partial = apply("block_sum", partial, bw=min(32, partial.extent.width), bh=1, count=partial.extent.count)
    return None, _as_laid(partial, x)


def _transposed_infer(name, inputs, attrs):
    _, n, blocks = _matrix_of(name, inputs, attrs)
    if inputs[1].vtype != attrs["vtype"] or inputs[1].extent.count != n or attrs["blocks"] != blocks:
        raise GraphError(f"{name}: {n} entries of {attrs['vtype']} are needed, got {inputs[1]!r}")
    return "vec4", image(attrs["lanes"], blocks)


def _transposed_ref(matrix, g, vtype, count, blocks, lanes):
    m = matrix.reshape(-1, 4)[:blocks * CHANNELS[vtype] * count].reshape(blocks, -1, count, 4)
    terms = np.einsum("jcik,ic->jik", m, g.reshape(-1, g.shape[2])[:count], optimize=True)
    padded = np.zeros((blocks, -(-count // lanes) * lanes, 4))
    padded[:, :count] = terms
    return padded.reshape(blocks, -1, lanes, 4).sum(1)


def _transposed_glsl(node: Node) -> str:
    c = CHANNELS[node.attrs["vtype"]]
    parts = " + ".join(f"{{matrix_at}}(({{p}}.y * {c} + {k}) * {{count}} + i_) * g_{'' if c == 1 else '.' + AXES[k]}" for k in range(c))
    return f"{{y}} = vec4(0.0); for (int i_ = {{p}}.x; i_ < {{count}}; i_ += {{lanes}}) {{ {node.attrs['vtype']} g_ = {{g_at}}(i_); " \
           f"{{y}} += {parts}; }}"


def _packed(matrix: np.ndarray) -> tuple[np.ndarray, int]:
    """(n, c, k) as (texels, 4), and the blocks of four coefficients."""
    n, c, k = matrix.shape
    blocks = _blocks(k)
    out = np.zeros((blocks, c, n, 4), np.float32)
    for j in range(blocks):
        part = matrix[:, :, 4 * j:4 * j + 4]
        out[j, :, :, :part.shape[2]] = part.swapaxes(0, 1)
    return out.reshape(-1, 4), blocks


def _table_of(texels: np.ndarray) -> Node:
    extent = table(len(texels))
    if len(texels) != extent.width * extent.height:
        texels = np.concatenate([texels, np.zeros((extent.width * extent.height - len(texels), 4), np.float32)])
    return apply("constant", data=Data(texels.reshape(extent.height, extent.width, 4)), vtype="vec4", extent=extent)


def _matmul_sample(rng):
    texels, blocks = _packed(rng.normal(size=(7, 3, 10)))
    return [_table_of(texels), rng.normal(size=(blocks, 1, 4))], {"vtype": "vec3", "count": 7, "blocks": blocks}


def _transposed_sample(rng):
    matrix, attrs = _matmul_sample(rng)
    return [matrix[0], rng.normal(size=(7, 1, 3))], {**attrs, "lanes": 4}


op("matmul", "matrix x", infer=_matmul_infer, reads="texel texel", cost=400, ref=_matmul_ref, glsl=_matmul_glsl, vjp=_matmul_vjp,
   sample=_matmul_sample,
   doc="A constant dense matrix, packed four coefficients a texel, times a table of vec4, one for each four columns.")
op("matmul_transposed", "matrix g", infer=_transposed_infer, reads="texel texel", cost=2000, ref=_transposed_ref, glsl=_transposed_glsl,
   sample=_transposed_sample,
   doc="Partial sums of the transpose of matmul: lane l of each block adds entries l, l + lanes, ...; no second derivative.")


def matmul(matrix: np.ndarray, x: Node) -> Node:
    """A constant dense matrix times a table of k floats: (n, k) gives a table of n floats, (n, c, k) one of n vectors of c channels.

    The matrix is rounded to fp32 and kept once, whatever uses it. Its transpose is exact and deterministic. Raises GraphError for
    other shapes, numbers beyond fp32, more than 67 million coefficients."""
    matrix = np.asarray(matrix)
    if matrix.ndim not in (2, 3) or matrix.dtype.kind not in "biuf" or 0 in matrix.shape or matrix.ndim == 3 and matrix.shape[1] > 4:
        raise GraphError(f"matmul: a matrix of shape {matrix.shape} and type {matrix.dtype}; numbers (n, k), or (n, c, k) with 1 to 4 "
                         "channels, are needed")
    if not isinstance(x, Node):
        raise GraphError(f"matmul: x is {type(x).__name__}; a node is needed: wrap arrays with constant_table()")
    _float_table("matmul", x)
    n, k = matrix.shape[0], matrix.shape[-1]
    if k != x.extent.count:
        raise GraphError(f"matmul: the matrix has {k} columns, {x!r} has {x.extent.count} entries; equal numbers are needed")
    c, blocks = matrix.shape[1] if matrix.ndim == 3 else 1, _blocks(k)
    if blocks * c * n > MAX_TEXELS or blocks > MAX_COLUMNS // 4:
        raise GraphError(f"matmul: a matrix of {n} x {c} x {k}; at most {4 * MAX_TEXELS} coefficients and {MAX_COLUMNS} columns are "
                         "allowed: split it, or use sparse_matmul()")
    texels, blocks = _packed(matrix.reshape(n, c, k))
    return apply("matmul", _table_of(texels), apply("pack4", x, count=k), vtype=vector_type(c), count=n, blocks=blocks)


def sparse_matmul(rows: np.ndarray, cols: np.ndarray, values: np.ndarray, x: Node, count: int | None = None) -> Node:
    """A constant sparse matrix times a table of floats or vectors: y[rows[e]] += values[e] x[cols[e]] for each entry e.

    Result: a table of `count` entries, by default as many as the rows need; entries of one place add up in the order given. Each channel
    of x is multiplied alike, so subdivision and averages of points are one call. Its transpose is exact and deterministic. Raises
    GraphError for arrays of unequal length, rows or columns that are not there, numbers beyond fp32."""
    rows, cols, values = (np.asarray(a) for a in (rows, cols, values))
    if not rows.ndim == cols.ndim == values.ndim == 1 or not len(rows) == len(cols) == len(values):
        raise GraphError(f"sparse_matmul: rows, columns and values have shapes {rows.shape}, {cols.shape}, {values.shape}; equal ones "
                         "(m,) are needed")
    if len(rows) and (rows.dtype.kind not in "iu" or cols.dtype.kind not in "iu" or values.dtype.kind not in "biuf"):
        raise GraphError(f"sparse_matmul: types {rows.dtype}, {cols.dtype}, {values.dtype}; integers, integers and numbers are needed")
    if not isinstance(x, Node) or is_int(x.vtype):
        raise GraphError(f"sparse_matmul: x is {x if isinstance(x, Node) else type(x).__name__!r}; a table of floats or vectors is needed")
    least = int(rows.max(initial=-1)) + 1
    count = least if count is None else count
    if count < max(least, 1) or rows.min(initial=0) < 0:
        raise GraphError(f"sparse_matmul: rows {rows.min(initial=0)} to {least - 1} of {count}; 0 to {count - 1} are allowed")
    if len(cols) and not 0 <= cols.min() <= cols.max() < x.extent.count:
        raise GraphError(f"sparse_matmul: columns {cols.min()} to {cols.max()} of {x!r}; 0 to {x.extent.count - 1} are allowed")
    if beyond_fp32(values).any():
        raise GraphError("sparse_matmul: values that are NaN, Inf or beyond the range of fp32; finite numbers are needed")
    order = np.argsort(rows, kind="stable")
    start = np.searchsorted(rows[order], np.arange(count + 1))
    return gather_sum(x, np.stack([start[:-1], start[1:]], 1), cols[order], values[order])
