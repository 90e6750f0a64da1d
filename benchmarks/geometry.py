"""Parametrized geometry: what a step costs that moves many vertices by few numbers, and what compiling and keeping it takes.

    python benchmarks/geometry.py [--quick] [--only WORD] [--device NAME] [--profile NAME] [--json FILE]

A step: vertices from parameters, mean squared distance from a target, the gradient, Adam. Nothing is drawn, so what is measured is the
geometry and its transpose. Numbers are random.

linear       a dense basis of 100 shapes of 100 000 vertices (`linear_model`)
blend        100 shapes that move 2 000 of 100 000 vertices each (`blend_shapes`)
skin         100 000 vertices, 4 of 50 bones each (`skin`)
subdivide    an icosphere of 2 562 vertices subdivided twice (Loop): 40 962 vertices
large steps  an icosphere of 2 562 vertices by smooth coordinates (`LargeSteps`), a dense inverse

compile: seconds from arrays to the bundle on disk, and of processor time. load: from the bundle to a session with its first step. bundle,
image: megabytes on disk, and of images on the device. host: megabytes that a process of its own grows by at most, from making the arrays
to the bundle. Milliseconds and processor time as in benchmarks/step.py.
"""

from __future__ import annotations

import argparse
import multiprocessing
import resource
import tempfile
import time
from pathlib import Path

import numpy as np
from step import Meter, options_of, rounded, table, take_turns, write

from dressi_edge import runtime
from dressi_edge.compiler.io.shapes import icosphere
from dressi_edge.compiler.render.topology import Topology
from dressi_edge.compiler.scene import Adam, LargeSteps, Scene, blend_shapes, l2, linear_model, look_at, skin, subdivide

COLUMNS = ("case", "compile_s", "compile_cpu_s", "load_s", "bundle_MB", "image_MB", "host_MB", "ms", "least_ms", "cpu_ms")


def linear(s: Scene, n: int, rng):
    basis = rng.standard_normal((n, 3, 100), np.float32)
    return linear_model(rng.normal(size=(n, 3)), basis, s.parameter("shape", np.zeros(100), kind="table"))


def blend(s: Scene, n: int, rng):
    each = n // 50
    vertex = np.concatenate([rng.choice(n, each, replace=False) for _ in range(100)])
    return blend_shapes(rng.normal(size=(n, 3)), vertex, np.repeat(np.arange(100), each), rng.normal(size=(100 * each, 3)),
                        s.parameter("shape", np.zeros(100), kind="table"))


def skinned(s: Scene, n: int, rng):
    weight = rng.uniform(0.1, 1.0, (n, 4))
    bone = np.argsort(rng.uniform(size=(n, 50)), 1)[:, :4]
    turn, move = (s.parameter(name, np.zeros((50, 3)), kind="table") for name in ("turn", "move"))
    weights = np.repeat(np.arange(n), 4), bone.reshape(-1), (weight / weight.sum(1, keepdims=True)).reshape(-1)
    return skin(rng.normal(size=(n, 3)), weights, turn, move, rng.normal(size=(50, 3)))


def subdivided(s: Scene, n: int, rng):
    coarse = icosphere(4 if n > 10000 else 1)
    return subdivide(coarse, 2)[1](s.parameter("vertices", coarse.positions))


def large_steps(s: Scene, n: int, rng):
    mesh = icosphere(4 if n > 10000 else 1)
    steps = LargeSteps(Topology(mesh.faces, len(mesh.positions)))
    return steps(s.parameter("u", steps.encode(mesh.positions)))


CASES = {"linear": linear, "blend": blend, "skin": skinned, "subdivide": subdivided, "large steps": large_steps}


def peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def processor_s() -> float:
    """Of this process and those that it has waited for."""
    return sum(sum(resource.getrusage(who)[:2]) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))


def compiled(case: str, n: int, path: Path, profile: str) -> dict:
    """Compiles a case to `path`; what that took."""
    make, rng = CASES[case], np.random.default_rng(0)
    s, before, start = Scene([look_at((0, 0, 3), (0, 0, 0), (0, 1, 0), 40.0, 8, 8)]), peak_mb(), time.perf_counter()
    used = processor_s()
    positions = make(s, n, rng)
    target = s.input("target", rng.normal(size=(positions.extent.count, 3)), kind="table")
    s.phase("fit", 100, {name: Adam(0.01) for name in s.parameters}, near=l2(positions, target))
    s.compile(profile, path)
    return {"compile_s": rounded(time.perf_counter() - start),
            "compile_cpu_s": rounded(processor_s() - used), "host_MB": rounded(peak_mb() - before),
            "bundle_MB": rounded(path.stat().st_size / 1e6), "vertices": positions.extent.count}


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options = options_of(parser, arguments)
    n, results, sessions = 1000 if options.quick else 100_000, [], []
    with tempfile.TemporaryDirectory(prefix="dressi-geometry-") as folder:
        try:
            chosen = {case: Path(folder) / f"{case}.dressi" for case in CASES if options.only in case}
            if not chosen:
                raise SystemExit(f"no case holds {options.only!r}")
            for case, path in chosen.items():
                with multiprocessing.get_context("fork").Pool(1) as process:
                    results.append({"case": case, **process.apply(compiled, (case, n, path, options.profile))})
            for row, path in zip(results, chosen.values()):
                start = time.perf_counter()
                sessions.append(runtime.load(path, options.device))
                sessions[-1].step(1)
                report = sessions[-1].report()
                row |= {"load_s": rounded(time.perf_counter() - start), "image_MB": rounded(report["image_bytes"] / 1e6)}
            meters = [Meter(lambda s=s: s.step(1)) for s in sessions]
            take_turns(meters, options.seconds)
            results = [{**row, **meter.row} for row, meter in zip(results, meters)]
        finally:
            for session in sessions:
                session.close()
    print(f"{report['device']}, {report['driver']}; {n} vertices; milliseconds, medians\n")
    print(table(results, COLUMNS))
    write(options.json, report, results)


if __name__ == "__main__":
    main()
