"""Tangents of a textured surface: the direction in which u grows, for maps of normals.

In: positions (a table), faces, texture coordinates. Out: a table of tangents, and which of them each corner has. As in MikkTSpace corners
share one where position, texture coordinates and handedness are the same, and it is the mean of their faces' by the angle at the corner
(that of the mesh as it is given); it is not the same to the bit. Faces whose texture coordinates lie on a line have none: zero.
"""
from __future__ import annotations

import numpy as np

from ..graph.functions import constant_table, gather_sum, normalize
from ..graph.ir import Node
from .normals import corners, incidence


def handedness(uvs: np.ndarray) -> np.ndarray:
    """(F,) of texture coordinates (F, 3, 2), v down: 1 where the bitangent normal x tangent goes against v, as it does of a picture that is
    not mirrored; -1 where it is mirrored; 0 where there is no tangent."""
    a, b = uvs[:, 1] - uvs[:, 0], uvs[:, 2] - uvs[:, 0]
    area = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    size = np.sqrt((a * a).sum(1) * (b * b).sum(1))
    return np.where(np.abs(area) > 1e-9 * np.maximum(size, 1e-30), -np.sign(area), 0.0)


def tangent_table(positions: Node, mesh) -> tuple[Node, np.ndarray]:
    """vec3 table of tangents, not of length 1 where faces differ, and (F, 3) which of them each corner of the mesh's faces has."""
    faces, uvs, uv_faces = np.asarray(mesh.faces), np.asarray(mesh.uvs, float), np.asarray(mesh.uv_faces)
    at = uvs[uv_faces]
    hand = handedness(at)
    a, b = at[:, 1] - at[:, 0], at[:, 2] - at[:, 0]
    scale = -hand / np.maximum(np.maximum(np.abs(a[:, 1]), np.abs(b[:, 1])), 1e-30)  # v may hardly change: the direction counts
    p0, p1, p2 = corners(positions, faces)
    along = normalize((p1 - p0) * constant_table(b[:, 1] * scale) - (p2 - p0) * constant_table(a[:, 1] * scale))
    _, places = np.unique(uvs, axis=0, return_inverse=True)
    key = np.stack([faces, places.reshape(-1)[uv_faces], np.repeat(hand.astype(int)[:, None], 3, 1)], -1).reshape(-1, 3)
    found, index = np.unique(key, axis=0, return_inverse=True)
    index = index.reshape(-1)
    corner = np.asarray(mesh.positions, float)[faces]
    sides = np.roll(corner, -1, 1) - corner, np.roll(corner, 1, 1) - corner
    length = np.linalg.norm(sides[0], axis=2) * np.linalg.norm(sides[1], axis=2)
    angle = np.arccos(np.clip((sides[0] * sides[1]).sum(2) / np.maximum(length, 1e-30), -1, 1)).reshape(-1)
    rows, entry = incidence(index, len(found))
    return gather_sum(along, rows, entry // 3, angle[entry]), index.reshape(-1, 3)
