"""What is wrong with a bundle is named, whatever it is; nothing else happens. tests/fuzz_bundle.py looks for more at random."""

import hashlib
import os
import threading
import tracemalloc

import fuzz_bundle
import hostile_bundles
import msgpack
import pytest

from dressi_edge.cache import bundle
from dressi_edge.cache.errors import BundleError
from dressi_edge.runtime import vk

ROWS, FILES = {row[0]: row[1:] for row in hostile_bundles.ROWS}, hostile_bundles.files()


@pytest.fixture(autouse=True)
def no_driver(monkeypatch):
    """Whoever reaches for the loader of Vulkan fails."""
    def called(*_):
        raise AssertionError("the reader called a driver")

    for name in ("CreateInstance", "CreateDevice", "CreateShaderModule", "CreateImage"):
        monkeypatch.setattr(vk, name, called)


def test_there_are_enough_and_each_has_its_name():
    assert len(ROWS) == len(hostile_bundles.ROWS) and len(ROWS) + len(FILES) >= 60


@pytest.mark.parametrize("name", ROWS)
def test_a_field_that_is_wrong_is_named(name):
    base, changes, told = ROWS[name]
    with pytest.raises(BundleError) as error:
        bundle.loads(hostile_bundles.spoiled(base, changes))
    assert told in str(error.value) and str(error.value).isprintable() and len(str(error.value)) < 400


@pytest.mark.parametrize("name", FILES)
def test_a_file_that_is_wrong_is_refused(name):
    data, told = FILES[name]
    with pytest.raises(BundleError) as error:
        bundle.loads(data)
    assert told in str(error.value) and str(error.value).isprintable() and len(str(error.value)) < 400


@pytest.mark.parametrize("name", ["ops", "texture"])
def test_a_bundle_cut_anywhere_is_refused(name):
    data = (hostile_bundles.FOLDER / f"{name}.dressi").read_bytes()
    for n in range(len(data)):
        with pytest.raises(BundleError):
            bundle.loads(data[:n])


@pytest.mark.parametrize("name", ["ops", "texture"])
def test_a_description_cut_anywhere_is_refused_though_its_checksum_is_right(name):
    text = msgpack.packb(bundle.read(hostile_bundles.FOLDER / f"{name}.dressi").description)
    for n in range(len(text)):
        with pytest.raises(BundleError):
            bundle.loads(hostile_bundles.packed(text[:n]))


@pytest.mark.parametrize("name, token", {
    "empty_maps": b"\x80", "empty_lists": b"\x90", "maps": b"\x81\xa0\x80", "floats": b"\xcb" + b"\x11" * 8, "texts": b"\xa1a",
    "nested": b"\xdc\x0f\xff" * 1000 + b"\xc0"}.items())
def test_memory_is_in_proportion_to_the_file(name, token):
    """The worst that MessagePack decodes to, in a list in meta."""
    d = {"meta": {}}
    count = 200_000 // len(token)
    text = msgpack.packb(d)[:-1] + b"\x81\xa1x\xdd" + count.to_bytes(4, "big") + token * count
    data = hostile_bundles.packed(text)
    tracemalloc.start()
    try:
        with pytest.raises(BundleError):
            bundle.loads(data)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < fuzz_bundle.BYTES_PER_BYTE * len(data) + fuzz_bundle.BYTES, peak / len(data)


def test_a_thousand_mutations_raise_nothing_else():
    done = fuzz_bundle.run(1000, 7)
    assert len(done.messages) > 100 and all(refused for refused, _ in done.counts.values())


def test_mutations_stay_in_bounds_of_memory():
    fuzz_bundle.run(100, 8, measure=True)


# ---- what is opened


def test_a_pin_is_the_digest_of_the_file(tmp_path):
    path = hostile_bundles.FOLDER / "ops.dressi"
    pin = hashlib.sha256(path.read_bytes()).hexdigest()
    assert bundle.read(path, pin).digest == bundle.read(path, pin.upper()).digest == pin
    with pytest.raises(BundleError, match=f"the file's SHA-256 is {pin}; the pin is {'0' * 64}"):
        bundle.read(path, "0" * 64)
    for wrong in ("", pin[:-1], pin + "0", "z" * 64, pin + "\n"):
        with pytest.raises(BundleError, match="is no SHA-256; 64 hexadecimal digits are needed"):
            bundle.read(path, wrong)
    (tmp_path / "junk").write_bytes(b"junk")
    with pytest.raises(BundleError, match="the pin is"):  # before anything is decoded
        bundle.read(tmp_path / "junk", pin)


@pytest.mark.parametrize("path", ["/dev/zero", "/", "fifo", "\0", "missing"])
def test_what_is_no_regular_file_is_not_read(tmp_path, path):
    if path == "fifo":
        os.mkfifo(tmp_path / path)
    errors = []

    def go():
        try:
            bundle.read(path if path.startswith("/") or path == "\0" else tmp_path / path)
        except BundleError as e:
            errors.append(str(e))

    thread = threading.Thread(target=go, daemon=True)
    thread.start()
    thread.join(20)
    assert errors and errors[0].isprintable()
