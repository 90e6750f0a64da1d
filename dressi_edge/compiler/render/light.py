"""Lights, and what arrives of them: the irradiance of a surface that faces the light, and the direction to it."""
from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from ...cache.errors import GraphError, InputError
from ...cache.layout import beyond_fp32
from ..graph.functions import clamp, compose, dot, maximum, normalize, select, stop_gradient
from ..graph.ir import UNIT, Node

KINDS = ("directional", "point", "spot", "ambient")
PLACED = ("point", "spot")  # of which `vector` is a position
NEAR = 1e-8  # the squared distance from a light within which neither its irradiance nor its direction has a slope
SIZES = (16, 4096)  # of a shadow map


@dataclass(frozen=True)
class Shadow:
    """How a light's shadow is drawn. size: of the map in texels, a side (of each of the six of a point light). filter: texels a side over
    which the edge of a shadow is spread, 1 to 5.

    A surface must not shadow itself: what lies less than a bias behind the map counts as lit. The bias is `bias` texels of the map as large
    as they are there, plus as much as the face that the map shows falls away over the filter, at most `limit` texels. Thinner things lose
    their shadow, and shadows begin so far behind what casts them. Raises InputError."""

    size: int = 1024
    filter: int = 2
    bias: float = 1.0
    limit: float = 16.0

    def __post_init__(self) -> None:
        for name, low, high, kind in (("size", *SIZES, int), ("filter", 1, 5, int), ("bias", 0, 1e4, float), ("limit", 0, 1e4, float)):
            x = getattr(self, name)
            if isinstance(x, bool) or not isinstance(x, (int, kind)) or not low <= x <= high:
                what = "a whole number" if kind is int else "a number"
                raise InputError(f"shadow: {name} is {x!r:.40}; {what} from {low:g} to {high:g} is needed")


@dataclass(frozen=True)
class Light:
    """kind "directional": `vector` is the direction in which the light travels, `power` its irradiance; "point": position and intensity;
    "spot": those, with the `direction` in which its cone opens, and `cone`: the angles from that, in radians, up to which the intensity is
    whole and from which on there is none, falling in between as in KHR_lights_punctual; "ambient": power is the radiance from everywhere.
    Three numbers each (power: or one), or a vec3 of extent 1x1: a parameter; cone: two numbers. shadow: how its shadow is drawn, of which
    `Scene.lit` and `Scene.shadow` make a function of points (vec3) that gives the share of the light that arrives; None: all of it."""

    kind: str
    power: tuple[float, float, float] | Node
    vector: tuple[float, float, float] | Node | None = None
    direction: tuple[float, float, float] | Node | None = None
    cone: tuple[float, float] = (0.0, math.pi / 4)
    shadow: Shadow | Callable[[Node], Node] | None = None

    def __post_init__(self):
        if self.kind not in KINDS:
            raise InputError(f"light kind {self.kind!r}; {' '.join(KINDS)} are allowed")
        if self.kind != "spot" and self.direction is not None:
            raise InputError(f"{self.kind} light: direction is {self.direction!r:.60}; only a spot has one: drop it")
        for name in ("power", "vector", "direction"):
            x = getattr(self, name)
            if name == "vector" and self.kind == "ambient" or name == "direction" and self.kind != "spot":
                continue
            if isinstance(x, Node):
                if (x.vtype, x.extent) != ("vec3", UNIT):
                    raise GraphError(f"{self.kind} light: {name} is {x!r}; a vec3 of extent 1x1 is needed")
                continue
            x = (x,) * 3 if isinstance(x, (int, float)) and name == "power" else x
            if x is None or len(x) != 3 or not all(isinstance(c, (int, float)) and not beyond_fp32(c) for c in x):
                raise InputError(f"{self.kind} light: {name} is {x!r}; three numbers that are finite in fp32 are needed")
            object.__setattr__(self, name, tuple(map(float, x)))
        for kind, name in (("directional", "vector"), ("spot", "direction")):
            if self.kind == kind and not isinstance(getattr(self, name), Node) and not any(getattr(self, name)):
                raise InputError(f"{kind} light: {name} is zero; a direction is needed")
        good = isinstance(self.cone, (tuple, list)) and len(self.cone) == 2 and all(isinstance(a, (int, float)) for a in self.cone)
        if not good or not 0.0 <= self.cone[0] < self.cone[1] <= math.pi / 2:
            raise InputError(f"{self.kind} light: cone is {self.cone!r:.60}; two angles in radians, 0 <= inner < outer <= pi / 2, are "
                             "needed")
        object.__setattr__(self, "cone", tuple(map(float, self.cone)))
        fits = self.shadow is None or isinstance(self.shadow, Shadow) or callable(self.shadow)
        if not fits or self.shadow is not None and self.kind == "ambient":
            raise InputError(f"{self.kind} light: shadow is {self.shadow!r:.60}; a Shadow is needed, and of an ambient light, which comes "
                             "from everywhere, none")

    def share(self, position: Node) -> Node | float:
        """How much of the light arrives at a point (vec3) for all that stands in its way. Raises InputError."""
        if self.shadow is None:
            return 1.0
        if isinstance(self.shadow, Shadow):
            raise InputError(f"a {self.kind} light's shadow is of no scene yet; give materials what scene.shadow(light) makes of it")
        return self.shadow(position)

    def arriving(self, position: Node) -> tuple[Node, Node, Node | float]:
        """At a point (vec3): power, the direction to the light (vec3, length 1), and what 1 / power of its irradiance is: 1, or the
        squared distance. Of a light that is not ambient."""
        power, vector = _node(self.power), _node(self.vector)
        if self.shadow is not None:
            power = power * self.share(position)
        if self.kind == "directional":
            return power, -normalize(vector), 1.0
        to_light = vector - position
        squared, towards = dot(to_light, to_light), normalize(to_light)
        # The slope of a direction is 1 / distance: what would be left of it at 1e-7 has squares beyond fp32.
        towards = select(squared > NEAR, towards, stop_gradient(towards))
        if self.kind == "spot":
            inner, outer = map(math.cos, self.cone)
            inside = clamp((-dot(towards, normalize(_node(self.direction))) - outer) / max(inner - outer, 1e-3), 0.0, 1.0)
            power = power * (inside * inside)
        return power, towards, maximum(squared, NEAR)


def _node(x) -> Node:
    return x if isinstance(x, Node) else compose(*x)


def diffuse(normal: Node, position: Node, lights: Sequence[Light]) -> Node:
    """Radiance of a white Lambert surface: E / pi max(n.l, 0) + ambient, summed over the lights. normal need not be of length 1."""
    n, total = normalize(normal), None
    for light in lights:
        if light.kind == "ambient":
            term = _node(light.power)
        elif light.kind == "directional":
            power, vector = _node(light.power), _node(light.vector)
            if light.shadow is not None:
                power = power * light.share(position)
            term = power * (maximum(-dot(n, normalize(vector)), 0.0) / math.pi)
        else:
            power, to_light, squared = light.arriving(position)
            term = power * (maximum(dot(n, to_light), 0.0) / (squared * math.pi))
        total = term if total is None else total + term
    return total
