"""Python's operators on nodes: + - * / // % ** abs, comparisons, & and | of integers, channels by name and by number."""
from __future__ import annotations

import numpy as np

from ...cache.errors import GraphError
from .ir import UNIT, Node, is_int
from .optable import apply, as_node


def power(a, b) -> Node:
    """a to the power b. A whole number b up to 64 is multiplied out, so negative bases are right; for any other b the base must not be
    negative (`pow`)."""
    if isinstance(b, float | np.floating) and float(b).is_integer():
        b = int(b)
    if not isinstance(b, int | np.integer) or isinstance(b, bool) or abs(b) > 64:
        return apply("sqrt", a) if isinstance(b, float | np.floating) and b == 0.5 else apply("pow", a, b)
    a, result, n = as_node(a), None, abs(int(b))
    if is_int(a.vtype) and b < 0:
        raise GraphError(f"power: {a!r} to the power {b}; of integers, powers from 0 on are allowed")
    square = a
    while n:
        if n & 1:
            result = square if result is None else apply("mul", result, square)
        n >>= 1
        square = apply("mul", square, square) if n else square
    if result is None:
        one = 1 if is_int(a.vtype) else 1.0
        one = apply("literal", value=one if a.channels == 1 else (one,) * a.channels)
        return one if a.extent == UNIT else apply("broadcast", one, extent=a.extent)
    return result if b >= 0 else apply("div", 1.0, result)


def remainder(a, b) -> Node:
    """a modulo b with the sign of b; of integers, neither may be negative."""
    integer = any(isinstance(x, Node) and is_int(x.vtype) for x in (a, b))
    return apply("imod" if integer else "mod", a, b)


def _floordiv(a, b) -> Node:
    integer = any(isinstance(x, Node) and is_int(x.vtype) for x in (a, b))
    return apply("idiv", a, b) if integer else apply("floor", apply("div", a, b))


def _item(a: Node, index) -> Node:
    """Channels by number or slice."""
    names = "xyzw"[:a.channels]
    try:
        chosen = names[index]
    except (TypeError, ValueError, IndexError):
        chosen = ""
    if not chosen:
        raise GraphError(f"{a!r} [{index!r:.40}]: channels 0 to {a.channels - 1}, or a slice of them, are allowed; slice_table() gives "
                         "entries of a table, shift() neighbours")
    return a if chosen == names else apply("swizzle", a, channels=chosen)


def _operators() -> None:
    def swapped(function):
        return lambda a, b: function(b, a)

    def of(name):
        return lambda a, b: apply(name, a, b)

    for method, function in (("add", of("add")), ("sub", of("sub")), ("mul", of("mul")), ("truediv", of("div")), ("floordiv", _floordiv),
                             ("mod", remainder), ("pow", power), ("and", of("bit_and")), ("or", of("bit_or"))):
        setattr(Node, f"__{method}__", function)
        setattr(Node, f"__r{method}__", swapped(function))
    for method, name in (("lt", "less"), ("le", "less_equal"), ("gt", "greater"), ("ge", "greater_equal")):
        setattr(Node, f"__{method}__", of(name))
    Node.__neg__ = lambda a: apply("neg", a)
    Node.__pos__ = lambda a: a
    Node.__abs__ = lambda a: apply("abs", a)
    Node.__getitem__ = _item

    def channel(names):
        return property(lambda a: apply("swizzle", a, channels=names))

    for names in ("x", "y", "z", "w", "xy", "xz", "yz", "zw", "xyz", "xyw"):
        setattr(Node, names, channel(names))


_operators()
