"""Shadow maps: how far a light sees, drawn by the scene's own rasterizer, and how much of it arrives at a point.

    the light's views (1, or 6 of a point) -> faces in front -> depth along each view's axis, one image
    a point -> its place and depth in the view that looks at it -> the share of texels around that see as far (percentage closer)

The map is part of the graph: it is drawn again when vertices or the light move, and once while they rest. Visibility has no gradient: not
of the edge of a shadow, nor of its place; everything that it multiplies has.
"""
from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property

import numpy as np

from ..graph.functions import (
    absolute,
    apply,
    clamp,
    compose,
    constant_table,
    cross,
    dot,
    lookup,
    maximum,
    minimum,
    normalize,
    select,
    stop_gradient,
    to_float,
    to_int,
)
from ..graph.ir import UNIT, Node
from ..graph.optable import as_node
from .atlas import Atlas
from .camera import ViewTable
from .light import Light, Shadow
from .part import Parts
from .raster.hard import Hard

FAR = 1e30  # depth where a light sees nothing
SIDES = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float)  # of a cube around a point light
UPS = np.array([[0, 1, 0], [0, 1, 0], [0, 0, 1], [0, 0, 1], [0, 1, 0], [0, 1, 0]], float)
BEYOND = 1.02  # of half a right angle, that a cube's views overlap


class ShadowMap:
    """What is called with points (vec3, world space) and gives the share of a light that arrives there, 0 to 1, a float.

    parts: all that casts shadows, asked for when the map is first used. middle, radius: a ball around them, which a directional light's map
    covers: what lies outside it is lit, and casts no shadow."""

    def __init__(self, kind: str, vector: Node, direction: Node | None, cone: float, shadow: Shadow, parts: Callable[[], Parts],
                 middle: np.ndarray, radius: float):
        self.kind, self.vector, self.direction, self.cone, self.shadow = kind, stop_gradient(vector), direction, cone, shadow
        self._parts, self.middle, self.radius = parts, np.asarray(middle, float), float(radius)
        self.atlas = Atlas.of(shadow.size, shadow.size, 6 if kind == "point" else 1)

    @cached_property
    def _axes(self) -> tuple[Node, Node, Node]:
        """Right, up and forward of each view, vec3 tables."""
        if self.kind == "point":
            right = np.cross(SIDES, UPS)
            return tuple(constant_table(x) for x in (right, np.cross(right, SIDES), SIDES))
        forward = normalize(self.vector if self.kind == "directional" else stop_gradient(self.direction))
        up = select(absolute(forward.y) < 0.9, compose(0.0, 1.0, 0.0), compose(1.0, 0.0, 0.0))
        right = normalize(cross(forward, up))
        return right, cross(right, forward), forward

    @cached_property
    def _eye(self) -> Node:
        if self.kind == "directional":
            return compose(*self.middle.tolist()) - self._axes[2] * self.radius
        return self.vector

    @cached_property
    def _slope(self) -> float:
        """Half of what a view sees across at distance 1; of a directional light, at all distances."""
        if self.kind == "directional":
            return self.radius
        return BEYOND if self.kind == "point" else max(math.tan(min(self.cone, 1.5)), 1e-3) * BEYOND

    @property
    def _near(self) -> float:
        return self.radius * 1e-3

    @cached_property
    def views(self) -> ViewTable:
        """The light's own views."""
        eye = self._eye if self.kind != "point" else lookup(self._eye, np.zeros(6, int))
        right, up, forward = self._axes
        rows = tuple(compose(a.x, a.y, a.z, -dot(a, eye)) for a in (right, up, -forward))
        count, flat = 6 if self.kind == "point" else 1, self.kind == "directional"
        lens = constant_table(np.tile([1.0 / self._slope, 1.0 / self._slope, 0.0, 0.0], (count, 1)))
        near, far = (0.5, 2.0) if flat else (self._near, self.radius * 1e3)
        return ViewTable(rows, lens, count, near, far, flat, (0.0, 2.0 * self.radius))

    @cached_property
    def map(self) -> Node:
        """float, over the atlas of the light's views: up to which depth there is light; `FAR` where nothing stands in its way."""
        parts, s, flat = self._parts(), self.shadow, self.kind == "directional"
        clip = stop_gradient(parts.clip(self.views))
        f = Hard().draw(clip, parts.topology, self.atlas, self.views.near, True)
        face = f.layers[0].face
        h = [lookup(c, face) for c in f.view_corners(clip)]
        depths = [x.z * (2.0 * self.radius / self.views.one) if flat else x.w for x in h]
        depth, across, down = f.plane(f.layers[0], h, depths)
        texel = 2.0 * self._slope / s.size * (as_node(1.0) if flat else depth)  # how large one is there
        falls = minimum((absolute(across) + absolute(down)) * (0.5 * (s.filter + 1)), texel * s.limit)
        return select(face >= 0, depth + falls + texel * s.bias, FAR)

    def __call__(self, position: Node) -> Node:
        p = stop_gradient(position)
        to = p - self._eye
        if self.kind == "point":
            size = compose(absolute(to.x), absolute(to.y), absolute(to.z))
            sign = [select(x < 0.0, 1, 0) for x in (to.x, to.y, to.z)]
            on_x, on_y = (size.x >= size.y) & (size.x >= size.z), size.y >= size.z
            side = select(on_x, sign[0], select(on_y, sign[1] + 2, sign[2] + 4))
            right, up, forward = (lookup(a, side) for a in self._axes)
            corner = self.atlas.corner(side)
        else:
            right, up, forward = self._axes
            corner = compose(as_node(0), as_node(0))
        depth, n = dot(to, forward), self.shadow.size
        scale = 1.0 / self._slope if self.kind == "directional" else 1.0 / (maximum(depth, self._near) * self._slope)
        x, y = dot(to, right) * scale, -dot(to, up) * scale
        inside = (absolute(x) < 1.0) & (absolute(y) < 1.0) & (depth > 0.0)
        share = self._closer((x + 1.0) * (0.5 * n), (y + 1.0) * (0.5 * n), depth, corner)
        return stop_gradient(select(inside, share, 1.0))

    def _closer(self, x: Node, y: Node, depth: Node, corner: Node) -> Node:
        """The share of the texels around a place of the map that see as far as depth, over a square of `filter` texels."""
        width, n = self.shadow.filter, self.shadow.size
        at = compose(x, y) - 0.5 * width  # the upper left corner of the square
        low = apply("floor", clamp(at, -float(n), 2.0 * n))
        f, first, total = at - low, to_int(low), None
        for j in range(width + 1):
            for i in range(width + 1):
                weight = _share(f.x, i, width) * _share(f.y, j, width) * (1.0 / width ** 2)
                texel = minimum(maximum(first + compose(as_node(i), as_node(j)), 0), n - 1) + corner
                term = weight * to_float(apply("fetch", self.map, texel) >= depth)
                total = term if total is None else total + term
        return total


def _share(f: Node, k: int, width: int) -> Node:
    """How much of texel k a stretch of `width` texels that begins at f covers."""
    return 1.0 - f if k == 0 else f if k == width else as_node(1.0)


def shadow_map(light: Light, shadow: Shadow, parts: Callable[[], Parts], middle: np.ndarray, radius: float) -> ShadowMap:
    """The map of a `Light` that is not ambient."""
    def node(x) -> Node | None:
        return x if x is None or isinstance(x, Node) and x.extent == UNIT else compose(*x)

    return ShadowMap(light.kind, node(light.vector), node(light.direction), light.cone[1], shadow, parts, middle, radius)


class Deferred:
    """A shadow whose map is made when it is first used: parts may be added until then."""

    def __init__(self, make: Callable[[], ShadowMap]):
        self._make = make

    @cached_property
    def drawn(self) -> ShadowMap:
        """The map."""
        return self._make()

    def __call__(self, position: Node) -> Node:
        return self.drawn(position)
