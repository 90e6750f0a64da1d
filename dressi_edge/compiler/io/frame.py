"""Scenes far from their origin, such as those in map coordinates: fp32 on the device has 7 digits, and 5000 km leave half a metre.

In: a mesh, views and lights in the input's frame, float64. Out: the same about the mesh's middle, and the origin of that frame in the
input's, which results are given back with. What is near its origin stays as it is, bit for bit.
"""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from .cameras import Camera
from .mesh import Mesh, origin_of
from .views import Views

if TYPE_CHECKING:
    from ..render.light import Light

def recentred(mesh: Mesh, views: Views | Sequence[Camera], lights: Sequence[Light]
              ) -> tuple[Mesh, Views | Sequence[Camera], Sequence[Light], np.ndarray]:
    """Mesh, views and lights moved by -origin, and the origin (3,): zero where nothing was moved."""
    (mesh,), views, lights, origin = recentred_parts([mesh], views, lights, origin_of(mesh.positions))
    return mesh, views, lights, origin


def recentred_parts(meshes: Sequence[Mesh], views: Views | Sequence[Camera], lights: Sequence[Light], origin: np.ndarray
                    ) -> tuple[Sequence[Mesh], Views | Sequence[Camera], Sequence[Light], np.ndarray]:
    """Several meshes, views and lights moved by -origin, and the origin; all as they are where it is zero."""
    if not origin.any():
        return meshes, views, lights, origin
    meshes = [replace(mesh, positions=mesh.positions - origin) for mesh in meshes]
    lights = tuple(_moved_light(x, origin) for x in lights)
    cameras = tuple(_moved(c, origin) for c in (views.cameras if isinstance(views, Views) else views))
    return meshes, replace(views, cameras=cameras) if isinstance(views, Views) else cameras, lights, origin


def _moved(camera: Camera, origin: np.ndarray) -> Camera:
    """The camera in the frame about `origin`: R (x + origin) + t, so that a rotation of few digits is not asked for the eye."""
    pose = camera.world_to_camera.copy()
    pose[:3, 3] += pose[:3, :3] @ origin
    return replace(camera, world_to_camera=pose)


def _moved_light(light: Light, origin: np.ndarray) -> Light:
    """The light in the frame about `origin`; directions stay, and so do vectors that are nodes of a graph."""
    known = light.kind in ("point", "spot") and isinstance(light.vector, tuple)
    return replace(light, vector=tuple(np.subtract(light.vector, origin).tolist())) if known else light
