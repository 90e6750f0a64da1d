"""Every face near a pixel: forward, forward and backward, and lists alone, against one loop over all faces a pixel.

    python benchmarks/binned.py [--quick] [--only WORD] [--data DIR] [--device NAME] [--profile NAME] [--json FILE]

meshes   one view of 512x512: the teapot and the bunny of DIR/meshes, and a sphere with bumps of as many faces as the Stanford dragon,
         which is not there; without DIR spheres with bumps of as many faces. `hard`: only faces that cover a pixel, as in the slides;
         `r=2`: soft
682      one view of 256x256, r = 2, all of it, hard and soft
faces, r, size: growth, of spheres with bumps; one thing changes, the others are 20,000 faces, r = 2 and 256x256

forward  positions to picture and alpha, everything, a 3 MB copy to the host included; both: the gradient of a loss of them by the vertices
         from the positions on; lists: boxes and lists of faces by tile alone
twin     the same renderer without lists (`tile=None`), on the 32x32 pixels in the middle of the picture, times the ratio of the areas; of
         more than 30,000 faces every second, third, ... times that: llvmpipe ends loops after 65535 turns
numpy    the same lists by np.repeat, np.bincount, np.cumsum and a stable np.argsort, one thread
cpu      processor milliseconds of all threads of the process; ms: wall; medians
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from step import Meter, bumpy, options_of, rounded, take_turns, write
from step import table as text

from dressi_edge import runtime
from dressi_edge.compiler.graph.functions import constant_table
from dressi_edge.compiler.io.cameras import Camera, orbit
from dressi_edge.compiler.io.mesh import Mesh
from dressi_edge.compiler.io.meshes import load_mesh
from dressi_edge.compiler.render.material import Unlit, Vertex
from dressi_edge.compiler.render.raster import Binned
from dressi_edge.compiler.scene.scene import Scene

CROP = 32
COLUMNS = ("case", "faces", "pairs", "forward_cpu", "both_cpu", "lists_cpu", "forward_ms", "both_ms", "numpy_ms", "twin_cpu", "ratio", "MB")


def sphere_of(faces: int) -> Mesh:
    """About so many faces."""
    n = max(4, round((faces / 2) ** 0.5))
    return bumpy(n, n + 1)


def unit(mesh: Mesh) -> Mesh:
    """In the cube from -1 to 1."""
    p = np.asarray(mesh.positions, float)
    middle = (p.max(0) + p.min(0)) / 2
    return Mesh((p - middle) / np.abs(p - middle).max(), mesh.faces)


def cropped(camera: Camera, side: int) -> Camera:
    """The middle of its picture."""
    return replace(camera, cx=camera.cx - (camera.width - side) / 2, cy=camera.cy - (camera.height - side) / 2, width=side, height=side)


class Case:
    """A mesh in one view by a renderer, opened."""

    def __init__(self, mesh: Mesh, size: int, renderer: Binned, folder: Path, options: argparse.Namespace, crop: int = 0):
        camera = orbit(1, [20.0], 2.7, 40.0, (size, size))[0]
        scene = Scene([cropped(camera, crop) if crop else camera])
        self.p = np.asarray(mesh.positions, float)
        colors = constant_table(0.5 + 0.4 * np.sin(5 * self.p + [0, 1, 2]))
        scene.add(mesh, scene.parameter("x", self.p), Unlit(Vertex(colors)))
        seen = scene.frame(renderer)
        scene.vjp("look", ["x"], color=seen.color, alpha=seen.alpha)
        scene.output("lists", ranges=seen.fragments.lists.ranges, pairs=seen.fragments.lists.pairs)
        path = folder / "case.dressi"
        scene.compile(options.profile, path, cache=False)  # what is measured begins with the positions
        self.session = runtime.load(path, options.device).__enter__()
        shape = self.session.shape("look.color")
        self.session.set("look.color.grad", np.random.default_rng(0).normal(size=shape))
        self.boxes, self.faces = None, len(mesh.faces)

    def meters(self, twin: bool = False) -> dict[str, Meter]:
        def again() -> None:
            self.session.set("x", self.p)

        names = {"forward": "look.color"} if twin else {"forward": "look.color", "both": "look.x.grad", "lists": "lists.ranges"}
        for name in names.values():
            again()
            self.session.get(name)
        return {key: Meter(lambda name=name: self.session.get(name), again) for key, name in names.items()}

    def close(self) -> None:
        self.session.__exit__(None, None, None)


def numpy_lists(p: np.ndarray, faces: np.ndarray, size: int, reach: float, tile: int = 8) -> tuple[np.ndarray, np.ndarray]:
    """Ranges and faces of tiles by NumPy, from the same places on screen."""
    camera = orbit(1, [20.0], 2.7, 40.0, (size, size))[0]
    x, y, z = (camera.world_to_camera @ np.column_stack([p, np.ones(len(p))]).T)[:3]
    screen = np.stack([camera.cx - camera.fx * x / z, camera.cy + camera.fy * y / z], 1)[faces]
    lo = np.clip(np.ceil(screen.min(1) - reach - 0.5), 0, size).astype(int) // tile
    hi = (np.clip(np.floor(screen.max(1) + reach - 0.5) + 1, 0, size).astype(int) + tile - 1) // tile
    wide = np.maximum(hi - lo, 0)
    counts, across = wide.prod(1), size // tile
    face = np.repeat(np.arange(len(faces)), counts)
    k = np.arange(len(face)) - np.repeat(np.cumsum(counts) - counts, counts)
    at = (lo[face, 1] + k // wide[face, 0]) * across + lo[face, 0] + k % wide[face, 0]
    ends = np.cumsum(np.bincount(at, minlength=across ** 2))
    return np.stack([np.append(0, ends[:-1]), ends], 1), face[np.argsort(at, kind="stable")]


def measured(name: str, mesh: Mesh, size: int, renderer: Binned, options: argparse.Namespace, twin: bool = False) -> tuple[dict, dict]:
    with tempfile.TemporaryDirectory(prefix="dressi-binned-") as folder:
        case = Case(mesh, size, renderer, Path(folder), options)
        try:
            meters = case.meters()
            reach = 0.05 if renderer.hard else renderer.r + 0.05
            meters["numpy"] = Meter(lambda: numpy_lists(case.p, mesh.faces, size, reach))
            one = None
            if twin:
                some = -(-len(mesh.faces) // 30_000)
                one = Case(Mesh(mesh.positions, mesh.faces[::some]), size, replace(renderer, tile=None), Path(folder), options, CROP)
                meters["twin"] = one.meters(True)["forward"]
            take_turns(list(meters.values()), options.seconds, 1)
            row = {"case": name, "faces": case.faces, "pairs": int(case.session.get("lists.pairs")),
                   "MB": rounded(case.session.report()["image_bytes"] / 1e6) if "image_bytes" in case.session.report() else ""}
            for key, meter in meters.items():
                row[f"{key}_ms"], row[f"{key}_cpu"] = (rounded(float(np.median(x))) for x in (meter.walls, meter.cpus))
            if one:
                one.close()
                row["twin_cpu"], row["twin_ms"] = (rounded(row[k] * some * (size / CROP) ** 2) for k in ("twin_cpu", "twin_ms"))
                row["ratio"] = rounded(row["twin_cpu"] / row["forward_cpu"])
            return row, case.session.report()
        finally:
            case.close()


def cases(options: argparse.Namespace):
    """(name, mesh, size, renderer, with its twin), made when asked for."""
    hard, soft = Binned(1.0, hard=True), Binned(2.0)
    folder = options.data / "meshes"
    if options.quick:
        yield from (("hard", sphere_of(300), 64, hard, True), ("r=2", sphere_of(300), 64, soft, True))
        return
    for name, faces in (("teapot", 6320), ("bunny", 69451), ("dragon's", 871414)):
        path = folder / f"{name}.obj"
        for kind, renderer in (("hard", hard), ("r=2", soft)):
            if options.only in (case := f"meshes {name} {kind}"):
                yield case, unit(load_mesh(path)) if path.exists() else sphere_of(faces), 512, renderer, True
    sweeps = [("682 hard", 682, 256, hard), ("682 r=2", 682, 256, soft),
              *((f"faces {n}", n, 256, soft) for n in (100, 1000, 10_000, 100_000, 1_000_000)),
              *((f"r {r}", 20_000, 256, Binned(float(r))) for r in (1, 2, 4, 8, 16, 32)),
              *((f"size {n}", 20_000, n, soft) for n in (128, 256, 512, 1024))]
    for case, faces, size, renderer in sweeps:
        if options.only in case:
            yield case, bumpy(31, 12) if faces == 682 else sphere_of(faces), size, renderer, case.startswith("682")


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options = options_of(parser, arguments)
    results, report = [], {}
    for case in cases(options):
        row, report = measured(*case[:4], options, case[4])
        results.append(row)
        print(text([row], COLUMNS), flush=True)
        write(options.json, report, results)
    if not results:
        raise SystemExit(f"no case holds {options.only!r}")
    print(f"\n{report['device']}, {report['driver']}; milliseconds, medians\n")
    print(text(results, COLUMNS))


if __name__ == "__main__":
    main()
