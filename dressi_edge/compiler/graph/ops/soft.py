"""Soft rasterization over every face near a pixel: a sum over the sparse relation pixel x face, and its transpose.

In: for each face of each view (view by view) its three corners v = (x, y, near / w, depth): screen place from the middle of its view's cell
in pixels, and a depth that is larger the nearer it is; colours c of the corners; boxes of pixels (`soft_boxes`) and lists by tile
(`bins.py`). Out: a picture and its alpha. Pixels go through the list of their tile once: the largest depth so far is kept, and sums are
rescaled where it grows (online softmax). What the gradient needs of a pixel are four numbers and three; of each pair it computes the rest
again, for one face after the other over the pixels of its box, in fixed order.

Formulas: docs/conventions.md, "Every face". 1 / w is linear on screen, and a corner is before the near plane where near / w is in (0, 1].
"""
from __future__ import annotations

import numpy as np

from ....cache.errors import GraphError
from ..ir import UNIT, Extent, Node, image
from ..optable import Loop, apply, at, op
from . import soft_reference as reference
from .bins import Grid
from .lookup import constant_table, to_table
from .tile_lists import bin_faces
from .vector import compose

LEAST, TINY = reference.LEAST, reference.TINY

FUNCTIONS = """
float soft_cross(vec2 a, vec2 b) { return a.x * b.y - a.y * b.x; }
bool soft_front(float iw) { return iw > 0.0 && iw <= 1.0; }
// Screen ends of the edge between corners (x, y, near / w), clipped to the near plane; 1e9 where nothing is left.
vec4 soft_clip(vec3 a, vec3 b) {
    bool front_a = soft_front(a.z), front_b = soft_front(b.z);
    if (!front_a && !front_b) return vec4(1e9);
    float den = b.z - a.z;
    vec2 cut = a.xy + (b.xy - a.xy) * ((1.0 - a.z) / (front_a != front_b ? den : 1.0));
    return vec4(front_a ? a.xy : cut, front_b ? b.xy : cut);
}
// Squared distance of the origin to a segment, and where on it the nearest point is.
vec2 soft_distance2(vec4 s) {
    vec2 d = s.zw - s.xy;
    float t = clamp(-dot(s.xy, d) / max(dot(d, d), 1e-20), 0.0, 1.0);
    vec2 o = s.xy + t * d;
    return vec2(dot(o, o), t);
}
"""

# Of the corners v0_, v1_, v2_ and the place q_: signed areas, whether the face covers the place, its three edges and how far they are.
GEOMETRY = """
vec2 a0_ = v0_.xy - q_, a1_ = v1_.xy - q_, a2_ = v2_.xy - q_;
vec3 iw_ = vec3(v0_.z, v1_.z, v2_.z), area_ = vec3(soft_cross(a1_, a2_), soft_cross(a2_, a0_), soft_cross(a0_, a1_));
float whole_ = area_.x + area_.y + area_.z, facing_ = whole_ < 0.0 ? -1.0 : 1.0;
area_ *= facing_;
vec3 m_ = area_ * iw_;
bool hard_ = min(min(m_.x, m_.y), m_.z) >= 0.0 && whole_ != 0.0 && abs(whole_) >= m_.x + m_.y + m_.z;
vec4 s0_ = vec4(a0_, a1_), s1_ = vec4(a1_, a2_), s2_ = vec4(a0_, a2_);
for (int cut_ = soft_front(iw_.x) && soft_front(iw_.y) && soft_front(iw_.z) ? 0 : 1; cut_ > 0; --cut_) {
    s0_ = soft_clip(vec3(a0_, iw_.x), vec3(a1_, iw_.y));
    s1_ = soft_clip(vec3(a1_, iw_.y), vec3(a2_, iw_.z));
    s2_ = soft_clip(vec3(a0_, iw_.x), vec3(a2_, iw_.z));
}
vec2 d0_ = soft_distance2(s0_), d1_ = soft_distance2(s1_), d2_ = soft_distance2(s2_);
float far_ = min(min(d0_.x, d1_.x), d2_.x), d_ = sqrt(far_);
bool near_ = hard_ || {hard_only} == 0 && d_ <= float({radius});
float x_ = ({squared} != 0 ? far_ : d_) * (hard_ ? 1.0 : -1.0) / float({sigma}), exp_ = exp(-abs(x_));
float big_ = 1.0 / (1.0 + exp_), small_ = exp_ * big_;
float probability_ = x_ < 0.0 ? small_ : big_, beside_ = x_ < 0.0 ? big_ : small_;
if ({hard_only} != 0) { probability_ = 1.0; beside_ = 0.0; }
if (!near_) { probability_ = 0.0; beside_ = 1.0; }
"""
# Weights b_ of the corners, those outside the face cut to 0, and the depth z_.
WEIGHTS = """
vec3 cut_m_ = max(m_, vec3(0.0));
float mass_ = cut_m_.x + cut_m_.y + cut_m_.z, reach2_ = max(max(dot(a0_, a0_), dot(a1_, a1_)), dot(a2_, a2_));
bool solid_ = abs(whole_) > reach2_ * """ + repr(reference.DEGENERATE) + """ && mass_ > 0.0;
vec3 b_ = solid_ ? cut_m_ / mass_ : vec3(1.0 / 3.0);
float z_ = v0_.w + b_.y * (v1_.w - v0_.w) + b_.z * (v2_.w - v0_.w);
bool held_ = z_ > float({nearest});
z_ = min(z_, float({nearest}));
"""

# The next face of the list whose box has the pixel: a loop of its own, for machines that run both sides of every `if`.
NEXT = """int f_ = -1;
for (; k_ < range_.y && f_ < 0; ++k_) {
    int c_ = {faces_at}(k_);
    ivec4 b_ = {boxes_at}(c_);
    if (b_.x <= {p}.x && b_.z > {p}.x && b_.y <= {p}.y && b_.w > {p}.y) f_ = c_;
}
if (f_ < 0) break;
vec4 v0_ = {v0_at}(f_), v1_ = {v1_at}(f_), v2_ = {v2_at}(f_);
"""
TILE = """{ ivec2 cell_ = {p} / ivec2({cell_w}, {cell_h}), in_ = {p} - cell_ * ivec2({cell_w}, {cell_h});
int view_ = cell_.y * {columns} + cell_.x;
ivec2 range_ = view_ < {views} ? {ranges_at}((view_ * {tiles_y} + in_.y / {tile_h}) * {tiles_x} + in_.x / {tile_w}) : ivec2(0);
vec2 q_ = vec2(in_) + 0.5 - 0.5 * vec2(ivec2({cell_w}, {cell_h}));
"""
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

# Of a face, pixel by pixel of that part of its box which lies in rows `low` to `high` of the cell.
_OVER_BOX = """{ ivec4 box_ = {i} < {n} ? {boxes_at}({i}) : ivec4(0);
int view_ = {i} / {face_count};
vec2 center_ = vec2(ivec2(view_ % {columns}, view_ / {columns}) * ivec2({cell_w}, {cell_h})) + 0.5 * vec2(ivec2({cell_w}, {cell_h}));
vec4 v0_ = {v0_at}({i}), v1_ = {v1_at}({i}), v2_ = {v2_at}({i});
MORE
int top_ = view_ / {columns} * {cell_h};
box_.yw = clamp(box_.yw, top_ + {low}, top_ + {high});
ivec2 p_ = ivec2(box_.x - 1, box_.y);
for (;;) {
if (++p_.x >= box_.z) { p_.x = box_.x; ++p_.y; }
if (p_.y >= box_.w) break;
vec2 q_ = vec2(p_) + 0.5 - center_;
"""
# From by_x_, the gradient by what the sigmoid is of, to the corners: along the nearest edge, and by its cut at the near plane.
BY_DISTANCE = """
bool first_ = d0_.x <= d1_.x && d0_.x <= d2_.x, second_ = !first_ && d1_.x <= d2_.x;
vec4 s_ = first_ ? s0_ : second_ ? s1_ : s2_;
float t_ = first_ ? d0_.y : second_ ? d1_.y : d2_.y;
vec2 along_ = s_.zw - s_.xy, foot_ = s_.xy + t_ * along_, normal_ = vec2(along_.y, -along_.x);
normal_ *= sign(dot(foot_, normal_));
bool between_ = t_ > 0.0 && t_ < 1.0;
vec2 unit_ = (between_ ? normal_ : foot_) / max(between_ ? length(along_) : d_, 1e-20);
if (!near_ || {hard_only} != 0) by_x_ = 0.0;
vec2 by_foot_ = ({squared} != 0 ? 2.0 * foot_ : unit_) * (by_x_ * (hard_ ? 1.0 : -1.0) / float({sigma}));
vec3 by_a_ = vec3(by_foot_ * (1.0 - t_), 0.0), by_b_ = vec3(by_foot_ * t_, 0.0);
vec3 a_ = second_ ? vec3(a1_, iw_.y) : vec3(a0_, iw_.x), e_ = first_ ? vec3(a1_, iw_.y) : vec3(a2_, iw_.z);
for (int cut_ = soft_front(a_.z) == soft_front(e_.z) ? 0 : 1; cut_ > 0; --cut_) {
    float den_ = e_.z - a_.z, u_ = (1.0 - a_.z) / den_;
    vec2 lost_ = soft_front(a_.z) ? by_b_.xy : by_a_.xy;
    float by_u_ = dot(lost_, e_.xy - a_.xy) / den_;
    by_a_ = vec3((soft_front(a_.z) ? by_a_.xy : vec2(0.0)) + lost_ * (1.0 - u_), by_u_ * (1.0 - u_) * -1.0);
    by_b_ = vec3((soft_front(e_.z) ? by_b_.xy : vec2(0.0)) + lost_ * u_, by_u_ * -u_);
}
vec4 g0_ = vec4(second_ ? vec3(0.0) : by_a_, 0.0), g1_ = vec4(first_ ? by_b_ : second_ ? by_a_ : vec3(0.0), 0.0);
vec4 g2_ = vec4(first_ ? vec3(0.0) : by_b_, 0.0);
"""
_BY_WEIGHTS = """
float z_off_ = z_ - most_.x;
float w_ = probability_ * exp(min(z_off_ / float({gamma}), 0.0));
vec3 by_b_w_ = vec3(dot(slope_.xyz, k0_), dot(slope_.xyz, k1_), dot(slope_.xyz, k2_));
float by_w_ = dot(by_b_w_, b_) + slope_.w, by_z_ = held_ ? 0.0 : by_w_ * w_ / float({gamma});
vec3 by_weight_ = by_b_w_ * w_ + by_z_ * vec3(v0_.w, v1_.w, v2_.w);
vec3 by_m_ = solid_ ? (by_weight_ - dot(by_weight_, b_)) / mass_ : vec3(0.0);
by_m_ = vec3(b_.x > 0.0 ? by_m_.x : 0.0, b_.y > 0.0 ? by_m_.y : 0.0, b_.z > 0.0 ? by_m_.z : 0.0);
vec3 by_c_ = by_m_ * iw_ * facing_, by_iw_ = by_m_ * area_;
float by_x_ = by_w_ * w_ * beside_ + most_.y * probability_;
"""
ADD_WEIGHTS = """
g0_ += vec4(by_c_.y * vec2(-a2_.y, a2_.x) + by_c_.z * vec2(a1_.y, -a1_.x), by_iw_.x, by_z_ * b_.x);
g1_ += vec4(by_c_.z * vec2(-a0_.y, a0_.x) + by_c_.x * vec2(a2_.y, -a2_.x), by_iw_.y, by_z_ * b_.y);
g2_ += vec4(by_c_.x * vec2(-a1_.y, a1_.x) + by_c_.y * vec2(a0_.y, -a0_.x), by_iw_.z, by_z_ * b_.z);
"""
_ALPHA_GRADIENT = _OVER_BOX.replace("MORE", "") + GEOMETRY + "float by_x_ = {slope}(p_) * probability_;\n" + BY_DISTANCE
_KEPT = "vec3 k0_ = {c0_at}({i}), k1_ = {c1_at}({i}), k2_ = {c2_at}({i});"
_BLEND_GRADIENT = (_OVER_BOX.replace("MORE", _KEPT) + "vec4 slope_ = {slope}(p_);\nvec2 most_ = {most}(p_);\n" + GEOMETRY + WEIGHTS
                   + _BY_WEIGHTS + BY_DISTANCE + ADD_WEIGHTS)
_CORNER = "({corner} == 0 ? g0_ : {corner} == 1 ? g1_ : g2_)"

_CELLS = "cell_w cell_h columns face_count"
PAIR = _CELLS + " radius sigma squared hard_only nearest"
LISTED = "extent views tiles_x tiles_y tile_w tile_h"
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
    """Attributes of the ops that go through lists."""
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


def _lists(corners, boxes) -> list[np.ndarray]:
    """ranges and faces of the boxes."""
    from ..reference import evaluate
    binned = bin_faces(constant_table(boxes.reshape(-1, 4)[:_GRID.views * _GRID.faces]), _GRID)
    return evaluate([binned.ranges, binned.faces])


def sample_of(colors: bool, squared: bool = False):
    def sample(rng):
        corners = _corners(rng)
        attrs = pair_attrs(_GRID, **{**_SOFT, "squared": squared})
        boxes = reference.soft_boxes(*corners, reach=2.05, **{k: attrs[k] for k in _CELLS.split()})
        more = [to_table(rng.uniform(0, 1, (_GRID.views * _GRID.faces, 3))) for _ in range(3)] if colors else []
        ranges, faces = _lists(corners, boxes)
        attrs |= listed_attrs(_GRID, image(26, 11))
        return [*corners, *more, boxes, ranges, faces], attrs
    return sample


def _sums_sample(rng):
    arguments, attrs = sample_of(True)(rng)
    return arguments, {**attrs, "gamma": 0.05, "base": 1.05, "least": LEAST - 1.05}


def _boxes_sample(rng):
    return _corners(rng), {**{k: pair_attrs(_GRID, **_SOFT)[k] for k in _CELLS.split()}, "reach": 2.05}


op("soft_boxes", "v0 v1 v2", alike=((1, 0), (2, 0)), attrs="reach " + _CELLS, infer=at(0, vtype="ivec4"),
   reads="texel texel texel", ref=reference.soft_boxes,
   functions=FUNCTIONS, cost=60, sample=_boxes_sample,
   glsl="""{ vec3 v0_ = {v0_at}({i}).xyz, v1_ = {v1_at}({i}).xyz, v2_ = {v2_at}({i}).xyz;
    vec4 s0_ = soft_clip(v0_, v1_), s1_ = soft_clip(v1_, v2_), s2_ = soft_clip(v0_, v2_);
    vec2 lo_ = vec2(1e9), hi_ = vec2(-1e9), cell_ = vec2(ivec2({cell_w}, {cell_h}));
    if (s0_.x < 1e8) { lo_ = min(s0_.xy, s0_.zw); hi_ = max(s0_.xy, s0_.zw); }
    if (s1_.x < 1e8) { lo_ = min(lo_, min(s1_.xy, s1_.zw)); hi_ = max(hi_, max(s1_.xy, s1_.zw)); }
    if (s2_.x < 1e8) { lo_ = min(lo_, min(s2_.xy, s2_.zw)); hi_ = max(hi_, max(s2_.xy, s2_.zw)); }
    int view_ = {i} / {face_count};
    ivec2 at_ = ivec2(view_ % {columns}, view_ / {columns}) * ivec2({cell_w}, {cell_h});
    ivec2 first_ = ivec2(clamp(lo_ + 0.5 * cell_ - (float({reach}) - 0.5), vec2(0.0), cell_));
    ivec2 end_ = ivec2(clamp(hi_ + 0.5 * cell_ + (float({reach}) + 0.5), vec2(0.0), cell_));
    {y} = {i} < {n} && lo_.x <= hi_.x && first_.x < end_.x && first_.y < end_.y ? ivec4(first_ + at_, end_ + at_) : ivec4(0); }""",
   doc="Half-open boxes of the pixels whose centres may be within `reach` of a face; empty where it is wholly behind or beside.")


TURNS = 60000  # of the loops of one invocation: llvmpipe ends them, and says nothing, after 65535


def _by_bands(name: str, inputs: tuple[Node, ...], **attrs) -> Node:
    """The sum over bands of rows, of so few pixels each that no loop over a face's box is too long. Each has another extent (one more row
    of padding), for the turns of all loops of one shader count together."""
    height = attrs["cell_h"]
    rows = max(1, min(height, TURNS // attrs["cell_w"]))
    found = None
    for number, low in enumerate(range(0, height, rows)):
        band = apply(name, *inputs, low=low, high=min(low + rows, height), band=number, **attrs)
        band = apply("reshape", band, extent=inputs[0].extent) if number else band
        found = band if found is None else found + band
    return found


def _alpha_vjp(g, y, v0, v1, v2, boxes, ranges, faces, **attrs):
    pair = {k: attrs[k] for k in PAIR.split()}
    slope = g * (1.0 - y)
    where = v0, v1, v2, boxes, slope
    return (*(_by_bands("soft_alpha_gradient", where, corner=k, **pair) for k in range(3)), None, None, None)


op("soft_alpha", "v0 v1 v2 boxes ranges faces", attrs=f"{LISTED} {PAIR}", infer=over_pixels("float", 4), reads=" ".join(["texel"] * 6),
   ref=reference.soft_alpha, vjp=_alpha_vjp, functions=FUNCTIONS, cost=2000, sample=sample_of(False),
   loop=Loop(_ALPHA, "{y} = 1.0 - clear_;", "} }"),
   doc="1 - prod(1 - D) over the faces of the pixel's list that cover it or are within `radius`; D: the sigmoid of the signed distance (or "
       "its square) to the nearest edge over sigma, or with `hard_only` 1 for what covers the pixel.")


def _alpha_gradient_sample(rng):
    arguments, attrs = sample_of(False)(rng)
    attrs = {k: attrs[k] for k in PAIR.split()}
    return [*arguments[:4], rng.normal(size=(11, 26, 1))], {**attrs, "corner": 1, "low": 2, "high": 9, "band": 0}


op("soft_alpha_gradient", "v0 v1 v2 boxes slope", alike=((1, 0), (2, 0), (3, 0)), attrs=f"corner low high band {PAIR}",
   reads=" ".join(["texel"] * 5), infer=_over_faces("vec4"),
   ref=reference.soft_alpha_gradient, functions=FUNCTIONS, cost=2000, sample=_alpha_gradient_sample,
   loop=Loop(_ALPHA_GRADIENT, "{y} += " + _CORNER + ";", "} }"),
   doc="Transpose of soft_alpha: for each face the gradient by one corner, over the pixels of its box in rows low to high of the cell; "
       "`band` rows of padding. slope: the gradient by alpha times 1 - alpha.")

for _name, _vtype, _body, _doc in (
        ("soft_sums", "vec4", "{y} = {y} * keep_ + w_ * vec4(color_, 1.0);",
         "Sums over the faces of the pixel's list of w times colour, and of w = D exp((depth - largest depth) / gamma)."),
        ("soft_most", "vec2", "{y} = vec2(near_ || {y}.x != 0.0 ? most_ : 0.0, 1.0 - clear_);",
         "The largest depth of the faces near the pixel, 0 if there is none, at least that of normalized depth 1e-10; and alpha, as of "
         "soft_alpha.")):
    op(_name, "v0 v1 v2 c0 c1 c2 boxes ranges faces", attrs=f"{LISTED} {PAIR} least{_DEPTH}", infer=over_pixels(_vtype, 7),
       reads=" ".join(["texel"] * 9), ref=getattr(reference, _name), functions=FUNCTIONS, cost=3000, sample=_sums_sample,
       loop=Loop(_SUMS, _body, "} }"), doc=_doc)


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
       ref=getattr(reference, _name), functions=FUNCTIONS, sample=_blend_gradient_sample, loop=Loop(_BLEND_GRADIENT, _body, "} }"),
       doc=f"Transpose of soft_blend: for each face the gradient by one corner's {_what}, over the pixels of its box in rows low to high "
           "of the cell; `band` rows of padding. slope: by the sum of colours and of weights; most: the largest depth, and the gradient by "
           "alpha times 1 - alpha.")
