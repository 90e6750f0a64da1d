"""The four functions as graphs: which face each pixel shows, attributes over it, samples of a texture, colours blended across silhouettes.

In: a topology, sizes, numbers of channels. Out: a `Scene` with one vjp, "f", whose parameters are inputs without a start; values of more
than four channels are several, `color0`, `color1`, ... Semantics: Laine et al., "Modular Primitives for High-Performance Differentiable
Rendering" (2020), and the manual of nvdiffrast; where we differ: docs/primitives.md. Pictures lie in an atlas; row 0 is where clip y is
-w.
"""
from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..cache.layout import Layout
from ..compiler.graph.autodiff import gradients
from ..compiler.graph.functions import (
    absolute,
    apply,
    clamp,
    compose,
    constant_table,
    dot,
    equal,
    lookup,
    maximum,
    not_equal,
    select,
    shift,
    sqrt,
    stop_gradient,
    to_float,
    to_int,
    total,
)
from ..compiler.graph.ir import Node, vector_type
from ..compiler.render.raster import Fragments, Softness
from ..compiler.render.raster.fragments import GUARDED
from ..compiler.render.texture import sample_texture
from ..compiler.render.topology import Topology
from ..compiler.scene import Camera
from ..compiler.scene.scene import Scene

NEAR = 1e-6  # w of what is in front of the camera; the near plane is where clip z is -w
FAR = 1e30
Wanted = Sequence[str] | None
EDGE = 1 / 16  # of a pixel by which an edge may miss the way between two pixel centres


def chunks(channels: int) -> list[tuple[int, int]]:
    """(first, how many) of the values that so many channels are kept in."""
    return [(k, min(4, channels - k)) for k in range(0, channels, 4)]


def scene_of(views: int, size: tuple[int, int]) -> Scene:
    """A scene of nothing but pictures of (width, height)."""
    return Scene([Camera(np.eye(4), 1.0, 1.0, 0.0, 0.0, *size)] * views)


class _Inputs:
    """What a function is given. wrt: what it has gradients by, of those that are wanted."""

    def __init__(self, views: int, size: tuple[int, int], wanted: Sequence[str] | None):
        self.scene, self.size, self.views, self.wanted = scene_of(views, size), size, views, wanted
        self.atlas, self.wrt = self.scene.atlas, {}

    def _add(self, name: str, layout: Layout, wrt: bool = True) -> Node:
        node = self.scene.program.input(name, layout)
        if wrt and (self.wanted is None or name.rstrip("0123456789") in self.wanted):
            self.wrt[name] = node
        return node

    def table(self, name: str, count: int, channels: int, integer: bool = False) -> Node:
        return self._add(name, Layout("table", vector_type(channels, integer), count=count), not integer)

    def pictures(self, name: str, channels: int, wrt: bool = True) -> Node:
        return self._add(name, self.scene.pictures_layout(vector_type(channels)), wrt)

    def image(self, name: str, width: int, height: int, channels: int) -> Node:
        return self._add(name, Layout("image", vector_type(channels), width, height))

    def done(self, outputs: Mapping[str, Node]) -> Scene:
        """The scene with the vjp of these pictures, as `Scene.vjp` makes it of parameters."""
        program = self.scene.program
        named = {f"f.{key}": (node, self.scene.pictures_layout(node.vtype)) for key, node in outputs.items()}
        inner, given = None, []
        for key, (node, layout) in named.items():
            given.append(f"{key}.grad")
            product = total(dot(node, program.input(given[-1], layout)))
            inner = product if inner is None else inner + product
        how = {"dynamic": frozenset(given), "group": "f", "moving": frozenset(program.values) - {*given}}
        program.plan("f", outputs=named, **how)
        found = gradients(inner, list(self.wrt.values()))
        program.plan("f.vjp", outputs={f"f.{key}.grad": (g, program.values[key].layout) for key, g in zip(self.wrt, found)}, **how)
        return self.scene

    def corners(self, faces: np.ndarray, vertices: int, each: bool = True) -> list[np.ndarray]:
        """For each corner its place in a table of vertices, of all views one after another (or of one that all share)."""
        return [np.concatenate([v * vertices * each + faces[:, k] for v in range(self.views)]) for k in range(3)]

    def index(self, rast: Node, count: int) -> Node:
        """The pixel's triangle in tables of views x triangles; -1 for none."""
        triangle = to_int(rast.w + 0.5) - 1
        return _in_tiles(select(triangle >= 0, triangle + self.atlas.view * count, -1))


def _cross2(a: Node, b: Node) -> Node:
    return a.x * b.y - a.y * b.x


def _in_tiles(index: Node, tiles: Node | None = None) -> Node:
    """The same numbers from -1 on, so that what is made of them is worked out in the tiles alone in which one is not -1, or in these."""
    width, height = GUARDED
    tiles = apply("occupied", index, width=width, height=height) if tiles is None else tiles
    return apply("inside_tiles", index + 1, tiles, tile=GUARDED) - 1


# ---- rasterize

def rasterize(faces: np.ndarray, vertices: int, views: int, size: tuple[int, int], output_db: bool = True,
              wanted: Wanted = None) -> Scene:
    """pos (views x vertices, 4) in clip coordinates -> rast: u, v (weights of corners 0 and 1), z / w, triangle + 1; if asked for db: how u
    and v change from pixel to pixel: du/dX, du/dY, dv/dX, dv/dY. Zero where there is nothing between the planes z = -w and z = w."""
    f = _Inputs(views, size, wanted)
    pos = f.table("pos", views * vertices, 4)
    t = Topology(faces, vertices)
    clip = compose(pos.x, pos.y, (pos.z + pos.w) * 0.5, pos.w)
    drawn = Fragments(clip, t, f.atlas, Softness(r=0.5), NEAR, True)
    boxes, scale, front = drawn.face_boxes, compose(size[0] / 2, size[1] / 2), _in_tiles(drawn.front)
    p = [lookup(lookup(pos, k), front, boxes) for k in f.corners(t.faces, vertices)]
    a = [x.xy * scale - f.atlas.position * x.w for x in p]
    e = [_cross2(a[(k + 1) % 3], a[(k + 2) % 3]) for k in range(3)]
    whole = e[0] + e[1] + e[2]
    safe = select(equal(whole, 0.0), 1.0, whole)
    u, v = e[0] / safe, e[1] / safe
    w = e[0] * p[0].w + e[1] * p[1].w + e[2] * p[2].w
    depth = stop_gradient((e[0] * p[0].z + e[1] * p[1].z + e[2] * p[2].z) / select(equal(w, 0.0), 1.0, w))
    shown = select((front >= 0) & (depth <= 1.0), 1, 0)
    own = front - f.atlas.view * len(t.faces)
    triangle = own if len(t.kept) == len(faces) else lookup(constant_table(t.kept), select(shown, own, -1))
    outputs = {"rast": select(shown, compose(u, v, clamp(depth, -1.0, 1.0), to_float(triangle + 1)), 0.0)}
    if output_db:
        right = [p[(k + 2) % 3].w * a[(k + 1) % 3].y - p[(k + 1) % 3].w * a[(k + 2) % 3].y for k in range(3)]
        down = [p[(k + 1) % 3].w * a[(k + 2) % 3].x - p[(k + 2) % 3].w * a[(k + 1) % 3].x for k in range(3)]
        slopes = [(by[k] - x * (by[0] + by[1] + by[2])) / safe for k, x in enumerate((u, v)) for by in (right, down)]
        outputs["db"] = select(shown, compose(*slopes), 0.0)
    return f.done(outputs)


# ---- interpolate

def interpolate(faces: np.ndarray, vertices: int, views: int, size: tuple[int, int], channels: int, each: bool,
                wanted: Wanted = None) -> Scene:
    """attr (vertices, or views x vertices if `each`; channels) and rast -> out: u attr0 + v attr1 + (1 - u - v) attr2. boxes (views x
    triangles, 4): in which pixels of the atlas each triangle is named."""
    f = _Inputs(views, size, wanted)
    rast = f.pictures("rast", 4)
    index, boxes = f.index(rast, len(faces)), f.table("boxes", views * len(faces), 4, integer=True)
    weights, outputs = (rast.x, rast.y, 1.0 - rast.x - rast.y), {}
    for number, (_, width) in enumerate(chunks(channels)):
        attr = f.table(f"attr{number}", vertices * (views if each else 1), width)
        out = None
        for corner, weight in zip(f.corners(faces, vertices, each), weights):
            part = weight * lookup(lookup(attr, corner), index, boxes)
            out = part if out is None else out + part
        outputs[f"out{number}"] = select(index >= 0, out, 0.0)
    return f.done(outputs)


def slopes(faces: np.ndarray, vertices: int, views: int, size: tuple[int, int], channels: int, each: bool,
           wanted: Wanted = None) -> Scene:
    """attr, db, and rast for its triangles -> x, y: how the attribute changes from pixel to pixel, along a row and down. boxes: as of
    `interpolate`."""
    f = _Inputs(views, size, wanted)
    rast, db = f.pictures("rast", 4, wrt=False), f.pictures("db", 4)
    index, boxes = f.index(rast, len(faces)), f.table("boxes", views * len(faces), 4, integer=True)
    outputs = {}
    for number, (_, width) in enumerate(chunks(channels)):
        attr = f.table(f"attr{number}", vertices * (views if each else 1), width)
        a = [lookup(lookup(attr, corner), index, boxes) for corner in f.corners(faces, vertices, each)]
        for name, du, dv in (("x", db.x, db.z), ("y", db.y, db.w)):
            outputs[f"{name}{number}"] = select(index >= 0, du * (a[0] - a[2]) + dv * (a[1] - a[2]), 0.0)
    return f.done(outputs)


# ---- texture

def texture(views: int, size: tuple[int, int], texels: tuple[int, int], channels: int, filter_mode: str, boundary: str,
            top: int | None, bias: bool, wanted: Wanted = None) -> Scene:
    """tex (height, width, channels) of texels (width, height), and uv -> out. filter_mode, boundary: nvdiffrast's words; top: the last mip
    level that is used, None for all. With a mipmap da is du/dX, du/dY, dv/dX, dv/dY, and, if asked for, bias is added to the level."""
    f = _Inputs(views, size, wanted)
    uv, wrap, lod = f.pictures("uv", 2), {"wrap": "repeat", "clamp": "clamp"}[boundary], None
    extent = compose(float(texels[0]), float(texels[1]))
    if filter_mode == "nearest":
        uv = stop_gradient((apply("floor", uv * extent) + 0.5) / extent)
    if "mipmap" in filter_mode:
        da = f.pictures("da", 4, wrt=False)
        a, b = compose(da.x, da.z) * extent, compose(da.y, da.w) * extent
        square, area = dot(a, a) + dot(b, b), _cross2(a, b)
        major = 0.5 * (square + sqrt(maximum(square * square - 4.0 * area * area, 0.0)))  # the longer axis of the pixel's ellipse, squared
        lod = 0.5 * apply("log2", maximum(major, 2.0 ** -60))
        if bias:
            lod = lod + f.pictures("bias", 1, wrt=False)
        lod = clamp(lod, 0.0, float(top)) if top is not None else maximum(lod, 0.0)
        lod = stop_gradient(apply("floor", lod + 0.5) if filter_mode == "linear-mipmap-nearest" else lod)
    outputs = {}
    for number, (_, width) in enumerate(chunks(channels)):
        tex = f.image(f"tex{number}", *texels, width)
        outputs[f"out{number}"] = sample_texture(tex, uv, wrap, lod=lod)
    return f.done(outputs)


# ---- antialias

def opposite(faces: np.ndarray) -> np.ndarray:
    """(F, 3): across the edge that faces each corner, the vertex of the other triangle; the corner itself where there is none. Of more than
    two triangles at an edge the first two count."""
    found: dict[tuple[int, int], list[int]] = {}
    out = np.array(faces)
    edges = [[(min(f[(k + 1) % 3], f[(k + 2) % 3]), max(f[(k + 1) % 3], f[(k + 2) % 3])) for k in range(3)] for f in faces.tolist()]
    for f, around in zip(faces.tolist(), edges):
        for k, edge in enumerate(around):
            slots = found.setdefault(edge, [])
            if f[k] not in slots and len(slots) < 2:
                slots.append(f[k])
    for i, (f, around) in enumerate(zip(faces.tolist(), edges)):
        for k, edge in enumerate(around):
            out[i, k] = next((v for v in found[edge] if v != f[k]), f[k])
    return out


def _same_sign(a: Node, b: Node) -> Node:
    return equal(select(a < 0.0, 1, 0), select(b < 0.0, 1, 0))


class _Silhouettes:
    """Between each pixel and its neighbour (to the right or below) the way that belongs to the other's colour."""

    def __init__(self, f: _Inputs, pos: Node, rast: Node, faces: np.ndarray, vertices: int, boxes: Node):
        self.f, self.rast, self.count = f, rast, len(faces)
        far = select(absolute(pos.w) < 1e-12, 1e-12, pos.w)
        self.screen = compose(pos.x / far * (f.size[0] / 2), pos.y / far * (f.size[1] / 2))
        held, wings = stop_gradient(self.screen), opposite(faces)
        self.held = [lookup(held, k) for k in f.corners(faces, vertices)]
        self.wings = [lookup(held, k) for k in f.corners(wings, vertices)]
        ends = [np.stack([faces[:, (k + by) % 3] for k in range(3)], 1).reshape(-1) for by in (1, 2)]
        self.ends = [lookup(self.screen, np.concatenate([v * vertices + x for v in range(f.views)])) for x in ends]
        self.boxes = lookup(boxes, np.repeat(np.arange(f.views * len(faces)), 3))

    def alphas(self) -> dict[tuple[int, int], Node]:
        """Towards the neighbours at (dx, dy), of the pixel's own colour towards theirs: above 0 changes the pixel, below 0 the neighbour.
        Worked out in the tiles alone where triangles meet."""
        pairs = {way: self._pair(*way) for way in ((1, 0), (0, 1))}
        named = apply("max", *(index for index, _, _ in pairs.values()))
        tiles = apply("occupied", named, width=GUARDED[0], height=GUARDED[1])
        return {way: self._alpha(*pair, way[1], tiles) for way, pair in pairs.items()}

    def _pair(self, dx: int, dy: int) -> tuple[Node, Node, Node]:
        """Of each pixel and its neighbour: which triangle is in front, in tables of views x triangles (-1: no silhouette can be between
        them); the centre of the pixel that shows it; 1 where that is the pixel itself, else -1."""
        f, rast = self.f, self.rast
        other, across = shift(rast, -dx, -dy, cell=f.size), f.size[0] / 2 - 1.0 if dx else f.size[1] / 2 - 1.0
        mine, theirs = to_int(rast.w + 0.5) - 1, to_int(other.w + 0.5) - 1
        place = f.atlas.position
        pair = not_equal(mine, theirs) & ((place.x if dx else place.y) < across)
        nearer = select(rast.z < other.z, 1, 0)
        own = select(mine < 0, 0, select(theirs < 0, 1, nearer))
        triangle = select(own, mine, theirs)
        index = select(pair & (triangle >= 0), triangle + f.atlas.view * self.count, -1)
        return index, select(own, place, place + compose(float(dx), float(dy))), select(own, 1.0, -1.0)

    def _alpha(self, index: Node, centre: Node, sign: Node, dy: int, tiles: Node) -> Node:
        index = _in_tiles(index, tiles)
        edge = _in_tiles(self._edge(index, centre, sign, dy), tiles)
        named = _in_tiles(select(edge >= 0, index * 3 + edge, -1), tiles)
        one, two = (lookup(x, named, self.boxes) - centre for x in self.ends)
        way = clamp(self._crossing(one, two, sign, dy), 0.0, 1.0)
        return apply("inside_tiles", select(edge >= 0, sign * (0.5 - way), 0.0), tiles, tile=GUARDED)

    def _crossing(self, one: Node, two: Node, sign: Node, dy: int) -> Node:
        """How far from the triangle's pixel to the other's the line through both ends crosses, relative to the first."""
        along, over = (one.y, one.x) if dy else (one.x, one.y)
        d_along, d_over = (two.y - one.y, two.x - one.x) if dy else (two.x - one.x, two.y - one.y)
        return sign * (along - over * d_along / select(equal(d_over, 0.0), 1.0, d_over))

    def _edge(self, index: Node, centre: Node, sign: Node, dy: int) -> Node:
        """Which edge of the triangle, 0 to 2 by the corner that it faces, is a silhouette between the two pixels; -1 for none."""
        p, o = ([lookup(x, index) - centre for x in tables] for tables in (self.held, self.wings))
        bend = _cross2(p[1] - p[0], p[2] - p[0])
        best, ways = None, []
        for k in range(3):
            one, two = p[(k + 1) % 3], p[(k + 2) % 3]
            wing = _cross2(one - o[k], two - o[k])
            over = [(x.x if dy else x.y) for x in (one, two)]
            steep = absolute(over[1] - over[0]) >= absolute(two.y - one.y if dy else two.x - one.x)
            way = select(_same_sign(*over), -FAR, self._crossing(one, two, sign, dy))
            ways.append((way, _same_sign(wing, bend) & steep & (way > -EDGE) & (way < 1.0 + EDGE)))
            best = way if best is None else maximum(best, way)
        edge = -1
        for k in (2, 1, 0):
            way, right = ways[k]
            edge = select(equal(way, best), select(right, k, -1), edge)
        return select(index >= 0, edge, -1)


def antialias(faces: np.ndarray, vertices: int, views: int, size: tuple[int, int], channels: int, wanted: Wanted = None) -> Scene:
    """color, rast and pos -> out: colours blended where a silhouette runs between two pixels. boxes (views x triangles, 4): in which pixels
    of the atlas each triangle is named by a pixel or its neighbours."""
    f = _Inputs(views, size, wanted)
    pos, rast = f.table("pos", views * vertices, 4), f.pictures("rast", 4, wrt=False)
    boxes = f.table("boxes", views * len(faces), 4, integer=True)
    ways, outputs = _Silhouettes(f, pos, rast, faces, vertices, boxes).alphas(), {}
    for number, (_, width) in enumerate(chunks(channels)):
        color = f.pictures(f"color{number}", width)
        out = color
        for (dx, dy), alpha in ways.items():
            change = alpha * (shift(color, -dx, -dy, cell=size) - color)
            out = out + select(alpha > 0.0, change, 0.0) + shift(select(alpha > 0.0, 0.0, change), dx, dy, edge="zero", cell=size)
        outputs[f"out{number}"] = out
    return f.done(outputs)


BUILDERS = {builder.__name__: builder for builder in (rasterize, interpolate, slopes, texture, antialias)}


def build(name: str, faces: np.ndarray | None, *sizes, wanted: Wanted = None) -> Scene:
    """The scene of a function by its name; faces only where it takes some. wanted: of what gradients are, None: all that there are."""
    return BUILDERS[name](*(() if faces is None else (faces,)), *sizes, wanted=wanted)


def names_of(name: str, channels: int) -> Sequence[str]:
    """A value's parts."""
    return [f"{name}{k}" for k in range(len(chunks(channels)))]
