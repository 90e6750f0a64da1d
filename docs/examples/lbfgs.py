"""The light of four pictures and the colours under it, by SciPy's L-BFGS: the renderer is one function with a gradient.

    python lbfgs.py [FOLDER]
"""
import sys

import numpy as np
from scipy.optimize import minimize

from dressi_edge import runtime
from dressi_edge.compiler.scene import F, Scene, Vertex, icosphere, orbit, save_png


def main(folder=".", size=72, steps=120):
    """How far off the light (degrees) and the colours (RMS), at the start and at the end, and how often pictures were drawn."""
    ball = icosphere(3, 0.7)
    truth = {"colors": 0.5 + 0.4 * np.sin(6 * ball.positions + [0, 2, 4]), "light": np.array([0.8, 0.5, 0.6])}
    scene = Scene(orbit(4, [20, -15], 3.0, 40, (size, size)))
    colors, light = scene.parameter("colors", truth["colors"]), scene.parameter("light", truth["light"])
    scene.add(ball, material=lambda s: Vertex(colors)(s) * (F.maximum(F.dot(s.normal, light), 0.0) + 0.2))
    scene.vjp("render", list(truth), color=scene.frame().color)
    scene.compile("vulkan_min", f"{folder}/lbfgs.dressi")
    with runtime.load(f"{folder}/lbfgs.dressi") as session:
        target = session.forward("render")["color"]
        start = {"colors": np.full(truth["colors"].shape, 0.5), "light": np.array([0.0, 0.0, 1.0])}

        def split(x):
            return {"colors": x[:-3].reshape(-1, 3), "light": x[-3:]}

        def value(x):
            session.set_all(split(x))
            apart = session.forward("render")["color"].astype(float) - target
            found = session.backward("render", color=2 * apart / apart.size)
            return np.mean(apart ** 2), np.concatenate([found[key].ravel().astype(float) for key in start])

        def seen(x):
            session.set_all(split(x))
            return session.forward("render")["color"]

        def off(x):
            found = split(x)
            a, b = found["light"], truth["light"]
            angle = np.degrees(np.arccos(np.clip(a @ b / np.linalg.norm(a) / np.linalg.norm(b), -1, 1)))
            return {"degrees": float(angle), "colors": float(np.sqrt(np.mean((found["colors"] - truth["colors"]) ** 2)))}

        x = np.concatenate([start[key].ravel() for key in start])
        scale = 1e4  # so that the optimizer's own thresholds are small beside the loss
        found = minimize(lambda x: tuple(scale * y for y in value(x)), x, jac=True, method="L-BFGS-B",
                         options={"maxiter": steps, "maxcor": 20})
        rows = [np.concatenate(list(seen(at)), 1) for at in (x, found.x)] + [np.concatenate(list(target), 1)]
    save_png(f"{folder}/lbfgs.png", np.clip(np.concatenate(rows, 0), 0, 1))
    return {"start": off(x), "end": off(found.x), "draws": found.nfev}


if __name__ == "__main__":
    print(main(*sys.argv[1:2]))
