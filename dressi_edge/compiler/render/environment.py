"""Light from all directions: an octahedral map of radiance, what surfaces of any roughness see of it (the split sum of Karis 2013), and
what cameras see.

In: a map (`octahedron.octahedral` makes one of a panorama), a constant or a parameter. Out: radiance by direction and roughness, as graph.
All filtering is one constant sparse matrix (`prefilter`), whose transpose is exact: the map may be optimized. While it rests, all of it is
computed once.
"""
from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ...cache.errors import GraphError, InputError
from ..graph.functions import apply, channels, clamp, compose, concat, constant, gather_sum, maximum, select
from ..graph.ir import UNIT, Node, image
from ..graph.ops.lobes import between, scaled
from ..graph.ops.lookup import constant_table
from ..graph.optable import as_node
from .camera import rotation_rows
from .octahedron import SIZES, place
from .prefilter import LEAST, ROUGHNESSES, Level, halving, layout, matrix
from .texture import sample_texture

if TYPE_CHECKING:
    from .frame import Frame

GRADIENTS = ("exact", "none")


@dataclass(frozen=True, eq=False)
class Environment:
    """map: radiance, (n, n, 3), n one of octahedron.SIZES, octahedral: an array, or a vec3 image: a parameter (`low=0.0`). rotation: a
    rotation vector that turns the environment, three numbers or a vec3 of extent 1x1; strength: a factor, a number or a float or vec3 of
    extent 1x1.

    gradient, of the map: "exact", by gathers over every level, so that where geometry and normals rest the gathers are found once, whatever
    roughness does; unless roughness is one number for all pixels every level is sampled, too. "none": two levels are sampled, those
    around the roughness. The values are the same, and so are gradients by rotation, strength, roughness and normals. Given as an array,
    a map has none. Raises InputError, GraphError.
    """

    map: Node | np.ndarray
    rotation: tuple[float, float, float] | Node = (0.0, 0.0, 0.0)
    strength: float | Node = 1.0
    gradient: str | None = None

    def __post_init__(self) -> None:
        known = not isinstance(self.map, Node)
        if known:
            array = np.asarray(self.map, float)
            if array.ndim != 3 or array.shape[2] != 3 or not np.isfinite(array).all() or array.min(initial=0) < 0:
                raise InputError(f"an environment's map of shape {array.shape}; (n, n, 3) radiance, finite and not negative, is needed: "
                                 "make it with octahedral()")
            object.__setattr__(self, "map", constant(array))
        e = self.map.extent
        if self.map.vtype != "vec3" or e.width != e.height or e.width not in SIZES:
            raise GraphError(f"an environment's map is {self.map!r}; a vec3 image of n x n texels is needed, n one of {SIZES}")
        object.__setattr__(self, "gradient", self.gradient or ("none" if known else "exact"))
        if self.gradient not in GRADIENTS:
            raise InputError(f"an environment's gradient is {self.gradient!r:.40}; {' or '.join(GRADIENTS)} is allowed")
        if isinstance(self.rotation, Node):
            if (self.rotation.vtype, self.rotation.extent) != ("vec3", UNIT):
                raise GraphError(f"an environment's rotation is {self.rotation!r}; a vec3 of extent 1x1 is needed")
        elif np.shape(self.rotation) != (3,) or not np.isfinite(np.asarray(self.rotation, float)).all():
            raise InputError(f"an environment's rotation is {self.rotation!r:.60}; three numbers are needed")
        if isinstance(self.strength, Node) and self.strength.extent != UNIT or not isinstance(self.strength, (Node, int, float)):
            raise InputError(f"an environment's strength is {self.strength!r:.60}; a number, or a parameter of one value, is needed")

    @property
    def size(self) -> int:
        """Texels a side of the map."""
        return self.map.extent.width

    @cached_property
    def levels(self) -> Node:
        """vec3: the image of all levels (`prefilter.layout`)."""
        n, pyramid = self.size, [self.map]
        while n > LEAST:
            pyramid.append(gather_sum(pyramid[-1], *halving(n)))
            n //= 2
        rows, cols, weights = matrix(self.size)
        height, width = rows.shape[:2]
        return apply("weighted_gather_sum", concat(*pyramid), constant(rows, image(width, height)), constant_table(cols),
                     constant_table(weights))

    def specular(self, direction: Node, roughness: Node | float, covered: Node | None = None) -> Node:
        """vec3: the light that a lobe of this roughness about the direction (vec3, length 1) sees, its weights adding to 1. covered: int, 0
        where nobody asks (the exact gradient counts no others)."""
        levels, at = layout(self.size).levels, apply("kept", place(self._turned(direction)))
        steps, k = np.diff(ROUGHNESSES), len(ROUGHNESSES) - 1
        if not isinstance(roughness, Node):
            r = min(max(float(roughness), 0.0), 1.0)
            k = min(int(np.searchsorted(ROUGHNESSES, r, "right")) - 1, k - 1)
            t = (r - ROUGHNESSES[k]) / steps[k]
            parts = [(levels[k], 1.0 - t), (levels[k + 1], t)]
            return self._scaled(_added([self._sampled(level, at, covered) * part for level, part in parts if part > 0.0]))
        r = clamp(roughness, 0.0, 1.0)
        corners = tuple((x.n, x.x, x.y) for x in levels)
        if self.gradient == "none":
            t, sides = between(r, ROUGHNESSES, list(zip(*corners)))
            low, high = (self._at(at * n + compose(x, y), covered) for n, x, y in sides)
            return self._scaled(low + (high - low) * t)
        if r.extent == UNIT:
            mask = apply("broadcast", as_node(1), extent=at.extent) if covered is None else covered
            return self._scaled(apply("sample_lobes", self.levels, at, r, mask, corners=corners, knots=ROUGHNESSES))
        weights = []
        for k, middle in enumerate(ROUGHNESSES):
            rising = (r - ROUGHNESSES[k - 1]) * (1.0 / steps[k - 1]) if k else None
            falling = (ROUGHNESSES[k + 1] - r) * (1.0 / steps[k]) if k < len(steps) else None
            both = rising if falling is None else falling if rising is None else select(r < middle, rising, falling)
            weights.append(maximum(both, 0.0))
        return self._scaled(_added([self._sampled(level, at, covered) * w for level, w in zip(levels, weights)]))

    def diffuse(self, normal: Node, covered: Node | None = None) -> Node:
        """vec3: what a white Lambert surface with this normal (length 1) reflects, irradiance / pi."""
        return self._scaled(self._sampled(layout(self.size).diffuse, place(self._turned(normal)), covered))

    def seen(self, frame: Frame) -> Node:
        """vec3: the map itself, as each camera of the frame sees it behind everything."""
        return self._scaled(self._sampled(layout(self.size).levels[0], place(self._turned(frame.ray))))

    def _turned(self, direction: Node) -> Node:
        if not isinstance(self.rotation, Node) and not any(self.rotation):
            return direction
        rotation = self.rotation if isinstance(self.rotation, Node) else compose(*map(float, self.rotation))
        rows = rotation_rows(rotation)  # of the transpose, columns
        return _added([row * x for row, x in zip(rows, channels(direction))])

    def _sampled(self, level: Level, at: Node, covered: Node | None = None) -> Node:
        return self._at(at * float(level.n) + compose(float(level.x), float(level.y)), covered)

    def _at(self, texel: Node, covered: Node | None) -> Node:
        """texel: places within a level from the corner of its rim, in texels, but for the rim itself. By fetches, whatever the gradient:
        the filters of devices have weights of 8 bits."""
        e = self.levels.extent
        uv = scaled(texel, e)
        levels = self.levels if self.gradient == "exact" else apply("stop_gradient", self.levels)
        return sample_texture(levels, uv, "clamp", covered=covered)

    def _scaled(self, light: Node) -> Node:
        return light if not isinstance(self.strength, Node) and self.strength == 1.0 else light * self.strength


def _added(terms: list[Node]) -> Node:
    first, *others = terms
    for x in others:
        first = first + x
    return first
