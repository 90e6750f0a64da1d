"""Time from process start to the first finished step, by phase, with cold and warm caches of compiled pipelines.

    python benchmarks/start.py [--quick] [--runs N] [--device NAME] [--json FILE]

The problem: silhouettes of six 256x256 views of a sphere of 1280 faces, fitted by gradient descent. Each run is a process of
its own, and the cases take turns so that a busy machine slows all of them alike; medians are quoted, and the least.

cold            no cache holds anything: the driver's and ours are fresh folders
warm            the run before left both
ours only       our VkPipelineCache file is there, the driver's own disk cache is fresh
driver's only   the driver's own disk cache is there, DRESSI_CACHE=off

Python's bytecode is compiled beforehand, as in an installed package.
"""

import argparse
import json
import os
import platform
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
VIEWS, SIZE, SUBDIVISIONS = 6, 256, 3

# name: keep our cache, keep the driver's, what else to set
CASES = {"cold": (False, False, {}), "warm": (True, True, {}), "ours only": (True, False, {}),
         "driver's only": (False, True, {"DRESSI_CACHE": "off"})}

PHASES = {"interpreter": "spawning the process until its first line runs", "numpy": "import numpy, msgpack",
          "imports": "import dressi_edge.runtime with its Vulkan binding", "read": "the bundle from disk",
          "verify": "all its checks",
          "device": "loader, drivers, instance and device", "memory": "images and their memory", "pipelines": "of all plans",
          "session": "the rest of opening a session", "upload": "the rest of clearing memory, constants, six images",
          "first submit": "record and run the first step", "second submit": "the same again, after the first step"}
AFTER = ("second submit",)  # not part of the start

CHILD = """
import sys
import time
phases, last = {}, float(sys.argv[1])
def mark(name):
    global last
    now = time.perf_counter()
    phases[name] = phases.get(name, 0.0) + (now - last) * 1e3
    last = now
mark("interpreter")
import msgpack
import numpy
mark("numpy")
from dressi_edge import runtime
from dressi_edge.cache import bundle
from dressi_edge.runtime import session as module
from dressi_edge.runtime.device import Device
mark("imports")
with open(sys.argv[2], "rb") as f:
    data = f.read()
mark("read")
checked = bundle.loads(data)
mark("verify")
device = Device.open(sys.argv[4] or None)
mark("device")
inside = ["session"]
def timed(owner, name, phase):
    work = getattr(owner, name)
    def wrapped(*args, **options):
        mark(inside[-1])
        inside.append(phase)
        try:
            return work(*args, **options)
        finally:
            mark(inside.pop())
    setattr(owner, name, wrapped)
timed(module, "Images", "memory")
timed(module, "PipelineStore", "pipelines")
timed(module, "Pipelines", "pipelines")
timed(module, "upload", "upload")
for name in ("begin", "finish"):
    timed(module.Work, name, "upload")
session = module.Session(checked, device)
mark("session")
inside = ["upload"]
session.set("targets", numpy.load(sys.argv[3]))
mark("upload")
session.step(1)
mark("first submit")
session.step(1)
mark("second submit")
import json
report = session.report()
print(json.dumps({"phases": phases, "device": report["device"], "driver": report["driver"], "kind": device.kind,
                  "pipeline_cache": report["pipeline_cache"], "numpy": numpy.__version__}))
session.close()
device.close()
"""


def build(path: Path, targets: Path) -> None:
    """Compile the problem to `path`, and save its target images, discs somewhat larger than the sphere looks."""
    import numpy as np

    from dressi_edge.cache.layout import Layout
    from dressi_edge.compiler import Program, compile_program
    from dressi_edge.compiler.graph.autodiff import gradients
    from dressi_edge.compiler.graph.functions import total
    from dressi_edge.compiler.io.cameras import orbit
    from dressi_edge.compiler.io.shapes import icosphere
    from dressi_edge.compiler.render.atlas import Atlas
    from dressi_edge.compiler.render.camera import fixed_views, to_clip
    from dressi_edge.compiler.render.raster import Softness, rasterized
    from dressi_edge.compiler.render.topology import Topology

    mesh, atlas = icosphere(SUBDIVISIONS), Atlas.of(SIZE, SIZE, VIEWS)
    views = fixed_views(orbit(VIEWS, (15.0, -15.0), 3.0, 50.0, (SIZE, SIZE)))
    images = Layout("atlas", "float", SIZE, SIZE, VIEWS, atlas.columns)
    program = Program()
    vertices = program.state("vertices", Layout("table", "vec3", count=len(mesh.positions)), mesh.positions)
    target = program.input("targets", images)
    layers = rasterized(to_clip(vertices, views), Topology(mesh.faces, len(mesh.positions)), atlas, Softness(2.0), views.near,
                        faces=False)
    error = layers.silhouette() - target
    loss = total(error * error) * (1.0 / (VIEWS * SIZE * SIZE))
    gradient, = gradients(loss, [vertices])
    program.plan("fit", {"vertices": vertices - gradient * 10.0}, {"fit.loss": (loss, Layout("unit", "float"))})
    compile_program(program, "lavapipe", path)
    y, x = np.mgrid[:SIZE, :SIZE] + 0.5 - SIZE / 2
    disc = (np.hypot(x, y) < 0.42 * SIZE).astype(np.float32)
    np.save(targets, np.repeat(disc[None], VIEWS, 0))


class Runs:
    """The processes of all cases, in folders of their own below `folder`."""

    def __init__(self, folder: Path, device: str | None):
        self.folder, self.device = folder, device
        self.bundle, self.targets = folder / "six.dressi", folder / "targets.npy"
        self.environment = {k: v for k, v in os.environ.items()
                            if k not in ("PYTHONDONTWRITEBYTECODE", "PYTHONPYCACHEPREFIX", "MESA_SHADER_CACHE_DISABLE")}
        self.environment["PYTHONPYCACHEPREFIX"] = str(folder / "bytecode")
        self.environment["PYTHONPATH"] = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])

    def run(self, case: str) -> dict:
        """One process. The caches a case does not keep are emptied before."""
        ours, drivers, extra = CASES[case]
        place = self.folder / case.replace(" ", "_").replace("'", "")
        caches = {"DRESSI_CACHE": (place / "ours", ours), "MESA_SHADER_CACHE_DIR": (place / "mesa", drivers),
                  "__GL_SHADER_DISK_CACHE_PATH": (place / "nvidia", drivers), "XDG_CACHE_HOME": (place / "xdg", drivers)}
        for path, keep in caches.values():
            if not keep:
                shutil.rmtree(path, ignore_errors=True)
            path.mkdir(parents=True, exist_ok=True)
        environment = {**self.environment, **{k: str(path) for k, (path, _) in caches.items()}, **extra}
        words = [sys.executable, "-c", CHILD, repr(time.perf_counter()), str(self.bundle), str(self.targets), self.device or ""]
        done = subprocess.run(words, env=environment, capture_output=True, text=True)
        if done.returncode:
            raise SystemExit(f"{case}: the process failed:\n{done.stderr}")
        return json.loads(done.stdout)


def summary(case: str, rows: list[dict]) -> dict:
    """Medians over the runs of a case; `ms` ends with the first step."""
    totals = [sum(ms for name, ms in row["phases"].items() if name not in AFTER) for row in rows]
    phases = {name: round(statistics.median(row["phases"].get(name, 0.0) for row in rows), 2) for name in PHASES}
    return {"case": case, "ms": round(statistics.median(totals), 1), "least_ms": round(min(totals), 1), "runs": len(rows),
            "phases": phases, "pipeline_cache": rows[-1]["pipeline_cache"]}


def table(results: list[dict]) -> str:
    lines = ["ms".ljust(16) + "".join(r["case"].rjust(15) for r in results)]
    lines += [name.ljust(16) + "".join(f"{r['phases'][name]:15.1f}" for r in results) for name in PHASES if name not in AFTER]
    lines.append("first step done".ljust(16) + "".join(f"{r['ms']:15.1f}" for r in results))
    lines.append("  the least".ljust(16) + "".join(f"{r['least_ms']:15.1f}" for r in results))
    lines += [name.ljust(16) + "".join(f"{r['phases'][name]:15.1f}" for r in results) for name in AFTER]
    lines += [f"{r['case']}: pipeline cache {r['pipeline_cache']}; {r['runs']} runs" for r in results]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="cold and warm only, three runs")
    parser.add_argument("--runs", type=int, help="processes a case (default 9)")
    parser.add_argument("--device", help="an index or a part of the device's name")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the results there")
    options = parser.parse_args()
    cases = ["cold", "warm"] if options.quick else list(CASES)
    count = options.runs or (3 if options.quick else 9)
    sys.path.insert(0, str(ROOT))
    with tempfile.TemporaryDirectory(prefix="dressi-start-") as folder:
        runs = Runs(Path(folder), options.device)
        build(runs.bundle, runs.targets)
        first = [runs.run(case) for case in cases][0]  # fills the caches and compiles the bytecode
        rows = {case: [] for case in cases}
        for _ in range(count):
            for case in cases:
                rows[case].append(runs.run(case))
    results = [summary(case, rows[case]) for case in cases]
    versions = {"python": platform.python_version(), "numpy": first["numpy"], "driver": first["driver"],
                "system": f"{platform.system()} {platform.machine()}, {os.cpu_count()} CPUs"}
    print(f"{first['device']} ({first['kind']}); {', '.join(f'{k} {v}' for k, v in versions.items())}")
    print(f"{VIEWS} views {SIZE}x{SIZE}, {20 * 4 ** SUBDIVISIONS} faces, silhouette, K = 1, r = 2; medians\n")
    print(table(results))
    if options.json:
        options.json.parent.mkdir(parents=True, exist_ok=True)
        text = json.dumps({"device": first["device"], "versions": versions, "results": results}, indent=1)
        options.json.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
