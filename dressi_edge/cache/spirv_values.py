"""Instructions within functions that look into composites, through pointers and at images, and those of matrices.

Each takes the `Body` that reads the functions, the words after the first, and where the instruction is; it gives its result a type, or
fails. In: ids of values. Out: nothing.
"""
from __future__ import annotations

from collections.abc import Callable

from .spirv_module import INPUT, UNIFORM_CONSTANT, Type

FRAGMENT = 16
BIAS, LOD, GRAD, OFFSET = 1, 2, 4, 8  # what follows the operands of an image instruction
QUERY = 50  # the capability


def _scalar(body, x: int, letters: str, at: int) -> Type:
    """The type of a scalar with one of these letters."""
    kind = body.m.types[body.value(x, at)]
    if kind.components != 1 or not kind.letter or kind.letter not in letters:
        body.m.wrong(at, f"id {x} is no scalar of letters {letters}")
    return kind


def _part(body, kind: int, index: int, at: int) -> int:
    """The id of the type of a part of a composite."""
    m = body.m
    found = m.types[kind]
    if index >= found.count:
        m.wrong(at, f"part {index} of {found.kind} with {found.count}")
    if kind in m.closed:
        if index in m.closed[kind]:
            m.wrong(at, f"built-in member {index}, which needs a feature")
        m.reached.add((kind, index))
    return found.members[index] if found.kind == "struct" else found.of


def _undefined(body, ops: tuple, at: int) -> None:
    body.m.operands(ops, 2, at, 2)
    body.m.holds(ops[0], at)
    body.result(ops[0], ops[1], at)


def _copy_memory(body, ops: tuple, at: int) -> None:
    m = body.m
    m.operands(ops, 2, at, 2)
    to, source = body.pointer(ops[0], at), body.pointer(ops[1], at)
    if to.of != source.of or to.of in m.closed or to.storage in (UNIFORM_CONSTANT, INPUT):
        m.wrong(at, "a copy between other types, or to where nothing may be stored")


def _access_chain(body, ops: tuple, at: int) -> None:
    m = body.m
    m.operands(ops, 3, at, 3 + 255)
    base = body.pointer(ops[2], at)
    kind = base.of
    for x in ops[3:]:
        _scalar(body, x, "iu", at)
        index = m.integers.get(x)
        if index is None and m.types[kind].kind == "struct":
            m.wrong(at, f"a member of a structure that is no constant (id {x})")
        kind = _part(body, kind, index or 0, at)
    made = m.type(ops[0], at)
    if made.kind != "pointer" or made.storage != base.storage or made.of != kind:
        m.wrong(at, "a pointer to another type than what is there, or of another storage class")
    body.result(ops[0], ops[1], at)


def _shuffle(body, ops: tuple, at: int) -> None:
    m = body.m
    m.operands(ops, 6, at)
    made = m.type(ops[0], at)
    pair = [m.types[body.value(x, at)] for x in ops[2:4]]
    if made.kind != "vector" or any(x.kind != "vector" or x.of != made.of for x in pair) or len(ops) - 4 != made.count \
            or any(x >= pair[0].count + pair[1].count and x != 0xFFFFFFFF for x in ops[4:]):
        m.wrong(at, "a shuffle of what is no vector of the result's scalars, or of scalars that they have not")
    body.result(ops[0], ops[1], at)


def _construct(body, ops: tuple, at: int) -> None:
    m = body.m
    m.operands(ops, 3, at)
    made = m.holds(ops[0], at)
    types = [body.value(x, at) for x in ops[2:]]
    if made.kind == "vector":
        parts = [m.types[x] for x in types]
        good = len(parts) > 1 and all(x.letter == made.letter and made.of in (t, x.of) for t, x in zip(types, parts)) \
            and sum(x.components for x in parts) == made.count
    else:
        good = made.count == len(types) and all(map(int.__eq__, types, m.parts(made)))
    if not good:
        m.wrong(at, "a composite of what its type has not")
    body.result(ops[0], ops[1], at)


def _extract(body, ops: tuple, at: int) -> None:
    m = body.m
    m.operands(ops, 4, at)
    kind = body.value(ops[2], at)
    for index in ops[3:]:
        kind = _part(body, kind, index, at)
    if kind != ops[0]:
        m.wrong(at, "a part of another type than the result's")
    body.result(ops[0], ops[1], at)


def _insert(body, ops: tuple, at: int) -> None:
    m = body.m
    m.operands(ops, 5, at)
    part, kind = body.value(ops[2], at), body.value(ops[3], at)
    whole = kind
    for index in ops[4:]:
        kind = _part(body, kind, index, at)
    if kind != part or whole != ops[0]:
        m.wrong(at, "a part of another type than what is there")
    body.result(ops[0], ops[1], at)


def _copy(body, ops: tuple, at: int) -> None:
    body.m.operands(ops, 3, at, 3)
    if body.value(ops[2], at) != ops[0] or not body.m.types[ops[0]].components:
        body.m.wrong(at, "a copy of another type, or of what holds no numbers")
    body.result(ops[0], ops[1], at)


def _transpose(body, ops: tuple, at: int) -> None:
    m = body.m
    m.operands(ops, 3, at, 3)
    made, x = m.type(ops[0], at), m.types[body.value(ops[2], at)]
    if made.kind != "matrix" or x.kind != "matrix" or (made.count, _rows(m, made)) != (_rows(m, x), x.count):
        m.wrong(at, "a transposed matrix of another size")
    body.result(ops[0], ops[1], at)


def _rows(m, matrix: Type) -> int:
    return m.types[matrix.of].count


# ---- images


def _operands(body, rest: tuple, allowed: int, at: int) -> None:
    """Bias, level of detail, gradients and offset after an image instruction's own operands."""
    m = body.m
    if not rest:
        return
    mask, ids = rest[0], list(rest[1:])
    if mask & ~allowed or mask == 0 and ids:
        m.wrong(at, f"image operands {mask}; {allowed} are allowed")
    for bit, letters, size in ((BIAS, "f", 1), (LOD, "fiu", 1), (GRAD, "f", 2), (GRAD, "f", 2), (OFFSET, "iu", 2)):
        if not mask & bit:
            continue
        kind = m.types[body.value(ids[0], at)] if ids else Type("void")
        if not kind.letter or kind.letter not in letters or kind.components != size or bit == OFFSET and ids[0] not in m.fixed:
            m.wrong(at, "an image operand that is missing or of another type")
        ids.pop(0)
    if ids:
        m.wrong(at, "more image operands than are named")


def _texel(body, ops: tuple, image: Type, at: int) -> None:
    """The result of a read: four numbers of the image's."""
    m = body.m
    made = m.type(ops[0], at)
    sampled = image if image.kind == "image" else m.types[image.of]
    if made.kind != "vector" or made.count != 4 or made.of != sampled.of:
        m.wrong(at, "a read of an image that gives another type than four of its numbers")
    body.result(ops[0], ops[1], at)


def image_operand(body, x: int, kind: str, at: int, attachment: bool = False, storage: bool = False) -> Type:
    """The type of an operand that is an image: one to sample, of a subpass, or to write."""
    found = body.m.types[body.value(x, at)]
    if found.kind != kind or found.attachment != attachment or bool(found.format) != storage:
        body.m.wrong(at, f"id {x} is no {kind}{' of a subpass' if attachment else ' to write' if storage else ''}")
    return found


def place(body, x: int, letters: str, least: int, at: int, most: int = 4) -> None:
    """An operand that says where in an image."""
    kind = body.m.types[body.value(x, at)]
    if not kind.letter or kind.letter not in letters or not least <= kind.components <= most:
        body.m.wrong(at, f"id {x} is no place in an image")


def _sample(explicit: bool, projective: bool):
    def check(body, ops: tuple, at: int) -> None:
        body.m.operands(ops, 4, at)
        image = image_operand(body, ops[2], "sampled", at)
        if not explicit:
            body.only_fragments(body.words[at] & 0xFFFF, at)
        place(body, ops[3], "f", 2 + projective, at)
        if explicit and (len(ops) < 5 or ops[4] & (LOD | GRAD) not in (LOD, GRAD)):
            body.m.wrong(at, "a sample with neither a level of detail nor gradients")
        if explicit and ops[4] & LOD and len(ops) > 5:
            _scalar(body, ops[5], "f", at)
        _operands(body, ops[4:], OFFSET | (LOD | GRAD if explicit else BIAS), at)
        _texel(body, ops, image, at)
    return check


def _fetch(body, ops: tuple, at: int) -> None:
    m = body.m
    m.operands(ops, 4, at)
    image = image_operand(body, ops[2], "image", at)
    place(body, ops[3], "iu", 2, at)
    if len(ops) > 5 and ops[4] & LOD:
        _scalar(body, ops[5], "iu", at)
    _operands(body, ops[4:], LOD | OFFSET, at)
    _texel(body, ops, image, at)


def _gather(body, ops: tuple, at: int) -> None:
    body.m.operands(ops, 5, at)
    image = image_operand(body, ops[2], "sampled", at)
    place(body, ops[3], "f", 2, at)
    _scalar(body, ops[4], "iu", at)
    _operands(body, ops[5:], OFFSET, at)
    _texel(body, ops, image, at)


def _read(body, ops: tuple, at: int) -> None:
    """Of a subpass input."""
    body.m.operands(ops, 4, at, 4)
    image = image_operand(body, ops[2], "image", at, True)
    if body.m.stage != FRAGMENT:
        body.m.wrong(at, "a subpass input belongs to fragment shaders")
    place(body, ops[3], "iu", 2, at)
    _texel(body, ops, image, at)


def _image(body, ops: tuple, at: int) -> None:
    m = body.m
    m.operands(ops, 3, at, 3)
    if image_operand(body, ops[2], "sampled", at).of != ops[0]:
        m.wrong(at, "the image of a combined sampler, of another type")
    body.result(ops[0], ops[1], at)


def _query(kind: str, letters: str, size: int, more: tuple[str, int] | None):
    def check(body, ops: tuple, at: int) -> None:
        m = body.m
        m.operands(ops, 3 + bool(more), at, 3 + bool(more))
        image_operand(body, ops[2], kind, at)
        if kind == "sampled":
            body.only_fragments(body.words[at] & 0xFFFF, at)
        if more:
            place(body, ops[3], more[0], more[1], at, 1 if more[1] == 1 else 4)
        made = m.type(ops[0], at)
        if QUERY not in m.capabilities or not made.letter or made.letter not in letters or made.components != size:
            m.wrong(at, f"a query without capability {QUERY}, or of another type")
        body.result(ops[0], ops[1], at)
    return check


# ---- matrices, and numbers of several sizes


def _product(body, ops: tuple, at: int) -> None:
    """Opcodes 142 to 148: vector and matrix times scalar, vector and matrix in each order, outer and dot product."""
    m, op = body.m, body.words[at] & 0xFFFF
    m.operands(ops, 4, at, 4)
    a, b = (body.value(x, at) for x in ops[2:])
    made, x, y = m.type(ops[0], at), m.types[a], m.types[b]
    scalar, column = y.kind == "float", x.kind == "vector" and x.letter == "f"
    good = {142: lambda: column and scalar and a == ops[0],
            143: lambda: x.kind == "matrix" and scalar and a == ops[0],
            144: lambda: column and y.kind == "matrix" and y.of == a and _floats(made, y.count),
            145: lambda: x.kind == "matrix" and _floats(y, x.count) and x.of == ops[0],
            146: lambda: x.kind == y.kind == made.kind == "matrix" and _rows(m, y) == x.count and made.of == x.of and made.count == y.count,
            147: lambda: column and y.letter == "f" and made.kind == "matrix" and made.of == a and made.count == y.count > 1,
            148: lambda: column and a == b and made.kind == "float"}[op]
    if not good():
        m.wrong(at, "a product of types that do not go together")
    body.result(ops[0], ops[1], at)


def _floats(kind: Type, count: int) -> bool:
    return kind.kind == "vector" and kind.letter == "f" and kind.count == count


def _wide(body, ops: tuple, at: int) -> None:
    """Opcodes 149 to 152: results of twice the bits, as a structure of two."""
    m, op = body.m, body.words[at] & 0xFFFF
    m.operands(ops, 4, at, 4)
    types = {body.value(x, at) for x in ops[2:]}
    made = m.type(ops[0], at)
    letters = "iu" if op == 152 else "u"
    if made.kind != "struct" or made.count != 2 or types != set(made.members) or len(types) != 1 \
            or not (letter := m.types[ops[0]].members and m.types[made.members[0]].letter) or letter not in letters:
        m.wrong(at, "a result that is no structure of two of the operands' type")
    body.result(ops[0], ops[1], at)


def _any_all(body, ops: tuple, at: int) -> None:
    m = body.m
    m.operands(ops, 3, at, 3)
    x = m.types[body.value(ops[2], at)]
    if m.type(ops[0], at).kind != "bool" or x.kind != "vector" or x.letter != "b":
        m.wrong(at, "any or all of what is no vector of truth values")
    body.result(ops[0], ops[1], at)


def _select(body, ops: tuple, at: int) -> None:
    m = body.m
    m.operands(ops, 5, at, 5)
    made, which = m.type(ops[0], at), m.types[body.value(ops[2], at)]
    if not made.letter or which.letter != "b" or which.components != made.components or any(body.value(x, at) != ops[0] for x in ops[3:]):
        m.wrong(at, "a choice among other types, or by what is no truth value for each number")
    body.result(ops[0], ops[1], at)


def _bit_field(count: int):
    """Of the result's type, `count` operands; then offset and number of bits."""
    def check(body, ops: tuple, at: int) -> None:
        m = body.m
        m.operands(ops, 4 + count, at, 4 + count)
        made = m.type(ops[0], at)
        if made.letter not in ("i", "u") or any(body.value(x, at) != ops[0] for x in ops[2:2 + count]):
            m.wrong(at, "bits of what is no integer of the result's type")
        for x in ops[2 + count:]:
            _scalar(body, x, "iu", at)
        body.result(ops[0], ops[1], at)
    return check


VALUES: dict[int, Callable] = {
    1: _undefined, 63: _copy_memory, 65: _access_chain, 66: _access_chain, 79: _shuffle, 80: _construct, 81: _extract, 82: _insert,
    83: _copy, 84: _transpose, 87: _sample(False, False), 88: _sample(True, False), 91: _sample(False, True), 92: _sample(True, True),
    95: _fetch, 96: _gather, 98: _read, 100: _image, 103: _query("image", "iu", 2, ("iu", 1)), 105: _query("sampled", "f", 2, ("f", 2)),
    106: _query("image", "iu", 1, None), 154: _any_all, 155: _any_all, 169: _select, 201: _bit_field(2), 202: _bit_field(1),
    203: _bit_field(1)}
VALUES |= dict.fromkeys(range(142, 149), _product) | dict.fromkeys(range(149, 153), _wide)
