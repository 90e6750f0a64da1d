"""An optimizer of one's own in ten lines: RMSProp, beside Adam on the same shape.

    python own_optimizer.py [FOLDER]
"""
import sys
from dataclasses import dataclass

import numpy as np

from dressi_edge import runtime
from dressi_edge.compiler.scene import Adam, F, Scene, icosphere, l2, limited, orbit, save_png, state, uniform_laplacian


@dataclass(frozen=True)
class RmsProp:
    """x - rate g / (sqrt(v) + 1e-8), v the running mean of g^2 (Hinton's lecture 6e)."""

    rate: float
    decay: float = 0.9

    def update(self, program, name, parameter, gradient, step, *, low=None, high=None, mask=None):
        g = gradient if mask is None else gradient * mask
        key = f"{name}.rms"
        v = state(program, key, name) * self.decay + g * g * (1.0 - self.decay)
        return {name: limited(parameter - g * self.rate / (F.sqrt(v) + 1e-8), low, high), key: v}


def main(folder=".", size=72, steps=150):
    """The silhouettes' loss at the start, and after as many steps of each."""
    ball = icosphere(3, 0.6)
    egg = ball.positions * [1.0, 1.3, 0.9]
    losses, pictures = {}, []
    for name, optimizer in (("rmsprop", RmsProp(0.003)), ("adam", Adam(0.003))):
        s = Scene(orbit(4, [20, -15], 3.0, 40, (size, size)))
        x = s.parameter("vertices", ball.positions)
        part = s.add(ball, x)
        seen = s.frame()
        mask = s.input("mask", np.zeros((4, size, size)))
        s.phase("fit", steps, {"vertices": optimizer}, silhouette=l2(seen.alpha, mask),
                smooth=(10.0, uniform_laplacian(x, part.topology, 2)))
        s.output("look", alpha=seen.alpha)
        s.compile("vulkan_min", f"{folder}/own_optimizer.dressi")
        with runtime.load(f"{folder}/own_optimizer.dressi") as session:
            session.set("vertices", egg)
            target = session.get("look.alpha")
            session.set("vertices", ball.positions)
            session.set("mask", target)
            losses.setdefault("start", float(session.get("fit.silhouette")))
            session.step(steps)
            losses[name] = float(session.get("fit.silhouette"))
            pictures.append(session.get("look.alpha"))
    rows = [np.concatenate(list(row), 1) for row in (*pictures, target)]
    save_png(f"{folder}/own_optimizer.png", np.repeat(np.concatenate(rows, 0)[..., None], 3, -1))
    return losses


if __name__ == "__main__":
    print(main(*sys.argv[1:2]))
