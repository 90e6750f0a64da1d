"""Files replaced whole or not at all."""
from __future__ import annotations

import os

FLAGS = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0) | getattr(os, "O_CLOEXEC", 0)


def replace_file(path: str | os.PathLike, *parts: bytes) -> None:
    """Write beside the file, then put it in its place, on the disk before its name is: a reader sees the old one or the new one,
    after a power cut too. A process killed here leaves at worst a hidden `.NAME.*.part`. The mode is as umask has it. Raises
    OSError; the old file is then as it was."""
    folder, base = os.path.split(os.path.abspath(path))
    name = os.path.join(folder, f".{base[:100]}.{os.getpid()}-{os.urandom(6).hex()}.part")
    with open(os.open(name, FLAGS, 0o666), "wb") as f:
        try:
            f.writelines(parts)
            f.flush()
            os.fsync(f.fileno())
        except BaseException:
            _remove(name)
            raise
    try:
        os.replace(name, path)
    except BaseException:
        _remove(name)
        raise
    _sync_folder(folder)


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
