"""Lenses: what a bent picture shows is, once straightened, where the pinhole has it; against points projected by OpenCV's formulas as they
are written, and rays cast through an equidistant fisheye."""

import json
import warnings
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from dressi_edge.cache.errors import InputError, InputWarning
from dressi_edge.compiler.io.cameras import look_at, orbit
from dressi_edge.compiler.io.decode import Masks
from dressi_edge.compiler.io.lens import Lens, beyond, straightened
from dressi_edge.compiler.io.views import load_views

SHARED = Path(__file__).resolve().parents[2] / "shared"
W, H, F = 120, 90, 80.0
BARREL = {"k1": -0.21, "k2": 0.06, "k3": -0.01, "p1": 0.004, "p2": -0.006}


def bent(point, kind, c):
    """Column and row of a point (x right, y down, z forward), as OpenCV's documentation writes it, without distances squared."""
    x, y = point[0] / point[2], point[1] / point[2]
    k = [c.get(f"k{n}", 0.0) for n in range(1, 7)]
    if kind == "fisheye":
        r = (x * x + y * y) ** 0.5
        t = np.arctan(r)
        scale = (t + k[0] * t ** 3 + k[1] * t ** 5 + k[2] * t ** 7 + k[3] * t ** 9) / r
        return F * scale * x + W / 2, F * scale * y + H / 2
    r2 = x ** 2 + y ** 2
    c1 = (1 + k[0] * r2 + k[1] * r2 ** 2 + k[2] * r2 ** 3) / (1 + k[3] * r2 + k[4] * r2 ** 2 + k[5] * r2 ** 3)
    p1, p2 = c.get("p1", 0.0), c.get("p2", 0.0)
    return (F * (x * c1 + 2 * p1 * x * y + p2 * (r2 + 2 * x ** 2)) + W / 2, F * (y * c1 + p1 * (r2 + 2 * y ** 2) + 2 * p2 * x * y) + H / 2)


def spots(places, radius=2.5):
    """A picture of soft white spots on black, all of it object."""
    y, x = np.mgrid[:H, :W] + 0.5
    image = np.full((H, W, 4), 255.0)
    image[..., :3] = sum(255.0 * np.exp(-((x - u) ** 2 + (y - v) ** 2) / radius ** 2) for u, v in places)[..., None].clip(0, 255)
    return np.rint(image).astype(np.uint8)


KINDS = [("opencv", BARREL), ("opencv", {"k1": 0.3, "k2": 0.1}), ("opencv", {"k1": 0.1, "k2": 0.02, "k4": 0.3, "k5": 0.05, "k6": 0.01}),
         ("fisheye", {}), ("fisheye", {"k1": 0.05, "k2": -0.02, "k3": 0.004, "k4": -0.001})]


@pytest.mark.parametrize("kind, c", KINDS)
def test_a_straightened_picture_shows_points_where_a_pinhole_does(kind, c):
    points = [(x, y, 1.0) for x in (-0.5, -0.2, 0.13, 0.44) for y in (-0.37, 0.05, 0.31)]
    lens = Lens(F, F, W / 2, H / 2, kind, tuple(c.get(f"k{n}", 0.0) for n in range(1, 5 if kind == "fisheye" else 7)),
                (c.get("p1", 0.0), c.get("p2", 0.0)))
    seen = spots([bent(p, kind, c) for p in points])
    found = straightened(seen, lens)
    y, x = np.mgrid[:H, :W] + 0.5
    for p in points:
        u, v = F * p[0] + W / 2, F * p[1] + H / 2
        weight = found[..., 0].astype(float) * ((x - u) ** 2 + (y - v) ** 2 < 25)
        centre = np.array([(weight * x).sum(), (weight * y).sum()]) / weight.sum()
        assert np.abs(centre - (u, v)).max() < 0.25, (p, centre, (u, v))  # a spot's middle moves where its sides are stretched unlike
    assert max(np.hypot(*np.subtract(bent(p, kind, c), (F * p[0] + W / 2, F * p[1] + H / 2))) for p in points) > 1.0, "the lens bends"
    alpha = found[..., 3]
    assert set(np.unique(alpha)) <= {0, 255} and np.isclose(beyond(lens, W, H), (alpha == 0).mean(), atol=0.01)
    assert (alpha[0, 0] == 0) == (bent(((0.5 - W / 2) / F, (0.5 - H / 2) / F, 1.0), kind, c)[0] < 0)


def test_skew_is_taken_out():
    seen = spots([(F * x + 7.0 * y + W / 2, F * y + H / 2) for x, y in ((0.3, 0.4), (-0.2, -0.3))])
    found = straightened(seen, Lens(F, F, W / 2, H / 2, skew=7.0))
    expected = spots([(F * x + W / 2, F * y + H / 2) for x, y in ((0.3, 0.4), (-0.2, -0.3))])
    assert np.abs(found[..., 0].astype(int) - expected[..., 0])[found[..., 3] > 0].max() < 40


def test_nothing_of_a_lens_is_shown_twice():
    """r (1 - r^2) turns back at 0.577; further out the formula shows the middle again."""
    lens = Lens(F, F, W / 2, H / 2, "opencv", (-1.0,))
    assert np.isclose(lens.reach(1.0), 3 ** -0.5, atol=1e-3) and Lens(F, F, 0, 0, "opencv", (0.735,)).reach(3.0) == 3.0
    found = straightened(np.full((H, W, 4), 255, np.uint8), lens)
    y, x = np.mgrid[:H, :W] + 0.5
    r = np.hypot(x - W / 2, y - H / 2) / F
    assert (found[r < 0.57, 3] == 255).all() and (found[r > 0.585, 3] == 0).all()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert not straightened(np.full((4, 4, 4), 255, np.uint8), Lens(1.0, 1.0, 0.0, 0.0, "opencv", (1e300, -1e300))).any()


def test_what_is_no_object_lends_no_colour():
    image = np.zeros((H, W, 4), np.uint8)
    image[..., :3] = (0, 255, 0)
    image[30:60, 40:80] = (200, 100, 50, 255)
    found = straightened(image, Lens(F, F, W / 2, H / 2, "opencv", (-0.2, 0.05)))
    inside = found[found[..., 3] > 0]
    assert len(inside) > 900 and np.abs(inside[:, :3].astype(int) - (200, 100, 50)).max() <= 1


BOX = np.array([[x, y, z] for x in (-0.8, 0.8) for y in (-0.64, 0.64) for z in (-0.8, 0.8)])


def rays_of_box(camera, directions):
    """Whether rays (h, w, 3) in camera space (y up, -z forward) meet the box: slabs."""
    d = directions @ camera.world_to_camera[:3, :3]
    with np.errstate(divide="ignore"):
        a, b = ((side - camera.position) / d for side in (BOX.min(0), BOX.max(0)))
    near, far = np.minimum(a, b).max(-1), np.maximum(a, b).min(-1)
    return (near <= far) & (far > 0)


@pytest.mark.parametrize("said", [{"camera_model": "OPENCV_FISHEYE", "k1": 0.0}, {"is_fisheye": True},
                                  {"camera_model": "OPENCV_FISHEYE", "k1": 0.05, "k2": -0.01}])
def test_photographs_of_a_fisheye_become_those_of_a_pinhole(tmp_path, said):
    """An equidistant lens, as its tools say it in their files: the masks of a box agree with the pinhole's rays to a pixel at the rim."""
    size, f, frames, bent_masks = 160, 70.0, [], []
    cameras = orbit(4, [20.0], 2.6, 2 * np.degrees(np.arctan(size / 2 / f)), (size, size))
    y, x = np.mgrid[:size, :size] + 0.5 - size / 2
    theta = np.linspace(0, 1.5, 4000)
    bend = theta * (1 + said.get("k1", 0.0) * theta ** 2 + said.get("k2", 0.0) * theta ** 4)
    t = np.interp(np.hypot(x, y) / f, bend, theta)
    s = np.sin(t) / np.maximum(np.hypot(x, y), 1e-9)
    for k, camera in enumerate(cameras):
        hit = rays_of_box(camera, np.stack([x * s, -y * s, -np.cos(t)], -1))
        bent_masks.append(hit)
        Image.fromarray(np.dstack([np.full((size, size, 3), 128), hit * 255]).astype(np.uint8)).save(tmp_path / f"{k}.png")
        frames.append({"file_path": f"{k}.png", "transform_matrix": camera.camera_to_world.tolist()})
    (tmp_path / "transforms.json").write_text(json.dumps({"fl_x": f, "fl_y": f, "w": size, "h": size, **said, "frames": frames}))
    with pytest.warns(InputWarning, match=r"4 of 4 pictures are undistorted to pinholes of the same focal lengths and size \(fisheye"):
        views = load_views(tmp_path)
    for image, camera, expected in zip(views.images, views.cameras, cameras):
        assert np.isclose(camera.fx, f) and np.allclose(camera.world_to_camera, expected.world_to_camera)
        wanted = rays_of_box(camera, np.stack([x / f, -y / f, -np.ones_like(x)], -1))
        found = image[..., 3] >= 0.5
        inner = wanted & np.roll(wanted, 1, 0) & np.roll(wanted, -1, 0) & np.roll(wanted, 1, 1) & np.roll(wanted, -1, 1)
        rim = wanted & ~inner
        assert (found ^ wanted).sum() < 0.4 * rim.sum() and found[inner].mean() > 0.995
        assert (bent_masks.pop(0) ^ wanted).sum() > 1.5 * rim.sum(), "taken for a pinhole's they are off by more than the rim"


def transforms_of(folder, **more):
    """A set of two pictures with the coefficients of a lens of the usual kind."""
    for k in range(2):
        Image.new("RGBA", (12, 9), (200, 100, 50, 255)).save(folder / f"{k}.png")
    pose = look_at((0, 0, 3), (0, 0, 0), (0, 1, 0), 40, 12, 9).camera_to_world.tolist()
    frames = [{"file_path": f"{k}.png", "transform_matrix": pose} for k in range(2)]
    (folder / "transforms.json").write_text(json.dumps({"fl_x": 10.0, "cx": 6.0, "cy": 4.5, **more, "frames": frames}))
    return folder


def test_a_note_says_what_was_done_and_what_is_lost(tmp_path):
    with pytest.warns(InputWarning) as told:
        load_views(transforms_of(tmp_path, k1=0.5, k2=0.0, p1=0.001))
    assert len(told) == 1 and str(told[0].message).startswith(
        "2 of 2 pictures are undistorted to pinholes of the same focal lengths and size (opencv k1 0.5, p1 0.001); up to ")
    assert str(told[0].message).endswith("of a picture lies beyond what its lens saw, and counts as no object")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert np.array_equal(load_views(transforms_of(tmp_path, camera_model="OPENCV", k1=0.0)).images,
                              load_views(transforms_of(tmp_path)).images)


@pytest.mark.parametrize("make, message", [
    (lambda: Lens(1, 1, 0, 0, "equirect"), "lens 'equirect' with 0 coefficients; opencv has up to 6, fisheye up to 4"),
    (lambda: Lens(1, 1, 0, 0, "fisheye", (0.1,) * 5), "lens 'fisheye' with 5 coefficients"),
    (lambda: Lens(1, 1, 0, 0, "opencv", (np.inf,)), "a lens has numbers that are not finite: opencv k1 inf")])
def test_what_no_lens_is_is_named(make, message):
    with pytest.raises(InputError, match=message):
        make()


def test_pictures_of_another_size_than_stated_have_their_cameras_scaled_and_lost_ones_are_left_out(tmp_path):
    transforms_of(tmp_path, k1=0.1, w=36, h=27.0)
    document = json.loads((tmp_path / "transforms.json").read_text())
    document["frames"].append({"file_path": "lost", "transform_matrix": np.eye(4).tolist()})
    (tmp_path / "transforms.json").write_text(json.dumps(document))
    with pytest.raises(InputError, match="frame 2: image file .*lost does not exist"):
        load_views(tmp_path)
    with pytest.warns(InputWarning) as told:
        views = load_views(tmp_path, skip=True)
    assert [str(w.message).split(":")[-1] for w in told][:2] == [
        " 1 of its 3 pictures do not exist, such as lost; the others are used", " 36 pixels across are stated, it has 12)"]
    camera = views.cameras[1]
    np.testing.assert_allclose((camera.fx, camera.cx, camera.cy, camera.width), (10 / 3, 2.0, 1.5, 12))
    for frame in document["frames"]:
        frame["file_path"] = "lost"
    (tmp_path / "transforms.json").write_text(json.dumps(document))
    with pytest.raises(InputError, match="3 of its 3 pictures do not exist, such as lost; check the paths"):
        load_views(tmp_path, skip=True)


def test_pictures_of_a_phone_as_instant_ngp_lists_them():
    """67 frames with k1, k2, p1, p2 of one lens, of which 50 pictures exist, at a third of the stated size: a real file of another tool."""
    folder = SHARED / "assets" / "fox_transforms"
    if not folder.is_dir():
        pytest.skip("shared assets not present; procedural sets were tested in their place")
    with pytest.raises(InputError, match=r"frame \d+: image file .* does not exist, .* say views.missing = \"skip\""):
        load_views(folder, masks=Masks(whole=True))
    with pytest.warns(InputWarning) as told:
        views = load_views(folder, 160, masks=Masks(whole=True), skip=True)
    assert len(views) == 50 and views.images.shape == (50, 160, 90, 4)
    told = [str(w.message) for w in told]
    assert "17 of its 67 pictures do not exist" in told[0] and "1080 pixels across are stated, it has 360" in told[1]
    assert "50 of 50 pictures are undistorted" in told[2] and "(opencv k1 0.05784, k2 -0.08051, p1 -0.0009803, p2 0.0001557)" in told[2]
    assert np.isclose(views.cameras[0].fx, 1375.52 / 12) and np.isclose(views.cameras[0].cy, 965.268 / 12)
