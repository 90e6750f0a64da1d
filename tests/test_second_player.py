"""A player in C, written from docs/bundle-format.md alone, gives the bits that the runtime gives, and refuses what it should."""

import os
import shutil
import subprocess
from pathlib import Path

import hostile_bundles
import jobs
import make_vectors
import numpy as np
import pytest

from dressi_edge import runtime
from dressi_edge.cache import bundle

pytest_plugins = ["gpu"]

SOURCE = Path(__file__).parent / "player" / "player.c"
LAYER = {"VK_INSTANCE_LAYERS": "VK_LAYER_KHRONOS_validation", "DRESSI_DEVICE": "llvmpipe"}

POINTS = jobs.TINY.replace('"colors"', '"texture"\ntexture_grad = "inverse_uv"').replace("colors", "texture")

# What only the interfaces of shaders tell: the player leaves that to whoever verified the bundle.
UNSEEN = {"binding_unseen", "binding_missing", "binding_other_kind", "draw_integers"}


@pytest.fixture(scope="module")
def player(tmp_path_factory):
    """Runs the player; its result."""
    compiler = os.environ.get("CC") or shutil.which("cc")
    if not compiler:
        pytest.skip("no C compiler: the player in C is not tested; apt-get install gcc libc6-dev")
    includes = subprocess.run([compiler, "-E", "-x", "c", "-"], input="#include <vulkan/vulkan.h>\n", capture_output=True, text=True)
    if includes.returncode:
        pytest.skip("no headers of Vulkan: the player in C is not tested; apt-get install libvulkan-dev")
    program = tmp_path_factory.mktemp("player") / "player"
    strict = ["-std=c11", "-O1", "-g", "-Wall", "-Wextra", "-Werror", "-fsanitize=address,undefined", "-fno-sanitize-recover=undefined"]
    subprocess.run([compiler, *strict, SOURCE, "-o", program, "-lvulkan", "-lm"], check=True)

    def run(*words, **environment):
        return subprocess.run([program, *words], capture_output=True, text=True,
                              env=os.environ | {"ASAN_OPTIONS": "detect_leaks=0"} | environment)

    return run


@pytest.mark.parametrize("name", make_vectors.VECTORS)
def test_both_players_give_the_same_bits(gpu, player, tmp_path, name):
    steps, _, _ = make_vectors.load(name)
    assert replay(gpu, player, tmp_path, make_vectors.FOLDER / f"{name}.dressi", steps) == sum(step[0] == "get" for step in steps)


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


@pytest.mark.parametrize("profile", make_vectors.PROFILES["variants"])
def test_every_variant_can_be_played(player, tmp_path, profile):
    steps, expected, tolerance = make_vectors.load("variants")
    (tmp_path / "x").write_bytes(steps[0][2].tobytes())
    done = player("run", make_vectors.FOLDER / "variants.dressi", "set", "x", tmp_path / "x", "get", "y0", tmp_path / "y0", **LAYER,
                  DRESSI_PROFILE=profile)
    assert done.stdout == f"profile: {profile}\n"
    assert np.abs(np.fromfile(tmp_path / "y0", np.float32) - expected[1].ravel()).max() <= tolerance


def replay(gpu, player, folder, path, steps):
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
    done = player("run", path, *words, **LAYER)
    assert (done.returncode, done.stdout.count("Validation")) == (0, 0), done.stdout + done.stderr
    for step, array, found in wanted:
        assert array.read_bytes() == found.tobytes(), step
    return len(wanted)


def test_what_is_asked_for_wrongly_is_named(player, tmp_path):
    ops, array = make_vectors.FOLDER / "ops.dressi", tmp_path / "x.bin"
    array.write_bytes(np.full((13, 3), np.inf, np.float32).tobytes())
    for words, told in ((("get", "y", array), "map reads x, which has no value"), (("get", "z", array), "no value z"),
                        (("get", "x", array), "x has no value"), (("step", "walk", "1"), "no plan walk"),
                        (("set", "x", array), "number 0 is not finite"),
                        (("set", "scale", array), "scale needs 4"), (("set", "y", array), "y is an output")):
        done = player("run", ops, *words, **LAYER)
        assert done.returncode == 1 and told in done.stderr
    assert "no Vulkan device" in player("run", ops, DRESSI_DEVICE="no such device").stderr


def test_the_player_refuses_what_is_malformed(player, tmp_path):
    """Every field, size and index is checked: of the malformed bundles it plays only those listed above."""
    path, accepted = tmp_path / "hostile.dressi", set()
    cases = {row[0]: hostile_bundles.spoiled(row[1], row[2]) for row in hostile_bundles.ROWS}
    for name, data in (cases | {name: data for name, (data, _) in hostile_bundles.files().items()}).items():
        path.write_bytes(data)
        done = player("check", path)
        assert done.returncode in (0, 2) and bool(done.returncode) == bool(done.stderr), (name, done.stderr)
        if not done.returncode:
            accepted.add(name)
    assert accepted == UNSEEN
