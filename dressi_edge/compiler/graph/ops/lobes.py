"""Images of lobes of several roughnesses, which lie side by side in one (an atlas), read at the same place of each: at one roughness that
all pixels share, linearly between the two around it.

Forward two bilinear reads are enough, whose images are chosen in each step. The transpose must not depend on that choice, for what is read
where is found once, where places rest: it has the lists of all images, and those that are not read now are empty.
"""
from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ....cache.errors import GraphError
from ..ir import UNIT, Node
from ..optable import apply, common_extent, op
from .texture import _sample_ref
from .texture_gradient import transpose
from .vector import compose

Corner = tuple[int, int, int]  # of an image: texels a side without its rim of one, and where the rim's upper left corner is


def scaled(texel: Node, e) -> Node:
    """Coordinates of places in texels of an image's atlas, from the corner of its rim, but for the rim itself."""
    return texel * compose(1.0 / e.width, 1.0 / e.height) + compose(1.0 / e.width, 1.0 / e.height)


def within(at: Node, corner: Corner, e) -> Node:
    """Coordinates in an atlas of the place `at` (vec2, 0 to 1) of one of its images."""
    n, x, y = corner
    return scaled(at * float(n) + compose(float(x), float(y)), e)


def between(r: Node, knots: Sequence[float], values: Sequence[Sequence[float]]) -> tuple[Node, list[list[Node]]]:
    """How far r, in [knots[0], knots[-1]], is from the knot at or below it to the next, 0 to 1; and of each row of values (one a knot),
    that of the one and of the other: choices, without gradient."""
    # What differs from one to the next is looked up in sums of steps.
    before = [apply("select", apply("greater_equal", r, low), 1.0, 0.0) for low in knots[1:-1]]

    def chosen(row) -> Node:
        total = float(row[0])
        for there, step in zip(before, np.diff(row)):
            total = total + there * float(step)
        return total

    t = (r - chosen(knots[:-1])) * chosen(1.0 / np.diff(knots))
    return t, [[chosen(row[:-1]) for row in values], [chosen(row[1:]) for row in values]]


def pair(texture: Node, at: Node, r: Node, covered: Node, corners: Sequence[Corner], knots: Sequence[float]) -> Node:
    """The two reads, and what lies between them; a texture's gradient goes through those two."""
    t, sides = between(r, knots, list(zip(*corners)))
    low, high = (apply("sample_exact", texture, scaled(at * n + compose(x, y), texture.extent), covered, wrap="clamp") for n, x, y in sides)
    return low + (high - low) * t


def _weights(r: Node, knots: Sequence[float]) -> list[Node]:
    """How much each image has in the result."""
    found = []
    for k, middle in enumerate(knots):
        rising = (r - knots[k - 1]) * (1.0 / (middle - knots[k - 1])) if k else None
        falling = (knots[k + 1] - r) * (1.0 / (knots[k + 1] - middle)) if k + 1 < len(knots) else None
        both = rising if falling is None else falling if rising is None else apply("select", apply("less", r, middle), rising, falling)
        found.append(apply("max", both, 0.0))
    return found


def _ref(texture, at, r, covered, corners, knots):
    size, y = np.array([texture.shape[1], texture.shape[0]]), 0.0
    for k, (n, *corner) in enumerate(corners):
        weight = np.interp(r, knots, np.eye(len(knots))[k])
        y = y + weight * _sample_ref(texture, (at * n + np.array(corner) + 1.0) / size, "clamp")
    return np.where(covered != 0, y, 0)


def _infer(name, inputs, attrs):
    texture, at, r, covered = inputs
    if (at.vtype, r.vtype, r.extent, covered.vtype) != ("vec2", "float", UNIT, "int"):
        raise GraphError(f"{name}: places as vec2, a float of extent 1x1 and an int mask are needed, got {at!r}, {r!r} and {covered!r}")
    if len(attrs["corners"]) != len(attrs["knots"]) or len(attrs["knots"]) < 2 or min(np.diff(attrs["knots"])) <= 0:
        raise GraphError(f"{name}: knots {attrs['knots']}; two or more, ascending, one for each image are needed")
    for n, x, y in attrs["corners"]:
        if min(x, y) < 0 or x + n + 2 > texture.extent.width or y + n + 2 > texture.extent.height:
            raise GraphError(f"{name}: an image of {n} x {n} texels and a rim at ({x}, {y}) of {texture!r}, which is smaller")
    return texture.vtype, common_extent(name, (at, covered))


def _vjp(g, y, texture, at, r, covered, corners, knots):
    from ..autodiff import gradients
    from .reduce import total
    product = apply("stop_gradient", g) * pair(texture, at, r, covered, corners, knots)
    loss = total(apply("sum_channels", product) if product.channels > 1 else product)
    by_place, by_r = gradients(loss, [at, r])
    of_texture = None
    for weight, corner in zip(_weights(r, knots), corners):
        part = weight * transpose(g, within(at, corner, texture.extent), covered, texture.extent, "clamp", apply("greater", weight, 0.0))
        of_texture = part if of_texture is None else of_texture + part
    return of_texture, by_place, by_r, None


op("sample_lobes", "texture at r covered", attrs="corners knots", stage="composite", reads="texel own own own", infer=_infer, ref=_ref,
   vjp=_vjp, lower=lambda *inputs, corners, knots, room=None: pair(*inputs, corners, knots),
   sample=lambda rng: ([rng.normal(size=(8, 13, 3)), rng.uniform(0.05, 0.95, (6, 5, 2)), np.array([[[0.3]]]),
                        rng.integers(0, 2, (6, 5, 1))], {"corners": ((6, 0, 0), (3, 8, 0), (1, 8, 5)), "knots": (0.0, 0.25, 1.0)}),
   doc="Of images that lie in one, each with a rim of a texel, the bilinear read at one place of all, linear between the two whose `knots` "
       "are around r, in [knots[0], knots[-1]], where `covered`; zero elsewhere.")
