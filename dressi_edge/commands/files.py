"""What commands need of files and streams, with the standard library alone."""
from __future__ import annotations

import json
import os
import sys

from ..cache.errors import InputError
from ..cache.files import replace_file


def write_file(path: str, data: bytes) -> None:
    """Replaces the file whole or not at all. Raises InputError."""
    try:
        replace_file(path, data)
    except OSError as error:
        raise InputError(f"output {path}: cannot be written: {error.strerror}; choose another path") from None


def check_folder(path: str) -> None:
    """Raises InputError unless the folder that `path` would lie in is there and can be written to."""
    folder = os.path.dirname(os.path.abspath(path))
    if not os.path.isdir(folder):
        raise InputError(f"output {path}: folder {folder} does not exist; create it first")
    if not os.access(folder, os.W_OK):
        raise InputError(f"output {path}: folder {folder} cannot be written to; choose another path")
    if os.path.isdir(path):
        raise InputError(f"output {path} is a folder; name a file")


def print_json(value) -> None:
    """A value on stdout, for programs."""
    json.dump(value, sys.stdout, indent=1, sort_keys=True, allow_nan=False)
    sys.stdout.write("\n")
