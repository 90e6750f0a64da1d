"""OBJ out: parts in, the bytes of the .obj, of its .mtl and of its pictures, by file name.

Vertices, uvs and normals have lists of their own, so nothing is split but vertices with several colours, which follow after the last.
"""
from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...cache.errors import note
from .images import linear_to_srgb, png_bytes
from .materials import Part
from .mesh import origin_of
from .write_gltf import split


def encode_obj(parts: Sequence[Part], stem: str) -> dict[str, bytes]:
    """Files by name, the OBJ last; a material file only where a part has a texture or states a colour."""
    files: dict[str, bytes] = {}
    materials: list[str] = []
    lines: list[str] = []
    starts = np.zeros(3, np.int64)
    for k, part in enumerate(parts):
        mesh, own = part.mesh, f"{stem}_{k}" if len(parts) > 1 else stem
        textured = mesh.texture is not None and mesh.uvs is not None
        name = f"{part.material.name or part.name}_{k}" if len(parts) > 1 else part.material.name or "surface"
        name = "_".join(name.split()) or "surface"
        if textured or part.material.stated:
            materials += _material(part, name, own, textured, files)
        if len(parts) > 1:
            lines.append(f"o {part.name or k}")
        vertex, faces, _ = split(mesh, [mesh.color_faces] if mesh.color_faces is not None else [])
        rows = mesh.positions[vertex]
        if mesh.colors is not None:
            colors = mesh.colors
            if mesh.color_faces is not None:
                colors = np.ones((len(vertex), 3))
                colors[faces.reshape(-1)] = mesh.colors[mesh.color_faces.reshape(-1)]
            rows = np.concatenate([rows, colors], axis=1)
        digits = 15 if origin_of(mesh.positions).any() else 9  # of fp64 or fp32
        lines += ["v " + " ".join(f"{x:.{digits}g}" for x in row) for row in rows.tolist()]
        columns = [faces + 1 + starts[0]]
        form = "{}"
        if mesh.uvs is not None:
            lines += [f"vt {u:.9g} {1.0 - v:.9g}" for u, v in mesh.uvs.tolist()]  # OBJ counts v upwards
            columns.append(mesh.uv_faces + 1 + starts[1])
            form += "/{}"
        if mesh.normals is not None:
            lines += ["vn " + " ".join(f"{x:.9g}" for x in row) for row in mesh.normals.tolist()]
            columns.append(mesh.normal_faces + 1 + starts[2])
            form += "/{}" if mesh.uvs is not None else "//{}"
        if textured or part.material.stated:
            lines.append(f"usemtl {name}")
        three = " ".join([form] * 3)
        lines += [f"f {three}".format(*row) for row in np.stack(columns, axis=-1).reshape(len(faces), -1).tolist()]
        starts += (len(rows), 0 if mesh.uvs is None else len(mesh.uvs), 0 if mesh.normals is None else len(mesh.normals))
    if materials:
        files[f"{stem}.mtl"] = ("\n".join(materials) + "\n").encode()
        lines.insert(0, f"mtllib {stem}.mtl")
    return {**files, f"{stem}.obj": ("\n".join(lines) + "\n").encode()}


def _material(part: Part, name: str, own: str, textured: bool, files: dict[str, bytes]) -> list[str]:
    """Lines of the material; its pictures go to `files`."""
    m = part.material
    color = " ".join(f"{x:.6g}" for x in linear_to_srgb(np.array(m.base_color[:3])))
    lines = [f"newmtl {name}", "Ka 0 0 0", f"Kd {color}", "Ks 0 0 0", "illum 1"]
    if m.base_color[3] < 1.0:
        lines.append(f"d {m.base_color[3]:.6g}")
    if any(m.emissive):
        lines.append("Ke " + " ".join(f"{x:.6g}" for x in linear_to_srgb(np.clip(m.emissive, 0.0, 1.0))))
    if m.stated:
        lines += [f"Pr {m.roughness:.6g}", f"Pm {m.metallic:.6g}"]
    pictures = [("map_Kd", own, part.mesh.texture)] if textured else []
    pictures += [(key, f"{own}_{kind}", found.picture.texels()) for key, kind, found in
                 (("map_Ke", "emissive", m.emissive_texture), ("norm", "normal", m.normal_texture)) if found is not None]
    wrap = m.base_texture.wrap if m.base_texture else (part.mesh.wrap,) * 2
    if textured and wrap not in (("repeat",) * 2, ("clamp",) * 2):
        note(f"{name}: its texture goes on as {' '.join(wrap)}, but OBJ knows repeat or clamp, alike for u and v; repeat is written")
    for key, stem, texels in pictures:
        files[f"{stem}.png"] = png_bytes(texels)
        clamp = "-clamp on " if key == "map_Kd" and wrap == ("clamp",) * 2 else ""
        lines.append(f"{key} {clamp}{stem}.png")
    return lines
