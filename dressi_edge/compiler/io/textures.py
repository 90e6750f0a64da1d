"""Pictures that files name: found where the world puts them, read in the modes that the world writes.

In: names as OBJ, MTL, PLY and glTF files have them, and image data. Out: texels (h, w, 3) float64 in [0, 1], as stored.
"""
from __future__ import annotations

import io
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import unquote

import numpy as np
from PIL import Image

from ...cache.errors import InputError

MAX_SIDE = 16384
MAX_TEXELS = 1 << 26  # 8192 x 8192: 1.6 GB in float64
SIXTEEN = ("I;16", "I;16B", "I;16L", "I;16N")


@contextmanager
def opened(source: Path | bytes, name: str) -> Iterator[Image.Image]:
    """The image of a file or of its bytes, not decoded yet. name: "image a.png", for messages. Raises InputError: unreadable, or larger
    than what is allowed."""
    limit, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, None  # the size is checked below, in our words
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of Pillow, about metadata
            try:
                image = Image.open(io.BytesIO(source) if isinstance(source, bytes) else source)
            except Exception as error:  # readers raise anything on a broken file
                raise _unreadable(name, error) from None
            with image:
                width, height = image.size
                if max(width, height) > MAX_SIDE or width * height > MAX_TEXELS:
                    raise InputError(f"{name} is {width}x{height}, {width * height / 1e6:.1f} million texels; at most {MAX_SIDE} a "
                                     f"side and {MAX_TEXELS / 1e6:.1f} million are allowed (8192x8192); scale it down")
                try:
                    yield image
                except InputError:
                    raise
                except Exception as error:
                    raise _unreadable(name, error) from None
    finally:
        Image.MAX_IMAGE_PIXELS = limit


def _unreadable(name: str, error: Exception) -> InputError:
    if isinstance(error, FileNotFoundError):
        return InputError(f"{name} cannot be read: there is no such file; check the path")
    text = str(error) or type(error).__name__
    text = "it is no image that is known" if "cannot identify" in text else text
    return InputError(f"{name} cannot be read ({text:.120}); give a PNG or JPEG file")


def load_texture(path: str | Path) -> np.ndarray:
    """An image file as a texture (h, w, 3) float64 in [0, 1], as stored; alpha is dropped. Raises InputError."""
    with opened(Path(path), f"texture {path}") as image:
        return texels(image, f"texture {path}")[..., :3]


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
        self.name, self.source = name, source
        self._texels: np.ndarray | None = None

    def texels(self) -> np.ndarray:
        """(h, w, 3) or, with alpha, (h, w, 4), float64 in [0, 1], as stored; read-only. Raises InputError."""
        if self.source is None:
            raise InputError(f"image {self.name} does not exist, nor a file of that name beside the mesh; put it there, or give a texture")
        if self._texels is None:
            with opened(self.source, f"image {self.name}") as image:
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
        try:
            if (folder / text).is_file():
                return folder / text
        except (OSError, ValueError):  # a name that no file can have
            continue
    wanted = {text.rpartition("/")[2].casefold() for text in spelled if text}
    try:
        beside = sorted(file for file in folder.iterdir() if file.name.casefold() in wanted and file.is_file())
    except OSError:
        return None
    return beside[0] if beside else None
