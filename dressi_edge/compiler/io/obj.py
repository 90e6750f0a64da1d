"""Wavefront OBJ: polygons with positions, texture coordinates, normals, vertex colours and materials (`mtl.py`).

After the format's appendix B1 and what exporters make of it: relative indices count from where the face stands, `v x y z r g b` has
sRGB colours, vt counts upwards (and is turned here), polygons may be concave. Lines, points, curves and surfaces are left out, by name.
"""
from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ...cache.errors import InputError, note
from .materials import Material
from .mtl import read_mtl
from .pieces import Piece, Pieces, decoded, listed, numbers, unit_colors
from .polygons import triangulated
from .textures import find_file

LEFT_OUT = {"p": "points", "l": "lines", "curv": "curves", "curv2": "curves", "surf": "surfaces", "bzp": "patches", "cdc": "curves",
            "cdp": "patches", "res": "patches", "call": "other files (call)", "csh": "commands (csh)"}
IGNORED = {"g", "s", "mg", "vp", "deg", "bmat", "step", "cstype", "parm", "trim", "hole", "scrv", "sp", "end", "con", "bevel", "c_interp",
           "d_interp", "lod", "shadow_obj", "trace_obj", "ctech", "stech", "usemap", "maplib", "bsp"}


class _Text:
    """What the statements of an OBJ file say, before numbers are made of it."""

    def __init__(self, path: Path, text: str):
        self.path = path
        self.rows: dict[str, list[list[str]]] = {"v": [], "vt": [], "vn": []}
        self.lines: dict[str, list[int]] = {"v": [], "vt": [], "vn": []}
        self.indices: list[tuple[int, int, int]] = []  # of v, vt and vn for each corner, from 1; 0: none
        self.starts, self.owner, self.face_lines = [0], [], []
        self.owners: dict[tuple[str, str], int] = {}  # (object, material)
        self.libraries: list[str] = []
        left_out: dict[str, None] = {}
        unknown: dict[str, None] = {}
        name, material, waiting, start = "", "", "", 0
        for number, line in enumerate(re.split(r"\r\n|\n|\r", text), 1):
            if line.rstrip().endswith("\\"):  # the statement goes on
                waiting, start = waiting + line.rstrip()[:-1] + " ", start or number
                continue
            line, waiting, number, start = waiting + line, "", start or number, 0
            words = line.split()
            if not words or words[0][0] == "#":
                continue
            key = words[0]
            if key in self.rows:
                self.rows[key].append(_uncommented(words)[1:])
                self.lines[key].append(number)
            elif key in ("f", "fo"):
                self._face(_uncommented(words)[1:], number)
                self.owner.append(self.owners.setdefault((name, material), len(self.owners)))
            elif key == "usemtl":
                material = line.strip()[6:].strip()
            elif key == "o":
                name = line.strip()[1:].strip()
            elif key == "mtllib":
                self.libraries.append(line.strip()[6:].strip())
            elif key in LEFT_OUT:
                left_out[LEFT_OUT[key]] = None
            elif key not in IGNORED and key.strip("\0\x1a"):
                unknown[key] = None
        if left_out:
            note(f"{path}: not read are {listed(left_out)}")
        if unknown:
            note(f"{path}: unknown statements are not read: {listed(unknown)}")

    def _face(self, words: list[str], number: int) -> None:
        counts = [len(self.rows[kind]) for kind in ("v", "vt", "vn")]
        for word in words:
            corner = []
            for k, part in enumerate(word.split("/")):
                try:
                    index = int(part) if part or k == 0 else 0
                except ValueError:
                    index = None
                if index is None or k > 2:
                    raise InputError(f"{self.path} line {number}: face corner {word!r:.40} is no v/vt/vn index")
                if index < 0:
                    index += counts[k] + 1
                if index <= 0 and part or index > 1 << 40:
                    self._beyond(number, "v vt vn".split()[k], part, counts[k])
                corner.append(index)
            self.indices.append((corner + [0, 0])[:3] if len(corner) < 3 else corner)
        self.starts.append(len(self.indices))
        self.face_lines.append(number)

    def _beyond(self, number: int, kind: str, index, count: int) -> None:
        raise InputError(f"{self.path} line {number}: a face names {kind} {index:.40}, but there are {count} "
                         f"({kind} 1 to {count}); repair or drop that face")

    def checked_indices(self) -> np.ndarray:
        """(C, 3) indices from 0, -1 for none. Raises InputError that names the line of the first which points past the end."""
        found = np.array(self.indices, np.int64).reshape(-1, 3) - 1
        counts = [len(self.rows[kind]) for kind in ("v", "vt", "vn")]
        if (bad := found >= counts).any():
            corner, k = np.argwhere(bad)[0]
            face = int(np.searchsorted(self.starts, corner, "right")) - 1
            self._beyond(self.face_lines[face], "v vt vn".split()[k], str(found[corner, k] + 1), counts[k])
        return found

    def numbers(self, kind: str, least: int, most: int) -> np.ndarray:
        """(n, most) of the statements `kind`, NaN where a row is shorter. Raises InputError that names the line."""
        rows = self.rows[kind]
        sizes = np.array([len(row) for row in rows], np.int64)
        if (sizes < least).any():
            row = int(np.argmax(sizes < least))
            raise InputError(f"{self.path} line {self.lines[kind][row]}: {kind} has {sizes[row]} numbers; {least} are needed")
        out = np.full((len(rows), most), np.nan)
        for size in np.unique(sizes):
            which, columns = np.flatnonzero(sizes == size), min(int(size), most)
            try:
                out[which, :columns] = np.array([rows[i][:columns] for i in which], np.float64)
            except ValueError:
                for i in which:
                    numbers(rows[i][:columns], f"{self.path} line {self.lines[kind][i]}")
        return out


def _uncommented(words: list[str]) -> list[str]:
    """The words up to a comment and without what DOS and C leave at a file's end."""
    for k, word in enumerate(words):
        if word[0] in "#\0\x1a":
            return words[:k]
    return words


def read_obj(path: Path, data: bytes) -> Pieces:
    """The pieces of an OBJ file, one for each object and material. Raises InputError, naming the line."""
    text = _Text(path, decoded(data))
    materials = _materials(text)
    positions, colors = _vertices(text)
    uvs = text.numbers("vt", 1, 2)
    uvs = np.nan_to_num(uvs, nan=0.0) if np.isnan(uvs[:, 1:]).any() else uvs  # vt u: a texture of one row
    normals = np.concatenate([text.numbers("vn", 3, 3), np.zeros((1, 3))])  # the last: none
    corners = text.checked_indices()
    if not len(positions) or not len(corners):
        return Pieces(positions, ())
    places, face = triangulated(positions, np.array(text.starts), corners[:, 0])
    owner, three = np.array(text.owner)[face], corners[places]
    has_uv = (three[..., 1] >= 0).all(axis=1)
    pieces = []
    for (name, material), number in text.owners.items():
        for with_uv in (True, False):
            which = np.flatnonzero((owner == number) & (has_uv == with_uv))
            if len(which):
                t = three[which]
                pieces.append(Piece(
                    name or material, t[..., 0], materials.get(material, Material(material)),
                    {0: (uvs * (1.0, -1.0) + (0.0, 1.0), t[..., 1])} if with_uv else {},
                    None if colors is None else (colors, t[..., 0]),
                    (normals, t[..., 2]) if (t[..., 2] >= 0).any() else None, order=which))
    return Pieces(positions, tuple(pieces))


def _vertices(text: _Text) -> tuple[np.ndarray, np.ndarray | None]:
    """Positions, and colours where any vertex has one: x y z, x y z w, x y z r g b, or x y z r g b a; white where others have one."""
    rows = text.numbers("v", 3, 7)
    colored = ~np.isnan(rows[:, 5]) if len(rows) else np.zeros(0, bool)
    if not colored.any():
        return rows[:, :3], None
    colors = np.ones((len(rows), 3))
    colors[colored] = unit_colors(rows[colored, 3:6], f"{text.path}: vertex colours")
    return rows[:, :3], colors


def _materials(text: _Text) -> dict[str, Material]:
    """The materials that faces use, by name, of all libraries; a warning for those that are nowhere."""
    found: dict[str, Material] = {}
    folder, missing = text.path.parent, []
    for library in text.libraries:
        whole = find_file(folder, library)
        for name in [library] if whole else library.split():
            file = whole or find_file(folder, name)
            if file is None:
                missing.append(name)
                continue
            try:
                found = {**read_mtl(file), **found}
            except OSError as error:
                raise InputError(f"{text.path}: material file {file} cannot be read: {error.strerror or error}; check it") from None
    if missing:
        note(f"{text.path}: material file {listed(missing)} does not exist, so the file has no materials and no textures of it")
    wanted = {material for _, material in text.owners if material}
    if not missing and (nowhere := sorted(wanted - set(found))):
        note(f"{text.path}: material {listed(nowhere)} is in no material file; it counts as none")
    return found
