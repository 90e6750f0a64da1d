"""Pictures that files name: found where the world puts them, read in the modes that the world writes.

In: names as OBJ, MTL, PLY and glTF files have them, and image data. Out: texels (h, w, 3) float64 in [0, 1], as stored.
"""
from __future__ import annotations

import re
from pathlib import Path
from urllib.parse import unquote

import numpy as np
from PIL import Image

from ...cache.errors import InputError
from .images import opened
from .text import is_file, shown

HINT = "give a PNG or JPEG file"
SIXTEEN = ("I;16", "I;16B", "I;16L", "I;16N")


def load_texture(path: str | Path) -> np.ndarray:
    """An image file as a texture (h, w, 3) float64 in [0, 1], as stored; alpha is dropped. Raises InputError."""
    with opened(path, "texture", HINT) as image:
        return texels(image, f"texture {shown(path)}")[..., :3]


def texels(image: Image.Image, name: str) -> np.ndarray:
    """(h, w, 3), or (h, w, 4) where the image has alpha: float64 in [0, 1]. Grey of 16 bits by 65535, float as it is."""
    if image.mode in SIXTEEN or image.mode == "I" and image.format == "PNG":
        grey = np.asarray(image).astype(np.float64) / 65535.0
    elif image.mode == "F":
        grey = np.asarray(image, np.float64)
    elif image.mode == "I":
        raise InputError(f"{name} has whole numbers of 32 bits, and nothing says what white is; save it with 8 or 16 bits")
    else:
        rgba = np.asarray(image.convert("RGBA" if image.has_transparency_data else "RGB"))
        return rgba.astype(np.float64) / 255.0
    if not ((grey >= 0.0) & (grey <= 1.0)).all():
        raise InputError(f"{name} has values from {grey.min():g} to {grey.max():g}; allowed are 0 to 1; scale it")
    return np.repeat(grey[..., None], 3, axis=-1)


class Picture:
    """An image that a mesh file names, found when the file is read and decoded when first asked for. source: None where it is missing,
    which is an error only for who needs it."""

    def __init__(self, name: str, source: Path | bytes | None):
        self.name, self.source = shown(name), source
        self._texels: np.ndarray | None = None

    def texels(self) -> np.ndarray:
        """(h, w, 3) or, with alpha, (h, w, 4), float64 in [0, 1], as stored; read-only. Raises InputError."""
        if self.source is None:
            raise InputError(f"image {self.name} does not exist, nor a file of that name beside the mesh; put it there, or give a texture")
        if self._texels is None:
            with opened(self.source, "image", HINT, self.name) as image:
                self._texels = texels(image, f"image {self.name}")
            self._texels.setflags(write=False)
        return self._texels

    def __repr__(self) -> str:
        return f"Picture({self.name!r})"


def find_file(folder: Path, name: str) -> Path | None:
    """The file that another file in `folder` names, however its program wrote that: in quotes, with backslashes, with %20, as a path
    of the machine that it was made on (the file is beside), in other capitals. None where there is none."""
    bare = name.strip().strip("\"'").strip()
    spelled = []
    for text in dict.fromkeys((name.strip(), bare, unquote(bare), re.sub(r"^file:/*(?=/|[A-Za-z]:)", "", unquote(bare)))):
        slashed = re.sub(r"[\\/]+", "/", text)
        spelled += [text, slashed, slashed.rpartition("/")[2]]
    for text in dict.fromkeys(filter(None, spelled)):
        if is_file(folder / text):
            return folder / text
    wanted = {text.rpartition("/")[2].casefold() for text in spelled if text}
    try:
        beside = sorted(file for file in folder.iterdir() if file.name.casefold() in wanted and file.is_file())
    except OSError:
        return None
    return beside[0] if beside else None
