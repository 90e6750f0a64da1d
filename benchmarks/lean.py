"""What embedding the runtime costs: imports, installed bytes, memory and host time of a step.

    python benchmarks/lean.py [--quick] [--device NAME] [--json FILE]

Each figure is the median of processes of their own, with bytecode compiled beforehand. Host time is Python's share of a step:
the driver's submit and wait do nothing while it is taken.
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
from importlib import metadata
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PARTS = ("runtime", "cache")

IMPORT = """
import sys, time
def rss():
    try:
        with open("/proc/self/status") as f:
            return next(int(line.split()[1]) for line in f if line.startswith("VmRSS"))
    except OSError:
        return 0
import msgpack, numpy
modules, memory, start = set(sys.modules), rss(), time.perf_counter()
from dressi_edge import runtime
runtime.load
imported, ours, after = (time.perf_counter() - start) * 1e3, set(sys.modules) - modules, rss()
from dressi_edge.runtime.device import Device
device = Device.open(sys.argv[2] or None)
opened = rss()
session = runtime.load(sys.argv[1], device)
session.step(3)
session.get("picture")
ran = rss()
more = set(sys.modules) - modules - ours
import json
print(json.dumps({"import_ms": imported, "modules": sorted(ours), "later": sorted(more), "rss_import_kb": after - memory,
                  "rss_device_kb": opened - after, "rss_session_kb": ran - opened, "device": device.name,
                  "driver": device.driver, "image_bytes": session.report()["image_bytes"]}))
session.close()
device.close()
"""


def build(path: Path) -> None:
    """A small problem: two states of 4000 points pulled to an input, with a picture."""
    from dressi_edge.cache.layout import Layout
    from dressi_edge.compiler import Program, compile_program
    from dressi_edge.compiler.graph.functions import apply, mean

    table, unit = Layout("table", "vec3", count=4000), Layout("unit", "float")
    program = Program()
    points, speed = program.state("points", table, 0.5), program.state("speed", table, 0.0)
    target = program.input("target", table, 0.25)
    error = points - target
    moved = speed * 0.9 - error * 0.1
    program.plan("pull", {"points": points + moved, "speed": moved}, {"loss": (mean(apply("dot", error, error)), unit)})
    program.plan("picture", {}, {"picture": (points * 2.0, table)})
    compile_program(program, "lavapipe", path)


class Nothing:
    """The Vulkan library, its queue idle at once."""

    def __init__(self, library):
        self.library = library

    def __getattr__(self, name):
        return (lambda *_: 0) if name in ("vkQueueSubmit", "vkWaitForFences", "vkResetFences") else getattr(self.library, name)


def host_time(path: Path, device: str | None, runs: int) -> dict[str, float]:
    """Microseconds of Python in step(1), and in step(100) by iteration; milliseconds of both with the device at work."""
    from dressi_edge import runtime
    from dressi_edge.runtime import vk

    def median(work, count):
        times = []
        for _ in range(count):
            start = time.perf_counter()
            work()
            times.append(time.perf_counter() - start)
        return statistics.median(times)

    with runtime.load(path, device) as session:
        session.step(2)
        real = median(lambda: session.step(1), runs), median(lambda: session.step(100), max(1, runs // 50)) / 100
        library = vk._lib
        vk._lib = Nothing(library)
        try:
            host = median(lambda: session.step(1), runs * 5), median(lambda: session.step(100), runs) / 100
        finally:
            vk._lib = library
    return {"host_us_step_1": host[0] * 1e6, "host_us_step_100": host[1] * 1e6, "ms_step_1": real[0] * 1e3,
            "ms_step_100": real[1] * 1e3}


def installed() -> dict[str, int]:
    """Bytes and lines of each part's Python files; how much of it is the generated binding."""
    sizes = {}
    for part in PARTS:
        files = list((ROOT / "dressi_edge" / part).glob("*.py"))
        sizes[part] = sum(f.stat().st_size for f in files)
        sizes[f"{part}_files"] = len(files)
    sizes["binding"] = (ROOT / "dressi_edge" / "runtime" / "vk.py").stat().st_size
    return sizes


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="fewer runs")
    parser.add_argument("--device", help="part of a device's name")
    parser.add_argument("--json", type=Path, help="where to write the figures")
    options = parser.parse_args()
    runs = 3 if options.quick else 9
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "lean.dressi"
        build(path)
        rows, environment = [], {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONPYCACHEPREFIX": str(Path(folder) / "bytecode")}
        environment.pop("PYTHONDONTWRITEBYTECODE", None)
        for _ in range(runs + 1):  # the first compiles bytecode and fills caches
            done = subprocess.run([sys.executable, "-c", IMPORT, str(path), options.device or ""], env=environment,
                                  capture_output=True, text=True, check=True)
            rows.append(json.loads(done.stdout))
        row = {name: statistics.median(r[name] for r in rows[1:]) if name.endswith(("_ms", "_kb")) else value
               for name, value in rows[-1].items()}
        row["import_ms_least"] = min(r["import_ms"] for r in rows[1:])
        row |= host_time(path, options.device, 100 if options.quick else 400)
    row["installed_bytes"] = installed()
    versions = {"driver": row.pop("driver"), "python": platform.python_version(), "numpy": metadata.version("numpy"),
                "system": f"{platform.system()} {platform.machine()}, {os.cpu_count()} CPUs"}
    told = {"device": row.pop("device"), "versions": versions, "results": [{"case": "lean", "runs": runs, **row}]}
    size = row["installed_bytes"]
    own = [m for m in row["modules"] if m.startswith("dressi_edge")]
    print(f"{told['device']}, {versions['driver']}; Python {versions['python']}, {versions['system']}; median of {runs} processes\n")
    for name, value in (
            ("modules beyond numpy and msgpack", f"{len(row['modules'])}, {len(own)} of them ours"),
            ("import beyond numpy and msgpack", f"{row['import_ms']:.0f} ms, least {row['import_ms_least']:.0f} ms"),
            ("Python of runtime and cache", f"{(size['runtime'] + size['cache']) / 1e3:.0f} kB in "
                                            f"{size['runtime_files'] + size['cache_files']} files"),
            ("of which the Vulkan binding", f"{size['binding'] / 1e3:.0f} kB"),
            ("RSS of the import", f"{row['rss_import_kb'] / 1024:.1f} MB"),
            ("RSS of the driver and its device", f"{row['rss_device_kb'] / 1024:.1f} MB"),
            (f"RSS of a session with {row['image_bytes'] / 1e6:.1f} MB of images", f"{row['rss_session_kb'] / 1024:.1f} MB"),
            ("Python in step(1)", f"{row['host_us_step_1']:.0f} us"),
            ("Python in step(100), an iteration", f"{row['host_us_step_100']:.2f} us"),
            ("step(1) in all", f"{row['ms_step_1']:.3f} ms"),
            ("step(100) in all, an iteration", f"{row['ms_step_100']:.3f} ms")):
        print(f"| {name:48} | {value:26} |")
    if options.json:
        options.json.parent.mkdir(parents=True, exist_ok=True)
        options.json.write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
