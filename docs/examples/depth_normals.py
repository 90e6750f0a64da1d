"""A shape from depth and normals, as a scanner gives them: a sphere becomes a bumpy ball that three views saw, and no silhouette is used.

    python depth_normals.py [FOLDER]
"""
import sys

import numpy as np

from dressi_edge import runtime
from dressi_edge.compiler.scene import Adam, Scene, Schedule, depth_loss, icosphere, normal_loss, orbit, save_png, uniform_laplacian


def main(folder=".", size=96, steps=250):
    """Root mean square error of the depth where something is seen, at the start and at the end."""
    ball = icosphere(3, 0.7)
    p = ball.positions
    bumpy = p * (1 + 0.12 * np.sin(7 * p[:, :1]) * np.cos(6 * p[:, 1:2]))
    s = Scene(orbit(3, [20, -15], 3.0, 36, (size, size)))
    x = s.parameter("vertices", p)
    part = s.add(ball, x)
    seen = s.frame()
    depth, normal = s.input("depth", np.zeros((3, size, size))), s.input("normal", np.zeros((3, size, size, 3)))
    s.phase("fit", steps, {"vertices": Adam(Schedule(0.004, 0.0004, steps, "exponential"))},
            depth=depth_loss(seen.depth, depth), normal=(0.02, normal_loss(seen.normal, normal)),
            smooth=(0.01, uniform_laplacian(x, part.topology, 2)))
    s.output("look", depth=seen.depth, normal=seen.normal)
    s.compile("vulkan_min", f"{folder}/depth_normals.dressi")
    with runtime.load(f"{folder}/depth_normals.dressi") as session:
        session.set("vertices", bumpy)
        target = {key: session.get(f"look.{key}") for key in ("depth", "normal")}
        session.set("vertices", p)
        for key, image in target.items():
            session.set(key, image)
        before = session.get("look.depth"), session.get("look.normal")
        session.step(steps)
        after = session.get("look.depth"), session.get("look.normal")
    rows = [np.concatenate(list(pictures), 1) for pictures in (before[1], after[1], target["normal"])]
    save_png(f"{folder}/depth_normals.png", np.concatenate(rows, 0) * 0.5 + 0.5)

    def error(found):
        both = (found > 0) & (target["depth"] > 0)
        return float(np.sqrt(np.mean((found - target["depth"])[both] ** 2)))
    return {"start": error(before[0]), "end": error(after[0])}


if __name__ == "__main__":
    print(main(*sys.argv[1:2]))
