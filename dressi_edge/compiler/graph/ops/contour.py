"""Occluding contours: how far away the front face of each pixel is, where that jumps, and which edge makes it jump.

No backward, as in `raster.py`: what is chosen here is held while one differentiates.
"""
from __future__ import annotations

import numpy as np

from ....cache.errors import GraphError
from ..optable import Draw, op
from .lookup import constant_table, to_table
from .raster import AROUND, FUNCTIONS, SEGMENT_VARYINGS
from .raster_reference import contour_slots, cross2


def _corners(front, clip, faces, face_count, vertices):
    """(n, 3, 4) clip corners of the pixels that have a front face, and which these are."""
    ys, xs = np.nonzero(front[..., 0] >= 0)
    view, f = np.divmod(front[ys, xs, 0], face_count)
    return ys, xs, clip.reshape(-1, 4)[view[:, None] * vertices + faces.reshape(-1, 3)[f]]


# Of the face front_ at position_, relative to the cell's centre.
_DEPTH = """if (front_ >= 0) {
    int view_ = front_ / {face_count};
    ivec3 c_ = {faces_at}(front_ - view_ * {face_count}) + view_ * {vertices};
    vec3 s_ = vec3(0.5 * float({cell_w}), 0.5 * float({cell_h}), 1.0);
    vec3 h0_ = {clip_at}(c_.x).xyw * s_, h1_ = {clip_at}(c_.y).xyw * s_, h2_ = {clip_at}(c_.z).xyw * s_;
    vec2 a0_ = h0_.xy - position_ * h0_.z, a1_ = h1_.xy - position_ * h1_.z, a2_ = h2_.xy - position_ * h2_.z;
    vec3 e_ = vec3(cross2(a1_, a2_), cross2(a2_, a0_), cross2(a0_, a1_)), w_ = vec3(h0_.z, h1_.z, h2_.z);
    float t_ = e_.x + e_.y + e_.z, size_ = max(max(dot(a0_, a0_), dot(a1_, a1_)), dot(a2_, a2_));
    float low_ = min(min(w_.x, w_.y), w_.z), high_ = max(max(w_.x, w_.y), w_.z);
    depth_ = abs(t_) > size_ * 1e-6 ? clamp(dot(e_, w_) / (t_ == 0.0 ? 1.0 : t_), low_, high_) : low_;
}"""


def _depth_ref(front, clip, faces, position, face_count, vertices, cell_w, cell_h):
    ys, xs, c = _corners(front, clip, faces, face_count, vertices)
    out = np.zeros(front.shape)
    h = c[..., [0, 1, 3]] * (cell_w / 2, cell_h / 2, 1.0)
    a = h[..., :2] - position[ys, xs][:, None] * h[..., 2:]
    e = np.stack([cross2(a[:, 1], a[:, 2]), cross2(a[:, 2], a[:, 0]), cross2(a[:, 0], a[:, 1])], 1)
    total, w = e.sum(1), h[..., 2]
    size = (a * a).sum(-1).max(1)
    at = np.where(np.abs(total) > size * 1e-6, (e * w).sum(1) / np.where(total == 0, 1, total), w.min(1))
    out[ys, xs, 0] = np.clip(at, w.min(1), w.max(1))
    return out


def _depth_infer(name, inputs, attrs):
    front, clip, faces, position = inputs
    if faces.extent.count != attrs["face_count"] or front.extent != position.extent or clip.extent.count % attrs["vertices"]:
        raise GraphError(f"{name}: {inputs!r} do not fit {attrs['face_count']} faces and views of {attrs['vertices']} vertices over one "
                         "image")
    return "float", inputs[0].extent


def _depth_sample(rng):
    """Two triangles in front of a camera, one view; pixels beside them have no face."""
    corners = np.array([(-2, -2), (3, -1), (0, 3), (2, 2)]) / (4, 3)
    w = np.array([2.0, 3.0, 2.5, 4.0])
    clip = np.column_stack([corners * w[:, None], w, w])
    y, x = np.mgrid[:6, :8]
    front = np.where((abs(x - 4) < 2) & (abs(y - 3) < 2), (x > 4).astype(int), -1)
    position = np.stack([x + 0.5 - 4, y + 0.5 - 3], -1)
    return [front[..., None], to_table(clip), constant_table(np.array([(0, 1, 2), (1, 2, 3)])), position], {
        "face_count": 2, "vertices": 4, "cell_w": 8, "cell_h": 6}


op("front_depth", "front clip faces position", attrs="face_count vertices cell_w cell_h", infer=_depth_infer, reads="own texel texel own",
   ref=_depth_ref, cost=60, functions=FUNCTIONS, sample=_depth_sample,
   glsl="{y} = 0.0;\n" + _DEPTH.replace("front_", "{front}").replace("position_", "{position}").replace("depth_", "{y}"),
   doc="w of the front face at the pixel's centre, its distance along the camera's axis; 0 where there is none.")


def _depth_steps_ref(depth, gap, cell_w, cell_h):
    h, w, _ = depth.shape
    d = depth[..., 0].reshape(h // cell_h, cell_h, w // cell_w, cell_w)
    jump = np.zeros(d.shape, bool)
    for axis in (1, 3):
        a, b = (np.take(d, at, axis) for at in (np.arange(d.shape[axis] - 1), np.arange(1, d.shape[axis])))
        far = (np.minimum(a, b) > 0) & (np.maximum(a, b) > np.minimum(a, b) * (1 + gap))
        ends = [(0, 0)] * 4
        for k in (0, 1):
            ends[axis] = (k, 1 - k)
            jump |= np.pad(far, ends)
    return np.where(jump, -2, np.where(d > 0, 0, -1)).reshape(h, w, 1)


def _depth_steps_infer(name, inputs, attrs):
    e = inputs[0].extent
    if min(attrs["cell_w"], attrs["cell_h"]) < 1 or e.width % attrs["cell_w"] or e.height % attrs["cell_h"]:
        raise GraphError(f"{name}: {inputs[0]!r} is not made of whole cells of {attrs['cell_w']} x {attrs['cell_h']}")
    return "int", e


op("depth_steps", "depth", attrs="gap cell_w cell_h", reads="texel", ref=_depth_steps_ref, cost=30, infer=_depth_steps_infer,
   glsl="""{ ivec2 size_ = ivec2({cell_w}, {cell_h}), c_ = {p} / size_ * size_, l_ = c_ + size_ - 1;
    float d_ = {depth}({p});
    vec4 n_ = vec4({depth}(ivec2(min({p}.x + 1, l_.x), {p}.y)), {depth}(ivec2(max({p}.x - 1, c_.x), {p}.y)),
                   {depth}(ivec2({p}.x, min({p}.y + 1, l_.y))), {depth}(ivec2({p}.x, max({p}.y - 1, c_.y))));
    vec4 low_ = min(n_, vec4(d_)), high_ = max(n_, vec4(d_));
    vec4 step_ = vec4(greaterThan(high_, low_ * (1.0 + float({gap})))) * vec4(greaterThan(low_, vec4(0.0)));
    {y} = step_.x + step_.y + step_.z + step_.w > 0.0 ? -2 : d_ > 0.0 ? 0 : -1; }""",
   sample=lambda rng: ([np.repeat(rng.choice([0.0, 1.0, 1.2], (9, 10, 1)), 2, 0)], {"cell_w": 5, "cell_h": 6, "gap": 0.1}),
   doc="-1 where there is no depth, -2 where a neighbour in the cell is further or nearer by more than `gap` times the nearer one's "
       "distance, both being somewhere, 0 elsewhere.")


_CONTOUR = """
ivec2 cell_size = ivec2({cell_w}, {cell_h});
vec2 q = gl_FragCoord.xy - center, along = segment.zw - segment.xy;
float t = clamp(dot(q - segment.xy, along) / max(dot(along, along), 1e-20), 0.0, 1.0);
vec2 foot = segment.xy + t * along, across = foot - q;
float d = length(across);
ivec2 beyond = ivec2(floor(foot + across / max(d, 1e-10) + 0.5 * vec2(cell_size)));
beyond = ivec2(center - 0.5 * vec2(cell_size)) + clamp(beyond, ivec2(0), cell_size - 1);
ivec2 fronts_ = ivec2({front}(pixel), {front}(beyond));
bool seen_ = fronts_.x >= 0 && fronts_.y >= 0 && d <= float({radius});
seen_ = seen_ && abs(q.x) <= 0.5 * float({cell_w}) && abs(q.y) <= 0.5 * float({cell_h});
vec2 depths_ = vec2(0.0);
for (int k_ = 0; k_ < (seen_ ? 2 : 0); ++k_) {  // no turn for most: machines that cannot branch around a body can leave a loop
    int front_ = k_ == 0 ? fronts_.x : fronts_.y;
    float depth_ = 0.0;
    vec2 position_ = vec2(k_ == 0 ? pixel : beyond) + 0.5 - center;
    DEPTH
    if (k_ == 0) depths_.x = depth_;
    else depths_.y = depth_;
}
float own = depths_.x, other = depths_.y, limit = (1.0 + float({gap})) / mix(nearness.x, nearness.y, t);
bool outer = own > limit;
if (own <= 0.0 || other <= 0.0 || !outer && !(other > limit)) discard;
gl_FragDepth = 0.9999 * d / float({radius});
{y} = 2 * code + (outer ? 1 : 0);
"""


def _contours_ref(segments, nearness, entries, front, clip, faces, count, face_count, vertices, **attrs):
    h, w, _ = front.shape
    cell_w, cell_h = attrs["cell_w"], attrs["cell_h"]
    y, x = np.mgrid[:h, :w]
    position = np.stack([x % cell_w + 0.5 - cell_w / 2, y % cell_h + 0.5 - cell_h / 2], -1)
    depth = _depth_ref(front, clip, faces, position, face_count, vertices, cell_w, cell_h)
    return contour_slots(segments, nearness, entries, depth, count, **attrs)


def _contour_infer(name, inputs, attrs):
    if inputs[5].extent.count != attrs["face_count"] or inputs[4].extent.count % attrs["vertices"]:
        raise GraphError(f"{name}: {inputs!r} do not fit {attrs['face_count']} faces and views of {attrs['vertices']} vertices")
    return "int", attrs["extent"]


op("rasterize_contours", "segments nearness entries front clip faces count", infer=_contour_infer,
   reads="vertex vertex vertex texel texel texel count", functions=FUNCTIONS,
   attrs="extent radius gap edge_count face_count vertices slots cell_w cell_h columns", stage="raster", ref=_contours_ref, cost=200,
   draws=(Draw(AROUND.replace("segment = {segments_at}(slot);", "segment = {segments_at}(slot); nearness = {nearness_at}(slot);")
               .replace("segment = vec4(0.0);", "segment = vec4(0.0);\nnearness = vec2(1.0);"), _CONTOUR.replace("DEPTH", _DEPTH),
               (*SEGMENT_VARYINGS, ("vec2", "nearness")), vertices=(6, "slots"), count="count"),),
   doc="For each covered pixel twice the slot of the nearest listed segment within `radius` in its cell that is a contour for it, the "
       "first of equals, plus 1 where the pixel is on its far side; -1 where there is none. Contour: the pixel itself is further away "
       "than the edge's nearest point, by more than `gap` times its distance, or else the one a pixel beyond that point is. How far away "
       "a pixel is: w of its face in front at its centre (front_depth).")
