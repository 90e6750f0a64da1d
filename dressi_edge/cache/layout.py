"""How a user's array lies in an image: docs/conventions.md, "Tables" and "Atlas"."""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .errors import InputError

CHANNELS = {"float": 1, "vec2": 2, "vec3": 3, "vec4": 4, "int": 1, "ivec2": 2, "ivec3": 3, "ivec4": 4}
KINDS = ("unit", "table", "image", "atlas")
MAX_TABLE_ROWS = 4096


def is_int(vtype: str) -> bool:
    """Whether a type holds integers."""
    return vtype.startswith("i")


def beyond_fp32(array) -> np.ndarray:
    """True where a number, finite or not, is NaN or Inf once it is rounded to fp32, as it is on the device."""
    with np.errstate(over="ignore"):
        return ~np.isfinite(np.asarray(array).astype(np.float32))


def halved(array) -> np.ndarray:
    """float16 of numbers as the device has them: rounded to fp32, then to fp16, each to nearest even."""
    with np.errstate(over="ignore"):
        return np.asarray(array).astype(np.float32).astype(np.float16)


def table_size(count: int, narrowest: int = 4, most_rows: int = MAX_TABLE_ROWS) -> tuple[int, int]:
    """Width and height of the image that holds `count` entries: a power-of-two width (addresses are a mask and a shift), from 4 on,
    while at most 4096 rows are needed. Tall and narrow, so that entries near each other in number share a block of pixels: what one
    of them can skip the others mostly can too."""
    width = 1 if count == 1 else 2 if count == 2 else narrowest
    while -(-count // width) > most_rows:
        width *= 2
    return width, -(-count // width)


def received(array, name: str) -> np.ndarray:
    """As a NumPy array, in whose memory it stays where it lies in the processor's: of what NumPy takes, or of anything with `__dlpack__`
    (tensors of PyTorch, JAX, ...). Raises InputError."""
    try:
        alone = hasattr(array, "__dlpack__") and not hasattr(array, "__array__")
        return np.from_dlpack(array) if alone else np.asarray(array)
    except (BufferError, RuntimeError, TypeError, ValueError) as error:  # on another device, part of a gradient, rows of unequal length
        kind = f"{type(array).__module__}.{type(array).__qualname__}"
        raise InputError(f"{name} is a {kind}, which NumPy does not take: {' '.join(str(error).split())}") from None


@dataclass(frozen=True)
class Layout:
    """kind "unit" (shape () or (c,)), "table" (n, c), "image" (h, w, c), "atlas" (views, h, w, c); see docs/conventions.md."""

    kind: str
    vtype: str
    width: int = 1
    height: int = 1
    count: int = 1
    columns: int = 1

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the image."""
        if self.kind == "unit":
            return 1, 1
        if self.kind == "table":
            return table_size(self.count)
        if self.kind == "image":
            return self.width, self.height
        return self.width * self.columns, self.height * -(-self.count // self.columns)

    @property
    def shape(self) -> tuple[int, ...]:
        """The user's array shape; one-channel tables, images and units have no channel axis."""
        c = CHANNELS[self.vtype]
        body = {"unit": (), "table": (self.count,), "image": (self.height, self.width),
                "atlas": (self.count, self.height, self.width)}[self.kind]
        return body if c == 1 else (*body, c)

    def checked(self, array, name: str, half: bool = False) -> np.ndarray:
        """The user's array as numbers that the device can have: float32 where they are that already, else float64, or integers; `half`:
        rounded to fp16. Raises InputError."""
        array = received(array, name)
        if array.shape not in (self.shape, (*self.shape, 1) if CHANNELS[self.vtype] == 1 else self.shape):
            raise InputError(f"{name} has shape {array.shape}; {self.shape} is needed")
        if array.dtype.kind not in ("biu" if is_int(self.vtype) else "biuf"):
            raise InputError(f"{name} has type {array.dtype}; {'integers are' if is_int(self.vtype) else 'numbers are'} needed")
        if is_int(self.vtype):
            if array.size and not -2 ** 31 <= int(array.min()) <= int(array.max()) < 2 ** 31:
                raise InputError(f"{name} has values beyond the range of int32")
            return array
        array = array if array.dtype == np.float32 else array.astype(np.float64)
        if not np.isfinite(array).all():
            raise InputError(f"{name} has {np.count_nonzero(~np.isfinite(array))} values that are NaN or Inf; finite numbers are needed")
        if array.dtype != np.float32 and (bad := beyond_fp32(array)).any():
            at = tuple(int(i) for i in np.argwhere(bad)[0])
            raise InputError(f"{name}{list(at) if at else ''} is {array[at]:g}, beyond the range of fp32; at most 3.4e38 is allowed")
        if half:
            given, array = array, halved(array).astype(np.float64)
            if (bad := ~np.isfinite(array)).any():
                at = tuple(int(i) for i in np.argwhere(bad)[0])
                raise InputError(f"{name}{list(at) if at else ''} is {given[at]:g}, beyond the range of fp16 in which it is stored; at "
                                 "most 65504 is allowed, more with storage float")
        return array

    def to_image(self, array, name: str, half: bool = False) -> np.ndarray:
        """(height, width, channels) of the user's array, float64 or int64; `half`: rounded to fp16. Raises InputError."""
        array, (width, height) = self.checked(array, name, half), self.size
        pixels = np.empty((height, width, CHANNELS[self.vtype]), np.int64 if is_int(self.vtype) else np.float64)
        self.fill(pixels, array)
        return pixels

    def fill(self, pixels: np.ndarray, array: np.ndarray) -> None:
        """Write a `checked` array into an image (height, width, channels or more) that is one piece of memory, zeros where the array has
        nothing. One pass, for this is how every step of a loop of the caller's own begins."""
        c = CHANNELS[self.vtype]
        pixels[..., c:] = 0
        if self.kind == "table":
            flat = pixels.reshape(-1, pixels.shape[2])
            flat[:self.count, :c] = array.reshape(self.count, c)
            flat[self.count:] = 0
        elif self.kind == "atlas":
            array, last = array.reshape(self.count, self.height, self.width, c), self.count % self.columns
            cells = self._cells(pixels)[..., :c]
            for row, first in zip(cells, range(0, self.count, self.columns)):
                row[:self.count - first] = array[first:first + self.columns]
            if last:
                cells[-1, last:] = 0
        else:
            pixels[..., :c] = array.reshape(*pixels.shape[:2], c)

    def take(self, pixels: np.ndarray, out: np.ndarray) -> None:
        """Write an image (height, width, channels or more) into an array of the user's shape, in one pass."""
        c = CHANNELS[self.vtype]
        if self.kind == "table":
            out.reshape(self.count, c)[...] = pixels.reshape(-1, pixels.shape[2])[:self.count, :c]
        elif self.kind == "atlas":
            flat = out.reshape(self.count, self.height, self.width, c)
            for row, first in zip(self._cells(pixels), range(0, self.count, self.columns)):
                flat[first:first + self.columns] = row[:self.count - first, ..., :c]
        else:
            out.reshape(*pixels.shape[:2], c)[...] = pixels[..., :c]

    def from_image(self, pixels: np.ndarray) -> np.ndarray:
        """The user's array of (height, width, channels), a new one."""
        out = np.empty(self.shape, pixels.dtype)
        self.take(pixels, out)
        return out

    def _cells(self, pixels: np.ndarray) -> np.ndarray:
        """An image of an atlas as (rows, columns, height, width, channels)."""
        rows, channels = pixels.shape[0] // self.height, pixels.shape[2]
        return pixels.reshape(rows, self.height, self.columns, self.width, channels).swapaxes(1, 2)
