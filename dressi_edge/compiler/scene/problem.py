"""The usual problem as a scene: one mesh, pictures of it, phases that make the first look like the second (paper, Appendix A).

    problem = Problem(mesh, views)
    problem.phase("shape", steps=500, optimize={"vertices": Adam(0.01)}, losses=[Loss("silhouette"), Loss("laplacian", weight=0.05)])
    problem.compile("lavapipe", "spot.dressi")

In: a `Mesh`, `Views` (or cameras alone, targets set later). Out: a `Scene`, and its program: each phase gives `<phase>` (updates) and
`<phase>.loss` of several terms `<phase>.<kind>` of each; `render()` gives pictures of all views. What this cannot say a `Scene` can.
"""
from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ...cache.errors import InputError
from ...cache.profile import Profile
from ..graph.functions import compose
from ..graph.ir import Node
from ..graph.program import Program
from ..io.cameras import Camera
from ..io.frame import recentred
from ..io.mesh import NORMALS, Mesh, linear_mesh, middle_of
from ..io.views import Views
from ..render import loss as terms
from ..render.frame import Frame
from ..render.light import Light
from ..render.material import Corner, Lambert, Texture, Unlit, Vertex
from ..render.optimizer import Optimizer
from ..render.raster import Renderer, Softness, renderer_of
from ..render.schedule import Schedule
from ..render.texture import Wrap, alike
from ..render.tone import encode_srgb
from . import sense
from .limits import fits, profiles_of
from .scene import ORDERS, Scene
from .targets import targets_of, windowed
from .values import GAINS, gains

SHADINGS = ("unlit", "lambert")
ALBEDOS = ("texture", "colors", "constant")
IMAGE_LOSSES = ("silhouette", "color")
MESH_LOSSES = {"laplacian": terms.uniform_laplacian, "cotangent_laplacian": terms.cotangent_laplacian,
               "normal_consistency": lambda positions, topology, power: terms.normal_consistency(positions, topology)}


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
        if self.masked and self.kind in MESH_LOSSES:
            raise InputError(f"loss {self.kind}: masked is for losses of images; drop it")
        object.__setattr__(self, "weight", Schedule.parse(self.weight, "weight"))

    def term(self, frame: Frame, target: Node, background: Node) -> Node:
        """The term in a frame of one part, beside its targets (vec4, straight colour and alpha): a float of extent 1x1, not weighted."""
        if self.kind in MESH_LOSSES:
            part = frame.parts.parts[0]
            return MESH_LOSSES[self.kind](part.positions, part.topology, self.power)
        norm = terms.l1 if self.norm == "l1" else terms.l2
        alpha = target.w
        mask = alpha if self.masked else frame.border
        if self.kind == "silhouette":
            return norm(frame.alpha, alpha, mask)
        return norm(frame.color, target.xyz * alpha + background * (1.0 - alpha), mask)


@dataclass
class Problem:
    """mesh: positions, faces; for albedo "texture" uvs, for "colors" colours of vertices or corners (grey 0.5 where missing). views:
    targets and cameras, or a sequence of cameras (targets are then set on the session, shape (views, height, width, 4)).

    order: "batch" draws all views each step, "cycle" or "shuffle" (by `seed`) one, "accumulate" one, too, with the gradient of all.
    shading "unlit" or "lambert" with `lights` and `normals` "smooth", "flat" or "file" (the mesh's own, where no phase moves vertices);
    `srgb` decodes the mesh's texture and colours, and encodes the rendered colour before it is compared. wrap: the mesh's own unless given.
    wrap, mips, anisotropy: of the texture, as in `Texture`. near and far come from the cameras. judged: the start was asked for its sense
    already (`sense.check`). embed: whether the bundle has the pictures; memory: bytes for all images of the device; room: bytes that they
    should take where memory says nothing; whole: all pictures as floats at once (`targets.py`). A mesh far from its origin is moved to it,
    with cameras and lights, by -`origin`.
    Raises InputError.
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
    wrap: Wrap | None = None
    texture_grad: str = "exact"
    normals: str = "smooth"
    program: Program = field(default_factory=Program)
    judged: bool = False
    embed: bool = True
    memory: int | None = None
    whole: bool = False
    room: int | None = None
    mips: bool = False
    anisotropy: int = 1

    def __post_init__(self):
        self.wrap = alike(self.mesh.wrap if self.wrap is None else self.wrap)
        for name, value, allowed in (("order", self.order, ORDERS), ("shading", self.shading, SHADINGS), ("albedo", self.albedo, ALBEDOS),
                                     ("normals", self.normals, NORMALS),
                                     ("texture_grad", self.texture_grad, ("exact", "inverse_uv"))):
            if value not in allowed:
                raise InputError(f"{name} is {value!r}; allowed: {' '.join(allowed)}")
        for name, value, count in (("albedo_color", self.albedo_color, 3), ("background", self.background, 3)):
            if len(value) != count or not np.isfinite(np.asarray(value, float)).all():
                raise InputError(f"{name} is {value!r:.60}; {count} finite numbers are needed")
        if any(type(x) is not int or x < 1 for x in self.texture_size) or len(self.texture_size) != 2:
            raise InputError(f"texture_size is {self.texture_size!r:.60}; width and height of 1 or more texels are needed")
        if self.mips and self.texture_grad == "inverse_uv":
            raise InputError("texture_grad is inverse_uv, which a texture with mips does not have; use exact")
        if self.shading == "lambert" and not self.lights:
            raise InputError("shading lambert needs lights; give at least one")
        if self.albedo == "texture" and self.mesh.uvs is None:
            raise InputError("albedo texture needs a mesh with texture coordinates; use colors, or a mesh that has them")
        self.mesh, self.views, self.lights, self.origin = recentred(self.mesh, self.views, self.lights)
        self.cameras = self.views.cameras if isinstance(self.views, Views) else tuple(self.views)
        if not self.cameras:
            raise InputError("no cameras; at least one view is needed")
        self.pivot = tuple(map(float, middle_of(self.mesh.positions)))
        self.scene = s = Scene(self.cameras, self.background, encode_srgb if self.srgb else None, self.program)
        self.width, self.height = s.width, s.height
        self.parameters: dict[str, Node] = {"vertices": s.parameter("vertices", self.mesh.positions, kind="table")}
        color = self._albedo()
        n = len(self.cameras)
        for name in ("rotation", "translation"):
            self.parameters[name] = s.parameter(name, np.zeros((n, 3)), kind="table")
        s.pose_cameras(self.parameters["rotation"], self.parameters["translation"], self.pivot)
        lights = s.lit(self.lights)
        self.parameters |= {name: p.node for name, p in s.parameters.items() if name.startswith("light")}
        material = Lambert(color, lights) if self.shading == "lambert" else Unlit(color)
        self.part = s.add(self.mesh, self.parameters["vertices"], material, "mesh", self.normals)
        self.topology = self.part.topology
        self._targets = targets_of(s, self.views if isinstance(self.views, Views) else None, self.order, self.seed, self.embed, self.memory,
                                   self.whole, self.room)
        self.targets, self._shown = self._targets.node, {}

    @property
    def phases(self) -> list[str]:
        """The names of the phases, in order."""
        return self.scene.phases

    def _albedo(self):
        """The source of the albedo, and its parameter."""
        mesh, s = linear_mesh(self.mesh) if self.srgb else self.mesh, self.scene
        if self.albedo == "constant":
            return tuple(self.albedo_color)
        if self.albedo == "colors":
            colors = np.full((len(mesh.positions), 3), 0.5) if mesh.colors is None else mesh.colors
            self.parameters["colors"] = s.parameter("colors", colors, 0.0, 1.0, kind="table")
            own = self.parameters["colors"]
            return Vertex(own) if mesh.color_faces is None else Corner(own, mesh.color_faces)
        texture = np.full((*self.texture_size[::-1], 3), 0.5) if mesh.texture is None else mesh.texture
        self.parameters["texture"] = s.parameter("texture", texture, 0.0, 1.0, kind="image")
        return Texture(self.parameters["texture"], self.wrap, self.texture_grad, mips=self.mips, anisotropy=self.anisotropy)

    def phase(self, name: str, steps: int, optimize: Mapping[str, Optimizer], losses: Sequence[Loss | Callable],
              softness: Softness | Renderer | None = None) -> None:
        """Add a phase: `steps` iterations that optimize the named parameters by the sum of the losses. A loss is a `Loss`, or a function of
        the frame and its targets (vec4: straight colour, alpha) that gives a float of extent 1x1. softness: or a renderer, such as
        `Binned(over=True)`."""
        s = self.scene
        with s.undone_by_errors():
            if "gain" in optimize and s.gain is None:
                s.gain = gains(s.parameter("gain", np.ones((len(self.cameras), 3)), *GAINS, kind="table"))
            s.check_phase(name, steps, optimize, losses)
            if self.normals == "file" and self.shading == "lambert" and "vertices" in optimize:
                raise InputError(f"phase {name} optimizes vertices, and normals are \"file\", which do not follow them; use flat or smooth")
            frame = s.frame(renderer_of(softness or Softness()), phase=name, order=self.order, seed=self.seed,
                            view=self._targets.turned(s, name, optimize))
            target, weighted = self._targets.at(frame), {}
            for k, loss in enumerate(losses):
                value = loss.term(frame, target, compose(*self.background)) if isinstance(loss, Loss) else loss(frame, target)
                weighted[f"{k}"] = (loss.weight if isinstance(loss, Loss) else 1.0, value)
            values = s.minimize(name, steps, optimize, weighted)
            if len(losses) > 1:
                s.terms(name, dict(zip(_term_names(losses), values.values())))

    def render(self, name: str = "render", softness: Softness | Renderer | None = None, color: bool = True) -> None:
        """Add a plan that draws all views: output `<name>.color` (views, height, width, 4), RGBA with straight colour over the
        background, or `<name>.silhouette` (views, height, width). Of many views that are not seen at once it draws one at a time, and the
        session puts them together (`Session.get(view=..)`)."""
        s, renderer = self.scene, renderer_of(softness or Softness())
        if windowed(self.order, len(self.cameras), self.width, self.height, self.whole):
            frame = s.frame(renderer, view=s.input(f"{name}.view", 0, integer=True))
            self._shown[f"{name}.{'color' if color else 'silhouette'}"] = f"{name}.view"
        else:
            frame = s.frame(renderer)
        if color:
            s.output(name, color=compose(frame.color, frame.alpha))
        else:
            s.output(name, silhouette=frame.alpha)

    def record(self) -> dict:
        """The meta of the bundle: what results are written of (`results.py`)."""
        from .results import record
        return record(self) | self._targets.meta(self.program, self._shown)

    def compile(self, profile: Profile | str | Sequence[Profile | str], path: str | os.PathLike, **options) -> dict:
        """Write the bundle, for one profile or several, best first; its description. See `compiler.compile_program`."""
        from .. import compile_program
        if not self.program.plans:
            raise InputError("the problem has no phase and renders nothing; add one with phase() or render()")
        profiles = profiles_of(profile)
        fits(self, profiles)
        if not self.judged:
            sense.check(self.mesh, self.views)
        self.program.meta.update(self.record())
        self.program.attached["pictures"] = self._targets.blobs()
        return compile_program(self.program, profiles, path, memory=self.memory, **options)


def _term_names(losses: Sequence[Loss | Callable]) -> list[str]:
    """What terms are called: by their kind, those of a function by its name, a second one silhouette2."""
    names: list[str] = []
    for loss in losses:
        own = loss.kind if isinstance(loss, Loss) else "".join(c for c in getattr(loss, "__name__", "") if c.isalnum() or c == "_")
        own = "term" if own in ("", "loss", "step", "lambda") else own
        names.append(next(n for n in (own, *(f"{own}{k}" for k in range(2, len(losses) + 2))) if n not in names))
    return names
