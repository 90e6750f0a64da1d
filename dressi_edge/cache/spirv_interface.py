"""What a shader binds, takes and gives, read from its SPIR-V.

In: the bytes of a module. Out: its `Interface`, or a BundleError and nothing else. Linear in the bytes.

Modules are held to what a player needs: SPIR-V 1.0, the opcodes, capabilities and storage classes of vertex and fragment
shaders that touch nothing but descriptors, varyings and their own variables, every id within the bound, one entry point `main`.
No more is promised: types inside functions and termination are not checked (spirv-val saw the module when it was compiled).
Numbers are those of the SPIR-V specification, version 1.6, chapter 3.
"""
from __future__ import annotations

import struct
import sys
from dataclasses import dataclass, field

from . import vulkan as v
from .errors import BundleError

MAGIC, VERSION = 0x07230203, 0x00010000
MAX_LOCATIONS = 64  # more than any known device has
HUGE = 1 << 20  # component counts stop here
MODELS = {0: v.STAGE_VERTEX, 4: v.STAGE_FRAGMENT}
CAPABILITIES = frozenset({0, 1, 40, 50, 51})  # Matrix Shader InputAttachment ImageQuery DerivativeControl: need no feature
MODES = frozenset({7, 9, 12, 14, 15, 16})  # OriginUpperLeft EarlyFragmentTests DepthReplacing -Greater -Less -Unchanged
UNIFORM_CONSTANT, INPUT, OUTPUT, PRIVATE, FUNCTION = 0, 1, 3, 6, 7
FLAT, BUILTIN, LOCATION, COMPONENT, INDEX, BINDING, SET, ATTACHMENT = 14, 11, 30, 31, 32, 33, 34, 43
_ONCE = frozenset({BUILTIN, LOCATION, COMPONENT, INDEX, BINDING, SET, ATTACHMENT})

# opcode: how many of its first operands are ids; 9 stands for all. What is not here is refused.
_ALL = 9
BODY = dict.fromkeys((*range(109, 117), 124, *range(126, 153), *range(154, 192), *range(194, 206), *range(207, 216)), _ALL)
BODY |= {1: 2, 8: 1, 12: 3, 54: 2, 55: 2, 56: 0, 57: 3, 59: 3, 61: 3, 62: 2, 63: 2, 65: _ALL, 66: _ALL, 79: 4, 80: _ALL,
         81: 3, 82: 4, 83: 3, 84: 3, 86: 4, 87: 4, 88: 4, 91: 4, 92: 4, 95: 4, 96: 5, 98: 4, 100: 3, 103: 4, 104: 3, 105: 4,
         106: 3, 245: _ALL, 246: 2, 247: 1, 248: 1, 249: 1, 250: 3, 251: 2, 252: 0, 253: 0, 254: 1, 255: 0, 317: 0}
_IGNORED = frozenset({2, 3, 4, 5, 6, 7, 8, 317, 330})  # sources, names, lines
_TYPED = {1: 2, 41: 2, 42: 2, 43: 2, 44: _ALL, 46: 2}  # undefined values and constants


@dataclass(frozen=True)
class Type:
    """A type as far as an interface needs it. `kind`: float int uint image sampled struct pointer other; `components` of
    scalars, vectors and what is built of them, 0 for what cannot be an interface variable."""

    kind: str
    components: int = 0
    plain: bool = False  # a scalar or vector of 32 bits
    pointee: int = 0
    storage: int = -1
    integer: bool = False  # of images: what a read gives
    attachment: bool = False  # of images: a subpass input


@dataclass(frozen=True)
class Interface:
    """`bindings`: number -> (descriptor kind, reads integers, input attachment index or -1). `inputs`, `outputs`: location ->
    (float int uint, components). `input_components`, `output_components`: whole locations and the built-ins."""

    stage: int
    bindings: dict[int, tuple[int, bool, int]] = field(default_factory=dict)
    inputs: dict[int, tuple[str, int]] = field(default_factory=dict)
    outputs: dict[int, tuple[str, int]] = field(default_factory=dict)
    input_components: int = 0
    output_components: int = 0


def parse(data: bytes, where: str = "shader") -> Interface:
    """The interface of a module. Raises BundleError and nothing else."""
    return _Module(data, where).interface()


class _Steps(dict):
    """First word of an instruction in a function -> how many words it has, negated for functions, calls and variables;
    LookupError for what is not allowed. Filled as it is asked: there are few different ones."""

    def __missing__(self, word: int) -> int:
        count, op = word >> 16, word & 0xFFFF
        if not count or not (BODY[op] < count or BODY[op] == _ALL):
            raise LookupError
        self[word] = -count if op in (54, 57, 59) else count
        return self[word]


class _Module:
    def __init__(self, data, where: str):
        self.where, self.data = where, data
        size = len(data)
        if size % 4 or size < 20:
            self.fail(f"{size} bytes are no SPIR-V module")
        self.words = words = struct.unpack(f"<{size // 4}I", data)
        if words[0] != MAGIC:
            self.fail(f"begins with {words[0]:#010x}; SPIR-V begins with {MAGIC:#010x}")
        if words[1] != VERSION:
            self.fail(f"is SPIR-V version {words[1]:#x}; 1.0 ({VERSION:#x}) is allowed")
        self.bound = words[3]
        if not 0 < self.bound <= len(words):
            self.fail(f"has ids up to {self.bound}; at most one a word, {len(words)}, is allowed")
        if words[4]:
            self.fail(f"has the reserved word {words[4]}; 0 is allowed")
        self.types: dict[int, Type] = {}
        self.constants: dict[int, int] = {}
        self.defined: set[int] = set()
        self.decorations: dict[int, dict[int, int]] = {}
        self.builtin_blocks: set[int] = set()
        self.variables: list[tuple[int, int, int]] = []  # id, storage class, pointee
        self.modes: set[int] = set()
        self.stage: int | None = None
        self.entry = 0
        self._functions(self._declarations())

    def fail(self, what: str):
        raise BundleError(f"{self.where}: {what}")

    # ---- instructions

    def _declarations(self) -> int:
        """Everything before the first function; where that is."""
        words, at, end = self.words, 5, len(self.words)
        while at < end:
            count, op = words[at] >> 16, words[at] & 0xFFFF
            if not count or count > end - at:
                self.fail(f"word {at}: an instruction of {count} words; {end - at} are left")
            if op == 54:
                return at
            if op not in _IGNORED:
                self._declaration(op, words[at + 1:at + count], at)
            at += count
        self.fail("has no function")

    def _functions(self, start: int) -> None:
        """Every instruction of the functions is known, its ids are within the bound, and what is called is there."""
        words, end, steps = self.words, len(self.words), _Steps()
        if self.stage is None:
            self.fail("has no entry point")
        at, n, step, noted, sound = start, 0, 0, [], True
        try:
            while at < end:  # the one loop over all instructions: whatever else there is to do is done at C's speed
                step = steps[words[at]]
                if step < 0:
                    noted.append(at)
                    step = -step
                at += step
                n += 1
        except LookupError:
            sound = False
        # if only the n first words of instructions have a high half, the words without one are the operands
        halves = memoryview(self.data).cast("B").cast("H")[2 * start:].tolist()
        high, low = halves[1::2], halves[::2]
        sound = sound and at == end and sys.byteorder == "little" and len(high) - high.count(0) == n
        if not sound or max(low) >= self.bound and max(filter((1 << 16).__gt__, words[start:]), default=0) >= self.bound:
            self._each(start)
        if words[-1] != 0x10038 or step != 1:
            self.fail("ends within a function")
        calls, functions = {self.entry}, set()
        for at in noted:
            op = words[at] & 0xFFFF
            if op == 59:
                if words[at + 3] != FUNCTION:
                    self.fail(f"word {at}: a variable in a function that is not its own")
            elif op == 54:
                functions.add(words[at + 2])
            else:
                calls.add(words[at + 3])
        if not calls <= functions:
            self.fail("calls a function that is not there" if self.entry in functions else "lacks the entry point's function")

    def _each(self, at: int) -> None:
        """The same one by one: names what is wrong, and accepts literals beyond the bound."""
        words, end, bound = self.words, len(self.words), self.bound
        while at < end:
            count, op = words[at] >> 16, words[at] & 0xFFFF
            if not count or count > end - at:
                self.fail(f"word {at}: an instruction of {count} words; {end - at} are left")
            ids = BODY.get(op)
            if ids is None:
                self.fail(f"word {at}: opcode {op} is not allowed in a function")
            if ids != _ALL and ids >= count:
                self.fail(f"word {at}: opcode {op} has {count - 1} operands; {ids} are needed")
            top = max(words[at + 1:at + (count if ids == _ALL else 1 + ids)], default=0)
            if top >= bound:
                self.fail(f"word {at}: id {top}; ids below {bound} are allowed")
            at += count

    def _id(self, x: int, at: int) -> int:
        if not 0 < x < self.bound:
            self.fail(f"word {at}: id {x}; ids from 1 to {self.bound - 1} are allowed")
        return x

    def _define(self, x: int, at: int) -> int:
        if self._id(x, at) in self.defined:
            self.fail(f"word {at}: id {x} is defined twice")
        self.defined.add(x)
        return x

    def _type(self, x: int, at: int) -> Type:
        if x not in self.types:
            self.fail(f"word {at}: id {x} is no type defined before")
        return self.types[x]

    def _operands(self, ops: tuple, least: int, at: int) -> None:
        if len(ops) < least:
            self.fail(f"word {at}: opcode {self.words[at] & 0xFFFF} has {len(ops)} operands; {least} are needed")

    def _declaration(self, op: int, ops: tuple, at: int) -> None:
        if 19 <= op <= 33:
            self._operands(ops, 1, at)
            self.types[self._define(ops[0], at)] = self._new_type(op, ops, at)
        elif op in _TYPED:
            self._operands(ops, 3 if op == 43 else 2, at)
            self._type(ops[0], at)
            for x in ops[1:] if _TYPED[op] == _ALL else ops[1:2]:
                self._id(x, at)
            self._define(ops[1], at)
            if op == 43:
                self.constants[ops[1]] = ops[2]
        elif op == 59:
            self._variable(ops, at)
        elif op == 71 or op == 72:
            self._decoration(op, ops, at)
        elif op == 17:
            self._operands(ops, 1, at)
            if ops[0] not in CAPABILITIES:
                self.fail(f"word {at}: capability {ops[0]} is not allowed")
        elif op == 11:
            self._operands(ops, 2, at)
            self._define(ops[0], at)
            if self._text(ops[1:]) != b"GLSL.std.450":
                self.fail(f"word {at}: only the instructions of GLSL.std.450 are allowed")
        elif op == 14:
            if ops != (0, 1):
                self.fail(f"word {at}: the memory model must be Logical GLSL450")
        elif op == 15:
            self._entry(ops, at)
        elif op == 16:
            self._operands(ops, 2, at)
            self._id(ops[0], at)
            if ops[1] not in MODES:
                self.fail(f"word {at}: execution mode {ops[1]} is not allowed")
            self.modes.add(ops[1])
        else:
            self.fail(f"word {at}: opcode {op} is not allowed before the functions")

    @staticmethod
    def _text(words: tuple) -> bytes:
        return struct.pack(f"<{len(words)}I", *words).partition(b"\0")[0]

    def _entry(self, ops: tuple, at: int) -> None:
        self._operands(ops, 3, at)
        if self.stage is not None:
            self.fail(f"word {at}: a second entry point")
        if ops[0] not in MODELS:
            self.fail(f"word {at}: execution model {ops[0]}; vertex (0) and fragment (4) are allowed")
        if ops[2:4] != struct.unpack("<2I", b"main\0\0\0\0"):
            self.fail(f"word {at}: the entry point must be called main")
        for x in (ops[1], *ops[4:]):
            self._id(x, at)
        self.stage, self.entry = MODELS[ops[0]], ops[1]

    def _new_type(self, op: int, ops: tuple, at: int) -> Type:
        def need(least: int) -> None:
            self._operands(ops, least, at)

        if op == 21:
            need(3)
            return Type("int" if ops[2] else "uint", 1, ops[1] == 32)
        if op == 22:
            need(2)
            return Type("float", 1, ops[1] == 32)
        if op == 23:
            need(3)
            x = self._type(ops[1], at)
            return Type(x.kind, min(HUGE, x.components * ops[2]), x.plain and x.components == 1 and 2 <= ops[2] <= 4)
        if op == 24 or op == 28:
            need(3)
            x = self._type(ops[1], at)
            length = ops[2] if op == 24 else self.constants.get(ops[2], 0)
            return Type("other", min(HUGE, x.components * length))
        if op == 25:
            return self._image(ops, at)
        if op == 27:
            need(2)
            x = self._type(ops[1], at)
            if x.kind != "image" or x.attachment:
                self.fail(f"word {at}: a combined sampler of what is no sampled image")
            return Type("sampled", integer=x.integer)
        if op == 30:
            return Type("struct", min(HUGE, sum(self._type(x, at).components for x in ops[1:])))
        if op == 32:
            need(3)
            self._type(ops[2], at)
            return Type("pointer", pointee=ops[2], storage=ops[1])
        if op == 33:
            need(2)
            for x in ops[1:]:
                self._type(x, at)
            return Type("other")
        if op in (19, 20):
            return Type("other")
        self.fail(f"word {at}: opcode {op} makes a type that is not allowed")

    def _image(self, ops: tuple, at: int) -> Type:
        self._operands(ops, 8, at)
        x = self._type(ops[1], at)
        _, _, dim, depth, arrayed, multisampled, sampled, image_format = ops[:8]
        if not x.plain or x.components != 1 or x.kind == "uint":
            self.fail(f"word {at}: an image of what is neither float nor int")
        if (dim, sampled) not in ((1, 1), (6, 2)) or depth == 1 or arrayed or multisampled or image_format:
            self.fail(f"word {at}: an image that is neither sampled 2D nor subpass input")
        return Type("image", integer=x.kind == "int", attachment=dim == 6)

    def _variable(self, ops: tuple, at: int) -> None:
        self._operands(ops, 3, at)
        pointer = self._type(ops[0], at)
        if pointer.kind != "pointer" or pointer.storage != ops[2]:
            self.fail(f"word {at}: a variable whose type is no pointer to its storage class")
        if ops[2] not in (UNIFORM_CONSTANT, INPUT, OUTPUT, PRIVATE):
            self.fail(f"word {at}: a variable of storage class {ops[2]}; images, inputs, outputs and private ones are allowed")
        for x in ops[3:]:
            self._id(x, at)
        self.variables.append((self._define(ops[1], at), ops[2], pointer.pointee))

    def _decoration(self, op: int, ops: tuple, at: int) -> None:
        member = op == 72
        self._operands(ops, 2 + member, at)
        self._id(ops[0], at)
        kind, rest = ops[1 + member], ops[2 + member:]
        if member:
            if kind == BUILTIN:
                self.builtin_blocks.add(ops[0])
            elif kind in _ONCE:
                self.fail(f"word {at}: decoration {kind} of a member is not allowed")
            return
        mine = self.decorations.setdefault(ops[0], {})
        if kind in _ONCE:
            self._operands(rest, 1, at)
            if kind in mine or kind in (COMPONENT, INDEX):
                self.fail(f"word {at}: decoration {kind} {'twice' if kind in mine else 'is not allowed'}")
        mine[kind] = rest[0] if rest else 1

    # ---- what it means

    def interface(self) -> Interface:
        stage = self.stage
        if stage == v.STAGE_FRAGMENT and 7 not in self.modes:
            self.fail("is a fragment shader without OriginUpperLeft")
        bindings: dict[int, tuple[int, bool, int]] = {}
        sides: dict[int, dict[int, tuple[str, int]]] = {INPUT: {}, OUTPUT: {}}
        extra = {INPUT: 0, OUTPUT: 0}
        for x, storage, pointee in self.variables:
            marks, kind = self.decorations.get(x, {}), self.types[pointee]
            if storage == UNIFORM_CONSTANT:
                self._bind(x, marks, kind, stage, bindings)
            elif storage in sides:
                if BUILTIN in marks or kind.kind == "struct" and pointee in self.builtin_blocks:
                    extra[storage] += kind.components
                else:
                    self._locate(x, marks, kind, sides[storage], flat=stage == v.STAGE_FRAGMENT and storage == INPUT)
        if stage == v.STAGE_VERTEX and sides[INPUT]:
            self.fail("takes vertex attributes; a bundle has none")
        count = {side: 4 * (max(sides[side], default=-1) + 1) + extra[side] for side in sides}
        return Interface(stage, bindings, sides[INPUT], sides[OUTPUT], count[INPUT], count[OUTPUT])

    def _bind(self, x: int, marks: dict, kind: Type, stage: int, bindings: dict) -> None:
        if kind.kind not in ("image", "sampled"):
            self.fail(f"id {x}: a descriptor that is neither image nor combined sampler")
        if marks.get(SET) != 0 or BINDING not in marks:
            self.fail(f"id {x}: a descriptor needs set 0 and a binding")
        number = marks[BINDING]
        if number in bindings:
            self.fail(f"binding {number} is declared twice")
        if kind.attachment and (stage != v.STAGE_FRAGMENT or ATTACHMENT not in marks):
            self.fail(f"binding {number}: an input attachment needs an index, in a fragment shader")
        what = (v.DESCRIPTOR_COMBINED_IMAGE_SAMPLER if kind.kind == "sampled" else
                v.DESCRIPTOR_INPUT_ATTACHMENT if kind.attachment else v.DESCRIPTOR_SAMPLED_IMAGE)
        bindings[number] = what, kind.integer, marks[ATTACHMENT] if kind.attachment else -1

    def _locate(self, x: int, marks: dict, kind: Type, side: dict, flat: bool) -> None:
        at = marks.get(LOCATION)
        if at is None or at >= MAX_LOCATIONS:
            self.fail(f"id {x}: an input or output at location {at}; 0 to {MAX_LOCATIONS - 1} are allowed")
        if at in side:
            self.fail(f"location {at} is declared twice")
        if not kind.plain:
            self.fail(f"location {at}: a scalar or vector of 32 bits is needed")
        if flat and kind.kind != "float" and FLAT not in marks:
            self.fail(f"location {at}: integers need Flat")
        side[at] = kind.kind, kind.components
