"""Fits by colours alone where surfaces hide each other, without and with gradients at occluding contours.

    python benchmarks/contour_fits.py [--size 128] [--steps 200] [--views 3] [--cases balls hand ring spot] [--data DIR] [--json FILE]

balls  a small painted ball before a large one; where both are is not known
hand   four fingers before a palm; where each finger is, is not known (colours of a finger hardly change across it)
ring   a torus over itself, bent by 12 smooth displacements of unknown strength
spot   the same of DIR/meshes/spot/spot.obj

Targets are sharp pictures of 64 samples a pixel, drawn from the truth. Told are root mean square distances from the truth at the start and
at the end, in pixels of the first view (balls: of the centres; else of vertices), and the loss.
"""
from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests"), str(ROOT / "benchmarks")]

from contours import cases, paint, rod, together  # noqa: E402

from dressi_edge import runtime  # noqa: E402
from dressi_edge.compiler.graph.functions import constant_table  # noqa: E402
from dressi_edge.compiler.render.raster.hard import Hard  # noqa: E402
from dressi_edge.compiler.scene import (  # noqa: E402
    Adam,
    Mesh,
    Outline,
    Scene,
    Schedule,
    Unlit,
    Vertex,
    icosphere,
    l2,
    linear_model,
    look_at,
)
from dressi_edge.runtime.device import Device  # noqa: E402

SAMPLES = 8  # a pixel's side
DISTANCE = 4.0


def waves(positions, count, size):
    """(V, 3, count): smooth displacements, the longest of each `size`."""
    rng, found = np.random.default_rng(4), []
    for _ in range(count):
        wave = np.sin(positions @ rng.normal(0, 2.5, 3) + rng.uniform(0, 6))[:, None] * rng.normal(size=3)
        found.append(wave * size / np.linalg.norm(wave, axis=1).max())
    return np.stack(found, -1)


def moving(folder):
    """name: (positions, faces, basis): vertices are positions + basis times coefficients, which start at 0 and are wanted
    as drawn from a fixed seed."""
    found, ball = {}, icosphere(3, 1.0)
    pieces = (ball.positions * 0.3 + (0.05, 0.02, 0.9), ball.faces), (ball.positions * 0.8, ball.faces)
    found["balls"] = (*together(*pieces), shifts([len(p) for p, _ in pieces], 0.08))
    palm = ball.positions * (0.75, 0.65, 0.15) - (0.0, 0.1, 0.3), ball.faces
    fingers = [rod((0.32 * k - 0.48, -0.35, 0.2), (0.36 * k - 0.54, 0.5 + 0.05 * (k % 2), 0.3), 0.1) for k in range(4)]
    found["hand"] = (*together(palm, *fingers), shifts([0, *(len(p) for p, _ in fingers)], 0.05, len(palm[0])))
    drawn = cases(folder)
    for name in ("ring", "spot"):
        if name in drawn:
            positions, faces = drawn[name]
            found[name] = positions, faces, waves(positions, 12, 0.03)
    return found


def shifts(counts, size, before=0):
    """(V, 3, 3 n): each piece of so many vertices along each axis; `before` vertices at first that stay."""
    counts = [c for c in counts if c]
    basis = np.zeros((before + sum(counts), 3, 3 * len(counts)))
    for k, first in enumerate(before + np.cumsum([0, *counts[:-1]])):
        for axis in range(3):
            basis[first:first + counts[k], axis, 3 * k + axis] = size
    return basis


def scene_of(positions, faces, basis, cameras, colors):
    s = Scene(cameras, (0.1, 0.1, 0.15))
    k = s.parameter("k", np.zeros(basis.shape[2]), kind="table")
    vertices = linear_model(positions, basis, k)
    s.add(Mesh(positions, faces), vertices, Unlit(Vertex(constant_table(colors))))
    return s


def around(views, size):
    """Cameras side by side, 25 degrees to either side of +z."""
    for angle in np.radians(np.linspace(-25, 25, views)) if views > 1 else (0.0,):
        yield look_at(DISTANCE * np.array((np.sin(angle), 0.15, np.cos(angle))), (0, 0, 0), (0, 1, 0), 28, size, size)


def fit(positions, faces, basis, options, device, folder):
    """Distance at the start, and by setting the distance and the loss at the end."""
    truth = np.random.default_rng(2).normal(size=basis.shape[2])
    colors, n, views = paint(positions), options.size, options.views
    fine = scene_of(positions, faces, basis, list(around(views, n * SAMPLES)), colors)
    fine.output("look", color=fine.frame(Hard()).color)
    fine.compile("lavapipe", f"{folder}/fine.dressi")
    with runtime.load(f"{folder}/fine.dressi", device) as session:
        session.set("k", truth)
        target = session.get("look.color").reshape(views, n, SAMPLES, n, SAMPLES, 3).mean((2, 4))
    cameras = list(around(views, n))
    moves, pixels = np.abs(basis).sum((1, 2)) > 0, cameras[0].fx / DISTANCE

    def off(k):
        return float(np.sqrt(np.mean(np.sum((basis[moves] @ (k - truth)) ** 2, 1))) * pixels)

    rows = {"start": off(np.zeros_like(truth))}
    for contours in (False, True):
        s = scene_of(positions, faces, basis, cameras, colors)
        photo = s.input("photo", np.zeros(target.shape))
        s.phase("fit", options.steps, {"k": Adam(Schedule(0.05, 0.005, options.steps, "exponential"))},
                color=l2(s.frame(Outline(2.0, contours=contours)).color, photo))
        s.compile("lavapipe", f"{folder}/fit.dressi")
        with runtime.load(f"{folder}/fit.dressi", device) as session:
            session.set("photo", target)
            session.step(options.steps)
            rows["contours" if contours else "without"] = {"pixels": off(session.get("k")), "loss": session.loss()}
    return rows


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--size", type=int, default=128)
    arguments.add_argument("--steps", type=int, default=200)
    arguments.add_argument("--views", type=int, default=3)
    arguments.add_argument("--cases", nargs="+")
    arguments.add_argument("--data", type=Path, default=ROOT.parent / "shared")
    arguments.add_argument("--device")
    arguments.add_argument("--json", type=Path)
    options, found = arguments.parse_args(), {}
    with Device.open(options.device) as device, tempfile.TemporaryDirectory() as folder:
        for name, (positions, faces, basis) in moving(options.data).items():
            if options.cases and name not in options.cases:
                continue
            found[name] = row = fit(positions, faces, basis, options, device, folder)
            print(f"{name:6} start {row['start']:.3f} px" + "".join(
                f"   {key} {row[key]['pixels']:.4f} px, loss {row[key]['loss']:.2e}" for key in ("without", "contours")), flush=True)
    if options.json:
        options.json.write_text(json.dumps({"options": {"size": options.size, "steps": options.steps, "views": options.views},
                                            "cases": found}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
