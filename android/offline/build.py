"""An APK of the sample from Debian 12's packages alone: `build.py OUT [ASSETS]`, or `make apk`. Neither SDK nor NDK nor network is needed.

In: the C of ../native, the smali of the Java (to_smali.sh), the manifest and resources of ../app, a folder of assets (assets.py). Out:
OUT/libdressi.so for 64-bit ARM, OUT/dressi.apk, signed with a debug key that is made once as OUT/debug.p12. With the same key the same
sources give the same bytes. Packages: aapt apksigner android-framework-res libsmali-java android-libnativehelper-dev clang-16 lld-16
libvulkan-dev openjdk-17-jre-headless.
"""
from __future__ import annotations

import re
import struct
import subprocess
import sys
import zipfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
NATIVE, APP, HEADERS = HERE.parent / "native", HERE.parent / "app" / "src" / "main", HERE / "include"
FRAMEWORK, SMALI = "/usr/share/android-framework-res/framework-res.apk", "/usr/share/java/smali.jar"
API, PAGE = 29, 16384  # of framework-res; devices with pages of 16 KiB map libraries only at multiples of that
CLANG = ["clang-16", f"--target=aarch64-linux-android{API}", "-nostdlib", "-fuse-ld=lld"]
FLAGS = ["-std=gnu11", "-Oz", "-flto", "-fPIC", "-fvisibility=hidden", "-ffunction-sections", "-fdata-sections", "-fno-unwind-tables",
         "-fno-asynchronous-unwind-tables", "-mno-outline-atomics", "-nostdlibinc", "-Wall", "-Wextra", "-Werror",
         "-Wno-format-truncation", "-Wno-unknown-warning-option"]
LINK = ["-shared", "-Wl,--gc-sections", "-Wl,--icf=all", f"-Wl,-z,max-page-size={PAGE}", "-Wl,-z,now", "-Wl,-z,relro", "-Wl,--no-undefined",
        "-Wl,-soname,libdressi.so", "-Wl,-s"]
DL = ("dlopen", "dlsym")
PASSWORD = "android"  # of a key that protects nothing


def run(*command) -> None:
    subprocess.run([*map(str, command)], check=True)


def declared() -> list[str]:
    """The functions of the system that may be called: those that the headers declare."""
    found = []
    for header in sorted(HEADERS.rglob("*.h")):
        for line in header.read_text().splitlines():
            if line and not line.startswith(("#", "typedef", "struct", "}", " ", "/")) and (name := re.search(r"(\w+)\(", line)):
                found.append(name[1])
            elif line.startswith("struct dirent *") or line.startswith("typedef struct DIR"):
                found += re.findall(r"\*(\w+)\(", line)
    return found


def library(out: Path) -> Path:
    """libdressi.so for 64-bit ARM, linked against stand-ins of the system's libraries that have names alone."""
    include = out / "include"
    include.mkdir(parents=True, exist_ok=True)
    for name in ("vulkan", "vk_video"):
        if (Path("/usr/include") / name).exists() and not (include / name).exists():
            (include / name).symlink_to(Path("/usr/include") / name)
    for name in ("c", "dl"):
        source = out / f"stub_{name}.c"
        source.write_text("".join(f"void {f}(void) {{}}\n" for f in declared() if (f in DL) == (name == "dl")))
        run(*CLANG, "-w", "-fno-builtin", "-shared", f"-Wl,-soname,lib{name}.so", source, "-o", out / f"lib{name}.so")
    made = out / "libdressi.so"
    run(*CLANG, *FLAGS, "-isystem", HEADERS, "-isystem", include, "-isystem", "/usr/include/android/nativehelper", "-I", NATIVE,
        *sorted(NATIVE.glob("*.c")), NATIVE / "jni" / "jni.c", *LINK, "-L", out, "-lc", "-ldl", "-o", made)
    return made


def _add(apk: zipfile.ZipFile, name: str, data: bytes) -> None:
    """One file, always the same bytes. Libraries and the table of resources are not compressed, but aligned, so that they can be mapped."""
    info = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
    info.external_attr = 0o644 << 16
    align = PAGE if name.endswith(".so") else 4 if name == "resources.arsc" else 0
    info.compress_type = zipfile.ZIP_STORED if align else zipfile.ZIP_DEFLATED
    if align:  # the field that apksigner keeps: its number, its size, the alignment, then zeros
        room = -(apk.fp.tell() + 30 + len(name) + 6) % align
        info.extra = struct.pack("<HHH", 0xd935, 2 + room, align) + bytes(room)
    apk.writestr(info, data)


def package(out: Path, lib: Path, assets: Path | None) -> Path:
    """The APK, signed and checked."""
    bare, dex, unsigned, signed, key = (out / name for name in ("bare.apk", "classes.dex", "unsigned.apk", "dressi.apk", "debug.p12"))
    run("aapt", "package", "-f", "-M", APP / "AndroidManifest.xml", "-S", APP / "res", "-I", FRAMEWORK, "-F", bare)
    run("java", "-jar", SMALI, "assemble", "--jobs", 1, "--api", API, "--output", dex, HERE / "smali" / "dressi")  # in one order
    with zipfile.ZipFile(bare) as made:
        files = {name: made.read(name) for name in made.namelist()}
    files |= {"classes.dex": dex.read_bytes(), "lib/arm64-v8a/libdressi.so": lib.read_bytes()}
    if assets:
        files |= {f"assets/{file.relative_to(assets)}": file.read_bytes() for file in sorted(assets.rglob("*")) if file.is_file()}
    with zipfile.ZipFile(unsigned, "w") as apk:
        for name in sorted(files):
            _add(apk, name, files[name])
    if not key.exists():
        run("keytool", "-genkeypair", "-keystore", key, "-storetype", "PKCS12", "-storepass", PASSWORD, "-alias", "debug", "-keyalg", "RSA",
            "-keysize", 2048, "-validity", 10000, "-dname", "CN=debug")
    run("apksigner", "sign", "--ks", key, "--ks-pass", f"pass:{PASSWORD}", "--min-sdk-version", 26, "--v1-signing-enabled", "false",
        "--v4-signing-enabled", "false", "--out", signed, unsigned)
    run("apksigner", "verify", "--min-sdk-version", 26, signed)
    return signed


def main(target: str, assets: str | None = None) -> None:
    out = Path(target)
    out.mkdir(parents=True, exist_ok=True)
    lib = library(out)
    apk = package(out, lib, Path(assets) if assets else None)
    print(f"{lib}: {lib.stat().st_size} bytes\n{apk}: {apk.stat().st_size} bytes")


if __name__ == "__main__":
    main(*sys.argv[1:])
