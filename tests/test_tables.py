"""Tables put together and cut, constant matrices, and neighbours in a cell: against NumPy, with exact transposes, and what is refused.

The rows of the op table have their own tests (test_ops.py); here are the functions that users call.
"""

import numpy as np
import pytest
from graphs import image_layout, layout_of
from test_ops import check_gradients

from dressi_edge.cache.errors import GraphError
from dressi_edge.cache.layout import Layout
from dressi_edge.compiler import Program
from dressi_edge.compiler.graph import functions as F
from dressi_edge.compiler.graph.autodiff import gradients
from dressi_edge.compiler.graph.ir import image, table, topological
from dressi_edge.compiler.graph.ops.lookup import to_table
from dressi_edge.compiler.graph.reference import evaluate

pytest_plugins = ["gpu"]
RNG = np.random.default_rng(5)


def flat(node, feed):
    """The entries (n, channels) of a node in the reference."""
    return evaluate([node], feed)[0].reshape(-1, node.channels)[:node.extent.count]


def table_input(count, vtype="float", name="x"):
    """A table input and random values for it."""
    layout = Layout("table", vtype, count=count)
    node = Program().input(name, layout)
    return node, {name: layout.to_image(RNG.normal(size=layout.shape), name)}


def adjoint(y, x, feed):
    """Whether <y, b> = <x, gradient> for random b, with a y that is linear in x: the transpose is exact."""
    b = RNG.normal(size=(y.extent.height, y.extent.width, y.channels))
    weights = F.constant(b, y.extent)
    g, = gradients(F.total(F.dot(y, weights)), [x])
    forward = (flat(y, feed) * b.reshape(-1, y.channels)[:y.extent.count]).sum()
    np.testing.assert_allclose((flat(g, feed) * flat(x, feed)).sum(), forward, rtol=1e-11)


# Tables


@pytest.mark.parametrize("sizes", [(3,), (1, 1), (4, 5), (3, 1, 7), (2, 2, 2, 2), (5, 1, 3, 9, 2, 4, 6, 1, 1)], ids=str)
def test_concat_is_concatenate_and_its_gradients_are_slices(sizes):
    program, feed, parts = Program(), {}, []
    for k, n in enumerate(sizes):
        layout = Layout("table", "vec3", count=n)
        parts.append(program.input(f"x{k}", layout))
        feed[f"x{k}"] = layout.to_image(RNG.normal(size=layout.shape), "x")
    y = F.concat(*parts)
    assert y.extent == table(sum(sizes))
    np.testing.assert_array_equal(flat(y, feed), np.concatenate([flat(x, feed) for x in parts]))
    check_gradients("concat", [to_table(RNG.normal(size=(n, 3))) for n in sizes], {}, build=F.concat)


def test_concat_takes_images_as_their_texels_and_constants():
    x = Program().input("x", Layout("image", "float", 3, 2))
    feed = {"x": np.arange(6.0).reshape(2, 3, 1)}
    np.testing.assert_array_equal(flat(F.concat(x, F.constant_table([7.0, 8.0])), feed).ravel(), [0, 1, 2, 3, 4, 5, 7, 8])
    assert F.concat(x).extent == table(6)


def test_slice_and_pad_are_transposes():
    x, feed = table_input(11, "vec2")
    y = F.slice_table(x, 3, 5)
    np.testing.assert_array_equal(flat(y, feed), flat(x, feed)[3:8])
    adjoint(y, x, feed)
    wide = F.pad(x, 4, 20)
    np.testing.assert_array_equal(flat(wide, feed), np.pad(flat(x, feed), ((4, 5), (0, 0))))
    adjoint(wide, x, feed)


def test_a_table_is_an_image_and_an_image_a_table():
    x, feed = table_input(12, "vec3")
    y = F.to_image(x, 6, 2)
    assert y.extent == image(6, 2)
    np.testing.assert_array_equal(evaluate([y], feed)[0], flat(x, feed).reshape(2, 6, 3))
    np.testing.assert_array_equal(flat(F.to_table(y), feed), flat(x, feed))
    adjoint(y, x, feed)
    adjoint(F.to_table(F.to_image(x, 4, 3) * 2.0), x, feed)


# Matrices


@pytest.mark.parametrize("shape", [(1, 1), (5, 1), (7, 4), (1, 9), (600, 10), (9, 3, 5), (40, 2, 17), (3, 1, 2), (6, 4, 8)], ids=str)
def test_matmul_is_the_product_and_has_its_transpose(shape):
    matrix = RNG.normal(size=shape).astype(np.float32)
    x, feed = table_input(shape[-1])
    y = F.matmul(matrix, x)
    assert y.extent == table(shape[0]) and y.channels == (shape[1] if len(shape) == 3 else 1)
    expected = matrix.astype(np.float64) @ flat(x, feed)[:, 0]
    np.testing.assert_allclose(flat(y, feed), expected.reshape(shape[0], -1), rtol=1e-12, atol=1e-12)
    adjoint(y, x, feed)


def test_a_morphable_model_on_the_device_is_the_reference_both_ways(gpu):
    """Mean + basis times coefficients, 3,000 vertices, 30 coefficients: value, gradient, and the same bits again."""
    basis = RNG.normal(size=(3000, 3, 30)).astype(np.float32)
    program = Program()
    x = program.input("x", Layout("table", "float", count=30))
    y = F.matmul(basis, x) + F.constant_table(RNG.normal(size=(3000, 3)))
    g, = gradients(F.mean(F.dot(y, y)), [x])
    program.plan("p", {}, {"y": (y, layout_of(y)), "g": (g, layout_of(g))})
    value = program.values["x"].layout.to_image(RNG.normal(size=30).astype(np.float32), "x")
    first, again = (gpu.run(program, {"x": value}) for _ in range(2))
    for key, node in (("y", y), ("g", g)):
        np.testing.assert_array_equal(first[key], again[key])
        expected = flat(node, {"x": value}).reshape(first[key].shape)
        np.testing.assert_allclose(first[key], expected, rtol=0, atol=3e-6 * np.abs(expected).max())
    matrices = [n for n in topological([y, g]) if n.op.name == "constant" and n.extent.count > 3000]
    assert [n.extent.count for n in matrices] == [3000 * 3 * 8], "the basis is kept once"


@pytest.mark.parametrize("vtype", ["float", "vec3", "vec4"])
def test_sparse_matmul_is_the_product_and_has_its_transpose(vtype):
    n, k, m = 20, 13, 90
    rows, cols, values = RNG.integers(0, n, m), RNG.integers(0, k, m), RNG.normal(size=m)
    dense = np.zeros((n, k))
    np.add.at(dense, (rows, cols), values)
    x, feed = table_input(k, vtype)
    y = F.sparse_matmul(rows, cols, values, x, n)
    np.testing.assert_allclose(flat(y, feed), dense @ flat(x, feed), atol=1e-12)
    adjoint(y, x, feed)


def test_sparse_matmul_has_as_many_rows_as_it_needs_and_may_be_empty():
    x, feed = table_input(4, "vec3")
    assert F.sparse_matmul(np.array([2]), np.array([0]), np.array([1.0]), x).extent == table(3)
    none = np.zeros(0, int)
    assert not flat(F.sparse_matmul(none, none, none, x, 5), feed).any()


# Neighbours


def cells(x, w, h):
    """The cells of an atlas (h, w, c), one after the other."""
    return [x[j:j + h, i:i + w] for j in range(0, x.shape[0], h) for i in range(0, x.shape[1], w)]


def joined(parts, like, w, h):
    out = np.zeros((like[0], like[1], parts[0].shape[2]))
    for part, (j, i) in zip(parts, [(j, i) for j in range(0, like[0], h) for i in range(0, like[1], w)]):
        out[j:j + h, i:i + w] = part
    return out


def shifted(x, dx, dy, edge):
    r = max(abs(dx), abs(dy))
    padded = np.pad(x, ((r, r), (r, r), (0, 0)), "edge" if edge == "clamp" else "constant")
    return padded[r - dy:r - dy + x.shape[0], r - dx:r - dx + x.shape[1]]


@pytest.mark.parametrize("edge", ["clamp", "zero"])
@pytest.mark.parametrize("by", [(0, 0), (1, 0), (-2, 1), (3, -4), (9, 0), (0, -20)], ids=str)
def test_shift_moves_every_cell_on_its_own(by, edge):
    x = RNG.normal(size=(8, 10, 2))
    node = Program().input("x", image_layout(x))
    y = F.shift(node, *by, edge=edge, cell=(5, 4))
    np.testing.assert_array_equal(evaluate([y], {"x": x})[0], joined([shifted(c, *by, edge) for c in cells(x, 5, 4)], x.shape, 5, 4))
    adjoint(y, node, {"x": x})


@pytest.mark.parametrize("edge", ["clamp", "zero"])
@pytest.mark.parametrize("kernel", [[1.0], [0.25, 0.5, 0.25], ([1.0, -2.0, 0.5], [3.0]), list(np.linspace(-1, 2, 11))], ids=str)
def test_convolve_is_convolve_of_every_cell(kernel, edge):
    x = RNG.normal(size=(8, 10, 1))
    node = Program().input("x", image_layout(x))
    y = F.convolve(node, kernel, edge, cell=(5, 4))
    across, down = kernel if isinstance(kernel, tuple) else (kernel, kernel)

    def blurred(c):
        for axis, taps in ((1, across), (0, down)):
            r = len(taps) // 2
            pad = [(0, 0)] * 3
            pad[axis] = (r, r)
            padded = np.pad(c, pad, "edge" if edge == "clamp" else "constant")
            c = np.apply_along_axis(lambda line: np.convolve(line, taps, "valid"), axis, padded)  # noqa: B023
        return c

    np.testing.assert_allclose(evaluate([y], {"x": x})[0], joined([blurred(c) for c in cells(x, 5, 4)], x.shape, 5, 4), atol=1e-12)
    adjoint(y, node, {"x": x})


@pytest.mark.parametrize("cell", [(4, 2), (5, 3), (1, 1), (2, 5)], ids=str)
def test_halves_are_means_of_what_there_is(cell):
    w, h = cell
    x = RNG.normal(size=(2 * h, 3 * w, 3))
    node = Program().input("x", image_layout(x))
    y = F.downsample(node, cell)
    small = [np.array([[c[j:j + 2, i:i + 2].mean((0, 1)) for i in range(0, w, 2)] for j in range(0, h, 2)]) for c in cells(x, w, h)]
    hw, hh = -(-w // 2), -(-h // 2)
    expected = joined(small, (2 * hh, 3 * hw), hw, hh)
    np.testing.assert_allclose(evaluate([y], {"x": x})[0], expected, atol=1e-12)
    adjoint(y, node, {"x": x})
    large = F.upsample(y, cell)
    assert large.extent == node.extent
    repeated = joined([s.repeat(2, 0).repeat(2, 1)[:h, :w] for s in small], x.shape, w, h)
    np.testing.assert_allclose(evaluate([large], {"x": x})[0], repeated, atol=1e-12)
    adjoint(F.upsample(y * 1.0, cell), node, {"x": x})


def test_a_pyramid_in_an_atlas_on_the_device_is_the_reference(gpu):
    """Three levels of blurred differences, weighted, and their gradient, for two views of 21 x 13."""
    x = RNG.normal(size=(13, 42, 3)).astype(np.float32).astype(np.float64)
    program = Program()
    node, cell, loss = program.input("x", image_layout(x)), (21, 13), 0.0
    level = node
    for _ in range(3):
        d = F.convolve(level, [0.25, 0.5, 0.25], cell=cell) - F.shift(level, 2, 1, cell=cell)
        loss = loss + F.mean(F.dot(d, d))
        level, cell = F.downsample(level, cell), (-(-cell[0] // 2), -(-cell[1] // 2))
    g, = gradients(loss, [node])
    program.plan("p", {}, {"g": (g, layout_of(g)), "loss": (loss, layout_of(loss))})
    device, reference = gpu.run(program, {"x": x}), evaluate([g, loss], {"x": x})
    np.testing.assert_allclose(device["g"], reference[0], rtol=0, atol=1e-6 * np.abs(reference[0]).max())
    np.testing.assert_allclose(device["loss"], reference[1].item(), rtol=1e-6)


# What is refused


def scalars(count=6, vtype="float"):
    return Program().input("x", Layout("table", vtype, count=count))


REFUSED = {
    "concat of nothing": (lambda: F.concat(), "no tables"),
    "concat of arrays": (lambda: F.concat(scalars(), np.ones(3)), "nodes are needed"),
    "concat of two types": (lambda: F.concat(scalars(), scalars(6, "vec3")), "one type"),
    "slice beyond the end": (lambda: F.slice_table(scalars(), 4, 3), "entries 4 to 6 of"),
    "slice from before the start": (lambda: F.slice_table(scalars(), -1, 3), "start is -1"),
    "slice of nothing": (lambda: F.slice_table(scalars(), 1, 0), "count is 0"),
    "slice of halves": (lambda: F.slice_table(scalars(), 1.5, 2), "start is 1.5"),
    "pad too short": (lambda: F.pad(scalars(), 2, 7), "count is 7"),
    "image of another size": (lambda: F.to_image(scalars(), 4, 2), "6 entries, 4x2 has 8"),
    "an empty image": (lambda: F.to_image(scalars(), 0, 2), "width is 0"),
    "matmul of a vector": (lambda: F.matmul(np.ones(6), scalars()), "shape (6,)"),
    "matmul of five channels": (lambda: F.matmul(np.ones((2, 5, 6)), scalars()), "shape (2, 5, 6)"),
    "matmul of text": (lambda: F.matmul(np.array([["a"]]), scalars()), "type <U1"),
    "matmul of vectors": (lambda: F.matmul(np.ones((2, 6)), scalars(6, "vec3")), "a table of floats"),
    "matmul of an array": (lambda: F.matmul(np.ones((2, 6)), np.ones(6)), "a node is needed"),
    "matmul of other columns": (lambda: F.matmul(np.ones((2, 5)), scalars()), "5 columns"),
    "matmul with nan": (lambda: F.matmul(np.full((2, 6), np.nan), scalars()), "finite in fp32"),
    "matmul too wide": (lambda: F.matmul(np.ones((1, 16400)), scalars(16400)), "16384 columns"),
    "sparse of unequal lengths": (lambda: F.sparse_matmul([0, 1], [0], [1.0], scalars()), "(2,), (1,), (1,)"),
    "sparse of float rows": (lambda: F.sparse_matmul([0.5], [0], [1.0], scalars()), "integers"),
    "sparse column that is not there": (lambda: F.sparse_matmul([0], [6], [1.0], scalars()), "columns 6 to 6"),
    "sparse row that is not there": (lambda: F.sparse_matmul([3], [0], [1.0], scalars(), 3), "rows"),
    "sparse with inf": (lambda: F.sparse_matmul([0], [0], [np.inf], scalars()), "NaN, Inf"),
    "shift by half": (lambda: F.shift(scalars(4), 0.5, 0), "dx is 0.5"),
    "shift of an array": (lambda: F.shift(np.ones((2, 2)), 1, 0), "an image is needed"),
    "shift with another edge": (lambda: F.shift(scalars(4), 1, 0, edge="wrap"), "clamp or zero"),
    "shift of cells that do not fit": (lambda: F.shift(scalars(4), 1, 0, cell=(3, 1)), "whole cells of 3 x 1"),
    "shift of padding": (lambda: F.shift(scalars(6), 1, 0), "whole cells"),
    "a kernel of even length": (lambda: F.convolve(scalars(4), [0.5, 0.5]), "2 numbers"),
    "a kernel of text": (lambda: F.convolve(scalars(4), "abc"), "not made of numbers"),
    "a kernel with nan": (lambda: F.convolve(scalars(4), [np.nan]), "finite"),
    "halves of cells of nothing": (lambda: F.downsample(scalars(4), (0, 1)), "0 x 1"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_is_refused_in_one_sentence(name):
    build, words = REFUSED[name]
    with pytest.raises(GraphError) as raised:
        build()
    assert words in str(raised.value) and "\n" not in str(raised.value)
