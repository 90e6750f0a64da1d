"""Meshes by recipe: spheres, and a textured pear."""
from __future__ import annotations

import numpy as np

from ...cache.errors import InputError
from .charts import cube_charts, texel_directions
from .mesh import Mesh, unique_rows
from .meshes import normalize


def icosphere(subdivisions: int, radius: float = 1.0) -> Mesh:
    """A sphere of 10 * 4**subdivisions + 2 vertices with cube-map uvs (none for 0: those faces are larger than a cube side)."""
    if not 0 <= subdivisions <= 8:
        raise InputError(f"icosphere has {subdivisions} subdivisions; allowed are 0 to 8 (655362 vertices)")
    return _geodesic(2 ** subdivisions, radius)


def sphere(vertices: int, radius: float = 1.0) -> Mesh:
    """The geodesic sphere with cube-map uvs whose vertex count is nearest: 42, 92, 162, 252, ... 10 n**2 + 2."""
    if not 4 <= vertices <= 700_000:
        raise InputError(f"sphere of {vertices} vertices; allowed are 4 to 700000")
    return _geodesic(max(2, round(((vertices - 2) / 10.0) ** 0.5)), radius)


def _geodesic(frequency: int, radius: float) -> Mesh:
    """An icosahedron with every edge cut in `frequency` pieces, pushed onto the sphere; faces are seen anticlockwise."""
    if not (np.isfinite(radius) and radius > 0.0):
        raise InputError(f"sphere radius is {radius}; it must be a finite number above 0")
    golden = (1.0 + 5.0 ** 0.5) / 2.0
    corners = np.array([(0, a, b * golden) for a in (-1, 1) for b in (-1, 1)], dtype=np.float64)
    corners = np.concatenate([np.roll(corners, turn, axis=1) for turn in range(3)])
    close = np.abs(np.linalg.norm(corners[:, None] - corners[None], axis=-1) - 2.0) < 1e-9
    triples = [(a, b, c) for a in range(12) for b in range(a) for c in range(b) if close[a, b] and close[b, c] and close[a, c]]
    # Rows of a triangle of points i + j + k = frequency, and the small triangles between neighbouring rows.
    grid = np.array([(frequency - i, i - j, j) for i in range(frequency + 1) for j in range(i + 1)]) / frequency
    grid = np.sin(grid * np.arctan(2.0))  # slerp along the edges, whose angle that is: more even than plain projection
    at = [i * (i + 1) // 2 for i in range(frequency + 1)]
    small = [(at[i] + j, at[i + 1] + j, at[i + 1] + j + 1) for i in range(frequency) for j in range(i + 1)]
    small += [(at[i] + j, at[i + 1] + j + 1, at[i] + j + 1) for i in range(frequency) for j in range(i)]
    points = np.concatenate([grid @ corners[list(triple)] for triple in triples])
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    faces = np.concatenate([np.array(small) + n * len(grid) for n in range(len(triples))])
    first, inverse = unique_rows(np.round(points, 9))
    points, faces = points[first], inverse[faces]
    a, b, c = (points[faces[:, i]] for i in range(3))
    inwards = np.einsum("ij,ij->i", np.cross(b - a, c - a), a + b + c) < 0.0
    faces[inwards] = faces[inwards][:, ::-1]
    if frequency == 1:
        return Mesh(points * radius, faces)
    charts = cube_charts(points, faces)
    return Mesh(points * radius, faces, charts.uvs, charts.uv_faces)


def pear(texture_height: int = 256, seed: int = 7) -> Mesh:
    """A textured target of our own: a bent pear of 2252 vertices and 4500 faces in the unit ball, y up, closed.

    The texture is (texture_height, 1.5 * texture_height, 3); spots and mottling come from `seed`.
    """
    ball = _geodesic(15, 1.0)
    angle = np.arccos(np.clip(ball.positions[:, 1], -1.0, 1.0))  # from the stem down
    around = np.arctan2(ball.positions[:, 2], ball.positions[:, 0])
    up = np.cos(angle)
    width = np.sin(angle) * (0.60 - 0.22 * up - 0.10 * np.exp(-((up - 0.42) / 0.28) ** 2))
    height = 1.02 * up - 0.16 * np.exp(-(angle / 0.24) ** 2) + 0.12 * np.exp(-((np.pi - angle) / 0.30) ** 2)
    bend = 0.16 * np.maximum(height, -0.4) ** 2
    positions = np.stack([width * np.cos(around) + bend, height, width * np.sin(around)], axis=1)
    charts = cube_charts(ball.positions, ball.faces)
    directions = texel_directions(texture_height, texture_height * 3 // 2, charts.reach, charts.gutter)
    return normalize(Mesh(positions, ball.faces, charts.uvs, charts.uv_faces, texture=_pear_skin(directions, seed)))


def _pear_skin(direction: np.ndarray, seed: int) -> np.ndarray:
    """sRGB albedo (h, w, 3) by direction (h, w, 3): green to yellow with mottling, a red cheek, brown ends and spots."""
    rng = np.random.default_rng(seed)

    def blend(below: np.ndarray, above: tuple[float, float, float], amount: np.ndarray) -> np.ndarray:
        return below + (np.array(above) - below) * np.clip(amount, 0.0, 1.0)[..., None]

    waves = rng.normal(size=(14, 3)) * np.linspace(3.0, 11.0, 14)[:, None]
    mottle = np.sin(direction @ waves.T + rng.uniform(0.0, 2.0 * np.pi, 14)).mean(axis=-1)
    cheek = np.array([0.75, -0.25, 0.61])
    skin = np.broadcast_to(np.array([0.50, 0.66, 0.18]), direction.shape)
    skin = blend(skin, (0.90, 0.82, 0.28), 0.45 - 0.55 * direction[..., 1] + 1.1 * mottle)
    skin = blend(skin, (0.80, 0.33, 0.20), 1.1 * (direction @ cheek - 0.45) + 0.8 * mottle)
    for centre in rng.normal(size=(170, 3)):
        size = rng.uniform(0.025, 0.055)
        distance = np.linalg.norm(direction - centre / np.linalg.norm(centre), axis=-1)
        skin = blend(skin, (0.42, 0.29, 0.13), 0.85 * np.clip(2.0 - 2.0 * distance / size, 0.0, 1.0))
    away = np.arccos(np.clip(np.abs(direction[..., 1]), 0.0, 1.0))
    return np.clip(blend(skin, (0.33, 0.22, 0.11), 1.3 - away / 0.22), 0.0, 1.0)
