"""Several pictures and colours as one texture that draws the same: `Surface`s in, an atlas with texture coordinates out.

A picture's tile holds the texels that its faces reach, repeated or mirrored as they ask, and one more on each side, so bilinear samples
are the same bits but for the rounding of coordinates. A coloured face has 2 x 2 texels of its own, between whose centres a bilinear
sample is linear.
"""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...cache.errors import InputError
from .images import MAX_PIXELS, linear_to_srgb, srgb_to_linear
from .materials import TextureMap
from .mesh import unique_rows
from .pieces import Corners

MAX_SIDE = 16384  # of an atlas


@dataclass(frozen=True, eq=False)
class Surface:
    """`count` faces with a picture at `uvs` (those of the picture, v down), times a linear `factor`; or with `colors` of corners, sRGB
    encoded (None: white)."""

    uvs: Corners | None
    map: TextureMap | None
    factor: tuple[float, float, float]
    colors: Corners | None
    count: int


def baked(surfaces: Sequence[Surface]) -> dict:
    """`texture`, `wrap`, `uvs` and `uv_faces` of a `Mesh`: the one picture with its own coordinates where there is one, else an atlas.
    Raises InputError where an atlas would be too large."""
    looks: dict[tuple, list[int]] = {}
    for k, surface in enumerate(surfaces):
        if surface.map is not None:
            looks.setdefault((id(surface.map.picture), surface.factor, surface.map.wrap), []).append(k)
    corners = [None if s.uvs is None else s.uvs[0][s.uvs[1]] for s in surfaces]
    if len(looks) == 1 and all(s.map is not None for s in surfaces):
        wraps = set(_wraps(surfaces[0].map, np.concatenate(corners))) - {"any"}
        if len(wraps) <= 1 and "mirror" not in wraps:
            return {"texture": _texels(surfaces[0]), "wrap": wraps.pop() if wraps else "repeat", **_compact(np.concatenate(corners))}
    tiles, moves = [], []
    for which in looks.values():
        uv, first = np.concatenate([corners[k] for k in which]), surfaces[which[0]]
        tile, moved = _picture_tile(_texels(first), uv, _wraps(first.map, uv))
        tiles.append(tile)
        moves.append((which, moved))
    colored = [k for k, s in enumerate(surfaces) if s.map is None]
    if colored:
        tile, moved = _color_tile(np.concatenate([_colors(surfaces[k]) for k in colored]))
        tiles.append(tile)
        moves.append((colored, moved))
    atlas, places = _packed(tiles)
    size = np.array(atlas.shape[1::-1])
    for (which, moved), place in zip(moves, places):
        pieces = np.split((moved + place) / size, np.cumsum([surfaces[k].count for k in which])[:-1])
        for k, piece in zip(which, pieces):
            corners[k] = piece
    return {"texture": atlas, "wrap": "clamp", **_compact(np.concatenate(corners))}


def _compact(corners: np.ndarray) -> dict:
    first, inverse = unique_rows(corners.reshape(-1, 2))
    return {"uvs": corners.reshape(-1, 2)[first], "uv_faces": inverse.reshape(-1, 3)}


def _texels(surface: Surface) -> np.ndarray:
    """The picture times its factor, which is linear (glTF 2.0 section 3.9.2)."""
    texels = surface.map.picture.texels()[..., :3]
    return texels if surface.factor == (1.0, 1.0, 1.0) else np.clip(linear_to_srgb(srgb_to_linear(texels) * surface.factor), 0.0, 1.0)


def _wraps(found: TextureMap, uvs: np.ndarray) -> tuple[str, str]:
    """How the picture goes on by u and by v for faces (F, 3, 2): "any" where none comes near its edge, "mirror" only where some go
    beyond."""
    out = []
    for axis, size in enumerate(found.picture.texels().shape[1::-1]):
        low, high, wrap = uvs[..., axis].min(), uvs[..., axis].max(), found.wrap[axis]
        inside = low >= 0.5 / size and high <= 1.0 - 0.5 / size
        out.append("any" if inside else "clamp" if wrap == "mirror" and low >= 0.0 and high <= 1.0 else wrap)
    return out[0], out[1]


def _picture_tile(texels: np.ndarray, uv: np.ndarray, wrap: tuple[str, str]) -> tuple[np.ndarray, np.ndarray]:
    """The texels that faces (F, 3, 2) reach, and the corners in texels of this tile."""
    size = np.array(texels.shape[1::-1])
    moved, rows = np.empty_like(uv), []
    for axis in (0, 1):
        period = {"repeat": 1.0, "mirror": 2.0}.get(wrap[axis])
        low = 0.0 if period is None else period * np.floor(uv[..., axis].min(axis=1, keepdims=True) / period)
        x = (uv[..., axis] - low) * size[axis]
        first, last = np.floor(x.min() - 0.5), np.floor(x.max() - 0.5) + 1.0
        if last - first >= MAX_SIDE:
            raise InputError(f"several materials need one atlas, and a picture of {size[0]}x{size[1]} texels is repeated over "
                             f"{last - first:.0f} of them; at most {MAX_SIDE} are allowed; load the parts one by one, or bake them")
        index = np.arange(int(first), int(last) + 1)
        n = size[axis]
        index = np.clip(index, 0, n - 1) if wrap[axis] in ("clamp", "any") else index % n if wrap[axis] == "repeat" else \
            np.minimum(index % (2 * n), 2 * n - 1 - index % (2 * n))
        moved[..., axis] = x - first
        rows.append(index)
    if len(rows[0]) * len(rows[1]) > MAX_PIXELS:
        raise _too_large(len(rows[0]), len(rows[1]))
    return texels[rows[1]][:, rows[0]], moved


def _colors(surface: Surface) -> np.ndarray:
    """sRGB colours (count, 3, 3) of the corners."""
    return np.ones((surface.count, 3, 3)) if surface.colors is None else surface.colors[0][surface.colors[1]]


def _color_tile(colors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A grid of 2 x 2 texels for each different face of (F, 3, 3), and the corners at their centres."""
    first, index = unique_rows(colors.reshape(-1, 9))
    faces = colors[first]
    columns = int(np.ceil(np.sqrt(len(faces))))
    rows = -(-len(faces) // columns)
    cells = np.zeros((rows * columns, 2, 2, 3))
    cells[:len(faces), 0, 0], cells[:len(faces), 0, 1], cells[:len(faces), 1, 0] = faces[:, 0], faces[:, 1], faces[:, 2]
    cells[:len(faces), 1, 1] = np.clip(faces[:, 1] + faces[:, 2] - faces[:, 0], 0.0, 1.0)
    if rows * columns * 4 > MAX_PIXELS:
        raise _too_large(2 * columns, 2 * rows)
    tile = cells.reshape(rows, columns, 2, 2, 3).transpose(0, 2, 1, 3, 4).reshape(2 * rows, 2 * columns, 3)
    corner = np.stack([index % columns, index // columns], axis=-1)[:, None] * 2.0
    return tile, corner + np.array([(0.5, 0.5), (1.5, 0.5), (0.5, 1.5)])


def _packed(tiles: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """The tiles on shelves of one image, and where (x, y) each is."""
    area = sum(tile.shape[0] * tile.shape[1] for tile in tiles)
    width = max(max(tile.shape[1] for tile in tiles), int(np.ceil(np.sqrt(area))))
    places, x, y, height = np.zeros((len(tiles), 2), np.int64), 0, 0, 0
    for k in sorted(range(len(tiles)), key=lambda k: -tiles[k].shape[0]):
        h, w = tiles[k].shape[:2]
        if x + w > width:
            x, y, height = 0, y + height, 0
        places[k] = x, y
        x, height = x + w, max(height, h)
    if max(width, y + height) > MAX_SIDE or width * (y + height) > MAX_PIXELS:
        raise _too_large(width, y + height)
    atlas = np.zeros((y + height, width, 3))
    for tile, (x, y) in zip(tiles, places):
        atlas[y:y + tile.shape[0], x:x + tile.shape[1]] = tile
    return atlas, places


def _too_large(width: int, height: int) -> InputError:
    return InputError(f"several materials need an atlas of {width}x{height} texels; at most {MAX_SIDE} a side and "
                      f"{MAX_PIXELS / 1e6:.1f} million are allowed; load the parts one by one, or scale their pictures down")
