"""Panoramas: Radiance .hdr, OpenEXR, and pictures of 8 or 16 bits, as linear radiance.

OpenEXR is read where it is scan lines that are not compressed, or by RLE or ZIP; what else there is, by a library (`exr_library.py`).
"""
from __future__ import annotations

import struct
import warnings
import zlib
from pathlib import Path

import numpy as np

from ...cache.errors import InputError, InputWarning
from . import exr_library
from .images import MAX_PIXELS, opened, srgb_to_linear
from .text import read_bytes, shown

MAX_PANORAMA_BYTES = 1 << 30
_EXR_LINES = {0: 1, 1: 1, 2: 1, 3: 16}  # lines of a chunk by compression: none, RLE, ZIPS, ZIP
_EXR_NAMES = ("none", "RLE", "ZIPS", "ZIP", "PIZ", "PXR24", "B44", "B44A", "DWAA", "DWAB")
_EXR_TYPES = (np.dtype("<u4"), np.dtype("<f2"), np.dtype("<f4"))


def load_panorama(path: str | Path) -> np.ndarray:
    """(height, 2 height, 3) float64 linear radiance of an equirectangular picture of all directions. A picture of 8 or 16 bits is decoded
    from sRGB: light brighter than its white is lost, which an `InputWarning` says. Raises InputError for other shapes, and for radiance
    that is NaN, infinite or negative."""
    path = Path(path)
    kind = path.suffix.lower()
    if kind == ".hdr":
        image = read_hdr(read_bytes(path, "panorama", MAX_PANORAMA_BYTES), path)
    elif kind == ".exr":
        image = read_exr(read_bytes(path, "panorama", MAX_PANORAMA_BYTES), path)
    else:
        with opened(path, "panorama", "save it as .hdr or .exr") as picture:
            sixteen = picture.mode.startswith("I;16")
            array = np.asarray(picture if sixteen else picture.convert("RGB"), float) / (65535.0 if sixteen else 255.0)
        image = srgb_to_linear(np.repeat(array[..., None], 3, 2) if array.ndim == 2 else array)
        warnings.warn(f"panorama {shown(path)} is no HDR picture: radiance above its white is lost, and with it lamps and the sun; "
                      "an .hdr or .exr keeps them", InputWarning, stacklevel=2)
    return checked(image, f"panorama {shown(path)}")


def checked(image: np.ndarray, who: str) -> np.ndarray:
    """The radiance of a whole sphere, or InputError."""
    image = np.asarray(image, float)
    if image.ndim != 3 or image.shape[2] != 3 or image.shape[1] != 2 * image.shape[0]:
        raise InputError(f"{who} has shape {image.shape}; (height, 2 height, 3) is needed: all directions, twice as wide as high")
    for what, bad in (("NaN", np.isnan(image)), ("infinite", np.isinf(image)), ("negative", image < 0)):
        if bad.any():
            row, column = np.argwhere(bad.any(-1))[0]
            raise InputError(f"{who} has {np.count_nonzero(bad.any(-1))} {what} texels, the first at row {row}, column {column}; finite "
                             "radiance from 0 on is needed: repair or clip it")
    return image


# ---- Radiance RGBE (Ward 1991)

def read_hdr(data: bytes, path: str | Path) -> np.ndarray:
    """(h, w, 3) of a Radiance picture, rows from the top. Raises InputError."""
    name = f"panorama {shown(path)}"
    if not data.startswith((b"#?RADIANCE", b"#?RGBE")):
        raise InputError(f"{name} is no Radiance picture: it does not begin with #?RADIANCE; save it again as .hdr")
    head, found, rest = data.partition(b"\n\n")
    line, newline, rest = rest.partition(b"\n")
    words = line.split()
    exposure = 1.0
    try:
        for entry in head.split(b"\n"):
            key, _, value = entry.partition(b"=")
            if key.strip() == b"FORMAT" and value.strip() != b"32-bit_rle_rgbe":
                raise InputError(f"{name} has the format {shown(value.decode('latin-1').strip())}; 32-bit_rle_rgbe is needed")
            if key.strip() == b"EXPOSURE":
                exposure *= float(value)
        if not (found and newline and len(words) == 4 and words[0] == b"-Y" and words[2] == b"+X"):
            raise InputError(f"{name} has the resolution {shown(line[:60].decode('latin-1'))!r}; -Y height +X width is needed")
        height, width = int(words[1]), int(words[3])
    except ValueError as error:
        raise InputError(f"{name} has a malformed header ({shown(error)}); save it again as .hdr") from None
    if not (0 < height and 0 < width and height * width <= MAX_PIXELS and 0 < exposure < np.inf):
        raise InputError(f"{name} is {width}x{height}, exposure {exposure:g}; 1 to {MAX_PIXELS} pixels and an exposure above 0 are allowed")
    pixels, at = np.zeros((height, width, 4), np.uint8), 0
    source = np.frombuffer(rest, np.uint8)
    for row in pixels:
        at = _hdr_row(source, at, row, name)
    scale = np.ldexp(1.0 / exposure, pixels[..., 3:].astype(int) - 136)
    return np.where(pixels[..., 3:] > 0, pixels[..., :3] * scale, 0.0)


def _hdr_row(source: np.ndarray, at: int, row: np.ndarray, name: str) -> int:
    """Fills a row (w, 4) from bytes at `at`; where the next begins."""
    cut = InputError(f"{name} ends within its pixels, or they are malformed; save it again as .hdr")
    width = len(row)
    if not (at + 4 <= len(source) and 8 <= width < 32768 and source[at] == 2 and source[at + 1] == 2
            and int(source[at + 2]) << 8 | int(source[at + 3]) == width):
        if at + 4 * width > len(source):
            raise cut
        row[:] = source[at:at + 4 * width].reshape(width, 4)
        if width and (row[:, :3] == 1).all(1).any():
            raise InputError(f"{name} is packed in runs of old readers; save it again as .hdr")
        return at + 4 * width
    at += 4
    for channel in range(4):
        k = 0
        while k < width:
            if at + 2 > len(source):
                raise cut
            count = int(source[at])
            run = count > 128
            count -= 128 * run
            end = at + 1 + (1 if run else count)
            if count == 0 or k + count > width or end > len(source):
                raise cut
            row[k:k + count, channel] = source[at + 1] if run else source[at + 1:end]
            k, at = k + count, end
    return at


# ---- OpenEXR (openexr.com: "OpenEXR file layout")

def read_exr(data: bytes, path: str | Path) -> np.ndarray:
    """(h, w, 3) of the channels R, G and B, or Y alone. Raises InputError."""
    name = f"panorama {shown(path)}"
    if len(data) < 8 or data[:4] != b"\x76\x2f\x31\x01":
        raise InputError(f"{name} is no OpenEXR file; save it again as .exr")
    try:
        attributes, at = _exr_header(data)
        compression = attributes["compression"][0]
        if data[5] & 0x18:
            raise InputError(f"{name} has several parts or deep data; one picture of scan lines or tiles is needed: save it so, or as .hdr")
        left, top, right, bottom = struct.unpack("<4i", attributes["dataWindow"])
        width, height = right - left + 1, bottom - top + 1
        if not (0 < width and 0 < height and width * height <= MAX_PIXELS):
            raise InputError(f"{name} is {width}x{height}; 1 to {MAX_PIXELS} pixels are allowed")
        if data[5] & 0x02 or compression not in _EXR_LINES:
            called = _EXR_NAMES[compression] if compression < len(_EXR_NAMES) else f"number {compression}"
            return exr_library.read(path, "tiles" if data[5] & 0x02 else f"compression {called}", name)
        return _exr_lines(data, at, _exr_channels(attributes["channels"]), compression, width, height, top, name)
    except InputError:
        raise
    except (KeyError, IndexError, ValueError, struct.error, zlib.error) as error:
        raise InputError(f"{name} cannot be read ({type(error).__name__}: {shown(error)}); save it again as .exr, compressed by "
                         "ZIP") from None


def _exr_header(data: bytes) -> tuple[dict[str, bytes], int]:
    attributes, at = {}, 8
    while data[at]:
        name, kind, size = *data[at:at + 512].split(b"\0", 2)[:2], 0
        at += len(name) + len(kind) + 2
        size, = struct.unpack_from("<i", data, at)
        if size < 0 or at + 4 + size > len(data):
            raise ValueError("an attribute is longer than the file")
        attributes[name.decode("latin-1")] = data[at + 4:at + 4 + size]
        at += 4 + size
    return attributes, at + 1


def _exr_channels(entry: bytes) -> list[tuple[str, np.dtype]]:
    found, at = [], 0
    while entry[at]:
        name = entry[at:].split(b"\0", 1)[0]
        at += len(name) + 1
        kind, _, across, down = struct.unpack_from("<4i", entry, at)
        if across != 1 or down != 1:
            raise ValueError("channels of different sizes")
        found.append((name.decode("latin-1"), _EXR_TYPES[kind]))
        at += 16
    return found


def _exr_lines(data: bytes, at: int, channels: list[tuple[str, np.dtype]], compression: int, width: int, height: int, top: int,
               name: str) -> np.ndarray:
    wanted = ["R", "G", "B"] if {"R", "G", "B"} <= {c for c, _ in channels} else ["Y"]
    if wanted == ["Y"] and "Y" not in dict(channels):
        raise InputError(f"{name} has the channels {shown(' '.join(c for c, _ in channels))}; R, G and B, or Y, are needed")
    lines, line = _EXR_LINES[compression], sum(kind.itemsize for _, kind in channels) * width
    out = np.zeros((height, width, len(wanted)))
    for offset in struct.unpack_from(f"<{-(-height // lines)}Q", data, at):
        y, size = struct.unpack_from("<ii", data, offset)
        first, chunk = y - top, data[offset + 8:offset + 8 + size]
        if not 0 <= first < height or size < 0 or len(chunk) != size:
            raise ValueError("a chunk lies outside")
        count = min(lines, height - first)
        raw = chunk if size == count * line else _exr_unpacked(chunk, compression, count * line)
        rows = np.frombuffer(raw, np.uint8).reshape(count, line)
        place = 0
        for channel, kind in channels:
            part = rows[:, place:place + kind.itemsize * width]
            place += kind.itemsize * width
            if channel in wanted:
                out[first:first + count, :, wanted.index(channel)] = np.ascontiguousarray(part).view(kind)
    return np.repeat(out, 3, 2) if wanted == ["Y"] else out


def _exr_unpacked(chunk: bytes, compression: int, size: int) -> bytes:
    if compression == 1:
        out, at = bytearray(), 0
        while at < len(chunk):
            count = chunk[at] - 256 * (chunk[at] > 127)
            out += chunk[at + 1:at + 1 - count] if count < 0 else chunk[at + 1:at + 2] * (count + 1)
            at += 1 - count if count < 0 else 2
        raw = bytes(out)
    else:
        decoder = zlib.decompressobj()
        raw = decoder.decompress(chunk, size)
    if len(raw) != size:
        raise ValueError(f"a chunk of {len(raw)} bytes, not {size}")
    deltas = np.frombuffer(raw, np.uint8).astype(np.int64)
    deltas[1:] -= 128
    values = (np.cumsum(deltas) & 255).astype(np.uint8)
    out = np.empty(size, np.uint8)
    half = (size + 1) // 2
    out[0::2], out[1::2] = values[:half], values[half:]
    return out.tobytes()


def write_hdr(image: np.ndarray) -> bytes:
    """A Radiance picture, not packed, of linear radiance (h, w, 3) from 0 on: to about half a percent, as the format has it."""
    image = np.asarray(image, float)
    top = image.max(-1)
    exponent = np.where(top > 1e-32, np.frexp(top)[1], 0)
    scale = np.where(top > 1e-32, np.ldexp(1.0, 8 - exponent), 0.0)
    pixels = np.concatenate([np.floor(image * scale[..., None]), np.where(top > 1e-32, exponent + 128, 0)[..., None]], -1).clip(0, 255)
    head = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {image.shape[0]} +X {image.shape[1]}\n"
    return head.encode() + pixels.astype(np.uint8).tobytes()
