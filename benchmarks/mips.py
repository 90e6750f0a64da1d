"""Mip-mapped textures: what they are worth, and what they cost.

    python benchmarks/mips.py [--quick] [--only WORD] [--data DIR] [--device NAME] [--profile NAME] [--json FILE]

error  a fine pattern of 2048x2048 texels (checks of 4 texels, waves of 7, noise) on a plane that goes to the horizon, a ball and Spot
       (where DIR/meshes holds it), one view of 256x256: root mean square difference from 8 x 8 samples a pixel, where all of those hit
step   six views of 256x256 by colours, geometry that stays, Adam, textures of several sizes: bilinear with lists of touched texels,
       bilinear with every texel updated, trilinear with mips
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from step import Meter, options_of, rounded, table, take_turns, views, write
from texture import pattern

from dressi_edge import runtime
from dressi_edge.compiler.io.meshes import Mesh, load_mesh, normalize
from dressi_edge.compiler.scene import Adam, Camera, HardSoftRas, Scene, Texture, Unlit, l2, look_at, orbit, pear, sphere

BY = 8  # samples a pixel and axis of the truth
COLUMNS = ("case", "ms", "least_ms", "cpu_ms", "ratio", "ratio_dense")


def fine(size: int) -> np.ndarray:
    """(size, size, 3) in 0 to 1."""
    y, x = np.mgrid[:size, :size]
    return np.stack([(x // 4 + y // 4) % 2 * 0.8 + 0.1, 0.5 + 0.4 * np.sin(x * 0.9) * np.sin(y * 0.05),
                     np.random.default_rng(0).random((size, size))], -1)


def plane() -> Mesh:
    corners = np.array([[0, 2, 1], [0, 3, 2]])
    return Mesh([[-3.0, 0, -6], [3, 0, -6], [3, 0, 1.5], [-3, 0, 1.5]], corners, [[0.0, 0], [1, 0], [1, 1], [0, 1]], corners)


def drawn(mesh: Mesh, cameras: Sequence[Camera], texture: np.ndarray, mips: bool, options: argparse.Namespace, folder: Path) -> tuple:
    """Colours and mask of the first view, and the session's report."""
    scene = Scene(cameras)
    scene.add(mesh, material=Unlit(Texture(scene.input("texture", texture, kind="image"), mips=mips)))
    seen = scene.frame(HardSoftRas(r=1.0, delta=0.0))
    scene.output("look", color=seen.color, mask=seen.mask)
    scene.compile(options.profile, folder / "look.dressi")
    with runtime.load(folder / "look.dressi", options.device) as session:
        return np.asarray(session.get("look.color"), float)[0], np.asarray(session.get("look.mask"))[0], session.report()


def errors(options: argparse.Namespace, folder: Path) -> tuple[list[dict], dict]:
    size, texels = (64, 256) if options.quick else (256, 2048)
    spot = options.data / "meshes" / "spot" / "spot.obj"
    cases = {"plane": (plane(), lambda n: [look_at([0, 0.6, 2.5], [0, 0, -0.5], [0, 1, 0], 50, n, n)]),
             "ball": (sphere(2562, 1.0), lambda n: orbit(1, [20], 3.0, 40, (n, n)))}
    if spot.is_file():
        cases["Spot"] = normalize(load_mesh(spot)), cases["ball"][1]
    rows = []
    for name, (mesh, cameras) in cases.items():
        texture = fine(texels)
        big, hit, report = drawn(mesh, cameras(size * BY), texture, False, options, folder)
        truth = big.reshape(size, BY, size, BY, 3).mean((1, 3))
        inside = hit.reshape(size, BY, size, BY).min((1, 3)) > 0
        row = {"case": name}
        for key, mips in (("bilinear", False), ("mips", True)):
            found, *_ = drawn(mesh, cameras(size), texture, mips, options, folder)
            row[key] = rounded(np.sqrt(((found - truth)[inside] ** 2).mean()))
        rows.append(row | {"ratio": rounded(row["bilinear"] / row["mips"])})
    return rows, report


def scene_of(mesh: Mesh, cameras: Sequence[Camera], size: int, mips: bool) -> Scene:
    scene = Scene(cameras)
    texture = scene.parameter("texture", pattern(size) * 0.5 + 0.2, 0.0, 1.0, kind="image")
    scene.add(mesh, material=Unlit(Texture(texture, mips=mips)))
    seen = scene.frame(HardSoftRas(r=2.0, delta=0.0))
    photo = scene.input("photo", np.full((len(cameras), *seen.cell[::-1], 3), 0.4))
    scene.phase("fit", 1000, {"texture": Adam(0.01)}, color=l2(seen.color, photo))
    return scene


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options = options_of(parser, arguments)
    spot = options.data / "meshes" / "spot" / "spot.obj"
    mesh, name = (normalize(load_mesh(spot)), "Spot") if spot.is_file() and not options.quick else (pear(96), "the pear")
    cameras = views(6, 64 if options.quick else 256)
    ways = {"bilinear": (False, {"sparse_texels": 1} if options.quick else {}), "dense": (False, {"sparse_texels": None}),
            "mips": (True, {})}
    with tempfile.TemporaryDirectory(prefix="dressi-mips-") as name_of_folder:
        folder, results = Path(name_of_folder), []
        found, report = errors(options, folder) if options.only in "error" else ([], {})
        for size in (64,) if options.quick else (256, 512, 1024, 2048):
            opened = {}
            try:
                for way, (mips, how) in ways.items():
                    case = f"step: {name}, six views, texture {size}, {way}"
                    if options.only in case and options.only != "error":
                        scene_of(mesh, cameras, size, mips).compile(options.profile, folder / "fit.dressi", **how)
                        opened[way] = session = runtime.load(folder / "fit.dressi", options.device)
                        session.step(5)
                meters = {way: Meter(lambda s=session: s.step(1, "fit")) for way, session in opened.items()}
                take_turns(list(meters.values()), options.seconds)
                rows = {way: meter.row for way, meter in meters.items()}
                for way, row in rows.items():
                    base = rows.get("bilinear", row)
                    made = {"case": f"texture {size}, {way}", **row, "ratio": rounded(row["cpu_ms"] / base["cpu_ms"])}
                    if way == "mips" and "dense" in rows:
                        made["ratio_dense"] = rounded(row["cpu_ms"] / rows["dense"]["cpu_ms"])
                    results.append(made)
                    report = opened[way].report()
            finally:
                for session in opened.values():
                    session.close()
    if found:
        print(table(found, ("case", "bilinear", "mips", "ratio")))
    if results:
        print(f"\n{report['device']}, {report['driver']}; {name}, six views; milliseconds, medians\n")
        print(table(results, COLUMNS))
    write(options.json, report, [*found, *results])


if __name__ == "__main__":
    main()
