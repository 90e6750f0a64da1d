"""What a surface is made of: base colour, roughness and metal as textures, from pictures under six lights; shape and lights are known.

    python material.py [FOLDER]
"""
import sys

import numpy as np

from dressi_edge import runtime
from dressi_edge.compiler.scene import PBR, Adam, Channel, Light, Scene, Schedule, Texture, l2, orbit, save_png, sphere

LIGHTS = [Light("directional", 2.0, d) for d in ((-1, -1, -1), (1, -0.5, -0.6), (0.2, -0.4, 1), (-1, 0.6, 0.3), (1, 1, 0.5), (0, 0.5, -1))]


def main(folder=".", size=96, steps=300, texels=(24, 16)):
    """Mean errors of roughness and metal over the texels that the pictures tell of, at the start and at the end; PSNR of the pictures."""
    ball, (width, height) = sphere(642, 0.8), texels
    y, x = np.mgrid[:height, :width] // 4
    odd = (x + y) % 2
    truth = {"base": np.where(odd[..., None], [0.9, 0.6, 0.3], [0.2, 0.4, 0.7]),
             "rough_metal": np.stack([np.where(x % 2, 0.3, 0.55), np.where(odd, 0.9, 0.1)], -1)}
    start = {"base": np.full(truth["base"].shape, 0.5), "rough_metal": np.full(truth["rough_metal"].shape, 0.5)}
    s = Scene(orbit(9, [25, -25, 0], 3.0, 40, (size, size)))
    base = Texture(s.parameter("base", start["base"], 0.0, 1.0, kind="image"))
    maps = Texture(s.parameter("rough_metal", start["rough_metal"], 0.05, 1.0, kind="image"))
    s.add(ball, material=PBR(base, roughness=Channel(maps, "x"), metallic=Channel(maps, "y"), lights=LIGHTS))
    seen = s.frame()
    photo = s.input("photo", np.zeros((9, size, size, 3)))
    rate = Adam(Schedule(0.05, 0.003, steps, "exponential"))
    s.phase("fit", steps, {"base": rate, "rough_metal": rate}, color=l2(seen.color, photo))
    s.output("look", color=seen.color)
    s.compile("vulkan_min", f"{folder}/material.dressi")
    with runtime.load(f"{folder}/material.dressi") as session:
        for name, value in truth.items():
            session.set(name, value)
        target = session.get("look.color")
        for name, value in start.items():
            session.set(name, value)
        session.set("photo", target)
        before = session.get("look.color")
        session.step(steps)
        found, after = session.get("rough_metal"), session.get("look.color")
    told = (np.abs(found - 0.5) > 0.02).any(-1)  # the poles are hardly seen
    rows = [np.concatenate(list(pictures[:4]), 1) for pictures in (before, after, target)]
    save_png(f"{folder}/material.png", np.clip(np.concatenate(rows, 0), 0, 1) ** (1 / 2.2))
    result = {"psnr": float(-10 * np.log10(((after - target) ** 2).mean())), "texels": float(told.mean())}
    for k, name in enumerate(("roughness", "metal")):
        result[name] = [float(np.abs(a - truth["rough_metal"])[..., k][told].mean()) for a in (start["rough_metal"], found)]
    return result


if __name__ == "__main__":
    print(main(*sys.argv[1:2]))
