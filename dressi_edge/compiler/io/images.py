"""Pictures: files to arrays, colour encodings, averaging to another size."""
from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from ...cache.errors import InputError

IMAGE_SUFFIXES = (".png", ".webp", ".tif", ".tiff")  # those that can hold alpha


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


def load_images(source: str | Path | Sequence[str | Path]) -> tuple[np.ndarray, tuple[str, ...]]:
    """Images (n, h, w, 4) float32 as stored and their names (file names without extension), of a list of files or of every
    image in a directory, by name. All need an alpha channel and one size."""
    if isinstance(source, str | Path):
        if not Path(source).is_dir():
            raise InputError(f"image directory {source} does not exist; check the path, or give a list of files")
        files = sorted(file for file in Path(source).iterdir() if file.suffix.lower() in IMAGE_SUFFIXES)
    else:
        files = [Path(file) for file in source]
    if not files:
        raise InputError(f"no image in {source}; give at least one of {', '.join(IMAGE_SUFFIXES)}")
    images: list[np.ndarray] = []
    for file in files:
        images.append(_load_image(file))
        if images[-1].shape != images[0].shape:
            (h, w), (h0, w0) = images[-1].shape[:2], images[0].shape[:2]
            raise InputError(f"image {file} is {w}x{h}, but {files[0]} is {w0}x{h0}; all views need one size")
    return np.stack(images), tuple(file.stem for file in files)


def _load_image(path: Path) -> np.ndarray:
    if not path.is_file():
        raise InputError(f"image file {path} does not exist; check the path")
    try:
        with Image.open(path) as image:
            if not image.has_transparency_data:
                raise InputError(f"image {path} has no alpha channel (mode {image.mode}); alpha is the mask; save it as RGBA")
            return np.asarray(image.convert("RGBA"), dtype=np.float32) / np.float32(255.0)
    except (OSError, ValueError, SyntaxError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"image {path} cannot be read ({error}); save it again as an RGBA PNG") from None


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
