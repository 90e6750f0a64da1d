"""HardSoftRas (paper 3.4, Algorithm 2, equations 3 to 6): soft silhouettes and colours on hardware rasterization.

In: clip coordinates (views x vertices), the mesh's topology, an atlas. Out: `Layers`: for each of K peels which face, its signed
distance and probability, barycentrics for attributes; and the blends. Forward only: every gradient comes from the AD.
"""
from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...cache.errors import InputError
from ..functions import (
    absolute,
    apply,
    clamp,
    compose,
    constant_table,
    dot,
    lookup,
    maximum,
    minimum,
    not_equal,
    select,
    sigmoid,
    sqrt,
    stop_gradient,
    to_int,
)
from ..ir import Extent, Node, image
from ..ops.reduce import TILE
from ..topology import Topology

MAX_LAYERS = 5
# Twice the area of a face over the square of its size as seen from the pixel: below this it is rounding noise, as is its inverse.
DEGENERATE = 1e-6


@dataclass(frozen=True)
class Atlas:
    """`views` cells of width x height, `columns` in a row."""

    width: int
    height: int
    views: int
    columns: int

    @property
    def extent(self) -> Extent:
        return image(self.width * self.columns, self.height * -(-self.views // self.columns))

    @staticmethod
    def of(width: int, height: int, views: int) -> Atlas:
        """The atlas nearest to a square with few empty cells."""
        best = min(range(1, views + 1), key=lambda c: (-(-views // c) * c - views, abs(c * width - -(-views // c) * height)))
        return Atlas(width, height, views, best)


@dataclass(frozen=True)
class Softness:
    """r, sigma, delta in pixels (defaults of paper 3.4.3: sigma = r / 7, delta = r); layers K; `folds=False` draws every face enlarged."""

    r: float = 2.0
    sigma: float | None = None
    delta: float | None = None
    layers: int = 1
    folds: bool = True

    def __post_init__(self):
        if not (math.isfinite(self.r) and self.r > 0):
            raise InputError(f"r is {self.r} pixels; a positive number is needed")
        if self.sigma is not None and not (math.isfinite(self.sigma) and self.sigma > 0):
            raise InputError(f"sigma is {self.sigma} pixels; a positive number is needed")
        if self.width < 1e-9:  # 1 / sigma times a distance in pixels must be a number of fp32, and so must its gradient
            raise InputError(f"sigma is {self.width} pixels; at least 1e-9 is needed")
        if self.delta is not None and not (math.isfinite(self.delta) and self.delta >= 0):
            raise InputError(f"delta is {self.delta} pixels; a number >= 0 is needed")
        if not 1 <= self.layers <= MAX_LAYERS:
            raise InputError(f"K is {self.layers}; 1 to {MAX_LAYERS} layers are allowed")

    @property
    def width(self) -> float:
        """sigma in force."""
        return self.r / 7 if self.sigma is None else self.sigma

    @property
    def reach(self) -> int:
        """Half width of the edge mask's window, delta rounded up."""
        return math.ceil(self.r if self.delta is None else self.delta)


def _cross2(a: Node, b: Node) -> Node:
    return a.x * b.y - a.y * b.x


def _segments(clip: Node, topology: Topology, atlas: Atlas, near: float) -> Node:
    """Screen segments of all edges, relative to the cell's centre, clipped to the near plane; 1e9 where wholly behind."""
    ends = [np.concatenate([v * topology.vertex_count + topology.edges[:, k] for v in range(atlas.views)]) for k in (0, 1)]
    scale = compose(atlas.width / 2, atlas.height / 2, 1.0)
    a, b = (apply("swizzle", lookup(clip, e), channels="xyw") * scale for e in ends)
    a_behind, b_behind = a.z < near, b.z < near
    crosses = not_equal(a_behind, b_behind)
    cut = a + (b - a) * ((near - a.z) / select(crosses, b.z - a.z, 1.0))
    a, b = select(apply("bit_and", crosses, a_behind), cut, a), select(apply("bit_and", crosses, b_behind), cut, b)
    a, b = a.xy / maximum(a.z, near), b.xy / maximum(b.z, near)
    return select(apply("bit_and", a_behind, b_behind), 1e9, compose(a, b))


def _boxes(low: Node, high: Node, exists: Node, reach: float, per_view: int, atlas: Atlas) -> Node:
    """Half-open boxes of the atlas' pixels whose centres are within `reach` of screen bounds; empty where nothing exists."""
    half = compose(atlas.width / 2, atlas.height / 2)
    limit = compose(float(atlas.width), float(atlas.height))
    view = apply("idiv", apply("texel_index", extent=low.extent), per_view)
    origin = compose(apply("imod", view, atlas.columns) * atlas.width, apply("idiv", view, atlas.columns) * atlas.height)
    lo = to_int(clamp(low + half - (reach - 0.5), 0.0, limit))
    hi = to_int(clamp(high + half + (reach + 0.5), 0.0, limit))
    box = compose(lo + origin, hi + origin)
    return select(exists, box, 0)


@dataclass(frozen=True)
class Layer:
    """One peel: global face index (-1 none), hard flag, signed distance in pixels, probability (0 where there is none), and the
    point of the face nearest to the pixel, relative to the cell's centre."""

    face: Node
    hard: Node
    dist: Node
    probability: Node
    point: Node


class Layers:
    """The rasterized peels of a mesh in an atlas of views."""

    def __init__(self, clip: Node, topology: Topology, atlas: Atlas, softness: Softness, near: float):
        self.clip, self.topology, self.atlas, self.softness, self.near = clip, topology, atlas, softness, near
        self.position = apply("cell_position", extent=atlas.extent, cell_w=atlas.width, cell_h=atlas.height)
        self.segments = _segments(clip, topology, atlas, near)
        s = stop_gradient(self.segments)
        reach = max(softness.r, math.sqrt(2) * softness.reach) + 0.05
        self.edge_boxes = _boxes(minimum(s.xy, s.zw), maximum(s.xy, s.zw), s.x < 1e8, reach, len(topology.edges), atlas)
        codes = self._codes()
        near = apply("edge_tiles", codes[0], reach=softness.reach)
        window = {"cell_w": atlas.width, "cell_h": atlas.height, "tile": (TILE, TILE)}
        across = apply("hard_window", codes[0], near, dx=softness.reach, dy=0, **window)
        self.edge_mask = apply("edge_mask", across, near, dx=0, dy=softness.reach, **window)
        self.layers = [self._layer(code if code.channels == 1 else code.x) for code in codes]
        self.stencil = self.layers[0].hard

    def _codes(self) -> list[Node]:
        a, t, k = self.atlas, self.topology, self.softness.layers
        faces = constant_table(t.sorted_faces)
        attrs = {"extent": a.extent, "cell_w": a.width, "cell_h": a.height, "columns": a.columns, "views": a.views,
                 "vertices": t.vertex_count, "face_count": len(t.faces), "radius": float(self.softness.r), "near": float(self.near)}
        if k == 1 and self.softness.folds:
            folds = apply("fold_segments", stop_gradient(self.segments), stop_gradient(self.clip), constant_table(t.edge_vertices),
                          edge_count=len(t.edges), vertices=t.vertex_count)
            return [apply("rasterize_folds", self.clip, faces, folds, constant_table(t.edge_faces), edge_count=len(t.edges), **attrs)]
        if k == 1:
            return [apply("rasterize", self.clip, faces, **attrs)]
        codes = [apply("rasterize_first", self.clip, faces, **attrs)]
        for _ in range(k - 1):
            codes.append(apply("rasterize_peel", self.clip, faces, codes[-1], **attrs))
        return codes

    def _layer(self, code: Node) -> Layer:
        exists = code >= 0
        hard = select(exists, apply("bit_and", code, 1), 0)
        face = apply("shift_right", code, 1)
        edge = apply("nearest_edge", code, constant_table(self.topology.face_edges), stop_gradient(self.segments), self.position,
                     self.edge_mask, face_count=len(self.topology.faces), edge_count=len(self.topology.edges))
        s = lookup(self.segments, edge, self.edge_boxes)
        a, b = s.xy, s.zw
        d, o = b - a, self.position - a
        squared = maximum(dot(d, d), 1e-20)
        t = dot(o, d) / squared
        between = apply("bit_and", t > 0.0, t < 1.0)
        end = self.position - select(t < 0.5, a, b)
        far = select(between, absolute(_cross2(d, o)) / sqrt(squared), sqrt(dot(end, end)))
        dist = select(hard, far, -far)
        probability = select(edge >= 0, sigmoid(dist * (1.0 / self.softness.width)), 0.0)
        point = select(hard, self.position, a + d * clamp(t, 0.0, 1.0))
        return Layer(face, hard, dist, probability, point)

    def silhouette(self) -> Node:
        """Equation 6: 1 - prod(1 - D_k) at edges, the stencil elsewhere."""
        clear = 1.0 - self.layers[0].probability
        for layer in self.layers[1:]:
            clear = clear * (1.0 - layer.probability)
        return select(self.edge_mask, 1.0 - clear, apply("to_float", self.stencil))

    def color(self, shaded: Sequence[Node], background: Node | float) -> Node:
        """Equation 5 over a background: the mean of the layers' colours weighted by probability at edges, C_1 inside."""
        weights = [layer.probability for layer in self.layers]
        total, mixed = weights[0], weights[0] * shaded[0]
        for w, c in zip(weights[1:], shaded[1:]):
            total, mixed = total + w, mixed + w * c
        soft = mixed / maximum(total, 1e-12) if len(weights) > 1 else shaded[0]
        alpha = self.silhouette()
        front = select(self.edge_mask, soft, shaded[0])
        return front * alpha + background * (1.0 - alpha)

    # ---- attributes

    @property
    def face_boxes(self) -> Node:
        """For each view and face the pixels it can own."""
        t, views = self.topology, self.atlas.views
        rows = [lookup(stop_gradient(self.segments), np.concatenate([v * len(t.edges) + t.face_edges[:, k] for v in range(views)]))
                for k in range(3)]
        low = [select(s.x < 1e8, minimum(s.xy, s.zw), 1e9) for s in rows]
        high = [select(s.x < 1e8, maximum(s.xy, s.zw), -1e9) for s in rows]
        low, high = minimum(minimum(low[0], low[1]), low[2]), maximum(maximum(high[0], high[1]), high[2])
        return _boxes(low, high, low.x < 1e8, self.softness.r + 0.05, len(t.faces), self.atlas)

    def corners(self, table: Node, per_view: bool = False) -> list[Node]:
        """Tables (views x faces) of an attribute at the three sorted corners of each face."""
        t, views = self.topology, self.atlas.views
        step = t.vertex_count if per_view else 0
        return [lookup(table, np.concatenate([v * step + t.sorted_faces[:, k] for v in range(views)])) for k in range(3)]

    def barycentrics(self, layer: Layer) -> list[Node]:
        """Perspective-correct barycentrics at the layer's point, clamped to the face (homogeneous edge functions relative to the
        point; Olano and Greer 1997). A third each, without gradient, where the face is too thin on screen for fp32 to tell."""
        scale = compose(self.atlas.width / 2, self.atlas.height / 2, 1.0)
        h = [apply("swizzle", lookup(c, layer.face, self.face_boxes), channels="xyw") * scale for c in self.corners(self.clip, True)]
        a = [x.xy - layer.point * x.z for x in h]
        e = [_cross2(a[1], a[2]), _cross2(a[2], a[0]), _cross2(a[0], a[1])]
        total = e[0] + e[1] + e[2]
        size = maximum(maximum(dot(a[0], a[0]), dot(a[1], a[1])), dot(a[2], a[2]))
        solid = absolute(total) > size * DEGENERATE
        total = select(solid, total, 1.0)
        b = [select(solid, clamp(x / total, 0.0, 1.0), 1 / 3) for x in e]
        norm = maximum(b[0] + b[1] + b[2], 1e-5)
        return [x / norm for x in b]

    def interpolate(self, layer: Layer, attribute: Node, weights: Sequence[Node] | None = None) -> Node:
        """A vertex attribute (V table) at the layer's point; zero where there is no face."""
        weights = weights or self.barycentrics(layer)
        values = [lookup(c, layer.face, self.face_boxes) for c in self.corners(attribute)]
        return weights[0] * values[0] + weights[1] * values[1] + weights[2] * values[2]

    def interpolate_constant(self, layer: Layer, corners: np.ndarray, weights: Sequence[Node] | None = None) -> Node:
        """A constant attribute given at the corners of each face, (F, 3, c) in the order of the mesh's faces, all of them."""
        weights = weights or self.barycentrics(layer)
        order = np.argsort(self.topology.faces, axis=1, kind="stable")
        sorted_corners = np.take_along_axis(np.asarray(corners)[self.topology.kept], order[..., None], 1)
        view = apply("cell_index", extent=self.atlas.extent, cell_w=self.atlas.width, cell_h=self.atlas.height)
        face = select(layer.face >= 0, layer.face - view * len(self.topology.faces), -1)
        values = [lookup(constant_table(sorted_corners[:, k]), face) for k in range(3)]
        return weights[0] * values[0] + weights[1] * values[1] + weights[2] * values[2]
