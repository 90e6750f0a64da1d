"""Rounding to what an image of 16 bits a channel holds; inserted by `passes/store.py`, after differentiation."""
from __future__ import annotations

import numpy as np

from ....cache.errors import GraphError
from ..ir import Node, is_int, vector_type
from ..optable import elementwise, op, zero
from .leaf import literal_glsl

LARGEST, LEAST_NORMAL, STEP = 65504.0, 2.0 ** -14, 2.0 ** -24  # of fp16; below LEAST_NORMAL numbers are STEP apart


def _infer(name, inputs, attrs):
    if is_int(inputs[0].vtype):
        raise GraphError(f"{name}: {inputs[0]!r} is an integer; floats are stored in 16 bits")
    return elementwise(name, inputs, attrs)


def _ref(a, half):
    return np.clip(a * 2.0 ** half, -LARGEST, LARGEST).astype(np.float16).astype(np.float64) * 2.0 ** -half


def _glsl(node: Node) -> str:
    """In the bits: a device may round towards zero when it writes such an image, and what fits is left as it is."""
    words, up, down = vector_type(node.channels, True), literal_glsl(2.0 ** node.half), literal_glsl(2.0 ** -node.half)
    small = f"abs(a_) < {LEAST_NORMAL}"
    pick = f"{small} ? tiny_ : intBitsToFloat(b_)" if node.channels == 1 else \
        f"mix(intBitsToFloat(b_), tiny_, lessThan(abs(a_), {{type}}({LEAST_NORMAL})))"
    return (f"{{ {{type}} a_ = clamp({{a}} * {up}, -{LARGEST}, {LARGEST}), tiny_ = roundEven(a_ * {1 / STEP}) * {STEP};\n"
            f"    {words} b_ = floatBitsToInt(a_); b_ = (b_ + 4095 + ((b_ >> 13) & 1)) & ~8191;\n"
            f"    {{y}} = ({pick}) * {down}; }}")


op("half", "a", infer=_infer, when=zero(0), cost=12, ref=_ref, glsl=_glsl,
   sample=lambda rng: ([rng.normal(size=(4, 5, 3)) * 2.0 ** rng.integers(-30, 20, (4, 5, 1))], {"half": 3}),
   doc="Rounded to nearest even to fp16 at 2^half times its value, held within +-65504 there; its image has 16 bits a channel.")
