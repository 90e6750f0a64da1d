"""One mesh, and the same mesh in two parts: what the second part costs a step; and what occluding contours cost.

    python benchmarks/parts.py [--size PIXELS] [--turns N]

A ball of 1280 faces, cut in two for two parts (which then are open: both sides of their faces are drawn, and the cut has edges), and two
balls of 320 faces as one mesh or two parts; in six views, vertices (and colours) optimized by Adam, profile lavapipe. Milliseconds of
processor time a step, medians of turns in which the cases alternate; ratios within a turn.
"""
from __future__ import annotations

import argparse
import resource
import tempfile
from pathlib import Path

import numpy as np

from dressi_edge import runtime
from dressi_edge.compiler.scene import Adam, Mesh, Outline, Scene, Unlit, Vertex, icosphere, l2, orbit

BALL = icosphere(3, 0.8)


def halves() -> list[Mesh]:
    """The ball in two pieces."""
    left = BALL.positions[BALL.faces].mean(1)[:, 0] > 0
    pieces = [np.unique(faces, return_inverse=True) for faces in (BALL.faces[left], BALL.faces[~left])]
    return [Mesh(BALL.positions[used], index.reshape(-1, 3)) for used, index in pieces]


def balls() -> list[Mesh]:
    """Two closed pieces."""
    return [Mesh(icosphere(2, 0.45).positions + (x, 0.0, 0.0), icosphere(2, 0.45).faces) for x in (-0.45, 0.45)]


def joined(meshes: list[Mesh]) -> list[Mesh]:
    """The same as one mesh."""
    first = np.cumsum([0, *(len(m.positions) for m in meshes)])
    return [Mesh(np.concatenate([m.positions for m in meshes]), np.concatenate([m.faces + k for m, k in zip(meshes, first)]))]


def scene(meshes: list[Mesh], colors: bool, contours: bool, size: int) -> Scene:
    """A phase "fit" over all meshes: silhouettes, and colours if asked for."""
    s, optimize = Scene(orbit(6, [20, -15], 2.7, 45, (size, size))), {}
    for k, mesh in enumerate(meshes):
        x = s.parameter(f"vertices{k}", mesh.positions)
        optimize[f"vertices{k}"] = Adam(1e-6)
        paint = None
        if colors:
            paint = Unlit(Vertex(s.parameter(f"colors{k}", np.full(mesh.positions.shape, 0.5))))
            optimize[f"colors{k}"] = Adam(1e-6)
        s.add(mesh, x, paint)
    f = s.frame(Outline(contours=contours))
    terms = {"silhouette": l2(f.alpha, s.input("mask", np.zeros((6, size, size))))}
    if colors:
        terms["color"] = l2(f.color, s.input("photo", np.full((6, size, size, 3), 0.3)))
    s.phase("fit", 10, optimize, **terms)
    return s


def spent() -> float:
    """Seconds of processor time of this process so far."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    arguments.add_argument("--size", type=int, default=256)
    arguments.add_argument("--turns", type=int, default=9)
    options = arguments.parse_args()
    cases = {"closed silhouettes, one part": (joined(balls()), False, False), "closed silhouettes, two parts": (balls(), False, False),
             "closed colours, one part": (joined(balls()), True, False), "closed colours, two parts": (balls(), True, False),
             "silhouettes, one part": ([BALL], False, False), "silhouettes, two parts": (halves(), False, False),
             "colours, one part": ([BALL], True, False), "colours, two parts": (halves(), True, False),
             "colours, contours": ([BALL], True, True)}
    with tempfile.TemporaryDirectory() as folder:
        sessions, times = {}, {name: [] for name in cases}
        for k, (name, what) in enumerate(cases.items()):
            path = Path(folder) / f"{k}.dressi"
            scene(*what, options.size).compile("lavapipe", path)
            sessions[name] = runtime.load(path)
            sessions[name].step(3)
        for _ in range(options.turns):
            for name, session in sessions.items():
                start = spent()
                session.step(4)
                session.loss()
                times[name].append((spent() - start) / 4 * 1e3)
        print(f"{'case':30} {'cpu ms':>8} {'ratio':>6} {'stages':>6}")
        for name, session in sessions.items():
            first = times[name.split(",")[0] + ", one part"]
            print(f"{name:30} {np.median(times[name]):8.1f} {np.median(np.divide(times[name], first)):6.2f} "
                  f"{len(session.plans['fit']['stages']):6}")
            session.close()


if __name__ == "__main__":
    main()
