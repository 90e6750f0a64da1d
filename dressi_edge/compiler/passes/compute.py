"""Which substages are dispatched instead of drawn, where a profile has the limits for it.

In: the stages of a plan with their domains. Out: the same, with `Substage.compute` set on those of pixelwise work that one invocation a
texel can do: a stage of one substage, none of geometry, whose outputs have formats that shaders write without a feature, within the
profile's storage images, resources and workgroups. The rest is drawn as before. What a texel is given is the same either way, and so
are the images (`tests/test_compute.py`). What goes through a list is dispatched as far as that goes: a stage of one texel before it says
how many workgroups that are.
"""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ...cache import vulkan as v
from ...cache.errors import InputError, PackError
from ...cache.limits import COMPUTE
from ...cache.profile import Profile
from ..graph.formats import format_number, format_of
from ..graph.ir import UNIT, Extent
from ..graph.optable import COUNT, FILTERED, apply
from .substage import FULL, LISTED, TEXELS, TILES, Domain, Stage, Substage, substage

NONE, OPS, PIXEL, ALL = COMPUTE
GROUP = 64  # invocations of a workgroup: every device has 128
NARROW = 8  # images of fewer columns are run through row by row, so that neighbours in number are neighbours in a workgroup


def choose(compute: str | None, profile: Profile) -> str:
    """What is computed for this profile: as asked for, or as the profile prefers. Raises InputError."""
    if compute not in (None, *COMPUTE):
        raise InputError(f"compute is {compute!r:.60}; allowed: {' '.join(COMPUTE)}")
    return compute or profile.compute


def local_size(extent: Extent) -> tuple[int, int]:
    """Columns and rows of a workgroup over an image; of a narrow one, its entries in a row."""
    return (GROUP, 1) if extent.width < NARROW else (8, GROUP // 8)


def groups(extent: Extent) -> tuple[int, int]:
    """How many workgroups cover an image."""
    width, height = local_size(extent)
    columns, rows = (extent.width * extent.height, 1) if extent.width < NARROW else (extent.width, extent.height)
    return -(-columns // width), -(-rows // height)


def in_rows(s: Substage) -> int | None:
    """Of what is dispatched as far as a list goes, entry after entry, how many workgroups all entries take; None of what is not."""
    return None if s.count is None else -(-s.extent.width * s.extent.height // GROUP)


def shape(s: Substage) -> tuple[tuple[int, int], tuple[int, int]]:
    """Columns and rows of its workgroups, and how many of them along x and y."""
    many = in_rows(s)
    return (local_size(s.extent), groups(s.extent)) if many is None else ((GROUP, 1), (many, 1))


def spread(count: int) -> tuple[int, int]:
    """So many workgroups and perhaps a few more, along x and y: no device takes less than 65535 along one."""
    across = min(count, 1 << 15)
    return across, -(-count // across)


def room(kind: str, profile: Profile) -> int | None:
    """Bytes that the workgroups of kernels share; None where there are to be none, or the profile has no place for them."""
    able = kind != NONE and min(profile.limit("maxComputeWorkGroupInvocations"), profile.limit("maxComputeWorkGroupSize")[0]) >= GROUP \
        and min(profile.limit(f"{of}StorageImages") for of in ("maxPerStageDescriptor", "maxDescriptorSet")) > 0 \
        and min(profile.limit("maxComputeWorkGroupCount")[:2]) >= 1 << 15 and profile.format_has("R32_SINT", "storage")
    return profile.limit("maxComputeSharedMemorySize") if able else None


def hindrance(stage: Stage, profile: Profile) -> str:
    """Why a stage is drawn and not dispatched, in words; nothing if it need not be."""
    if len(stage.substages) > 1:
        return "several substages in one pass"
    s = stage.substages[0]
    if s.raster:
        return "geometry"
    if s.kernel:
        return "; ".join(excess(s, profile))
    for n in s.outputs:
        if format_number(n) not in v.STORABLE.values():
            return f"{format_of(n)} takes a feature to be written"
        if not profile.format_has(format_of(n), "storage"):
            return f"{format_of(n)} is no storage image"
    return "; ".join(excess(s, profile))


def excess(s: Substage, profile: Profile) -> list[str]:
    """What breaks a limit if it is dispatched, one line each."""
    images = {(x, m == FILTERED) for x, m in s.reads if m != COUNT}
    sampled = len(images) + (s.domain.kind == TILES and (s.domain.by, False) not in images) + (s.domain.kind == LISTED)
    kernel = s.nodes[0].op.kernel_of(s.nodes[0]) if s.kernel else None
    width, height = (kernel.lanes, 1) if kernel else shape(s)[0]
    counts = {"maxPerStageDescriptorStorageImages": len(s.outputs), "maxDescriptorSetStorageImages": len(s.outputs),
              "maxPerStageDescriptorSampledImages": sampled, "maxDescriptorSetSampledImages": sampled,
              "maxPerStageDescriptorSamplers": sum(filtered for _, filtered in images), "maxPerStageResources": sampled + len(s.outputs),
              "maxComputeWorkGroupInvocations": width * height, "maxComputeSharedMemorySize": kernel.room if kernel else 0}
    lines = [f"needs {found} {name}; profile {profile.name} allows {profile.limit(name):g}"
             for name, found in counts.items() if found > profile.limit(name)]
    many = spread(kernel.groups(s.nodes[0])) if kernel else shape(s)[1]
    for name, found in (("maxComputeWorkGroupSize", (width, height, 1)), ("maxComputeWorkGroupCount", (*many, 1))):
        if any(map(int.__gt__, found, profile.limit(name))):
            lines.append(f"needs {found} {name}; profile {profile.name} allows {profile.limit(name)}")
    return lines


def find_compute(stages: Sequence[Stage], profile: Profile, kind: str) -> tuple[Stage, ...]:
    """The stages, those that can be dispatched so as far as `kind` asks for it; kernels always are. Raises PackError."""
    def wanted(stage: Stage) -> bool:
        s = stage.substages[0]
        if s.kernel and (why := hindrance(stage, profile)):
            raise PackError(f"{s.nodes[0].op.name} {why}; take fewer entries, or compute='none', which draws")
        return s.kernel or kind == ALL or kind == PIXEL and s.domain.kind in (FULL, TEXELS)

    return _counted([stage if not wanted(stage) or hindrance(stage, profile) else
                     replace(stage, substages=(replace(stage.substages[0], compute=True),)) for stage in stages], profile)


def _counted(stages: Sequence[Stage], profile: Profile) -> tuple[Stage, ...]:
    """The stages, those that are dispatched over lists as far as these go, each after one that says how far."""
    found, said = [], {}
    for stage in stages:
        s = stage.substages[0]
        if s.compute and s.domain.kind == LISTED:
            most = -(-s.extent.width * s.extent.height // GROUP)
            count = apply("group_count", s.domain.by, each=GROUP, most=most)
            listed = Stage(stage.extent, (replace(s, count=count),))
            before = Stage(UNIT, (replace(substage([count], [count]), domain=Domain(outside=(None,)), compute=True),))
            if not hindrance(listed, profile) and not hindrance(before, profile):
                found += [] if count in said else [before]
                said[count], stage = None, listed
        found.append(stage)
    return tuple(found)
