"""Whole problems on lavapipe, from targets that we drew ourselves: each kind of parameter comes back."""
import numpy as np
import pytest

from dressi_edge import runtime
from dressi_edge.cache.errors import InputError
from dressi_edge.compiler.io.cameras import orbit
from dressi_edge.compiler.io.meshes import Mesh
from dressi_edge.compiler.io.shapes import icosphere
from dressi_edge.compiler.io.views import Views
from dressi_edge.compiler.render.light import Light
from dressi_edge.compiler.render.optimizer import Adam
from dressi_edge.compiler.render.raster import Softness
from dressi_edge.compiler.scene.problem import Loss, Problem

SIZE = 48
SOFT = Softness(2.0, layers=2)
pytest_plugins = ["gpu"]


def bumpy(colors=False):
    """A closed mesh without symmetry, 162 vertices."""
    ball = icosphere(2, 0.8)
    p = ball.positions * (1 + 0.3 * np.sin(3 * ball.positions[:, :1] + 1) + 0.2 * ball.positions[:, 1:2])
    paint = 0.5 + 0.4 * np.sin(4 * p + [0, 1, 2]) if colors else None
    return Mesh(positions=p, faces=ball.faces, uvs=ball.uvs, uv_faces=ball.uv_faces, colors=paint, texture=None)


def cameras(n=4):
    return orbit(n, [20, -20], 2.6, 50, (SIZE, SIZE))


def pictures(problem, gpu, path):
    """RGBA of all views."""
    problem.render("render", SOFT)
    problem.compile("lavapipe", path)
    with runtime.load(path, gpu.device) as s:
        return s.get("render.color")


def as_views(images, cams):
    return Views(images=images.astype(np.float32), cameras=tuple(cams), names=tuple(map(str, range(len(cams)))))


def test_vertex_colours_come_back(gpu, tmp_path):
    target = pictures(Problem(bumpy(True), cameras(), albedo="colors"), gpu, tmp_path / "t.dressi")
    problem = Problem(bumpy(), as_views(target, cameras()), albedo="colors")
    problem.phase("paint", 60, {"colors": Adam(0.05)}, [Loss("color")], SOFT)
    problem.compile("lavapipe", tmp_path / "x.dressi")
    with runtime.load(tmp_path / "x.dressi", gpu.device) as s:
        before = s.loss()
        s.step(60)
        assert s.loss() < 0.03 * before


def test_a_texture_comes_back_with_both_gradients(gpu, tmp_path):
    mesh = bumpy()
    rng = np.random.default_rng(0)
    painted = Mesh(positions=mesh.positions, faces=mesh.faces, uvs=mesh.uvs, uv_faces=mesh.uv_faces, colors=None,
                   texture=np.kron(rng.random((4, 6, 3)), np.ones((4, 4, 1))))
    target = pictures(Problem(painted, cameras()), gpu, tmp_path / "t.dressi")
    for mode in ("exact", "inverse_uv"):
        problem = Problem(mesh, as_views(target, cameras()), texture_size=(24, 16), texture_grad=mode)
        problem.phase("paint", 60, {"texture": Adam(0.05)}, [Loss("color", masked=True)], SOFT)
        problem.compile("lavapipe", tmp_path / "x.dressi")
        with runtime.load(tmp_path / "x.dressi", gpu.device) as s:
            before = s.loss()
            s.step(60)
            assert s.loss() < 0.1 * before, mode


def test_a_camera_comes_back(gpu, tmp_path):
    cams = cameras(3)
    target = pictures(Problem(bumpy(), cams, albedo="constant"), gpu, tmp_path / "t.dressi")
    problem = Problem(bumpy(), as_views(target, cams), albedo="constant")
    problem.phase("pose", 120, {"rotation": Adam({"start": 0.01, "end": 0.001, "steps": 120}),
                                "translation": Adam({"start": 0.02, "end": 0.002, "steps": 120})}, [Loss("silhouette")],
                  Softness(3.0, layers=2))
    problem.compile("lavapipe", tmp_path / "x.dressi")
    rng = np.random.default_rng(1)
    with runtime.load(tmp_path / "x.dressi", gpu.device) as s:
        s.set("rotation", 0.05 * rng.normal(size=(3, 3)))
        s.set("translation", 0.08 * rng.normal(size=(3, 3)))
        before = s.loss()
        s.step(120)
        assert s.loss() < 0.1 * before


def test_a_light_comes_back(gpu, tmp_path):
    sun = Light("directional", (2.0, 1.5, 1.0), (-0.4, -0.7, -0.6))
    target = pictures(Problem(bumpy(), cameras(), albedo="constant", shading="lambert", lights=[sun]), gpu, tmp_path / "t.dressi")
    guess = Light("directional", 1.0, (0.1, -1.0, -0.2))
    problem = Problem(bumpy(), as_views(target, cameras()), albedo="constant", shading="lambert", lights=[guess])
    problem.phase("light", 150, {"light0.power": Adam(0.03), "light0.vector": Adam(0.02)}, [Loss("color", masked=True)], SOFT)
    problem.compile("lavapipe", tmp_path / "x.dressi")
    with runtime.load(tmp_path / "x.dressi", gpu.device) as s:
        s.step(150)
        found = s.get("light0.vector")
        assert np.dot(found / np.linalg.norm(found), np.array(sun.vector) / np.linalg.norm(sun.vector)) > 0.99
        np.testing.assert_allclose(s.get("light0.power"), sun.power, rtol=0.1)


def test_shading_moves_vertices_that_no_silhouette_sees(gpu, tmp_path):
    sun = [Light("directional", 2.0, (-0.4, -0.7, -0.6)), Light("ambient", 0.2)]
    make = {"albedo": "constant", "shading": "lambert", "lights": sun}
    target = pictures(Problem(bumpy(), cameras(), **make), gpu, tmp_path / "t.dressi")
    problem = Problem(bumpy(), as_views(target, cameras()), **make)
    problem.phase("shape", 40, {"vertices": Adam(0.003)}, [Loss("color")], SOFT)
    problem.compile("lavapipe", tmp_path / "x.dressi")
    truth = bumpy().positions
    with runtime.load(tmp_path / "x.dressi", gpu.device) as s:
        dented = truth * (1 - 0.05 * (truth[:, 2:] > 0.5))
        s.set("vertices", dented)
        before = s.loss()
        s.step(40)
        assert s.loss() < 0.5 * before


@pytest.mark.parametrize("order", ["cycle", "shuffle"])
def test_one_view_a_step_sees_each_view(gpu, tmp_path, order):
    cams = cameras(3)
    target = pictures(Problem(bumpy(True), cams, albedo="colors"), gpu, tmp_path / "t.dressi")
    problem = Problem(bumpy(), as_views(target, cams), albedo="colors", order=order, seed=3)
    problem.phase("paint", 60, {"colors": Adam(0.05)}, [Loss("color")], SOFT)
    batch = Problem(bumpy(), as_views(target, cams), albedo="colors")
    batch.phase("paint", 60, {"colors": Adam(0.05)}, [Loss("color")], SOFT)
    problem.compile("lavapipe", tmp_path / "x.dressi")
    batch.compile("lavapipe", tmp_path / "b.dressi")
    with runtime.load(tmp_path / "x.dressi", gpu.device) as s, runtime.load(tmp_path / "b.dressi", gpu.device) as all_views:
        first = [s.loss()]
        for _ in range(2):
            s.set("paint.step", s.get("paint.step") + 1)
            first.append(s.loss())
        if order == "cycle":  # three single views make the mean of the batch
            assert abs(np.mean(first) - all_views.loss()) < 1e-6
        s.set("paint.step", 0)
        s.step(60)
        all_views.set("colors", s.get("colors"))
        assert all_views.loss() < 0.1 * np.mean(first)
        assert len(s.bundle.description["pipelines"]) <= len(all_views.bundle.description["pipelines"]) + 1


@pytest.mark.parametrize("change, expected", [
    ({"order": "random"}, "order is 'random'"), ({"shading": "phong"}, "shading is 'phong'"), ({"albedo": "paint"}, "albedo is 'paint'"),
    ({"shading": "lambert"}, "needs lights"), ({"texture_grad": "sum"}, "texture_grad is 'sum'")])
def test_wrong_choices_are_named(change, expected):
    with pytest.raises(InputError, match=expected):
        Problem(bumpy(), cameras(), **change)


def test_wrong_phases_are_named():
    problem = Problem(bumpy(), cameras(), albedo="constant")
    for arguments, expected in (((("a", 1, {"colors": Adam(0.1)}, [Loss("color")])), "no parameter 'colors'"),
                                ((("a", 0, {"vertices": Adam(0.1)}, [Loss("color")])), "steps is 0"),
                                ((("a.b", 1, {"vertices": Adam(0.1)}, [Loss("color")])), "without dots"),
                                ((("a", 1, {}, [Loss("color")])), "something to optimize")):
        with pytest.raises(InputError, match=expected):
            problem.phase(*arguments)
    with pytest.raises(InputError, match="no cameras"):
        Problem(bumpy(), [], albedo="constant")
