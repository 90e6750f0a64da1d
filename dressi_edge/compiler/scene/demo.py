"""The paper's pear-like problem with a target of our own: six pictures of a textured pear, a grey sphere, two phases.

In: a size and a number of steps. Out: `Problem`s to compile, and a distance to judge the shape by.
"""
from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..io.cameras import Camera, orbit
from ..io.meshes import Mesh
from ..io.shapes import sphere
from ..io.views import Views
from ..render.light import Light
from ..render.optimizer import Adam
from ..render.raster import Softness
from ..render.schedule import Schedule
from .problem import Loss, Problem
from .sections import SHARP

VIEWS = 6
LIGHTS = (Light("directional", 2.2, (-0.5, -0.8, -0.45)), Light("directional", 0.9, (0.7, 0.2, 0.6)), Light("ambient", 0.16))


def cameras(size: int) -> tuple[Camera, ...]:
    """Six cameras around the unit ball, by turns above and below the horizon."""
    return orbit(VIEWS, (25.0, -25.0), 2.5, 52.0, (size, size))


def picture(mesh: Mesh, views: Sequence[Camera]) -> Problem:
    """Draws a mesh with its texture: output "render.color"."""
    problem = Problem(mesh, views, albedo="texture")
    problem.render("render", SHARP)
    return problem


def clay(mesh: Mesh, views: Sequence[Camera]) -> Problem:
    """Draws a mesh in grey under three lights, so that one sees its shape: output "render.color", sRGB encoded."""
    problem = Problem(mesh, views, albedo="constant", shading="lambert", lights=LIGHTS, srgb=True)
    problem.render("render", SHARP)
    return problem


def start() -> Mesh:
    return sphere(2562, 0.6)


def reconstruction(images: np.ndarray, views: Sequence[Camera], shape_steps: int, texture_steps: int) -> Problem:
    """From the sphere to images (n, h, w, 4): the shape by silhouettes, then the albedo texture."""
    names = tuple(f"view {k}" for k in range(len(views)))
    side = views[0].width
    # Stiff at first: what six silhouettes leave open would else end in folds. epsilon: what no silhouette moves stays calm.
    smooth = Schedule(200.0, 10.0, max(1, shape_steps * 3 // 4), "exponential")
    problem = Problem(start(), Views(np.clip(images, 0.0, 1.0).astype(np.float32), tuple(views), names), albedo="texture",
                      texture_size=(side * 3 // 2, side))
    problem.phase("shape", shape_steps, {"vertices": Adam(Schedule(0.01, 0.001, shape_steps, "exponential"), epsilon=1e-5)},
                  [Loss("silhouette"), Loss("laplacian", smooth, power=2), Loss("normal_consistency", 0.01)], Softness(2.0))
    problem.phase("texture", texture_steps, {"texture": Adam(Schedule(0.05, 0.005, texture_steps, "exponential"))},
                  [Loss("color", masked=True)], SHARP)
    problem.render("render", SHARP)
    return problem


def surface_distance(points: np.ndarray, mesh: Mesh) -> np.ndarray:
    """Distance of each point (n, 3) to the nearest point of the mesh's triangles; brute force.

    Inside the triangle's prism it is the distance to the plane, outside that to the nearest edge.
    """
    corners = mesh.positions[mesh.faces]
    nearest = np.empty(len(points))
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    for low in range(0, len(points), 64):
        p = np.asarray(points[low:low + 64], np.float64)[:, None]
        squared, inside = np.full((p.shape[0], len(corners)), np.inf), np.ones((p.shape[0], len(corners)), bool)
        for k in range(3):
            a, edge = corners[:, k], corners[:, (k + 1) % 3] - corners[:, k]
            d = p - a
            t = np.clip((d * edge).sum(2) / np.maximum((edge * edge).sum(1), 1e-300), 0.0, 1.0)
            squared = np.minimum(squared, ((d - t[..., None] * edge) ** 2).sum(2))
            inside &= (d * np.cross(normal, edge)).sum(2) >= 0.0
        plane = ((p - corners[:, 0]) * normal).sum(2) ** 2
        nearest[low:low + 64] = np.sqrt(np.where(inside, plane, squared).min(axis=1))
    return nearest
