"""Real photographs (paper 5.2, Figure 14): joint shape and texture, from a sphere and from the visual hull, with a gain for each view.

    python benchmarks/real.py oxford|middlebury|dtu|spot [--quick] [--data DIR] [--out DIR] [--json FILE] [--size PIXELS]

sphere   silhouettes of the training views from a ball, then a texture on the shape that was found: what the job of docs/photographs.md
         does with a sphere, 1000 and 150 steps
hull     the same from the visual hull of the masks, a third of the steps
joint    from there: shape, texture and a gain for each view and channel together, by silhouettes and colours, unlit
Test views are in no step. Data are those of DIR/assets and DIR/datasets, by default DIR is `shared` next to the checkout; --quick takes a
small procedural ring instead and few steps: it shows that all of this runs, its numbers mean nothing.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "benchmarks")]

import metrics  # noqa: E402
from reconstruct import HARD, Bench, common_options, falling, part, smooth, versions  # noqa: E402

from dressi_edge import runtime  # noqa: E402
from dressi_edge.cache.errors import InputWarning  # noqa: E402
from dressi_edge.compiler.io.cameras import orbit  # noqa: E402
from dressi_edge.compiler.io.hull import genus_of, visual_hull  # noqa: E402
from dressi_edge.compiler.io.meshes import load_mesh  # noqa: E402
from dressi_edge.compiler.io.views import Views, load_views  # noqa: E402
from dressi_edge.compiler.io.writers import contact_sheet, save_mesh  # noqa: E402
from dressi_edge.compiler.render.raster import renderer_of  # noqa: E402
from dressi_edge.compiler.scene import (  # noqa: E402
    Adam,
    Light,
    Loss,
    Mesh,
    Problem,
    Scene,
    Softness,
    Texture,
    Unlit,
    l2,
    mean_square,
    normal_consistency,
    sphere,
    uniform_laplacian,
)

SETS = {"oxford": "assets/oxford_dino", "middlebury": "assets/middlebury_dino48", "dtu": "assets/dtu_scan24", "spot": "datasets/spot"}
GREY = {"albedo": "constant", "albedo_color": (0.7, 0.7, 0.7), "shading": "lambert", "srgb": True,
        "lights": (Light("directional", (2.4, 2.4, 2.4), (-0.4, -0.7, -0.6)), Light("ambient", (0.25, 0.25, 0.25)))}
SOFT = Softness(2.0, 0.2)


@dataclass(frozen=True)
class Recipe:
    """Every hyperparameter. Pairs are (first, last) of an exponential schedule over the phase's steps."""

    vertices: int = 2562
    texture_size: int = 256
    texture_rate: tuple[float, float] = (0.05, 0.01)
    sphere_steps: tuple[int, int] = (1000, 150)  # shape, texture
    sphere_rate: tuple[float, float] = (0.02, 0.001)
    sphere_laplacian: tuple[float, float] = (100.0, 4.0)
    hull_steps: tuple[int, int] = (333, 50)
    hull_rate: tuple[float, float] = (0.003, 0.0003)
    hull_laplacian: tuple[float, float] = (20.0, 4.0)
    joint_steps: int = 300
    joint_rate: tuple[float, float] = (0.001, 0.0002)
    joint_texture_rate: tuple[float, float] = (0.03, 0.002)
    gain_rate: float = 0.003
    gain_prior: float = 0.1
    color: float = 2.0
    consistency: float = 0.02


QUICK = Recipe(vertices=200, texture_size=64, sphere_steps=(6, 4), hull_steps=(4, 3), joint_steps=4)


def shape(bench: Bench, train: Views, start: Mesh, steps: int, rate, laplacian, recipe: Recipe) -> tuple[Mesh, dict]:
    problem = Problem(start, train, order="shuffle", albedo="constant")
    problem.phase("shape", steps, {"vertices": Adam(falling(rate, steps), (0.96, 0.999))},
                  [Loss("silhouette"), *smooth(laplacian, (recipe.consistency,) * 2, steps)], SOFT)
    vertices, run = bench.run(problem, "shape", steps, "vertices")
    return replace(start, positions=vertices), run


def texture(bench: Bench, train: Views, mesh: Mesh, steps: int, recipe: Recipe) -> tuple[Mesh, dict]:
    problem = Problem(mesh, train, order="shuffle", albedo="texture", texture_size=(recipe.texture_size,) * 2)
    problem.phase("texture", steps, {"texture": Adam(falling(recipe.texture_rate, steps), (0.9, 0.99))},
                  [Loss("color", masked=True)], HARD)
    image, run = bench.run(problem, "texture", steps, "texture")
    return replace(mesh, texture=np.clip(image, 0.0, 1.0).astype(np.float64)), run


def joint(bench: Bench, train: Views, mesh: Mesh, recipe: Recipe) -> tuple[Mesh, dict, np.ndarray]:
    """Shape, texture and gains together. The gains (views, 3) stay about 1: what all views share is the texture's."""
    steps, scene = recipe.joint_steps, Scene(train.cameras)
    x = scene.parameter("vertices", mesh.positions)
    skin = scene.parameter("texture", mesh.texture, low=0.0, high=1.0)
    gain = scene.parameter("gain", np.ones((len(train), 3)), kind="table")
    body = scene.add(mesh, x, Unlit(Texture(skin, mesh.wrap)))
    seen = scene.frame(renderer_of(SOFT), phase="joint", order="shuffle")
    photo = seen.at(scene.input("targets", np.asarray(train.images), kind="pictures", narrow=True))
    scene.phase("joint", steps, {"vertices": Adam(falling(recipe.joint_rate, steps), (0.96, 0.999)),
                                 "texture": Adam(falling(recipe.joint_texture_rate, steps), (0.9, 0.99)), "gain": Adam(recipe.gain_rate)},
                silhouette=l2(seen.alpha, photo.w),
                color=(recipe.color, l2(seen.color * seen.per_view(gain), photo.xyz * photo.w, photo.w)),
                smooth=(recipe.hull_laplacian[1], uniform_laplacian(x, body.topology, 2)),
                normals=(recipe.consistency, normal_consistency(x, body.topology)), gains=(recipe.gain_prior, mean_square(gain - 1.0)))
    path = bench.folder / "joint.dressi"
    scene.compile(bench.profile, path)
    with runtime.load(path, bench.device) as session:
        session.step(1)
        start = time.perf_counter()
        session.step(steps - 1)
        session.get("gain")
        seconds = time.perf_counter() - start
        found = replace(mesh, positions=session.get("vertices"), texture=np.clip(session.get("texture"), 0, 1).astype(np.float64))
        return found, {"steps": steps, "seconds": seconds, "ms": seconds / max(steps - 1, 1) * 1e3}, np.asarray(session.get("gain"))


def load(name: str, folder: Path, size: int | None) -> tuple[Views, Views, Mesh | None, np.ndarray | None]:
    place = folder / SETS[name]
    if not place.is_dir():
        raise SystemExit(f"{place} does not exist: give the folder that holds assets/ and datasets/ by --data, or try --quick")
    train, test = (load_views(place / f"transforms_{part}.json", size) for part in ("train", "test"))
    points = np.load(place / "points3d.npz")["xyz"].astype(float) if (place / "points3d.npz").exists() else None
    return train, test, load_mesh(place / "mesh.ply") if name == "spot" else None, points


def procedural(bench: Bench) -> tuple[Views, Views, Mesh, None]:
    """A painted ring, drawn hard."""
    a, b = np.meshgrid(np.linspace(0, 2 * np.pi, 49)[:-1], np.linspace(0, 2 * np.pi, 25)[:-1], indexing="ij")
    points = np.stack([(0.6 + 0.22 * np.cos(b)) * np.cos(a), 0.22 * np.sin(b), (0.6 + 0.22 * np.cos(b)) * np.sin(a)], -1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(48), np.arange(24), indexing="ij")
    at = lambda p, q: (p % 48 * 24 + q % 24).ravel()  # noqa: E731
    corners = ((i, j), (i, j + 1), (i + 1, j)), ((i + 1, j), (i, j + 1), (i + 1, j + 1))
    faces = np.concatenate([np.stack([at(*corner) for corner in face], 1) for face in corners])
    mesh = Mesh(points, faces.astype(np.int32), colors=0.5 + 0.4 * np.sin(3.0 * points))
    cameras = orbit(10, (60.0, -35.0), 3.0, 40.0, (48, 48))
    images = np.clip(bench.draw(mesh, cameras, albedo="colors"), 0.0, 1.0).astype(np.float32)
    views = Views(images, cameras, tuple(map(str, range(10))))
    return part(views, range(8)), part(views, (8, 9)), mesh, None


def reconstruct(bench: Bench, name: str, data, recipe: Recipe, out: Path, ball: bool = True) -> list[dict]:
    train, test, truth, points = data
    results, sheet, shapes = [], [("photographs", np.asarray(test.images))], []

    def finished(case: str, mesh: Mesh, run: dict, spent: tuple[float, float], color: bool = True) -> None:
        drawn = bench.draw(mesh, test.cameras, **({"albedo": "texture"} if color else {"albedo": "constant"}))
        row = {"case": f"{name} {case}", "steps": run["steps"], "ms": run["ms"], "seconds": spent[0], "processor": spent[1],
               "genus": sum(genus_of(mesh.faces))}
        row["iou"] = metrics.silhouette_iou(drawn[..., 3], test.images[..., 3]).mean()
        if color:
            row["psnr"], row["psnr_strict"] = (x.mean() for x in metrics.psnr_in_mask(drawn, np.asarray(test.images)))
            sheet.append((case, drawn))
        surface = metrics.Surface(mesh.positions, mesh.faces)
        if truth is not None:
            row["chamfer"] = metrics.Surface(truth.positions, truth.faces).measure(mesh.positions, mesh.faces).chamfer
        if points is not None:
            row["points"] = float(np.median(surface.vertex_distances(points)))
        shapes.append((case, bench.draw(mesh, test.cameras, **GREY)))
        results.append({k: x if isinstance(x, str | int) else round(float(x), 5) for k, x in row.items()})
        print("  ".join(f"{k} {x:.4g}" if isinstance(x, float) else f"{k} {x}" for k, x in results[-1].items()), flush=True)

    def timed(before: tuple[float, float], work, *arguments):
        """What the work gives, and all that was spent: seconds on the clock, and of the processors, of this process."""
        begun = time.perf_counter(), time.process_time()
        found = work(bench, train, *arguments)
        return *found, (before[0] + time.perf_counter() - begun[0], before[1] + time.process_time() - begun[1])

    def course(case: str, start: Mesh, spent, steps, rate, laplacian):
        mesh, run, spent = timed(spent, shape, start, steps[0], rate, laplacian, recipe)
        finished(f"{case}: shape", mesh, run, spent, color=False)
        mesh, run, spent = timed(spent, texture, mesh, steps[1], recipe)
        finished(f"{case}: texture", mesh, run, spent)
        return mesh, spent

    def carved(_, views: Views) -> tuple[Mesh]:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", InputWarning)
            return (visual_hull(views, recipe.vertices),)

    hull, spent = timed((0.0, 0.0), carved)
    finished("hull", hull, {"steps": 0, "ms": 0.0}, spent, color=False)
    mesh, spent = course("hull", hull, spent, recipe.hull_steps, recipe.hull_rate, recipe.hull_laplacian)
    mesh, run, gains, spent = timed(spent, joint, mesh, recipe)
    finished("joint", mesh, run, spent)
    results[-1]["gains"] = [round(float(x), 4) for x in (gains.min(), gains.max(), gains.std())]
    save_mesh(out / "mesh.glb", mesh, unlit=True)
    if ball:
        course("sphere", sphere(recipe.vertices, 0.6), (0.0, 0.0), recipe.sphere_steps, recipe.sphere_rate,
               recipe.sphere_laplacian)
    contact_sheet(sheet, out / "contact.png")
    contact_sheet(shapes, out / "shape.png")
    return results


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("case", choices=SETS)
    parser.add_argument("--size", type=int, help="average the photographs down to a longer side of so many pixels")
    parser.add_argument("--hull", action="store_true", help="leave the course from the sphere out")
    common_options(parser)
    options = parser.parse_args(arguments)
    recipe, out = QUICK if options.quick else Recipe(), options.out or Path(f"results_{options.case}")
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="dressi-bench-") as folder:
        bench = Bench(Path(folder), options.device, options.profile)
        data = procedural(bench) if options.quick else load(options.case, options.data or ROOT.parent / "shared", options.size)
        results = reconstruct(bench, options.case, data, recipe, out, not options.hull)
    if options.json is not None:
        options.json.parent.mkdir(parents=True, exist_ok=True)
        report = {"device": bench.about["device"], "versions": versions(bench.about), "results": results, "recipe": vars(recipe),
                  "views": [len(data[0]), len(data[1])], "size": list(data[0].images.shape[2:0:-1])}
        options.json.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    print(f"{bench.about['device']}, {bench.about['driver']}; pictures in {out}")


if __name__ == "__main__":
    main()
