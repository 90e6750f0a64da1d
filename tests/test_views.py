"""Cameras and views: the projection is the documented one, each kind of bad input is named, and images line up with meshes."""

import json
import struct
import warnings
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from dressi_edge.cache.errors import InputError, InputWarning
from dressi_edge.compiler.io.averaging import downsampled
from dressi_edge.compiler.io.cameras import Camera, look_at, orbit, rotation_matrix, rotation_vector
from dressi_edge.compiler.io.decode import load_images
from dressi_edge.compiler.io.gltf_cameras import gltf_cameras
from dressi_edge.compiler.io.images import linear_to_srgb, names_of, natural, srgb_to_linear
from dressi_edge.compiler.io.meshes import Mesh, load_mesh, load_texture, normalize
from dressi_edge.compiler.io.shapes import pear
from dressi_edge.compiler.io.views import Views, load_gltf_views, load_views
from dressi_edge.compiler.io.writers import save_json, save_png

SHARED = Path(__file__).resolve().parents[2] / "shared"


def camera_at(**changes) -> Camera:
    fields = dict(world_to_camera=np.eye(4), fx=40.0, fy=50.0, cx=30.0, cy=20.0, width=64, height=48) | changes
    return Camera(**fields)


def first_hit(mesh: Mesh, origin: np.ndarray, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of each ray (n, 3): distance along it (inf on a miss), face, barycentrics (n, 3). Moeller and Trumbore 1997."""
    a, b, c = (mesh.positions[mesh.faces[:, i]] for i in range(3))
    e1, e2, s = b - a, c - a, origin - a
    q = np.cross(s, e1)
    distance, face, weights = np.full(len(rays), np.inf), np.zeros(len(rays), int), np.zeros((len(rays), 3))
    for i, ray in enumerate(rays):
        p = np.cross(ray, e2)
        scale = 1.0 / np.where(np.abs(det := (e1 * p).sum(1)) > 1e-15, det, np.inf)
        u, v, t = (s * p).sum(1) * scale, (q @ ray) * scale, (e2 * q).sum(1) * scale
        t = np.where((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 1e-9), t, np.inf)
        face[i] = np.argmin(t)
        distance[i], weights[i] = t[face[i]], (1 - u[face[i]] - v[face[i]], u[face[i]], v[face[i]])
    return distance, face, weights


def surface_colour(mesh: Mesh, face: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """The nearest texel, with texel row j at v = (j + 0.5) / height."""
    uv = np.einsum("ij,ijk->ik", weights, mesh.uvs[mesh.uv_faces[face]]) % 1.0
    height, width = mesh.texture.shape[:2]
    return mesh.texture[(uv[:, 1] * height).astype(int), (uv[:, 0] * width).astype(int)]


def photograph(mesh: Mesh, camera: Camera) -> np.ndarray:
    """RGBA (h, w, 4) by casting a ray through each pixel centre; uses the pose and intrinsics, not `clip_rows`."""
    y, x = np.mgrid[:camera.height, :camera.width] + 0.5
    rays = np.stack([(x - camera.cx) / camera.fx, -(y - camera.cy) / camera.fy, -np.ones_like(x)], axis=-1).reshape(-1, 3)
    distance, face, weights = first_hit(mesh, camera.position, rays @ camera.world_to_camera[:3, :3])
    hit = np.isfinite(distance)[:, None]
    image = np.concatenate([np.where(hit, surface_colour(mesh, face, weights), 0.0), hit], axis=1)
    return image.reshape(camera.height, camera.width, 4)


def misfit(mesh: Mesh, views: Views, view: int) -> tuple[float, float]:
    """Between the texture at visible, not grazing face centroids and the image at their projections: median colour error,
    mean alpha."""
    camera, image = views.cameras[view], views.images[view]
    chosen = np.random.default_rng(view).choice(len(mesh.faces), 400, replace=False)
    points = mesh.positions[mesh.faces[chosen]].mean(axis=1)
    distance, face, weights = first_hit(mesh, camera.position, points - camera.position)
    a, b, c = (mesh.positions[mesh.faces[chosen, i]] for i in range(3))
    normal, ray = np.cross(b - a, c - a), camera.position - points
    facing = (normal * ray).sum(axis=1) > 0.4 * np.linalg.norm(normal, axis=1) * np.linalg.norm(ray, axis=1)
    seen = (face == chosen) & (distance > 1.0 - 1e-6) & facing
    assert seen.sum() > 50
    clip = np.concatenate([points[seen], np.ones((seen.sum(), 1))], axis=1) @ camera.clip_rows().T
    x, y = (clip[:, :2] / clip[:, 3:] + 1.0).T / 2.0
    pixels = image[(y * camera.height).astype(int), (x * camera.width).astype(int)]
    error = np.abs(pixels[:, :3] - surface_colour(mesh, face[seen], weights[seen])).mean(axis=1)
    return float(np.median(error)), float(pixels[:, 3].mean())


def write_views(folder: Path, images: list[np.ndarray], cameras: tuple[Camera, ...], **top) -> Path:
    frames = []
    for i, (image, camera) in enumerate(zip(images, cameras, strict=True)):
        save_png(folder / f"{i:03d}.png", image)
        frames.append({"file_path": f"./{i:03d}", "transform_matrix": camera.camera_to_world.tolist()})
    first = cameras[0]
    intrinsics = {"fl_x": first.fx, "fl_y": first.fy, "cx": first.cx, "cy": first.cy}
    save_json(folder / "transforms.json", {**intrinsics, "frames": frames} | top)
    return folder


@pytest.fixture
def folder(tmp_path):
    """A small valid data set of two views of 8x6 pixels."""
    images = [np.full((6, 8, 4), level) for level in (0.2, 0.8)]
    return write_views(tmp_path, images, orbit(2, [20.0], 3.0, 40.0, (8, 6)))


def edited(folder: Path, change) -> Path:
    document = json.loads((folder / "transforms.json").read_text())
    change(document)
    (folder / "transforms.json").write_text(json.dumps(document))
    return folder


# Cameras


def test_clip_rows_are_the_documented_projection():
    camera = camera_at(world_to_camera=look_at((1, 2, 3), (0, 0, 0), (0, 1, 0), 40, 64, 48).world_to_camera, near=0.5, far=20.0)
    world = np.random.default_rng(0).normal(size=(20, 3))
    x, y, z = camera.world_to_camera[:3, :3] @ world.T + camera.world_to_camera[:3, 3:]
    clip = np.concatenate([world, np.ones((20, 1))], axis=1) @ camera.clip_rows().T
    assert np.allclose(clip[:, 3], -z)
    assert np.allclose((clip[:, 0] / clip[:, 3] + 1) / 2 * 64, 30.0 + 40.0 * x / -z)
    assert np.allclose((clip[:, 1] / clip[:, 3] + 1) / 2 * 48, 20.0 - 50.0 * y / -z)
    assert np.allclose(clip[:, 2], 20.0 * (-z - 0.5) / 19.5)


def test_look_at_puts_its_target_in_the_centre_and_up_upwards():
    camera = look_at((0, 0, 5), (0, 0, 0), (0, 1, 0), 90.0, 64, 64)
    assert np.allclose(camera.position, (0, 0, 5)) and np.isclose(camera.fy, 32.0)
    centre, right, above = (camera.clip_rows() @ (*point, 1.0) for point in ((0, 0, 0), (1, 0, 0), (0, 1, 0)))
    assert np.allclose(centre[:2], 0.0) and right[0] > 0.0 and above[1] < 0.0
    assert np.allclose(camera.camera_to_world @ camera.world_to_camera, np.eye(4))
    with pytest.raises(InputError, match="give another up"):
        look_at((0, 5, 0), (0, 0, 0), (0, 1, 0), 40.0, 64, 64)


def test_orbit_goes_once_round():
    cameras = orbit(6, [0.0, 30.0], 3.0, 40.0, (64, 48))
    positions = np.array([camera.position for camera in cameras])
    assert np.allclose(np.linalg.norm(positions, axis=1), 3.0) and np.allclose(positions[::2].sum(axis=0), 0.0)
    assert np.allclose(positions[1::2, 1], 1.5) and np.allclose(positions[0], (0, 0, 3))


@pytest.mark.parametrize(("changes", "message"), [
    (dict(fx=0.0), "fx is 0.0"), (dict(cy=np.nan), "cy is nan"), (dict(width=0), "width is 0"),
    (dict(near=-1.0), "near is -1.0"), (dict(far=0.01), "far is 0.01"), (dict(world_to_camera=np.eye(3)), r"shape \(3, 3\)"),
    (dict(world_to_camera=np.diag([2.0, 2, 2, 1])), "not rigid: its rotation is 3 away"),
    (dict(world_to_camera=np.diag([1.0, 1, -1, 1])), "mirrors"),
    (dict(world_to_camera=np.eye(4) + np.eye(4, k=-3)), "last row"),
    (dict(fx=1e39), "fx is 1e.39; .*finite in fp32"), (dict(cx=-1e39), "cx is -1e.39; it must be finite in fp32"),
    (dict(near=1e-50), "near is 1e-50; it must be above 0"), (dict(far=1e300), "far is 1e.300"),
    (dict(world_to_camera=np.eye(4) + 1e39 * np.eye(4, k=3)), r"value 1e\+39 in row 0, column 3"),
    (dict(fx=3e38, width=1), r"beyond the range of fp32 \(row 0, column 0\)"),
    (dict(fx=1e30, world_to_camera=np.eye(4) + 1e30 * np.eye(4, k=3)), r"row 0, column 3\); bring the pose"),
])
def test_a_malformed_camera_is_refused(changes, message):
    with pytest.raises(InputError, match=message):
        camera_at(**changes)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-7, 0.5, 2.0, np.pi - 1e-7, np.pi])
def test_rotation_vectors_go_there_and_back(angle):
    for axis in np.concatenate([np.eye(3), np.random.default_rng(3).normal(size=(20, 3))]):
        rotvec = axis / np.linalg.norm(axis) * angle
        matrix = rotation_matrix(rotvec)
        assert np.allclose(matrix @ matrix.T, np.eye(3), atol=1e-14)
        back = rotation_vector(matrix)
        assert np.allclose(rotation_matrix(back), matrix, atol=1e-13)
        assert np.allclose(back, rotvec, rtol=1e-6, atol=1e-14) or angle == np.pi  # at pi both axes are right
    assert np.allclose(rotation_matrix((0, 0, np.pi / 2)) @ (1, 0, 0), (0, 1, 0))


# Views


def test_srgb_is_the_standard_curve():
    x = np.linspace(0.0, 1.0, 1001)
    assert np.allclose(linear_to_srgb(srgb_to_linear(x)), x, atol=1e-7)
    assert np.isclose(srgb_to_linear(np.array(0.5)), 0.21404114) and np.isclose(linear_to_srgb(np.array(0.0031308)), 0.0404499)
    assert srgb_to_linear(x.astype(np.float32)).dtype == np.float32


def test_a_data_set_comes_back_as_it_was_written(folder):
    views = load_views(folder)
    assert len(views) == 2 and views.images.shape == (2, 6, 8, 4) and views.images.dtype == np.float32
    assert np.allclose(views.images[1], 0.8) and views.names == ("000", "001")
    for camera, expected in zip(views.cameras, orbit(2, [20.0], 3.0, 40.0, (8, 6)), strict=True):
        assert np.allclose(camera.clip_rows(), expected.clip_rows())


def test_frame_values_win_and_angles_are_horizontal(folder):
    def change(document):
        for key in ("fl_x", "fl_y", "cx", "cy"):
            del document[key]
        document["camera_angle_x"] = np.pi / 2
        document["frames"][1] |= {"fl_x": 9.0, "fl_y": 10.0, "cx": 1.0, "cy": 2.0, "w": 8, "h": 6}
    first, second = load_views(edited(folder, change) / "transforms.json").cameras
    assert np.allclose((first.fx, first.fy, first.cx, first.cy), (4.0, 4.0, 4.0, 3.0))
    assert (second.fx, second.fy, second.cx, second.cy) == (9.0, 10.0, 1.0, 2.0)


@pytest.mark.parametrize(("change", "message"), [
    (lambda d: d.update(frames=[]), "has no frames"),
    (lambda d: d.pop("frames"), "has no frames"),
    (lambda d: d["frames"][1].pop("transform_matrix"), "frame 1 needs a file_path and a transform_matrix"),
    (lambda d: d["frames"][1].update(file_path="images/lost"), "frame 1: image file .*lost does not exist"),
    (lambda d: d["frames"][1].update(transform_matrix=[[1, 0], [0, 1]]), r"frame 1 .*shape \(2, 2\)"),
    (lambda d: d["frames"][0].update(transform_matrix=[[1, 2], [3]]), "frame 0 .*not a 4 x 4 matrix"),
    (lambda d: d["frames"][0]["transform_matrix"][0].__setitem__(0, 3.0), "frame 0 .*not rigid: its rotation is"),
    (lambda d: d["frames"][0]["transform_matrix"][2].__setitem__(3, float("nan")), "value nan in row 2, column 3"),
    (lambda d: [d.pop("fl_x"), d.pop("fl_y")], "neither camera_angle_x nor fl_x"),
    (lambda d: d.update(fl_x="wide"), "fl_x is 'wide'"),
    (lambda d: d.update(fl_x=-3), "fl_x is -3"),
    (lambda d: [d.pop("fl_x"), d.update(camera_angle_x=40.0)], "camera_angle_x is 40.0; it must be between 0 and pi"),
    (lambda d: d.update(k5=0.3), "lens distortion k5 is 0.3; without a camera_model, k1 k2 k3 p1 p2 are read; name the right model"),
    (lambda d: d.update(k4=0.3, camera_model="OPENCV"), "lens distortion k4 is 0.3; with camera_model OPENCV, k1 k2 k3 p1 p2 are read"),
    (lambda d: d["frames"][1].update(camera_model="PINHOLE", p2=-1e-9), "frame 1: lens distortion p2 is -1e-09; .*PINHOLE, none is read"),
    (lambda d: d.update(camera_model="OPENCV_FISHEYE", p1=0.1), "p1 is 0.1; with camera_model OPENCV_FISHEYE, k1 k2 k3 k4 are read"),
    (lambda d: d.update(k1="much"), "k1 is 'much'; it must be a finite number"),
    (lambda d: d.update(distortion_params=[0, 0.1]), r"distortion_params is \[0, 0.1\]"),
    (lambda d: d["frames"][1].update(camera_model="EQUIRECTANGULAR"), "frame 1: camera_model is 'EQUIRECTANGULAR'; allowed: PINHOLE"),
    (lambda d: d.update(camera_model=7), "camera_model is 7"),
    (lambda d: d.update(equirectangular=True), "equirectangular is True; cameras of one lens and one moment are read"),
    (lambda d: d.update(fisheye_crop_radius=1000.0), "fisheye_crop_radius is 1000.0"),
    (lambda d: d["frames"][0].update(ftheta_p1=0.5), "ftheta_p1 is 0.5"),
    (lambda d: d.update(rolling_shutter=[0.0, 0.0, 0.02]), "rolling_shutter is"),
    (lambda d: d["frames"][0].update(mask_path="m.png"), "frame 0: mask file .*m.png does not exist"),
    (lambda d: d["frames"][0].update(mask_path=["m.png"]), "frame 0: its mask's path is"),
    (lambda d: d.update(white_transparent=True), "white_transparent is not read"),
    (lambda d: d.update(K=[[9, 0, 4], [0, 9, 3], [0, 0, 1]]), "K is not read: intrinsics are read from fl_x"),
    (lambda d: d.update(fl_X=9), "fl_X is an unknown key; did you mean fl_x"),
    (lambda d: d["frames"][1].update(pose=1), "frame 1: pose is an unknown key"),
    (lambda d: d["frames"][1].update(fl_x=10 ** 400), "frame 1: fl_x is inf; it must be a finite number"),
    (lambda d: d.update(x_fov=190), "x_fov is 190; it must be between 0 and 180"),
    (lambda d: d.update(train_filenames=["other.png"]), "train_filenames names none of the 2 frames"),
    (lambda d: d.update(train_filenames="000"), "train_filenames is '000'; a list"),
    (lambda d: d.update(w="8"), "w is '8'; it must be a finite number"),
    (lambda d: d["frames"][0].update(file_path="a" * 5000), "does not exist"),
    (lambda d: d["frames"][0].update(file_path="a\0b"), "does not exist"),
    (lambda d: d["frames"][0].update(file_path="\ud800"), "half a surrogate pair"),
    (lambda d: d.update(up=[[[1] * 3]] * 3, aabb=eval("[" * 40 + "]" * 40)), "nests deeper than 32 levels"),
    (lambda d: d.update(w=16), "states 16x6 pixels, but .*000.png has 8x6"),
    (lambda d: d.update(w=16, h=9), "states 16x9 pixels, but .*000.png has 8x6"),
])
def test_a_malformed_transforms_file_is_named(folder, change, message):
    with pytest.raises(InputError, match=message) as caught:
        load_views(edited(folder, change))
    assert "transforms.json" in str(caught.value) and "\n" not in str(caught.value)


def test_keys_that_change_nothing_or_are_applied_are_taken(folder):
    """What the usual tools write for a pinhole without distortion."""
    plain = load_views(folder)

    def change(document):
        document |= {"camera_model": "OPENCV", "k1": 0, "k2": 0.0, "p1": 0.0, "is_fisheye": False, "aabb_scale": 16, "w": 8, "h": 6.0,
                     "applied_transform": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]], "ply_file_path": "sparse.ply", "scale": 0.33,
                     "distortion_params": [0, 0, 0, 0], "mask_path": None}
        for frame in document["frames"]:
            frame |= {"sharpness": float("nan"), "rotation": 0.1, "colmap_im_id": 10 ** 30, "depth_file_path": "d.png"}

    found = load_views(edited(folder, change))
    assert all(np.array_equal(a.clip_rows(), b.clip_rows()) for a, b in zip(plain.cameras, found.cameras, strict=True))
    wide = load_views(edited(folder, lambda d: [d.pop("fl_x"), d.pop("fl_y"), d.update(x_fov=90.0)]))
    assert np.isclose(wide.cameras[0].fx, 4.0) and np.isclose(wide.cameras[0].fy, 4.0)
    assert load_views(edited(folder, lambda d: d.update(train_filenames=["./001"]))).names == ("001",)


def test_a_byte_order_mark_is_no_mistake(folder):
    file = folder / "transforms.json"
    file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes())
    assert len(load_views(folder)) == 2


def test_a_scene_that_moves_is_noted(folder):
    with pytest.warns(InputWarning, match="different times"):
        load_views(edited(folder, lambda d: [frame.update(time=k) for k, frame in enumerate(d["frames"])]))


@pytest.mark.parametrize(("text", "message"), [
    ("[" * 100_000, "nests deeper than 32"), ("{" * 100_000, "malformed"),
    ('{"frames": ' + "[" * 50 + "]" * 50 + "}", "nests deeper than 32"),
    ('{"a": ' + "9" * 5000 + "}", "has no frames"), ('{"frames": NaN}', "has no frames"), ('{"\\ud800": 1}', "half a surrogate pair"),
    ('"frames"', "has no frames"), ("\0", "malformed"), ("", "malformed")])
def test_no_text_is_too_odd_for_one_line(folder, text, message):
    (folder / "transforms.json").write_text(text)
    with pytest.raises(InputError, match=message):
        load_views(folder)


def test_malformed_json_is_named_by_line(folder):
    (folder / "transforms.json").write_text('{\n "frames": [\n  {]\n}')
    with pytest.raises(InputError, match="transforms.json line 3 column 4: malformed JSON"):
        load_views(folder)
    (folder / "transforms.json").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="not UTF-8"):
        load_views(folder)


def test_missing_files_are_named(folder, tmp_path):
    with pytest.raises(InputError, match="lost.json does not exist"):
        load_views(folder / "lost.json")
    (tmp_path / "empty").mkdir()
    for load, message in ((load_views, "has no transforms_train.json"), (load_images, "no image in")):
        with pytest.raises(InputError, match=message):
            load(tmp_path / "empty")
    with pytest.raises(InputError, match="image file lost.png does not exist"):
        load_images(["lost.png"])
    with pytest.raises(InputError, match="image directory .*lost does not exist"):
        load_images(tmp_path / "lost")


def test_images_need_alpha_one_size_and_to_be_images(folder):
    Image.new("RGB", (8, 6)).save(folder / "001.png")
    with pytest.raises(InputError, match=r"001.png has no alpha channel \(mode RGB\); alpha is the mask"):
        load_views(folder)
    Image.new("RGBA", (9, 6)).save(folder / "001.png")
    with pytest.raises(InputError, match="001.png is 9x6, but .*000.png is 8x6"):
        load_images(folder)
    (folder / "001.png").write_bytes((folder / "000.png").read_bytes()[:40])
    with pytest.raises(InputError, match="001.png cannot be read"):
        load_views(folder)


def test_pictures_of_a_directory_come_as_people_count(tmp_path):
    for k in (10, 9, 2, 1, 100):
        save_png(tmp_path / f"img{k}.png", np.full((6, 8, 4), k / 100))
    images, names = load_images(tmp_path)
    assert names == ("img1", "img2", "img9", "img10", "img100") and np.allclose(images[:, 0, 0, 0], (0.01, 0.02, 0.09, 0.1, 1), atol=0.002)
    order = sorted(["b2", "a10", "a2", "A3", "a2b10", "a2b9", "7", "07", "", "a"], key=natural)
    assert order == ["", "07", "7", "a", "a2", "a2b9", "a2b10", "A3", "a10", "b2"]


@pytest.mark.parametrize(("files", "names"), [
    (["a/0.png", "a/1.png"], ("0", "1")), (["cam0/0001.png", "cam1/0001.png"], ("cam0/0001", "cam1/0001")),
    (["r/cam0/img/1.png", "r/cam1/img/1.png", "r/cam1/img/2.png"], ("cam0/img/1", "cam1/img/1", "cam1/img/2")),
    (["a.png", "a.webp"], ("a.png", "a.webp")), (["a.png", "a.png", "b.png"], ("a.png", "a.png (2)", "b.png")),
    (["x\udcff.png"], ("x?",))])
def test_every_picture_has_a_name_of_its_own(files, names):
    assert names_of([Path(file) for file in files]) == names


def test_a_rig_loses_no_camera(folder):
    for name in ("cam0", "cam1"):
        (folder / name).mkdir()
    for k in (0, 1):
        (folder / f"00{k}.png").rename(folder / f"cam{k}" / "0001.png")
    views = load_views(edited(folder, lambda d: [f.update(file_path=f"cam{k}/0001.png") for k, f in enumerate(d["frames"])]))
    assert views.names == ("cam0/0001", "cam1/0001") and np.allclose(views.images[1], 0.8)
    with pytest.raises(InputError, match="no image in .*; its folders have 2: give a list of files"):
        load_images(folder)


@pytest.mark.parametrize(("size", "message"), [
    ((1 << 14, 1 << 13), r"image .*big.png is 16384x8192; at most 67108864 pixels are allowed, such as 8192x8192"),
    ((1 << 14, 1 << 14), r"big.png is 16384x16384; at most")])
def test_a_picture_too_large_is_named_with_its_size(tmp_path, size, message):
    picture = Image.new("P", (1, 1))
    picture.save(tmp_path / "big.png")
    data = bytearray((tmp_path / "big.png").read_bytes())
    data[16:24] = struct.pack(">II", *size)  # the header says so; no decoder gets to see that there is no more
    data[29:33] = struct.pack(">I", zlib.crc32(bytes(data[12:29])))
    (tmp_path / "big.png").write_bytes(data)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for load in (lambda: load_images([tmp_path / "big.png"]), lambda: load_texture(tmp_path / "big.png")):
            with pytest.raises(InputError, match=message.replace("image", "(image|texture)")):
                load()
    assert Image.MAX_IMAGE_PIXELS, "the library's own bound is as it was"


def test_a_check_of_sizes_comes_before_any_pixel(folder):
    def refuse(count, width, height):
        raise InputError(f"{count} of {width}x{height}")

    (folder / "001.png").write_bytes((folder / "001.png").read_bytes()[:60])  # a header and nothing to decode
    for size, told in ((None, "2 of 8x6"), ((4, 3), "2 of 4x3")):
        with pytest.raises(InputError, match=told):
            load_views(folder, size, fits=refuse)


def test_images_of_a_directory_come_by_name(folder):
    images, names = load_images(folder)
    assert names == ("000", "001") and np.allclose(images[:, 0, 0, 0], (0.2, 0.8))
    with pytest.raises(InputError, match="2 images, 1 cameras"):
        Views(images, orbit(1, [0.0], 3.0, 40.0, (8, 6)), names)
    with pytest.raises(InputError, match="camera of 6x8 pixels and an image of 8x6"):
        Views(images, orbit(2, [0.0], 3.0, 40.0, (6, 8)), names)


def test_two_views_of_one_name_are_refused(folder):
    images, _ = load_images(folder)
    with pytest.raises(InputError, match="two views are called 'a'; give each a name of its own"):
        Views(images, orbit(2, [0.0], 3.0, 40.0, (8, 6)), ("a", "a"))


def a_set(folder, count=9, size=(33, 21), seed=5):
    """Files of random RGBA pictures, and what they hold."""
    rng = np.random.default_rng(seed)
    pixels = rng.integers(0, 256, (count, *size[::-1], 4), np.uint8)
    for k, image in enumerate(pixels):
        Image.fromarray(image).save(folder / f"{k}.png")
    return [folder / f"{k}.png" for k in range(count)], pixels


def test_pictures_in_files_are_as_good_as_an_array(tmp_path):
    files, pixels = a_set(tmp_path)
    seen = []
    images, _ = load_images(files, told=lambda *x: seen.append(x))
    floats = pixels.astype(np.float32) / np.float32(255.0)
    assert seen == [(k, 9) for k in range(1, 10)] and images.bits == 8 and images.rows(3).dtype == np.uint8
    assert np.asarray(images).dtype == np.float32 and np.array_equal(images, floats) and np.array_equal(images[-2], floats[-2])
    assert np.array_equal(images[1:4, ..., 3], floats[1:4, ..., 3]) and all(map(np.array_equal, images, floats)) and len(images) == 9
    light = np.concatenate([srgb_to_linear(floats[..., :3]), floats[..., 3:]], -1)
    assert np.array_equal(images.as_linear(), light) and np.array_equal(images, floats), "the one is not the other"
    with pytest.raises(IndexError, match="picture 9 of 9"):
        images[9]


@pytest.mark.parametrize("size", [(33, 21), (11, 7), (16, 10), (1, 1), (32, 3)])
def test_pictures_are_averaged_as_they_are_read(tmp_path, size):
    """Against the definition: how much of each pixel lies in each of the new ones, in float64."""
    files, pixels = a_set(tmp_path)
    images, _ = load_images(files, size=size)
    floats = pixels / 255.0
    light = np.concatenate([srgb_to_linear(floats[..., :3]) * floats[..., 3:], floats[..., 3:]], -1)
    for axis, n, m in ((1, 21, size[1]), (2, 33, size[0])):
        low, high = np.arange(m)[:, None] * n / m, (np.arange(m)[:, None] + 1) * n / m
        part = np.clip(np.minimum(high, np.arange(n) + 1) - np.maximum(low, np.arange(n)), 0.0, None) * m / n
        light = np.moveaxis(np.tensordot(part, light, (1, axis)), 0, axis)
    wanted = np.concatenate([linear_to_srgb(light[..., :3] / np.maximum(light[..., 3:], 1e-12)), light[..., 3:]], -1)
    if size == (33, 21):
        assert images.bits == 8 and np.array_equal(images, pixels / np.float32(255.0))
    else:
        assert images.bits == 32 and np.allclose(images, wanted, atol=2e-7)
        assert np.array_equal(images[2], downsampled(np.asarray(pixels[2] / np.float32(255.0), np.float32), size)), "8 bits or float"


@pytest.mark.parametrize("size", [(40, 30), (20, 15), (33, 17), (7, 30), (1, 1)])
@pytest.mark.parametrize("filled", [None, (0, 60, 0, 80), (13, 14, 31, 32), (0, 1, 0, 1), (59, 60, 79, 80), (20, 47, 33, 61)])
def test_what_is_empty_is_left_out_and_changes_nothing(size, filled):
    """Of 80x60 pixels those in some rows and columns: what is averaged of all of them, to the bit, and zero where nothing is near."""
    rng = np.random.default_rng(5)
    image, full = np.zeros((60, 80, 4), np.uint8), rng.integers(0, 256, (60, 80, 4), np.uint8)
    if filled is not None:
        r0, r1, c0, c1 = filled
        image[r0:r1, c0:c1] = np.maximum(full[r0:r1, c0:c1], 1)
    found = downsampled(image, size)
    assert found.dtype == np.float32 and found.shape == (size[1], size[0], 4) and np.isfinite(found).all()
    seen = image.copy()
    seen[..., 3] = np.maximum(seen[..., 3], 1)  # nothing can be left out now, and the rest weighs next to nothing
    assert np.allclose(downsampled(seen, size)[..., 3], found[..., 3], atol=1.1 / 255.0)
    light = srgb_to_linear(image[..., :3] / 255.0) * (image[..., 3:] / 255.0)
    kept = srgb_to_linear(found[..., :3].astype(float)) * found[..., 3:]
    assert np.allclose(kept.mean((0, 1)), light.mean((0, 1)), atol=1e-6) and np.isclose(found[..., 3].mean(), image[..., 3].mean() / 255.0)
    if filled is not None:
        far = [slice(0, r0 * size[1] // 60), slice(-(-r1 * size[1] // 60), None)]
        assert all((found[rows] == 0.0).all() for rows in far)
    assert (found[..., :3][found[..., 3] == 0.0] == 0.0).all()


def test_masks_are_known_of_files_and_of_arrays(tmp_path):
    files, pixels = a_set(tmp_path)
    pixels[..., 3] = 0
    pixels[1, 3:9, 5:20, 3], pixels[2, ..., 3], pixels[3, ..., 3] = 128, 255, 127
    for file, image in zip(files, pixels):
        Image.fromarray(image).save(file)
    images, names = load_images(files)
    cams = orbit(9, [0.0], 3.0, 40.0, (33, 21))
    masks = Views(images, cams, names).masks
    assert masks == Views(np.asarray(images), cams, names).masks
    assert masks[1].box == (5, 3, 20, 9) and masks[2].full and masks[2].border and masks[3].box is None and masks[0].highest == 0.0
    assert masks[3].highest == pytest.approx(127 / 255)


def test_a_picture_that_changes_while_it_is_used_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr("dressi_edge.compiler.io.pictures.KEPT_BYTES", 3 * 33 * 21 * 4)
    files, pixels = a_set(tmp_path)
    images, _ = load_images(files)
    assert np.array_equal(images, pixels / np.float32(255.0)), "those that are not kept are read again"
    Image.fromarray(pixels[0]).save(files[7])
    with pytest.raises(InputError, match="image .*7.png has changed since it was read; leave pictures alone while they are used"):
        np.asarray(images)
    files[5].unlink()
    with pytest.raises(InputError, match=r"image file .*5.png cannot be read: No such file"):
        images[5]


def test_the_first_of_several_broken_pictures_is_named(tmp_path):
    files, _ = a_set(tmp_path)
    for k in (4, 6):
        files[k].write_bytes(files[k].read_bytes()[:120])
    before = Image.MAX_IMAGE_PIXELS
    with pytest.raises(InputError, match="4.png cannot be read"):
        load_images(files)
    assert Image.MAX_IMAGE_PIXELS == before != None  # noqa: E711  (both)


def test_downsampling_keeps_light_coverage_and_geometry():
    image = np.zeros((4, 6, 4), np.float32)
    image[:, 0] = (1.0, 0.5, 0.0, 1.0)
    image[:, 1, :3] = 0.9  # a colour that nothing covers must not bleed in
    views = Views(image[None], (camera_at(width=6, height=4),), ("a",))
    small = views.resized((3, 2))
    assert np.allclose(small.images[0, :, 0], (1.0, 0.5, 0.0, 0.5), atol=1e-6) and not small.images[0, :, 1:].any()
    odd = views.resized((4, 3))
    assert np.isclose(odd.images[..., 3].mean(), image[..., 3].mean()), "no coverage is lost at ratios that are not whole"
    assert (small.cameras[0].fx, small.cameras[0].cy) == (20.0, 10.0)
    before, after = (v.cameras[0].clip_rows() @ (0.3, 0.2, -2.0, 1.0) for v in (views, small))
    assert np.allclose(before, after)
    with pytest.raises(InputError, match="size 7x4"):
        views.resized((7, 4))


# glTF cameras


GLTF = {
    "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
    "nodes": [{"children": [1], "scale": [2, 2, 2], "translation": [1, 0, 0]},
              {"camera": 0, "translation": [0, 0, 3], "rotation": [0, 0.7071067811865476, 0, 0.7071067811865476]}],
    "cameras": [{"type": "perspective", "perspective": {"yfov": np.pi / 2, "znear": 0.1}}],
}


@pytest.mark.parametrize("suffix", [".gltf", ".glb"])
def test_gltf_cameras_have_world_transforms(tmp_path, suffix):
    text = json.dumps(GLTF).encode()
    text += b" " * (-len(text) % 4)
    header = struct.pack("<4sII", b"glTF", 2, 20 + len(text)) + struct.pack("<I4s", len(text), b"JSON")
    (tmp_path / f"c{suffix}").write_bytes(text if suffix == ".gltf" else header + text)
    (camera,) = gltf_cameras(tmp_path / f"c{suffix}", 64, 48)[0]
    assert np.allclose(camera.position, (1, 0, 6)) and np.isclose(camera.fx, 24.0) and np.isclose(camera.fy, 24.0)
    assert np.allclose(camera.camera_to_world[:3, 2], (1, 0, 0)) and (camera.near, camera.far) == (0.1, 100.0)


def test_orthographic_gltf_cameras_span_twice_ymag(tmp_path):
    document = json.loads(json.dumps(GLTF))
    document["cameras"] = [{"type": "orthographic", "orthographic": {"xmag": 4.0, "ymag": -3.0, "znear": 0, "zfar": 20.0}}]
    (tmp_path / "c.gltf").write_text(json.dumps(document))
    (camera,) = gltf_cameras(tmp_path / "c.gltf", 64, 48)[0]
    assert (camera.kind, camera.fx, camera.fy, camera.near, camera.far) == ("orthographic", 8.0, 8.0, 0.0, 20.0)


def gltf_scene(nodes):
    return GLTF | {"nodes": [{"camera": 0, "translation": [k, 0, 3], **more} for k, more in enumerate(nodes)],
                   "scenes": [{"nodes": list(range(len(nodes)))[::-1]}]}


def test_gltf_cameras_come_in_order_of_the_scene_and_go_to_pictures_of_their_names(folder):
    file = folder / "c.gltf"
    file.write_text(json.dumps(gltf_scene([{"name": "right"}, {"name": "left"}])))
    cameras, names = gltf_cameras(file, 8, 6)
    assert names == ("left", "right") and [c.position[0] for c in cameras] == [1, 0]
    assert [c.position[0] for c in load_gltf_views(file, folder).cameras] == [1, 0], "pictures 000, 001: by order"
    file.write_text(json.dumps(gltf_scene([{"name": "000"}, {"name": "001"}])))
    views = load_gltf_views(file, folder, (4, 3))
    assert [c.position[0] for c in views.cameras] == [0, 1] and views.names == ("000", "001") and views.images.shape == (2, 3, 4, 4)


def test_an_aspect_ratio_of_other_pictures_is_noted(tmp_path):
    document = json.loads(json.dumps(GLTF))
    document["cameras"][0]["perspective"]["aspectRatio"] = 2.0
    (tmp_path / "c.gltf").write_text(json.dumps(document))
    with pytest.warns(InputWarning, match="aspect ratio 2, but the pictures are 64x48"):
        gltf_cameras(tmp_path / "c.gltf", 64, 48)


@pytest.mark.parametrize(("change", "message"), [
    (lambda d: d["scenes"][0].update(nodes=[-1]), "not well-formed"), (lambda d: d.update(scene=-1), "not well-formed"),
    (lambda d: d["nodes"][1].update(camera="0"), "not well-formed"), (lambda d: d["nodes"][1].update(translation=[1e400] * 3), "transform"),
    (lambda d: d["cameras"][0]["perspective"].update(yfov=10 ** 400), "field of view"),
    (lambda d: d["cameras"][0]["perspective"].update(znear=None), "not well-formed"),
    (lambda d: d.update(nodes=[{}]), "no camera"), (lambda d: d["nodes"][0].update(children=[7]), "not well-formed"),
    (lambda d: d["nodes"][1].update(children=[0]), "must form a tree"), (lambda d: d.pop("cameras"), "not well-formed"),
    (lambda d: d["cameras"][0].update(type="fisheye"), "type 'fisheye'; perspective and orthographic cameras are supported"),
    (lambda d: d["cameras"][0].update(type="orthographic"), "not well-formed"),
    (lambda d: d["cameras"][0].update(type="orthographic", orthographic={"xmag": 1, "ymag": 0, "znear": 0, "zfar": 9}), "the ymag 0;"),
    (lambda d: d["nodes"][1].update(scale=[1, 1, 0]), "world transform"),
])
def test_malformed_gltf_cameras_are_named(tmp_path, change, message):
    document = json.loads(json.dumps(GLTF))
    change(document)
    (tmp_path / "c.gltf").write_text(json.dumps(document))
    with pytest.raises(InputError, match=message):
        gltf_cameras(tmp_path / "c.gltf", 64, 48)


def test_truncated_glb_is_named(tmp_path):
    (tmp_path / "c.glb").write_bytes(b"glTF\x02\x00\x00\x00")
    with pytest.raises(InputError, match="truncated"):
        gltf_cameras(tmp_path / "c.glb", 64, 48)


# Meshes, textures, cameras and images together


def test_images_show_the_texture_where_the_cameras_say(tmp_path):
    mesh, cameras = pear(), orbit(3, [10.0, -35.0, 50.0], 3.2, 40.0, (48, 40))
    views = load_views(write_views(tmp_path, [photograph(mesh, camera) for camera in cameras], cameras))
    for view in range(3):
        error, coverage = misfit(mesh, views, view)
        assert error < 0.02 and coverage > 0.97
    if not (SHARED / "datasets" / "spot").is_dir():
        pytest.skip("shared data not present; photographs of the pear were tested in their place")
    spot = normalize(load_mesh(SHARED / "meshes" / "spot" / "spot.obj", SHARED / "meshes" / "spot" / "spot_texture.png"))
    true = load_mesh(SHARED / "datasets" / "spot" / "mesh.ply")
    assert np.allclose(spot.positions.max(axis=0), true.positions.max(axis=0), atol=1e-3)
    views = load_views(SHARED / "datasets" / "spot")
    for view in range(0, 24, 6):
        error, coverage = misfit(spot, views, view)
        assert error < 0.01 and coverage > 0.99
    assert len(load_views(SHARED / "datasets" / "bunny_lambert" / "transforms_test.json", size=(64, 64))) == 6
