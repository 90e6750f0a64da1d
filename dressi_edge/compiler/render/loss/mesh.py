"""Regularizers of meshes: the vec3 table of vertex positions and the topology in, a 1x1 float out, zero with zero gradient wherever a
length or an angle is not defined."""
from __future__ import annotations

import numpy as np

from ....cache.errors import GraphError
from ...graph.functions import (
    clamp,
    compose,
    constant_table,
    dot,
    gather_sum,
    length,
    lookup,
    mean,
    minimum,
    select,
    sqrt,
    stop_gradient,
)
from ...graph.ir import Node
from ...graph.optable import apply, as_node
from ..normals import DEGENERATE, check_positions, corners, incidence, unit_face_normals
from ..topology import Topology

# Limits of one corner's cotangent. The lower one keeps weights positive, so that each vertex is drawn to a point between its
# neighbours on any mesh: angles over 89.9 degrees count as that. The upper one (2.9 degrees) stops slivers from taking over.
COTANGENTS = (1e-3, 20.0)


def _mean_length(d: Node, power: int) -> Node:
    if power not in (1, 2):
        raise GraphError(f"a Laplacian of power {power!r}; 1 (mean length) or 2 (mean squared length) is allowed")
    return mean(length(d) if power == 1 else dot(d, d))


def uniform_laplacian(positions: Node, topology: Topology, power: int = 1) -> Node:
    """Mean over all vertices of |p - mean of p's neighbours| (power 1) or its square (power 2).

    positions: vec3 table of V. A vertex without edges counts as 0. Raises GraphError.
    """
    check_positions(positions, topology.vertex_count)
    rows, cols = topology.neighbours
    degree = rows[:, 1] - rows[:, 0]
    inverse = constant_table(np.where(degree > 0, 1.0 / np.maximum(degree, 1), 0.0))
    centre = gather_sum(positions, rows, cols) * inverse
    return _mean_length(select(inverse > 0.0, positions - centre, 0.0), power)


def cotangent_laplacian(positions: Node, topology: Topology, power: int = 1) -> Node:
    """As `uniform_laplacian`, neighbours weighted by the cotangents of the angles opposite their edge; weights add up to 1.

    The weights follow the positions without gradient. A cotangent is limited to COTANGENTS; a face with corners on a line has
    no weight, and a vertex without weight counts as 0. Source: Desbrun et al., SIGGRAPH 1999, section 4. Raises GraphError.
    """
    check_positions(positions, topology.vertex_count)
    p0, p1, p2 = corners(positions, topology.faces)
    a, b, c = p1 - p0, p2 - p0, p2 - p1
    n = apply("cross", a, b)
    area, size = sqrt(dot(n, n)), dot(a, a) + dot(b, b) + dot(c, c)
    safe = area > size * DEGENERATE
    cotangents = clamp(compose(dot(a, b), -dot(a, c), dot(b, c)) / select(safe, area, 1.0), *COTANGENTS)
    w = stop_gradient(select(safe, cotangents, 0.0))
    to_1, to_2, side = a * w.z, b * w.y, c * w.x  # edges of corner 0 and the far one, each with the cotangent opposite
    at_corner = (compose(to_1 + to_2, w.y + w.z), compose(side - to_1, w.x + w.z), compose(-to_2 - side, w.x + w.y))
    around = None
    for k, value in enumerate(at_corner):
        part = gather_sum(value, *incidence(topology.faces[:, k], topology.vertex_count))
        around = part if around is None else around + part
    weight = stop_gradient(around.w)
    some = weight > 0.0
    return _mean_length(select(some, around.xyz, 0.0) / select(some, weight, 1.0), power)


def edge_length(positions: Node, topology: Topology, rest=0.0) -> Node:
    """Mean over edges of (length - rest)^2. rest: a length in units of the scene, from 0 on, or one for each edge of `topology.edges`,
    (E,): an array, or a float table. Raises GraphError."""
    check_positions(positions, topology.vertex_count)
    edges = topology.edges
    d = lookup(positions, edges[:, 0]) - lookup(positions, edges[:, 1])
    if not isinstance(rest, Node):
        array = np.asarray(rest, np.float64)
        if array.shape not in ((), (len(edges),)) or not np.isfinite(array).all() or (array < 0).any():
            raise GraphError(f"edge_length: rest is {rest!r:.60}; a length from 0 on, or one for each of {len(edges)} edges, is needed")
        if not array.any():
            return mean(dot(d, d))
        rest = as_node(float(array)) if array.ndim == 0 else constant_table(array)
    return mean((length(d) - rest) ** 2)


def _edge_signs(topology: Topology, edge: np.ndarray, pair: np.ndarray) -> np.ndarray:
    """Of edges (n,) with faces pair (n, 2): 1 where the faces run along the edge in opposite directions, as they do on a
    consistently wound mesh, else -1."""
    f = topology.faces
    order = np.argsort(f, axis=1, kind="stable")
    turn = np.where((order[:, 1] - order[:, 0]) % 3 == 1, 1, -1)  # is the sorted face a rotation or a mirror image of the face?
    along = turn[:, None] * np.array([1, 1, -1])  # of sorted corners 01, 12, 02
    first, second = (along[pair[:, k], (topology.face_edges[pair[:, k]] == edge[:, None]).argmax(1)] for k in (0, 1))
    return -first * second


def normal_consistency(positions: Node, topology: Topology) -> Node:
    """Mean over the edges of exactly two faces of 1 - cos(angle between the faces' normals): 0 flat, 2 folded over.

    Normals follow the winding of `topology.faces`; of two neighbours wound against each other one is turned. An edge of a face
    with corners on a line counts as 0, and so does a mesh without edges of two faces. Raises GraphError.
    """
    check_positions(positions, topology.vertex_count)
    edge = np.flatnonzero(topology.edge_faces[:, 1] >= 0)
    if not len(edge):
        return as_node(0.0)
    pair = topology.edge_faces[edge]
    normals = unit_face_normals(positions, topology.faces)
    first, second = lookup(normals, pair[:, 0]), lookup(normals, pair[:, 1])
    signs = _edge_signs(topology, edge, pair)
    if (signs < 0).any():
        second = second * constant_table(signs.astype(np.float64))
    # 1 - cos = |m - n|^2 / 2 of unit vectors, which keeps its digits on nearly flat meshes
    d = first - second
    defined = minimum(dot(first, first), dot(second, second)) > 0.5
    return mean(select(defined, dot(d, d), 0.0)) * 0.5
