"""Files read as one piece, and files replaced whole or not at all."""
from __future__ import annotations

import errno
import os
import stat
import sys
import time

# A pipe or a device would block when it is opened; what the name stands for is asked of the opened file, not before.
READ_FLAGS = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0) | getattr(os, "O_BINARY", 0) \
    | getattr(os, "O_CLOEXEC", 0)
FLAGS = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0) | getattr(os, "O_CLOEXEC", 0)
WINDOWS = os.name == "nt"
BUSY_SECONDS = 2.0  # that a replacement waits for readers there


def read_regular(path: str | os.PathLike, limit: int, flags: int = 0, allowed=None) -> bytes:
    """The bytes of a regular file of at most `limit`, opened once and never waited for. `flags`: more of `os.open`. `allowed(status)`:
    why a file with this `os.fstat` is not to be read, or "". Raises OSError, with errno EFBIG where the file is larger."""
    try:
        handle = os.open(path, READ_FLAGS | flags)
    except ValueError:  # a NUL, or what no file system can name
        raise OSError(errno.EINVAL, "it is no path") from None
    try:
        found = os.fstat(handle)
        if stat.S_ISDIR(found.st_mode):
            raise OSError(errno.EISDIR, f"{os.strerror(errno.EISDIR)}; it is no regular file")
        if not stat.S_ISREG(found.st_mode):
            raise OSError(errno.EINVAL, "it is no regular file")
        if allowed is not None and (why := allowed(found)):
            raise OSError(errno.EPERM, why)
        if found.st_size > limit:
            raise OSError(errno.EFBIG, f"it has {found.st_size} bytes; at most {limit} are allowed")
        with open(handle, "rb", closefd=False) as f:
            data = f.read(limit + 1)  # it may grow meanwhile
    finally:
        os.close(handle)
    if len(data) > limit:
        raise OSError(errno.EFBIG, f"it has more than {limit} bytes; at most so many are allowed")
    return data


def replace_file(path: str | os.PathLike, *parts: bytes, mode: int = 0o666, lasting: bool = True) -> None:
    """Write beside the file, then put it in its place: a reader sees the old one or the new one, where it is `lasting`, which waits for
    the disk, after a power cut too. A process killed here leaves at worst a hidden `.NAME.*.part`. mode: less what umask takes. Raises
    OSError; the old file is then as it was."""
    folder, base = os.path.split(os.path.abspath(path))
    name = os.path.join(folder, f".{base[:100]}.{os.getpid()}-{os.urandom(6).hex()}.part")
    with open(os.open(name, FLAGS, mode), "wb") as f:
        try:
            f.writelines(parts)
            if lasting:
                f.flush()
                _to_disk(f.fileno())
        except BaseException:
            _remove(name)
            raise
    try:
        _exchange(name, path)
    except BaseException:
        _remove(name)
        raise
    if lasting:
        _sync_folder(folder)


def _exchange(name: str, path: str | os.PathLike) -> None:
    """Put a file in the place of another. On Windows a file that somebody reads, a virus scanner too, cannot be replaced: wait for it."""
    end = time.monotonic() + BUSY_SECONDS
    while True:
        try:
            return os.replace(name, path)
        except PermissionError:
            if not WINDOWS or time.monotonic() > end:
                raise
            time.sleep(0.02)


def _to_disk(handle: int) -> None:
    """macOS's fsync hands the bytes to the disk, which may keep them; F_FULLFSYNC has it write them."""
    if sys.platform == "darwin":
        import fcntl
        try:
            fcntl.fcntl(handle, fcntl.F_FULLFSYNC)
            return
        except OSError:  # not every file system can
            pass
    os.fsync(handle)


def _remove(name: str) -> None:
    try:
        os.unlink(name)
    except OSError:
        pass


def _sync_folder(folder: str) -> None:
    """So that the new name survives a power cut; not every system can."""
    try:
        handle = os.open(folder, os.O_RDONLY)
    except OSError:
        return
    try:
        os.fsync(handle)
    except OSError:
        pass
    finally:
        os.close(handle)
