"""A scene: parameters, parts, what is to be seen of them, and what is to be done with that. Functions of the user are called here, once.

    scene = Scene(cameras)
    x = scene.parameter("vertices", ball.positions)
    scene.add(ball, x, Unlit(Vertex(scene.parameter("colors", grey, low=0, high=1))))
    seen = scene.frame(Outline(r=2.0))
    photo = scene.input("photo", pictures)
    scene.phase("fit", 300, {"vertices": Adam(0.01), "colors": Adam(0.03)}, color=l2(seen.color, photo.xyz))
    scene.output("look", color=seen.color, depth=seen.depth)
    scene.compile("vulkan_min", "ball.dressi")

In: numbers, meshes, cameras. Out: a `Program` of plans: `<phase>` (updates), `<phase>.loss`, `<phase>.terms`, what output() and vjp() name.
"""
from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from ...cache.errors import DressiError, InputError
from ...cache.layout import Layout
from ...cache.profile import Profile
from ..graph.autodiff import gradients
from ..graph.functions import apply, compose, constant, constant_table, dot, lookup, total
from ..graph.ir import UNIT, Node, topological
from ..graph.program import Program
from ..io.cameras import Camera
from ..io.meshes import Mesh
from ..render.atlas import Atlas
from ..render.camera import fixed_views, posed_views
from ..render.environment import Environment
from ..render.frame import Frame
from ..render.light import Light, Shadow
from ..render.material import Unlit
from ..render.optimizer import Optimizer
from ..render.part import Part, Parts
from ..render.raster import Outline, Renderer
from ..render.schedule import Schedule
from ..render.shadow import Deferred, ShadowMap, shadow_map
from .layouts import layout_for, layout_of, pictures_layout
from .limits import fits_program, profiles_of
from .rounds import Round
from .values import Parameter, ball_around, numbers, padded
from .where import caller, place

ORDERS = ("batch", "cycle", "shuffle", "accumulate")
ROUNDS = 64  # of a shuffle, before it begins again


class Scene:
    """cameras: one for each view; none where nothing is seen, but images are fitted. Where their pictures have different sizes every view
    is as large as the largest, and each picture is in its upper left corner: `padded` makes such pictures, `frame.valid` is 1 inside.
    background: three numbers, or pictures (views, height, width, 3), or a list of one for each camera. encode: from linear radiance to the
    colours of the pictures, such as `tone.encode_srgb`; None leaves it linear. Raises InputError, GraphError; both name what was given and,
    where it is known, the line."""

    def __init__(self, cameras: Sequence[Camera] = (), background=(0.0, 0.0, 0.0), encode: Callable[[Node], Node] | None = None,
                 program: Program | None = None):
        self.cameras = tuple(cameras)
        sizes = np.array([(c.width, c.height) for c in self.cameras] or [(1, 1)])
        self.width, self.height = map(int, sizes.max(0))
        self._sizes = sizes if (sizes != sizes[0]).any() else None
        self.program, self.encode = program or Program(), encode
        self.atlas = Atlas.of(self.width, self.height, len(sizes))
        self.views = fixed_views(self.cameras, (self.width, self.height)) if self.cameras else None
        self.parameters: dict[str, Parameter] = {}
        self.parts: list[Part] = []
        self.phases: list[str] = []
        self._frames: list[Frame] = []
        self._steps: dict[str, Node] = {}
        self._rounds: dict[str, int] = {}  # by phase of order "accumulate"
        self.background = self._background(background)
        self.gain: Node | None = None  # factors of the colours of each view, a table of vec3
        self.surroundings: Environment | None = None  # shown behind all parts in place of the background, through `encode`

    # ---- values

    def parameter(self, name: str, value, low: float | None = None, high: float | None = None, free=None,
                  kind: str | None = None) -> Node:
        """A value that phases may optimize, by its start: a number, a vector, a table (n, c) or an image (h, w, c); `kind` says which where
        a shape could be either (`layouts.layout_of`). Every update keeps it within [low, high]. free: an array of its shape without the
        channels, 1 where an entry may move and 0 where it stays."""
        value, where = numbers(f"parameter {name}", value), caller()
        layout = layout_of(value.shape, self.atlas, f"parameter {name}", kind)
        if low is not None and high is not None and not low < high:
            raise InputError(f"parameter {name}: its limits are {low} to {high}; the first must be below the second")
        mask = None
        if free is not None:
            free = numbers(f"parameter {name}: free", free)
            single = layout_of(free.shape, self.atlas, f"parameter {name}: free", kind or layout.kind.replace("atlas", "pictures"))
            if single.size != layout.size or single.vtype != "float" or not np.isin(free, (0.0, 1.0)).all():
                raise InputError(f"parameter {name}: free has shape {free.shape}; zeros and ones, one for each entry, are needed")
            mask = constant_table(free) if layout.kind == "table" else constant(single.to_image(free, name))
        node = self.program.state(name, layout, value)
        self.parameters[name] = Parameter(node, low, high, mask, where)
        return node

    def input(self, name: str, value=None, shape: tuple[int, ...] | None = None, kind: str | None = None, integer: bool = False,
              narrow: bool = False) -> Node:
        """A value that the session sets, and that starts as `value`; without one, of this shape. narrow: pictures that are only compared
        with, which storage half may round."""
        if value is None and shape is None:
            raise InputError(f"input {name}: a value to start with, or a shape, is needed")
        if value is not None:
            value = numbers(f"input {name}", value, integer)
        layout = layout_of(value.shape if value is not None else tuple(shape), self.atlas, f"input {name}", kind, integer)
        return self.program.input(name, layout, value, narrow)

    def padded(self, pictures: Sequence[np.ndarray], fill: float = 0.0) -> np.ndarray:
        """Pictures (h, w) or (h, w, c), each of its camera's size, as one array (views, height, width[, c]): each in the upper left corner
        of its view, `fill` beside it. Raises InputError."""
        return padded(pictures, self.cameras, (self.width, self.height), fill)

    def _background(self, background) -> Node:
        if isinstance(background, (list, tuple)) and any(np.ndim(x) > 1 for x in background):
            background = self.padded(background)
        array = numbers("background", background)
        if array.shape == (3,):
            return compose(*map(float, array))
        layout = layout_of(array.shape, self.atlas, "background", "pictures")
        if layout.vtype != "vec3":
            raise InputError(f"background has shape {array.shape}; three numbers, or pictures of three channels, are needed")
        return constant(layout.to_image(array, "background"))

    # ---- what there is

    def add(self, mesh: Mesh, positions: Node | None = None, material: Callable | None = None, name: str | None = None,
            normals: str = "smooth") -> Part:
        """A part: a mesh, where its vertices are (a vec3 table of as many; by default where the mesh has them) and what it is made of.
        `material` is called with a `Surface` and gives a vec3 (`render/material.py`). normals: "smooth", "flat", or "file": the mesh's."""
        name = f"part{len(self.parts)}" if name is None else name
        if self._frames:
            raise InputError(f"part {name} is added after a frame was made; add all parts first")
        if name in (part.name for part in self.parts):
            raise InputError(f"part {name!r}: the name is taken; give each part a name of its own")
        positions = constant_table(np.asarray(mesh.positions)) if positions is None else positions
        part = Part(name, mesh, positions, Unlit(0.5) if material is None else material, normals)
        self.parts.append(part)
        return part

    def pose_cameras(self, rotation: Node, translation: Node, pivot: Sequence[float] | None = None) -> None:
        """Cameras that move: vec3 tables of the views, on top of where they are, about the pivot, a point in world space such as the middle
        of what they see; without one each about its eye (`camera.posed_views`)."""
        if self._frames:
            raise InputError("cameras are posed after a frame was made; pose them first")
        self.views = posed_views(fixed_views(self.cameras, (self.width, self.height)), rotation, translation, pivot)

    def lit(self, lights: Sequence[Light]) -> list[Light]:
        """The lights with the parameters `light0.power`, `light0.vector`, `light0.direction`, ... for their numbers, made where they are
        missing."""
        found = []
        for k, light in enumerate(lights):
            own = {}
            for key in ("power", "vector", "direction"):
                name, start = f"light{k}.{key}", getattr(light, key)
                if start is not None:
                    own[key] = self.parameters[name].node if name in self.parameters else self.parameter(name, start)
            found.append(replace(light, **own))
        return [self.shadow(light) if isinstance(light.shadow, Shadow) else light for light in found]

    def shadow(self, light: Light, shadow: Shadow | None = None, ball: tuple[Sequence[float], float] | None = None) -> Light:
        """The light, with shadows cast by all parts of the scene, those that are added later too: what materials are to be given.
        shadow: how they are drawn; by default as the light says, else `Shadow()`. ball: middle and radius of what a directional light's map
        covers; by default a quarter more than holds all vertices where they start. Visibility has no gradient. Raises InputError."""
        found = None
        if shadow is None:
            shadow = light.shadow if isinstance(light.shadow, Shadow) else Shadow()
        if ball is not None:
            middle, radius = numbers("shadow: the middle of the ball", ball[0]), float(ball[1])
            if middle.shape != (3,) or not (np.isfinite(radius) and radius > 0.0):
                raise InputError(f"shadow: ball is {ball!r:.60}; a middle of three numbers and a positive radius are needed")
            found = middle, radius

        def drawn() -> ShadowMap:
            middle, radius = found or ball_around(self.parts, self.program)
            return shadow_map(light, shadow, lambda: Parts(tuple(self.parts)), middle, radius)

        return replace(light, shadow=Deferred(drawn))

    def step(self, phase: str) -> Node:
        """How many steps of a phase are done: an int of extent 1x1."""
        if phase not in self._steps:
            self._steps[phase] = self.program.state(f"{phase}.step", Layout("unit", "int"), 0)
        return self._steps[phase]

    def view_of(self, step: Node, order: str, seed: int = 0) -> Node | None:
        """The one view that a step sees, an int of extent 1x1; None for all of them: one of ORDERS (seed: of "shuffle")."""
        if order not in ORDERS:
            raise InputError(f"order is {order!r:.40}; allowed: {' '.join(ORDERS)}")
        if order == "batch":
            return None
        table = self.order_of(order, seed)
        return lookup(constant_table(table), apply("imod", step, len(table)))

    def order_of(self, order: str, seed: int = 0) -> np.ndarray:
        """The view of each step, (n,), after which it begins again: of an order other than "batch"."""
        n, rng = len(self.cameras), np.random.default_rng(seed)
        return np.concatenate([rng.permutation(n) for _ in range(ROUNDS)]) if order == "shuffle" else np.arange(n)

    def frame(self, renderer: Renderer | None = None, *, phase: str | None = None, order: str = "batch", seed: int = 0,
              view: Node | None = None) -> Frame:
        """What the cameras see, by a renderer (`Outline()` unless given). With an order other than "batch" one view a step of `phase`; what
        it is compared with is then `frame.at(pictures)`. With "accumulate" parameters change after each round, by the mean of
        its gradients. view: which one is drawn, an int of extent 1x1, such as an input."""
        if not self.cameras:
            raise InputError("no cameras; at least one view is needed")
        if not self.parts:
            raise InputError("the scene has no parts; add one before you look at it")
        if phase is None and order != "batch":
            raise InputError(f"order {order!r:.40} shows one view a step; name the phase whose steps these are")
        step = None if phase is None else self.step(phase)
        self._rounds |= {phase: len(self.cameras)} if order == "accumulate" else {}
        chosen = self.view_of(step, order, seed) if view is None else view
        views, atlas = (self.views, self.atlas) if chosen is None else (self.views.choose(chosen), Atlas(self.width, self.height, 1, 1))
        parts = self.parts
        frame = Frame(Parts(tuple(parts)), views, atlas, renderer or Outline(), self.background, all_views=self.atlas, chosen=chosen,
                      sizes=self._sizes, encode=self.encode, gain=self.gain, step=step,
                      who=lambda k: f"part {parts[k].name}: its material {place(parts[k].material)}")
        if self.surroundings is None:
            frame.background = frame.at(frame.background)
        else:
            behind = self.surroundings.seen(frame)
            frame.background = self.encode(behind) if self.encode else behind
        self._frames.append(frame)
        return frame

    # ---- what is done

    def phase(self, name: str, steps: int, optimize: Mapping[str, Optimizer], /, **terms) -> None:
        """`steps` iterations that optimize the named parameters by the sum of the terms, each a float of extent 1x1, or a pair of a weight
        (a number or `Schedule`) and that."""
        with self.undone_by_errors():
            self.check_phase(name, steps, optimize, terms)
            if taken := {"loss", "step"} & terms.keys():
                raise InputError(f"phase {name}: a term is called {taken.pop()}, as what the phase keeps itself is; give it another name")
            self.step(name)
            pairs = {key: term if isinstance(term, tuple) and len(term) == 2 else (1.0, term) for key, term in terms.items()}
            values = self.minimize(name, steps, optimize, pairs)
            if len(terms) > 1 or any(isinstance(term, tuple) for term in terms.values()):
                self.terms(name, values)

    def terms(self, name: str, values: Mapping[str, Node]) -> None:
        """The plan of the terms of the phase that was added last, each an output `<name>.<term>`."""
        last, unit = self.program.plans[-1], Layout("unit", "float")
        outputs = {f"{name}.{key}": (value, unit) for key, value in values.items()}
        self.program.plan(f"{name}.terms", outputs=outputs, dynamic=last.dynamic, group=last.group)

    def check_phase(self, name, steps, optimize, terms) -> None:
        if not isinstance(name, str) or name in self.phases or not name or "." in name:
            raise InputError(f"phase {name!r:.60}: a new name without dots is needed")
        if not optimize or not terms:
            raise InputError(f"phase {name}: something to optimize and a loss are needed")
        for parameter in optimize:
            if parameter not in self.parameters:
                raise InputError(f"phase {name}: no parameter {parameter!r:.60}; there are: {' '.join(self.parameters)}")
        if type(steps) is not int or steps < 1:
            raise InputError(f"phase {name}: steps is {steps!r:.40}; 1 or more are needed")

    def minimize(self, name: str, steps: int, optimize: Mapping[str, Optimizer], terms: Mapping[str, tuple]) -> dict[str, Node]:
        """The plans of a phase: `<name>` and `<name>.loss`. terms: pairs of weight and value; gives the values as they are drawn."""
        values, around = {}, Round(self.program, name, self.step(name), self._rounds.get(name, 1))
        for key, (_, value) in terms.items():
            if not isinstance(value, Node) or value.vtype != "float" or value.extent != UNIT:
                raise InputError(f"phase {name}: its term {key} ({caller()}) is {value!r:.80}; a float of extent 1x1 is needed, or a "
                                 "pair of a weight and that; reduce images with mean() or a loss")
            values[key] = value
        values = dict(zip(values, self._settled(list(values.values()))))
        loss = None
        for key, (weight, _) in terms.items():
            weighted = values[key] * Schedule.parse(weight, f"the weight of term {key}").node(around.turn)
            loss = weighted if loss is None else loss + weighted
        below, updates = set(topological([loss])), {}
        for key in optimize:
            if self.parameters[key].node not in below:
                raise InputError(f"phase {name} optimizes {key} ({self.parameters[key].where}), but none of its terms depends on it")
        found = gradients(loss, [self.parameters[key].node for key in optimize])
        for (key, optimizer), gradient in zip(optimize.items(), found):
            p = self.parameters[key]
            limits = {k: x for k, x in (("low", p.low), ("high", p.high), ("mask", p.free)) if x is not None}
            updates |= around.updates(optimizer.update(self.program, key, p.node, around.mean(key, gradient), around.turn, **limits))
        updates |= around.sums | {f"{name}.step": around.step + 1}
        dynamic = frozenset(updates)
        self.program.plan(name, updates, dynamic=dynamic, steps=steps * around.views, group=name)
        how = {"group": f"{name}.loss"} if name in self.program.turned else {"group": name, "dynamic": dynamic}  # reads what no step keeps
        self.program.plan(f"{name}.loss", outputs={f"{name}.loss": (loss, Layout("unit", "float"))}, **how)
        self.phases.append(name)
        return values

    def output(self, name: str, /, **nodes: Node) -> None:
        """Values that are worked out when the session asks for one of them: `<name>.<key>`. Pictures of all views have the shape (views,
        height, width, channels)."""
        with self.undone_by_errors():
            self.program.plan(name, outputs=self._named(name, nodes))

    def _named(self, name: str, nodes: Mapping[str, Node]) -> dict[str, tuple[Node, Layout]]:
        if not nodes:
            raise InputError(f"output {name}: nothing is given out; name at least one value")
        for key, node in nodes.items():
            if not isinstance(node, Node):
                raise InputError(f"output {name}: {key} is {node!r:.60}; a value of the graph is needed")
        settled = self._settled(list(nodes.values()))
        return {f"{name}.{key}": (node, self._layout(node)) for key, node in zip(nodes, settled)}

    def _layout(self, node: Node) -> Layout:
        """Of a node: that of the value which it is, or how its extent looks."""
        for value in self.program.values.values():
            if value.node is node:
                return value.layout
        one = Atlas(self.width, self.height, 1, 1)
        known = {value.layout.size for value in self.program.values.values() if value.layout.kind == "image"}
        if (node.extent.width, node.extent.height) in known and node.extent not in (self.atlas.extent, one.extent):
            return Layout("image", node.vtype, node.extent.width, node.extent.height)
        return layout_for(node, (self.atlas, one))

    def vjp(self, name: str, wrt: Sequence[str], /, **outputs: Node) -> None:
        """Gradients for a loop of the caller's own. The session gives `<name>.<output>`; where it is told a gradient of something by each
        output, as `<name>.<output>.grad` of the output's shape (zeros until then), it gives that by each parameter of `wrt` as
        `<name>.<parameter>.grad`. What is drawn for the outputs is kept, and not drawn again for gradients (`Session.forward`,
        `Session.backward`)."""
        with self.undone_by_errors():
            for key in wrt:
                if key not in self.parameters:
                    raise InputError(f"vjp {name}: no parameter {key!r:.60}; there are: {' '.join(self.parameters)}")
                if key in outputs:
                    raise InputError(f"vjp {name}: an output and a parameter are both called {key}, and so would their gradients "
                                     f"be, {name}.{key}.grad; call the output something else")
            if not wrt:
                raise InputError(f"vjp {name}: no parameter is named; there are: {' '.join(self.parameters)}")
            named = self._named(name, outputs)
            inner, given = None, []
            for key, (node, layout) in named.items():
                given.append(f"{key}.grad")
                g = self.program.input(given[-1], layout, np.zeros(layout.shape))
                product = total(dot(node, g))
                inner = product if inner is None else inner + product
            found = gradients(inner, [self.parameters[key].node for key in wrt])
            dynamic, moving = frozenset(given), frozenset(wrt)
            self.program.plan(name, outputs=named, dynamic=dynamic, group=name, moving=moving)
            self.program.plan(f"{name}.vjp", dynamic=dynamic, group=name, moving=moving, outputs={
                f"{name}.{key}.grad": (g, self.program.values[key].layout) for key, g in zip(wrt, found)})
            self.program.meta.setdefault("vjp", {})[name] = {"outputs": list(outputs), "wrt": list(wrt)}

    def _settled(self, roots: list[Node]) -> list[Node]:
        for frame in self._frames:
            roots = frame.settled(roots)
        return roots

    @contextmanager
    def undone_by_errors(self):
        """What an error leaves behind is taken back."""
        p = self.program
        before = dict(p.values), dict(p.roles), list(p.plans), dict(p.meta), dict(p.turned)
        steps, frames, phases = dict(self._steps), list(self._frames), list(self.phases)
        parameters, gain = dict(self.parameters), self.gain
        try:
            yield
        except DressiError:
            p.values, p.roles, p.plans, p.meta, p.turned = before
            self._steps, self._frames, self.phases, self.parameters, self.gain = steps, frames, phases, parameters, gain
            raise

    def compile(self, profile: Profile | str | Sequence[Profile | str], path: str | os.PathLike, record: bool = True, **options) -> dict:
        """Write the bundle, for one profile or several, best first; its description. See `compiler.compile_program`.

        record: the bundle says what its parts are made of, so that `run -o out.glb` can write them (`pieces.record`)."""
        from .. import compile_program
        from .pieces import record as meta_of
        self.check()
        profiles, faces = profiles_of(profile), sum(len(part.mesh.faces) for part in self.parts)
        fits_program(self.program, profiles, f"{len(self.cameras)} views of {self.width}x{self.height} and {faces} faces")
        before = dict(self.program.meta)
        try:
            if record and self.parts:
                self.program.meta.update(meta_of(self))
            return compile_program(self.program, profiles, path, **options)
        finally:
            self.program.meta.clear()
            self.program.meta.update(before)

    def check(self) -> None:
        """Raises InputError where there is nothing to do, or a parameter that nothing depends on."""
        if not self.program.plans:
            raise InputError("the scene has no phase and gives nothing out; add one with phase(), output() or vjp()")
        used = set(topological([n for plan in self.program.plans for n in (*plan.updates.values(), *plan.outputs.values())]))
        for name, parameter in self.parameters.items():
            if parameter.node not in used:
                raise InputError(f"parameter {name} ({parameter.where}) is used by nothing; use it in a part, or leave it out")

    def pictures_layout(self, vtype: str) -> Layout:
        """Of pictures of all views."""
        return pictures_layout(self.atlas, vtype)
