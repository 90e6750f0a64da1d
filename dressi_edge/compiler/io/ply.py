"""PLY: what the header declares, of any type, text or binary of either order.

Vertices: x y z, normals, colours (integers by their type's largest value, float as it is; sRGB), texture coordinates. Faces: polygons or
triangle strips, corners' texture coordinates (`texcoord`, with `texnumber`), colours of faces. v counts upwards and is turned here.
"""
from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...cache.errors import InputError, note
from .materials import Material, TextureMap
from .pieces import Piece, Pieces, decoded, listed, unit_colors
from .polygons import triangulated
from .textures import Picture, find_file

TYPES = {"char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
         "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "int64": "i8", "uint64": "u8",
         "float": "f4", "float32": "f4", "double": "f8", "float64": "f8"}
FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
COLORS = (("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"), ("r", "g", "b"))
UVS = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"), ("texture_s", "texture_t"))
KNOWN = {"x", "y", "z", "nx", "ny", "nz", "alpha", "a", "diffuse_alpha", "texnumber", "texcoord", "vertex_index", "vertex_indices",
         *sum(COLORS + UVS, ())}
MESH = ("vertex", "face", "tristrips")
MAX_HEADER = 1 << 20


@dataclass(frozen=True)
class _Property:
    name: str
    type: str
    count: str | None = None  # the type of a list's length


@dataclass(frozen=True, eq=False)
class _Column:
    """Values of a property, (n,), or of a list, flat, with starts (n + 1,); `type` as declared."""

    values: np.ndarray
    type: str
    starts: np.ndarray | None = None


def read_ply(path: Path, data: bytes) -> Pieces:
    """The pieces of a PLY file, one for each texture. Raises InputError, naming the file."""
    elements, order, comments, body = _header(path, data)
    tables, at = {}, body
    words = None if order else _Words(data[body:])
    needed = max((k for k, (name, _, _) in enumerate(elements) if name in MESH), default=-1)
    for name, count, properties in elements[:needed + 1]:
        if not properties:
            tables[name] = {}
        elif order:
            tables[name], at = _binary(path, data, at, name, count, properties, order)
        else:
            tables[name] = _text(path, words, name, count, properties)
    left = [f"{name} {p.name}" if name in MESH else name for name, _, properties in elements for p in properties
            if name not in MESH or p.name not in KNOWN]
    if left:
        note(f"{path}: {listed(left)} are not read")
    vertex = tables.get("vertex", {})
    vertex = {key: column for key, column in vertex.items() if column.starts is None}
    if not {"x", "y", "z"} <= set(vertex):
        raise InputError(f"mesh file {path} cannot be read: it has no element vertex with x, y, z; repair or convert it")
    positions = np.stack([vertex[axis].values.astype(np.float64) for axis in "xyz"], axis=-1)
    return Pieces(positions, _pieces(path, positions, vertex, tables, comments))


def _header(path: Path, data: bytes) -> tuple[list, str, list[str], int]:
    """Elements as (name, count, properties), the byte order ("" for text), comments, and where the body begins."""
    def wrong(text: str) -> InputError:
        return InputError(f"mesh file {path} cannot be read: {text}; repair or convert it")

    start = 3 if data.startswith(b"\xef\xbb\xbf") else 0
    match = re.search(rb"(?:^|[\r\n])end_header[ \t]*(\r\n|\n|\r)", data[:MAX_HEADER])
    if not re.match(rb"ply\s", data[start:start + 4]) or not match:
        raise wrong("it has no PLY header")
    elements: list[tuple[str, int, list[_Property]]] = []
    order, comments = None, []
    for line in re.split(r"\r\n|\n|\r", decoded(data[start:match.start()]))[1:]:
        words = line.split()
        if not words:
            continue
        try:
            if words[0] == "format":
                order = FORMATS[words[1]]
            elif words[0] in ("comment", "obj_info"):
                comments.append(line.strip().partition(" ")[2].strip())
            elif words[0] == "element":
                elements.append((words[1], int(words[2]), []))
                if elements[-1][1] < 0 or words[1] in [name for name, _, _ in elements[:-1]]:
                    raise ValueError
            elif words[0] == "property":
                p = _Property(words[4], TYPES[words[3]], TYPES[words[2]]) if words[1] == "list" else _Property(words[2], TYPES[words[1]])
                if p.name in [q.name for q in elements[-1][2]] or p.count and p.count[0] == "f":
                    raise ValueError
                elements[-1][2].append(p)
            else:
                raise ValueError
        except (IndexError, KeyError, ValueError):
            raise wrong(f"the header's line {line.strip()!r:.60} is malformed or unknown") from None
    if order is None:
        raise wrong("its header names no format")
    return elements, order, comments, match.end()


def _binary(path: Path, data: bytes, at: int, name: str, count: int, properties: list[_Property], order: str) -> tuple[dict, int]:
    """The element's columns, and where the next begins. Lists as long as the first row's are read at once, others row by row."""
    def short() -> InputError:
        return InputError(f"mesh file {path} cannot be read: it ends within its {count} of element {name}; it is truncated")

    lengths: dict[str, int] = {}
    if count:
        where = at
        for p in properties:
            if p.count is None:
                where += int(p.type[1])
                continue
            head = np.frombuffer(data[where:where + int(p.count[1])], order + p.count)
            if not len(head):
                raise short()
            lengths[p.name] = int(head[0])
            where += int(p.count[1]) + max(0, lengths[p.name]) * int(p.type[1])
    fields = []
    for k, p in enumerate(properties):
        if p.count:
            fields.append((f"n{k}", order + p.count))
        shape = (max(0, min(lengths.get(p.name, 0), len(data))),) if p.count else ()
        fields.append((f"p{k}", order + p.type, shape))
    row = np.dtype(fields)
    if count * row.itemsize <= len(data) - at:
        rows = np.frombuffer(data, row, count, at) if row.itemsize else np.zeros(count, row)
        if all((rows[f"n{k}"] == lengths.get(p.name, 0)).all() for k, p in enumerate(properties) if p.count):
            columns = {p.name: _Column(rows[f"p{k}"].reshape(-1), p.type,
                                       np.arange(count + 1) * lengths.get(p.name, 0) if p.count else None)
                       for k, p in enumerate(properties)}
            return columns, at + count * row.itemsize
    if not any(p.count for p in properties):
        raise short()
    values: list[list] = [[] for _ in properties]
    starts: list[list[int]] = [[0] for _ in properties]
    for _ in range(count):
        for k, p in enumerate(properties):
            n = 1
            if p.count:
                head = np.frombuffer(data[at:at + int(p.count[1])], order + p.count)
                n, at = int(head[0]) if len(head) else -1, at + int(p.count[1])
                starts[k].append(starts[k][-1] + n)
            size = n * int(p.type[1])
            if n < 0 or at + size > len(data):
                raise short()
            values[k].append(data[at:at + size])
            at += size
    return {p.name: _Column(np.frombuffer(b"".join(values[k]), order + p.type), p.type, np.array(starts[k]) if p.count else None)
            for k, p in enumerate(properties)}, at


class _Words:
    """The numbers of a text, taken in order; they end before the first word that is none."""

    def __init__(self, data: bytes):
        found = []
        for word in data.split():
            try:
                found.append(float(word))
            except ValueError:
                break
        self.values, self.at = np.array(found, np.float64), 0

    def take(self, n: int) -> np.ndarray | None:
        """The next n, or None where there are not as many."""
        if n < 0 or self.at + n > len(self.values):
            return None
        self.at += n
        return self.values[self.at - n:self.at]


def _text(path: Path, words: _Words, name: str, count: int, properties: list[_Property]) -> dict[str, _Column]:
    wrong = InputError(f"mesh file {path} cannot be read: its numbers end within the {count} of element {name}; repair it")
    if not any(p.count for p in properties):
        if (rows := words.take(count * len(properties))) is None:
            raise wrong
        rows = rows.reshape(count, len(properties))
        return {p.name: _Column(rows[:, k], p.type) for k, p in enumerate(properties)}
    values: list[list[np.ndarray]] = [[] for _ in properties]
    starts: list[list[int]] = [[0] for _ in properties]
    for _ in range(count):
        for k, p in enumerate(properties):
            n = 1
            if p.count:
                head = words.take(1)
                n = int(head[0]) if head is not None and 0 <= head[0] <= len(words.values) else -1
                starts[k].append(starts[k][-1] + n)
            if (found := words.take(n)) is None:
                raise wrong
            values[k].append(found)
    return {p.name: _Column(np.concatenate([np.zeros(0), *values[k]]), p.type, np.array(starts[k]) if p.count else None)
            for k, p in enumerate(properties)}


def _colors(path: Path, table: dict[str, _Column], what: str) -> np.ndarray | None:
    """(n, 3) in [0, 1]: integers of 8 and 16 bits by the largest of their type, float as it is."""
    for names in COLORS:
        if set(names) <= set(table):
            columns = [table[name] for name in names]
            if any(c.starts is not None for c in columns):
                continue
            tops = [np.iinfo(c.type).max if c.type in ("i1", "u1", "i2", "u2") else 1 for c in columns]  # of int, 255 or so is meant
            stacked = np.stack([c.values.astype(np.float64) / top for c, top in zip(columns, tops)], axis=-1)
            return unit_colors(stacked, f"{path}: colours of {what}")
    return None


def _uvs(table: dict[str, _Column]) -> np.ndarray | None:
    for names in UVS:
        if set(names) <= set(table) and not any(table[name].starts is not None for name in names):
            return np.stack([table[name].values.astype(np.float64) for name in names], axis=-1) * (1.0, -1.0) + (0.0, 1.0)
    return None


def _pieces(path: Path, positions: np.ndarray, vertex: dict, tables: dict, comments: list[str]) -> tuple[Piece, ...]:
    face = tables.get("face", {})
    index = next((face[name] for name in ("vertex_indices", "vertex_index") if name in face), None)
    triangles, places, owner = np.zeros((0, 3), np.int64), np.zeros((0, 3), np.int64), np.zeros(0, np.int64)
    if index is not None and index.starts is not None:
        corners = _whole(path, index.values)
        if len(corners) and not ((corners >= 0) & (corners < len(positions))).all():
            bad = int(np.argmax((corners < 0) | (corners >= len(positions))))
            row = int(np.searchsorted(index.starts, bad, "right")) - 1
            raise InputError(f"{path}: faces[{row}] is {corners[index.starts[row]:index.starts[row + 1]].tolist()!s:.60}, but there are "
                             f"{len(positions)} vertices, 0 to {len(positions) - 1}; repair or drop that face")
        places, owner = triangulated(positions, index.starts, corners)
        triangles = corners[places]
    strips = tables.get("tristrips", {})
    for name in ("vertex_indices", "vertex_index"):
        if name in strips and strips[name].starts is not None:
            found = strip_faces(_whole(path, strips[name].values), strips[name].starts)
            if ((found < 0) | (found >= len(positions))).any():
                raise InputError(f"{path}: a triangle strip names vertex {int(found.max())}, but there are {len(positions)}; repair it")
            triangles = np.concatenate([triangles, found])
    count = len(triangles)
    normals = uvs = None
    if {"nx", "ny", "nz"} <= set(vertex):
        normals = (np.nan_to_num(np.stack([vertex[a].values.astype(np.float64) for a in ("nx", "ny", "nz")], -1)), triangles)
    colors, of_faces, at_vertices = _colors(path, vertex, "vertices"), _colors(path, face, "faces"), _uvs(vertex)
    colored = None if colors is None else (colors, triangles)
    if colored is None and of_faces is not None and len(of_faces) and len(owner) == count:
        colored = (of_faces, np.repeat(owner[:, None], 3, axis=1))
    if at_vertices is not None:
        uvs = (at_vertices, triangles)
    wedge, with_uv = face.get("texcoord"), np.ones(count, bool)
    if wedge is not None and wedge.starts is not None and index is not None and len(owner) == count:
        full = np.diff(wedge.starts) == 2 * np.diff(index.starts)  # u and v of each corner
        with_uv = full[owner]
        values = wedge.values[:2 * (len(wedge.values) // 2)].astype(np.float64).reshape(-1, 2) * (1.0, -1.0) + (0.0, 1.0)
        at = wedge.starts[owner][:, None] // 2 + places - index.starts[owner][:, None]
        uvs = (values, np.where(with_uv[:, None], at, 0)) if len(values) else None
    piece = Piece("", triangles, Material(), {} if uvs is None else {0: uvs}, colored, normals)
    return _by_texture(path, piece, with_uv, owner, face.get("texnumber"), comments)


def _by_texture(path: Path, piece: Piece, with_uv: np.ndarray, owner: np.ndarray, texnumber, comments: list[str]) -> tuple[Piece, ...]:
    """The piece, cut by the textures that comments name ("TextureFile skin.png")."""
    names = [match[1].strip() for text in comments if (match := re.match(r"(?i)texturefile\s+(.+)", text))]
    if not names or not piece.uvs:
        return (piece,) if len(piece.faces) else ()
    number = np.zeros(len(piece.faces), np.int64)
    if texnumber is not None and texnumber.starts is None and len(owner) == len(number):
        number = texnumber.values.astype(np.int64)[owner]
    pieces, number = [], np.where(with_uv, number, -1)
    for k in dict.fromkeys(number.tolist()):
        keep, material = number == k, Material()
        if 0 <= k < len(names):
            picture = Picture(f"{names[k]} (named in {path.name})", find_file(path.parent, names[k]))
            material = Material(names[k], base_texture=TextureMap(picture), stated=True)
        part = piece.taken(keep)
        pieces.append(Piece(material.name, part.faces, material, part.uvs if k >= 0 else {}, part.colors, part.normals,
                            order=np.flatnonzero(keep)))
    return tuple(pieces)


def _whole(path: Path, values: np.ndarray) -> np.ndarray:
    with np.errstate(invalid="ignore"):
        whole = values.astype(np.int64)
        if not (whole == values).all():
            raise InputError(f"{path}: a face names a vertex that is no whole number; repair it")
    return whole


def strip_faces(indices: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """Triangles (T, 3) of strips, indices[starts[k]:starts[k + 1]] each; a negative index begins a new one, every other is turned."""
    faces = [np.zeros((0, 3), np.int64)]
    for first, end in zip(starts[:-1], starts[1:]):
        cuts = first + np.flatnonzero(indices[first:end] < 0)
        for a, b in zip([first, *(cuts + 1)], [*cuts, end]):
            strip = indices[a:b]
            if len(strip) >= 3:
                three = np.stack([strip[:-2], strip[1:-1], strip[2:]], axis=-1)
                three[1::2] = three[1::2, [1, 0, 2]]
                faces.append(three)
    return np.concatenate(faces)
