"""Views side by side in one image."""
from __future__ import annotations

from dataclasses import dataclass

from ..graph.ir import Extent, image

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
