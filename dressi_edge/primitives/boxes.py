"""In which pixels of an atlas each triangle is named, from which triangle each pixel shows: what bounds the sums of gradients."""
from __future__ import annotations

import numpy as np

from ..cache.errors import InputError


def boxes(rast: np.ndarray, count: int, columns: int, beside: int = 0) -> np.ndarray:
    """(views x triangles, 4) int32: x0, y0, x1, y1, half open, in an atlas of so many columns; zeros for triangles that no pixel names.
    rast: (views, height, width, 4), channel 3 is triangle + 1. beside: pixels to the left and above that may name a triangle too. Raises
    InputError where a pixel names a triangle that there is not."""
    views, height, width, _ = rast.shape
    with np.errstate(invalid="ignore"):
        ids = rast[..., 3].astype(np.int64)
    if ids.size and not 0 <= ids.min() <= ids.max() <= count:
        raise InputError(f"rast names triangle {ids.max() - 1 if ids.max() > count else ids.min() - 1}; there are 0 to {count - 1}")
    out = np.zeros((views * count, 4), np.int32)
    # Of several values for one place the last is what stays: pixels in order give the last row, in reverse the first.
    for low, high, across in ((1, 3, False), (0, 2, True)):
        order = ids.transpose(0, 2, 1) if across else ids
        view, at, _ = np.nonzero(order)
        entry = view * count + order[order > 0] - 1
        out[entry, high] = at + 1
        out[entry[::-1], low] = at[::-1]
    named = out[:, 3] > 0
    view = np.repeat(np.arange(views), count)
    out[:, :2] = np.maximum(out[:, :2] - beside, 0)
    corner = np.stack([view % columns * width, view // columns * height], 1)
    out[:, :2] += corner.astype(np.int32)
    out[:, 2:] += corner.astype(np.int32)
    out[~named] = 0
    return out
