"""The graph: frozen, hash-consed nodes over 2D images.

In: an op of the table (`optable.OPS`), input nodes and attributes. Out: a `Node`; equal arguments give the very same node,
so duplicates never exist. A node has a value type (`float`, `vec2..4`, `int`, `ivec2..4`) and an `Extent`. 1 x 1 broadcasts.
"""
from __future__ import annotations

import hashlib
import math
import weakref
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from operator import is_

import numpy as np

from ...cache.errors import GraphError
from ...cache.layout import CHANNELS, is_int, table_size

__all__ = ["CHANNELS", "Data", "Extent", "Node", "UNIT", "image", "intern", "is_int", "rebuild", "remade", "table", "topological",
           "vector_type"]


def vector_type(channels: int, integer: bool = False) -> str:
    """The value type of 1 to 4 channels."""
    if not 1 <= channels <= 4:
        raise GraphError(f"a value has {channels} channels; 1 to 4 are allowed")
    scalar, vector = ("int", "ivec") if integer else ("float", "vec")
    return scalar if channels == 1 else f"{vector}{channels}"


@dataclass(frozen=True)
class Extent:
    """Size of an image; texels from `count` on (row-major) are padding. partial: the number of a list (`ops/compact.py`) that
    fills the first texels, how many is known on the device alone; 0: of none."""

    width: int
    height: int
    count: int
    partial: int = 0

    @property
    def column(self) -> int:
        """Entries lie in columns of this width, in a column row by row. Lists have narrow ones, so that what a device draws at once
        are neighbours in number; everything else has one."""
        return COLUMN if self.partial and self.width % COLUMN == 0 else self.width

    def __str__(self) -> str:
        full = self.width * self.height
        return f"{self.width}x{self.height}" + ("" if self.count == full else f"[{self.count}]")


UNIT = Extent(1, 1, 1)
COLUMN = 64  # texels; a tile of many devices, lavapipe's among them


def image(width: int, height: int) -> Extent:
    """The extent of an image without padding."""
    if width < 1 or height < 1:
        raise GraphError(f"an image of {width} x {height} is empty; at least 1 x 1 is needed")
    return Extent(width, height, width * height)


def table(count: int) -> Extent:
    """The extent that holds `count` entries; see `cache.layout.table_size`."""
    if count < 1:
        raise GraphError("a table of no entries; at least one is needed")
    return Extent(*table_size(count), count)


class Data:
    """Constant numbers of a node, (height, width, channels), compared by content."""

    __slots__ = ("array", "digest")

    def __init__(self, array: np.ndarray):
        self.array = np.ascontiguousarray(array)
        self.array.flags.writeable = False
        self.digest = hashlib.sha256(str((self.array.dtype.str, self.array.shape)).encode() + self.array.tobytes()).digest()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Data) and self.digest == other.digest

    def __hash__(self) -> int:
        return hash(self.digest)

    def __repr__(self) -> str:
        return f"data{self.array.shape}"


def _refused(what: str, instead: str):
    def refuse(self, *_):
        raise GraphError(f"{self!r} {what}: it is a graph value, known on the device alone; {instead}")
    return refuse


class Node:
    """One value of the graph. Never made directly: `optable.apply` does.

    Nodes are told apart by identity, and hash by it: equal arguments give the very same node. What Python would ask of a value that is
    not there yet (truth, equality, length, items, a number) raises GraphError and says what to write instead."""

    __slots__ = ("op", "inputs", "attrs", "vtype", "extent", "serial", "__weakref__")
    __array_ufunc__ = None  # NumPy's numbers leave arithmetic with nodes to the node

    __bool__ = _refused("has no truth", "use select(condition, a, b), & and | for if, and and or, maximum and minimum for max and min")
    __len__ = _refused("has no length", "its extent.count says how many entries there are, channels how many numbers each")
    __iter__ = _refused("cannot be run through", "channels(node) gives its channels, slice_table(node, start, count) entries of a table")
    __contains__ = _refused("contains nothing that Python can see", "use equal(node, value)")
    __array__ = _refused("is no array", "get() of a session, or evaluate() of the reference, gives its numbers")
    __float__ = __int__ = __index__ = _refused("is no number", "to_float and to_int convert it on the device")
    __hash__ = object.__hash__

    def __eq__(self, other: object) -> bool:
        if self is other:
            return True
        if isinstance(other, Node | int | float | np.generic | np.ndarray):
            raise GraphError(f"{self!r} == {other!r:.60}: a graph value is known on the device alone; equal(a, b) is 1 where they are "
                             "equal, `a is b` tells whether they are one node")
        return NotImplemented

    def __init__(self, op, inputs: tuple[Node, ...], attrs: dict, vtype: str, extent: Extent, serial: int):
        self.op, self.inputs, self.attrs, self.vtype, self.extent, self.serial = op, inputs, attrs, vtype, extent, serial

    @property
    def channels(self) -> int:
        """How many numbers a texel has, 1 to 4."""
        return CHANNELS[self.vtype]

    @property
    def half(self) -> int | None:
        """Where its image has 16 bits a channel, the power of two by which the numbers in it are larger; None: 32 bits."""
        return self.attrs.get("half")

    @property
    def name(self) -> str:
        """The user's name of a leaf, or the op with a serial number."""
        return self.attrs.get("name") or f"{self.op.name}{self.serial}"

    def __repr__(self) -> str:
        return f"{self.name}: {self.vtype} {self.extent}"


_interned: weakref.WeakValueDictionary = weakref.WeakValueDictionary()
_serial = 0


def _exact(value):
    """An attribute as a key: 0.0 and -0.0 are two."""
    if isinstance(value, tuple):
        return tuple(map(_exact, value))
    return (value, math.copysign(1.0, value)) if isinstance(value, float) else value


def intern(op, inputs: tuple[Node, ...], attrs: dict, vtype: str, extent: Extent) -> Node:
    """The one node with these fields."""
    global _serial
    known = tuple((k, _exact(attrs[k])) for k in sorted(attrs)) if attrs else ()
    key = (id(op), tuple(map(id, inputs)), known, vtype, extent.width, extent.height, extent.count, extent.partial)
    node = _interned.get(key)
    if node is None:
        _serial += 1
        node = _interned[key] = Node(op, inputs, attrs, vtype, extent, _serial)
    return node


def remade(node: Node, inputs: tuple[Node, ...]) -> Node:
    """The one node that is this one of other inputs: itself, where they are the same."""
    return node if all(map(is_, inputs, node.inputs)) else intern(node.op, inputs, node.attrs, node.vtype, node.extent)


def topological(roots: Iterable[Node], within: Collection[Node] | None = None) -> list[Node]:
    """Every node that the roots need (of those `within`, if given), inputs before users; the order depends on the graph alone."""
    order: list[Node] = []
    seen: set[Node] = set()
    for root in roots:
        if root in seen:
            continue
        seen.add(root)
        nodes, rests = [root], [iter(root.inputs)]  # the way down to where we are, and what is left of each node's inputs
        while nodes:
            for x in rests[-1]:
                if x not in seen and (within is None or x in within):
                    seen.add(x)
                    if x.inputs:
                        nodes.append(x)
                        rests.append(iter(x.inputs))
                        break
                    order.append(x)
            else:
                order.append(nodes.pop())
                rests.pop()
    return order


def rebuild(roots: Iterable[Node], rewrite) -> dict[Node, Node]:
    """Map every node through `rewrite(node, new_inputs) -> Node`, inputs first."""
    new: dict[Node, Node] = {}
    for node in topological(roots):
        new[node] = rewrite(node, tuple(new[x] for x in node.inputs))
    return new
