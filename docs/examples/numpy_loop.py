"""Gradients for a loop of one's own: SciPy-like descent in NumPy, with the renderer as one function and its transpose.

    python numpy_loop.py [FOLDER]
"""
import sys

import numpy as np

from dressi_edge import runtime
from dressi_edge.compiler.scene import Scene, Unlit, Vertex, icosphere, orbit, save_png


def main(folder=".", size=72, steps=60):
    """Mean squared difference of the pictures, at the start and at the end."""
    ball = icosphere(3, 0.7)
    truth = 0.5 + 0.4 * np.sin(6 * ball.positions + [0, 2, 4])
    s = Scene(orbit(4, [20, -15], 3.0, 40, (size, size)))
    s.add(ball, material=Unlit(Vertex(s.parameter("colors", truth))))
    s.vjp("render", ["colors"], color=s.frame().color)
    s.compile("vulkan_min", f"{folder}/numpy_loop.dressi")
    with runtime.load(f"{folder}/numpy_loop.dressi") as session:
        target, colors, speed = session.forward("render")["color"], np.full(truth.shape, 0.5), 0.0
        errors, first = [], None
        for _ in range(steps):  # gradient descent with momentum: anything that NumPy can say
            session.set("colors", colors)
            picture = session.forward("render")["color"]
            first = picture if first is None else first
            errors.append(float(np.mean((picture - target) ** 2)))
            gradient = session.backward("render", color=picture - target)["colors"]
            speed = 0.8 * speed - 0.02 * gradient
            colors = colors + speed
    rows = [np.concatenate(list(pictures), 1) for pictures in (first, picture, target)]
    save_png(f"{folder}/numpy_loop.png", np.clip(np.concatenate(rows, 0), 0, 1))
    return {"start": errors[0], "end": errors[-1]}


if __name__ == "__main__":
    print(main(*sys.argv[1:2]))
