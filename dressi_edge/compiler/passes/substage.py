"""One shader over one extent, and one render pass of them; which limits of a profile they break."""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ...cache.profile import Profile
from ..graph.formats import format_bits
from ..graph.ir import Extent, Node
from ..graph.optable import COUNT, FILTERED, VERTEX

FULL, TEXELS, TILES, LISTED = "full", "texels", "tiles", "listed"
KEPT = "kept"  # what an image held before


@dataclass(frozen=True)
class Domain:
    """Which texels of a substage are drawn, and what its outputs are in the others.

    kind: "full", all that its draws cover; "texels", those where `by`, an int, is not 0: the others are discarded; "tiles", tiles of so
    many texels (`tile`) for which `by`, which has one texel for each, is not 0; "listed", the first so many entries as the last texel
    of `by` says. cone: what computes `by` in this substage. outside: for each output the number in every channel where nothing is
    drawn, "kept" for what it held before, or None where nothing reads it."""

    kind: str = FULL
    by: Node | None = None
    tile: tuple[int, int] | None = None
    cone: tuple[Node, ...] = ()
    outside: tuple[int | str | None, ...] = ()


@dataclass(frozen=True)
class Substage:
    """One subpass: `nodes` in order, of which `outputs` are written; `reads` are (node, mode) from outside. domain: as
    `passes/domains.py` found it. compute: it is dispatched, not drawn (`passes/compute.py`). count: what says how many workgroups of
    a dispatch there are, where the device finds that."""

    extent: Extent
    nodes: tuple[Node, ...]
    outputs: tuple[Node, ...]
    reads: tuple[tuple[Node, str], ...]
    domain: Domain = Domain()
    compute: bool = False
    count: Node | None = None

    @property
    def raster(self) -> bool:
        """Whether it draws geometry."""
        return self.nodes[0].op.stage == "raster"

    @property
    def kernel(self) -> bool:
        """Whether it is a shader of workgroups that share memory."""
        return self.nodes[0].op.stage == "kernel"

    @property
    def images(self) -> tuple[Node, ...]:
        """What its shaders read of what lies in images."""
        found = dict.fromkeys(x for x, mode in self.reads if mode != COUNT)
        if self.domain.kind in (TILES, LISTED):
            found[self.domain.by] = None
        return tuple(found)

    @property
    def counts(self) -> tuple[Node, ...]:
        """What says how many vertices its draws have, or how many workgroups its dispatch."""
        return tuple(x for x, mode in self.reads if mode == COUNT) if self.raster else () if self.count is None else (self.count,)


@dataclass(frozen=True)
class Stage:
    """One render pass, or one dispatch."""

    extent: Extent
    substages: tuple[Substage, ...]

    @property
    def compute(self) -> bool:
        """Whether it is a dispatch."""
        return self.substages[0].compute


def is_inline(node: Node) -> bool:
    """Whether its value is written into the text of its readers."""
    return node.op.stage == "inline"


def is_alone(node: Node) -> bool:
    """Whether it is a substage by itself: geometry, or a kernel."""
    return node.op.stage in ("raster", "kernel")


def is_leaf(node: Node) -> bool:
    """Whether it is there before anything runs."""
    return node.op.stage == "leaf"


def edges(node: Node) -> list[tuple[Node, str]]:
    """Its inputs that are images, each with how it is read."""
    return [(x, mode) for x, mode in zip(node.inputs, node.op.reads) if x.op.stage != "inline"]


def substage(nodes: Sequence[Node], outputs: Sequence[Node]) -> Substage:
    """The substage of these nodes; what it reads is derived."""
    inside, reads = set(nodes), {}
    for node in nodes:
        for x, mode in edges(node):
            if x not in inside:
                reads[x, mode] = None
    return Substage(nodes[0].extent, tuple(nodes), tuple(outputs), tuple(reads))


def merged_reads(stage: Sequence[Substage], s: Substage) -> set[Node]:
    """What s reads of the outputs of a stage's substages."""
    written = {n for part in stage for n in part.outputs}
    return {x for x, _ in s.reads if x in written}


def excess(s: Substage, profile: Profile) -> list[str]:
    """What breaks a limit, one line each."""
    return excess_of(profile, s.extent, s.outputs, len({x for x, m in s.reads if m != COUNT}), len({x for x, m in s.reads if m == VERTEX}),
                   sum(m == FILTERED for _, m in s.reads))


def excess_of(profile: Profile, extent: Extent, outputs: Sequence[Node], images: int, vertex: int, filtered: int) -> list[str]:
    """Of a substage that reads so many images, so many of them in its vertex shader, and so many through a filter."""
    counts = {
        "maxColorAttachments": len(outputs), "maxFragmentOutputAttachments": len(outputs),
        "maxFragmentCombinedOutputResources": len(outputs),
        "maxPerStageDescriptorSampledImages": max(vertex, images - vertex),
        "maxDescriptorSetSampledImages": images,
        "maxPerStageResources": max(vertex, images - vertex + len(outputs)),
        "maxPerStageDescriptorSamplers": filtered,
        "maxFramebufferWidth": extent.width, "maxFramebufferHeight": extent.height,
        "maxImageDimension2D": max(extent.width, extent.height),
    }
    lines = [f"needs {found} {name}; profile {profile.name} allows {profile.limit(name):g}"
             for name, found in counts.items() if found > profile.limit(name)]
    bits = sum(map(format_bits, outputs))
    if profile.tile_bits and bits > profile.tile_bits and len(outputs) > 1:
        lines.append(f"needs {bits} tile colour bits a pixel; profile {profile.name} allows {profile.tile_bits}")
    return lines
