"""Trilinear samples at coordinates that rest, of a texture that is optimized: the texels that pixels read, level by level, in one list.

    texture, half, rest -> list of touched texels (`mip_lists.reads_of`) -> sample by places in it, which are found once

`sample_levels` reads up to three images, and a group of pixels that lie in several levels reads all of them; a list is read alone, and
where in it a pixel reads needs no arithmetic. The bits are those of `sample_levels`. A pixel that reads nothing reads the
first texel of the list, which costs less than a loop of no turn.
"""
from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ....cache.errors import GraphError
from ..ir import Node
from ..optable import apply, common_extent, op
from .mip_lists import SIZE, Chain, Reads, numbered, over, reads_of
from .mip_pyramid import Pyramid, found
from .mips import MIXED, bilinear, levels_ref, mixed, split_lod, texels_of, wrapped, wraps_of


def still(node: Node) -> Node:
    """A `sample_levels` by a list."""
    texture, half, rest, uv, lod, covered = node.inputs
    uv, lod, covered = over(node.extent, uv, lod, covered)
    p, wrap = Pyramid(texture.extent.width, texture.extent.height), node.attrs["wrap"]
    sample, = by_list((texture, half, rest), [uv], lod, covered, wrap, reads_of(p, uv, lod, covered, wrap))
    return sample


def by_list(levels: Sequence[Node], at: Sequence[Node], lod: Node, covered: Node, wrap: tuple[str, str], reads: Reads) -> list[Node]:
    """Samples at these coordinates of a texture, its half and its rest, by a list of what they read."""
    extent = levels[0].extent
    size = {"width": extent.width, "height": extent.height}
    entries = apply("mip_texels", apply("mip_where", reads.touched.entries, **size), *levels)
    slots, last = reads.touched.slots, Pyramid(**size).last
    return [apply("sample_touched", entries,
                  *(apply("mip_places", slots, uv, lod, covered, second=k, wrap=wrap, **size) for k in (0, 1)),
                  apply("mip_fractions", uv, lod, wrap=wrap, **size), lod, last=last) for uv in at]


def _where_ref(entries, width, height):
    p = Pyramid(width, height)
    level, x, y = p.find(np.clip(entries[..., 0], 0, p.starts[-1] - 1))
    return np.stack([x, y + np.array([0, 0, *map(p.row, range(2, p.last + 1))])[level], level], -1)


def _where_glsl(node: Node) -> str:
    p = Pyramid(node.attrs["width"], node.attrs["height"])
    return f"{{ int q_ = clamp({{entries}}, 0, {p.starts[-1] - 1}); " + found(node) \
        + f" {{y}} = ivec3(a_.x, a_.y + (m_ < 2 ? 0 : {p.row_glsl}), m_); }}"


op("mip_where", "entries", attrs="width height", cost=40, ref=_where_ref, infer=lambda name, inputs, attrs: ("ivec3", inputs[0].extent),
   glsl=_where_glsl,
   sample=lambda rng: ([Chain(rng).texels], dict(SIZE)),
   doc="Of each texel of a list the column and row in the image that it lies in, and its level: the texture 0, its half 1, the rest.")


def _texels_ref(where, texture, half, rest):
    x, y, level = np.moveaxis(where, -1, 0)
    out = np.zeros((*level.shape, texture.shape[2]))
    for image, inside in ((texture, level == 0), (half, level == 1), (rest, level > 1)):
        out[inside] = image[y[inside], x[inside]]
    return out


def _texels_infer(name, inputs, attrs):
    if inputs[0].vtype != "ivec3" or len({x.vtype for x in inputs[1:]}) != 1:
        raise GraphError(f"{name}: places as ivec3 and images of one type are needed, got {', '.join(map(repr, inputs))}")
    return inputs[1].vtype, inputs[0].extent


op("mip_texels", "where texture half rest", attrs="", reads="own texel texel texel", cost=60, ref=_texels_ref, infer=_texels_infer,
   glsl="""{ ivec3 w_ = {where}; ivec2 at_ = w_.xy, no_ = ivec2(0); int m_ = w_.z;
    {type} t_ = {texture}(m_ < 1 ? at_ : no_), h_ = {half}(m_ == 1 ? at_ : no_), r_ = {rest}(m_ > 1 ? at_ : no_);
    {y} = m_ < 1 ? t_ : m_ == 1 ? h_ : r_; }""",
   sample=lambda rng: ((lambda t: [_where_ref(Chain(rng).texels, **SIZE), t, *levels_ref(t)])(rng.normal(size=(6, 13, 3))), {}),
   doc="The listed texels of a texture, its half and its rest.")


def _of_one(p: Pyramid, lod, second):
    """Of each pixel the level of its first or second read, and how far it goes to the second."""
    level, t = split_lod(lod, p.last)
    return level + second, t


def _places_ref(slots, uv, lod, covered, width, height, second, wrap):
    p = Pyramid(width, height)
    level, t = _of_one(p, lod, second)
    out, flat = np.full((1, 1, 4), -1), slots.reshape(-1)
    for k in range(p.last + 1):
        xs, ys, _, _ = bilinear(uv, p, k, wrap)
        q = p.starts[k] + np.stack([ys[..., j] * p.size(k)[0] + xs[..., i] for j in (0, 1) for i in (0, 1)], -1)
        out = np.where((level == k) & (covered != 0) & ((second == 0) | (t > 0)), flat[q], out)
    return out


def _level_glsl(node: Node, second: int) -> str:
    p = Pyramid(node.attrs["width"], node.attrs["height"])
    text = f"""{wrapped(node.attrs["wrap"])}
    float d_ = clamp({{lod}}, 0.0, {float(p.last)}), f_ = min(floor(d_), {float(p.last - 1)}); int m_ = int(f_) + {second}; f_ = d_ - f_;
    ivec2 z_ = (ivec2({{width}}, {{height}}) + (1 << m_) - 1) >> m_;
    {texels_of(node.attrs["wrap"])}"""
    return text


def _places_infer(name, inputs, attrs):
    wraps_of(name, attrs["wrap"])
    p = Pyramid(attrs["width"], attrs["height"])
    if inputs[0].vtype != "int" or inputs[0].extent != numbered(p) or inputs[1].vtype != "vec2":
        raise GraphError(f"{name}: an int for each texel of {p.width}x{p.height} and its levels and vec2 coordinates are needed, got "
                         f"{inputs[0]!r} and {inputs[1]!r}")
    return "ivec4", common_extent(name, inputs[1:])


def _places_glsl(node: Node) -> str:
    p, second = Pyramid(node.attrs["width"], node.attrs["height"]), node.attrs["second"]
    at = ", ".join(f"{{slots_at}}(o_[m_] + {y}_.y * z_.x + {x}_.x)" for y in ("lo", "hi") for x in ("lo", "hi"))
    none = " || f_ <= 0.0" if second else ""
    return f"{{ {p.glsl} {_level_glsl(node, second)}\n    {{y}} = ivec4({at}); if ({{covered}} == 0{none}) {{y}} = ivec4(-1); }}"


def _pixels(rng):
    c = Chain(rng)
    return [c.slots, c.uv, c.lod, c.covered], {**SIZE, "wrap": ("repeat", "clamp")}


op("mip_places", "slots uv lod covered", attrs="width height second wrap", reads="texel own own own", cost=80, ref=_places_ref,
   infer=_places_infer, glsl=_places_glsl, sample=lambda rng: (lambda x, a: (x, {**a, "second": 1}))(*_pixels(rng)),
   doc="Where the four texels of a pixel's first or second read stand in a list, of which `slots` has the places; -1 where it reads none.")


def _fractions_ref(uv, lod, width, height, wrap):
    p, out = Pyramid(width, height), 0
    for second in (0, 1):
        level = _of_one(p, lod, second)[0]
        for k in range(p.last + 1):
            _, _, fx, fy = bilinear(uv, p, k, wrap)
            four = np.concatenate([fx, fy, fx * 0, fy * 0], 2)
            out = out + np.where(level == k, np.roll(four, 2 * second, 2), 0)
    return out


op("mip_fractions", "uv lod", attrs="width height wrap", cost=60, ref=_fractions_ref,
   infer=lambda name, inputs, attrs: ("vec4", common_extent(name, inputs)),
   glsl=lambda node: "{ " + _level_glsl(node, 0) + " {y}.xy = s_; }\n{ " + _level_glsl(node, 1) + " {y}.zw = s_; }",
   sample=lambda rng: (lambda x, a: (x[1:3], a))(*_pixels(rng)),
   doc="The fractions of a pixel's first and second bilinear read towards the further column and row.")


def _touched_ref(entries, near, far, fractions, lod, last):
    flat, t = entries.reshape(-1, entries.shape[2]), split_lod(lod, last)[1]
    total = 0
    for places, k, weight in ((near, 0, 1 - t), (far, 2, t)):
        texels = [np.where(places[..., c:c + 1] >= 0, flat[np.maximum(places[..., c], 0)], 0) for c in range(4)]
        total = total + weight * mixed((texels[:2], texels[2:]), fractions[..., k:k + 1], fractions[..., k + 1:k + 2])
    return total


def _touched_infer(name, inputs, attrs):
    if [x.vtype for x in inputs[1:]] != ["ivec4", "ivec4", "vec4", "float"]:
        raise GraphError(f"{name}: places as ivec4, fractions as vec4 and a float are needed, got {', '.join(map(repr, inputs[1:]))}")
    return inputs[0].vtype, common_extent(name, inputs[1:])


_READ = "; ".join(f"t{k}_ = {{entries_at}}(max(p_.{c}, 0))" for k, c in (("00", "x"), ("10", "y"), ("01", "z"), ("11", "w")))
op("sample_touched", "entries near far fractions lod", attrs="last", reads="texel own own own own", cost=80, ref=_touched_ref,
   infer=_touched_infer,
   glsl=lambda node: f"""{{ float w_ = clamp({{lod}}, 0.0, {float(node.attrs["last"])});
    w_ -= min(floor(w_), {float(node.attrs["last"] - 1)});
    {{type}} t00_, t10_, t01_, t11_; ivec4 p_ = {{near}}; vec4 f_ = {{fractions}}; vec2 s_ = f_.xy;
    {_READ}; {{y}} = p_.x >= 0 ? (1.0 - w_) * {MIXED} : {{type}}(0);
    p_ = {{far}}; s_ = f_.zw; {_READ}; {{y}} = p_.x >= 0 ? {{y}} + w_ * {MIXED} : {{y}}; }}""",
   sample=lambda rng: ([rng.normal(size=(4, 6, 3)), rng.integers(0, 24, (6, 5, 4)) * (s := rng.integers(0, 2, (6, 5, 1))) + s - 1,
                        rng.integers(0, 24, (6, 5, 4)), rng.uniform(size=(6, 5, 4)), rng.uniform(-0.5, 4.5, (6, 5, 1))], {"last": 4}),
   doc="sample_levels of texels that stand in a list, by places, fractions and the level of detail.")
