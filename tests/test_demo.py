"""The demo: its distance is right, its problem is the one described, and it ends with a pear."""

import json

import numpy as np
import pytest
from jobs import command

from dressi_edge.compiler.io.meshes import Mesh, load_mesh
from dressi_edge.compiler.io.shapes import icosphere, pear
from dressi_edge.compiler.scene import demo
from dressi_edge.compiler.scene.results import record


def test_the_distance_to_a_triangle_is_to_its_face_edges_and_corners():
    triangle = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
    points = np.array([[0.2, 0.2, 0.5], [0.2, 0.2, -0.5], [0.5, -2.0, 0], [-3.0, -4.0, 0], [1.0, 1.0, 0], [0.3, 0.3, 0]])
    np.testing.assert_allclose(demo.surface_distance(points, triangle), [0.5, 0.5, 2, 5, np.sqrt(0.5), 0], atol=1e-12)


def test_the_distance_to_a_sphere_is_that_of_the_radii():
    ball = icosphere(3)
    found = demo.surface_distance(icosphere(2, 0.5).positions, ball)
    assert np.all(np.abs(found - 0.5) < 0.01) and demo.surface_distance(ball.positions, ball).max() < 1e-12


def test_the_problem_has_two_phases_and_six_views_that_see_the_whole_pear():
    cameras = demo.cameras(32)
    problem = demo.reconstruction(np.zeros((6, 32, 32, 4)), cameras, 4, 3)
    assert record(problem)["phases"] == [["shape", 4], ["texture", 3]] and len(problem.cameras) == 6
    assert problem.parameters["texture"].extent.width == 48
    points = np.concatenate([pear().positions, np.ones((len(pear().positions), 1))], axis=1)
    for camera in cameras:
        x, y, _, w = (points @ camera.clip_rows().T).T
        assert np.all(np.abs(x) < w) and np.all(np.abs(y) < w)


@pytest.mark.full
def test_the_demo_ends_with_a_pear(tmp_path):
    done = command("demo", "-o", "out", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    folder = tmp_path / "out"
    assert sorted(p.name for p in folder.iterdir()) == ["pear.glb", "pear_loss.png", "pear_metrics.json", "pear_sheet.png"]
    metrics = json.loads((folder / "pear_metrics.json").read_text())
    assert metrics["distance_to_surface"]["end"] < 0.02 < metrics["distance_to_surface"]["start"]
    assert metrics["views"]["iou_min"] > 0.99 and metrics["views"]["psnr_mean"] > 32
    mesh = load_mesh(folder / "pear.glb")
    assert len(mesh.faces) == 5120 and mesh.texture.shape == (256, 384, 3)
    assert "texture 200/200 loss" in done.stderr and "IoU" in done.stdout.splitlines()[-2]


@pytest.mark.full
def test_the_quick_demo_works(tmp_path):
    done = command("demo", "--quick", "-o", tmp_path)
    assert done.returncode == 0 and len(list(tmp_path.iterdir())) == 4, done.stderr
