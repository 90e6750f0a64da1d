"""Numbers of 8 bits, four in an int: pictures in the bits that they have, on any device that samples integers."""
from __future__ import annotations

import numpy as np

from ....cache.errors import GraphError
from ..functions import compose, constant_table, lookup
from ..ir import Node
from ..optable import apply, op

# k / 255 rounded to fp32 for every k of 0 to 255, whether or not a device fuses: k HIGH is exact, HIGH having 16 bits. A division may be
# off by 2.5 units in the last place, and k times the rounded 1 / 255 is for some k.
HIGH, LOW = 0.0039215087890625, 5.983839201917363e-08


def _infer(name, inputs, attrs):
    if inputs[0].vtype != "int":
        raise GraphError(f"{name}: an int is needed, got {inputs[0]!r}")
    return "ivec4", inputs[0].extent


op("unpack8", "a", infer=_infer, ref=lambda a: a >> np.array([0, 8, 16, 24]) & 255, glsl="{y} = ivec4({a}) >> ivec4(0, 8, 16, 24) & 255;",
   cost=4, sample=lambda rng: ([rng.integers(-2 ** 31, 2 ** 31, (4, 5, 1))], {}),
   doc="The four bytes of an int, the lowest first; no gradient.")
# Without `precise` drivers make k (HIGH + LOW) of it.
op("unorm8", "a", infer=lambda name, inputs, attrs: ("vec4", _infer(name, inputs, attrs)[1]), cost=8,
   ref=lambda a: ((a >> np.array([0, 8, 16, 24]) & 255) / 255.0).astype(np.float32).astype(np.float64),
   glsl="{ vec4 k_ = vec4(ivec4({a}) >> ivec4(0, 8, 16, 24) & 255); precise vec4 x_ = k_ * " f"{HIGH!r} + k_ * {LOW!r}" "; {y} = x_; }",
   sample=lambda rng: ([rng.integers(-2 ** 31, 2 ** 31, (4, 5, 1))], {}),
   doc="Four bytes k of an int as k / 255, rounded to fp32 once; no gradient.")


def unorm8(packed: Node, table: np.ndarray | None = None) -> Node:
    """vec4 of RGBA bytes in an int, each k / 255 to the bit. table: (256,) what the bytes of R, G and B stand for instead."""
    x = apply("unorm8", packed)
    if table is None:
        return x
    bytes_, values = apply("unpack8", packed), constant_table(np.asarray(table, np.float64))
    return compose(*(lookup(values, getattr(bytes_, c)) for c in "xyz"), x.w)
