"""Instructions within functions whose operands and result are numbers and truth values: one row an opcode.

A row: the letters of the result (f float, i int, u uint, b truth value), those of the operands, how many there are, and how they go
together. SAME: every operand is of the result's type. SIZE: of its size, whatever the sign. ALIKE: of its size, and all of one type.
"""
from __future__ import annotations

SAME, SIZE, ALIKE = "same", "size", "alike"

ROWS: dict[int, tuple[str, str, int, str]] = {
    109: ("u", "f", 1, SIZE), 110: ("iu", "f", 1, SIZE), 111: ("f", "iu", 1, SIZE), 112: ("f", "iu", 1, SIZE),  # conversions
    116: ("f", "f", 1, SAME), 124: ("fiu", "fiu", 1, SIZE),
    126: ("iu", "iu", 1, SIZE), 127: ("f", "f", 1, SAME), 134: ("u", "u", 2, SAME), 137: ("u", "u", 2, SAME)}
ROWS |= dict.fromkeys((128, 130, 132, 135, 138, 139), ("iu", "iu", 2, SIZE))  # add, subtract, multiply, divide, remainder, modulo
ROWS |= dict.fromkeys((129, 131, 133, 136, 140, 141), ("f", "f", 2, SAME))
ROWS |= {156: ("b", "f", 1, SIZE), 157: ("b", "f", 1, SIZE), 168: ("b", "b", 1, SAME)}  # is NaN, is Inf, not
ROWS |= dict.fromkeys(range(164, 168), ("b", "b", 2, SAME))
ROWS |= dict.fromkeys(range(170, 180), ("b", "iu", 2, SIZE))  # comparisons
ROWS |= dict.fromkeys(range(180, 192), ("b", "f", 2, ALIKE))
ROWS |= dict.fromkeys(range(194, 200), ("iu", "iu", 2, SIZE))  # shifts, or, xor, and
ROWS |= {200: ("iu", "iu", 1, SIZE), 204: ("iu", "iu", 1, SAME), 205: ("iu", "iu", 1, SIZE)}
ROWS |= dict.fromkeys(range(207, 216), ("f", "f", 1, SAME))  # derivatives
FRAGMENT_ONLY = frozenset(range(207, 216))
DERIVATIVE_CONTROL = frozenset(range(210, 216))

# GLSL.std.450, by number; version 1.0 revision 10 of its specification, chapter 2
EXTENDED: dict[int, tuple[str, str, int, str]] = dict.fromkeys(
    (1, 2, 3, 4, 6, *range(8, 25), *range(27, 33), 69), ("f", "f", 1, SAME))
EXTENDED |= dict.fromkeys((25, 26, 37, 40, 48, 71, 79, 80), ("f", "f", 2, SAME))
EXTENDED |= dict.fromkeys((43, 46, 49, 50, 70, 81), ("f", "f", 3, SAME))
EXTENDED |= dict.fromkeys((5, 7, 73, 74, 75), ("iu", "iu", 1, SIZE))
EXTENDED |= dict.fromkeys((38, 39, 41, 42), ("iu", "iu", 2, SIZE))
EXTENDED |= dict.fromkeys((44, 45), ("iu", "iu", 3, SIZE))
POINTED = {35: "f", 51: "iu"}  # modf and frexp: the letters of what their second operand points to
SQUARE, INVERSE = (33, 34), 34  # determinant and inverse
# Those whose operands are of other sizes: result, then operands, each letters and components; n: of any, the same in all. A
# structure is told by its members.
SHAPED: dict[int, tuple[tuple[str, ...], ...]] = {
    66: (("f1",), ("fn",)), 67: (("f1",), ("fn", "fn")),
    68: (("f3",), ("f3", "f3")), 72: (("fn",), ("fn", "fn", "f1")), 53: (("fn",), ("fn", "in")),
    36: (("fn", "fn"), ("fn",)), 52: (("fn", "in"), ("fn",)),
    54: (("u1",), ("f4",)), 55: (("u1",), ("f4",)), 56: (("u1",), ("f2",)), 57: (("u1",), ("f2",)), 58: (("u1",), ("f2",)),
    60: (("f2",), ("u1",)), 61: (("f2",), ("u1",)), 62: (("f2",), ("u1",)), 63: (("f4",), ("u1",)), 64: (("f4",), ("u1",))}
