"""Ours against what others wrote (benchmarks/peers.py, quick): SciPy and a float64 ray caster always, Embree and Mitsuba where the extra
`peers` is installed, which is not in CI."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))

import peers
import peers_pytorch3d


def run(folder, monkeypatch, parts, installed=()):
    """The rows of a quick run with those peers and no others."""
    monkeypatch.setattr(peers, "INSTALLED", {name: name in installed for name in peers.INSTALLED})
    peers.main(["--quick", "--part", *parts, "--json", str(folder / "out.json")])
    document = json.loads((folder / "out.json").read_text())
    assert {"device", "versions", "results", "peers"} <= document.keys()
    return document["results"]


def check_rays(rows, peer):
    masks = [row for row in rows if row["part"] == "rays" and row["peer"] == peer and "hit" in row]
    assert len(masks) == 2 and all(row["hit"] > 500 and row["differ"] == 0 and row["at_edges"] < 10 for row in masks)
    found = [row for row in rows if row["part"] == "rays" and row["peer"] == peer and "hit" not in row]
    assert len(found) >= 3 and all(row["median"] < 1e-4 and row["worst"] < 1e-3 for row in found)


def test_hits_interpolation_coding_and_gradient_are_those_of_float64(tmp_path, monkeypatch):
    rows = run(tmp_path, monkeypatch, ["rays", "shading", "gradient"])
    assert {row["peer"] for row in rows} == {"float64"}
    check_rays(rows, "float64")
    for row in rows:
        assert row["part"] != "shading" or row["worst"] < 1e-5, row
        assert row["part"] != "gradient" or row["cosine"] > 0.95, row


def test_materials_are_near_the_split_sum_and_lamps_the_closed_form(tmp_path, monkeypatch):
    """Few samples: the split sum's integrals are known to a few percent, lamps need none."""
    rows = run(tmp_path, monkeypatch, ["pbr"])
    assert {row["peer"] for row in rows} == {"split", "own", "lamp, float64"} and len(rows) == 12
    for row in rows:
        limit = {"split": 0.04, "own": 0.3, "lamp, float64": 1e-4}[row["peer"]]
        assert row["median"] < limit, row


def test_sums_samples_and_their_transposes_are_scipys_sparse_matrices(tmp_path, monkeypatch):
    rows = run(tmp_path, monkeypatch, ["algebra"])
    assert len(rows) > 15
    for row in rows:
        assert row["worst"] < 1e-4 and row["median"] < 1e-5, row


def needed(name):
    if not peers.INSTALLED[name]:
        pytest.skip(f"the extra peers is not installed, so {name} was not asked; float64 rays and SciPy were")


def test_pixels_and_attributes_are_those_of_embree(tmp_path, monkeypatch):
    needed("embree")
    rows = run(tmp_path, monkeypatch, ["rays"], ["embree"])
    check_rays(rows, "embree")
    assert next(row for row in rows if "covered area" in row["case"])["worst"] < 1e-3


def test_pixels_shading_and_gradient_are_those_of_mitsuba(tmp_path, monkeypatch):
    needed("mitsuba")
    rows = run(tmp_path, monkeypatch, ["rays", "shading", "gradient"], ["mitsuba"])
    check_rays(rows, "mitsuba")
    for row in rows:
        assert row["part"] != "shading" or row["median"] < 1e-5 and row["worst"] < 1e-3, row
    exact = next(row for row in rows if "Mitsuba's to exact" in row["case"])
    assert exact["cosine"] > 0.995 and abs(exact["slope"] - 1) < 0.05


def test_pictures_are_those_of_pytorch3d_and_where_gradients_differ_its_own_differences_agree_with_ours(tmp_path):
    """In float32; of a few vertices its gradient is not that of its picture, ours is."""
    pytest.importorskip("pytorch3d", reason="PyTorch3D is not installed: its formulas in float64 are in tests/test_binned.py")
    peers_pytorch3d.main(["--quick", "--json", str(tmp_path / "out.json")])
    theirs, device = json.loads((tmp_path / "out.json").read_text())["results"]
    assert theirs["image"] < 1e-5 and theirs["alpha"] < 1e-5 and theirs["typical"] < 1e-4 and theirs["full"] == 0
    assert device["image"] < 1e-5 and device["gradient"] < 1e-5 and device["off"] == 0
    for ours in ("worst_ours", "worst_theirs_differences"):
        np.testing.assert_allclose(theirs[ours], theirs["worst_exact"], rtol=0.02)


def test_a_peer_that_is_missing_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "pytorch3d", None)
    with pytest.raises(SystemExit, match="pytorch3d is not installed; how to get torch and PyTorch3D: benchmarks/peers_py"):
        peers_pytorch3d.main(["--quick"])
