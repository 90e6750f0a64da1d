"""Compiled shaders kept from one process to the next, by their text and the tools that compiled them.

In: a folder (the pipeline cache's, and as trusted: `cache/pipeline_cache.py`), a key. Out: SPIR-V, or None. A file holds the SHA-256 of its
code and the code; what is damaged, or others could have written, is not there. A folder that cannot be used costs time, never an error.
"""
from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Mapping

from ...cache.errors import DressiError
from ...cache.files import read_regular, replace_file
from ...cache.pipeline_cache import kept_folder

MAX_BYTES = 1 << 22  # of one shader
MAX_FOLDER_BYTES = 256 << 20  # 25,000 shaders: those of 300 problems
LOOK_EVERY = 16  # after the sixteenth part of that, a process looks again whether there is too much
SUFFIX = ".spirv"


def folder() -> str | None:
    """Where shaders are kept; None where none are (`pipeline_cache.kept_folder`)."""
    return kept_folder("shaders")


def key(tools: Mapping[str, str], *words: str) -> str:
    """Of a shader: the tools by path, and everything else that its code depends on."""
    known = hashlib.sha256()
    for path in tools.values():
        real = os.path.realpath(path)
        found = os.stat(real)
        known.update(repr((real, found.st_size, found.st_mtime_ns)).encode())
    for word in words:
        known.update(b"\0" + word.encode())
    return known.hexdigest()


def load(path: str, name: str) -> bytes | None:
    """The code under a key; None unless it is there and whole."""
    try:
        data = read_regular(os.path.join(path, name + SUFFIX), MAX_BYTES, getattr(os, "O_NOFOLLOW", 0), _foreign)
    except (OSError, DressiError):
        return None
    return data[32:] if len(data) > 32 and hashlib.sha256(data[32:]).digest() == data[:32] else None


def _foreign(found: os.stat_result) -> str:
    return "others may write to it" if hasattr(os, "geteuid") and (found.st_uid != os.geteuid() or found.st_mode & 0o022) else ""


_stored: dict[str, int] = {}  # by folder, the bytes that this process wrote since it last looked how much there is


def store(path: str, made: Mapping[str, bytes]) -> None:
    """Keep code by key; what was stored longest ago goes where there is too much. Nothing waits for the disk: a file of which a power cut
    leaves a part does not have its SHA-256."""
    try:
        for name, code in made.items():
            replace_file(os.path.join(path, name + SUFFIX), hashlib.sha256(code).digest(), code, mode=0o600, lasting=False)
        written = sum(map(len, made.values()))
        if path not in _stored or _stored[path] + written > MAX_FOLDER_BYTES // LOOK_EVERY:
            _trim(path)
            _stored[path] = 0
        else:
            _stored[path] += written
    except OSError:
        pass


def _trim(path: str) -> None:
    with os.scandir(path) as entries:
        files = [(entry.stat().st_mtime, entry.stat().st_size, entry.path) for entry in entries if entry.is_file(follow_symlinks=False)]
    total = sum(size for _, size, _ in files)
    for written, size, name in sorted(files):
        unfinished = not name.endswith(SUFFIX) and time.time() - written > 3600
        if total > MAX_FOLDER_BYTES or unfinished:
            os.unlink(name)
            total -= size
