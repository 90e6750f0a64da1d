"""The float64 executor: what it refuses, and its rasterization against the brute-force oracle."""

import inspect
import threading

import brute_force
import numpy as np
import pytest
from corpus import scenes
from graphs import Graph

from dressi_edge.cache.errors import GraphError, InputError
from dressi_edge.cache.layout import Layout
from dressi_edge.compiler import Program
from dressi_edge.compiler.graph import reference_session
from dressi_edge.compiler.graph.functions import constant, mean, total
from dressi_edge.compiler.graph.ir import table, topological
from dressi_edge.compiler.graph.ops.lookup import to_table
from dressi_edge.compiler.graph.optable import OPS
from dressi_edge.compiler.graph.reference import evaluate
from dressi_edge.compiler.graph.reference_session import ReferenceSession
from dressi_edge.compiler.render.atlas import Atlas
from dressi_edge.compiler.render.raster import Softness, rasterized
from dressi_edge.compiler.render.topology import Topology
from dressi_edge.runtime.session import Session

pytest_plugins = ["gpu"]

RADIUS = 3.0


def test_a_missing_value_is_named():
    x = Program().input("depth", Layout("image", "float", 3, 2))
    with pytest.raises(GraphError, match="no value for input depth"):
        evaluate([x + 1.0], {"other": np.zeros((2, 3, 1))})


@pytest.mark.parametrize("shape", [(3, 2, 1), (2, 3), (2, 3, 3), (), (1, 1, 1)])
def test_a_value_of_another_shape_is_refused_with_both_shapes(shape):
    x = Program().input("depth", Layout("image", "float", 3, 2))
    with pytest.raises(GraphError, match=r"depth has shape .* \(2, 3, 1\) is needed"):
        evaluate([x], {"depth": np.zeros(shape)})


@pytest.mark.parametrize("seed", range(5))
def test_every_value_has_its_nodes_type_and_shape(seed):
    graph = Graph(seed)
    for node, value in zip(graph.nodes, evaluate(graph.nodes, graph.feed)):
        assert value.shape == (node.extent.height, node.extent.width, node.channels)
        assert value.dtype == (np.int64 if node.vtype.startswith("i") else np.float64)
        assert np.isfinite(value).all()


def test_padding_is_never_counted():
    layout = Layout("table", "vec3", count=9)
    x = Program().input("x", layout)
    assert x.extent == table(9) and x.extent.width * x.extent.height > 9
    values = np.random.default_rng(0).normal(size=(9, 3))
    feed = layout.to_image(values, "x")
    feed.reshape(-1, 3)[9:] = 1e9
    np.testing.assert_allclose(evaluate([total(x), mean(x)], {"x": feed})[0][0, 0], values.sum(0))
    np.testing.assert_allclose(evaluate([mean(x)], {"x": feed})[0][0, 0], values.mean(0))


def test_one_by_one_stands_for_any_extent():
    x = Program().input("x", Layout("unit", "vec3"))
    y, = evaluate([constant(np.ones((2, 5, 1))) * x], {"x": np.array([[[1.0, 2.0, 3.0]]])})
    np.testing.assert_array_equal(y, np.broadcast_to([1.0, 2.0, 3.0], (2, 5, 3)))


# Rasterization


def layers_of(scene, layers):
    """Codes (h, w, layers) of the reference's raster ops, -2 outside the edge mask, where they are not meant."""
    w, h = scene.size
    topology = Topology(np.asarray(scene.faces), len(scene.clip))
    clip, atlas = constant(to_table(scene.clip), table(len(scene.clip))), Atlas(w, h, 1, 1)
    found = {}
    for softness in (Softness(RADIUS, layers=layers), Softness(RADIUS, distance="face")):
        made = rasterized(clip, topology, atlas, softness, scene.near)
        for n in topological([made.edge_mask, *(layer.face for layer in made.layers)]):
            if n.op.stage == "raster" or n is made.edge_mask:
                found.setdefault(n.op.name, []).append(n)
    *peels, single, hard, mask = evaluate([*found["rasterize_first"], *found["rasterize_peel"], *found["rasterize"],
                                           *found["rasterize_hard"][:1], *found["inside_tiles"][:1]])
    assert len(peels) == layers
    np.testing.assert_array_equal(single[..., 0], peels[0][..., 0])
    front = np.where((single >= 0) & (single & 1 == 1), single >> 1, -1)
    np.testing.assert_array_equal(hard[mask != 0], front[mask != 0])
    return np.where(mask != 0, np.concatenate([p[..., :1] for p in peels], 2), -2)


@pytest.mark.parametrize("name", scenes())
def test_peels_are_the_layers_of_the_oracle(name):
    scene = scenes()[name]
    codes = layers_of(scene, 5)
    expected = brute_force.select(scene.clip, scene.faces, scene.size, RADIUS, layers=5, near=scene.near)
    found, hard = np.where(codes >= 0, codes >> 1, -1), (codes >= 0) & (codes & 1 == 1)
    meant = codes[..., 0] > -2
    np.testing.assert_array_equal(meant, expected.edge_mask)
    sure = meant & (expected.margins.color > 1e-9)
    np.testing.assert_array_equal(found[sure], expected.face[sure])
    nearly = meant & (expected.margins.value > 1e-9)  # equally far faces may change places, but which are there does not change
    np.testing.assert_array_equal(hard[nearly], expected.inside[nearly])
    np.testing.assert_array_equal((found >= 0)[nearly], (expected.face >= 0)[nearly])


def test_equal_faces_are_peeled_by_index():
    """Equation 3 with ties: two copies of one triangle, the lower index in front, both hard and soft."""
    codes = layers_of(scenes()["coincident"], 3)
    some = codes[..., 0] >= 0
    assert some.sum() > 30 and ((codes[..., 0] >> 1)[some] == 0).all() and ((codes[..., 1] >> 1)[some] == 1).all()
    assert (codes[..., 2] < 0).all()


def test_every_raster_op_has_a_reference():
    assert all(o.ref is not None for o in OPS.values() if o.stage == "raster")


# The session


ON_DEVICES = {"checkpoint", "restore", "profile_stages", "pictures"}  # what a session has beyond this one


@pytest.fixture
def session():
    p, unit = Program(), Layout("unit", "float")
    x, rate = p.state("x", unit, 8.0), p.input("rate", unit)
    p.plan("halve", {"x": x * 0.5}, {"halve.loss": (x * x, unit)})
    p.plan("move", {"x": x + rate}, {})
    return ReferenceSession(p)


def public(cls):
    return {name: inspect.signature(f) for name, f in vars(cls).items() if inspect.isfunction(f) and not name.startswith("_")}


def test_it_has_the_face_of_a_session_on_a_device():
    here, there = public(ReferenceSession), public(Session)
    assert here.keys() == there.keys() - ON_DEVICES
    for name, signature in here.items():
        assert [(q.name, q.kind, q.default) for q in signature.parameters.values()] == \
            [(q.name, q.kind, q.default) for q in there[name].parameters.values()], name
        assert signature.return_annotation == there[name].return_annotation, name


def spiral():
    """Two phases that give out what depends on the state that they update, one of them the same output as the other; a plan that only
    shows; an input that nobody has set."""
    p, unit = Program(), Layout("unit", "float")
    x, y = p.state("x", unit, 8.0), p.state("y", Layout("image", "vec2", 3, 2), 0.5)
    rate, late = p.input("rate", unit, 0.25), p.input("late", unit)
    bent = y * 0.75 + x * rate
    p.plan("turn", {"x": x * 0.5 + rate, "y": bent}, {"turn.loss": (x * x, unit), "seen": (y, Layout("image", "vec2", 3, 2)),
                                                      "both": (x + 1.0, unit)})
    p.plan("lift", {"x": x + late}, {"both": (x * 3.0, unit), "lift.loss": (x - late, unit)})
    p.plan("show", {}, {"shown": (bent, Layout("image", "vec2", 3, 2)), "late.too": (late * 2.0, unit)})
    return p


NAMES = ("x", "y", "turn.loss", "seen", "both", "lift.loss", "shown", "late.too")


def found(session, name):
    """The value, or the words of the error."""
    try:
        return session.get(name)
    except InputError as error:
        return str(error)


def test_what_phases_give_out_is_what_a_device_gives_out(gpu):
    """Values and refusals, after everything that may happen between two steps."""
    doings = [lambda s: None, lambda s: s.step(0, "turn"), lambda s: s.step(1, "turn"), lambda s: s.step(2), lambda s: s.set("x", 3.0),
              lambda s: s.set("late", -1.5), lambda s: s.step(1, "lift"), lambda s: s.set("rate", 0.5), lambda s: s.step(3, "turn"),
              lambda s: s.set("y", np.full((2, 3, 2), 0.125))]
    with gpu.open(spiral()) as device, ReferenceSession(spiral()) as reference:
        for number, do in enumerate(doings):
            do(device)
            do(reference)
            for name in NAMES:
                here, there = found(reference, name), found(device, name)
                if isinstance(there, str):
                    assert here == there, (number, name)
                else:
                    np.testing.assert_allclose(here, there, rtol=1e-6, err_msg=f"{number} {name}")
        assert reference.report()["runs"]["turn"] == device.report()["runs"]["turn"] == 6
        assert reference.get("turn.loss") != reference.get("x") ** 2  # of the state before the update
    gpu.silent()


def test_a_phase_without_its_input_says_so_as_on_a_device(gpu):
    with gpu.open(spiral()) as device, ReferenceSession(spiral()) as reference:
        for session in (device, reference):
            with pytest.raises(InputError, match="^lift needs late; set it first$"):
                session.step(1, "lift")
            assert session.get("x") == 8.0 and session.report()["runs"]["lift"] == 0
    gpu.silent()


def test_an_interrupt_leaves_whole_iterations(session, monkeypatch):
    """Whatever line it comes at: the state is that of the count."""
    real, calls = reference_session.evaluate, iter(range(100))

    def evaluate(*args):
        if next(calls) == 3:
            raise KeyboardInterrupt
        return real(*args)

    monkeypatch.setattr(reference_session, "evaluate", evaluate)
    with pytest.raises(KeyboardInterrupt):
        session.step(10, "halve")
    assert session.report()["runs"]["halve"] == 3 and session.get("x") == 1.0 and session.get("halve.loss") == 4.0


def test_steps_are_counted_bounded_and_cancelled(session):
    assert session.step(2) == 2 and session.get("x") == 2.0
    asked = iter([False, True])
    assert session.step(10, cancel=lambda: next(asked)) == 1 and session.get("x") == 1.0
    stop = threading.Event()
    stop.set()
    assert session.step(5, cancel=stop) == session.step(5, seconds=0) == session.step(0, seconds=1) == 0
    done = session.step(10 ** 9, "halve", seconds=0.05)
    assert 0 < done < 10 ** 9 and session.report()["runs"]["halve"] == 3 + done


@pytest.mark.parametrize("arguments, options, message", [
    ((-1,), {}, "0 or more"), ((1.5,), {}, "0 or more"), (("3",), {}, "0 or more"), ((1, "nothing"), {}, "no phase"),
    ((1,), {"seconds": -1}, "seconds=-1"), ((1,), {"seconds": "1"}, "0 or more"), ((1,), {"cancel": 1}, "a function is needed")])
def test_wrong_steps_are_refused(session, arguments, options, message):
    with pytest.raises(InputError, match=message):
        session.step(*arguments, **options)
    assert session.get("x") == 8.0
