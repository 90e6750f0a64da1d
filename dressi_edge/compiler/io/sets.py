"""Calibrated sets of multi-view stereo: projection matrices in files, pictures in a folder; `Shot`s out.

idr         cameras_sphere.npz of IDR, NeuS and their DTU data: world_mat_0, ... = K [R t], and scale_mat_0, from the unit ball to the
            object's place
middlebury  *_par.txt of the Middlebury multi-view data: a count, then lines of name, K, R, t
Both have cameras that look along +z with y down, as OpenCV has them.
"""
from __future__ import annotations

import io
import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...cache.errors import InputError, note
from .cameras import check_rigid, inverse_rigid
from .decode import images_in
from .lens import Lens
from .shots import Shot
from .text import is_file, is_folder, read_bytes, shown

DOWN_FORWARD = np.diag([1.0, -1.0, -1.0, 1.0])  # from a camera with y up that looks along -z to one with y down that looks along +z
IDR_FOLDERS = ("image", "images", "rgb")
MAX_BYTES = 1 << 24  # of a matrix in a file
NEGLIGIBLE = 1e-6  # skew over focal length, of a matrix that has gone through fp32


def find_images(folder: Path, names: Sequence[str], above: int = 3) -> Path:
    """The folder of one of these names beside or above a folder; else the folder itself. Raises InputError."""
    place = folder
    for _ in range(above + 1):
        for name in names:
            if is_folder(place / name):
                return place / name
        if place == place.parent:
            break
        place = place.parent if place.name else place.resolve().parent
    if any(True for _ in images_in(folder)):
        return folder
    raise InputError(f"there is no folder {' or '.join(names)} beside or above {shown(folder)}; say views.images")


def present(shots: list[Shot], skip: bool, where: str = "") -> list[Shot]:
    """The shots, or with `skip` those whose picture exists. Raises InputError."""
    missing = [s for s in shots if not is_file(s.file)]
    if not missing:
        return shots
    lost = f"{where}{len(missing)} of {len(shots)} pictures do not exist, such as {shown(missing[0].file)}"
    if not skip or len(missing) == len(shots):
        raise InputError(f"{lost}; check views.images" + ("" if len(missing) == len(shots) else ", or say views.missing = \"skip\""))
    note(f"{lost}; the others are used")
    return [s for s in shots if is_file(s.file)]


def read_idr(path: str | Path, images: Path | None = None, skip: bool = False
             ) -> tuple[list[Shot], tuple[np.ndarray, float] | None]:
    """The photographs of a cameras.npz, and the (centre, radius) of its ball, if it says so. images: the folder of the pictures, which are
    taken in order; None: image/ beside the file. Raises InputError."""
    path = Path(path)
    arrays = _npz(path)
    numbers = sorted(int(key[10:]) for key in arrays if key.startswith("world_mat_") and key[10:].isdigit())
    if not numbers:
        raise InputError(f"{shown(path)} has no world_mat_0, ...; give a cameras.npz as IDR and NeuS have it")
    root = find_images(path.parent, IDR_FOLDERS, 0) if images is None else images
    files = images_in(root) if is_folder(root) else []
    if len(files) != len(numbers):
        raise InputError(f"{shown(path)} has {len(numbers)} cameras, but {shown(root)} has {len(files)} pictures; they are taken in order, "
                         "so there must be as many")
    shots = []
    for number, file in zip(numbers, files):
        where = f"{shown(path)} world_mat_{number}"
        k, pose = decomposed(_matrix(arrays, f"world_mat_{number}", path)[:3], where)
        shots.append(_shot(file, k, pose, where))
    ball = None
    if f"scale_mat_{numbers[0]}" in arrays:
        scale = _matrix(arrays, f"scale_mat_{numbers[0]}", path)
        radius = float(np.linalg.norm(scale[:3, 0]))
        if radius > 0.0:
            ball = scale[:3, 3], radius
    return present(shots, skip), ball


def _npz(path: Path) -> dict[str, np.ndarray]:
    data = read_bytes(path, "cameras file")
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            if large := [e.filename for e in archive.infolist() if e.file_size > MAX_BYTES]:
                raise InputError(f"{shown(path)} has {shown(large[0])} of more than {MAX_BYTES} bytes; matrices of 4 x 4 are needed")
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            return {key: arrays[key] for key in arrays.files if key.startswith(("world_mat_", "scale_mat_")) and "inv" not in key}
    except InputError:
        raise
    except Exception as error:  # noqa: BLE001  (what a broken archive raises is not said)
        raise InputError(f"{shown(path)} is no archive of NumPy arrays ({shown(error, 80)}); give a .npz file") from None


def _matrix(arrays: dict, key: str, path: Path) -> np.ndarray:
    matrix = arrays.get(key)
    if matrix is None or matrix.dtype.kind not in "fiu" or matrix.shape not in ((4, 4), (3, 4)) or not np.isfinite(matrix).all():
        found = "missing" if matrix is None else f"{matrix.dtype} of shape {matrix.shape}"
        raise InputError(f"{shown(path)} {key} is {found}; a 4 x 4 matrix of finite numbers is needed")
    return np.asarray(matrix, np.float64)


def decomposed(projection: np.ndarray, where: str) -> tuple[np.ndarray, np.ndarray]:
    """K (3, 3) with K[2, 2] = 1, and the pose world to camera (4, 4), of a projection (3, 4) = K [R t] up to a factor. InputError."""
    m = projection[:, :3]
    scale = np.abs(m).max()
    if scale == 0.0 or abs(np.linalg.det(m / scale)) < 1e-12:
        raise InputError(f"{where} is no projection: its first three columns are singular")
    q, r = np.linalg.qr(np.flipud(m).T)  # RQ decomposition
    k, rotation = np.flipud(np.fliplr(r.T)), np.flipud(q.T)
    sign = np.diag(np.sign(np.diag(k)))
    k, rotation = k @ sign, sign @ rotation
    translation = np.linalg.solve(k, projection[:, 3])
    if np.linalg.det(rotation) < 0.0:  # a projection times -1 is the same
        rotation, translation = -rotation, -translation
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, translation
    return k / k[2, 2], pose


def read_middlebury(path: str | Path, images: Path | None = None, skip: bool = False) -> list[Shot]:
    """The photographs of a *_par.txt. images: the folder of the pictures; None: the file's own. Raises InputError."""
    path = Path(path)
    lines = [line.split() for line in read_bytes(path, "cameras file").decode("utf-8", "replace").splitlines() if line.strip()]
    if not lines or len(lines[0]) != 1 or not lines[0][0].isdigit():
        raise InputError(f"{shown(path)} line 1 must be the number of cameras; give a *_par.txt as Middlebury has it")
    shots, root = [], path.parent if images is None else images
    for n, words in enumerate(lines[1:], start=2):
        where = f"{shown(path)} line {n}"
        try:
            numbers = np.array(words[1:], float)
        except ValueError as error:
            raise InputError(f"{where}: {shown(error, 80)}; a number is needed") from None
        if len(numbers) != 21 or not np.isfinite(numbers).all():
            raise InputError(f"{where} has {len(numbers)} numbers after the name; 21 finite ones are needed: K, R, t")
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = numbers[9:18].reshape(3, 3), numbers[18:]
        shots.append(_shot(root / words[0], numbers[:9].reshape(3, 3), pose, f"{where} ({shown(words[0], 60)})"))
    if not shots:
        raise InputError(f"{shown(path)} has no camera after its first line")
    if int(lines[0][0]) != len(shots):
        note(f"{shown(path)} says {lines[0][0]} cameras, but has {len(shots)}; those are used")
    return present(shots, skip, f"{shown(path)}: ")


def _shot(file: Path, k: np.ndarray, pose: np.ndarray, where: str) -> Shot:
    """Of K and a pose world to camera as OpenCV has them."""
    if not (k[0, 0] > 0.0 and k[1, 1] > 0.0) or abs(k[1, 0]) + abs(k[2, 0]) + abs(k[2, 1]) > 1e-6 * k[0, 0] or abs(k[2, 2] - 1.0) > 1e-6:
        raise InputError(f"{where}: K is {np.round(k, 4).tolist()}; fx skew cx, 0 fy cy, 0 0 1 with focal lengths above 0 is needed")
    skew = float(k[0, 1]) if abs(k[0, 1]) > NEGLIGIBLE * k[0, 0] else 0.0
    lens = Lens(float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2]), skew=skew)
    pose = inverse_rigid(check_rigid(pose, where)) @ DOWN_FORWARD
    return Shot(file, pose, lambda w, h: lens, (None, None), where, stored=True)
