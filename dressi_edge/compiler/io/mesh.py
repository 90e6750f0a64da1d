"""The value that meshes are here: one frozen, checked `Mesh`.

Topology is by position: corners of faces at exactly the same point are one vertex and move together, whatever else they have. Uvs,
colours and normals belong to corners and have faces of their own, so a seam or a crease costs no vertex. v is down: texel row j of
an image of height h has its centre at v = (j + 0.5) / h.
"""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...cache.errors import InputError
from ...cache.layout import beyond_fp32
from .images import srgb_to_linear

WRAPS = ("repeat", "clamp")
NORMALS = ("smooth", "flat", "file")
FAR = 64.0  # radii from the origin from which a mesh is moved: fp32 is then 4e-6 of the radius
_INDEX = ("faces", "uv_faces", "color_faces", "normal_faces", "vertex_map")
_FLOAT = ("positions", "uvs", "colors", "texture", "normals")


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh; arrays are copied, checked and read-only.

    positions: (V, 3) float64 in the range of fp32, any unit; there may be some that no face uses. faces: (F, 3) int32.
    uvs: (T, 2) float64, v down, and uv_faces: (F, 3) int32, both or neither.
    colors: float64 in [0, 1], as stored; (V, 3), or (C, 3) with color_faces: (F, 3) where corners have their own.
    texture: (h, w, 3) float64 in [0, 1], sRGB encoded, row 0 at v = 0; wrap: what is beyond its edge, "repeat" or "clamp".
    normals: (N, 3) float64 of length 1 and normal_faces: (F, 3), both or neither: what a file gives; they do not follow vertices.
    vertex_map: (M,) int32, where a file's M vertices are more than the V of here: the vertex of each, in the file's order.
    Raises InputError for anything else.
    """

    positions: np.ndarray
    faces: np.ndarray
    uvs: np.ndarray | None = None
    uv_faces: np.ndarray | None = None
    colors: np.ndarray | None = None
    texture: np.ndarray | None = None
    color_faces: np.ndarray | None = None
    normals: np.ndarray | None = None
    normal_faces: np.ndarray | None = None
    vertex_map: np.ndarray | None = None
    wrap: str = "repeat"

    def __post_init__(self) -> None:
        check_mesh(self)
        for name in (*_INDEX, *_FLOAT):
            value = getattr(self, name)
            if value is not None:
                value = np.array(value, dtype=np.int32 if name in _INDEX else np.float64, order="C")
                value.setflags(write=False)
            object.__setattr__(self, name, value)


def check_mesh(mesh: Mesh) -> None:
    """Raises InputError unless shapes, types, values and indices are those `Mesh` states."""
    positions = _floats("positions", mesh.positions, (None, 3))
    count = len(_indices("faces", mesh.faces, len(positions), "vertices"))
    _corners("uvs", mesh.uvs, mesh.uv_faces, (None, 2), count)
    _corners("normals", mesh.normals, mesh.normal_faces, (None, 3), count)
    if mesh.normals is not None:
        length = np.linalg.norm(np.asarray(mesh.normals, np.float64), axis=1)
        if (bad := np.abs(length - 1.0) > 1e-3).any():
            row = int(np.argmax(bad))
            raise InputError(f"mesh normals[{row}] has length {length[row]:g}; 1 is needed; divide it by its length")
    if mesh.colors is None and mesh.color_faces is not None:
        raise InputError("mesh has color_faces but no colors; give both or neither")
    if mesh.colors is not None:
        colors = _floats("colors", mesh.colors, (len(positions) if mesh.color_faces is None else None, 3), unit=True)
        if mesh.color_faces is not None:
            _paired("color_faces", _indices("color_faces", mesh.color_faces, len(colors), "colors"), count)
    if mesh.texture is not None:
        _floats("texture", mesh.texture, (None, None, 3), unit=True)
    if mesh.wrap not in WRAPS:
        raise InputError(f"mesh wrap is {mesh.wrap!r}; allowed: {' '.join(WRAPS)}")
    if mesh.vertex_map is not None:
        where = np.asarray(mesh.vertex_map)
        if where.ndim != 1 or not np.issubdtype(where.dtype, np.integer) or ((where < 0) | (where >= len(positions))).any():
            raise InputError(f"mesh vertex_map is {where.dtype} of shape {where.shape}; it must be integers of shape (n,), "
                             f"vertices 0 to {len(positions) - 1}")


def _corners(name: str, values, faces, shape: tuple[int | None, int], count: int) -> None:
    of_faces = f"{name[:-1]}_faces"
    if (values is None) != (faces is None):
        given, missing = (of_faces, name) if values is None else (name, of_faces)
        raise InputError(f"mesh has {given} but no {missing}; give both or neither")
    if values is not None:
        _paired(of_faces, _indices(of_faces, faces, len(_floats(name, values, shape)), name), count)


def _paired(name: str, faces: np.ndarray, count: int) -> None:
    if len(faces) != count:
        raise InputError(f"mesh has {len(faces)} {name} for {count} faces; give one for each face")


def _floats(name: str, value: np.ndarray, shape: tuple[int | None, ...], unit: bool = False) -> np.ndarray:
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"mesh {name} is not an array of numbers: {error}") from None
    fits = array.ndim == len(shape) and all(want in (None, found) for want, found in zip(shape, array.shape, strict=True))
    if not fits or array.size == 0:
        wanted = ", ".join("n" if n is None else str(n) for n in shape)
        raise InputError(f"mesh {name} has shape {array.shape}; it must be ({wanted}), n at least 1")
    bad = beyond_fp32(array) if not unit else ~((array >= 0.0) & (array <= 1.0))
    if bad.any():
        row = tuple(int(i) for i in np.argwhere(bad)[0])
        large = np.isfinite(array[row])
        allowed = ("values in [0, 1]; scale or clip them" if unit else "magnitudes up to 3.4e38, those of fp32; scale it" if large else
                   "finite values; repair or drop it")
        raise InputError(f"mesh {name}[{row[0]}] has the value {array[row]}; allowed are {allowed}")
    return array


def _indices(name: str, value: np.ndarray, count: int, of: str) -> np.ndarray:
    array = np.asarray(value)
    if array.ndim != 2 or array.shape[1] != 3 or not np.issubdtype(array.dtype, np.integer):
        raise InputError(f"mesh {name} is {array.dtype} of shape {array.shape}; it must be integers of shape (n, 3)")
    if len(array) == 0:
        raise InputError(f"mesh {name} is empty; a mesh needs at least one face")
    bad = ((array < 0) | (array >= count)).any(axis=1)
    if bad.any():
        face = int(np.flatnonzero(bad)[0])
        raise InputError(f"mesh {name}[{face}] is {array[face].tolist()}, but there are {count} {of}, 0 to {count - 1}; "
                         "repair or drop that face")
    return array


def side_by_side(indices: Sequence[np.ndarray], counts: Sequence[int]) -> np.ndarray:
    """Indices into several arrays of so many entries as indices into these one after another."""
    return np.concatenate([index + k for index, k in zip(indices, np.cumsum([0, *counts]))])


def together(meshes: Sequence[Mesh]) -> Mesh:
    """The vertices and faces of all, nothing else."""
    return Mesh(np.concatenate([m.positions for m in meshes]),
                side_by_side([m.faces for m in meshes], [len(m.positions) for m in meshes]))


def unique_rows(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`first` picks each distinct row once, in order of appearance; `inverse` rebuilds: rows == rows[first][inverse]."""
    rows = np.ascontiguousarray(rows + 0.0 if rows.dtype.kind == "f" else rows)  # + 0.0: -0.0 is 0.0
    keys = rows.reshape(len(rows), -1).view(np.dtype((np.void, rows.dtype.itemsize * rows[0].size))).reshape(-1)
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return first[order], rank[inverse.reshape(-1)]


def linear_mesh(mesh: Mesh) -> Mesh:
    """The mesh with texture and colours decoded from sRGB to linear light, as shading takes them."""
    return replace(mesh, texture=None if mesh.texture is None else srgb_to_linear(mesh.texture),
                   colors=None if mesh.colors is None else srgb_to_linear(mesh.colors))


def face_normals(positions: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """The unit normal (F, 3) of each face, seen anticlockwise; +z where a face has no area."""
    corners = positions[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.where(length > 0.0, normals / np.maximum(length, 1e-300), (0.0, 0.0, 1.0))


def corner_normals(mesh: Mesh, kind: str) -> np.ndarray:
    """Unit normals (F, 3, 3) of each face's corners: "flat" its own, "file" what the file gave, "smooth" those of the vertices:
    the mean of the faces around, weighted by area. Raises InputError for "file" where the file gave none."""
    if kind == "file":
        if mesh.normals is None:
            raise InputError("normals \"file\", but the mesh has none of its own; allowed are smooth and flat")
        return mesh.normals[mesh.normal_faces]
    flat = face_normals(mesh.positions, mesh.faces)
    if kind == "flat":
        return np.repeat(flat[:, None], 3, axis=1)
    if kind != "smooth":
        raise InputError(f"normals {kind!r}; allowed: {' '.join(NORMALS)}")
    a, b, c = (mesh.positions[mesh.faces[:, k]] for k in range(3))
    weighted = np.zeros_like(mesh.positions)
    np.add.at(weighted, mesh.faces.reshape(-1), np.repeat(np.cross(b - a, c - a), 3, axis=0))
    length = np.linalg.norm(weighted, axis=1, keepdims=True)
    return np.where(length > 0.0, weighted / np.maximum(length, 1e-300), (0.0, 0.0, 1.0))[mesh.faces]


def middle_of(positions: np.ndarray) -> np.ndarray:
    """(3,) float64: the middle of the bounding box of positions (n, 3)."""
    return (positions.min(axis=0) + positions.max(axis=0)) / 2.0


def origin_of(positions: np.ndarray) -> np.ndarray:
    """(3,) float64: the middle of the bounding box of positions (n, 3) that are far from the origin for their extent, else zero."""
    low, high = positions.min(axis=0), positions.max(axis=0)
    middle, radius = (low + high) / 2.0, float(np.linalg.norm(high - low)) / 2.0
    return middle if radius > 0.0 and np.abs(middle).max() > FAR * radius else np.zeros(3)
