"""Who touches whom in a mesh, once, at compile time.

In: faces (F, 3) and the vertex count. Out: corners sorted by vertex index, unique edges, which faces they bound, neighbours. Edges are
numbered in order of the first face that has them, so the first face of an edge is its lowest. A face that names a vertex twice has no
area whatever the positions are: it is left out, and the others are numbered without it.
"""
from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...cache.errors import InputError


@dataclass(frozen=True, eq=False)
class Topology:
    """faces (F, 3) int, those with three different corners; `kept` (F,) are their places among the faces given; vertex_count V.
    Raises InputError where no face is left."""

    faces: np.ndarray
    vertex_count: int

    def __post_init__(self):
        faces = np.asarray(self.faces).reshape(-1, 3)
        kept = np.flatnonzero((faces != np.roll(faces, 1, axis=1)).all(axis=1))
        if not len(kept):
            raise InputError(f"none of {len(faces)} faces has three different corners; a mesh needs at least one")
        object.__setattr__(self, "kept", kept)
        object.__setattr__(self, "faces", faces if len(kept) == len(faces) else faces[kept])

    @cached_property
    def sorted_faces(self) -> np.ndarray:
        """(F, 3), each row ascending: edges shared by faces are evaluated in one direction."""
        return np.sort(self.faces, axis=1)

    @cached_property
    def _edge_index(self) -> tuple[np.ndarray, np.ndarray]:
        f = self.sorted_faces
        halves = np.stack([f[:, [0, 1]], f[:, [1, 2]], f[:, [0, 2]]], 1).reshape(-1, 2).astype(np.int64)
        keys = halves[:, 0] * self.vertex_count + halves[:, 1]
        _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
        rank = np.argsort(np.argsort(first, kind="stable"), kind="stable")
        return halves[np.sort(first)], rank[inverse].reshape(-1, 3)

    @cached_property
    def closed(self) -> np.ndarray:
        """(F,) bool: whether the faces that hang together with this one are a closed surface, oriented all alike: every edge is passed
        as often one way as the other."""
        ascents = (self.faces < np.roll(self.faces, -1, axis=1)).sum(1)  # around a face: 2 if it goes as its sorted corners do, else 1
        passed = np.bincount(self.face_edges.reshape(-1), weights=np.outer(2 * ascents - 3, (1, 1, -1)).reshape(-1))
        part = self._parts[self.faces[:, 0]]
        leaks = np.zeros(self.vertex_count, bool)
        leaks[part[(passed[self.face_edges] != 0).any(1)]] = True
        return ~leaks[part]

    @property
    def _parts(self) -> np.ndarray:
        """(V,): the lowest vertex that hangs together with each by faces."""
        lowest = np.arange(self.vertex_count)
        while True:
            of_faces, joined = lowest[self.faces], lowest.copy()
            np.minimum.at(joined, of_faces, of_faces.min(1, keepdims=True))
            while (joined[joined] != joined).any():
                joined = joined[joined]
            if (joined == lowest).all():
                return lowest
            lowest = joined

    @property
    def edges(self) -> np.ndarray:
        """(E, 2), lower vertex first."""
        return self._edge_index[0]

    @property
    def face_edges(self) -> np.ndarray:
        """(F, 3): the edges of corners 01, 12, 02 of the sorted face."""
        return self._edge_index[1]

    @cached_property
    def edge_faces(self) -> np.ndarray:
        """(E, 2): the first two faces of an edge, ascending; -1 at a boundary, -2 in second place where more than two meet."""
        owner = np.repeat(np.arange(len(self.faces)), 3)
        edge = self.face_edges.reshape(-1)
        order = np.argsort(edge, kind="stable")
        start = np.searchsorted(edge[order], np.arange(len(self.edges) + 1))
        count = np.diff(start)
        second = owner[order[np.minimum(start[:-1] + 1, len(order) - 1)]]
        return np.stack([owner[order[start[:-1]]], np.where(count == 1, -1, np.where(count == 2, second, -2))], 1)

    @cached_property
    def far_corners(self) -> np.ndarray:
        """(E,): which sorted corner of its first face is not on the edge."""
        own = self.face_edges[self.edge_faces[:, 0]] == np.arange(len(self.edges))[:, None]
        return np.array((2, 0, 1))[own.argmax(axis=1)]

    @cached_property
    def edge_vertices(self) -> np.ndarray:
        """(E, 4): the edge's ends and the far corners of its two faces; -1 in last place where there are not exactly two."""
        ends, faces = self.edges, self.edge_faces
        total = self.sorted_faces.sum(1)
        far = [np.where(faces[:, k] >= 0, total[np.maximum(faces[:, k], 0)] - ends.sum(1), -1) for k in (0, 1)]
        return np.stack([ends[:, 0], ends[:, 1], *far], 1)

    @cached_property
    def neighbours(self) -> tuple[np.ndarray, np.ndarray]:
        """Compressed rows (V, 2) and columns (2 E,): the vertices that share an edge with each vertex, ascending."""
        a = np.concatenate([self.edges, self.edges[:, ::-1]])
        a = a[np.lexsort((a[:, 1], a[:, 0]))]
        start = np.searchsorted(a[:, 0], np.arange(self.vertex_count + 1))
        return np.stack([start[:-1], start[1:]], 1), a[:, 1]
