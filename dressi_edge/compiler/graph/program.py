"""A problem as plain data: what lives on the device, what comes in, what each plan updates and gives out.

In: nodes built by `render/` or by the user. Out: a `Program`, which `compiler.build` turns into a bundle. What no bundle can hold is
refused here, when it is said.
"""
from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ...cache.errors import GraphError
from ...cache.layout import CHANNELS, KINDS, Layout
from .ir import Extent, Node, topological
from .optable import apply, nearest

MAX_STEPS = 1 << 40
MAX_SIDE = 1 << 16
OURS = re.compile(r"\.(prepare(\.\d+)?|enter\d*|leave\d*)$")  # names of plans that the compiler adds
LISTED = re.compile(r"\.list\d*\.")  # and of copies


def check_name(what: str, name) -> None:
    """Raises GraphError unless a bundle can hold the name: a text of 1 to 200 characters, none of control."""
    if type(name) is not str:
        raise GraphError(f"{what} {name!r:.60}: a name is a text")
    if not 0 < len(name) <= 200 or any(c < " " or "\x7f" <= c < "\xa0" for c in name) or not name.isascii() and not _utf8(name):
        raise GraphError(f"{what} {name[:60]!r} has {len(name)} characters; a name has 1 to 200, none of them a line end or another of "
                         "control")


def _utf8(name: str) -> bool:
    try:
        name.encode()
    except UnicodeEncodeError:  # half of a surrogate pair
        return False
    return True


def check_layout(what: str, name: str, layout: Layout) -> None:
    """Raises GraphError unless an image can hold the layout: kind and type are known, each side has from 1 to 65536 texels."""
    if not isinstance(layout, Layout):
        raise GraphError(f"{what} {name}: {type(layout).__name__} {layout!r:.60} is no Layout")
    for key, word, known in (("kind", layout.kind, KINDS), ("type", layout.vtype, CHANNELS)):
        if not isinstance(word, str) or word not in known:
            raise GraphError(f"{what} {name}: its layout has {key} {word!r:.40}; allowed: {' '.join(known)}{nearest(word, known)}")
    for key in ("width", "height", "count", "columns"):
        if type(x := getattr(layout, key)) is not int or x < 1:
            raise GraphError(f"{what} {name}: its layout has {key} {x!r:.40}; a whole number above 0 is needed")
    width, height = layout.size
    if max(width, height) > MAX_SIDE:
        raise GraphError(f"{what} {name} needs an image of {width} x {height}; at most {MAX_SIDE} texels a side are allowed")


def extent_of(layout: Layout) -> Extent:
    """The extent of the image that holds a user's array."""
    width, height = layout.size
    return Extent(width, height, layout.count if layout.kind == "table" else width * height)


@dataclass(frozen=True)
class Value:
    """An input, a state or an output: its node, layout, and for inputs and states the array it starts with (or None). `narrow`: an
    input that may be stored in 16 bits a channel, for nothing but images is compared with it."""

    node: Node
    layout: Layout
    initial: np.ndarray | None = None
    narrow: bool = False


@dataclass(frozen=True)
class PlanSpec:
    """One thing the session can run: the states it updates (by name) and the outputs it gives. `dynamic` names the leaves that change
    between runs; what depends on none of them is computed once and kept, shared by the plans of a `group`. `moving` names leaves that
    change every few runs: what depends on them is kept only where it costs much (`passes/specialize.py`). `steps` is how often to run."""

    name: str
    updates: Mapping[str, Node]
    outputs: Mapping[str, Node]
    dynamic: frozenset[str]
    steps: int = 0
    group: str = ""
    moving: frozenset[str] = frozenset()


@dataclass
class Program:
    """The problem being built. attached: bytes that its bundle carries for whoever reads meta, where a map of that name gets `blobs`.
    turned: by group of plans, the input that says which view the next step sees; the session gives it another value each step."""

    values: dict[str, Value] = field(default_factory=dict)
    roles: dict[str, str] = field(default_factory=dict)
    plans: list[PlanSpec] = field(default_factory=list)
    meta: dict = field(default_factory=dict)
    attached: dict[str, Sequence[bytes]] = field(default_factory=dict)
    turned: dict[str, str] = field(default_factory=dict)

    def _leaf(self, role: str, name: str, layout: Layout, initial, narrow: bool = False) -> Node:
        check_name(role, name)
        check_layout(role, name, layout)
        if LISTED.search(name):
            raise GraphError(f"{role} {name}: names with .list. in them are the compiler's; choose another")
        if name in self.values:
            raise GraphError(f"{role} {name}: the name is taken by {self.roles[name]} {self.values[name].node!r}")
        node = apply(role, name=name, vtype=layout.vtype, extent=extent_of(layout))
        start = None if initial is None else np.broadcast_to(np.asarray(initial), layout.shape) if np.ndim(initial) == 0 else initial
        if start is not None:
            layout.to_image(start, name)
        self.values[name] = Value(node, layout, start, narrow)
        self.roles[name] = role
        return node

    def input(self, name: str, layout: Layout, default=None, narrow: bool = False) -> Node:
        """An image the session sets; with a default it need not. `narrow`: storage half applies to it."""
        return self._leaf("input", name, layout, default, narrow)

    def state(self, name: str, layout: Layout, initial=0) -> Node:
        """An image that lives on the device and that plans update."""
        return self._leaf("state", name, layout, initial)

    def plan(self, name: str, updates: Mapping[str, Node] = {}, outputs: Mapping[str, tuple[Node, Layout]] = {},  # noqa: B006
             dynamic: frozenset[str] | None = None, steps: int = 0, group: str = "", moving: frozenset[str] = frozenset()) -> None:
        """Add a plan. `outputs`: name -> (node, layout). `dynamic` defaults to the updated states; None of a plan without updates
        means that everything may change. Raises GraphError, and nothing is added then."""
        check_name("plan", name)
        if OURS.search(name):
            raise GraphError(f"plan {name}: names that end in .{name.rpartition('.')[2]} are the compiler's; choose another")
        if any(spec.name == name for spec in self.plans):
            raise GraphError(f"plan {name}: there is a plan of this name; choose another")
        if type(steps) is not int or not 0 <= steps <= MAX_STEPS:
            raise GraphError(f"plan {name}: steps is {steps!r:.40}; a whole number from 0 (no wish) to {MAX_STEPS} is needed")
        group = group or name
        check_name("group", group)
        new: dict[str, Value] = {}
        for key, pair in outputs.items():
            if not isinstance(pair, tuple | list) or len(pair) != 2:
                raise GraphError(f"plan {name}: output {key!r:.60} is {type(pair).__name__}; a pair (node, layout) is needed")
            check_layout("output", key, pair[1])
        roots = {**updates, **{key: node for key, (node, _) in outputs.items()}}
        for key, node in roots.items():
            if not isinstance(node, Node):
                raise GraphError(f"plan {name}: {key!r:.60} is {type(node).__name__}; a graph value is needed")
        leaves = [n for n in topological(roots.values()) if n.op.held]
        for n in leaves:
            if n.name not in self.values or self.values[n.name].node is not n:
                raise GraphError(f"plan {name} reads {n.op.name} {n!r}, which is not of this program; make it with its input() or state()")
        for key, node in updates.items():
            state = self.values.get(key)
            if state is None or self.roles[key] != "state":
                states = [known for known, role in self.roles.items() if role == "state"]
                raise GraphError(f"plan {name} updates {key}, which is no state{nearest(key, states)}")
            if (node.vtype, node.extent) != (state.node.vtype, state.node.extent):
                raise GraphError(f"plan {name}: the update of {key} is {node!r}; {state.node!r} is needed")
        for key, (node, layout) in outputs.items():
            if (node.vtype, node.extent) != (layout.vtype, extent_of(layout)):
                raise GraphError(f"plan {name}: output {key} is {node!r}; {layout.vtype} {extent_of(layout)} is needed")
            known = self.values.get(key)
            if known is None:
                check_name("output", key)
                new[key] = Value(node, layout)
            elif self.roles[key] != "output" or known.layout != layout:
                raise GraphError(f"output {key}: the name is taken by {self.roles[key]} {known.node!r}")
        if not roots:
            raise GraphError(f"plan {name} updates nothing and gives nothing out")
        self._check_losses(name if updates else None, new)
        if dynamic is None:
            dynamic = frozenset(updates) or frozenset(n.name for n in leaves)
        self.values |= new
        self.roles |= dict.fromkeys(new, "output")
        self.plans.append(PlanSpec(name, dict(updates), {k: node for k, (node, _) in outputs.items()}, dynamic, steps, group, moving))

    def _check_losses(self, phase: str | None, new: Mapping[str, Value]) -> None:
        """An output called as a phase and ".loss" is what `Session.loss` and the command line take for one number."""
        phases = {spec.name for spec in self.plans if spec.updates} | {phase} - {None}
        for key, value in (self.values | new).items():
            if key.endswith(".loss") and key[:-5] in phases and (value.layout.kind, value.layout.vtype) != ("unit", "float"):
                raise GraphError(f"{key} is the loss of phase {key[:-5]}, which is one float; give it another name, or the layout unit of "
                                 "float")
