"""The exact transpose of bilinear sampling: for each texel the sum of weight x gradient over its pixels, by gathers only.

    uv, covered -> footprint -> list of those covered -> keys -> merge sort -> bins -> rows, list -> gather of the gradient

The pixels are sorted by the texel at the lower corner of their footprint: a stable merge sort, one pass a doubling, whose cost
does not depend on where the coordinates point. The four bins around a texel hold all of its pixels, and where its entries start
in a list of four entries a pixel follows from the bins' ends alone, without a prefix sum. All but the gather depends on the
coordinates only: with static geometry the reactive cache computes it once. Every order is fixed: two runs agree bit for bit.
"""
from __future__ import annotations

import numpy as np

from ....cache.errors import GraphError
from ..facts import InOrder, Listed
from ..ir import Extent, Node, image, is_int, table
from ..optable import Loop, apply, common_extent, empty, flag, op
from .compact import Compact, compact
from .lookup import constant
from .texture import FETCHES, FOOTPRINT, TEXELS, WRAPS, _infer, _sample_ref, footprint

LAST = 2 ** 31 - 1  # key of a pixel that samples nothing: sorted behind all others
MAX_PIXELS = 1 << 24  # pixel numbers are kept as floats
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
        ordered = _merged(apply("texture_keys", footprint, width=extent.width, count=footprint.extent.count))
        bins = apply("texture_bins", ordered, extent=extent)
    rows = apply("texture_rows", bins)
    entries = apply("texture_list", rows, bins, ordered, footprint)
    return _gathered(g, rows if asked is None else apply("select", asked, rows, 0), entries, 4 * footprint.extent.count)


def sorted_list(footprint: Node, width: int, listed: Compact) -> Node:
    """(texel, read) of the footprints of a list, sorted by texel: the number of a lower corner in an image of this width."""
    return _merged(apply("listed_keys", footprint, listed.entries, listed.total, width=width), listed.total)


def _merged(ordered: Node, total: Node | None = None) -> Node:
    """Sorted by the first channel. total: its last texel says how many there are."""
    run = 1
    while run < ordered.extent.width * ordered.extent.height:
        each = constant(np.array([[[run]]]))  # data, not text: all passes share one pipeline
        ordered = apply("merge_runs", ordered, each) if total is None else apply("merge_listed", ordered, each, total)
        run *= 2
    return ordered


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


def _footprint_ref(uv, covered, width, height, wrap):
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
op("texture_footprint", "uv covered", infer=_footprint_infer, ref=_footprint_ref, cost=30,
   glsl=lambda node: _ROUNDED[node.attrs["wrap"]],
   sample=lambda rng: ([rng.uniform(-1, 2, (6, 5, 2)), rng.integers(0, 2, (6, 5, 1))],
                       {"width": 8, "height": 3, "wrap": "repeat"}),
   doc="(x, y) of the lower texel of a bilinear read and the fractions towards the next, which wraps; x = -1 if not covered. "
       "With clamp the fraction at a border is 0, so that the wrapped neighbour has no weight.")


# ---- sorting

def _keys_ref(footprint, width, count):
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


op("texture_keys", "footprint", reads="texel", ref=_keys_ref, cost=30, infer=_keys_infer,
   glsl="""{y} = ivec2(2147483647, {i});
    if ({i} < {count}) { vec2 f_ = {footprint_at}({i}).xy; if (f_.x >= 0.0) {y}.x = int(f_.y) * {width} + int(f_.x); }""",
   sample=lambda rng: ([_footprint_ref(rng.uniform(-1, 2, (6, 5, 2)), rng.integers(0, 2, (6, 5, 1)), 8, 3, "repeat")],
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
    return [_footprint_ref(rng.uniform(-1, 2, (6, 5, 2)), covered, 8, 3, "repeat"), entries, np.array([[[len(pixels)]]])], {"width": 8}


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


def _merge_ref(a, run):
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
_TOTAL = "{total}(ivec2({total_w} - 1, {total_h} - 1))"


def _merge_listed_ref(a, run, total):
    out, count = a.copy(), int(total.reshape(-1)[-1])
    if count:
        out.reshape(-1, 2)[:count] = _merge_ref(a.reshape(-1, 2)[:count], run)
    return out


op("merge_runs", "a run", alone=True, infer=_merge_infer, reads="texel own", ref=_merge_ref, cost=200, sample=_merge_sample,
   glsl=_MERGE.replace("{n}", "{a_w} * {a_h}"),
   doc="Stable merge of neighbouring runs of `run` entries (a power of two), each sorted by the first channel.")


op("merge_listed", "a run total", alone=True, infer=_merge_infer, reads="texel own texel", ref=_merge_listed_ref, cost=200,
   glsl=_MERGE.replace("{n}", _TOTAL).replace("if (second_", "if ({i} < n_ && second_", 1),
   sample=lambda rng: ([*_merge_sample(rng)[0], np.array([[[17]]])], {}),
   doc="merge_runs of as many entries as the last texel of `total` says.")


# ---- from sorted pixels to a list by texel

def _bins_ref(ordered, extent):
    keys, texels = ordered[..., 0].ravel(), np.arange(extent.width * extent.height)
    return np.stack([np.searchsorted(keys, texels + side) for side in (0, 1)], 1).reshape(extent.height, extent.width, 2)


def _ordered(rng, width=8, height=3):
    """What each op of the chain makes of a random image."""
    footprint = _footprint_ref(rng.uniform(-1, 2, (6, 5, 2)), rng.integers(0, 2, (6, 5, 1)), width, height, "repeat")
    ordered = _merge_ref(_keys_ref(footprint, width, 30), np.array([[[32]]]))
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
   glsl=_BINS.replace("{n}", _TOTAL), sample=lambda rng: ([_ordered(rng)[1], np.array([[[9]]])], {"extent": image(8, 3)}),
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
    for y, x in np.ndindex(rows.shape[:2]):
        k = rows[y, x, 0]
        for corner in range(4):
            i, j = corner & 1, corner >> 1
            p = pixels[slice(*bins[y - j, x - i])]
            weight = (f[p, 0] if i else 1 - f[p, 0]) * (f[p, 1] if j else 1 - f[p, 1])
            out[k:k + len(p)] = np.stack([p, weight], 1)
            k += len(p)
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
    return InOrder(apply("swizzle", ordered, channels="y"),
                   lambda g, there: apply("texture_gather_ordered", g, bins, there(footprint.inputs[0]), **how))


op("texture_gather", "g rows entries", ordered=_in_order, sums=(0,), reads="texel own texel",
   ref=lambda g, rows, entries: _lanes_ref(g, rows, entries, 1, 1), infer=_gather_infer, cost=60, when=empty(1),
   sample=lambda rng: (_gather_sample(rng), {}),
   loop=Loop("for (int k_ = {rows}.x; k_ < {rows}.y; ++k_) " + _ENTRY, _ADD),
   doc="For each texel the sum of weight x g over its entries; no second derivative.")


def _gather_ordered_ref(g, bins, uv, width, height, clamped):
    g, wrap = g.reshape(-1, g.shape[2]), WRAPS[clamped]
    f = _footprint_ref(uv, np.ones_like(uv[..., :1]), width, height, wrap).reshape(-1, 4)[:, 2:]
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
    ordered = _merge_ref(_keys_ref(_footprint_ref(uv, np.ones((6, 5, 1)), 8, 3, "repeat"), 8, 30), np.array([[[32]]]))
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
