"""An environment and a roughness from pictures, shapes known (the paper's Figure 18): a torus, a pot and a pig.

    python benchmarks/light_and_roughness.py [--data DIR] [--mesh FILE ...] [--panorama FILE] [--roughness R ...] [--views N]
                                             [--size PIXELS] [--steps N] [--even WEIGHT] [--json FILE] [--picture FILE] [--quick]

The pot is the teapot and the pig that of DIR (by default `shared` next to the checkout), the panorama DIR's sunset; without it the torus
and a sky of its own. The environment starts grey; its truth is clamped to [0.02, 4], as the paper clamps it. Told are

roughness    the one that was found
all          PSNR of the environment's map, all of its texels; the peak is the clamp
visible      over texels that a pixel of a picture mirrors, and how large a part of the sphere they are
lobe         of the map as a surface of that roughness sees it: filtered by its lobe (of the nearest level), over all directions
pictures     PSNR of the pictures
"""
from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from pathlib import Path

import numpy as np

from dressi_edge import runtime
from dressi_edge.compiler.io.panorama import read_exr
from dressi_edge.compiler.render.octahedron import cells, places
from dressi_edge.compiler.render.prefilter import layout
from dressi_edge.compiler.scene import (
    PBR,
    Adam,
    Environment,
    F,
    Mesh,
    Scene,
    Schedule,
    Tone,
    l1,
    load_mesh,
    load_panorama,
    octahedral,
    orbit,
    panorama,
    save_png,
    total_variation,
)

ROOT = Path(__file__).resolve().parents[1]
PEAK = 4.0
TRUTH = (0.15, 0.35, 0.6)
OWN = {"pot": "meshes/teapot.obj", "pig": "assets/meshes_cgal/pig.stl"}


def torus(across: int = 64, around: int = 32) -> Mesh:
    """Radii 0.6 and 0.27."""
    u, v = np.meshgrid(np.arange(across), np.arange(around), indexing="ij")
    a, b = 2 * np.pi * u / across, 2 * np.pi * v / around
    r = 0.6 + 0.27 * np.cos(b)
    points = np.stack([r * np.cos(a), 0.27 * np.sin(b), r * np.sin(a)], -1).reshape(-1, 3)
    k, right, up = u * around + v, (u + 1) % across * around + v, u * around + (v + 1) % around
    over = (u + 1) % across * around + (v + 1) % around
    return Mesh(points, np.concatenate([np.stack([k, up, over], -1).reshape(-1, 3), np.stack([k, over, right], -1).reshape(-1, 3)]))


def centred(mesh: Mesh) -> Mesh:
    """Within a radius of 0.9 about the origin, with normals of its vertices."""
    x = mesh.positions - (mesh.positions.max(0) + mesh.positions.min(0)) / 2
    return Mesh(x * 0.9 / np.linalg.norm(x, axis=1).max(), mesh.faces)


def outdoors() -> np.ndarray:
    """A panorama of sky, ground, sun and windows."""
    y, x = np.mgrid[:128, :256]
    image = np.where(y < 64, 0.5 + 0.6 * y / 64, 0.25)[..., None] * np.where((y < 64)[..., None], [0.6, 0.8, 1.0], [0.9, 0.7, 0.5])
    image = image + 6.0 * np.exp(-((x - 180) ** 2 + (y - 40) ** 2) / 60.0)[..., None] * [1.0, 0.9, 0.7]
    for k in range(6):
        image[55:95, 15 + 40 * k:30 + 40 * k] = [[1.5, 1.2, 0.6], [0.1, 0.15, 0.3], [0.5, 1.0, 0.4]][k % 3]
    return image


def db(error: float, peak: float = 1.0) -> float:
    return float(10 * np.log10(peak ** 2 / max(error, 1e-12)))


def mirrored_by(directions: np.ndarray, n: int) -> np.ndarray:
    """(n, n): whether one of the directions (count, 3) is one of the texel's."""
    column, row = np.floor(places(directions) * n).clip(0, n - 1).astype(int).T
    found = np.zeros((n, n), bool)
    found[row, column] = True
    return found


def fit(mesh: Mesh, light: np.ndarray, roughness: float, options) -> tuple[dict, np.ndarray]:
    """What was found and how good it is, and the map."""
    size, steps, n = options.size, options.steps, len(light)
    s = Scene(orbit(options.views, [25, -20, 60, -50], 2.6, 40, (size, size)), encode=Tone("reinhard", white=PEAK))
    around = Environment(s.parameter("sky", light, 0.0, PEAK, kind="image"))
    own = s.parameter("roughness", roughness, 0.05, 1.0)
    s.add(mesh, material=PBR((0.95, 0.93, 0.9), own, 1.0, environment=around))
    seen = s.frame()
    photo = s.input("photo", np.zeros((options.views, size, size, 3)))
    even = {"even": (options.even, total_variation(around.map))} if options.even else {}
    s.phase("fit", steps, {"sky": Adam(Schedule(0.03, 0.003, steps, "exponential")),
                           "roughness": Adam(Schedule(0.01, 0.001, steps, "exponential"))}, color=l1(seen.color, photo), **even)
    s.output("look", color=seen.color)
    s.output("mirror", towards=seen.ray - seen.normal * (F.dot(seen.normal, seen.ray) * 2.0), mask=seen.mask)
    s.output("lobes", levels=around.levels)
    with tempfile.TemporaryDirectory() as folder:
        s.compile(options.profile, Path(folder) / "x.dressi")
        with runtime.load(Path(folder) / "x.dressi", options.device) as session:
            target, lobes = session.get("look.color"), np.asarray(session.get("lobes.levels"), float)
            visible = mirrored_by(session.get("mirror.towards")[np.squeeze(session.get("mirror.mask")) > 0], n)
            session.set("photo", target)
            session.set("sky", np.full((n, n, 3), 0.5))
            session.set("roughness", 0.5)
            start = time.perf_counter()
            session.step(steps)
            found, r = np.asarray(session.get("sky"), float), float(session.get("roughness"))  # which waits for the steps
            seconds = time.perf_counter() - start
            after, off = session.get("look.color"), np.asarray(session.get("lobes.levels"), float) - lobes
    level = min(layout(n).levels, key=lambda x: abs(x.roughness - roughness))
    x, y = level.x + 1, level.y + 1
    error, angle = ((found - light) ** 2).mean(-1), cells(n)[1].reshape(n, n)
    return {"truth": roughness, "found": r, "environment_psnr": db(np.average(error, weights=angle), PEAK),
            "visible": float((angle * visible).sum() / angle.sum()),
            "visible_psnr": db(np.average(error, weights=angle * visible), PEAK),
            "lobe_psnr": db((off[y:y + level.n, x:x + level.n] ** 2).mean(), PEAK),
            "picture_psnr": db(((after - target) ** 2).mean()), "ms_per_step": seconds / steps * 1e3}, found


def main(given: list[str] | None = None) -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--data", type=Path, default=ROOT.parent / "shared")
    arguments.add_argument("--mesh", nargs="*", type=Path, help="these beside the torus, instead of the pot and the pig")
    arguments.add_argument("--panorama", type=Path)
    arguments.add_argument("--roughness", nargs="*", type=float, default=TRUTH)
    arguments.add_argument("--views", type=int, default=8)
    arguments.add_argument("--size", type=int, default=128)
    arguments.add_argument("--steps", type=int, default=400)
    arguments.add_argument("--texels", type=int, default=32, help="a side of the octahedral map")
    arguments.add_argument("--even", type=float, default=0.0, help="the weight of the map's total variation")
    arguments.add_argument("--profile", default="lavapipe")
    arguments.add_argument("--device")
    arguments.add_argument("--quick", action="store_true")
    arguments.add_argument("--json", type=Path)
    arguments.add_argument("--picture", type=Path, help="a PNG: the environment, then what was found, a mesh a row")
    options = arguments.parse_args(given)
    if options.quick:
        options.size, options.steps, options.views, options.texels, options.roughness = 32, 120, 4, 16, (0.15,)
    known, sunset = {name: options.data / path for name, path in OWN.items()}, options.data / "meshes" / "sunset_512x256.exr"
    if options.mesh is not None:
        known = {path.stem: path for path in options.mesh}
    if options.panorama:
        wide = load_panorama(options.panorama)
    elif sunset.is_file():
        wide = np.maximum(read_exr(sunset.read_bytes(), sunset)[..., :3], 0.0)  # some of it is below 0
    else:
        wide = outdoors()
    light = np.clip(octahedral(wide, options.texels), 0.02, PEAK)
    meshes = {"torus": torus(), **{name: centred(load_mesh(path)) for name, path in known.items() if path.is_file()}}
    rows, pictures = [], []
    print(f"{'mesh':10} {'roughness':>9} {'found':>6} {'all dB':>6} {'visible dB':>10} {'of the sphere':>13} {'lobe dB':>7} "
          f"{'pictures dB':>11} {'ms':>5}")
    for name, mesh in meshes.items():
        across = [panorama(light, 64)]
        for roughness in options.roughness:
            row, sky = fit(mesh, light, roughness, options)
            rows.append({"mesh": name, "faces": len(mesh.faces), **row})
            print(f"{name:10} {roughness:9.2f} {row['found']:6.3f} {row['environment_psnr']:6.1f} {row['visible_psnr']:10.1f} "
                  f"{row['visible']:13.2f} {row['lobe_psnr']:7.1f} {row['picture_psnr']:11.1f} {row['ms_per_step']:5.1f}", flush=True)
            across.append(panorama(sky, 64))
        pictures.append(np.concatenate(across, 1))
    if options.json:
        options.json.write_text(json.dumps({"views": options.views, "size": options.size, "steps": options.steps, "texels": options.texels,
                                            "even": options.even, "photographed": bool(options.panorama) or sunset.is_file(),
                                            "load": round(os.getloadavg()[0], 1), "results": rows}, indent=1) + "\n")
    if options.picture:
        shown = np.concatenate(pictures, 0)
        save_png(options.picture, np.clip(shown / (1 + shown) * (1 + shown / PEAK ** 2), 0, 1) ** (1 / 2.2))


if __name__ == "__main__":
    main()
