"""Whether a profile is sound. In: a `Profile`. Out: what is wrong with it, a line each."""

from __future__ import annotations

from .errors import ProfileError
from .limits import FEATURES, FORMAT_FEATURES, FORMATS, LIMITS, REQUIRED_FEATURES, RESOURCES, enough, limit_value, nearest, show, text_of
from .profile import Profile


def check(profile: Profile) -> list[str]:
    """What is wrong with a profile, one line each; empty if it is sound. Lines that start with "note: " are no fault."""
    name, out = profile.name, []
    for table, known, what in ((profile.limits, LIMITS, "limit"), (profile.features, FEATURES, "feature"),
                               (profile.formats, FORMATS, "format")):
        out += [f"{name}: {k}: unknown {what}; {nearest(k, known)}" for k in table if k not in known]
    for k in (k for k in profile.limits if k in LIMITS):
        kind, floor = LIMITS[k]
        try:
            value = limit_value(k, profile.limits[k], f"{name}: {k}")
        except ProfileError as e:
            out.append(str(e))
            continue
        if k == "maxPerStageResources" and all(_integer(profile.limit(r)) for r in RESOURCES):
            floor = min(floor, sum(profile.limit(r) for r in RESOURCES))
        if not enough(kind, floor, value):
            note = "note: " if profile.source(k)["status"] == "measured" else ""  # drivers do break the rule
            out.append(f"{note}{name}: {k}: {text_of(value)} is worse than {text_of(floor)}, the specification's minimum")
    for k, v in profile.features.items():
        if type(v) is not bool:
            out.append(f"{name}: {k}: must be true or false, found {show(v)}")
        elif k in REQUIRED_FEATURES and not v:
            out.append(f"{name}: {k}: false, but the specification requires it")
    for k in (k for k in profile.formats if k in FORMATS):
        if strange := sorted(profile.formats[k] - set(FORMAT_FEATURES)):
            out.append(f"{name}: {k}: unknown format feature {strange[0]!r}; {nearest(strange[0], FORMAT_FEATURES)}")
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
