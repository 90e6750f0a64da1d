"""OBJ and MTL in, as exporters write them: what they say arrives, and what is missing is named."""

import warnings
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from dressi_edge.cache.errors import InputError, InputWarning
from dressi_edge.compiler.io.images import srgb_to_linear
from dressi_edge.compiler.io.meshes import load_mesh, load_parts
from dressi_edge.compiler.io.polygons import triangulated

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
FACE = "f 1/1 2/2 3/3 4/4\n"


@pytest.fixture(autouse=True)
def notes_are_errors():
    """A note is an error, unless the test expects it."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", InputWarning)
        yield


def area(mesh) -> float:
    a, b, c = (mesh.positions[mesh.faces[:, k]] for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2.0)


def corner_colors(mesh) -> np.ndarray:
    return mesh.colors[mesh.faces if mesh.color_faces is None else mesh.color_faces]


def write(folder: Path, obj: str, mtl: str | None = None) -> Path:
    (folder / "a.obj").write_text(obj)
    if mtl is not None:
        (folder / "a.mtl").write_text(mtl)
    return folder / "a.obj"


def picture(path: Path) -> np.ndarray:
    path.parent.mkdir(exist_ok=True)
    pixels = np.random.default_rng(len(path.name)).integers(0, 256, (3, 2, 3), np.uint8)
    Image.fromarray(pixels).save(path)
    return pixels / 255.0


# ---- polygons and indices


def test_relative_indices_count_from_where_the_face_stands(tmp_path):
    """c01: each box counts back from itself."""
    triangle = "v {0} 0 0\nv {0} 1 0\nv {0} 0 1\nvt 0.{0} 0\nvt 1 0\nvt 0 1\nf -3/-3 -2/-2 -1/-1\n"
    mesh = load_mesh(write(tmp_path, "".join(triangle.format(k) for k in range(3)) + "f 1/1 -2/-2 9/9\n"))
    assert mesh.faces.tolist() == [[0, 1, 2], [3, 4, 5], [6, 7, 8], [0, 7, 8]]
    assert np.allclose(mesh.uvs[mesh.uv_faces][:, 0, 0], [0.0, 0.1, 0.2, 0.0])


@pytest.mark.parametrize("first", range(6))
@pytest.mark.parametrize("turned", [False, True])
def test_concave_polygons_are_cut_by_their_ears(tmp_path, first, turned):
    """c02: an L in any plane, from any corner, in either sense; its uvs go with the corners."""
    outline = [(0, 0), (2, 0), (2, 0.6), (0.6, 0.6), (0.6, 2), (0, 2)]
    order = [(first + k) % 6 for k in range(6)][::-1 if turned else 1]
    for axes in ((0, 1, 2), (2, 0, 1), (1, 2, 0)):
        points = np.array([(x, y, 5.0) for x, y in outline])[:, axes]
        text = "".join("v {} {} {}\n".format(*p) for p in points) + "".join(f"vt {x} {y}\n" for x, y in outline)
        mesh = load_mesh(write(tmp_path, text + "f " + " ".join(f"{k + 1}/{k + 1}" for k in order) + "\n"))
        assert len(mesh.faces) == 4 and np.isclose(area(mesh), 2 * 0.6 + 1.4 * 0.6)
        uv = mesh.uvs[mesh.uv_faces] * (1, -1) + (0, 1)
        e1, e2 = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
        signed = (e1[:, 0] * e2[:, 1] - e1[:, 1] * e2[:, 0]) / 2.0
        assert np.isclose(abs(signed.sum()), area(mesh)) and len(set(np.sign(signed))) == 1, "none turned over, none outside"


def polygon_area(points: np.ndarray, corners) -> tuple[float, np.ndarray]:
    """The signed area of a polygon in the plane, and those of its triangles."""
    corners = np.asarray(corners)
    places, _ = triangulated(points, np.array([0, len(corners)]), corners)
    p = points[corners][:, :2]
    x, y = p[:, 0], p[:, 1]
    e1, e2 = p[places[:, 1]] - p[places[:, 0]], p[places[:, 2]] - p[places[:, 0]]
    return float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum() / 2.0), (e1[:, 0] * e2[:, 1] - e1[:, 1] * e2[:, 0]) / 2.0


@pytest.mark.parametrize("seed", range(12))
def test_any_simple_polygon_is_covered_once(seed):
    """Star-shaped outlines with random radii, some corners on a line; all triangles turn as the polygon does."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(4, 40))
    angle = np.sort(rng.uniform(0.0, 2.0 * np.pi, n))
    points = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=-1) * rng.uniform(0.2, 1.0, n)[:, None]
    points[1] = (points[0] + points[2]) / 2.0
    if np.diff(angle).max() > 3.0 or angle[-1] - angle[0] < 3.3:
        pytest.skip("not around its centre")
    whole, parts = polygon_area(points, np.arange(n))
    assert len(parts) == n - 2 and np.isclose(np.abs(parts).sum(), abs(whole), rtol=1e-9)


def test_a_spiral_and_a_bridge_to_a_hole_are_covered_once():
    turns = np.linspace(0.5, 6 * np.pi, 80)
    spiral = np.concatenate([np.stack([r * np.cos(turns), r * np.sin(turns)], -1)[::s] for r, s in ((turns, 1), (turns + 1.5, -1))])
    spiral = np.pad(spiral, ((0, 0), (0, 1)))
    whole, parts = polygon_area(spiral, np.arange(len(spiral)))
    assert np.isclose(np.abs(parts).sum(), abs(whole))
    ring = np.array([[0, 0, 0], [4, 0, 0], [4, 4, 0], [0, 4, 0], [1, 1, 0], [1, 3, 0], [3, 3, 0], [3, 1, 0]], float)
    whole, parts = polygon_area(ring, [0, 1, 2, 3, 0, 4, 5, 6, 7, 4])
    assert np.isclose(whole, 12.0) and np.isclose(np.abs(parts).sum(), 12.0)


def test_quads_of_which_one_diagonal_lies_outside_take_the_other():
    dart = np.array([[0, 0, 0], [2, 2, 0], [0, 4, 0], [0.5, 2, 0]], float)
    for first in range(4):
        whole, parts = polygon_area(dart, np.roll(np.arange(4), first))
        assert np.isclose(np.abs(parts).sum(), abs(whole))


def test_faces_keep_their_order_when_polygons_differ(tmp_path):
    text = SQUARE + "v 0 0 1\nv 3 0 0\nv 3 3 0\nv 2 1 0\nf 1 2 3\nf 1 2 3 4\nf 1 2 5\nf 1 6 7 8 4\nf 2 3 5\n"
    faces = load_mesh(write(tmp_path, text)).faces
    assert faces[:4].tolist() == [[0, 1, 2], [0, 1, 2], [0, 2, 3], [0, 1, 4]] and faces[-1].tolist() == [1, 2, 4] and len(faces) == 8


# ---- vertices


def test_vertices_keep_order_and_count_those_that_no_face_uses_too(tmp_path):
    mesh = load_mesh(write(tmp_path, "v 9 9 9\nv 1 0 0\nv 0 1 0\nv 5 5 5\nv 0 0 0\nf 5 2 3\n"))
    assert mesh.positions.tolist() == [[9, 9, 9], [1, 0, 0], [0, 1, 0], [5, 5, 5], [0, 0, 0]]
    assert mesh.faces.tolist() == [[4, 1, 2]] and mesh.vertex_map is None


def test_vertices_at_one_position_move_together_and_keep_their_colours(tmp_path):
    """Split at a seam: one vertex with two colours, and the map says which was which."""
    mesh = load_mesh(write(tmp_path, "v 0 0 0 1 0 0\nv 1 0 0 1 0 0\nv 0 1 0 1 0 0\nv 1 0 0 0 0 1\nv 1 1 0 0 0 1\nv 0 1 0 0 0 1\n"
                                     "f 1 2 3\nf 4 5 6\n"))
    assert mesh.vertex_map.tolist() == [0, 1, 2, 1, 3, 2] and mesh.faces.tolist() == [[0, 1, 2], [1, 3, 2]]
    assert np.array_equal(corner_colors(mesh), [[[1, 0, 0]] * 3, [[0, 0, 1]] * 3])


@pytest.mark.parametrize("row, wanted", [
    ("0.5 0.25 1", (0.5, 0.25, 1.0)), ("128 255 0", (128 / 255, 1.0, 0.0)), ("0.5 0.25 1 1", (0.5, 0.25, 1.0)), ("1", None), ("", None)])
def test_colours_behind_positions(tmp_path, row, wanted):
    mesh = load_mesh(write(tmp_path, "".join(f"v {p} {row}\n" for p in ("0 0 0", "1 0 0", "0 1 0")) + "f 1 2 3\n"))
    assert mesh.colors is None if wanted is None else np.allclose(mesh.colors, wanted)


def test_normals_of_the_file_belong_to_corners(tmp_path):
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvn 0 0 2\nvn 1 0 0\nf 1//1 2//1 3//1\nf 1//2 3//2 4//2\nf 1 4 2\n"
    mesh = load_mesh(write(tmp_path, text))
    assert np.allclose(mesh.normals[mesh.normal_faces], [[[0, 0, 1]] * 3, [[1, 0, 0]] * 3, [[0, 1, 0]] * 3]), "the face's own where none is"


# ---- text as the world writes it


@pytest.mark.parametrize("encode", [
    lambda t: t.encode(), lambda t: b"\xef\xbb\xbf" + t.encode(), lambda t: t.encode("utf-16"), lambda t: t.encode("latin-1"),
    lambda t: t.replace("\n", "\r\n").encode(), lambda t: t.replace("\n", "\r").encode(), lambda t: t.encode() + b"\x1a",
    lambda t: t.encode() + b"\0\0\0", lambda t: t.replace(" 4/4", " \\\n 4/4").encode(), lambda t: t.replace("\n", "  # said\n").encode(),
    lambda t: t.replace(" ", "\t").encode()],
    ids=["utf8", "bom", "utf16", "latin1", "crlf", "cr", "ctrl-z", "zeros", "continued", "comments", "tabs"])
def test_encodings_line_ends_and_what_trails(tmp_path, encode):
    (tmp_path / "a.obj").write_bytes(encode("# ü\no k\xf6rper\n" + SQUARE + FACE))
    mesh = load_mesh(tmp_path / "a.obj")
    assert mesh.positions.shape == (4, 3) and np.isclose(area(mesh), 1.0) and len(mesh.uvs) == 4


def test_what_is_no_face_is_one_note(tmp_path):
    with pytest.warns(InputWarning, match="not read are points, lines, curves$") as noted:
        load_mesh(write(tmp_path, SQUARE + FACE + "p 1\nl 1 2\nl 2 3\ncurv 0 1 1 2\ns off\ng a b\n"))
    assert len(noted) == 1
    with pytest.warns(InputWarning, match="unknown statements are not read: vq"):
        load_mesh(write(tmp_path, SQUARE + FACE + "vq 1\n"))


@pytest.mark.parametrize("text, message", [
    ("v 0 0\nf 1 1 1\n", "line 1: v has 2 numbers; 3 are needed"),
    ("v 0 0 zero\nf 1 1 1\n", "line 1: 'zero' is no number"),
    (SQUARE + "f 1/1/1/1 2 3\n", "line 9: face corner '1/1/1/1'"),
    (SQUARE + "vn 0 0 1\nf 1//1 2//1 3//2\n", r"line 10: a face names vn 2, but there are 1 \(vn 1 to 1\)"),
    (SQUARE + f"f 1 2 {'9' * 30}\n", "line 9: a face names v 999"),
    (SQUARE + f"f 1 2 {'9' * 5000}\n", "line 9: face corner '999"),
    (SQUARE + "f 1 2 -9\n", "line 9: a face names v -9"),
    (SQUARE + "f 1 2\n", "has no faces"),
])
def test_mistakes_are_named_by_their_line(tmp_path, text, message):
    with pytest.raises(InputError, match=message) as caught:
        load_mesh(write(tmp_path, text))
    assert "a.obj" in str(caught.value) and "\n" not in str(caught.value) and len(str(caught.value)) < 400


# ---- materials


def test_colours_of_materials_are_srgb(tmp_path):
    """c07: Kd alone; several; the file's order of faces stays where materials take turns."""
    mtl = "newmtl dark red\nKd 0.8 0.25 0.2\nnewmtl b\nKd 0.2 0.3 0.8\nKs 1 1 1\nNs 10\n"
    mesh = load_mesh(write(tmp_path, "mtllib a.mtl\n" + SQUARE + "v 0 0 1\nusemtl dark red\nf 1 2 3\nusemtl b\nf 1 3 4\nusemtl dark red\n"
                                     "f 1 2 5\n", mtl))
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3], [0, 1, 4]] and mesh.texture is None
    red, blue = [[0.8, 0.25, 0.2]] * 3, [[0.2, 0.3, 0.8]] * 3
    assert np.allclose(corner_colors(mesh), [red, blue, red], atol=1e-9)
    first, second = load_parts(tmp_path / "a.obj")
    assert (first.name, len(first.mesh.faces), len(first.mesh.positions)) == ("dark red", 2, 4) and second.name == "b"
    assert np.allclose(first.material.base_color[:3], srgb_to_linear(np.array([0.8, 0.25, 0.2])))


NAMES = ["skin.png", '"skin.png"', "'skin.png'", "./skin.png", "C:\\scans\\job 7\\skin.png", "/scans/job 7/skin.png", "..\\other\\skin.png",
         "SKIN.PNG", "skin.png -clamp on", "-s 1 1 1 -o 0 0 0 skin.png", "-blendu on -mm 0 1 -bm 1 skin.png", "skin.png  ", "file:///x/skin.png"]


@pytest.mark.parametrize("name", NAMES)
def test_pictures_are_found_however_they_are_named(tmp_path, name):
    """c08."""
    pixels = picture(tmp_path / "skin.png")
    mesh = load_mesh(write(tmp_path, "mtllib a.mtl\nusemtl m\n" + SQUARE + FACE, f"newmtl m\nmap_Kd {name}\n"))
    assert np.array_equal(mesh.texture, pixels) and np.allclose(mesh.uvs[mesh.uv_faces[0]], [[0, 1], [1, 1], [1, 0]])


@pytest.mark.parametrize("file, name", [
    ("tex/skin.png", "tex\\skin.png"), ("my skin 2.png", "my skin 2.png"), ("my skin 2.png", "my%20skin%202.png"), ("-s.png", "./-s.png"),
    ("a#b.png", "a#b.png"), ("100%.png", "100%.png"), ("häut.png", "häut.png"), ("my skin 2.png", "-s 2 2 my skin 2.png")])
def test_pictures_with_odd_names(tmp_path, file, name):
    pixels = picture(tmp_path / file)
    mesh = load_mesh(write(tmp_path, "mtllib a.mtl\nusemtl m\n" + SQUARE + FACE, f"newmtl m\nmap_Kd {name}\n"))
    assert np.array_equal(mesh.texture, pixels)


def test_scale_offset_and_clamp_of_a_map_are_applied(tmp_path):
    picture(tmp_path / "skin.png")
    mtl = "newmtl m\nmap_Kd -s 2 3 -o 0.5 0.25 -clamp on skin.png\n"
    mesh = load_mesh(write(tmp_path, "mtllib a.mtl\nusemtl m\n" + SQUARE + FACE, mtl))
    up = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * (2, 3) + (0.5, 0.25)
    assert np.allclose(mesh.uvs[mesh.uv_faces], (up * (1, -1) + (0, 1))[[[0, 1, 2], [0, 2, 3]]]) and mesh.wrap == "clamp"


def test_what_only_some_faces_have_is_noted_where_it_is_left_out(tmp_path):
    with pytest.warns(InputWarning, match="some faces: no texture coordinates; those of the other parts are left out"):
        assert load_mesh(write(tmp_path, SQUARE + "f 1/1 2/2 3/3\nf 1 3 4\n")).uvs is None
    path = write(tmp_path, "mtllib a.mtl\nusemtl m\n" + SQUARE + FACE, "newmtl m\nKd 1 0 0\nKe 1 1 0\n")
    with pytest.warns(InputWarning, match="not used by a single mesh: emission"):
        assert np.allclose(load_mesh(path).colors, (1, 0, 0))


def test_a_missing_picture_is_an_error_that_names_it_and_a_missing_library_a_note(tmp_path):
    path = write(tmp_path, "mtllib a.mtl\nusemtl m\n" + SQUARE + FACE, "newmtl m\nKd 1 0 0\nmap_Kd skn.png\n")
    with pytest.raises(InputError, match=r"image skn.png \(named in a.mtl\) does not exist"):
        load_mesh(path)
    picture(tmp_path / "given.png")
    assert load_mesh(path, tmp_path / "given.png").texture is not None
    (tmp_path / "a.mtl").unlink()
    with pytest.warns(InputWarning, match="material file a.mtl does not exist"):
        assert load_mesh(path).texture is None
    with pytest.warns(InputWarning, match="material x is in no material file"):
        load_mesh(write(tmp_path, "mtllib a.mtl\nusemtl x\n" + SQUARE + FACE, "newmtl m\n"))


def test_libraries_with_spaces_and_several_of_them(tmp_path):
    (tmp_path / "my lib.mtl").write_text("newmtl m\nKd 1 0 0\n")
    (tmp_path / "b.mtl").write_text("newmtl n\nKd 0 1 0\n")
    text = SQUARE + "usemtl m\nf 1 2 3\nusemtl n\nf 1 3 4\n"
    for libraries in ("mtllib my lib.mtl\nmtllib b.mtl\n", "mtllib my%20lib.mtl\nmtllib ./b.mtl\n"):
        assert np.allclose(corner_colors(load_mesh(write(tmp_path, libraries + text)))[:, 0], [[1, 0, 0], [0, 1, 0]])
    (tmp_path / "c.mtl").write_text("newmtl m\nKd 0 0 1\n")
    assert np.allclose(corner_colors(load_mesh(write(tmp_path, "mtllib c.mtl b.mtl\n" + text)))[:, 0], [[0, 0, 1], [0, 1, 0]])


def test_kd_multiplies_its_map_in_linear_light_and_a_black_one_does_not(tmp_path):
    pixels = picture(tmp_path / "skin.png")
    obj = "mtllib a.mtl\nusemtl m\n" + SQUARE + FACE
    half = load_mesh(write(tmp_path, obj, "newmtl m\nKd 0.5 1 1\nmap_Kd skin.png\n")).texture
    assert np.allclose(srgb_to_linear(half), srgb_to_linear(pixels) * (srgb_to_linear(np.array(0.5)), 1, 1))
    with pytest.warns(InputWarning, match="Kd 0 0 0 and a map_Kd, which would be black"):
        assert np.array_equal(load_mesh(write(tmp_path, obj, "newmtl m\nKd 0 0 0\nmap_Kd skin.png\n")).texture, pixels)


def test_the_rest_of_a_material_arrives_or_is_named(tmp_path):
    picture(tmp_path / "n.png")
    mtl = ("newmtl m\nKd 0.5 0.5 0.5\nKe 1 0 0\nd 0.5\nPr 0.25\nPm 0.75\nnorm n.png\nmap_Ke n.png\nmap_Bump b.png\nmap_Ks s.png\n"
           "newmtl spectrum\nKd spectral a.rfl\n")
    path = write(tmp_path, "mtllib a.mtl\nusemtl m\n" + SQUARE + FACE, mtl)
    with pytest.warns(InputWarning, match="map_Bump, map_Ks, colours as spectral are not read") as noted:
        m = load_parts(path)[0].material
    assert len(noted) == 1
    assert (m.roughness, m.metallic, m.base_color[3], m.alpha_mode, m.emissive) == (0.25, 0.75, 0.5, "BLEND", (1.0, 0.0, 0.0))
    assert list(m.extra_maps) == ["normal", "emissive"]


@pytest.mark.parametrize("mtl, message", [("newmtl m\nKd red\n", "a.mtl line 2: 'red' is no number"),
                                          ("newmtl m\nKd 1 2\n", "a.mtl line 2: '1 2' is no colour"),
                                          ("newmtl m\nKd nan 0 0\n", "is no colour"), ("newmtl m\nd x\n", "'x' is no number")])
def test_mistakes_in_a_library_are_named_by_their_line(tmp_path, mtl, message):
    with pytest.raises(InputError, match=message):
        load_mesh(write(tmp_path, "mtllib a.mtl\nusemtl m\n" + SQUARE + FACE, mtl))
