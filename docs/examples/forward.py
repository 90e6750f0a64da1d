"""A plain renderer: any mesh from many cameras at 512 x 512, lit, over a picture; no gradient is computed, and none is in the bundle.

    python forward.py [FOLDER] [MESH]
"""
import sys

import numpy as np

from dressi_edge import runtime
from dressi_edge.compiler.scene import BlinnPhong, F, Light, Outline, Scene, Texture, encode_srgb, load_mesh, orbit, pear, save_png

LIGHTS = [Light("directional", 2.5, (-0.6, -0.8, -0.5)), Light("ambient", 0.25)]


def main(folder=".", mesh=None, size=512, views=8):
    """How much of the pictures the mesh covers, and the depths that are seen."""
    mesh = pear(256) if mesh is None else load_mesh(mesh)
    y, x = np.mgrid[:size, :size] / size
    sky = np.stack([0.35 + 0.2 * y, 0.5 + 0.2 * y, 0.8 - 0.1 * y], -1)
    s = Scene(orbit(views, [15, -10], 2.6, 45, (size, size)), background=np.broadcast_to(sky, (views, size, size, 3)), encode=encode_srgb)
    color = (0.6, 0.6, 0.6) if mesh.texture is None else Texture(F.constant(((mesh.texture + 0.055) / 1.055) ** 2.4))
    s.add(mesh, material=BlinnPhong(color, 0.25, 40.0, LIGHTS))
    seen = s.frame(Outline(r=1.0))  # edges as wide as a pixel
    s.output("look", color=seen.color, mask=seen.mask, depth=seen.depth)
    s.compile("vulkan_min", f"{folder}/forward.dressi")
    with runtime.load(f"{folder}/forward.dressi") as session:
        color, mask, depth = (session.get(f"look.{key}") for key in ("color", "mask", "depth"))
    save_png(f"{folder}/forward.png", np.concatenate(list(color[:4]), 1)[::2, ::2])
    return {"covered": float(mask.mean()), "nearest": float(depth[mask > 0].min()), "furthest": float(depth.max())}


if __name__ == "__main__":
    print(main(*sys.argv[1:3]))
