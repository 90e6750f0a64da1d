"""Libraries that only some inputs need; what is missing is named with how to get it."""
from __future__ import annotations

import importlib
from types import ModuleType

from ...cache.errors import InputError


def needed(module: str) -> ModuleType:
    """The module, of one of the libraries of the extra `hull`. Raises InputError."""
    try:
        return importlib.import_module(module)
    except ImportError:
        raise InputError(f"a visual hull needs {module.partition('.')[0]}, which is not installed; "
                         "pip install 'dressi_edge[hull]'") from None
