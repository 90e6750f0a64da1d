"""The lists of faces by tile, of the steps in `bins.py`: boxes in, lists out."""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..ir import UNIT, Node
from ..optable import apply, as_node
from .bins import RUN, SIDE, WORD, Grid
from .lookup import constant_table
from .scan import exclusive_scan


@dataclass(frozen=True)
class Binned:
    """Lists by tile: `faces` (over views), `tiles` (of each entry), `ranges` (of each tile its first place in it and the one after its
    last). `pairs`: how many entries the tiles have together, `spilled`: 1 where the list had no room for them and tiles have the faces of
    their bins or views; both of extent 1x1. drawn: of how many
    places there is something; bins: places of the list of bins."""

    faces: Node
    tiles: Node
    ranges: Node
    pairs: Node
    spilled: Node
    drawn: Node
    bins: int


def _total(counts: Node, starts: Node, entries: Node) -> Node:
    """The sum of the first so many counts, of which starts are the running sums."""
    last = entries - 1
    return apply("select", last >= 0, apply("lookup", starts, last) + apply("lookup", counts, last), 0)


DEEP = 64  # entries of a tile for which there is room beside those of small faces


def capacities(grid: Grid, pairs: int | None, reach: float) -> tuple[int, int]:
    """Places in the lists of bins and of tiles: no more than there could be entries. Small faces, enlarged by `reach`, meet so many tiles
    as a square of that size does, and twice that is what there is room for; large ones are few."""
    def room(count: int, size: tuple[int, int], least: int) -> int:
        small = 2.0 * (1 + 2 * reach / size[0]) * (1 + 2 * reach / size[1])
        return min(grid.faces * count, max(int(small * grid.views * grid.faces) + DEEP * count, least))

    bins, tiles = (grid.views * a * b for a, b in (grid.bins, grid.tiles))
    first = room(bins, grid.bin, 1 << 13)
    second = room(tiles, grid.tile, 1 << 16) if pairs is None else min(grid.faces * tiles, pairs)
    return first, max(first, second)


def bin_faces(boxes: Node, grid: Grid, pairs: int | None = None, reach: float = 0.0) -> Binned:
    """Lists by tile of what has these boxes, an ivec4 table of views x faces. pairs: places in the list, no more than there could be;
    unless given, by `capacities`: enough for faces that are small, but for being enlarged by `reach` pixels, and for 64 others a tile."""
    first, second = capacities(grid, pairs, reach)
    bins = {key: grid.attrs[key] for key in ("views", "bins_x", "bins_y")}
    sides, words = apply("bin_sides", boxes, **grid.attrs), {"words": grid.words}
    runs = apply("bin_runs", apply("bin_counts", sides, **bins, **words), **bins, **words)
    starts, count = exclusive_scan(runs), runs.extent.count
    total = _total(runs, starts, as_node(count))
    spilled = total > first
    marks = apply("list_marks", starts, spilled, total, constant_table(np.array([count])), slots=first)
    drawn = apply("select", spilled, grid.views * grid.faces, total)
    faces = apply("bin_list", sides, starts, spilled, total, marks, drawn, slots=first, face_count=grid.faces, partial=sides.serial, **bins,
                  **words)
    ranges = apply("bin_ranges", starts, spilled, total, runs=grid.runs, face_count=grid.faces, **bins)
    sizes = apply("shift_left", apply("shift_right", ranges.y - ranges.x + (WORD * RUN - 1), 8), 6)
    bases, room = exclusive_scan(sizes), SIDE * SIDE * (-(-first // (WORD * RUN)) + sizes.extent.count)
    needed = _total(sizes, bases, as_node(sizes.extent.count))
    here = apply("min", needed, room)
    sides = apply("tile_sides", apply("lookup", boxes, faces), ranges, bases, apply("shift_right", here, 1), slots=room // 2,
                  partial=bases.serial, **grid.attrs)
    runs = apply("tile_runs", sides, ranges, bases, here, slots=room, partial=sizes.serial, **bins)
    starts = exclusive_scan(runs)
    total = _total(runs, starts, here)
    spilled = apply("bit_or", needed > room, total > second)
    drawn = apply("select", spilled, drawn, total)
    tiles = {"tiles_x": grid.tiles[0], "tiles_y": grid.tiles[1], **bins}
    marks = apply("list_marks", starts, spilled, total, here, slots=second)
    of_marks = apply("mark_bins", marks, bases, bins=sizes.extent.count)
    listed = apply("tile_list", sides, starts, spilled, total, marks, of_marks, faces, ranges, bases, drawn, slots=second,
                   partial=boxes.serial, **tiles)
    where = apply("tile_ranges", starts, spilled, total, ranges, bases, needed, **tiles)
    assert spilled.extent == UNIT
    return Binned(listed.x, listed.y, where, as_node(total), spilled, drawn, first)
