"""Any value of a bundle as a file: PNG, EXR and NumPy arrays hold the numbers that `Session.get` gives."""

import struct
import zlib

import numpy as np
import pytest
from jobs import command, write_job
from PIL import Image

from dressi_edge import runtime
from dressi_edge.cache.errors import InputError
from dressi_edge.compiler.io.exr import exr_bytes


def read_exr(data):
    """(names of the channels, (h, w, c)) of an EXR of scan lines, ZIP and floats: a reader of its own, by the format's page."""
    magic, version = struct.unpack_from("<II", data)
    assert magic == 20000630 and version == 2
    at, header = 8, {}
    while data[at]:
        name, kind, _ = data[at:].split(b"\0", 2)
        at += len(name) + len(kind) + 2
        size, = struct.unpack_from("<i", data, at)
        header[name.decode()] = data[at + 4:at + 4 + size]
        at += 4 + size
    at += 1
    channels, rows = [], header["channels"]
    while rows[0]:
        name, rows = rows.split(b"\0", 1)
        kind, _, xs, ys = struct.unpack_from("<iB3xii", rows)
        assert (kind, xs, ys) == (2, 1, 1)
        channels, rows = [*channels, name.decode()], rows[16:]
    assert header["compression"] == b"\3"
    _, _, right, bottom = struct.unpack("<4i", header["dataWindow"])
    w, h, n = right + 1, bottom + 1, len(channels)
    starts = struct.unpack_from(f"<{-(-h // 16)}Q", data, at)
    image = np.zeros((h, n, w), np.float32)
    for start in starts:
        y, size = struct.unpack_from("<ii", data, start)
        lines = min(16, h - y)
        block = data[start + 8:start + 8 + size]
        if size < lines * n * w * 4:
            x = np.frombuffer(zlib.decompress(block), np.uint8).astype(int)
            x = (np.cumsum(x - 128) + 128).astype(np.uint8)  # the first is itself
            out, half = np.empty(len(x), np.uint8), (len(x) + 1) // 2
            out[::2], out[1::2] = x[:half], x[half:]
            block = out.tobytes()
        image[y:y + lines] = np.frombuffer(block, "<f4").reshape(lines, n, w)
    assert starts[-1] + 8 + struct.unpack_from("<i", data, starts[-1] + 4)[0] == len(data)
    return channels, image.transpose(0, 2, 1)


@pytest.mark.parametrize("shape, names", [((1, 1), "Y"), ((17, 5), "Y"), ((33, 7, 2), "GR"), ((150, 200, 3), "BGR"),
                                          ((217, 333, 4), "ABGR")])
@pytest.mark.parametrize("smooth", [False, True], ids=["noise", "smooth"])
def test_an_exr_holds_every_bit(shape, names, smooth):
    image = np.random.default_rng(1).normal(size=shape).astype(np.float32) * 1e4
    if smooth:
        image = np.broadcast_to(np.linspace(0, 1, shape[1], dtype=np.float32).reshape(1, -1, *[1] * (len(shape) - 2)), shape).copy()
    image.flat[0] = np.inf
    channels, found = read_exr(exr_bytes(image))
    assert "".join(channels) == names
    given = image.reshape(*shape[:2], -1)
    order = [{"Y": 0, "R": 0, "G": 1, "B": 2, "A": 3}[c] for c in channels]
    assert found.tobytes() == given[..., order].tobytes()


@pytest.mark.parametrize("shape", [(4,), (2, 2, 5), (0, 3), (1, 2, 3, 4)])
def test_what_is_no_picture_is_no_exr(shape):
    with pytest.raises(InputError, match="an EXR takes"):
        exr_bytes(np.zeros(shape))


def test_values_become_files_of_their_numbers(tmp_path):
    made = command("compile", write_job(tmp_path), "-p", "lavapipe", "-o", tmp_path / "x.dressi")
    assert made.returncode == 0, made.stderr
    wanted = ["render.color=a.png", "render.color=b.exr", "vertices=v.npy", "render.color=c.npy"]
    done = command("run", "x.dressi", *(x for w in wanted for x in ("-o", w)), cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    with runtime.load(tmp_path / "x.dressi") as session:
        session.step(3, "shape")
        session.step(2, "paint")
        color, vertices = session.get("render.color"), session.get("vertices")
    assert np.load(tmp_path / "v.npy").tobytes() == vertices.tobytes()
    assert np.load(tmp_path / "c.npy").tobytes() == color.tobytes()
    for k, image in enumerate(color):
        channels, found = read_exr((tmp_path / f"b_{k}.exr").read_bytes())
        assert "".join(channels) == "ABGR" and found.tobytes() == image[..., ::-1].tobytes()
        png = np.asarray(Image.open(tmp_path / f"a_{k}.png"))
        assert png.shape == (24, 24, 4) and np.abs(png / 255.0 - np.clip(image, 0, 1)).max() <= 0.5 / 255 + 1e-6
    assert len(list(tmp_path.glob("*.png"))) == 2 == len(color)
