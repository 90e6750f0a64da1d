"""Renderers: how what the cameras see becomes layers of fragments, and how layers compose."""
from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

from ....cache.errors import InputError
from ...graph.ir import Node
from ..atlas import Atlas
from ..topology import Topology
from .contours import ContourFragments
from .fragments import Fragments
from .layers import PeeledFragments
from .outline import OutlineFragments
from .softness import Softness


class Renderer(Protocol):
    """What a scene draws with. One of your own has this method, and may have `seen_by(views: ViewTable) -> Renderer`, which is called first
    and gives what then draws."""

    def draw(self, clip: Node, topology: Topology, atlas: Atlas, near: float, faces: bool) -> Fragments:
        """clip: coordinates of views x vertices (docs/conventions.md), of all parts together; near: the smallest w in front of the
        cameras; faces: whether it matters which face a pixel shows, and not only whether there is one."""


@dataclass(frozen=True)
class Outline:
    """One layer; alpha by the distance to the nearest fold or boundary edge beside which there is nothing. r: how far from it the
    picture is soft, sigma: the width of the fade; both in pixels, sigma r / 7 unless given.

    contours: colours are soft where one surface hides another, too, and so have the gradient of that (`contours.py`); what is hidden must
    be deeper by more than `gap` times the distance of the edge that hides it. Raises InputError."""

    r: float = 2.0
    sigma: float | None = None
    contours: bool = False
    gap: float = 0.02

    def __post_init__(self) -> None:
        self.softness  # noqa: B018  (checks the numbers)
        if not (math.isfinite(self.gap) and self.gap > 0):
            raise InputError(f"gap is {self.gap!r:.40}; a positive fraction of the distance is needed")

    @property
    def softness(self) -> Softness:
        return Softness(self.r, self.sigma, distance="outline")

    def draw(self, clip: Node, topology: Topology, atlas: Atlas, near: float, faces: bool) -> OutlineFragments:
        """See `Renderer.draw`."""
        if self.contours and faces:
            return ContourFragments(clip, topology, atlas, self.softness, near, self.gap)
        return OutlineFragments(clip, topology, atlas, self.softness, near, faces)


@dataclass(frozen=True)
class HardSoftRas:
    """The paper's (3.4): `layers` depth peels of faces enlarged by r, alpha by the distance to the edges of each. delta: half width of the
    edge mask, r unless given; all in pixels. edges: where the mask has its edges, "coverage" (the paper's), "depth" or "all"
    (`Softness`). Raises InputError."""

    r: float = 2.0
    layers: int = 1
    sigma: float | None = None
    delta: float | None = None
    edges: str = "coverage"

    def __post_init__(self) -> None:
        self.softness  # noqa: B018  (checks the numbers)

    @property
    def softness(self) -> Softness:
        return Softness(self.r, self.sigma, self.delta, self.layers, "face", self.edges)

    def draw(self, clip: Node, topology: Topology, atlas: Atlas, near: float, faces: bool) -> PeeledFragments:
        """See `Renderer.draw`."""
        return PeeledFragments(clip, topology, atlas, self.softness, near, faces)


def renderer_of(softness: Softness | Renderer) -> Renderer:
    """The renderer that these settings mean; one that is given is that."""
    if not isinstance(softness, Softness):
        return softness
    if softness.distance == "outline":
        return Outline(softness.r, softness.sigma)
    return HardSoftRas(softness.r, softness.layers, softness.sigma, softness.delta, softness.edges)


def rasterized(clip: Node, topology: Topology, atlas: Atlas, softness: Softness, near: float, faces: bool = True) -> Fragments:
    """A mesh drawn as `softness` says; see `Renderer.draw`. Without `faces` only silhouettes are asked for: layers have no `face`, and
    half of a closed surface is drawn (`graph/ops/raster.py`)."""
    return renderer_of(softness).draw(clip, topology, atlas, near, faces)
