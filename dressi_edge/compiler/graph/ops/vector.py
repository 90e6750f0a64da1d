"""Channels: swizzle, compose, dot, cross."""
from __future__ import annotations

import numpy as np

from ....cache.errors import GraphError
from ..ir import is_int, vector_type
from ..optable import apply, common_extent, elementwise, op, product, zero

_AXIS = {"x": 0, "y": 1, "z": 2, "w": 3}


def compose(*parts):
    """A vector of the parts' channels, in order; 2 to 4 scalars after splitting."""
    scalars = []
    for part in parts:
        if not hasattr(part, "channels") or part.channels == 1:
            scalars.append(part)
        else:
            scalars += [apply("swizzle", part, channels=c) for c in "xyzw"[:part.channels]]
    if not 2 <= len(scalars) <= 4:
        raise GraphError(f"compose: {len(scalars)} channels; 2 to 4 are allowed")
    return apply(f"compose{len(scalars)}", *scalars)


def _swizzle_infer(name, inputs, attrs):
    x, names = inputs[0], attrs["channels"]
    if not 1 <= len(names) <= 4 or any(c not in _AXIS or _AXIS[c] >= x.channels for c in names):
        raise GraphError(f"swizzle: {x!r} has no channels {names!r}")
    return vector_type(len(names), is_int(x.vtype)), x.extent


def _swizzle_vjp(g, y, a, channels):
    parts = []
    for c in "xyzw"[:a.channels]:
        terms = [g if g.channels == 1 else apply("swizzle", g, channels="xyzw"[k]) for k, d in enumerate(channels) if d == c]
        parts.append(sum(terms[1:], terms[0]) if terms else 0.0)
    return (parts[0] if a.channels == 1 else compose(*parts),)


def _swizzle_glsl(node):
    return "{y} = {a};" if node.inputs[0].channels == 1 else "{y} = {a}.{channels};"


op("swizzle", "a", infer=_swizzle_infer, vjp=_swizzle_vjp, glsl=_swizzle_glsl, cost=0, part=True,
   ref=lambda a, channels: a[..., [_AXIS[c] for c in channels]],
   sample=lambda rng: ([rng.normal(size=(4, 5, 4))], {"channels": "wxx"}),
   doc="Channels by name (x y z w), 1 to 4 of them in any order.")


def _compose_infer(name, inputs, attrs):
    integer = is_int(inputs[0].vtype)
    if any(x.channels != 1 or is_int(x.vtype) != integer for x in inputs):
        raise GraphError(f"{name}: scalars of one kind are needed: {', '.join(map(repr, inputs))}")
    return vector_type(len(inputs), integer), common_extent(name, inputs)


for _n in (2, 3, 4):
    op(f"compose{_n}", "a b c d"[:2 * _n - 1], infer=_compose_infer, cost=0,
       ref=lambda *xs: np.concatenate(np.broadcast_arrays(*xs), axis=2),
       glsl="{y} = {type}(" + ", ".join("{" + c + "}" for c in "abcd"[:_n]) + ");",
       vjp=lambda g, y, *xs: tuple(apply("swizzle", g, channels=c) for c in "xyzw"[:len(xs)]),
       sample=lambda rng, n=_n: ([rng.normal(size=(4, 5, 1)) for _ in range(n)], {}),
       doc=f"A vector of {_n} scalars.")


def _dot_infer(name, inputs, attrs):
    vtype, extent = elementwise(name, inputs, attrs)
    if inputs[0].vtype != inputs[1].vtype or is_int(vtype):
        raise GraphError(f"{name}: two float vectors of one type are needed: {', '.join(map(repr, inputs))}")
    return "float", extent


op("dot", "a b", when=zero(0, 1), size=product, infer=_dot_infer, ref=lambda a, b: (a * b).sum(2, keepdims=True), cost=3,
   glsl="{y} = dot({a}, {b});",
   vjp=lambda g, y, a, b: (g * b, g * a),
   sample=lambda rng: ([rng.normal(size=(4, 5, 3)), rng.normal(size=(4, 5, 3))], {}), doc="Inner product of two vectors.")


def _cross_infer(name, inputs, attrs):
    if any(x.vtype != "vec3" for x in inputs):
        raise GraphError(f"cross: two vec3 are needed: {', '.join(map(repr, inputs))}")
    return "vec3", common_extent(name, inputs)


op("cross", "a b", when=zero(0, 1), size=product, infer=_cross_infer, ref=lambda a, b: np.cross(a, b, axis=2), cost=5,
   glsl="{y} = cross({a}, {b});",
   vjp=lambda g, y, a, b: (apply("cross", b, g), apply("cross", g, a)),
   sample=lambda rng: ([rng.normal(size=(4, 5, 3)), rng.normal(size=(4, 5, 3))], {}), doc="Cross product of two vec3.")


def _sum_channels_infer(name, inputs, attrs):
    return vector_type(1, is_int(inputs[0].vtype)), inputs[0].extent


op("sum_channels", "a", infer=_sum_channels_infer, ref=lambda a: a.sum(2, keepdims=True), cost=2,
   glsl=lambda node: "{y} = " + " + ".join(f"{{a}}.{c}" for c in "xyzw"[:node.inputs[0].channels]) + ";",
   vjp=lambda g, y, a: (compose(*[g] * a.channels) if a.channels > 1 else g,),
   doc="Sum of a texel's channels (the paper's per-pixel sum).")
