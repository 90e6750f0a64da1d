"""One answer on every profile, after steps and not only for one image; and a reactive cache that nobody can tell from none.

Small problems are compiled for each profile and run on lavapipe as that profile (emulate=), validation layer on.
"""

import itertools
import types

import numpy as np
import pytest

from dressi_edge import runtime
from dressi_edge.cache.layout import Layout
from dressi_edge.cache.profile import Profile
from dressi_edge.compiler import Program, build
from dressi_edge.compiler.graph.functions import apply, total
from dressi_edge.compiler.io.cameras import orbit
from dressi_edge.compiler.io.meshes import Mesh
from dressi_edge.compiler.io.shapes import icosphere
from dressi_edge.compiler.render.optimizer import Adam
from dressi_edge.compiler.render.raster import Softness
from dressi_edge.compiler.scene.problem import Loss, Problem

pytest_plugins = ["gpu"]

PROFILES = ("limit4", "limit8", "unlimited", "vulkan_min", "mali_g76")
SCENES = ("silhouette", "texture", "colors")
STEPS = 20
SIZE = 32
POSES = ("rotation", "translation")
ALWAYS = {("silhouette", "limit4", 3), ("texture", "vulkan_min", 1), ("colors", "mali_g76", 1)}
CASES = [pytest.param(*case, marks=() if case in ALWAYS else pytest.mark.full, id="-".join(map(str, case)))
         for case in itertools.product(SCENES, PROFILES, (1, 3))]


def target():
    """Two views of a disk with coloured quarters, (2, SIZE, SIZE, 4)."""
    y, x = np.mgrid[:SIZE, :SIZE] + 0.5
    y, x = y / SIZE * 2 - 1, x / SIZE * 2 - 1
    image = np.stack([x * 0.5 + 0.5, y * 0.5 + 0.5, (x * y > 0) * 0.8, np.clip((0.7 - np.hypot(x, y)) * SIZE / 2, 0, 1)], -1)
    return np.stack([image, image[:, ::-1] * [0.6, 1.0, 0.9, 1.0]]).astype(np.float32)


def problem(scene, layers):
    """Phase "fit" and plan "render" of a small ball in two views."""
    softness = Softness(2.0, layers=layers)
    ball = icosphere(1, 0.5)
    mesh = Mesh(ball.positions, ball.faces, ball.uvs, ball.uv_faces)
    made = Problem(mesh, orbit(2, (20.0, -20.0), 2.5, 50.0, (SIZE, SIZE)), texture_size=(48, 32),
                   albedo={"silhouette": "constant", "texture": "texture", "colors": "colors"}[scene])
    optimize, losses = {
        "silhouette": ({"vertices": Adam(0.01)}, [Loss("silhouette"), Loss("laplacian", 0.05)]),
        "texture": ({"texture": Adam(0.03)}, [Loss("color")]),
        "colors": ({"vertices": Adam(0.005), "colors": Adam(0.03)}, [Loss("silhouette"), Loss("color"), Loss("laplacian", 0.05)]),
    }[scene]
    made.phase("fit", STEPS, optimize, losses, softness)
    made.render(softness=softness)
    return made.program


def fitted(session):
    """(losses before and after, image) of all steps."""
    session.set("targets", target())
    first = session.loss()
    session.step(STEPS)
    return (first, session.loss()), session.get("render.color")


@pytest.fixture(scope="module")
def native(gpu):
    """native(scene, K): what lavapipe's own bundle gives on lavapipe as it is."""
    made = {}

    def get(scene, layers):
        if (scene, layers) not in made:
            with gpu.open(problem(scene, layers)) as session:
                made[scene, layers] = fitted(session)
            gpu.silent()
        return made[scene, layers]

    return get


@pytest.mark.parametrize("scene, profile, layers", CASES)
def test_every_profile_comes_to_the_same_answer(gpu, native, scene, profile, layers):
    (before, expected), expected_image = native(scene, layers)
    assert expected < 0.95 * before
    with runtime.load(gpu.compile(problem(scene, layers), profile), gpu.device, emulate=profile) as session:
        assert session.device.profile.name == profile
        (first, last), image = fitted(session)
    gpu.silent()
    assert first == pytest.approx(before, rel=0.01)
    assert last == pytest.approx(expected, rel=0.01)
    np.testing.assert_allclose(image, expected_image, rtol=0, atol=1e-3)


@pytest.mark.parametrize("scene, profile, layers", CASES)
def test_storage_half_comes_to_the_same_answer_on_every_profile(gpu, native, scene, profile, layers):
    (before, expected), expected_image = native(scene, layers)
    with runtime.load(gpu.compile(problem(scene, layers), profile, storage="half"), gpu.device, emulate=profile) as session:
        (first, last), image = fitted(session)
    gpu.silent()
    assert first == pytest.approx(before, rel=0.01)
    assert last == pytest.approx(expected, rel=0.02)
    assert np.abs(image - expected_image).mean() < 0.005


# ---- the reactive cache


@pytest.fixture(scope="module")
def bundles(gpu):
    """bundles(scene): the paths of the cached and the uncached bundle."""
    made = {}

    def get(scene):
        if scene not in made:
            made[scene] = [gpu.compile(problem(scene, 1), cache=cache) for cache in (True, False)]
        return made[scene]

    return get


def moves(rng, first, count=14):
    """A random sequence of calls: ("set", name, array), ("step", n), ("get", name). `first`: the values to begin with."""
    names = ("fit.loss", "render.color", "vertices", "targets")
    for _ in range(count):
        kind = rng.choice(["set", "step", "step", "get", "get"])
        if kind == "step":
            yield "step", int(rng.integers(1, 4))
        elif kind == "get":
            yield "get", str(rng.choice(names))
        else:
            name = str(rng.choice(list(first)))
            if name == "vertices":
                yield "set", name, icosphere(1, float(rng.uniform(0.4, 0.6))).positions
            elif name == "targets":
                yield "set", name, target() * np.float32(rng.uniform(0.5, 1.0))
            elif name in POSES:
                yield "set", name, first[name] + rng.uniform(-0.05, 0.05, first[name].shape).astype(np.float32)
            else:
                yield "set", name, rng.uniform(0.2, 0.8, first[name].shape).astype(np.float32)


def played(session, calls):
    """What the calls gave, and every state at the end."""
    session.set("targets", target())
    got = []
    for name, *arguments in calls:
        result = getattr(session, name)(*arguments)
        if name == "get":
            got.append((arguments[0], result))
    return got + [(name, session.get(name)) for name, value in session.values.items() if value["role"] == "state"]


@pytest.mark.parametrize("scene, seed", [("texture", 0), ("colors", 1), *(
    pytest.param(scene, seed, marks=pytest.mark.full) for scene in SCENES for seed in range(2, 12))])
def test_any_sequence_of_calls_gives_the_same_bits_with_and_without_the_cache(gpu, bundles, scene, seed):
    cached, plain = bundles(scene)
    with runtime.load(cached, gpu.device) as session:
        session.set("targets", target())
        first = {n: session.get(n) for n in ("vertices", "texture", "colors", "targets", *POSES) if n in session.values}
        calls = list(moves(np.random.default_rng(seed), first))
        found = played(session, calls)
        assert session.report()["runs"]["fit.prepare"] >= 1
    with runtime.load(plain, gpu.device) as session:
        expected = played(session, calls)
        assert "fit.prepare" not in session.plans
    gpu.silent()
    for (name, a), (_, b) in zip(found, expected):
        np.testing.assert_array_equal(a, b, err_msg=f"{scene} {seed}: {name} after {calls}")


def test_an_input_sent_again_every_fourth_step_runs_what_depends_on_it_and_no_more(gpu, bundles):
    with runtime.load(bundles("texture")[0], gpu.device) as session:
        def counts():
            report = session.report()
            return types.SimpleNamespace(**{f"{kind}_{name.replace('.', '_')}": n for kind in ("runs", "skipped")
                                            for name, n in report[kind].items()})

        def steps(name, array):
            for k in range(12):
                if k % 4 == 0:
                    session.set(name, array)
                session.step()

        session.set("targets", target())
        session.get("render.color")
        steps("vertices", icosphere(1, 0.45).positions)
        at = counts()
        assert (at.runs_fit, at.runs_fit_prepare, at.skipped_fit_prepare) == (12, 3, 9)
        assert at.runs_render == 1  # nobody asked for it again
        steps("targets", target() * np.float32(0.9))
        at = counts()
        assert (at.runs_fit, at.runs_fit_prepare, at.skipped_fit_prepare) == (24, 3, 21)  # the shape was drawn already
        session.loss()
        session.loss()
        assert counts().runs_fit_loss == 1  # nothing was new for the second
        session.get("render.color")
        assert counts().runs_render == 2  # the texture is new
        session.set("targets", target())
        session.get("render.color")
        session.loss()
        at = counts()
        assert (at.runs_render, at.runs_fit_loss, at.runs_fit_prepare) == (2, 2, 3)  # a picture does not depend on the target
    gpu.silent()


def test_a_step_of_a_texture_draws_no_geometry(gpu, bundles):
    """It was drawn before the first; only the steps of a shape draw it each time."""
    def draws(scene, plan):
        with runtime.load(bundles(scene)[0], gpu.device) as session:
            d = session.bundle.description
            return sum(d["pipelines"][draw["pipeline"]]["depth"] for stage in session.plans[plan]["stages"]
                       for draws in stage["subpasses"] for draw in draws)

    assert draws("texture", "fit.prepare") > 0
    assert draws("texture", "fit") == 0
    assert draws("colors", "fit") > 0


# ---- what is known beforehand, by what it depends on


NEEDED = {  # of `layered`: plan -> the inputs on which all that it computes depends
    "fit.prepare.1": {"a"}, "fit.prepare.2": {"b"}, "fit.prepare.3": {"c"}, "fit.prepare.4": {"a", "b"}, "fit.prepare": {"a", "b", "c"}}


def layered():
    """A state that grows by a number of which parts depend on one, two and three of the inputs a, b, c."""
    program, layout = Program(), Layout("unit", "float")
    state = program.state("state", layout)
    a, b, c = (program.input(name, Layout("image", "float", *size), 0.25) for name, size in (("a", (9, 7)), ("b", (5, 8)), ("c", (4, 3))))
    both = apply("sin", apply("sin", total(apply("sin", a)) * total(apply("sin", b))))
    program.plan("fit", {"state": state * 0.5 + total(apply("cos", c)) * both}, {"number": (total(apply("cos", c * both)), layout)})
    return program


def test_what_is_known_beforehand_from_one_input_is_not_computed_again_when_another_is_new():
    description = build(layered(), Profile.load("limit4")).description
    names = [value["name"] for value in description["values"]]
    plans = {plan["name"]: plan for plan in description["plans"]}
    found = {name: set() for name in plans if "prepare" in name}
    for name, reads in found.items():
        for needed in (plans[name], *(description["plans"][k] for k in plans[name]["needs"])):
            reads |= {names[k] for k in needed["reads"]}
    assert found == NEEDED


@pytest.mark.parametrize("seed", range(3))
def test_any_order_of_new_inputs_runs_what_depends_on_them_and_gives_the_bits_of_no_cache(gpu, seed):
    rng, path = np.random.default_rng(seed), gpu.compile(layered())
    with runtime.load(path, gpu.device) as session, gpu.open(layered(), cache=False) as plain:
        shapes = {name: session.shape(name) for name in "abc"}
        new, expected = set(shapes), dict.fromkeys(NEEDED, 0)
        for _ in range(20):
            for name in rng.choice(list(shapes), rng.integers(0, 3), replace=False):
                array = rng.uniform(-1, 1, shapes[name]).astype(np.float32)
                session.set(name, array)
                plain.set(name, array)
                new.add(str(name))
            n = int(rng.integers(0, 3))
            session.step(n)
            plain.step(n)
            if n:
                for plan, inputs in NEEDED.items():
                    expected[plan] += bool(inputs & new)
                new = set()
            assert {name: session.report()["runs"][name] for name in NEEDED} == expected
            if session.report()["runs"]["fit"]:
                for name in ("state", "number"):
                    np.testing.assert_array_equal(session.get(name), plain.get(name))
    gpu.silent()


def test_an_input_sent_again_every_fourth_step_costs_the_stages_that_depend_on_it(gpu):
    with gpu.open(layered()) as session:
        stages = {name: len(plan["stages"]) for name, plan in session.plans.items()}
        session.step()
        before = session.report()["runs"]
        for k in range(12):
            if k % 4 == 0:
                session.set("c", np.full((3, 4), 0.1 * k))
            session.step()
        report = session.report()
        runs = {name: report["runs"][name] - before[name] for name in stages}
        assert runs == {"fit": 12, "fit.prepare.1": 0, "fit.prepare.2": 0, "fit.prepare.3": 3, "fit.prepare.4": 0, "fit.prepare": 3}
        cost = {name: runs[name] * stages[name] for name in stages}
        assert sum(cost.values()) - cost["fit"] < 3 * sum(n for name, n in stages.items() if name != "fit") / 2
        assert report["skipped"]["fit.prepare.1"] == 12
    gpu.silent()


def test_too_many_kinds_of_dependence_are_prepared_together(gpu):
    program, layout = Program(), Layout("unit", "float")
    y = program.state("state", layout)
    for k in range(17):
        y = y + total(apply("sin", program.input(f"x{k}", Layout("image", "float", 3, 2), k / 8)))
    program.plan("fit", {"state": y})
    with gpu.open(program) as session, gpu.open(program, cache=False) as plain:
        assert list(session.plans) == ["fit.prepare", "fit"]
        for one in (session, plain):
            one.step(2)
            one.set("x3", np.ones((2, 3)))
            one.step(2)
        np.testing.assert_array_equal(session.get("state"), plain.get("state"))
