"""Writers: what is written reads back the same, pictures show what they should, and a failed write leaves the old file."""

import json
import os
import resource
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from dressi_edge.cache import bundle
from dressi_edge.cache.errors import InputError
from dressi_edge.commands.files import write_file
from dressi_edge.compiler.io.meshes import Mesh, load_mesh
from dressi_edge.compiler.io.shapes import icosphere, pear
from dressi_edge.compiler.io.writers import contact_sheet, loss_curve, save_json, save_mesh, save_png, to_bytes
from dressi_edge.runtime import checkpoint


def colour_of_corners(mesh: Mesh) -> np.ndarray:
    """The texel under each face corner, (F, 3, 3)."""
    height, width = mesh.texture.shape[:2]
    uv = mesh.uvs[mesh.uv_faces]
    return mesh.texture[(uv[..., 1] * height).astype(int), (uv[..., 0] * width).astype(int)]


@pytest.mark.parametrize("suffix", ["glb", "gltf", "obj", "ply"])
def test_a_textured_mesh_reads_back_the_same(tmp_path, suffix):
    mesh = pear(64)
    save_mesh(tmp_path / f"pear.{suffix}", mesh)
    back = load_mesh(tmp_path / f"pear.{suffix}")
    assert back.positions.shape == mesh.positions.shape and back.uvs.shape == mesh.uvs.shape
    assert np.allclose(back.positions[back.faces], mesh.positions[mesh.faces], atol=1e-6)
    assert np.allclose(back.uvs[back.uv_faces], mesh.uvs[mesh.uv_faces], atol=1e-6)
    assert np.abs(back.texture - mesh.texture).max() <= 0.5 / 255.0 + 1e-9
    assert np.median(np.abs(colour_of_corners(back) - colour_of_corners(mesh))) < 0.01


def test_gltf_holds_v_downwards_and_its_texture_inside(tmp_path):
    save_mesh(tmp_path / "pear.gltf", pear(64))
    document = json.loads((tmp_path / "pear.gltf").read_text())
    assert [file.name for file in tmp_path.iterdir()] == ["pear.gltf"] and len(document["images"]) == 1
    attributes = document["meshes"][0]["primitives"][0]["attributes"]
    assert {"POSITION", "NORMAL", "TEXCOORD_0"} <= set(attributes)


def test_obj_keeps_topology_and_counts_v_upwards(tmp_path):
    uvs = np.array([[0.25, 0.1], [0.5, 0.2], [0.75, 0.3]])
    save_mesh(tmp_path / "t.obj", Mesh(np.eye(3), [[0, 1, 2]], uvs, [[0, 1, 2]]))
    lines = (tmp_path / "t.obj").read_text().splitlines()
    assert "vt 0.25 0.9" in lines and "f 1/1 2/2 3/3" in lines
    assert not (tmp_path / "t.mtl").exists(), "no texture, no material"


@pytest.mark.parametrize("suffix", ["glb", "gltf", "obj", "ply"])
def test_vertex_colours_read_back(tmp_path, suffix):
    ball = icosphere(2)
    mesh = Mesh(ball.positions, ball.faces, colors=(ball.positions + 1.0) / 2.0)
    save_mesh(tmp_path / f"ball.{suffix}", mesh)
    back = load_mesh(tmp_path / f"ball.{suffix}")
    assert back.uvs is None and back.texture is None
    assert np.allclose(back.colors[back.faces], mesh.colors[mesh.faces], atol=1.0 / 255.0)


@pytest.mark.parametrize("suffix", ["glb", "obj", "ply"])
def test_a_bare_mesh_reads_back(tmp_path, suffix):
    ball = icosphere(0)
    save_mesh(tmp_path / f"ball.{suffix}", ball)
    back = load_mesh(tmp_path / f"ball.{suffix}")
    assert np.allclose(back.positions[back.faces], ball.positions[ball.faces], atol=1e-6)


def test_uvs_and_colours_without_texture_survive_glb(tmp_path):
    ball = icosphere(2)
    mesh = Mesh(ball.positions, ball.faces, ball.uvs, ball.uv_faces, colors=(ball.positions + 1.0) / 2.0)
    save_mesh(tmp_path / "ball.glb", mesh)
    back = load_mesh(tmp_path / "ball.glb")
    assert np.allclose(back.uvs[back.uv_faces], mesh.uvs[mesh.uv_faces], atol=1e-6) and back.texture is None
    assert np.allclose(back.colors[back.faces], mesh.colors[mesh.faces], atol=1.0 / 255.0)


def test_wrong_places_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"extension .fbx is unknown; known are .glb, .gltf, .obj, .ply, .usdz"):
        save_mesh(tmp_path / "a.fbx", icosphere(1))
    with pytest.raises(InputError, match="directory .*lost does not exist"):
        save_mesh(tmp_path / "lost" / "a.glb", icosphere(1))
    with pytest.raises(InputError, match="cannot write .*what was there is unchanged"):
        (tmp_path / "folder.json").mkdir()
        save_json(tmp_path / "folder.json", {})


def test_a_full_disk_leaves_the_old_file_and_no_rubbish(tmp_path):
    path = tmp_path / "result.png"
    save_png(path, np.zeros((4, 4)))
    before = path.read_bytes()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    # The kernel now refuses longer files, as a full disk does.
    resource.setrlimit(resource.RLIMIT_FSIZE, (len(before), limits[1]))
    try:
        with pytest.raises(InputError, match="cannot write .*result.png"):
            save_png(path, np.random.default_rng(0).uniform(size=(64, 64, 3)))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert path.read_bytes() == before and [file.name for file in tmp_path.iterdir()] == ["result.png"]


@pytest.mark.parametrize("mask", [0o022, 0o077, 0o002])
def test_every_file_has_the_mode_that_umask_asks_for(tmp_path, mask):
    """A bundle that only its writer can read is of no use to the app that it was made for."""
    old = os.umask(mask)
    try:
        save_json(tmp_path / "a.json", {})
        bundle.write(tmp_path / "a.dressi", {"images": [], "values": []}, [])
        checkpoint.write(tmp_path / "a.checkpoint", [b""])
        write_file(tmp_path / "a.txt", b"")
        for _ in range(2):  # new, and in place of another
            assert {f.name: oct(f.stat().st_mode & 0o777) for f in tmp_path.iterdir()} == dict.fromkeys(
                ("a.json", "a.dressi", "a.checkpoint", "a.txt"), oct(0o666 & ~mask))
            bundle.write(tmp_path / "a.dressi", {"images": [], "values": []}, [])
    finally:
        os.umask(old)


def test_json_is_sorted_and_finite(tmp_path):
    save_json(tmp_path / "a.json", {"b": 1, "a": [0.5]})
    assert list(json.loads((tmp_path / "a.json").read_text())) == ["a", "b"]
    for bad in ({"x": float("nan")}, {"x": object()}):
        with pytest.raises(InputError, match="cannot write"):
            save_json(tmp_path / "a.json", bad)
    assert json.loads((tmp_path / "a.json").read_text()) == {"a": [0.5], "b": 1}


@pytest.mark.parametrize("channels", [0, 1, 3, 4])
def test_png_holds_the_values_as_given(tmp_path, channels):
    image = np.random.default_rng(0).uniform(-0.2, 1.2, size=(5, 7) + ((channels,) if channels else ()))
    save_png(tmp_path / "a.png", image)
    back = np.asarray(Image.open(tmp_path / "a.png")) / 255.0
    assert np.abs(back.reshape(5, 7, -1) - np.clip(image, 0, 1).reshape(5, 7, -1)).max() <= 0.5 / 255.0 + 1e-9
    with pytest.raises(InputError, match=r"shape \(5, 7, 2\)"):
        to_bytes(np.zeros((5, 7, 2)))


def test_contact_sheet_shows_every_image_on_grey(tmp_path):
    red, clear = np.zeros((20, 30, 3)) + (1, 0, 0), np.zeros((20, 30, 4))
    contact_sheet([("target", [red, clear]), ("difference", [np.ones((10, 10, 1))])], tmp_path / "sheet.png")
    pixels = np.asarray(Image.open(tmp_path / "sheet.png")).reshape(-1, 3)
    assert (pixels == (255, 0, 0)).all(axis=1).sum() == 600 and (pixels == 217).all(axis=1).sum() >= 600
    assert (pixels < 100).all(axis=1).any(), "labels are drawn"
    for rows in ([], [("nothing", [])]):
        with pytest.raises(InputError, match="has no image"):
            contact_sheet(rows, tmp_path / "sheet.png")


@pytest.mark.parametrize("losses", [
    [1.0 / (1 + i) for i in range(500)], [0.5 - 1e-4 * i for i in range(50)], [0.25], [1e-9, 1e9],
    [1.0, float("nan"), 0.0, 0.5], [0.3, 0.3],
], ids=["decades", "narrow", "one", "wide", "gaps", "flat"])
def test_loss_curves_are_drawn_for_any_range(tmp_path: Path, losses):
    loss_curve({"loss": list(enumerate(losses)), "other": []}, tmp_path / "curve.png")
    image = np.asarray(Image.open(tmp_path / "curve.png")).astype(int)
    assert image.shape == (420, 720, 3)
    blue = (np.abs(image - (0x1F, 0x77, 0xB4)).sum(axis=-1) < 30)[:, :600]
    assert blue.any(), "the curve, left of the legend"


def test_a_loss_curve_needs_a_positive_loss(tmp_path):
    with pytest.raises(InputError, match="no finite loss above 0"):
        loss_curve({"a": [(0, 0.0)]}, tmp_path / "curve.png")
