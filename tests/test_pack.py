"""Packing: whatever the profile, the same numbers; never more than the profile allows; the same bundle every time.

Random graphs (tests/graphs.py) are compiled for several profiles, packed and one function a pass, run on lavapipe, and compared
with the float64 reference.
"""

import dataclasses
import gc

import numpy as np
import pytest
from graphs import Graph, python

from dressi_edge.cache import bundle
from dressi_edge.cache import vulkan as v
from dressi_edge.cache.errors import PackError
from dressi_edge.cache.layout import Layout
from dressi_edge.cache.profile import Profile
from dressi_edge.compiler import Options, Program, build
from dressi_edge.compiler.graph.autodiff import gradients
from dressi_edge.compiler.graph.formats import format_bits
from dressi_edge.compiler.graph.functions import apply, constant_table, dot, gather_sum, mean, select, sigmoid, total
from dressi_edge.compiler.graph.ir import intern, topological
from dressi_edge.compiler.graph.reference import evaluate
from dressi_edge.compiler.io.cameras import orbit
from dressi_edge.compiler.io.shapes import sphere
from dressi_edge.compiler.passes import pack, split, substage
from dressi_edge.compiler.passes.simplify import lower, simplify
from dressi_edge.compiler.render.optimizer import Adam
from dressi_edge.compiler.render.raster import Softness
from dressi_edge.compiler.scene.problem import Loss, Problem

pytest_plugins = ["gpu"]

PROFILES = ["limit4", "limit8", "unlimited", "lavapipe"]
SEEDS = [*range(4), *(pytest.param(s, marks=pytest.mark.full) for s in range(4, 60))]
TOLERANCE = 2e-5  # of values within [-4, 4] after some thirty operations in fp32


def given(seed, size=40):
    graph = Graph(seed, size)
    roots = graph.plan()
    layouts = [graph.program.values[f"y{k}"].layout for k in range(len(roots))]
    return graph, {f"y{k}": layout.from_image(y) for k, (layout, y) in enumerate(zip(layouts, evaluate(roots, graph.feed)))}


def close(found, expected, where):
    assert found.keys() == expected.keys()
    for name in found:
        np.testing.assert_allclose(found[name], expected[name], rtol=TOLERANCE, atol=4 * TOLERANCE, err_msg=f"{where} {name}")


@pytest.mark.parametrize("seed", SEEDS)
def test_packed_and_naive_are_the_reference_on_every_profile(gpu, seed):
    graph, expected = given(seed)
    close(gpu.run(graph.program, graph.feed, naive=True), expected, "naive")
    for profile in PROFILES:
        close(gpu.run(graph.program, graph.feed, profile), expected, profile)


# What is left out of a pass is cleared, unless nothing reads it


@pytest.mark.parametrize("read, cleared", [(("sum",), 1), (("sum", "mean"), 2)], ids=["by name", "by more"])
def test_what_is_read_only_where_something_is_named_is_not_cleared(gpu, read, cleared):
    """The pixels' values, which a segment takes from those that name it: outside of the marked tiles nothing does."""
    program, rng = Program(), np.random.default_rng(3)
    pixels, kind = Layout("image", "int", 32, 32), Layout("table", "vec3", count=5)
    names, table = program.input("names", pixels), program.input("table", kind)
    tiles = apply("occupied", names, width=16, height=16)
    place = apply("inside_tiles", names + 1, tiles, tile=(16, 16))
    box = constant_table(np.tile([0, 0, 32, 32], (5, 1)))
    near = apply("lookup_near", table, place, box, constant_table(np.full((5, 4), 16.0)), constant_table(np.zeros((5, 2))), reach=99.0,
                 channel=0)
    values = sigmoid(near) * sigmoid(near * 0.25)
    outside = select(place > 0, values, 0.0)
    outputs = {"sum": (gradients(total(dot(outside, outside)), [table])[0], kind), "mean": (mean(outside), Layout("unit", "vec3"))}
    program.plan("all", {}, {name: outputs[name] for name in read})
    picked = np.where((np.arange(32) < 11)[:, None] & (np.arange(32) > 20), rng.integers(-1, 5, (32, 32)), -1)
    feed = {"names": picked, "table": rng.normal(size=(5, 3))}
    description = build(program, Profile.load("lavapipe")).description
    guarded = [stage for stage in description["plans"][0]["stages"] if stage["width"] == 32]
    loads = [a["load"] for stage in guarded for a in description["passes"][stage["pass"]]["attachments"]]
    assert loads.count(v.LOAD_CLEAR) == cleared and loads.count(v.LOAD_DONT_CARE) == 1
    images = {name: program.values[name].layout.to_image(x, name) for name, x in feed.items()}
    found = gpu.run(program, images)
    for name, want in zip(read, evaluate([outputs[name][0] for name in read], images)):
        np.testing.assert_allclose(found[name], outputs[name][1].from_image(want), rtol=1e-5, atol=1e-5)


# What a pass may ask of a device, counted from the description that the runtime reads


def demands(description):
    """For each draw {limit: how much of it}, and bits of colour, counted by hand."""
    for plan in description["plans"]:
        for stage in plan["stages"]:
            record = description["passes"][stage["pass"]]
            for subpass, draws in zip(record["subpasses"], stage["subpasses"]):
                colors = len(subpass["colors"])
                for draw in draws:
                    bindings = description["pipelines"][draw["pipeline"]]["bindings"]
                    images = [b for b in bindings if b[0] != v.DESCRIPTOR_INPUT_ATTACHMENT]
                    counts = {"maxColorAttachments": colors, "maxFragmentOutputAttachments": colors,
                              "maxFragmentCombinedOutputResources": colors, "maxDescriptorSetSampledImages": len(images),
                              "maxPerStageDescriptorInputAttachments": len(bindings) - len(images),
                              "maxFramebufferWidth": stage["width"], "maxFramebufferHeight": stage["height"]}
                    for bit in (v.STAGE_VERTEX, v.STAGE_FRAGMENT):
                        seen = sum(bool(b[1] & bit) for b in bindings)
                        counts["maxPerStageDescriptorSampledImages"] = max(
                            counts.get("maxPerStageDescriptorSampledImages", 0), sum(bool(b[1] & bit) for b in images))
                        counts["maxPerStageResources"] = max(counts.get("maxPerStageResources", 0),
                                                             seen + (colors if bit == v.STAGE_FRAGMENT else 0))
                    yield plan["name"], counts


@pytest.mark.parametrize("profile", [*PROFILES, "vulkan_min", "raspberry_pi_4", "mali_g76"])
def test_no_pass_asks_for_more_than_the_profile_allows(profile):
    profile = Profile.load(profile)
    for seed in (0, 1, 2):
        graph, _ = given(seed, 60)
        built = build(graph.program, profile)
        description = built.description
        found = list(demands(description))
        assert found
        for plan, counts in found:
            for name, count in counts.items():
                assert count <= profile.limit(name), f"{plan}: {name}"
        for name, count in description["needs"]["limits"].items():
            assert count <= profile.limit(name), name
        for stages in built.stages.values():
            for s in (s for stage in stages for s in stage.substages):
                bits = sum(format_bits(n) for n in s.outputs)
                assert not profile.tile_bits or bits <= profile.tile_bits or len(s.outputs) == 1


@pytest.mark.parametrize("profile", PROFILES)
def test_what_is_read_was_written_before_and_each_root_is_written_once(profile):
    for seed in (0, 1, 2):
        graph, _ = given(seed)
        built = build(graph.program, Profile.load(profile))
        for stages in built.stages.values():
            written = set()
            for s in (s for stage in stages for s in stage.substages):
                for x, _ in s.reads:
                    assert x.op.stage == "leaf" or x in written, f"{s.outputs} reads {x} too early"
                assert not written & set(s.outputs) and len({n.extent for n in s.nodes}) == 1
                written |= set(s.outputs)


def test_packing_makes_far_fewer_passes_than_functions():
    def passes(graph, naive):
        return sum(map(len, build(graph.program, Profile.load("lavapipe"), Options(naive=naive)).stages.values()))

    graphs = [given(seed)[0] for seed in range(2)]
    assert sum(passes(g, False) for g in graphs) < sum(passes(g, True) for g in graphs) / 2


def wide(count, tail=0):
    """A pixel that reads `count` images, some of them late."""
    program = Program()
    layout = Layout("image", "float", 5, 4)
    y = apply("literal", value=0.5)
    for k in range(count):
        x = program.input(f"x{k}", layout)
        y = apply("sin", y * x + x)
    outputs = {"y": (y, layout)} | {f"z{k}": (y + program.values[f"x{k}"].node, layout) for k in range(tail)}
    program.plan("p", {}, outputs)
    return program, {f"x{k}": np.random.default_rng(k).normal(size=(4, 5, 1)) for k in range(count)}


@pytest.mark.parametrize("count, tail", [(3, 0), (16, 0), (17, 0), (40, 0), (40, 9)])
def test_a_pixel_that_reads_more_images_than_fit_is_cut(gpu, count, tail):
    program, feed = wide(count, tail)
    roots = program.plans[0].outputs.values()
    expected = dict(zip(program.plans[0].outputs, (y[..., 0] for y in evaluate(roots, feed))))
    close(gpu.run(program, feed, "limit4"), expected, "limit4")


def test_more_outputs_than_attachments_are_split(gpu):
    program, layout = Program(), Layout("image", "vec4", 5, 4)
    x = program.input("x", layout)
    program.plan("p", {}, {f"y{k}": (x * float(k + 2), layout) for k in range(21)})
    value = np.random.default_rng(0).normal(size=(4, 5, 4))
    for profile in PROFILES[:2]:
        found = gpu.run(program, {"x": value}, profile)
        for k in range(21):
            np.testing.assert_allclose(found[f"y{k}"], value * (k + 2), rtol=1e-6)


@pytest.mark.parametrize("count, times", [(100, 3), (20_000, 1)])
def test_what_parts_of_a_split_share_is_computed_once_if_it_is_dear(gpu, count, times):
    """Three results of 128 bits, of which a tile holds one: a sum over many texels is stored before them, one over few made again."""
    program, rng = Program(), np.random.default_rng(5)
    kind = Layout("table", "vec4", count=count)
    x, rates = program.input("x", kind), [program.input(f"rate{k}", kind) for k in range(3)]
    near = gather_sum(x, np.stack([np.arange(count), np.arange(count) + 1], 1), (np.arange(count) * 7 + 3) % count)
    made = {f"y{k}": (near * rate + near, kind) for k, rate in enumerate(rates)}
    program.plan("p", {}, made)
    stages = pack.pack(simplify(lower([y for y, _ in made.values()])), Profile.load("mali_g76"))
    assert sum(n.op.name == "gather_sum" for stage in stages for s in stage.substages for n in s.nodes) == times
    values = {name: rng.normal(size=(count, 4)) for name in ("x", "rate0", "rate1", "rate2")}
    expected = {f"y{k}": values["x"][(np.arange(count) * 7 + 3) % count] * (values[f"rate{k}"] + 1) for k in range(3)}
    with gpu.open(program, "mali_g76") as session:
        for name, value in values.items():
            session.set(name, value)
        close({name: session.get(name) for name in expected}, expected, "mali_g76")


def test_a_function_that_fits_no_profile_is_named_with_the_limit():
    program = Program()
    x = program.input("x", Layout("image", "float", 5000, 2))
    program.plan("p", {}, {"y": (x * 2.0, Layout("image", "float", 5000, 2))})
    with pytest.raises(PackError, match=r"mul.*5000 maxFramebufferWidth; profile limit4 allows 4096"):
        build(program, Profile.load("limit4"))


# Splitting is fast, and does what it did when it was simple


def simple_split(nodes, outputs, profile):
    """`split._parts` as its text says it, counting everything anew for each part that is tried."""
    whole = substage.substage(nodes, outputs)
    if not substage.excess(whole, profile):
        return [whole]
    result, stored, pending = [], set(), list(outputs)

    def part(outputs):
        return substage.substage(pack._needed([n for n in nodes if n not in stored], outputs), outputs)

    while pending:
        taken = []
        while pending and not substage.excess(part([*taken, pending[0]]), profile):
            taken.append(pending.pop(0))
        if taken:
            result.append(part(taken))
            stored.update(taken)
        else:
            inside = [part([n]) for n in part(pending[:1]).nodes[:-1]]
            fitting = [p for p in inside if p.reads and not substage.excess(p, profile)]
            if not fitting:
                raise PackError("nothing fits")
            pending.insert(0, max(fitting, key=lambda p: len(p.reads)).outputs[0])
    return result


def tangle(size, inputs=20, seed=0):
    """Roots of a random graph of one extent: `size` functions of two, late ones and any."""
    program, rng, layout = Program(), np.random.default_rng(seed), Layout("image", "float", 5, 4)
    nodes = [program.input(f"x{k}", layout) for k in range(inputs)]
    for m in range(inputs, size + inputs):
        nodes.append(apply(("sin", "add")[m % 2], *(nodes[int(rng.integers(low, m))] for low in (max(0, m - 99), 0)[:1 + m % 2])))
    used = {x for n in nodes for x in n.inputs}
    return [n for n in nodes if n not in used and n.op.stage == "pixel"]


def tight(images, colors):
    limit4 = Profile.load("limit4")
    return dataclasses.replace(limit4, name="tight", limits={
        **limit4.limits, "maxPerStageDescriptorSampledImages": images, "maxColorAttachments": colors, "maxPerStageResources": images + 3})


@pytest.mark.parametrize("seed", SEEDS)
def test_a_split_is_what_trying_everything_gives(seed, monkeypatch):
    graph = Graph(seed, 60)
    mixed = simplify(lower([n for n in graph.nodes if n.op.stage not in ("leaf", "inline")]))
    mixed = [n for n in dict.fromkeys(mixed) if n.op.stage not in ("leaf", "inline")]
    for roots in (mixed, tangle(120, 20, seed), [*wide(40)[0].plans[0].outputs.values()]):
        for profile in (tight(3, 1), tight(5, 4), tight(8, 2), Profile.load("limit4"), Profile.load("mali_g76")):
            found = []
            for cut in (split._parts, simple_split):
                with monkeypatch.context() as patched:
                    patched.setattr(split, "_parts", cut)
                    try:
                        found.append(pack.pack_substages(roots, profile))
                    except PackError:
                        found.append("an error")
            assert found[0] == found[1]


@pytest.mark.parametrize("name", ["limit4", "limit8", "unlimited", "mali_g76"])
@pytest.mark.parametrize("make", [lambda n: tangle(n), lambda n: [*wide(n // 3)[0].plans[0].outputs.values()]], ids=["tangle", "wide"])
def test_the_work_of_packing_grows_as_the_graph_does(monkeypatch, make, name):
    """Counted in looks at a function's inputs and at limits; a sum over pairs of functions would grow sixteenfold."""
    looks, profile = [0], Profile.load(name)

    def counted(f):
        def call(*args):
            looks[0] += 1
            return f(*args)
        return call

    for function in ("edges", "excess_of"):
        call = counted(getattr(substage, function))
        for module in (pack, split, substage):
            if hasattr(module, function):
                monkeypatch.setattr(module, function, call)
    work = []
    for size in (900, 3600):
        roots, looks[0] = make(size), 0
        pack.pack_substages(roots, profile)
        work.append(looks[0])
    assert work[1] < 8 * work[0]


# The same bundle every time


BUILD = """
import sys
from graphs import Graph
from dressi_edge.compiler import Program, compile_program
from dressi_edge.compiler.graph.functions import apply
if sys.argv[2] == "later":  # other nodes first: addresses and serial numbers differ
    others = [Graph(k).program for k in range(90, 93)]
graph = Graph(4, 40)
graph.plan()
compile_program(graph.program, "limit8", sys.argv[1])
"""


def test_one_program_is_one_bundle_whatever_the_process_its_hashes_and_its_history(tmp_path):
    paths = [tmp_path / f"{k}.dressi" for k in range(3)]
    for path, history, seed in zip(paths, ("first", "first", "later"), ("0", "1", "2")):
        python(BUILD, path, history, PYTHONHASHSEED=seed)
    first, *others = [path.read_bytes() for path in paths]
    assert all(other == first for other in others)


@pytest.mark.parametrize("seed", range(3))
def test_one_program_built_or_compiled_twice_is_one_bundle(seed):
    def dumped(graph):
        built = build(graph.program, Profile.load("limit4"))
        return bundle.dumps(built.description, built.blobs)

    graph, _ = given(seed)
    first = dumped(graph)
    assert dumped(graph) == first
    assert dumped(given(seed)[0]) == first
    others = [Graph(k + 50).nodes for k in range(5)]  # noqa: F841
    del graph
    assert dumped(given(seed)[0]) == first


def recipe(program):
    """The graph of a program as rows (op, numbers of inputs, ...), without its nodes."""
    order = topological(n for spec in program.plans for n in (*spec.updates.values(), *spec.outputs.values()))
    at = {n: k for k, n in enumerate(order)}
    return [(n.op, tuple(at[x] for x in n.inputs), n.attrs, n.vtype, n.extent) for n in order]


def made_in_another_order(rows, rng):
    """The same nodes, made anew in a random order: what is alive when another program with parts in common is."""
    made, ready = {}, [k for k, row in enumerate(rows) if not row[1]]
    waiting, users = {k: len(set(row[1])) for k, row in enumerate(rows)}, {k: [] for k in range(len(rows))}
    for k, row in enumerate(rows):
        for x in set(row[1]):
            users[x].append(k)
    while ready:
        k = ready.pop(rng.integers(len(ready)))
        op, inputs, *rest = rows[k]
        made[k] = intern(op, tuple(made[x] for x in inputs), *rest)
        for user in users[k]:
            waiting[user] -= 1
            if not waiting[user]:
                ready.append(user)
    return list(made.values())


def colors_of_two_layers():
    """The program of a small problem that draws and optimizes all there is."""
    problem = Problem(sphere(42, 0.7), orbit(2, (20.0,), 3.0, 42.0, (24, 20)), albedo="colors")
    problem.phase("fit", 10, {"vertices": Adam(0.01), "colors": Adam(0.03)}, [Loss("silhouette"), Loss("color"), Loss("laplacian", 0.1)],
                  Softness(2.0, layers=2))
    return problem.program


@pytest.mark.parametrize("make", [colors_of_two_layers, lambda: given(0)[0].program, lambda: given(2, 60)[0].program],
                         ids=["problem", "graph 0", "graph 2"])
def test_a_bundle_does_not_depend_on_what_else_is_alive_and_shares_its_nodes(make):
    def dumped(program):
        made = build(program, Profile.load("limit8"))
        return bundle.dumps(made.description, made.blobs)

    program = make()
    first, rows = dumped(program), recipe(program)
    del program
    gc.collect()
    others = made_in_another_order(rows, np.random.default_rng(1))
    serials = {n.serial for n in others}
    program = make()
    shared = {n.serial for spec in program.plans for n in topological((*spec.updates.values(), *spec.outputs.values()))}
    assert len(shared & serials) > 0.3 * len(shared), "little is shared: the test says nothing"
    assert dumped(program) == first


def test_what_is_packed_is_what_simplify_left():
    """Every root is written, and no composite op is left for a shader to do."""
    graph, _ = given(0)
    built = build(graph.program, Profile.load("lavapipe"), Options(cache=False))
    roots = simplify(lower([n for spec in graph.program.plans for n in spec.outputs.values()]))
    packed = {n for stages in built.stages.values() for stage in stages for s in stage.substages for n in s.nodes}
    assert {n for n in roots if n.op.stage == "pixel"} <= packed
    assert all(n.op.stage in ("pixel", "raster") for n in packed)
    assert not any(n.op.stage == "composite" for n in topological(roots))
