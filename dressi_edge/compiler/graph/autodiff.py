"""Reverse mode: from a loss and the nodes to differentiate by, the gradient nodes. Builds graph only.

Rows of the op table say how a gradient passes each op; broadcasting is undone here and nowhere else.
"""
from __future__ import annotations

from collections.abc import Collection, Sequence

from ...cache.errors import GraphError
from .ir import UNIT, Node, is_int, topological
from .ops.reduce import total
from .ops.vector import compose
from .optable import apply


def _fit(g: Node, x: Node) -> Node:
    """Sum a gradient over what x was broadcast to."""
    if x.channels == 1 and g.channels > 1:
        g = apply("sum_channels", g)
    if x.extent == UNIT and g.extent != UNIT:
        g = total(g)
    return g


def _widen(g: Node, y: Node) -> Node:
    """A gradient of y's own type and extent."""
    if g.channels != y.channels:
        g = compose(*[g] * y.channels)
    return g if g.extent == y.extent else apply("broadcast", g, extent=y.extent)


def gradients(loss: Node, wrt: Sequence[Node]) -> list[Node]:
    """d loss / d x for each x of `wrt`, same type and extent as x; zeros where the loss does not depend on x.

    The loss is a float of extent 1x1. Raises GraphError if a path from x to the loss passes an op that has no gradient.
    """
    if not isinstance(loss, Node) or isinstance(wrt, Node) or wrt is None or any(not isinstance(x, Node) for x in wrt):
        raise GraphError("gradients: a loss and a sequence of nodes to differentiate by are needed")
    if loss.vtype != "float" or loss.extent != UNIT:
        raise GraphError(f"the loss {loss!r} is not a 1x1 float; reduce it with total() or mean()")
    order, asked = topological([loss]), set(wrt)
    needed: set[Node] = set()
    for node in order:
        if node in asked or (not is_int(node.vtype) and any(x in needed for x in node.inputs)):
            needed.add(node)
    pending: dict[Node, list[Node]] = {loss: [apply("literal", value=1.0)]}
    done: dict[Node, Node] = {}
    for y in reversed(order):
        terms = pending.pop(y, None)
        if y not in needed or not terms:
            continue
        g = _sum_pairwise(terms)
        if y in asked:
            done[y] = _widen(g, y)
        if not any(x in needed for x in y.inputs):
            continue
        if y.op.vjp is None:
            raise GraphError(f"{y.op.name} has no gradient, and the loss depends on {_culprit(y, asked).name} through it; "
                             "cut the path with stop_gradient")
        for x, gx in zip(y.inputs, y.op.vjp(_widen(g, y), y, *y.inputs, **y.attrs)):
            if x in needed and gx is not None:
                pending.setdefault(x, []).append(_fit(gx, x))
    return [done[x] if x in done else _widen(apply("literal", value=0.0), x) for x in wrt]


def _sum_pairwise(terms: list[Node]) -> Node:
    while len(terms) > 1:
        terms = [terms[k] + terms[k + 1] if k + 1 < len(terms) else terms[k] for k in range(0, len(terms), 2)]
    return terms[0]


def _culprit(y: Node, wrt: Collection[Node]) -> Node:
    return next((node for node in topological([y]) if node in wrt), y)
