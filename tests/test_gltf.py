"""glTF in: accessors, extensions, scenes, skins and materials as the specification applies them, and what is not read is named."""

import json
import struct
import warnings

import numpy as np
import pytest
from gltf_files import CORNER_UVS, SQUARE, TWO, GltfFile, checker
from PIL import Image

from dressi_edge.cache.errors import InputError, InputWarning
from dressi_edge.compiler.io import gltf
from dressi_edge.compiler.io.images import linear_to_srgb, srgb_to_linear
from dressi_edge.compiler.io.mesh import corner_normals
from dressi_edge.compiler.io.meshes import load_mesh, load_parts


@pytest.fixture(autouse=True)
def notes_are_errors():
    """A note is an error, unless the test expects it."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", InputWarning)
        yield


def corners(mesh, what="positions") -> np.ndarray:
    """(F, 3, c) at the corners of faces."""
    if what == "positions":
        return mesh.positions[mesh.faces]
    if what == "uvs":
        return mesh.uvs[mesh.uv_faces]
    if what == "normals":
        return mesh.normals[mesh.normal_faces]
    return mesh.colors[mesh.faces if mesh.color_faces is None else mesh.color_faces]


# ---- accessors


LEVELS = {"uint8": 255, "uint16": 65535, "int8": 127, "int16": 32767}


@pytest.mark.parametrize("kind, stride", [(kind, stride) for kind in LEVELS for stride in (None, 12)])
def test_normalized_integers_of_every_width_are_fractions(tmp_path, kind, stride):
    """uvs: unsigned ones by the largest value of their type, signed ones too and not below -1."""
    g, top = GltfFile(), LEVELS[kind]
    stored = np.array([[0, top], [top, top], [top, 0], [top // 3, -top - 1 if kind[0] == "i" else 0]], kind)
    uv = g.accessor(stored, stride, normalized=True)
    g.square(attributes={"TEXCOORD_0": uv})
    mesh = load_mesh(g.save(tmp_path / "a.glb"))
    wanted = np.maximum(stored / top, -1.0)
    assert np.allclose(corners(mesh, "uvs"), wanted[TWO], atol=1e-12)


@pytest.mark.parametrize("kind, columns", [("uint8", 3), ("uint8", 4), ("uint16", 3), ("uint16", 4), ("float32", 3), ("float32", 4)])
def test_vertex_colours_are_linear_in_any_type(tmp_path, kind, columns):
    linear = np.random.default_rng(3).uniform(0.05, 0.9, (4, columns))
    top = LEVELS.get(kind, 1)
    stored = (np.rint(linear * top) if top > 1 else linear).astype(kind)
    g = GltfFile()
    said = {"normalized": True} if top > 1 else {}
    g.square(attributes={"COLOR_0": g.accessor(stored, -(-stored.itemsize * columns // 4) * 4, **said)})
    mesh = load_mesh(g.save(tmp_path / "a.glb"))
    assert mesh.color_faces is None
    assert np.allclose(srgb_to_linear(mesh.colors), stored[:, :3] / top, atol=1e-7)


def test_quantized_positions_are_what_they_say(tmp_path):
    """KHR_mesh_quantization: plain integers as they are, normalized ones as fractions, the node scales them."""
    g = GltfFile()
    g.json |= {"extensionsUsed": ["KHR_mesh_quantization"], "extensionsRequired": ["KHR_mesh_quantization"]}
    plain = g.accessor((SQUARE * 100).astype(np.int16), 8)
    fractions = g.accessor((SQUARE * 255).astype(np.uint8), 4, normalized=True)
    index = g.accessor(TWO.reshape(-1))
    g.node([{"attributes": {"POSITION": plain}, "indices": index}], scale=[0.01] * 3)
    g.node([{"attributes": {"POSITION": fractions}, "indices": index}], translation=[0, 0, 3])
    mesh = load_mesh(g.save(tmp_path / "a.glb"))
    assert np.allclose(corners(mesh), np.concatenate([SQUARE[TWO], SQUARE[TWO] + (0, 0, 3)]))


def test_sparse_entries_replace_those_of_the_base_or_zeros(tmp_path):
    g = GltfFile()
    index, values = np.array([1, 2, 3], np.uint8), np.array([[5, 0, 0], [6, 6, 0], [0, 7, 0]], np.float32)
    sparse = {"count": 3, "indices": {"bufferView": g.view(index.tobytes()), "componentType": 5121},
              "values": {"bufferView": g.view(values.tobytes())}}
    with_base = g.accessor(SQUARE, sparse=sparse)
    without = g.add("accessors", {"componentType": 5126, "count": 4, "type": "VEC3", "sparse": sparse})
    faces = g.accessor(TWO.reshape(-1))
    g.node([{"attributes": {"POSITION": with_base}, "indices": faces}])
    g.node([{"attributes": {"POSITION": without}, "indices": faces}], translation=[0, 0, 2])
    wanted = np.array([[0, 0, 0], [5, 0, 0], [6, 6, 0], [0, 7, 0]])
    assert np.array_equal(load_mesh(g.save(tmp_path / "a.glb")).positions, np.concatenate([wanted, wanted + (0, 0, 2)]))


@pytest.mark.parametrize("indexed", [True, False])
def test_strips_and_fans_keep_their_outside(tmp_path, indexed):
    strip = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 2, 0]], np.float32)
    fan = np.array([[0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]], np.float32)
    g = GltfFile()
    for points, mode in ((strip, 5), (fan, 6)):
        given = {"attributes": {"POSITION": g.accessor(points)}, "mode": mode}
        g.node([given | ({"indices": g.accessor(np.arange(len(points), dtype=np.uint8))} if indexed else {})])
    mesh = load_mesh(g.save(tmp_path / "a.glb"))
    a, b, c = (mesh.positions[mesh.faces[:, k]] for k in range(3))
    areas = np.cross(b - a, c - a)
    assert len(mesh.faces) == 5 and np.allclose(areas, (0, 0, 1)), "all are seen anticlockwise from +z, none twice"


# ---- extensions


@pytest.mark.parametrize("name", ["KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_texture_basisu", "VENDOR_new"])
def test_required_extensions_that_are_not_read_are_one_error(tmp_path, name):
    g = GltfFile()
    g.square()
    g.json |= {"extensionsUsed": [name], "extensionsRequired": [name]}
    with pytest.raises(InputError, match=f"requires the glTF extension {name}, which is not read; export it without") as caught:
        load_mesh(g.save(tmp_path / "a.glb"))
    assert "\n" not in str(caught.value)


def test_optional_extensions_that_are_not_read_are_one_note(tmp_path):
    g = GltfFile()
    g.square()
    g.json |= {"extensionsUsed": ["KHR_materials_clearcoat", "VENDOR_new", "KHR_materials_unlit"]}
    with pytest.warns(InputWarning, match="KHR_materials_clearcoat, VENDOR_new are not read") as noted:
        mesh = load_mesh(g.save(tmp_path / "a.glb"))
    assert len(noted) == 1 and len(mesh.faces) == 2


def test_optional_compression_is_read_by_its_fallback_or_refused(tmp_path):
    """Draco beside plain accessors: those are read. Without data of their own, nothing can be."""
    g = GltfFile()
    g.square()
    draco = {"KHR_draco_mesh_compression": {"bufferView": g.view(b"DRACO"), "attributes": {"POSITION": 0}}}
    g.json["meshes"][0]["primitives"][0]["extensions"] = draco
    g.json["extensionsUsed"] = ["KHR_draco_mesh_compression"]
    with pytest.warns(InputWarning, match="KHR_draco_mesh_compression"):
        assert np.array_equal(load_mesh(g.save(tmp_path / "a.glb")).positions, SQUARE)
    del g.json["accessors"][0]["bufferView"]
    with pytest.warns(InputWarning), pytest.raises(InputError, match="KHR_draco_mesh_compression, which is not read"):
        load_mesh(g.save(tmp_path / "b.glb"))


def test_meshopt_without_required_is_refused_where_its_data_is_all(tmp_path):
    g = GltfFile()
    g.square()
    g.json["buffers"] = [{"byteLength": len(g.data)}, {"byteLength": 48, "extensions": {"EXT_meshopt_compression": {"fallback": True}}}]
    g.json["bufferViews"][0]["buffer"] = 1
    with pytest.raises(InputError, match="needs the glTF extension EXT_meshopt_compression"):
        load_mesh(g.save(tmp_path / "a.glb"))


@pytest.mark.parametrize("required", [False, True])
def test_texture_transforms_are_applied(tmp_path, required):
    g = GltfFile()
    name = "KHR_texture_transform"
    moved = {"offset": [0.25, 0.5], "rotation": np.pi / 2, "scale": [2.0, 0.5]}
    material = g.material(texture=g.texture(checker(2, 2)), info={"extensions": {name: moved}})
    g.square(material, {"TEXCOORD_0": g.accessor(CORNER_UVS)})
    g.json["extensionsUsed"] = [name]
    if required:
        g.json["extensionsRequired"] = [name]
    mesh = load_mesh(g.save(tmp_path / "a.glb"))
    # Scaled, turned by a quarter against the clock as one sees it (right becomes up, which is -v), then moved.
    u, v = CORNER_UVS[TWO][..., 0] * 2.0, CORNER_UVS[TWO][..., 1] * 0.5
    assert np.allclose(corners(mesh, "uvs"), np.stack([v + 0.25, -u + 0.5], axis=-1))
    assert mesh.texture.shape == (2, 2, 3)


@pytest.mark.parametrize("by_extension", [False, True])
def test_the_texture_says_which_coordinates_are_its(tmp_path, by_extension):
    g = GltfFile()
    info = {"texCoord": 1} if not by_extension else {"texCoord": 0, "extensions": {"KHR_texture_transform": {"texCoord": 1}}}
    material = g.material(texture=g.texture(checker(2, 2)), info=info)
    g.square(material, {"TEXCOORD_0": g.accessor(np.zeros((4, 2), np.float32)), "TEXCOORD_1": g.accessor(CORNER_UVS)})
    path = g.save(tmp_path / "a.glb")
    assert np.allclose(corners(load_mesh(path), "uvs"), CORNER_UVS[TWO])
    part = load_parts(path)[0]
    assert sorted(part.uv_sets) == [0, 1] and part.material.base_texture.uv_set == 1


def test_a_texture_without_its_coordinates_is_left_out_with_a_note(tmp_path):
    g = GltfFile()
    g.square(g.material((1, 0, 0, 1), g.texture(checker(2, 2)), {"texCoord": 2}), {"TEXCOORD_0": g.accessor(CORNER_UVS)})
    with pytest.warns(InputWarning, match="no texture coordinates for the base colour texture"):
        mesh = load_mesh(g.save(tmp_path / "a.glb"))
    assert mesh.texture is None and np.allclose(mesh.colors, (1, 0, 0))


def test_specular_glossiness_has_its_diffuse_colour_read(tmp_path):
    g = GltfFile()
    index = g.add("materials", {"extensions": {"KHR_materials_pbrSpecularGlossiness": {"diffuseFactor": [0.2, 0.4, 0.6, 1.0]}}})
    g.square(index)
    assert np.allclose(srgb_to_linear(load_mesh(g.save(tmp_path / "a.glb")).colors), (0.2, 0.4, 0.6))


def test_instances_of_an_extension_are_drawn(tmp_path):
    g = GltfFile()
    at = g.accessor(np.array([[0, 0, 1], [0, 0, 2]], np.float32))
    g.square(extensions={"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": at}}})
    mesh = load_mesh(g.save(tmp_path / "a.glb"))
    assert len(mesh.faces) == 4 and sorted(set(mesh.positions[:, 2])) == [1.0, 2.0]


def test_a_basis_picture_with_a_fallback_is_noted(tmp_path):
    g = GltfFile()
    texture = g.texture(checker(2, 2), extensions={"KHR_texture_basisu": {"source": 0}})
    g.square(g.material(texture=texture), {"TEXCOORD_0": g.accessor(CORNER_UVS)})
    g.json["extensionsUsed"] = ["KHR_texture_basisu"]
    with pytest.warns(InputWarning, match="KHR_texture_basisu"):
        assert load_mesh(g.save(tmp_path / "a.glb")).texture.shape == (2, 2, 3)


# ---- scenes


def test_only_the_default_scene_is_read(tmp_path):
    g = GltfFile()
    g.square()
    g.square(translation=[0, 0, 9])
    g.json |= {"scenes": [{"nodes": [0]}, {"nodes": [1]}], "scene": 1}
    with pytest.warns(InputWarning, match="1 nodes with meshes are in other scenes"):
        assert np.array_equal(load_mesh(g.save(tmp_path / "a.glb")).positions, SQUARE + (0, 0, 9))
    del g.json["scene"]
    with pytest.warns(InputWarning) as noted:
        assert np.array_equal(load_mesh(g.save(tmp_path / "b.glb")).positions, SQUARE)
    assert "says of none that it is the default; the first is read" in str(noted[0].message) and len(noted) == 2


def test_nodes_turn_scale_and_move_in_that_order(tmp_path):
    g, half = GltfFile(), np.sqrt(0.5)
    g.square(rotation=[0, 0, half, half], scale=[2, 1, 1], translation=[10, 0, 0])  # a quarter about z
    assert np.allclose(load_mesh(g.save(tmp_path / "a.glb")).positions, [[10, 0, 0], [10, 2, 0], [9, 2, 0], [9, 0, 0]])


def test_skins_stand_as_their_joints_do(tmp_path):
    """Two joints; the node's own transform does not count (3.7.3.1)."""
    g = GltfFile()
    joints, weights = np.array([[0, 1, 0, 0]] * 4, np.uint8), np.array([[1, 0], [1, 0], [0, 1], [0.5, 0.5]], np.float32)
    attributes = {"JOINTS_0": g.accessor(joints), "WEIGHTS_0": g.accessor(np.pad(weights, ((0, 0), (0, 2))))}
    g.square(attributes=attributes, skin=0, translation=[100, 0, 0])
    bind = np.stack([np.eye(4), np.eye(4)])
    bind[1, :3, 3] = (0, -1, 0)  # the second joint was at y = 1 when it was bound
    g.add("skins", {"joints": [1, 2], "inverseBindMatrices": g.accessor(bind.transpose(0, 2, 1).reshape(2, 16).astype(np.float32))})
    g.add("nodes", {"children": [2]})
    g.add("nodes", {"translation": [0, 1, 4]})
    g.json["scenes"][0]["nodes"].append(1)
    assert np.allclose(load_mesh(g.save(tmp_path / "a.glb")).positions, [[0, 0, 0], [1, 0, 0], [1, 1, 4], [0, 1, 2]])


def test_morph_targets_count_by_the_files_weights_and_are_named(tmp_path):
    g = GltfFile()
    target = g.accessor(np.full((4, 3), 2.0, np.float32))
    g.square()
    mesh = g.json["meshes"][0]
    mesh["primitives"][0]["targets"] = [{"POSITION": target}]
    mesh |= {"weights": [0.25], "extras": {"targetNames": ["smile"]}}
    with pytest.warns(InputWarning, match=r"morph targets \(smile\) .* not read"):
        assert np.allclose(load_mesh(g.save(tmp_path / "a.glb")).positions, SQUARE + 0.5)


def test_points_lines_and_animations_are_one_note(tmp_path):
    g = GltfFile()
    g.square()
    g.node([{"attributes": {"POSITION": g.accessor(SQUARE)}, "mode": 0}, {"attributes": {"POSITION": g.accessor(SQUARE)}, "mode": 3}])
    g.json["animations"] = [{"channels": [], "samplers": []}]
    with pytest.warns(InputWarning, match="animations, points, lines are not read") as noted:
        assert len(load_mesh(g.save(tmp_path / "a.glb")).faces) == 2
    assert len(noted) == 1


# ---- materials


def test_colours_of_materials_are_colours(tmp_path):
    """c07: one red part; a red and a blue one that share their vertices."""
    red, blue = (0.6, 0.05, 0.05), (0.05, 0.1, 0.6)
    g = GltfFile()
    position = g.accessor(SQUARE)
    g.node([{"attributes": {"POSITION": position}, "indices": g.accessor(TWO[k]), "material": g.material((*color, 1))}
            for k, color in enumerate((red, blue))])
    path = g.save(tmp_path / "a.glb")
    mesh = load_mesh(path)
    assert len(mesh.positions) == 4 and mesh.vertex_map is None, "one vertex list, as the file has it"
    assert np.allclose(corners(mesh, "colors"), linear_to_srgb(np.array([[red] * 3, [blue] * 3])))
    assert [part.material.base_color for part in load_parts(path)] == [(*red, 1.0), (*blue, 1.0)]
    g = GltfFile()
    g.square(g.material((*red, 1)))
    mesh = load_mesh(g.save(tmp_path / "b.glb"))
    assert mesh.color_faces is None and np.allclose(mesh.colors, linear_to_srgb(np.array(red)))
    g = GltfFile()
    g.square(g.material())
    assert load_mesh(g.save(tmp_path / "c.glb")).colors is None, "a material that says nothing of colour"


def test_factors_multiply_vertex_colours_in_linear_light(tmp_path):
    g = GltfFile()
    g.square(g.material((0.5, 1.0, 0.25, 1.0)), {"COLOR_0": g.accessor(np.full((4, 3), 0.5, np.float32))})
    assert np.allclose(srgb_to_linear(load_mesh(g.save(tmp_path / "a.glb")).colors), (0.25, 0.5, 0.125), atol=1e-6)


def test_everything_of_a_material_arrives_in_its_part(tmp_path):
    g = GltfFile()
    pictures = [g.texture(checker(2, 2, seed)) for seed in range(5)]
    sampler = g.add("samplers", {"wrapS": 33071, "wrapT": 33648})
    g.json["textures"][pictures[0]]["sampler"] = sampler
    g.add("materials", {
        "name": "paint", "doubleSided": True, "alphaMode": "MASK", "alphaCutoff": 0.25, "emissiveFactor": [0.5, 0.25, 0.0],
        "pbrMetallicRoughness": {"baseColorFactor": [0.1, 0.2, 0.3, 0.4], "baseColorTexture": {"index": pictures[0]},
                                 "metallicFactor": 0.75, "roughnessFactor": 0.5, "metallicRoughnessTexture": {"index": pictures[1]}},
        "normalTexture": {"index": pictures[2], "scale": 2.0}, "occlusionTexture": {"index": pictures[3], "strength": 0.5},
        "emissiveTexture": {"index": pictures[4]},
        "extensions": {"KHR_materials_unlit": {}, "KHR_materials_emissive_strength": {"emissiveStrength": 4.0}}})
    g.square(0, {"TEXCOORD_0": g.accessor(CORNER_UVS)}, name="wall")
    path = g.save(tmp_path / "a.glb")
    part = load_parts(path)[0]
    m = part.material
    assert (part.name, m.name, m.alpha_mode, m.alpha_cutoff, m.double_sided, m.unlit) == ("wall", "paint", "MASK", 0.25, True, True)
    assert m.base_color == (0.1, 0.2, 0.3, 0.4) and (m.metallic, m.roughness) == (0.75, 0.5) and m.emissive == (2.0, 1.0, 0.0)
    assert m.base_texture.wrap == ("clamp", "mirror") and (m.normal_scale, m.occlusion_strength) == (2.0, 0.5)
    maps = (m.base_texture, m.metallic_roughness_texture, m.normal_texture, m.occlusion_texture, m.emissive_texture)
    assert all(np.array_equal(found.picture.texels() * 255, checker(2, 2, seed)) for seed, found in enumerate(maps))
    with pytest.warns(InputWarning) as noted:
        load_mesh(path)
    assert "not used by a single mesh: metallic-roughness maps, normal maps, occlusion maps, emissive maps" in str(noted[0].message)
    assert "paint: transparency is not drawn" in str(noted[1].message) and len(noted) == 2


def test_flat_normals_of_split_vertices_stay_while_vertices_move_together(tmp_path):
    """c24: a crease is two normals at corners of one vertex."""
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 0], [0, 1, 0], [0, 0, 1]], np.float32)
    normals = np.array([[0, 0, 2]] * 3 + [[1, 0, 0]] * 3, np.float32)
    g = GltfFile()
    g.node([{"attributes": {"POSITION": g.accessor(points), "NORMAL": g.accessor(normals)}}], scale=[1, 1, 2])
    mesh = load_mesh(g.save(tmp_path / "a.glb"))
    assert len(mesh.positions) == 4 and mesh.vertex_map.tolist() == [0, 1, 2, 0, 2, 3]
    assert np.allclose(corners(mesh, "normals"), [[[0, 0, 1]] * 3, [[1, 0, 0]] * 3])
    assert np.allclose(corner_normals(mesh, "file"), corner_normals(mesh, "flat"))
    assert not np.allclose(corner_normals(mesh, "smooth"), corner_normals(mesh, "flat"))


def test_a_surface_without_normals_is_flat(tmp_path):
    g = GltfFile()
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float32)
    g.node([{"attributes": {"POSITION": g.accessor(points)}, "indices": g.accessor(np.array([0, 1, 2, 0, 2, 3], np.uint8))}])
    mesh = load_mesh(g.save(tmp_path / "a.glb"))
    assert np.allclose(corners(mesh, "normals"), [[[0, 0, 1]] * 3, [[1, 0, 0]] * 3])


def test_pictures_are_found_by_uri_and_missing_ones_named(tmp_path):
    g = GltfFile()
    g.add("images", {"uri": "oak%20skin.png"})
    g.add("textures", {"source": 0})
    g.square(g.material(texture=0), {"TEXCOORD_0": g.accessor(CORNER_UVS)})
    g.json["buffers"] = [{"byteLength": len(g.data)}]
    path = g.save(tmp_path / "a.glb")
    with pytest.raises(InputError, match=r"image oak%20skin.png \(named in a.glb\) does not exist"):
        load_mesh(path)
    with pytest.raises(InputError, match="does not exist"):
        load_parts(path)
    Image.fromarray(checker(2, 3)).save(tmp_path / "oak skin.png")
    assert load_mesh(path).texture.shape == (2, 3, 3)
    (tmp_path / "other.png").write_bytes((tmp_path / "oak skin.png").read_bytes())
    (tmp_path / "oak skin.png").unlink()
    assert load_mesh(path, tmp_path / "other.png").texture.shape == (2, 3, 3), "who gives another needs it not"


def test_buffers_beside_the_file_are_found_with_spaces(tmp_path):
    g = GltfFile()
    g.square()
    (tmp_path / "my box.bin").write_bytes(bytes(g.data))
    g.json["buffers"] = [{"byteLength": len(g.data), "uri": "my%20box.bin"}]
    (tmp_path / "a.gltf").write_bytes(b"\xef\xbb\xbf" + json.dumps(g.json).encode())
    assert np.array_equal(load_mesh(tmp_path / "a.gltf").positions, SQUARE)
    (tmp_path / "my box.bin").unlink()
    with pytest.raises(InputError, match=r"buffer 0 is in 'my%20box.bin', which does not exist"):
        load_mesh(tmp_path / "a.gltf")


def test_what_follows_a_glb_is_not_looked_at(tmp_path):
    g = GltfFile()
    g.square()
    path = g.save(tmp_path / "a.glb")
    path.write_bytes(path.read_bytes() + b"trailing bytes of a download")
    assert np.array_equal(load_mesh(path).positions, SQUARE)
    path.write_bytes(path.read_bytes()[:-60])
    with pytest.raises(InputError, match="truncated"):
        load_mesh(path)


# ---- what is wrong is named


def broken(change) -> GltfFile:
    """Accessors and views 1 to 3 are uvs, positions and indices; the accessors count from 0."""
    g = GltfFile()
    g.square(g.material(texture=g.texture(checker(2, 2))), {"TEXCOORD_0": g.accessor(CORNER_UVS)})
    change(g.json)
    return g


@pytest.mark.parametrize("change, message", [
    (lambda j: j["asset"].update(version="1.0"), "is glTF 1.0; 2.0 is read"),
    (lambda j: j["accessors"][1].update(count=5), "accessor 1 needs 60 bytes of a bufferView of 48"),
    (lambda j: j["accessors"][1].update(count=-1), "well-formed"),
    (lambda j: j["accessors"][1].update(count=10 ** 30), "well-formed"),
    (lambda j: j["accessors"][1].update(componentType=5124), "accessor 1 is 'VEC3' of 5124"),
    (lambda j: j["accessors"][1].update(type="VEC2"), "VEC3 of a known component type is needed"),
    (lambda j: j["accessors"][0].update(count=3), "has 3 values of TEXCOORD_0 for 4 vertices"),
    (lambda j: j["bufferViews"][2].update(byteLength=1 << 20), "bufferView 2 ends at byte"),
    (lambda j: j["bufferViews"][2].update(byteStride=4), "accessor 1 needs"),
    (lambda j: j["bufferViews"][2].update(buffer=-1), r"it names buffers\[-1\], but there are 1"),
    (lambda j: j["nodes"][0].update(mesh=7), r"it names meshes\[7\], but there are 1"),
    (lambda j: j["nodes"][0].update(children=[0]), "ring|tree"),
    (lambda j: j["nodes"][0].update(scale=[1, 2]), r"node 0 has a scale of \[1, 2\]; 3 numbers are needed"),
    (lambda j: j["nodes"][0].update(rotation="x"), "well-formed|rotation"),
    (lambda j: j["scenes"].append(3), "scenes is no list of objects"),
    (lambda j: j.update(scene=4), r"it names scenes\[4\]"),
    (lambda j: j["meshes"][0].pop("primitives"), "no 'primitives'"),
    (lambda j: j["meshes"][0]["primitives"][0].update(mode=9), "has mode 9; 0 to 6 are known"),
    (lambda j: j["meshes"][0]["primitives"][0].update(indices=1), "accessor 1 is 'VEC3'"),
    (lambda j: j["materials"][0]["pbrMetallicRoughness"].update(baseColorFactor=[1, 2]), "base colour is .* 4 numbers are needed"),
    (lambda j: j["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"].update(texCoord=-1), "texCoord is -1"),
    (lambda j: j["images"][0].update(bufferView=1), "cannot be read"),
    (lambda j: j.update(nodes={"a": 1}), "nodes is no list of objects"),
])
def test_a_malformed_file_is_one_line(tmp_path, change, message):
    with pytest.raises(InputError, match=message) as caught:
        load_mesh(broken(change).save(tmp_path / "bad.glb"))
    assert "bad.glb" in str(caught.value) and "\n" not in str(caught.value)


def test_indices_beyond_the_vertices_are_named(tmp_path):
    g = GltfFile()
    g.node([{"attributes": {"POSITION": g.accessor(SQUARE)}, "indices": g.accessor(np.array([0, 1, 9], np.uint8))}])
    with pytest.raises(InputError, match="primitive 0 names vertex 9, but there are 4, 0 to 3"):
        load_mesh(g.save(tmp_path / "a.glb"))


def test_instances_without_end_are_refused_before_they_are_made(tmp_path, monkeypatch):
    monkeypatch.setattr(gltf, "MAX_CORNERS", 100)
    g = GltfFile()
    at = g.accessor(np.arange(33, dtype=np.float32).reshape(11, 3))
    g.square(extensions={"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": at}}})
    with pytest.raises(InputError, match="more than 100 corners of faces, all instances counted"):
        load_mesh(g.save(tmp_path / "a.glb"))


def test_headers_that_lie_are_named(tmp_path):
    path = tmp_path / "a.glb"
    for data, message in ((b"glTF", "truncated"), (struct.pack("<4sII", b"glTF", 1, 20) + bytes(8), "version 1; 2 is read"),
                          (struct.pack("<4sII", b"glTF", 2, 28) + struct.pack("<I4s", 8, b"BIN\0") + bytes(8), "begin with JSON"),
                          (b"[" * 100_000, "nests|JSON"), (b'{"a": ' + b"9" * 5000 + b"}", "glb"), (b"\xff\xfe{", "UTF-8"),
                          (b"[]", "no object")):
        path.write_bytes(data)
        with pytest.raises(InputError, match=message):
            load_mesh(path)
