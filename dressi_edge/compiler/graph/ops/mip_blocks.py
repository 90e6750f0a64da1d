"""Blocks of a mip-mapped texture: squares of 2^l texels all of which get the same gradient, because no pixel reads a texel within one.

    places of touched texels -> occupied texels -> each texel's block -> a list of blocks -> the gradient of each

A pixel that reads a coarse texel moves all that this stands for, and alike. So moments of an optimizer are one for each block
(`compiler/passes/blocks.py`). A texel of a level is occupied if a pixel reads it or a finer one in it; the block of a texel of the texture
is the largest texel over it, of any level, in which nothing finer is occupied. Blocks do not overlap, and cover all.
"""
from __future__ import annotations

import numpy as np

from ....cache.errors import GraphError
from ..ir import Node, image
from ..optable import apply, as_node, op
from .mip_gradient import FOLD
from .mip_lists import SIZE, Chain, numbered
from .mip_pyramid import Pyramid, blocks, found

STEP = 3  # levels that one pass goes up


class Blocks:
    """Of a gradient that `mip_gradient.transpose` gives: `Op.blocked`."""

    def __init__(self, gradient: Node):
        self._each, self._slots = gradient.inputs
        self._size = {"width": gradient.extent.width, "height": gradient.extent.height}
        self.at = (self._slots,)  # what blocks depend on

    def levels(self, alone: Node | int = 0) -> Node:
        """Of each texel the level of its block; alone: 1 where a texel is a block of its own, whatever is read."""
        flags = apply("mip_marked", self._slots, apply("broadcast", as_node(alone), extent=image(**self._size)), **self._size)
        for above in range(0, Pyramid(**self._size).last, STEP):
            flags = apply("mip_occupied", flags, above=above, **self._size)
        return apply("mip_level_of", flags, **self._size)

    def first(self, levels: Node) -> Node:
        """Of each texel the number of the first one of its block."""
        return apply("mip_first", levels, **self._size)

    def heads(self, levels: Node) -> Node:
        """1 for each texel that is the first one of its block, 0 for the others."""
        return apply("mip_heads", levels, **self._size)

    def places(self, entries: Node) -> tuple[Node, Node]:
        """From where the blocks of a list have their gradient."""
        return apply("mip_near", entries, self._slots, **self._size), apply("mip_coarse", entries, **self._size)

    def gradient(self, near: Node, coarse: Node) -> Node:
        """What a texel of each block gets, from `places`."""
        level = min(FOLD, Pyramid(**self._size).last)
        return apply("mip_block_gradient", self._each, apply("mip_fold", self._each, self._slots, level=level, **self._size), near, coarse)


def _marked_ref(slots, alone, width, height):
    out = (slots >= 0).astype(np.int64)
    out.reshape(-1)[:width * height] |= (alone.reshape(-1) != 0)
    return out


def _marked_infer(name, inputs, attrs):
    _of_texture(name, inputs[1:], attrs)
    return _of_all("int", False)(name, inputs[:1], attrs)


op("mip_marked", "slots alone", attrs="width height", reads="own texel", cost=10, ref=_marked_ref, infer=lambda *x: _marked_infer(*x),
   glsl="{y} = int({slots} >= 0); if ({i} < {width} * {height}) {y} |= int({alone_at}(min({i}, {width} * {height} - 1)) != 0);",
   sample=lambda rng: ([rng.integers(-3, 2, _numbered_shape()), rng.integers(0, 2, (SIZE["height"], SIZE["width"], 1))], dict(SIZE)),
   doc="1 for each texel of all levels that stands in a list, or of the texture that is `alone`.")


def _pyramid(node: Node) -> Pyramid:
    return Pyramid(node.attrs["width"], node.attrs["height"])


def _size_glsl(level: str) -> str:
    return f"(ivec2({{width}}, {{height}}) + (1 << {level}) - 1) >> {level}"


def _of_all(vtype, over_texture):
    """Inference of an op on an int for each texel of all levels."""
    def infer(name, inputs, attrs):
        p = Pyramid(attrs["width"], attrs["height"])
        if inputs[-1].vtype != "int" or inputs[-1].extent != numbered(p):
            raise GraphError(f"{name}: an int for each texel of {p.width}x{p.height} and its levels is needed, got {inputs[-1]!r}")
        return vtype, image(p.width, p.height) if over_texture else inputs[0].extent
    return infer


def _of_texture(name, inputs, attrs):
    """Inference of an op on the levels of blocks."""
    p = Pyramid(attrs["width"], attrs["height"])
    if inputs[0].vtype != "int" or inputs[0].extent != image(p.width, p.height):
        raise GraphError(f"{name}: an int for each texel of {p.width}x{p.height} is needed, got {inputs[0]!r}")
    return "int", inputs[0].extent


def _of_entries(vtype):
    return lambda name, inputs, attrs: (vtype, inputs[0].extent)


# ---- blocks

def _occupied_ref(flags, width, height, above):
    p, out = Pyramid(width, height), flags.copy()
    flat = out.reshape(-1, 1)
    for level in range(above + 1, min(above + STEP, p.last) + 1):
        for finer in range(above, level):
            p.texels(flat, level)[:] |= blocks(p.texels(flags.reshape(-1, 1), finer), 1 << level - finer) > 0
    return out


op("mip_occupied", "flags", attrs="width height above", reads="texel", cost=60, ref=_occupied_ref, infer=_of_all("int", False),
   glsl=lambda node: f"""{{ int q_ = {{i}}; {found(node)} {{y}} = {{flags_at}}(q_);
    int l_ = m_ > {{above}} && m_ <= {{above}} + {STEP} && a_.y < z_.y ? {{above}} : m_;
    for (; l_ < m_; ++l_) {{ ivec2 s_ = {_size_glsl("l_")}, f_ = a_ << (m_ - l_), e_ = min(f_ + (1 << (m_ - l_)), s_);
    for (int b_ = f_.y; b_ < e_.y; ++b_) for (int c_ = f_.x; c_ < e_.x; ++c_) {{y}} |= {{flags_at}}(o_[l_] + b_ * s_.x + c_); }} }}""",
   sample=lambda rng: ([(rng.random(_numbered_shape()) < 0.1).astype(np.int64)], {**SIZE, "above": 0}),
   doc=f"Flags of all levels, and of the {STEP} levels after `above` whether something in a texel is flagged from that level on.")


def _numbered_shape():
    e = numbered(Pyramid(**SIZE))
    return e.height, e.width, 1


def _over(values: np.ndarray, level: int, p: Pyramid) -> np.ndarray:
    """(height, width): of each texel of the texture what its texel of a level has."""
    return values.repeat(1 << level, 0).repeat(1 << level, 1)[:p.height, :p.width]


def _level_of_ref(occupied, width, height):
    p = Pyramid(width, height)
    out = np.full((height, width), p.last)
    for level in reversed(range(p.last)):
        texels = p.texels(occupied.reshape(-1, 1), level)
        out = np.where(_over(blocks(texels, 2)[..., 0] > 0, level + 1, p), level, out)
    return out[..., None]


def _level_of_glsl(node: Node) -> str:
    p = _pyramid(node)
    return f"""{{ {p.glsl} ivec2 a_ = {{p}}; {{y}} = {p.last};
    for (int m_ = 0; m_ < {{y}}; ++m_) {{ ivec2 z_ = {_size_glsl("m_")}, f_ = (a_ >> m_) & ~1, e_ = min(f_ + 1, z_ - 1);
    int k_ = o_[m_] + f_.y * z_.x, n_ = o_[m_] + e_.y * z_.x;
    int any_ = {{occupied_at}}(k_ + f_.x) | {{occupied_at}}(k_ + e_.x) | {{occupied_at}}(n_ + f_.x) | {{occupied_at}}(n_ + e_.x);
    if (any_ != 0) {{y}} = m_; }} }}"""


op("mip_level_of", "occupied", attrs="width height", reads="texel", cost=100, ref=_level_of_ref, infer=_of_all("int", True),
   glsl=_level_of_glsl, sample=lambda rng: ([(rng.random(_numbered_shape()) < 0.1).astype(np.int64)], dict(SIZE)),
   doc="Of each texel of a texture the level of its block: the first at which one of the four texels in the next level's is occupied.")


def _levels(rng):
    flags = (rng.random(_numbered_shape()) < 0.1).astype(np.int64)
    for above in range(0, Pyramid(**SIZE).last, STEP):
        flags = _occupied_ref(flags, above=above, **SIZE)
    return _level_of_ref(flags, **SIZE)


def _first_ref(levels, width, height):
    y, x = np.mgrid[:height, :width][..., None]
    return (y >> levels << levels) * width + (x >> levels << levels)


op("mip_first", "levels", attrs="width height", cost=10, ref=_first_ref, infer=_of_texture, sample=lambda rng: ([_levels(rng)], dict(SIZE)),
   glsl="{ ivec2 a_ = {p} >> {levels} << {levels}; {y} = a_.y * {width} + a_.x; }",
   doc="Of each texel of a texture the number of the first one of its block, row by row.")


def _heads_ref(levels, width, height):
    return (_first_ref(levels, width, height)[..., 0] == np.arange(width * height).reshape(height, width)).astype(np.int64)[..., None]


op("mip_heads", "levels", attrs="width height", cost=10, ref=_heads_ref, infer=_of_texture, sample=lambda rng: ([_levels(rng)], dict(SIZE)),
   glsl="{y} = int({p} >> {levels} << {levels} == {p});", doc="1 for each texel of a texture that is the first one of its block.")


# ---- what the blocks of a list get

def _corners(entries, p: Pyramid):
    q = np.clip(entries[..., 0], 0, p.width * p.height - 1)
    return q % p.width, q // p.width


_ENTRY = "int q_ = clamp({entries}, 0, {width} * {height} - 1); ivec2 a_ = ivec2(q_ % {width}, q_ / {width});"


def _near_ref(entries, slots, width, height):
    p = Pyramid(width, height)
    x, y = _corners(entries, p)
    out = np.full((*x.shape, 4), -1)
    for level in range(min(FOLD, p.last)):
        out[..., level] = p.texels(slots.reshape(-1, 1), level)[y >> level, x >> level, 0]
    return out


def _near_glsl(node: Node) -> str:
    p = _pyramid(node)
    at = [f"{{slots_at}}(o_[{k}] + (a_.y >> {k}) * {p.size(k)[0]} + (a_.x >> {k}))" if k < min(FOLD, p.last) else "-1" for k in range(4)]
    return f"{{ {p.glsl} {_ENTRY} {{y}} = ivec4({', '.join(at)}); }}"


op("mip_near", "entries slots", attrs="width height", reads="own texel", cost=60, ref=_near_ref, infer=_of_all("ivec4", False),
   glsl=_near_glsl, sample=lambda rng: ((lambda c: [c.texels, c.slots])(Chain(rng)), dict(SIZE)),
   doc=f"Where in the list of touched texels those of levels 0 to {FOLD - 1} over the first texel of each block stand; -1: not touched.")


def _coarse_ref(entries, width, height):
    p = Pyramid(width, height)
    level, (x, y) = min(FOLD, p.last), _corners(entries, p)
    return ((y >> level) * p.size(level)[0] + (x >> level))[..., None]


def _coarse_glsl(node: Node) -> str:
    level = min(FOLD, _pyramid(node).last)
    return f"{{ {_ENTRY} {{y}} = (a_.y >> {level}) * {_pyramid(node).size(level)[0]} + (a_.x >> {level}); }}"


op("mip_coarse", "entries", attrs="width height", cost=30, ref=_coarse_ref, infer=_of_entries("int"), glsl=_coarse_glsl,
   sample=lambda rng: ([Chain(rng).texels], dict(SIZE)),
   doc=f"Of each block of a list the number of the texel of level {FOLD}, or of the last, over its first texel.")


def _gradient_ref(each, fold, near, coarse):
    each, out = each.reshape(-1, each.shape[2]), fold.reshape(-1, fold.shape[2])[coarse[..., 0]]
    for k in reversed(range(4)):
        out = out + np.where(near[..., k:k + 1] >= 0, each[np.maximum(near[..., k], 0)], 0)
    return out


def _gradient_infer(name, inputs, attrs):
    each, fold, near, coarse = inputs
    if each.vtype != fold.vtype or (near.vtype, coarse.vtype) != ("ivec4", "int"):
        raise GraphError(f"{name}: sums of one type, places as ivec4 and as int are needed, got {', '.join(map(repr, inputs))}")
    return each.vtype, near.extent


op("mip_block_gradient", "each fold near coarse", attrs="", reads="texel texel own own", cost=40, ref=_gradient_ref, infer=_gradient_infer,
   glsl="{ ivec4 n_ = {near}; {y} = {fold_at}({coarse});\n    "
   + "\n    ".join(f"{{y}} = n_.{c} >= 0 ? {{each_at}}(max(n_.{c}, 0)) + {{y}} : {{y}};" for c in "wzyx") + " }",
   sample=lambda rng: ([rng.normal(size=(4, 4, 3)), rng.normal(size=(2, 3, 3)), rng.integers(-1, 16, (5, 3, 4)),
                        rng.integers(0, 6, (5, 3, 1))], {}),
   doc="What a texel of each block gets: that of a coarse texel, and of each finer touched one over it.")
