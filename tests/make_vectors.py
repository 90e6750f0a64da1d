"""Bundles for other players to replay: `python -m tests.make_vectors` writes tests/vectors/ anew.

Each vector is NAME.dressi and NAME.json: what to set, step and get in order, and the arrays that must come back within
`tolerance`, relative to the largest magnitude of the array or to 1. An array is its values in row-major order and its shape, as
docs/bundle-format.md has it; fp32 values are written so that they come back exact.
"""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np

from dressi_edge import runtime
from dressi_edge.cache.bundle import combine, dumps, version_of
from dressi_edge.cache.layout import Layout
from dressi_edge.cache.profile import Profile
from dressi_edge.compiler import Options, Program, build
from dressi_edge.compiler.graph.autodiff import gradients
from dressi_edge.compiler.graph.functions import (
    apply,
    bincount,
    constant_table,
    dot,
    exclusive_scan,
    lookup,
    mean,
    to_float,
    total,
)
from dressi_edge.compiler.render.atlas import Atlas
from dressi_edge.compiler.render.optimizer import Sgd
from dressi_edge.compiler.render.raster import Softness, rasterized
from dressi_edge.compiler.render.texture import sample_texture
from dressi_edge.compiler.render.topology import Topology

FOLDER = Path(__file__).parent / "vectors"
GLSLANG = "11:12.0.0"  # Debian 12's, which wrote the vectors' SPIR-V; the word in a module that names its maker has no version
PROFILE = "lavapipe"
UNIT = Layout("unit", "float")


def image(vtype, width, height):
    return Layout("image", vtype, width, height)


def ops():
    """Elementwise work on a table of three channels, with a padded last row."""
    p, table = Program(), Layout("table", "vec3", count=13)
    x, scale = p.input("x", table), p.input("scale", UNIT, 0.5)
    p.plan("map", {}, {"y": (apply("sin", x) * scale + 1.0, table)})
    data = np.linspace(-2, 2, 39, dtype=np.float32).reshape(13, 3)
    return p, [("set", "x", data), ("get", "y"), ("set", "scale", np.float32(2.0)), ("get", "y")]


def reduction():
    """A sum and a mean over an image whose sides are no powers of two."""
    p, layout = Program(), image("vec2", 11, 7)
    x = p.input("x", layout)
    p.plan("reduce", {}, {"sum": (total(x), Layout("unit", "vec2")), "mean": (mean(dot(x, x)), UNIT)})
    data = np.random.default_rng(1).uniform(-1, 1, (7, 11, 2)).astype(np.float32)
    return p, [("set", "x", data), ("get", "sum"), ("get", "mean")]


def states():
    """Two phases, states that change places, a counter, an output of a phase, and a part that is prepared once."""
    p, table = Program(), Layout("table", "float", count=6)
    a, t = p.state("a", table, np.arange(6) / 4), p.state("t", Layout("unit", "int"))
    b, rate = p.state("b", table, 1.0), p.input("rate", UNIT, 0.25)
    kept = apply("cos", apply("sin", lookup(p.input("fixed", table, np.arange(6)), np.arange(6)[::-1])))
    p.plan("walk", {"a": b * rate + kept, "b": a * 0.5, "t": apply("add", t, 1)}, {"loss": (total(a * a) + to_float(t), UNIT)})
    p.plan("rest", {"a": a * 0.5}, {}, steps=2)
    p.plan("look", {}, {"doubled": (a * 2.0, table)})
    seen = [("get", name) for name in ("a", "b", "t", "doubled")]
    return p, [*seen, ("step", "walk", 1), ("get", "loss"), *seen, ("step", "walk", 4), ("get", "loss"), *seen,
               ("step", "rest", 3), *seen, ("set", "a", np.ones(6, np.float32)), ("set", "fixed", np.zeros(6, np.float32)),
               ("step", "walk", 2), *seen]


def _quads(distance):
    """Two triangles in three views of an atlas; what is set on them."""
    p, count = Program(), 4
    clip = p.input("clip", Layout("table", "vec4", count=3 * count))
    faces = np.array([(0, 1, 2), (0, 2, 3)])
    softness = Softness(2.0, distance=distance)
    layers = rasterized(clip, Topology(faces, count), Atlas(16, 12, 3, 2), softness, 0.1, faces=distance == "face")
    quad = np.array([(-1.03, -1.11, 1, 2), (1.17, -1.09, 1, 2), (0.93, 1.21, 1.4, 2.5), (-0.71, 1.07, 1.4, 2.5)])
    views = np.concatenate([quad, quad[::-1] * (0.6, 1.3, 1, 1), quad * (-0.9, 0.7, 1, 1)])
    return p, layers, ("set", "clip", views.astype(np.float32))


def silhouette():
    """The silhouette of two triangles in three views of an atlas: draws with depth test and a viewport a cell."""
    p, layers, given = _quads("face")
    p.plan("render", {}, {"covered": (layers.front >= 0, Layout("atlas", "int", 16, 12, 3, 2))})
    return p, [given, ("get", "covered")]


def lists():
    """The soft outline of two triangles in three views: lists made on the device, and draws that take their count from them."""
    p, layers, given = _quads("outline")
    p.plan("render", {}, {"alpha": (layers.silhouette(), Layout("atlas", "float", 16, 12, 3, 2))})
    return p, [given, ("get", "alpha")]


def texture():
    """A texture sampled over its border, by the device's filter: a combined image sampler that repeats."""
    p = Program()
    texels, uv = p.input("texels", image("vec3", 4, 3)), p.input("uv", image("vec2", 6, 5))
    p.plan("sample", {}, {"y": (sample_texture(texels, uv, "repeat", "none"), image("vec3", 6, 5))})
    rng = np.random.default_rng(2)
    return p, [("set", "texels", rng.uniform(0, 1, (3, 4, 3)).astype(np.float32)),
               ("set", "uv", rng.uniform(-1, 2, (5, 6, 2)).astype(np.float32)), ("get", "y")]


def copies():
    """A phase that works on a list of the texels that are sampled, one that works on all of them, and what makes the list anew."""
    p, size, screen = Program(), image("vec3", 8, 6), image("vec2", 5, 4)
    texels, uv = p.state("texels", size, 0.5), p.input("uv", screen)
    y = sample_texture(texels, uv, "repeat", "exact", p.input("covered", image("int", 5, 4), 1), p.state("t", Layout("unit", "int")))
    error = y - p.input("wanted", image("vec3", 5, 4), 0.75)
    loss = mean(dot(error, error))
    t, (g,) = p.values["t"].node, gradients(loss, [texels])
    p.plan("fit", {**Sgd(4.0, 0.5).update(p, "texels", texels, g, t, low=0.0, high=0.7), "t": t + 1}, {}, group="fit")
    p.plan("fit.loss", {}, {"loss": (loss, UNIT)}, dynamic=p.plans[0].dynamic, group="fit")
    p.plan("fade", {"texels": texels * 0.75}, {})
    rng = np.random.default_rng(3)
    given = [("set", "uv", rng.uniform(0.1, 0.6, (4, 5, 2)).astype(np.float32)) for _ in range(2)]
    seen = [("get", name) for name in ("texels", "texels.momentum", "t", "loss")]
    return p, [given[0], ("step", "fit", 3), ("get", "loss"), ("step", "fit", 1), *seen, ("step", "fit", 2), ("step", "fade", 1),
               ("step", "fit", 1), *seen, given[1], ("get", "loss"), ("step", "fit", 2), *seen,
               ("set", "texels", rng.uniform(0, 1, (6, 8, 3)).astype(np.float32)),
               ("set", "covered", np.arange(20, dtype=np.int32).reshape(4, 5) % 2), ("step", "fit", 2), *seen]


def variants():
    """Two variants in one file: five results in one subpass, and in two for devices of four attachments. What `grow` needs is
    prepared by three plans, of which one needs the others."""
    p, layout = Program(), image("float", 6, 5)
    x, s, rate = p.input("x", layout), p.state("s", UNIT, 1.0), p.input("rate", UNIT, 0.5)
    p.plan("grow", {"s": s + mean(apply("sin", x)) * apply("cos", apply("sin", rate))}, {}, steps=2)
    p.plan("map", {}, {f"y{k}": (x * s + float(k), layout) for k in range(5)})
    data = np.linspace(-1, 2, 30, dtype=np.float32).reshape(5, 6)
    return p, [("set", "x", data), ("get", "y0"), ("step", "grow", 2), ("get", "y4"), ("get", "s"),
               ("set", "rate", np.float32(2.0)), ("step", "grow", 1), ("get", "s")]


def subpasses():
    """More images than one stage may sample: two subpasses, the second of which reads the first as input attachment."""
    p, layout = Program(), image("vec2", 5, 3)
    xs = [p.input(f"x{k}", layout, np.full((3, 5, 2), k / 8)) for k in range(20)]
    p.plan("add", {}, {"y": (sum(xs[1:], xs[0]) * 0.5, layout)})
    return p, [("get", "y"), ("set", "x19", np.arange(30, dtype=np.float32).reshape(3, 5, 2)), ("get", "y")]


def half():
    """A target, and gradients on their way from pixels to the entries they name, in 16 bits a channel: numbers between those of
    fp16, and below its normal ones."""
    p, layout, table = Program(), image("vec3", 7, 5), Layout("table", "vec3", count=6)
    entries, index = p.input("entries", table, 0.25), p.input("index", image("int", 7, 5))
    target = p.input("target", layout, np.arange(105).reshape(5, 7, 3) / 99, narrow=True)
    d = lookup(entries, index, constant_table(np.tile([0, 0, 7, 5], (6, 1)))) - target
    g, = gradients(mean(dot(d, d)), [entries])
    p.plan("compare", {}, {"difference": (d, layout), "gradient": (g, table)})
    data = np.random.default_rng(3).normal(size=(5, 7, 3)) * 10.0 ** np.linspace(-8, 1, 105).reshape(5, 7, 3)
    seen = [("get", name) for name in ("target", "difference", "gradient")]
    return p, [("set", "index", (np.arange(35).reshape(5, 7) % 8 - 1).astype(np.int32)), *seen,
               ("set", "target", data.astype(np.float32)), *seen]


def dispatched():
    """Draws and dispatches that read each other: the soft outline again, with lists and tiles, and a texture by the device's filter."""
    p, layers, given = _quads("outline")
    p.plan("render", {}, {"alpha": (layers.silhouette(), Layout("atlas", "float", 16, 12, 3, 2))})
    texels, uv = p.input("texels", image("vec3", 4, 3), 0.5), p.input("uv", image("vec2", 6, 5), 0.25)
    p.plan("sample", {}, {"y": (sample_texture(texels, uv, "repeat", "none"), image("vec3", 6, 5))})
    rng = np.random.default_rng(2)
    return p, [given, ("get", "alpha"), ("set", "texels", rng.uniform(0, 1, (3, 4, 3)).astype(np.float32)),
               ("set", "uv", rng.uniform(-1, 2, (5, 6, 2)).astype(np.float32)), ("get", "y")]


def counted():
    """A dispatch as wide as an image on the device says."""
    p, layout = Program(), image("float", 37, 30)
    x, n = p.input("x", layout), p.input("n", Layout("unit", "int"), 4)
    p.plan("map", {}, {"groups": (apply("add", n, 1), Layout("unit", "int")), "y": (apply("sqrt", x) + 1.0, layout)})
    return p, [("set", "x", np.arange(37 * 30, dtype=np.float32).reshape(30, 37)), ("get", "y"), ("get", "groups")]


def shared():
    """Bins that are cleared and added to, sums of chunks and running sums: workgroups that share memory."""
    p, n, bins = Program(), 1500, 40
    index, table = p.input("index", Layout("table", "int", count=n)), Layout("table", "int", count=bins)
    counts = bincount(index, bins)
    p.plan("count", {}, {"counts": (counts, table), "begins": (exclusive_scan(counts), table),
                         "running": (exclusive_scan(index), Layout("table", "int", count=n))})
    seen = [("get", name) for name in ("counts", "begins", "running")]
    rng = np.random.default_rng(6)
    return p, [step for _ in range(2) for step in (("set", "index", rng.integers(-2, bins + 2, n).astype(np.int32)), *seen)]


def filled():
    """Large images that start as one texel: a state of floats and an input of integers."""
    p, screen, numbers = Program(), image("vec3", 96, 48), image("int", 150, 120)
    a, n = p.state("a", screen, np.broadcast_to([0.25, -2.0, 1e-3], (48, 96, 3))), p.input("n", numbers, -7)
    p.plan("halve", {"a": a * 0.5}, {"sum": (total(a), Layout("unit", "vec3"))})
    p.plan("look", {}, {"mean": (mean(a), Layout("unit", "vec3")), "count": (total(n), Layout("unit", "int"))})
    seen = [("get", "mean"), ("get", "count")]
    return p, [*seen, ("step", "halve", 2), ("get", "sum"), *seen]


def _count(d: dict) -> None:
    """The dispatch over the image goes as far as the one before it says."""
    first, second = d["plans"][0]["stages"]
    assert first["groups"] == [1, 1, 1] and second["groups"] == [5, 4, 1] and not second["wait"]
    second["count"], second["wait"] = first["outputs"][0], True


# what Vulkan lets devices differ by: sin and cos by 2^-11, weights of a filter by 2^-8
TOLERANCE = {"ops": 2e-3, "reduction": 1e-5, "states": 2e-3, "silhouette": 0, "lists": 1e-4,
             "texture": 8e-3, "copies": 1e-4, "variants": 2e-3, "subpasses": 1e-6, "half": 2e-3, "dispatched": 8e-3, "counted": 1e-5,
             "shared": 0, "filled": 1e-5}
VECTORS = {f.__name__: f for f in (ops, reduction, states, silhouette, lists, texture, copies, variants, subpasses, half, dispatched,
                                   counted, shared, filled)}
PROFILES = {"variants": ("limit8", "vulkan_min"), "subpasses": ("vulkan_min",)}  # of the others PROFILE
OPTIONS = {"copies": {"sparse_texels": 1}, "half": {"storage": "half"},  # 1: its texture is too small to be listed otherwise
           "dispatched": {"compute": "all"}, "counted": {"compute": "pixel"}, "shared": {"compute": "ops"}}
CHANGES = {"counted": _count}  # of descriptions, to what the compiler does not write


def compiled(name: str) -> tuple[bytes, list]:
    """The bundle's bytes, and what to do with it."""
    program, steps = VECTORS[name]()
    made = [(built.description, built.blobs) for built in (
        build(program, Profile.load(profile), Options(**{"storage": "float"} | OPTIONS.get(name, {})))
        for profile in PROFILES.get(name, (PROFILE,)))]
    for description, _ in made:
        CHANGES.get(name, lambda d: None)(description)
    return dumps(*(combine(made) if len(made) > 1 else made[0]), version_of([description for description, _ in made])), steps


def same_compiler() -> bool:
    """Whether compiling here must give the bytes of the vectors."""
    told = subprocess.run(["glslangValidator", "--version"], capture_output=True, text=True).stdout
    return f"Version: {GLSLANG}\n" in told


def perform(session, step: tuple):
    """Do one step on a session; the array it gets, or None."""
    what, name, *rest = step
    if what == "set":
        session.set(name, rest[0])
    elif what == "step":
        session.step(rest[0], name)
    else:
        return session.get(name)


def _plain(x) -> dict:
    x = np.asarray(x)
    return {"type": "i4" if x.dtype.kind == "i" else "f4", "shape": list(x.shape), "values": x.ravel().tolist()}


def _array(record: dict) -> np.ndarray:
    return np.array(record["values"], record["type"]).reshape(record["shape"])


def load(name: str) -> tuple[list, list, float]:
    """The steps, what each must give, and the tolerance."""
    record = json.loads((FOLDER / f"{name}.json").read_text())
    steps = [(s["do"], s["name"], *([_array(s["array"])] if s["do"] == "set" else [s["count"]] if s["do"] == "step" else []))
             for s in record["steps"]]
    return steps, [_array(s["array"]) if s["do"] == "get" else None for s in record["steps"]], record["tolerance"]


def write(name: str, device: str) -> int:
    """One vector; the bytes of its files."""
    data, steps = compiled(name)
    path = FOLDER / f"{name}.dressi"
    path.write_bytes(data)
    with runtime.load(path, device) as session:
        record = recorded(session, steps)
    return len(data) + write_record(path.with_suffix(".json"), VECTORS[name].__doc__, TOLERANCE[name], record)


def recorded(session, steps: list) -> list[dict]:
    """The steps done on a session, as they are kept."""
    record = []
    for step in steps:
        found = perform(session, step)
        what, about, *rest = step
        record.append({"do": what, "name": about, **({"count": rest[0]} if what == "step" else
                                                     {"array": _plain(rest[0] if what == "set" else found)})})
    return record


def write_record(path: Path, about: str, tolerance: float, record: list[dict]) -> int:
    """The bytes of the JSON file."""
    lines = ",\n".join("  " + json.dumps(step) for step in record)
    path.write_text(f'{{"about": {json.dumps(about)}, "tolerance": {tolerance}, "steps": [\n{lines}\n]}}\n')
    return path.stat().st_size


def main() -> None:
    FOLDER.mkdir(exist_ok=True)
    for name in VECTORS:
        print(name, write(name, sys.argv[1] if sys.argv[1:] else "llvmpipe"), "bytes")


if __name__ == "__main__":
    main()
