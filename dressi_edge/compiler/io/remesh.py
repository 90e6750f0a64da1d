"""Even triangles: a closed mesh of many small faces in; one of a given number of vertices, of the same topology, out.

Shortest edges are collapsed first (Hoppe et al. 1993), where the link condition (Dey et al. 1999) says that no handle is lost; then edges
are flipped towards six neighbours a vertex, and vertices move along the surface to the middle of their neighbours (Botsch, Kobbelt 2004).
"""
from __future__ import annotations

import heapq

import numpy as np

from ...cache.errors import InputError
from .needs import needed

MOST_NEIGHBOURS = 9
UPRIGHT = 0.2  # least cosine between a face's normal before and after
ROUNDS = 6


def evened(positions: np.ndarray, faces: np.ndarray, vertices: int) -> tuple[np.ndarray, np.ndarray]:
    """positions (n, 3), faces (F, 3) of a closed surface -> the same of about as many vertices as are asked for, n at most. Deterministic.
    Raises InputError where so few vertices cannot have its topology."""
    surface, normals = positions, vertex_normals(positions, faces)
    nearest = needed("scipy.spatial").cKDTree(surface)
    positions, faces = _collapsed(positions, faces, vertices)
    for _ in range(ROUNDS):
        faces = _flipped(positions, faces)
        moved = _relaxed(positions, faces)
        _, at = nearest.query(moved)
        positions = moved - normals[at] * ((moved - surface[at]) * normals[at]).sum(axis=1, keepdims=True)
    return positions, faces


def vertex_normals(positions: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(n, 3) of length 1, by the faces' areas."""
    a, b, c = positions[faces.T]
    across = np.cross(b - a, c - a)
    total = np.zeros_like(positions)
    for k in range(3):
        np.add.at(total, faces[:, k], across)
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-30)


def _cross(a, b, c) -> tuple[float, float, float]:
    """Of a triangle, its normal times twice its area."""
    x, y, z = a
    ux, uy, uz, vx, vy, vz = b[0] - x, b[1] - y, b[2] - z, c[0] - x, c[1] - y, c[2] - z
    return uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx


def _turned(before, after) -> bool:
    """Whether a face with these two normals has turned too far, or lost its area."""
    (x, y, z), (u, v, w) = before, after
    dot = x * u + y * v + z * w
    return dot <= 0.0 or dot * dot < UPRIGHT * UPRIGHT * ((x * x + y * y + z * z) * (u * u + v * v + w * w))


class _Surface:
    """A mesh in lists, where each vertex knows its faces."""

    def __init__(self, positions: np.ndarray, faces: np.ndarray):
        self.at, self.faces = positions.tolist(), faces.tolist()
        self.around: list[set[int]] = [set() for _ in self.at]
        for k, face in enumerate(self.faces):
            for v in face:
                self.around[v].add(k)

    def neighbours(self, v: int) -> set[int]:
        found = set().union(*[self.faces[k] for k in self.around[v]])
        found.discard(v)
        return found

    def arrays(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions and faces of what is left, renumbered."""
        faces = np.array([face for face in self.faces if face is not None], np.int64).reshape(-1, 3)
        used, numbered = np.unique(faces, return_inverse=True)
        return np.array(self.at)[used], numbered.reshape(-1, 3).astype(np.int32)


def _collapsed(positions: np.ndarray, faces: np.ndarray, vertices: int) -> tuple[np.ndarray, np.ndarray]:
    s = _Surface(positions, faces)
    at, around, stamp = s.at, s.around, [0] * len(s.at)

    def entry(u: int, v: int) -> tuple:
        (a, b, c), (x, y, z) = at[u], at[v]
        return (a - x) ** 2 + (b - y) ** 2 + (c - z) ** 2, u, v, stamp[u], stamp[v]

    def turns(k: int, u: int, v: int, middle: list[float]) -> bool:
        """Whether a face turns where these two vertices become one."""
        i, j, k = s.faces[k]
        a, b, c = at[i], at[j], at[k]
        return _turned(_cross(a, b, c), _cross(middle if i == u or i == v else a, middle if j == u or j == v else b,
                                               middle if k == u or k == v else c))

    edges = np.unique(np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1), axis=0).tolist()
    queue, left = [entry(u, v) for u, v in edges], len(s.at)
    heapq.heapify(queue)
    while left > vertices and queue:
        _, u, v, su, sv = heapq.heappop(queue)
        if stamp[u] != su or stamp[v] != sv:
            continue
        shared = around[u] & around[v]
        if len(shared) != 2:
            continue
        near_u, near_v = s.neighbours(u), s.neighbours(v)
        if len(near_u & near_v) != 2 or min(len(near_u), len(near_v)) < 4:
            continue  # a handle would close, or a fold open
        if len(near_u | near_v) - 2 > MOST_NEIGHBOURS:
            continue
        middle = [(a + b) / 2.0 for a, b in zip(at[u], at[v])]
        if any(turns(k, u, v, middle) for k in (around[u] | around[v]) - shared):
            continue
        for k in shared:
            for w in s.faces[k]:
                around[w].discard(k)
            s.faces[k] = None
        for k in around[v]:
            s.faces[k] = [u if w == v else w for w in s.faces[k]]
        around[u] |= around[v]
        around[v], at[u], left = set(), middle, left - 1
        stamp[u], stamp[v] = stamp[u] + 1, -1
        for w in s.neighbours(u):
            heapq.heappush(queue, entry(min(u, w), max(u, w)))
    if left > 1.2 * vertices + 8:
        raise InputError(f"{vertices} vertices are too few for this surface, with its handles and thin parts; {left} are the fewest; ask "
                         "for more")
    return s.arrays()


def _flipped(positions: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Faces whose edges were flipped where that brings the neighbours of four vertices nearer to six each."""
    s = _Surface(positions, faces)
    at, around = s.at, s.around
    edges = np.unique(np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1), axis=0).tolist()
    for u, v in edges:
        both = sorted(around[u] & around[v])
        if len(both) != 2:
            continue
        first, second = (s.faces[k] for k in both)
        if first[(first.index(u) + 1) % 3] != v:
            first, second, both = second, first, both[::-1]
        if first[(first.index(u) + 1) % 3] != v:
            continue
        c, d = (next(w for w in face if w != u and w != v) for face in (first, second))  # first is u v c, second v u d
        i, j, k, n = len(around[u]), len(around[v]), len(around[c]), len(around[d])
        gain = i + j - k - n - 2  # half of what the squared differences from six become less by
        if gain <= 0 or min(i, j) < 4 or around[c] & around[d]:
            continue
        new = [c, d, v], [d, c, u]
        normal = [a + b for a, b in zip(_cross(*(at[w] for w in first)), _cross(*(at[w] for w in second)))]
        if any(_turned(normal, _cross(*(at[w] for w in face))) for face in new):
            continue
        around[u].discard(both[0]), around[v].discard(both[1]), around[c].add(both[1]), around[d].add(both[0])
        s.faces[both[0]], s.faces[both[1]] = new
    return np.array(s.faces, np.int32)


def _relaxed(positions: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Vertices halfway to the mean of their neighbours, along the surface."""
    total, count = np.zeros_like(positions), np.zeros(len(positions))
    for a, b in ((0, 1), (1, 2), (2, 0)):  # on a closed surface every edge is in two faces, once each way
        np.add.at(total, faces[:, a], positions[faces[:, b]])
        np.add.at(count, faces[:, a], 1.0)
    step = 0.5 * (total / np.maximum(count, 1.0)[:, None] - positions)
    normal = vertex_normals(positions, faces)
    return positions + step - normal * (step * normal).sum(axis=1, keepdims=True)
