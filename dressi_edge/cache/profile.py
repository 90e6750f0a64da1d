"""Device profiles. In: device_profiles/NAME.json (Khronos profile layout and our block). Out: a frozen `Profile`.

A profile states what a device, driver and version allow. What it does not state is the minimum that the Vulkan 1.0
specification requires ("Required Limits" and the mandatory format tables): unknown stays unknown. The compiler packs for
a profile, the runtime compares one with the device at hand; standard library only, for both import it.
"""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING

from dressi_edge.cache.errors import ProfileError

if TYPE_CHECKING:  # files, JSON and suggestions are imported where they are used: a session makes do without
    from pathlib import Path

SCHEMA = "https://schema.khronos.org/vulkan/profiles-0.8-latest.json#"
MAX_FILE_BYTES = 1 << 20
STATUS = ("measured", "specified", "assumed")  # best first
OUTSIDE_READ = ("texel_fetch", "input_attachment")  # the first wins a merge: it needs no slot and no tile memory

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
_FROM_VK = {vk: short for short, vk in FORMAT_FEATURES.items()}
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

_BLOCK = ("description", "tile_bits", "max_merged_attachments", "outside_read", "compute", "prefer_fp16",
          "device_local_lazily_allocated", "quirks", "sources")


@dataclass(frozen=True)
class Profile:
    """What a device allows. `limits`, `features` and `formats` hold only what is stated; ask `limit`, `feature` and
    `format_has` for the value in force. `tile_bits`: colour bits a pixel that fit in tile memory; `max_merged_attachments`:
    attachments over merged subpasses; None means no such rule is known. `outside_read`: how to read an attachment written
    outside the render pass. `compute`: compute substages may be used."""

    name: str
    description: str = ""
    limits: Mapping[str, int | float | tuple | bool] = field(default_factory=dict)
    features: Mapping[str, bool] = field(default_factory=dict)
    formats: Mapping[str, frozenset[str]] = field(default_factory=dict)
    tile_bits: int | None = None
    max_merged_attachments: int | None = None
    outside_read: str = "texel_fetch"
    compute: bool = False
    prefer_fp16: bool = False
    device_local_lazily_allocated: bool = False
    quirks: tuple[str, ...] = ()
    sources: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    api_version: str = "1.0.0"
    date: str = "1970-01-01"

    def __post_init__(self):
        limits = {k: tuple(v) if isinstance(v, list | tuple) else v for k, v in self.limits.items()}
        sources = {k: MappingProxyType(dict(v)) for k, v in self.sources.items()}
        formats = {k: frozenset(v) for k, v in self.formats.items()}
        frozen = dict(limits=limits, features=dict(self.features), formats=formats, sources=sources)
        for key, value in frozen.items():
            object.__setattr__(self, key, MappingProxyType({k: value[k] for k in sorted(value)}))
        object.__setattr__(self, "quirks", tuple(sorted(set(self.quirks))))

    def __hash__(self):
        return hash((self.name, self.digest))

    @classmethod
    def load(cls, name_or_path: str | Path) -> Profile:
        """The profile of that name (`profile_names()`) or in that .json file. ProfileError if unknown or malformed."""
        text = str(name_or_path)
        if text.endswith(".json") or "/" in text or "\\" in text:
            from pathlib import Path

            return _parse(_read(Path(text), text), text)
        if text not in (names := profile_names()):
            near = _close(text, names, 0.4)
            hint = f"did you mean {near[0]}? " if near else ""
            raise ProfileError(f"profile {text[:80]!r} is unknown; {hint}known: {' '.join(names)}")
        return _parse(_read(folder() / f"{text}.json", f"{text}.json"), f"{text}.json")

    @classmethod
    def loads(cls, data: bytes | str, where: str = "profile") -> Profile:
        """The profile in this JSON text; `where` names it in errors."""
        return _parse(data.encode() if isinstance(data, str) else data, where)

    def limit(self, name: str):
        """The value in force of a limit: the stated one or the specification's minimum."""
        if name in self.limits:
            return self.limits[name]
        kind_floor = LIMITS.get(name)
        if kind_floor is None:
            raise ProfileError(f"limit {name!r} is unknown; {_nearest(name, LIMITS)}")
        if name == "maxPerStageResources":  # footnote in the specification: the smaller of 128 and this sum
            return min(kind_floor[1], sum(self.limit(k) for k in RESOURCES))
        if name == "maxDrawIndexedIndexValue" and self.feature("fullDrawIndexUint32"):
            return (1 << 32) - 1
        return kind_floor[1]

    def feature(self, name: str) -> bool:
        """Whether the device has a feature; False where nothing is stated and the specification does not require it."""
        if name not in FEATURES:
            raise ProfileError(f"feature {name!r} is unknown; {_nearest(name, FEATURES)}")
        return self.features.get(name, name in REQUIRED_FEATURES)

    def format_features(self, name: str) -> frozenset[str]:
        """What an optimally tiled image of this format can do, of: sampled filter color blend depth storage."""
        name = name.removeprefix("VK_FORMAT_")
        if name not in FORMATS:
            raise ProfileError(f"format {name!r} is unknown; {_nearest(name, FORMATS)}")
        return self.formats.get(name, FORMATS[name])

    def format_has(self, name: str, *features: str) -> bool:
        """Whether the format has all of these features: `profile.format_has("R32G32_SFLOAT", "blend")`."""
        for f in features:
            if f not in FORMAT_FEATURES:
                raise ProfileError(f"format feature {f!r} is unknown; {_nearest(f, FORMAT_FEATURES)}")
        return self.format_features(name) >= set(features)

    def depth_choice(self) -> tuple[str, ...]:
        """Depth formats to try at load, best first. One entry if the profile is certain, else the two of which the
        specification promises at least one."""
        both = ("D32_SFLOAT", "X8_D24_UNORM_PACK32")
        certain = [f for f in both if self.format_has(f, "depth")]
        return (certain[0],) if certain else both

    def source(self, name: str) -> Mapping[str, str]:
        """Where a value comes from: {"source", "status"}; the entry "*" speaks for the values not named."""
        floor = {"source": "Vulkan 1.0 specification, required minimum", "status": "specified"}
        stated = name in self.limits or name in self.features or name in self.formats or name in _BLOCK
        return self.sources.get(name, self.sources.get("*", floor)) if stated else floor

    @property
    def digest(self) -> str:
        """SHA-256 of `canonical(self)`, hexadecimal: equal for profiles that the packer cannot tell apart."""
        import json

        text = json.dumps(canonical(self), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()


# ---- files ------------------------------------------------------------------------------------------------------------

def folder():
    """Where the profiles are: the package data dressi_edge.device_profiles, or device_profiles/ of the checkout."""
    import importlib.resources
    from pathlib import Path

    try:
        found = importlib.resources.files("dressi_edge.device_profiles")
        if any(f.name.endswith(".json") for f in found.iterdir()):
            return found
    except (ModuleNotFoundError, OSError):
        pass
    return Path(__file__).resolve().parents[2] / "device_profiles"


def profile_names() -> list[str]:
    """The names of the profiles that come with the product, sorted."""
    try:
        return sorted(f.name[:-5] for f in folder().iterdir() if f.name.endswith(".json"))
    except OSError:
        raise ProfileError("no device_profiles folder beside the package; reinstall, or name a .json file") from None


def _read(path, where: str) -> bytes:
    try:
        with path.open("rb") as f:
            data = f.read(MAX_FILE_BYTES + 1)
    except OSError as e:
        raise ProfileError(f"{where}: cannot be read: {e.strerror}") from None
    if len(data) > MAX_FILE_BYTES:
        raise ProfileError(f"{where}: larger than {MAX_FILE_BYTES} bytes, the most a profile may have")
    return data


def _decode(data: bytes, where: str) -> dict:
    import json

    def unique(pairs):
        if len(out := dict(pairs)) < len(pairs):
            keys = [k for k, _ in pairs]
            raise ValueError(f"key {next(k for k in keys if keys.count(k) > 1)[:60]!r} appears twice")
        return out

    def constant(word):
        raise ValueError(f"{word} is not a number of JSON")

    try:
        value = json.loads(data.decode("utf-8"), object_pairs_hook=unique, parse_constant=constant)
    except (ValueError, RecursionError) as e:
        why = "nested too deeply" if isinstance(e, RecursionError) else str(e).partition("\n")[0][:200]
        raise ProfileError(f"{where}: not JSON: {why}") from None
    return _dict(value, where)


def _show(value) -> str:
    return (text := repr(value))[:60] + ("..." if len(text) > 60 else "")


def _close(name: str, known: Iterable[str], cutoff: float) -> list[str]:
    import difflib

    return difflib.get_close_matches(name, list(known), 1, cutoff)


def _nearest(name: str, known: Iterable[str]) -> str:
    near = _close(str(name)[:80], known, 0.5)
    return f"did you mean {near[0]}?" if near else f"known: {' '.join(known)}"


def _dict(value, where: str, keys: Iterable[str] | None = None, required: bool = False) -> dict:
    if not isinstance(value, dict):
        raise ProfileError(f"{where}: must be an object, found {_show(value)}")
    for k in value if keys is not None else ():
        if k not in keys:
            raise ProfileError(f"{where}: unknown key {k[:60]!r}; {_nearest(k, keys)}")
    for k in keys if required else ():
        if k not in value:
            raise ProfileError(f"{where}: {k!r} is missing")
    return value


def _typed(value, kind: type, where: str):
    if type(value) is not kind:
        raise ProfileError(f"{where}: must be {_WORDS[kind]}, found {_show(value)}")
    return value


_WORDS = {bool: "true or false", str: "a string", list: "a list"}


def _number(value, where: str, low=0, whole=True):
    ok = type(value) is int or (not whole and type(value) is float and math.isfinite(value))
    if not ok or not low <= value < 1 << 64:
        kind = "a whole number" if whole else "a number"
        raise ProfileError(f"{where}: must be {kind} from {low} to 2^64 - 1, found {_show(value)}")
    return int(value) if value == int(value) else value


def _limit(name: str, value, where: str):
    kind, floor = LIMITS[name]
    if kind == "flag":
        return _typed(value, bool, where)
    if kind in ("max", "min"):
        return _number(value, where)
    if not isinstance(value, list | tuple) or len(value) != len(floor):
        raise ProfileError(f"{where}: must be a list of {len(floor)} numbers, found {_show(value)}")
    low, whole = (-(1 << 63), False) if kind == "range" else (0, True)
    out = tuple(_number(v, f"{where}[{i}]", low, whole) for i, v in enumerate(value))
    if kind == "range" and out[0] > out[1]:
        raise ProfileError(f"{where}: must be [low, high], found {_show(value)}")
    return out


def _parse(data: bytes, where: str) -> Profile:
    top = _dict(_decode(data, where), where, ("$schema", "capabilities", "profiles", "dressi_edge"), True)
    if not _typed(top["$schema"], str, f"{where}: $schema").startswith("https://schema.khronos.org/vulkan/profiles-"):
        raise ProfileError(f"{where}: $schema: must be a Khronos profile schema such as {SCHEMA}, found "
                           f"{_show(top['$schema'])}")
    capabilities, profiles = _dict(top["capabilities"], f"{where}: capabilities"), _dict(top["profiles"], f"{where}: profiles")
    if len(capabilities) != 1:
        raise ProfileError(f"{where}: capabilities: must hold one entry, the device, found {len(capabilities)}")
    (name, block), = capabilities.items()
    if not re.fullmatch(r"[a-z0-9_]{1,64}", name):
        raise ProfileError(f"{where}: capabilities: a name has 1 to 64 of a-z, 0-9 and _, found {_show(name)}")
    _dict(block, f"{where}: {name}", ("properties", "features", "formats"))
    at = f"{where}: VkPhysicalDeviceProperties"
    properties = _dict(block.get("properties", {}), f"{where}: properties", ("VkPhysicalDeviceProperties",))
    limits = _dict(properties.get("VkPhysicalDeviceProperties", {}), at, ("limits",)).get("limits", {})
    limits = {k: _limit(k, v, f"{where}: {k}") for k, v in _dict(limits, f"{where}: limits", LIMITS).items()}

    features = {}
    for struct, members in _dict(block.get("features", {}), f"{where}: features", sorted(set(FEATURES.values()))).items():
        allowed = [f for f, s in FEATURES.items() if s == struct]
        for k, v in _dict(members, f"{where}: {struct}", allowed).items():
            features[k] = _typed(v, bool, f"{where}: {k}")

    formats = {}
    known = [f"VK_FORMAT_{f}" for f in FORMATS]
    for k, v in _dict(block.get("formats", {}), f"{where}: formats", known).items():
        kinds = ("linearTilingFeatures", "optimalTilingFeatures", "bufferFeatures")
        v = _dict(_dict(v, f"{where}: {k}", ("VkFormatProperties",), True)["VkFormatProperties"], f"{where}: {k}", kinds, True)
        for kind, flags in v.items():
            for flag in _typed(flags, list, f"{where}: {k}: {kind}"):
                if _typed(flag, str, f"{where}: {k}: {kind}") not in _FROM_VK or kind != "optimalTilingFeatures":
                    raise ProfileError(f"{where}: {k}: {kind}: unknown flag {flag[:60]!r}; {_nearest(flag, _FROM_VK)}")
        formats[k.removeprefix("VK_FORMAT_")] = frozenset(_FROM_VK[f] for f in v["optimalTilingFeatures"])

    about = _dict(profiles.get(_profile_key(name)), f"{where}: profiles: {_profile_key(name)}")
    if len(profiles) != 1 or about.get("capabilities") != [name]:
        raise ProfileError(f"{where}: profiles: must hold only {_profile_key(name)}, of the capabilities [{name!r}]")
    version = _typed(about.get("api-version"), str, f"{where}: api-version")
    history = about.get("history")
    date = history[-1].get("date") if isinstance(history, list) and history and isinstance(history[-1], dict) else None
    if not re.fullmatch(r"\d{1,4}\.\d{1,4}\.\d{1,6}", version) or not re.fullmatch(r"\d{4}-\d\d-\d\d", _typed(
            date, str, f"{where}: history: date")):
        raise ProfileError(f"{where}: api-version must be like 1.1.0 and a date like 2025-01-31, "
                           f"found {_show(version)} and {_show(date)}")
    return Profile(name=name, limits=limits, features=features, formats=formats, api_version=version, date=date,
                   **_own(top["dressi_edge"], f"{where}: dressi_edge"))


def _own(block, where: str) -> dict:
    block = _dict(block, where, _BLOCK)
    out = {}
    for k, v in block.items():
        at = f"{where}: {k}"
        if k in ("tile_bits", "max_merged_attachments"):
            out[k] = None if v is None else _number(v, at, 1)
        elif k in ("compute", "prefer_fp16", "device_local_lazily_allocated"):
            out[k] = _typed(v, bool, at)
        elif k == "outside_read":
            if _typed(v, str, at) not in OUTSIDE_READ:
                raise ProfileError(f"{at}: must be {' or '.join(OUTSIDE_READ)}, found {_show(v)}")
            out[k] = v
        elif k == "description":
            out[k] = _typed(v, str, at)
        elif k == "quirks":
            out[k] = tuple(_typed(q, str, at) for q in _typed(v, list, at))
        else:
            out[k] = _dict(v, at, ("*", *LIMITS, *FEATURES, *FORMATS, *_BLOCK[:-1]))
            for name, entry in out[k].items():
                _dict(entry, f"{at}: {name}", ("source", "status"), True)
                if _typed(entry["status"], str, f"{at}: {name}: status") not in STATUS:
                    raise ProfileError(f"{at}: {name}: status must be one of {' '.join(STATUS)}, "
                                       f"found {_show(entry['status'])}")
                _typed(entry["source"], str, f"{at}: {name}: source")
    return out


def _profile_key(name: str) -> str:
    return f"VP_DRESSI_{name}"


def to_json(profile: Profile) -> str:
    """The file of a profile: sorted, two spaces, one newline at the end. Loading and writing it again gives the same bytes."""
    import json

    structs = {}
    for name, on in profile.features.items():
        structs.setdefault(FEATURES[name], {})[name] = on
    capability = {}
    if profile.limits:
        capability["properties"] = {"VkPhysicalDeviceProperties": {"limits": {
            k: list(v) if isinstance(v, tuple) else v for k, v in profile.limits.items()}}}
    if structs:
        capability["features"] = {k: structs[k] for k in sorted(structs)}
    if profile.formats:
        capability["formats"] = {f"VK_FORMAT_{k}": {"VkFormatProperties": {
            "linearTilingFeatures": [], "optimalTilingFeatures": sorted(FORMAT_FEATURES[f] for f in v), "bufferFeatures": []}}
            for k, v in profile.formats.items()}
    own = {k: getattr(profile, k) for k in _BLOCK[:-1]} | {"sources": {k: dict(v) for k, v in profile.sources.items()}}
    about = {"version": 1, "api-version": profile.api_version, "label": profile.name, "description": profile.description,
             "contributors": {}, "history": [{"revision": 1, "date": profile.date, "author": "dressi_edge", "comment": ""}],
             "capabilities": [profile.name]}
    top = {"$schema": SCHEMA, "capabilities": {profile.name: capability}, "profiles": {_profile_key(profile.name): about},
           "dressi_edge": own}
    text = json.dumps(top, indent=2, ensure_ascii=False)
    # one flag or one pair of numbers a line would make the files five times as long
    return re.sub(r"\[\s+([^][{}]*?)\s+\]", lambda m: "[" + re.sub(r",\s+", ", ", m[1]) + "]", text) + "\n"


# ---- what the packer and the bundle read ------------------------------------------------------------------------------

def canonical(profile: Profile) -> dict:
    """All values in force, in plain lists, dicts and numbers, without name, description and sources."""
    return {
        "limits": {k: list(v) if isinstance(v := profile.limit(k), tuple) else v for k in LIMITS},
        "features": {k: profile.feature(k) for k in FEATURES},
        "formats": {k: sorted(profile.format_features(k)) for k in FORMATS},
        "tile_bits": profile.tile_bits,
        "max_merged_attachments": profile.max_merged_attachments,
        "outside_read": profile.outside_read,
        "compute": profile.compute,
        "prefer_fp16": profile.prefer_fp16,
        "device_local_lazily_allocated": profile.device_local_lazily_allocated,
        "quirks": list(profile.quirks),
    }


def _meet(kind: str, a, b):
    """The stricter of two values of a limit."""
    if kind == "size":
        return tuple(map(min, a, b))
    if kind == "range":
        return max(a[0], b[0]), min(a[1], b[1])
    return max(a, b) if kind == "min" else min(a, b)


def _enough(kind: str, need, have) -> bool:
    return _meet(kind, need, have) == need


def merge(profiles: Iterable[Profile], name: str) -> Profile:
    """The intersection: what is allowed on every one of the profiles, in any order. Quirks add up; `sources` says whose
    value binds."""
    members = sorted(profiles, key=lambda p: (p.name, p.digest))
    if not members:
        raise ProfileError(f"profile {name!r}: nothing to merge; give at least one profile")
    limits, sources = {}, {}
    for key, (kind, _) in LIMITS.items():
        value = members[0].limit(key)
        for p in members[1:]:
            value = _meet(kind, value, p.limit(key))
        limits[key] = value
        binding = next((p for p in members if p.limits.get(key) == value), None)
        if binding is not None:
            source = binding.source(key)
            sources[key] = {"source": f"{binding.name}: {source['source']}", "status": source["status"]}
    names = " ".join(dict.fromkeys(p.name for p in members))
    worst = max((e["status"] for p in members for e in p.sources.values()), key=STATUS.index, default="specified")
    return Profile(
        name=name, description=f"What is allowed on all of: {names}", limits=limits,
        features={k: all(p.feature(k) for p in members) for k in FEATURES},
        formats={k: frozenset.intersection(*(p.format_features(k) for p in members)) for k in FORMATS},
        tile_bits=min((p.tile_bits for p in members if p.tile_bits is not None), default=None),
        max_merged_attachments=min(
            (p.max_merged_attachments for p in members if p.max_merged_attachments is not None), default=None),
        outside_read=min((p.outside_read for p in members), key=OUTSIDE_READ.index),
        compute=all(p.compute for p in members),
        prefer_fp16=all(p.prefer_fp16 for p in members),
        device_local_lazily_allocated=all(p.device_local_lazily_allocated for p in members),
        quirks=tuple(q for p in members for q in p.quirks),
        sources=sources | {"*": {"source": f"merged from {names}", "status": worst}},
        api_version=min((p.api_version for p in members), key=lambda v: tuple(map(int, v.split(".")))),
        date=max(p.date for p in members))


def check(profile: Profile) -> list[str]:
    """What is wrong with a profile, one line each; empty if it is sound. Lines that start with "note: " are no fault."""
    name, out = profile.name, []
    for table, known, what in ((profile.limits, LIMITS, "limit"), (profile.features, FEATURES, "feature"),
                               (profile.formats, FORMATS, "format")):
        out += [f"{name}: {k}: unknown {what}; {_nearest(k, known)}" for k in table if k not in known]
    for k in (k for k in profile.limits if k in LIMITS):
        kind, floor = LIMITS[k]
        try:
            value = _limit(k, profile.limits[k], f"{name}: {k}")
        except ProfileError as e:
            out.append(str(e))
            continue
        if k == "maxPerStageResources" and all(_integer(profile.limit(r)) for r in RESOURCES):
            floor = min(floor, sum(profile.limit(r) for r in RESOURCES))
        if not _enough(kind, floor, value):
            note = "note: " if profile.source(k)["status"] == "measured" else ""  # drivers do break the rule
            out.append(f"{note}{name}: {k}: {_text(value)} is worse than {_text(floor)}, the specification's minimum")
    for k, v in profile.features.items():
        if type(v) is not bool:
            out.append(f"{name}: {k}: must be true or false, found {_show(v)}")
        elif k in REQUIRED_FEATURES and not v:
            out.append(f"{name}: {k}: false, but the specification requires it")
    for k in (k for k in profile.formats if k in FORMATS):
        if strange := sorted(profile.formats[k] - set(FORMAT_FEATURES)):
            out.append(f"{name}: {k}: unknown format feature {strange[0]!r}; {_nearest(strange[0], FORMAT_FEATURES)}")
        if lacks := sorted(FORMATS[k] - profile.formats[k]):
            out.append(f"{name}: {k}: lacks {' '.join(lacks)}, which the specification requires")
        if {"blend"} <= profile.formats[k] and "color" not in profile.formats[k]:
            out.append(f"{name}: {k}: blend without color")
        if {"filter"} <= profile.formats[k] and "sampled" not in profile.formats[k]:
            out.append(f"{name}: {k}: filter without sampled")
    if all(line.startswith("note: ") for line in out):
        out += _contradictions(profile)
    if "*" not in profile.sources:
        bare = [k for t in (profile.limits, profile.features, profile.formats) for k in t if k not in profile.sources]
        out += [f"{name}: {k}: no source is given" for k in bare]
    return out


def _contradictions(p: Profile) -> list[str]:
    """Values that cannot hold together, and what looks odd but is known from real drivers (note: ...)."""
    out = []
    at_least = [("maxImageDimension2D", "maxFramebufferWidth"), ("maxImageDimension2D", "maxFramebufferHeight"),
                ("maxFragmentOutputAttachments", "maxColorAttachments"),
                ("maxFragmentCombinedOutputResources", "maxColorAttachments")]
    at_least += [(f"maxDescriptorSet{k}", f"maxPerStageDescriptor{k}") for k in (
        "Samplers", "UniformBuffers", "StorageBuffers", "SampledImages", "StorageImages", "InputAttachments")]
    for big, small in at_least:
        if p.limit(big) < p.limit(small):
            out.append(f"note: {p.name}: {big} {p.limit(big)} is below {small} {p.limit(small)}; the smaller one binds")
    for axis, key in enumerate(("maxFramebufferWidth", "maxFramebufferHeight")):
        if p.limit("maxViewportDimensions")[axis] < p.limit(key):
            out.append(f"{p.name}: maxViewportDimensions[{axis}] {p.limit('maxViewportDimensions')[axis]} is below {key} "
                       f"{p.limit(key)}; the specification forbids it")
    total = p.limit("maxPerStageResources")
    out += [f"note: {p.name}: {k} {p.limit(k)} is above maxPerStageResources {total}; the smaller one binds"
            for k in RESOURCES if p.limit(k) > total]
    if len(p.depth_choice()) > 1:
        out.append(f"note: {p.name}: whether D32_SFLOAT or X8_D24_UNORM_PACK32 is a depth attachment is decided at load")
    if p.tile_bits is not None and p.max_merged_attachments is None:
        out.append(f"note: {p.name}: tile_bits without max_merged_attachments")
    return out


def _integer(value) -> bool:
    return type(value) is int


def _text(value) -> str:
    return " ".join(map(str, value)) if isinstance(value, tuple | list) else str(value)


def misfit(needs: Mapping, profile: Profile) -> list[str]:
    """Why `needs` do not fit, one line each; empty if they do. `needs` maps a limit to a value, a feature or "compute" to
    True, a format to the format features it must have: {"maxColorAttachments": 6, "R32_SFLOAT": ["blend"]}."""
    out, name = [], profile.name
    for key in sorted(needs, key=str):
        need = needs[key]
        plain = str(key).removeprefix("VK_FORMAT_")
        if key in LIMITS:
            kind, have = LIMITS[key][0], profile.limit(key)
            need = _limit(key, need, f"needs: {key}")
            if kind == "flag":
                out += [f"{key}: needed, {name} has none"] if need and not have else []
            elif not _enough(kind, need, have):
                out.append(f"{key}: needs {_text(need)}, {name} has {_text(have)}")
        elif key in FEATURES or key == "compute":
            has = profile.compute if key == "compute" else profile.feature(key)
            if _typed(need, bool, f"needs: {key}") and not has:
                out.append(f"{key}: needed, {name} has none")
        elif plain in FORMATS:
            need = {need} if isinstance(need, str) else set(need) if isinstance(need, Iterable) else {None}
            if not all(isinstance(f, str) for f in need):
                raise ProfileError(f"needs: {plain}: must be a list of format features, found {_show(needs[key])}")
            have = profile.format_features(plain)
            if not need <= have:
                out.append(f"{plain}: needs {' '.join(sorted(need))}, {name} has {' '.join(sorted(have)) or 'nothing'}")
        else:
            out.append(f"{str(key)[:60]}: needs {_show(need)}, {name} says nothing of it")
    return out


def from_device(limits: Mapping, features: Mapping, formats: Mapping[str, Iterable[str]], name: str, *,
                description: str = "", source: str = "", **own) -> Profile:
    """The profile of a device at hand. Takes all that a driver reports (keys not known here are left out); `formats` maps a
    format to optimal-tiling features, by Vulkan's names or ours; `own` are further fields of Profile."""
    names = {f.removeprefix("VK_FORMAT_"): v for f, v in formats.items()}
    return Profile(
        name=name, description=description,
        limits={k: _limit(k, _plain(k, limits[k]), f"{name}: {k}") for k in LIMITS if k in limits},
        features={k: bool(features[k]) for k in FEATURES if k in features},
        formats={k: frozenset(_FROM_VK.get(f, f) for f in names[k] if f in _FROM_VK or f in FORMAT_FEATURES)
                 for k in FORMATS if k in names},
        **{"sources": {"*": {"source": source or f"reported by the driver of {name}", "status": "measured"}}, **own})


def _plain(name: str, value):
    """A limit as a driver gives it (VkBool32, C array) in Python's types."""
    kind = LIMITS[name][0]
    return bool(value) if kind == "flag" else tuple(value) if kind in ("size", "range") else value


def from_khronos(data: bytes | str, name: str, **own) -> Profile:
    """The profile in a file of vulkaninfo --json or gpuinfo.org: like `from_device`, from all its capabilities together."""
    top = _decode(data.encode() if isinstance(data, str) else data, name)
    limits, features, formats = {}, {}, {}
    for block in _dict(top.get("capabilities"), f"{name}: capabilities").values():
        block = _dict(block, f"{name}: capabilities")
        properties = _dict(block.get("properties", {}), f"{name}: properties").get("VkPhysicalDeviceProperties", {})
        limits |= _dict(_dict(properties, f"{name}: properties").get("limits", {}), f"{name}: limits")
        for members in _dict(block.get("features", {}), f"{name}: features").values():
            features |= _dict(members, f"{name}: features")
        for k, v in _dict(block.get("formats", {}), f"{name}: formats").items():
            formats[k] = _dict(_dict(v, k).get("VkFormatProperties", {}), k).get("optimalTilingFeatures", [])
    return from_device(limits, features, formats, name, **own)
