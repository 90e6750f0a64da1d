"""Lights, and what arrives of them: the irradiance of a surface that faces the light, and the direction to it."""
from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from ...cache.errors import GraphError, InputError
from ...cache.layout import beyond_fp32
from ..graph.functions import compose, dot, maximum, normalize
from ..graph.ir import UNIT, Node

KINDS = ("directional", "point", "ambient")


@dataclass(frozen=True)
class Light:
    """kind "directional": `vector` is the direction in which the light travels, `power` its irradiance; "point": position and intensity;
    "ambient": power is the radiance from everywhere. Three numbers each (power: or one), or a vec3 of extent 1x1: a parameter."""

    kind: str
    power: tuple[float, float, float] | Node
    vector: tuple[float, float, float] | Node | None = None

    def __post_init__(self):
        if self.kind not in KINDS:
            raise InputError(f"light kind {self.kind!r}; {' '.join(KINDS)} are allowed")
        for name in ("power", "vector"):
            x = getattr(self, name)
            if name == "vector" and self.kind == "ambient":
                continue
            if isinstance(x, Node):
                if (x.vtype, x.extent) != ("vec3", UNIT):
                    raise GraphError(f"{self.kind} light: {name} is {x!r}; a vec3 of extent 1x1 is needed")
                continue
            x = (x,) * 3 if isinstance(x, (int, float)) and name == "power" else x
            if x is None or len(x) != 3 or not all(isinstance(c, (int, float)) and not beyond_fp32(c) for c in x):
                raise InputError(f"{self.kind} light: {name} is {x!r}; three numbers that are finite in fp32 are needed")
            object.__setattr__(self, name, tuple(map(float, x)))
        if self.kind == "directional" and not isinstance(self.vector, Node) and not any(self.vector):
            raise InputError("directional light: vector is zero; a direction is needed")

    def arriving(self, position: Node) -> tuple[Node, Node, Node | float]:
        """At a point (vec3): power, the direction to the light (vec3, length 1), and what 1 / power of its irradiance is: 1, or the
        squared distance. Of a light that is not ambient."""
        power, vector = _node(self.power), _node(self.vector)
        if self.kind == "directional":
            return power, -normalize(vector), 1.0
        to_light = vector - position
        return power, normalize(to_light), maximum(dot(to_light, to_light), 1e-8)


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
            term = power * (maximum(-dot(n, normalize(vector)), 0.0) / math.pi)
        else:
            power, to_light, squared = light.arriving(position)
            term = power * (maximum(dot(n, to_light), 0.0) / (squared * math.pi))
        total = term if total is None else total + term
    return total
