"""What a bundle is made of, as plain values that a page can show: plans, their stages and what flows between them, limits, versions.

In: a checked description (docs/bundle-format.md) and, where they are known, milliseconds of stages and a device. Out: what JSON can hold.
Every image that a stage reads has a source: a stage before it in its plan, another plan whose result is kept, a value, or a constant.
"""
from __future__ import annotations

import platform
import sys
from collections.abc import Mapping, Sequence

import numpy as np

from ..cache import vulkan as v
from ..cache.copies import kinds
from ..cache.errors import DressiError
from ..cache.profile import Profile
from ..cache.summary import image_bytes, size, stage_bytes, substages, summary

LOADS = {v.LOAD_LOAD: "kept", v.LOAD_CLEAR: "cleared", v.LOAD_DONT_CARE: "overwritten"}
HOW = {v.DESCRIPTOR_INPUT_ATTACHMENT: "on the tile", v.DESCRIPTOR_COMBINED_IMAGE_SAMPLER: "filtered"}
MEANINGS = {"phase": "stepped: it updates what is optimized", "output": "run when somebody asks for what it gives out",
            "prepare": "cached: run once, and again when what it reads has changed",
            "enter": "lists what a phase touches, before its steps", "leave": "puts back what a phase has touched"}


def plans(d: Mapping, stage_ms: Mapping[str, Sequence[float]] | None = None) -> list[dict]:
    """Every plan with its stages. stage_ms: medians by plan, where they were measured."""
    counted, found = summary(d), []
    values = {value["image"]: value["name"] for value in d["values"]}
    writers: dict[int, str] = {}  # image -> the plan whose result is kept in it
    needed = {k for plan in d["plans"] for k in plan["needs"]}
    holds = d["meta"].get("holds")
    holds = holds if isinstance(holds, Mapping) else {}
    for k, (plan, kind) in enumerate(zip(d["plans"], kinds(d))):
        kind = "prepare" if kind == "output" and k in needed else kind
        texts = list(holds.get(plan["name"], ()))
        stages, written = [], {}
        ms = (stage_ms or {}).get(plan["name"])
        for number, stage in enumerate(plan["stages"]):
            count = substages(stage)
            own, texts = texts[:count], texts[count:]
            make = _dispatch if "compute" in stage else _stage
            stages.append(make(d, stage, written, writers, values, own) | {"ms": ms[number] if ms else None})
            written.update(dict.fromkeys(stage["outputs"] if "compute" in stage else stage["attachments"], number))
        found.append({"name": plan["name"], "kind": kind, "meaning": MEANINGS[kind], "steps": plan["steps"],
                      "needs": [d["plans"][n]["name"] for n in plan["needs"]],
                      "updates": [d["values"][n]["name"] for n in plan["updates"]],
                      "outputs": [d["values"][n]["name"] for n in plan["outputs"]],
                      **{key: counted[plan["name"]][key] for key in ("functions", "substages", "pipelines", "bytes_per_step")},
                      "ms": sum(ms) if ms else None, "stages": stages})
        writers.update({ref // 2: plan["name"] for ref in written})
    return found


def _dispatch(d: Mapping, stage: Mapping, written: Mapping[int, int], kept: Mapping[int, str], values: Mapping[int, str],
              texts: Sequence[str]) -> dict:
    """One dispatch of compute, as `_stage` has render passes: what it writes stands for attachments."""
    made = d["computes"][stage["compute"]]
    reads = {ref: _read(d, ref, [kind], written, kept, values, {}) for ref, (kind, _) in zip(stage["images"], made["bindings"])}
    outputs = [{"image": ref // 2, "format": _format(o["format"]), "load": LOADS[o["load"]], "stored": True, "value": values.get(ref // 2)}
               for ref, o in zip(stage["outputs"], made["outputs"])]
    width, height = size(d, stage)
    return {"width": width, "height": height, "waits": bool(stage["wait"]), "bytes": stage_bytes(d, stage), "attachments": outputs,
            "groups": list(stage["groups"]), "substages": [
                {"holds": _ops(texts[0]) if texts else [], "draws": 0, "vertices": 0, "indirect": stage["count"] >= 0, "depth": False,
                 "reads": list(reads.values()), "writes": [ref // 2 for ref in stage["outputs"]]}]}


def _stage(d: Mapping, stage: Mapping, written: Mapping[int, int], kept: Mapping[int, str], values: Mapping[int, str],
           texts: Sequence[str]) -> dict:
    """One render pass. written: ref -> the stage of this plan that wrote it last; kept: image -> the plan that wrote it before."""
    passed = d["passes"][stage["pass"]]
    made, inside = [], {}
    for k, (draws, subpass) in enumerate(zip(stage["subpasses"], passed["subpasses"])):
        reads: dict[int, dict] = {}
        for draw in draws:
            for ref, binding in zip(draw["images"], d["pipelines"][draw["pipeline"]]["bindings"]):
                reads.setdefault(ref, _read(d, ref, binding, written, kept, values, inside))
        made.append({"holds": _ops(texts[k]) if k < len(texts) else [], "draws": sum(len(draw["cells"]) for draw in draws),
                          "vertices": sum(draw["vertices"] * len(draw["cells"]) for draw in draws),
                          "indirect": any(draw["count"] >= 0 for draw in draws), "depth": subpass["depth"] >= 0,
                          "reads": list(reads.values()), "writes": [stage["attachments"][a] // 2 for a in subpass["colors"]]})
        inside.update({stage["attachments"][a]: k for a in subpass["colors"]})
    attachments = [{"image": ref // 2, "format": _format(a["format"]), "load": LOADS[a["load"]], "stored": a["store"] == v.STORE_STORE,
                    "value": values.get(ref // 2)} for ref, a in zip(stage["attachments"], passed["attachments"])]
    return {"width": stage["width"], "height": stage["height"], "waits": bool(stage["wait"]), "bytes": stage_bytes(d, stage),
            "attachments": attachments, "substages": made}


def _read(d: Mapping, ref: int, binding: Sequence[int], written: Mapping[int, int], kept: Mapping[int, str], values: Mapping[int, str],
          inside: Mapping[int, int]) -> dict:
    image, kind = ref // 2, binding[0]
    record = {"image": image, "how": HOW.get(kind, "sampled")}
    if ref in inside:
        return record | {"substage": inside[ref]}
    if ref in written:
        return record | {"stage": written[ref]}
    if image in values:
        return record | {"value": values[image]}
    if d["images"][image]["data"] is not None:
        return record | {"constant": True}
    return record | {"plan": kept.get(image, "")}


def _format(number: int) -> str:
    return v.FORMAT_NAMES.get(number, "depth")


def _ops(text: str) -> list[list]:
    """"dot*3 add" -> [["dot", 3], ["add", 1]]"""
    found = []
    for word in text.split():
        name, _, count = word.partition("*")
        found.append([name, int(count) if count.isdecimal() else 1])
    return found


def images(d: Mapping) -> list[dict]:
    """Every image: its format, size and bytes."""
    return [{"format": _format(i["format"]), "width": i["width"], "height": i["height"], "slots": i["slots"],
             "bytes": image_bytes(i) * i["slots"]} for i in d["images"]]


def limits(d: Mapping, device=None) -> list[dict]:
    """What the bundle needs of each limit, what its profile allows, and what the device has; None where that is not known."""
    try:
        profile = Profile.load(d["profile"]["name"])
        profile = profile if profile.digest == d["profile"]["digest"] else None
    except DressiError:
        profile = None
    has = getattr(device, "limits", None) or {}

    def known(source, name: str):
        try:
            found = source.limit(name) if isinstance(source, Profile) else source.get(name)
        except (DressiError, KeyError):
            return None
        return found if isinstance(found, (int, float)) else None

    return [{"name": name, "needed": needed, "profile": known(profile, name) if profile else None, "device": known(has, name)}
            for name, needed in d["needs"]["limits"].items()]


def versions(device=None) -> dict[str, str]:
    """Of the product, of what it runs on and with."""
    from importlib.metadata import PackageNotFoundError, version
    try:
        own = version("dressi_edge")
    except PackageNotFoundError:
        own = "from a checkout"
    found = {"dressi_edge": own, "Python": platform.python_version(), "NumPy": np.__version__,
             "system": f"{platform.system()} {platform.machine()}"}
    if device is not None:
        found |= {"device": device.name, "driver": str(getattr(device, "driver_info", "") or device.driver)}
        if api := getattr(device, "api_version", None):
            found["Vulkan"] = ".".join(map(str, api))
    return found | ({"byte order": "big"} if sys.byteorder == "big" else {})


def bundle_facts(bundle, device=None, stage_ms: Mapping[str, Sequence[float]] | None = None) -> dict:
    """All of one variant. device: where it runs, if it does."""
    d = bundle.description
    return {"profile": d["profile"]["name"], "digest": bundle.digest, "plans": plans(d, stage_ms), "images": images(d),
            "limits": limits(d, device), "shaders": len(d["shaders"]), "pipelines": len(d["pipelines"]) + len(d.get("computes", ())),
            "formats": {name: list(features) for name, features in d["needs"]["formats"].items()}}
