"""A frame in which the object fills the unit ball, whatever unit and origin its cameras have: cameras in; the same there, and the way
back, out."""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...cache.errors import InputError
from ...cache.layout import beyond_fp32
from .cameras import Camera


@dataclass(frozen=True, eq=False)
class Unit:
    """Points x of the frame are origin + scale x in the input's. Raises InputError."""

    origin: np.ndarray
    scale: float

    def __post_init__(self) -> None:
        origin = np.array(self.origin, np.float64)
        if origin.shape != (3,) or beyond_fp32([*origin, self.scale]).any() or not self.scale > 0.0:
            raise InputError(f"a ball of radius {self.scale!r:.40} about {origin.tolist()!r:.80}; three finite numbers and one above 0 "
                             "are needed")
        origin.setflags(write=False)
        object.__setattr__(self, "origin", origin)

    def inside(self, points: np.ndarray) -> np.ndarray:
        """Points (n, 3) of the input's frame, in this one."""
        return (np.asarray(points, np.float64) - self.origin) / self.scale

    def cameras(self, cameras: Sequence[Camera]) -> tuple[Camera, ...]:
        """Cameras of the input's frame in this one, with the same pictures; near and far stay as they are. Raises InputError."""
        moved = []
        for camera in cameras:
            pose = camera.world_to_camera.copy()
            pose[:3, 3] = (pose[:3, :3] @ self.origin + pose[:3, 3]) / self.scale
            across = self.scale if camera.kind == "orthographic" else 1.0
            moved.append(replace(camera, world_to_camera=pose, fx=camera.fx * across, fy=camera.fy * across))
        return tuple(moved)
