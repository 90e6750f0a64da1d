"""What a page shows of a session: the model, pictures of the views, parameters; and of its run: curves and times.

In: a session (of the runtime or the reference) and the courses of its phases. Out: the page's data, plain values, and a GLB.
"""
from __future__ import annotations

import base64
import contextlib
import math
import os
import tempfile
from collections.abc import Mapping, Sequence

import numpy as np

from ..cache.errors import DressiError, InputError
from ..cache.progress import tell
from ..compiler.io.images import png_bytes
from ..compiler.io.write_gltf import encode_gltf
from ..compiler.scene import results
from .facts import bundle_facts, versions

SHOWN = 12  # views
WIDTH = 480  # of a picture on the page, at most
FEW = 12  # numbers of a parameter that are shown one by one


def model(session) -> bytes | None:
    """What is on the device now as GLB; None where the bundle carries no mesh."""
    try:
        return encode_gltf(results.parts_now(session), binary=True)
    except DressiError:
        return None


def file_model(path: str) -> bytes:
    """A mesh file as GLB, its parts with their materials. Raises InputError."""
    from ..compiler.io.meshes import load_parts
    return encode_gltf(list(load_parts(path)), binary=True)


def pictures(session, before: np.ndarray | None) -> list[dict]:
    """Rows of the contact sheet: {"label", "images"}, each image a data address of a PNG."""
    rows = (("start", before), ("now", results.snapshot(session, SHOWN)), ("target", results.targets(session, SHOWN)))
    return [{"label": label, "images": [_address(image) for image in images[:SHOWN]]} for label, images in rows if images is not None]


def _address(image: np.ndarray) -> str:
    step = math.ceil(image.shape[1] / WIDTH)
    if step > 1:  # averaged over whole squares; alpha is straight, so colours count by it
        h, w = (n // step * step for n in image.shape[:2])
        blocks = image[:h, :w].reshape(h // step, step, w // step, step, -1)
        weight = blocks[..., 3:] if image.shape[-1] == 4 else np.ones_like(blocks[..., :1])
        color = (blocks[..., :3] * weight).sum((1, 3)) / np.maximum(weight.sum((1, 3)), 1e-9)
        image = np.concatenate([color, weight.mean((1, 3))], axis=-1)
    return "data:image/png;base64," + base64.b64encode(png_bytes(image)).decode()


def cameras(session) -> list[dict]:
    """The views as they were given: name, world_to_camera (12 numbers, rows), fx, fy, cx, cy, width, height."""
    meta = results.meta_of(session)
    try:
        width, height = meta["image_size"]
        origin = np.array(meta.get("origin", (0.0, 0.0, 0.0)), np.float64)
        found = []
        for name, row in zip(meta["images"], meta["cameras"]):
            pose = np.array(row[:12], np.float64).reshape(3, 4)
            pose[:, 3] -= pose[:, :3] @ origin
            found.append({"name": str(name), "pose": pose.reshape(-1).tolist(), "fx": row[12], "fy": row[13], "cx": row[14], "cy": row[15],
                          "width": width, "height": height})
        return found
    except (KeyError, TypeError, ValueError, IndexError):
        return []


def parameters(session) -> list[dict]:
    """What phases optimize, as it is now: shape, least, mean and largest number, and all of them where they are few."""
    d, found = session.bundle.description, []
    changed = dict.fromkeys(k for plan in d["plans"] for k in plan["updates"])
    for k in changed:
        value = d["values"][k]
        name = value["name"]
        if value["role"] != "state" or name.endswith(".step") or _is_moment(name, d):
            continue
        array = np.asarray(session.get(name), np.float64)
        flat = array.reshape(-1)
        found.append({"name": name, "shape": list(array.shape), "least": _finite(flat.min()), "mean": _finite(flat.mean()),
                      "largest": _finite(flat.max()), "numbers": [_finite(x) for x in flat] if flat.size <= FEW else None,
                      "phases": list(dict.fromkeys(plan["name"].removesuffix(".leave") for plan in d["plans"] if k in plan["updates"]))})
    return found


def _is_moment(name: str, d: Mapping) -> bool:
    """Whether this is what an optimizer keeps of another state: `vertices.shape.m` and the like."""
    names = {value["name"] for value in d["values"] if value["role"] == "state"}
    head, dot, _ = name.rpartition(".")
    return bool(dot) and any(name.startswith(other + ".") and name != other for other in names if other != name)


def _finite(x) -> float | None:
    return float(x) if math.isfinite(x) else None


def curves(courses: Sequence) -> list[dict]:
    """Of each phase that has begun its loss, and its terms."""
    return [{"phase": c.phase, "steps": c.steps, "loss": [list(p) for p in c.curve],
             "terms": {key: [list(p) for p in points] for key, points in c.terms.items()}} for c in courses if c.curve]


def stage_times(session, runs: int = 3) -> dict[str, list[float]]:
    """Milliseconds of each stage by plan, medians. The session is as before: what the steps for it have changed is put back from a
    checkpoint. Nothing for plans that lack an input, and for sessions that have no stages or whose states are not finite."""
    if not hasattr(session, "profile_stages"):
        return {}
    found: dict[str, list[float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        kept = os.path.join(folder, "kept")
        try:
            session.checkpoint(kept)
        except InputError:
            return {}
        for k, name in enumerate(session.plans):
            tell("timing plans", k, len(session.plans))
            with contextlib.suppress(InputError):
                found[name] = session.profile_stages(name, runs)
        session.restore(kept)
    return found


def run_data(session, title: str, courses: Sequence = (), before: np.ndarray | None = None, times: bool = False) -> dict:
    """All that a page says of a session and what has run on it. courses: of phases, with record(), as `commands.solve.Course`."""
    device = session.device if hasattr(session, "profile_stages") else None
    data = {"title": title, "where": {"device": session.device.name, "profile": session.report()["profile"]},
            "phases": [{"name": c.phase, "of": c.steps, **c.record()} for c in courses], "views": results.measured(session),
            "curves": curves(courses), "pictures": pictures(session, before), "cameras": cameras(session),
            "parameters": parameters(session), "versions": versions(device or session.device)}
    if device is not None:
        data["bundle"] = bundle_facts(session.bundle, device, stage_times(session) if times else None)
    return results.plain(data)
