"""Faces as they are, without any softness: one layer, whose alpha is 0 or 1. No gradient by where outlines are."""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ...graph.functions import select, to_float
from ...graph.ir import Node
from ..atlas import Atlas
from ..topology import Topology
from .fragments import Fragments, Layer
from .softness import Softness


class HardFragments(Fragments):
    """What is in front of each pixel's centre."""

    def __init__(self, clip: Node, topology: Topology, atlas: Atlas, near: float, faces: bool):
        super().__init__(clip, topology, atlas, Softness(1.0, delta=0.0), near, faces)
        hard = self.front >= 0
        self.layers = [Layer(self.front if faces else None, hard, to_float(hard), to_float(hard), self.position)]

    def silhouette(self) -> Node:
        return self.layers[0].probability

    def color(self, shaded: Sequence[Node], background: Node | float) -> Node:
        """The face in front, or the background."""
        return select(self.layers[0].hard, shaded[0], background)


@dataclass(frozen=True)
class Hard:
    """A renderer (`Renderer`) that blurs nothing: depth maps, pictures of ids."""

    def draw(self, clip: Node, topology: Topology, atlas: Atlas, near: float, faces: bool) -> HardFragments:
        """See `Renderer.draw`."""
        return HardFragments(clip, topology, atlas, near, faces)
