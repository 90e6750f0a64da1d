"""Single pairs of a pixel and a face, beside the sums over all of them (`soft.py`): which faces weigh most at a pixel, and what a pair is
made of, so that materials can be worked out where pixels see them.

In: corners and lists as in `soft.py`. Out: faces by their weight, four at a time; of one face a pixel its point, depth and probability,
with the gradient by its corners.
"""
from __future__ import annotations

import numpy as np

from ....cache.errors import GraphError
from ..optable import Loop, apply, common_extent, op
from . import soft_reference as reference
from .lookup import constant
from .soft import LISTED, PAIR, over_pixels, sample_of
from .soft_glsl import ADD_WEIGHTS, BY_DISTANCE, FUNCTIONS, GEOMETRY, NEAREST, NEXT, TILE, WEIGHTS

LOWEST = 1e-38  # probability of which the logarithm is taken

_HEAVIEST = TILE + """vec4 best_ = vec4(-3e38);
for (int k_ = range_.x; ;) {
""" + NEXT + GEOMETRY + WEIGHTS + """ivec4 skip_ = {skip};
int own_ = f_ + 1;
bool other_ = own_ != skip_.x && own_ != skip_.y && own_ != skip_.z && own_ != skip_.w;
float score_ = near_ && other_ ? z_ / float({gamma}) + log(max(probability_, """ + repr(LOWEST) + """)) : -3e38;
bvec4 over_ = greaterThan(vec4(score_), best_);
best_ = vec4(over_.x ? score_ : best_.x, over_.x ? best_.x : over_.y ? score_ : best_.y,
             over_.y ? best_.y : over_.z ? score_ : best_.z, over_.z ? best_.z : over_.w ? score_ : best_.w);
"""


def _heaviest_infer(name, inputs, attrs):
    if inputs[8].vtype != "ivec4":
        raise GraphError(f"{name}: what to skip is {inputs[8]!r}; an ivec4 is needed")
    return over_pixels("ivec4", 4)(name, inputs, attrs)


def _heaviest_ref(v0, v1, v2, boxes, ranges, faces, masks, spilled, skip, extent, gamma, **attrs):
    p = reference.near_pairs(v0, v1, v2, boxes, **attrs)
    skip = np.broadcast_to(skip, (extent.height, extent.width, 4))[p.ys, p.xs]
    score = np.where((skip == p.face[:, None] + 1).any(1), -np.inf, p.depth / gamma + np.log(np.maximum(p.probability, LOWEST)))
    at = p.ys * extent.width + p.xs
    order = np.lexsort((p.face, -score, at))
    order = order[np.isfinite(score[order])]
    rank = np.arange(len(order)) - np.searchsorted(at[order], at[order])
    out, first = np.zeros((extent.height * extent.width, 4), int), rank < 4
    out[at[order][first], rank[first]] = p.face[order][first] + 1
    return out.reshape(extent.height, extent.width, 4)


def _heaviest_sample(rng):
    arguments, attrs = sample_of(False)(rng)
    return [*arguments, np.array([[[3, 9, 0, 0]]])], {**attrs, "gamma": 0.05}


op("soft_heaviest", "v0 v1 v2 boxes ranges faces masks spilled skip", attrs=f"{LISTED} {PAIR} gamma", infer=_heaviest_infer,
   reads="texel " * 8 + "own", ref=_heaviest_ref, functions=FUNCTIONS, cost=3000, sample=_heaviest_sample,
   loop=Loop(_HEAVIEST, "{y} = ivec4(over_.x ? own_ : {y}.x, over_.x ? {y}.x : over_.y ? own_ : {y}.y, "
                        "over_.y ? {y}.y : over_.z ? own_ : {y}.z, over_.z ? {y}.z : over_.w ? own_ : {y}.w);", "} }"),
   doc="The four faces of the pixel's list with the largest D exp(depth / gamma), largest first, of equal ones the lowest; each plus 1, "
       "0 where there is none. Those in `skip` (plus 1) are left out.")

_NEAR = "radius sigma squared hard_only nearest"
_PAIR_OF = """{ vec4 v0_ = {v0}, v1_ = {v1}, v2_ = {v2};
vec2 q_ = {place};
"""


def _pair_infer(name, inputs, attrs):
    if any(x.vtype != "vec4" for x in inputs[:3]) or inputs[3].vtype != "vec2":
        raise GraphError(f"{name}: corners are {list(inputs[:3])!r:.120}, the place {inputs[3]!r}; vec4 and vec2 are needed")
    return "vec4", common_extent(name, inputs)


def _pairs_at(*images, **attrs) -> tuple[reference.Pairs, tuple[int, int]]:
    """Of corners and a place at each texel the pair, and the shape of the image."""
    shape = np.broadcast_shapes(*(x.shape[:2] for x in images))
    *corners, place = (np.broadcast_to(x, (*shape, x.shape[2])).reshape(-1, x.shape[2]) for x in images)
    away = np.concatenate([place, np.zeros_like(place)], 1)
    return reference.all_pairs(*(c - away for c in corners), **attrs), shape


def _pair_ref(v0, v1, v2, place, **attrs):
    p, shape = _pairs_at(v0, v1, v2, place, **attrs)
    return np.stack([p.weights[:, 1], p.weights[:, 2], p.depth, p.probability], 1).reshape(*shape, 4)


def _pair_vjp(g, y, v0, v1, v2, place, **attrs):
    return (*(apply("soft_pair_gradient", g, v0, v1, v2, place, corner=k, **attrs) for k in range(3)), None)


def _pair_sample(rng):
    shape = 3, 5
    spots = rng.uniform((-3, -3), (3, 3), (*shape, 3, 2))
    w = rng.uniform(1.2, 3.0, (*shape, 3, 1))
    w[0, 1, 0], w[1, 2, 1:] = -0.7, ((-0.4,), (-1.1,))  # behind the plane w = 1
    v = np.concatenate([spots, 1 / w, -w / 20], 3)
    return [v[:, :, 0], v[:, :, 1], v[:, :, 2], constant(rng.uniform(-1, 1, (*shape, 2)))], {
        "radius": 4.0, "sigma": 0.7, "squared": 0, "hard_only": 0, "nearest": -0.05}


op("soft_pair", "v0 v1 v2 place", attrs=_NEAR, infer=_pair_infer, reads="own own own own", ref=_pair_ref, vjp=_pair_vjp, cost=100,
   functions=FUNCTIONS, sample=_pair_sample,
   glsl=_PAIR_OF + GEOMETRY + WEIGHTS + "{y} = vec4(b_.y, b_.z, z_, probability_); }",
   doc="Of the face with these corners, seen from `place`, which is held: the weights of the second and third corner at its point, "
       "the depth there, and D, 0 where it is further than `radius`; as `soft_sums` has them.")

_PAIR_GRADIENT = _PAIR_OF + "vec4 g_ = {g};\n" + NEAREST + WEIGHTS + """
float by_z_ = held_ ? 0.0 : g_.z, by_x_ = g_.w * probability_ * beside_;
vec3 by_weight_ = vec3(0.0, g_.xy) + by_z_ * vec3(v0_.w, v1_.w, v2_.w);
vec3 by_m_ = solid_ ? (by_weight_ - dot(by_weight_, b_)) / mass_ : vec3(0.0);
by_m_ = vec3(b_.x > 0.0 ? by_m_.x : 0.0, b_.y > 0.0 ? by_m_.y : 0.0, b_.z > 0.0 ? by_m_.z : 0.0);
vec3 by_c_ = by_m_ * iw_ * facing_, by_iw_ = by_m_ * area_;
""" + BY_DISTANCE + ADD_WEIGHTS


def _pair_gradient_ref(g, v0, v1, v2, place, corner, **attrs):
    p, shape = _pairs_at(v0, v1, v2, place, **attrs)
    g = np.broadcast_to(g, (*shape, 4)).reshape(-1, 4)
    gz = np.where(p.held, 0, g[:, 2])
    gw = np.concatenate([np.zeros((len(g), 1)), g[:, :2]], 1) + gz[:, None] * p.corners[..., 3]
    out = reference.corner_gradient(p, g[:, 3] * p.probability * p.clear, gw)
    out[..., 3] += gz[:, None] * p.weights
    return out[:, corner].reshape(*shape, 4)


def _pair_gradient_sample(rng):
    inputs, attrs = _pair_sample(rng)
    return [rng.normal(size=(3, 5, 4)), *inputs], {**attrs, "corner": 1}


# The three corners share what comes before: a loop of no turns.
op("soft_pair_gradient", "g v0 v1 v2 place", attrs=f"corner {_NEAR}", reads="own own own own own", ref=_pair_gradient_ref,
   functions=FUNCTIONS, cost=120, sample=_pair_gradient_sample,
   infer=lambda name, inputs, attrs: _pair_infer(name, inputs[1:], attrs),
   loop=Loop(_PAIR_GRADIENT, "{y} = {corner} == 0 ? g0_ : {corner} == 1 ? g1_ : g2_;", "}"),
   doc="Transpose of soft_pair, by one corner.")
