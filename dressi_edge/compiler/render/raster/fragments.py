"""What both distances share: which face each pixel shows, barycentrics, attributes at points of faces, boxes and lists of edges.

In: clip coordinates (views x vertices), topology, an atlas. Out: `Layer`s, and what is interpolated in them. Forward only: every
gradient comes from the AD.
"""
from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ...graph.functions import (
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
    sqrt,
    stop_gradient,
    to_int,
)
from ...graph.ir import Node, table
from ...graph.ops.compact import Compact, compact, count_set
from ...graph.ops.join import portion
from ...graph.ops.reduce import TILE
from ..atlas import Atlas
from ..topology import Topology
from .softness import Softness

GUARDED = (TILE, TILE // 2)  # pixels of the tiles that are drawn or not
BIN = (8, 4)  # pixels of the bins that say what of the mesh may be left out
# Twice the area of a face over the square of its size as seen from the pixel: below this it is rounding noise, as is its inverse.
DEGENERATE = 1e-6


def cross2(a: Node, b: Node) -> Node:
    return a.x * b.y - a.y * b.x


def screen_segments(ends: Iterable[Node], atlas: Atlas, near: float) -> Node:
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
    origin = atlas.corner(view)
    lo = to_int(clamp(low + half - (reach - 0.5), 0.0, limit))
    hi = to_int(clamp(high + half + (reach + 0.5), 0.0, limit))
    box = compose(lo + origin, hi + origin)
    return select(exists, box, 0)


def around(segments: Node, exists: Node, reach: float, view: Node, atlas: Atlas) -> Node:
    """`_boxes` of screen segments."""
    return _boxes(minimum(segments.xy, segments.zw), maximum(segments.xy, segments.zw), exists, reach, view, atlas)


def listed_boxes(boxes: Node, bins: Node, each: int) -> Compact:
    """The boxes with pixels in a marked bin."""
    return compact(apply("meets_tiles", boxes, bins, tile=BIN), each)


def _over(face: Node, value: Node) -> Node:
    """A value at each pixel of the image of faces: one for all of them (1 x 1) is broadcast."""
    return value if value.extent == face.extent else apply("broadcast", value, extent=face.extent)


def near_faces(face: Node, value: Node, apart: bool = False) -> Node:
    """A value in the tiles that have pixels of a face, zero outside: what depends on it alone is drawn there only; with `apart` in passes
    of its own. One value for all pixels (1 x 1) is broadcast to them."""
    value = _over(face, value)
    how = {"tile": (TILE, TILE), **({"apart": True} if apart else {})}
    return apply("inside_tiles", value, apply("occupied", face, width=TILE, height=TILE), **how)


@dataclass(frozen=True)
class Layer:
    """One peel: global face index (-1 none; None where only silhouettes are asked for), hard flag, signed distance in pixels,
    probability (0 where there is none), and the point of the face nearest to the pixel, relative to the cell's centre. far: the corner
    (0..2) of the sorted face that is not on the edge on which the point lies, 3 where it lies on none; None where that is not known.
    tiles: of GUARDED pixels, 0 where no pixel has a face; None where most may."""

    face: Node | None
    hard: Node
    dist: Node
    probability: Node
    point: Node
    far: Node | None = None
    tiles: Node | None = None

    def near(self, value: Node) -> Node:
        """A value in the tiles that have pixels of a face, zero outside; as `near_faces`."""
        if self.tiles is None:
            return near_faces(self.face, value)
        return apply("inside_tiles", _over(self.face, value), self.tiles, tile=GUARDED)


@dataclass(frozen=True, eq=False)
class Span:
    """The faces of one part among those that are drawn together: from `first` on, with a topology of their own, and their vertices from
    `first_vertex` on."""

    topology: Topology
    first: int
    first_vertex: int


class Fragments:
    """What a renderer gives, and what all of them share: one layer or more, how they compose, and attributes at their points. faces:
    whether it matters which face a pixel shows, and not only whether there is one. at_corners: `color` takes colours of the three corners
    of each face, tables of views x faces, not of pixels."""

    at_corners = False

    def __init__(self, clip: Node, topology: Topology, atlas: Atlas, softness: Softness, near: float, faces: bool):
        self.clip, self.topology, self.atlas, self.softness, self.near, self.faces = clip, topology, atlas, softness, near, faces
        self.position = atlas.position
        self.ends = [np.concatenate([v * topology.vertex_count + topology.edges[:, k] for v in range(atlas.views)]) for k in (0, 1)]
        self.segments = screen_segments((lookup(stop_gradient(clip), e) for e in self.ends), atlas, near)  # of all edges; no gradient
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

    @property
    def drawn(self) -> Node:
        """What is there once it is drawn which faces pixels show."""
        return self.front

    def _listed_segments(self, edges: Compact) -> Node:
        """Those of listed edges."""
        return screen_segments((edges.lookup(self.clip, e) for e in self.ends), self.atlas, self.near)

    def _nearest(self, segment: Node, hard: Node) -> tuple[Node, Node]:
        """Signed distance of the pixel to its segment, and the point of the face nearest to it."""
        a, b = segment.xy, segment.zw
        d, o = b - a, self.position - a
        squared = maximum(dot(d, d), 1e-20)
        t = dot(o, d) / squared
        between = apply("bit_and", t > 0.0, t < 1.0)
        end = self.position - select(t < 0.5, a, b)
        far = select(between, absolute(cross2(d, o)) / sqrt(squared), sqrt(dot(end, end)))
        return select(hard, far, -far), select(hard, self.position, self._foot(segment))

    def _foot(self, segment: Node) -> Node:
        """The point of the pixel's segment that is nearest to it."""
        a, b = segment.xy, segment.zw
        d = b - a
        return a + d * clamp(dot(self.position - a, d) / maximum(dot(d, d), 1e-20), 0.0, 1.0)

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

    def _vertices(self, span: Span | None) -> np.ndarray:
        """(3, views x faces): which of a table of vertices, of all parts or of the span's, the sorted corners of each face are."""
        return np.tile((span or self).topology.sorted_faces.T, self.atlas.views)

    def _view_vertices(self, span: Span | None) -> np.ndarray:
        """The same of a table of views x vertices, of all parts."""
        faces, step = (span or self).topology.sorted_faces.T + (span.first_vertex if span else 0), self.topology.vertex_count
        return np.concatenate([faces + v * step for v in range(self.atlas.views)], 1)

    def view_corners(self, table: Node, span: Span | None = None) -> list[Node]:
        """Tables (views x faces) of a table of views x vertices, of all parts, at the three sorted corners of each face."""
        return [lookup(table, names) for names in self._view_vertices(span)]

    def _at_corners(self, layer: Layer, values: Node, names: np.ndarray, span: Span | None) -> list[Node]:
        """Of each pixel what a table has at the three corners of the layer's face. names: (3, views x faces), of the span if it is given:
        which of its entries each corner has."""
        face, boxes = self.face_over_views(layer, span), self._boxes(span)
        return [lookup(lookup(values, corner), face, boxes) for corner in names]

    def _screen_corners(self, layer: Layer, span: Span | None) -> list[Node]:
        """The corners of the layer's face: x, y in pixels from the cell's centre times w, and w."""
        scale = compose(self.atlas.width / 2, self.atlas.height / 2, 1.0)
        return [apply("swizzle", c, channels="xyw") * scale for c in self._at_corners(layer, self.clip, self._view_vertices(span), span)]

    def barycentrics(self, layer: Layer, span: Span | None = None) -> list[Node]:
        """Perspective-correct barycentrics at the layer's point, clamped to the face (homogeneous edge functions relative to the
        point; Olano and Greer 1997). A third each, without gradient, where the face is too thin on screen for fp32 to tell.

        A point on an edge has nothing of the far corner, wherever that is: it is put across from the edge, as far away as the edge is
        long, so that the other two keep their digits however thin the face is. The gradient by it is 0 anyhow."""
        h = self._screen_corners(layer, span)
        a = [x.xy - layer.point * x.z for x in h]
        if layer.far is not None:
            start, stop = (stop_gradient(select(equal(layer.far, k), a[1], a[k])) for k in (0, 2))
            across = compose(start.x + start.y - stop.y, start.y + stop.x - start.x)
            a = [select(equal(layer.far, k), across, x) for k, x in enumerate(a)]
        e = [cross2(a[1], a[2]), cross2(a[2], a[0]), cross2(a[0], a[1])]
        total = e[0] + e[1] + e[2]
        size = maximum(maximum(dot(a[0], a[0]), dot(a[1], a[1])), dot(a[2], a[2]))
        solid = absolute(total) > size * DEGENERATE
        total = select(solid, total, 1.0)
        b = [select(solid, clamp(x / total, 0.0, 1.0), 1 / 3) for x in e]
        norm = maximum(b[0] + b[1] + b[2], 1e-5)
        return [x / norm for x in b]

    def slopes(self, layer: Layer, corners: np.ndarray, span: Span | None = None) -> tuple[Node, Node]:
        """How a constant attribute of corners, (F, 3, c) as in `interpolate_constant`, changes from pixel to pixel across and down at the
        layer's point: its derivatives, worked out from the face alone. Zero where the face is too thin for fp32 to tell; no gradient."""
        topology = (span or self).topology
        over, boxes = self.face_over_views(layer, span), self._boxes(span)
        h = [stop_gradient(lookup(c, over, boxes)) for c in self.view_corners(self.clip, span)]
        sorted_corners = np.take_along_axis(np.asarray(corners)[topology.kept], order_of(topology)[..., None], 1)
        face = self.face_in_view(layer, span)
        return self.plane(layer, h, [lookup(constant_table(sorted_corners[:, k]), face) for k in range(3)])[1:]

    def plane(self, layer: Layer, h: Sequence[Node], values: Sequence[Node]) -> tuple[Node, Node, Node]:
        """An attribute with these values at the corners of each pixel's face, whose clip coordinates are h: at the layer's point, in
        perspective, and its derivatives by pixels across and down. Zero where the face is too thin for fp32 to tell.

        It is sum(e u) / sum(e) with the edge functions e of `barycentrics`, which are linear in the point."""
        scale = compose(self.atlas.width / 2, self.atlas.height / 2, 1.0)
        h, point = [apply("swizzle", x, channels="xyw") * scale for x in h], stop_gradient(layer.point)
        a = [x.xy - point * x.z for x in h]
        e = [cross2(a[(k + 1) % 3], a[(k + 2) % 3]) for k in range(3)]
        across = [h[(k + 2) % 3].z * a[(k + 1) % 3].y - h[(k + 1) % 3].z * a[(k + 2) % 3].y for k in range(3)]
        down = [h[(k + 1) % 3].z * a[(k + 2) % 3].x - h[(k + 2) % 3].z * a[(k + 1) % 3].x for k in range(3)]
        total = e[0] + e[1] + e[2]
        size = maximum(maximum(dot(a[0], a[0]), dot(a[1], a[1])), dot(a[2], a[2]))
        solid = absolute(total) > size * DEGENERATE
        inverse = select(solid, 1.0, 0.0) / select(solid, total, 1.0)
        mean = (e[0] * values[0] + e[1] * values[1] + e[2] * values[2]) * inverse

        def slope(by: list[Node]) -> Node:
            return (by[0] * (values[0] - mean) + by[1] * (values[1] - mean) + by[2] * (values[2] - mean)) * inverse

        return mean, slope(across), slope(down)

    @property
    def view(self) -> Node:
        """The view of each pixel."""
        return self.atlas.view

    def face_in_view(self, layer: Layer, span: Span | None = None) -> Node:
        """The layer's face as its view (and the span, if given) numbers it; -1 where there is none."""
        face = select(layer.face >= 0, layer.face - self.view * len(self.topology.faces), -1)
        if span is None:
            return face
        inside = apply("bit_and", face >= span.first, face < span.first + len(span.topology.faces))
        return select(inside, face - span.first, -1)

    def face_over_views(self, layer: Layer, span: Span | None = None) -> Node:
        """The layer's face as tables of views x faces (of the span, if given) have it; -1 where there is none."""
        if span is None:
            return layer.face
        face = self.face_in_view(layer, span)
        return select(face >= 0, face + self.view * len(span.topology.faces), -1)

    def _boxes(self, span: Span | None) -> Node:
        """The pixels that each face, of the span if it is given, can own."""
        boxes = self.face_boxes
        return boxes if span is None else portion(boxes, span.first, len(span.topology.faces), self.atlas.views)

    def interpolate(self, layer: Layer, attribute: Node, weights: Sequence[Node] | None = None, span: Span | None = None) -> Node:
        """A vertex attribute (a table of all vertices, or of the span's) at the layer's point; zero where there is no face."""
        weights = weights or self.barycentrics(layer, span)
        values = self._at_corners(layer, attribute, self._vertices(span), span)
        return weights[0] * values[0] + weights[1] * values[1] + weights[2] * values[2]

    def interpolate_indexed(self, layer: Layer, attribute: Node, faces: np.ndarray, weights: Sequence[Node] | None = None,
                            span: Span | None = None) -> Node:
        """An attribute of corners at the layer's point: a table, and (F, 3) which entry each corner has, of all of the mesh's faces."""
        weights, topology = weights or self.barycentrics(layer, span), (span or self).topology
        index = np.take_along_axis(np.asarray(faces)[topology.kept], order_of(topology), 1)
        values = self._at_corners(layer, attribute, np.tile(index.T, self.atlas.views), span)
        return weights[0] * values[0] + weights[1] * values[1] + weights[2] * values[2]

    def of_face(self, layer: Layer, values: Node, span: Span | None = None) -> Node:
        """The entry of a table of views x faces (of all, or of the span) that belongs to the layer's face; zero where there is none."""
        return lookup(values, self.face_over_views(layer, span), self._boxes(span))

    def interpolate_constant(self, layer: Layer, corners: np.ndarray, weights: Sequence[Node] | None = None,
                             span: Span | None = None) -> Node:
        """A constant attribute given at the corners of each face, (F, 3, c) in the order of the mesh's faces, all of them."""
        weights, topology = weights or self.barycentrics(layer, span), (span or self).topology
        sorted_corners = np.take_along_axis(np.asarray(corners)[topology.kept], order_of(topology)[..., None], 1)
        face = self.face_in_view(layer, span)
        values = [lookup(constant_table(sorted_corners[:, k]), face) for k in range(3)]
        return weights[0] * values[0] + weights[1] * values[1] + weights[2] * values[2]


def order_of(topology: Topology) -> np.ndarray:
    """(F, 3): which corner of each face as the mesh has it is the first, second and third of the sorted one."""
    return np.argsort(topology.faces, axis=1, kind="stable")
