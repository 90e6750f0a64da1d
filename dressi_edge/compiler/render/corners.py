"""What a material reads where colours are worked out at the corners of faces, not at pixels: `Surface`, over tables of views x faces.

The renderer then interpolates linearly on the face (Gouraud 1971), so whatever is linear there is exact. Whether a material has read what
is not, a texture or the pixel, a surface knows afterwards (`linear`): such faces are better shaded at pixels where they weigh much.
"""
from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ..graph.functions import apply, compose, constant_table, lookup, stop_gradient
from ..graph.ir import Node, table
from .normals import unit_face_normals
from .raster.fragments import order_of
from .surface import Surface
from .texture import Wrap

if TYPE_CHECKING:
    from .frame import Frame
    from .part import Part
    from .raster import Span


class CornerSurface(Surface):
    """The surface of a part at corner `number` (0 to 2, by ascending vertex index) of each of its faces, in each view of the frame."""

    def __init__(self, frame: Frame, number: int, part: Part, span: Span | None):
        super().__init__(frame, 0, part, span)
        self.number, self.count, self.linear = number, frame.atlas.views, True
        self._faces = np.tile(np.arange(len(self.part.topology.faces)), self.count)

    @cached_property
    def face(self) -> Node:
        """The face as its part numbers it, an int."""
        return constant_table(self._faces)

    @cached_property
    def face_over_views(self) -> Node:
        """The entry's own number."""
        return constant_table(np.arange(len(self._faces)))

    @cached_property
    def inside(self) -> Node:
        return constant_table(np.ones(len(self._faces), int))

    @cached_property
    def barycentric(self) -> Node:
        """vec3: 1 for this corner."""
        return apply("broadcast", compose(*(float(k == self.number) for k in range(3))), extent=table(len(self._faces)))

    @cached_property
    def geometric_normal(self) -> Node:
        return lookup(unit_face_normals(self.part.positions, self.part.topology.faces), self._faces)

    @cached_property
    def view(self) -> Node:
        return constant_table(np.repeat(np.arange(self.count), len(self._faces) // self.count))

    def of_view(self, values: Node) -> Node:
        """Of each entry's view."""
        if self.count == 1:
            return values if values.extent.count == 1 else lookup(values, np.zeros(len(self._faces), int))
        return lookup(values, np.repeat(np.arange(self.count), len(self._faces) // self.count))

    def vertex(self, table: Node) -> Node:
        """An attribute of the part's vertices. Raises InputError."""
        self._check_vertex(table)
        return lookup(table, self.part.topology.sorted_faces[self._faces, self.number])

    def indexed(self, table: Node, faces: np.ndarray) -> Node:
        """An attribute that corners share as they like. Raises InputError."""
        return lookup(table, self._own(self._check_indexed(table, faces)))

    def corner(self, values: np.ndarray) -> Node:
        """A constant attribute of the faces' corners. Raises InputError."""
        return constant_table(self._own(self._corners(values)))

    def per_face(self, values: np.ndarray) -> Node:
        """A constant of each face. Raises InputError."""
        return constant_table(self._check_per_face(values)[self.part.topology.kept][self._faces])

    def _own(self, corners: np.ndarray) -> np.ndarray:
        """Of something at the corners of the mesh's faces, that at this corner of each entry's."""
        t = self.part.topology
        return np.asarray(corners)[t.kept][np.arange(len(t.faces)), order_of(t)[:, self.number]][self._faces]

    def slopes(self, values: np.ndarray) -> tuple[Node, Node]:
        """How much a constant attribute of the faces' corners changes from pixel to pixel there, across and down. Raises InputError."""
        self.linear, t, fragments = False, self.part.topology, self.frame.fragments
        corners = np.take_along_axis(self._corners(values)[t.kept], order_of(t)[..., None], 1)[self._faces]
        here = replace(self._layer, point=fragments.corner_point(self.number, self._span))
        h = [stop_gradient(x) for x in fragments.view_corners(self.frame.clip, self._span)]
        return fragments.plane(here, h, [constant_table(corners[:, k]) for k in range(3)])[1:]

    def texture(self, image: Node, uv: Node | None = None, wrap: Wrap = "repeat", gradient: str = "exact", lod: Node | None = None) -> Node:
        """A texture at the corner. Its gradient by "inverse_uv", of one pixel for each texel, comes from pixels alone."""
        self.linear = False
        return super().texture(image, uv, wrap, "none" if gradient == "inverse_uv" else gradient, lod)

    def pixel(self) -> Node:
        """vec2: where the corner is in the picture, from the upper left corner."""
        self.linear, a = False, self.frame.atlas
        return self.frame.fragments.corner_point(self.number, self._span) + compose(a.width / 2, a.height / 2)
