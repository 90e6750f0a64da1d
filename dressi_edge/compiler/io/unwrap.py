"""Texture coordinates of any closed mesh: positions and faces in; charts, packed in the unit square, out.

Faces that look along one of the six axes and hang together are a chart, projected along that axis: no face is mirrored, most keep more
than a third of their area, and all have one scale. Charts are packed in rows. Where a chart lies over itself, it is cut.
"""
from __future__ import annotations

import numpy as np

from .charts import SIDES, Charts
from .needs import needed

GUTTER = 1.0 / 128.0  # around each chart, of the square's side: two texels of 256
SEEN = 0.35  # least cosine between a face and its chart's axis
SMALL = 6  # faces of a chart that is given to a neighbour, if that sees them
SMOOTHED = 4
PAIRS = 1 << 18  # of faces, looked at at once


def unwrapped(positions: np.ndarray, faces: np.ndarray) -> Charts:
    """uvs and uv_faces of a mesh. A texture should have 128 texels a side, or more."""
    a, b, c = positions[faces.T]
    across = np.cross(b - a, c - a)
    normal = across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-30)
    cosine = normal @ SIDES[:, 0].T
    pairs = _adjacent(faces)
    side = _smoothed(np.argmax(np.round(cosine, 9), axis=1), cosine, pairs)
    chart, side = _absorbed(_parts(side, pairs, len(faces)), side, cosine, pairs)
    chart = _single(positions, faces, side, chart, pairs)
    return _packed(positions, faces, side, chart)


def _adjacent(faces: np.ndarray) -> np.ndarray:
    """(n, 2) pairs of faces with a common edge."""
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    owner = np.tile(np.arange(len(faces)), 3)
    order = np.lexsort(edges.T)
    same = (edges[order][1:] == edges[order][:-1]).all(axis=1)
    return np.stack([owner[order][1:][same], owner[order][:-1][same]], axis=1)


def _smoothed(side: np.ndarray, cosine: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """Each face's side, that of most of its neighbours where it looks that way, too."""
    for _ in range(SMOOTHED):
        votes = np.zeros_like(cosine)
        for i, j in ((0, 1), (1, 0)):
            np.add.at(votes, (pairs[:, i], side[pairs[:, j]]), 1.0)
        votes[np.arange(len(side)), side] += 0.9
        side = np.argmax(np.where(cosine > SEEN, votes + 0.1 * cosine, -1.0 + cosine), axis=1)
    return side


def _parts(side: np.ndarray, pairs: np.ndarray, count: int) -> np.ndarray:
    """(count,) which part each face belongs to: faces of one side that hang together."""
    sparse, graph = needed("scipy.sparse"), needed("scipy.sparse.csgraph")
    own = pairs[side[pairs[:, 0]] == side[pairs[:, 1]]]
    matrix = sparse.coo_matrix((np.ones(len(own)), (own[:, 0], own[:, 1])), (count, count))
    return graph.connected_components(matrix, directed=False)[1]


def _absorbed(chart: np.ndarray, side: np.ndarray, cosine: np.ndarray, pairs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Charts and sides, after small charts went to the side of most neighbours, if that sees all their faces."""
    for _ in range(3):
        sizes = np.bincount(chart)
        for small in np.flatnonzero(sizes <= SMALL):
            members = np.flatnonzero(chart == small)
            beside = np.concatenate([pairs[np.isin(pairs[:, i], members), 1 - i] for i in (0, 1)])
            beside = beside[chart[beside] != small]
            sides = [s for s in np.argsort(-np.bincount(side[beside], minlength=6), kind="stable")[:2]
                     if s in side[beside] and (cosine[members, s] > 0.1).all()]
            if sides:
                side[members] = sides[0]
        chart = _parts(side, pairs, len(side))
    return chart, side


def _single(positions: np.ndarray, faces: np.ndarray, side: np.ndarray, chart: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """Charts of which none lies over itself: faces that lie over others of their chart, as samples at their middles tell, get charts of
    their own."""
    right, down = SIDES[side, 1], SIDES[side, 2]
    corners = np.stack([(positions[faces] * right[:, None]).sum(2), (positions[faces] * down[:, None]).sum(2)], axis=2)
    low, high = corners.min(axis=1), corners.max(axis=1)
    middle = corners.mean(axis=1)
    tree = needed("scipy.spatial").cKDTree(middle)
    reach = float(np.linalg.norm(high - low, axis=1).max()) if len(faces) else 0.0
    over = np.zeros(len(faces), bool)
    near = tree.query_pairs(reach, output_type="ndarray") if len(faces) > 1 else np.zeros((0, 2), int)
    near = near[chart[near[:, 0]] == chart[near[:, 1]]]
    for some in np.array_split(near, 1 + len(near) // PAIRS):
        i, j = some.T
        lies = _holds(corners[i], middle[j]) | _holds(corners[j], middle[i])
        for one, other in some[lies].tolist():
            if not over[one] and not over[other]:
                over[other] = True
    if not over.any():
        return chart
    split = np.where(over, chart + chart.max() + 1, chart)
    own = pairs[split[pairs[:, 0]] == split[pairs[:, 1]]]
    sparse, graph = needed("scipy.sparse"), needed("scipy.sparse.csgraph")
    matrix = sparse.coo_matrix((np.ones(len(own)), (own[:, 0], own[:, 1])), (len(faces), len(faces)))
    return graph.connected_components(matrix, directed=False)[1]


def _holds(triangles: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(n,) whether triangles (n, 3, 2) have points (n, 2) inside."""
    at = triangles - points[:, None]
    after = np.roll(at, -1, axis=1)
    turns = at[..., 0] * after[..., 1] - at[..., 1] * after[..., 0]
    return (turns > 0).all(axis=1) | (turns < 0).all(axis=1)


def _packed(positions: np.ndarray, faces: np.ndarray, side: np.ndarray, chart: np.ndarray) -> Charts:
    """Charts in rows, highest first, at the largest scale that fits."""
    count = int(chart.max()) + 1
    corner_chart, corner = np.repeat(chart, 3), faces.reshape(-1).astype(np.int64)
    keys, uv_faces = np.unique(corner_chart * np.int64(len(positions)) + corner, return_inverse=True)
    key_chart, key_vertex = keys // len(positions), keys % len(positions)
    side_of = np.zeros(count, int)
    side_of[chart] = side
    s = side_of[key_chart]
    plane = np.stack([(positions[key_vertex] * SIDES[s, 1]).sum(1), (positions[key_vertex] * SIDES[s, 2]).sum(1)], axis=1)
    low, high = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
    np.minimum.at(low, key_chart, plane)
    np.maximum.at(high, key_chart, plane)
    size = high - low
    upright = size[:, 1] > size[:, 0]  # a quarter turn, so that rows are low
    size = np.where(upright[:, None], size[:, ::-1], size)
    a, b = 0.0, 1.0 / max(float(size.max()), 1e-30)
    places = None
    for _ in range(40):
        scale = (a + b) / 2.0
        found = _rows(size * scale + 2.0 * GUTTER)
        a, b, places = (scale, b, (scale, found)) if found is not None else (a, scale, places)
    scale, place = places
    local = (plane - low[key_chart]) * scale
    turned = np.stack([local[:, 1], (size[key_chart, 1] * scale) - local[:, 0]], axis=1)
    local = np.where(upright[key_chart][:, None], turned, local)
    return Charts(place[key_chart] + GUTTER + local, uv_faces.reshape(-1, 3).astype(np.int32), 1.0, GUTTER)


def _rows(sizes: np.ndarray) -> np.ndarray | None:
    """Upper left corners (n, 2) of boxes (n, 2) in the unit square, in rows; None where they do not fit."""
    order = np.lexsort((np.arange(len(sizes)), -sizes[:, 1]))
    place, x, y, height = np.zeros_like(sizes), 0.0, 0.0, 0.0
    for k in order:
        w, h = sizes[k]
        if w > 1.0:
            return None
        if x + w > 1.0:
            x, y, height = 0.0, y + height, 0.0
        height = max(height, h)
        if y + height > 1.0:
            return None
        place[k] = x, y
        x += w
    return place
