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

import numpy as np

from ...cache.errors import InputError
from .averaging import downsampled
from .color import srgb_to_linear
from .text import shown

KEPT_BYTES = 1 << 28  # of decoded pictures that stay in memory
COVERED = 0.5  # alpha from which a pixel counts as the object
AS_FLOAT = np.arange(256, dtype=np.float32) / np.float32(255.0)  # what 8 bits stand for

Read = Callable[[bytes, Path], np.ndarray]  # the bytes of a file and its name -> (h, w, 4) uint8, straight RGBA as stored


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
        """Of a picture (h, w, 4), 8 bits or float."""
        alpha = image[..., 3]
        whole, half = (255, 128) if alpha.dtype == np.uint8 else (1.0, COVERED)
        covered = alpha >= half
        columns, rows = np.flatnonzero(covered.any(axis=0)), np.flatnonzero(covered.any(axis=1))
        box = (int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1) if len(columns) else None
        ends = all(part.all() for part in (covered[0], covered[-1], covered[:, 0], covered[:, -1]))
        return Mask(box, float(np.float32(alpha.max()) / np.float32(whole)), bool((alpha >= whole).all()), ends)


class Pictures:
    """n pictures of one size, RGBA: for NumPy a float32 array (n, h, w, 4) in [0, 1], straight colour as stored, or linear light where
    `linear`. files: one each; stored: (width, height) of all of them; size: what they are averaged down to, if anything. told: called with
    how many of how many are read. Raises InputError for the first file that is wrong."""

    dtype, ndim = np.dtype(np.float32), 4

    def __init__(self, files: Sequence[Path], read: Read, stored: tuple[int, int], size: tuple[int, int] | None = None,
                 told: Callable[[int, int], None] | None = None):
        self.files, self.stored, self.linear = tuple(files), tuple(stored), False
        self.size = self.stored if size is None else tuple(size)
        self._read, self._kept = read, {}
        if not (1 <= self.size[0] <= self.stored[0] and 1 <= self.size[1] <= self.stored[1]):
            raise InputError(f"size {self.size[0]}x{self.size[1]} for images of {self.stored[0]}x{self.stored[1]}; "
                             "it must be 1x1 or more and not larger than they are")
        found, left = [], KEPT_BYTES
        for k, (digest, mask, image) in enumerate(self._each(self._seen)):
            found.append((digest, mask))
            left -= image.nbytes
            if left >= 0:
                self._kept[k] = image
            if told is not None:
                told(k + 1, len(self.files))
        self.digests, self.masks = (tuple(x) for x in zip(*found))

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """(n, height, width, 4)."""
        return len(self.files), self.size[1], self.size[0], 4

    @property
    def bits(self) -> int:
        """Of a channel of `rows`: 8 as stored, 32 (float) where pictures are averaged."""
        return 8 if self.size == self.stored else 32

    def copy(self) -> np.ndarray:
        """All of them as an array."""
        return np.asarray(self)

    def as_linear(self) -> Pictures:
        """The same in linear light."""
        other = object.__new__(Pictures)
        other.__dict__ |= self.__dict__ | {"linear": True}
        return other

    def resized(self, size: tuple[int, int]) -> Pictures | np.ndarray:
        """The same averaged to another size, not larger than they are now. Raises InputError."""
        if self.size != self.stored or self.linear:
            return np.stack([downsampled(image, size) for image in self])
        return Pictures(self.files, self._read, self.stored, size)

    def rows(self, k: int) -> np.ndarray:
        """One picture (h, w, 4) as it is: uint8 as stored, float32 where it was averaged; sRGB encoded. Raises InputError, also where the
        file is no longer the one that it was."""
        if k in self._kept:
            return self._kept[k]
        digest, _, image = self._seen(k)
        if digest != self.digests[k]:
            raise InputError(f"image {shown(self.files[k])} has changed since it was read; leave pictures alone while they are used")
        return image

    def _seen(self, k: int) -> tuple[bytes, Mask, np.ndarray]:
        file = self.files[k]
        try:
            data = file.read_bytes()
        except OSError as error:
            raise InputError(f"image file {shown(file)} cannot be read: {error.strerror or error}; check the path") from None
        image = self._read(data, file)
        if image.shape[1::-1] != self.stored:
            raise InputError(f"image {shown(file)} is {image.shape[1]}x{image.shape[0]}, not {self.stored[0]}x{self.stored[1]}; all views "
                             "need one size")
        if self.size != self.stored:
            image = downsampled(image, self.size)
        return hashlib.sha256(data).digest(), Mask.of(image), image

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
        return len(self.files)

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
    if rows.dtype == np.uint8:
        if not linear:
            return AS_FLOAT[rows]
        return np.concatenate([srgb_to_linear(AS_FLOAT)[rows[..., :3]], AS_FLOAT[rows[..., 3:]]], axis=-1)
    return np.concatenate([srgb_to_linear(rows[..., :3]), rows[..., 3:]], axis=-1) if linear else rows
