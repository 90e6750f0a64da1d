"""Rasterize: which face covers or comes near each pixel (paper 3.4.2, Algorithm 2). No backward: distances, barycentrics and
attributes are recomputed by ordinary ops from the face index (paper, Appendix A), so every gradient comes from the AD.

Inputs are tables: `clip` (V views x vertices, clip coordinates), `faces` (corners sorted by vertex index). A draw of all faces has one
instance a view, one of a list (`entries`, here view F + face, ascending) a single one for the atlas. Both have `vertices` invocations
an item and pull everything by `gl_VertexIndex`: no geometry shader, no primitive id. The result of a pixel is the code
`2 (view F + face) + hard`, or -1; peels add the bits of the shifted depth (equation 3, soft depths scaled by r).
"""
from __future__ import annotations

from ....cache.errors import GraphError
from ..ir import table
from ..optable import OPS, Draw, common_extent, flag, op
from . import raster_reference as reference

FUNCTIONS = """
float cross2(vec2 a, vec2 b) { return a.x * b.y - a.y * b.x; }
// Squared distance from p to the segment s; docs/conventions.md.
float segment_distance2(vec2 p, vec4 s) {
    vec2 d = s.zw - s.xy;
    vec2 o = s.xy + clamp(dot(p - s.xy, d) / max(dot(d, d), 1e-20), 0.0, 1.0) * d - p;
    return dot(o, o);
}
// The part of the edge a, b (homogeneous pixels) in front of the near plane, on screen; far away where there is none.
vec4 clip_segment(vec3 a, vec3 b, float near) {
    bool a_behind = a.z < near, b_behind = b.z < near;
    if (a_behind && b_behind) return vec4(1e9);
    vec3 d = b - a;
    float t = (near - a.z) / (a_behind != b_behind ? d.z : 1.0);
    if (a_behind) a += t * d;
    else if (b_behind) b = a + t * d;
    return vec4(a.xy / max(a.z, near), b.xy / max(b.z, near));
}
"""

# Enlarge (paper 3.4.2): acute faces are stretched from the centroid until every edge has moved out by r; others, smallest angle
# under 30 degrees, become a box along the longest edge. A face that crosses the near plane becomes an upright box.
_ENLARGE = """
int entry = {entries_at}(gl_VertexIndex / 6), view = entry / {face_count}, f = entry - view * {face_count}, corner = gl_VertexIndex % 6;
vec3 half_cell = vec3(0.5 * float({cell_w}), 0.5 * float({cell_h}), 1.0);
gl_Position = vec4(0.0, 0.0, 0.0, 1.0);
if (entry < 0) return;
center = vec2(view % {columns}, view / {columns}) * 2.0 * half_cell.xy + half_cell.xy;
ivec3 t = {faces_at}(f);
vec4 c0 = {clip_at}(view * {vertices} + t.x), c1 = {clip_at}(view * {vertices} + t.y), c2 = {clip_at}(view * {vertices} + t.z);
h0 = c0.xyw * half_cell; h1 = c1.xyw * half_cell; h2 = c2.xyw * half_cell;
depths = vec3(c0.z, c1.z, c2.z);
code = 2 * entry;
facing = dot(h0, cross(h1 - h0, h2 - h0)) < 0.0 ? -1.0 : 1.0;
float reach = float({radius}) + 0.02;
s0 = clip_segment(h0, h1, {near}); s1 = clip_segment(h1, h2, {near}); s2 = clip_segment(h0, h2, {near});
if (max(max(c0.w, c1.w), c2.w) >= {near}) {
    vec2 o;
    if (min(min(c0.w, c1.w), c2.w) >= {near}) {
        vec2 p0 = s0.xy, p1 = s0.zw, p2 = s1.zw;
        vec2 d0 = p1 - p0, d1 = p2 - p1, d2 = p0 - p2;
        vec3 l = vec3(length(d0), length(d1), length(d2));
        float area = abs(cross2(d0, d2));
        float longest = max(max(l.x, l.y), l.z);
        float middle = l.x + l.y + l.z - longest - min(min(l.x, l.y), l.z);
        if (area > 0.5 * longest * middle) {
            vec2 g = (p0 + p1 + p2) / 3.0;
            float stretch = 1.0 + reach * 3.0 * longest / area;
            o = g + ((corner == 1 ? p1 : corner == 2 ? p2 : p0) - g) * stretch;
        } else {
            vec2 a = l.x == longest ? p0 : l.y == longest ? p1 : p2;
            vec2 d = (l.x == longest ? d0 : l.y == longest ? d1 : d2) / max(longest, 1e-20);
            if (longest < 1e-20) d = vec2(1.0, 0.0);
            vec2 n = vec2(-d.y, d.x);
            vec3 along = vec3(dot(p0 - a, d), dot(p1 - a, d), dot(p2 - a, d));
            vec3 across = vec3(dot(p0 - a, n), dot(p1 - a, n), dot(p2 - a, n));
            float lo = min(min(along.x, along.y), along.z) - reach, hi = max(max(along.x, along.y), along.z) + reach;
            float under = min(min(across.x, across.y), across.z) - reach, over = max(max(across.x, across.y), across.z) + reach;
            o = a + d * (corner == 1 || corner == 3 || corner == 5 ? hi : lo) + n * (corner >= 2 && corner != 3 ? over : under);
        }
    } else {
        vec2 lo = vec2(1e9), hi = vec2(-1e9);
        if (s0.x < 1e8) { lo = min(lo, min(s0.xy, s0.zw)); hi = max(hi, max(s0.xy, s0.zw)); }
        if (s1.x < 1e8) { lo = min(lo, min(s1.xy, s1.zw)); hi = max(hi, max(s1.xy, s1.zw)); }
        if (s2.x < 1e8) { lo = min(lo, min(s2.xy, s2.zw)); hi = max(hi, max(s2.xy, s2.zw)); }
        lo = max(lo - reach, -2.0 * half_cell.xy); hi = min(hi + reach, 2.0 * half_cell.xy);
        o = vec2(corner == 1 || corner == 3 || corner == 5 ? hi.x : lo.x, corner >= 2 && corner != 3 ? hi.y : lo.y);
    }
    gl_Position = vec4((center + o) / (0.5 * vec2({w}, {h})) - 1.0, 0.0, 1.0);
}
"""

# SignedDist and Shift (paper 3.4.2, equation 3). Inside is decided by homogeneous edge functions relative to the pixel
# (Olano and Greer 1997), which need no clipped triangle.
_SHIFT = """
vec2 q = gl_FragCoord.xy - center;
if (abs(q.x) > 0.5 * float({cell_w}) || abs(q.y) > 0.5 * float({cell_h})) discard;
vec2 a0 = h0.xy - q * h0.z, a1 = h1.xy - q * h1.z, a2 = h2.xy - q * h2.z;
vec3 e = vec3(cross2(a1, a2), cross2(a2, a0), cross2(a0, a1)) * facing;
float sum = e.x + e.y + e.z;
bool hard = min(min(e.x, e.y), e.z) >= 0.0 && sum > 0.0 && dot(e, vec3(h0.z, h1.z, h2.z)) > {near} * sum;
float depth;
if (hard) depth = 0.5 * clamp(dot(e, depths) / max(dot(e, vec3(h0.z, h1.z, h2.z)), 1e-30), 0.0, 1.0);
else {
    float d = sqrt(min(min(segment_distance2(q, s0), segment_distance2(q, s1)), segment_distance2(q, s2)));
    if (d > float({radius})) discard;
    depth = 0.5 + 0.4999 * d / float({radius});
}
int found = code + int(hard);
"""

_PEELED = """
ivec2 front = {previous};
float front_depth = intBitsToFloat(front.y);
if (front.x < 0 || depth < front_depth || (depth == front_depth && found <= front.x)) discard;
"""

_SOFT_VARYINGS = (("int", "code"), ("float", "facing"), ("vec2", "center"), ("vec3", "depths"), ("vec3", "h0"), ("vec3", "h1"),
                  ("vec3", "h2"), ("vec4", "s0"), ("vec4", "s1"), ("vec4", "s2"))


def _enlarged(fragment: str) -> Draw:
    return Draw(_ENLARGE, fragment + "gl_FragDepth = depth;\n", _SOFT_VARYINGS, vertices=(6, "slots"), count="count")


DRAWN = "extent views vertices face_count near cell_w cell_h columns"


def _need(name, params, inputs, attrs, **counts):
    """Each input that is read by number has at least so many entries."""
    for x, param in zip(inputs, params):
        if x.extent.count < counts.get(param, 0):
            raise GraphError(f"{name}: {param} {x!r} has {x.extent.count} entries; {counts[param]} are needed")


def _code(channels):
    def infer(name, inputs, attrs):
        corners, vertices = attrs.get("face_count", 0), attrs.get("views", 0) * attrs.get("vertices", 0)
        listed = {"entries": attrs["slots"], "segments": attrs["slots"]} if "slots" in attrs else {}
        _need(name, OPS[name].params, inputs, attrs, clip=vertices, faces=corners, corners=3 * corners, behind=1,
              front=attrs["extent"].count, **listed)
        return "int" if channels == 1 else "ivec2", attrs["extent"]
    return infer


op("rasterize", "clip faces entries count", attrs=DRAWN + " radius slots", infer=_code(1), functions=FUNCTIONS,
   reads="vertex vertex vertex count", stage="raster",
   draws=(_enlarged(_SHIFT + "{y} = found;\n"),), ref=reference.rasterize, cost=1000,
   doc="First layer, the listed faces enlarged.")
op("rasterize_first", "clip faces entries count", attrs=DRAWN + " radius slots", infer=_code(2), functions=FUNCTIONS,
   reads="vertex vertex vertex count", stage="raster",
   draws=(_enlarged(_SHIFT + "{y} = ivec2(found, floatBitsToInt(depth));\n"),), ref=reference.rasterize_first, cost=1000,
   doc="First layer with its shifted depth, for peeling.")
op("rasterize_peel", "clip faces entries count previous", attrs=DRAWN + " radius slots", infer=_code(2), functions=FUNCTIONS,
   reads="vertex vertex vertex count own", stage="raster",
   draws=(_enlarged(_SHIFT + _PEELED + "{y} = ivec2(found, floatBitsToInt(depth));\n"),),
   ref=reference.rasterize_peel, cost=1000,
   doc="The layer behind `previous` (depth peeling).")

# In the plane of the camera, where w is 0, a corner is behind the near plane; SwiftShader leaves out all of such a face.
_OFF_ZERO = "if (gl_Position.w == 0.0) gl_Position.w = {near} * 1e-6;\n"

# Which face is in front, without fragment work; for outline distance also the nearest fold edge of each pixel, whatever is in front.
_HARD = """
int view = gl_InstanceIndex;
gl_Position = {clip_at}(view * {vertices} + {corners_at}(gl_VertexIndex));
gl_Position.z *= 0.5;  // the far plane clips nothing: z < 2 w everywhere, unless far < 2 near
""" + _OFF_ZERO + """code = view * {face_count} + gl_VertexIndex / 3;
"""
op("rasterize_hard", "clip corners", attrs=DRAWN, infer=_code(1), reads="vertex vertex", stage="raster", cost=200,
   ref=reference.rasterize_hard, draws=(Draw(_HARD, "{y} = code;\n", (("int", "code"),), vertices=(3, "face_count")),),
   doc="The front face of each pixel, view F + face; -1 where there is none. Fixed-function depth.")

# Whether any face is in front. Of a closed surface, oriented all alike and wholly before the near plane, faces that turn one way cover
# what all faces cover, however it folds or intersects itself: along every ray as many enter it as leave it, and on the grid to which a
# device rounds corners the rule for shared edges keeps that so. So faces that turn the other way by more than any rounding are left out.
_COVERED = """
int first = gl_InstanceIndex * {vertices}, corner = gl_VertexIndex % 3;
ivec4 t = {faces_at}(gl_VertexIndex / 3);
vec4 c0 = {clip_at}(first + t.x), c1 = {clip_at}(first + t.y), c2 = {clip_at}(first + t.z);
gl_Position = corner == 0 ? c0 : corner == 1 ? c1 : c2;
gl_Position.z *= 1.0 / 1024.0;  // the far plane clips nothing, whatever far is
""" + _OFF_ZERO + """vec2 scale = vec2(0.5 * float({cell_w}), 0.5 * float({cell_h}));
vec2 p = c0.xy / c0.w * scale, a = c1.xy / c1.w * scale - p, b = c2.xy / c2.w * scale - p;
vec2 size = abs(a) + abs(b), far = abs(p) + size;
float off = {snap} + 4e-7 * (max(float({w}), float({h})) + max(far.x, far.y));  // of a corner, either way
bool away = a.x * b.y - a.y * b.x < -(2.0 * off * (size.x + size.y) + 8.0 * off * off);
if (away && t.w != 0 && {behind}(ivec2(0)) == 0) gl_Position = vec4(0.0, 0.0, 0.0, 1.0);
"""
op("rasterize_covered", "clip faces behind", attrs=DRAWN, infer=_code(1), reads="vertex vertex vertex", stage="raster", cost=200,
   ref=reference.rasterize_covered,
   draws=(Draw(_COVERED, "{y} = 0;\n", (), vertices=(3, "face_count"), depth_test=False),),
   doc="0 where a face covers the pixel, -1 where none does. `faces`: three corners, in order, and whether it is of a closed "
       "surface; `behind`: 0 if all corners of all views are before the near plane.")

# A list of segments over the whole atlas: the box around each.
AROUND = """
int slot = gl_VertexIndex / 6, corner = gl_VertexIndex % 6, entry = {entries_at}(slot);
gl_Position = vec4(0.0, 0.0, 0.0, 1.0);
segment = vec4(0.0);
center = vec2(0.0);
code = slot;
if (entry >= 0) {
    int view = entry / {edge_count};
    vec2 cell = vec2(float({cell_w}), float({cell_h}));
    center = (vec2(view % {columns}, view / {columns}) + 0.5) * cell;
    segment = {segments_at}(slot);
    float grow = float({radius}) + 0.02;
    vec2 d = segment.zw - segment.xy;
    float l = length(d);
    d = l < 1e-20 ? vec2(1.0, 0.0) : d / l;
    vec2 n = vec2(-d.y, d.x) * grow;
    vec2 o = center + segment.xy - d * grow + (corner == 1 || corner == 3 || corner == 5 ? d * (l + 2.0 * grow) : vec2(0.0))
           + (corner >= 2 && corner != 3 ? n : -n);
    gl_Position = vec4(o / (0.5 * vec2({w}, {h})) - 1.0, 0.0, 1.0);
}
"""
SEGMENT_VARYINGS = (("int", "code"), ("vec2", "center"), ("vec4", "segment"))
_NEAREST = """
ivec2 cell_size = ivec2({cell_w}, {cell_h});
vec2 q = gl_FragCoord.xy - center, along = segment.zw - segment.xy;
vec2 foot = segment.xy + clamp(dot(q - segment.xy, along) / max(dot(along, along), 1e-20), 0.0, 1.0) * along, across = foot - q;
float d = length(across);
ivec2 beyond = ivec2(floor(foot + across / max(d, 1e-10) + 0.5 * vec2(cell_size)));
beyond = ivec2(center - 0.5 * vec2(cell_size)) + clamp(beyond, ivec2(0), cell_size - 1);
bool inner = {front}(pixel) >= 0 && {front}(beyond) >= 0;
if (inner || d > float({radius}) || abs(q.x) > 0.5 * float({cell_w}) || abs(q.y) > 0.5 * float({cell_h})) discard;
gl_FragDepth = 0.9999 * d / float({radius});
{y} = code;
"""
op("rasterize_segments", "segments entries front count", attrs="extent radius edge_count cell_w cell_h columns slots", infer=_code(1),
   reads="vertex vertex texel count", stage="raster",
   ref=reference.rasterize_segments, cost=200,
   draws=(Draw(AROUND, _NEAREST, SEGMENT_VARYINGS, vertices=(6, "slots"), count="count"),),
   doc="For each pixel the slot of the nearest listed segment within `radius` in its cell that is outline for it, the first of equals; -1 "
       "where there is none. Outline: `front` does not cover the pixel, or not the one that lies a pixel beyond the nearest point.")

def _fold_infer(name, inputs, attrs):
    _need(name, ("clip", "edges"), inputs, attrs, clip=attrs["views"] * attrs["vertices"], edges=attrs["edge_count"])
    return "vec4", table(attrs["views"] * attrs["edge_count"])


op("fold_segments", "clip edges", infer=_fold_infer,
   reads="texel texel", ref=reference.fold_segments, functions=FUNCTIONS, cost=40,
   glsl="""{ int view_ = {i} / {edge_count}, first_ = view_ * {vertices};
    ivec4 v_ = {edges_at}({i} - view_ * {edge_count});
    vec3 scale_ = vec3(0.5 * float({cell_w}), 0.5 * float({cell_h}), 1.0);
    vec3 o_ = {clip_at}(first_ + v_.x).xyw, e_ = {clip_at}(first_ + v_.y).xyw;
    {y} = clip_segment(o_ * scale_, e_ * scale_, {near});
    vec3 n_ = cross(o_, e_ - o_);  // differences keep the digits of small faces
    float a_ = dot(n_, {clip_at}(first_ + v_.z).xyw - o_), b_ = dot(n_, {clip_at}(first_ + max(v_.w, 0)).xyw - o_);
    if (v_.w >= 0 && sign(a_) * sign(b_) < 0.0) {y} = vec4(1e9); }""",
   doc="Screen segments of boundary edges and of folds, whose two faces lie on one side on screen, relative to the cell's centre and "
       "clipped to the near plane; 1e9 for all others.")

def _nearest_infer(name, inputs, attrs):
    _need(name, ("code", "face_edges", "segments"), inputs, attrs, face_edges=attrs["face_count"], segments=attrs["edge_count"])
    return "int", common_extent(name, (inputs[0], *inputs[3:]))


op("nearest_edge", "code face_edges segments position active", when=flag(4, -1), infer=_nearest_infer,
   reads="own texel texel own own", ref=reference.nearest_edge, functions=FUNCTIONS, cost=40,
   glsl="""{y} = -1;
if ({code} >= 0 && {active} != 0) {
    int f_ = {code} >> 1, view_ = f_ / {face_count};
    ivec3 e_ = {face_edges_at}(f_ - view_ * {face_count}) + view_ * {edge_count};
    vec3 d_ = vec3(segment_distance2({position}, {segments_at}(e_.x)), segment_distance2({position}, {segments_at}(e_.y)),
                   segment_distance2({position}, {segments_at}(e_.z)));
    {y} = d_.x <= d_.y && d_.x <= d_.z ? e_.x : d_.y <= d_.z ? e_.y : e_.z;
}""", doc="Entry of the face's edge nearest to the pixel; -1 where there is no face or `active` is 0.")
