"""How a step grows: with faces, resolution, views, r and K, the exponent fitted and stated.

    python benchmarks/scaling.py [--quick] [--only WORD] [--most-faces N] [--device NAME] [--profile NAME] [--json FILE]

Each sweep changes one thing of the same problem: silhouettes against a centred square by gradient descent, one view of 256x256,
1280 faces, K = 1, r = 2. The faces' meshes are spheres with bumps. All points of a sweep take turns. growth: the exponent of
the straight line through (log x, log processor time), by least squares over the sweep, and between the last two points.

--quick takes small images and few points.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
from step import Case, Meter, bumpy, options_of, rounded, shares, table, take_turns, views, write

from dressi_edge.compiler.io.shapes import icosphere
from dressi_edge.compiler.render.optimizer import Sgd
from dressi_edge.compiler.render.raster import Softness
from dressi_edge.compiler.scene.problem import Loss, Problem

COLUMNS = ("sweep", "x", "ms", "least_ms", "cpu_ms", "of_before", "exponent", "image_MB", "most")


def sphere_of(faces: int):
    """About so many faces."""
    n = max(6, round((faces / 1.5) ** 0.5))
    return bumpy(n, max(3, round(0.75 * n)))


def problem_of(mesh=None, size: int = 256, count: int = 1, r: float = 2.0, layers: int = 1) -> Problem:
    problem = Problem(mesh or icosphere(3, 0.85), views(count, size), albedo="constant")
    problem.phase("fit", 1000, {"vertices": Sgd(1e-6)}, [Loss("silhouette")], Softness(r, layers=layers))
    return problem


def sweeps(options: argparse.Namespace) -> dict[str, list]:
    """Name -> [(x, a function that gives the problem)]."""
    if options.quick:
        s = 64
        return {"faces": [(f, lambda f=f: problem_of(sphere_of(f), s)) for f in (100, 1000)],
                "resolution": [(n, lambda n=n: problem_of(size=n)) for n in (32, 64)],
                "views": [(n, lambda n=n: problem_of(size=s, count=n)) for n in (1, 2)],
                "r": [(r, lambda r=r: problem_of(size=s, r=r)) for r in (1, 2)],
                "K": [(k, lambda k=k: problem_of(size=s, layers=k)) for k in (1, 2)]}
    faces = [f for f in (100, 1000, 10_000, 100_000, 1_000_000) if f <= options.most_faces]
    return {"faces": [(f, lambda f=f: problem_of(sphere_of(f))) for f in faces],
            "resolution": [(n, lambda n=n: problem_of(size=n)) for n in (128, 256, 512, 1024)],
            "views": [(n, lambda n=n: problem_of(count=n)) for n in (1, 2, 4, 8)],
            "r": [(r, lambda r=r: problem_of(r=r)) for r in (1, 2, 4, 8, 16)],
            "K": [(k, lambda k=k: problem_of(layers=k)) for k in (1, 2, 3, 4, 5)]}


def exponents(xs: list[float], ys: list[float]) -> tuple[float, float]:
    """Slope of log y over log x: of all points, and of the last two."""
    x, y = np.log(xs), np.log(np.maximum(ys, 1e-6))
    return rounded(float(np.polyfit(x, y, 1)[0])), rounded(float((y[-1] - y[-2]) / (x[-1] - x[-2])))


def square(case: Case) -> np.ndarray:
    shape = case.session.shape("targets")
    target = np.zeros(shape, np.float32)
    h, w = shape[1:3]
    target[:, h // 4:h - h // 4, w // 4:w - w // 4, 3] = 1.0
    return target


def sweep(name: str, points: list, options: argparse.Namespace) -> tuple[list[dict], dict]:
    opened: list[Case] = []
    with tempfile.TemporaryDirectory(prefix="dressi-scaling-") as folder:
        try:
            for _, make in points:
                case = Case(make(), Path(folder), options)
                opened.append(case)
                case.session.set("targets", square(case))
                case.session.step(2, "fit")
            meters = [Meter(case.step) for case in opened]
            take_turns(meters, options.seconds, 2)
            rows = []
            for k, ((x, _), case, meter) in enumerate(zip(points, opened, meters)):
                stages = case.stages(2)
                most = max(stages, key=lambda s: s["cpu_ms"])
                row = {"case": f"{name} {x}", "sweep": name, "x": case.faces if name == "faces" else x, **meter.row,
                       "image_MB": rounded(case.memory / 1e6), "MB_moved": rounded(case.bytes / 1e6), "cpu_ms_by_kind": shares(stages),
                       "most": f"{most['stage']} {most['cpu_ms']:.2f}", "stages": stages}
                if k:
                    row["of_before"] = rounded(row["cpu_ms"] / rows[-1]["cpu_ms"])
                    row["exponent"] = exponents([rows[-1]["x"], row["x"]], [rows[-1]["cpu_ms"], row["cpu_ms"]])[1]
                rows.append(row)
            return rows, opened[0].session.report()
        finally:
            for case in opened:
                case.__exit__()


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--most-faces", type=int, default=1_000_000, metavar="N", help="leave out meshes of more (default 1000000)")
    options = options_of(parser, arguments)
    results, growth, report = [], {}, {}
    for name, points in sweeps(options).items():
        if options.only not in name:
            continue
        rows, report = sweep(name, points, options)
        results += rows
        whole, last = exponents([row["x"] for row in rows], [row["cpu_ms"] for row in rows])
        growth[name] = {"exponent": whole, "exponent_last": last, "memory_exponent": exponents([row["x"] for row in rows],
                                                                                              [row["image_MB"] for row in rows])[0]}
        print(f"{name}: grows by the power {whole} ({last} between the last two)", flush=True)
    if not results:
        raise SystemExit(f"no sweep holds {options.only!r}")
    print(f"\n{report['device']}, {report['driver']}; milliseconds, medians\n")
    print(table(results, COLUMNS))
    write(options.json, report, results, growth=growth)


if __name__ == "__main__":
    main()
