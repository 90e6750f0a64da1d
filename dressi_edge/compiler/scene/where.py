"""Where in the user's own code something was said, for errors."""
from __future__ import annotations

import os
import sys
from collections.abc import Callable

PACKAGE = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))


def caller() -> str:
    """"file.py:12" of the line outside this package that is being carried out."""
    frame = sys._getframe(1)
    while frame is not None and os.path.abspath(frame.f_code.co_filename).startswith(PACKAGE + os.sep):
        frame = frame.f_back
    return "?" if frame is None else f"{os.path.basename(frame.f_code.co_filename)}:{frame.f_lineno}"


def place(made: Callable) -> str:
    """A function's name and where it is written, or what kind of record it is."""
    code = getattr(made, "__code__", None)
    if code is None:
        return type(made).__name__
    return f"{made.__name__.strip('<>')} at {os.path.basename(code.co_filename)}:{code.co_firstlineno}"
