"""libdressi brings pictures to the device as steps need them, and says which view a step sees: the bits of the other runtime, whose
checkpoints it goes on from, and the other way round."""

import json

import numpy as np
import pytest
from test_feed import NAMES, fit, made, misled
from test_native import BUNDLE, INPUT, player  # noqa: F401

from dressi_edge import runtime
from dressi_edge.cache import bundle as bundles
from dressi_edge.compiler.io.cameras import orbit
from dressi_edge.compiler.io.views import Views
from dressi_edge.compiler.scene import targets

pytest_plugins = ["gpu"]

N, SIZE = 5, (40, 30)
KINDS = {8: np.uint8, 16: np.uint16, 32: np.float32}


@pytest.fixture(autouse=True)
def few(monkeypatch):
    """Five views of 40x30 count as many, and three of them make a window."""
    monkeypatch.setattr(targets, "SMALL", 1000)
    monkeypatch.setattr(targets, "SLOTS", 3)


def photographs(bits):
    """(n, h, w, 4) of a blob, in numbers of so many bits."""
    rng, most = np.random.default_rng(bits), 1 if bits == 32 else 2 ** bits - 1
    y, x = np.mgrid[:SIZE[1], :SIZE[0]] + 0.5
    alpha = np.clip(8.0 - np.hypot(x - 20, y - 15) / 1.2, 0.0, 1.0)
    images = np.stack([np.concatenate([rng.random((*alpha.shape, 3)), alpha[..., None]], -1) for _ in range(N)]) * most
    return images.astype(np.float32) if bits == 32 else np.rint(images).astype(KINDS[bits])


def bundle_of(gpu, pictures, path, order="shuffle"):
    images = pictures if pictures.dtype == np.float32 else pictures / np.float32(np.iinfo(pictures.dtype).max)
    cameras = orbit(N, [20.0, -15.0], 2.6, 50.0, SIZE)
    return made(gpu, fit(Views(images, cameras, tuple(map(str, range(N)))), order, embed=False), path)


def got(names, folder):
    return [word for name in names for word in ("get", name, folder / name)]


def read(names, folder):
    return {name: (folder / name).read_bytes() for name in names}


@pytest.mark.parametrize(("bits", "order"), [(8, "shuffle"), (16, "cycle"), (32, "shuffle"), (8, "batch"),
                                              pytest.param(8, "accumulate", marks=pytest.mark.full)])
def test_both_players_bring_the_same_pictures(gpu, player, tmp_path, bits, order):  # noqa: F811
    pictures = photographs(bits)
    path, file = bundle_of(gpu, pictures, tmp_path / "x.dressi", order), tmp_path / "pictures"
    pictures.tofile(file)
    names = (*NAMES, "paint.loss")
    with runtime.load(path, gpu.device) as session:
        assert session.bundle.description["meta"]["pictures"]["bits"] == bits
        session.pictures(pictures.__getitem__)
        session.step(7, "shape")
        session.checkpoint(tmp_path / "python.checkpoint")
        session.step(4)
        session.step(6, "paint")
        wanted = {name: session.get(name).tobytes() for name in names}
    done = player("run", path, "pictures", ".", file, "step", "shape", 7, "save", ".", tmp_path / "c.checkpoint", "step", "shape", 4,
                  "step", "paint", 6, *got(names, tmp_path))
    assert done.stdout.splitlines()[0] == f"{N} {SIZE[0]}x{SIZE[1]} {bits} {SIZE[0] * SIZE[1] * bits // 2}", done.stderr
    assert read(names, tmp_path) == wanted
    assert (tmp_path / "c.checkpoint").read_bytes() == (tmp_path / "python.checkpoint").read_bytes()
    player("run", path, "pictures", ".", file, "step", "paint", 2, "load", ".", tmp_path / "python.checkpoint", "bound", "shape", "4:60",
           "step", "paint", 1, "step", "paint", 5, *got(names, tmp_path))
    assert read(names, tmp_path) == wanted, "gone on from the other's checkpoint, in other pieces"
    with runtime.load(path, gpu.device) as session:
        session.pictures(pictures.__getitem__)
        session.restore(tmp_path / "c.checkpoint")
        session.step(4, "shape")
        session.step(6, "paint")
        assert {name: session.get(name).tobytes() for name in names} == wanted
    gpu.silent()


def test_a_counter_that_is_set_and_other_pictures_are_seen(gpu, player, tmp_path):  # noqa: F811
    pictures = photographs(8)
    path, other = bundle_of(gpu, pictures, tmp_path / "x.dressi"), 255 - pictures
    other[..., 3] = pictures[..., 3]
    pictures.tofile(tmp_path / "pictures")
    other.tofile(tmp_path / "other")
    np.array(3, np.int32).tofile(tmp_path / "three")
    with runtime.load(path, gpu.device) as session:
        session.pictures(pictures.__getitem__)
        session.step(4, "paint")
        session.set("paint.step", 3)
        session.step(2)
        session.pictures(other.__getitem__)
        session.step(2)
        wanted = {name: session.get(name).tobytes() for name in NAMES}
    player("run", path, "pictures", ".", tmp_path / "pictures", "step", "paint", 4, "set", "paint.step", tmp_path / "three",
           "step", "paint", 2, "pictures", ".", tmp_path / "other", "step", "paint", 2, *got(NAMES, tmp_path))
    assert read(NAMES, tmp_path) == wanted


def test_pictures_that_cannot_be_had_are_named_and_steps_before_stay(gpu, player, tmp_path):  # noqa: F811
    pictures = photographs(8)
    path, file = bundle_of(gpu, pictures, tmp_path / "x.dressi"), tmp_path / "pictures"
    meta = bundles.read(path).description["meta"]
    order = np.frombuffer(meta["pictures"]["order"], "<i4")
    pictures.tofile(file)
    last = int(np.argmax(order == N - 1))  # the first step that sees the last picture
    (tmp_path / "short").write_bytes(file.read_bytes()[:-1])
    done = player("run", path, "try", "step:shape", 1, "try", "step:paint", 1, "pictures", ".", tmp_path / "short",
                  "try", "step:paint", last + 1, "report", ".", ".", "pictures", ".", file, "step", "paint", 1,
                  "pictures", ".", ".", "set", "paint.view", tmp_path / "short")
    lines = done.stdout.splitlines()
    assert lines[0] == f"{INPUT} shape needs targets; set it first"
    assert lines[1] == f"{INPUT} paint needs targets paint.view; set it first"
    assert lines[3] == f"{INPUT} targets: picture {N - 1} cannot be had"
    assert max(0, last - 2) <= json.loads(lines[4])["runs"]["paint"] <= last, "a window is filled for the steps that it has room for"
    assert done.returncode == INPUT and "paint.view: the array has" in done.stderr


@pytest.mark.parametrize(("key", "value"), [
    ("value", "vertices"), ("value", 3), ("views", 0), ("views", 1 << 21), ("bits", 16), ("bits", "8"), ("order", b""), ("order", b"123"),
    ("order", None), ("order", np.full(2, N, "<i4").tobytes()), ("steps", 3), ("steps", {"shape": "vertices"})])
def test_a_bundle_that_misleads_about_its_pictures_is_refused_by_both(gpu, player, tmp_path, key, value):  # noqa: F811
    path = bundle_of(gpu, photographs(8), tmp_path / "x.dressi")
    misled(path, path, lambda meta: {**meta, "pictures": {**meta["pictures"], key: value}})
    done = player("run", path)
    assert done.returncode == BUNDLE and "meta.pictures is malformed" in done.stderr
