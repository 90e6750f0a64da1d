"""UV charts for sphere-like meshes: directions and faces in; a 3 x 2 atlas of cube sides out.

Each face belongs to the cube side that its centroid looks at and is projected from the origin onto that side (gnomonic), so
inside one side straight edges stay straight and no two faces of a star-shaped mesh overlap. Faces that stick out of their
side would leave the cell; `reach` is how far they stick out, and the whole side is shrunk by it so that they do not.
uv is as everywhere here: u to the right, v down, texel (row 0, column 0) at the corner (0, 0).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...cache.errors import InputError

COLUMNS, ROWS = 3, 2
MAX_REACH = 4.0  # tan 76 degrees: faces beyond it are too large for one cube side

# Per side: outwards, right, down. Seen from outside no side is mirrored: right x down = -outwards.
SIDES = np.array([
    [[1, 0, 0], [0, 0, -1], [0, -1, 0]],
    [[-1, 0, 0], [0, 0, 1], [0, -1, 0]],
    [[0, 1, 0], [1, 0, 0], [0, 0, 1]],
    [[0, -1, 0], [1, 0, 0], [0, 0, -1]],
    [[0, 0, 1], [1, 0, 0], [0, -1, 0]],
    [[0, 0, -1], [-1, 0, 0], [0, -1, 0]],
], dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Charts:
    """uvs (T, 2) in [0, 1]; uv_faces (F, 3) int32; `reach` >= 1, half the width of a cell in units of half a cube side;
    `gutter`, the empty border of a cell as a fraction of the cell."""

    uvs: np.ndarray
    uv_faces: np.ndarray
    reach: float
    gutter: float


def cube_charts(directions: np.ndarray, faces: np.ndarray, gutter: float = 1.0 / 64.0) -> Charts:
    """Charts of a mesh around the origin. directions: (V, 3), any length but 0; faces: (F, 3).

    The gutter is there for bilinear sampling: it must be half a texel or more, so with the default a cell of 32 texels or more.
    Raises InputError where a face is too large for one cube side.
    """
    outwards, right, down = SIDES[:, 0], SIDES[:, 1], SIDES[:, 2]
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    # Rounded, so that a centroid on the border of two sides goes to the first of them on every machine.
    side = np.argmax(np.round(unit[faces].sum(axis=1) @ outwards.T, 9), axis=1)
    corner_side = np.repeat(side, 3)
    keys, uv_index = np.unique(corner_side * len(unit) + faces.reshape(-1), return_inverse=True)
    key_side, key_unit = keys // len(unit), unit[keys % len(unit)]
    depth = np.einsum("ij,ij->i", key_unit, outwards[key_side])
    u = np.einsum("ij,ij->i", key_unit, right[key_side])
    v = np.einsum("ij,ij->i", key_unit, down[key_side])
    too_far = np.maximum(np.abs(u), np.abs(v)) > MAX_REACH * depth
    if too_far.any():
        bad = int(np.flatnonzero(too_far[uv_index])[0]) // 3
        raise InputError(f"cube-map charts: face {bad} sticks out of its cube side by more than {MAX_REACH:g} half sides; "
                         "subdivide the mesh, or give it uvs of its own")
    plane = np.stack([u / depth, v / depth], axis=1)
    reach = max(1.0, float(np.abs(plane).max()))
    in_cell = 0.5 + plane * (0.5 - gutter) / reach
    cell = np.stack([key_side % COLUMNS, key_side // COLUMNS], axis=1)
    uvs = (cell + in_cell) / (COLUMNS, ROWS)
    return Charts(uvs, uv_index.reshape(-1, 3).astype(np.int32), reach, gutter)


def texel_directions(height: int, width: int, reach: float, gutter: float = 1.0 / 64.0) -> np.ndarray:
    """The unit direction (height, width, 3) that each texel centre of an atlas with this reach and gutter stands for.

    Every texel has one, also those that no face covers, so a texture painted with them has no seam and no empty border.
    """
    u = (np.arange(width) + 0.5) / width * COLUMNS
    v = (np.arange(height) + 0.5) / height * ROWS
    column, row = np.floor(u).astype(int), np.floor(v).astype(int)
    side = SIDES[row[:, None] * COLUMNS + column[None, :]]
    a = (u - column - 0.5) * reach / (0.5 - gutter)
    b = (v - row - 0.5) * reach / (0.5 - gutter)
    direction = side[..., 0, :] + a[None, :, None] * side[..., 1, :] + b[:, None, None] * side[..., 2, :]
    return direction / np.linalg.norm(direction, axis=-1, keepdims=True)
