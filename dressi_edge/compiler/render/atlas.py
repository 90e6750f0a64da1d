"""Views side by side in one image."""
from __future__ import annotations

from dataclasses import dataclass

from ..graph.functions import apply, compose
from ..graph.ir import Extent, Node, image

COMMON_SIDE = 4096  # what every device allows (Vulkan 1.0, "Required Limits", maxFramebufferWidth)


@dataclass(frozen=True)
class Atlas:
    """`views` cells of width x height, `columns` in a row."""

    width: int
    height: int
    views: int
    columns: int

    @property
    def extent(self) -> Extent:
        return image(self.width * self.columns, self.height * -(-self.views // self.columns))

    @property
    def view(self) -> Node:
        """int: which view each pixel belongs to."""
        return apply("cell_index", extent=self.extent, cell_w=self.width, cell_h=self.height)

    @property
    def position(self) -> Node:
        """vec2: each pixel's centre from the middle of its view's cell, in pixels."""
        return apply("cell_position", extent=self.extent, cell_w=self.width, cell_h=self.height)

    def corner(self, view: Node) -> Node:
        """ivec2: the upper left texel of a view's cell."""
        return compose(apply("imod", view, self.columns) * self.width, apply("idiv", view, self.columns) * self.height)

    @staticmethod
    def of(width: int, height: int, views: int) -> Atlas:
        """The atlas nearest to a square with few empty cells among those within `COMMON_SIDE`, else the one whose longer side is least."""
        def shape(columns: int) -> tuple[int, int, int]:
            rows = -(-views // columns)
            return rows * columns - views, columns * width, rows * height

        def rank(columns: int) -> tuple[int, int, int]:
            empty, across, down = shape(columns)
            return max(across, down, COMMON_SIDE), empty, abs(across - down)

        return Atlas(width, height, views, min(range(1, views + 1), key=rank))
