"""glTF 2.0 files: containers, buffers and accessors, exactly as sections 3.6 and 4 of the specification apply them.

In: a .gltf or .glb file. Out: its JSON as `Document`, which gives accessors as arrays and images as bytes or files.
"""
from __future__ import annotations

import base64
import struct
from pathlib import Path
from urllib.parse import unquote_to_bytes

import numpy as np

from ...cache.errors import InputError, note
from .pieces import listed
from .text import parse_json
from .textures import Picture, find_file

TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
SHAPES = {"SCALAR": (1,), "VEC2": (2,), "VEC3": (3,), "VEC4": (4,), "MAT2": (2, 2), "MAT3": (3, 3), "MAT4": (4, 4)}
READ = {"KHR_texture_transform", "KHR_materials_unlit", "KHR_mesh_quantization", "EXT_texture_webp", "KHR_materials_pbrSpecularGlossiness",
        "KHR_materials_emissive_strength", "EXT_mesh_gpu_instancing", "KHR_lights_punctual"}
HARMLESS = {"KHR_xmp", "KHR_xmp_json_ld", "KHR_animation_pointer", "EXT_lights_image_based",
            "EXT_lights_ies"}  # they say nothing of a surface
MAX_EMPTY = 1 << 22  # entries of an accessor without data of its own


class Document:
    """The JSON of a glTF file with what it refers to. `get` reads checked lists; malformed entries raise InputError or what Python
    raises for them, which `read_gltf` turns into one."""

    def __init__(self, path: Path, data: bytes):
        self.path, self.folder = path, path.parent
        self.json, self.binary = _contents(path, data)
        asset = self.json.get("asset", {})
        version, least = str(asset.get("version", "2.0")), str(asset.get("minVersion", "2.0"))
        if not version.startswith("2.") or not least.startswith("2.0"):
            raise InputError(f"{path} is glTF {least if version.startswith('2.') else version:.20}; 2.0 is read; export it as glTF 2.0")
        required = [str(name) for name in self.json.get("extensionsRequired", [])]
        if unread := [name for name in required if name not in READ]:
            packed = any(word in name for name in unread for word in ("compress", "meshopt", "basisu"))
            raise InputError(f"{path} requires the glTF extension{'s' * (len(unread) > 1)} {listed(unread)}, which is not read; export it "
                             f"without {'compression' if packed else 'it'}")
        if unread := [str(name) for name in self.json.get("extensionsUsed", []) if str(name) not in READ | HARMLESS]:
            note(f"{path}: glTF extensions {listed(unread)} are not read; what the file has without them is used")
        self._buffers: dict[int, bytes] = {}
        self._pictures: dict[int, Picture] = {}

    def list(self, key: str) -> list:
        """The top-level list of that name, of objects."""
        found = self.json.get(key, [])
        if not isinstance(found, list) or not all(isinstance(item, dict) for item in found):
            raise InputError(f"{self.path} is not well-formed glTF: {key} is no list of objects; export it again")
        return found

    def get(self, key: str, index) -> dict:
        """The entry of a top-level list. Raises InputError where there is none."""
        found = self.list(key)
        if type(index) is not int or not 0 <= index < len(found):
            raise InputError(f"{self.path} is not well-formed glTF: it names {key}[{index!r:.20}], but there are {len(found)}; export it "
                             "again")
        return found[index]

    def buffer(self, index: int) -> bytes:
        if index not in self._buffers:
            entry = self.get("buffers", index)
            uri, length = entry.get("uri"), _count(entry["byteLength"])
            if uri is None and "EXT_meshopt_compression" in entry.get("extensions", {}):
                raise InputError(f"{self.path} needs the glTF extension EXT_meshopt_compression, which is not read; export it without "
                                 "compression")
            if uri is None and index == 0 and self.binary is not None:
                data = self.binary
            else:
                data = self.contents(uri, f"buffer {index}")
            if len(data) < length:
                raise InputError(f"{self.path}: buffer {index} says {length} bytes and has {len(data)}; it is truncated")
            self._buffers[index] = data[:length]
        return self._buffers[index]

    def contents(self, uri, what: str) -> bytes:
        """The bytes of a data URI or of a file beside."""
        if isinstance(uri, str) and uri[:5].lower() == "data:":
            head, _, body = uri.partition(",")
            try:
                return base64.b64decode(body.translate({32: None, 10: None, 13: None}), validate=True) if ";base64" in head.lower() \
                    else unquote_to_bytes(body)
            except ValueError:
                raise InputError(f"{self.path}: the data URI of {what} is no base64; export it again") from None
        file = find_file(self.folder, uri) if isinstance(uri, str) else None
        if file is None:
            raise InputError(f"{self.path}: {what} is in {uri!r:.120}, which does not exist; put it beside the file")
        return file.read_bytes()

    def view(self, index: int) -> tuple[bytes, int | None]:
        """The bytes of a bufferView, and its stride."""
        entry = self.get("bufferViews", index)
        start, length = _count(entry.get("byteOffset", 0)), _count(entry["byteLength"])
        data = self.buffer(entry["buffer"])
        if start + length > len(data):
            raise InputError(f"{self.path}: bufferView {index} ends at byte {start + length} of a buffer of {len(data)}; export it again")
        stride = entry.get("byteStride")
        return data[start:start + length], None if stride is None else _count(stride)

    def _rows(self, view: int, offset, kind: str, shape: tuple[int, ...], count: int, what: str) -> np.ndarray:
        """(count, *shape) of a bufferView; columns of matrices begin at multiples of 4 bytes (3.6.2.4)."""
        data, stride = self.view(view)
        size, offset = int(kind[-1]), _count(offset)
        column = -(-shape[0] * size // 4) * 4 if len(shape) == 2 else shape[0] * size
        row = column * shape[1] if len(shape) == 2 else column
        stride = stride or row
        if stride < row or count and offset + stride * (count - 1) + row - (column - shape[0] * size) > len(data):
            raise InputError(f"{self.path}: {what} needs {offset + stride * (count - 1) + row} bytes of a bufferView of {len(data)}; "
                             "export it again")
        if not count:
            return np.zeros((0, *shape), kind)
        strides = (stride, column, size) if len(shape) == 2 else (stride, size)
        rows = np.ndarray((count, *shape[::-1]), kind, data, offset, strides)
        return np.swapaxes(rows, 1, 2) if len(shape) == 2 else rows

    def accessor(self, index: int, types: tuple[str, ...], normalize: bool = False) -> np.ndarray:
        """(count, n) or (count, n, n): integers as they are, normalized ones as float64 (3.6.2.2), with sparse entries in place.

        types: those allowed. normalize: integers are taken as normalized whether or not that is said, as for colours."""
        entry, what = self.get("accessors", index), f"accessor {index}"
        if entry.get("type") not in types or entry.get("componentType") not in TYPES:
            raise InputError(f"{self.path}: {what} is {entry.get('type')!r:.20} of {entry.get('componentType')!r:.20}; "
                             f"{' or '.join(types)} of a known component type is needed; export it again")
        kind, shape, count = TYPES[entry["componentType"]], SHAPES[entry["type"]], _count(entry["count"])
        if "bufferView" in entry:
            values = self._rows(entry["bufferView"], entry.get("byteOffset", 0), kind, shape, count, what)
        else:
            if "sparse" not in entry and count:
                compressed = [name for name in self.json.get("extensionsUsed", []) if "draco" in str(name) or "meshopt" in str(name)]
                raise InputError(f"{self.path}: {what} has no data" + (f"; the glTF extension {listed(compressed)} is not read; export it "
                                 "without compression" if compressed else "; export it again"))
            if count > MAX_EMPTY:
                raise InputError(f"{self.path}: {what} has {count} entries and no bufferView; at most {MAX_EMPTY} are allowed")
            values = np.zeros((count, *shape), kind)
        if "sparse" in entry:
            values = self._sparse(entry["sparse"], values.copy(), kind, shape, what)
        if kind[-2] == "f":
            return values.astype(np.float64)
        if entry.get("normalized") or normalize:
            return np.maximum(values.astype(np.float64) / np.iinfo(kind).max, -1.0)
        return values.astype(np.int64)

    def _sparse(self, sparse: dict, values: np.ndarray, kind: str, shape: tuple[int, ...], what: str) -> np.ndarray:
        count, where, new = _count(sparse["count"]), sparse["indices"], sparse["values"]
        if where.get("componentType") not in (5121, 5123, 5125):
            raise InputError(f"{self.path}: {what} has sparse indices of type {where.get('componentType')!r:.20}; export it again")
        rows = self._rows(where["bufferView"], where.get("byteOffset", 0), TYPES[where["componentType"]], (1,), count, what)[:, 0]
        if count and int(rows.max()) >= len(values):
            raise InputError(f"{self.path}: {what} has a sparse entry {int(rows.max())}, but there are {len(values)}; export it again")
        values[rows] = self._rows(new["bufferView"], new.get("byteOffset", 0), kind, shape, count, what)
        return values

    def picture(self, index: int) -> Picture:
        """The image of that number, one `Picture` for all textures that name it."""
        if index not in self._pictures:
            self._pictures[index] = self._picture(index)
        return self._pictures[index]

    def _picture(self, index: int) -> Picture:
        entry = self.get("images", index)
        uri, name = entry.get("uri"), str(entry.get("name") or f"image {index}")
        if "bufferView" in entry:
            return Picture(f"{name} (in {self.path.name})", self.view(entry["bufferView"])[0])
        if isinstance(uri, str) and uri[:5].lower() == "data:":
            return Picture(f"{name} (in {self.path.name})", self.contents(uri, name))
        return Picture(f"{uri!s:.200} (named in {self.path.name})", find_file(self.folder, uri) if isinstance(uri, str) else None)


def _count(value) -> int:
    if type(value) is not int and not (type(value) is float and value.is_integer()) or not 0 <= value <= 1 << 40:
        raise ValueError(f"{value!r:.20} where a count is needed")
    return int(value)


def _contents(path: Path, data: bytes) -> tuple[dict, bytes | None]:
    """The JSON and, of a .glb, the binary chunk (4.4). What follows the length that a .glb states is not looked at."""
    binary = None
    if data[:4] == b"glTF":
        if len(data) < 20:
            raise InputError(f"{path} is a truncated .glb; export it again")
        version, length = struct.unpack("<II", data[4:12])
        if version != 2:
            raise InputError(f"{path} is a .glb of version {version}; 2 is read; export it as glTF 2.0")
        chunks, at = [], 12
        while at + 8 <= min(len(data), max(length, 20)):
            size, kind = struct.unpack("<I4s", data[at:at + 8])
            if at + 8 + size > len(data):
                raise InputError(f"{path} is a truncated .glb: a chunk of {size} bytes begins at byte {at} of {len(data)}; export it again")
            chunks.append((kind, data[at + 8:at + 8 + size]))
            at += 8 + -(-size // 4) * 4
        if not chunks or chunks[0][0] != b"JSON":
            raise InputError(f"{path} is a malformed .glb: it does not begin with JSON; export it again")
        data, binary = chunks[0][1], next((chunk for kind, chunk in chunks[1:] if kind == b"BIN\0"), None)
    document = parse_json(data.rstrip(b"\0 \t\r\n\x1a"), path)
    if not isinstance(document, dict):
        raise InputError(f"{path} is not glTF: its JSON is no object; export it again")
    return document, binary
