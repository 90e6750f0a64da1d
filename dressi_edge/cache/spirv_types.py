"""Types and constants of a SPIR-V module.

In: an instruction before the first function. Out: entries of `Module.types`, `values`, `integers` and `fixed`, or a BundleError:
widths other than 32, vectors and matrices that are not of 2 to 4, arrays whose length is no constant above 0, constants that are not
of their type, whatever is larger or deeper than `spirv_module.py` allows.
"""
from __future__ import annotations

from . import vulkan as v
from .spirv_module import COMPUTE_STORAGES, IMAGE, MAX_COMPONENTS, MAX_DEPTH, OUTPUT, STORAGES, UNIFORM_CONSTANT, Module, Type

# opcode: how many words a type has after the first, at least and at most
LENGTHS = {19: (1, 1), 20: (1, 1), 21: (3, 3), 22: (2, 2), 23: (3, 3), 24: (3, 3), 25: (8, 8), 27: (2, 2), 28: (3, 3), 30: (1, None),
           32: (3, 3), 33: (2, 257)}
UNIQUE = frozenset({19, 20, 21, 22, 23, 24, 25, 27, 33})  # two of them are one type
CONSTANTS = {1: (2, 2), 41: (2, 2), 42: (2, 2), 43: (3, 3), 44: (2, None), 46: (2, 2)}
UNDEFINED, TRUE, FALSE, NUMBER, COMPOSITE = 1, 41, 42, 43, 44


def declare_type(m: Module, op: int, ops: tuple, at: int, seen: set) -> None:
    """OpType...; `seen`: those that may not come again."""
    if op not in LENGTHS:
        m.wrong(at, f"opcode {op} makes a type that is not allowed")
    m.operands(ops, LENGTHS[op][0], at, LENGTHS[op][1])
    if op in UNIQUE:
        if (op, ops[1:]) in seen:
            m.wrong(at, f"a type that there is already (opcode {op})")
        seen.add((op, ops[1:]))
    made = _MAKE[op](m, ops, at)
    if made.components > MAX_COMPONENTS:
        m.wrong(at, f"a type of {made.components} numbers; at most {MAX_COMPONENTS} are allowed")
    if made.depth > MAX_DEPTH:
        m.wrong(at, f"a type nested {made.depth} deep; at most {MAX_DEPTH} is allowed")
    m.types[m.define(ops[0], at)] = made


def declare_constant(m: Module, op: int, ops: tuple, at: int) -> None:
    """OpConstant..., and an undefined value outside functions."""
    m.operands(ops, CONSTANTS[op][0], at, CONSTANTS[op][1])
    kind = m.holds(ops[0], at)
    if op in (TRUE, FALSE) and kind.kind != "bool":
        m.wrong(at, f"a truth value of type {kind.kind}")
    if op == NUMBER:
        if not kind.plain or kind.components != 1:
            m.wrong(at, f"a number of type {kind.kind}")
        if kind.letter != "f":
            m.integers[ops[1]] = ops[2]
    if op == COMPOSITE:
        if not kind.count or len(ops) - 2 != kind.count:
            m.wrong(at, f"a constant of {len(ops) - 2} parts; its type has {kind.count}")
        for x, part in zip(ops[2:], m.parts(kind)):
            if x not in m.fixed or m.values[x] != part:
                m.wrong(at, f"a part (id {m.id(x, at)}) that is no constant of the type of the part")
        m.composites[ops[1]] = ops[2:]
    if not kind.letter:
        m.weigh(kind, at)
    m.fixed.add(m.define(ops[1], at))
    m.values[ops[1]] = ops[0]


def _no_operand(kind: str, letter: str = ""):
    def make(m: Module, ops: tuple, at: int) -> Type:
        return Type(kind, len(letter), letter=letter)
    return make


def _integer(m: Module, ops: tuple, at: int) -> Type:
    if ops[1] != 32 or ops[2] > 1:
        m.wrong(at, f"integers of {ops[1]} bits and signedness {ops[2]}; 32 bits, and 0 or 1, are allowed")
    return Type(*(("int", 1, 0, "i") if ops[2] else ("uint", 1, 0, "u")))


def _float(m: Module, ops: tuple, at: int) -> Type:
    if ops[1] != 32:
        m.wrong(at, f"floats of {ops[1]} bits; 32 are allowed")
    return Type("float", 1, 0, "f")


def _vector(m: Module, ops: tuple, at: int) -> Type:
    x = m.type(ops[1], at)
    if not x.letter or x.components != 1 or not 2 <= ops[2] <= 4:
        m.wrong(at, f"a vector of {ops[2]} of {x.kind}; 2 to 4 scalars are allowed")
    return Type("vector", ops[2], 1, x.letter, ops[2], ops[1])


def _matrix(m: Module, ops: tuple, at: int) -> Type:
    x = m.type(ops[1], at)
    if x.kind != "vector" or x.letter != "f" or not 2 <= ops[2] <= 4:
        m.wrong(at, f"a matrix of {ops[2]} columns of {x.kind}; 2 to 4 vectors of floats are allowed")
    return Type("matrix", x.components * ops[2], 2, count=ops[2], of=ops[1])


def _image(m: Module, ops: tuple, at: int) -> Type:
    x = m.type(ops[1], at)
    _, _, dim, depth, arrayed, multisampled, sampled, image_format = ops
    if x.kind not in ("float", "int"):
        m.wrong(at, "an image of what is neither float nor int")
    storage = v.STORABLE.get(image_format, 0) if m.stage == v.STAGE_COMPUTE and (dim, sampled) == (1, 2) else 0
    if ((dim, sampled) not in ((1, 1), (6, 2)) or image_format) and not storage or depth not in (0, 2) or arrayed or multisampled:
        m.wrong(at, "an image that is neither sampled 2D nor subpass input nor, of a compute shader, storage of a format for it")
    if storage and (storage in v.INTEGER_FORMATS) != (x.kind == "int"):
        m.wrong(at, "a storage image whose format does not hold its numbers")
    if dim == 6 and 40 not in m.capabilities:
        m.wrong(at, "a subpass input without capability 40")
    return Type("image", of=ops[1], integer=x.kind == "int", attachment=dim == 6, format=storage)


def _sampled(m: Module, ops: tuple, at: int) -> Type:
    x = m.type(ops[1], at)
    if x.kind != "image" or x.attachment or x.format:
        m.wrong(at, "a combined sampler of what is no sampled image")
    return Type("sampled", of=ops[1], integer=x.integer)


def _array(m: Module, ops: tuple, at: int) -> Type:
    x, length = m.holds(ops[1], at), m.integers.get(ops[2], 0)
    if not 0 < length < 1 << 31:
        m.wrong(at, f"an array whose length (id {m.id(ops[2], at)}) is no constant integer above 0")
    return Type("array", x.components * length, x.depth + 1, count=length, of=ops[1])


def _struct(m: Module, ops: tuple, at: int) -> Type:
    found = [m.holds(x, at) for x in ops[1:]]
    return Type("struct", sum(x.components for x in found), 1 + max((x.depth for x in found), default=0), count=len(found),
                members=ops[1:])


def _pointer(m: Module, ops: tuple, at: int) -> Type:
    if ops[1] not in STORAGES and not (m.stage == v.STAGE_COMPUTE and ops[1] in COMPUTE_STORAGES):
        m.wrong(at, f"a pointer to storage class {ops[1]}; images, inputs, outputs, private and local variables, and those that the "
                    "invocations of a compute shader share, are allowed")
    x = m.type(ops[2], at)
    if x.kind not in ("image", "sampled") if ops[1] == UNIFORM_CONSTANT else not x.components:
        m.wrong(at, f"a pointer of storage class {ops[1]} to {x.kind}")
    if ops[2] in m.closed and ops[1] != OUTPUT:
        m.wrong(at, f"a structure of built-ins in storage class {ops[1]}; outputs are allowed")
    if ops[1] == IMAGE and x.kind != "int":
        m.wrong(at, f"a pointer to texels that are {x.kind}; int is allowed")
    return Type("pointer", of=ops[2], storage=ops[1])


def _function(m: Module, ops: tuple, at: int) -> Type:
    for x in ops[1:]:
        if m.type(x, at).kind in ("function", "image", "sampled") or x != ops[1] and m.types[x].kind == "void":
            m.wrong(at, f"a function that takes or returns {m.types[x].kind}")
        if m.types[x].kind == "pointer" and m.types[x].storage in COMPUTE_STORAGES:
            m.wrong(at, "a function that takes a pointer to what invocations share")
    if m.types[ops[1]].kind == "pointer" or ops[1] in ops[2:] and m.types[ops[1]].kind == "void":
        m.wrong(at, f"a function that {'returns a pointer' if m.types[ops[1]].kind == 'pointer' else 'takes void'}")
    return Type("function", of=ops[1], members=ops[2:])


_MAKE = {19: _no_operand("void"), 20: _no_operand("bool", "b"), 21: _integer, 22: _float, 23: _vector, 24: _matrix, 25: _image,
         27: _sampled, 28: _array, 30: _struct, 32: _pointer, 33: _function}
