"""Cameras on the device: tables of views, and vertices to clip coordinates (docs/conventions.md, "Projection").

In: positions (V table), poses and intrinsics (tables of N views). Out: the N x V table of clip coordinates, differentiable by all.
"""
from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..graph.functions import apply, channels, clamp, compose, constant_table, dot, lookup, select, sqrt
from ..graph.ir import Node
from ..io.cameras import Camera


@dataclass(frozen=True)
class ViewTable:
    """Tables of N views: rows of world to camera (three vec4), and projection coefficients (2 fx / width, 2 fy / height,
    2 cx / width - 1, 2 cy / height - 1). near and far are common to the perspective ones; with w below near a point is behind a camera.

    parallel: whether all are orthographic, or where only some are a float table, 1 for those. Then their w is `one`, not below near, and
    depths from span[0] to span[1] are told apart."""

    rows: tuple[Node, Node, Node]
    projection: Node
    count: int
    near: float
    far: float
    parallel: bool | Node = False
    span: tuple[float, float] = (0.0, 1.0)

    @property
    def one(self) -> float:
        return max(1.0, 2.0 * self.near)

    def choose(self, view: Node) -> ViewTable:
        """The table of the one view with this 1x1 index."""
        rows = tuple(lookup(row, view) for row in self.rows)
        parallel = lookup(self.parallel, view) if isinstance(self.parallel, Node) else self.parallel
        return replace(self, rows=rows, projection=lookup(self.projection, view), count=1, parallel=parallel)

    def either(self, parallel: Callable[[], Node], perspective: Callable[[], Node], at: Callable[[Node], Node]) -> Node:
        """Of each view what its kind needs; `at` takes tables of views to where it is needed."""
        if not isinstance(self.parallel, Node):
            return (parallel if self.parallel else perspective)()
        return select(at(self.parallel) > 0.5, parallel(), perspective())

    def position(self) -> Node:
        """Camera centres in world space, N x vec3: -R^T t."""
        r = self.rows
        return -compose(*(r[0].w * channels(r[0])[k] + r[1].w * channels(r[1])[k] + r[2].w * channels(r[2])[k] for k in range(3)))


def projection_rows(cameras: Sequence[Camera], size: tuple[int, int] | None = None) -> np.ndarray:
    """(N, 4) projection coefficients; of pictures that lie in the upper left corner of cells of this size, if given."""
    return np.array([[2 * c.fx / w, 2 * c.fy / h, 2 * c.cx / w - 1, 2 * c.cy / h - 1]
                     for c in cameras for w, h in [size or (c.width, c.height)]])


def pose_rows(cameras: Sequence[Camera]) -> np.ndarray:
    """(N, 3, 4) world to camera."""
    return np.array([c.world_to_camera[:3] for c in cameras])


def fixed_views(cameras: Sequence[Camera], size: tuple[int, int] | None = None) -> ViewTable:
    """Views known at compile time. size: of the cells, where pictures may be smaller; each is in the upper left corner of its cell."""
    rows, flat = pose_rows(cameras), [c.kind == "orthographic" for c in cameras]
    deep, level = ([c for c, is_flat in zip(cameras, flat) if is_flat == kind] for kind in (False, True))
    near, far = (min(c.near for c in deep), max(c.far for c in deep)) if deep else (0.5, 2.0)
    return ViewTable(tuple(constant_table(rows[:, k]) for k in range(3)), constant_table(projection_rows(cameras, size)), len(cameras),
                     float(near), float(far), constant_table(np.array(flat, float)) if deep and level else not deep,
                     (float(min(c.near for c in level)), float(max(c.far for c in level))) if level else (0.0, 1.0))


def rotation_rows(rotation: Node) -> tuple[Node, Node, Node]:
    """Rows of the rotation matrix of a rotation vector (Rodrigues); smooth at zero, where sin a / a and (1 - cos a) / a^2 are series."""
    a2 = dot(rotation, rotation)
    small = a2 < 1e-2
    safe = select(small, 1.0, a2)
    a = sqrt(safe)
    s = select(small, 1.0 - a2 / 6.0 * (1.0 - a2 / 20.0 * (1.0 - a2 / 42.0)), apply("sin", a) / a)
    half = apply("sin", a * 0.5)
    c = select(small, 0.5 - a2 / 24.0 * (1.0 - a2 / 30.0 * (1.0 - a2 / 56.0)), 2.0 * half * half / safe)
    x, y, z = channels(rotation)
    return (compose(1.0 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y),
            compose(c * x * y + s * z, 1.0 - c * (x * x + z * z), c * y * z - s * x),
            compose(c * x * z - s * y, c * y * z + s * x, 1.0 - c * (x * x + y * y)))


def posed_views(base: ViewTable, rotation: Node, translation: Node, pivot: Sequence[float] | None = None) -> ViewTable:
    """Views whose poses are parameters: rotation vectors and translations (N x vec3) in camera space, applied after the base poses. About
    the pivot, a point in world space that the base pose takes to p: x_cam = R(rotation) (R0 x + t0 - p) + p + translation. Without one p is
    the eye, 0. Zero leaves the base poses, exactly.

    About the eye a turn and a shift move what is seen almost alike, and a fit stays where they cancel; about its middle they do not."""
    turned = rotation_rows(rotation)
    p = None if pivot is None else compose(*(dot(row, compose(*pivot, 1.0)) for row in base.rows))
    rows = []
    for k, (row, t) in enumerate(zip(turned, channels(translation))):
        r = row.x * base.rows[0] + row.y * base.rows[1] + row.z * base.rows[2]
        shift = r.w + t if p is None else r.w + (channels(p)[k] - dot(row, p)) + t
        rows.append(compose(r.x, r.y, r.z, shift))
    return replace(base, rows=tuple(rows))


def to_clip(positions: Node, views: ViewTable) -> Node:
    """Clip coordinates, view-major table of N x V."""
    vertices, n = positions.extent.count, views.count
    p = lookup(positions, np.tile(np.arange(vertices), n)) if n > 1 else positions
    view = np.repeat(np.arange(n), vertices)

    def at(table: Node) -> Node:
        return lookup(table, view) if n > 1 else table

    point = compose(p.x, p.y, p.z, 1.0)
    x, y, depth = dot(at(views.rows[0]), point), dot(at(views.rows[1]), point), -dot(at(views.rows[2]), point)
    k = at(views.projection)

    def perspective() -> Node:
        scale = views.far / (views.far - views.near)
        return compose(k.x * x + k.z * depth, k.w * depth - k.y * y, scale * (depth - views.near), depth)

    def parallel() -> Node:
        low, high = views.span
        z = clamp((depth - low) * (1.0 / (high - low)), 0.0, 1.0)  # so that no device clips there
        return compose(k.x * x + k.z, k.w - k.y * y, z, 1.0) * views.one

    return views.either(parallel, perspective, at)


def depths(positions: Node, views: ViewTable) -> Node:
    """Of points, how far along each view's axis they lie from its eye: a view-major float table of N x V."""
    count, n = positions.extent.count, views.count
    p = lookup(positions, np.tile(np.arange(count), n)) if n > 1 else positions
    row = lookup(views.rows[2], np.repeat(np.arange(n), count)) if n > 1 else views.rows[2]
    return -dot(row, compose(p.x, p.y, p.z, 1.0))
