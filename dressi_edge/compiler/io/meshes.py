"""Meshes: files and recipes in; one frozen, checked `Mesh` out.

Topology is by position: two corners at exactly the same point are one vertex, whatever their uvs or normals. Uvs have faces
of their own, so a seam costs no vertex. v is down: texel row j of an image of height h has its centre at v = (j + 0.5) / h.
(OBJ keeps v up, glTF keeps it down, trimesh hands out v up for both.)
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image

from ...cache.errors import InputError
from ...cache.layout import beyond_fp32
from .images import linear_to_srgb, opened, srgb_to_linear


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh; arrays are copied, checked and read-only.

    positions: (V, 3) float64 in the range of fp32, any unit. faces: (F, 3) int32.
    uvs: (T, 2) float64, v down, and uv_faces: (F, 3) int32, both or neither.
    colors: (V, 3) float64 in [0, 1], as stored. texture: (h, w, 3) float64 in [0, 1], sRGB encoded, row 0 at v = 0.
    Raises InputError for anything else.
    """

    positions: np.ndarray
    faces: np.ndarray
    uvs: np.ndarray | None = None
    uv_faces: np.ndarray | None = None
    colors: np.ndarray | None = None
    texture: np.ndarray | None = None

    def __post_init__(self) -> None:
        check_mesh(self)
        for name in ("positions", "faces", "uvs", "uv_faces", "colors", "texture"):
            value = getattr(self, name)
            if value is not None:
                value = np.array(value, dtype=np.int32 if name.endswith("faces") else np.float64, order="C")
                value.setflags(write=False)
            object.__setattr__(self, name, value)


def check_mesh(mesh: Mesh) -> None:
    """Raises InputError unless shapes, types, values and indices are those `Mesh` states."""
    positions = _floats("positions", mesh.positions, (None, 3))
    _indices("faces", mesh.faces, len(positions), "vertices")
    if (mesh.uvs is None) != (mesh.uv_faces is None):
        given, missing = ("uv_faces", "uvs") if mesh.uvs is None else ("uvs", "uv_faces")
        raise InputError(f"mesh has {given} but no {missing}; give both or neither")
    if mesh.uvs is not None:
        uvs = _floats("uvs", mesh.uvs, (None, 2))
        _indices("uv_faces", mesh.uv_faces, len(uvs), "uvs")
        if len(mesh.uv_faces) != len(mesh.faces):
            raise InputError(f"mesh has {len(mesh.uv_faces)} uv_faces for {len(mesh.faces)} faces; give one for each face")
    if mesh.colors is not None:
        _floats("colors", mesh.colors, (len(positions), 3), unit=True)
    if mesh.texture is not None:
        _floats("texture", mesh.texture, (None, None, 3), unit=True)


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


def _indices(name: str, value: np.ndarray, count: int, of: str) -> None:
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


def load_mesh(path: str | Path, texture: str | Path | None = None) -> Mesh:
    """The mesh of a file in any format that trimesh reads; a scene (glTF) is flattened with its transforms.

    Vertices at exactly the same position are merged, in order of first use; faces that have two corners left are dropped.
    Uvs are kept where every part has them, and the base colour image with its glTF factor; `texture` names an image to use
    instead. Raises InputError, naming the file, where the result is no `Mesh`.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"mesh file {path} does not exist; check the path")
    if path.suffix.lower() == ".obj":
        _check_obj_indices(path)
    try:
        parts = _parts(trimesh.load_scene(str(path), process=False))
    except Exception as error:  # readers raise anything on a broken file
        known = ", ".join(sorted({"obj", "ply", "stl", "off", "glb", "gltf"} & set(trimesh.available_formats())))
        raise InputError(f"mesh file {path} cannot be read ({type(error).__name__}: {error}); "
                         f"readable are {known} and what else trimesh reads; convert or repair it") from error
    if not parts or not sum(len(part.faces) for part in parts):
        raise InputError(f"mesh file {path} has no faces; a mesh needs at least one triangle")
    try:
        mesh = _joined(parts)
        return mesh if texture is None else replace(mesh, texture=load_texture(texture))
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def load_texture(path: str | Path) -> np.ndarray:
    """An image file as a texture (h, w, 3) float64 in [0, 1], as stored; alpha is dropped."""
    with opened(path, "texture", "give a PNG or JPEG file") as image:
        return _texels(image)


def _texels(image: Image.Image) -> np.ndarray:
    return np.asarray(image.convert("RGB"), dtype=np.float64) / 255.0


def _check_obj_indices(path: Path) -> None:
    """Names the line of the first face that points past the end, which trimesh reports as a bare IndexError or ignores."""
    counts = {"v": 0, "vt": 0}
    faces: list[tuple[int, dict[str, int], list[str]]] = []
    with path.open(encoding="utf-8", errors="replace") as lines:
        for number, line in enumerate(lines, 1):
            words = line.split()
            if not words:
                continue
            if words[0] in counts:
                counts[words[0]] += 1
            elif words[0] == "f":
                faces.append((number, dict(counts), words[1:]) if "-" in line else (number, counts, words[1:]))
    for number, before, corners in faces:
        for corner in corners:
            if corner.startswith(("#", "\\")):  # a comment, or the line goes on
                break
            for kind, word in zip(("v", "vt"), corner.split("/"), strict=False):
                if not word:
                    continue
                try:
                    index = int(word)
                except ValueError:
                    raise InputError(f"{path} line {number}: face corner {corner!r} is no v/vt/vn index") from None
                if index == 0 or index > counts[kind] or -index > before[kind]:
                    raise InputError(f"{path} line {number}: a face names {kind} {index}, but there are {counts[kind]} "
                                     f"({kind} 1 to {counts[kind]}); repair or drop that face")


@dataclass(frozen=True, eq=False)
class _Part:
    """One piece of a scene, in world space, as trimesh reads it: one uv and one colour a vertex."""

    positions: np.ndarray
    faces: np.ndarray
    uvs: np.ndarray | None
    colors: np.ndarray | None
    image: Image.Image | None
    factor: tuple[float, ...]


def _parts(scene: trimesh.Scene) -> list[_Part]:
    parts = []
    for node in scene.graph.nodes_geometry:
        transform, name = scene.graph[node]
        geometry = scene.geometry[name]
        if not isinstance(geometry, trimesh.Trimesh):
            continue
        positions = np.asarray(geometry.vertices, np.float64)
        faces = np.asarray(geometry.faces, np.int64)
        if not np.array_equal(transform, np.eye(4)):
            positions = positions @ transform[:3, :3].T + transform[:3, 3]
        if np.linalg.det(transform[:3, :3]) < 0.0:
            faces = faces[:, ::-1]  # a mirror turns faces inside out
        visual = geometry.visual
        material = getattr(visual, "material", None)
        image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
        if image is not None and image.format is None and image.size == (2, 2):
            image = None  # trimesh's stand-in where a part has uvs and no material
        factor = getattr(material, "baseColorFactor", None)
        uvs = getattr(visual, "uv", None)
        colors = visual.vertex_colors if visual.kind == "vertex" else None
        if visual.kind == "texture":
            colors = visual.vertex_attributes.get("color")
        if colors is not None:
            colors = np.asarray(colors)
            top = np.iinfo(colors.dtype).max if np.issubdtype(colors.dtype, np.integer) else 1.0
            colors = colors[:, :3] / top
        parts.append(_Part(
            positions, faces, None if uvs is None else np.asarray(uvs, np.float64)[:, :2] * (1, -1) + (0, 1), colors, image,
            (1.0, 1.0, 1.0) if factor is None else tuple(np.asarray(factor)[:3] / 255.0)))
    return parts


def _joined(parts: list[_Part]) -> Mesh:
    def stacked(arrays: list[np.ndarray | None]) -> np.ndarray | None:
        return None if any(array is None for array in arrays) else np.concatenate(arrays)

    offsets = np.cumsum([0] + [len(part.positions) for part in parts])
    positions = np.concatenate([part.positions for part in parts])
    faces = np.concatenate([part.faces + offset for part, offset in zip(parts, offsets, strict=False)])
    Mesh(positions, faces)  # name bad positions and faces by the file's own numbers, before anything is merged
    uvs, colors = stacked([part.uvs for part in parts]), stacked([part.colors for part in parts])

    used = faces.reshape(-1)
    first, inverse = unique_rows(positions[used])
    merged = inverse.reshape(-1, 3)
    solid = (merged != np.roll(merged, 1, axis=1)).all(axis=1)
    if not solid.any():
        raise InputError("no face has three different corners; a mesh needs at least one triangle")
    mesh = Mesh(positions[used][first], merged[solid], colors=None if colors is None else colors[used][first])
    if uvs is None:
        return mesh
    uv_first, uv_inverse = unique_rows(uvs[used])
    return replace(mesh, uvs=uvs[used][uv_first], uv_faces=uv_inverse.reshape(-1, 3)[solid], texture=_texture(parts))


def unique_rows(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`first` picks each distinct row once, in order of appearance; `inverse` rebuilds: rows == rows[first][inverse]."""
    _, first, inverse = np.unique(rows + 0.0, axis=0, return_index=True, return_inverse=True)  # + 0.0: -0.0 is 0.0
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return first[order], rank[inverse.reshape(-1)]


def _texture(parts: list[_Part]) -> np.ndarray | None:
    """The one base colour image of all parts, times its factor (which is linear, glTF 2.0 section 3.9.2)."""
    looks = []
    for part in parts:
        look = None if part.image is None else _texels(part.image)
        if look is not None and min(part.factor) < 1.0:
            look = np.clip(linear_to_srgb(srgb_to_linear(look) * part.factor), 0.0, 1.0)
        if not any(look is seen or (look is not None and seen is not None and np.array_equal(look, seen)) for seen in looks):
            looks.append(look)
    if len(looks) > 1:
        raise InputError(f"the parts have {len(looks)} different base colours or textures; one image for all is allowed; "
                         "bake them into one, or load the parts from files of their own")
    return looks[0]


def normalize(mesh: Mesh, radius: float = 1.0) -> Mesh:
    """The mesh moved so that its bounding box is centred on the origin and its furthest vertex is at `radius`."""
    positions = mesh.positions - (mesh.positions.min(axis=0) + mesh.positions.max(axis=0)) / 2.0
    size = float(np.linalg.norm(positions, axis=1).max())
    if size == 0.0:
        raise InputError("mesh has all its vertices in one point; it cannot be scaled into a ball")
    return replace(mesh, positions=positions * (radius / size))
