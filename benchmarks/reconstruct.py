"""A sphere becomes what 24 photographs show, and is measured against the true mesh and six photographs it has not seen.

    python benchmarks/reconstruct.py spot|bunny [--quick] [--data DIR] [--out DIR] [--json FILE] [--layers K] [--order ORDER]

spot    shape from silhouettes, then the albedo texture, then the shape by colours under that texture, then a texture anew;
        photographs of an unlit surface
bunny   shape from silhouettes; then, from there, either more of the same or Lambert shading under the known light, as many
        steps each: the difference is what shading adds

Photographs are those of DIR/datasets/spot and DIR/datasets/bunny_lambert, by default DIR is `shared` next to the checkout.
--quick takes a small procedural target instead (or, with --data, the photographs at 64x64) and few steps: it shows that all of
this runs, its numbers mean nothing. Into --out go contact.png, shape.png, loss.png and the mesh.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import sys
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "benchmarks")]

import metrics  # noqa: E402

from dressi_edge import runtime  # noqa: E402
from dressi_edge.compiler.io.cameras import Camera, orbit  # noqa: E402
from dressi_edge.compiler.io.meshes import Mesh, load_mesh  # noqa: E402
from dressi_edge.compiler.io.shapes import icosphere, pear  # noqa: E402
from dressi_edge.compiler.io.views import Views, load_views  # noqa: E402
from dressi_edge.compiler.io.writers import contact_sheet, loss_curve, save_mesh  # noqa: E402
from dressi_edge.compiler.render.light import Light  # noqa: E402
from dressi_edge.compiler.render.optimizer import Adam  # noqa: E402
from dressi_edge.compiler.render.raster import Softness  # noqa: E402
from dressi_edge.compiler.render.schedule import Schedule  # noqa: E402
from dressi_edge.compiler.scene.problem import Loss, Problem  # noqa: E402

DATASETS = {"spot": "spot", "bunny": "bunny_lambert"}
ALBEDO = (0.75, 0.72, 0.68)  # of the bunny, and its light, as its data set states them
LIGHTS = (Light("directional", (2.4, 2.4, 2.4), (-0.4, -0.7, -0.6)), Light("ambient", (0.25, 0.25, 0.25)))
UNLIT = {"albedo": "texture"}
LAMBERT = {"albedo": "constant", "albedo_color": ALBEDO, "shading": "lambert", "lights": LIGHTS, "srgb": True}
HARD = Softness(1.0, delta=0.0)  # how results are drawn: one sample a pixel, no edge mask


@dataclass(frozen=True)
class Recipe:
    """Every hyperparameter. Pairs are (first, last) of an exponential schedule over the phase's steps."""

    subdivisions: int = 4
    radius: float = 0.6
    layers: int = 1
    r: float = 2.0
    sigma: float = 0.2
    betas: tuple[float, float] = (0.96, 0.999)
    order: str = "shuffle"
    shape_steps: int = 1500
    shape_rate: tuple[float, float] = (0.02, 0.001)
    laplacian: tuple[float, float] = (100.0, 4.0)
    consistency: tuple[float, float] = (0.02, 0.02)
    texture_heights: tuple[int, ...] = (64, 128, 256)  # a side of the cube is half of it
    texture_steps: int = 30  # for each height
    texture_rate: tuple[float, float] = (0.05, 0.01)
    texture_epsilon: float = 1e-7  # half the gradient of a texel that one pixel of 24 x 256 x 256 shows
    refine_steps: int = 480
    refine_rate: tuple[float, float] = (0.002, 0.0003)
    refine_laplacian: tuple[float, float] = (4.0, 4.0)
    refine_consistency: tuple[float, float] = (0.02, 0.02)
    color: float = 1.0
    color_norm: str = "l2"

    def softness(self) -> Softness:
        return Softness(self.r, self.sigma, layers=self.layers)


# The photographs have shadows and a sky that is partly hidden, our Lambert shading has not: absolute values mind that less.
RECIPES = {"spot": {}, "bunny": {"color": 0.3, "color_norm": "l1"}}
QUICK = {"subdivisions": 3, "shape_steps": 40, "texture_steps": 8, "texture_heights": (64,), "refine_steps": 10}


@dataclass(frozen=True)
class Data:
    """What is known (train), and what it is measured by (the rest)."""

    name: str
    train: Views
    test: Views
    truth: Mesh
    look: dict  # how the surface is drawn: keyword arguments of `Problem`


class Bench:
    """Compiles problems to bundles in a folder of its own and runs them on one device."""

    def __init__(self, folder: Path, device: str | None, profile: str):
        self.folder, self.device, self.profile, self.about = folder, device, profile, {}

    def open(self, problem: Problem):
        path = self.folder / "problem.dressi"
        problem.compile(self.profile, path)
        session = runtime.load(path, self.device)
        self.about = session.report()
        return session

    def draw(self, mesh: Mesh, cameras: tuple[Camera, ...], **look) -> np.ndarray:
        """The mesh from each camera, (n, h, w, 4), hard, colour straight."""
        problem = Problem(mesh, cameras, **look)
        problem.render(softness=HARD)
        with self.open(problem) as session:
            return session.get("render.color")

    def run(self, problem: Problem, phase: str, steps: int, parameter: str) -> tuple[np.ndarray, dict]:
        """All steps of a phase. The parameter's value at the end, and {"steps", "seconds", "ms", "loss"}.

        seconds: of the steps alone, first draw included. ms: of a step, median over pieces of the run. loss: [(step, loss)].
        """
        with self.open(problem) as session:
            done, times, curve = 0, [], [(0, session.loss())]
            while done < steps:
                count = min(max(1, steps // 60), steps - done)
                start = time.perf_counter()
                session.step(count)
                times.append((time.perf_counter() - start, count))
                done += count
                curve.append((done, session.loss()))
                progress(f"{phase} {done}/{steps}  loss {curve[-1][1]:.5f}  {times[-1][0] / count * 1e3:.1f} ms a step")
            value = session.get(parameter)
        progress(None)
        ms = 1e3 * statistics.median(t / n for t, n in times)
        return value, {"steps": steps, "seconds": sum(t for t, _ in times), "ms": ms, "loss": curve}


def progress(text: str | None) -> None:
    """One line that is written over, on a terminal only; None ends it."""
    if sys.stderr.isatty():
        print("\n" if text is None else f"\r{text:78.78}", end="", file=sys.stderr, flush=True)


def load(name: str, folder: Path, look: dict) -> Data:
    folder = folder / "datasets" / DATASETS[name]
    if not folder.is_dir():
        raise SystemExit(f"{folder} does not exist: give the folder that holds datasets/ by --data, or try --quick")
    train, test = (load_views(folder / f"transforms_{part}.json") for part in ("train", "test"))
    return Data(name, train, test, load_mesh(folder / "mesh.ply"), look)


def procedural(name: str, bench: Bench, look: dict, size: int = 64) -> Data:
    """The pear, drawn hard at four times the size and averaged, so that alpha is coverage."""
    mesh = pear(96)
    cameras = orbit(10, (20.0, -20.0), 3.0, 40.0, (4 * size, 4 * size))
    images = bench.draw(mesh, cameras, **look)
    images[..., :3] = np.where(images[..., 3:] > 0.0, images[..., :3], 0.0)
    views = Views(np.clip(images, 0.0, 1.0), cameras, tuple(map(str, range(10)))).resized((size, size))
    return Data(name, part(views, range(8)), part(views, (8, 9)), mesh, look)


def part(views: Views, which) -> Views:
    which = list(which)
    return Views(views.images[which], tuple(views.cameras[k] for k in which), tuple(views.names[k] for k in which))


def falling(pair: tuple[float, float], steps: int) -> Schedule:
    return Schedule(pair[0], pair[1], steps, "exponential")


def smooth(laplacian: tuple[float, float], consistency: tuple[float, float], steps: int) -> list[Loss]:
    return [Loss("laplacian", falling(laplacian, steps), power=2), Loss("normal_consistency", falling(consistency, steps))]


def shape(bench: Bench, data: Data, recipe: Recipe, start: Mesh) -> tuple[Mesh, dict]:
    """Silhouettes of the training views, a squared uniform Laplacian, and normals alike across edges."""
    steps = recipe.shape_steps
    problem = Problem(start, data.train, order=recipe.order, albedo="constant")
    problem.phase("shape", steps, {"vertices": Adam(falling(recipe.shape_rate, steps), recipe.betas)},
                  [Loss("silhouette"), *smooth(recipe.laplacian, recipe.consistency, steps)], recipe.softness())
    vertices, run = bench.run(problem, "shape", steps, "vertices")
    return replace(start, positions=vertices), run


def refine(bench: Bench, data: Data, recipe: Recipe, start: Mesh, name: str, color: float) -> tuple[Mesh, dict]:
    """More steps from a shape; `color`: the weight of shaded colours inside the photographs' masks, 0 for silhouettes alone."""
    steps = recipe.refine_steps
    losses = [Loss("silhouette"), *smooth(recipe.refine_laplacian, recipe.refine_consistency, steps)]
    losses += [Loss("color", color, norm=recipe.color_norm, masked=True)] if color else []
    problem = Problem(start, data.train, order=recipe.order, **(data.look if color else {"albedo": "constant"}))
    problem.phase(name, steps, {"vertices": Adam(falling(recipe.refine_rate, steps), recipe.betas)}, losses, recipe.softness())
    vertices, run = bench.run(problem, name, steps, "vertices")
    return replace(start, positions=vertices), run


def texture(bench: Bench, data: Data, recipe: Recipe, mesh: Mesh) -> tuple[Mesh, dict]:
    """The albedo texture on a shape that stays, by all training views at once, coarse to fine; the shape is drawn hard.

    Where the sphere was squeezed a pixel covers many texels, and most are never sampled: they keep what the coarser one said.
    """
    steps, runs, low = recipe.texture_steps, [], recipe.texture_heights[0]
    image = np.full((low, low * 3 // 2, 3), 0.5)
    adam = Adam(falling(recipe.texture_rate, steps), (0.9, 0.99), recipe.texture_epsilon)
    for height in recipe.texture_heights:
        start = finer(image, height // len(image))
        problem = Problem(replace(mesh, texture=start), data.train, **data.look)
        problem.phase("texture", steps, {"texture": adam}, [Loss("color", norm="l1", masked=True)], HARD)
        image, run = bench.run(problem, f"texture {height}", steps, "texture")
        image = filled(np.clip(image, 0.0, 1.0).astype(np.float64), (image != start.astype(np.float32)).any(axis=2))
        runs.append(run)
    curve = [(k * steps + step, loss) for k, run in enumerate(runs) for step, loss in run["loss"]]
    return replace(mesh, texture=image), {"steps": steps * len(runs), "seconds": sum(run["seconds"] for run in runs),
                                          "ms": statistics.median(run["ms"] for run in runs), "loss": curve}


def finer(image: np.ndarray, factor: int) -> np.ndarray:
    """(h, w, 3) resampled bilinearly to `factor` times the size; texel centres stay where they are."""
    for axis in (0, 1):
        n = image.shape[axis]
        at = np.clip((np.arange(n * factor) + 0.5) / factor - 0.5, 0, n - 1)
        low = np.minimum(at.astype(int), max(n - 2, 0))
        f = np.expand_dims(at - low, (1, 2) if axis == 0 else (0, 2))
        image = np.take(image, low, axis) * (1.0 - f) + np.take(image, np.minimum(low + 1, n - 1), axis) * f
    return image


def filled(image: np.ndarray, known: np.ndarray) -> np.ndarray:
    """The image (h, w, 3), its texels that are not `known` (h, w) taking the mean of neighbours that are, ring by ring."""
    image, known = image.copy(), known.copy()
    while known.any() and not known.all():
        total, count = np.zeros_like(image), np.zeros(known.shape)
        for axis, step in ((0, 1), (0, -1), (1, 1), (1, -1)):
            total += np.roll(image * known[..., None], step, axis)
            count += np.roll(known, step, axis)
        ring = ~known & (count > 0)
        image[ring] = total[ring] / count[ring, None]
        known |= ring
    return image


def measure(data: Data, surface: metrics.Surface, mesh: Mesh, drawn: np.ndarray) -> dict:
    iou = metrics.silhouette_iou(drawn[..., 3], data.test.images[..., 3])
    psnr, strict = metrics.psnr_in_mask(drawn, data.test.images)
    return {**surface.measure(mesh.positions, mesh.faces)._asdict(), "iou": iou.mean(), "iou_least": iou.min(),
            "psnr": psnr.mean(), "psnr_least": psnr.min(), "psnr_strict": strict.mean()}


def reconstruct(data: Data, recipe: Recipe, bench: Bench, out: Path) -> list[dict]:
    """Everything of a case: rows of results, and pictures in `out`."""
    surface = metrics.Surface(data.truth.positions, data.truth.faces)
    cameras, results, curves, shapes = data.test.cameras, [], {}, {}
    sheet = [("photographs", data.test.images)]

    def finished(name: str, mesh: Mesh, run: Mapping, color: bool) -> Mesh:
        drawn = bench.draw(mesh, cameras, **(data.look if color else {"albedo": "constant"}))
        row = {"case": f"{data.name} {name}", **run, **measure(data, surface, mesh, drawn)}
        row = {k: v if isinstance(v, str | int) else round(float(v), 6) for k, v in row.items()
               if k != "loss" and (color or not k.startswith("psnr"))}
        results.append(row)
        print(line(results[-1]), flush=True)
        curves[name], shapes[name] = run["loss"], mesh
        sheet.extend([(f"ours: {name}", drawn)] if color else [])
        return mesh

    start = icosphere(recipe.subdivisions, recipe.radius)
    if data.look["albedo"] != "texture":  # the best that this model of light could do
        seen = metrics.psnr_in_mask(bench.draw(data.truth, cameras, **data.look), data.test.images)[0].mean()
        print(f"{data.name}: the true mesh, drawn by this renderer: PSNR {seen:.2f} dB", flush=True)
        results.append({"case": f"{data.name} true mesh", "ms": 0.0, "psnr": round(float(seen), 6)})
    lit = data.look["albedo"] != "texture"
    best = finished("silhouettes", *shape(bench, data, recipe, start), color=lit)
    if lit:
        finished("more silhouettes", *refine(bench, data, recipe, best, "silhouettes", 0.0), color=True)
        best = finished("shading", *refine(bench, data, recipe, best, "shading", recipe.color), color=True)
    else:
        best = finished("texture", *texture(bench, data, recipe, best), color=True)
        best = finished("shape by colour", *refine(bench, data, recipe, best, "shape by colour", recipe.color), color=True)
        best = finished("texture again", *texture(bench, data, recipe, best), color=True)
    grey = {"albedo": "constant", "albedo_color": (0.7, 0.7, 0.7), "shading": "lambert", "lights": LIGHTS, "srgb": True}
    rows = [("true shape", bench.draw(data.truth, cameras, **grey)), ("start", bench.draw(start, cameras, **grey))]
    rows += [(name, bench.draw(mesh, cameras, **grey)) for name, mesh in shapes.items() if "texture" not in name]
    contact_sheet(sheet, out / "contact.png")
    contact_sheet(rows, out / "shape.png")
    loss_curve(curves, out / "loss.png", title=f"{data.name}: loss of the view at hand")
    save_mesh(out / "mesh.glb", best)
    save_mesh(out / "mesh.obj", best)
    return results


def line(row: dict) -> str:
    return (f"{row['case']:24} {row['steps']:5} steps {row['ms']:7.1f} ms {row['seconds']:6.1f} s  "
            f"distance {row['vertex']:.5f}  chamfer {row['chamfer']:.5f}  normals {row['normal']:5.1f}  IoU {row['iou']:.4f}"
            + (f"  PSNR {row['psnr']:.2f} dB" if "psnr" in row else ""))


def versions(about: Mapping) -> dict:
    return {"python": platform.python_version(), "numpy": np.__version__, "driver": about["driver"],
            "profile": about["profile"], "system": f"{platform.system()} {platform.machine()}, {os.cpu_count()} CPUs"}


def write_report(path: Path | None, about: Mapping, results: list[dict], **more) -> None:
    """The JSON of a benchmark: {"device", "versions", "results": [{"case", "ms", ...}], ...}."""
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        text = json.dumps({"device": about["device"], "versions": versions(about), "results": results, **more}, indent=1)
        path.write_text(text + "\n", encoding="utf-8")


def common_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--quick", action="store_true", help="a small procedural target and few steps")
    parser.add_argument("--data", type=Path, metavar="DIR", help="the folder of datasets/ and meshes/ (default: ../shared)")
    parser.add_argument("--out", type=Path, metavar="DIR", help="where pictures go (default: results_<case>)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the results there")
    parser.add_argument("--layers", type=int, default=1, metavar="K", help="layers of HardSoftRas (default 1)")
    parser.add_argument("--device", help="an index or a part of the device's name")
    parser.add_argument("--profile", default="lavapipe", help="the device profile to compile for (default lavapipe)")


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("case", choices=DATASETS)
    parser.add_argument("--order", choices=("batch", "cycle", "shuffle"), help="all views a step, or one (default shuffle)")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE",
                        help="another hyperparameter, a Python literal")
    common_options(parser)
    options = parser.parse_args(arguments)
    recipe = replace(recipe_of(options), layers=options.layers, **({"order": options.order} if options.order else {}))
    out = options.out or Path(f"results_{options.case}")
    out.mkdir(parents=True, exist_ok=True)
    look = UNLIT if options.case == "spot" else LAMBERT
    with tempfile.TemporaryDirectory(prefix="dressi-bench-") as folder:
        bench = Bench(Path(folder), options.device, options.profile)
        if options.quick and options.data is None:
            data = procedural(options.case, bench, look)
        else:
            data = load(options.case, options.data or ROOT.parent / "shared", look)
            if options.quick:
                data = replace(data, train=data.train.resized((64, 64)), test=data.test.resized((64, 64)))
        results = reconstruct(data, recipe, bench, out)
    write_report(options.json, bench.about, results, recipe=vars(recipe), views=[len(data.train), len(data.test)],
                 size=list(data.train.images.shape[2:0:-1]))
    print(f"{bench.about['device']}, {bench.about['driver']}; pictures in {out}")


def recipe_of(options) -> Recipe:
    import ast
    given = {}
    for text in options.set:
        name, _, value = text.partition("=")
        if name not in Recipe.__dataclass_fields__:
            raise SystemExit(f"--set {text}: there are {' '.join(Recipe.__dataclass_fields__)}")
        given[name] = ast.literal_eval(value)
    return Recipe(**(RECIPES[options.case] | (QUICK if options.quick else {}) | given))


if __name__ == "__main__":
    main()
