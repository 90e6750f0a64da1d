"""Text that people and other programs wrote. In: bytes. Out: plain values within bounds, so that whoever reads on need not fear them.

Bounds: how deep it nests, whole numbers of 64 bits, text that can be printed and stored. What breaks one is an InputError of one line.
"""
from __future__ import annotations

import errno
import json
from pathlib import Path

from ...cache.errors import InputError
from ...cache.files import read_regular

MAX_DEPTH = 32
MAX_BYTES = 1 << 28
LONGEST_NAME = 200  # of what an error repeats


def shown(text, most: int = LONGEST_NAME) -> str:
    """A name of the user's for an error: on one line, without what cannot be printed, and not endless."""
    text = str(text)
    text = "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in text[:most + 1])
    return text if len(text) <= most else text[:most] + "..."


def is_file(path: Path) -> bool:
    """Whether there is such a file; False too for names that no file can have."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def is_folder(path: Path) -> bool:
    """Whether there is such a folder; False too for names that none can have."""
    try:
        return path.is_dir()
    except (OSError, ValueError):
        return False


def read_bytes(path: Path, what: str, most: int = MAX_BYTES) -> bytes:
    """All of a regular file of at most `most` bytes; pipes and devices are not waited for. Raises InputError."""
    try:
        return read_regular(path, most)
    except OSError as error:
        if error.errno == errno.EFBIG:
            raise InputError(f"{what} {shown(path)} is larger than the {most} bytes that are allowed; give a smaller file") from None
        raise InputError(f"{what} {shown(path)} cannot be read: {error.strerror or error}; check the path") from None


def parse_json(data: bytes, where: str | Path) -> object:
    """The value of a JSON text in UTF-8, with or without a byte-order mark. NaN and Infinity, which Python writes though JSON has
    neither, become floats for the reader to judge, as do whole numbers beyond 18 digits. Raises InputError."""
    where = shown(where)
    try:
        value = json.loads(data.decode("utf-8-sig"), parse_int=_whole)
    except json.JSONDecodeError as error:
        raise InputError(f"{where} line {error.lineno} column {error.colno}: malformed JSON ({error.msg}); repair it") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{where} is not UTF-8 text ({error.reason} at byte {error.start}); give a JSON file") from None
    except RecursionError:
        raise InputError(f"{where} nests deeper than {MAX_DEPTH} levels; give a flatter file") from None
    bounded(value, where)
    return value


def _whole(text: str) -> int | float:
    return int(text) if len(text) <= 18 else float(text)


def bounded(value, where: str) -> None:
    """Raises InputError, naming `where`, if the value nests too deeply, has a whole number beyond 64 bits, or text that is no Unicode."""
    level, depth = [value], 0
    while level:
        if depth > MAX_DEPTH:
            raise InputError(f"{where} nests deeper than {MAX_DEPTH} levels; give a flatter file")
        inner = []
        for item in level:
            if isinstance(item, dict):
                inner += item.keys()
                inner += item.values()
            elif isinstance(item, list):
                inner += item
            elif isinstance(item, str) and not item.isascii():
                try:
                    item.encode()
                except UnicodeEncodeError:
                    raise InputError(f"{where}: the text {shown(item, 40)!r} has half a surrogate pair, which is no character; "
                                     "write it anew") from None
            elif type(item) is int and not -2 ** 63 <= item < 2 ** 63:
                raise InputError(f"{where}: a whole number of {len(hex(item)) * 4 - 8} bits; at most 64 bits are allowed")
        level, depth = inner, depth + 1
