"""NeRF-style transforms JSON, as its several tools write it: a file in; `Shot`s out.

Every key is applied, known to change nothing here, or refused by name: what is not read must not be taken for read. Keys are those of
the NeRF synthetic sets, instant-ngp, nerfstudio and the exporters that write for them.
"""
from __future__ import annotations

import difflib
import math
from pathlib import Path

import numpy as np

from ...cache.errors import InputError, note
from .cameras import check_rigid, focal
from .images import IMAGE_SUFFIXES
from .lens import Lens
from .shots import Shot
from .text import is_file, is_folder, parse_json, read_bytes, shown

NAMES = ("transforms_train.json", "transforms.json")
LENS = ("fl_x", "fl_y", "camera_angle_x", "camera_angle_y", "x_fov", "y_fov", "cx", "cy", "w", "h")
RADIAL3 = ("k1", "k2", "k3", "p1", "p2")
FISHEYE = ("k1", "k2", "k3", "k4")
# What each camera_model has of coefficients; a model that is not named has RADIAL3.
LENSES = {"PINHOLE": (), "SIMPLE_PINHOLE": (), "PERSPECTIVE": (), "SIMPLE_RADIAL": ("k1",), "RADIAL": ("k1", "k2"), "OPENCV": RADIAL3,
          "FULL_OPENCV": (*RADIAL3, "k4", "k5", "k6"), "OPENCV_FISHEYE": FISHEYE}
DISTORTION = (*(f"k{k}" for k in range(1, 7)), *(f"p{k}" for k in range(1, 5)), *(f"s{k}" for k in range(1, 5)), "b1", "b2", "skew",
              "distortion_params", "distortion")
# Another way to form a picture: refused unless false, 0 or null.
MODELS = ("fisheye", "equirectangular", "latlong", "orthographic", "ortho", "panorama", "is_panorama",
          *(f"ftheta_p{k}" for k in range(5)), "fisheye_crop_radius", "rolling_shutter")
MASKS = ("mask_path", "mask_file_path")
MASKED = "say views.backdrop = {color = [...]} in the job, and drop the key"
MATRIX = "intrinsics are read from fl_x, fl_y, cx, cy; write them there and drop the key"
REFUSED = {**dict.fromkeys(("mask_color", "white_transparent", "black_transparent"), MASKED),
           **dict.fromkeys(("K", "intrinsics", "intrinsic_matrix", "camera_intrinsics"), MATRIX),
           **dict.fromkeys(("transform_matrix_start", "transform_matrix_end"), "a camera that moves during its exposure is not supported")}
# Bounds and settings of radiance fields, where the poses came from, files of other kinds: nothing that moves a ray of ours.
HARMLESS = ("aabb_scale", "aabb", "render_aabb", "render_aabb_to_local", "scale", "offset", "from_na", "up", "n_frames", "near", "far",
            "applied_transform", "applied_scale", "orientation_override", "ply_file_path", "val_filenames", "test_filenames", "test_frames",
            "has_mask", "enable_depth_loading", "enable_ray_loading", "integer_depth_scale", "depth_unit_scale_factor", "depth_path",
            "depth_file_path", "normal_file_path", "n_extra_learnable_dims", "sharpness_discard_threshold", "sharpness", "rotation",
            "colmap_im_id", "colmap_image_id", "image_id", "camera_id", "cam_idx", "frame_id", "timestamp", "time", "exposure",
            "is_bad", "label", "name", "source", "comment", "version", "date")
SETTINGS = (*LENS, *MASKS, "fix_premult", *DISTORTION, *MODELS, "camera_model", "is_fisheye", *REFUSED, *HARMLESS)


def read_transforms(path: str | Path, skip: bool = False) -> list[Shot]:
    """The frames of a transforms JSON, or of the one in a folder, in its order; where it has `train_filenames`, those alone. skip: without
    those whose picture does not exist. Raises InputError for everything that can be known without opening a picture."""
    path = transforms_file(Path(path))
    document = parse_json(read_bytes(path, "views file"), path)
    frames = document.get("frames") if isinstance(document, dict) else None
    if not isinstance(frames, list) or not frames:
        raise InputError(f"{shown(path)} has no frames; it needs \"frames\": [{{\"file_path\": ..., \"transform_matrix\": ...}}, ...]")
    _known(document, ("frames", "train_filenames", *SETTINGS), shown(path))
    top = {key: value for key, value in document.items() if key != "frames"}
    result, missing = [], []
    for i, frame in enumerate(frames):
        where = f"{shown(path)} frame {i}"
        if not isinstance(frame, dict) or not isinstance(frame.get("file_path"), str) or "transform_matrix" not in frame:
            raise InputError(f"{where} needs a file_path and a transform_matrix")
        _known(frame, ("file_path", "transform_matrix", *SETTINGS), where)
        setting = {**top, **frame}
        _check_model(setting, where)
        intrinsics(setting, 1, 1, where)  # names a bad number before any picture is opened
        pose = check_rigid(frame["transform_matrix"], f"{where} ({shown(frame['file_path'])}) transform_matrix")
        if skip and _file(path.parent / _slashed(frame["file_path"])) is None:
            missing.append(frame["file_path"])
            continue
        result.append((frame["file_path"], _shot(path.parent, frame["file_path"], pose, setting, where)))
    if missing:
        lost = f"{len(missing)} of its {len(frames)} pictures do not exist, such as {shown(missing[0])}"
        if not result:
            raise InputError(f"{shown(path)}: {lost}; check the paths")
        note(f"{shown(path)}: {lost}; the others are used")
    if len({str(frame.get("time")) for frame in frames}) > 1:
        note(f"{shown(path)}: its frames are of different times, but the mesh stands still; take frames of one time")
    return _training(top, result, shown(path))


def _shot(folder: Path, name: str, pose: np.ndarray, setting: dict, where: str) -> Shot:
    mask = next((setting[key] for key in MASKS if _set(setting.get(key))), None)
    if mask is not None and not isinstance(mask, str):
        raise InputError(f"{where}: its mask's path is {shown(repr(mask), 60)}; a text is needed")
    return Shot(_image_file(folder / _slashed(name), where), pose, lambda w, h: lens(setting, w, h, where),
                (_number(setting, "w", where), _number(setting, "h", where)), where,
                None if mask is None else _image_file(folder / _slashed(mask), where, "mask"), bool(setting.get("fix_premult")))


def _slashed(name: str) -> str:
    """A path as this system takes it: tools on Windows write it with backslashes."""
    return name.replace("\\", "/")


def _training(top: dict, frames: list[tuple[str, Shot]], where: str) -> list[Shot]:
    names = top.get("train_filenames")
    if names is None:
        return [frame for _, frame in frames]
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise InputError(f"{where}: train_filenames is {shown(repr(names), 60)}; a list of the frames' file_path is needed")
    chosen = [frame for name, frame in frames if name in set(names)]
    if not chosen:
        raise InputError(f"{where}: train_filenames names none of the {len(frames)} frames; correct it, or drop it to use all")
    return chosen


def transforms_file(path: Path) -> Path:
    """The JSON file of a path to it or to its folder. Raises InputError."""
    if is_folder(path):
        for name in NAMES:
            if is_file(path / name):
                return path / name
        raise InputError(f"{shown(path)} has no {' or '.join(NAMES)}; give the path of the JSON file")
    if not is_file(path):
        raise InputError(f"views file {shown(path)} does not exist; check the path")
    return path


def _known(table: dict, allowed: tuple[str, ...], where: str) -> None:
    for key in table:
        if key not in allowed:
            near = [k for k in allowed if k.lower() == key.lower()] or difflib.get_close_matches(key[:80], allowed, 1, 0.6)
            hint = f"did you mean {near[0]}?" if near else "remove it, if nothing of the cameras or pictures depends on it"
            raise InputError(f"{where}: {shown(key, 60)} is an unknown key; {hint}")


def _check_model(setting: dict, where: str) -> None:
    """Raises InputError for cameras of another kind than `Lens`, and for pictures that need what is not read."""
    model = setting.get("camera_model")
    if model is not None and (not isinstance(model, str) or model.upper() not in LENSES):
        raise InputError(f"{where}: camera_model is {shown(repr(model), 60)}; allowed: {' '.join(LENSES)}; undistort the images to a "
                         "pinhole")
    for key in MODELS:
        if _set(setting.get(key)):
            raise InputError(f"{where}: {key} is {shown(repr(setting[key]), 60)}; cameras of one lens and one moment are read; "
                             "undistort the images to a pinhole")
    used = _coefficients(setting)
    for key in DISTORTION:
        value = setting.get(key)
        if key in used:
            _number(setting, key, where)
        elif _set(value):
            kind = "without a camera_model" if model is None else f"with camera_model {model}"
            raise InputError(f"{where}: lens distortion {key} is {shown(repr(value), 60)}; {kind}, {' '.join(used) or 'none'} "
                             f"{'are' if len(used) > 1 else 'is'} read; name the right model, or undistort the images")
    for key, hint in REFUSED.items():
        if _set(setting.get(key)):
            raise InputError(f"{where}: {key} is not read: {hint}")


def _coefficients(setting: dict) -> tuple[str, ...]:
    """The names of the coefficients that the setting's lens has."""
    return FISHEYE if _set(setting.get("is_fisheye")) else LENSES[(setting.get("camera_model") or "OPENCV").upper()]


def lens(setting: dict, width: int, height: int, where: str) -> Lens:
    """The lens of a picture of width x height, by the keys in force. Raises InputError."""
    used = _coefficients(setting)
    value = {key: float(_number(setting, key, where) or 0.0) for key in used}
    k = tuple(value.get(f"k{n}", 0.0) for n in range(1, 7))
    while k and k[-1] == 0.0:
        k = k[:-1]
    model = "fisheye" if used is FISHEYE else "opencv"
    return Lens(*intrinsics(setting, width, height, where), model, k, (value.get("p1", 0.0), value.get("p2", 0.0)))


def _set(value) -> bool:
    """Whether a key says anything: not null, false, 0 or empty, or a list of such."""
    return any(map(_set, value)) if isinstance(value, list) else bool(value)


def _image_file(path: Path, where: str, what: str = "image") -> Path:
    file = _file(path)
    if file is None:
        raise InputError(f"{where}: {what} file {shown(path)} does not exist, nor with {', '.join(IMAGE_SUFFIXES)}; check the path"
                         + (", or say views.missing = \"skip\"" if what == "image" else ""))
    return file


def _file(path: Path) -> Path | None:
    """The file of that path, or with an extension that it lacks."""
    with_suffix = (path.with_name(path.name + suffix) for s in IMAGE_SUFFIXES for suffix in (s, s.upper()) if path.name)
    return next((candidate for candidate in (path, *with_suffix) if is_file(candidate)), None)


def _number(setting: dict, key: str, where: str) -> float | None:
    value = setting.get(key)
    if value is not None and (not isinstance(value, int | float) or isinstance(value, bool) or not math.isfinite(value)):
        raise InputError(f"{where}: {key} is {shown(repr(value), 60)}; it must be a finite number")
    return value


def intrinsics(setting: dict, width: int, height: int, where: str) -> tuple[float, float, float, float]:
    """fx, fy, cx, cy in pixels; each value of the frame wins over that of the file, and pixels over angles. Raises InputError."""
    lengths = []
    for axis, pixels in (("x", width), ("y", height)):
        length, angle, degrees = (_number(setting, key, where) for key in (f"fl_{axis}", f"camera_angle_{axis}", f"{axis}_fov"))
        if length is not None and length <= 0.0:
            raise InputError(f"{where}: fl_{axis} is {length}; it must be above 0, in pixels")
        if angle is not None and not 0.0 < angle < math.pi:
            raise InputError(f"{where}: camera_angle_{axis} is {angle}; it must be between 0 and pi, in radians")
        if degrees is not None and not 0.0 < degrees < 180.0:
            raise InputError(f"{where}: {axis}_fov is {degrees}; it must be between 0 and 180, in degrees")
        angle = math.degrees(angle) if angle is not None else degrees
        lengths.append(length if length is not None or angle is None else focal(angle, pixels))
    if lengths[0] is None:
        raise InputError(f"{where} has neither camera_angle_x nor fl_x; give one of them, there or at the top")
    cx, cy = _number(setting, "cx", where), _number(setting, "cy", where)
    return (lengths[0], lengths[0] if lengths[1] is None else lengths[1],
            width / 2.0 if cx is None else cx, height / 2.0 if cy is None else cy)
