"""Numbers of 8 bits, four in an int, or of 16, four in two: pictures in the bits that they have, on any device that samples integers."""
from __future__ import annotations

import numpy as np

from ....cache.errors import GraphError
from ..functions import compose, constant_table, lookup
from ..ir import Node
from ..optable import apply, op

# k / 255 rounded to fp32 for every k of 0 to 255, whether or not a device fuses: k HIGH is exact, HIGH having 16 bits. A division may be
# off by 2.5 units in the last place, and k times the rounded 1 / 255 is for some k.
HIGH, LOW = 0.0039215087890625, 5.983839201917363e-08
HIGH16, LOW16 = 1.52587890625e-05, 2.3283419636754843e-10  # of k / 65535: a power of two, and the rest


def _infer(vtype):
    def infer(name, inputs, attrs):
        if inputs[0].vtype != vtype:
            raise GraphError(f"{name}: an {vtype} is needed, got {inputs[0]!r}")
        return ("vec4" if name.startswith("unorm") else "ivec4"), inputs[0].extent
    return infer


op("unpack8", "a", infer=_infer("int"), ref=lambda a: a >> np.array([0, 8, 16, 24]) & 255, cost=4,
   glsl="{y} = ivec4({a}) >> ivec4(0, 8, 16, 24) & 255;", sample=lambda rng: ([rng.integers(-2 ** 31, 2 ** 31, (4, 5, 1))], {}),
   doc="The four bytes of an int, the lowest first; no gradient.")
# Without `precise` drivers make k (HIGH + LOW) of it.
op("unorm8", "a", infer=_infer("int"), cost=8,
   ref=lambda a: ((a >> np.array([0, 8, 16, 24]) & 255) / 255.0).astype(np.float32).astype(np.float64),
   glsl="{ vec4 k_ = vec4(ivec4({a}) >> ivec4(0, 8, 16, 24) & 255); precise vec4 x_ = k_ * " f"{HIGH!r} + k_ * {LOW!r}" "; {y} = x_; }",
   sample=lambda rng: ([rng.integers(-2 ** 31, 2 ** 31, (4, 5, 1))], {}),
   doc="Four bytes k of an int as k / 255, rounded to fp32 once; no gradient.")


def _words(a):
    return (a[..., [0, 0, 1, 1]] >> np.array([0, 16, 0, 16])) & 65535


_WORDS = "ivec4({a}.xx, {a}.yy) >> ivec4(0, 16, 0, 16) & 65535"
op("unpack16", "a", infer=_infer("ivec2"), ref=_words, glsl="{y} = " f"{_WORDS};",
   cost=4, sample=lambda rng: ([rng.integers(-2 ** 31, 2 ** 31, (4, 5, 2))], {}),
   doc="The four numbers of 16 bits in two ints, the lower of the first first; no gradient.")
op("unorm16", "a", infer=_infer("ivec2"), cost=8, ref=lambda a: (_words(a) / 65535.0).astype(np.float32).astype(np.float64),
   glsl="{ vec4 k_ = vec4(" f"{_WORDS}); precise vec4 x_ = k_ * {HIGH16!r} + k_ * {LOW16!r};" " {y} = x_; }",
   sample=lambda rng: ([rng.integers(-2 ** 31, 2 ** 31, (4, 5, 2))], {}),
   doc="Four numbers k of 16 bits in two ints as k / 65535, rounded to fp32 once; no gradient.")


def unorm8(packed: Node, table: np.ndarray | None = None) -> Node:
    """vec4 of RGBA bytes in an int, each k / 255 to the bit. table: (256,) what the bytes of R, G and B stand for instead."""
    return _told(packed, 8, table)


def unorm16(packed: Node, table: np.ndarray | None = None) -> Node:
    """vec4 of RGBA words in an ivec2, each k / 65535 to the bit. table: (65536,) what the words of R, G and B stand for instead."""
    return _told(packed, 16, table)


def _told(packed: Node, bits: int, table: np.ndarray | None) -> Node:
    x = apply(f"unorm{bits}", packed)
    if table is None:
        return x
    numbers, values = apply(f"unpack{bits}", packed), constant_table(np.asarray(table, np.float64))
    return compose(*(lookup(values, getattr(numbers, c)) for c in "xyz"), x.w)
