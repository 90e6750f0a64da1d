"""The exact transpose of trilinear sampling: for each texel of each level the sum of weight x gradient over its pixels, by gathers only.

    reads by cell (`mip_lists.py`) -> sums of runs -> touched texels -> levels, coarse to fine

The reads of a cell are summed by themselves, once with the weights of each of its corners: a gradient is fetched twice a pixel, not eight
times. A texel then is the sum of a corner of each of the four cells around it. Where many pixels see few texels, a cell is several sums.

All but sums depends on coordinates and levels of detail alone. What a texel of level l gets is divided by how many texels it stands for;
so it is what each of those gets, and what comes of coarse levels is handed down as it is.
"""
from __future__ import annotations

import numpy as np

from ....cache.errors import GraphError
from ..ir import Extent, Node, image
from ..optable import Loop, apply, empty, negative, op
from .lookup import lookup_infer, lookup_ref
from .mip_lists import SIZE, Chain, around_ref, numbered, over, reads_of, share_ref
from .mip_pyramid import Pyramid
from .stencil import upsample

FOLD = 4  # the level that gets what all coarser ones get at once


def transpose(g: Node, uv: Node, lod: Node, covered: Node, extent: Extent, wrap: tuple[str, str], apart: Node | None = None,
              count: int = 1) -> Node:
    """The gradient of a texture of `extent`, of which a pixel has one sample, or the mean of `count` that are `apart`."""
    p = Pyramid(extent.width, extent.height)
    size = {"width": p.width, "height": p.height}
    uv, lod, covered, *more = over(g.extent, uv, lod, covered, *([] if apart is None else [apart]))
    r = reads_of(p, uv, lod, covered, wrap, *more, count=count)
    sums = [apply(f"mip_sums_{corner}", g, r.spans, r.reads, pixels=g.extent.count) for corner in ("00", "10", "01", "11")]
    around = [apply("mip_around", r.cells, r.touched.entries, ends=ends, **size) for ends in (0, 1)]
    each = apply("mip_meet", *sums, *around, 1.0 if p.even else apply("mip_share", r.touched.entries, **size))
    return apply("mip_fold", each, r.touched.slots, level=0, **size)


def _handed_down(node: Node) -> Node:
    """A `mip_fold` of the texture itself, level by level."""
    (each, slots), p = node.inputs, Pyramid(node.attrs["width"], node.attrs["height"])
    if node.attrs["level"]:
        return node

    def own(level: int) -> Node:
        return apply("mip_taken", each, apply("excerpt", slots, first=p.starts[level], extent=image(*p.size(level))))

    level = min(FOLD, p.last)
    total = apply("mip_fold", each, slots, width=p.width, height=p.height, level=level)
    while level:
        level -= 1
        total = own(level) + upsample(total, p.size(level))
    return total


# ---- the transpose itself

def _corner(corner: int, fx, fy, one=1.0):
    return (fx if corner & 1 else one - fx) * (fy if corner >> 1 else one - fy)


def _sums_ref(g, spans, reads, corner):
    pixels, (fx, fy, w) = reads.reshape(-1, 4)[:, 0].astype(int), reads.reshape(-1, 4)[:, 1:].T
    terms = g.reshape(-1, g.shape[2])[pixels] * (_corner(corner, fx, fy) * w)[:, None]
    return np.array([terms[begin:max(begin, end)].sum(0) for begin, end in spans.reshape(-1, 2)]).reshape(*spans.shape[:2], -1)


def _sums_infer(name, inputs, attrs):
    g, spans, reads = inputs
    if spans.vtype != "ivec2" or reads.vtype != "vec4" or g.extent.count != attrs["pixels"]:
        raise GraphError(f"{name}: {attrs['pixels']} gradients, spans as ivec2 and reads as vec4 are needed, got {g!r}, {spans!r}, "
                         f"{reads!r}")
    return g.vtype, spans.extent


def _sums_loop(corner: int) -> Loop:
    x, y = ("e_.y" if corner & 1 else "(1.0 - e_.y)"), ("e_.z" if corner >> 1 else "(1.0 - e_.z)")
    return Loop("for (int k_ = {spans}.x; k_ < {spans}.y; ++k_) { vec4 e_ = {reads_at}(k_); {type} g_ = {g_at}(int(e_.x)) * e_.w;",
                f"{{y}} += {x} * {y} * g_;")


for _corner_name, _number in (("mip_sums_00", 0), ("mip_sums_10", 1), ("mip_sums_01", 2), ("mip_sums_11", 3)):
    op(_corner_name, "g spans reads", attrs="pixels", sums=(0,), reads="texel own texel", cost=60, infer=_sums_infer, when=empty(1),
       ref=(lambda corner: lambda g, spans, reads, pixels: _sums_ref(g, spans, reads, corner))(_number), loop=_sums_loop(_number),
       sample=lambda rng: ((lambda c: [rng.normal(size=(6, 5, 3)), c.spans, c.reads])(Chain(rng)), {"pixels": 30}),
       doc=f"Over each run the sum of weight x g of corner {_corner_name[-2:]} (column, row) of its cell.")


def _meet_ref(s00, s10, s01, s11, firsts, ends, share):
    total = 0
    for k, x in enumerate((s00, s10, s01, s11)):
        flat = x.reshape(-1, x.shape[2])
        before = np.concatenate([np.zeros((1, flat.shape[1])), np.cumsum(flat, 0)])
        first, several = firsts[..., k] >> 1, firsts[..., k] & 1
        begin = np.clip(first, 0, len(flat) - 1)
        end = np.where(first < 0, begin, np.where(several != 0, np.clip(ends[..., k], begin, len(flat)), begin + 1))
        total = total + before[end] - before[begin]
    return share * total


def _meet_infer(name, inputs, attrs):
    if {x.vtype for x in inputs[4:6]} != {"ivec4"} or len({(x.vtype, x.extent) for x in inputs[:4]}) != 1:
        raise GraphError(f"{name}: four sums of one type and ivec4 runs are needed, got {', '.join(map(repr, inputs))}")
    return inputs[0].vtype, inputs[4].extent


def _meet_glsl(node: Node) -> str:
    """Mostly a cell has one run; others go on in loops, of which most groups of texels have no turn."""
    sums = tuple(zip(("s00", "s10", "s01", "s11"), "xyzw"))
    lines = ["ivec4 f_ = {firsts}, b_ = max(f_, ivec4(0)) >> 1; {y} = {type}(0);"]
    lines += [f"{{type}} {s}_ = {{{s}_at}}(b_.{c}); if (f_.{c} >= 0) {{y}} += {s}_;" for s, c in sums]
    lines += ["b_ = mix(ivec4(2147483647), b_ + 1, equal(f_ & 1, ivec4(1))); b_ = mix(b_, ivec4(2147483647), lessThan(f_, ivec4(0)));",
              "for (int j_ = min(min(b_.x, b_.y), min(b_.z, b_.w)) < 2147483647 ? 0 : 1; j_ < 1; ++j_) { ivec4 e_ = {ends_at}({i});"]
    lines += [f"for (int k_ = b_.{c}; k_ < e_.{c}; ++k_) {{y}} += {{{s}_at}}(k_);" for s, c in sums]
    return "{ " + "\n    ".join(lines) + " }\n    {y} *= {share}; }"


op("mip_meet", "s00 s10 s01 s11 firsts ends share", attrs="", sums=(0, 1, 2, 3), reads="texel texel texel texel own texel own", cost=60,
   ref=_meet_ref, infer=_meet_infer, glsl=_meet_glsl, sample=lambda rng: (_meet_sample(rng), {}),
   doc="Of each texel of a list the sums of one corner of each of the four cells around it, times its share.")


def _meet_sample(rng):
    c = Chain(rng)
    firsts, ends = (around_ref(c.cells, c.texels, ends=ends, **SIZE) for ends in (0, 1))
    return [*(rng.normal(size=(*c.spans.shape[:2], 3)) for _ in range(4)), firsts, ends, share_ref(c.texels, **SIZE)]


op("mip_taken", "each index", attrs="", when=negative(1), reads="texel own", cost=8, ref=lookup_ref, infer=lookup_infer,
   loop=Loop("for (int k_ = {index}; k_ >= 0; k_ = -1) {", "{y} += {each_at}(k_);"),
   sample=lambda rng: ([rng.normal(size=(4, 4, 3)), rng.integers(-1, 16, (5, 3, 1))], {}),
   doc="lookup, where most of the indices are negative: whole groups of texels then do nothing.")


def _fold_ref(each, slots, width, height, level):
    p, flat, out = Pyramid(width, height), each.reshape(-1, each.shape[2]), 0
    w, h = p.size(level)
    for m in range(level, p.last + 1):
        own = lookup_ref(flat[None], p.texels(slots.reshape(-1, 1), m))
        out = out + own.repeat(1 << m - level, 0).repeat(1 << m - level, 1)[:h, :w]
    return out


def _fold_glsl(node: Node) -> str:
    p, level = Pyramid(node.attrs["width"], node.attrs["height"]), node.attrs["level"]
    return f"""{{ {p.glsl} {{y}} = {{type}}(0);
    for (int m_ = {level}; m_ <= {p.last}; ++m_) {{ ivec2 a_ = {{p}} >> (m_ - {level});
    int q_ = o_[m_] + a_.y * (({p.width} + (1 << m_) - 1) >> m_) + a_.x;
    for (int k_ = {{slots_at}}(q_); k_ >= 0; k_ = -1) {{y}} += {{each_at}}(k_); }} }}"""


def _fold_infer(name, inputs, attrs):
    p = Pyramid(attrs["width"], attrs["height"])
    if inputs[1].vtype != "int" or inputs[1].extent != numbered(p):
        raise GraphError(f"{name}: a place for each texel of {p.width}x{p.height} and its levels is needed, got {inputs[1]!r}")
    return inputs[0].vtype, image(*p.size(attrs["level"]))


def _blocks(node: Node):
    from .mip_blocks import Blocks
    return None if node.attrs["level"] else Blocks(node)


op("mip_fold", "each slots", attrs="width height level", reads="texel texel", cost=60, ref=_fold_ref, infer=_fold_infer, glsl=_fold_glsl,
   late=_handed_down, blocked=_blocks,
   sample=lambda rng: ((lambda c: [rng.normal(size=(c.texels.shape[0], c.texels.shape[1], 3)), c.slots])(Chain(rng)), {**SIZE, "level": 2}),
   doc="What a level's texels get, with all that coarser texels hand down to them; slots: where each texel of all levels stands in a list.")


def _excerpt_ref(x, first, extent):
    flat, count = x.reshape(-1, x.shape[2]), extent.width * extent.height
    return flat[first:first + count].reshape(extent.height, extent.width, -1)


def _excerpt_infer(name, inputs, attrs):
    x, e, first = inputs[0], attrs["extent"], attrs["first"]
    if first < 0 or first + e.width * e.height > x.extent.width * x.extent.height:
        raise GraphError(f"{name}: entries {first} to {first + e.width * e.height} of {x!r}, which has fewer")
    return x.vtype, e


op("excerpt", "x", attrs="first extent", infer=_excerpt_infer, reads="texel", cost=2, ref=_excerpt_ref, glsl="{y} = {x_at}({first} + {i});",
   sample=lambda rng: ([rng.normal(size=(5, 4, 2))], {"first": 3, "extent": image(5, 3)}),
   doc="Entries of an image, row by row from `first` on, as an image; no gradient.")
