"""Distance "face": the paper's HardSoftRas with K depth peels (paper 3.4, Algorithm 2, equations 3 to 6)."""
from __future__ import annotations

import math
from collections.abc import Sequence

from ...graph.functions import apply, compose, constant_table, lookup, maximum, select, sigmoid, stop_gradient
from ...graph.ir import Node
from ...graph.ops.reduce import tiles_of
from ..atlas import Atlas
from ..topology import Topology
from .fragments import BIN, GUARDED, Fragments, Layer, around, listed_boxes
from .softness import Softness

GAP = 0.02  # by which fraction of its distance one pixel must be nearer than the next to be an edge


class PeeledFragments(Fragments):
    """Distance "face": the front faces, drawn hard, and in the edge mask the peels of the enlarged faces (paper 3.4.2).

    Equations 5 and 6 use soft fragments and the layers behind the first in the edge mask alone, so only faces that come near it are
    enlarged, and only edges near it are summed to. Both are listed on the device first.
    """

    def __init__(self, clip: Node, topology: Topology, atlas: Atlas, softness: Softness, near: float, faces: bool):
        super().__init__(clip, topology, atlas, softness, near, faces)
        self.edge_mask, self.bins = self._edges(topology, atlas, softness)
        codes = [select(self.edge_mask, code, -1) for code in self._peels()]
        if faces:
            codes[0] = select(codes[0] >= 0, codes[0], select(self.front >= 0, self.front * 2 + 1, -1))
        edges = [apply("nearest_edge", code, constant_table(topology.face_edges), self.segments, self.position,
                       self.edge_mask, face_count=len(topology.faces), edge_count=len(topology.edges)) for code in codes]
        self.layers = [self._layer(*of) for of in zip(codes, edges, self._segments_of(edges))]

    def _edges(self, topology: Topology, atlas: Atlas, softness: Softness) -> tuple[Node, Node]:
        """The edge mask, and the bins in which it is 1."""
        if softness.edges == "all":
            mask = apply("broadcast", apply("literal", value=1), extent=atlas.extent)
            return mask, apply("broadcast", apply("literal", value=1), extent=tiles_of(atlas.extent, *BIN))
        front = self.front if softness.edges == "coverage" else self._steps(topology, atlas)
        steps = {} if front is self.front else {"steps": True}
        tiles = apply("edge_tiles", front, reach=softness.reach, tile=GUARDED, **steps)
        window = {"cell_w": atlas.width, "cell_h": atlas.height, "tile": GUARDED}
        across = apply("covered_window", front, tiles, dx=softness.reach, dy=0, **window, **steps)
        mask = apply("edge_mask", across, tiles, dx=0, dy=softness.reach, **window)
        marked = apply("marked", mask, width=BIN[0], height=BIN[1])
        return apply("inside_tiles", mask, tiles, tile=GUARDED), marked  # guards do not see what is absent behind an image

    def _steps(self, topology: Topology, atlas: Atlas) -> Node:
        """What is covered, with the pixels that a neighbour of another depth makes edges."""
        front = self._front()
        depth = apply("front_depth", front, stop_gradient(self.clip), constant_table(topology.sorted_faces), self.position,
                      face_count=len(topology.faces), vertices=topology.vertex_count, cell_w=atlas.width, cell_h=atlas.height)
        return apply("depth_steps", depth, gap=GAP, cell_w=atlas.width, cell_h=atlas.height)

    def _peels(self) -> list[Node]:
        """The codes of each layer; of use in the edge mask alone."""
        listed = listed_boxes(self.face_boxes, self.bins, each=6)
        inputs = self.clip, constant_table(self.topology.sorted_faces), listed.entries, listed.running
        attrs = {**self.draw, "radius": float(self.softness.r), "slots": listed.entries.extent.count}
        if self.softness.layers == 1:
            return [apply("rasterize", *inputs, **attrs)]
        codes = [apply("rasterize_first", *inputs, **attrs)]
        for _ in range(self.softness.layers - 1):
            codes.append(apply("rasterize_peel", *inputs, codes[-1], **attrs))
        return [code.x for code in codes]

    def _segments_of(self, edges: Sequence[Node]) -> list[Node]:
        """The segment of each layer's edge. No pixel of a mask of coverage is further from it than `reach`; of another mask those that
        are have no gradient that fp32 could tell from 0."""
        count, s = len(self.topology.edges), self.segments
        reach = max(self.softness.r, math.sqrt(2) * self.softness.reach) + 0.05
        if self.softness.edges != "coverage":
            reach = max(reach, 17.0 * self.softness.width)
        boxes = around(s, s.x < 1e8, reach, self._view(count), self.atlas)
        listed = listed_boxes(boxes, self.bins, each=1)
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
