"""Job files: TOML in, a checked `Problem` out, with a plan "render" that draws every view sharply. docs/job.md lists the keys.

Numbers, words and keys are checked before any file is read, and files before anything is built. Every mistake is an InputError
of one line: the job file, the key as table.key, what was found, what is allowed.
"""
from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...cache.errors import InputError
from ...cache.profile import Profile
from ..io.images import srgb_to_linear
from ..io.mesh import NORMALS, WRAPS, Mesh, linear_mesh
from ..io.meshes import load_mesh, normalize
from ..io.shapes import sphere
from ..io.text import bounded, read_bytes, shown
from ..io.textures import load_texture
from ..io.views import Views, load_gltf_views, load_views
from ..render.light import KINDS as LIGHTS
from ..render.light import Light
from ..render.optimizer import Adam, Sgd
from ..render.raster import DISTANCES, MAX_LAYERS, Softness
from ..render.schedule import Schedule
from . import sense
from .limits import fits_scene, fits_views
from .problem import ALBEDOS, IMAGE_LOSSES, MESH_LOSSES, ORDERS, SHADINGS, Loss, Problem
from .tables import NEEDED, Table

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

MAX_FILE_BYTES = 1 << 20
SHARP = Softness(1.0, delta=0.0)  # of the plan "render": about as soft as a pixel's own area
SOFT = ("r", "r_fraction", "sigma", "delta", "layers", "distance")
OPTIMIZERS = {"adam": (Adam, ("rate", "betas", "epsilon")), "sgd": (Sgd, ("rate", "momentum", "nesterov"))}

@dataclass(frozen=True)
class _Phase:
    table: Table
    name: str
    steps: int
    optimize: dict
    losses: list[Loss]
    soft: dict


def load_job(path: str | Path, profiles: Sequence[Profile] = ()) -> Problem:
    """The problem of a job file. What is too large for one of the `profiles` is said before pictures are decoded. Raises InputError,
    naming the file and the key."""
    path = Path(path)
    data = read_bytes(path, "job", MAX_FILE_BYTES)
    try:
        document = tomllib.loads(data.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: byte {error.start} is not UTF-8; save the job as UTF-8") from None
    except RecursionError:
        raise InputError(f"{path}: not a job: nested too deeply; repair it") from None
    except ValueError as error:  # a TOMLDecodeError, or a number of thousands of digits
        raise InputError(f"{path}: not TOML: {shown(error)}; repair it") from None
    return parse_job(document, path, profiles)


def parse_job(document: dict, path: str | Path, profiles: Sequence[Profile] = ()) -> Problem:
    """The problem of a parsed job; `path` is its file, for messages and for the paths in it. profiles: as in `load_job`."""
    path = Path(path)
    bounded(document, str(path))
    job = Table(document, "", ("mesh", "views", "render", "light", "phase"), str(path))
    make_mesh = _mesh(job, path.parent)
    views_table, make_views = _views(job, path.parent, fits_views(profiles))
    order = views_table.word("order", "batch", ORDERS)
    seed = views_table.number("seed", 0, 0, 2 ** 31 - 1, whole=True)
    linear = views_table.word("color", "srgb", ("srgb", "linear")) == "linear"
    phases = [_phase(p) for p in job.tables("phase", ("name", "steps", "optimize", "loss", *SOFT))]
    if not phases:
        raise InputError(f"{path}: phase is missing; at least one [[phase]] is needed")
    render, settings = _render(job)
    lights = [_light(x) for x in job.tables("light", ("kind", "power", "vector"))]
    if settings["shading"] == "unlit" and lights:
        raise InputError(f"{path}: light[0] is given, but render.shading is 'unlit'; "
                         "set render.shading = \"lambert\", or drop it")
    softs = [(p, {**settings["soft"], **p.soft}) for p in phases]

    mesh, views = make_mesh(), make_views()
    views_table.checked(sense.check, mesh, views, any(loss.kind == "silhouette" for phase in phases for loss in phase.losses),
                        "mesh.normalize has moved and scaled the mesh, but not the cameras" if job.get("mesh").get("normalize") else "")
    albedo = settings["albedo"] or _albedo(phases, mesh)
    textured = None if albedo != "texture" else settings["texture_size"] if mesh.texture is None else mesh.texture.shape[1::-1]
    height, width = views.images.shape[1:3]
    render.checked(fits_scene, profiles, len(views), width * height, order, len(mesh.positions), len(mesh.faces), textured,
                   {name for phase in phases for name in phase.optimize}, settings["texture_grad"])
    if linear:
        mesh = linear_mesh(mesh)
        views = replace(views, images=np.concatenate([srgb_to_linear(views.images[..., :3]), views.images[..., 3:]], axis=-1))
    moved = any("vertices" in phase.optimize for phase in phases)
    normals = settings["normals"] or ("smooth" if moved or mesh.normals is None else "file")
    problem = render.checked(
        Problem, mesh, views, order=order, seed=seed, albedo=albedo, lights=lights, normals=normals, judged=True,
        **{k: settings[k] for k in ("shading", "albedo_color", "srgb", "background", "texture_size", "wrap", "texture_grad")})
    problem.program.meta.update(linear_albedo=linear or settings["srgb"], linear_images=linear)
    side = max(problem.width, problem.height)
    for phase, soft in softs:
        softness = phase.table.checked(_softness, soft, side)
        phase.table.checked(problem.phase, phase.name, phase.steps, phase.optimize, phase.losses, softness)
    problem.render("render", SHARP, color=not (albedo == "constant" and settings["shading"] == "unlit"))
    return problem


def _mesh(job: Table, folder: Path):
    """Reads [mesh]; gives a function that loads it."""
    t = job.table("mesh", ("path", "sphere", "normalize", "texture"))
    if len(t.has("path", "sphere")) != 1:
        raise t.conflict("path or sphere is needed, and not both")
    scaled, texture = t.flag("normalize", False), t.file("texture", folder, None)
    file = t.file("path", folder, None)
    if file is None:
        if scaled:
            raise t.conflict("normalize is for path; a sphere has its radius")
        ball = t.table("sphere", ("vertices", "radius"))
        vertices, radius = ball.number("vertices", 2562, 4, 700_000, whole=True), ball.number("radius", 1.0, 0.0, above=True)

    def make() -> Mesh:
        if file is None:
            mesh = ball.checked(sphere, vertices, radius)
            return mesh if texture is None else replace(mesh, texture=t.checked(load_texture, texture))
        mesh = t.checked(load_mesh, file, texture)
        return t.checked(normalize, mesh) if scaled else mesh

    return make


def _views(job: Table, folder: Path, fits: Callable[[int, int, int], None]):
    """Reads [views]; gives the table and a function that loads them."""
    t = job.table("views", ("transforms", "gltf", "images", "size", "order", "seed", "color", "near", "far"))
    if len(t.has("transforms", "gltf")) != 1:
        raise t.conflict("transforms (a NeRF-style JSON or its folder) or gltf (cameras) is needed, and not both")
    transforms, gltf = t.file("transforms", folder, None), t.file("gltf", folder, None)
    size = t.numbers("size", 2, None, 1, 16384, whole=True)
    near, far = t.number("near", 0.05, 0.0, above=True), t.number("far", 100.0, 0.0, above=True)
    if far <= near:
        raise t.wrong("far", far, f"a number above near, {near:g}, is needed")
    if gltf is not None and t.has("near", "far"):
        raise t.conflict("near and far are for transforms; glTF cameras have their own")
    images = t.get("images", None)
    if (gltf is None) != (images is None):
        raise t.conflict("gltf and images belong together; transforms names its images itself")
    if images is not None:
        listed = images if isinstance(images, list) else [images]
        if not (listed and all(isinstance(i, str) and i for i in listed)):
            raise t.wrong("images", images, "a folder or a list of files is needed")
        listed = [t.path("images", folder, i) for i in listed]
        images = listed if isinstance(images, list) else listed[0]

    def make() -> Views:
        if transforms is not None:
            return t.checked(load_views, transforms, size, near, far, fits)
        return t.checked(load_gltf_views, gltf, images, size, fits)

    return t, make


def _render(job: Table) -> tuple[Table, dict]:
    t = Table(job.get("render", {}), "render", (*SOFT, "shading", "albedo", "albedo_color", "srgb", "background",
                                                 "texture_size", "wrap", "texture_grad", "normals"), job.source)
    settings = {"shading": t.word("shading", "unlit", SHADINGS), "albedo": t.word("albedo", None, ALBEDOS),
                "albedo_color": t.numbers("albedo_color", 3, (0.5,) * 3, 0, 1), "srgb": t.flag("srgb", False),
                "background": t.numbers("background", 3, (0.0,) * 3, 0, 1),
                "texture_size": t.numbers("texture_size", 2, (512, 512), 1, 16384, whole=True),
                "wrap": t.word("wrap", None, WRAPS), "normals": t.word("normals", None, NORMALS),
                "texture_grad": t.word("texture_grad", "exact", ("exact", "inverse_uv")), "soft": _soft(t)}
    if settings["srgb"] and job.get("views").get("color") == "linear":
        raise t.wrong("srgb", True, "views.color is \"linear\" already; set one of the two")
    return t, settings


def _soft(t: Table) -> dict:
    """The softness keys of a table that are there."""
    if len(t.has("r", "r_fraction")) > 1:
        raise t.conflict("r (pixels) and r_fraction (of the image's larger side) are both given; give one")
    soft = {"r": t.number("r", None, 0.0, above=True), "r_fraction": t.number("r_fraction", None, 0.0, 1.0, above=True),
            "sigma": t.number("sigma", None, 0.0, above=True), "delta": t.number("delta", None, 0.0),
            "layers": t.number("layers", None, 1, MAX_LAYERS, whole=True), "distance": t.word("distance", None, DISTANCES)}
    soft = {k: x for k, x in soft.items() if x is not None}
    if "r" in soft or "r_fraction" in soft:  # either replaces the other of an outer table
        soft = {"r": None, "r_fraction": None, **soft}
    return soft


def _softness(soft: dict, side: int) -> Softness:
    r = soft["r_fraction"] * side if soft.get("r_fraction") else soft.get("r") or 2.0
    return Softness(r, soft.get("sigma"), soft.get("delta"), soft.get("layers", 1), soft.get("distance"))


def _light(t: Table) -> Light:
    kind, power = t.word("kind", allowed=LIGHTS), t.get("power")
    if isinstance(power, list):
        power = t.numbers("power", 3, low=0)
    else:
        power = (float(t.number("power", low=0)),) * 3
    if kind == "ambient" and t.has("vector"):
        raise t.conflict("vector is for directional and point lights; an ambient light has none")
    return t.checked(Light, kind, power, None if kind == "ambient" else t.numbers("vector", 3))


def _phase(t: Table) -> _Phase:
    name, steps = t.word("name"), t.number("steps", low=1, high=10 ** 8, whole=True)
    optimize = t.get("optimize")
    if not isinstance(optimize, dict) or not optimize:
        raise t.wrong("optimize", optimize, "a table of parameters such as "
                      "vertices = {optimizer = \"adam\", rate = 0.01} is needed")
    inner = Table(optimize, f"{t.where}.optimize", optimize, t.source)
    losses = [_loss(x, steps) for x in t.tables("loss", ("kind", "weight", "norm", "masked", "power"))]
    if not losses:
        raise InputError(f"{t.source}: {t.where}.loss is missing; at least one [[phase.loss]] is needed")
    return _Phase(t, name, steps, {key: _optimizer(inner, key, steps) for key in optimize}, losses, _soft(t))


def _optimizer(outer: Table, key: str, steps: int) -> Adam | Sgd:
    every = tuple(dict.fromkeys(k for _, keys in OPTIMIZERS.values() for k in keys))
    t = outer.table(key, ("optimizer", *every))
    kind = t.word("optimizer", "adam", tuple(OPTIMIZERS))
    make, keys = OPTIMIZERS[kind]
    if extra := [k for k in t.has(*every) if k not in keys]:
        raise t.conflict(f"{extra[0]} is no setting of {kind}; allowed: {' '.join(keys)}")
    given = {"rate": _schedule(t, "rate", steps)}
    if t.has("betas"):
        given["betas"] = t.numbers("betas", 2, low=0, high=1)
    for name in t.has("epsilon", "momentum"):
        given[name] = t.number(name, low=0)
    if t.has("nesterov"):
        given["nesterov"] = t.flag("nesterov", False)
    return t.checked(make, **given)


def _schedule(t: Table, key: str, steps: int, default=NEEDED) -> Schedule:
    """A number or a schedule's table; one with an `end` spans the phase unless it says otherwise."""
    value = t.get(key, default)
    if isinstance(value, dict):
        t.table(key, ("start", "end", "steps", "kind", "at", "values", "warmup"))
        if "end" in value or value.get("kind") in ("exponential", "linear", "cosine"):
            value = {"steps": max(1, steps - value["warmup"] if isinstance(value.get("warmup"), int) else steps), **value}
    return t.checked(Schedule.parse, value, key)


def _loss(t: Table, steps: int) -> Loss:
    kind = t.word("kind", allowed=(*IMAGE_LOSSES, *MESH_LOSSES))
    of_image = kind in IMAGE_LOSSES
    if wrong := t.has("power") if of_image or kind == "normal_consistency" else t.has("norm", "masked"):
        raise t.conflict(f"{wrong[0]} is no setting of loss {kind}; drop it")
    return t.checked(Loss, kind, _schedule(t, "weight", steps, 1.0), t.word("norm", "l2", ("l1", "l2")),
                     t.flag("masked", False), t.number("power", 1, 1, 2, whole=True))


def _albedo(phases: list[_Phase], mesh: Mesh) -> str:
    """What the phases optimize, else what the mesh has."""
    named = {key for phase in phases for key in phase.optimize}
    if "texture" in named or "colors" not in named and mesh.texture is not None:
        return "texture"
    return "colors" if "colors" in named or mesh.colors is not None else "constant"
