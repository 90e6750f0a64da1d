"""Packing: whatever the profile, the same numbers; never more than the profile allows; the same bundle every time.

Random graphs (tests/graphs.py) are compiled for several profiles, packed and one function a pass, run on lavapipe, and compared
with the float64 reference.
"""

import numpy as np
import pytest
from graphs import Graph, python

from dressi_edge.cache import bundle
from dressi_edge.cache import vulkan as v
from dressi_edge.cache.errors import PackError
from dressi_edge.cache.layout import Layout
from dressi_edge.cache.profile import Profile
from dressi_edge.compiler import Program, describe
from dressi_edge.compiler.functions import apply
from dressi_edge.compiler.ir import topological
from dressi_edge.compiler.pack import FORMAT_BITS
from dressi_edge.compiler.reference import evaluate
from dressi_edge.compiler.simplify import lower, simplify

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
        description, assembler = describe(graph.program, profile)
        found = list(demands(description))
        assert found
        for plan, counts in found:
            for name, count in counts.items():
                assert count <= profile.limit(name), f"{plan}: {name}"
        for name, count in description["needs"]["limits"].items():
            assert count <= profile.limit(name), name
        for _, stages in assembler.stage_lists:
            for s in (s for stage in stages for s in stage.substages):
                bits = sum(FORMAT_BITS[n.vtype] for n in s.outputs)
                assert not profile.tile_bits or bits <= profile.tile_bits or len(s.outputs) == 1


@pytest.mark.parametrize("profile", PROFILES)
def test_what_is_read_was_written_before_and_each_root_is_written_once(profile):
    for seed in (0, 1, 2):
        graph, _ = given(seed)
        _, assembler = describe(graph.program, Profile.load(profile))
        for _, stages in assembler.stage_lists:
            written = set()
            for s in (s for stage in stages for s in stage.substages):
                for x, _ in s.reads:
                    assert x.op.stage == "leaf" or x in written, f"{s.outputs} reads {x} too early"
                assert not written & set(s.outputs) and len({n.extent for n in s.nodes}) == 1
                written |= set(s.outputs)


def test_packing_makes_far_fewer_passes_than_functions():
    def passes(graph, naive):
        return sum(len(stages) for _, stages in describe(graph.program, Profile.load("lavapipe"), naive=naive)[1].stage_lists)

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


def test_a_function_that_fits_no_profile_is_named_with_the_limit():
    program = Program()
    x = program.input("x", Layout("image", "float", 5000, 2))
    program.plan("p", {}, {"y": (x * 2.0, Layout("image", "float", 5000, 2))})
    with pytest.raises(PackError, match=r"mul.*5000 maxFramebufferWidth; profile limit4 allows 4096"):
        describe(program, Profile.load("limit4"))


# The same bundle every time


BUILD = """
import sys
from graphs import Graph
from dressi_edge.compiler import Program, compile_program
from dressi_edge.compiler.functions import apply
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
        description, assembler = describe(graph.program, Profile.load("limit4"))
        return bundle.dumps(description, assembler.blobs)

    graph, _ = given(seed)
    first = dumped(graph)
    assert dumped(graph) == first
    assert dumped(given(seed)[0]) == first
    others = [Graph(k + 50).nodes for k in range(5)]  # noqa: F841
    del graph
    assert dumped(given(seed)[0]) == first


def test_what_is_packed_is_what_simplify_left():
    """Every root is written, and no composite op is left for a shader to do."""
    graph, _ = given(0)
    _, assembler = describe(graph.program, Profile.load("lavapipe"), cache=False)
    roots = simplify(lower([n for spec in graph.program.plans for n in spec.outputs.values()]))
    packed = {n for _, stages in assembler.stage_lists for stage in stages for s in stage.substages for n in s.nodes}
    assert {n for n in roots if n.op.stage == "pixel"} <= packed
    assert all(n.op.stage in ("pixel", "raster") for n in packed)
    assert not any(n.op.stage == "composite" for n in topological(roots))
