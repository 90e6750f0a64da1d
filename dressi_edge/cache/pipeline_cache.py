"""Compiled pipelines kept from one process to the next: the blobs of VkPipelineCache as files. Pure logic, no Vulkan.

In: a folder, a `Key` (bundle, device, driver) and the driver's blob. Out: the blob again, or None. A file is only ever whole or
not there; whatever is truncated, damaged or of another device is ignored before a driver sees it, and a folder that cannot be
read or written costs time, never an error.

A file, little-endian: "DRESSIPC", u32 version 1, u32 0, u64 bytes of the blob, SHA-256 of the key, SHA-256 of the blob,
the blob.
"""
from __future__ import annotations

import hashlib
import os
import stat
import struct
import time
from typing import NamedTuple

MAGIC = b"DRESSIPC"
VERSION = 1
HEADER = struct.Struct("<8sIIQ32s32s")
DRIVER_HEADER = struct.Struct("<IIII16s")  # VkPipelineCacheHeaderVersionOne: bytes, version, vendor, device, UUID
SUFFIX = ".pipelines"
MAX_FOLDER_BYTES = 64 << 20
STALE_SECONDS = 3600  # an unfinished file this old belongs to a process that is gone


class Key(NamedTuple):
    """What a blob depends on. bundle: its digest. driver: every word the driver says of itself (name, version in words, UUIDs);
    lavapipe has the same `uuid` and `driver_version` in every release of Mesa."""

    bundle: str
    vendor_id: int
    device_id: int
    driver_version: int
    uuid: bytes
    driver: str

    @property
    def digest(self) -> bytes:
        return hashlib.sha256(repr(tuple(self)).encode()).digest()

    @property
    def file(self) -> str:
        """The name of the file in its folder."""
        return self.digest.hex()[:40] + SUFFIX


def key(bundle_digest: str, vendor_id: int, device_id: int, driver_version: int, pipeline_cache_uuid: bytes | str,
        *driver: str) -> Key:
    """The key of a bundle on a device; UUIDs as bytes or hexadecimal."""
    uuid = bytes.fromhex(pipeline_cache_uuid) if isinstance(pipeline_cache_uuid, str) else bytes(pipeline_cache_uuid)
    return Key(bundle_digest, vendor_id, device_id, driver_version, uuid, "\n".join(driver))


def default_folder() -> tuple[str | None, str]:
    """The folder to use, or None and why there is none: $DRESSI_CACHE ("off": no folder), $XDG_CACHE_HOME/dressi_edge or
    ~/.cache/dressi_edge."""
    chosen = os.environ.get("DRESSI_CACHE", "")
    if chosen == "off":
        return None, "DRESSI_CACHE=off"
    base = os.environ.get("XDG_CACHE_HOME", "")
    if not os.path.isabs(base):  # its specification: a relative path is invalid and to be ignored
        base = os.path.expanduser(os.path.join("~", ".cache"))
    folder = os.path.expanduser(chosen) if chosen else os.path.join(base, "dressi_edge")
    return (None, "there is no home folder") if folder.startswith("~") else (folder, "")


def belongs(data: bytes, k: Key) -> bool:
    """Whether a driver's blob begins with Vulkan's header, of the device of this key."""
    if len(data) < DRIVER_HEADER.size:
        return False
    size, version, vendor, device, uuid = DRIVER_HEADER.unpack_from(data)
    return DRIVER_HEADER.size <= size <= len(data) and (version, vendor, device, uuid) == (1, k.vendor_id, k.device_id, k.uuid)


def load(folder: str | os.PathLike, k: Key) -> bytes | None:
    """The blob stored under a key, marked as used; None unless it is there, whole and of this device. Never raises OSError."""
    path = os.path.join(folder, k.file)
    try:
        status = os.stat(path)
        if not stat.S_ISREG(status.st_mode) or not HEADER.size <= status.st_size <= MAX_FOLDER_BYTES:
            return None  # a pipe would wait for ever
        with open(path, "rb") as f:
            text = f.read(MAX_FOLDER_BYTES + 1)
    except OSError:
        return None
    data = text[HEADER.size:]
    head = (MAGIC, VERSION, 0, len(data), k.digest, hashlib.sha256(data).digest())
    if text[:HEADER.size] != HEADER.pack(*head) or not belongs(data, k):
        return None
    try:
        os.utime(path)
    except OSError:
        pass
    return data


def store(folder: str | os.PathLike, k: Key, data: bytes, limit: int = MAX_FOLDER_BYTES) -> str:
    """Keep a blob under a key, and remove the files used least recently until the folder has at most `limit` bytes of them.
    Returns "" or why it was not kept; never raises OSError."""
    if not belongs(data, k):
        return "the driver's blob is not of this device"
    if HEADER.size + len(data) > limit:
        return f"the driver's blob has {len(data)} bytes; {limit - HEADER.size} are allowed"
    name = os.path.join(folder, f".{os.getpid()}-{os.urandom(8).hex()}{SUFFIX}")
    made = False
    try:
        os.makedirs(folder, mode=0o700, exist_ok=True)
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0) | getattr(os, "O_CLOEXEC", 0)
        with open(os.open(name, flags, 0o600), "wb") as f:
            made = True
            f.write(HEADER.pack(MAGIC, VERSION, 0, len(data), k.digest, hashlib.sha256(data).digest()) + data)
        os.replace(name, os.path.join(folder, k.file))
    except OSError as e:
        if made:
            _remove(name)
        return f"{os.fspath(folder)}: {e.strerror or e}"
    _trim(folder, k.file, limit)
    return ""


def _trim(folder: str | os.PathLike, kept: str, limit: int) -> None:
    """Other processes may store and trim at the same time: what is gone is gone."""
    files, total, now = [], 0, time.time()
    try:
        with os.scandir(folder) as entries:
            for entry in entries:
                if not entry.name.endswith(SUFFIX):
                    continue  # not ours
                try:
                    status = entry.stat(follow_symlinks=False)
                except OSError:
                    continue
                if not stat.S_ISREG(status.st_mode):
                    continue
                if entry.name.startswith("."):
                    if now - status.st_mtime > STALE_SECONDS:
                        _remove(entry.path)
                    continue
                total += status.st_size
                if entry.name != kept:
                    files.append((status.st_mtime_ns, entry.name, entry.path, status.st_size))
    except OSError:
        return
    for _, _, path, size in sorted(files):
        if total <= limit:
            return
        _remove(path)
        total -= size


def _remove(path: str) -> None:
    try:
        os.unlink(path)
    except OSError:
        pass
