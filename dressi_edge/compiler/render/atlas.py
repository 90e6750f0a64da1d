"""Views side by side in one image."""
from __future__ import annotations

from dataclasses import dataclass

from ..graph.ir import Extent, image


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
        """The atlas nearest to a square with few empty cells."""
        best = min(range(1, views + 1), key=lambda c: (-(-views // c) * c - views, abs(c * width - -(-views // c) * height)))
        return Atlas(width, height, views, best)
