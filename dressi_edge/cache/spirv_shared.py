"""Instructions of compute shaders alone: texels that are written, sums that several invocations add to, and where they wait for each other.

Each takes the `Body` that reads the functions, the words after the first, and where the instruction is, or fails. What an atomic gives
back depends on who came first, so that nothing may use it: sums of integers are the same in any order, and whoever reads them later
cannot tell in which they were made.
"""
from __future__ import annotations

from collections.abc import Callable

from . import vulkan as v
from .spirv_module import IMAGE, WORKGROUP
from .spirv_values import image_operand, place

DEVICE, GROUP, RELAXED, GROUP_MEMORY = 1, 2, 0, 0x108  # scopes; memory semantics: none, acquire and release of what a workgroup shares


def _only_compute(body, at: int) -> None:
    if body.m.stage != v.STAGE_COMPUTE:
        body.m.wrong(at, f"opcode {body.words[at] & 0xFFFF} belongs to compute shaders")


def _constants(body, ids: tuple, wanted: tuple, at: int) -> None:
    """These ids are constants of these values."""
    for x, number in zip(ids, wanted):
        body.value(x, at)
        if body.m.integers.get(x) != number:
            body.m.wrong(at, f"id {x} is no constant {number}, as scopes, memory semantics and samples must be here")


def _write(body, ops: tuple, at: int) -> None:
    """Of a texel, to a storage image."""
    m = body.m
    _only_compute(body, at)
    m.operands(ops, 3, at, 3)
    image = image_operand(body, ops[0], "image", at, storage=True)
    place(body, ops[1], "iu", 2, at, 2)
    texel = m.types[body.value(ops[2], at)]
    if texel.kind != "vector" or texel.count != 4 or texel.of != image.of:
        m.wrong(at, "a write to an image of what is not four of its numbers")


def _texel_pointer(body, ops: tuple, at: int) -> None:
    m = body.m
    _only_compute(body, at)
    m.operands(ops, 5, at, 5)
    made, image = m.type(ops[0], at), m.types[body.pointer(ops[2], at).of]
    place(body, ops[3], "iu", 2, at, 2)
    _constants(body, ops[4:], (0,), at)
    if image.kind != "image" or image.format != v.FORMATS["R32_SINT"] or made.kind != "pointer" or made.storage != IMAGE \
            or made.of != image.of:
        m.wrong(at, "a pointer to a texel of what is no storage image of one integer")
    body.result(ops[0], ops[1], at)


def _add(body, ops: tuple, at: int) -> None:
    """Atomically; of the result there is an id, and no value."""
    m = body.m
    _only_compute(body, at)
    m.operands(ops, 6, at, 6)
    target = body.pointer(ops[2], at, IMAGE)
    _constants(body, ops[3:5], (DEVICE, RELAXED), at)
    kind = m.type(ops[0], at)
    if target.storage not in (IMAGE, WORKGROUP) or kind.kind != "int" or target.of != ops[0] or body.value(ops[5], at) != ops[0]:
        m.wrong(at, "a sum of what is no int that invocations share")
    m.define(ops[1], at)


def _wait(body, ops: tuple, at: int) -> None:
    _only_compute(body, at)
    body.m.operands(ops, 3, at, 3)
    _constants(body, ops, (GROUP, GROUP, GROUP_MEMORY), at)


SHARED: dict[int, Callable] = {60: _texel_pointer, 99: _write, 224: _wait, 234: _add}
