"""Shaders on disk: the same code from process to process, and nothing that is damaged or not ours."""
import os

import pytest

from dressi_edge.compiler.backend import spirv, spirv_cache

SHADER = ("frag", "#version 450\nlayout(location = 0) out vec4 o0;\nvoid main() { o0 = vec4(0.25); }\n")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A cache of its own, and a compiler that has compiled nothing yet."""
    monkeypatch.setenv("DRESSI_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(spirv, "_compiled", {})
    return tmp_path / "cache" / "shaders"


def compiled(monkeypatch, allowed=True):
    """The code of SHADER as another process would get it."""
    monkeypatch.setattr(spirv, "_compiled", {})
    if not allowed:
        monkeypatch.setattr(spirv, "_compile_some", lambda glslc, jobs: pytest.fail("a shader is compiled that is on disk"))
    return spirv.compile_all([SHADER])[SHADER]


def test_the_second_process_compiles_nothing(folder, monkeypatch):
    code = compiled(monkeypatch)
    assert [f.suffix for f in folder.iterdir()] == [spirv_cache.SUFFIX]
    assert compiled(monkeypatch, allowed=False) == code


@pytest.mark.parametrize("damage", [lambda b: b[:-1], lambda b: b"", lambda b: b[:40] + bytes([b[40] ^ 1]) + b[41:], lambda b: b[:32]])
def test_what_is_damaged_is_compiled_again(folder, monkeypatch, damage):
    code = compiled(monkeypatch)
    file, = folder.iterdir()
    file.write_bytes(damage(file.read_bytes()))
    assert compiled(monkeypatch) == code
    assert compiled(monkeypatch, allowed=False) == code  # and whole again


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="rights as POSIX has them")
@pytest.mark.parametrize("of", ["file", "folder"])
def test_what_others_may_write_is_not_read(folder, monkeypatch, of):
    code = compiled(monkeypatch)
    file, = folder.iterdir()
    changed = file.read_bytes()[32:].replace(b"\x00\x00\x80\x3e", b"\x00\x00\x00\x3f")
    spirv_cache.store(str(folder), {file.stem: changed})
    assert compiled(monkeypatch, allowed=False) == changed != code  # it would be taken
    os.chmod(file if of == "file" else folder, 0o666 if of == "file" else 0o777)
    monkeypatch.undo()
    monkeypatch.setenv("DRESSI_CACHE", str(folder.parent))
    assert compiled(monkeypatch) == code


def test_other_tools_and_other_text_have_other_names(tmp_path):
    tools = {}
    for name in ("a", "b"):
        (tmp_path / name).write_text(name * 3)
        tools[name] = str(tmp_path / name)
    first = spirv_cache.key(tools, "-V", "frag", "text")
    assert first == spirv_cache.key(tools, "-V", "frag", "text")
    assert len({first, spirv_cache.key(tools, "-V", "vert", "text"), spirv_cache.key(tools, "-V", "frag", "texts")}) == 3
    (tmp_path / "b").write_text("another version")
    assert spirv_cache.key(tools, "-V", "frag", "text") != first


def test_off_keeps_nothing(tmp_path, monkeypatch):
    monkeypatch.setenv("DRESSI_CACHE", "off")
    assert spirv_cache.folder() is None


def test_the_folder_stays_small(tmp_path, monkeypatch):
    monkeypatch.setattr(spirv_cache, "MAX_FOLDER_BYTES", 1000)
    for k in range(30):
        spirv_cache.store(str(tmp_path), {f"{k:02}": bytes(100)})
        os.utime(tmp_path / f"{k:02}.spirv", (k, k))
    left = sorted(f.stem for f in tmp_path.iterdir())
    assert left[-1] == "29" and len(left) <= 9
