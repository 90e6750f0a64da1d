"""The exact transpose of bilinear sampling: for each texel the sum of weight x gradient over its pixels, by gathers only.

    uv, covered -> footprint -> list of those covered -> keys -> merge sort -> bins -> rows, list -> gather of the gradient

The pixels are sorted by the texel at the lower corner of their footprint (`texture_sort.py`). The four bins around a texel hold all of its
pixels, and where its entries start in a list of four entries a pixel follows from the bins' ends alone, without a prefix sum. All but the
gather depends on the coordinates only: with static geometry the reactive cache computes it once. Every order is fixed: two runs agree bit
for bit.
"""
from __future__ import annotations

import numpy as np

from ....cache.errors import GraphError
from ..facts import InOrder, Listed
from ..ir import Extent, Node, image, table
from ..optable import Loop, apply, common_extent, empty, flag, op
from .compact import compact
from .texture import FETCHES, FOOTPRINT, TEXELS, WRAPS, _infer, _sample_ref, footprint
from .texture_sort import TOTAL, footprint_ref, keys_ref, merge_ref, merged, sorted_list

MANY = 1 << 14  # pixels from which those that sample nothing are not sorted: an object mostly fills a part of its pictures
LANE = 16  # entries a lane sums where a texel has more on average


def transpose(g: Node, uv: Node, covered: Node, extent: Extent, wrap: str, asked: Node | None = None) -> Node:
    """The gradient of a texture of `extent` sampled at `uv` where `covered`, from the gradient of the samples. asked: an int; where it is 0
    nothing is added up, whatever the lists hold."""
    footprint = apply("texture_footprint", uv, covered, width=extent.width, height=extent.height, wrap=wrap)
    if footprint.extent.count >= MANY and covered.extent == footprint.extent:
        listed = compact(apply("not_equal", covered, 0), 1)
        ordered = sorted_list(footprint, extent.width, listed)
        bins = apply("listed_bins", ordered, listed.total, extent=extent)
    else:
        ordered = merged(apply("texture_keys", footprint, width=extent.width, count=footprint.extent.count))
        bins = apply("texture_bins", ordered, extent=extent)
    rows = apply("texture_rows", bins)
    entries = apply("texture_list", rows, bins, ordered, footprint)
    return _gathered(g, rows if asked is None else apply("select", asked, rows, 0), entries, 4 * footprint.extent.count)


def _gathered(g: Node, rows: Node, entries: Node, count: int) -> Node:
    """For each texel of `rows` the sum of weight x g over its entries, of `count` in all."""
    across, down = _split(rows.extent, count)
    if across == 1:
        return apply("texture_gather", g, rows, entries)
    y = apply("texture_gather_lanes", g, rows, entries, across=across, down=down)
    return apply("block_sum", y, bw=across, bh=down, count=y.extent.count)


def _split(extent: Extent, entries: int) -> tuple[int, int]:
    """Lanes that share a texel: powers of two that keep lanes short and the image within every device's limit of 4096."""
    across = down = 1
    while entries > LANE * extent.width * extent.height * across * down and across < 32 and extent.width * across < 4096:
        across *= 2
        if down < across and extent.height * down < 4096 and entries > LANE * extent.width * extent.height * across * down:
            down *= 2
    return across, down


# ---- sampling

def _sample_vjp(g, y, texture, uv, covered, wrap):
    inside = apply("select", covered, g, 0.0)
    return transpose(g, uv, covered, texture.extent, wrap), apply("sample_uv_gradient", texture, uv, inside, wrap=wrap), None


def _listed(node: Node) -> Listed:
    """How `sample_exact` reads a texture of which there is only a list."""
    texture, uv, covered = node.inputs
    e = texture.extent
    return Listed(lambda places: apply("texel_places", places, uv, covered, wrap=node.attrs["wrap"]),
                  lambda entries, places: apply("sample_listed", entries, places, uv, width=e.width, height=e.height))


_BILINEAR = "mix(mix(t00_, t10_, s_.x), mix(t01_, t11_, s_.x), s_.y)"
# Always by fetches: samplers have weights of 8 bits, and the transpose is of the exact ones.
op("sample_exact", "texture uv covered", infer=_infer, reads="texel own own", cost=40, vjp=_sample_vjp, listed=_listed,
   when=flag(2), ref=lambda texture, uv, covered, wrap: np.where(covered != 0, _sample_ref(texture, uv, wrap), 0),
   glsl=lambda node: "{ " + FOOTPRINT + TEXELS[node.attrs["wrap"]] + FETCHES.replace("{t}", "{type}")
   + "{y} = {covered} != 0 ? " + _BILINEAR + " : {type}(0); }",
   sample=lambda rng: ([rng.normal(size=(5, 4, 3)), rng.uniform(-0.4, 1.4, (6, 5, 2)), rng.integers(0, 2, (6, 5, 1))],
                       {"wrap": "repeat"}),
   doc="Bilinear sample of a texture that is optimized, where `covered`; zero elsewhere.")


# ---- the same of a list of the texture's texels (compiler/passes/lists.py)

def _places_ref(places, uv, covered, wrap):
    xs, ys, _, _ = footprint(uv, places.shape[1], places.shape[0], wrap)
    return np.where(covered != 0, np.stack([places[ys[..., j], xs[..., i], 0] for j in (0, 1) for i in (0, 1)], -1), 0) - 1


def _sample_listed_ref(entries, places, uv, width, height):
    s = uv * np.array([width, height]) - 0.5
    fx, fy = np.split(s - np.floor(s), 2, -1)
    t00, t10, t01, t11 = (entries.reshape(-1, entries.shape[2])[np.maximum(places[..., k], 0)] for k in range(4))
    return np.where(places[..., :1] >= 0, (t00 * (1 - fx) + t10 * fx) * (1 - fy) + (t01 * (1 - fx) + t11 * fx) * fy, 0)


op("texel_places", "texture uv covered", reads="texel own own", cost=40, ref=_places_ref,
   infer=lambda name, inputs, attrs: ("ivec4", common_extent(name, inputs[1:])),
   glsl=lambda node: "{ " + FOOTPRINT + TEXELS[node.attrs["wrap"]] + FETCHES.replace("{t}", "int")
   + "{y} = ({covered} != 0 ? ivec4(t00_, t10_, t01_, t11_) : ivec4(0)) - 1; }",
   sample=lambda rng: ([rng.integers(1, 9, (5, 4, 1)), rng.uniform(-0.4, 1.4, (6, 5, 2)), rng.integers(0, 2, (6, 5, 1))],
                       {"wrap": "repeat"}),
   doc="Where the four texels of a bilinear read stand in a list, from an image of the places, which count from 1; -1 if not covered.")
op("sample_listed", "entries places uv", reads="texel own own", cost=40, ref=_sample_listed_ref,
   infer=lambda name, inputs, attrs: (inputs[0].vtype, common_extent(name, inputs[1:])),
   glsl="{ vec2 s_ = {uv} * vec2({width}, {height}) - 0.5; s_ -= floor(s_); ivec4 k_ = max({places}, ivec4(0));\n"
        "    {type} t00_ = {entries_at}(k_.x), t10_ = {entries_at}(k_.y), t01_ = {entries_at}(k_.z), t11_ = {entries_at}(k_.w);\n"
        "    {y} = {places}.x >= 0 ? " + _BILINEAR + " : {type}(0); }",
   sample=lambda rng: ([rng.normal(size=(3, 4, 3)), rng.integers(-1, 12, (6, 5, 4)), rng.uniform(-0.4, 1.4, (6, 5, 2))],
                       {"width": 5, "height": 7}),
   doc="sample_exact of a texture of width x height, of which the texels in use stand in a list; zero where a place is -1.")


# ---- from sorted pixels to a list by texel

def _bins_ref(ordered, extent):
    keys, texels = ordered[..., 0].ravel(), np.arange(extent.width * extent.height)
    return np.stack([np.searchsorted(keys, texels + side) for side in (0, 1)], 1).reshape(extent.height, extent.width, 2)


def _ordered(rng, width=8, height=3):
    """What each op of the chain makes of a random image."""
    footprint = footprint_ref(rng.uniform(-1, 2, (6, 5, 2)), rng.integers(0, 2, (6, 5, 1)), width, height, "repeat")
    ordered = merge_ref(keys_ref(footprint, width, 30), np.array([[[32]]]))
    bins = _bins_ref(ordered, image(width, height))
    rows = _rows_ref(bins)
    return footprint, ordered, bins, rows, _list_ref(rows, bins, ordered, footprint)


_BINS = """{ int n_ = {n}, lo_ = 0, hi_ = n_, step_ = 1;
    while (lo_ < hi_) { int m_ = (lo_ + hi_) >> 1; if ({ordered_at}(m_).x < {i}) lo_ = m_ + 1; else hi_ = m_; }
    {y} = ivec2(lo_);
    while (hi_ < n_ && {ordered_at}(hi_).x == {i}) { lo_ = hi_ + 1; hi_ = min(lo_ + step_, n_); step_ *= 2; }
    while (lo_ < hi_) { int m_ = (lo_ + hi_) >> 1; if ({ordered_at}(m_).x == {i}) lo_ = m_ + 1; else hi_ = m_; }
    {y}.y = lo_; }"""
op("listed_bins", "ordered total", alone=True, infer=lambda name, inputs, attrs: ("ivec2", attrs["extent"]), reads="texel texel", cost=200,
   ref=lambda ordered, total, extent: _bins_ref(ordered.reshape(-1, 2)[:int(total.reshape(-1)[-1])], extent),
   glsl=_BINS.replace("{n}", TOTAL), sample=lambda rng: ([_ordered(rng)[1], np.array([[[9]]])], {"extent": image(8, 3)}),
   doc="texture_bins of as many sorted pixels as the last texel of `total` says.")
op("texture_bins", "ordered", alone=True, infer=lambda name, inputs, attrs: ("ivec2", attrs["extent"]), reads="texel", ref=_bins_ref,
   cost=200,
   glsl=_BINS.replace("{n}", "{ordered_w} * {ordered_h}"),
   sample=lambda rng: ([_ordered(rng)[1]], {"extent": image(8, 3)}),
   doc="Begin and end of each texel's pixels among the sorted ones.")


def _rows_ref(bins):
    n = bins[..., 1] - bins[..., 0]
    n = n + np.roll(n, 1, 1)
    counts = (n + np.roll(n, 1, 0)).ravel()
    ends = np.cumsum(counts)
    return np.stack([ends - counts, ends], 1).reshape(bins.shape)


# Entries before texel (x, y) in the list: a sum over all texels before it of four bins each. Bins lie in the texels' order, so
# each of the four sums telescopes to bins at the ends of rows: of the own bins, of those to the left, above, above to the left.
op("texture_rows", "bins", infer=lambda name, inputs, attrs: ("ivec2", inputs[0].extent), reads="texel", ref=_rows_ref,
   cost=100,
   glsl="""{ int x_ = {p}.x, y_ = {p}.y, r_ = {w} - 1, b_ = {h} - 1, l_ = x_ == 0 ? r_ : x_ - 1, u_ = y_ == 0 ? b_ : y_ - 1;
    ivec2 own_ = {bins}({p}), left_ = {bins}(ivec2(l_, y_)), above_ = {bins}(ivec2(x_, u_)), corner_ = {bins}(ivec2(l_, u_)),
          right_ = {bins}(ivec2(r_, y_)), end_ = {bins}(ivec2(r_, u_));
    int begin_ = {bins}(ivec2(0, u_)).x, last_ = {bins}(ivec2(r_, b_)).y - {bins}(ivec2(0, b_)).x;
    int s_ = own_.x + (x_ == 0 ? own_.x : right_.y - right_.x + left_.x) + (y_ == 0 ? above_.x - begin_ : last_ + above_.x)
           + (y_ == 0 ? 0 : last_ + begin_) + (x_ == 0 ? 0 : end_.y - end_.x + corner_.x - begin_);
    {y} = ivec2(s_, s_ + own_.y - own_.x + left_.y - left_.x + above_.y - above_.x + corner_.y - corner_.x); }""",
   sample=lambda rng: ([_ordered(rng)[2]], {}),
   doc="Begin and end of each texel's entries in the list of four entries a pixel.")


def _list_ref(rows, bins, ordered, footprint):
    e = table(4 * footprint.shape[0] * footprint.shape[1])
    out = np.zeros((e.width * e.height, 2))
    pixels, f = ordered[..., 1].ravel(), footprint.reshape(-1, 4)[:, 2:]
    begin = rows[..., 0].ravel()
    for i, j in ((0, 0), (1, 0), (0, 1), (1, 1)):
        first, end = np.roll(bins, (j, i), (0, 1)).reshape(-1, 2).T
        count = np.maximum(end - first, 0)
        within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)  # the how manieth of its bin each pixel is
        p = pixels[np.repeat(first, count) + within]
        weight = (f[p, 0] if i else 1 - f[p, 0]) * (f[p, 1] if j else 1 - f[p, 1])
        out[np.repeat(begin, count) + within] = np.stack([p, weight], 1)
        begin = begin + count
    return out.reshape(e.height, e.width, 2)


def _size(e: Extent) -> tuple[int, int]:
    return e.width, e.height


def _list_infer(name, inputs, attrs):
    rows, bins, ordered, footprint = inputs
    pixels = footprint.extent.width * footprint.extent.height
    if rows.extent != bins.extent or _size(ordered.extent) != _size(table(pixels)):
        raise GraphError(f"{name}: rows {rows!r} and bins {bins!r} of one extent, and {pixels} ordered pixels are needed, got {ordered!r}")
    return "vec2", table(4 * pixels)


op("texture_list", "rows bins ordered footprint", alone=True, reads="texel texel texel texel", ref=_list_ref, cost=300, infer=_list_infer,
   glsl="""{ int lo_ = 0, hi_ = {rows_w} * {rows_h};
    if ({i} >= {rows_at}(hi_ - 1).y) hi_ = 0;
    while (lo_ < hi_) { int m_ = (lo_ + hi_) >> 1; if ({rows_at}(m_).x <= {i}) lo_ = m_ + 1; else hi_ = m_; }
    ivec2 r_ = lo_ > 0 ? {rows_at}(lo_ - 1) : ivec2(0);
    {y} = vec2(0.0);
    if ({i} < r_.y) {
        int x_ = (lo_ - 1) % {rows_w}, y_ = (lo_ - 1) / {rows_w}, j_ = {i} - r_.x, corner_ = 0;
        ivec2 b_ = {bins}(ivec2(x_, y_));
        while (j_ >= b_.y - b_.x && corner_ < 3) {
            j_ -= b_.y - b_.x;
            ++corner_;
            b_ = {bins}(ivec2((corner_ & 1) == 0 ? x_ : x_ == 0 ? {rows_w} - 1 : x_ - 1,
                              corner_ < 2 ? y_ : y_ == 0 ? {rows_h} - 1 : y_ - 1));
        }
        int k_ = {ordered_at}(b_.x + j_).y;
        vec2 f_ = {footprint_at}(k_).zw;
        {y} = vec2(k_, ((corner_ & 1) == 0 ? 1.0 - f_.x : f_.x) * (corner_ < 2 ? 1.0 - f_.y : f_.y));
    } }""",
   sample=lambda rng: (list(_ordered(rng)[3::-1]), {}),
   doc="(pixel, weight) of each texel's pixels, texel by texel: own bin, left, above, above to the left.")


# ---- the transpose itself

def _lanes_ref(g, rows, entries, across, down):
    g, entries = g.reshape(-1, g.shape[2]), entries.reshape(-1, 2)
    out = np.zeros((rows.shape[0] * down, rows.shape[1] * across, g.shape[1]))
    for y, x in np.ndindex(out.shape[:2]):
        first, end = rows[y // down, x // across]
        chunk = -(-(end - first) // (across * down))
        first = min(first + (y % down * across + x % across) * chunk, end)
        part = entries[first:min(first + chunk, end)]
        out[y, x] = (part[:, 1:] * g[part[:, 0].astype(int)]).sum(0)
    return out


def _gather_infer(name, inputs, attrs):
    g, rows, entries = inputs
    if _size(entries.extent) != _size(table(4 * g.extent.width * g.extent.height)):
        raise GraphError(f"{name}: {entries!r} are not four entries for each texel of {g!r}")
    return g.vtype, rows.extent


def _lanes_infer(name, inputs, attrs):
    e = _gather_infer(name, inputs, attrs)[1]
    return inputs[0].vtype, image(e.width * attrs["across"], e.height * attrs["down"])


def _gather_sample(rng):
    chain = _ordered(rng)
    return [rng.normal(size=(6, 5, 3)), chain[3], chain[4]]


_ENTRY = "{ vec2 e_ = {entries_at}(k_);"
_ADD = "{y} += e_.y * {g_at}(int(e_.x));"
def _in_order(node: Node) -> InOrder | None:
    """How `texture_gather` sums what lies in the order in which pixels were sorted, if only those that sample something were."""
    entries = node.inputs[2]
    if entries.op.name != "texture_list" or not entries.inputs[2].extent.partial:
        return None
    _, bins, ordered, footprint = entries.inputs
    how = {"width": footprint.attrs["width"], "height": footprint.attrs["height"], "clamped": WRAPS.index(footprint.attrs["wrap"])}
    return InOrder(apply("swizzle", ordered, channels="y"), footprint.inputs[1],
                   lambda g, there: apply("texture_gather_ordered", g, bins, there(footprint.inputs[0]), **how))


op("texture_gather", "g rows entries", ordered=_in_order, sums=(0,), reads="texel own texel",
   ref=lambda g, rows, entries: _lanes_ref(g, rows, entries, 1, 1), infer=_gather_infer, cost=60, when=empty(1),
   sample=lambda rng: (_gather_sample(rng), {}),
   loop=Loop("for (int k_ = {rows}.x; k_ < {rows}.y; ++k_) " + _ENTRY, _ADD),
   doc="For each texel the sum of weight x g over its entries; no second derivative.")


def _gather_ordered_ref(g, bins, uv, width, height, clamped):
    g, wrap = g.reshape(-1, g.shape[2]), WRAPS[clamped]
    f = footprint_ref(uv, np.ones_like(uv[..., :1]), width, height, wrap).reshape(-1, 4)[:, 2:]
    out = np.zeros((*bins.shape[:2], g.shape[1]))
    for y, x in np.ndindex(bins.shape[:2]):
        for corner in range(4):
            i, j = corner & 1, corner >> 1
            k = slice(*bins[y - j, x - i])
            weight = (f[k, 0] if i else 1 - f[k, 0]) * (f[k, 1] if j else 1 - f[k, 1])
            out[y, x] += (weight[:, None] * g[k]).sum(0)
    return out


def _gather_ordered_infer(name, inputs, attrs):
    g, bins, uv = inputs
    if g.extent != uv.extent or uv.vtype != "vec2" or bins.vtype != "ivec2":
        raise GraphError(f"{name}: gradients and vec2 coordinates of one extent, and ivec2 bins are needed, got {g!r}, {uv!r} and {bins!r}")
    if _size(bins.extent) != (attrs["width"], attrs["height"]):
        raise GraphError(f"{name}: bins of {attrs['width']}x{attrs['height']} texels are needed, got {bins!r}")
    return g.vtype, bins.extent


def _gather_ordered_sample(rng):
    uv = rng.uniform(-1, 2, (6, 5, 2))
    ordered = merge_ref(keys_ref(footprint_ref(uv, np.ones((6, 5, 1)), 8, 3, "repeat"), 8, 30), np.array([[[32]]]))
    pixels = ordered.reshape(-1, 2)[:30, 1]
    return [rng.normal(size=(6, 5, 3)), _bins_ref(ordered, image(8, 3)), uv.reshape(-1, 2)[pixels].reshape(6, 5, 2)]


op("texture_gather_ordered", "g bins uv", sums=(0,), reads="texel texel texel", ref=_gather_ordered_ref, infer=_gather_ordered_infer,
   cost=80, sample=lambda rng: (_gather_ordered_sample(rng), {"width": 8, "height": 3, "clamped": 0}),
   loop=Loop("""{ int x_ = {p}.x, y_ = {p}.y, l_ = (x_ == 0 ? {bins_w} : x_) - 1, u_ = (y_ == 0 ? {bins_h} : y_) - 1;
    ivec2 o_ = {bins}({p}), a_ = {bins}(ivec2(l_, y_)), b_ = {bins}(ivec2(x_, u_)), c_ = {bins}(ivec2(l_, u_));
    int m0_ = o_.y - o_.x, m1_ = m0_ + a_.y - a_.x, m2_ = m1_ + b_.y - b_.x, m3_ = m2_ + c_.y - c_.x;
    for (int j_ = 0; j_ < m3_; ++j_) {
    int k_ = j_ < m0_ ? o_.x + j_ : j_ < m1_ ? a_.x + j_ - m0_ : j_ < m2_ ? b_.x + j_ - m1_ : c_.x + j_ - m2_;
    vec2 f_ = {uv_at}(k_) * vec2({width}, {height}) - 0.5;
    if ({clamped} != 0) f_ = clamp(f_, vec2(0.0), vec2({width} - 1, {height} - 1));
    f_ -= floor(f_);
    float e_ = (j_ < m0_ || j_ >= m1_ && j_ < m2_ ? 1.0 - f_.x : f_.x) * (j_ < m1_ ? 1.0 - f_.y : f_.y);""",
             "{y} += e_ * {g_at}(k_);", "} }"),
   doc="texture_gather where gradients and coordinates lie in the order of the sorted pixels: own bin, left, above, above to the left.")
op("texture_gather_lanes", "g rows entries", sums=(0,), infer=_lanes_infer, reads="texel texel texel", ref=_lanes_ref, cost=60,
   sample=lambda rng: (_gather_sample(rng), {"across": 2, "down": 1}),
   loop=Loop("""{ ivec2 r_ = {rows}({p} / ivec2({across}, {down}));
    int c_ = (r_.y - r_.x + {across} * {down} - 1) / ({across} * {down});
    int k_ = min(r_.x + ({p}.y % {down} * {across} + {p}.x % {across}) * c_, r_.y), z_ = min(k_ + c_, r_.y);
    for (; k_ < z_; ++k_) """ + _ENTRY, _ADD, "} }"),
   doc="texture_gather by across x down lanes a texel, to be summed.")
