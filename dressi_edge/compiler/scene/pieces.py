"""What a scene's bundle must carry so that its parts can be written as files, and the parts of a session.

In: a `Scene`, or a session of its bundle. Out: the bundle's meta, or `io.materials.Part`s with the numbers as they are on the device.
"""
from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...cache.errors import BundleError, note
from ..graph.ir import Node
from ..graph.program import Program
from ..io.cameras import Camera
from ..io.gltf_lights import PlacedLight
from ..io.images import linear_to_srgb, srgb_to_linear
from ..io.materials import Material, Part
from ..io.mesh import Mesh
from ..io.unit import Unit
from ..render.light import PLACED, Light
from ..render.material import IDENTITY, Corner, Texture, Unlit, Vertex
from .material_meta import Sources, described, pack, unpack

GEOMETRY = "geometry"  # the plan that gives positions which are no values of their own


def origin_in(meta: Mapping, name: str | None = None) -> np.ndarray:
    """(3,) what is to be added to points on the device to have them in the input's frame (`io.frame`); zero for the value `name` where it
    is no point. Raises BundleError."""
    try:
        origin = np.array(meta.get("origin", (0.0, 0.0, 0.0)), np.float64).reshape(3)
        return origin if name is None or name in meta.get("points", ()) else np.zeros(3)
    except (TypeError, ValueError) as error:
        raise BundleError(f"meta.origin is malformed ({error}); compile the bundle again") from None


def scale_in(meta: Mapping, name: str | None = None) -> float:
    """What lengths on the device are to be multiplied by to have them in the input's frame (`io.unit`), before `origin_in`; 1 for the value
    `name` where it is no point. Raises BundleError."""
    scale = meta.get("scale", 1.0)
    if not isinstance(scale, float | int) or not 0.0 < scale < np.inf:
        raise BundleError(f"meta.scale is {scale!r:.40}, no number above 0; compile the bundle again")
    return float(scale) if name is None or name in meta.get("points", ()) else 1.0


def frame_meta(origin: np.ndarray, vertices: Sequence[str], lights: Sequence[Light], unit: Unit | None = None) -> dict:
    """The meta of a frame that is not the input's: its origin there, how long its unit is there (if not 1), and which values are points in
    it. Nothing for the input's own. unit: the frame that the origin is in."""
    points = [*vertices, *(f"light{k}.vector" for k, light in enumerate(lights) if light.kind in PLACED)]
    if unit is not None:
        return {"origin": (unit.origin + unit.scale * origin).tolist(), "scale": unit.scale, "points": points}
    return {"origin": origin.tolist(), "points": points} if origin.any() else {}


def seen_meta(program: Program, phases: Sequence[str], cameras: Sequence[Camera], size: tuple[int, int], images) -> dict:
    """The meta of what is fitted to: phases with their steps, names of the pictures (or None), their size, and that of each where they
    differ, cameras."""
    sizes = [[c.width, c.height] for c in cameras]
    return {"phases": [[spec.name, spec.steps] for spec in program.plans if spec.name in phases],
            "images": list(images or (f"view {k}" for k in range(len(cameras)))), "image_size": list(size),
            **({} if all(s == list(size) for s in sizes) else {"view_sizes": sizes}),
            **({"camera_kinds": [c.kind for c in cameras]} if any(c.kind != "perspective" for c in cameras) else {}),
            "cameras": [[*map(float, c.world_to_camera[:3].reshape(-1)), c.fx, c.fy, c.cx, c.cy, c.near, c.far] for c in cameras]}


def record(scene, images: Sequence[str] | None = None) -> dict:
    """The meta of a scene: its parts with what their colours are, phases, cameras, names of its pictures. Adds the plan "geometry", whose
    outputs are the positions that are worked out from parameters."""
    names = {value.node: name for name, value in scene.program.values.items() if scene.program.roles[name] == "state"}
    parts, derived = [], {}
    for part in scene.parts:
        found = {"name": part.name, "faces": pack(np.asarray(part.mesh.faces), "<i4"), "unlit": isinstance(part.material, Unlit),
                 "color": _color(getattr(part.material, "color", None), names)}
        more = described(part.material, names)
        if more and (more["kind"] == "pbr" or not found["color"]):
            found["material"] = more
        if part.mesh.uvs is not None:
            found |= {"uvs": pack(part.mesh.uvs, "<f8"), "uv_faces": pack(part.mesh.uv_faces, "<i4")}
        if part.normals == "file":
            found |= {"normals": pack(part.mesh.normals, "<f8"), "normal_faces": pack(part.mesh.normal_faces, "<i4")}
        if part.positions in names:
            found["positions"] = names[part.positions]
        elif part.positions.op.name == "constant":
            rows = part.positions.attrs["data"].array.reshape(-1, 3)[:part.positions.extent.count]
            found["positions"] = pack(rows, "<f8")
        else:
            derived[part.name] = part.positions
            found["positions"] = f"{GEOMETRY}.{part.name}"
        parts.append(found)
    if derived and not any(plan.name == GEOMETRY for plan in scene.program.plans):
        scene.output(GEOMETRY, **derived)
    seen = seen_meta(scene.program, scene.phases, scene.cameras, (scene.width, scene.height), images)
    lights = lights_meta(scene, names)
    return {"parts": parts, **seen, **lights, "linear_albedo": scene.encode is not None, **scene.program.meta}


def lights_meta(scene, names: Mapping[Node, str]) -> dict:
    """The meta of the lights of all parts, each once: numbers, or names of values. Nothing where there are none."""
    found: list[dict] = []
    for light in (light for part in scene.parts for light in getattr(part.material, "lights", ())):
        entry = {"kind": light.kind, "cone": list(light.cone)}
        for key in ("power", "vector", "direction"):
            x = getattr(light, key)
            if x is not None and not (isinstance(x, Node) and x not in names):
                entry[key] = names[x] if isinstance(x, Node) else [float(c) for c in x]
        if entry not in found:
            found.append(entry)
    return {"lights": found} if found else {}


def _color(source, names: Mapping[Node, str]) -> dict:
    """Where the colour of a part comes from: a value of the session, or numbers. Nothing where it is worked out from more than that."""
    plain = isinstance(source, Texture) and source.uv is None and not source.srgb and source.wrap in ("repeat", "clamp")
    if plain and source.image in names and tuple(map(tuple, source.transform)) == IDENTITY:
        return {"texture": names[source.image], "wrap": source.wrap}
    if isinstance(source, Vertex) and source.table in names:
        return {"vertices": names[source.table]}
    if isinstance(source, Corner) and source.table in names:
        return {"corners": names[source.table], "faces": pack(source.faces, "<i4")}
    if isinstance(source, Node) and source in names:
        return {"value": names[source]}
    if isinstance(source, (int, float)):
        return {"numbers": [float(source)] * 3}
    return {"numbers": [float(x) for x in source]} if isinstance(source, (tuple, list)) else {}


@dataclass(frozen=True)
class _Entry:
    """One part of a bundle's meta, read with care: it is somebody's file."""

    session: object
    meta: Mapping
    where: str

    def value(self, name) -> np.ndarray:
        if not isinstance(name, str) or name not in self.session.values:
            raise BundleError(f"{self.where} names the value {name!r:.60}, which the bundle does not have; compile the bundle again")
        return np.asarray(self.session.get(name), np.float64)

    def array(self, key: str, kind: str, columns: int) -> np.ndarray | None:
        return unpack(self.meta[key], f"{self.where}.{key}", kind, columns) if key in self.meta else None


def parts_of(session) -> list[Part]:
    """The parts as they are on the device now, colours in sRGB as files have them. Raises BundleError."""
    meta = session.bundle.description["meta"]
    entries = meta.get("parts")
    if not isinstance(entries, list) or not entries or not all(isinstance(e, Mapping) for e in entries):
        raise BundleError("this bundle carries no parts (meta.parts); compile it from a job, a Problem or a recorded Scene")
    origin, scale, linear = origin_in(meta), scale_in(meta), bool(meta.get("linear_albedo"))
    return [_part(_Entry(session, entry, f"meta.parts[{k}]"), linear, origin, scale) for k, entry in enumerate(entries)]


def lights_of(session) -> list[PlacedLight]:
    """The lights as they are on the device now, but for ambient ones, which files do not have. Raises BundleError."""
    meta = session.bundle.description["meta"]
    origin, out = origin_in(meta), []
    for k, entry in enumerate(meta.get("lights", ())):
        where = f"meta.lights[{k}]"
        if not isinstance(entry, Mapping) or not isinstance(entry.get("kind"), str):
            raise BundleError(f"{where} is malformed; compile the bundle again")
        if entry["kind"] == "ambient":
            note("an ambient light is left out: glTF has none")
            continue
        e = _Entry(session, entry, where)

        def number(key: str, default, e=e) -> np.ndarray:
            x = e.meta.get(key, default)
            x = e.value(x) if isinstance(x, str) else np.asarray(x, float)
            if x.shape != (3,):
                raise BundleError(f"{e.where}.{key} is malformed; compile the bundle again")
            return x

        power, vector = np.maximum(number("power", (1.0,) * 3), 0.0), number("vector", (0.0, 0.0, -1.0))
        travels = number("direction", (0.0, 0.0, -1.0)) if entry["kind"] == "spot" else vector
        out.append(PlacedLight(f"light{k}", entry["kind"], tuple(power.tolist()), tuple((vector + origin).tolist()),
                               tuple((travels / (np.linalg.norm(travels) or 1.0)).tolist()), tuple(entry.get("cone", PlacedLight.cone))))
    return out


def cameras_of(session) -> list[tuple[str, Camera]]:
    """The cameras with their names, in the input's frame, where they were when compiled. Raises BundleError."""
    meta = session.bundle.description["meta"]
    scale = scale_in(meta)
    try:
        sizes = meta.get("view_sizes") or [meta["image_size"]] * len(meta["cameras"])
        rows, names = np.array(meta["cameras"], np.float64).reshape(-1, 18), list(map(str, meta["images"]))
        kinds, out = meta.get("camera_kinds", ["perspective"] * len(rows)), []
        for name, row, kind, (width, height) in zip(names, rows, kinds, sizes, strict=True):
            pose = np.eye(4)
            pose[:3] = row[:12].reshape(3, 4)
            pose[:3, 3] = pose[:3, 3] * scale - pose[:3, :3] @ origin_in(meta)
            lens = row[12:16] / (scale if kind == "orthographic" else 1.0, scale if kind == "orthographic" else 1.0, 1.0, 1.0)
            out.append((name, Camera(pose, *lens.tolist(), width, height, *(row[16:] * scale).tolist(), kind)))
        return out
    except (KeyError, TypeError, ValueError) as error:
        raise BundleError(f"meta.cameras is malformed ({error}); compile the bundle again") from None


def _part(e: _Entry, linear: bool, origin: np.ndarray, scale: float) -> Part:
    def stored(colors: np.ndarray) -> np.ndarray:
        colors = np.clip(np.asarray(colors, np.float64), 0.0, 1.0)
        return linear_to_srgb(colors) if linear else colors

    name, positions, color = str(e.meta.get("name", "")), e.meta.get("positions"), e.meta.get("color", {})
    if not isinstance(color, Mapping):
        raise BundleError(f"{e.where}.color is malformed; compile the bundle again")
    faces = e.array("faces", "<i4", 3)
    if faces is None:
        raise BundleError(f"{e.where} has no faces; compile the bundle again")
    places = e.value(positions) if isinstance(positions, str) else unpack(positions, f"{e.where}.positions", "<f8", 3)
    places = places * scale + origin
    mesh = Mesh(places, faces, e.array("uvs", "<f8", 2), e.array("uv_faces", "<i4", 3), normals=e.array("normals", "<f8", 3),
                normal_faces=e.array("normal_faces", "<i4", 3))
    if isinstance(e.meta.get("material"), Mapping):
        sources = Sources(e.meta["material"], e.where, e.value, mesh, linear)
        material, mesh = sources.material(name)
        return Part(name, mesh, material, sources.uv_sets)
    material = Material(name, unlit=bool(e.meta.get("unlit")))
    if "texture" in color:
        mesh = replace(mesh, texture=stored(e.value(color["texture"])), wrap=color.get("wrap", "repeat"))
    elif "vertices" in color:
        mesh = replace(mesh, colors=stored(e.value(color["vertices"])))
    elif "corners" in color:
        mesh = replace(mesh, colors=stored(e.value(color["corners"])), color_faces=unpack(color["faces"], f"{e.where}.color", "<i4", 3))
    elif "value" in color or "numbers" in color:
        numbers = e.value(color["value"]) if "value" in color else np.array(color["numbers"], np.float64)
        numbers = np.broadcast_to(numbers, 3) if linear else srgb_to_linear(np.clip(np.broadcast_to(numbers, 3), 0.0, 1.0))
        material = replace(material, base_color=(*map(float, np.clip(numbers, 0.0, 1.0)), 1.0), stated=True)
    else:
        note(f"{e.where}.color is worked out by a function, and is left out")
    return Part(name, mesh, material)

