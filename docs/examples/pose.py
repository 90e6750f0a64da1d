"""The pose of a known object from one picture: 28 degrees and a shift away, coarse to fine.

    python pose.py [FOLDER]
"""
import sys

import numpy as np

from dressi_edge import runtime
from dressi_edge.compiler.scene import (
    Adam,
    F,
    Outline,
    Scene,
    Schedule,
    Texture,
    Unlit,
    l2,
    look_at,
    pear,
    pyramid_l1,
    rigid,
    save_png,
)

TRUTH = np.array([0.2, 0.4, -0.2]), np.array([0.2, -0.1, 0.1])
START = np.array([0.0, 0.01, 0.0]), np.array([-0.1, 0.1, 0.0])


def main(folder=".", size=96, steps=300):
    """How far the pose is off: degrees, and the shift in units of the scene; at the start and at the end."""
    mesh, s = pear(128), Scene([look_at((0, 0.5, 3), (0, 0, 0), (0, 1, 0), 42, size, size)])
    turn, shift = s.parameter("rotation", START[0]), s.parameter("translation", START[1])
    s.add(mesh, rigid(mesh.positions, turn, shift), Unlit(Texture(F.constant(mesh.texture))))
    seen = s.frame(Outline(r=4.0))
    photo, mask = s.input("photo", np.zeros((1, size, size, 3))), s.input("mask", np.zeros((1, size, size)))
    rate = Schedule(0.03, 0.002, steps, "exponential")
    s.phase("fit", steps, {"rotation": Adam(rate), "translation": Adam(rate)},
            color=pyramid_l1(seen.color, photo, 5, seen.cell), shape=l2(seen.alpha, mask))
    s.output("look", color=seen.color, alpha=seen.alpha)
    s.compile("vulkan_min", f"{folder}/pose.dressi")

    def off(session):
        a, b = (matrix(session.get("rotation")), matrix(TRUTH[0]))
        angle = np.degrees(np.arccos(np.clip((np.trace(a.T @ b) - 1) / 2, -1, 1)))
        return {"degrees": angle, "shift": np.linalg.norm(session.get("translation") - TRUTH[1])}

    with runtime.load(f"{folder}/pose.dressi") as session:
        session.set("rotation", TRUTH[0])
        session.set("translation", TRUTH[1])
        target, alpha = session.get("look.color"), session.get("look.alpha")
        session.set("rotation", START[0])
        session.set("translation", START[1])
        session.set("photo", target)
        session.set("mask", alpha)
        before, start = session.get("look.color"), off(session)
        session.step(steps)
        save_png(f"{folder}/pose.png", np.concatenate([before[0], session.get("look.color")[0], target[0]], 1))
        return {"start": start, "end": off(session)}


def matrix(turn):
    """The rotation matrix of a rotation vector."""
    angle = np.linalg.norm(turn)
    x, y, z = turn / angle
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


if __name__ == "__main__":
    print(main(*sys.argv[1:2]))
