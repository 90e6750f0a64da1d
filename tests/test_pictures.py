"""Pictures as cameras and tools write them: each kind is read for what it shows, the mask is where it is said to be, sizes may differ, and
what cannot be told is refused with what helps."""

import json
import struct
import warnings
import zlib

import numpy as np
import pytest
from jobs import SIZE, TINY, command
from PIL import Image

from dressi_edge.cache.errors import InputError, InputWarning
from dressi_edge.compiler.graph.reference_session import ReferenceSession
from dressi_edge.compiler.io.cameras import orbit
from dressi_edge.compiler.io.decode import OWN, Masks, Photograph, header
from dressi_edge.compiler.io.shapes import icosphere
from dressi_edge.compiler.io.views import Views, load_views
from dressi_edge.compiler.render.optimizer import Adam
from dressi_edge.compiler.render.raster import Softness
from dressi_edge.compiler.scene import results
from dressi_edge.compiler.scene.job import load_job
from dressi_edge.compiler.scene.problem import Loss, Problem


def decoded(path, masks=OWN, mask=None):
    """uint8 (h, w, 4) of a picture, of 16 bits the upper 8."""
    read = Photograph(path, header(path).upright, masks, mask)
    found = read(*(file.read_bytes() for file in read.files))
    return found if found.dtype == np.uint8 else (found >> 8).astype(np.uint8)


RNG = np.random.default_rng(5)
PIXELS = RNG.integers(0, 256, (6, 8, 4), np.uint8)  # of any picture, straight colour and alpha


def png16(path, pixels, kind):
    """A PNG of 16 bits, with the bytes of `pixels` above others: no library here writes one in colours."""
    height, width, channels = pixels.shape
    words = (pixels.astype(np.uint16) << 8) | RNG.integers(0, 256, pixels.shape, np.uint16)

    def chunk(name, data):
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    rows = b"".join(b"\0" + row.astype(">u2").tobytes() for row in words.reshape(height, -1))
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 16, kind, 0, 0, 0))
                     + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b""))


def test_a_picture_is_read_for_what_it_shows_however_it_is_stored(tmp_path):
    grey, opaque = PIXELS[..., :1].repeat(3, 2), np.full((6, 8, 1), 255, np.uint8)
    whole = Masks(whole=True)

    def check(name, expected, off=0):
        found = decoded(tmp_path / name, whole).astype(int)
        assert found.shape == (6, 8, 4) and np.abs(found - expected).max() <= off, name

    image = Image.fromarray(PIXELS)
    for suffix in ("png", "webp", "tif", "tga"):
        image.save(tmp_path / f"a.{suffix}", **({"lossless": True, "exact": True} if suffix == "webp" else {}))
        check(f"a.{suffix}", PIXELS)
    image.convert("RGB").save(tmp_path / "rgb.bmp")
    check("rgb.bmp", np.concatenate([PIXELS[..., :3], opaque], 2))
    Image.fromarray(PIXELS[..., 0]).save(tmp_path / "grey.png")
    check("grey.png", np.concatenate([grey, opaque], 2))
    Image.fromarray(PIXELS[..., [0, 3]], "LA").save(tmp_path / "la.png")
    check("la.png", np.concatenate([grey, PIXELS[..., 3:]], 2))
    few = Image.fromarray(PIXELS[..., :3]).quantize(8)
    few.save(tmp_path / "palette.png", transparency=3)
    index = np.asarray(few)
    check("palette.png", np.concatenate([np.asarray(few.convert("RGB")), np.where(index == 3, 0, 255)[..., None]], 2))
    Image.fromarray(PIXELS[..., 0] > 99).save(tmp_path / "bits.png")
    check("bits.png", np.concatenate([np.where(PIXELS[..., :1] > 99, 255, 0).repeat(3, 2), opaque], 2))
    for kind, channels in ((0, [0]), (2, [0, 1, 2]), (4, [0, 3]), (6, [0, 1, 2, 3])):
        png16(tmp_path / "deep.png", PIXELS[..., channels], kind)
        check("deep.png", np.concatenate([PIXELS[..., :3] if len(channels) > 2 else grey, PIXELS[..., 3:] if kind > 2 else opaque], 2))
    smooth = np.kron(RNG.integers(0, 256, (1, 1, 3)), np.ones((6, 8, 1))).astype(np.uint8)
    Image.fromarray(smooth).save(tmp_path / "a.jpg", quality=95)
    check("a.jpg", np.concatenate([smooth, opaque], 2), off=3)
    Image.fromarray(smooth).convert("CMYK").save(tmp_path / "cmyk.jpg", quality=95)
    check("cmyk.jpg", np.concatenate([smooth, opaque], 2), off=8)
    Image.fromarray(np.float32(PIXELS[..., 0])).save(tmp_path / "float.tif")
    with pytest.raises(InputError, match="float.tif has pixels of mode F, which are not read; save it again as a PNG of 8 bits"):
        decoded(tmp_path / "float.tif")


def test_colour_that_is_multiplied_by_alpha_is_divided_by_it(tmp_path):
    Image.fromarray(PIXELS).convert("RGBa").convert("RGB")
    alpha = PIXELS[..., 3:].astype(float)
    stored = np.concatenate([np.rint(PIXELS[..., :3] * alpha / 255.0), alpha], 2).astype(np.uint8)
    Image.fromarray(stored).save(tmp_path / "a.png")
    found = decoded(tmp_path / "a.png", Masks(premultiplied=True)).astype(float)
    assert np.array_equal(found[..., 3], alpha[..., 0])
    np.testing.assert_allclose(found[..., :3] * alpha, PIXELS[..., :3] * alpha, atol=256)  # half a step of what was stored
    Image.fromarray(PIXELS[..., :3]).save(tmp_path / "b.png")
    with pytest.raises(InputError, match=r"b.png has no alpha channel \(mode RGB\), but its colour is to be divided by alpha"):
        decoded(tmp_path / "b.png", Masks(premultiplied=True, whole=True))


@pytest.mark.parametrize("turn, back", [(3, lambda x: x[::-1, ::-1]), (6, lambda x: np.rot90(x, -1)), (8, lambda x: np.rot90(x, 1)),
                                        (2, lambda x: x[:, ::-1])])
def test_a_picture_is_turned_as_exif_says_unless_the_cameras_are_of_it_as_stored(tmp_path, turn, back):
    exif = Image.Exif()
    exif[0x0112] = turn
    Image.fromarray(PIXELS).save(tmp_path / "a.png", exif=exif)
    height, width = back(PIXELS).shape[:2]
    frame = {"file_path": "a", "transform_matrix": np.eye(4).tolist()}
    for stated, expected in (({}, back(PIXELS)), ({"w": width, "h": height}, back(PIXELS)), ({"w": 8, "h": 6}, None)):
        (tmp_path / "transforms.json").write_text(json.dumps({"fl_x": 9, **stated, "frames": [frame]}))
        if expected is None:  # lying on a side, the stated size tells; standing on the head it does not
            expected = PIXELS if turn > 4 else back(PIXELS)
        turned = expected is not PIXELS
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            views = load_views(tmp_path)
        np.testing.assert_allclose(views.images[0] * 255.0, expected, atol=1e-4)
        assert (views.cameras[0].width, views.cameras[0].height) == expected.shape[1::-1]
        assert [str(x.message) for x in told] == ["1 of 1 pictures are turned as their EXIF orientation says"] * turned
    (tmp_path / "transforms.json").write_text(json.dumps({"fl_x": 9, "w": 80, "frames": [frame]}))
    with pytest.raises(InputError, match=f"states 80x{height} pixels, but .*a.png has {width}x{height}"):
        load_views(tmp_path)


# Masks


def photos(folder, count=3, size=(8, 6), name="{:03d}.jpg", places=("images", "masks"), masks="{:03d}.png"):
    """A set of grey JPEGs in images/ whose left half is the object, as masks/ says."""
    for place in places:
        (folder / place).mkdir(exist_ok=True)
    frames = []
    for k, camera in enumerate(orbit(count, [20.0], 3.0, 40.0, size)):
        Image.new("RGB", size, (90 + k,) * 3).save(folder / "images" / name.format(k))
        mask = np.zeros(size[::-1], np.uint8)
        mask[:, :size[0] // 2] = 255
        if masks:
            Image.fromarray(mask).save(folder / "masks" / masks.format(k))
        frames.append({"file_path": f"images/{name.format(k)}", "transform_matrix": camera.camera_to_world.tolist()})
    (folder / "transforms.json").write_text(json.dumps({"fl_x": 9.0, "frames": frames}))
    return folder


@pytest.mark.parametrize("named", ["{:03d}.png", "{:03d}.jpg.png", "{:03d}.PNG", "{:03d}.jpg", "mask{}.png"])
def test_masks_of_a_folder_go_to_the_pictures_of_their_names(tmp_path, named):
    photos(tmp_path, 12, masks=named)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        views = load_views(tmp_path, masks=Masks(tmp_path / "masks"))
    assert [x.category for x in told] == [InputWarning] * ("mask" in named)
    if told:
        assert "mask0.png for 000.jpg, ..., mask11.png for 011.jpg" in str(told[0].message)
    left = views.images[..., 3][:, :, :4], views.images[..., 3][:, :, 4:]
    assert left[0].min() > 0.98 and left[1].max() < 0.02
    np.testing.assert_allclose(views.images[:, 0, 0, 0] * 255, 90 + np.arange(12), atol=1)


def test_masks_of_a_rig_lie_in_folders_of_the_same_names(tmp_path):
    for cam in ("cam0", "cam1"):
        for place in ("images", "masks"):
            (tmp_path / place / cam).mkdir(parents=True)
        Image.new("RGB", (8, 6)).save(tmp_path / "images" / cam / "1.png")
        Image.new("L", (8, 6), 255 if cam == "cam1" else 51).save(tmp_path / "masks" / cam / "1.png")
    files = [tmp_path / "images" / cam / "1.png" for cam in ("cam0", "cam1")]
    found = Masks(tmp_path / "masks").of(files, [None, None])
    assert [decoded(f, mask=m)[0, 0, 3] for f, m in zip(files, found)] == [51, 255]
    assert Masks((files[1], files[0])).of(files, [None, None]) == files[::-1]


def test_a_mask_is_its_brightness_or_its_alpha_or_labels_and_goes_with_the_alpha_of_the_picture(tmp_path):
    Image.fromarray(PIXELS).save(tmp_path / "a.png")
    half = np.full((6, 8), 128, np.uint8)
    for mask, expected in ((half, 128 / 255), (np.where(half > 0, 1, 0).astype(np.uint8), 1.0),
                           (np.dstack([half * 0 + 255] * 3 + [half]), 128 / 255), (np.dstack([half] * 3), 128 / 255)):
        Image.fromarray(mask).save(tmp_path / "m.png")
        found = decoded(tmp_path / "a.png", mask=tmp_path / "m.png")
        np.testing.assert_allclose(found[..., 3], PIXELS[..., 3] * expected, atol=0.51)
        assert np.array_equal(found[..., :3], PIXELS[..., :3])


def test_a_file_of_transforms_names_masks_and_premultiplied_colour(tmp_path):
    document = json.loads((photos(tmp_path) / "transforms.json").read_text())
    for k, frame in enumerate(document["frames"]):
        frame |= {"mask_path": f".\\masks\\{k:03d}", "file_path": frame["file_path"].replace("/", "\\")[:-4]}
    (tmp_path / "transforms.json").write_text(json.dumps(document))
    views = load_views(tmp_path)
    assert views.images[:, :, :4, 3].min() == 1.0 and views.images[:, :, 4:, 3].max() == 0.0 and views.names == ("000", "001", "002")
    Image.fromarray(np.uint8([[[100, 50, 0, 128]]])).save(tmp_path / "p.png")
    (tmp_path / "transforms.json").write_text(json.dumps({"fl_x": 9.0, "fix_premult": True, "frames": [
        {"file_path": "p", "transform_matrix": np.eye(4).tolist()}]}))
    np.testing.assert_allclose(load_views(tmp_path).images[0, 0, 0] * 255, (199, 100, 0, 128), atol=0.51)


def test_what_differs_from_a_backdrop_is_the_object(tmp_path):
    picture = np.full((6, 8, 3), (20, 60, 200), np.uint8)
    picture[2:4, 2:5] = (200, 180, 90)
    picture[0, 0] = (20, 60, 200 - int(0.75 * 0.2 * 3 ** 0.5 * 255))  # three quarters of the way
    Image.fromarray(picture).save(tmp_path / "a.png")
    found = decoded(tmp_path / "a.png", Masks(backdrop=(20 / 255, 60 / 255, 200 / 255), within=0.2))[..., 3]
    expected = np.zeros((6, 8))
    expected[2:4, 2:5], expected[0, 0] = 255, 0.5 * 255
    np.testing.assert_allclose(found, expected, atol=2)


@pytest.mark.parametrize("make, message", [
    (lambda f: Masks(f / "lost"), "mask directory .*lost does not exist"), (lambda f: Masks((f / "a.png",)), "1 masks for 3 pictures"),
    (lambda f: (f / "masks/001.png").unlink() or Masks(f / "masks"), "001.jpg has no mask in .*masks, though others have; add 001.png"),
    (lambda f: [(f / f"masks/00{k}.png").unlink() for k in range(3)] and Masks(f / "masks"), "no mask in .*masks has the name of a pict"),
    (lambda f: Image.new("L", (4, 3)).save(f / "masks/002.png") or Masks(f / "masks"), "mask .*002.png is 4x3, but .*002.jpg is 8x6"),
    (lambda f: (f / "masks/000.png").write_bytes(b"x") and Masks(f / "masks"), "mask .*000.png cannot be read"),
    (lambda f: Masks(), r"000.jpg has no alpha channel \(mode RGB\); .*views.masks = \"...\", for there is a folder .*masks"),
    (lambda f: Masks(backdrop=(0, 0, 2)), "backdrop is .* three numbers from 0 to 1"),
    (lambda f: Masks(within=0.0), "within is 0.0; a number above 0")])
def test_a_mask_that_is_not_there_is_named(tmp_path, make, message):
    with pytest.raises(InputError, match=message) as caught:
        load_views(photos(tmp_path), masks=make(tmp_path))
    assert "\n" not in str(caught.value)


def test_pictures_without_masks_are_told_of_their_backdrop(tmp_path):
    photos(tmp_path, places=("images",), masks=None)
    with pytest.raises(InputError, match=r"views.masks = a folder of masks, views.backdrop = a plain background's colour \(about \[0.35, "
                                         r"0.35, 0.35\] at the border of this one\), or views.masks = false for all of it"):
        load_views(tmp_path)
    assert load_views(tmp_path, masks=Masks(whole=True)).images[..., 3].min() == 1.0


# Sizes


def sized(folder, sizes=((24, 24), (30, 18), (16, 28))):
    """Discs on pictures of these sizes, each camera's angle such that one pixel is as wide in all; their numbers."""
    (folder / "photos").mkdir(exist_ok=True)
    frames = []
    for k, ((w, h), camera) in enumerate(zip(sizes, orbit(len(sizes), (10.0, -10.0), 2.5, 50.0, (SIZE, SIZE)))):
        y, x = np.mgrid[:h, :w] + 0.5
        image = np.zeros((h, w, 4), np.uint8)
        image[(x - w / 2) ** 2 + (y - h / 2) ** 2 < 49] = (200, 50, 25, 255)
        Image.fromarray(image).save(folder / "photos" / f"{k}.png")
        frames.append({"file_path": f"{k}.png", "fl_x": camera.fx, "w": w, "h": h, "transform_matrix": camera.camera_to_world.tolist()})
    (folder / "photos" / "transforms.json").write_text(json.dumps({"frames": frames}))
    return folder / "photos"


def test_pictures_of_different_sizes_are_each_in_the_corner_of_its_view(tmp_path):
    views = load_views(sized(tmp_path))
    assert views.images.shape == (3, 28, 30, 4) and [(c.width, c.height, c.cx) for c in views.cameras] == [
        (24, 24, 12), (30, 18, 15), (16, 28, 8)]
    for k, camera in enumerate(views.cameras):
        beside = np.ones((28, 30), bool)
        beside[:camera.height, :camera.width] = False
        assert not views.images[k][beside].any() and views.picture(k).shape == (camera.height, camera.width, 4)
        assert np.count_nonzero(views.picture(k)[..., 3]) == np.count_nonzero(views.picture(0)[..., 3])
    small = load_views(tmp_path / "photos", 15)
    assert [(c.width, c.height) for c in small.cameras] == [(15, 15), (15, 9), (9, 15)] and small.images.shape == (3, 15, 15, 4)
    assert np.allclose(small.images, views.resized(15).images) and np.isclose(small.cameras[1].fx, views.cameras[1].fx / 2)
    same = load_views(tmp_path / "photos", (12, 10))
    assert same.images.shape == (3, 10, 12, 4) and {(c.width, c.height) for c in same.cameras} == {(12, 10)}


@pytest.mark.parametrize("loss", [Loss("silhouette"), Loss("color", norm="l1"), Loss("color", masked=True)])
def test_a_loss_over_different_sizes_is_that_of_the_pictures(tmp_path, loss):
    views = load_views(sized(tmp_path))
    ball, settings = icosphere(2, 0.4), {"albedo": "constant", "background": (0.3, 0.5, 0.1)}

    def value(views):
        problem = Problem(ball, views, **settings)
        problem.phase("p", 1, {"vertices": Adam(0.01)}, [loss], Softness(2.0))
        with ReferenceSession(problem.program) as s:
            return float(s.get("p.loss"))

    alone = [value(Views(views.picture(k)[None], (c,), (str(k),))) * c.width * c.height for k, c in enumerate(views.cameras)]
    texels = Problem(ball, views, **settings).scene.atlas.extent.count
    assert np.isclose(value(views) * texels, sum(alone), rtol=1e-6)


def test_a_job_takes_photographs_of_three_sizes_with_masks_in_a_folder(tmp_path):
    """From JPEGs to a mesh, on the command line; what is beside a picture counts nowhere."""
    folder = sized(tmp_path)
    (tmp_path / "masks").mkdir()
    document = json.loads((folder / "transforms.json").read_text())
    for k, frame in enumerate(document["frames"]):
        with Image.open(folder / f"{k}.png") as image:
            image.getchannel("A").save(tmp_path / "masks" / f"{k}.png")
            image.convert("RGB").save(folder / f"{k}.jpg")
        (folder / f"{k}.png").unlink()
        frame["file_path"] = f"{k}"
    (folder / "transforms.json").write_text(json.dumps(document))
    (tmp_path / "job.toml").write_text(TINY.replace('transforms = "photos/transforms.json"', 'transforms = "photos"\nmasks = "masks"'))
    done = command("run", "job.toml", "--device", "reference", "-o", "out.ply", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    metrics = json.loads((tmp_path / "out_metrics.json").read_text())
    assert 0.5 < metrics["views"]["iou_mean"] < 1.0
    problem = load_job(tmp_path / "job.toml")
    with ReferenceSession(problem.program) as s:
        s.bundle = type("B", (), {"description": {"meta": problem.record()}})
        assert s.bundle.description["meta"]["view_sizes"] == [[24, 24], [30, 18], [16, 28]]
        drawn, wanted = results.snapshot(s), results.targets(s)
    assert drawn[..., 3].any() and not drawn[0, 24:].any() and not drawn[0, :, 24:].any() and not drawn[1, 18:].any()
    assert np.array_equal(wanted[..., 3] > 0, problem.views.images[..., 3] > 0)


@pytest.mark.parametrize("lines, message", [
    ('masks = "masks"', "views: mask directory .*masks does not exist"), ("masks = 3", "views.masks is 3; a folder or a list of files"),
    ('alpha = "multiplied"', "views.alpha is 'multiplied'; did you mean premultiplied"), ("masks = true", "views.masks is True; a folder"),
    ("backdrop = [0, 0, 1]", "views.backdrop is .* a table is needed"), ("backdrop = {color = [0, 0, 2]}", "views.backdrop.color.2 is 2"),
    ("masks = false\nbackdrop = {color = [0, 0, 1]}", "views: backdrop and masks = false are both given"), ("size = 0", "views.size is 0"),
    ("size = [4]", "views.size is \\[4\\]; a list of 2 numbers"), ('size = "half"', "views.size is 'half'; a whole number from 1")])
def test_keys_of_masks_and_sizes_are_checked(tmp_path, lines, message):
    sized(tmp_path)
    (tmp_path / "job.toml").write_text(TINY.replace('transforms = "photos/transforms.json"', f'transforms = "photos"\n{lines}'))
    with pytest.raises(InputError, match=message):
        load_job(tmp_path / "job.toml")
