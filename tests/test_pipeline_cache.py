"""Compiled pipelines kept on disk: only whole files of the same device come back, and no folder however broken is an error."""

import itertools
import os
import stat
import struct
import subprocess
import sys
import textwrap
import time

import numpy as np
import pytest

from dressi_edge import runtime
from dressi_edge.cache import pipeline_cache as cache
from dressi_edge.cache.layout import Layout
from dressi_edge.compiler import Program, compile_program
from dressi_edge.runtime import vk
from dressi_edge.runtime.device import Device

UUID = bytes(range(16))


def a_key(bundle="b" * 64, vendor=0x10005, device=0, version=1, uuid=UUID, driver="Mesa 22.3.6"):
    return cache.key(bundle, vendor, device, version, uuid, "llvmpipe", driver)


def a_blob(body=b"pipelines" * 100, vendor=0x10005, device=0, uuid=UUID, size=32, version=1):
    return struct.pack("<IIII16s", size, version, vendor, device, uuid) + body


def the_file(folder):
    path, = folder.glob(f"*{cache.SUFFIX}")
    return path


# ---- files

def test_what_was_stored_comes_back(tmp_path):
    folder, k = tmp_path / "made" / "on demand", a_key()
    assert cache.load(folder, k) is None
    assert cache.store(folder, k, a_blob()) == ""
    assert cache.load(folder, k) == a_blob()
    assert cache.store(folder, k, a_blob(b"more")) == "" and cache.load(folder, k) == a_blob(b"more")
    assert os.listdir(folder) == [k.file]


@pytest.mark.parametrize("changed", [dict(bundle="c" * 64), dict(vendor=1), dict(device=1), dict(version=2),
                                     dict(uuid=b"x" * 16), dict(driver="Mesa 23.0.0")], ids=lambda d: next(iter(d)))
def test_every_part_of_the_key_counts(tmp_path, changed):
    cache.store(tmp_path, a_key(), a_blob())
    assert cache.load(tmp_path, a_key(**changed)) is None
    os.rename(the_file(tmp_path), tmp_path / a_key(**changed).file)  # the name alone does not make it another's
    assert cache.load(tmp_path, a_key(**changed)) is None


def test_parts_of_the_key_do_not_run_together():
    assert cache.key("a", 1, 2, 3, UUID, "x", "yz").digest != cache.key("a", 1, 2, 3, UUID, "xy", "z").digest
    assert cache.key("a", 1, 2, 3, UUID.hex(), "x") == cache.key("a", 1, 2, 3, UUID, "x")


@pytest.mark.parametrize("length", [0, 1, 8, cache.HEADER.size - 1, cache.HEADER.size, cache.HEADER.size + 31, -1])
def test_a_truncated_file_is_ignored(tmp_path, length):
    cache.store(tmp_path, a_key(), a_blob())
    path = the_file(tmp_path)
    path.write_bytes(path.read_bytes()[:length])
    assert cache.load(tmp_path, a_key()) is None
    assert cache.store(tmp_path, a_key(), a_blob()) == "" and cache.load(tmp_path, a_key()) == a_blob()


def test_a_file_with_any_byte_changed_is_ignored(tmp_path):
    cache.store(tmp_path, a_key(), a_blob(b"body"))
    path = the_file(tmp_path)
    whole = path.read_bytes()
    for at in range(len(whole)):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 0x40]) + whole[at + 1:])
        assert cache.load(tmp_path, a_key()) is None, at
    path.write_bytes(whole + b"\0")
    assert cache.load(tmp_path, a_key()) is None


@pytest.mark.parametrize("blob", [a_blob(vendor=0x10DE), a_blob(device=7), a_blob(uuid=b"x" * 16), a_blob(version=2),
                                  a_blob(size=31), a_blob(size=1 << 31), a_blob(b"", size=33), a_blob()[:31], b""],
                         ids=["vendor", "device", "uuid", "version", "small", "huge", "longer", "short", "nothing"])
def test_a_blob_that_is_not_of_this_device_is_neither_kept_nor_given_out(tmp_path, monkeypatch, blob):
    assert "not of this device" in cache.store(tmp_path, a_key(), blob) and not os.listdir(tmp_path)
    with monkeypatch.context() as m:
        m.setattr(cache, "belongs", lambda data, k: True)
        assert cache.store(tmp_path, a_key(), blob) == ""
    assert cache.load(tmp_path, a_key()) is None


def test_a_longer_header_of_the_driver_is_accepted(tmp_path):
    assert cache.store(tmp_path, a_key(), a_blob(size=40)) == "" and cache.load(tmp_path, a_key()) == a_blob(size=40)


def test_a_folder_or_pipe_in_place_of_the_file_is_ignored(tmp_path):
    path = tmp_path / a_key().file
    path.mkdir()
    assert cache.load(tmp_path, a_key()) is None
    assert cache.store(tmp_path, a_key(), a_blob()) != "" and os.listdir(tmp_path) == [a_key().file]
    path.rmdir()
    if hasattr(os, "mkfifo"):
        os.mkfifo(path)
        assert cache.load(tmp_path, a_key()) is None  # and does not wait


# ---- the folder

def test_files_used_least_recently_go_first(tmp_path):
    blob, keys = a_blob(bytes(1000)), [a_key(bundle=c) for c in "abcde"]
    size = cache.HEADER.size + len(blob)
    for age, k in enumerate(reversed(keys[:4])):  # a is the oldest
        cache.store(tmp_path, k, blob)
        os.utime(tmp_path / k.file, (1e9 - age, 1e9 - age))
    assert cache.load(tmp_path, keys[0]) == blob  # a is used again
    assert cache.store(tmp_path, keys[4], blob, limit=3 * size) == ""
    assert [c for c, k in zip("abcde", keys) if cache.load(tmp_path, k)] == ["a", "d", "e"]


def test_a_file_is_touched_when_it_is_used(tmp_path):
    cache.store(tmp_path, a_key(), a_blob())
    os.utime(the_file(tmp_path), (1e9, 1e9))
    cache.load(tmp_path, a_key())
    assert the_file(tmp_path).stat().st_mtime > time.time() - 60


def test_a_blob_beyond_the_limit_is_not_kept_and_drives_nobody_out(tmp_path):
    cache.store(tmp_path, a_key(), a_blob())
    assert "allowed" in cache.store(tmp_path, a_key(bundle="large"), a_blob(bytes(5000)), limit=4000)
    assert cache.load(tmp_path, a_key()) == a_blob()


def test_only_our_own_files_are_removed(tmp_path):
    (tmp_path / "photo.jpg").write_bytes(bytes(5000))
    old, new = tmp_path / f".1-a{cache.SUFFIX}", tmp_path / f".1-b{cache.SUFFIX}"
    for path in (old, new):
        path.write_bytes(b"unfinished")
    os.utime(old, (1e9, 1e9))
    cache.store(tmp_path, a_key(), a_blob(), limit=2000)
    assert (tmp_path / "photo.jpg").exists() and new.exists() and not old.exists() and cache.load(tmp_path, a_key())


@pytest.fixture
def unwritable(tmp_path):
    """A folder below which nothing can be made, for root too: it is a file."""
    path = tmp_path / "file"
    path.write_bytes(b"")
    return path / "folder"


def test_a_folder_that_cannot_be_made_is_no_error(unwritable):
    assert "Not a directory" in cache.store(unwritable, a_key(), a_blob()) and cache.load(unwritable, a_key()) is None


@pytest.mark.skipif(os.name == "nt" or os.geteuid() == 0, reason="root may write anywhere, and Windows has other rights")
def test_a_read_only_folder_still_gives_out(tmp_path):
    cache.store(tmp_path, a_key(), a_blob())
    tmp_path.chmod(0o500)
    try:
        assert cache.load(tmp_path, a_key()) == a_blob()
        assert "Permission denied" in cache.store(tmp_path, a_key(bundle="other"), a_blob())
    finally:
        tmp_path.chmod(0o700)


@pytest.mark.parametrize("error", [PermissionError(13, "Permission denied"), OSError(30, "Read-only file system")],
                         ids=["EACCES", "EROFS"])
def test_a_folder_that_refuses_writing_still_gives_out(tmp_path, monkeypatch, error):
    cache.store(tmp_path, a_key(), a_blob())

    def refuse(*args, **kwargs):
        raise error

    def read_only(name, flags, *args, real=os.open):
        return refuse() if flags & os.O_WRONLY else real(name, flags, *args)

    monkeypatch.setattr(os, "open", read_only)
    for name in ("utime", "replace", "unlink", "makedirs"):
        monkeypatch.setattr(os, name, refuse)
    assert cache.load(tmp_path, a_key()) == a_blob()
    assert error.strerror in cache.store(tmp_path, a_key(), a_blob(b"new")) and cache.load(tmp_path, a_key()) == a_blob()


def test_a_full_disk_leaves_the_old_file_and_no_unfinished_one(tmp_path, monkeypatch):
    cache.store(tmp_path, a_key(), a_blob())

    class Full:
        def __enter__(self):
            return self

        def __exit__(self, *exception):
            return False

        def write(self, data):
            raise OSError(28, "No space left on device")

    def full(name, *args, **kwargs):
        if isinstance(name, int):
            os.close(name)
            return Full()
        return open(name, *args, **kwargs)

    monkeypatch.setattr(cache, "open", full, raising=False)
    assert "No space left" in cache.store(tmp_path, a_key(), a_blob(b"new"))
    assert cache.load(tmp_path, a_key()) == a_blob() and os.listdir(tmp_path) == [a_key().file]


@pytest.mark.skipif(os.name == "nt", reason="Windows keeps rights elsewhere")
def test_nobody_else_may_read_or_replace_the_files(tmp_path):
    cache.store(tmp_path / "folder", a_key(), a_blob())
    assert stat.S_IMODE((tmp_path / "folder").stat().st_mode) & 0o077 == 0
    assert stat.S_IMODE(the_file(tmp_path / "folder").stat().st_mode) & 0o077 == 0


# ---- who else could have written it

rights = pytest.mark.skipif(os.name == "nt", reason="Windows keeps rights elsewhere")
other = pytest.mark.skipif(os.name == "nt" or os.geteuid() != 0, reason="only root may give files away")
OTHER = 54321


@pytest.fixture
def folder(tmp_path):
    """A folder of ours with a file in it, in one that is ours."""
    path = tmp_path / "outer" / "folder"
    assert cache.store(path, a_key(), a_blob()) == "" and cache.load(path, a_key()) == a_blob()
    return path


def foreign(folder, told):
    """Nothing of this folder reaches a driver, nothing is put into it, and it is said why."""
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert told in cache.distrusted(folder) and "DRESSI_CACHE" in cache.distrusted(folder)
    assert cache.load(folder, a_key()) is None
    assert cache.store(folder, a_key(), a_blob(b"new")) == cache.distrusted(folder)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


@rights
@pytest.mark.parametrize("mode", [0o777, 0o1777, 0o770, 0o722, 0o702])
def test_a_folder_that_others_may_write_to_is_not_trusted(folder, mode):
    folder.chmod(mode)
    foreign(folder, f"{folder} can be written to by others")
    folder.chmod(0o755)  # to be read by others is fine
    assert cache.load(folder, a_key()) == a_blob()


@rights
@pytest.mark.parametrize("mode", [0o777, 0o707])
def test_a_folder_that_others_could_exchange_is_not_trusted(folder, mode):
    folder.parent.chmod(mode)
    foreign(folder, f"{folder.parent} can be written to by others")
    folder.parent.chmod(0o1777)  # as /tmp: only the owner may move what is his
    assert cache.distrusted(folder) == "" and cache.load(folder, a_key()) == a_blob()


@rights
def test_a_link_that_others_could_turn_is_not_trusted(folder, tmp_path):
    (tmp_path / "open").mkdir()
    (tmp_path / "open" / "link").symlink_to(folder)
    assert cache.load(tmp_path / "open" / "link", a_key()) == a_blob()
    (tmp_path / "open").chmod(0o777)
    assert cache.load(folder, a_key()) == a_blob()
    assert f"{tmp_path / 'open'} can be written to by others" in cache.distrusted(tmp_path / "open" / "link")
    assert cache.load(tmp_path / "open" / "link", a_key()) is None
    folder.chmod(0o777)
    (tmp_path / "open").chmod(0o755)
    foreign(tmp_path / "open" / "link", f"{folder} can be written to by others")


@rights
@pytest.mark.parametrize("mode", [0o666, 0o660, 0o606, 0o622])
def test_a_file_that_others_may_write_to_is_ignored_and_replaced(folder, mode):
    the_file(folder).chmod(mode)
    assert cache.load(folder, a_key()) is None
    assert cache.store(folder, a_key(), a_blob(b"new")) == "" and cache.load(folder, a_key()) == a_blob(b"new")


@rights
def test_a_link_in_place_of_the_file_is_ignored_and_replaced(folder, tmp_path):
    path = the_file(folder)
    path.rename(tmp_path / "elsewhere")
    path.symlink_to(tmp_path / "elsewhere")
    assert cache.load(folder, a_key()) is None
    assert cache.store(folder, a_key(), a_blob(b"new")) == "" and cache.load(folder, a_key()) == a_blob(b"new")
    assert (tmp_path / "elsewhere").read_bytes().endswith(a_blob())


@other
def test_what_belongs_to_another_is_not_trusted(folder):
    path = the_file(folder)
    os.chown(path, OTHER, OTHER)
    assert cache.load(folder, a_key()) is None
    assert cache.store(folder, a_key(), a_blob()) == "" and cache.load(folder, a_key()) == a_blob()
    for place in (folder, folder.parent):
        os.chown(place, OTHER, OTHER)
        foreign(folder, f"{place} belongs to another user ({OTHER})")
        os.chown(place, 0, 0)


@other
def test_the_private_group_of_the_user_is_the_user(folder):
    os.chown(folder.parent, 0, OTHER)
    folder.parent.chmod(0o775)
    foreign(folder, f"{folder.parent} can be written to by others")
    os.chown(folder.parent, 0, 0)
    assert cache.load(folder, a_key()) == a_blob()


@rights
def test_a_session_says_why_it_keeps_nothing(bundle, tmp_path, monkeypatch):
    tmp_path.chmod(0o777)
    monkeypatch.setenv("DRESSI_CACHE", str(tmp_path))
    monkeypatch.setattr(vk, "CreatePipelineCache", lambda *_: pytest.fail("the driver was asked"))
    assert fitted(bundle)[1] == f"off ({cache.distrusted(tmp_path)})" and list(tmp_path.iterdir()) == []


def test_four_processes_in_one_folder_never_see_half_a_file(tmp_path):
    """Each stores and loads blobs of many sizes under three keys, in a folder that has room for two of them."""
    code = textwrap.dedent(f"""
        import sys, time
        sys.path[:0] = {[p for p in sys.path if p]!r}
        from test_pipeline_cache import a_blob, a_key, cache
        me, seen = int(sys.argv[1]), 0
        for turn in range(150):
            k = a_key(bundle=str(turn % 3))
            why = cache.store({str(tmp_path)!r}, k, a_blob(bytes([me]) * (20000 + 997 * (turn % 40))), limit=130000)
            assert why == "", why
            k = a_key(bundle=str(turn * 7 % 3))
            data = cache.load({str(tmp_path)!r}, k)
            if data is not None:
                assert len(set(data[32:])) == 1 and (len(data) - 20032) % 997 == 0
                seen += 1
        print(seen)
    """)
    workers = [subprocess.Popen([sys.executable, "-c", code, str(k)], stdout=subprocess.PIPE, text=True) for k in range(4)]
    seen = [int(w.communicate(timeout=120)[0] or -1) for w in workers]
    assert all(w.returncode == 0 for w in workers) and sum(seen) > 100
    keys = {a_key(bundle=str(k)).file: a_key(bundle=str(k)) for k in range(3)}
    assert all(cache.load(tmp_path, keys[name]) for name in os.listdir(tmp_path))


# ---- where

def test_the_environment_chooses_the_folder(monkeypatch, tmp_path):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("USERPROFILE", str(tmp_path))
    for name in ("DRESSI_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    assert cache.default_folder() == (os.path.join(tmp_path, ".cache", "dressi_edge"), "")
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    assert cache.default_folder() == (os.path.join(tmp_path, ".cache", "dressi_edge"), "")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    assert cache.default_folder() == (os.path.join(tmp_path, "xdg", "dressi_edge"), "")
    monkeypatch.setenv("DRESSI_CACHE", str(tmp_path / "mine"))
    assert cache.default_folder() == (str(tmp_path / "mine"), "")
    monkeypatch.setenv("DRESSI_CACHE", "off")
    assert cache.default_folder() == (None, "DRESSI_CACHE=off")


@pytest.mark.parametrize("system, environment, folder", [
    ("darwin", {}, ("Library", "Caches", "dressi_edge")), ("win32", {}, ("AppData", "Local", "dressi_edge", "cache")),
    ("win32", {"LOCALAPPDATA": "local"}, ("local", "dressi_edge", "cache")), ("linux", {}, (".cache", "dressi_edge"))])
def test_each_system_has_a_place_for_caches(monkeypatch, tmp_path, system, environment, folder):
    for name in ("DRESSI_CACHE", "XDG_CACHE_HOME", "LOCALAPPDATA"):
        monkeypatch.delenv(name, raising=False)
    for name in ("HOME", "USERPROFILE"):
        monkeypatch.setenv(name, str(tmp_path))
    for name, value in environment.items():
        monkeypatch.setenv(name, str(tmp_path / value))
    monkeypatch.setattr(cache.sys, "platform", system)
    assert cache.default_folder() == (os.path.join(tmp_path, *folder), "")


# ---- a session

@pytest.fixture(scope="module")
def bundle(tmp_path_factory):
    path = tmp_path_factory.mktemp("bundle") / "sum.dressi"
    layout, program = Layout("image", "float", 16, 8), Program()
    x, target = program.state("x", layout, 0.5), program.input("target", layout, np.linspace(0, 1, 128).reshape(8, 16))
    program.plan("fit", {"x": x - (x - target) * 0.25})
    compile_program(program, "lavapipe", path)
    return path


def fitted(path):
    with Device.open(validation=True) as device:
        with runtime.load(path, device) as session:
            session.step(3)
            out = session.get("x"), session.report()["pipeline_cache"]
    assert device.messages == []
    return out


def test_results_do_not_depend_on_the_cache(bundle, tmp_path, monkeypatch):
    monkeypatch.setenv("DRESSI_CACHE", "off")
    off, state = fitted(bundle)
    assert state == "off (DRESSI_CACHE=off)"
    monkeypatch.setenv("DRESSI_CACHE", str(tmp_path / "folder"))
    states = []
    for _ in range(2):
        on, state = fitted(bundle)
        states.append(state)
        assert on.tobytes() == off.tobytes()
    assert states == ["stored", "hit"] or [s[:5] for s in states] == ["empty"] * 2


@pytest.fixture
def talkative(monkeypatch):
    """A driver that puts something into its cache, late: Vulkan's header and eight bytes more each time it is asked. `given`:
    what it was handed."""
    given, turns, real = [], itertools.count(1), vk.GetPipelineCacheData

    def create(device, info, real=vk.CreatePipelineCache):
        given.append(info.initialDataSize)
        return real(device, vk.VkPipelineCacheCreateInfo())

    monkeypatch.setattr(vk, "CreatePipelineCache", create)
    monkeypatch.setattr(vk, "GetPipelineCacheData", lambda *args: real(*args)[:32] + bytes(8 * next(turns)))
    return given


def test_what_the_driver_compiled_late_is_kept_and_handed_to_the_next_session(bundle, tmp_path, monkeypatch, talkative):
    monkeypatch.setenv("DRESSI_CACHE", str(tmp_path))
    assert fitted(bundle)[1] == "stored" and fitted(bundle)[1] == "hit"
    assert talkative == [0, 32 + 16]  # 8 after creation, 8 more after the first step
    path = the_file(tmp_path)
    path.write_bytes(path.read_bytes()[:-1])
    assert fitted(bundle)[1] == "stored" and talkative[2] == 0  # the driver never saw it
    (tmp_path / path.name).unlink()
    monkeypatch.setenv("DRESSI_CACHE", str(bundle / "folder"))
    assert fitted(bundle)[1].startswith("off (") and "Not a directory" in fitted(bundle)[1]
