"""A session: set, step, get on lavapipe; the same bits every time; errors before any work."""

import numpy as np
import pytest
from graphs import python
from undertest import DEVICE

from dressi_edge import runtime
from dressi_edge.cache.errors import DeviceError, InputError
from dressi_edge.cache.layout import CHANNELS, Layout, is_int
from dressi_edge.compiler import Program, compile_program
from dressi_edge.compiler.graph.functions import apply, compose, lookup, mean, stop_gradient, to_float, total
from dressi_edge.compiler.passes.specialize import specialize

pytest_plugins = ["gpu", "sessions"]

IMAGE = Layout("image", "vec3", 7, 5)
SCALARS = Layout("image", "float", 7, 5)
TABLE = Layout("table", "vec3", count=13)
UNIT = Layout("unit", "float")
COUNTER = Layout("unit", "int")


def walk():
    """A little of everything that steps: two states that change places, a counter, an input, reductions and lookups, a loss."""
    p = Program()
    a, b = p.state("a", TABLE, np.linspace(-1, 1, 39).reshape(13, 3)), p.state("b", TABLE, 0.25)
    t = p.state("t", COUNTER, 0)
    target = p.input("target", IMAGE, np.linspace(0, 1, 105).reshape(5, 7, 3))
    rate = p.input("rate", UNIT, 0.1)
    picked = lookup(a, np.arange(35) % 13)
    error = apply("sin", picked) - lookup(target, np.arange(35)[::-1])
    push = lookup(error, (np.arange(13) * 5) % 35)
    updates = {"a": b + push * rate, "b": apply("cos", a) * 0.5, "t": apply("add", t, 1)}
    loss = mean(apply("dot", error, error)) + to_float(t) * 0.01
    p.plan("walk", updates, {"loss": (loss, UNIT)})
    p.plan("rest", {"a": a * 0.5, "t": apply("add", t, 10)})
    p.plan("picture", {}, {"picture": (picked * 2.0, Layout("table", "vec3", count=35)),
                           "sum": (total(a), Layout("unit", "vec3"))})
    return p


STATES = ("a", "b", "t")


def bits(session, names=(*STATES, "picture", "sum")):
    return {name: session.get(name).tobytes() for name in names}


# The same bits


@pytest.mark.parametrize("n", [1, 2, 3, 8, 9])
def test_n_single_steps_are_one_call_of_n(gpu, bundle, n):
    with runtime.load(bundle, gpu.device) as one, runtime.load(bundle, gpu.device) as many:
        for _ in range(n):
            one.step(1)
        many.step(n)
        assert bits(one, (*STATES, "picture", "sum", "loss")) == bits(many, (*STATES, "picture", "sum", "loss"))
        assert one.get("t") == n
    gpu.silent()


RUN = """
import sys, hashlib
from dressi_edge import runtime
with runtime.load(sys.argv[1]) as s:
    s.step(7)
    s.set("rate", 0.3)
    s.step(4)
    print([hashlib.sha256(s.get(name).tobytes()).hexdigest() for name in ("a", "b", "t", "picture", "sum", "loss")])
"""


def test_two_runs_and_two_processes_are_bit_identical(gpu, bundle):
    def here():
        with runtime.load(bundle, gpu.device) as s:
            s.step(7)
            s.set("rate", 0.3)
            s.step(4)
            return bits(s, (*STATES, "picture", "sum", "loss"))

    assert here() == here()
    assert python(RUN, bundle, PYTHONHASHSEED="1") == python(RUN, bundle, PYTHONHASHSEED="2")
    gpu.silent()


def test_states_that_change_places_do_so_over_odd_and_even_steps(gpu):
    p = Program()
    a, b, c = (p.state(name, SCALARS, start) for name, start in (("a", 1.0), ("b", 2.0), ("c", 3.0)))
    p.plan("turn", {"a": b, "b": c, "c": a})
    p.plan("add", {"a": a + b, "b": apply("literal", value=5.0) + apply("broadcast", total(c) * 0.0, extent=c.extent)})
    p.plan("same", {"a": b, "c": b})
    p.plan("see", {}, {"all": (compose(a, b, c), IMAGE), "again": (compose(a, b, c), IMAGE), "b_too": (b, SCALARS)})
    values, rng = [1.0, 2.0, 3.0], np.random.default_rng(0)
    with gpu.open(p) as s:
        for _ in range(25):
            phase, n = rng.choice(["turn", "add", "same"]), int(rng.integers(0, 5))
            if rng.random() < 0.3:
                values[1] = float(rng.integers(1, 9))
                s.set("b", np.full((5, 7), values[1]))
            s.step(n, phase)
            for _ in range(n):
                a, b, c = values
                values = {"turn": [b, c, a], "add": [a + b, 5.0, c], "same": [b, b, b]}[phase]
            np.testing.assert_array_equal(s.get("all"), np.broadcast_to(values, (5, 7, 3)))
            np.testing.assert_array_equal(s.get("again"), s.get("all"))
            np.testing.assert_array_equal(s.get("b_too"), s.get("b"))
            assert [s.get(name)[0, 0] for name in "abc"] == values
    gpu.silent()


def test_two_plans_share_a_state(session):
    a = session.get("a")
    session.step(3, "rest")
    np.testing.assert_array_equal(session.get("a"), a * 0.125)
    session.step(1, "walk")
    session.step(1, "rest")
    assert session.get("t") == 41
    np.testing.assert_array_equal(session.get("picture"), session.get("a")[np.arange(35) % 13] * 2)
    np.testing.assert_allclose(session.get("sum"), session.get("a").sum(0), rtol=1e-6)


def test_steps_stay_in_the_phase_that_was_last_asked_for(session):
    assert session.phase == "walk"
    session.step(1, "rest")
    session.step(2)
    assert session.get("t") == 30


def test_no_step_changes_nothing(session):
    before = bits(session)
    session.step(0)
    assert bits(session) == before


# The reactive cache


def cacheable():
    """Most of it depends on inputs only; one output depends on a state, one does not."""
    p = Program()
    x, gain = p.input("x", IMAGE, 0.5), p.input("gain", UNIT, 1.0)
    v, w = p.state("v", TABLE, 0.1), p.state("w", UNIT, 1.0)
    still = apply("sin", apply("exp", apply("sin", x * gain))) / (apply("cos", x) + 2.0)
    folded = lookup(still, np.arange(26) % 35)
    level = mean(apply("dot", still, still))
    seen = lookup(v, np.arange(35) % 13)
    p.plan("go", {"v": v * 0.9 + lookup(folded, np.arange(13) * 2) * level * w}, {"loss": (total(seen.x) * level, UNIT)})
    p.plan("breathe", {"w": apply("cos", w) * level})
    shown = seen + lookup(still, np.arange(35))
    p.plan("show", {}, {"shown": (shown, Layout("table", "vec3", count=35)), "still": (still, IMAGE)}, dynamic=frozenset({"v"}))
    p.plan("level", {}, {"level": (level, UNIT)})
    return p


@pytest.mark.parametrize("seed", range(6))
def test_a_cached_plan_is_the_uncached_one_bit_for_bit(gpu, cached_pair, seed):
    rng = np.random.default_rng(seed)
    with runtime.load(cached_pair[0], gpu.device) as cached, runtime.load(cached_pair[1], gpu.device) as plain:
        for _ in range(40):
            what = rng.choice(["set", "step", "get"], p=[0.3, 0.3, 0.4])
            if what == "set":
                name = rng.choice(["x", "gain", "v", "w"])
                value = rng.uniform(-1, 1, cached.shape(name))
                for s in (cached, plain):
                    s.set(name, value)
            elif what == "step":
                phase, n = rng.choice(["go", "breathe"]), int(rng.integers(1, 4))
                for s in (cached, plain):
                    s.step(n, phase)
            else:
                name = rng.choice(["v", "w", "shown", "still", "level"])
                np.testing.assert_array_equal(cached.get(name), plain.get(name), err_msg=name)
        cached.step(1, "go")
        plain.step(1, "go")
        assert cached.get("loss") == plain.get("loss")
    gpu.silent()


@pytest.fixture(scope="module")
def cached_pair(gpu):
    return gpu.compile(cacheable()), gpu.compile(cacheable(), cache=False)


def test_what_does_not_change_is_computed_once(gpu, cached_pair):
    with runtime.load(cached_pair[0], gpu.device) as s:
        prepared = [name for name in s.plans if name.endswith("prepare")]
        assert prepared

        def runs():
            return sum(s.report()["runs"][name] for name in prepared)

        s.step(5, "go")
        before = runs()
        s.step(5, "go")
        s.get("shown")
        s.get("shown")
        after = runs()
        s.step(1, "go")
        assert runs() == after and before > 0
        s.set("x", s.get("x"))
        s.step(1, "go")
        assert runs() > after
    gpu.silent()


@pytest.mark.parametrize("channels, kept", [("xyz", ["vec3"]), ("y", ["float"])])
def test_channels_that_are_wanted_one_by_one_are_kept_together(channels, kept):
    """A vector of which several channels are read is one image, not one for each; of one channel alone no more is kept."""
    p = Program()
    still = lookup(p.input("x", TABLE, 0.5), np.arange(26) % 13)
    moved = lookup(p.state("v", Layout("table", "float", count=13)), np.arange(26) % 13)
    grown = moved
    for channel in channels:
        grown = grown * apply("swizzle", still, channels=channel)
    cached = {}
    grown, = specialize([grown], frozenset({"v"}), "p", cached)
    assert [leaf.vtype for leaf in cached.values()] == kept


def test_an_output_is_computed_again_only_if_something_it_needs_has_changed(session):
    session.get("picture")
    session.get("sum")
    assert session.report()["runs"]["picture"] == 1
    session.set("rate", 0.5)
    session.get("picture")
    assert session.report()["runs"]["picture"] == 1
    session.step(1)
    session.get("picture")
    assert session.report()["runs"]["picture"] == 2
    session.set("a", session.get("a"))
    session.get("picture")
    assert session.report()["runs"]["picture"] == 3


# Layouts


LAYOUTS = {"unit": {}, "table": {"count": 13}, "one": {"kind": "table", "count": 1}, "large": {"kind": "table", "count": 5000},
           "image": {"width": 7, "height": 5}, "atlas": {"width": 3, "height": 4, "count": 5, "columns": 2}}


def test_what_is_set_is_what_is_got_in_every_layout_and_type(gpu):
    p, values, outputs = Program(), {}, {}
    for kind, sizes in LAYOUTS.items():
        for vtype in CHANNELS:
            name = f"{kind} {vtype}"
            layout = Layout(**{"kind": kind, "vtype": vtype, **sizes})
            node = p.input(name, layout) if len(values) % 2 else p.state(name, layout)
            outputs[f"copy of {name}"] = node, layout
            rng = np.random.default_rng(len(values))
            values[name] = (rng.integers(-2 ** 31, 2 ** 31, layout.shape, np.int64).astype(np.int32) if is_int(vtype) else
                            rng.normal(size=layout.shape).astype(np.float32))
    p.plan("copy", {}, outputs)
    with gpu.open(p) as s:
        for name, value in values.items():
            assert s.shape(name) == value.shape
            s.set(name, value)
        for name, value in values.items():
            for found in (s.get(name), s.get(f"copy of {name}")):
                assert found.dtype == value.dtype and found.shape == value.shape
                np.testing.assert_array_equal(found, value, err_msg=name)
        s.set("image float", values["image float"][..., None])  # one channel may be told
        s.set("table vec3", values["table vec3"].astype(np.float16))
        s.set("table float", np.arange(13))
        np.testing.assert_array_equal(s.get("copy of table float"), np.arange(13))
        s.set("table vec3", np.asfortranarray(values["table vec3"])[::-1])
        np.testing.assert_array_equal(s.get("copy of table vec3"), values["table vec3"][::-1])
    gpu.silent()


def test_the_starting_values_are_those_of_the_program(session):
    np.testing.assert_array_equal(session.get("a"), np.linspace(-1, 1, 39).reshape(13, 3).astype(np.float32))
    np.testing.assert_array_equal(session.get("b"), np.float32(0.25))
    np.testing.assert_array_equal(session.get("target"), np.linspace(0, 1, 105).reshape(5, 7, 3).astype(np.float32))
    assert session.get("t") == 0 and session.get("t").dtype == np.int32


# Errors


BAD = {
    "shape": ("a", np.zeros((12, 3)), r"a has shape \(12, 3\); \(13, 3\) is needed"),
    "rank": ("rate", np.zeros(1 + 1), r"rate has shape \(2,\); \(\) is needed"),
    "transposed": ("target", np.zeros((7, 5, 3)), r"\(5, 7, 3\) is needed"),
    "nan": ("a", np.full((13, 3), np.nan), "a has 39 values that are NaN or Inf"),
    "inf": ("rate", np.inf, "rate has 1 values that are NaN or Inf"),
    "too_large": ("rate", 1e39, r"rate is 1e\+39, beyond the range of fp32"),
    "too_large_row": ("a", np.ones((13, 3)) * 10.0 ** (100 * (np.arange(13)[:, None] == 4)), r"a\[4, 0\] is 1e\+100, beyond the range"),
    "text": ("rate", "fast", "rate has type"),
    "complex": ("rate", 1j, "rate has type"),
    "none": ("rate", None, "rate has type"),
    "fraction": ("t", 0.5, "t has type float64; integers are needed"),
    "too_large_int": ("t", 2 ** 31, "beyond the range of int32"),
    "unknown": ("vertices", 0.0, "'vertices' is no input or state of this bundle; there are: a b t target rate"),
    "output": ("picture", 0.0, "'picture' is no input or state"),
}


@pytest.mark.parametrize("name, value, message", BAD.values(), ids=BAD)
def test_a_wrong_value_is_refused_by_name_and_changes_nothing(session, name, value, message):
    before = bits(session)
    with pytest.raises(InputError, match=message):
        session.set(name, value)
    assert bits(session) == before


def test_unknown_names_and_counts_are_refused(session):
    for call, message in ((lambda: session.get("vertices"), "'vertices' is no .*there are: a b t target rate loss picture sum"),
                          (lambda: session.shape("nothing"), "'nothing' is no"),
                          (lambda: session.step(1, "texture"), "'texture' is no phase of this bundle; there are: walk rest"),
                          (lambda: session.step(1, "picture"), "no phase"), (lambda: session.step(-1), "0 or more"),
                          (lambda: session.step(1.5), "0 or more"), (lambda: session.step("3"), "0 or more"),
                          (lambda: session.get("loss"), "loss is given out by walk, which has not run yet")):
        with pytest.raises(InputError, match=message):
            call()
    session.step(1)
    assert np.isfinite(session.get("loss"))


def test_an_input_that_nobody_set_is_named(gpu):
    p = Program()
    target, x = p.input("target", IMAGE), p.state("x", IMAGE)
    p.plan("fit", {"x": x + apply("sin", apply("exp", apply("sin", target)))})
    p.plan("see", {}, {"y": (target * 2.0, IMAGE), "z": (x * 2.0, IMAGE)})
    with gpu.open(p) as s:
        for call in (lambda: s.step(1), lambda: s.get("y")):
            with pytest.raises(InputError, match="needs target; set it first"):
                call()
        with pytest.raises(InputError, match="target has no value yet; set it first"):
            s.get("target")
        np.testing.assert_array_equal(s.get("x"), 0)
        s.set("target", np.ones((5, 7, 3)))
        s.step(1)
        np.testing.assert_array_equal(s.get("y"), 2)
    gpu.silent()


def test_a_bundle_without_updates_has_no_phase(gpu):
    p = Program()
    p.plan("see", {}, {"y": (stop_gradient(p.input("x", UNIT, 2.0)) * 2.0, UNIT)})
    with gpu.open(p) as s:
        assert s.phase is None and s.get("y") == 4
        with pytest.raises(InputError, match="no phase to step"):
            s.step(1)
    gpu.silent()


def test_a_closed_session_says_so(gpu, bundle):
    s = runtime.load(bundle, gpu.device)
    s.close()
    s.close()
    for call in (lambda: s.get("a"), lambda: s.set("a", np.zeros((13, 3))), lambda: s.step(1), lambda: s.shape("a")):
        with pytest.raises(DeviceError, match="closed"):
            call()
    with runtime.load(bundle, gpu.device) as again:  # the device is not the session's to close
        again.step(1)
    gpu.silent()


def test_a_session_that_opened_its_device_closes_it(bundle):
    with runtime.load(bundle, DEVICE, validation=True) as s:
        s.step(2)
        device = s.device
    assert device.device is None and device.messages == []


def test_a_value_that_no_plan_reads_can_still_be_set(gpu, tmp_path):
    p = Program()
    p.input("unused", IMAGE)
    p.plan("see", {}, {"y": (p.input("x", UNIT, 2.0) * 2.0, UNIT)})
    path = tmp_path / "unused.dressi"
    compile_program(p, "vulkan_min", path)
    with runtime.load(path, gpu.device) as s:
        s.set("unused", np.ones((5, 7, 3)))
        np.testing.assert_array_equal(s.get("unused"), 1)
        assert s.get("y") == 4
    gpu.silent()
