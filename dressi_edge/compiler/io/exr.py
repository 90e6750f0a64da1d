"""OpenEXR out: an image of floats to the bytes of a file that any reader of the format takes (version 2, one part, scan lines, ZIP).

Format: openexr.com, "Technical Introduction to OpenEXR" and "OpenEXR File Layout".
"""
from __future__ import annotations

import struct
import zlib

import numpy as np

from ...cache.errors import InputError

MAGIC, VERSION = 20000630, 2
ZIP, ROWS = 3, 16  # compression, and the scan lines that it takes together
FLOAT = 2
NAMES = {1: "Y", 2: "RG", 3: "RGB", 4: "RGBA"}


def exr_bytes(image: np.ndarray) -> bytes:
    """The file of an image (h, w) or (h, w, c), c 1 to 4, with 32 bits a channel: Y, RG, RGB or RGBA, values as they are, NaN and infinity
    too. Raises InputError."""
    image = np.asarray(image)
    if image.ndim == 2:
        image = image[..., None]
    if image.ndim != 3 or image.shape[2] not in NAMES or image.size == 0:
        raise InputError(f"image has shape {image.shape}; an EXR takes (h, w), or (h, w, c) with 1 to 4 channels")
    height, width, channels = image.shape
    order = sorted(range(channels), key=lambda k: NAMES[channels][k])  # the file has them by name
    rows = np.ascontiguousarray(image.transpose(0, 2, 1)[:, order], "<f4")  # (h, c, w)
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    listed = b"".join(NAMES[channels][k].encode() + b"\0" + struct.pack("<iB3xii", FLOAT, 0, 1, 1) for k in order) + b"\0"
    head = struct.pack("<II", MAGIC, VERSION) + b"".join(
        name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(data)) + data for name, kind, data in (
            ("channels", "chlist", listed), ("compression", "compression", bytes([ZIP])), ("dataWindow", "box2i", window),
            ("displayWindow", "box2i", window), ("lineOrder", "lineOrder", b"\0"), ("pixelAspectRatio", "float", struct.pack("<f", 1.0)),
            ("screenWindowCenter", "v2f", struct.pack("<2f", 0.0, 0.0)), ("screenWindowWidth", "float", struct.pack("<f", 1.0)))) + b"\0"
    blocks = []
    for y in range(0, height, ROWS):
        data = _packed(rows[y:y + ROWS].tobytes())
        blocks.append(struct.pack("<ii", y, len(data)) + data)
    starts = np.cumsum([len(head) + 8 * len(blocks), *map(len, blocks[:-1])])
    return head + starts.astype("<u8").tobytes() + b"".join(blocks)


def _packed(raw: bytes) -> bytes:
    """A block as ZIP has it: bytes of even places before those of odd ones, differences, deflated; as it is where that is no shorter."""
    data = np.frombuffer(raw, np.uint8)
    data = np.concatenate([data[::2], data[1::2]])
    data[1:] = data[1:] - data[:-1] + np.uint8(128)
    packed = zlib.compress(data.tobytes())
    return packed if len(packed) < len(raw) else raw
