"""Faces that fill large pictures: sums over their pixels, in bands of rows, against float64."""
import numpy as np
import pytest
from undertest import DEVICE

from dressi_edge import runtime
from dressi_edge.compiler.graph.ir import topological
from dressi_edge.compiler.graph.reference_session import ReferenceSession
from dressi_edge.compiler.passes.bands import banded
from dressi_edge.compiler.passes.groups import grouped, lowered
from dressi_edge.compiler.scene import HardSoftRas, Mesh, Outline, Scene, Unlit, Vertex, icosphere, look_at
from dressi_edge.primitives.boxes import boxes
from dressi_edge.primitives.store import Store

pytest_plugins = ["gpu"]
FLOOR = Mesh(np.array([[-2, -2, 0], [2, -2, 0], [2, 2, 0], [-2, 2, 0]], float), np.array([[0, 1, 2], [0, 2, 3]]))


def scene_of(mesh, size, renderer, ball=False):
    """A mesh whose places and colours have gradients by the picture, and perhaps a ball before it."""
    s = Scene([look_at((0.1, 0.2, 3), (0, 0, 0), (0, 1, 0), 60, *size)])
    places = s.parameter("places", mesh.positions)
    colors = s.parameter("colors", np.random.default_rng(1).uniform(0, 1, mesh.positions.shape))
    s.add(mesh, places, Unlit(Vertex(colors)))
    if ball:
        s.add(icosphere(2, 0.5), material=Unlit(1.0))
    s.vjp("p", ["places", "colors"], color=s.frame(renderer).color)
    return s


def gradients(session, size):
    y, x = np.mgrid[:size[1], :size[0]] / size[0]
    session.forward("p")
    return session.backward("p", color=np.stack([np.sin(3 * x + 1) + y, np.cos(4 * y) + x, np.sin(6 * x * y)], -1)[None])


@pytest.mark.parametrize(("size", "renderer", "ball"), [((333, 217), Outline(2), True), ((400, 400), Outline(2), False),
                                                        ((256, 256), HardSoftRas(2, layers=3), False)])
def test_all_pixels_of_a_large_face_count(gpu, size, renderer, ball):
    scene = scene_of(FLOOR, size, renderer, ball)
    with runtime.load(gpu.compile(scene.program), gpu.device) as session, ReferenceSession(scene.program) as exact:
        found, true = gradients(session, size), gradients(exact, size)
    gpu.silent()
    for name in true:
        assert np.linalg.norm(found[name] - true[name]) < 2e-4 * np.linalg.norm(true[name]), name


def sums_of(scene):
    groups = banded(lowered(grouped(scene.program)), scene.program)
    return {n.op.name for group in groups for n in topological([r for some in group.roots for r in some]) if "segment_sum" in n.op.name}


def test_small_faces_are_summed_in_one_go():
    assert sums_of(scene_of(icosphere(3, 0.9), (256, 256), Outline(2))) == {"segment_sum"}
    assert sums_of(scene_of(FLOOR, (60, 60), Outline(2))) == {"segment_sum"}
    assert sums_of(scene_of(FLOOR, (256, 256), Outline(2))) == {"segment_sum_banded"}


def test_a_function_that_knows_no_places_beforehand_counts_all_pixels(tmp_path, monkeypatch):
    """A square of two triangles over the whole picture: what its corners get of a gradient of ones is as much as there are pixels."""
    monkeypatch.setenv("DRESSI_CACHE", str(tmp_path))
    store, (w, h) = Store(DEVICE), (400, 300)
    corners, tri = np.array([[-1, -1, 0, 1], [1, -1, 0, 1], [1, 1, 0, 1], [-1, 1, 0, 1]], np.float32), FLOOR.faces.astype(np.int32)
    drawn = store.find("rasterize", tri, (4, 1, (w, h)), {})
    rast = drawn.forward({"pos": corners})[0]["rast"]
    attr = np.ones((4, 3), np.float32)
    shaded = store.find("interpolate", tri, (4, 1, (w, h), 3, False), {"attr": 3, "out": 3})
    out, call = shaded.forward({"attr": attr, "rast": rast, "boxes": boxes(rast, len(tri), drawn.columns)})
    found = shaded.backward(call, {"out": np.ones_like(out["out"])}, ["attr"])["attr"]
    store.close()
    np.testing.assert_allclose(found.sum(0), w * h, rtol=1e-5)
