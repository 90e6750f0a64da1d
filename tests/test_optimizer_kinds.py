"""AdamW, the uniform Adam, clipping, rates by entry, frozen entries, and an optimizer of a user's own, against NumPy."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from test_optimizer import COUNT, evaluate_fp32, problem, run, unit

from dressi_edge.cache.errors import InputError
from dressi_edge.cache.layout import Layout
from dressi_edge.compiler.graph.program import Program
from dressi_edge.compiler.graph.reference import evaluate
from dressi_edge.compiler.graph.reference_session import ReferenceSession
from dressi_edge.compiler.io.cameras import look_at
from dressi_edge.compiler.io.shapes import icosphere
from dressi_edge.compiler.scene import Adam, AdamUniform, AdamW, Clipped, F, Outline, Scaled, Scene, Sgd, l2, limited, state

pytest_plugins = ["gpu"]

BOTH = pytest.mark.parametrize("evaluator, tolerance", [(evaluate, 1e-10), (evaluate_fp32, 2e-4)], ids=["float64", "fp32"])


def follows(optimizer, loop, evaluator=evaluate, tolerance=1e-10, steps=50):
    """The parameter of `problem` goes as the loop says: loop(x, gradient, steps) yields it after every step."""
    program, updates, gradient = problem(optimizer)
    for found, x in zip(run(program, updates, steps, evaluator), loop(program.values["p"].initial, gradient, steps)):
        np.testing.assert_allclose(found["p"], x, rtol=tolerance, atol=tolerance)


def adam_like(x, gradient, steps, rate, beta1=0.9, beta2=0.999, decay=0.0, share=lambda v: v, square=lambda g: g ** 2):
    m, v = np.zeros_like(x), np.zeros_like(square(x))
    for t in range(1, steps + 1):
        g = gradient(x)
        m, v = beta1 * m + (1 - beta1) * g, beta2 * v + (1 - beta2) * square(g)
        x = x - rate * decay * x
        x = x - rate * (m / (1 - beta1 ** t)) / (np.sqrt(share(v) / (1 - beta2 ** t)) + 1e-8)
        yield x


@BOTH
def test_adamw_takes_a_part_of_the_parameter_away_beside_the_gradient(evaluator, tolerance):
    follows(AdamW(0.02, decay=0.3), lambda *a: adam_like(*a, 0.02, decay=0.3), evaluator, tolerance)


@BOTH
def test_the_uniform_adam_has_one_second_moment_for_the_parameter(evaluator, tolerance):
    follows(AdamUniform(0.02), lambda *a: adam_like(*a, 0.02, share=np.max), evaluator, tolerance)


@BOTH
def test_the_uniform_adam_has_one_second_moment_for_a_vector(evaluator, tolerance):
    follows(AdamUniform(0.02, shared="vector"),
            lambda *a: adam_like(*a, 0.02, square=lambda g: (g ** 2).sum(1, keepdims=True)), evaluator, tolerance)


def test_steps_of_the_uniform_adam_keep_the_direction_of_the_first_moment():
    for shared, whole in (("parameter", True), ("vector", False)):
        program, updates, gradient = problem(AdamUniform(0.02, shared=shared))
        start = program.values["p"].initial
        moved, g = run(program, updates, 1)[0]["p"] - start, gradient(start)
        each = (moved * g).sum(1) / np.linalg.norm(moved, axis=1) / np.linalg.norm(g, axis=1)
        np.testing.assert_allclose(each, -1.0, rtol=1e-9)
        ratio = np.linalg.norm(moved, axis=1) / np.linalg.norm(g, axis=1)
        assert np.allclose(ratio, ratio[0]) == whole
        assert np.linalg.norm(moved, axis=1).max() <= 0.02 * (np.sqrt(3) if whole else 1.0001)


def test_padding_is_no_part_of_what_is_shared():
    program, updates, _ = problem(AdamUniform(0.02))
    feed = {name: value.layout.to_image(value.initial, name) for name, value in program.values.items()}
    clean = evaluate([updates["p"]], feed)[0].reshape(-1, 3)[:COUNT]
    feed["p"].reshape(-1, 3)[COUNT:] = 1e9
    np.testing.assert_array_equal(evaluate([updates["p"]], feed)[0].reshape(-1, 3)[:COUNT], clean)


def clipped(g, value=None, norm=None):
    g = g if value is None else np.clip(g, -value, value)
    return g if norm is None else g * min(1.0, norm / np.linalg.norm(g))


@BOTH
@pytest.mark.parametrize("limits", [{"value": 0.01}, {"norm": 0.02}, {"value": 0.01, "norm": 0.05}, {"norm": 1e4}])
def test_gradients_are_clipped_by_value_and_by_norm(limits, evaluator, tolerance):
    follows(Clipped(Adam(0.02), **limits), lambda x, gradient, steps: adam_like(x, lambda p: clipped(gradient(p), **limits), steps, 0.02),
            evaluator, max(tolerance, 1e-8))


@pytest.mark.parametrize("size", [1e-30, 1e-3, 3e25])
def test_the_norm_of_tiny_and_huge_gradients_is_that_in_fp32(size):
    program = Program()
    layout = Layout("table", "vec2", count=5)
    p, g = program.state("p", layout), program.input("g", layout)
    step = program.state("step", Layout("unit", "int"), 0)
    update = Clipped(Sgd(1.0), norm=2 * size).update(program, "p", p, g, step)["p"]
    gradient = np.float32(size) * np.random.default_rng(0).normal(size=(5, 2)).astype(np.float32)
    found, = evaluate_fp32([update], {"p": layout.to_image(0 * gradient, "p").astype(np.float32),
                                      "g": layout.to_image(gradient, "g").astype(np.float32), "step": unit(0)})
    expected = -clipped(gradient.astype(float) / size, norm=2.0)
    np.testing.assert_allclose(layout.from_image(found).astype(float) / size, expected, rtol=1e-5)


def test_a_gradient_of_zero_is_clipped_to_zero():
    program = Program()
    p = program.state("p", Layout("unit", "vec3"), [1.0, 2.0, 3.0])
    step = program.state("step", Layout("unit", "int"), 0)
    g = program.input("g", Layout("unit", "vec3"))
    update = Clipped(Sgd(1.0), norm=1.0).update(program, "p", p, g, step)["p"]
    start = np.array([[[1.0, 2, 3]]])
    np.testing.assert_array_equal(evaluate([update], {"p": start, "g": 0 * start, "step": unit(0)})[0], start)


def test_steps_are_scaled_entry_by_entry_within_the_limits():
    scale = np.random.default_rng(1).uniform(size=COUNT)
    scale[::5] = 0.0

    def loop(x, gradient, steps):
        m, v = np.zeros_like(x), np.zeros_like(x)
        for t in range(1, steps + 1):
            g = gradient(x)
            m, v = 0.9 * m + 0.1 * g, 0.999 * v + 0.001 * g ** 2
            x = x - scale[:, None] * 0.02 * (m / (1 - 0.9 ** t)) / (np.sqrt(v / (1 - 0.999 ** t)) + 1e-8)
            yield x

    follows(Scaled(Adam(0.02), scale), loop)
    program, updates, _ = problem(Scaled(Sgd(1e6), 0.5), low=-1.0, high=1.5)
    p = run(program, updates, 1)[0]["p"]
    assert p.min() == -1.0 and p.max() == 1.5


def test_an_entry_of_scale_zero_keeps_its_bits_in_fp32():
    program, updates, _ = problem(Scaled(Adam(0.02), (np.arange(COUNT) % 2).astype(float)))
    start = np.float32(program.values["p"].initial)
    end = run(program, updates, 3, evaluate_fp32)[-1]["p"]
    assert ((end == start).all(1) == (np.arange(COUNT) % 2 == 0)).all()


# A user's own, as the documentation has it


def rmsprop():
    """The class in docs/losses_and_optimizers.md."""
    text = (Path(__file__).resolve().parents[1] / "docs" / "losses_and_optimizers.md").read_text()
    code, = re.findall(r"```python\n(.*?)```", text, re.S)
    names = {"dataclass": dataclass, "state": state, "limited": limited, "F": F, "__name__": "docs"}
    exec(code, names)
    return names["RmsProp"], code


@BOTH
def test_the_documented_optimizer_is_rmsprop(evaluator, tolerance):
    def loop(x, gradient, steps):
        v = np.zeros_like(x)
        for _ in range(steps):
            g = gradient(x)
            v = 0.99 * v + 0.01 * g ** 2
            x = x - 0.01 * g / (np.sqrt(v) + 1e-8)
            yield x

    made, code = rmsprop()
    assert len(code.split("def update")[1].splitlines()) <= 6
    follows(made(), loop, evaluator, tolerance)


# In a scene


def test_each_parameter_has_its_optimizer_and_what_is_not_free_stays_on_a_device(gpu):
    ball = icosphere(1)
    s = Scene([look_at((0.2, 0.3, 3.0), (0, 0, 0), (0, 1, 0), 40.0, 24, 24)])
    free = (np.arange(42) % 3 > 0).astype(float)
    x = s.parameter("vertices", ball.positions * 0.8, free=free)
    stretch = s.parameter("stretch", (1.0, 1.0, 1.0), low=0.5, high=2.0)
    lift = s.parameter("lift", np.zeros(42), kind="table")
    s.add(ball, x * F.apply("broadcast", stretch, extent=x.extent) + F.compose(lift, 0.0, 0.0))
    frame = s.frame(Outline(2.0))
    RmsProp, _ = rmsprop()
    s.phase("fit", 5, {"vertices": Clipped(AdamW(0.01, decay=0.5), value=1e-3, norm=1e-3), "stretch": AdamUniform(0.01),
                       "lift": Scaled(RmsProp(), free * 0.5)}, alpha=l2(frame.alpha, 1.0))
    with ReferenceSession(s.program) as reference, gpu.open(s.program) as session:
        for each in (reference, session):
            each.step(2, "fit")
        for name in ("vertices", "stretch", "lift"):
            np.testing.assert_allclose(session.get(name), reference.get(name), atol=2e-4, err_msg=name)
        end, start = session.get("vertices"), np.float32(ball.positions * 0.8)
        assert ((end == start).all(1) == (free == 0)).all()
        assert ((session.get("lift") == 0) | (free > 0)).all() and session.get("lift").any()
    gpu.silent()


@pytest.mark.parametrize("make, message", [
    (lambda: AdamW(0.01, decay=-1), "decay is -1; a number above 0"),
    (lambda: AdamW("fast"), "rate is 'fast'"),
    (lambda: AdamUniform(0.01, (1.0, 0.9)), "betas is 1.0"),
    (lambda: AdamUniform(0.01, epsilon=0), "epsilon is 0; at least 1e-15"),
    (lambda: AdamUniform(0.01, shared="all"), "shared is 'all'; parameter or vector"),
    (lambda: Clipped(Adam(0.01)), "Clipped limits nothing"),
    (lambda: Clipped(Adam(0.01), norm=0.0), "Clipped: norm is 0.0; a number above 0"),
    (lambda: Clipped(0.01, norm=1.0), "Clipped: 0.01 is no optimizer"),
    (lambda: Scaled(Adam, "x"), "Scaled: scale is 'x'"),
    (lambda: Scaled(Adam(), [1.0, np.nan]), "not finite"),
    (lambda: problem(Scaled(Adam(), np.ones(5))), r"optimizer of p: scale has shape \(5,\); \(37,\) is needed"),
    (lambda: problem(Scaled(Adam(), F.constant_table(np.ones((COUNT, 3))))), "a float for each entry of p"),
])
def test_a_bad_setting_is_named(make, message):
    with pytest.raises(InputError, match=message):
        make()
