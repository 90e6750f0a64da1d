"""An environment and a roughness from pictures, shapes known (the paper's Figure 18, in small): a torus, and meshes of one's own.

    python benchmarks/light_and_roughness.py [--mesh FILE ...] [--panorama FILE] [--views N] [--size PIXELS] [--steps N]

The environment starts grey; its truth is clamped to [0.02, 4], as the paper clamps it. Told are the roughness that was found, the PSNR of
the environment over the texels that the pictures tell of (those that have moved; the peak is the clamp), and that of the pictures.
"""
from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

import numpy as np

from dressi_edge import runtime
from dressi_edge.compiler.scene import (
    PBR,
    Adam,
    Environment,
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
)

RESULTS = Path(__file__).resolve().parent / "results"
PEAK = 4.0
TRUTH = {"shiny": 0.15, "satin": 0.35, "rough": 0.6}


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


def fit(mesh: Mesh, light: np.ndarray, roughness: float, options) -> tuple[dict, list]:
    size, steps, n = options.size, options.steps, len(light)
    s = Scene(orbit(options.views, [25, -20, 60, -50], 2.6, 40, (size, size)), encode=Tone("reinhard", white=PEAK))
    around = Environment(s.parameter("sky", light, 0.0, PEAK, kind="image"))
    own = s.parameter("roughness", roughness, 0.05, 1.0)
    s.add(mesh, material=PBR((0.95, 0.93, 0.9), own, 1.0, environment=around))
    seen = s.frame()
    photo = s.input("photo", np.zeros((options.views, size, size, 3)))
    s.phase("fit", steps, {"sky": Adam(Schedule(0.03, 0.003, steps, "exponential")),
                           "roughness": Adam(Schedule(0.01, 0.001, steps, "exponential"))}, color=l1(seen.color, photo))
    s.output("look", color=seen.color)
    with tempfile.TemporaryDirectory() as folder:
        s.compile(options.profile, Path(folder) / "x.dressi")
        with runtime.load(Path(folder) / "x.dressi") as session:
            target = session.get("look.color")
            session.set("photo", target)
            session.set("sky", np.full((n, n, 3), 0.5))
            session.set("roughness", 0.5)
            session.step(steps)
            found, after = session.get("sky"), session.get("look.color")
            r = float(session.get("roughness"))
    told = (np.abs(found - 0.5) > 0.01).any(-1)
    error = float(((found - light)[told] ** 2).mean())
    return {"truth": roughness, "found": r, "texels": float(told.mean()), "environment_psnr": float(10 * np.log10(PEAK ** 2 / error)),
            "picture_psnr": float(-10 * np.log10(max(((after - target) ** 2).mean(), 1e-12)))}, [found, after[0], target[0]]


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    arguments.add_argument("--mesh", nargs="*", default=[], type=Path)
    arguments.add_argument("--panorama", type=Path)
    arguments.add_argument("--views", type=int, default=8)
    arguments.add_argument("--size", type=int, default=96)
    arguments.add_argument("--steps", type=int, default=400)
    arguments.add_argument("--texels", type=int, default=32, help="a side of the octahedral map")
    arguments.add_argument("--profile", default="lavapipe")
    arguments.add_argument("--picture", type=Path, help="a PNG of what was found and wanted")
    options = arguments.parse_args()
    wide = load_panorama(options.panorama) if options.panorama else outdoors()
    light = np.clip(octahedral(wide, options.texels), 0.02, PEAK)
    meshes = {"torus": torus(), **{path.stem: centred(load_mesh(path)) for path in options.mesh}}
    rows, pictures = {}, [panorama(light, 64)]
    print(f"{'mesh':16} {'roughness':>9} {'found':>7} {'environment dB':>14} {'of texels':>9} {'pictures dB':>11}")
    for name, mesh in meshes.items():
        for roughness in TRUTH.values():
            row, (sky, after, target) = fit(mesh, light, roughness, options)
            rows[f"{name}, {roughness}"] = row
            print(f"{name:16} {roughness:9.2f} {row['found']:7.3f} {row['environment_psnr']:14.1f} {row['texels']:9.2f} "
                  f"{row['picture_psnr']:11.1f}", flush=True)
            pictures.append(panorama(sky, 64))
    (RESULTS / "light_and_roughness.json").write_text(json.dumps({"views": options.views, "size": options.size, "steps": options.steps,
                                                                  "panorama": bool(options.panorama), "cases": rows}, indent=1) + "\n")
    if options.picture:
        shown = np.concatenate(pictures, 0)
        save_png(options.picture, np.clip(shown / (1 + shown) * (1 + shown / PEAK ** 2), 0, 1) ** (1 / 2.2))


if __name__ == "__main__":
    main()
