"""COLMAP models, binary or text: a folder in; `Shot`s, and the points that were found, out. The format is that of COLMAP's documentation,
"Output Format": cameras and images are read; rigs, frames and what images saw of points are not needed.
"""
from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...cache.errors import InputError
from .cameras import check_rigid, inverse_rigid
from .lens import Lens
from .sets import DOWN_FORWARD, find_images, present
from .shots import Shot
from .text import is_file, is_folder, read_bytes, shown

MODEL_FOLDERS = ("", "sparse/0", "sparse", "colmap/sparse/0", "0")  # below the folder that is named
IMAGE_FOLDERS = ("images", "image")
# By number: name, and what its parameters are; no letters: a lens that is not read.
MODELS = (("SIMPLE_PINHOLE", "f cx cy"), ("PINHOLE", "fx fy cx cy"), ("SIMPLE_RADIAL", "f cx cy k1"), ("RADIAL", "f cx cy k1 k2"),
          ("OPENCV", "fx fy cx cy k1 k2 p1 p2"), ("OPENCV_FISHEYE", "fx fy cx cy k1 k2 k3 k4"),
          ("FULL_OPENCV", "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6"), ("FOV", ""), ("SIMPLE_RADIAL_FISHEYE", "f cx cy k1"),
          ("RADIAL_FISHEYE", "f cx cy k1 k2"), ("THIN_PRISM_FISHEYE", ""), ("RAD_TAN_THIN_PRISM_FISHEYE", ""))
READ = " ".join(name for name, letters in MODELS if letters)


@dataclass(frozen=True)
class _Camera:
    """One camera of a model, with the size of its pictures."""

    lens: Lens
    width: int
    height: int


def read_colmap(path: str | Path, images: Path | None = None, skip: bool = False) -> list[Shot]:
    """The photographs of a model, in the order of their names. path: the folder of the model, or one with sparse/0 in it. images: the
    folder of the pictures; None: images/ beside or above the model. skip: without pictures that do not exist. Raises InputError."""
    folder = model_folder(Path(path))
    root = find_images(folder, IMAGE_FOLDERS) if images is None else images
    cameras = dict(_cameras(folder))
    shots = []
    for name, camera_id, rotation, translation in sorted(_images(folder), key=lambda x: x[0]):
        where = f"{shown(folder)} image {shown(name)}"
        if camera_id not in cameras:
            raise InputError(f"{where} is of camera {camera_id}, which the model does not have; export the model again")
        length = float(np.linalg.norm(rotation))
        if not 0.9 < length < 1.1:
            raise InputError(f"{where} has a quaternion of length {length:.3g}; 1 is needed")
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = _matrix(np.array(rotation) / length), translation
        pose = check_rigid(inverse_rigid(pose) @ DOWN_FORWARD, where)
        camera = cameras[camera_id]
        shots.append(Shot(root / name, pose, lambda w, h, camera=camera: camera.lens, (camera.width, camera.height), where, stored=True))
    if not shots:
        raise InputError(f"{shown(folder)} has no image; a model with registered images is needed")
    return present(shots, skip, f"{shown(folder)}: ")


def model_folder(path: Path) -> Path:
    """The folder that holds a model. Raises InputError."""
    for below in MODEL_FOLDERS:
        for suffix in (".bin", ".txt"):
            if is_file(path / below / f"cameras{suffix}") and is_file(path / below / f"images{suffix}"):
                return path / below
    if not is_folder(path):
        raise InputError(f"COLMAP model {shown(path)} is no folder; give the folder that has cameras.bin and images.bin")
    raise InputError(f"{shown(path)} has no cameras.bin and images.bin (or .txt), nor has {', '.join(MODEL_FOLDERS[1:])} in it; give the "
                     "folder of the model")


def read_points(path: str | Path) -> np.ndarray:
    """The points (n, 3) of a model; none where it has no file of them. Raises InputError."""
    folder = model_folder(Path(path))
    if is_file(folder / "points3D.bin"):
        reader = _Reader(folder / "points3D.bin")
        points = []
        for _ in range(reader.count(8 + 24 + 3 + 8 + 8)):
            points.append(reader.take("<Q3d3Bd")[1:4])
            reader.skip(8 * reader.take("<Q")[0])
        return np.array(points, float).reshape(-1, 3)
    if is_file(folder / "points3D.txt"):
        return np.array([_numbers(words[1:4], where) for words, where in _lines(folder / "points3D.txt") if len(words) > 3]).reshape(-1, 3)
    return np.zeros((0, 3))


def _matrix(q: np.ndarray) -> np.ndarray:
    """(3, 3) of a unit quaternion w, x, y, z."""
    w, x, y, z = q
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                     [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                     [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]])


def _camera(model: str | int, width, height, parameters, where: str) -> _Camera:
    named = dict(MODELS) if isinstance(model, str) else {k: entry[1] for k, entry in enumerate(MODELS)}
    name = model if isinstance(model, str) else MODELS[model][0] if 0 <= model < len(MODELS) else f"number {model}"
    if not named.get(model):
        raise InputError(f"{where} has the model {shown(name, 40)}; read are {READ}; undistort the pictures "
                         "with COLMAP's image_undistorter")
    letters = named[model].split()
    if len(parameters) != len(letters):
        raise InputError(f"{where} has {len(parameters)} parameters; model {name} has {len(letters)}: {' '.join(letters)}")
    given = dict(zip(letters, map(float, parameters)))
    fx, fy = (given.get(key, given.get("f")) for key in ("fx", "fy"))
    if not (fx > 0.0 and fy > 0.0 and width > 0 and height > 0):
        raise InputError(f"{where} has focal lengths {fx:g}, {fy:g} and size {width}x{height}; they must be above 0")
    k = tuple(given.get(f"k{n}", 0.0) for n in range(1, 7))
    while k and k[-1] == 0.0:
        k = k[:-1]
    kind = "fisheye" if "FISHEYE" in name else "opencv"
    return _Camera(Lens(fx, fy, given["cx"], given["cy"], kind, k, (given.get("p1", 0.0), given.get("p2", 0.0))), int(width), int(height))


def _cameras(folder: Path) -> Iterator[tuple[int, _Camera]]:
    """Number and camera of each camera of the model."""
    if is_file(folder / "cameras.bin"):
        reader = _Reader(folder / "cameras.bin")
        for _ in range(reader.count(24)):
            number, model, width, height = reader.take("<iiQQ")
            count = len(MODELS[model][1].split()) if 0 <= model < len(MODELS) else 0
            where = f"{shown(folder / 'cameras.bin')} camera {number}"
            yield number, _camera(model, width, height, reader.take(f"<{count}d") if count else (), where)
    else:
        for words, where in _lines(folder / "cameras.txt"):
            if len(words) < 4:
                raise InputError(f"{where} has {len(words)} words; CAMERA_ID MODEL WIDTH HEIGHT PARAMS are needed")
            number, width, height = _numbers([words[0], *words[2:4]], where)
            yield int(number), _camera(words[1], width, height, _numbers(words[4:], where), f"{where}, camera {words[0]},")


def _images(folder: Path) -> Iterator[tuple[str, int, tuple, tuple]]:
    """Name, number of the camera, quaternion and translation, world to camera, of each image of the model."""
    if is_file(folder / "cameras.bin"):  # of one kind as model_folder looked for
        reader = _Reader(folder / "images.bin")
        for _ in range(reader.count(64)):
            _, *q = reader.take("<i4d")
            t, (camera,) = reader.take("<3d"), reader.take("<i")
            name = reader.text()
            reader.skip(24 * reader.take("<Q")[0])
            yield name, camera, tuple(q), t
    else:
        lines = list(_lines(folder / "images.txt", keep_empty=True))
        for words, where in lines[::2]:  # each is followed by a line of what it saw, which may be empty
            if len(words) < 10:
                raise InputError(f"{where} has {len(words)} words; IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME are needed, and a line of "
                                 "points after each")
            numbers = _numbers(words[:9], where)
            yield " ".join(words[9:]), int(numbers[8]), tuple(numbers[1:5]), tuple(numbers[5:8])


def _lines(path: Path, keep_empty: bool = False) -> Iterator[tuple[list[str], str]]:
    """The words of each line that is no comment, and what errors call it."""
    text = read_bytes(path, "COLMAP file").decode("utf-8", "replace")
    started = False
    for k, line in enumerate(text.splitlines()):
        words = line.split()
        if words and words[0].startswith("#") or not words and not (keep_empty and started):
            continue
        started = True
        yield words, f"{shown(path)} line {k + 1}"


def _numbers(words: list[str], where: str) -> list[float]:
    try:
        numbers = [float(word) for word in words]
    except ValueError as error:
        raise InputError(f"{where}: {shown(error, 80)}; a number is needed") from None
    if not np.isfinite(numbers).all():
        raise InputError(f"{where} has a number that is not finite")
    return numbers


class _Reader:
    """A binary file of a model, read from the front. Raises InputError where it ends too early."""

    def __init__(self, path: Path):
        self.path, self.data, self.at = path, read_bytes(path, "COLMAP file", 1 << 32), 0

    def take(self, layout: str) -> tuple:
        size = struct.calcsize(layout)
        if self.at + size > len(self.data):
            raise InputError(f"{shown(self.path)} ends at byte {len(self.data)} in the middle of an entry; export the model again")
        self.at += size
        values = struct.unpack_from(layout, self.data, self.at - size)
        if not np.isfinite([x for x in values if isinstance(x, float)]).all():
            raise InputError(f"{shown(self.path)} has a number that is not finite before byte {self.at}; export the model again")
        return values

    def count(self, least: int) -> int:
        """How many entries there are, of at least so many bytes each."""
        count, = self.take("<Q")
        if count * least > len(self.data):
            raise InputError(f"{shown(self.path)} says that it has {count} entries, but it has {len(self.data)} bytes; export it again")
        return count

    def skip(self, size: int) -> None:
        if self.at + size > len(self.data):
            raise InputError(f"{shown(self.path)} ends at byte {len(self.data)} in the middle of an entry; export the model again")
        self.at += size

    def text(self) -> str:
        end = self.data.find(b"\0", self.at)
        if end < 0:
            raise InputError(f"{shown(self.path)} ends in the middle of a name; export the model again")
        name, self.at = self.data[self.at:end].decode("utf-8", "replace"), end + 1
        return name
