"""The sample's APK is built from Debian packages alone, and the library in it, the very file, plays on 64-bit ARM under qemu-user what the
runtime plays here; the Java face plays it on a JVM. `make test-android` installs what these tests need; nothing here runs on a phone."""

import hashlib
import json
import re
import shutil
import struct
import subprocess
import sys
import zipfile
from pathlib import Path

import hostile_bundles
import make_vectors
import numpy as np
import pytest

from dressi_edge import runtime
from dressi_edge.cache.profile import Profile

ROOT = Path(__file__).parents[1]
OFFLINE, JAVA = ROOT / "android" / "offline", ROOT / "android" / "app" / "src" / "main" / "java"
FOLDER = make_vectors.FOLDER
sys.path.insert(0, str(OFFLINE))
import arm64  # noqa: E402
import assets  # noqa: E402
import build  # noqa: E402

EXPORTED = r"dressi_\w+|Java_dressi_(Device|Session)_\w+"


def test_the_smali_is_that_of_the_java():
    """offline/to_smali.sh makes it and writes down of what."""
    told = dict(line.split()[::-1] for line in (OFFLINE / "smali" / "SOURCES").read_text().splitlines())
    found = {f"./{file.relative_to(JAVA)}": hashlib.sha256(file.read_bytes()).hexdigest() for file in JAVA.rglob("*.java")}
    assert told == found


def test_java_declares_what_the_library_defines():
    declared = {f"Java_dressi_{file.stem}_{name}" for file in JAVA.glob("dressi/*.java")
                for name in re.findall(r"native \S+ (\w+)\(", file.read_text())}
    source = (ROOT / "android" / "native" / "jni" / "jni.c").read_text()
    defined = {f"Java_dressi_{name}" for name in re.findall(r"^METHOD\(\w+, (\w+)\)", source, re.M)}
    assert declared == defined and len(declared) > 10


android = pytest.mark.android


@pytest.fixture(scope="module")
def pear(tmp_path_factory):
    """The sample's assets, small."""
    folder = tmp_path_factory.mktemp("assets")
    assets.make(folder, 32, ("vulkan_min",))
    return folder


@pytest.fixture(scope="module")
def apk(tmp_path_factory, pear):
    """(the folder of the build, the APK)."""
    out = tmp_path_factory.mktemp("apk")
    return out, build.package(out, build.library(out), pear)


@android
def test_the_apk_is_sound_aligned_and_the_same_again(apk, pear):
    out, path = apk
    first = path.read_bytes()
    subprocess.run(["apksigner", "verify", "--min-sdk-version", "26", path], check=True)
    with zipfile.ZipFile(path) as z:
        names = set(z.namelist())
        assert {"AndroidManifest.xml", "classes.dex", "resources.arsc", "lib/arm64-v8a/libdressi.so", "assets/pear.dressi"} <= names
        info = z.getinfo("lib/arm64-v8a/libdressi.so")
        head = first[info.header_offset:info.header_offset + 30]
        start = info.header_offset + 30 + sum(struct.unpack("<HH", head[26:]))
        assert info.compress_type == zipfile.ZIP_STORED and start % 16384 == 0
        assert first[start:start + info.file_size] == (out / "libdressi.so").read_bytes()
        assert z.read("assets/pear.dressi") == (pear / "pear.dressi").read_bytes()
        without = sum(z.getinfo(name).compress_size for name in names if not name.startswith("assets/"))
        assert without < 400_000
    assert build.package(out, build.library(out), pear).read_bytes() == first


@android
def test_the_library_needs_and_gives_no_more_than_it_should(apk):
    library = apk[0] / "libdressi.so"
    told = subprocess.run(["llvm-readelf-16", "-lWd", library], capture_output=True, text=True, check=True).stdout
    assert set(re.findall(r"NEEDED.*\[(.*)\]", told)) == {"libc.so", "libdl.so"}
    assert re.findall(r"SONAME.*\[(.*)\]", told) == ["libdressi.so"]
    assert {line.split()[-1] for line in told.splitlines() if line.lstrip().startswith("LOAD ")} == {"0x4000"}
    assert "TEXTREL" not in told and "GNU_RELRO" in told and "BIND_NOW" in told
    names = {}
    for kind in ("undefined", "defined"):
        listed = ["llvm-nm-16", "-D", f"--{kind}-only", "--format=just-symbols", library]
        names[kind] = set(subprocess.run(listed, capture_output=True, text=True, check=True).stdout.split())
    assert names["undefined"] <= set(build.declared()) and not [n for n in names["defined"] if not re.fullmatch(EXPORTED, n)]
    assert library.stat().st_size < 200_000


@pytest.fixture(scope="module")
def arm(apk, tmp_path_factory):
    """Runs the player for 64-bit ARM, with the library as it is in the APK."""
    out = tmp_path_factory.mktemp("arm64")
    sysroot = arm64.root(Path(tmp_path_factory.getbasetemp().parent) / "dressi-arm64-root")
    with zipfile.ZipFile(apk[1]) as z:
        (out / "libdressi.so").write_bytes(z.read("lib/arm64-v8a/libdressi.so"))
    arm64.shims(sysroot, out)
    arm64.player(sysroot, out, out / "libdressi.so")
    arm64.play(sysroot, out, apk[0] / "include")
    return lambda *words, program="player": arm64.run(sysroot, out, program, *words)


def replayed(play, folder, path, steps):
    """[(step, array)] of what a player got."""
    words, got = [], []
    for k, step in enumerate(steps):
        file = folder / f"{k}.bin"
        if step[0] == "set":
            file.write_bytes(np.ascontiguousarray(step[2]).tobytes())
        elif step[0] == "get":
            got.append((step, file))
        words += [step[0], step[1], str(step[2]) if step[0] == "step" else str(file)]
    done = play(path, *words)
    assert done.returncode == 0, done.stdout + done.stderr
    return got


@android
@pytest.mark.parametrize("name", make_vectors.VECTORS)
def test_the_library_of_the_apk_replays_the_vectors_on_arm(arm, tmp_path, name):
    steps, expected, tolerance = make_vectors.load(name)
    wanted = [array for array in expected if array is not None]
    for (step, file), array in zip(replayed(lambda *w: arm("run", *w), tmp_path, FOLDER / f"{name}.dressi", steps), wanted, strict=True):
        found = np.fromfile(file, array.dtype).reshape(array.shape)
        if array.dtype.kind == "i":
            assert (found == array).all(), step
        else:
            assert np.abs(found - array).max() <= max(tolerance, 1e-6) * max(1.0, np.abs(array).max()), step


@android
def test_the_pear_begins_on_arm_as_it_does_here(arm, pear, tmp_path):
    """Ten steps of its shape and two of its texture: pictures of eight bits are the same but for few numbers by one."""
    path = pear / "pear.dressi"
    steps = [("step", "shape", 10), ("get", "vertices"), ("step", "texture", 2), ("get", "texture"), ("get", "render.color")]
    got = replayed(lambda *w: arm("run", *w), tmp_path, path, steps)
    with runtime.load(path, "llvmpipe") as session:
        here = [array for step in steps if (array := make_vectors.perform(session, step)) is not None]
    for (step, file), array in zip(got, here, strict=True):
        found = np.fromfile(file, np.float32).reshape(array.shape)
        far = float(np.abs(found - array).max())
        print(f"{step[1]}: at most {far:.2e} from x86-64, of {np.abs(array).max():.2f}; {(found == array).mean():.4f} equal bits")
        assert far < 2e-2
    eight = [np.round(np.clip(x, 0, 1) * 255) for x in (np.fromfile(got[-1][1], np.float32), here[-1].ravel())]
    assert (eight[0] != eight[1]).mean() < 0.01


@android
def test_what_is_malformed_is_refused_on_arm_and_a_checkpoint_goes_there(arm, tmp_path):
    for row in hostile_bundles.ROWS[::12]:
        (tmp_path / "bad").write_bytes(hostile_bundles.spoiled(row[1], row[2]))
        done = arm("check", tmp_path / "bad")
        assert done.returncode == 2 and row[3] in done.stderr, row[0]
    path = FOLDER / "states.dressi"
    with runtime.load(path, "llvmpipe") as session:
        session.step(3, "walk")
        session.checkpoint(tmp_path / "here")
        at = session.get("t")
    done = arm("run", path, "load", ".", tmp_path / "here", "step", ".", 2, "get", "t", tmp_path / "t", "save", ".", tmp_path / "there")
    assert done.returncode == 0 and np.fromfile(tmp_path / "t", np.int32) == at + 2
    with runtime.load(path, "llvmpipe") as session:
        session.restore(tmp_path / "there")
        assert session.report()["runs"]["walk"] == 5


@android
def test_dressi_play_runs_on_arm(arm, tmp_path):
    done = arm("capture", "--name", "arm", "--output", tmp_path / "arm.json", program="dressi-play")
    assert done.returncode == 0 and Profile.load(tmp_path / "arm.json").limit("maxImageDimension2D") >= 4096, done.stderr
    path = FOLDER / "states.dressi"
    assert arm("verify", path, program="dressi-play").stdout.startswith(f"OK {path}: profile lavapipe, 4 plans")
    done = arm("run", path, "--phase", "walk", "--steps", 3, "--get", f"t={tmp_path / 't'}", program="dressi-play")
    assert done.returncode == 0 and np.fromfile(tmp_path / "t", np.int32) == 3, done.stderr


@pytest.fixture(scope="module")
def java(tmp_path_factory):
    """Runs JavaPlayer on this machine's JVM."""
    out = tmp_path_factory.mktemp("java")
    native = ROOT / "android" / "native"
    subprocess.run([shutil.which("cc"), "-std=gnu11", "-O1", "-fPIC", "-shared", "-fvisibility=hidden", "-I", native, "-I",
                    "/usr/include/android/nativehelper", *native.glob("*.c"), native / "jni" / "jni.c", "-o", out / "libdressi.so",
                    "-lpthread", "-ldl"], check=True)
    subprocess.run(["javac", "--release", "8", "-Xlint:-options", "-d", out, *JAVA.glob("dressi/*.java"),
                    ROOT / "tests" / "player" / "JavaPlayer.java"], check=True)
    return lambda *words: subprocess.run(["java", "-Xcheck:jni", f"-Djava.library.path={out}", "-cp", out, "JavaPlayer", "llvmpipe",
                                          *map(str, words)], capture_output=True, text=True, timeout=300)


@android
@pytest.mark.parametrize("how, name", [("file", "states"), ("mapped", "copies")])
def test_java_gives_the_bits_that_python_gives(java, tmp_path, how, name):
    path, steps = FOLDER / f"{name}.dressi", make_vectors.load(name)[0]
    got = replayed(lambda path, *words: java(how, path, *words), tmp_path, path, steps)
    with runtime.load(path, "llvmpipe") as session:
        here = [array for step in steps if (array := make_vectors.perform(session, step)) is not None]
    for (step, file), array in zip(got, here, strict=True):
        assert file.read_bytes() == np.asarray(array).tobytes(), step


@android
def test_java_tells_what_is_wrong_and_what_there_is(java, tmp_path):
    path = FOLDER / "states.dressi"
    (tmp_path / "short").write_bytes(bytes(8))
    done = java("file", path, "values", ".", ".", "get", "none", tmp_path / "x", "set", "a", tmp_path / "short", "heap", "a", 24,
                "step", "jump", 1, "cancel", "walk", 5, "bound", "walk", 3, "save", ".", tmp_path / "c", "load", ".", tmp_path / "short",
                "load", ".", tmp_path / "c", "report", ".", ".", "capture", "here", "2025-01-31")
    lines = done.stdout.splitlines()
    assert done.returncode == 0 and "WARNING" not in done.stdout + done.stderr, done.stdout + done.stderr
    assert lines[:9] == ["a 1 false 24", "t 1 true 4", "b 1 false 24", "rate 0 false 4", "fixed 0 false 24", "loss 2 false 4",
                         "doubled 2 false 24", "walk 0", "rest 2"]
    assert lines[9].startswith("3 'none' is no input or state or output of this bundle")
    assert lines[10].startswith("3 a: the array has 8 bytes")
    assert lines[11].startswith("3 the buffer is not direct") and lines[12].startswith("3 'jump' is no phase")
    assert lines[13:15] == ["0", "3"] and re.match(r"2 .*short: 8 bytes; a checkpoint has at least 80", lines[15])
    assert json.loads(lines[16])["runs"]["walk"] == 3 and lines[-1] == "the session is closed"
    assert Profile.loads("\n".join(lines[17:-1])).name == "here"
    bad = java("mapped", ROOT / "README.md")
    assert bad.returncode and "dressi.DressiException: not a bundle" in bad.stderr
