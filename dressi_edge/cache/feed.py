"""Pictures that a session brings to the device view by view: what a bundle says of them (docs/bundle-format.md, "Pictures"), and which
must be where for which steps.

In: meta.pictures, the record of its value, then the steps that will run. Out: slots and the views that belong there; pictures as rows of
the value's image. Nothing here knows a device.
"""
from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping

import numpy as np

from .errors import BundleError, InputError

AS_FLOAT = {8: np.arange(256, dtype=np.float32) / np.float32(255.0), 16: np.arange(65536, dtype=np.float32) / np.float32(65535.0)}
KINDS = {8: np.dtype(np.uint8), 16: np.dtype("<u2"), 32: np.dtype("<f4")}  # of a channel, by its bits
TYPES = {8: "int", 16: "ivec2", 32: "vec4"}  # of a pixel
MAX_VIEWS = 1 << 20


def differences(rows: np.ndarray) -> bytes:
    """The bytes of rows (h, w, c), each less the byte above it: what compresses well."""
    flat = np.ascontiguousarray(rows).view(np.uint8).reshape(rows.shape[0], -1)
    return np.diff(flat, axis=0, prepend=np.zeros_like(flat[:1])).tobytes()


def summed(data: bytes, shape: tuple[int, ...], kind: type) -> np.ndarray:
    """Rows of their differences."""
    flat = np.cumsum(np.frombuffer(data, np.uint8).reshape(shape[0], -1), axis=0, dtype=np.uint8)
    return flat.view(kind).reshape(shape)


class Feed:
    """name: the value, an atlas of slots. views: how many pictures there are; size: (width, height) of each; bits: 8, 16 or 32 a
    channel.
    order: the view of each step, or None where every view has a slot of its own. steps: plans that read the value, each with the state that
    counts its steps. shown: outputs of one view, each with the input that says which. held: slot -> view, as far as it is filled. source:
    what gives pictures that the bundle does not have, given: those that were set."""

    def __init__(self, meta: Mapping, values: Mapping[str, Mapping], blob: Callable[[int], bytes], blobs: int):
        try:
            self._read(meta, values, blobs)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise BundleError(f"meta.pictures is malformed ({error}); compile the bundle again") from None
        self._blob = blob
        self.held: dict[int, int] = {}
        self.given: dict[int, np.ndarray] = {}
        self.source: Callable[[int], np.ndarray] | None = None

    def _read(self, meta: Mapping, values: Mapping[str, Mapping], blobs: int) -> None:
        def texts(pairs, allowed: Mapping) -> dict[str, str]:
            if not all(type(a) is type(b) is str and b in allowed for a, b in pairs.items()):
                raise ValueError("steps or shown name what is not there")
            return dict(pairs)

        value = values[meta["value"]]
        self.name, self.views, self.bits = meta["value"], meta["views"], meta["bits"]
        self.size, self.slots, self.columns = (value["width"], value["height"]), value["count"], value["columns"]
        self.table = None if meta["table"] is None else np.frombuffer(meta["table"], "<f4")
        self.order = None if meta["order"] is None else np.frombuffer(meta["order"], "<i4")
        self.steps, self.shown = texts(meta["steps"], values), texts(meta["shown"], values)
        self.names, self.files, self.blobs = meta["names"], meta["files"], meta["blobs"]
        self.digests = meta.get("digests", [])
        if value["role"] != "input" or value["layout"] != "atlas" or TYPES.get(self.bits) != value["type"]:
            raise ValueError("its value is no atlas of 8, 16 or 32 bits that is set")
        if type(self.views) is not int or not 0 < self.views <= MAX_VIEWS or self.table is not None and len(self.table) != 1 << self.bits:
            raise ValueError("views or table")
        if self.order is None and self.slots != self.views or self.order is not None and not (
                len(self.order) and 0 <= self.order.min() <= self.order.max() < self.views):
            raise ValueError("order")
        for xs, kind, counts in ((self.names, str, (self.views,)), (self.files, str, (0, self.views)), (self.blobs, int, (0, self.views)),
                                 (self.digests, bytes, (0, self.views))):
            if type(xs) is not list or len(xs) not in counts or not all(type(x) is kind for x in xs):
                raise ValueError("names, files, blobs or digests")
        if not all(0 <= k < blobs for k in self.blobs):
            raise ValueError("blobs")

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Of all pictures as a user has them."""
        return self.views, self.size[1], self.size[0], 4

    def wanted(self, plan: str, step: int, n: int) -> dict[int, int]:
        """Slot -> view, as n steps from `step` on need them, without what is there. n is at most `slots`."""
        if self.order is None:
            pairs = ((k, k) for k in range(self.views))
        else:
            pairs = ((s % self.slots, int(self.order[s % len(self.order)])) for s in range(step, step + n))
        return {slot: view for slot, view in pairs if self.held.get(slot) != view}

    def cell(self, slot: int) -> tuple[int, int]:
        """The upper left texel of a slot."""
        return slot % self.columns * self.size[0], slot // self.columns * self.size[1]

    def check(self) -> None:
        """Raises InputError where pictures are missing."""
        if not self.blobs and self.source is None and len(self.given) < self.views:
            n, (w, h) = self.views, self.size
            raise InputError(f"{self.name} has no value yet: the bundle was compiled without its {n} pictures of {w}x{h}; give their "
                             "folder (run --views), set them, or compile with --embed")

    def rows(self, view: int) -> np.ndarray:
        """A picture as its slot holds it: (h, w, 4), uint8, uint16, float32. Raises InputError where there is none, BundleError where what
        the bundle has is damaged."""
        if view in self.given:
            return self.given[view]
        if self.source is not None:
            return self.packed(self.source(view), f"{self.name}, view {view}")
        self.check()
        kind = KINDS[self.bits]
        shape = (self.size[1], self.size[0], 4)
        size = int(np.prod(shape)) * kind.itemsize
        unpacker = zlib.decompressobj()
        try:
            data = unpacker.decompress(self._blob(self.blobs[view]), size)
        except zlib.error as error:
            raise BundleError(f"picture {view} of the bundle is damaged ({error}); compile it again") from None
        if len(data) != size or unpacker.decompress(unpacker.unconsumed_tail, 1):
            raise BundleError(f"picture {view} of the bundle has not the {size} bytes of {self.size[0]}x{self.size[1]}; compile it again")
        return summed(data, shape, kind)

    def packed(self, picture, who: str) -> np.ndarray:
        """A picture as its slot holds it, of one as it is stored in a file (uint8, uint16), or as `floats` gives it. Raises InputError."""
        picture = np.asarray(picture)
        if picture.shape != self.shape[1:]:
            raise InputError(f"{who} has shape {picture.shape}; {self.shape[1:]} is needed")
        if picture.dtype == np.uint8 and self.bits == 16:
            return picture.astype(np.uint16) * np.uint16(257)
        if picture.dtype == np.uint8 or picture.dtype == np.uint16 and self.bits >= 16:
            return picture if self.bits < 32 else self.floats(picture)
        if picture.dtype.kind not in "fiub":
            raise InputError(f"{who} has type {picture.dtype}; numbers are needed")
        with np.errstate(over="ignore"):
            picture = picture.astype(np.float32)
        if not np.isfinite(picture).all():
            raise InputError(f"{who} has {np.count_nonzero(~np.isfinite(picture))} values that are NaN or Inf; finite numbers are needed")
        if self.bits == 32:
            return picture
        if not 0.0 <= picture.min() <= picture.max() <= 1.0:
            raise InputError(f"{who} has values from {picture.min():g} to {picture.max():g}; pictures of {self.bits} bits have 0 to 1")
        out = np.rint(picture * np.float32((1 << self.bits) - 1)).astype(KINDS[self.bits])
        if self.table is not None:
            out[..., :3] = np.searchsorted((self.table[1:] + self.table[:-1]) / 2, picture[..., :3])
        return out

    def floats(self, rows: np.ndarray) -> np.ndarray:
        """float32 as shaders have it, of rows."""
        if rows.dtype.kind != "u":
            return rows
        known = AS_FLOAT[8 * rows.dtype.itemsize]
        if self.table is None:
            return known[rows]
        return np.concatenate([self.table[rows[..., :3]], known[rows[..., 3:]]], axis=-1)
