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
from .cameras import Camera, inverse_rigid
from .gltf_cameras import gltf_cameras
from .images import load_images
from .pictures import Mask, Pictures, as_floats
from .text import shown
from .transforms import intrinsics, read_transforms, stated_size


@dataclass(frozen=True, eq=False)
class Views:
    """N views of one size. images: (N, h, w, 4) float32 in [0, 1], as stored: colour is sRGB encoded and straight (not
    multiplied by alpha), alpha is coverage and the mask; an array, or `Pictures` in files that are as good as one. cameras and names: one
    each. Raises InputError for anything else."""

    images: np.ndarray | Pictures
    cameras: tuple[Camera, ...]
    names: tuple[str, ...]

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
        for camera, name in zip(self.cameras, self.names, strict=True):
            if (camera.width, camera.height) != (images.shape[2], images.shape[1]):
                raise InputError(f"view {name} has a camera of {camera.width}x{camera.height} pixels and an image of "
                                 f"{images.shape[2]}x{images.shape[1]}; resize one of them")

    def __len__(self) -> int:
        return len(self.cameras)

    @cached_property
    def masks(self) -> tuple[Mask, ...]:
        """Where the object is in each."""
        return self.images.masks if isinstance(self.images, Pictures) else tuple(Mask.of(image) for image in self.images)

    def linear(self) -> Views:
        """The same with linear light for colour."""
        images = self.images
        images = images.as_linear() if isinstance(images, Pictures) else np.stack([as_floats(image, True) for image in images])
        return replace(self, images=images)

    def resized(self, size: tuple[int, int]) -> Views:
        """The views at size (width, height), not larger than now: images averaged over area, intrinsics scaled with them."""
        images = self.images.resized(size) if isinstance(self.images, Pictures) else np.stack([downsampled(x, size) for x in self.images])
        return Views(images, tuple(camera.resized(*size) for camera in self.cameras), self.names)


def load_views(path: str | Path, size: tuple[int, int] | None = None, near: float = 0.05, far: float = 100.0,
               fits: Callable[[int, int, int], None] | None = None, told: Callable[[int, int], None] | None = None) -> Views:
    """Views of a NeRF-style JSON file, or of a directory that has transforms_train.json or transforms.json (docs/job.md, "transforms").

    size: (width, height) to average the images down to. fits: called with the number of views, their width and height before any
    picture is decoded, to refuse what will be too large. told: called with how many pictures of how many are read.
    """
    frames = read_transforms(path)
    files = [frame.file for frame in frames]

    def check(count: int, width: int, height: int) -> None:
        for frame in frames:
            stated_size(frame, width, height)
        if fits is not None:
            fits(count, *(size or (width, height)))

    images, names = load_images(files, check, size, told)
    width, height = images.stored
    cameras = tuple(Camera(inverse_rigid(frame.pose), *intrinsics(frame.setting, width, height, frame.where), width, height, near, far)
                    for frame in frames)
    return Views(images, cameras if size is None else tuple(camera.resized(*size) for camera in cameras), names)


def load_gltf_views(path: str | Path, source: str | Path | Sequence[str | Path], size: tuple[int, int] | None = None,
                    fits: Callable[[int, int, int], None] | None = None, told: Callable[[int, int], None] | None = None) -> Views:
    """Views of a glTF file's cameras and the pictures in a folder or a list: by name where each camera node has the name of one picture,
    in order otherwise. size, fits and told as in `load_views`."""
    images, names = load_images(source, None if fits is None else lambda n, w, h: fits(n, *(size or (w, h))), size, told)
    cameras, nodes = gltf_cameras(path, *images.stored)
    if len(set(nodes)) == len(nodes) and set(nodes) == set(names):
        cameras = tuple(cameras[nodes.index(name)] for name in names)
    return Views(images, cameras if size is None else tuple(camera.resized(*size) for camera in cameras), names)
