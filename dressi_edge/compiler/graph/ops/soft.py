"""Soft rasterization over every face near a pixel: a sum over the sparse relation pixel x face, and its transpose.

In: for each face of each view (view by view) its three corners v = (x, y, near / w, depth): screen place from the middle of its view's
cell in pixels, and a depth that is larger the nearer it is; colours c of the corners; boxes of pixels (`soft_boxes`) and lists by tile
(`bins.py`), with masks of what of a tile each face comes near (`soft_mask.py`). Out: a picture and its alpha. Pixels go through the list
of their tile once: the largest depth so far is kept, and sums are rescaled where it grows (online softmax). What the gradient needs of a
pixel are four numbers and three; of each pair it computes the rest again, for one face after the other over the pixels of its box, in
fixed order.

Formulas: docs/conventions.md, "Every face". 1 / w is linear on screen, and a corner is before the near plane where near / w is in (0, 1].
"""
from __future__ import annotations

import numpy as np

from ....cache.errors import GraphError
from ..ir import UNIT, Extent, Node, image
from ..optable import Loop, apply, at, op
from . import soft_reference as reference
from .bins import Grid
from .lookup import constant, constant_table, to_table
from .soft_glsl import ADD_WEIGHTS, BY_DISTANCE, BY_WEIGHTS, FUNCTIONS, GEOMETRY, NEAREST, NEXT, TILE, WEIGHTS, over_box
from .soft_mask import soft_masks
from .tile_lists import bin_faces
from .vector import compose

LEAST, TINY = reference.LEAST, reference.TINY

_ALPHA = TILE + """float clear_ = 1.0;
for (int k_ = range_.x; ;) {
""" + NEXT + GEOMETRY + """clear_ *= beside_;
if (clear_ < 2e-8) k_ = range_.y;  // alpha is 1 to the last bit
"""
_SUMS = TILE + """float clear_ = 1.0, most_ = float({least});
for (int k_ = range_.x; ;) {
""" + NEXT + GEOMETRY + WEIGHTS + """clear_ *= beside_;
float away_ = exp(-abs(z_ - most_) / float({gamma}));
bool nearer_ = near_ && z_ > most_;
float keep_ = nearer_ ? away_ : 1.0, w_ = probability_ * (nearer_ ? 1.0 : away_);
most_ = nearer_ ? z_ : most_;
vec3 color_ = b_.x * {c0_at}(f_) + b_.y * {c1_at}(f_) + b_.z * {c2_at}(f_);
"""

ALPHA_BODY = "{y} = 1.0 - clear_;", "} }"
SUMS_BODY = "{y} = {y} * keep_ + w_ * vec4(color_, 1.0);", "} }"
MOST_BODY = "{y} = vec2(near_ || {y}.x != 0.0 ? most_ : 0.0, 1.0 - clear_);", "} }"

_ALPHA_TURN = NEAREST + "float by_x_ = {slope}(p_) * probability_;\n" + BY_DISTANCE
_ALPHA_GRADIENT, _ALPHA_LEAN = (text + _ALPHA_TURN for text in over_box("", ""))
_KEPT = "vec3 k0_ = {c0_at}({i}), k1_ = {c1_at}({i}), k2_ = {c2_at}({i});\n"
_SLOPE = "vec4 slope_ = {slope}(p_);\nvec3 by_b_w_ = vec3(dot(slope_.xyz, k0_), dot(slope_.xyz, k1_), dot(slope_.xyz, k2_));\n"
_BLEND_TURN = NEAREST + "vec2 most_ = {most}(p_);\n" + WEIGHTS + BY_WEIGHTS + BY_DISTANCE + ADD_WEIGHTS
_BLEND_GRADIENT, _BLEND_LEAN = (text + _BLEND_TURN for text in over_box(_KEPT, _SLOPE))
_CORNER = "({corner} == 0 ? g0_ : {corner} == 1 ? g1_ : g2_)"

_CELLS = "cell_w cell_h columns face_count"
PAIR = _CELLS + " radius sigma squared hard_only nearest"
_TILES = "extent views tiles_x tiles_y tile_w tile_h"
LISTED = _TILES + " each"
_DEPTH = " gamma base"


def _need_faces(name, inputs, views, attrs):
    """Tables of all faces of all views."""
    for x in inputs:
        if x.extent.count % attrs["face_count"] or views and x.extent.count != views * attrs["face_count"]:
            raise GraphError(f"{name}: {x!r} is no table of views of {attrs['face_count']} faces")


def over_pixels(vtype: str, tables: int):
    def infer(name, inputs, attrs):
        _need_faces(name, inputs[:tables], attrs["views"], attrs)
        if inputs[tables].extent.count != attrs["views"] * attrs["tiles_x"] * attrs["tiles_y"]:
            raise GraphError(f"{name}: ranges are {inputs[tables]!r}; a table of {attrs['tiles_x']} x {attrs['tiles_y']} tiles of "
                             f"{attrs['views']} views is needed")
        return vtype, attrs["extent"]
    return infer


def _over_faces(vtype: str):
    def infer(name, inputs, attrs):
        _need_faces(name, inputs[:-2], 0, attrs)
        e = inputs[0].extent
        return vtype, Extent(e.width, e.height + attrs["band"], e.count)
    return infer


def pair_attrs(grid: Grid, radius: float, sigma: float, squared: bool, hard_only: bool, nearest: float) -> dict:
    """Attributes of the ops that look at pairs."""
    return {"cell_w": grid.cell_w, "cell_h": grid.cell_h, "columns": grid.columns, "face_count": grid.faces, "radius": float(radius),
            "sigma": float(sigma), "squared": int(squared), "hard_only": int(hard_only), "nearest": float(nearest)}


def listed_attrs(grid: Grid, extent) -> dict:
    """Attributes of the ops that go through lists, so many entries of each."""
    return {"each": EACH, **_tiles_attrs(grid, extent)}


def _tiles_attrs(grid: Grid, extent) -> dict:
    return {"extent": extent, "views": grid.views, "tiles_x": grid.tiles[0], "tiles_y": grid.tiles[1], "tile_w": grid.tile[0],
            "tile_h": grid.tile[1]}


# ---- a sample: two views of faces, some of which cross the near plane

_GRID = Grid(2, 6, 13, 11, 2, (8, 4))
_SOFT = {"radius": 2.0, "sigma": 0.7, "squared": False, "hard_only": False, "nearest": -0.05}


def _corners(rng) -> list[np.ndarray]:
    count = _GRID.views * _GRID.faces
    place = rng.uniform((-5, -4), (5, 4), (count, 3, 2)) + rng.uniform(-2, 2, (count, 1, 2))
    w = rng.uniform(1.2, 3.0, (count, 3, 1))
    w[1, 0, 0], w[2, 1:, 0], w[8, 2, 0] = -0.7, (-0.4, -1.1), 0.5  # behind the plane w = 1
    v = np.concatenate([place, 1 / w, -w / 20], 2)
    return [to_table(v[:, k]) for k in range(3)]


def _lists(corners, boxes, attrs) -> list[np.ndarray]:
    """Ranges, faces and masks of the boxes, and that they are those of tiles."""
    from ..reference import evaluate
    count = _GRID.views * _GRID.faces
    binned = bin_faces(constant_table(boxes.reshape(-1, 4)[:count]), _GRID)
    masks = soft_masks([constant_table(v.reshape(-1, 4)[:count]) for v in corners], binned, _GRID, attrs["radius"])
    return evaluate([binned.ranges, binned.faces, masks, binned.spilled])


def sample_of(colors: bool, squared: bool = False):
    def sample(rng):
        corners = _corners(rng)
        attrs = pair_attrs(_GRID, **{**_SOFT, "squared": squared})
        boxes = reference.soft_boxes(*corners, reach=2.05, tight=0, **{k: attrs[k] for k in _CELLS.split()})
        more = [to_table(rng.uniform(0, 1, (_GRID.views * _GRID.faces, 3))) for _ in range(3)] if colors else []
        lists = _lists(corners, boxes, attrs)
        attrs |= listed_attrs(_GRID, image(26, 11))
        return [*corners, *more, boxes, *lists], attrs
    return sample


def _sums_sample(rng):
    arguments, attrs = sample_of(True)(rng)
    return arguments, {**attrs, "gamma": 0.05, "base": 1.05, "least": LEAST - 1.05}


def _boxes_sample(rng):
    return _corners(rng), {**{k: pair_attrs(_GRID, **_SOFT)[k] for k in _CELLS.split()}, "reach": 2.05, "tight": 1}


op("soft_boxes", "v0 v1 v2", alike=((1, 0), (2, 0)), attrs="reach tight " + _CELLS, infer=at(0, vtype="ivec4"),
   reads="own own own", ref=reference.soft_boxes,
   functions=FUNCTIONS, cost=60, sample=_boxes_sample,
   glsl="""{ vec3 v0_ = {v0}.xyz, v1_ = {v1}.xyz, v2_ = {v2}.xyz;
    vec4 s0_ = soft_clip(v0_, v1_), s1_ = soft_clip(v1_, v2_), s2_ = soft_clip(v0_, v2_);
    vec2 lo_ = vec2(1e9), hi_ = vec2(-1e9), cell_ = vec2(ivec2({cell_w}, {cell_h}));
    if (s0_.x < 1e8) { lo_ = min(s0_.xy, s0_.zw); hi_ = max(s0_.xy, s0_.zw); }
    if (s1_.x < 1e8) { lo_ = min(lo_, min(s1_.xy, s1_.zw)); hi_ = max(hi_, max(s1_.xy, s1_.zw)); }
    if (s2_.x < 1e8) { lo_ = min(lo_, min(s2_.xy, s2_.zw)); hi_ = max(hi_, max(s2_.xy, s2_.zw)); }
    int view_ = {i} / {face_count};
    ivec2 at_ = ivec2(view_ % {columns}, view_ / {columns}) * ivec2({cell_w}, {cell_h});
    ivec2 first_ = ivec2(clamp(lo_ + 0.5 * cell_ - (float({reach}) - 0.5), vec2(0.0), cell_));
    ivec2 end_ = ivec2(clamp(hi_ + 0.5 * cell_ + (float({reach}) + 0.5), vec2(0.0), cell_)), wide_ = max(end_ - first_, ivec2(0));
    bool plain_ = soft_front(v0_.z) && soft_front(v1_.z) && soft_front(v2_.z);
    int many_ = {tight} != 0 && plain_ && max(wide_.x, wide_.y) <= """ + str(reference.SMALL) + """ ? wide_.x * wide_.y : 0;
    if (many_ > 0) {
        vec2 e0_ = v1_.xy - v0_.xy, e1_ = v2_.xy - v1_.xy, e2_ = v0_.xy - v2_.xy;
        vec3 far_ = float({reach}) * vec3(length(e0_), length(e1_), length(e2_));
        float facing_ = soft_cross(e0_, e1_) < 0.0 ? -1.0 : 1.0;
        ivec2 p_ = first_, low_ = end_, high_ = first_;
        for (int k_ = 0; k_ < many_; ++k_) {
            vec2 q_ = vec2(p_) + 0.5 - 0.5 * cell_;
            vec3 side_ = facing_ * vec3(soft_cross(e0_, q_ - v0_.xy), soft_cross(e1_, q_ - v1_.xy), soft_cross(e2_, q_ - v2_.xy)) + far_;
            bool in_ = min(min(side_.x, side_.y), side_.z) >= 0.0;
            low_ = in_ ? min(low_, p_) : low_;
            high_ = in_ ? max(high_, p_ + 1) : high_;
            p_ = p_.x + 1 < end_.x ? ivec2(p_.x + 1, p_.y) : ivec2(first_.x, p_.y + 1);
        }
        first_ = low_;
        end_ = high_;
    }
    {y} = {i} < {n} && lo_.x <= hi_.x && first_.x < end_.x && first_.y < end_.y ? ivec4(first_ + at_, end_ + at_) : ivec4(0); }""",
   doc="Half-open boxes of the pixels whose centres may be within `reach` of a face; empty where it is wholly behind or beside. Of small "
       "faces those that are, if `tight`: no more than `reach` on the outer side of each edge.")


TURNS = 60000  # of the loops of one invocation: llvmpipe ends them, and says nothing, after 65535


def _by_bands(name: str, inputs: tuple[Node, ...], **attrs) -> Node:
    """The sum over bands of rows, of so few pixels each that no loop over a face's box, of one turn a pixel, is too long. Each
    has another extent (one more row of padding), for the turns of all loops of one shader count together."""
    height = attrs["cell_h"]
    rows = max(1, min(height, TURNS // attrs["cell_w"]))
    found = None
    for number, low in enumerate(range(0, height, rows)):
        band = apply(name, *inputs, low=low, high=min(low + rows, height), band=number, **attrs)
        band = apply("reshape", band, extent=inputs[0].extent) if number else band
        found = band if found is None else found + band
    return found


# Entries of a list that one invocation goes through: five turns each where masks say which come near, and where boxes do, of entries that
# have no tile, as many more as lanes that run together may find theirs at different ones.
EACH = TURNS // 12


def _alpha_vjp(g, y, v0, v1, v2, boxes, *lists, **attrs):
    pair = {k: attrs[k] for k in PAIR.split()}
    slope = g * (1.0 - y)
    where = v0, v1, v2, boxes, slope
    return (*(_by_bands("soft_alpha_gradient", where, corner=k, **pair) for k in range(3)), None, *(None for _ in lists))


op("soft_alpha", "v0 v1 v2 boxes ranges faces masks spilled", attrs=f"{LISTED} {PAIR}", infer=over_pixels("float", 4),
   reads=" ".join(["texel"] * 8),
   ref=reference.soft_alpha, vjp=_alpha_vjp, functions=FUNCTIONS, cost=2000, sample=sample_of(False),
   loop=Loop(_ALPHA, *ALPHA_BODY),
   doc="1 - prod(1 - D) over the faces of the pixel's list that cover it or are within `radius`; D: the sigmoid of the signed distance (or "
       "its square) to the nearest edge over sigma, or with `hard_only` 1 for what covers the pixel.")


def _whole_vjp(g, y, alpha, v0, v1, v2, boxes, **pair):
    where = v0, v1, v2, boxes, g * (1.0 - alpha)
    return (None, *(_by_bands("soft_alpha_gradient", where, corner=k, **pair) for k in range(3)), None)


def _whole_sample(rng):
    arguments, attrs = sample_of(False)(rng)
    alpha = reference.soft_alpha(*arguments, **attrs)
    nodes = [constant_table(x.reshape(-1, x.shape[2])[:_GRID.views * _GRID.faces]) for x in arguments[:4]]
    return [constant(alpha), *nodes], {k: attrs[k] for k in PAIR.split()}


op("soft_whole", "alpha v0 v1 v2 boxes", attrs=PAIR, reads="own texel texel texel texel", cost=1, sample=_whole_sample,
   infer=lambda name, inputs, attrs: (inputs[0].vtype, inputs[0].extent), ref=lambda alpha, *_, **attrs: alpha, vjp=_whole_vjp,
   glsl="{y} = {alpha};",
   doc="alpha, of which it is known that it is that of soft_alpha over all of these faces: gradients by their corners come from here.")


def _alpha_gradient_sample(rng):
    arguments, attrs = sample_of(False)(rng)
    attrs = {k: attrs[k] for k in PAIR.split()}
    return [*arguments[:4], rng.normal(size=(11, 26, 1))], {**attrs, "corner": 1, "low": 2, "high": 9, "band": 0}


op("soft_alpha_gradient", "v0 v1 v2 boxes slope", alike=((1, 0), (2, 0), (3, 0)), attrs=f"corner low high band {PAIR}",
   reads=" ".join(["texel"] * 5), infer=_over_faces("vec4"),
   ref=reference.soft_alpha_gradient, functions=FUNCTIONS, cost=2000, sample=_alpha_gradient_sample,
   loop=Loop(_ALPHA_GRADIENT, "{y} += " + _CORNER + ";", "} }", holds=30, lean=(_ALPHA_LEAN, 12)),
   doc="Transpose of soft_alpha: for each face the gradient by one corner, over the pixels of its box in rows low to high of the cell; "
       "`band` rows of padding. slope: the gradient by alpha times 1 - alpha.")

for _name, _vtype, _body, _doc in (
        ("soft_sums", "vec4", SUMS_BODY,
         "Sums over the faces of the pixel's list of w times colour, and of w = D exp((depth - largest depth) / gamma)."),
        ("soft_most", "vec2", MOST_BODY,
         "The largest depth of the faces near the pixel, 0 if there is none, at least that of normalized depth 1e-10; and alpha, as of "
         "soft_alpha.")):
    op(_name, "v0 v1 v2 c0 c1 c2 boxes ranges faces masks spilled", attrs=f"{LISTED} {PAIR} least{_DEPTH}", infer=over_pixels(_vtype, 7),
       reads=" ".join(["texel"] * 11), ref=getattr(reference, _name), functions=FUNCTIONS, cost=3000, sample=_sums_sample,
       loop=Loop(_SUMS, *_body), doc=_doc)


def _far(sums: Node, most: Node, gamma: float, base: float) -> Node:
    """The background's weight."""
    away = apply("exp", apply("min", (most.x * -1.0 + (LEAST - base)) * (1.0 / gamma), 0.0))
    return apply("select", sums.w > 0.0, apply("max", away, LEAST), 1.0)


def _blend_vjp(g, y, sums, most, background, v0, v1, v2, c0, c1, c2, boxes, gamma, base, over, **attrs):
    color, weight, alpha = g.xyz, sums.w, most.y
    if over:
        some = weight > TINY
        mean = apply("select", some, sums.xyz / apply("select", some, weight, 1.0), 0.0)
        inner = apply("select", some, color * (alpha / apply("select", some, weight, 1.0)), 0.0)
        by_clear = (g.w + apply("dot", color, mean - background)) * (1.0 - alpha)
        by_background = color * (1.0 - alpha)
    else:
        far = _far(sums, most, gamma, base)
        whole = weight + far
        mean, inner = y.xyz, color / whole
        by_clear, by_background = g.w * (1.0 - alpha), color * (far / whole)
    slope = compose(inner.x, inner.y, inner.z, apply("dot", inner, mean) * -1.0)
    where = v0, v1, v2, c0, c1, c2, boxes, slope, compose(most.x, by_clear)
    places = (_by_bands("soft_place_gradient", where, corner=k, gamma=gamma, **attrs) for k in range(3))
    colors = (_by_bands("soft_color_gradient", where, corner=k, gamma=gamma, **attrs) for k in range(3))
    return (slope, None, by_background, *places, *colors, None)


def _blend_infer(name, inputs, attrs):
    sums, most, background = inputs[:3]
    if sums.extent != most.extent or background.vtype != "vec3" or background.extent not in (UNIT, sums.extent):
        raise GraphError(f"{name}: {sums!r}, {most!r} and the background {background!r} do not lie alike")
    _need_faces(name, inputs[3:], 0, attrs)
    return "vec4", sums.extent


def _blend_sample(over):
    def sample(rng):
        arguments, attrs = _sums_sample(rng)
        nodes = [constant_table(x.reshape(-1, x.shape[2])[:_GRID.views * _GRID.faces]) for x in arguments[:7]]
        return [reference.soft_sums(*arguments, **attrs), reference.soft_most(*arguments, **attrs), rng.uniform(0, 1, (1, 1, 3)), *nodes], {
            **{k: attrs[k] for k in (PAIR + _DEPTH).split()}, "over": over}
    return sample


op("soft_blend", "sums most background v0 v1 v2 c0 c1 c2 boxes", attrs=f"{PAIR}{_DEPTH} over", infer=_blend_infer,
   reads="own own own texel texel texel texel texel texel texel", ref=reference.soft_blend, vjp=_blend_vjp, cost=20,
   sample=_blend_sample(0),
   glsl="""if ({over} != 0) {
    vec3 mean_ = {sums}.w > """ + repr(TINY) + """ ? {sums}.xyz / max({sums}.w, """ + repr(TINY) + """) : vec3(0.0);
    {y} = vec4(mean_ * {most}.y + {background} * (1.0 - {most}.y), {most}.y);
} else {
    float far_ = {sums}.w > 0.0 ? max(exp(min((float({base}) * -1.0 + """ + repr(LEAST) + """ - {most}.x) / float({gamma}), 0.0)), """
   + repr(LEAST) + """) : 1.0;
    {y} = vec4(({sums}.xyz + far_ * {background}) / ({sums}.w + far_), {most}.y);
}""", doc="The colour of soft_sums over the background, and alpha. over 0: the background has the weight max(exp((1e-10 - largest "
          "normalized depth) / gamma), 1e-10) beside the faces'; over 1: the faces' mean is laid over it by alpha. Gradients by the "
          "faces' corners come from here, with the largest depth held.")


def _blend_gradient_sample(rng):
    arguments, attrs = _sums_sample(rng)
    most = reference.soft_most(*arguments, **attrs)
    most[..., 1] = rng.normal(size=most.shape[:2])
    attrs = {k: attrs[k] for k in (PAIR + " gamma").split()}
    return [*arguments[:7], rng.normal(size=(11, 26, 4)), most], {**attrs, "corner": 2, "low": 2, "high": 9, "band": 0}


for _name, _vtype, _body, _what in (("soft_place_gradient", "vec4", "{y} += " + _CORNER + ";", "place and depth"),
                                    ("soft_color_gradient", "vec3",
                                     "{y} += slope_.xyz * (w_ * ({corner} == 0 ? b_.x : {corner} == 1 ? b_.y : b_.z));", "colour")):
    op(_name, "v0 v1 v2 c0 c1 c2 boxes slope most", alike=(*((k, 0) for k in range(1, 7)), (8, 7)),
       attrs=f"corner low high band {PAIR} gamma", reads=" ".join(["texel"] * 9), infer=_over_faces(_vtype), cost=3000,
       ref=getattr(reference, _name), functions=FUNCTIONS, sample=_blend_gradient_sample,
       loop=Loop(_BLEND_GRADIENT, _body, "} }", holds=38, lean=(_BLEND_LEAN, 21)),
       doc=f"Transpose of soft_blend: for each face the gradient by one corner's {_what}, over the pixels of its box in rows low to high "
           "of the cell; `band` rows of padding. slope: by the sum of colours and of weights; most: the largest depth, and the gradient by "
           "alpha times 1 - alpha.")
