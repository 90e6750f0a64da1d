"""A session's values and counters as a file: what `Session.checkpoint` writes and `Session.restore` reads.

In: the bundle's digest, a description and the bytes of images. Out: a file that is whole or not there, and back, checked before
anything is used.

A file, little-endian: "DRESSICP", u32 version 1, u32 bytes of the description, the bundle's SHA-256 (32 bytes), SHA-256 of all
that follows, then the description, msgpack {"phase": str or nil, "runs": {phase: int}, "values": [[name, bytes]]}, then the
bytes of each value's image as the device holds them, rows from the top, in that order, without gaps.
"""
from __future__ import annotations

import errno
import hashlib
import os
import struct
from typing import NamedTuple

import msgpack

from ..cache.errors import BundleError, InputError
from ..cache.files import read_regular, replace_file

MAGIC = b"DRESSICP"
VERSION = 1
HEADER = struct.Struct("<8sII32s32s")
MAX_DESCRIPTION = 1 << 20


class Checkpoint(NamedTuple):
    """phase: the current one. runs: iterations done of each phase. values: {name: the bytes of its image}."""

    phase: str | None
    runs: dict[str, int]
    values: dict[str, bytes]


def dumps(checkpoint: Checkpoint, bundle_digest: str) -> list[bytes]:
    """The file's bytes, in parts."""
    text = msgpack.packb({"phase": checkpoint.phase, "runs": checkpoint.runs,
                          "values": [[name, len(data)] for name, data in checkpoint.values.items()]})
    parts = [text, *checkpoint.values.values()]
    sha = hashlib.sha256()
    for part in parts:
        sha.update(part)
    return [HEADER.pack(MAGIC, VERSION, len(text), bytes.fromhex(bundle_digest), sha.digest()), *parts]


def write(path: str | os.PathLike, parts: list[bytes]) -> None:
    """Replace the file by these bytes. Raises InputError; the old file is then as it was."""
    try:
        replace_file(path, *parts)
    except OSError as e:
        raise InputError(f"{os.fspath(path)}: the checkpoint cannot be written: {e.strerror or e}") from None


def read(path: str | os.PathLike, bundle_digest: str, limit: int) -> Checkpoint:
    """The checkpoint in a regular file of at most `limit` bytes of images. Raises InputError if there is no such file, BundleError
    if it is damaged or of another bundle."""
    where, limit = os.fspath(path), HEADER.size + MAX_DESCRIPTION + limit
    try:
        data = read_regular(path, limit)
    except OSError as e:
        if e.errno == errno.EFBIG:
            raise BundleError(f"{where}: more than the {limit} bytes that a checkpoint of this bundle can have") from None
        raise InputError(f"{where}: the checkpoint cannot be read: {e.strerror or e}") from None
    try:
        return loads(data, bundle_digest)
    except BundleError as e:
        raise BundleError(f"{where}: {e}") from None


def loads(data: bytes, bundle_digest: str) -> Checkpoint:
    """The checkpoint in these bytes; which values and sizes a bundle has is the caller's to check. Raises BundleError."""
    if len(data) < HEADER.size:
        raise BundleError(f"{len(data)} bytes; a checkpoint has at least {HEADER.size}")
    magic, version, size, bundle, sha = HEADER.unpack_from(data)
    if magic != MAGIC:
        raise BundleError("not a checkpoint: the file does not begin with DRESSICP")
    if version != VERSION:
        raise BundleError(f"checkpoint version {version}; this reader knows {VERSION}")
    rest = memoryview(data)[HEADER.size:]
    if hashlib.sha256(rest).digest() != sha:
        raise BundleError("the checksum does not match: the checkpoint is damaged")
    if bundle.hex() != bundle_digest:
        raise BundleError(f"the checkpoint belongs to the bundle with SHA-256 {bundle.hex()}; this one has {bundle_digest}")
    if size > min(len(rest), MAX_DESCRIPTION):
        raise BundleError(f"a description of {size} bytes; {min(len(rest), MAX_DESCRIPTION)} are allowed")
    try:
        d = msgpack.unpackb(rest[:size], raw=False, strict_map_key=True)
        phase, runs, sizes = d["phase"], dict(d["runs"]), [(name, count) for name, count in d["values"]]
        typed = ((phase is None or type(phase) is str) and len(d) == 3
                 and all(type(k) is str and type(n) is int and n >= 0 for k, n in (*runs.items(), *sizes)))
    except Exception:  # noqa: BLE001 msgpack raises many kinds
        typed = False
    if not typed:
        raise BundleError("the description is not that of a checkpoint")
    if sum(n for _, n in sizes) != len(rest) - size or len(dict(sizes)) != len(sizes):
        raise BundleError(f"values of {sum(n for _, n in sizes)} bytes are named, {len(rest) - size} are there, each once")
    values, at = {}, size
    for name, count in sizes:
        values[name] = bytes(rest[at:at + count])
        at += count
    return Checkpoint(phase, runs, values)
