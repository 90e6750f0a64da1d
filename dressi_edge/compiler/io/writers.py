"""Results to files: meshes, images, contact sheets, loss curves and JSON.

Every file appears whole or not at all.
"""

from __future__ import annotations

import io
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image, ImageDraw, ImageFont

from ...cache.errors import InputError
from ...cache.files import replace_file
from .meshes import Mesh

MESH_SUFFIXES = (".glb", ".gltf", ".obj", ".ply")
BACKGROUND = 0.85  # light grey below transparent images, so that white and black both show
COLORS = ("#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#ff7f0e", "#17becf", "#8c564b", "#e377c2")


def write_bytes(path: str | Path, data: bytes) -> None:
    """Replaces `path` by `data` in one step; on an error (disk full) the old file stays. Raises InputError."""
    path = Path(path)
    if not path.parent.is_dir():
        raise InputError(f"cannot write {path}: directory {path.parent} does not exist; create it first")
    try:
        replace_file(path, data)
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror or error}; what was there is unchanged; "
                         "free space or choose another path") from error


def save_json(path: str | Path, value: Mapping) -> None:
    """A JSON object with sorted keys. Raises InputError for NaN and infinity, which JSON does not have."""
    try:
        text = json.dumps(value, sort_keys=True, indent=1, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InputError(f"cannot write {path}: {error}; JSON takes finite numbers, text, lists and dicts") from None
    write_bytes(path, text.encode() + b"\n")


def save_mesh(path: str | Path, mesh: Mesh) -> None:
    """Writes .glb or .gltf (texture embedded, vertices split at uv seams), .obj (with .mtl and .png beside it when there is a
    texture) or .ply (positions, faces and colours; no uvs). glTF holds the texture or, without one, the colours."""
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in MESH_SUFFIXES:
        raise InputError(f"cannot write mesh {path}: extension {suffix or 'none'} is unknown; "
                         f"known are {', '.join(MESH_SUFFIXES)}")
    if suffix == ".obj":
        if mesh.texture is not None and mesh.uvs is not None:  # what the OBJ names is there before it
            save_png(path.with_suffix(".png"), mesh.texture)
            write_bytes(path.with_suffix(".mtl"),
                        f"newmtl surface\nKa 0 0 0\nKd 1 1 1\nKs 0 0 0\nillum 1\nmap_Kd {path.stem}.png\n".encode())
        write_bytes(path, _obj(mesh, path.stem).encode())
    elif suffix == ".ply":
        out = trimesh.Trimesh(mesh.positions, mesh.faces, process=False, vertex_colors=_byte_colors(mesh))
        write_bytes(path, out.export(file_type="ply"))
    elif suffix == ".glb":
        write_bytes(path, _split(mesh).export(file_type="glb"))
    else:
        files = trimesh.exchange.gltf.export_gltf(_split(mesh).scene(), embed_buffers=True, merge_buffers=True)
        write_bytes(path, files["model.gltf"])


def _byte_colors(mesh: Mesh) -> np.ndarray | None:
    return None if mesh.colors is None else np.rint(mesh.colors * 255.0).astype(np.uint8)


def _obj(mesh: Mesh, stem: str) -> str:
    lines = [f"mtllib {stem}.mtl"] if mesh.texture is not None and mesh.uvs is not None else []
    rows = mesh.positions if mesh.colors is None else np.concatenate([mesh.positions, mesh.colors], axis=1)
    lines += ["v " + " ".join(f"{x:.9g}" for x in row) for row in rows.tolist()]
    if mesh.uvs is None:
        lines += [f"f {a} {b} {c}" for a, b, c in (mesh.faces + 1).tolist()]
        return "\n".join(lines) + "\n"
    lines += [f"vt {u:.9g} {1.0 - v:.9g}" for u, v in mesh.uvs.tolist()]  # OBJ counts v upwards
    lines += ["usemtl surface"] if mesh.texture is not None else []
    corners = np.stack([mesh.faces, mesh.uv_faces], axis=-1).reshape(-1, 6) + 1
    lines += ["f {}/{} {}/{} {}/{}".format(*row) for row in corners.tolist()]
    return "\n".join(lines) + "\n"


def _split(mesh: Mesh) -> trimesh.Trimesh:
    """One vertex for each (position, uv) pair, with the smooth normals of the unsplit mesh, so that seams do not show."""
    corners = mesh.positions[mesh.faces]
    face_normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(mesh.positions)
    np.add.at(normals, mesh.faces.reshape(-1), np.repeat(face_normals, 3, axis=0))  # weighted by area
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.where(length > 0.0, normals / np.maximum(length, 1e-300), (0.0, 0.0, 1.0))
    if mesh.uvs is None:
        colors = _byte_colors(mesh)
        return trimesh.Trimesh(mesh.positions, mesh.faces, vertex_normals=normals, process=False, vertex_colors=colors)
    pairs, index = np.unique(np.stack([mesh.faces.reshape(-1), mesh.uv_faces.reshape(-1)], axis=1), axis=0, return_inverse=True)
    uvs = mesh.uvs[pairs[:, 1]] * (1.0, -1.0) + (0.0, 1.0)  # trimesh counts v upwards and turns it for glTF
    image = None if mesh.texture is None else Image.fromarray(to_bytes(mesh.texture))
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=image, metallicFactor=0.0, roughnessFactor=1.0)
    visual = trimesh.visual.TextureVisuals(uv=uvs, material=material)
    if image is None and mesh.colors is not None:
        rgba = np.pad(_byte_colors(mesh), ((0, 0), (0, 1)), constant_values=255)
        visual.vertex_attributes["color"] = rgba[pairs[:, 0]]
    return trimesh.Trimesh(mesh.positions[pairs[:, 0]], index.reshape(-1, 3), vertex_normals=normals[pairs[:, 0]],
                           visual=visual, process=False)


def to_bytes(image: np.ndarray) -> np.ndarray:
    """uint8 of an image in [0, 1]: (h, w), (h, w, 1), (h, w, 3) or (h, w, 4), as PIL takes it; clipped, NaN becomes 0."""
    image = np.asarray(image)
    if image.ndim == 2:
        image = image[..., None]
    if image.ndim != 3 or image.shape[2] not in (1, 3, 4) or image.size == 0:
        raise InputError(f"image has shape {image.shape}; it must be (h, w), or (h, w, c) with 1, 3 or 4 channels")
    if image.dtype != np.uint8:
        image = np.rint(np.clip(np.nan_to_num(image.astype(np.float64), nan=0.0), 0.0, 1.0) * 255.0).astype(np.uint8)
    return image[..., 0] if image.shape[2] == 1 else image


def save_png(path: str | Path, image: np.ndarray) -> None:
    """An image in [0, 1] as a PNG of 8 bits, values as given (encode to sRGB before, where they are linear)."""
    _write_png(path, Image.fromarray(to_bytes(image)))


def _write_png(path: str | Path, image: Image.Image) -> None:
    data = io.BytesIO()
    image.save(data, format="PNG")
    write_bytes(path, data.getvalue())


def contact_sheet(rows: Sequence[tuple[str, Sequence[np.ndarray]]], path: str | Path) -> None:
    """A labelled grid: each row is (label, images); images in [0, 1] of 1, 3 or 4 channels, alpha straight, over light grey."""
    if not rows or not any(len(images) for _, images in rows):
        raise InputError(f"contact sheet {path} has no image; give at least one row with one")
    tiles = [[_tile(image) for image in images] for _, images in rows]
    font = ImageFont.load_default(14)
    gap, left = 6, 12 + max(math.ceil(font.getlength(label)) for label, _ in rows)
    width = max(tile.width for row in tiles for tile in row)
    heights = [max((tile.height for tile in row), default=20) for row in tiles]
    columns = max(len(row) for row in tiles)
    sheet = Image.new("RGB", (left + columns * (width + gap) + gap, sum(heights) + gap * (len(rows) + 1)), "white")
    draw, y = ImageDraw.Draw(sheet), gap
    for (label, _), row, height in zip(rows, tiles, heights, strict=True):
        draw.text((6, y + height / 2), label, fill="black", font=font, anchor="lm")
        for column, tile in enumerate(row):
            sheet.paste(tile, (left + gap + column * (width + gap), y))
        y += height + gap
    _write_png(path, sheet)


def _tile(image: np.ndarray) -> Image.Image:
    pixels = to_bytes(image)
    if pixels.ndim == 3 and pixels.shape[2] == 4:
        alpha = pixels[..., 3:] / 255.0
        pixels = to_bytes(pixels[..., :3] / 255.0 * alpha + BACKGROUND * (1.0 - alpha))
    return Image.fromarray(pixels).convert("RGB")


def loss_curve(curves: Mapping[str, Sequence[tuple[float, float]]], path: str | Path, size: tuple[int, int] = (720, 420),
               title: str = "loss") -> None:
    """A line plot of (iteration, loss) lists, loss on a log scale; points that are not finite and above 0 are left out."""
    lines = {name: [(x, math.log10(y)) for x, y in points if math.isfinite(y) and y > 0.0] for name, points in curves.items()}
    points = [point for line in lines.values() for point in line]
    if not points:
        raise InputError(f"loss curve {path} has no finite loss above 0; a log scale needs one")
    x0, x1 = min(x for x, _ in points), max(x for x, _ in points)
    y0, y1 = min(y for _, y in points), max(y for _, y in points)
    x1 = x1 if x1 > x0 else x0 + 1.0
    margin = 0.05 * (y1 - y0) or 0.1
    y0, y1 = y0 - margin, y1 + margin
    font, scale = ImageFont.load_default(24), 2  # drawn twice as large and averaged down, so that lines are smooth
    width, height = size[0] * scale, size[1] * scale
    left, right, top, bottom = 130, width - 30, 60, height - 90
    plot = Image.new("RGB", (width, height), "white")
    draw = ImageDraw.Draw(plot)

    def at(x: float, y: float) -> tuple[float, float]:
        return left + (x - x0) / (x1 - x0) * (right - left), bottom - (y - y0) / (y1 - y0) * (bottom - top)

    for y in _log_ticks(y0, y1):
        draw.line([at(x0, y), at(x1, y)], fill="#dddddd", width=2)
        draw.text((left - 12, at(x0, y)[1]), f"{10.0 ** y:.3g}", fill="black", font=font, anchor="rm")
    for x in _ticks(x0, x1):
        draw.line([at(x, y0), at(x, y1)], fill="#eeeeee", width=2)
        draw.text((at(x, y0)[0], bottom + 12), f"{x:g}", fill="black", font=font, anchor="mt")
    draw.line([(left, top), (left, bottom), (right, bottom)], fill="black", width=3)
    draw.text(((left + right) / 2, height - 14), "iteration", fill="black", font=font, anchor="mb")
    draw.text((left, top - 16), f"{title} (log scale)", fill="black", font=font, anchor="ls")
    for i, (name, line) in enumerate(lines.items()):
        color = COLORS[i % len(COLORS)]
        corners = [at(x, y) for x, y in line]
        if len(corners) > 1:
            draw.line(corners, fill=color, width=4, joint="curve")
        for x, y in corners if len(corners) == 1 else ():
            draw.ellipse([x - 6, y - 6, x + 6, y + 6], fill=color)
        y = top + 24 + 34 * i
        draw.line([(right - 60, y), (right - 10, y)], fill=color, width=6)
        draw.text((right - 72, y), name, fill="black", font=font, anchor="rm")
    _write_png(path, plot.resize(size, Image.Resampling.BOX))


def _ticks(low: float, high: float) -> list[float]:
    """About six round numbers (1, 2 or 5 times a power of ten apart) in [low, high]."""
    rough = (high - low) / 6.0
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(power * factor for factor in (1.0, 2.0, 5.0, 10.0) if power * factor >= rough)
    return [i * step for i in range(math.ceil(low / step), math.floor(high / step + 1e-9) + 1)]


def _log_ticks(low: float, high: float) -> list[float]:
    """log10 of the decades in [low, high]; with 2 and 5 where there are few; of even steps where even those are."""
    decades = range(math.floor(low), math.ceil(high) + 1)
    for factors in ((1,), (1, 2, 5)):
        inside = [y for d in decades for f in factors if low <= (y := d + math.log10(f)) <= high]
        if len(inside) >= 3:
            return inside[::max(1, len(inside) // 8)]
    return [math.log10(x) for x in _ticks(10.0 ** low, 10.0 ** high) if x > 0.0]
