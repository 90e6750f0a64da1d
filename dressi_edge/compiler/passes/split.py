"""A substage that breaks a limit, cut into several that keep it.

In: the nodes of a substage, their outputs, a profile. Out: substages in order; later ones read what earlier ones give.
"""
from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace

from ...cache.errors import PackError
from ...cache.profile import Profile
from ..graph.ir import Node
from ..graph.optable import FILTERED, VERTEX
from .pressure import peak
from .substage import Substage, edges, excess, excess_of, is_alone, substage

SPLIT_COST = 50  # work without loops that each part of a split substage may do again
HARD = 3  # steps of a sort in one shader; of eight LLVM makes nothing in ten minutes
TRIED = 32  # values, before one is stored to relieve a shader; the search is for the best of them
PASS_COST = 100_000  # work over all texels that is worth a pass of its own


def split(nodes: list[Node], outputs: list[Node], profile: Profile) -> list[Substage]:
    """One substage, or several that each keep the limits. Of two ways to keep a bound on registers the one that computes less."""
    whole = substage(nodes, outputs)
    if not excess(whole, profile) and not crowded(nodes, outputs, profile) and not overloaded(nodes):
        return [whole]
    cut = _cut(nodes, outputs, profile)
    if profile.max_live is None or not any(crowded(p.nodes, p.outputs, profile) for p in (whole, *cut)):
        return cut
    return min(cut, _relieved(nodes, outputs, profile), key=lambda parts: (
        any(crowded(p.nodes, p.outputs, profile) for p in parts), sum(_work(p.nodes) for p in parts)))


def _work(nodes: Iterable[Node]) -> int:
    return sum(n.op.cost for n in nodes)


def _cut(nodes: list[Node], outputs: list[Node], profile: Profile) -> list[Substage]:
    """Outputs in order, each with what it needs; later parts read the outputs of earlier ones. What several would compute and costs more
    than a pass is stored before them."""
    before: list[Node] = []
    while True:
        parts = _parts(nodes, list(dict.fromkeys([*before, *outputs])), profile)
        computed = Counter(n for part in parts for n in part.nodes
                           if (n.op.loop or n.op.cost > SPLIT_COST) and n.op.cost * n.extent.count > PASS_COST)
        again = {n for n, times in computed.items() if times > 1}
        if not again:
            return parts
        inner = {x for n in again for x, _ in edges(n)} - {x for n in nodes if n not in again for x, _ in edges(n)}
        before += [n for n in nodes if n in again and n not in inner]


def crowded(nodes: Sequence[Node], outputs: Sequence[Node], profile: Profile, known: dict | None = None) -> bool:
    """Whether a substage holds more numbers at once than the profile's compiler has registers for. No limit: it only costs. known: as
    `peak` has it."""
    return profile.max_live is not None and not is_alone(nodes[0]) and peak(nodes, outputs, known).count > profile.max_live


def overloaded(nodes: Sequence[Node]) -> bool:
    """Whether a substage has more of the functions that are hard on drivers than they compile in a moment."""
    return sum(n.op.alone for n in nodes) > HARD


def _relieved(nodes: list[Node], outputs: list[Node], profile: Profile) -> list[Substage]:
    """Cut as if registers had no end; and before each part that holds too much, parts that store some of what it computes on its way.
    What it needs for these alone it then neither computes nor holds."""
    cones, result = _Cones(nodes, profile), []
    for part in _cut(nodes, outputs, replace(profile, max_live=None)):
        before, stored = list(cones.stored), []
        pending = [n for n in part.outputs if n not in cones.stored]
        while pending and not cones.fit(pending) and (n := cones.middle(pending)) is not None:
            stored.append(n)
            cones.store([n])
        for some, after in ((stored, before), (pending, [*before, *stored])):
            more = _parts(nodes, some, profile, after)
            cones.store([n for p in more for n in p.outputs])
            result += more
    return result


def _parts(nodes: list[Node], outputs: Iterable[Node], profile: Profile, stored: Sequence[Node] = ()) -> list[Substage]:
    """Substages that give these in order, and read what is stored before. A single one that is too wide is cut inside at the widest node
    that fits."""
    result: list[Substage] = []
    cones, pending = _Cones(nodes, profile), list(outputs)
    cones.store(stored)
    while pending:
        taken: list[Node] = []
        while pending and cones.fit([*taken, pending[0]]) and not (taken and overloaded(cones.nodes([*taken, pending[0]]))):
            taken.append(pending.pop(0))
        if not taken and cones.keeps([pending[0]]):  # crowded, and no output less to give
            taken = cones.relief(pending[0])
            if taken[0] is pending[0] and (n := cones.middle(taken)) is not None:
                taken = [n]
            given = set(taken)  # which tells nodes apart by what they are; a list would ask whether they are equal
            pending = [n for n in pending if n not in given]
        if taken:
            result.append(substage(cones.nodes(taken), taken))
            cones.store(taken)
        else:
            pending.insert(0, cones.cut(pending[0]))
    return result


class _Cones:
    """What each node of a group reads from outside if it is computed with all it needs, down to what is stored.

    The reads are four sets, as bits: (node, mode), nodes, nodes read in the vertex shader, through a filter; None where they alone
    break a limit, as they then do for every node above. So storing a node changes little, and 10,000 functions take seconds.
    """

    def __init__(self, nodes: Sequence[Node], profile: Profile):
        self.profile, self.order, self.at = profile, nodes, {n: k for k, n in enumerate(nodes)}
        self.inputs = {n: [x for x in dict.fromkeys(x for x, _ in edges(n)) if x in self.at] for n in nodes}
        self.users: dict[Node, list[Node]] = {n: [] for n in nodes}
        for n in nodes:
            for x in self.inputs[n]:
                self.users[x].append(n)
        self.reads: dict[Node, tuple[int, ...] | None] = {}
        self.numbers: dict[object, int] = {}  # of the bits: of pairs and of nodes
        self.stored: set[Node] = set()
        self.stale = list(range(len(nodes)))  # a heap of the nodes whose reads may have changed
        self.output: Node | None = None  # that is being cut
        self.own: dict[Node, list[tuple[Node, bool]]] = {}  # what `peak` asks again and again
        self.live: dict[Node, int] = {}  # node of its cone -> users there
        self.widest: list[tuple[int, int]] = []  # a heap of (-reads, number) of those that fit; old entries stay in it

    def _bits(self, x: Node, mode: str) -> tuple[int, ...]:
        pair, image = (1 << self.numbers.setdefault(key, len(self.numbers)) for key in ((x, mode), x))
        return pair, image, image * (mode == VERTEX), image * (mode == FILTERED)

    def _join(self, sets: Iterable[tuple[int, ...]], outputs: Sequence[Node]) -> tuple[int, ...] | None:
        """The union, or None where it breaks a limit."""
        union = (0, 0, 0, 0)
        for bits in sets:
            union = tuple([a | b for a, b in zip(union, bits)])
        return None if excess_of(self.profile, outputs[0].extent, outputs, *(x.bit_count() for x in union[1:])) else union

    def _find(self, n: Node) -> tuple[int, ...] | None:
        sets = []
        for x, mode in edges(n):
            sets.append(self.reads[x] if x in self.at and x not in self.stored else self._bits(x, mode))
            if sets[-1] is None:
                return None
        return self._join(sets, [n])

    def _refresh(self, last: Node) -> None:
        """Bring the reads of all nodes up to this one up to date."""
        while self.stale and self.stale[0] <= self.at[last]:
            k = heapq.heappop(self.stale)
            n = self.order[k]
            if n in self.stored or self.stale and self.stale[0] == k:
                continue
            found = self._find(n)
            if found != self.reads.get(n, ()):
                self.reads[n] = found
                self._changed(n)
                if found is not None and n in self.live:
                    heapq.heappush(self.widest, (-found[0].bit_count(), k))

    def _changed(self, n: Node) -> None:
        for user in self.users[n]:
            heapq.heappush(self.stale, self.at[user])

    def keeps(self, outputs: Sequence[Node]) -> bool:
        """Whether a substage that gives these keeps the limits."""
        self._refresh(max(outputs, key=self.at.__getitem__))
        sets = [self.reads[n] for n in outputs]
        return None not in sets and self._join(sets, outputs) is not None

    def fit(self, outputs: Sequence[Node]) -> bool:
        """Whether a substage may give these."""
        return self.keeps(outputs) and not crowded(self.nodes(outputs), outputs, self.profile, self.own)

    def relief(self, output: Node) -> list[Node]:
        """What to store before an output that is crowded alone: values that its shader would hold where it holds most, wide ones first, as
        many as one substage may give, until few enough are left. The output itself where there are none: to compute all of it twice
        costs more than what its compiler spills."""
        most = peak(self.nodes([output]), [output], self.own)
        taken: list[Node] = []
        for n in sorted(most.across, key=lambda n: (-n.channels, -self.at[n])):
            if n is not output and sum(x.channels for x in taken) < most.count - self.profile.max_live and self.fit([*taken, n]):
                taken.append(n)
        return taken or [output]

    def middle(self, outputs: Sequence[Node]) -> Node | None:
        """The value that is best stored before outputs that are crowded: the rest then holds least, and computes least where that is the
        same. None where no value helps. Tried are those on which most work is spent that is of use to nothing else."""
        nodes, given = self.nodes(outputs), set(outputs)
        alone = self._alone(nodes, outputs)
        best, found = (peak(nodes, outputs, self.own).count, 0), None
        for n in sorted((n for n in nodes if n not in given), key=lambda n: -alone[n])[:TRIED]:
            self.stored.add(n)
            rest = self.nodes(outputs)
            self.stored.discard(n)
            now = max(peak(rest, outputs, self.own).count, self.profile.max_live), _work(rest) + _work(self.nodes([n]))
            if (now[0] < best[0] or found is not None and now < best) and self.fit([n]):
                best, found = now, n
        return found

    def _alone(self, nodes: Sequence[Node], outputs: Sequence[Node]) -> dict[Node, int]:
        """Node -> cost of what is computed for it alone, itself included: of all that it dominates, seen from the outputs."""
        above: dict[Node, Node | None] = dict.fromkeys(outputs)  # the nearest node through which all of its uses go
        depth: dict[Node | None, int] = {None: 0}
        cost = {n: n.op.cost for n in nodes}
        for n in reversed(nodes):
            depth[n] = depth[above[n]] + 1
            for x in self.inputs[n]:
                if x in cost:
                    a, b = above.setdefault(x, n), n
                    while a is not b:
                        a, b = (a, above[b]) if depth[a] < depth[b] else (above[a], b)
                    above[x] = a
        for n in nodes:
            if above[n] is not None:
                cost[above[n]] += cost[n]
        return cost

    def nodes(self, outputs: Sequence[Node]) -> list[Node]:
        """What a substage that gives these computes, in order."""
        keep, stack = set(outputs), list(outputs)
        while stack:
            for x in self.inputs[stack.pop()]:
                if x not in keep and x not in self.stored:
                    keep.add(x)
                    stack.append(x)
        return sorted(keep, key=self.at.__getitem__)

    def store(self, outputs: Sequence[Node]) -> None:
        """From now on these are read."""
        self.stored.update(outputs)
        for n in outputs:
            self._changed(n)
        gone = [n for n in outputs if self.live.pop(n, None) is not None]
        while gone:
            for x in self.inputs[gone.pop()]:
                if x in self.live:
                    self.live[x] -= 1
                    if not self.live[x]:
                        del self.live[x]
                        gone.append(x)

    def cut(self, output: Node) -> Node:
        """The node inside `output`'s cone to store first: the widest one that keeps the limits."""
        if self.output is not output:
            cone = self.nodes([output])
            self.output, self.live = output, dict.fromkeys(cone, 0)
            for n in cone:
                for x in self.inputs[n]:
                    if x in self.live:
                        self.live[x] += 1
            self.widest = [(-reads[0].bit_count(), self.at[n]) for n in cone if (reads := self.reads[n]) is not None]
            heapq.heapify(self.widest)
        while self.widest:
            width, k = self.widest[0]
            n = self.order[k]
            reads = self.reads.get(n)
            if width and n in self.live and n is not output and reads is not None and reads[0].bit_count() == -width:
                return n
            heapq.heappop(self.widest)
        part = substage(self.nodes([output]), [output])
        names = " ".join(x.name for x, _ in part.reads)
        raise PackError(f"function {output.name} ({output.op.name}) {excess(part, self.profile)[0]}: {names}")
