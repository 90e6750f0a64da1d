"""Compiled pipelines kept from one process to the next: the blobs of VkPipelineCache as files. Pure logic, no Vulkan.

In: a folder, a `Key` (bundle, device, driver) and the driver's blob. Out: the blob again, or None. A file is only ever whole or
not there; whatever is truncated, damaged or of another device is ignored before a driver sees it, and a folder that cannot be
read or written costs time, never an error.

A driver takes its blob as it takes its own code, and no checksum tells who wrote it. So only what nobody but this user (and root)
could have written reaches a driver: files of ours in a folder of ours, which others may neither write to nor exchange.

A file, little-endian: "DRESSIPC", u32 version 1, u32 0, u64 bytes of the blob, SHA-256 of the key, SHA-256 of the blob,
the blob.
"""
from __future__ import annotations

import hashlib
import os
import stat
import struct
import sys
import time
from typing import NamedTuple

from .files import read_regular

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
        """Of all its parts: what a file begins with and is called by."""
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
    """The folder to use, or None and why there is none: $DRESSI_CACHE ("off": no folder), $XDG_CACHE_HOME/dressi_edge, else where the
    system has caches: ~/.cache/dressi_edge, ~/Library/Caches/dressi_edge, %LOCALAPPDATA%/dressi_edge/cache."""
    chosen = os.environ.get("DRESSI_CACHE", "")
    if chosen == "off":
        return None, "DRESSI_CACHE=off"
    folder = os.path.expanduser(chosen or _system_folder())
    return (None, "there is no home folder") if folder.startswith("~") else (folder, "")


def kept_folder(name: str) -> str | None:
    """A folder of that name in it, made where it is missing; None where nothing is to be kept, or nothing can be trusted."""
    base, _ = default_folder()
    if base is None:
        return None
    path = os.path.join(base, name)
    try:
        os.makedirs(path, mode=0o700, exist_ok=True)
        return None if distrusted(path) else path
    except OSError:
        return None


def _system_folder() -> str:
    """Where this system has the caches of a program."""
    base = os.environ.get("XDG_CACHE_HOME", "")
    if os.path.isabs(base):  # its specification: a relative path is invalid and to be ignored
        return os.path.join(base, "dressi_edge")
    if sys.platform == "win32":
        return os.path.join(os.environ.get("LOCALAPPDATA") or os.path.join("~", "AppData", "Local"), "dressi_edge", "cache")
    return os.path.join("~", *(("Library", "Caches") if sys.platform == "darwin" else (".cache",)), "dressi_edge")


def distrusted(folder: str | os.PathLike) -> str:
    """Why no driver is given a file of this folder, or "": the folder belongs to another, or others may write to it; or they may put
    another folder in its place, because a folder that it lies in, or a link on the way, is theirs or open to them (and not sticky).
    A folder that is not there yet is judged by those it would lie in. On Windows, whose rights are elsewhere, always ""."""
    if not hasattr(os, "geteuid"):
        return ""
    real, me = os.path.realpath(folder), os.geteuid()
    rulers = {me, 0, os.stat("/").st_uid}  # who owns the root may do anything; in a sandbox that is not 0
    for at in (*_way(os.path.abspath(folder)), *_way(real)):
        try:
            found = os.lstat(at)
        except OSError:  # not there yet, or not for us to see
            continue
        if stat.S_ISLNK(found.st_mode):  # as safe as the folder that it is in
            continue
        if found.st_uid not in ({me} if at == real else rulers):
            return f"{at} belongs to another user ({found.st_uid}); set DRESSI_CACHE to a folder of your own"
        private = at != real and found.st_gid == found.st_uid  # a group of the user alone, as many systems make them
        exchanged = at == real or not found.st_mode & stat.S_ISVTX
        if exchanged and found.st_mode & (stat.S_IWOTH if private else stat.S_IWOTH | stat.S_IWGRP):
            return f"{at} can be written to by others; chmod go-w it, or set DRESSI_CACHE to a folder of your own"
    return ""


def _way(path: str) -> list[str]:
    """A path and every folder that it lies in."""
    found = [path]
    while found[-1] != os.path.dirname(found[-1]):
        found.append(os.path.dirname(found[-1]))
    return found


def _not_ours(found: os.stat_result) -> str:
    """Why this file is not read, or ""."""
    if hasattr(os, "geteuid") and (found.st_uid != os.geteuid() or found.st_mode & (stat.S_IWGRP | stat.S_IWOTH)):
        return "it belongs to another user, or others may write to it"
    return ""


def belongs(data: bytes, k: Key) -> bool:
    """Whether a driver's blob begins with Vulkan's header, of the device of this key."""
    if len(data) < DRIVER_HEADER.size:
        return False
    size, version, vendor, device, uuid = DRIVER_HEADER.unpack_from(data)
    return DRIVER_HEADER.size <= size <= len(data) and (version, vendor, device, uuid) == (1, k.vendor_id, k.device_id, k.uuid)


def load(folder: str | os.PathLike, k: Key) -> bytes | None:
    """The blob stored under a key, marked as used; None unless it is there, whole, of this device, and nobody else's to write.
    Never raises OSError."""
    path = os.path.join(folder, k.file)
    try:
        if distrusted(folder):
            return None
        text = read_regular(path, MAX_FOLDER_BYTES, getattr(os, "O_NOFOLLOW", 0), _not_ours)
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
    Returns "" or why it was not kept; never raises OSError. Nothing is put into a folder that others may write to."""
    if not belongs(data, k):
        return "the driver's blob is not of this device"
    if HEADER.size + len(data) > limit:
        return f"the driver's blob has {len(data)} bytes; {limit - HEADER.size} are allowed"
    name = os.path.join(folder, f".{os.getpid()}-{os.urandom(8).hex()}{SUFFIX}")
    made = False
    try:
        os.makedirs(folder, mode=0o700, exist_ok=True)
        if why := distrusted(folder):
            return why
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
