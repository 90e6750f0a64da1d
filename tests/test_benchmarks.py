"""The benchmarks run, and what they measure with is right: small procedural targets always, photographs where they are."""

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from conftest import SHARED

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))

import anisotropy
import asset_normals
import binned
import binned_fits
import error_vs_time
import geometry
import gloss
import gloss_ways
import inverse
import light_and_roughness
import metrics
import mips
import reconstruct
import sphere_to_spot
import storage
import svg

from dressi_edge.compiler.graph.functions import constant
from dressi_edge.compiler.graph.reference import evaluate
from dressi_edge.compiler.io.shapes import icosphere


def test_distances_of_concentric_spheres_are_the_difference_of_their_radii():
    big, small = icosphere(4, 1.0), icosphere(4, 0.9)
    d = metrics.Surface(big.positions, big.faces).measure(small.positions, small.faces)
    assert d.vertex == pytest.approx(0.1, abs=0.002)
    assert d.chamfer == pytest.approx(0.1, abs=0.002)
    assert d.normal < 3.0
    turned = metrics.Surface(big.positions, big.faces[:, ::-1]).measure(small.positions, small.faces)
    assert turned.normal > 177.0


def test_a_mesh_is_near_itself_but_for_the_gaps_between_samples():
    ball = icosphere(3, 1.0)
    d = metrics.Surface(ball.positions, ball.faces).measure(ball.positions, ball.faces)
    assert max(d.vertex, d.chamfer) < 0.005


def test_samples_spread_over_the_area():
    corners = np.array([[0.0, 0, 0], [3, 0, 0], [0, 3, 0], [0, 0, 5], [1, 0, 5], [0, 1, 5]])
    points, normals = metrics.sample_surface(corners, np.array([[0, 1, 2], [3, 4, 5]]), 20000)
    large = points[:, 2] == 0.0
    assert large.mean() == pytest.approx(0.9, abs=0.01)
    np.testing.assert_allclose(points[large].mean(axis=0), [1, 1, 0], atol=0.05)
    np.testing.assert_allclose(normals, [[0, 0, 1]] * len(points), atol=1e-12)


def test_iou_counts_masks_at_half_coverage():
    a, b = np.zeros((2, 4, 4)), np.zeros((2, 4, 4))
    a[0, :2], b[0, 1:3] = 0.6, 0.9
    b[0, 3] = 0.5  # not over a half
    np.testing.assert_allclose(metrics.silhouette_iou(a, b), [1 / 3, 1.0])


def test_psnr_looks_inside_the_mask_only():
    target, ours = np.zeros((1, 4, 4, 4)), np.ones((1, 4, 4, 4))
    target[0, :2] = [0.5, 0.5, 0.5, 1.0]
    ours[0, :2, :, :3] = 0.6
    both, strict = metrics.psnr_in_mask(ours, target)
    assert both == pytest.approx(20.0) and strict == pytest.approx(20.0)
    ours[0, 0, :, 3] = 0.0  # half of it is not seen, so it is black there
    both, strict = metrics.psnr_in_mask(ours, target)
    assert both == pytest.approx(20.0)
    assert strict == pytest.approx(-10 * np.log10((0.01 + 0.25) / 2))


def test_a_texture_grows_without_moving_and_its_unseen_texels_take_their_neighbours_colour():
    ramp = np.repeat(np.arange(8.0)[:, None, None], 4, 1).repeat(3, 2)
    fine = reconstruct.finer(ramp, 2)
    assert fine.shape == (16, 8, 3)
    np.testing.assert_allclose(fine[2:14, 3, 1], (np.arange(2, 14) + 0.5) / 2 - 0.5)
    image, known = np.zeros((5, 5, 3)), np.zeros((5, 5), bool)
    image[2, 2], known[2, 2] = 0.7, True
    np.testing.assert_allclose(reconstruct.filled(image, known), 0.7)


def run(module, folder, *arguments) -> dict:
    """The JSON that a benchmark writes; its pictures are there."""
    module.main(["--quick", "--out", str(folder), "--json", str(folder / "out.json"), *map(str, arguments)])
    assert (folder / "contact.png").stat().st_size > 1000
    assert (folder / "loss.png").stat().st_size > 1000
    document = json.loads((folder / "out.json").read_text())
    assert {"device", "versions", "results"} <= document.keys()
    assert all({"case", "ms"} <= row.keys() for row in document["results"])
    return document


@pytest.mark.full
def test_real_photographs_quick(tmp_path):
    """On a painted ring: from its hull, it has its hole from the start, and colours and gains are fitted together."""
    import real
    real.main(["oxford", "--quick", "--out", str(tmp_path), "--json", str(tmp_path / "out.json")])
    report = json.loads((tmp_path / "out.json").read_text())
    cases = {row["case"]: row for row in report["results"]}
    assert set(cases) == {f"oxford {k}" for k in ("hull", "hull: shape", "hull: texture", "joint", "sphere: shape", "sphere: texture")}
    assert cases["oxford joint"]["genus"] == 1 and cases["oxford sphere: shape"]["genus"] == 0
    assert cases["oxford joint"]["iou"] > cases["oxford sphere: shape"]["iou"] and len(cases["oxford joint"]["gains"]) == 3
    assert (tmp_path / "contact.png").stat().st_size > 1000 and (tmp_path / "mesh.glb").exists()


@pytest.mark.full
def test_refined_poses_quick(tmp_path):
    """Of a painted ring seen by cameras that are wrong: refined, they see its surface nearer to where the true ones do."""
    import poses
    poses.main(["oxford", "--quick", "--trials", "2", "--json", str(tmp_path / "out.json")])
    held, refined = json.loads((tmp_path / "out.json").read_text())["results"]
    assert held["trials"] == refined["trials"] == 2 and held["pixels"] > 1.0
    assert refined["pixels"] < 0.8 * held["pixels"] and refined["iou"] > held["iou"]


def test_sphere_to_spot_quick(tmp_path):
    document = run(sphere_to_spot, tmp_path)
    assert [row["case"] for row in document["results"]] == ["same", "hard"]
    for row in document["results"]:
        assert row["distance_40"] < 0.7 * document["start_distance"]
        assert row["iou"] > 0.9


@pytest.mark.parametrize("parts, panels", [
    (("gradient", "layers"), 5), pytest.param(error_vs_time.PARTS, 7, marks=pytest.mark.full)], ids=["cheap", "all"])
def test_error_vs_time_quick(tmp_path, parts, panels):
    error_vs_time.main(["--quick", "--part", *parts, "--json", str(tmp_path / "out.json"), "--plot", str(tmp_path / "out.svg")])
    document = json.loads((tmp_path / "out.json").read_text())
    assert {"device", "versions", "results"} <= document.keys()
    rows = {part: [row for row in document["results"] if row["part"] == part] for part in error_vs_time.PARTS}
    assert all(rows[part] for part in parts) and all(row["ms"] > 0 and row["cpu_ms"] >= 0 for row in document["results"])
    by = {(row["distance"], row["K"], row["profile"]): row["error"] for row in rows["gradient"] if row["swept"] == "r"}
    assert by["outline", 1, "lavapipe"] < 0.1 < by["face", 1, "lavapipe"]
    assert by["outline", 1, "lavapipe"] == by["outline", 1, "limit4"], "packing changes no gradient"
    for row in rows["texture"]:
        assert row["cosine"] > 0.2 and (row["error"] < 1e-3) == (row["gradient"] == "exact")
    for row in rows["fit"] + rows["layers"]:
        assert row["distance"][-1] < row["distance"][0], row["case"]
    assert len(ElementTree.parse(tmp_path / "out.svg").getroot()) == 1 + panels


def test_labels_of_a_chart_lie_beside_each_other_and_within_its_axes():
    points = [(100.0 + 2 * k, 100.0, f"r{k}", "#000") for k in range(4)] + [(svg.WIDTH - svg.RIGHT - 1.0, svg.TOP + 1.0, "corner", "#000")]
    found = [ElementTree.fromstring(line) for line in svg.beside(points, [])]
    boxes = [(float(t.get("x")), float(t.get("y")), 5.4 * len(t.text)) for t in found]
    assert [t.text for t in found] == ["r0", "r1", "r2", "r3", "corner"]
    for k, (x, y, wide) in enumerate(boxes):
        assert svg.LEFT <= x and x + wide <= svg.WIDTH - svg.RIGHT and svg.TOP <= y - 7
        assert all(abs(y - other[1]) >= 7 or x + wide <= other[0] or other[0] + other[2] <= x for other in boxes[:k])


def test_the_front_is_what_nothing_beats_in_both():
    assert error_vs_time.front([(3, 1), (1, 5), (2, 5), (2, 2), (4, 1.5)]) == [(1, 5), (2, 2), (3, 1)]


def test_rows_of_a_part_that_is_not_run_stay(tmp_path):
    kept = {"part": "layers", "case": "old", "mesh": "pear", "distance_by": "face", "K": 1, "r": 1.0, "ms": 1.0, "cpu_ms": 1.0,
            "steps": [1, 2], "seconds": [1, 2], "cpu_seconds": [1, 2], "distance": [0.2, 0.1]}
    document = {"device": "d", "versions": {"driver": "v"}, "results": [kept]}
    (tmp_path / "out.json").write_text(json.dumps(document))
    error_vs_time.main(["--part", "--json", str(tmp_path / "out.json"), "--plot", str(tmp_path / "out.svg")])
    assert json.loads((tmp_path / "out.json").read_text()) == document


def check(document, cases):
    assert [row["case"] for row in document["results"]] == cases
    assert document["recipe"]["layers"] == 1
    for row in document["results"]:
        assert all(np.isfinite(x) for x in row.values() if not isinstance(x, str))
        assert 0.3 < row.get("iou", 1.0) <= 1.0


SPOT = ["spot silhouettes", "spot texture", "spot shape by colour", "spot texture again"]
BUNNY = ["bunny true mesh", "bunny silhouettes", "bunny more silhouettes", "bunny shading"]


@pytest.mark.full
@pytest.mark.parametrize("name, cases", [("spot", SPOT), ("bunny", BUNNY)])
def test_reconstruction_quick(tmp_path, name, cases):
    check(run(reconstruct, tmp_path, name), cases)
    assert (tmp_path / "mesh.glb").stat().st_size > 1000
    assert (tmp_path / "shape.png").stat().st_size > 1000


@pytest.mark.full
@pytest.mark.parametrize("name, cases", [("spot", SPOT), ("bunny", BUNNY)])
def test_reconstruction_of_photographs_quick(tmp_path, shared_dir, name, cases):
    check(run(reconstruct, tmp_path, name, "--data", shared_dir), cases)


@pytest.mark.full
def test_mips_quick(tmp_path):
    """Less than half the error, and all ways of stepping."""
    mips.main(["--quick", "--json", str(tmp_path / "out.json"), "--data", str(tmp_path)])
    rows = {row["case"]: row for row in json.loads((tmp_path / "out.json").read_text())["results"]}
    assert rows["plane"]["ratio"] > 2 and rows["ball"]["ratio"] > 1.5
    assert {"texture 64, bilinear", "texture 64, dense", "texture 64, mips"} <= rows.keys()


@pytest.mark.full
def test_gloss_quick(tmp_path):
    """More of a change shows more, and metal shows more than roughness of the rest."""
    gloss.main(["--quick", "--json", str(tmp_path / "out.json"), "--data", str(tmp_path)])
    rows = {row["case"]: row for row in json.loads((tmp_path / "out.json").read_text())["results"]}
    assert rows["roughness +0.3"]["rest"] > rows["roughness +0.15"]["rest"] > 0
    assert rows["metal 0.2"]["metal"] > rows["metal 0.43"]["metal"] > rows["metal 0.2"]["rest"]


@pytest.mark.full
def test_gloss_ways_quick(tmp_path):
    """All kinds of light, each term, and the shape read back from its file; a light that is known is right."""
    ways = ["the light is known", "light first, maps guided", "light as logarithms", "light grey", "colours compared as log(1 + c)",
            "light first, at 0.1, white fades"]
    common = ["--quick", "--data", str(tmp_path), "--shape", str(tmp_path / "x.npz"), "--json", str(tmp_path / "out.json"), "--ways"]
    gloss_ways.main([*common, *ways])
    rows = {row["way"]: row for row in json.loads((tmp_path / "out.json").read_text())["results"]}
    assert list(rows) == ways and all(0 < row["roughness"] < 0.5 and 0 < row["metal"] < 1 for row in rows.values())
    assert rows["the light is known"]["light"] > 60 > max(row["light"] for name, row in rows.items() if name != "the light is known")
    gloss_ways.main([*common, "light grey"])
    (row,) = json.loads((tmp_path / "out.json").read_text())["results"]
    assert {k: v for k, v in row.items() if k != "seconds"} == {k: v for k, v in rows["light grey"].items() if k != "seconds"}


def test_texels_alike_are_those_of_equal_colour():
    """Halved twice to the size of the maps; a border between two colours is seen by the texels before it."""
    picture = np.zeros((8, 8, 3))
    picture[:, 4:] = 0.5
    found = evaluate([inverse.alike(constant(picture), 4, 10.0)], {})[0].reshape(4, 4)
    np.testing.assert_allclose(found[:, [0, 2, 3]], 1.0)
    np.testing.assert_allclose(found[:, 1], np.exp(-10.0 * 0.75))


@pytest.mark.full
def test_light_and_roughness_quick(tmp_path):
    """A torus of metal: roughness comes nearer from 0.5, and what a surface sees of the light is nearer than the light itself."""
    out = tmp_path / "out.json"
    light_and_roughness.main(["--quick", "--json", str(out), "--picture", str(tmp_path / "out.png"), "--data", str(tmp_path)])
    (row,) = json.loads(out.read_text())["results"]
    assert row["mesh"] == "torus" and abs(row["found"] - row["truth"]) < 0.15
    assert row["picture_psnr"] > 25 and row["lobe_psnr"] > row["environment_psnr"] > 15 and 0.9 < row["visible"] <= 1.0


def test_texels_that_mirror_is_those_of_the_directions():
    """Straight up is in the middle of the square, straight down at its corners."""
    up = light_and_roughness.mirrored_by(np.array([[0.01, 1.0, 0.01]]), 8)
    assert up.sum() == 1 and up[4, 4]
    assert light_and_roughness.mirrored_by(np.array([[-0.01, -1.0, -0.01], [1.0, 0.01, 0.01]]), 8).sum() == 2


@pytest.mark.full
def test_anisotropy_quick(tmp_path):
    """Four probes have less than 0.6 of the error of one, and every way has its price."""
    anisotropy.main(["--quick", "--json", str(tmp_path / "out.json"), "--data", str(tmp_path)])
    rows = {row["case"]: row for row in json.loads((tmp_path / "out.json").read_text())["results"]}
    assert rows["plane"]["4 probes"] < 0.6 * rows["plane"]["mips"] and rows["ball"]["4 probes"] < 0.6 * rows["ball"]["mips"]
    assert all(rows[way]["step"] > 0 for way in anisotropy.WAYS)


@pytest.mark.full
def test_asset_normals_of_a_file_that_is_made(tmp_path):
    asset_normals.main(["--quick", "--json", str(tmp_path / "out.json"), "--data", str(tmp_path)])
    row, = json.loads((tmp_path / "out.json").read_text())["results"]
    assert row["case"].startswith("pear, 2 views") and row["psnr_after"] > row["psnr_before"]


def test_asset_normals_quick(tmp_path, shared_dir):
    asset_normals.main(["--quick", "--json", str(tmp_path / "out.json"), "--data", str(shared_dir)])
    row, = json.loads((tmp_path / "out.json").read_text())["results"]
    assert row["psnr_after"] > row["psnr_before"]


def test_missing_data_is_one_line(tmp_path):
    for module, arguments in ((reconstruct, ["spot"]), (sphere_to_spot, [])):
        with pytest.raises(SystemExit, match="does not exist: give the folder"):
            module.main([*arguments, "--data", str(tmp_path), "--out", str(tmp_path)])


@pytest.mark.skipif(not (SHARED / "protocol").is_dir(), reason="no shared/protocol beside the checkout")
def test_distances_are_those_of_the_protocol(monkeypatch):
    monkeypatch.syspath_prepend(str(SHARED / "protocol"))
    monkeypatch.delitem(sys.modules, "metrics")
    import metrics as protocol
    rng = np.random.default_rng(5)
    truth, ours = icosphere(3, 0.9), icosphere(4, 0.8)
    moved = ours.positions + rng.normal(scale=0.02, size=ours.positions.shape)
    expected = protocol.distances(moved, ours.faces, truth.positions, truth.faces)
    found = reconstruct.metrics.Surface(truth.positions, truth.faces).measure(moved, ours.faces)
    np.testing.assert_allclose(found[:2], expected, rtol=1e-3)


def test_storage_half_moves_less_for_an_error_that_rounding_explains(tmp_path):
    storage.main(["--quick", "--only", "silhouette", "--json", str(tmp_path / "out.json")])
    full, half = json.loads((tmp_path / "out.json").read_text())["results"]
    assert (full["storage"], half["storage"]) == ("float", "half") and full["gradient"] == 0.0
    assert half["MB"] < full["MB"] and half["bytes"] == full["bytes"] - 8.0
    assert 1e-6 < half["gradient"] < 1e-3


def test_the_geometry_benchmark_names_what_it_measures(tmp_path):
    geometry.main(["--quick", "--only", "skin", "--json", str(tmp_path / "out.json")])
    row, = json.loads((tmp_path / "out.json").read_text())["results"]
    assert row["case"] == "skin" and row["vertices"] == 1000 and min(row["ms"], row["compile_s"], row["image_MB"], row["bundle_MB"]) > 0


@pytest.mark.full
def test_what_a_real_gpu_is_measured_with_runs_from_the_folder_alone(tmp_path):
    """Prepared here, run there: by another process that sees nothing of the checkout."""
    program = Path(__file__).resolve().parents[1] / "benchmarks" / "gpu.py"
    folder, out = tmp_path / "carried", tmp_path / "out.json"
    subprocess.run([sys.executable, program, "prepare", folder, "--quick"], check=True, capture_output=True)
    environment = {name: x for name, x in os.environ.items() if name != "PYTHONPATH"} | {"DRESSI_CACHE": str(tmp_path / "cache")}
    done = subprocess.run([sys.executable, folder / "gpu.py", "run", out, "--device", "llvmpipe", "--validation"], cwd=tmp_path,
                          env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    told = json.loads(out.read_text())
    assert told["messages"] == [] == told["left_out"] and "failed" not in told
    assert told["vectors"] and all(r["error"] is None and r["deviation"] <= 1 for r in told["vectors"])
    assert {b["variant"] for b in told["bundles"].values()} == {"navi21", "limit8", "vulkan_min"} and len(told["bundles"]) == 3 + 2 * 3 + 2
    assert all(b["losses"][1] < b["losses"][0] and b["ms"] > 0 for b in told["bundles"].values())
    assert all(max(b["error"].values()) == 0 for b in told["bundles"].values())  # dispatched, too: the same device has the same bits
    shown = subprocess.run([sys.executable, folder / "gpu.py", "tables", out], capture_output=True, text=True, env=environment).stdout
    assert f"Vectors: {len(told['vectors'])} of {len(told['vectors'])} to the bit" in shown and "| texture 64 at 64 |" in shown
    assert told["profile"]["capabilities"]["captured"]


def test_the_lists_that_binned_is_compared_with_hold_every_face_of_a_tile(tmp_path):
    mesh = binned.sphere_of(300)
    ranges, faces = binned.numpy_lists(np.asarray(mesh.positions), mesh.faces, 64, 2.05)
    binned.main(["--quick", "--only", "r=2", "--json", str(tmp_path / "out.json")])
    row = json.loads((tmp_path / "out.json").read_text())["results"][-1]
    assert ranges[-1, 1] == len(faces) == row["pairs"] and row["ratio"] > 0 and row["faces"] == len(mesh.faces)


@pytest.mark.full
def test_binned_fits_quick(tmp_path):
    binned_fits.main(["--quick", "--json", str(tmp_path / "out.json")])
    rows = json.loads((tmp_path / "out.json").read_text())["results"]
    assert [row["case"] for row in rows] == ["outline", "face K=3", "binned"] and all(row["distance_20"] < 0.5 for row in rows)


@pytest.mark.full
def test_inverse_quick(tmp_path):
    """A pear and its own light, photographed by ourselves: unseen pictures come nearer."""
    inverse.main(["--quick", "--data", str(tmp_path), "--json", str(tmp_path / "out.json"), "--picture", str(tmp_path / "out.png")])
    found = json.loads((tmp_path / "out.json").read_text())
    assert found["photographs"] == ("mitsuba" if importlib.util.find_spec("mitsuba") else "ours")
    assert found["psnr"] > found["psnr_start"] + 1 and found["iou"] > 0.9 and found["chamfer_found"] < 0.05
    assert found["ours_of_the_truth"] > 20
