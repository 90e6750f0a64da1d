"""A starting job for a folder of pictures: it fits what is there, compiles as it is, and what nobody can guess is asked for."""

import json
import sys

import numpy as np
import pytest
from jobs import command
from PIL import Image

from dressi_edge.cache.errors import InputError
from dressi_edge.compiler.io.cameras import Camera, orbit
from dressi_edge.compiler.io.meshes import load_mesh
from dressi_edge.compiler.scene.job import load_job
from dressi_edge.compiler.scene.starting import starting_job

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

RADIUS = 0.5


def folder_of(path, views=5, size=(80, 60), middle=(0.0, 0.0, 0.0), scale=1.0, kind="alpha", name="photos"):
    """A folder of pictures of a red ball of radius RADIUS * scale at `middle`, with transforms.json. kind: how the object is told."""
    folder = path / name
    (folder / "images").mkdir(parents=True)
    if kind == "masks":
        (folder / "masks").mkdir()
    frames = []
    for k, camera in enumerate(orbit(views, [20.0, -15.0], 3.0 * scale, 40.0, size)):
        pose = camera.camera_to_world.copy()
        pose[:3, 3] += middle
        moved = Camera(np.linalg.inv(pose), camera.fx, camera.fy, camera.cx, camera.cy, *size)
        at = moved.world_to_camera @ np.append(middle, 1.0)
        y, x = np.mgrid[:size[1], :size[0]] + 0.5
        centre = moved.cx + moved.fx * at[0] / -at[2], moved.cy - moved.fy * at[1] / -at[2]
        inside = (x - centre[0]) ** 2 + (y - centre[1]) ** 2 < (moved.fx * RADIUS * scale / -at[2]) ** 2
        image = np.zeros((size[1], size[0], 4), np.uint8)
        image[..., :3] = np.where(inside[..., None], (200, 40, 30), (230, 235, 240))
        if kind == "noise":
            image[..., :3] = np.random.default_rng(k).integers(0, 255, image[..., :3].shape)
        image[..., 3] = 255 * inside
        Image.fromarray(image if kind == "alpha" else image[..., :3]).save(folder / "images" / f"{k:03}.png")
        if kind == "masks":
            Image.fromarray(image[..., 3]).save(folder / "masks" / f"{k:03}.png")
        frames.append({"file_path": f"images/{k:03}.png", "transform_matrix": pose.tolist()})
    camera = orbit(1, [0.0], 3.0, 40.0, size)[0]
    lens = {"fl_x": camera.fx, "fl_y": camera.fy, "cx": camera.cx, "cy": camera.cy, "w": size[0], "h": size[1]}
    (folder / "transforms.json").write_text(json.dumps({**lens, "frames": frames}))
    return folder


def written(tmp_path, folder, *args):
    """The table of the job that `new` writes, and what it says."""
    done = command("new", folder, *args, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    return tomllib.loads((tmp_path / "job.toml").read_text()), done.stdout


@pytest.mark.parametrize("kind, key, start", [("alpha", None, "sphere"), ("masks", "masks", "sphere"), pytest.param(
    "backdrop", "backdrop", "hull", marks=pytest.mark.full)])
def test_the_object_is_found_by_alpha_masks_or_a_plain_backdrop(tmp_path, kind, key, start):
    job, said = written(tmp_path, folder_of(tmp_path, kind=kind), "--start", start)
    assert {"masks", "backdrop"} & set(job["views"]) == ({key} if key else set())
    if start == "sphere":
        assert job["mesh"]["sphere"]["radius"] == pytest.approx(0.6 * RADIUS, rel=0.1) and "hull" not in said
    else:
        assert job["mesh"] == {"hull": {"vertices": 2562}} and "it starts from the hull of the masks: what all of them allow" in said
    assert job["views"]["transforms"] == "photos/transforms.json" and "5 pictures of 80 x 60" in said
    assert [p["name"] for p in job["phase"]] == ["shape", "texture"] and "dressi-edge compile job.toml" in said
    problem = load_job(tmp_path / "job.toml")
    assert len(problem.cameras) == 5 and problem.views.masks[0].box is not None
    far = np.linalg.norm(problem.mesh.positions, axis=1)
    assert problem.albedo == "texture" and (start == "sphere" or 0.9 * RADIUS < far.min() and np.median(far) < 1.15 * RADIUS)


def test_numbers_follow_the_size_and_the_place_of_the_object(tmp_path):
    middle = (40.0, -30.0, 10.0)
    start = starting_job(folder_of(tmp_path, middle=middle, scale=20.0), tmp_path)
    job = tomllib.loads(start.text)
    assert "around (40, -30, 10)" in start.text and not start.files
    rate = job["phase"][0]["optimize"]["vertices"]["rate"]["start"]
    assert rate == pytest.approx(0.003 * RADIUS * 20.0, rel=0.1)
    assert job["phase"][0]["loss"][1]["weight"]["start"] == pytest.approx(20.0 / 100.0, rel=0.1)
    assert job["views"]["near"] < 60.0 - 10.0 and job["views"]["far"] > 60.0 + 10.0 and list(job["mesh"]) == ["hull"]


def test_without_the_libraries_of_the_hull_it_starts_from_a_sphere_and_says_so(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "skimage.measure", None)
    start = starting_job(folder_of(tmp_path), tmp_path)
    job = tomllib.loads(start.text)
    assert job["mesh"]["sphere"]["radius"] == pytest.approx(0.6 * RADIUS, rel=0.1) and not start.carved
    assert start.told[-1] == ("it starts from a sphere, not from the hull of the masks: a visual hull needs skimage, which is not "
                              "installed; pip install 'dressi_edge[hull]'")
    middle = (40.0, -30.0, 10.0)
    start = starting_job(folder_of(tmp_path, middle=middle, scale=20.0, name="far"), tmp_path)
    job = tomllib.loads(start.text)
    (tmp_path / "job.toml").write_text(start.text)
    for name, data in start.files.items():
        (tmp_path / name).write_bytes(data)
    ball = load_mesh(tmp_path / job["mesh"]["path"]).positions - middle
    assert job["mesh"] == {"path": "job_start.obj"} and "the sphere is in job_start.obj" in start.told[-1]
    assert np.linalg.norm(ball, axis=1).max() == pytest.approx(0.6 * RADIUS * 20.0, rel=0.1)
    assert job["phase"][0]["optimize"]["vertices"]["rate"]["start"] == pytest.approx(0.01 * RADIUS * 20.0, rel=0.1)
    assert load_job(tmp_path / "job.toml").mesh.uvs is not None


def test_masks_that_bound_nothing_leave_a_sphere(tmp_path):
    """All cameras look from one side, and what they see goes on beyond the pictures."""
    folder = folder_of(tmp_path, views=4, size=(26, 22))
    table = json.loads((folder / "transforms.json").read_text())
    for k, (image, frame) in enumerate(zip(sorted((folder / "images").iterdir()), table["frames"])):
        pixels = np.asarray(Image.open(image)).copy()
        pixels[..., 3] = 255
        pixels[:, :2, 3] = 0
        Image.fromarray(pixels).save(image)
        frame["transform_matrix"] = [[1, 0, 0, 0.01 * k], [0, 1, 0, 0], [0, 0, 1, 3.0], [0, 0, 0, 1]]
    (folder / "transforms.json").write_text(json.dumps(table))
    start = starting_job(folder, tmp_path)
    assert not start.carved and any("it starts from a sphere, not from the hull of the masks: the masks do not bound the object" in line
                                    for line in start.told), start.told


def test_masks_that_do_not_agree_are_told_and_allowed_for(tmp_path):
    """Of sixteen masks one lacks a third of the ball, which all others show."""
    folder = folder_of(tmp_path, views=16)
    agreeing = tomllib.loads(starting_job(folder, tmp_path).text)
    pixels = np.asarray(Image.open(folder / "images" / "003.png")).copy()
    pixels[:26, :, 3] = 0
    Image.fromarray(pixels).save(folder / "images" / "003.png")
    start = starting_job(folder, tmp_path)
    assert agreeing["mesh"]["hull"] == {"vertices": 2562}
    assert tomllib.loads(start.text)["mesh"]["hull"] == {"vertices": 2562, "misses": 1}
    assert "they do not agree everywhere, and what 1 lacks is kept" in start.told[-1]


def test_many_large_pictures_become_views_that_every_device_takes(tmp_path):
    job, said = written(tmp_path, folder_of(tmp_path, views=33, size=(450, 300), kind="backdrop"), "--start", "sphere")
    assert job["views"]["order"] == "shuffle" and job["views"]["size"] == 400
    assert "run job.dressi --views photos -o" in said, "so many pictures are not in the bundle"
    problem = load_job(tmp_path / "job.toml")
    assert (problem.width, problem.height) == (400, 267)


def test_a_mesh_in_the_folder_is_the_start(tmp_path):
    folder = folder_of(tmp_path)
    (folder / "scan.off").write_text("OFF\n4 4 0\n0.3 0 0\n-0.3 0 0.3\n-0.3 0 -0.3\n0 0.4 0\n3 0 1 2\n3 0 3 1\n3 1 3 2\n3 2 3 0\n")
    job, said = written(tmp_path, folder)
    assert job["mesh"] == {"path": "photos/scan.off"} and "it starts from scan.off" in said
    assert list(job["phase"][1]["optimize"]) == ["colors"], "it has no texture coordinates"


def test_pictures_that_are_missing_are_left_out(tmp_path):
    folder = folder_of(tmp_path)
    (folder / "images" / "002.png").unlink()
    job, said = written(tmp_path, folder, "--start", "sphere")
    assert job["views"]["missing"] == "skip" and "4 pictures" in said and len(load_job(tmp_path / "job.toml").cameras) == 4


def test_a_colmap_model_is_found(tmp_path):
    folder = folder_of(tmp_path, kind="masks", middle=(1.0, 2.0, 3.0))
    table = json.loads((folder / "transforms.json").read_text())
    (folder / "transforms.json").unlink()
    model = folder / "sparse" / "0"
    model.mkdir(parents=True)
    (model / "cameras.txt").write_text(f"1 PINHOLE 80 60 {table['fl_x']} {table['fl_y']} {table['cx']} {table['cy']}\n")
    lines = []
    for k, frame in enumerate(table["frames"]):
        seen = np.diag([1.0, -1.0, -1.0, 1.0]) @ np.linalg.inv(frame["transform_matrix"])  # COLMAP: y down, z ahead
        w = 0.5 * np.sqrt(max(1.0 + np.trace(seen[:3, :3]), 1e-12))
        axis = np.array([seen[2, 1] - seen[1, 2], seen[0, 2] - seen[2, 0], seen[1, 0] - seen[0, 1]]) / (4.0 * w)
        numbers = " ".join(f"{x:.17g}" for x in (w, *axis, *seen[:3, 3]))
        lines += [f"{k + 1} {numbers} 1 {k:03}.png", ""]
    (model / "images.txt").write_text("\n".join(lines) + "\n")
    job, said = written(tmp_path, folder, "--start", "sphere")
    assert job["views"]["cameras"] == "photos" and "masks are in masks" in said
    problem = load_job(tmp_path / "job.toml")
    assert len(problem.cameras) == 5 and np.allclose(problem.mesh.positions.mean(axis=0), (1.0, 2.0, 3.0), atol=0.05)


@pytest.mark.parametrize("name", ["my photos", "it's", 'a "b"', "Äpfel", "a\\b"])
def test_folders_may_be_called_anything(tmp_path, name):
    job, _ = written(tmp_path, folder_of(tmp_path, name=name, views=3), "--start", "sphere")
    assert job["views"]["transforms"] == f"{name}/transforms.json"


def test_the_job_compiles_and_reconstructs_as_it_is(tmp_path):
    written(tmp_path, folder_of(tmp_path))
    made = command("compile", "job.toml", "-p", "vulkan_min", "-o", "job.dressi", cwd=tmp_path)
    assert made.returncode == 0, made.stderr
    done = command("run", "job.dressi", "-o", "job.glb", "--steps", "50", "--json", cwd=tmp_path)
    views = json.loads(done.stdout)["views"]
    assert done.returncode == 0 and views["iou_mean"] > 0.93 and views["psnr_mean"] > 25, done.stderr


@pytest.mark.full
def test_the_other_renderer_is_a_line_away(tmp_path):
    written(tmp_path, folder_of(tmp_path))
    job = tmp_path / "job.toml"
    text = job.read_text()
    assert text.count('# renderer = "binned"') == 1
    job.write_text(text.replace('# renderer = "binned"', 'renderer = "binned"'))
    assert tomllib.loads(job.read_text())["phase"][0]["renderer"] == "binned"
    made = command("compile", "job.toml", "-p", "lavapipe", "-o", "job.dressi", cwd=tmp_path)
    assert made.returncode == 0, made.stderr


def test_an_existing_job_is_kept_unless_it_is_to_be_replaced(tmp_path):
    folder = folder_of(tmp_path)
    (tmp_path / "job.toml").write_text("mine")
    done = command("new", folder, cwd=tmp_path)
    assert done.returncode == 3 and "job.toml exists; name another with -o, or replace it with --force" in done.stderr
    assert (tmp_path / "job.toml").read_text() == "mine"
    written(tmp_path, folder, "--force", "--start", "sphere")


def test_what_cannot_be_guessed_is_asked_for(tmp_path):
    with pytest.raises(InputError, match="is no folder; name the one with the pictures"):
        starting_job(tmp_path / "none", tmp_path)
    folder = folder_of(tmp_path, kind="noise")
    with pytest.raises(InputError, match="where the object is cannot be told: 000.png has no alpha.*Make masks, white on the object"):
        starting_job(folder, tmp_path)
    (folder / "transforms.json").unlink()
    with pytest.raises(InputError, match="photos has 5 pictures and no cameras: .*COLMAP model.*COLMAP finds it"):
        starting_job(folder, tmp_path)


def test_masks_that_are_empty_and_poses_of_another_convention_are_named(tmp_path):
    folder = folder_of(tmp_path, kind="masks")
    for mask in (folder / "masks").iterdir():
        Image.new("L", (80, 60)).save(mask)
    with pytest.raises(InputError, match="the masks of all pictures are empty"):
        starting_job(folder, tmp_path)
    other = folder_of(tmp_path, name="other", middle=(0.3, 0.1, 0.0))
    table = json.loads((other / "transforms.json").read_text())
    for frame in table["frames"]:
        frame["transform_matrix"] = (np.array(frame["transform_matrix"]) @ np.diag([1.0, -1.0, -1.0, 1.0])).tolist()
    (other / "transforms.json").write_text(json.dumps(table))
    with pytest.raises(InputError, match="lies behind the cameras: their poses are of another convention"):
        starting_job(other, tmp_path)


def test_real_photographs_get_a_job(shared_dir, tmp_path):
    """Thirty-two photographs of a toy dinosaur on a turntable; its procedural twins are the tests above."""
    source = shared_dir / "assets" / "oxford_dino"
    if not source.is_dir():
        pytest.skip("shared/assets/oxford_dino is not there")
    folder = tmp_path / "dino"
    folder.mkdir()
    (folder / "images").symlink_to(source / "images")
    table = json.loads((source / "transforms_train.json").read_text())
    for frame in table["frames"]:
        frame.pop("source", None)  # where the picture came from, which no camera depends on
    (folder / "transforms_train.json").write_text(json.dumps(table))
    start = starting_job(folder, tmp_path)
    job, said = tomllib.loads(start.text), start.text
    assert "32 pictures of 240 x 192" in said and "their alpha is the mask" in said and "they do not agree" not in said
    assert list(job["mesh"]) == ["hull"] and job["views"]["order"] == "shuffle"
