"""A texture step: six views of 256x256 by colours, geometry that stays, Adam, for atlases of several sizes.

    python benchmarks/texture.py [--quick] [--only WORD] [--data DIR] [--device NAME] [--profile NAME] [--json FILE]

Mesh: Spot (DIR/meshes/spot/spot.obj) or, where that is not, the pear. Targets: the mesh drawn from the same views with a
pattern as its texture. Loss: mean squared difference of colours. Views as in benchmarks/step.py; r = 2, K = 1.

exact        the transpose of the bilinear sample, by lists made once; of large textures only what is touched is updated
dense        the same, but every texel is updated
inverse_uv   one pixel a texel and step; every texel is updated

touched: texels whose first moment is not zero after the steps; all others have no gradient. get: the texture after a step.
first: the once-only work for the geometry, with the first step. Milliseconds and processor time as in benchmarks/step.py.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from step import Case, Meter, options_of, rounded, shares, table, take_turns, views, write

from dressi_edge import runtime
from dressi_edge.compiler.io.meshes import Mesh, load_mesh, normalize
from dressi_edge.compiler.io.shapes import pear
from dressi_edge.compiler.render.optimizer import Adam
from dressi_edge.compiler.render.raster import Softness
from dressi_edge.compiler.scene.problem import Loss, Problem

COLUMNS = ("case", "ms", "least_ms", "cpu_ms", "cpu_ms_per_processor", "first_ms", "get_ms", "copy", "MB_moved", "image_MB", "touched")


def pattern(size: int) -> np.ndarray:
    """Stripes of three frequencies, (size, size, 3) in 0.1 to 0.9."""
    y, x = np.mgrid[:size, :size] / size
    waves = np.stack([np.sin(40 * x + 9 * y), np.sin(55 * y), np.sin(31 * (x - y))], -1)
    return 0.5 + 0.4 * waves


def target(mesh: Mesh, cameras, folder: Path, options: argparse.Namespace) -> np.ndarray:
    problem = Problem(replace(mesh, texture=pattern(512)), cameras)
    problem.render(softness=Softness(1.0, delta=0.0))
    problem.compile(options.profile, folder / "target.dressi")
    with runtime.load(folder / "target.dressi", options.device) as session:
        return session.get("render.color")


def problem_of(mesh: Mesh, cameras, size: int, gradient: str) -> Problem:
    problem = Problem(replace(mesh, texture=None), cameras, texture_size=(size, size), texture_grad=gradient)
    problem.phase("fit", 1000, {"texture": Adam(0.01)}, [Loss("color")], Softness(2.0))
    return problem


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options = options_of(parser, arguments)
    spot = options.data / "meshes" / "spot" / "spot.obj"
    mesh, name = (normalize(load_mesh(spot)), "Spot") if spot.is_file() and not options.quick else (pear(96), "the pear")
    size = 64 if options.quick else 256
    cameras, opened, results, first = views(6, size), {}, [], {}
    with tempfile.TemporaryDirectory(prefix="dressi-texture-") as folder:
        images = target(mesh, cameras, Path(folder), options)
        try:
            for atlas in (64, 128) if options.quick else (512, 1024, 2048, 4096):
                for way in ("exact", "dense", "inverse_uv") if atlas < 4096 else ("exact",):
                    case = f"{name}, six views {size}x{size}, atlas {atlas}, {way}"
                    if options.only not in case:
                        continue
                    how = {"exact": {"sparse_texels": 1} if options.quick else {}, "dense": {"sparse_texels": None}}.get(way, {})
                    gradient = "inverse_uv" if way == "inverse_uv" else "exact"
                    opened[case] = made = Case(problem_of(mesh, cameras, atlas, gradient), Path(folder), options, **how)
                    made.session.set("targets", images)
                    start = time.perf_counter()
                    made.step()
                    first[case] = (time.perf_counter() - start) * 1e3
                    made.session.step(5, "fit")
            if not opened:
                raise SystemExit(f"no case holds {options.only!r}")
            steps, copies = ({k: Meter(f) for k, f in rows} for rows in (
                [(k, c.step) for k, c in opened.items()], [(k, c.copy()) for k, c in opened.items()]))
            take_turns([*steps.values(), *copies.values()], options.seconds)
            for case, made in opened.items():
                start = time.perf_counter()
                made.session.get("texture")
                got = (time.perf_counter() - start) * 1e3
                stages = made.stages(3 if options.quick else 5)
                touched = int(made.session.get("texture.adam_m").any(axis=-1).sum())
                results.append({"case": case, **steps[case].row, "first_ms": rounded(first[case]), "get_ms": rounded(got),
                                "copy": copies[case].row, "MB_moved": rounded(made.bytes / 1e6),
                                "image_MB": rounded(made.memory / 1e6), "touched": touched, "host_ms": made.host_ms(10),
                                "cpu_ms_by_kind": shares(stages), "stages": stages})
                print(f"{case}: {results[-1]['ms']} ms, {results[-1]['cpu_ms']} of the processors", flush=True)
                for s in stages:
                    print(f"    {s['kind']:7} {s['stage']:16} {s['size']:>10} {s['ms']:9.3f} ms  cpu {s['cpu_ms']:9.3f} ms")
            report = made.session.report()
        finally:
            for made in opened.values():
                made.__exit__()
    print(f"\n{report['device']}, {report['driver']}; milliseconds, medians\n")
    print(table([{**row, "copy": row["copy"]["cpu_ms"]} for row in results], COLUMNS))
    write(options.json, report, results)


if __name__ == "__main__":
    main()
