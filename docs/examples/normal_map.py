"""Detail as a map of normals: a ball of 320 faces looks like one of 5120 with bumps, by a picture of normals found from six views.

    python normal_map.py [FOLDER]
"""
import sys

import numpy as np

from dressi_edge import runtime
from dressi_edge.compiler.scene import PBR, Adam, Light, Mesh, NormalMap, Scene, Schedule, Texture, icosphere, l2, orbit, save_png, sphere

# Lights of three colours from either side: a grey surface says by its colour where it looks.
COLORS = ((2.5, 0.4, 0.4), (0.4, 2.5, 0.4), (0.4, 0.4, 2.5))
LIGHTS = [Light("directional", color, tuple(d + 0.3 * np.roll(axis, 1))) for axis, color in zip(np.eye(3), COLORS) for d in (axis, -axis)]


def bumpy(rings=4):
    """A ball with bumps a twentieth of its radius high."""
    ball = icosphere(rings, 0.8)
    d = ball.positions / 0.8
    height = 0.05 * np.sin(9 * d[:, 0] + 2 * d[:, 1]) * np.sin(9 * d[:, 1]) * np.sin(9 * d[:, 2] + 1)
    return Mesh(ball.positions * (1 + height[:, None]), ball.faces)


def main(folder=".", size=96, steps=200, texels=(144, 96)):
    """PSNR of the pictures, and the median angle between normals of the coarse ball and of the detailed one, before and after."""
    cameras, pictures = orbit(6, [25, -25, 5], 2.8, 40, (size, size)), {}
    for name in ("detailed", "coarse"):
        s, fitted = Scene(cameras), name == "coarse"
        flat = np.full((*texels[::-1], 3), (0.5, 0.5, 1.0))
        bent = NormalMap(Texture(s.parameter("normals", flat, 0.0, 1.0, kind="image"))) if fitted else lambda x: x.normal
        s.add(sphere(162, 0.8) if fitted else bumpy(), material=PBR(0.7, 0.5, 0.0, normal=bent, lights=LIGHTS))
        seen = s.frame()
        if fitted:
            photo = s.input("photo", np.zeros((6, size, size, 3)))
            s.phase("fit", steps, {"normals": Adam(Schedule(0.03, 0.002, steps, "exponential"))}, color=l2(seen.color, photo))
        s.output("look", color=seen.color, mask=seen.mask, normal=seen.of(bent))
        s.compile("vulkan_min", f"{folder}/normal_map.dressi")
        with runtime.load(f"{folder}/normal_map.dressi") as session:
            pictures[name] = {key: session.get(f"look.{key}") for key in ("color", "mask", "normal")}
            if fitted:
                session.set("photo", pictures["detailed"]["color"])
                session.step(steps)
                pictures["after"] = {key: session.get(f"look.{key}") for key in ("color", "mask", "normal")}
    want, result = pictures["detailed"], {}
    for key, found in (("start", pictures["coarse"]), ("end", pictures["after"])):
        both = (want["mask"] > 0) & (found["mask"] > 0)
        cosine = np.clip((want["normal"] * found["normal"]).sum(-1)[both], -1, 1)
        result[key] = {"psnr": float(-10 * np.log10(((found["color"] - want["color"])[both] ** 2).mean())),
                       "degrees": float(np.degrees(np.median(np.arccos(cosine))))}
    rows = [np.concatenate(list(p["color"][:4]), 1) for p in (pictures["coarse"], pictures["after"], want)]
    save_png(f"{folder}/normal_map.png", np.clip(np.concatenate(rows, 0), 0, 1) ** (1 / 2.2))
    return result


if __name__ == "__main__":
    print(main(*sys.argv[1:2]))
