"""The words of a SPIR-V module, and what its declarations have made so far.

In: bytes. Out: a `Module` that the declarations (`spirv_types.py`), the functions (`spirv_body.py`) and the interface
(`spirv_interface.py`) fill and ask. Numbers are those of the SPIR-V specification, version 1.6, chapter 3.

A driver takes a module as it comes: what a few words declare, it makes. So whatever grows faster than the words is bounded here, far
above what any compiler of ours emits.
"""
from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import NoReturn

from .errors import BundleError

MAGIC, VERSION = 0x07230203, 0x00010000
MAX_WORDS = 1 << 20
MAX_COMPONENTS = 1 << 14  # scalars of one type
MAX_DEPTH = 16  # of arrays, matrices and structures in each other
MAX_WEIGHT = 1 << 16  # scalars of all variables, and of all values that are neither scalar nor vector
UNIFORM_CONSTANT, INPUT, OUTPUT, WORKGROUP, PRIVATE, FUNCTION, IMAGE = 0, 1, 3, 4, 6, 7, 11
STORAGES = (UNIFORM_CONSTANT, INPUT, OUTPUT, PRIVATE, FUNCTION)
COMPUTE_STORAGES = (WORKGROUP, IMAGE)  # of compute shaders alone


@dataclass(frozen=True)
class Type:
    """kind: void bool int uint float vector matrix array struct image sampled pointer function. components: scalars in all, 0 for what
    holds none. depth: how deep it nests. letter: b i u f of a scalar or vector, else "". count: immediate parts. of: id of the type of
    parts, of what is pointed to, of the image, or of what a function returns. members: ids of a structure's parts, or of parameters.
    Of images: integer, what a read gives; attachment, a subpass input; format, the VkFormat of a storage image, else 0."""

    kind: str
    components: int = 0
    depth: int = 0
    letter: str = ""
    count: int = 0
    of: int = 0
    members: tuple[int, ...] = ()
    storage: int = -1
    integer: bool = False
    attachment: bool = False
    format: int = 0

    @property
    def plain(self) -> bool:
        """A number, or a vector of numbers."""
        return self.letter not in ("", "b")


class Module:
    """types: id -> Type. values: id -> the id of its type. integers: id of a constant integer -> its bits. fixed: ids of constants.
    variables: (id, storage class, id of the type) of those outside functions. weight: scalars of what `weigh` counts."""

    def __init__(self, data, where: str):
        self.where, size = where, len(data)
        if size % 4 or size < 20:
            self.fail(f"{size} bytes are no SPIR-V module")
        if size > 4 * MAX_WORDS:
            self.fail(f"has {size // 4} words; at most {MAX_WORDS} are allowed")
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
        self.values: dict[int, int] = {}
        self.integers: dict[int, int] = {}
        self.fixed: set[int] = set()
        self.composites: dict[int, tuple[int, ...]] = {}  # of constants
        self.defined: set[int] = set()
        self.variables: list[tuple[int, int, int]] = []
        self.capabilities: set[int] = set()
        self.instructions = 0  # id of GLSL.std.450
        self.stage, self.entry = 0, 0
        self.listed: set[int] = set()  # what the entry point names
        self.touched: set[int] = set()  # pointers that functions use
        self.closed: dict[int, set[int]] = {}  # structures of built-ins -> the members that no shader may touch
        self.reached: set[tuple[int, int]] = set()  # their members that functions point to
        self.weight = 0

    def fail(self, what: str) -> NoReturn:
        """Raise BundleError."""
        raise BundleError(f"{self.where}: {what}")

    def wrong(self, at: int, what: str) -> NoReturn:
        """Raise BundleError about the instruction at this word."""
        self.fail(f"word {at}: {what}")

    def id(self, x: int, at: int) -> int:
        """An id within the bound."""
        if not 0 < x < self.bound:
            self.wrong(at, f"id {x}; ids from 1 to {self.bound - 1} are allowed")
        return x

    def define(self, x: int, at: int) -> int:
        """An id that nothing else defines."""
        if self.id(x, at) in self.defined:
            self.wrong(at, f"id {x} is defined twice")
        self.defined.add(x)
        return x

    def type(self, x: int, at: int) -> Type:
        """The type with this id, of those declared before."""
        if x not in self.types:
            self.wrong(at, f"id {x} is no type defined before")
        return self.types[x]

    def holds(self, x: int, at: int) -> Type:
        """The same, of a value: numbers, truth values, and what is built of them."""
        found = self.type(x, at)
        if not found.components or x in self.closed:
            self.wrong(at, f"a value of a type that holds no numbers (id {x}, {found.kind})")
        return found

    def operands(self, ops: tuple, least: int, at: int, most: int | None = None) -> None:
        """At least so many words after the first, or between two counts."""
        if not least <= len(ops) <= (len(ops) if most is None else most):
            needed = f"{least}" if most in (None, least) else f"{least} to {most}"
            self.wrong(at, f"opcode {self.words[at] & 0xFFFF} has {len(ops)} operands; {needed} are needed")

    def weigh(self, kind: Type, at: int) -> None:
        """Count what a driver has to make of a few words."""
        self.weight += kind.components
        if self.weight > MAX_WEIGHT:
            self.wrong(at, f"variables and composite values of more than {MAX_WEIGHT} numbers in all")

    def parts(self, kind: Type):
        """The ids of the types of its immediate parts."""
        return kind.members if kind.kind == "struct" else (kind.of,) * kind.count

    def text(self, words: tuple, at: int) -> bytes:
        """A string that ends in the last of these words, and nowhere before."""
        data = struct.pack(f"<{len(words)}I", *words)
        found, zero, rest = data.partition(b"\0")
        if not zero or any(rest) or len(rest) > 3:
            self.wrong(at, "a text that does not end in its last word")
        return found
