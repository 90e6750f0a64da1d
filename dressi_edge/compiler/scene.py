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

from dressi_edge.cache.errors import InputError
from dressi_edge.cache.layout import beyond_fp32
from dressi_edge.compiler.charts import cube_charts, texel_directions
from dressi_edge.compiler.views import linear_to_srgb, srgb_to_linear


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
    try:
        with Image.open(path) as image:
            return _texels(image)
    except (OSError, ValueError) as error:
        raise InputError(f"texture {path} cannot be read ({error}); give a PNG or JPEG file") from None


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
    first, inverse = _unique_rows(positions[used])
    merged = inverse.reshape(-1, 3)
    solid = (merged != np.roll(merged, 1, axis=1)).all(axis=1)
    if not solid.any():
        raise InputError("no face has three different corners; a mesh needs at least one triangle")
    mesh = Mesh(positions[used][first], merged[solid], colors=None if colors is None else colors[used][first])
    if uvs is None:
        return mesh
    uv_first, uv_inverse = _unique_rows(uvs[used])
    return replace(mesh, uvs=uvs[used][uv_first], uv_faces=uv_inverse.reshape(-1, 3)[solid], texture=_texture(parts))


def _unique_rows(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
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


def icosphere(subdivisions: int, radius: float = 1.0) -> Mesh:
    """A sphere of 10 * 4**subdivisions + 2 vertices with cube-map uvs (none for 0: those faces are larger than a cube side)."""
    if not 0 <= subdivisions <= 8:
        raise InputError(f"icosphere has {subdivisions} subdivisions; allowed are 0 to 8 (655362 vertices)")
    return _geodesic(2 ** subdivisions, radius)


def sphere(vertices: int, radius: float = 1.0) -> Mesh:
    """The geodesic sphere with cube-map uvs whose vertex count is nearest: 42, 92, 162, 252, ... 10 n**2 + 2."""
    if not 4 <= vertices <= 700_000:
        raise InputError(f"sphere of {vertices} vertices; allowed are 4 to 700000")
    return _geodesic(max(2, round(((vertices - 2) / 10.0) ** 0.5)), radius)


def _geodesic(frequency: int, radius: float) -> Mesh:
    """An icosahedron with every edge cut in `frequency` pieces, pushed onto the sphere; faces are seen anticlockwise."""
    if not (np.isfinite(radius) and radius > 0.0):
        raise InputError(f"sphere radius is {radius}; it must be a finite number above 0")
    golden = (1.0 + 5.0 ** 0.5) / 2.0
    corners = np.array([(0, a, b * golden) for a in (-1, 1) for b in (-1, 1)], dtype=np.float64)
    corners = np.concatenate([np.roll(corners, turn, axis=1) for turn in range(3)])
    close = np.abs(np.linalg.norm(corners[:, None] - corners[None], axis=-1) - 2.0) < 1e-9
    triples = [(a, b, c) for a in range(12) for b in range(a) for c in range(b) if close[a, b] and close[b, c] and close[a, c]]
    # Rows of a triangle of points i + j + k = frequency, and the small triangles between neighbouring rows.
    grid = np.array([(frequency - i, i - j, j) for i in range(frequency + 1) for j in range(i + 1)]) / frequency
    grid = np.sin(grid * np.arctan(2.0))  # slerp along the edges, whose angle that is: more even than plain projection
    at = [i * (i + 1) // 2 for i in range(frequency + 1)]
    small = [(at[i] + j, at[i + 1] + j, at[i + 1] + j + 1) for i in range(frequency) for j in range(i + 1)]
    small += [(at[i] + j, at[i + 1] + j + 1, at[i] + j + 1) for i in range(frequency) for j in range(i)]
    points = np.concatenate([grid @ corners[list(triple)] for triple in triples])
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    faces = np.concatenate([np.array(small) + n * len(grid) for n in range(len(triples))])
    first, inverse = _unique_rows(np.round(points, 9))
    points, faces = points[first], inverse[faces]
    a, b, c = (points[faces[:, i]] for i in range(3))
    inwards = np.einsum("ij,ij->i", np.cross(b - a, c - a), a + b + c) < 0.0
    faces[inwards] = faces[inwards][:, ::-1]
    if frequency == 1:
        return Mesh(points * radius, faces)
    charts = cube_charts(points, faces)
    return Mesh(points * radius, faces, charts.uvs, charts.uv_faces)


def normalize(mesh: Mesh, radius: float = 1.0) -> Mesh:
    """The mesh moved so that its bounding box is centred on the origin and its furthest vertex is at `radius`."""
    positions = mesh.positions - (mesh.positions.min(axis=0) + mesh.positions.max(axis=0)) / 2.0
    size = float(np.linalg.norm(positions, axis=1).max())
    if size == 0.0:
        raise InputError("mesh has all its vertices in one point; it cannot be scaled into a ball")
    return replace(mesh, positions=positions * (radius / size))


def pear(texture_height: int = 256, seed: int = 7) -> Mesh:
    """A textured target of our own: a bent pear of 2252 vertices and 4500 faces in the unit ball, y up, closed.

    The texture is (texture_height, 1.5 * texture_height, 3); spots and mottling come from `seed`.
    """
    ball = _geodesic(15, 1.0)
    angle = np.arccos(np.clip(ball.positions[:, 1], -1.0, 1.0))  # from the stem down
    around = np.arctan2(ball.positions[:, 2], ball.positions[:, 0])
    up = np.cos(angle)
    width = np.sin(angle) * (0.60 - 0.22 * up - 0.10 * np.exp(-((up - 0.42) / 0.28) ** 2))
    height = 1.02 * up - 0.16 * np.exp(-(angle / 0.24) ** 2) + 0.12 * np.exp(-((np.pi - angle) / 0.30) ** 2)
    bend = 0.16 * np.maximum(height, -0.4) ** 2
    positions = np.stack([width * np.cos(around) + bend, height, width * np.sin(around)], axis=1)
    charts = cube_charts(ball.positions, ball.faces)
    directions = texel_directions(texture_height, texture_height * 3 // 2, charts.reach, charts.gutter)
    return normalize(Mesh(positions, ball.faces, charts.uvs, charts.uv_faces, texture=_pear_skin(directions, seed)))


def _pear_skin(direction: np.ndarray, seed: int) -> np.ndarray:
    """sRGB albedo (h, w, 3) by direction (h, w, 3): green to yellow with mottling, a red cheek, brown ends and spots."""
    rng = np.random.default_rng(seed)

    def blend(below: np.ndarray, above: tuple[float, float, float], amount: np.ndarray) -> np.ndarray:
        return below + (np.array(above) - below) * np.clip(amount, 0.0, 1.0)[..., None]

    waves = rng.normal(size=(14, 3)) * np.linspace(3.0, 11.0, 14)[:, None]
    mottle = np.sin(direction @ waves.T + rng.uniform(0.0, 2.0 * np.pi, 14)).mean(axis=-1)
    cheek = np.array([0.75, -0.25, 0.61])
    skin = np.broadcast_to(np.array([0.50, 0.66, 0.18]), direction.shape)
    skin = blend(skin, (0.90, 0.82, 0.28), 0.45 - 0.55 * direction[..., 1] + 1.1 * mottle)
    skin = blend(skin, (0.80, 0.33, 0.20), 1.1 * (direction @ cheek - 0.45) + 0.8 * mottle)
    for centre in rng.normal(size=(170, 3)):
        size = rng.uniform(0.025, 0.055)
        distance = np.linalg.norm(direction - centre / np.linalg.norm(centre), axis=-1)
        skin = blend(skin, (0.42, 0.29, 0.13), 0.85 * np.clip(2.0 - 2.0 * distance / size, 0.0, 1.0))
    away = np.arccos(np.clip(np.abs(direction[..., 1]), 0.0, 1.0))
    return np.clip(blend(skin, (0.33, 0.22, 0.11), 1.3 - away / 0.22), 0.0, 1.0)
