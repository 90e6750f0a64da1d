"""A little scene with gradients for tests of bridges: colours and silhouettes of a ball by its vertices, colours and a shade."""
import re
from pathlib import Path

import numpy as np

from dressi_edge.compiler.scene import Outline, Scene, Vertex, icosphere, orbit

SHAPES = {"vertices": (42, 3), "colors": (42, 3), "shade": (3,), "color": (2, 12, 16, 3), "alpha": (2, 12, 16)}
MARKS = (("dressi_edge.torch", "torch"), ("accumulate", "torch"), ("dressi_edge.jax", "jax"))  # of the page's code, and what it needs


def ball_scene(level=1, size=(16, 12), **outline):
    """The scene, its vjp called "render": color, alpha by vertices, colors; "shade" is an input, 1 to begin with."""
    ball, s = icosphere(level, 0.6), Scene(orbit(2, [20, -15], 3.0, 40, size))
    x = s.parameter("vertices", ball.positions)
    colors = s.parameter("colors", 0.5 + 0.4 * np.sin(6 * ball.positions + [0, 2, 4]))
    shade = s.input("shade", np.ones(3))
    s.add(ball, x, lambda p: Vertex(colors)(p) * shade)
    seen = s.frame(Outline(r=2.0, **outline))
    s.vjp("render", ["vertices", "colors"], color=seen.color, alpha=seen.alpha)
    return s


def arrays(seed, kind=np.float32):
    """Some values for its parameters, and a gradient by each picture."""
    rng = np.random.default_rng(seed)
    given = {"vertices": icosphere(1, 0.6).positions + rng.normal(scale=0.02, size=(42, 3)), "colors": rng.uniform(size=(42, 3))}
    gradients = {key: rng.normal(size=SHAPES[key]) for key in ("color", "alpha")}
    return {k: x.astype(kind) for k, x in given.items()}, {k: x.astype(kind) for k, x in gradients.items()}


def run_page(*frameworks):
    """The code of docs/bridges.md in order, but for that of frameworks other than these; how many blocks ran."""
    page = (Path(__file__).resolve().parents[1] / "docs" / "bridges.md").read_text(encoding="utf-8")
    names, ran = {}, 0
    for block in re.findall(r"```python\n(.*?)```", page, re.S):
        needs = {name for mark, name in MARKS if mark in block}
        if needs <= {*frameworks}:
            exec(compile(block, "bridges.md", "exec"), names)
            ran += 1
    names["session"].close()
    return ran
