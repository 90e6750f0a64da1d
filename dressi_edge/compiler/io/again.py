"""The pictures of a bundle that does not have them, read again: how each was read, as a bundle's meta says it; and back, from a folder.

In: `Pictures`, when a bundle is compiled. Out: plain values for its meta. Then those and a folder in; a function that gives picture k out,
as `Session.pictures` wants it.
"""
from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path, PurePosixPath

import numpy as np

from ...cache.errors import BundleError, InputError
from .decode import Masks, Photograph
from .lens import Lens
from .pictures import Pictures
from .text import shown


def recorded(pictures: Pictures) -> dict:
    """What a bundle says of the files of its pictures; nothing where they cannot be read again by it."""
    if not all(isinstance(r, Photograph) for r in pictures.readings):
        return {}
    endings = _endings([f for r in pictures.readings for f in r.files])
    return {"files": ["\n".join(endings[f] for f in r.files) for r in pictures.readings], "digests": list(pictures.digests),
            "readings": [{"size": list(r.size), "to": list(size), "upright": r.upright, "lens": r.lens and _plain(asdict(r.lens)),
                          "masks": _plain({k: x for k, x in asdict(r.masks).items() if k != "files"})}
                         for r, size in zip(pictures.readings, pictures.sizes)]}


def _plain(x):
    """Of numbers, lists and maps, as a bundle has them."""
    if isinstance(x, Mapping):
        return {k: _plain(y) for k, y in x.items()}
    return [_plain(y) for y in x] if isinstance(x, tuple | list) else x.item() if isinstance(x, np.generic) else x


def _endings(files: Sequence[Path]) -> dict[Path, str]:
    """The end of each file's path: its name and folder, and as many more as tell all of them apart."""
    depth, most = 2, max(len(f.parts) for f in files)
    while len({f.parts[-depth:] for f in files}) < len(set(files)) and depth < most:
        depth += 1
    return {f: "/".join(part for part in f.parts[-depth:] if part != f.anchor) for f in files}


def reader(folder: str | Path, meta: Mapping | None, linear: bool) -> Callable[[int], np.ndarray]:
    """What gives the pictures that a bundle (its meta.pictures) was compiled with, from files in a folder: that of the cameras' file, or
    the one that they are in. All files are looked at now: InputError for the first that is not there, or another than it was. linear:
    whether the bundle compares linear light. Raises BundleError."""
    if not meta or not meta.get("files"):
        raise InputError(f"--views {shown(folder)}: the bundle names no picture files; it has its pictures, or was compiled of arrays")
    folder = Path(folder)
    if folder.suffix.lower() == ".json" and folder.is_file():
        folder = folder.parent
    if not folder.is_dir():
        raise InputError(f"--views {shown(folder)} is no folder; give the one that the pictures are in")
    try:
        found = [[_found(folder, name) for name in names.split("\n")] for names in meta["files"]]
        readings = [_photograph(r, files) for r, files in zip(meta["readings"], found, strict=True)]
        pictures = Pictures.known(readings, [tuple(r["to"]) for r in meta["readings"]], meta["digests"], meta["bits"] == 16)
    except InputError:  # of a file, not of the bundle
        raise
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise BundleError(f"meta.pictures is malformed ({error}); compile the bundle again") from None
    pictures.check()
    if linear:
        pictures = pictures.as_linear()
    return pictures.rows if meta["bits"] < 32 else pictures.picture


def _photograph(r: Mapping, files: Sequence[Path]) -> Photograph:
    lens = None if r["lens"] is None else Lens(**{k: tuple(x) if isinstance(x, list) else x for k, x in r["lens"].items()})
    masks = Masks(**{k: tuple(x) if isinstance(x, list) else x for k, x in r["masks"].items()})
    return Photograph(files[0], tuple(r["size"]), masks, files[1] if len(files) > 1 else None, r["upright"], lens)


def _found(folder: Path, name: str) -> Path:
    """The file of that ending in the folder, beside it, or right in it. Raises InputError."""
    def places() -> Iterator[Path]:
        parts = PurePosixPath(name).parts
        yield folder.joinpath(*parts)
        yield folder.parent.joinpath(*parts)
        for k in range(1, len(parts)):
            yield folder.joinpath(*parts[k:])

    if ".." not in PurePosixPath(name).parts and not name.startswith("/"):
        for place in places():
            if place.is_file():
                return place
    raise InputError(f"picture {shown(name)} is not in {shown(folder)}; give the folder that the pictures are in")
