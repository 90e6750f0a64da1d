"""Several trilinear samples of a pixel that stand evenly on a line, and their mean: what anisotropic filtering is made of.

    texture, uv, apart, lod, covered -> samples at uv + (k - (count - 1) / 2) apart -> their mean

It is one op so that what all samples read is one list: its transpose sorts, sums and hands down once, not once a sample, and moments
of an optimizer are kept by blocks (`mip_blocks.py`), which a texture with several transposes cannot have.
"""
from __future__ import annotations

from ....cache.errors import GraphError
from ..ir import Node
from ..optable import apply, common_extent, flag, op
from .mip_lists import middle, over, reads_of
from .mip_pyramid import Pyramid
from .mips import WHOLE, arguments, infer, levels, levels_infer, levels_ref, sample_glsl, sample_ref


def along(uv: Node, apart: Node, count: int) -> list[Node]:
    """Where the samples of a pixel are."""
    return [uv + apart * (k - middle(count)) for k in range(count)]


def mean(samples: list[Node]) -> Node:
    """Of some samples, added from the first on."""
    return sum(samples[1:], samples[0]) * (1.0 / len(samples))


def _along_ref(texture, half, rest, uv, apart, lod, covered, wrap, count):
    return sum(sample_ref(texture, half, rest, uv + apart * (k - middle(count)), lod, covered, wrap) for k in range(count)) / count


def _infer(of):
    """Inference by that of one sample."""
    def several(name, inputs, attrs):
        *images, uv, apart, lod, covered = inputs
        if apart.vtype != "vec2" or isinstance(attrs["count"], bool) or not isinstance(attrs["count"], int) or attrs["count"] < 2:
            raise GraphError(f"{name}: two samples or more that are apart by a vec2 are needed, got {attrs['count']!r} and {apart!r}")
        return of(name, (*images, uv, lod, covered), attrs)[0], common_extent(name, (uv, apart, lod, covered))
    return several


def _glsl(node: Node) -> str:
    count = node.attrs["count"]
    one = sample_glsl(node, "one_").replace("{uv}", "at_")
    return f"""{{ {{y}} = {{type}}(0); for (int n_ = 0; n_ < {count}; ++n_) {{
    vec2 at_ = {{uv}} + {{apart}} * (float(n_) - {middle(count)}); {{type}} one_; {one} {{y}} += one_; }} {{y}} *= {1.0 / count!r}; }}"""


def _still(node: Node) -> Node:
    """By one list of what all samples read."""
    from .mip_still import by_list
    *images, uv, apart, lod, covered = node.inputs
    uv, apart, lod, covered = over(node.extent, uv, apart, lod, covered)
    p, wrap, count = Pyramid(images[0].extent.width, images[0].extent.height), node.attrs["wrap"], node.attrs["count"]
    return mean(by_list(images, along(uv, apart, count), lod, covered, wrap, reads_of(p, uv, lod, covered, wrap, apart, count)))


def _vjp(g, y, texture, uv, apart, lod, covered, wrap, count):
    from .mip_gradient import transpose
    inside, images = apply("select", covered, g * (1.0 / count), 0.0), (texture, *levels(texture))
    slopes = [apply("mip_slopes", *images, at, lod, inside, wrap=wrap) for at in along(uv, apart, count)]
    turned = [x * (k - middle(count)) for k, x in enumerate(slopes)]
    whole = sum(slopes[1:], slopes[0])
    return (transpose(g, uv, lod, covered, texture.extent, wrap, apart, count), apply("swizzle", whole, channels="xy"),
            apply("swizzle", sum(turned[1:], turned[0]), channels="xy"), apply("swizzle", whole, channels="z"), None)


def _sample(rng, images: bool):
    texture, half, rest, uv, lod = arguments(rng)
    return [texture, *((half, rest) if images else ()), uv, rng.uniform(-0.1, 0.1, uv.shape), lod,
            rng.integers(0, 2, lod.shape)], {"wrap": ("repeat", "clamp"), "count": 3}


op("sample_along", "texture uv apart lod covered", attrs="wrap count", stage="composite", infer=_infer(infer), vjp=_vjp,
   reads="texel own own own own",
   ref=lambda texture, uv, apart, lod, covered, wrap, count:
   _along_ref(texture, *levels_ref(texture), uv, apart, lod, covered, wrap, count),
   lower=lambda texture, uv, apart, lod, covered, wrap, count, room=None:
   apply("levels_along", texture, *levels(texture), uv, apart, lod, covered, wrap=wrap, count=count),
   sample=lambda rng: _sample(rng, False),
   doc="The mean of `count` samples as of sample_mips, which are `apart` and stand evenly about uv.")
op("levels_along", "texture half rest uv apart lod covered", attrs="wrap count", infer=_infer(levels_infer), when=flag(6), dense=WHOLE,
   reads="texel texel texel own own own own", cost=400, still=_still, ref=_along_ref, glsl=_glsl, sample=lambda rng: _sample(rng, True),
   doc="sample_along of a texture, its half and its rest.")


def sample_along(texture: Node, uv: Node, apart: Node, lod: Node, covered: Node, wrap: tuple[str, str], count: int) -> Node:
    """The mean of trilinear samples along a line of a texture with levels made of it."""
    return apply("sample_along", texture, uv, apart, lod, covered, wrap=wrap, count=count)
