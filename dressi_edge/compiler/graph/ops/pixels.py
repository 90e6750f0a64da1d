"""What pixels name: lookups by an index that is computed a pixel, which tiles name anything, and the transposes: sums over pixels.

The transpose of a lookup gathers over a box of pixels that is known to hold every pixel that can name the entry, or over what of that
box is near a segment; both skip what cannot name it.
"""
from __future__ import annotations

import numpy as np

from ....cache.errors import GraphError
from ..ir import Extent, Node, table
from ..optable import Loop, apply, at, negative, op, zero
from .lookup import LOOKUP, lookup_infer, lookup_ref, to_table
from .reduce import tiles_of

BIN = 8  # pixels a side of a bin of names
FOUR = 4  # pixels of a row in one texel


def _boxed_sample(rng):
    index = rng.integers(-1, 6, (8, 9, 1))
    box = np.tile(np.array([0, 0, 9, 8]), (6, 1))
    return [to_table(rng.normal(size=(6, 3))), index, to_table(box)], {}


def _sums(values, index, box):
    """For each box the sum of the values of its pixels that name it."""
    out = np.zeros((box.shape[0] * box.shape[1], values.shape[2]))
    ys, xs = np.nonzero((index[..., 0] >= 0) & (index[..., 0] < len(out)))
    entry = index[ys, xs, 0]
    b = box.reshape(-1, 4)[entry]
    inside = (xs >= b[:, 0]) & (ys >= b[:, 1]) & (xs < b[:, 2]) & (ys < b[:, 3])
    np.add.at(out, entry[inside], np.broadcast_to(values, index.shape[:2] + values.shape[2:])[ys, xs][inside])
    return out.reshape(box.shape[0], box.shape[1], -1)


op("lookup_boxed", "entries index box", attrs="", alike=((2, 0),), when=negative(1), infer=lookup_infer, reads="texel own texel",
   ref=lookup_ref, cost=8, glsl=LOOKUP, sample=_boxed_sample,
   vjp=lambda g, y, entries, index, box: (sum_named(g, index, box), None, None),
   doc="A table's entry by a computed index; `box` bounds, for each entry, the pixels that may name it.")


def _any_ref(test):
    def ref(index, width, height):
        h, w, _ = index.shape
        padded = np.zeros((-(-h // height) * height, -(-w // width) * width), bool)
        padded[:h, :w] = test(index[..., 0])
        return padded.reshape(padded.shape[0] // height, height, -1, width).any((1, 3)).astype(np.int64)[..., None]
    return ref


for _name, _glsl, _test, _covers, _what in (("occupied", ">= 0", lambda x: x >= 0, (0, -1), "index is not negative"),
                                            ("vacant", "< 0", lambda x: x < 0, None, "index is negative"),
                                            ("marked", "> 0", lambda x: x > 0, None, "mask is positive")):
    op(_name, "index", reads="texel", ref=_any_ref(_test), covers=_covers, cost=64,
       infer=lambda name, inputs, attrs: ("int", tiles_of(inputs[0].extent, attrs["width"], attrs["height"])),
       glsl="""{ ivec2 size_ = ivec2({width}, {height}), lo_ = {p} * size_, hi_ = min(lo_ + size_, ivec2({index_w}, {index_h}));
    {y} = 0;
    for (int b_ = lo_.y; b_ < hi_.y && {y} == 0; ++b_)
    for (int a_ = lo_.x; a_ < hi_.x && {y} == 0; ++a_) {y} = {index}(ivec2(a_, b_)) TEST ? 1 : 0; }""".replace(
           "TEST", _glsl),
       sample=lambda rng: ([rng.integers(-60, 3, (17, 20, 1))], {"width": 8, "height": 8}),
       doc=f"1 for each tile of width x height pixels in which some {_what}.")


def _in_fours_ref(index):
    h, w, _ = index.shape
    out = np.full((h, -(-w // FOUR) * FOUR), -1, np.int64)
    out[:, :w] = index[..., 0]
    return out.reshape(h, -1, FOUR)


def fours_of(extent: Extent) -> Extent:
    """The extent of an image with one texel for four of a row."""
    return tiles_of(extent, FOUR, 1)


op("in_fours", "index", reads="texel", ref=_in_fours_ref, cost=8, regroups=True,
   infer=lambda name, inputs, attrs: ("ivec4", fours_of(inputs[0].extent)),
   glsl=f"""{{ int a_ = {{p}}.x * {FOUR}, last_ = {{index_w}} - 1 - a_;
    {{y}} = ivec4({{index}}(ivec2(a_, {{p}}.y)), last_ < 1 ? -1 : {{index}}(ivec2(a_ + 1, {{p}}.y)),
                  last_ < 2 ? -1 : {{index}}(ivec2(a_ + 2, {{p}}.y)), last_ < 3 ? -1 : {{index}}(ivec2(a_ + 3, {{p}}.y))); }}""",
   sample=lambda rng: ([rng.integers(-300, 300, (7, 10, 1))], {}),
   doc="An index, four pixels of a row in one texel, which is read at once; -1 beyond the last pixel.")


def _one_infer(name, inputs, attrs):
    if inputs[0].vtype != "ivec4" or inputs[0].extent != fours_of(attrs["extent"]):
        raise GraphError(f"{name}: {inputs[0]!r} is not what in_fours makes of {attrs['extent']}")
    return "int", attrs["extent"]


op("one_of_fours", "fours", attrs="extent", reads="texel", cost=4,
   ref=lambda fours, extent: fours.reshape(fours.shape[0], -1, 1)[:, :extent.width],
   infer=_one_infer,
   glsl=f"""{{ ivec4 all_ = {{fours}}(ivec2({{p}}.x / {FOUR}, {{p}}.y)); int k_ = {{p}}.x % {FOUR};
    {{y}} = k_ == 0 ? all_.x : k_ == 1 ? all_.y : k_ == 2 ? all_.z : all_.w; }}""",
   sample=lambda rng: ([rng.integers(-300, 300, (7, 3, 4))], {"extent": Extent(10, 7, 70)}),
   doc="What in_fours was made of.")


def _bin_names_ref(fours):
    h, w, _ = fours.shape
    out = np.zeros((-(-h // BIN), -(-w * FOUR // BIN), 4), np.int64)
    for y, x, c in np.argwhere(fours >= 0):
        k = fours[y, x, c]
        out[y // BIN, x * FOUR // BIN, k >> 5 & 3] |= 1 << (k & 31)
    return (out + 2 ** 31) % 2 ** 32 - 2 ** 31


_NAME_BIT = "ivec4 name_bit(int k) { return ivec4(equal(ivec4(k >> 5 & 3), ivec4(0, 1, 2, 3))) * (1 << (k & 31)); }"
op("bin_names", "fours", reads="texel", ref=_bin_names_ref, cost=64, functions=_NAME_BIT,
   infer=lambda name, inputs, attrs: ("ivec4", tiles_of(inputs[0].extent, BIN // FOUR, BIN)),
   glsl=f"""{{ ivec2 size_ = ivec2({BIN // FOUR}, {BIN}), lo_ = {{p}} * size_, hi_ = min(lo_ + size_, ivec2({{fours_w}}, {{fours_h}}));
    {{y}} = ivec4(0);
    for (int b_ = lo_.y; b_ < hi_.y; ++b_) for (int a_ = lo_.x; a_ < hi_.x; ++a_) {{
    ivec4 k_ = {{fours}}(ivec2(a_, b_));
    if (k_.x >= 0) {{y}} |= name_bit(k_.x);
    if (k_.y >= 0) {{y}} |= name_bit(k_.y);
    if (k_.z >= 0) {{y}} |= name_bit(k_.z);
    if (k_.w >= 0) {{y}} |= name_bit(k_.w); }} }}""",
   sample=lambda rng: ([rng.integers(-300, 300, (17, 5, 4))], {}),
   doc=f"For each bin of {BIN} x {BIN} pixels which entries some pixel names: bit k mod 128 is set for each entry k.")


def sum_named(values: Node, index: Node, box: Node) -> Node:
    """For each entry of a table the sum of the values (1 x 1 or of the index's extent) of the pixels that name it; all lie in its box."""
    e = index.extent
    values = values if (values.extent.width, values.extent.height) == (e.width, e.height) else apply("broadcast", values, extent=e)
    fours = apply("in_fours", index)
    return apply("segment_sum", values, fours, box, apply("bin_names", fours))


def _segment_infer(name, inputs, attrs):
    values, fours, box, bins = inputs
    if ((fours.vtype, box.vtype, bins.vtype) != ("ivec4", "ivec4", "ivec4") or fours.extent != fours_of(values.extent)
            or bins.extent != tiles_of(fours.extent, BIN // FOUR, BIN)):
        raise GraphError(f"{name}: values, their index in_fours, ivec4 boxes and the bin_names of those are needed, got {values!r}, "
                         f"{fours!r}, {box!r}, {bins!r}")
    return values.vtype, box.extent


def _segment_ref(values, fours, box, *_):
    return _sums(values, fours.reshape(fours.shape[0], -1, 1)[:, :values.shape[1]], box)


# Bin by bin, those skipped in which nothing can name the entry, four pixels of a row at once, from pixel to pixel that does. Machines that
# run several entries at once turn as often as the longest needs, and those that cannot branch around a body run it once for each pixel
# added, not for each tried.
_BINS = f"""{{ ivec2 most_ = ivec2({{values_w}}, {{values_h}});
ivec4 mine_ = name_bit({{i}}), box_ = clamp({{box}}, ivec4(0), ivec4(most_, most_));
ivec2 bin_ = ivec2(box_.x / {BIN} - 1, box_.y / {BIN}), at_ = ivec2(0), lo_ = ivec2(0), hi_ = ivec2(0);
int hits_ = 0;
for (;;) {{
for (bool left_ = true; left_ && hits_ == 0;) {{
at_.x += {FOUR};
if (at_.x >= hi_.x) {{ ++at_.y; at_.x = lo_.x; }}
if (at_.y >= hi_.y) {{
if (++bin_.x * {BIN} >= box_.z) {{ bin_.x = box_.x / {BIN}; ++bin_.y; }}
left_ = bin_.y * {BIN} < box_.w;
lo_ = max(bin_ * {BIN}, box_.xy);
lo_.x &= ~{FOUR - 1};
hi_ = left_ && any(notEqual({{bins}}(bin_) & mine_, ivec4(0))) ? min(bin_ * {BIN} + {BIN}, box_.zw) : ivec2(0);
at_ = lo_;
}}
ivec4 found_ = ivec4(equal({{fours}}(ivec2(at_.x / {FOUR}, at_.y)), ivec4({{i}})));
int inside_ = {2 ** FOUR - 1} << max(box_.x - at_.x, 0) & {2 ** FOUR - 1} >> max(at_.x + {FOUR} - box_.z, 0);
hits_ = at_.y < hi_.y ? (found_.x | found_.y << 1 | found_.z << 2 | found_.w << 3) & inside_ : 0;
}}
if (hits_ == 0) break;
ivec2 q_ = at_;
q_.x += (hits_ & 1) != 0 ? 0 : (hits_ & 2) != 0 ? 1 : (hits_ & 4) != 0 ? 2 : 3;
hits_ &= hits_ - 1;"""


def _in_bands(values, fours, box, bins, bands):
    how = {"bands": bands, "count": box.extent.count}
    return apply("band_total", apply("segment_sum_banded", values, fours, box, bins, **how), **how)


op("segment_sum", "values fours box bins", attrs="", sums=(0,), named=(0, 1, -1), infer=_segment_infer,
   reads="texel texel own texel", ref=_segment_ref, cost=400, functions=_NAME_BIT, banded=_in_bands,
   vjp=lambda g, y, values, fours, box, bins: (
       apply("lookup", g, apply("one_of_fours", fours, extent=values.extent)), None, None, None),
   loop=Loop(_BINS, "{y} += {values}(q_);", "} }", 14),
   sample=lambda rng: ([rng.normal(size=(8, 9, 3)), _in_fours_ref(rng.integers(-1, 6, (8, 9, 1))),
                        to_table(np.tile(np.array([0, 0, 9, 8]), (6, 1))), np.full((1, 2, 4), -1)], {}),
   doc="Transpose of lookup_boxed: for each entry the sum, over the bins of its box that may hold any (`bin_names`), of the pixels that "
       "name it.")


def _banded_infer(name, inputs, attrs):
    vtype, extent = _segment_infer(name, inputs, attrs)
    if attrs["bands"] < 1 or not 0 < attrs["count"] <= extent.count:
        raise GraphError(f"{name}: {attrs['bands']} bands of {attrs['count']} entries; the table {inputs[2]!r} has {extent.count}")
    return vtype, table(attrs["count"] * attrs["bands"])


def _rows_of(top, bottom, bands, band):
    """The rows of bins that a band has of boxes: an equal share, but for the last."""
    first = top // BIN
    each = -(-(-(-bottom // BIN) - first) // bands)
    return np.maximum(top, (first + band * each) * BIN), np.minimum(bottom, (first + (band + 1) * each) * BIN)


def _banded_ref(values, fours, box, bins, bands, count):
    parts = []
    for band in range(bands):
        part = box.copy()
        part[..., 1], part[..., 3] = _rows_of(box[..., 1], box[..., 3], bands, band)
        parts.append(_segment_ref(values, fours, part).reshape(-1, values.shape[2])[:count])
    return to_table(np.stack(parts, 1).reshape(-1, values.shape[2]))


_BAND = f"""{{ int entry_ = {{i}} / {{bands}}, band_ = {{i}} - entry_ * {{bands}};
ivec4 rows_ = {{box_at}}(entry_);
int top_ = rows_.y / {BIN}, each_ = ((rows_.w + {BIN - 1}) / {BIN} - top_ + {{bands}} - 1) / {{bands}};
top_ += band_ * each_;
rows_.yw = ivec2(max(rows_.y, top_ * {BIN}), min(rows_.w, (top_ + each_) * {BIN}));
"""
op("segment_sum_banded", "values fours box bins", attrs="bands count", sums=(0,), named=(0, 1, -1), infer=_banded_infer,
   reads="texel texel texel texel", ref=_banded_ref, cost=400, functions=_NAME_BIT,
   loop=Loop(_BAND + _BINS.replace("{i}", "entry_").replace("{box}", "rows_"), "{y} += {values}(q_);", "} } }", 19),
   sample=lambda rng: ([rng.normal(size=(30, 9, 3)), _in_fours_ref(rng.integers(-1, 6, (30, 9, 1))),
                        to_table(np.tile(np.array([0, 3, 9, 29]), (6, 1))), np.full((4, 2, 4), -1)], {"bands": 3, "count": 6}),
   doc="segment_sum of each of so many bands of rows of an entry's box: entry k's are the entries k * bands and after.")


def _band_total_infer(name, inputs, attrs):
    if min(attrs["bands"], attrs["count"]) < 1 or inputs[0].extent.count < attrs["bands"] * attrs["count"]:
        raise GraphError(f"{name}: {inputs[0]!r} is no table of {attrs['count']} entries of {attrs['bands']} bands")
    return inputs[0].vtype, table(attrs["count"])


op("band_total", "parts", attrs="bands count", reads="texel", infer=_band_total_infer, cost=30,
   ref=lambda parts, bands, count: to_table(
       parts.reshape(-1, parts.shape[2])[:bands * count].reshape(count, bands, parts.shape[2]).sum(1)),
   loop=Loop("for (int b_ = 0; b_ < {bands}; ++b_) {", "{y} += {parts_at}(min({i}, {n} - 1) * {bands} + b_);"),
   sample=lambda rng: ([to_table(rng.normal(size=(12, 3)))], {"bands": 3, "count": 4}),
   doc="The sum of each entry's bands, first to last.")

# Rows of a capsule: the slab within `reach` of the segment's line, wider by more than rounding; the whole box where the line is nearly
# level. From pixel to pixel that names the entry, all in one loop: see `_BINS`.
_CAPSULE = """{ vec2 d_ = {segment}.zw - {segment}.xy;
bool level_ = abs(d_.y) < 0.25;
float slope_ = level_ ? 0.0 : d_.x / d_.y, wide_ = level_ ? 1e6 : float({reach}) * length(d_) / abs(d_.y) + 0.02 + 2e-3 * abs(slope_);
ivec4 box_ = clamp({box}, ivec4(0), ivec4({places_w}, {places_h}, {places_w}, {places_h})), named_ = ivec4(0);
ivec2 q_ = ivec2(0, box_.y - 1);
int end_ = 0;
for (;;) {
bool hit_ = false;
for (bool left_ = true; left_ && !hit_;) {
if (++q_.x >= end_) {
left_ = ++q_.y < box_.w;
float at_ = {center}.x + {segment}.x + (float(q_.y) + 0.5 - {center}.y - {segment}.y) * slope_ - 0.5;
ivec2 row_ = ivec2(clamp(vec2(ceil(at_ - wide_), floor(at_ + wide_) + 1.0), vec2(box_.xx), vec2(box_.zz)));
q_.x = row_.x;
end_ = row_.y;
}
hit_ = left_ && q_.x < end_;
named_ = ivec4({places}(hit_ ? q_ : ivec2(0)));
hit_ = hit_ && any(equal(named_, ivec4({i} + 1)));
}
if (!hit_) break;"""


def _capsules(rng):
    """Pixels that name the nearest of some segments, within 2; arguments after the values, with no name out of reach."""
    ends = np.array([(-4, -3, 3, 2), (2, 3, 2, -3), (-5, 4, 4, 4.1), (-1, 3, -3, -3)], float)
    ys, xs = np.mgrid[:10, :12] + 0.5 - np.array([5.0, 6.0])[:, None, None]
    p = np.stack([xs, ys], -1)[..., None, :]
    d = ends[:, 2:] - ends[:, :2]
    t = np.clip(((p - ends[:, :2]) * d).sum(-1) / (d * d).sum(-1), 0, 1)
    far = np.linalg.norm(ends[:, :2] + t[..., None] * d - p, axis=-1)
    places = np.where(far.min(-1) <= 2, far.argmin(-1) + 1, 0)[..., None]
    box = np.array([np.concatenate([np.floor(np.minimum(e[:2], e[2:]) + (4, 3)), np.ceil(np.maximum(e[:2], e[2:]) + (8, 7))])
                    for e in ends]).clip(0, [12, 10, 12, 10]).astype(int)
    return places, to_table(box), to_table(ends), to_table(np.tile([6.0, 5.0], (4, 1)))


def _near_ref(entries, places, *_, channel, reach):
    return lookup_ref(entries, places[..., channel:channel + 1] - 1)


op("lookup_near", "entries places box segment center", alike=((2, 0), (3, 0), (4, 0)), when=zero(1), infer=at(1),
   reads="texel own texel texel texel",
   size=lambda node, sizes: sizes[0], ref=_near_ref, cost=8,
   glsl="{ int at_ = ivec4({places})[{channel}] - 1;\n"
        "    {y} = {type}(0); if (at_ >= 0) {y} = {entries_at}(min(at_, {entries_w} * {entries_h} - 1)); }",
   vjp=lambda g, y, entries, places, box, segment, center, **attrs: (
       apply("capsule_sum", g, places, box, segment, center, **attrs), None, None, None, None),
   sample=lambda rng: ([to_table(rng.normal(size=(4, 3))), *_capsules(rng)], {"reach": 2.0, "channel": 0}),
   doc="lookup_boxed for entries that are segments, relative to `center`, and pixels within `reach` of the one that a channel of "
       "`places`, int or ivec4, names, counted from 1, 0 for none: sums over several channels share one loop.")
op("capsule_sum", "values places box segment center", alike=((0, 1),), sums=(0,), named=(0, 1, 0), infer=at(2),
   reads="texel texel own own own", cost=300,
   ref=lambda values, places, box, *_, channel, reach: _sums(values, places[..., channel:channel + 1] - 1, box),
   vjp=lambda g, y, values, places, *where, **attrs: (apply("lookup_near", g, places, *where, **attrs), None, None, None, None),
   loop=Loop(_CAPSULE, "if (named_[{channel}] == {i} + 1) {y} += {values}(q_);", "} }", 7),
   sample=lambda rng: ([rng.normal(size=(10, 12, 3)), *_capsules(rng)], {"reach": 2.0, "channel": 0}),
   doc="Transpose of lookup_near: for each segment the sum over the pixels of its box and within `reach` that name it.")

op("fetch", "source xy", infer=at(1), reads="texel own", cost=6,
   ref=lambda source, xy: source[np.clip(xy[..., 1], 0, source.shape[0] - 1), np.clip(xy[..., 0], 0, source.shape[1] - 1)],
   glsl="{y} = {source}(clamp({xy}, ivec2(0), ivec2({source_w} - 1, {source_h} - 1)));",
   sample=lambda rng: ([rng.normal(size=(4, 5, 3)), rng.integers(0, 4, (6, 7, 2))], {}),
   doc="The texel at a computed place, clamped to the image; no gradient.")
