"""HardSoftRas (paper 3.4, Algorithm 2, equations 3 to 6): soft silhouettes and colours on hardware rasterization.

In: clip coordinates (views x vertices), the mesh's topology, an atlas. Out: `Outline` or `Layers` (see `Softness.distance`): for each
layer which face, its signed distance and probability, barycentrics for attributes; and the blends. Forward only: every gradient comes
from the AD.
"""
from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
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
    equal,
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
from ..ir import Extent, Node, image, table
from ..ops.compact import Compact, compact, count_set
from ..ops.reduce import TILE
from ..topology import Topology

MAX_LAYERS = 5
GUARDED = (TILE, TILE // 2)  # pixels of the tiles that are drawn or not
BIN = (8, 4)  # pixels of the bins that say what of the mesh may be left out
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


DISTANCES = ("outline", "face")


@dataclass(frozen=True)
class Softness:
    """r, sigma, delta in pixels (defaults of paper 3.4.3: sigma = r / 7, delta = r); layers K.

    distance: "face" is the paper's, to the nearest edge of each layer's face, softened where the edge mask of half width delta says;
    "outline", for one layer, is to the nearest fold or boundary edge of the mesh and softens only pixels beside the outline, so that
    edges inside the shape do not count: its gradient is nearer to that of covered area (docs/numerics.md) and costs less. By default
    outline for one layer without a delta, face otherwise.
    """

    r: float = 2.0
    sigma: float | None = None
    delta: float | None = None
    layers: int = 1
    distance: str | None = None

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
        one = self.layers == 1 and self.delta is None
        if self.distance is None:
            object.__setattr__(self, "distance", "outline" if one else "face")
        if self.distance not in DISTANCES:
            raise InputError(f"distance is {self.distance!r}; allowed: {' '.join(DISTANCES)}")
        if self.distance == "outline" and not one:
            raise InputError("distance outline is for one layer and has no delta; distance face has both")

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


def _segments(ends: Iterable[Node], atlas: Atlas, near: float) -> Node:
    """Screen segments between clip coordinates, relative to the cell's centre, clipped to the near plane; 1e9 where wholly behind."""
    scale = compose(atlas.width / 2, atlas.height / 2, 1.0)
    a, b = (apply("swizzle", e, channels="xyw") * scale for e in ends)
    a_behind, b_behind = a.z < near, b.z < near
    crosses = not_equal(a_behind, b_behind)
    cut = a + (b - a) * ((near - a.z) / select(crosses, b.z - a.z, 1.0))
    a, b = select(apply("bit_and", crosses, a_behind), cut, a), select(apply("bit_and", crosses, b_behind), cut, b)
    a, b = a.xy / maximum(a.z, near), b.xy / maximum(b.z, near)
    return select(apply("bit_and", a_behind, b_behind), 1e9, compose(a, b))


def _boxes(low: Node, high: Node, exists: Node, reach: float, view: Node, atlas: Atlas) -> Node:
    """Half-open boxes of the atlas' pixels whose centres are within `reach` of screen bounds; empty where nothing exists."""
    half = compose(atlas.width / 2, atlas.height / 2)
    limit = compose(float(atlas.width), float(atlas.height))
    origin = compose(apply("imod", view, atlas.columns) * atlas.width, apply("idiv", view, atlas.columns) * atlas.height)
    lo = to_int(clamp(low + half - (reach - 0.5), 0.0, limit))
    hi = to_int(clamp(high + half + (reach + 0.5), 0.0, limit))
    box = compose(lo + origin, hi + origin)
    return select(exists, box, 0)


def _around(segments: Node, exists: Node, reach: float, view: Node, atlas: Atlas) -> Node:
    """`_boxes` of screen segments."""
    return _boxes(minimum(segments.xy, segments.zw), maximum(segments.xy, segments.zw), exists, reach, view, atlas)


def _listed(boxes: Node, bins: Node, each: int) -> Compact:
    """The boxes with pixels in a marked bin."""
    return compact(apply("meets_tiles", boxes, bins, tile=BIN), each)


def near_faces(face: Node, value: Node) -> Node:
    """A value in the tiles that have pixels of a face, zero outside: what depends on it alone is drawn there only."""
    return apply("inside_tiles", value, apply("occupied", face, width=TILE, height=TILE), tile=(TILE, TILE))


@dataclass(frozen=True)
class Layer:
    """One peel: global face index (-1 none; None where only silhouettes are asked for), hard flag, signed distance in pixels,
    probability (0 where there is none), and the point of the face nearest to the pixel, relative to the cell's centre. far: the corner
    (0..2) of the sorted face that is not on the edge on which the point lies, 3 where it lies on none; None where that is not known."""

    face: Node | None
    hard: Node
    dist: Node
    probability: Node
    point: Node
    far: Node | None = None


class _Rasterized:
    """What both distances share: one layer or more, their blends, and attributes at their points. faces: whether it matters which face
    a pixel shows, and not only whether there is one."""

    def __init__(self, clip: Node, topology: Topology, atlas: Atlas, softness: Softness, near: float, faces: bool):
        self.clip, self.topology, self.atlas, self.softness, self.near, self.faces = clip, topology, atlas, softness, near, faces
        self.position = apply("cell_position", extent=atlas.extent, cell_w=atlas.width, cell_h=atlas.height)
        self.ends = [np.concatenate([v * topology.vertex_count + topology.edges[:, k] for v in range(atlas.views)]) for k in (0, 1)]
        self.segments = _segments((lookup(stop_gradient(clip), e) for e in self.ends), atlas, near)  # of all edges; no gradient
        self.cells = {"cell_w": atlas.width, "cell_h": atlas.height, "columns": atlas.columns}
        self.draw = {"extent": atlas.extent, "views": atlas.views, "vertices": topology.vertex_count,
                     "face_count": len(topology.faces), "near": float(near), **self.cells}
        self.front = self._front() if faces else self._covered()

    def _front(self) -> Node:
        """The face in front of each pixel, over all views; -1 where there is none."""
        return apply("rasterize_hard", self.clip, constant_table(self.topology.sorted_faces.reshape(-1)), **self.draw)

    def _covered(self) -> Node:
        """0 where there is a face in front, -1 where there is none."""
        t = self.topology
        behind = count_set(select(stop_gradient(self.clip).w >= self.near, 0, 1)) if t.closed.any() else constant_table(np.ones(1, int))
        return apply("rasterize_covered", self.clip, constant_table(np.column_stack([t.faces, t.closed])), behind, **self.draw)

    def _listed_segments(self, edges: Compact) -> Node:
        """Those of listed edges."""
        return _segments((edges.lookup(self.clip, e) for e in self.ends), self.atlas, self.near)

    def _nearest(self, segment: Node, hard: Node) -> tuple[Node, Node]:
        """Signed distance of the pixel to its segment, and the point of the face nearest to it."""
        a, b = segment.xy, segment.zw
        d, o = b - a, self.position - a
        squared = maximum(dot(d, d), 1e-20)
        t = dot(o, d) / squared
        between = apply("bit_and", t > 0.0, t < 1.0)
        end = self.position - select(t < 0.5, a, b)
        far = select(between, absolute(_cross2(d, o)) / sqrt(squared), sqrt(dot(end, end)))
        return select(hard, far, -far), select(hard, self.position, a + d * clamp(t, 0.0, 1.0))

    @property
    def face_boxes(self) -> Node:
        """For each view and face the pixels it can own."""
        t, views = self.topology, self.atlas.views
        rows = [lookup(self.segments, np.concatenate([v * len(t.edges) + t.face_edges[:, k] for v in range(views)]))
                for k in range(3)]
        low = [select(s.x < 1e8, minimum(s.xy, s.zw), 1e9) for s in rows]
        high = [select(s.x < 1e8, maximum(s.xy, s.zw), -1e9) for s in rows]
        low, high = minimum(minimum(low[0], low[1]), low[2]), maximum(maximum(high[0], high[1]), high[2])
        return _boxes(low, high, low.x < 1e8, self.softness.r + 0.05, self._view(len(t.faces)), self.atlas)

    def _view(self, per_view: int) -> Node:
        """The view of each entry of a table of views x per_view."""
        return apply("idiv", apply("texel_index", extent=table(self.atlas.views * per_view)), per_view)

    def _center(self, view: Node) -> Node:
        """The middle of a view's cell, in pixels of the atlas."""
        a = self.atlas
        return compose((apply("to_float", apply("imod", view, a.columns)) + 0.5) * float(a.width),
                       (apply("to_float", apply("idiv", view, a.columns)) + 0.5) * float(a.height))

    def corners(self, table: Node, per_view: bool = False) -> list[Node]:
        """Tables (views x faces) of an attribute at the three sorted corners of each face."""
        t, views = self.topology, self.atlas.views
        step = t.vertex_count if per_view else 0
        return [lookup(table, np.concatenate([v * step + t.sorted_faces[:, k] for v in range(views)])) for k in range(3)]

    def barycentrics(self, layer: Layer) -> list[Node]:
        """Perspective-correct barycentrics at the layer's point, clamped to the face (homogeneous edge functions relative to the
        point; Olano and Greer 1997). A third each, without gradient, where the face is too thin on screen for fp32 to tell.

        A point on an edge has nothing of the far corner, wherever that is: it is put across from the edge, as far away as the edge is
        long, so that the other two keep their digits however thin the face is. The gradient by it is 0 anyhow."""
        scale = compose(self.atlas.width / 2, self.atlas.height / 2, 1.0)
        h = [apply("swizzle", lookup(c, layer.face, self.face_boxes), channels="xyw") * scale for c in self.corners(self.clip, True)]
        a = [x.xy - layer.point * x.z for x in h]
        if layer.far is not None:
            start, stop = (stop_gradient(select(equal(layer.far, k), a[1], a[k])) for k in (0, 2))
            across = compose(start.x + start.y - stop.y, start.y + stop.x - start.x)
            a = [select(equal(layer.far, k), across, x) for k, x in enumerate(a)]
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


class Outline(_Rasterized):
    """Distance "outline": the front faces, drawn hard, and around the mesh's fold and boundary edges the nearest of them.

    A pixel beside an uncovered one, across the nearest point of its edge, has an alpha of its distance to that edge; so has any
    uncovered pixel within r. All others have the stencil's. The edges are listed on the device first. With faces all is drawn together
    where there are faces, else only what is beside the outline.
    """

    def __init__(self, clip: Node, topology: Topology, atlas: Atlas, softness: Softness, near: float, faces: bool):
        super().__init__(clip, topology, atlas, softness, near, faces)
        count, r = len(topology.edges), float(softness.r)
        folds = apply("fold_segments", stop_gradient(clip), constant_table(topology.edge_vertices), edge_count=count, views=atlas.views,
                      vertices=topology.vertex_count, near=float(near), cell_w=atlas.width, cell_h=atlas.height)
        gaps = apply("vacant", self.front, width=BIN[0], height=BIN[1])  # away from them a fold is outline for no pixel
        edges = _listed(_around(folds, folds.x < 1e8, r + 1.75, self._view(count), atlas), gaps, each=6)
        segments = self._listed_segments(edges)
        fixed = stop_gradient(segments)
        exists, view = edges.entries >= 0, apply("idiv", edges.entries, count)
        boxes = _around(fixed, exists, r + 0.05, view, atlas)
        listed = {"extent": atlas.extent, "radius": r, "edge_count": count, "slots": edges.entries.extent.count, **self.cells}
        slot = apply("rasterize_segments", fixed, edges.entries, self.front, edges.running, **listed)
        tiles = apply("occupied", slot, width=GUARDED[0], height=GUARDED[1])
        place = apply("inside_tiles", slot + 1, tiles, tile=GUARDED)  # so that guards see where it is 0
        hard = self.front >= 0
        shown = lookup(self._owners(edges, view), place - 1)
        face = None
        if faces:
            face = select(hard, self.front, select(place > 0, apply("shift_right", shown, 2), -1))
            place = near_faces(face, place)
        segment = apply("lookup_near", segments, place, boxes, fixed, self._center(view), reach=r, channel=0)
        dist, point = self._nearest(segment, hard)
        probability = select(place > 0, sigmoid(dist * (1.0 / softness.width)), apply("to_float", hard))
        self.layers = [Layer(face, hard, dist, probability, point, select(hard, 3, apply("bit_and", shown, 3)))]

    def _owners(self, edges: Compact, view: Node) -> Node:
        """For each listed edge, four times the face (over all views) that it shows, plus the corner that is not on it."""
        t = self.topology
        count, first = len(t.edges), t.edge_faces[:, 0]
        far = np.array((2, 0, 1))[(t.face_edges[first] == np.arange(count)[:, None]).argmax(axis=1)]
        edge = select(edges.entries >= 0, edges.entries - view * count, 0)
        return lookup(constant_table(first * 4 + far), edge) + view * (4 * len(t.faces))

    def silhouette(self) -> Node:
        return self.layers[0].probability

    def color(self, shaded: Sequence[Node], background: Node | float) -> Node:
        """Equation 5 over a background."""
        alpha = self.silhouette()
        return shaded[0] * alpha + background * (1.0 - alpha)


class Layers(_Rasterized):
    """Distance "face": the front faces, drawn hard, and in the edge mask the peels of the enlarged faces (paper 3.4.2).

    Equations 5 and 6 use soft fragments and the layers behind the first in the edge mask alone, so only faces that come near it are
    enlarged, and only edges near it are summed to. Both are listed on the device first.
    """

    def __init__(self, clip: Node, topology: Topology, atlas: Atlas, softness: Softness, near: float, faces: bool):
        super().__init__(clip, topology, atlas, softness, near, faces)
        tiles = apply("edge_tiles", self.front, reach=softness.reach, tile=GUARDED)
        window = {"cell_w": atlas.width, "cell_h": atlas.height, "tile": GUARDED}
        across = apply("covered_window", self.front, tiles, dx=softness.reach, dy=0, **window)
        mask = apply("edge_mask", across, tiles, dx=0, dy=softness.reach, **window)
        self.edge_mask = apply("inside_tiles", mask, tiles, tile=GUARDED)  # guards do not see what is absent behind an image
        self.bins = apply("marked", mask, width=BIN[0], height=BIN[1])
        codes = [select(self.edge_mask, code, -1) for code in self._peels()]
        if faces:
            codes[0] = select(codes[0] >= 0, codes[0], select(self.front >= 0, self.front * 2 + 1, -1))
        edges = [apply("nearest_edge", code, constant_table(topology.face_edges), self.segments, self.position,
                       self.edge_mask, face_count=len(topology.faces), edge_count=len(topology.edges)) for code in codes]
        self.layers = [self._layer(*of) for of in zip(codes, edges, self._segments_of(edges))]

    def _peels(self) -> list[Node]:
        """The codes of each layer; of use in the edge mask alone."""
        listed = _listed(self.face_boxes, self.bins, each=6)
        inputs = self.clip, constant_table(self.topology.sorted_faces), listed.entries, listed.running
        attrs = {**self.draw, "radius": float(self.softness.r), "slots": listed.entries.extent.count}
        if self.softness.layers == 1:
            return [apply("rasterize", *inputs, **attrs)]
        codes = [apply("rasterize_first", *inputs, **attrs)]
        for _ in range(self.softness.layers - 1):
            codes.append(apply("rasterize_peel", *inputs, codes[-1], **attrs))
        return [code.x for code in codes]

    def _segments_of(self, edges: Sequence[Node]) -> list[Node]:
        """The segment of each layer's edge. No pixel of the mask is further from it than `reach`."""
        count, s = len(self.topology.edges), self.segments
        reach = max(self.softness.r, math.sqrt(2) * self.softness.reach) + 0.05
        boxes = _around(s, s.x < 1e8, reach, self._view(count), self.atlas)
        listed = _listed(boxes, self.bins, each=1)
        segments = self._listed_segments(listed)
        where = lookup(boxes, listed.entries), stop_gradient(segments), self._center(apply("idiv", listed.entries, count))
        places = [select(edge >= 0, lookup(listed.slots, edge) + 1, 0) for edge in edges]
        found = []
        for first in range(0, len(places), 4):  # four to an image: their sums share a loop
            some = places[first:first + 4]
            together = some[0] if len(some) == 1 else compose(*some, *[0] * (4 - len(some)))
            found += [apply("lookup_near", segments, together, *where, reach=reach, channel=k) for k in range(len(some))]
        return found

    def _layer(self, code: Node, edge: Node, segment: Node) -> Layer:
        hard = select(code >= 0, apply("bit_and", code, 1), 0)
        dist, point = self._nearest(segment, hard)
        probability = select(edge >= 0, sigmoid(dist * (1.0 / self.softness.width)), 0.0)
        return Layer(apply("shift_right", code, 1) if self.faces else None, hard, dist, probability, point)

    def silhouette(self) -> Node:
        """Equation 6: 1 - prod(1 - D_k) at edges, the stencil elsewhere."""
        clear = 1.0 - self.layers[0].probability
        for layer in self.layers[1:]:
            clear = clear * (1.0 - layer.probability)
        return select(self.edge_mask, 1.0 - clear, apply("to_float", self.front >= 0))

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


def rasterized(clip: Node, topology: Topology, atlas: Atlas, softness: Softness, near: float, faces: bool = True) -> Outline | Layers:
    """A mesh rasterized as `softness` says: clip coordinates (views x vertices), `near` the smallest w in front of the cameras.
    faces: what pixels show is asked for, colours or attributes; without, only silhouettes, whose layers have no `face` and which draw
    half of a closed surface (`ops/raster.py`)."""
    return (Outline if softness.distance == "outline" else Layers)(clip, topology, atlas, softness, near, faces)
