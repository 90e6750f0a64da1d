"""Which format a file or folder of cameras has: a path in; `Shot`s out, whatever tool wrote it."""
from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...cache.errors import InputError
from .colmap import model_folder, read_colmap, read_points
from .sets import read_idr, read_middlebury
from .shots import Shot
from .text import is_file, is_folder, shown
from .transforms import NAMES, read_transforms

FORMATS = "a COLMAP model's folder, a NeRF-style .json or its folder, cameras.npz of IDR and NeuS, or *_par.txt of Middlebury"


@dataclass(frozen=True, eq=False)
class Cameras:
    """Photographs, and what their file knows of where the object is: a ball (centre, radius), or points (n, 3) of all that was seen."""

    shots: list[Shot]
    ball: tuple[np.ndarray, float] | None = None
    points: np.ndarray | None = None


def read_cameras(path: str | Path, images: Path | None = None, skip: bool = False) -> Cameras:
    """The photographs of any format. images: the folder of the pictures, where the file does not say it itself. skip: without pictures
    that do not exist. Raises InputError."""
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix == ".json" or is_folder(path) and any(is_file(path / name) for name in NAMES):
        if images is not None:
            raise InputError(f"{shown(path)} names its pictures itself; drop views.images")
        return Cameras(read_transforms(path, skip))
    if is_folder(path):
        return Cameras(read_colmap(path, images, skip), points=read_points(path))
    if is_file(path) and path.name in ("cameras.bin", "images.bin", "cameras.txt", "images.txt"):
        return Cameras(read_colmap(model_folder(path.parent), images, skip), points=read_points(path.parent))
    if suffix == ".npz":
        return Cameras(*read_idr(path, images, skip))
    if suffix == ".txt":
        return Cameras(read_middlebury(path, images, skip))
    raise InputError(f"cameras {shown(path)} {'have a format that is not read' if is_file(path) else 'do not exist'}; {FORMATS} is needed")
