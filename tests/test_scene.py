"""Meshes: what is refused and how, what loading keeps, and that the charts of spheres are one-to-one."""

import json
from dataclasses import FrozenInstanceError
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from dressi_edge.cache.errors import InputError, InputWarning
from dressi_edge.compiler.io.charts import COLUMNS, ROWS, SIDES, cube_charts, texel_directions
from dressi_edge.compiler.io.meshes import Mesh, load_mesh, load_texture, normalize
from dressi_edge.compiler.io.shapes import icosphere, pear, sphere
from dressi_edge.compiler.io.writers import save_mesh

SHARED_MESHES = Path(__file__).resolve().parents[2] / "shared" / "meshes"
TRIANGLE = np.eye(3)
FACE = np.array([[0, 1, 2]])
SQUARE_OBJ = """mtllib square.mtl
v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 0
vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1
usemtl paint
f 1/1 2/2 3/3
f 5/2 3/3 4/4
"""


def edges_of(mesh: Mesh) -> np.ndarray:
    """How many faces use each undirected edge."""
    edges = np.sort(np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]]), axis=1)
    return np.unique(edges, axis=0, return_counts=True)[1]


def is_closed(mesh: Mesh) -> bool:
    return bool((edges_of(mesh) == 2).all()) and len(mesh.positions) - len(edges_of(mesh)) + len(mesh.faces) == 2


def four_colours() -> np.ndarray:
    """A 2 x 2 texture: red, green in the top row; blue, white below."""
    return np.array([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [255, 255, 255]]], np.uint8)


def write_square_obj(folder: Path) -> Path:
    (folder / "square.obj").write_text(SQUARE_OBJ)
    (folder / "square.mtl").write_text("newmtl paint\nmap_Kd square.png\n")
    Image.fromarray(four_colours()).save(folder / "square.png")
    return folder / "square.obj"


@pytest.mark.parametrize(("fields", "message"), [
    (dict(positions=TRIANGLE, faces=np.zeros((0, 3), int)), "at least one face"),
    (dict(positions=TRIANGLE, faces=[[0, 1, 2], [0, 1, 3]]), r"faces\[1\] is \[0, 1, 3\], but there are 3 vertices"),
    (dict(positions=TRIANGLE, faces=[[0, -1, 2]]), r"faces\[0\]"),
    (dict(positions=TRIANGLE, faces=FACE.astype(float)), "must be integers"),
    (dict(positions=TRIANGLE[:, :2], faces=FACE), r"positions has shape \(3, 2\)"),
    (dict(positions=TRIANGLE * np.nan, faces=FACE), r"positions\[0\] has the value nan"),
    (dict(positions=TRIANGLE * [[1], [1e39], [1]], faces=FACE), r"positions\[1\] has the value .*e\+39; .* magnitudes up to 3.4e38"),
    (dict(positions=TRIANGLE, faces=FACE, uvs=[[0, 0], [1, -1e300], [0, 1]], uv_faces=FACE), r"uvs\[1\] has the value -1e\+300"),
    (dict(positions=TRIANGLE, faces=FACE, texture=np.full((1, 2, 3), 1e39)), r"texture\[0\] has the value 1e\+39; .*\[0, 1\]"),
    (dict(positions=[["a", "b", "c"]], faces=FACE), "not an array of numbers"),
    (dict(positions=TRIANGLE, faces=FACE, uvs=TRIANGLE[:, :2]), "uvs but no uv_faces"),
    (dict(positions=TRIANGLE, faces=FACE, uvs=TRIANGLE[:, :2], uv_faces=[[0, 1, 9]]), r"uv_faces\[0\].*3 uvs"),
    (dict(positions=TRIANGLE, faces=FACE, uvs=TRIANGLE[:, :2], uv_faces=[[0, 1, 2]] * 2), "2 uv_faces for 1 faces"),
    (dict(positions=TRIANGLE, faces=FACE, colors=TRIANGLE[:2]), "colors has shape"),
    (dict(positions=TRIANGLE, faces=FACE, colors=TRIANGLE * 255), r"colors\[0\] has the value 255.0"),
    (dict(positions=TRIANGLE, faces=FACE, texture=np.zeros((4, 4))), "texture has shape"),
])
def test_a_malformed_mesh_is_refused_in_one_line(fields, message):
    with pytest.raises(InputError, match=message) as caught:
        Mesh(**fields)
    assert "\n" not in str(caught.value)


def test_a_mesh_is_a_frozen_copy():
    positions = TRIANGLE.copy()
    mesh = Mesh(positions, FACE)
    positions[0, 0] = 5.0
    assert mesh.positions[0, 0] == 1.0 and mesh.faces.dtype == np.int32
    with pytest.raises(ValueError, match="read-only"):
        mesh.positions[0, 0] = 2.0
    with pytest.raises(FrozenInstanceError):
        mesh.faces = FACE


@pytest.mark.parametrize(("name", "text", "message"), [
    ("absent.obj", None, "does not exist"),
    ("junk.ply", "hello", "cannot be read"),
    ("mesh.unknown", "hello", "cannot be read"),
    ("empty.obj", "", "no faces"),
    ("points.obj", "v 0 0 0\nv 1 0 0\n", "no faces"),
    ("past.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 1 2 9\n", "past.obj line 5: a face names v 9, but there are 3"),
    ("pastuv.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/2\n", "line 5: a face names vt 2"),
    ("before.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf -1 -2 -4\n", "line 4: a face names v -4"),
    ("zero.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n", "line 4: a face names v 0"),
    ("word.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 x\n", "line 4: face corner 'x'"),
    ("nan.obj", "v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n", r"nan.obj: mesh positions\[2\] has the value nan"),
    ("point.obj", "v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n", "no face has three different corners"),
    ("past.ply", "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
     "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
     "0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n", r"faces\[0\] is \[0, 1, 7\]"),
])
def test_a_file_that_is_no_mesh_is_named(tmp_path, name, text, message):
    if text is not None:
        (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        load_mesh(tmp_path / name)
    assert name in str(caught.value)


def test_obj_merges_vertices_by_position_and_keeps_its_uv_seam(tmp_path):
    mesh = load_mesh(write_square_obj(tmp_path))
    assert mesh.positions.shape == (4, 3) and len(mesh.uvs) == 4
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    # The corner at the origin has v = 0 in the file, counted upwards: the bottom row here.
    assert np.allclose(mesh.uvs[mesh.uv_faces], [[[0, 1], [1, 1], [1, 0]], [[1, 1], [1, 0], [0, 0]]])
    assert np.array_equal(mesh.texture, four_colours() / 255.0)


def test_obj_without_material_has_no_texture_until_one_is_given(tmp_path):
    path = write_square_obj(tmp_path)
    (tmp_path / "square.mtl").unlink()
    with pytest.warns(InputWarning, match="material file square.mtl does not exist"):
        assert load_mesh(path).texture is None
    with pytest.warns(InputWarning):
        assert np.array_equal(load_mesh(path, tmp_path / "square.png").texture, load_texture(tmp_path / "square.png"))
    with pytest.warns(InputWarning), pytest.raises(InputError, match="texture file .*nothing.png does not exist"):
        load_mesh(path, tmp_path / "nothing.png")


def gltf_of(folder: Path, nodes: list[dict], factors: list[float] | None = None) -> Path:
    """A hand-written glTF of one textured triangle, so that nothing here depends on a writer."""
    positions, uvs = TRIANGLE.astype("<f4"), np.array([[0, 0], [1, 0], [0, 0.75]], "<f4")
    (folder / "t.bin").write_bytes(positions.tobytes() + uvs.tobytes())
    Image.fromarray(four_colours()).save(folder / "t.png")
    surface = {"baseColorTexture": {"index": 0}} | ({} if factors is None else {"baseColorFactor": factors})
    (folder / "t.gltf").write_text(json.dumps({
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": nodes,
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": surface}], "textures": [{"source": 0}], "images": [{"uri": "t.png"}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0] * 3, "max": [1] * 3},
                      {"bufferView": 1, "componentType": 5126, "count": 3, "type": "VEC2"}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36, "byteLength": 24}],
        "buffers": [{"uri": "t.bin", "byteLength": 60}]}))
    return folder / "t.gltf"


def test_gltf_is_flattened_with_transforms_and_its_v_is_down_already(tmp_path):
    mesh = load_mesh(gltf_of(tmp_path, [{"children": [1], "translation": [0, 0, 5]}, {"mesh": 0, "scale": [2, 2, 2]}]))
    assert np.allclose(mesh.positions, TRIANGLE * 2.0 + (0, 0, 5))
    assert np.allclose(mesh.uvs[mesh.uv_faces[0]], [[0, 0], [1, 0], [0, 0.75]])
    assert np.array_equal(mesh.texture, four_colours() / 255.0)


def test_gltf_mirrored_by_its_transform_keeps_its_outside(tmp_path):
    a, b, c = (mesh := load_mesh(gltf_of(tmp_path, [{"mesh": 0, "scale": [-1, 1, 1]}]))).positions[mesh.faces[0]]
    assert np.cross(b - a, c - a) @ (-1, 1, 1) > 0.0


def test_gltf_base_colour_factor_is_linear(tmp_path):
    half = load_mesh(gltf_of(tmp_path, [{"mesh": 0}], [0.5, 1.0, 1.0, 1.0])).texture
    assert abs(half[0, 0, 0] - 0.7354) < 2e-3 and np.isclose(half[1, 1, 1], 1.0)


def test_degenerate_faces_are_dropped_and_the_rest_kept(tmp_path):
    (tmp_path / "d.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 0\nf 1 2 3\nf 1 4 2\n")
    assert load_mesh(tmp_path / "d.obj").faces.tolist() == [[0, 1, 2]]


@pytest.mark.parametrize("mesh", [icosphere(0), icosphere(1), icosphere(3), sphere(252), sphere(1000)],
                         ids=lambda m: len(m.positions))
def test_spheres_are_closed_round_and_face_outwards(mesh):
    assert is_closed(mesh)
    assert np.allclose(np.linalg.norm(mesh.positions, axis=1), 1.0)
    a, b, c = (mesh.positions[mesh.faces[:, i]] for i in range(3))
    assert (np.einsum("ij,ij->i", np.cross(b - a, c - a), a + b + c) > 0.0).all()
    edge = np.linalg.norm(b - a, axis=1)
    assert edge.max() / edge.min() < 1.3


def test_sphere_counts():
    assert [len(icosphere(n).positions) for n in range(4)] == [12, 42, 162, 642]
    assert [len(sphere(n).positions) for n in (4, 100, 1000)] == [42, 92, 1002]
    assert np.allclose(np.linalg.norm(icosphere(1, radius=2.5).positions, axis=1), 2.5)
    for bad in (lambda: icosphere(-1), lambda: sphere(2), lambda: icosphere(1, radius=0.0)):
        with pytest.raises(InputError):
            bad()


@pytest.mark.parametrize("mesh", [icosphere(1), sphere(92), icosphere(3), pear(32)], ids=lambda m: len(m.positions))
def test_charts_are_one_to_one_and_stay_in_their_cells(mesh):
    corners = mesh.uvs[mesh.uv_faces]
    assert mesh.uvs.min() > 0.0 and mesh.uvs.max() < 1.0
    cells = np.floor(corners * (COLUMNS, ROWS))
    assert (cells == cells[:, :1]).all(), "no face crosses a cell"
    e1, e2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = e1[:, 0] * e2[:, 1] - e1[:, 1] * e2[:, 0]
    assert (area < 0.0).all(), "with v down, faces that are anticlockwise from outside are clockwise: no chart is mirrored"
    points = np.random.default_rng(1).uniform(size=(2000, 2))
    local = points[:, None] - corners[None, :, 0]
    s = (local[..., 0] * e2[:, 1] - local[..., 1] * e2[:, 0]) / area
    t = (e1[:, 0] * local[..., 1] - e1[:, 1] * local[..., 0]) / area
    hits = ((s > 1e-9) & (t > 1e-9) & (s + t < 1.0 - 1e-9)).sum(axis=1)
    assert hits.max() == 1, "no point of the atlas belongs to two faces"
    assert hits.mean() > 0.1


def test_a_texel_stands_for_the_direction_of_the_surface_there():
    ball = icosphere(4)
    charts = cube_charts(ball.positions, ball.faces)
    assert np.array_equal(charts.uvs, ball.uvs) and charts.uv_faces.max() == len(charts.uvs) - 1
    directions = texel_directions(512, 768, charts.reach, charts.gutter)
    row, column = (charts.uvs[:, 1] * 512).astype(int), (charts.uvs[:, 0] * 768).astype(int)
    found = np.empty_like(charts.uvs[:, :1].repeat(3, axis=1))
    found[charts.uv_faces] = ball.positions[ball.faces]
    assert np.linalg.norm(directions[row, column] - found, axis=1).max() < 0.01
    assert np.allclose(np.cross(SIDES[:, 1], SIDES[:, 2]), -SIDES[:, 0])


def test_faces_larger_than_a_cube_side_have_no_charts():
    with pytest.raises(InputError, match="subdivide"):
        cube_charts(icosphere(0).positions, icosphere(0).faces)


def test_normalize_centres_the_box_and_fills_the_ball():
    box = normalize(Mesh(TRIANGLE * (10, 2, 4) + 7.0, FACE))
    assert np.allclose(box.positions.min(axis=0), -box.positions.max(axis=0))
    assert np.isclose(np.linalg.norm(box.positions, axis=1).max(), 1.0)
    with pytest.raises(InputError, match="in one point"):
        normalize(Mesh(np.ones((3, 3)), FACE))


def test_the_pear_is_a_closed_textured_mesh_in_the_unit_ball():
    mesh = pear()
    assert is_closed(mesh) and 2000 <= len(mesh.faces) <= 5000
    assert np.linalg.norm(mesh.positions, axis=1).max() <= 1.0 + 1e-12
    assert mesh.texture.shape == (256, 384, 3) and mesh.texture.std() > 0.1
    assert np.array_equal(mesh.texture, pear().texture) and not np.array_equal(mesh.texture, pear(seed=8).texture)
    volume = np.linalg.det(mesh.positions[mesh.faces]).sum() / 6.0
    assert 0.5 < volume < 4.0, "faces outwards, so the signed volume is positive"


def test_real_meshes_load_with_their_topology(tmp_path):
    save_mesh(tmp_path / "pear.obj", pear(32))
    twin = load_mesh(tmp_path / "pear.obj")
    assert is_closed(twin) and len(twin.uvs) > len(twin.positions)
    if not SHARED_MESHES.is_dir():
        pytest.skip("shared data not present; the pear was tested in its place")
    spot = load_mesh(SHARED_MESHES / "spot" / "spot.obj", SHARED_MESHES / "spot" / "spot_texture.png")
    assert is_closed(spot) and spot.positions.shape == (2930, 3) and spot.uvs.shape == (3225, 2)
    assert spot.faces.shape == (5856, 3) and spot.texture.shape == (1024, 1024, 3)
    with pytest.warns(InputWarning, match="not used by a single mesh: metallic-roughness maps, normal maps"):
        avocado = load_mesh(SHARED_MESHES / "avocado" / "Avocado.gltf")
    assert avocado.uvs.shape == (406, 2) and avocado.faces.shape == (682, 3) and avocado.texture.shape == (512, 512, 3)
    assert load_mesh(SHARED_MESHES / "bunny.obj").faces.shape == (69451, 3)
