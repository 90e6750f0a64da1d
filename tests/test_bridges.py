"""What bridges to PyTorch and JAX are made of, without these: a vjp as a pure function (`bridges.pure`), values in and out in one pass,
and the plans of a vjp. tests/test_torch.py and tests/test_jax.py have the bridges themselves, where the frameworks are installed."""
import ast
import copy
import pickle
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from bridge_scenes import SHAPES, arrays, ball_scene, run_page

from dressi_edge import runtime
from dressi_edge.bridges import Pure
from dressi_edge.cache.errors import InputError
from dressi_edge.cache.layout import Layout
from dressi_edge.cache.profile import Profile
from dressi_edge.compiler import Program, build
from dressi_edge.compiler.graph.reference_session import ReferenceSession
from dressi_edge.compiler.passes.substage import LISTED, TILES
from dressi_edge.compiler.scene import HardSoftRas, Lambert, Light, Outline, Scene, Texture, icosphere, orbit, pear

pytest_plugins = ["gpu"]


@pytest.fixture(scope="module")
def path(gpu):
    return gpu.compile(ball_scene().program)


@pytest.fixture
def session(gpu, path):
    with runtime.load(path, gpu.device) as s:
        yield s
    gpu.silent()


def same(a, b):
    assert a.keys() == b.keys() and all(np.array_equal(a[k], b[k]) for k in a), {k: np.abs(a[k] - b[k]).max() for k in a}


# The function


def test_it_says_what_it_takes_and_gives(session):
    f = Pure(session)
    assert (f.name, f.real) == ("render", np.float32)
    assert f.outputs == {key: SHAPES[key] for key in ("color", "alpha")}
    assert f.parameters == {key: SHAPES[key] for key in ("vertices", "colors")}
    assert f.given == {key: SHAPES[key] for key in ("vertices", "colors", "shade")}


def test_pictures_and_gradients_are_those_of_the_session(session):
    given, gradients = arrays(1)
    pictures, call = Pure(session).forward(given)
    found = Pure(session, "render").backward(call, gradients)
    for key, x in given.items():
        session.set(key, x)
    same(pictures, session.forward("render"))
    same(found, session.backward("render", **gradients))


def test_gradients_are_those_of_float64(session):
    given, gradients = arrays(2, np.float64)
    found = []
    for s in (session, ReferenceSession(ball_scene().program)):
        f = Pure(s)
        found.append((f.forward(given)[0], f.backward(f.at(given), gradients)))
    for ours, exact in zip(*found):
        for key, x in exact.items():
            assert x.dtype == np.float64 and np.abs(ours[key] - x).max() < 2e-3 * np.abs(x).max(), key


def test_each_call_keeps_its_own_arrays_whatever_comes_between(session):
    f, (first, g), (second, _) = Pure(session), arrays(3), arrays(4)
    wanted = f.backward(f.forward(first)[1], g), f.backward(f.forward(second)[1], g)
    a, b = f.forward(first)[1], f.forward(second)[1]
    same(f.backward(b, g), wanted[1])
    same(f.backward(a, g), wanted[0])
    same(f.backward(a, g), wanted[0])
    same(f.backward(b, g), wanted[1])
    assert not np.array_equal(wanted[0]["colors"], wanted[1]["colors"])


def test_what_was_drawn_for_a_call_is_not_drawn_again_for_its_gradient(session):
    f, (given, g) = Pure(session), arrays(3)
    _, call = f.forward(given)
    before = session.report()["runs"]
    f.backward(call, g)
    f.backward(call, {"alpha": g["alpha"]})
    after = session.report()["runs"]
    assert {k: after[k] - before[k] for k in after if after[k] != before[k]} == {"render.vjp": 2}


def test_what_is_steady_and_the_same_is_not_drawn_again_and_what_is_other_is(session):
    f, (given, _), (other, _) = Pure(session), arrays(3), arrays(4)
    first, _ = f.forward(given, steady=given)
    before = session.report()["runs"]
    again, _ = f.forward({k: x.copy() for k, x in given.items()}, steady=given)
    assert session.report()["runs"] == before
    same(first, again)
    turned = {**given, "colors": np.ascontiguousarray(given["colors"].T).T}  # the same numbers in another order of memory
    same(f.forward(turned, steady=turned)[0], first)
    assert session.report()["runs"] == before
    moved, _ = f.forward({**given, "colors": other["colors"]}, steady=given)
    assert not np.array_equal(moved["color"], first["color"])
    session.set("colors", given["colors"])  # by somebody else
    same(f.forward({**given, "colors": other["colors"]}, steady=given)[0], moved)


def test_a_picture_without_a_gradient_counts_as_zero_also_after_it_had_one(session):
    f, (given, g) = Pure(session), arrays(5)
    _, call = f.forward(given)
    both, zero = f.backward(call, g), np.zeros(SHAPES["color"], np.float32)
    alone = f.backward(call, {"alpha": g["alpha"]})
    same(alone, f.backward(call, {"alpha": g["alpha"], "color": zero}))
    assert not np.array_equal(alone["vertices"], both["vertices"]) and not alone["colors"].any()
    assert f.backward(call, g, ["colors"]).keys() == {"colors"}


def test_an_input_that_has_changed_and_was_not_given_is_an_error_and_given_it_is_none(session):
    f, (given, g) = Pure(session), arrays(6)
    session.set("shade", [1.0, 0.5, 0.25])
    _, call = f.forward(given)
    wanted = f.backward(call, g)
    session.set("shade", [0.5, 0.5, 0.5])
    with pytest.raises(InputError, match="shade has changed in the session since render was called"):
        f.backward(call, g)
    _, call = f.forward({**given, "shade": np.array([1.0, 0.5, 0.25])})
    session.set("shade", [0.1, 0.1, 0.1])
    same(f.backward(call, g), wanted)


@pytest.mark.parametrize("change, words", [
    ({"paint": np.zeros(3)}, "no parameter or input 'paint'; there are: vertices colors shade"),
    ({"colors": np.zeros((41, 3))}, r"colors has shape \(41, 3\); \(42, 3\) is needed"),
    ({"colors": np.full((42, 3), np.nan)}, "colors has 126 values that are NaN or Inf"),
    ({"colors": np.full((42, 3), 1e39)}, "beyond the range of fp32"),
    ({"colors": np.full((42, 3), "x")}, "numbers are needed"),
])
def test_what_cannot_be_given_is_said_and_nothing_has_changed(session, change, words):
    f, (given, _) = Pure(session), arrays(7)
    before = f.forward(given)[0]
    with pytest.raises(InputError, match=words):
        f.forward({"vertices": np.zeros((42, 3)), **change})
    same(session.forward("render"), before)


def test_gradients_that_cannot_be_are_errors(session):
    f, (given, g) = Pure(session), arrays(7)
    _, call = f.forward(given)
    for gradients, words in (({"depth": g["alpha"]}, "no output 'depth'; there are: color alpha"),
                             ({"alpha": g["alpha"][:1]}, r"render.alpha.grad has shape \(1, 12, 16\)"),
                             ({"alpha": g["alpha"] * np.nan}, "NaN or Inf")):
        with pytest.raises(InputError, match=words):
            f.backward(call, gradients)
    assert np.isfinite(f.backward(call, g)["vertices"]).all()


def test_without_a_name_there_must_be_one_vjp(gpu):
    s = ball_scene()
    s.vjp("second", ["colors"], color=s._frames[0].color)
    with pytest.raises(InputError, match=r"2 vjps \(render second\); name the one to use"):
        Pure(ReferenceSession(s.program))
    with pytest.raises(InputError, match="'third' is no vjp of this bundle; there are: render second"):
        Pure(ReferenceSession(s.program), "third")
    assert Pure(ReferenceSession(s.program), "second").parameters.keys() == {"colors"}


def test_many_threads_get_each_its_own(session):
    f = Pure(session)
    cases = [arrays(seed) for seed in range(4)]
    wanted = [(f.forward(given)[0], f.backward(f.at(given), g)) for given, g in cases]

    def work(k):
        for _ in range(5):
            pictures, call = f.forward(cases[k][0], steady=["vertices"])
            same(pictures, wanted[k][0])
            same(f.backward(call, cases[k][1]), wanted[k][1])
        return True

    with ThreadPoolExecutor(4) as pool:
        assert all(pool.map(work, range(4), timeout=120))


def test_it_is_not_sent_to_another_process_but_shared_by_copies(session):
    f = Pure(session)
    assert copy.deepcopy({"f": f})["f"] is f
    with pytest.raises(InputError, match="load the bundle there"):
        pickle.dumps(f)


def test_bridges_know_neither_frameworks_nor_vulkan():
    for path in (Path(__file__).resolve().parents[1] / "dressi_edge" / "bridges").glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else [node.module or ""] \
                if isinstance(node, ast.ImportFrom) else []
            assert not any(name.split(".")[0] in ("torch", "jax", "runtime", "compiler") for name in names), path


# Values in and out


LAYOUTS = [Layout("unit", "float"), Layout("unit", "vec3"), Layout("table", "vec3", count=7), Layout("table", "int", count=9),
           Layout("image", "vec2", 5, 3), Layout("atlas", "vec3", 4, 3, 5, 2), Layout("atlas", "float", 4, 3, 6, 3),
           Layout("atlas", "vec4", 2, 3, 1, 1), Layout("atlas", "ivec3", 2, 2, 3, 3)]


@pytest.mark.parametrize("layout", LAYOUTS, ids=str)
def test_several_values_go_in_and_come_out_as_one_by_one(gpu, layout):
    p = Program()
    a, b = p.input("a", layout), p.state("b", layout, 3)
    p.plan("sum", outputs={"sum.y": (a + b, layout)})
    integer = layout.vtype.startswith("i")
    x = np.arange(int(np.prod(layout.shape))).reshape(layout.shape) - 4
    x = x if integer else x / 8
    with gpu.open(p) as s:
        s.set_all({"a": x, "b": (2 * x).astype(np.float32) if not integer else 2 * x})
        found = s.get_all(["sum.y", "a", "b", "a"])
        assert list(found) == ["sum.y", "a", "b"] and found["sum.y"].dtype == (np.int32 if integer else np.float32)
        for key, factor in (("sum.y", 3), ("a", 1), ("b", 2)):
            np.testing.assert_array_equal(found[key], factor * x)
            np.testing.assert_array_equal(s.get(key), found[key])
        out = np.empty((2, *layout.shape), found["a"].dtype)
        assert s.get_all(["a"], {"a": out[1, ...]})["a"] is not None
        np.testing.assert_array_equal(out[1], x)
        with pytest.raises(InputError, match="one piece of"):
            s.get_all(["a"], {"a": np.empty(layout.shape, np.float64)})
        before = s.version("a"), s.version("b")
        with pytest.raises(InputError, match="b has shape"):
            s.set_all({"a": 0 * x, "b": np.zeros((1, 2, 3, 4, 5))})
        assert before == (s.version("a"), s.version("b"))
        np.testing.assert_array_equal(s.get("a"), x)
        assert set(s.reads("sum")) == {"a", "b"}
    gpu.silent()


# The plans


def textured(renderer, profile="lavapipe"):
    s, fruit = Scene(orbit(2, [20, -15], 3.0, 40, (40, 32)), background=(0.1, 0.2, 0.3)), pear(16)
    x, skin = s.parameter("vertices", fruit.positions), s.parameter("skin", np.random.default_rng(0).uniform(size=(16, 24, 3)))
    s.add(fruit, x, Lambert(Texture(skin), [Light("directional", 3.0, (-1.0, -1.0, -1.0)), Light("ambient", 0.2)]))
    seen = s.frame(renderer)
    s.vjp("render", ["vertices", "skin"], color=seen.color, alpha=seen.alpha, depth=seen.depth)
    return s


@pytest.mark.parametrize("renderer", [Outline(r=2.0), Outline(r=2.0, contours=True), pytest.param(
    HardSoftRas(r=2.0, layers=2), marks=pytest.mark.full)], ids=repr)
def test_computed_again_or_kept_the_bits_are_those_of_computing_everything_in_each_plan(gpu, renderer):
    s, rng, found = textured(renderer), np.random.default_rng(1), []
    gradients = {key: rng.normal(size=s.program.values[f"render.{key}"].layout.shape) for key in ("color", "alpha", "depth")}
    for how in ({}, {"cache": False}):
        with gpu.open(s.program, **how) as session:
            found.append([session.forward("render"), session.backward("render", **gradients)])
            session.set("skin", rng.uniform(size=(16, 24, 3)) * 0 + 0.25)
            found[-1] += [session.forward("render"), session.backward("render", **gradients)]
    for cached, plain in zip(*found):
        same(cached, plain)
    gpu.silent()


def test_work_beside_outlines_is_drawn_there_alone_and_listed_edges_as_far_as_the_list_goes():
    s = Scene(orbit(2, [20, -15], 3.0, 40, (64, 48)))
    ball = icosphere(2, 0.6)
    s.add(ball, s.parameter("vertices", ball.positions))
    s.vjp("render", ["vertices"], alpha=s.frame(Outline(r=2.0)).alpha)
    stages = build(s.program, Profile.load("lavapipe")).stages
    atlas = s.atlas.extent

    def kinds(plan):
        subs = [sub for stage in stages[plan] for sub in stage.substages]
        return [(sub.domain.kind, sub.extent == atlas, sum(n.op.cost for n in sub.nodes)) for sub in subs]

    pixels = [kind for kind, over_pixels, _ in kinds("render.vjp") if over_pixels]
    assert pixels == [TILES] and [kind for kind, _, _ in kinds("render.vjp")].count(LISTED) == 2
    assert all(cost < 30 for _, over_pixels, cost in kinds("render") if over_pixels)  # what is laid into the picture comes from tiles
    assert TILES in [kind for kind, over_pixels, cost in kinds("render.prepare") if over_pixels and cost > 60]


def test_the_code_of_the_page_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run_page() == 2


def test_the_benchmark_walks_the_same_way_in_each_loop(monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(str(Path(__file__).resolve().parents[1] / "benchmarks"))
    import bridges
    monkeypatch.setattr(bridges, "INSTALLED", {"torch": False, "jax": False})
    rows = {row["case"]: row for row in bridges.main(["--quick", "--size", "32", "--json", str(tmp_path / "out.json")])}
    assert rows.keys() == {"ours", "vjp", "numpy"} and (tmp_path / "out.json").stat().st_size > 100
    assert rows["numpy"]["loss_after"] == pytest.approx(rows["ours"]["loss_after"], rel=1e-2)
