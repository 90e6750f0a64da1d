"""How much error a millisecond buys: gradients against the derivative of true coverage, textures against the exact transpose, and
shapes against the true surface, each with the time that it takes.

    python benchmarks/error_vs_time.py [--quick] [--part PART ...] [--only WORD] [--data DIR] [--device NAME] [--json FILE] [--plot FILE]

gradient  Spot, two poses; the loss is the silhouette times a smooth image. The gradient by clip coordinates, along the 43 displacement
          fields of gradient_error.py, against the derivative of covered area: cosine, and relative L2 error. Swept: distance and K, r,
          image size, sigma, profile. Time: one step, that is image, gradient and update of the clip coordinates
texture   Spot, two views; the gradient of the colour loss by the texture against the float64 reference of the exact transpose, for
          the exact one and for inverse UV, of one step and of the mean of 64. Time: a step, with the shape at rest and moving
fit       sphere to Spot as in sphere_to_spot.py, but the target is coverage: drawn hard at four times the size and averaged. Mean
          distance to the true surface after several numbers of iterations
layers    distance, K, every face, by r (the paper's Figures 11, 12): a sphere of 1280 faces becomes the bunny by silhouettes of 24 views of
          128x128, one a step in random order, 2500 steps with the schedules of reconstruct.py, sigma = r / 7
speed     a step of each of those, in turns

--part takes one or several, or none to draw only what --json FILE holds; --only takes the cases whose name holds the word. A row
replaces the one of its part and case there. Where DIR/meshes lacks a mesh, and with --quick, the pear is taken. ms: wall time, median.
cpu_ms: processor time of all threads together, which other work on the machine disturbs least where the device is the processor.
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import svg
from gradient_error import covered as covered_area
from gradient_error import fields, placed, rotation, weight
from metrics import Surface
from reconstruct import RECIPES, Recipe, falling, smooth
from sphere_to_spot import cameras
from step import HARD, Meter, options_of, processor_ms, rounded, take_turns, versions, views
from texture import pattern

from dressi_edge import runtime
from dressi_edge.cache.layout import Layout
from dressi_edge.compiler import compile_program
from dressi_edge.compiler.graph.autodiff import gradients
from dressi_edge.compiler.graph.functions import total
from dressi_edge.compiler.graph.program import Program
from dressi_edge.compiler.graph.reference_session import ReferenceSession
from dressi_edge.compiler.io.cameras import Camera, orbit
from dressi_edge.compiler.io.meshes import Mesh, load_mesh, normalize
from dressi_edge.compiler.io.shapes import icosphere, pear
from dressi_edge.compiler.render.atlas import Atlas
from dressi_edge.compiler.render.optimizer import Adam, Sgd
from dressi_edge.compiler.render.raster import Binned, Softness, rasterized
from dressi_edge.compiler.render.topology import Topology
from dressi_edge.compiler.scene.problem import Loss, Problem

PARTS = ("gradient", "texture", "fit", "layers", "speed")
ESTIMATORS = (("outline", 1), ("face", 1), ("face", 3))
COLORS = {"outline": "#1b6ca8", "face K=1": "#d1495b", "face K=3": "#2e8b57", "face K=5": "#8a5a00"}
MEAN_OF = 64  # steps of inverse UV
# Figure 12's choices, near, best and far, with 8 pixels for its 7, and outline's over the same range: what the plot shows of part layers.
CURVES = (("outline", 1, 1.0), ("outline", 1, 2.0), ("outline", 1, 8.0), ("face", 1, 1.0), ("face", 3, 2.0), ("face", 5, 8.0))


def name_of(distance: str, k: int) -> str:
    return distance if distance in ("outline", "binned") else f"face K={k}"


def softness_of(distance: str, k: int, r: float, sigma: float | None = None) -> Softness | Binned:
    return Binned(r, sigma) if distance == "binned" else Softness(r, sigma, layers=k, distance=distance)


class Run:
    """Where bundles go, and what they run on."""

    def __init__(self, folder: Path, options: argparse.Namespace):
        self.folder, self.options, self.count, self.about = folder, options, 0, {}

    def open(self, what: Program | Problem, profile: str | None = None):
        self.count += 1
        path = self.folder / f"{self.count}.dressi"
        profile = profile or self.options.profile
        what.compile(profile, path) if isinstance(what, Problem) else compile_program(what, profile, path)
        session = runtime.load(path, self.options.device)
        self.about = session.report()
        return session

    def wants(self, case: str) -> bool:
        return self.options.only in case

    def mesh(self, file: str) -> tuple[str, Mesh]:
        """Its name, and the mesh in the unit ball."""
        path = self.options.data / "meshes" / file
        return (path.stem, normalize(load_mesh(path))) if path.is_file() and not self.options.quick else ("pear", pear(96))

    def coverage(self, mesh: Mesh, cameras: tuple[Camera, ...]) -> np.ndarray:
        """Targets (n, h, w, 4): black, alpha of 16 samples a pixel."""
        w, h = cameras[0].width, cameras[0].height
        problem = Problem(mesh, [c.resized(4 * w, 4 * h) for c in cameras], albedo="constant")
        problem.render(softness=HARD, color=False)
        with self.open(problem) as session:
            alpha = session.get("render.silhouette").reshape(len(cameras), h, 4, w, 4).mean((2, 4))
        return np.concatenate([np.zeros((*alpha.shape, 3), np.float32), alpha[..., None]], -1)


# ---- gradient

def silhouette_step(topology: Topology, size: int, softness: Softness) -> Program:
    """Plan "step": clip coordinates go down the weighted silhouette at `rate`, 0 unless set. Output by_clip: the gradient."""
    program, table = Program(), Layout("table", "vec4", count=topology.vertex_count)
    clip, by_alpha = program.state("clip", table), program.input("by_alpha", Layout("atlas", "float", size, size))
    rate = program.input("rate", Layout("unit", "float"), 0.0)
    shape = rasterized(clip, topology, Atlas(size, size, 1, 1), softness, 0.1, faces=False)
    g, = gradients(total(shape.silhouette() * by_alpha), [clip])
    program.plan("step", {"clip": clip - g * rate})
    program.plan("gradient", {}, {"by_clip": (g, table)})
    return program


def poses(mesh: Mesh, topology: Topology, size: int) -> list[tuple]:
    """(clip coordinates, fields, derivative of covered area along each field) of two poses."""
    out, step = [], 0.25
    for pose in (5, 12):
        turned = mesh.positions @ rotation(pose).T
        clip, screen = placed(turned, size, 1.2, 3.4, np.full(2, size / 2))
        moves = fields(turned, screen)
        ends = [[covered_area(screen + x * f, topology, size) for x in (step, -step)] for f in moves]
        out.append((clip, moves, np.array(ends) @ (1, -1) / (2 * step)))
    return out


def gradient_case(size: int, distance: str, k: int, r: float, sigma: float | None, profile: str) -> str:
    return f"{name_of(distance, k)}, r {r:g}, sigma {softness_of(distance, k, r, sigma).width:.2f}, {size}x{size}, {profile}"


def part_gradient(run: Run) -> Iterator[dict]:
    quick = run.options.quick
    name, mesh = run.mesh("spot/spot.obj")
    topology = Topology(mesh.faces, len(mesh.positions))
    for size in (48,) if quick else (128, 256):
        known = poses(mesh, topology, size)
        ys, xs = np.mgrid[:size, :size] + 0.5
        small, profile = size < 200, run.options.profile
        groups = [[(*e, r, None, profile) for e in ESTIMATORS[:2 if quick else 3]]
                  + [(*e, r, None, "limit4") for e in ESTIMATORS[:1 if quick else 3] if small]
                  for r in ((2.0,) if quick else (1.0, 2.0, 4.0, 8.0))]
        groups += [[(*e, 2.0, sigma, profile) for e in ESTIMATORS] for sigma in (() if quick else (0.1, 0.2, 0.6, 1.0)) if small]
        for group in filter(None, ([x for x in group if run.wants(gradient_case(size, *x))] for group in groups)):
            sessions, rows = [], []
            try:
                for distance, k, r, sigma, profile in group:
                    softness = softness_of(distance, k, r, sigma)
                    session = run.open(silhouette_step(topology, size, softness), profile)
                    sessions.append(session)
                    session.set("by_alpha", weight(xs, ys)[None])
                    found = []
                    for clip, moves, _ in known:
                        session.set("clip", clip)
                        g = session.get("by_clip")[:, :2].astype(np.float64) * clip[:, 3:] * 2 / size
                        found.append((moves * g).sum((1, 2)))
                    v, t = np.ravel(found), np.ravel([true for *_, true in known])
                    rows.append({"case": gradient_case(size, distance, k, r, sigma, profile), "part": "gradient", "mesh": name,
                                 "distance": distance, "K": k, "r": r, "sigma": rounded(softness.width),
                                 "swept": "r" if sigma is None else "sigma", "size": size, "profile": profile,
                                 "error": rounded(np.linalg.norm(v - t) / np.linalg.norm(t)),
                                 "cosine": float(f"{v @ t / np.linalg.norm(v) / np.linalg.norm(t):.6f}")})
                    session.step(3, "step")
                meters = [Meter(lambda s=s: s.step(1, "step")) for s in sessions]
                take_turns(meters, 0.1 if quick else 1.5)
                yield from ({**row, **meter.row} for row, meter in zip(rows, meters))
            finally:
                for session in sessions:
                    session.close()


# ---- texture

def textured(mesh: Mesh, cameras, size: int, gradient: str, moving: bool) -> Problem:
    """Rates at which nothing moves: the momentum's state then adds up gradients of one and the same place."""
    problem = Problem(replace(mesh, texture=None), cameras, texture_size=(size, size), texture_grad=gradient)
    optimize = {"texture": Sgd(1e-20, 0.5)} | ({"vertices": Sgd(1e-20)} if moving else {})
    problem.phase("fit", 1000, optimize, [Loss("color")], HARD)
    return problem


def texture_case(gradient: str, atlas: int, moving: bool) -> str:
    return f"{gradient}, atlas {atlas}, {'shape moves' if moving else 'shape at rest'}"


def part_texture(run: Run) -> Iterator[dict]:
    quick = run.options.quick
    name, mesh = run.mesh("spot/spot.obj")
    size = 32 if quick else 128
    cameras = views(2, size)
    problem = Problem(replace(mesh, texture=pattern(256)), cameras)
    problem.render(softness=HARD)
    with run.open(problem) as session:
        targets = session.get("render.color")
    for atlas in (32,) if quick else (64, 128, 256, 512):
        chosen = [(moving, gradient) for moving in (False, True) for gradient in ("exact", "inverse_uv")
                  if run.wants(texture_case(gradient, atlas, moving))]
        if not chosen:
            continue
        reference = ReferenceSession(textured(mesh, cameras, atlas, "exact", False).program)
        reference.set("targets", targets)
        reference.step(1)
        true = reference.get("texture.momentum").ravel()
        sessions, rows = [], []
        try:
            for moving, gradient in chosen:
                session = run.open(textured(mesh, cameras, atlas, gradient, moving))
                sessions.append(session)
                session.set("targets", targets)
                last, found = 0.0, []
                for _ in range(MEAN_OF):
                    session.step(1)
                    now = session.get("texture.momentum").astype(np.float64).ravel()
                    found.append(now - 0.5 * last)
                    last = now
                row = {"case": texture_case(gradient, atlas, moving), "part": "texture", "mesh": name, "gradient": gradient,
                       "atlas": atlas, "moving": moving, "size": size}
                for key, g in (("", found[0]), ("_of_mean", np.mean(found, 0))):
                    row[f"error{key}"] = rounded(np.linalg.norm(g - true) / np.linalg.norm(true))
                    row[f"cosine{key}"] = float(f"{g @ true / np.linalg.norm(g) / np.linalg.norm(true):.6f}")
                rows.append(row)
            meters = [Meter(lambda s=s: s.step(1)) for s in sessions]
            take_turns(meters, 0.1 if quick else 1.5)
            yield from ({**row, **meter.row} for row, meter in zip(rows, meters))
        finally:
            for session in sessions:
                session.close()


# ---- fit and layers

def curve(run: Run, problem: Problem, targets: np.ndarray, surface: Surface, stops: tuple[int, ...]) -> dict:
    """Lists over the stops: steps, seconds and processor seconds of the steps alone, first draw excluded, and distance; ms a step."""
    out = {"steps": [], "seconds": [], "cpu_seconds": [], "distance": []}
    with run.open(problem) as session:
        session.set("targets", targets)
        before = session.get("vertices")
        session.step(1, "shape")  # what is computed beforehand, and what the driver compiles
        session.set("vertices", before)
        session.set("shape.step", np.array(0))
        done, seconds, busy, times = 0, 0.0, 0.0, []
        for stop in stops:
            while done < stop:
                count = min(10, stop - done)
                cpu, start = processor_ms(), time.perf_counter()
                session.step(count, "shape")
                spent = time.perf_counter() - start
                seconds, busy, done = seconds + spent, busy + (processor_ms() - cpu) / 1e3, done + count
                times.append(spent / count * 1e3)
            distance = surface.vertex_distances(session.get("vertices")).mean()
            for key, x in zip(out, (done, seconds, busy, distance)):
                out[key].append(done if key == "steps" else rounded(float(x)))
    return {"ms": rounded(statistics.median(times)), "cpu_ms": rounded(busy / done * 1e3), **out}


def part_fit(run: Run) -> Iterator[dict]:
    quick = run.options.quick
    name, mesh = run.mesh("spot/spot.obj")
    surface, start = Surface(mesh.positions, mesh.faces), icosphere(2 if quick else 3, 0.6)
    cases = [(128, 2.0, ESTIMATORS), (256, 2.0, ESTIMATORS), (128, 1.0, ESTIMATORS), (128, 4.0, ESTIMATORS[:2]), (128, 8.0, ESTIMATORS[:2])]
    for size, r, estimators in [(32, 2.0, ESTIMATORS[:2])] if quick else cases:
        seen = cameras(size)
        targets = run.coverage(mesh, seen)
        for distance, k in estimators:
            case = f"{name_of(distance, k)}, r {r:g}, six views {size}x{size}"
            if not run.wants(case):
                continue
            problem = Problem(start, seen, albedo="constant")
            problem.phase("shape", 1000, {"vertices": Adam(0.01)}, [Loss("silhouette"), Loss("laplacian", 0.05)],
                          softness_of(distance, k, r))
            row = {"case": case, "part": "fit", "mesh": name, "distance_by": distance, "K": k, "r": r, "size": size}
            yield row | curve(run, problem, targets, surface, (5, 10) if quick else (20, 50, 100, 150, 250, 500))


def layers_cases(run: Run) -> Iterator[tuple[str, str, int, float]]:
    """(name, distance, K, r) of the grid."""
    for k in (1,) if run.options.quick else run.options.layers:
        for distance in ("outline", "binned") if run.options.quick else ("outline", "face", "binned") if k == 1 else ("face",):
            for r in (2.0,) if run.options.quick else run.options.radii:
                if run.wants(case := f"{name_of(distance, k)}, r {r:g}"):
                    yield case, distance, k, r


def layers_problem(run: Run, softness: Softness | Binned) -> Problem:
    quick, recipe = run.options.quick, Recipe(**RECIPES["spot"])
    steps, size = (20, 32) if quick else (2500, 128)
    seen = orbit(24, (20.0, -20.0, 50.0, 0.0), 2.5, 50.0, (size, size))
    problem = Problem(icosphere(2 if quick else 3, 0.6), seen, order="shuffle", albedo="constant")
    problem.phase("shape", steps, {"vertices": Adam(falling(recipe.shape_rate, steps), recipe.betas)},
                  [Loss("silhouette"), *smooth(recipe.laplacian, recipe.consistency, steps)], softness)
    return problem


def part_layers(run: Run) -> Iterator[dict]:
    name, mesh = run.mesh("bunny.obj")
    surface, targets = Surface(mesh.positions, mesh.faces), None
    stops = (10, 20) if run.options.quick else (100, 250, 500, 1000, 1500, 2000, 2500)
    for case, distance, k, r in layers_cases(run):
        problem = layers_problem(run, softness_of(distance, k, r))
        if targets is None:
            targets = run.coverage(mesh, problem.cameras)
        row = {"case": f"{case}, {stops[-1]} steps", "part": "layers", "mesh": name, "distance_by": distance, "K": k, "r": r,
               "size": problem.width}
        yield row | curve(run, problem, targets, surface, stops)


def part_speed(run: Run) -> Iterator[dict]:
    """All open at once and in turns, at the start of the way: ratios that other work disturbs little."""
    sessions, rows = [], []
    try:
        for case, distance, k, r in layers_cases(run):
            problem = layers_problem(run, softness_of(distance, k, r))
            rows.append({"case": case, "part": "speed", "distance_by": distance, "K": k, "r": r, "size": problem.width})
            sessions.append(run.open(problem))
            sessions[-1].set("targets", np.zeros(sessions[-1].shape("targets"), np.float32))
            sessions[-1].step(5)
        meters = [Meter(lambda s=s: s.step(1)) for s in sessions]
        if meters:
            take_turns(meters, 0.1 if run.options.quick else 30.0)
        yield from ({**row, **meter.row} for row, meter in zip(rows, meters))
    finally:
        for session in sessions:
            session.close()


# ---- tables and plot

def front(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Those that no other point beats in both, by the first."""
    out: list[tuple[float, float]] = []
    for p in sorted(points):
        if not out or p[1] < out[-1][1]:
            out.append(p)
    return out


def markdown(columns: list[str], rows: list[list[str]]) -> str:
    return "\n".join([f"| {' | '.join(columns)} |", "|" + "---|" * len(columns), *(f"| {' | '.join(row)} |" for row in rows), ""])


def degrees(cosine: float) -> float:
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def heat_values(rows: list[dict], stop: int) -> dict[tuple[str, str], float]:
    """(r, distance and K) -> distance to the surface after `stop` steps."""
    return {(f"r = {x['r']:g}", name_of(x["distance_by"], x["K"])): x["distance"][x["steps"].index(stop)] for x in rows}


def tables(results: list[dict]) -> str:
    of = {part: [x for x in results if x["part"] == part] for part in PARTS}
    out = []
    if of["gradient"]:
        out.append(markdown(["case", "error", "degrees off", "ms", "cpu ms", ""], [
            [x["case"], f"{x['error']:.3f}", f"{degrees(x['cosine']):.1f}", f"{x['ms']:g}", f"{x['cpu_ms']:g}",
             "front" if x in fronts(of["gradient"]) else ""] for x in of["gradient"]]))
    if of["texture"]:
        out.append(markdown(["case", "error of a step", "cosine", f"error of the mean of {MEAN_OF}", "cosine", "ms", "cpu ms"], [
            [x["case"], f"{x['error']:.1e}", f"{x['cosine']:.4f}", f"{x['error_of_mean']:.1e}", f"{x['cosine_of_mean']:.4f}",
             f"{x['ms']:g}", f"{x['cpu_ms']:g}"] for x in of["texture"]]))
    if of["fit"]:
        stops = of["fit"][0]["steps"]
        out.append(markdown(["case", *(f"{s}" for s in stops), "s", "cpu s", "ms a step", "cpu ms"], [
            [x["case"], *(f"{d:.4f}" for d in x["distance"]), f"{x['seconds'][-1]:g}", f"{x['cpu_seconds'][-1]:g}", f"{x['ms']:g}",
             f"{x['cpu_ms']:g}"] for x in of["fit"]]))
    if of["layers"]:
        stops = of["layers"][0]["steps"]
        out.append(markdown(["case", *(f"{s}" for s in stops), "ms a step", "cpu ms", "cpu s"], [
            [x["case"], *(f"{d:.4f}" for d in x["distance"]), f"{x['ms']:g}", f"{x['cpu_ms']:g}", f"{x['cpu_seconds'][-1]:g}"]
            for x in of["layers"]]))
    if of["speed"]:
        out.append(markdown(["case", "ms a step", "cpu ms"], [[x["case"], f"{x['ms']:g}", f"{x['cpu_ms']:g}"] for x in of["speed"]]))
    return "\n".join(out)


def fronts(rows: list[dict]) -> list[dict]:
    """The rows that no other of their size and profile beats in both error and processor time."""
    out = []
    for size, profile in sorted({(x["size"], x["profile"]) for x in rows}):
        own = [x for x in rows if (x["size"], x["profile"]) == (size, profile)]
        best = front([(x["cpu_ms"], x["error"]) for x in own])
        out += [x for x in own if (x["cpu_ms"], x["error"]) in best]
    return out


def scatter(rows: list[dict], title: str, y_name: str, y: Callable[[dict], float]) -> str:
    sizes, first = sorted({x["size"] for x in rows}), rows[0]["profile"]
    series = [svg.Series(front([(x["cpu_ms"], y(x)) for x in rows if x["size"] == size and x["profile"] == first]), "#777",
                         line=True, dashed=True, radius=0) for size in sizes]
    for x in rows:
        label = "" if x["profile"] != first else f"r{x['r']:g}" if x["swept"] == "r" else f"s{x['sigma']:g}"
        series.append(svg.Series([(x["cpu_ms"], y(x))], COLORS[name_of(x["distance"], x["K"])], [label],
                                 radius=3 if x["size"] == sizes[0] else 5, hollow=x["profile"] != first))
    return svg.chart(title, "processor ms a step", y_name, series, {k: COLORS[k] for k in list(COLORS)[:3]})


def plot(results: list[dict]) -> str:
    of = {part: [x for x in results if x["part"] == part] for part in PARTS}
    panels = []
    if of["gradient"]:
        sizes = " and ".join(f"{s}²" for s in sorted({x["size"] for x in of["gradient"]}))
        panels += [scatter(of["gradient"], f"gradient, {sizes} (large dots), rings: limit4", "relative L2 error", lambda x: x["error"]),
                   scatter(of["gradient"], "the same, direction", "degrees off", lambda x: max(degrees(x["cosine"]), 0.01))]
    for size in sorted({x["size"] for x in of["fit"]}):
        series = [svg.Series(list(zip(x["cpu_seconds"], x["distance"])), COLORS[name_of(x["distance_by"], x["K"])],
                             [""] * (len(x["steps"]) - 1) + [f"r{x['r']:g}"], line=True) for x in of["fit"] if x["size"] == size]
        panels.append(svg.chart(f"sphere to {of['fit'][0]['mesh']}, six views {size}²", "processor seconds", "distance to the surface",
                                series, {k: COLORS[k] for k in list(COLORS)[:3]}))
    if of["layers"]:
        rows, stops = of["layers"], of["layers"][0]["steps"]
        columns = [c for c in COLORS if any(name_of(x["distance_by"], x["K"]) == c for x in rows)]
        for stop in (stops[min(2, len(stops) - 1)], stops[-1]):
            panels.append(svg.heat(f"{rows[0]['mesh']}: distance after {stop} steps", columns,
                                   [f"r = {r:g}" for r in sorted({x["r"] for x in rows})], heat_values(rows, stop)))
        series = [svg.Series(list(zip(x["steps"], x["distance"])), COLORS[name_of(x["distance_by"], x["K"])],
                             [""] * (len(stops) - 1) + [f"r{x['r']:g}"], line=True, radius=2)
                  for x in rows if (x["distance_by"], x["K"], x["r"]) in CURVES]
        panels.append(svg.chart(f"{rows[0]['mesh']}: distance by step", "steps", "distance to the surface", series,
                                {k: COLORS[k] for k in columns}))
    if of["texture"]:
        series = [svg.Series([(x["cpu_ms"], max(x["error"], 1e-8))], "#1b6ca8" if x["gradient"] == "exact" else "#d1495b",
                             [f"{x['atlas']}"], hollow=x["moving"]) for x in of["texture"]]
        panels.append(svg.chart("texture gradient by atlas; rings: shape moves", "processor ms a step", "relative L2 error", series,
                                {"exact": "#1b6ca8", "inverse UV": "#d1495b"}))
    return svg.page(panels)


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--part", choices=PARTS, nargs="*", default=PARTS, help="default: all")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="write the SVG there")
    parser.add_argument("--layers", type=int, nargs="+", default=[1, 3, 5], metavar="K", help="of parts layers and speed")
    parser.add_argument("--radii", type=float, nargs="+", default=[1.0, 2.0, 4.0, 8.0], metavar="R", help="of parts layers and speed")
    options = options_of(parser, arguments)
    document = json.loads(options.json.read_text()) if options.json and options.json.is_file() else {"results": []}
    with tempfile.TemporaryDirectory(prefix="dressi-error-") as folder:
        run = Run(Path(folder), options)
        for part in options.part:
            for row in globals()[f"part_{part}"](run):
                print("  ".join(f"{k} {v}" for k, v in row.items() if k not in ("part", "mesh")), flush=True)
                kept = [x for x in document["results"] if (x["part"], x["case"]) != (part, row["case"])]
                results = sorted([*kept, row], key=lambda x: PARTS.index(x["part"]))
                document = {"device": run.about["device"], "versions": versions(run.about), "results": results}
                save(options, document)  # a part takes minutes, and what is done stays if the rest is cut off
    save(options, document)
    print(f"\n{document['device']}, {document['versions']['driver']}\n\n{tables(document['results'])}")


def save(options: argparse.Namespace, document: dict) -> None:
    if options.json:
        options.json.parent.mkdir(parents=True, exist_ok=True)
        options.json.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    if options.plot:
        options.plot.write_text(plot(document["results"]), encoding="utf-8")


if __name__ == "__main__":
    main()
