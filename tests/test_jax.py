"""The bridge to JAX, where it is installed (the extra `jax`, which is not in CI); tests/test_bridges.py tests what it is made of
everywhere."""
import numpy as np
import pytest
from bridge_scenes import SHAPES, arrays, ball_scene, run_page

from dressi_edge import runtime
from dressi_edge.cache.errors import InputError
from dressi_edge.compiler.graph.reference_session import ReferenceSession

jax = pytest.importorskip("jax", reason="the extra jax is not installed, so the bridge to JAX was not run; what it is made of was")

import jax.numpy as jnp  # noqa: E402

import dressi_edge.jax as bridge  # noqa: E402

pytest_plugins = ["gpu"]


@pytest.fixture(scope="module")
def path(gpu):
    return gpu.compile(ball_scene().program)


@pytest.fixture
def session(gpu, path):
    with runtime.load(path, gpu.device) as s:
        yield s
    gpu.silent()


def loss(f, gradients):
    def value(given):
        pictures = f(**given)
        return sum((pictures[key] * g).sum() for key, g in gradients.items())
    return value


def wanted(session, seed):
    given, gradients = arrays(seed)
    for k, x in given.items():
        session.set(k, x)
    return session.forward("render"), session.backward("render", **gradients)


@pytest.mark.parametrize("compiled", [False, True], ids=["eager", "jit"])
def test_pictures_and_gradients_are_those_of_the_session(session, compiled):
    pictures, gradients = wanted(session, 1)
    given, weights = arrays(1)
    f = bridge.function(session)
    how = jax.jit if compiled else lambda x: x
    for key, x in how(lambda given: f(**given))(given).items():
        assert x.dtype == jnp.float32 and np.array_equal(x, pictures[key])
    for key, x in how(jax.grad(loss(f, weights)))(given).items():
        np.testing.assert_array_equal(x, gradients[key])


def test_what_was_drawn_is_not_drawn_again_for_the_gradient(session):
    given, weights = arrays(1)
    f = bridge.function(session)
    step = jax.jit(jax.value_and_grad(loss(f, weights)))
    jax.block_until_ready(step(given))
    before = session.report()["runs"]
    jax.block_until_ready(step({**given, "colors": given["colors"] * 0.5}))
    assert session.report()["runs"]["render"] == before["render"] + 1


def test_float64_against_differences_of_the_reference():
    with jax.enable_x64(True):
        f = bridge.function(ReferenceSession(ball_scene(0, (8, 6)).program))
        rng = np.random.default_rng(0)
        x, d = f.pure.session.get("vertices") + rng.normal(scale=0.02, size=(12, 3)), rng.normal(size=(12, 3))
        weights = {key: rng.normal(size=shape) for key, shape in f.pure.outputs.items()}
        value = loss(f, weights)
        slope, h = jax.grad(lambda v: value({"vertices": v}))(jnp.asarray(x)), 1e-5
        assert slope.dtype == jnp.float64
        there, back = (value({"vertices": x + sign * h * d}) for sign in (1, -1))
        assert float((slope * d).sum()) == pytest.approx(float(there - back) / (2 * h), rel=1e-6)


def test_vmap_draws_one_after_another_and_shares_what_is_not_mapped(session):
    f, cases, weights = bridge.function(session), [arrays(seed)[0]["vertices"] for seed in range(3)], arrays(0)[1]
    colors = arrays(0)[0]["colors"]

    def value(x, colors):
        return loss(f, weights)({"vertices": x, "colors": colors})

    each = [jax.grad(value, (0, 1))(x, colors) for x in cases]
    mapped = jax.jit(jax.vmap(jax.grad(value), (0, None)))(np.stack(cases), colors)
    np.testing.assert_array_equal(mapped, np.stack([x for x, _ in each]))
    shared = jax.grad(lambda c: jax.vmap(value, (0, None))(np.stack(cases), c).sum())(colors)
    np.testing.assert_allclose(shared, sum(np.asarray(c) for _, c in each), rtol=1e-5, atol=1e-5)
    assert jax.vmap(lambda x: f(vertices=x)["color"])(np.stack(cases)).shape == (3, *SHAPES["color"])


def test_narrow_numbers_and_inputs_without_gradient(session):
    f, (given, weights) = bridge.function(session), arrays(4)
    found = jax.grad(loss(f, weights))({"colors": jnp.asarray(given["colors"], jnp.bfloat16), "shade": jnp.ones(3)})
    assert found["colors"].dtype == jnp.bfloat16 and not np.asarray(found["shade"]).any()


@pytest.mark.parametrize("given, words", [
    ({"paint": np.zeros(3)}, "no parameter or input 'paint'; there are: vertices colors shade"),
    ({"colors": np.zeros((41, 3))}, r"colors has shape \(41, 3\); \(42, 3\) is needed \(jax.vmap draws several\)"),
    ({"colors": np.zeros((42, 3), complex)}, "real numbers are needed"),
])
def test_what_cannot_be_given_is_said(session, given, words):
    with pytest.raises(InputError, match=words):
        bridge.function(session)(**given)


def test_nan_is_an_error_of_the_call(session):
    with pytest.raises(Exception, match="colors has 126 values that are NaN or Inf"):
        jax.block_until_ready(bridge.function(session)(colors=np.full((42, 3), np.nan, np.float32)))


def test_the_code_of_the_page_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run_page("jax") == 3
