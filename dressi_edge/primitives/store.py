"""Functions compiled at first use: in memory for this process, as bundles on disk for the next.

In: a function's name, triangles, sizes. Out: a `Primitive`: arrays in, pictures out, and back. The key of a bundle is a hash of all that it
depends on, the device's profile included; a bundle on disk lies in the folder of the pipeline cache and is trusted as that is, and what is
damaged is compiled anew.
"""
from __future__ import annotations

import hashlib
import os
import threading
from collections import OrderedDict
from collections.abc import Iterable, Mapping

import numpy as np

from ..bridges.pure import Call, Pure
from ..cache.errors import DressiError, InputError
from ..cache.pipeline_cache import kept_folder
from ..cache.profile import Profile
from ..runtime import load
from ..runtime.device import Device
from ..runtime.emulate import reported
from .graphs import build, names_of

VERSION = 1  # of what graphs.py makes: another number whenever a bundle on disk would be out of date
MOST = 48  # functions that are kept open; the one not used for longest is closed
MAX_FOLDER_BYTES = 256 << 20


class Primitive:
    """One function for one topology and size. wide: the channels of values that may have more than four. columns: of its atlas."""

    def __init__(self, pure: Pure, wide: Mapping[str, int]):
        self.pure, self.wide = pure, dict(wide)
        self.columns = next(v["columns"] for v in pure.session.values.values() if v["name"].startswith("f.") and v["layout"] == "atlas")

    def _parts(self, arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        found = {}
        for name, array in arrays.items():
            if name not in self.wide:
                found[name] = array
                continue
            for k, part in enumerate(names_of(name, self.wide[name])):
                slab = array[..., 4 * k:4 * k + 4]
                found[part] = slab[..., 0] if slab.shape[-1] == 1 else slab
        return found

    def _whole(self, parts: Mapping[str, np.ndarray], names: Iterable[str]) -> dict[str, np.ndarray]:
        found = {}
        for name in names:
            if name not in self.wide:
                found[name] = parts[name]
                continue
            own = names_of(name, self.wide[name])
            slabs = [parts[x] if k + 1 < len(own) or self.wide[name] % 4 != 1 else parts[x][..., None] for k, x in enumerate(own)]
            found[name] = slabs[0] if len(slabs) == 1 else np.concatenate(slabs, -1)
        return found

    def _names(self, parts: Iterable[str]) -> list[str]:
        """Whole values by the names of parts."""
        split = {part: name for name, channels in self.wide.items() for part in names_of(name, channels)}
        return list(dict.fromkeys(split.get(part, part) for part in parts))

    def forward(self, arrays: Mapping[str, np.ndarray], steady: Iterable[str] = ()) -> tuple[dict[str, np.ndarray], Call]:
        """As `Pure.forward`, of whole values."""
        parts = {name: x for name, x in self._parts(arrays).items() if name in self.pure.given}  # some serve gradients alone
        still = {part for name in steady for part in ((name,) if name not in self.wide else names_of(name, self.wide[name]))}
        found, call = self.pure.forward(parts, still)
        return self._whole(found, self._names(found)), call

    def backward(self, call: Call, gradients: Mapping[str, np.ndarray], wanted: Iterable[str]) -> dict[str, np.ndarray]:
        """As `Pure.backward`, of whole values."""
        names = [part for name in wanted for part in ((name,) if name not in self.wide else names_of(name, self.wide[name]))]
        return self._whole(self.pure.backward(call, self._parts(gradients), names), wanted)


class Store:
    """A device, and the functions compiled for it. device: an open one, or a part of its name; profile: what to compile for, by default
    what the device reports. Threads may share it. Raises DeviceError, ProfileError."""

    def __init__(self, device: str | Device | None = None, profile: Profile | str | None = None):
        self.device = device if isinstance(device, Device) else Device.open(device)
        self._owns = self.device is not device
        self.profile = reported(self.device) if profile is None else profile if isinstance(profile, Profile) else Profile.load(profile)
        self._open: OrderedDict[str, Primitive] = OrderedDict()
        self._lock = threading.Lock()

    def close(self) -> None:
        """Give everything back."""
        with self._lock:
            for primitive in self._open.values():
                primitive.pure.session.close()
            self._open.clear()
            if self._owns:
                self.device.close()

    def find(self, name: str, faces: np.ndarray | None, sizes: tuple, wide: Mapping[str, int],
             wanted: Iterable[str] | None = None) -> Primitive:
        """The function, compiled if neither memory nor disk has it. sizes: arguments of its builder in graphs.py after the triangles.
        wanted: of what gradients will be asked for; None: of all; nothing: any that is open will do."""
        wanted = None if wanted is None else tuple(sorted(wanted))
        words = repr((VERSION, name, None if faces is None else faces.shape, sizes, self.profile.digest))
        base = hashlib.sha256(words.encode() + (b"" if faces is None else np.ascontiguousarray(faces, "<i4").tobytes())).hexdigest()[:40]
        with self._lock:
            if wanted == ():
                key = next((k for k in reversed(self._open) if k.startswith(base)), f"{base}-all")
                wanted = None
            else:
                key = f"{base}-{'all' if wanted is None else '-'.join(wanted)}"
            primitive = self._open.get(key)
            if primitive is None:
                primitive = self._open[key] = Primitive(Pure(self._session(key, name, faces, sizes, wanted), "f"), wide)
            self._open.move_to_end(key)
            while len(self._open) > MOST:
                _, oldest = self._open.popitem(last=False)
                oldest.pure.session.close()
            return primitive

    def _session(self, key: str, name: str, faces: np.ndarray | None, sizes: tuple, wanted: tuple[str, ...] | None):
        folder = kept_folder("functions")
        path = None if folder is None else os.path.join(folder, f"{name}-{key}.dressi")
        if path is not None and os.path.exists(path):
            try:
                session = load(path, self.device)
                os.utime(path)
                return session
            except (DressiError, OSError):  # damaged, or of another version of the format
                pass
        if faces is not None and not len(faces):
            raise InputError(f"{name}: there are no triangles; at least one is needed")
        scene = build(name, faces, *sizes, wanted=wanted)
        if path is not None:
            try:
                scene.compile(self.profile, path)
                _trim(folder)
                return load(path, self.device)
            except OSError:
                pass
        import tempfile
        with tempfile.TemporaryDirectory() as own:
            scene.compile(self.profile, os.path.join(own, "f.dressi"))
            return load(os.path.join(own, "f.dressi"), self.device)


def _trim(folder: str) -> None:
    """Those not used for longest go where there is too much."""
    with os.scandir(folder) as entries:
        files = sorted((e.stat().st_mtime, e.stat().st_size, e.path) for e in entries if e.is_file(follow_symlinks=False))
    whole = sum(size for _, size, _ in files)
    for _, size, path in files[:-1]:
        if whole > MAX_FOLDER_BYTES:
            os.unlink(path)
            whole -= size
