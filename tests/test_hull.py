"""The visual hull as a start: of shapes whose hull is known it is that hull, its topology is theirs, its triangles are even, its charts
have a place of their own for every face, and a job starts there."""

import json
import re
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from jobs import ROOT, TINY
from PIL import Image
from test_formats import write_colmap

from dressi_edge.cache.errors import InputError, InputWarning
from dressi_edge.compiler.io.cameras import inverse_rigid, look_along, orbit
from dressi_edge.compiler.io.carve import ball_of, bounds, depth, rims, uncovered
from dressi_edge.compiler.io.hull import genus_of, misses_of, visual_hull
from dressi_edge.compiler.io.remesh import evened, vertex_normals
from dressi_edge.compiler.io.shapes import icosphere, pear
from dressi_edge.compiler.io.unit import Unit
from dressi_edge.compiler.io.unwrap import GUTTER, unwrapped
from dressi_edge.compiler.io.views import Views, load_views
from dressi_edge.compiler.io.writers import save_png
from dressi_edge.compiler.scene.job import load_job

SHARED = Path(__file__).resolve().parents[2] / "shared"


def implicit_views(inside, cameras, supersampled=2):
    """Views whose alpha says where rays meet {inside(points) > 0}, by marching in small steps."""
    images = []
    for c in cameras:
        n = supersampled
        y, x = (np.mgrid[:c.height * n, :c.width * n] + 0.5) / n
        if c.kind == "orthographic":
            start = np.stack([(x - c.cx) / c.fx, (c.cy - y) / c.fy, np.zeros_like(x)], -1)
            ray = np.broadcast_to((0.0, 0.0, -1.0), start.shape)
        else:
            start, ray = np.zeros((*x.shape, 3)), np.stack([(x - c.cx) / c.fx, (c.cy - y) / c.fy, -np.ones_like(x)], -1)
        hit = np.zeros(x.shape, bool)
        for t in np.linspace(1.4, 5.0, 120):
            points = (start + t * ray - c.world_to_camera[:3, 3]) @ c.world_to_camera[:3, :3]
            hit |= inside(points.reshape(-1, 3)).reshape(x.shape) > 0.0
        alpha = hit.reshape(c.height, n, c.width, n).mean((1, 3))
        images.append(np.concatenate([np.full((*alpha.shape, 3), 0.5), alpha[..., None]], -1))
    return Views(np.array(images, np.float32), tuple(cameras), tuple(f"v{k}" for k in range(len(images))))


def ball(p):
    return 0.7 - np.linalg.norm(p - (0.2, 0.1, -0.1), axis=-1)


def ring(p):
    """A torus about the y axis."""
    return 0.22 - np.hypot(np.hypot(p[:, 0], p[:, 2]) - 0.6, p[:, 1])


AROUND = orbit(16, (10.0, 60.0, -45.0, -10.0), 3.2, 40.0, (80, 72))
RING = implicit_views(ring, AROUND)


def closed(faces):
    """Whether each edge is in two faces, once each way."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    return len(np.unique(edges, axis=0)) == len(edges) and {*map(tuple, edges)} == {*map(tuple, edges[:, ::-1])}


def test_the_hull_of_a_balls_masks_is_the_ball():
    views = implicit_views(ball, AROUND)
    mesh = visual_hull(views, 362)
    radius = np.linalg.norm(mesh.positions - (0.2, 0.1, -0.1), axis=1)
    assert 0.68 < radius.min() and radius.max() < 0.76 and len(mesh.positions) == 362, (radius.min(), radius.max())
    assert closed(mesh.faces) and genus_of(mesh.faces) == [0]
    outwards = (vertex_normals(mesh.positions, mesh.faces) * (mesh.positions - (0.2, 0.1, -0.1))).sum(1) / radius
    assert outwards.min() > 0.8
    centre, size = ball_of(views)
    assert np.linalg.norm(centre - (0.2, 0.1, -0.1)) < 0.05 and 0.68 < size < 0.85


def test_a_ring_has_its_hole_and_even_triangles():
    mesh = visual_hull(RING, 600)
    assert genus_of(mesh.faces) == [1] and closed(mesh.faces) and abs(len(mesh.positions) - 600) <= 1
    assert np.abs(ring(mesh.positions)).max() < 0.09, np.abs(ring(mesh.positions)).max()
    ends = mesh.positions[np.unique(np.sort(mesh.faces[:, [0, 1]], 1), axis=0)]
    length = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
    low, middle, high = np.quantile(length, (0.02, 0.5, 0.98))
    assert low > 0.45 * middle and high < 1.7 * middle
    neighbours = np.bincount(mesh.faces.ravel())
    assert neighbours.min() >= 4 and neighbours.max() <= 9 and (neighbours == 6).mean() > 0.5
    again = visual_hull(RING, 600)
    assert np.array_equal(mesh.positions, again.positions) and np.array_equal(mesh.uvs, again.uvs), "the same each time"


def test_depth_is_a_distance_and_what_a_picture_cuts_off_is_not_known():
    of = rims(implicit_views(ball, AROUND))
    rng = np.random.default_rng(0)
    direction = rng.normal(size=(400, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    for far in (0.55, 0.66, 0.75, 0.9):
        found = depth(of, direction * far + (0.2, 0.1, -0.1))
        assert np.abs(np.median(found) - (0.7 - far)) < 0.05, (far, np.median(found))
    exact = depth(of, direction * 0.9)
    floored = depth(of, direction * 0.9, -0.1)
    assert np.array_equal(exact >= -0.1, floored >= -0.1) and np.array_equal(exact[exact >= -0.1], floored[exact >= -0.1])
    near = implicit_views(lambda p: 0.7 - np.abs(p).max(-1), [look_along((0, 0, 3), (0, 0, 0), (0, 1, 0), 1.0, 40, 40),
                                                              look_along((3, 0, 0), (0, 0, 0), (0, 1, 0), 4.0, 40, 40),
                                                              look_along((0, 3, 0), (0, 0, 0), (0, 0, 1), 4.0, 40, 40)])
    assert not near.masks[0].box == (0, 0, 40, 40) or near.masks[0].full
    low, high = bounds(rims(near))
    assert np.allclose((low, high), ((-0.7,) * 3, (0.7,) * 3), atol=0.15), "views along the axes, one of them wholly covered"


def test_orthographic_views_carve_too():
    views = implicit_views(ball, [look_along(3 * np.array(v), (0, 0, 0), up, 2.4, 64, 64) for v, up in (
        ((1, 0, 0), (0, 1, 0)), ((0, 1, 0), (0, 0, 1)), ((0, 0, 1), (0, 1, 0)), ((0.6, 0.64, 0.48), (0, 1, 0)))])
    mesh = visual_hull(views, 300)
    assert np.allclose(mesh.positions.min(0), np.array([0.2, 0.1, -0.1]) - 0.7, atol=0.06)
    assert np.allclose(mesh.positions.max(0), np.array([0.2, 0.1, -0.1]) + 0.7, atol=0.06)


def covered_texels(mesh, size=1024):
    """How many faces have each texel's centre."""
    count = np.zeros((size, size), int)
    for corners in mesh.uvs[mesh.uv_faces] * size:
        low, high = np.floor(corners.min(0)).astype(int), np.ceil(corners.max(0)).astype(int)
        y, x = np.mgrid[low[1]:high[1], low[0]:high[0]] + 0.5
        a, b, c = corners
        turn = [(q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0]) for p, q in ((a, b), (b, c), (c, a))]
        inside = np.all([t > 0 for t in turn], 0) | np.all([t < 0 for t in turn], 0)
        count[low[1]:high[1], low[0]:high[0]] += inside
    return count


@pytest.mark.parametrize("make", [lambda: visual_hull(RING, 400), lambda: pear(48), lambda: icosphere(2)], ids=["ring", "pear", "ball"])
def test_charts_have_a_place_of_their_own_for_every_face(make):
    mesh = make()
    charts = unwrapped(np.asarray(mesh.positions), np.asarray(mesh.faces))
    assert charts.uvs.min() >= GUTTER - 1e-9 and charts.uvs.max() <= 1.0 - GUTTER + 1e-9 and charts.uv_faces.shape == mesh.faces.shape
    flat, solid = charts.uvs[charts.uv_faces], np.asarray(mesh.positions)[mesh.faces]
    turn = np.cross(np.c_[flat[:, 1] - flat[:, 0], np.zeros(len(flat))], np.c_[flat[:, 2] - flat[:, 0], np.zeros(len(flat))])[:, 2]
    area = np.linalg.norm(np.cross(solid[:, 1] - solid[:, 0], solid[:, 2] - solid[:, 0]), axis=1)
    assert (turn < 0).all(), "v is down: seen from outside no face is mirrored"
    share = -turn / area
    assert np.quantile(share, 0.01) > 0.25 * share.max() and share.min() > 0.02 * share.max()
    found = covered_texels(type("M", (), {"uvs": charts.uvs, "uv_faces": charts.uv_faces}))
    assert found.max() == 1 and 0.25 < (found > 0).mean() < 0.95, (found.max(), (found > 0).mean())


def test_evening_keeps_topology_however_few_are_asked_for():
    fine = visual_hull(RING, 1200)
    for n in (500, 150):
        positions, faces = evened(fine.positions, fine.faces.astype(np.int64), n)
        assert genus_of(faces) == [1] and closed(faces) and len(positions) <= 1.2 * n + 8
    with pytest.raises(InputError, match="4 vertices are too few for this surface, .*; [0-9]+ are the fewest; ask for more"):
        evened(fine.positions, fine.faces.astype(np.int64), 4)


def test_what_one_mask_lacks_may_be_kept():
    """A scratch through the middle of one mask becomes a gorge or a handle; with `misses` the ball is the ball again, and the ring's hole,
    which many views look through, stays."""
    views = implicit_views(ball, AROUND)
    images = views.images.copy()
    images[3, 30:38, 25:55, 3] = 0.0
    scratched = Views(images, views.cameras, views.names)
    worn, kept = visual_hull(scratched, 362), visual_hull(scratched, 362, misses=1)
    radius = {name: np.linalg.norm(m.positions - (0.2, 0.1, -0.1), axis=1) for name, m in (("worn", worn), ("kept", kept))}
    assert radius["worn"].min() < 0.5 and 0.68 < radius["kept"].min() and radius["kept"].max() < 0.8, radius
    assert genus_of(kept.faces) == [0] and genus_of(visual_hull(RING, 600, misses=1).faces) == [1]
    with pytest.raises(InputError, match="misses is 15, of 16 masks; 0 to 14 is allowed"):
        visual_hull(views, 362, misses=15)


def test_whether_masks_agree_is_seen_from_the_others():
    """What one mask lacks is missing behind the others' pixels; holes of the object are not, and whole masks need no misses."""
    assert misses_of(RING) == 0 and uncovered(rims(RING)) == 0.0
    views = implicit_views(ball, AROUND)
    images = views.images.copy()
    images[3, :40, :, 3] = 0.0
    worn = Views(images, views.cameras, views.names)
    assert uncovered(rims(views)) == 0.0 < 0.02 < uncovered(rims(worn)) and uncovered(rims(worn), 1) == 0.0
    assert misses_of(worn) == 1
    images[6, :, :48, 3] = 0.0
    assert misses_of(Views(images, views.cameras, views.names)) == 2


@pytest.mark.full
def test_loose_parts_are_left_out_and_said_but_two_things_stay_two():
    def crumb(p):
        return np.maximum(ball(p), 0.08 - np.linalg.norm(p - (-0.9, 0.6, 0.5), axis=-1))

    with pytest.warns(InputWarning, match="the hull of the masks has 1 small loose part, which is left out"):
        assert len(genus_of(visual_hull(implicit_views(crumb, AROUND), 1200).faces)) == 1

    def two(p):
        return np.maximum(0.35 - np.linalg.norm(p - (0.5, 0, 0), axis=-1), 0.35 - np.linalg.norm(p + (0.5, 0, 0), axis=-1))

    assert genus_of(visual_hull(implicit_views(two, AROUND), 400).faces) == [0, 0]


@pytest.mark.parametrize("make, message", [
    (lambda: Views(RING.images[:1], RING.cameras[:1], ("a",)), "a hull needs masks in two views or more; 1 of 1 views have one"),
    (lambda: Views(np.ones_like(RING.images), RING.cameras, RING.names), "two views or more; 0 of 16 views have one that is neither empty"),
    (lambda: Views(RING.images[::-1].copy(), tuple(orbit(16, (10.0,), 3.2, 40.0, (80, 72), (9.0 * k, 0, 0))[k] for k in range(16)),
                   RING.names), "the masks have no point in common: cameras and masks do not belong together")])
def test_what_cannot_be_carved_is_said(make, message):
    with pytest.raises(InputError, match=message) as caught:
        visual_hull(make(), 300)
    assert "\n" not in str(caught.value)


def test_a_library_that_is_missing_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "skimage.measure", None)
    with pytest.raises(InputError, match=r"a visual hull needs skimage, which is not installed; pip install 'dressi_edge\[hull\]'"):
        visual_hull(RING, 300)


def write_set(folder, views):
    folder.mkdir(exist_ok=True)
    frames = []
    for k, (image, camera) in enumerate(zip(views.images, views.cameras)):
        save_png(folder / f"{k}.png", image)
        frames.append({"file_path": f"{k}.png", "transform_matrix": camera.camera_to_world.tolist()})
    c = views.cameras[0]
    (folder / "transforms.json").write_text(json.dumps({"fl_x": c.fx, "fl_y": c.fy, "frames": frames}))


def test_a_job_starts_at_the_hull_with_a_texture(tmp_path):
    write_set(tmp_path / "photos", RING.resized((40, 36)))
    text = TINY.replace("sphere = {vertices = 42, radius = 0.5}", "hull = {vertices = 200}").replace('albedo = "colors"', "")
    text = text.replace("optimize.colors", "optimize.texture").replace("[render]", "[render]\ntexture_size = [32, 32]")
    (tmp_path / "job.toml").write_text(text)
    problem = load_job(tmp_path / "job.toml")
    assert problem.albedo == "texture" and genus_of(problem.mesh.faces) == [1]
    assert problem.mesh.uvs is not None and np.abs(ring(problem.mesh.positions)).max() < 0.12


def test_the_job_of_the_page_about_photographs_is_right(tmp_path):
    """With a COLMAP model in a unit of its own, JPEGs and a folder of masks."""
    far = Unit(np.array([50.0, 20.0, -30.0]), 9.0)
    cameras = []
    for c in AROUND:
        pose = c.camera_to_world.copy()
        pose[:3, 3] = far.origin + far.scale * pose[:3, 3]
        cameras.append(replace(c, world_to_camera=inverse_rigid(pose)))
    for place in ("images", "masks"):
        (tmp_path / "photos" / place).mkdir(parents=True)
    for k, image in enumerate(RING.images):
        save_png(tmp_path / "photos" / "masks" / f"im{k}.png", np.repeat(image[..., 3:], 3, 2))
        Image.new("RGB", image.shape[1::-1], (120, 90, 30)).save(tmp_path / "photos" / "images" / f"im{k}.jpg")
    write_colmap(tmp_path / "photos" / "sparse" / "0", False, names=[f"im{k}.jpg" for k in range(16)], cameras=cameras, size=(80, 72))
    page = (ROOT / "docs" / "photographs.md").read_text()
    job, = re.findall(r"```toml\n(.*?)```", page, re.S)
    (tmp_path / "object.toml").write_text(job.replace("vertices = 2562", "vertices = 300"))
    problem = load_job(tmp_path / "object.toml")
    assert problem.phases == ["shape", "texture"] and genus_of(problem.mesh.faces) == [1] and len(problem.views) == 16
    assert np.linalg.norm(problem.mesh.positions, axis=1).max() < 1.05 and abs(problem.views.unit.scale / 9.0 - 0.82) < 0.1


@pytest.mark.parametrize("mesh, message", [
    ("hull = {vertices = 20}", "mesh.hull.vertices is 20; a whole number from 100"), ("hull = 3", "mesh.hull is 3; a table is needed"),
    ("hull = {radius = 1.0}", "mesh.hull.radius is an unknown key"), ("hull = {}\nsphere = {}", "path, sphere or hull is needed, and one"),
    ("hull = {}\nnormalize = true", "normalize is for path; a sphere has its radius, a hull its place")])
def test_keys_of_the_hull_are_checked(tmp_path, mesh, message):
    write_set(tmp_path / "photos", RING)
    (tmp_path / "job.toml").write_text(TINY.replace("sphere = {vertices = 42, radius = 0.5}", mesh))
    with pytest.raises(InputError, match=message):
        load_job(tmp_path / "job.toml")


def test_the_hull_of_real_photographs():
    """32 photographs of a toy dinosaur, whose masks agree to a pixel: projected back, the hull covers them."""
    folder = SHARED / "assets" / "oxford_dino"
    if not folder.is_dir():
        pytest.skip("shared assets not present; shapes with known hulls were carved in their place")
    views = load_views(folder)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        mesh = visual_hull(views, 2562)
    assert len(mesh.positions) == 2562 and closed(mesh.faces) and len(genus_of(mesh.faces)) == 1
    of = rims(views)
    found = depth(of, mesh.positions)
    pixel = 8.0 / 1000.0  # at the object, in the scene's unit
    assert np.quantile(np.abs(found), 0.95) < 1.5 * pixel, np.quantile(np.abs(found), 0.95)
