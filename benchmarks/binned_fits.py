"""Silhouette fits with every face counting, beside one layer and three: distance to the true surface, processor time of a step.

    python benchmarks/binned_fits.py [--quick] [--steps N] [--data DIR] [--device NAME] [--profile NAME] [--json FILE]

A sphere of 1280 faces becomes Spot by six views of 128x128, as in sphere_to_spot.py, case "hard": the target is 0 or 1 a pixel, r = 2,
sigma = r / 7, Adam 0.01, 0.05 times the Laplacian. The renderers take turns of ten steps. --quick takes the pear and small pictures.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import metrics
import numpy as np
from sphere_to_spot import STOPS, cameras
from step import options_of, processor_ms, rounded, table, write

from dressi_edge import runtime
from dressi_edge.compiler.io.meshes import load_mesh, normalize
from dressi_edge.compiler.io.shapes import icosphere, pear
from dressi_edge.compiler.render.loss import l2, uniform_laplacian
from dressi_edge.compiler.render.optimizer import Adam
from dressi_edge.compiler.render.raster import Binned, HardSoftRas, Outline
from dressi_edge.compiler.scene.scene import Scene

RENDERERS = {"outline": Outline(2.0), "face K=3": HardSoftRas(2.0, 3), "binned": Binned(2.0)}
TURN = 10


def target_of(mesh, views, options, folder: Path) -> np.ndarray:
    """Masks of the views, 0 or 1."""
    scene = Scene(views)
    scene.add(mesh)
    scene.output("look", mask=scene.frame().mask)
    scene.compile(options.profile, folder / "target.dressi")
    with runtime.load(folder / "target.dressi", options.device) as session:
        return session.get("look.mask")


def opened(renderer, views, target: np.ndarray, steps: int, options, folder: Path):
    """A session of the fit."""
    ball, scene = icosphere(3, 0.6), Scene(views)
    x = scene.parameter("vertices", ball.positions)
    part = scene.add(ball, x)
    mask = scene.input("mask", target)
    scene.phase("fit", steps, {"vertices": Adam(0.01)}, silhouette=l2(scene.frame(renderer).alpha, mask),
                smooth=(0.05, uniform_laplacian(x, part.topology)))
    scene.compile(options.profile, folder / "fit.dressi")
    return runtime.load(folder / "fit.dressi", options.device).__enter__()


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, help="iterations (default 500)")
    options = options_of(parser, arguments)
    path = options.data / "meshes" / "spot" / "spot.obj"
    mesh = normalize(load_mesh(path)) if path.exists() and not options.quick else pear(48)
    steps, views = options.steps or (20 if options.quick else 500), cameras(32 if options.quick else 128)
    surface, rows, sessions = metrics.Surface(mesh.positions, mesh.faces), {}, {}
    with tempfile.TemporaryDirectory(prefix="dressi-fits-") as folder:
        target = target_of(mesh, views, options, Path(folder))
        for name, renderer in RENDERERS.items():
            sessions[name] = opened(renderer, views, target, steps, options, Path(folder))
            rows[name] = {"case": name, "cpu": []}
        try:
            for done in range(TURN, steps + 1, TURN):
                for name, session in sessions.items():
                    before = processor_ms()
                    session.step(TURN)
                    rows[name]["cpu"].append((processor_ms() - before) / TURN)
                    if done in STOPS or done == steps:
                        rows[name][f"distance_{done}"] = rounded(float(surface.vertex_distances(session.get("vertices")).mean()))
                        results = [{**row, "cpu": rounded(float(np.median(row["cpu"])))} for row in rows.values()]
                        write(options.json, session.report(), results, steps=done)
        finally:
            for session in sessions.values():
                session.__exit__(None, None, None)
    print(table(results, list(results[0])))


if __name__ == "__main__":
    main()
