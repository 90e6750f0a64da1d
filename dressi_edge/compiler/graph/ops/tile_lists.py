"""The lists of faces by tile, of the steps in `bins.py`: boxes in, lists out."""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..ir import UNIT, Node
from ..optable import apply, as_node
from .bins import SIDE, WORD, Grid
from .lookup import constant_table
from .scan import exclusive_scan


@dataclass(frozen=True)
class Binned:
    """Lists by tile: `faces` (over views), `ranges` (of each tile its first place in it and the one after its last). `pairs`: how many
    entries the tiles have together, `spilled`: 1 where the list had no room for them and tiles have the faces of their bins or views;
    both of extent 1x1."""

    faces: Node
    ranges: Node
    pairs: Node
    spilled: Node


def _total(words: Node, starts: Node) -> Node:
    last = constant_table(np.array([words.extent.count - 1]))
    return apply("lookup", starts, last) + apply("bit_count", apply("lookup", words, last))


def capacities(grid: Grid, pairs: int | None) -> tuple[int, int]:
    """Places in the lists of bins and of tiles: no more than there could be entries."""
    bins, tiles = (grid.views * a * b for a, b in (grid.bins, grid.tiles))
    first = min(grid.faces * bins, max(2 * grid.views * grid.faces, 1 << 13))
    second = max(16 * grid.views * grid.faces, 1 << 16) if pairs is None else pairs
    return first, max(first, min(grid.faces * tiles, second))


def bin_faces(boxes: Node, grid: Grid, pairs: int | None = None) -> Binned:
    """Lists by tile of what has these boxes, an ivec4 table of views x faces. pairs: places in the list, 16 a face of each view, at least
    65536, unless given, and no more than there could be."""
    first, second = capacities(grid, pairs)
    some = {key: grid.attrs[key] for key in ("views", "face_count", "bins_x", "bins_y")}
    words = apply("bin_words", boxes, **grid.attrs)
    starts = exclusive_scan(apply("bit_count", words))
    total = _total(words, starts)
    spilled = total > first
    faces = apply("bin_list", words, starts, spilled, total, slots=first, per_bin=grid.words, **some)
    ranges = apply("bin_ranges", starts, spilled, total, words=grid.words, **some)
    sizes = apply("shift_left", apply("shift_right", ranges.y - ranges.x + (WORD - 1), 5), 6)
    bases, room = exclusive_scan(sizes), 2 * first + SIDE * SIDE * sizes.extent.count
    last = constant_table(np.array([sizes.extent.count - 1]))
    needed = apply("lookup", bases, last) + apply("lookup", sizes, last)
    words = apply("tile_words", apply("lookup", boxes, faces), ranges, bases, slots=room, **grid.attrs)
    starts = exclusive_scan(apply("bit_count", words))
    total = _total(words, starts)
    spilled = apply("bit_or", needed > room, total > second)
    drawn = apply("select", spilled, first, total)
    listed = apply("tile_list", words, starts, spilled, total, faces, ranges, bases, drawn, slots=second, bins=sizes.extent.count,
                   partial=boxes.serial)
    where = apply("tile_ranges", starts, spilled, total, ranges, bases, tiles_x=grid.tiles[0], tiles_y=grid.tiles[1],
                  **{key: some[key] for key in ("views", "bins_x", "bins_y")})
    assert spilled.extent == UNIT
    return Binned(listed, where, as_node(total), spilled)
