"""The raster ops in NumPy float64: faces one by one over the pixels they may reach. Meaning as in `raster.py`."""
from __future__ import annotations

import numpy as np

from .lookup import to_table

SIDES = ((0, 1), (1, 2), (0, 2))  # the corners of a face, edge by edge


def segment_distance2(p, s):
    """Squared distance of points (..., 2) to segments (..., 4)."""
    d = s[..., 2:] - s[..., :2]
    t = np.clip(((p - s[..., :2]) * d).sum(-1) / np.maximum((d * d).sum(-1), 1e-20), 0, 1)
    o = s[..., :2] + t[..., None] * d - p
    return (o * o).sum(-1)


def clip_segment(a, b, near):
    """The part of the homogeneous edge a, b in front of the near plane on screen, (4,), or None."""
    if a[2] < near and b[2] < near:
        return None
    if a[2] < near or b[2] < near:
        c = a + (near - a[2]) / (b[2] - a[2]) * (b - a)
        a, b = (c, b) if a[2] < near else (a, c)
    return np.concatenate([a[:2] / a[2], b[:2] / b[2]])


def cross2(a, b):
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _clipped(h, near):
    """The edges (n, 4) of one face (3, 3), homogeneous in pixels, before the near plane."""
    return [s for s in (clip_segment(h[a], h[b], near) for a, b in SIDES) if s is not None]


def _boxes(h, near, reach, half, cell):
    """Of faces (F, 3, 3), homogeneous in pixels, the boxes of pixels (F, 2), (F, 2) that they may reach, and the edges (F, 3, 4) of those
    wholly before the near plane, as `whole` (F,) says."""
    whole = (h[:, :, 2] >= near).all(axis=1)
    corners = h[:, :, :2] / np.where(whole[:, None, None], h[:, :, 2:], 1.0)
    edges = np.stack([np.concatenate([corners[:, a], corners[:, b]], axis=1) for a, b in SIDES], axis=1)
    least, most = corners.min(axis=1), corners.max(axis=1)
    for f in np.flatnonzero(~whole):
        ends = np.array(_clipped(h[f], near)).reshape(-1, 2)
        least[f], most[f] = (ends.min(0), ends.max(0)) if len(ends) else (np.inf, -np.inf)
    with np.errstate(all="ignore"):
        return (np.clip(np.floor(least - reach + half), 0, cell).astype(int), np.clip(np.ceil(most + reach + half), 0, cell).astype(int),
                edges, whole)


def _fragments(clip, faces, entries, extent, cell_w, cell_h, columns, views, vertices, face_count, near, radius=None, **_):
    """Yield (ys, xs, code, depth) of every face, in drawing order: of those listed, or of all where `entries` is None; without a radius of
    the pixels that it covers."""
    half = np.array([cell_w / 2, cell_h / 2, 1.0])
    clip, faces = clip.reshape(-1, 4), faces.reshape(-1)[:3 * face_count].reshape(-1, 3)
    for view in range(views):
        table = clip[view * vertices:(view + 1) * vertices][faces]
        left, top = view % columns * cell_w, view // columns * cell_h
        screen = table[:, :, [0, 1, 3]] * half
        signs = np.where(np.linalg.det(table[:, :, [0, 1, 3]]) < 0, -1, 1)
        low, high, edges, whole = _boxes(screen, near, 1 if radius is None else radius + 1, half[:2], [cell_w, cell_h])
        for f in np.flatnonzero((high > low).all(axis=1)):
            if entries is not None and view * face_count + f not in entries:
                continue
            c, h, (x0, y0), (x1, y1) = table[f], screen[f], low[f], high[f]
            px, py = np.arange(x0, x1) + 0.5 - half[0], np.arange(y0, y1)[:, None] + 0.5 - half[1]
            ax, ay = [h[k, 0] - px * h[k, 2] for k in range(3)], [h[k, 1] - py * h[k, 2] for k in range(3)]
            e = np.stack([(ax[i] * ay[j] - ay[i] * ax[j]).ravel() for i, j in ((1, 2), (2, 0), (0, 1))], 1) * signs[f]
            total, w = e.sum(1), e @ h[:, 2]
            hard = (e.min(1) >= 0) & (total > 0) & (w > near * total)
            code, (ys, xs) = 2 * (view * face_count + f), np.divmod(np.arange(len(e)), x1 - x0)
            ys, xs = ys + (y0 + top), xs + (x0 + left)
            if radius is None:
                yield ys[hard], xs[hard], np.full(hard.sum(), code + 1), 0.5 * np.clip((e @ c[:, 2])[hard] / w[hard], 0, 1)
                continue
            p = np.stack([(xs - left) + 0.5 - half[0], (ys - top) + 0.5 - half[1]], 1)
            d = np.sqrt(np.min([segment_distance2(p, s) for s in (edges[f] if whole[f] else _clipped(h, near))], axis=0))
            keep = hard | (d <= radius)
            with np.errstate(all="ignore"):
                depth = np.where(hard, 0.5 * np.clip(e @ c[:, 2] / np.where(hard, w, 1), 0, 1), 0.5 + 0.4999 * d / radius)
            yield ys[keep], xs[keep], code + hard[keep], depth[keep]


def _layer(behind, clip, faces, entries, count, extent, **attrs):
    code = np.full((extent.height, extent.width), -1, np.int64)
    depth = np.ones((extent.height, extent.width))
    listed = set(entries.reshape(-1)[:int(count.reshape(-1)[-1]) // 6].tolist())
    for ys, xs, c, d in _fragments(clip, faces, listed, extent, **attrs):
        nearer = d < depth[ys, xs]
        if behind is not None:
            front_code, front_depth = behind[0][ys, xs], behind[1][ys, xs]
            nearer &= (front_code >= 0) & ((d > front_depth) | ((d == front_depth) & (c > front_code)))
        ys, xs = ys[nearer], xs[nearer]
        code[ys, xs], depth[ys, xs] = c[nearer], d[nearer]
    return code, depth


def rasterize(clip, faces, entries, count, **attrs):
    """First layer of listed faces: their codes."""
    return _layer(None, clip, faces, entries, count, **attrs)[0][..., None]


def rasterize_hard(clip, corners, extent, **attrs):
    """The front face of each pixel."""
    code = np.full((extent.height, extent.width), -1, np.int64)
    depth = np.ones((extent.height, extent.width))
    for ys, xs, c, d in _fragments(clip, corners, None, extent, **attrs):
        nearer = d < depth[ys, xs]
        code[ys[nearer], xs[nearer]], depth[ys[nearer], xs[nearer]] = c[nearer] >> 1, d[nearer]
    return code[..., None]


def rasterize_covered(clip, faces, behind, extent, **attrs):
    """Whether any face covers the pixel."""
    code = np.full((extent.height, extent.width), -1, np.int64)
    for ys, xs, _, _ in _fragments(clip, faces.reshape(-1, 4)[:, :3], None, extent, **attrs):
        code[ys, xs] = 0
    return code[..., None]


def _beside(segments, entries, count, radius, edge_count, cell_w, cell_h, columns):
    """Of each listed segment: its slot, pixels near it (ys, xs), their distance, how far along their foot is, and the pixels beyond."""
    cell = np.array([cell_w, cell_h])
    for slot, entry in enumerate(entries.reshape(-1)[:int(count.reshape(-1)[-1]) // 6]):
        view, (a, b) = entry // edge_count, segments.reshape(-1, 2, 2)[slot]
        corner = np.array([view % columns, view // columns]) * cell
        lo = np.clip(np.floor(np.minimum(a, b) - radius - 1 + cell / 2), 0, cell).astype(int)
        hi = np.clip(np.ceil(np.maximum(a, b) + radius + 1 + cell / 2), 0, cell).astype(int)
        if (hi <= lo).any():
            continue
        ys, xs = (g.ravel() for g in np.mgrid[lo[1]:hi[1], lo[0]:hi[0]])
        p = np.stack([xs, ys], 1) + 0.5 - cell / 2
        t = np.clip((p - a) @ (b - a) / max((b - a) @ (b - a), 1e-20), 0, 1)
        foot = a + t[:, None] * (b - a)
        d = np.linalg.norm(foot - p, axis=1)
        beyond = foot + (foot - p) / np.maximum(d, 1e-10)[:, None]
        at = corner + np.clip(np.floor(beyond + cell / 2), 0, cell - 1).astype(int)
        yield slot, ys + corner[1], xs + corner[0], d, t, at


def rasterize_segments(segments, entries, front, count, extent, radius, slots, **cells):
    """The nearest listed segment of each pixel that is outline for it."""
    code = np.full((extent.height, extent.width), -1, np.int64)
    nearest = np.full((extent.height, extent.width), np.inf)
    for slot, ys, xs, d, _, at in _beside(segments, entries, count, radius, **cells):
        clear = (front[ys, xs, 0] < 0) | (front[at[:, 1], at[:, 0], 0] < 0)
        nearer = clear & (d <= radius) & (d < nearest[ys, xs])
        code[ys[nearer], xs[nearer]], nearest[ys[nearer], xs[nearer]] = slot, d[nearer]
    return code[..., None]


def contour_slots(segments, nearness, entries, depth, count, extent, radius, gap, slots, **cells):
    """`rasterize_contours`."""
    code = np.full((extent.height, extent.width), -1, np.int64)
    nearest = np.full((extent.height, extent.width), np.inf)
    for slot, ys, xs, d, t, at in _beside(segments, entries, count, radius, **cells):
        n = nearness.reshape(-1, 2)[slot]
        own, other, limit = depth[ys, xs, 0], depth[at[:, 1], at[:, 0], 0], (1 + gap) / (n[0] + t * (n[1] - n[0]))
        outer = own > limit
        nearer = (own > 0) & (other > 0) & (outer | (other > limit)) & (d <= radius) & (d < nearest[ys, xs])
        code[ys[nearer], xs[nearer]], nearest[ys[nearer], xs[nearer]] = (2 * slot + outer)[nearer], d[nearer]
    return code[..., None]


def fold_segments(clip, edges, edge_count, vertices, views, near, cell_w, cell_h):
    """Segments of boundary edges and folds on screen; 1e9 for all others."""
    h, v = clip.reshape(-1, 4)[:views * vertices, [0, 1, 3]].reshape(views, vertices, 3), edges.reshape(-1, 4)[:edge_count]
    o, e = h[:, v[:, 0]], h[:, v[:, 1]]
    n = np.cross(o, e - o)
    sides = [np.sign((n * (h[:, np.maximum(v[:, k], 0)] - o)).sum(-1)) for k in (2, 3)]
    inner = ((v[:, 3] >= 0) & (sides[0] * sides[1] < 0)).reshape(-1)
    scale = np.array([cell_w / 2, cell_h / 2, 1.0])
    ends = zip((o * scale).reshape(-1, 3), (e * scale).reshape(-1, 3))
    found = np.array([np.full(4, 1e9) if s is None else s for s in (clip_segment(a, b, near) for a, b in ends)])
    return to_table(np.where(inner[:, None], 1e9, found))


def _with_depth(code, depth):
    return np.stack([code, depth.view(np.int64)], 2)


def rasterize_first(clip, faces, entries, count, **attrs):
    """First layer and the bits of its depth."""
    return _with_depth(*_layer(None, clip, faces, entries, count, **attrs))


def rasterize_peel(clip, faces, entries, count, previous, **attrs):
    """The layer behind `previous`, and the bits of its depth."""
    front = previous[..., 0], np.ascontiguousarray(previous[..., 1]).view(np.float64)
    return _with_depth(*_layer(front, clip, faces, entries, count, **attrs))


def nearest_edge(code, face_edges, segments, position, active, face_count, edge_count):
    """The edge of each pixel's face that is nearest to it."""
    code = code[..., 0]
    face = np.maximum(code >> 1, 0)
    view = face // face_count
    edges = face_edges.reshape(-1, 3)[face - view * face_count] + (view * edge_count)[..., None]
    d = segment_distance2(position[..., None, :], segments.reshape(-1, 4)[edges])
    nearest = np.take_along_axis(edges, d.argmin(-1)[..., None], -1)
    return np.where((code[..., None] >= 0) & (active != 0), nearest, -1)
