"""What emitting a substage gives: its draws or its dispatch, shader by shader, and the images that they bind."""
from __future__ import annotations

from dataclasses import dataclass

from ..graph.ir import Node

SAMPLED, SAMPLER, ATTACHMENT = "sampled", "sampler", "attachment"


@dataclass(frozen=True)
class Binding:
    """One descriptor: the node's image, how it is bound, in which shader stages; for samplers the wrap."""

    node: Node
    kind: str
    vertex: bool
    fragment: bool
    wrap: str = ""


@dataclass(frozen=True)
class DrawCode:
    """One draw of a substage. `vertices` invocations; `views` instances over the atlas cells (`cell` = width, height, columns).
    `count`: the node whose last texel says how many of the vertices there are to draw. `grid`: it relies on the grid to which devices
    round corners, which is the profile's subPixelPrecisionBits."""

    vertex: str
    fragment: str
    vertices: int
    views: int = 1
    cell: tuple[int, int, int] | None = None
    depth: bool = False
    topology: str = "triangles"
    count: Node | None = None
    grid: bool = False


@dataclass(frozen=True)
class DispatchCode:
    """A dispatch: its shader, which binds the outputs after all others, and how many workgroups there are. clear: what the outputs are
    before."""

    shader: str
    groups: tuple[int, int, int]
    clear: int | None = None


@dataclass(frozen=True)
class Code:
    """The draws or the dispatch of a substage and the images they bind, in binding order."""

    draws: tuple[DrawCode, ...]
    bindings: tuple[Binding, ...]
    dispatch: DispatchCode | None = None

    @property
    def shaders(self) -> tuple[tuple[str, str], ...]:
        """("vert", "frag" or "comp", text) of each."""
        if self.dispatch:
            return (("comp", self.dispatch.shader),)
        return tuple(shader for d in self.draws for shader in (("vert", d.vertex), ("frag", d.fragment)))
