"""Storage "half": which images have 16 bits a channel, as graph. Arithmetic stays fp32.

In: a `Program`. Out: the same with `half` nodes and inputs, which round to what such an image holds: the reference sees what the
device sees, and how it is packed makes no difference. Two facts decide. An op `sums` an input if many of its texels only add up:
gradients of pixels on their way to faces, edges and texels. A value is `narrow` if nothing but images is compared with it: targets.
All else stays: integers; states, whose updates would vanish; positions and coordinates, for 11 bits are no pixel in 2048; and whatever is
read at its own texel, for whether that is stored depends on the profile.

The gradient of a mean over a million pixels is below what fp16 can hold. So each such image holds its values times a power of two,
by which their usual magnitude, followed through the graph from that of constants and of what values start with, becomes 1; there are 2^16
above and 2^14 below that with all 11 bits. What is beyond is held at the largest number.
"""
from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from ...cache.errors import InputError, ProfileError
from ...cache.profile import Profile
from ..graph.formats import HALF_FORMATS
from ..graph.ir import UNIT, Node, is_int, rebuild, remade, topological
from ..graph.optable import apply
from ..graph.program import Program

STORAGES = ("float", "half")
MOST = 96  # of the power of two: what it scales, and its inverse, must be numbers of fp32


def choose(storage: str | None, profiles: Iterable[Profile]) -> bool:
    """Whether to store in half: as asked for, or if all profiles prefer it. Raises InputError, ProfileError."""
    profiles = list(profiles)
    if storage not in (None, *STORAGES):
        raise InputError(f"storage is {storage!r:.40}; allowed: {' '.join(STORAGES)}")
    half = storage == "half" if storage else all(p.prefer_fp16 for p in profiles)
    for profile in profiles if half else ():
        for name in dict.fromkeys(HALF_FORMATS.values()):
            if not profile.format_has(name, "sampled", "color"):
                has = " ".join(sorted(profile.format_features(name))) or "nothing"
                raise ProfileError(f"storage half needs {name} with color and sampled; profile {profile.name} has {has}; "
                                   "choose storage float")
    return half


def sizes(program: Program, roots: Iterable[Node]) -> dict[Node, float]:
    """log2 of the usual magnitude of each node, by `Op.size`; minus infinity for zeros."""
    found: dict[Node, float] = {}
    for n in topological(roots):
        inputs = [found[x] for x in n.inputs]
        floats = [found[x] for x in n.inputs if not is_int(x.vtype)]
        if n.op.held:
            found[n] = _start(program.values[n.attrs["name"]].initial)
        elif is_int(n.vtype):
            found[n] = 0.0
        elif n.op.size is not None:
            found[n] = n.op.size(n, inputs)
        else:
            found[n] = found[n.inputs[n.op.sums[0]]] if n.op.sums else max(floats, default=0.0)
    return found


def _start(initial) -> float:
    """Of what has no value yet, or starts at zero, 1 is expected."""
    largest = 0.0 if initial is None else float(np.abs(initial).max())
    return math.log2(largest) if largest else 0.0


def halve(program: Program) -> Program:
    """The program in storage half. Raises InputError where an input's initial value is beyond fp16."""
    roots = [n for spec in program.plans for n in (*spec.updates.values(), *spec.outputs.values())]
    size = sizes(program, roots)

    def rewrite(node: Node, inputs: tuple[Node, ...]) -> Node:
        if node.op.held and program.values[node.attrs["name"]].narrow:
            return apply(node.op.name, **node.attrs, half=0)
        inputs = tuple(_rounded(x, size[old]) if k in node.op.sums else x for k, (x, old) in enumerate(zip(inputs, node.inputs)))
        return remade(node, inputs)

    new = rebuild(roots, rewrite)
    values = {name: replace(value, node=new.get(value.node, value.node)) for name, value in program.values.items()}
    for name, value in values.items():
        if value.node.half is not None and value.initial is not None:
            value.layout.to_image(value.initial, name, half=True)
    plans = [replace(spec, updates={k: new[n] for k, n in spec.updates.items()}, outputs={k: new[n] for k, n in spec.outputs.items()})
             for spec in program.plans]
    return replace(program, values=values, plans=plans)


def _rounded(x: Node, size: float) -> Node:
    if x.op.stage in ("leaf", "inline") or is_int(x.vtype) or x.extent == UNIT:
        return x
    return apply("half", x, half=0 if math.isinf(size) else max(-MOST, min(MOST, -round(size))))
