"""Mesh files: OBJ, PLY, STL, OFF, glTF in; one `Mesh`, or `Part`s with their materials, out.

What a file names has arrived, is applied, or is named in an InputError (where the result would be wrong without it) or in an
InputWarning (where it would only be poorer). Vertices at exactly the same position are one vertex, in the order in which the file has
them first, those that no face uses too; `Mesh.vertex_map` says which is which where that makes them fewer.
"""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...cache.errors import InputError, note
from .bake import Surface, baked
from .gltf import read_gltf
from .images import linear_to_srgb, srgb_to_linear
from .materials import Part
from .mesh import Mesh, face_normals, middle_of, unique_rows
from .obj import read_obj
from .pieces import MAX_BYTES, Corners, Piece, Pieces, listed
from .plain import read_off, read_stl
from .ply import read_ply
from .textures import load_texture

READERS = {".obj": read_obj, ".ply": read_ply, ".stl": read_stl, ".off": read_off, ".glb": read_gltf, ".gltf": read_gltf}


def load_mesh(path: str | Path, texture: str | Path | None = None) -> Mesh:
    """All of a mesh file as one mesh, with one texture or with colours; a scene is flattened with its transforms.

    Colours of materials are corner colours where nothing has a texture. Where something has, all of it is one texture: the file's own
    if that says it all, else an atlas of its pictures and colours (`bake.py`). `texture` names an image to use instead of all that.
    Faces of which two corners are at one position are dropped. Raises InputError, naming the file; warns of what it leaves out.
    """
    path = Path(path)
    pieces = load_pieces(path)
    try:
        mesh = _joined(path, pieces, given=texture is not None)
        return mesh if texture is None else replace(mesh, texture=load_texture(texture))
    except InputError as error:
        raise error if str(error).startswith(str(path)) else InputError(f"{path}: {error}") from None


def load_parts(path: str | Path) -> tuple[Part, ...]:
    """The parts of a mesh file with their materials: one for each primitive of glTF's nodes, object and material of OBJ, texture of PLY.

    Vertices are merged within each part, not between parts; those that no part uses are left. A missing picture of a base colour is an
    InputError, other missing ones are warned of and dropped.
    """
    path = Path(path)
    pieces = load_pieces(path)
    try:
        return tuple(_part(path, pieces, k) for k in range(len(pieces.pieces)))
    except InputError as error:
        raise error if str(error).startswith(str(path)) else InputError(f"{path}: {error}") from None


def load_pieces(path: Path) -> Pieces:
    """What the reader for the file's extension gives, with faces of at least one triangle; all arrays checked."""
    if not path.is_file():
        raise InputError(f"mesh file {path} does not exist; check the path")
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise InputError(f"mesh file {path} cannot be read: extension {path.suffix or 'none'} is unknown; readable are "
                         f"{' '.join(READERS)}; convert it")
    try:
        if path.stat().st_size > MAX_BYTES:
            raise InputError(f"mesh file {path} has {path.stat().st_size} bytes; at most {MAX_BYTES} are allowed; simplify it")
        with np.errstate(all="ignore"):  # of NaN and Inf in the file, which are named below
            pieces = reader(path, path.read_bytes())
    except OSError as error:
        raise InputError(f"mesh file {path} cannot be read: {error.strerror or error}; check it") from None
    except MemoryError:
        raise InputError(f"mesh file {path} needs more memory than there is; simplify it") from None
    pieces = Pieces(pieces.positions, tuple(piece for piece in pieces.pieces if len(piece.faces)))
    if not pieces.pieces:
        raise InputError(f"mesh file {path} has no faces; a mesh needs at least one triangle")
    try:
        for piece in pieces.pieces:  # names what is wrong by the file's own numbers, before anything is merged
            Mesh(pieces.positions, piece.faces)
            for values, faces in piece.uvs.values():
                Mesh(pieces.positions, piece.faces, values, faces)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    return pieces


def _merged(positions: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    """`first` of each position, in order, and the map from all of them; None where no two are the same."""
    first, where = unique_rows(positions)
    return first, None if len(first) == len(positions) else where


def _solid(faces: np.ndarray) -> np.ndarray:
    """Which faces have three different corners. Raises InputError where none has."""
    solid = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    if not solid.any():
        raise InputError("no face has three different corners; a mesh needs at least one triangle")
    return solid


def _joined(path: Path, pieces: Pieces, given: bool) -> Mesh:
    first, where = _merged(pieces.positions)
    parts = [piece if where is None else replace(piece, faces=where[piece.faces]) for piece in pieces.pieces]
    solid = _solid(np.concatenate([part.faces for part in parts]))
    keep = np.split(solid, np.cumsum([len(part.faces) for part in parts])[:-1])
    parts = [part.taken(k) for part, k in zip(parts, keep, strict=True) if k.any()]
    faces = np.concatenate([part.faces for part in parts])
    mesh = Mesh(pieces.positions[first], faces, vertex_map=where)
    mesh = _with_normals(mesh, parts)
    textured = [not given and part.material.base_texture is not None and _uv_of(part) is not None for part in parts]
    if lacking := [part.name for part, drawn in zip(parts, textured) if not given and part.material.base_texture and not drawn]:
        note(f"{path}: {listed(lacking)}: no texture coordinates for the base colour texture; it is left out")
    if any(textured):
        surfaces = [Surface(_uv_of(part), part.material.base_texture, part.material.base_color[:3], None, len(part.faces)) if drawn else
                    Surface(None, None, (1.0, 1.0, 1.0), _stated_colors(part), len(part.faces)) for part, drawn in zip(parts, textured)]
        mesh = replace(mesh, **baked(surfaces))
        if multiplied := [part.name for part, drawn in zip(parts, textured) if drawn and part.colors is not None
                          and (part.colors[0][part.colors[1]] < 1.0 - 1e-6).any()]:
            note(f"{path}: {listed(multiplied)}: colours of vertices, which multiply the texture, are left out")
    else:
        stated = [_stated_colors(part) for part in parts]
        if any(colors is not None for colors in stated):
            white = [(np.ones((1, 3)), np.zeros_like(part.faces)) for part in parts]
            mesh = _with_colors(mesh, [w if colors is None else colors for colors, w in zip(stated, white)])
        uvs = [_uv_of(part) for part in parts]
        bare = [part.name or "some faces" for part, uv in zip(parts, uvs) if uv is None]
        if not bare:
            mesh = replace(mesh, **_compact("uvs", "uv_faces", uvs))
        elif len(bare) < len(parts):
            note(f"{path}: {listed(bare)}: no texture coordinates; those of the other parts are left out")
    _warn_of_more(path, parts)
    orders = [part.order for part in parts]
    return mesh if any(order is None for order in orders) or len(parts) == 1 else _reordered(mesh, np.argsort(np.concatenate(orders)))


def _reordered(mesh: Mesh, order: np.ndarray) -> Mesh:
    """The mesh with its faces in the order of the file."""
    named = {name: getattr(mesh, name) for name in ("faces", "uv_faces", "color_faces", "normal_faces")}
    return replace(mesh, **{name: faces[order] for name, faces in named.items() if faces is not None})


def _uv_of(piece: Piece) -> Corners | None:
    """The texture coordinates of the piece's base colour texture, or its first."""
    base = piece.material.base_texture
    if base is None:
        return piece.uvs[min(piece.uvs)] if piece.uvs else None
    found = piece.uvs.get(base.uv_set)
    return None if found is None else (base.applied(found[0]), found[1])


def _stated_colors(piece: Piece) -> Corners | None:
    """Colours of corners times the material's, sRGB encoded; None where the file states neither."""
    factor = np.array(piece.material.base_color[:3])
    if piece.colors is None:
        return (linear_to_srgb(factor)[None], np.zeros_like(piece.faces)) if piece.material.stated else None
    if (factor == 1.0).all():
        return piece.colors
    return linear_to_srgb(srgb_to_linear(piece.colors[0]) * factor), piece.colors[1]


def _stacked(corners: Sequence[Corners]) -> Corners:
    starts = np.cumsum([0] + [len(values) for values, _ in corners])
    return (np.concatenate([values for values, _ in corners]),
            np.concatenate([faces + start for (_, faces), start in zip(corners, starts)]))


def _compact(values: str, faces: str, corners: Sequence[Corners]) -> dict[str, np.ndarray]:
    """Those of the values that are used, each once, in the order of the file."""
    found, index = _stacked(corners)
    used, inverse = np.unique(index.reshape(-1), return_inverse=True)
    first, where = unique_rows(found[used])
    return {values: found[used][first], faces: where[inverse.reshape(-1)].reshape(-1, 3)}


def _with_normals(mesh: Mesh, parts: Sequence[Piece]) -> Mesh:
    """The mesh with normals where any part has some; the face's own for corners without."""
    if all(part.normals is None for part in parts):
        return mesh
    own = np.repeat(face_normals(mesh.positions, mesh.faces)[:, None], 3, axis=1)
    start = 0
    for part in parts:
        rows = slice(start, start := start + len(part.faces))
        if part.normals is not None:
            given = part.normals[0][part.normals[1]]
            length = np.linalg.norm(given, axis=-1, keepdims=True)
            there = np.isfinite(length) & (length > 0.0)
            own[rows] = np.where(there, given / np.where(there, length, 1.0), own[rows])
    corners = np.arange(3 * len(own)).reshape(-1, 3)
    return replace(mesh, **_compact("normals", "normal_faces", [(own.reshape(-1, 3), corners)]))


def _with_colors(mesh: Mesh, colors: Sequence[Corners]) -> Mesh:
    """The mesh with colours of all faces: one for each vertex, or for each vertex and colour where corners at one vertex differ."""
    corners = np.concatenate([found[0][found[1]] for found in colors]).reshape(-1, 3)
    vertices = mesh.faces.reshape(-1)
    order = np.argsort(vertices, kind="stable")
    first, inverse = unique_rows(np.concatenate([vertices[order, None].astype(np.float64), corners[order]], axis=1))
    of_vertex, entries = vertices[order][first], corners[order][first]
    if len(np.unique(of_vertex)) < len(of_vertex):
        index = np.empty(len(vertices), np.int64)
        index[order] = inverse
        return replace(mesh, colors=entries, color_faces=index.reshape(-1, 3))
    whole = np.ones_like(mesh.positions)
    whole[of_vertex] = entries
    return replace(mesh, colors=whole)


def _part(path: Path, pieces: Pieces, k: int) -> Part:
    piece, base = pieces.pieces[k], pieces.pieces[k].material.base_texture
    chosen = np.arange(*piece.vertices) if piece.vertices else np.arange(len(pieces.positions)) if len(pieces.pieces) == 1 \
        else np.unique(piece.faces)
    first, where = _merged(pieces.positions[chosen])
    local = np.zeros(len(pieces.positions), np.int64)
    local[chosen] = np.arange(len(chosen)) if where is None else where
    piece = replace(piece, faces=local[piece.faces])
    piece = piece.taken(_solid(piece.faces))
    mesh = _with_normals(Mesh(pieces.positions[chosen][first], piece.faces, vertex_map=where), [piece])
    mesh = mesh if piece.colors is None else _with_colors(mesh, [piece.colors])
    uv = _uv_of(piece)
    if uv is not None:
        mesh = replace(mesh, **_compact("uvs", "uv_faces", [uv]))
    if base is not None:
        if uv is None:
            note(f"{path}: {piece.name}: no texture coordinates for the base colour texture; it is left out")
            piece = replace(piece, material=replace(piece.material, base_texture=None))
        else:
            wrap = base.wrap[0] if base.wrap in (("repeat",) * 2, ("clamp",) * 2) else "repeat"
            mesh = replace(mesh, texture=base.picture.texels()[..., :3], wrap=wrap)
    missing = [name for name, found in piece.material.extra_maps.items() if found.picture.source is None]
    if missing:
        note(f"{path}: {piece.name}: the pictures of {listed(missing)} do not exist; they are left out")
    material = replace(piece.material, **{name.replace("-", "_") + "_texture": None for name in missing})
    return Part(piece.name, mesh, material, dict(piece.uvs))


def _warn_of_more(path: Path, parts: Sequence[Piece]) -> None:
    """One line about what materials have and one mesh has not."""
    maps = [f"{name} maps" for part in parts for name in part.material.extra_maps]
    maps += ["emission" for part in parts if any(part.material.emissive) and part.material.emissive_texture is None]
    if maps:
        note(f"{path}: not used by a single mesh: {listed(maps)}")
    clear = [part.material.name or part.name for part in parts if part.material.alpha_mode != "OPAQUE"]
    if clear:
        note(f"{path}: {listed(clear)}: transparency is not drawn")


def normalize(mesh: Mesh, radius: float = 1.0) -> Mesh:
    """The mesh moved so that the bounding box of what its faces use is centred on the origin, the furthest of it at `radius`."""
    used = mesh.positions[np.unique(mesh.faces)]
    centre = middle_of(used)
    size = float(np.linalg.norm(used - centre, axis=1).max())
    if size == 0.0:
        raise InputError("mesh has all its vertices in one point; it cannot be scaled into a ball")
    return replace(mesh, positions=(mesh.positions - centre) * (radius / size))
