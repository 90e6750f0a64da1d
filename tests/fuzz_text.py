"""Damage the texts that people write and read them: `python tests/fuzz_text.py [MUTATIONS [SEED]]`, or `make fuzz-text`.

Kinds: jobs (TOML), transforms JSON, cameras of glTF, profiles. Nothing but an InputError of one printable line may come out, and notes
that are one too. What is still accepted goes on: a start is judged, and now and then a problem is built.
"""

import copy
import json
import random
import re
import sys
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np
from fuzz_bundle import mutate_bytes, places
from jobs import TINY, write_job

from dressi_edge.cache.errors import InputError, InputWarning
from dressi_edge.cache.profile import Profile, profile_names
from dressi_edge.cache.profile_check import check
from dressi_edge.compiler.io.shapes import icosphere
from dressi_edge.compiler.io.views import load_gltf_views, load_views
from dressi_edge.compiler.scene import job, sense

SECONDS = 20.0  # for one text, on a machine that does other things too
LONGEST = 2000
BUILT = 40  # one in so many jobs becomes a problem
DEEP = "@deep@"  # in JSON: a list as deep as a reader may not go
NUMBERS = (-1, 0, 1, 2, 3, 7, 0.5, -0.0, 1e-320, 1e-39, 1e38, 1e39, 1e308, 10 ** 18, 2 ** 31, 2 ** 63, 10 ** 40, 10 ** 400, float("nan"),
           float("inf"), -float("inf"))
ODD = (*NUMBERS, None, True, False, "", "a", "\0", "a\0b", "\n", "\ud800", "x" * 300, "../" * 50, "\N{RIGHT-TO-LEFT OVERRIDE}", "1e5",
       [], {}, [[]], [0] * 3, [[0] * 4] * 4, {"a": 1}, DEEP)
TOML = ("nan", "-inf", "1e400", "-0.0", "9" * 400, "9" * 5000, "0x7fffffffffffffffff", "1979-05-27", "07:32:00", "true", '""',
        '"\\u0000"', '"' + "n" * 3000 + '"', "''", "[" * 40 + "]" * 40, "[" * 2000, "{}", "[]", "[1, 2]",
        "{a = 1}", "'''\n'''", "\ufeff", "\0", "=", "[[", "5")
MORE = """
[render]
shading = "lambert"
background = [0.0, 0.5, 1.0]
texture_size = [8, 8]
[[light]]
kind = "point"
vector = [0, 2, 2]
power = 30
[[phase]]
name = "p"
steps = 3
r_fraction = 0.1
layers = 2
optimize.texture = {rate = {start = 0.1, end = 0.01, kind = "linear", warmup = 1}}
optimize."light0.power" = {optimizer = "sgd", rate = {values = [1.0, 0.5], at = [2]}, nesterov = true, momentum = 0.9}
[[phase.loss]]
kind = "color"
weight = {start = 1.0, end = 0.1}
"""
PARTS = """
[[part]]
name = "ball"
sphere = {vertices = 42, radius = 0.4}
translation = [0.1, 0.0, 0.0]
[part.material]
kind = "blinn_phong"
color = [0.5, 0.4, 0.3]
gloss = 9.0
[[part]]
name = "small"
sphere = {vertices = 12, radius = 0.2}
rotation = [0.1, 0.2, 0.3]
scale = 0.9
material.texture_size = [8, 4]
[views]
transforms = "photos"
masks = "photos"
backdrop = {color = [0.0, 0.1, 1.0], within = 0.2}
alpha = "premultiplied"
size = 20
missing = "skip"
order = "shuffle"
[[light]]
kind = "directional"
vector = [0, -1, 0]
power = [1, 2, 3]
[[phase]]
name = "p"
steps = 2
optimize.ball.rotation = {rate = 0.1}
optimize.small.texture = {rate = 0.1}
optimize."camera.translation" = {rate = 1e-3}
[[phase.loss]]
kind = "color"
norm = "huber"
[[phase.loss]]
kind = "edge_length"
part = "ball"
"""
GLTF = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
        "nodes": [{"children": [1, 2], "scale": [2, 2, 2], "translation": [0, 0, 1]},
                  {"camera": 0, "name": "0", "translation": [0, 0, 1], "rotation": [0, 0, 0, 1]},
                  {"camera": 0, "name": "1", "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 2, 1]}],
        "cameras": [{"type": "perspective", "perspective": {"yfov": 0.8, "znear": 0.1, "zfar": 9, "aspectRatio": 1.0}}]}


def mutate_document(d, r: random.Random) -> str:
    """The JSON of a document with some of its fields replaced, removed, doubled or moved."""
    d = copy.deepcopy(d)
    for _ in range(r.choice((1, 1, 1, 2, 3))):
        found = places(d, [])
        if not found:
            break
        x, key = r.choice(found)
        kind = r.randrange(9)
        if kind > 6 and type(x[key]) in (int, float):
            x[key] = x[key] * r.choice((-1, 0.5, 1.0001, 2)) + r.choice((0, 0, 1))
        elif kind < 3:
            x[key] = copy.deepcopy(r.choice(ODD))
        elif kind == 3:
            other, k = r.choice(found)
            x[key] = copy.deepcopy(other[k])
        elif kind == 4:
            del x[key]
        elif isinstance(x, list):
            x.insert(r.randrange(len(x) + 1), copy.deepcopy(x[key]))
        else:
            x[r.choice(("", "k1", "camera_model", "fl_x", "x" * 400, str(key) + "s", "\ud800", "is_fisheye"))] = copy.deepcopy(x[key])
    depth = r.choice((20, 60, 3000))
    return json.dumps(d).replace(f'"{DEEP}"', "[" * depth + "]" * depth)


def mutate_toml(text: str, r: random.Random) -> str:
    """The text with some of its words replaced by others of its own, or by odd ones."""
    for _ in range(r.choice((1, 1, 2, 3))):
        words = list(re.finditer(r'"[^"\n]*"|[\w.+-]+|[\[\]{}=,]', text))
        if not words:
            break
        at, other = r.choice(words), r.choice(words)
        numbers = [word for word in words if re.fullmatch(r"-?\d{1,9}(\.\d{1,9})?", word[0])]
        if numbers and r.random() < 0.5:  # a little off: most such jobs are still right
            at = r.choice(numbers)
            kind = float if "." in at[0] else int
            new = str(kind(float(at[0]) * r.choice((-1, 0.5, 1.01, 2)) + r.choice((0, 0, 1))))
        else:
            new = r.choice(("", other[0], r.choice(TOML), r.choice(TOML), str(r.choice(NUMBERS))))
        text = text[:at.start()] + new + text[at.end():]
    return text


class Fuzz:
    """`one()` makes a mutation and reads it; `counts` says what came of each kind."""

    KINDS = ("job", "job", "transforms", "transforms", "gltf", "profile")

    def __init__(self, seed: int, folder: Path):
        self.r, self.folder = random.Random(seed), folder
        self.jobs = [TINY, TINY.split("[render]")[0] + MORE, PARTS]
        for text in self.jobs:  # undamaged they are right
            job.load_job(write_job(folder, text))
        self.transforms = json.loads((folder / "photos" / "transforms.json").read_text()) | {
            "camera_model": "OPENCV", "k1": -0.02, "p1": 0.001, "fl_x": 26.0, "cx": 12.0, "cy": 12.0, "w": 24, "h": 24, "aabb_scale": 4}
        self.profiles = [Profile.load(name) for name in ("vulkan_min", "lavapipe")]
        self.texts = [json.loads((Path(job.__file__).parents[3] / "device_profiles" / f"{name}.json").read_text())
                      for name in profile_names()]
        self.ball = icosphere(1, 0.5)
        self.counts = {kind: [0, 0] for kind in self.KINDS}
        self.messages: set[str] = set()

    def make(self, kind: str) -> bytes:
        r = self.r
        # Jobs of parts are always built, which takes as long as a hundred texts read.
        text = mutate_toml(self.jobs[2] if r.randrange(BUILT) == 0 else r.choice(self.jobs[:2]), r) if kind == "job" else mutate_document(
            {"transforms": self.transforms, "gltf": GLTF, "profile": r.choice(self.texts)}[kind], r)
        data = text.encode("utf-8", "surrogatepass")
        return mutate_bytes(data, r) if r.random() < 0.2 else data

    def read(self, kind: str, data: bytes) -> None:
        if kind == "profile":
            check(Profile.loads(data, "p.json"))
            return
        path = self.folder / {"job": "fuzzed.toml", "transforms": "photos/fuzzed.json", "gltf": "fuzzed.gltf"}[kind]
        path.write_bytes(data)
        if kind == "job":
            job.load_job(path, self.profiles)
        else:
            load = load_views if kind == "transforms" else load_gltf_views
            views = load(path, *([self.folder / "photos"] if kind == "gltf" else []))
            sense.check(self.ball, views, True)

    def one(self) -> None:
        kind = self.r.choice(self.KINDS)
        data = self.make(kind)
        build, start, accepted = job.Problem, time.perf_counter(), False
        job.Problem = build if self.r.randrange(BUILT) == 0 else _Unbuilt
        try:
            with warnings.catch_warnings(record=True) as notes:
                warnings.simplefilter("always")
                self.read(kind, data)
                accepted = True
        except InputError as error:
            self._line(str(error), kind)
        finally:
            job.Problem = build
        for note in notes:
            assert issubclass(note.category, InputWarning), note
            self._line(str(note.message), kind)
        assert time.perf_counter() - start < SECONDS, f"{len(data)} bytes of {kind} took {time.perf_counter() - start:.1f} s"
        self.counts[kind][accepted] += 1

    def _line(self, message: str, kind: str) -> None:
        assert 0 < len(message) < LONGEST and "\n" not in message and message.encode(), (kind, message[:3000])
        self.messages.add("".join(c for c in message if not c.isdigit())[:120])


class _Unbuilt:
    """In place of a problem: takes what one takes, and builds nothing."""

    def __init__(self, mesh, views, **_):
        self.width, self.height = views.cameras[0].width, views.cameras[0].height
        self.program = type("Program", (), {"meta": {}})
        self.scene = type("Scene", (), {"parameters": {}, "program": self.program})
        assert np.isfinite(mesh.positions).all() and np.isfinite(views.images).all()

    def phase(self, *_, **__):
        pass

    render = phase


def run(mutations: int, seed: int) -> Fuzz:
    """So many mutations."""
    with tempfile.TemporaryDirectory() as folder:
        fuzz = Fuzz(seed, Path(folder))
        for n in range(mutations):
            try:
                state = fuzz.r.getstate()
                fuzz.one()
            except BaseException:
                print(f"mutation {n} of seed {seed}", file=sys.stderr)
                fuzz.r.setstate(state)
                kind = fuzz.r.choice(fuzz.KINDS)
                print(kind, fuzz.make(kind)[:3000], file=sys.stderr)
                raise
        return fuzz


if __name__ == "__main__":
    count, seed = (int(x) for x in (*sys.argv[1:], *("100000", "0")[len(sys.argv) - 1:]))
    start = time.perf_counter()
    done = run(count, seed)
    print(f"{count} mutations of seed {seed} in {time.perf_counter() - start:.0f} s, {len(done.messages)} different messages")
    for kind, (refused, accepted) in done.counts.items():
        print(f"  {kind}: {refused} refused, {accepted} accepted")
