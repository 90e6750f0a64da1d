"""What a shader binds, takes and gives, read from its SPIR-V.

In: the bytes of a module. Out: its `Interface`, or a BundleError and nothing else. Takes n log n for n bytes.

Modules are held to what a player needs, and to what drivers may take for granted: SPIR-V 1.0, the opcodes, capabilities and storage
classes of vertex, fragment and compute shaders that touch nothing but descriptors, varyings and their own variables; types, constants and
variables of bounded size (`spirv_types.py`); every instruction of the right types, in structured control flow (`spirv_body.py`,
`spirv_flow.py`); one entry point `main`. What passes, spirv-val passes too (`tests/test_spirv.py` holds the two together). That a shader
ends is not promised. Numbers are those of the SPIR-V specification, version 1.6, chapter 3.
"""
from __future__ import annotations

import hashlib
import struct
from dataclasses import dataclass, field

from . import vulkan as v
from .spirv_body import Body
from .spirv_module import INPUT, OUTPUT, PRIVATE, UNIFORM_CONSTANT, WORKGROUP, Module, Type
from .spirv_types import CONSTANTS, LENGTHS, declare_constant, declare_type

MAX_LOCATIONS = 64  # more than any known device has
MAX_KNOWN = 1024
MODELS = {0: v.STAGE_VERTEX, 4: v.STAGE_FRAGMENT, 5: v.STAGE_COMPUTE}
CAPABILITIES = frozenset({0, 1, 40, 50, 51})  # Matrix Shader InputAttachment ImageQuery DerivativeControl: need no feature
SHADER, INPUT_ATTACHMENT = 1, 40
# EarlyFragmentTests OriginUpperLeft DepthReplacing -Greater -Less -Unchanged
MODES = frozenset({7, 9, 12, 14, 15, 16})
ORIGIN, REPLACES_DEPTH, LOCAL_SIZE, DEPTHS = 7, 12, 17, frozenset({14, 15, 16})
MAX_INVOCATIONS = 1 << 16  # of a workgroup; devices allow far less
BLOCK, FLAT, BUILTIN, NON_READABLE, LOCATION, COMPONENT, INDEX, BINDING, SET, ATTACHMENT = 2, 14, 11, 25, 30, 31, 32, 33, 34, 43
NUMBERED = frozenset({BUILTIN, LOCATION, BINDING, SET, ATTACHMENT})  # decorations with a number, once
# RelaxedPrecision Block NoPerspective Flat Centroid Invariant NonReadable NoContraction
PLAIN = frozenset({0, BLOCK, 13, FLAT, 16, 18, NON_READABLE, 42})
FREE = frozenset({0, 42})  # of results of instructions, too
INTERPOLATED = frozenset({13, FLAT, 16})
MARKS_OF_IMAGES, MARKS_OF_VARYINGS = frozenset({BINDING, SET, ATTACHMENT}), frozenset({BUILTIN, LOCATION, 18}) | INTERPOLATED
# Built-ins, by stage and storage class: number -> the letter and count of its type. Clip and cull distances (3, 4) need features, and are
# members that no shader touches.
BUILTINS = {(v.STAGE_VERTEX, INPUT): {42: "i1", 43: "i1"}, (v.STAGE_VERTEX, OUTPUT): {0: "f4", 1: "f1"},
            (v.STAGE_FRAGMENT, INPUT): {15: "f4", 16: "f2", 17: "b1"}, (v.STAGE_FRAGMENT, OUTPUT): {22: "f1"},
            (v.STAGE_COMPUTE, INPUT): {24: "u3", 26: "u3", 27: "u3", 28: "u3", 29: "u1"}, (v.STAGE_COMPUTE, OUTPUT): {}}
WORKGROUP_SIZE = 25  # a built-in that is a constant: what the execution mode LocalSize says
PER_VERTEX = {0: "f4", 1: "f1", 3: "array", 4: "array"}
POINT_SIZE, FRAG_DEPTH, CLOSED = 1, 22, frozenset({3, 4})
NAMES, LINES = frozenset({5, 6}), frozenset({8, 317})
# The order in which declarations come: opcode -> section. Lines belong to any from types on.
SECTIONS = {17: 0, 11: 1, 14: 2, 15: 3, 16: 4, 2: 5, 3: 5, 4: 5, 7: 5, 5: 6, 6: 6, 330: 7, 71: 8, 72: 8}
TYPES = 9


@dataclass(frozen=True)
class Interface:
    """`bindings`: number -> (descriptor kind, reads integers, input attachment index or -1; of a storage image its VkFormat). `inputs`,
    `outputs`: location -> (float int uint, components). `input_components`, `output_components`: whole locations and the built-ins.
    `point_size`: a vertex shader that writes the size of points. Of a compute shader: `local_size`, the invocations of a workgroup
    along x, y, z, and `shared_bytes`, what they share at most."""

    stage: int
    bindings: dict[int, tuple[int, bool, int]] = field(default_factory=dict)
    inputs: dict[int, tuple[str, int]] = field(default_factory=dict)
    outputs: dict[int, tuple[str, int]] = field(default_factory=dict)
    input_components: int = 0
    output_components: int = 0
    point_size: bool = False
    local_size: tuple[int, int, int] = (0, 0, 0)
    shared_bytes: int = 0


_KNOWN: dict[bytes, Interface] = {}


def parse(data: bytes, where: str = "shader") -> Interface:
    """The interface of a module. Raises BundleError and nothing else. Those of modules read lately are remembered by their digest: bundles
    and variants share many, and what is written is read back."""
    key = hashlib.sha256(data).digest()
    found = _KNOWN.get(key)
    if found is None:
        found = _Declarations(Module(data, where)).interface()
        if len(_KNOWN) >= MAX_KNOWN:
            _KNOWN.clear()
        _KNOWN[key] = found
    return found


class _Declarations:
    """Reads what comes before the first function, has `Body` read the rest, and finds what the variables mean."""

    def __init__(self, m: Module):
        self.m, self.words = m, m.words
        self.decorations: dict[int, dict[int, int]] = {}
        self.members: dict[int, dict[int, int]] = {}  # structure -> member -> built-in
        self.modes: set[int] = set()
        self.named: dict[int, int] = {}  # what annotations speak of, and where
        self.moded: dict[int, int] = {}  # what execution modes speak of, and where
        self.seen: set[tuple] = set()
        self.models, self.local_size = 0, (0, 0, 0)
        body, at = Body(m), self._all()
        if not m.stage:
            m.fail("has no entry point")
        if self.models != 1 or not {SHADER} <= m.capabilities:
            m.fail("lacks its memory model, or capability 1 (Shader)")
        body.read(at)
        for x, at in self.named.items():
            if x not in m.defined:
                m.wrong(at, f"speaks of id {x}, which nothing defines")
        for x, at in self.moded.items():
            if x != m.entry or m.stage != v.STAGE_FRAGMENT and self.modes != {LOCAL_SIZE}:
                m.wrong(at, "an execution mode of what is no fragment shader")

    def _all(self) -> int:
        """Every declaration; where the first function is."""
        m, words, at, end, section = self.m, self.words, 5, len(self.words), 0
        while at < end:
            count, op = words[at] >> 16, words[at] & 0xFFFF
            if not count or count > end - at:
                m.wrong(at, f"an instruction of {count} words; {end - at} are left")
            if op == 54:
                return at
            mine = TYPES if op in LENGTHS or op in CONSTANTS or op == 59 or op in LINES else SECTIONS.get(op)
            if mine is None:
                m.wrong(at, f"opcode {op} is not allowed before the functions")
            if mine < section:
                m.wrong(at, f"opcode {op} comes too late")
            section = mine
            self._one(op, words[at + 1:at + count], at)
            at += count
        m.fail("has no function")

    def _one(self, op: int, ops: tuple, at: int) -> None:
        m = self.m
        if op in LENGTHS:
            declare_type(m, op, ops, at, self.seen)
        elif op in CONSTANTS:
            declare_constant(m, op, ops, at)
        elif op == 59:
            self._variable(ops, at)
        elif op in (71, 72):
            self._decoration(op, ops, at)
        elif op == 17:
            m.operands(ops, 1, at, 1)
            if ops[0] not in CAPABILITIES:
                m.wrong(at, f"capability {ops[0]} is not allowed")
            m.capabilities.add(ops[0])
        elif op == 11:
            m.operands(ops, 2, at)
            if m.text(ops[1:], at) != b"GLSL.std.450":
                m.wrong(at, "only the instructions of GLSL.std.450 are allowed")
            m.instructions = m.define(ops[0], at)
        elif op == 14:
            if ops != (0, 1):
                m.wrong(at, "the memory model must be Logical GLSL450")
            self.models += 1
        elif op == 15:
            self._entry(ops, at)
        elif op == 16:
            self._mode(ops, at)
        else:
            self._told(op, ops, at)

    def _told(self, op: int, ops: tuple, at: int) -> None:
        """Sources, names and lines: of no use here, but of sound form."""
        m = self.m
        numbers = {2: 0, 3: 2, 4: 0, 5: 1, 6: 2, 7: 1, 8: 3, 317: 0, 330: 0}[op]
        m.operands(ops, numbers, at, numbers if op in LINES else None)
        if op in NAMES:
            self.named.setdefault(m.id(ops[0], at), at)
        elif op == 7:
            m.define(ops[0], at)
        elif op == 8:
            self.named.setdefault(m.id(ops[0], at), at)
        elif op == 3 and len(ops) > 2:
            self.named.setdefault(m.id(ops[2], at), at)
            numbers = 3
        if op not in LINES and (op != 3 or len(ops) > 3):
            m.text(ops[numbers:], at)

    def _entry(self, ops: tuple, at: int) -> None:
        m = self.m
        m.operands(ops, 4, at)
        if m.stage:
            m.wrong(at, "a second entry point")
        if ops[0] not in MODELS:
            m.wrong(at, f"execution model {ops[0]}; vertex (0), fragment (4) and compute (5) are allowed")
        if ops[2:4] != struct.unpack("<2I", b"main\0\0\0\0"):
            m.wrong(at, "the entry point must be called main")
        for x in (ops[1], *ops[4:]):
            m.id(x, at)
        m.stage, m.entry, m.listed = MODELS[ops[0]], ops[1], set(ops[4:])
        if len(m.listed) != len(ops) - 4:
            m.wrong(at, "the entry point names a variable twice")

    def _mode(self, ops: tuple, at: int) -> None:
        m = self.m
        local = len(ops) > 1 and ops[1] == LOCAL_SIZE and m.stage == v.STAGE_COMPUTE
        m.operands(ops, 2 + 3 * local, at, 2 + 3 * local)
        self.moded.setdefault(m.id(ops[0], at), at)
        if local:
            x, y, z = self.local_size = ops[2:]
            if not 0 < x * y * z <= MAX_INVOCATIONS:
                m.wrong(at, f"workgroups of {x} x {y} x {z} invocations; 1 to {MAX_INVOCATIONS} are allowed")
        elif ops[1] not in MODES:
            m.wrong(at, f"execution mode {ops[1]} is not allowed")
        if ops[1] in self.modes or ops[1] in DEPTHS and self.modes & DEPTHS:
            m.wrong(at, f"execution mode {ops[1]} is given twice, or with another of the kind")
        self.modes.add(ops[1])

    def _variable(self, ops: tuple, at: int) -> None:
        m = self.m
        m.operands(ops, 3, at, 4)
        pointer = m.type(ops[0], at)
        if pointer.kind != "pointer" or pointer.storage != ops[2]:
            m.wrong(at, "a variable whose type is no pointer to its storage class")
        if ops[2] not in (UNIFORM_CONSTANT, INPUT, OUTPUT, PRIVATE, WORKGROUP):
            m.wrong(at, f"a variable of storage class {ops[2]}; images, inputs, outputs, private and shared ones are allowed")
        if len(ops) == 4 and (ops[2] not in (OUTPUT, PRIVATE) or ops[3] not in m.fixed or m.values[ops[3]] != pointer.of):
            m.wrong(at, "a variable that begins with what is no constant of its type, or may not")
        m.weigh(m.types[pointer.of], at)
        m.variables.append((m.define(ops[1], at), ops[2], pointer.of))
        m.values[ops[1]] = ops[0]

    def _decoration(self, op: int, ops: tuple, at: int) -> None:
        m, member = self.m, op == 72
        m.operands(ops, 2 + member, at)
        self.named.setdefault(m.id(ops[0], at), at)
        kind, rest = ops[1 + member], ops[2 + member:]
        if kind not in NUMBERED and kind not in PLAIN:
            m.wrong(at, f"decoration {kind} is not allowed")
        m.operands(rest, int(kind in NUMBERED), at, int(kind in NUMBERED))
        if member:
            if kind != BUILTIN or ops[1] in self.members.setdefault(ops[0], {}):
                m.wrong(at, f"decoration {kind} of a member is not allowed, or there twice")
            self.members[ops[0]][ops[1]] = rest[0]
            m.closed.setdefault(ops[0], set()).update({ops[1]} if rest[0] in CLOSED else ())
            return
        mine = self.decorations.setdefault(ops[0], {})
        if kind in mine:
            m.wrong(at, f"decoration {kind} twice")
        mine[kind] = rest[0] if rest else 1

    # ---- what it means

    def interface(self) -> Interface:
        """What the variables are for. Raises BundleError."""
        m, stage = self.m, self.m.stage
        if stage == v.STAGE_FRAGMENT and ORIGIN not in self.modes:
            m.fail("is a fragment shader without OriginUpperLeft")
        if stage == v.STAGE_COMPUTE and self.modes != {LOCAL_SIZE}:
            m.fail("is a compute shader without LocalSize, or with another mode")
        storages = {x: storage for x, storage, _ in m.variables}
        for x in sorted(m.listed):
            if storages.get(x) not in (INPUT, OUTPUT):
                m.fail(f"has an entry point that names id {x}, which is no input or output")
        for x, marks in self.decorations.items():
            if marks == {BUILTIN: WORKGROUP_SIZE} and self._says_size(x):
                continue
            if BLOCK in marks and (x not in m.types or m.types[x].kind != "struct") or marks.keys() - FREE - {BLOCK} and x not in storages:
                m.fail(f"id {x}: a decoration of what it does not go with")
        bindings: dict[int, tuple[int, bool, int]] = {}
        sides: dict[int, dict[int, tuple[str, int]]] = {INPUT: {}, OUTPUT: {}}
        extra, built_in = {INPUT: 0, OUTPUT: 0}, set()
        for x, storage, pointee in m.variables:
            marks, kind = self.decorations.get(x, {}), m.types[pointee]
            if x in m.touched and storage in sides and x not in m.listed:
                m.fail(f"id {x}: an input or output that is used and not named by the entry point")
            of_class = MARKS_OF_IMAGES if storage == UNIFORM_CONSTANT else MARKS_OF_VARYINGS if storage in sides else set()
            if marks.keys() - FREE - (of_class | {NON_READABLE} if kind.format else of_class):
                m.fail(f"id {x}: a decoration that variables of its storage class have not")
            if storage == UNIFORM_CONSTANT:
                self._bind(x, marks, kind, bindings)
            elif storage in sides:
                if stage == v.STAGE_COMPUTE and BUILTIN not in marks:
                    m.fail(f"id {x}: an input or output of a compute shader that is no built-in")
                found = self._built_in(x, storage, marks, pointee)
                if found and found & built_in:
                    m.fail(f"id {x}: a built-in that there is already")
                if found:
                    built_in |= found
                    extra[storage] += kind.components
                else:
                    self._locate(x, marks, kind, sides[storage], (stage, storage))
        if stage == v.STAGE_VERTEX and sides[INPUT]:
            m.fail("takes vertex attributes; a bundle has none")
        count = {side: 4 * (max(sides[side], default=-1) + 1) + extra[side] for side in sides}
        shared = sum(_bytes(m, pointee) for _, storage, pointee in m.variables if storage == WORKGROUP)
        return Interface(stage, bindings, sides[INPUT], sides[OUTPUT], count[INPUT], count[OUTPUT], any(
            self.members.get(x, {}).get(k) == POINT_SIZE for x, k in m.reached) or any(
            self.decorations.get(x, {}).get(BUILTIN) == POINT_SIZE for x in m.touched), self.local_size, shared)

    def _says_size(self, x: int) -> bool:
        """Whether it is the constant of the size of a workgroup, and says what the execution mode does."""
        m = self.m
        return m.stage == v.STAGE_COMPUTE and x in m.composites and _is(m, m.values[x], "u3") \
            and tuple(m.integers.get(part, -1) for part in m.composites[x]) == self.local_size

    def _built_in(self, x: int, storage: int, marks: dict, pointee: int) -> set[tuple[int, int]]:
        """The built-ins that a variable stands for, as (storage class, number); none for those with a location."""
        m, kind, which = self.m, self.m.types[pointee], BUILTINS[self.m.stage, storage]
        if pointee in self.members:
            mine = self.members[pointee]
            good = (m.stage, storage) == (v.STAGE_VERTEX, OUTPUT) and set(mine) == set(range(kind.count)) and not marks \
                and BLOCK in self.decorations.get(pointee, {}) and len(set(mine.values())) == len(mine) \
                and all(_is(m, kind.members[k], PER_VERTEX.get(number, "")) for k, number in mine.items())
            if not good:
                m.fail(f"id {x}: a block that is not that of the built-ins of a vertex shader")
            return {(storage, number) for number in mine.values()}
        if BUILTIN not in marks:
            return set()
        number = marks[BUILTIN]
        if number not in which or not _is(m, pointee, which[number]) or LOCATION in marks:
            m.fail(f"id {x}: built-in {number}, which this stage has not, or not of this type")
        if number == FRAG_DEPTH and REPLACES_DEPTH not in self.modes:
            m.fail(f"id {x}: writes depth without execution mode DepthReplacing")
        return {(storage, number)}

    def _bind(self, x: int, marks: dict, kind: Type, bindings: dict) -> None:
        m = self.m
        if marks.get(SET) != 0 or BINDING not in marks:
            m.fail(f"id {x}: a descriptor needs set 0 and a binding")
        number = marks[BINDING]
        if number in bindings:
            m.fail(f"binding {number} is declared twice")
        if kind.attachment != (ATTACHMENT in marks) or kind.attachment and m.stage != v.STAGE_FRAGMENT:
            m.fail(f"binding {number}: an input attachment, and nothing else, needs an index, in a fragment shader")
        what = (v.DESCRIPTOR_COMBINED_IMAGE_SAMPLER if kind.kind == "sampled" else
                v.DESCRIPTOR_INPUT_ATTACHMENT if kind.attachment else v.DESCRIPTOR_STORAGE_IMAGE if kind.format else
                v.DESCRIPTOR_SAMPLED_IMAGE)
        bindings[number] = what, kind.integer, marks[ATTACHMENT] if kind.attachment else kind.format or -1

    def _locate(self, x: int, marks: dict, kind: Type, side: dict, where: tuple[int, int]) -> None:
        m, at = self.m, marks.get(LOCATION)
        if at is None or at >= MAX_LOCATIONS:
            m.fail(f"id {x}: an input or output at location {at}; 0 to {MAX_LOCATIONS - 1} are allowed")
        if at in side:
            m.fail(f"location {at} is declared twice")
        if not kind.plain:
            m.fail(f"location {at}: a scalar or vector of 32 bits is needed")
        if where == (v.STAGE_FRAGMENT, INPUT) and kind.letter != "f" and FLAT not in marks:
            m.fail(f"location {at}: integers need Flat")
        if where in ((v.STAGE_VERTEX, INPUT), (v.STAGE_FRAGMENT, OUTPUT)) and marks.keys() & INTERPOLATED:
            m.fail(f"location {at}: nothing is interpolated there")
        side[at] = {"f": "float", "i": "int", "u": "uint"}[kind.letter], kind.components


def _is(m: Module, x: int, want: str) -> bool:
    """Whether a type is what a built-in is: a letter and how many, or an array of floats."""
    kind = m.types[x]
    if want == "array":
        return kind.kind == "array" and m.types[kind.of].kind == "float"
    return bool(want) and kind.letter in (want[0], "u" if want[0] == "i" else want[0]) and kind.components == int(want[1])


def _bytes(m: Module, x: int) -> int:
    """What a variable of this type takes at most: three of a vector count four."""
    kind = m.types[x]
    if kind.letter:
        return 4 * (4 if kind.components == 3 else kind.components)
    return sum(_bytes(m, part) for part in kind.members) if kind.kind == "struct" else kind.count * _bytes(m, kind.of)
