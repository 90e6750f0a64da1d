"""One optimization step: milliseconds, processor time, stages, and two yardsticks measured in the same run.

    python benchmarks/step.py [--quick] [--only WORD] [--data DIR] [--device NAME] [--profile NAME] [--json FILE]

sphere to Spot   six views of 256x256, an icosphere of 1280 faces, silhouettes + 0.05 Laplacian, Adam: benchmarks/sphere_to_spot.py
eight views      the same sphere and losses, 128x128
one view         a mesh from 2.5 away, silhouette against a centred square of half the image's size, gradient descent: spheres with bumps
                 and, where DIR/meshes holds it, the Avocado

Without DIR/meshes/spot the target is the pear. --quick takes small images and few steps.

step       the median of steps that are submitted and waited for one by one, everything included
hard draw  the yardstick: all faces of the K = 1 step at the same places with plain depth, submitted by itself
copy       the other: an image as large as half the bytes that the step moves, copied to another
K          1 is outline distance, `1 face` and more layers face distance; `1 colors` is outline distance with a loss of colours,
           of which each vertex has one that is optimized, too
cpu        processor time, all threads of the process together. Where the device is the processor, other work on the machine
           disturbs it least: divided by the number of processors it estimates `ms` on an idle machine if the load is even
host       the step's time outside of the driver
"""

from __future__ import annotations

import argparse
import functools
import json
import os
import platform
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT)]

from dressi_edge import runtime  # noqa: E402
from dressi_edge.cache import bundle as bundles  # noqa: E402
from dressi_edge.cache.profile import Profile  # noqa: E402
from dressi_edge.cache.summary import summary  # noqa: E402
from dressi_edge.cache.vulkan import FORMATS, USAGE_TRANSFER_SRC  # noqa: E402
from dressi_edge.compiler import Options, build  # noqa: E402
from dressi_edge.compiler.io.cameras import Camera, orbit  # noqa: E402
from dressi_edge.compiler.io.meshes import Mesh, load_mesh, normalize  # noqa: E402
from dressi_edge.compiler.io.shapes import icosphere, pear  # noqa: E402
from dressi_edge.compiler.render.optimizer import Adam, Sgd  # noqa: E402
from dressi_edge.compiler.render.raster import Softness  # noqa: E402
from dressi_edge.compiler.scene.problem import Loss, Problem  # noqa: E402
from dressi_edge.runtime import vk  # noqa: E402
from dressi_edge.runtime.memory import Images  # noqa: E402
from dressi_edge.runtime.running import record  # noqa: E402
from dressi_edge.runtime.transfer import clear  # noqa: E402

HARD = Softness(1.0, delta=0.0)
WARM = 20  # steps before any is timed
COPY_WIDTH = 1024
COPY_ROWS = 4096
GATHERS = ("bin_names", "block_sum", "capsule_sum", "gather_listed", "gather_sum", "occupied", "segment_sum", "texture_gather",
           "texture_gather_lanes", "weighted_gather_sum")
PEAK = """
import sys
import numpy
from dressi_edge import runtime
with runtime.load(sys.argv[1], sys.argv[2] or None) as session:
    session.set("targets", numpy.zeros(session.shape("targets"), numpy.float32))
    session.step(5)
with open("/proc/self/status") as f:  # ru_maxrss would count the process that started this one
    print(*(line.split()[1] for line in f if line.startswith("VmHWM")))
"""


# ---- measuring, also for texture.py and scaling.py

def processor_ms() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return (used.ru_utime + used.ru_stime) * 1e3


class Meter:
    """Runs one thing again and again: wall milliseconds of each run, processor milliseconds of a run in each round.
    `prepare` goes before each run and is not counted."""

    def __init__(self, run: Callable[[], object], prepare: Callable[[], object] | None = None):
        self.run, self.prepare, self.walls, self.cpus = run, prepare, [], []

    def round(self, count: int) -> None:
        used = 0.0
        for _ in range(count):
            if self.prepare is not None:
                self.prepare()
            before, start = processor_ms(), time.perf_counter()
            self.run()
            self.walls.append((time.perf_counter() - start) * 1e3)
            used += processor_ms() - before
        self.cpus.append(used / count)

    @property
    def row(self) -> dict:
        cpu = statistics.median(self.cpus)
        return {"ms": rounded(statistics.median(self.walls)), "least_ms": rounded(min(self.walls)), "cpu_ms": rounded(cpu),
                "cpu_ms_per_processor": rounded(cpu / (os.cpu_count() or 1)), "runs": len(self.walls)}


def take_turns(meters: Sequence[Meter], seconds: float, count: int = 3, rounds: int = 3) -> None:
    """Rounds of all meters one after another, so that a busy machine slows all alike, for at least so long and so many."""
    end, done = time.perf_counter() + seconds, 0
    while done < rounds or time.perf_counter() < end:
        for meter in meters:
            meter.round(count)
        done += 1


def rounded(x: float) -> float:
    return float(f"{x:.4g}")


class Case:
    """A problem compiled and opened, with what the yardsticks need."""

    def __init__(self, problem: Problem, folder: Path, options: argparse.Namespace, phase: str = "fit", **how):
        """`how`: fields of `Options`."""
        self.path, self.faces, self.device_name = folder / "problem.dressi", len(problem.topology.faces), options.device
        built = build(problem.program, Profile.load(options.profile), Options(**how))
        bundles.write(self.path, built.description, built.blobs)
        self.labels = [label(stage, problem) for stage in built.stages[phase]]
        self.plan, self.session = phase, runtime.load(self.path, options.device)
        self.bytes = summary(self.session.bundle.description)[phase]["bytes_per_step"]
        if "targets" in self.session.values:
            self.session.set("targets", np.zeros(self.session.shape("targets"), np.float32))
        self.closing: list = []

    def __enter__(self) -> Case:
        return self

    def __exit__(self, *_) -> None:
        for part in self.closing:
            part.close()
        self.session.close()

    def step(self) -> None:
        self.session.step(1, self.plan)

    @property
    def memory(self) -> int:
        return self.session.report()["image_bytes"]

    def _recorded(self, stages: list[dict]):
        s = self.session
        plan = s._plans[self.plan]
        recording = record(s, type(plan)({**plan.record, "stages": stages}, s.bundle.description, plan.rule),
                           {k: s._parity.get(k, 0) for k in plan.slots})
        self.closing.insert(0, recording)

        def run() -> None:
            s._work.submit([recording.commands])
            s._work.settle()
        return run

    def hard_draw(self) -> Meter:
        """Draws the faces of the step's first raster draw with depth, which `drawn_hard` draws hard. The stages before it go first, not
        counted: their images may have served the end of the step for something else."""
        d, stages = self.session.bundle.description, self.session.plans[self.plan]["stages"]
        for k, stage in enumerate(stages):
            if any(a["format"] == 0 for a in d["passes"][stage["pass"]]["attachments"]):
                found, kept = False, []
                for draws in stage["subpasses"]:
                    first = [] if found else [draw for draw in draws if draw["vertices"] == 3 * self.faces][:1]
                    found = found or bool(first)
                    kept.append(first)
                if found:
                    return Meter(self._recorded([{**stage, "subpasses": kept}]), self._recorded(stages[:k]))
        raise SystemExit(f"{self.plan} draws no hard faces")

    def copy(self) -> Callable[[], None]:
        """Moves as many bytes as the step: half of them read, half written, in pieces that any device has room for."""
        s = self.session
        rows = max(1, round(self.bytes / 2 / 16 / COPY_WIDTH))
        pieces = -(-rows // COPY_ROWS)
        record = {"slots": 2, "format": FORMATS["R32G32B32A32_SFLOAT"], "width": COPY_WIDTH, "height": -(-rows // pieces),
                  "usage": USAGE_TRANSFER_SRC}
        images = Images(s.device, [record], s._depth_format)
        self.closing.append(images)
        s._work.once(functools.partial(clear, images))
        whole = (vk.VK_IMAGE_ASPECT_COLOR_BIT, 0, 0, 1)
        region = (whole, (0, 0, 0), whole, (0, 0, 0), (record["width"], record["height"], 1))

        def fill(commands: int) -> None:
            for _ in range(pieces):
                vk.CmdCopyImage(commands, images.handles[0][0], vk.VK_IMAGE_LAYOUT_GENERAL, images.handles[0][1],
                                vk.VK_IMAGE_LAYOUT_GENERAL, [region])
        return lambda: s._work.once(fill)

    def stages(self, runs: int) -> list[dict]:
        """[{"stage", "kind", "ms" by device timestamps, "cpu_ms" of the stage submitted by itself}], in order."""
        records = self.session.plans[self.plan]["stages"]
        ms = self.session.profile_stages(self.plan, runs)
        meters = []
        for stage in records:
            meters.append(Meter(self._recorded([stage])))
        empty = Meter(self._recorded([]))
        take_turns([*meters, empty], 0.0, max(1, runs // 2), 2)
        idle = statistics.median(empty.cpus)
        return [{"stage": name, "kind": kind, "size": f"{stage['width']}x{stage['height']}", "ms": rounded(t),
                 "cpu_ms": rounded(max(0.0, statistics.median(m.cpus) - idle))}
                for (name, kind), stage, t, m in zip(self.labels, records, ms, meters)]

    def host_ms(self, runs: int) -> float:
        """Median time of a step outside of submitting and waiting."""
        inside, times, kept = [0.0], [], (vk.QueueSubmit, vk.WaitForFences)

        def timed(call):
            def run(*arguments):
                start = time.perf_counter()
                try:
                    return call(*arguments)
                finally:
                    inside[0] += time.perf_counter() - start
            return run

        vk.QueueSubmit, vk.WaitForFences = map(timed, kept)
        try:
            for _ in range(runs):
                inside[0], start = 0.0, time.perf_counter()
                self.step()
                times.append((time.perf_counter() - start - inside[0]) * 1e3)
        finally:
            vk.QueueSubmit, vk.WaitForFences = kept
        return rounded(statistics.median(times))

    def peak_bytes(self) -> int | None:
        """The most memory that a process of its own occupies which loads the bundle and steps, Python and driver included; None
        where the system does not tell."""
        if not Path("/proc/self/status").is_file():
            return None
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        done = subprocess.run([sys.executable, "-c", PEAK, str(self.path), self.device_name or ""], env=environment,
                              capture_output=True, text=True, check=True)
        return int(done.stdout.split()[-1]) * 1024


def label(stage, problem: Problem) -> tuple[str, str]:
    """What a stage is named after, its costliest op, and its kind: raster, gather, pixel or table."""
    nodes = [node for substage in stage.substages for node in substage.nodes]
    main = max(nodes, key=lambda node: node.op.cost)
    name = main.op.name if main.op.cost >= 30 else "arithmetic"
    if any(node.op.stage == "raster" for node in nodes):
        return name, "raster"
    if name in GATHERS:
        return name, "gather"
    atlas = problem.scene.atlas.extent
    extent = stage.substages[0].extent
    return name, "pixel" if extent.width * atlas.height == atlas.width * extent.height else "table"


def shares(stages: list[dict]) -> dict[str, float]:
    """Kind -> processor milliseconds."""
    total: dict[str, float] = defaultdict(float)
    for s in stages:
        total[s["kind"]] += s["cpu_ms"]
    return {kind: rounded(ms) for kind, ms in sorted(total.items(), key=lambda x: -x[1])}


def versions(report: Mapping) -> dict:
    return {"python": platform.python_version(), "numpy": np.__version__, "driver": report["driver"], "profile": report["profile"],
            "system": f"{platform.system()} {platform.machine()}, {os.cpu_count()} CPUs"}


def write(path: Path | None, report: Mapping, results: list[dict], **more) -> None:
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        text = json.dumps({"device": report["device"], "versions": versions(report), "results": results, **more}, indent=1)
        path.write_text(text + "\n", encoding="utf-8")


def table(rows: Sequence[Mapping], columns: Sequence[str]) -> str:
    """Columns of the rows as text; a row without a column leaves it empty."""
    cells = [list(columns), *([str(row.get(c, "")) for c in columns] for row in rows)]
    widths = [max(len(line[k]) for line in cells) for k in range(len(columns))]
    return "\n".join("  ".join(x.ljust(w) if k == 0 else x.rjust(w) for k, (x, w) in enumerate(zip(line, widths))) for line in cells)


def options_of(parser: argparse.ArgumentParser, arguments: list[str] | None) -> argparse.Namespace:
    parser.add_argument("--quick", action="store_true", help="small images, few steps")
    parser.add_argument("--data", type=Path, metavar="DIR", default=ROOT.parent / "shared",
                        help="the folder of meshes/ (default: ../shared)")
    parser.add_argument("--seconds", type=float, default=4.0, help="to measure a case for (default 4)")
    parser.add_argument("--only", default="", metavar="WORD", help="cases whose name holds it")
    parser.add_argument("--device", help="an index or a part of the device's name")
    parser.add_argument("--profile", default="lavapipe", help="the device profile to compile for (default lavapipe)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the results there")
    options = parser.parse_args(arguments)
    if options.quick:
        options.seconds = min(options.seconds, 0.3)
    return options


# ---- the cases

def bumpy(n_lon: int, n_lat: int) -> Mesh:
    """A sphere by longitude and latitude of 2 n_lon (n_lat - 1) faces, radius 0.85 + 0.12 sin 5 phi sin 4 theta."""
    theta = np.pi * np.arange(1, n_lat)[:, None] / n_lat
    phi = 2 * np.pi * np.arange(n_lon)[None] / n_lon
    radius = 0.85 + 0.12 * np.sin(5 * phi) * np.sin(4 * theta)
    rings = radius[..., None] * np.stack(np.broadcast_arrays(np.sin(theta) * np.sin(phi), np.cos(theta), np.sin(theta) * np.cos(phi)), -1)
    points = np.concatenate([[[0.0, 0.85, 0.0]], rings.reshape(-1, 3), [[0.0, -0.85, 0.0]]])
    here, right = np.arange(n_lon), (np.arange(n_lon) + 1) % n_lon
    faces = [np.stack([np.zeros_like(here), 1 + here, 1 + right], 1)]
    for k in range(n_lat - 2):
        a, b = 1 + k * n_lon, 1 + (k + 1) * n_lon
        faces += [np.stack([a + here, b + here, b + right], 1), np.stack([a + here, b + right, a + right], 1)]
    last = 1 + (n_lat - 2) * n_lon
    faces.append(np.stack([last + here, np.full_like(here, len(points) - 1), last + right], 1))
    return Mesh(points, np.concatenate(faces))


def views(count: int, size: int) -> tuple[Camera, ...]:
    """The protocol's: 2.5 away, 50 degrees high, evenly round, 20 degrees up and down in turn; a single one from the front."""
    return orbit(count, (20.0, -20.0) if count > 1 else (0.0,), 2.5, 50.0, (size, size))


def square(size: int) -> np.ndarray:
    target = np.zeros((1, size, size, 4), np.float32)
    target[0, size // 4:size - size // 4, size // 4:size - size // 4, 3] = 1.0
    return target


def drawn(mesh: Mesh, cameras: Sequence[Camera], folder: Path, options: argparse.Namespace) -> np.ndarray:
    """Target images (views, height, width, 4) of a mesh drawn hard."""
    problem = Problem(mesh, cameras, albedo="constant")
    problem.render(softness=HARD, color=False)
    problem.compile(options.profile, folder / "target.dressi")
    with runtime.load(folder / "target.dressi", options.device) as session:
        alpha = session.get("render.silhouette")
    return np.concatenate([np.zeros((*alpha.shape, 3), np.float32), alpha[..., None]], -1)


FACE = "1 face"  # one layer of face distance, of which K > 1 has more
COLORS = "1 colors"  # outline distance, and the loss is of colours of vertices, which are optimized with them


def softness(layers: int | str, r: float) -> Softness:
    return Softness(r, distance="face") if layers == FACE else Softness(r) if layers == COLORS else Softness(r, layers=layers)


def fitted(mesh: Mesh, cameras: Sequence[Camera], layers: int | str = 1, r: float = 2.0) -> Problem:
    colored = layers == COLORS
    problem = Problem(mesh, cameras, albedo="colors" if colored else "constant")
    problem.phase("fit", 1000, {key: Adam(0.01) for key in ("vertices", "colors")[:1 + colored]},
                  [Loss("color" if colored else "silhouette"), Loss("laplacian", 0.05)], softness(layers, r))
    return problem


def one_view(mesh: Mesh, size: int, layers: int | str = 1, r: float = 2.0) -> Problem:
    problem = Problem(mesh, views(1, size), albedo="constant")
    problem.phase("fit", 1000, {"vertices": Sgd(1e-3)}, [Loss("silhouette")], softness(layers, r))
    return problem


def drawn_hard(problem: Problem) -> Problem:
    """One of the same mesh and views that has to know which face is in front."""
    hard = Problem(problem.mesh, problem.cameras, albedo="constant")
    hard.phase("fit", 1000, {"vertices": Sgd(1e-9)}, [Loss("color")])
    return hard


def cases(options: argparse.Namespace, folder: Path):
    """(name, layers -> problem, target images or None for drawn when the case runs, which layers)."""
    quick = options.quick
    spot, small = options.data / "meshes" / "spot" / "spot.obj", (64 if quick else 256)
    is_spot = spot.is_file()
    goal = normalize(load_mesh(spot)) if is_spot else pear(96)
    for count, size, name in ((6, small, "Spot" if is_spot else "the pear"), (8, small // 2, "eight views")):
        title = f"sphere to {name}, six views {size}x{size}" if count == 6 else f"eight views {size}x{size}"
        yield (title, functools.partial(fitted, icosphere(3, 0.6), views(count, size)),
               functools.partial(drawn, goal, views(count, size), folder, options), (1, COLORS, FACE, 3, 5)[:4 if quick else 5])
    meshes = [("682", bumpy(31, 12))]
    if not quick:
        meshes += [("14208", bumpy(96, 75)), ("51414", bumpy(209, 124))]
    for name, mesh in meshes:
        for size in (64,) if quick else (256, 512):
            yield (f"one view {size}x{size}, {name} faces", functools.partial(one_view, mesh, size),
                   functools.partial(square, size), (1,))
    avocado = options.data / "meshes" / "avocado" / "Avocado.gltf"
    if avocado.is_file() and not quick:
        mesh = normalize(load_mesh(avocado))
        for size in (128, 256, 512, 1024):
            yield (f"Avocado one view {size}x{size}", functools.partial(one_view, mesh, size), functools.partial(square, size),
                   (1, FACE, 3, 5) if size == 256 else (1,))


def measure(name: str, problem, target, layers: Sequence[int | str], folder: Path, options: argparse.Namespace) -> tuple[list[dict], dict]:
    image, opened, rows = target(), {}, []
    try:
        for k in layers:
            place = folder / f"layers{k}"
            place.mkdir(exist_ok=True)
            opened[k] = Case(problem(layers=k), place, options)
            opened[k].session.set("targets", image)
            opened[k].session.step(3 if options.quick else WARM, "fit")
        steps = {k: Meter(case.step) for k, case in opened.items()}
        yardstick = opened["hard"] = Case(drawn_hard(problem(layers=1)), folder, options)
        yardstick.session.set("vertices", opened[1].session.get("vertices"))
        yardstick.step()
        hard, copy = yardstick.hard_draw(), Meter(opened[1].copy())
        take_turns([*steps.values(), hard, copy], options.seconds, *((1, 2) if options.quick else ()))
        yard = hard.row
        for k in steps:
            row, case = steps[k].row, opened[k]
            stages = case.stages(2 if options.quick else 5)
            rows.append({"case": name, "K": k, "faces": case.faces, **row, "hard_draw": yard, "copy": copy.row if k == 1 else None,
                         "of_hard": rounded(row["cpu_ms"] / yard["cpu_ms"]), "of_hard_by_wall": rounded(row["ms"] / yard["ms"]),
                         "of_one_layer": rounded(row["cpu_ms"] / steps[1].row["cpu_ms"]),
                         "of_one_face": rounded(row["cpu_ms"] / steps[FACE].row["cpu_ms"]) if FACE in steps else None,
                         "MB_moved": rounded(case.bytes / 1e6), "image_MB": rounded(case.memory / 1e6),
                         "host_ms": case.host_ms(10),
                         "cpu_ms_by_kind": shares(stages), "stages": stages})
            if layers != (1,):
                peak = case.peak_bytes()
                rows[-1]["peak_MB"] = None if peak is None else rounded(peak / 1e6)
        report = opened[1].session.report()
    finally:
        for case in opened.values():
            case.__exit__()
    return rows, report


COLUMNS = ("case", "K", "ms", "least", "cpu", "cpu/proc", "hard", "hard cpu", "of hard", "of K=1", "of face", "copy cpu", "MB", "images MB",
           "peak MB", "host")


def flat(row: Mapping) -> dict:
    return {**row, "least": row["least_ms"], "cpu": row["cpu_ms"], "cpu/proc": row["cpu_ms_per_processor"], "hard": row["hard_draw"]["ms"],
            "hard cpu": row["hard_draw"]["cpu_ms"], "of hard": row["of_hard"], "of K=1": row["of_one_layer"],
            "of face": row["of_one_face"] or "",
            "copy cpu": (row["copy"] or {}).get("cpu_ms", ""), "MB": row["MB_moved"], "images MB": row["image_MB"],
            "peak MB": row.get("peak_MB") or "", "host": row["host_ms"]}


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options = options_of(parser, arguments)
    results, report = [], {}
    with tempfile.TemporaryDirectory(prefix="dressi-step-") as name:
        for case in cases(options, Path(name)):
            if options.only not in case[0]:
                continue
            rows, report = measure(*case, Path(name), options)
            results += rows
            for row in rows:
                print(f"{row['case']}, K = {row['K']}: {row['ms']} ms, {row['cpu_ms']} of the processors; "
                      f"{row['of_hard']} times the hard draw", flush=True)
                for s in row["stages"]:
                    print(f"    {s['kind']:7} {s['stage']:16} {s['size']:>10} {s['ms']:9.3f} ms  cpu {s['cpu_ms']:9.3f} ms")
    if not results:
        raise SystemExit(f"no case holds {options.only!r}")
    print(f"\n{report['device']}, {report['driver']}; milliseconds, medians\n")
    print(table([flat(row) for row in results], COLUMNS))
    write(options.json, report, results)


if __name__ == "__main__":
    main()
