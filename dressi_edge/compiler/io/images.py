"""Pictures: files to arrays, colour encodings, averaging to another size."""
from __future__ import annotations

import contextlib
import io
import math
import re
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from ...cache.errors import InputError
from .text import is_file, is_folder, shown

IMAGE_SUFFIXES = (".png", ".webp", ".tif", ".tiff")  # those that can hold alpha
MAX_PIXELS = 1 << 26  # of one picture: as float64 RGB 1.6 GB, of the 4 GB that a bundle may have 1 GB


def srgb_to_linear(x: np.ndarray) -> np.ndarray:
    """Linear light of sRGB values in [0, 1] (IEC 61966-2-1)."""
    x = np.asarray(x)
    return np.where(x <= 0.04045, x / 12.92, ((np.maximum(x, 0.04045) + 0.055) / 1.055) ** 2.4).astype(_float(x))


def linear_to_srgb(x: np.ndarray) -> np.ndarray:
    """sRGB values of linear light in [0, 1] (IEC 61966-2-1)."""
    x = np.asarray(x)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 0.0031308) ** (1.0 / 2.4) - 0.055).astype(_float(x))


def _float(x: np.ndarray) -> np.dtype:
    return x.dtype if np.issubdtype(x.dtype, np.floating) else np.dtype(np.float64)


def load_images(source: str | Path | Sequence[str | Path], fits: Callable[[int, int, int], None] | None = None
                ) -> tuple[np.ndarray, tuple[str, ...]]:
    """Images (n, h, w, 4) float32 as stored and their names (`names_of`), of a list of files or of every image in a directory, 2
    before 10. All need an alpha channel and one size. fits: called with n, width and height before any pixel is read. InputError."""
    if isinstance(source, str | Path):
        if not is_folder(Path(source)):
            raise InputError(f"image directory {shown(source)} does not exist; check the path, or give a list of files")
        files = sorted((file for file in Path(source).iterdir() if file.suffix.lower() in IMAGE_SUFFIXES), key=lambda f: natural(f.name))
    else:
        files = [Path(file) for file in source]
    if not files:
        below = sum(file.suffix.lower() in IMAGE_SUFFIXES for file in Path(source).glob("*/*")) if isinstance(source, str | Path) else 0
        hint = f"its folders have {below}: give a list of files" if below else f"give at least one of {', '.join(IMAGE_SUFFIXES)}"
        raise InputError(f"no image in {shown(source)}; {hint}")
    sizes = [picture_size(file) for file in files]
    for file, (w, h) in zip(files, sizes):
        if (w, h) != sizes[0]:
            raise InputError(f"image {shown(file)} is {w}x{h}, but {shown(files[0])} is {sizes[0][0]}x{sizes[0][1]}; "
                             "all views need one size")
    if fits is not None:
        fits(len(files), *sizes[0])
    images = np.empty((len(files), sizes[0][1], sizes[0][0], 4), np.float32)
    for k, file in enumerate(files):
        with opened(file, "image", "save it again as an RGBA PNG") as image:
            if not image.has_transparency_data:
                raise InputError(f"image {shown(file)} has no alpha channel (mode {image.mode}); alpha is the mask; save it as RGBA")
            images[k] = np.asarray(image.convert("RGBA"))
    images /= np.float32(255.0)
    return images, names_of(files)


def picture_size(path: str | Path) -> tuple[int, int]:
    """(width, height) of an image file by its header. Raises InputError."""
    with opened(path, "image", "save it again as an RGBA PNG") as image:
        return image.size


@contextlib.contextmanager
def opened(path: str | Path | bytes, what: str, hint: str, name: str | None = None) -> Iterator[Image.Image]:
    """The picture in a file, or in its bytes, its pixels not yet read: of at most `MAX_PIXELS`. Whatever goes wrong with the file, then or
    while its pixels are read, is an InputError that calls it `what` and `name` (its path unless given) and ends with `hint`."""
    source = io.BytesIO(path) if isinstance(path, bytes) else path
    path = path if name is None else name
    if source is path and not is_file(Path(path)):
        raise InputError(f"{what} file {shown(path)} does not exist; check the path")
    try:
        with _any_size(), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of the library, about chunks that do not matter
            with Image.open(source) as image:
                if image.width * image.height > MAX_PIXELS:
                    side = math.isqrt(MAX_PIXELS)
                    raise InputError(f"{what} {shown(path)} is {image.width}x{image.height}; at most {MAX_PIXELS} pixels are allowed, "
                                     f"such as {side}x{side}; make it smaller")
                yield image
    except InputError:
        raise
    except Exception as error:  # noqa: BLE001  (decoders raise anything on a broken file)
        raise InputError(f"{what} {shown(path)} cannot be read ({shown(error)}); {hint}") from None


@contextlib.contextmanager
def _any_size() -> Iterator[None]:
    """Without the library's own bound on pictures, whose error does not say their size."""
    before, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, None
    try:
        yield
    finally:
        Image.MAX_IMAGE_PIXELS = before


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


def downsampled(image: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """An sRGB RGBA image (h, w, 4) averaged over area down to size (width, height).

    Light adds up linearly and only where there is something, so colour is averaged linear and multiplied by alpha.
    """
    height, width = image.shape[:2]
    if not (1 <= size[0] <= width and 1 <= size[1] <= height):
        raise InputError(f"size {size[0]}x{size[1]} for images of {width}x{height}; "
                         "it must be 1x1 or more and not larger than they are")
    alpha = image[..., 3:].astype(np.float64)
    light = np.concatenate([srgb_to_linear(image[..., :3].astype(np.float64)) * alpha, alpha], axis=-1)
    light = np.einsum("yh,hwc->ywc", _area_weights(height, size[1]), light, optimize=True)
    light = np.einsum("xw,ywc->yxc", _area_weights(width, size[0]), light, optimize=True)
    colour = light[..., :3] / np.maximum(light[..., 3:], 1e-12)
    return np.clip(np.concatenate([linear_to_srgb(colour), light[..., 3:]], axis=-1), 0.0, 1.0).astype(np.float32)


def _area_weights(n: int, m: int) -> np.ndarray:
    """(m, n): row i is how much of each of n pixels lies in the i-th of m equal pieces; rows add to 1."""
    low, high = np.arange(m)[:, None] * n / m, (np.arange(m)[:, None] + 1) * n / m
    pixel = np.arange(n)[None, :]
    return np.clip(np.minimum(high, pixel + 1) - np.maximum(low, pixel), 0.0, None) * m / n


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
