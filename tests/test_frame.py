"""Scenes far from their origin are drawn and fitted as at it, with results in the input's frame; poses turn about the mesh's middle."""

import json
from dataclasses import replace

import numpy as np
import pytest
from jobs import SIZE, command, disc

from dressi_edge import runtime
from dressi_edge.cache.errors import BundleError
from dressi_edge.commands import run as run_module
from dressi_edge.compiler.graph.functions import constant_table
from dressi_edge.compiler.graph.reference import evaluate
from dressi_edge.compiler.io.cameras import inverse_rigid, look_at, orbit, rotation_matrix, rotation_vector
from dressi_edge.compiler.io.frame import recentred
from dressi_edge.compiler.io.mesh import Mesh, origin_of
from dressi_edge.compiler.io.meshes import load_mesh
from dressi_edge.compiler.io.shapes import icosphere
from dressi_edge.compiler.io.views import Views
from dressi_edge.compiler.io.writers import save_mesh, save_png
from dressi_edge.compiler.render.camera import fixed_views, posed_views
from dressi_edge.compiler.render.light import Light
from dressi_edge.compiler.render.optimizer import Adam
from dressi_edge.compiler.render.raster import Softness
from dressi_edge.compiler.scene import results
from dressi_edge.compiler.scene import scene as scene_module
from dressi_edge.compiler.scene.problem import Loss, Problem

pytest_plugins = ["gpu"]

UTM = np.array([441547.3, 5121946.6, 2345.1])
HARD = Softness(1.0, delta=0.0)


def scene(offset):
    """A ball and three cameras, all moved by `offset`, with poses of few digits as files have them."""
    ball = icosphere(2, 0.7)
    cameras = []
    for c in orbit(3, (20.0, -15.0), 3.0, 40.0, (SIZE, SIZE)):
        pose = c.camera_to_world.copy()
        pose[:3, :3] = np.round(pose[:3, :3], 6)
        pose[:3, 3] = np.round(pose[:3, 3], 3) + offset
        cameras.append(replace(c, world_to_camera=inverse_rigid(pose)))
    return Mesh(ball.positions * (1.0, 0.7, 0.5) + offset, ball.faces), tuple(cameras)


def test_only_what_is_far_for_its_extent_is_moved():
    mesh, cameras = scene(np.zeros(3))
    assert not origin_of(mesh.positions).any() and not origin_of(mesh.positions + 20.0).any()
    for same, given in zip(recentred(mesh, cameras, ()), (mesh, cameras, ())):
        assert same is given
    np.testing.assert_allclose(origin_of(mesh.positions + UTM), UTM, atol=1e-6)
    assert not origin_of(np.ones((3, 3)) * 1e9).any(), "a point has no extent to compare with"


def test_what_is_moved_is_seen_alike():
    (mesh, cameras), (near_mesh, near) = scene(UTM), scene(np.zeros(3))
    lights = (Light("point", 3.0, tuple(UTM + (0, 2, 2))), Light("directional", 1.0, (0, -1, 0)), Light("ambient", 0.1))
    mesh, cameras, lights, origin = recentred(mesh, cameras, lights)
    np.testing.assert_allclose(mesh.positions, near_mesh.positions + UTM - origin, atol=2e-9)
    np.testing.assert_allclose(lights[0].vector, UTM + (0, 2, 2) - origin, atol=1e-8)
    assert lights[1].vector == (0, -1, 0) and lights[2].vector is None
    for a, b in zip(cameras, near):  # in fp32, as on the device, and with rotations that are off by 1e-6
        rows = a.clip_rows().astype(np.float32)
        found, expected = (np.c_[m.positions, np.ones(len(m.positions))] @ r.T for m, r in ((mesh, rows), (near_mesh, b.clip_rows())))
        np.testing.assert_allclose(found, expected, atol=2e-6)


def fitted(offset, folder, gpu, steps=25):
    mesh, cameras = scene(offset)
    images = np.repeat(disc(radius=6.0)[None].astype(np.float32), 3, 0)
    problem = Problem(mesh, Views(images, cameras, ("a", "b", "c")), albedo="constant", shading="lambert",
                      lights=[Light("point", 30.0, tuple(offset + (0.0, 2.0, 2.0)))])
    problem.phase("p", steps, {"vertices": Adam(0.004, epsilon=1e-4), "rotation": Adam(0.001), "translation": Adam(0.001),
                               "light0.vector": Adam(0.01)}, [Loss("color"), Loss("silhouette")], HARD)
    problem.render("render", HARD)
    problem.compile("lavapipe", folder / "x.dressi")
    with runtime.load(folder / "x.dressi", gpu.device) as s:
        before = results.snapshot(s)
        s.step(steps, "p")
        metrics = results.write(s, folder / "out.ply", {"p": [(0, 1.0)]}, before, {})
        run_module._save_states(s, str(folder / "out.npz"))
        return before, results.mesh_of(s), metrics, dict(np.load(folder / "out.npz"))


def test_a_scene_in_map_coordinates_is_fitted_as_at_the_origin_and_given_back_there(gpu, tmp_path):
    (tmp_path / "a").mkdir(), (tmp_path / "b").mkdir()
    picture, mesh, metrics, states = fitted(np.zeros(3), tmp_path / "a", gpu)
    far_picture, far_mesh, far_metrics, far_states = fitted(UTM, tmp_path / "b", gpu)
    assert np.abs(picture - far_picture).max() < 1e-3, "not 0.7 of the silhouettes"
    moved = np.abs(mesh.positions - scene(np.zeros(3))[0].positions).max()
    assert moved > 0.003 and np.abs(far_mesh.positions - UTM - mesh.positions).max() < 0.1 * moved
    assert far_states["vertices"].dtype == np.float64
    np.testing.assert_allclose(far_states["vertices"] - UTM, states["vertices"], atol=0.1 * moved)
    np.testing.assert_allclose(far_states["light0.vector"] - UTM, states["light0.vector"], atol=0.02)
    np.testing.assert_allclose(np.array(far_metrics["lights"]["light0.vector"]) - UTM, metrics["lights"]["light0.vector"], atol=0.02)
    assert metrics["lights"]["light0.vector"] != [0.0, 2.0, 2.0]
    for name in ("a", "b", "c"):
        there, here = (np.array(m["camera_to_world"][name]) for m in (far_metrics, metrics))
        np.testing.assert_allclose(there[:3, 3] - UTM, here[:3, 3], atol=5e-3)
        np.testing.assert_allclose(there[:3, :3], here[:3, :3], atol=2e-3)


@pytest.mark.parametrize("meta, told", [({"origin": "far"}, "meta.origin is malformed"), ({"origin": [1, 2]}, "meta.origin is malformed"),
                                        ({"pivot": {}}, "meta.pivot is malformed")])
def test_a_frame_that_is_malformed_is_named(meta, told):
    session = type("S", (), {"bundle": type("B", (), {"description": {"meta": meta}})})
    with pytest.raises(BundleError, match=told):
        results._origin(session) if "origin" in meta else results._pivot(session)


def test_a_job_in_map_coordinates(tmp_path):
    """From files to files, with positions as text of OBJ."""
    mesh, cameras = scene(UTM)
    lines = ["v {:.6f} {:.6f} {:.6f}".format(*p) for p in mesh.positions] + ["f {} {} {}".format(*f) for f in mesh.faces + 1]
    (tmp_path / "far.obj").write_text("\n".join(lines))
    frames = []
    for k, c in enumerate(cameras):
        save_png(tmp_path / f"{k}.png", disc(radius=6.0))
        frames.append({"file_path": f"{k}.png", "transform_matrix": c.camera_to_world.tolist()})
    (tmp_path / "transforms.json").write_text(json.dumps({"fl_x": cameras[0].fx, "frames": frames}))
    (tmp_path / "job.toml").write_text('[mesh]\npath = "far.obj"\n[views]\ntransforms = "."\n[render]\nalbedo = "constant"\n[[phase]]\n'
                                       'name = "p"\nsteps = 1\noptimize.vertices = {rate = 1e-6}\n[[phase.loss]]\nkind = "silhouette"\n')
    done = command("run", "job.toml", "--device", "reference", "-o", "out.npz", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    found = np.load(tmp_path / "out.npz")["vertices"]
    assert np.linalg.norm(found[:, None] - mesh.positions[None], axis=2).min(axis=0).max() < 2e-5


@pytest.mark.parametrize("suffix", [".obj", ".ply", ".glb", ".gltf"])
def test_meshes_in_map_coordinates_are_written_in_all_their_digits(tmp_path, suffix):
    ball = icosphere(2, 0.5)
    mesh = Mesh(ball.positions + UTM, ball.faces, colors=np.full((len(ball.positions), 3), 0.5))
    save_mesh(tmp_path / f"far{suffix}", mesh)
    found = load_mesh(tmp_path / f"far{suffix}")
    assert np.abs(found.positions - mesh.positions).max() < 1e-6 and np.array_equal(found.faces, mesh.faces)


# The pivot of poses


def test_a_pose_turns_about_the_pivot_and_zero_is_the_base_pose_exactly():
    base, pivot = orbit(3, (20.0, -15.0), 3.0, 40.0, (SIZE, SIZE)), np.array([0.3, -0.2, 0.4])
    rng = np.random.default_rng(0)
    turn, move = rng.normal(size=(3, 3)), rng.normal(size=(3, 3))

    def rows(turn, move, pivot):
        table = fixed_views(base)
        views = posed_views(table, constant_table(turn), constant_table(move), pivot)
        return np.stack([x.reshape(-1, 4)[:3] for x in evaluate(views.rows)], 1), np.stack([x.reshape(-1, 4)[:3] for x in
                                                                                          evaluate(table.rows)], 1)

    zero, fixed = rows(np.zeros((3, 3)), np.zeros((3, 3)), tuple(pivot))
    assert np.array_equal(zero, fixed)
    found, _ = rows(turn, move, tuple(pivot))
    eye, _ = rows(turn, move, None)
    x = np.array([0.7, 0.1, -0.5])
    for k, c in enumerate(base):
        r, (r0, t0) = rotation_matrix(turn[k]), (c.world_to_camera[:3, :3], c.world_to_camera[:3, 3])
        p = r0 @ pivot + t0
        np.testing.assert_allclose(found[k] @ (*x, 1), r @ (r0 @ x + t0 - p) + p + move[k], atol=1e-9)
        np.testing.assert_allclose(found[k] @ (*pivot, 1), p + move[k], atol=1e-9)
        np.testing.assert_allclose(eye[k] @ (*x, 1), r @ (r0 @ x + t0) + move[k], atol=1e-9)


def body() -> Mesh:
    """Something that no turn leaves as it is."""
    ball = icosphere(2, 1.0)
    x, y, z = ball.positions.T
    shape = ball.positions * (0.9, 0.5, 0.7) * (1.0 + 0.35 * np.sin(4.0 * x + 1.0) * np.cos(3.0 * y))[:, None]
    shape[:, 0] += 0.3 * y * y
    return Mesh(shape, ball.faces, colors=np.clip(0.5 + 0.5 * np.c_[np.sin(5 * x), np.cos(4 * y), np.sin(3 * z + 2 * x)], 0, 1))


def angle(a, b) -> float:
    return float(np.degrees(np.linalg.norm(rotation_vector(a[:3, :3] @ b[:3, :3].T))))


def test_400_steps_bring_a_pose_back(gpu, tmp_path, monkeypatch):
    """A turn of several degrees about the middle comes back to 0.1 degrees; about the eye some degrees are left."""
    true = look_at((0.4, 0.9, 2.9), (0.0, 0.0, 0.0), (0, 1, 0), 42.0, 96, 96)
    drawn = Problem(body(), [true], albedo="colors")
    drawn.render("render", Softness(2.0))
    drawn.compile("lavapipe", tmp_path / "t.dressi")
    with runtime.load(tmp_path / "t.dressi", gpu.device) as s:
        drawn = np.array(s.get("render.color"), np.float32)
    drawn[..., :3] /= np.maximum(drawn[..., 3:], 1e-6)  # straight: what it drew lies over black
    images = np.clip(drawn, 0.0, 1.0)
    off = np.eye(4)
    off[:3, :3] = rotation_matrix(np.radians((6.0, -7.0, 4.0)))
    pose = off @ true.camera_to_world
    pose[:3, 3] += (0.03, -0.02, 0.05)
    start = replace(true, world_to_camera=inverse_rigid(pose))
    left = {}
    for pivot in ("middle", "eye"):
        with monkeypatch.context() as m:
            if pivot == "eye":
                m.setattr(scene_module, "posed_views", lambda base, rotation, translation, _: posed_views(base, rotation, translation))
            problem = Problem(body(), Views(images, (start,), ("a",)), albedo="colors")
        if pivot == "eye":
            problem.pivot = tuple(start.position.tolist())  # for what the results say: there p is 0
        rate = {"start": 0.01, "end": 1e-3, "steps": 400}
        problem.phase("p", 400, {"rotation": Adam(rate), "translation": Adam(rate)}, [Loss("color"), Loss("silhouette")], Softness(2.0))
        problem.compile("lavapipe", tmp_path / f"{pivot}.dressi")
        with runtime.load(tmp_path / f"{pivot}.dressi", gpu.device) as s:
            s.step(400, "p")
            found = np.array(results._found(s)["camera_to_world"]["a"])
            left[pivot] = angle(found, true.camera_to_world), float(np.linalg.norm(found[:3, 3] - true.position))
    assert angle(start.camera_to_world, true.camera_to_world) > 8.0
    assert left["middle"][0] < 0.1 and left["middle"][1] < 0.01, left
    assert left["eye"][0] > 5.0 * left["middle"][0], left
