"""Where a surface shines: the gloss of a Blinn-Phong material as a texture, from pictures under three lights; the shape is known.

    python gloss.py [FOLDER]
"""
import sys

import numpy as np

from dressi_edge import runtime
from dressi_edge.compiler.scene import Adam, BlinnPhong, F, Light, Scene, Schedule, Texture, l2, orbit, save_png, sphere

LIGHTS = [Light("directional", 2.0, d) for d in ((-1, -1, -1), (1, -0.5, -0.6), (0.2, -0.4, 1.0))] + [Light("ambient", 0.3)]


def main(folder=".", size=96, steps=300, texels=(48, 32)):
    """Relative error of the gloss (its median over the texels that pixels with a highlight show), at the start and at the end."""
    ball, (width, height) = sphere(642, 0.8), texels
    y, x = np.mgrid[:height, :width]
    truth = np.where((x // 8 + y // 8) % 2, 40.0, 10.0)
    s = Scene(orbit(6, [20, -25], 3.0, 40, (size, size)))
    gloss = s.parameter("log_gloss", np.full((height, width), np.log(20.0)), low=0.0, high=6.0, kind="image")
    shine = Texture(gloss)
    s.add(ball, material=BlinnPhong((0.3, 0.25, 0.2), 0.6, lambda surface: F.apply("exp", shine(surface)), LIGHTS))
    seen = s.frame()
    photo = s.input("photo", np.zeros((6, size, size, 3)))
    s.phase("fit", steps, {"log_gloss": Adam(Schedule(0.1, 0.01, steps, "exponential"))}, color=l2(seen.color, photo))
    s.output("look", color=seen.color)
    s.compile("vulkan_min", f"{folder}/gloss.dressi")
    with runtime.load(f"{folder}/gloss.dressi") as session:
        session.set("log_gloss", np.log(truth))
        target = session.get("look.color")
        session.set("log_gloss", np.full(truth.shape, np.log(20.0)))
        session.set("photo", target)
        before = session.get("look.color")
        session.step(steps)
        found, after = np.exp(session.get("log_gloss")), session.get("look.color")
    moved = np.abs(np.log(found / 20.0)) > 0.05  # a texel that no highlight touches says nothing of its gloss
    rows = [np.concatenate(list(pictures[:3]), 1) for pictures in (before, after, target)]
    save_png(f"{folder}/gloss.png", np.clip(np.concatenate(rows, 0), 0, 1))
    error = {name: float(np.median(np.abs(g - truth)[moved] / truth[moved])) for name, g in (("start", 20.0), ("end", found))}
    return {**error, "texels": float(moved.mean())}


if __name__ == "__main__":
    print(main(*sys.argv[1:2]))
