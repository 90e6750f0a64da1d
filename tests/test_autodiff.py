"""Reverse mode: what it sums, what it refuses, and random graphs against central differences."""

import numpy as np
import pytest
from graphs import Graph, layout_of

from dressi_edge.cache.errors import GraphError
from dressi_edge.cache.layout import Layout
from dressi_edge.compiler import Program
from dressi_edge.compiler.graph.autodiff import gradients
from dressi_edge.compiler.graph.functions import (
    apply,
    compose,
    constant,
    constant_table,
    dot,
    lookup,
    scale_gradient,
    select,
    stop_gradient,
    to_float,
    to_int,
    total,
)
from dressi_edge.compiler.graph.ir import UNIT, image, is_int, topological
from dressi_edge.compiler.graph.reference import evaluate

RNG = np.random.default_rng(0)


def inputs(**layouts):
    program = Program()
    return [program.input(name, layout) for name, layout in layouts.items()]


def image_of(vtype="float", w=5, h=4):
    return Layout("image", vtype, w, h)


def values(*nodes):
    return {n.name: RNG.normal(size=(n.extent.height, n.extent.width, n.channels)) for n in nodes}


# Broadcasting


def test_a_scalar_beside_a_vector_gets_the_sum_over_channels():
    s, v = inputs(s=image_of(), v=image_of("vec3"))
    feed = values(s, v)
    gs, gv = evaluate(gradients(total(dot(s * v, v)), [s, v]), feed)
    np.testing.assert_allclose(gs, (feed["v"] ** 2).sum(2, keepdims=True))
    np.testing.assert_allclose(gv, 2 * feed["s"] * feed["v"])


def test_a_unit_beside_an_image_gets_the_sum_over_texels():
    u, v = inputs(u=Layout("unit", "vec3"), v=image_of("vec3"))
    feed = values(u, v)
    gu, = gradients(total(dot(u * v, v)), [u])
    assert gu.extent == UNIT and gu.vtype == "vec3"
    np.testing.assert_allclose(evaluate([gu], feed)[0], (feed["v"] ** 2).sum((0, 1), keepdims=True))


def test_a_unit_scalar_beside_an_image_of_vectors_gets_both_sums():
    u, v = inputs(u=Layout("unit", "float"), v=image_of("vec4"))
    feed = values(u, v)
    gu, = gradients(total(dot(u + v, v)), [u])
    assert (gu.extent, gu.vtype) == (UNIT, "float")
    np.testing.assert_allclose(evaluate([gu], feed)[0].item(), feed["v"].sum())


def test_a_unit_beside_a_table_does_not_count_padding():
    u, t = inputs(u=Layout("unit", "float"), t=Layout("table", "float", count=9))
    feed = values(u, t)
    gu, = gradients(total(u * t), [u])
    np.testing.assert_allclose(evaluate([gu], feed)[0].item(), feed["t"].ravel()[:9].sum())


def test_a_gradient_has_the_type_and_extent_of_its_variable():
    u, v, t = inputs(u=Layout("unit", "float"), v=image_of("vec3"), t=Layout("table", "vec2", count=9))
    loss = total(dot(v * u, v)) + total(t.x) * u + total(dot(t, t))
    for x, g in zip((u, v, t), gradients(loss, [u, v, t])):
        assert (g.vtype, g.extent) == (x.vtype, x.extent)


def test_only_a_unit_is_broadcast():
    x, = inputs(x=image_of())
    with pytest.raises(GraphError, match="only 1x1"):
        apply("broadcast", x, extent=image(7, 4))


# Sums


def test_every_use_adds_to_the_gradient():
    x, = inputs(x=image_of())
    feed = values(x)
    once, = gradients(total(x * x), [x])
    four, = gradients(total(x * x) + total(x * x) + total(x * x + x * x), [x])
    np.testing.assert_allclose(evaluate([four], feed)[0], 4 * evaluate([once], feed)[0])
    many, = gradients(total(sum([x * float(k) for k in range(7)], x)), [x])
    np.testing.assert_allclose(evaluate([many], feed)[0], np.full((4, 5, 1), 22.0))


def test_an_independent_variable_has_a_gradient_of_zeros():
    x, y, t = inputs(x=image_of(), y=image_of("vec3"), t=Layout("table", "vec2", count=9))
    gradient = gradients(total(x * x), [y, x, t])
    for node, g in zip((y, x, t), gradient):
        assert (g.vtype, g.extent) == (node.vtype, node.extent)
    assert not evaluate([gradient[0], gradient[2]], {})[0].any()


def test_the_gradient_by_the_loss_itself_is_one():
    x, = inputs(x=Layout("unit", "float"))
    assert evaluate(gradients(x, [x]), {"x": np.full((1, 1, 1), 3.0)})[0].item() == 1
    loss = x * x
    assert [g.item() for g in evaluate(gradients(loss, [loss, x]), {"x": np.full((1, 1, 1), 3.0)})] == [1, 6]


def test_an_inner_node_may_be_asked_for():
    x, = inputs(x=image_of())
    y = x * 3.0
    g, = gradients(total(y * y), [y])
    feed = values(x)
    np.testing.assert_allclose(evaluate([g], feed)[0], 6 * feed["x"])


# Cuts and errors


def test_a_scaled_gradient_is_that_of_the_value_times_the_factor():
    x, by = inputs(x=image_of(), by=image_of())
    y = scale_gradient(x * x, by)
    feed = values(x, by)
    value, by_x, by_by = evaluate([y, *gradients(total(y), [x, by])], feed)
    np.testing.assert_array_equal(value, feed["x"] ** 2)
    np.testing.assert_allclose(by_x, 2 * feed["x"] * feed["by"])
    assert not by_by.any()


def test_stop_gradient_and_integers_cut_the_path():
    x, = inputs(x=image_of())
    feed = values(x)
    for cut in (stop_gradient(x * 3.0), to_float(to_int(x * 3.0)), select(x > 0.0, 1.0, 2.0),
                stop_gradient(apply("floor", x))):
        g, = gradients(total(cut * x), [x])
        np.testing.assert_allclose(evaluate([g], feed)[0], evaluate([cut], feed)[0])


@pytest.mark.parametrize("build", [lambda x: apply("floor", x), lambda x: apply("sign", x * 2.0),
                                   lambda x: apply("fetch", x, constant(np.zeros((2, 2, 2), int))),
                                   lambda x: apply("block_sum", x, bw=2, bh=2, count=20)],
                         ids=["floor", "sign", "fetch", "block_sum"])
def test_an_op_without_gradient_on_the_path_is_named_with_the_variable_and_the_way_out(build):
    x, = inputs(albedo=image_of())
    y = build(x + 1.0)
    with pytest.raises(GraphError, match=f"{y.op.name} has no gradient.*albedo.*stop_gradient"):
        gradients(total(y), [x])


def test_an_op_without_gradient_off_the_path_is_fine():
    x, y = inputs(x=image_of(), y=image_of())
    gradients(total(x * apply("floor", y)), [x])


def test_a_lookup_by_a_computed_index_wants_a_box():
    x, k = inputs(entries=Layout("table", "vec3", count=9), k=image_of("int"))
    with pytest.raises(GraphError, match="entries.*computed index.*box"):
        gradients(total(lookup(x, k)).x, [x])


@pytest.mark.parametrize("build", [lambda x: x, lambda x: total(compose(x, x)), lambda x: total(to_int(x))],
                         ids=["image", "vector", "integer"])
def test_a_loss_that_is_no_number_is_refused(build):
    x, = inputs(x=image_of())
    with pytest.raises(GraphError, match="not a 1x1 float"):
        gradients(build(x), [x])


# Random graphs


@pytest.mark.parametrize("seed", [*range(12), *(pytest.param(s, marks=pytest.mark.full) for s in range(12, 100))])
def test_the_gradient_of_a_random_graph_is_its_central_difference(seed):
    graph = Graph(seed, differentiable=True)
    rng = np.random.default_rng(seed)
    weights = [constant(rng.normal(size=(n.extent.height, n.extent.width, n.channels)), n.extent) for n in graph.nodes[-4:]]
    loss = sum((total(dot(n, w)) for n, w in zip(graph.nodes[-4:], weights)), total(graph.nodes[0]))
    wrt = [x for x in topological([loss]) if x.op.name == "input" and not is_int(x.vtype)]
    found = evaluate(gradients(loss, wrt), graph.feed)
    for x, g in zip(wrt, found):
        direction = layout_of(x).to_image(layout_of(x).from_image(rng.normal(size=g.shape)), x.name)
        ends = []
        for h in (1e-6, -1e-6):
            ends.append(evaluate([loss], {**graph.feed, x.name: graph.feed[x.name] + h * direction})[0].item())
        np.testing.assert_allclose((g * direction).sum(), (ends[0] - ends[1]) / 2e-6, rtol=1e-5, atol=1e-6, err_msg=x.name)


def test_equal_subexpressions_of_a_gradient_are_one_node():
    x, = inputs(x=image_of())
    loss = total(apply("sigmoid", x))
    assert gradients(loss, [x]) == gradients(loss, [x])
    assert gradients(loss, [x])[0].extent == image(5, 4)
    assert constant_table([1, 2]) is constant_table([1, 2])
