"""Two textured things, one partly hidden by the other, and where both are: from two pictures, by colours and silhouettes.

    python two_objects.py [FOLDER]
"""
import sys

import numpy as np

from dressi_edge import runtime
from dressi_edge.compiler.scene import Adam, F, Outline, Scene, Schedule, Texture, Unlit, Vertex, icosphere, l2, orbit, pear, save_png

PLACES = {"pear": [0.1, 0.0, -0.2], "ball": [0.35, -0.2, 0.6]}
STARTS = {"pear": [0.0, 0.1, -0.3], "ball": [0.25, -0.1, 0.5]}


def main(folder=".", size=96, steps=250):
    """Distance of each thing from its place, at the start and at the end."""
    big, small = pear(128), icosphere(2, 0.4)
    s = Scene(orbit(2, [10, 25], 3.5, 42, (size, size)), background=(0.1, 0.1, 0.15))
    place = {name: s.parameter(name, at) for name, at in STARTS.items()}
    s.add(big, F.constant_table(big.positions) + place["pear"], Unlit(Texture(F.constant(big.texture))), "pear")
    paint = F.constant_table(0.5 + 0.5 * np.sin(8 * small.positions + [0, 2, 4]))
    s.add(small, F.constant_table(small.positions) + place["ball"], Unlit(Vertex(paint)), "ball")
    seen = s.frame(Outline(r=3.0))
    shape = (2, size, size)
    photo, mask = s.input("photo", np.zeros((*shape, 3))), s.input("mask", np.zeros(shape))
    adam = Adam(Schedule(0.02, 0.002, steps, "exponential"))
    s.phase("fit", steps, {name: adam for name in PLACES}, color=l2(seen.color, photo), shape=l2(seen.alpha, mask))
    s.output("look", color=seen.color, alpha=seen.alpha, part=seen.part)
    s.compile("vulkan_min", f"{folder}/two_objects.dressi")

    def off(session):
        return {name: float(np.linalg.norm(session.get(name) - at)) for name, at in PLACES.items()}

    with runtime.load(f"{folder}/two_objects.dressi") as session:
        for name, at in PLACES.items():
            session.set(name, at)
        target, alpha = session.get("look.color"), session.get("look.alpha")
        for name, at in STARTS.items():
            session.set(name, at)
        session.set("photo", target)
        session.set("mask", alpha)
        before, start = session.get("look.color"), off(session)
        session.step(steps)
        rows = [np.concatenate(list(pictures), 1) for pictures in (before, session.get("look.color"), target)]
        save_png(f"{folder}/two_objects.png", np.concatenate(rows, 0))
        return {"start": start, "end": off(session)}


if __name__ == "__main__":
    print(main(*sys.argv[1:2]))
