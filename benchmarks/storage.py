"""What storage "half" costs in error and saves in bytes and time: one problem compiled twice, in one run.

    python benchmarks/storage.py [--quick] [--device NAME] [--profile NAME] [--json FILE]

silhouette         a sphere of 1280 faces to silhouettes of the pear, six views of 256x256, one layer, Adam
three layers       the same with K = 3
shape and colours  a sphere of 5120 faces, Lambert under two lights: vertices and their colours
texture            an albedo of 1024x1024 on the pear, which stays, exact gradients
shape and texture  vertices of a sphere and its albedo of 512x512

MB           what a step moves, as in packing.py; of profile `mali_g76` too, which has 128 bits of tile colour a pixel
passes       of a step for either profile
bytes        written to the pixels of the views by a step for mali_g76, divided by their number
gradient     relative L2 difference of what Adam takes from the first step, half to float
final        relative L2 difference of the optimized parameters after all steps, to how far they moved, half to float
nudged       the same of float begun 1e-6 away: what any other rounding makes of it
loss         at the end, both by the shaders of float
ms, cpu_ms   medians of steps submitted one by one, in turns

The error against the float64 reference is that of gradient_error.py. --quick: views of 48x48 and few steps.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import packing
from step import Meter, options_of, rounded, table, take_turns, versions

from dressi_edge import runtime
from dressi_edge.cache.profile import Profile
from dressi_edge.cache.summary import image_bytes, summary
from dressi_edge.compiler import Options, build
from dressi_edge.compiler.io.meshes import Mesh
from dressi_edge.compiler.io.shapes import pear, sphere
from dressi_edge.compiler.render.light import Light
from dressi_edge.compiler.render.optimizer import Adam
from dressi_edge.compiler.render.raster import Softness
from dressi_edge.compiler.scene.problem import Loss, Problem
from dressi_edge.runtime.device import Device

TILED = "mali_g76"
STORAGES = ("float", "half")
LIGHTS = (Light("directional", (2.0, 2.0, 2.0), (-0.3, -0.5, -0.8)), Light("ambient", (0.3, 0.3, 0.3)))
COLUMNS = ("case", "storage", "MB", f"MB {TILED}", "passes", f"passes {TILED}", "bytes", "gradient", "final", "nudged", "loss", "ms",
           "cpu_ms", "cpu ratio")


def both(cameras, texture: int) -> Problem:
    """Phase "step" moves a sphere and paints it."""
    ball = sphere(642, radius=0.6)
    mesh = Mesh(ball.positions, ball.faces, ball.uvs, ball.uv_faces, texture=np.full((texture, texture, 3), 0.5))
    problem = Problem(mesh, cameras)
    problem.phase("step", 500, {"vertices": Adam(0.01), "texture": Adam(0.03)},
                  [Loss("silhouette"), Loss("color", norm="l1", masked=True), Loss("laplacian", 0.05)], Softness(2.0))
    return problem


def colored(cameras, vertices: int) -> Problem:
    problem = Problem(sphere(vertices, radius=0.6), cameras, albedo="colors", shading="lambert", lights=LIGHTS)
    problem.phase("step", 500, {"vertices": Adam(0.01), "colors": Adam(0.03)},
                  [Loss("silhouette"), Loss("color"), Loss("laplacian", 0.05)], Softness(2.0))
    return problem


def problems(quick: bool) -> dict[str, tuple[Problem, int]]:
    """name: (problem, steps)."""
    cameras = packing.views(6, 48 if quick else 256)
    found = {"silhouette": (packing.geometry(cameras), 100), "three layers": (packing.geometry(cameras, 3), 20),
             "shape and colours": (colored(cameras, 162 if quick else 2562), 20),
             "texture": (packing.texture(cameras, 64 if quick else 1024), 20),
             "shape and texture": (both(cameras, 64 if quick else 512), 10)}
    return {name: (problem, 5 if quick else steps) for name, (problem, steps) in found.items()}


def written(d: dict, pixels: int) -> float:
    """Bytes stored by a step in images of so many pixels, for each pixel."""
    stages = next(plan for plan in d["plans"] if plan["name"] == "step")["stages"]
    refs = [ref for stage in stages for ref in stage["attachments"] if stage["width"] * stage["height"] == pixels]
    return sum(image_bytes(d["images"][ref // 2]) for ref in refs if d["images"][ref // 2]["format"]) / pixels


def difference(a: np.ndarray, b: np.ndarray, start: np.ndarray | float = 0.0) -> float:
    """|a - b| / |b - start|."""
    a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)
    return rounded(float(np.linalg.norm(a - b) / np.linalg.norm(b - start)))


def measure(name: str, problem: Problem, steps: int, targets: np.ndarray, device: Device, folder: Path, options) -> list[dict]:
    rows, sessions = {}, {}
    wanted = [n for n in ("vertices", "colors", "texture") if f"{n}.adam_m" in problem.program.values]
    with ExitStack() as stack:
        for storage in STORAGES:
            path = folder / f"{storage}.dressi"
            made = problem.compile(options.profile, path, storage=storage)
            tiled = build(problem.program, Profile.load(TILED), Options(storage=storage)).description
            counts, counts_tiled = summary(made)["step"], summary(tiled)["step"]
            extent = problem.scene.atlas.extent
            rows[storage] = {"case": name, "storage": storage, "MB": rounded(counts["bytes_per_step"] / 1e6),
                             f"MB {TILED}": rounded(counts_tiled["bytes_per_step"] / 1e6), "passes": counts["stages"],
                             f"passes {TILED}": counts_tiled["stages"], "bytes": rounded(written(tiled, extent.width * extent.height))}
            sessions[storage] = session = stack.enter_context(runtime.load(path, device))
            session.set("targets", targets)
        start = {n: sessions["float"].get(n) for n, value in sessions["float"].values.items() if value["role"] == "state"}
        first, last = {}, {}
        for storage, nudge in (("float", 0.0), ("half", 0.0), ("nudged", 1e-6)):
            session = sessions.get(storage, sessions["float"])
            for n, x in start.items():
                session.set(n, x)
            for n in wanted:
                session.set(n, start[n] + nudge * np.random.default_rng(0).normal(size=start[n].shape))
            session.step(1)
            first[storage] = {n: session.get(f"{n}.adam_m") for n in wanted}
            session.step(steps - 1)
            last[storage] = {n: session.get(n) for n in wanted}
        meters = [Meter(lambda s=s: s.step(1)) for s in sessions.values()]
        rows["float"]["nudged"] = max(difference(last["nudged"][n], last["float"][n], start[n]) for n in wanted)
        for storage in STORAGES:
            for n in wanted:
                sessions["float"].set(n, last[storage][n])
            rows[storage]["loss"] = rounded(sessions["float"].loss())
            for key, found, since in (("gradient", first, dict.fromkeys(wanted, 0.0)), ("final", last, start)):
                rows[storage][key] = max(difference(found[storage][n], found["float"][n], since[n]) for n in wanted)
        take_turns(meters, options.seconds)
        for row, meter in zip(rows.values(), meters):
            row |= meter.row
            row["cpu ratio"] = rounded(row["cpu_ms"] / rows["float"]["cpu_ms"])
    return list(rows.values())


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options = options_of(parser, arguments)
    results = []
    with tempfile.TemporaryDirectory(prefix="dressi-storage-") as name, Device.open(options.device) as device:
        folder, found = Path(name), problems(options.quick)
        target = Problem(pear(96), next(iter(found.values()))[0].cameras)
        target.render(softness=packing.HARD)
        target.compile(options.profile, folder / "target.dressi")
        with runtime.load(folder / "target.dressi", device) as session:
            targets, about = session.get("render.color"), session.report()
        for case, (problem, steps) in found.items():
            if options.only in case:
                results += measure(case, problem, steps, targets, device, folder, options)
                print(results[-1], flush=True)
    print(f"\n{about['device']}, {about['driver']}\n\n{table(results, COLUMNS)}")
    if options.json:
        document = {"device": about["device"], "versions": versions(about), "results": results}
        options.json.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
