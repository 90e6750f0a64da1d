"""Outline distance with occluding contours: also where one surface hides another the picture is composed of both sides.

An edge is a contour for a covered pixel if what lies on one side of it is deeper than the edge by more than `gap` times its distance
(docs/conventions.md, "Occluding contours"). Where nothing lies behind, `OutlineFragments` says the same with the background. Silhouettes
are left as they are; the second layer is drawn in the tiles that have pixels on the far side of a contour.
"""
from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ...graph.functions import (
    absolute,
    apply,
    clamp,
    compose,
    constant_table,
    dot,
    equal,
    length,
    lookup,
    maximum,
    minimum,
    not_equal,
    scale_gradient,
    select,
    sqrt,
    stop_gradient,
    to_int,
)
from ...graph.ir import Node
from ...graph.ops.compact import Compact, compact
from ..atlas import Atlas
from ..topology import Topology
from .fragments import GUARDED, Layer, Span, around, cross2, near_faces
from .outline import OutlineFragments
from .softness import Softness

NARROWEST = 0.05  # pixels, of the sigmoid beside the pixel's own width
STEEP = 8.0  # change of a face's weights per pixel up to which the gradient follows it


class ContourFragments(OutlineFragments):
    """Layers: what is in front at the pixel (or beside an outline), and beside a contour what is on its other side: of a pixel on the far
    side the face that the contour's edge shows, at its nearest point; on the near side the face in front at the pixel across. gap: how
    much deeper what is hidden must be, as a fraction of the edge's distance."""

    def __init__(self, clip: Node, topology: Topology, atlas: Atlas, softness: Softness, near: float, gap: float):
        super().__init__(clip, topology, atlas, softness, near, True)
        count, r, listed, segments = len(topology.edges), float(softness.r), self.edges, self.segments_listed
        held = stop_gradient(clip)
        fixed, exists, view = stop_gradient(segments), listed.entries >= 0, apply("idiv", listed.entries, count)
        nearness = compose(*(1.0 / maximum(listed.lookup(held, e).w, float(near)) for e in self.ends))  # linear on screen
        code = apply("rasterize_contours", fixed, nearness, listed.entries, self.front, held, constant_table(topology.sorted_faces),
                     listed.running, extent=atlas.extent, radius=r, gap=float(gap), edge_count=count, face_count=len(topology.faces),
                     vertices=topology.vertex_count, slots=listed.entries.extent.count, **self.cells)
        tiles = apply("occupied", code, width=GUARDED[0], height=GUARDED[1])
        place = apply("inside_tiles", apply("shift_right", code, 1) + 1, tiles, tile=GUARDED)
        self.tiles = tiles
        self.beside = place > 0  # a contour is within r
        self.outer = apply("bit_and", self.beside, apply("bit_and", code, 1))
        boxes = around(fixed, exists, r + 0.05, view, atlas)
        boxes = select(apply("meets_tiles", boxes, tiles, tile=GUARDED), boxes, 0)  # most edges are no contour for any pixel
        self._where = place, boxes, fixed, self._center(view)
        segment = self._along(segments)
        dist, foot = self._nearest(segment, select(self.outer, 0, 1))
        nearer = self._covered_at(dist)
        self.share = select(self.outer, 1.0 - nearer, nearer), select(self.outer, nearer, 1.0 - nearer)  # of the own face, of the other
        shown = lookup(self._owners(listed, view), place - 1)
        beyond = stop_gradient(self._beyond(segment))
        across = apply("fetch", self.front, to_int(beyond + self._middle) + self.atlas.corner(self.view))
        face = select(self.outer, apply("shift_right", shown, 2), select(self.beside, across, -1))
        nowhere = apply("broadcast", 0, extent=atlas.extent)  # of a pixel whose own face is another this is not in front
        self.layers = [*self.layers, Layer(face, nowhere, dist, select(self.outer, nearer, 0.0), select(self.outer, foot, beyond),
                                           select(self.outer, apply("bit_and", shown, 3), 3), tiles)]

    def _listed(self, folds: Node) -> Compact:
        """All fold and boundary edges: each may be a contour."""
        return compact(select(folds.x < 1e8, 1, 0), 6)

    def _covered_at(self, dist: Node) -> Node:
        """How much of the picture the near side of a contour is at a signed distance from it: a sigmoid's mean over a pixel across the
        edge. Its slopes at distances a pixel apart add up to 1, however narrow it is and wherever pixels lie to the edge. The sigmoid is
        narrower than sigma by the pixel: both together spread as sigmoid(d / sigma) does (variances: pi^2 / 3 sigma^2, and 1 / 12)."""
        width = math.sqrt(max(self.softness.width ** 2 - 0.25 / math.pi ** 2, NARROWEST ** 2))

        def integral(x: Node) -> Node:
            size = absolute(x)
            return (x + size) * 0.5 + apply("log", apply("exp", size * (-1.0 / width)) + 1.0) * width

        return integral(dist + 0.5) - integral(dist - 0.5)

    def barycentrics(self, layer: Layer, span: Span | None = None) -> list[Node]:
        """Of a face that is seen so nearly edge on that its weights change by more than STEEP a pixel, the gradient by where it lies is
        that of one on which they change by as much: what the one centre that meets it says of it is noise, and without bounds."""
        weights = super().barycentrics(layer, span)
        if layer is self.layers[-1]:
            return weights
        h = [stop_gradient(x) for x in self._screen_corners(layer, span)]
        a = [x.xy - stop_gradient(layer.point) * x.z for x in h]
        pairs = (1, 2), (2, 0), (0, 1)
        slopes = [a[j] * h[k].z - a[k] * h[j].z for j, k in pairs]
        most = maximum(maximum(dot(slopes[0], slopes[0]), dot(slopes[1], slopes[1])), dot(slopes[2], slopes[2]))
        total = absolute(sum((cross2(a[j], a[k]) for j, k in pairs[1:]), cross2(a[1], a[2])))
        limit = select(layer.hard, minimum(total * STEEP / maximum(sqrt(most), 1e-10), 1.0), 1.0)
        return [scale_gradient(x, limit) for x in weights]

    def _along(self, values: Node) -> Node:
        """Of each pixel what a table of the listed edges has of its contour."""
        return apply("lookup_near", values, *self._where, reach=float(self.softness.r), channel=0)

    def _firsts(self, span: Span | None) -> np.ndarray:
        """(views x edges,): the first face of each edge as tables of views x faces, of the span if it is given, have it; -1 if it is of
        another."""
        t, faces = self.topology, (span or self).topology.faces
        face = t.edge_faces[:, 0] - (span.first if span else 0)
        inside = (face >= 0) & (face < len(faces))
        return np.concatenate([np.where(inside, face + v * len(faces), -1) for v in range(self.atlas.views)])

    def _at_corners(self, layer: Layer, values: Node, names: np.ndarray, span: Span | None) -> list[Node]:
        """On the far side of a contour the point lies on the edge: what the edge's ends have has the gradient, summed with the edge's own
        over the pixels beside it, and the corner that is not on it has none. Nor has anything on the near side."""
        if layer is not self.layers[-1]:
            return super()._at_corners(layer, values, names, span)
        face, firsts = self.face_over_views(layer, span), self._firsts(span)
        a, b, c = np.where(firsts >= 0, names[:, firsts], -1)
        far = np.tile(self.topology.far_corners, self.atlas.views)
        start, end = (self._along(self.edges.lookup(values, names)) for names in (np.where(far == 0, b, a), np.where(far == 2, b, c)))
        held = [stop_gradient(lookup(lookup(values, corner), face)) for corner in names]
        ends = start, select(equal(layer.far, 0), start, end), end
        return [select(apply("bit_and", self.outer, not_equal(layer.far, k)), *x) for k, x in enumerate(zip(ends, held))]

    def of_face(self, layer: Layer, values: Node, span: Span | None = None) -> Node:
        """See `Fragments.of_face`; with the gradient of `_at_corners`."""
        if layer is not self.layers[-1]:
            return super().of_face(layer, values, span)
        held = stop_gradient(lookup(values, self.face_over_views(layer, span)))
        return select(self.outer, self._along(self.edges.lookup(values, self._firsts(span))), held)

    @property
    def _middle(self) -> Node:
        return compose(self.atlas.width / 2, self.atlas.height / 2)

    def _beyond(self, segment: Node) -> Node:
        """The centre of the pixel that lies across the edge, relative to the cell's: of the one that holds the point a pixel beyond the
        edge's nearest point."""
        foot = self._foot(segment)
        across = foot - self.position
        at = apply("floor", foot + across / maximum(length(across), 1e-10) + self._middle)
        last = compose(float(self.atlas.width - 1), float(self.atlas.height - 1))
        return clamp(at, 0.0, last) + 0.5 - self._middle

    def color(self, shaded: Sequence[Node], background: Node | float) -> Node:
        """Beside a contour the pixel's own colour and that of the other side, by their shares, and all of it over the background as
        equation 5 says. What lies across has no gradient of its own. The other side has passes of its own: few tiles have contours."""
        own, other = shaded
        other = select(self.outer, other, stop_gradient(other)) * self.share[1]
        less = self.share[0] - 1.0
        if other.channels < 4:  # one image of both
            both = self._apart(compose(other, less))
            other, less = apply("swizzle", both, channels="xyz"[:other.channels]), apply("swizzle", both, channels="xyzw"[other.channels])
        else:
            less, other = self._apart(less), self._apart(other)
        both = near_faces(self.layers[0].face, own * (1.0 + less) + other)  # one pass leaves out what shows nothing
        alpha = self.silhouette()
        return both * alpha + background * (1.0 - alpha)

    def _apart(self, value: Node) -> Node:
        """A value beside contours, zero elsewhere, in passes of its own."""
        return apply("inside_tiles", select(self.beside, value, 0.0), self.tiles, tile=GUARDED, apart=True)
