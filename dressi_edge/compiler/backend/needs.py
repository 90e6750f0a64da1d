"""What a bundle needs of a device: the limits and format features it really uses, counted from its description, and what its shaders
take for granted."""
from __future__ import annotations

from collections.abc import Sequence

from ...cache import vulkan as v
from ...cache.profile import Profile
from ...cache.spirv_interface import Interface


def needs(d: dict, profile: Profile, interfaces: Sequence[Interface] = (), grid: bool = False) -> dict:
    """{"limits": {Vulkan limit: value}, "formats": {format: [features]}} of a description for a profile. `interfaces`: of its shaders, in
    their order. `grid`: a shader relies on the profile's subPixelPrecisionBits; whoever samples with a filter on subTexelPrecisionBits."""
    limits: dict[str, int] = {}

    def need(name: str, x: int) -> None:
        if x:
            limits[name] = max(limits.get(name, 0), x)

    for image in d["images"]:
        need("maxImageDimension2D", max(image["width"], image["height"]))
    for p in d["passes"]:
        for s in p["subpasses"]:
            for name in ("maxColorAttachments", "maxFragmentOutputAttachments", "maxFragmentCombinedOutputResources"):
                need(name, len(s["colors"]))
    for p in d["pipelines"]:
        colors = len(d["passes"][p["pass"]]["subpasses"][p["subpass"]]["colors"])
        sampled = [b for b in p["bindings"] if b[0] != v.DESCRIPTOR_INPUT_ATTACHMENT]
        samplers = [b for b in p["bindings"] if b[0] == v.DESCRIPTOR_COMBINED_IMAGE_SAMPLER]
        inputs = [b for b in p["bindings"] if b[0] == v.DESCRIPTOR_INPUT_ATTACHMENT]
        need("maxDescriptorSetSampledImages", len(sampled))
        need("maxDescriptorSetSamplers", len(samplers))
        need("maxDescriptorSetInputAttachments", len(inputs))
        need("maxPerStageDescriptorInputAttachments", len(inputs))
        for stage in (v.STAGE_VERTEX, v.STAGE_FRAGMENT):
            need("maxPerStageDescriptorSampledImages", sum(bool(b[1] & stage) for b in sampled))
            need("maxPerStageDescriptorSamplers", sum(bool(b[1] & stage) for b in samplers))
            need("maxPerStageResources", sum(bool(b[1] & stage) for b in p["bindings"]) + colors * (stage == v.STAGE_FRAGMENT))
    for c in d.get("computes", ()):
        kinds = [kind for kind, _ in c["bindings"]]
        samplers = kinds.count(v.DESCRIPTOR_COMBINED_IMAGE_SAMPLER)
        for of in ("maxPerStageDescriptor", "maxDescriptorSet"):
            need(f"{of}SampledImages", len(kinds))
            need(f"{of}Samplers", samplers)
            need(f"{of}StorageImages", len(c["outputs"]))
        need("maxPerStageResources", len(kinds) + len(c["outputs"]))
    for stage in (stage for plan in d["plans"] for stage in plan["stages"] if "compute" not in stage):
        need("maxFramebufferWidth", stage["width"])
        need("maxFramebufferHeight", stage["height"])
    if grid:
        need("subPixelPrecisionBits", profile.limit("subPixelPrecisionBits"))
    if any(b[0] == v.DESCRIPTOR_COMBINED_IMAGE_SAMPLER for p in (*d["pipelines"], *d.get("computes", ())) for b in p["bindings"]):
        need("subTexelPrecisionBits", profile.limit("subTexelPrecisionBits"))
    for shader in interfaces:
        if shader.stage == v.STAGE_COMPUTE:
            x, y, z = shader.local_size
            need("maxComputeWorkGroupInvocations", x * y * z)
            need("maxComputeSharedMemorySize", shader.shared_bytes)
            continue
        vertex = shader.stage == v.STAGE_VERTEX
        need("maxVertexOutputComponents" if vertex else "maxFragmentInputComponents",
             shader.output_components if vertex else shader.input_components)
    formats: dict[str, set[str]] = {}
    filtered = {ref // 2 for plan in d["plans"] for stage in plan["stages"] for images, bindings in _bound(stage, d)
                for ref, b in zip(images, bindings) if b[0] == v.DESCRIPTOR_COMBINED_IMAGE_SAMPLER}
    for k, image in enumerate(d["images"]):
        if image["format"]:
            wanted = formats.setdefault(v.FORMAT_NAMES[image["format"]], set())
            wanted.update(f for bit, f in ((v.USAGE_SAMPLED, "sampled"), (v.USAGE_COLOR, "color"),
                                                  (v.USAGE_STORAGE, "storage")) if image["usage"] & bit)
            if k in filtered:
                wanted.add("filter")
    return {"limits": dict(sorted(limits.items())), "formats": {name: sorted(f) for name, f in sorted(formats.items())}}


def _bound(stage: dict, d: dict) -> list[tuple[list, list]]:
    """The images that each draw or dispatch of a stage reads, and their bindings."""
    if "compute" in stage:
        return [(stage["images"], d["computes"][stage["compute"]]["bindings"])]
    return [(draw["images"], d["pipelines"][draw["pipeline"]]["bindings"]) for draws in stage["subpasses"] for draw in draws]


def shadowed(descriptions: list[dict]) -> dict[str, str]:
    """Of variants in order of preference, each (its profile's name) that no device takes for what it has, and the one before it that
    is taken instead: a device with all that the later one needs has all that the earlier one needs."""
    found: dict[str, str] = {}
    for k, later in enumerate(descriptions):
        for earlier in descriptions[:k]:
            limits, formats = (earlier["needs"][key] for key in ("limits", "formats"))
            if all(x <= later["needs"]["limits"].get(name, 0) for name, x in limits.items()) \
                    and all(set(f) <= set(later["needs"]["formats"].get(name, ())) for name, f in formats.items()) \
                    and set(later["depth_formats"]) <= set(earlier["depth_formats"]):
                found.setdefault(later["profile"]["name"], earlier["profile"]["name"])
    return found
