"""Images whose gradient is the same over blocks of texels: a phase that optimizes one keeps its moments once a block.

In: the plans of a phase (a `Group`). Out: the same with `Lists`: the moments of such an image are replaced by copies of which each entry
is a block's, and what is computed of gradient and moments alone is computed once a block; the image itself is updated texel by texel, as
ever. `enter` fills list and copies from the states, `leave` puts the copies back.

Which texels are alike follows from where the image is read (`Op.blocked`). Whoever set moments, or another phase, may have told them
apart: such texels are blocks of their own. So what comes out is what updating every texel gives, bit for bit.
"""
from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

from ..graph.ir import UNIT, Node, intern, is_int, rebuild, remade, topological
from ..graph.ops.compact import compact
from ..graph.optable import OWN, apply
from ..graph.program import Program
from .columns import fewest
from .groups import Group, Lists, on_copies
from .lists import MAX_TEXELS
from .simplify import simplify
from .specialize import dependence

TOLD = "every texel is updated, with moments kept once for texels that are always moved alike"


class _Apart(Exception):
    """Why every texel has moments of its own."""


def find_blocks(group: Group, program: Program, rows: int, least: int) -> Group:
    """The plans of a group with moments by blocks, for images of at least so many texels, in images of at most so many rows."""
    phases = [k for k, spec in enumerate(group.specs) if spec.updates]
    if len(phases) != 1:
        return group
    for gradient in [n for n in topological(group.roots[phases[0]]) if n.op.blocked and n.op.blocked(n)]:
        if not least <= gradient.extent.width * gradient.extent.height <= MAX_TEXELS:
            continue
        try:
            body = _Body(group, program, phases[0], gradient)
        except _Apart:
            continue
        name = group.specs[phases[0]].name
        told = {**group.told.get(name, {}), **dict.fromkeys(body.names, TOLD)}
        group = replace(body.grouped(rows), told={**group.told, name: told})
    return group


def late(group: Group) -> Group:
    """The plans of a group with what was kept whole for `find_blocks` in parts."""
    roots = [root for roots in group.roots for root in roots]

    def rewrite(n: Node, inputs: tuple[Node, ...]) -> Node:
        made = remade(n, inputs)
        return n.op.late(made) if n.op.late else made

    new = rebuild(roots, rewrite)
    if all(new[n] is n for n in new):
        return group
    return replace(group, roots=tuple(tuple(simplify([new[root] for root in roots])) for roots in group.roots))


class _Body:
    """What a phase does between a gradient and the states of its extent: `same`, what is alike over blocks. Raises _Apart where the
    moments are not."""

    def __init__(self, group: Group, program: Program, phase: int, gradient: Node):
        self.group, self.phase, self.gradient = group, phase, gradient
        self.spec, self.roots = group.specs[phase], group.roots[phase]
        taken = {copy.attrs["name"] for x in group.lists for copy in x.copies.values()}
        states = {name: program.values[name].node for name in self.spec.updates if name not in taken}
        targets = dict(zip(self.spec.updates, self.roots))
        dirty = {n for n, names in dependence(self.roots).items() if names & self.spec.dynamic}
        if any(x in dirty for x in gradient.op.blocked(gradient).at):
            raise _Apart
        self.order = topological(self.roots)
        self.moments = {name: node for name, node in states.items() if node.extent == gradient.extent and not is_int(node.vtype)
                        and not self._elsewhere({node})}
        self.uniform = self._spread(set(), set())
        while True:  # of the states, those that are made of themselves and the gradient alone
            self.same = self._spread({gradient, *self.moments.values()}, self.uniform)
            if not (others := [name for name in self.moments if targets[name] not in self.same]):
                break
            for name in others:
                del self.moments[name]
        if not self.moments or self._elsewhere(self.same, {targets[name] for name in self.moments}):
            raise _Apart
        self.names = [name for name in states if name not in self.moments and gradient in set(topological([targets[name]]))]

    def _texelwise(self, n: Node) -> bool:
        return n.op.stage == "pixel" and n.extent == self.gradient.extent and n.op.loop is None and not n.op.placed(n)

    def _spread(self, known: set[Node], beside: set[Node]) -> set[Node]:
        """What is computed texel by texel of these, and of what is the same everywhere; with none known, what is that itself."""
        found = set(known)
        for n in self.order:
            own = [x for k, x in enumerate(n.inputs) if x.extent != UNIT]
            if self._texelwise(n) and n not in beside and all(n.op.read(k) == OWN for k in range(len(n.inputs))) \
                    and all(x in found or x in beside for x in own) and (not beside or any(x in found for x in own)):
                found.add(n)
        return found

    def _elsewhere(self, nodes: set[Node], but: Collection[Node] = ()) -> bool:
        """Whether something but what is computed texel by texel reads these, or a plan gives them out, but for some roots."""
        return any(root in nodes and root not in but for root in self.roots) or any(
            x in nodes and (n.op.read(k) != OWN or n.op.stage != "pixel" or n.extent != self.gradient.extent)
            for n in self.order if n is not self.gradient for k, x in enumerate(n.inputs))

    def grouped(self, rows: int) -> Group:
        """The group with the list."""
        group, extent, how = self.group, self.gradient.extent, self.gradient.op.blocked(self.gradient)
        number = len(group.lists) + 1
        name = f"{group.name}.list{number if number > 1 else ''}"
        first, alone = how.first(how.levels()), None
        for s in self.moments.values():
            flag = apply("differs", s, apply("lookup", s, first))
            alone = flag if alone is None else apply("bit_or", alone, flag)
        levels = how.levels(alone)
        found = compact(how.heads(levels), 1, fewest(extent.width * extent.height, rows))
        listed = found.entries.extent
        enter: dict[Node, Node] = {}

        def keep(n: Node) -> Node:
            leaf = apply("cached", name=f"{name}.{len(enter)}", vtype=n.vtype, extent=n.extent)
            enter[leaf] = n
            return leaf

        copies = {}
        for key, s in self.moments.items():
            copies[key] = intern(s.op, (), {**s.attrs, "name": f"{name}.{key}", "extent": listed}, s.vtype, listed)
            enter[copies[key]] = apply("lookup", s, found.entries)
        total, put = keep(found.total), keep(apply("lookup", found.slots, how.first(levels)) + 1)
        part = put - 1  # `put` is from 1 on, which says that all are given back
        near, coarse = map(keep, how.places(found.entries))
        inside = {self.gradient: how.gradient(near, coarse), **{s: copies[key] for key, s in self.moments.items()}}

        def of_block(n: Node) -> Node:
            """What is alike, over the list."""
            if n not in inside:
                inside[n] = intern(n.op, tuple(of_block(x) if x in self.same or x in self.uniform else x for x in n.inputs),
                                   {k: listed if x == extent else x for k, x in n.attrs.items()}, n.vtype, listed)
            return inside[n]

        def rewrite(n: Node, inputs: tuple[Node, ...]) -> Node:
            return intern(n.op, tuple(apply("lookup", of_block(x), part) if x in self.same and n not in self.same else y
                                      for x, y in zip(n.inputs, inputs)), n.attrs, n.vtype, n.extent)

        names = list(self.spec.updates)
        new = rebuild(self.roots, rewrite)
        roots = tuple(of_block(root) if name in self.moments else new[root]
                      for root, name in zip(self.roots, names + [""] * (len(self.roots) - len(names))))
        leave = {key: apply("select", put, apply("lookup", c, part), 0.0) for key, c in copies.items()}
        made = Lists(number, listed, copies, enter, leave, total)
        rooted = tuple(roots if k == self.phase else x for k, x in enumerate(group.roots))
        return replace(group, specs=on_copies(group.specs, copies), roots=rooted, lists=(*group.lists, made))
