"""A long run in other people's hands: it says how it goes, leaves results on the way, and goes on bit for bit after Ctrl-C, SIGTERM and
kill. Driven as a user drives it, in processes of their own."""

import json
import os
import pty
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from jobs import ROOT, TINY, command, write_job

from dressi_edge.commands.progress import SILENCE, Events, JsonLines, Terminal, duration
from dressi_edge.compiler.io.meshes import load_mesh

STEPS = {"shape": 900, "paint": 3000}
LONG = TINY.replace("steps = 3", f"steps = {STEPS['shape']}").replace("steps = 2\n", f"steps = {STEPS['paint']}\n")
OFTEN = ("--every", "0.0005")


@pytest.fixture(scope="module")
def bundle(tmp_path_factory):
    folder = tmp_path_factory.mktemp("long")
    made = command("compile", write_job(folder, LONG), "-p", "lavapipe", "-o", folder / "x.dressi")
    assert made.returncode == 0, made.stderr
    return folder / "x.dressi"


@pytest.fixture(scope="module")
def whole(bundle):
    """The states of a run that nothing disturbed, and its metrics."""
    done = command("run", bundle, "-o", bundle.parent / "whole.npz", "-o", bundle.parent / "whole.ply")
    assert done.returncode == 0, done.stderr
    return states(bundle.parent / "whole.npz"), json.loads((bundle.parent / "whole_metrics.json").read_text())


def states(path):
    with np.load(path) as found:
        return {name: found[name].tobytes() for name in found.files}


def started(*args, **more):
    """The process of `dressi-edge run ARGS --json-lines`."""
    return subprocess.Popen([sys.executable, "-m", "dressi_edge.cli", "run", *map(str, args), "--json-lines"], stdout=subprocess.PIPE,
                            stderr=subprocess.PIPE, text=True, env={**os.environ, "PYTHONPATH": str(ROOT)},
                            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a shell's background has it ignored
                            **more)


def until(process, wanted):
    """The events up to the first one that is wanted."""
    seen = []
    for line in process.stdout:
        seen.append(json.loads(line))
        if wanted(seen[-1]):
            return seen
    pytest.fail(f"the run ended after {seen[-3:]}: {process.stderr.read()}")


def rest(process):
    """(exit code, the events that were left, stderr)"""
    out, err = process.communicate(timeout=120)
    return process.returncode, [json.loads(line) for line in out.splitlines()], err


def middle(phase, after=50):
    return lambda e: e["event"] == "step" and e["phase"] == phase and after < e["done"] < e["steps"]


@pytest.mark.parametrize("phase", ["shape", "paint"])
def test_a_killed_run_goes_on_in_the_middle_of_a_phase_bit_for_bit(bundle, whole, tmp_path, phase):
    process = started(bundle, "--checkpoint", tmp_path / "c", *OFTEN)
    until(process, middle(phase))
    until(process, lambda e: e["event"] == "wrote" and e["what"] == "checkpoint")
    process.kill()
    process.wait()
    code, events, err = rest(started(bundle, "--checkpoint", tmp_path / "c", "-o", tmp_path / "out.npz", "-o", tmp_path / "out.ply"))
    assert code == 0, err
    resumed = next(e for e in events if e["event"] == "resumed" and e["done"] < e["steps"])
    assert resumed["phase"] == phase and 0 < resumed["done"] < STEPS[phase]
    assert states(tmp_path / "out.npz") == whole[0]
    metrics = json.loads((tmp_path / "out_metrics.json").read_text())
    assert metrics["losses"] == whole[1]["losses"] and metrics["phases"][phase]["resumed_at"] == resumed["done"]
    assert {name: p["steps"] for name, p in metrics["phases"].items()} == STEPS
    assert metrics["phases"]["shape"]["seconds"] > 0


@pytest.mark.parametrize("number, told", [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_an_interrupted_run_writes_what_there_is_with_the_right_counts_and_goes_on(bundle, whole, tmp_path, number, told):
    process = started(bundle, "--checkpoint", tmp_path / "c", "-o", tmp_path / "out.npz", "-o", tmp_path / "out.glb")
    until(process, middle("paint"))
    process.send_signal(number)
    code, events, err = rest(process)
    assert code == told and err == ""
    done = events[-1]["metrics"]["phases"]["paint"]["steps"]
    assert events[-1]["event"] == "done" and 50 < done < STEPS["paint"] and events[-1]["metrics"]["phases"]["paint"]["interrupted"]
    assert [e["done"] for e in events if e["event"] == "stopped"] == [done]
    with np.load(tmp_path / "out.npz") as found:
        assert found["paint.step"] == done and found["shape.step"] == STEPS["shape"]
    metrics = json.loads((tmp_path / "out_metrics.json").read_text())
    assert metrics["phases"]["paint"]["steps"] == done == metrics["losses"]["paint"][-1][0]
    assert len(load_mesh(tmp_path / "out.glb").faces) == 80
    again = command("run", bundle, "--checkpoint", tmp_path / "c", "-o", tmp_path / "out.npz")
    assert again.returncode == 0 and f"going on with paint after {done} of {STEPS['paint']} steps" in again.stderr
    assert states(tmp_path / "out.npz") == whole[0]
    over = command("run", bundle, "--checkpoint", tmp_path / "c", "-o", tmp_path / "again.npz")
    assert over.returncode == 0 and states(tmp_path / "again.npz") == whole[0], "there was nothing left to do"


def test_results_and_a_preview_are_there_before_the_end(bundle, tmp_path):
    process = started(bundle, "-o", tmp_path / "out.glb", "--preview", tmp_path / "p.png", "--preview-every", "0.05", *OFTEN)
    wrote = set()
    while wrote < {str(tmp_path / "out.glb"), str(tmp_path / "p.png")}:
        wrote.add(until(process, lambda e: e["event"] == "wrote")[-1]["file"])
    process.kill()
    process.wait()
    assert len(load_mesh(tmp_path / "out.glb").faces) == 80 and (tmp_path / "p.png").read_bytes()[:4] == b"\x89PNG"
    metrics = json.loads((tmp_path / "out_metrics.json").read_text())
    assert 0 < sum(p["steps"] for p in metrics["phases"].values()) < sum(STEPS.values())


def test_programs_read_how_it_goes(bundle):
    process = started(bundle, "--steps", "30")
    code, events, err = rest(process)
    assert code == 0 and err == ""
    assert {e["event"] for e in events} >= {"doing", "phase", "step", "done"}
    assert any("pipelines" in e["what"] and e["total"] > 10 for e in events if e["event"] == "doing")
    steps = [e for e in events if e["event"] == "step" and e["phase"] == "paint"]
    assert steps[-1]["done"] == 30 and steps[-1]["seconds_left"] == 0 and all(e["loss"] > 0 and e["ms_per_step"] > 0 for e in steps)
    assert events[-1]["metrics"]["phases"]["paint"]["steps"] == 30


def test_a_terminal_shows_a_bar_with_the_time_that_is_left(bundle):
    here, there = pty.openpty()
    process = subprocess.Popen([sys.executable, "-m", "dressi_edge.cli", "run", str(bundle)], stderr=there, stdout=subprocess.PIPE,
                               env={**os.environ, "PYTHONPATH": str(ROOT)})
    os.close(there)
    shown = b""
    try:
        while part := os.read(here, 4096):
            shown += part
    except OSError:  # the other end is closed
        pass
    os.close(here)
    assert process.wait(60) == 0
    text = shown.decode()
    assert "loading" in text and " s left" in text and f"[{'#' * 24}] paint 3000/3000 loss" in text
    assert b"shape: 900 steps" in process.stdout.read()


def test_what_takes_long_says_so_again_and_again():
    told = []
    with Events(lambda event, facts: told.append((time.monotonic(), event, dict(facts)))) as events:
        events.doing("thinking")
        time.sleep(2 * SILENCE + 0.5)
    times = [at for at, *_ in told]
    assert max(b - a for a, b in zip(times, times[1:])) < SILENCE + 0.5
    beats = [facts for _, event, facts in told if facts.get("seconds")]
    assert len(beats) >= 2 and all(x["what"] == "thinking" for x in beats) and beats[-1]["seconds"] >= SILENCE


def test_lines_on_no_terminal_come_when_it_was_silent(capsys):
    sink = Terminal()
    sink("doing", {"what": "quick"})
    assert capsys.readouterr().err == ""
    sink.last -= SILENCE
    sink("doing", {"what": "slow", "done": 3, "total": 9, "seconds": 2.0})
    assert capsys.readouterr().err == "slow 3/9, 2 s\n"


def test_nobody_reading_is_no_reason_to_stop(tmp_path):
    class Gone:
        def write(self, text):
            raise BrokenPipeError

    sink = JsonLines(Gone())
    sink("step", {"loss": float("nan")})
    assert sink.stream is None
    sink("step", {})


def test_numbers_that_json_lacks_are_null(capsys):
    JsonLines()("step", {"loss": float("nan"), "more": [1.0, float("inf")]})
    assert json.loads(capsys.readouterr().out) == {"event": "step", "loss": None, "more": [1.0, None]}


@pytest.mark.parametrize("seconds, text", [(0.0, "0 s"), (7.2, "8 s"), (60.0, "1:00"), (3725.0, "1:02:05")])
def test_durations_are_said_as_people_say_them(seconds, text):
    assert duration(seconds) == text


@pytest.mark.parametrize("args, expected", [
    (["--checkpoint", "none/c"], "folder"), (["--preview", "p.jpg"], "a .png is written"),
    (["--checkpoint", "c", "--steps", "10"], "phase shape has run 20 times, and 10 are asked for"),
    (["--checkpoint", "x.dressi"], "not a checkpoint"), (["--checkpoint", "c", "--device", "reference"], "the reference keeps none"),
    (["-o", "render.colour=a.png"], "the bundle has no value 'render.colour'; its outputs are: "),
    (["-o", "vertices=a.png"], "vertices is no picture, but an array of shape (42, 3); write it as .npy"),
    (["-o", "vertices=a.ply"], "extension .ply is unknown for a value")])
def test_what_cannot_be_is_said_before_the_work(bundle, args, expected):
    folder = bundle.parent
    if not (folder / "c").exists():
        assert command("run", bundle, "--steps", "20", "--checkpoint", "c", cwd=folder).returncode == 0
    before = {p: p.read_bytes() for p in folder.iterdir() if p.is_file()}
    done = command("run", "x.dressi", *args, cwd=folder)
    lines = [line for line in done.stderr.splitlines() if line.startswith("dressi-edge: ")]  # a slow machine says, too, what it is at
    assert done.returncode == 3 and len(lines) == 1 and expected in lines[0], done.stderr
    assert {p: p.read_bytes() for p in folder.iterdir() if p.is_file()} == before


def test_curves_of_another_bundle_are_left_alone(bundle, tmp_path):
    """What lies beside a checkpoint is no part of it: lost or strange, the run goes on without the old points."""
    assert command("run", bundle, "--steps", "20", "--phase", "shape", "--checkpoint", tmp_path / "c").returncode == 0
    for text in ('{"bundle": "other", "courses": {}}', "[]", "{"):
        (tmp_path / "c.json").write_text(text)
        done = command("run", bundle, "--steps", "30", "--phase", "shape", "--checkpoint", tmp_path / "c", "--json")
        phase = json.loads(done.stdout)["phases"]["shape"]
        assert done.returncode == 0 and phase["steps"] == 30 and phase["resumed_at"] in (20, 30)
