"""The command line: each kind of failure has its exit code and one line; a job becomes a mesh; the device needs no compiler."""

import hashlib
import inspect
import json
import os
import subprocess
import sys

import numpy as np
import pytest
from jobs import ROOT, TINY, command, write_job

from dressi_edge import cli
from dressi_edge.cache.layout import Layout
from dressi_edge.cache.profile import Profile, profile_names
from dressi_edge.commands import run as run_module
from dressi_edge.compiler import Program, compile_program
from dressi_edge.compiler.io.meshes import load_mesh
from dressi_edge.runtime.session import Session


@pytest.fixture(autouse=True)
def environment(monkeypatch):
    for name in ("DRESSI_DEVICE", "DRESSI_DEBUG", "DRESSI_DUMP"):
        monkeypatch.delenv(name, raising=False)


def here(capsys, *args):
    """(exit code, stdout, stderr) of the command in this process."""
    try:
        code = cli.main([str(a) for a in args])
    except SystemExit as stop:
        code = stop.code
    out = capsys.readouterr()
    return code, out.out, out.err


def one_line(stderr):
    """What is told of an error: one line, among those in which a slow machine said what it was at."""
    assert "Traceback" not in stderr
    stderr = "".join(line for line in stderr.splitlines(True) if line.startswith("dressi-edge: "))
    assert stderr.startswith("dressi-edge: ") and stderr.endswith("\n") and stderr.count("\n") == 1
    return stderr


@pytest.fixture(scope="module")
def solved(tmp_path_factory):
    """A folder with job.toml, x.dressi and what `run` wrote, all made from another directory."""
    folder, elsewhere = tmp_path_factory.mktemp("job"), tmp_path_factory.mktemp("elsewhere")
    write_job(folder)
    made = command("compile", folder / "job.toml", "-p", "lavapipe", "-o", folder / "x.dressi", cwd=elsewhere)
    assert made.returncode == 0, made.stderr
    ran = command("run", folder / "x.dressi", "-o", folder / "out.glb", "--explain", cwd=elsewhere)
    assert ran.returncode == 0, ran.stderr
    assert list(elsewhere.iterdir()) == []
    return folder, made, ran


def test_a_job_becomes_a_mesh_with_pictures_and_numbers(solved):
    folder, made, ran = solved
    assert "phases shape (3 steps) paint (2 steps)" in made.stdout
    metrics = json.loads((folder / "out_metrics.json").read_text())
    assert sorted(p.name for p in folder.glob("out*")) == ["out.glb", "out_loss.png", "out_metrics.json", "out_sheet.png"]
    assert {name: p["steps"] for name, p in metrics["phases"].items()} == {"shape": 3, "paint": 2}
    for phase in metrics["phases"].values():
        assert phase["loss_last"] < phase["loss_first"] and phase["ms_per_step"] > 0
    assert [x for x, _ in metrics["losses"]["shape"]] == [0, 1, 2, 3]
    assert 0.3 < metrics["views"]["iou_mean"] <= 1 and metrics["views"]["psnr_mean"] > 3 and metrics["profile"] == "lavapipe"
    mesh = load_mesh(folder / "out.glb")
    assert len(mesh.positions) == 42 and len(mesh.faces) == 80
    assert "shape: 3 steps, loss" in ran.stdout and "out_sheet.png" in ran.stdout and "runs: {" in ran.stdout
    assert "shape 3/3 loss" in ran.stderr and "paint 2/2 loss" in ran.stderr


@pytest.mark.parametrize("suffix, files", [(".obj", ["b.obj"]), (".ply", ["b.ply"]), (".npz", ["b.npz"])])
def test_the_extension_chooses_the_output(solved, tmp_path, capsys, suffix, files):
    code, out, _ = here(capsys, "run", solved[0] / "x.dressi", "--phase", "shape", "--steps", "2", "-o",
                        tmp_path / f"b{suffix}", "--json")
    metrics = json.loads(out)
    assert code == 0 and list(metrics["phases"]) == ["shape"] and metrics["phases"]["shape"]["steps"] == 2
    assert set(files) <= {p.name for p in tmp_path.iterdir()}
    if suffix == ".npz":
        states = np.load(tmp_path / "b.npz")
        assert states["vertices"].shape == (42, 3) and states["shape.step"] == 2
        assert [p.name for p in tmp_path.iterdir()] == ["b.npz"]
    else:
        assert len(load_mesh(tmp_path / f"b{suffix}").faces) == 80


def test_two_compilations_give_the_same_bytes(solved, tmp_path):
    again = command("compile", "job.toml", "-p", "lavapipe", "-o", tmp_path / "y.dressi", cwd=solved[0], PYTHONHASHSEED="1")
    assert again.returncode == 0, again.stderr
    assert (tmp_path / "y.dressi").read_bytes() == (solved[0] / "x.dressi").read_bytes()


def test_the_reference_device_agrees_with_lavapipe(solved, capsys):
    losses = {}
    for device, path in (("reference", "job.toml"), ("llvmpipe", "x.dressi")):
        code, out, err = here(capsys, "run", solved[0] / path, "--device", device, "--json")
        assert code == 0, err
        losses[device] = {name: (p["loss_first"], p["loss_last"]) for name, p in json.loads(out)["phases"].items()}
    for name, values in losses["reference"].items():
        np.testing.assert_allclose(losses["llvmpipe"][name], values, rtol=2e-3)


def test_one_bundle_for_several_profiles_runs_the_one_that_fits_or_is_asked_for(solved, tmp_path, capsys):
    path = tmp_path / "several.dressi"
    code, out, err = here(capsys, "compile", solved[0] / "job.toml", "-p", "lavapipe", "-p", "limit4", "-o", path)
    assert code == 0 and "for profile lavapipe, " in out and "for profile limit4, " in out, err
    assert path.stat().st_size < 1.6 * (solved[0] / "x.dressi").stat().st_size
    for more, taken in (((), "lavapipe"), (("--profile", "limit4"), "limit4"), (("--emulate", "limit4"), "limit4")):
        code, out, err = here(capsys, "run", path, "--steps", "1", "--explain", "--json", *more)
        report = json.loads(out)["report"]
        assert code == 0 and report["profile"] == taken and set(report["variants"]) == {"lavapipe", "limit4"}, err
    assert report["variants"]["lavapipe"].startswith("does not fit limit4: ")
    code, _, err = here(capsys, "run", path, "--profile", "limit8")
    assert code == 3 and "is none of this bundle's; there are: lavapipe limit4" in one_line(err)
    code, _, err = here(capsys, "compile", solved[0] / "job.toml", "-p", "limit4", "-p", "limit4", "-o", path)
    assert code == 3 and "profile limit4 is given twice" in one_line(err)


def test_running_without_a_mesh_imports_no_compiler(solved, tmp_path):
    code = ("import sys\nsys.modules.update(PIL=None)\nfrom dressi_edge.cli import main\n"
            "code = main(sys.argv[1:])\nassert not [m for m in sys.modules if m.startswith('dressi_edge.compiler')]\n"
            "sys.exit(code)")
    for args in (["run", "--steps", "1", "-o", tmp_path / "a.npz"], ["inspect"], ["verify"]):
        done = subprocess.run([sys.executable, "-c", code, args[0], str(solved[0] / "x.dressi"), *map(str, args[1:])],
                              env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
    done = subprocess.run([sys.executable, "-c", code, "run", str(solved[0] / "x.dressi"), "-o", str(tmp_path / "a.glb")],
                          env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True)
    assert "pip install 'dressi_edge[compiler]'" in done.stderr


POSED = """
[mesh]
sphere = {vertices = 42, radius = 0.5}
[views]
transforms = "photos"
[render]
shading = "lambert"
albedo = "constant"
srgb = true
[[light]]
kind = "point"
vector = [0, 2, 2]
power = 30
[[phase]]
name = "pose"
steps = 2
optimize.rotation = {rate = 0.01}
optimize.translation = {rate = 0.01}
optimize."light0.power" = {optimizer = "sgd", rate = 1.0}
[[phase.loss]]
kind = "color"
"""


def test_cameras_and_lights_that_were_optimized_are_in_the_metrics(tmp_path, capsys):
    path = write_job(tmp_path, POSED)
    assert here(capsys, "compile", path, "-p", "vulkan_min", "-o", tmp_path / "x.dressi")[0] == 0
    code, _, err = here(capsys, "run", tmp_path / "x.dressi", "-o", tmp_path / "out.ply")
    assert code == 0, err
    metrics = json.loads((tmp_path / "out_metrics.json").read_text())
    frames = json.loads((tmp_path / "photos" / "transforms.json").read_text())["frames"]
    for frame, name in zip(frames, ("0", "1")):
        moved = np.array(metrics["camera_to_world"][name]) - frame["transform_matrix"]
        assert 0.001 < np.abs(moved).max() < 0.1
    assert len(metrics["lights"]["light0.power"]) == 3 and metrics["lights"]["light0.power"] != [30.0] * 3


def test_inspect_counts_plans(solved, capsys):
    bundle = solved[0] / "x.dressi"
    code, out, _ = here(capsys, "inspect", bundle, "--json")
    (profile, plans), = json.loads(out).items()
    assert code == 0 and profile == "lavapipe" and {"shape", "shape.loss", "paint", "render"} <= set(plans)
    for row in plans.values():
        assert set(row) == {"functions", "substages", "stages", "pipelines", "bytes_per_step"}
        assert row["functions"] >= row["substages"] >= row["stages"] > 0 and row["pipelines"] > 0 and row["bytes_per_step"] > 0
    code, out, _ = here(capsys, "inspect", bundle)
    assert code == 0 and f"shape: {plans['shape']['functions']} functions" in out and "attachments" in out
    code, out, _ = here(capsys, "inspect", bundle, "--dot")
    assert code == 0 and out.startswith("digraph") and out.count("{") == out.count("}") and "->" in out


def test_bench_times_every_stage(solved, capsys):
    code, out, _ = here(capsys, "bench", solved[0] / "x.dressi", "--runs", "2", "--json")
    report = json.loads(out)
    assert code == 0 and report["plans"]["shape"]["step_ms"] > 0
    for row in report["plans"].values():
        assert len(row["stage_ms"]) == row["stages"] and row["ms"] == pytest.approx(sum(row["stage_ms"]))
    code, out, _ = here(capsys, "bench", solved[0] / "x.dressi", "--runs", "1")
    assert code == 0 and "ms on the device" in out


def test_verify_says_ok_or_the_first_thing_wrong(solved, tmp_path, capsys):
    code, out, _ = here(capsys, "verify", solved[0] / "x.dressi")
    assert code == 0 and out.startswith("OK ")
    assert here(capsys, "verify", solved[0] / "x.dressi", "-p", "lavapipe")[0] == 0
    code, _, err = here(capsys, "verify", solved[0] / "x.dressi", "-p", "limit4")
    assert code == 3 and "does not fit profile limit4" in one_line(err)
    digest = hashlib.sha256((solved[0] / "x.dressi").read_bytes()).hexdigest()
    assert here(capsys, "verify", solved[0] / "x.dressi", "--pin", digest)[0] == 0
    code, _, err = here(capsys, "verify", solved[0] / "x.dressi", "--pin", digest[::-1])
    assert code == 3 and "the pin is" in one_line(err)
    data = bytearray((solved[0] / "x.dressi").read_bytes())
    data[len(data) // 2] ^= 1
    (tmp_path / "bad.dressi").write_bytes(data)
    code, out, err = here(capsys, "verify", tmp_path / "bad.dressi")
    assert code == 3 and not out and "checksum" in one_line(err)


def test_emulation_holds_a_bundle_to_another_device(solved, capsys):
    code, _, err = here(capsys, "run", solved[0] / "x.dressi", "--steps", "1", "--emulate", "limit4")
    assert code == 4 and "limit4" in one_line(err)
    assert here(capsys, "run", solved[0] / "x.dressi", "--steps", "1", "--emulate", "unlimited")[0] == 0


def test_debug_and_dump_show_what_was_compiled(tmp_path):
    write_job(tmp_path)
    done = command("compile", tmp_path / "job.toml", "-p", "limit4", "-o", tmp_path / "x.dressi", DRESSI_DEBUG="3",
                   DRESSI_DUMP=tmp_path / "dump")
    assert done.returncode == 0
    assert all(text in done.stderr for text in ("profile limit4", "substage 0", "void main()"))
    names = {p.name for p in (tmp_path / "dump").iterdir()}
    assert {"stages.dot", "shader000.vert"} <= names
    assert [name.split("-")[1][:-4] for name in sorted(names) if "-" in name] == [
        "built", "simplified", "banded", "listed", "ordered", "specialized", "stored", "packed", "placed", "shaders", "described"]


def test_profiles_are_listed_shown_checked_merged_and_captured(tmp_path, capsys):
    code, out, _ = here(capsys, "profiles", "list")
    assert code == 0 and [line.split()[0] for line in out.splitlines()] == profile_names()
    assert set(json.loads(here(capsys, "profiles", "list", "--json")[1])) == set(profile_names())
    assert Profile.loads(here(capsys, "profiles", "show", "limit4")[1]) == Profile.load("limit4")
    assert here(capsys, "profiles", "check")[0] == 0
    code, _, _ = here(capsys, "profiles", "merge", "limit8", "limit4", "-n", "both", "-o", tmp_path / "both.json")
    assert code == 0 and Profile.load(tmp_path / "both.json").limit("maxColorAttachments") == 4
    code, _, _ = here(capsys, "profiles", "capture", "-n", "here", "-o", tmp_path / "here.json", "--device", "llvmpipe")
    captured = Profile.load(tmp_path / "here.json")
    assert code == 0 and captured.limit("maxColorAttachments") == 8
    assert captured.format_has("R32G32B32A32_SFLOAT", "sampled", "color")
    assert here(capsys, "profiles", "check", tmp_path / "here.json")[0] == 0


def test_devices_are_listed(capsys):
    assert "llvmpipe" in here(capsys, "devices")[1]
    assert any("llvmpipe" in row["name"] for row in json.loads(here(capsys, "devices", "--json")[1]))


@pytest.mark.parametrize("args, expected", [
    ([], "required"), (["draw"], "invalid choice: 'draw'"), (["compile", "job.toml"], "-p/--profile, -o/--output"),
    (["run", "x.dressi", "--steps", "0"], "'0' is no whole number above 0"),
    (["run", "x.dressi", "--step", "3", "--frobnicate"], "--frobnicate"),
    (["inspect", "x.dressi", "--json", "--dot"], "not allowed with")])
def test_wrong_usage_is_exit_code_2(capsys, args, expected):
    code, _, err = here(capsys, *args)
    assert code == 2 and expected in one_line(err) and "--help" in err


@pytest.mark.parametrize("args, expected", [
    (["compile", "none.toml", "-p", "lavapipe", "-o", "y.dressi"], "none.toml cannot be read"),
    (["compile", "job.toml", "-p", "lavapip", "-o", "y.dressi"], "did you mean lavapipe?"),
    (["compile", "job.toml", "-p", "lavapipe", "-o", "none/y.dressi"], "does not exist; create it first"),
    (["run", "none.dressi"], "none.dressi: cannot be read"), (["run", "job.toml"], "make a bundle of it first"),
    (["run", "x.dressi", "--phase", "shap"], "no phase of x.dressi; there are: shape paint"),
    (["run", "x.dressi", "-o", "out.blend"], "extension .blend is unknown; known are .glb .gltf .obj .ply .usdz .npz"),
    (["run", "x.dressi", "-o", "none/out.glb"], "does not exist; create it first"),
    (["run", "x.dressi", "--device", "reference"], "runs a job (.toml)"),
    (["run", "photos/0.png"], "not a bundle"), (["inspect", "job.toml"], "not a bundle"),
    (["verify", "photos"], "is no regular file"),
    (["profiles", "show", "limit5"], "did you mean limit"), (["profiles", "check", "photos/transforms.json"], "unknown key"),
    (["profiles", "merge", "limit4", "limit8", "-n", "A B"], "1 to 64 of a-z"),
    (["demo", "-o", "job.toml"], "cannot be made a folder")])
def test_bad_input_is_exit_code_3_and_leaves_nothing(solved, monkeypatch, capsys, args, expected):
    monkeypatch.chdir(solved[0])
    before = sorted(p.name for p in solved[0].iterdir())
    code, out, err = here(capsys, *args)
    assert code == 3 and expected in one_line(err) and out == ""
    assert sorted(p.name for p in solved[0].iterdir()) == before


@pytest.mark.parametrize("old, new, expected", [
    ("r = 2.0", "raduis = 2.0", "render.raduis is an unknown key"), ("photos/", "none/", "none/transforms.json does not exist"),
    ("sphere = {vertices = 42, radius = 0.5}", "path = 'none.obj'", "none.obj does not exist")])
def test_a_bad_job_is_refused_before_anything_is_compiled(tmp_path, monkeypatch, capsys, old, new, expected):
    monkeypatch.setattr("dressi_edge.compiler.compile_program", None)
    path = write_job(tmp_path, TINY.replace(old, new))
    code, _, err = here(capsys, "compile", path, "-p", "lavapipe", "-o", tmp_path / "x.dressi")
    assert code == 3 and expected in one_line(err) and not (tmp_path / "x.dressi").exists()


def test_no_vulkan_device_is_exit_code_4(solved, tmp_path):
    nowhere = {"VK_DRIVER_FILES": str(tmp_path / "none.json"), "VK_ICD_FILENAMES": str(tmp_path / "none.json")}
    for args in (["run", solved[0] / "x.dressi"], ["run", solved[0] / "x.dressi", "-o", tmp_path / "a.glb"], ["devices"],
                 ["bench", solved[0] / "x.dressi"],
                 ["demo", "-o", tmp_path / "demo"]):
        done = command(*args, **nowhere)
        assert done.returncode == 4 and "no Vulkan" in one_line(done.stderr) and "mesa-vulkan-drivers" in done.stderr, done
    assert not (tmp_path / "a.glb").exists()


def test_an_unknown_device_is_exit_code_4_and_lists_those_there_are(solved, capsys, monkeypatch):
    code, _, err = here(capsys, "run", solved[0] / "x.dressi", "--device", "geforce")
    assert code == 4 and "llvmpipe" in one_line(err)
    monkeypatch.setenv("DRESSI_DEVICE", "radeon")
    code, _, err = here(capsys, "run", solved[0] / "x.dressi")
    assert code == 4 and "DRESSI_DEVICE" in one_line(err)


def test_a_defect_is_exit_code_1_with_a_traceback_only_on_demand(solved, capsys, monkeypatch):
    monkeypatch.setattr("dressi_edge.cache.summary.text", lambda d: 1 / 0)
    code, _, err = here(capsys, "inspect", solved[0] / "x.dressi")
    assert code == 1 and "ZeroDivisionError" in one_line(err) and "DRESSI_DEBUG=1" in err
    monkeypatch.setenv("DRESSI_DEBUG", "1")
    with pytest.raises(ZeroDivisionError):
        cli.main(["inspect", str(solved[0] / "x.dressi")])


class Interrupted:
    """A session that is interrupted once: before, in or after its third submission, or while a loss is fetched. What was submitted
    runs all the same."""

    values, plans = {"p.loss": {}}, {}

    def __init__(self, when):
        self.done, self.calls, self.when = 7, 0, when  # an earlier run of the phase

    def interrupt(self, when):
        if when == self.when and self.calls >= 3:
            self.when = ""
            raise KeyboardInterrupt

    def step(self, n, phase=None):
        self.calls += n > 0
        self.interrupt("before")
        self.done += n
        self.interrupt("in")

    def loss(self):
        self.interrupt("loss")
        return 1.0 / (1 + self.done)

    def report(self):
        return {"runs": {"p": self.done}}


@pytest.mark.parametrize("when", ["before", "in", "loss"])
def test_an_interrupted_phase_says_how_many_steps_ran_and_has_no_step_twice(capsys, when):
    curve, session = [], Interrupted(when)
    out = run_module.solve(session, "p", 100, curve)
    ran = session.done - 7
    assert out["interrupted"] and out["steps"] == ran and (ran == 2) == (when == "before")
    assert curve[-1] == (ran, 1 / (8 + ran)) and len(dict(curve)) == len(curve)
    assert out["loss_last"] == curve[-1][1] and f"stopped p after {ran} of 100 steps" in capsys.readouterr().err


def test_an_interrupt_of_the_command_line_tells_what_ran(solved, capsys, monkeypatch):
    """The report and the states agree: the step counter of the bundle is the count that is told."""
    from dressi_edge.runtime import vk
    real, calls = vk.QueueSubmit, []

    def submit(*args):
        real(*args)
        calls.append(args)
        if len(calls) == 14:
            raise KeyboardInterrupt

    monkeypatch.setattr(vk, "QueueSubmit", submit)
    path = solved[0] / "interrupted.npz"
    code, out, err = here(capsys, "run", solved[0] / "x.dressi", "--steps", 40, "--phase", "shape", "-o", path, "--json")
    steps = json.loads(out)["phases"]["shape"]["steps"]
    assert code == 130 and 0 < steps < 40 and f"stopped shape after {steps} of 40 steps" in err
    assert np.load(path)["shape.step"] == steps


# ---- names and pins

def program_of(name):
    p = Program()
    x = p.state(name, Layout("unit", "float"), 1.0)
    p.plan("go", {name: x * 0.5}, steps=2)
    return p


@pytest.mark.parametrize("name", ["file", "allow_pickle", "../../x", "/x", "a/../x", "a//x", "..", "C:x", "a\\x", "x.npy", "X.NPY"])
def test_states_that_no_npz_can_hold_are_refused_before_the_run(tmp_path, capsys, monkeypatch, name):
    compile_program(program_of(name), "lavapipe", tmp_path / "x.dressi")
    if name == "allow_pickle" and name not in inspect.signature(np.savez).parameters:
        pytest.skip("this NumPy has no such argument")
    monkeypatch.setattr(Session, "step", lambda *_: pytest.fail("it ran"))
    code, _, err = here(capsys, "run", tmp_path / "x.dressi", "-o", tmp_path / "out.npz")
    assert code == 3 and "cannot be an array of an .npz" in one_line(err) and os.listdir(tmp_path) == ["x.dressi"]


@pytest.mark.parametrize("name", ["x", "a/b", "Äpfel", "arr_0", "files", "args", "a.b", "..x", "x" * 200])
def test_every_other_state_is_in_the_npz_under_its_name(tmp_path, capsys, name):
    compile_program(program_of(name), "lavapipe", tmp_path / "x.dressi")
    code, _, err = here(capsys, "run", tmp_path / "x.dressi", "-o", tmp_path / "out.npz")
    assert code == 0, err
    with np.load(tmp_path / "out.npz") as found:
        assert found.files == [name] and found[name] == 0.25


@pytest.mark.parametrize("command", ["run", "bench", "inspect", "verify"])
def test_a_pin_lets_one_file_through(solved, capsys, command):
    path = solved[0] / "x.dressi"
    more = {"run": ["--steps", "1"], "bench": ["--runs", "1"]}.get(command, [])
    pin = hashlib.sha256(path.read_bytes()).hexdigest()
    assert here(capsys, command, path, "--pin", pin, *more)[0] == 0
    for wrong, told in ((pin[::-1], f"the file's SHA-256 is {pin}; the pin is {pin[::-1]}"), ("abc", "is no SHA-256")):
        code, _, err = here(capsys, command, path, "--pin", wrong, *more)
        assert code == 3 and told in one_line(err)
    code, _, err = here(capsys, "run", solved[0] / "job.toml", "--device", "reference", "--pin", pin)
    assert code == 3 and "a job has no digest" in one_line(err)


def test_output_into_a_closed_pipe_is_no_error(solved):
    done = subprocess.run(f"{sys.executable} -m dressi_edge.cli inspect {solved[0] / 'x.dressi'} | head -1", shell=True,
                          capture_output=True,
                          text=True, env={**os.environ, "PYTHONPATH": str(ROOT)})
    assert done.stderr == "" and done.stdout.startswith("profile lavapipe")
