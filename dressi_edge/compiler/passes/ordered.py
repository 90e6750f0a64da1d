"""Pixels of a view that are kept: only those that sample a texture, in the order in which its gradient sums them.

In: the plans of a phase that sees one view a step of a shape at rest (`Program.turned`). Out: the same, with what is computed pixel by
pixel between the texture and its gradient over the list of those pixels. What a pixel takes from its view then lies in lists, too, of
which as much is kept as there are entries, and a texel's pixels are neighbours. Where a pixel lies is had of its number, and that it
samples is known, so that neither takes memory. The values and the order of the sums are the same.
"""
from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from ...cache.profile import Profile
from ..graph.facts import InOrder
from ..graph.ir import UNIT, Extent, Node, intern, is_int, rebuild, remade, topological
from ..graph.optable import OWN, TILE, apply, as_node
from ..graph.program import Program
from .constants import constant_value
from .groups import Group
from .lists import list_extent, rows_of
from .specialize import dependence


class _Elsewhere(Exception):
    """A value is worked out of more than its own pixel."""


def in_order(group: Group, program: Program, profile: Profile) -> Group:
    """The plans of a group; of one that does not see a view at a time, or where pixels are not listed, as they were."""
    if group.name not in program.turned:
        return group
    dynamic = frozenset().union(*(spec.dynamic for spec in group.specs))
    return replace(group, roots=tuple(_reordered(roots, dynamic, rows_of(profile)) for roots in group.roots))


def _reordered(roots: tuple[Node, ...], dynamic: frozenset[str], rows: int) -> tuple[Node, ...]:
    names = dependence(roots)
    new: dict[Node, Node] = {}
    long: dict[Extent, Extent] = {}  # lists in one column where a profile has the rows: as much is kept as there is, not whole columns
    for n in topological(roots):
        how = n.op.ordered(n) if n.op.ordered else None
        if how is not None:
            there = _There(how, n.inputs[0].extent, names, dynamic)
            try:
                new[n] = how.total(there.value(n.inputs[0]), there.value)
                e = how.pixels.extent
                long[e] = replace(list_extent(e.width * e.height, rows), partial=e.partial)
            except _Elsewhere:
                pass
    if not new:
        return roots
    made = rebuild(roots, lambda n, inputs: new[n] if n in new else remade(n, inputs))

    def laid(n: Node, inputs: tuple[Node, ...]) -> Node:
        attrs = {k: long.get(x, x) if isinstance(x, Extent) else x for k, x in n.attrs.items()}
        return intern(n.op, inputs, attrs, n.vtype, long.get(n.extent, n.extent))

    placed = rebuild([made[root] for root in roots], laid)
    return tuple(placed[made[root]] for root in roots)


class _There:
    """Values of an image of `extent` at the listed pixels, over the list's extent: looked up, or worked out there if they change."""

    def __init__(self, how: InOrder, extent: Extent, names: Mapping[Node, frozenset[str]], dynamic: frozenset[str]):
        self.pixels, self.flag, self.extent, self.names, self.dynamic = how.pixels, how.flag, extent, names, dynamic
        self._made: dict[Node, Node] = {}
        self._placed: dict[Node, Node | None] = {}

    def value(self, n: Node) -> Node:
        """Raises _Elsewhere."""
        if n.extent == UNIT or n.op.stage == "inline":
            return n
        if n.extent != self.extent:
            raise _Elsewhere
        if n not in self._made:
            self._made[n] = self._worked_out(n) if self.names[n] & self.dynamic else self._looked_up(n)
        return self._made[n]

    def _looked_up(self, n: Node) -> Node:
        known = constant_value(n, {})
        if known is not None and len(set(known.tolist())) == 1 and n.vtype in ("float", "int"):
            return apply("broadcast", as_node(known.tolist()[0]), extent=self.pixels.extent)
        placed = self._of_place(n)
        return apply("lookup", n, self.pixels) if placed is None else placed

    def _inside(self, tiles: Node) -> bool:
        """Whether all listed pixels are in these tiles: elsewhere something is such that none is listed."""
        if tiles.op.covers is None:
            return False
        k, none = tiles.op.covers
        flag = constant_value(self.flag, {tiles.inputs[k]: np.array([none])})
        return flag is not None and not flag.any()

    def _of_place(self, n: Node) -> Node | None:
        """A value that depends on nothing but where its pixel lies, from the pixel's number; None for another."""
        if n.extent == UNIT or n.op.stage == "inline":
            return n
        if n not in self._placed:
            made = None
            if n.op.numbered:
                made = n.op.numbered(n, apply("kept", self.pixels))
            elif n.extent == self.extent and n.op.stage == "pixel" and n.inputs and not self.names.get(n, True):
                made = self._over(n, self._of_place)
            self._placed[n] = made
        return self._placed[n]

    def _over(self, n: Node, of: Callable[[Node], Node | None]) -> Node | None:
        """A node that works pixel by pixel on what its inputs are `of` there; None where it does more, or one of them is None."""
        if n.op.loop is not None or n.op.placed(n) or any(n.op.read(k) != OWN for k in range(len(n.inputs))):
            return None
        inputs = [of(x) for x in n.inputs]
        if any(x is None for x in inputs):
            return None
        attrs = {k: self.pixels.extent if x == self.extent else x for k, x in n.attrs.items()}
        return intern(n.op, tuple(inputs), attrs, n.vtype, self.pixels.extent)

    def _worked_out(self, n: Node) -> Node:
        modes = [n.op.read(k) for k in range(len(n.inputs))]
        if n.op.stage != "pixel" or n.op.loop is not None or n.op.placed(n):
            raise _Elsewhere
        if modes == [OWN, TILE] and self._inside(n.inputs[1]):
            return self.value(n.inputs[0])
        if modes == [OWN, TILE]:  # a value inside of tiles, nothing outside
            ones = apply("broadcast", as_node(1), extent=self.extent)
            inside = intern(n.op, (ones, n.inputs[1]), n.attrs, ones.vtype, self.extent)
            if self.names[n.inputs[1]] & self.dynamic:
                raise _Elsewhere
            return apply("select", self._looked_up(inside), self.value(n.inputs[0]), 0 if is_int(n.vtype) else 0.0)
        inputs = []
        for x, mode in zip(n.inputs, modes):
            if mode == OWN:
                flagged = x is self.flag and any(w.flag and w.input == len(inputs) for w in n.op.when)
                inputs.append(apply("broadcast", as_node(1), extent=self.pixels.extent) if flagged else self.value(x))
            elif mode == TILE:
                raise _Elsewhere
            else:
                inputs.append(x)
        attrs = {k: self.pixels.extent if x == self.extent else x for k, x in n.attrs.items()}
        return intern(n.op, tuple(inputs), attrs, n.vtype, self.pixels.extent)
