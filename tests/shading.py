"""Metallic-roughness shading written once more, in NumPy float64 from glTF 2.0's appendix B, for tests: the reflectance, light that arrives
from everywhere by Monte Carlo, and surfaces whose values are given and not drawn."""
from types import SimpleNamespace

import numpy as np

from dressi_edge.compiler import Program
from dressi_edge.compiler.check_op import image_layout


def unit(x):
    x = np.asarray(x, float)
    return x / np.linalg.norm(x, axis=-1, keepdims=True)


def dots(a, b):
    return (a * b).sum(-1, keepdims=True)


def brdf(n, v, light, color, metallic, roughness):
    """f(l, v) (..., 3) of unit vectors (..., 3), and color (..., 3), metallic and roughness (..., 1): in its textbook form."""
    h = unit(light + v)
    a2 = roughness ** 4
    nl, nv, nh, vh = (np.maximum(dots(x, y), 1e-9) for x, y in ((n, light), (n, v), (n, h), (v, h)))
    d = a2 / (np.pi * (nh ** 2 * (a2 - 1) + 1) ** 2)

    def smith(c):  # Lambda of the masking function
        return (np.sqrt(1 + a2 * (1 / c ** 2 - 1)) - 1) / 2

    g = 1 / (1 + smith(nl) + smith(nv))
    f0 = 0.04 * (1 - metallic) + color * metallic
    f = f0 + (1 - f0) * (1 - vh) ** 5
    return (1 - f) * color * (1 - metallic) / np.pi + f * d * g / (4 * nl * nv)


def frames(n):
    """Two unit vectors (..., 3) that make a right-handed frame with n."""
    up = np.where(np.abs(n[..., :1]) < 0.7, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    t = unit(np.cross(up, n))
    return t, np.cross(n, t)


def reflected(n, v, color, metallic, roughness, arriving, rng, samples=20000):
    """(m, 3): what surfaces (m) send to the eye of the radiance `arriving(directions)`, by Monte Carlo of the very reflectance. Half of
    the directions follow the cosine, half the microfacets' normals, weighed by both densities (balance heuristic)."""
    out = np.empty_like(n)
    t, b = frames(n)
    for k in range(len(n)):
        basis, a2 = np.stack([t[k], b[k], n[k]]), float(roughness[k, 0]) ** 4
        u = (np.arange(samples) + rng.uniform(size=samples)) / samples
        turn = 2 * np.pi * rng.permutation(u)
        half = samples // 2
        c = np.where(np.arange(samples) % 2 == 0, np.sqrt(u), np.sqrt((1 - u) / (1 + (a2 - 1) * u)))
        s = np.sqrt(np.maximum(1 - c * c, 0))
        w = np.stack([s * np.cos(turn), s * np.sin(turn), c], 1) @ basis
        micro = (np.arange(samples) % 2 == 1)[:, None]
        light = np.where(micro, 2 * dots(w, v[k]) * w - v[k], w)
        h = unit(light + v[k])
        nl, nh, vh = dots(light, n[k]), np.maximum(dots(h, n[k]), 1e-9), np.maximum(dots(h, v[k]), 1e-9)
        d = a2 / (np.pi * (nh ** 2 * (a2 - 1) + 1) ** 2)
        density = (np.maximum(nl, 0) / np.pi + d * nh / (4 * vh)) / 2
        ok = (nl > 0)[:, 0]
        f = brdf(n[k], v[k], light[ok], color[k], metallic[k], roughness[k])
        out[k] = (f * nl[ok] * arriving(light[ok]) / density[ok]).sum(0) / (2 * half)
    return out


class Given:
    """Surfaces of a grid (h, w, c): each value an input of a program, so that a material may be called with them."""

    def __init__(self, **arrays):
        self.program, self.feed = Program(), {name: np.asarray(a, float) for name, a in arrays.items()}
        self.nodes = {name: self.program.input(name, image_layout(a), image_layout(a).from_image(a)) for name, a in self.feed.items()}
        self.surface = SimpleNamespace(**self.nodes)
        self.surface.geometric_normal = self.nodes.get("geometric_normal", self.nodes.get("normal"))


def random_surfaces(rng, shape=(9, 13), least=0.05):
    """Normals, eyes and points with n.v of `least` or more."""
    n = unit(rng.normal(size=(*shape, 3)))
    v = unit(rng.normal(size=(*shape, 3)))
    v = np.where(dots(n, v) < 0, v - 2 * dots(n, v) * n, v)
    v = unit(np.where(dots(n, v) < least, v + (least + 0.01) * n, v))
    return {"normal": n, "to_eye": v, "position": rng.normal(size=(*shape, 3)) * 0.3}
