"""Finer meshes of coarse ones, by a constant matrix: coarse vertices stay parameters, fine ones are drawn.

In: a `Mesh`. Out: the finer `Mesh`, and the `Subdivision` that makes a table of its vertices of one of the coarse vertices.
"""
from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...cache.errors import InputError
from ..graph.functions import sparse_matmul
from ..graph.ir import Node
from ..io.mesh import Mesh

SCHEMES = ("loop", "midpoint")
MAX_FACES = 1 << 22


@dataclass(frozen=True, eq=False)
class Subdivision:
    """A sparse matrix (count, source): rows, cols and values (m,), by rows. Called with a table of `source` entries, floats or vectors, it
    gives one of `count`; with an array (source, c), an array."""

    rows: np.ndarray
    cols: np.ndarray
    values: np.ndarray
    count: int
    source: int

    def __call__(self, x):
        if isinstance(x, Node):
            if x.extent.count != self.source:
                raise InputError(f"subdivision: {x!r} has {x.extent.count} entries; {self.source} are needed")
            return sparse_matmul(self.rows, self.cols, self.values, x, self.count)
        x = np.asarray(x, np.float64)
        if x.ndim not in (1, 2) or len(x) != self.source:
            raise InputError(f"subdivision: an array of shape {x.shape}; ({self.source}, c) is needed")
        out = np.zeros((self.count, *x.shape[1:]))
        np.add.at(out, self.rows, (self.values * x[self.cols].T).T)
        return out

    def after(self, first: Subdivision) -> Subdivision:
        """The product: `first`, then this."""
        start = np.searchsorted(first.rows, np.arange(first.count + 1))
        lengths = (start[1:] - start[:-1])[self.cols]
        own = np.repeat(np.arange(len(self.rows)), lengths)
        entry = np.repeat(start[self.cols] - (np.cumsum(lengths) - lengths), lengths) + np.arange(lengths.sum())
        keys = self.rows[own] * first.source + first.cols[entry]
        keys, where = np.unique(keys, return_inverse=True)
        values = np.bincount(where.reshape(-1), self.values[own] * first.values[entry], len(keys))
        return Subdivision(keys // first.source, keys % first.source, values, self.count, first.source)


def subdivide(mesh: Mesh, levels: int = 1, scheme: str = "loop") -> tuple[Mesh, Subdivision]:
    """The mesh with every face cut in four, `levels` times, and what makes its vertices of the coarse ones.

    "loop": a smooth surface (Loop 1987, with Warren's weights), edges of one face or of more than two as cubic curves; "midpoint": the same
    surface. The first vertices are the coarse ones; face f becomes 4 f to 4 f + 3. Texture coordinates, colours of corners and normals are
    halved along edges. Raises InputError."""
    if isinstance(levels, bool) or not isinstance(levels, int) or levels < 0 or len(mesh.faces) * 4.0 ** levels > MAX_FACES:
        raise InputError(f"subdivide: {levels!r:.40} levels of {len(mesh.faces)} faces; a whole number from 0 on, for at most {MAX_FACES} "
                         "faces, is needed")
    if scheme not in SCHEMES:
        raise InputError(f"subdivide: scheme is {scheme!r:.40}; allowed: {' '.join(SCHEMES)}")
    n = len(mesh.positions)
    whole = Subdivision(np.arange(n), np.arange(n), np.ones(n), n, n)
    for _ in range(levels):
        mesh, step = _finer(mesh, scheme)
        whole = step.after(whole)
    return mesh, whole


@dataclass(frozen=True, eq=False)
class _Edges:
    """Of faces (F, 3): edges (E, 2), lower end first; of (F, 3) which edge is from corner k to the next; how many faces have each, and the
    corners (E, 2) opposite it in the first and the last of them."""

    ends: np.ndarray
    of_face: np.ndarray
    faces: np.ndarray
    far: np.ndarray


def _edges(faces: np.ndarray) -> _Edges:
    halves = np.sort(np.stack([faces, np.roll(faces, -1, 1)], 2).reshape(-1, 2), 1)
    ends, where, count = np.unique(halves, axis=0, return_inverse=True, return_counts=True)
    where = where.reshape(-1)
    far = np.zeros((len(ends), 2), int)
    opposite = np.roll(faces, 1, 1).reshape(-1)
    far[where[::-1], 0] = opposite[::-1]  # the last to be written is the first
    far[where, 1] = opposite
    return _Edges(ends, where.reshape(-1, 3), count, far)


def _cut(faces: np.ndarray, edges: _Edges, first: int) -> np.ndarray:
    """(4 F, 3): each face in four, edge e having vertex first + e."""
    a, b, c = faces.T
    ab, bc, ca = first + edges.of_face.T
    return np.stack([a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca], 1).reshape(-1, 3)


def _halved(values: np.ndarray | None, faces: np.ndarray | None) -> tuple[np.ndarray | None, np.ndarray | None]:
    """An attribute with faces of its own."""
    if values is None or faces is None:
        return values, faces
    edges = _edges(np.asarray(faces))
    return np.concatenate([values, values[edges.ends].mean(1)]), _cut(np.asarray(faces), edges, len(values))


def _finer(mesh: Mesh, scheme: str) -> tuple[Mesh, Subdivision]:
    faces, n = np.asarray(mesh.faces, np.int64), len(mesh.positions)
    if (bad := (faces == np.roll(faces, 1, 1)).any(1)).any():
        k = int(bad.argmax())
        raise InputError(f"subdivide: faces[{k}] is {faces[k].tolist()}, which names a vertex twice; drop it")
    edges = _edges(faces)
    e = n + np.arange(len(edges.ends))
    rows, cols, values = [np.r_[e, e]], [edges.ends.T.reshape(-1)], [np.full(2 * len(e), 0.5)]
    if scheme == "midpoint":
        rows, cols, values = [np.arange(n), *rows], [np.arange(n), *cols], [np.ones(n), *values]
    else:
        smooth = edges.faces == 2
        values = [np.tile(np.where(smooth, 0.375, 0.5), 2), np.full(2 * smooth.sum(), 0.125)]
        rows.append(np.tile(e[smooth], 2))
        cols.append(edges.far[smooth].T.reshape(-1))
        _even(n, edges.ends, smooth, rows, cols, values)
    found = [np.concatenate(x) for x in (rows, cols, values)]
    order = np.lexsort((found[1], found[0]))
    step = Subdivision(*(x[order] for x in found), n + len(e), n)
    uvs, uv_faces = _halved(mesh.uvs, mesh.uv_faces)
    normals, normal_faces = _halved(mesh.normals, mesh.normal_faces)
    if normals is not None:
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        normals = np.where(length > 1e-6, normals / np.maximum(length, 1e-6), (0.0, 0.0, 1.0))
    colors, color_faces = mesh.colors, mesh.color_faces
    if colors is not None:
        colors, color_faces = (np.clip(step(colors), 0, 1), None) if color_faces is None else _halved(colors, color_faces)
    return replace(mesh, positions=step(mesh.positions), faces=_cut(faces, edges, n), uvs=uvs, uv_faces=uv_faces, colors=colors,
                   color_faces=color_faces, normals=normals, normal_faces=normal_faces), step


def _even(n: int, ends: np.ndarray, smooth: np.ndarray, rows: list, cols: list, values: list) -> None:
    """Loop's rules for the vertices that were there: around a vertex of smooth edges Warren's weights; at two creases (edges that are not
    smooth) 1/8, 3/4, 1/8 along them; at any other number of creases, or without edges, a vertex stays."""
    both, other = np.concatenate([ends, ends[:, ::-1]]).T
    crease = np.tile(~smooth, 2)
    degree, creases = np.bincount(both, minlength=n), np.bincount(both, crease, n).astype(int)
    beta = np.where(degree == 3, 3 / 16, 3 / (8 * np.maximum(degree, 1)))
    inner, along = (creases == 0) & (degree > 2), creases == 2
    weight = np.where(inner[both], beta[both], np.where(along[both] & crease, 0.125, 0.0))
    keep = weight > 0
    rows += [both[keep], np.arange(n)]
    cols += [other[keep], np.arange(n)]
    values += [weight[keep], np.where(inner, 1 - degree * beta, np.where(along, 0.75, 1.0))]
