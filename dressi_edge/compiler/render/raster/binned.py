"""Every face near a pixel, without layers: lists of faces by tile, and an online softmax over them (docs/conventions.md, "Every face").

Published as SoftRas (Liu et al. 2019) and PyTorch3D's `softmax_rgb_blend`. Colours are those of the faces' corners, linear on the face, and
for the faces that weigh most at a pixel those which their materials have there.
"""
from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ....cache.errors import InputError
from ...graph.functions import absolute, apply, clamp, compose, constant, constant_table, lookup, select
from ...graph.ir import UNIT, Node, table
from ...graph.ops import soft
from ...graph.ops.bins import Grid
from ...graph.ops.soft import LEAST, TURNS, listed_attrs, pair_attrs
from ...graph.ops.soft_mask import soft_masks
from ...graph.ops.soft_parts import Parts, find_parts, in_parts, join_parts
from ...graph.ops.tile_lists import Binned as Lists
from ...graph.ops.tile_lists import bin_faces
from ...graph.optable import as_node
from ..atlas import Atlas
from ..camera import ViewTable
from ..topology import Topology
from .fragments import Fragments, Layer, Span, screen_segments
from .softness import Softness

FARTHEST = 1e8  # pixels from the middle of the picture
OWN, MOST = 4, 8  # faces of a pixel that are shaded there: where a material asks for it, and at most


@dataclass(frozen=True)
class Range:
    """How depth is normalized: 1 at `near` units before the camera, 0 at `far`. Where `parallel` is 1 (or a table of views, 1 for those)
    it is what clip coordinates have: orthographic views."""

    near: float
    far: float
    parallel: bool | Node = False

    @property
    def base(self) -> float:
        """What is added to depths to have them normalized. They are kept without it, as -distance / (far - near), with all their
        digits."""
        return 1.0 if self.parallel is True else self.far / (self.far - self.near)

    def depth(self, clip: Node, vertices: int, views: int) -> Node:
        """Of clip coordinates, views x vertices: less where it is further."""
        by_distance = clip.w * (-1.0 / (self.far - self.near))
        if self.parallel is False:
            return by_distance
        by_plane = clip.z / clip.w * -1.0 + (1.0 - self.base)
        if self.parallel is True:
            return by_plane
        flat = lookup(self.parallel, np.repeat(np.arange(views), vertices)) if views > 1 else self.parallel
        return select(flat > 0.5, by_plane, by_distance)

    def nearest(self, near: float) -> float:
        """The depth of the cameras' near plane."""
        flat = 1.0 - self.base
        return flat if self.parallel is True else max(-near / (self.far - self.near), flat if self.parallel is not False else -math.inf)


class BinnedFragments(Fragments):
    """What pixels show in front is drawn hard, as layer 0; `silhouette` and `color` are of all faces near them. Layers 1 to `heaviest` are
    the faces with the largest weights in the colour, largest first."""

    at_corners = True

    def __init__(self, clip: Node, topology: Topology, atlas: Atlas, settings: Binned, span: Range, near: float, faces: bool):
        self.clip, self.topology, self.atlas, self.near, self.faces = clip, topology, atlas, near, faces
        self.settings, self.softness, self.position = settings, Softness(settings.r), atlas.position
        self.cells = {"cell_w": atlas.width, "cell_h": atlas.height, "columns": atlas.columns}
        self.draw = {"extent": atlas.extent, "views": atlas.views, "vertices": topology.vertex_count,
                     "face_count": len(topology.faces), "near": float(near), **self.cells}
        if settings.tile is None and len(topology.faces) > TURNS // 2:
            raise InputError(f"Binned: without tiles each pixel goes through {len(topology.faces)} faces; at most {TURNS // 2} are "
                             "allowed, for some drivers end loops of more than 65535 turns: give a tile")
        tile = settings.tile or (atlas.width, atlas.height)
        self.grid = Grid(atlas.views, len(topology.faces), atlas.width, atlas.height, atlas.columns, tile)
        self.range, self.blend = span, None
        self.pair = pair_attrs(self.grid, settings.r, settings.width, settings.squared, settings.hard, span.nearest(near))

    @cached_property
    def ends(self) -> list[np.ndarray]:
        t = self.topology
        return [np.concatenate([v * t.vertex_count + t.edges[:, k] for v in range(self.atlas.views)]) for k in (0, 1)]

    @cached_property
    def segments(self) -> Node:
        return screen_segments((lookup(apply("stop_gradient", self.clip), e) for e in self.ends), self.atlas, self.near)

    @cached_property
    def front(self) -> Node:
        return self._front() if self.faces else self._covered()

    @property
    def drawn(self) -> Node:
        return self.front if self.blend is None else self.blend

    @cached_property
    def layers(self) -> list[Layer]:
        hard = self.front >= 0
        nowhere = apply("broadcast", 0.0, extent=self.atlas.extent)
        front = Layer(self.front if self.faces else None, hard, nowhere, apply("to_float", hard), self.position)
        return [front, *(self._heavy(k) for k in range(self.heaviest))] if self.faces else [front]

    @property
    def heaviest(self) -> int:
        """How many of the faces that weigh most have layers of their own."""
        return OWN if self.settings.layers is None else self.settings.layers

    def at_pixels(self, linear: bool) -> int:
        """How many of them are shaded at pixels, where what materials read is linear on faces or is not."""
        return 0 if linear and self.settings.layers is None else self.heaviest

    @cached_property
    def _pairs(self) -> dict[Node, Node]:
        """Of a layer's face: weights of its second and third corner, depth, probability at each pixel."""
        return {}

    def _heavy(self, number: int) -> Layer:
        """The face that weighs most, after `number` others."""
        where, attrs = self._listed
        four = constant(np.zeros((1, 1, 4), int))
        for _ in range(number // 4 + 1):
            four = apply("soft_heaviest", *self.places, *where, four, **{**attrs, "each": TURNS // 5}, gamma=float(self.settings.gamma))
        face = apply("swizzle", four, channels="xyzw"[number % 4]) - 1
        shown, (v0, v1, v2) = face >= 0, (lookup(x, face, self.boxes) for x in self.places)
        settings = {k: self.pair[k] for k in ("radius", "sigma", "squared", "hard_only", "nearest")}
        pair = apply("soft_pair", v0, v1, v2, self.position, **settings)
        self._pairs[face] = pair
        b = [x * v.z for x, v in zip((1.0 - pair.x - pair.y, pair.x, pair.y), (v0, v1, v2))]
        mass = b[0] + b[1] + b[2]
        some = mass > 1e-20
        point = (v0.xy * b[0] + v1.xy * b[1] + v2.xy * b[2]) / select(some, mass, 1.0)
        point = apply("stop_gradient", select(some, point, self.position))
        nowhere = apply("broadcast", 0.0, extent=self.atlas.extent)
        return Layer(face, shown, nowhere, select(shown, pair.w, 0.0), point)

    def barycentrics(self, layer: Layer, span: Span | None = None) -> list[Node]:
        """See `Fragments`; of the heaviest faces, those by which all faces are blended."""
        if layer.face not in self._pairs:
            return super().barycentrics(layer, span)
        pair = self._pairs[layer.face]
        return [1.0 - pair.x - pair.y, pair.x, pair.y]

    @cached_property
    def places(self) -> list[Node]:
        """Of each view's faces the three corners: (x, y, near / w, depth), tables of views x faces."""
        return self.view_corners(self._place)

    @cached_property
    def _place(self) -> Node:
        """The same of views x vertices."""
        a, t, least = self.atlas, self.topology, max(self.near * 1e-6, 1e-30)
        w = select(absolute(self.clip.w) < least, select(self.clip.w < 0.0, -least, least), self.clip.w)
        place = clamp(self.clip.xy * compose(a.width / 2, a.height / 2) / w, -FARTHEST, FARTHEST)
        return compose(place.x, place.y, self.near / w, self.range.depth(self.clip, t.vertex_count, a.views))

    def corner_point(self, number: int, span: Span | None) -> Node:
        """vec2: where a corner of each face is on screen, from the middle of its view's cell."""
        return self.view_corners(self._place, span)[number].xy

    @cached_property
    def boxes(self) -> Node:
        """The pixels near each face."""
        where = {key: self.pair[key] for key in ("cell_w", "cell_h", "columns", "face_count")}
        reach = (0.0 if self.settings.hard else self.settings.r) + 0.05
        return apply("soft_boxes", *(apply("stop_gradient", x) for x in self.places), reach=reach, tight=int(self.settings.hard), **where)

    @cached_property
    def lists(self) -> Lists:
        """Which faces come near each tile; all of its view's where there are no tiles."""
        if self.settings.tile is None:
            views, n = self.grid.views, self.grid.faces
            ranges = np.arange(views)[:, None] * n + (0, n)
            faces, tiles, where = (constant_table(x) for x in (np.arange(views * n), np.zeros(1, int), ranges))
            return Lists(faces, tiles, where, as_node(views * n), as_node(1), as_node(views * n), n)
        return bin_faces(self.boxes, self.grid, self.settings.pairs, 0.0 if self.settings.hard else self.settings.r)

    @cached_property
    def _parts(self) -> Parts | None:
        """Of lists longer than one invocation goes through, where there can be any."""
        return find_parts(self.lists, self.grid, soft.EACH) if self.grid.faces > soft.EACH else None

    def _in_parts(self, name: str, inputs: Sequence[Node], **more) -> list[Node]:
        """An op over the lists: of the first part of each, and of the others, where there can be any."""
        where, attrs = self._listed
        first = apply(name, *inputs, *where, **attrs, **more)
        if self._parts is None:
            return [first]
        return [first, in_parts(name, [*inputs, *where], self._parts, self.grid, soft.EACH, **self.pair, **more)]

    def _join(self, name: str, own: Sequence[Node], others: Sequence[Node], **more) -> Node:
        """Of all parts together; infinite where there are more than there is room for: no picture rather than part of one."""
        joined = join_parts(name, own, self.lists.ranges, others, self._parts, self.grid, self.atlas.extent, soft.EACH, **more)
        return apply("stop_gradient", joined)  # gradients by the corners come from soft_blend and soft_whole

    @property
    def _listed(self) -> tuple[tuple[Node, ...], dict]:
        lists = self.boxes, self.lists.ranges, self.lists.faces, self._masks, self.lists.spilled
        return lists, {**listed_attrs(self.grid, self.atlas.extent), **self.pair}

    @cached_property
    def _masks(self) -> Node:
        """Which of the pixels of its tile each entry of the lists may come near."""
        if self.settings.tile is None:
            return constant_table(np.zeros((1, 4), int))
        corners = [apply("stop_gradient", x) for x in self.places]
        return soft_masks(corners, self.lists, self.grid, 0.0 if self.settings.hard else self.settings.r)

    def silhouette(self) -> Node:
        """1 - prod(1 - D) of all faces."""
        if self.blend is not None:
            return self.blend.w
        alphas = self._in_parts("soft_alpha", self.places)
        if self._parts is None:
            return alphas[0]
        return apply("soft_whole", self._join("soft_join_alpha", alphas[:1], alphas[1:]), *self.places, self.boxes, **self.pair)

    def color(self, shaded: Sequence[Node], background: Node | float, own: Sequence[Node] = ()) -> Node:
        """Colours of the three corners, vec3 tables of views x faces, as all faces blend over a background. own: colours of the first
        of the layers 1, 2, ... at pixels; these faces then have them instead."""
        if len(shaded) != 3 or any(x.vtype != "vec3" or x.extent not in (UNIT, self._table) for x in shaded):
            raise InputError(f"Binned blends what the corners of faces show: three vec3 tables of {self._table} are needed, "
                             f"got {list(shaded)!r:.80}")
        background = background if isinstance(background, Node) and background.channels == 3 else compose(*[background] * 3)
        shaded = [x if x.extent == self._table else apply("broadcast", x, extent=self._table) for x in shaded]
        depth = {"gamma": float(self.settings.gamma), "base": float(self.range.base)}
        inputs = *self.places, *shaded
        sums, most = (self._in_parts(name, inputs, **depth, least=LEAST - self.range.base) for name in ("soft_sums", "soft_most"))
        if self._parts is None:
            sums, most = (apply("stop_gradient", x[0]) for x in (sums, most))
        else:
            of = {"gamma": depth["gamma"]}
            sums = self._join("soft_join_sums", [sums[0], most[0]], [sums[1], most[1]], **of)
            most = self._join("soft_join_most", most[:1], most[1:], **of)
        if own:
            more = self._more(shaded, own, most)
            sums = sums + compose(more.x, more.y, more.z, 0.0)
        blend = apply("soft_blend", sums, most, background, *inputs, self.boxes, over=int(self.settings.over), **self.pair, **depth)
        self.blend = blend if self.blend is None else self.blend
        return blend.xyz

    def _more(self, shaded: Sequence[Node], own: Sequence[Node], most: Node) -> Node:
        """What the sums of colours lack if faces have colours of their own: weight times what these differ from those of their corners."""
        nearest, more = apply("stop_gradient", most.x), None
        for layer, color in zip(self.layers[1:], own):
            pair, (b0, b1, b2) = self._pairs[layer.face], self.barycentrics(layer)
            c0, c1, c2 = (lookup(x, layer.face, self.boxes) for x in shaded)
            away = apply("exp", apply("min", (pair.z - nearest) * (1.0 / self.settings.gamma), 0.0))
            term = (color - (c0 * b0 + c1 * b1 + c2 * b2)) * (layer.probability * away)
            more = term if more is None else more + term
        return more

    @property
    def _table(self):
        return table(self.grid.views * self.grid.faces)


@dataclass(frozen=True)
class Binned:
    """Every face within r pixels of a pixel has a say in it, however many there are: its probability D is the sigmoid of its signed
    distance over sigma (of the square of the distance where `squared`), alpha is 1 - prod(1 - D), and its weight in the colour
    D exp((z - z_max) / gamma), z the depth, 1 at the near end of a range and 0 at the far end. So hidden faces have gradients, too.

    r, sigma: in pixels (squared pixels where `squared`); sigma is r / 7 unless given, r^2 / 9.21 where `squared`. depth: (near, far) of the
    range in units of the scene, those of the cameras unless given. over: the faces' mean colour is laid over the background by alpha;
    else the background has a weight of its own, as in SoftRas and PyTorch3D. hard: only faces that cover the pixel count, with D = 1:
    nothing is soft at outlines. tile: pixels of the tiles that have lists, None: each pixel goes through all faces; pairs: places in the
    list, 16 a face of each view unless given. What does not fit is not left out: tiles then go through longer lists, slowly.

    Colours are worked out at the corners of faces and are linear on the face (Gouraud shading): exact for colours of vertices and corners,
    constant colours and normals "flat". layers: so many faces of a pixel, those with the largest weights, are shaded at the pixel instead,
    0 to 8; unless given 4 where a material samples a texture or reads the pixel, else none. The others still count, with what their corners
    show; so nothing is left out, and where no more faces than that are near it is all exact. Raises InputError."""

    r: float = 2.0
    sigma: float | None = None
    gamma: float = 1e-4
    depth: tuple[float, float] | None = None
    squared: bool = False
    over: bool = False
    hard: bool = False
    tile: tuple[int, int] | None = (8, 8)
    pairs: int | None = None
    layers: int | None = None

    def __post_init__(self) -> None:
        for name, least in (("r", 0.0), ("sigma", 1e-12), ("gamma", 1e-9)):
            x = getattr(self, name)
            if not (x is None and name == "sigma") and (isinstance(x, bool) or not isinstance(x, int | float) or not least < x < 1e6):
                raise InputError(f"Binned: {name} is {x!r:.40}; a number above {least:g} and below 1e6 is needed")
        if self.width < 1e-12:
            raise InputError(f"Binned: sigma is {self.width:g}; a number above 1e-12 is needed: give a larger r, or a sigma")
        if self.depth is not None:
            near, far = self.depth if isinstance(self.depth, tuple) and len(self.depth) == 2 else (math.nan, math.nan)
            if not (math.isfinite(near) and math.isfinite(far) and 0 <= near < far < 1e30 and far - near > 1e-6 * far):
                raise InputError(f"Binned: depth is {self.depth!r:.40}; (near, far) with 0 <= near < far is needed")
        sides = self.tile if isinstance(self.tile, tuple) else ()
        if self.tile is not None and not (len(sides) == 2 and all(type(x) is int and 1 <= x <= 64 for x in sides)):
            raise InputError(f"Binned: tile is {self.tile!r:.40}; (width, height), each from 1 to 64 pixels, or None is needed")
        if self.pairs is not None and (type(self.pairs) is not int or not 1 <= self.pairs < 1 << 26):
            raise InputError(f"Binned: pairs is {self.pairs!r:.40}; a whole number from 1 to {(1 << 26) - 1} is needed")
        if self.layers is not None and (type(self.layers) is not int or not 0 <= self.layers <= MOST):
            raise InputError(f"Binned: layers is {self.layers!r:.40}; a whole number from 0 to {MOST} is needed")

    @property
    def width(self) -> float:
        """sigma in force."""
        if self.sigma is not None:
            return float(self.sigma)
        return self.r ** 2 / math.log(1e4 - 1) if self.squared else self.r / 7

    @staticmethod
    def pytorch3d(size: tuple[int, int], sigma: float = 1e-4, gamma: float = 1e-4, blur_radius: float | None = None, znear: float = 1.0,
                  zfar: float = 100.0) -> Binned:
        """The settings of PyTorch3D's `BlendParams`, `RasterizationSettings` and `softmax_rgb_blend` for pictures of (width, height), with
        K no less than the layers there are. Its distances are squares in units of half the shorter side; blur_radius is
        log(1 / 1e-4 - 1) sigma unless given."""
        unit = (min(size) / 2) ** 2
        blur = math.log(1e4 - 1) * sigma if blur_radius is None else blur_radius
        return Binned(math.sqrt(blur * unit), sigma * unit, gamma, (znear, zfar), squared=True)

    def seen_by(self, views: ViewTable) -> Seen:
        """This renderer with what it is to know of the views: the range of depth, and which are orthographic."""
        near, far = self.depth or (views.near, views.far)
        return Seen(self, Range(near, far, views.parallel))

    def draw(self, clip: Node, topology: Topology, atlas: Atlas, near: float, faces: bool) -> BinnedFragments:
        """See `Renderer.draw`: of perspective views, with a `depth`."""
        if self.depth is None:
            raise InputError("Binned: nothing says which depths are told apart; give depth=(near, far), in units of the scene")
        return Seen(self, Range(*self.depth)).draw(clip, topology, atlas, near, faces)


@dataclass(frozen=True)
class Seen:
    """A `Binned` that knows its range of depth."""

    settings: Binned
    span: Range

    def draw(self, clip: Node, topology: Topology, atlas: Atlas, near: float, faces: bool) -> BinnedFragments:
        """See `Renderer.draw`."""
        return BinnedFragments(clip, topology, atlas, self.settings, self.span, near, faces)


