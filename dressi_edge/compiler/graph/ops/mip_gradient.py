"""The exact transpose of trilinear sampling: for each texel of each level the sum of weight x gradient over its pixels, by gathers only.

Each pixel is two bilinear reads, 2 k and 2 k + 1: of its level and of the next. As in `texture_gradient.py` they are sorted by the texel at
the lower corner of their footprint, now by its number among the texels of all levels; the four bins around a texel, which wrap within its
level, hold all of its reads. Lists for the texture, its half and the rest are excerpts of one; all but the gathers depends on
coordinates and levels of detail alone. What reaches a coarse level goes on to the finer ones by the transposes of what made it.
"""
from __future__ import annotations

import numpy as np

from ....cache.errors import GraphError
from ..ir import UNIT, Extent, Node, image, table
from ..optable import apply, op
from .mips import Pyramid, bilinear, found, split_lod, texels_of, wrapped, wraps_of
from .texture_gradient import MAX_PIXELS, gathered, sorted_keys

MAX_SIDE = 4096  # of an image on every device


def _places(p: Pyramid) -> Extent:
    """An image with a place for each texel of all levels, and for those that the rest's image has more."""
    count = p.starts[2] + p.rest.width * p.rest.height
    width = p.width
    while -(-count // width) > MAX_SIDE and width < MAX_SIDE:
        width *= 2
    return image(width, -(-count // width))


def transpose(g: Node, uv: Node, lod: Node, covered: Node, extent: Extent, wrap: tuple[str, str]) -> tuple[Node, Node, Node]:
    """The gradients of a texture of `extent`, its half and its rest."""
    p = Pyramid(extent.width, extent.height)
    uv, lod, covered = (x if x.extent != UNIT or g.extent == UNIT else apply("broadcast", x, extent=g.extent) for x in (uv, lod, covered))
    size, places = {"width": p.width, "height": p.height}, _places(p)
    footprint = apply("mip_footprint", uv, lod, covered, across=places.width, wrap=wrap, **size)
    ordered = sorted_keys(footprint, places.width, 2 * uv.extent.count)
    bins = apply("texture_bins", ordered, extent=places)
    rows = apply("mip_rows", bins, **size)
    entries = apply("mip_list", rows, bins, ordered, footprint, lod, **size)
    parts = ((0, extent), (p.starts[1], image(*p.size(1))), (p.starts[2], p.rest))
    return tuple(gathered(g, apply("excerpt", rows, first=first, extent=of), entries, 8 * uv.extent.count) for first, of in parts)


def _footprint_infer(name, inputs, attrs):
    uv, lod, covered = inputs
    if uv.vtype != "vec2" or lod.vtype != "float" or covered.vtype != "int":
        raise GraphError(f"{name}: vec2 coordinates, a float and an int mask are needed, got {uv!r}, {lod!r}, {covered!r}")
    wraps_of(name, attrs["wrap"])
    texels = uv.extent.width * uv.extent.height
    if texels > MAX_PIXELS:
        raise GraphError(f"{name}: {uv!r} has {texels} pixels; {MAX_PIXELS} are allowed")
    return "vec4", table(2 * texels)


def _footprint_ref(uv, lod, covered, width, height, across, wrap):
    p = Pyramid(width, height)
    level, t = split_lod(lod, p.last)
    out = np.tile([-1.0, 0.0, 0.0, 0.0], (*covered.shape[:2], 2, 1))
    for k in range(p.last + 1):
        xs, ys, fx, fy = bilinear(uv, p, k, wrap)
        number = p.starts[k] + ys[..., :1] * p.size(k)[0] + xs[..., :1]
        f = [np.where(x[..., :1] == x[..., 1:], 0, s) if p.size(k)[axis] > 1 or wrap[axis] == "clamp" else s
             for axis, (x, s) in enumerate(((xs, fx), (ys, fy)))]
        found = np.concatenate([number % across, number // across, *f], 2)
        for j in (0, 1):
            here = (level + j == k) & (covered != 0) & ((j == 0) | (t > 0))
            out[:, :, j] = np.where(here, found, out[:, :, j])
    flat, e = out.reshape(-1, 4), table(2 * covered.size)
    filled = np.tile([-1.0, 0.0, 0.0, 0.0], (e.width * e.height, 1))
    filled[:len(flat)] = flat
    return filled.reshape(e.height, e.width, 4)


def _footprint_glsl(node: Node) -> str:
    p, wrap, uv = Pyramid(node.attrs["width"], node.attrs["height"]), node.attrs["wrap"], node.inputs[0].extent
    none = " ".join(f"if (lo_.{c} == hi_.{c}) s_.{c} = 0.0;" for c, w in zip("xy", wrap) if w == "clamp")
    return f"""{{ {{y}} = vec4(-1.0, 0.0, 0.0, 0.0); int g_ = min({{i}} >> 1, {uv.width * uv.height - 1}), j_ = {{i}} & 1;
    float d_ = clamp({{lod_at}}(g_), 0.0, {float(p.last)}), f_ = min(floor(d_), {float(p.last - 1)}); int m_ = int(f_) + j_; f_ = d_ - f_;
    if ({{i}} >> 1 == g_ && {{covered_at}}(g_) != 0 && (j_ == 0 || f_ > 0.0)) {{ {p.glsl}
    {wrapped(wrap).replace("{uv}", "{uv_at}(g_)")} ivec2 z_ = (ivec2({{width}}, {{height}}) + (1 << m_) - 1) >> m_;
    {texels_of(wrap)} {none}
    int q_ = o_[m_] + lo_.y * z_.x + lo_.x;
    {{y}} = vec4(q_ % {{across}}, q_ / {{across}}, s_); }} }}"""


def _pixels(rng):
    return [rng.uniform(-0.6, 1.6, (6, 5, 2)), rng.uniform(-0.5, 4.5, (6, 5, 1)), rng.integers(0, 2, (6, 5, 1))]


_SIZE = {"width": 13, "height": 6}
op("mip_footprint", "uv lod covered", alike=((1, 0), (2, 0)), attrs="width height across wrap", infer=_footprint_infer,
   reads="texel texel texel", cost=60, ref=_footprint_ref, glsl=_footprint_glsl,
   sample=lambda rng: (_pixels(rng), {**_SIZE, "across": 13, "wrap": ("repeat", "clamp")}),
   doc="Of both bilinear reads of each pixel: the number of the lower texel among all levels, as column and row of an image `across` "
       "wide, and the fractions towards the next, which wraps within its level; column -1 where nothing is read.")


# ---- lists

def _rows_ref(bins, width, height):
    p, flat = Pyramid(width, height), bins.reshape(-1, 2)
    counts = np.zeros(len(flat), np.int64)
    for level in range(p.last + 1):
        n = p.texels(flat[:, 1:] - flat[:, :1], level)[..., 0]
        n = n + np.roll(n, 1, 1)
        p.texels(counts[:, None], level)[..., 0] = n + np.roll(n, 1, 0)
    ends = np.cumsum(counts)
    return np.stack([ends - counts, ends], 1).reshape(bins.shape)


def _rows_glsl(node: Node) -> str:
    total = Pyramid(node.attrs["width"], node.attrs["height"]).starts[-1]
    return "{ int q_ = {i}; " + found(node) + f""" int at_ = o_[m_];
    if (q_ >= {total}) {{y}} = ivec2(4 * {{bins_at}}({total - 1}).y); else {{
    int x_ = a_.x, y_ = a_.y, r_ = z_.x - 1, b_ = z_.y - 1, l_ = x_ == 0 ? r_ : x_ - 1, u_ = y_ == 0 ? b_ : y_ - 1;
    ivec2 own_ = {{bins_at}}(q_), left_ = {{bins_at}}(at_ + y_ * z_.x + l_), above_ = {{bins_at}}(at_ + u_ * z_.x + x_),
          corner_ = {{bins_at}}(at_ + u_ * z_.x + l_), right_ = {{bins_at}}(at_ + y_ * z_.x + r_), end_ = {{bins_at}}(at_ + u_ * z_.x + r_);
    int first_ = {{bins_at}}(at_).x, begin_ = {{bins_at}}(at_ + u_ * z_.x).x,
        last_ = {{bins_at}}(at_ + b_ * z_.x + r_).y - {{bins_at}}(at_ + b_ * z_.x).x;
    int s_ = own_.x + (x_ == 0 ? own_.x : right_.y - right_.x + left_.x) + (y_ == 0 ? above_.x - begin_ + first_ : last_ + above_.x)
           + (y_ == 0 ? first_ : last_ + begin_) + (x_ == 0 ? 0 : end_.y - end_.x + corner_.x - begin_);
    {{y}} = ivec2(s_, s_ + own_.y - own_.x + left_.y - left_.x + above_.y - above_.x + corner_.y - corner_.x); }} }}"""


def _chain(rng):
    """What each op of the chain makes of random pixels."""
    from .texture_gradient import _bins_ref, _keys_ref, _merge_ref
    p = Pyramid(**_SIZE)
    uv, lod, covered = _pixels(rng)
    e = _places(p)
    footprint = _footprint_ref(uv, lod, covered, across=e.width, wrap=("repeat", "clamp"), **_SIZE)
    ordered = _merge_ref(_keys_ref(footprint, e.width, 60), np.array([[[64]]]))
    bins = _bins_ref(ordered, e)
    return _rows_ref(bins, **_SIZE), bins, ordered, footprint, lod


op("mip_rows", "bins", attrs="width height", infer=lambda name, inputs, attrs: ("ivec2", inputs[0].extent), reads="texel", cost=120,
   ref=_rows_ref, glsl=_rows_glsl, sample=lambda rng: ([_chain(rng)[1]], dict(_SIZE)),
   doc="Begin and end of the entries of each texel of all levels in the list of four entries a read.")


def _list_ref(rows, bins, ordered, footprint, lod, width, height):
    p = Pyramid(width, height)
    e = table(8 * lod.size)
    out = np.zeros((e.width * e.height, 2))
    reads, f, t = ordered[..., 1].ravel(), footprint.reshape(-1, 4)[:, 2:], split_lod(lod, p.last)[1].ravel()
    flat = bins.reshape(-1, 2)
    for number, (k, _) in enumerate(rows.reshape(-1, 2)[:p.starts[-1]]):
        level, x, y = (int(v) for v in p.find(np.array(number)))
        w, h = p.size(level)
        for corner in range(4):
            i, j = corner & 1, corner >> 1
            r = reads[slice(*flat[p.starts[level] + (y - j) % h * w + (x - i) % w])]
            weight = (f[r, 0] if i else 1 - f[r, 0]) * (f[r, 1] if j else 1 - f[r, 1]) * np.where(r & 1, t[r >> 1], 1 - t[r >> 1])
            out[k:k + len(r)] = np.stack([r >> 1, weight], 1)
            k += len(r)
    return out.reshape(e.height, e.width, 2)


def _list_glsl(node: Node) -> str:
    last = Pyramid(node.attrs["width"], node.attrs["height"]).last
    return "{ int low_ = 0, high_ = {rows_w} * {rows_h};\n" + """
    while (low_ < high_) { int n_ = (low_ + high_) >> 1; if ({rows_at}(n_).x <= {i}) low_ = n_ + 1; else high_ = n_; }
    ivec2 r_ = {rows_at}(low_ - 1);
    {y} = vec2(0.0);
    if ({i} < r_.y) { int q_ = low_ - 1; """ + found(node) + f"""
        int j_ = {{i}} - r_.x, corner_ = 0;
        ivec2 b_ = {{bins_at}}(q_);
        while (j_ >= b_.y - b_.x && corner_ < 3) {{
            j_ -= b_.y - b_.x;
            ++corner_;
            b_ = {{bins_at}}(o_[m_] + (corner_ < 2 ? a_.y : a_.y == 0 ? z_.y - 1 : a_.y - 1) * z_.x
                           + ((corner_ & 1) == 0 ? a_.x : a_.x == 0 ? z_.x - 1 : a_.x - 1));
        }}
        int k_ = {{ordered_at}}(b_.x + j_).y;
        vec2 f_ = {{footprint_at}}(k_).zw;
        float d_ = clamp({{lod_at}}(k_ >> 1), 0.0, {float(last)}), t_ = d_ - min(floor(d_), {float(last - 1)});
        {{y}} = vec2(k_ >> 1, ((corner_ & 1) == 0 ? 1.0 - f_.x : f_.x) * (corner_ < 2 ? 1.0 - f_.y : f_.y)
                              * ((k_ & 1) == 0 ? 1.0 - t_ : t_));
    }} }}"""


def _list_infer(name, inputs, attrs):
    rows, bins, ordered, footprint, lod = inputs
    if rows.extent != bins.extent or footprint.extent != table(2 * lod.extent.width * lod.extent.height):
        raise GraphError(f"{name}: rows {rows!r} and bins {bins!r} of one extent, and two reads a pixel of {lod!r} are needed, got "
                         f"{footprint!r}")
    return "vec2", table(8 * lod.extent.width * lod.extent.height)


op("mip_list", "rows bins ordered footprint lod", alone=True, attrs="width height", reads="texel texel texel texel texel", cost=300,
   ref=_list_ref, infer=_list_infer, glsl=_list_glsl, sample=lambda rng: (list(_chain(rng)), dict(_SIZE)),
   doc="(pixel, weight) of each texel's reads, texel by texel of all levels: own bin, left, above, above to the left.")


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
