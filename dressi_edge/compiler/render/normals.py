"""Normals of faces and vertices, differentiable.

In: a vec3 table of vertex positions and constant faces. Out: vec3 tables. A face reads its corners (one level of lookups), a
vertex its faces (one more); every transpose is a constant gather.
"""
from __future__ import annotations

import numpy as np

from ...cache.errors import GraphError
from ..graph.functions import compose, cross, dot, gather_sum, lookup, select, sqrt, stop_gradient
from ..graph.ir import Node
from .topology import Topology

# Below this sine of the angle between two sides, a normal's direction is fp32 rounding noise, and so would be its gradient.
DEGENERATE = 1e-6


def check_positions(positions: Node, count: int) -> None:
    """Raises GraphError unless `positions` is a vec3 table of `count` entries."""
    if positions.vtype != "vec3" or positions.extent.count != count:
        raise GraphError(f"positions are {positions!r} of {positions.extent.count} entries; a vec3 table of {count} is needed")


def corners(positions: Node, faces: np.ndarray) -> list[Node]:
    """The three vec3 tables (F) of the faces' corners."""
    return [lookup(positions, np.asarray(faces)[:, k]) for k in range(3)]


def incidence(index: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Compressed rows (count, 2) and columns (n,): for each entry the positions in `index` (n,) that name it, ascending."""
    order = np.argsort(index, kind="stable")
    start = np.searchsorted(index[order], np.arange(count + 1))
    return np.stack([start[:-1], start[1:]], 1), order


def _crosses(positions: Node, faces: np.ndarray) -> tuple[Node, Node]:
    """Cross product a x b of two sides of each face, and |a|^2 |b|^2."""
    p0, p1, p2 = corners(positions, faces)
    a, b = p1 - p0, p2 - p0
    return cross(a, b), dot(a, a) * dot(b, b)


def _unit(a: Node, size2: Node) -> Node:
    """a / |a|; zero with zero gradient where |a|^2 is noise beside size2."""
    safe = dot(a, a) > size2 * DEGENERATE ** 2
    return select(safe, a, 0.0) / sqrt(select(safe, dot(a, a), 1.0))


def face_normals(positions: Node, faces: np.ndarray) -> Node:
    """(p1 - p0) x (p2 - p0) of faces (F, 3): a vec3 table of F, twice the area long on the side that sees counter-clockwise."""
    return _crosses(positions, faces)[0]


def unit_face_normals(positions: Node, faces: np.ndarray) -> Node:
    """Face normals of length 1: a vec3 table of F; zero with zero gradient where the corners are on a line."""
    return _unit(*_crosses(positions, faces))


def vertex_normals(positions: Node, topology: Topology) -> Node:
    """Smooth normals: the area-weighted sum of the normals around each vertex, length 1, a vec3 table of V.

    Zero with zero gradient at vertices of no face, of degenerate faces only, and where the faces cancel out. Raises GraphError.
    """
    check_positions(positions, topology.vertex_count)
    normal, size2 = _crosses(positions, topology.faces)
    rows, corner = incidence(topology.faces.reshape(-1), topology.vertex_count)
    total = gather_sum(compose(normal, stop_gradient(sqrt(size2))), rows, corner // 3)
    size = stop_gradient(total.w)  # how large the sum could be
    return _unit(total.xyz, size * size)
