"""Real photographs whose cameras are wrong: ten trials with the poses held, and with the poses refined beside shape and texture.

    python benchmarks/poses.py oxford|middlebury|spot [--quick] [--trials N] [--turn DEGREES] [--shift PIXELS] [--size S] [--data DIR]

Each trial turns every training camera about the object and shifts it, by normal numbers with these deviations (a shift in pixels at the
object); carves the hull by those cameras (what two masks lack is kept), and moves its vertices by normal numbers of a two-hundredth of the
object. Then shape and texture are fitted by silhouettes and colours, one view a step, and from there
held     they are fitted on, as many steps
refined  the same, with a turn and a shift of each camera beside them
With --turn 0 --shift 0 the trials are of the random start alone. pixels: how far the cameras see the surface's vertices from where the true
ones see them, root mean square. Nothing in the pictures says where all of it is together, nor how large it is, so the motion and scale
that make this least are taken out before, and before test views, which are in no step, are drawn. Rows are means over the trials and
their standard deviations.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "benchmarks")]

import metrics  # noqa: E402
from real import load, procedural  # noqa: E402
from reconstruct import HARD, Bench, common_options, falling, versions  # noqa: E402

from dressi_edge import runtime  # noqa: E402
from dressi_edge.cache.errors import InputWarning  # noqa: E402
from dressi_edge.compiler.io.cameras import Camera, rotation_matrix  # noqa: E402
from dressi_edge.compiler.io.hull import visual_hull  # noqa: E402
from dressi_edge.compiler.io.mesh import Mesh, middle_of  # noqa: E402
from dressi_edge.compiler.io.views import Views  # noqa: E402
from dressi_edge.compiler.render.raster import renderer_of  # noqa: E402
from dressi_edge.compiler.scene import (  # noqa: E402
    Adam,
    F,
    Scene,
    Softness,
    Texture,
    Unlit,
    l2,
    normal_consistency,
    uniform_laplacian,
)

POSE = ("turn", "shift")
LIMIT = {"turn": 0.2, "shift": 0.2}  # radians, and of the object's radius


@dataclass(frozen=True)
class Recipe:
    """Every hyperparameter; lengths are of the object's radius. Pairs are (first, last) of an exponential schedule over the steps."""

    vertices: int = 642
    texels: int = 64
    misses: int = 2
    steps: int = 250
    jitter: float = 0.005
    rate: tuple[float, float] = (0.003, 0.0003)
    texture_rate: tuple[float, float] = (0.05, 0.004)
    pose_rate: tuple[float, float] = (0.002, 0.0005)
    laplacian: float = 20.0
    consistency: float = 0.02
    color: float = 1.0


def moved(camera: Camera, middle: np.ndarray, turn: np.ndarray, shift: np.ndarray) -> Camera:
    """The camera with what it sees turned about `middle` and shifted, in camera space: what `Scene.pose_cameras` does."""
    pose = camera.world_to_camera.copy()
    p = pose[:3, :3] @ middle + pose[:3, 3]
    pose[:3] = np.column_stack([rotation_matrix(turn) @ pose[:3, :3], rotation_matrix(turn) @ (pose[:3, 3] - p) + p + shift])
    return replace(camera, world_to_camera=pose)


def seen_at(cameras, points: np.ndarray) -> np.ndarray:
    """(cameras, points, 2) in pixels."""
    out = []
    for c in cameras:
        x, y, z = (c.world_to_camera[:3, :3] @ points.T + c.world_to_camera[:3, 3:])
        out.append(np.stack([c.cx - c.fx * x / z, c.cy + c.fy * y / z], 1))
    return np.array(out)


def placed(found, true, points: np.ndarray, middle: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """The turn about the middle, shift and scale by which the true cameras see the points nearest to where those found see them."""
    sample = points[np.linspace(0, len(points) - 1, min(len(points), 60)).astype(int)]
    wanted = seen_at(found, sample)

    def by(x: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        return lambda p: np.exp(x[6]) * (p - middle) @ rotation_matrix(x[:3]).T + middle + x[3:6]

    best = least_squares(lambda x: (seen_at(true, by(x)(sample)) - wanted).ravel(), np.zeros(7))
    return by(best.x)


def problem(train: Views, mesh: Mesh, middle: np.ndarray, radius: float, recipe: Recipe, seed: int) -> Scene:
    """Phases `begin`, and after it `held` or `refined`, over the same parameters."""
    scene, steps, n = Scene(train.cameras), recipe.steps, len(train)
    x = scene.parameter("vertices", mesh.positions)
    skin = scene.parameter("texture", np.full((recipe.texels, recipe.texels, 3), 0.5), low=0.0, high=1.0)
    pose = {name: scene.parameter(name, np.zeros((n, 3)), -LIMIT[name] * unit, LIMIT[name] * unit, kind="table")
            for name, unit in (("turn", 1.0), ("shift", radius))}
    scene.pose_cameras(pose["turn"], pose["shift"], middle)
    body = scene.add(mesh, x, Unlit(Texture(skin, mesh.wrap)))
    photos = scene.input("targets", np.asarray(train.images), kind="pictures", narrow=True)
    for name, more, slower in (("begin", (), 1.0), ("held", (), 0.3), ("refined", POSE, 0.3)):
        seen = scene.frame(renderer_of(Softness(2.0, 0.2)), phase=name, order="shuffle", seed=seed)
        photo = seen.at(photos)
        optimize = {"vertices": Adam(falling(tuple(slower * radius * r for r in recipe.rate), steps), (0.96, 0.999)),
                    "texture": Adam(falling(tuple(slower * r for r in recipe.texture_rate), steps), (0.9, 0.99))}
        optimize |= {key: Adam(falling(tuple((radius if key == "shift" else 1.0) * r for r in recipe.pose_rate), steps)) for key in more}
        scene.phase(name, steps, optimize, silhouette=l2(seen.alpha, photo.w),
                    color=(recipe.color, l2(seen.color, photo.xyz * photo.w, photo.w)),
                    smooth=(recipe.laplacian / radius ** 2, uniform_laplacian(x, body.topology, 2)),
                    normals=(recipe.consistency, normal_consistency(x, body.topology)))
    return scene


def drawing(test: Views, mesh: Mesh, recipe: Recipe) -> Scene:
    """The mesh from the test cameras, hard."""
    scene = Scene(test.cameras)
    skin = scene.parameter("texture", np.zeros((recipe.texels, recipe.texels, 3)), low=0.0, high=1.0)
    scene.add(mesh, scene.parameter("vertices", mesh.positions), Unlit(Texture(skin, mesh.wrap)))
    seen = scene.frame(renderer_of(HARD))
    scene.output("look", color=F.compose(seen.color, seen.alpha))
    return scene


def trial(bench: Bench, data, recipe: Recipe, turn: float, shift: float, seed: int) -> list[dict]:
    """A row for `held` and one for `refined`."""
    train, test, middle, radius = data
    rng, true = np.random.default_rng(seed), train.cameras
    pixel = np.median([-(c.world_to_camera[2] @ np.append(middle, 1.0)) / c.fx for c in true])
    wrong = [moved(c, middle, np.radians(turn) * rng.normal(size=3), shift * pixel * rng.normal(size=3)) for c in true]
    given = Views(train.images, tuple(wrong), train.names)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        mesh = visual_hull(given, recipe.vertices, recipe.misses)
    mesh = replace(mesh, positions=mesh.positions + recipe.jitter * radius * rng.normal(size=mesh.positions.shape))
    problem(given, mesh, middle, radius, recipe, seed).compile(bench.profile, bench.folder / "fit.dressi")
    drawing(test, mesh, recipe).compile(bench.profile, bench.folder / "draw.dressi")
    rows = []
    with runtime.load(bench.folder / "fit.dressi", bench.device) as fit, runtime.load(bench.folder / "draw.dressi", bench.device) as draw:
        bench.about = fit.report()
        fit.step(recipe.steps, "begin")
        starts = {name: fit.get(name) for name in ("vertices", "texture", *POSE)}
        for name in ("held", "refined"):
            fit.set_all(starts)
            begun = time.process_time()
            fit.step(recipe.steps, name)
            vertices = np.asarray(fit.get("vertices"), float)
            spent = time.process_time() - begun
            found = [moved(c, middle, np.asarray(w, float), np.asarray(t, float))
                     for c, w, t in zip(wrong, fit.get("turn"), fit.get("shift"))]
            back = placed(found, true, vertices, middle)
            draw.set_all({"vertices": back(vertices), "texture": fit.get("texture")})
            image = draw.get("look.color")
            away = seen_at(found, vertices) - seen_at(true, back(vertices))
            rows.append({"case": name, "iou": float(metrics.silhouette_iou(image[..., 3], test.images[..., 3]).mean()),
                         "psnr": float(metrics.psnr_in_mask(image, np.asarray(test.images))[0].mean()),
                         "pixels": float(np.sqrt((away ** 2).sum(2).mean())), "ms": 1e3 * spent / recipe.steps})
    return rows


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("case", choices=("oxford", "middlebury", "spot"))
    parser.add_argument("--trials", type=int, default=10, metavar="N", help="how many (default 10)")
    parser.add_argument("--turn", type=float, default=1.0, metavar="DEGREES", help="deviation of each camera's turns (default 1)")
    parser.add_argument("--shift", type=float, default=2.0, metavar="PIXELS", help="deviation of each camera's shifts (default 2)")
    parser.add_argument("--size", type=int, default=96, help="average the photographs down to a longer side of so many pixels (96)")
    common_options(parser)
    options = parser.parse_args(arguments)
    recipe = Recipe(vertices=150, texels=32, steps=120) if options.quick else Recipe()
    trials: list[dict] = []
    with tempfile.TemporaryDirectory(prefix="dressi-bench-") as folder:
        bench = Bench(Path(folder), options.device, options.profile)
        train, test = (procedural(bench) if options.quick else
                       load(options.case, options.data or ROOT.parent / "shared", options.size))[:2]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", InputWarning)
            hull = visual_hull(train, 300).positions
        middle = np.asarray(middle_of(hull), float)
        data = train, test, middle, float(np.linalg.norm(hull - middle, axis=1).max())
        about = {"recipe": vars(recipe), "turn": options.turn, "shift": options.shift, "views": [len(train), len(test)],
                 "size": list(train.images.shape[2:0:-1])}
        for seed in range(options.trials):
            trials += [{"trial": seed, **row} for row in trial(bench, data, recipe, options.turn, options.shift, seed)]
            for row in trials[-2:]:
                print("  ".join(f"{k} {x:.4f}" if isinstance(x, float) else f"{k} {x}" for k, x in row.items()), flush=True)
            results = means(options.case, trials)
            if options.json is not None:
                options.json.parent.mkdir(parents=True, exist_ok=True)
                report = {"device": bench.about["device"], "versions": versions(bench.about), "results": results, "trials": trials, **about}
                options.json.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    for row in results:
        print(f"{row['case']:20} " + "  ".join(f"{k} {row[k]:.4f} +- {row[f'{k}_deviation']:.4f}" for k in ("iou", "psnr", "pixels", "ms")))


def means(case: str, trials: list[dict]) -> list[dict]:
    """Over the trials so far, with deviations."""
    results = []
    for name in ("held", "refined"):
        own = [row for row in trials if row["case"] == name]
        row = {"case": f"{case} {name}", "trials": len(own)}
        for key in ("iou", "psnr", "pixels", "ms"):
            row[key], row[f"{key}_deviation"] = (round(float(f([r[key] for r in own])), 5) for f in (np.mean, np.std))
        results.append(row)
    return results


if __name__ == "__main__":
    main()
