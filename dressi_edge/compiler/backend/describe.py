"""From names and nodes to the numbers of docs/bundle-format.md: the one place where a description is put together.

In: a program, its packed plans, their code, their places, and SPIR-V for each shader. Out: the description, a plain dict, and its blobs.
"""
from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence

import numpy as np

from ...cache import vulkan as v
from ...cache.layout import Layout
from ..graph.formats import format_number
from ..graph.ir import CHANNELS, Node, is_int
from ..graph.program import Program
from ..passes.plans import PackedPlan
from ..passes.substage import KEPT, Stage, Substage
from .allocate import Allocation, Image, PlacedPlan, PlacedStage, is_copy
from .code import ATTACHMENT, SAMPLER, Binding, Code, DrawCode

LARGE = 1 << 16  # bytes from which a state that starts with zeros is not in the file, and an image that starts as one texel is that texel

Shader = tuple[str, str]  # "vert", "frag" or "comp", and its GLSL


def shaders(code: Sequence[Sequence[Sequence[Code]]]) -> list[Shader]:
    """The distinct shaders of all plans, in order of first use."""
    return list(dict.fromkeys(shader for plan in code for stage in plan for c in stage for shader in c.shaders))


def describe(program: Program, plans: Sequence[PackedPlan], code: Sequence[Sequence[Sequence[Code]]], places: Allocation,
             spirv: Mapping[Shader, bytes]) -> tuple[dict, list[bytes]]:
    """The description without what depends on the profile alone, and the blobs that it names."""
    blobs, tables = _Blobs(), _Tables(code)
    images = [_image(image, blobs) for image in places.images]
    values = _values(program, plans, places, blobs)
    numbers = {value["name"]: k for k, value in enumerate(values)}
    at = {plan.graph.name: k for k, plan in enumerate(plans)}
    filled = any(type(value["initial"]) is bytes for value in values)
    described = [_plan(plan, c, where, tables, numbers, at) for plan, c, where in zip(plans, code, places.plans)]
    return {"meta": program.meta, "images": images, "samplers": tables.samplers.records,
            "shaders": [blobs.add(spirv[shader]) for shader in tables.shaders],
            "passes": tables.passes.records, "pipelines": tables.pipelines.records,
            **({"computes": tables.computes.records} if tables.computes.records or filled else {}),
            "values": values, "plans": described}, blobs.made


class _Blobs:
    """Bytes by number; equal ones have one."""

    def __init__(self):
        self.made: list[bytes] = []
        self._at: dict[bytes, int] = {}

    def add(self, data: bytes) -> int:
        number = self._at.setdefault(hashlib.sha256(data).digest(), len(self.made))
        if number == len(self.made):
            self.made.append(data)
        return number


class _Tables:
    """What plans share, numbered in order of first use: samplers and shaders by themselves, passes and pipelines by their content."""

    def __init__(self, code: Sequence[Sequence[Sequence[Code]]]):
        self.shaders = {shader: k for k, shader in enumerate(shaders(code))}
        self.samplers, self.passes, self.pipelines, self.computes = _Table(), _Table(), _Table(), _Table()


class _Table:
    """Records by number; equal ones have one."""

    def __init__(self):
        self.records: list = []
        self._at: dict[str, int] = {}

    def number(self, record) -> int:
        number = self._at.setdefault(repr(record), len(self.records))
        if number == len(self.records):
            self.records.append(record)
        return number


def _texels(array: np.ndarray, vtype: str, half: bool = False) -> bytes:
    """(height, width, channels) as the bytes of its image format."""
    array = np.asarray(array, np.int32 if is_int(vtype) else np.float16 if half else np.float32)
    if CHANNELS[vtype] == 3:
        array = np.concatenate([array, np.zeros_like(array[..., :1])], 2)
    return array.astype(array.dtype.newbyteorder("<")).tobytes()


def _laid(array: np.ndarray, image: Image) -> np.ndarray:
    """(height, width, channels) in the image's rows, zeros after the last."""
    if array.shape[:2] == (image.height, image.width):
        return array
    flat = np.zeros((image.height * image.width, array.shape[2]), array.dtype)
    flat[:array.shape[0] * array.shape[1]] = array.reshape(-1, array.shape[2])
    return flat.reshape(image.height, image.width, -1)


def _image(image: Image, blobs: _Blobs) -> dict:
    data = None if image.data is None else blobs.add(_texels(_laid(image.data.attrs["data"].array, image), image.data.vtype))
    return {"format": image.format, "width": image.width, "height": image.height, "slots": image.slots, "usage": image.usage,
            "data": data}


def _values(program: Program, plans: Sequence[PackedPlan], places: Allocation, blobs: _Blobs) -> list[dict]:
    def record(name: str, role: str, layout: Layout, initial: int | bytes | None) -> dict:
        return {"name": name, "role": role, "image": places.values[name], "type": layout.vtype, "layout": layout.kind,
                "width": layout.width, "height": layout.height, "count": layout.count, "columns": layout.columns, "initial": initial}

    def start(name: str, layout: Layout, texels: bytes) -> int | bytes | None:
        count = math.prod(layout.size)
        texel = texels[:len(texels) // count]
        if len(texels) < LARGE or texels != texel * count:
            return blobs.add(texels)
        return texel if program.roles[name] == "input" or any(texel) else None  # a state without is zero

    values = []
    for name, value in program.values.items():
        half = value.node.half is not None
        texels = None if value.initial is None else _texels(value.layout.to_image(value.initial, name, half), value.layout.vtype, half)
        values.append(record(name, program.roles[name], value.layout, None if texels is None else start(name, value.layout, texels)))
    copies = dict.fromkeys(x for plan in plans for x in plan.graph.targets if isinstance(x, Node) and is_copy(program, x))
    return values + [record(x.attrs["name"], "copy", Layout("image", x.vtype, x.extent.width, x.extent.height), None) for x in copies]


def _plan(plan: PackedPlan, code: Sequence[Sequence[Code]], where: PlacedPlan, tables: _Tables, numbers: Mapping[str, int],
          at: Mapping[str, int]) -> dict:
    graph = plan.graph
    reads = dict.fromkeys(x.attrs["name"] for stage in plan.stages for s in stage.substages for x in s.images if x.op.held)
    return {"name": graph.name,
            "stages": [_stage(stage, c, refs, where.refs, tables) for stage, c, refs in zip(plan.stages, code, where.stages)],
            "updates": [numbers[name] for name in graph.updates], "reads": [numbers[name] for name in reads],
            "outputs": [numbers[name] for name in graph.outputs], "needs": [at[name] for name in graph.needs], "steps": graph.steps}


def _stage(stage: Stage, code: Sequence[Code], placed: PlacedStage, refs: Mapping[Node, int], tables: _Tables) -> dict:
    if stage.compute:
        return _dispatch(stage.substages[0], code[0], placed, refs, tables)
    attached = list(placed.attachments)
    attachments = [_attachment(n, outside) for s in stage.substages for n, outside in zip(s.outputs, s.domain.outside)]
    if placed.depth >= 0:
        attached.append(placed.depth)
        attachments.append({"clear": 1, "format": 0, "load": v.LOAD_CLEAR, "store": v.STORE_DONT_CARE})
    subpasses = []
    for s, c in zip(stage.substages, code):
        inputs = [attached.index(refs[b.node]) for b in c.bindings if b.kind == ATTACHMENT]
        subpasses.append({"colors": [attached.index(refs[n]) for n in s.outputs],
                          "depth": attached.index(placed.depth) if placed.depth >= 0 else -1, "inputs": inputs})
    number = tables.passes.number({"attachments": attachments, "subpasses": subpasses})
    width, height = placed.size
    return {"pass": number, "width": width, "height": height, "attachments": attached, "wait": placed.wait,
            "subpasses": [[_draw(d, c.bindings, refs, number, k, placed.size, tables) for d in c.draws] for k, c in enumerate(code)]}


def _dispatch(s: Substage, code: Code, placed: PlacedStage, refs: Mapping[Node, int], tables: _Tables) -> dict:
    """A stage of compute. Its shader writes every texel that somebody reads, or adds to what is cleared before."""
    clear, outputs = code.dispatch.clear, []
    for n, outside in zip(s.outputs, s.domain.outside):
        first = outside if s.count is not None and outside != KEPT else clear  # workgroups that are not run write nothing
        load = v.LOAD_LOAD if outside == KEPT else v.LOAD_DONT_CARE if first is None else v.LOAD_CLEAR
        outputs.append({"format": format_number(n), "load": load, "clear": first or 0})
    bindings = [[kind, sampler] for kind, _, sampler in (_binding(b, tables) for b in code.bindings)]
    number = tables.computes.number({"shader": tables.shaders["comp", code.dispatch.shader], "bindings": bindings, "outputs": outputs})
    return {"compute": number, "groups": list(code.dispatch.groups), "images": [refs[b.node] for b in code.bindings],
            "outputs": list(placed.attachments), "count": -1 if s.count is None else refs[s.count], "wait": placed.wait}


def _attachment(n: Node, outside: int | str | None) -> dict:
    """How an output is attached: cleared where something is left out that somebody reads, else overwritten."""
    load = v.LOAD_LOAD if outside == KEPT else v.LOAD_DONT_CARE if outside is None else v.LOAD_CLEAR
    return {"clear": 0 if outside in (KEPT, None) else outside, "format": format_number(n), "load": load, "store": v.STORE_STORE}


def _draw(draw: DrawCode, bindings: Sequence[Binding], refs: Mapping[Node, int], number: int, subpass: int, size: tuple[int, int],
          tables: _Tables) -> dict:
    pipeline = tables.pipelines.number({
        "bindings": [_binding(b, tables) for b in bindings], "depth": draw.depth, "fragment": tables.shaders["frag", draw.fragment],
        "pass": number, "subpass": subpass, "topology": v.TOPOLOGIES[draw.topology], "vertex": tables.shaders["vert", draw.vertex]})
    if draw.cell:
        w, h, columns = draw.cell
        cells = [[k % columns * w, k // columns * h, w, h] for k in range(draw.views)]
    else:
        cells = [[0, 0, *size]]
    return {"pipeline": pipeline, "images": [refs[b.node] for b in bindings], "vertices": draw.vertices, "cells": cells,
            "depth_range": [0.0, 1.0], "count": -1 if draw.count is None else refs[draw.count]}


def _binding(b: Binding, tables: _Tables) -> list[int]:
    stages = (v.STAGE_VERTEX if b.vertex else 0) | (v.STAGE_FRAGMENT if b.fragment else 0)
    if b.kind == ATTACHMENT:
        return [v.DESCRIPTOR_INPUT_ATTACHMENT, stages, -1]
    if b.kind == SAMPLER:
        address = v.ADDRESS_REPEAT if b.wrap == "repeat" else v.ADDRESS_CLAMP
        return [v.DESCRIPTOR_COMBINED_IMAGE_SAMPLER, stages, tables.samplers.number(address)]
    return [v.DESCRIPTOR_SAMPLED_IMAGE, stages, -1]
