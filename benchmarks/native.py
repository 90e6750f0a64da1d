"""libdressi against the Python runtime on the demo's pear: the same bits after all its steps, memory, and the time to the first step.

    python benchmarks/native.py [--quick] [--bundle FILE] [--json FILE]

Each figure is that of processes of their own, by turns, with bytecode compiled and pipelines cached beforehand: peak resident memory, and
wall clock and processor time from the start of the process to the end of its first step, medians. Where the machine is busy, processor
time tells more. Needs a C compiler and Vulkan's headers.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FIRST = """
import sys
from dressi_edge import runtime
with runtime.load(sys.argv[1]) as session:
    session.step(1, sys.argv[2])
"""
ALL = """
import sys
from dressi_edge import runtime
with runtime.load(sys.argv[1]) as session:
    for name in session.phases:
        session.step(session.plans[name]["steps"], name)
    for name in sys.argv[3:]:
        open(f"{sys.argv[2]}/{name}.python", "wb").write(session.get(name).tobytes())
"""


def pear(path: Path, size: int, steps: tuple[int, int]) -> None:
    """The demo's problem: six pictures of a pear, a grey sphere."""
    from dressi_edge import runtime
    from dressi_edge.compiler.io.shapes import pear
    from dressi_edge.compiler.scene import demo
    cameras, target = demo.cameras(size), path.with_suffix(".target")
    demo.picture(pear(), cameras).compile("vulkan_min", target)
    with runtime.load(target) as session:
        images = session.get("render.color")
    demo.reconstruction(images, cameras, *steps).compile("vulkan_min", path)


def measured(command: list, env: dict) -> dict[str, float]:
    """Run to the end: wall clock and processor time in ms, peak resident memory in kB."""
    start = time.perf_counter()
    process = subprocess.Popen([*map(str, command)], env=env, stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"{command[0]} failed with {process.returncode}")
    return {"wall_ms": (time.perf_counter() - start) * 1e3, "cpu_ms": (used.ru_utime + used.ru_stime) * 1e3, "peak_kb": used.ru_maxrss}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="pictures of 32 pixels, 6 steps, 2 runs")
    parser.add_argument("--bundle", type=Path, help="this one, instead of compiling the pear")
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    runs = 2 if args.quick else 7
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        subprocess.run(["make", "-s", "-C", ROOT / "android" / "native", f"BUILD={folder}"], check=True)
        bundle = args.bundle or folder / "pear.dressi"
        if not args.bundle:
            pear(bundle, *((32, (4, 2)) if args.quick else (256, (400, 200))))
        env = os.environ | {"DRESSI_CACHE": str(folder / "cache"), "PYTHONPATH": str(ROOT)}
        from dressi_edge.cache.bundle import read
        description = read(bundle).description
        states = [value["name"] for value in description["values"] if value["role"] == "state"]
        phase = next(plan["name"] for plan in description["plans"] if plan["updates"] and plan["steps"])
        play = folder / "dressi-play"
        first = {"python": [sys.executable, "-c", FIRST, bundle, phase],
                 "native": [play, "run", bundle, "--phase", phase, "--steps", "1"]}
        rows: dict[str, list[dict]] = {name: [] for name in first}
        for k in range(runs + 1):
            for name, command in first.items():
                row = measured(command, env)
                if k:  # the first fills caches
                    rows[name].append(row)
        gets = [word for s in states for word in ("--get", f"{s}={folder / s}.native")]
        whole = {"python": measured([sys.executable, "-c", ALL, bundle, folder, *states], env),
                 "native": measured([play, "run", bundle, *gets], env)}
        equal = {s: (folder / f"{s}.python").read_bytes() == (folder / f"{s}.native").read_bytes() for s in states}
        stripped = folder / "stripped.so"
        subprocess.run(["strip", "-o", stripped, folder / "libdressi.so"], check=True)
        machine = f"{platform.machine()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}"
        medians = {name: {key: statistics.median(row[key] for row in some) for key in some[0]} for name, some in rows.items()}
        report = {"machine": machine, "python": platform.python_version(), "bundle_bytes": bundle.stat().st_size,
                  "steps": sum(plan["steps"] for plan in description["plans"]), "states_equal": equal,
                  "library_bytes": stripped.stat().st_size, "first_step": medians, "all_steps": whole}
    print(f"{report['machine']}; {report['steps']} steps: {sum(equal.values())} of {len(equal)} states equal to the bit; "
          f"libdressi.so {report['library_bytes']} bytes stripped")
    for what, some in (("to the first step", report["first_step"]), ("all steps", report["all_steps"])):
        for name, row in some.items():
            times = f"{row['wall_ms']:9.0f} ms wall {row['cpu_ms']:9.0f} ms processor"
            print(f"  {what:18} {name:7} {times} {row['peak_kb'] / 1e3:8.1f} MB peak")
    if args.json:
        args.json.write_text(json.dumps(report, indent=2) + "\n")


if __name__ == "__main__":
    main()
