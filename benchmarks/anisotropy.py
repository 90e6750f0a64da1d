"""Whether several trilinear probes along the longer axis of a pixel's ellipse on the texture earn their price.

    python benchmarks/anisotropy.py [--quick] [--device NAME] [--profile NAME] [--json FILE]

look  a fine pattern of 2048x2048 texels (checks of 4 texels, waves of 7, noise) at 256x256 pixels, on a plane that goes to the horizon,
      a ball and Spot: root mean square difference from 8 x 8 samples a pixel
fit   a picture of 256x256 texels on a plane that six cameras see at a slant, found from photographs with 8 x 8 samples a pixel by Adam:
      PSNR of the texels that are seen, of a seventh view that was not, and processor time of a step

N probes stand evenly along the longer axis, each at the level of detail of its share of the ellipse; 1 is `Texture(mips=True)`.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
from mips import BY, fine, plane
from step import Meter, options_of, rounded, table, take_turns, write

from dressi_edge import runtime
from dressi_edge.compiler.graph.ir import Node
from dressi_edge.compiler.io.meshes import load_mesh, normalize
from dressi_edge.compiler.scene import Adam, HardSoftRas, Scene, Texture, Unlit, l2, look_at, orbit, sphere

WAYS = {"bilinear": 0, "mips": 1, "2 probes": 2, "4 probes": 4, "8 probes": 8}


def scene_of(mesh, cameras, image, count: int) -> tuple[Scene, Node, object]:
    scene = Scene(cameras)
    texture = image(scene)
    scene.add(mesh, material=Unlit(Texture(texture, mips=count > 0, anisotropy=max(1, count))))
    return scene, texture, scene.frame(HardSoftRas(r=1.0, delta=0.0))


def drawn(mesh, cameras, texture: np.ndarray, count: int, options, folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Colours (views, h, w, 3) and masks."""
    scene, _, seen = scene_of(mesh, cameras, lambda scene: scene.input("texture", texture, kind="image"), count)
    scene.output("look", color=seen.color, mask=seen.mask)
    scene.compile(options.profile, folder / "look.dressi")
    with runtime.load(folder / "look.dressi", options.device) as session:
        return np.asarray(session.get("look.color"), float), np.asarray(session.get("look.mask"))


def truth(mesh, cameras, texture: np.ndarray, options, folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Means of BY x BY samples a pixel (views, h, w, 3), and where all of them hit; each camera is a function of how many times larger."""
    colors, hits = [], []
    for camera in cameras:
        big, hit = drawn(mesh, [camera(BY)], texture, 0, options, folder)
        n, h, w, _ = big.shape
        colors.append(big.reshape(n, h // BY, BY, w // BY, BY, 3).mean((2, 4)))
        hits.append(hit.reshape(n, h // BY, BY, w // BY, BY).min((2, 4)) > 0)
    return np.concatenate(colors), np.concatenate(hits)


def looks(options, folder: Path) -> list[dict]:
    size, texels = (64, 256) if options.quick else (256, 2048)
    spot = options.data / "meshes" / "spot" / "spot.obj"
    ball = lambda by: orbit(1, [20], 3.0, 40, (size * by, size * by))[0]  # noqa: E731
    cases = {"plane": (plane(), lambda by: look_at([0, 0.6, 2.5], [0, 0, -0.5], [0, 1, 0], 50, size * by, size * by)),
             "ball": (sphere(2562, 1.0), ball)}
    if spot.is_file():
        cases["Spot"] = normalize(load_mesh(spot)), ball
    rows = []
    for name, (mesh, camera) in cases.items():
        texture = fine(texels)
        wanted, inside = truth(mesh, [camera], texture, options, folder)
        found = {way: drawn(mesh, [camera(1)], texture, n, options, folder)[0] - wanted for way, n in WAYS.items()}
        rows.append({"case": name, **{way: rounded(np.sqrt((x[inside] ** 2).mean())) for way, x in found.items()}})
    return rows


def picture(size: int) -> np.ndarray:
    """(size, size, 3): patches, lines and smooth shades."""
    y, x = np.mgrid[:size, :size] / size
    rng = np.random.default_rng(1)
    patches = np.kron(rng.random((size // 8, size // 8, 3)), np.ones((8, 8, 1)))
    lines = ((x * 32 % 1 < 0.12) | (y * 32 % 1 < 0.12))[..., None]
    return np.clip(0.15 + 0.7 * np.where(lines, 0.1, 0.5 * patches + 0.25 * (1 + np.sin(x * 20) * np.sin(y * 14))[..., None]), 0, 1)


def psnr(a, b) -> float:
    return rounded(-10 * np.log10(np.mean((a - b) ** 2)))


def fits(options, folder: Path) -> list[dict]:
    size, texels, steps = (48, 64, 20) if options.quick else (160, 256, 150)
    mesh, wanted = plane(), picture(texels)

    def camera(angle: float, height: float):
        eye = [2.6 * np.sin(angle), height, -2.2 + 4.6 * np.cos(angle)]
        return lambda by: look_at(eye, [0, 0, -2.2], [0, 1, 0], 50, size * by, size * by)
    cameras = [camera(k * np.pi / 3, 0.9) for k in range(6)]
    photos, inside = truth(mesh, cameras, wanted, options, folder)
    other, where = truth(mesh, [camera(0.5, 1.1)], wanted, options, folder)
    rows, opened = [], {}
    try:
        for way, n in WAYS.items():
            scene, texture, seen = scene_of(mesh, [c(1) for c in cameras], lambda scene: scene.parameter(
                "texture", np.full_like(wanted, 0.5), 0.0, 1.0, kind="image"), n)
            photo, mask = scene.input("photo", photos), scene.input("inside", inside.astype(np.float32))
            scene.phase("fit", steps, {"texture": Adam(0.03)}, color=l2(seen.color, photo, mask=mask))
            path = folder / f"{n}.dressi"
            scene.compile(options.profile, path)
            opened[way] = runtime.load(path, options.device)
            opened[way].step(steps)
        meters = {way: Meter(lambda s=session: s.step(1, "fit")) for way, session in opened.items()}
        found = {way: np.asarray(session.get("texture"), float) for way, session in opened.items()}
        take_turns(list(meters.values()), options.seconds)
        base = meters["mips"].row["cpu_ms"]
        changed = np.any(abs(found["8 probes"] - 0.5) > 1e-6, -1)
        for way, n in WAYS.items():
            view = drawn(mesh, [camera(0.5, 1.1)(1)], found[way], n, options, folder)[0]
            sharp = truth(mesh, [camera(0.5, 1.1)], found[way], options, folder)[0]
            rows.append({"case": way, "texture": psnr(found[way][changed], wanted[changed]), "unseen": psnr(view[where], other[where]),
                         "unseen, 64 samples": psnr(sharp[where], other[where]), "step": rounded(meters[way].row["cpu_ms"] / base)})
        report = opened["mips"].report()
    finally:
        for session in opened.values():
            session.close()
    return rows, report


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options = options_of(parser, arguments)
    with tempfile.TemporaryDirectory(prefix="dressi-anisotropy-") as name:
        seen = looks(options, Path(name))
        print(table(seen, ("case", *WAYS)), flush=True)
        found, report = fits(options, Path(name))
    print(table(found, ("case", "texture", "unseen", "unseen, 64 samples", "step")))
    write(options.json, report, [*seen, *found])


if __name__ == "__main__":
    main()
