"""Sampling a texture with the gradient of one's choice, with or without mip levels.

In: a texture, coordinates over the screen, which pixels are covered. Out: the sampled colour, zero where not covered.
"""
from __future__ import annotations

from ...cache.errors import GraphError, InputError
from ..graph.functions import absolute, apply, clamp, compose, dot, maximum, select, sqrt, stop_gradient
from ..graph.ir import UNIT, Extent, Node
from ..graph.ops.mip_along import along, mean, sample_along
from ..graph.ops.mip_pyramid import LEAST
from ..graph.ops.mips import sample_mips
from ..graph.ops.texture_sort import MAX_PIXELS
from ..graph.optable import as_node

GRADIENTS = ("exact", "inverse_uv", "none")
WRAPS = ("repeat", "clamp", "mirror")
Wrap = str | tuple[str, str]


def wraps_of(wrap: Wrap) -> tuple[str, str]:
    """What is beyond the edges by u and by v: one of WRAPS for each. Raises InputError."""
    pair = (wrap, wrap) if isinstance(wrap, str) else wrap
    if not isinstance(pair, (tuple, list)) or len(pair) != 2 or not set(pair) <= set(WRAPS):
        raise InputError(f"wrap is {wrap!r:.60}; {' '.join(WRAPS)} are allowed, or a pair of them for u and v")
    return tuple(pair)


def alike(wrap: Wrap) -> Wrap:
    """One word where both axes go on alike, else a pair. Raises InputError."""
    u, v = wraps_of(wrap)
    return u if u == v else (u, v)


def _mirrored(u: Node) -> Node:
    """There and back between 0 and 1."""
    return 1.0 - absolute(u - 2.0 * apply("floor", u * 0.5) - 1.0)


def within(uv: Node, wrap: tuple[str, str], extent: Extent, mips: bool) -> tuple[Node, str | tuple[str, str]]:
    """Coordinates and the wrap with which the ops sample as `wrap` says: they know "repeat" and "clamp", the bilinear ones of both axes
    alike. Then what shall not repeat is held between the first texel's centre and the last's."""
    if uv.vtype != "vec2":
        raise GraphError(f"a texture's coordinates must be vec2, got {uv!r}")
    if "mirror" in wrap:
        uv = compose(*(_mirrored(x) if w == "mirror" else x for x, w in zip((uv.x, uv.y), wrap)))
    kinds = tuple("repeat" if w == "repeat" else "clamp" for w in wrap)
    if mips:
        return uv, kinds
    if kinds[0] == kinds[1]:
        return uv, kinds[0]
    sizes = extent.width, extent.height
    return compose(*(x if k == "repeat" else clamp(x, 0.5 / n, 1.0 - 0.5 / n) for x, k, n in zip((uv.x, uv.y), kinds, sizes))), "repeat"


def level_of_detail(across: Node, down: Node, extent: Extent, bias: float = 0.0) -> Node:
    """The level of a texture of `extent` at which texels are as large as pixels, from how far coordinates (vec2) go from one pixel to the
    next: log2 of the root mean square, over all directions, of texels a pixel, plus bias. No gradient.

    A pixel is an ellipse on the texture; the longer axis (what hardware takes) blurs a face seen at an angle more than it helps, the
    shorter aliases: docs/benchmarks.md."""
    size = compose(float(extent.width), float(extent.height))
    a, b = across * size, down * size
    return stop_gradient(0.5 * apply("log2", maximum((dot(a, a) + dot(b, b)) * 0.5, 2.0 ** -60)) + bias)


def probes(across: Node, down: Node, extent: Extent, count: int, bias: float = 0.0) -> tuple[Node, Node]:
    """How far `count` samples of a pixel stand from one another on a texture of `extent`, in coordinates (vec2), and the level of detail of
    each: a pixel is an ellipse there, along whose longer axis they stand, each for its share of it. No gradient."""
    size = compose(float(extent.width), float(extent.height))
    a, b = across * size, down * size
    most = maximum(maximum(absolute(a.x), absolute(a.y)), maximum(absolute(b.x), absolute(b.y)))
    most = maximum(most, 2.0 ** -60)
    a, b = a / most, b / most  # squares of what is far away would leave fp32
    xx, xy, yy = a.x * a.x + b.x * b.x, a.x * a.y + b.x * b.y, a.y * a.y + b.y * b.y
    half, turn = (xx + yy) * 0.5, sqrt(maximum((xx - yy) * (xx - yy) * 0.25 + xy * xy, 0.0))
    longer, shorter = half + turn, maximum(half - turn, 0.0)  # squares of the axes
    axis = select(xx > yy, compose(longer - yy, xy), compose(xy, longer - xx))
    squared = dot(axis, axis)
    axis = select(squared > 1e-12, axis * sqrt(longer / maximum(squared, 1e-12)), compose(sqrt(longer), 0.0))
    lod = 0.5 * apply("log2", maximum((shorter + longer * (1.0 / count ** 2)) * 0.5, 2.0 ** -60)) + apply("log2", most) + bias
    return stop_gradient(axis * most / size * (1.0 / count)), stop_gradient(lod)


def sample_texture(texture: Node, uv: Node, wrap: Wrap = "repeat", gradient: str = "exact", covered: Node | None = None,
                   step: Node | None = None, lod: Node | None = None) -> Node:
    """Bilinear sample of `texture` (any size, 1 to 4 float channels) at `uv` (vec2), zero where `covered` is 0.

    uv: [0, 1] over the texture, texel centres at (k + 0.5) / size; outside by `wrap`, "repeat", "clamp" or "mirror", or a pair for u and v.
    covered: int over uv's extent; None: everywhere.
    lod: a float over uv's extent, the level of detail: the sample is then trilinear, between mip levels (`graph/ops/mips.py`).
    gradient of the texture:
    "exact"       the transpose, by gathers. What depends on uv alone is computed again only when uv changes.
    "inverse_uv"  paper 3.3.2: one pixel a texel and step, chosen by Sobol point number `step` (1x1 int, >= 0); for a uv that
                  changes every step. A texel that many pixels sample gets the gradient of one, not their sum.
    "none"        none.
    The gradient of uv is the same in all. With lod "exact" is the transpose through all levels, and there is no "inverse_uv".
    Raises InputError, GraphError.
    """
    if gradient not in GRADIENTS:
        raise InputError(f"gradient is {gradient!r:.40}; {' '.join(GRADIENTS)} are allowed")
    if gradient == "inverse_uv" and (step is None or step.vtype != "int" or step.extent != UNIT):
        raise InputError(f"gradient inverse_uv: step is {step!r}; the 1x1 int that counts steps is needed")
    if covered is not None and (covered.vtype != "int" or covered.extent != uv.extent):
        raise InputError(f"covered is {covered!r}; an int over {uv.extent} is needed")
    if lod is not None and gradient == "inverse_uv":
        raise InputError("gradient inverse_uv: a texture with mips has none; use exact or none")
    mask = apply("broadcast", as_node(1), extent=uv.extent) if covered is None else covered
    mips = lod is not None and max(texture.extent.width, texture.extent.height) >= LEAST  # smaller ones have nothing to alias
    uv, wrap = within(uv, wraps_of(wrap), texture.extent, mips)
    if mips:
        return sample_mips(stop_gradient(texture) if gradient == "none" else texture, uv, lod, mask, wrap)
    if gradient == "none":
        color = apply("sample", texture, uv, wrap=wrap)
    elif gradient == "exact":
        return apply("sample_exact", texture, uv, mask, wrap=wrap)
    else:
        color = apply("sample_inverse", texture, uv, mask, step, wrap=wrap)
    return color if covered is None else select(covered, color, 0.0)


def sample_probes(texture: Node, uv: Node, apart: Node, lod: Node, count: int, wrap: Wrap = "repeat", gradient: str = "exact",
                  covered: Node | None = None) -> Node:
    """The mean of `count` trilinear samples (1 or more) that are `apart` and stand evenly about uv (`probes`); else as `sample_texture`."""
    kinds, e = wraps_of(wrap), uv.extent
    if count > 1 and gradient in ("exact", "none") and "mirror" not in kinds and covered is not None \
            and max(texture.extent.width, texture.extent.height) >= LEAST and count * e.width * e.height <= MAX_PIXELS:
        return sample_along(stop_gradient(texture) if gradient == "none" else texture, uv, apart, lod, covered, kinds, count)
    return mean([sample_texture(texture, at, wrap, gradient, covered, lod=lod) for at in along(uv, apart, count)])
