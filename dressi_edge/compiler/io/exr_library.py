"""OpenEXR files that the reader here (`panorama.read_exr`) does not unpack, such as PIZ, DWAA, DWAB and tiles, by the format's own library.

In: a path. Out: an array (h, w, 3). The library is that of openexr.com, package OpenEXR, the extra `exr`; nothing else needs it.
"""
from __future__ import annotations

import importlib
from pathlib import Path

import numpy as np

from ...cache.errors import InputError
from .text import shown


def read(path: str | Path, what: str, name: str) -> np.ndarray:
    """(h, w, 3) float64 of the channels R, G and B, or Y alone. what: why the library is asked. Raises InputError, where it is not
    installed, too."""
    try:
        library = importlib.import_module("OpenEXR")
    except ImportError:
        raise InputError(f"{name} has {what}, which the package OpenEXR reads, and it is not installed; pip install 'dressi_edge[exr]', or "
                         "save it as scan lines compressed by none, RLE, ZIPS or ZIP, or as .hdr") from None
    try:
        with library.File(str(path), separate_channels=True) as file:
            found = {key: np.array(channel.pixels, float) for key, channel in file.channels().items()}
    except Exception as error:  # its errors have no class of their own
        raise InputError(f"{name} cannot be read by OpenEXR ({type(error).__name__}: {shown(error)}); save it again as .exr, compressed by "
                         "ZIP") from None
    wanted = ["R", "G", "B"] if {"R", "G", "B"} <= found.keys() else ["Y"] * 3
    if not set(wanted) <= found.keys():
        raise InputError(f"{name} has the channels {shown(' '.join(found))}; R, G and B, or Y, are needed")
    planes = [found[key] for key in wanted]
    if len({x.shape for x in planes}) != 1 or planes[0].ndim != 2:
        raise InputError(f"{name} has channels of shapes {', '.join(str(x.shape) for x in planes)}; equal ones are needed")
    return np.stack(planes, -1)
