"""The op table: everything a pass may know about an op, in one row.

`op(...)` adds a row, `apply(name, *inputs, **attrs)` makes a node. Passes read facts (reads, stage, cost, loop), never names.

A snippet is GLSL with these marks: `{y}` the result, `{name}` an input (its own texel's value, or for inputs that are read
elsewhere two functions: `{name}(ivec2)` the texel, `{name_at}(index)` the entry in row-major order), `{name_w} {name_h}
{name_n}` an input's width, height, count, `{w} {h} {n}` the result's, `{type}` the result's GLSL type, `{attr}` any attribute,
`{i}` the own texel's row-major index and `{p}` its ivec2, `{snap}` the grid of corners in pixels. A snippet may be a function of the
node where types decide.

An input read by tile is a coarser image, one texel for each `attrs["tile"]` = (width, height) texels of the result: where it is zero
the op must not matter (`Op.when`), and whole tiles are left undrawn. An input read by count only says how much is drawn: it is that of a
raster op's `Draw.count`, or the number of a list's entries (`ops/compact.py`).
"""
from __future__ import annotations

import inspect
import math
import re
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from difflib import get_close_matches

import numpy as np

from ...cache.errors import GraphError
from .ir import UNIT, Data, Extent, Node, image, intern, is_int, vector_type

OWN, TEXEL, FILTERED, VERTEX, TILE, COUNT = "own", "texel", "filtered", "vertex", "tile", "count"


@dataclass(frozen=True)
class Loop:
    """A snippet that loops: ops whose headers come out equal share one loop. The result starts at zero; `body` adds to it. holds: of how
    many 32-bit numbers the header's variables are where most of them are needed, beside inputs at the own texel; 0 for a few. lean: a
    header for few registers, which fetches in each turn what `header` keeps over all of them, and how many numbers that are."""

    header: str
    body: str
    close: str = "}"
    holds: int = 0
    lean: tuple[str, int] = ("", 0)


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
class Kernel:
    """A compute shader that makes one image, of an op of stage "kernel".

    body: GLSL as in snippets, of which each invocation runs all; it knows `lane_`, its number in the workgroup, and `group_`, that of the
    workgroup. It writes entries in row-major order, padding among them ({whole} in all): {store}(i, value), or, where all are `clear` at
    first, {add}(i, value), atomically and of type int. shared: declarations of what a workgroup shares, of so many bytes (`room`). What
    atomic sums give back nothing may use, for it depends on who came first: a reader of bundles refuses it. lanes: invocations of a
    workgroup. groups(node): how many workgroups; a few more may run."""

    body: str
    shared: str
    lanes: int
    room: int
    groups: Callable
    clear: int | None = None


ZERO, NEGATIVE, EMPTY = "zero", "negative", "empty"


@dataclass(frozen=True)
class When:
    """What one input's value makes of the result: where input `input` is `what`, the result is `result` in every channel, whatever the
    other inputs are. what: "zero" in every channel, "negative", or "empty": a range (begin, end) that holds nothing. flag: that is what
    the input is there for, so that passes may leave texels undrawn by it (`passes/domains.py`)."""

    input: int
    what: str
    result: int = 0
    flag: bool = False


def zero(*inputs: int) -> tuple[When, ...]:
    """Each of these inputs makes the result zero where it is zero."""
    return tuple(When(k, ZERO) for k in inputs)


def flag(k: int, result: int = 0) -> tuple[When, ...]:
    """Where input k is zero there is nothing to do, and the result is this."""
    return (When(k, ZERO, result, flag=True),)


def negative(k: int) -> tuple[When, ...]:
    """Input k makes the result zero where it is negative."""
    return (When(k, NEGATIVE),)


def empty(k: int) -> tuple[When, ...]:
    """Input k is a range that makes the result zero where it holds nothing."""
    return (When(k, EMPTY),)


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
    attrs: tuple[str, ...] = ()  # attributes that must be given
    optional: tuple[str, ...] = ()  # and that may be
    stage: str = "pixel"
    loop: Loop | None = None
    draws: tuple[Draw, ...] = ()
    clear: int = -1  # of a raster op: where nothing is drawn
    cost: int = 1
    functions: str = ""
    when: tuple[When, ...] = ()  # what single inputs make of the result
    chooses: bool = False  # the result is input 1 where input 0 is not zero, else input 2
    part: bool = False  # the result is some channels of its only input
    alone: bool = False  # shares a shader with few other such ones: drivers take minutes to compile many, as of sorts
    keeps: bool = False  # where it rests it is in an image of its own, from which what is cheap is computed again
    held: bool = False  # a leaf that the session holds by name: an input or a state
    listed: Callable | None = None  # of a node: `Listed`
    still: Callable | None = None  # of a node whose inputs rest but those of its extent's images: passes/still.py
    ordered: Callable | None = None  # of a node: `InOrder`, or None
    numbered: Callable | None = None  # (node, numbers of texels) -> its values there, where these depend on nothing else
    blocked: Callable | None = None  # of a node: how its texels are alike in blocks, `ops.mip_blocks.Blocks`, or None: passes/blocks.py
    late: Callable | None = None  # of a node: what it is made of, once passes/blocks.py has seen it
    dense: str = ""  # why of a texture that it samples, input 0, there can be no list
    banded: Callable | None = None  # values, index, boxes, bins, bands= -> the sums over boxes, of so many bands of rows side by side
    sums: tuple[int, ...] = ()  # inputs of which many texels only add up: each may be rounded (compiler/passes/store.py)
    named: tuple[int, int, int] | None = None  # (input, other, none): that input's texels are of use only where the other's are not none
    regroups: bool = False  # the result names what its only input does, at other texels
    covers: tuple[int, int] | None = None  # (input, none): where a texel of the result is 0 all that it stands for are none
    alike: tuple[tuple[int, int], ...] = ()  # (input, other): read at places of the other, so of its extent; 1 x 1 is broadcast to it
    lower: Callable | None = None  # of a composite: inputs, attributes, room= bytes that workgroups share or None -> what it is made of
    kernel: Kernel | Callable | None = None  # of stage "kernel": a `Kernel`, or what makes one of the node
    size: Callable | None = None  # (node, sizes of its inputs) -> log2 of its usual magnitude; None: that of the largest float
    sample: Callable | None = field(default=None, compare=False)
    doc: str = ""

    def read(self, k: int) -> str:
        """How input k is read."""
        return self.reads[k] if k < len(self.reads) else OWN

    def placed(self, node: Node) -> bool:
        """Whether a texel of a node of this op depends on where it lies, not on what is read alone."""
        text = self.glsl(node) if callable(self.glsl) else self.glsl
        return any(mark in text for mark in ("{p}", "{i}", "{snap}"))

    def kernel_of(self, node: Node) -> Kernel:
        """The kernel of a node of this op."""
        return self.kernel if isinstance(self.kernel, Kernel) else self.kernel(node)

    def __call__(self, *inputs, **attrs) -> Node:
        """The node of this op: `apply`."""
        return apply(self.name, *inputs, **attrs)

    def __hash__(self) -> int:
        return hash(self.name)


OPS: dict[str, Op] = {}
MODES = (OWN, TEXEL, FILTERED, VERTEX, TILE, COUNT)
_MARK = re.compile(r"\{(\w+)\}")


def op(name: str, params: str | None = None, *, infer: Callable | None = None, ref: Callable | None = None, vjp: Callable | None = None,
       reads: str = "", attrs: str | None = None, **facts) -> Op:
    """Add a row to the table; what it returns makes nodes: `fade = op("fade", ...)`, then `fade(x)`.

    params: the inputs' names, in words; by default those of the reference's positional parameters. infer(name, inputs, attrs) -> (type,
    extent), by default `elementwise`. ref: NumPy, arrays (height, width, channels) in and out, attributes by keyword. vjp(g, y, *inputs,
    **attrs) -> a gradient for each input, or None; with no vjp a gradient through the op is refused. glsl: the snippet, see the module's
    text. reads: how each input is read, in words, by default at the own texel. attrs: attributes in words, those that may be left out end
    in "?"; by default the reference's other parameters. The other facts are fields of `Op`. `compiler.check_op` tests a row. Raises
    GraphError where a word is not known."""
    if name in OPS:
        raise GraphError(f"op {name} is declared twice")
    if not re.fullmatch(r"[A-Za-z]\w*", name):
        raise GraphError(f"op {name!r:.60}: a name is made of letters, digits and _")
    if unknown := [key for key in facts if key not in Op.__dataclass_fields__]:
        raise GraphError(f"op {name}: {unknown[0]} is no fact{nearest(unknown[0], Op.__dataclass_fields__)}")
    words = tuple(params.split()) if params is not None else _positional(name, ref)
    modes = tuple(reads.split()) or (OWN,) * len(words)
    if len(modes) != len(words) or not set(modes) <= set(MODES):
        raise GraphError(f"op {name}: reads {' '.join(modes)!r} of inputs {' '.join(words)!r}; one of {' '.join(MODES)} for each is needed")
    must, may = _attributes(words, ref) if attrs is None else _split_words(attrs)
    row = Op(name, words, infer or elementwise, ref, vjp, reads=modes, attrs=must, optional=may, **facts)
    if isinstance(row.glsl, str):
        known = {*"y w h n type i p snap".split(), *must, *may, *(p + end for p in words for end in ("", "_at", "_w", "_h", "_n"))}
        if unknown := [mark for mark in _MARK.findall(row.glsl) if mark not in known]:
            raise GraphError(f"op {name}: {{{unknown[0]}}} in its GLSL is neither an input nor an attribute nor a mark"
                             + nearest(unknown[0], known))
    OPS[name] = row
    return row


def nearest(word: str, known: Iterable[str]) -> str:
    """Ends a sentence about a word that is not known with the one that was likely meant, if there is one."""
    found = get_close_matches(str(word), list(known), 1)
    return f"; did you mean {found[0]}?" if found else ""


def _parameters(ref: Callable | None) -> list[inspect.Parameter]:
    return [] if ref is None or isinstance(ref, np.ufunc) else list(inspect.signature(ref).parameters.values())


def _positional(name: str, ref: Callable | None) -> tuple[str, ...]:
    found = tuple(p.name for p in _parameters(ref) if p.kind is p.POSITIONAL_OR_KEYWORD and p.default is p.empty)
    if not found:
        raise GraphError(f"op {name}: its inputs are not named; give params, or a reference whose parameters are the inputs")
    return found


def _attributes(params: tuple[str, ...], ref: Callable | None) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """What the reference takes beside the inputs: without and with a default."""
    own = [p for p in _parameters(ref) if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)]
    positional = [p for p in own if p.kind is p.POSITIONAL_OR_KEYWORD]
    own = [p for p in own if p not in positional[:len(params)]]
    return tuple(p.name for p in own if p.default is p.empty), tuple(p.name for p in own if p.default is not p.empty)


def _split_words(attrs: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    words = attrs.split()
    return tuple(w for w in words if w[-1] != "?"), tuple(w[:-1] for w in words if w[-1] == "?")


def common_extent(name: str, inputs: tuple[Node, ...]) -> Extent:
    """The extent of inputs that are equal or 1 x 1."""
    extent = UNIT
    for found in (x.extent for x in inputs if x.extent != UNIT):
        if extent not in (UNIT, found):
            raise GraphError(f"{name}: extents {extent} and {found} differ; equal ones or 1x1 are allowed: {', '.join(map(repr, inputs))}")
        extent = found
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


def floats(name: str, inputs: tuple[Node, ...], attrs: dict) -> tuple[str, Extent]:
    """`elementwise`, of floats alone."""
    for x in inputs:
        if is_int(x.vtype):
            raise GraphError(f"{name}: {x!r} is an integer; convert it with to_float")
    return elementwise(name, inputs, attrs)


def integers(name: str, inputs: tuple[Node, ...], attrs: dict) -> tuple[str, Extent]:
    """`elementwise`, of integers alone."""
    for x in inputs:
        if not is_int(x.vtype):
            raise GraphError(f"{name}: {x!r} is no integer; convert it with to_int, or use a comparison")
    return elementwise(name, inputs, attrs)


def typed(vtype: str) -> Callable:
    """Inference of an op whose result has this type over the inputs' extent."""
    return lambda name, inputs, attrs: (vtype, common_extent(name, inputs))


def at(*positions: int, vtype: str | None = None) -> Callable:
    """Inference: the extent of the inputs at these positions; the type given, or that of input 0."""
    return lambda name, inputs, attrs: (vtype or inputs[0].vtype, common_extent(name, tuple(inputs[k] for k in positions)))


# Sizes (`Op.size`) of results: of products and quotients, of choices, of which a literal is the guard and not the rule, of what is
# of order 1 whatever it is made of.

def product(node: Node, sizes: Sequence[float]) -> float:
    """log2 of the size of a product."""
    return sizes[0] + sizes[-1]


def quotient(node: Node, sizes: Sequence[float]) -> float:
    """log2 of the size of a quotient; of one by zero, that of its first input."""
    return sizes[0] - (sizes[1] if math.isfinite(sizes[1]) else 0.0)


def chosen(node: Node, sizes: Sequence[float]) -> float:
    """Of a choice, that of its options, but for literals where there is another."""
    options = list(zip(node.inputs, sizes))[-2:]
    return max([size for x, size in options if x.op.name != "literal"] or [size for _, size in options])


def unit(node: Node, sizes: Sequence[float]) -> float:
    """Of order 1, whatever it is made of."""
    return 0.0


def as_node(x) -> Node:
    """A node, or a Python or NumPy number as a literal. Raises GraphError."""
    if isinstance(x, Node):
        return x
    x = x[()] if isinstance(x, np.ndarray) and x.ndim == 0 else x
    if isinstance(x, int | float | np.number | np.bool_):
        return apply("literal", value=int(x) if isinstance(x, int | np.integer) and not isinstance(x, bool) else float(x))
    raise GraphError(f"{type(x).__name__} {' '.join(repr(x).split()):.60} is neither a graph value nor a number; wrap arrays with "
                     "constant() or constant_table()")


def _number(x, like_int: bool):
    """A whole number beside floats is a float."""
    if like_int or isinstance(x, bool) or not isinstance(x, int | np.integer):
        return x
    try:
        return float(x)
    except OverflowError:
        raise GraphError("a whole number beyond the range of fp32; numbers that are finite in fp32 are allowed") from None


def stored(row: Op, inputs: Sequence[Node]) -> tuple[Node, ...]:
    """The inputs, literals that are read otherwise than at the own texel as 1x1 images: there is no other place to read them from."""
    return tuple(x if x.op.name != "literal" or row.read(k) == OWN else
                 intern(OPS["constant"], (), {"data": Data(x.op.ref(x.attrs["value"])), "vtype": x.vtype, "extent": UNIT}, x.vtype, UNIT)
                 for k, x in enumerate(inputs))


def _placed(row: Op, inputs: tuple[Node, ...]) -> tuple[Node, ...]:
    """The inputs, with those that must lie as another does (`Op.alike`) broadcast to it."""
    inputs = list(inputs)
    for k, other in row.alike:
        x, extent = inputs[k], inputs[other].extent
        if (x.extent.width, x.extent.height) != (extent.width, extent.height):
            if x.extent != UNIT:
                raise GraphError(f"{row.name}: {row.params[k]} {x!r} has another extent than {row.params[other]} {inputs[other]!r}; equal "
                                 "ones or 1x1 are allowed")
            inputs[k] = apply("broadcast", x, extent=extent)
    return tuple(inputs)


def _check_places(row: Op, inputs: tuple[Node, ...], attrs: dict, extent: Extent) -> None:
    """What is read at the own texel must have it, what is read by tile a texel for each tile."""
    for k, x in enumerate(inputs):
        mode = row.read(k)
        if mode == OWN and x.extent not in (UNIT, extent):
            raise GraphError(f"{row.name}: {row.params[k]} {x!r} does not lie as the result, {extent}; that extent or 1x1 is allowed")
        if mode == TILE:
            width, height = attrs["tile"]
            tiles = image(-(-extent.width // width), -(-extent.height // height))
            if x.extent != tiles:
                raise GraphError(f"{row.name}: {row.params[k]} {x!r} is not one texel for each {width} x {height} of the result, "
                                 f"{extent}: {tiles} is needed")


def apply(name: str, /, *inputs, **attrs) -> Node:
    """Make (or find) the node of op `name`. Numbers become literals, typed like their neighbours. Raises GraphError where the op or an
    attribute is not known or missing, and where inputs do not fit in number, type or extent."""
    row = OPS.get(name)
    if row is None:
        raise GraphError(f"there is no op {name!r:.60}{nearest(name, OPS)}")
    like_int = all(is_int(x.vtype) for x in inputs if isinstance(x, Node)) and any(isinstance(x, Node) for x in inputs)
    nodes = tuple(as_node(_number(x, like_int)) for x in inputs)
    if len(nodes) != len(row.params):
        raise GraphError(f"{name} takes {len(row.params)} inputs ({' '.join(row.params)}), got {len(nodes)}")
    for key in attrs:
        if key not in row.attrs and key not in row.optional:
            raise GraphError(f"{name}: {key} is no attribute of it; it has {' '.join(row.attrs + row.optional) or 'none'}"
                             + nearest(key, row.attrs + row.optional))
    if missing := [key for key in row.attrs if key not in attrs]:
        raise GraphError(f"{name}: {' '.join(missing)} must be given")
    nodes = _placed(row, stored(row, nodes))
    vtype, extent = row.infer(name, nodes, attrs)
    _check_places(row, nodes, attrs, extent)
    with suppress(TypeError):  # of what no dictionary takes as a key
        if isinstance(extent, Extent):
            return intern(row, nodes, attrs, vtype, extent)
    raise GraphError(f"{name}: attributes are numbers, words, extents or tuples of them, got "
                     f"{', '.join(f'{k} of type {type(v).__name__}' for k, v in attrs.items())}")
