"""PLY, STL and OFF in: what their headers declare arrives, in any type and order of bytes."""

import struct
import warnings

import numpy as np
import pytest
from PIL import Image

from dressi_edge.cache.errors import InputError, InputWarning
from dressi_edge.compiler.io.meshes import load_mesh, load_parts

POINTS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
NAMES = {"u1": "uchar", "i2": "short", "u2": "ushort", "i4": "int", "u4": "uint32", "f4": "float", "f8": "double"}


@pytest.fixture(autouse=True)
def notes_are_errors():
    """A note is an error, unless the test expects it."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", InputWarning)
        yield


def ply(path, columns: list[tuple[str, str, np.ndarray]], faces, form: str = "ascii", face_columns=(), index: str = "vertex_indices",
        lengths: str = "u1", head: str = "", newline: bytes = b"\n"):
    """A file of vertex properties (name, type, values), faces of any corners, and properties of faces: lists if they are lists of rows."""
    order = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}[form]
    header = ["ply", f"format {form} 1.0", *head.splitlines(), f"element vertex {len(columns[0][2])}",
              *(f"property {NAMES[kind]} {name}" for name, kind, _ in columns), f"element face {len(faces)}",
              f"property list {NAMES[lengths]} int {index}",
              *(f"property {'list uchar ' * isinstance(values[0], list)}{NAMES[kind]} {name}" for name, kind, values in face_columns),
              "end_header"]
    body = b""

    def put(kind: str, value) -> None:
        nonlocal body
        body += np.array(value, order + kind).tobytes() if order else b"%a " % (float(value) if kind[0] == "f" else int(value))

    for i in range(len(columns[0][2])):
        for _, kind, values in columns:
            put(kind, values[i])
        body += b"" if order else newline
    for i, face in enumerate(faces):
        put(lengths, len(face))
        for corner in face:
            put("i4", corner)
        for _, kind, values in face_columns:
            if isinstance(values[i], list):
                put("u1", len(values[i]))
            for x in values[i] if isinstance(values[i], list) else [values[i]]:
                put(kind, x)
        body += b"" if order else newline
    path.write_bytes(newline.join(line.encode() for line in header) + newline + body)
    return path


def xyz(points=POINTS, kind: str = "f4") -> list:
    return [(axis, kind, points[:, k]) for k, axis in enumerate("xyz")]


FORMS = ["ascii", "binary_little_endian", "binary_big_endian"]


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("kind", ["u1", "u2", "f4", "f8"])
def test_colours_of_every_type_are_fractions_of_their_own(tmp_path, form, kind):
    top = {"u1": 255, "u2": 65535}.get(kind, 1)
    wanted = np.random.default_rng(1).uniform(0.1, 0.9, (4, 3))
    stored = np.rint(wanted * top) if top > 1 else wanted.astype(kind)
    columns = [(name, kind, stored[:, k]) for k, name in enumerate(("red", "green", "blue"))] + [("alpha", kind, stored[:, 0])]
    mesh = load_mesh(ply(tmp_path / "a.ply", xyz(kind="f8") + columns, [[0, 1, 2], [0, 2, 3]], form))
    assert np.array_equal(mesh.positions, POINTS) and np.allclose(mesh.colors, stored / top, atol=1e-7)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("index, lengths", [("vertex_index", "u1"), ("vertex_indices", "i4")])
def test_polygons_of_mixed_sizes(tmp_path, form, index, lengths):
    """Lists of several lengths, the first not the last; a concave one is cut by its ears."""
    points = np.array([(0, 0), (2, 0), (2, 0.6), (0.6, 0.6), (0.6, 2), (0, 2)])
    faces = [[0, 1, 2], [1, 2, 3, 4, 5, 0], [0, 3, 4, 5]]
    mesh = load_mesh(ply(tmp_path / "a.ply", xyz(np.pad(points, ((0, 0), (0, 1)))), faces, form, index=index, lengths=lengths))
    a, b, c = (mesh.positions[mesh.faces[:, k]] for k in range(3))
    areas = np.cross(b - a, c - a)[:, 2] / 2.0
    assert len(mesh.faces) == 1 + 4 + 2 and np.isclose(areas[0], 0.6) and np.isclose(areas[1:5].sum(), 2.04, rtol=1e-6)
    assert (areas > 0).all()


def test_colours_and_uvs_of_faces_belong_to_their_corners(tmp_path):
    faces, skin = [[0, 1, 2], [0, 2, 3]], np.random.default_rng(0).integers(0, 256, (2, 2, 3), np.uint8)
    painted = load_mesh(ply(tmp_path / "a.ply", xyz(), faces, face_columns=[(c, "u1", [255 * (k == 0), 255 * (k == 2)])
                                                                            for k, c in enumerate(("red", "green", "blue"))]))
    assert np.array_equal(painted.colors[painted.color_faces], [[[1, 0, 0]] * 3, [[0, 0, 1]] * 3])
    Image.fromarray(skin).save(tmp_path / "skin.png")
    uvs = [[0, 0, 1, 0, 1, 1], [0.25, 0.25, 0.5, 0.5, 0, 1]]
    mesh = load_mesh(ply(tmp_path / "b.ply", xyz(), faces, "binary_little_endian", [("texcoord", "f4", uvs)],
                         head="comment TextureFile skin.png"))
    up = np.array(uvs).reshape(2, 3, 2)
    assert np.allclose(mesh.uvs[mesh.uv_faces], up * (1, -1) + (0, 1)) and np.array_equal(mesh.texture, skin / 255)


def test_textures_of_faces_by_number(tmp_path):
    skins = [np.full((2, 2, 3), value, np.uint8) for value in (50, 200)]
    for k, skin in enumerate(skins):
        Image.fromarray(skin).save(tmp_path / f"{k}.png")
    uvs = [[0.3, 0.3, 0.7, 0.3, 0.7, 0.7]] * 2
    path = ply(tmp_path / "a.ply", xyz(), [[0, 1, 2], [0, 2, 3]], face_columns=[("texcoord", "f4", uvs), ("texnumber", "i4", [1, 0])],
               head="comment TextureFile 0.png\ncomment TextureFile 1.png")
    assert [part.mesh.texture[0, 0, 0] for part in load_parts(path)] == [200 / 255, 50 / 255]
    mesh = load_mesh(path)
    at = (mesh.uvs[mesh.uv_faces].mean(axis=1) * mesh.texture.shape[1::-1]).astype(int)
    assert np.allclose(mesh.texture[at[:, 1], at[:, 0], 0] * 255, [200, 50]) and mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    (tmp_path / "1.png").unlink()
    with pytest.raises(InputError, match=r"image 1.png \(named in a.ply\) does not exist"):
        load_mesh(path)


def test_uvs_and_normals_of_vertices(tmp_path):
    columns = [(n, "f4", POINTS[:, 0] * 0 + (n == "nz") * 3) for n in ("nx", "ny", "nz")]
    columns += [("s", "f4", POINTS[:, 0]), ("t", "f4", POINTS[:, 1])]
    mesh = load_mesh(ply(tmp_path / "a.ply", xyz() + columns, [[0, 1, 2]]))
    assert np.allclose(mesh.normals[mesh.normal_faces], (0, 0, 1)) and np.allclose(mesh.uvs[mesh.uv_faces[0]], [[0, 1], [1, 1], [1, 0]])


def test_triangle_strips_of_scans(tmp_path):
    text = ("ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nelement tristrips 1\n"
            "property list int int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n1 1 0\n8 0 1 2 3 -1 1 3 2\n")
    (tmp_path / "a.ply").write_text(text)
    mesh = load_mesh(tmp_path / "a.ply")
    a, b, c = (mesh.positions[mesh.faces[:, k]] for k in range(3))
    assert len(mesh.faces) == 3 and (np.cross(b - a, c - a)[:, 2] > 0).all()


def test_order_and_count_are_the_files_and_equal_positions_one_vertex(tmp_path):
    points = np.array([[9, 9, 9], [1, 0, 0], [0, 1, 0], [1, 0, 0], [0, 0, 0]], float)
    mesh = load_mesh(ply(tmp_path / "a.ply", xyz(points), [[4, 3, 2], [1, 2, 4]]))
    assert mesh.positions.tolist() == [[9, 9, 9], [1, 0, 0], [0, 1, 0], [0, 0, 0]]
    assert mesh.vertex_map.tolist() == [0, 1, 2, 1, 3] and mesh.faces.tolist() == [[3, 1, 2], [1, 2, 3]]


def test_headers_as_the_world_writes_them(tmp_path):
    head = "comment made by ümlaut\nobj_info num_cols 5\ncomment end_header is not here"
    for newline in (b"\n", b"\r\n"):
        mesh = load_mesh(ply(tmp_path / "a.ply", xyz(), [[0, 1, 2]], "binary_little_endian", head=head, newline=newline))
        assert np.array_equal(mesh.positions, POINTS)
    data = (tmp_path / "a.ply").read_bytes()
    (tmp_path / "a.ply").write_bytes(data + b"trailing")
    assert np.array_equal(load_mesh(tmp_path / "a.ply").positions, POINTS)
    with pytest.warns(InputWarning, match="vertex confidence are not read"):
        load_mesh(ply(tmp_path / "b.ply", xyz() + [("confidence", "f4", POINTS[:, 0])], [[0, 1, 2]]))


HEAD = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n" \
       "property list uchar int vertex_indices\nend_header\n"


@pytest.mark.parametrize("text, message", [
    ("solid", "has no PLY header"),
    (HEAD.replace("format ascii 1.0\n", ""), "names no format"),
    (HEAD.replace("ascii", "ebcdic"), "line 'format ebcdic 1.0' is malformed"),
    (HEAD.replace("vertex 3", "vertex -3"), "'element vertex -3' is malformed"),
    (HEAD.replace("float x", "quad x"), "'property quad x' is malformed"),
    (HEAD + "0 0 0\n1 0 0\n", "numbers end within the 3 of element vertex"),
    (HEAD + "0 0 0\n1 0 0\n0 one 0\n3 0 1 2\n", "numbers end within the 3 of element vertex"),
    (HEAD + "0 0 0\n1 0 0\n0 1 0\n3 0 1\n", "numbers end within the 1 of element face"),
    (HEAD + "0 0 0\n1 0 0\n0 1 0\n3 0 1 2.5\n", "no whole number"),
    (HEAD + "0 0 0\n1 0 0\n0 1 0\n3 0 1 9\n", r"faces\[0\] is \[0, 1, 9\], but there are 3 vertices"),
    (HEAD.replace("float z", "float w") + "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", "no element vertex with x, y, z"),
    (HEAD.replace("vertex 3", "vertex 999999999999"), "numbers end"),
    (HEAD.replace("element face", f"element edge {10 ** 20}\nelement face") + "0 0 0\n1 0 0\n0 1 0\n3 0 1 9\n", r"faces\[0\] is"),
    (HEAD.replace("ascii", "binary_little_endian").replace("vertex 3", "vertex 999999999999"), "truncated"),
])
def test_mistakes_are_named(tmp_path, text, message):
    (tmp_path / "a.ply").write_text(text)
    with pytest.raises(InputError, match=message) as caught, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        load_mesh(tmp_path / "a.ply")
    assert "a.ply" in str(caught.value) and "\n" not in str(caught.value)


def test_numbers_that_are_none_are_named_and_nothing_else_is_said(tmp_path):
    """A signalling NaN: NumPy would warn of it."""
    path = ply(tmp_path / "a.ply", xyz(), [[0, 1, 2]], "binary_little_endian")
    data = path.read_bytes()
    path.write_bytes(data.replace(struct.pack("<3f", 1, 0, 0), b"\1\0\x80\x7f" + bytes(8)))
    with warnings.catch_warnings(), pytest.raises(InputError, match=r"positions\[1\] has the value nan"):
        warnings.simplefilter("error")
        load_mesh(path)


# ---- STL and OFF


TRIANGLES = POINTS[[[0, 1, 2], [0, 2, 3]]]


def test_stl_as_text_and_binary(tmp_path):
    rows = b"".join(struct.pack("<12fH", 0, 0, 1, *t.reshape(-1), 0) for t in TRIANGLES)
    files = {"binary": b"solid, yet binary".ljust(80) + struct.pack("<I", 2) + rows,
             "longer": b"x" * 80 + struct.pack("<I", 2) + rows + b"more"}
    text = "solid a\n" + "".join("facet normal 0 0 1\nouter loop\n" + "".join("  vertex {} {} {}\n".format(*p) for p in t)
                                 + "endloop\nendfacet\n" for t in TRIANGLES) + "endsolid a\n"
    files |= {"text": text.encode(), "upper": text.upper().replace("\n", "\r\n").encode(), "bom": b"\xef\xbb\xbf" + text.encode()}
    for name, data in files.items():
        (tmp_path / f"{name}.stl").write_bytes(data)
        mesh = load_mesh(tmp_path / f"{name}.stl")
        assert np.array_equal(mesh.positions, POINTS) and mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3]], name
        assert mesh.vertex_map.tolist() == [0, 1, 2, 0, 2, 3]
    (tmp_path / "colour.stl").write_bytes(files["binary"][:-1] + b"\x80")
    with pytest.warns(InputWarning, match="the two bytes after each face"):
        load_mesh(tmp_path / "colour.stl")
    (tmp_path / "short.stl").write_bytes(files["longer"][:-20])
    with pytest.raises(InputError, match="it says 2 faces, which take 184 bytes, and has 168; it is truncated"):
        load_mesh(tmp_path / "short.stl")


@pytest.mark.parametrize("text, colors", [
    ("OFF\n4 2 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2\n3 0 2 3\n", None),
    ("OFF 4 1 0 # said\n\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n", None),
    ("4 1 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n", None),
    ("COFF\n4 1 0\n0 0 0 255 0 0 255\n1 0 0 255 0 0 255\n1 1 0 255 0 0 255\n0 1 0 255 0 0 255\n4 0 1 2 3\n", [[(1, 0, 0)] * 3] * 2),
    ("OFF\n4 2 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2 255 0 0\n3 0 2 3 0 0 255\n", [[(1, 0, 0)] * 3, [(0, 0, 1)] * 3]),
    ("OFF\r\n4 2 0\r\n0 0 0\r\n1 0 0\r\n1 1 0\r\n0 1 0\r\n3 0 1 2 0.5 0 0 1\r\n3 0 2 3 0 0 0.5 1\r\n",
     [[(0.5, 0, 0)] * 3, [(0, 0, 0.5)] * 3]),
])
def test_off_and_its_colours(tmp_path, text, colors):
    (tmp_path / "a.off").write_bytes(text.encode())
    mesh = load_mesh(tmp_path / "a.off")
    assert np.array_equal(mesh.positions, POINTS) and mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    found = None if mesh.colors is None else mesh.colors[mesh.faces if mesh.color_faces is None else mesh.color_faces]
    assert found is None if colors is None else np.allclose(found, colors)


@pytest.mark.parametrize("text, message", [
    ("OFF\n", "no counts"), ("OFF\n3 x 0\n", "'x' is no number"), ("OFF BINARY\n", "not supported"), ("OFF\n3 1 0\n0 0 0\n", "truncated"),
    ("OFF\n3 1 0\n0 0 0\n1 0\n0 1 0\n3 0 1 2\n", "vertex 1 has 2 numbers"),
    ("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 3\n", r"faces\[0\] is \[0, 1, 3\]"),
    ("OFF\n1e300 1e300 0\n", "truncated"), ("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\nnan 0 1 2\n", "no faces"), ("", "no counts"),
])
def test_mistakes_of_off_are_named(tmp_path, text, message):
    (tmp_path / "a.off").write_text(text)
    with pytest.raises(InputError, match=message):
        load_mesh(tmp_path / "a.off")
