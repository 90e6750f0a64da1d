"""Meshes at the border: several materials as one texture, colour spaces, modes of pictures, order of vertices, parts written."""

import json
import struct
import warnings
from dataclasses import replace

import numpy as np
import pytest
from gltf_files import CORNER_UVS, SQUARE, TWO, GltfFile, checker
from PIL import Image

from dressi_edge.cache.errors import InputError, InputWarning
from dressi_edge.commands.run import _save_states
from dressi_edge.compiler.graph.reference_session import ReferenceSession
from dressi_edge.compiler.io.cameras import orbit
from dressi_edge.compiler.io.images import linear_to_srgb, srgb_to_linear
from dressi_edge.compiler.io.materials import Material, Part, TextureMap
from dressi_edge.compiler.io.mesh import Mesh, corner_normals, linear_mesh
from dressi_edge.compiler.io.meshes import load_mesh, load_parts
from dressi_edge.compiler.io.shapes import icosphere
from dressi_edge.compiler.io.textures import Picture, load_texture
from dressi_edge.compiler.io.writers import save_mesh, save_parts
from dressi_edge.compiler.render.light import Light
from dressi_edge.compiler.scene.problem import Problem
from dressi_edge.compiler.scene.results import mesh_of, record


@pytest.fixture(autouse=True)
def notes_are_errors():
    """A note is an error, unless the test expects it."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", InputWarning)
        yield


# ---- several materials in one mesh


def sampled(texture: np.ndarray, uv: np.ndarray, wrap: str) -> np.ndarray:
    """Bilinear samples (n, 3) in float64: texel centres at half, beyond the edge by `wrap`."""
    size = np.array(texture.shape[1::-1])
    x = uv * size - 0.5
    low, part = np.floor(x).astype(int), (x - np.floor(x))[..., None]

    def texel(dx: int, dy: int) -> np.ndarray:
        at = low + (dx, dy)
        at = at % size if wrap == "repeat" else np.clip(at, 0, size - 1) if wrap == "clamp" else \
            np.minimum(at % (2 * size), 2 * size - 1 - at % (2 * size))
        return texture[at[..., 1], at[..., 0]]

    top = texel(0, 0) * (1 - part[:, 0]) + texel(1, 0) * part[:, 0]
    return top * (1 - part[:, 1]) + (texel(0, 1) * (1 - part[:, 0]) + texel(1, 1) * part[:, 0]) * part[:, 1]


def drawn(mesh: Mesh, face: int, weights: np.ndarray) -> np.ndarray:
    """What the mesh's texture shows at points (n, 3) of a face."""
    return sampled(mesh.texture, weights @ mesh.uvs[mesh.uv_faces[face]], mesh.wrap)


WEIGHTS = np.random.default_rng(5).dirichlet((1, 1, 1), 50)
CODES = {"repeat": 10497, "clamp": 33071, "mirror": 33648}


@pytest.mark.parametrize("wrap", CODES)
def test_a_texture_beside_colours_and_another_texture_is_one_that_draws_the_same(tmp_path, wrap):
    """c07, mixed: a picture that repeats, a second one with a factor, a constant colour, colours of vertices."""
    one, two = checker(5, 4, 1), checker(3, 8, 2)
    stretched = CORNER_UVS * (2.5, 1.25) - (0.75, 0.5)
    colors = np.random.default_rng(0).uniform(0.3, 0.6, (4, 3)).astype(np.float32)
    g = GltfFile()
    sampler = g.add("samplers", {"wrapS": CODES[wrap], "wrapT": CODES[wrap]})
    g.square(g.material(texture=g.texture(one, sampler=sampler)), {"TEXCOORD_0": g.accessor(stretched.astype(np.float32))})
    g.square(g.material((0.5, 0.25, 1, 1), g.texture(two)), {"TEXCOORD_0": g.accessor(CORNER_UVS)}, translation=[0, 0, 1])
    g.square(g.material((0.6, 0.05, 0.05, 1)), translation=[0, 0, 2])
    g.square(attributes={"COLOR_0": g.accessor(colors)}, translation=[0, 0, 3])
    mesh = load_mesh(g.save(tmp_path / "a.glb"))
    assert len(mesh.faces) == 8 and mesh.wrap == "clamp"
    for face in (0, 1):
        corners = TWO[face]
        assert np.allclose(drawn(mesh, face, WEIGHTS), sampled(one / 255, WEIGHTS @ stretched[corners], wrap), atol=1e-6)
        tinted = linear_to_srgb(srgb_to_linear(two / 255) * (0.5, 0.25, 1))
        assert np.allclose(drawn(mesh, 2 + face, WEIGHTS), sampled(tinted, WEIGHTS @ CORNER_UVS[corners], "repeat"), atol=1e-9)
        assert np.allclose(drawn(mesh, 4 + face, WEIGHTS), linear_to_srgb(np.array([0.6, 0.05, 0.05])), atol=1e-9)
        assert np.allclose(drawn(mesh, 6 + face, WEIGHTS), WEIGHTS @ linear_to_srgb(colors[corners].astype(float)), atol=1e-6)


@pytest.mark.parametrize("wrap, inside, wanted", [("repeat", False, "repeat"), ("clamp", False, "clamp"), ("mirror", True, "clamp")])
def test_one_texture_for_all_stays_as_it_is(tmp_path, wrap, inside, wanted):
    g, picture = GltfFile(), checker(4, 4)
    texture = g.texture(picture, sampler=g.add("samplers", {"wrapS": CODES[wrap], "wrapT": CODES[wrap]}))
    uvs = CORNER_UVS if inside else CORNER_UVS * 3
    for z, own in ((0, CORNER_UVS * 0.5 + 0.25), (1, uvs)):  # the first comes near no edge
        g.square(g.material(texture=texture), {"TEXCOORD_0": g.accessor(own.astype(np.float32))}, translation=[0, 0, z])
    mesh = load_mesh(g.save(tmp_path / "a.glb"))
    assert np.array_equal(mesh.texture, picture / 255) and mesh.wrap == wanted and np.allclose(mesh.uvs[mesh.uv_faces[2]], uvs[TWO[0]])


def test_an_atlas_that_is_too_large_is_named(tmp_path):
    g = GltfFile()
    g.square(g.material(texture=g.texture(checker(4, 64))), {"TEXCOORD_0": g.accessor(CORNER_UVS * 500)})
    g.square(g.material((1, 0, 0, 1)), translation=[0, 0, 1])
    with pytest.raises(InputError, match="picture of 64x4 texels is repeated over 3[0-9]* of them; at most 16384 are allowed"):
        load_mesh(g.save(tmp_path / "a.glb"))


def test_colours_that_multiply_a_texture_are_noted_unless_they_are_white(tmp_path):
    for value in (1.0, 0.5):
        g = GltfFile()
        attributes = {"TEXCOORD_0": g.accessor(CORNER_UVS), "COLOR_0": g.accessor(np.full((4, 3), value, np.float32))}
        g.square(g.material(texture=g.texture(checker(2, 2))), attributes)
        path = g.save(tmp_path / "a.glb")
        if value == 1.0:
            load_mesh(path)
        else:
            with pytest.warns(InputWarning, match="colours of vertices, which multiply the texture, are left out"):
                load_mesh(path)
            assert np.allclose(load_parts(path)[0].mesh.colors, linear_to_srgb(np.array(0.5)))


def test_an_unknown_extension_is_named_with_those_that_are_known(tmp_path):
    (tmp_path / "a.fbx").write_text("x")
    with pytest.raises(InputError, match="extension .fbx is unknown; readable are .obj .ply .stl .off .glb .gltf; convert it"):
        load_mesh(tmp_path / "a.fbx")


# ---- pictures in the modes that there are


def test_textures_of_every_mode(tmp_path):
    grey = np.array([[0, 100], [200, 255]], np.uint8)
    saved = {
        "L": (Image.fromarray(grey), grey / 255), "1": (Image.fromarray(grey > 127), (grey > 127) * 1.0),
        "LA": (Image.merge("LA", [Image.fromarray(grey)] * 2), grey / 255),
        "P": (Image.fromarray(np.stack([grey, grey, grey], -1)).convert("P", palette=Image.Palette.ADAPTIVE), grey / 255),
        "I;16": (Image.fromarray(grey.astype(np.uint16) * 257), grey / 255),
        "RGBA": (Image.fromarray(np.stack([grey] * 4, -1)), grey / 255)}
    for mode, (image, wanted) in saved.items():
        image.save(tmp_path / "a.png")
        found = load_texture(tmp_path / "a.png")
        assert found.shape == (2, 2, 3) and np.allclose(found, wanted[..., None], atol=1e-9), mode
    Image.fromarray((grey / 255).astype(np.float32)).save(tmp_path / "a.tif")
    assert np.allclose(load_texture(tmp_path / "a.tif"), (grey / 255)[..., None], atol=1e-7)
    Image.fromarray(np.stack([255 - grey, 255 - grey, 255 - grey, grey * 0], -1), "CMYK").save(tmp_path / "b.tif")
    assert np.allclose(load_texture(tmp_path / "b.tif"), (grey / 255)[..., None], atol=2 / 255)


def test_textures_that_say_too_little_or_are_too_large_are_named(tmp_path):
    Image.fromarray(np.array([[0.5, 3.0]], np.float32)).save(tmp_path / "a.tif")
    with pytest.raises(InputError, match=r"texture .*a.tif has values from 0.5 to 3; allowed are 0 to 1"):
        load_texture(tmp_path / "a.tif")
    Image.fromarray(np.array([[5, 70000]], np.int32)).save(tmp_path / "b.tif")
    with pytest.raises(InputError, match="whole numbers of 32 bits"):
        load_texture(tmp_path / "b.tif")
    Image.new("1", (16384, 16384)).save(tmp_path / "c.png")
    with pytest.raises(InputError, match=r"c.png is 16384x16384; at most \d+ pixels are allowed"):
        load_texture(tmp_path / "c.png")


# ---- colours, normals and order, out and in again


def json_of(path) -> dict:
    data = path.read_bytes()
    return json.loads(data[20:20 + struct.unpack("<I", data[12:16])[0]])


def accessor_of(path, attribute: str) -> np.ndarray:
    """An attribute of the first primitive of a .glb, as its numbers are stored."""
    document, data = json_of(path), path.read_bytes()
    start = 28 + struct.unpack("<I", data[12:16])[0]
    a = document["accessors"][document["meshes"][0]["primitives"][0]["attributes"][attribute]]
    kind = {5126: "<f4", 5123: "<u2", 5121: "u1"}[a["componentType"]]
    columns = {"VEC2": 2, "VEC3": 3, "VEC4": 4}[a["type"]]
    offset = start + document["bufferViews"][a["bufferView"]]["byteOffset"]
    return np.frombuffer(data, kind, a["count"] * columns, offset).reshape(-1, columns)


def test_gltf_has_linear_colours_and_a_surface_that_is_no_metal(tmp_path):
    """c04: sRGB 0.5 0.3 0.8 is 0.214 0.073 0.604."""
    mesh = Mesh(SQUARE, TWO.astype(int), colors=np.tile((0.5, 0.3, 0.8), (4, 1)))
    save_mesh(tmp_path / "a.glb", mesh)
    assert np.allclose(accessor_of(tmp_path / "a.glb", "COLOR_0") / 65535, (0.214, 0.073, 0.604, 1.0), atol=5e-4)
    material = json_of(tmp_path / "a.glb")["materials"][0]
    assert material["pbrMetallicRoughness"]["metallicFactor"] == 0.0 and "extensions" not in material
    assert np.allclose(load_mesh(tmp_path / "a.glb").colors, (0.5, 0.3, 0.8), atol=1e-5)
    save_mesh(tmp_path / "b.glb", mesh, unlit=True)
    document = json_of(tmp_path / "b.glb")
    assert document["materials"][0]["extensions"] == {"KHR_materials_unlit": {}} and document["extensionsUsed"] == ["KHR_materials_unlit"]
    for suffix in ("ply", "obj"):
        save_mesh(tmp_path / f"a.{suffix}", mesh)
        assert np.allclose(load_mesh(tmp_path / f"a.{suffix}").colors, (0.5, 0.3, 0.8), atol=0.5 / 255)


def creased() -> Mesh:
    """Three faces at two edges, a vertex that none uses, corners with colours, normals and uvs of their own."""
    positions = np.array([[0, 0, 0], [7, 7, 7], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
    faces = np.array([[4, 0, 2], [0, 3, 2], [0, 4, 3]])
    colors = np.array([(0.2, 0.4, 0.6), (0.8, 0.6, 0.2), (0.4, 0.4, 0.4)])
    flat = Mesh(positions, faces)
    return Mesh(positions, faces, [[0, 0], [1, 0], [0, 1], [1, 1]], [[0, 1, 2], [0, 1, 2], [1, 3, 2]], colors, None,
                [[0] * 3, [1] * 3, [1, 1, 2]], corner_normals(flat, "flat")[:, 0], [[0] * 3, [1] * 3, [2] * 3])


@pytest.mark.parametrize("suffix", ["glb", "gltf", "obj", "ply"])
def test_what_is_written_keeps_order_and_corners(tmp_path, suffix):
    mesh = creased()
    save_mesh(tmp_path / f"a.{suffix}", mesh)
    back = load_mesh(tmp_path / f"a.{suffix}")
    assert np.array_equal(back.positions, mesh.positions) and np.array_equal(back.faces, mesh.faces)
    assert back.vertex_map[:5].tolist() == [0, 1, 2, 3, 4], "those that are split follow after the last"
    assert np.allclose(back.colors[back.color_faces], mesh.colors[mesh.color_faces], atol=0.5 / 255)
    if suffix != "ply":
        assert np.allclose(back.uvs[back.uv_faces], mesh.uvs[mesh.uv_faces])
        assert np.allclose(back.normals[back.normal_faces], mesh.normals[mesh.normal_faces], atol=1e-6)


@pytest.mark.parametrize("suffix", ["glb", "obj", "ply"])
def test_one_vertex_list_goes_in_and_comes_out_the_same(tmp_path, suffix):
    """A9."""
    rng, ball = np.random.default_rng(0), icosphere(1)
    shuffled = rng.permutation(42)
    mesh = Mesh(np.float32(ball.positions[np.argsort(shuffled)]), shuffled[ball.faces][rng.permutation(80)])
    save_mesh(tmp_path / f"a.{suffix}", mesh)
    back = load_mesh(tmp_path / f"a.{suffix}")
    assert back.vertex_map is None and np.array_equal(back.faces, mesh.faces)
    assert np.allclose(back.positions, mesh.positions, rtol=1e-8, atol=1e-9)


def test_parts_go_out_and_come_in_with_their_materials(tmp_path):
    skin, bumps = checker(4, 4, 1) / 255, Image.fromarray(checker(2, 2, 2))
    bumps.save(tmp_path / "bumps.png")
    normal = TextureMap(Picture("bumps", tmp_path / "bumps.png"), 0, ((2.0, 0.0, 0.5), (0.0, 2.0, 0.0)), ("clamp", "mirror"))
    square = Mesh(SQUARE, TWO.astype(int), CORNER_UVS, TWO.astype(int), texture=skin)
    parts = [Part("wall", square, Material("paint", (0.5, 1.0, 1.0, 1.0), None, 0.25, 0.75, normal_texture=normal, normal_scale=0.5,
                                           emissive=(3.0, 0.0, 1.5), double_sided=True, stated=True), {0: (CORNER_UVS, TWO.astype(int))}),
             Part("red", replace(square, positions=SQUARE + (0, 0, 1), texture=None), Material("red", (0.6, 0.05, 0.05, 1.0), stated=True))]
    save_parts(tmp_path / "a.glb", parts)
    wall, red = load_parts(tmp_path / "a.glb")
    assert (wall.name, red.name) == ("wall", "red") and np.allclose(wall.mesh.texture, skin, atol=0.5 / 255)
    m = wall.material
    assert (m.name, m.base_color, m.metallic, m.roughness, m.double_sided) == ("paint", (0.5, 1.0, 1.0, 1.0), 0.25, 0.75, True)
    assert m.emissive == (3.0, 0.0, 1.5) and m.normal_scale == 0.5 and m.normal_texture.wrap == ("clamp", "mirror")
    values, faces = wall.uv_sets[m.normal_texture.uv_set]
    assert np.allclose(m.normal_texture.applied(values)[faces], normal.applied(CORNER_UVS)[TWO]), "its transform is in its coordinates"
    assert np.array_equal(m.normal_texture.picture.texels() * 255, np.asarray(bumps))
    assert red.material.base_color == (0.6, 0.05, 0.05, 1.0) and red.mesh.texture is None
    save_parts(tmp_path / "a.obj", parts)
    wall, red = load_parts(tmp_path / "a.obj")
    assert np.allclose(wall.mesh.texture, skin, atol=0.5 / 255) and np.allclose(red.material.base_color[:3], (0.6, 0.05, 0.05), atol=1e-5)
    save_parts(tmp_path / "a.ply", parts)
    wall, red = load_parts(tmp_path / "a.ply")
    assert np.allclose(wall.mesh.texture, linear_to_srgb(srgb_to_linear(skin) * (0.5, 1, 1)), atol=0.5 / 255)
    assert np.allclose(wall.mesh.uvs[wall.mesh.uv_faces], CORNER_UVS[TWO]) and red.mesh.uvs is None
    assert np.allclose(red.mesh.colors, linear_to_srgb(np.array((0.6, 0.05, 0.05))), atol=0.5 / 255)
    with pytest.raises(InputError, match="there is no part"):
        save_parts(tmp_path / "b.glb", [])


@pytest.mark.parametrize("fields, message", [
    (dict(color_faces=TWO), "color_faces but no colors"), (dict(normals=SQUARE), "normals but no normal_faces"),
    (dict(colors=np.ones((2, 3)), color_faces=TWO), r"color_faces\[0\].*2 colors"),
    (dict(colors=np.ones((4, 3)), color_faces=TWO[:1]), "1 color_faces for 2 faces"),
    (dict(normals=SQUARE + 1, normal_faces=TWO), r"normals\[0\] has length 1.73205; 1 is needed"),
    (dict(wrap="mirror"), "wrap is 'mirror'; allowed: repeat clamp"),
    (dict(vertex_map=[0, 9]), "vertex_map .* vertices 0 to 3"), (dict(vertex_map=[0.5]), "it must be integers"),
])
def test_attributes_of_corners_are_checked(fields, message):
    with pytest.raises(InputError, match=message):
        Mesh(SQUARE, TWO, **fields)
    with pytest.raises(InputError, match="the mesh has none of its own; allowed are smooth and flat"):
        corner_normals(Mesh(SQUARE, TWO), "file")


# ---- what is drawn


VIEW = orbit(1, (20.0,), 3.0, 50.0, (24, 20))


def shown(problem: Problem) -> tuple[np.ndarray, ReferenceSession]:
    problem.render("render")
    problem.program.meta.update(record(problem))
    session = ReferenceSession(problem.program)
    return session.get("render.color")[0], session


def ball() -> Mesh:
    b = icosphere(1)
    lilac = np.array((0.5, 0.3, 0.8))
    return Mesh(b.positions, b.faces, b.uvs, b.uv_faces, texture=np.tile(lilac, (8, 12, 1)), colors=np.tile(lilac, (42, 1)))


@pytest.mark.parametrize("albedo", ["texture", "colors"])
def test_what_nothing_changes_comes_back_the_same_with_srgb(albedo):
    """Decoded where the result is encoded: it was off by 0.29."""
    picture, session = shown(Problem(ball(), VIEW, albedo=albedo, srgb=True))
    assert np.allclose(picture[10, 12], (0.5, 0.3, 0.8, 1.0), atol=1e-5)
    back = mesh_of(session)
    assert np.allclose(back.texture if albedo == "texture" else back.colors, (0.5, 0.3, 0.8), atol=1e-6)
    assert np.allclose(linear_mesh(ball()).colors, srgb_to_linear(np.array((0.5, 0.3, 0.8))))


def test_arrays_have_the_files_order_and_the_map_where_vertices_are_fewer(tmp_path):
    """A9: what `run -o out.npz` writes."""
    (tmp_path / "a.obj").write_text("v 9 9 9\nv 1 0 0\nv 0 1 0\nv 1 0 0\nv 0 0 0\nf 5 4 3\nf 3 2 5\n")
    for text, rows in (("a.obj", [0, 1, 2, 1, 3]), ("b.obj", None)):
        if rows is None:
            (tmp_path / text).write_text((tmp_path / "a.obj").read_text().replace("v 1 0 0\nv 0 0 0", "v 1 0 1\nv 0 0 0"))
        mesh = load_mesh(tmp_path / text)
        _, session = shown(Problem(mesh, VIEW, albedo="colors"))
        _save_states(session, str(tmp_path / "a.npz"))
        with np.load(tmp_path / "a.npz") as arrays:
            assert np.allclose(arrays["vertices"], mesh.positions, atol=1e-6)
            assert arrays["vertex_map"].tolist() == rows if rows else "vertex_map" not in arrays
        assert (mesh_of(session).vertex_map is None) == (rows is None)


def test_colours_of_corners_are_drawn_without_bleeding(tmp_path):
    """Two flat colours that share vertices: no covered pixel has anything between them; and each corner comes back."""
    b = icosphere(1)
    front = b.positions[b.faces].mean(axis=1) @ np.array((0.2, 1.0, 0.3)) > 0.0
    mesh = Mesh(b.positions, b.faces, colors=[(1, 0, 0), (0, 0, 1)], color_faces=np.repeat(np.where(front, 0, 1)[:, None], 3, axis=1))
    picture, session = shown(Problem(mesh, VIEW, albedo="colors"))
    inside = picture[picture[..., 3] > 0.999][:, :3]
    red, blue = (np.abs(inside - color).max(axis=1) < 2e-3 for color in ((1, 0, 0), (0, 0, 1)))
    assert (red | blue).all() and red.any() and blue.any()
    back = mesh_of(session)
    assert np.allclose(back.colors[back.color_faces], mesh.colors[mesh.color_faces])


def test_flat_and_the_files_normals_are_shaded(tmp_path):
    """c24: a ball of flat faces under a sun: each pixel has its face's own shade, for "file" and for "flat", and not for "smooth"."""
    b = icosphere(0)
    sun = [Light("directional", 2.0, (-0.3, -0.5, -0.8))]
    own = corner_normals(b, "flat")[:, 0]
    mesh = replace(b, normals=own, normal_faces=np.repeat(np.arange(20)[:, None], 3, axis=1))
    pictures = {}
    for kind in ("file", "flat", "smooth"):
        pictures[kind], session = shown(Problem(mesh, VIEW, albedo="constant", shading="lambert", lights=sun, normals=kind))
        assert (mesh_of(session).normals is not None) == (kind == "file")
    direction = np.array((-0.3, -0.5, -0.8)) / np.linalg.norm((-0.3, -0.5, -0.8))
    shades = np.maximum(own @ -direction, 0.0) * 0.5 * 2.0 / np.pi
    for kind in ("file", "flat"):
        inside = pictures[kind][pictures[kind][..., 3] > 0.999][:, 0]
        assert np.abs(inside[:, None] - shades).min(axis=1).max() < 1e-5, kind
    assert np.abs(pictures["smooth"] - pictures["flat"]).max() > 0.05
