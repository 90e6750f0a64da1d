"""Photographs with their cameras: image files and transforms JSON or glTF in; frozen, checked `Views` out.

Everything wrong with the input is named here, before a renderer is built.
"""

from __future__ import annotations

import json
import math
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...cache.errors import InputError
from .cameras import Camera, check_rigid, focal, inverse_rigid, rotation_matrix
from .images import IMAGE_SUFFIXES, downsampled, load_images

DISTORTION = ("k1", "k2", "k3", "k4", "p1", "p2")


@dataclass(frozen=True, eq=False)
class Views:
    """N views of one size. images: (N, h, w, 4) float32 in [0, 1], as stored: colour is sRGB encoded and straight (not
    multiplied by alpha), alpha is coverage and the mask. cameras and names: one each. Raises InputError for anything else."""

    images: np.ndarray
    cameras: tuple[Camera, ...]
    names: tuple[str, ...]

    def __post_init__(self) -> None:
        images = np.asarray(self.images)
        if images.ndim != 4 or images.shape[3] != 4 or images.dtype != np.float32:
            raise InputError(f"views images are {images.dtype} of shape {images.shape}; they must be float32 (n, h, w, 4)")
        if not len(images):
            raise InputError("views have no image; give at least one")
        if len(images) != len(self.cameras) or len(images) != len(self.names):
            raise InputError(f"views have {len(images)} images, {len(self.cameras)} cameras and {len(self.names)} names; "
                             "give one camera and one name for each image")
        bad = ~((images >= 0.0) & (images <= 1.0)).reshape(len(images), -1).all(axis=1)
        if bad.any():
            raise InputError(f"view {self.names[int(np.argmax(bad))]} has values outside [0, 1] or NaN; scale or clip it")
        for camera, name in zip(self.cameras, self.names, strict=True):
            if (camera.width, camera.height) != (images.shape[2], images.shape[1]):
                raise InputError(f"view {name} has a camera of {camera.width}x{camera.height} pixels and an image of "
                                 f"{images.shape[2]}x{images.shape[1]}; resize one of them")

    def __len__(self) -> int:
        return len(self.cameras)

    def resized(self, size: tuple[int, int]) -> Views:
        """The views at size (width, height), not larger than now: images averaged over area, intrinsics scaled with them."""
        images = np.stack([downsampled(image, size) for image in self.images])
        return Views(images, tuple(camera.resized(*size) for camera in self.cameras), self.names)


def load_views(path: str | Path, size: tuple[int, int] | None = None, near: float = 0.05, far: float = 100.0) -> Views:
    """Views of a NeRF-style JSON file, or of a directory that has transforms_train.json or transforms.json.

    Understood at the top and in each frame: camera_angle_x, camera_angle_y (radians), fl_x, fl_y, cx, cy, w, h (pixels).
    frames[].file_path is relative to the JSON, with or without its extension; frames[].transform_matrix is camera to world.
    size: (width, height) to average the images down to.
    """
    path = _transforms_file(Path(path))
    document = _json(path, path.read_bytes())
    frames = document.get("frames") if isinstance(document, dict) else None
    if not isinstance(frames, list) or not frames:
        raise InputError(f"{path} has no frames; it needs \"frames\": [{{\"file_path\": ..., \"transform_matrix\": ...}}, ...]")
    files, poses = [], []
    for i, frame in enumerate(frames):
        where = f"{path} frame {i}"
        if not isinstance(frame, dict) or not isinstance(frame.get("file_path"), str) or "transform_matrix" not in frame:
            raise InputError(f"{where} needs a file_path and a transform_matrix")
        poses.append(check_rigid(frame["transform_matrix"], f"{where} ({frame['file_path']}) transform_matrix"))
        files.append(_image_file(path.parent / frame["file_path"], where))
    settings = [{**document, **frame} for frame in frames]
    for i, setting in enumerate(settings):
        _intrinsics(setting, 1, 1, f"{path} frame {i}")  # names a bad number before any image is read
    images, names = load_images(files)
    height, width = images.shape[1:3]
    cameras = []
    for i, (setting, pose) in enumerate(zip(settings, poses, strict=True)):
        found = (setting.get("w", width), setting.get("h", height))
        if found != (width, height):
            raise InputError(f"{path} frame {i} states {found[0]}x{found[1]} pixels, but {files[i]} has {width}x{height}; "
                             "correct w and h, with the focal lengths, or the image")
        lens = _intrinsics(setting, width, height, f"{path} frame {i}")
        cameras.append(Camera(inverse_rigid(pose), *lens, width, height, near, far))
    views = Views(images, tuple(cameras), names)
    return views if size is None else views.resized(size)


def _transforms_file(path: Path) -> Path:
    if path.is_dir():
        for name in ("transforms_train.json", "transforms.json"):
            if (path / name).is_file():
                return path / name
        raise InputError(f"{path} has no transforms_train.json or transforms.json; give the path of the JSON file")
    if not path.is_file():
        raise InputError(f"views file {path} does not exist; check the path")
    return path


def _json(path: Path, data: bytes) -> dict:
    try:
        return json.loads(data.decode("utf-8"))
    except json.JSONDecodeError as error:
        raise InputError(f"{path} line {error.lineno} column {error.colno}: malformed JSON ({error.msg}); repair it") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is not UTF-8 text ({error.reason} at byte {error.start}); give a JSON file") from None


def _image_file(path: Path, where: str) -> Path:
    for candidate in (path, *(path.with_name(path.name + suffix) for suffix in IMAGE_SUFFIXES)):
        if candidate.is_file():
            return candidate
    raise InputError(f"{where}: image file {path} does not exist, nor with {', '.join(IMAGE_SUFFIXES)}; check file_path")


def _intrinsics(setting: dict, width: int, height: int, where: str) -> tuple[float, float, float, float]:
    """fx, fy, cx, cy in pixels; each value of the frame wins over that of the file, and pixels over angles."""
    def number(key: str) -> float | None:
        value = setting.get(key)
        if value is not None and (not isinstance(value, int | float) or isinstance(value, bool) or not math.isfinite(value)):
            raise InputError(f"{where}: {key} is {value!r}; it must be a finite number")
        return value

    for key in DISTORTION:
        if number(key):
            raise InputError(f"{where}: lens distortion {key} is {number(key)}; only 0 is allowed; undistort the images")
    lengths = []
    for axis, pixels in (("x", width), ("y", height)):
        length, angle = number(f"fl_{axis}"), number(f"camera_angle_{axis}")
        if length is not None and length <= 0.0:
            raise InputError(f"{where}: fl_{axis} is {length}; it must be above 0, in pixels")
        if length is None and angle is not None and not 0.0 < angle < math.pi:
            raise InputError(f"{where}: camera_angle_{axis} is {angle}; it must be between 0 and pi, in radians")
        lengths.append(length if length is not None or angle is None else focal(math.degrees(angle), pixels))
    if lengths[0] is None:
        raise InputError(f"{where} has neither camera_angle_x nor fl_x; give one of them, there or at the top")
    cx, cy = number("cx"), number("cy")
    return (lengths[0], lengths[0] if lengths[1] is None else lengths[1],
            width / 2.0 if cx is None else cx, height / 2.0 if cy is None else cy)


def load_gltf_cameras(path: str | Path, width: int, height: int) -> tuple[Camera, ...]:
    """Perspective cameras of a .gltf or .glb file for width x height images, in order of the scene's nodes.

    Pixels are square and yfov spans the height. Scale above a camera is ignored, as glTF says. A missing zfar is 1000 znear.
    """
    path = Path(path)
    document = _gltf(path)
    nodes, cameras = document.get("nodes", []), []
    try:
        roots = set(range(len(nodes))) - {child for node in nodes for child in node.get("children", [])}
        if document.get("scenes"):
            roots = document["scenes"][document.get("scene", 0)].get("nodes", [])
        stack = [(root, np.eye(4)) for root in reversed(sorted(roots))]
        seen: set[int] = set()
        while stack:
            index, parent = stack.pop()
            if index in seen:
                raise InputError(f"{path} node {index} is reached twice; glTF nodes must form a tree")
            seen.add(index)
            node = nodes[index]
            world = parent @ _node_matrix(node)
            stack += [(child, world) for child in reversed(node.get("children", []))]
            if "camera" in node:
                where = f"{path} node {index} ({node.get('name', 'camera')})"
                cameras.append(_gltf_camera(document["cameras"][node["camera"]], world, width, height, where))
    except (KeyError, IndexError, TypeError, AttributeError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path} is not well-formed glTF ({type(error).__name__}: {error}); export it again") from None
    if not cameras:
        raise InputError(f"{path} has no camera in its scene; export it with cameras")
    return tuple(cameras)


def _gltf(path: Path) -> dict:
    if not path.is_file():
        raise InputError(f"glTF file {path} does not exist; check the path")
    data = path.read_bytes()
    if data[:4] == b"glTF":  # binary: a header of 12 bytes, then the chunk "JSON" (glTF 2.0 section 4.4)
        length, kind = struct.unpack("<I4s", data[12:20]) if len(data) >= 20 else (0, b"")
        if kind != b"JSON" or len(data) < 20 + length:
            raise InputError(f"{path} is a truncated or malformed .glb; export it again")
        data = data[20:20 + length]
    document = _json(path, data)
    if not isinstance(document, dict):
        raise InputError(f"{path} is not glTF: its JSON is no object; export it again")
    return document


def _node_matrix(node: dict) -> np.ndarray:
    if "matrix" in node:
        return np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T  # stored by columns
    matrix = np.eye(4)
    x, y, z, w = np.array(node.get("rotation", (0.0, 0.0, 0.0, 1.0)), dtype=np.float64)
    half = math.sqrt(x * x + y * y + z * z)
    turn = 2.0 * math.atan2(half, w)
    matrix[:3, :3] = rotation_matrix(np.array([x, y, z]) * (turn / half if half else 0.0)) * node.get("scale", (1.0, 1.0, 1.0))
    matrix[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return matrix


def _gltf_camera(camera: dict, world: np.ndarray, width: int, height: int, where: str) -> Camera:
    if camera.get("type") != "perspective":
        raise InputError(f"{where} is a camera of type {camera.get('type')!r}; only perspective cameras are supported")
    lens = camera["perspective"]
    pose = world.copy()
    with np.errstate(invalid="ignore", divide="ignore"):
        pose[:3, :3] /= np.linalg.norm(pose[:3, :3], axis=0)
    pose = check_rigid(pose, f"{where} world transform")
    length, near = focal(math.degrees(lens["yfov"]), height), lens["znear"]
    far = lens.get("zfar", 1000.0 * near)
    return Camera(inverse_rigid(pose), length, length, width / 2.0, height / 2.0, width, height, near, far)
