"""How tables lie on a device that pads the rows of images: several rows of the graph's in one of the image's.

In: packed plans and a profile with a `table_width`. Out: `wide_rows`: of each node whose image is wider than its extent says, what the
image measures. Entry y w + x of the graph's w x h is entry y w + x of the image, too, so that shaders compute the same from the same
numbers, and what the graph says of places stands. `emit.py` alone turns places of the one into places of the other.

Left as they are: what a session sees (inputs, states, outputs, whose size the bundle format says), what is filtered, drawn in cells or
tiles, or counted by a draw; and, since all that a pass writes has one size, whatever is written beside those.
"""
from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ...cache.profile import Profile
from ..graph.ir import Extent, Node
from ..graph.optable import COUNT, FILTERED
from ..passes.plans import PackedPlan
from ..passes.substage import TILES

LEAST_ROWS = 4  # of the wider image; smaller ones would only be padded otherwise


@dataclass(frozen=True)
class Rows:
    """An extent of 2^`narrow` columns in rows of 2^`wide`."""

    narrow: int
    wide: int
    last: int

    @classmethod
    def of(cls, extent: Extent, image: Extent) -> Rows:
        return cls(extent.width.bit_length() - 1, image.width.bit_length() - 1, extent.width * extent.height - 1)

    @property
    def name(self) -> str:
        """The GLSL function from a place in the graph's image to that in ours."""
        return f"rows{self.narrow}_{self.wide}_"

    @property
    def function(self) -> str:
        more = self.wide - self.narrow
        return f"ivec2 {self.name}(ivec2 c) {{ return ivec2((c.y & {(1 << more) - 1}) << {self.narrow} | c.x, c.y >> {more}); }}"

    def pixel(self) -> str:
        """The first statements of a fragment shader: which entry it computes, where that is in the image (`texel`) and in the graph's
        (`pixel`). What lies after the last is computed as the last, so that nothing is read beyond an image's end."""
        return (f"int entry = min(int(gl_FragCoord.y) << {self.wide} | int(gl_FragCoord.x), {self.last}); "
                f"ivec2 texel = {self.place('entry')}, pixel = ivec2(entry & {(1 << self.narrow) - 1}, entry >> {self.narrow});")

    def place(self, i: str) -> str:
        """Where in the image an entry is."""
        return f"ivec2({i} & {(1 << self.wide) - 1}, {i} >> {self.wide})"


def wide_rows(plans: Sequence[PackedPlan], profile: Profile) -> Mapping[Node, Extent]:
    """The nodes whose images have rows of `profile.table_width` texels, and the size of these."""
    width = profile.table_width
    if width is None:
        return {}
    fixed: set[Node] = set()  # lie as their extent says
    written: list[tuple[Node, ...]] = []  # what has one size: all that a pass writes, a root and its target
    nodes: dict[Node, None] = {}
    for plan in plans:
        for root, target in zip(plan.graph.roots, plan.graph.targets):
            written.append((root, target) if isinstance(target, Node) else (root,))
            fixed.update({root} if isinstance(target, str) else ())
        for stage in plan.stages:
            outputs = tuple(n for s in stage.substages for n in s.outputs)
            written.append(outputs)
            for s in stage.substages:
                fixed.update(s.outputs if s.raster or s.domain.kind == TILES else ())
                fixed.update(x for x, mode in s.reads if mode in (FILTERED, COUNT))
                nodes |= dict.fromkeys((*s.images, *s.outputs))
    nodes |= dict.fromkeys(n for group in written for n in group)
    fixed.update(n for n in nodes if n.op.held or not _narrow(n.extent, width))
    while more := {n for group in written if not fixed.isdisjoint(group) for n in group} - fixed:
        fixed |= more
    return {n: _size(n.extent, width) for n in nodes if n not in fixed}


def _narrow(e: Extent, width: int) -> bool:
    return e.width < width and e.width & (e.width - 1) == 0 and e.width * e.height >= LEAST_ROWS * width


def _size(e: Extent, width: int) -> Extent:
    entries = e.width * e.height
    return Extent(width, -(-entries // width), entries)
