"""What a run leaves behind: the mesh with its texture, a contact sheet, a loss curve, and numbers.

In: a session (of the runtime, or of `reference_session`) and the loss curves of its phases. Out: files and metrics.
What the bundle must carry for that is its "meta", written by `record`: faces, uvs, phases, names of the images, cameras.
"""
from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...cache.errors import BundleError, InputError
from ..io.cameras import inverse_rigid, rotation_matrix
from ..io.images import linear_to_srgb, to_bytes
from ..io.materials import Material, Part, TextureMap
from ..io.mesh import WRAPS, Mesh
from ..io.panorama import write_hdr
from ..io.textures import Picture
from ..io.views import Views
from ..io.writers import contact_sheet, loss_curve, save_json, save_parts
from ..render.octahedron import panorama
from ..render.texture import wraps_of
from .material_meta import pack, unpack
from .pieces import cameras_of, frame_meta, lights_of, origin_in, parts_of, scale_in, seen_meta

SHOWN = 8  # views in a contact sheet


def _unpack(meta: Mapping, name: str, kind: str, columns: int) -> np.ndarray | None:
    """The (n, columns) array of that name in a bundle's meta, or None. Raises BundleError."""
    return None if meta.get(name) is None else unpack(meta[name], name, kind, columns)


def record(problem) -> dict:
    """The meta of a `Problem`: plain values that a bundle holds."""
    mesh, names = problem.mesh, problem.views.names if isinstance(problem.views, Views) else None
    meta = {"linear_albedo": problem.srgb, "linear_images": False, **problem.program.meta}  # linear: not sRGB encoded
    meta |= {"faces": pack(mesh.faces, "<i4"), "albedo": problem.albedo,
             "albedo_color": [float(x) for x in problem.albedo_color],
             "pivot": list(problem.pivot), "shading": problem.shading,
             "wrap": problem.wrap if isinstance(problem.wrap, str) else list(problem.wrap)}
    meta |= seen_meta(problem.program, problem.phases, problem.cameras, (problem.width, problem.height), names)
    meta |= frame_meta(problem.origin, ["vertices"], problem.lights, problem.views.unit if isinstance(problem.views, Views) else None)
    if mesh.uvs is not None:
        meta |= {"uvs": pack(mesh.uvs, "<f8"), "uv_faces": pack(mesh.uv_faces, "<i4")}
    given = {"color_faces": mesh.color_faces, "vertex_map": mesh.vertex_map}
    if problem.normals == "file":  # then nothing moves vertices, and they stay right
        given |= {"normals": mesh.normals, "normal_faces": mesh.normal_faces}
    meta |= {name: pack(array, "<f8" if name == "normals" else "<i4") for name, array in given.items() if array is not None}
    return meta


def meta_of(session) -> dict:
    """The meta of the session's bundle."""
    return session.bundle.description["meta"]


def _origin(session, name: str | None = None) -> np.ndarray:
    """(3,) to be added to points on the device, or to the value `name` if it is one, to have them in the input's frame."""
    return origin_in(meta_of(session), name)


def _pivot(session) -> np.ndarray | None:
    """(3,) the point that poses turn about, on the device; None: each about its eye. Raises BundleError."""
    try:
        pivot = meta_of(session).get("pivot")
        return None if pivot is None else np.array(pivot, np.float64).reshape(3)
    except (TypeError, ValueError) as error:
        raise BundleError(f"meta.pivot is malformed ({error}); compile the bundle again") from None


def _has(session, name: str) -> bool:
    return name in session.values


def _wrap(session) -> tuple[str, str]:
    """How its texture goes on by u and by v. Raises BundleError."""
    try:
        return wraps_of(meta_of(session).get("wrap", "repeat"))
    except (InputError, TypeError) as error:
        raise BundleError(f"meta.wrap is malformed ({error}); compile the bundle again") from None


def _plain(session) -> bool:
    """Whether a `Mesh` can say how its texture goes on."""
    u, v = _wrap(session)
    return u == v and u in WRAPS


def mesh_of(session) -> Mesh:
    """The mesh as it is on the device now; its texture repeats where a mesh cannot say how it goes on. Raises BundleError where the bundle
    carries none."""
    meta = meta_of(session)
    faces = _unpack(meta, "faces", "<i4", 3)
    if faces is None or not _has(session, "vertices"):
        raise BundleError("this bundle carries no mesh (meta.faces); compile it from a job or a Problem")

    def encoded(colors: np.ndarray) -> np.ndarray:
        colors = np.clip(np.asarray(colors, np.float64), 0.0, 1.0)
        return linear_to_srgb(colors) if meta.get("linear_albedo") else colors

    uvs, uv_faces = _unpack(meta, "uvs", "<f8", 2), _unpack(meta, "uv_faces", "<i4", 3)
    texture = encoded(session.get("texture")) if _has(session, "texture") and uvs is not None else None
    colors = encoded(session.get("colors")) if _has(session, "colors") else None
    color_faces, vertex_map = (_unpack(meta, name, "<i4", columns) for name, columns in (("color_faces", 3), ("vertex_map", 1)))
    normals, normal_faces = _unpack(meta, "normals", "<f8", 3), _unpack(meta, "normal_faces", "<i4", 3)
    positions = session.get("vertices") * scale_in(meta) + _origin(session)
    return Mesh(positions, faces, uvs, uv_faces, colors, texture, None if colors is None else color_faces, normals, normal_faces,
                None if vertex_map is None else vertex_map[:, 0], wrap=_wrap(session)[0] if _plain(session) else "repeat")


def _views(session) -> int:
    """How many there are to be drawn; 0 where the bundle has no plan "render"."""
    name = next((name for name in ("render.color", "render.silhouette") if _has(session, name)), None)
    return 0 if name is None else session.shape(name)[0]


def drawn(session, view: int) -> np.ndarray:
    """One view as it is drawn now, (h, w, 4) straight RGBA, sRGB encoded."""
    if _has(session, "render.color"):
        return displayed(session, session.get("render.color", view=view)[None], first=view)[0]
    alpha = np.asarray(session.get("render.silhouette", view=view))[..., None]
    color = np.asarray(meta_of(session).get("albedo_color", [0.5] * 3), np.float64)
    whole = np.concatenate([np.broadcast_to(color, (*alpha.shape[:2], 3)), alpha], axis=-1)
    return displayed(session, whole[None], encoded=True, first=view)[0]


def snapshot(session, most: int | None = None) -> np.ndarray | None:
    """Every view, or the first so many, as `drawn` gives one, (n, h, w, 4); None where the bundle has no plan "render"."""
    count = _views(session)
    return np.stack([drawn(session, k) for k in range(count if most is None else min(most, count))]) if count else None


def displayed(session, images: np.ndarray, encoded: bool = False, first: int = 0) -> np.ndarray:
    """RGBA of views of the session from `first` on as one looks at it: in [0, 1], sRGB encoded, nothing beside pictures that are smaller
    than others."""
    images = np.clip(np.asarray(images, np.float64), 0.0, 1.0)
    try:
        for image, (width, height) in zip(images, meta_of(session).get("view_sizes", ())[first:]):
            image[height:], image[:, width:] = 0.0, 0.0
    except (TypeError, ValueError) as error:
        raise BundleError(f"meta.view_sizes is malformed ({error}); compile the bundle again") from None
    if meta_of(session).get("linear_images") and not encoded:
        images = np.concatenate([linear_to_srgb(images[..., :3]), images[..., 3:]], axis=-1)
    return images


def wanted(session, view: int) -> np.ndarray:
    """One of the images to match, as `drawn` gives the drawn one."""
    return displayed(session, session.get("targets", view=view)[None], first=view)[0]


def targets(session, most: int | None = None) -> np.ndarray | None:
    """The images to match, or the first so many, as `snapshot` gives the drawn ones."""
    if not _has(session, "targets"):
        return None
    count = session.shape("targets")[0]
    return np.stack([wanted(session, k) for k in range(count if most is None else min(most, count))])


def measure(drawn: Iterable[np.ndarray], wanted: Iterable[np.ndarray]) -> dict:
    """Of pictures drawn and wanted, one at a time: IoU of the silhouettes at half coverage, and PSNR of the colours (dB) where both are at
    least that: mean, lowest."""
    iou, psnr = [], []
    for a, b in zip(drawn, wanted):
        inside, target = a[..., 3] >= 0.5, b[..., 3] >= 0.5
        union, both = np.count_nonzero(inside | target), inside & target
        iou.append(np.count_nonzero(both) / union if union else 1.0)
        if both.any():
            error = float(np.mean((a[both][:, :3] - b[both][:, :3]) ** 2))
            psnr.append(min(99.0, -10.0 * math.log10(max(error, 1e-12))))
    out = {"iou_mean": float(np.mean(iou)), "iou_min": float(np.min(iou))}
    return out | ({"psnr_mean": float(np.mean(psnr)), "psnr_min": float(np.min(psnr))} if psnr else {})


def measured(session) -> dict:
    """`measure` of all views as they are now, where they are drawn and there are targets; of silhouettes alone without colours."""
    views = _views(session)
    if not views or not _has(session, "targets"):
        return {}
    found = measure((drawn(session, k) for k in range(views)), (wanted(session, k) for k in range(views)))
    return found if _has(session, "render.color") else {k: x for k, x in found.items() if k.startswith("iou")}


def check(session) -> None:
    """Raises BundleError where the bundle carries nothing to write a mesh file of."""
    if "parts" in meta_of(session):
        parts_of(session)
    else:
        mesh_of(session)


def parts_now(session) -> list[Part]:
    """What is on the device now as parts: those of a scene, or one surface, its texture or else its colours. Raises BundleError."""
    if "parts" in meta_of(session):
        return parts_of(session)
    mesh = mesh_of(session)
    if mesh.texture is not None and mesh.uvs is not None:
        mesh = replace(mesh, colors=None, color_faces=None)  # they would multiply the texture
    base = None if mesh.texture is None or _plain(session) else TextureMap(Picture("surface base colour", None), wrap=_wrap(session))
    return [Part("surface", mesh, Material("surface", unlit=meta_of(session).get("shading") == "unlit", base_texture=base))]


def save_result(session, path: str | Path, lights: bool = False, cameras: bool = False) -> None:
    """Writes what is on the device now as a mesh file: one surface, or the parts of a scene with their materials; and, as glTF, with its
    lights and the cameras that it was seen by, where they were when compiled."""
    scene = "parts" in meta_of(session)
    save_parts(path, parts_now(session), lights_of(session) if lights and scene else (), cameras_of(session) if cameras and scene else ())


def sheet_rows(session, before, extra_rows=()) -> list[tuple[str, np.ndarray]]:
    """The rows of a contact sheet: those there are, of the first views."""
    after = [to_bytes(drawn(session, k)) for k in range(min(SHOWN, _views(session)))] or None  # one at a time as floats
    target = [to_bytes(wanted(session, k)) for k in range(min(SHOWN, session.shape("targets")[0]))] if _has(session, "targets") else None
    rows = (("before", before), ("after", after), ("target", target), *extra_rows)
    return [(label, images[:SHOWN]) for label, images in rows if images is not None]


def save_sheet(session, path: str | Path, before: np.ndarray | None = None) -> None:
    """Writes a contact sheet of how it is now, as PNG; of a session that draws no pictures none."""
    if rows := sheet_rows(session, before):
        contact_sheet(rows, path)


def write(session, out: str | Path, curves: Mapping[str, Sequence[tuple[int, float]]], before: np.ndarray | None,
          metrics: Mapping, extra_rows: Sequence[tuple[str, Sequence[np.ndarray]]] = (), scene: bool = False) -> dict:
    """Writes OUT, and OUT's stem with _sheet.png, _loss.png and _metrics.json; gives the metrics, with what was measured.

    curves: losses by phase, (iterations done, loss). before: `snapshot` of the start. extra_rows: more rows for the sheet.
    scene: the mesh file has lights and cameras, too.
    """
    out = Path(out)
    files = {"mesh": out, "sheet": out.with_name(f"{out.stem}_sheet.png"), "loss": out.with_name(f"{out.stem}_loss.png"),
             "metrics": out.with_name(f"{out.stem}_metrics.json")}
    metrics = {**metrics, "losses": {name: [list(point) for point in points] for name, points in curves.items()}}
    save_result(session, files["mesh"], lights=scene, cameras=scene)
    if "environment.map" in _changed(session):
        files["environment"] = out.with_name(f"{out.stem}_environment.hdr")
        square = np.asarray(session.get("environment.map"), np.float64)
        files["environment"].write_bytes(write_hdr(panorama(square, 2 * len(square))))
    if rows := sheet_rows(session, before, extra_rows):
        contact_sheet(rows, files["sheet"])
    else:
        del files["sheet"]
    if views := measured(session):
        metrics["views"] = views
    metrics |= _found(session)
    if any(math.isfinite(y) and y > 0.0 for points in curves.values() for _, y in points):
        loss_curve(curves, files["loss"])
    else:
        del files["loss"]
    metrics["files"] = {kind: path.name for kind, path in files.items()}
    metrics = plain(metrics)
    save_json(files["metrics"], metrics)
    return metrics


def _changed(session) -> set[str]:
    """The values that some plan updates."""
    d = session.bundle.description
    return {d["values"][k]["name"] for plan in d["plans"] for k in plan["updates"]}


def _found(session) -> dict:
    """Cameras, gains of views, lights and single values of parts, where they were optimized."""
    changed, out, scale = _changed(session), {}, scale_in(meta_of(session))
    lights = {name: (np.asarray(session.get(name)) * scale_in(meta_of(session), name) + _origin(session, name)).tolist() for name in
              sorted(changed)
              if name.startswith("light") and name.count(".") == 1}
    if lights:
        out["lights"] = lights
    if "gain" in changed:
        gain = np.asarray(session.get("gain"), np.float64)
        out["gains"] = dict(zip(meta_of(session)["images"], (gain / gain.mean(0)).tolist()))
    values = {name: (np.asarray(session.get(name)) * (scale if name.endswith(".translation") else 1.0)).tolist() for name in
              sorted(changed)
              if not name.startswith(("light", "camera.")) and name.count(".") == 1 and session.values[name]["layout"] == "unit"
              and name.partition(".")[0] in {entry.get("name") for entry in meta_of(session).get("parts", ())}}
    if values:
        out["parameters"] = values
    poses = ("camera.rotation", "camera.translation") if "parts" in meta_of(session) else ("rotation", "translation")
    if changed & {*poses}:
        rotation, translation = (np.asarray(session.get(name), np.float64) for name in poses)
        poses, pivot = [], _pivot(session)
        for row, turn, shift in zip(meta_of(session)["cameras"], rotation, translation):
            base, pose = np.array(row[:12], np.float64).reshape(3, 4), np.eye(4)
            p = np.zeros(3) if pivot is None else base @ (*pivot, 1.0)  # where the pivot is for the camera: see `posed_views`
            pose[:3] = rotation_matrix(turn) @ base
            pose[:3, 3] += p - rotation_matrix(turn) @ p + shift
            pose = inverse_rigid(pose)
            pose[:3, 3] = pose[:3, 3] * scale + _origin(session)
            poses.append(pose.tolist())
        out["camera_to_world"] = dict(zip(meta_of(session)["images"], poses))
    return out


def plain(value):
    """The value in JSON's types; numbers that are not finite become None."""
    if isinstance(value, Mapping):
        return {str(k): plain(x) for k, x in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(x) for x in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    return value
