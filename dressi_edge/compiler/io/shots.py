"""Photographs as every format of cameras gives them: files with poses and lenses in; pictures of pinholes, and cameras, out.

A format's reader makes `Shot`s; `developed` does the rest for all of them, picture by picture: decode, mask, straighten, average down.
"""
from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...cache.errors import InputError, note
from .cameras import Camera, inverse_rigid
from .decode import OWN, Header, Masks, Photograph, fitted, header
from .images import names_of
from .lens import Lens, beyond
from .pictures import Pictures
from .text import shown

LOOKED = 16  # lenses whose border a note is about


@dataclass(frozen=True, eq=False)
class Shot:
    """One photograph. pose: camera to world (4, 4), rigid, of a camera as docs/conventions.md has them. lens: gives it for the picture's
    width and height. stated: the (width, height) that the cameras' file says of the picture, each a number or None. where: what errors
    call it. mask: its own mask's file. premultiplied: whether its colour is multiplied by alpha. stored: whether cameras were found for
    pictures as stored, whatever EXIF says."""

    file: Path
    pose: np.ndarray
    lens: Callable[[int, int], Lens]
    stated: tuple[float | None, float | None]
    where: str
    mask: Path | None = None
    premultiplied: bool = False
    stored: bool = False

    def found(self, of: Header) -> Found:
        """How the picture of that header is meant: turned as EXIF says or as it is stored, as the stated size tells where it does; in other
        pixels than stated where it has the same shape. Raises InputError where it fits in no way."""
        ways = [(False, of.size), (True, of.upright)] if of.turned else [(False, of.size)]
        for scaled in (False, True):
            fitting = [way for way in ways if self._fits(way[1], scaled)]
            if fitting:
                upright, size = fitting[0 if self.stored else -1]
                return Found(upright, size, self.lens(*(self.stated if scaled else size)).scaled(
                    *((n / s for n, s in zip(size, self.stated)) if scaled else (1.0, 1.0))), scaled)
        w, h = (s if s is not None else n for s, n in zip(self.stated, of.upright))
        raise InputError(f"{self.where} states {w:g}x{h:g} pixels, but {shown(self.file)} has {of.upright[0]}x{of.upright[1]}; "
                         "correct w and h, with the focal lengths, or the image")

    def _fits(self, size: tuple[int, int], scaled: bool) -> bool:
        if not scaled:
            return all(s is None or s == n for s, n in zip(self.stated, size))
        if None in self.stated or min(self.stated) < 1:
            return False
        ratio = max(n / s for n, s in zip(size, self.stated))  # the shape is the same but for a pixel that rounding took
        return all(abs(n - ratio * s) < 1.0 for n, s in zip(size, self.stated))


@dataclass(frozen=True)
class Found:
    """A picture as it is meant. size: (width, height) of it, turned as EXIF says if upright. lens: in its pixels. scaled: whether its
    cameras are stated for another size."""

    upright: bool
    size: tuple[int, int]
    lens: Lens
    scaled: bool


def developed(shots: Sequence[Shot], size: tuple[int, int] | int | None = None, near: float = 0.05, far: float = 100.0,
              fits: Callable[[int, int, int], None] | None = None, told: Callable[[int, int], None] | None = None, masks: Masks = OWN
              ) -> tuple[Pictures, tuple[Camera, ...], tuple[str, ...]]:
    """Pictures of pinholes, their cameras and names. size: what to average down to (`fitted`). fits: called with n, width and height before
    any picture is decoded, to refuse what will be too large. told: called with how many of how many are read. Raises InputError."""
    of_masks = masks.of([s.file for s in shots], [s.mask for s in shots])
    found = [s.found(header(s.file)) for s in shots]
    sizes = [fitted(*f.size, size) for f in found]
    cameras = tuple(Camera(inverse_rigid(s.pose), f.lens.fx, f.lens.fy, f.lens.cx, f.lens.cy, *f.size, near, far).resized(*small)
                    for s, f, small in zip(shots, found, sizes))
    if fits is not None:
        fits(len(shots), *(max(s[k] for s in sizes) for k in (0, 1)))
    readings = [Photograph(s.file, f.size, replace(masks, premultiplied=masks.premultiplied or s.premultiplied), mask, f.upright, f.lens)
                for s, f, mask in zip(shots, found, of_masks)]
    pictures = Pictures(readings, sizes, told)
    _tell(shots, found)
    return pictures, cameras, names_of([s.file for s in shots])


def _tell(shots: Sequence[Shot], found: Sequence[Found]) -> None:
    """What was done to pictures."""
    n, bent = len(shots), [f for f in found if not f.lens.straight]
    if turned := sum(f.upright for f in found):
        note(f"{turned} of {n} pictures are turned as their EXIF orientation says")
    if scaled := [(s, f) for s, f in zip(shots, found) if f.scaled]:
        (s, f), w = scaled[0], scaled[0][0].stated[0]
        note(f"{len(scaled)} of {n} pictures are not of the stated size, but of its shape, so focal lengths and principal points are "
             f"scaled ({shown(s.file.name, 60)}: {w:g} pixels across are stated, it has {f.size[0]})")
    if bent:
        lenses = list(dict.fromkeys(f.lens for f in bent))
        worst = max(beyond(f.lens, *f.size) for f in bent[::-(-len(bent) // LOOKED)])
        border = f"; up to {worst:.1%} of a picture lies beyond what its lens saw, and counts as no object" if worst > 0.005 else ""
        note(f"{len(bent)} of {n} pictures are undistorted to pinholes of the same focal lengths and size ({lenses[0].described()}"
             f"{', ...' if len(lenses) > 1 else ''}){border}")
