"""Find the condition under which a substage has nothing to do.

In: a substage. Out: a `Guard`: an int node of the substage and the constant of each output where that node is zero. The emitter then
discards those texels before the work and the attachments are cleared to the constants. Facts of the op table (`absorbs`,
`absent`) carry zeros through; everything else must be constant to give a constant.
"""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..graph.ir import Node, is_int
from ..graph.optable import TILE
from .substage import Substage

MIN_COST = 40  # work worth a test


@dataclass(frozen=True)
class Guard:
    """Where `node` is 0 output k is `constants[k]` in every channel: 0, or -1 for integers. `cone`: what computes the node here.
    `tile`: the node comes from outside and has one texel for so many of the substage's; whole tiles are then left undrawn."""

    node: Node
    cone: tuple[Node, ...]
    constants: tuple[int, ...]
    tile: tuple[int, int] | None = None


def constant_value(node: Node, known: dict[Node, np.ndarray]) -> np.ndarray | None:
    """The constant value (channels,) of a node given constant inputs, or None."""
    inputs = [x.op.ref(**x.attrs)[0, 0] if x.op.stage == "inline" else known.get(x) for x in node.inputs]
    channels = np.zeros(node.channels, np.int64 if is_int(node.vtype) else np.float64)
    for k, value in node.op.absent:
        if inputs[k] is not None and (inputs[k] == 0).all():
            return channels + value
    if any(inputs[k] is not None and (inputs[k] == 0).all() for k in node.op.absorbs):
        return channels
    if any(inputs[k] is not None and (inputs[k] < 0).all() for k in node.op.absorbs_negative):
        return channels
    if node.op.name == "select" and inputs[0] is not None and inputs[0].size == 1:
        taken = inputs[1] if inputs[0][0] else inputs[2]
        return None if taken is None else channels + taken
    if node.op.name == "select" and inputs[1] is not None and inputs[2] is not None and np.array_equal(*np.broadcast_arrays(*inputs[1:])):
        return channels + inputs[1]
    if node.op.stage != "pixel" or node.op.loop or not inputs or any(x is None for x in inputs) or "texel" in node.op.reads:
        return None
    value = np.asarray(node.op.ref(*(x[None, None] for x in inputs), **node.attrs))[0, 0]
    return channels + value if np.isfinite(value).all() else None


def _cone(node: Node, inside: set[Node], order: tuple[Node, ...]) -> tuple[Node, ...]:
    keep, stack = {node}, [node]
    while stack:
        for x in stack.pop().inputs:
            if x in inside and x not in keep:
                keep.add(x)
                stack.append(x)
    return tuple(n for n in order if n in keep)


def find_guard(stage: Substage, least: int = MIN_COST) -> Guard | None:
    """The guard that leaves most work out, by tiles if it can be, or None; one that leaves out less than `least` is none."""
    if stage.raster:
        return None
    inside = set(stage.nodes)
    total = sum(n.op.cost for n in stage.nodes)
    conditions = {n.inputs[0] for n in stage.nodes if n.op.name == "select"}
    conditions |= {n.inputs[k] for n in stage.nodes for k, _ in n.op.absent}
    tiles = {x: n.attrs["tile"] for n in stage.nodes for k, x in enumerate(n.inputs) if n.op.read(k) == TILE}
    best = None
    for c in sorted((c for c in conditions if is_int(c.vtype) and c.channels == 1 and (c.extent == stage.extent or c in tiles)),
                    key=lambda n: n.serial):
        known: dict[Node, np.ndarray] = {c: np.zeros(1, np.int64)}
        for n in stage.nodes:
            if n is not c:
                value = constant_value(n, known)
                if value is not None:
                    known[n] = value
        constants = [known.get(n) for n in stage.outputs]
        if any(x is None or not ((x == 0).all() or (is_int(n.vtype) and (x == -1).all())) for x, n in zip(constants, stage.outputs)):
            continue
        cone = _cone(c, inside, stage.nodes) if c in inside else ()
        saved = total - sum(n.op.cost for n in cone)
        rank = (c in tiles, saved)  # tiles that are not drawn cost nothing anywhere
        if saved >= least and (best is None or rank > best[0]):
            best = (rank, Guard(c, cone, tuple(int(x[0]) for x in constants), tiles.get(c)))
    return best and best[1]
