"""What a profile can speak of: limits, features and formats, what the Vulkan 1.0 specification requires of each, and whether a value of
theirs is well formed. In: names and values as read. Out: tables, checked values, and errors that name what was meant."""

from __future__ import annotations

import math
from collections.abc import Iterable

from .errors import ProfileError

# name: (kind, minimum of the specification). Kinds: "max" and "size" (per axis) bound a need from above, "min" is an
# alignment that a need must be a multiple of (the larger the stricter), "range" encloses, "flag" is a yes.
# maxDescriptorSet*: n times the per-stage minimum for n shader stages; n = 3 where geometry and tessellation are absent.
LIMITS = {
    "maxImageDimension2D": ("max", 4096),
    "maxImageArrayLayers": ("max", 256),
    "maxUniformBufferRange": ("max", 16384),
    "maxStorageBufferRange": ("max", 1 << 27),
    "maxPushConstantsSize": ("max", 128),
    "maxMemoryAllocationCount": ("max", 4096),
    "maxSamplerAllocationCount": ("max", 4000),
    "bufferImageGranularity": ("min", 131072),
    "maxBoundDescriptorSets": ("max", 4),
    "maxPerStageDescriptorSamplers": ("max", 16),
    "maxPerStageDescriptorUniformBuffers": ("max", 12),
    "maxPerStageDescriptorStorageBuffers": ("max", 4),
    "maxPerStageDescriptorSampledImages": ("max", 16),
    "maxPerStageDescriptorStorageImages": ("max", 4),
    "maxPerStageDescriptorInputAttachments": ("max", 4),
    "maxPerStageResources": ("max", 128),  # or the sum of RESOURCES, if that is smaller: see Profile.limit
    "maxDescriptorSetSamplers": ("max", 48),
    "maxDescriptorSetUniformBuffers": ("max", 36),
    "maxDescriptorSetUniformBuffersDynamic": ("max", 8),
    "maxDescriptorSetStorageBuffers": ("max", 12),
    "maxDescriptorSetSampledImages": ("max", 48),
    "maxDescriptorSetStorageImages": ("max", 12),
    "maxDescriptorSetInputAttachments": ("max", 4),
    "maxVertexOutputComponents": ("max", 64),
    "maxFragmentInputComponents": ("max", 64),
    "maxFragmentOutputAttachments": ("max", 4),
    "maxFragmentCombinedOutputResources": ("max", 4),
    "maxColorAttachments": ("max", 4),
    "maxFramebufferWidth": ("max", 4096),
    "maxFramebufferHeight": ("max", 4096),
    "maxFramebufferLayers": ("max", 256),
    "maxComputeSharedMemorySize": ("max", 16384),
    "maxComputeWorkGroupCount": ("size", (65535, 65535, 65535)),
    "maxComputeWorkGroupInvocations": ("max", 128),
    "maxComputeWorkGroupSize": ("size", (128, 128, 64)),
    "subPixelPrecisionBits": ("max", 4),
    "subTexelPrecisionBits": ("max", 4),
    "mipmapPrecisionBits": ("max", 4),
    "maxDrawIndexedIndexValue": ("max", (1 << 24) - 1),
    "maxDrawIndirectCount": ("max", 1),
    "maxViewports": ("max", 1),
    "maxViewportDimensions": ("size", (4096, 4096)),
    "viewportBoundsRange": ("range", (-8192, 8191)),
    "minUniformBufferOffsetAlignment": ("min", 256),
    "minStorageBufferOffsetAlignment": ("min", 256),
    "nonCoherentAtomSize": ("min", 256),
    "timestampComputeAndGraphics": ("flag", False),
}
# What is dispatched to compute shaders instead of drawn, each with all before it: nothing, ops that share memory, pixelwise work of which
# nothing is left undrawn, and that of which tiles or the end of a list are.
COMPUTE = ("none", "ops", "pixel", "all")
RESOURCES = ("maxPerStageDescriptorUniformBuffers", "maxPerStageDescriptorStorageBuffers", "maxPerStageDescriptorSampledImages",
             "maxPerStageDescriptorStorageImages", "maxPerStageDescriptorInputAttachments", "maxColorAttachments")

# feature: the structure that holds it. Only robustBufferAccess is required.
_CORE = "VkPhysicalDeviceFeatures"
FEATURES = dict.fromkeys((
    "robustBufferAccess", "fullDrawIndexUint32", "imageCubeArray", "independentBlend", "geometryShader", "depthClamp",
    "multiDrawIndirect", "drawIndirectFirstInstance", "wideLines", "multiViewport", "samplerAnisotropy",
    "vertexPipelineStoresAndAtomics", "fragmentStoresAndAtomics", "shaderStorageImageExtendedFormats",
    "shaderStorageImageReadWithoutFormat", "shaderStorageImageWriteWithoutFormat", "shaderUniformBufferArrayDynamicIndexing",
    "shaderSampledImageArrayDynamicIndexing", "shaderClipDistance", "shaderInt16"), _CORE) | {
    "shaderFloat16": "VkPhysicalDeviceShaderFloat16Int8Features",
    "shaderBufferFloat32AtomicAdd": "VkPhysicalDeviceShaderAtomicFloatFeaturesEXT",
}
REQUIRED_FEATURES = frozenset({"robustBufferAccess"})

# our short names of the optimal-tiling features that matter here
FORMAT_FEATURES = {
    "sampled": "VK_FORMAT_FEATURE_SAMPLED_IMAGE_BIT",
    "filter": "VK_FORMAT_FEATURE_SAMPLED_IMAGE_FILTER_LINEAR_BIT",
    "color": "VK_FORMAT_FEATURE_COLOR_ATTACHMENT_BIT",
    "blend": "VK_FORMAT_FEATURE_COLOR_ATTACHMENT_BLEND_BIT",
    "depth": "VK_FORMAT_FEATURE_DEPTH_STENCIL_ATTACHMENT_BIT",
    "storage": "VK_FORMAT_FEATURE_STORAGE_IMAGE_BIT",
}
FROM_VK = {vk: short for short, vk in FORMAT_FEATURES.items()}
# mandatory features of each format; besides, one of X8_D24 and D32 must be a depth attachment: see Profile.depth_choice
FORMATS = {name: frozenset(features.split()) for name, features in {
    "R32_SINT": "sampled color storage",
    "R32G32_SINT": "sampled color storage",
    "R32G32B32A32_SINT": "sampled color storage",
    "R32_SFLOAT": "sampled color storage",
    "R32G32_SFLOAT": "sampled color storage",
    "R32G32B32A32_SFLOAT": "sampled color storage",
    "R16_SFLOAT": "sampled filter color blend",
    "R16G16_SFLOAT": "sampled filter color blend",
    "R16G16B16A16_SFLOAT": "sampled filter color blend storage",
    "R8_UNORM": "sampled filter color blend",
    "R8G8B8A8_UNORM": "sampled filter color blend storage",
    "D16_UNORM": "sampled depth",
    "X8_D24_UNORM_PACK32": "",
    "D32_SFLOAT": "sampled",
}.items()}


def show(value) -> str:
    """A value, cut where it is long."""
    return (text := repr(value))[:60] + ("..." if len(text) > 60 else "")


NAMED = 24  # of the names that an error lists


def close(name: str, known: Iterable[str], cutoff: float) -> list[str]:
    """The known name most like this one, if any is like it enough, in a list."""
    import difflib

    return difflib.get_close_matches(name, list(known), 1, cutoff)


def nearest(name: str, known: Iterable[str]) -> str:
    """What was likely meant by a name, in words: the one known that is near, or the first few there are."""
    near, known = close(str(name)[:80], known, 0.5), list(known)
    return f"did you mean {near[0]}?" if near else f"known: {' '.join(known[:NAMED])}{' ...' if len(known) > NAMED else ''}"


def an_object(value, where: str, keys: Iterable[str] | None = None, required: bool = False) -> dict:
    """A JSON object, of these keys alone where they are given, with all of them if `required`. Raises ProfileError."""
    if not isinstance(value, dict):
        raise ProfileError(f"{where}: must be an object, found {show(value)}")
    for k in value if keys is not None else ():
        if k not in keys:
            raise ProfileError(f"{where}: unknown key {k[:60]!r}; {nearest(k, keys)}")
    for k in keys if required else ():
        if k not in value:
            raise ProfileError(f"{where}: {k!r} is missing")
    return value


_WORDS = {bool: "true or false", str: "a string", list: "a list"}


def typed(value, kind: type, where: str):
    """A value of this type, which a boolean is not of int. Raises ProfileError."""
    if type(value) is not kind:
        raise ProfileError(f"{where}: must be {_WORDS[kind]}, found {show(value)}")
    return value


def number(value, where: str, low=0, whole=True):
    """A finite number from `low` to 2^64 - 1. Raises ProfileError."""
    ok = type(value) is int or (not whole and type(value) is float and math.isfinite(value))
    if not ok or not low <= value < 1 << 64:
        kind = "a whole number" if whole else "a number"
        raise ProfileError(f"{where}: must be {kind} from {low} to 2^64 - 1, found {show(value)}")
    return int(value) if value == int(value) else value


def limit_value(name: str, value, where: str):
    """The value of a limit, of its kind. Raises ProfileError."""
    kind, floor = LIMITS[name]
    if kind == "flag":
        return typed(value, bool, where)
    if kind in ("max", "min"):
        return number(value, where)
    if not isinstance(value, list | tuple) or len(value) != len(floor):
        raise ProfileError(f"{where}: must be a list of {len(floor)} numbers, found {show(value)}")
    low, whole = (-(1 << 63), False) if kind == "range" else (0, True)
    out = tuple(number(v, f"{where}[{i}]", low, whole) for i, v in enumerate(value))
    if kind == "range" and out[0] > out[1]:
        raise ProfileError(f"{where}: must be [low, high], found {show(value)}")
    return out


def stricter(kind: str, a, b):
    """The stricter of two values of a limit."""
    if kind == "size":
        return tuple(map(min, a, b))
    if kind == "range":
        return max(a[0], b[0]), min(a[1], b[1])
    return max(a, b) if kind == "min" else min(a, b)


def enough(kind: str, need, have) -> bool:
    """Whether a value of a limit satisfies a need."""
    return stricter(kind, need, have) == need


def text_of(value) -> str:
    """A limit's value as people read it."""
    return " ".join(map(str, value)) if isinstance(value, tuple | list) else str(value)
