"""What users write graphs with: every op by its name and with its documentation, operators, ops of their own, and what Python must not ask
of a value that is not there yet."""

import inspect
import itertools
import operator

import numpy as np
import pytest
from graphs import image_layout

from dressi_edge.cache.errors import GraphError
from dressi_edge.cache.layout import Layout
from dressi_edge.compiler import Program
from dressi_edge.compiler.check_op import check_op
from dressi_edge.compiler.graph import functions as F
from dressi_edge.compiler.graph.autodiff import gradients
from dressi_edge.compiler.graph.ir import UNIT, Data, Node, image
from dressi_edge.compiler.graph.optable import OPS, When, elementwise, op
from dressi_edge.compiler.graph.reference import evaluate


def leaf(name="x", vtype="vec3", w=5, h=4):
    return Program().input(name, Layout("image", vtype, w, h))


def value(node, **feed):
    return evaluate([node], feed)[0]


# The namespace


@pytest.mark.parametrize("row", OPS.values(), ids=lambda row: row.name)
def test_every_op_is_a_function_with_its_documentation(row):
    function = getattr(F, row.name)
    assert callable(function) and row.name in dir(F)
    assert len(row.doc) > 2 and row.doc[-1] == ".", f"{row.name} has no sentence of documentation"
    assert inspect.getdoc(function) and inspect.signature(function)


@pytest.mark.parametrize("name", F.__all__)
def test_every_public_function_has_documentation(name):
    assert inspect.getdoc(getattr(F, name))


def test_functions_are_found_by_name_and_misspelt_ones_named():
    x = leaf()
    assert F.sin(x) is F.apply("sin", x) and F.sin.__name__ == "sin"
    assert list(inspect.signature(F.shift_transposed).parameters) == ["x", "dx", "dy", "cell_w", "cell_h"]
    with pytest.raises(AttributeError, match="did you mean maximum"):
        F.maximun  # noqa: B018


# Operators


def test_operators_are_what_numpy_has():
    x, y = leaf(), leaf("y")
    a, b = np.random.default_rng(0).uniform(0.5, 3, (2, 4, 5, 3)) * [[[[1]]], [[[-1]]]]
    for f in (operator.add, operator.sub, operator.mul, operator.truediv, operator.mod, operator.floordiv):
        np.testing.assert_allclose(value(f(x, y), x=a, y=b), f(a, b), err_msg=str(f))
        np.testing.assert_allclose(value(f(x, 0.7), x=a), f(a, 0.7), err_msg=str(f))
        np.testing.assert_allclose(value(f(2.5, y), y=b), f(2.5, b), err_msg=str(f))
    for n in (0, 1, 2, 3, 7, -1, -2, 2.0, np.int64(3)):
        np.testing.assert_allclose(value(y ** n, y=b), b ** float(n), rtol=1e-12)
    np.testing.assert_allclose(value(x ** 0.5, x=a), a ** 0.5)
    np.testing.assert_allclose(value(x ** 1.5, x=a), a ** 1.5)
    np.testing.assert_allclose(value(2.0 ** y, y=b), 2 ** b)
    np.testing.assert_array_equal(value(abs(y), y=b), abs(b))
    assert +x is x


def test_powers_of_negative_bases_have_gradients():
    x = leaf(vtype="float")
    a = np.linspace(-2, 2, 20).reshape(4, 5, 1)
    g, = gradients(F.total(x ** 3), [x])
    np.testing.assert_allclose(value(g, x=a), 3 * a ** 2)


def test_integers_have_their_own_remainder_quotient_and_bits():
    k = leaf(vtype="int")
    a = np.arange(20).reshape(4, 5, 1)
    for f in (operator.mod, operator.floordiv, operator.and_, operator.or_):
        np.testing.assert_array_equal(value(f(k, 3), x=a), f(a, 3))
    np.testing.assert_array_equal(value((k > 3) & (k < 9) | (k >= 18), x=a), (a > 3) & (a < 9) | (a >= 18))
    np.testing.assert_array_equal(value(k ** 2, x=a), a ** 2)


def test_channels_by_number_and_slice():
    x = leaf(vtype="vec4")
    assert x[0] is x.x and x[-1] is x.w and x[1:3] is x.yz and x[::-1] is F.swizzle(x, channels="wzyx") and x[:] is x
    for index in (4, -5, slice(3, 3), "x", None, (0, 1), 1.0):
        with pytest.raises(GraphError, match="channels 0 to 3"):
            x[index]


@pytest.mark.parametrize("number", [np.float32(2), np.float64(2), np.int64(2), np.array(2.0), 2, 2.0], ids=repr)
def test_numbers_of_numpy_on_either_side_make_a_node(number):
    x = leaf()
    for y in (number * x, x * number, number + x, number - x, number / x, number > x, x > number):
        assert isinstance(y, Node)
    assert number * x is F.apply("mul", 2.0, x)


def test_arrays_are_refused_with_a_hint():
    for f in (operator.mul, operator.add, operator.lt):
        for a, b in ((np.ones(3), leaf()), (leaf(), np.ones((4, 5, 3)))):
            with pytest.raises(GraphError, match=r"constant\(\)"):
                f(a, b)


# What Python must not ask


ASKED = {
    "truth": (lambda x: bool(x), "select"), "if": (lambda x: 1 if x > 0 else 2, "select"), "max": (lambda x: max(x, 0.0), "maximum"),
    "and": (lambda x: x and x, "&"), "not": (lambda x: not x, "select"), "chained": (lambda x: 0 < x < 1, "select"),
    "==": (lambda x: x == x * 2.0, r"equal\(a, b\)"), "== number": (lambda x: x == 0.0, r"equal\(a, b\)"),
    "!=": (lambda x: x != x * 2.0, r"equal\(a, b\)"), "number ==": (lambda x: 0.0 == x, r"equal\(a, b\)"),
    "== array": (lambda x: x == np.zeros(3), r"equal\(a, b\)"), "numpy ==": (lambda x: np.float32(1) == x, r"equal\(a, b\)"),
    "len": (lambda x: len(x), "extent.count"), "iter": (lambda x: list(x), "channels"), "unpack": (lambda x: [*x], "channels"),
    "in": (lambda x: 1.0 in x, "equal"), "float": (lambda x: float(x), "to_float"), "int": (lambda x: int(x), "to_int"),
    "index": (lambda x: [1, 2][x], "to_int"), "range": (lambda x: range(x), "to_int"), "array": (lambda x: np.asarray(x), "evaluate"),
    "sqrt": (lambda x: np.sqrt(np.asarray(x)), "evaluate"), "round": (lambda x: float(x), "to_float"),
}


@pytest.mark.parametrize("name", ASKED)
def test_what_is_not_known_yet_is_refused_with_what_to_write(name):
    ask, hint = ASKED[name]
    with pytest.raises(GraphError, match=hint):
        ask(leaf())


def test_nodes_are_told_apart_by_identity_in_sets_and_dicts():
    """Equal hashes are those of one node; two nodes are never compared, whatever else is a key."""
    x = leaf()
    nodes = [x * float(k) for k in range(2000)]
    assert len(set(nodes)) == 2000 and len({n: 0 for n in nodes}) == 2000 and all(n in set(nodes) for n in nodes)
    assert {x, (x, "mode"), "x", None} == {x, (x, "mode"), "x", None}
    assert {(x, 1): 2}[x, 1] == 2 and x == x and not x != x
    assert (x == "x") is False and (x is not None) and x not in {"x", None, ("x",)}


# Bad input


BAD = {
    "op": (lambda x: F.apply("sinn", x), "no op 'sinn'; did you mean sin"),
    "op that is none": (lambda x: F.apply(None, x), "no op None"),
    "attribute": (lambda x: F.apply("swizzle", x, chanels="x"), "chanels is no attribute of it; it has channels; did you mean channels"),
    "attribute of none": (lambda x: F.apply("add", x, x, axis=1), "axis is no attribute of it; it has none"),
    "missing": (lambda x: F.apply("swizzle", x), "channels must be given"),
    "list as attribute": (lambda x: F.apply("broadcast", F.constant(np.ones((1, 1, 1))), extent=[5, 4]), "extent"),
    "pair as extent": (lambda x: F.apply("broadcast", F.constant(np.ones((1, 1, 1))), extent=(5, 4)), "extent of type tuple"),
    "inputs": (lambda x: F.apply("add", x), "takes 2 inputs"),
    "text": (lambda x: x + "1", "neither a graph value nor a number"),
    "none": (lambda x: F.maximum(x, None), "neither a graph value nor a number"),
    "huge": (lambda x: x + 10 ** 400, "finite in fp32"),
    "nan": (lambda x: x + float("nan"), "finite in fp32"),
    "integer beyond int32": (lambda x: leaf("k", "int") + 2 ** 31, "-2^31 to 2^31 - 1"),
    "integer below int32": (lambda x: F.apply("literal", value=-2 ** 31 - 1), "-2^31 to 2^31 - 1"),
    "literal of nothing": (lambda x: F.apply("literal", value=()), "literal"),
    "mixed literal": (lambda x: F.apply("literal", value=(1, 2.0)), "literal"),
    "constant beyond int32": (lambda x: F.constant_table([2 ** 40]), "int32"),
    "constant of text": (lambda x: F.constant_table(["a"]), "numbers are needed"),
    "constant of nothing": (lambda x: F.constant_table(np.zeros((0, 3))), "at least one entry"),
    "constant number": (lambda x: F.constant_table(3.0), "at least one entry"),
    "sine of an integer": (lambda x: F.sin(leaf("k", "int")), "to_float"),
    "bits of a float": (lambda x: x & 1, "to_int"),
    "lookup by a float": (lambda x: F.lookup(x, leaf("u", "float")), "to_int"),
    "negative power of an integer": (lambda x: leaf("k", "int") ** -1, "from 0 on"),
}


def planned(**outputs):
    """A program that gives out what is named, with a state to update."""
    program = Program()
    program.state("count", Layout("unit", "int"))
    program.plan("p", outputs.pop("updates", {}), outputs)


FLOAT = Layout("unit", "float")
BAD |= {
    "kind of layout": (lambda x: Program().input("x", Layout("tabel", "float")), "did you mean table"),
    "type of layout": (lambda x: Program().input("x", Layout("table", "vec5", count=3)), "did you mean vec"),
    "no layout": (lambda x: Program().input("x", (3, 4)), "is no Layout"),
    "empty layout": (lambda x: Program().input("x", Layout("table", "vec3", count=0)), "above 0"),
    "leaf of another program": (lambda x: planned(y=(F.mean(x.x), FLOAT)), "not of this program"),
    "output without layout": (lambda x: planned(y=x), "a pair (node, layout) is needed"),
    "output that is a number": (lambda x: planned(y=(1.0, FLOAT)), "a graph value is needed"),
    "update of what is no state": (lambda x: planned(updates={"counts": F.to_int(F.constant(np.zeros((1, 1, 1))))}), "did you mean count"),
    "update that is a number": (lambda x: planned(updates={"count": 1}), "a graph value is needed"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_one_sentence(name):
    build, words = BAD[name]
    with pytest.raises(GraphError) as raised:
        build(leaf())
    assert words in str(raised.value) and "\n" not in str(raised.value)


ANYTHING = [None, "a", 1, 1.5, -3, [1, 2], np.ones((2, 3)), np.ones(3), (1, 2), {}, float("nan"), True]


@pytest.mark.parametrize("name", sorted({*F.__all__} - {"op", "apply"}))
def test_whatever_a_function_is_given_it_answers_or_says_what_is_wrong(name):
    """No bare error of Python or NumPy comes out, but for the wrong number of arguments."""
    given = [leaf(), leaf("k", "int"), *ANYTHING]
    for count in (1, 2, 3):
        for arguments in itertools.product(given, repeat=count) if count < 3 else zip(given, given[3:] + given[:3], given[7:] + given[:7]):
            try:
                getattr(F, name)(*arguments)
            except GraphError as e:
                assert str(e)
            except TypeError as e:
                assert "argument" in str(e) and name in str(e), f"{name}{arguments}"


@pytest.mark.parametrize("loss, wrt", [(None, [1.0]), (1.0, None), (F.constant(np.ones((1, 1, 1))), [None]),
                                       (F.constant(np.ones((1, 1, 1))), leaf())])
def test_gradients_are_of_nodes_by_nodes(loss, wrt):
    with pytest.raises(GraphError, match="a loss and a sequence of nodes"):
        gradients(loss, wrt)


def test_the_zeros_of_both_signs_are_two_literals():
    a, b = F.apply("literal", value=0.0), F.apply("literal", value=-0.0)
    assert a is not b and F.apply("literal", value=0.0) is a and F.apply("literal", value=0) is not a
    assert np.signbit(value(b)).all() and not np.signbit(value(a)).any()
    assert F.apply("literal", value=(0.0, 1.0)) is not F.apply("literal", value=(-0.0, 1.0))


def test_the_smallest_integer_is_a_literal():
    assert value(leaf("k", "int") * 0 + F.apply("literal", value=-2 ** 31), k=np.zeros((4, 5, 1)))[0, 0, 0] == -2 ** 31


# Ops of users


@pytest.fixture
def table():
    """The op table as it was, whatever a test adds."""
    before = dict(OPS)
    yield
    for name in OPS.keys() - before.keys():
        del OPS[name]
        vars(F).pop(name, None)


FADE = {"glsl": "{y} = {x} * {x} * (3.0 - 2.0 * {x});", "ref": lambda x: x * x * (3.0 - 2.0 * x),
        "vjp": lambda g, y, x: (g * 6.0 * x * (1.0 - x),), "doc": "3 x^2 - 2 x^3."}


def test_an_op_of_a_user_is_as_good_as_ours(table):
    fade = op("fade", **FADE)
    check_op(fade)
    x = leaf()
    y = fade(x)
    assert y is F.fade(x) and F.fade.__doc__ == FADE["doc"]
    a = np.random.default_rng(0).normal(size=(4, 5, 3))
    g, = gradients(F.total(F.dot(y, y)), [x])
    np.testing.assert_allclose(value(g, x=a), 2 * FADE["ref"](a) * 6 * a * (1 - a))


def test_an_op_with_attributes_neighbours_and_a_sample(table):
    """A box sum along rows: it reads elsewhere, has attributes, and its transpose is itself."""
    box = op("box_rows", "x", ref=lambda x, reach: sum(np.roll(x, k, 1) for k in range(-reach, reach + 1)), reads="texel", cost=20,
             infer=lambda name, inputs, attrs: (inputs[0].vtype, inputs[0].extent),
             glsl="""{y} = {type}(0); for (int k_ = -{reach}; k_ <= {reach}; ++k_)
                     {y} += {x}(ivec2(({p}.x + k_ + {w}) % {w}, {p}.y));""",
             vjp=lambda g, y, x, reach: (F.box_rows(g, reach=reach),), doc="Sum over neighbours in the row, which wraps.",
             sample=lambda rng: ([rng.normal(size=(3, 7, 2))], {"reach": 2}))
    assert box.attrs == ("reach",)
    check_op(box)
    check_op("box_rows", [np.random.default_rng(1).normal(size=(2, 9, 4))], {"reach": 1}, profile="lavapipe")
    with pytest.raises(GraphError, match="reach must be given"):
        box(leaf())


WRONG = {
    "vjp": ({"vjp": lambda g, y, x: (g * 6.0 * x,)}, "the VJP by x0 is"),
    "vjp of another extent": ({"vjp": lambda g, y, x: (F.total(g),)}, ""),
    "no gradient": ({"vjp": lambda g, y, x: (None,)}, "the VJP by x0 is 0 "),
    "glsl": ({"glsl": "{y} = {x} * {x};"}, "(sample): the device has"),
    "glsl that is none": ({"glsl": "{y} = fade_of({x});"}, "its GLSL is refused"),
    "glsl for one channel": ({"glsl": "{y} = {type}(dot({x}, {type}(1.0)));"}, "the device has"),
    "a fact": ({"when": (When(0, "zero", 1),)}, "where x is zero the result is not 1"),
    "the reference's shape": ({"ref": lambda x: x[..., :2]}, "the reference gives float64 (4, 5, 2)"),
    "the reference's type": ({"ref": lambda x: (x > 0).astype(int)}, "the reference gives int64"),
    "no documentation": ({"doc": ""}, "a sentence of documentation"),
    "no glsl": ({"glsl": ""}, "a sentence of documentation"),
    "a sample that says nothing": ({"sample": lambda rng: ([np.zeros((4, 5, 3))], {})}, "the test says nothing"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_with_an_op_is_said(table, name):
    wrong, words = WRONG[name]
    bad = op("fade", **{**FADE, **wrong})
    with pytest.raises(GraphError) as raised:
        check_op(bad)
    assert "fade" in str(raised.value) and words in str(raised.value)


DECLARED = {
    "twice": (lambda: op("add", **FADE), "declared twice"),
    "name": (lambda: op("fade in", **FADE), "letters, digits"),
    "fact": (lambda: op("fade", **FADE, costs=3), "costs is no fact; did you mean cost"),
    "mark": (lambda: op("fade", **{**FADE, "glsl": "{y} = {z};"}), "{z} in its GLSL"),
    "reads": (lambda: op("fade", **FADE, reads="texels"), "reads 'texels'"),
    "inputs": (lambda: op("fade", **{**FADE, "ref": np.exp}), "its inputs are not named"),
    "unknown to check": (lambda: check_op("fade"), "no op of the table"),
}


@pytest.mark.parametrize("name", DECLARED)
def test_a_row_that_cannot_be_is_refused_when_it_is_declared(table, name):
    declare, words = DECLARED[name]
    with pytest.raises(GraphError) as raised:
        declare()
    assert words in str(raised.value)


@pytest.mark.parametrize("name", ["sin", "shift", "select", "lookup_boxed", "sample_exact"])
def test_our_own_rows_pass(name):
    check_op(name, without=["texture"] if name == "sample" else [], profile="lavapipe")


def test_inference_is_elementwise_unless_it_is_said(table):
    assert op("fade", **FADE).infer is elementwise
    assert OPS["fade"](F.constant(np.ones((1, 1, 2)))).extent == UNIT


def test_data_is_compared_by_content():
    assert F.constant(np.ones((2, 3, 1))) is F.constant(np.ones((2, 3, 1))) and F.constant(np.ones((2, 3, 1))).extent == image(3, 2)
    assert Data(np.zeros(3)) != Data(-np.zeros(3)) and image_layout(np.zeros((2, 3, 1))).shape == (2, 3)
