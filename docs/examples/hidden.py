"""What gradients of what is hidden or far away find: a ball behind another is to come to its front, and a ball is to go where its target
is, which it does not overlap. One view; three renderers of the same reach.

    python hidden.py [FOLDER]
"""
import sys

import numpy as np

from dressi_edge import runtime
from dressi_edge.compiler.scene import Adam, Binned, HardSoftRas, Outline, Scene, Unlit, icosphere, l2, orbit, rigid, save_png

BIG, SMALL = icosphere(2, 0.5), icosphere(2, 0.22)
STILL = np.zeros(3)


def fit(folder, name, renderer, size, steps, behind, start, goal):
    """Where the small ball is after `steps`, and pictures of start, end and goal."""
    s = Scene(orbit(1, [0], 3.2, 40, (size, size)), (0.05, 0.1, 0.3))
    shift = s.parameter("shift", start)
    s.add(SMALL, rigid(SMALL.positions, STILL, shift), Unlit((0.2, 0.9, 0.3)))
    if behind:
        s.add(BIG, material=Unlit((0.9, 0.3, 0.2)))
    seen, sharp = s.frame(renderer), s.frame(Outline(r=1.0))
    photo = s.input("photo", np.zeros((1, size, size, 3)))
    s.phase("fit", steps, {"shift": Adam(0.02)}, color=l2(seen.color, photo))
    s.output("look", color=sharp.color)
    s.compile("vulkan_min", f"{folder}/{name}.dressi")
    with runtime.load(f"{folder}/{name}.dressi") as session:
        session.set("shift", goal)
        target = session.get("look.color")
        session.set("shift", start)
        session.set("photo", target)
        before = session.get("look.color")
        session.step(steps)
        return session.get("shift"), [before[0], session.get("look.color")[0], target[0]]


def main(folder=".", size=64, steps=120):
    """How far from the goal, at the start and by renderer at the end: behind, in units of the scene; far, in pixels of the picture."""
    camera = orbit(1, [0], 3.2, 40, (size, size))[0]
    toward = camera.position / 3.2
    right = np.cross([0.0, 1.0, 0.0], toward)
    tasks = {"behind": (-0.8 * toward, 0.7 * toward + 0.1 * right), "far": (-0.35 * right, 0.35 * right + [0.0, 0.2, 0.0])}
    r = {"behind": size / 24, "far": size / 3}
    found, rows = {}, []

    def off(task, x, goal):
        a, b = (camera.world_to_camera @ [*p, 1.0] for p in (x, goal))
        return float(np.linalg.norm(x - goal) if task == "behind" else camera.fx * np.linalg.norm(a[:2] / a[2] - b[:2] / b[2]))

    for task, (start, goal) in tasks.items():
        renderers = {"outline": Outline(r[task]), "K3": HardSoftRas(r[task], 3), "binned": Binned(r[task], gamma=0.02, over=True)}
        found[task] = {"start": off(task, start, goal)}
        for name, renderer in renderers.items():
            end, pictures = fit(folder, f"hidden_{task}_{name}", renderer, size, steps, task == "behind", start, goal)
            found[task][name] = off(task, end, goal)
            rows.append(np.concatenate(pictures, 1))
    save_png(f"{folder}/hidden.png", np.clip(np.concatenate([np.concatenate(rows[k::3], 1) for k in range(3)], 0), 0.0, 1.0))
    return found


if __name__ == "__main__":
    print(main(*sys.argv[1:2]))
