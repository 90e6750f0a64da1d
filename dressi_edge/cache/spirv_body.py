"""The functions of a SPIR-V module: every instruction, its types, what it uses and where that was made.

In: a `Module` with its declarations, and where the first function begins. Out: nothing, or a BundleError that names the first thing
wrong. What is not known here is refused. Calls are followed as drivers follow them, who put functions into each other: a chain that
calls itself, or grows beyond MAX_WORK, is refused.
"""
from __future__ import annotations

from functools import partial

from .spirv_flow import LOOP, SELECT, SWITCH, Block, Flow
from .spirv_module import FUNCTION, IMAGE, INPUT, UNIFORM_CONSTANT, Module, Type
from .spirv_numbers import extended, row
from .spirv_shared import SHARED
from .spirv_table import DERIVATIVE_CONTROL, ROWS
from .spirv_values import FRAGMENT, VALUES

MAX_WORK = 1 << 18  # instructions and numbers of variables, of all functions as they are put into each other
MAX_CALLS = 64  # deep
ENDS = {249: (1, 1), 250: (3, 5), 251: (2, None), 252: (0, 0), 253: (0, 0), 254: (1, 1), 255: (0, 0)}
VARIABLE, PHI, LOOP_MERGE, SELECTION_MERGE, LABEL = 59, 245, 246, 247, 248
LINES = (8, 317)
EARLY = frozenset({VARIABLE, PHI, *LINES})


class _Function:
    """One of them while it is read. blocks, labels: number of the block of a label. local: id of a value -> number of the block that
    makes it. uses: (number of a block, of the block it uses something of). calls: how often it calls which."""

    def __init__(self, made: Type):
        self.made, self.params = made, list(made.members)
        self.blocks: list[Block] = []
        self.labels: dict[int, int] = {}
        self.targets: list[tuple[int, int, list[int], int, int]] = []
        self.phis: list[tuple[int, int, tuple]] = []
        self.local: dict[int, int] = {}
        self.uses: set[tuple[int, int]] = set()
        self.calls: dict[int, int] = {}
        self.work = 0


class Body:
    """Reads the functions. `of`: id of a function -> its type, those that are only called so far included."""

    def __init__(self, m: Module):
        self.m, self.words = m, m.words
        self.functions: dict[int, _Function] = {}
        self.called: list[tuple[int, int, tuple, int]] = []  # word, function, types of arguments, type of the result
        self.f: _Function | None = None
        self.block, self.begun = -1, False  # begun: something came that no variable or phi may come after
        self.open = Block(0)  # the block with that number

    # ---- ids

    def value(self, x: int, at: int) -> int:
        """The id of the type of a value that there is."""
        found = self.m.values.get(x)
        if found is None:
            self.m.wrong(at, f"id {x}; ids below {self.m.bound} are allowed" if x >= self.m.bound else f"id {x} is no value made before")
        made = self.f.local.get(x)
        if made is not None and made != self.block:
            self.f.uses.add((self.block, made))
        return found

    def pointer(self, x: int, at: int, also: int | None = None) -> Type:
        """The type of a value that points; to a texel (`IMAGE`) only if asked for."""
        found = self.m.types[self.value(x, at)]
        if found.kind != "pointer" or found.storage == IMAGE != also:
            self.m.wrong(at, f"id {x} is no pointer")
        self.m.touched.add(x)
        return found

    def result(self, kind: int, x: int, at: int) -> Type:
        """Give an id a type; this one."""
        m = self.m
        found = m.types.get(kind) or m.type(kind, at)
        if x in m.defined or not 0 < x < m.bound:
            m.define(x, at)
        m.defined.add(x)
        m.values[x] = kind
        self.f.local[x] = self.block
        if not found.letter and found.components:
            m.weigh(found, at)
        return found

    # ---- instructions

    def read(self, at: int) -> None:
        """All functions, from the first to the end of the module. A block is open from its label to what ends it."""
        words, end, m, handlers = self.words, len(self.words), self.m, self._handlers()
        while at < end:
            word = words[at]
            count, op = word >> 16, word & 0xFFFF
            if not count or count > end - at:
                m.wrong(at, f"an instruction of {count} words; {end - at} are left")
            ops = words[at + 1:at + count]
            if self.block < 0:
                self._between(op, ops, at)
            else:
                if op not in handlers:
                    m.wrong(at, f"opcode {op} is not allowed in a function")
                if self.open.kind and op not in ENDS:
                    m.wrong(at, "a merge instruction that is not the last but one of its block")
                self.f.work += 1
                handlers[op](ops, at)
                if not self.begun and op not in EARLY:
                    self.begun = True
            at += count
        if self.f is not None:
            m.fail("ends within a function")
        self._calls()

    def _between(self, op: int, ops: tuple, at: int) -> None:
        """An instruction outside blocks."""
        m = self.m
        if self.f is None:
            if op != 54:
                m.wrong(at, f"opcode {op} is not allowed between functions")
            self._begin(ops, at)
        elif op == LABEL:
            self._label(ops, at)
        elif op == 55 and not self.f.blocks:
            self._parameter(ops, at)
        elif op == 56:
            self._finish(ops, at)
        elif op not in LINES:
            m.wrong(at, f"opcode {op} is not allowed {'outside a block' if op in ENDS or op in ROWS or op in VALUES else 'in a function'}")

    def _handlers(self) -> dict:
        """Opcode -> what reads an instruction in a block."""
        found = dict.fromkeys(ROWS, partial(row, self)) | {op: partial(read, self) for op, read in (VALUES | SHARED).items()}
        found |= dict.fromkeys(ENDS, self._end) | dict.fromkeys(LINES, lambda ops, at: None)
        return found | {12: partial(extended, self), 57: self._call, 61: self._load, 62: self._store, VARIABLE: self._variable,
                        PHI: self._phi, LOOP_MERGE: self._merge, SELECTION_MERGE: self._merge}

    def _load(self, ops: tuple, at: int) -> None:
        m = self.m
        if len(ops) != 3:
            m.operands(ops, 3, at, 4)
            self._access(ops[3:], at)
        if self.pointer(ops[2], at).of != ops[0] or ops[0] in m.closed:
            m.wrong(at, f"a load of another type than id {ops[2]} points to")
        self.result(ops[0], ops[1], at)

    def _store(self, ops: tuple, at: int) -> None:
        m = self.m
        if len(ops) != 2:
            m.operands(ops, 2, at, 3)
            self._access(ops[2:], at)
        target = self.pointer(ops[0], at)
        if target.of != self.value(ops[1], at) or target.of in m.closed or target.storage in (UNIFORM_CONSTANT, INPUT):
            m.wrong(at, f"a store into id {ops[0]}, of another type, or where nothing may be stored")

    def only_fragments(self, op: int, at: int) -> None:
        """What needs neighbouring pixels, or ends one."""
        if self.m.stage != FRAGMENT:
            self.m.wrong(at, f"opcode {op} belongs to fragment shaders")
        if op in DERIVATIVE_CONTROL and 51 not in self.m.capabilities:
            self.m.wrong(at, f"opcode {op} needs capability 51")

    def _access(self, rest: tuple, at: int) -> None:
        if rest and rest[0] & ~5:
            self.m.wrong(at, f"memory access {rest[0]}; 0, 1, 4 and 5 are allowed")

    # ---- functions and blocks

    def _begin(self, ops: tuple, at: int) -> None:
        m = self.m
        m.operands(ops, 4, at, 4)
        made = m.type(ops[3], at)
        if made.kind != "function" or made.of != ops[0] or ops[2] > 15:
            m.wrong(at, "a function that is not of its type")
        m.define(ops[1], at)
        self.f = self.functions[ops[1]] = _Function(made)

    def _parameter(self, ops: tuple, at: int) -> None:
        m, f = self.m, self.f
        m.operands(ops, 2, at, 2)
        if not f.params or f.params.pop(0) != ops[0]:
            m.wrong(at, "a parameter that the function's type has not")
        m.values[m.define(ops[1], at)] = ops[0]
        f.local[ops[1]] = 0

    def _label(self, ops: tuple, at: int) -> None:
        f = self.f
        self.m.operands(ops, 1, at, 1)
        if f.params:
            self.m.wrong(at, "a function that lacks parameters of its type")
        f.labels[self.m.define(ops[0], at)] = self.block = len(f.blocks)
        self.begun = False
        self.open = Block(at)
        f.blocks.append(self.open)

    def _merge(self, ops: tuple, at: int) -> None:
        loop = self.words[at] & 0xFFFF == LOOP_MERGE
        self.m.operands(ops, 2 + loop, at, 2 + loop)
        if ops[-1] > 3:
            self.m.wrong(at, f"merge control {ops[-1]}; at most 3 is allowed")
        self.open.kind = LOOP if loop else SELECT
        self.f.targets.append((at, self.block, [], ops[0], ops[1] if loop else 0))

    def _end(self, ops: tuple, at: int) -> None:
        m, f, block, op = self.m, self.f, self.open, self.words[at] & 0xFFFF
        m.operands(ops, ENDS[op][0], at, ENDS[op][1])
        labels: list[int] = []
        if op == 249:
            labels = [ops[0]]
        elif op == 250:
            if len(ops) == 4 or m.types[self.value(ops[0], at)].kind != "bool":
                m.wrong(at, "a branch on what is no truth value")
            labels = [ops[1], ops[2]]
        elif op == 251:
            kind = m.types[self.value(ops[0], at)]
            if len(ops) % 2 or kind.letter not in ("i", "u") or kind.components != 1 or len(set(ops[2::2])) != len(ops[2::2]):
                m.wrong(at, "a switch on what is no integer, or with a case twice")
            labels = [ops[1], *ops[3::2]]
        elif op == 252:
            self.only_fragments(op, at)
        elif op in (253, 254):
            given = self.value(ops[0], at) if ops else None
            if given != f.made.of and (op == 254 or m.types[f.made.of].kind != "void"):
                m.wrong(at, "a return of another type than the function's")
        if block.kind and op not in ((249, 250) if block.kind == LOOP else (250, 251)):
            m.wrong(at, "a merge instruction before what it does not go with")
        if op == 251 and block.kind:
            block.kind = SWITCH
        block.end = op
        f.targets.append((at, self.block, labels, 0, 0))
        self.block = -1

    def _phi(self, ops: tuple, at: int) -> None:
        m, f = self.m, self.f
        m.operands(ops, 4, at)
        if len(ops) % 2 or self.begun or not self.block:
            m.wrong(at, "a phi that is not at the beginning of a later block, with a parent for each value")
        m.holds(ops[0], at)
        self.result(ops[0], ops[1], at)
        f.phis.append((at, self.block, ops))

    def _variable(self, ops: tuple, at: int) -> None:
        m, f = self.m, self.f
        m.operands(ops, 3, at, 4)
        pointer = m.type(ops[0], at)
        if ops[2] != FUNCTION or pointer.kind != "pointer" or pointer.storage != FUNCTION:
            m.wrong(at, "a variable in a function that is not its own")
        if self.block or self.begun:
            m.wrong(at, "a variable that is not at the beginning of its function")
        if len(ops) == 4 and (ops[3] not in m.fixed or m.values[ops[3]] != pointer.of):
            m.wrong(at, "a variable that begins with what is no constant of its type")
        self.result(ops[0], ops[1], at)
        m.weigh(m.types[pointer.of], at)
        f.work += m.types[pointer.of].components

    def _call(self, ops: tuple, at: int) -> None:
        m = self.m
        m.operands(ops, 3, at)
        types = tuple(self.value(x, at) for x in ops[3:])
        m.touched.update(ops[3:])
        m.id(ops[2], at)
        found = m.type(ops[0], at)
        m.values[m.define(ops[1], at)] = ops[0]
        self.f.local[ops[1]] = self.block
        if not found.letter:
            m.weigh(found, at)
        self.f.calls[ops[2]] = self.f.calls.get(ops[2], 0) + 1
        self.called.append((at, ops[2], types, ops[0]))

    def _finish(self, ops: tuple, at: int) -> None:
        """The function is whole: what its branches name is there, and what it uses comes before."""
        m, f = self.m, self.f
        m.operands(ops, 0, at, 0)
        if not f.blocks:
            m.wrong(at, "a function without a block")

        def label(x: int, at: int) -> int:
            if x not in f.labels:
                m.wrong(at, f"a branch to id {m.id(x, at)}, which is no block of this function")
            return f.labels[x]

        for where, number, labels, merge, goes_on in f.targets:
            block = f.blocks[number]
            block.to += [label(x, where) for x in labels]
            if merge:
                block.merge = label(merge, where)
            if goes_on:
                block.goes_on = label(goes_on, where)
        flow = Flow(f.blocks, m.wrong)
        before: list[set[int]] = [set() for _ in f.blocks] if f.phis else []
        for number, block in enumerate(f.blocks if f.phis else ()):
            for x in block.to:
                before[x].add(number)
        for where, number, ops in f.phis:
            parents = [label(x, where) for x in ops[3::2]]
            if len(parents) != len(set(parents)) or set(parents) != before[number]:
                m.wrong(where, "a phi whose parents are not the blocks that lead to it")
            for x, parent in zip(ops[2::2], parents):
                self.block = parent
                if self.value(x, where) != ops[0]:
                    m.wrong(where, f"a phi of id {x}, which is of another type")
        for number, made in f.uses:
            if number in flow.reached and not (made in flow.reached and flow.values.over(made, number)):
                m.wrong(f.blocks[number].at, "the block here uses what a block makes that need not run before it")
        for x in f.local:
            del m.values[x]
        f.local, f.uses, f.phis, f.targets, f.blocks, f.labels = {}, set(), [], [], [], {}
        self.f, self.block = None, -1

    def _calls(self) -> None:
        """What is called is there and takes what it is given; nothing calls itself; put into each other they are not too much."""
        m, functions = self.m, self.functions
        for at, x, types, kind in self.called:
            if x not in functions:
                m.wrong(at, "calls a function that is not there")
            made = functions[x].made
            if x == m.entry or made.of != kind or len(types) != len(made.members) or types != made.members:
                m.wrong(at, f"a call of id {x} that does not go with its type, or of the entry point")
        if m.entry not in functions:
            m.fail("lacks the entry point's function")
        if functions[m.entry].params or m.types[functions[m.entry].made.of].kind != "void" or functions[m.entry].made.members:
            m.fail("has an entry point that takes or returns something")
        work: dict[int, tuple[int, int]] = {}  # in all, how deep it calls
        for first in functions:
            stack, open_ = [first], set()
            while stack:
                x = stack[-1]
                if x in work:
                    stack.pop()
                    continue
                open_.add(x)
                if missing := [y for y in functions[x].calls if y not in work]:
                    if not open_.isdisjoint(missing):
                        m.fail("has a function that calls itself")
                    stack += missing
                    continue
                calls = functions[x].calls
                total = functions[x].work + sum(n * work[y][0] for y, n in calls.items())
                depth = 1 + max((work[y][1] for y in calls), default=0)
                if total > MAX_WORK or depth > MAX_CALLS:
                    m.fail(f"has functions that, put into each other, are {total} instructions and numbers, {depth} deep; "
                           f"{MAX_WORK} and {MAX_CALLS} are allowed")
                work[x] = total, depth
                open_.discard(stack.pop())
