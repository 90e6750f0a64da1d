"""Where vertices are, said with fewer numbers: poses, linear models, skinning, and a parametrization that keeps steps smooth.

In: nodes of parameters and constant arrays. Out: vec3 tables of vertices, for `Scene.add`. Offsets of single vertices, or anything else,
are added on top. Every transpose is exact: constant matrices read the other way round, in a fixed order. Vertices of the mesh may be given
as an array (V, 3).
"""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...cache.errors import InputError
from ...cache.layout import beyond_fp32
from ..graph.functions import channels, compose, concat, constant_table, dot, gather_sum, lookup, matmul, sparse_matmul
from ..graph.ir import UNIT, Node
from ..graph.optable import as_node
from .camera import rotation_rows
from .topology import Topology


def _floats(who: str, what: str, array, shape: tuple[int | None, ...]) -> np.ndarray:
    try:
        array = np.asarray(array, np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{who}: {what} is not made of numbers") from None
    if array.ndim != len(shape) or any(n not in (None, k) for n, k in zip(shape, array.shape)) or not array.size:
        wanted = ", ".join("n" if n is None else str(n) for n in shape)
        raise InputError(f"{who}: {what} has shape {array.shape}; ({wanted}) is needed")
    if beyond_fp32(array).any():
        raise InputError(f"{who}: {what} has numbers that are not finite in fp32")
    return array


def _indices(who: str, what: str, array, shape: tuple[int, ...], count: int) -> np.ndarray:
    array = np.asarray(array)
    if array.shape != shape or array.dtype.kind not in "iu" or array.size and not 0 <= array.min() <= array.max() < count:
        found = f"{array.min()} to {array.max()}" if array.dtype.kind in "iu" and array.size else f"of type {array.dtype}"
        raise InputError(f"{who}: {what} are {found}, of shape {array.shape}; integers {shape}, 0 to {count - 1}, are needed")
    return array


def _points(who: str, positions) -> Node:
    if not isinstance(positions, Node):
        return constant_table(_floats(who, "positions", positions, (None, 3)))
    if positions.vtype != "vec3":
        raise InputError(f"{who}: positions are {positions!r}; a vec3 table is needed")
    return positions


def _one(who: str, what: str, value, vtype: str) -> Node:
    """A parameter of extent 1x1, or numbers for one."""
    if not isinstance(value, Node):
        array = _floats(who, what, value, () if vtype == "float" else (3,))
        return as_node(float(array)) if vtype == "float" else compose(*map(float, array))
    if (value.vtype, value.extent) != (vtype, UNIT):
        raise InputError(f"{who}: {what} is {value!r}; a {vtype} of extent 1x1 is needed")
    return value


def rigid(positions, rotation, translation, pivot=(0.0, 0.0, 0.0)) -> Node:
    """R(rotation) (p - pivot) + pivot + translation of every vertex. rotation: a rotation vector, axis times angle in radians; it,
    translation and pivot: a vec3 of extent 1x1, or three numbers. Raises InputError."""
    return similarity(positions, rotation, translation, 1.0, pivot)


def similarity(positions, rotation, translation, scale, pivot=(0.0, 0.0, 0.0)) -> Node:
    """scale R(rotation) (p - pivot) + pivot + translation; scale: a float of extent 1x1, or a number; the rest as in `rigid`."""
    p = _points("similarity", positions)
    rotation, translation, pivot = (_one("similarity", what, x, "vec3") for what, x in (
        ("rotation", rotation), ("translation", translation), ("pivot", pivot)))
    scale = _one("similarity", "scale", scale, "float")
    moved = p - pivot
    return compose(*(dot(row * scale, moved) for row in rotation_rows(rotation))) + (pivot + translation)


def _coefficients(who: str, x, count: int) -> Node:
    """A float table of `count`; a value of up to four channels is one too."""
    if isinstance(x, Node) and x.extent == UNIT and x.channels == count and x.vtype.startswith(("float", "vec")):
        return concat(*channels(x))
    if not isinstance(x, Node) or x.vtype != "float" or x.extent.count != count:
        raise InputError(f"{who}: coefficients are {x!r:.60}; a table of {count} floats is needed")
    return x


def linear_model(mean, basis: np.ndarray, coefficients: Node) -> Node:
    """mean + basis times coefficients. mean: V vertices; basis (V, 3, k): for each coefficient how every vertex moves; coefficients: a
    table of k floats (a parameter of shape (k,)). The basis is kept once, in fp32: 12 V k bytes, k rounded up to a multiple of 4; at most
    67 million numbers (`F.matmul`). Raises InputError, GraphError."""
    p = _points("linear_model", mean)
    basis = np.asarray(basis)
    if basis.ndim != 3 or basis.shape[:2] != (p.extent.count, 3):
        raise InputError(f"linear_model: the basis has shape {basis.shape}; ({p.extent.count}, 3, k) is needed")
    return p + matmul(basis, _coefficients("linear_model", coefficients, basis.shape[2]))


def blend_shapes(mean, vertex: np.ndarray, shape: np.ndarray, offset: np.ndarray, coefficients: Node) -> Node:
    """`linear_model` where a shape moves few vertices: for each entry e, vertex[e] moves by offset[e] times coefficients[shape[e]].

    vertex, shape: (m,) integers; offset: (m, 3). Several entries for one vertex and shape add up. Raises InputError."""
    p = _points("blend_shapes", mean)
    offset = _floats("blend_shapes", "offset", offset, (None, 3))
    count = coefficients.channels if isinstance(coefficients, Node) and coefficients.extent == UNIT else \
        coefficients.extent.count if isinstance(coefficients, Node) else 0
    table = _coefficients("blend_shapes", coefficients, count)
    vertex = _indices("blend_shapes", "vertices", vertex, (len(offset),), p.extent.count)
    shape = _indices("blend_shapes", "shapes", shape, (len(offset),), count)
    order = np.argsort(vertex, kind="stable")
    start = np.searchsorted(vertex[order], np.arange(p.extent.count + 1))
    moves = lookup(table, shape[order]) * constant_table(offset[order])
    return p + gather_sum(moves, np.stack([start[:-1], start[1:]], 1), np.arange(len(order)))


def skin(positions, weights, rotation: Node, translation: Node, pivots=None) -> Node:
    """Linear blend skinning: the sum over bones b of w_b (R_b (p - pivot_b) + pivot_b + translation_b).

    weights: (V, B), or (vertex, bone, weight), each (m,), of the B bones; those of a vertex add up to 1. rotation: a vec3 table of B
    rotation vectors, translation: of B; both in world space, from where the mesh is at rest. pivots: (B, 3), where each bone turns; the
    origin unless given. Raises InputError."""
    p, bones = _points("skin", positions), getattr(getattr(rotation, "extent", None), "count", 0)
    for what, x in (("rotation", rotation), ("translation", translation)):
        if not isinstance(x, Node) or x.vtype != "vec3" or x.extent.count != bones:
            raise InputError(f"skin: {what} is {x!r:.60}; a vec3 table of one entry for each bone is needed")
    count = p.extent.count
    if isinstance(weights, tuple):
        if len(weights) != 3:
            raise InputError(f"skin: weights are {len(weights)} arrays; (vertex, bone, weight) are needed")
        weight = _floats("skin", "weights", weights[2], (None,))
        vertex = _indices("skin", "vertices of weights", weights[0], weight.shape, count)
        bone = _indices("skin", "bones of weights", weights[1], weight.shape, bones)
    else:
        dense = _floats("skin", "weights", weights, (count, bones))
        vertex, bone = np.nonzero(dense)
        weight = dense[vertex, bone]
    sums = np.bincount(vertex, weight, count)
    if (off := abs(sums - 1.0) > 1e-3).any():
        k = int(off.argmax())
        raise InputError(f"skin: the weights of vertex {k} add up to {sums[k]:g}; 1 is needed: divide them by their sum")
    pivot = constant_table(_floats("skin", "pivots", np.zeros((bones, 3)) if pivots is None else pivots, (bones, 3)))
    blended = []
    for row, at, t in zip(rotation_rows(rotation), channels(pivot), channels(translation)):
        rest = compose(row.x, row.y, row.z, at + t - dot(row, pivot))
        blended.append(sparse_matmul(vertex, bone, weight, rest, count))
    return compose(*(dot(row.xyz, p) + row.w for row in blended))


@dataclass(frozen=True, eq=False)
class LargeSteps:
    """Vertices by smoother coordinates: p = (I + weight L)^-1 u, L the graph's Laplacian (degree on the diagonal, -1 for each edge). A step
    of u moves what is around a vertex with it (Nicolet et al. 2021; use `AdamUniform`). u starts as `encode(positions)`.

    The inverse is worked out once, dense, and multiplied: exact, and exact in its transpose, for meshes of up to 8192 vertices; it takes
    4 V^2 bytes. Raises InputError.
    """

    topology: Topology
    weight: float = 19.0

    def __post_init__(self) -> None:
        w, n = self.weight, self.topology.vertex_count
        if isinstance(w, bool) or not isinstance(w, int | float) or not w >= 0 or beyond_fp32(w):
            raise InputError(f"LargeSteps: weight is {w!r:.40}; a number from 0 on is needed")
        if n > 8192:
            raise InputError(f"LargeSteps: {n} vertices; at most 8192 are allowed, for the inverse of their Laplacian is dense")
        matrix, (a, b) = np.eye(n), self.topology.edges.T
        np.add.at(matrix, (np.r_[a, b], np.r_[a, b]), float(w))
        matrix[np.r_[a, b], np.r_[b, a]] = -float(w)
        object.__setattr__(self, "_matrix", matrix)
        object.__setattr__(self, "_inverse", np.linalg.inv(matrix))

    def encode(self, positions: np.ndarray) -> np.ndarray:
        """u of positions (V, 3)."""
        return self._matrix @ _floats("LargeSteps", "positions", positions, (self.topology.vertex_count, 3))

    def __call__(self, u: Node) -> Node:
        """The vertices of u, a vec3 table."""
        if not isinstance(u, Node) or u.vtype != "vec3" or u.extent.count != self.topology.vertex_count:
            raise InputError(f"LargeSteps: u is {u!r:.60}; a vec3 table of {self.topology.vertex_count} entries is needed")
        return compose(*(matmul(self._inverse, x) for x in channels(u)))
