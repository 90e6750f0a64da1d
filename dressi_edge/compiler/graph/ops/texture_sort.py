"""Pixels sorted by the texel that they sample: which texels each reads, keys, and a stable merge sort of one pass a doubling, whose cost
does not depend on where the coordinates point. What is made of the order: `texture_gradient.py`.
"""
from __future__ import annotations

import numpy as np

from ....cache.errors import GraphError
from ..ir import Node, is_int, table
from ..optable import apply, common_extent, op
from .compact import Compact
from .lookup import constant
from .texture import WRAPS

LAST = 2 ** 31 - 1  # key of a pixel that samples nothing: sorted behind all others
MAX_PIXELS = 1 << 24  # pixel numbers are kept as floats


def sorted_list(footprint: Node, width: int, listed: Compact) -> Node:
    """(texel, read) of the footprints of a list, sorted by texel: the number of a lower corner in an image of this width."""
    return merged(apply("listed_keys", footprint, listed.entries, listed.total, width=width), listed.total)


def merged(ordered: Node, total: Node | None = None) -> Node:
    """A table sorted by the first channel. total: its last texel says how many there are."""
    run = 1
    while run < ordered.extent.width * ordered.extent.height:
        each = constant(np.array([[[run]]]))  # data, not text: all passes share one pipeline
        ordered = apply("merge_runs", ordered, each) if total is None else apply("merge_listed", ordered, each, total)
        run *= 2
    return ordered


# ---- which texels a pixel reads

def _footprint_infer(name, inputs, attrs):
    uv, covered = inputs
    if uv.vtype != "vec2" or covered.vtype != "int":
        raise GraphError(f"{name}: vec2 coordinates and an int mask are needed, got {uv!r} and {covered!r}")
    if attrs["wrap"] not in WRAPS:
        raise GraphError(f"{name}: wrap {attrs['wrap']!r}; {' or '.join(WRAPS)} is allowed")
    if uv.extent.count > MAX_PIXELS:
        raise GraphError(f"{name}: {uv!r} has {uv.extent.count} pixels; {MAX_PIXELS} are allowed")
    return "vec4", common_extent(name, inputs)


def footprint_ref(uv, covered, width, height, wrap):
    size = np.array([width, height])
    s = uv * size - 0.5
    s = np.clip(s, 0, size - 1) if wrap == "clamp" else s
    base = np.floor(s)
    return np.concatenate(np.broadcast_arrays(np.where(covered != 0, base % size, [-1, 0]), s - base), 2)


_ROUNDED = {
    "repeat": """{ vec2 s_ = {uv} * vec2({width}, {height}) - 0.5, b_ = floor(s_);
    ivec2 z_ = ivec2({width}, {height});
    {y} = vec4((ivec2(clamp(b_, -2e9, 2e9)) % z_ + z_) % z_, s_ - b_); if ({covered} == 0) {y}.xy = vec2(-1.0, 0.0); }""",
    "clamp": """{ vec2 s_ = clamp({uv} * vec2({width}, {height}) - 0.5, vec2(0.0), vec2({width} - 1, {height} - 1));
    {y} = vec4(floor(s_), fract(s_)); if ({covered} == 0) {y}.xy = vec2(-1.0, 0.0); }""",
}
op("texture_footprint", "uv covered", infer=_footprint_infer, ref=footprint_ref, cost=30,
   glsl=lambda node: _ROUNDED[node.attrs["wrap"]],
   sample=lambda rng: ([rng.uniform(-1, 2, (6, 5, 2)), rng.integers(0, 2, (6, 5, 1))],
                       {"width": 8, "height": 3, "wrap": "repeat"}),
   doc="(x, y) of the lower texel of a bilinear read and the fractions towards the next, which wraps; x = -1 if not covered. "
       "With clamp the fraction at a border is 0, so that the wrapped neighbour has no weight.")


# ---- sorting

def keys_ref(footprint, width, count):
    e = table(footprint.shape[0] * footprint.shape[1])
    keys = np.full(e.width * e.height, LAST)
    f = footprint.reshape(-1, 4)[:count]
    keys[:count] = np.where(f[:, 0] < 0, LAST, f[:, 1] * width + f[:, 0])
    return np.stack([keys, np.arange(len(keys))], 1).reshape(e.height, e.width, 2)


def _keys_infer(name, inputs, attrs):
    pixels = inputs[0].extent.width * inputs[0].extent.height
    if not 0 < attrs["count"] <= pixels:
        raise GraphError(f"{name}: {attrs['count']} pixels of {inputs[0]!r}")
    return "ivec2", table(pixels)


op("texture_keys", "footprint", reads="texel", ref=keys_ref, cost=30, infer=_keys_infer,
   glsl="""{y} = ivec2(2147483647, {i});
    if ({i} < {count}) { vec2 f_ = {footprint_at}({i}).xy; if (f_.x >= 0.0) {y}.x = int(f_.y) * {width} + int(f_.x); }""",
   sample=lambda rng: ([footprint_ref(rng.uniform(-1, 2, (6, 5, 2)), rng.integers(0, 2, (6, 5, 1)), 8, 3, "repeat")],
                       {"width": 8, "count": 29}),
   doc="(lower texel, pixel) of each pixel as a table; texel 2^31 - 1 where nothing is sampled.")


def _listed_keys_ref(footprint, entries, total, width):
    out, pixels = np.zeros((entries.size, 2)), entries.reshape(-1)[:int(total.reshape(-1)[-1])]
    f = footprint.reshape(-1, 4)[pixels]
    out[:len(pixels)] = np.stack([f[:, 1] * width + f[:, 0], pixels], 1)
    return out.reshape(*entries.shape[:2], 2)


def _listed_keys_sample(rng):
    covered = rng.integers(0, 2, (6, 5, 1))
    pixels = np.flatnonzero(covered)
    entries = np.full((8, 4, 1), -1)
    entries.reshape(-1)[:len(pixels)] = pixels
    return [footprint_ref(rng.uniform(-1, 2, (6, 5, 2)), covered, 8, 3, "repeat"), entries, np.array([[[len(pixels)]]])], {"width": 8}


op("listed_keys", "footprint entries total", reads="texel texel texel", ref=_listed_keys_ref, cost=30,
   infer=lambda name, inputs, attrs: ("ivec2", inputs[1].extent),
   glsl="""{y} = ivec2(0);
    if ({i} < {total}(ivec2({total_w} - 1, {total_h} - 1))) {
        int k_ = {entries_at}({i});
        vec2 f_ = {footprint_at}(k_).xy;
        {y} = ivec2(int(f_.y) * {width} + int(f_.x), k_);
    }""",
   sample=lambda rng: _listed_keys_sample(rng),
   doc="texture_keys of the pixels of a list, as many as the last texel of `total` says, in its order.")


def merge_ref(a, run):
    flat, block = a.reshape(-1, 2), 2 * int(run[0, 0, 0])
    parts = [flat[k:k + block] for k in range(0, len(flat), block)]
    return np.concatenate([p[np.argsort(p[:, 0], kind="stable")] for p in parts]).reshape(a.shape)


def _merge_infer(name, inputs, attrs):
    if inputs[0].vtype != "ivec2" or not is_int(inputs[1].vtype):
        raise GraphError(f"{name}: an ivec2 table and an int are needed, got {inputs[0]!r} and {inputs[1]!r}")
    return "ivec2", inputs[0].extent


def _merge_sample(rng):
    keys = np.concatenate([np.sort(rng.integers(0, 9, 8)) for _ in range(3)])[:20]
    return [np.stack([keys, np.arange(20)], 1).reshape(5, 4, 2), np.array([[[8]]])], {}


# Entry d of a merged pair of runs has `lo` of the first before it: the least for which the first's entry exceeds the second's.
_MERGE = """{ int n_ = {n}, d_ = {i} & (2 * {run} - 1), first_ = {i} - d_, second_ = first_ + {run};
    {y} = {a}({p});
    if (second_ < n_ && {a_at}(second_ - 1).x > {a_at}(second_).x) {
        int size_ = min({run}, n_ - second_), lo_ = max(d_ - size_, 0), hi_ = min(d_, {run});
        while (lo_ < hi_) {
            int m_ = (lo_ + hi_) >> 1;
            if ({a_at}(first_ + m_).x <= {a_at}(second_ + d_ - 1 - m_).x) lo_ = m_ + 1; else hi_ = m_;
        }
        ivec2 u_ = {a_at}(first_ + min(lo_, {run} - 1)), v_ = {a_at}(second_ + min(d_ - lo_, size_ - 1));
        {y} = lo_ < {run} && (d_ - lo_ >= size_ || u_.x <= v_.x) ? u_ : v_;
    } }"""
TOTAL = "{total}(ivec2({total_w} - 1, {total_h} - 1))"


def _merge_listed_ref(a, run, total):
    out, count = a.copy(), int(total.reshape(-1)[-1])
    if count:
        out.reshape(-1, 2)[:count] = merge_ref(a.reshape(-1, 2)[:count], run)
    return out


op("merge_runs", "a run", alone=True, infer=_merge_infer, reads="texel own", ref=merge_ref, cost=200, sample=_merge_sample,
   glsl=_MERGE.replace("{n}", "{a_w} * {a_h}"),
   doc="Stable merge of neighbouring runs of `run` entries (a power of two), each sorted by the first channel.")


op("merge_listed", "a run total", alone=True, infer=_merge_infer, reads="texel own texel", ref=_merge_listed_ref, cost=200,
   glsl=_MERGE.replace("{n}", TOTAL).replace("if (second_", "if ({i} < n_ && second_", 1),
   sample=lambda rng: ([*_merge_sample(rng)[0], np.array([[[17]]])], {}),
   doc="merge_runs of as many entries as the last texel of `total` says.")
