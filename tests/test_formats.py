"""Cameras as other tools write them: the same photographs come out whichever format says where they were taken, results are in its frame,
and a damaged file is one line."""

import json
import random
import struct
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from jobs import TINY, command, disc
from PIL import Image

from dressi_edge.cache.errors import InputError, InputWarning
from dressi_edge.compiler.io.cameras import inverse_rigid, orbit, rotation_vector
from dressi_edge.compiler.io.colmap import MODELS
from dressi_edge.compiler.io.decode import Masks
from dressi_edge.compiler.io.formats import read_cameras
from dressi_edge.compiler.io.meshes import load_mesh
from dressi_edge.compiler.io.sets import DOWN_FORWARD, decomposed
from dressi_edge.compiler.io.unit import Unit
from dressi_edge.compiler.io.views import load_photographs
from dressi_edge.compiler.io.writers import save_png
from dressi_edge.compiler.scene.job import load_job

ASSETS = Path(__file__).resolve().parents[2] / "shared" / "assets"
SIZE = (33, 21)
CAMERAS = orbit(5, (20.0, -15.0, 40.0), 3.0, 40.0, SIZE)


def quaternion(rotation):
    """w, x, y, z."""
    v = rotation_vector(rotation)
    angle = np.linalg.norm(v)
    return [np.cos(angle / 2), *(np.sin(angle / 2) * v / max(angle, 1e-12))]


def write_colmap(folder, text, model="PINHOLE", parameters=None, names=None, cameras=CAMERAS, points=((0.1, 0.2, 0.3),), size=SIZE):
    """A model with a camera for all images, as COLMAP's documentation has it; what images saw of points too."""
    c = cameras[0]
    parameters = [c.fx, c.fy, c.cx, c.cy] if parameters is None else parameters
    names = [f"im{k}.png" for k in range(len(cameras))] if names is None else names
    poses = [DOWN_FORWARD @ c.world_to_camera for c in cameras]
    rows = [(k + 7, quaternion(p[:3, :3]), p[:3, 3], name) for k, (p, name) in enumerate(zip(poses, names))]
    folder.mkdir(parents=True, exist_ok=True)
    if text:
        numbers = " ".join(map(repr, map(float, parameters)))
        (folder / "cameras.txt").write_text("# Camera list\n3 {} {} {} {}\n".format(model, *size, numbers))
        (folder / "images.txt").write_text("# Image list\n# two lines each\n" + "".join(
            f"{k} {' '.join(repr(float(x)) for x in (*q, *t))} 3 {name}\n{'1.5 2.5 -1 3 4 2' if n % 2 else ''}\n"
            for n, (k, q, t, name) in enumerate(rows)))
        (folder / "points3D.txt").write_text("# points\n" + "".join(f"{n} {' '.join(map(str, p))} 1 2 3 0.5 7 0 8 1\n"
                                                                    for n, p in enumerate(points)))
        return folder
    number = [name for name, _ in MODELS].index(model)
    (folder / "cameras.bin").write_bytes(struct.pack("<QiiQQ", 1, 3, number, *size) + struct.pack(f"<{len(parameters)}d", *parameters))
    data = struct.pack("<Q", len(rows))
    for n, (k, q, t, name) in enumerate(rows):
        data += struct.pack("<i7di", k, *q, *t, 3) + name.encode() + b"\0" + struct.pack("<Q", n) + struct.pack("<ddq", 1.5, 2.5, -1) * n
    (folder / "images.bin").write_bytes(data)
    (folder / "points3D.bin").write_bytes(struct.pack("<Q", len(points)) + b"".join(
        struct.pack("<Q3d3BdQ", n, *p, 1, 2, 3, 0.5, 2) + struct.pack("<4i", 7, 0, 8, 1) for n, p in enumerate(points)))
    for extra in ("rigs.bin", "frames.bin"):  # as COLMAP 4 has beside them
        (folder / extra).write_bytes(b"\1\0")
    return folder


def pictures(folder, names=None, size=SIZE):
    folder.mkdir(parents=True, exist_ok=True)
    for k in range(len(CAMERAS)):
        path = folder / (f"im{k}.png" if names is None else names[k])
        path.parent.mkdir(parents=True, exist_ok=True)
        save_png(path, np.full((*size[::-1], 4), (k + 1) / 10))
    return folder


def write_idr(path, cameras=CAMERAS, ball=((0.5, -1.0, 2.0), 1.5), factor=-3.0):
    """world_mat = K [R t], up to a factor, and a ball."""
    arrays = {}
    for k, c in enumerate(cameras):
        matrix = np.eye(4)
        matrix[:3] = np.array([[c.fx, 0, c.cx], [0, c.fy, c.cy], [0, 0, 1]]) @ (DOWN_FORWARD @ c.world_to_camera)[:3]
        matrix[:3] *= factor
        scale = np.diag([ball[1]] * 3 + [1.0])
        scale[:3, 3] = ball[0]
        arrays |= {f"world_mat_{k}": matrix, f"scale_mat_{k}": scale, f"world_mat_inv_{k}": np.eye(4)}
    np.savez(path, **arrays)
    return path


def write_par(path, cameras=CAMERAS, count=None):
    lines = [str(len(cameras) if count is None else count)]
    for k, c in enumerate(cameras):
        pose = DOWN_FORWARD @ c.world_to_camera
        numbers = [c.fx, 0, c.cx, 0, c.fy, c.cy, 0, 0, 1, *pose[:3, :3].ravel(), *pose[:3, 3]]
        lines.append(f"im{k}.png " + " ".join(f"{x:.17g}" for x in numbers))
    path.write_text("\n".join(lines) + "\n")
    return path


def check(views, cameras=CAMERAS):
    assert len(views) == len(cameras)
    for k, (found, expected) in enumerate(zip(views.cameras, cameras)):
        np.testing.assert_allclose(found.clip_rows(), expected.clip_rows(), atol=1e-9)
        np.testing.assert_allclose(views.images[k], (k + 1) / 10, atol=0.003)


@pytest.mark.parametrize("text", [False, True], ids=["binary", "text"])
@pytest.mark.parametrize("place", ["", "sparse/0", "colmap/sparse/0"])
def test_a_colmap_model_is_found_and_read(tmp_path, text, place):
    pictures(tmp_path / "images")
    write_colmap(tmp_path / place, text)
    check(load_photographs(tmp_path))
    check(load_photographs(tmp_path / place, tmp_path / "images"))
    check(load_photographs(tmp_path / place / ("cameras.txt" if text else "cameras.bin")))


@pytest.mark.parametrize("text", [False, True], ids=["binary", "text"])
def test_images_of_a_model_come_by_name_with_spaces_and_folders_in_it(tmp_path, text):
    names = ["cam 1/a b.png", "cam 0/10.png", "cam 0/9.png", "x.png", "y.png"]
    order = sorted(range(5), key=lambda k: names[k])
    pictures(tmp_path / "images", names)
    views = load_photographs(write_colmap(tmp_path / "sparse", text, names=names))
    assert views.names == ("10", "9", "a b", "x", "y")
    for view, k in enumerate(order):
        np.testing.assert_allclose(views.cameras[view].clip_rows(), CAMERAS[k].clip_rows(), atol=1e-9)


@pytest.mark.parametrize("model, parameters", [
    ("SIMPLE_PINHOLE", [40, 16, 10]), ("PINHOLE", [40, 41, 16, 10]), ("SIMPLE_RADIAL", [40, 16, 10, 0.1]),
    ("RADIAL", [40, 16, 10, 0.1, 0.02]), ("OPENCV", [40, 41, 16, 10, 0.1, 0.02, 0.003, 0.004]),
    ("OPENCV_FISHEYE", [40, 41, 16, 10, 0.1, 0.02, 0.03, 0.04]), ("SIMPLE_RADIAL_FISHEYE", [40, 16, 10, 0.1]),
    ("RADIAL_FISHEYE", [40, 16, 10, 0.1, 0.02]), ("FULL_OPENCV", [40, 41, 16, 10, 0.1, 0.02, 0.003, 0.004, 0.05, 0.06, 0.07, 0.08])])
def test_every_lens_of_colmap_is_read_the_same_from_binary_and_text(tmp_path, model, parameters):
    found = []
    for text in (False, True):
        folder = tmp_path / str(text)
        pictures(folder / "images")
        shots = read_cameras(write_colmap(folder / "sparse", text, model, parameters)).shots
        found.append(shots[0].lens(1, 1))
    lens = found[0]
    assert lens == found[1] and (lens.fx, lens.cx, lens.cy) == (40, 16, 10) and lens.fy == (41 if len(parameters) in (8, 12) or
                                                                                             model == "PINHOLE" else 40)
    assert lens.model == ("fisheye" if "FISHEYE" in model else "opencv")
    k = {"OPENCV": (0.1, 0.02), "FULL_OPENCV": (0.1, 0.02, 0.05, 0.06, 0.07, 0.08), "OPENCV_FISHEYE": (0.1, 0.02, 0.03, 0.04)}
    assert lens.k == k.get(model, tuple(parameters[3:]) if "RADIAL" in model else ())
    assert lens.p == ((0.003, 0.004) if "OPENCV" in model and "FISHEYE" not in model else (0.0, 0.0))


@pytest.mark.parametrize("factor", [1.0, -3.0])
def test_projections_of_idr_are_taken_apart(tmp_path, factor):
    pictures(tmp_path / "image")
    path = write_idr(tmp_path / "cameras_sphere.npz", factor=factor)
    check(load_photographs(path))
    unit = load_photographs(path, normalize=True)
    assert np.allclose(unit.unit.origin, (0.5, -1.0, 2.0)) and np.isclose(unit.unit.scale, 1.5)
    x = np.array([[0.3, -0.2, 0.1]])
    for found, expected in zip(unit.cameras, CAMERAS):
        a, b = found.clip_rows() @ (*x[0], 1), expected.clip_rows() @ (*(x[0] * 1.5 + unit.unit.origin), 1)
        np.testing.assert_allclose(a[:2] / a[3], b[:2] / b[3], atol=1e-9)
    k, pose = decomposed(np.array([[40, 2, 16], [0, 41, 10], [0, 0, 1]]) @ (DOWN_FORWARD @ CAMERAS[1].world_to_camera)[:3] * factor, "")
    assert np.allclose(k, [[40, 2, 16], [0, 41, 10], [0, 0, 1]]) and np.allclose(pose, DOWN_FORWARD @ CAMERAS[1].world_to_camera)


def test_a_par_file_of_middlebury_is_read(tmp_path):
    pictures(tmp_path)
    check(load_photographs(write_par(tmp_path / "im_par.txt")))
    with pytest.warns(InputWarning, match="im_par.txt says 363 cameras, but has 5; those are used"):
        check(load_photographs(write_par(tmp_path / "im_par.txt", count=363)))


def test_cameras_of_larger_pictures_are_scaled_where_the_job_says_their_size(tmp_path):
    pictures(tmp_path)
    write_par(tmp_path / "im_par.txt", [c.resized(99, 63) for c in CAMERAS])
    with pytest.warns(InputWarning, match="5 of 5 pictures are not of the stated size"):
        check(load_photographs(tmp_path / "im_par.txt", stated=(99, 63)))


def test_pictures_that_do_not_exist_are_skipped_where_that_is_said(tmp_path):
    pictures(tmp_path / "images")
    write_colmap(tmp_path / "sparse" / "0", False)
    (tmp_path / "images" / "im3.png").unlink()
    with pytest.raises(InputError, match="1 of 5 pictures do not exist, such as .*im3.png; .* say views.missing = \"skip\""):
        load_photographs(tmp_path)
    with pytest.warns(InputWarning, match="1 of 5 pictures do not exist"):
        assert load_photographs(tmp_path, skip=True).names == ("im0", "im1", "im2", "im4")


DAMAGED = [
    ("none", lambda f: None, "has no cameras.bin and images.bin"),
    ("binary", lambda f: cut(f / "images.bin", 100), "images.bin says that it has 5 entries, but it has 100 bytes"),
    ("binary", lambda f: cut(f / "images.bin", 400), "images.bin ends at byte 400 in the middle of an entry"),
    ("binary", lambda f: cut(f / "cameras.bin", 40), "cameras.bin ends at byte 40"),
    ("binary", lambda f: put(f / "images.bin", 0, struct.pack("<Q", 2 ** 60)), "says that it has 1152921504606846976 entries"),
    ("binary", lambda f: put(f / "cameras.bin", 12, struct.pack("<i", 7)), "camera 3 has the model FOV; read are SIMPLE_PINHOLE PINHOLE"),
    ("binary", lambda f: put(f / "cameras.bin", 12, struct.pack("<i", 10)), "has the model THIN_PRISM_FISHEYE; read are"),
    ("binary", lambda f: put(f / "cameras.bin", 12, struct.pack("<i", 99)), "has the model number 99; read are"),
    ("binary", lambda f: put(f / "cameras.bin", 8, struct.pack("<i", 4)), "image im0.png is of camera 3, which the model does not have"),
    ("binary", lambda f: put(f / "images.bin", 12, struct.pack("<d", 7.0)), "has a quaternion of length"),
    ("binary", lambda f: put(f / "images.bin", 12, struct.pack("<d", np.nan)), "images.bin has a number that is not finite before byte"),
    ("binary", lambda f: put(f / "cameras.bin", 32, struct.pack("<d", -1.0)), "camera 3 has focal lengths -1, "),
    ("text", lambda f: edit(f / "cameras.txt", "PINHOLE", "OPENCV"), "line 2, camera 3, has 4 parameters; model OPENCV has 8: fx fy cx"),
    ("text", lambda f: edit(f / "cameras.txt", "PINHOLE", "FOV"), "has the model FOV; read are"),
    ("text", lambda f: edit(f / "cameras.txt", "PINHOLE 33", "PINHOLE wide"), "line 2: could not convert string to float: 'wide'"),
    ("text", lambda f: edit(f / "images.txt", "3 im1.png", "im1.png"), "line 5 has 9 words; IMAGE_ID QW"),
    ("text", lambda f: (f / "images.txt").write_text("# none\n"), "has no image; a model with registered images is needed"),
    ("idr", lambda f: (f / "c.npz").write_bytes(b"PK no"), "c.npz is no archive of NumPy arrays"),
    ("idr", lambda f: np.savez(f / "c.npz", a=np.eye(4)), "c.npz has no world_mat_0"),
    ("idr", lambda f: np.savez(f / "c.npz", **{f"world_mat_{k}": np.eye(3) for k in range(5)}), "world_mat_0 is float64 of shape .3, 3.;"),
    ("idr", lambda f: np.savez(f / "c.npz", **{f"world_mat_{k}": np.zeros((4, 4)) for k in range(5)}), "world_mat_0 is no projection"),
    ("idr", lambda f: (f / "image" / "im0.png").unlink(), "has 5 cameras, but .*image has 4 pictures; they are taken in order"),
    ("par", lambda f: edit(f / "p_par.txt", "5\n", "five\n"), "p_par.txt line 1 must be the number of cameras"),
    ("par", lambda f: cut(f / "p_par.txt", 1300), "p_par.txt line [0-9] has [0-9]+ numbers after the name; 21 finite ones are needed"),
    ("par", lambda f: edit(f / "p_par.txt", " 0 0 1 ", " 0.5 0 1 "), "line 2 .im0.png.: K is .* fx skew cx, 0 fy cy, 0 0 1"),
    ("par", lambda f: edit(f / "p_par.txt", "im1.png", "lost.png"), "1 of 5 pictures do not exist, such as .*lost.png; check views.images")]


def cut(path, size):
    path.write_bytes(path.read_bytes()[:size])


def put(path, at, data):
    old = path.read_bytes()
    path.write_bytes(old[:at] + data + old[at + len(data):])


def edit(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def written(kind, folder):
    """What load_photographs is given."""
    pictures(folder if kind == "par" else folder / ("image" if kind == "idr" else "images"))
    if kind in ("binary", "text"):
        return write_colmap(folder, kind == "text")
    if kind == "idr":
        return write_idr(folder / "c.npz")
    return write_par(folder / "p_par.txt") if kind == "par" else folder


@pytest.mark.parametrize("kind, damage, message", DAMAGED)
def test_a_damaged_file_of_cameras_is_named(tmp_path, kind, damage, message):
    path = written(kind, tmp_path)
    damage(tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        with pytest.raises(InputError, match=message) as caught:
            load_photographs(path)
    assert "\n" not in str(caught.value)


def test_no_damage_of_any_byte_gives_more_than_a_line(tmp_path):
    """A few hundred mutations; each is read, or refused in one line."""
    r, counts = random.Random(3), [0, 0]
    for kind in ("binary", "text", "idr", "par"):
        folder = tmp_path / kind
        path = written(kind, folder)
        files = {f: f.read_bytes() for f in folder.iterdir() if f.suffix in (".bin", ".txt", ".npz")}
        for _ in range(60):
            file = r.choice(list(files))
            data = bytearray(files[file])
            for _ in range(r.choice((1, 1, 3))):
                at = r.randrange(max(1, len(data)))
                new = bytes(r.choice((0, 255, 48, 45, 32, 10, r.randrange(256))) for _ in range(r.choice((0, 1, 1, 8))))
                data[at:at + r.choice((0, 1, 8))] = new
            file.write_bytes(data[:r.randrange(len(data) + 1)] if r.random() < 0.2 else data)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", InputWarning)
                try:
                    load_photographs(path)
                    counts[0] += 1
                except InputError as error:
                    counts[1] += 1
                    assert "\n" not in str(error) and 0 < len(str(error)) < 1500
            file.write_bytes(files[file])
    assert counts[0] > 20 and counts[1] > 60, counts


# A frame of the object's own


GAUGE = Unit(np.array([120.0, -30.0, 55.0]), 17.0)  # as arbitrary as COLMAP's is


def far_cameras():
    """The cameras of a ball about 0, in a frame of another place and unit."""
    return [replace_pose(c, GAUGE) for c in orbit(6, (15.0, -20.0), 2.5, 50.0, (24, 24))]


def replace_pose(camera, unit):
    pose = camera.camera_to_world.copy()
    pose[:3, 3] = unit.origin + unit.scale * pose[:3, 3]
    return replace(camera, world_to_camera=inverse_rigid(pose))


@pytest.mark.parametrize("masks", [True, False], ids=["by masks", "by points"])
def test_the_object_is_brought_into_the_unit_ball(tmp_path, masks):
    (tmp_path / "images").mkdir()
    for k in range(6):
        save_png(tmp_path / "images" / f"im{k}.png", disc() if masks else np.ones((24, 24, 4)))
    cameras = far_cameras()
    surface = np.random.default_rng(0).normal(size=(300, 3))
    surface *= 17.0 * 0.8 / np.linalg.norm(surface, axis=1, keepdims=True)
    points = [*(surface + GAUGE.origin), *np.full((10, 3), 1e4)]
    views = load_photographs(write_colmap(tmp_path, False, cameras=cameras, points=points, size=(24, 24)), normalize=True,
                             masks=Masks(whole=not masks))
    assert np.linalg.norm(views.unit.origin - GAUGE.origin) < 0.1 * 17.0
    assert 0.7 * 17 * 0.8 < views.unit.scale < 1.4 * 17 * 0.8, views.unit.scale  # the disc is a ball of radius 0.79 seen from 2.5
    for c, expected in zip(views.cameras, cameras):
        np.testing.assert_allclose(c.position * views.unit.scale + views.unit.origin, expected.position)
        assert (c.near, c.far) == (0.05, 100.0)


@pytest.mark.full
def test_results_of_a_job_in_the_unit_ball_are_in_the_frame_of_its_cameras(tmp_path):
    """From a COLMAP model in an arbitrary gauge to a mesh file there, on the command line."""
    (tmp_path / "images").mkdir()
    for k in range(6):
        save_png(tmp_path / "images" / f"im{k}.png", disc())
    write_colmap(tmp_path / "sparse" / "0", False, cameras=far_cameras(), size=(24, 24))
    text = TINY.replace('transforms = "photos/transforms.json"', 'cameras = "sparse/0"\nnormalize = true')
    text = text.replace("steps = 3", "steps = 15").replace("start = 0.01", "start = 0.03")
    (tmp_path / "job.toml").write_text(text.replace("radius = 0.5", "radius = 1.0").replace(
        'optimize.vertices = {optimizer', 'optimize.translation = {rate = 1e-3}\noptimize.vertices = {optimizer'))
    for out in ("out.ply", "out.npz"):
        done = command("run", "job.toml", "--device", "reference", "-o", out, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
    mesh = load_mesh(tmp_path / "out.ply")
    radius = np.linalg.norm(mesh.positions - GAUGE.origin, axis=1)
    assert 0.6 < np.median(radius) / 17.0 < 1.0, np.median(radius) / 17.0
    np.testing.assert_allclose(np.load(tmp_path / "out.npz")["vertices"], mesh.positions, atol=1e-3)
    poses = json.loads((tmp_path / "out_metrics.json").read_text())["camera_to_world"]
    for k, camera in enumerate(far_cameras()):
        assert np.linalg.norm(np.array(poses[f"im{k}"])[:3, 3] - camera.position) < 2.0


@pytest.mark.parametrize("lines, message", [
    ("cameras = \"lost\"", "cameras .*lost do not exist; a COLMAP model"), ("cameras = \"job.toml\"", "have a format that is not read"),
    ("cameras = \".\"\nimages = [\"a.png\"]", "cameras needs a folder"), ("cameras = \".\"\ntransforms = \".\"", "one of them alone"),
    ("cameras = \".\"\nnormalize = 3", "views.normalize is 3; true, false or"), ("cameras = \".\"\nstated = 3", "views.stated is 3"),
    ("cameras = \".\"\nnormalize = {center = [0, 0, 0]}", "views.normalize.radius is missing"),
    ("transforms = \".\"\nimages = \"images\"", "transforms names its images itself"), ("cameras = \"images\"", "has no cameras.bin and"),
    ("gltf = \"x.gltf\"\nimages = \"images\"\nnormalize = true", "normalize is not for gltf")])
def test_keys_of_cameras_are_checked(tmp_path, lines, message):
    pictures(tmp_path / "images")
    write_colmap(tmp_path, False)
    (tmp_path / "job.toml").write_text(TINY.replace('transforms = "photos/transforms.json"', lines))
    with pytest.raises(InputError, match=message):
        load_job(tmp_path / "job.toml")


def test_point_lights_are_refused_beside_a_frame_of_another_unit(tmp_path):
    pictures(tmp_path / "images")
    write_colmap(tmp_path, False)
    text = TINY.replace('transforms = "photos/transforms.json"', 'cameras = "."\nnormalize = {center = [0, 0, 0], radius = 2}')
    text = text.replace("[render]", "[[light]]\nkind = \"point\"\npower = 3\nvector = [0, 1, 2]\n[render]\nshading = \"lambert\"")
    (tmp_path / "job.toml").write_text(text)
    with pytest.raises(InputError, match="a point or spot light's power and place are of the unit that views.normalize changes"):
        load_job(tmp_path / "job.toml")


# Real files, that others wrote


def real(name):
    if not (ASSETS / name).is_dir():
        pytest.skip("shared assets not present; sets written by this test were read in their place")
    return ASSETS / name


def angles(views):
    """Of each view's rotation against the first's, in degrees."""
    first = views.cameras[0].world_to_camera[:3, :3]
    return np.degrees([np.linalg.norm(rotation_vector(c.world_to_camera[:3, :3] @ first.T)) for c in views.cameras])


def test_a_real_colmap_model_in_binary_and_text():
    folder = real("colmap_oxford_dino")
    whole = Masks(whole=True)
    with pytest.warns(InputWarning, match=r"36 of 36 pictures are undistorted .*opencv k1 0.735"):
        binary, text = (load_photographs(folder / place, size=72, masks=whole) for place in ("sparse/0", "sparse_txt"))
    for a, b in zip(binary.cameras, text.cameras):
        np.testing.assert_allclose(a.clip_rows(), b.clip_rows(), atol=1e-6)
    known = load_photographs(folder / "known_poses", size=72, masks=whole, normalize=True)
    assert len(known) == 36 and known.images.shape == (36, 58, 72, 4)
    turned = 10.0 * np.minimum(np.arange(36), 36 - np.arange(36))
    np.testing.assert_allclose(angles(known), turned, atol=0.5)  # a turntable of 36 stops
    np.testing.assert_allclose(angles(binary), turned, atol=1.0)
    inside = [np.abs((c.clip_rows() @ (0, 0, 0, 1))[:2] / (c.clip_rows() @ (0, 0, 0, 1))[3]).max() for c in known.cameras]
    assert max(inside) < 0.6, "the points' middle is in the middle of the pictures"


def test_real_files_of_idr_and_of_middlebury(tmp_path):
    dtu = real("dtu_scan24")
    views = load_photographs(dtu / "cameras_sphere.npz", dtu / "images", stated=(1600, 1200), normalize=True)
    own = load_photographs(dtu / "transforms_train.json")
    assert len(views) == 49 and views.images.shape[1:] == (150, 200, 4)
    by_name = {name: c for name, c in zip(views.names, views.cameras)}
    chosen = [by_name[name] for name in own.names]
    a, b = (np.array([np.linalg.norm(c.position) for c in cs]) for cs in (chosen, own.cameras))
    np.testing.assert_allclose(a, b, rtol=1e-3)  # the JSON is of the same ball, turned
    focal = np.array([c.fx for c in chosen]) / [c.fx for c in own.cameras]
    assert np.abs(focal - np.median(focal)).max() < 1e-3 and 0.9 < np.median(focal) < 1.0, "the JSON's pictures are cut by 3 %"
    dino = real("middlebury_dino48")
    for k in range(48):
        Image.new("L", (640, 480)).save(tmp_path / f"dino{k + 1:04d}.png")
    with pytest.warns(InputWarning, match="says 363 cameras, but has 48"):
        par = load_photographs(dino / "dino_par_first48.txt", tmp_path, size=64, masks=Masks(whole=True))
    assert len(par) == 48 and np.isclose(par.cameras[0].fx, 331.04)
    own = load_photographs(dino / "transforms_train.json")
    numbers = [int(name) for name in own.names]
    found = angles(par)[numbers]
    assert numbers[0] in (0, 1) and np.abs((found - found[0]) - (angles(own) - angles(own)[0])).max() < 1.0
