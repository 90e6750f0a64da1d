"""Shape, colours, roughness, metal and light together, from photographs with known cameras alone (the problem of Munkberg et al. 2022).

    python benchmarks/inverse.py [--data DIR] [--size 160] [--views 24] [--rounds 3] [--quick] [--json FILE] [--picture FILE]

The thing is Bob of DIR/assets/bob_nvdiffrec under the panorama of DIR/meshes, by default DIR is `shared` next to the checkout; without it a
pear under a sky of its own. Its blue spots are of metal and smooth, the rest is not. Photographs: Mitsuba 3's of its `principled`
reflectance by direct light, shadows included, where it is installed; else ours, which knows no better than what it is asked to find.

The fit begins with the visual hull of the masks, grey, under a grey sky. Measured by six photographs that it has not seen, and there by the
colours (scaled channel by channel as nothing else can be, for light times colour is all that is seen), roughness and metal of each pixel
that shows the thing in both; the distance of the surfaces both ways; and under another light, which nobody has photographed.

roughness told     only where 0.1 more of it changes some photograph by 0.02 (`told`)
ours of the truth  the photographs against our pictures of the true shape, maps and light: what no fit of ours can be better than
"""
from __future__ import annotations

import argparse
import importlib.util
import json
import math
import os
import platform
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "benchmarks")]

import metrics  # noqa: E402

from dressi_edge import runtime  # noqa: E402
from dressi_edge.compiler.graph.ir import Node  # noqa: E402
from dressi_edge.compiler.io.hull import visual_hull  # noqa: E402
from dressi_edge.compiler.io.panorama import read_exr  # noqa: E402
from dressi_edge.compiler.io.shapes import pear  # noqa: E402
from dressi_edge.compiler.io.views import Views  # noqa: E402
from dressi_edge.compiler.scene import (  # noqa: E402
    PBR,
    Adam,
    Camera,
    Channel,
    Environment,
    F,
    HardSoftRas,
    Mesh,
    Outline,
    Scene,
    Schedule,
    Texture,
    Unlit,
    l1,
    l2,
    load_mesh,
    octahedral,
    orbit,
    panorama,
    save_png,
    tint,
    total_variation,
    uniform_laplacian,
)

PEAK = 4.0  # radiance is clamped to this, as the paper clamps it
ELEVATIONS = (25.0, -20.0, 55.0, 0.0)
TOLD = 0.02  # of `told`, from where on photographs count as telling of roughness
SIDE = 32  # texels of the environment's map


@dataclass(frozen=True)
class Thing:
    """A mesh with uvs, its maps (h, w, 3) in linear colours and with roughness and metal as channels y and z, and a panorama around it."""

    mesh: Mesh
    color: np.ndarray
    maps: np.ndarray
    sky: np.ndarray


def linear(image: np.ndarray) -> np.ndarray:
    return np.where(image <= 0.04045, image / 12.92, ((image + 0.055) / 1.055) ** 2.4)


def averaged(image: np.ndarray, size: int) -> np.ndarray:
    """A square image whose side is a multiple of `size`, as size x size."""
    by = len(image) // size
    return image[:by * size, :by * size].reshape(size, by, size, by, -1).mean((1, 3))


def outdoors() -> np.ndarray:
    """A sky with a lamp and windows."""
    y, x = np.mgrid[:64, :128]
    sky = np.where((y < 32)[..., None], [0.5, 0.7, 1.0], [0.35, 0.28, 0.2]) + 0.0
    sky += 8.0 * np.exp(-((x - 90) ** 2 + (y - 20) ** 2) / 20.0)[..., None] * [1.0, 0.9, 0.7]
    sky[18:34, 10:22], sky[20:36, 50:60] = (2.0, 1.4, 0.6), (0.3, 0.8, 1.6)
    return sky


def thing(data: Path, texels: int) -> Thing:
    """The photographed thing, about the origin and within a radius of 0.95."""
    folder, light = data / "assets" / "bob_nvdiffrec", data / "meshes" / "sunset_512x256.exr"
    if folder.is_dir():
        from PIL import Image
        mesh, picture = load_mesh(folder / "bob_tri.obj"), np.asarray(Image.open(folder / "bob_diffuse.png").convert("RGB")) / 255.0
        picture = averaged(linear(picture), texels)[:, :, :3]
    else:
        mesh = pear(96)
        y, x = np.mgrid[:texels, :texels] / texels
        spots = (np.sin(x * 19) * np.sin(y * 13) > 0.6)[..., None]
        picture = np.where(spots, [0.05, 0.2, 0.6], [0.9, 0.5, 0.02])
    x = mesh.positions - (mesh.positions.max(0) + mesh.positions.min(0)) / 2
    mesh = Mesh(x * 0.95 / np.linalg.norm(x, axis=1).max(), mesh.faces, mesh.uvs, mesh.uv_faces)
    spotted = picture[..., 2:] > picture[..., :1]
    maps = np.concatenate([np.zeros_like(spotted, float), np.where(spotted, 0.2, 0.45), spotted.astype(float)], -1)
    sky = np.asarray(read_exr(light.read_bytes(), light), float)[..., :3] if light.is_file() else outdoors()  # some of it is below 0
    return Thing(mesh, picture * 0.9 + 0.03, maps, np.clip(sky, 0.02, PEAK))


def session_of(scene: Scene, folder: Path, options):
    path = folder / "x.dressi"
    scene.compile(options.profile, path)
    return runtime.load(path, options.device)


def drawn(mesh: Mesh, cameras, material, folder: Path, options, by: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Colours (n, h, w, 3) over black, and alpha, of by x by samples a pixel."""
    scene = Scene([Camera(c.world_to_camera, c.fx * by, c.fy * by, c.cx * by, c.cy * by, c.width * by, c.height * by) for c in cameras])
    scene.add(mesh, None, material)
    seen = scene.frame(HardSoftRas(1.0, delta=0.0))
    scene.output("look", color=seen.color, alpha=seen.mask)
    with session_of(scene, folder, options) as session:
        color, alpha = np.asarray(session.get("look.color"), float), np.asarray(session.get("look.alpha"), float)

    def smaller(x):
        return x.reshape(len(x), x.shape[1] // by, by, x.shape[2] // by, by, -1).mean((2, 4))
    return smaller(color), smaller(alpha)[..., 0]


def shaded(of: Thing, sky: np.ndarray) -> PBR:
    maps = of.maps
    return PBR(Texture(of.color), Channel(Texture(maps), "y"), Channel(Texture(maps), "z"), environment=Environment(octahedral(sky, SIDE)))


def mitsuba_photographs(of: Thing, cameras, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Colours and alpha, as `drawn`, by Mitsuba's direct light."""
    from peers import area_normals, mitsuba, mitsuba_mesh
    mi, mesh = mitsuba(), of.mesh

    def bitmap(image):
        return {"type": "bitmap", "bitmap": mi.Bitmap(image.astype(np.float32)), "raw": True}
    surface = mi.load_dict({"type": "principled", "base_color": bitmap(of.color), "roughness": bitmap(of.maps[..., 1:2]),
                            "metallic": bitmap(of.maps[..., 2:]), "specular": 0.5})
    normals = area_normals(mesh.positions, mesh.faces)[mesh.faces]
    uvs = np.asarray(mesh.uvs)[mesh.uv_faces]
    sky = np.roll(of.sky, of.sky.shape[1] // 2, 1)  # its columns begin where ours have their middle
    scene = mi.load_dict({"type": "scene", "mesh": mitsuba_mesh(mesh.positions[mesh.faces], normals, uvs, bsdf=surface),
                          "light": {"type": "envmap", "bitmap": mi.Bitmap(sky.astype(np.float32))},
                          "integrator": {"type": "direct", "hide_emitters": True}})
    found = []
    for k, c in enumerate(cameras):
        sensor = mi.load_dict({"type": "perspective", "fov": 2 * math.degrees(math.atan(c.width / 2 / c.fx)),
                               "film": {"type": "hdrfilm", "width": c.width, "height": c.height, "rfilter": {"type": "box"},
                                        "pixel_format": "rgba"},
                               "to_world": mi.ScalarTransform4f(c.camera_to_world * (-1, 1, -1, 1))})
        found.append(np.array(mi.render(scene, sensor=sensor, spp=samples, seed=k), float))
    found = np.stack(found)
    return found[..., :3], np.clip(found[..., 3], 0.0, 1.0)


def told(of: Thing, cameras, others, folder: Path, options) -> np.ndarray:
    """(n, h, w), of each pixel of the other cameras: how much the colours of some pixel of a photograph of the same place change if its
    roughness grows by 0.1: root mean square of the channels, the largest over all photographs."""
    rougher = Thing(of.mesh, of.color, np.clip(of.maps + [0.0, 0.1, 0.0], 0.0, 1.0), of.sky)
    looks, n = [drawn(x.mesh, cameras, shaded(x, of.sky), folder, options, 1) for x in (of, rougher)], 256
    changed = np.sqrt(((np.clip(looks[0][0], 0, 1) - np.clip(looks[1][0], 0, 1)) ** 2).mean(-1))
    y, x = (np.mgrid[:n, :n] + 0.5) / n
    place = drawn(of.mesh, cameras, Unlit(Texture(np.stack([x, y, x * 0], -1))), folder, options, 1)[0]
    row, column = ((place[..., k] * n).astype(int).clip(0, n - 1) for k in (1, 0))
    most, inside = np.zeros((n, n)), looks[0][1] > 0.99
    np.maximum.at(most, (row[inside], column[inside]), changed[inside])
    for _ in range(3):  # texels between those that pixels are at
        most = np.where(most > 0, most, np.max([np.roll(most, (i, j), (0, 1)) for i in (-1, 0, 1) for j in (-1, 0, 1)], 0))
    return drawn(of.mesh, others, Unlit(Texture(np.repeat(most[..., None], 3, -1))), folder, options)[0][..., 0]


def alike(colors: Node, size: int, sharp: float) -> Node:
    """Of each of size x size texels how much it looks like those beside and below it: 1 as they do, exp(-sharp d^2) of other colours."""
    while colors.extent.width > size:
        colors = F.downsample(colors)
    apart = [F.shift(colors, dx, dy) - colors for dx, dy in ((-1, 0), (0, -1))]
    return F.stop_gradient(F.exp((F.dot(apart[0], apart[0]) + F.dot(apart[1], apart[1])) * -sharp))


def fit(photos, masks, cameras, folder: Path, options) -> tuple[Thing, np.ndarray, dict]:
    """The thing found, the environment's map and how long it took."""
    start, steps = time.perf_counter(), 4 if options.quick else options.steps
    images = np.concatenate([np.clip(photos, 0, 1), masks[..., None]], -1).astype(np.float32)
    views = Views(images, tuple(cameras), tuple(map(str, range(len(cameras)))))
    hull = visual_hull(views, 642 if options.quick else options.vertices)
    s = Scene(cameras)
    x = s.parameter("vertices", hull.positions)
    base = s.parameter("base", np.full((options.texels, options.texels, 3), 0.5), 0.02, 1.0, kind="image")
    rest = s.parameter("maps", np.full((options.texels // 4, options.texels // 4, 3), [0.0, options.rough, options.metal]), 0.02, 1.0,
                       kind="image")
    light = s.parameter("sky", np.full((SIDE, SIDE, 3), 0.6), 0.0, PEAK, kind="image")
    part = s.add(hull, x, PBR(Texture(base), Channel(Texture(rest), "y"), Channel(Texture(rest), "z"), environment=Environment(light)))
    photo, mask = s.input("photo", photos), s.input("mask", masks)
    bend, count = uniform_laplacian(x, part.topology, 2), steps * options.rounds

    first = steps * options.first // 100

    def adam(rate: float, n: int) -> Adam:
        return Adam(Schedule(rate, rate / 10, n, "exponential"))
    for name, n, optimize, colors in (("outline", 2 * steps, {"vertices": 0.004}, False),
                                      ("light", first, {"base": 0.02, "sky": options.sky_rate}, True),
                                      ("surface", count, {"base": 0.02, "maps": options.maps_rate, "sky": options.sky_rate}, True),
                                      ("shape", count, {"vertices": 0.002}, True)):
        if not n:
            continue
        seen = s.frame(Outline(r=2.0), phase=name, order="shuffle")
        same = alike(base, options.texels // 4, options.guide) if options.guide else None
        even = {"even": (options.even, total_variation(base)), "even_maps": (options.even_maps, total_variation(rest, mask=same)),
                **({"white": (Schedule(options.white, options.white / 100, n, "exponential"), tint(light))} if options.white else {})}
        kept = even if name in ("light", "surface") else {
            "mask": l2(seen.alpha, seen.at(mask)), "smooth": (options.smooth, bend)}
        s.phase(name, n, {key: Adam(rate) if name == "light" else adam(rate, n) for key, rate in optimize.items()},
                **({"color": l1(seen.color, seen.at(photo))} if colors else {}), **kept)
    with session_of(s, folder, options) as session:
        session.step(2 * steps, "outline")
        if first:
            session.step(first, "light")
        for _ in range(options.rounds):
            session.step(steps, "surface")
            session.step(steps, "shape")
        session.step(steps, "surface")
        found = {key: np.asarray(session.get(key), float) for key in ("vertices", "base", "maps", "sky")}
        about = session.report()
    mesh = Mesh(found["vertices"], hull.faces, hull.uvs, hull.uv_faces)
    return (Thing(mesh, found["base"], found["maps"], panorama(found["sky"], 64)), hull,
            {"seconds": time.perf_counter() - start, "device": about["device"], "driver": about["driver"]})


def psnr(a: np.ndarray, b: np.ndarray, where: np.ndarray) -> float:
    return float(-10 * np.log10(max(np.mean((np.clip(a, 0, 1) - np.clip(b, 0, 1))[where] ** 2), 1e-12)))


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=ROOT.parent / "shared")
    parser.add_argument("--size", type=int, default=160)
    parser.add_argument("--views", type=int, default=24)
    parser.add_argument("--vertices", type=int, default=2562)
    parser.add_argument("--texels", type=int, default=256, help="a side of the colours; of the other maps a quarter")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--steps", type=int, default=200, help="of each phase and round")
    parser.add_argument("--smooth", type=float, default=1.0, help="the weight of the Laplacian")
    parser.add_argument("--even", type=float, default=0.02, help="the weight of the colours' total variation")
    parser.add_argument("--even-maps", type=float, default=0.02, help="that of roughness and metal")
    parser.add_argument("--white", type=float, default=0.0, help="the weight of the light's tint as a phase begins; a hundredth as it ends")
    parser.add_argument("--first", type=int, default=0, help="steps before roughness and metal move, in percent of --steps")
    parser.add_argument("--sky-rate", type=float, default=0.03, help="Adam's, for the light")
    parser.add_argument("--guide", type=float, default=0.0, help="how much less roughness and metal are evened out where colours differ")
    parser.add_argument("--ours", action="store_true", help="photographs by ourselves, of the very model that is fitted")
    parser.add_argument("--rough", type=float, default=0.5, help="the roughness that the fit begins with")
    parser.add_argument("--metal", type=float, default=0.2, help="the metal that the fit begins with")
    parser.add_argument("--maps-rate", type=float, default=0.02, help="Adam's, for roughness and metal")
    parser.add_argument("--samples", type=int, default=128, help="of Mitsuba, a pixel")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--profile", default="lavapipe")
    parser.add_argument("--device")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--picture", type=Path)
    options = parser.parse_args(arguments)
    if options.quick:
        options.size, options.views, options.rounds, options.texels, options.samples = 48, 8, 1, 64, 16
    size, true = options.size, thing(options.data, 512)
    cameras = orbit(options.views, ELEVATIONS, 2.7, 42.0, (size, size))
    others = orbit(6, (10.0, -35.0, 40.0), 2.7, 42.0, (size, size))
    theirs = importlib.util.find_spec("mitsuba") is not None and not options.ours
    with tempfile.TemporaryDirectory(prefix="dressi-inverse-") as name:
        folder = Path(name)

        def photographs(at):
            if theirs:
                return mitsuba_photographs(true, at, options.samples)
            return drawn(true.mesh, at, shaded(true, true.sky), folder, options)
        photos, masks = photographs(cameras)
        wanted, seen = photographs(others)
        ours, _ = drawn(true.mesh, others, shaded(true, true.sky), folder, options)
        found, hull, about = fit(photos, masks, cameras, folder, options)
        grey = Thing(hull, np.full((4, 4, 3), 0.5), np.full((4, 4, 3), [0.0, 0.5, 0.2]), np.full((32, 64, 3), 0.6))
        before, _ = drawn(hull, others, shaded(grey, grey.sky), folder, options)
        again, alpha = drawn(found.mesh, others, shaded(found, found.sky), folder, options)
        inside = (seen > 0.99) & (alpha > 0.99)
        maps = {}
        for key, of in (("true", true), ("found", found)):
            for what, image in (("color", of.color), ("maps", of.maps)):
                maps[key, what] = drawn(of.mesh, others, Unlit(Texture(image)), folder, options)[0]
        scale = np.array([(maps["true", "color"][inside][:, c] * maps["found", "color"][inside][:, c]).sum()
                          / (maps["found", "color"][inside][:, c] ** 2).sum() for c in range(3)])
        metal = maps["true", "maps"][..., 2] > 0.5
        rough, metals = (np.abs(maps["true", "maps"] - maps["found", "maps"])[..., k] for k in (1, 2))
        clear = told(true, cameras, others, folder, options) > TOLD
        elsewhere = np.clip(np.roll(true.sky[:, ::-1], true.sky.shape[1] // 3, 1)[:, :, ::-1], 0.02, PEAK)
        relit = [drawn(of.mesh, others, shaded(of, elsewhere), folder, options)[0] for of in (
            true, Thing(found.mesh, np.clip(found.color * scale, 0, 1), found.maps, found.sky))]
    surface = metrics.Surface(true.mesh.positions, true.mesh.faces)
    apart = {f"chamfer_{key}": surface.measure(of.positions, of.faces).chamfer for key, of in (("hull", hull), ("found", found.mesh))}
    row = {"photographs": "mitsuba" if theirs else "ours", "size": size, "views": options.views, "steps": options.steps,
           "rounds": options.rounds, **{key: getattr(options, key) for key in ("first", "sky_rate", "white", "even_maps", "guide")},
           "seconds": round(about["seconds"], 1),
           "psnr_start": psnr(before, wanted, seen > -1), "psnr": psnr(again, wanted, seen > -1),
           "psnr_inside": psnr(again, wanted, inside),
           "ours_of_the_truth": psnr(ours, wanted, seen > -1), "ours_of_the_truth_inside": psnr(ours, wanted, inside),
           "iou": float(np.minimum(alpha, seen).sum() / np.maximum(alpha, seen).sum()),
           "color_psnr": psnr(maps["found", "color"] * scale, maps["true", "color"], inside), "scale": scale.round(3).tolist(),
           "roughness": float(rough[inside].mean()), "roughness_told": float(rough[inside & clear].mean()),
           "told": float((inside & clear).sum() / inside.sum()), "metal": float(metals[inside].mean()),
           "roughness_of_metal": float(rough[inside & metal].mean()),
           "metal_of_metal": float(metals[inside & metal].mean()), "metal_of_the_rest": float(metals[inside & ~metal].mean()),
           "relit_psnr": psnr(relit[0], relit[1], inside), **apart}
    print(json.dumps(row, indent=1))
    if options.json:
        options.json.write_text(json.dumps({"device": about["device"], "driver": about["driver"], "python": platform.python_version(),
                                            "load": round(os.getloadavg()[0], 1), **row}, indent=1) + "\n")
    if options.picture:
        k = [0, 2, 4]
        rows = [np.concatenate(list(x[k]), 1) for x in (wanted, again, maps["true", "color"], maps["found", "color"] * scale,
                                                         maps["true", "maps"], maps["found", "maps"], relit[0], relit[1])]
        sheet = np.concatenate([np.concatenate(rows[i:i + 2], 1) for i in range(0, 8, 2)])
        save_png(options.picture, np.clip(sheet, 0, 1) ** (1 / 2.2))


if __name__ == "__main__":
    main()
