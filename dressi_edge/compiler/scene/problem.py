"""An inverse-rendering problem: mesh, views, what to optimize in which phases (in the spirit of the paper's Appendix A).

    problem = Problem(mesh, views)
    problem.phase("shape", steps=500, optimize={"vertices": Adam(0.01)}, losses=[Loss("silhouette"), Loss("laplacian", weight=0.05)])
    problem.compile("lavapipe", "spot.dressi")

In: a `Mesh`, `Views` (or cameras alone, targets set later). Out: a `Program`. Each phase gives three plans: the phase itself (updates),
`<phase>.loss`, and `<phase>.render` (outputs `<phase>.color`, RGBA, and its parts on demand).
"""
from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ...cache.errors import InputError
from ...cache.layout import Layout
from ...cache.profile import Profile
from ..graph.autodiff import gradients
from ..graph.functions import apply, compose, constant_table, lookup, normalize, to_int
from ..graph.ir import Node
from ..graph.program import Program
from ..io.cameras import Camera
from ..io.meshes import Mesh
from ..io.views import Views
from ..render import loss as objective
from ..render.atlas import Atlas
from ..render.camera import ViewTable, fixed_views, posed_views, to_clip
from ..render.normals import vertex_normals
from ..render.optimizer import Adam, Sgd
from ..render.raster import Layers, Outline, Softness, near_faces, rasterized
from ..render.schedule import Schedule
from ..render.shade import Light, encode_srgb, lambert
from ..render.texture import sample_texture
from ..render.topology import Topology
from .limits import fits

SHADINGS = ("unlit", "lambert")
ALBEDOS = ("texture", "colors", "constant")
IMAGE_LOSSES = ("silhouette", "color")
MESH_LOSSES = {"laplacian": objective.uniform_laplacian, "cotangent_laplacian": objective.cotangent_laplacian,
               "normal_consistency": None}
ORDERS = ("batch", "cycle", "shuffle")


@dataclass(frozen=True)
class Loss:
    """One term: kind "silhouette" or "color" (norm "l1" or "l2"; masked: times the target's alpha), "laplacian",
    "cotangent_laplacian" (power 1: mean length, 2: mean square) or "normal_consistency"; weight a number or Schedule."""

    kind: str
    weight: Schedule | float = 1.0
    norm: str = "l2"
    masked: bool = False
    power: int = 1

    def __post_init__(self):
        if self.kind not in (*IMAGE_LOSSES, *MESH_LOSSES):
            raise InputError(f"loss {self.kind!r}; allowed: {' '.join((*IMAGE_LOSSES, *MESH_LOSSES))}")
        if self.norm not in ("l1", "l2"):
            raise InputError(f"loss {self.kind}: norm {self.norm!r}; l1 or l2 is allowed")
        if self.power not in (1, 2):
            raise InputError(f"loss {self.kind}: power {self.power!r}; 1 or 2 is allowed")
        object.__setattr__(self, "weight", Schedule.parse(self.weight, "weight"))


@dataclass
class Problem:
    """mesh: positions, faces; for albedo "texture" uvs, for "colors" vertex colours (grey 0.5 where missing). views: targets and
    cameras, or a sequence of cameras (targets are then set on the session, shape (views, height, width, 4)).

    order: "batch" draws all views each step, "cycle" or "shuffle" (by `seed`) one. shading "unlit" or "lambert" with `lights`; `srgb`
    encodes the rendered colour before it is compared. near and far come from the cameras. Raises InputError.
    """

    mesh: Mesh
    views: Views | Sequence[Camera]
    order: str = "batch"
    seed: int = 0
    shading: str = "unlit"
    albedo: str = "texture"
    albedo_color: tuple[float, float, float] = (0.5, 0.5, 0.5)
    lights: Sequence[Light] = ()
    srgb: bool = False
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    texture_size: tuple[int, int] = (512, 512)
    wrap: str = "repeat"
    texture_grad: str = "exact"
    program: Program = field(default_factory=Program)

    def __post_init__(self):
        cameras = self.views.cameras if isinstance(self.views, Views) else tuple(self.views)
        if not cameras:
            raise InputError("no cameras; at least one view is needed")
        sizes = {(c.width, c.height) for c in cameras}
        if len(sizes) != 1:
            raise InputError(f"cameras have sizes {sorted(sizes)}; one size is needed")
        for name, value, allowed in (("order", self.order, ORDERS), ("shading", self.shading, SHADINGS), ("albedo", self.albedo, ALBEDOS),
                                     ("wrap", self.wrap, ("repeat", "clamp")),
                                     ("texture_grad", self.texture_grad, ("exact", "inverse_uv"))):
            if value not in allowed:
                raise InputError(f"{name} is {value!r}; allowed: {' '.join(allowed)}")
        if self.shading == "lambert" and not self.lights:
            raise InputError("shading lambert needs lights; give at least one")
        if self.albedo == "texture" and self.mesh.uvs is None:
            raise InputError("albedo texture needs a mesh with texture coordinates; use colors, or a mesh that has them")
        self.cameras, (self.width, self.height) = cameras, sizes.pop()
        self.topology = Topology(np.asarray(self.mesh.faces), len(self.mesh.positions))
        self.phases: list[str] = []
        self._states()

    # ---- what lives on the device

    def _states(self) -> None:
        p, n, v = self.program, len(self.cameras), len(self.mesh.positions)
        table = Layout("table", "vec3", count=v)
        self.parameters: dict[str, Node] = {"vertices": p.state("vertices", table, self.mesh.positions)}
        if self.albedo == "colors":
            colors = np.full((v, 3), 0.5) if self.mesh.colors is None else self.mesh.colors
            self.parameters["colors"] = p.state("colors", table, colors)
        elif self.albedo == "texture":
            width, height = self.texture_size if self.mesh.texture is None else self.mesh.texture.shape[1::-1]
            texture = np.full((height, width, 3), 0.5) if self.mesh.texture is None else self.mesh.texture
            self.parameters["texture"] = p.state("texture", Layout("image", "vec3", width, height), texture)
        pose = Layout("table", "vec3", count=n)
        self.parameters |= {name: p.state(name, pose) for name in ("rotation", "translation")}
        self.lighting: list[tuple[str, Node, Node | None]] = []
        for k, light in enumerate(self.lights):
            unit = Layout("unit", "vec3")
            power = self.parameters[f"light{k}.power"] = p.state(f"light{k}.power", unit, np.array(light.power))
            vector = None
            if light.vector is not None:
                vector = self.parameters[f"light{k}.vector"] = p.state(f"light{k}.vector", unit, np.array(light.vector))
            self.lighting.append((light.kind, power, vector))
        self.all_views = Atlas.of(self.width, self.height, n)
        targets = self.views.images if isinstance(self.views, Views) else None
        layout = Layout("atlas", "vec4", self.width, self.height, n, self.all_views.columns)
        self.targets = p.input("targets", layout, targets, narrow=True)

    # ---- graph

    def _view_table(self) -> ViewTable:
        """The views as posed now; where no phase moves them this is computed once (the reactive cache)."""
        return posed_views(fixed_views(self.cameras), self.parameters["rotation"], self.parameters["translation"])

    def _chosen(self, step: Node) -> Node | None:
        """The view of this step, or None for all."""
        n = len(self.cameras)
        if self.order == "batch":
            return None
        rounds = 1 if self.order == "cycle" else 64
        rng = np.random.default_rng(self.seed)
        table = np.concatenate([np.arange(n) if self.order == "cycle" else rng.permutation(n) for _ in range(rounds)])
        return lookup(constant_table(table), apply("imod", step, len(table)))

    def _target(self, atlas: Atlas, view: Node | None) -> Node:
        if view is None:
            return self.targets
        columns = self.all_views.columns
        corner = compose(apply("imod", view, columns) * self.width, apply("idiv", view, columns) * self.height)
        half = compose(self.width / 2, self.height / 2)
        own = to_int(apply("cell_position", extent=atlas.extent, cell_w=atlas.width, cell_h=atlas.height) + half)
        return apply("fetch", self.targets, own + corner)

    def _shaded(self, layers: Outline | Layers, step: Node) -> list[Node]:
        positions, result = self.parameters["vertices"], []
        normals = vertex_normals(positions, self.topology) if self.shading == "lambert" else None
        point = any(kind == "point" for kind, _, _ in self.lighting)
        for layer in layers.layers:
            weights = layers.barycentrics(layer)
            if self.albedo == "texture":
                uv = layers.interpolate_constant(layer, self.mesh.uvs[self.mesh.uv_faces], weights)
                color = sample_texture(self.parameters["texture"], uv, wrap=self.wrap, gradient=self.texture_grad,
                                       covered=layer.face >= 0, step=step)
            elif self.albedo == "colors":
                color = layers.interpolate(layer, self.parameters["colors"], weights)
            else:
                color = compose(*self.albedo_color)
            if self.shading == "lambert":
                normal = normalize(layers.interpolate(layer, normals, weights))
                at = layers.interpolate(layer, positions, weights) if point else normal
                color = lambert(color, normal, at, self.lighting)
            result.append(near_faces(layer.face, encode_srgb(color) if self.srgb else color))
        return result

    def _term(self, loss: Loss, layers: Outline | Layers | None, target: Node | None, color) -> Node:
        positions = self.parameters["vertices"]
        if loss.kind == "normal_consistency":
            return objective.normal_consistency(positions, self.topology)
        if loss.kind in MESH_LOSSES:
            return MESH_LOSSES[loss.kind](positions, self.topology, loss.power)
        norm = objective.l1 if loss.norm == "l1" else objective.l2
        mask = target.w if loss.masked else None
        if loss.kind == "silhouette":
            return norm(layers.silhouette(), target.w, mask)
        alpha = target.w
        over = target.xyz * alpha + compose(*self.background) * (1.0 - alpha)
        return norm(color(), over, mask)

    def phase(self, name: str, steps: int, optimize: Mapping[str, Adam | Sgd], losses: Sequence[Loss],
              softness: Softness | None = None) -> None:
        """Add a phase: `steps` iterations that optimize the named parameters by the sum of the losses."""
        if name in self.phases or not name or "." in name:
            raise InputError(f"phase {name!r}: a new name without dots is needed")
        if not optimize or not losses:
            raise InputError(f"phase {name}: something to optimize and a loss are needed")
        for parameter in optimize:
            if parameter not in self.parameters:
                raise InputError(f"phase {name}: no parameter {parameter!r}; there are: {' '.join(self.parameters)}")
        if type(steps) is not int or steps < 1:
            raise InputError(f"phase {name}: steps is {steps!r}; 1 or more are needed")
        softness = softness or Softness()
        step = self.program.state(f"{name}.step", Layout("unit", "int"), 0)
        view = self._chosen(step)
        table = self._view_table()
        atlas = self.all_views if view is None else Atlas(self.width, self.height, 1, 1)
        layers = target = None
        if any(loss.kind in IMAGE_LOSSES for loss in losses):
            clip = to_clip(self.parameters["vertices"], table if view is None else table.choose(view))
            colored = any(term.kind == "color" for term in losses)
            layers = rasterized(clip, self.topology, atlas, softness, table.near, faces=colored)
            target = self._target(atlas, view)

        def color() -> Node:
            return layers.color(self._shaded(layers, step), compose(*self.background))

        loss = None
        for term in losses:
            value = self._term(term, layers, target, color) * term.weight.node(step)
            loss = value if loss is None else loss + value
        updates: dict[str, Node] = {}
        wrt = [self.parameters[k] for k in optimize]
        for (parameter, optimizer), gradient in zip(optimize.items(), gradients(loss, wrt)):
            limits = {"low": 0.0, "high": 1.0} if parameter in ("texture", "colors") else {}
            updates |= optimizer.update(self.program, parameter, self.parameters[parameter], gradient, step, **limits)
        updates[f"{name}.step"] = step + 1
        dynamic = frozenset(updates)
        self.program.plan(name, updates, dynamic=dynamic, steps=steps, group=name)
        self.program.plan(f"{name}.loss", outputs={f"{name}.loss": (loss, Layout("unit", "float"))}, dynamic=dynamic, group=name)
        self.phases.append(name)

    def render(self, name: str = "render", softness: Softness | None = None, color: bool = True) -> None:
        """Add a plan that draws all views: output `<name>.color` (views, height, width, 4), RGBA with straight colour over the
        background, or `<name>.silhouette` (views, height, width)."""
        n, atlas = len(self.cameras), self.all_views
        layers = rasterized(to_clip(self.parameters["vertices"], self._view_table()), self.topology, atlas, softness or Softness(),
                        fixed_views(self.cameras).near, faces=color)
        alpha = layers.silhouette()
        if color:
            rgb = layers.color(self._shaded(layers, apply("literal", value=0)), compose(*self.background))
            image = compose(rgb, alpha)
            self.program.plan(name, outputs={f"{name}.color": (image, Layout("atlas", "vec4", self.width, self.height, n, atlas.columns))})
        else:
            layout = Layout("atlas", "float", self.width, self.height, n, atlas.columns)
            self.program.plan(name, outputs={f"{name}.silhouette": (alpha, layout)})

    def compile(self, profile: Profile | str | Sequence[Profile | str], path: str | os.PathLike, **options) -> dict:
        """Write the bundle, for one profile or several, best first; its description. See `compiler.compile_program`."""
        from .. import compile_program
        from .results import record
        if not self.program.plans:
            raise InputError("the problem has no phase and renders nothing; add one with phase() or render()")
        given = [profile] if isinstance(profile, Profile | str | os.PathLike) else profile
        profiles = [p if isinstance(p, Profile) else Profile.load(p) for p in given]
        fits(self, profiles)
        self.program.meta.update(record(self))
        return compile_program(self.program, profiles, path, **options)

