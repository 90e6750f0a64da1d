"""What of a session a checkpoint holds, and how it comes back. The file itself is `checkpoint.py`.

In: a session. Out: its values and counters as they are between two calls, or a session as it was then.
"""
from __future__ import annotations

import os
from typing import TYPE_CHECKING

import numpy as np

from ..cache.errors import BundleError, InputError
from ..cache.layout import is_int
from . import checkpoint as files
from .memory import image_bytes
from .running import give_back
from .transfer import download
from .values import pixels, put

if TYPE_CHECKING:
    from .session import Session


def snapshot(s: Session) -> files.Checkpoint:
    """Values and counters now; the session's lock is held."""
    s._work.settle()
    runs = {name: s._runs[name] for name in s.phases}
    names = _kept(s, runs, [n for n, given in s._reactive.given.items() if given])
    give_back(s, names)
    data = download(s._work, s._staging, [s._handle(s.values[name]["image"]) for name in names])
    s._staging.trim(s._largest)
    return files.Checkpoint(s.phase, runs, dict(zip(names, data)))


def _kept(s: Session, runs: dict[str, int], inputs: list[str]) -> list[str]:
    """The values that a checkpoint holds: states, inputs that were set, and what phases that have run gave out."""
    given = {name for phase in s.phases if runs[phase] for name in s._plans[phase].rule.outputs}
    known = {*given, *inputs} - {s._fed.name, *s._kept.inputs}  # pictures are known by the bundle, or whoever gives them
    return [name for name, value in s.values.items() if value["role"] == "state" or name in known]


def _not_finite(s: Session, kept: files.Checkpoint) -> str:
    """Which input or state of it has numbers that `set` would refuse, in words; else nothing."""
    for name, data in kept.values.items():
        value = s.values[name]
        if value["role"] != "output" and not is_int(value["type"]):
            numbers = s._layouts[name].from_image(pixels(s, value, np.frombuffer(data, np.uint8)))
            if bad := np.count_nonzero(~np.isfinite(numbers)):
                return f"{name} has {bad} values that are NaN or Inf"
    return ""


def checkpoint(s: Session, path: str | os.PathLike) -> None:
    """`Session.checkpoint`."""
    kept = s._snapshot()
    if bad := _not_finite(s, kept):
        raise InputError(f"{os.fspath(path)}: the checkpoint is not written: {bad}, and what goes on from there is of no use; "
                         "restore an earlier one, and lower the rates")
    files.write(path, files.dumps(kept, s.bundle.digest))


def restore(s: Session, path: str | os.PathLike) -> None:
    """`Session.restore`."""
    s._usable()
    sizes = {name: image_bytes(s._d["images"][value["image"]]) for name, value in s.values.items()}
    found = files.read(path, s.bundle.digest, sum(sizes.values()))
    inputs = [name for name in found.values if name in s._reactive.given]
    if (found.phase not in (s.phases or [None]) or list(found.runs) != s.phases
            or list(found.values) != _kept(s, found.runs, inputs)
            or any(len(data) != sizes[name] for name, data in found.values.items())):
        raise BundleError(f"{os.fspath(path)}: the checkpoint's values are not those of this bundle")
    if bad := _not_finite(s, found):
        raise BundleError(f"{os.fspath(path)}: {bad}; finite numbers are needed")
    unset = [name for name in s._reactive.given if name not in (*inputs, s._fed.name, *s._kept.inputs)]
    put(s, [(name, np.frombuffer(data, np.uint8)) for name, data in found.values.items()],
           (*((s._runs, name, n) for name, n in found.runs.items()),
            *s._reactive.unset(unset),
            (s.__dict__, "phase", found.phase)), trim=True)
