"""The sphere of directions as a square: the octahedral map (Praun and Hoppe 2003, Engelhardt and Dachsbacher 2008).

|x| + |y| + |z| = 1 cut open at -y and folded flat: +y is in the middle, -y at the corners, x runs to the right and z down. Texel (row,
column) of n x n has its centre at ((column + 0.5) / n, (row + 0.5) / n). Beyond a border the map goes on at the same border, turned round:
a rim of one texel makes bilinear samples seamless (`rim`). In: directions or panoramas. Out: places on the square, pictures of n x n.
"""
from __future__ import annotations

import functools
import math

import numpy as np

from ...cache.errors import InputError
from ..graph.functions import absolute, compose, maximum, select
from ..graph.ir import Node

SIZES = (16, 32, 64, 128, 256)


def place(direction: Node) -> Node:
    """vec2 in [0, 1] of directions (vec3, of any length but zero)."""
    x, y, z = direction.x, direction.y, direction.z
    p = compose(x, z) / maximum(absolute(x) + absolute(y) + absolute(z), 1e-20)
    turned = 1.0 - absolute(compose(p.y, p.x))
    return select(y < 0.0, select(p >= 0.0, turned, -turned), p) * 0.5 + 0.5


def folded(p: np.ndarray) -> np.ndarray:
    """Points (..., 2) of the square [-1, 1]^2, or of a rim around it, as points (..., 3) with |x| + |y| + |z| = 1."""
    p = np.array(p, float)
    for k in (0, 1):
        out = np.abs(p[..., k]) > 1
        p[..., k] = np.where(out, np.sign(p[..., k]) * 2 - p[..., k], p[..., k])
        p[..., 1 - k] = np.where(out, -p[..., 1 - k], p[..., 1 - k])
    y = 1.0 - np.abs(p).sum(-1)
    sign = np.where(p >= 0, 1.0, -1.0)
    flat = np.where(y[..., None] < 0, (1.0 - np.abs(p[..., ::-1])) * sign, p)
    return np.stack([flat[..., 0], y, flat[..., 1]], -1)


def places(direction: np.ndarray) -> np.ndarray:
    """(..., 2) in [0, 1] of directions (..., 3): `place` in NumPy."""
    d = np.asarray(direction, float)
    d = d / np.abs(d).sum(-1, keepdims=True)
    p = d[..., [0, 2]]
    turned = (1.0 - np.abs(p[..., ::-1])) * np.where(p >= 0, 1.0, -1.0)
    return np.where(d[..., 1:2] < 0, turned, p) * 0.5 + 0.5


@functools.lru_cache(maxsize=16)
def cells(n: int, parts: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Each texel of n x n in parts x parts pieces: unit directions (n n, parts^2, 3) to their centres, and their solid angles
    (n n, parts^2), dx dz / |q|^3 for q on the octahedron."""
    side = (np.arange(n * parts) + 0.5) / (n * parts) * 2.0 - 1.0
    z, x = np.meshgrid(side, side, indexing="ij")
    q = folded(np.stack([x, z], -1)).reshape(n, parts, n, parts, 3).swapaxes(1, 2).reshape(n * n, parts * parts, 3)
    size = np.linalg.norm(q, axis=-1)
    return q / size[..., None], (2.0 / (n * parts)) ** 2 / size ** 3


def rim(n: int) -> np.ndarray:
    """(n + 2, n + 2): for each texel of the square with its rim which of its n n texels it shows."""
    side = (np.arange(-1, n + 1) + 0.5) / n * 2.0 - 1.0
    z, x = np.meshgrid(side, side, indexing="ij")
    texel = np.floor(places(folded(np.stack([x, z], -1))) * n).clip(0, n - 1).astype(np.int64)
    return texel[..., 1] * n + texel[..., 0]


def octahedral(panorama: np.ndarray, n: int) -> np.ndarray:
    """A panorama (h, w, c) as (n, n, c): of each texel the mean radiance over its solid angle, so that no light is lost, however small its
    source. The panorama's middle column looks along -z, a quarter to the right of it along +x; its top row is +y. Raises InputError."""
    panorama = np.asarray(panorama, float)
    if n not in SIZES:
        raise InputError(f"an octahedral map of {n!r:.40} texels a side; allowed: {' '.join(map(str, SIZES))}")
    if panorama.ndim != 3 or panorama.shape[1] != 2 * panorama.shape[0]:
        raise InputError(f"the panorama has shape {panorama.shape}; (height, 2 height, channels) is needed: the whole sphere")
    h, w, c = panorama.shape
    fine = max(2, -(-8 * n // h))  # pieces of each of its pixels: at least eight a texel
    total, weight = np.zeros((n * n, c)), np.zeros(n * n)
    for row in range(h):
        theta = (row + (np.arange(fine) + 0.5) / fine) * math.pi / h
        cell = np.floor(places(panorama_directions(theta, w * fine)) * n).clip(0, n - 1).astype(np.int64)
        index = (cell[..., 1] * n + cell[..., 0]).ravel()
        angle = np.repeat(np.sin(theta), w * fine)
        values = np.tile(np.repeat(panorama[row], fine, axis=0), (fine, 1))
        weight += np.bincount(index, angle, n * n)
        for k in range(c):
            total[:, k] += np.bincount(index, angle * values[:, k], n * n)
    return (total / weight[:, None]).reshape(n, n, c)


def panorama_directions(theta: np.ndarray, width: int) -> np.ndarray:
    """(rows, width, 3): directions of a panorama's pixels in rows at angles theta from +y."""
    phi = ((np.arange(width) + 0.5) / width - 0.5) * 2 * math.pi
    s = np.sin(theta)[:, None]
    return np.stack([s * np.sin(phi), np.broadcast_to(np.cos(theta)[:, None], (len(theta), width)), -s * np.cos(phi)], -1)


def panorama(square: np.ndarray, height: int) -> np.ndarray:
    """The panorama (height, 2 height, c) that an octahedral map (n, n, c) shows, bilinear: what to look at, and to write."""
    square, n = np.asarray(square, float), len(square)
    direction = panorama_directions((np.arange(height) + 0.5) * math.pi / height, 2 * height)
    rimmed = square.reshape(n * n, -1)[rim(n)]
    s = places(direction) * n + 0.5
    k = np.floor(s).astype(np.int64).clip(0, n)
    f = s - k
    rows = [rimmed[k[..., 1] + j, k[..., 0]] * (1 - f[..., :1]) + rimmed[k[..., 1] + j, k[..., 0] + 1] * f[..., :1] for j in (0, 1)]
    return rows[0] * (1 - f[..., 1:]) + rows[1] * f[..., 1:]
