"""The metallic-roughness material of glTF 2.0 (section 3.9, appendix B), under lights. Forward only: every gradient comes from the AD."""
from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from ...cache.errors import InputError
from ..graph.functions import absolute, apply, clamp, compose, cross, dot, maximum, mix, normalize
from ..graph.ir import Node
from .brdf import LEAST_COSINE, LEAST_ROUGHNESS, ggx, reflectance, schlick, visibility
from .environment import Environment
from .light import Light
from .material import Source, evaluate, facing
from .surface import Surface

DIELECTRIC = 0.04  # what a surface that is no metal reflects at right angles: index of refraction 1.5


@dataclass(frozen=True)
class PBR:
    """color: of a metal its reflectance at right angles, else the diffuse colour, linear. roughness: the square root of GGX's alpha, in
    [0, 1], used from 0.02 on. metallic: in [0, 1]. occlusion: the part of ambient light that arrives. emissive: radiance of its own.
    normal: the direction to shade with, in world space, such as a `NormalMap`; the surface's own unless given.
    two_sided: faces seen from behind are lit from the side on which one sees them; else they are lit as the front.
    Each a source (`material.Source`), one number or three channels as its name says; one channel of a texture is `Channel(Texture(image),
    "y")`. lights: may be empty. environment: light from everywhere by a map, added to them.

    Radiance: with f0 = 0.04 + (color - 0.04) metallic and F = f0 + (1 - f0) (1 - v.h)^5, for each light
    E n.l ((1 - F) (1 - metallic) color / pi + F D V). Ambient light is integrated with the very same reflectance, by a table; that of an
    environment by the split sum: its own integral by the lobe times the reflectance's.
    """

    color: Source = 0.5
    roughness: Source = 0.5
    metallic: Source = 0.0
    occlusion: Source = 1.0
    emissive: Source = 0.0
    lights: Sequence[Light] = ()
    environment: Environment | None = None
    two_sided: bool = False
    normal: Source | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.lights, (tuple, list)) or not all(isinstance(light, Light) for light in self.lights):
            raise InputError(f"lights are {self.lights!r:.60}; a sequence of Lights is needed")
        if not isinstance(self.environment, (Environment, type(None))):
            raise InputError(f"environment is {self.environment!r:.60}; an Environment is needed")

    def __call__(self, s: Surface) -> Node:
        n, v, color = facing(s, self.two_sided, self.normal), s.to_eye, _vec3(evaluate(self.color, s))
        metallic, roughness = evaluate(self.metallic, s), maximum(evaluate(self.roughness, s), LEAST_ROUGHNESS)
        alpha, f0, body = roughness * roughness, mix(DIELECTRIC, color, metallic), color * (1.0 - metallic)
        nv = maximum(dot(n, v), LEAST_COSINE)
        total, ambient = _vec3(evaluate(self.emissive, s)), None
        for light in self.lights:
            if light.kind == "ambient":
                power = light.power if isinstance(light.power, Node) else compose(*light.power)
                ambient = power if ambient is None else ambient + power
                continue
            power, to_light, squared = light.arriving(s.position)
            half = normalize(to_light + v)
            side = cross(n, half)
            nh = maximum(dot(n, half), 0.0)
            # One image of each light, where geometry rests. Each product below has a factor that does not, so that no more is kept.
            known = apply("kept", compose(maximum(dot(n, to_light), 0.0), schlick(absolute(dot(v, half))), nh * nh, dot(side, side)))
            nl = known.x
            fresnel = f0 + (1.0 - f0) * known.y
            shine = ggx(known.z, known.w, alpha) * visibility(nl, nv, alpha)
            total = total + ((1.0 - fresnel) * (body * (1.0 / math.pi)) + fresnel * shine) * power * nl / squared
        if ambient is None and self.environment is None:
            return total
        parts = reflectance(clamp(nv, 0.0, 1.0), clamp(roughness, 0.0, 1.0))
        mirrored, diffused = f0 * parts.x + parts.y, body * ((1.0 - f0) * (1.0 - parts.z))
        around = None if ambient is None else ambient * (diffused + mirrored)
        if self.environment is not None:
            sky, covered = self.environment, getattr(s, "inside", None)
            towards = normalize(n * (2.0 * dot(n, v)) - v)
            light = sky.specular(towards, roughness, covered) * mirrored + sky.diffuse(n, covered) * diffused
            around = light if around is None else around + light
        return total + around * evaluate(self.occlusion, s)


def _vec3(x) -> Node:
    return x if isinstance(x, Node) and x.channels == 3 else compose(x, x, x)
