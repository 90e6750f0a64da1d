"""What jobs of one mesh and of several parts have in common: views, lights, softness, optimizers, schedules; tables in, values out."""
from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from ...cache.errors import InputError
from ..io.decode import Masks
from ..io.formats import Cameras, read_cameras
from ..io.hull import visual_hull
from ..io.mesh import Mesh
from ..io.meshes import load_mesh, load_texture, normalize
from ..io.panorama import load_panorama
from ..io.shapes import sphere
from ..io.transforms import read_transforms
from ..io.views import Views, load_gltf_views, photographs
from ..render.environment import Environment
from ..render.light import KINDS as LIGHTS
from ..render.light import PLACED, Light, Shadow
from ..render.material import MAX_PROBES
from ..render.octahedron import SIZES, octahedral
from ..render.optimizer import SHARED, Adam, AdamUniform, AdamW, Clipped, Optimizer, Sgd
from ..render.raster import DISTANCES, EDGES, MAX_LAYERS, MOST, Binned, Softness
from ..render.schedule import Schedule
from ..render.texture import WRAPS, Wrap, alike
from ..render.tone import CURVES, Tone
from .scene import Scene
from .tables import NEEDED, Table
from .values import narrowed

ENVIRONMENT = ("path", "radiance", "size", "rotation", "strength", "background")
LIGHT = ("kind", "power", "vector", "direction", "cone", "shadow")
SHARP = Softness(1.0, delta=0.0)  # of pictures to look at: about as soft as a pixel's own area
MESH = ("path", "sphere", "hull", "normalize", "texture")
PEELED, BINNED = ("delta", "distance", "edges"), ("gamma", "depth", "squared", "over", "hard")  # what one kind of renderer alone has
RENDERERS = ("layered", "binned")
SOFT = ("r", "r_fraction", "sigma", "layers", *PEELED, "renderer", *BINNED)
SAMPLED = ("mips", "anisotropy")
ADAM = ("rate", "betas", "epsilon")
OPTIMIZERS = {"adam": (Adam, ADAM), "adamw": (AdamW, (*ADAM, "decay")), "adam_uniform": (AdamUniform, (*ADAM, "shared")),
              "sgd": (Sgd, ("rate", "momentum", "nesterov"))}


def flat(table: dict, ends: Sequence[str]) -> dict:
    """Parameters by their whole names: pear.vertices is the same as "pear.vertices". ends: keys that what belongs to one parameter has."""
    found = {}
    for key, value in table.items():
        inner = isinstance(value, dict) and value and all(isinstance(x, dict) and k not in ends for k, x in value.items())
        found |= {f"{key}.{k}": x for k, x in value.items()} if inner else {key: value}
    return found


def limit(job: Table, scene: Scene) -> None:
    """Narrows the limits of a scene's parameters to what [limits] says. Raises InputError."""
    said = job.get("limits", {})
    said = flat(said, ()) if isinstance(said, dict) else said
    table = Table(said, "limits", scene.parameters, job.source)
    for name in said:
        if name.rpartition(".")[2] in ("vertices", "vector"):
            raise table.conflict(f"{name} is a place, and places have no limits; hold it by a loss")
        own = table.table(name, ("low", "high"))
        low, high = own.number("low", None), own.number("high", None)
        if low is None and high is None:
            raise own.conflict("low or high is needed")
        start = np.asarray(scene.program.values[name].initial)
        scene.parameters[name] = table.checked(narrowed, scene.parameters[name], name, start, low, high)


def mesh_of(t: Table, folder: Path) -> Callable[[Callable[[], Views]], Mesh]:
    """Reads [mesh], or what of a [[part]] says its mesh; gives a function that makes it of what loads the views."""
    if len(t.has("path", "sphere", "hull")) != 1:
        raise t.conflict("path, sphere or hull is needed, and one of them alone")
    scaled, texture = t.flag("normalize", False), t.file("texture", folder, None)
    file = t.file("path", folder, None)
    if file is None:
        if scaled:
            raise t.conflict("normalize is for path; a sphere has its radius, a hull its place")
        hull = bool(t.has("hull"))
        ball = t.table("hull", ("vertices", "misses")) if hull else t.table("sphere", ("vertices", "radius"))
        vertices = ball.number("vertices", 2562, 100 if hull else 4, 100_000 if hull else 700_000, whole=True)
        misses = ball.number("misses", 0, 0, 1000, whole=True) if hull else 0
        radius = 1.0 if hull else ball.number("radius", 1.0, 0.0, above=True)

    def make(views: Callable[[], Views]) -> Mesh:
        if file is None:
            mesh = ball.checked(visual_hull, views(), vertices, misses) if hull else ball.checked(sphere, vertices, radius)
            return mesh if texture is None else replace(mesh, texture=t.checked(load_texture, texture))
        mesh = t.checked(load_mesh, file, texture)
        if scaled:
            return t.checked(normalize, mesh)
        unit = views().unit  # a mesh of a file is where the cameras are
        return mesh if unit is None else replace(mesh, positions=unit.inside(mesh.positions))

    return make


def views_of(job: Table, folder: Path, fits: Callable[[int, int, int], None], told: Callable[[int, int], None] | None = None):
    """Reads [views]; gives the table and a function that loads them, and tells how many pictures of how many are read."""
    t = job.table("views", ("transforms", "cameras", "gltf", "images", "missing", "stated", "normalize", "masks", "backdrop", "alpha",
                            "size", "order", "seed", "color", "near", "far"))
    if len(t.has("transforms", "cameras", "gltf")) != 1:
        raise t.conflict("transforms (a NeRF-style JSON or its folder), cameras (of COLMAP and others) or gltf (cameras) is needed, and "
                         "one of them alone")
    transforms, cameras, gltf = (t.file(key, folder, None) for key in ("transforms", "cameras", "gltf"))
    masks, skip = _masks_of(t, folder), t.word("missing", "error", ("error", "skip")) == "skip"
    if isinstance(t.get("size", None), list):
        size = t.numbers("size", 2, None, 1, 16384, whole=True)
    else:
        size = t.number("size", None, 1, 16384, whole=True)
    near, far = t.number("near", 0.05, 0.0, above=True), t.number("far", 100.0, 0.0, above=True)
    if far <= near:
        raise t.wrong("far", far, f"a number above near, {near:g}, is needed")
    if gltf is not None and (wrong := t.has("near", "far", "missing", "stated", "normalize")):
        raise t.conflict(f"{wrong[0]} is not for gltf, whose cameras have a near and far, a unit and a picture of their own; drop it")
    if cameras is None and (gltf is None) != (not t.has("images")):
        raise t.conflict("gltf and images belong together; transforms names its images itself")
    images = _files_of(t, "images", folder) if t.has("images") else None
    if cameras is not None and isinstance(images, list):
        raise t.wrong("images", t.get("images"), "cameras needs a folder")
    stated, ball = t.numbers("stated", 2, None, 1, 1 << 16, whole=True), t.get("normalize", False)
    if isinstance(ball, dict):
        b = t.table("normalize", ("center", "radius"))
        ball = b.numbers("center", 3), b.number("radius", low=0.0, above=True)
    elif not isinstance(ball, bool):
        raise t.wrong("normalize", ball, "true, false or {center = [x, y, z], radius = r} is needed")

    def make() -> Views:
        if gltf is not None:
            return t.checked(load_gltf_views, gltf, images, size, fits, told, masks)
        found = Cameras(t.checked(read_transforms, transforms, skip)) if cameras is None else t.checked(read_cameras, cameras, images, skip)
        return t.checked(photographs, found, size, near, far, fits, told, masks, stated, ball)

    return t, cache(make)


def _files_of(t: Table, key: str, folder: Path) -> Path | list[Path]:
    """A folder, or a list of files."""
    value = t.get(key)
    listed = value if isinstance(value, list) else [value]
    if not (listed and all(isinstance(i, str) and i for i in listed)):
        raise t.wrong(key, value, "a folder or a list of files is needed")
    files = [t.path(key, folder, i) for i in listed]
    return files if isinstance(value, list) else files[0]


def _masks_of(t: Table, folder: Path) -> Masks:
    """Reads what [views] says of masks."""
    whole = t.get("masks", None) is False
    files = _files_of(t, "masks", folder) if t.has("masks") and not whole else None
    premultiplied = t.word("alpha", "straight", ("straight", "premultiplied")) == "premultiplied"
    if not t.has("backdrop"):
        return Masks(tuple(files) if isinstance(files, list) else files, whole=whole, premultiplied=premultiplied)
    if whole:
        raise t.conflict("backdrop and masks = false are both given; the one cuts the object out, the other takes all")
    b = t.table("backdrop", ("color", "within"))
    return Masks(tuple(files) if isinstance(files, list) else files, b.numbers("color", 3, low=0, high=1),
                 b.number("within", 0.1, 0.0, 1.0, above=True), premultiplied=premultiplied)


def soft(t: Table) -> dict:
    """The softness keys of a table that are there."""
    if len(t.has("r", "r_fraction")) > 1:
        raise t.conflict("r (pixels) and r_fraction (of the image's larger side) are both given; give one")
    renderer = t.word("renderer", None, RENDERERS)
    layers = (0, MOST) if renderer == "binned" else (1, MAX_LAYERS)
    soft = {"renderer": renderer, "r": t.number("r", None, 0.0, above=True),
            "r_fraction": t.number("r_fraction", None, 0.0, 1.0, above=True),
            "sigma": t.number("sigma", None, 0.0, above=True), "delta": t.number("delta", None, 0.0),
            "layers": t.number("layers", None, *layers, whole=True), "distance": t.word("distance", None, DISTANCES),
            "edges": t.word("edges", None, EDGES),
            "gamma": t.number("gamma", None, 0.0, above=True), "depth": t.numbers("depth", 2, None, 0.0)}
    soft |= {key: t.flag(key, False) for key in t.has("squared", "over", "hard")}
    soft = {k: x for k, x in soft.items() if x is not None}
    if "r" in soft or "r_fraction" in soft:  # either replaces the other of an outer table
        soft = {"r": None, "r_fraction": None, **soft}
    if renderer is not None:  # and a renderer what the other kind had there
        soft = {**dict.fromkeys(("layers", *(PEELED if renderer == "binned" else BINNED))), **soft}
    return soft


def softness_of(soft: dict, side: int) -> Softness | Binned:
    """What draws, of the softness keys that are in force. Raises InputError."""
    soft = {key: x for key, x in soft.items() if x is not None}
    r = soft["r_fraction"] * side if "r_fraction" in soft else soft.get("r", 2.0)
    kind = soft.get("renderer", "layered")
    if wrong := [key for key in (PEELED if kind == "binned" else BINNED) if key in soft]:
        raise InputError(f"{wrong[0]} is given, but the renderer is {kind!r}, which has none; drop it, or set renderer = "
                         f'"{"layered" if kind == "binned" else "binned"}"')
    if kind == "binned":
        own = {key: soft[key] for key in ("gamma", "depth", "squared", "hard", "layers") if key in soft}
        return Binned(float(r), soft.get("sigma"), over=soft.get("over", True), **own)  # as targets lie over the background
    return Softness(r, soft.get("sigma"), soft.get("delta"), soft.get("layers", 1), soft.get("distance"),
                    soft.get("edges", "coverage"))


def sampled(t: Table, mips: bool = False) -> dict:
    """How textures are sampled: mips, and anisotropy, which is of mips alone; `mips` where the table does not say. Raises InputError."""
    mips, anisotropy = t.flag("mips", mips), t.number("anisotropy", 1, 1, MAX_PROBES, whole=True)
    if anisotropy > 1 and not mips:
        raise t.conflict(f"anisotropy is {anisotropy}, but there are no mips; set mips = true, or drop it")
    return {"mips": mips, "anisotropy": anisotropy}


def wrap_of(t: Table) -> Wrap | None:
    """How a texture goes on beyond its edges: a word, or one for u and one for v; None where the table does not say. Raises InputError."""
    found = t.get("wrap", None)
    if isinstance(found, list):
        if len(found) != 2 or not all(isinstance(x, str) and x in WRAPS for x in found):
            raise t.wrong("wrap", found, f"a list of two is needed, for u and for v; allowed: {' '.join(WRAPS)}")
        return alike(found)
    return t.word("wrap", None, WRAPS)


def _shadow_of(t: Table) -> Shadow | None:
    """Reads shadow of a light: true, or how it is drawn."""
    if not t.has("shadow") or t.get("shadow") is False:
        return None
    if t.get("shadow") is True:
        return Shadow()
    own = t.table("shadow", ("size", "filter", "bias", "limit"))
    numbers = {key: own.number(key, whole=key in ("size", "filter")) for key in own.has("size", "filter", "bias", "limit")}
    return own.checked(Shadow, **numbers)


def light_of(t: Table) -> Light:
    kind, power = t.word("kind", allowed=LIGHTS), t.get("power")
    if isinstance(power, list):
        power = t.numbers("power", 3, low=0)
    else:
        power = (float(t.number("power", low=0)),) * 3
    if kind == "ambient" and t.has("vector"):
        raise t.conflict("vector is for directional, point and spot lights; an ambient light has none")
    if kind != "spot" and (wrong := t.has("direction", "cone")):
        raise t.conflict(f"{wrong[0]} is for spot lights; drop it")
    spot = {"direction": t.numbers("direction", 3)} if kind == "spot" else {}
    if t.has("cone"):
        spot["cone"] = tuple(math.radians(a) for a in t.numbers("cone", 2, low=0, high=90))
    if shadow := _shadow_of(t):
        spot["shadow"] = shadow
    return t.checked(Light, kind, power, None if kind == "ambient" else t.numbers("vector", 3), **spot)


@dataclass(frozen=True)
class Surroundings:
    """[environment], read: what loads the map, its rotation and strength, whether it is seen behind the parts."""

    load: Callable[[], np.ndarray]
    rotation: tuple[float, float, float]
    strength: float
    shown: bool

    def made(self) -> Environment:
        """The environment, of which nothing is optimized."""
        return Environment(self.load(), self.rotation, self.strength)

    def into(self, scene, optimized: set[str]) -> Environment:
        """The environment, with parameters for what is optimized."""
        own = {key: scene.parameter(f"environment.{key}", x, low) if f"environment.{key}" in optimized else x
               for key, x, low in (("rotation", self.rotation, None), ("strength", self.strength, 0.0))}
        light = self.load()
        if "environment.map" in optimized:
            return Environment(scene.parameter("environment.map", light, 0.0, kind="image"), **own)
        return Environment(light, **own)


def environment_of(job: Table, folder: Path) -> Surroundings | None:
    """Reads [environment]; None where there is none."""
    if not job.has("environment"):
        return None
    t = job.table("environment", ENVIRONMENT)
    if len(t.has("path", "radiance")) != 1:
        raise t.conflict("path (a panorama) or radiance (three numbers, the same from everywhere) is needed, and not both")
    path, same = t.file("path", folder, None), t.numbers("radiance", 3, None, 0)
    size = t.number("size", 64, whole=True)
    if size not in SIZES:
        raise t.wrong("size", size, f"allowed: {' '.join(map(str, SIZES))}")

    def load() -> np.ndarray:
        return np.full((size, size, 3), 1.0) * same if path is None else octahedral(t.checked(load_panorama, path), size)

    return Surroundings(load, t.numbers("rotation", 3, (0.0, 0.0, 0.0)), float(t.number("strength", 1.0, 0.0)), t.flag("background", True))


def tone_of(render: Table, srgb: bool) -> Tone | None:
    """Reads render.tone; None where there is none."""
    if not render.has("tone"):
        return None
    t = render.table("tone", ("curve", "exposure", "white"))
    return t.checked(Tone, t.word("curve", "linear", CURVES), float(t.number("exposure", 0.0, -60, 60)),
                     float(t.number("white", 4.0, 0.0, above=True)), srgb)


def no_points_in(views: Views, lights: Sequence[Light]) -> None:
    """Raises InputError for point lights beside views in a frame of their own: their power is one of the unit of length."""
    if views.unit is not None and any(light.kind in PLACED for light in lights):
        raise InputError("a point or spot light's power and place are of the unit that views.normalize changes; use directional and "
                         "ambient lights, or bring the cameras into the unit ball yourself")


def optimizer_of(outer: Table, key: str, steps: int) -> Optimizer:
    """Reads a parameter's table; clipped where it says so."""
    every = tuple(dict.fromkeys(k for _, keys in OPTIMIZERS.values() for k in keys))
    t = outer.table(key, ("optimizer", *every, "clip_value", "clip_norm"))
    kind = t.word("optimizer", "adam", tuple(OPTIMIZERS))
    make, keys = OPTIMIZERS[kind]
    if extra := [k for k in t.has(*every) if k not in keys]:
        raise t.conflict(f"{extra[0]} is no setting of {kind}; allowed: {' '.join(keys)}")
    given = {"rate": schedule_of(t, "rate", steps)}
    if t.has("betas"):
        given["betas"] = t.numbers("betas", 2, low=0, high=1)
    for name in t.has("epsilon", "momentum", "decay"):
        given[name] = t.number(name, low=0)
    if t.has("shared"):
        given["shared"] = t.word("shared", allowed=SHARED)
    if t.has("nesterov"):
        given["nesterov"] = t.flag("nesterov", False)
    clip = {name: t.number(f"clip_{name}", None, 0, above=True) for name in ("value", "norm")}
    made = t.checked(make, **given)
    return t.checked(Clipped, made, **clip) if any(clip.values()) else made


def schedule_of(t: Table, key: str, steps: int, default=NEEDED) -> Schedule:
    """A number or a schedule's table; one with an `end` spans the phase unless it says otherwise."""
    value = t.get(key, default)
    if isinstance(value, dict):
        t.table(key, ("start", "end", "steps", "kind", "at", "values", "warmup"))
        if "end" in value or value.get("kind") in ("exponential", "linear", "cosine"):
            value = {"steps": max(1, steps - value["warmup"] if isinstance(value.get("warmup"), int) else steps), **value}
    return t.checked(Schedule.parse, value, key)
