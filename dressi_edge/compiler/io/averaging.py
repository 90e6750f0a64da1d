"""Pictures averaged over area to a smaller size, in linear light: 8-bit or float RGBA in, float RGBA out."""
from __future__ import annotations

import numpy as np

from ...cache.errors import InputError
from .color import linear_to_srgb, srgb_to_linear

BYTE = (np.arange(256, dtype=np.float32) / np.float32(255.0)).astype(np.float64)  # what the 8 bits of a picture stand for
BYTE_LIGHT = srgb_to_linear(BYTE)


def downsampled(image: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """An sRGB RGBA image (h, w, 4), of 8 bits or float in [0, 1], averaged over area down to size (width, height): float32.

    Light adds up linearly and only where there is something, so colour is averaged linear and multiplied by alpha. Raises InputError.
    """
    height, width = image.shape[:2]
    if not (1 <= size[0] <= width and 1 <= size[1] <= height):
        raise InputError(f"size {size[0]}x{size[1]} for images of {width}x{height}; "
                         "it must be 1x1 or more and not larger than they are")
    planes = [np.ascontiguousarray(image[..., k]) for k in range(4)]
    alpha = BYTE[planes[3]] if image.dtype == np.uint8 else planes[3].astype(np.float64)
    light = [BYTE_LIGHT[x] if image.dtype == np.uint8 else srgb_to_linear(x.astype(np.float64)) for x in planes[:3]]
    *light, alpha = (_averaged(_averaged(x, 0, size[1]), 1, size[0]) for x in (*(x * alpha for x in light), alpha))
    scale, out = np.maximum(alpha, 1e-12), np.empty((*alpha.shape, 4), np.float32)
    for k, x in enumerate((*(linear_to_srgb(x / scale) for x in light), alpha)):
        np.clip(x, 0.0, 1.0, out=x)
        out[..., k] = x
    return out


def _averaged(x: np.ndarray, axis: int, m: int) -> np.ndarray:
    """x with its n entries along an axis averaged to m: entry i is the mean of the i-th of m equal pieces, of which the pixels at the ends
    may be parts. The work is n entries, not n times m."""
    n = x.shape[axis]
    if n % m == 0:  # whole pixels, all of one weight
        pieces = [x[(slice(None),) * axis + (slice(t, None, n // m),)] for t in range(n // m)]
        total = pieces[0].copy()
        for piece in pieces[1:]:
            total += piece
        return total if len(pieces) == 1 else np.multiply(total, m / n, out=total)
    low, high = np.arange(m) * n / m, (np.arange(m) + 1) * n / m
    total = 0.0
    for t in range(int(np.ceil(n / m)) + 1):
        at = np.floor(low).astype(int) + t
        weight = np.clip(np.minimum(high, at + 1) - np.maximum(low, at), 0.0, None) * (m / n)
        total = total + np.take(x, np.minimum(at, n - 1), axis) * weight.reshape((-1,) + (1,) * (x.ndim - 1 - axis))
    return total
