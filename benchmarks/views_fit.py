"""What more pixels bring: the same photographs whole and averaged down, one view a step; how near the fits are.

    python benchmarks/views_fit.py [--views 100] [--size 800] [--sizes 400,800] [--steps 500,200] [--data DIR] [--json FILE]

A sphere becomes the pear of photographs.py: shape by silhouettes, then texture. All results are drawn at the full size and compared with
the photographs in every fifth view (IoU of masks, PSNR inside them), and their surfaces with the true one (Chamfer distance).
"""
from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "benchmarks")]

import metrics  # noqa: E402
import numpy as np  # noqa: E402
from photographs import draw  # noqa: E402

from dressi_edge import runtime  # noqa: E402
from dressi_edge.compiler.io.shapes import pear, sphere  # noqa: E402
from dressi_edge.compiler.io.views import Views, load_views  # noqa: E402
from dressi_edge.compiler.scene import Adam, Loss, Problem, Schedule, Softness  # noqa: E402
from dressi_edge.compiler.scene.results import measure  # noqa: E402

SHARP = Softness(r=1.0, delta=0.0)
FRACTION = 0.005  # r of the larger side


def problem(views: Views, steps: list[int]) -> Problem:
    made = Problem(sphere(2562, 0.6), views, order="shuffle", albedo="texture", texture_size=(600, 400), embed=False)
    r = FRACTION * max(made.width, made.height)
    made.phase("shape", steps[0], {"vertices": Adam(Schedule(0.01, 0.001, steps[0], "exponential"))},
               [Loss("silhouette"), Loss("laplacian", 0.05)], Softness(r=r))
    made.phase("texture", steps[1], {"texture": Adam(0.03)}, [Loss("color", masked=True)], Softness(r=r, delta=0.0))
    made.render("render", SHARP)
    return made


def fitted(views: Views, steps: list[int], profile: str, path: Path) -> tuple[dict[str, np.ndarray], dict]:
    """What a fit to these views gives, and what it took."""
    problem(views, steps).compile(profile, path)
    with runtime.load(path) as session:
        session.pictures(views.images.picture)
        took = {}
        for phase, n in zip(session.phases, steps):
            start, cpu = time.perf_counter(), time.process_time()
            session.step(n, phase)
            took |= {f"{phase}_s": time.perf_counter() - start, f"{phase}_cpu_s": time.process_time() - cpu}
        took |= {"image_mb": session.report()["image_bytes"] / 1e6, "views_kept": session.report()["views_kept"]["texture"]}
        return {name: session.get(name) for name in ("vertices", "texture")}, took


def compared(found: dict[str, np.ndarray], views: Views, path: Path) -> dict[str, float]:
    """Of a fit, drawn by the bundle at `path`."""
    true, faces = pear(), np.asarray(sphere(2562, 0.6).faces)
    surface = metrics.Surface(np.asarray(true.positions), np.asarray(true.faces))
    with runtime.load(path) as session:
        for name, value in found.items():
            session.set(name, value)
        some = range(0, len(views), 5)
        seen = measure((session.get("render.color", view=k) for k in some), (views.images[k] for k in some))
    distance = surface.measure(found["vertices"].astype(np.float64), faces)
    return {"chamfer": distance.chamfer, "normal_degrees": distance.normal, **{k: float(x) for k, x in seen.items() if np.ndim(x) == 0}}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--views", type=int, default=100)
    parser.add_argument("--size", type=int, default=800)
    parser.add_argument("--sizes", default="400,800")
    parser.add_argument("--steps", default="500,200")
    parser.add_argument("--profile", default="lavapipe")
    parser.add_argument("--data", type=Path, help="folder to keep the photographs in")
    parser.add_argument("--json", type=Path, default=ROOT / "benchmarks" / "results" / "views_fit.json")
    options = parser.parse_args()
    steps = [int(x) for x in options.steps.split(",")]
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = draw((options.data or Path(name)) / f"{options.views}x{options.size}", options.views, options.size, options.profile)
        whole = load_views(folder)
        problem(whole, steps).compile(options.profile, path := Path(name) / "whole.dressi")
        for size in map(int, options.sizes.split(",")):
            views = load_views(folder, size if size < options.size else None)
            found, took = fitted(views, steps, options.profile, Path(name) / f"{size}.dressi")
            rows.append({"size": size, "load": os.getloadavg()[0], **took, **compared(found, whole, path)})
            print(", ".join(f"{key} {x:.4g}" for key, x in rows[-1].items()), flush=True)
    options.json.write_text(json.dumps({"profile": options.profile, "views": options.views, "steps": steps, "rows": rows}, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
