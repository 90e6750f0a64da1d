"""Job files: TOML in, a checked `Problem` out, with a plan "render" that draws every view sharply. docs/job.md lists the keys.

Numbers, words and keys are checked before any file is read, and files before anything is built. Every mistake is an InputError
of one line: the job file, the key as table.key, what was found, what is allowed.
"""
from __future__ import annotations

import difflib
import math
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...cache.errors import InputError
from ..io.images import load_images, srgb_to_linear
from ..io.meshes import Mesh, load_mesh, load_texture, normalize
from ..io.shapes import sphere
from ..io.views import Views, load_gltf_cameras, load_views
from ..render.optimizer import Adam, Sgd
from ..render.raster import DISTANCES, MAX_LAYERS, Softness
from ..render.schedule import Schedule
from ..render.shade import KINDS as LIGHTS
from ..render.shade import Light
from .problem import ALBEDOS, IMAGE_LOSSES, MESH_LOSSES, ORDERS, SHADINGS, Loss, Problem

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

MAX_FILE_BYTES = 1 << 20
SHARP = Softness(1.0, delta=0.0)  # of the plan "render": about as soft as a pixel's own area
SOFT = ("r", "r_fraction", "sigma", "delta", "layers", "distance")
OPTIMIZERS = {"adam": (Adam, ("rate", "betas", "epsilon")), "sgd": (Sgd, ("rate", "momentum", "nesterov"))}
_NEEDED = object()


class _Table:
    """A table of the job: typed reads that know where they are."""

    def __init__(self, value, where: str, keys: Iterable[str], file: str):
        self.where, self.keys, self.file = where, tuple(keys), file
        if not isinstance(value, dict):
            raise self.wrong("", value, "a table is needed")
        self.value = value
        for key in value:
            if key not in self.keys:
                near = difflib.get_close_matches(key, self.keys, 1, 0.5)
                hint = f"did you mean {near[0]}?" if near else f"allowed: {' '.join(self.keys)}"
                raise InputError(f"{file}: {self._at(key)} is an unknown key; {hint}")

    def _at(self, key: str) -> str:
        return ".".join(filter(None, (self.where, key)))

    def wrong(self, key: str, found, allowed: str) -> InputError:
        return InputError(f"{self.file}: {self._at(key)} is {found!r:.60}; {allowed}")

    def conflict(self, text: str) -> InputError:
        return InputError(f"{self.file}: {self.where}: {text}")

    def has(self, *keys: str) -> list[str]:
        return [key for key in keys if key in self.value]

    def get(self, key: str, default=_NEEDED):
        if key in self.value:
            return self.value[key]
        if default is _NEEDED:
            raise InputError(f"{self.file}: {self._at(key)} is missing; it is needed")
        return default

    def number(self, key: str, default=_NEEDED, low: float = -math.inf, high: float = math.inf, whole: bool = False,
               above: bool = False):
        x = self.get(key, default)
        if key not in self.value:
            return x
        good = isinstance(x, int if whole else (int, float)) and not isinstance(x, bool)
        good = good and math.isfinite(x) and low <= x <= high
        if not good or above and x == low:
            span = f"{'above' if above else 'from'} {low:g}" if high == math.inf else f"from {low:g} to {high:g}"
            raise self.wrong(key, x, f"a {'whole ' if whole else ''}number{'' if low == -math.inf else ' ' + span} is needed")
        return x

    def word(self, key: str, default=_NEEDED, allowed: Sequence[str] = ()):
        x = self.get(key, default)
        if key in self.value and (not isinstance(x, str) or not x or allowed and x not in allowed):
            near = difflib.get_close_matches(x, allowed, 1, 0.5) if isinstance(x, str) else []
            hint = f"did you mean {near[0]}? " if near else ""
            raise self.wrong(key, x, f"{hint}allowed: {' '.join(allowed)}" if allowed else "a text is needed")
        return x

    def flag(self, key: str, default: bool) -> bool:
        x = self.get(key, default)
        if not isinstance(x, bool):
            raise self.wrong(key, x, "true or false is needed")
        return x

    def numbers(self, key: str, count: int, default=_NEEDED, low=-math.inf, high=math.inf, whole=False):
        x = self.get(key, default)
        if key not in self.value:
            return x
        if not isinstance(x, list) or len(x) != count:
            raise self.wrong(key, x, f"a list of {count} numbers is needed")
        cells = _Table({str(k): v for k, v in enumerate(x)}, self._at(key), map(str, range(count)), self.file)
        return tuple(cells.number(str(k), low=low, high=high, whole=whole) for k in range(count))

    def table(self, key: str, keys: Iterable[str]) -> _Table:
        return _Table(self.get(key), self._at(key), keys, self.file)

    def tables(self, key: str, keys: Iterable[str]) -> list[_Table]:
        x = self.get(key, [])
        if not isinstance(x, list):
            raise self.wrong(key, x, f"tables [[{self._at(key)}]] are needed")
        return [_Table(item, f"{self._at(key)}[{k}]", keys, self.file) for k, item in enumerate(x)]

    def checked(self, make, *args, **kwargs):
        """make(...), with this table named in its InputError."""
        try:
            return make(*args, **kwargs)
        except InputError as error:
            raise self.conflict(str(error)) from None


@dataclass(frozen=True)
class _Phase:
    table: _Table
    name: str
    steps: int
    optimize: dict
    losses: list[Loss]
    soft: dict


def load_job(path: str | Path) -> Problem:
    """The problem of a job file. Raises InputError, naming the file and the key."""
    path = Path(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"job {path} cannot be read: {error.strerror}; check the path") from None
    if len(data) > MAX_FILE_BYTES:
        raise InputError(f"job {path} has {len(data)} bytes; at most {MAX_FILE_BYTES} are allowed")
    try:
        document = tomllib.loads(data.decode("utf-8"))
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: byte {error.start} is not UTF-8; save the job as UTF-8") from None
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise InputError(f"{path}: not TOML: {error or 'nested too deeply'}; repair it") from None
    return parse_job(document, path)


def parse_job(document: dict, path: str | Path) -> Problem:
    """The problem of a parsed job; `path` is its file, for messages and for the paths in it."""
    path = Path(path)
    job = _Table(document, "", ("mesh", "views", "render", "light", "phase"), str(path))
    make_mesh = _mesh(job, path.parent)
    views_table, make_views = _views(job, path.parent)
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
    albedo = settings["albedo"] or _albedo(phases, mesh)
    linear_albedo = linear or settings["srgb"]
    if linear_albedo:
        mesh = replace(mesh, texture=None if mesh.texture is None else srgb_to_linear(mesh.texture),
                       colors=None if mesh.colors is None else srgb_to_linear(mesh.colors))
    if linear:
        views = replace(views, images=np.concatenate([srgb_to_linear(views.images[..., :3]), views.images[..., 3:]], axis=-1))
    problem = render.checked(
        Problem, mesh, views, order=order, seed=seed, albedo=albedo, lights=lights,
        **{k: settings[k] for k in ("shading", "albedo_color", "srgb", "background", "texture_size", "wrap", "texture_grad")})
    problem.program.meta.update(linear_albedo=linear_albedo, linear_images=linear)
    side = max(problem.width, problem.height)
    for phase, soft in softs:
        softness = phase.table.checked(_softness, soft, side)
        phase.table.checked(problem.phase, phase.name, phase.steps, phase.optimize, phase.losses, softness)
    problem.render("render", SHARP, color=not (albedo == "constant" and settings["shading"] == "unlit"))
    return problem


def _mesh(job: _Table, folder: Path):
    """Reads [mesh]; gives a function that loads it."""
    t = job.table("mesh", ("path", "sphere", "normalize", "texture"))
    if len(t.has("path", "sphere")) != 1:
        raise t.conflict("path or sphere is needed, and not both")
    scaled, texture = t.flag("normalize", False), t.word("texture", None)
    file = t.word("path", None)
    if file is None:
        if scaled:
            raise t.conflict("normalize is for path; a sphere has its radius")
        ball = t.table("sphere", ("vertices", "radius"))
        vertices, radius = ball.number("vertices", 2562, 4, 700_000, whole=True), ball.number("radius", 1.0, 0.0, above=True)

    def make() -> Mesh:
        if file is None:
            mesh = ball.checked(sphere, vertices, radius)
            return mesh if texture is None else replace(mesh, texture=t.checked(load_texture, folder / texture))
        mesh = t.checked(load_mesh, folder / file, None if texture is None else folder / texture)
        return t.checked(normalize, mesh) if scaled else mesh

    return make


def _views(job: _Table, folder: Path):
    """Reads [views]; gives the table and a function that loads them."""
    t = job.table("views", ("transforms", "gltf", "images", "size", "order", "seed", "color", "near", "far"))
    if len(t.has("transforms", "gltf")) != 1:
        raise t.conflict("transforms (a NeRF-style JSON or its folder) or gltf (cameras) is needed, and not both")
    transforms, gltf, size = t.word("transforms", None), t.word("gltf", None), t.numbers("size", 2, None, 1, 16384, whole=True)
    near, far = t.number("near", 0.05, 0.0, above=True), t.number("far", 100.0, 0.0, above=True)
    if far <= near:
        raise t.wrong("far", far, f"a number above near, {near:g}, is needed")
    if gltf is not None and t.has("near", "far"):
        raise t.conflict("near and far are for transforms; glTF cameras have their own")
    images = t.get("images", None)
    if (gltf is None) != (images is None):
        raise t.conflict("gltf and images belong together; transforms names its images itself")
    listed = images if isinstance(images, list) else [images]
    if images is not None and not (listed and all(isinstance(i, str) for i in listed)):
        raise t.wrong("images", images, "a folder or a list of files is needed")

    def make() -> Views:
        if transforms is not None:
            return t.checked(load_views, folder / transforms, size, near, far)
        pixels, names = t.checked(load_images, folder / images if isinstance(images, str) else [folder / i for i in images])
        cameras = t.checked(load_gltf_cameras, folder / gltf, pixels.shape[2], pixels.shape[1])
        views = t.checked(Views, pixels, cameras, names)
        return views if size is None else t.checked(views.resized, size)

    return t, make


def _render(job: _Table) -> tuple[_Table, dict]:
    t = _Table(job.get("render", {}), "render", (*SOFT, "shading", "albedo", "albedo_color", "srgb", "background",
                                                 "texture_size", "wrap", "texture_grad"), job.file)
    settings = {"shading": t.word("shading", "unlit", SHADINGS), "albedo": t.word("albedo", None, ALBEDOS),
                "albedo_color": t.numbers("albedo_color", 3, (0.5,) * 3, 0, 1), "srgb": t.flag("srgb", False),
                "background": t.numbers("background", 3, (0.0,) * 3, 0, 1),
                "texture_size": t.numbers("texture_size", 2, (512, 512), 1, 16384, whole=True),
                "wrap": t.word("wrap", "repeat", ("repeat", "clamp")),
                "texture_grad": t.word("texture_grad", "exact", ("exact", "inverse_uv")), "soft": _soft(t)}
    if settings["srgb"] and job.get("views").get("color") == "linear":
        raise t.wrong("srgb", True, "views.color is \"linear\" already; set one of the two")
    return t, settings


def _soft(t: _Table) -> dict:
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


def _light(t: _Table) -> Light:
    kind, power = t.word("kind", allowed=LIGHTS), t.get("power")
    if isinstance(power, list):
        power = t.numbers("power", 3, low=0)
    else:
        power = (float(t.number("power", low=0)),) * 3
    if kind == "ambient" and t.has("vector"):
        raise t.conflict("vector is for directional and point lights; an ambient light has none")
    return t.checked(Light, kind, power, None if kind == "ambient" else t.numbers("vector", 3))


def _phase(t: _Table) -> _Phase:
    name, steps = t.word("name"), t.number("steps", low=1, high=10 ** 8, whole=True)
    optimize = t.get("optimize")
    if not isinstance(optimize, dict) or not optimize:
        raise t.wrong("optimize", optimize, "a table of parameters such as "
                      "vertices = {optimizer = \"adam\", rate = 0.01} is needed")
    inner = _Table(optimize, f"{t.where}.optimize", optimize, t.file)
    losses = [_loss(x, steps) for x in t.tables("loss", ("kind", "weight", "norm", "masked", "power"))]
    if not losses:
        raise InputError(f"{t.file}: {t.where}.loss is missing; at least one [[phase.loss]] is needed")
    return _Phase(t, name, steps, {key: _optimizer(inner, key, steps) for key in optimize}, losses, _soft(t))


def _optimizer(outer: _Table, key: str, steps: int) -> Adam | Sgd:
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


def _schedule(t: _Table, key: str, steps: int, default=_NEEDED) -> Schedule:
    """A number or a schedule's table; one with an `end` spans the phase unless it says otherwise."""
    value = t.get(key, default)
    if isinstance(value, dict):
        t.table(key, ("start", "end", "steps", "kind", "at", "values", "warmup"))
        if "end" in value or value.get("kind") in ("exponential", "linear", "cosine"):
            value = {"steps": max(1, steps - value["warmup"] if isinstance(value.get("warmup"), int) else steps), **value}
    return t.checked(Schedule.parse, value, key)


def _loss(t: _Table, steps: int) -> Loss:
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
