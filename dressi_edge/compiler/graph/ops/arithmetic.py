"""Pixelwise arithmetic, comparisons and choice. Sources: calculus; guards are in the snippets."""
from __future__ import annotations

import numpy as np

from ....cache.errors import GraphError
from ..ir import is_int, vector_type
from ..optable import apply, chosen, common_extent, elementwise, floats, integers, op, product, quotient, unit, zero


def select(c, a, b):
    """`a` where c is not zero, else `b`."""
    return apply("select", c, a, b)


op("add", "a b", infer=elementwise, ref=np.add, glsl="{y} = {a} + {b};", vjp=lambda g, y, a, b: (g, g),
   doc="a + b.")
op("sub", "a b", infer=elementwise, ref=np.subtract, glsl="{y} = {a} - {b};", vjp=lambda g, y, a, b: (g, -g),
   doc="a - b.")
op("mul", "a b", when=zero(0, 1), size=product, infer=elementwise, ref=np.multiply, glsl="{y} = {a} * {b};",
   vjp=lambda g, y, a, b: (g * b, g * a), doc="a b, channel by channel.")
op("div", "a b", when=zero(0), infer=floats, ref=lambda a, b: a / b, glsl="{y} = {a} / {b};", cost=4, size=quotient,
   vjp=lambda g, y, a, b: (g / b, -(g * y / b)),
   sample=lambda rng: ([rng.normal(size=(4, 5, 3)), rng.uniform(0.5, 2, (4, 5, 1))], {}), doc="a / b, channel by channel.")
op("neg", "a", infer=elementwise, ref=np.negative, glsl="{y} = -{a};", vjp=lambda g, y, a: (-g,), doc="-a.")
op("abs", "a", infer=elementwise, ref=np.abs, glsl="{y} = abs({a});", vjp=lambda g, y, a: (g * apply("sign", a),),
   doc="Without its sign; the gradient at 0 is 0.")
op("sign", "a", infer=elementwise, size=unit, ref=np.sign, glsl="{y} = sign({a});", doc="-1, 0 or 1; no gradient.")
op("floor", "a", infer=floats, ref=np.floor, glsl="{y} = floor({a});",
   doc="The whole number at or below; no gradient: cut with stop_gradient.")
op("fract", "a", infer=floats, ref=lambda a: a - np.floor(a), glsl="{y} = fract({a});", vjp=lambda g, y, a: (g,),
   doc="a - floor(a).")
op("min", "a b", infer=elementwise, size=chosen, ref=np.minimum, glsl="{y} = min({type}({a}), {type}({b}));",
   vjp=lambda g, y, a, b: (select(a <= b, g, 0.0), select(a <= b, 0.0, g)), doc="The smaller; a tie gives its gradient to `a`.")
op("max", "a b", infer=elementwise, size=chosen, ref=np.maximum, glsl="{y} = max({type}({a}), {type}({b}));",
   vjp=lambda g, y, a, b: (select(a >= b, g, 0.0), select(a >= b, 0.0, g)), doc="The larger; a tie gives its gradient to `a`.")
op("stop_gradient", "a", infer=elementwise, ref=lambda a: a, glsl="{y} = {a};", cost=0, vjp=lambda g, y, a: (None,),
   doc="The value; no gradient flows through.")

op("idiv", "a b", infer=integers, ref=lambda a, b: a // b, glsl="{y} = {a} / {b};", cost=4,
   sample=lambda rng: ([rng.integers(0, 100, (4, 5, 2)), rng.integers(1, 9, (4, 5, 1))], {}),
   doc="The quotient of non-negative integers, rounded down.")
op("imod", "a b", infer=integers, ref=lambda a, b: a % b, glsl="{y} = {a} % {b};", cost=4,
   sample=lambda rng: ([rng.integers(0, 100, (4, 5, 2)), rng.integers(1, 9, (4, 5, 1))], {}),
   doc="The remainder of non-negative integers.")
op("shift_left", "a b", infer=integers, ref=np.left_shift, glsl="{y} = {type}({a}) << {b};",
   sample=lambda rng: ([rng.integers(0, 100, (4, 5, 2)), rng.integers(0, 9, (4, 5, 1))], {}), doc="The integer a, b bits up.")
op("shift_right", "a b", infer=integers, ref=np.right_shift, glsl="{y} = {type}({a}) >> {b};",
   sample=lambda rng: ([rng.integers(-100, 100, (4, 5, 2)), rng.integers(0, 9, (4, 5, 1))], {}),
   doc="The integer a, b bits down, with its sign.")
op("bit_and", "a b", when=zero(0, 1), infer=integers, ref=np.bitwise_and, glsl="{y} = {a} & {b};",
   sample=lambda rng: ([rng.integers(0, 100, (4, 5, 2)), rng.integers(0, 9, (4, 5, 1))], {}),
   doc="Bits of both integers; of conditions, and.")
op("bit_or", "a b", infer=integers, ref=np.bitwise_or, glsl="{y} = {a} | {b};",
   sample=lambda rng: ([rng.integers(0, 100, (4, 5, 2)), rng.integers(0, 9, (4, 5, 1))], {}),
   doc="Bits of either integer; of conditions, or.")


def _convert(integer: bool):
    """From the other kind: of its own, the value is that already."""
    def infer(name, inputs, attrs):
        (floats if integer else integers)(name, inputs, attrs)
        return vector_type(inputs[0].channels, integer), inputs[0].extent
    return infer


op("to_float", "a", infer=_convert(False), ref=lambda a: a.astype(np.float64), glsl="{y} = {type}({a});",
   sample=lambda rng: ([rng.integers(-100, 100, (4, 5, 2))], {}), doc="The integer as a float; no gradient.")
op("to_int", "a", infer=_convert(True), ref=lambda a: np.trunc(np.clip(a, -2e9, 2e9)).astype(np.int64),
   glsl="{y} = {type}(clamp({a}, -2e9, 2e9));", doc="Rounded towards zero; no gradient.",
   sample=lambda rng: ([rng.normal(size=(4, 5, 2)) * 50], {}))


def _compare(name, inputs, attrs):
    vtype, extent = elementwise(name, inputs, attrs)
    return vector_type(int(vtype[-1]) if vtype[-1].isdigit() else 1, True), extent


def _comparison(name, symbol, function, ref):
    def glsl(node):
        if node.channels == 1:
            return f"{{y}} = int({{a}} {symbol} {{b}});"
        kind = vector_type(node.channels, is_int(node.inputs[0].vtype))
        return f"{{y}} = {{type}}({function}({kind}({{a}}), {kind}({{b}})));"

    op(name, "a b", infer=_compare, ref=lambda a, b: ref(a, b).astype(np.int64), glsl=glsl,
       doc=f"1 where a {symbol} b, else 0.")


for _name, _symbol, _function, _ref in (("less", "<", "lessThan", np.less), ("less_equal", "<=", "lessThanEqual", np.less_equal),
                                        ("greater", ">", "greaterThan", np.greater),
                                        ("greater_equal", ">=", "greaterThanEqual", np.greater_equal),
                                        ("equal", "==", "equal", np.equal), ("not_equal", "!=", "notEqual", np.not_equal)):
    _comparison(_name, _symbol, _function, _ref)


def _differs_glsl(node):
    kind = vector_type(node.inputs[0].channels)
    return f"{{y}} = int(floatBitsToInt({kind}({{a}})) != floatBitsToInt({kind}({{b}})));"


op("differs", "a b", glsl=_differs_glsl, infer=lambda name, inputs, attrs: ("int", floats(name, inputs, attrs)[1]),
   ref=lambda a, b: ((a != b) | (np.signbit(a) != np.signbit(b))).any(-1, keepdims=True).astype(np.int64),
   sample=lambda rng: ([rng.integers(0, 2, (4, 5, 3)) * rng.choice([-1.0, 1.0], (4, 5, 3)), np.zeros((1, 1, 1))], {}),
   doc="1 where some channel of a differs from that of b in any bit, its sign too.")


def _select_infer(name, inputs, attrs):
    c, a, b = inputs
    if not is_int(c.vtype):
        raise GraphError(f"select: the condition {c!r} is not an integer; use a comparison")
    vtype, _ = elementwise(name, (a, b), attrs)
    channels = int(vtype[-1]) if vtype[-1].isdigit() else 1
    if c.channels not in (1, channels):
        if channels != 1:
            raise GraphError(f"select: condition {c!r} does not fit {a!r}, {b!r}")
        vtype = vector_type(c.channels, is_int(vtype))
    return vtype, common_extent(name, inputs)


def _select_glsl(node):
    c = node.inputs[0]
    if c.channels == 1:
        return "{y} = {c} != 0 ? {type}({a}) : {type}({b});"
    zero = vector_type(c.channels, True)
    return f"{{y}} = mix({{type}}({{b}}), {{type}}({{a}}), notEqual({{c}}, {zero}(0)));"


op("select", "c a b", infer=_select_infer, chooses=True, size=chosen, ref=lambda c, a, b: np.where(c != 0, a, b), glsl=_select_glsl,
   vjp=lambda g, y, c, a, b: (None, select(c, g, 0.0), select(c, 0.0, g)),
   sample=lambda rng: ([rng.integers(0, 2, (4, 5, 1)), rng.normal(size=(4, 5, 3)), rng.normal(size=(1, 1, 1))], {}),
   doc="The branch not taken gets a zero gradient; both branches must be finite.")


op("sqrt", "a", infer=floats, ref=lambda a: np.sqrt(np.maximum(a, 0.0)), glsl="{y} = sqrt(max({a}, {type}(0.0)));", cost=4,
   size=lambda node, sizes: sizes[0] / 2,
   vjp=lambda g, y, a: (select(a > 1e-30, g * 0.5 / apply("max", y, 1e-15), 0.0),),
   sample=lambda rng: ([rng.uniform(0.3, 3, (4, 5, 3))], {}),
   doc="Square root; 0 below zero; the gradient at 0 is 0.")
op("kept", "a", infer=elementwise, keeps=True, ref=lambda a: a, glsl="{y} = {a};", cost=0, vjp=lambda g, y, a: (g,),
   doc="The value; where it rests, in one image of its own, and what is cheap is computed from that.")
op("copy", "a", infer=elementwise, ref=lambda a: a, glsl="{y} = {a};", vjp=lambda g, y, a: (g,),
   doc="The value in an image of its own.")
