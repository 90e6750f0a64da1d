"""The op table is the test list: every gradient against central differences, every snippet on lavapipe against the reference.

An op is tested on its own `sample`, or on three-channel normals; CASES adds what the table gives no sample of. A row
that neither covers fails here.
"""

from typing import NamedTuple

import brute_force
import numpy as np
import pytest
from corpus import icosahedron, project, rotation
from graphs import image_layout, layout_of, rounded
from undertest import margin

from dressi_edge.cache.layout import Layout
from dressi_edge.compiler import Program
from dressi_edge.compiler import check_op as check
from dressi_edge.compiler.graph.autodiff import gradients
from dressi_edge.compiler.graph.functions import apply, compose, constant_table, dot, gather_sum, lookup, normalize, select, total
from dressi_edge.compiler.graph.ir import Node, topological
from dressi_edge.compiler.graph.ir import image as image_extent
from dressi_edge.compiler.graph.ops.arithmetic import _compare
from dressi_edge.compiler.graph.ops.lookup import to_table
from dressi_edge.compiler.graph.ops.raster_reference import segment_distance2
from dressi_edge.compiler.graph.optable import EMPTY, NEGATIVE, OPS, ZERO, elementwise, floats, integers
from dressi_edge.compiler.graph.reference import evaluate
from dressi_edge.compiler.render.atlas import Atlas
from dressi_edge.compiler.render.raster import Outline, Softness, rasterized
from dressi_edge.compiler.render.topology import Topology

pytest_plugins = ["gpu"]

WITHOUT_INPUTS = {"texel_index": {"extent": image_extent(6, 4)},
                  "cell_position": {"extent": image_extent(10, 12), "cell_w": 5, "cell_h": 4},
                  "cell_index": {"extent": image_extent(10, 12), "cell_w": 5, "cell_h": 4}}
RASTER = [o for o in OPS.values() if o.name.startswith("rasterize")]
SNIPPETS = [o for o in OPS.values() if o.stage in ("pixel", "kernel") or o.lower or o.stage == "raster" and o not in RASTER]
GRADIENTS = [o for o in OPS.values() if o.vjp is not None]
ids = {"ids": lambda o: o.name}


def seeded(name):
    return np.random.default_rng(list(name.encode()))


def sample(o):
    """Arguments (arrays or nodes) and attributes."""
    rng = seeded(o.name)
    if o.name in WITHOUT_INPUTS:
        return [], WITHOUT_INPUTS[o.name]
    if o.name == "sum":
        return [rng.normal(size=(4, 5, 3))], {"count": 20}
    if o.name == "nearest_edge":
        faces, edges, views = 5, 7, 2
        codes = rng.integers(-1, 2 * faces * views, (6, 8, 1))
        return [codes, constant_table(rng.integers(0, edges, (faces, 3))), to_table(rng.normal(size=(edges * views, 4))),
                rng.normal(size=(6, 8, 2)), rng.integers(0, 2, (6, 8, 1))], {"face_count": faces, "edge_count": edges}
    if o.name == "fold_segments":
        edges, views, vertices = 8, 2, 6
        ends = np.array([rng.permutation(vertices)[:4] for _ in range(edges)])
        ends[2, 3] = -1
        return [to_table(rng.normal(size=(vertices * views, 4))), constant_table(ends)], {
            "edge_count": edges, "vertices": vertices, "views": views, "near": 0.1, "cell_w": 20, "cell_h": 14}
    if o.sample:
        return o.sample(rng)
    return [rng.normal(size=(4, 5, 3)) for _ in o.params], {}


def test_every_row_has_its_place_in_these_tests():
    leaves = {o.name for o in OPS.values() if o.stage in ("leaf", "inline")}
    assert leaves == {"literal", "constant", "input", "state", "cached"}
    assert {o.stage for o in OPS.values()} == {"leaf", "inline", "pixel", "raster", "kernel", "composite"}
    assert {o.name for o in OPS.values() if o.stage == "composite"} == {
        "sum", "exclusive_scan", "bincount", "sample_mips", "sample_along", "sample_lobes"}
    assert all((o.kernel is not None) == (o.stage == "kernel") for o in OPS.values())
    assert {"rasterize", "rasterize_covered", "rasterize_first", "rasterize_hard", "rasterize_peel",
            "rasterize_segments", "rasterize_contours"} == {o.name for o in RASTER}
    tested = {o.name for o in (*SNIPPETS, *RASTER)} | leaves | {"sum"}
    assert tested == OPS.keys()


# Facts


@pytest.mark.parametrize("o, when", [pytest.param(o, when, id=f"{o.name}-{o.params[when.input]}-{when.what}")
                                     for o in OPS.values() for when in o.when])
def test_an_input_makes_of_the_result_what_the_table_says(o, when):
    arguments, attrs = sample(o)
    arrays = [evaluate([x], {})[0] if isinstance(x, Node) else x for x in arguments]
    x = arrays[when.input]
    forced = {ZERO: np.zeros_like(x), NEGATIVE: -1 - abs(x), EMPTY: np.stack([abs(x[..., 0]), abs(x[..., 0]) - 1], -1)}

    def result(x):
        return o.ref(*arrays[:when.input], x, *arrays[when.input + 1:], **attrs)

    assert (result(forced[when.what]) == when.result).all()
    assert (result(np.ones_like(x) if when.flag else x) != when.result).any(), "the sample would not show it"


@pytest.mark.parametrize("o", [o for o in OPS.values() if o.chooses], **ids)
def test_a_choice_is_one_of_two_inputs(o):
    rng = seeded(o.name)
    by, yes, no = rng.integers(0, 2, (4, 5, 1)), rng.normal(size=(4, 5, 3)), rng.normal(size=(4, 5, 3))
    np.testing.assert_array_equal(o.ref(by, yes, no), np.where(by != 0, yes, no))


# Gradients


# inputs that by their documentation get no gradient
UNDIFFERENTIATED = {"sample": {0}, "stop_gradient": {0}, "lookup_near": {3, 4}, "capsule_sum": {3, 4},
                    "soft_blend": {0, 1}}


def check_gradients(name, arguments, attrs, without=frozenset(), build=None):
    """By `compiler/check_op.py`, as ops of users are tested."""
    check.check_gradients(name, arguments, build or (lambda *xs: apply(name, *xs, **attrs)), without)


@pytest.mark.parametrize("o", [o for o in GRADIENTS if o.name != "stop_gradient" and o.name != "lookup"], **ids)
def test_a_vjp_is_the_central_difference(o):
    arguments, attrs = sample(o)
    check_gradients(o.name, arguments, attrs, UNDIFFERENTIATED.get(o.name, set()))


def test_stop_gradient_stops_it():
    x = Program().input("x", image_layout(np.zeros((4, 5, 3))))
    g, = gradients(total(dot(apply("stop_gradient", x * x), x)), [x])
    value = seeded("stop").normal(size=(4, 5, 3))
    np.testing.assert_array_equal(evaluate([g], {"x": value})[0], value * value)


LOOKUPS = {
    "repeated": lambda x: lookup(x, np.array([3, 0, 3, 3, -1, 5, 8, 0])),
    "one_of_a_table": lambda x: lookup(x, constant_table(np.array([4]))),
    "long_rows": lambda x: lookup(x, np.arange(1100) % 2),
    "long_weighted_rows": lambda x: gather_sum(x, np.array([[0, 550], [550, 550], [550, 570]]), np.arange(570) % 9,
                                               np.linspace(-1, 2, 570)),
}


@pytest.mark.parametrize("name", LOOKUPS)
def test_a_lookup_has_its_exact_transpose(name):
    check_gradients(name, [to_table(seeded(name).normal(size=(9, 3)))], {}, build=LOOKUPS[name])


def test_entries_may_be_an_image_of_any_size():
    check_gradients("image", [seeded("image").normal(size=(5, 7, 3))], {}, build=lambda x: lookup(x, np.arange(60) % 35))


def test_a_lookup_by_a_computed_index_of_one_has_its_transpose():
    values = seeded("unit").normal(size=(3, 4, 3))
    index = np.array([[[7]]])
    check_gradients("lookup", [values, index], {})
    check_gradients("lookup", [values, index * 0], {})


# Snippets on the device


class Case(NamedTuple):
    arguments: list
    attrs: dict
    rtol: float


DEFAULT_RTOL = 2e-6
RTOL = {"pow": 2e-5, "sample": 1e-5, "sample_uv_gradient": 1e-5, "sample_mips": 1e-5, "mip_slopes": 1e-5, "mip_footprint": 1e-5,
        "mip_footprints": 1e-5, "sample_along": 1e-5, "levels_along": 1e-5,
        "exp": 1e-5, "sigmoid": 1e-5, "sinh": 2e-5, "cosh": 2e-5, "exp2": 1e-5,
        **{o.name: 1e-5 for o in OPS.values() if o.name.startswith("soft_")}}
SPECIAL = np.array([0.0, 1.0, -1.0, 0.5, -0.5, 2.0, -2.5, 1e-6, -1e-6, 1e-30, -1e-30, 70.0, -70.0, 16777216.0,
                    -16777217.0, 1e30, -1e30])
# Outside these domains GLSL leaves the result open, or grants so wide an error that a comparison says nothing.
DOMAIN = {"log": lambda a: a > 0, "log2": lambda a: a > 0, **dict.fromkeys(("sin", "cos", "tan"), lambda a: abs(a) <= 70),
          "mod": lambda a, b: (abs(a) > 1e-4 * abs(b)) & (abs(a) < 1e3 * abs(b)),
          "div": lambda a, b: abs(b) > 1e-20,
          "pow": lambda a, b: (a >= 0) & (abs(b) <= 2.5), "atan2": lambda a, b: (a != 0) | (b != 0),
          "idiv": lambda a, b: (a >= 0) & (b > 0), "imod": lambda a, b: (a >= 0) & (b > 0),
          "shift_left": lambda a, b: (a >= 0) & (a < 1 << 16) & (b >= 0) & (b < 14),
          "shift_right": lambda a, b: (b >= 0) & (b < 31)}
SPECIAL_INT = np.array([0, 1, -1, 2, 7, 30, -100, 12345, -40000, 2 ** 30, -2 ** 31])
INTEGER_ONLY = {"idiv", "imod", "shift_left", "shift_right", "bit_and", "bit_or", "bit_count"}
INTEGER_TOO = {"add", "sub", "neg", "abs", "sign", "min", "max", "copy", "less", "less_equal", "greater", "greater_equal",
               "equal", "not_equal", "stop_gradient", "kept"}
UNARY_BINARY = [o for o in SNIPPETS if o.infer in (elementwise, floats, integers, _compare) or o.name in ("to_float", "to_int")]


def special_case(o, values):
    """Every pair of special values within the domain, as a row of scalars."""
    grids = [g.ravel() for g in np.meshgrid(*[values] * len(o.params))]
    keep = DOMAIN.get(o.name, lambda *xs: np.ones(xs[0].shape, bool))(*grids)
    if values.dtype.kind == "i" and o.name in ("add", "sub", "neg", "abs"):  # overflow is not the point
        keep &= np.logical_and.reduce([abs(g) < 2 ** 30 for g in grids])
    return [g[keep][None, :, None] for g in grids]


def cases():
    """{(op, case name): Case} over all snippets."""
    out = {}
    for o in SNIPPETS:
        rtol = RTOL.get(o.name, DEFAULT_RTOL)
        arguments, attrs = sample(o)
        out[o.name, "sample"] = Case(arguments, attrs, rtol)
        if o in UNARY_BINARY:
            integer = o.name in INTEGER_ONLY or o.name == "to_float"
            out[o.name, "special"] = Case(special_case(o, SPECIAL_INT if integer else SPECIAL), attrs, rtol)
            if o.name in INTEGER_TOO:
                out[o.name, "special_int"] = Case(special_case(o, SPECIAL_INT), attrs, rtol)
            if o.infer not in (elementwise, floats, integers, _compare) or len(o.params) != 2:
                continue
            for shapes in (((4, 5, 3), (4, 5, 1)), ((4, 5, 1), (4, 5, 3)), ((1, 1, 3), (4, 5, 1)), ((4, 5, 1), (1, 1, 3)),
                           ((1, 1, 1), (4, 5, 4)), ((4, 5, 1), (4, 5, 1)), ((1, 1, 2), (1, 1, 2))):
                rng = seeded(o.name + str(shapes))
                draw = (lambda s: rng.integers(1, 12, s)) if integer else (lambda s: rng.uniform(0.4, 2.0, s))  # noqa: B023
                out[o.name, f"{shapes}"] = Case([draw(s) for s in shapes], attrs, rtol)
    rng = seeded("more")
    ints = rng.integers(-9, 9, (4, 5, 3))
    huge = np.where(rng.random((4, 5, 3)) < 0.5, 3e38, -3e38)
    out["select", "huge"] = Case([rng.integers(0, 2, (4, 5, 1)), huge, rng.normal(size=(4, 5, 3))], {}, 0)
    out["select", "vector_condition"] = Case([rng.integers(-1, 2, (4, 5, 3)), huge, rng.normal(size=(4, 5, 1))], {}, 0)
    scalars = rng.normal(size=(4, 5, 1)), huge[:1, :1, :1]
    out["select", "scalar_branches"] = Case([rng.integers(-1, 2, (4, 5, 3)), *scalars], {}, 0)
    out["select", "int"] = Case([rng.integers(0, 2, (4, 5, 1)), ints, ints[:1, :1]], {}, 0)
    for c in (1, 2, 3, 4):
        x = rng.normal(size=(4, 5, c))
        out["swizzle", f"first_of_{c}"] = Case([x], {"channels": "x"}, 0)
        out["swizzle", f"all_of_{c}"] = Case([x], {"channels": "wzyx"[4 - c:]}, 0)
        out["swizzle", f"ints_of_{c}"] = Case([ints[..., :1].repeat(c, 2)], {"channels": "x" * c}, 0)
        out["block_sum", f"channels_{c}"] = Case([x], {"bw": 2, "bh": 4, "count": 18}, DEFAULT_RTOL)
        out["broadcast", f"channels_{c}"] = Case([x[:1, :1]], {"extent": image_extent(6, 4)}, 0)
        if c > 1:
            out["dot", f"channels_{c}"] = Case([x, rng.normal(size=(1, 1, c))], {}, DEFAULT_RTOL)
            out["sum_channels", f"channels_{c}"] = Case([x], {}, DEFAULT_RTOL)
            out[f"compose{c}", "int_mixed"] = Case([ints[..., :1], *[ints[:1, :1, :1]] * (c - 1)], {}, 0)
    out["sum_channels", "int"] = Case([ints], {}, 0)
    out["block_sum", "int"] = Case([ints], {"bw": 32, "bh": 32, "count": 20}, 0)
    out["lookup", "int"] = Case([ints, rng.integers(-2, 20, (6, 7, 1))], {}, 0)
    sparse = np.where(rng.random((20, 35, 1)) < 0.02, rng.integers(0, 6, (20, 35, 1)), -1)
    sparse[8:16, 8:24] = -1
    boxes = to_table(np.array([[0, 0, 35, 20], [3, 5, 30, 17], [8, 8, 24, 16], [9, 1, 9, 19], [34, 19, 35, 20], [0, 0, 8, 20]]))
    occupied = OPS["occupied"].ref(sparse, width=8, height=8)
    assert 0 < occupied.mean() < 1
    out["occupied", "sparse"] = Case([sparse], {"width": 8, "height": 8}, 0)
    out["occupied", "tiles"] = Case([sparse], {"width": 16, "height": 8}, 0)
    fours = OPS["in_fours"].ref(sparse)
    bins = OPS["bin_names"].ref(fours)
    assert 0 < (bins != 0).mean() < 1
    out["segment_sum", "sparse"] = Case([rng.normal(size=(20, 35, 2)), fours, boxes, bins], {}, DEFAULT_RTOL)
    many = OPS["in_fours"].ref(rng.permutation(20 * 35).reshape(20, 35, 1))  # entries that share a bit
    whole = to_table(np.tile([0, 0, 35, 20], (700, 1)))
    out["segment_sum", "many"] = Case([rng.normal(size=(20, 35, 1)), many, whole, OPS["bin_names"].ref(many)], {}, DEFAULT_RTOL)
    out["bin_names", "many"] = Case([many], {}, 0)
    out["fetch", "outside"] = Case([rng.normal(size=(4, 5, 2)), rng.integers(-9, 20, (6, 7, 2))], {}, 0)
    uv = np.array([0.0, 1.0, -1.0, 2.0, 0.5, 1 / 16, 1 - 1 / 16, -0.26, 1.37, 7.77])
    uv = np.stack(np.meshgrid(uv, uv), 2)
    for wrap in ("repeat", "clamp"):
        for c in (1, 2, 3, 4):
            texture = rng.normal(size=(7, 8, c))
            out["sample", f"{wrap}_{c}"] = Case([texture, uv], {"wrap": wrap}, 1e-5)
            # a derivative jumps at texel centres: those stay out
            out["sample_uv_gradient", f"{wrap}_{c}"] = Case([texture, uv + 0.013, rng.normal(size=(*uv.shape[:2], c))],
                                                            {"wrap": wrap}, 1e-5)
        out["sample", f"{wrap}_one_texel"] = Case([rng.normal(size=(1, 1, 3)), uv], {"wrap": wrap}, 1e-5)
    return out


ALL = cases()


@pytest.fixture(scope="module")
def snippets(gpu):
    """{(op, case): (device, reference, rtol)}, all of them from one bundle."""
    program, feed, outputs, nodes = Program(), {}, {}, {}
    for (name, case), (arguments, attrs, _) in ALL.items():
        inputs = []
        for k, a in enumerate(arguments):
            if not isinstance(a, Node):
                key = f"{name}/{case}/{k}"
                feed[key] = rounded(a)
                a = program.input(key, image_layout(a))
            inputs.append(a)
        y = nodes[name, case] = apply(name, *inputs, **attrs)
        outputs[f"{name}/{case}"] = y, layout_of(y)
    program.plan("all", {}, outputs)
    device = gpu.run(program, feed)
    reference = evaluate(nodes.values(), feed)
    return {key: (device["/".join(key)], program.values["/".join(key)].layout.from_image(r), ALL[key].rtol)
            for key, r in zip(nodes, reference)}


def same(device, reference, rtol, where):
    """Special values have results of all sizes: there is no largest to be measured by."""
    check.compare(device, reference, rtol, where, 1e-37 if "special" in where else None)


@pytest.mark.parametrize("o", SNIPPETS, **ids)
def test_a_snippet_on_lavapipe_is_the_reference(o, snippets):
    mine = {key: row for key, row in snippets.items() if key[0] == o.name}
    assert mine
    for (name, case), (device, reference, rtol) in mine.items():
        same(device, reference, rtol, f"{name} {case}")


# Units of 2^-24 of the largest result by which a function may be off over these arguments; Vulkan would allow a device 2^-11, 4096 ulp.
EXACT = {"sin": (12000.0, 2.5), "cos": (12000.0, 2.5), "tan": (0.78, 6), "asin": (1.0, 3), "acos": (1.0, 3), "tanh": (9.0, 3),
         "sinh": (1.0, 3)}


def test_what_becomes_a_place_is_exact_to_a_few_units_in_the_last_place(gpu):
    program, feed, outputs, rng = Program(), {}, {}, seeded("places")
    for name, (most, _) in EXACT.items():
        eighths = np.arange(-15000, 15000) * (np.pi / 4)  # where the reduction turns
        x = rounded(np.concatenate([rng.uniform(-most, most, 6000), np.linspace(-1, 1, 401) * most, rng.uniform(-1, 1, 599) * min(most, 7),
                                    eighths[np.abs(eighths) < most]]))
        node = program.input(name, Layout("table", "float", count=len(x)))
        feed[name] = program.values[name].layout.to_image(x, name)
        outputs[f"{name}.y"] = apply(name, node), Layout("table", "float", count=len(x))
    y, x = (program.input(name, Layout("table", "float", count=4000)) for name in "yx")
    for name in "yx":
        feed[name] = program.values[name].layout.to_image(rounded(rng.normal(size=4000) * 10.0 ** rng.integers(-20, 20, 4000)), name)
    outputs["atan2.y"] = apply("atan2", y, x), Layout("table", "float", count=4000)
    program.plan("p", {}, outputs)
    device = gpu.run(program, feed)
    for name, (_, units) in {**EXACT, "atan2": (0, 3)}.items():
        node, layout = outputs[f"{name}.y"]
        expected = layout.from_image(evaluate([node], feed)[0])
        off = np.abs(device[f"{name}.y"] - expected).max() * 2 ** 24 / np.abs(expected).max()
        assert off < units, f"{name} is off by {off:.2f} units"


def test_sine_and_cosine_stay_in_range_however_large_the_angle(gpu):
    program = Program()
    x = program.input("x", image_layout(np.zeros((1, 5, 1))))
    outputs = {name: (apply(name, x), image_layout(np.zeros((1, 5, 1)))) for name in ("sin", "cos")}
    program.plan("p", {}, outputs)
    for y in gpu.run(program, {"x": np.array([2e4, -1e6, 1e9, 3e20, -3e38])[None, :, None]}).values():
        assert np.isfinite(y).all() and np.abs(y).max() <= 1


def test_select_ignores_the_huge_branch_that_is_not_taken_and_gives_it_no_gradient(gpu):
    program = Program()
    x = program.input("x", image_layout(np.zeros((2, 4, 1))))
    huge = apply("exp", apply("exp", x * x + 0.3))  # to 1e32 at |x| = 2
    inside = x * x < 4.0
    y = select(inside, x, select(x < 0.0, -3e38, 3e38))
    g, = gradients(total(select(inside, x * 3.0, huge)), [x])
    program.plan("p", {}, {"y": (y, layout_of(y)), "g": (g, layout_of(g))})
    value = np.array([[0.0, 1.0, -1.5, 0.25], [3.0, -3.0, 1.9, -1.9]])[..., None]
    result = gpu.run(program, {"x": value})
    value, taken = value[..., 0].astype(np.float32), abs(value[..., 0]) < 2
    np.testing.assert_array_equal(result["y"][taken], value[taken])
    np.testing.assert_array_equal(result["y"][~taken], np.float32([3e38, -3e38]))
    np.testing.assert_array_equal(result["g"][taken], np.float32(3))


AT_ZERO = {  # function of a and b (both 0), gradients by a and b
    "sqrt": (lambda a, b: apply("sqrt", a) + b, (0, 1)), "abs": (lambda a, b: apply("abs", a) + b, (0, 1)),
    "sqrt_of_square": (lambda a, b: apply("sqrt", a * a) + b, (0, 1)), "atan2": (lambda a, b: apply("atan2", a, b), (0, 0)),
    "pow": (lambda a, b: apply("pow", a, b + 2.0), (0, 0)), "sigmoid": (lambda a, b: apply("sigmoid", a - b), (0.25, -0.25)),
    "min_tie": (lambda a, b: apply("min", a, b), (1, 0)), "max_tie": (lambda a, b: apply("max", a, b), (1, 0)),
    "normalize": (lambda a, b: normalize(compose(a, b, 0.0)).x, (0, 0)),
}


def test_gradients_at_zero_are_finite_and_documented(gpu):
    program = Program()
    a, b = (program.input(name, image_layout(np.zeros((1, 2, 1)))) for name in "ab")
    outputs = {}
    for name, (build, _) in AT_ZERO.items():
        for x, g in zip("ab", gradients(total(build(a, b)), [a, b])):
            outputs[f"{name}.{x}"] = g, layout_of(g)
    program.plan("p", {}, outputs)
    zero = np.zeros((1, 2, 1))
    device = gpu.run(program, {"a": zero, "b": zero})
    for name, (g, _) in outputs.items():
        expected = AT_ZERO[name[:-2]][1]["ab".index(name[-1])]
        np.testing.assert_allclose(evaluate([g], {"a": zero, "b": zero})[0], expected, rtol=1e-6, atol=1e-30, err_msg=name)
        np.testing.assert_allclose(device[name], expected, rtol=1e-6, atol=1e-30, err_msg=name)


# Rasterization


@pytest.fixture(scope="module")
def raster(gpu):
    """Three views of a ball in an atlas of 2 x 2: device and reference of every raster op, and how sure each pixel is."""
    w, h, r, near = 20, 18, 2.5, 0.1
    ball, faces = icosahedron()
    clips = [project(0.9 * ball @ rotation(k).T + (0.1 * k, 0.04, -3.3), (w, h), near) for k in (2, 3, 4)]
    topology, atlas = Topology(faces, len(ball)), Atlas(w, h, 3, 2)
    program = Program()
    table = to_table(np.concatenate(clips))
    clip = program.input("clip", Layout("table", "vec4", count=len(ball) * 3))
    found = topological([rasterized(clip, topology, atlas, softness, near).layers[-1].face for softness in
                         (Softness(r), Softness(r, distance="face"), Softness(r, layers=2))]
                        + [rasterized(clip, topology, atlas, Softness(r), near, faces=False).front]
                        + [Outline(r, contours=True).draw(clip, topology, atlas, near, True).layers[-1].face])
    nodes = {n.op.name: n for n in found if n.op in RASTER}
    assert len(nodes) == len(RASTER)
    program.plan("p", {}, {name: (y, layout_of(y)) for name, y in nodes.items()})
    feed = {"clip": rounded(table)}
    chosen = [brute_force.select(rounded(c), faces, (w, h), r, layers=2, near=near) for c in clips]
    margin = [[s.margins.color for s in chosen], [s.margins.value for s in chosen]]
    sure = [np.block([[m[0], m[1]], [m[2], np.full((h, w), np.inf)]]) for m in margin]
    listed = evaluate(nodes["rasterize_segments"].inputs, feed)
    return gpu.run(program, feed), dict(zip(nodes, evaluate(nodes.values(), feed))), sure, listed


@pytest.mark.parametrize("o", [o for o in RASTER if o.name not in ("rasterize_hard", "rasterize_segments", "rasterize_contours")], **ids)
def test_rasterization_on_lavapipe_is_the_reference(o, raster):
    device, reference, (clear, same_value), _ = raster
    found, expected = np.atleast_3d(device[o.name]), reference[o.name]
    sure, nearly = clear > margin(), same_value > margin()
    assert nearly.mean() > 0.8 and (expected[..., 0][sure] >= 0).sum() > 100
    np.testing.assert_array_equal(found[..., 0][sure], expected[..., 0][sure])
    # where two faces are equally far the lower index is meant; one shared corner may be rounded either way
    np.testing.assert_array_equal(found[..., 0][nearly] >= 0, expected[..., 0][nearly] >= 0)
    np.testing.assert_array_equal((found[..., 0] & 1)[nearly], (expected[..., 0] & 1)[nearly])
    if found.shape[2] == 2:
        some = nearly & (expected[..., 0] >= 0)
        depth = np.ascontiguousarray(expected[..., 1]).view(np.float64)[some]
        np.testing.assert_allclose(np.ascontiguousarray(found[..., 1]).view(np.float32)[some], depth, atol=2e-6)


def test_an_empty_cell_of_the_atlas_stays_empty(raster):
    for found in raster[0].values():
        assert (np.atleast_3d(found)[18:, 20:] == -1).all()


def test_the_hard_faces_are_those_of_the_first_layer(raster):
    device, reference, (clear, same_value), _ = raster
    found, first = device["rasterize_hard"], device["rasterize"]
    sure, nearly = clear > margin(), same_value > margin()
    np.testing.assert_array_equal(found[sure], reference["rasterize_hard"][..., 0][sure])
    covered = (first >= 0) & (first & 1 == 1)
    np.testing.assert_array_equal((found >= 0)[nearly], covered[nearly])
    assert 100 < covered.sum() < covered.size / 2


def test_the_nearest_outline_segment_is_found_in_every_cell(raster):
    device, reference, _, (segments, entries, front, running) = raster
    found, expected = device["rasterize_segments"], reference["rasterize_segments"][..., 0]
    count = running.reshape(-1)[-1] // 6
    assert 10 < count < 60 and (entries.reshape(-1)[:count] >= 0).all() and (entries.reshape(-1)[count:] == -1).all()
    ys, xs = np.mgrid[:36, :40]
    p = np.stack([xs % 20 - 9.5, ys % 18 - 8.5], -1)
    d = np.sqrt(segment_distance2(p[:, :, None], segments.reshape(-1, 4)[:count]))
    d = np.where(entries.reshape(-1)[:count] // 30 == (xs // 20 + ys // 18 * 2)[..., None], d, np.inf)
    sure = np.abs(d - 2.5).min(-1) > 1e-3
    np.testing.assert_array_equal((found >= 0)[sure], (expected >= 0)[sure])
    outside = sure & (front[..., 0] < 0)
    np.testing.assert_array_equal((found >= 0)[outside], (d.min(-1) < 2.5)[outside])
    some = sure & (found >= 0)
    chosen = [np.take_along_axis(d, np.maximum(slot, 0)[..., None], -1)[..., 0][some] for slot in (found, expected)]
    np.testing.assert_allclose(*chosen, rtol=0, atol=1e-3)
    assert (some & outside).sum() > 150 and (some & ~outside).sum() > 150
