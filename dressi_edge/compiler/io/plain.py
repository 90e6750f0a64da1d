"""STL and OFF: formats of positions and faces, text or (STL) binary; OFF with colours."""
from __future__ import annotations

import re
import struct
from pathlib import Path

import numpy as np

from ...cache.errors import InputError, note
from .pieces import Piece, Pieces, decoded, numbers, unit_colors
from .polygons import triangulated


def read_stl(path: Path, data: bytes) -> Pieces:
    """The one piece of an STL file: three vertices a face. Binary where the size fits its count, whatever the header begins with."""
    count = struct.unpack("<I", data[80:84])[0] if len(data) >= 84 else 0
    text = data[:256].removeprefix(b"\xef\xbb\xbf").lstrip()[:5].lower() == b"solid"
    if len(data) >= 84 and (84 + 50 * count == len(data) or not text and 84 + 50 * count <= len(data)):
        rows = np.frombuffer(data, np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")]), count, 84)
        if rows["more"].any():
            note(f"{path}: the two bytes after each face, in which some programs put colours, are not read")
        positions = rows["corners"].reshape(-1, 3).astype(np.float64)
    elif text:
        found = re.findall(r"(?im)^\s*vertex\s+(\S+)\s+(\S+)\s+(\S+)", decoded(data))
        positions = numbers([word for row in found for word in row], str(path)).reshape(-1, 3)
        positions = positions[:len(positions) // 3 * 3]
    else:
        raise InputError(f"mesh file {path} cannot be read: it says {count} faces, which take {84 + 50 * count} bytes, and has "
                         f"{len(data)}; it is truncated")
    faces = np.arange(len(positions)).reshape(-1, 3)
    return Pieces(positions, (Piece("", faces),) if len(faces) else ())


def read_off(path: Path, data: bytes) -> Pieces:
    """The one piece of an OFF, COFF, NOFF, STOFF or CNOFF file; colours of vertices, or else of faces. Raises InputError."""
    lines = [words for line in re.split(r"\r\n|\n|\r", decoded(data)) if (words := line.partition("#")[0].strip(" \t\0\x1a").split())]
    head = re.fullmatch(r"(ST)?(C)?(N)?(4)?(n)?OFF", lines[0][0]) if lines else None
    if head:
        if lines[0][1:2] == ["BINARY"] or head[4] or head[5]:
            raise InputError(f"mesh file {path} cannot be read: {' '.join(lines[0])} is not supported; convert it to OFF as text")
        lines = ([lines[0][1:]] if lines[0][1:] else []) + lines[1:]
    where = f"mesh file {path} cannot be read"
    counts = numbers(lines[0][:2] if lines else [], where)
    if len(counts) != 2 or not ((counts >= 0) & (counts == np.floor(counts))).all():
        raise InputError(f"{where}: it has no counts of vertices and faces; repair or convert it")
    vertex_count, face_count = (int(min(x, 1 << 62)) for x in counts)
    rows, faces = lines[1:1 + vertex_count], lines[1 + vertex_count:1 + vertex_count + face_count]
    if len(rows) < vertex_count or len(faces) < face_count:
        raise InputError(f"{where}: it says {vertex_count} vertices and {face_count} faces, and has {max(0, len(lines) - 1)} lines of "
                         "them; it is truncated")
    if short := [k for k, row in enumerate(rows) if len(row) < 3]:
        raise InputError(f"{where}: vertex {short[0]} has {len(rows[short[0]])} numbers; 3 are needed")
    positions = numbers([word for row in rows for word in row[:3]], where).reshape(-1, 3)
    texture, colored, normal = (bool(head and head[k]) for k in (1, 2, 3))
    at = 3 + 3 * normal
    normals = colors = None
    width = min((len(row) for row in rows), default=0)
    if normal and width >= 6:
        normals = np.nan_to_num(numbers([word for row in rows for word in row[3:6]], where).reshape(-1, 3))
    if colored and width >= at + 3:
        colors = unit_colors(numbers([word for row in rows for word in row[at:at + 3]], where).reshape(-1, 3), str(path))
    uvs = None
    if texture and width >= at + 2 + 3 * colored:
        uvs = numbers([word for row in rows for word in row[-2:]], where).reshape(-1, 2) * (1.0, -1.0) + (0.0, 1.0)
    sizes = np.clip(np.nan_to_num(numbers([row[0] for row in faces], where)), 0, [len(row) for row in faces]).astype(int).tolist()
    corners = numbers([word for row, n in zip(faces, sizes) for word in row[1:1 + n]], where)
    starts = np.concatenate([[0], np.cumsum([len(row[1:1 + n]) for row, n in zip(faces, sizes)])]).astype(np.int64)
    if (bad := ~((corners >= 0) & (corners < vertex_count) & (corners == np.floor(corners)))).any():
        face = int(np.searchsorted(starts, int(np.argmax(bad)), "right")) - 1
        found = ", ".join(f"{x:g}" for x in corners[starts[face]:starts[face + 1]][:6])
        raise InputError(f"{path}: faces[{face}] is [{found}], but there are {vertex_count} "
                         f"vertices, 0 to {vertex_count - 1}; repair or drop that face")
    corners = corners.astype(np.int64)
    places, owner = triangulated(positions, starts, corners)
    triangles = corners[places]
    behind = [row[1 + n:] for row, n in zip(faces, sizes)]
    painted = None if colors is None else (colors, triangles)
    if painted is None and len(triangles) and all(len(row) in (3, 4) for row in behind):
        painted = (unit_colors(numbers([word for row in behind for word in row[:3]], where).reshape(-1, 3), str(path)),
                   np.repeat(owner[:, None], 3, axis=1))
    piece = Piece("", triangles, uvs={} if uvs is None else {0: (uvs, triangles)}, colors=painted,
                  normals=None if normals is None else (normals, triangles))
    return Pieces(positions, (piece,) if len(triangles) else ())
