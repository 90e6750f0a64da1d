"""Lenses that bend straight lines, and pictures as a pinhole in their place would have taken them: a lens and a picture in; a picture out.

With (x, y) = (x_cam, -y_cam) / w, to the right and down, a lens shows a point at column fx x' + skew y' + cx, row fy y' + cy:

opencv   r2 = x^2 + y^2, c = (1 + k1 r2 + k2 r2^2 + k3 r2^3) / (1 + k4 r2 + k5 r2^2 + k6 r2^3),
         x' = c x + 2 p1 x y + p2 (r2 + 2 x^2), y' = c y + p1 (r2 + 2 y^2) + 2 p2 x y          (OpenCV, "Camera calibration")
fisheye  t = atan r, (x', y') = (x, y) t (1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8) / r           (OpenCV, "Fisheye camera model")
"""
from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from ...cache.errors import InputError

MODELS = ("opencv", "fisheye")
SAMPLES = 4096  # of the radius, to find where a lens turns back on itself
BLOCK = 1 << 13  # pixels at once, which stay in a cache of the processor


@dataclass(frozen=True)
class Lens:
    """fx, fy, cx, cy, skew: pixels. k: k1, k2, ..., up to six (opencv) or four (fisheye); p: p1, p2, of opencv. Raises InputError."""

    fx: float
    fy: float
    cx: float
    cy: float
    model: str = "opencv"
    k: tuple[float, ...] = ()
    p: tuple[float, float] = (0.0, 0.0)
    skew: float = 0.0

    def __post_init__(self) -> None:
        if self.model not in MODELS or len(self.k) > (4 if self.model == "fisheye" else 6):
            raise InputError(f"lens {self.model!r:.40} with {len(self.k)} coefficients; opencv has up to 6, fisheye up to 4")
        if not np.isfinite([self.fx, self.fy, self.cx, self.cy, self.skew, *self.k, *self.p]).all():
            raise InputError(f"a lens has numbers that are not finite: {self.described()}")

    @property
    def straight(self) -> bool:
        """Whether it is a pinhole already."""
        return self.model == "opencv" and not any((*self.k, *self.p, self.skew))

    def scaled(self, across: float, down: float) -> Lens:
        """The same for a picture in other pixels: so many times as many across and down."""
        if across == down == 1.0:
            return self
        return replace(self, fx=self.fx * across, fy=self.fy * down, cx=self.cx * across, cy=self.cy * down, skew=self.skew * across)

    def described(self) -> str:
        """Its coefficients that are not 0, in words."""
        named = [*((f"k{n + 1}", x) for n, x in enumerate(self.k)), ("p1", self.p[0]), ("p2", self.p[1]), ("skew", self.skew)]
        return f"{self.model}{' ' if any(x for _, x in named) else ''}" + ", ".join(f"{name} {x:.4g}" for name, x in named if x)

    def bent(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(x', y') of (x, y)."""
        r2 = x * x + y * y
        c = self._stretch(np.sqrt(r2))
        p1, p2 = self.p
        return (c * x + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x), c * y + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y)

    def _stretch(self, r: np.ndarray) -> np.ndarray:
        """What (x, y) at distance r are multiplied by."""
        k = (*self.k, *(0.0,) * 6)
        if self.model == "fisheye":
            t = np.arctan(r)
            t2 = t * t
            return np.where(r > 1e-9, t / np.maximum(r, 1e-9), 1.0) * (1.0 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))))
        r2 = r * r
        below = 1.0 + r2 * (k[3] + r2 * (k[4] + r2 * k[5]))
        return (1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[2]))) / np.where(below > 1e-9, below, np.nan)

    def reach(self, most: float) -> float:
        """Up to which r the picture's radius r' grows with r, at most `most`: beyond, the formula shows again what it has shown."""
        r = np.linspace(0.0, most, SAMPLES)
        grows = np.diff(r * self._stretch(r)) > 0.0
        return most if grows.all() else float(r[int(np.argmin(grows))])


@lru_cache(maxsize=4)  # all pictures of a set often have one lens
def _places(lens: Lens, width: int, height: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """For each pixel of the pinhole's picture, flat: column and row in the lens's, from the first pixel's centre, and whether they are in
    it."""
    with np.errstate(all="ignore"):  # of coefficients that bend beyond all numbers: nothing is inside then
        v, u = np.mgrid[:height, :width] + 0.5
        x, y = (u - lens.cx) / lens.fx, (v - lens.cy) / lens.fy
        r = np.hypot(x, y)
        bx, by = lens.bent(x, y)
        column, row = lens.fx * bx + lens.skew * by + lens.cx - 0.5, lens.fy * by + lens.cy - 0.5
        inside = (r <= lens.reach(float(r.max()))) & (column >= -0.5) & (column <= width - 0.5) & (row >= -0.5) & (row <= height - 0.5)
    return (np.where(inside, column, 0.0).astype(np.float32).ravel(), np.where(inside, row, 0.0).astype(np.float32).ravel(), inside.ravel())


def beyond(lens: Lens, width: int, height: int) -> float:
    """What part of the pinhole's picture lies beyond what the lens saw, on a grid of 64 x 64."""
    coarse = lens.scaled(64 / width, 64 / height)
    return float(1.0 - _places(coarse, 64, 64)[2].mean())


def straightened(picture: np.ndarray, lens: Lens) -> np.ndarray:
    """The picture (h, w, 4), uint8 or uint16 with straight colour, as a pinhole with the lens's fx, fy, cx, cy would have taken it at the
    same size, bilinear; alpha is 0 beyond what the lens saw."""
    height, width = picture.shape[:2]
    column, row, inside = _places(lens, width, height)
    flat, result = picture.reshape(-1, 4).astype(np.float32), np.empty((width * height, 4), picture.dtype)
    flat[:, :3] *= flat[:, 3:]  # what is no object has no colour to give
    for start in range(0, len(flat), BLOCK):
        part = slice(start, start + BLOCK)
        x, y = np.clip(column[part], 0.0, width - 1.0), np.clip(row[part], 0.0, height - 1.0)
        left, top = x.astype(np.int64), y.astype(np.int64)
        fx, fy = (x - left)[:, None], (y - top)[:, None]
        right, above, under = np.minimum(left + 1, width - 1), top * width, np.minimum(top + 1, height - 1) * width
        mean = ((flat.take(above + left, axis=0) * (1 - fx) + flat.take(above + right, axis=0) * fx) * (1 - fy)
                + (flat.take(under + left, axis=0) * (1 - fx) + flat.take(under + right, axis=0) * fx) * fy)
        mean[:, :3] /= np.maximum(mean[:, 3:], 1e-6)
        mean[~inside[part]] = 0.0
        result[part] = np.rint(np.clip(mean, 0.0, np.iinfo(picture.dtype).max, out=mean), out=mean)
    return result.reshape(picture.shape)
