"""Job files: TOML in, a checked `Problem` out, with a plan "render" that draws every view sharply. docs/job.md lists the keys.

Numbers, words and keys are checked before any file is read, and files before anything is built. Every mistake is an InputError
of one line: the job file, the key as table.key, what was found, what is allowed.
"""
from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ...cache.errors import InputError
from ...cache.profile import Profile
from ..io.mesh import NORMALS, Mesh, linear_mesh
from ..io.text import bounded, read_bytes, shown
from . import sense
from .job_file import parse_file_scene
from .job_scene import SceneJob, parse_scene
from .job_views import job_views
from .limits import fits_scene
from .problem import ALBEDOS, IMAGE_LOSSES, MESH_LOSSES, SHADINGS, Loss, Problem
from .sections import (
    LIGHT,
    MESH,
    SAMPLED,
    SHARP,
    SOFT,
    light_of,
    limit,
    mesh_of,
    no_points_in,
    optimizer_of,
    sampled,
    schedule_of,
    soft,
    softness_of,
    wrap_of,
)
from .tables import Table
from .targets import Carried, at_once

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

MAX_FILE_BYTES = 1 << 20
MAX_PHASE_NAME = 100


@dataclass(frozen=True)
class _Phase:
    table: Table
    name: str
    steps: int
    optimize: dict
    losses: list[Loss]
    soft: dict


def load_job(path: str | Path, profiles: Sequence[Profile] = (), told: Callable[[int, int], None] | None = None,
             carried: Carried = Carried()) -> Problem | SceneJob:  # noqa: B008  (frozen)
    """The problem of a job file. What is too large for one of the `profiles` is said before pictures are decoded. told: called with how
    many pictures of how many are read. carried: what the bundle has of them. Raises InputError, naming the file and the key."""
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
    return parse_job(document, path, profiles, told, carried)


def parse_job(document: dict, path: str | Path, profiles: Sequence[Profile] = (),
              told: Callable[[int, int], None] | None = None, carried: Carried = Carried()) -> Problem | SceneJob:  # noqa: B008  (frozen)
    """The problem of a parsed job; `path` is its file, for messages and for the paths in it. The rest: as in `load_job`."""
    path = Path(path)
    bounded(document, str(path))
    if "part" in document or "scene" in document:
        return (parse_scene if "part" in document else parse_file_scene)(document, path, profiles, told, carried)
    job = Table(document, "", ("mesh", "views", "render", "light", "limits", "phase"), str(path))
    make_mesh = mesh_of(job.table("mesh", MESH), path.parent)
    seen = job_views(job, path.parent, profiles, told, carried)
    carried, linear = seen.carried, seen.linear
    phases = [_phase(p) for p in job.tables("phase", ("name", "steps", "optimize", "loss", *SOFT))]
    if not phases:
        raise InputError(f"{path}: phase is missing; at least one [[phase]] is needed")
    render, settings = _render(job)
    lights = [light_of(x) for x in job.tables("light", LIGHT)]
    if settings["shading"] == "unlit" and lights:
        raise InputError(f"{path}: light[0] is given, but render.shading is 'unlit'; "
                         "set render.shading = \"lambert\", or drop it")
    softs = [(p, {**settings["soft"], **p.soft}) for p in phases]

    mesh, views = make_mesh(seen.load), seen.load()
    order = seen.order(views)
    job.checked(no_points_in, views, lights)
    seen.table.checked(sense.check, mesh, views, any(loss.kind == "silhouette" for phase in phases for loss in phase.losses),
                        "mesh.normalize has moved and scaled the mesh, but not the cameras" if job.get("mesh").get("normalize") else "",
                        "path" in job.get("mesh"))
    albedo = settings["albedo"] or _albedo(phases, mesh)
    textured = None if albedo != "texture" else settings["texture_size"] if mesh.texture is None else mesh.texture.shape[1::-1]
    height, width = views.images.shape[1:3]
    drawn = at_once(order, len(views), width, height, carried.whole)
    render.checked(fits_scene, profiles, drawn, width * height, order, len(mesh.positions), len(mesh.faces), textured,
                   {name for phase in phases for name in phase.optimize}, settings["texture_grad"])
    if linear:
        mesh = linear_mesh(mesh)
        views = views.linear()
    moved = any("vertices" in phase.optimize for phase in phases)
    normals = settings["normals"] or ("smooth" if moved or mesh.normals is None else "file")
    problem = render.checked(
        Problem, mesh, views, order=order, seed=seen.seed, albedo=albedo, lights=lights, normals=normals, judged=True,
        **carried.of(len(views), width, height),
        **{k: settings[k] for k in ("shading", "albedo_color", "srgb", "background", "texture_size", "wrap", "texture_grad", *SAMPLED)})
    problem.program.meta.update(linear_albedo=linear or settings["srgb"], linear_images=linear, **seen.meta(views))
    limit(job, problem.scene)
    side = max(problem.width, problem.height)
    for phase, widths in softs:
        softness = phase.table.checked(softness_of, widths, side)
        phase.table.checked(problem.phase, phase.name, phase.steps, phase.optimize, phase.losses, softness)
    problem.render("render", SHARP, color=not (albedo == "constant" and settings["shading"] == "unlit"))
    return problem


def _render(job: Table) -> tuple[Table, dict]:
    t = Table(job.get("render", {}), "render", (*SOFT, "shading", "albedo", "albedo_color", "srgb", "background",
                                                 "texture_size", "wrap", "texture_grad", *SAMPLED, "normals"), job.source)
    settings = {"shading": t.word("shading", "unlit", SHADINGS), "albedo": t.word("albedo", None, ALBEDOS),
                "albedo_color": t.numbers("albedo_color", 3, (0.5,) * 3, 0, 1), "srgb": t.flag("srgb", False),
                "background": t.numbers("background", 3, (0.0,) * 3, 0, 1),
                "texture_size": t.numbers("texture_size", 2, (512, 512), 1, 16384, whole=True),
                "wrap": wrap_of(t), "normals": t.word("normals", None, NORMALS),
                "texture_grad": t.word("texture_grad", "exact", ("exact", "inverse_uv")), "soft": soft(t), **sampled(t)}
    if settings["srgb"] and job.get("views").get("color") == "linear":
        raise t.wrong("srgb", True, "views.color is \"linear\" already; set one of the two")
    return t, settings


def _phase(t: Table) -> _Phase:
    name, steps = t.word("name"), t.number("steps", low=1, high=10 ** 8, whole=True)
    if not name.isprintable() or len(name) > MAX_PHASE_NAME or name == "render":
        raise t.wrong("name", name, f"a name of up to {MAX_PHASE_NAME} letters, none of control, is needed, "
                      "and not that of the plan \"render\"")
    optimize = t.get("optimize")
    if not isinstance(optimize, dict) or not optimize:
        raise t.wrong("optimize", optimize, "a table of parameters such as "
                      "vertices = {optimizer = \"adam\", rate = 0.01} is needed")
    inner = Table(optimize, f"{t.where}.optimize", optimize, t.source)
    losses = [_loss(x, steps) for x in t.tables("loss", ("kind", "weight", "norm", "masked", "power"))]
    if not losses:
        raise InputError(f"{t.source}: {t.where}.loss is missing; at least one [[phase.loss]] is needed")
    return _Phase(t, name, steps, {key: optimizer_of(inner, key, steps) for key in optimize}, losses, soft(t))


def _loss(t: Table, steps: int) -> Loss:
    kind = t.word("kind", allowed=(*IMAGE_LOSSES, *MESH_LOSSES))
    of_image = kind in IMAGE_LOSSES
    if wrong := t.has("power") if of_image or kind == "normal_consistency" else t.has("norm", "masked"):
        raise t.conflict(f"{wrong[0]} is no setting of loss {kind}; drop it")
    return t.checked(Loss, kind, schedule_of(t, "weight", steps, 1.0), t.word("norm", "l2", ("l1", "l2")),
                     t.flag("masked", False), t.number("power", 1, 1, 2, whole=True))


def _albedo(phases: list[_Phase], mesh: Mesh) -> str:
    """What the phases optimize, else what the mesh has."""
    named = {key for phase in phases for key in phase.optimize}
    if "texture" in named or "colors" not in named and mesh.texture is not None:
        return "texture"
    return "colors" if "colors" in named or mesh.colors is not None else "constant"
