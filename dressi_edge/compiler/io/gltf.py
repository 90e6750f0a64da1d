"""Scenes of glTF 2.0: nodes, meshes, skins and morph targets of the default scene in; `Pieces` in world space out.

Skinned meshes stand as their joints do in the file, morph targets count by the file's weights. COLOR_0 is linear in glTF and sRGB encoded
here. What is not read (points, lines, animations, other scenes) is named in warnings; extensions: `gltf_file.READ`.
"""
from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ...cache.errors import InputError, note
from .gltf_file import Document
from .gltf_material import material_of
from .images import linear_to_srgb
from .pieces import Piece, Pieces, listed
from .ply import strip_faces
from .text import read_bytes

MAX_CORNERS = 1 << 27  # of faces and vertices of all instances together
MODES = {0: "points", 1: "lines", 2: "lines", 3: "lines"}
TRIANGLES, STRIP, FAN = 4, 5, 6
ATTRIBUTES = ("POSITION", "NORMAL", "TANGENT", "TEXCOORD", "JOINTS", "WEIGHTS")


def read_gltf(path: Path, data: bytes) -> Pieces:
    """The pieces of a glTF file, one for each primitive of each node of its default scene. Raises InputError, naming the file."""
    return _well_formed(path, lambda: _Scene(Document(path, data)).pieces())


def placed_nodes(path: Path) -> tuple[Document, list[tuple[int, dict, np.ndarray]]]:
    """The document of a glTF file, and the nodes of its default scene with their numbers and world matrices, in order. Raises InputError,
    naming the file."""
    def read() -> tuple:
        scene = _Scene(Document(path, read_bytes(path, "glTF file")))
        return scene.document, [(k, scene.nodes[k], scene.world[k]) for k in scene.drawn]

    return _well_formed(path, read)


def _well_formed(path: Path, read: Callable):
    """What `read` gives; what Python raises at malformed files becomes an InputError."""
    try:
        with np.errstate(all="ignore"):
            return read()
    except InputError:
        raise
    except (KeyError, IndexError, TypeError, AttributeError, ValueError, OverflowError, RecursionError, struct.error) as error:
        what = f"no {error}" if isinstance(error, KeyError) else str(error) or type(error).__name__
        raise InputError(f"{path} is not well-formed glTF ({what:.120}); export it again") from None
    except OSError as error:
        raise InputError(f"{path}: a file that it names cannot be read: {error.strerror or error}; check it") from None


class _Scene:
    """A document's nodes in their places, and what of it was left out."""

    def __init__(self, document: Document):
        self.document, self.path = document, document.path
        self.nodes = document.list("nodes")
        self.left_out: dict[str, None] = {}
        self.positions: list[np.ndarray] = []
        self.count = self.corners = 0
        self._place()
        if document.list("animations"):
            self.left_out["animations"] = None

    def _place(self) -> None:
        """World matrices of all nodes, and which are in the default scene. Raises InputError where nodes are no tree."""
        children = [node.get("children", []) for node in self.nodes]
        parent: dict[int, int] = {}
        for k, below in enumerate(children):
            for child in below:
                self.document.get("nodes", child)
                if child in parent:
                    raise InputError(f"{self.path} node {child} is reached twice; glTF nodes must form a tree")
                parent[child] = k
        self.world: dict[int, np.ndarray] = {}
        stack = [(k, np.eye(4)) for k in range(len(self.nodes)) if k not in parent]
        while stack:
            k, above = stack.pop()
            self.world[k] = above @ node_matrix(self.nodes[k], f"{self.path} node {k}")
            stack += [(child, self.world[k]) for child in children[k]]
        if len(self.world) < len(self.nodes):
            raise InputError(f"{self.path} has nodes in a ring; glTF nodes must form a tree")
        scenes, roots = self.document.list("scenes"), [k for k in range(len(self.nodes)) if k not in parent]
        if scenes:
            if "scene" not in self.document.json and len(scenes) > 1:
                note(f"{self.path} has {len(scenes)} scenes and says of none that it is the default; the first is read")
            chosen = self.document.json.get("scene", 0)
            roots = self.document.get("scenes", chosen).get("nodes", [])
            for root in roots:
                self.document.get("nodes", root)
        self.drawn, seen, stack = [], set(), list(reversed(roots))
        while stack:
            k = stack.pop()
            if k in seen:
                raise InputError(f"{self.path} node {k} is reached twice; glTF nodes must form a tree")
            seen.add(k)
            self.drawn.append(k)
            stack += reversed(children[k])
        hidden = [k for k in set(self.world) - seen if "mesh" in self.nodes[k]]
        if hidden:
            note(f"{self.path}: {len(hidden)} nodes with meshes are in other scenes than the default, and not read")

    def pieces(self) -> Pieces:
        """All pieces of the default scene; of a file without nodes, those of its meshes."""
        out: list[Piece] = []
        if not self.nodes:
            for mesh in range(len(self.document.list("meshes"))):
                out += self._mesh(mesh, {}, np.eye(4))
        for k in self.drawn:
            node = self.nodes[k]
            if "mesh" in node:
                for matrix in self._instances(k):
                    out += self._mesh(node["mesh"], node, matrix)
        if self.left_out:
            note(f"{self.path}: {listed(self.left_out, 8)} are not read")
        return Pieces(np.concatenate([np.zeros((0, 3)), *self.positions]), tuple(out))

    def _instances(self, k: int) -> list[np.ndarray]:
        """Where the node's mesh stands: once, or as EXT_mesh_gpu_instancing says."""
        found = self.nodes[k].get("extensions", {}).get("EXT_mesh_gpu_instancing")
        if found is None:
            return [self.world[k]]
        arrays = {key.lower(): self.document.accessor(index, (kind,)) for key, kind in
                  (("TRANSLATION", "VEC3"), ("ROTATION", "VEC4"), ("SCALE", "VEC3")) if (index := found["attributes"].get(key)) is not None}
        counts = {len(array) for array in arrays.values()}
        if len(counts) != 1:
            raise InputError(f"{self.path} node {k} has instances of {len(counts)} different counts; export it again")
        return [self.world[k] @ node_matrix({key: array[i].tolist() for key, array in arrays.items()}, f"{self.path} node {k}")
                for i in range(counts.pop())]

    def _mesh(self, index: int, node: dict, matrix: np.ndarray) -> list[Piece]:
        mesh, pieces, ranges = self.document.get("meshes", index), [], {}
        name = str(node.get("name") or mesh.get("name") or f"mesh {index}")
        primitives = mesh["primitives"]
        for number, primitive in enumerate(primitives):
            mode = primitive.get("mode", TRIANGLES)
            if mode in MODES:
                self.left_out[MODES[mode]] = None
                continue
            if type(mode) is not int or not TRIANGLES <= mode <= FAN:
                raise InputError(f"{self.path} mesh {index} primitive {number} has mode {mode!r:.20}; 0 to 6 are known; export it again")
            where = f"{self.path} mesh {index} primitive {number}"
            own = f"{name} {number}" if len(primitives) > 1 else name
            pieces += self._primitive(primitive, mode, own, node, mesh, matrix, ranges, where)
        return pieces

    def _primitive(self, primitive: dict, mode: int, name: str, node: dict, mesh: dict, matrix: np.ndarray, ranges: dict,
                   where: str) -> list[Piece]:
        read, attributes = self.document.accessor, primitive["attributes"]
        if "POSITION" not in attributes:
            self.left_out["primitives without POSITION"] = None
            return []
        if "KHR_draco_mesh_compression" in primitive.get("extensions", {}) and \
                "bufferView" not in self.document.get("accessors", attributes["POSITION"]):
            raise InputError(f"{where} needs the glTF extension KHR_draco_mesh_compression, which is not read; export it without "
                             "compression")
        unread = [key for key in attributes if key.partition("_")[0] not in ATTRIBUTES and key != "COLOR_0"]
        self.left_out |= dict.fromkeys(f"attributes {key}" for key in unread)
        local = read(attributes["POSITION"], ("VEC3",)).astype(np.float64)
        count = len(local)

        def attribute(key: str, types: tuple[str, ...], normalize: bool = False) -> np.ndarray | None:
            if key not in attributes:
                return None
            values = read(attributes[key], types, normalize).astype(np.float64)
            if len(values) != count:
                raise InputError(f"{where} has {len(values)} values of {key} for {count} vertices; export it again")
            return values

        normals = attribute("NORMAL", ("VEC3",))
        local, normals = self._morphed(primitive, node, mesh, local, normals, where)
        matrices = self._skinned(node, attribute, where)
        if matrices is None:
            world, flip = local @ matrix[:3, :3].T + matrix[:3, 3], np.linalg.det(matrix[:3, :3]) < 0.0
            normals = None if normals is None else normals @ _cofactors(matrix[None])[0].T
        else:
            world, flip = np.einsum("nij,nj->ni", matrices[:, :3, :3], local) + matrices[:, :3, 3], False
            flip = bool(count) and np.median(np.linalg.det(matrices[:, :3, :3])) < 0.0
            normals = None if normals is None else np.einsum("nij,nj->ni", _cofactors(matrices), normals)
        key = (attributes["POSITION"], attributes.get("JOINTS_0"), attributes.get("WEIGHTS_0"), str(primitive.get("targets")))
        if key not in ranges:
            ranges[key] = self.count
            self.positions.append(world)
            self.count += count
        first = ranges[key]
        index = np.arange(count) if "indices" not in primitive else read(primitive["indices"], ("SCALAR",))[:, 0].astype(np.int64)
        if len(index) and (index.max() >= count or index.min() < 0):
            raise InputError(f"{where} names vertex {int(index.max())}, but there are {count}, 0 to {count - 1}; export it again")
        self.corners += len(index) * (1 if mode == TRIANGLES else 3) + count
        if self.corners > MAX_CORNERS:
            raise InputError(f"{self.path} has more than {MAX_CORNERS} corners of faces, all instances counted; as many are allowed; "
                             "load its parts from files of their own")
        faces = _faces(index, mode)
        faces = faces[:, ::-1] if flip else faces  # a mirror turns faces inside out
        colors = attribute("COLOR_0", ("VEC3", "VEC4"), True)
        if colors is not None:
            if not ((colors >= 0.0) & (colors <= 1.0)).all():
                note(f"{where}: COLOR_0 from {colors.min():g} to {colors.max():g}; it is clipped to 0 to 1")
            colors = (linear_to_srgb(np.clip(np.nan_to_num(colors[:, :3]), 0.0, 1.0)), faces)
        sets = [key for key in attributes if key.startswith("TEXCOORD_") and key[9:].isdecimal()]
        uvs = {int(key[9:]): (attribute(key, ("VEC2",)), faces) for key in sets}
        flat = np.zeros((1, 3)), np.zeros_like(faces)  # without normals a surface is flat (3.7.2.1)
        return [Piece(name, faces + first, material_of(self.document, primitive.get("material")), uvs, colors,
                      flat if normals is None else (np.nan_to_num(normals), faces), (first, first + count))]

    def _morphed(self, primitive: dict, node: dict, mesh: dict, positions: np.ndarray, normals: np.ndarray | None, where: str):
        """Positions and normals with morph targets by the file's weights (3.7.2.2)."""
        targets = primitive.get("targets", [])
        if not targets:
            return positions, normals
        names = mesh.get("extras", {}).get("targetNames", []) if isinstance(mesh.get("extras", {}), dict) else []
        weights = node.get("weights", mesh.get("weights", [0.0] * len(targets)))
        self.left_out[f"morph targets ({listed(names) or len(targets)}) beyond the weights that the file gives them"] = None
        for target, weight in zip(targets, weights):
            for key, base in (("POSITION", positions), ("NORMAL", normals)):
                if key in target and base is not None and weight:
                    moved = self.document.accessor(target[key], ("VEC3",))
                    if len(moved) != len(base):
                        raise InputError(f"{where} has a morph target of {len(moved)} vertices for {len(base)}; export it again")
                    base += float(weight) * moved
        return positions, normals

    def _skinned(self, node: dict, attribute, where: str) -> np.ndarray | None:
        """The world matrix (n, 4, 4) of each vertex of a skinned mesh (3.7.3.1); None without a skin."""
        if "skin" not in node:
            return None
        joints, weights = ([found for k in range(8) if (found := attribute(f"{key}_{k}", ("VEC4",))) is not None]
                           for key in ("JOINTS", "WEIGHTS"))
        if not joints or len(joints) != len(weights):
            raise InputError(f"{where} is skinned and has {len(joints)} JOINTS for {len(weights)} WEIGHTS; export it again")
        skin = self.document.get("skins", node["skin"])
        for joint in skin["joints"]:
            self.document.get("nodes", joint)
        stands = np.stack([self.world[joint] for joint in skin["joints"]])
        if "inverseBindMatrices" in skin:
            bind = self.document.accessor(skin["inverseBindMatrices"], ("MAT4",)).astype(np.float64)
            stands = stands @ bind[:len(stands)]
        which, weight = np.concatenate(joints, 1).astype(np.int64), np.concatenate(weights, 1)
        if len(which) and (which.max() >= len(stands) or which.min() < 0):
            raise InputError(f"{where} names joint {int(which.max())}, but its skin has {len(stands)}; export it again")
        total = weight.sum(axis=1, keepdims=True)
        weight = np.where(total > 0.0, weight / np.where(total > 0.0, total, 1.0), [1.0] + [0.0] * (weight.shape[1] - 1))
        return sum(weight[:, k, None, None] * stands[which[:, k]] for k in range(which.shape[1]))


def _faces(index: np.ndarray, mode: int) -> np.ndarray:
    """Triangles (F, 3) of an index list; corners that are too few for one more are left."""
    if mode == STRIP:
        return strip_faces(index, np.array([0, len(index)]))
    if mode == FAN:
        return np.stack([index[1:-1], index[2:], np.broadcast_to(index[:1], max(0, len(index) - 2))], axis=-1)
    return index[:len(index) // 3 * 3].reshape(-1, 3)


def _cofactors(matrices: np.ndarray) -> np.ndarray:
    """What turns normals (n, 3, 3): the inverse transpose times |determinant|, which a flat matrix has too."""
    a, b, c = (matrices[:, :3, k] for k in range(3))
    cofactors = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=-1)
    return cofactors * np.where(np.linalg.det(matrices[:, :3, :3]) < 0.0, -1.0, 1.0)[:, None, None]


def node_matrix(node: dict, where: str) -> np.ndarray:
    """The 4 x 4 of a node's matrix, or of its translation, rotation (a quaternion x, y, z, w) and scale."""
    given = {key: np.array(node.get(key, default), np.float64) for key, default in
             (("matrix", np.eye(4).reshape(-1)), ("translation", (0, 0, 0)), ("rotation", (0, 0, 0, 1)), ("scale", (1, 1, 1)))}
    for key, size in (("matrix", 16), ("translation", 3), ("rotation", 4), ("scale", 3)):
        if given[key].shape != (size,) or not np.isfinite(given[key]).all():
            raise InputError(f"{where} has a {key} of {node.get(key)!r:.60}; {size} numbers are needed; export it again")
    if "matrix" in node:
        return given["matrix"].reshape(4, 4).T  # stored by columns
    x, y, z, w = given["rotation"] / (np.linalg.norm(given["rotation"]) or 1.0)
    matrix = np.eye(4)
    matrix[:3, :3] = np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                               [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                               [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]]) * given["scale"]
    matrix[:3, 3] = given["translation"]
    return matrix
