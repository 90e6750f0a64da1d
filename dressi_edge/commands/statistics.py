"""What a driver's compiler made of a bundle's shaders: registers, spills, waves, cycles, in the driver's own words and in ours.

In: a device opened with `statistics=True` and a checked bundle. Out: `Compiled`, one a pipeline. Drivers tell by
VK_KHR_pipeline_executable_properties, each with names of its own; NAMES says which of them mean the same.
"""
from __future__ import annotations

import time
from collections.abc import Callable, Container
from dataclasses import dataclass
from typing import NamedTuple

from ..cache.errors import DeviceError
from ..cache.summary import image_bytes, size
from ..runtime import vk
from ..runtime.memory import requirements
from ..runtime.pipelines import Compute, Pipelines

# Ours -> the drivers' (RADV, Turnip, Honeykrisp, NVK, PanVK, V3DV, PowerVR), those of one driver added up.
NAMES = {
    "registers": ("VGPRs", "Registers used", "GPRs", "Number of GPRs"),
    "spills": ("Spilled VGPRs", "Spilled SGPRs", "STP Count", "Spills", "Spills to memory", "TMU Spills"),
    "waves": ("Subgroups per SIMD", "Max Waves Per Core", "Threads", "Max warps/SM", "Thread Count"),
    "instructions": ("Instructions", "Instruction Count", "Instruction count"),
    "cycles": ("Inverse Throughput", "Cycles", "Static cycle count"),
}
LEAST = ("waves",)  # of several executables the least counts, of everything else the most


class Place(NamedTuple):
    """The first draw of a pipeline: plan, number of the stage and of the substage in it, size, vertices, pixels of its cells. Of one of
    compute the first dispatch: size and pixels are those of the first image that it writes, and it has no vertices."""

    plan: str
    stage: int
    substage: int
    width: int
    height: int
    vertices: int
    pixels: int

    def __str__(self) -> str:
        return f"{self.plan}[{self.stage}.{self.substage}] {self.width} x {self.height}"


@dataclass(frozen=True)
class Compiled:
    """One pipeline. place: where it is drawn, None if nowhere. ms: its creation. executables: (name, VkShaderStageFlags, the driver's
    numbers), empty where it tells nothing."""

    place: Place | None
    ms: float
    executables: tuple[tuple[str, int, dict[str, int | float]], ...]

    def told(self, what: str) -> int | float | None:
        """The number of that name of ours over all executables; None where the driver has none."""
        found = [sum(numbers.values()) for _, _, told in self.executables
                 if (numbers := {name: told[name] for name in NAMES[what] if name in told})]
        return (min if what in LEAST else max)(found) if found else None


    def record(self) -> dict:
        """All of it for JSON."""
        return {"place": self.place and self.place._asdict(), "ms": self.ms, **{name: self.told(name) for name in NAMES},
                "executables": [{"name": name, "stages": stages, "told": told} for name, stages, told in self.executables]}


def places(d: dict) -> dict[int, Place]:
    """Pipeline number -> the first draw of it; those of compute are counted on from the others."""
    found: dict[int, Place] = {}
    for plan in d["plans"]:
        for k, stage in enumerate(plan["stages"]):
            if "compute" in stage:
                width, height = size(d, stage)
                found.setdefault(len(d["pipelines"]) + stage["compute"], Place(plan["name"], k, 0, width, height, 0, width * height))
                continue
            for j, draws in enumerate(stage["subpasses"]):
                for draw in draws:
                    pixels = sum(cell[2] * cell[3] for cell in draw["cells"])
                    found.setdefault(draw["pipeline"], Place(plan["name"], k, j, stage["width"], stage["height"], draw["vertices"], pixels))
    return found


class _Timed(Pipelines):
    """Pipelines, those of compute after the others, and how long each took; of those that are not asked for nothing is made."""

    def __init__(self, asked: Container[int], *arguments):
        self.asked, self.ms = asked, []
        super().__init__(*arguments)

    def _pipeline(self, p: dict, layout: int, cache: int) -> int:
        return self._timed(0, super()._pipeline, p, layout, cache)

    def _compute(self, c: dict, cache: int) -> Compute:
        return self._timed(Compute(0, 0, 0, ()), super()._compute, c, cache)

    def _timed(self, nothing, make: Callable, *arguments):
        start = time.perf_counter()
        made = make(*arguments) if len(self.ms) in self.asked else nothing
        self.ms.append((time.perf_counter() - start) * 1e3)
        return made


def compiled(device, bundle, plan: str | None = None) -> list[Compiled]:
    """Every pipeline of the bundle (one variant), or those that are first drawn in this plan, compiled on the device: no cache, no images.
    Raises DeviceError where the device cannot make one."""
    d = bundle.description
    where = places(d)
    asked = [k for k in range(len(d["pipelines"]) + len(d.get("computes", ()))) if plan is None or k in where and where[k].plan == plan]
    made = _Timed(set(asked), device, bundle, _depth_format(device, d))
    try:
        pipelines = [*made.pipelines, *(c.pipeline for c in made.computes)]
        return [Compiled(where.get(k), made.ms[k], _executables(device, pipelines[k])) for k in asked]
    finally:
        made.close()


def _depth_format(device, d: dict) -> int:
    able = [f for f in d["depth_formats"] if device.format_features(f)[1] & vk.VK_FORMAT_FEATURE_DEPTH_STENCIL_ATTACHMENT_BIT]
    if not able and not all(image["format"] for image in d["images"]):
        raise DeviceError(f"none of the depth formats {d['depth_formats']} is a depth attachment of {device.name}")
    return able[0] if able else 0


def image_memory(device, bundle) -> tuple[int, int]:
    """Bytes of all images of the bundle: their texels alone, and as the device lays them out. Nothing is allocated."""
    d, raw, taken = bundle.description, 0, 0
    depth = _depth_format(device, d)
    for record in d["images"]:
        raw += image_bytes(record) * record["slots"]
        taken += requirements(device, record, depth).size * record["slots"]
    return raw, taken


def _executables(device, pipeline: int) -> tuple:
    if not device.statistics:
        return ()
    properties = vk.GetPipelineExecutablePropertiesKHR(device.instance, device.device, vk.VkPipelineInfoKHR(pipeline=pipeline))
    return tuple((p.name.decode(errors="replace"), p.stages, {s.name.decode(errors="replace"): _number(s)
                  for s in vk.GetPipelineExecutableStatisticsKHR(device.instance, device.device, vk.VkPipelineExecutableInfoKHR(
                      pipeline=pipeline, executableIndex=k))}) for k, p in enumerate(properties))


def _number(s) -> int | float:
    return (s.value.b32, s.value.i64, s.value.u64, s.value.f64)[s.format]

