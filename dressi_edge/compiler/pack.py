"""Functions to substages to stages (paper 3.3.3), under one device profile.

In: the roots of one plan, lowered and simplified. Out: `Stage`s in running order, each a list of `Substage`s: one shader over one extent.

A value must be stored where a reader is not at the same texel: another extent, a fetch, a sampler, the vertex stage. Those reads
cut the graph into levels; all pixelwise work of one extent and one level can be one shader. A node is placed as late as
its readers allow, at a level where a substage of its extent already exists if there is one. Values that are cheap to
recompute from what the reader fetches anyway are recomputed instead of stored. Then substages that break a limit are split.
`pack_naive` is the simple twin: one function a substage.
"""
from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from ..cache.errors import PackError
from ..cache.profile import Profile
from .ir import UNIT, Extent, Node, topological
from .ops import lookup as _lookup  # noqa: F401  (fills the op table)
from .optable import COUNT, FILTERED, OWN, VERTEX

RECOMPUTE_COST = 24  # work a value may cost to be computed again
SPLIT_COST = 50  # work without loops that each part of a split substage may do again
PASS_COST = 100_000  # work over all texels that is worth a pass of its own
FORMAT_BITS = {"float": 32, "vec2": 64, "vec3": 128, "vec4": 128, "int": 32, "ivec2": 64, "ivec3": 128, "ivec4": 128}


@dataclass(frozen=True)
class Substage:
    """One subpass: `nodes` in order, of which `outputs` are written; `reads` are (node, mode) from outside."""

    extent: Extent
    nodes: tuple[Node, ...]
    outputs: tuple[Node, ...]
    reads: tuple[tuple[Node, str], ...]

    @property
    def raster(self) -> bool:
        return self.nodes[0].op.stage == "raster"


@dataclass(frozen=True)
class Stage:
    """One render pass."""

    extent: Extent
    substages: tuple[Substage, ...]


def format_bits(node: Node) -> int:
    """Bits of a texel of its image."""
    return FORMAT_BITS[node.vtype] // (1 if node.half is None else 2)


def _inline(node: Node) -> bool:
    return node.op.stage == "inline"


def _leaf(node: Node) -> bool:
    return node.op.stage == "leaf"


def _crosses(x: Node, user: Node, mode: str) -> bool:
    """Whether this read needs x stored in an image."""
    return (mode != OWN or x.extent != user.extent or x.op.stage == "raster" or user.op.stage == "raster")


def _edges(node: Node):
    for k, x in enumerate(node.inputs):
        if not _inline(x):
            yield x, node.op.read(k)


def substage(nodes: Sequence[Node], outputs: Sequence[Node]) -> Substage:
    """The substage of these nodes; what it reads is derived."""
    inside, reads = set(nodes), {}
    for node in nodes:
        for x, mode in _edges(node):
            if x not in inside:
                reads[x, mode] = None
    return Substage(nodes[0].extent, tuple(nodes), tuple(outputs), tuple(reads))


def _levels(order: Sequence[Node], roots: set[Node]) -> dict[Node, int]:
    """The level of each node; see the module's text."""
    low: dict[Node, int] = {}
    for n in order:
        low[n] = 0 if _leaf(n) else max([1] + [low[x] + (0 if _leaf(x) else _crosses(x, n, m)) for x, m in _edges(n)])
    top = max(low.values(), default=0)
    high = dict.fromkeys(order, top)
    level: dict[Node, int] = {}
    groups: dict[Extent, set[int]] = {}
    read: set[Node] = set()
    for n in reversed(order):
        if _leaf(n):
            continue
        existing = [] if n.op.stage == "raster" else [g for g in groups.get(n.extent, ()) if low[n] <= g <= high[n]]
        level[n] = max(existing) if existing else (high[n] if n in read else low[n])
        if n.op.stage != "raster":
            groups.setdefault(n.extent, set()).add(level[n])
        for x, m in _edges(n):
            high[x] = min(high[x], level[n] - _crosses(x, n, m))
            read.add(x)
    _merge(order, level)
    return level


def _merge(order: Sequence[Node], level: dict[Node, int]) -> None:
    """Move whole groups down to an earlier group of their extent wherever their inputs are there in time."""
    groups: dict[tuple[Extent, int], list[Node]] = {}
    for n in order:
        if n in level and n.op.stage != "raster":
            groups.setdefault((n.extent, level[n]), []).append(n)
    for extent, top in sorted(groups, key=lambda key: key[1]):
        members = set(groups[extent, top])
        ready = max((level.get(x, 0) + (0 if _leaf(x) else _crosses(x, n, m)) for n in members for x, m in _edges(n) if x not in members),
                    default=1)
        inner = any(x in members and _crosses(x, n, m) for n in members for x, m in _edges(n))
        target = next((k for k in range(max(1, ready), top) if groups.get((extent, k))), None)
        if target is not None and not inner:
            for n in groups[extent, top]:
                level[n] = target
            groups[extent, target] += groups[extent, top]
            groups[extent, top] = []


def _groups(order: Sequence[Node], level: dict[Node, int]) -> list[list[Node]]:
    groups: dict[tuple, list[Node]] = {}
    for n in order:
        if not _leaf(n):
            key = (level[n], 0 if n.op.stage == "raster" else 1, n.extent.width, n.extent.height, n.extent.count, n.extent.partial,
                   n.serial if n.op.stage == "raster" else 0)
            groups.setdefault(key, []).append(n)
    return [groups[key] for key in sorted(groups, key=lambda key: key[:5])]


def _cone(xs: Sequence[Node], stored: set[Node], reads: set[Node], budget: int) -> list[Node] | None:
    """Nodes to recompute so that none of xs need be stored, or None if storing them is better: too much work, or more new reads than
    the values themselves would be."""
    cone, fetched, cost, stack, seen = [], set(), 0, list(xs), set(xs)
    while stack:
        n = stack.pop()
        cost += n.op.cost
        cone.append(n)
        if cost > budget or n in stored or n.op.loop is not None or n.op.stage != "pixel":
            return None
        for y, mode in _edges(n):
            if y in stored or mode != OWN:
                fetched.add(y)
            elif y not in seen:
                seen.add(y)
                stack.append(y)
    new = {y for y in fetched if y not in reads and y.extent != UNIT}
    return None if len(new) > len(xs) else cone


def _ordered(nodes: Iterable[Node]) -> list[Node]:
    """These nodes, inputs first."""
    members = set(nodes)
    return topological(sorted(members, key=lambda n: n.serial), members)


def pack_substages(roots: Sequence[Node], profile: Profile) -> list[Substage]:
    """Substages in running order. Raises PackError where one function alone breaks a limit."""
    root_set = {r for r in roots if not _leaf(r)}
    order = [n for n in topological(roots) if not _inline(n)]
    level = _levels(order, root_set)
    groups = _groups(order, level)
    stored = {n for n in order if _leaf(n) or n in root_set or n.op.stage == "raster"}
    for n in order:
        stored.update(x for x, m in _edges(n) if _crosses(x, n, m))
    members: list[list[Node]] = []
    for group in groups:
        inside = set(group)
        reads = {x for n in group for x, m in _edges(n) if x not in inside and x in stored}
        wanted = list(dict.fromkeys(x for n in group for x, m in _edges(n) if x not in inside and x not in stored))
        extra = _cone(wanted, stored, reads, RECOMPUTE_COST * len(wanted))
        if extra is None:
            extra = []
            for x in wanted:
                cone = None if x in stored else _cone([x], stored, reads, RECOMPUTE_COST)
                if cone is None:
                    stored.add(x)
                    reads.add(x)
                else:
                    extra += cone
        members.append(_ordered([*group, *extra]) if extra else group)
    read_elsewhere = set(root_set)
    for nodes in members:
        inside = set(nodes)
        read_elsewhere.update(x for n in nodes for x, m in _edges(n) if x not in inside or _crosses(x, n, m))
    result = []
    for group, nodes in zip(groups, members):
        own = set(group)
        outputs = [n for n in nodes if n in own and n in read_elsewhere]
        if outputs:
            result += _split(_needed(nodes, outputs), outputs, profile)
    return result


def _needed(nodes, outputs) -> list[Node]:
    """Those nodes that the outputs depend on."""
    inside, keep, stack = set(nodes), set(outputs), list(outputs)
    while stack:
        for x, _ in _edges(stack.pop()):
            if x in inside and x not in keep:
                keep.add(x)
                stack.append(x)
    return [n for n in nodes if n in keep]


def pack_naive(roots: Sequence[Node], profile: Profile) -> list[Substage]:
    """The simple twin: every function is a substage of its own."""
    return [substage([n], [n]) for n in topological(roots) if not _leaf(n) and not _inline(n)]


def excess(s: Substage, profile: Profile) -> list[str]:
    """What breaks a limit, one line each."""
    return _excess(profile, s.extent, s.outputs, len({x for x, m in s.reads if m != COUNT}), len({x for x, m in s.reads if m == VERTEX}),
                   sum(m == FILTERED for _, m in s.reads))


def _excess(profile: Profile, extent: Extent, outputs: Sequence[Node], images: int, vertex: int, filtered: int) -> list[str]:
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


def _split(nodes: list[Node], outputs: list[Node], profile: Profile) -> list[Substage]:
    """One substage, or several that each keep the limits: outputs in order, each with what it needs; later parts read the outputs of
    earlier ones. What several would compute and costs more than a pass is stored before them."""
    whole = substage(nodes, outputs)
    if not excess(whole, profile):
        return [whole]
    before: list[Node] = []
    while True:
        parts = _parts(nodes, list(dict.fromkeys([*before, *outputs])), profile)
        computed = Counter(n for part in parts for n in part.nodes
                           if (n.op.loop or n.op.cost > SPLIT_COST) and n.op.cost * n.extent.count > PASS_COST)
        again = {n for n, times in computed.items() if times > 1}
        if not again:
            return parts
        inner = {x for n in again for x, _ in _edges(n)} - {x for n in nodes if n not in again for x, _ in _edges(n)}
        before += sorted(again - inner, key=nodes.index)


def _parts(nodes: list[Node], outputs: Iterable[Node], profile: Profile) -> list[Substage]:
    """Substages that give these in order. A single one that is too wide is cut inside at the widest node that fits."""
    result: list[Substage] = []
    cones, pending = _Cones(nodes, profile), list(outputs)
    while pending:
        taken: list[Node] = []
        while pending and cones.fit([*taken, pending[0]]):
            taken.append(pending.pop(0))
        if taken:
            result.append(substage(cones.nodes(taken), taken))
            cones.store(taken)
        else:
            pending.insert(0, cones.cut(pending[0]))
    return result


class _Cones:
    """What each node of a group reads from outside if it is computed with all it needs, down to what is stored.

    The reads are four sets, as bits: (node, mode), nodes, nodes read in the vertex shader, through a filter; None where they alone
    break a limit, as they then do for every node above. So storing a node changes little, and 10,000 functions take seconds.
    """

    def __init__(self, nodes: Sequence[Node], profile: Profile):
        self.profile, self.order, self.at = profile, nodes, {n: k for k, n in enumerate(nodes)}
        self.inputs = {n: [x for x in dict.fromkeys(x for x, _ in _edges(n)) if x in self.at] for n in nodes}
        self.users: dict[Node, list[Node]] = {n: [] for n in nodes}
        for n in nodes:
            for x in self.inputs[n]:
                self.users[x].append(n)
        self.reads: dict[Node, tuple[int, ...] | None] = {}
        self.numbers: dict[object, int] = {}  # of the bits: of pairs and of nodes
        self.stored: set[Node] = set()
        self.stale = list(range(len(nodes)))  # a heap of the nodes whose reads may have changed
        self.output: Node | None = None  # that is being cut
        self.live: dict[Node, int] = {}  # node of its cone -> users there
        self.widest: list[tuple[int, int]] = []  # a heap of (-reads, number) of those that fit; old entries stay in it

    def _bits(self, x: Node, mode: str) -> tuple[int, ...]:
        pair, image = (1 << self.numbers.setdefault(key, len(self.numbers)) for key in ((x, mode), x))
        return pair, image, image * (mode == VERTEX), image * (mode == FILTERED)

    def _join(self, sets: Iterable[tuple[int, ...]], outputs: Sequence[Node]) -> tuple[int, ...] | None:
        """The union, or None where it breaks a limit."""
        union = (0, 0, 0, 0)
        for bits in sets:
            union = tuple([a | b for a, b in zip(union, bits)])
        return None if _excess(self.profile, outputs[0].extent, outputs, *(x.bit_count() for x in union[1:])) else union

    def _find(self, n: Node) -> tuple[int, ...] | None:
        sets = []
        for x, mode in _edges(n):
            sets.append(self.reads[x] if x in self.at and x not in self.stored else self._bits(x, mode))
            if sets[-1] is None:
                return None
        return self._join(sets, [n])

    def _refresh(self, last: Node) -> None:
        """Bring the reads of all nodes up to this one up to date."""
        while self.stale and self.stale[0] <= self.at[last]:
            k = heapq.heappop(self.stale)
            n = self.order[k]
            if n in self.stored or self.stale and self.stale[0] == k:
                continue
            found = self._find(n)
            if found != self.reads.get(n, ()):
                self.reads[n] = found
                self._changed(n)
                if found is not None and n in self.live:
                    heapq.heappush(self.widest, (-found[0].bit_count(), k))

    def _changed(self, n: Node) -> None:
        for user in self.users[n]:
            heapq.heappush(self.stale, self.at[user])

    def fit(self, outputs: Sequence[Node]) -> bool:
        """Whether a substage may give these."""
        self._refresh(outputs[-1])
        sets = [self.reads[n] for n in outputs]
        return None not in sets and self._join(sets, outputs) is not None

    def nodes(self, outputs: Sequence[Node]) -> list[Node]:
        """What a substage that gives these computes, in order."""
        keep, stack = set(outputs), list(outputs)
        while stack:
            for x in self.inputs[stack.pop()]:
                if x not in keep and x not in self.stored:
                    keep.add(x)
                    stack.append(x)
        return sorted(keep, key=self.at.__getitem__)

    def store(self, outputs: Sequence[Node]) -> None:
        """From now on these are read."""
        self.stored.update(outputs)
        for n in outputs:
            self._changed(n)
        gone = [n for n in outputs if self.live.pop(n, None) is not None]
        while gone:
            for x in self.inputs[gone.pop()]:
                if x in self.live:
                    self.live[x] -= 1
                    if not self.live[x]:
                        del self.live[x]
                        gone.append(x)

    def cut(self, output: Node) -> Node:
        """The node inside `output`'s cone to store first: the widest one that keeps the limits."""
        if self.output is not output:
            cone = self.nodes([output])
            self.output, self.live = output, dict.fromkeys(cone, 0)
            for n in cone:
                for x in self.inputs[n]:
                    if x in self.live:
                        self.live[x] += 1
            self.widest = [(-reads[0].bit_count(), self.at[n]) for n in cone if (reads := self.reads[n]) is not None]
            heapq.heapify(self.widest)
        while self.widest:
            width, k = self.widest[0]
            n = self.order[k]
            reads = self.reads.get(n)
            if width and n in self.live and n is not output and reads is not None and reads[0].bit_count() == -width:
                return n
            heapq.heappop(self.widest)
        part = substage(self.nodes([output]), [output])
        names = " ".join(x.name for x, _ in part.reads)
        raise PackError(f"function {output.name} ({output.op.name}) {excess(part, self.profile)[0]}: {names}")


def merged_reads(stage: Sequence[Substage], s: Substage) -> set[Node]:
    """What s reads of the outputs of a stage's substages."""
    written = {n for part in stage for n in part.outputs}
    return {x for x, _ in s.reads if x in written}


def _joins(stage: Sequence[Substage], s: Substage, profile: Profile) -> bool:
    """Whether s may be one more subpass of the stage: the same size, reads of its outputs at the same texel only, and within the
    profile's input attachments and the merge rules of tile-based GPUs (docs/packing.md)."""
    first = stage[0]
    if (first.extent.width, first.extent.height) != (s.extent.width, s.extent.height) or s.raster or any(part.raster for part in stage):
        return False
    inner = merged_reads(stage, s)
    if not inner or any(x in inner and m != OWN for x, m in s.reads):
        return False
    if len(inner) > profile.limit("maxPerStageDescriptorInputAttachments"):
        return False
    attachments = [n for part in (*stage, s) for n in part.outputs]
    if profile.max_merged_attachments is not None and len(attachments) > profile.max_merged_attachments:
        return False
    return profile.tile_bits is None or sum(map(format_bits, attachments)) <= profile.tile_bits


def pack_stages(substages: Sequence[Substage], profile: Profile) -> list[Stage]:
    """Substages to render passes: each joins the pass before it where it may."""
    stages: list[list[Substage]] = []
    for s in substages:
        if stages and _joins(stages[-1], s, profile):
            stages[-1].append(s)
        else:
            stages.append([s])
    return [Stage(group[0].extent, tuple(group)) for group in stages]


def pack(roots: Sequence[Node], profile: Profile, naive: bool = False, stage_packing: bool = True) -> list[Stage]:
    """Stages in running order for one plan. The simple twins: `naive`, one function a pass; no stage packing, one substage a pass."""
    substages = pack_naive(roots, profile) if naive else pack_substages(roots, profile)
    if naive or not stage_packing:
        return [Stage(s.extent, (s,)) for s in substages]
    return pack_stages(substages, profile)
