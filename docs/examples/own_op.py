"""An operation of one's own: a smooth step with its GLSL, its reference and its gradient, tested as ours are, in a material.

    python own_op.py [FOLDER]
"""
import sys

import numpy as np

from dressi_edge import runtime
from dressi_edge.compiler.scene import Adam, F, Scene, check_op, icosphere, l2, op, orbit, save_png

fade = op("fade", ref=lambda x: (t := np.clip(x, 0, 1)) * t * (3 - 2 * t),
          glsl="{ {type} t_ = clamp({x}, {type}(0.0), {type}(1.0)); {y} = t_ * t_ * (3.0 - 2.0 * t_); }",
          vjp=lambda g, y, x: (g * F.clamp(x, 0.0, 1.0) * (1.0 - F.clamp(x, 0.0, 1.0)) * 6.0,),
          doc="0 below 0, 1 above 1, smooth between.")


def main(folder=".", size=72, steps=150):
    """Where a ball's colour changes: the height and width of the band, at the start and at the end; they are 0.25 and 0.2."""
    check_op(fade)  # GLSL against the reference on the device, the gradient against central differences
    ball = icosphere(3, 0.8)
    s = Scene(orbit(3, [20, -15], 3.0, 40, (size, size)))
    height, width = s.parameter("height", -0.1), s.parameter("width", 0.5, low=0.02)

    def band(surface):
        t = fade((surface.position.y - height) / width + 0.5)
        return F.compose(t, 0.3, 1.0 - t)

    s.add(ball, material=band)
    seen = s.frame()
    photo = s.input("photo", np.zeros((3, size, size, 3)))
    s.phase("fit", steps, {"height": Adam(0.01), "width": Adam(0.01)}, color=l2(seen.color, photo))
    s.output("look", color=seen.color)
    s.compile("vulkan_min", f"{folder}/own_op.dressi")
    with runtime.load(f"{folder}/own_op.dressi") as session:
        session.set("height", 0.25)
        session.set("width", 0.2)
        target = session.get("look.color")
        session.set("height", -0.1)
        session.set("width", 0.5)
        session.set("photo", target)
        before = session.get("look.color")
        session.step(steps)
        found = {name: float(session.get(name)) for name in ("height", "width")}
        rows = [np.concatenate(list(pictures), 1) for pictures in (before, session.get("look.color"), target)]
    save_png(f"{folder}/own_op.png", np.concatenate(rows, 0))
    return {"start": {"height": -0.1, "width": 0.5}, "end": found}


if __name__ == "__main__":
    print(main(*sys.argv[1:2]))
