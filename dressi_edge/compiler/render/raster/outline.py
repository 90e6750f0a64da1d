"""Distance "outline": alpha by the distance to the nearest fold or boundary edge beside which there is nothing (docs/conventions.md)."""
from __future__ import annotations

from collections.abc import Sequence

from ...graph.functions import apply, constant_table, lookup, select, sigmoid, stop_gradient
from ...graph.ir import Node
from ...graph.ops.compact import Compact
from ..atlas import Atlas
from ..topology import Topology
from .fragments import BIN, GUARDED, Fragments, Layer, around, listed_boxes, near_faces
from .softness import Softness


class OutlineFragments(Fragments):
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
        edges = self._listed(folds)
        segments = self._listed_segments(edges)
        fixed = stop_gradient(segments)
        exists, view = edges.entries >= 0, apply("idiv", edges.entries, count)
        boxes = around(fixed, exists, r + 0.05, view, atlas)
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
        self.edges, self.segments_listed = edges, segments
        self.layers = [Layer(face, hard, dist, probability, point, select(hard, 3, apply("bit_and", shown, 3)))]

    def _listed(self, folds: Node) -> Compact:
        """The fold and boundary edges that may be outline for some pixel: what is not near a pixel without a face is for none."""
        gaps = apply("vacant", self.front, width=BIN[0], height=BIN[1])
        boxes = around(folds, folds.x < 1e8, float(self.softness.r) + 1.75, self._view(len(self.topology.edges)), self.atlas)
        return listed_boxes(boxes, gaps, each=6)

    def _owners(self, edges: Compact, view: Node) -> Node:
        """For each listed edge, four times the face (over all views) that it shows, plus the corner that is not on it."""
        t = self.topology
        edge = select(edges.entries >= 0, edges.entries - view * len(t.edges), 0)
        return lookup(constant_table(t.edge_faces[:, 0] * 4 + t.far_corners), edge) + view * (4 * len(t.faces))

    def silhouette(self) -> Node:
        return self.layers[0].probability

    def color(self, shaded: Sequence[Node], background: Node | float) -> Node:
        """Equation 5 over a background."""
        alpha = self.silhouette()
        return shaded[0] * alpha + background * (1.0 - alpha)
