"""Schedules and optimizers against NumPy transcriptions, in float64 and with every operation rounded to fp32."""

import math

import numpy as np
import pytest

from dressi_edge.cache.errors import InputError
from dressi_edge.cache.layout import Layout
from dressi_edge.compiler.graph.autodiff import gradients
from dressi_edge.compiler.graph.functions import constant, constant_table
from dressi_edge.compiler.graph.ir import UNIT, is_int, topological
from dressi_edge.compiler.graph.optable import apply
from dressi_edge.compiler.graph.program import Program
from dressi_edge.compiler.graph.reference import evaluate
from dressi_edge.compiler.render.loss import l2
from dressi_edge.compiler.render.optimizer import Adam, Sgd, one_minus_power
from dressi_edge.compiler.render.schedule import Schedule

COUNT = 37
STEP = apply("state", name="step", vtype="int", extent=UNIT)


def unit(value):
    return np.array([[[value]]])


def evaluate_fp32(roots, feed):
    """The reference with each float result rounded to fp32, as a device computes."""
    values = {}
    for node in topological(roots):
        value = feed[node.attrs["name"]] if node.op.name in ("input", "state") else node.op.ref(
            *(values[x] for x in node.inputs), **(node.attrs if node.op.name != "constant" else {"data": node.attrs["data"]}))
        values[node] = np.asarray(value, np.int64 if is_int(node.vtype) else np.float32)
    return [values[root] for root in roots]


# Schedules


SCHEDULES = {
    "constant": (Schedule(0.3), lambda t: 0.3),
    "exponential": (Schedule(0.1, 0.001, 40, "exponential"), lambda t: 0.1 * 0.01 ** (min(t, 40) / 40)),
    "negative": (Schedule(-2.0, -8.0, 2, "exponential"), lambda t: -2.0 * 4 ** (min(t, 2) / 2)),
    "linear": (Schedule(7.0, 1.0, 30, "linear"), lambda t: 7 - 6 * min(t, 30) / 30),
    "cosine": (Schedule(1.0, 0.0, 50, "cosine"), lambda t: 0.5 + 0.5 * math.cos(math.pi * min(t, 50) / 50)),
    "piecewise": (Schedule(kind="piecewise", at=(10, 20), values=(3.0, 2.0, 1.0)), lambda t: 3.0 - (t >= 10) - (t >= 20)),
    "warm": (Schedule(2.0, 1.0, 20, "linear", warmup=5), lambda t: min(t + 1, 5) / 5 * (2 - min(max(t - 5, 0), 20) / 20)),
}


@pytest.mark.parametrize("schedule, expected", SCHEDULES.values(), ids=SCHEDULES)
@pytest.mark.parametrize("run", [evaluate, evaluate_fp32], ids=["float64", "fp32"])
@pytest.mark.parametrize("vtype", ["int", "float"])
def test_a_schedule_starts_fades_ends_and_holds(schedule, expected, run, vtype):
    node = schedule.node(apply("state", name="t", vtype=vtype, extent=UNIT))
    assert (node.vtype, node.extent) == ("float", UNIT)
    for t in (0, 1, 4, 5, 6, 10, 15, 20, 25, 30, 40, 49, 50, 51, 1000, 10_000_000):
        value, = run([node], {"t": unit(t)})
        np.testing.assert_allclose(value.item(), expected(t), rtol=1e-12 if run is evaluate else 2e-6, atol=1e-7)


def test_a_cosine_ends_exactly_at_its_end():
    node = Schedule(1.0, 0.0, 50, "cosine").node(STEP)
    assert [evaluate_fp32([node], {"step": unit(t)})[0].item() for t in (50, 51, 10 ** 9)] == [0, 0, 0]


def test_parse_reads_numbers_and_tables():
    assert Schedule.parse(2) == Schedule(2.0)
    assert Schedule.parse({"start": 0.1}) == Schedule(0.1)
    assert Schedule.parse({"start": 0.1, "end": 0.01, "steps": 9}) == Schedule(0.1, 0.01, 9, "exponential")
    assert Schedule.parse({"start": 1, "end": 0, "steps": 9, "kind": "linear"}) == Schedule(1.0, 0.0, 9, "linear")
    assert Schedule.parse({"start": 1, "warmup": 3}) == Schedule(1.0, warmup=3)
    assert Schedule.parse({"at": [5], "values": [1, 2]}) == Schedule(kind="piecewise", at=(5,), values=(1.0, 2.0))
    assert Schedule.parse(s := Schedule(1.0)) is s


@pytest.mark.parametrize("value, message", [
    ("fast", "rate is 'fast'; a finite number"),
    (True, "rate is True; a finite number"),
    (float("nan"), "rate is nan; a finite number"),
    ({}, "rate: start is missing"),
    ({"start": 1, "stop": 2}, "rate: no key stop; start, end"),
    ({"start": 1, "kind": "quadratic"}, "rate: schedule kind is 'quadratic'; constant, exponential"),
    ({"start": 1, "end": 0, "steps": 5}, "rate: exponential schedule from 1.0 to 0.0; numbers of one sign"),
    ({"start": 1, "end": 2}, "rate: schedule steps is 0; a whole number from 1 on"),
    ({"start": 1, "end": 2, "steps": 2.5}, "rate: schedule steps is 2.5; a whole number"),
    ({"start": 1, "steps": 5, "kind": "linear"}, "rate: schedule end is None; a finite number"),
    ({"start": 1, "end": 2, "kind": "constant"}, "rate: constant schedule from 1.0 to 2"),
    ({"start": 1, "warmup": -1}, "rate: schedule warmup is -1; a whole number from 0 on"),
    ({"at": [5, 5], "values": [1, 2, 3]}, r"rate: piecewise schedule: 3 values for steps \[5, 5\]; ascending"),
    ({"at": [5], "values": [1]}, "rate: piecewise schedule: 1 values"),
    ({"at": 5, "values": [1, 2]}, "rate: piecewise schedule: at is 5"),
    ({"start": 1, "at": [1]}, "rate: constant schedule: at and values belong"),
])
def test_a_bad_schedule_is_named(value, message):
    with pytest.raises(InputError, match=f"^{message}"):
        Schedule.parse(value, "rate")


def test_a_schedule_needs_a_scalar_counter():
    with pytest.raises(InputError, match="step counter"):
        Schedule(1.0).node(apply("state", name="s", vtype="vec2", extent=UNIT))


# Optimizers


def problem(optimizer, **limits):
    """A program that moves a table towards a target; its updates, the counter's among them."""
    rng = np.random.default_rng(2)
    program = Program()
    layout = Layout("table", "vec3", count=COUNT)
    p = program.state("p", layout, rng.normal(size=(COUNT, 3)))
    step = program.state("step", Layout("unit", "int"), 0)
    target, scale = rng.normal(size=(COUNT, 3)), 10.0 ** rng.uniform(-3, 2, (COUNT, 1))
    loss = l2(p * constant_table(scale), constant_table(target))
    updates = optimizer.update(program, "p", p, gradients(loss, [p])[0], step, **limits)
    updates["step"] = step + 1
    return program, updates, lambda x: 2 * (x * scale - target) * scale / (3 * COUNT)


def run(program, updates, steps, evaluator=evaluate):
    """The states after every step."""
    values = program.values
    feed = {name: values[name].layout.to_image(values[name].initial, name) for name in updates}
    history = []
    for _ in range(steps):
        feed = dict(zip(updates, evaluator(list(updates.values()), feed)))
        history.append({name: values[name].layout.from_image(x) for name, x in feed.items()})
    return history


def adam_loop(x, gradient, steps, rate, beta1=0.9, beta2=0.999, epsilon=1e-8):
    m, v = np.zeros_like(x), np.zeros_like(x)
    for t in range(1, steps + 1):
        g = gradient(x)
        m = beta1 * m + (1 - beta1) * g
        v = beta2 * v + (1 - beta2) * g ** 2
        x = x - rate(t - 1) * (m / (1 - beta1 ** t)) / (np.sqrt(v / (1 - beta2 ** t)) + epsilon)
        yield x


def sgd_loop(x, gradient, steps, rate, momentum, nesterov):
    buffer = None
    for t in range(steps):
        g = gradient(x)
        buffer = g if buffer is None else momentum * buffer + g
        x = x - rate(t) * (g + momentum * buffer if nesterov else buffer if momentum else g)
        yield x


@pytest.mark.parametrize("evaluator, tolerance", [(evaluate, 1e-10), (evaluate_fp32, 2e-4)], ids=["float64", "fp32"])
@pytest.mark.parametrize("settings, steps", [({}, 50), ({"betas": (0.0, 0.9)}, 50), ({"betas": (0.0, 0.0)}, 5),
                                             ({"betas": (0.8, 0.9), "epsilon": 1e-3}, 50)])
def test_adam_is_adam_for_50_steps(settings, steps, evaluator, tolerance):
    program, updates, gradient = problem(Adam(0.02, **settings))
    beta1, beta2 = settings.get("betas", (0.9, 0.999))
    start, epsilon = program.values["p"].initial, settings.get("epsilon", 1e-8)
    expected = adam_loop(start, gradient, steps, lambda t: 0.02, beta1, beta2, epsilon)
    for state, x in zip(run(program, updates, steps, evaluator), expected):
        np.testing.assert_allclose(state["p"], x, rtol=tolerance, atol=tolerance)


def test_adam_follows_its_schedule():
    program, updates, gradient = problem(Adam({"start": 0.1, "end": 0.001, "steps": 30}))
    expected = adam_loop(program.values["p"].initial, gradient, 50, lambda t: 0.1 * 0.01 ** (min(t, 30) / 30))
    for state, x in zip(run(program, updates, 50), expected):
        np.testing.assert_allclose(state["p"], x, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("momentum, nesterov", [(0.0, False), (0.9, False), (0.9, True)])
def test_sgd_is_sgd_for_50_steps(momentum, nesterov):
    schedule = Schedule(1e-4, 1e-6, 40, "linear")
    program, updates, gradient = problem(Sgd(schedule, momentum, nesterov))
    start = program.values["p"].initial
    expected = sgd_loop(start, gradient, 50, lambda t: 1e-4 - 0.99e-4 * min(t, 40) / 40, momentum, nesterov)
    for state, x in zip(run(program, updates, 50), expected):
        np.testing.assert_allclose(state["p"], x, rtol=1e-10, atol=1e-10)
    assert ("p.momentum" in program.values) == bool(momentum)


def one_texel(optimizer, **fields):
    """Updates of a table of 5 floats whose gradient is an input, and the program."""
    program = Program()
    layout = Layout("image", "float", 1, 5)
    p, g = program.state("p", layout), program.input("g", layout)
    step = program.state("step", Layout("unit", "int"), 0)
    return program, optimizer.update(program, "p", p, g, step, **fields)


@pytest.mark.parametrize("step", [0, 1, 9, 99, 10 ** 4, 10 ** 6, 2 * 10 ** 9])
def test_adam_in_fp32_moves_by_the_rate_at_any_step(step):
    """With the moments of a constant gradient the corrected quotient is its sign, whatever its size."""
    _, updates = one_texel(Adam(0.01))
    g = np.float32([1e-3, -1e-8, 5e4, -1.0, 3e-6])
    t = np.float64(step)
    m, v = g * -np.expm1(t * math.log(0.9)), g.astype(float) ** 2 * -np.expm1(t * math.log(0.999))
    layout = Layout("image", "float", 1, 5)
    feed = {"p": 0 * g, "g": g, "p.adam_m": m, "p.adam_v": v}
    feed = {name: layout.to_image(x.reshape(5, 1), name).astype(np.float32) for name, x in feed.items()}
    p, _, _ = evaluate_fp32([updates[n] for n in ("p", "p.adam_m", "p.adam_v")], feed | {"step": unit(step)})
    np.testing.assert_allclose(layout.from_image(p)[:, 0], -0.01 * g / (abs(g) + 1e-8), rtol=5e-6 if step < 2000 else 2e-5)


@pytest.mark.parametrize("base", [0.0, 1e-30, 0.5, 0.6, 0.9, 0.99, 0.999, 0.99999])
def test_bias_corrections_keep_six_digits_in_fp32(base):
    t = apply("state", name="t", vtype="float", extent=UNIT)
    node = one_minus_power(base, t)
    for k in [*range(1, 40), 69, 70, 499, 500, 501, 692, 693, 694, 1000, 7000, 10 ** 5, 10 ** 6, 10 ** 7]:
        exact = -math.expm1(k * math.log(base)) if base else 1.0
        assert abs(evaluate_fp32([node], {"t": unit(float(k))})[0].item() / exact - 1) < 1e-6


@pytest.mark.parametrize("optimizer", [Adam(0.01), Adam(0.01, epsilon=1e-15), Sgd(0.1), Sgd(0.1, 0.9), Sgd(0.1, 0.9, True)])
@pytest.mark.parametrize("step", [0, 1, 10 ** 6])
def test_a_texel_without_gradient_and_moments_keeps_its_bits(optimizer, step):
    program, updates = one_texel(optimizer)
    zero = {name: np.zeros((5, 1, 1), np.float32) for name in ("g", *updates)}
    p = np.float32([0.1, -3e-30, 1e20, -0.0, 7]).reshape(5, 1, 1)
    after = dict(zip(updates, evaluate_fp32(list(updates.values()), zero | {"p": p, "step": unit(step)})))
    assert after["p"].view(np.uint32).tolist() == p.view(np.uint32).tolist()
    assert not any(x.any() for name, x in after.items() if name != "p")


@pytest.mark.parametrize("optimizer", [Adam(0.01), Sgd(0.01, 0.9)])
def test_a_masked_texel_does_not_move(optimizer):
    program = Program()
    layout = Layout("image", "vec3", 1, 5)
    p, g = program.state("p", layout, np.ones((5, 1, 3))), program.input("g", layout)
    step = program.state("step", Layout("unit", "int"), 0)
    updates = optimizer.update(program, "p", p, g, step, mask=constant(np.array([1.0, 0, 1, 0, 0.5]).reshape(5, 1, 1)))
    feed = {name: np.zeros((5, 1, 3)) for name in updates} | {"g": np.full((5, 1, 3), 2.0), "p": np.ones((5, 1, 3))}
    after, = evaluate([updates["p"]], feed | {"step": unit(0)})
    assert ((after == 1).all((1, 2)) == [False, True, False, True, False]).all()


@pytest.mark.parametrize("optimizer", [Adam(10.0), Sgd(10.0)])
@pytest.mark.parametrize("low, high", [(0.0, 1.0), (0.0, None), (None, 1.0)])
def test_limits_hold_after_the_update(optimizer, low, high):
    program, updates = one_texel(optimizer, low=low, high=high)
    feed = {name: np.zeros((5, 1, 1)) for name in updates} | {"step": unit(0)}
    feed |= {"g": np.array([-3.0, 3, 0, 0, 1e-12]).reshape(5, 1, 1), "p": np.full((5, 1, 1), 0.5)}
    free = evaluate([one_texel(optimizer)[1]["p"]], feed)[0]
    p, = evaluate([updates["p"]], feed)
    np.testing.assert_array_equal(p, np.clip(free, -np.inf if low is None else low, np.inf if high is None else high))


@pytest.mark.parametrize("optimizer", [Adam(0.01), Sgd(0.01, 0.9)])
def test_a_second_phase_shares_the_states_and_starts_afresh(optimizer):
    program, first, _ = problem(optimizer)
    p, step = program.values["p"].node, program.values["step"].node
    second = optimizer.update(program, "p", p, gradients(l2(p, 1.0), [p])[0], step)
    assert set(second) | {"step"} == set(first)
    dirty = {name: np.full((p.extent.height, p.extent.width, 3), 7.0) for name in second}
    clean = {name: x if name == "p" else 0 * x for name, x in dirty.items()}
    for a, b in zip(*(evaluate(list(second.values()), feed | {"step": unit(0)}) for feed in (dirty, clean))):
        np.testing.assert_array_equal(a, b)


def test_what_depends_on_the_step_alone_is_one_texel():
    _, updates, _ = problem(Adam({"start": 0.1, "end": 0.001, "steps": 30}))
    order = topological(updates.values())
    wide = {n for n in order if n.extent != UNIT}
    assert not [n for n in wide if n.op.name in ("exp", "cos", "pow")] and len([n for n in wide if n.op.name == "sqrt"]) == 1


def test_updates_make_a_plan():
    program, updates, _ = problem(Adam(0.01))
    program.plan("fit", updates, steps=50)
    assert {name for name, role in program.roles.items() if role == "state"} == {"p", "step", "p.adam_m", "p.adam_v"}
    assert program.values["p.adam_v"].layout == program.values["p"].layout


@pytest.mark.parametrize("make, message", [
    (lambda: Adam("fast"), "rate is 'fast'"),
    (lambda: Adam(0.01, (0.9, 1.0)), "betas is 1.0; a number from 0"),
    (lambda: Adam(0.01, 0.9), "betas is 0.9; two numbers"),
    (lambda: Adam(0.01, epsilon=0.0), "epsilon is 0.0; at least 1e-15"),
    (lambda: Sgd(0.01, -0.1), "momentum is -0.1"),
    (lambda: Sgd(0.01, nesterov=True), "nesterov needs a momentum"),
])
def test_a_bad_setting_is_named(make, message):
    with pytest.raises(InputError, match=message):
        make()


def test_a_bad_update_is_named():
    program = Program()
    layout = Layout("table", "vec3", count=5)
    p, g = program.state("p", layout), program.input("g", layout)
    step = program.state("step", Layout("unit", "int"), 0)
    for arguments, message in ((("p", p, g.x, step), "gradient of p"), (("g", g, g, step), "g is not the state"),
                               (("p", p, g, p.x), "step counter")):
        with pytest.raises(InputError, match=message):
            Adam().update(program, *arguments)
