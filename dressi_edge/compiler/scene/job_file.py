"""Jobs whose scene is a glTF file: [scene] instead of [[part]]; a table in, a `SceneJob` out. docs/job.md lists the keys.

Parts, materials and textures are the file's, and so are the lights unless the job has [[light]]; what phases optimize is called as
`load_scene` calls it: `<part>.vertices`, `<part>.texture`, `<part>.roughness`, ..., `light0.power`, `environment.map`, `exposure`.
"""
from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from ...cache.errors import InputError
from ...cache.profile import Profile
from ..io.mesh import middle_of, together
from ..io.meshes import load_parts
from ..render.tone import encode_srgb
from . import sense
from .file_scene import load_scene, names_of
from .job_scene import SceneJob, add_phases, phase_of
from .job_views import job_views
from .sections import ENVIRONMENT, LIGHT, SAMPLED, SOFT, environment_of, light_of, limit, sampled, soft, tone_of
from .tables import Table
from .targets import Carried


def parse_file_scene(document: dict, path: Path, profiles: Sequence[Profile] = (),
                     told: Callable[[int, int], None] | None = None, carried: Carried = Carried()) -> SceneJob:  # noqa: B008  (frozen)
    """The scene of a parsed job. Raises InputError, naming the file and the key."""
    job = Table(document, "", ("scene", "views", "render", "light", "environment", "limits", "phase"), str(path))
    file = job.table("scene", ("path", *SAMPLED))
    source, how = file.file("path", path.parent), sampled(file, True)
    seen = job_views(job, path.parent, profiles, told, carried)
    linear = seen.linear
    render = Table(job.get("render", {}), "render", (*SOFT, "background", "tone"), job.source)
    background, common = render.numbers("background", 3, (0.0,) * 3, 0, 1), soft(render)
    tone, around = tone_of(render, not linear), environment_of(job, path.parent)
    lights = [light_of(x) for x in job.tables("light", LIGHT)] if "light" in document else None
    parts = file.checked(load_parts, source)
    phases = [phase_of(t, names_of(parts)) for t in job.tables("phase", ("name", "steps", "optimize", "loss", *SOFT))]
    if not phases:
        raise InputError(f"{path}: phase is missing; at least one [[phase]] is needed")
    views = seen.load()
    whole = together([part.mesh for part in parts])
    silhouettes = any(term.kind == "silhouette" for phase in phases for term in phase.terms)
    seen.table.checked(sense.check, whole, views, silhouettes, "", True)
    views = views.linear() if linear else views
    encode = tone or (None if linear else encode_srgb)
    if around is not None:
        how |= {"environment": job.table("environment", ENVIRONMENT).checked(around.made), "shown": around.shown}
    scene = file.checked(load_scene, source, views.cameras, parameters=sorted({key for phase in phases for key in phase.optimize}),
                         lights=lights, background=background, encode=encode, **how)
    scene.program.meta.update(linear_albedo=True, linear_images=linear, **seen.meta(views))
    limit(job, scene)
    targets, shown = add_phases(scene, views, phases, common, seen, background)
    return SceneJob(scene, views.names, tuple(map(float, middle_of(whole.positions))), {}, targets, shown)
