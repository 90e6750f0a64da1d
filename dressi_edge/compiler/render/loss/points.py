"""Landmarks: points of a part, seen by every camera of a frame, against points in its pictures."""
from __future__ import annotations

import numpy as np

from ....cache.errors import GraphError
from ...graph.functions import (
    absolute,
    apply,
    clamp,
    compose,
    constant_table,
    dot,
    lookup,
    maximum,
    select,
    sparse_matmul,
    stop_gradient,
    to_float,
    to_int,
    total,
)
from ...graph.ir import Node, table
from ..camera import depths, to_clip
from ..frame import Frame
from .image import _huber, _positive


def face_points(positions: Node, faces: np.ndarray, index: np.ndarray, barycentrics: np.ndarray) -> Node:
    """Points on faces, a table of P: for each of index (P,) the corners of faces (F, 3) weighted by barycentrics (P, 3). `positions` may be
    any table of the vertices. Raises GraphError. Of vertices alone, `F.lookup(positions, index)` is enough."""
    faces, index, weights = np.asarray(faces), np.asarray(index), np.asarray(barycentrics, float)
    if index.ndim != 1 or index.dtype.kind not in "iu" or weights.shape != (len(index), 3) or not len(index):
        raise GraphError(f"face_points: faces {index.dtype} {index.shape}, barycentrics {weights.shape}; integers (P,) and numbers "
                         "(P, 3) are needed")
    if not 0 <= index.min() <= index.max() < len(faces):
        raise GraphError(f"face_points: faces {index.min()} to {index.max()}; 0 to {len(faces) - 1} are allowed")
    return sparse_matmul(np.repeat(np.arange(len(index)), 3), faces[index].reshape(-1), weights.reshape(-1), positions, len(index))


def _of_views(frame: Frame, value, points: int, channels: int, what: str) -> Node:
    """The rows of the frame's views: of an array (views, points[, channels]) or a table of views x points over all views of the scene."""
    count = frame.all_views.views * points
    if not isinstance(value, Node):
        array = np.asarray(value, float)
        if array.shape != (frame.all_views.views, points, 2)[:3 if channels == 2 else 2] or not np.isfinite(array).all():
            raise GraphError(f"landmarks: {what} have shape {array.shape}; finite numbers, ({frame.all_views.views}, {points}"
                             f"{', 2' if channels == 2 else ''}), are needed")
        value = constant_table(array.reshape(count, channels))
    if value.channels != channels or value.extent.count != count:
        raise GraphError(f"landmarks: {what} are {value!r} of {value.extent.count} entries; a table of {frame.all_views.views} views x "
                         f"{points} points, {channels} channels each, is needed")
    if frame.chosen is None:
        return value
    own = apply("texel_index", extent=table(points)) + apply("broadcast", frame.chosen * points, extent=table(points))
    return lookup(value, own)


def landmarks(frame: Frame, points: Node, targets, weights=None, *, delta: float | None = None, hidden: float | None = None) -> Node:
    """Mean over views, points and both coordinates of weight (pixel - target)^2; with `delta`, in pixels, of their Huber loss.

    points: a vec3 table of P in world space, such as `face_points(...)`. targets: where each view of the scene sees them, in pixels of its
    picture from the upper left corner: an array (views, P, 2), or a vec2 table of views x P, view by view (an input). weights: (views, P)
    or a float table of views x P; 0 leaves a point out. hidden: a distance along the camera's axis; a point that lies further than that
    behind what is drawn at its pixel counts for nothing. So does one behind the near plane. Raises GraphError.
    """
    if not isinstance(points, Node) or points.vtype != "vec3":
        raise GraphError(f"landmarks: points are {points!r:.60}; a vec3 table is needed")
    count, views, atlas = points.extent.count, frame.views, frame.atlas
    clip = to_clip(points, views)
    front = stop_gradient(clip).w >= views.near
    size = compose(float(atlas.width), float(atlas.height))
    pixel = (clip.xy / select(front, clip.w, 1.0) * 0.5 + 0.5) * size
    d = select(front, pixel - _of_views(frame, targets, count, 2, "targets"), 0.0)
    term = dot(d, d) if delta is None else apply("sum_channels", _huber(d, _positive("landmarks", "delta", delta)))
    if weights is not None:
        term = term * _of_views(frame, weights, count, 1, "weights")
    if hidden is not None:
        term = term * _visible(frame, pixel, depths(points, views), _positive("landmarks", "hidden", hidden))
    return total(term) * (1.0 / (2 * count * views.count))


def _visible(frame: Frame, pixel: Node, depth: Node, tolerance: float) -> Node:
    """1 for points with nothing more than `tolerance` before them at their pixel, and for those outside the picture; else 0."""
    atlas, count = frame.atlas, pixel.extent.count // frame.views.count
    view = np.repeat(np.arange(frame.views.count), count)
    corner = constant_table(np.stack([view % atlas.columns * atlas.width, view // atlas.columns * atlas.height], 1))
    last = compose(atlas.width - 1.0, atlas.height - 1.0)
    pixel, depth = stop_gradient(pixel), stop_gradient(depth)
    own = apply("floor", pixel)
    seen = apply("fetch", stop_gradient(frame.depth), to_int(clamp(own, 0.0, last)) + corner)
    off = absolute(own - last * 0.5) - last * 0.5
    return to_float((maximum(off.x, off.y) > 0.0) | (seen <= 0.0) | (depth <= seen + tolerance))
