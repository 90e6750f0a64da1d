"""libdressi, the player in C: it refuses what the Python reader refuses in the same words, gives the bits that the runtime gives, and
goes on where the other stopped. Built with the sanitizers of addresses and undefined behaviour, played under the validation layer."""

import hashlib
import json
import os
import random
import re
import shutil
import stat
import struct
import subprocess
import sys
from pathlib import Path

import fuzz_bundle
import hostile_bundles
import jobs
import make_vectors
import numpy as np
import pytest
import test_checkpoint
import test_spirv

from dressi_edge import runtime
from dressi_edge.cache import bundle, pipeline_cache
from dressi_edge.cache.errors import BundleError
from dressi_edge.cache.profile import Profile
from dressi_edge.cache.profile_check import check
from dressi_edge.runtime.emulate import EmulatedDevice

pytest_plugins = ["gpu"]

ROOT = Path(__file__).parents[1]
NATIVE = ROOT / "android" / "native"
FOLDER = make_vectors.FOLDER
LAYER = {"VK_INSTANCE_LAYERS": "VK_LAYER_KHRONOS_validation",
         "VK_LAYER_ENABLES": "VK_VALIDATION_FEATURE_ENABLE_SYNCHRONIZATION_VALIDATION_EXT"}
MEMORY, BUNDLE, INPUT, DEVICE, LOST = 1, 2, 3, 4, 5  # dressi_code
OUT_OF_DEVICE_MEMORY, DEVICE_LOST = -2, -4  # VkResult

POINTS = jobs.TINY.replace('"colors"', '"texture"\ntexture_grad = "inverse_uv"').replace("colors", "texture")


class Player:
    """The test driver, and a loader of Vulkan that fails where it is told to."""

    def __init__(self, program: Path, shim: Path):
        self.program, self.shim = program, shim

    def __call__(self, *words, **environment):
        """Run it under the validation layer; the finished process."""
        env = os.environ | LAYER | {"DRESSI_DEVICE": "llvmpipe", "ASAN_OPTIONS": "detect_leaks=0"} | environment  # drivers leak
        done = subprocess.run([self.program, *map(str, words)], capture_output=True, text=True, env=env, timeout=1200)
        assert done.returncode <= LOST and "Sanitizer" not in done.stderr and "runtime error" not in done.stderr, done.stderr
        assert "Validation" not in done.stdout and "VUID" not in done.stdout + done.stderr, done.stdout + done.stderr
        return done

    def shimmed(self, *words, **environment):
        """The same with the tests' loader in the place of Vulkan's, and without the layer, which has an opinion of what fails."""
        shim = {"LD_LIBRARY_PATH": str(self.shim), "SHIM_REAL": real_loader(), "VK_INSTANCE_LAYERS": "", "DRESSI_CACHE": "off"}
        return self(*words, **(shim | environment))

    def judge(self, bundles):
        """Of each of these bytes the code and the sentence. Here nothing may leak, either."""
        data = b"".join(struct.pack("<Q", len(one)) + one for one in bundles)
        done = subprocess.run([self.program, "stream"], input=data, capture_output=True,
                              env=os.environ | {"ASAN_OPTIONS": "detect_leaks=1"})
        assert done.returncode == 0, done.stderr.decode()
        return [(int(line[0]), line[2:]) for line in done.stdout.decode().split("\n")[:-1]]


def real_loader() -> str:
    """Where the loader of this process lies."""
    return next(line.split()[-1] for line in Path("/proc/self/maps").read_text().splitlines() if "libvulkan.so" in line)


def kept(compiler: str, headers: str) -> Path:
    """Where the programs are kept from run to run: they take 20 seconds to compile. Its name is a hash of all that they are made of."""
    version = subprocess.run([compiler, "--version"], capture_output=True, text=True).stdout
    made_of = hashlib.sha256("\0".join((version, headers, os.environ.get("CFLAGS", ""))).encode())
    for file in sorted([*NATIVE.rglob("*.[ch]"), NATIVE / "Makefile", *(ROOT / "tests" / "player").glob("*.[ch]")]):
        made_of.update(b"\0".join((file.name.encode(), file.read_bytes(), b"")))
    return ROOT / "build" / f"native-{made_of.hexdigest()[:20]}"


@pytest.fixture(scope="module")
def player(gpu, tmp_path_factory):
    compiler = os.environ.get("CC") or shutil.which("cc")
    if not compiler:
        pytest.skip("no C compiler: libdressi is not tested; apt-get install gcc libc6-dev")
    includes = subprocess.run([compiler, "-E", "-x", "c", "-"], input="#include <vulkan/vulkan.h>\n", capture_output=True, text=True)
    if includes.returncode:
        pytest.skip("no headers of Vulkan: libdressi is not tested; apt-get install libvulkan-dev")
    fcntl = pytest.importorskip("fcntl", reason="libdressi is for POSIX")
    base = tmp_path_factory.getbasetemp()
    built = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "native"  # of all processes of this run, which wait for it
    built.mkdir(exist_ok=True)
    with open(built / "lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        folder = kept(compiler, includes.stdout)
        if not folder.is_dir():
            programs = built / "player", built / "dressi-play"
            subprocess.run(["make", "-s", "-j2", "-C", NATIVE, f"BUILD={built}", f"CC={compiler}", "SANITIZE=1", *programs], check=True)
            for old in folder.parent.glob("native-*"):
                shutil.rmtree(old)
            unfinished = folder.with_name(f"unfinished-{os.getpid()}")
            unfinished.mkdir(parents=True)
            for program in programs:
                shutil.copy2(program, unfinished)
            unfinished.rename(folder)
    shim = tmp_path_factory.mktemp("shim")
    strict = ["-O1", "-Wall", "-Wextra", "-Werror", "-Wno-cast-function-type"]
    subprocess.run([compiler, *strict, "-shared", "-fPIC", "-Wl,-soname,libvulkan.so.1", ROOT / "tests" / "player" / "shim.c",
                    "-o", shim / "libvulkan.so.1", "-ldl"], check=True)
    return Player(folder / "player", shim)


# Reading


def python_says(data: bytes) -> tuple[int, str]:
    try:
        bundle.loads(data)
        return 0, ""
    except BundleError as e:
        return BUNDLE, str(e)


def test_what_is_malformed_is_refused_in_the_words_of_the_other_reader(player):
    cases = {row[0]: hostile_bundles.spoiled(row[1], row[2]) for row in hostile_bundles.ROWS}
    cases |= {name: data for name, (data, _) in hostile_bundles.files().items()}
    for (name, data), found in zip(cases.items(), player.judge(cases.values()), strict=True):
        assert found == python_says(data) and found[0] == BUNDLE, name


def alike(told: tuple[int, str], wanted: tuple[int, str]) -> bool:
    """The same code and words, but for letters beyond ASCII, which C writes as numbers, and where one block of several is named."""
    ambiguous = "need not run before it" in told[1] and "need not run before it" in wanted[1]
    return told == wanted or told[0] == wanted[0] and (ambiguous or not wanted[1].isascii())


def same_judgement(player, mutations: int, seed: int) -> tuple[int, int]:
    """How many mutated bundles both readers refused, and accepted: each in the same words."""
    fuzz = fuzz_bundle.Fuzz(seed)
    made = [fuzz.make(fuzz.r.choice(("bytes", "text", "words", "words", "fields", "fields", "fields"))) for _ in range(mutations)]
    found = player.judge(made)
    for data, told in zip(made, found, strict=True):
        wanted = python_says(data)
        assert alike(told, wanted), (told, wanted)
    return sum(code > 0 for code, _ in found), sum(code == 0 for code, _ in found)


def test_mutated_bundles_are_judged_alike(player):
    refused, accepted = same_judgement(player, 1500, 21)
    assert refused > 1000 and accepted > 20


@pytest.mark.full
@pytest.mark.parametrize("seed", range(20))
def test_many_mutated_bundles_are_judged_alike(player, seed):
    assert sum(same_judgement(player, 10_000, 100 + seed)) == 10_000


def with_shader(module: bytes, compute: bool = False) -> bytes:
    """A bundle whose fragment or compute shader is this module."""
    d, blobs = hostile_bundles.vector("counted" if compute else "ops")
    blobs[d["shaders"][d["computes"][1]["shader"] if compute else d["pipelines"][0]["fragment"]]] = module
    return bundle.dumps(d, blobs, bundle.version_of([d]))


def damaged_shaders(seed: int, count: int, compute: bool = False):
    """So many shaders of the vectors, of those that draw or compute, with an instruction or a branch changed."""
    r, modules = random.Random(seed), set()
    for name in make_vectors.VECTORS:
        b = bundle.read(FOLDER / f"{name}.dressi")
        modules |= {bytes(b.blob(k)) for k, shader in zip(b.description["shaders"], b.interfaces) if (shader.stage == 32) == compute}
    sound = sorted(x for x in modules if len(x) < 8000)
    for _ in range(count):
        yield fuzz_bundle.mutate_instructions(r.choice(sound), r)


def same_judgement_of_shaders(player, modules, compute: bool = False) -> tuple[int, int]:
    """How many both readers refused and accepted."""
    made = [with_shader(module, compute) for module in modules]
    found = player.judge(made)
    for data, told in zip(made, found, strict=True):
        wanted = python_says(data)
        assert alike(told, wanted), (told, wanted)
    return sum(code > 0 for code, _ in found), sum(code == 0 for code, _ in found)


def test_shaders_are_judged_alike(player):
    written = [*((row[0] + "\n", "OpReturn\n") for row in (*test_spirv.DECLARED.values(), *test_spirv.TOO_MUCH.values())),
               *(("", row[0]) for row in test_spirv.BODY.values()), *(("", body) for body in test_spirv.SOUND.values())]
    chains = [test_spirv.shader("", test_spirv.CALL, test_spirv.chain(*how)) for how in ((2, 30), (2, 12), (1, 64), (1, 63))]
    same_judgement_of_shaders(player, [*(test_spirv.shader(*one) for one in written), *chains])
    compute = [test_spirv.COMPUTE, *(test_spirv.COMPUTE.replace(*row[:2]) for row in test_spirv.DIFFERENTLY.values())]
    same_judgement_of_shaders(player, map(test_spirv.assemble, compute), True)
    refused, accepted = same_judgement_of_shaders(player, damaged_shaders(5, 300, True), True)
    assert refused > 150 and accepted > 0
    refused, accepted = same_judgement_of_shaders(player, damaged_shaders(3, 800))
    assert refused > 500 and accepted > 0


@pytest.mark.full
def test_many_damaged_shaders_are_judged_alike(player):
    same_judgement_of_shaders(player, damaged_shaders(4, 20_000))
    same_judgement_of_shaders(player, damaged_shaders(6, 10_000, True), True)


@pytest.mark.parametrize("name", ["ops", "texture", *(pytest.param(name, marks=pytest.mark.full) for name in make_vectors.VECTORS)])
def test_a_bundle_cut_anywhere_is_refused(player, name):
    path = FOLDER / f"{name}.dressi"
    assert int(player("cut", path, ASAN_OPTIONS="detect_leaks=1").stdout) == path.stat().st_size


def test_reading_loads_no_driver(player, tmp_path):
    for name in make_vectors.VECTORS:
        player.shimmed("check", FOLDER / f"{name}.dressi", SHIM_LOADED=str(tmp_path / "loaded"))
    assert not (tmp_path / "loaded").exists()
    player.shimmed("run", FOLDER / "ops.dressi", SHIM_LOADED=str(tmp_path / "loaded"))
    assert (tmp_path / "loaded").exists()


def test_what_is_opened_is_a_regular_file_and_has_its_pin(player, tmp_path):
    path = FOLDER / "ops.dressi"
    pin = bundle.read(path).digest
    assert player("check", path, DRESSI_PIN=pin.upper()).returncode == 0
    for wrong in ("0" * 64, "junk", ""):
        done = player("check", path, DRESSI_PIN=wrong)
        with pytest.raises(BundleError) as error:
            bundle.read(path, wrong)
        assert (done.returncode, done.stderr.strip()) == (BUNDLE, str(error.value))
    os.mkfifo(tmp_path / "fifo")
    for what in (tmp_path, tmp_path / "fifo", tmp_path / "nothing", "/dev/zero"):
        done = player("check", what)
        with pytest.raises(BundleError) as error:
            bundle.read(what)
        assert (done.returncode, done.stderr.strip()) == (BUNDLE, str(error.value))


# Playing


def replay(gpu, player, folder, path, steps, **environment):
    """Both do the steps and get the same bytes; how often they got something."""
    words, wanted = [], []
    with runtime.load(path, gpu.device) as session:
        for k, step in enumerate(steps):
            found, array = make_vectors.perform(session, step), folder / f"{k}.bin"
            if step[0] == "set":
                array.write_bytes(step[2].tobytes())
            elif found is not None:
                wanted.append((step, array, np.asarray(found)))
            words += [step[0], step[1], str(step[2]) if step[0] == "step" else str(array)]
        report = session.report()
    done = player("run", path, *words, "report", ".", ".", **environment)
    assert done.returncode == 0, done.stderr
    for step, array, found in wanted:
        assert array.read_bytes() == found.tobytes(), step
    told = json.loads(done.stdout)
    assert {key: told[key] for key in told if key not in ("staging_bytes", "phase")} == {
        key: report[key] for key in report if key not in ("staging_bytes", "texels", "time", "views_kept")}
    return len(wanted)


@pytest.mark.parametrize("name", make_vectors.VECTORS)
def test_both_players_give_the_same_bits(gpu, player, tmp_path, name):
    steps, _, _ = make_vectors.load(name)
    in_memory = {"PLAYER_MEMORY": "1"} if name == "subpasses" else {}
    assert replay(gpu, player, tmp_path, FOLDER / f"{name}.dressi", steps, **in_memory) == sum(step[0] == "get" for step in steps)


@pytest.mark.parametrize("profile, text", {"lavapipe": jobs.TINY, "vulkan_min": POINTS}.items())
def test_both_players_solve_a_job_to_the_same_bits(gpu, player, tmp_path, profile, text):
    """Two phases in turns, with what each prepares, under new targets; colours of vertices, or a texture by drawing points."""
    path, job, paint = tmp_path / "job.dressi", jobs.write_job(tmp_path, text), "texture" if "texture" in text else "colors"
    assert jobs.command("compile", job, "-p", profile, "-o", path).returncode == 0
    topologies = {pipeline["topology"] for pipeline in bundle.read(path).description["pipelines"]}
    assert topologies == ({0, 3} if text == POINTS else {3})
    seen = [("get", name) for name in ("vertices", paint, "vertices.adam_m", "shape.step", "shape.loss", "paint.loss", "render.color")]
    with runtime.load(path, gpu.device) as session:
        targets = session.get("targets")
    steps = [("step", "shape", 3), ("step", "paint", 2), ("step", "shape", 2), *seen, ("set", "targets", targets[:, ::-1]),
             ("step", "paint", 1), ("step", "shape", 1), *seen]
    assert replay(gpu, player, tmp_path, path, steps) == 2 * len(seen)


def test_what_a_bundle_has_is_told(gpu, player):
    for name in ("states", "silhouette", "copies", "half"):
        lines = []
        with runtime.load(FOLDER / f"{name}.dressi", gpu.device) as session:
            for value, about in session.values.items():
                shape, kind = session.shape(value), "int" if about["type"][0] == "i" else "float"
                channels = {"2": 2, "3": 3, "4": 4}.get(about["type"][-1], 1)
                lines.append(" ".join([f"{about['role']} {value} {kind} {channels} {4 * int(np.prod(shape))}:", *map(str, shape)]))
            lines += [f"phase {phase} {session.plans[phase]['steps']}" for phase in session.phases]
        assert player("run", FOLDER / f"{name}.dressi", "values", ".", ".").stdout.splitlines() == lines


@pytest.mark.parametrize("profile", make_vectors.PROFILES["variants"])
def test_every_variant_can_be_played(gpu, player, tmp_path, profile):
    steps, expected, tolerance = make_vectors.load("variants")
    (tmp_path / "x").write_bytes(steps[0][2].tobytes())
    done = player("run", FOLDER / "variants.dressi", "set", "x", tmp_path / "x", "get", "y0", tmp_path / "y0", "report", ".", ".",
                  DRESSI_PROFILE=profile)
    assert np.abs(np.fromfile(tmp_path / "y0", np.float32) - expected[1].ravel()).max() <= tolerance
    with runtime.load(FOLDER / "variants.dressi", gpu.device, profile=profile) as session:
        assert json.loads(done.stdout)["variants"] == session.report()["variants"]
    done = player("run", FOLDER / "variants.dressi", DRESSI_PROFILE="radeon")
    assert (done.returncode, done.stderr) == (INPUT, "profile 'radeon' is none of this bundle's; there are: limit8 vulkan_min\n")


def test_a_smaller_device_takes_a_later_variant_or_says_what_it_lacks(gpu, player):
    told = json.loads(player.shimmed("run", FOLDER / "variants.dressi", "report", ".", ".", SHIM_COLORS="4").stdout)
    with runtime.load(FOLDER / "variants.dressi", EmulatedDevice(gpu.device, "vulkan_min")) as session:
        why = {name: line.replace("vulkan_min:", f"{gpu.device.name}:").replace("profile vulkan_min", f"profile {gpu.device.name}")
               for name, line in session.report()["variants"].items()}
    assert told["profile"] == "vulkan_min" and told["variants"]["vulkan_min"] == why["vulkan_min"]
    assert re.match(r"does not fit llvmpipe.*: .* needs 5 colour attachments; profile llvmpipe.* allows 4 \(maxColorAttachments\)",
                    told["variants"]["limit8"])
    done = player.shimmed("run", FOLDER / "variants.dressi", SHIM_COLORS="0")
    assert done.returncode == DEVICE and re.match(r"no variant of the bundle fits: limit8: .*; vulkan_min: .*; compile it", done.stderr)
    done = player.shimmed("run", FOLDER / "states.dressi", SHIM_COLORS="1")
    assert done.returncode == DEVICE and re.match(r"the bundle, made for profile lavapipe, does not fit llvmpipe.*: .* needs 3 colour "
                                                  r"attachments; .*; compile it for a profile this device has", done.stderr)
    images = bundle.read(FOLDER / "states.dressi").description["images"]
    texels = sum(bundle.v.TEXEL_BYTES[i["format"]] * i["width"] * i["height"] * i["slots"] for i in images)
    for heap, why in ((texels - 1, "its images need 0.0 MB; llvmpipe.* has 0.0 MB of memory for them; compile"),
                      (texels, r"the images of this bundle need 0.0 MB; llvmpipe.* has 0.0 MB \(heap 0\); compile")):
        done = player.shimmed("run", FOLDER / "states.dressi", SHIM_HEAP=str(heap))
        assert done.returncode == DEVICE and re.search(why, done.stderr), done.stderr


def test_what_is_asked_for_wrongly_is_named_and_changes_nothing(player, tmp_path):
    infinite, short, beyond = tmp_path / "x", tmp_path / "short", tmp_path / "beyond"
    infinite.write_bytes(np.full((13, 3), np.inf, np.float32).tobytes())
    short.write_bytes(bytes(8))
    asked = {f"get:y {tmp_path / 'y'}": (INPUT, "map needs x; set it first"), f"get:z {tmp_path / 'y'}": (INPUT, "'z' is no input or state "
             "or output of this bundle; there are: x scale y"), f"get:x {tmp_path / 'y'}": (INPUT, "x has no value yet; set it first"),
             "step:walk 1": (INPUT, "'walk' is no phase of this bundle; there are: "),
             "step:. 1": (INPUT, "this bundle updates nothing: there is no phase to step"),
             f"set:x {infinite}": (INPUT, "x has 39 values that are NaN or Inf; finite numbers are needed"),
             f"set:x {short}": (INPUT, "x: the array has 8 bytes; 156 are needed, of shape (13, 3) and type float"),
             f"set:y {short}": (INPUT, "'y' is no input or state of this bundle; there are: x scale")}
    done = player("run", FOLDER / "ops.dressi", *(word for ask in asked for word in ("try", *ask.split(" "))), "report", ".", ".")
    assert [(int(line[0]), line[2:]) for line in done.stdout.splitlines()[:-1]] == [*asked.values()]
    assert json.loads(done.stdout.splitlines()[-1])["runs"] == {"map": 0}
    beyond.write_bytes(np.full((5, 7, 3), [0, 1, 65520], np.float32).tobytes())
    done = player("run", FOLDER / "half.dressi", "try", "set:target", beyond)
    assert "3 target[0, 0, 2] is 65520, beyond the range of fp16 in which it is stored" in done.stdout
    done = player("run", FOLDER / "ops.dressi", DRESSI_DEVICE="no such device")
    assert done.returncode == DEVICE
    assert "no Vulkan device is called 'no such device' (from DRESSI_DEVICE); there are 0: llvmpipe" in done.stderr
    assert player("run", FOLDER / "ops.dressi", DRESSI_DEVICE="0").returncode == 0
    none = player("run", FOLDER / "ops.dressi", VK_ICD_FILENAMES="/nothing", VK_DRIVER_FILES="/nothing", VK_INSTANCE_LAYERS="")
    assert none.returncode == DEVICE and "no Vulkan driver found" in none.stderr


def test_a_step_ends_in_time_or_when_it_is_cancelled(gpu, player, tmp_path):
    bounds = [word for bound in ("0:1", "5:0", "7:100") for word in ("bound", "walk", bound)]
    done = player("run", FOLDER / "states.dressi", "bound", "walk", "1000000:0.3", "get", "a", tmp_path / "a", *bounds,
                  "cancel", ".", "1000000:4", "get", "a", tmp_path / "b", "loss", ".", ".")
    counts = [int(line) for line in done.stdout.splitlines()[:5]]
    assert 0 < counts[0] < 1_000_000 and counts[1:4] == [0, 0, 7] and 3 <= counts[4] < 1_000_000
    with runtime.load(FOLDER / "states.dressi", gpu.device) as session:
        session.step(counts[0], "walk")
        assert session.get("a").tobytes() == (tmp_path / "a").read_bytes()
        session.step(sum(counts[1:]))
        assert session.get("a").tobytes() == (tmp_path / "b").read_bytes()


def test_threads_get_while_one_steps(player):
    steps, calls, wrong = map(int, player("run", FOLDER / "states.dressi", "step", "walk", "1", "threads", "a", "3").stdout.split())
    assert steps > 0 and calls > 3 and wrong == 0


def test_a_session_belongs_to_the_process_that_opened_it(player, tmp_path):
    done = player("run", FOLDER / "states.dressi", "step", "walk", "2", "fork", "t", ".", "step", "walk", "1", "get", "t", tmp_path / "t")
    assert re.match(r"4 the session belongs to process \d+, of which this one is a fork; load the bundle in this process", done.stdout)
    assert done.returncode == 0 and np.fromfile(tmp_path / "t", np.int32) == 3


# Checkpoints


@pytest.mark.parametrize("name, before, after", [("states", [("walk", 3), ("rest", 1)], [("walk", 2)]),
                                                 ("copies", [("fit", 3)], [("fit", 2), ("fade", 1)])])
def test_each_restores_what_the_other_wrote(gpu, player, tmp_path, name, before, after):
    """They write the same bytes, and what follows is the same to the bit."""
    path, steps, states = FOLDER / f"{name}.dressi", make_vectors.load(name)[0], {"states": "abt", "copies": ("texels", "t")}[name]
    sets = [step for step in steps if step[0] == "set"][:1] if name == "copies" else []
    words = []
    with runtime.load(path, gpu.device) as session:
        for _, value, array in sets:
            session.set(value, array)
            (tmp_path / value).write_bytes(array.tobytes())
            words += ["set", value, tmp_path / value]
        for phase, n in before:
            session.step(n, phase)
            words += ["step", phase, n]
        session.checkpoint(tmp_path / "python")
        for phase, n in after:
            session.step(n, phase)
        expected = {value: session.get(value).tobytes() for value in states}
    onward = [word for phase, n in after for word in ("step", phase, n)]
    got = [word for value in states for word in ("get", value, tmp_path / f"{value}.bin")]
    assert player("run", path, *words, "save", ".", tmp_path / "native").returncode == 0
    assert (tmp_path / "native").read_bytes() == (tmp_path / "python").read_bytes()
    assert player("run", path, *words, "step", after[0][0], 5, "load", ".", tmp_path / "python", *onward, *got).returncode == 0
    assert {value: (tmp_path / f"{value}.bin").read_bytes() for value in states} == expected
    with runtime.load(path, gpu.device) as session:
        session.restore(tmp_path / "native")
        for phase, n in after:
            session.step(n, phase)
        assert {value: session.get(value).tobytes() for value in states} == expected


def test_what_is_no_checkpoint_of_this_bundle_changes_nothing(gpu, player, tmp_path):
    path = FOLDER / "states.dressi"
    with runtime.load(path, gpu.device) as session:
        session.step(3, "walk")
        session.checkpoint(tmp_path / "c")
        expected = session.get("a").tobytes()
    whole, words, told = (tmp_path / "c").read_bytes(), ["step", "walk", 3], []
    for k, (make, message) in enumerate(test_checkpoint.BAD.values()):
        (tmp_path / str(k)).write_bytes(make(whole))
        words += ["try", "load:.", tmp_path / str(k)]
        told.append((BUNDLE, re.escape(f"{tmp_path / str(k)}: ") + ".*" + message))
    for file, message in (("nothing", "cannot be read: No such file"), ("", "cannot be read: Is a directory; it is no regular file")):
        words += ["try", "load:.", tmp_path / file]
        told.append((INPUT, "the checkpoint " + message))
    for file, message in (("no/c", "cannot be written: No such file"), ("", "cannot be written")):
        words += ["try", "save:.", tmp_path / file]
        told.append((INPUT, "the checkpoint " + message))
    done = player("run", path, *words, "get", "a", tmp_path / "a", "load", ".", tmp_path / "c", "report", ".", ".")
    lines = done.stdout.splitlines()
    for line, (code, message) in zip(lines[:-1], told, strict=True):
        assert int(line[0]) == code and re.search(message, line), (line, message)
    assert (tmp_path / "a").read_bytes() == expected and json.loads(lines[-1])["runs"]["walk"] == 3
    assert not [p for p in tmp_path.iterdir() if p.name.endswith(".part")]


# Trouble


STEPPED = ("try", "step:walk", 1, "step", "walk", 1, "get", "a")


@pytest.mark.parametrize("call", ["CreateBuffer", "AllocateMemory", "CreateFramebuffer", "CreateDescriptorPool", "AllocateDescriptorSets",
                                  "BeginCommandBuffer", "QueueSubmit", "CreateImageView", "CreateGraphicsPipelines"])
def test_memory_that_is_not_there_leaves_the_session_usable_or_none(gpu, player, tmp_path, call):
    """Each call of this name fails in turn: a session opens or does not, a step runs or can be tried again."""
    with runtime.load(FOLDER / "states.dressi", gpu.device) as session:
        after = {}
        for n in (1, 2):
            session.step(1, "walk")
            after[n] = session.get("a").tobytes()
    found = set()
    for number in (1, 3, 6):
        failing = f"{call}:{number}:{OUT_OF_DEVICE_MEMORY}"
        done = player.shimmed("run", FOLDER / "states.dressi", *STEPPED, tmp_path / "a", SHIM_FAIL=failing)
        if not done.stdout:
            assert done.returncode in (MEMORY, DEVICE) and f"vk{call} failed with VK_ERROR_OUT_OF_DEVICE_MEMORY" in done.stderr
            found.add("not opened")
        elif done.stdout[0] == str(MEMORY):
            assert done.returncode == 0 and (tmp_path / "a").read_bytes() == after[1]
            found.add("tried again")
        elif not done.returncode:
            assert (tmp_path / "a").read_bytes() == after[2]
    assert found


@pytest.mark.parametrize("call", ["QueueSubmit", "WaitForFences", "BeginCommandBuffer", "AllocateCommandBuffers"])
def test_a_lost_device_closes_the_session_and_says_so(player, tmp_path, call):
    failed = 0
    for number in (1, 2, 4, 6, 9):
        done = player.shimmed("run", FOLDER / "states.dressi", "try", "step:walk", 1, "try", "get:a", tmp_path / "a",
                              "try", "save:.", tmp_path / "c", SHIM_FAIL=f"{call}:{number}:{DEVICE_LOST}")
        lines = done.stdout.splitlines()
        if not lines:
            assert done.returncode == LOST and re.search(r"llvmpipe.* was lost \(vk.*VK_ERROR_DEVICE_LOST.*\); open it again", done.stderr)
        elif any(line[0] == str(LOST) for line in lines):
            first = next(k for k, line in enumerate(lines) if line[0] == str(LOST))
            closed = r"5 the session is closed: llvmpipe.* was lost .*restore the last checkpoint there"
            assert all(re.match(closed, line) for line in lines[first:])
            failed += 1
        else:
            assert [line[0] for line in lines] == ["0", "0", "0"]
    assert failed


def test_compiled_pipelines_are_kept_for_the_next_process_and_for_python(gpu, player, tmp_path):
    folder, log = tmp_path / "cache", tmp_path / "log"

    def run(**environment):
        """What the report says, and the bytes that the driver was given."""
        log.write_text("")
        done = player.shimmed("run", FOLDER / "states.dressi", "step", "walk", 1, "report", ".", ".", SHIM_CACHE=str(log),
                              **{"DRESSI_CACHE": str(folder), **environment})
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)["pipeline_cache"], [int(line) for line in log.read_text().split()]

    assert run() == ("stored", [0]) and run() == ("hit", [1000])
    d = gpu.device
    key = pipeline_cache.key(bundle.read(FOLDER / "states.dressi").digest, d.vendor_id, d.device_id, d.driver_version,
                             d.pipeline_cache_uuid, d.name, d.driver_name, d.driver_info, d.device_uuid, d.driver_uuid)
    file = folder / key.file
    assert len(pipeline_cache.load(folder, key)) == 1000
    assert stat.S_IMODE(file.stat().st_mode) == 0o600 and stat.S_IMODE(folder.stat().st_mode) == 0o700
    whole = file.read_bytes()
    for damaged in (whole[:-1], whole[:-1] + b"\0", b"", whole + b"\0", whole.replace(b"DRESSIPC", b"DRESSIPD")):
        file.write_bytes(damaged)
        assert run() == ("stored", [0])
    file.chmod(0o660)
    assert run() == ("stored", [0])
    file.unlink()
    file.symlink_to(tmp_path / "elsewhere")
    (tmp_path / "elsewhere").write_bytes(whole)
    assert run() == ("stored", [0])
    folder.chmod(0o770)
    assert run()[0] == f"off ({folder} can be written to by others; chmod go-w it, or set DRESSI_CACHE to a folder of your own)"
    folder.chmod(0o700)
    assert run(DRESSI_CACHE="off") == ("off (DRESSI_CACHE=off)", [])
    (tmp_path / "file").write_text("")
    assert run(DRESSI_CACHE=str(tmp_path / "file" / "x"))[0].startswith("off (")
    for k in range(2):  # what was used least recently goes first, and nothing that is not ours
        path = folder / f"{k:040}.pipelines"
        path.touch()
        os.truncate(path, 40 << 20)
        os.utime(path, (k + 1, k + 1))
    (folder / "other").write_text("other")
    file.unlink()
    assert run() == ("stored", [0])
    assert sorted(p.name for p in folder.iterdir()) == sorted([file.name, "other", f"{1:040}.pipelines"])
    assert run(DRESSI_CACHE="", XDG_CACHE_HOME=str(tmp_path / "xdg")) == ("stored", [0]) and [*(tmp_path / "xdg" / "dressi_edge").iterdir()]


# dressi-play


@pytest.fixture(scope="module")
def play(player):
    """Runs the program; the finished process."""
    return Player(player.program.parent / "dressi-play", player.shim)


def test_a_captured_profile_is_that_of_python_to_the_byte(play, tmp_path):
    assert jobs.command("profiles", "capture", "-n", "here", "--device", "llvmpipe", "-o", tmp_path / "python.json").returncode == 0
    done = play("capture", "--name", "here", "--output", tmp_path / "native.json")
    assert done.stdout == f"{tmp_path / 'native.json'}: profile here\n"
    assert (tmp_path / "native.json").read_bytes() == (tmp_path / "python.json").read_bytes()
    profile = Profile.load(tmp_path / "native.json")
    assert profile.name == "here" and check(profile) == check(Profile.load(tmp_path / "python.json"))
    assert play("capture", "--name", "Not so").stderr == "dressi-play: profile name 'Not so': 1 to 64 of a-z, 0-9 and _ are allowed\n"
    assert play("devices").stdout == jobs.command("devices").stdout


@pytest.mark.parametrize("name", ["subpasses", "variants", "copies"])
def test_a_bundle_is_told_as_python_tells_it(play, name):
    path = FOLDER / f"{name}.dressi"
    assert play("verify", path).stdout == jobs.command("verify", path).stdout
    told = re.sub(r"\d+ functions, |needs of the device: .*", "", jobs.command("inspect", path).stdout).splitlines()
    found = play("inspect", path).stdout.splitlines()
    assert len(told) > 5 and [line for line in told if line not in found] == []


def test_a_bundle_is_run_and_goes_on(gpu, play, tmp_path):
    path, folder = FOLDER / "copies.dressi", tmp_path
    uv = make_vectors.load("copies")[0][0][2]
    (folder / "uv").write_bytes(uv.tobytes())
    first = play("run", path, "--phase", "fit", "--steps", 3, "--set", f"uv={folder / 'uv'}", "--checkpoint", folder / "c", "--explain")
    assert first.returncode == 0 and re.match(r"fit: 3 steps, .* ms a step\n\{", first.stdout), first.stderr
    second = play("run", path, "--phase", "fit", "--steps", 2, "--restore", folder / "c", "--get", f"texels={folder / 'texels'}")
    assert second.returncode == 0, second.stderr
    with runtime.load(path, gpu.device) as session:
        session.set("uv", uv)
        session.step(5, "fit")
        assert session.get("texels").tobytes() == (folder / "texels").read_bytes()
    told = play("bench", FOLDER / "states.dressi", "--steps", 4).stdout
    assert re.fullmatch(r"opened in .* ms\n((walk|rest): the first step .* ms, then .* ms, the median of 4 .*\n){2}", told)


def test_words_that_are_wrong_are_named(play, tmp_path):
    ops, states = FOLDER / "ops.dressi", FOLDER / "states.dressi"
    for words, code, told in (
            ((), INPUT, "needed: run, bench"), (("dance", ops), INPUT, "dance is none of run, bench"),
            (("run", ops, "--loud", "x"), INPUT, "--loud is not understood"), (("run", ops, "--steps"), INPUT, "needs a word"),
            (("run", ops, "--steps", "many"), INPUT, "--steps many: a number"), (("run", ops, ops), INPUT, "one bundle is enough"),
            (("run", ops, "--get", "y"), INPUT, "--get y: NAME=FILE is needed"), (("run", states), INPUT, "phase walk says no number"),
            (("run", states, "--phase", "jump"), INPUT, "--phase jump is no phase"),
            (("run", ops, "--set", "x=/nothing"), INPUT, "/nothing cannot be read: No such file"),
            (("verify", ROOT / "README.md"), BUNDLE, "not a bundle"), (("verify", states, "--pin", "0" * 64), BUNDLE, "the pin is"),
            (("run", states, "--device", "nothing"), DEVICE, "no Vulkan device is called 'nothing'; there are")):
        done = play(*words)
        assert done.returncode == code and done.stderr.startswith("dressi-play: ") and told in done.stderr, (words, done.stderr)


@pytest.mark.full
def test_the_benchmark_finds_the_same_bits(tmp_path):
    subprocess.run([sys.executable, ROOT / "benchmarks" / "native.py", "--quick", "--json", tmp_path / "out.json"], check=True,
                   env=os.environ | {"PYTHONPATH": str(ROOT)})
    report = json.loads((tmp_path / "out.json").read_text())
    assert all(report["states_equal"].values()) and report["steps"] == 6 and report["all_steps"]["native"]["peak_kb"] > 0
