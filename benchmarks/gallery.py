"""The programs of docs/examples/ on a device and in NumPy float64, with fewer pixels and steps: do both go the same way?

    python benchmarks/gallery.py [NAME ...] [--steps N] [--json FILE]

Sizes are those of tests/test_gallery.py, steps fewer. For each program its lines, and what its main() returns on lavapipe and where every
`runtime.load` gives a `ReferenceSession` of the scene that was compiled to that path.
"""
from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from test_gallery import PROGRAMS, SMALL, load  # noqa: E402

from dressi_edge import runtime  # noqa: E402
from dressi_edge.compiler.graph.reference_session import ReferenceSession  # noqa: E402
from dressi_edge.compiler.scene import Scene  # noqa: E402

SLOW = {"antialiasing", "forward", "hidden", "slant"}  # minutes in NumPy: large pictures, or many faces a pixel; run where named


def numbers(found, name: str = "") -> Iterator[tuple[str, float]]:
    """(where, number) of a nest of mappings and sequences."""
    if isinstance(found, Mapping):
        for key, value in found.items():
            yield from numbers(value, f"{name}.{key}" if name else str(key))
    elif isinstance(found, list | tuple):
        for k, value in enumerate(found):
            yield from numbers(value, f"{name}[{k}]")
    else:
        yield name, float(found)


def by_reference(run):
    """What run() returns where sessions are NumPy."""
    made, kept = {}, (Scene.compile, runtime.load)

    def compiled(scene, profile, path, *_, **__):
        made[os.fspath(path)] = scene.program

    Scene.compile, runtime.load = compiled, lambda path, *_, **__: ReferenceSession(made[os.fspath(path)])
    try:
        return run()
    finally:
        Scene.compile, runtime.load = kept


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("names", nargs="*", metavar="NAME")
    arguments.add_argument("--steps", type=int, default=12, metavar="N", help="at most so many (12)")
    arguments.add_argument("--json", metavar="FILE")
    options, rows = arguments.parse_args(), {}
    for path in PROGRAMS:
        if path.stem not in (options.names or SMALL.keys() - SLOW):
            continue
        with tempfile.TemporaryDirectory() as folder:
            def run(path=path, folder=folder):
                how = dict(SMALL[path.stem][0])
                if "steps" in how:
                    how["steps"] = min(how["steps"], options.steps)
                return dict(numbers(load(path).main(folder, **how)))

            device, began = run(), time.perf_counter()
            true = by_reference(run)
        rows[path.stem] = {"lines": len(path.read_text(encoding="utf-8").splitlines()), "device": device, "float64": true,
                           "reference_seconds": round(time.perf_counter() - began, 1)}
        print(f"{path.stem}: {rows[path.stem]['lines']} lines, {rows[path.stem]['reference_seconds']} s in NumPy", flush=True)
        for key in device:
            print(f"    {key:24} {device[key]:12.5g} {true[key]:12.5g}", flush=True)
    if options.json:
        Path(options.json).write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
