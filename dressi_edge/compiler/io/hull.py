"""A mesh to start from: the visual hull of the views' masks, evenly meshed and charted for a texture. `Views` in; a `Mesh` out."""
from __future__ import annotations

import numpy as np

from ...cache.errors import InputError, note
from .carve import bounds, depth, grid, rims, uncovered
from .mesh import Mesh
from .needs import needed
from .remesh import evened
from .unwrap import unwrapped
from .views import Views

FINER = 6.0  # vertices of the carved surface for each that is asked for
MOST = 320  # cells a side
SHARE = 0.02  # of the surface, what a part must have to stay
COARSE = 64  # cells a side where handles are counted
AGREE = 1e-3  # of the masks' pixels, what may be missing from the hull of masks that agree
MOST_MISSES = 3


def visual_hull(views: Views, vertices: int = 2562, misses: int = 0) -> Mesh:
    """The hull of the masks of two views or more, as a closed mesh of about `vertices` vertices with uvs. Small loose parts are left out,
    which a note says. misses: what so many masks lack, all others having it, is not carved away. Raises InputError where the masks bound
    nothing, there are not two more of them than `misses`, or the libraries of the extra `hull` are not installed."""
    of = rims(views)
    if not 0 <= misses <= len(of) - 2:
        raise InputError(f"misses is {misses}, of {len(of)} masks; 0 to {len(of) - 2} is allowed")
    low, high = bounds(of, misses)
    coarse = float((high - low).max()) / 48
    positions, faces = _surface(of, low, high, coarse, misses)
    a, b, c = positions[faces.T]
    area = float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()) / 2.0
    step = max(np.sqrt(1.5 * area / (FINER * vertices)), float((high - low).max()) / MOST)
    positions, faces = _largest(*_surface(of, low, high, step, misses))
    if len(positions) > vertices:
        positions, faces = evened(positions, faces, vertices)
    charts = unwrapped(positions, faces)
    return Mesh(positions, faces, charts.uvs, charts.uv_faces)


def misses_of(views: Views) -> int:
    """How many masks may lack what all others have (`visual_hull`): 0 where the masks agree, up to 3 and an eighth of them where not: the
    fewest of those that leave the fewest handles, and then such that the hull lacks nothing of what masks show. What one mask lacks becomes
    a handle or a dent, which goes when one may lack it; a hole of the object is seen through from more sides, and stays. Raises InputError
    as `visual_hull`."""
    of = rims(views)

    def handles(misses: int) -> int:
        low, high = bounds(of, misses)
        return sum(genus_of(_largest(*_surface(of, low, high, float((high - low).max()) / COARSE, misses), told=False)[1]))

    found = handles(0)  # also tells whether there is a hull at all
    if uncovered(of) <= AGREE:
        return 0
    scores = [(found, True), *((handles(k), uncovered(of, k) > AGREE) for k in range(1, min(MOST_MISSES, len(of) // 8) + 1))]
    return scores.index(min(scores))


def _surface(of, low: np.ndarray, high: np.ndarray, step: float, misses: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions and faces, outwards, of where the depth is 0."""
    measure = needed("skimage.measure")
    points, counts = grid(low - step, high + step, step)
    field = np.clip(depth(of, points, -2.0 * step, misses), -2.0 * step, 2.0 * step).reshape(counts)
    for axis in range(3):  # closed at the box, whatever lies there
        field[(slice(None),) * axis + ([0, -1],)] = -2.0 * step
    if not (field > 0.0).any():
        raise InputError("nothing is left when all masks are carved: the object is thinner than a pixel, or cameras and masks do not "
                         "belong together")
    positions, faces, _, _ = measure.marching_cubes(field, 0.0, spacing=(step,) * 3, gradient_direction="ascent", allow_degenerate=False)
    positions, faces = positions.astype(np.float64) + (low - step), np.asarray(faces, np.int32)
    a, b, c = positions[faces.T] - positions.mean(axis=0)
    if (np.cross(a, b) * c).sum() < 0.0:
        faces = faces[:, ::-1].copy()
    return positions, faces


def _largest(positions: np.ndarray, faces: np.ndarray, told: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """Without parts that are small beside the whole, which a note says if it is to be `told`."""
    sparse, graph = needed("scipy.sparse"), needed("scipy.sparse.csgraph")
    n = len(positions)
    links = sparse.coo_matrix((np.ones(2 * len(faces)), (faces[:, [0, 1]].ravel(), faces[:, [1, 2]].ravel())), (n, n))
    part = graph.connected_components(links, directed=False)[1][faces[:, 0]]
    sizes = np.bincount(part)
    keep = sizes >= SHARE * len(faces)
    if told and (lost := np.count_nonzero((sizes > 0) & ~keep)):
        note(f"the hull of the masks has {lost} small loose part{'s' if lost > 1 else ''}, which {'are' if lost > 1 else 'is'} left out")
    used, numbered = np.unique(faces[keep[part]], return_inverse=True)
    return positions[used], numbered.reshape(-1, 3).astype(np.int32)


def genus_of(faces: np.ndarray) -> list[int]:
    """Of each part of a closed mesh, how many handles it has: Euler's V - E + F = 2 - 2 genus."""
    sparse, graph = needed("scipy.sparse"), needed("scipy.sparse.csgraph")
    n = int(faces.max()) + 1
    links = sparse.coo_matrix((np.ones(2 * len(faces)), (faces[:, [0, 1]].ravel(), faces[:, [1, 2]].ravel())), (n, n))
    part = graph.connected_components(links, directed=False)[1]
    return [1 - (len(np.unique(f)) - len(f) * 3 // 2 + len(f)) // 2
            for f in (faces[part[faces[:, 0]] == k] for k in np.unique(part[faces]))]
