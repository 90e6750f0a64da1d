"""Pinhole and orthographic cameras as docs/conventions.md states them: poses and intrinsics in; frozen, checked `Camera`s out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...cache.errors import InputError
from ...cache.layout import beyond_fp32

KINDS = ("perspective", "orthographic")
RIGID_TOLERANCE = 1e-3  # poses in text files are often rounded to six digits, or float32


@dataclass(frozen=True, eq=False)
class Camera:
    """world_to_camera: (4, 4) rigid, the camera looks along its -z with +y up. fx, fy, cx, cy: pixels of a width x height
    image. near, far: distances along the view axis, 0 < near < far.

    kind "orthographic": fx, fy are pixels a unit of the scene, whatever the distance; near < far may be any numbers, and tell only between
    which depths what is in front is told by depth. Raises InputError for anything else."""

    world_to_camera: np.ndarray
    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int
    near: float = 0.05
    far: float = 100.0
    kind: str = "perspective"

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise InputError(f"camera kind is {self.kind!r:.40}; allowed: {' '.join(KINDS)}")
        matrix = check_rigid(self.world_to_camera, "camera world_to_camera").copy()
        matrix.setflags(write=False)
        object.__setattr__(self, "world_to_camera", matrix)
        for name in ("width", "height"):
            value = getattr(self, name)
            if int(value) != value or value < 1:
                raise InputError(f"camera {name} is {value}; it must be a whole number of pixels, 1 or more")
            object.__setattr__(self, name, int(value))
        signed = ("cx", "cy") if self.kind == "perspective" else ("cx", "cy", "near", "far")
        for name in ("fx", "fy", "cx", "cy", "near", "far"):
            value = float(getattr(self, name))
            if beyond_fp32(value) or (np.float32(value) <= 0.0 and name not in signed):
                raise InputError(f"camera {name} is {value}; it must be {'' if name in signed else 'above 0 and '}finite in fp32")
            object.__setattr__(self, name, value)
        if self.far <= self.near:
            raise InputError(f"camera far is {self.far}; it must be above near, {self.near}")
        with np.errstate(over="ignore", invalid="ignore"):
            bad = beyond_fp32([self.projection_rows(), self.clip_rows()])
        if bad.any():
            row, column = (int(i) for i in np.argwhere(bad)[0][1:])
            raise InputError(f"camera takes points to clip coordinates by numbers beyond the range of fp32 (row {row}, column "
                             f"{column}); bring the pose, fx, fy, cx and cy nearer to the size of the scene and the image")

    @property
    def position(self) -> np.ndarray:
        """The eye in world space, (3,)."""
        return -self.world_to_camera[:3, :3].T @ self.world_to_camera[:3, 3]

    @property
    def camera_to_world(self) -> np.ndarray:
        """(4, 4), the inverse of world_to_camera."""
        return inverse_rigid(self.world_to_camera)

    def projection_rows(self) -> np.ndarray:
        """(4, 4): takes (x_cam, y_cam, z_cam, 1) to Vulkan clip coordinates (x, y, z, w), y down and depth in [0, 1]."""
        if self.kind == "orthographic":
            depth = 1.0 / (self.far - self.near)
            return np.array([
                [2.0 * self.fx / self.width, 0.0, 0.0, 2.0 * self.cx / self.width - 1.0],
                [0.0, -2.0 * self.fy / self.height, 0.0, 2.0 * self.cy / self.height - 1.0],
                [0.0, 0.0, -depth, -depth * self.near],
                [0.0, 0.0, 0.0, 1.0],
            ])
        depth = self.far / (self.far - self.near)
        return np.array([
            [2.0 * self.fx / self.width, 0.0, 1.0 - 2.0 * self.cx / self.width, 0.0],
            [0.0, -2.0 * self.fy / self.height, 1.0 - 2.0 * self.cy / self.height, 0.0],
            [0.0, 0.0, -depth, -depth * self.near],
            [0.0, 0.0, -1.0, 0.0],
        ])

    def clip_rows(self) -> np.ndarray:
        """(4, 4): takes (x, y, z, 1) in world space to Vulkan clip coordinates (x, y, z, w)."""
        return self.projection_rows() @ self.world_to_camera

    def resized(self, width: int, height: int) -> Camera:
        """The same view on another number of pixels."""
        x, y = width / self.width, height / self.height
        return replace(self, fx=self.fx * x, fy=self.fy * y, cx=self.cx * x, cy=self.cy * y, width=width, height=height)


def check_rigid(matrix: np.ndarray, where: str) -> np.ndarray:
    """The matrix as (4, 4) float64; raises InputError, naming `where`, unless it is a rotation and a translation."""
    try:
        matrix = np.asarray(matrix, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{where} is not a 4 x 4 matrix of numbers; give four rows of four") from None
    if matrix.shape != (4, 4):
        raise InputError(f"{where} has shape {matrix.shape}; it must be (4, 4)")
    if (bad := beyond_fp32(matrix)).any():
        row, column = np.argwhere(bad)[0]
        raise InputError(f"{where} has the value {matrix[row, column]} in row {row}, column {column}; it must be finite in fp32")
    rotation = matrix[:3, :3]
    off = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if off > RIGID_TOLERANCE:
        raise InputError(f"{where} is not rigid: its rotation is {off:.3g} away from orthonormal, allowed is "
                         f"{RIGID_TOLERANCE:g}; remove scale and shear")
    if np.linalg.det(rotation) < 0.0:
        raise InputError(f"{where} mirrors space (determinant -1); flip one axis of it")
    off = float(np.abs(matrix[3] - (0.0, 0.0, 0.0, 1.0)).max())
    if off > RIGID_TOLERANCE:
        raise InputError(f"{where} has the last row {matrix[3].tolist()}; it must be 0 0 0 1 (is the matrix transposed?)")
    return matrix


def inverse_rigid(matrix: np.ndarray) -> np.ndarray:
    """The inverse of a rigid (4, 4) matrix."""
    out = np.eye(4)
    out[:3, :3] = matrix[:3, :3].T
    out[:3, 3] = -matrix[:3, :3].T @ matrix[:3, 3]
    return out


def focal(fov_degrees: float, pixels: int) -> float:
    """Focal length in pixels of a field of view across `pixels`. Raises InputError outside (0, 180) degrees."""
    if not 0.0 < fov_degrees < 180.0:
        raise InputError(f"field of view is {fov_degrees} degrees; it must be between 0 and 180")
    return pixels / 2.0 / float(np.tan(np.radians(fov_degrees) / 2.0))


def look_at(eye: Sequence[float], target: Sequence[float], up: Sequence[float], fov_y_degrees: float, width: int, height: int,
            near: float = 0.05, far: float = 100.0) -> Camera:
    """A camera at `eye` that sees `target` in the centre of the image, with square pixels."""
    length = focal(fov_y_degrees, height)
    return Camera(_towards(eye, target, up), length, length, width / 2.0, height / 2.0, width, height, near, far)


def look_along(eye: Sequence[float], target: Sequence[float], up: Sequence[float], span: float, width: int, height: int,
               near: float = 0.05, far: float = 100.0) -> Camera:
    """An orthographic camera that looks from `eye` towards `target` and has it in the centre of the image, with square pixels; the image
    is `span` units of the scene high. Depths count from the eye."""
    if isinstance(span, bool) or not isinstance(span, int | float | np.number) or not span > 0:
        raise InputError(f"look_along: span is {span!r:.40}; a number above 0 is needed")
    length = height / float(span)
    return Camera(_towards(eye, target, up), length, length, width / 2.0, height / 2.0, width, height, near, far, "orthographic")


def _towards(eye: Sequence[float], target: Sequence[float], up: Sequence[float]) -> np.ndarray:
    """World to camera, of a camera at `eye` with `target` on its axis."""
    eye, target, up = (np.asarray(point, dtype=np.float64) for point in (eye, target, up))
    back = eye - target
    right = np.cross(up, back)
    if np.linalg.norm(right) <= 1e-9 * np.linalg.norm(up) * np.linalg.norm(back):
        raise InputError(f"a camera with up {up.tolist()} along the line from eye {eye.tolist()} to target {target.tolist()}; "
                         "give another up or move the eye")
    back, right = back / np.linalg.norm(back), right / np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3] = np.stack([right, np.cross(back, right), back, eye], axis=1)
    return inverse_rigid(pose)


def orbit(n: int, elevations: Sequence[float], distance: float, fov_y_degrees: float, size: tuple[int, int],
          target: Sequence[float] = (0.0, 0.0, 0.0)) -> tuple[Camera, ...]:
    """n cameras around `target`, y up: azimuth goes evenly once round, elevation (degrees above the horizon) cycles through
    the list. size: (width, height). Azimuth 0 is on +z."""
    if n < 1 or not len(elevations):
        raise InputError(f"orbit of {n} cameras on {len(elevations)} elevations; give at least one of each")
    cameras = []
    for i in range(n):
        azimuth, elevation = 2.0 * np.pi * i / n, np.radians(elevations[i % len(elevations)])
        ray = np.array([np.sin(azimuth) * np.cos(elevation), np.sin(elevation), np.cos(azimuth) * np.cos(elevation)])
        cameras.append(look_at(np.asarray(target) + distance * ray, target, (0.0, 1.0, 0.0), fov_y_degrees, *size))
    return tuple(cameras)


def rotation_matrix(rotvec: Sequence[float]) -> np.ndarray:
    """(3, 3) of a rotation vector (axis times angle in radians), by Rodrigues' formula; exact at 0."""
    rotvec = np.asarray(rotvec, dtype=np.float64)
    angle = float(np.linalg.norm(rotvec))
    x, y, z = rotvec
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    # sin(a) / a and (1 - cos(a)) / a^2; np.sinc is sin(pi x) / (pi x), smooth at 0.
    return np.eye(3) + np.sinc(angle / np.pi) * cross + 0.5 * np.sinc(angle / 2.0 / np.pi) ** 2 * (cross @ cross)


def rotation_vector(matrix: np.ndarray) -> np.ndarray:
    """The rotation vector (3,), of length 0 to pi, of a rotation (3, 3).

    Goes through the unit quaternion computed from its largest component (Shepperd 1978), so it is accurate at 0 and near pi.
    """
    m = np.asarray(matrix, dtype=np.float64)
    x, y, z = np.diag(m)
    # The outer product of the quaternion (x, y, z, w) with itself, times 4.
    outer = np.array([
        [1 + x - y - z, m[0, 1] + m[1, 0], m[0, 2] + m[2, 0], m[2, 1] - m[1, 2]],
        [m[0, 1] + m[1, 0], 1 - x + y - z, m[1, 2] + m[2, 1], m[0, 2] - m[2, 0]],
        [m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], 1 - x - y + z, m[1, 0] - m[0, 1]],
        [m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], 1 + x + y + z],
    ])
    quaternion = outer[np.argmax(np.diag(outer))]
    quaternion = quaternion / np.linalg.norm(quaternion) * (1.0 if quaternion[3] >= 0.0 else -1.0)
    length = float(np.linalg.norm(quaternion[:3]))
    if length == 0.0:
        return np.zeros(3)
    return quaternion[:3] * (2.0 * np.arctan2(length, quaternion[3]) / length)
