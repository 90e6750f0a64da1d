"""HardSoftRas (paper 3.4, docs/conventions.md) in float64 NumPy, face by face over every pixel: the oracle of renderer tests, for
distance "face"; `brute_force_outline` is that for distance "outline".

In: clip coordinates (V, 4), faces (F, 3), an image size. Out: `Rendered`, or the `Gradient` of a loss of it.
`render` = `select` (the discrete choices) then `shade` (a smooth function of clip and attributes, given those choices);
`gradient` takes central differences of `shade` alone, so it is the derivative of the smooth piece on which the point lies.
Distances are in pixels. Nothing here is shared with the renderer.
"""

import math
from typing import NamedTuple

import numpy as np

DEGENERATE = 1e-12  # |det| of the rows (x, y, w) below which a face does not exist
GAP = 0.02  # of the distance, between neighbours with a step of depth between them
DOUBT = 1 / 32  # pixels
DEPTH_SCALE = 1e3  # makes a difference of depth comparable with one of pixels in a margin
SAME_DISTANCE = 1e-9


class Rendered(NamedTuple):
    """An image of (h, w) pixels, A attributes and K layers, and how far each pixel is from another outcome (see `Margins`)."""

    color: np.ndarray | None  # (h, w, A)
    silhouette: np.ndarray  # (h, w), 0..1
    face: np.ndarray  # (h, w, K) int, -1 where there is no layer
    dist: np.ndarray  # (h, w, K), >= 0 inside, -inf where there is no layer
    hard: np.ndarray  # (h, w) bool, S^H
    edge_mask: np.ndarray  # (h, w) bool, E
    margin: np.ndarray
    margin_color: np.ndarray
    margin_gradient: np.ndarray


class Gradient(NamedTuple):
    clip: np.ndarray  # (V, 4); the z column is 0, depth only orders
    attributes: np.ndarray | None  # (V, A)


class Margins(NamedTuple):
    """(h, w) each: pixels, or depth times `DEPTH_SCALE`, to the nearest other choice.

    All three count the boundary of every face, the near cut, the range r, and the edge mask. They differ in swaps of order:
    `value` leaves out two fragments of the same distance, since dist and silhouette do not tell which of them was taken;
    `color` leaves out nothing, so it covers `face` too;
    `gradient` leaves out two soft fragments whose nearest point is on the same edge or vertex, since distance, colour and the
    derivatives of both are the same, and counts the second nearest edge of a layer, where the derivative of dist jumps.
    """

    value: np.ndarray
    color: np.ndarray
    gradient: np.ndarray


class Selection(NamedTuple):
    """Every discrete choice of an image of (h, w) pixels and K layers."""

    faces: np.ndarray  # (F, 3), corners sorted by vertex index
    size: tuple[int, int]  # (w, h)
    near: float
    face: np.ndarray  # (h, w, K), -1 where there is no layer
    edge: np.ndarray  # (h, w, K), nearest edge 0..2: from corner EDGES[edge][0] to EDGES[edge][1]
    inside: np.ndarray  # (h, w, K) bool, the layer is a hard fragment
    edge_mask: np.ndarray  # (h, w) bool
    margins: Margins


EDGES = np.array([(0, 1), (0, 2), (1, 2)])  # ascending corners: the direction of an edge depends on its vertices only


def render(
    clip, faces, size, r, sigma=None, delta=None, layers=1, near=1e-3, attributes=None, background=None, edges="coverage"
) -> Rendered:
    """Render clip (V, 4), Vulkan's clip space, and faces (F, 3) to `size` = (w, h) pixels.

    r: range in pixels; sigma, delta: pixels, r / 7 and r unless given; near: smallest w in front of the camera;
    attributes (V, A), interpolated as colours; background (A,) or (h, w, A), 0 unless given.
    """
    selection = select(clip, faces, size, r, delta, layers, near, edges)
    return shade(selection, clip, sigma_of(r, sigma), attributes, background)


def gradient(
    loss, clip, faces, size, r, sigma=None, delta=None, layers=1, near=1e-3, attributes=None, background=None, h=1e-6, edges="coverage"
) -> Gradient:
    """Central differences of `loss(Rendered) -> float` by clip and attributes, the discrete choices held as at `clip`."""
    selection = select(clip, faces, size, r, delta, layers, near, edges)
    width = sigma_of(r, sigma)
    return central_differences(lambda c, a: loss(shade(selection, c, width, a, background)), clip, attributes, h)


def central_differences(loss, clip, attributes=None, h=1e-6) -> Gradient:
    """Of `loss(clip, attributes) -> float` by both; attributes may be None."""

    def differences(array, columns, loss_of):
        out = np.zeros_like(array)
        for i in np.ndindex(len(array), len(columns)):
            at = i[0], columns[i[1]]
            ends = []
            for step in (h, -h):
                moved = array.copy()
                moved[at] += step
                ends.append(loss_of(moved))
            out[at] = (ends[0] - ends[1]) / (2 * h)
        return out

    clip = np.array(clip, np.float64)
    by_clip = differences(clip, (0, 1, 3), lambda moved: loss(moved, attributes))
    if attributes is None:
        return Gradient(by_clip, None)
    attributes = np.array(attributes, np.float64)
    return Gradient(by_clip, differences(attributes, range(attributes.shape[1]), lambda moved: loss(clip, moved)))


def select(clip, faces, size, r, delta=None, layers=1, near=1e-3, edges="coverage") -> Selection:
    """Which face fills each layer of each pixel, hard or soft, by which of its edges, and the edge mask."""
    clip, faces = np.asarray(clip, np.float64), np.sort(np.asarray(faces, int).reshape(-1, 3), axis=1)
    delta = r if delta is None else delta
    width, height = size
    pixels = pixel_centres(size)
    shape = (len(faces), height, width)
    inside = np.zeros(shape, bool)
    d, cut = np.full(shape, np.inf), np.full(shape, np.inf)  # to the nearest edge; to the line along which near cuts the face
    second = np.full(shape, np.inf)  # how much further the nearest edge with another nearest point is
    depth, edge = np.zeros(shape), np.zeros(shape, int)
    feature = np.zeros((*shape, 2), int)  # the vertices on which the nearest point depends, one vertex twice for a corner
    for f, corners in enumerate(faces):
        if not face_exists(clip[corners], near):
            continue
        inside[f], depth[f] = cover(clip[corners], pixels, size, near)
        d[f], edge[f], feature[f], second[f] = nearest_edge(clip, corners, pixels, size, near)
        cut[f] = distance_to_near_cut(clip[corners], pixels, size, near)

    candidate = inside | (d <= r)
    kind = np.where(inside, 0, np.where(candidate, 1, 2))
    key = np.where(inside, depth, np.where(candidate, d, 0.0))
    order = np.lexsort((key, kind), axis=0)  # stable: ties stay in the order of the face index (equation 3)
    order = np.concatenate([order, np.zeros((max(0, layers - len(faces)), height, width), int)])[:layers]
    filled = np.arange(layers)[:, None, None] < candidate.sum(axis=0)
    face = np.where(filled, order, -1)

    def per_layer(values):
        if not len(faces):
            return np.zeros((layers, height, width), values.dtype)
        return np.where(filled, np.take_along_axis(values, order, axis=0), values.dtype.type(0))

    hard = inside.any(axis=0)
    reach = math.ceil(delta)
    hard_margin = hard_margin_of(clip, faces, pixels, size, near, inside, d, cut)
    if edges == "coverage":
        edge_mask = _windows(hard, reach).any(axis=(2, 3)) != _windows(hard, reach).all(axis=(2, 3))
        mask_margin = _edge_mask_margin(hard, edge_mask, reach, hard_margin)
    elif edges == "depth":
        doubt = np.minimum(hard_margin, np.minimum(d, cut).min(axis=0, initial=np.inf)) < DOUBT
        edge_mask, mask_margin = _depth_mask(clip, faces, pixels, size, hard, face, reach, doubt)
    else:
        edge_mask, mask_margin = np.ones((height, width), bool), np.inf

    # The smallest distance to another outcome that every margin has in common.
    common = np.minimum(d, cut).min(axis=0, initial=np.inf)
    layer_inside, layer_d = per_layer(inside), per_layer(d)
    common = np.minimum(common, np.where(filled & ~layer_inside, r - layer_d, np.inf).min(axis=0))
    room = candidate.sum(axis=0) < layers
    common = np.minimum(common, np.where(room & ~candidate, d - r, np.inf).min(axis=0, initial=np.inf))
    common = np.minimum(common, mask_margin)
    margins = [common, common, np.minimum(common, np.where(filled, per_layer(second), np.inf).min(axis=0))]
    rank = np.zeros(shape, int)
    if len(faces):
        np.put_along_axis(rank, np.lexsort((key, kind), axis=0), np.arange(len(faces))[:, None, None], axis=0)
    ys, xs = np.indices((height, width))
    for k in range(layers):
        f = face[k]
        if not (f >= 0).any():
            break
        at = f, ys, xs
        gap = (key - key[at]) * np.where(kind == 0, DEPTH_SCALE, 1.0)
        gap = np.where((f >= 0) & candidate & (kind == kind[at]) & (rank > k), gap, np.inf)
        same_value = np.abs(d - d[at]) < SAME_DISTANCE
        same_feature = (kind == 1) & (feature == feature[at]).all(axis=-1)
        for m, ignored in enumerate((same_value, np.zeros_like(same_value), same_feature)):
            margins[m] = np.minimum(margins[m], np.where(ignored, np.inf, gap).min(axis=0))

    def last(values):
        return np.moveaxis(values, 0, -1)

    return Selection(
        faces, (width, height), near, last(face), last(per_layer(edge)), last(layer_inside), edge_mask, Margins(*margins)
    )


def shade(selection, clip, sigma, attributes=None, background=None) -> Rendered:
    """The image of clip (V, 4) and attributes (V, A) under the choices of `selection`: smooth in both."""
    clip = np.asarray(clip, np.float64)
    s, (width, height) = selection, selection.size
    ys, xs, ks = np.nonzero(s.face >= 0)
    face, inside = s.face[ys, xs, ks], s.inside[ys, xs, ks]
    corners = clip[s.faces[face]]  # (N, 3, 4)
    pixels = np.stack([xs + 0.5, ys + 0.5], axis=-1)
    ends = np.take_along_axis(corners, EDGES[s.edge[ys, xs, ks]][:, :, None], axis=1)
    start, stop, _ = edge_segment(ends[:, 0], ends[:, 1], s.near, s.size)
    d, nearest, _ = segment_distance(pixels, start, stop)
    dist = np.full(s.face.shape, -np.inf)
    dist[ys, xs, ks] = np.where(inside, d, -d)
    probability = sigmoid(dist / sigma)
    hard = s.inside[..., 0]
    edge_silhouette = 1 - np.prod(1 - probability, axis=-1)  # equation 6
    silhouette = np.where(s.edge_mask, edge_silhouette, hard)

    color = None
    if attributes is not None:
        attributes = np.asarray(attributes, np.float64)
        channels = attributes.shape[1]
        background = np.broadcast_to(0.0 if background is None else background, (height, width, channels))
        b = barycentrics(corners, np.where(inside[:, None], pixels, nearest), s.size)
        b = np.clip(b, 0, 1)
        b = b / np.maximum(b.sum(axis=-1, keepdims=True), 1e-5)
        layer = np.zeros((*s.face.shape, channels))
        layer[ys, xs, ks] = np.einsum("ni,nia->na", b, attributes[s.faces[face]])
        weight = np.maximum(probability.sum(axis=-1), 1e-300)
        edge_color = (probability[..., None] * layer).sum(axis=2) / weight[..., None]  # equation 5
        alpha = silhouette[..., None]
        color = np.where(
            s.edge_mask[..., None],
            alpha * edge_color + (1 - alpha) * background,
            np.where(hard[..., None], layer[:, :, 0], background),
        )
    m = s.margins
    return Rendered(color, silhouette, s.face, dist, hard, s.edge_mask, m.value, m.color, m.gradient)


def face_exists(corners, near) -> bool:
    """Whether the face of clip corners (3, 4) has a vertex in front of near and is not seen edge on."""
    return bool((corners[:, 3] >= near).any()) and abs(np.linalg.det(corners[:, [0, 1, 3]])) >= DEGENERATE


def edge_segment(a, b, near, size):
    """The screen segment (start, stop, exists) of edges between clip points a and b (..., 4), clipped to w = near."""
    behind_a, behind_b = a[..., 3] < near, b[..., 3] < near
    span = np.where(behind_a != behind_b, b[..., 3] - a[..., 3], 1.0)
    meet = a + ((near - a[..., 3]) / span)[..., None] * (b - a)
    exists = ~(behind_a & behind_b)
    start = np.where((behind_a & ~behind_b)[..., None], meet, a)
    stop = np.where((behind_b & ~behind_a)[..., None], meet, b)
    return screen(start, exists, size), screen(stop, exists, size), exists


def screen(points, exists, size):
    """Clip (..., 4) to pixels (..., 2)."""
    w = np.where(exists, points[..., 3], 1.0)[..., None]
    return (points[..., :2] / w + 1) / 2 * np.array(size, np.float64)


def segment_distance(p, a, b):
    """Distance from p (..., 2) to the segment a b, the nearest point of it, and where on it that is, 0..1."""
    ab = b - a
    length2 = (ab * ab).sum(axis=-1)
    t = np.clip(((p - a) * ab).sum(axis=-1) / np.maximum(length2, 1e-300), 0, 1)
    q = a + t[..., None] * ab
    return np.sqrt(((p - q) ** 2).sum(axis=-1)), q, t


def edge_functions(corners, pixels, size):
    """Homogeneous edge functions (..., 3) of clip corners (..., 3, 4) at pixels (..., 2) [Olano and Greer 1997]."""
    p = pixels / np.array(size, np.float64) * 2 - 1
    a = corners[..., :2] - p[..., None, :] * corners[..., 3:]

    def cross(i, j):
        return a[..., i, 0] * a[..., j, 1] - a[..., i, 1] * a[..., j, 0]

    return np.stack([cross(1, 2), cross(2, 0), cross(0, 1)], axis=-1)


def barycentrics(corners, pixels, size):
    """Perspective-correct barycentrics (..., 3) of the point of the face's plane that is seen at pixels (..., 2)."""
    e = edge_functions(corners, pixels, size)
    total = e.sum(axis=-1, keepdims=True)
    return e / np.where(total == 0, 1.0, total)


def sigmoid(x):
    small = np.exp(-np.abs(x))
    return np.where(x >= 0, 1, small) / (1 + small)


def sigma_of(r, sigma):
    sigma = r / 7 if sigma is None else sigma
    if not sigma > 0:
        raise ValueError(f"sigma is {sigma}; it must be > 0: give one where r is 0")
    return sigma


def pixel_centres(size):
    width, height = size
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    return np.stack([x, y], axis=-1)


def cover(corners, pixels, size, near):
    """Whether the face of corners (3, 4) covers each pixel, and its depth there, 0..1."""
    sign = np.sign(np.linalg.det(corners[:, [0, 1, 3]]))
    e = edge_functions(corners, pixels, size) * sign
    b = barycentrics(corners, pixels, size)
    w = b @ corners[:, 3]
    inside = (e >= 0).all(axis=-1) & (w > near)
    return inside, np.clip(b @ corners[:, 2] / np.where(inside, w, 1.0), 0, 1)


def nearest_edge(clip, corners, pixels, size, near):
    """Distance to the nearest edge of a face, which edge, its feature (see `select`), the lead over the next other feature."""
    distances, features = [], []
    for i, j in corners[EDGES]:
        start, stop, exists = edge_segment(clip[i], clip[j], near, size)
        distance, _, t = segment_distance(pixels, start, stop)
        at_start = (t == 0) & (clip[i, 3] >= near)  # an end made by clipping depends on both vertices
        at_stop = (t == 1) & (clip[j, 3] >= near)
        features.append(np.stack([np.where(at_stop, j, i), np.where(at_start, i, j)], axis=-1))
        distances.append(distance if exists else np.full_like(distance, np.inf))
    distances, features = np.array(distances), np.array(features)
    edge = distances.argmin(axis=0)
    d = np.take_along_axis(distances, edge[None], axis=0)[0]
    feature = np.take_along_axis(features, edge[None, ..., None], axis=0)[0]
    other = (features != feature).any(axis=-1)
    return d, edge, feature, np.where(other & np.isfinite(distances), distances - d, np.inf).min(axis=0)


def distance_to_near_cut(corners, pixels, size, near):
    """Distance to the segment along which w = near cuts the face: not one of its edges, but its coverage ends there."""
    ends = []
    for i, j in EDGES:
        if (corners[i, 3] < near) != (corners[j, 3] < near):
            start, stop, _ = edge_segment(corners[i], corners[j], near, size)
            ends.append(start if corners[i, 3] < near else stop)
    return segment_distance(pixels, *ends)[0] if ends else np.full(pixels.shape[:2], np.inf)


def hard_margin_of(clip, faces, pixels, size, near, inside, d, cut):
    """How far each pixel is from a change of S^H: from the outline, or as deep as it is inside a single face."""
    outline = cut.min(axis=0, initial=np.inf)
    users = {}
    for corners in faces:
        if face_exists(clip[corners], near):
            for e in range(3):
                users.setdefault(tuple(corners[EDGES[e]]), []).append(corners[2 - e])  # the corner that edge e leaves out
    for (i, j), others in users.items():
        start, stop, exists = edge_segment(clip[i], clip[j], near, size)
        in_front = (clip[[i, j, *others], 3] >= near).all()
        if in_front:  # an edge with a face on either side of it is no outline: those faces are watertight along it
            third = screen(clip[others], True, size)
            side = (stop - start)[0] * (third - start)[:, 1] - (stop - start)[1] * (third - start)[:, 0]
        if exists and not (in_front and side.min() < 0 < side.max()):
            outline = np.minimum(outline, segment_distance(pixels, start, stop)[0])
    deep = np.where(inside, np.minimum(d, cut), 0).max(axis=0, initial=0)
    return np.maximum(outline, deep)


def _edge_mask_margin(hard, edge_mask, reach, hard_margin):
    """How far each pixel is from a change of E: by the first change of S^H where E is 0, by the last needed where it is 1."""
    margin = _windows(hard_margin, reach)
    differs = _windows(hard, reach) != hard[..., None, None]
    return np.where(edge_mask, np.where(differs, margin, 0).max(axis=(2, 3)), margin.min(axis=(2, 3)))


def _depth_mask(clip, faces, pixels, size, hard, face, reach, doubt):
    """The edge mask with the steps of depth, and 0 where doubtful pixels may decide it."""
    w = np.full(hard.shape, np.nan)
    for f, corners in enumerate(faces):
        mine = hard & (face[0] == f)
        w[mine] = (barycentrics(clip[corners], pixels, size) @ clip[corners, 3])[mine]
    bits = np.where(hard, 2, 1)
    sure, possible = np.where(doubt, 0, bits), np.where(doubt, 3, bits)
    for a, b in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        with np.errstate(invalid="ignore"):
            ratio = np.maximum(w[a], w[b]) / np.minimum(w[a], w[b]) - 1
        far, perhaps, unsure = ratio > GAP, ratio > GAP * 0.99, doubt[a] | doubt[b]
        for at in (a, b):
            bits[at] |= 3 * far
            sure[at] |= 3 * ((ratio > GAP * 1.01) & ~unsure)
            possible[at] |= 3 * (perhaps | unsure)
    mask, least, most = (np.bitwise_or.reduce(_windows(x, reach), axis=(2, 3)) == 3 for x in (bits, sure, possible))
    return mask, np.where(least == most, np.inf, 0.0)


def _windows(image, reach):
    """(h, w, 2 reach + 1, 2 reach + 1) neighbourhoods; beyond the image is its border, which lies in the same neighbourhood."""
    padded = np.pad(image, reach, mode="edge")
    return np.lib.stride_tricks.sliding_window_view(padded, (2 * reach + 1, 2 * reach + 1))
