"""Materials: from what a pixel sees (`surface.Surface`) to the radiance that leaves it towards the eye, linear, a vec3.

A material is anything that is called with a surface and gives a vec3. Ours are frozen records, so that results can be written with
them; one of your own may as well be a function of three lines.

Each setting of a material is a source: a number, three numbers, a node of extent 1x1 (a parameter), or anything that is called with the
surface and gives a node, such as `Texture(image)` and `Vertex(table)`.
"""
from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ...cache.errors import GraphError, InputError
from ..graph.functions import apply, compose, constant, cross, dot, maximum, normalize, select, sqrt
from ..graph.ir import UNIT, Node
from ..graph.optable import as_node
from .light import PLACED, Light, diffuse
from .surface import Surface
from .texture import Wrap, wraps_of
from .tone import decode_srgb

Source = float | tuple | Node | Callable[[Surface], Node]


IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
MAX_PROBES = 16


@dataclass(frozen=True, eq=False)
class Coordinates:
    """A source, a vec2: texture coordinates of faces' corners that are not the mesh's own. values: (n, 2), v down; faces: (F, 3), which of
    them each corner has. transform: 2 x 3 numbers, (u, v) = transform (u, v, 1), as KHR_texture_transform has it. Raises InputError."""

    values: np.ndarray
    faces: np.ndarray
    transform: tuple = IDENTITY

    def __post_init__(self) -> None:
        _matrix(self.transform)

    @property
    def corners(self) -> np.ndarray:
        """(F, 3, 2)."""
        return moved(np.asarray(self.values, float)[self.faces], self.transform)

    def __call__(self, s: Surface) -> Node:
        return s.corner(self.corners)


def _matrix(transform) -> np.ndarray:
    try:
        matrix = np.array(transform, float)
    except (TypeError, ValueError):
        matrix = np.zeros(0)
    if matrix.shape != (2, 3) or not np.isfinite(matrix).all():
        raise InputError(f"a transform of texture coordinates is {transform!r:.60}; two rows of three finite numbers are needed")
    return matrix


def moved(corners: np.ndarray, transform) -> np.ndarray:
    """Texture coordinates (..., 2) after a 2 x 3 transform; the same array where that does nothing. Raises InputError."""
    matrix = _matrix(transform)
    return corners if (matrix == np.array(IDENTITY)).all() else corners @ matrix[:, :2].T + matrix[:, 2]


@dataclass(frozen=True)
class Texture:
    """A source: the sample of an image of 1 to 4 channels at the surface's texture coordinates, or at `uv`, a source of its own.

    image: a node, or an array (h, w) or (h, w, channels) that stays as it is.
    wrap: "repeat", "clamp" or "mirror", or a pair of them, for u and for v. gradient: of the image; `texture.sample_texture` says which.
    transform: 2 x 3 numbers by which the coordinates are moved first (KHR_texture_transform).
    mips: trilinear between mip levels, by how large a pixel is on the face; so a texture that is much finer than the pixels does not alias.
    The coordinates are then the mesh's own or `Coordinates`. bias: added to the level; below 0 sharper. The texture's gradient is exact
    through all levels; an optimizer then updates every texel. How the level changes as vertices move is not in gradients.
    anisotropy: with mips, how many trilinear samples a pixel takes along the longer axis of its ellipse on the texture, 1 to 16, and then
    their mean: a face seen at a slant is neither blurred nor does it alias. 4 make a step 2 to 2.5 times as long.
    srgb: the image holds sRGB values and is decoded before anything is averaged. Raises InputError."""

    image: Node | np.ndarray
    wrap: Wrap = "repeat"
    gradient: str = "exact"
    uv: Source | None = None
    mips: bool = False
    srgb: bool = False
    transform: tuple = IDENTITY
    bias: float = 0.0
    anisotropy: int = 1

    def __post_init__(self) -> None:
        wraps_of(self.wrap)
        _matrix(self.transform)
        if isinstance(self.anisotropy, bool) or not isinstance(self.anisotropy, int) or not 1 <= self.anisotropy <= MAX_PROBES:
            raise InputError(f"a texture's anisotropy is {self.anisotropy!r:.40}; a whole number from 1 to {MAX_PROBES} is needed")
        if self.anisotropy > 1 and not self.mips:
            raise InputError(f"a texture with anisotropy {self.anisotropy} has no mips; give it mips=True, or 1")
        if not isinstance(self.image, Node):
            array = np.asarray(self.image)
            if array.ndim == 2:
                array = array[..., None]
            if (array.dtype.kind not in "fiu" or array.ndim != 3 or 0 in array.shape or array.shape[2] > 4
                    or not np.isfinite(array).all()):
                raise InputError(f"a texture's image is of shape {array.shape} and type {array.dtype}; a node, or an array (h, w) or "
                                 "(h, w, 1 to 4) of finite numbers, is needed")
            object.__setattr__(self, "image", constant(array.astype(float)))
        if self.mips and not (self.uv is None or isinstance(self.uv, Coordinates)):
            raise InputError(f"a texture with mips has the uv {self.uv!r:.40}; the mesh's own coordinates or Coordinates are needed, of "
                             "which it is known how fast they change")

    @property
    def decoded(self) -> Node:
        """The image as it is sampled."""
        return decode_srgb(self.image) if self.srgb else self.image

    def __call__(self, s: Surface) -> Node:
        image, plain = self.decoded, tuple(map(tuple, self.transform)) == IDENTITY
        if self.uv is None and plain and not self.mips:
            return s.texture(image, None, self.wrap, self.gradient)
        if self.uv is None or isinstance(self.uv, Coordinates):
            corners = moved(s.uv_corners if self.uv is None else self.uv.corners, self.transform)
            uv = s.corner(corners)
            if self.anisotropy > 1:
                return s.probes(image, uv, corners, self.anisotropy, self.wrap, self.gradient, self.bias)
            lod = s.level_of_detail(image, corners, self.bias) if self.mips else None
            return s.texture(image, uv, self.wrap, self.gradient, lod)
        uv = evaluate(self.uv, s)
        if not plain:
            uv = compose(*(row[0] * uv.x + row[1] * uv.y + row[2] for row in self.transform))
        return s.texture(image, uv, self.wrap, self.gradient)


@dataclass(frozen=True)
class Product:
    """A source: other ones, multiplied: a texture and a factor, a texture and the colours of vertices."""

    sources: Sequence[Source]

    def __call__(self, s: Surface) -> Node:
        first, *others = (as_node(evaluate(x, s)) for x in self.sources)
        for x in others:
            first = first * x
        return first


@dataclass(frozen=True)
class Vertex:
    """A source: an attribute of the part's vertices, a float or vec table of as many entries."""

    table: Node

    def __call__(self, s: Surface) -> Node:
        return s.vertex(self.table)


@dataclass(frozen=True)
class Channel:
    """A source: channels of another one by name, such as "y" or "xyz"."""

    source: Source
    name: str

    def __call__(self, s: Surface) -> Node:
        return apply("swizzle", evaluate(self.source, s), channels=self.name)


@dataclass(frozen=True, eq=False)
class Corner:
    """A source: an attribute of faces' corners. table: a float or vec table; faces: (F, 3), which of its entries each corner has."""

    table: Node
    faces: np.ndarray

    def __call__(self, s: Surface) -> Node:
        return s.indexed(self.table, self.faces)


@dataclass(frozen=True)
class Occlusion:
    """A source: the part of ambient light that arrives, by the first channel x of another one: 1 + strength (x - 1) (glTF 2.0, 3.9.3)."""

    source: Source
    strength: Source = 1.0

    def __call__(self, s: Surface) -> Node:
        return 1.0 + evaluate(self.strength, s) * (apply("swizzle", evaluate(self.source, s), channels="x") - 1.0)


def evaluate(source: Source, surface: Surface) -> Node | float:
    """A source at a surface. Raises InputError."""
    if callable(source):
        return source(surface)
    if isinstance(source, (Node, int, float)):
        return source
    if isinstance(source, (tuple, list)) and len(source) == 3:
        return compose(*map(float, source))
    raise InputError(f"{source!r:.60} is no source of a material; a number, three numbers, a node or a function of the surface is needed")


@dataclass(frozen=True)
class NormalMap:
    """A source, of a material's `normal`: the direction in world space that a picture of normals says. source: x along the tangent, y along
    the bitangent, z along the normal, each from -1 to 1 stored as 0 to 1 (glTF 2.0, 3.9.3); scale: of x and y. Where there is no tangent,
    or the picture says zero, the surface's own normal."""

    source: Source
    scale: Source = 1.0

    def __call__(self, s: Surface) -> Node:
        n, t = apply("kept", normalize(s.normal)), apply("kept", s.tangent)
        map = evaluate(self.source, s) * 2.0 - 1.0
        x, y = (map.xy * evaluate(self.scale, s)).x, (map.xy * evaluate(self.scale, s)).y
        bent = t.xyz * x + cross(n, t.xyz) * (t.w * y) + n * map.z
        squared = dot(bent, bent)
        return select(squared > 1e-8, bent, n) / sqrt(select(squared > 1e-8, squared, 1.0))


def facing(s: Surface, two_sided: bool, normal: Source | None = None) -> Node:
    """The normal to shade with, of length 1: the surface's own or what a material says; two_sided: turned round where the face is seen
    from behind."""
    n = normalize(s.normal) if normal is None else normalize(evaluate(normal, s))
    return select(dot(s.geometric_normal, s.to_eye) < 0.0, -n, n) if two_sided else n


def _check_lights(lights: Sequence[Light]) -> None:
    if not isinstance(lights, (tuple, list)) or not lights or not all(isinstance(light, Light) for light in lights):
        raise InputError(f"lights are {lights!r:.60}; a sequence of at least one Light is needed")


@dataclass(frozen=True)
class Unlit:
    """The colour itself."""

    color: Source = 0.5

    def __call__(self, s: Surface) -> Node:
        c = evaluate(self.color, s)
        return c if isinstance(c, Node) and c.channels == 3 else compose(c, c, c)


@dataclass(frozen=True)
class Lambert:
    """A diffuse surface: color (E / pi max(n.l, 0) + ambient), summed over the lights. A point light of intensity I at distance d gives
    E = I / d^2. two_sided: faces seen from behind are lit from the side on which one sees them. normal: the direction to shade with, in
    world space, such as a `NormalMap`; the surface's own unless given."""

    color: Source
    lights: Sequence[Light]
    two_sided: bool = False
    normal: Source | None = None

    def __post_init__(self) -> None:
        _check_lights(self.lights)

    def __call__(self, s: Surface) -> Node:
        plain = not self.two_sided and self.normal is None
        albedo, normal = evaluate(self.color, s), s.normal if plain else facing(s, self.two_sided, self.normal)
        position = s.position if any(light.kind in PLACED or light.shadow is not None for light in self.lights) else normal
        return albedo * diffuse(normal, position, self.lights)


@dataclass(frozen=True)
class BlinnPhong:
    """Lambert, and where a light is in front specular E max(n.h, 0)^gloss, h half way between light and eye (Blinn 1977). gloss > 0.
    two_sided and normal: as in `Lambert`."""

    color: Source
    specular: Source
    gloss: Source
    lights: Sequence[Light]
    two_sided: bool = False
    normal: Source | None = None

    def __post_init__(self) -> None:
        _check_lights(self.lights)

    def __call__(self, s: Surface) -> Node:
        n, gloss, shine = facing(s, self.two_sided, self.normal), evaluate(self.gloss, s), None
        for light in self.lights:
            if light.kind == "ambient":
                continue
            power, to_light, squared = light.arriving(s.position)
            height = maximum(dot(n, normalize(to_light + s.to_eye)), 0.0)
            term = power * (select(dot(n, to_light) > 0.0, apply("pow", height, gloss), 0.0) / squared)
            shine = term if shine is None else shine + term
        body = evaluate(self.color, s) * diffuse(n, s.position, self.lights)
        return body if shine is None else body + evaluate(self.specular, s) * shine


def shaded(material: Callable[[Surface], Node], surface: Surface, who: str) -> Node:
    """The material at the surface, a float vec3 over its pixels or of extent 1x1. Raises GraphError, InputError, with `who` in front."""
    try:
        color = material(surface)
    except (GraphError, InputError) as error:
        raise type(error)(f"{who}: {error}") from None
    except AttributeError as error:
        raise InputError(f"{who} reads what a surface does not have: {error}") from error
    if not isinstance(color, Node) or color.vtype != "vec3":
        raise GraphError(f"{who} gives {color!r:.60}; a vec3 of linear radiance is needed")
    if color.extent not in (UNIT, surface.inside.extent):
        raise GraphError(f"{who} gives {color!r} over {color.extent}; {surface.inside.extent} is needed")
    return color
