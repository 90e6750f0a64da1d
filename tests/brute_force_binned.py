"""Every face that is near a pixel, in float64 NumPy, one after the other over all pixels: the oracle of `Binned`, and its sequential twin.

The published formulas (Liu et al. 2019; PyTorch3D's `softmax_rgb_blend`) as docs/conventions.md has them ("Every face"), from clip
coordinates, in two loops: the largest depth, then the sums. Nothing here is shared with the renderer.
"""

from typing import NamedTuple

import numpy as np
from brute_force import EDGES, cover, edge_functions, edge_segment, pixel_centres, segment_distance

EPS = 1e-10
DEGENERATE = 1e-6


class Blended(NamedTuple):
    """color (h, w, 3), alpha (h, w); margin (h, w): pixels to the next jump, of the range r or of a near cut."""

    color: np.ndarray
    alpha: np.ndarray
    margin: np.ndarray


class Face(NamedTuple):
    """Over all pixels: whether it counts, its probability, and 1 - that, depth and the weights of its corners."""

    counts: np.ndarray
    probability: np.ndarray
    clear: np.ndarray
    depth: np.ndarray
    weights: np.ndarray
    margin: np.ndarray


def face_at(clip, corners, pixels, size, near, r, sigma, depth, squared, hard) -> Face:
    """One face of clip corners (3, 4)."""
    inside, _ = cover(corners, pixels, size, near)
    inside &= np.linalg.det(corners[:, [0, 1, 3]]) != 0
    d, cut = np.full(pixels.shape[:2], np.inf), np.full(pixels.shape[:2], np.inf)
    ends = []
    for i, j in EDGES:
        start, stop, exists = edge_segment(corners[i], corners[j], near, size)
        if exists:
            d = np.minimum(d, segment_distance(pixels, start, stop)[0])
            behind = corners[[i, j], 3] < near
            ends += [start] * int(behind[0]) + [stop] * int(behind[1])
    if ends:
        cut = segment_distance(pixels, *ends)[0]
    x = np.where(inside, 1, -1) * (d * d if squared else d) / sigma
    e = np.exp(-np.abs(x))
    counts = inside if hard else inside | (d <= r)
    probability, clear = np.where(x < 0, e, 1) / (1 + e), np.where(x < 0, 1, e) / (1 + e)
    if hard:
        probability, clear = np.ones_like(x), np.zeros_like(x)
    m = edge_functions(corners, pixels, size) * np.sign(np.linalg.det(corners[:, [0, 1, 3]]))
    m = np.maximum(m, 0)
    total = m.sum(-1, keepdims=True)
    weights = np.where(total > 0, m / np.where(total > 0, total, 1), 1 / 3)
    low, high = depth
    z = (high - weights @ corners[:, 3]) / (high - low)
    z = np.minimum(z, (high - near) / (high - low))
    jump = cut if hard else np.minimum(np.where(inside, np.inf, np.abs(d - r)), cut)
    return Face(counts, probability, clear, z, weights, np.minimum(jump, d) if hard else jump)


def render(clip, faces, size, near, r, sigma, gamma, depth, colors=None, background=(0, 0, 0), squared=False, over=False,
           hard=False) -> Blended:
    """clip (V, 4), faces (F, 3), colors (V, 3) of vertices or (F, 3, 3) of the corners of faces, or what gives (h, w, 3) of the number of a
    face and the weights of its corners (h, w, 3)."""
    clip, pixels = np.asarray(clip, np.float64), pixel_centres(size)
    faces = np.asarray(faces)
    if not callable(colors):
        values = np.zeros((len(clip), 3)) if colors is None else np.asarray(colors)
        corner_colors = values[faces] if values.ndim == 2 else values

        def colors(k, weights):
            return weights @ corner_colors[k]

    seen = [(face_at(clip, clip[f], pixels, size, near, r, sigma, depth, squared, hard), k) for k, f in enumerate(faces)
            if (clip[f, 3] >= near).any()]
    shape = size[1], size[0]
    margin, most, clear = np.full(shape, np.inf), np.full(shape, EPS), np.ones(shape)
    for face, _ in seen:
        margin = np.minimum(margin, face.margin)
        most = np.where(face.counts, np.maximum(most, face.depth), most)
        clear = np.where(face.counts, clear * face.clear, clear)
    weight, mixed = np.zeros(shape), np.zeros((*shape, 3))
    for face, k in seen:
        w = np.where(face.counts, face.probability * np.exp(np.minimum(face.depth - most, 0) / gamma), 0)
        weight, mixed = weight + w, mixed + w[..., None] * colors(k, face.weights)
    background = np.broadcast_to(np.asarray(background, float), (*shape, 3))
    if over:
        mean = mixed / np.maximum(weight, 1e-30)[..., None]
        color = mean * (1 - clear)[..., None] + background * clear[..., None]
    else:
        far = np.maximum(np.exp((EPS - most) / gamma), EPS)[..., None]
        color = (mixed + far * background) / (weight[..., None] + far)
    return Blended(color, 1 - clear, margin)


def pytorch3d(points, z, faces, size, sigma, gamma, blur_radius, colors, background, znear, zfar, layers):
    """`rasterize_meshes` with `perspective_correct` and `clip_barycentric_coords`, then `softmax_rgb_blend`: from screen points (V, 2) in
    PyTorch3D's NDC, x to the left and y up, half the shorter side being 1, distances z (V,), by sorting `layers` faces of each pixel. Color
    (h, w, 4)."""
    width, height = size
    unit = min(size) / 2
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    p = np.stack([(width / 2 - x) / unit, (height / 2 - y) / unit], -1)
    rows = []
    for f in np.asarray(faces):
        a, b, c = points[f]

        def edge(s, t):
            return (p[..., 0] - s[0]) * (t[1] - s[1]) - (p[..., 1] - s[1]) * (t[0] - s[0])  # noqa: B023

        area = (c[0] - a[0]) * (b[1] - a[1]) - (c[1] - a[1]) * (b[0] - a[0])
        flat = np.stack([edge(b, c), edge(c, a), edge(a, b)], -1) / area
        top = flat * np.array([z[f][1] * z[f][2], z[f][0] * z[f][2], z[f][0] * z[f][1]])
        bary = top / np.maximum(top.sum(-1, keepdims=True), 1e-8)
        clipped = np.maximum(bary, 0)
        clipped = clipped / np.maximum(clipped.sum(-1, keepdims=True), 1e-5)
        inside = (bary > 0).all(-1)
        squares = []
        for s, t in ((a, b), (b, c), (c, a)):
            k = np.clip(((p - s) @ (t - s)) / ((t - s) @ (t - s)), 0, 1)[..., None]
            squares.append(((s + k * (t - s) - p) ** 2).sum(-1))
        dist = np.min(squares, 0)
        rows.append((np.where(inside | (dist < blur_radius), clipped @ z[f], np.inf), np.where(inside, -dist, dist), clipped @ colors[f]))
    zbuf, dists, seen = (np.stack([row[k] for row in rows]) for k in range(3))
    order = zbuf.argsort(0)[:layers]
    zbuf, dists = np.take_along_axis(zbuf, order, 0), np.take_along_axis(dists, order, 0)
    seen = np.take_along_axis(seen, order[..., None], 0)
    mask = np.isfinite(zbuf)
    prob = np.where(mask, 1 / (1 + np.exp(np.clip(dists / sigma, -700, 700))), 0)
    alpha = np.prod(1 - prob, 0)
    zinv = np.where(mask, (zfar - np.where(mask, zbuf, 0)) / (zfar - znear), 0)
    most = np.maximum(zinv.max(0), 1e-10)
    num = prob * np.exp((zinv - most) / gamma)
    delta = np.maximum(np.exp((1e-10 - most) / gamma), 1e-10)
    rgb = ((num[..., None] * seen).sum(0) + delta[..., None] * background) / (num.sum(0) + delta)[..., None]
    return np.concatenate([rgb, 1 - alpha[..., None]], -1)
