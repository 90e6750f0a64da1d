"""Jobs of several parts: [[part]] tables in, a `Scene` out. docs/job.md lists the keys.

A part's parameters are named after it: `<part>.vertices`, `.rotation`, `.translation`, `.scale`, `.texture`, `.colors`, `.color`,
`.specular`, `.gloss`, `.roughness`, `.metallic`, `.emissive`, `.normal`; that of the picture `exposure`; those of cameras
`camera.rotation` and `camera.translation`; lights as ever. What no phase optimizes is a constant, but for textures, colours and lights.
"""
from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...cache.errors import InputError
from ...cache.profile import Profile
from ..graph.functions import compose, constant_table
from ..graph.ir import Node
from ..graph.program import Program
from ..io.cameras import rotation_matrix
from ..io.frame import recentred_parts
from ..io.mesh import Mesh, linear_mesh, middle_of, origin_of, together
from ..io.views import Views
from ..render import loss as losses
from ..render.brdf import LEAST_ROUGHNESS
from ..render.environment import Environment
from ..render.frame import Frame
from ..render.geometry import similarity
from ..render.light import Light
from ..render.material import BlinnPhong, Corner, Lambert, NormalMap, Texture, Unlit, Vertex
from ..render.optimizer import Optimizer
from ..render.part import Part
from ..render.pbr import PBR
from ..render.raster import Binned, Softness, renderer_of
from ..render.schedule import Schedule
from ..render.tone import Tone, encode_srgb
from . import sense
from .job_part import COLORS, MATERIALS, NUMBERS, PartTable, part_of
from .job_views import JobViews, job_views
from .pieces import frame_meta, record
from .scene import Scene
from .sections import (
    ENVIRONMENT,
    LIGHT,
    MESH,
    SHARP,
    SOFT,
    environment_of,
    flat,
    light_of,
    limit,
    no_points_in,
    optimizer_of,
    schedule_of,
    soft,
    softness_of,
    tone_of,
)
from .tables import Table
from .targets import Carried, Targets, targets_of, windowed
from .values import GAINS, gains

KINDS = {"unlit": Unlit, "lambert": Lambert, "blinn_phong": BlinnPhong, "pbr": PBR}
POSES = ("rotation", "translation", "scale")
NORMS = {"l1": losses.l1, "l2": losses.l2, "huber": losses.huber, "ssim": losses.ssim_loss, "pyramid": losses.pyramid_l1}
OF_IMAGES = ("silhouette", "color")
OF_MESHES = {"laplacian": losses.uniform_laplacian, "cotangent_laplacian": losses.cotangent_laplacian,
             "normal_consistency": lambda p, t, power: losses.normal_consistency(p, t),
             "edge_length": lambda p, t, power: losses.edge_length(p, t)}
OF_PARAMETERS = {"magnitude": lambda x, power: losses.mean_square(x), "total_variation": losses.total_variation,
                 "tint": lambda x, power: losses.tint(x)}
LIMITS = {"texture": (0.0, 1.0), "colors": (0.0, 1.0), "color": (0.0, 1.0), "specular": (0.0, None), "gloss": (1.0, None),
          "scale": (1e-3, None), "normal": (0.0, 1.0), "roughness": (LEAST_ROUGHNESS, 1.0), "metallic": (0.0, 1.0), "emissive": (0.0, None)}

FLAT = (0.5, 0.5, 1.0)  # of a map of normals


@dataclass(frozen=True, eq=False)
class SceneJob:
    """The scene of a job, its pictures' names, the point that cameras turn about, what its meta says of its frame, its pictures, and
    outputs that draw one view, with the input that says which."""

    scene: Scene
    images: tuple[str, ...]
    pivot: tuple[float, float, float]
    frame: dict
    targets: Targets
    shown: dict[str, str]

    @property
    def program(self) -> Program:
        return self.scene.program

    @property
    def phases(self) -> list[str]:
        return self.scene.phases

    def record(self) -> dict:
        """The meta of the bundle."""
        return {**record(self.scene, self.images), "pivot": list(self.pivot), **self.frame,
                **self.targets.meta(self.program, self.shown)}

    def compile(self, profile: Profile | str | Sequence[Profile | str], path: str | os.PathLike, **options) -> dict:
        """Write the bundle; see `compiler.compile_program`."""
        self.program.meta.update(self.record())
        self.program.attached["pictures"] = self.targets.blobs()
        return self.scene.compile(profile, path, memory=self.targets.memory, **options)


@dataclass(frozen=True)
class _Term:
    table: Table
    kind: str
    weight: Schedule
    norm: str
    masked: bool
    power: int
    part: str | None
    parameter: str | None


@dataclass(frozen=True)
class _PhaseTable:
    table: Table
    name: str
    steps: int
    optimize: dict[str, Optimizer]
    terms: list[_Term]
    soft: dict


def parse_scene(document: dict, path: Path, profiles: Sequence[Profile] = (),
                told: Callable[[int, int], None] | None = None, carried: Carried = Carried()) -> SceneJob:  # noqa: B008  (frozen)
    """The scene of a parsed job. Raises InputError, naming the file and the key."""
    job = Table(document, "", ("part", "views", "render", "light", "environment", "limits", "phase"), str(path))
    parts = [part_of(t, path.parent) for t in job.tables("part", ("name", "normals", "material", *POSES, *MESH))]
    if not parts:
        raise InputError(f"{path}: part is empty; at least one [[part]] is needed")
    if twice := [p.name for k, p in enumerate(parts) if p.name in [q.name for q in parts[:k]]]:
        raise InputError(f"{path}: two parts are called {twice[0]!r}; give each part a name of its own")
    seen = job_views(job, path.parent, profiles, told, carried)
    linear = seen.linear
    render = Table(job.get("render", {}), "render", (*SOFT, "srgb", "background", "tone"), job.source)
    srgb, background, common = render.flag("srgb", False), render.numbers("background", 3, (0.0,) * 3, 0, 1), soft(render)
    if srgb and linear:
        raise render.wrong("srgb", True, "views.color is \"linear\" already; set one of the two")
    tone = tone_of(render, srgb)
    lights = [light_of(x) for x in job.tables("light", LIGHT)]
    around = environment_of(job, path.parent)
    if around is not None and all(p.kind != "pbr" for p in parts) and not around.shown:
        raise InputError(f"{path}: environment is given, but no part's material is of kind pbr, and it is not shown; change one, or drop "
                         "it")
    if lights and all(p.kind == "unlit" for p in parts):
        raise InputError(f"{path}: light[0] is given, but no part's material has a use for it; make one lambert, or drop it")
    phases = [phase_of(t, [p.name for p in parts]) for t in job.tables("phase", ("name", "steps", "optimize", "loss", *SOFT))]
    if not phases:
        raise InputError(f"{path}: phase is missing; at least one [[phase]] is needed")
    optimized = {key for phase in phases for key in phase.optimize}

    meshes, views = [p.load(seen.load) for p in parts], seen.load()
    job.checked(no_points_in, views, lights)
    placed = together([_placed(p, mesh) for p, mesh in zip(parts, meshes)])
    meshes, views, lights, origin = recentred_parts(meshes, views, lights, origin_of(placed.positions))
    placed = replace(placed, positions=placed.positions - origin)
    silhouettes = any(t.kind == "silhouette" for phase in phases for t in phase.terms)
    seen.table.checked(sense.check, placed, views, silhouettes,
                        "normalize has moved and scaled a part, but not the cameras" * any(p.table.has("normalize") for p in parts),
                        all(p.table.has("path") for p in parts))
    if linear:
        views = views.linear()
    scene = Scene(views.cameras, background, encode_srgb if srgb else None)
    scene.program.meta.update(linear_albedo=linear or srgb, linear_images=linear, **seen.meta(views))
    if tone is not None:
        exposure = scene.parameter("exposure", tone.exposure) if "exposure" in optimized else tone.exposure
        scene.encode = replace(tone, exposure=exposure)
    surroundings = None if around is None else job.table("environment", ENVIRONMENT).checked(around.into, scene, optimized)
    if around is not None and around.shown:
        scene.surroundings = surroundings
    builder = _Builder(scene, optimized, lights, linear or srgb, surroundings)
    for p, mesh in zip(parts, meshes):
        p.table.checked(builder.part, p, mesh)
    middle = builder.cameras(meshes)
    if "gain" in optimized:
        scene.gain = gains(scene.parameter("gain", np.ones((len(views.cameras), 3)), *GAINS, kind="table"))
    for phase in phases:
        for key in phase.optimize:
            if key not in scene.parameters:
                raise phase.table.conflict(f"optimize.{key} is no parameter of this job; there are: {' '.join(_known(scene, parts))}")
    limit(job, scene)
    targets, shown = add_phases(scene, views, phases, common, seen, background)
    vertices = [f"{p.name}.vertices" for p in parts if f"{p.name}.vertices" in scene.parameters]
    return SceneJob(scene, views.names, middle, frame_meta(origin, vertices, lights, views.unit), targets, shown)


def _placed(p: PartTable, mesh: Mesh) -> Mesh:
    """The mesh where the part's own pose puts it (`_Builder._positions`)."""
    middle = middle_of(mesh.positions)
    turned = (mesh.positions - middle) @ rotation_matrix(p.pose.get("rotation", np.zeros(3))).T * p.pose.get("scale", 1.0)
    return replace(mesh, positions=middle + turned + p.pose.get("translation", np.zeros(3))) if p.pose else mesh


def _known(scene: Scene, parts: Sequence[PartTable]) -> list[str]:
    """The names of all that may be optimized."""
    of_parts = [f"{p.name}.{key}" for p in parts for key in ("vertices", *POSES, *(k for k in MATERIALS[p.kind] if k != "color"))]
    of_picture = ["gain", *(["exposure"] if isinstance(scene.encode, Tone) else [])]
    return sorted({*scene.parameters, *of_parts, *of_picture, "camera.rotation", "camera.translation"})


def phase_of(t: Table, parts: Sequence[str]) -> _PhaseTable:
    name, steps = t.word("name"), t.number("steps", low=1, high=10 ** 8, whole=True)
    optimize = t.get("optimize")
    if not isinstance(optimize, dict) or not optimize:
        raise t.wrong("optimize", optimize, "a table of parameters such as part.vertices = {optimizer = \"adam\", rate = 0.01} is needed")
    optimize = flat(optimize, ("rate",))
    inner = Table(optimize, f"{t.where}.optimize", optimize, t.source)
    terms = [_term(x, steps, parts) for x in t.tables("loss", ("kind", "weight", "norm", "masked", "power", "part", "parameter"))]
    if not terms:
        raise InputError(f"{t.source}: {t.where}.loss is missing; at least one [[phase.loss]] is needed")
    return _PhaseTable(t, name, steps, {key: optimizer_of(inner, key, steps) for key in optimize}, terms, soft(t))


def _term(t: Table, steps: int, parts: Sequence[str]) -> _Term:
    kind = t.word("kind", allowed=(*OF_IMAGES, *OF_MESHES, *OF_PARAMETERS))
    own = {"magnitude": ("parameter",), "tint": ("parameter",), "total_variation": ("parameter", "power")}
    allowed = ("norm", "masked") if kind in OF_IMAGES else own.get(kind, ("power", "part"))
    if wrong := [key for key in t.has("norm", "masked", "power", "part", "parameter") if key not in allowed]:
        raise t.conflict(f"{wrong[0]} is no setting of loss {kind}; drop it")
    part = t.word("part", None, tuple(parts))
    if kind in OF_MESHES and part is None:
        if len(parts) > 1:
            raise t.conflict(f"part is missing; loss {kind} is of one part: {' '.join(parts)}")
        part = parts[0]
    parameter = t.word("parameter") if kind in OF_PARAMETERS else None
    return _Term(t, kind, schedule_of(t, "weight", steps, 1.0), t.word("norm", "l2", tuple(NORMS)), t.flag("masked", False),
                 t.number("power", 1, 1, 2, whole=True), part, parameter)


@dataclass(frozen=True)
class _Builder:
    """Adds parts to a scene. decode: whether meshes' colours are decoded, for the scene is lit or compared in linear light."""

    scene: Scene
    optimized: set[str]
    lights: Sequence[Light]
    decode: bool
    surroundings: Environment | None

    def part(self, p: PartTable, mesh: Mesh) -> Part:
        if self.decode:
            mesh = linear_mesh(mesh)
        positions, moved = self._positions(p, mesh)
        settings = {"color": self._color(p, mesh)}
        settings |= {key: self._setting(p, mesh, key) for key in p.settings if key not in ("color", "two_sided", "normal")}
        if "two_sided" in p.settings:
            settings["two_sided"] = p.settings["two_sided"]
        if p.kind == "pbr":
            settings["environment"] = self.surroundings
            if p.settings["normal"] or f"{p.name}.normal" in self.optimized:
                settings["normal"] = NormalMap(self._map(p, mesh, "normal", FLAT))
        if p.kind != "unlit":
            settings["lights"] = self._lights(p)
        make = KINDS[p.kind]
        normals = p.normals or ("smooth" if moved or mesh.normals is None else "file")
        if moved and normals == "file":
            raise InputError("normals are \"file\", which do not turn with a part that moves; use flat or smooth")
        return self.scene.add(mesh, positions, make(**settings), p.name, normals)

    def _setting(self, p: PartTable, mesh: Mesh, key: str):
        """A setting of a part's material: numbers, or the parameter of that name if it is optimized, or a texture."""
        value = p.settings[key]
        return self._map(p, mesh, key, NUMBERS[key][:1]) if value == "texture" else self._number(f"{p.name}.{key}", value)

    def _map(self, p: PartTable, mesh: Mesh, key: str, start: Sequence[float]) -> Texture:
        """A texture that starts as one value."""
        if mesh.uvs is None:
            raise InputError(f"material.{key} is \"texture\", but the mesh has no texture coordinates; "
                             f"{'drop it' if key == 'normal' else 'give a number'}, or give a mesh that has them")
        image = np.full((*p.texture_size[::-1], len(start)), start)
        return Texture(self.scene.parameter(f"{p.name}.{key}", image, *LIMITS[key], kind="image"), p.wrap or mesh.wrap, **p.sampled)

    def _number(self, name: str, value):
        """Numbers of a material, or the parameter of that name if it is optimized."""
        if name not in self.optimized:
            return value
        low, high = LIMITS[name.rpartition(".")[2]]
        return self.scene.parameter(name, value, low, high)

    def _positions(self, p: PartTable, mesh: Mesh) -> tuple[Node, bool]:
        """Where the part's vertices are, and whether anything moves them."""
        name, start = p.name, {"rotation": np.zeros(3), "translation": np.zeros(3), "scale": 1.0, **p.pose}
        free = f"{name}.vertices" in self.optimized
        x = self.scene.parameter(f"{name}.vertices", mesh.positions, kind="table") if free else constant_table(mesh.positions)
        if not any(f"{name}.{key}" in self.optimized or key in p.pose for key in POSES):
            return x, free
        at = {key: self.scene.parameter(f"{name}.{key}", value, *LIMITS.get(key, ())) if f"{name}.{key}" in self.optimized else value
              for key, value in start.items()}
        return similarity(x, at["rotation"], at["translation"], at["scale"], middle_of(mesh.positions)), True

    def _color(self, p: PartTable, mesh: Mesh):
        named, color = p.name + ".", p.settings["color"]
        if color is None:
            color = next((key for key in COLORS if named + key in self.optimized), None)
        if color is None and f"{named}color" not in self.optimized:
            color = "texture" if mesh.texture is not None else "colors" if mesh.colors is not None else None
        if color == "texture":
            if mesh.uvs is None:
                raise InputError("material.color is \"texture\", but the mesh has no texture coordinates; use colors, or a mesh that "
                                 "has them")
            start = np.full((*p.texture_size[::-1], 3), 0.5) if mesh.texture is None else mesh.texture
            return Texture(self.scene.parameter(f"{named}texture", start, *LIMITS["texture"], kind="image"), p.wrap or mesh.wrap,
                           **p.sampled)
        if color == "colors":
            start = np.full((len(mesh.positions), 3), 0.5) if mesh.colors is None else mesh.colors
            own = self.scene.parameter(f"{named}colors", start, *LIMITS["colors"], kind="table")
            return Vertex(own) if mesh.color_faces is None else Corner(own, mesh.color_faces)
        return self._number(f"{named}color", color or (0.5, 0.5, 0.5))

    def _lights(self, p: PartTable) -> list[Light]:
        """The lights, of which every part that is lit shares the parameters."""
        if not self.lights and (p.kind != "pbr" or self.surroundings is None):
            raise InputError(f"material.kind is {p.kind!r}, but there is no [[light]]; give at least one")
        return self.scene.lit(self.lights)

    def cameras(self, meshes: Sequence[Mesh]) -> tuple[float, float, float]:
        """Cameras that move where a phase says so, about the middle of all parts; that point."""
        middle = tuple(map(float, middle_of(np.concatenate([m.positions for m in meshes]))))
        if {"camera.rotation", "camera.translation"} & self.optimized:
            zero = np.zeros((len(self.scene.cameras), 3))
            turn, shift = (self.scene.parameter(f"camera.{key}", zero, kind="table") for key in ("rotation", "translation"))
            self.scene.pose_cameras(turn, shift, middle)
        return middle


def add_phases(scene: Scene, views: Views, phases: Sequence[_PhaseTable], common: dict, seen: JobViews,
               background) -> tuple[Targets, dict[str, str]]:
    """The phases of a job, and what draws its pictures; common: softness where a phase says none. The pictures, and of outputs that draw
    one view the input that says which. Raises InputError."""
    order, seed, carried = seen.order(views), seen.seed, seen.carried
    targets = targets_of(scene, views, order, seed, **carried.of(len(views), scene.width, scene.height))
    side = max(scene.width, scene.height)
    for phase in phases:
        softness = phase.table.checked(softness_of, {**common, **phase.soft}, side)
        phase.table.checked(add_phase, scene, phase, softness, order, seed, targets, background)
    one = windowed(order, len(views), scene.width, scene.height, carried.whole)
    seen = scene.frame(renderer_of(SHARP), view=scene.input("render.view", 0, integer=True) if one else None)
    scene.output("render", color=compose(seen.color, seen.alpha))
    return targets, {"render.color": "render.view"} if one else {}


def add_phase(scene: Scene, phase: _PhaseTable, softness: Softness | Binned, order: str, seed: int, targets: Targets, background) -> None:
    frame = scene.frame(renderer_of(softness), phase=phase.name, order=order, seed=seed,
                        view=targets.turned(scene, phase.name, phase.optimize))
    target, terms = targets.at(frame), {}
    for term in phase.terms:
        name = next(n for n in (term.kind, *(f"{term.kind}{k}" for k in range(2, 99))) if n not in terms)
        terms[name] = (term.weight, term.table.checked(_value, scene, term, frame, target, compose(*background)))
    scene.phase(phase.name, phase.steps, phase.optimize, **terms)


def _value(scene: Scene, term: _Term, frame: Frame, target: Node, background: Node) -> Node:
    """A term, not weighted."""
    if term.kind in OF_PARAMETERS:
        if term.parameter not in scene.parameters:
            raise InputError(f"parameter is {term.parameter!r}; there are: {' '.join(scene.parameters)}")
        node = scene.parameters[term.parameter].node
        if term.kind in ("total_variation", "tint") and scene.program.values[term.parameter].layout.kind != "image":
            raise InputError(f"parameter {term.parameter} is no image; {term.kind} is of textures and environments")
        return OF_PARAMETERS[term.kind](node, term.power)
    if term.part is not None:
        part = next(p for p in scene.parts if p.name == term.part)
        return OF_MESHES[term.kind](part.positions, part.topology, term.power)
    norm, alpha = NORMS[term.norm], target.w
    cell = {"cell": frame.cell} if term.norm in ("ssim", "pyramid") else {}
    mask = {"mask": alpha} if term.masked else {} if frame.border is None else {"mask": frame.border}
    if term.kind == "silhouette":
        return norm(frame.alpha, alpha, **cell, **mask)
    return norm(frame.color, target.xyz * alpha + background * (1.0 - alpha), **cell, **mask)
