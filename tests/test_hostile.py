"""What is wrong with a bundle is named, whatever it is; nothing else happens. tests/fuzz_bundle.py looks for more at random."""

import hashlib
import os
import threading
import time
import tracemalloc

import fuzz_bundle
import hostile_bundles
import msgpack
import pytest

from dressi_edge.cache import bundle
from dressi_edge.cache.errors import BundleError
from dressi_edge.runtime import load, vk

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


TOKENS = {"empty_maps": b"\x80", "empty_lists": b"\x90", "maps": b"\x81\xa0\x80", "floats": b"\xcb" + b"\x11" * 8, "texts": b"\xa1a",
          "long_empty_texts": b"\xd9\0", "long_empty_lists": b"\xdc\0\0", "nested": b"\xdc\x0f\xff" * 1000 + b"\xc0"}


def worst(token: bytes, size: int) -> bytes:
    """A file with these, over and over, in a list in meta: the worst that MessagePack decodes to."""
    count = size // len(token)
    return hostile_bundles.packed(msgpack.packb({"meta": {}})[:-1] + b"\x81\xa1x\xdd" + count.to_bytes(4, "big") + token * count)


def seconds(data: bytes) -> float:
    start = time.perf_counter()
    try:
        bundle.loads(data)
    except BundleError:
        pass
    return time.perf_counter() - start


def test_refusing_takes_no_longer_than_accepting():
    """200 kB of the worst against a sound description of as many; twice the bytes take about twice as long."""
    d, blobs = hostile_bundles.vector("ops")
    draw = d["plans"][0]["stages"][0]["subpasses"][0][0]
    draw["cells"] = [[0, 0, 1, 1]] * 40_000
    good = bundle.dumps(d, blobs)
    assert bundle.loads(good).description["plans"] and len(good) > 200_000
    limit = min(seconds(good) for _ in range(3))
    for name, token in TOKENS.items():
        assert min(seconds(worst(token, 200_000)) for _ in range(3)) < 5 * limit, name
        assert min(seconds(worst(token, 400_000)) for _ in range(3)) < 10 * limit, name


def test_a_long_description_that_ended_long_ago_is_not_read_on():
    """64 MB, of which no item is in a list: 32 million of them."""
    with pytest.raises(BundleError, match="goes on after its end"):
        bundle.loads(hostile_bundles.packed(b"\xd9\0" * (1 << 25)))


@pytest.mark.parametrize("name, token", TOKENS.items())
def test_memory_is_in_proportion_to_the_file(name, token):
    data = worst(token, 200_000)
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


def test_the_bytes_that_are_checked_are_those_that_are_loaded(tmp_path, monkeypatch):
    """One opening of the file, of which everything is asked: who exchanges it in between changes nothing."""
    path, other = tmp_path / "x", tmp_path / "y"
    path.write_bytes((hostile_bundles.FOLDER / "ops.dressi").read_bytes())
    pin, real, opened = hashlib.sha256(path.read_bytes()).hexdigest(), os.open, []

    def exchange(name, *args, **options):
        handle = real(name, *args, **options)
        opened.append(name)
        other.write_bytes((hostile_bundles.FOLDER / "states.dressi").read_bytes())
        os.replace(other, path)
        return handle

    monkeypatch.setattr(os, "open", exchange)
    monkeypatch.setattr(os, "stat", lambda *_: pytest.fail("asked of the name"))
    found = bundle.read(path, pin)
    monkeypatch.undo()
    assert opened == [path] and found.digest == pin and found.description["plans"][0]["name"] == "map"
    with pytest.raises(BundleError, match="the pin is"):
        bundle.read(path, pin)
    with pytest.raises(BundleError, match="the pin is"):  # before any device is looked for
        load(path, "no such device", pin=pin)


def test_a_file_that_grows_while_it_is_read_is_not_read_on(tmp_path, monkeypatch):
    monkeypatch.setattr(bundle, "MAX_FILE_BYTES", 5)
    (tmp_path / "x").write_bytes(b"DRESSI")
    with pytest.raises(BundleError, match="it has 6 bytes; at most 5 are allowed"):
        bundle.read(tmp_path / "x")
    monkeypatch.setattr(os, "fstat", lambda handle, real=os.fstat: os.stat_result([*real(handle)[:6], 0, *real(handle)[7:10]]))
    with pytest.raises(BundleError, match="it has more than 5 bytes; at most so many are allowed"):
        bundle.read(tmp_path / "x")


@pytest.mark.parametrize("path", ["/dev/zero", "/dev/tty", "/", "fifo", "\0", "missing", "x\ny"])
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
