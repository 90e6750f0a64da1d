"""Instructions whose operands and results are numbers: those of `spirv_table.py`, held to their rows.

Each takes the `Body` that reads the functions, the words after the first, and where the instruction is; it gives its result a type, or
fails.
"""
from __future__ import annotations

from .spirv_module import INPUT, UNIFORM_CONSTANT, Type
from .spirv_table import ALIKE, EXTENDED, FRAGMENT_ONLY, INVERSE, POINTED, ROWS, SAME, SHAPED, SQUARE


def row(body, ops: tuple, at: int) -> None:
    """An instruction of `ROWS`."""
    op = body.words[at] & 0xFFFF
    how = ROWS[op]
    if len(ops) != 2 + how[2]:
        body.m.operands(ops, 2 + how[2], at, 2 + how[2])
    types = [body.value(x, at) for x in ops[2:]]
    _together(body, body.result(ops[0], ops[1], at), ops[0], types, how, at)
    if op in FRAGMENT_ONLY:
        body.only_fragments(op, at)


def _together(body, kind: Type, number: int, types: list[int], row: tuple, at: int) -> None:
    """The operands and the result go together as the row says."""
    made, taken, _, how = row
    if not kind.letter or kind.letter not in made:
        body.m.wrong(at, f"a result of type {kind.kind} {kind.letter}; letters {made} are allowed")
    for x in types:
        given = body.m.types[x]
        if how == SAME and x != number or not given.letter or given.letter not in taken or given.components != kind.components \
                or how == ALIKE and x != types[0]:
            body.m.wrong(at, "operands whose types do not go with the result's")


def extended(body, ops: tuple, at: int) -> None:
    """An instruction of GLSL.std.450."""
    m = body.m
    m.operands(ops, 4, at)
    if ops[2] != m.instructions or not m.instructions:
        m.wrong(at, "only the instructions of GLSL.std.450 are allowed")
    if ops[3] in POINTED:
        _pointed(body, ops, at)
        return
    types = [body.value(x, at) for x in ops[4:]]
    row, shaped, square = EXTENDED.get(ops[3]), SHAPED.get(ops[3]), ops[3] in SQUARE
    if not (row or shaped or square) or len(types) != (row[2] if row else len(shaped[1]) if shaped else 1):
        m.wrong(at, f"instruction {ops[3]} of GLSL.std.450 with {len(types)} operands is not allowed")
    kind = body.result(ops[0], ops[1], at)
    if row:
        _together(body, kind, ops[0], types, row, at)
    elif not (_shaped(body, kind, ops[0], types, *shaped) if shaped else _square(body, ops[0], types[0], ops[3])):
        m.wrong(at, "operands whose types do not go with the result's")


def _pointed(body, ops: tuple, at: int) -> None:
    """A result, and one more that is stored."""
    m = body.m
    m.operands(ops, 6, at, 6)
    given, target = body.value(ops[4], at), body.pointer(ops[5], at)
    kind, stored = body.result(ops[0], ops[1], at), m.types[target.of]
    if kind.letter != "f" or given != ops[0] or target.storage in (UNIFORM_CONSTANT, INPUT) or not stored.letter \
            or stored.letter not in POINTED[ops[3]] or stored.components != kind.components:
        m.wrong(at, "operands whose types do not go with the result's")


def _shaped(body, kind: Type, number: int, types: list[int], made: tuple, taken: tuple) -> bool:
    """Whether result (of several: the members of a structure) and operands have these letters and sizes."""
    results = kind.members if len(made) > 1 else (number,)
    size = 0
    for x, (letter, count) in zip((*results, *types), (*made, *taken)):
        found = body.m.types[x]
        size = size or found.components * (count == "n")
        if not found.letter or found.letter not in letter.replace("i", "iu"):
            return False
        if found.components != (size if count == "n" else int(count)):
            return False
    return len(results) == len(made)


def _square(body, number: int, given: int, op: int) -> bool:
    """The determinant or the inverse of a square matrix."""
    x = body.m.types[given]
    if x.kind != "matrix" or body.m.types[x.of].count != x.count:
        return False
    return number == (given if op == INVERSE else body.m.types[x.of].of)
