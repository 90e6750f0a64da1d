"""What the cameras see, as images over all views of a frame (docs/conventions.md, "Atlas"); each made only if something reads it.

In: parts, views, a renderer, a background. Out: `color` and `alpha` as the renderer composes them, softly at outlines; everything else
(`mask`, `depth`, `normal`, `position`, `uv`, `face`, `part`, ...) of what is in front at the pixel's centre, zero (ids: -1) elsewhere.
"""
from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np

from ...cache.errors import InputError
from ..graph.functions import apply, compose, constant_table, lookup, normalize, select, to_float, to_int
from ..graph.ir import UNIT, Node, rebuild, remade, table, topological
from ..graph.ops.join import join
from .alike import runs
from .atlas import Atlas
from .camera import ViewTable
from .corners import CornerSurface
from .material import shaded
from .part import Parts
from .raster import Fragments, Renderer, Span, near_faces
from .surface import Surface


class Frame:
    """views: those that are drawn; atlas: their cells. all_views: the cells of all views of the scene, chosen: which of them this frame
    draws (an int of extent 1x1), None for all. sizes: (views of the scene, 2), width and height of each picture, where some are smaller
    than their cells. encode: from linear radiance to the colours of the picture. gain: factors of the colours of all views, a table of
    vec3, as pictures have them that were not exposed alike; the background is not multiplied. step: of the phase, an int.
    who: of part number k, words for errors of its material."""

    def __init__(self, parts: Parts, views: ViewTable, atlas: Atlas, renderer: Renderer, background: Node, *,
                 all_views: Atlas | None = None, chosen: Node | None = None, sizes: np.ndarray | None = None,
                 encode: Callable[[Node], Node] | None = None, gain: Node | None = None, step: Node | None = None,
                 who: Callable[[int], str] = lambda k: f"the material of part {k}"):
        self.parts, self.views, self.atlas, self.renderer, self.background = parts, views, atlas, renderer, background
        self.all_views, self.chosen, self.encode, self.step, self._who = all_views or atlas, chosen, encode, step, who
        self._sizes = sizes
        self._gain = gain if gain is None or chosen is None else lookup(gain, chosen)
        self._weights: dict[tuple[int, int, int], list[Node]] = {}
        self._surfaces: dict[tuple[int, int], Surface] = {}
        self._runs: dict[tuple[int, bool], list[tuple[int, Surface]]] = {}

    # ---- what is drawn

    @cached_property
    def clip(self) -> Node:
        """Clip coordinates of all vertices of all parts, view-major."""
        return self.parts.clip(self.views)

    @cached_property
    def fragments(self) -> Fragments:
        """Which faces pixels show."""
        return self._draw(True)

    @cached_property
    def _outline(self) -> Fragments:
        """Only whether there is one."""
        return self._draw(False)

    def _draw(self, faces: bool) -> Fragments:
        renderer = self.renderer.seen_by(self.views) if hasattr(self.renderer, "seen_by") else self.renderer
        return renderer.draw(self.clip, self.parts.topology, self.atlas, self.views.near, faces)

    def settled(self, roots: list[Node]) -> list[Node]:
        """The roots of a plan; where they read which faces pixels show, silhouettes are taken from the same drawing."""
        if not {"_outline", "fragments"} <= self.__dict__.keys() or self.fragments.drawn not in set(topological(roots)):
            return roots
        same = {self._outline.silhouette(): self.fragments.silhouette(),
                self._outline.layers[0].hard: self.fragments.layers[0].hard}
        new = rebuild(roots, lambda n, inputs: same[n] if n in same else remade(n, inputs))
        return [new[root] for root in roots]

    def surface(self, layer: int = 0, part: int = 0) -> Surface:
        """What pixels see of a part in a layer, soft rim included. Raises InputError where there is no such layer or part."""
        for what, k, count in (("layer", layer, len(self.fragments.layers)), ("part", part, len(self.parts.parts))):
            if not 0 <= k < count:
                raise InputError(f"{what} {k} of a frame that has {count}; 0 to {count - 1} are allowed")
        if (layer, part) not in self._surfaces:
            one = self.parts.parts[part]
            self._surfaces[layer, part] = Surface(self, layer, one, self.parts.span(part, one.topology))
        return self._surfaces[layer, part]

    def _together(self, layer: int, materials: bool) -> list[tuple[int, Surface]]:
        """What pixels see in a layer, each with the number of its first part: parts that are made alike (without `materials`, shaped alike)
        as one."""
        if (layer, materials) not in self._runs:
            self._runs[layer, materials] = [
                (k, self.surface(layer, k) if count == 1 else Surface(self, layer, part, self.parts.span(k, part.topology)))
                for k, count, part in runs(self.parts.parts, materials)]
        return self._runs[layer, materials]

    def weights(self, layer: int, span: Span | None) -> list[Node]:
        """Barycentrics of a layer's points on the faces of a span, or on all."""
        key = layer, *((span.first, len(span.topology.faces)) if span else (0, len(self.parts.topology.faces)))
        if key not in self._weights:
            self._weights[key] = self.fragments.barycentrics(self.fragments.layers[layer], span)
        return self._weights[key]

    # ---- pictures

    @cached_property
    def alpha(self) -> Node:
        """float: the silhouette, soft at outlines."""
        return self._outline.silhouette()

    @cached_property
    def color(self) -> Node:
        """vec3: the parts as their materials say, over the background."""
        def shade(s: Surface, part: int) -> Node:
            color = shaded(s.part.material, s, self._who(part))
            color = self.encode(color) if self.encode else color
            return color if self._gain is None else color * s.of_view(self._gain)

        return self._composed(shade, True, self.background)

    def soft(self, read: Callable[[Surface], Node], background: Node | float = 0.0) -> Node:
        """What `read` gives of shapes, such as `lambda s: s.depth`, composed over the background as colours are: soft at outlines, and at
        contours where the renderer has them. The pictures below change from one surface to the next without a gradient; this has it."""
        return self._composed(lambda s, part: read(s), False, background)

    def composed(self, layers: list[Node], background: Node | float | None = None) -> Node:
        """Values of each layer as the renderer composes them, over the background."""
        return self.fragments.color(layers, self.background if background is None else background)

    def _composed(self, read: Callable[[Surface, int], Node], materials: bool, background: Node | float) -> Node:
        if self.fragments.at_corners:
            corners, linear = zip(*(self._at_corner(read, k) for k in range(3)))
            layers = range(1, 1 + self.fragments.at_pixels(all(linear)))
            return self.fragments.color(corners, background, [self._in_layer(read, k, materials) for k in layers])
        return self.composed([self._in_layer(read, k, materials) for k in range(len(self.fragments.layers))], background)

    def _in_layer(self, read: Callable[[Surface, int], Node], layer: int, materials: bool) -> Node:
        """Of a layer; each part's, or that of parts that are made alike, is worked out in the tiles that show it."""
        total, together, shown = None, self._together(layer, materials), self.fragments.layers[layer]
        if shown.tiles is not None and len(together) == 1:
            return shown.near(read(together[0][1], together[0][0]))
        for k, s in together:
            value = near_faces(s.face_over_views, read(s, k), apart=len(together) > 1)
            total = value if total is None else select(s.inside, value, total)
        return total if len(together) == 1 else shown.near(total)  # nothing elsewhere

    def _at_corner(self, read: Callable[[Surface, int], Node], number: int) -> tuple[Node, bool]:
        """Of a corner of each face, a table of views x faces; and whether all that was read is linear on faces."""
        total, linear, extent = None, True, table(self.atlas.views * len(self.parts.topology.faces))
        for k, part in enumerate(self.parts.parts):
            s = CornerSurface(self, number, part, self.parts.span(k, part.topology))
            value = read(s, k)
            linear &= s.linear
            value = apply("broadcast", value, extent=s.inside.extent) if value.extent == UNIT else value
            total = value if total is None else join(total, value, self.atlas.views)
        assert total.extent == extent
        return total, linear

    @cached_property
    def mask(self) -> Node:
        """float: 1 where a part is in front at the pixel's centre, else 0."""
        return to_float(self._outline.layers[0].hard)

    def of(self, read: Callable[[Surface], Node], none: float = 0.0, layer: int = 0, soft: bool = False) -> Node:
        """What `read` gives of the surfaces of a layer, each part's in its pixels, `none` where nothing is in front. soft: also beside
        outlines, at the nearest points of what is beside."""
        return self._of(read, [self.surface(layer, k) for k in range(len(self.parts.parts))], none, layer, soft)

    def _shape(self, read: Callable[[Surface], Node]) -> Node:
        """What `read` gives of shapes alone."""
        return self._of(read, [s for _, s in self._together(0, False)])

    def _of(self, read: Callable[[Surface], Node], surfaces: list[Surface], none: float = 0.0, layer: int = 0, soft: bool = False) -> Node:
        total = None
        for s in surfaces:
            value = near_faces(s.face_over_views, read(s))
            total = value if total is None else select(s.inside, value, total)
        shown = self.fragments.layers[layer]
        return select(shown.face >= 0 if soft else shown.hard, total, none)

    @cached_property
    def position(self) -> Node:
        """vec3, in world space."""
        return self._shape(lambda s: s.position)

    @cached_property
    def normal(self) -> Node:
        """vec3 of length 1, in world space; by each part's `normals`."""
        return self._shape(lambda s: s.normal)

    @cached_property
    def geometric_normal(self) -> Node:
        """vec3 of length 1: of the faces."""
        return self._shape(lambda s: s.geometric_normal)

    @cached_property
    def camera_normal(self) -> Node:
        """vec3 of length 1, in the camera's axes: x right, y up, z towards the eye."""
        return self._shape(lambda s: s.camera_normal)

    @cached_property
    def depth(self) -> Node:
        """float: along the camera's axis."""
        return self._shape(lambda s: s.depth)

    @cached_property
    def distance(self) -> Node:
        """float: from the eye, along the ray."""
        return self._shape(lambda s: s.distance)

    @cached_property
    def uv(self) -> Node:
        """vec2: texture coordinates, v down."""
        return self._shape(lambda s: s.uv)

    @cached_property
    def barycentric(self) -> Node:
        """vec3: of the face, its corners by ascending vertex index."""
        return self._shape(lambda s: s.barycentric)

    @cached_property
    def face(self) -> Node:
        """int: the face as its part numbers it, of those with three different corners; -1 where there is none."""
        return self._id(lambda k: self.surface(0, k).face)

    @cached_property
    def part(self) -> Node:
        """int: the number of the part, in the order of adding; -1 where there is none."""
        return self._id(lambda k: apply("broadcast", k, extent=self.atlas.extent))

    def _id(self, number: Callable[[int], Node]) -> Node:
        total = None
        for k in range(len(self.parts.parts)):
            total = number(k) if total is None else select(self.surface(0, k).inside, number(k), total)
        return select(self.fragments.layers[0].hard, total, -1)

    # ---- views

    @cached_property
    def view(self) -> Node:
        """int: which view of the frame the pixel belongs to."""
        return self.atlas.view

    def of_view(self, table: Node) -> Node:
        """The entry of a table of the frame's views that belongs to the pixel."""
        if table.extent == UNIT:
            return table
        a = self.atlas
        corner = [(v % a.columns * a.width, v // a.columns * a.height) for v in range(a.views)]
        return lookup(table, self.view, constant_table([(x, y, x + a.width, y + a.height) for x, y in corner]))

    @cached_property
    def pixel(self) -> Node:
        """vec2: the pixel's centre in its picture, from the upper left corner."""
        a = self.atlas
        return a.position + compose(a.width / 2, a.height / 2)

    @cached_property
    def ray(self) -> Node:
        """vec3 of length 1: the direction in which the camera looks through the pixel, in world space."""
        a, k, rows = self.atlas, self.of_view(self.views.projection), [self.of_view(row).xyz for row in self.views.rows]

        def through() -> Node:
            x = (self.pixel.x * (2.0 / a.width) - 1.0 - k.z) / k.x
            y = (self.pixel.y * (2.0 / a.height) - 1.0 - k.w) / k.y
            return normalize(rows[0] * x - rows[1] * y - rows[2])

        return self.views.either(lambda: -normalize(rows[2]), through, self.of_view)

    @cached_property
    def valid(self) -> Node:
        """float: 1 in the picture of the pixel's camera, 0 beside it, where its cell is larger. Everything is drawn there too, as if the
        picture were larger; a mask for losses and metrics that shall not see it."""
        if self._sizes is None:
            return apply("broadcast", 1.0, extent=self.atlas.extent)
        size = self.per_view(self._sizes)
        return to_float((self.pixel.x < size.x) & (self.pixel.y < size.y))

    @property
    def border(self) -> Node | None:
        """`valid` where pictures have different sizes; None where all texels of a view are its picture's, and no loss needs a mask."""
        return None if self._sizes is None else self.valid

    @property
    def cell(self) -> tuple[int, int]:
        """Width and height of a view in the frame's images: what `convolve`, `ssim_loss`, `pyramid_l1` and the like want to know."""
        return self.atlas.width, self.atlas.height

    def per_view(self, values) -> Node:
        """Numbers of all views of the scene, (views,) or (views, channels), or a table of them, each over the pixels of its view: weights
        of views in a mask, exposures, colours. Raises InputError."""
        count = self.all_views.views
        if not isinstance(values, Node):
            values = np.asarray(values, float)
            if values.ndim not in (1, 2) or len(values) != count or values.ndim == 2 and not 1 <= values.shape[1] <= 4:
                raise InputError(f"values of views have shape {values.shape}; ({count},) or ({count}, 1 to 4) is needed")
            values = constant_table(values)
        if values.extent.count != count:
            raise InputError(f"values of views are {values!r} of {values.extent.count} entries; a table of {count} views is needed")
        if self.chosen is not None:
            values = lookup(values, self.chosen)
        image = self.of_view(values)
        return image if image.extent == self.atlas.extent else apply("broadcast", image, extent=self.atlas.extent)

    def at(self, image: Node) -> Node:
        """Of an image over all views of the scene, the views of this frame: the image itself, or the cell of the chosen view."""
        if self.chosen is None or not isinstance(image, Node) or image.extent == UNIT:
            return image
        if image.extent != self.all_views.extent:
            raise InputError(f"{image!r} is no image over all views of the scene, which is {self.all_views.extent}")
        return apply("fetch", image, to_int(self.pixel) + self.all_views.corner(self.chosen))

