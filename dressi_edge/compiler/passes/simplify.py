"""Rewrite a graph to a smaller equal one, and lower composites.

`lower` replaces ops that no single shader can do (`sum`, those with `Op.lower`) by passes. `simplify` folds literals and applies the
identities of RULES; all rows are exact on finite values: the reference gives the same numbers before and after. The sign of a zero may
change, and a product with a literal 0 is 0 also where the other factor is infinite or NaN.
"""
from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...cache.layout import beyond_fp32
from ..graph.ir import CHANNELS, UNIT, Node, is_int, rebuild, remade
from ..graph.ops.reduce import lower_sum
from ..graph.optable import apply, stored


def _value(node: Node) -> float | int | None:
    return node.attrs["value"] if node.op.name == "literal" else None


def _nothing(node: Node) -> bool:
    """Whether it is zero in every channel: a literal, what is taken from itself, or a product with one of these."""
    if node.op.name == "mul":
        return any(_nothing(x) for x in node.inputs)
    if node.op.name == "sub" and node.inputs[0] is node.inputs[1]:
        return True
    return node.op.name == "literal" and not np.any(node.attrs["value"])


def _as(x: Node, like: Node) -> Node | None:
    """x if it has like's type and extent."""
    return x if (x.vtype, x.extent) == (like.vtype, like.extent) else None


def _first(a: Node | None, b: Node | None) -> Node | None:
    return b if a is None else a


def _zero(like: Node) -> Node | None:
    return apply("literal", value=0 if is_int(like.vtype) else 0.0) if CHANNELS[like.vtype] == 1 and like.extent.count == 1 else None


def _channel(x: Node, k: int) -> Node:
    return x if x.channels == 1 else apply("swizzle", x, channels="xyzw"[k])


# op -> (inputs, node) -> replacement or None
RULES = {
    "add": lambda x, n: _first(_as(x[1], n) if _nothing(x[0]) else None, _as(x[0], n) if _nothing(x[1]) else None),
    "sub": lambda x, n: _as(x[0], n) if _nothing(x[1]) else None,
    "mul": lambda x, n: (_as(x[1], n) if _value(x[0]) == 1 else _as(x[0], n) if _value(x[1]) == 1 else
                         _zero(n) if 0 in (_value(x[0]), _value(x[1])) else None),
    "div": lambda x, n: _as(x[0], n) if _value(x[1]) == 1 else None,
    "neg": lambda x, n: x[0].inputs[0] if x[0].op.name == "neg" else None,
    "stop_gradient": lambda x, n: x[0],
    "select": lambda x, n: _as(x[1], n) if x[1] is x[2] else None,  # branches that differ in their gradients alone
    "broadcast": lambda x, n: _as(x[0], n),
    "lookup_boxed": lambda x, n: apply("lookup", *x[:2]),  # what else these three take is for the transpose alone
    "lookup_near": lambda x, n: apply("lookup", x[0], _channel(x[1], n.attrs["channel"]) - 1),
    "lookup_listed": lambda x, n: apply("lookup", *x[:2]),
    "swizzle": lambda x, n: _swizzle(x[0], n),
    "shift_right": lambda x, n: _as(x[0], n) if _value(x[1]) == 0 else None,
}


def _swizzle(x: Node, node: Node) -> Node | None:
    channels = node.attrs["channels"]
    if channels == "xyzw"[:x.channels]:
        return x
    if x.op.name == "swizzle":
        return apply("swizzle", x.inputs[0], channels="".join(x.attrs["channels"]["xyzw".index(c)] for c in channels))
    if x.op.name.startswith("compose") and len(channels) == 1:
        return _as(x.inputs["xyzw".index(channels)], node)
    return None


def simplify(roots: Sequence[Node]) -> list[Node]:
    """The roots' equals after literal folding and RULES."""

    def rewrite(node: Node, inputs: tuple[Node, ...]) -> Node:
        if inputs and all(x.op.name == "literal" for x in inputs) and node.extent == UNIT and node.op.stage == "pixel":
            value = node.op.ref(*(x.op.ref(_value(x)) for x in inputs), **node.attrs)[0, 0]
            if not beyond_fp32(value).any():
                value = tuple(map(int if is_int(node.vtype) else float, value))
                return apply("literal", value=value if len(value) > 1 else value[0])
        rule = RULES.get(node.op.name)
        found = rule(inputs, node) if rule else None
        return found if found is not None else remade(node, stored(node.op, inputs))

    new = rebuild(roots, rewrite)
    return [new[root] for root in roots]


def lower(roots: Sequence[Node], room: int | None = None) -> list[Node]:
    """The roots' equals without composite ops. room: bytes that the workgroups of kernels share; None: there are no kernels."""

    def rewrite(node: Node, inputs: tuple[Node, ...]) -> Node:
        if node.op.name == "sum":
            return lower_sum(inputs[0], node.attrs["count"])
        if node.op.lower is not None:
            return node.op.lower(*inputs, **node.attrs, room=room)
        return remade(node, inputs)

    new = rebuild(roots, rewrite)
    return [new[root] for root in roots]
