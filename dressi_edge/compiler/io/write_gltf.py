"""glTF out: parts, lights and cameras in, the bytes of a .glb or of a .gltf with everything inside.

Corners with different uvs, colours or normals are vertices of their own; each mesh vertex's first corner stays in its place, the others
follow after the last. Colours are linear in glTF, of 16 bits; pictures are PNG.
"""
from __future__ import annotations

import base64
import json
import math
import struct
from collections.abc import Sequence

import numpy as np

from ...cache.errors import note
from .cameras import Camera, inverse_rigid
from .gltf_lights import EXTENSION, PlacedLight
from .images import png_bytes, srgb_to_linear
from .materials import Part, TextureMap
from .mesh import Mesh, corner_normals, origin_of, unique_rows

WRAPS = {"repeat": 10497, "clamp": 33071, "mirror": 33648}
TYPES = {"<f4": 5126, "<u2": 5123, "<u4": 5125}
MAPS = {"normalTexture": "normal_texture", "occlusionTexture": "occlusion_texture", "emissiveTexture": "emissive_texture"}


def split(mesh: Mesh, corners: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
    """Vertices of a file that has one index for all. corners: (F, 3) indices of attributes.

    Gives (n,) the mesh vertex of each, n at least V and the first V the mesh's own in order; the faces (F, 3) by these; and for each
    attribute (n,) which of its values a vertex has, -1 for vertices that no face uses.
    """
    rows = np.stack([mesh.faces.reshape(-1), *(c.reshape(-1) for c in corners)], axis=-1).astype(np.int64)
    first, inverse = unique_rows(rows)
    combos = rows[first]
    count = len(mesh.positions)
    own = np.full(count, len(combos))
    np.minimum.at(own, combos[:, 0], np.arange(len(combos)))
    place = np.full(len(combos), -1)
    used = own < len(combos)
    place[own[used]] = np.flatnonzero(used)
    place[place < 0] = count + np.arange((place < 0).sum())
    total = int(max(count, place.max() + 1))
    vertex, values = np.arange(total), [np.full(total, -1) for _ in corners]
    vertex[place] = combos[:, 0]
    for k, found in enumerate(values):
        found[place] = combos[:, k + 1]
    return vertex, place[inverse].reshape(-1, 3), values


class _Writer:
    """The growing document and its one buffer. origin: (3,) what positions are about; glTF has them in fp32, but nodes, which bring them
    back, in as many digits as one writes."""

    def __init__(self, origin: np.ndarray):
        self.origin = origin
        self.json: dict = {"asset": {"version": "2.0", "generator": "dressi_edge"}, "scene": 0, "scenes": [{"nodes": []}]}
        self.buffer, self.extensions = bytearray(), set()
        self.textures: dict[tuple, int] = {}

    def add(self, key: str, entry: dict) -> int:
        self.json.setdefault(key, []).append(entry)
        return len(self.json[key]) - 1

    def view(self, data: bytes, **more) -> int:
        self.buffer += b"\0" * (-len(self.buffer) % 4)
        self.buffer += data
        return self.add("bufferViews", {"buffer": 0, "byteOffset": len(self.buffer) - len(data), "byteLength": len(data), **more})

    def accessor(self, values: np.ndarray, kind: str, target: int, **more) -> int:
        values = np.ascontiguousarray(values, kind)
        return self.add("accessors", {
            "bufferView": self.view(values.tobytes(), target=target), "componentType": TYPES[kind], "count": len(values),
            "type": "SCALAR" if values.ndim == 1 else f"VEC{values.shape[1]}", **more})

    def texture(self, texels: np.ndarray, key: object, wrap: tuple[str, str]) -> int:
        """A texture of the texels; one for each key and wrap."""
        if (key, wrap) not in self.textures:
            image = self.add("images", {"bufferView": self.view(png_bytes(texels)), "mimeType": "image/png"})
            sampler = self.add("samplers", {"wrapS": WRAPS[wrap[0]], "wrapT": WRAPS[wrap[1]]})
            self.textures[key, wrap] = self.add("textures", {"source": image, "sampler": sampler})
        return self.textures[key, wrap]

    def material(self, part: Part, sets: dict[tuple, int]) -> int:
        m, mesh = part.material, part.mesh
        pbr: dict = {"metallicFactor": m.metallic, "roughnessFactor": m.roughness}
        if m.stated and m.base_color != (1.0,) * 4:
            pbr["baseColorFactor"] = list(m.base_color)
        if mesh.texture is not None and mesh.uvs is not None:
            wrap = m.base_texture.wrap if m.base_texture else (mesh.wrap,) * 2
            texels = mesh.texture
            if m.base_texture and m.alpha_mode != "OPAQUE":
                texels = _with_alpha(texels, m.base_texture)
            pbr["baseColorTexture"] = {"index": self.texture(texels, id(mesh), wrap)}
        elif m.stated:
            pbr["baseColorFactor"] = list(m.base_color)
        entry: dict = {"name": m.name, "pbrMetallicRoughness": pbr, "alphaMode": m.alpha_mode, "doubleSided": m.double_sided}
        if m.alpha_mode == "MASK":
            entry["alphaCutoff"] = m.alpha_cutoff

        def info(found: TextureMap, **more) -> dict:
            texture = self.texture(found.picture.texels(), id(found.picture), found.wrap)
            return {"index": texture, "texCoord": sets[found.uv_set, found.transform], **more}

        if m.metallic_roughness_texture:
            pbr["metallicRoughnessTexture"] = info(m.metallic_roughness_texture)
        for key, name in MAPS.items():
            if found := getattr(m, name):
                more = {"normalTexture": {"scale": m.normal_scale}, "occlusionTexture": {"strength": m.occlusion_strength}}.get(key, {})
                entry[key] = info(found, **more)
        strength = max(1.0, *m.emissive)
        if any(m.emissive):
            entry["emissiveFactor"] = [x / strength for x in m.emissive]
        used = {"KHR_materials_unlit": {}} if m.unlit else {}
        if strength > 1.0:
            used["KHR_materials_emissive_strength"] = {"emissiveStrength": strength}
        if used:
            entry["extensions"] = used
            self.extensions |= set(used)
        return self.add("materials", entry)

    def part(self, part: Part) -> None:
        mesh, m = part.mesh, part.material
        uvs = [] if mesh.uvs is None else [(mesh.uvs, mesh.uv_faces)]
        sets: dict[tuple, int] = {}
        for found in m.extra_maps.values():
            key = (found.uv_set, found.transform)
            if key not in sets:
                values, faces = part.uv_sets.get(found.uv_set, (None, None))
                if values is None:  # the part was made by hand: the one set it has
                    values, faces = (mesh.uvs, mesh.uv_faces) if mesh.uvs is not None else (np.zeros((1, 2)), np.zeros_like(mesh.faces))
                sets[key] = len(uvs)
                uvs.append((found.applied(values), faces))
        keys = [faces for _, faces in uvs]
        keys += [mesh.color_faces] if mesh.color_faces is not None else []
        keys += [mesh.normal_faces] if mesh.normals is not None else []
        vertex, faces, chosen = split(mesh, keys)
        positions = (mesh.positions[vertex] - self.origin).astype(np.float32)
        span = {"min": positions.min(axis=0).tolist(), "max": positions.max(axis=0).tolist()}
        attributes = {"POSITION": self.accessor(positions, "<f4", 34962, **span)}
        if mesh.normals is not None:
            normals = np.concatenate([mesh.normals, [(0.0, 0.0, 1.0)]])[chosen[-1]]
        else:
            normals = np.zeros((len(mesh.positions), 3)) + (0.0, 0.0, 1.0)
            normals[mesh.faces.reshape(-1)] = corner_normals(mesh, "smooth").reshape(-1, 3)  # the same on both sides of a seam
            normals = normals[vertex]
        attributes["NORMAL"] = self.accessor(normals, "<f4", 34962)
        for k, (values, _) in enumerate(uvs):
            attributes[f"TEXCOORD_{k}"] = self.accessor(np.concatenate([values, [(0.0, 0.0)]])[chosen[k]], "<f4", 34962)
        if mesh.colors is not None:
            index = vertex if mesh.color_faces is None else chosen[len(uvs)]
            linear = srgb_to_linear(np.concatenate([mesh.colors, [(1.0, 1.0, 1.0)]]))[index]
            rgba = np.rint(np.concatenate([linear, np.ones((len(linear), 1))], axis=1) * 65535.0)
            attributes["COLOR_0"] = self.accessor(rgba, "<u2", 34962, normalized=True)
        kind = "<u2" if len(vertex) < 65535 else "<u4"  # the largest value of a type restarts strips
        index = self.accessor(faces.reshape(-1), kind, 34963)
        primitive = {"attributes": attributes, "indices": index, "material": self.material(part, sets)}
        node = {"name": part.name, "mesh": self.add("meshes", {"name": part.name, "primitives": [primitive]})}
        if self.origin.any():
            node["translation"] = self.origin.tolist()
        self._node(node)

    def _node(self, entry: dict) -> None:
        self.json["scenes"][0]["nodes"].append(self.add("nodes", entry))

    def light(self, light: PlacedLight) -> None:
        """A light on a node of its own, which turns it from -z."""
        intensity = max(light.power)
        entry = {"name": light.name, "type": light.kind, "color": [x / intensity for x in light.power] if intensity else [1.0] * 3,
                 "intensity": intensity}
        if light.kind == "spot":
            entry["spot"] = {"innerConeAngle": light.cone[0], "outerConeAngle": light.cone[1]}
        own = self.json.setdefault("extensions", {}).setdefault(EXTENSION, {"lights": []})["lights"]
        own.append(entry)
        self.extensions.add(EXTENSION)
        node = {"name": light.name, "extensions": {EXTENSION: {"light": len(own) - 1}}}
        if light.kind != "directional":
            node["translation"] = list(light.position)
        if light.kind != "point":
            node["rotation"] = _turn(np.array(light.direction))
        self._node(node)

    def camera(self, name: str, camera: Camera) -> None:
        """A camera on a node of its own. glTF's look along the middle of their pictures."""
        if abs(camera.cx - camera.width / 2) > 0.5 or abs(camera.cy - camera.height / 2) > 0.5:
            note(f"camera {name}: glTF has the principal point in the middle of the picture, not at ({camera.cx:g}, {camera.cy:g})")
        across, up = camera.width / (2.0 * camera.fx), camera.height / (2.0 * camera.fy)
        lens = {"znear": camera.near, "zfar": camera.far}
        lens |= {"xmag": across, "ymag": up} if camera.kind == "orthographic" else {"yfov": 2.0 * math.atan(up), "aspectRatio": across / up}
        index = self.add("cameras", {"name": name, "type": camera.kind, camera.kind: lens})
        self._node({"name": name, "camera": index, "matrix": inverse_rigid(camera.world_to_camera).T.reshape(-1).tolist()})


def _turn(direction: np.ndarray) -> list[float]:
    """The quaternion (x, y, z, w) that turns -z to a direction."""
    d = direction / np.linalg.norm(direction)
    q = np.array([d[1], -d[0], 0.0, 1.0 - d[2]])  # cross(-z, d), 1 + dot(-z, d)
    size = np.linalg.norm(q)
    return (q / size).tolist() if size > 1e-6 else [0.0, 1.0, 0.0, 0.0]


def _with_alpha(texels: np.ndarray, base: TextureMap) -> np.ndarray:
    """The texels with the alpha of the file's picture, where that has one of this size."""
    stored = base.picture.texels()
    return np.concatenate([texels, stored[..., 3:]], axis=-1) if stored.shape[2] == 4 and stored.shape[:2] == texels.shape[:2] else texels


def encode_gltf(parts: Sequence[Part], binary: bool, lights: Sequence[PlacedLight] = (),
                cameras: Sequence[tuple[str, Camera]] = ()) -> bytes:
    """A .glb, or a .gltf whose buffer is a data URI."""
    writer = _Writer(origin_of(np.concatenate([part.mesh.positions for part in parts])))
    for part in parts:
        writer.part(part)
    for light in lights:
        writer.light(light)
    for name, camera in cameras:
        writer.camera(name, camera)
    document, data = writer.json, bytes(writer.buffer) + b"\0" * (-len(writer.buffer) % 4)
    if writer.extensions:
        document["extensionsUsed"] = sorted(writer.extensions)
    document["buffers"] = [{"byteLength": len(data)}]
    if not binary:
        document["buffers"][0]["uri"] = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
        return json.dumps(document, indent=1, allow_nan=False).encode() + b"\n"
    text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    return (struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(data)) + struct.pack("<I4s", len(text), b"JSON") + text
            + struct.pack("<I4s", len(data), b"BIN\0") + data)


