"""No text that people write is too odd for one line and exit code 3: jobs, views, glTF, profiles. tests/fuzz_text.py looks for more."""

import json
import logging
import os
import warnings

import fuzz_text
import pytest
from jobs import TINY, write_job

from dressi_edge import cli
from dressi_edge.cache.errors import InputError, InputWarning, note
from dressi_edge.compiler.io.text import MAX_DEPTH, bounded, is_file, parse_json, read_bytes, shown


def refused(capsys, *args):
    """The one line of a command that fails with bad input."""
    code, (out, err) = cli.main([str(a) for a in args]), capsys.readouterr()
    assert code == 3 and out == "" and err.startswith("dressi-edge: ") and err.count("\n") == 1 and "defect" not in err, err[:2000]
    assert len(err) <= cli.LONGEST_LINE + 20 and err[:-1].isprintable()
    return err


LONG = "n" * 100_000


@pytest.mark.parametrize("old, new, told", [
    ("[mesh]", LONG + " = 1\n[mesh]", "is an unknown key"), ("[mesh]", "a" + ".a" * 5000 + " = 1\n[mesh]", "deep"),
    ("steps = 3", "steps = " + "9" * 400, "a whole number of"), ("steps = 3", "steps = " + "9" * 5000, "not TOML"),
    ("steps = 3", "steps = " + "[" * 5000, "nested too deeply"),
    ("steps = 3", "steps = " + "[" * 40 + "]" * 40, "nests deeper than 32"),
    ("steps = 3", "steps = 1979-05-27", "phase[0].steps is datetime.date"), ("steps = 3", "steps = -inf", "a whole number"),
    ("weight = 0.05", "weight = 1e400", "phase[0].loss[1]: weight"), ("r = 2.0", "r = 1e400", "render.r is inf"),
    ("r = 2.0", "r = 1e308", "phase[0]"), ("rate = 0.1", "rate = 1e-400\nrate = 1", "not TOML"),
    ("name = \"shape\"", f"name = \"{LONG}\"", "a name of up to 100 letters"),
    ("name = \"shape\"", "name = \"a\\nb\\u0000\"", "phase[0].name is 'a"),
    ("name = \"shape\"", "name = \"render\"", "and not that of the plan"),
    ("name = \"shape\"", "name = \"\"", "phase[0].name is ''"), ("optimize.vertices", f"optimize.{LONG}", "no parameter"),
    ("photos/transforms.json", LONG, "no file can have that name"), ("photos/transforms.json", "a\\u0000b", "no file can have that name"),
    ("photos/transforms.json", "x/" * 4000, "does not exist"), ("photos/transforms.json", "/dev/null", "does not exist"),
    ("sphere = {vertices = 42, radius = 0.5}", f"path = \"{LONG}.obj\"", "no file can have that name"),
    ("sphere = {vertices = 42, radius = 0.5}", "path = \"a\\u0000.obj\"", "no file can have that name"),
    ("radius = 0.5", "radius = 0.5}\ntexture = \"\\uD7FF\"\nx = {", "mesh"), ("\"colors\"", f"\"{LONG}\"", "render.albedo is")])
def test_an_odd_job_is_one_line(tmp_path, capsys, old, new, told):
    assert old in TINY
    path = write_job(tmp_path, TINY.replace(old, new, 1))
    assert told in refused(capsys, "compile", path, "-p", "lavapipe", "-o", tmp_path / "x.dressi")
    assert not (tmp_path / "x.dressi").exists()


@pytest.mark.parametrize("change, told", [
    (lambda t: "[" * 100_000, "nests deeper than 32"), (lambda t: t.replace("0.5", "9" * 5000), "transform_matrix"),
    (lambda t: t.replace('"frames"', '"' + LONG + '": 1, "frames"'), "is an unknown key"),
    (lambda t: t.replace("0.png", LONG), "does not exist"),
    (lambda t: t.replace("0.png", "\\u0000"), "does not exist"), (lambda t: t.replace("0.png", "\\ud800"), "half a surrogate pair"),
    (lambda t: t.replace('"camera_angle_x": ', '"camera_angle_x": NaN, "k1": '), "camera_angle_x is nan"),
    (lambda t: "NaN", "has no frames"),
    (lambda t: t.replace('"camera_angle_x": ', '"camera_angle_x": -Infinity, "near": '), "camera_angle_x is -inf"),
    (lambda t: "\0", "malformed")])
def test_odd_views_are_one_line(tmp_path, capsys, change, told):
    path = write_job(tmp_path)
    file = tmp_path / "photos" / "transforms.json"
    document = json.loads(file.read_text())
    document["frames"][0]["transform_matrix"][0][3] = 0.5
    file.write_text(change(json.dumps(document)))
    assert told in refused(capsys, "compile", path, "-p", "lavapipe", "-o", tmp_path / "x.dressi")


@pytest.mark.parametrize("text, told", [
    ("[" * 100_000, "nested too deeply"), ('{"' + LONG + '": 1}', "unknown key"), ('{"$schema": ' + "9" * 5000 + "}", "not JSON"),
    ('{"$schema": NaN}', "NaN is not a number"), ('{"\\ud800": 1}', "unknown key"), ("\0", "not JSON"),
    ('{"a": 1, "a": 2}', "appears twice")])
def test_odd_profiles_are_one_line(tmp_path, capsys, text, told):
    (tmp_path / "p.json").write_text(text)
    assert told in refused(capsys, "profiles", "show", tmp_path / "p.json")
    assert told in refused(capsys, "compile", write_job(tmp_path), "-p", tmp_path / "p.json", "-o", tmp_path / "x.dressi")


def test_odd_names_on_the_command_line_are_one_line(tmp_path, capsys):
    for name in ("n" * 5000, "a\0b", "\ud800"):
        refused(capsys, "compile", name + ".toml", "-p", "lavapipe", "-o", tmp_path / "x.dressi")
        refused(capsys, "compile", write_job(tmp_path), "-p", "x/" + name + ".json", "-o", tmp_path / "x.dressi")


def test_what_libraries_say_never_reaches_stderr(tmp_path, capsys, monkeypatch):
    """Their warnings and logs; ours are one line each."""
    def noisy(*_):
        warnings.warn("of a library", stacklevel=2)
        for name in ("trimesh", "PIL", "PIL.Image"):
            logging.getLogger(name).error("of a library")
        note("of ours\nin two lines")
        raise InputError("enough")

    write_job(tmp_path)
    monkeypatch.setattr("dressi_edge.compiler.scene.job.load_job", noisy)
    assert cli.main(["compile", str(tmp_path / "job.toml"), "-p", "lavapipe", "-o", str(tmp_path / "x.dressi")]) == 3
    assert capsys.readouterr().err == "dressi-edge: note: of ours in two lines\ndressi-edge: enough\n"
    with pytest.warns(InputWarning, match="for a caller"):
        note("for a caller")


def test_bounds_of_parsed_text():
    deep = [[]]
    for _ in range(MAX_DEPTH - 2):
        deep = [deep]
    bounded({"a": [1, 2.0, None, "\N{GREEK SMALL LETTER ALPHA}"]}, "x"), bounded(deep, "x")
    for value, told in (([[deep]], "nests deeper"), ({"a": 1 << 63}, "64 bits are"), (["\ud800"], "half a surrogate"),
    ({"\udfff": 1}, "half")):
        with pytest.raises(InputError, match=told):
            bounded(value, "x")
    assert parse_json(b'\xef\xbb\xbf{"a": 12345678901234567890}', "x") == {"a": 12345678901234567890.0}
    assert shown("a\nb" + "c" * 500, 10) == "a\N{REPLACEMENT CHARACTER}bccccccc..."


def test_files_that_cannot_be_are_no_files(tmp_path):
    for name in ("a\0b", "n" * 5000, "\ud800", "x/" * 5000):
        assert not is_file(tmp_path / name)
        with pytest.raises(InputError, match="cannot be read"):
            read_bytes(tmp_path / name, "file")
    (tmp_path / "big").write_bytes(b"12345")
    with pytest.raises(InputError, match="larger than the 4 bytes"):
        read_bytes(tmp_path / "big", "file", 4)


def test_pipes_and_devices_are_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "job.toml")
    for path in (tmp_path / "job.toml", "/dev/zero", tmp_path):
        with pytest.raises(InputError, match="file .* cannot be read: .*it is no regular file; check the path"):
            read_bytes(path, "file", 4)


def test_damaged_texts_are_refused_in_one_line():
    done = fuzz_text.run(600, 3)
    assert all(refused > 20 for refused, _ in done.counts.values()) and all(accepted > 3 for _, accepted in done.counts.values())
