"""Pictures in files, read when they are asked for: files in; an array of floats to whoever treats it as one, rows of bytes to whoever
wants them as they are.

Every file is read once when a `Pictures` is made, on all processors, so that whatever is wrong with it is said then, and what the rest of
the compiler asks of all pictures is known: where their masks are, and their SHA-256. What was decoded is kept while it is small, else
read again."""
from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from ...cache.errors import InputError
from .averaging import downsampled
from .color import srgb_to_linear
from .text import shown

KEPT_BYTES = 1 << 28  # of decoded pictures that stay in memory
COVERED = 0.5  # alpha from which a pixel counts as the object
AS_FLOAT, AS_FLOAT16 = (np.arange(n + 1, dtype=np.float32) / np.float32(n) for n in (255, 65535))  # what 8 and 16 bits stand for


class Reading(Protocol):
    """How one picture is had. files: whose bytes say all of it, the picture's own first; size: its (width, height)."""

    files: tuple[Path, ...]
    size: tuple[int, int]

    def __call__(self, *data: bytes) -> np.ndarray:
        """The picture (h, w, 4) in the bytes of the files: uint8 or uint16, straight RGBA as stored. Raises InputError."""


@dataclass(frozen=True)
class Mask:
    """Of one picture: left, top, right, bottom in pixels of where alpha is half or more (None where it nowhere is), the highest alpha,
    whether all of it is 1, and whether all of the border is half or more."""

    box: tuple[int, int, int, int] | None
    highest: float
    full: bool
    border: bool

    @staticmethod
    def of(image: np.ndarray) -> Mask:
        """Of a picture (h, w, 4), 8 or 16 bits or float."""
        alpha = image[..., 3]
        whole, half = {np.dtype(np.uint8): (255, 128), np.dtype(np.uint16): (65535, 32768)}.get(alpha.dtype, (1.0, COVERED))
        covered = alpha >= half
        columns, rows = np.flatnonzero(covered.any(axis=0)), np.flatnonzero(covered.any(axis=1))
        box = (int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1) if len(columns) else None
        ends = all(part.all() for part in (covered[0], covered[-1], covered[:, 0], covered[:, -1]))
        return Mask(box, float(np.float32(alpha.max()) / np.float32(whole)), bool((alpha >= whole).all()), ends)


class Pictures:
    """n pictures, RGBA: for NumPy a float32 array (n, h, w, 4) in [0, 1], straight colour as stored, or linear light where `linear`; of
    different sizes each is the upper left corner, with zeros beside it. sizes: the (width, height) that each is averaged down to, if
    anything. told: called with how many of how many are read. Raises InputError for the first file that is wrong."""

    dtype, ndim = np.dtype(np.float32), 4

    def __init__(self, readings: Sequence[Reading], sizes: Sequence[tuple[int, int]] | None = None,
                 told: Callable[[int, int], None] | None = None):
        self._begin(readings, [r.size for r in readings] if sizes is None else sizes)
        found = []
        for k, (digest, mask, image) in enumerate(self._each(self._seen)):
            found.append((digest, mask))
            self.deep |= image.dtype == np.uint16
            self._keep(k, image)
            if told is not None:
                told(k + 1, len(self))
        self.digests, self.masks = (tuple(x) for x in zip(*found))

    @classmethod
    def known(cls, readings: Sequence[Reading], sizes: Sequence[tuple[int, int]], digests: Sequence[bytes],
              deep: bool = False) -> Pictures:
        """Pictures whose SHA-256 are known, none of them read yet. deep: whether some have 16 bits. `masks` is not there."""
        self = object.__new__(cls)
        self._begin(readings, sizes)
        self.deep = deep
        self.digests = tuple(digests)
        self._other = "is not the one that the bundle was compiled with (its SHA-256 is another); put that back, or compile again"
        return self

    def _begin(self, readings: Sequence[Reading], sizes: Sequence[tuple[int, int]]) -> None:
        self.readings, self.linear, self.deep, self._kept, self._left = tuple(readings), False, False, {}, KEPT_BYTES
        self._other = "has changed since it was read; leave pictures alone while they are used"
        self.sizes = tuple(sizes)
        for (w, h), r in zip(self.sizes, self.readings, strict=True):
            if not (1 <= w <= r.size[0] and 1 <= h <= r.size[1]):
                raise InputError(f"size {w}x{h} for images of {r.size[0]}x{r.size[1]}; it must be 1x1 or more and not larger than they are")
        self.size = tuple(max(s[k] for s in self.sizes) for k in (0, 1))

    def _keep(self, k: int, image: np.ndarray) -> None:
        if self._left >= image.nbytes and k not in self._kept:
            self._kept[k], self._left = image, self._left - image.nbytes

    def check(self) -> None:
        """Raises InputError where a file is not there, or not the one that is known."""
        for _ in self._each(lambda k: self._data(k)[1]):
            pass

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """(n, height, width, 4)."""
        return len(self), self.size[1], self.size[0], 4

    @property
    def files(self) -> tuple[Path, ...]:
        """Of the pictures, one each."""
        return tuple(r.files[0] for r in self.readings)

    @property
    def bits(self) -> int:
        """Of a channel of `rows`: 8 as stored, 16 where some have so many, 32 (float) where pictures are averaged."""
        return (16 if self.deep else 8) if all(size == r.size for size, r in zip(self.sizes, self.readings)) else 32

    def copy(self) -> np.ndarray:
        """All of them as an array."""
        return np.asarray(self)

    def as_linear(self) -> Pictures:
        """The same in linear light."""
        other = object.__new__(Pictures)
        other.__dict__ |= self.__dict__ | {"linear": True}
        return other

    def rows(self, k: int) -> np.ndarray:
        """One picture (h, w, 4) as it is: uint8 or uint16 as stored, float32 where pictures were averaged; sRGB encoded. Raises InputError,
        also where the file is no longer the one that it was."""
        image, (_, height, width, _) = self._rows(k), self.shape
        if self.bits == 32:
            image = as_floats(image)
        elif self.deep and image.dtype == np.uint8:
            image = image.astype(np.uint16) * np.uint16(257)
        if image.shape[:2] == (height, width):
            return image
        whole = np.zeros((height, width, 4), image.dtype)
        whole[:image.shape[0], :image.shape[1]] = image
        return whole

    def _rows(self, k: int) -> np.ndarray:
        if k in self._kept:
            return self._kept[k]
        image = self._decoded(k, self._data(k)[0])
        self._keep(k, image)
        return image

    def _data(self, k: int) -> tuple[list[bytes], bytes]:
        """The bytes of a picture's files, and the SHA-256 of them all. Raises InputError, also where that is known and another."""
        data, digest = [], hashlib.sha256()
        for file in self.readings[k].files:
            try:
                data.append(file.read_bytes())
            except OSError as error:
                raise InputError(f"image file {shown(file)} cannot be read: {error.strerror or error}; check the path") from None
            digest.update(data[-1])
        found = digest.digest()
        if found != getattr(self, "digests", {k: found})[k]:
            names = " or ".join(str(shown(file)) for file in self.readings[k].files)
            raise InputError(f"image {names} {self._other}")
        return data, found

    def _seen(self, k: int) -> tuple[bytes, Mask, np.ndarray]:
        data, digest = self._data(k)
        image = self._decoded(k, data)
        return digest, Mask.of(image), image

    def _decoded(self, k: int, data: Sequence[bytes]) -> np.ndarray:
        reading = self.readings[k]
        image = reading(*data)
        if image.shape[1::-1] != reading.size:
            raise InputError(f"image {shown(reading.files[0])} is {image.shape[1]}x{image.shape[0]}, not {reading.size[0]}x"
                             f"{reading.size[1]} any more; leave pictures alone while they are used")
        return image if self.sizes[k] == reading.size else downsampled(image, self.sizes[k])

    def _each(self, work: Callable[[int], object]) -> Iterator:
        """What `work` gives of each picture, in order, with a few on their way."""
        workers = os.cpu_count() or 1
        with ThreadPoolExecutor(workers) as pool:
            ahead = [pool.submit(work, k) for k in range(min(2 * workers, len(self)))]
            try:
                for k in range(len(self)):
                    yield ahead.pop(0).result()
                    if k + 2 * workers < len(self):
                        ahead.append(pool.submit(work, k + 2 * workers))
            finally:
                for future in ahead:
                    future.cancel()

    # ---- as an array

    def __len__(self) -> int:
        return len(self.readings)

    def picture(self, k: int) -> np.ndarray:
        """One picture (h, w, 4), float32."""
        return as_floats(self.rows(k), self.linear)

    def __iter__(self) -> Iterator[np.ndarray]:
        return self._each(self.picture)

    def __getitem__(self, key) -> np.ndarray:
        if isinstance(key, int | np.integer):
            if not -len(self) <= key < len(self):
                raise IndexError(f"picture {key} of {len(self)}")
            return self.picture(int(key) % len(self))
        return np.asarray(self)[key]

    def __array__(self, dtype=None, copy=None) -> np.ndarray:
        out = np.empty(self.shape, np.float32 if dtype is None else dtype)
        for k, image in enumerate(self):
            out[k] = image
        return out


def as_floats(rows: np.ndarray, linear: bool = False) -> np.ndarray:
    """float32 in [0, 1] of the rows of a picture; of its colour linear light where `linear`."""
    if rows.dtype.kind == "u":
        known = AS_FLOAT if rows.dtype == np.uint8 else AS_FLOAT16
        if not linear:
            return known[rows]
        return np.concatenate([srgb_to_linear(known)[rows[..., :3]], known[rows[..., 3:]]], axis=-1)
    return np.concatenate([srgb_to_linear(rows[..., :3]), rows[..., 3:]], axis=-1) if linear else rows
