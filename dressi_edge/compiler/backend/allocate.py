"""Which image holds which value when: lifetimes, reuse, and what must wait for what.

In: a program and its packed plans, in running order. Out: an `Allocation`: the images, where each value and each node lies, and for
each stage what it is attached to and whether it waits. Names of images are their numbers, in order of first use. An image is free once
the last stage that reads it has run; the next value of its format and size takes it, in any plan. Nothing is added to the plans.
"""
from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

from ...cache import vulkan as v
from ..graph.formats import FORMATS, format_number
from ..graph.ir import Extent, Node
from ..graph.program import Program
from ..passes.plans import PHASE, PackedPlan
from ..passes.substage import Stage, Substage, merged_reads


@dataclass(frozen=True)
class Image:
    """As docs/bundle-format.md has it; `data`: the constant that it holds."""

    format: int
    width: int
    height: int
    slots: int = 1
    usage: int = 0
    data: Node | None = None


@dataclass(frozen=True)
class PlacedStage:
    """attachments: refs (2 image + slot), the outputs of each substage in order, of a dispatch those it writes; depth: the ref of a depth
    image or -1; wait: whether a stage before it must have ended; size: width and height of what it writes."""

    attachments: tuple[int, ...]
    depth: int
    wait: bool
    size: tuple[int, int]


@dataclass(frozen=True)
class PlacedPlan:
    """refs: of all that the plan reads from images and writes."""

    refs: Mapping[Node, int]
    stages: tuple[PlacedStage, ...]


@dataclass(frozen=True)
class Allocation:
    """images: by number. plans: as given. values: by name the image of each input, state, output and copy."""

    images: tuple[Image, ...]
    plans: tuple[PlacedPlan, ...]
    values: Mapping[str, int]


def allocate(program: Program, plans: Sequence[PackedPlan], wide: Mapping[Node, Extent] = MappingProxyType({})) -> Allocation:
    """Images for everything that these plans read and write. wide: as `rows.wide_rows` has it."""
    images = _Images(program, plans, wide)
    placed = tuple(_place(plan, images) for plan in plans)
    values = {name: images.outputs[name] if program.roles[name] == "output" else images.leaf(value.node)
              for name, value in program.values.items()}
    values |= {node.attrs["name"]: images.leaf(node) for node in images.copies}
    return Allocation(tuple(images.made), placed, values)


def kept_lists(plans: Sequence[PackedPlan], places: Allocation) -> Iterator[tuple[int, int, int]]:
    """Of images that plans fill for others and that hold lists, each with the image whose last texel says how many entries there are, and
    how wide the columns are in which they lie."""
    totals = {extent: leaf for plan in plans for extent, leaf in plan.graph.totals.items()}
    at = {target: where.refs[root] // 2 for plan, where in zip(plans, places.plans)
          for root, target in zip(plan.graph.roots, plan.graph.targets) if isinstance(target, Node) and not target.op.held}
    for leaf, image in at.items():
        if leaf.extent in totals:
            width = places.images[image].width
            yield image, at[totals[leaf.extent]], leaf.extent.column if width == leaf.extent.width else width


def is_copy(program: Program, leaf: Node) -> bool:
    """Whether a leaf that a session holds is none of the program's own: it stands for a state while a phase works on a list."""
    return leaf.op.held and leaf.attrs["name"] not in program.values


class _Images:
    """The images made so far, and which of them are free."""

    def __init__(self, program: Program, plans: Sequence[PackedPlan], wide: Mapping[Node, Extent]):
        self.program, self.wide = program, wide
        self.updated = {name for plan in plans if plan.graph.kind == PHASE for name in plan.graph.updates}
        self.copies = dict.fromkeys(x for plan in plans for x in plan.graph.targets if isinstance(x, Node) and is_copy(program, x))
        self.made: list[Image] = []
        self.leaves: dict[Node, int] = {}
        self.outputs: dict[str, int] = {}
        self.free: dict[tuple[int, int, int], list[int]] = {}

    def new(self, *what) -> int:
        self.made.append(Image(*what))
        return len(self.made) - 1

    def use(self, image: int, usage: int) -> None:
        self.made[image] = replace(self.made[image], usage=self.made[image].usage | usage)

    def leaf(self, node: Node) -> int:
        """The image of a leaf."""
        if node not in self.leaves:
            constant, held = "data" in node.attrs, node.op.held
            usage = v.USAGE_TRANSFER_DST if constant else 0
            if held and not is_copy(self.program, node):
                usage = v.USAGE_TRANSFER_DST | v.USAGE_TRANSFER_SRC
            slots = 2 if held and node.attrs["name"] in self.updated else 1
            self.leaves[node] = self.new(*self.kind(node), slots, usage, node if constant else None)
        return self.leaves[node]

    def output(self, name: str) -> int:
        if name not in self.outputs:
            layout = self.program.values[name].layout
            self.outputs[name] = self.new(v.FORMATS[FORMATS[layout.vtype]], *layout.size, 1, v.USAGE_TRANSFER_SRC)
        return self.outputs[name]

    def take(self, n: Node) -> int:
        """A free image for a value, or a new one."""
        free = self.free.get(self.kind(n))
        return free.pop() if free else self.new(*self.kind(n))

    def give(self, n: Node, image: int) -> None:
        if image not in self.free.setdefault(self.kind(n), []):
            self.free[self.kind(n)].append(image)

    def depth(self, stage: Stage) -> int:
        """The depth image of this size; no stage leaves anything in it."""
        kind = (0, stage.extent.width, stage.extent.height)
        if kind not in self.free:
            self.free[kind] = [self.new(*kind, 1, v.USAGE_DEPTH)]
        return self.free[kind][0]

    def kind(self, n: Node) -> tuple[int, int, int]:
        return format_number(n), *self.size(n)

    def size(self, n: Node) -> tuple[int, int]:
        e = self.wide.get(n, n.extent)
        return e.width, e.height


def _place(plan: PackedPlan, images: _Images) -> PlacedPlan:
    """The places of one plan, after those of the plans before it."""
    graph, roots = plan.graph, set(plan.graph.roots)
    refs = {root: 2 * (images.output(x) if isinstance(x, str) else images.leaf(x)) + graph.slot(x)
            for root, x in zip(graph.roots, graph.targets)}
    last_read = {x: k for k, stage in enumerate(plan.stages) for s in stage.substages for x in _reads(s)}
    placed, hazards = [], _Hazards()
    for k, stage in enumerate(plan.stages):
        for n in (n for s in stage.substages for n in s.outputs):
            if n not in refs:
                refs[n] = 2 * images.take(n)
        placed.append(_stage(stage, refs, images, hazards))
        for s in stage.substages:
            for n in (*_reads(s), *s.outputs):
                if n not in roots and n.op.stage != "leaf" and last_read.get(n, k) == k:
                    images.give(n, refs[n] // 2)
    return PlacedPlan(refs, tuple(placed))


def _reads(s: Substage) -> tuple[Node, ...]:
    return tuple(dict.fromkeys((*(x for x, _ in s.reads), *s.images, *s.counts)))


def _stage(stage: Stage, refs: dict[Node, int], images: _Images, hazards: _Hazards) -> PlacedStage:
    attachments: dict[int, None] = {}
    read: set[int] = set()
    depth = -1
    for k, s in enumerate(stage.substages):
        for n in s.outputs:
            images.use(refs[n] // 2, v.USAGE_STORAGE if s.compute else v.USAGE_COLOR)
            attachments[refs[n]] = None
        inner = merged_reads(stage.substages[:k], s)
        for nodes, usage in ((s.images, v.USAGE_SAMPLED), (s.counts, v.USAGE_TRANSFER_SRC)):
            for x in nodes:
                if x not in refs:
                    refs[x] = 2 * images.leaf(x)
                images.use(refs[x] // 2, v.USAGE_INPUT if x in inner else usage)
                if x not in inner:
                    read.add(refs[x])
        if s.raster and any(draw.depth_test for draw in s.nodes[0].op.draws):
            depth = 2 * images.depth(stage)
    wait = hazards.stage(read, {*attachments, depth} - {-1})
    return PlacedStage(tuple(attachments), depth, wait, images.size(stage.substages[0].outputs[0]))


class _Hazards:
    """Which stages must wait for those before: a read or write of something written, or a write of something read."""

    def __init__(self):
        self.written: set[int] = set()
        self.read: set[int] = set()
        self.first = True

    def stage(self, reads: set[int], writes: set[int]) -> bool:
        wait = self.first or bool(self.written & (reads | writes) or self.read & writes)
        if wait:
            self.written, self.read, self.first = set(), set(), False
        self.written |= writes
        self.read |= reads
        return wait
