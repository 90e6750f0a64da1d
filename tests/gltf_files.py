"""Tiny glTF files for tests, written by hand: what is in them is what the test says, and nothing that our writer does."""

import base64
import io
import json
import struct
from pathlib import Path

import numpy as np
from PIL import Image

CODES = {"int8": 5120, "uint8": 5121, "int16": 5122, "uint16": 5123, "uint32": 5125, "float32": 5126}
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
TWO = np.array([[0, 1, 2], [0, 2, 3]], np.uint16)
CORNER_UVS = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32)


class GltfFile:
    """A document that grows: accessors, images, materials and nodes by number; `json` may be changed before `save`."""

    def __init__(self):
        self.json = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": []}]}
        self.data = bytearray()

    def add(self, key: str, entry: dict) -> int:
        self.json.setdefault(key, []).append(entry)
        return len(self.json[key]) - 1

    def view(self, data: bytes, **more) -> int:
        self.data += b"\0" * (-len(self.data) % 4)
        self.data += data
        return self.add("bufferViews", {"buffer": 0, "byteOffset": len(self.data) - len(data), "byteLength": len(data), **more})

    def accessor(self, array, stride: int | None = None, **more) -> int:
        """stride: bytes from one entry to the next, padded with rubbish."""
        array = np.ascontiguousarray(array)
        columns, data = 1 if array.ndim == 1 else array.shape[1], array.tobytes()
        if stride:
            size = array.itemsize * columns
            data = b"".join(data[i * size:(i + 1) * size] + b"\xee" * (stride - size) for i in range(len(array)))
            view = self.view(data, byteStride=stride)
        else:
            view = self.view(data)
        return self.add("accessors", {"bufferView": view, "componentType": CODES[array.dtype.name], "count": len(array),
                                      "type": TYPES[columns], **more})

    def texture(self, pixels: np.ndarray, **more) -> int:
        data = io.BytesIO()
        Image.fromarray(pixels).save(data, "PNG")
        image = self.add("images", {"bufferView": self.view(data.getvalue()), "mimeType": "image/png"})
        return self.add("textures", {"source": image, **more})

    def material(self, factor=None, texture: int | None = None, info: dict | None = None, **more) -> int:
        pbr = {} if factor is None else {"baseColorFactor": list(factor)}
        if texture is not None:
            pbr["baseColorTexture"] = {"index": texture, **(info or {})}
        return self.add("materials", {"pbrMetallicRoughness": pbr, **more})

    def node(self, primitives: list[dict], **more) -> int:
        mesh = self.add("meshes", {"primitives": primitives})
        node = self.add("nodes", {"mesh": mesh, **more})
        self.json["scenes"][0]["nodes"].append(node)
        return node

    def square(self, material: int | None = None, attributes: dict | None = None, **more) -> int:
        """A node with two triangles: the unit square, v down along y."""
        given = {"POSITION": self.accessor(SQUARE), **(attributes or {})}
        primitive = {"attributes": given, "indices": self.accessor(TWO.reshape(-1))}
        return self.node([primitive | ({} if material is None else {"material": material})], **more)

    def save(self, path: Path) -> Path:
        document, data = self.json, bytes(self.data) + b"\0" * (-len(self.data) % 4)
        document.setdefault("buffers", [{"byteLength": len(data)}])
        if path.suffix == ".gltf":
            document["buffers"][0]["uri"] = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
            path.write_text(json.dumps(document))
            return path
        text = json.dumps(document).encode()
        text += b" " * (-len(text) % 4)
        path.write_bytes(struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(data)) + struct.pack("<I4s", len(text), b"JSON") + text
                         + struct.pack("<I4s", len(data), b"BIN\0") + data)
        return path


def checker(rows: int, columns: int, seed: int = 0) -> np.ndarray:
    """An image (rows, columns, 3) of random bytes."""
    return np.random.default_rng(seed).integers(0, 256, (rows, columns, 3), np.uint8)
