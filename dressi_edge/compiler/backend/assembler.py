"""Stages to a bundle: images and their reuse, render passes, pipelines, descriptors, waits.

In: a `Program` and a profile. Out: the bundle's description, a plain dict as docs/bundle-format.md has it, and its blobs.
"""
from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...cache import vulkan as v
from ...cache.bundle_check import MAX_NEEDS
from ...cache.layout import Layout
from ...cache.profile import Profile
from ..graph.formats import FORMATS, format_number
from ..graph.ir import CHANNELS, Extent, Node, is_int, topological
from ..graph.optable import COUNT, VERTEX, apply
from ..graph.program import PlanSpec, Program
from ..passes.domains import Guard, find_guard
from ..passes.lists import MIN_TEXELS, Lists, find_lists
from ..passes.pack import merged_reads, pack
from ..passes.simplify import lower, simplify
from ..passes.specialize import prepare, specialize
from ..passes.substage import Stage
from . import emit, spirv

MAX_ROWS = 16384  # of a list, whatever the profile allows: most devices have them


def texels(array: np.ndarray, vtype: str, half: bool = False) -> bytes:
    """(height, width, channels) as the bytes of its image format."""
    array = np.asarray(array, np.int32 if is_int(vtype) else np.float16 if half else np.float32)
    if CHANNELS[vtype] == 3:
        array = np.concatenate([array, np.zeros_like(array[..., :1])], 2)
    return array.astype(array.dtype.newbyteorder("<")).tobytes()


class _Table(dict):
    """Numbers things by equality, in order of first use."""

    def number(self, key) -> int:
        return self.setdefault(key, len(self))


class Assembler:
    """Collects images, blobs, shaders, passes and pipelines over all plans of a program."""

    def __init__(self, program: Program, profile: Profile, naive: bool = False, cache: bool = True,
                 stage_packing: bool = True, sparse_texels: int | None = MIN_TEXELS):
        self.program, self.profile, self.naive, self.cache, self.stage_packing = program, profile, naive, cache, stage_packing
        self.sparse_texels = sparse_texels if cache and not naive else None
        self.blobs: list[bytes] = []
        self._blob_at: dict[bytes, int] = {}
        self.images: list[dict] = []
        self.shaders, self.passes, self.pipelines, self.samplers = _Table(), _Table(), _Table(), _Table()
        self.leaves: dict[Node, int] = {}
        self.free: dict[tuple, list[int]] = {}
        self.states: dict[str, int] = {}
        self.plans: list[dict] = []
        self.prepared: dict[Node, int] = {}  # cached leaf -> the plan that fills it
        self.stage_lists: list[tuple[str, list[Stage]]] = []
        self.copies: dict[str, tuple[Node, Layout]] = {}  # what stands for states while a phase works on lists
        self.texels: dict[str, dict[str, str]] = {}  # phase -> sampled image -> how its texels are updated

    def blob(self, data: bytes) -> int:
        key = hashlib.sha256(data).digest()
        if key not in self._blob_at:
            self._blob_at[key] = len(self.blobs)
            self.blobs.append(data)
        return self._blob_at[key]

    def new_image(self, fmt: int, width: int, height: int, slots: int = 1, data: int | None = None) -> int:
        self.images.append({"format": fmt, "width": width, "height": height, "slots": slots, "usage": 0, "data": data})
        return len(self.images) - 1

    def leaf(self, node: Node) -> int:
        """The image of a leaf."""
        if node not in self.leaves:
            data = None
            if node.op.name == "constant":
                data = self.blob(texels(node.attrs["data"].array, node.vtype))
            role = node.op.name
            slots = 2 if role == "state" and node.attrs["name"] in self.updated else 1
            self.leaves[node] = self.new_image(format_number(node), node.extent.width, node.extent.height, slots, data)
            if role in ("input", "state") and node.attrs["name"] not in self.copies:
                self.images[self.leaves[node]]["usage"] |= v.USAGE_TRANSFER_DST | v.USAGE_TRANSFER_SRC
            if role == "constant":
                self.images[self.leaves[node]]["usage"] |= v.USAGE_TRANSFER_DST
        return self.leaves[node]

    def assemble(self) -> dict:
        self.outputs: dict[str, int] = {}
        groups: dict[tuple, list[PlanSpec]] = {}
        for spec in self.program.plans:
            groups.setdefault((spec.group, spec.dynamic), []).append(spec)
        found = [self._lists(specs) for specs in groups.values()]
        self.updated = {name for specs, _, _ in found for spec in specs for name in spec.updates}
        for specs, rooted, lists in found:
            self._group(specs, rooted, lists)
        values = []
        for name, value in self.program.values.items():
            role = self.program.roles[name]
            image = self.outputs[name] if role == "output" else self.leaf(value.node)
            layout: Layout = value.layout
            half = value.node.half is not None
            initial = None if value.initial is None else self.blob(
                texels(layout.to_image(value.initial, name, half), layout.vtype, half))
            values.append({"name": name, "role": role, "image": image, "type": layout.vtype, "layout": layout.kind,
                           "width": layout.width, "height": layout.height, "count": layout.count, "columns": layout.columns,
                           "initial": initial})
        values += [{"name": name, "role": "copy", "image": self.leaf(node), "type": layout.vtype, "layout": layout.kind,
                    "width": layout.width, "height": layout.height, "count": layout.count, "columns": layout.columns,
                    "initial": None} for name, (node, layout) in self.copies.items()]
        names = [value["name"] for value in values]
        for plan in self.plans:
            for key in ("updates", "reads", "outputs"):
                plan[key] = [names.index(name) for name in plan[key]]
        code = spirv.compile_all(self.shaders)
        return {"meta": self.program.meta, "images": self.images, "samplers": list(self.samplers),
                "shaders": [self.blob(code[job]) for job in self.shaders],
                "passes": [_unfreeze(p) for p in self.passes], "pipelines": [_unfreeze(p) for p in self.pipelines],
                "values": values, "plans": self.plans}

    def _lists(self, specs: list[PlanSpec]) -> tuple[list[PlanSpec], list[list[Node]], list[Lists]]:
        """The plans of a group, their roots, and the lists on which they work."""
        rooted, lists = [simplify(lower([*spec.updates.values(), *spec.outputs.values()])) for spec in specs], []
        if self.sparse_texels is not None:
            lists, rooted, told = find_lists(self.program, specs, rooted, self.sparse_texels, self._rows())
            self.texels |= {spec.name: told for spec in specs if spec.updates and told}
        names = {name: copy.attrs["name"] for x in lists for name, copy in x.copies.items()}
        self.copies |= {copy.attrs["name"]: (copy, x.layout(copy)) for x in lists for copy in x.copies.values()}
        specs = [replace(spec, dynamic=spec.dynamic.union(names.values()),
                         updates={names.get(name, name): node for name, node in spec.updates.items()}) for spec in specs]
        return specs, rooted, lists

    def _rows(self) -> int:
        """The most rows of an image that is drawn to."""
        limit = self.profile.limit
        return min(limit("maxImageDimension2D"), limit("maxFramebufferHeight"), limit("maxViewportDimensions")[1], MAX_ROWS)

    def _group(self, specs: list[PlanSpec], rooted: list[list[Node]], lists: list[Lists]) -> None:
        """The plans of a group, after those that compute what they share and nothing of theirs changes."""
        if self.cache:
            cached: dict[Node, Node] = {}
            rooted = [specialize(roots, spec.dynamic, spec.group, cached) for spec, roots in zip(specs, rooted)]
            entered = [specialize(list(x.enter.values()), frozenset(x.copies), specs[0].group, cached) for x in lists]
            beforehand = prepare(specs[0].group, cached, MAX_NEEDS - len(lists))
            for k, (roots, leaves) in enumerate(beforehand, 1):
                name = f"{specs[0].group}.prepare" + (f".{k}" if k < len(beforehand) else "")
                self._run(name, roots, [(self.leaf(x), 0) for x in leaves], [], [], 0, self._needs(roots))
                self.prepared.update(dict.fromkeys(leaves, len(self.plans) - 1))
            for x, roots in zip(lists, entered):
                self._list(specs[0].group, x, roots)
        totals = {x.extent: x.total for x in lists}
        for spec, roots in zip(specs, rooted):
            self._plan(spec, roots, self._needs(roots), totals)

    def _list(self, group: str, x: Lists, entered: list[Node]) -> None:
        """The plan that fills a list and the copies of its states, and the one that puts them back, in place."""
        copies = [copy.attrs["name"] for copy in x.copies.values()]
        number = x.number if x.number > 1 else ""
        needs = self._needs(entered)
        self._run(f"{group}.enter{number}", entered, [(self.leaf(leaf), int(leaf.op.name == "state")) for leaf in x.enter], copies, [],
                  0, needs)
        needs = [*needs, len(self.plans) - 1]
        self.prepared.update({leaf: needs[-1] for leaf in x.enter})
        self._run(f"{group}.leave{number}", list(x.leave.values()), [(self.leaf(self.program.values[name].node), 0) for name in x.leave],
                  list(x.leave), [], 0, needs, in_place=True)

    def _needs(self, roots: list[Node]) -> list[int]:
        """The plans that fill the cached leaves under these roots, and those that these need in turn."""
        direct = {self.prepared[n] for n in topological(roots) if n in self.prepared}
        return sorted(direct.union(*(self.plans[k]["needs"] for k in direct)))

    def _plan(self, spec: PlanSpec, roots: list[Node], needs: list[int], totals: dict[Extent, Node]) -> None:
        names = [*spec.updates, *spec.outputs]
        targets, distinct, seen = [], [], set()
        for name, root in zip(names, roots):
            home = self.copies[name][0] if name in self.copies else self.program.values[name].node
            if root.op.stage in ("leaf", "inline") or root.half is not None or root in seen:
                root = apply("copy", root if root.extent == home.extent else apply("broadcast", root, extent=home.extent))
            while root in seen:
                root = apply("copy", root)
            seen.add(root)
            distinct.append(root)
            if name in spec.updates:
                targets.append((self.leaf(home), 1))
            else:
                if name not in self.outputs:
                    layout = self.program.values[name].layout
                    self.outputs[name] = self.new_image(v.FORMATS[FORMATS[layout.vtype]], *layout.size)
                    self.images[self.outputs[name]]["usage"] |= v.USAGE_TRANSFER_SRC
                targets.append((self.outputs[name], 0))
        self._run(spec.name, distinct, targets, list(spec.updates), list(spec.outputs), spec.steps, needs, totals)

    def _run(self, name, roots, targets, updates, outputs, steps, needs=(), totals=None, in_place=False) -> None:
        """A plan. totals: of extents of lists that were made before, what says how many entries there are. in_place: what a guard leaves
        out keeps what the targets held."""
        stages = pack(roots, self.profile, self.naive, self.stage_packing)
        totals = {**(totals or {}), **_totals(stages)}
        self.stage_lists.append((name, stages))
        place = dict(zip(roots, targets))
        last_read: dict[Node, int] = {}
        reads: dict[str, None] = {}
        for k, stage in enumerate(stages):
            if stage.extent in totals:
                last_read[totals[stage.extent]] = k
            for s in stage.substages:
                for x, _ in s.reads:
                    last_read[x] = k
                    if x.op.name in ("input", "state"):
                        reads[x.attrs["name"]] = None
        records, hazards, unread = [], _Hazards(), _Unread(roots, stages)
        for k, stage in enumerate(stages):
            for s in stage.substages:
                for n in s.outputs:
                    if n not in place:
                        place[n] = (self._take(n), 0)
            total = totals.get(stage.extent)
            records.append(self._stage(stage, place, hazards, unread, total, in_place))
            for s in stage.substages:
                for n in [*dict(s.reads), *s.outputs, *([total] if total else [])]:
                    if n in place and n not in roots and n.op.stage != "leaf" and last_read.get(n, k) == k:
                        key = (format_number(n), n.extent.width, n.extent.height)
                        if place[n][0] not in self.free.setdefault(key, []):
                            self.free[key].append(place[n][0])
        self.plans.append({"name": name, "stages": records, "updates": updates, "reads": list(reads), "outputs": outputs,
                           "needs": list(needs), "steps": steps})

    def _take(self, n: Node) -> int:
        key = (format_number(n), n.extent.width, n.extent.height)
        return self.free[key].pop() if self.free.get(key) else self.new_image(*key)

    def _ref(self, node: Node, place: dict) -> int:
        image, slot = place[node] if node in place else (self.leaf(node), 0)
        return 2 * image + slot

    def _stage(self, stage: Stage, place: dict, hazards: _Hazards, unread: _Unread, total: Node | None, in_place: bool) -> dict:
        attachments: dict[int, dict] = {}
        subpasses, layouts, read_refs = [], [], set()
        depth = -1
        for number_in_pass, s in enumerate(stage.substages):
            colors = []
            inner = merged_reads(stage.substages[:number_in_pass], s)
            guard = None if total else find_guard(s, 0) if in_place else find_guard(s)
            clears = guard.constants if guard else [s.nodes[0].op.clear if s.raster else unread.after_the_last(n, total) for n in s.outputs]
            for n, clear in zip(s.outputs, clears):
                ref = self._ref(n, place)
                self.images[ref // 2]["usage"] |= v.USAGE_COLOR
                dont_care = clear is None or guard and unread.outside(n, guard, s.outputs)
                load = v.LOAD_LOAD if in_place else v.LOAD_DONT_CARE if dont_care else v.LOAD_CLEAR
                attachments[ref] = {"format": format_number(n), "load": load,
                                    "store": v.STORE_STORE, "clear": 0 if dont_care else clear}
                colors.append(list(attachments).index(ref))
            draws, bindings = emit.emit(s, self.profile, guard, inner, total)
            refs = [self._ref(b.node, place) for b in bindings]
            inputs = []
            for b, ref in zip(bindings, refs):
                if b.kind == emit.ATTACHMENT:
                    self.images[ref // 2]["usage"] |= v.USAGE_INPUT
                    inputs.append(list(attachments).index(ref))
                else:
                    self.images[ref // 2]["usage"] |= v.USAGE_SAMPLED
                    read_refs.add(ref)
            for d in draws:
                if d.count is not None:
                    read_refs.add(self._ref(d.count, place))
                    self.images[self._ref(d.count, place) // 2]["usage"] |= v.USAGE_TRANSFER_SRC
            if any(d.depth for d in draws):
                image = self._depth(stage)
                attachments[2 * image] = {"format": 0, "load": v.LOAD_CLEAR, "store": v.STORE_DONT_CARE, "clear": 1}
                depth = list(attachments).index(2 * image)
            layouts.append({"colors": tuple(colors), "inputs": tuple(inputs), "depth": depth})
            subpasses.append((s, draws, bindings, refs))
        key = _freeze({"attachments": tuple(_freeze(a) for a in attachments.values()), "subpasses": tuple(map(_freeze, layouts))})
        number = self.passes.number(key)
        wait = hazards.stage(read_refs, set(attachments))
        return {"pass": number, "width": stage.extent.width, "height": stage.extent.height, "attachments": list(attachments),
                "wait": wait, "subpasses": [[self._draw(d, bindings, refs, place, number, k, stage) for d in draws]
                                            for k, (s, draws, bindings, refs) in enumerate(subpasses)]}

    def _depth(self, stage: Stage) -> int:
        key = (0, stage.extent.width, stage.extent.height)
        if not self.free.get(key):
            image = self.new_image(*key)
            self.images[image]["usage"] = v.USAGE_DEPTH
            self.free[key] = [image]
        return self.free[key][0]

    def _draw(self, draw: emit.DrawCode, bindings: Sequence[emit.Binding], refs, place, number, subpass, stage: Stage) -> dict:
        kinds = []
        for b in bindings:
            if b.kind == emit.ATTACHMENT:
                kind, sampler = v.DESCRIPTOR_INPUT_ATTACHMENT, -1
            elif b.kind == emit.SAMPLER:
                kind = v.DESCRIPTOR_COMBINED_IMAGE_SAMPLER
                sampler = self.samplers.number(v.ADDRESS_REPEAT if b.wrap == "repeat" else v.ADDRESS_CLAMP)
            else:
                kind, sampler = v.DESCRIPTOR_SAMPLED_IMAGE, -1
            kinds.append((kind, (v.STAGE_VERTEX if b.vertex else 0) | (v.STAGE_FRAGMENT if b.fragment else 0), sampler))
        pipeline = self.pipelines.number(_freeze({
            "vertex": self.shaders.number(("vert", draw.vertex)), "fragment": self.shaders.number(("frag", draw.fragment)),
            "pass": number, "subpass": subpass, "bindings": tuple(kinds), "depth": draw.depth,
            "topology": v.TOPOLOGIES[draw.topology]}))
        if draw.cell:
            w, h, columns = draw.cell
            cells = [[k % columns * w, k // columns * h, w, h] for k in range(draw.views)]
        else:
            cells = [[0, 0, stage.extent.width, stage.extent.height]]
        return {"pipeline": pipeline, "images": refs, "vertices": draw.vertices, "cells": cells, "depth_range": [0.0, 1.0],
                "count": -1 if draw.count is None else self._ref(draw.count, place)}


def _totals(stages: Sequence[Stage]) -> dict[Extent, Node]:
    """Of the extents of lists that these stages make, what says how many entries there are."""
    return {n.extent: x for stage in stages for s in stage.substages for n in s.nodes if n.extent.partial
            for k, x in enumerate(n.inputs) if n.op.read(k) == COUNT}


class _Unread:
    """Which outputs of a substage nothing reads where they are left out."""

    def __init__(self, roots: Sequence[Node], stages: Sequence[Stage]):
        self.roots, self.reads = set(roots), {}
        for n in (n for stage in stages for s in stage.substages for n in s.nodes):
            for k, x in enumerate(n.inputs):
                self.reads.setdefault(x, []).append((n, k))

    def outside(self, x: Node, guard: Guard, outputs: Sequence[Node]) -> bool:
        """Whether x, one of the outputs, is of use only where something is named by an image that names nothing where the guard leaves
        them out: another output, or what the guard is made of (`Op.named`, `Op.covers`)."""
        known = dict(zip(outputs, guard.constants))
        if guard.node.op.covers:
            covered, value = guard.node.op.covers
            known[guard.node.inputs[covered]] = value

        def of_no_use(n: Node, k: int) -> bool:
            mine, other, none = n.op.named or (-1, 0, 0)
            return k == mine and known.get(n.inputs[other]) == none
        return x not in self.roots and all(of_no_use(n, k) for n, k in self.reads[x])

    def after_the_last(self, x: Node, total: Node | None) -> int | None:
        """What an output of a list has to be in the part that is not drawn: draws may run over all entries."""
        drawn = x in self.roots or any(n.op.read(k) == VERTEX for n, k in self.reads[x])
        return -1 if total and x.vtype == "int" and drawn else None


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


def _freeze(d: dict) -> tuple:
    return tuple(sorted(d.items()))


def _unfreeze(x):
    if isinstance(x, tuple) and x and all(isinstance(i, tuple) and len(i) == 2 and isinstance(i[0], str) for i in x):
        return {k: _unfreeze(i) for k, i in x}
    return [_unfreeze(i) for i in x] if isinstance(x, tuple) else x
