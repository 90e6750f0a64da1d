"""Sampling a texture with the gradient of one's choice.

In: a texture, coordinates over the screen, which pixels are covered. Out: the sampled colour, zero where not covered.
"""
from __future__ import annotations

from ...cache.errors import InputError
from ..graph.functions import select
from ..graph.ir import UNIT, Node
from ..graph.optable import apply, as_node

GRADIENTS = ("exact", "inverse_uv", "none")


def sample_texture(texture: Node, uv: Node, wrap: str = "repeat", gradient: str = "exact", covered: Node | None = None,
                   step: Node | None = None) -> Node:
    """Bilinear sample of `texture` (any size, 1 to 4 float channels) at `uv` (vec2), zero where `covered` is 0.

    uv: [0, 1] over the texture, texel centres at (k + 0.5) / size; outside by `wrap`, "repeat" or "clamp".
    covered: int over uv's extent; None: everywhere.
    gradient of the texture:
    "exact"       the transpose, by gathers. What depends on uv alone is computed again only when uv changes.
    "inverse_uv"  paper 3.3.2: one pixel a texel and step, chosen by Sobol point number `step` (1x1 int, >= 0); for a uv that
                  changes every step. A texel that many pixels sample gets the gradient of one, not their sum.
    "none"        none.
    The gradient of uv is the same in all. Raises InputError, GraphError.
    """
    if gradient not in GRADIENTS:
        raise InputError(f"gradient is {gradient!r:.40}; {' '.join(GRADIENTS)} are allowed")
    if gradient == "inverse_uv" and (step is None or step.vtype != "int" or step.extent != UNIT):
        raise InputError(f"gradient inverse_uv: step is {step!r}; the 1x1 int that counts steps is needed")
    if covered is not None and (covered.vtype != "int" or covered.extent != uv.extent):
        raise InputError(f"covered is {covered!r}; an int over {uv.extent} is needed")
    mask = apply("broadcast", as_node(1), extent=uv.extent) if covered is None else covered
    if gradient == "none":
        color = apply("sample", texture, uv, wrap=wrap)
    elif gradient == "exact":
        return apply("sample_exact", texture, uv, mask, wrap=wrap)
    else:
        color = apply("sample_inverse", texture, uv, mask, step, wrap=wrap)
    return color if covered is None else select(covered, color, 0.0)
