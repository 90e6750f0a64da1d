"""Pictures averaged over area to a smaller size, in linear light: 8-bit or float RGBA in, float RGBA out."""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...cache.errors import InputError
from .color import linear_to_srgb, srgb_to_linear

BYTE = (np.arange(256, dtype=np.float32) / np.float32(255.0)).astype(np.float64)  # what the 8 bits of a picture stand for
COVERED_LIGHT = (BYTE[:, None] * srgb_to_linear(BYTE)).reshape(-1)  # by alpha and colour, 256 * alpha + colour


def downsampled(image: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """An sRGB RGBA image (h, w, 4), of 8 or 16 bits or float in [0, 1], averaged over area down to size (width, height): float32.

    Light adds up linearly and only where there is something, so colour is averaged linear and multiplied by alpha. Of what alpha leaves
    empty nothing is worked out: it is zero. Raises InputError.
    """
    height, width = image.shape[:2]
    if not (1 <= size[0] <= width and 1 <= size[1] <= height):
        raise InputError(f"size {size[0]}x{size[1]} for images of {width}x{height}; "
                         "it must be 1x1 or more and not larger than they are")
    out = np.zeros((size[1], size[0], 4), np.float32)
    down, across = (_Part.of(image[..., 3].any(axis=1 - axis), size[1 - axis]) for axis in (0, 1))
    if down is None or across is None:
        return out
    planes = [np.ascontiguousarray(image[down.read, across.read, k]) for k in range(4)]
    if image.dtype == np.uint8:
        alpha, row = BYTE.take(planes[3]), planes[3].astype(np.uint16) << 8
        light = [COVERED_LIGHT.take(row | x) for x in planes[:3]]
    else:
        if image.dtype == np.uint16:
            planes = [x / np.float32(65535.0) for x in planes]
        alpha = planes[3].astype(np.float64)
        light = [srgb_to_linear(x.astype(np.float64)) * alpha for x in planes[:3]]
    *light, alpha = (across.averaged(down.averaged(x, 0), 1) for x in (*light, alpha))
    found = out[down.made, across.made]
    some = np.flatnonzero(alpha)
    scale, plane = np.maximum(alpha.take(some), 1e-12), np.zeros(alpha.size, np.float32)
    for k, x in enumerate(light):
        plane[some] = np.clip(linear_to_srgb(x.take(some) / scale), 0.0, 1.0)
        found[..., k] = plane.reshape(alpha.shape)
    found[..., 3] = np.clip(alpha, 0.0, 1.0)
    return out


@dataclass(frozen=True)
class _Part:
    """Of an axis of n pixels that become m: which of the m are not empty (`made`), and which of the n these are made of (`read`)."""

    n: int
    m: int
    made: slice
    read: slice

    @staticmethod
    def of(filled: np.ndarray, m: int) -> _Part | None:
        """filled: (n,) where there is anything; None where there is nothing."""
        n, at = len(filled), np.flatnonzero(filled)
        if not len(at):
            return None
        first, end = max(0, int(at[0]) * m // n - 1), min(m, (int(at[-1]) + 1) * m // n + 2)
        return _Part(n, m, slice(first, end), slice(first * n // m, min(n, (end - 1) * n // m + -(-n // m) + 2)))

    def averaged(self, x: np.ndarray, axis: int) -> np.ndarray:
        """x, what is read, along an axis: of all m entries number i is the mean of the i-th of m equal pieces, of which the pixels at the
        ends may be parts. The work is as much as is read, not that times what is made."""
        n, m, count = self.n, self.m, self.made.stop - self.made.start
        if n % m == 0:  # whole pixels, all of one weight
            k = n // m
            pieces = [x[(slice(None),) * axis + (slice(t, count * k, k),)] for t in range(k)]
            total = pieces[0].copy()
            for piece in pieces[1:]:
                total += piece
            return total if len(pieces) == 1 else np.multiply(total, m / n, out=total)
        low, high = (np.arange(m) * n / m)[self.made], ((np.arange(m) + 1) * n / m)[self.made]
        total = 0.0
        for t in range(int(np.ceil(n / m)) + 1):
            at = np.floor(low).astype(int) + t
            weight = np.clip(np.minimum(high, at + 1) - np.maximum(low, at), 0.0, None) * (m / n)
            place = np.minimum(np.minimum(at, n - 1) - self.read.start, x.shape[axis] - 1)
            total = total + np.take(x, place, axis) * weight.reshape((-1,) + (1,) * (x.ndim - 1 - axis))
        return total
