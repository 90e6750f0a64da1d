"""Shading of one layer: unlit albedo, vertex colours, Lambert under point, directional and ambient light.

In: nodes over the atlas. Out: linear radiance, vec3. Lambert: albedo (E / pi max(n.l, 0) + ambient), E the irradiance of a surface that
faces the light; a point light of intensity I at distance d gives E = I / d^2.
"""
from __future__ import annotations

import math
from dataclasses import dataclass

from ...cache.errors import InputError
from ...cache.layout import beyond_fp32
from ..graph.functions import apply, dot, maximum, minimum, normalize, select
from ..graph.ir import Node

KINDS = ("directional", "point", "ambient")


@dataclass(frozen=True)
class Light:
    """kind "directional": `vector` is the direction the light travels, `power` its irradiance; "point": position and intensity;
    "ambient": power is the radiance from everywhere. Three numbers each (power: or one)."""

    kind: str
    power: tuple[float, float, float]
    vector: tuple[float, float, float] | None = None

    def __post_init__(self):
        if self.kind not in KINDS:
            raise InputError(f"light kind {self.kind!r}; {' '.join(KINDS)} are allowed")
        for name in ("power", "vector"):
            x = getattr(self, name)
            if name == "vector" and self.kind == "ambient":
                continue
            x = (x,) * 3 if isinstance(x, (int, float)) and name == "power" else x
            if x is None or len(x) != 3 or not all(isinstance(c, (int, float)) and not beyond_fp32(c) for c in x):
                raise InputError(f"{self.kind} light: {name} is {x!r}; three numbers that are finite in fp32 are needed")
            object.__setattr__(self, name, tuple(map(float, x)))
        if self.kind == "directional" and not any(self.vector):
            raise InputError("directional light: vector is zero; a direction is needed")


def lambert(albedo: Node, normal: Node, position: Node, lights: list[tuple[str, Node, Node | None]]) -> Node:
    """Radiance of a Lambert surface. normal need not be of length 1; lights are (kind, power vec3, vector vec3 or None)."""
    n = normalize(normal)
    total = None
    for kind, power, vector in lights:
        if kind == "ambient":
            term = power
        elif kind == "directional":
            term = power * (maximum(-dot(n, normalize(vector)), 0.0) / math.pi)
        else:
            to_light = vector - position
            squared = maximum(dot(to_light, to_light), 1e-8)
            term = power * (maximum(dot(n, normalize(to_light)), 0.0) / (squared * math.pi))
        total = term if total is None else total + term
    return albedo * total


def encode_srgb(linear: Node) -> Node:
    """IEC 61966-2-1 transfer of linear values to sRGB, clamped to [0, 1]."""
    x = minimum(maximum(linear, 0.0), 1.0)
    return select(x <= 0.0031308, x * 12.92, 1.055 * apply("pow", maximum(x, 0.0031308), 1.0 / 2.4) - 0.055)
