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

KINDS = ("v", "vt", "vn")
FORMS = {form: (re.compile(f"{one}(?: {one})*"), columns) for form, one, columns in (
    ("v", r"-?\d{1,12}", [0]), ("v/vt", r"-?\d{1,12}/-?\d{1,12}", [0, 1]), ("v//vn", r"-?\d{1,12}//-?\d{1,12}", [0, 2]),
    ("v/vt/vn", r"-?\d{1,12}/-?\d{1,12}/-?\d{1,12}", [0, 1, 2]))}
LEFT_OUT = {"p": "points", "l": "lines", "curv": "curves", "curv2": "curves", "surf": "surfaces", "bzp": "patches", "cdc": "curves",
            "cdp": "patches", "res": "patches", "call": "other files (call)", "csh": "commands (csh)"}
IGNORED = {"g", "s", "mg", "vp", "deg", "bmat", "step", "cstype", "parm", "trim", "hole", "scrv", "sp", "end", "con", "bevel", "c_interp",
           "d_interp", "lod", "shadow_obj", "trace_obj", "ctech", "stech", "usemap", "maplib", "bsp"}


class _Text:
    """What the statements of an OBJ file say, before numbers are made of it."""

    def __init__(self, path: Path, text: str):
        self.path = path
        self.words: dict[str, list[str]] = {kind: [] for kind in KINDS}  # flat: a list a line would take most of the time
        self.counts: dict[str, list[int]] = {kind: [] for kind in KINDS}  # of words in each statement
        self.lines: dict[str, list[int]] = {kind: [] for kind in KINDS}
        self.faces: list[tuple[str, int, int, int, int]] = []  # corners; how many v, vt and vn there were; the line
        sizes: list[int] = []
        self.owner: list[int] = []
        self.owners: dict[tuple[str, str], int] = {}  # (object, material)
        self.libraries: list[str] = []
        v, vt, vn = self.counts.values()
        left_out: dict[str, None] = {}
        unknown: dict[str, None] = {}
        name, material, waiting, start, own = "", "", "", 0, -1
        for number, line in enumerate(re.split(r"\r\n|\n|\r", text), 1):
            if line.endswith(("\\", " ", "\t")) and line.rstrip().endswith("\\"):  # the statement goes on
                waiting, start = waiting + line.rstrip()[:-1] + " ", start or number
                continue
            if waiting:
                line, waiting, number, start = waiting + line, "", start, 0
            words = line.split()
            if not words or words[0][0] == "#":
                continue
            key = words[0]
            if key in KINDS:
                words = _uncommented(words, line)
                self.words[key] += words[1:]
                self.counts[key].append(len(words) - 1)
                self.lines[key].append(number)
            elif key in ("f", "fo"):
                if own < 0:
                    own = self.owners.setdefault((name, material), len(self.owners))
                words = _uncommented(words, line)
                self.faces.append((" ".join(words[1:]), len(v), len(vt), len(vn), number))
                self.owner.append(own)
                sizes.append(len(words) - 1)
            elif key == "usemtl":
                material, own = line.strip()[6:].strip(), -1
            elif key == "o":
                name, own = line.strip()[1:].strip(), -1
            elif key == "mtllib":
                self.libraries.append(line.strip()[6:].strip())
            elif key in LEFT_OUT:
                left_out[LEFT_OUT[key]] = None
            elif key not in IGNORED and key.strip("\0\x1a"):
                unknown[key] = None
        self.sizes = np.array(sizes, np.int64)
        self.starts = np.concatenate([[0], np.cumsum(self.sizes)]).astype(np.int64)
        if left_out:
            note(f"{path}: not read are {listed(left_out)}")
        if unknown:
            note(f"{path}: unknown statements are not read: {listed(unknown)}")

    def indices(self) -> np.ndarray:
        """(C, 3) indices of v, vt and vn from 0, -1 for none, of all corners. Raises InputError that names the line of a face that has
        none, or points past the end. Faces that are written alike are converted together."""
        found = np.zeros((int(self.starts[-1]), 3), np.int64)
        alike: dict[str, list[int]] = {}
        for k, (text, *_) in enumerate(self.faces):
            alike.setdefault(next((form for form, (pattern, _) in FORMS.items() if pattern.fullmatch(text)), ""), []).append(k)
        for form, faces in alike.items():
            which = np.array(faces)
            place = np.repeat(self.starts[which] - np.cumsum(self.sizes[which]) + self.sizes[which], self.sizes[which])
            place += np.arange(len(place))
            if form:
                columns = FORMS[form][1]
                text = " ".join(self.faces[k][0] for k in faces)
                index = np.array(list(map(int, text.replace("/", " ").split())), np.int64).reshape(-1, len(columns))
                before = np.repeat(np.array([self.faces[k][1:4] for k in faces])[:, columns], self.sizes[which], axis=0)
                index = np.where(index < 0, index + before + 1, index)
                if (bad := (index <= 0).any(axis=1)).any():
                    self._corners(int(which[np.searchsorted(np.cumsum(self.sizes[which]), int(np.argmax(bad)), "right")]))
                found[np.ix_(place, columns)] = index
            elif len(place):
                found[place] = [corner for k in faces for corner in self._corners(k)]
        counts = [len(lines) for lines in self.lines.values()]
        if (bad := found > counts).any():
            corner, k = np.argwhere(bad)[0]
            line = self.faces[int(np.searchsorted(self.starts, corner, "right")) - 1][4]
            self._beyond(line, KINDS[k], str(found[corner, k]), counts[k])
        return found - 1

    def _corners(self, face: int) -> list[list[int]]:
        """The indices of one face's corners, from 1, 0 for none. Raises InputError, naming the line."""
        text, *counts, number = self.faces[face]
        corners = []
        for word in text.split():
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
                    self._beyond(number, KINDS[k], part, counts[k])
                corner.append(index)
            corners.append((corner + [0, 0])[:3])
        return corners

    def _beyond(self, number: int, kind: str, index: str, count: int) -> None:
        raise InputError(f"{self.path} line {number}: a face names {kind} {index:.40}, but there are {count} "
                         f"({kind} 1 to {count}); repair or drop that face")

    def numbers(self, kind: str, least: int, most: int) -> np.ndarray:
        """(n, most) of the statements `kind`, NaN where a row is shorter. Raises InputError that names the line."""
        words, sizes = self.words[kind], np.array(self.counts[kind], np.int64)
        if (sizes < least).any():
            row = int(np.argmax(sizes < least))
            raise InputError(f"{self.path} line {self.lines[kind][row]}: {kind} has {sizes[row]} numbers; {least} are needed")
        starts = np.cumsum(sizes) - sizes
        try:
            flat = np.array(list(map(float, words)), np.float64)
        except ValueError:
            flat = np.zeros(len(words))
            for line, start, size in zip(self.lines[kind], starts.tolist(), np.minimum(sizes, most).tolist()):
                flat[start:start + size] = numbers(words[start:start + size], f"{self.path} line {line}")
        out = np.full((len(sizes), most), np.nan)
        for k in range(min(most, int(sizes.max(initial=0)))):
            there = sizes > k
            out[there, k] = flat[starts[there] + k]
        return out


def _uncommented(words: list[str], line: str) -> list[str]:
    """The words of a line up to a comment, and without what DOS and C leave at a file's end."""
    if "#" not in line and "\0" not in line and "\x1a" not in line:
        return words
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
    corners = text.indices()
    if not len(positions) or not len(corners):
        return Pieces(positions, ())
    places, face = triangulated(positions, text.starts, corners[:, 0])
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
