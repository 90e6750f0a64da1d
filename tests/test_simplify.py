"""`simplify` and `lower` change how much is computed, never what."""

import numpy as np
import pytest
from graphs import Graph

from dressi_edge.cache.layout import Layout
from dressi_edge.compiler import Program
from dressi_edge.compiler.graph.autodiff import gradients
from dressi_edge.compiler.graph.functions import apply, compose, constant, dot, mean, scale_gradient, total
from dressi_edge.compiler.graph.ir import is_int, topological
from dressi_edge.compiler.graph.optable import OPS
from dressi_edge.compiler.graph.reference import evaluate
from dressi_edge.compiler.passes.simplify import RULES, lower, simplify

SEEDS = [*range(20), *(pytest.param(s, marks=pytest.mark.full) for s in range(20, 300))]


def leaf(name="x", vtype="float"):
    return Program().input(name, Layout("image", vtype, 5, 4))


def same(before, after, feed):
    for a, b, x, y in zip(before, after, evaluate(before, feed), evaluate(after, feed)):
        assert (a.vtype, a.extent) == (b.vtype, b.extent)
        np.testing.assert_array_equal(x, y, err_msg=f"{a!r} -> {b!r}")


@pytest.mark.parametrize("seed", SEEDS)
def test_simplify_keeps_every_bit_of_a_random_graph(seed):
    graph = Graph(seed)
    same(graph.nodes, simplify(graph.nodes), graph.feed)


@pytest.mark.parametrize("seed", SEEDS)
def test_lower_keeps_every_bit_where_the_order_of_additions_does_not_matter(seed):
    graph = Graph(seed, exact=True)
    lowered = lower(graph.nodes)
    assert not any(n.op.stage == "composite" for n in topological(lowered))
    same(graph.nodes, lowered, graph.feed)
    same(graph.nodes, simplify(lowered), graph.feed)


@pytest.mark.parametrize("seed", range(5))
def test_simplify_keeps_gradients_and_makes_them_smaller(seed):
    graph = Graph(seed, differentiable=True)
    loss = total(dot(graph.nodes[-1], graph.nodes[-1])) * 0.5 + total(graph.nodes[0]) * 1.0 + 0.0
    wrt = [x for x in topological([loss]) if x.op.name == "input" and not is_int(x.vtype)]
    before = gradients(loss, wrt)
    after = simplify(before)
    same(before, after, graph.feed)
    assert len(topological(after)) < len(topological(before))


@pytest.mark.parametrize("seed", range(5))
def test_simplifying_twice_changes_nothing_more(seed):
    once = simplify(Graph(seed).nodes)
    assert simplify(simplify(once)) == simplify(once)


@pytest.mark.parametrize("count", [1, 9, 31, 1024, 1025, 5000])
def test_a_sum_of_a_table_of_any_length_is_its_sum(count):
    layout = Layout("table", "vec3", count=count)
    x = Program().input("x", layout)
    values = np.random.default_rng(count).integers(-9, 9, (count, 3)).astype(float)
    feed = layout.to_image(values, "x")
    feed.reshape(-1, 3)[count:] = np.inf  # padding
    roots = [total(x * 1.0)]
    assert (evaluate(lower(roots), {"x": feed})[0][0, 0] == values.sum(0)).all()


IDENTITIES = {
    "x+0": lambda x: x + 0.0, "0+x": lambda x: 0.0 + x, "x-0": lambda x: x - 0.0, "x*1": lambda x: x * 1.0,
    "1*x": lambda x: 1.0 * x, "x/1": lambda x: x / 1.0, "-(-x)": lambda x: apply("neg", apply("neg", x)),
    "stop": lambda x: apply("stop_gradient", x), "scaled": lambda x: scale_gradient(x, 3.0), "x+(x-x)*y": lambda x: x + (x - x) * leaf("y"),
    "either": lambda x: apply("select", leaf("c") > 0.0, x, apply("stop_gradient", x)),
    "broadcast": lambda x: apply("broadcast", x, extent=x.extent), "compose.x": lambda x: compose(x, x * 2.0).x,
}


@pytest.mark.parametrize("build", IDENTITIES.values(), ids=IDENTITIES)
def test_an_identity_vanishes(build):
    x = leaf()
    assert simplify([build(x)]) == [x]


def test_an_identity_that_widens_stays():
    x = leaf()
    unit = Program().input("u", Layout("unit", "float"))
    ones = constant(np.ones((4, 5, 3)))
    for y in (ones + x, apply("broadcast", unit, extent=x.extent), unit * ones, apply("literal", value=0.0) * ones):
        after, = simplify([y])
        assert (after.vtype, after.extent) == (y.vtype, y.extent)


def test_a_swizzle_of_a_swizzle_is_one():
    x = leaf(vtype="vec4")
    assert simplify([apply("swizzle", x, channels="wzy").yz]) == [apply("swizzle", x, channels="zy")]


def test_literals_fold_to_one_literal():
    y = (apply("literal", value=2.0) + 3.0) * 4.0 - apply("sqrt", apply("literal", value=16.0))
    folded, = simplify([y])
    assert folded.op.name == "literal" and folded.attrs["value"] == 16.0
    vector, = simplify([compose(*[apply("literal", value=float(k)) for k in range(3)])])
    assert vector.op.name == "literal" and vector.attrs["value"] == (0.0, 1.0, 2.0)
    integer, = simplify([apply("add", apply("literal", value=2), apply("literal", value=3))])
    assert integer.attrs["value"] == 5 and type(integer.attrs["value"]) is int


def test_what_folds_to_no_number_is_left_alone():
    y = apply("div", apply("literal", value=1.0), apply("literal", value=0.0))
    with np.errstate(divide="ignore"):
        assert simplify([y]) == [y]


def test_rules_are_about_ops_that_exist():
    assert RULES.keys() <= OPS.keys()


def test_mean_of_a_constant_keeps_its_value():
    x = constant(np.full((3, 4, 1), 0.5))
    same([mean(x)], simplify(lower([mean(x)])), {})
