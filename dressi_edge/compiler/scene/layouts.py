"""How a user's arrays lie in images (cache/layout.py), told from their shapes; and the other way round, from nodes."""
from __future__ import annotations

from collections.abc import Iterable

from ...cache.errors import InputError
from ...cache.layout import Layout, table_size
from ..graph.ir import Node, vector_type
from ..render.atlas import Atlas

KINDS = ("unit", "table", "image", "pictures")


def layout_of(shape: tuple[int, ...], views: Atlas, who: str, kind: str | None = None, integer: bool = False) -> Layout:
    """Of an array: () or (c,) with c to 4 is one value; (n,) and (n, c) a table; (h, w, c) an image; (views, h, w) and (views, h, w, c)
    pictures of all views. kind, one of KINDS, says so where a shape could be either, and (h, w) is an image. Raises InputError."""
    n = len(shape)
    if kind not in (None, *KINDS):
        raise InputError(f"{who}: kind is {kind!r:.40}; allowed: {' '.join(KINDS)}")
    pictures = (views.views, views.height, views.width)
    if kind is None:
        kind = ("unit" if n == 0 or n == 1 and shape[0] <= 4 else "table" if n in (1, 2) else
                "pictures" if n == 4 or n == 3 and shape == pictures else "image")
    plain = {"unit": 0, "table": 1, "image": 2, "pictures": 3}[kind]  # axes beside the channels
    if n not in (plain, plain + 1) or any(k < 1 for k in shape) or n == plain + 1 and shape[-1] > 4:
        raise InputError(f"{who} has shape {shape}; as {kind} it needs {_NEEDED[kind]}, with 1 to 4 channels")
    vtype = vector_type(shape[-1] if n == plain + 1 else 1, integer)
    if kind == "unit":
        return Layout("unit", vtype)
    if kind == "table":
        return Layout("table", vtype, count=shape[0])
    if kind == "image":
        return Layout("image", vtype, shape[1], shape[0])
    if shape[:3] != pictures:
        raise InputError(f"{who} has shape {shape}; pictures of all views are {pictures} and channels")
    return pictures_layout(views, vtype)


_NEEDED = {"unit": "() or (channels,)", "table": "(n,) or (n, channels)", "image": "(height, width) or (height, width, channels)",
           "pictures": "(views, height, width) or (views, height, width, channels)"}


def pictures_layout(atlas: Atlas, vtype: str) -> Layout:
    """Of pictures in an atlas."""
    return Layout("atlas", vtype, atlas.width, atlas.height, atlas.views, atlas.columns)


def layout_for(node: Node, atlases: Iterable[Atlas]) -> Layout:
    """Of a node: pictures where it is as large as one of the atlases, else one value, a table or an image."""
    extent = node.extent
    for atlas in atlases:
        if extent == atlas.extent and extent.count > 1:
            return pictures_layout(atlas, node.vtype)
    if extent.width * extent.height == 1:
        return Layout("unit", node.vtype)
    if (extent.width, extent.height) == table_size(extent.count):
        return Layout("table", node.vtype, count=extent.count)
    return Layout("image", node.vtype, extent.width, extent.height)
