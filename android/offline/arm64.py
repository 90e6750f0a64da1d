"""64-bit ARM without a device: programs of a Debian root of that architecture under qemu-user, with Mesa's software driver.

In: the libdressi.so of an APK. Out: the tests' player, which loads that very file, and dressi-play for boards with Debian's C library. What
Android's C library has and glibc has otherwise is bridged by libraries of its names (`SHIMS`) that depend on glibc's. It proves code,
relocations, names and results; nothing of Android's own loader, C library and drivers. Packages: clang-16 lld-16 mmdebstrap qemu-user.
"""
from __future__ import annotations

import os
import subprocess
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
TARGET = ["clang-16", "--target=aarch64-linux-gnu", "-fuse-ld=lld"]
PACKAGES = "libc6,libc6-dev,libgcc-12-dev,mesa-vulkan-drivers,libvulkan1"
LIBRARIES = Path("usr/lib/aarch64-linux-gnu")
SHIMS = {"libc.so": "int *__errno_location(void);\nint *__errno(void) { return __errno_location(); }\n",
         "libdl.so": "", "libvulkan.so": ""}
BEHIND = {"libc.so": "libc.so.6", "libdl.so": "libc.so.6", "libvulkan.so": "libvulkan.so.1"}


def root(folder: Path) -> Path:
    """A Debian 12 root for 64-bit ARM; made if it is not there (about 70 MB of packages)."""
    if not (folder / LIBRARIES / "libvulkan.so.1").exists():
        subprocess.run(["mmdebstrap", "--mode=root", "--variant=extract", "--architectures=arm64", f"--include={PACKAGES}", "bookworm",
                        folder], check=True, capture_output=True)
    return folder


def _library(sysroot: Path, name: str) -> Path:
    """Of the two folders that there are while nothing is installed."""
    return next(file for folder in (LIBRARIES, LIBRARIES.relative_to("usr")) if (file := sysroot / folder / name).exists())


def shims(sysroot: Path, out: Path) -> None:
    """Libraries of Android's names."""
    for name, code in SHIMS.items():
        source = out / f"{name}.c"
        source.write_text(code)
        subprocess.run([*TARGET, "-nostdlib", "-shared", "-fPIC", f"-Wl,-soname,{name}", "-Wl,--no-as-needed", source,
                        _library(sysroot, BEHIND[name]), "-o", out / name], check=True)


def player(sysroot: Path, out: Path, library: Path) -> Path:
    """The tests' player, linked to this libdressi.so."""
    made = out / "player"
    subprocess.run([*TARGET, f"--sysroot={sysroot}", "-std=gnu11", "-O1", "-I", ROOT / "android" / "native",
                    ROOT / "tests" / "player" / "player.c", library, "-Wl,--allow-shlib-undefined", "-lpthread", "-o", made],
                   check=True)
    return made


def play(sysroot: Path, out: Path, include: Path) -> Path:
    """dressi-play, as it is built for a board; `include` has Vulkan's headers."""
    native, made = ROOT / "android" / "native", out / "dressi-play"
    sources = [*sorted(native.glob("*.c")), native / "programs" / "play.c", native / "programs" / "inspect.c"]
    subprocess.run([*TARGET, f"--sysroot={sysroot}", "-std=gnu11", "-O1", "-I", native, "-I", native / "programs", "-isystem", include,
                    *sources, "-lpthread", "-o", made], check=True)
    return made


def run(sysroot: Path, out: Path, program: str, *words, **environment) -> subprocess.CompletedProcess:
    """Run a program of that folder with these words; the finished process."""
    set_there = {"LD_LIBRARY_PATH": str(out), "VK_ICD_FILENAMES": str(sysroot / "usr/share/vulkan/icd.d/lvp_icd.aarch64.json"),
                 "DRESSI_CACHE": "off", **environment}
    words = [word for name, value in set_there.items() for word in ("-E", f"{name}={value}")] + [str(w) for w in (out / program, *words)]
    return subprocess.run(["qemu-aarch64", "-L", sysroot, *words], capture_output=True, text=True, env=os.environ, timeout=600)
