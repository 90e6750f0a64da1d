"""A sphere of 1280 faces becomes Spot by the silhouettes of six views: how far it gets, and how long an iteration takes.

    python benchmarks/sphere_to_spot.py [--quick] [--steps N] [--layers K] [--data DIR] [--out DIR] [--json FILE]

Target: Spot (DIR/meshes/spot/spot.obj) in the unit ball. Start: an icosphere of 642 vertices, radius 0.6. Six views of 256x256,
50 degrees high, from 2.5 away, 60 degrees apart, 20 degrees up and down in turn. Loss: mean squared difference of silhouettes
+ 0.05 times the mean length of vertex minus mean of its neighbours. Adam, rate 0.01. r = 2 pixels, sigma = r / 7.

same     the target's silhouette is drawn by the same renderer with the same softness
hard     by one sample a pixel, 0 or 1, as a hard rasterizer does

--quick takes the pear, 64x64 and few steps. Time: the median, and the least, of 100 iterations after the first 20, each
submitted by itself and waited for; the mean of those that were submitted many at a time; and the processor time of an
iteration, all threads together, which other work on the machine disturbs least where the device is the processor.
"""

from __future__ import annotations

import argparse
import math
import statistics
import tempfile
import time
from pathlib import Path

import metrics
import numpy as np
from reconstruct import HARD, ROOT, Bench, common_options, write_report

from dressi_edge.compiler.io.cameras import Camera, look_at
from dressi_edge.compiler.io.meshes import Mesh, load_mesh, normalize
from dressi_edge.compiler.io.shapes import icosphere, pear
from dressi_edge.compiler.io.writers import contact_sheet, loss_curve, save_mesh
from dressi_edge.compiler.render.optimizer import Adam
from dressi_edge.compiler.render.raster import Softness
from dressi_edge.compiler.scene.problem import Loss, Problem

WARM = 20  # iterations before any is timed
TIMED = 100  # timed one by one
STOPS = (50, 150, 500)  # where the distance is measured


def cameras(size: int) -> tuple[Camera, ...]:
    """The protocol's six."""
    out = []
    for i in range(6):
        elevation, azimuth = math.radians(20 if i % 2 == 0 else -20), math.radians(60 * i)
        eye = (math.cos(elevation) * math.sin(azimuth), math.sin(elevation), math.cos(elevation) * math.cos(azimuth))
        out.append(look_at([2.5 * x for x in eye], (0, 0, 0), (0, 1, 0), 50, size, size))
    return tuple(out)


def silhouettes(bench: Bench, mesh: Mesh, views: tuple[Camera, ...], softness: Softness) -> np.ndarray:
    problem = Problem(mesh, views, albedo="constant")
    problem.render(softness=softness, color=False)
    with bench.open(problem) as session:
        return session.get("render.silhouette")


def fit(bench: Bench, start: Mesh, views: tuple[Camera, ...], target: np.ndarray, softness: Softness, surface: metrics.Surface,
        steps: int) -> tuple[dict, np.ndarray, list]:
    """The loop: what was measured, the vertices at the end, [(iteration, loss)]."""
    problem = Problem(start, views, albedo="constant")
    problem.phase("shape", steps, {"vertices": Adam(0.01)}, [Loss("silhouette"), Loss("laplacian", 0.05)], softness)
    with bench.open(problem) as session:
        session.set("targets", np.concatenate([np.zeros((*target.shape, 3), np.float32), target[..., None]], axis=-1))
        done, single, whole, busy, row, curve = 0, [], [], 0.0, {}, [(0, session.loss())]
        stops = sorted({*(s for s in STOPS if s < steps), steps})
        marks = sorted({*stops, *(s for s in (WARM, WARM + TIMED) if s < steps), *range(0, steps, max(1, steps // 40))} - {0})
        for mark in marks:
            for count in [1] * (mark - done) if WARM <= done < WARM + TIMED else [mark - done]:
                begin, cpu = time.perf_counter(), time.process_time()
                session.step(count)
                spent = (time.perf_counter() - begin) * 1e3
                if done >= WARM:
                    busy += (time.process_time() - cpu) * 1e3
                    (single if done < WARM + TIMED else whole).append((spent, count))
                done += count
            curve.append((done, session.loss()))
            if done in stops:
                row[f"distance_{done}"] = round(float(surface.vertex_distances(session.get("vertices")).mean()), 5)
        vertices = session.get("vertices")
    row["ms"] = round(statistics.median(t for t, _ in single), 2) if single else None
    row["least_ms"] = round(min(t for t, _ in single), 2) if single else None
    row["ms_in_a_row"] = round(sum(t for t, _ in whole) / sum(n for _, n in whole), 2) if whole else None
    row["cpu_ms"] = round(busy / (steps - WARM), 2) if steps > WARM else None
    measured = surface.measure(vertices, start.faces)
    return {**row, "chamfer": round(measured.chamfer, 5), "steps": steps}, vertices, curve


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, help="iterations (default 500)")
    common_options(parser)
    options = parser.parse_args(arguments)
    if options.quick and options.data is None:
        target = pear(96)
    else:
        path = (options.data or ROOT.parent / "shared") / "meshes" / "spot" / "spot.obj"
        if not path.is_file():
            raise SystemExit(f"{path} does not exist: give the folder that holds meshes/ by --data, or try --quick")
        target = normalize(load_mesh(path))
    steps = options.steps or (40 if options.quick else 500)
    out = options.out or Path("results_sphere_to_spot")
    out.mkdir(parents=True, exist_ok=True)
    views, start, soft = cameras(64 if options.quick else 256), icosphere(3, 0.6), Softness(2.0, layers=options.layers)
    surface = metrics.Surface(target.positions, target.faces)
    results, curves = [], {}
    with tempfile.TemporaryDirectory(prefix="dressi-bench-") as folder:
        bench = Bench(Path(folder), options.device, options.profile)
        true = silhouettes(bench, target, views, HARD)
        sheet = [("target, hard", true), ("start, hard", silhouettes(bench, start, views, HARD))]
        for case, how in (("same", soft), ("hard", HARD)):
            row, vertices, curve = fit(bench, start, views, silhouettes(bench, target, views, how), soft, surface, steps)
            ours = Mesh(vertices, start.faces)
            drawn = silhouettes(bench, ours, views, HARD)
            iou = float(metrics.silhouette_iou(drawn, true).mean())
            results.append({"case": case, "layers": options.layers, **row, "iou": round(iou, 4)})
            curves[case] = curve
            sheet.append((f"ours, {case}", drawn))
            save_mesh(out / f"{case}.obj", ours)
            print("  ".join(f"{k} {v}" for k, v in results[-1].items()), flush=True)
    contact_sheet(sheet, out / "contact.png")
    loss_curve(curves, out / "loss.png", title="sphere to Spot")
    before = float(surface.vertex_distances(start.positions).mean())
    write_report(options.json, bench.about, results, start_distance=round(before, 5))
    print(f"{bench.about['device']}, {bench.about['driver']}; pictures in {out}")


if __name__ == "__main__":
    main()
