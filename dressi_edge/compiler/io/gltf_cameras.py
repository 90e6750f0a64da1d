"""Cameras of a glTF scene: a .gltf or .glb file in; `Camera`s out."""
from __future__ import annotations

import math
import struct
from pathlib import Path

import numpy as np

from ...cache.errors import InputError, note
from .cameras import KINDS, Camera, check_rigid, focal, inverse_rigid, rotation_matrix
from .text import is_file, parse_json, read_bytes, shown


def gltf_cameras(path: str | Path, width: int, height: int) -> tuple[tuple[Camera, ...], tuple[str, ...]]:
    """Cameras of a .gltf or .glb file for width x height images, in order of the scene's nodes, and the nodes' names.

    Pixels are square; yfov, or twice ymag, spans the height. Scale above a camera is ignored, as glTF says. A missing zfar is 1000 znear.
    """
    path = Path(path)
    document = _gltf(path)
    where, found, names, odd = shown(path), [], [], []
    try:
        nodes = document.get("nodes", [])
        roots = sorted(set(range(len(nodes))) - {child for node in nodes for child in node.get("children", [])})
        if document.get("scenes"):
            roots = _at(document["scenes"], document.get("scene", 0)).get("nodes", [])
        stack = [(root, np.eye(4)) for root in reversed(roots)]
        seen: set[int] = set()
        while stack:
            index, parent = stack.pop()
            node = _at(nodes, index)
            if index in seen:
                raise InputError(f"{where} node {index} is reached twice; glTF nodes must form a tree")
            seen.add(index)
            with np.errstate(invalid="ignore", over="ignore"):  # `check_rigid` names what comes of it
                world = parent @ _node_matrix(node)
            stack += [(child, world) for child in reversed(node.get("children", []))]
            if "camera" in node:
                names.append(str(node.get("name", "camera")))
                camera = _at(document["cameras"], node["camera"])
                found.append(_gltf_camera(camera, world, width, height, f"{where} node {index} ({shown(names[-1], 40)})", odd))
    except (KeyError, IndexError, TypeError, AttributeError, ValueError, OverflowError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{where} is not well-formed glTF ({type(error).__name__}: {shown(error)}); export it again") from None
    if not found:
        raise InputError(f"{where} has no camera in its scene; export it with cameras")
    if odd:
        note(odd[0] + (f"; so it is with {len(odd) - 1} more" if len(odd) > 1 else ""))
    return tuple(found), tuple(names)


def has_cameras(path: str | Path) -> bool:
    """Whether the file has any. Raises InputError."""
    found = _gltf(Path(path)).get("cameras")
    return isinstance(found, list) and bool(found)


def _at(items: list, index: int):
    """items[index], for an index that counts from the front."""
    if not isinstance(index, int) or index < 0:
        raise IndexError(f"index {index!r:.20}")
    return items[index]


def _gltf(path: Path) -> dict:
    if not is_file(path):
        raise InputError(f"glTF file {shown(path)} does not exist; check the path")
    data = read_bytes(path, "glTF file")
    if data[:4] == b"glTF":  # binary: a header of 12 bytes, then the chunk "JSON" (glTF 2.0 section 4.4)
        length, kind = struct.unpack("<I4s", data[12:20]) if len(data) >= 20 else (0, b"")
        if kind != b"JSON" or len(data) < 20 + length:
            raise InputError(f"{shown(path)} is a truncated or malformed .glb; export it again")
        data = data[20:20 + length]
    document = parse_json(data, path)
    if not isinstance(document, dict):
        raise InputError(f"{shown(path)} is not glTF: its JSON is no object; export it again")
    return document


def _node_matrix(node: dict) -> np.ndarray:
    if "matrix" in node:
        return np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T  # stored by columns
    matrix = np.eye(4)
    x, y, z, w = np.array(node.get("rotation", (0.0, 0.0, 0.0, 1.0)), dtype=np.float64)
    half = math.sqrt(x * x + y * y + z * z)
    turn = 2.0 * math.atan2(half, w)
    matrix[:3, :3] = rotation_matrix(np.array([x, y, z]) * (turn / half if half else 0.0)) * node.get("scale", (1.0, 1.0, 1.0))
    matrix[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return matrix


def _gltf_camera(camera: dict, world: np.ndarray, width: int, height: int, where: str, odd: list[str]) -> Camera:
    """The camera; what is odd about it goes into the list."""
    kind = camera.get("type")
    if kind not in KINDS:
        raise InputError(f"{where} is a camera of type {kind!r:.40}; {' and '.join(KINDS)} cameras are supported")
    lens = camera[kind]
    pose = world.copy()
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        pose[:3, :3] /= np.linalg.norm(pose[:3, :3], axis=0)
    pose = check_rigid(pose, f"{where} world transform")
    near = lens["znear"]
    if kind == "orthographic":
        far, across, up = lens["zfar"], abs(lens["xmag"]), abs(lens["ymag"])
        if not up > 0:
            raise InputError(f"{where} has the ymag {lens['ymag']!r:.40}; a number other than 0 is needed")
        length, aspect, taken = height / (2.0 * up), across / up, "ymag"
    else:
        length, far = focal(math.degrees(lens["yfov"]), height), lens.get("zfar", 1000.0 * near)
        aspect, taken = lens.get("aspectRatio", width / height), "yfov"
    if abs(aspect * height - width) > 1.0:
        odd.append(f"{where} has the aspect ratio {aspect:g}, but the pictures are {width}x{height}; {taken} is taken, and pixels as "
                   "square")
    return Camera(inverse_rigid(pose), length, length, width / 2.0, height / 2.0, width, height, near, far, kind)
