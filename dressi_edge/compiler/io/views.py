"""Photographs with their cameras: image files and transforms JSON or glTF in; frozen, checked `Views` out.

Everything wrong with the input is named here, before a renderer is built.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from ...cache.errors import InputError
from .averaging import downsampled
from .cameras import Camera
from .decode import OWN, Masks, fitted, load_images
from .formats import Cameras, read_cameras
from .gltf_cameras import gltf_cameras
from .pictures import Mask, Pictures, as_floats
from .shots import developed
from .text import shown
from .transforms import read_transforms
from .unit import Unit


@dataclass(frozen=True, eq=False)
class Views:
    """N views. images: (N, h, w, 4) float32 in [0, 1], as stored: colour is sRGB encoded and straight (not multiplied by alpha), alpha is
    coverage and the mask; an array, or `Pictures` in files that are as good as one. cameras and names: one each. Where pictures have
    different sizes h and w are the largest of all, and each is the upper left corner of its image, of its camera's size. unit: the frame
    that the cameras are in, if it is not the input's; results are given back in the input's. Raises InputError for anything else."""

    images: np.ndarray | Pictures
    cameras: tuple[Camera, ...]
    names: tuple[str, ...]
    unit: Unit | None = None

    def __post_init__(self) -> None:
        images = self.images if isinstance(self.images, Pictures) else np.asarray(self.images)
        if images.ndim != 4 or images.shape[3] != 4 or images.dtype != np.float32:
            raise InputError(f"views images are {images.dtype} of shape {images.shape}; they must be float32 (n, h, w, 4)")
        if not len(images):
            raise InputError("views have no image; give at least one")
        if len(images) != len(self.cameras) or len(images) != len(self.names):
            raise InputError(f"views have {len(images)} images, {len(self.cameras)} cameras and {len(self.names)} names; "
                             "give one camera and one name for each image")
        if len(set(self.names)) < len(self.names):
            twice = next(name for k, name in enumerate(self.names) if name in self.names[:k])
            raise InputError(f"two views are called {shown(twice)!r}; give each a name of its own, for results are told by it")
        if not isinstance(images, Pictures):  # which are what 8 bits can say
            bad = ~((images >= 0.0) & (images <= 1.0)).reshape(len(images), -1).all(axis=1)
            if bad.any():
                raise InputError(f"view {self.names[int(np.argmax(bad))]} has values outside [0, 1] or NaN; scale or clip it")
        largest = max(c.width for c in self.cameras), max(c.height for c in self.cameras)
        for camera, name in zip(self.cameras, self.names, strict=True):
            if largest != (images.shape[2], images.shape[1]):
                raise InputError(f"view {name} has a camera of {camera.width}x{camera.height} pixels and an image of "
                                 f"{images.shape[2]}x{images.shape[1]}; resize one of them")

    def __len__(self) -> int:
        return len(self.cameras)

    @cached_property
    def masks(self) -> tuple[Mask, ...]:
        """Where the object is in each."""
        if isinstance(self.images, Pictures):
            return self.images.masks
        return tuple(Mask.of(self.picture(k)) for k in range(len(self)))

    def picture(self, view: int) -> np.ndarray:
        """The picture of a view without what is beside it, (h, w, 4) float32."""
        camera = self.cameras[view]
        return self.images[view][:camera.height, :camera.width]

    def within(self, unit: Unit) -> Views:
        """The same in another frame, given in that of these."""
        if self.unit is not None:
            outer = Unit(self.unit.origin + self.unit.scale * unit.origin, self.unit.scale * unit.scale)
            return replace(self, cameras=unit.cameras(self.cameras), unit=outer)
        return replace(self, cameras=unit.cameras(self.cameras), unit=unit)

    def linear(self) -> Views:
        """The same with linear light for colour."""
        images = self.images
        images = images.as_linear() if isinstance(images, Pictures) else np.stack([as_floats(image, True) for image in images])
        return replace(self, images=images)

    def resized(self, size: tuple[int, int] | int) -> Views:
        """The views at size (width, height), or with that longer side at most, not larger than now: images averaged over area, intrinsics
        scaled with them."""
        sizes = [fitted(c.width, c.height, size) for c in self.cameras]
        cameras = tuple(c.resized(*wh) for c, wh in zip(self.cameras, sizes))
        if isinstance(self.images, Pictures) and self.images.bits < 32 and not self.images.linear:
            return replace(self, images=Pictures(self.images.readings, sizes), cameras=cameras)
        images = np.zeros((len(self), max(h for _, h in sizes), max(w for w, _ in sizes), 4), np.float32)
        for k, (w, h) in enumerate(sizes):
            images[k, :h, :w] = downsampled(self.picture(k), (w, h))
        return replace(self, images=images, cameras=cameras)


def load_views(path: str | Path, size: tuple[int, int] | int | None = None, near: float = 0.05, far: float = 100.0,
               fits: Callable[[int, int, int], None] | None = None, told: Callable[[int, int], None] | None = None, masks: Masks = OWN,
               skip: bool = False) -> Views:
    """Views of a NeRF-style JSON file, or of a directory that has transforms_train.json or transforms.json (docs/job.md, "transforms").

    size: to average the images down to, (width, height) or the most that the longer side may have. fits: called with the number of views,
    their width and height before any picture is decoded, to refuse what will be too large. told: called with how many pictures of how many
    are read. masks: where the object is in the pictures. skip: without frames whose picture does not exist.
    """
    return Views(*developed(read_transforms(path, skip), size, near, far, fits, told, masks))


def load_photographs(path: str | Path, images: str | Path | None = None, skip: bool = False, **settings) -> Views:
    """Views by cameras of any format that is read: a COLMAP model's folder, NeRF-style JSON, cameras.npz of IDR and NeuS, Middlebury's
    *_par.txt. images: the pictures' folder, where the format does not say it. skip: without pictures that do not exist. settings: those of
    `photographs`. Raises InputError."""
    return photographs(read_cameras(path, None if images is None else Path(images), skip), **settings)


def photographs(found: Cameras, size: tuple[int, int] | int | None = None, near: float = 0.05, far: float = 100.0,
                fits: Callable[[int, int, int], None] | None = None, told: Callable[[int, int], None] | None = None, masks: Masks = OWN,
                stated: tuple[int, int] | None = None, normalize: bool | tuple[Sequence[float], float] = False) -> Views:
    """Views of cameras that were read. stated: (width, height) of the pictures that the cameras are of, where their file does not say that.
    normalize: brought into the unit ball: True, by what the file says of the object's place, else by the masks (`carve.ball_of`), else by
    the points of the file; or a ball (centre, radius). near and far are then in its radii. The others as in `load_views`. InputError."""
    shots = [replace(s, stated=stated) if stated is not None and s.stated == (None, None) else s for s in found.shots]
    views = Views(*developed(shots, size, near, far, fits, told, masks))
    if normalize is False:
        return views
    ball = found.ball if normalize is True else normalize
    if ball is None and sum(mask.box is not None and not mask.full for mask in views.masks) > 1:
        from .carve import ball_of  # which is of views
        ball = ball_of(views)
    if ball is None and found.points is not None and len(found.points):
        centre = np.median(found.points, axis=0)  # some points are far off
        ball = centre, float(np.quantile(np.linalg.norm(found.points - centre, axis=1), 0.9))
    if ball is None:
        raise InputError("nothing says where the object is, no masks and no points; give views.normalize = {center = [...], radius = ...}")
    return views.within(Unit(*ball))


def load_gltf_views(path: str | Path, source: str | Path | Sequence[str | Path], size: tuple[int, int] | int | None = None,
                    fits: Callable[[int, int, int], None] | None = None, told: Callable[[int, int], None] | None = None,
                    masks: Masks = OWN) -> Views:
    """Views of a glTF file's cameras and the pictures in a folder or a list: by name where each camera node has the name of one picture,
    in order otherwise. size, fits, told and masks as in `load_views`."""
    images, names = load_images(source, fits, size, told, masks)
    cameras, nodes = gltf_cameras(path, *images.readings[0].size)
    if len(set(nodes)) == len(nodes) and set(nodes) == set(names):
        cameras = tuple(cameras[nodes.index(name)] for name in names)
    return Views(images, tuple(camera.resized(*images.size) for camera in cameras), names)
