"""The op table: everything a pass may know about an op, in one row.

`op(...)` adds a row, `apply(name, *inputs, **attrs)` makes a node. Passes read facts (reads, stage, cost, loop), never names.

A snippet is GLSL with these marks: `{y}` the result, `{name}` an input (its own texel's value, or for inputs that are read
elsewhere two functions: `{name}(ivec2)` the texel, `{name_at}(index)` the entry in row-major order), `{name_w} {name_h}
{name_n}` an input's width, height, count, `{w} {h} {n}` the result's, `{type}` the result's GLSL type, `{attr}` any attribute,
`{i}` the own texel's row-major index and `{p}` its ivec2, `{snap}` the grid of corners in pixels. A snippet may be a function of the
node where types decide.

An input read by tile is a coarser image, one texel for each `attrs["tile"]` = (width, height) texels of the result: where it is zero
the op must not matter (`absent`), and whole tiles are left undrawn. An input read by count only says how much is drawn: it is that of a
raster op's `Draw.count`, or the number of a list's entries (`ops/compact.py`).
"""
from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from ...cache.errors import GraphError
from .ir import UNIT, Extent, Node, intern, is_int, vector_type

OWN, TEXEL, FILTERED, VERTEX, TILE, COUNT = "own", "texel", "filtered", "vertex", "tile", "count"


@dataclass(frozen=True)
class Loop:
    """A snippet that loops: ops whose headers come out equal share one loop. The result starts at zero; `body` adds to it."""

    header: str
    body: str
    close: str = "}"


@dataclass(frozen=True)
class Draw:
    """One draw of a raster op, an instance a view: `vertices = (6, "face_count")` is six invocations a face: `ops/raster.py`.

    `topology`: "triangles", or "points" (the vertex snippet sets gl_PointSize). Without `depth_test` the last primitive wins. `count`: the
    input whose last texel is how many vertices there are to draw, over the whole image in one instance; the rest must come out empty.
    An empty triangle has its corners at one point inside the clip volume: one outside may send those around it through a clipper.
    """

    vertex: str
    fragment: str
    varyings: tuple[tuple[str, str], ...]
    vertices: tuple[int, str]
    topology: str = "triangles"
    depth_test: bool = True
    count: str = ""


@dataclass(frozen=True)
class Listed:
    """How a node reads input 0 where of that only a list of texels is kept (`compiler/passes/lists.py`): `find` makes the node's places in
    it from an image of places, one for each texel (counted from 1, 0: not in the list), `read` the same values from list and places."""

    find: Callable[[Node], Node]
    read: Callable[[Node, Node], Node]


@dataclass(frozen=True)
class Op:
    """One row of the table."""

    name: str
    params: tuple[str, ...]
    infer: Callable
    ref: Callable
    vjp: Callable | None
    glsl: str | Callable = ""
    reads: tuple[str, ...] = ()
    stage: str = "pixel"
    loop: Loop | None = None
    draws: tuple[Draw, ...] = ()
    clear: int = -1  # of a raster op: where nothing is drawn
    cost: int = 1
    functions: str = ""
    absorbs: tuple[int, ...] = ()  # inputs that, when zero, make the result zero
    absorbs_negative: tuple[int, ...] = ()  # inputs that, when negative, make the result zero
    absorbs_empty: tuple[int, ...] = ()  # inputs, ranges (begin, end), that make the result zero where they hold nothing
    listed: Callable | None = None  # of a node: `Listed`
    absent: tuple[tuple[int, int], ...] = ()  # (input, result): what the result is where that input is zero
    sums: tuple[int, ...] = ()  # inputs of which many texels only add up: each may be rounded (compiler/passes/store.py)
    named: tuple[int, int, int] | None = None  # (input, other, none): that input's texels are of use only where the other's are not none
    covers: tuple[int, int] | None = None  # (input, none): where a texel of the result is 0 all that it stands for are none
    size: Callable | None = None  # (node, sizes of its inputs) -> log2 of its usual magnitude; None: that of the largest float
    sample: Callable | None = field(default=None, compare=False)
    doc: str = ""

    def read(self, k: int) -> str:
        """How input k is read."""
        return self.reads[k] if k < len(self.reads) else OWN

    def __hash__(self) -> int:
        return hash(self.name)


OPS: dict[str, Op] = {}


def op(name: str, params: str, *, infer: Callable, ref: Callable, vjp: Callable | None = None, reads: str = "", **facts) -> Op:
    """Add a row. `params` and `reads` are words; reads default to the own texel."""
    if name in OPS:
        raise GraphError(f"op {name} is declared twice")
    words = tuple(params.split())
    OPS[name] = Op(name, words, infer, ref, vjp, reads=tuple(reads.split()) or (OWN,) * len(words), **facts)
    return OPS[name]


def common_extent(name: str, inputs: tuple[Node, ...]) -> Extent:
    """The extent of inputs that are equal or 1 x 1."""
    extent = UNIT
    for x in inputs:
        if x.extent != UNIT:
            if extent not in (UNIT, x.extent):
                raise GraphError(f"{name}: extents {extent} and {x.extent} differ; equal ones or 1x1 are allowed: "
                                 + ", ".join(map(repr, inputs)))
            extent = x.extent
    return extent


def elementwise(name: str, inputs: tuple[Node, ...], attrs: dict) -> tuple[str, Extent]:
    """Types equal, or scalars beside vectors of the same kind."""
    channels = 1
    for x in inputs:
        if is_int(x.vtype) != is_int(inputs[0].vtype):
            raise GraphError(f"{name}: integer and float mixed: {', '.join(map(repr, inputs))}; convert with to_float or to_int")
        if x.channels != 1:
            if channels not in (1, x.channels):
                raise GraphError(f"{name}: {channels} and {x.channels} channels; equal ones or a scalar are allowed: "
                                 + ", ".join(map(repr, inputs)))
            channels = x.channels
    return vector_type(channels, is_int(inputs[0].vtype)), common_extent(name, inputs)


def typed(vtype: str) -> Callable:
    """Inference of an op whose result has this type over the inputs' extent."""
    return lambda name, inputs, attrs: (vtype, common_extent(name, inputs))


def at(*positions: int, vtype: str | None = None) -> Callable:
    """Inference: the extent of the inputs at these positions; the type given, or that of input 0."""
    return lambda name, inputs, attrs: (vtype or inputs[0].vtype, common_extent(name, tuple(inputs[k] for k in positions)))


# Sizes (`Op.size`) of results: of products and quotients, of choices, of which a literal is the guard and not the rule, of what is
# of order 1 whatever it is made of.

def product(node: Node, sizes: Sequence[float]) -> float:
    return sizes[0] + sizes[-1]


def quotient(node: Node, sizes: Sequence[float]) -> float:
    return sizes[0] - (sizes[1] if math.isfinite(sizes[1]) else 0.0)


def chosen(node: Node, sizes: Sequence[float]) -> float:
    options = list(zip(node.inputs, sizes))[-2:]
    return max([size for x, size in options if x.op.name != "literal"] or [size for _, size in options])


def unit(node: Node, sizes: Sequence[float]) -> float:
    return 0.0


def as_node(x) -> Node:
    """A node, or a Python number as a literal."""
    if isinstance(x, Node):
        return x
    if isinstance(x, bool) or not isinstance(x, (int, float)):
        try:
            x = float(x)
        except (TypeError, ValueError):
            raise GraphError(f"{x!r} is neither a graph value nor a number; wrap arrays with constant()") from None
    return apply("literal", value=x)


def apply(name: str, /, *inputs, **attrs) -> Node:
    """Make (or find) the node of op `name`. Numbers become literals, typed like their neighbours. Raises GraphError."""
    row = OPS[name]
    like_int = all(is_int(x.vtype) for x in inputs if isinstance(x, Node)) and any(isinstance(x, Node) for x in inputs)
    nodes = tuple(as_node(float(x) if isinstance(x, int) and not like_int else x) for x in inputs)
    if len(nodes) != len(row.params):
        raise GraphError(f"{name} takes {len(row.params)} inputs ({' '.join(row.params)}), got {len(nodes)}")
    vtype, extent = row.infer(name, nodes, attrs)
    return intern(row, nodes, attrs, vtype, extent)


def _operators() -> None:
    def binary(name):
        return lambda a, b: apply(name, a, b)

    def swapped(name):
        return lambda a, b: apply(name, b, a)

    for method, name in (("add", "add"), ("sub", "sub"), ("mul", "mul"), ("truediv", "div")):
        setattr(Node, f"__{method}__", binary(name))
        setattr(Node, f"__r{method}__", swapped(name))
    for method, name in (("lt", "less"), ("le", "less_equal"), ("gt", "greater"), ("ge", "greater_equal")):
        setattr(Node, f"__{method}__", binary(name))
    Node.__neg__ = lambda a: apply("neg", a)

    def channel(names):
        return property(lambda a: apply("swizzle", a, channels=names))

    for names in ("x", "y", "z", "w", "xy", "xz", "yz", "zw", "xyz", "xyw"):
        setattr(Node, names, channel(names))


_operators()
