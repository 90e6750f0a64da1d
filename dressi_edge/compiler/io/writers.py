"""Results to files: meshes, images, contact sheets, loss curves and JSON.

Every file appears whole or not at all.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from ...cache.errors import InputError
from ...cache.files import replace_file
from .cameras import Camera
from .gltf_lights import PlacedLight
from .images import png_bytes, to_bytes
from .materials import Material, Part
from .mesh import Mesh
from .write_gltf import encode_gltf
from .write_obj import encode_obj
from .write_ply import encode_ply

MESH_SUFFIXES = (".glb", ".gltf", ".obj", ".ply", ".usdz")
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


def save_mesh(path: str | Path, mesh: Mesh, unlit: bool = False) -> None:
    """Writes a mesh with its texture or, without one, its colours: as .glb, .gltf or .usdz (texture inside), .obj or .ply (texture as
    .png beside, with .mtl). Vertices keep their order and count; those that must be split, at seams, follow after the last.

    unlit: glTF says that the colours are what one sees (KHR_materials_unlit); else they are those of a diffuse surface.
    """
    if mesh.texture is not None and mesh.uvs is not None:
        mesh = replace(mesh, colors=None, color_faces=None)  # they would multiply the texture
    save_parts(path, [Part("surface", mesh, Material("surface", unlit=unlit))])


def save_parts(path: str | Path, parts: Sequence[Part], lights: Sequence[PlacedLight] = (),
               cameras: Sequence[tuple[str, Camera]] = ()) -> None:
    """Writes parts with their materials, as `save_mesh` does; `Part.mesh` has the base colour's uvs and texels. OBJ has base colours,
    emission and the PBR extension; PLY has pictures and colours of vertices, times base colours. glTF has lights (KHR_lights_punctual) and
    cameras with their names, too; .usdz has cameras."""
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in MESH_SUFFIXES:
        raise InputError(f"cannot write mesh {path}: extension {suffix or 'none'} is unknown; "
                         f"known are {', '.join(MESH_SUFFIXES)}")
    if not parts:
        raise InputError(f"cannot write mesh {path}: there is no part; give at least one")
    if suffix in (".obj", ".ply"):
        for name, data in (encode_obj if suffix == ".obj" else encode_ply)(parts, path.stem).items():  # what the mesh names before it
            write_bytes(path if name == f"{path.stem}{suffix}" else path.with_name(name), data)
    elif suffix == ".usdz":
        from .write_usd import encode_usdz  # takes a library that not everybody has
        write_bytes(path, encode_usdz(parts, cameras))
    else:
        write_bytes(path, encode_gltf(parts, suffix == ".glb", lights, cameras))


def save_png(path: str | Path, image: np.ndarray) -> None:
    """An image in [0, 1] as a PNG of 8 bits, values as given (encode to sRGB before, where they are linear)."""
    write_bytes(path, png_bytes(image))


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
    write_bytes(path, png_bytes(np.asarray(sheet)))


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
    write_bytes(path, png_bytes(np.asarray(plot.resize(size, Image.Resampling.BOX))))


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
