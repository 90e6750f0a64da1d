"""Pictures: files to arrays and back."""
from __future__ import annotations

import contextlib
import io
import math
import re
import threading
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from ...cache.errors import InputError
from .averaging import downsampled
from .color import linear_to_srgb, srgb_to_linear
from .text import is_file, shown

__all__ = ["IMAGE_SUFFIXES", "MAX_PIXELS", "downsampled", "linear_to_srgb", "names_of", "natural", "opened", "png_bytes",
           "srgb_to_linear", "to_bytes"]
IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".bmp", ".tga", ".ppm", ".gif")
MAX_PIXELS = 1 << 26  # of one picture: as float64 RGB 1.6 GB, of the 4 GB that a bundle may have 1 GB


@contextlib.contextmanager
def opened(path: str | Path | bytes, what: str, hint: str, name: str | None = None) -> Iterator[Image.Image]:
    """The picture in a file, or in its bytes, its pixels not yet read: of at most `MAX_PIXELS`. Whatever goes wrong with the file, then or
    while its pixels are read, is an InputError that calls it `what` and `name` (its path unless given) and ends with `hint`."""
    source = io.BytesIO(path) if isinstance(path, bytes) else path
    path = path if name is None else name
    if source is path and not is_file(Path(path)):
        raise InputError(f"{what} file {shown(path)} does not exist; check the path")
    try:
        with _Unasked(), Image.open(source) as image:
            if image.width * image.height > MAX_PIXELS:
                side = math.isqrt(MAX_PIXELS)
                raise InputError(f"{what} {shown(path)} is {image.width}x{image.height}; at most {MAX_PIXELS} pixels are allowed, "
                                 f"such as {side}x{side}; make it smaller")
            yield image
    except InputError:
        raise
    except Exception as error:  # noqa: BLE001  (decoders raise anything on a broken file)
        raise InputError(f"{what} {shown(path)} cannot be read ({shown(error)}); {hint}") from None


class _Unasked:
    """Without the library's own bound on pictures, whose error does not say their size, and without its warnings, of chunks that do not
    matter. Both are of the whole process: the first thread to enter changes them, the last to leave puts them back."""

    lock, inside, before = threading.Lock(), 0, (0, None)

    def __enter__(self) -> None:
        with self.lock:
            if not _Unasked.inside:
                quiet = warnings.catch_warnings()
                quiet.__enter__()
                warnings.filterwarnings("ignore", module=r"PIL\b")
                _Unasked.before, Image.MAX_IMAGE_PIXELS = (Image.MAX_IMAGE_PIXELS, quiet), None
            _Unasked.inside += 1

    def __exit__(self, *_) -> None:
        with self.lock:
            _Unasked.inside -= 1
            if not _Unasked.inside:
                Image.MAX_IMAGE_PIXELS, quiet = _Unasked.before
                quiet.__exit__(None, None, None)


def natural(name: str) -> tuple:
    """A key that sorts names as people count: 2 before 10."""
    return tuple((int(part), "") if k % 2 else (-1, part.casefold()) for k, part in enumerate(re.split("([0-9]{1,18})", name))), name


def names_of(files: Sequence[Path]) -> tuple[str, ...]:
    """A name of its own for each of the files: its name without extension, with as many of its folders as tell them apart (cameras of a
    rig number their pictures alike), with the extension where that does, and a number where a file comes twice."""
    parts = [[*file.parent.parts, file.stem] for file in files]
    for depth in range(1, max(map(len, parts)) + 1):
        names = ["/".join(part[-depth:]) for part in parts]
        if len(set(names)) == len(names):
            break
    else:
        names = [file.as_posix() for file in files]
    seen: dict[str, int] = {}
    for k, name in enumerate(names):
        seen[name] = seen.get(name, 0) + 1
        if seen[name] > 1:
            names[k] = f"{name} ({seen[name]})"
    return tuple(name.encode("utf-8", "replace").decode() for name in names)


def to_bytes(image: np.ndarray) -> np.ndarray:
    """uint8 of an image in [0, 1]: (h, w), (h, w, 1), (h, w, 3) or (h, w, 4), as PIL takes it; clipped, NaN becomes 0."""
    image = np.asarray(image)
    if image.ndim == 2:
        image = image[..., None]
    if image.ndim != 3 or image.shape[2] not in (1, 3, 4) or image.size == 0:
        raise InputError(f"image has shape {image.shape}; it must be (h, w), or (h, w, c) with 1, 3 or 4 channels")
    if image.dtype != np.uint8:
        image = np.rint(np.clip(np.nan_to_num(image.astype(np.float64), nan=0.0), 0.0, 1.0) * 255.0).astype(np.uint8)
    return image[..., 0] if image.shape[2] == 1 else image


def png_bytes(image: np.ndarray) -> bytes:
    """An image in [0, 1] as PNG of 8 bits, values as given."""
    data = io.BytesIO()
    Image.fromarray(to_bytes(image)).save(data, format="PNG")
    return data.getvalue()
