"""Ways to find roughness and metal together with colours and light, one change at a time, on the shape that inverse.py finds.

    python benchmarks/gloss_ways.py [--data DIR] [--ways NAME ...] [--shape FILE.npz] [--size 128] [--quick] [--json FILE]

Thing, photographs and measures are inverse.py's; its plain fit gives the shape (kept in --shape, if that is named: read where it exists).
Then the shape rests, twelve photographs are compared in every step, and light, colours, roughness and metal are found from grey; mean
errors in six photographs that no fit has seen of roughness and metal, and

colours      PSNR, each channel scaled by one number, that of least squares
light        PSNR of the panorama, the peak is 4
"""
from __future__ import annotations

import argparse
import importlib.util
import json
import os
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from inverse import (
    ELEVATIONS,
    PBR,
    PEAK,
    ROOT,
    SIDE,
    Adam,
    Channel,
    Environment,
    F,
    HardSoftRas,
    Mesh,
    Scene,
    Schedule,
    Texture,
    Thing,
    Unlit,
    alike,
    drawn,
    fit,
    l1,
    mitsuba_photographs,
    octahedral,
    orbit,
    panorama,
    psnr,
    session_of,
    shaded,
    thing,
    tint,
    total_variation,
)


@dataclass(frozen=True)
class Way:
    """first: steps in which roughness and metal rest. white: the weight of the light's tint, fading to a hundredth if `fades`. light: a
    map of colours, of grey, of logarithms, or the true one."""

    first: int = 0
    steps: int = 200
    white: float = 0.0
    fades: bool = False
    light: str = "colours"
    light_rate: float = 0.03
    even_maps: float = 0.02
    guide: float = 0.0
    logarithms: bool = False
    ours: bool = False


PLAIN, LATER = Way(), Way(first=100, steps=150)
FADING = replace(LATER, light_rate=0.1, white=0.1, fades=True)
WAYS = {
    "plain": PLAIN,
    "the light is known": replace(PLAIN, light="true"),
    "photographs by ourselves": replace(PLAIN, ours=True),
    "colours compared as log(1 + c)": replace(PLAIN, logarithms=True),
    "total variation of maps 0.1": replace(PLAIN, even_maps=0.1),
    "light white, 0.1": replace(PLAIN, white=0.1),
    "light as logarithms": replace(PLAIN, light="logarithms"),
    "light grey": replace(PLAIN, light="grey"),
    "light at 0.1 a step": replace(PLAIN, light_rate=0.1),
    "light grey, at 0.1": replace(PLAIN, light="grey", light_rate=0.1),
    "light first": LATER,
    "light first, maps guided": replace(LATER, even_maps=0.1, guide=200.0),
    "light first, at 0.1": replace(LATER, light_rate=0.1),
    "light first, at 0.1, white": replace(FADING, fades=False),
    "light first, at 0.1, white fades": FADING,
}


def found_by(way: Way, mesh: Mesh, photos: np.ndarray, cameras, sky: np.ndarray, folder: Path, options) -> tuple[Thing, float]:
    """What a way finds, and its seconds."""
    s, n = Scene(cameras), options.texels
    base = s.parameter("base", np.full((n, n, 3), 0.5), 0.02, 1.0, kind="image")
    rest = s.parameter("maps", np.full((n // 4, n // 4, 3), [0.0, 0.5, 0.2]), 0.02, 1.0, kind="image")
    if way.light in ("grey", "logarithms"):
        start = np.full((SIDE, SIDE, 1 if way.light == "grey" else 3), np.log(0.6))
        log = s.parameter("sky", start, -7.0, float(np.log(PEAK)), kind="image")
        light = F.exp(F.compose(log, log, log) if way.light == "grey" else log)
    else:
        light = s.parameter("sky", octahedral(sky, SIDE) if way.light == "true" else np.full((SIDE, SIDE, 3), 0.6), 0.0, PEAK, kind="image")
    s.add(mesh, None, PBR(Texture(base), Channel(Texture(rest), "y"), Channel(Texture(rest), "z"), environment=Environment(light)))
    seen, photo = s.frame(HardSoftRas(1.0, delta=0.0)), s.input("photo", photos)
    a, b = (F.log(F.maximum(x, 0.0) + 1.0) if way.logarithms else x for x in (seen.color, photo))
    rates = {"base": 0.02, "maps": 0.02, **({} if way.light == "true" else {"sky": way.light_rate})}
    for name, steps in (("first", way.first), ("all", way.steps)):
        if not steps:
            continue
        terms = {"color": l1(a, b), "even": (0.02, total_variation(base)),
                 "even_maps": (way.even_maps, total_variation(rest, mask=alike(base, n // 4, way.guide) if way.guide else None))}
        if way.white:
            terms["white"] = (Schedule(way.white, way.white / 100, way.steps, "exponential") if way.fades else way.white, tint(light))
        s.phase(name, steps, {key: Adam(rate) if name == "first" else Adam(Schedule(rate, rate / 10, steps, "exponential"))
                              for key, rate in rates.items() if name == "all" or key != "maps"}, **terms)
    s.output("found", sky=light)
    with session_of(s, folder, options) as session:
        start = time.perf_counter()
        for name, steps in (("first", way.first), ("all", way.steps)):
            if steps:
                session.step(steps, name)
        base, rest, sky = (np.asarray(session.get(key), float) for key in ("base", "maps", "found.sky"))
        return Thing(mesh, base, rest, panorama(sky.reshape(SIDE, SIDE, 3), 64)), time.perf_counter() - start


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=ROOT.parent / "shared")
    parser.add_argument("--ways", nargs="*", choices=list(WAYS), default=list(WAYS))
    parser.add_argument("--shape", type=Path)
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--samples", type=int, default=128, help="of Mitsuba, a pixel")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--profile", default="lavapipe")
    parser.add_argument("--device")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args(arguments)
    if options.quick:
        options.size, options.samples = 48, 16
    plain = {"vertices": 2562, "texels": 64 if options.quick else 256, "rounds": 1 if options.quick else 3, "steps": 150, "smooth": 1.0,
             "even": 0.02, "even_maps": 0.02, "white": 0.0, "guide": 0.0, "first": 0, "sky_rate": 0.03, "rough": 0.5, "metal": 0.2,
             "maps_rate": 0.02}
    for key, value in plain.items():
        setattr(options, key, value)
    size, true = options.size, thing(options.data, 512)
    cameras = orbit(24, ELEVATIONS, 2.7, 42.0, (size, size))
    others = orbit(6, (10.0, -35.0, 40.0), 2.7, 42.0, (size, size))
    used = [k for k in range(24) if k // 4 % 2 == 0]  # of each elevation every second
    with tempfile.TemporaryDirectory(prefix="dressi-ways-") as name:
        folder = Path(name)
        theirs = importlib.util.find_spec("mitsuba") is not None
        own = drawn(true.mesh, cameras, shaded(true, true.sky), folder, options)
        photos, masks = mitsuba_photographs(true, cameras, options.samples) if theirs else own
        if options.shape and options.shape.is_file():
            stored = np.load(options.shape)
            mesh = Mesh(*(stored[key] for key in ("positions", "faces", "uvs", "uv_faces")))
        else:
            mesh = fit(photos, masks, cameras, folder, options)[0].mesh
            if options.shape:
                np.savez(options.shape, positions=mesh.positions, faces=mesh.faces, uvs=mesh.uvs, uv_faces=mesh.uv_faces)
        (color, alpha), (maps, _) = (drawn(true.mesh, others, Unlit(Texture(x)), folder, options) for x in (true.color, true.maps))
        wanted, rows = panorama(octahedral(true.sky, SIDE), 64), []
        print(f"{'way':34} {'roughness':>9} {'metal':>5} {'colours':>7} {'light':>5} {'s':>4}")
        for name in options.ways:
            way = WAYS[name]
            if options.quick:
                way = replace(way, first=way.first // 50, steps=4)
            pictures, at = (own[0] if way.ours else photos)[used], [cameras[k] for k in used]
            got, seconds = found_by(way, mesh, pictures, at, true.sky, folder, options)
            c, seen = drawn(mesh, others, Unlit(Texture(got.color)), folder, options)
            off = np.abs(drawn(mesh, others, Unlit(Texture(got.maps)), folder, options)[0] - maps)
            inside = (alpha > 0.99) & (seen > 0.99)
            scale = (c * color)[inside].sum(0) / (c ** 2)[inside].sum(0)
            row = {"way": name, "roughness": float(off[inside][:, 1].mean()), "metal": float(off[inside][:, 2].mean()),
                   "colours": psnr(c * scale, color, inside),
                   "light": psnr(got.sky / PEAK, wanted / PEAK, np.ones(wanted.shape[:2], bool)), "seconds": round(seconds, 1)}
            rows.append(row)
            print(f"{name:34} {row['roughness']:9.3f} {row['metal']:5.3f} {row['colours']:7.1f} {row['light']:5.1f} "
                  f"{seconds:4.0f}", flush=True)
            if options.json:
                options.json.write_text(json.dumps({"size": size, "load": round(os.getloadavg()[0], 1), "results": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
