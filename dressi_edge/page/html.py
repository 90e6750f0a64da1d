"""The page's data to one HTML file. Nothing in it is fetched from anywhere: style, programs, model and pictures are inside.

In: plain values, as facts.py and result.py give them, and a GLB. Out: the file's bytes. Names in the data come from somebody's bundle: they
are escaped here, and the page writes them as text alone.
"""
from __future__ import annotations

import base64
import html
import json
from collections.abc import Mapping
from importlib import resources

from ..cache.errors import InputError

OFFLINE = "default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"
LIVE = OFFLINE + "; connect-src 'self'"
MAX_MODEL = 200 << 20  # bytes; a browser takes a text of about 500 MB


def page(data: Mapping, model: bytes | None = None, live: bool = False) -> bytes:
    """One HTML file. data: see page.js for its keys, all may be missing; model: a GLB; live: may ask the server it came from for news.
    Raises InputError where the model is too large for a page."""
    if model is not None and len(model) > MAX_MODEL:
        raise InputError(f"the model has {len(model) / 1e6:.0f} MB; a page can hold {MAX_MODEL / 1e6:.0f} MB; take a smaller "
                         "texture or fewer faces")
    parts = {"policy": LIVE if live else OFFLINE, "title": html.escape(str(data.get("title", "dressi_edge"))),
             "style": _asset("style.css"), "viewer": _asset("viewer.js"), "page": _asset("page.js"), "data": script_json(data),
             "model": base64.b64encode(model).decode() if model else ""}
    pieces = _asset("page.html").split("@")  # text and names take turns
    return "".join(parts[piece] if k % 2 else piece for k, piece in enumerate(pieces)).encode()


def script_json(value) -> str:
    """JSON that may stand in a script element: nothing in it ends the element or begins a comment."""
    return json.dumps(value, allow_nan=False, ensure_ascii=True, separators=(",", ":")).replace("<", "\\u003c").replace(">", "\\u003e")


def _asset(name: str) -> str:
    return resources.files(__package__).joinpath(name).read_text(encoding="utf-8")
