"""The map of normals of a glTF asset from pictures that show it (the paper's Figure 19): geometry, colours, roughness and lights known.

    python benchmarks/asset_normals.py [--quick] [--asset FILE [--map FILE]] [--size N] [--views N] [--steps N] [--json FILE] ...

Pictures are drawn with the file's own map, the fit begins flat. PSNR of the pictures and angle of the normals that are shaded with, over
all pixels of the object, before and after; ms a step. Asset: DIR/meshes/avocado, with a map of 512x512 texels, if none is named; with
--made, or where that is not there, a pear whose bumps are a map of 1024x1024, written as glTF first.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image
from step import options_of, rounded, table, write

from dressi_edge import runtime
from dressi_edge.compiler.io.materials import Material, Part, TextureMap
from dressi_edge.compiler.io.textures import Picture
from dressi_edge.compiler.io.writers import save_parts
from dressi_edge.compiler.scene import (
    Adam,
    F,
    HardSoftRas,
    Light,
    Schedule,
    l2,
    load_mesh,
    load_parts,
    load_scene,
    look_at,
    orbit,
    pear,
    save_png,
)

LIGHTS = [Light("directional", 2.0, d) for d in ((-1, -0.6, -0.5), (0.8, -0.5, -0.8), (0.1, -0.7, 1.0), (0.3, 1.0, -0.2))]
FLAT = (0.5, 0.5, 1.0)


def cameras_of(positions: np.ndarray, views: int, size: int) -> list:
    """All around what has these vertices, above and below."""
    low, high = positions.min(0), positions.max(0)
    middle, radius = (low + high) / 2, np.linalg.norm(high - low) / 2
    eyes = [np.linalg.inv(c.world_to_camera)[:3, 3] for c in orbit(views, [25, -20], 2.6 * radius, 40, (size, size))]
    return [look_at(middle + eye, middle, (0, 1, 0), 40, size, size, near=0.1 * radius, far=10 * radius) for eye in eyes]


def made(folder: Path, texels: int) -> Path:
    """A glTF file of a pear whose map of normals has bumps of several sizes."""
    y, x = np.mgrid[:texels, :texels] / texels * 2 * np.pi
    right = 0.5 * np.cos(12 * x) * np.sin(10 * y) + 0.3 * np.cos(40 * x + 9 * y) + 0.15 * np.cos(110 * x - 60 * y)
    down = 0.5 * np.sin(12 * x) * np.cos(10 * y) + 0.3 * np.cos(40 * x + 9 * y + 1) + 0.15 * np.cos(110 * x - 60 * y + 2)
    normal = np.stack([-right, down, np.ones_like(x)], -1)
    normal = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    Image.fromarray(np.round((normal * 0.5 + 0.5) * 255).astype(np.uint8)).save(folder / "bumps.png")
    mesh, bumps = pear(64), TextureMap(Picture("bumps", folder / "bumps.png"))
    material = Material("pear", (0.7, 0.6, 0.3, 1.0), None, 0.0, 0.6, normal_texture=bumps, stated=True)
    save_parts(folder / "pear.glb", [Part("pear", replace(mesh, texture=None), material, {0: (mesh.uvs, mesh.uv_faces)})])
    return folder / "pear.glb"


def with_map(mesh_file: Path, map_file: Path, folder: Path) -> Path:
    """A glTF file of a mesh and a picture of normals that belongs to it."""
    mesh = load_mesh(mesh_file)
    material = Material(mesh_file.stem, (0.6, 0.5, 0.45, 1.0), None, 0.0, 0.6, normal_texture=TextureMap(Picture("normals", map_file)),
                        stated=True)
    save_parts(folder / f"{mesh_file.stem}.glb", [Part("mesh", replace(mesh, texture=None), material, {0: (mesh.uvs, mesh.uv_faces)})])
    return folder / f"{mesh_file.stem}.glb"


def looks(session) -> dict:
    return {key: np.asarray(session.get(f"look.{key}"), float) for key in ("color", "normal", "mask")}


def fitted(asset: Path, views: int, size: int, steps: int, options: argparse.Namespace, folder: Path) -> tuple[dict, dict]:
    """The row of the table, and the session's report; pictures into `folder`."""
    part, = load_parts(asset)
    scene = load_scene(asset, cameras_of(part.mesh.positions, views, size), lights=LIGHTS, parameters=["*.normal_texture"], mips=False)
    name, = scene.parameters
    truth, material = part.material.normal_texture.picture.texels()[..., :3], scene.parts[0].material
    seen = scene.frame(HardSoftRas(1.0, delta=0.0))
    scene.output("look", color=seen.color, mask=seen.mask, normal=seen.of(lambda s: F.normalize(material.normal(s))))
    photo = scene.input("photo", np.zeros((views, size, size, 3)))
    scene.phase("fit", steps, {name: Adam(Schedule(0.03, 0.003, steps, "exponential"))}, color=l2(seen.color, photo, mask=seen.mask))
    scene.compile(options.profile, folder / "fit.dressi", record=False)
    with runtime.load(folder / "fit.dressi", options.device) as session:
        session.set(name, truth)
        wanted = looks(session)
        session.set(name, np.broadcast_to(FLAT, truth.shape))
        before = looks(session)
        session.set("photo", wanted["color"])
        spent = []
        for _ in range(steps):
            start = time.perf_counter()
            session.step(1)
            spent.append((time.perf_counter() - start) * 1e3)
        after, report = looks(session), session.report()
    inside = wanted["mask"] > 0
    row = {"case": f"{asset.stem}, {views} views {size}x{size}, map {truth.shape[1]}x{truth.shape[0]}, {steps} steps"}
    for key, found in (("before", before), ("after", after)):
        row[f"psnr_{key}"] = rounded(-10 * np.log10(((found["color"] - wanted["color"])[inside] ** 2).mean()))
        cosine = np.clip((found["normal"] * wanted["normal"]).sum(-1)[inside], -1, 1)
        row[f"degrees_{key}"] = rounded(np.degrees(np.arccos(cosine)).mean())
    row["ms"] = rounded(statistics.median(spent))
    rows = [np.concatenate(list(x["color"][:3]), 1) for x in (before, after, wanted)]
    save_png(folder / "asset_normals.png", np.clip(np.concatenate(rows), 0, 1))
    return row, report


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--asset", type=Path, help="a glTF file of one part with a map of normals")
    parser.add_argument("--map", type=Path, help="its map of normals, where the asset is a mesh that names none")
    parser.add_argument("--made", action="store_true", help="take the pear")
    parser.add_argument("--size", type=int, default=256, help="of the pictures")
    parser.add_argument("--views", type=int, default=6)
    parser.add_argument("--steps", type=int, default=80)
    parser.add_argument("--out", type=Path, help="a folder for the picture")
    options = options_of(parser, arguments)
    asset = options.asset or options.data / "meshes" / "avocado" / "Avocado.gltf"
    if options.asset and not asset.is_file():
        raise SystemExit(f"{asset} is not there")
    size, views, steps = (32, 2, 3) if options.quick else (options.size, options.views, options.steps)
    with tempfile.TemporaryDirectory(prefix="dressi-normals-") as folder:
        if options.made or not asset.is_file():
            asset = made(Path(folder), 64 if options.quick else 1024)
        elif options.map:
            asset = with_map(asset, options.map, Path(folder))
        row, report = fitted(asset, views, size, steps, options, Path(folder))
        if options.out:
            (options.out / "asset_normals.png").write_bytes((Path(folder) / "asset_normals.png").read_bytes())
    print(f"{report['device']}, {report['driver']}")
    print(table([row], tuple(row)))
    write(options.json, report, [row])


if __name__ == "__main__":
    main()
