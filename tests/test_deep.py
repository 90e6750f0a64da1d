"""Pictures of 16 bits: PNGs read for all of them, two ints a pixel on the device, and the bits of the floats that they stand for."""

import json
import struct
import zlib

import numpy as np
import pytest
from PIL import Image
from test_feed import NAMES, SIZE, blobs, fit, made, solved
from test_views import write_views

from dressi_edge import runtime
from dressi_edge.cache.errors import InputError
from dressi_edge.cache.layout import Layout
from dressi_edge.compiler.graph.ops.packed import unorm16
from dressi_edge.compiler.graph.program import Program
from dressi_edge.compiler.graph.reference_session import ReferenceSession
from dressi_edge.compiler.io.again import reader
from dressi_edge.compiler.io.averaging import downsampled
from dressi_edge.compiler.io.decode import Masks, Photograph
from dressi_edge.compiler.io.lens import Lens
from dressi_edge.compiler.io.pictures import Pictures
from dressi_edge.compiler.io.views import Views, load_views
from dressi_edge.compiler.scene import targets

pytest_plugins = ["gpu"]

KINDS = {1: 0, 2: 4, 3: 2, 4: 6}  # of a PNG, by channels


@pytest.fixture(autouse=True)
def few(monkeypatch):
    """Seven views of 40x30 count as many, and three of them make a window."""
    monkeypatch.setattr(targets, "SMALL", 1000)
    monkeypatch.setattr(targets, "SLOTS", 3)


def png16(words, more=b""):
    """The bytes of a PNG of 16 bits, its rows filtered in all five ways by turns; more: chunks before the pixels."""
    height, width, channels = words.shape
    step, rows, above = 2 * channels, [], np.zeros(2 * channels * width, int)
    for y in range(height):
        row = np.frombuffer(words[y].astype(">u2").tobytes(), np.uint8).astype(int)
        left, corner = (np.concatenate([np.zeros(step, int), x[:-step]]) for x in (row, above))
        off = [abs(left + above - corner - x) for x in (left, above, corner)]
        paeth = np.where((off[0] <= off[1]) & (off[0] <= off[2]), left, np.where(off[1] <= off[2], above, corner))
        told = row - [0, left, above, (left + above) // 2, paeth][y % 5]
        rows.append(bytes([y % 5]) + (told % 256).astype(np.uint8).tobytes())
        above = row
    head = struct.pack(">IIBBBBB", width, height, 16, KINDS[channels], 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + b"".join((chunk(b"IHDR", head), more, chunk(b"IDAT", zlib.compress(b"".join(rows))), chunk(b"IEND", b"")))


def chunk(name, data):
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


def as_rgba(words):
    """(h, w, 4) of 1 to 4 channels."""
    color, alpha = words[..., :-1] if words.shape[2] in (2, 4) else words, np.full_like(words[..., :1], 65535)
    return np.concatenate([np.broadcast_to(color, (*color.shape[:2], 3)), words[..., -1:] if words.shape[2] in (2, 4) else alpha], -1)


@pytest.fixture(scope="module")
def photos(tmp_path_factory):
    """A folder of views of a blob, of 16 bits but for the last, which has 8."""
    images, cams = blobs()
    folder = write_views(tmp_path_factory.mktemp("photos"), images, cams)
    listing = next(folder.glob("transforms*.json"))
    for frame, image in list(zip(json.loads(listing.read_text())["frames"], images))[:-1]:
        path = (folder / frame["file_path"]).with_suffix(".png")
        assert path.exists()
        path.write_bytes(png16(np.rint(image * 65535.0).astype(np.uint16)))
    return folder


# ---- reading

@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_all_bits_of_a_png_are_read(tmp_path, channels):
    words = np.random.default_rng(channels).integers(0, 65536, (11, 9, channels), np.uint16)
    whole = Masks(whole=True)
    found = Photograph(tmp_path / "a.png", (9, 11), whole)(png16(words))
    assert found.dtype == np.uint16 and np.array_equal(found, as_rgba(words))
    turned = chunk(b"eXIf", b"MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0")  # to be turned right by a quarter
    found = Photograph(tmp_path / "a.png", (11, 9), whole)(png16(words, turned))
    assert np.array_equal(found, np.rot90(as_rgba(words), -1)), "turned as EXIF says"
    if channels in (1, 3):  # a colour that stands for nothing there
        clear = png16(words, chunk(b"tRNS", struct.pack(f">{channels}H", *map(int, words[3, 4]))))
        assert Photograph(tmp_path / "a.png", (9, 11))(clear)[3, 4, 3] == 0
    torn = png16(words)[:120]
    with pytest.raises(InputError, match="image .*a.png cannot be read"):
        Photograph(tmp_path / "a.png", (9, 11), whole)(torn)


def test_what_is_made_of_a_picture_of_16_bits_has_16(tmp_path):
    """Masks, a backdrop, colour divided by alpha, a lens: as of 8 bits, 257 times as fine."""
    rng = np.random.default_rng(8)
    bytes_ = rng.integers(0, 256, (12, 10, 4), np.uint8)
    few, many = tmp_path / "few.png", tmp_path / "many.png"
    Image.fromarray(bytes_).save(few)
    many.write_bytes(png16(bytes_.astype(np.uint16) * 257))
    mask = tmp_path / "mask.png"
    Image.fromarray(rng.integers(0, 256, (12, 10), np.uint8)).save(mask)
    bent = Lens(9.0, 9.0, 5.0, 6.0, k=(0.05,))
    for masks, own, lens in ((Masks(), mask, None), (Masks(backdrop=(0.1, 0.5, 0.9), within=0.8), None, None),
                             (Masks(premultiplied=True), None, None), (Masks(), None, bent)):
        a, b = (Photograph(path, (10, 12), masks, own, True, lens) for path in (few, many))
        a, b = (p(*(f.read_bytes() for f in p.files)).astype(float) for p in (a, b))
        assert np.abs(a - b / 257).max() <= 0.5 + 1e-3 and np.any(b % 257), "each rounded once"
    pictures = Pictures([Photograph(many, (10, 12))], [(5, 6)])
    assert pictures.bits == 32 and np.array_equal(pictures[0], downsampled(bytes_, (5, 6)))
    assert Pictures([Photograph(many, (10, 12)), Photograph(few, (10, 12))]).bits == 16
    both = Pictures([Photograph(many, (10, 12)), Photograph(few, (10, 12))])
    assert np.array_equal(both.rows(0), both.rows(1)) and both.rows(1).dtype == np.uint16 and both.masks[0] == both.masks[1]
    assert np.array_equal(both[0], bytes_ / np.float32(255.0))


# ---- on the device

def test_every_word_is_what_numpy_makes_of_it(gpu):
    """k / 65535 to the last bit, on the device and in the reference to fp32; and a table's."""
    p, table = Program(), np.linspace(1.0, -3.0, 65536).astype(np.float32) ** 3
    rng, image = np.random.default_rng(0), Layout("image", "vec4", 256, 256)
    rows = np.stack([rng.permutation(65536) for _ in range(4)], -1).astype("<u2").reshape(256, 256, 4)
    packed = p.input("packed", Layout("image", "ivec2", 256, 256), rows.view("<i4"))
    p.plan("out", outputs={"plain": (unorm16(packed), image), "table": (unorm16(packed, table), image)})
    found, wanted = gpu.run(p, {}), rows.astype(np.float32) / np.float32(65535.0)
    assert np.array_equal(found["plain"], wanted)
    assert np.array_equal(found["table"], np.concatenate([table[rows[..., :3]], wanted[..., 3:]], -1))
    with ReferenceSession(p) as session:
        assert np.array_equal(session.get("plain").astype(np.float32), wanted)


@pytest.mark.parametrize("how", ["files", "linear", "arrays"])
def test_a_window_gives_the_bits_of_floats(gpu, photos, tmp_path, how):
    views = load_views(photos)
    assert views.images.bits == 16
    views = views.linear() if how == "linear" else Views(np.asarray(views.images), views.cameras, views.names) if how == "arrays" else views
    found = []
    for k, more in enumerate(({"whole": True}, {}, {"embed": False})):
        path = made(gpu, fit(views, **more), tmp_path / f"{k}.dressi")
        with runtime.load(path, gpu.device) as session:
            if k:
                assert session.values["targets"]["type"] == "ivec2" and session.values["targets"]["count"] == 3
            if k == 2:
                meta = session.bundle.description["meta"]["pictures"]
                assert meta["bits"] == 16
                session.pictures(views.images.__getitem__ if how == "arrays" else reader(photos, meta, how == "linear"))
            found.append((solved(session), session.get("targets").tobytes()))
    assert found[1] == found[0] and found[2] == found[0]
    gpu.silent()


@pytest.mark.parametrize("profile", ["vulkan_min", "android_baseline_2022", "videocore7", *(
    pytest.param(name, marks=pytest.mark.full) for name in ("mali_g76", "adreno_740_turnip"))])
def test_every_profile_has_them(gpu, photos, tmp_path, profile):
    """The bits of the same profile's floats."""
    found = []
    for whole in (True, False):
        fit(load_views(photos), whole=whole).compile(profile, tmp_path / "x.dressi")
        with runtime.load(tmp_path / "x.dressi", gpu.device, emulate=profile) as session:
            session.step(4, "shape")
            session.step(3, "paint")
            found.append([session.get(name).tobytes() for name in NAMES])
    assert found[0] == found[1]
    gpu.silent()


def test_one_picture_is_set_in_any_kind_of_numbers(gpu, photos, tmp_path):
    path = made(gpu, fit(load_views(photos)), tmp_path / "x.dressi")
    words = np.random.default_rng(1).integers(0, 65536, (*SIZE[::-1], 4), np.uint16)
    with runtime.load(path, gpu.device) as session:
        session.set("targets", words, view=2)
        assert np.array_equal(session.get("targets", view=2), words / np.float32(65535.0))
        session.set("targets", words / np.float32(65535.0), view=3)
        assert np.array_equal(session.get("targets", view=3), words / np.float32(65535.0))
        session.set("targets", (words >> 8).astype(np.uint8), view=4)
        assert np.array_equal(session.get("targets", view=4), (words >> 8) / np.float32(255.0))
        with pytest.raises(InputError, match="pictures of 16 bits have 0 to 1"):
            session.set("targets", np.full((*SIZE[::-1], 4), 1.5), view=2)
        session.step(9, "shape")
        assert np.isfinite(session.loss())
    gpu.silent()
