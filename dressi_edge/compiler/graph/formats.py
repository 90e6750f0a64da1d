"""Which Vulkan format an image of the graph has. Three channels take the room of four: most devices draw to no three."""
from __future__ import annotations

from ...cache import vulkan as v
from .ir import Node

FORMATS = {"float": "R32_SFLOAT", "vec2": "R32G32_SFLOAT", "vec3": "R32G32B32A32_SFLOAT", "vec4": "R32G32B32A32_SFLOAT",
           "int": "R32_SINT", "ivec2": "R32G32_SINT", "ivec3": "R32G32B32A32_SINT", "ivec4": "R32G32B32A32_SINT"}
HALF_FORMATS = {"float": "R16_SFLOAT", "vec2": "R16G16_SFLOAT", "vec3": "R16G16B16A16_SFLOAT", "vec4": "R16G16B16A16_SFLOAT"}


def format_of(node: Node) -> str:
    """The format of its image."""
    return (FORMATS if node.half is None else HALF_FORMATS)[node.vtype]


def format_number(node: Node) -> int:
    """The same as Vulkan numbers it."""
    return v.FORMATS[format_of(node)]


def format_bits(node: Node) -> int:
    """Bits of a texel of its image."""
    return 8 * v.TEXEL_BYTES[format_number(node)]
