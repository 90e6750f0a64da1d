"""Images of which few texels are ever touched: the phase that optimizes one works on a list of those.

In: the plans of a phase (a `Group`). Out: the same with `Lists`: the image's states (the parameter, its moments) are replaced by copies
that hold the listed texels alone, and there are two plans more: `enter` fills the list and the copies from the states, `leave` puts the
copies back.

A texel is left out if nothing would ever happen to it: it has no gradient, its moments are zero in every bit, and the update of such a
texel gives the parameter's own bits. So what comes out is what updating every texel gives, bit for bit, whatever was set before.
"""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...cache.layout import table_size
from ...cache.profile import Profile
from ..graph.ir import COLUMN, Extent, Node, intern, is_int, rebuild, remade, topological
from ..graph.ops.compact import compact
from ..graph.optable import EMPTY, OWN, apply
from ..graph.program import PlanSpec, Program
from .constants import constant_value
from .groups import Group, Lists, on_copies
from .simplify import simplify
from .specialize import dependence

MIN_TEXELS = 1 << 17  # below, updating every texel costs less than what the lists do to the start
MAX_ROWS = 16384  # of a list, whatever the profile allows: most devices have them
MAX_TEXELS = 1 << 22  # above, the copies, which have room for every texel, would be more memory than many devices have


class _Dense(Exception):
    """Why every texel is updated."""


def find_lists(group: Group, program: Program, rows: int, least: int) -> Group:
    """The plans of a group on lists, for images of at least so many texels, in images of at most so many rows."""
    specs, rooted = group.specs, list(group.roots)
    lists, told = [], {}
    phases = [k for k, spec in enumerate(specs) if spec.updates]
    for k in phases:
        sampled = [(name, program.values[name].node) for name in specs[k].updates if any(
            n.op.listed and n.inputs[0] is program.values[name].node for n in topological(rooted[k]))]
        whole = {n.inputs[0]: n.op.dense for n in topological(rooted[k]) if n.op.dense}
        told |= {name: f"every texel is updated: {whole[node]}" for name in specs[k].updates
                 if (node := program.values[name].node) in whole}
        for extent in dict.fromkeys(node.extent for _, node in sampled):
            why, texels = "listed", extent.width * extent.height
            try:
                if texels < least:
                    raise _Dense(f"it has {texels}; lists begin at {least}")
                if texels > MAX_TEXELS:
                    raise _Dense(f"it has {texels}; lists end at {MAX_TEXELS}, for they have room for all")
                if texels != extent.count:
                    raise _Dense("it is a table with padding")
                if len(phases) > 1:
                    raise _Dense("several phases share its plans")
                changing = specs[k].dynamic.union((copy.attrs["name"] for x in lists for copy in x.copies.values()),
                                                  {program.turned.get(group.name)} - {None})
                made, rooted = _Body(program, specs[k], rooted[k], changing, extent).lists(rooted, len(lists) + 1, rows)
                lists.append(made)
            except _Dense as reason:
                why = f"every texel is updated: {reason}"
            told |= {name: why for name, node in sampled if node.extent == extent}
    specs = on_copies(specs, {name: copy for x in lists for name, copy in x.copies.items()})
    return replace(group, specs=specs, roots=tuple(map(tuple, rooted)), lists=tuple(lists),
                   told={spec.name: told for spec in specs if spec.updates and told})


def rows_of(profile: Profile) -> int:
    """The most rows of an image that is drawn to."""
    limit = profile.limit
    return min(limit("maxImageDimension2D"), limit("maxFramebufferHeight"), limit("maxViewportDimensions")[1], MAX_ROWS)


def list_extent(entries: int, rows: int) -> Extent:
    """Room for so many: one column if that needs at most so many rows, so that what is near in number is near in memory."""
    width, height = table_size(entries, COLUMN, rows)
    return Extent(width, height, width * height)


class _Body:
    """What a phase does to the texels of one extent: `states` (name -> leaf) and `nodes`, all that is computed texel by texel between
    them and their updates; `samples`, which alone read elsewhere. Raises _Dense where it is not so."""

    def __init__(self, program: Program, spec: PlanSpec, roots: list[Node], dynamic: frozenset[str], extent: Extent):
        self.extent, self.group = extent, spec.group
        self.dirty = {n for n, names in dependence(roots).items() if names & dynamic}
        self.states = {name: program.values[name].node for name in spec.updates if program.values[name].node.extent == extent}
        self.targets = {name: root for name, root in zip(spec.updates, roots) if name in self.states}
        if counters := [name for name, state in self.states.items() if is_int(state.vtype)]:
            raise _Dense(f"{counters[0]} of its size is an integer")
        if any(x in self.dirty for n in topological(roots) if n.op.listed and n.inputs[0] in self.leaves for x in n.inputs[1:]):
            raise _Dense("where it is sampled changes while the phase runs")
        self.nodes = self._between()
        self.samples = self._readers(roots)
        if self.samples is None or (self.nodes | self.leaves) & set(roots[len(spec.updates):]):
            raise _Dense("more reads it than samples do")
        self.order = [n for n in topological(self.targets.values()) if n in self.nodes]
        self.rest = self._at_rest()

    @property
    def leaves(self) -> set[Node]:
        return set(self.states.values())

    def _between(self) -> set[Node]:
        nodes: set[Node] = set()
        stack = list(self.targets.values())
        while stack:
            n = stack.pop()
            if n in self.leaves or n in nodes:
                continue
            if n not in self.dirty or n.op.stage != "pixel" or n.extent != self.extent:
                raise _Dense(f"its update is made of {n.name}")
            nodes.add(n)
            stack += [x for x, mode in _inputs(n) if mode == OWN and x.extent == self.extent and x in self.dirty]
        return nodes

    def _readers(self, roots: Sequence[Node]) -> list[Node] | None:
        """The samples among these plans' nodes; None if anything else reads what changes."""
        changing, samples = self.nodes | self.leaves, []
        for n in topological(roots):
            for k, (x, mode) in enumerate(_inputs(n)):
                if x in changing and not (n in self.nodes and mode == OWN):
                    if x not in self.leaves or k or n.op.listed is None:
                        return None
                    samples.append(n)
        return samples

    def _empty(self) -> list[Node]:
        """The ranges in which a texel without gradient finds nothing."""
        return list(dict.fromkeys(x for n in self.order for x in _ranges(n) if x not in self.dirty))

    def _at_rest(self) -> dict[str, Node]:
        """What each sampled state becomes where there is no gradient and no moment: made of the state alone. Raises _Dense where it may
        be something else later, or moments may become other than zero."""
        sampled, empty = {n.inputs[0] for n in self.samples}, set(self._empty())
        known = {s: np.zeros(s.channels) for s in self.leaves if s not in sampled}
        for n in self.order:
            value = np.zeros(n.channels) if not empty.isdisjoint(_ranges(n)) else constant_value(n, known)
            if value is not None and not value.any():
                known[n] = value
        zero, rest = apply("literal", value=0.0), {}
        for name, target in self.targets.items():
            if self.states[name] in sampled:
                new = rebuild([target], lambda n, inputs: zero if n in known else remade(n, inputs))
                rest[name], = simplify([new[target]])
                if {n for n in topological([rest[name]]) if n.op.stage == "leaf"} != {self.states[name]}:
                    raise _Dense("its update moves texels without gradient")
            elif target not in known:
                raise _Dense("its update moves texels without gradient")
        return rest

    def lists(self, rooted: Sequence[list[Node]], number: int, rows: int) -> tuple[Lists, list[list[Node]]]:
        """The lists, and the roots of all plans that can read them instead of the states."""
        name = f"{self.group}.list{number if number > 1 else ''}"
        flags = [apply("greater", x.y, x.x) for x in self._empty()]
        flags += [apply("differs", s, self.rest.get(key, 0.0)) for key, s in self.states.items()]
        used = flags[0]
        for flag in flags[1:]:
            used = apply("bit_or", used, flag)
        found = compact(used, 1, list_extent(self.extent.width * self.extent.height, rows))
        extent = found.entries.extent
        enter: dict[Node, Node] = {}
        kept: dict[Node, Node] = {}

        def keep(n: Node) -> Node:
            if n not in kept:
                kept[n] = apply("cached", name=f"{name}.{len(kept)}", vtype=n.vtype, extent=n.extent)
                enter[kept[n]] = n
            return kept[n]

        copies = {}
        for key, s in self.states.items():
            copies[key] = intern(s.op, (), {**s.attrs, "name": f"{name}.{key}", "extent": extent}, s.vtype, extent)
            enter[copies[key]] = apply("lookup", s, found.entries)
        copy, samples = {s: copies[key] for key, s in self.states.items()}, set(self.samples)
        total = keep(found.total)
        places = apply("add", found.slots, 1)
        put = keep(places)

        def rewrite(n: Node, inputs: tuple[Node, ...]) -> Node:
            if n in copy:
                return copy[n]
            if n in samples:
                how = n.op.listed(n)
                return how.read(copy[n.inputs[0]], keep(how.find(places)))
            if n not in self.nodes:
                return remade(n, inputs)
            own = tuple(keep(apply("lookup", x, found.entries)) if mode == OWN and x.extent == self.extent and x not in self.dirty else y
                        for (x, mode), y in zip(_inputs(n), inputs))
            return intern(n.op, own, {k: extent if x == self.extent else x for k, x in n.attrs.items()}, n.vtype, extent)

        result = []
        for roots in rooted:
            readers = self._readers(roots)
            if readers is None or not set(readers) <= set(self.samples) or self.leaves & set(roots):
                result.append(roots)
            else:
                new = rebuild(roots, rewrite)
                result.append([new[root] for root in roots])
        back = apply("sub", put, 1)
        leave = {key: apply("select", put, apply("lookup", c, back), 0.0) for key, c in copies.items()}
        return Lists(number, extent, copies, enter, leave, total), result


def _ranges(n: Node) -> list[Node]:
    """Inputs that make the result zero where they hold nothing."""
    return [n.inputs[when.input] for when in n.op.when if when.what == EMPTY and when.result == 0]


def _inputs(n: Node) -> list[tuple[Node, str]]:
    return [(x, n.op.read(k)) for k, x in enumerate(n.inputs)]
