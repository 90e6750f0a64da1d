"""What a problem is written with: every op of the table as a function of nodes (the paper's namespace F), by its name, and what is made
of several ops. `help(functions.sin)` says what one does; `dir(functions)` lists all.

Numbers may stand for nodes; arrays are wrapped with `constant` (an image) or `constant_table`. Inputs have equal extents or 1 x 1 where
nothing else is said. `op` adds an op of one's own, `compiler.check_op` tests it.
"""
from __future__ import annotations

import inspect
from collections.abc import Callable

from . import ops as _ops  # noqa: F401
from .ir import Node
from .operators import power, remainder
from .ops.lookup import constant, constant_table, gather_sum, lookup
from .ops.matrix import matmul, sparse_matmul
from .ops.reduce import largest, mean, total
from .ops.scan import bincount, exclusive_scan
from .ops.stencil import convolve, downsample, shift, upsample
from .ops.tables import concat, pad, reshape, slice_table, to_image, to_table
from .ops.vector import compose
from .optable import OPS, Op, apply, as_node, nearest, op

__all__ = ["absolute", "apply", "bincount", "channels", "clamp", "compose", "concat", "constant", "constant_table", "convolve", "cross",
           "dot", "downsample", "equal", "exclusive_scan", "gather_sum", "largest", "length", "lookup", "matmul", "maximum", "mean",
           "minimum", "mix", "normalize", "not_equal", "op", "pad", "power", "remainder", "reshape", "scale_gradient", "select", "shift",
           "sigmoid", "slice_table", "sparse_matmul", "sqrt", "stop_gradient", "to_float", "to_image", "to_int", "to_table", "total",
           "upsample"]


def _function(row: Op) -> Callable[..., Node]:
    def function(*inputs, **attrs) -> Node:
        return apply(row.name, *inputs, **attrs)

    function.__name__ = function.__qualname__ = row.name
    function.__doc__ = row.doc
    own = [inspect.Parameter(name, inspect.Parameter.POSITIONAL_ONLY) for name in row.params]
    must = [inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY) for name in row.attrs]
    may = [inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None) for name in row.optional]
    function.__signature__ = inspect.Signature([*own, *must, *may])
    return function


def __getattr__(name: str) -> Callable[..., Node]:
    row = OPS.get(name)
    if row is None:
        raise AttributeError(f"there is no function {name!r:.60}{nearest(name, [*OPS, *__all__])}", name=name)
    made = globals()[name] = _function(row)
    return made


def __dir__() -> list[str]:
    return sorted({*__all__, *OPS})


def select(c, a, b) -> Node:
    """a where c is not zero, else b. The branch not taken gets a zero gradient; both must be finite."""
    return apply("select", c, a, b)


def minimum(a, b) -> Node:
    """The smaller, channel by channel; a tie gives its gradient to a."""
    return apply("min", a, b)


def maximum(a, b) -> Node:
    """The larger, channel by channel; a tie gives its gradient to a."""
    return apply("max", a, b)


def clamp(a, low, high) -> Node:
    """a limited to [low, high]; the gradient outside is zero."""
    return minimum(maximum(a, low), high)


def absolute(a) -> Node:
    """Without its sign; the gradient at 0 is 0."""
    return apply("abs", a)


def sqrt(a) -> Node:
    """Square root; 0 below zero; the gradient at 0 is 0."""
    return apply("sqrt", a)


def sigmoid(a) -> Node:
    """1 / (1 + exp(-a)) without overflow."""
    return apply("sigmoid", a)


def dot(a, b) -> Node:
    """Inner product of two vectors; of scalars, the product."""
    a = as_node(a)
    return a * b if a.channels == 1 else apply("dot", a, b)


def cross(a, b) -> Node:
    """Cross product of two vec3."""
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
    a, b = as_node(a), as_node(b)
    return a + (b - a) * t


def equal(a, b) -> Node:
    """1 where a and b are equal, else 0."""
    return apply("equal", a, b)


def not_equal(a, b) -> Node:
    """1 where a and b differ, else 0."""
    return apply("not_equal", a, b)


def stop_gradient(a) -> Node:
    """The value, with no gradient through it."""
    return apply("stop_gradient", a)


def scale_gradient(a, by) -> Node:
    """a, and its gradient times `by`, which gets none."""
    held = stop_gradient(a)
    return held + (a - held) * stop_gradient(by)


def to_float(a) -> Node:
    """Integers as floats; no gradient."""
    return apply("to_float", a)


def to_int(a) -> Node:
    """Rounded towards zero."""
    return apply("to_int", a)


def channels(a: Node) -> list[Node]:
    """The scalars of a vector."""
    a = as_node(a)
    return [a] if a.channels == 1 else [apply("swizzle", a, channels=c) for c in "xyzw"[:a.channels]]
