"""Does what a problem takes grow with its photographs? Compiling, starting, stepping, and what lies on the device.

    python benchmarks/views.py [--size 256] [--views 24,100,400] [--steps 40] [--data DIR] [--json FILE]

Photographs of a pear are drawn first (photographs.py; kept in DIR). A job of two phases, one view a step (order "shuffle"), is compiled
without its pictures and run with them beside it. Compiling and running are processes of their own: peak memory is that of all they do.
Processor time is that of the whole process, so that a busy machine matters less; wall time is beside it.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "benchmarks")]

JOB = """
[mesh]
sphere = {{vertices = 2562, radius = 0.6}}
[views]
transforms = "{folder}"
order = "shuffle"
[[phase]]
name = "shape"
steps = 100
optimize.vertices = {{optimizer = "adam", rate = {{start = 0.01, end = 0.001}}}}
[[phase.loss]]
kind = "silhouette"
[[phase.loss]]
kind = "laplacian"
weight = 0.05
[[phase]]
name = "texture"
steps = 100
optimize.texture = {{optimizer = "adam", rate = 0.03}}
[[phase.loss]]
kind = "color"
masked = true
"""


def _peak() -> float:
    """Megabytes of this process at the most."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def compiled(job: Path, bundle: Path, profile: str, memory: int | None) -> dict:
    from dressi_edge.cache.profile import Profile
    from dressi_edge.compiler.scene.job import load_job
    from dressi_edge.compiler.scene.targets import Carried
    start, cpu, profiles = time.perf_counter(), time.process_time(), [Profile.load(profile)]
    loaded = load_job(job, profiles, carried=Carried(False, memory))
    read = time.process_time() - cpu
    loaded.compile(profiles, bundle)
    return {"compile_s": time.perf_counter() - start, "compile_cpu_s": time.process_time() - cpu, "read_cpu_s": read, "compile_mb": _peak(),
            "bundle_mb": bundle.stat().st_size / 1e6}


def ran(bundle: Path, folder: Path, steps: int, texture_steps: int) -> dict:
    from dressi_edge import runtime
    from dressi_edge.compiler.io.again import reader
    start, cpu = time.perf_counter(), time.process_time()
    with runtime.load(bundle) as session:
        session.pictures(reader(folder, session.bundle.description["meta"]["pictures"], False))
        session.step(1)
        found = {"first_step_s": time.perf_counter() - start, "first_step_cpu_s": time.process_time() - cpu}
        once = session.shape("targets")[0]
        for phase, n in (("shape", steps), ("texture", texture_steps)):  # in the first round each picture is read, and what is kept is made
            for part, k in (("first_round_", once), ("", n)):
                start, cpu = time.perf_counter(), time.process_time()
                session.step(k, phase)
                found |= {f"{phase}_{part}ms": (time.perf_counter() - start) / k * 1e3,
                          f"{phase}_{part}cpu_ms": (time.process_time() - cpu) / k * 1e3}
        report = session.report()
        found |= {"image_mb": report["image_bytes"] / 1e6, "run_mb": _peak(), "views_kept": report["views_kept"]["texture"],
                  "slots": session.values["targets"]["count"], "device": session.device.name}
    return found


def _apart(*arguments) -> dict:
    """A part of this program in a process of its own."""
    out = subprocess.run([sys.executable, __file__, "--part", json.dumps(arguments)], capture_output=True, text=True, check=True,
                         env={**os.environ, "PYTHONPATH": str(ROOT)})
    return json.loads(out.stdout.splitlines()[-1])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--views", default="24,100,400")
    parser.add_argument("--steps", type=int, default=40)
    parser.add_argument("--texture-steps", type=int, default=40)
    parser.add_argument("--profile", default="lavapipe")
    parser.add_argument("--memory", type=int, help="bytes, as compile --memory")
    parser.add_argument("--data", type=Path, help="folder to keep the photographs in")
    parser.add_argument("--json", type=Path, default=ROOT / "benchmarks" / "results" / "views.json")
    parser.add_argument("--part", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.part:
        kind, *rest = json.loads(options.part)
        result = compiled(Path(rest[0]), Path(rest[1]), *rest[2:]) if kind == "compile" else ran(Path(rest[0]), Path(rest[1]), *rest[2:])
        print(json.dumps(result))
        return 0
    from photographs import draw
    rows = []
    with tempfile.TemporaryDirectory() as name:
        data = options.data or Path(name)
        for count in map(int, options.views.split(",")):
            folder = draw(data / f"{count}x{options.size}", count, options.size, options.profile)
            job, bundle = Path(name) / f"{count}.toml", Path(name) / f"{count}.dressi"
            job.write_text(JOB.format(folder=folder.resolve()))
            row = {"views": count, "size": options.size, "load": os.getloadavg()[0]}
            row |= _apart("compile", str(job), str(bundle), options.profile, options.memory)
            row |= _apart("run", str(bundle), str(folder), options.steps, options.texture_steps)
            rows.append(row)
            told = [f"{key} {x:.4g}" if isinstance(x, float) else f"{key} {x}" for key, x in row.items() if key not in ("views", "size")]
            print(f"{count:4d} views of {options.size}x{options.size}: {', '.join(told)}", flush=True)
    options.json.write_text(json.dumps({"profile": options.profile, "rows": rows}, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
