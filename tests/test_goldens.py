"""What the passes make of a handful of small programs, as text: the graph with its gradients, the stages, the GLSL.

A refactor moves none of it; whoever means to change it runs `pytest tests/test_goldens.py --update-golden` and reads the difference.
"""

from pathlib import Path

import numpy as np
import pytest
from graphs import Graph

from dressi_edge.cache.layout import Layout
from dressi_edge.cache.profile import Profile
from dressi_edge.compiler import Options, Program, build
from dressi_edge.compiler.backend import dump
from dressi_edge.compiler.graph.autodiff import gradients
from dressi_edge.compiler.graph.functions import apply, constant_table, dot, lookup, mean, select, sigmoid, total
from dressi_edge.compiler.graph.ops.compact import compact
from dressi_edge.compiler.render.texture import sample_texture

GOLDENS = Path(__file__).parent / "goldens"
LEVELS = {"graph": ("built",), "stages": ("packed", "placed"), "glsl": ("shaders",)}
UNIT = Layout("unit", "float")


def image(vtype="float", width=12, height=8):
    return Layout("image", vtype, width, height)


def fit():
    """An image drawn to a target by gradient descent, with what its target alone decides computed beforehand."""
    p = Program()
    x, target = p.state("x", image("vec3"), 0.5), p.input("target", image("vec3"))
    wanted = sigmoid(sigmoid(sigmoid(target)))
    loss = mean(dot(sigmoid(x) - wanted, sigmoid(x) - wanted))
    p.plan("fit", {"x": x - gradients(loss, [x])[0] * 0.1}, {}, group="fit", steps=3)
    p.plan("fit.loss", {}, {"fit.loss": (loss, UNIT)}, dynamic=frozenset(["x"]), group="fit")
    return p, "lavapipe", Options()


def guard():
    """Work that an int leaves out, texel by texel."""
    p = Program()
    where, x = p.input("where", image("int")), p.input("x", image())
    y = x
    for _ in range(20):
        y = sigmoid(y * 2.0)
    p.plan("draw", {}, {"y": (select(where, y, 0.0), image())})
    return p, "lavapipe", Options()


def tiles():
    """Work in the tiles that some pixel marks, and a sum back over the pixels that name an entry."""
    p = Program()
    names, entries = p.input("names", image("int", 40, 24)), p.input("entries", Layout("table", "vec3", count=5))
    marked = apply("occupied", names, width=16, height=16)
    place = apply("inside_tiles", names + 1, marked, tile=(16, 16))
    box = constant_table(np.tile([0, 0, 40, 24], (5, 1)))
    near = apply("lookup_near", entries, place, box, constant_table(np.full((5, 4), 16.0)), constant_table(np.zeros((5, 2))), reach=99.0,
                 channel=0)
    shown = select(place > 0, sigmoid(near) * sigmoid(near * 0.25), 0.0)
    p.plan("draw", {}, {"gradient": (gradients(total(dot(shown, shown)), [entries])[0], Layout("table", "vec3", count=5))})
    return p, "lavapipe", Options()


def entries_listed():
    """What is computed for the set entries of a table alone, as far as there are any."""
    p = Program()
    flags, values = p.input("flags", Layout("table", "int", count=90)), p.input("values", Layout("table", "float", count=90))
    found = compact(flags, 1)
    mine = lookup(values, found.entries)
    for _ in range(20):
        mine = sigmoid(mine * 2.0)
    p.plan("draw", {}, {"sum": (total(select(flags, lookup(mine, found.slots), 0.0)), UNIT)})
    return p, "lavapipe", Options()


def texture():
    """A texture of which the phase updates a list of the touched texels."""
    p = Program()
    x, uv, target = p.state("x", image("float", 9, 7), 0.5), p.input("uv", image("vec2")), p.input("target", image())
    loss = mean((sample_texture(x, uv, "repeat") - target) * (sample_texture(x, uv, "repeat") - target))
    p.plan("fit", {"x": x - gradients(loss, [x])[0] * 0.1}, {}, group="fit", steps=3)
    p.plan("look", {}, {"shown": (x * 1.0 + 0.5, image("float", 9, 7))})
    return p, "lavapipe", Options(sparse_texels=1)


def split():
    """More reads and results than a device has room for: several substages, put together as subpasses again."""
    p = Program()
    xs = [p.input(f"x{k}", image("vec4")) for k in range(20)]
    y = xs[0]
    for x in xs[1:]:
        y = sigmoid(y * x + x)
    p.plan("draw", {}, {f"y{k}": (y * float(k + 1), image("vec4")) for k in range(6)})
    return p, "limit4", Options()


@pytest.mark.parametrize("make", [fit, guard, tiles, entries_listed, texture, split], ids=lambda make: make.__name__)
def test_small_programs_become_what_they_became(make, pytestconfig):
    others = [Graph(k).program for k in range(90, 92)]  # what else lives in the process has no say in it
    program, profile, options = make()
    seen = {}
    build(program, Profile.load(profile), options, lambda name, value: seen.update({name: dump.shown(name, value)}))
    assert others
    for level, passes in LEVELS.items():
        path, found = GOLDENS / f"{make.__name__}.{level}", "\n".join(seen[name] for name in passes)
        if pytestconfig.getoption("update_golden"):
            path.write_text(found, encoding="utf-8")
        assert path.read_text(encoding="utf-8") == found, f"{path.name} is not what it was; read the difference, then --update-golden"


def test_every_golden_has_its_program():
    programs = {"fit", "guard", "tiles", "entries_listed", "texture", "split"}
    assert {path.name for path in GOLDENS.iterdir()} == {f"{name}.{level}" for name in programs for level in LEVELS}
