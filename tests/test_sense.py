"""A start of which nothing can come is refused with its likely cause; one that only looks wrong is noted; a good one is left in peace."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from jobs import TINY, command, disc, write_job

from dressi_edge.cache.errors import InputError
from dressi_edge.compiler.io.cameras import inverse_rigid, orbit
from dressi_edge.compiler.io.meshes import Mesh
from dressi_edge.compiler.io.shapes import icosphere
from dressi_edge.compiler.io.views import Views
from dressi_edge.compiler.io.writers import save_mesh, save_png
from dressi_edge.compiler.scene import sense
from dressi_edge.compiler.scene.job import load_job

SIZE = (48, 40)
HARD = np.array([1.0, -1.0, -1.0, 1.0])


def flag() -> Mesh:
    """A body without symmetry, whose middle is not the origin."""
    ball = icosphere(2, 1.0)
    return Mesh(ball.positions * (0.5, 0.15, 0.3) + (0.25, 0.35, -0.1) + 0.3 * ball.positions[:, [1]] * (0.2, 1.0, 0.4), ball.faces)


def cameras(n=6, **changes):
    return tuple(replace(c, **changes) for c in orbit(n, (25.0, -10.0, 50.0), 3.0, 50.0, SIZE))


def photos(mesh, cameras):
    """Views whose masks are the boxes of the mesh: what `sense` compares."""
    images = np.zeros((len(cameras), SIZE[1], SIZE[0], 4), np.float32)
    for image, box in zip(images, sense.sight(mesh, cameras).boxes):
        left, top, right, bottom = np.rint(np.nan_to_num(box)).astype(int)
        image[top:bottom, left:right] = (0.5, 0.5, 0.5, 1.0)
    return Views(images, tuple(cameras), tuple(map(str, range(len(cameras)))))


def told(mesh, views, silhouettes=True, placed=True):
    """("error" or "note" or "", the lines)."""
    with warnings.catch_warnings(record=True) as notes:
        warnings.simplefilter("always")
        try:
            sense.check(mesh, views, silhouettes, placed=placed)
        except InputError as error:
            assert "\n" not in str(error)
            return "error", str(error)
    return "note" if notes else "", " / ".join(str(n.message) for n in notes)


def with_poses(views, change):
    return replace(views, cameras=tuple(replace(c, world_to_camera=inverse_rigid(change(c.camera_to_world))) for c in views.cameras))


def transposed(pose):
    out = pose.copy()
    out[:3, :3] = pose[:3, :3].T
    return out


def test_a_good_start_is_left_in_peace():
    views = photos(flag(), cameras())
    assert told(flag(), views) == ("", "") and told(icosphere(2, 0.5), views, placed=False)[0] == "", "a ball to begin with too"
    assert told(flag(), views.cameras) == ("", ""), "cameras without pictures"
    assert told(flag(), photos(flag(), cameras(1))) == ("", "")
    spread = icosphere(2, 4.0)  # a room around the cameras
    assert told(spread, Views(np.ones((6, *SIZE[::-1], 4), np.float32), cameras(), tuple("abcdef")), False)[0] == "note"


@pytest.mark.parametrize("given, cause, cure", [
    (lambda p: p @ np.diag(HARD), "looks along +z with y down, as in OpenCV", "columns 1 and 2"),
    (inverse_rigid, "world to camera?", "invert each matrix"),
    (lambda p: inverse_rigid(p @ np.diag(HARD)), "world to camera, and the camera looks along +z", "invert each matrix, then"),
    (lambda p: p @ np.diag([-1.0, 1.0, -1.0, 1.0]), "looks along +z with y up", "columns 0 and 2"),
    (transposed, "rotations are transposed?", "transpose the upper left")])
def test_poses_of_another_convention_are_named_with_what_helps(given, cause, cure):
    kind, text = told(flag(), with_poses(photos(flag(), cameras()), given))
    assert kind == "error" and cause in text and cure in text, (kind, text)


@pytest.mark.parametrize("given, cause", [
    (lambda p: np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1.0]]) @ p, "the mesh has y up, the poses have z up?"),
    (lambda p: np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1.0]]) @ p, "the mesh has z up, the poses have y up?")])
def test_another_upright_is_noted_though_the_mesh_is_seen(given, cause):
    high = Mesh(flag().positions * (0.3, 2.0, 0.3) + (0.0, 0.4, 0.0), flag().faces)
    kind, text = told(high, with_poses(photos(high, cameras()), given))
    assert kind in ("note", "error") and cause in text, (kind, text)


def test_a_mesh_in_no_view_is_told_where_it_and_the_cameras_are():
    views = photos(flag(), cameras())
    kind, text = told(Mesh(flag().positions + (0, 400.0, 0), flag().faces), views)
    assert kind == "error" and "the mesh is in no view" in text and "(0.25, 400.4, -0.1)" in text and "look at about" in text
    nearest = sense.looked_at(cameras())
    np.testing.assert_allclose(nearest, 0.0, atol=1e-9)
    kind, text = told(Mesh(flag().positions * 0.01, flag().faces), with_poses(views, lambda p: p * ([[1, 1, 1, 0.01]] * 3 + [[1] * 4])))
    assert kind == "error" and "nearer than near = 0.05" in text and "set near = 0.01" in text, text


def test_units_that_differ_are_told():
    views = photos(flag(), cameras())
    kind, text = told(Mesh(flag().positions * 0.001, flag().faces), views, placed=False)
    assert kind == "error" and "pixels large in all views" in text
    kind, text = told(Mesh(flag().positions * 0.08, flag().faces), views, placed=False)
    assert kind == "note" and "times smaller in the views than the masks" in text
    kind, text = told(Mesh(flag().positions * 20.0, flag().faces), views, placed=False)
    assert kind == "note" and "inside the mesh" in text


@pytest.mark.parametrize("times, told_", [(0.1, "the poses are in a unit 10 times larger"), (1e-3, "a unit 1000 times larger"),
                                          (10.0, "the poses are in a unit 10 times smaller"), (1e3, "a unit 1000 times smaller")])
def test_units_of_mesh_and_poses_are_told_where_one_explains_the_masks(times, told_):
    kind, text = told(Mesh(flag().positions / times, flag().faces), photos(flag(), cameras()))
    assert kind in ("note", "error") and (told_ in text or times > 100 and "pixels large" in text), (kind, text)


@pytest.mark.parametrize("times", [0.25, 2.0, 4.0])
def test_focal_lengths_of_other_pictures_are_noted(times):
    views = photos(flag(), cameras())
    other = replace(views, cameras=tuple(replace(c, fx=times * c.fx, fy=times * c.fy) for c in views.cameras))
    kind, text = told(flag(), other)
    assert kind == "note" and f"fl_x and fl_y belong to pictures {times:g} times as large? divide them by {times:g}" in text, (kind, text)


@pytest.mark.parametrize("change, kind, text", [
    (lambda a: a * 0, "error", "the mask is empty: alpha is 0 everywhere in all 3 views"),
    (lambda a: a * 0.3, "error", "alpha is at most 0.3"),
    (lambda a: a * 0 + 1, "error", "alpha is 255 (opaque) everywhere in all 3 views"),
    (lambda a: 1 - a, "note", "is it inverted?"),
    (lambda a: a * np.array([1, 1, 0])[:, None, None], "note", "the mask is empty in 1 of 3 views (2)"),
    (lambda a: np.maximum(a, np.array([0, 1, 0])[:, None, None]), "note", "opaque) everywhere in 1 of 3 views (1)")])
def test_masks_that_say_nothing_are_told(change, kind, text):
    views = photos(flag(), cameras(3))
    images = views.images.copy()
    images[..., 3] = change(images[..., 3])
    found = told(flag(), replace(views, images=images))
    assert found[0] == kind and text in found[1], found


def test_pictures_without_masks_may_be_matched_by_colour():
    views = photos(flag(), cameras(3))
    opaque = replace(views, images=np.ones_like(views.images))
    assert told(flag(), opaque, silhouettes=False)[0] == "note" and told(flag(), opaque, silhouettes=True)[0] == "error"


@pytest.mark.parametrize("scale, kind, text", [(4.0, "error", "belong to pictures of about 192x160, 4 times as large? divide them by 4"),
                                               (0.25, "note", "belong to pictures of about 12x10, 0.25 times as large?")])
def test_intrinsics_of_other_pictures_are_named(scale, kind, text):
    views = photos(flag(), cameras())
    other = tuple(replace(c, fx=scale * c.fx, fy=scale * c.fy, cx=scale * c.cx, cy=scale * c.cy) for c in views.cameras)
    found = told(flag(), replace(views, cameras=other))
    assert found[0] == kind and text in found[1], found


def test_odd_lenses_and_poses_are_noted():
    outside = photos(flag(), cameras(3, cx=-5.0))
    assert "the principal point is outside the picture in all 3 views (-5, 20 in 48x40)" in told(flag(), outside)[1]
    wide = photos(flag(), cameras(3, fx=5.0))
    assert "a field of view of 156 degrees" in told(flag(), wide)[1]
    same = photos(flag(), cameras(1) * 3)
    assert "all 3 cameras have the same pose" in told(flag(), same)[1]
    assert "beyond far = 3" in told(flag(), photos(flag(), cameras(3, far=3.0)))[1]
    assert "nearer than near = 3" in told(flag(), photos(flag(), cameras(3, near=3.0)))[1]


def test_a_face_that_covers_the_picture_is_seen_though_no_corner_is():
    wall = Mesh(np.array([[-99.0, -99, 0], [99, -99, 0], [0, 150, 0]]), np.array([[0, 1, 2]]))
    level = orbit(1, (0.0,), 3.0, 50.0, SIZE)
    assert sense.sight(wall, level).seen.all()
    assert not sense.sight(Mesh(wall.positions + (0, 0, 9), wall.faces), level).seen.any(), "behind"
    assert not sense.sight(Mesh(wall.positions + (0, -160, 0), wall.faces), level).seen.any(), "below"


def test_orthographic_cameras_see_whatever_their_near():
    flat = tuple(replace(c, kind="orthographic", fx=14.0, fy=14.0, near=2.0, far=9.0) for c in cameras())
    assert sense.sight(flag(), flat).seen.all() and told(flag(), photos(flag(), flat)) == ("", "")
    kind, text = told(Mesh(flag().positions + (0, 40.0, 0), flag().faces), photos(flag(), flat))
    assert kind == "error" and "the mesh is in no view" in text


def test_a_job_is_judged_before_anything_is_built(tmp_path, monkeypatch):
    monkeypatch.setattr("dressi_edge.compiler.scene.job.Problem", None)
    path = write_job(tmp_path)
    for k in range(2):
        save_png(tmp_path / "photos" / f"{k}.png", disc() * 0.0)
    with pytest.raises(InputError, match="job.toml: views: the mask is empty"):
        load_job(path)
    save_mesh(tmp_path / "far.ply", Mesh(flag().positions + 50.0, flag().faces))
    text = TINY.replace("sphere = {vertices = 42, radius = 0.5}", 'path = "far.ply"\nnormalize = true')
    for k in range(2):
        save_png(tmp_path / "photos" / f"{k}.png", disc())
    path = write_job(tmp_path, text)
    file = tmp_path / "photos" / "transforms.json"
    file.write_text(file.read_text().replace("2.46", "52.46").replace("2.5", "52.5"))
    moved = text.replace("[views]", "[views]\nnear = 9.0")
    with pytest.raises(InputError, match=r"the mesh is in no view: .*; mesh.normalize has moved and scaled the mesh, but not the cameras"):
        load_job(write_job(tmp_path, moved))


def test_a_note_is_one_line_on_stderr(tmp_path):
    path = write_job(tmp_path)
    save_png(tmp_path / "photos" / "1.png", disc() * 0.0)
    done = command("run", path, "--device", "reference", "--steps", "1", "--phase", "paint")
    assert done.returncode == 0
    notes = [line for line in done.stderr.splitlines() if line.startswith("dressi-edge: ")]  # a slow machine tells what it is at, too
    assert notes == ["dressi-edge: note: the mask is empty in 1 of 2 views (1): alpha is nowhere half or more"]
