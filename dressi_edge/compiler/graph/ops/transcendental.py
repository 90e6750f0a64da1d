"""Exponential, trigonometric and hyperbolic functions, powers, remainders.

Vulkan lets a device be off by 2^-11 in sin and cos and by 4096 units in the last place in atan, asin and acos, which is far too much
for what becomes a place. So these are polynomials here (coefficients: Cephes by S. Moshier, single precision), of additions and products
but for a division or a root, and the same on every device to a few units in the last place. Arguments are reduced by pi / 2 in three
parts (Cody and Waite); the products of the first two with whole numbers up to 2^13 are exact.
"""
from __future__ import annotations

import math

import numpy as np

from ..ir import vector_type
from ..optable import apply, floats, op, unit
from .arithmetic import select

HALF_PI = (1.5703125, 0.0004837512969970703, 7.549790126404332e-08)  # of 8 bits, 11 bits, fp32


def _positive(rng):
    return [rng.uniform(0.3, 3, (4, 5, 3))], {}


def _inside(rng):
    return [rng.uniform(-0.95, 0.95, (4, 5, 3))], {}


def _choose(node, condition: tuple[str, str, str], yes: str, no: str) -> str:
    """GLSL of `yes` where (a, comparison, b) holds, channel by channel. The comparison is < or >."""
    a, sign, b = condition
    if node.channels == 1:
        return f"(({a}) {sign} ({b}) ? ({yes}) : ({no}))"
    kind = vector_type(node.channels)
    return f"mix({kind}({no}), {kind}({yes}), {'lessThan' if sign == '<' else 'greaterThan'}({kind}({a}), {kind}({b})))"


def _signed(node, value: str) -> str:
    return _choose(node, ("{a}", "<", "0.0"), f"-({value})", value)


def _angle(node) -> str:
    """k_: how many quarter turns; s_ and c_: sine and cosine of the rest. Beyond what can be reduced the rest is held in range."""
    first, second, third = HALF_PI
    return f"""{{type}} k_ = roundEven({{a}} * {1 / (math.pi / 2)!r});
    precise {{type}} r_ = (({{a}} - k_ * {first}) - k_ * {second}) - k_ * {third};
    r_ = clamp(r_, -0.79, 0.79);  // an eighth of a turn, and what rounding of k_ adds
    {{type}} z_ = r_ * r_, q_ = k_ - 4.0 * floor(0.25 * k_);
    {{type}} s_ = ((-1.9515295891e-4 * z_ + 8.3321608736e-3) * z_ - 1.6666654611e-1) * z_ * r_ + r_;
    {{type}} c_ = ((2.443315711809948e-5 * z_ - 1.388731625493765e-3) * z_ + 4.166664568298827e-2) * z_ * z_ - 0.5 * z_ + 1.0;
    """


def _sine(node) -> str:
    even = _choose(node, ("abs(q_ - 1.0)", "<", "0.5"), "c_", _choose(node, ("q_", ">", "2.5"), "-c_", "s_"))
    return "{ " + _angle(node) + "{y} = " + _choose(node, ("abs(q_ - 2.0)", "<", "0.5"), "-s_", even) + "; }"


def _cosine(node) -> str:
    odd = _choose(node, ("abs(q_ - 1.0)", "<", "0.5"), "-s_", _choose(node, ("q_", ">", "2.5"), "s_", "c_"))
    return "{ " + _angle(node) + "{y} = " + _choose(node, ("abs(q_ - 2.0)", "<", "0.5"), "-c_", odd) + "; }"


def _tangent(node) -> str:
    odd = _choose(node, ("abs(abs(q_ - 2.0) - 1.0)", "<", "0.5"), "-c_ / s_", "s_ / c_")
    return "{ " + _angle(node) + "{y} = " + odd + "; }"


op("sin", "a", infer=floats, size=unit, ref=np.sin, glsl=_sine, vjp=lambda g, y, a: (g * apply("cos", a),), cost=30,
   doc="Sine of an angle in radians: to 2 units in the last place of 1 up to |a| = 12,000; beyond, in [-1, 1] and less and less exact.")
op("cos", "a", infer=floats, size=unit, ref=np.cos, glsl=_cosine, vjp=lambda g, y, a: (-(g * apply("sin", a)),), cost=30,
   doc="Cosine of an angle in radians, as exact as sin.")
op("tan", "a", infer=floats, size=unit, ref=np.tan, glsl=_tangent, vjp=lambda g, y, a: (g * (y * y + 1.0),), cost=34,
   sample=_inside, doc="Tangent of an angle in radians, the quotient of sin and cos.")


def _arctangent(node) -> str:
    turned = _choose(node, ("t_", ">", "0.41421356"), "0.78539816 + p_", "p_")
    steep = _choose(node, ("v_", ">", "u_"), "1.57079633 - p_", "p_")
    left = _choose(node, ("w_", "<", "0.0"), "3.14159265 - p_", "p_")
    reduced = _choose(node, ("t_", ">", "0.41421356"), "(t_ - 1.0) / (t_ + 1.0)", "t_")
    return """{ {type} o_ = {type}({a}), w_ = {type}({b}), v_ = abs(o_), u_ = abs(w_), t_ = min(v_, u_) / max(max(v_, u_), 1e-37);
    {type} x_ = """ + reduced + """, z_ = x_ * x_;
    {type} p_ = (((8.05374449538e-2 * z_ - 1.38776856032e-1) * z_ + 1.99777106478e-1) * z_ - 3.33329491539e-1) * z_ * x_ + x_;
    p_ = """ + turned + "; p_ = " + steep + "; p_ = " + left + ";\n    {y} = " + _choose(node, ("o_", "<", "0.0"), "-p_", "p_") + "; }"


def _atan2_vjp(g, y, a, b):
    squared = apply("max", a * a + b * b, 1e-30)
    return g * b / squared, -(g * a / squared)


op("atan2", "a b", infer=floats, size=unit, ref=np.arctan2, cost=40, vjp=_atan2_vjp,
   glsl=_arctangent, sample=lambda rng: ([rng.uniform(0.3, 1, (4, 5, 2)), rng.uniform(-1, -0.3, (4, 5, 2))], {}),
   doc="The angle of the point (b, a), in radians from -pi to pi; 0 at (0, 0), where the gradient is 0.")


# p_: arc sine of |a| up to 1/2, beyond it of the root that halves the angle.
_ARC = """{type} o_ = min(abs({a}), {type}(1.0)), z_ = HALVED, x_ = ROOT;
    {type} p_ = (((4.2163199048e-2 * z_ + 2.4181311049e-2) * z_ + 4.5470025998e-2) * z_ + 7.4953002686e-2) * z_ + 1.6666752422e-1;
    p_ = p_ * z_ * x_ + x_;
    """


def _arc(node) -> str:
    halved = _choose(node, ("o_", ">", "0.5"), "0.5 - 0.5 * o_", "o_ * o_")
    return _ARC.replace("HALVED", halved).replace("ROOT", _choose(node, ("o_", ">", "0.5"), "sqrt(z_)", "o_"))


def _arcsine(node) -> str:
    whole = _choose(node, ("o_", ">", "0.5"), "1.57079633 - 2.0 * p_", "p_")
    return "{ " + _arc(node) + "p_ = " + whole + "; {y} = " + _signed(node, "p_") + "; }"


def _arccosine(node) -> str:
    near = _choose(node, ("{a}", "<", "0.0"), "3.14159265 - 2.0 * p_", "2.0 * p_")
    middle = _choose(node, ("{a}", "<", "0.0"), "1.57079633 + p_", "1.57079633 - p_")
    return "{ " + _arc(node) + "{y} = " + _choose(node, ("o_", ">", "0.5"), near, middle) + "; }"


def _arc_slope(g, a):
    rest = 1.0 - a * a
    return select(rest > 1e-12, g / apply("sqrt", apply("max", rest, 1e-12)), 0.0)


op("asin", "a", infer=floats, size=unit, ref=lambda a: np.arcsin(np.clip(a, -1, 1)), glsl=_arcsine, cost=30, sample=_inside,
   vjp=lambda g, y, a: (_arc_slope(g, a),),
   doc="Arc sine in radians; beyond -1 and 1 that of -1 and 1. The gradient there, where it is infinite or none, is 0.")
op("acos", "a", infer=floats, size=unit, ref=lambda a: np.arccos(np.clip(a, -1, 1)), glsl=_arccosine, cost=30, sample=_inside,
   vjp=lambda g, y, a: (-_arc_slope(g, a),),
   doc="Arc cosine in radians; beyond -1 and 1 that of -1 and 1. The gradient there, where it is infinite or none, is 0.")


# ---- exponentials

op("exp", "a", infer=floats, size=unit, ref=np.exp, glsl="{y} = exp({a});", vjp=lambda g, y, a: (g * y,), cost=8,
   doc="e to the power a.")
op("log", "a", infer=floats, size=unit, ref=np.log, glsl="{y} = log({a});", vjp=lambda g, y, a: (g / a,), cost=8, sample=_positive,
   doc="Natural logarithm, of positive values.")
op("exp2", "a", infer=floats, size=unit, ref=np.exp2, glsl="{y} = exp2({a});", vjp=lambda g, y, a: (g * (y * math.log(2.0)),), cost=8,
   doc="2 to the power a.")
op("log2", "a", infer=floats, size=unit, ref=np.log2, glsl="{y} = log2({a});", vjp=lambda g, y, a: (g / (a * math.log(2.0)),), cost=8,
   sample=_positive, doc="Logarithm to base 2, of positive values.")
op("pow", "a b", infer=floats, size=unit, ref=lambda a, b: np.power(np.maximum(a, 1e-30), b), cost=16,
   glsl="{y} = pow(max({type}({a}), {type}(1e-30)), {type}({b}));",
   vjp=lambda g, y, a, b: (select(a > 1e-30, g * b * apply("pow", a, b - 1.0), 0.0),
                           g * y * apply("log", apply("max", a, 1e-30))),
   sample=lambda rng: ([rng.uniform(0.3, 3, (4, 5, 3)), rng.uniform(-1, 2, (1, 1, 1))], {}),
   doc="a to the power b, of non-negative bases; 0 counts as 1e-30 and its base gradient is 0. `power` multiplies whole powers out.")
op("sigmoid", "a", infer=floats, size=unit, ref=lambda a: np.where(a >= 0, 1, np.exp(-np.abs(a))) / (1 + np.exp(-np.abs(a))), cost=12,
   glsl=lambda node: "{ {type} e_ = exp(-abs({a})); {y} = " + (
       "({a} >= 0.0 ? 1.0 : e_)" if node.channels == 1 else "mix(e_, {type}(1.0), greaterThanEqual({a}, {type}(0.0)))")
   + " / (1.0 + e_); }",
   vjp=lambda g, y, a: (g * apply("sigmoid", a) * apply("sigmoid", -a),),
   doc="1 / (1 + exp(-a)) without overflow; paper 3.4.3.")

# h_: half of e to the power |a|
_HALF_EXP = "{type} o_ = abs({a}), h_ = exp(o_ - 0.69314718);"
_SINH = "((2.03721912945e-4 * z_ + 8.33028376239e-3) * z_ + 1.66667160211e-1) * z_ * {a} + {a}"
_TANH = ("((((-5.70498872745e-3 * z_ + 2.06390887954e-2) * z_ - 5.37397155531e-2) * z_ + 1.33314422036e-1) * z_ - 3.33332819422e-1)"
         " * z_ * {a} + {a}")
op("sinh", "a", infer=floats, size=unit, ref=np.sinh, cost=24, vjp=lambda g, y, a: (g * apply("cosh", a),),
   glsl=lambda node: "{ " + _HALF_EXP + " {type} z_ = min(o_, {type}(1.0)); z_ *= z_; {y} = "
   + _choose(node, ("o_", "<", "1.0"), _SINH, _signed(node, "h_ - 0.25 / h_")) + "; }", doc="Hyperbolic sine.")
op("cosh", "a", infer=floats, size=unit, ref=np.cosh, glsl="{ " + _HALF_EXP + " {y} = h_ + 0.25 / h_; }", cost=16,
   vjp=lambda g, y, a: (g * apply("sinh", a),), doc="Hyperbolic cosine.")
op("tanh", "a", infer=floats, size=unit, ref=np.tanh, cost=24, vjp=lambda g, y, a: (g * (1.0 - y * y),),
   glsl=lambda node: "{ {type} o_ = min(abs({a}), {type}(20.0)), z_ = min(o_, {type}(1.0)); z_ *= z_; {y} = "
   + _choose(node, ("o_", "<", "0.625"), _TANH, _signed(node, "1.0 - 2.0 / (exp(2.0 * o_) + 1.0)")) + "; }",
   doc="Hyperbolic tangent.")


# ---- remainder

def _mod_glsl(node) -> str:
    """The quotient may be rounded across a whole number: one step either way puts that right."""
    low = _choose(node, ("r_ * sign(b_)", "<", "0.0"), "r_ + b_", "r_")
    high = _choose(node, ("abs(r_)", "<", "abs(b_)"), "r_", "r_ - b_")
    return "{ {type} b_ = {type}({b}), r_ = {a} - b_ * floor({a} / b_); r_ = " + low + "; {y} = " + high + "; }"


op("mod", "a b", infer=floats, ref=np.mod, glsl=_mod_glsl, cost=12,
   vjp=lambda g, y, a, b: (g, -(g * apply("floor", a / b))), size=lambda node, sizes: sizes[1],
   sample=lambda rng: ([rng.uniform(-9, 9, (4, 5, 3)), rng.uniform(1, 2, (4, 5, 1)) * rng.choice([-1, 1], (4, 5, 1))], {}),
   doc="a - b floor(a / b), of floats: the sign of b, to a unit in the last place of a. The gradient by b is -floor(a / b).")
