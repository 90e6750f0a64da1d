"""What a problem is written with: every op as a function of nodes (the paper's namespace F).

Numbers may stand for nodes; arrays are wrapped with `constant` (an image) or `constant_table`. All inputs have equal extents or 1 x 1.
"""
from __future__ import annotations

from . import ops as _ops  # noqa: F401
from .ir import Node
from .ops.lookup import constant, constant_table, gather_sum, lookup
from .ops.matrix import matmul, sparse_matmul
from .ops.reduce import largest, mean, total
from .ops.stencil import convolve, downsample, shift, upsample
from .ops.tables import concat, pad, reshape, slice_table, to_image, to_table
from .ops.vector import compose
from .optable import apply

__all__ = ["absolute", "apply", "channels", "clamp", "compose", "concat", "constant", "constant_table", "convolve", "cross", "dot",
           "downsample", "equal", "gather_sum", "largest", "length", "lookup", "matmul", "maximum", "mean", "minimum", "mix", "normalize",
           "not_equal", "pad", "reshape", "select", "shift", "sigmoid", "slice_table", "sparse_matmul", "sqrt", "stop_gradient",
           "to_float", "to_image", "to_int", "to_table", "total", "upsample"]


def select(c, a, b) -> Node:
    """a where c is not zero, else b."""
    return apply("select", c, a, b)


def minimum(a, b) -> Node:
    return apply("min", a, b)


def maximum(a, b) -> Node:
    return apply("max", a, b)


def clamp(a, low, high) -> Node:
    """a limited to [low, high]; the gradient outside is zero."""
    return minimum(maximum(a, low), high)


def absolute(a) -> Node:
    return apply("abs", a)


def sqrt(a) -> Node:
    return apply("sqrt", a)


def sigmoid(a) -> Node:
    return apply("sigmoid", a)


def dot(a, b) -> Node:
    """Inner product of two vectors; of scalars, the product."""
    return a * b if a.channels == 1 else apply("dot", a, b)


def cross(a, b) -> Node:
    return apply("cross", a, b)


def length(a) -> Node:
    """Euclidean length; its gradient at zero is zero."""
    return sqrt(dot(a, a))


def normalize(a, epsilon: float = 1e-20) -> Node:
    """a / |a|; zero, with zero gradient, where |a|^2 is not above epsilon."""
    squared = dot(a, a)
    valid = squared > epsilon
    return a * (select(valid, 1.0, 0.0) / sqrt(select(valid, squared, 1.0)))


def mix(a, b, t) -> Node:
    """a + (b - a) t."""
    return a + (b - a) * t


def equal(a, b) -> Node:
    return apply("equal", a, b)


def not_equal(a, b) -> Node:
    return apply("not_equal", a, b)


def stop_gradient(a) -> Node:
    """The value, with no gradient through it."""
    return apply("stop_gradient", a)


def to_float(a) -> Node:
    return apply("to_float", a)


def to_int(a) -> Node:
    """Rounded towards zero."""
    return apply("to_int", a)


def channels(a: Node) -> list[Node]:
    """The scalars of a vector."""
    return [a] if a.channels == 1 else [apply("swizzle", a, channels=c) for c in "xyzw"[:a.channels]]
