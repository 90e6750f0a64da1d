"""HardSoftRas with distance "outline" (docs/conventions.md) in float64 NumPy, edge by edge over every pixel: the oracle of renderer
tests. In, out and method as in `brute_force`: `render` = `select` then `shade`; `gradient` holds what `select` chose.

Of `brute_force.Rendered`, `edge_mask` says here which pixels have an alpha of a distance; there is one layer.
"""

from typing import NamedTuple

import brute_force as face
import numpy as np
from brute_force import DEPTH_SCALE, Gradient, Margins, Rendered


class Selection(NamedTuple):
    """Every discrete choice of an image of (h, w) pixels."""

    faces: np.ndarray  # (F, 3), corners sorted by vertex index
    size: tuple[int, int]  # (w, h)
    near: float
    front: np.ndarray  # (h, w), -1 where S^H is 0
    ends: np.ndarray  # (E, 2) vertices of all edges, lower first
    owner: np.ndarray  # (E,) the lowest face of each
    edge: np.ndarray  # (h, w) the nearest fold or boundary edge within r that is outline for the pixel, -1 where there is none
    margins: Margins  # `value` of silhouette, `color` of colour and face, `gradient` of the derivatives of silhouette and colour


def render(clip, faces, size, r, sigma=None, near=1e-3, attributes=None, background=None) -> Rendered:
    """As `brute_force.render`, for one layer."""
    return shade(select(clip, faces, size, r, near), clip, face.sigma_of(r, sigma), attributes, background)


def gradient(loss, clip, faces, size, r, sigma=None, near=1e-3, attributes=None, background=None, h=1e-6) -> Gradient:
    """As `brute_force.gradient`, for one layer."""
    selection, width = select(clip, faces, size, r, near), face.sigma_of(r, sigma)
    return face.central_differences(lambda c, a: loss(shade(selection, c, width, a, background)), clip, attributes, h)


def select(clip, faces, size, r, near=1e-3) -> Selection:
    """The front face of each pixel, and of the fold and boundary edges that are outline for it the nearest."""
    clip, faces = np.asarray(clip, np.float64), np.sort(np.asarray(faces, int).reshape(-1, 3), axis=1)
    pixels = face.pixel_centres(size)
    front, sure_hard, sure_front = _front(clip, faces, pixels, size, near)
    hard = front >= 0

    users = {}
    for f, corners in enumerate(faces):
        for i, j in ((0, 1), (1, 2), (0, 2)):
            users.setdefault((corners[i], corners[j]), []).append(f)
    ends = np.array(list(users), int).reshape(-1, 2)
    folded = [_fold(clip, faces[own], size) for own in users.values()]
    fold, sure_fold = np.array([x for x, _ in folded], bool), np.array([x for _, x in folded])
    start, stop, exists = face.edge_segment(clip[ends[:, 0]], clip[ends[:, 1]], near, size)
    d, foot, t = face.segment_distance(pixels[None], start[:, None, None], stop[:, None, None])
    d = np.where(exists[:, None, None], d, np.inf)
    clear, sure_clear = _clear_beyond(pixels, foot, d, hard, sure_hard, size)
    clear, sure_clear = clear | ~hard, np.where(hard, sure_clear, np.inf)

    counts = fold[:, None, None] & clear
    listed = np.where(counts, d, np.inf)
    least = listed.min(axis=0, initial=np.inf)
    beside = least <= r
    edge = np.where(beside, listed.argmin(axis=0) if len(ends) else 0, -1)

    def chosen(values):
        return np.take_along_axis(values, np.maximum(edge, 0)[None], axis=0)[0] if len(ends) else np.zeros(edge.shape, values.dtype)

    # Another outcome: an edge would have to count that does not, and to come before the nearest, within r.
    behind = np.maximum(d - np.minimum(least, r), 0)
    become = np.maximum(behind, np.maximum(np.where(fold, 0.0, sure_fold)[:, None, None], np.where(clear, 0.0, sure_clear)))
    become = np.where((np.arange(len(ends))[:, None, None] == edge) & beside, np.inf, become)
    changes = np.where(counts & beside, np.inf, become)  # of two that count the least distance is taken, whichever has it
    own = np.where(beside, np.minimum(chosen(sure_fold[:, None, None] + np.zeros_like(d)), chosen(sure_clear)), np.inf)
    own = np.minimum(np.minimum(own, np.where(beside, r - least, np.inf)), sure_hard)
    value = np.minimum(own, changes.min(axis=0, initial=np.inf))

    # Two edges whose nearest point is the same vertex differ in nothing but the name of the face.
    feature = np.stack([np.where((t == 1) & _in_front(clip, ends[:, 1], near), ends[:, 1, None, None], ends[:, 0, None, None]),
                        np.where((t == 0) & _in_front(clip, ends[:, 0], near), ends[:, 0, None, None], ends[:, 1, None, None])], -1)
    other = (feature != np.take_along_axis(feature, np.maximum(edge, 0)[None, ..., None], axis=0)).any(axis=-1) if len(ends) else clear
    lead = np.where(beside, np.where(other, become, np.inf).min(axis=0, initial=np.inf), np.inf)
    along = np.where(exists, np.linalg.norm(stop - start, axis=-1), 0.0)[:, None, None] * np.ones_like(d)
    line = ((pixels - start[:, None, None]) * (stop - start)[:, None, None]).sum(-1) / np.maximum(along, 1e-300)
    kink = np.where(beside, np.minimum(np.abs(chosen(line)), np.abs(chosen(line - along))), np.inf)  # the foot stops at an end
    color = np.minimum(value, np.where(hard, sure_front, lead))
    slope = np.minimum(np.minimum(value, np.where(hard, sure_front, np.inf)), np.minimum(lead, kink))
    owner = np.array([own[0] for own in users.values()], int)
    return Selection(faces, tuple(size), near, front, ends, owner, edge, Margins(value, color, slope))


def shade(selection, clip, sigma, attributes=None, background=None) -> Rendered:
    """The image of clip (V, 4) and attributes (V, A) under the choices of `selection`: smooth in both."""
    clip = np.asarray(clip, np.float64)
    s, (width, height) = selection, selection.size
    hard, pixels = s.front >= 0, face.pixel_centres(s.size)
    ys, xs = np.nonzero(s.edge >= 0)
    ends = s.ends[s.edge[ys, xs]]
    start, stop, _ = face.edge_segment(clip[ends[:, 0]], clip[ends[:, 1]], s.near, s.size)
    d, _, t = face.segment_distance(pixels[ys, xs], start, stop)
    dist = np.full((height, width), -np.inf)
    dist[ys, xs] = np.where(hard[ys, xs], d, -d)
    silhouette = np.where(s.edge >= 0, face.sigmoid(dist / sigma), hard)
    shown = s.front.copy()
    shown[ys, xs] = np.where(hard[ys, xs], shown[ys, xs], s.owner[s.edge[ys, xs]])

    color = None
    if attributes is not None:
        attributes = np.asarray(attributes, np.float64)
        channels = attributes.shape[1]
        background = np.broadcast_to(0.0 if background is None else background, (height, width, channels))
        layer = np.zeros((height, width, channels))
        layer[ys, xs] = along_edge(clip[ends[:, 0]], clip[ends[:, 1]], attributes[ends[:, 0]], attributes[ends[:, 1]], t, s.near)
        ys, xs = np.nonzero(hard)
        corners = s.faces[s.front[ys, xs]]
        b = np.clip(face.barycentrics(clip[corners], pixels[ys, xs], s.size), 0, 1)
        b = b / np.maximum(b.sum(axis=-1, keepdims=True), 1e-5)
        layer[ys, xs] = np.einsum("ni,nia->na", b, attributes[corners])
        color = silhouette[..., None] * layer + (1 - silhouette[..., None]) * background
    m = s.margins
    return Rendered(color, silhouette, shown[..., None], dist[..., None], hard, s.edge >= 0, m.value, m.color, m.gradient)


def along_edge(a, b, at_a, at_b, t, near):
    """An attribute at the place t (...), 0..1 as seen, of edges between clip points a and b (..., 4), clipped to w = near."""
    wa, wb = a[..., 3], b[..., 3]
    cut = (near - wa) / np.where(wa == wb, 1.0, wb - wa)
    first, last = np.where(wa < near, cut, 0.0), np.where(wb < near, cut, 1.0)
    w_first, w_last = wa + first * (wb - wa), wa + last * (wb - wa)
    s = first + (last - first) * t * w_first / ((1 - t) * w_last + t * w_first)
    return at_a + s[..., None] * (at_b - at_a)


def _front(clip, faces, pixels, size, near):
    """The front face of each pixel; how far each pixel is from another S^H; and from another front face (depths scaled)."""
    shape = (len(faces), *pixels.shape[:2])
    inside, depth = np.zeros(shape, bool), np.zeros(shape)
    d, cut = np.full(shape, np.inf), np.full(shape, np.inf)
    for f, corners in enumerate(faces):
        if face.face_exists(clip[corners], near):
            inside[f], depth[f] = face.cover(clip[corners], pixels, size, near)
            d[f] = face.nearest_edge(clip, corners, pixels, size, near)[0]
            cut[f] = face.distance_to_near_cut(clip[corners], pixels, size, near)
    key = np.where(inside, depth, np.inf)
    front = np.where(inside.any(axis=0), key.argmin(axis=0) if len(faces) else 0, -1)
    sure_hard = face.hard_margin_of(clip, faces, pixels, size, near, inside, d, cut)
    ranked = np.sort(np.concatenate([key, np.full((2, *shape[1:]), 1e3)]), axis=0)
    sure_front = np.minimum((ranked[1] - ranked[0]) * DEPTH_SCALE, np.minimum(d, cut).min(axis=0, initial=np.inf))
    return front, sure_hard, np.where(front >= 0, sure_front, np.inf)


def _fold(clip, own, size):
    """Whether an edge of the faces `own` (n, 3) is a fold or boundary, and by how many pixels."""
    if len(own) != 2:
        return True, np.inf
    shared = np.intersect1d(own[0], own[1])
    sides, thin = [], []
    for corners in own:
        third = np.setdiff1d(corners, shared)
        if len(third) != 1:  # twice the same face, folded on itself
            return True, np.inf
        h = clip[[*shared, third[0]]][:, [0, 1, 3]] * (size[0] / 2, size[1] / 2, 1)
        sides.append(np.linalg.det(h))
        for k in range(3):  # its height over each side, as seen: a face turns where that is 0
            line = np.cross(h[k - 1], h[k - 2])
            thin.append(abs(line @ h[k]) / max(abs(h[k, 2]) * np.hypot(*line[:2]), 1e-300))
    return sides[0] * sides[1] >= 0, min(thin)


def _in_front(clip, vertices, near):
    return (clip[vertices, 3] >= near)[:, None, None]


def _clear_beyond(pixels, foot, d, hard, sure_hard, size):
    """For each edge and pixel: whether the pixel that holds the point one pixel beyond the foot is not covered; how far from another.

    The point lies on the line from the pixel's centre through the foot; a foot that moves by x turns that line by x / d.
    """
    d = np.where(np.isfinite(d), d, 1.0)
    point = foot + (foot - pixels) / np.maximum(d, 1e-300)[..., None]
    at, lever = np.floor(point), d / (1 + d)
    limit = np.array(size) - 1

    def covered(texel):
        x, y = np.moveaxis(np.clip(texel, 0, limit).astype(int), -1, 0)
        return hard[y, x], sure_hard[y, x]

    here, margin = covered(at)
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            texel = at + (dx, dy)
            away = np.linalg.norm(np.maximum(np.maximum(texel - point, point - texel - 1), 0), axis=-1) * lever
            there, sure = covered(texel)
            margin = np.minimum(margin, np.where(there == here, np.maximum(away, sure), away))
    return ~here, np.minimum(margin, lever)
