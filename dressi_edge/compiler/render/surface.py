"""What a pixel sees of one part in one layer: position, normal, texture coordinates and the like, each computed only if it is read.

Values are those at the layer's point: the pixel's centre where the face covers it, the nearest point of the face where it only comes near
(paper 3.4; docs/conventions.md). Pixels that see something else have values of no meaning; `inside` says where they mean something.
"""
from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ...cache.errors import InputError
from ..graph.functions import compose, constant_table, dot, lookup, maximum, normalize, sqrt
from ..graph.ir import Node
from ..graph.optable import as_node
from .normals import unit_face_normals, vertex_normals
from .tangents import handedness, tangent_table
from .texture import Wrap, level_of_detail, probes, sample_probes, sample_texture

if TYPE_CHECKING:
    from .frame import Frame
    from .part import Part
    from .raster import Span


class Surface:
    """In a material: `s.position`, `s.normal`, ... are vec3 in world space unless they say otherwise, over all pixels of the frame.
    number: the layer, 0 in front; span: the part's faces among those that are drawn together, None where they are all."""

    def __init__(self, frame: Frame, number: int, part: Part, span: Span | None):
        self.frame, self.number, self.part = frame, number, part
        self._layer, self._span = frame.fragments.layers[number], span

    @cached_property
    def face(self) -> Node:
        """The face as its part numbers it, an int; -1 where the layer shows none of this part."""
        return self.frame.fragments.face_in_view(self._layer, self._span)

    @cached_property
    def inside(self) -> Node:
        """1 where the layer's face is one of this part, soft rim included, else 0."""
        return self.face_over_views >= 0

    @cached_property
    def face_over_views(self) -> Node:
        """The face as tables of views x faces of this part have it; -1 where there is none."""
        return self.frame.fragments.face_over_views(self._layer, self._span)

    @cached_property
    def barycentric(self) -> Node:
        """vec3: the weights of the face's corners, by ascending vertex index; in perspective."""
        return compose(*self.frame.weights(self.number, self._span))

    @cached_property
    def position(self) -> Node:
        return self.vertex(self.part.positions)

    @cached_property
    def normal(self) -> Node:
        """Of length 1, on the side from which faces are seen anticlockwise; by the part's `normals`."""
        part = self.part
        if part.normals == "flat":
            return self.geometric_normal
        if part.normals == "file":
            return normalize(self.corner(np.asarray(part.mesh.normals)[part.mesh.normal_faces]))
        return normalize(self.vertex(vertex_normals(part.positions, part.topology)))

    @cached_property
    def geometric_normal(self) -> Node:
        """The face's own, of length 1."""
        faces, views = self.part.topology.faces, self.frame.views.count
        normals = unit_face_normals(self.part.positions, faces)
        if views > 1:
            normals = lookup(normals, np.tile(np.arange(len(faces)), views))
        return self.frame.fragments.of_face(self._layer, normals, self._span)

    @cached_property
    def uv(self) -> Node:
        """vec2: texture coordinates, v down. Raises InputError where the mesh has none."""
        return self.corner(self.uv_corners)

    @property
    def uv_corners(self) -> np.ndarray:
        """(F, 3, 2): the texture coordinates of the faces' corners. Raises InputError where the mesh has none."""
        mesh = self.part.mesh
        if mesh.uvs is None:
            raise InputError(f"part {self.part.name}: its mesh has no texture coordinates, and its material reads them")
        return np.asarray(mesh.uvs)[mesh.uv_faces]

    @cached_property
    def tangent(self) -> Node:
        """vec4: the direction in which u grows, at right angles to the normal, of length 1; and 1, or -1 where the texture is mirrored:
        the bitangent is w (normal x tangent), against v. Zero where texture coordinates lie on a line. Raises InputError."""
        part = self.part
        if part.mesh.uvs is None:
            raise InputError(f"part {part.name}: its mesh has no texture coordinates, and its material reads tangents")
        along, n = self.indexed(*tangent_table(part.positions, part.mesh)), self.normal
        hand = self.per_face(handedness(np.asarray(part.mesh.uvs, float)[np.asarray(part.mesh.uv_faces)])[:, None])
        return compose(normalize(along - n * dot(along, n), 1e-12), hand)

    @cached_property
    def view(self) -> Node:
        """Which of the frame's views the pixel belongs to, an int."""
        return self.frame.view

    @cached_property
    def eye(self) -> Node:
        """The centre of the pixel's camera; of an orthographic one, where its depths count from."""
        return self.of_view(self.frame.views.position())

    @cached_property
    def to_eye(self) -> Node:
        """The direction from the surface to the eye, of length 1; of an orthographic camera, against the way it looks."""
        views = self.frame.views
        return views.either(lambda: normalize(self.of_view(views.rows[2].xyz)), lambda: normalize(self.eye - self.position), self.of_view)

    @cached_property
    def distance(self) -> Node:
        """From the eye, along the ray; of an orthographic camera, the depth."""
        def from_eye() -> Node:
            d = self.eye - self.position
            return sqrt(maximum(dot(d, d), 1e-30))

        return self.frame.views.either(lambda: self.depth, from_eye, self.of_view)

    @cached_property
    def depth(self) -> Node:
        """From the eye, along the camera's axis."""
        row = self.of_view(self.frame.views.rows[2])
        return -(dot(row.xyz, self.position) + row.w)

    @cached_property
    def camera_normal(self) -> Node:
        """The normal in the camera's own axes: x right, y up, z towards the eye."""
        rows = [self.of_view(row) for row in self.frame.views.rows]
        return compose(*(dot(row.xyz, self.normal) for row in rows))

    @property
    def step(self) -> Node:
        """The step of the phase that the frame belongs to, an int of extent 1x1; 0 where it belongs to none."""
        return as_node(0) if self.frame.step is None else self.frame.step

    def of_view(self, values: Node) -> Node:
        """The entry of a table of the frame's views that belongs to the pixel."""
        return self.frame.of_view(values)

    def vertex(self, table: Node) -> Node:
        """An attribute of the part's vertices: a float or vec table of as many entries. Raises InputError."""
        self._check_vertex(table)
        return self.frame.fragments.interpolate(self._layer, table, self.frame.weights(self.number, self._span), self._span)

    def _check_vertex(self, table: Node) -> None:
        count = len(self.part.mesh.positions)
        if not isinstance(table, Node) or table.extent.count != count:
            raise InputError(f"part {self.part.name}: a vertex attribute is {table!r:.60}; a table of its {count} vertices is needed")

    def indexed(self, table: Node, faces: np.ndarray) -> Node:
        """An attribute that corners share as they like: a float or vec table, and (F, 3) entries for all faces of the mesh. InputError."""
        faces = self._check_indexed(table, faces)
        return self.frame.fragments.interpolate_indexed(self._layer, table, faces, self.frame.weights(self.number, self._span), self._span)

    def _check_indexed(self, table: Node, faces: np.ndarray) -> np.ndarray:
        faces, count = np.asarray(faces), len(self.part.mesh.faces)
        if faces.shape != (count, 3) or not isinstance(table, Node) or faces.min() < 0 or faces.max() >= table.extent.count:
            raise InputError(f"part {self.part.name}: an attribute of corners has indices of shape {faces.shape} into {table!r:.60}; "
                             f"({count}, 3) indices of its entries are needed")
        return faces

    def corner(self, values: np.ndarray) -> Node:
        """A constant attribute of the faces' corners, (F, 3, c) for all faces of the mesh. Raises InputError."""
        weights = self.frame.weights(self.number, self._span)
        return self.frame.fragments.interpolate_constant(self._layer, self._corners(values), weights, self._span)

    def slopes(self, values: np.ndarray) -> tuple[Node, Node]:
        """How much a constant attribute of the faces' corners (as in `corner`) changes from pixel to pixel, across and down: its
        derivatives, worked out of the face, without gradient. Raises InputError."""
        return self.frame.fragments.slopes(self._layer, self._corners(values), self._span)

    def _corners(self, values: np.ndarray) -> np.ndarray:
        values, count = np.asarray(values, float), len(self.part.mesh.faces)
        if values.ndim != 3 or values.shape[:2] != (count, 3) or not 1 <= values.shape[2] <= 4:
            raise InputError(f"part {self.part.name}: an attribute of corners has shape {values.shape}; ({count}, 3, 1 to 4) is needed")
        return values

    def per_face(self, values: np.ndarray) -> Node:
        """A constant of each face, (F, c) for all faces of the mesh. Raises InputError."""
        return lookup(constant_table(self._check_per_face(values)[self.part.topology.kept]), self.face)

    def _check_per_face(self, values: np.ndarray) -> np.ndarray:
        values, count = np.asarray(values, float), len(self.part.mesh.faces)
        if values.ndim != 2 or len(values) != count:
            raise InputError(f"part {self.part.name}: an attribute of faces has shape {values.shape}; ({count}, 1 to 4) is needed")
        return values

    def texture(self, image: Node, uv: Node | None = None, wrap: Wrap = "repeat", gradient: str = "exact", lod: Node | None = None) -> Node:
        """The bilinear sample of an image at `uv` or the part's own coordinates, zero outside the part; with a level of detail the
        trilinear one; see `texture.sample_texture`."""
        return sample_texture(image, self.uv if uv is None else uv, wrap=wrap, gradient=self._asked(gradient), covered=self.inside,
                              step=self.step, lod=lod)

    def _asked(self, gradient: str) -> str:
        """The gradient of a texture, none in a picture that no phase steps: nobody asks for it there."""
        return "none" if gradient == "inverse_uv" and self.step is None else gradient

    def level_of_detail(self, image: Node, corners: np.ndarray | None = None, bias: float = 0.0) -> Node:
        """The mip level of an image at which a pixel sees texels of its own size, a float; corners: (F, 3, 2) coordinates by which it is
        sampled, the part's own by default; see `texture.level_of_detail`."""
        return level_of_detail(*self.slopes(self.uv_corners if corners is None else corners), image.extent, bias)

    def probes(self, image: Node, uv: Node, corners: np.ndarray, count: int, wrap: Wrap = "repeat", gradient: str = "exact",
               bias: float = 0.0) -> Node:
        """The mean of so many trilinear samples of an image along the longer axis of what a pixel sees of it, at uv, which corners
        (F, 3, 2) give; zero outside the part; see `texture.probes`."""
        apart, lod = probes(*self.slopes(corners), image.extent, count, bias)
        return sample_probes(image, uv, apart, lod, count, wrap, self._asked(gradient), self.inside)

    def pixel(self) -> Node:
        """vec2: the pixel's centre in its picture, from the upper left corner."""
        return self.frame.pixel
