"""Job files: what they mean, and that each mistake is one line that names its key, before anything is compiled."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from jobs import ROOT, SIZE, TINY, disc, write_job

from dressi_edge.cache.errors import InputError
from dressi_edge.compiler.io.images import srgb_to_linear
from dressi_edge.compiler.io.shapes import icosphere
from dressi_edge.compiler.io.writers import save_mesh, save_png
from dressi_edge.compiler.render.optimizer import Adam, AdamUniform, AdamW, Clipped, Sgd
from dressi_edge.compiler.scene.job import load_job
from dressi_edge.compiler.scene.sections import optimizer_of, softness_of
from dressi_edge.compiler.scene.tables import Table


def replaced(old, new):
    assert old in TINY
    return TINY.replace(old, new)


def message(path):
    with pytest.raises(InputError) as error:
        load_job(path)
    assert "\n" not in str(error.value)
    return str(error.value)


def test_a_job_becomes_a_problem(tmp_path):
    problem = load_job(write_job(tmp_path))
    assert problem.phases == ["shape", "paint"]
    assert len(problem.cameras) == 2 and (problem.width, problem.height) == (SIZE, SIZE)
    plans = {spec.name: spec for spec in problem.program.plans}
    assert (plans["shape"].steps, plans["paint"].steps) == (3, 2)
    assert {"vertices", "vertices.adam_m"} <= set(plans["shape"].updates) and "colors.momentum" in plans["paint"].updates
    assert set(plans) == {"shape", "shape.loss", "shape.terms", "paint", "paint.loss", "render"}
    assert problem.program.values["targets"].initial.shape == (2, SIZE, SIZE, 4)
    assert np.allclose(np.linalg.norm(problem.mesh.positions, axis=1), 0.5)


def test_paths_are_relative_to_the_job(tmp_path, monkeypatch):
    path = write_job(tmp_path)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert load_job(Path("..") / path.name).phases


def test_linear_targets_are_decoded_and_the_albedo_is_known_to_be_linear(tmp_path):
    stored = load_job(write_job(tmp_path)).program
    linear = load_job(write_job(tmp_path, replaced("transforms.json\"", "transforms.json\"\ncolor = \"linear\""))).program
    assert linear.meta["linear_albedo"] and not stored.meta["linear_albedo"]
    a, b = stored.values["targets"].initial, linear.values["targets"].initial
    assert np.array_equal(a[..., 3], b[..., 3]) and np.allclose(b[..., :3], srgb_to_linear(a[..., :3]))


@pytest.mark.parametrize("change, expected", [
    ("", "constant"), ("optimize.vertices", "constant"), ("optimize.colors", "colors"), ("optimize.texture", "texture")])
def test_the_albedo_is_what_a_phase_optimizes(tmp_path, change, expected):
    text = TINY.replace('albedo = "colors"\n', "").split("[[phase]]\nname = \"paint\"")[0]
    if change.startswith("optimize") and "vertices" not in change:
        text = text.replace("optimize.vertices", change).replace('kind = "silhouette"', 'kind = "color"')
    assert load_job(write_job(tmp_path, text)).albedo == expected


def test_r_fraction_counts_the_larger_side_and_a_phase_overrides_render(tmp_path):
    assert softness_of({"r": None, "r_fraction": 0.25}, 24).r == 6.0
    assert softness_of({"edges": "depth"}, 24).distance == "face"
    assert load_job(write_job(tmp_path, replaced("r = 2.0", "r_fraction = 0.1"))).phases
    assert load_job(write_job(tmp_path, replaced("delta = 0.0", "r_fraction = 0.1"))).phases


@pytest.mark.parametrize("given, expected", [
    ({"optimizer": "adam_uniform", "rate": 0.1, "shared": "vector"}, AdamUniform(0.1, shared="vector")),
    ({"optimizer": "adamw", "rate": 0.1, "decay": 0.3, "betas": [0.8, 0.9]}, AdamW(0.1, (0.8, 0.9), decay=0.3)),
    ({"rate": 0.1, "clip_norm": 2, "clip_value": 0.5}, Clipped(Adam(0.1), 0.5, 2)),
    ({"optimizer": "sgd", "rate": 0.1, "clip_value": 0.5}, Clipped(Sgd(0.1), 0.5))])
def test_a_parameters_table_is_its_optimizer(given, expected):
    assert optimizer_of(Table({"colors": given}, "phase[0].optimize", ("colors",), "job.toml"), "colors", 10) == expected


@pytest.mark.parametrize("old, new, expected", [
    ("[mesh]", "[meshes]", "meshes is an unknown key; did you mean mesh?"),
    ("radius = 0.5", "radious = 0.5", "mesh.sphere.radious is an unknown key; did you mean radius?"),
    ("r = 2.0", "sigm = 2.0", "render.sigm is an unknown key; did you mean sigma?"),
    ("r = 2.0", "xyzzy = 2.0", "render.xyzzy is an unknown key; allowed: r r_fraction"),
    ("steps = 3", "step = 3", "phase[0].step is an unknown key; did you mean steps?"),
    ("weight = 0.05", "wieght = 0.05", "phase[0].loss[1].wieght is an unknown key; did you mean weight?"),
    ("end = 0.001", "stop = 0.001", "phase[0].optimize.vertices.rate.stop is an unknown key"),
    ("momentum = 0.5", "momentun = 0.5", "phase[1].optimize.colors.momentun is an unknown key; did you mean momentum?"),
    ("momentum = 0.5", "clip_norm = 0", "phase[1].optimize.colors.clip_norm is 0; a number above 0 is needed"),
    ("momentum = 0.5", "decay = 0.1", "decay is no setting of sgd; allowed: rate momentum nesterov"),
    ("momentum = 0.5", "betas = [0.9, 0.99]", "betas is no setting of sgd; allowed: rate momentum nesterov"),
    ("r = 2.0", "r = -2.0", "render.r is -2.0; a number above 0 is needed"),
    ("r = 2.0", "r = 0", "render.r is 0; a number above 0 is needed"),
    ("r = 2.0", "r = nan", "render.r is nan; a number above 0 is needed"),
    ("r = 2.0", "r = true", "render.r is True; a number above 0 is needed"),
    ("r = 2.0", "r = 2.0\nr_fraction = 0.1", "r (pixels) and r_fraction"),
    ("r = 2.0", "layers = 9", "render.layers is 9; a whole number from 1 to 5 is needed"),
    ("r = 2.0", "renderer = \"bined\"", "render.renderer is 'bined'; did you mean binned?"),
    ("r = 2.0", "renderer = \"binned\"\nlayers = 9", "render.layers is 9; a whole number from 0 to 8 is needed"),
    ("delta = 0.0", "gamma = 0.1", "phase[1]: gamma is given, but the renderer is 'layered'"),
    ("r = 2.0", "renderer = \"binned\"", "phase[1]: delta is given, but the renderer is 'binned'"),
    ("delta = 0.0", "renderer = \"binned\"\ndepth = [3, 1]", "phase[1]: Binned: depth is (3, 1)"),
    ("r = 2.0", "layers = 1.5", "render.layers is 1.5; a whole number from 1 to 5 is needed"),
    ("r = 2.0", "edges = \"depths\"", "render.edges is 'depths'; did you mean depth? allowed: coverage depth all"),
    ("r = 2.0", "distance = \"outline\"\nedges = \"depth\"", "distance outline is for one layer, without delta and edges"),
    ("r = 2.0", "background = [0, 0]", "render.background is [0, 0]; a list of 3 numbers is needed"),
    ("r = 2.0", "background = [0, 0, 2]", "render.background.2 is 2; a number from 0 to 1 is needed"),
    ("r = 2.0", "shading = \"lambertian\"", "render.shading is 'lambertian'; did you mean lambert? allowed: unlit lambert"),
    ("r = 2.0", "shading = \"lambert\"", "shading lambert needs lights"),
    ("r = 2.0", "srgb = 1", "render.srgb is 1; true or false is needed"),
    ("[[phase]]\nname = \"shape\"", "[[light]]\nkind = \"ambient\"\npower = 1\n[[phase]]\nname = \"shape\"",
     "light[0] is given"),
    ("\"colors\"\n", "\"paint\"\n", "render.albedo is 'paint'; allowed: texture colors constant"),
    ("steps = 3", "steps = 0", "phase[0].steps is 0; a whole number from 1 to 1e+08 is needed"),
    ("steps = 3", "", "phase[0].steps is missing"),
    ("name = \"paint\"", "name = \"shape\"", "phase 'shape': a new name without dots"),
    ("optimize.colors", "optimize.colours", "no parameter 'colours'; there are: vertices colors"),
    ("optimize.colors", "optimize.texture", "no parameter 'texture'"),
    ("rate = 0.1", "rate = \"fast\"", "phase[1].optimize.colors: rate is 'fast'; a finite number of fp32 is needed"),
    ("\"sgd\"", "\"lbfgs\"", "phase[1].optimize.colors.optimizer is 'lbfgs'; allowed: adam adamw adam_uniform sgd"),
    ("kind = \"silhouette\"", "kind = \"silhouete\"", "phase[0].loss[0].kind is 'silhouete'; did you mean silhouette?"),
    ("kind = \"laplacian\"", "kind = \"laplacian\"\nnorm = \"l1\"", "norm is no setting of loss laplacian"),
    ("norm = \"l1\"", "norm = \"l3\"", "phase[1].loss[0].norm is 'l3'; did you mean l2? allowed: l1 l2"),
    ("vertices = 42, radius = 0.5", "vertices = 1", "mesh.sphere.vertices is 1; a whole number from 4 to 700000 is needed"),
    ("[mesh]", "[mesh]\npath = \"a.obj\"", "mesh: path, sphere or hull is needed, and one of them alone"),
    ("[views]", "[views]\nsize = [48, 48]", "size 48x48 for images of 24x24"),
    ("[views]", "[views]\norder = \"random\"", "views.order is 'random'; allowed: batch cycle shuffle"),
    ("[views]", "[views]\nnear = 2\nfar = 1", "views.far is 1; a number above near, 2, is needed"),
    ("[views]", "[views]\nimages = \"photos\"", "gltf and images belong together"),
    ("photos/transforms.json", "nowhere", "nowhere does not exist"),
    ("[views]", "[views", "not TOML"),
])
def test_a_mistake_is_one_line_that_names_it(tmp_path, old, new, expected):
    found = message(write_job(tmp_path, replaced(old, new)))
    assert found.startswith(f"{tmp_path}/job.toml: ") and expected in found


@pytest.mark.parametrize("text, expected", [
    ("", "mesh is missing"), ("[mesh]\nsphere = {}\n", "views is missing"), ("mesh = 3", "mesh is 3; a table is needed"),
    ("[mesh]\nsphere = {}\n[views]\ntransforms = \"photos\"\n", "phase is missing; at least one [[phase]] is needed"),
    ("[mesh]\nsphere = {}\n[views]\ntransforms = \"photos\"\n[phase]\n", "phase is {}; tables [[phase]] are needed"),
    (TINY.split("[[phase.loss]]")[0], "phase[0].loss is missing; at least one [[phase.loss]] is needed")])
def test_what_is_missing_is_named(tmp_path, text, expected):
    assert expected in message(write_job(tmp_path, text))


def test_a_file_that_is_no_job_is_named(tmp_path):
    assert "cannot be read" in message(tmp_path / "none.toml")
    (tmp_path / "latin.toml").write_bytes(b"[mesh]\n# \xff\n")
    assert "not UTF-8" in message(tmp_path / "latin.toml")
    (tmp_path / "long.toml").write_bytes(b"#" * (1 << 21))
    assert "larger than the 1048576 bytes" in message(tmp_path / "long.toml")


OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"


@pytest.mark.parametrize("body, expected", [
    (None, "mesh.obj does not exist"), (OBJ, "has no faces"),
    (OBJ.replace("v 1 0", "v nan 0") + "f 1 2 3\n", "has the value nan"),
    (OBJ + "f 1 2 9\n", "a face names v 9, but there are 4"), ("not a mesh", "mesh.obj")])
def test_bad_meshes(tmp_path, body, expected):
    if body is not None:
        (tmp_path / "mesh.obj").write_text(body)
    found = message(write_job(tmp_path, replaced("sphere = {vertices = 42, radius = 0.5}", "path = \"mesh.obj\"")))
    assert "job.toml: mesh: " in found and expected in found


def test_a_mesh_file_is_read_and_normalized(tmp_path):
    save_mesh(tmp_path / "mesh.ply", icosphere(1, 7.0))
    problem = load_job(write_job(tmp_path, replaced("sphere = {vertices = 42, radius = 0.5}",
                                                    "path = \"mesh.ply\"\nnormalize = true")))
    assert len(problem.mesh.positions) == 42 and np.isclose(np.linalg.norm(problem.mesh.positions, axis=1).max(), 1.0)


def test_bad_images(tmp_path):
    path = write_job(tmp_path)
    save_png(tmp_path / "photos" / "1.png", disc(channels=3))
    assert "1.png has no alpha channel" in message(path)
    save_png(tmp_path / "photos" / "1.png", disc(size=30))
    assert load_job(path).views.images.shape == (2, 30, 30, 4)
    (tmp_path / "photos" / "1.png").unlink()
    assert "image file" in message(path) and "1.png does not exist" in message(path)


def test_bad_cameras(tmp_path):
    path = write_job(tmp_path)
    file = tmp_path / "photos" / "transforms.json"
    good = json.loads(file.read_text())
    for change, expected in ((lambda d: d["frames"][1]["transform_matrix"].pop(), "must be (4, 4)"),
                             (lambda d: d.update(w=99), "states 99x24 pixels"),
                             (lambda d: d.update(frames=[]), "has no frames"),
                             (lambda d: d.pop("camera_angle_x"), "neither camera_angle_x nor fl_x")):
        document = json.loads(json.dumps(good))
        change(document)
        file.write_text(json.dumps(document))
        assert expected in message(path)


def test_the_numbers_of_images_and_gltf_cameras_must_agree(tmp_path):
    path = write_job(tmp_path, replaced('transforms = "photos/transforms.json"', 'gltf = "cameras.gltf"\nimages = "photos"'))
    camera = {"type": "perspective", "perspective": {"yfov": 0.8, "znear": 0.1}}
    gltf = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "cameras": [camera],
            "nodes": [{"camera": 0, "translation": [0, 0, 2.5]}]}
    (tmp_path / "cameras.gltf").write_text(json.dumps(gltf))
    assert "2 images, 1 cameras" in message(path)
    (tmp_path / "photos" / "1.png").unlink()
    assert len(load_job(path).cameras) == 1


@pytest.mark.parametrize("path", sorted((ROOT / "docs" / "examples").glob("*.toml")), ids=lambda p: p.stem)
def test_the_examples_lack_nothing_but_their_files(tmp_path, path):
    (tmp_path / "job.toml").write_text(path.read_text())
    assert re.search(r"(photos|object\.glb|cameras\.glb) does not exist", message(tmp_path / "job.toml"))


def test_the_page_names_every_key_and_its_job_is_right(tmp_path):
    page = (ROOT / "docs" / "job.md").read_text()
    folder = ROOT / "dressi_edge" / "compiler" / "scene"
    source = "".join((folder / name).read_text() for name in ("job.py", "job_scene.py", "sections.py"))
    keys = {key for group in re.findall(r"(?:Table|table|tables)\((.*?)\)\)", source, re.S)
            for key in re.findall(r'"([a-z_]+)"', group)}
    assert len(keys) > 25 and [key for key in sorted(keys) if not re.search(rf"\b{key}\b", page)] == []
    job = re.search(r"```toml\n(.*?)```", page, re.S)[1]
    assert load_job(write_job(tmp_path, job)).phases == ["shape"]


def test_the_readme_is_right(tmp_path, monkeypatch):
    text = (ROOT / "README.md").read_text()
    program, job = (re.search(rf"```{kind}\n(.*?)```", text, re.S)[1] for kind in ("python", "toml"))
    assert load_job(write_job(tmp_path, job)).phases == ["shape"] and len(program.splitlines()) <= 15
    monkeypatch.chdir(tmp_path)
    exec(program.replace("500", "2").replace("200", "2").replace("2562", "42"), {})
