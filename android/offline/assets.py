"""The sample's assets: a pear to be made of a sphere, and other pictures of it for "Other pictures". `assets.py FOLDER [SIZE] [PROFILE..]`.

In: the side of the pictures in pixels (64), and the profiles to compile for, widest first. Out: FOLDER/pear.dressi, FOLDER/pear/K.png, and
their sizes on stdout. Needs the compiler and a Vulkan device, which draws the pictures.
"""
from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

from dressi_edge import runtime
from dressi_edge.compiler.io.shapes import pear
from dressi_edge.compiler.io.writers import save_png
from dressi_edge.compiler.scene import demo

PROFILES = ("android_baseline_2022", "vulkan_min")
SHAPE_STEPS, TEXTURE_STEPS = 400, 200


def make(folder: Path, size: int = 64, profiles: tuple[str, ...] = PROFILES) -> list[Path]:
    """The files made."""
    cameras = demo.cameras(size)
    (folder / "pear").mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "target.dressi"
        demo.picture(pear(), cameras).compile("vulkan_min", path)
        with runtime.load(path) as session:
            images = np.clip(session.get("render.color"), 0.0, 1.0)
    made = [folder / "pear.dressi"]
    problem = demo.reconstruction(images, cameras, SHAPE_STEPS, TEXTURE_STEPS)
    problem.compile(list(profiles) if len(profiles) > 1 else profiles[0], made[0])
    for k, image in enumerate(images):
        made.append(folder / "pear" / f"{k}.png")
        save_png(made[-1], image[..., [2, 1, 0, 3]])  # a blue pear
    return made


if __name__ == "__main__":
    target, size, *names = [*sys.argv[1:], *("64",)[len(sys.argv) - 2:]]
    for file in make(Path(target), int(size), tuple(names) or PROFILES):
        print(file, file.stat().st_size, "bytes")
