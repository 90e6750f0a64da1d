"""What a scene keeps of its parameters, and what it asks of arrays that it is given."""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...cache.errors import InputError
from ...cache.layout import beyond_fp32
from ..graph.ir import Node
from ..graph.ops.reduce import mean
from ..graph.program import Program
from ..graph.reference import evaluate
from ..io.cameras import Camera
from ..io.mesh import middle_of
from ..render.part import Part

GAINS = (0.1, 10.0)  # limits of a view's gain


@dataclass(frozen=True, eq=False)
class Parameter:
    """What can be optimized: its node, limits of its numbers, which entries are free to move (1) and which stay (0), and where it was
    said to be one."""

    node: Node
    low: float | None
    high: float | None
    free: Node | None
    where: str


def narrowed(parameter: Parameter, name: str, start: np.ndarray, low: float | None, high: float | None) -> Parameter:
    """The parameter with limits within those it has. Raises InputError where it starts outside of them."""
    low = parameter.low if low is None or parameter.low is not None and parameter.low > low else low
    high = parameter.high if high is None or parameter.high is not None and parameter.high < high else high
    if low is not None and high is not None and not low < high:
        raise InputError(f"limits of {name}: {low:g} to {high:g}; the first must be below the second")
    least, most = float(start.min()), float(start.max())
    for x, side, limit in ((least, "below", low), (most, "above", high)):
        if limit is not None and (x < limit if side == "below" else x > limit):
            raise InputError(f"limits of {name}: it starts at {x:g}, which is {side} {limit:g}; start it within its limits, or widen them")
    return replace(parameter, low=low, high=high)


def gains(values: Node) -> Node:
    """A table of (views, 3) over its mean, so that what all views share is the materials'."""
    return values / mean(values)


def numbers(who: str, value, integer: bool = False) -> np.ndarray:
    """As an array of float64, or of integers. Raises InputError, with `who` in front."""
    try:
        array = np.asarray(value, None if integer else float)
    except (TypeError, ValueError):
        raise InputError(f"{who} is {value!r:.60}; numbers are needed") from None
    if integer and array.dtype.kind not in "biu":
        raise InputError(f"{who} has type {array.dtype}; integers are needed")
    if not np.isfinite(array).all():
        raise InputError(f"{who} has NaN or Inf in it; finite numbers are needed")
    if not integer and beyond_fp32(array).any():
        raise InputError(f"{who} has {np.abs(array).max():g} in it; numbers that are finite in fp32 are needed")
    return array


def ball_around(parts: Sequence[Part], program: Program) -> tuple[np.ndarray, float]:
    """A quarter more than the ball around all vertices as they start."""
    starts = {v.node.attrs["name"]: v.layout.to_image(v.initial, "start") for v in program.values.values()
              if v.initial is not None and v.node.op.held}
    rows = evaluate([part.positions for part in parts], starts)
    points = np.concatenate([x.reshape(-1, 3)[:len(part.mesh.positions)] for x, part in zip(rows, parts)])
    middle = middle_of(points)
    return middle, 1.25 * max(float(np.linalg.norm(points - middle, axis=1).max()), 1e-6)


def padded(pictures: Sequence[np.ndarray], cameras: Sequence[Camera], size: tuple[int, int], fill: float) -> np.ndarray:
    """`Scene.padded`; size: (width, height) of what each lies in."""
    arrays = [numbers(f"picture {k}", x) for k, x in enumerate(pictures)]
    if len(arrays) != len(cameras):
        raise InputError(f"{len(arrays)} pictures for {len(cameras)} cameras; one for each is needed")
    tail = arrays[0].shape[2:]
    for k, (x, c) in enumerate(zip(arrays, cameras)):
        if x.shape != (c.height, c.width, *tail) or len(tail) > 1:
            raise InputError(f"picture {k} has shape {x.shape}; its camera's is {(c.height, c.width)}, with as many channels as the "
                             "others have")
    out = np.full((len(arrays), size[1], size[0], *tail), float(fill))
    for view, x in zip(out, arrays):
        view[:x.shape[0], :x.shape[1]] = x
    return out
