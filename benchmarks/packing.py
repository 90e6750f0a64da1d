"""What every profile's bundle is made of, like the paper's Table 2: functions -> substages -> stages -> distinct pipelines.

    python benchmarks/packing.py [--quick] [--json FILE] [--docs FILE]

geometry      a sphere of 1280 faces fitted to silhouettes: six views of 256x256, K = 1, Adam, a Laplacian
geometry 24   the same with 24 views
texture       an albedo of 1024x1024 on the pear, which stays: six views of 256x256, colours

Each is compiled for every profile in device_profiles/ (--quick: the three plain ones), with the reactive cache and without; a step is
the plan that `step()` runs, prepare the plans that run before the first and again when something they read changes. No device is
needed, and what the targets show does not matter: only their size does. The numbers go to --json and, as tables, between the markers of
--docs.

It stops with an error unless a profile that allows at least as much as another never takes more stages; six-view geometry on `limit4` is at
most 20 stages and 17 pipelines a step; and 24 views take no more than six.
"""

from __future__ import annotations

import argparse
import json
import platform
import re
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT)]

from dressi_edge.cache.profile import Profile, profile_names  # noqa: E402
from dressi_edge.cache.summary import summary  # noqa: E402
from dressi_edge.compiler import Options, build  # noqa: E402
from dressi_edge.compiler.io.cameras import Camera, orbit  # noqa: E402
from dressi_edge.compiler.io.meshes import Mesh  # noqa: E402
from dressi_edge.compiler.io.shapes import icosphere, pear  # noqa: E402
from dressi_edge.compiler.render.optimizer import Adam  # noqa: E402
from dressi_edge.compiler.render.raster import Softness  # noqa: E402
from dressi_edge.compiler.scene.problem import Loss, Problem  # noqa: E402

PLAIN = ("unlimited", "limit8", "limit4")
COUNTS = ("functions", "substages", "stages", "pipelines", "bytes_per_step")
STAGES_AT_MOST, PIPELINES_AT_MOST = 20, 17  # a step of six-view geometry on limit4
# What `pack` reads of a profile; None is no limit.
LIMITS = ("maxColorAttachments", "maxFragmentOutputAttachments", "maxFragmentCombinedOutputResources", "maxPerStageDescriptorSamplers",
          "maxPerStageDescriptorSampledImages", "maxDescriptorSetSampledImages", "maxPerStageResources",
          "maxPerStageDescriptorInputAttachments")
HARD = Softness(1.0, delta=0.0)  # one sample a pixel, no edge mask


def views(count: int, size: int) -> tuple[Camera, ...]:
    """Cameras around, 20 degrees up and down in turn."""
    return orbit(count, (20.0, -20.0), 2.5, 50.0, (size, size))


def geometry(cameras: Sequence[Camera], layers: int = 1) -> Problem:
    """Phase "step" moves a sphere of 1280 faces by silhouettes."""
    problem = Problem(icosphere(3, 0.6), cameras, albedo="constant")
    losses = [Loss("silhouette"), Loss("laplacian", 0.05)]
    problem.phase("step", 500, {"vertices": Adam(0.01)}, losses, Softness(2.0, layers=layers))
    return problem


def texture(cameras: Sequence[Camera], size: int = 1024) -> Problem:
    """Phase "step" paints the pear, from grey, by colours."""
    shape = pear(48)
    mesh = Mesh(shape.positions, shape.faces, shape.uvs, shape.uv_faces, texture=np.full((size, size, 3), 0.5))
    problem = Problem(mesh, cameras)
    problem.phase("step", 500, {"texture": Adam(0.03)}, [Loss("color", norm="l1", masked=True)], HARD)
    return problem


def rows(name: str, problem: Problem, profiles: Sequence[Profile]) -> list[dict]:
    """{"problem", "profile", "cache", "step": counts, "prepare": counts of all such plans or None} for each profile, uncached and
    cached."""
    out = []
    for profile in profiles:
        for cache in (False, True):
            plans = summary(build(problem.program, profile, Options(cache=cache)).description)
            before = [counts for plan, counts in plans.items() if plan.startswith("step.prepare")]
            prepare = {key: sum(counts[key] for counts in before) for key in COUNTS} if before else None
            out.append({"problem": name, "profile": profile.name, "cache": cache, "step": plans["step"], "prepare": prepare})
    return out


def allows_at_least(a: Profile, b: Profile) -> bool:
    """Whether whatever the packer may do for b it may do for a."""
    pairs = [(a.limit(k), b.limit(k)) for k in LIMITS]
    pairs += [(float("inf") if x is None else x, float("inf") if y is None else y)
              for x, y in ((a.tile_bits, b.tile_bits), (a.max_merged_attachments, b.max_merged_attachments))]
    return all(x >= y for x, y in pairs)


def check(found: Sequence[dict], profiles: Sequence[Profile]) -> int:
    """How many pairs of profiles were compared. AssertionError where a promise is broken."""
    stages = {(r["problem"], r["profile"], r["cache"]): r["step"]["stages"] for r in found}
    problems = list(dict.fromkeys(r["problem"] for r in found))
    pairs = [(a.name, b.name) for a in profiles for b in profiles if a is not b and allows_at_least(a, b)]
    for a, b in pairs:
        for problem in problems:
            for cache in (False, True):
                more, less = stages[problem, a, cache], stages[problem, b, cache]
                assert more <= less, f"{problem}: {a} allows what {b} does, but takes {more} stages and {b} {less}"
    for r in found:
        if r["problem"] == "geometry" and r["profile"] == "limit4" and r["cache"]:
            assert r["step"]["stages"] <= STAGES_AT_MOST, r
            assert r["step"]["pipelines"] <= PIPELINES_AT_MOST, r
    six = {(r["profile"], r["cache"]): r["step"] for r in found if r["problem"] == "geometry"}
    for r in found:
        if r["problem"] == "geometry 24":
            for key in ("stages", "pipelines"):
                assert r["step"][key] <= six[r["profile"], r["cache"]][key], f"24 views take more {key} than six: {r}"
    return len(pairs)


def cell(counts: dict | None) -> str:
    if counts is None:
        return "none | "
    return " -> ".join(str(counts[k]) for k in COUNTS[:4]) + f" | {counts['bytes_per_step'] / 1e6:.1f}"


def tables(found: Sequence[dict]) -> str:
    """Markdown: a table for each problem, profiles of equal numbers in one row."""
    lines = []
    for problem in dict.fromkeys(r["problem"] for r in found):
        by_numbers: dict[str, list[str]] = {}
        for name in dict.fromkeys(r["profile"] for r in found):
            plain, cached = (next(r for r in found if (r["problem"], r["profile"], r["cache"]) == (problem, name, cache))
                             for cache in (False, True))
            numbers = f"{cell(plain['step'])} | {cell(cached['step'])} | {cell(cached['prepare'])} |"
            by_numbers.setdefault(numbers, []).append(name)
        lines += [f"**{problem}**", "", "| profile | step without cache | MB | step | MB | prepare | MB |",
                  "|---|---|---:|---|---:|---|---:|",
                  *(f"| {', '.join(names)} | {numbers}" for numbers, names in by_numbers.items()), ""]
    return "\n".join(lines)


def insert(path: Path, name: str, text: str) -> None:
    """Put text between `<!-- name -->` and `<!-- /name -->` of a file."""
    old = path.read_text(encoding="utf-8")
    new, count = re.subn(rf"(<!-- {name} -->\n).*?(<!-- /{name} -->)", lambda m: f"{m[1]}\n{text}\n{m[2]}", old, flags=re.DOTALL)
    if count != 1:
        raise SystemExit(f"{path}: no place for a table: <!-- {name} --> and <!-- /{name} --> are needed, once each")
    path.write_text(new, encoding="utf-8")


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="the profiles unlimited, limit8 and limit4 only")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the numbers there")
    parser.add_argument("--docs", type=Path, metavar="FILE", help="a Markdown file whose tables are written anew")
    options = parser.parse_args(arguments)
    names = [*PLAIN, *(n for n in profile_names() if n not in PLAIN and not options.quick)]
    profiles = [Profile.load(name) for name in names]
    six = views(6, 256)
    problems = {"geometry": geometry(six), "geometry 24": geometry(views(24, 256)), "texture": texture(six)}
    found = [row for name, problem in problems.items() for row in rows(name, problem, profiles)]
    text = tables(found)
    print(text)
    if options.json:
        options.json.parent.mkdir(parents=True, exist_ok=True)
        document = {"device": None, "versions": {"python": platform.python_version(), "numpy": np.__version__}, "results": found}
        options.json.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    if options.docs:
        insert(options.docs, "packing", text)
    print(f"{check(found, profiles)} pairs of profiles, of which one allows what the other does: never more stages")


if __name__ == "__main__":
    main()
