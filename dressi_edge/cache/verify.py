"""Whether a bundle keeps a profile: every limit that its passes can break, counted anew from the description.

In: a checked description, a `Profile`, and the interfaces of its shaders (`Bundle.interfaces`). Out: one line for each thing
that breaks a limit. Shares nothing with the packer: it looks at what the driver will be given, not at how that came about.

Limits that no bundle can break are not here: there are no buffers but those of the transfers, one layer, one
viewport and one level, no blending, and draws are not indexed, so that maxDrawIndexedIndexValue bounds nothing.
"""
from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from . import vulkan as v
from .profile import Profile
from .spirv_interface import Interface

FORMAT_NAMES = {**v.FORMAT_NAMES, **{number: name for name, number in v.DEPTH_FORMATS.items()}}
MEMORY_TYPES = 32  # VK_MAX_MEMORY_TYPES: a session allocates once a memory type, and once for its transfers
DECLARED = {"subPixelPrecisionBits": "bits of the grid to which corners are rounded",
            "subTexelPrecisionBits": "bits of the weights of a filter"}
USAGE_FEATURES = ((v.USAGE_SAMPLED, "sampled"), (v.USAGE_COLOR, "color"), (v.USAGE_INPUT, "color"), (v.USAGE_STORAGE, "storage"))
# descriptor kind: what it counts against; a combined sampler is a sampler and a sampled image, but one resource
DESCRIPTORS = {v.DESCRIPTOR_COMBINED_IMAGE_SAMPLER: ("Samplers", "SampledImages"),
               v.DESCRIPTOR_SAMPLED_IMAGE: ("SampledImages",), v.DESCRIPTOR_INPUT_ATTACHMENT: ("InputAttachments",),
               v.DESCRIPTOR_STORAGE_IMAGE: ("StorageImages",)}
WORDS = {"Samplers": "samplers", "SampledImages": "sampled images", "InputAttachments": "input attachments",
         "StorageImages": "storage images"}
STAGES = ((v.STAGE_VERTEX, "vertex"), (v.STAGE_FRAGMENT, "fragment"))


def violations(description: Mapping, profile: Profile, interfaces: Sequence[Interface] | None = None) -> list[str]:
    """What breaks the profile, one line each, in the order of the description; empty if it fits. Without `interfaces` what the
    shaders pass from vertex to fragment is not counted. Checked:

    images      maxImageDimension2D; format features for what is done with them: sampled, color (input attachments too), storage,
                filter, and one depth format that the profile promises; maxMemoryAllocationCount
    samplers    maxSamplerAllocationCount
    stages      maxFramebufferWidth, maxFramebufferHeight; of cells: maxViewportDimensions, viewportBoundsRange
    subpasses   maxColorAttachments, maxFragmentOutputAttachments, maxFragmentCombinedOutputResources; with several colours:
                their bits a pixel together within tile_bits (a single colour always passes, however wide)
    passes      of several subpasses: the distinct colour and input attachments of the pass within max_merged_attachments, and
                their bits a pixel together within tile_bits
    shaders     what they take for granted: subPixelPrecisionBits and subTexelPrecisionBits, as the bundle's needs tell, for no
                count of the description finds them
    pipelines   maxPerStageDescriptor and maxDescriptorSet of Samplers, SampledImages, InputAttachments; maxPerStageResources,
                of the fragment stage with the colours; maxBoundDescriptorSets; maxVertexOutputComponents and
                maxFragmentInputComponents, where every location counts four and the built-ins what they have
    compute     of descriptors and resources the same; of shaders maxComputeWorkGroupSize, maxComputeWorkGroupInvocations and
                maxComputeSharedMemorySize; of stages maxComputeWorkGroupCount
    """
    return list(_Count(description, profile, interfaces).lines())


class _Count:
    def __init__(self, d: Mapping, profile: Profile, interfaces: Sequence[Interface] | None):
        self.d, self.profile, self.interfaces = d, profile, interfaces
        self.pass_at: dict[int, str] = {}
        self.pipeline_at: dict[int, str] = {}
        self.filtered: set[int] = set()
        self.compute_at: dict[int, str] = {}
        for plan in d["plans"]:
            name = plan["name"] if plan["name"].isprintable() else ascii(plan["name"])
            for k, stage in enumerate(plan["stages"]):
                if "compute" in stage:
                    self.compute_at.setdefault(stage["compute"], f"{name}.stages[{k}]")
                    self.filtered.update(ref // 2 for ref, (kind, _) in zip(stage["images"], d["computes"][stage["compute"]]["bindings"])
                                         if kind == v.DESCRIPTOR_COMBINED_IMAGE_SAMPLER)
                    continue
                self.pass_at.setdefault(stage["pass"], f"{name}.stages[{k}]")
                for j, draws in enumerate(stage["subpasses"]):
                    for draw in draws:
                        self.pipeline_at.setdefault(draw["pipeline"], f"{name}.stages[{k}].subpasses[{j}]")
                        for ref, b in zip(draw["images"], d["pipelines"][draw["pipeline"]]["bindings"]):
                            if b[0] == v.DESCRIPTOR_COMBINED_IMAGE_SAMPLER:
                                self.filtered.add(ref // 2)

    def lines(self) -> Iterator[str]:
        """All that breaks the profile, in the order of the description."""
        yield from self.images()
        for k, p in enumerate(self.d["passes"]):
            yield from self.render_pass(self.pass_at.get(k, "unused"), k, p)
        for k, p in enumerate(self.d["pipelines"]):
            yield from self.pipeline(f"{self.pipeline_at.get(k, 'unused')} (pipeline {k})", p)
        for k, c in enumerate(self.d.get("computes", ())):
            yield from self.compute(f"{self.compute_at.get(k, 'unused')} (compute {k})", c)
        for plan in self.d["plans"]:
            name = plan["name"] if plan["name"].isprintable() else ascii(plan["name"])
            for k, stage in enumerate(plan["stages"]):
                yield from self.stage(f"{name}.stages[{k}]", stage)
        for name, words in DECLARED.items():
            yield from self.limit("what its shaders do", self.d["needs"]["limits"].get(name, 0), words, name)

    def limit(self, where: str, found: int, what: str, limit: str) -> Iterator[str]:
        """A line if more is found than the limit allows."""
        allowed = self.profile.limit(limit)
        if found > allowed:
            yield f"{where} needs {found} {what}; profile {self.profile.name} allows {allowed} ({limit})"

    # ---- what there is

    def images(self) -> Iterator[str]:
        """Of images, samplers and memory."""
        profile, images = self.profile, self.d["images"]
        for k, image in enumerate(images):
            where = f"images[{k}]"
            yield from self.limit(where, max(image["width"], image["height"]), "texels a side", "maxImageDimension2D")
            if image["format"]:
                wanted = {feature: None for bit, feature in USAGE_FEATURES if image["usage"] & bit}
                if k in self.filtered:
                    wanted["filter"] = None
                name = FORMAT_NAMES[image["format"]]
                for feature in wanted:
                    if not profile.format_has(name, feature):
                        yield f"{where} needs {name} with {feature}; profile {profile.name} has {self.features(name)}"
        if any(image["format"] == 0 for image in images):
            offered = [FORMAT_NAMES[f] for f in self.d["depth_formats"]]
            promised = profile.depth_choice()
            if not any(profile.format_has(name, "depth") for name in offered) and not set(promised) <= set(offered):
                yield (f"depth_formats needs a depth attachment, of {' '.join(offered) or 'none'}; profile {profile.name} "
                       f"promises one of {' '.join(promised)}")
        yield from self.limit("samplers", len(self.d["samplers"]), "samplers", "maxSamplerAllocationCount")
        kinds = {(image["format"], image["usage"]) for image in images}
        yield from self.limit("images", min(len(kinds), MEMORY_TYPES) + 1, "memory allocations", "maxMemoryAllocationCount")

    def features(self, name: str) -> str:
        """What the profile says of a format, in words."""
        return " ".join(sorted(self.profile.format_features(name))) or "nothing"

    # ---- passes and stages

    def render_pass(self, where: str, number: int, p: Mapping) -> Iterator[str]:
        """Of a render pass and its subpasses."""
        profile, merged = self.profile, {}
        for k, s in enumerate(p["subpasses"]):
            at = f"{where}.subpasses[{k}] (pass {number})"
            colors = len(s["colors"])
            yield from self.limit(at, colors, "colour attachments", "maxColorAttachments")
            yield from self.limit(at, colors, "fragment outputs", "maxFragmentOutputAttachments")
            yield from self.limit(at, colors, "fragment output resources", "maxFragmentCombinedOutputResources")
            if colors > 1:
                yield from self.tile(at, p, s["colors"])
            merged.update(dict.fromkeys([*s["colors"], *s["inputs"]]))
        if len(p["subpasses"]) > 1:
            at, most = f"{where} (pass {number}, {len(p['subpasses'])} subpasses)", profile.max_merged_attachments
            if most is not None and len(merged) > most:
                yield (f"{at} needs {len(merged)} merged attachments; profile {profile.name} allows {most} "
                       "(max_merged_attachments)")
            yield from self.tile(at, p, merged)

    def tile(self, where: str, p: Mapping, attachments) -> Iterator[str]:
        """A line if these attachments do not fit the tile."""
        most = self.profile.tile_bits
        bits = sum(8 * v.TEXEL_BYTES[p["attachments"][a]["format"]] for a in attachments)
        if most is not None and bits > most:
            yield f"{where} needs {bits} bits of tile colour a pixel; profile {self.profile.name} allows {most} (tile_bits)"

    def stage(self, where: str, stage: Mapping) -> Iterator[str]:
        """Of a stage's framebuffer and viewports, or of its workgroups."""
        if "compute" in stage:
            yield from self.sizes(where, stage["groups"], "workgroups", "maxComputeWorkGroupCount")
            return
        yield from self.limit(where, stage["width"], "pixels of framebuffer width", "maxFramebufferWidth")
        yield from self.limit(where, stage["height"], "pixels of framebuffer height", "maxFramebufferHeight")
        size, (low, high) = self.profile.limit("maxViewportDimensions"), self.profile.limit("viewportBoundsRange")
        for j, draws in enumerate(stage["subpasses"]):
            for draw in draws:
                for x, y, w, h in draw["cells"]:
                    at = f"{where}.subpasses[{j}] (pipeline {draw['pipeline']})"
                    if w > size[0] or h > size[1]:
                        yield (f"{at} needs a viewport of {w} x {h}; profile {self.profile.name} allows {size[0]} x {size[1]} "
                               "(maxViewportDimensions)")
                        break
                    if min(x, y) < low or max(x + w, y + h) > high:
                        yield (f"{at} needs a viewport from {min(x, y)} to {max(x + w, y + h)}; profile {self.profile.name} "
                               f"allows {low:g} to {high:g} (viewportBoundsRange)")
                        break

    # ---- pipelines

    def sizes(self, where: str, found: Sequence[int], what: str, limit: str) -> Iterator[str]:
        """A line if there is more along an axis than the limit allows."""
        allowed = self.profile.limit(limit)
        if any(map(int.__gt__, found, allowed)):
            yield (f"{where} needs {' x '.join(map(str, found))} {what}; profile {self.profile.name} allows "
                   f"{' x '.join(map(str, allowed))} ({limit})")

    def compute(self, where: str, c: Mapping) -> Iterator[str]:
        """Of a compute pipeline's descriptors, and of its workgroups."""
        kinds = [*(kind for kind, _ in c["bindings"]), *(v.DESCRIPTOR_STORAGE_IMAGE for _ in c["outputs"])]
        yield from self.limit(where, 1, "descriptor sets", "maxBoundDescriptorSets")
        for group, words in WORDS.items():
            found = sum(group in DESCRIPTORS[kind] for kind in kinds)
            yield from self.limit(where, found, f"{words} in its set", f"maxDescriptorSet{group}")
            yield from self.limit(where, found, f"{words} in its shader", f"maxPerStageDescriptor{group}")
        yield from self.limit(where, len(kinds), "resources in its shader", "maxPerStageResources")
        if self.interfaces is not None:
            shader = self.interfaces[c["shader"]]
            yield from self.sizes(where, shader.local_size, "invocations in a workgroup", "maxComputeWorkGroupSize")
            x, y, z = shader.local_size
            yield from self.limit(where, x * y * z, "invocations in a workgroup", "maxComputeWorkGroupInvocations")
            yield from self.limit(where, shader.shared_bytes, "bytes of memory that a workgroup shares", "maxComputeSharedMemorySize")

    def pipeline(self, where: str, p: Mapping) -> Iterator[str]:
        """Of a pipeline's descriptors, and of what its shaders pass on."""
        colors = len(self.d["passes"][p["pass"]]["subpasses"][p["subpass"]]["colors"])
        yield from self.limit(where, int(bool(p["bindings"])), "descriptor sets", "maxBoundDescriptorSets")
        whole = dict.fromkeys(WORDS, 0)
        for kind, _, _ in p["bindings"]:
            for group in DESCRIPTORS[kind]:
                whole[group] += 1
        for group, found in whole.items():
            yield from self.limit(where, found, f"{WORDS[group]} in its set", f"maxDescriptorSet{group}")
        for bit, name in STAGES:
            mine = [kind for kind, stages, _ in p["bindings"] if stages & bit]
            for group, words in WORDS.items():
                found = sum(group in DESCRIPTORS[kind] for kind in mine)
                yield from self.limit(where, found, f"{words} in its {name} shader", f"maxPerStageDescriptor{group}")
            found = len(mine) + (colors if bit == v.STAGE_FRAGMENT else 0)
            yield from self.limit(where, found, f"resources in its {name} shader", "maxPerStageResources")
        if self.interfaces is not None:
            vertex, fragment = self.interfaces[p["vertex"]], self.interfaces[p["fragment"]]
            yield from self.limit(where, vertex.output_components, "vertex output components", "maxVertexOutputComponents")
            yield from self.limit(where, fragment.input_components, "fragment input components", "maxFragmentInputComponents")
