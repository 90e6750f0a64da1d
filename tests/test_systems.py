"""Linux, macOS and Windows: where the loader and the compiler's tools are looked for, what is said where they are not, files that others
hold open. What a machine at hand cannot show is shown of the decisions alone."""

import os
import subprocess
import sys

import pytest
from jobs import ROOT

from dressi_edge.cache import files
from dressi_edge.compiler.backend import tools
from dressi_edge.runtime import loader


def test_linux_asks_for_names_alone():
    assert loader.candidates("linux", {"VULKAN_SDK": "/sdk"}) == ["libvulkan.so.1", "libvulkan.so"]


def test_windows_asks_the_system_first_and_then_the_sdk():
    assert loader.candidates("win32", {}) == ["vulkan-1.dll"]
    assert loader.candidates("win32", {"VULKAN_SDK": "sdk"}) == ["vulkan-1.dll", os.path.join("sdk", "Bin", "vulkan-1.dll")]


def test_macos_finds_homebrew_the_sdk_and_moltenvk_by_itself(tmp_path):
    for version in ("1.3.275.0", "1.4.309.0"):
        (tmp_path / "VulkanSDK" / version / "macOS" / "lib").mkdir(parents=True)
    found = loader.candidates("darwin", {"HOME": str(tmp_path), "VULKAN_SDK": "/sdk/macOS"})
    assert found[:3] == ["libvulkan.dylib", "libvulkan.1.dylib", "libMoltenVK.dylib"]
    order = [found.index(name) for name in ("/sdk/macOS/lib/libvulkan.dylib", "/opt/homebrew/lib/libvulkan.dylib",
                                            "/opt/homebrew/lib/libMoltenVK.dylib", "/usr/local/lib/libvulkan.dylib",
                                            str(tmp_path / "VulkanSDK" / "1.4.309.0" / "macOS" / "lib" / "libvulkan.dylib"),
                                            str(tmp_path / "VulkanSDK" / "1.3.275.0" / "macOS" / "lib" / "libvulkan.dylib"))]
    assert order == sorted(order)


@pytest.mark.parametrize("system, word", [("linux", "mesa-vulkan-drivers"), ("darwin", "molten-vk"), ("win32", "winget"),
                                          ("freebsd14", "libvulkan1")])
def test_what_to_do_without_a_loader_is_said_for_the_system(system, word):
    text = loader.missing(loader.candidates(system, {}), system)
    assert text.startswith("no Vulkan loader found (tried ") and word in text and text.count("libvulkan.dylib") <= 1


@pytest.mark.parametrize("release, word", [
    ({"ID": "debian"}, "apt-get install glslang-tools"), ({"ID": "ubuntu", "ID_LIKE": "debian"}, "apt-get"),
    ({"ID": "fedora"}, "dnf install"), ({"ID": "rocky", "ID_LIKE": "rhel centos fedora"}, "dnf install"), ({"ID": "arch"}, "pacman -S"),
    ({"ID": "endeavouros", "ID_LIKE": "arch"}, "pacman -S"),
    ({"ID": "opensuse-leap", "ID_LIKE": "suse opensuse"}, "zypper"), ({"ID": "nixos"}, "dressi_edge[glslang]")])
def test_each_linux_is_told_its_own_command(monkeypatch, release, word):
    monkeypatch.setattr(tools.platform, "freedesktop_os_release", lambda: release)
    monkeypatch.setattr(tools.sys, "platform", "linux")
    monkeypatch.setattr(tools.platform, "machine", lambda: "x86_64")
    assert word in tools.command() and tools.WHEELS in tools.command()


@pytest.mark.parametrize("system, machine, word, wheels", [
    ("darwin", "arm64", "brew install glslang", True), ("win32", "AMD64", "winget install", False),
    ("linux", "riscv64", "install both from your system's packages", False)])
def test_other_systems_are_told_theirs(monkeypatch, system, machine, word, wheels):
    monkeypatch.setattr(tools.sys, "platform", system)
    monkeypatch.setattr(tools.platform, "machine", lambda: machine)
    monkeypatch.setattr(tools.platform, "freedesktop_os_release", lambda: {"ID": "other"})
    assert word in tools.command() and (tools.WHEELS in tools.command()) == wheels


@pytest.fixture
def alone(monkeypatch, tmp_path):
    """No tool is found but in tmp_path/site."""
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    monkeypatch.delenv("VULKAN_SDK", raising=False)
    monkeypatch.setattr(tools.sys, "path", [str(tmp_path / "site")])
    monkeypatch.setattr(tools.sysconfig, "get_path", lambda name: str(tmp_path / "scripts"))
    tools._found.cache_clear()
    yield tmp_path
    tools._found.cache_clear()


def program(path):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("#!/bin/sh\n")
    path.chmod(0o755)
    return str(path)


def test_a_missing_tool_is_named_with_the_command_that_brings_it(alone):
    with pytest.raises(tools.ToolError, match="^spirv-val not found; the compiler needs glslang and SPIRV-Tools: ") as told:
        tools.find("spirv-val")
    assert "\n" not in str(told.value)


def test_tools_are_taken_from_path_then_wheels_then_scripts(alone):
    script = program(alone / "scripts" / "glslangValidator")
    assert tools.find("glslangValidator") == script and tools.environment(script) is None
    tools._found.cache_clear()
    wheel = program(alone / "site" / "cmeel.prefix" / "bin" / "glslang")  # what newer releases call it
    assert tools.find("glslangValidator") == wheel
    assert str(alone / "site" / "cmeel.prefix" / "lib") in tools.environment(wheel)[
        "DYLD_LIBRARY_PATH" if sys.platform == "darwin" else "LD_LIBRARY_PATH"]
    tools._found.cache_clear()
    own = program(alone / "bin" / "glslangValidator")
    assert tools.find("glslangValidator") == own


def test_a_file_that_a_reader_holds_open_is_replaced_as_soon_as_it_lets_go(monkeypatch, tmp_path):
    """Windows refuses the replacement while somebody reads."""
    real, calls = os.replace, []

    def busy(a, b):
        calls.append(a)
        if len(calls) < 4:
            raise PermissionError(13, "held")
        real(a, b)

    monkeypatch.setattr(files.os, "replace", busy)
    monkeypatch.setattr(files, "WINDOWS", True)
    files.replace_file(tmp_path / "x", b"new")
    assert (tmp_path / "x").read_bytes() == b"new" and len(calls) == 4
    monkeypatch.setattr(files, "BUSY_SECONDS", 0.05)
    monkeypatch.setattr(files.os, "replace", lambda a, b: (_ for _ in ()).throw(PermissionError(13, "held")))
    with pytest.raises(PermissionError):
        files.replace_file(tmp_path / "x", b"newer")
    assert (tmp_path / "x").read_bytes() == b"new" and [p.name for p in tmp_path.iterdir()] == ["x"]


def test_elsewhere_a_refusal_is_one_at_once(monkeypatch, tmp_path):
    calls = []

    def refused(a, b):
        calls.append(a)
        raise PermissionError(13, "no")

    monkeypatch.setattr(files.os, "replace", refused)
    monkeypatch.setattr(files, "WINDOWS", False)
    with pytest.raises(PermissionError):
        files.replace_file(tmp_path / "x", b"new")
    assert len(calls) == 1 and list(tmp_path.iterdir()) == []


@pytest.mark.full
def test_wheels_alone_compile_and_run_a_job(tmp_path):
    """A bare environment with the wheel of this tree, `[compiler,glslang]`, and nothing else on PATH (it is built from the network)."""
    from jobs import write_job
    from test_packaging import copied
    source = copied(tmp_path)
    subprocess.run([sys.executable, "-m", "venv", str(tmp_path / "v")], check=True)
    pip = [str(tmp_path / "v" / "bin" / "python"), "-m", "pip", "-q", "--disable-pip-version-check"]
    subprocess.run([*pip, "wheel", "--no-deps", "-w", "wheels", str(source)], check=True, cwd=tmp_path)
    wheel, = (tmp_path / "wheels").iterdir()
    subprocess.run([*pip, "install", f"{wheel}[compiler,glslang]"], check=True, cwd=tmp_path)
    write_job(tmp_path)
    bare = {"PATH": str(tmp_path / "v" / "bin"), "HOME": str(tmp_path), "DRESSI_CACHE": "off"}
    for args in (["compile", "job.toml", "-p", "lavapipe", "-o", "x.dressi"], ["run", "x.dressi", "-o", "out.glb", "--report", "page"],
                 ["verify", "x.dressi"]):
        done = subprocess.run([str(tmp_path / "v" / "bin" / "dressi-edge"), *args], cwd=tmp_path, env=bare, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
    assert (tmp_path / "page" / "index.html").stat().st_size > 20000 and str(ROOT) not in done.stdout
