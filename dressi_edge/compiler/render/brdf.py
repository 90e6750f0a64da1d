"""The reflectance of metallic-roughness surfaces (glTF 2.0, appendix B), and its integrals over directions as a table.

In: cosines and roughness, as graph. Out: the microfacet terms, and what the surface reflects of light that is the same from everywhere.
alpha = roughness^2; the normals of microfacets are distributed by GGX (Walter et al. 2007), they hide each other by Smith's function in
its height-correlated form (Heitz 2014), and reflect by Schlick's approximation of Fresnel (1994).
"""
from __future__ import annotations

import functools
import math

import numpy as np

from ..graph.functions import clamp, compose, constant, maximum, sqrt
from ..graph.ir import Node
from .texture import sample_texture

LEAST_ROUGHNESS = 0.02  # alpha^2 = 1.6e-7, about what fp32 tells apart from 0 beside 1
LEAST_COSINE = 1e-4  # of the angle between normal and eye
TABLE = 32  # entries a side: bilinear between them A, B and C are right to 0.002, 0.0004 in the middle


def ggx(nh2: Node, side: Node, alpha: Node | float) -> Node:
    """D, per steradian. nh2: (n.h)^2, 0 where n.h is negative; side: |n x h|^2, which has its digits where 1 - (n.h)^2 has none and alpha
    is small."""
    a2 = alpha * alpha
    width = maximum(nh2 * a2 + side, 1e-10)  # of a normal that is none it is 0
    return a2 / (math.pi * width * width)


def visibility(nl: Node, nv: Node, alpha: Node | float) -> Node:
    """G / (4 n.l n.v). nl >= 0, nv > 0."""
    a2 = alpha * alpha
    rest = 1.0 - a2
    return 0.5 / (nl * sqrt(nv * (nv * rest) + a2) + nv * sqrt(nl * (nl * rest) + a2))


def schlick(vh: Node) -> Node:
    """(1 - v.h)^5: how far reflectance has gone from that at right angles to 1."""
    x = clamp(1.0 - vh, 0.0, 1.0)
    squared = x * x
    return squared * squared * x


def reflectance(nv: Node, roughness: Node | float) -> Node:
    """vec3 (A, B, C) of the table, at a cosine and a roughness in [0, 1]: a surface under radiance 1 from everywhere sends to the eye
    f0 A + B by reflection, and the part (1 - f0) (1 - C) of its diffuse colour."""
    place = compose(nv, roughness) * ((TABLE - 1) / TABLE) + 0.5 / TABLE
    return sample_texture(constant(_table()), place, "clamp")


@functools.lru_cache(maxsize=1)
def _table() -> np.ndarray:
    """(TABLE, TABLE, 3): rows by roughness, columns by n.v, both from 0 to 1."""
    side = np.linspace(0.0, 1.0, TABLE)
    roughness, nv = np.meshgrid(np.maximum(side, LEAST_ROUGHNESS), np.maximum(side, LEAST_COSINE), indexing="ij")
    a, b = specular_integrals(nv.ravel(), roughness.ravel())
    return np.stack([a, b, diffuse_loss(nv.ravel())], 1).reshape(TABLE, TABLE, 3)


def specular_integrals(nv: np.ndarray, roughness: np.ndarray, steps: tuple[int, int] = (64, 32)) -> tuple[np.ndarray, np.ndarray]:
    """A and B (m,) of cosines and roughnesses (m,): the integrals of D V n.l (1 - w) and D V n.l w over directions l, w = schlick(v.h).

    Midpoint sums over microfacet normals, which are laid out as GGX has them (so that D drops out) but closer where they lie flat.
    """
    a, nv = (np.asarray(roughness, float) ** 2)[:, None, None], np.asarray(nv, float)[:, None, None]
    t = ((np.arange(steps[0]) + 0.5) / steps[0])[None, :, None]
    u, du = 1.0 - (1.0 - t) ** 3, 3.0 * (1.0 - t) ** 2
    turn = ((np.arange(steps[1]) + 0.5) / steps[1] * np.pi)[None, None, :]
    nh2 = (1.0 - u) / (1.0 + (a * a - 1.0) * u)
    vh = np.maximum(np.sqrt(np.maximum(1.0 - nh2, 0.0)) * np.cos(turn) * np.sqrt(1.0 - nv * nv) + np.sqrt(nh2) * nv, 0.0)
    nl = np.maximum(2.0 * vh * np.sqrt(nh2) - nv, 0.0)
    v = 0.5 / (nl * np.sqrt(nv * nv * (1.0 - a * a) + a * a) + nv * np.sqrt(nl * nl * (1.0 - a * a) + a * a))
    terms, w = 4.0 * v * nl * vh / np.sqrt(nh2) * du, (1.0 - vh) ** 5
    return (terms * (1.0 - w)).mean((1, 2)), (terms * w).mean((1, 2))


def diffuse_loss(nv: np.ndarray, steps: tuple[int, int] = (64, 64)) -> np.ndarray:
    """C (m,) of cosines (m,): the mean of schlick(v.h) over directions l, by their cosine."""
    nv = np.asarray(nv, float)[:, None, None]
    nl = np.sqrt((np.arange(steps[0]) + 0.5) / steps[0])[None, :, None]
    turn = ((np.arange(steps[1]) + 0.5) / steps[1] * np.pi)[None, None, :]
    vl = nl * nv + np.sqrt(1.0 - nl * nl) * np.sqrt(1.0 - nv * nv) * np.cos(turn)
    return ((1.0 - np.sqrt(np.maximum(1.0 + vl, 0.0) / 2.0)) ** 5).mean((1, 2))
