"""Texture sampling: bilinear, wrapped or clamped, and its derivative with respect to the coordinates.

Coordinates are in [0, 1] with texel centres at (k + 0.5) / size; rows run down with v. Where the profile can filter the format the
snippet is the hardware sampler, elsewhere four texel fetches of the same answer.
"""
from __future__ import annotations

from math import log2

import numpy as np

from ....cache.errors import GraphError
from ..ir import Node
from ..optable import apply, common_extent, op

WRAPS = ("repeat", "clamp")


def _wrap(k, size, wrap):
    return k % size if wrap == "repeat" else np.clip(k, 0, size - 1)


def footprint(uv, width, height, wrap):
    """Texels and weights of a bilinear read: xs, ys (h, w, 2), fractions fx, fy (h, w, 1)."""
    s = uv * np.array([width, height]) - 0.5
    base = np.floor(s)
    f = s - base
    k = base.astype(np.int64)
    xs = np.stack([_wrap(k[..., 0] + d, width, wrap) for d in (0, 1)], -1)
    ys = np.stack([_wrap(k[..., 1] + d, height, wrap) for d in (0, 1)], -1)
    return xs, ys, f[..., :1], f[..., 1:]


def _four(texture, uv, wrap):
    xs, ys, fx, fy = footprint(uv, texture.shape[1], texture.shape[0], wrap)
    return [[texture[ys[..., j], xs[..., i]] for i in (0, 1)] for j in (0, 1)], fx, fy


def _sample_ref(texture, uv, wrap, **_):
    (t00, t10), (t01, t11) = (_four(texture, uv, wrap))[0]
    _, _, fx, fy = footprint(uv, texture.shape[1], texture.shape[0], wrap)
    return (t00 * (1 - fx) + t10 * fx) * (1 - fy) + (t01 * (1 - fx) + t11 * fx) * fy


def _grad_ref(texture, uv, g, wrap):
    ((t00, t10), (t01, t11)), fx, fy = _four(texture, uv, wrap)
    du = ((t10 - t00) * (1 - fy) + (t11 - t01) * fy) * texture.shape[1]
    dv = ((t01 - t00) * (1 - fx) + (t11 - t10) * fx) * texture.shape[0]
    return np.concatenate([(g * du).sum(2, keepdims=True), (g * dv).sum(2, keepdims=True)], 2)


def _infer(name, inputs, attrs):
    if inputs[1].vtype != "vec2":
        raise GraphError(f"{name}: coordinates must be vec2, got {inputs[1]!r}")
    if attrs["wrap"] not in WRAPS:
        raise GraphError(f"{name}: wrap {attrs['wrap']!r}; {' or '.join(WRAPS)} is allowed")
    return inputs[0].vtype, common_extent(name, inputs[1:])


FOOTPRINT = """vec2 s_ = {uv} * vec2({texture_w}, {texture_h}) - 0.5, b_ = floor(s_);
    s_ -= b_; ivec2 k_ = ivec2(clamp(b_, -2e9, 2e9)), z_ = ivec2({texture_w}, {texture_h});"""
TEXELS = {"repeat": "ivec2 lo_ = (k_ % z_ + z_) % z_, hi_ = ivec2(lo_.x + 1 == z_.x ? 0 : lo_.x + 1, lo_.y + 1 == z_.y ? 0 : lo_.y + 1);",
           "clamp": "ivec2 lo_ = clamp(k_, ivec2(0), z_ - 1), hi_ = clamp(k_ + 1, ivec2(0), z_ - 1);"}
FETCHES = """{t} t00_ = {texture}(lo_), t10_ = {texture}(ivec2(hi_.x, lo_.y)),
    t01_ = {texture}(ivec2(lo_.x, hi_.y)), t11_ = {texture}(hi_);"""


def _sample_glsl(node: Node) -> str:
    """Four fetches; the emitter uses the sampler instead where the profile filters this format."""
    return "{ " + FOOTPRINT + TEXELS[node.attrs["wrap"]] + FETCHES.replace("{t}", "{type}") + \
        "{y} = mix(mix(t00_, t10_, s_.x), mix(t01_, t11_, s_.x), s_.y); }"


def _grad_glsl(node: Node) -> str:
    kind = node.inputs[0].vtype
    dot = "dot" if node.inputs[0].channels > 1 else ""
    product = f"{dot}({{g}}, " if dot else "({g} * ("
    close = ")" if dot else "))"
    return "{ " + FOOTPRINT + TEXELS[node.attrs["wrap"]] + FETCHES.replace("{t}", kind) + \
        f"{{y}} = vec2({product}mix(t10_ - t00_, t11_ - t01_, s_.y){close}, {product}mix(t01_ - t00_, t11_ - t10_, s_.x){close})" \
        " * vec2({texture_w}, {texture_h}); }"


def _sample(rng, wrap):
    uv = rng.uniform(-0.4, 1.4, (6, 5, 2)) if wrap == "repeat" else rng.uniform(0.05, 0.95, (6, 5, 2))
    return [rng.normal(size=(7, 8, 3)), uv], {"wrap": wrap}


op("sample", "texture uv", attrs="wrap", infer=_infer, reads="filtered own", ref=_sample_ref, cost=40, glsl=_sample_glsl,
   vjp=lambda g, y, texture, uv, wrap: (None, apply("sample_uv_gradient", texture, uv, g, wrap=wrap)),
   sample=lambda rng: _sample(rng, "repeat"),
   doc="Bilinear sample of a texture that is not optimized; the gradient flows to the coordinates.")
op("sample_uv_gradient", "texture uv g", reads="texel own own", cost=45, ref=_grad_ref, glsl=_grad_glsl,
   size=lambda node, sizes: sizes[0] + sizes[2] + log2(max(node.inputs[0].extent.width, node.inputs[0].extent.height)),
   infer=lambda name, inputs, attrs: ("vec2", common_extent(name, inputs[1:])),
   sample=lambda rng: ([*_sample(rng, "clamp")[0], rng.normal(size=(6, 5, 3))], {"wrap": "clamp"}),
   doc="Derivative of sample with respect to the coordinates, times g.")
