"""What a shader holds at once is counted as it is computed, and a profile's bound on it is kept where anything helps."""

from dataclasses import replace

import numpy as np
import pytest
from drivers import whole

from dressi_edge.cache.layout import Layout
from dressi_edge.cache.profile import Profile, canonical, merge
from dressi_edge.compiler import Options, Program, build
from dressi_edge.compiler.backend.emit import emit
from dressi_edge.compiler.graph.functions import apply, gather_sum
from dressi_edge.compiler.graph.ir import UNIT
from dressi_edge.compiler.passes import split
from dressi_edge.compiler.passes.groups import grouped, lowered
from dressi_edge.compiler.passes.lists import find_lists
from dressi_edge.compiler.passes.pack import pack_substages
from dressi_edge.compiler.passes.plans import plan_graphs, stored
from dressi_edge.compiler.passes.pressure import peak, statements
from dressi_edge.compiler.passes.split import crowded

pytest_plugins = ["gpu"]

SIZE = Layout("image", "float", 6, 5)


def roomy(most=None):
    return replace(Profile.load("lavapipe"), name="bounded", max_live=most)


def substages(program, profile):
    return [s for stages in build(program, profile).stages.values() for stage in stages for s in stage.substages]


def folded(count, outputs=1):
    """Sums and products of the same `count` values: all are held when the sum is done and the product is not."""
    program = Program()
    x = program.input("x", SIZE)
    values = [apply("sin", x * float(k + 1)) for k in range(count)]
    made = {}
    for k in range(outputs):
        total, product = values[0], values[-1] * float(k + 2)
        for value in values[1:]:
            total = total + value
        for value in reversed(values[:-1]):
            product = apply("cos", product * value)
        made[f"y{k}"] = (total * product, SIZE)
    program.plan("p", {}, made)
    return program


def test_values_that_are_needed_later_are_counted_and_no_others():
    program = Program()
    x, one = program.input("x", SIZE), program.input("one", Layout("unit", "float"))
    a, b = apply("sin", x), apply("cos", x)
    c = a * b * one
    program.plan("p", {}, {"c": (c, SIZE)})
    s, = substages(program, roomy())
    assert s.outputs == (c,) and one.extent == UNIT
    assert peak(s.nodes, s.outputs).count == 3  # x, a and b where b is made; `one` is the same everywhere
    assert peak([c.inputs[0]], [c.inputs[0]]).count == 3  # a and b, read, and what is made of them


def test_vectors_count_by_channel_and_results_stay_to_the_end():
    program = Program()
    x = program.input("x", Layout("image", "vec4", 6, 5))
    made = {f"y{k}": (apply("sin", x + float(k)), Layout("image", "vec4", 6, 5)) for k in range(3)}
    program.plan("p", {}, made)
    s, = substages(program, roomy())
    assert peak(s.nodes, s.outputs).count == 16  # two results, the third and what it is made of; x is gone


@pytest.mark.parametrize("count", [3, 10, 40])
def test_what_is_held_over_a_stretch_is_counted_and_named(count):
    s, = substages(folded(count), roomy())
    found = peak(s.nodes, s.outputs)
    assert count <= found.count <= count + 2
    assert set(found.across) <= set(s.nodes)


def test_loops_come_after_what_needs_none_and_what_they_need_is_held_across():
    program, count = Program(), 12
    kind = Layout("table", "float", count=count)
    x, y = program.input("x", kind), program.input("y", kind)
    ranges, order = np.stack([np.arange(count), np.arange(count) + 1], 1), np.arange(count)
    before = apply("sin", y)
    made = gather_sum(x, ranges, order) * before
    program.plan("p", {}, {"z": (made, kind)})
    s, = substages(program, roomy())
    order = statements(s.nodes)
    loops = [k for k, together in enumerate(order) if together[0].op.loop]
    at = {together[0]: k for k, together in enumerate(order)}
    assert len(loops) == 1 and at[before] < loops[0] < at[made]
    assert peak(s.nodes, s.outputs).count >= 2


def summed(views, **channels):
    """Sums of pixels by entry, for each view in one loop; channels: what each adds up in every view, by its number of channels."""
    program = Program()
    box = program.input("box", Layout("table", "ivec4", count=12))
    made = {}
    for view in range(views):
        fours = program.input(f"fours{view}", Layout("image", "ivec4", 4, 16))
        bins = program.input(f"bins{view}", Layout("image", "ivec4", 2, 2))
        for name, count in channels.items():
            values = program.input(f"{name}{view}", Layout("image", f"vec{count}", 16, 16))
            made[f"{name}_sum{view}"] = apply("segment_sum", values, fours, box, bins), Layout("table", f"vec{count}", count=12)
    program.plan("p", {}, made)
    return program


@pytest.mark.parametrize("views, channels, count", [
    (1, {"a": 3}, 3 + 3), (1, {"a": 3, "b": 4}, 7 + 7), (2, {"a": 3}, 6 + 3), (2, {"a": 3, "b": 4}, 14 + 7)])
def test_a_loop_holds_its_own_variables_and_what_all_that_share_it_fetch_in_a_turn(views, channels, count):
    """Of loops that do not share a header one turns after the other, while the results of all are there."""
    s, = substages(summed(views, **channels), roomy())
    own = {n.op.loop.holds for n in s.nodes}
    assert peak(s.nodes, s.outputs).count == 4 + count + own.pop() and not own  # the box, and results beside what is fetched


def test_sums_whose_turns_hold_too_much_are_given_to_more_shaders():
    program = summed(1, a=3, b=4, c=4, d=3)
    free, bound = substages(program, roomy()), substages(program, roomy(40))
    assert len(free) == 1 and len(bound) == 2 and max(peak(s.nodes, s.outputs).count for s in bound) <= 40
    assert sum(n.op.cost for s in bound for n in s.nodes) == sum(n.op.cost for n in free[0].nodes)  # nothing twice


@pytest.mark.parametrize("count, outputs, most", [(40, 1, 24), (40, 6, 44), (60, 3, 32)])
def test_a_bound_makes_more_substages_and_the_same_numbers(gpu, count, outputs, most):
    program, feed = folded(count, outputs), {"x": np.linspace(-1, 1, 30).reshape(5, 6, 1)}
    free, bound = substages(program, roomy()), substages(program, roomy(most))
    assert len(free) == 1 and crowded(free[0].nodes, free[0].outputs, roomy(most))
    assert len(bound) > 1 and max(peak(s.nodes, s.outputs).count for s in bound) <= most
    assert {n for s in bound for n in s.outputs} >= set(free[0].outputs)
    expected, found = gpu.run(program, feed, roomy()), gpu.run(program, feed, roomy(most))
    for name in expected:  # not to the bit: a driver's compiler simplifies within a shader
        np.testing.assert_allclose(found[name], expected[name], rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("name, device, times", [("lambert", "apple_m1_honeykrisp", 1.25), ("colors3", "apple_m1_honeykrisp", 1.3)])
def test_of_a_whole_problem_every_shader_keeps_the_bound_for_a_little_more_work(name, device, times, monkeypatch):
    """Cut by outputs alone, as where registers are the only reason to cut it was before, Lambert's step for M1 is 1.9 times the work."""
    made = whole.CASES[name]()
    program, profile = getattr(made, "program", made), Profile.load(device)
    groups = tuple(find_lists(g, program, profile, Options().lists) for g in lowered(grouped(program), None))
    roots = next(p for p in (stored(p, program) for p in plan_graphs(groups, program, True)) if p.name == "fit").roots

    def work(found):
        return sum(n.op.cost * s.extent.count for s in found for n in s.nodes if not s.raster)

    bound = pack_substages(roots, profile)
    assert max(peak(s.nodes, s.outputs).count for s in bound if not s.raster) <= profile.max_live
    assert work(bound) <= times * work(pack_substages(roots, replace(profile, max_live=None)))
    monkeypatch.setattr(split, "_relieved", split._cut)
    assert work(bound) < work(pack_substages(roots, profile))


def test_what_is_stored_to_relieve_a_shader_is_stored_once_and_the_numbers_are_the_same(gpu):
    """Two results, each of a way there and back over the same 30 values: a shader of both holds all of them; so does one of one."""
    program, kind = Program(), Layout("image", "float", 6, 5)
    x = program.input("x", kind)
    there = [apply("sin", x)]
    for k in range(30):
        there.append(apply("sin", there[-1] * (1.5 + 0.01 * k) + 0.1 * k))
    back = [there[-1], apply("cos", there[-1])]
    for value in reversed(there):
        back = [b * value + apply("cos", value * float(k + 1)) for k, b in enumerate(back)]
    program.plan("p", {}, {f"y{k}": (b, kind) for k, b in enumerate(back)})
    free, bound = substages(program, roomy()), substages(program, roomy(20))
    assert len(free) == 1 and peak(free[0].nodes, free[0].outputs).count > 30
    assert max(peak(s.nodes, s.outputs).count for s in bound) <= 20
    given = [n for s in bound for n in s.outputs]
    assert len(given) == len(set(given))
    feed = {"x": np.linspace(-1, 1, 30).reshape(5, 6, 1)}
    expected, found = gpu.run(program, feed, roomy()), gpu.run(program, feed, roomy(20))
    for name in expected:
        np.testing.assert_allclose(found[name], expected[name], rtol=1e-4, atol=1e-4)


def test_a_bound_that_nothing_can_keep_stops_nothing():
    """A function of two inputs holds three numbers, whatever is cut."""
    made = substages(folded(6), roomy(1))
    assert made == substages(folded(6), roomy()) and peak(made[0].nodes, made[0].outputs).count > 1


def test_profiles_without_a_bound_are_what_they_were_and_the_least_binds_in_a_merge():
    free, tight = roomy(), roomy(40)
    assert "max_live" not in canonical(free) and canonical(tight)["max_live"] == 40 and free.digest != tight.digest
    assert merge([free, tight, roomy(50)], "m").max_live == 40 and merge([free, free], "m").max_live is None
    assert substages(folded(10), free) == substages(folded(10), roomy(1000))


def test_loops_keep_over_all_turns_what_a_shader_has_room_for_and_the_bits_are_the_same(gpu):
    """Every-face rendering's gradient fetches a face's corners and colours once, or at each pixel of its box where registers are few; its
    six results, 21 numbers beside 38, then come from two shaders."""
    found = {}
    for most, together in ((None, True), (120, True), (50, False)):
        program, profile = whole.binned().program, roomy(most)
        stages = build(program, profile).stages["fit"]
        (given, text), = [({n.op.name for n in s.nodes}, code.draws[0].fragment) for stage, codes in zip(stages, emit(stages, profile))
                          for s, code in zip(stage.substages, codes) if any(n.op.name == "soft_place_gradient" for n in s.nodes)]
        before, _, turn = text.partition("for (;;)")
        assert ("vec4 v0_" in before, "vec4 v0_" in turn, "soft_color_gradient" in given) == (together, not together, together)
        with gpu.open(program, profile) as session:
            session.step(3, "fit")
            found[most] = [session.get(name) for name in ("vertices", "colors", "fit.loss")]
    gpu.silent()
    for most in (120, 50):
        for expected, got in zip(found[None], found[most]):
            np.testing.assert_array_equal(got, expected)
