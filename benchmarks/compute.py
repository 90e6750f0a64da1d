"""What it costs, and saves, to dispatch pixelwise work instead of drawing it: problems compiled twice, measured in turns.

    python benchmarks/compute.py [--quick] [--only WORD] [--device NAME] [--profile NAME] [--json FILE] [--docs FILE]

The problems are those of storage.py. Of each: how many of the step's stages are dispatches; whether all states after the steps, and the
loss, have the same bits either way (the program stops if not); medians of steps submitted one by one, in turns, and their ratios to
drawing all; the device's time of those stages that "all" dispatches.
"""

from __future__ import annotations

import argparse
import tempfile
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import packing
import storage
from step import Meter, options_of, rounded, table, take_turns, write

from dressi_edge import runtime
from dressi_edge.cache import bundle as bundles
from dressi_edge.cache.profile import Profile
from dressi_edge.compiler import Options, build
from dressi_edge.compiler.io.shapes import pear
from dressi_edge.compiler.scene.problem import Problem
from dressi_edge.runtime.device import Device

COLUMNS = ("case", "compute", "stages", "dispatched", "same stages ms", "ms", "cpu_ms", "ms ratio", "cpu ratio")
KINDS = ("none", "pixel", "all")


def states(session) -> dict[str, np.ndarray]:
    """Every state, and the loss."""
    names = [name for name, value in session.values.items() if value["role"] == "state" or name == f"{session.phase}.loss"]
    return {name: session.get(name) for name in names}


def measure(name: str, problem, steps: int, targets: np.ndarray, device: Device, folder: Path, options) -> list[dict]:
    rows, sessions, found = {}, {}, {}
    with ExitStack() as stack:
        for kind in KINDS:
            built = build(problem.program, Profile.load(options.profile), Options(compute=kind))
            path = folder / f"{kind}.dressi"
            bundles.write(path, built.description, built.blobs)
            stages = built.stages["step"]
            rows[kind] = {"case": name, "compute": kind, "stages": len(stages), "dispatched": sum(stage.compute for stage in stages)}
            sessions[kind] = session = stack.enter_context(runtime.load(path, device))
            session.set("targets", targets)
            session.step(steps)
            found[kind] = states(session)
            dispatched = [k for k, stage in enumerate(stages) if stage.compute]
        different = [n for n, x in found["none"].items() if any(x.tobytes() != of[n].tobytes() for of in found.values())]
        if different:
            raise SystemExit(f"{name}: other bits of {' '.join(different)}")
        meters = [Meter(lambda s=s: s.step(1)) for s in sessions.values()]
        take_turns(meters, options.seconds)
        for kind, meter in zip(KINDS, meters):
            ms = sessions[kind].profile_stages("step", 5)
            rows[kind] |= meter.row | {"same stages ms": rounded(sum(ms[k] for k in dispatched))}
            for key in ("ms", "cpu"):
                told = "ms" if key == "ms" else "cpu_ms"
                rows[kind][f"{key} ratio"] = rounded(rows[kind][told] / rows["none"][told])
    return list(rows.values())


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--docs", type=Path, metavar="FILE", help="put the table between its marks there (docs/packing.md)")
    options = options_of(parser, arguments)
    results = []
    with tempfile.TemporaryDirectory(prefix="dressi-compute-") as name, Device.open(options.device) as device:
        folder, cases = Path(name), storage.problems(options.quick)
        pictures = Problem(pear(96), next(iter(cases.values()))[0].cameras)
        pictures.render(softness=packing.HARD)
        pictures.compile(options.profile, folder / "target.dressi")
        with runtime.load(folder / "target.dressi", device) as session:
            targets, report = session.get("render.color"), session.report()
        for case, (problem, steps) in cases.items():
            if options.only in case:
                results += measure(case, problem, min(steps, 10), targets, device, folder, options)
                print(table(results[-3:], COLUMNS), flush=True)
    write(options.json, report, results)
    if options.docs:
        text = options.docs.read_text(encoding="utf-8")
        head, rest = text.split("<!-- compute -->")
        rows = ["| " + " | ".join(COLUMNS) + " |", "|---|---|" + "---:|" * (len(COLUMNS) - 2)]
        rows += ["| " + " | ".join(str(row[c]) for c in COLUMNS) + " |" for row in results]
        table_ = f"\n{report['device']}, {report['driver']}.\n\n" + "\n".join(rows) + "\n\n"
        options.docs.write_text(f"{head}<!-- compute -->\n{table_}<!-- /compute -->{rest.split('<!-- /compute -->')[1]}", encoding="utf-8")


if __name__ == "__main__":
    main()
