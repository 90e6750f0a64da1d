"""Whether a start makes sense: a mesh and views in; an InputError where nothing can come of it, notes where it only looks wrong.

A mesh that no camera sees has no gradient, and a mask that is everywhere says nothing. Both come from inputs in another convention than
docs/conventions.md: so the usual ones are tried, and one that puts the mesh where the masks are is named with what mends it.
"""
from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...cache.errors import InputError, note
from ..io.cameras import Camera, inverse_rigid
from ..io.mesh import Mesh, middle_of
from ..io.pictures import COVERED, Mask
from ..io.text import shown
from ..io.views import Views

SAMPLES = 4096  # vertices that stand for the mesh
NAMED = 3  # views that a note names


@dataclass(frozen=True)
class Sight:
    """What n views see of a mesh. seen: (n,) whether any face may be in the picture. ahead, nearer, beyond: (n,) what part of the vertices
    is in front of the eye, in front of it but nearer than near, and further than far. boxes: (n, 4) left, top, right, bottom in pixels of
    the vertices in front of near, cut at the picture; NaN where there are none. depth: (least, most) along the view axes of all that is in
    front."""

    seen: np.ndarray
    ahead: np.ndarray
    nearer: np.ndarray
    beyond: np.ndarray
    boxes: np.ndarray
    depth: tuple[float, float]


def sight(mesh: Mesh, cameras: Sequence[Camera], exact: bool = True) -> Sight:
    """How the cameras see the mesh. exact: faces of which no vertex is in a picture are looked at too."""
    points = np.c_[mesh.positions, np.ones(len(mesh.positions))]
    few = points[:: -(-len(points) // SAMPLES)]
    few = np.concatenate([few, points[mesh.positions.argmin(0)], points[mesh.positions.argmax(0)]])
    low, high = mesh.positions.min(axis=0), mesh.positions.max(axis=0)
    corners = np.array([(*np.where(bits, high, low), 1.0) for bits in np.ndindex(2, 2, 2)])
    n = len(cameras)
    seen, boxes = np.zeros(n, bool), np.full((n, 4), np.nan)
    ahead, nearer, beyond = np.zeros(n), np.zeros(n), np.zeros(n)
    least, most = np.inf, -np.inf
    for k, camera in enumerate(cameras):
        x, y, _, w = (few @ camera.clip_rows().T).T
        depth, eye = -(few @ camera.world_to_camera[2]), camera.kind == "perspective"
        front = depth > 0.0 if eye else np.ones(len(few), bool)  # an orthographic camera sees what is behind it too
        visible = depth >= camera.near if eye else front
        ahead[k], nearer[k], beyond[k] = front.mean(), (front & ~visible).mean(), (depth > camera.far).mean()
        if front.any():
            least, most = min(least, float(depth[front].min())), max(most, float(depth[front].max()))
        seen[k] = bool((visible & (np.abs(x) < w) & (np.abs(y) < w)).any())
        seen[k] = seen[k] or exact and bool((~_beyond(corners @ camera.clip_rows().T, camera).all(axis=0)).all()) and _any_face(
            points @ camera.clip_rows().T, mesh.faces, camera)
        if seen[k] and visible.any():
            px, py = (x[visible] / w[visible] + 1.0) / 2.0 * camera.width, (y[visible] / w[visible] + 1.0) / 2.0 * camera.height
            box = np.array([px.min(), py.min(), px.max(), py.max()])
            boxes[k] = np.clip(box, 0.0, [camera.width, camera.height] * 2)
    return Sight(seen, ahead, nearer, beyond, boxes, (least, most))


def _any_face(clip: np.ndarray, faces: np.ndarray, camera: Camera) -> bool:
    """Whether some face may be in the picture: not all its corners are beyond one and the same of its sides, or nearer than near."""
    return bool((~_beyond(clip, camera)[faces].all(axis=1).any(axis=1)).any())


def _beyond(clip: np.ndarray, camera: Camera) -> np.ndarray:
    """(n, 5) of points in clip coordinates: beyond the left, right, upper and lower side of the picture, and nearer than near."""
    x, y, _, w = clip.T
    near = camera.near if camera.kind == "perspective" else -np.inf
    return np.stack([x < -w, x > w, y < -w, y > w, w < near], axis=1)


# ---- conventions

def _turned(axes: Sequence[float]) -> Callable[[np.ndarray], np.ndarray]:
    return lambda pose: pose @ np.diag([*axes, 1.0])


def _moved(rows: Sequence[Sequence[float]]) -> Callable[[np.ndarray], np.ndarray]:
    matrix = np.eye(4)
    matrix[:3, :3] = rows
    return lambda pose: matrix @ pose


def _transposed(pose: np.ndarray) -> np.ndarray:
    pose = pose.copy()
    pose[:3, :3] = pose[:3, :3].T
    return pose


DOWN_FORWARD = np.diag([1.0, -1.0, -1.0, 1.0])  # between a camera with +y up and one with +y down that look the same way
# What was likely meant, what helps, and the right pose camera to world of the given one.
CONVENTIONS: tuple[tuple[str, str, Callable[[np.ndarray], np.ndarray]], ...] = (
    ("the camera looks along +z with y down, as in OpenCV and COLMAP?", "multiply columns 1 and 2 (y and z) of each pose by -1",
     lambda pose: pose @ DOWN_FORWARD),
    ("the poses are world to camera?", "invert each matrix", inverse_rigid),
    ("the poses are world to camera, and the camera looks along +z with y down, as in OpenCV and COLMAP?",
     "invert each matrix, then multiply columns 1 and 2 (y and z) by -1", lambda pose: inverse_rigid(pose) @ DOWN_FORWARD),
    ("the camera looks along +z with y up, as in PyTorch3D and DirectX?", "multiply columns 0 and 2 (x and z) of each pose by -1",
     _turned((-1, 1, -1))),
    ("the rotations are transposed?", "transpose the upper left 3 x 3 of each pose", _transposed),
    ("the rotations are transposed, and the camera looks along +z with y down?",
     "transpose the upper left 3 x 3 of each pose, then multiply its columns 1 and 2 by -1",
     lambda pose: _transposed(pose) @ DOWN_FORWARD),
    ("the mesh has y up, the poses have z up?", "turn the poses by -90 degrees about x: rows x, z, -y",
     _moved(((1, 0, 0), (0, 0, 1), (0, -1, 0)))),
    ("the mesh has z up, the poses have y up?", "turn the poses by 90 degrees about x: rows x, -z, y",
     _moved(((1, 0, 0), (0, 0, -1), (0, 1, 0)))),
    ("y is down in the pictures of these poses?", "multiply columns 0 and 1 (x and y) of each pose by -1", _turned((-1, -1, 1))),
    ("the axes x and y of the world are exchanged?", "exchange rows 0 and 1 of each pose and multiply row 2 by -1",
     _moved(((0, 1, 0), (1, 0, 0), (0, 0, -1)))),
)


def _lens(cameras: Sequence[Camera]) -> Iterator[tuple[str, str, list[Camera]]]:
    """Intrinsics of a picture of another size, where the principal point says so."""
    ratio = float(np.median([(c.cx / c.width + c.cy / c.height) for c in cameras]))
    even = all(abs(c.cx / c.width - c.cy / c.height) < 0.2 * ratio for c in cameras)
    if even and (ratio > 1.5 or 0.0 < ratio < 0.67):
        camera = cameras[0]
        size = f"{2.0 * camera.cx:.0f}x{2.0 * camera.cy:.0f}"
        yield (f"fl_x, fl_y, cx and cy belong to pictures of about {size}, {ratio:.3g} times as large?",
               f"divide them by {ratio:.3g}, or give w and h with pictures of that size",
               [replace(c, fx=c.fx / ratio, fy=c.fy / ratio, cx=c.cx / ratio, cy=c.cy / ratio) for c in cameras])


def _scales(cameras: Sequence[Camera]) -> Iterator[tuple[str, str, list[Camera]]]:
    """Focal lengths of pictures of another size, poses of another unit."""
    for times in (2.0, 4.0, 8.0, 0.5, 0.25, 0.125):
        yield (f"fl_x and fl_y belong to pictures {times:g} times as large?", f"divide them by {times:g}",
               [replace(c, fx=c.fx / times, fy=c.fy / times) for c in cameras])
    for times in (0.1, 0.01, 0.001, 10.0, 100.0, 1000.0):
        poses = [c.world_to_camera * np.pad(np.full((3, 1), times), ((0, 1), (3, 0)), constant_values=1.0) for c in cameras]
        yield (f"the poses are in a unit {max(times, 1 / times):g} times {'smaller' if times < 1 else 'larger'} than the mesh's?",
               f"multiply the positions (column 3) of the poses by {times:g}",
               [replace(c, world_to_camera=pose) for c, pose in zip(cameras, poses)])


def explained(mesh: Mesh, cameras: Sequence[Camera], masks: np.ndarray | None) -> Iterator[tuple[str, str, Sight, float]]:
    """Of each convention: what was likely meant, what helps, the sight it gives, and its agreement with the masks' boxes (n, 4)."""
    turned = ((cause, cure, [replace(c, world_to_camera=inverse_rigid(change(c.camera_to_world))) for c in cameras])
              for cause, cure, change in CONVENTIONS)
    for cause, cure, tried in (*turned, *_lens(cameras), *_scales(cameras)):
        found = sight(mesh, tried, False)
        yield cause, cure, found, agreement(found, masks, tried)


def agreement(found: Sight, masks: np.ndarray | None, cameras: Sequence[Camera]) -> float:
    """How well the mesh lies where the masks are, 0 to 1: intersection over union of their boxes, over the views that have a mask.
    Without masks: how many views see it."""
    if masks is None or not (known := np.isfinite(masks).all(axis=1)).any():
        return float(found.seen.mean())
    a, b = np.nan_to_num(found.boxes[known]), masks[known]
    both = np.prod(np.clip(np.minimum(a[:, 2:], b[:, 2:]) - np.maximum(a[:, :2], b[:, :2]), 0.0, None), axis=1)
    union = np.prod(a[:, 2:] - a[:, :2], axis=1) + np.prod(b[:, 2:] - b[:, :2], axis=1) - both
    return float(np.mean(both / np.maximum(union, 1e-12)))


def mask_boxes(masks: Sequence[Mask]) -> np.ndarray:
    """(n, 4) left, top, right, bottom in pixels of where alpha is half or more; NaN where it nowhere is."""
    return np.array([mask.box or (np.nan,) * 4 for mask in masks], float)


# ---- the checks

def check(mesh: Mesh, views: Views | Sequence[Camera], silhouettes: bool = False, remark: str = "",
          placed: bool = False) -> None:
    """Raises InputError where nothing can come of the start; notes what looks wrong. silhouettes: whether a loss compares with the masks.
    remark: what else may have put the mesh where it is not seen. placed: the mesh is believed to be where and what the object is, such as
    one of a file, and no blob to begin with."""
    with np.errstate(all="ignore"):
        cameras = views.cameras if isinstance(views, Views) else tuple(views)
        names = views.names if isinstance(views, Views) else tuple(f"view {k}" for k in range(len(cameras)))
        found = sight(mesh, cameras)
        masks = None
        if isinstance(views, Views):
            masks = mask_boxes(views.masks)
            _check_masks(views, masks, found, silhouettes)
        _check_place(mesh, cameras, names, found, masks, remark, placed)
        _check_lens(cameras, names)


def _check_masks(views: Views, masks: np.ndarray, found: Sight, silhouettes: bool) -> None:
    highest, full = np.array([mask.highest for mask in views.masks]), np.array([mask.full for mask in views.masks])
    if (highest < COVERED).all():
        what = "0 everywhere" if highest.max() == 0.0 else f"at most {highest.max():.2g}"
        raise InputError(f"the mask is empty: alpha is {what} in {_all(len(views))}; alpha must be 1 where the object is, 0 elsewhere")
    if full.all():
        pixels = np.array([c.width * c.height for c in views.cameras])
        filled = np.nan_to_num(found.boxes[:, 2:] - found.boxes[:, :2]).prod(axis=1) >= 0.95 * pixels
        text = f"alpha is 255 (opaque) everywhere in {_all(len(views))}, so the mask is the whole picture"
        if silhouettes and not filled.all():
            raise InputError(f"{text}, which no silhouette of the mesh can match; save the object's mask as the alpha")
        note(f"{text}; save the object's mask as the alpha, if it has one")
        return
    if empty := _some(highest < COVERED, views.names):
        note(f"the mask is empty in {empty}: alpha is nowhere half or more")
    if whole := _some(full, views.names):
        note(f"alpha is 255 (opaque) everywhere in {whole}, so the mask is the whole picture there")
    if not full.any() and all(mask.border for mask in views.masks):
        note(f"the mask covers the border of {_all(len(views))} and not all inside; is it inverted? alpha must be 1 where the object is")


def _check_place(mesh: Mesh, cameras: Sequence[Camera], names: Sequence[str], found: Sight, masks: np.ndarray | None,
                 remark: str, placed: bool) -> None:
    n, now = len(cameras), agreement(found, masks, cameras)
    wanted = np.ones(n, bool) if masks is None or not np.isfinite(masks).any() else np.isfinite(masks).all(axis=1)
    missing, best, better = wanted & ~found.seen, None, False
    if missing.any() or masks is not None and now < (0.75 if placed else 0.3):
        best = max(explained(mesh, cameras, masks), key=lambda e: (round(e[2].seen[wanted].mean(), 2), round(e[3], 2)))
        better = best[2].seen[wanted].mean() >= 0.9 and best[3] > max(0.1, 2.0 * now)
    if not found.seen.any() or better and missing.mean() > 0.5:
        seen = "no view" if not found.seen.any() else f"{found.seen.sum()} of {n} views"
        raise InputError(f"the mesh is in {seen}: {_why(mesh, cameras, found, best if better else None)}{remark and '; ' + remark}")
    if left := _some(missing, names):
        note(f"the mesh is not in {left}, though there is a mask" if masks is not None else f"the mesh is not in {left}")
    elif placed and best is not None and best[3] > max(0.6 if now < 0.3 else 0.85, now + 0.2):
        note(f"the mesh lies elsewhere than the masks; {best[0]} {best[1]}")
    else:
        _check_size(cameras, found, masks)
    if (found.beyond > 0.0).any():
        note(f"the mesh reaches to {found.depth[1]:.4g} along the view, beyond far = {max(c.far for c in cameras):g}, where what hides "
             "what is not told; set far higher")
    elif (found.nearer > 0.0).any() and (found.ahead > 0.999)[found.nearer > 0.0].all():
        note(f"the mesh comes as near as {found.depth[0]:.4g} along the view, nearer than near = {min(c.near for c in cameras):g}, and is "
             "cut there; set near lower")
    poses = np.stack([c.world_to_camera for c in cameras])
    if n > 2 and np.ptp(poses, axis=0).max() < 1e-9:
        note(f"all {n} cameras have the same pose; are they those of the pictures?")


def _why(mesh: Mesh, cameras: Sequence[Camera], found: Sight, best: tuple[str, str, Sight, float] | None) -> str:
    near = min(c.near for c in cameras)
    if not found.seen.any() and (found.ahead > 0.5).all() and (found.nearer >= found.ahead).all():
        return (f"it is nearer than near = {near:g}, at {found.depth[0]:.4g} to {found.depth[1]:.4g} along the view; "
                f"set near = {found.depth[0] / 2.0:.2g} or less")
    if best is not None:
        return f"{best[0]} {best[1]}"
    centre = middle_of(mesh.positions)
    target, eyes = looked_at(cameras), np.mean([c.position for c in cameras], axis=0)
    where = "it is behind all cameras" if (found.ahead == 0.0).all() else "it is beside what the cameras see"
    return (f"{where}; its middle is at {_point(centre)}, the cameras are about {_point(eyes)} and look at about {_point(target)}; "
            "bring mesh and poses into one frame and unit")


def looked_at(cameras: Sequence[Camera]) -> np.ndarray:
    """The point (3,) nearest to the view axes of all cameras, by least squares; for parallel axes the one nearest to the eyes."""
    eyes = np.stack([c.position for c in cameras])
    middle = eyes.mean(axis=0)
    across = [np.eye(3) - np.outer(axis, axis) for axis in (c.world_to_camera[2, :3] for c in cameras)]
    rhs = sum(a @ (eye - middle) for a, eye in zip(across, eyes))
    return middle + np.linalg.lstsq(sum(across), rhs, rcond=1e-6)[0]


def _check_size(cameras: Sequence[Camera], found: Sight, masks: np.ndarray | None) -> None:
    sizes = (found.boxes[:, 2:] - found.boxes[:, :2])[found.seen & np.isfinite(found.boxes).all(axis=1)]
    if not len(sizes):
        return
    largest = float(sizes.max())
    if largest < 1.0:
        raise InputError(f"the mesh is at most {largest:.2g} pixels large in all views; are mesh and poses of one unit (millimetres, "
                         "metres)? scale one of them")
    if masks is None or not (known := np.isfinite(masks).all(axis=1) & found.seen).any():
        return
    ratio = np.median(np.prod(masks[known, 2:] - masks[known, :2], axis=1) / np.maximum(np.prod(
        np.nan_to_num(found.boxes[known, 2:] - found.boxes[known, :2]), axis=1), 1e-12))
    if ratio > 100.0:
        note(f"the mesh is about {ratio ** 0.5:.3g} times smaller in the views than the masks are; are mesh and poses of one unit?")
    inside = np.mean([(0.05 < a < 0.95) for a in found.ahead])
    if inside > 0.5 and ratio < 0.5:
        note("most cameras are inside the mesh, but the masks end within the pictures; are mesh and poses of one unit?")


def _check_lens(cameras: Sequence[Camera], names: Sequence[str]) -> None:
    outside = np.array([not (0.0 <= c.cx <= c.width and 0.0 <= c.cy <= c.height) for c in cameras])
    far_off = np.array([max(abs(c.cx / c.width - 0.5), abs(c.cy / c.height - 0.5)) > 0.25 for c in cameras])
    cause = next(iter(_lens(cameras)), None)
    hint = f"{cause[0]} {cause[1]}" if cause else "check cx and cy"
    c = cameras[int(np.argmax(outside | far_off))]
    if left := _some(outside, names):
        note(f"the principal point is outside the picture in {left} ({c.cx:g}, {c.cy:g} in {c.width}x{c.height}); {hint}")
    elif left := _some(far_off, names):
        note(f"the principal point is far from the middle of the picture in {left} ({c.cx:g}, {c.cy:g} in {c.width}x{c.height}); {hint}")
    angles = np.degrees(2.0 * np.arctan([c.width / 2.0 / c.fx for c in cameras if c.kind == "perspective"]))
    if not len(angles):
        return
    if angles.max() > 150.0 or angles.min() < 0.5:
        angle = angles.max() if angles.max() > 150.0 else angles.min()
        note(f"a field of view of {angle:.3g} degrees across; fl_x is in pixels, not in millimetres, and camera_angle_x in radians")


def _point(x: np.ndarray) -> str:
    return "(" + ", ".join(f"{v:.4g}" for v in x) + ")"


def _all(n: int) -> str:
    return "the one view" if n == 1 else f"all {n} views"


def _some(which: np.ndarray, names: Sequence[str]) -> str:
    """Those views in words, "" for none."""
    chosen = [shown(name, 40) for name, yes in zip(names, which) if yes]
    if not chosen:
        return ""
    if len(chosen) == len(names):
        return _all(len(names))
    return f"{len(chosen)} of {len(names)} views ({', '.join(chosen[:NAMED])}{', ...' if len(chosen) > NAMED else ''})"
