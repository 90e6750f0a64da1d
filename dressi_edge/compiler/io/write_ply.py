"""PLY out: parts in, one binary file and its pictures. Vertices with several colours are split, after the last.

Textures go the way of scanners' programs: `texcoord` of each face's corners, v upwards, and a comment `TextureFile` for each picture.
"""
from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .images import linear_to_srgb, png_bytes, srgb_to_linear
from .materials import Part
from .mesh import origin_of
from .write_gltf import split


def encode_ply(parts: Sequence[Part], stem: str) -> dict[str, bytes]:
    """Files by name, the PLY last: all parts as one mesh. Colours (of 8 bits, sRGB) where a part without texture has or states one, white
    for the others; pictures times what their materials state."""
    files: dict[str, bytes] = {}
    textured = [part.mesh.texture is not None and part.mesh.uvs is not None for part in parts]
    colored = any(part.mesh.colors is not None or part.material.stated for part, t in zip(parts, textured) if not t)
    wide = origin_of(np.concatenate([part.mesh.positions for part in parts])).any()  # far from the origin fp32 has too few digits
    number = ("<f8", "double") if wide else ("<f4", "float")
    several = [("t", "<i4")] if len(parts) > 1 else []
    face_type = np.dtype([("n", "u1"), ("i", "<i4", 3)] + ([("m", "u1"), ("uv", "<f4", (3, 2)), *several] if any(textured) else []))
    vertices, faces, start = [], [], 0
    for k, part in enumerate(parts):
        mesh, factor = part.mesh, part.material.base_color[:3]
        own = mesh.color_faces if not textured[k] else None
        vertex, index, _ = split(mesh, [own] if own is not None else [])
        rows = np.zeros(len(vertex), np.dtype([("p", number[0], 3)] + ([("c", "u1", 3)] if colored else [])))
        rows["p"] = mesh.positions[vertex]
        if colored:
            colors = np.ones((len(vertex), 3))
            if own is not None:
                colors[index.reshape(-1)] = mesh.colors[own.reshape(-1)]
            elif mesh.colors is not None and not textured[k]:
                colors = mesh.colors
            rows["c"] = np.rint((colors if textured[k] else _times(colors, factor)) * 255.0)
        triangles = np.zeros(len(index), face_type)
        triangles["n"], triangles["i"] = 3, index + start
        if any(textured):
            triangles["m"] = 6
            if several:
                triangles["t"] = len(files) if textured[k] else -1
        if textured[k]:
            triangles["uv"] = mesh.uvs[mesh.uv_faces] * (1.0, -1.0) + (0.0, 1.0)
            files[f"{stem}_{k}.png" if several else f"{stem}.png"] = png_bytes(_times(mesh.texture, factor))
        vertices.append(rows)
        faces.append(triangles)
        start += len(vertex)
    lines = ["ply", "format binary_little_endian 1.0", "comment made by dressi_edge", *(f"comment TextureFile {name}" for name in files),
             f"element vertex {start}", *(f"property {number[1]} {axis}" for axis in "xyz"),
             *(f"property uchar {c}" for c in ("red", "green", "blue") if colored),
             f"element face {sum(map(len, faces))}", "property list uchar int vertex_indices",
             *(["property list uchar float texcoord"] if any(textured) else []),
             *(["property int texnumber"] if any(textured) and several else []), "end_header"]
    body = b"".join(rows.tobytes() for rows in (*vertices, *faces))
    return {**files, f"{stem}.ply": ("\n".join(lines) + "\n").encode() + body}


def _times(stored: np.ndarray, factor: tuple[float, ...]) -> np.ndarray:
    """sRGB values times a linear factor."""
    return stored if factor == (1.0, 1.0, 1.0) else linear_to_srgb(srgb_to_linear(stored) * factor)
