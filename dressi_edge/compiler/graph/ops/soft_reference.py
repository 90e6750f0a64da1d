"""The soft ops in NumPy float64: every pair of a pixel and a face that is near it. Meaning as in `soft.py`."""
from __future__ import annotations

from typing import NamedTuple

import numpy as np

EDGES = ((0, 1), (1, 2), (0, 2))
DEGENERATE = 1e-6
TINY = 1e-30
LEAST = 1e-10  # of the background's weight, and the normalized depth from which on that falls (PyTorch3D's eps)


class Pairs(NamedTuple):
    """n pairs, those of a face together, faces ascending. face, ys, xs (n,); corners (n, 3, 4); probability and its complement, depth
    (n,), weights of the corners (n, 3), and what the gradient needs."""

    face: np.ndarray
    ys: np.ndarray
    xs: np.ndarray
    corners: np.ndarray
    probability: np.ndarray
    clear: np.ndarray
    depth: np.ndarray
    weights: np.ndarray
    a: np.ndarray  # (n, 3, 2) corners relative to the pixel
    facing: np.ndarray  # 1 or -1
    area: np.ndarray  # (n, 3) signed by facing
    total: np.ndarray  # of what the weights are normalized by; 0 where they are a third each
    held: np.ndarray  # depth is the near plane's
    edge: np.ndarray  # nearest
    sign: np.ndarray  # of the distance: 1 inside
    step: np.ndarray  # (n, 2) d distance (or its square) / d foot, over sigma
    along: np.ndarray  # where on the edge the foot is


def _cross(a, b):
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _front(iw):
    return (iw > 0) & (iw <= 1)


def _cut(va, vb):
    """Where the edge from a to b meets the near plane: 1 / w is linear on screen, and 1 there in units of 1 / near."""
    den = vb[..., 2] - va[..., 2]
    return (1 - va[..., 2]) / np.where(den == 0, 1, den)


def clipped(va, vb):
    """Screen ends of edges (..., 4) each, and whether there is anything of them."""
    fa, fb = _front(va[..., 2]), _front(vb[..., 2])
    cut = va[..., :2] + (vb[..., :2] - va[..., :2]) * np.where(fa != fb, _cut(va, vb), 0)[..., None]
    return np.where(fa[..., None], va[..., :2], cut), np.where(fb[..., None], vb[..., :2], cut), fa | fb


SMALL = 4  # pixels across and down of the boxes whose pixels are looked at


def soft_boxes(v0, v1, v2, reach, tight, face_count, cell_w, cell_h, columns):
    """The pixels whose centres are near each face; empty where it is wholly behind."""
    v = np.stack([x.reshape(-1, 4) for x in (v0, v1, v2)], 1)
    lo, hi = np.full((len(v), 2), 1e9), np.full((len(v), 2), -1e9)
    for i, j in EDGES:
        a, b, there = clipped(v[:, i], v[:, j])
        lo = np.where(there[:, None], np.minimum(lo, np.minimum(a, b)), lo)
        hi = np.where(there[:, None], np.maximum(hi, np.maximum(a, b)), hi)
    cell = np.array([cell_w, cell_h])
    view = np.arange(len(v)) // face_count
    corner = np.stack([view % columns * cell_w, view // columns * cell_h], 1)
    first = np.clip(lo + cell / 2 - (reach - 0.5), 0, cell).astype(int)
    last = np.clip(hi + cell / 2 + (reach + 0.5), 0, cell).astype(int)
    if tight:
        _tighten(v, first, last, cell, reach)
    there = (lo[:, :1] <= hi[:, :1]) & (first < last).all(1, keepdims=True)
    return np.where(there, np.concatenate([first + corner, last + corner], 1), 0).reshape(*v0.shape[:2], 4)


def _tighten(v, first, last, cell, reach) -> None:
    """Shrinks small boxes, in place, to the pixels that are nowhere more than `reach` on the outer side of an edge."""
    small = np.flatnonzero(_front(v[..., 2]).all(1) & (last > first).all(1) & (last - first <= SMALL).all(1))
    v, low, high = v[small, :, :2], last[small].copy(), first[small].copy()
    e = np.roll(v, -1, 1) - v
    facing = np.where(_cross(e[:, 0], e[:, 1]) < 0, -1.0, 1.0)[:, None]
    for y in range(SMALL):
        for x in range(SMALL):
            p = first[small] + (x, y)
            q = p + 0.5 - cell / 2
            side = facing * _cross(e, q[:, None] - v) + reach * np.linalg.norm(e, axis=-1)
            inside = ((side >= 0).all(1) & (p < last[small]).all(1))[:, None]
            low, high = np.where(inside, np.minimum(low, p), low), np.where(inside, np.maximum(high, p + 1), high)
    first[small], last[small] = low, high


def _distance(a, b):
    """(n, 2) each, relative to the pixel: squared distance of the origin to the segment, where on it the foot is, the foot."""
    d = b - a
    t = np.clip(-(a * d).sum(-1) / np.maximum((d * d).sum(-1), 1e-20), 0, 1)
    foot = a + t[..., None] * d
    return (foot * foot).sum(-1), t, foot


def near_pairs(v0, v1, v2, boxes, cell_w, cell_h, columns, face_count, radius, sigma, squared, hard_only, nearest, low=0, high=1 << 30,
               **_) -> Pairs:
    """All pairs of a pixel and a face in whose box it is and that is no more than `radius` away, in rows low to high of cells."""
    v, boxes = np.stack([x.reshape(-1, 4) for x in (v0, v1, v2)], 1), boxes.reshape(-1, 4)
    wide = boxes[:, 2:] - boxes[:, :2]
    face = np.repeat(np.arange(len(boxes)), wide.prod(1))
    k = np.arange(len(face)) - np.repeat(np.cumsum(wide.prod(1)) - wide.prod(1), wide.prod(1))
    ys, xs = boxes[face, 1] + k // np.maximum(wide[face, 0], 1), boxes[face, 0] + k % np.maximum(wide[face, 0], 1)
    view = face // face_count
    q = np.stack([xs - view % columns * cell_w + 0.5 - cell_w / 2, ys - view // columns * cell_h + 0.5 - cell_h / 2], 1)
    found, near = _pairs(face, ys, xs, v[face], q, radius, sigma, squared, hard_only, nearest)
    near &= (ys % cell_h >= low) & (ys % cell_h < high)
    return Pairs(*(x[near] for x in found))


def all_pairs(v0, v1, v2, radius, sigma, squared, hard_only, nearest) -> Pairs:
    """The pair of each face with the place (0, 0); of those that are further than `radius` the probability is 0."""
    v = np.stack([x.reshape(-1, 4) for x in (v0, v1, v2)], 1)
    n = np.arange(len(v))
    found, near = _pairs(n, n, n, v, np.zeros((len(v), 2)), radius, sigma, squared, hard_only, nearest)
    return found._replace(probability=np.where(near, found.probability, 0), clear=np.where(near, found.clear, 1))


def _pairs(face, ys, xs, v, q, radius, sigma, squared, hard_only, nearest) -> tuple[Pairs, np.ndarray]:
    """The pairs of faces with corners v (n, 3, 4) and places q (n, 2), and which of them are near."""
    a, iw = v[..., :2] - q[:, None], v[..., 2]
    c = np.stack([_cross(a[:, 1], a[:, 2]), _cross(a[:, 2], a[:, 0]), _cross(a[:, 0], a[:, 1])], 1)
    whole = c.sum(1)
    facing = np.where(whole < 0, -1.0, 1.0)
    area = c * facing[:, None]
    m = area * iw
    hard = (m >= 0).all(1) & (whole != 0) & (np.abs(whole) >= m.sum(1))
    rows = []
    for i, j in EDGES:
        p, r, there = clipped(v[:, i], v[:, j])
        d2, t, foot = _distance(p - q, r - q)
        rows.append((np.where(there, d2, np.inf), t, foot, r - p))
    d2 = np.stack([x[0] for x in rows], 1)
    edge = d2.argmin(1)
    pick = np.arange(len(edge)), edge
    d2, t = d2[pick], np.stack([x[1] for x in rows], 1)[pick]
    foot, along = np.stack([x[2] for x in rows], 1)[pick], np.stack([x[3] for x in rows], 1)[pick]
    d = np.sqrt(d2)
    near = hard if hard_only else hard | (d <= radius)
    sign = np.where(hard, 1.0, -1.0)
    s = sign * (d2 if squared else d) / sigma
    e = np.exp(-np.abs(s))
    big, small = 1 / (1 + e), e / (1 + e)
    probability, clear = np.where(s < 0, small, big), np.where(s < 0, big, small)
    normal = np.stack([along[:, 1], -along[:, 0]], 1) * np.sign((foot * np.stack([along[:, 1], -along[:, 0]], 1)).sum(1))[:, None]
    between = (t > 0) & (t < 1)
    length = np.where(between, np.linalg.norm(along, axis=1), d)
    unit = np.where(between[:, None], normal, foot) / np.maximum(length, 1e-20)[:, None]
    step = (2 * foot if squared else unit) / sigma
    if hard_only:
        probability, clear, step = np.ones_like(s), np.zeros_like(s), np.zeros_like(step)
    m = np.maximum(m, 0)
    solid = (np.abs(whole) > (a * a).sum(-1).max(1) * DEGENERATE) & (m.sum(1) > 0)
    total = np.where(solid, m.sum(1), 0)
    weights = np.where(solid[:, None], m / np.where(solid, total, 1)[:, None], 1 / 3)
    depth = (weights * v[..., 3]).sum(1)
    held = depth > nearest
    parts = (face, ys, xs, v, probability, clear, np.minimum(depth, nearest), weights, a, facing, area, total, held, edge, sign, step, t)
    return Pairs(*parts), near


def _of_part(p: Pairs, ranges, faces, each, views, tiles_x, tiles_y, tile_w, tile_h, cell_w, cell_h, columns, **_) -> Pairs:
    """Those pairs whose entries are among the first `each` of the lists of their tiles."""
    if each >= faces.size:
        return p
    view = p.ys // cell_h * columns + p.xs // cell_w
    tile = (view * tiles_y + p.ys % cell_h // tile_h) * tiles_x + p.xs % cell_w // tile_w
    keep, flat, spans = np.zeros(len(p.face), bool), faces.reshape(-1), ranges.reshape(-1, 2)
    for t in np.unique(tile):
        own, (begin, end) = tile == t, spans[t]
        keep[own] = np.isin(p.face[own], flat[begin:min(begin + each, end)])
    return Pairs(*(x[keep] for x in p))


def at_units(p: Pairs, ranges, faces, units, slots, each, tiles_x, tiles_y, tile_w, tile_h, cell_w, cell_h, columns, **_) -> Pairs:
    """Pairs of pixels of units' tiles and the entries of these parts of their lists, units being (tile, part); in the place of a pixel's
    row and column 0 and its number among those of all units."""
    view = p.ys // cell_h * columns + p.xs // cell_w
    y, x = p.ys % cell_h, p.xs % cell_w
    tile, k = (view * tiles_y + y // tile_h) * tiles_x + x // tile_w, y % tile_h * tile_w + x % tile_w
    found, flat, spans = [], faces.reshape(-1), ranges.reshape(-1, 2)
    for unit, (t, part) in enumerate(units.reshape(-1, 2)[:slots]):
        begin = spans[t, 0] + part * each
        own = (tile == t) & np.isin(p.face, flat[begin:min(begin + each, spans[t, 1])])
        found.append(Pairs(*(x[own] for x in p._replace(ys=p.ys * 0, xs=unit * tile_w * tile_h + k))))
    return Pairs(*(np.concatenate(x) for x in zip(*found)))


def alpha_of(p: Pairs, shape, **_):
    """1 - prod(1 - D) of pairs at pixels of an image of this shape."""
    clear = np.ones(shape)
    np.multiply.at(clear, (p.ys, p.xs), p.clear)
    return (1 - clear)[..., None]


def soft_alpha(v0, v1, v2, boxes, ranges, faces, masks, spilled, extent, **attrs):
    """1 - prod(1 - D)."""
    return alpha_of(_of_part(near_pairs(v0, v1, v2, boxes, **attrs), ranges, faces, **attrs), (extent.height, extent.width))


def _weights(p: Pairs, shape, gamma, base):
    most = np.full(shape, LEAST - base)
    np.maximum.at(most, (p.ys, p.xs), p.depth)
    return most, p.probability * np.exp((p.depth - most[p.ys, p.xs]) / gamma)


def _colors(p: Pairs, *tables):
    return np.stack([c.reshape(-1, 3)[p.face] for c in tables], 1)


def sums_of(p: Pairs, shape, c0, c1, c2, gamma, base, **_):
    """Sums of weighted colours and of weights, as `alpha_of`."""
    _, w = _weights(p, shape, gamma, base)
    out = np.zeros((*shape, 4))
    seen = (p.weights[..., None] * _colors(p, c0, c1, c2)).sum(1)
    np.add.at(out, (p.ys, p.xs), w[:, None] * np.concatenate([seen, np.ones((len(w), 1))], 1))
    return out


def soft_sums(v0, v1, v2, c0, c1, c2, boxes, ranges, faces, masks, spilled, extent, **attrs):
    """Sums of weighted colours and of weights."""
    p = _of_part(near_pairs(v0, v1, v2, boxes, **attrs), ranges, faces, **attrs)
    return sums_of(p, (extent.height, extent.width), c0, c1, c2, **attrs)


def most_of(p: Pairs, shape, c0, c1, c2, gamma, base, **_):
    """The largest depth, and alpha, as `alpha_of`."""
    some = np.zeros(shape, bool)
    some[p.ys, p.xs] = True
    most, _ = _weights(p, shape, gamma, base)
    return np.concatenate([np.where(some, most, 0)[..., None], alpha_of(p, shape)], 2)


def soft_most(v0, v1, v2, c0, c1, c2, boxes, ranges, faces, masks, spilled, extent, **attrs):
    """The largest depth (0 where there is no face), and alpha."""
    p = _of_part(near_pairs(v0, v1, v2, boxes, **attrs), ranges, faces, **attrs)
    return most_of(p, (extent.height, extent.width), c0, c1, c2, **attrs)


def corner_gradient(p: Pairs, gs, gw):
    """(n, 3, 4) by the corners: gs by what the sigmoid is of, gw (n, 3) by the weights of the corners, depth's own part left out."""
    out = np.zeros_like(p.corners)
    solid = p.total > 0
    gm = (gw - (gw * p.weights).sum(1, keepdims=True)) / np.where(solid, p.total, 1)[:, None]
    gm = np.where(solid[:, None] & (p.weights > 0), gm, 0)
    out[..., 2] += gm * p.area
    gc = gm * p.corners[..., 2] * p.facing[:, None]
    for k, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):
        out[:, i, :2] += gc[:, k, None] * np.stack([p.a[:, j, 1], -p.a[:, j, 0]], 1)
        out[:, j, :2] += gc[:, k, None] * np.stack([-p.a[:, i, 1], p.a[:, i, 0]], 1)
    gfoot = (gs * p.sign)[:, None] * p.step
    n = np.arange(len(gs))
    i, j = np.array(EDGES)[p.edge].T
    va, vb = p.corners[n, i], p.corners[n, j]
    ga, gb = (1 - p.along)[:, None] * gfoot, p.along[:, None] * gfoot
    fa, fb = _front(va[:, 2]), _front(vb[:, 2])
    lost = np.where(fa[:, None], 0, ga) + np.where(fb[:, None], 0, gb)  # by the cut
    t = np.where(fa != fb, _cut(va, vb), 0)
    den = np.where(fa != fb, vb[:, 2] - va[:, 2], 1)
    gt = (lost * (vb[:, :2] - va[:, :2])).sum(1)
    ga, gb = np.where(fa[:, None], ga, 0) + lost * (1 - t)[:, None], np.where(fb[:, None], gb, 0) + lost * t[:, None]
    out[n, i, :2] += ga
    out[n, j, :2] += gb
    out[n, i, 2] += gt * (1 - vb[:, 2]) / den ** 2
    out[n, j, 2] -= gt * (1 - va[:, 2]) / den ** 2
    return out


def _by_face(p: Pairs, values, like, band):
    height, width = like.shape[0] + band, like.shape[1]
    out = np.zeros((height * width, values.shape[1]))
    np.add.at(out, p.face, values)
    return out.reshape(height, width, -1)


def soft_blend(sums, most, background, *_, gamma, base, over, **attrs):
    """The blend of equation (1) or (2), and alpha."""
    weight = sums[..., 3:]
    if over:
        mean = np.where(weight > TINY, sums[..., :3] / np.maximum(weight, TINY), 0)
        return np.concatenate([mean * most[..., 1:] + background * (1 - most[..., 1:]), most[..., 1:]], 2)
    far = np.where(weight > 0, np.maximum(np.exp(np.minimum((LEAST - base - most[..., :1]) / gamma, 0)), LEAST), 1)
    return np.concatenate([(sums[..., :3] + far * background) / (weight + far), most[..., 1:]], 2)


def soft_alpha_gradient(v0, v1, v2, boxes, slope, corner, band, **attrs):
    """By one corner. slope: the gradient by alpha times what is clear."""
    p = near_pairs(v0, v1, v2, boxes, **attrs)
    g = corner_gradient(p, slope[p.ys, p.xs, 0] * p.probability, np.zeros((len(p.face), 3)))
    return _by_face(p, g[:, corner], v0, band)


def _of_pixel(p: Pairs, slope, most, gamma):
    """Of each pair: the slopes of its pixel, and the pair's weight there."""
    most = most[p.ys, p.xs]
    return slope[p.ys, p.xs], most[:, 1], p.probability * np.exp(np.minimum((p.depth - most[:, 0]) / gamma, 0))


def soft_place_gradient(v0, v1, v2, c0, c1, c2, boxes, slope, most, corner, gamma, band, **attrs):
    """By the place of one corner."""
    p = near_pairs(v0, v1, v2, boxes, **attrs)
    slope, by_clear, w = _of_pixel(p, slope, most, gamma)
    gw = (slope[:, None, :3] * _colors(p, c0, c1, c2)).sum(-1)
    by_weight = (gw * p.weights).sum(1) + slope[:, 3]
    gz = np.where(p.held, 0, by_weight * w / gamma)
    g = corner_gradient(p, by_weight * w * p.clear + by_clear * p.probability, gw * w[:, None] + gz[:, None] * p.corners[..., 3])
    g[..., 3] = gz[:, None] * p.weights
    return _by_face(p, g[:, corner], v0, band)


def soft_color_gradient(v0, v1, v2, c0, c1, c2, boxes, slope, most, corner, gamma, band, **attrs):
    """By the colour of one corner."""
    p = near_pairs(v0, v1, v2, boxes, **attrs)
    slope, _, w = _of_pixel(p, slope, most, gamma)
    return _by_face(p, slope[:, :3] * (w * p.weights[:, corner])[:, None], c0, band)
