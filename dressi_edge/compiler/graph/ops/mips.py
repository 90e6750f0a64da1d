"""Mip maps: the levels of a texture, and the trilinear sample between two of them.

    level 0: the texture;  level 1: its half, an image;  levels 2 to the last: the rest, one image

Level l has ceil(width / 2^l) x ceil(height / 2^l) texels; the last has one. Texel k of it stands for texels k 2^l to (k + 1) 2^l - 1 of
the texture, or as many of them as there are, and is the mean of the texels of an earlier level that it stands for. Its centre is at
(k + 1/2) 2^l / width, whatever the size. All levels are numbered one after the other, row by row (`Pyramid`): so are the texels of the
rest.

A sample at level of detail d reads level floor(d) and, unless d is whole, the next, each bilinearly. Of a texture that is magnified
(d <= 0) it is the bilinear sample to the bit. The transpose is in `mip_gradient.py`.
"""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ....cache.errors import GraphError
from ..ir import Extent, Node, image
from ..optable import apply, common_extent, flag, op
from .stencil import downsample
from .texture import WRAPS

LEAST = 4  # texels of the longer side of a texture that has a rest
STEPS = 3  # levels that are made at once of the one above them


@dataclass(frozen=True)
class Pyramid:
    """The levels of a texture of width x height texels, at least LEAST on one side. Raises GraphError."""

    width: int
    height: int

    def __post_init__(self) -> None:
        if max(self.width, self.height) < LEAST:
            raise GraphError(f"mip levels of {self.width}x{self.height} texels; at least {LEAST} on one side are needed")

    @property
    def last(self) -> int:
        """The number of the last level, of one texel."""
        return (max(self.width, self.height) - 1).bit_length()

    def size(self, level: int) -> tuple[int, int]:
        """Width and height of a level."""
        return -(-self.width // (1 << level)), -(-self.height // (1 << level))

    @property
    def starts(self) -> list[int]:
        """The number of each level's first texel, and how many texels there are in all."""
        counts = [w * h for w, h in map(self.size, range(self.last + 1))]
        return [0, *np.cumsum(counts).tolist()]

    @property
    def rest(self) -> Extent:
        """Of the image that holds the levels from 2 on."""
        width = self.size(1)[0]
        return image(width, -(-(self.starts[-1] - self.starts[2]) // width))

    def texels(self, flat: np.ndarray, level: int, first: int = 0) -> np.ndarray:
        """The texels (h, w, c) of a level, of a list (n, c) that begins with level `first`."""
        w, h = self.size(level)
        start = self.starts[level] - self.starts[first]
        return flat[start:start + w * h].reshape(h, w, -1)

    def find(self, index: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Level, column and row of numbers; beyond the last level rows go on."""
        level = np.clip(np.searchsorted(self.starts, index, "right") - 1, 0, self.last)
        local = index - np.array(self.starts)[level]
        width = np.array([self.size(k)[0] for k in range(self.last + 1)])[level]
        return level, local % width, local // width

    @property
    def glsl(self) -> str:
        """The number of each level's first texel, o_, and what finds of number q_ its level m_, that level's size z_, and its place a_."""
        return f"const int o_[{self.last + 2}] = int[]({', '.join(map(str, self.starts))});"


FIND = """int m_ = 0;
    while (m_ < {last} && q_ >= o_[m_ + 1]) ++m_;
    ivec2 z_ = (ivec2({width}, {height}) + (1 << m_) - 1) >> m_, a_ = ivec2((q_ - o_[m_]) % z_.x, (q_ - o_[m_]) / z_.x);"""


def found(node: Node) -> str:
    """GLSL that finds number q_ among the levels of a node's texture."""
    p = Pyramid(node.attrs["width"], node.attrs["height"])
    return p.glsl + " " + FIND.replace("{last}", str(p.last))


# ---- levels

def _counts(p: Pyramid, level: int, above: int) -> np.ndarray:
    """(h, w, 1): of each texel of a level, how many of level `above` it stands for."""
    steps = 1 << level - above
    ys, xs = (np.minimum(steps, n - steps * np.arange(m)) for n, m in zip(p.size(above)[::-1], p.size(level)[::-1]))
    return (ys[:, None] * xs)[..., None]


def _blocks(texels: np.ndarray, steps: int) -> np.ndarray:
    """Sums of steps x steps texels, at the far ends of those that are there."""
    h, w, c = texels.shape
    padded = np.pad(texels, ((0, -h % steps), (0, -w % steps), (0, 0)))
    return padded.reshape(padded.shape[0] // steps, steps, -1, steps, c).sum((1, 3))


def _made(p: Pyramid, above: int) -> range:
    """The levels that are made of level `above`."""
    return range(above + 1, min(above + STEPS, p.last) + 1)


def _refine_ref(x, width, height, first, above):
    p, flat = Pyramid(width, height), x.reshape(-1, x.shape[2])
    out = np.zeros((p.rest.width * p.rest.height, x.shape[2]))
    for level in range(2, above + 1):
        p.texels(out, level, 2)[:] = p.texels(flat, level, first)
    for level in _made(p, above):
        p.texels(out, level, 2)[:] = _blocks(p.texels(flat, above, first), 1 << level - above) / _counts(p, level, above)
    return out.reshape(p.rest.height, p.rest.width, -1)


def _refine_glsl(node: Node) -> str:
    p, above, first = Pyramid(node.attrs["width"], node.attrs["height"]), node.attrs["above"], node.attrs["first"]
    w, h = p.size(above)
    kept = f"if (m_ <= {above}) {{y}} = {{x_at}}(q_ - {p.starts[first]}); else " if above >= 2 else ""
    return "{ int q_ = {i} + " + str(p.starts[2]) + "; " + found(node) + " {y} = {type}(0);\n    " + kept + \
        f"if (m_ <= {above + STEPS} && a_.y < z_.y) {{ int d_ = m_ - {above};\n" \
        f"    ivec2 f_ = a_ << d_, l_ = min(f_ + (1 << d_), ivec2({w}, {h}));\n" \
        f"    for (int b_ = f_.y; b_ < l_.y; ++b_) for (int c_ = f_.x; c_ < l_.x; ++c_)" \
        f" {{y}} += {{x_at}}({p.starts[above] - p.starts[first]} + b_ * {w} + c_);\n" \
        "    {y} /= {type}((l_.x - f_.x) * (l_.y - f_.y)); } }"


def _refine_infer(name, inputs, attrs):
    p = Pyramid(attrs["width"], attrs["height"])
    needed = image(*p.size(1)) if attrs["first"] == 1 else p.rest
    if inputs[0].extent != needed:
        raise GraphError(f"{name}: {inputs[0]!r} does not hold the levels of {p.width}x{p.height} from {attrs['first']} on: {needed}")
    return inputs[0].vtype, p.rest


op("mip_refine", "x", attrs="width height first above", infer=_refine_infer, reads="texel", cost=60, ref=_refine_ref, glsl=_refine_glsl,
   vjp=lambda g, y, x, **attrs: (apply("mip_refine_transposed", g, **attrs),),
   sample=lambda rng: ([rng.normal(size=(5, 10, 3))], {"width": 20, "height": 9, "first": 1, "above": 1}),
   doc="Mip levels from 2 on: those to `above` as x has them, and three more, each the mean of the texels of level `above`.")


def _transposed_extent(p: Pyramid, first: int) -> Extent:
    return image(*p.size(1)) if first == 1 else p.rest


def _transposed_ref(g, width, height, first, above):
    p, flat = Pyramid(width, height), g.reshape(-1, g.shape[2])
    e = _transposed_extent(p, first)
    out = np.zeros((e.width * e.height, g.shape[2]))
    for level in range(max(2, first), above + 1):
        p.texels(out, level, first)[:] = p.texels(flat, level, 2)
    w, h = p.size(above)
    for level in _made(p, above):
        each, steps = p.texels(flat, level, 2) / _counts(p, level, above), 1 << level - above
        p.texels(out, above, first)[:] += each.repeat(steps, 0).repeat(steps, 1)[:h, :w]
    return out.reshape(e.height, e.width, -1)


def _transposed_glsl(node: Node) -> str:
    p, above, first = Pyramid(node.attrs["width"], node.attrs["height"]), node.attrs["above"], node.attrs["first"]
    kept = f"if (m_ <= {above}) {{y}} = {{g_at}}(q_ - {p.starts[2]}); " if above >= 2 else ""
    return "{ int q_ = {i} + " + str(p.starts[first]) + "; " + found(node) + " {y} = {type}(0);\n    " + kept + \
        f"if (m_ == {above} && a_.y < z_.y) for (int l_ = {above + 1}; l_ <= {_made(p, above)[-1]}; ++l_) {{\n" \
        f"    int d_ = l_ - {above}; ivec2 b_ = a_ >> d_, c_ = min(ivec2(1 << d_), z_ - (b_ << d_)), n_ = (z_ + (1 << d_) - 1) >> d_;\n" \
        f"    {{y}} += {{g_at}}(o_[l_] - {p.starts[2]} + b_.y * n_.x + b_.x) / float(c_.x * c_.y); }} }}"


def _transposed_infer(name, inputs, attrs):
    return inputs[0].vtype, _transposed_extent(Pyramid(attrs["width"], attrs["height"]), attrs["first"])


op("mip_refine_transposed", "g", attrs="width height first above", infer=_transposed_infer, reads="texel", cost=40, ref=_transposed_ref,
   glsl=_transposed_glsl, vjp=lambda g, y, x, **attrs: (apply("mip_refine", g, **attrs),),
   sample=lambda rng: ([rng.normal(size=(_P.rest.height, _P.rest.width, 3))], {"width": 75, "height": 33, "first": 2, "above": 4}),
   doc="Transpose of mip_refine.")
_P = Pyramid(75, 33)


def levels(texture: Node) -> tuple[Node, Node]:
    """The half and the rest of a texture. Raises GraphError where it is too small to have them."""
    e = texture.extent
    p, half = Pyramid(e.width, e.height), downsample(texture)
    made, above = apply("mip_refine", half, width=p.width, height=p.height, first=1, above=1), 1 + STEPS
    while above < p.last:
        made, above = apply("mip_refine", made, width=p.width, height=p.height, first=2, above=above), above + STEPS
    return half, made


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
    flat = np.concatenate([texture.reshape(-1, texture.shape[2]), half.reshape(-1, half.shape[2]), rest.reshape(-1, rest.shape[2])])
    start, t = split_lod(lod, p.last)
    for level in range(p.last + 1):
        texels = p.texels(flat, level)
        xs, ys, fx, fy = bilinear(uv, p, level, wrap)
        four = [[texels[ys[..., j], xs[..., i]] for i in (0, 1)] for j in (0, 1)]
        first, second = start == level, start + 1 == level
        yield np.where(first, 1 - t, 0) + np.where(second, t, 0), second * 1 - first, four, fx, fy, level


def _mixed(four, fx, fy):
    (t00, t10), (t01, t11) = four
    return (t00 * (1 - fx) + t10 * fx) * (1 - fy) + (t01 * (1 - fx) + t11 * fx) * fy


def _sample_ref(texture, half, rest, uv, lod, covered, wrap):
    y = sum(weight * _mixed(four, fx, fy) for weight, _, four, fx, fy, _ in _of_levels(texture, half, rest, uv, lod, wrap))
    return np.where(covered != 0, y, 0)


def _slopes_ref(texture, half, rest, uv, lod, g, wrap):
    h, w, _ = texture.shape
    last = Pyramid(w, h).last
    total, inside = 0, (lod > 0) & (lod < last)
    for weight, side, four, fx, fy, level in _of_levels(texture, half, rest, uv, lod, wrap):
        (t00, t10), (t01, t11) = four
        du = ((t10 - t00) * (1 - fy) + (t11 - t01) * fy) * (w / (1 << level))
        dv = ((t01 - t00) * (1 - fx) + (t11 - t10) * fx) * (h / (1 << level))
        by = [weight * du, weight * dv, np.where(inside, side, 0) * _mixed(four, fx, fy)]
        total = total + np.concatenate([(g * x).sum(2, keepdims=True) for x in by], 2)
    return total


def _infer(name, inputs, attrs):
    texture, half, rest, uv, lod, _ = inputs
    if max(texture.extent.width, texture.extent.height) < LEAST:
        raise GraphError(f"{name}: mip levels of {texture!r}, {texture.extent}; at least {LEAST} texels on one side are needed")
    p = Pyramid(texture.extent.width, texture.extent.height)
    if uv.vtype != "vec2" or lod.vtype != "float":
        raise GraphError(f"{name}: vec2 coordinates and a float level of detail are needed, got {uv!r} and {lod!r}")
    if half.extent != image(*p.size(1)) or rest.extent != p.rest or {half.vtype, rest.vtype} != {texture.vtype}:
        raise GraphError(f"{name}: {half!r} and {rest!r} are not the levels of {texture!r}; levels() makes them")
    wraps_of(name, attrs["wrap"])
    return texture.vtype, common_extent(name, inputs[3:])


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


def _turns(node: Node, condition: str, body: str) -> str:
    """GLSL that does `body` for both levels m_ of a sample with their weights w_, with the four texels t00_ to t11_ of each. Loops of no
    turns are what every driver skips: each level is read from its own image."""
    texture = node.inputs[0]
    p, wrap = Pyramid(texture.extent.width, texture.extent.height), node.attrs["wrap"]
    fetch = "t00_ = {0}; t10_ = {1}; t01_ = {2}; t11_ = {3};"
    places = ["lo_", "ivec2(hi_.x, lo_.y)", "ivec2(lo_.x, hi_.y)", "hi_"]
    numbers = [f"e_ + {y}_.y * z_.x + {x}_.x" for y in ("lo", "hi") for x in ("lo", "hi")]
    text = f"""{p.glsl} {wrapped(wrap)}
    float d_ = clamp({{lod}}, 0.0, {float(p.last)}), f_ = min(floor(d_), {float(p.last - 1)}); int first_ = int(f_); f_ = d_ - f_;
    for (int j_ = 0, n_ = {condition}f_ > 0.0 ? 2 : 1; j_ < n_; ++j_) {{
    int m_ = first_ + j_; float w_ = j_ == 0 ? 1.0 - f_ : f_; ivec2 z_ = (ivec2({{width}}, {{height}}) + (1 << m_) - 1) >> m_;
    {texels_of(wrap)}
    {texture.vtype} t00_ = {texture.vtype}(0), t10_ = t00_, t01_ = t00_, t11_ = t00_;
    for (int q_ = m_; q_ < 1; ++q_) {{ {fetch.format(*(f"{{texture}}({x})" for x in places))} }}
    for (int q_ = m_; q_ == 1; ++q_) {{ {fetch.format(*(f"{{half}}({x})" for x in places))} }}
    for (int q_ = m_; q_ > 1; q_ = 0) {{ int e_ = o_[m_] - {p.starts[2]}; {fetch.format(*(f"{{rest_at}}({x})" for x in numbers))} }}
    {body} }}"""
    return text.replace("{width}", str(p.width)).replace("{height}", str(p.height))


_MIXED = "mix(mix(t00_, t10_, s_.x), mix(t01_, t11_, s_.x), s_.y)"


def _sample_glsl(node: Node) -> str:
    return "{ {y} = {type}(0); " + _turns(node, "{covered} == 0 ? 0 : ", "{y} += w_ * " + _MIXED + ";") + " }"


def _slopes_glsl(node: Node) -> str:
    product = (lambda x: f"dot({{g}}, {x})") if node.inputs[0].channels > 1 else (lambda x: f"({{g}} * ({x}))")
    p = Pyramid(node.inputs[0].extent.width, node.inputs[0].extent.height)
    body = f"""vec2 u_ = vec2({p.width}, {p.height}) * (w_ / float(1 << m_));
    {{y}} += vec3({product("mix(t10_ - t00_, t11_ - t01_, s_.y)")} * u_.x, {product("mix(t01_ - t00_, t11_ - t10_, s_.x)")} * u_.y,
    {product(_MIXED)} * (in_ ? j_ == 0 ? -1.0 : 1.0 : 0.0));"""
    return f"{{ {{y}} = vec3(0.0); bool in_ = {{lod}} > 0.0 && {{lod}} < {float(p.last)}; " + _turns(node, "", body) + " }"


def _sample_vjp(g, y, texture, half, rest, uv, lod, covered, wrap):
    from .mip_gradient import transpose
    inside = apply("select", covered, g, 0.0)
    slopes = apply("mip_slopes", texture, half, rest, uv, lod, inside, wrap=wrap)
    return (*transpose(g, uv, lod, covered, texture.extent, wrap), apply("swizzle", slopes, channels="xy"),
            apply("swizzle", slopes, channels="z"), None)


def _arguments(rng, width=13, height=6):
    p, texture = Pyramid(width, height), rng.normal(size=(height, width, 3))
    half = _blocks(texture, 2) / _counts(p, 1, 0)
    rest = _refine_ref(half, width, height, 1, 1)
    return [texture, half, rest, rng.uniform(-0.4, 1.4, (6, 5, 2)), rng.uniform(-0.5, 4.5, (6, 5, 1))]


WHOLE = "its mip levels are means of all its texels"
op("sample_mips", "texture half rest uv lod covered", attrs="wrap", infer=_infer, reads="texel texel texel own own own", cost=120,
   vjp=_sample_vjp, when=flag(5), dense=WHOLE, ref=_sample_ref, glsl=_sample_glsl,
   sample=lambda rng: ([*_arguments(rng), rng.integers(0, 2, (6, 5, 1))], {"wrap": ("repeat", "clamp")}),
   doc="Trilinear sample of a texture with its mip levels at a level of detail, where `covered`; zero elsewhere.")
op("mip_slopes", "texture half rest uv lod g", attrs="wrap", reads="texel texel texel own own own", cost=140, ref=_slopes_ref,
   glsl=_slopes_glsl, infer=lambda name, inputs, attrs: ("vec3", _infer(name, inputs, attrs)[1]),
   size=lambda node, sizes: sizes[0] + sizes[5] + (max(node.inputs[0].extent.width, node.inputs[0].extent.height) - 1).bit_length(),
   sample=lambda rng: ([*_arguments(rng), rng.normal(size=(6, 5, 3))], {"wrap": ("clamp", "repeat")}),
   doc="Derivatives of sample_mips by both coordinates and by the level of detail, times g.")


def sample_mips(texture: Node, uv: Node, lod: Node, covered: Node, wrap: tuple[str, str]) -> Node:
    """The trilinear sample of a texture with levels made of it."""
    return apply("sample_mips", texture, *levels(texture), uv, lod, covered, wrap=wrap)


