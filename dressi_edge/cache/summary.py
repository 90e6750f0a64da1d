"""What a bundle's plans are made of, counted from its description: for `dressi-edge inspect` and docs/packing.md.

In: a checked description. Out: counts a plan, lines of text, or a graph in DOT.
"""
from __future__ import annotations

from collections.abc import Mapping

from . import vulkan as v
from .bundle_plans import bound, written


def image_bytes(image: Mapping) -> int:
    """Bytes of one slot of an image; depth counts four a pixel."""
    return v.TEXEL_BYTES[image["format"]] * image["width"] * image["height"]


def padded_bytes(d: Mapping, texels: int) -> int:
    """Bytes of all images if each row is filled up to whole so many texels."""
    return sum(image_bytes({**i, "width": -(-i["width"] // texels) * texels}) * i["slots"] for i in d["images"])


def stage_bytes(d: Mapping, stage: Mapping) -> int:
    """Bytes a render pass moves between images and the GPU: every attachment it loads, every one it stores, and once a subpass
    every image that is sampled there. Input attachments stay where they are; reuse by a cache is not counted."""
    if "compute" in stage:
        loaded = [o["load"] == v.LOAD_LOAD for o in d["computes"][stage["compute"]]["outputs"]]
        return sum((1 + again) * image_bytes(d["images"][ref // 2]) for ref, again in zip(stage["outputs"], loaded)) \
            + sum(image_bytes(d["images"][ref // 2]) for ref in set(stage["images"]))
    total = 0
    for ref, a in zip(stage["attachments"], d["passes"][stage["pass"]]["attachments"]):
        times = (a["load"] == v.LOAD_LOAD) + (a["store"] == v.STORE_STORE)
        total += times * image_bytes(d["images"][ref // 2])
    for draws in stage["subpasses"]:
        sampled = {ref for draw in draws for ref, b in zip(draw["images"], d["pipelines"][draw["pipeline"]]["bindings"])
                   if b[0] != v.DESCRIPTOR_INPUT_ATTACHMENT}
        total += sum(image_bytes(d["images"][ref // 2]) for ref in sampled)
    return total


def pipelines(plan: Mapping) -> set[tuple[str, int]]:
    """The pipelines that a plan uses: their kind and number."""
    return {("compute", stage["compute"]) if "compute" in stage else ("graphics", draw["pipeline"]) for stage in plan["stages"]
            for draw in ([stage] if "compute" in stage else [draw for draws in stage["subpasses"] for draw in draws])}


def substages(stage: Mapping) -> int:
    """How many subpasses a stage has; one of compute is one."""
    return 1 if "compute" in stage else len(stage["subpasses"])


def size(d: Mapping, stage: Mapping) -> tuple[int, int]:
    """Width and height of what a stage draws, or of the first image that its compute shader writes."""
    image = d["images"][stage["outputs"][0] // 2] if "compute" in stage else stage
    return image["width"], image["height"]


def summary(d: Mapping) -> dict[str, dict]:
    """Plan -> functions (None where the bundle does not say), substages, stages, pipelines (distinct), bytes_per_step."""
    functions = d["meta"].get("functions")
    functions = functions if isinstance(functions, dict) else {}
    return {plan["name"]: {
        "functions": functions.get(plan["name"]), "substages": sum(map(substages, plan["stages"])),
        "stages": len(plan["stages"]), "pipelines": len(pipelines(plan)),
        "bytes_per_step": sum(stage_bytes(d, stage) for stage in plan["stages"])} for plan in d["plans"]}


def _size(count: float) -> str:
    for unit in ("B", "kB", "MB"):
        if count < 1000:
            return f"{count:.3g} {unit}"
        count /= 1000
    return f"{count:.3g} GB"


def _padding(d: Mapping) -> str:
    """What images take on a device that fills rows up as the profile says; to the byte: `inspect --statistics` on it."""
    width = d["meta"].get("table_width")
    known = type(width) is int and 0 < width <= 1 << 16
    return f", {_size(padded_bytes(d, width))} in rows of whole {width} texels" if known else ""


def text(d: Mapping) -> str:
    """The summary and every stage, for people."""
    lines = [f"profile {d['profile']['name']}: {len(d['plans'])} plans, {len(d['pipelines']) + len(d.get('computes', ()))} pipelines, "
             f"{len(d['shaders'])} shaders, {len(d['images'])} images of "
             f"{_size(padded_bytes(d, 1))}{_padding(d)}", ""]
    for plan in d["plans"]:
        s = summary({**d, "plans": [plan]})[plan["name"]]
        known = "" if s["functions"] is None else f"{s['functions']} functions, "
        lines.append(f"{plan['name']}: {known}{s['substages']} substages, {s['stages']} stages, {s['pipelines']} pipelines, "
                     f"{_size(s['bytes_per_step'])} a step" + (f", {plan['steps']} steps" if plan["steps"] else ""))
        for k, stage in enumerate(plan["stages"]):
            compute = "compute" in stage
            formats = [d["images"][ref // 2]["format"] for ref in written(stage)]
            names = [v.FORMAT_NAMES.get(f, "depth") for f in formats]
            count = " ".join(f"{names.count(n)}x{n}" for n in dict.fromkeys(names))
            (width, height), what = size(d, stage), "compute, " + " x ".join(map(str, stage["groups"])) + " workgroups" if compute else \
                f"{sum(len(draw['cells']) for subpass in stage['subpasses'] for draw in subpass)} draws"
            lines.append(f"  {k:3} {width:5} x {height:<5} {substages(stage)} substages, "
                         f"{what}, {_size(stage_bytes(d, stage))}, {'outputs' if compute else 'attachments'} {count}")
    needs = " ".join(f"{name}={x}" for name, x in d["needs"]["limits"].items())
    return "\n".join([*lines, "", f"needs of the device: {needs}"]) + "\n"


def _quoted(name: str) -> str:
    return '"' + "".join(c if c.isprintable() else "?" for c in name).replace("\\", "\\\\").replace('"', '\\"') + '"'


def dot(d: Mapping) -> str:
    """Stages as boxes, an arrow from the stage that writes an image to each that reads it; a cluster for each plan."""
    lines = ["digraph bundle {", "  node [shape=box, fontname=\"sans-serif\", fontsize=10];", "  rankdir=TB;"]
    for p, plan in enumerate(d["plans"]):
        lines += [f"  subgraph cluster_{p} {{", f"    label={_quoted(plan['name'])};"]
        writer: dict[int, int] = {}
        edges: dict[tuple[int, int], int] = {}
        for k, stage in enumerate(plan["stages"]):
            (width, height), what = size(d, stage), "outputs" if "compute" in stage else "attachments"
            label = f"{k}: {width} x {height}\\n{substages(stage)} substages, " \
                    f"{len(written(stage))} {what}\\n{_size(stage_bytes(d, stage))}"
            lines.append(f"    s{p}_{k} [label=\"{label}\"];")
            for ref in sorted(set(bound(stage))):
                if ref in writer and writer[ref] != k:
                    edges[writer[ref], k] = edges.get((writer[ref], k), 0) + 1
            writer.update(dict.fromkeys(written(stage), k))
        lines += [f"    s{p}_{a} -> s{p}_{b}" + (f" [label=\"{n}\"];" if n > 1 else ";") for (a, b), n in edges.items()]
        lines.append("  }")
    return "\n".join([*lines, "}"]) + "\n"
