"""Gains of views: photographs that were not exposed or balanced alike."""
import numpy as np
import pytest
from test_job_scene import folder, job  # noqa: F401  (a fixture)
from test_problem import SOFT, as_views, bumpy, cameras, pictures

from dressi_edge import runtime
from dressi_edge.cache.errors import InputError
from dressi_edge.compiler.graph.reference_session import ReferenceSession
from dressi_edge.compiler.render.optimizer import Adam
from dressi_edge.compiler.scene import Binned, HardSoftRas, Outline, Scene, Unlit, Vertex, icosphere, orbit
from dressi_edge.compiler.scene.job import parse_job
from dressi_edge.compiler.scene.problem import Loss, Problem
from dressi_edge.compiler.scene.values import gains

pytest_plugins = ["gpu"]
TRUE = np.array([[1.1, 1.0, 0.8], [0.8, 0.9, 1.0], [1.0, 1.1, 1.3], [1.1, 1.0, 0.9]])


@pytest.mark.parametrize("order", ["batch", "shuffle"])
def test_gains_and_colours_come_back_together(gpu, tmp_path, order):
    """From pictures that were multiplied by known factors; without gains the colours are between those of the views."""
    paint, cams = bumpy(True), cameras()
    shown = pictures(Problem(paint, cams, albedo="colors"), gpu, tmp_path / "t.dressi")
    shown[..., :3] *= 0.7 * TRUE[:, None, None] / np.maximum(shown[..., 3:], 1e-3)  # they come over black
    found = {}
    for names in (("colors",), ("colors", "gain")):
        problem = Problem(bumpy(), as_views(shown, cams), albedo="colors", order=order)
        problem.phase("paint", 240, {name: Adam(0.02, (0.8, 0.95)) for name in names}, [Loss("color")], SOFT)
        problem.compile("lavapipe", tmp_path / "x.dressi")
        with runtime.load(tmp_path / "x.dressi", gpu.device) as s:
            s.step(240)
            found[names] = s.get("colors"), s.loss(), s.get("gain") if len(names) > 1 else None
    gpu.silent()
    (_, loss, _), (colors, less, gain) = found["colors",], found["colors", "gain"]
    assert less < 0.2 * loss
    np.testing.assert_allclose(gain / gain.mean(0), TRUE / TRUE.mean(0), atol=0.03)
    seen = np.abs(colors - 0.5).max(1) > 1e-3
    assert np.median(np.abs(colors - 0.7 * paint.colors * TRUE.mean(0))[seen]) < 0.02


@pytest.mark.parametrize("renderer", [Outline(2.0), pytest.param(HardSoftRas(2.0, layers=2), marks=pytest.mark.full), Binned(2.0)])
def test_the_device_has_the_gradient_of_the_reference(gpu, renderer):
    """In views of more pixels than one loop may go over."""
    ball, size = icosphere(2, 0.9), (160, 140)
    s = Scene(orbit(2, [10, -10], 2.2, 50, size), (0.3, 0.2, 0.1))
    s.gain = gains(s.parameter("gain", TRUE[:2], kind="table"))
    s.add(ball, material=Unlit(Vertex(s.parameter("colors", 0.5 + 0.4 * np.sin(4 * ball.positions)))))
    s.vjp("v", ["gain", "colors"], color=s.frame(renderer).color)
    given = np.random.default_rng(2).uniform(0, 1, size=(2, *size[::-1], 3))
    with ReferenceSession(s.program) as exact, runtime.load(gpu.compile(s.program), gpu.device) as session:
        one, two = (x.forward("v")["color"] for x in (exact, session))
        assert np.median(np.abs(one - two)) < 1e-5
        true, found = exact.backward("v", color=given), session.backward("v", color=given)
    gpu.silent()
    for name in true:
        assert np.linalg.norm(found[name] - true[name]) < 1e-3 * np.linalg.norm(true[name]), name


def test_the_background_has_no_gain(gpu):
    s = Scene(orbit(2, [0], 3.0, 40, (32, 24)), (0.3, 0.2, 0.1))
    s.gain = gains(s.parameter("gain", TRUE[:2], kind="table"))
    s.add(icosphere(1, 0.5), material=Unlit((0.5, 0.5, 0.5)))
    s.output("look", color=s.frame().color)
    with runtime.load(gpu.compile(s.program), gpu.device) as session:
        picture = session.get("look.color")
    np.testing.assert_allclose(picture[:, 0, 0], [[0.3, 0.2, 0.1]] * 2, atol=1e-6)
    np.testing.assert_allclose(picture[:, 12, 16], 0.5 * TRUE[:2] / TRUE[:2].mean(0), atol=1e-6)


def test_jobs_have_gains(folder):  # noqa: F811
    phase = job()["phase"][0] | {"optimize": {"ball.translation": {"rate": 0.02}, "gain": {"rate": 0.01}}}
    found = parse_job(job(phase=[phase]), folder / "job.toml")
    assert found.scene.parameters["gain"].node.extent.count == 2 and found.scene.gain is not None
    assert parse_job(job(), folder / "job.toml").scene.gain is None


def test_an_error_leaves_no_gain_behind():
    problem = Problem(bumpy(), cameras(), albedo="colors")
    with pytest.raises(InputError, match="no parameter 'colour'"):
        problem.phase("paint", 3, {"gain": Adam(0.1), "colour": Adam(0.1)}, [Loss("color")])
    assert problem.scene.gain is None and "gain" not in problem.scene.parameters
