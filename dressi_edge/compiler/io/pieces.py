"""What readers of mesh files hand over: `Pieces`, the file's own vertices in the file's order and what is made of them.

`meshes.py` turns them into a `Mesh` or into `Part`s.
"""
from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from ...cache.errors import InputError, note
from .materials import Material
from .text import shown

MAX_BYTES = 1 << 31
Corners = tuple[np.ndarray, np.ndarray]  # values (n, k) float64, and (F, 3) which of them each corner has


@dataclass(frozen=True, eq=False)
class Piece:
    """Faces of one material. faces: (F, 3) indices of the file's vertices. uvs: by set, v down. colors: in [0, 1], sRGB encoded.
    normals: of any length; of length 0 where the face's own is meant. vertices: the range (first, end) that is this piece's own, if one is.
    order: (F,) where its faces stand among all of the file, if pieces take turns."""

    name: str
    faces: np.ndarray
    material: Material = field(default_factory=Material)
    uvs: dict[int, Corners] = field(default_factory=dict)
    colors: Corners | None = None
    normals: Corners | None = None
    vertices: tuple[int, int] | None = None
    order: np.ndarray | None = None

    def taken(self, keep: np.ndarray) -> Piece:
        """The piece with some of its faces only; keep: (F,) bool."""
        def some(corners: Corners | None) -> Corners | None:
            return None if corners is None else (corners[0], corners[1][keep])

        return replace(self, faces=self.faces[keep], uvs={k: some(c) for k, c in self.uvs.items()}, colors=some(self.colors),
                       normals=some(self.normals), order=None if self.order is None else self.order[keep])


@dataclass(frozen=True, eq=False)
class Pieces:
    """positions: (M, 3) float64, all vertices of the file in its order, in world space. pieces: what uses them."""

    positions: np.ndarray
    pieces: tuple[Piece, ...]


def listed(names: Iterable, most: int = 6) -> str:
    """The names, each once, and how many more there are."""
    names = list(dict.fromkeys(map(str, names)))
    return ", ".join(shown(name, 60) for name in names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def decoded(data: bytes) -> str:
    """The text of a file: UTF-8 or UTF-16 with their byte-order marks, else Latin-1, in which every byte is a letter."""
    for mark, encoding in ((b"\xef\xbb\xbf", "utf-8-sig"), (b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16")):
        if data.startswith(mark):
            return data.decode(encoding, errors="replace")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def numbers(words: list[str], where: str) -> np.ndarray:
    """float64 of words. Raises InputError that names the first which is no number."""
    try:
        return np.array(words, dtype=np.float64)
    except ValueError:
        for word in words:
            try:
                float(word)
            except ValueError:
                raise InputError(f"{where}: {word!r:.40} is no number; repair it") from None
        raise InputError(f"{where}: numbers are malformed; repair it") from None


def unit_colors(colors: np.ndarray, where: str) -> np.ndarray:
    """Colours of a text format in [0, 1]: those up to 255 are divided by it, and others clipped with a warning."""
    top = colors.max(initial=0.0)
    if 1.0 < top <= 255.0 and (colors == np.floor(colors)).all():
        colors = colors / 255.0
    if not ((colors >= 0.0) & (colors <= 1.0)).all():
        note(f"{where}: colours from {colors.min():g} to {colors.max():g}; they are clipped to 0 to 1")
    return np.clip(np.nan_to_num(colors, nan=0.0), 0.0, 1.0)
