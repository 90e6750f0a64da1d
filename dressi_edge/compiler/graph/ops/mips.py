"""Mip maps: the levels of a texture (`mip_pyramid.py`), and the trilinear sample between two of them.

A sample at level of detail d reads level floor(d) and, unless d is whole, the next, each bilinearly. Of a texture that is magnified
(d <= 0) it is the bilinear sample to the bit. The transpose is in `mip_gradient.py`; of coordinates that rest `mip_still.py` samples.
"""
from __future__ import annotations

import numpy as np

from ....cache.errors import GraphError
from ..ir import Node, image
from ..optable import apply, common_extent, flag, op
from .mip_pyramid import LEAST, Pyramid, mean
from .texture import WRAPS

COARSE = 4  # the level of which all further ones are made: what few texels are made of is read by few


# ---- levels

def _mean_glsl(p: Pyramid, x: str, above: int, level: str, at: str) -> str:
    """GLSL that adds to {y} the mean of what texel `at` of `level`, an int, stands for of x, which is level `above`."""
    w, h = p.size(above)
    head = f"int d_ = {level} - {above}; ivec2 f_ = {at} << d_, l_ = min(f_ + (1 << d_), ivec2({w}, {h}));\n" \
           "    for (int b_ = f_.y; b_ < l_.y; ++b_) for (int c_ = f_.x; c_ < l_.x; ++c_) "
    if p.even or above == 0:
        return head + f"{{y}} += {x}(ivec2(c_, b_));\n    {{y}} /= float((l_.x - f_.x) * (l_.y - f_.y));"
    each = " * ".join(f"min({1 << above}, {n} - (({k}) << {above}))" for n, k in ((p.width, "c_"), (p.height, "b_")))
    return "float n_ = 0.0; " + head + f"{{ float e_ = float({each}); {{y}} += e_ * {x}(ivec2(c_, b_)); n_ += e_; }}\n    {{y}} /= n_;"


def _means_infer(name, inputs, attrs):
    p, above, level = Pyramid(attrs["width"], attrs["height"]), attrs["above"], attrs["level"]
    if not 0 <= above < level <= p.last or inputs[0].extent != image(*p.size(above)):
        raise GraphError(f"{name}: {inputs[0]!r} is not level {above} of {p.width}x{p.height}, or there is no level {level} below it")
    return inputs[0].vtype, image(*p.size(level))


def _means_glsl(node: Node) -> str:
    p, above, level = (Pyramid(node.attrs["width"], node.attrs["height"]), node.attrs["above"], node.attrs["level"])
    return "{ {y} = {type}(0); " + _mean_glsl(p, "{x}", above, str(level), "{p}") + " }"


op("mip_means", "x", attrs="width height above level", infer=_means_infer, reads="texel", cost=30, glsl=_means_glsl,
   ref=lambda x, width, height, above, level: mean(Pyramid(width, height), x, above, level),
   sample=lambda rng: ([rng.normal(size=(5, 10, 3))], {"width": 20, "height": 9, "above": 1, "level": 3}),
   doc="A mip level of a texture of width x height, from a finer level.")


def _rest_ref(two, coarse, width, height):
    p = Pyramid(width, height)
    out, base = np.zeros((p.rest.height, p.rest.width, two.shape[2])), min(COARSE, p.last)
    for level in range(2, p.last + 1):
        above, x = (2, two) if level < base or level == 2 else (base, coarse)
        p.part(out, level)[:] = x if level == above else mean(p, x, above, level)
    return out


def _rest_infer(name, inputs, attrs):
    p = Pyramid(attrs["width"], attrs["height"])
    for x, level in zip(inputs, (2, min(COARSE, p.last))):
        if x.extent != image(*p.size(level)) or x.vtype != inputs[0].vtype:
            raise GraphError(f"{name}: {x!r} is not level {level} of {p.width}x{p.height}: {image(*p.size(level))} is")
    return inputs[0].vtype, p.rest


def _rest_glsl(node: Node) -> str:
    """Loops of one turn or none, which every driver skips where there is nothing to do."""
    p = Pyramid(node.attrs["width"], node.attrs["height"])
    base = min(COARSE, p.last)
    later = "".join(f" if (a_.y >= {p.row(k)}) {{ m_ = {k}; r_ = {p.row(k)}; }}" for k in range(3, p.last + 1))
    lines = ["int m_ = 2, r_ = 0; ivec2 a_ = {p}; {y} = {type}(0);" + later + " a_.y -= r_;",
             f"ivec2 z_ = (ivec2({p.width}, {p.height}) + (1 << m_) - 1) >> m_;",
             "int k_ = a_.x < z_.x && a_.y < z_.y ? m_ : 0;",
             "for (int q_ = k_; q_ == 2; ++q_) {y} = {two}(a_);"]
    if base > 3:
        lines.append(f"for (int q_ = k_; q_ == 3; ++q_) {{ {_mean_glsl(p, '{two}', 2, '3', 'a_')} }}")
    if base > 2:
        lines.append(f"for (int q_ = k_; q_ == {base}; ++q_) {{y}} = {{coarse}}(a_);")
    if p.last > base:
        lines.append(f"for (int q_ = k_; q_ > {base}; q_ = 0) {{ {_mean_glsl(p, '{coarse}', base, 'm_', 'a_')} }}")
    return "{ " + "\n    ".join(lines) + " }"


def _rest_sample(rng):
    p = Pyramid(75, 33)
    return [rng.normal(size=(*p.size(k)[::-1], 3)) for k in (2, 4)], {"width": 75, "height": 33}


op("mip_rest", "two coarse", attrs="width height", infer=_rest_infer, reads="texel texel", cost=60, ref=_rest_ref, glsl=_rest_glsl,
   sample=_rest_sample, doc=f"All mip levels from 2 on in one image, of levels 2 and {COARSE}.")


def levels(texture: Node) -> tuple[Node, Node]:
    """The half and the rest of a texture. Raises GraphError where it is too small to have them."""
    p, size = Pyramid(texture.extent.width, texture.extent.height), {"width": texture.extent.width, "height": texture.extent.height}
    half = apply("mip_means", texture, above=0, level=1, **size)
    two = apply("mip_means", half, above=1, level=2, **size)
    coarse = two if p.last == 2 else apply("mip_means", two, above=2, level=min(COARSE, p.last), **size)
    return half, apply("mip_rest", two, coarse, **size)


# ---- sampling

def wraps_of(name: str, wrap) -> None:
    """Raises GraphError unless wrap is one for each axis."""
    if not isinstance(wrap, tuple) or len(wrap) != 2 or not set(wrap) <= set(WRAPS):
        raise GraphError(f"{name}: wrap {wrap!r:.60}; {' or '.join(WRAPS)} for u and for v are allowed")


def split_lod(lod: np.ndarray, last: int) -> tuple[np.ndarray, np.ndarray]:
    """The level that a sample begins at, and how far it goes to the next."""
    lod = np.clip(lod, 0, last)
    level = np.minimum(np.floor(lod), last - 1).astype(np.int64)
    return level, lod - level


def bilinear(uv: np.ndarray, p: Pyramid, level: int, wrap: tuple[str, str]):
    """Of a level: the texels (h, w, 2) of a bilinear read by column and by row, and fractions (h, w, 1)."""
    out = []
    for axis in (0, 1):
        u, n, size = uv[..., axis], p.size(level)[axis], (p.width, p.height)[axis]
        u = u - np.floor(u) if wrap[axis] == "repeat" else u
        s = u * size / (1 << level) - 0.5
        base = np.floor(s)
        k = np.clip(base, -1, n).astype(np.int64)
        if wrap[axis] == "repeat":
            low = np.where(k < 0, n - 1, np.minimum(k, n - 1))
            high = np.where(low + 1 == n, 0, low + 1)
        else:
            low, high = np.clip(k, 0, n - 1), np.clip(k + 1, 0, n - 1)
        out.append((np.stack([low, high], -1), (s - base)[..., None]))
    (xs, fx), (ys, fy) = out
    return xs, ys, fx, fy


def _of_levels(texture, half, rest, uv, lod, wrap):
    """(weight, side, four texels, fx, fy, level) over all pixels, level by level; side: -1 where it is a pixel's first, 1 its second."""
    p = Pyramid(texture.shape[1], texture.shape[0])
    uv, lod = np.broadcast_arrays(uv, lod)[0], np.broadcast_arrays(lod, uv[..., :1])[0]
    start, t = split_lod(lod, p.last)
    for level in range(p.last + 1):
        texels = p.part(rest, level) if level > 1 else half if level else texture
        xs, ys, fx, fy = bilinear(uv, p, level, wrap)
        four = [[texels[ys[..., j], xs[..., i]] for i in (0, 1)] for j in (0, 1)]
        first, second = start == level, start + 1 == level
        yield np.where(first, 1 - t, 0) + np.where(second, t, 0), second * 1 - first, four, fx, fy, level


def mixed(four, fx, fy):
    (t00, t10), (t01, t11) = four
    return (t00 * (1 - fx) + t10 * fx) * (1 - fy) + (t01 * (1 - fx) + t11 * fx) * fy


def sample_ref(texture, half, rest, uv, lod, covered, wrap):
    y = sum(weight * mixed(four, fx, fy) for weight, _, four, fx, fy, _ in _of_levels(texture, half, rest, uv, lod, wrap))
    return np.where(covered != 0, y, 0)


def levels_ref(texture):
    p = Pyramid(texture.shape[1], texture.shape[0])
    rest = np.zeros((p.rest.height, p.rest.width, texture.shape[2]))
    for level in range(2, p.last + 1):
        p.part(rest, level)[:] = mean(p, texture, 0, level)
    return mean(p, texture, 0, 1), rest


def _slopes_ref(texture, half, rest, uv, lod, g, wrap):
    h, w, _ = texture.shape
    last = Pyramid(w, h).last
    total, inside = 0, (lod > 0) & (lod < last)
    for weight, side, four, fx, fy, level in _of_levels(texture, half, rest, uv, lod, wrap):
        (t00, t10), (t01, t11) = four
        du = ((t10 - t00) * (1 - fy) + (t11 - t01) * fy) * (w / (1 << level))
        dv = ((t01 - t00) * (1 - fx) + (t11 - t10) * fx) * (h / (1 << level))
        by = [weight * du, weight * dv, np.where(inside, side, 0) * mixed(four, fx, fy)]
        total = total + np.concatenate([(g * x).sum(2, keepdims=True) for x in by], 2)
    return total


def infer(name, inputs, attrs):
    texture, uv, lod = inputs[0], *inputs[-3:-1]
    if max(texture.extent.width, texture.extent.height) < LEAST:
        raise GraphError(f"{name}: mip levels of {texture!r}, {texture.extent}; at least {LEAST} texels on one side are needed")
    if uv.vtype != "vec2" or lod.vtype != "float":
        raise GraphError(f"{name}: vec2 coordinates and a float level of detail are needed, got {uv!r} and {lod!r}")
    wraps_of(name, attrs["wrap"])
    return texture.vtype, common_extent(name, inputs[-3:])


def levels_infer(name, inputs, attrs):
    found, (texture, half, rest, *_) = infer(name, inputs, attrs), inputs
    p = Pyramid(texture.extent.width, texture.extent.height)
    if (half.extent, rest.extent) != (image(*p.size(1)), p.rest) or {half.vtype, rest.vtype} != {texture.vtype}:
        raise GraphError(f"{name}: {half!r} and {rest!r} are not the levels of {texture!r}; levels() makes them")
    return found


def wrapped(wrap: tuple[str, str]) -> str:
    """GLSL: r_, the coordinates, those that repeat within [0, 1]."""
    return "vec2 r_ = {uv}; " + " ".join(f"r_.{c} -= floor(r_.{c});" for c, w in zip("xy", wrap) if w == "repeat")


def texels_of(wrap: tuple[str, str]) -> str:
    """GLSL: of level m_, of size z_, the texels lo_ and hi_ of a bilinear read at r_, and fractions s_."""
    lines = ["vec2 s_ = r_ * vec2({width}, {height}) * (1.0 / float(1 << m_)) - 0.5, b_ = floor(s_); s_ -= b_;",
             "ivec2 k_ = ivec2(clamp(b_, vec2(-1.0), vec2(z_))), lo_ = clamp(k_, ivec2(0), z_ - 1), hi_ = clamp(k_ + 1, ivec2(0), z_ - 1);"]
    for c, w in zip("xy", wrap):
        if w == "repeat":
            lines.append(f"if (k_.{c} < 0) lo_.{c} = z_.{c} - 1; hi_.{c} = lo_.{c} + 1 == z_.{c} ? 0 : lo_.{c} + 1;")
    return "\n    ".join(lines)


def _turns(node: Node, left_out: str, body: str) -> str:
    """GLSL that does `body` for both levels m_ of a sample with their weights w_, with the four texels t00_ to t11_ of each; SIDE in it
    is -1 in the first and 1 in the second. What a group of pixels has nothing of is left out by loops of no turns, which every driver
    skips: the texture where it is minified, the second level where it is not, all where `left_out`, a condition or "", says so."""
    skip = (lambda n: f"{left_out} ? {n} : ") if left_out else (lambda n: "")
    texture = node.inputs[0]
    p, kind = Pyramid(texture.extent.width, texture.extent.height), texture.vtype
    at = ("lo_", "ivec2(hi_.x, lo_.y)", "ivec2(lo_.x, hi_.y)", "hi_")
    fetch = {x: " ".join(f"{t} = {{{x}}}({place}{below});" for t, place in zip(("t00_", "t10_", "t01_", "t11_"), at))
             for x, below in (("texture", ""), ("half", ""), ("rest", " + e_"))}
    place = f"ivec2 z_ = (ivec2({{width}}, {{height}}) + (1 << m_) - 1) >> m_, e_ = ivec2(0, {p.row_glsl});\n    " \
            f"{texels_of(node.attrs['wrap'])}\n    {kind} t00_ = {kind}(0), t10_ = t00_, t01_ = t00_, t11_ = t00_;"
    text = f"""{wrapped(node.attrs["wrap"])}
    float d_ = clamp({{lod}}, 0.0, {float(p.last)}), f_ = min(floor(d_), {float(p.last - 1)}); int first_ = int(f_); f_ = d_ - f_;
    {{ int m_ = first_; float w_ = 1.0 - f_; {place}
    for (int q_ = {skip(1)}m_; q_ < 1; ++q_) {{ {fetch['texture']} }}
    for (int q_ = {skip(0)}m_; q_ == 1; ++q_) {{ {fetch['half']} }}
    for (int q_ = {skip(0)}m_; q_ > 1; q_ = 0) {{ {fetch['rest']} }}
    {body.replace('SIDE', '-1.0')} }}
    for (int j_ = {skip(1)}f_ > 0.0 ? 0 : 1; j_ < 1; ++j_) {{ int m_ = first_ + 1; float w_ = f_; {place}
    for (int q_ = m_; q_ == 1; ++q_) {{ {fetch['half']} }}
    for (int q_ = m_; q_ > 1; q_ = 0) {{ {fetch['rest']} }}
    {body.replace('SIDE', '1.0')} }}"""
    return text.replace("{width}", str(p.width)).replace("{height}", str(p.height))


MIXED = "mix(mix(t00_, t10_, s_.x), mix(t01_, t11_, s_.x), s_.y)"


def sample_glsl(node: Node, y: str = "{y}") -> str:
    """GLSL of a sample at {uv}, into the variable y."""
    return f"{{ {y} = {{type}}(0); " + _turns(node, "{covered} == 0", f"{y} += w_ * {MIXED};") + " }"


def _slopes_glsl(node: Node) -> str:
    product = (lambda x: f"dot({{g}}, {x})") if node.inputs[0].channels > 1 else (lambda x: f"({{g}} * ({x}))")
    p = Pyramid(node.inputs[0].extent.width, node.inputs[0].extent.height)
    body = f"""vec2 u_ = vec2({p.width}, {p.height}) * (w_ / float(1 << m_));
    {{y}} += vec3({product("mix(t10_ - t00_, t11_ - t01_, s_.y)")} * u_.x, {product("mix(t01_ - t00_, t11_ - t10_, s_.x)")} * u_.y,
    {product(MIXED)} * (in_ ? SIDE : 0.0));"""
    return f"{{ {{y}} = vec3(0.0); bool in_ = {{lod}} > 0.0 && {{lod}} < {float(p.last)}; " + _turns(node, "", body) + " }"


def _sample_vjp(g, y, texture, uv, lod, covered, wrap):
    from .mip_gradient import transpose
    inside = apply("select", covered, g, 0.0)
    slopes = apply("mip_slopes", texture, *levels(texture), uv, lod, inside, wrap=wrap)
    return (transpose(g, uv, lod, covered, texture.extent, wrap), apply("swizzle", slopes, channels="xy"),
            apply("swizzle", slopes, channels="z"), None)


def _still(node: Node) -> Node:
    from .mip_still import still
    return still(node)


def arguments(rng, width=13, height=6):
    texture = rng.normal(size=(height, width, 3))
    return [texture, *levels_ref(texture), rng.uniform(-0.4, 1.4, (6, 5, 2)), rng.uniform(-0.5, 4.5, (6, 5, 1))]


def _covered(arguments, rng):
    return [*arguments, rng.integers(0, 2, (6, 5, 1))], {"wrap": ("repeat", "clamp")}


WHOLE = "its mip levels are means of all its texels"
op("sample_mips", "texture uv lod covered", attrs="wrap", stage="composite", infer=infer, reads="texel own own own", vjp=_sample_vjp,
   ref=lambda texture, uv, lod, covered, wrap: sample_ref(texture, *levels_ref(texture), uv, lod, covered, wrap),
   lower=lambda texture, uv, lod, covered, wrap, room=None: apply("sample_levels", texture, *levels(texture), uv, lod, covered, wrap=wrap),
   sample=lambda rng: _covered([x for k, x in enumerate(arguments(rng)) if k not in (1, 2)], rng),
   doc="Trilinear sample of a texture at a level of detail, between mip levels that are made of it, where `covered`; zero elsewhere.")
op("sample_levels", "texture half rest uv lod covered", attrs="wrap", infer=levels_infer, reads="texel texel texel own own own", cost=120,
   when=flag(5), dense=WHOLE, still=_still, ref=sample_ref, glsl=sample_glsl, sample=lambda rng: _covered(arguments(rng), rng),
   doc="sample_mips of a texture, its half and its rest.")
op("mip_slopes", "texture half rest uv lod g", attrs="wrap", reads="texel texel texel own own own", cost=140, ref=_slopes_ref,
   glsl=_slopes_glsl, infer=lambda name, inputs, attrs: ("vec3", levels_infer(name, inputs, attrs)[1]),
   size=lambda node, sizes: sizes[0] + sizes[5] + (max(node.inputs[0].extent.width, node.inputs[0].extent.height) - 1).bit_length(),
   sample=lambda rng: ([*arguments(rng), rng.normal(size=(6, 5, 3))], {"wrap": ("clamp", "repeat")}),
   doc="Derivatives of sample_mips by both coordinates and by the level of detail, times g.")


def sample_mips(texture: Node, uv: Node, lod: Node, covered: Node, wrap: tuple[str, str]) -> Node:
    """The trilinear sample of a texture with levels made of it."""
    return apply("sample_mips", texture, uv, lod, covered, wrap=wrap)
