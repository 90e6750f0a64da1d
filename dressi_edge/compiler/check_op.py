"""Tests of a row of the op table: `check_op` for ops of users, and what the tests of ours are made of.

In: an op, or its name, and arguments (its own sample by default). What is checked: the reference has the type and extent that the inference
says; the GLSL on the device is the reference, also with one value for all texels and, where types are free, with other numbers of
channels; the VJP is the central difference of the reference; facts (`Op.when`) hold. Raises GraphError with the first thing wrong.
"""
from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Collection, Iterator, Sequence

import numpy as np

from ..cache.errors import DressiError, GraphError
from ..cache.layout import Layout
from .graph.autodiff import gradients
from .graph.functions import dot, total
from .graph.ir import Node, is_int, vector_type
from .graph.optable import EMPTY, NEGATIVE, OPS, Op, apply, elementwise, floats, integers
from .graph.program import Program
from .graph.reference import evaluate

RTOL = 2e-6  # of fp32 against float64, for a few operations


def layout_of(node: Node) -> Layout:
    """The layout in which a node is given out: a table where its extent has padding, else an image."""
    e = node.extent
    return Layout("image", node.vtype, e.width, e.height) if e.count == e.width * e.height else Layout("table", node.vtype, count=e.count)


def image_layout(array: np.ndarray) -> Layout:
    """The image layout of an array (h, w, c), integers as such."""
    h, w, c = array.shape
    return Layout("image", vector_type(c, array.dtype.kind in "iu"), w, h)


def rounded(array: np.ndarray) -> np.ndarray:
    """As the device holds it: floats of fp32, in float64."""
    return array if array.dtype.kind in "iu" else array.astype(np.float32).astype(np.float64)


def seeded(name: str) -> np.random.Generator:
    """Random numbers that depend on the name alone."""
    return np.random.default_rng(list(name.encode()))


def sample_of(row: Op) -> tuple[list, dict]:
    """Arguments (arrays or nodes) and attributes to test a row with: its sample, or normal numbers of three channels."""
    rng = seeded(row.name)
    return row.sample(rng) if row.sample else ([rng.normal(size=(4, 5, 3)) for _ in row.params], {})


def given(program: Program, key: str, arguments: Sequence, feed: dict) -> list[Node]:
    """Inputs of a program for the arrays among the arguments; their values, as the device has them, are put into `feed`."""
    nodes = []
    for k, a in enumerate(arguments):
        if not isinstance(a, Node):
            feed[f"{key}/{k}"] = rounded(np.asarray(a))
            a = program.input(f"{key}/{k}", image_layout(np.asarray(a)))
        nodes.append(a)
    return nodes


def compare(device: np.ndarray, reference: np.ndarray, rtol: float, where: str, least: float | None = None) -> None:
    """Integers are equal; floats to rtol of the value or, as sums cancel, of the largest (or `least`); overflow is infinite on both
    sides. Raises GraphError."""
    if reference.dtype.kind == "i":
        wrong, expected = device != reference, reference
    else:
        with np.errstate(over="ignore", invalid="ignore"):
            expected = reference.astype(np.float32).astype(np.float64)
            finite = np.isfinite(expected)
            floor = rtol * np.abs(expected[finite]).max(initial=0) if least is None else least
            off = np.abs(device.astype(np.float64) - expected) > rtol * np.abs(expected) + floor
            same = (device == expected) | np.isnan(device) & np.isnan(expected)
        wrong = np.where(finite, off | ~np.isfinite(device), ~same)
    if wrong.any():
        at = tuple(int(i) for i in np.argwhere(wrong)[0])
        raise GraphError(f"{where}: the device has {device[at]} at {list(at)}, the reference {expected[at]}; {wrong.sum()} of {wrong.size} "
                         "numbers differ")


def central(loss: Node, feed: dict, name: str, h: float = 1e-6) -> np.ndarray:
    """Central differences of a 1 x 1 loss by every number of one input, in the reference."""
    out = np.zeros_like(feed[name])
    for k in np.ndindex(out.shape):
        ends = []
        for step in (h, -h):
            moved = feed[name].copy()
            moved[k] += step
            ends.append(evaluate([loss], {**feed, name: moved})[0].item())
        out[k] = (ends[0] - ends[1]) / (2 * h)
    return out


def check_gradients(name: str, arguments: Sequence, build: Callable[..., Node], without: Collection[int] = (),
                    rtol: float = 2e-6, atol: float = 1e-7) -> None:
    """The gradients of what `build` makes of inputs with these values are central differences, but by those `without`. Raises
    GraphError."""
    program, feed, rng = Program(), {}, seeded(name + "gradient")
    nodes = []
    for k, a in enumerate(arguments):
        if not isinstance(a, Node):
            feed[f"x{k}"] = a.astype(np.int64 if a.dtype.kind in "iu" else np.float64)
            a = program.input(f"x{k}", image_layout(a))
        nodes.append(a)
    y = build(*nodes)
    weights = program.input("weights", layout_of(y))
    feed["weights"] = rng.normal(size=(y.extent.height, y.extent.width, y.channels))
    loss = total(dot(y, weights))
    wrt = [x for k, x in enumerate(nodes) if x.op.name == "input" and not is_int(x.vtype) and k not in without]
    for x, g in zip(wrt, gradients(loss, wrt)):
        if (g.vtype, g.extent) != (x.vtype, x.extent):
            raise GraphError(f"{name}: the gradient by {x!r} is {g!r}")
        difference, found = central(loss, feed, x.name), evaluate([g], feed)[0]
        if np.abs(difference).max() <= 1e-3:
            raise GraphError(f"{name}: with this sample the result does not depend on {x.name}: the test says nothing")
        wrong = ~(np.abs(found - difference) <= rtol * np.abs(difference) + atol)
        if wrong.any():
            at = tuple(int(i) for i in np.argwhere(wrong)[0])
            raise GraphError(f"{name}: the VJP by {x.name} is {found[at]:.6g} at {list(at)}, the central difference {difference[at]:.6g}; "
                             f"{wrong.sum()} of {wrong.size} numbers differ")


def check_op(op: Op | str, arguments: Sequence | None = None, attrs: dict | None = None, *, without: Sequence[str] = (), rtol: float = RTOL,
             profile: str = "vulkan_min", device: bool = True) -> None:
    """Test a row of the table; see the module's text.

    arguments: arrays (h, w, c), floats or integers, or nodes, one for each input, and `attrs`, its attributes: by default its `sample`.
    without: inputs by which the op has, by its documentation, no gradient. rtol: how far fp32 may be from float64, of the largest
    number. profile: what the GLSL is compiled for; it is run on the first device that fits, not at all with device=False.
    Raises GraphError, and DeviceError where there is none."""
    row = OPS.get(op) if isinstance(op, str) else op
    if row is None or OPS.get(row.name) is not row:
        raise GraphError(f"check_op: {op!r:.60} is no op of the table; op(...) puts it there")
    if not row.doc or row.ref is None or not (row.glsl or row.loop or row.draws):
        raise GraphError(f"{row.name}: an op has a reference, GLSL and a sentence of documentation (doc)")
    if unknown := [word for word in without if word not in row.params]:
        raise GraphError(f"{row.name}: without names {unknown[0]!r:.40}; its inputs are {' '.join(row.params)}")
    sample = (list(arguments), attrs or {}) if arguments is not None else sample_of(row)
    found = dict(_cases(row, *sample))
    program, feed = Program(), {}
    nodes = {case: apply(row.name, *given(program, case, values, feed), **sample[1]) for case, values in found.items()}
    for case, y in nodes.items():
        _check_reference(row, case, y, feed)
    _check_facts(row, *sample)
    if row.vjp is not None:
        check_gradients(row.name, sample[0], lambda *xs: apply(row.name, *xs, **sample[1]), [row.params.index(word) for word in without])
    if device:
        _check_device(row, program, nodes, feed, rtol, profile)


def _cases(row: Op, arguments: list, attrs: dict) -> Iterator[tuple[str, list]]:
    """The sample; each input as one value for all; of ops that are free in their types, other numbers of channels."""
    yield "sample", arguments
    for k, param in enumerate(row.params):
        if not isinstance(arguments[k], Node) and arguments[k].shape[:2] != (1, 1) and row.read(k) == "own":
            yield f"{param} 1x1", [a[:1, :1] if j == k else a for j, a in enumerate(arguments)]
    if row.infer in (elementwise, floats, integers) and not any(isinstance(a, Node) for a in arguments):
        for c in (1, 2, 4):
            yield f"{c} channels", [np.concatenate([a] * 4, 2)[..., :c] if a.shape[2] > 1 or k == 0 else a for k, a in enumerate(arguments)]


def _check_reference(row: Op, case: str, y: Node, feed: dict) -> None:
    values = dict(zip(y.inputs, evaluate(y.inputs, feed)))
    shape = (y.extent.height, y.extent.width, y.channels)
    value = np.asarray(row.ref(*(values[x] for x in y.inputs), **y.attrs))
    try:
        fits = np.broadcast_shapes(value.shape, shape) == shape
    except ValueError:
        fits = False
    if not fits or (value.dtype.kind in "iub") != is_int(y.vtype) and value.dtype.kind != "b":
        raise GraphError(f"{row.name} ({case}): the reference gives {value.dtype} {value.shape}; by its inference it is {y!r}, {shape}")


def _check_facts(row: Op, arguments: list, attrs: dict) -> None:
    """What an input's value makes of the result, whatever the others are."""
    for when in row.when:
        a = arguments[when.input]
        array = np.array(a.attrs["data"].array if isinstance(a, Node) else a)
        array = np.broadcast_to(np.array([3, 3]), array.shape) if when.what == EMPTY else \
            -np.abs(array) - 1 if when.what == NEGATIVE else np.zeros_like(array)
        program, feed = Program(), {}
        y = apply(row.name, *given(program, "fact", [array if k == when.input else x for k, x in enumerate(arguments)], feed), **attrs)
        if not (evaluate([y], feed)[0] == when.result).all():
            raise GraphError(f"{row.name}: where {row.params[when.input]} is {when.what} the result is not {when.result}, as its facts say")


def _check_device(row: Op, program: Program, nodes: dict[str, Node], feed: dict, rtol: float, profile: str) -> None:
    from .. import runtime
    from . import compile_program

    program.plan("all", {}, {case: (y, layout_of(y)) for case, y in nodes.items()})
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "op.dressi")
        try:
            compile_program(program, profile, path)
        except GraphError:
            raise
        except DressiError as e:
            raise GraphError(f"{row.name}: its GLSL is refused: {' '.join(str(e).split()):.400}") from e
        with runtime.load(path) as session:
            for key, array in feed.items():
                session.set(key, program.values[key].layout.from_image(array))
            for case, y in nodes.items():
                reference = program.values[case].layout.from_image(evaluate([y], feed)[0])
                compare(np.asarray(session.get(case)), reference, rtol, f"{row.name} ({case})")
