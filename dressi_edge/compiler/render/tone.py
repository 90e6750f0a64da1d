"""From linear radiance to what is looked at: transfer curves as graph."""
from __future__ import annotations

from ..graph.functions import apply, maximum, minimum, select
from ..graph.ir import Node


def encode_srgb(linear: Node) -> Node:
    """IEC 61966-2-1 transfer of linear values to sRGB, clamped to [0, 1]."""
    x = minimum(maximum(linear, 0.0), 1.0)
    return select(x <= 0.0031308, x * 12.92, 1.055 * apply("pow", maximum(x, 0.0031308), 1.0 / 2.4) - 0.055)


def decode_srgb(encoded: Node) -> Node:
    """IEC 61966-2-1: of sRGB values in [0, 1] the linear ones; clamped."""
    x = minimum(maximum(encoded, 0.0), 1.0)
    return select(x <= 0.04045, x * (1.0 / 12.92), apply("pow", (maximum(x, 0.04045) + 0.055) * (1.0 / 1.055), 2.4))
