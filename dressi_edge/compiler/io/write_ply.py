"""PLY out: parts in, one binary file of positions, faces and colours. Vertices with several colours are split, after the last."""
from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .images import linear_to_srgb, srgb_to_linear
from .materials import Part
from .mesh import origin_of
from .write_gltf import split


def encode_ply(parts: Sequence[Part]) -> bytes:
    """All parts as one mesh; colours (of 8 bits, sRGB) where a part has or states one, white for the others."""
    colored = any(part.mesh.colors is not None or part.material.stated for part in parts)
    wide = origin_of(np.concatenate([part.mesh.positions for part in parts])).any()  # far from the origin fp32 has too few digits
    number = ("<f8", "double") if wide else ("<f4", "float")
    vertices, faces, start = [], [], 0
    for part in parts:
        mesh = part.mesh
        vertex, index, _ = split(mesh, [mesh.color_faces] if mesh.color_faces is not None else [])
        rows = np.zeros(len(vertex), np.dtype([("p", number[0], 3)] + ([("c", "u1", 3)] if colored else [])))
        rows["p"] = mesh.positions[vertex]
        if colored:
            colors = np.ones((len(vertex), 3))
            if mesh.color_faces is not None:
                colors[index.reshape(-1)] = mesh.colors[mesh.color_faces.reshape(-1)]
            elif mesh.colors is not None:
                colors = mesh.colors
            rows["c"] = np.rint(linear_to_srgb(srgb_to_linear(colors) * part.material.base_color[:3]) * 255.0)
        triangles = np.zeros(len(index), np.dtype([("n", "u1"), ("i", "<i4", 3)]))
        triangles["n"], triangles["i"] = 3, index + start
        vertices.append(rows.tobytes())
        faces.append(triangles.tobytes())
        start += len(vertex)
    header = ["ply", "format binary_little_endian 1.0", "comment made by dressi_edge", f"element vertex {start}",
              *(f"property {number[1]} {axis}" for axis in "xyz"), *(f"property uchar {c}" for c in ("red", "green", "blue") if colored),
              f"element face {sum(len(data) // 13 for data in faces)}", "property list uchar int vertex_indices", "end_header"]
    return ("\n".join(header) + "\n").encode() + b"".join(vertices) + b"".join(faces)
