"""What `-o` asks for: a mesh, all states, or one value of the bundle as pictures or as an array.

In: the texts of the command line. Out: `Wanted`, which says before the work whether it can be written, and writes itself.
"""
from __future__ import annotations

import importlib.util
import io
import os
from dataclasses import dataclass

import numpy as np

from ..cache.errors import InputError
from ..cache.layout import is_int
from .files import check_folder, write_file

MESHES = (".glb", ".gltf", ".obj", ".ply", ".usdz")
PICTURES = (".png", ".exr")
ROLES = ("output", "state", "input")


@dataclass(frozen=True)
class Wanted:
    """kind: "mesh", "arrays" (all states, .npz) or "value", which has the name of one."""

    path: str
    kind: str
    value: str = ""

    @property
    def names(self) -> list[str]:
        """The file's name as it is shown."""
        return [os.path.basename(self.path)]

    @property
    def suffix(self) -> str:
        return os.path.splitext(self.path)[1].lower()

    def check(self, session) -> None:
        """Raises InputError unless the session has this value and it is what the file can hold."""
        value = session.values.get(self.value)
        if value is None or value["role"] not in ROLES:
            known = " ".join(name for name, x in session.values.items() if x["role"] == "output") or "none"
            raise InputError(f"-o {self.value}={self.path}: the bundle has no value {self.value!r:.60}; its outputs are: {known}; states "
                             "and inputs may be named, too")
        if self.suffix == ".npy":
            return
        if value["layout"] not in ("image", "atlas"):
            raise InputError(f"-o {self.value}={self.path}: {self.value} is no picture, but an array of shape {session.shape(self.value)}; "
                             "write it as .npy")
        if self.suffix == ".png" and is_int(value.get("type", "float")):
            raise InputError(f"-o {self.value}={self.path}: {self.value} has whole numbers, which a PNG cannot show; write .exr or .npy")

    def write(self, session) -> None:
        """Write the value as it is now: of several views a file each, numbered."""
        array = np.asarray(session.get(self.value))
        if self.suffix == ".npy":
            data = io.BytesIO()
            np.save(data, array)
            write_file(self.path, data.getvalue())
            return
        if session.values[self.value]["layout"] == "atlas":
            stem, suffix = os.path.splitext(self.path)
            paths = [self.path] if len(array) == 1 else [f"{stem}_{k}{suffix}" for k in range(len(array))]
        else:
            array, paths = array[None], [self.path]
        for path, image in zip(paths, array):
            write_file(path, _encoded(image, self.suffix))


def _encoded(image: np.ndarray, suffix: str) -> bytes:
    if suffix == ".exr":
        from ..compiler.io.exr import exr_bytes
        return exr_bytes(image)
    from ..compiler.io.images import png_bytes
    if image.ndim == 3 and image.shape[2] == 2:
        image = np.concatenate([image, np.zeros_like(image[..., :1])], axis=2)
    return png_bytes(image)


def wanted(texts: list[str]) -> list[Wanted]:
    """What each -o asks for: FILE, or VALUE=FILE. Raises InputError."""
    found = []
    for text in texts:
        name, equals, path = text.partition("=")
        found.append(_value(name, path) if equals else _file(text))
        check_folder(found[-1].path)
    return found


def _file(path: str) -> Wanted:
    suffix = os.path.splitext(path)[1].lower()
    if suffix not in (*MESHES, ".npz"):
        raise InputError(f"output {path}: extension {suffix or 'none'} is unknown; known are {' '.join(MESHES)} .npz, and for one "
                         f"value, as VALUE=FILE, {' '.join(PICTURES)} .npy")
    if suffix == ".usdz" and importlib.util.find_spec("pxr") is None:
        raise InputError(f"output {path}: writing .usdz takes Pixar's library: pip install 'dressi_edge[usd]'")
    return Wanted(path, "arrays" if suffix == ".npz" else "mesh")


def _value(name: str, path: str) -> Wanted:
    suffix = os.path.splitext(path)[1].lower()
    if suffix not in (*PICTURES, ".npy"):
        raise InputError(f"-o {name}={path}: extension {suffix or 'none'} is unknown for a value; known are {' '.join(PICTURES)} .npy")
    return Wanted(path, "value", name)
