"""The visual hull of masks (Laurentini 1994): cameras and alphas in; where it lies, and how deep points are in it, out.

The depth of a point is the least over the views of its signed distance to the mask's rim, in the scene's unit; where a mask goes on beyond
its picture, that view says nothing of what it does not show.
"""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...cache.errors import InputError
from .cameras import Camera
from .needs import needed
from .views import Views

COARSE = 40  # cells a side of the grid that looks for the hull
GROWTH = 1.7
ROUNDS = 8
CHUNK = 1 << 15  # points at once, which stay in a cache of the processor
RAYS, SAMPLES = 64, 128  # of each view, and along each ray, where masks are asked whether they agree


@dataclass(frozen=True, eq=False)
class Rim:
    """One view's mask. inside: (h, w) float32, each pixel's distance to the rim in pixels, negative outside. cut: whether the mask goes on
    beyond the picture."""

    camera: Camera
    inside: np.ndarray
    cut: bool

    @staticmethod
    def of(camera: Camera, alpha: np.ndarray) -> Rim:
        distance = needed("scipy.ndimage").distance_transform_edt
        covered = alpha >= 0.5
        if covered.all() or not covered.any():
            inside = np.full(alpha.shape, 1.0 if covered.all() else -1.0) * sum(alpha.shape)
        else:
            inside = np.where(covered, distance(covered) - 0.5, 0.5 - distance(~covered))
            inside = np.where(np.abs(inside) < 1.0, np.clip(alpha - 0.5, -0.5, 0.5), inside)  # where coverage tells more
        return Rim(camera, inside.astype(np.float32), any(edge.any() for edge in (covered[0], covered[-1], covered[:, 0], covered[:, -1])))

    def depth(self, points: np.ndarray) -> np.ndarray:
        """(n,) of points (n, 3): inside the mask's cone, in the scene's unit; inf where this view says nothing."""
        c = self.camera
        x, y, z = (c.world_to_camera[:3, :3] @ points.T + c.world_to_camera[:3, 3:]).astype(np.float32)
        ahead = -z
        if c.kind == "orthographic":
            w, seen = np.ones_like(ahead), np.ones(len(ahead), bool)
        else:
            seen = ahead > c.near
            w = np.where(seen, ahead, 1.0)
        u, v = c.cx + c.fx * x / w - 0.5, c.cy - c.fy * y / w - 0.5
        cu, cv = np.clip(u, 0.0, c.width - 1.0), np.clip(v, 0.0, c.height - 1.0)
        i, j = np.minimum(cv.astype(np.int64), max(c.height - 2, 0)), np.minimum(cu.astype(np.int64), max(c.width - 2, 0))
        down, right = np.minimum(i + 1, c.height - 1), np.minimum(j + 1, c.width - 1)
        fv, fu = cv - i, cu - j
        a = self.inside
        pixels = (a[i, j] * (1 - fu) + a[i, right] * fu) * (1 - fv) + (a[down, j] * (1 - fu) + a[down, right] * fu) * fv
        beyond = np.hypot(u - cu, v - cv)
        pixels = np.where(beyond > 0.5, np.inf if self.cut else pixels - beyond, pixels)
        return np.where(seen, pixels * w / min(c.fx, c.fy), -np.inf)


def rims(views: Views) -> list[Rim]:
    """Of the views whose mask is neither empty nor the whole picture. Raises InputError where there are less than two."""
    found = [Rim.of(camera, views.picture(k)[..., 3]) for k, (camera, mask) in enumerate(zip(views.cameras, views.masks))
             if mask.box is not None and not mask.full]
    if len(found) < 2:
        raise InputError(f"a hull needs masks in two views or more; {len(found)} of {len(views)} views have one that is neither empty nor "
                         "the whole picture")
    return found


def depth(of: Sequence[Rim], points: np.ndarray, floor: float = -np.inf, misses: int = 0) -> np.ndarray:
    """(n,) of points (n, 3): how deep they are in the hull, negative outside; somewhere below `floor` where they are less deep than that.
    What no view shows is outside. misses: so many views may lack a point: their least depths do not count."""
    out = np.empty(len(points), np.float32)
    for k in range(0, len(points), CHUNK):
        part = points[k:k + CHUNK]
        least, left = np.full((misses + 1, len(part)), np.inf, np.float32), np.arange(len(part))  # the least first
        for rim in of:
            new = rim.depth(part[left])
            for row in least:
                old = row[left]
                row[left], new = np.minimum(old, new), np.maximum(old, new)
            left = left[least[-1, left] >= floor]
        found = np.where(np.isfinite(least[-1]), least[-1], least[0])  # of what so few views see, all count
        out[k:k + CHUNK] = np.where(np.isfinite(found), found, -np.inf)
    return out


def grid(low: np.ndarray, high: np.ndarray, step: float) -> tuple[np.ndarray, tuple[int, int, int]]:
    """Points (n, 3) `step` apart from low to high or just beyond, x slowest, and how many there are along each axis."""
    counts = tuple(int(n) + 1 for n in np.ceil((high - low) / step - 1e-9))
    axes = [low[k] + step * np.arange(counts[k]) for k in range(3)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3), counts


def bounds(of: Sequence[Rim], misses: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest corner (3,) of a box around the hull (`depth`). Raises InputError where the masks have nothing in common, or do
    not bound it."""
    middle, radius = _guess(of)
    low, high = middle - radius, middle + radius
    for _ in range(ROUNDS):
        step = float((high - low).max()) / COARSE
        points, _ = grid(low, high, step)
        inside = depth(of, points, -0.87 * step, misses) > -0.87 * step  # a cell's half diagonal: nothing thinner is lost
        if not inside.any():
            raise InputError("the masks have no point in common: cameras and masks do not belong together, or a mask lacks the object")
        a, b = points[inside].min(axis=0) - step, points[inside].max(axis=0) + step
        ends = (a < low - 1e-9) | (b > high + 1.01 * step)
        if not ends.any():
            if (b - a).max() > 0.6 * (high - low).max():
                return a, b
            low, high = a, b
        else:
            centre, half = (a + b) / 2.0, GROWTH * (high - low).max() / 2.0
            low, high = centre - half, centre + half
    raise InputError("the masks do not bound the object: it goes on beyond the pictures, or all cameras look from one side; give "
                     "views.normalize = {center = [...], radius = ...}")


def _guess(of: Sequence[Rim]) -> tuple[np.ndarray, float]:
    """About where and how large the object is: the point nearest to the rays through the masks' middles, and the largest of their boxes."""
    rows, sizes = [], []
    for rim in of:
        c = rim.camera
        at = np.argwhere(rim.inside > 0.0)
        (top, left), (bottom, right) = at.min(axis=0), at.max(axis=0) + 1
        u, v = (left + right) / 2.0, (top + bottom) / 2.0
        ray = np.array([(u - c.cx) / c.fx, (c.cy - v) / c.fy, -1.0])
        eye = c.position
        if c.kind == "orthographic":
            eye, ray = c.camera_to_world[:3, :3] @ (ray[0], ray[1], 0.0) + c.position, np.array([0.0, 0.0, -1.0])
        ray = c.world_to_camera[:3, :3].T @ ray
        rows.append((np.eye(3) - np.outer(ray, ray) / (ray @ ray), eye))
        sizes.append(np.hypot(right - left, bottom - top) / 2.0 / min(c.fx, c.fy))
    eyes = np.mean([eye for _, eye in rows], axis=0)
    middle = eyes + np.linalg.lstsq(sum(a for a, _ in rows), sum(a @ (eye - eyes) for a, eye in rows), rcond=1e-6)[0]
    depths = [1.0 if rim.camera.kind == "orthographic" else abs(float(rim.camera.world_to_camera[2, :3] @ middle
                                                                     + rim.camera.world_to_camera[2, 3])) for rim in of]
    return middle, float(max(np.multiply(sizes, depths))) or 1.0


def ball_of(views: Views) -> tuple[np.ndarray, float]:
    """Centre and radius of a ball around the hull of the views' masks: about the middle of its box, as far as it reaches. InputError."""
    of = rims(views)
    low, high = bounds(of)
    points, _ = grid(low, high, float((high - low).max()) / COARSE)
    inside = points[depth(of, points, 0.0) > 0.0]
    if not len(inside):
        inside = np.stack([low, high])
    centre = (inside.min(axis=0) + inside.max(axis=0)) / 2.0
    return centre, float(np.linalg.norm(inside - centre, axis=1).max())


def uncovered(of: Sequence[Rim], misses: int = 0) -> float:
    """The share of the masks' pixels behind which nothing of the hull is, nearer than a pixel: 0 where all masks agree. What a mask lacks
    is carved out of the hull, and so is missing from what the others show. Some pixels of each mask, evenly over it, stand for all.
    Raises InputError as `bounds`."""
    low, high = bounds(of, misses)
    middle, half = (low + high) / 2.0, float(np.linalg.norm(high - low)) / 2.0
    bare = []
    for rim in of:
        c = rim.camera
        at = np.argwhere(rim.inside > 1.0)
        at = at[np.linspace(0, len(at) - 1, min(RAYS, len(at))).astype(np.int64)] + 0.5
        screen = np.stack([(at[:, 1] - c.cx) / c.fx, (c.cy - at[:, 0]) / c.fy, np.zeros(len(at))], axis=1)
        ahead = -float(c.world_to_camera[2, :3] @ middle + c.world_to_camera[2, 3])
        depths = np.linspace(ahead - half, ahead + half, SAMPLES)
        if c.kind != "orthographic":
            depths = np.maximum(depths, c.near)
        across = screen[:, None] * (1.0 if c.kind == "orthographic" else depths[None, :, None])
        points = c.position + (across - depths[None, :, None] * (0.0, 0.0, 1.0)) @ c.world_to_camera[:3, :3]
        near = 2.0 * half / SAMPLES / 2.0 + (1.0 if c.kind == "orthographic" else ahead) / min(c.fx, c.fy)
        flat = points.reshape(-1, 3)
        found = np.zeros(len(flat), bool)
        box = np.flatnonzero(((flat > low - near) & (flat < high + near)).all(axis=1))
        found[box] = depth(of, flat[box], -near, misses) > -near
        bare.append(~found.reshape(len(at), SAMPLES).any(axis=1))
    return float(np.concatenate(bare).mean())
