"""What packing and the reactive cache are worth, like the paper's Table 3: five ways to compile one problem, in one run.

    python benchmarks/ablation.py [--quick] [--rounds N] [--layers K] [--json FILE] [--docs FILE]

full               everything
no stage packing   one substage a render pass (stage_packing=False)
no cache           nothing is known beforehand (cache=False)
neither            both of these
naive              one function a render pass, and no cache: the plain way to run such a graph

Geometry and texture are the problems of packing.py, with the pear as the target. --quick takes views of 64x64 and a texture
of 256x256. Sessions of all five are open at once and step in turn, round by round, so that other work on the machine slows all alike; a
step is submitted by itself and waited for. Medians of wall time and, where the device is the processor, of processor
time of all threads; ratios to full. For full and naive also the device's time stage by stage, by timestamps.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "benchmarks")]

import packing  # noqa: E402
from reconstruct import write_report  # noqa: E402

from dressi_edge import runtime  # noqa: E402
from dressi_edge.cache.summary import stage_bytes, summary  # noqa: E402
from dressi_edge.compiler.io.shapes import pear  # noqa: E402
from dressi_edge.compiler.scene.problem import Problem  # noqa: E402
from dressi_edge.runtime.device import Device  # noqa: E402

WAYS = {"full": {}, "no stage packing": {"stage_packing": False}, "no cache": {"cache": False},
        "neither": {"stage_packing": False, "cache": False}, "naive": {"naive": True, "cache": False}}
WARM = 2  # rounds before any is timed
FEW = 12  # vertices of a draw that covers its image, 3, or a list, 12


def targets(device: Device, folder: Path, profile: str, cameras) -> np.ndarray:
    """The pear from each camera, drawn hard, (views, height, width, 4)."""
    problem = Problem(pear(256), cameras)
    problem.render(softness=packing.HARD)
    problem.compile(profile, folder / "target.dressi")
    with runtime.load(folder / "target.dressi", device) as session:
        return session.get("render.color")


def stage_times(session, runs: int) -> list[dict]:
    """{"ms", "kind", "mpixels", "mbytes"} of each stage of a step. kind: "raster" draws geometry or tiles, "small" covers an image of at
    most 4096 pixels, "image" a larger one."""
    d = session.bundle.description
    out = []
    for ms, stage in zip(session.profile_stages("step", runs), session.plans["step"]["stages"]):
        drawn = [draw["vertices"] for draws in stage["subpasses"] for draw in draws]
        pixels = stage["width"] * stage["height"]
        out.append({"ms": ms, "kind": "raster" if max(drawn) > FEW else "small" if pixels <= 4096 else "image",
                    "mpixels": pixels / 1e6, "mbytes": stage_bytes(d, stage) / 1e6})
    return out


def profile(session, runs: int) -> dict:
    """Where a step goes: milliseconds, stages and megabytes of each kind of stage, and of the five longest stages."""
    stages = stage_times(session, runs)
    kinds = {kind: {"stages": len(some), "ms": round(sum(s["ms"] for s in some), 3), "mbytes": round(sum(s["mbytes"] for s in some), 2)}
             for kind in ("raster", "image", "small") for some in [[s for s in stages if s["kind"] == kind]]}
    longest = sorted(range(len(stages)), key=lambda k: -stages[k]["ms"])[:5]
    return {"kinds": kinds, "longest": [{"stage": k, **{key: x if isinstance(x, str) else round(x, 3) for key, x in stages[k].items()}}
                                        for k in longest]}


def ablate(name: str, problem: Problem, target: np.ndarray, device: Device, folder: Path, options) -> list[dict]:
    """A row for each way."""
    rows, sessions = {}, {}
    with ExitStack() as stack:
        for way, how in WAYS.items():
            path = folder / "problem.dressi"
            description = problem.compile(options.profile, path, **how)
            counts = summary(description)
            sessions[way] = session = stack.enter_context(runtime.load(path, device))
            session.set("targets", target)
            rows[way] = {"case": f"{name}, {way}", **{k: counts["step"][k] for k in packing.COUNTS}, "first_loss": session.loss()}
        wall, busy = {way: [] for way in WAYS}, {way: [] for way in WAYS}
        for k in range(WARM + options.rounds):
            for way, session in sessions.items():
                begin, cpu = time.perf_counter(), time.process_time()
                session.step(1)
                if k >= WARM:
                    wall[way].append((time.perf_counter() - begin) * 1e3)
                    busy[way].append((time.process_time() - cpu) * 1e3)
        for way, row in rows.items():
            row["ms"], row["least_ms"] = statistics.median(wall[way]), min(wall[way])
            row["cpu_ms"] = statistics.median(busy[way])
            row["loss"] = sessions[way].loss()
        for way in ("full", "naive"):
            rows[way]["profile"] = profile(sessions[way], 3)
    for row in rows.values():
        for key in ("ms", "least_ms", "cpu_ms"):
            row[f"{key}_ratio"] = round(row[key] / rows["full"][key], 2)
            row[key] = round(row[key], 2)
        print(f"{row['case']:28} {row['stages']:4} stages {row['ms']:9.2f} ms ({row['ms_ratio']:6.2f}x)  cpu {row['cpu_ms']:9.2f} ms "
              f"({row['cpu_ms_ratio']:6.2f}x)  loss {row['loss']:.6f}", flush=True)
    losses = [row["loss"] for row in rows.values()]
    assert max(losses) - min(losses) <= 0.01 * max(losses), f"{name}: the ways do not agree: losses {losses}"
    return list(rows.values())


def table(results: list[dict]) -> str:
    lines = ["| | stages | MB | ms | ratio | least ms | ratio | processor ms | ratio |", "|---|---:|---:|---:|---:|---:|---:|---:|---:|"]
    for r in results:
        lines.append(f"| {r['case']} | {r['stages']} | {r['bytes_per_step'] / 1e6:.1f} | {r['ms']} | {r['ms_ratio']} | {r['least_ms']} "
                     f"| {r['least_ms_ratio']} | {r['cpu_ms']} | {r['cpu_ms_ratio']} |")
    lines += ["", "Time of the device by kind of stage: `raster` draws geometry or tiles, `image` covers an image, `small` one of at most "
              "4096 pixels.", "",
              "| | raster stages | ms | image stages | ms | small stages | ms |", "|---|---:|---:|---:|---:|---:|---:|"]
    for r in (r for r in results if "profile" in r):
        kinds = r["profile"]["kinds"]
        lines.append(f"| {r['case']} | " + " | ".join(f"{kinds[k]['stages']} | {kinds[k]['ms']:.1f}" for k in kinds) + " |")
    return "\n".join(lines) + "\n"


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="views of 64x64, a texture of 256x256, few rounds")
    parser.add_argument("--rounds", type=int, metavar="N", help="timed steps of each (default 15)")
    parser.add_argument("--layers", type=int, default=1, metavar="K", help="layers of HardSoftRas in the geometry problem (default 1)")
    parser.add_argument("--only", choices=("geometry", "texture"), help="one of the two")
    parser.add_argument("--device", help="an index or a part of the device's name")
    parser.add_argument("--profile", default="lavapipe", help="the device profile to compile for (default lavapipe)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the results there")
    parser.add_argument("--docs", type=Path, metavar="FILE", help="a Markdown file whose table is written anew")
    options = parser.parse_args(arguments)
    options.rounds = options.rounds or (3 if options.quick else 15)
    cameras = packing.views(6, 64 if options.quick else 256)
    problems = {"geometry": lambda: packing.geometry(cameras, options.layers),
                "texture": lambda: packing.texture(cameras, 256 if options.quick else 1024)}
    results = []
    with tempfile.TemporaryDirectory(prefix="dressi-bench-") as folder, Device.open(options.device) as device:
        target = targets(device, Path(folder), options.profile, cameras)
        for name, make in problems.items():
            if options.only in (None, name):
                results += ablate(name, make(), target, device, Path(folder), options)
        about = {"device": device.name, "driver": device.driver_info, "profile": options.profile}
    write_report(options.json, about, results, size=cameras[0].width, rounds=options.rounds)
    if options.docs:
        packing.insert(options.docs, "ablation", f"{about['device']}, {about['driver']}, views of {cameras[0].width}x{cameras[0].height}, "
                       f"{options.rounds} steps each.\n\n{table(results)}")


if __name__ == "__main__":
    main()
