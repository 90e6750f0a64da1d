"""Whether the blocks of a SPIR-V function make structured control flow: sections 2.11 and 2.16.1 of the specification.

In: blocks in their order, with the numbers of those they branch to and those their merge instruction names. Out: which block dominates
which, or what is wrong. Back edges lead to loop headers alone, one to each; who leaves a construct goes to its merge block, or to the
merge block or continue target of the innermost loop around it, or to the merge block of the innermost switch; constructs
nest, and not deeper than drivers can follow.
Takes n log n for n blocks and edges. Falling from one case of a switch into the next, and leaving a switch for the end of a loop around it,
are refused, though the specification has them: spirv-val is not of one mind about the second.
"""
from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NoReturn

MAX_NESTING = 64
LEAVES = frozenset({252, 253, 254, 255})  # kill, return, return value, unreachable
SELECT, SWITCH, LOOP, CONTINUE = "selection", "switch", "loop", "continue"


@dataclass(slots=True)
class Block:
    """at: its first word. to: numbers of the blocks it may branch to. merge, goes_on: those its merge instruction names, or -1. kind: of
    the construct it heads, or "". end: the opcode that ends it."""

    at: int
    to: list[int] = field(default_factory=list)
    merge: int = -1
    goes_on: int = -1
    kind: str = ""
    end: int = 0


class Dominators:
    """Which block dominates which. As if each edge back to a dominator were not there, which changes nothing; `strange`: an edge back to
    another block, or None. `parent`: the immediate dominator, -1 of the first block and of those that nothing leads to."""

    def __init__(self, to: Sequence[Sequence[int]]):
        count = len(to)
        order = _postorder(to)[::-1]
        number = [-1] * count
        for k, b in enumerate(order):
            number[b] = k
        before: list[list[int]] = [[] for _ in range(count)]
        back = []
        for b in order:
            for x in to[b]:
                if number[x] > number[b]:
                    before[x].append(b)
                else:
                    back.append((b, x))
        self.parent, self.depth, jump = [-1] * count, [0] * count, list(range(count))
        for b in order[1:]:
            p = before[b][0]
            for x in before[b][1:]:
                p = self._common(p, x, jump)
            self.parent[b], self.depth[b] = p, self.depth[p] + 1
            far = jump[p]  # a pointer up so that any ancestor is log n steps away
            jump[b] = jump[far] if self.depth[p] - self.depth[far] == self.depth[far] - self.depth[jump[far]] else p
        self.jump, self.order, self.number = jump, order, number
        self.strange = next(((b, x) for b, x in back if not self.over(x, b)), None)

    def _common(self, a: int, b: int, jump: list[int]) -> int:
        depth, parent = self.depth, self.parent
        if depth[a] < depth[b]:
            a, b = b, a
        while depth[a] > depth[b]:
            a = jump[a] if depth[jump[a]] >= depth[b] else parent[a]
        while a != b:
            a, b = (jump[a], jump[b]) if jump[a] != jump[b] else (parent[a], parent[b])
        return a

    def over(self, a: int, b: int) -> bool:
        """Whether a dominates b; every block dominates itself."""
        depth, jump, parent, low = self.depth, self.jump, self.parent, self.depth[a]
        while depth[b] > low:
            b = jump[b] if depth[jump[b]] >= low else parent[b]
        return a == b


def _postorder(to: Sequence[Sequence[int]]) -> list[int]:
    """The blocks that the first one leads to, each after those it leads to."""
    found, seen, stack = [], {0}, [(0, iter(to[0]))]
    while stack:
        at, rest = stack[-1]
        for x in rest:
            if x not in seen:
                seen.add(x)
                stack.append((x, iter(to[x])))
                break
        else:
            found.append(at)
            stack.pop()
    return found


@dataclass(frozen=True, eq=False)
class _Construct:
    """What a header heads, or a continue target within its loop. around: the construct it lies in."""

    kind: str
    header: int
    around: _Construct | None
    depth: int


class Flow:
    """`values`: the dominators of what really runs. `reached`: those blocks."""

    def __init__(self, blocks: Sequence[Block], wrong: Callable[[int, str], NoReturn]):
        self.blocks, self.wrong = blocks, wrong
        self.values = Dominators([b.to for b in blocks])
        self.reached = set(self.values.order)
        headed = any(b.kind for b in blocks)
        self.whole = Dominators([[*b.to, *(x for x in (b.merge, b.goes_on) if x >= 0)] for b in blocks]) if headed else self.values
        for d in (self.values, self.whole):
            if d.strange:
                self.fail(d.strange[0], "it branches back to a block that does not dominate it")
        for number, b in enumerate(blocks):
            if 0 in b.to:
                self.fail(number, "it branches to the first block of the function")
            if self.whole.number[number] < 0:
                self.fail(number, "nothing leads to it")
            if self.whole.parent[number] >= number:
                self.fail(number, "it comes before the block that dominates it")
        self.before: list[_Construct | None] = [None] * len(blocks)
        self.inside: list[_Construct | None] = [None] * len(blocks)
        self._constructs()
        self._edges()

    def fail(self, number: int, what: str) -> NoReturn:
        """Say what is wrong with a block; does not return."""
        self.wrong(self.blocks[number].at, f"the control flow of the block here is not structured: {what}")

    def _constructs(self) -> None:
        """The construct that each block lies in (`before`), and that it opens or lies in (`inside`)."""
        blocks, parent, going_on = self.blocks, self.whole.parent, {}
        merges: set[int] = set()
        for b in self.whole.order:
            block = blocks[b]
            self.before[b] = around = self._within(b, parent[b], going_on)
            if b in going_on:
                around = self._open(CONTINUE, going_on[b], around)
            if block.kind:
                ends = {block.merge, block.goes_on} - {-1}
                if b == block.merge or block.merge == block.goes_on or block.merge in merges or block.merge in going_on:
                    self.fail(b, "its merge block is itself, its continue target, or another's")
                for x in ends - {b}:
                    if parent[x] != b:
                        self.fail(b, "it does not dominate the block that its merge instruction names, or not first")
                merges.add(block.merge)
                around = self._open(block.kind, b, around)
                if block.goes_on >= 0 and block.goes_on != b:
                    if block.goes_on in going_on or block.goes_on in merges:
                        self.fail(b, "its continue target is another's, or a merge block")
                    going_on[block.goes_on] = b
            self.inside[b] = around

    def _within(self, b: int, parent: int, going_on: dict[int, int]) -> _Construct | None:
        if parent < 0:
            return None
        around = self.inside[parent]
        if self.blocks[parent].merge == b:
            return around.around
        return around

    def _open(self, kind: str, header: int, around: _Construct | None) -> _Construct:
        depth = around.depth + 1 if around else 1
        if depth > MAX_NESTING:
            self.fail(header, f"constructs are nested deeper than {MAX_NESTING}")
        return _Construct(kind, header, around, depth)

    def _edges(self) -> None:
        blocks, back = self.blocks, {}
        for b in self.whole.order:
            plain = set()
            for x in dict.fromkeys(blocks[b].to):
                if self.whole.number[x] <= self.whole.number[b]:
                    self._back(b, x)
                    back[x] = back.get(x, 0) + 1
                elif not self._leaves(b, x):
                    plain.add(x)
            if blocks[b].end == 251 and blocks[b].kind != SWITCH or blocks[b].end == 250 and not blocks[b].kind and len(plain) > 1:
                self.fail(b, "it branches to several blocks without a merge instruction")
            if blocks[b].end in LEAVES and self._around(b, CONTINUE):
                self.fail(b, "it leaves the function from where a loop goes on")
        for b in self.whole.order:
            if blocks[b].kind == LOOP and back.get(b) != 1:
                self.fail(b, f"{back.get(b, 0)} blocks branch back to this loop header; one is needed")
        self._cases()

    def _around(self, b: int, kind: str) -> bool:
        c = self.inside[b]
        while c and c.kind != kind:
            c = c.around
        return c is not None

    def _back(self, b: int, header: int) -> None:
        """A branch back: to a loop header, from where its loop goes on, and from no construct within that."""
        target, mine = self.blocks[header], self.inside[b]
        alone = target.goes_on == header == b
        if target.kind != LOOP or not (alone or mine and mine.kind == CONTINUE and mine.header == header):
            self.fail(b, "it branches back to what is not the header of the loop that goes on here")

    def _leaves(self, b: int, x: int) -> bool:
        """Whether the branch goes to where a construct around it ends, or a loop goes on; fails where it may not go there."""
        blocks, low = self.blocks, self.before[x]
        left, c = [], self.inside[b]
        while c is not None and c.depth > (low.depth if low else 0):
            left.append(c)
            c = c.around
        if c is not low:
            self.fail(b, "it branches into a construct, past its header")
        goes_on = low is not None and low.kind == LOOP and x == blocks[low.header].goes_on
        if not left:
            return goes_on
        kinds, last = [c.kind for c in left[:-1]], left[-1]
        if x == blocks[last.header].merge and last.kind != CONTINUE:
            if last.kind == LOOP and kinds == [CONTINUE]:
                if last.header not in blocks[b].to:
                    self.fail(b, "it leaves a loop from where it goes on, and does not go on")
            elif {*kinds} - {SELECT} or kinds and last.kind == SELECT:
                self.fail(b, "it leaves several constructs at once")
            return True
        if goes_on and not {*kinds, last.kind} - {SELECT}:
            return True
        self.fail(b, "it leaves a construct to where that does not end")

    def _cases(self) -> None:
        """A case is entered by its switch alone, and is not where a loop around it ends or goes on."""
        whole = self.whole
        cases = {x: b for b in whole.order if self.blocks[b].kind == SWITCH for x in self.blocks[b].to if x != self.blocks[b].merge}
        for x, b in cases.items():
            if whole.parent[x] != b:
                self.fail(b, "it has a case that others lead to")
        for b in whole.order:
            for x in self.blocks[b].to:
                if cases.get(x, b) != b and whole.number[x] > whole.number[b]:
                    self.fail(b, "it branches to a case of a switch")
