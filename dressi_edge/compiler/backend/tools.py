"""glslang and SPIRV-Tools: where they are on this machine, or the one command that brings them.

Looked for on PATH; where wheels for this Python put them (`pip install 'dressi_edge[glslang]'`); in the Vulkan SDK; and where Homebrew
puts them. `glslang` is what newer releases call glslangValidator. `glslc` of shaderc is glslang, too, and compiles many shaders at once.
"""
from __future__ import annotations

import functools
import os
import platform
import shutil
import subprocess
import sys
import sysconfig

from ...cache.errors import DressiError

NAMES = {"glslangValidator": ("glslangValidator", "glslang"), "spirv-val": ("spirv-val",), "glslc": ("glslc",)}
COMMANDS = {"debian": "apt-get install glslang-tools spirv-tools", "fedora": "dnf install glslang spirv-tools",
            "arch": "pacman -S glslang spirv-tools", "suse": "zypper install glslang-devel spirv-tools",
            "alpine": "apk add glslang spirv-tools", "darwin": "brew install glslang spirv-tools",
            "win32": "winget install KhronosGroup.VulkanSDK"}
WHEELS = "pip install 'dressi_edge[glslang]'"


class ToolError(DressiError):
    """A tool of the compiler is not on this machine."""


def folders() -> list[str]:
    """Where tools may lie that are not on PATH."""
    found = [os.path.join(path, "cmeel.prefix", "bin") for path in sys.path if path]
    if sdk := os.environ.get("VULKAN_SDK"):
        found += [os.path.join(sdk, "bin"), os.path.join(sdk, "Bin")]
    if sys.platform == "darwin":
        found += ["/opt/homebrew/bin", "/usr/local/bin"]
    return found


def find(name: str) -> str:
    """The path of a tool, "glslangValidator" or "spirv-val". Raises ToolError, which says how to get it here."""
    found = _found(name, os.environ.get("PATH", ""), os.environ.get("VULKAN_SDK", ""))
    if found is None:
        raise ToolError(f"{name} not found; the compiler needs glslang and SPIRV-Tools: {command()}")
    return found


def find_glslc() -> str | None:
    """The path of glslc, where there is one that starts; compiling takes a third of the time with it."""
    found = _found("glslc", os.environ.get("PATH", ""), os.environ.get("VULKAN_SDK", ""))
    return os.path.abspath(found) if found and _starts(found) else None  # it is started in another folder


@functools.lru_cache(maxsize=64)
def _starts(path: str) -> bool:
    try:
        return subprocess.run([path, "--version"], capture_output=True, timeout=60).returncode == 0
    except (OSError, subprocess.SubprocessError):
        return False


@functools.lru_cache(maxsize=64)
def _found(name: str, path: str, _sdk: str) -> str | None:
    scripts = sysconfig.get_path("scripts")  # there wheels put Python programs that start the tool, which takes longer than its work
    first = os.pathsep.join(part for part in path.split(os.pathsep) if part and os.path.realpath(part) != os.path.realpath(scripts))
    for where in (first, os.pathsep.join(folders()), scripts):
        for own in NAMES[name]:
            if found := shutil.which(own, path=where):
                return found
    return None


def environment(path: str) -> dict[str, str] | None:
    """What a tool is started with: of a wheel its libraries are beside it; None: as we are."""
    prefix = os.path.dirname(os.path.dirname(path))
    if os.path.basename(prefix) != "cmeel.prefix":
        return None
    name = "DYLD_LIBRARY_PATH" if sys.platform == "darwin" else "LD_LIBRARY_PATH"
    return {**os.environ, name: os.pathsep.join(filter(None, [os.path.join(prefix, "lib"), os.environ.get(name, "")]))}


def command() -> str:
    """What brings the tools on this machine, in words."""
    kind = system()
    own = COMMANDS.get(kind)
    wheels = kind != "win32" and platform.machine().lower() in ("x86_64", "aarch64", "arm64")
    ways = [way for way in (own, WHEELS if wheels else None) if way]
    return " or ".join(ways) or "install both from your system's packages"


def system() -> str:
    """A key of `COMMANDS`, or what the system calls itself."""
    if sys.platform != "linux":
        return sys.platform
    try:
        found = platform.freedesktop_os_release()
    except OSError:
        return "linux"
    words = [found.get("ID", ""), *found.get("ID_LIKE", "").split()]
    known = {"ubuntu": "debian", "rhel": "fedora", "centos": "fedora", "opensuse": "suse", "sles": "suse", "manjaro": "arch"}
    return next((known.get(word, word) for word in words if known.get(word, word) in COMMANDS), words[0] or "linux")
