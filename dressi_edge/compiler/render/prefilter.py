"""What surfaces see of an environment, as constant sparse matrices over its texels: the microfacet lobes of several roughnesses, and the
cosine of diffuse light. Their transposes are exact, so that an environment may be optimized through them.

In: how many texels a side the octahedral map has. Out: levels (roughness and size of each), where each lies in one image of all levels, and
the matrix from a pyramid of the map to that image, in compressed rows.

Rows are short and yet exact because they read from a pyramid (each level averages 2 x 2 texels by solid angle): near its direction a row
reads small texels, far from it large ones (a quadtree, refined while a texel looks large from the middle of the lobe).
"""
from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .octahedron import cells, rim

# Of the levels, between which it is linear: roughness, and texels a side at most. A texel is narrower than half the lobe: with 16 a side
# from 0.3 on, half of a metal's pixels were off by more than 1.3 % at 0.4 and 0.5, now by 0.9 % at any roughness.
SIZES = {0.0: None, 0.1: 128, 0.2: 32, 0.3: 32, 0.4: 32, 0.55: 32, 0.75: 16, 1.0: 16}
ROUGHNESSES = tuple(SIZES)
LEAST = 8  # texels a side of the pyramid's top
FEW, MANY = 0.05, 0.03  # of a lobe, how much one texel may have at most before it is read in four: of sharp lobes, of wide ones
PIECES = 4  # a side, in which the lobe is integrated over a texel of the map; 2 over larger ones, of which it has little


@dataclass(frozen=True)
class Level:
    """A filtered map of n x n texels with a rim of one, whose upper left corner (of the rim) is at (x, y) of the image of all levels.
    roughness: None for diffuse light."""

    roughness: float | None
    n: int
    x: int
    y: int


@dataclass(frozen=True)
class Layout:
    """The image of all levels. levels: by roughness, ascending; diffuse: the last."""

    width: int
    height: int
    levels: tuple[Level, ...]
    diffuse: Level


@functools.lru_cache(maxsize=8)
def layout(n: int) -> Layout:
    """Where levels lie: the map itself on the left, all others beside it, as they fit, row by row."""
    sizes = [n, *(min(n, SIZES[r]) for r in ROUGHNESSES[1:]), min(n, 16)]
    placed, x, y, tall, width = [(0, 0)], n + 2, 0, 0, n + 2
    limit = n + 2 + max(sizes[1:]) + 2
    for size in sizes[1:]:
        if x + size + 2 > limit:
            x, y, tall = n + 2, y + tall, 0
        placed.append((x, y))
        x, tall = x + size + 2, max(tall, size + 2)
        width = max(width, x)
    height = max(y + size + 2 for size, (_, y) in zip(sizes, placed))
    levels = [Level(r, size, *at) for r, size, at in zip((*ROUGHNESSES, None), sizes, placed)]
    return Layout(width, height, tuple(levels[:-1]), levels[-1])


def pyramid_sizes(n: int) -> list[int]:
    """Texels a side of the pyramid's levels, the map first."""
    sizes = [n]
    while sizes[-1] > LEAST:
        sizes.append(sizes[-1] // 2)
    return sizes


@functools.lru_cache(maxsize=8)
def halving(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows, columns and weights of the average of 2 x 2 texels of n x n by solid angle."""
    angle, m = cells(n)[1][:, 0], n // 2
    row, column = np.divmod(np.arange(m * m), m)
    cols = np.stack([(2 * row + j) * n + 2 * column + i for j in (0, 1) for i in (0, 1)], 1)
    weights = angle[cols] / angle[cols].sum(1, keepdims=True)
    return np.stack([4 * np.arange(m * m), 4 * np.arange(1, m * m + 1)], 1), cols.ravel(), weights.ravel()


def lobe(roughness: float | None) -> Callable[[np.ndarray], np.ndarray]:
    """The weight of light by the cosine from the lobe's middle: n.l D(h) with normal and eye in the middle (Karis 2013), not scaled; of
    diffuse light n.l."""
    if roughness is None:
        return lambda c: np.maximum(c, 0.0)
    a2 = roughness ** 4

    def weight(c: np.ndarray) -> np.ndarray:
        side = (1.0 - c) / 2.0  # of the angle between normal and half vector the squared sine
        return np.maximum(c, 0.0) * (a2 / (side + (1.0 - side) * a2)) ** 2

    return weight


def lobe_rows(directions: np.ndarray, roughness: float | None, n: int, part: float | None = None
              ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Entries of the matrix from the pyramid to what lobes about directions (m, 3) see: rows, columns, weights, each row adding to 1.
    part: a texel that may have more than this of the whole lobe is read in four."""
    weight = lobe(roughness)
    cosine = np.cos(np.linspace(0, 1, 4097)[1:] ** 2 * np.pi / 2)
    whole = 2 * np.pi * np.abs(np.sum((weight(cosine[1:]) + weight(cosine[:-1])) / 2 * np.diff(cosine)))
    part = part or (FEW if roughness is not None and roughness < 0.35 else MANY)
    sizes = pyramid_sizes(n)
    first = np.cumsum([0, *(k * k for k in sizes)])
    row, cell = (a.ravel() for a in np.meshgrid(np.arange(len(directions)), np.arange(sizes[-1] ** 2), indexing="ij"))
    found = []
    for level in range(len(sizes) - 1, -1, -1):
        k = sizes[level]
        middle, angle = (a[:, 0] for a in cells(k))
        radius = 0.7 * np.sqrt(angle[cell])
        away = np.arccos(np.clip((middle[cell] * directions[row]).sum(1), -1, 1))
        most = weight(np.cos(np.maximum(away - radius, 0.0))) * angle[cell]
        keep = (most > 0) & ((most < part * whole) | (level == 0))
        parts, pieces = cells(k, PIECES if level == 0 else 2)
        value = (weight(np.einsum("epk,ek->ep", parts[cell[keep]], directions[row[keep]])) * pieces[cell[keep]]).sum(1)
        found.append((row[keep], first[level] + cell[keep], value))
        further = (most > 0) & ~keep
        row, cell = row[further], cell[further]
        y, x = np.divmod(cell, k)
        row = np.repeat(row, 4)
        cell = ((2 * y[:, None] + [0, 0, 1, 1]) * 2 * k + 2 * x[:, None] + [0, 1, 0, 1]).ravel()
    rows, cols, values = (np.concatenate(a) for a in zip(*found))
    keep = values > 1e-4 * whole
    rows, cols, values = rows[keep], cols[keep], values[keep]
    order = np.lexsort((cols, rows))
    rows, cols, values = rows[order], cols[order], values[order]
    return rows, cols, values / np.bincount(rows, values, len(directions))[rows]


@functools.lru_cache(maxsize=4)
def matrix(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compressed rows (height, width, 2) over the image of all levels, columns of the pyramid's table, weights. Texels of no level are
    empty rows, and a rim has what the texel that it shows has."""
    where = layout(n)
    span, cols, weights, first = np.zeros((where.height, where.width, 2), np.int64), [], [], 0
    for level in (*where.levels, where.diffuse):
        if level.roughness == 0.0:
            rows, columns, values = np.arange(n * n), np.arange(n * n), np.ones(n * n)
        else:
            rows, columns, values = lobe_rows(cells(level.n)[0][:, 0], level.roughness, n)
        ends = first + np.searchsorted(rows, np.arange(level.n ** 2 + 1))
        shown = rim(level.n)
        span[level.y:level.y + level.n + 2, level.x:level.x + level.n + 2] = np.stack([ends[shown], ends[shown + 1]], -1)
        cols.append(columns)
        weights.append(values)
        first += len(columns)
    lengths = (span[..., 1] - span[..., 0]).ravel()
    ends = np.cumsum(lengths)
    entry = np.repeat(span[..., 0].ravel() - (ends - lengths), lengths) + np.arange(lengths.sum())
    rows = np.stack([ends - lengths, ends], 1).reshape(where.height, where.width, 2)
    return rows, np.concatenate(cols)[entry], np.concatenate(weights)[entry]
