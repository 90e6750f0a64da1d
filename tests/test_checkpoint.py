"""Checkpoints: a run goes on bit for bit, whatever is not a whole checkpoint of this bundle is refused, and a lost device, an
interrupt or a full disk leaves the session usable or says that it is closed."""

import errno
import hashlib
import os
import signal
import struct
import subprocess
import sys
import threading
import time

import msgpack
import numpy as np
import pytest
from test_session import STATES, bits, cacheable

from dressi_edge import runtime
from dressi_edge.cache import bundle as bundles
from dressi_edge.cache.errors import BundleError, DeviceError, InputError
from dressi_edge.cache.layout import Layout
from dressi_edge.compiler import Program
from dressi_edge.runtime import checkpoint as checkpoints
from dressi_edge.runtime import vk
from dressi_edge.runtime.memory import Images, image_bytes

pytest_plugins = ["gpu", "sessions"]

ALL = (*STATES, "picture", "sum", "loss", "rate", "target")


# The same bits


@pytest.mark.parametrize("before", [0, 1, 2, 5])
@pytest.mark.parametrize("elsewhere", [0, 1], ids=["even", "odd"])
def test_a_run_goes_on_bit_for_bit_on_a_new_session(gpu, session, bundle, tmp_path, before, elsewhere):
    session.set("rate", 0.3)
    session.step(2, "rest")
    session.step(before, "walk")
    session.checkpoint(tmp_path / "c")
    at = bits(session, STATES)
    session.step(4)
    session.step(1, "rest")
    expected = bits(session, ALL if before else ALL[:-3])
    with runtime.load(bundle, gpu.device) as other:
        other.step(elsewhere)  # what it did before does not matter, nor which slot is current
        other.get("picture")
        other.restore(tmp_path / "c")
        assert other.phase == "walk" and bits(other, STATES) == at
        assert {n: other.report()["runs"][n] for n in other.phases} == {"walk": before, "rest": 2}
        if before:
            assert np.isfinite(other.get("loss"))
        else:
            with pytest.raises(InputError, match="has not run yet"):
                other.get("loss")
        other.step(4)
        other.step(1, "rest")
        assert bits(other, ALL if before else ALL[:-3]) == expected


def test_what_a_phase_gave_out_is_kept(gpu, session, bundle, tmp_path):
    session.step(3, "walk")
    loss = session.get("loss")
    session.set("rate", 0.9)
    session.checkpoint(tmp_path / "c")
    with runtime.load(bundle, gpu.device) as other:
        other.restore(tmp_path / "c")
        assert other.get("loss") == loss and other.get("rate") == np.float32(0.9)


def test_what_was_computed_from_other_inputs_is_computed_again(gpu, tmp_path):
    path = gpu.compile(cacheable())
    with runtime.load(path, gpu.device) as s, runtime.load(path, gpu.device) as other:
        s.set("x", np.full((5, 7, 3), 0.25))
        s.step(3, "go")
        s.checkpoint(tmp_path / "c")
        s.step(2)
        other.step(3, "go")
        other.get("shown")
        other.restore(tmp_path / "c")
        other.step(2)
        for name in ("v", "w", "shown", "still", "level", "loss"):
            assert s.get(name).tobytes() == other.get(name).tobytes(), name
    gpu.silent()


def test_an_input_that_nobody_had_set_is_unset_again(gpu, tmp_path):
    p = Program()
    x, y = p.input("x", Layout("unit", "float")), p.state("y", Layout("unit", "float"), 1.0)
    p.plan("add", {"y": x + y})
    with gpu.open(p) as s:
        s.checkpoint(tmp_path / "c")
        s.set("x", 2.0)
        s.step(1)
        s.restore(tmp_path / "c")
        assert s.get("y") == 1
        with pytest.raises(InputError, match="needs x; set it first"):
            s.step(1)
    gpu.silent()


def test_what_was_made_of_an_input_that_is_unset_again_is_no_more(gpu, tmp_path):
    p, unit = Program(), Layout("unit", "float")
    x, y = p.input("x", unit), p.state("y", unit, 1.0)
    p.plan("add", {"y": y + 1.0})
    p.plan("show", {}, {"twice": (x * 2.0, unit)})
    with gpu.open(p) as s:
        s.checkpoint(tmp_path / "c")
        s.set("x", 2.0)
        assert s.get("twice") == 4
        s.restore(tmp_path / "c")
        for _ in range(2):
            with pytest.raises(InputError, match="^show needs x; set it first$"):
                s.get("twice")
        s.set("x", 3.0)
        assert s.get("twice") == 6
    gpu.silent()


# Files


@pytest.fixture
def whole(session, tmp_path):
    session.step(3, "walk")
    session.checkpoint(tmp_path / "c")
    return (tmp_path / "c").read_bytes()


def remade(data, **changes):
    """The same checkpoint with another description and a right checksum."""
    _, _, size, digest, _ = checkpoints.HEADER.unpack_from(data)
    start = checkpoints.HEADER.size
    text = msgpack.packb({**msgpack.unpackb(data[start:start + size]), **changes})
    rest = text + data[start + size:]
    return checkpoints.HEADER.pack(checkpoints.MAGIC, 1, len(text), digest, hashlib.sha256(rest).digest()) + rest


BAD = {
    "empty": (lambda d: b"", "0 bytes; a checkpoint has at least 80"),
    "other": (lambda d: b"DRESSI\r\n" + d[8:], "not a checkpoint"),
    "version": (lambda d: d[:8] + struct.pack("<I", 2) + d[12:], "version 2; this reader knows 1"),
    "flipped": (lambda d: d[:-9] + bytes([d[-9] ^ 1]) + d[-8:], "checksum does not match"),
    "short": (lambda d: d[:-1], "checksum does not match"),
    "long": (lambda d: d + b"\0", "checksum does not match"),
    "huge": (lambda d: d + bytes(2 << 20), "more than the"),
    "bundle": (lambda d: d[:16] + bytes(32) + d[48:], "belongs to the bundle with SHA-256 0000"),
    "description": (lambda d: d[:12] + struct.pack("<I", 1 << 31) + d[16:], "a description of 2147483648 bytes"),
    "no map": (lambda d: d[:12] + struct.pack("<I", 1) + d[16:], "not that of a checkpoint"),
    "phase": (lambda d: remade(d, phase="jump"), "not those of this bundle"),
    "no phase": (lambda d: remade(d, phase=None), "not those of this bundle"),
    "runs": (lambda d: remade(d, runs={"walk": 3}), "not those of this bundle"),
    "negative": (lambda d: remade(d, runs={"walk": -3, "rest": 0}), "not that of a checkpoint"),
    "never ran": (lambda d: remade(d, runs={"walk": 0, "rest": 0}), "not those of this bundle"),
    "values": (lambda d: remade(d, values=[]), "values of 0 bytes are named"),
    "extra": (lambda d: remade(d, more=1), "not that of a checkpoint"),
}


@pytest.mark.parametrize("make, message", BAD.values(), ids=BAD)
def test_what_is_no_checkpoint_of_this_bundle_changes_nothing(session, whole, tmp_path, make, message):
    before = bits(session)
    (tmp_path / "bad").write_bytes(make(whole))
    with pytest.raises(BundleError, match=message) as error:
        session.restore(tmp_path / "bad")
    assert str(tmp_path / "bad") in str(error.value) and "\n" not in str(error.value)
    assert bits(session) == before
    session.restore(tmp_path / "c")


@pytest.mark.parametrize("kind", ["fifo", "/dev/zero", "/dev/tty", "link to a fifo", "\0"])
def test_what_is_no_regular_file_is_refused_without_waiting(session, tmp_path, kind):
    path = tmp_path / "c" if "fifo" in kind else kind
    if "fifo" in kind:
        os.mkfifo(tmp_path / "fifo")
        os.symlink("fifo", path) if "link" in kind else os.rename(tmp_path / "fifo", path)
    before, told = bits(session), []

    def go():
        with pytest.raises(InputError, match="the checkpoint cannot be read: ") as error:
            session.restore(path)
        told.append(str(error.value))

    thread = threading.Thread(target=go, daemon=True)
    thread.start()
    thread.join(20)
    assert told and bits(session) == before


def numbers(data, name, change):
    """The checkpoint with the bytes of a value changed."""
    start = checkpoints.HEADER.size
    _, _, size, digest, _ = checkpoints.HEADER.unpack_from(data)
    at = start + size
    for other, count in msgpack.unpackb(data[start:at])["values"]:
        if other == name:
            data = data[:at] + change(data[at:at + count]) + data[at + count:]
        at += count
    return checkpoints.HEADER.pack(checkpoints.MAGIC, 1, size, digest, hashlib.sha256(data[start:]).digest()) + data[start:]


@pytest.mark.parametrize("name", ["a", "rate"])
@pytest.mark.parametrize("number", [np.nan, -np.inf])
def test_numbers_that_set_refuses_restore_refuses(session, whole, tmp_path, name, number):
    before = bits(session)
    (tmp_path / "bad").write_bytes(numbers(whole, name, lambda data: np.float32(number).tobytes() + data[4:]))
    with pytest.raises(BundleError, match=f"bad: {name} has 1 values that are NaN or Inf; finite numbers are needed"):
        session.restore(tmp_path / "bad")
    assert bits(session) == before


def test_what_nobody_sees_of_an_image_may_be_anything(session, whole, tmp_path):
    """The fourth channel of three, texels after the last entry, integers of any bits."""
    padded = numbers(whole, "a", lambda data: data[:12] + np.float32(np.nan).tobytes() + data[16:-4] + np.float32(np.inf).tobytes())
    (tmp_path / "padded").write_bytes(numbers(padded, "t", lambda data: np.float32(np.nan).tobytes()))
    before = session.get("a")
    session.restore(tmp_path / "padded")
    assert session.get("a").tobytes() == before.tobytes() and session.get("t") == np.float32(np.nan).view(np.int32)


def test_a_run_that_diverged_leaves_the_last_checkpoint_that_is_of_use(gpu, tmp_path):
    p = Program()
    x = p.state("x", Layout("unit", "float"), 1e30)
    p.plan("grow", {"x": x * 1e9})
    with gpu.open(p) as s:
        s.checkpoint(tmp_path / "c")
        s.step(1)
        with pytest.raises(InputError, match="c: the checkpoint is not written: x has 1 values that are NaN or Inf"):
            s.checkpoint(tmp_path / "c")
        s.restore(tmp_path / "c")
        assert s.get("x") == np.float32(1e30)
    gpu.silent()


def test_no_byte_of_the_file_can_change_unseen(bundle, session, whole):
    for at in range(0, len(whole), max(1, len(whole) // 400)):
        for data in (whole[:at], whole[:at] + bytes([whole[at] ^ 0x20]) + whole[at + 1:]):
            try:
                found = checkpoints.loads(data, session.bundle.digest)
            except BundleError:
                continue
            assert 12 <= at < 16, at  # the length of the description: read otherwise, and not what the bundle has
            assert set(found.values) != set(ALL)


def test_another_bundle_refuses_it(gpu, whole, tmp_path):
    with gpu.open(cacheable()) as other, pytest.raises(BundleError, match="belongs to the bundle"):
        other.restore(tmp_path / "c")


def test_files_that_cannot_be_are_named(session, tmp_path):
    before = bits(session)
    with pytest.raises(InputError, match="nothing: the checkpoint cannot be read: No such file"):
        session.restore(tmp_path / "nothing")
    with pytest.raises(InputError, match="cannot be read: Is a directory"):
        session.restore(tmp_path)
    with pytest.raises(InputError, match="cannot be written: No such file"):
        session.checkpoint(tmp_path / "no" / "c")
    with pytest.raises(InputError, match="cannot be written"):
        session.checkpoint(tmp_path)
    assert bits(session) == before and list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_a_full_disk_leaves_the_old_checkpoint(session, whole, tmp_path, monkeypatch, call):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    session.step(1)
    with monkeypatch.context() as m:
        m.setattr(os, call, full)
        with pytest.raises(InputError, match="cannot be written: No space left on device"):
            session.checkpoint(tmp_path / "c")
    assert (tmp_path / "c").read_bytes() == whole and [p.name for p in tmp_path.iterdir()] == ["c"]
    session.checkpoint(tmp_path / "c")
    assert (tmp_path / "c").read_bytes() != whole


KILLED = """
import sys
from dressi_edge import runtime
with runtime.load(sys.argv[1], "llvmpipe") as s:
    while True:
        s.step(1)
        s.checkpoint(sys.argv[2])
        print(flush=True)
"""


def test_a_process_killed_while_it_writes_leaves_a_whole_checkpoint(gpu, bundle, session, tmp_path):
    for wait in (0.0, 0.003, 0.01):
        child = subprocess.Popen([sys.executable, "-c", KILLED, str(bundle), str(tmp_path / "c")], stdout=subprocess.PIPE,
                                 env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)})
        child.stdout.readline()
        time.sleep(wait)
        child.kill()
        child.wait()
        child.stdout.close()
        session.restore(tmp_path / "c")
        assert session.get("t") >= 1


# Trouble


def lost(*_, **__):
    raise vk.VulkanError("vkFake", vk.VK_ERROR_DEVICE_LOST)


@pytest.mark.parametrize("call", ["QueueSubmit", "WaitForFences", "ResetFences", "BeginCommandBuffer", "CreateBuffer"])
def test_a_lost_device_closes_the_session_and_the_last_checkpoint_goes_on(gpu, bundle, tmp_path, monkeypatch, call):
    s = runtime.load(bundle, gpu.device)
    s.step(3)
    s.checkpoint(tmp_path / "c")
    s.step(2)
    expected = bits(s, ALL)
    s._staging.close()  # so that a buffer is made
    with monkeypatch.context() as m:
        m.setattr(vk, call, lost)
        with pytest.raises(DeviceError, match="the session is closed: .* was lost .*restore the last checkpoint"):
            s.get("picture")
    for again in (lambda: s.step(1), lambda: s.get("a"), lambda: s.checkpoint(tmp_path / "c"), s.report):
        with pytest.raises(DeviceError, match="closed: .* was lost"):
            again()
    s.close()
    with runtime.load(bundle, gpu.device) as new:
        new.restore(tmp_path / "c")
        new.step(2)
        assert bits(new, ALL) == expected
    gpu.silent()


@pytest.mark.parametrize("call", ["QueueSubmit", "AllocateCommandBuffers", "CreateGraphicsPipelines"])
def test_a_device_lost_while_loading_is_said(gpu, bundle, monkeypatch, call):
    with monkeypatch.context() as m:
        m.setattr(vk, call, lost)
        with pytest.raises(DeviceError, match="was lost .*open it again"):
            runtime.load(bundle, gpu.device)
    gpu.silent()


def full(*_, **__):
    raise vk.VulkanError("vkFake", vk.VK_ERROR_OUT_OF_DEVICE_MEMORY)


@pytest.mark.parametrize("call", ["CreateImage", "AllocateMemory", "BindImageMemory", "CreateImageView"])
def test_memory_that_is_not_there_is_said_when_loading(gpu, bundle, monkeypatch, call):
    with monkeypatch.context() as m:
        m.setattr(vk, call, full)
        with pytest.raises(DeviceError, match="no memory for the images of this bundle"):
            runtime.load(bundle, gpu.device)
    gpu.silent()


def test_images_beyond_the_memory_of_the_device_are_refused_before_any_is_made(gpu, bundle, monkeypatch):
    """First by their texels, which every device needs at least; then by what the driver asks for them."""
    images = bundles.read(bundle).description["images"]
    texels = sum(image_bytes(r) * r["slots"] for r in images)

    def called(*_):
        raise AssertionError("something was made")

    for size, forbidden, told in ((texels - 1, "CreateImage", "its images need .* MB; llvmpipe.* has .* MB of memory for them"),
                                  (texels, "AllocateMemory", "images of this bundle need .* MB; llvmpipe.* has .* MB .heap 0.; compile")):
        with monkeypatch.context() as m:
            m.setattr(gpu.device, "heaps", [(size, 1)])
            m.setattr(vk, forbidden, called)
            with pytest.raises(DeviceError, match=told):
                runtime.load(bundle, gpu.device)
            with pytest.raises(DeviceError, match=told.replace("llvmpipe.*", "llvmpipe.* as lavapipe")):
                runtime.load(bundle, gpu.device, emulate="lavapipe")
    gpu.silent()


def test_many_tiny_images_are_weighed_before_they_are_made(gpu, monkeypatch):
    """A driver takes far more for each than its texels are: one of each kind tells how much."""
    made, real = [], vk.CreateImage
    monkeypatch.setattr(vk, "CreateImage", lambda *args: made.append(args) or real(*args))
    record = {"format": 100, "width": 1, "height": 1, "slots": 2, "usage": 23, "data": None}
    with monkeypatch.context() as m:
        m.setattr(gpu.device, "heaps", [(1 << 20, 1)])
        with pytest.raises(DeviceError, match="the images of this bundle need .* MB; llvmpipe.* has 1.0 MB"):
            Images(gpu.device, [record] * 60_000, 126)
    assert len(made) == 1
    images = Images(gpu.device, [record, record], 126)
    assert len(made) == 6 and images.bytes > 0
    images.close()
    gpu.silent()


@pytest.mark.parametrize("call", ["QueueSubmit", "BeginCommandBuffer", "CmdPipelineBarrier", "CreateBuffer", "AllocateMemory",
                                  "MapMemory", "CreateFramebuffer", "CreateDescriptorPool", "AllocateDescriptorSets"])
def test_a_call_that_fails_leaves_the_session_usable(gpu, bundle, session, tmp_path, monkeypatch, call):
    failed = 0
    with runtime.load(bundle, gpu.device) as s:
        for work in (lambda: s.set("rate", 0.5), lambda: s.step(3, "walk"), lambda: s.get("picture"),
                     lambda: s.checkpoint(tmp_path / "c")):
            s._staging.close()
            with monkeypatch.context() as m:
                m.setattr(vk, call, full)
                try:
                    work()
                except DeviceError as error:
                    assert "VK_ERROR_OUT_OF_DEVICE_MEMORY" in str(error)
                    failed += 1
        assert failed
        s.set("rate", 0.5)
        t = int(s.get("t"))
        s.step(3, "walk")
        assert s.get("t") == t + 3
    gpu.silent()


# Interrupts


@pytest.mark.parametrize("call", ["QueueSubmit", "WaitForFences", "ResetFences", "BeginCommandBuffer", "EndCommandBuffer",
                                  "ResetCommandBuffer", "CmdCopyImageToBuffer", "CmdDraw"])
@pytest.mark.parametrize("after", [False, True], ids=["before", "after"])
def test_an_interrupt_around_any_call_loses_and_doubles_nothing(gpu, bundle, monkeypatch, call, after):
    with runtime.load(bundle, gpu.device) as expected, runtime.load(bundle, gpu.device) as s:
        real, armed = getattr(vk, call), []

        def interrupted(*args, **options):
            if armed:
                armed.clear()
                if after:
                    real(*args, **options)
                raise KeyboardInterrupt
            return real(*args, **options)

        monkeypatch.setattr(vk, call, interrupted)
        for n, work in ((1, lambda: s.step(1)), (3, lambda: s.step(3)), (0, lambda: s.get("a")), (0, lambda: s.get("picture")),
                        (0, lambda: s.set("rate", s.get("rate")))):
            armed.append(True)
            try:
                work()
            except KeyboardInterrupt:
                pass
            armed.clear()
            s.report()
            done = int(s.get("t")) - int(expected.get("t"))
            assert done in (0, n)
            expected.step(done)
            assert bits(s, STATES) == bits(expected, STATES)
            assert s.report()["runs"]["walk"] == expected.report()["runs"]["walk"]
        s.step(2)
        expected.step(2)
        assert bits(s) == bits(expected)
    gpu.silent()


def test_a_real_interrupt_stops_a_long_step_soon(gpu, session):
    session.step(1)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a process in the background may have it ignored
    timer = threading.Timer(0.3, signal.raise_signal, [signal.SIGINT])
    timer.start()
    start = time.perf_counter()
    with pytest.raises(KeyboardInterrupt):
        session.step(10 ** 9, "walk", seconds=60)
    assert time.perf_counter() - start < 20
    timer.join()
    signal.signal(signal.SIGINT, before)
    assert session.get("t") == session.report()["runs"]["walk"] > 1
