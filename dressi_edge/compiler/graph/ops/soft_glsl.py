"""GLSL of pairs of a pixel and a face, of which the snippets in `soft.py` and `soft_pair.py` are made. The formulas: docs/conventions.md,
"Every face". Names of what each piece leaves behind end in an underscore."""
from . import soft_reference as reference

FUNCTIONS = """
float soft_cross(vec2 a, vec2 b) { return a.x * b.y - a.y * b.x; }
bool soft_front(float iw) { return iw > 0.0 && iw <= 1.0; }
// Screen ends of the edge between corners (x, y, near / w), clipped to the near plane; 1e9 where nothing is left.
vec4 soft_clip(vec3 a, vec3 b) {
    bool front_a = soft_front(a.z), front_b = soft_front(b.z);
    float den = b.z - a.z;
    vec2 cut = front_a || front_b ? a.xy + (b.xy - a.xy) * ((1.0 - a.z) / (front_a != front_b ? den : 1.0)) : vec2(1e9);
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

# Of the corners v0_, v1_, v2_ and the place q_: signed areas, and whether the face covers the place.
_AREAS = """
vec2 a0_ = v0_.xy - q_, a1_ = v1_.xy - q_, a2_ = v2_.xy - q_;
vec3 iw_ = vec3(v0_.z, v1_.z, v2_.z), area_ = vec3(soft_cross(a1_, a2_), soft_cross(a2_, a0_), soft_cross(a0_, a1_));
float whole_ = area_.x + area_.y + area_.z, facing_ = whole_ < 0.0 ? -1.0 : 1.0;
area_ *= facing_;
vec3 m_ = area_ * iw_;
bool hard_ = min(min(m_.x, m_.y), m_.z) >= 0.0 && whole_ != 0.0 && abs(whole_) >= m_.x + m_.y + m_.z;
"""
# How far the nearest edge is, seen from q_. All three are cut at the near plane whether they cross it or not. That takes less time than a
# branch where many invocations run at once, and no turns of a loop, of which a shader has only so many (`soft.TURNS`).
_FAR = """
vec3 r0_ = vec3(a0_, iw_.x), r1_ = vec3(a1_, iw_.y), r2_ = vec3(a2_, iw_.z);
float far_ = min(min(soft_distance2(soft_clip(r0_, r1_)).x, soft_distance2(soft_clip(r1_, r2_)).x), soft_distance2(soft_clip(r0_, r2_)).x);
"""
# And which one it is, with the nearest point on it: one after the other, so that no more than two are held at once.
_NEAREST = """
vec3 r0_ = vec3(a0_, iw_.x), r1_ = vec3(a1_, iw_.y), r2_ = vec3(a2_, iw_.z);
int edge_ = 0;
vec4 s_ = soft_clip(r0_, r1_), other_ = soft_clip(r1_, r2_);
vec2 on_ = soft_distance2(s_), on_other_ = soft_distance2(other_);
if (on_other_.x < on_.x) { edge_ = 1; s_ = other_; on_ = on_other_; }
other_ = soft_clip(r0_, r2_);
on_other_ = soft_distance2(other_);
if (on_other_.x < on_.x) { edge_ = 2; s_ = other_; on_ = on_other_; }
float far_ = on_.x;
"""
_PROBABILITY = """
float d_ = sqrt(far_);
bool near_ = hard_ || {hard_only} == 0 && d_ <= float({radius});
float x_ = ({squared} != 0 ? far_ : d_) * (hard_ ? 1.0 : -1.0) / float({sigma}), exp_ = exp(-abs(x_));
float big_ = 1.0 / (1.0 + exp_), small_ = exp_ * big_;
float probability_ = x_ < 0.0 ? small_ : big_, beside_ = x_ < 0.0 ? big_ : small_;
if ({hard_only} != 0) { probability_ = 1.0; beside_ = 0.0; }
if (!near_) { probability_ = 0.0; beside_ = 1.0; }
"""
# A pair, for who wants its sum, and for who wants its gradient.
GEOMETRY = _AREAS + _FAR + _PROBABILITY
NEAREST = _AREAS + _NEAREST + _PROBABILITY
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

# The next face of the list whose mask has the pixel's cell, or where entries have no tile of their own, whose box has the pixel: loops of
# their own, for machines that run both sides of every `if`. Both may give faces that are not near, never leave one out that is.
NEXT = """int f_ = -1;
for (int end_ = spilled_ ? 0 : range_.y; k_ < end_ && f_ < 0;) {
    ivec4 c_ = {masks_at}((k_ >> 5) * 16 + four_);
    int set_ = int(uint(one_ < 2 ? one_ == 0 ? c_.x : c_.y : one_ == 2 ? c_.z : c_.w) >> (k_ & 31));
    k_ = set_ != 0 ? k_ + findLSB(set_) : (k_ | 31) + 1;
    f_ = set_ != 0 && k_ < end_ ? k_ : -1;
    k_ += set_ != 0 ? 1 : 0;
}
for (int end_ = spilled_ ? range_.y : 0; k_ < end_ && f_ < 0; ++k_) {
    ivec4 b_ = {boxes_at}({faces_at}(k_));
    if (b_.x <= pixel_.x && b_.z > pixel_.x && b_.y <= pixel_.y && b_.w > pixel_.y) f_ = k_;
}
if (f_ < 0) break;
f_ = {faces_at}(f_);
vec4 v0_ = {v0_at}(f_), v1_ = {v1_at}(f_), v2_ = {v2_at}(f_);
"""
_LIST = """bool spilled_ = {spilled}(ivec2(0)) != 0;
ivec2 tile_ = ivec2({tile_w}, {tile_h}), in_tile_ = (in_ % tile_) / ((tile_ + 7) / 8);
int four_ = in_tile_.y * 2 + in_tile_.x / 4, one_ = in_tile_.x & 3;
ivec2 all_ = there_ ? {ranges_at}(listed_) : ivec2(0);
ivec2 range_ = min(all_.x + clamp(part_, 0, (all_.y - all_.x) / {each} + 1) * {each} + ivec2(0, {each}), all_.y);
vec2 q_ = vec2(in_) + 0.5 - 0.5 * vec2(ivec2({cell_w}, {cell_h}));
"""
# A pixel with the first part of its tile's list.
TILE = """{ ivec2 pixel_ = {p}, cell_ = pixel_ / ivec2({cell_w}, {cell_h}), in_ = pixel_ - cell_ * ivec2({cell_w}, {cell_h});
int view_ = cell_.y * {columns} + cell_.x, listed_ = (view_ * {tiles_y} + in_.y / {tile_h}) * {tiles_x} + in_.x / {tile_w};
const int part_ = 0;
bool there_ = view_ < {views};
""" + _LIST
# A pixel of a unit, with another part of it; units after the last may be anything, and draws run over them.
UNIT = """{ int unit_ = {i} / ({tile_w} * {tile_h}), of_ = {i} - unit_ * ({tile_w} * {tile_h});
ivec2 which_ = {units_at}(min(unit_, {slots} - 1));
int per_ = {tiles_x} * {tiles_y}, listed_ = clamp(which_.x, 0, {views} * per_ - 1), part_ = which_.y, view_ = listed_ / per_;
int rest_ = listed_ - view_ * per_;
ivec2 in_ = ivec2(rest_ % {tiles_x}, rest_ / {tiles_x}) * ivec2({tile_w}, {tile_h}) + ivec2(of_ % {tile_w}, of_ / {tile_w});
ivec2 pixel_ = in_ + ivec2(view_ % {columns}, view_ / {columns}) * ivec2({cell_w}, {cell_h});
bool there_ = in_.x < {cell_w} && in_.y < {cell_h};
""" + _LIST

_OVER_BOX = """{ ivec4 box_ = {i} < {n} ? {boxes_at}({i}) : ivec4(0);
int view_ = {i} / {face_count};
vec2 center_ = vec2(ivec2(view_ % {columns}, view_ / {columns}) * ivec2({cell_w}, {cell_h})) + 0.5 * vec2(ivec2({cell_w}, {cell_h}));
int top_ = view_ / {columns} * {cell_h};
box_.yw = clamp(box_.yw, top_ + {low}, top_ + {high});
ivec2 p_ = ivec2(box_.x - 1, box_.y);
HELD
for (;;) {
if (++p_.x >= box_.z) { p_.x = box_.x; ++p_.y; }
if (p_.y >= box_.w) break;
vec2 q_ = vec2(p_) + 0.5 - center_;
TURN
"""
_CORNERS = "vec4 v0_ = {v0_at}({i}), v1_ = {v1_at}({i}), v2_ = {v2_at}({i});\n"


def over_box(held: str, turn: str) -> tuple[str, str]:
    """A loop over the pixels of a face's box in rows `low` to `high` of the cell, as two texts. held: fetches what is the same at every
    pixel; turn: what is made of it at one. The first fetches the corners, too, before the loop. The second fetches all at each pixel, the
    corners last, so that fewer registers do (`Loop.lean`)."""
    return (_OVER_BOX.replace("HELD", held + _CORNERS).replace("TURN", turn),
            _OVER_BOX.replace("HELD", "").replace("TURN", held + turn + _CORNERS))


# From by_x_, the gradient by what the sigmoid is of, to the corners: along the nearest edge, and by its cut at the near plane.
BY_DISTANCE = """
bool first_ = edge_ == 0, second_ = edge_ == 1;
float t_ = on_.y;
vec2 along_ = s_.zw - s_.xy, foot_ = s_.xy + t_ * along_, normal_ = vec2(along_.y, -along_.x);
normal_ *= sign(dot(foot_, normal_));
bool between_ = t_ > 0.0 && t_ < 1.0;
vec2 unit_ = (between_ ? normal_ : foot_) / max(between_ ? length(along_) : d_, 1e-20);
if (!near_ || {hard_only} != 0) by_x_ = 0.0;
vec2 by_foot_ = ({squared} != 0 ? 2.0 * foot_ : unit_) * (by_x_ * (hard_ ? 1.0 : -1.0) / float({sigma}));
vec3 by_a_ = vec3(by_foot_ * (1.0 - t_), 0.0), by_b_ = vec3(by_foot_ * t_, 0.0);
vec3 a_ = second_ ? r1_ : r0_, e_ = first_ ? r1_ : r2_;
bool front_a_ = soft_front(a_.z), front_e_ = soft_front(e_.z);
if (front_a_ != front_e_) {
    float den_ = e_.z - a_.z, u_ = (1.0 - a_.z) / den_;
    vec2 lost_ = front_a_ ? by_b_.xy : by_a_.xy;
    float by_u_ = dot(lost_, e_.xy - a_.xy) / den_;
    by_a_ = vec3((front_a_ ? by_a_.xy : vec2(0.0)) + lost_ * (1.0 - u_), by_u_ * (1.0 - u_) * -1.0);
    by_b_ = vec3((front_e_ ? by_b_.xy : vec2(0.0)) + lost_ * u_, by_u_ * -u_);
}
vec4 g0_ = vec4(second_ ? vec3(0.0) : by_a_, 0.0), g1_ = vec4(first_ ? by_b_ : second_ ? by_a_ : vec3(0.0), 0.0);
vec4 g2_ = vec4(first_ ? vec3(0.0) : by_b_, 0.0);
"""
BY_WEIGHTS = """
float z_off_ = z_ - most_.x;
float w_ = probability_ * exp(min(z_off_ / float({gamma}), 0.0));
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
