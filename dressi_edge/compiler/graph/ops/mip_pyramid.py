"""The levels of a mip-mapped texture: their sizes, their numbers, where they lie.

    level 0: the texture;  level 1: its half, an image;  levels 2 to the last: the rest, one image, level under level (`Pyramid.rest`)

Level l has ceil(width / 2^l) x ceil(height / 2^l) texels; the last has one. Texel k of it is the mean of texels k 2^l to (k + 1) 2^l - 1 of
the texture, of as many of them as there are. Its centre is at (k + 1/2) 2^l / width, whatever the size. All levels are numbered one
after the other, row by row (`Pyramid.starts`).
"""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ....cache.errors import GraphError
from ..ir import Extent, Node, image

LEAST = 4  # texels of the longer side of a texture that has levels


@dataclass(frozen=True)
class Pyramid:
    """The levels of a texture of width x height texels, at least LEAST on one side. Raises GraphError."""

    width: int
    height: int

    def __post_init__(self) -> None:
        if max(self.width, self.height) < LEAST:
            raise GraphError(f"mip levels of {self.width}x{self.height} texels; at least {LEAST} on one side are needed")

    @property
    def last(self) -> int:
        """The number of the last level, of one texel."""
        return (max(self.width, self.height) - 1).bit_length()

    def size(self, level: int) -> tuple[int, int]:
        """Width and height of a level."""
        return -(-self.width // (1 << level)), -(-self.height // (1 << level))

    @property
    def starts(self) -> list[int]:
        """The number of each level's first texel, and how many texels there are in all."""
        counts = [w * h for w, h in map(self.size, range(self.last + 1))]
        return [0, *np.cumsum(counts).tolist()]

    def row(self, level: int) -> int:
        """The row in the rest's image that a level from 2 on begins in. Levels there have as many rows as those of a texture whose height
        is the next power of two, which gives a short formula."""
        height = 1 << (self.height - 1).bit_length()
        return (height >> 1) - max(1, height >> level - 1) + max(0, level - height.bit_length())

    @property
    def row_glsl(self) -> str:
        """`row` of level m_, an int."""
        height = 1 << (self.height - 1).bit_length()
        return f"{height >> 1} - max(1, {height} >> max(m_ - 1, 0)) + max(0, m_ - {height.bit_length()})"

    @property
    def rest(self) -> Extent:
        """Of the image that holds the levels from 2 on."""
        return image(self.size(2)[0], self.row(self.last) + self.size(self.last)[1])

    def part(self, rest: np.ndarray, level: int) -> np.ndarray:
        """The texels (h, w, c) of a level from 2 on in the rest's image."""
        w, h = self.size(level)
        return rest[self.row(level):self.row(level) + h, :w]

    def texels(self, flat: np.ndarray, level: int, first: int = 0) -> np.ndarray:
        """The texels (h, w, c) of a level, of a list (n, c) that begins with level `first`."""
        w, h = self.size(level)
        start = self.starts[level] - self.starts[first]
        return flat[start:start + w * h].reshape(h, w, -1)

    def counts(self, level: int) -> np.ndarray:
        """(h, w, 1): how many of the texture's texels each texel of a level stands for."""
        by = 1 << level
        ys, xs = (np.minimum(by, n - by * np.arange(m)) for n, m in zip((self.height, self.width), self.size(level)[::-1]))
        return (ys[:, None] * xs)[..., None]

    def find(self, index: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Level, column and row of numbers; beyond the last level rows go on."""
        level = np.clip(np.searchsorted(self.starts, index, "right") - 1, 0, self.last)
        local = index - np.array(self.starts)[level]
        width = np.array([self.size(k)[0] for k in range(self.last + 1)])[level]
        return level, local % width, local // width

    @property
    def even(self) -> bool:
        """Whether each texel of a level stands for as many as the others."""
        return not any(n & n - 1 for n in (self.width, self.height)) and self.width == self.height

    @property
    def glsl(self) -> str:
        """The number of each level's first texel, o_, and what finds of number q_ its level m_, that level's size z_, and its place a_."""
        return f"const int o_[{self.last + 2}] = int[]({', '.join(map(str, self.starts))});"


FIND = """int m_ = 0;
    while (m_ < {last} && q_ >= o_[m_ + 1]) ++m_;
    ivec2 z_ = (ivec2({width}, {height}) + (1 << m_) - 1) >> m_, a_ = ivec2((q_ - o_[m_]) % z_.x, (q_ - o_[m_]) / z_.x);"""


def found(node: Node) -> str:
    """GLSL that finds number q_ among the levels of a node's texture."""
    p = Pyramid(node.attrs["width"], node.attrs["height"])
    return p.glsl + " " + FIND.replace("{last}", str(p.last))


def blocks(texels: np.ndarray, steps: int) -> np.ndarray:
    """Sums of steps x steps texels, at the far ends of those that are there."""
    h, w, c = texels.shape
    padded = np.pad(texels, ((0, -h % steps), (0, -w % steps), (0, 0)))
    return padded.reshape(padded.shape[0] // steps, steps, -1, steps, c).sum((1, 3))


def mean(p: Pyramid, x: np.ndarray, above: int, level: int) -> np.ndarray:
    """A level, from a finer one."""
    return blocks(x * p.counts(above), 1 << level - above) / p.counts(level)
