"""Coefficients of a linear model from silhouettes alone: 12 smooth displacements of a sphere, four views.

    python blend_shapes.py [FOLDER]
"""
import sys

import numpy as np

from dressi_edge import runtime
from dressi_edge.compiler.scene import Adam, Outline, Scene, Schedule, icosphere, l2, linear_model, mean_square, orbit, save_png


def main(folder=".", size=96, steps=200, count=12):
    """Root mean square distance of the vertices from the truth, at the start and at the end."""
    ball, rng = icosphere(3, 0.7), np.random.default_rng(5)
    p = ball.positions
    waves = [np.sin(p @ rng.normal(size=3) * 3 + rng.uniform(0, 6))[:, None] * p * 0.1 for _ in range(count)]
    basis, truth = np.stack(waves, -1), rng.normal(size=count)
    s = Scene(orbit(4, [20, -15], 3.2, 40, (size, size)))
    k = s.parameter("coefficients", np.zeros(count), kind="table")
    s.add(ball, linear_model(p, basis, k))
    seen = s.frame(Outline(r=3.0))
    mask = s.input("mask", np.zeros((4, size, size)))
    s.phase("fit", steps, {"coefficients": Adam(Schedule(0.1, 0.005, steps, "exponential"))},
            silhouette=l2(seen.alpha, mask), prior=(1e-6, mean_square(k)))
    s.output("look", alpha=seen.alpha, positions=linear_model(p, basis, k))
    s.compile("vulkan_min", f"{folder}/blend_shapes.dressi")
    with runtime.load(f"{folder}/blend_shapes.dressi") as session:
        session.set("coefficients", truth)
        target, wanted = session.get("look.alpha"), session.get("look.positions")
        session.set("coefficients", np.zeros(count))
        session.set("mask", target)
        before, start = session.get("look.alpha"), session.get("look.positions")
        session.step(steps)
        after, end = session.get("look.alpha"), session.get("look.positions")
    rows = [np.concatenate(list(pictures), 1) for pictures in (before, after, target)]
    save_png(f"{folder}/blend_shapes.png", np.repeat(np.concatenate(rows, 0)[..., None], 3, -1))
    return {name: float(np.sqrt(np.mean(np.sum((x - wanted) ** 2, 1)))) for name, x in (("start", start), ("end", end))}


if __name__ == "__main__":
    print(main(*sys.argv[1:2]))
