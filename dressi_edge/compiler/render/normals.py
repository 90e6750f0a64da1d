"""Normals of faces and vertices, differentiable.

In: a vec3 table of vertex positions and constant faces. Out: vec3 tables. A face reads its corners (one level of lookups), a vertex
its faces (one more); every transpose is a constant gather.
"""
from __future__ import annotations

import numpy as np

from ...cache.errors import GraphError
from ..functions import compose, cross, dot, gather_sum, length, lookup, select, sqrt, stop_gradient
from ..ir import Node
from ..topology import Topology

# Below these sines a direction is rounding noise in fp32, and so would be its gradient.
DEGENERATE_FACE = 1e-6
OPPOSED_FACES = 1e-5


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
    """Cross product of each face and whether it is safe to normalize (int 0 or 1)."""
    p0, p1, p2 = corners(positions, faces)
    a, b = p1 - p0, p2 - p0
    normal = cross(a, b)
    return normal, dot(normal, normal) > dot(a, a) * dot(b, b) * DEGENERATE_FACE ** 2


def unit_where(safe: Node, a: Node) -> Node:
    """a / |a| where safe is not zero; elsewhere zero with zero gradient."""
    return select(safe, a, 0.0) / sqrt(select(safe, dot(a, a), 1.0))


def face_normals(positions: Node, faces: np.ndarray) -> Node:
    """(p1 - p0) x (p2 - p0) of faces (F, 3): a vec3 table of F, twice the area long, along the outside of counter-clockwise faces."""
    return _crosses(positions, faces)[0]


def unit_face_normals(positions: Node, faces: np.ndarray) -> Node:
    """Face normals of length 1: a vec3 table of F; zero with zero gradient where the corners are on a line."""
    normal, safe = _crosses(positions, faces)
    return unit_where(safe, normal)


def vertex_normals(positions: Node, topology: Topology) -> Node:
    """Smooth normals: the area-weighted sum of the normals around each vertex, length 1, a vec3 table of V. Zero with zero gradient
    at vertices of no face, of degenerate faces only, and where the faces cancel out. Raises GraphError."""
    check_positions(positions, topology.vertex_count)
    normal = face_normals(positions, topology.faces)
    rows, corner = incidence(topology.faces.reshape(-1), topology.vertex_count)
    total = gather_sum(compose(normal, stop_gradient(length(normal))), rows, corner // 3)
    scale = stop_gradient(total.w)  # what |total| would be without cancellation
    return unit_where(dot(total.xyz, total.xyz) > scale * scale * OPPOSED_FACES ** 2, total.xyz)
