"""Polygons of any number of corners: one list of corner numbers in, triangles out, the same for every format.

Convex polygons become fans. Concave ones are cut ear by ear (Meisters 1975), on the plane of their Newell normal.
"""
from __future__ import annotations

import numpy as np

from ...cache.errors import InputError

MAX_CORNERS = 10_000  # of a concave polygon: cutting takes time with the square of it


def triangulated(points: np.ndarray, starts: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of polygons. points: (n, 3); starts: (P + 1,), polygon p is corners[starts[p]:starts[p + 1]], indices of points.

    Gives (T, 3) places in `corners` and (T,) the polygon of each, in the polygons' order; polygons of fewer than three have none.
    """
    sizes = np.diff(starts)
    triangles, owner = [], []
    for size in np.unique(sizes[sizes >= 3]):
        which = np.flatnonzero(sizes == size)
        places = starts[which][:, None] + np.arange(size)
        if size > 3:
            convex = _convex(points[corners[places]])
            for p, row in zip(which[~convex], places[~convex]):
                cut = row[_ears(points[corners[row]])]
                triangles.append(cut)
                owner.append(np.full(len(cut), p))
            which, places = which[convex], places[convex]
        fan = np.stack([np.broadcast_to(places[:, :1], (len(places), size - 2)), places[:, 1:-1], places[:, 2:]], axis=-1)
        triangles.append(fan.reshape(-1, 3))
        owner.append(np.repeat(which, size - 2))
    if not triangles:
        return np.zeros((0, 3), np.int64), np.zeros(0, np.int64)
    found, of = np.concatenate(triangles), np.concatenate(owner)
    order = np.argsort(of, kind="stable")
    return found[order], of[order]


def _turns(polygons: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Twice the signed area of the corner triangles (P, n), seen along the Newell normal, and that normal (P, 3)."""
    before, after = np.roll(polygons, 1, axis=1), np.roll(polygons, -1, axis=1)
    normal = np.cross(polygons - polygons[:, :1], after - polygons[:, :1]).sum(axis=1)
    return np.einsum("pnk,pk->pn", np.cross(polygons - before, after - polygons), normal), normal


def _convex(polygons: np.ndarray) -> np.ndarray:
    """Whether each of (P, n, 3) is convex (P,): it turns one way only, and once around; a polygon without area counts too."""
    with np.errstate(over="ignore", invalid="ignore"):
        turns, normal = _turns(polygons)
        size = np.abs(turns).max(axis=1, keepdims=True)
        one_way = (turns >= -1e-9 * size).all(axis=1)
        fans = np.cross(polygons[:, 1:-1] - polygons[:, :1], polygons[:, 2:] - polygons[:, :1])
        once = (np.einsum("pnk,pk->pn", fans, normal) >= -1e-9 * size).all(axis=1)
        return (one_way & once) | ~np.isfinite(size[:, 0]) | (size[:, 0] == 0.0)


def _ears(polygon: np.ndarray) -> np.ndarray:
    """Triangles (n - 2, 3) of one polygon (n, 3)."""
    n = len(polygon)
    if n > MAX_CORNERS:
        raise InputError(f"a concave face has {n} corners; at most {MAX_CORNERS} are allowed; cut it into triangles")
    _, normal = _turns(polygon[None])
    axis = int(np.argmax(np.abs(normal[0])))
    p = np.delete(polygon, axis, axis=1) * ((1.0, 1.0) if (normal[0, axis] > 0.0) == (axis != 1) else (-1.0, 1.0))
    p = (p - p.mean(axis=0)) / max(np.abs(p - p.mean(axis=0)).max(), 1e-300)
    after, before = list(range(1, n)) + [0], [n - 1] + list(range(n - 1))

    def cross(a: int, b: int, c: np.ndarray | int) -> np.ndarray:
        return (p[b, 0] - p[a, 0]) * (p[c, 1] - p[a, 1]) - (p[b, 1] - p[a, 1]) * (p[c, 0] - p[a, 0])

    alive = np.ones(n, bool)
    reflex = np.array([cross(before[i], i, after[i]) <= 0.0 for i in range(n)])
    out, i, waited = [], 0, 0
    while n - len(out) > 3:
        a, c = before[i], after[i]
        area = cross(a, i, c)
        ear = area > 1e-14
        if ear:
            inside = np.flatnonzero(alive & reflex)
            q = p[inside]
            touches = (q == p[a]).all(1) | (q == p[i]).all(1) | (q == p[c]).all(1)  # bridges to holes pass a point twice
            inside, low = inside[~touches], 0.0 if waited <= n else 1e-12  # points on the cut are let through when nothing else is left
            ear = not ((cross(a, i, inside) >= low) & (cross(i, c, inside) >= low) & (cross(c, a, inside) >= low)).any()
        if ear or waited > 2 * n and area >= 0.0 or waited > 3 * n:  # a polygon that crosses itself has no ear: any cut then
            out.append((a, i, c))
            alive[i], after[a], before[c] = False, c, a
            for k in (a, c):
                reflex[k] = cross(before[k], k, after[k]) <= 0.0
            i, waited = a, 0
        else:
            i, waited = c, waited + 1
    i = int(np.flatnonzero(alive)[0])
    return np.array([*out, (i, after[i], after[after[i]])])
