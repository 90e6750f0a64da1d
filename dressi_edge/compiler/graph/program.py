"""A problem as plain data: what lives on the device, what comes in, what each plan updates and gives out.

In: nodes built by `render/` or by the user. Out: a `Program`, which `plan.Assembler` turns into a bundle.
"""
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ...cache.errors import GraphError
from ...cache.layout import Layout
from .ir import Extent, Node, topological
from .optable import apply


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
    between runs; what depends on none of them is computed once and kept, shared by the plans of a `group`; `steps` is how often to
    run."""

    name: str
    updates: Mapping[str, Node]
    outputs: Mapping[str, Node]
    dynamic: frozenset[str]
    steps: int = 0
    group: str = ""


@dataclass
class Program:
    """The problem being built."""

    values: dict[str, Value] = field(default_factory=dict)
    roles: dict[str, str] = field(default_factory=dict)
    plans: list[PlanSpec] = field(default_factory=list)
    meta: dict = field(default_factory=dict)

    def _leaf(self, role: str, name: str, layout: Layout, initial, narrow: bool = False) -> Node:
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
             dynamic: frozenset[str] | None = None, steps: int = 0, group: str = "") -> None:
        """Add a plan. `outputs`: name -> (node, layout). `dynamic` defaults to the updated states; None of a plan without updates
        means that everything may change."""
        for key, node in updates.items():
            state = self.values.get(key)
            if state is None or self.roles[key] != "state":
                raise GraphError(f"plan {name} updates {key}, which is no state")
            if (node.vtype, node.extent) != (state.node.vtype, state.node.extent):
                raise GraphError(f"plan {name}: the update of {key} is {node!r}; {state.node!r} is needed")
        for key, (node, layout) in outputs.items():
            if (node.vtype, node.extent) != (layout.vtype, extent_of(layout)):
                raise GraphError(f"plan {name}: output {key} is {node!r}; {layout.vtype} {extent_of(layout)} is needed")
            known = self.values.get(key)
            if known is None:
                self.values[key] = Value(node, layout)
                self.roles[key] = "output"
            elif self.roles[key] != "output" or known.layout != layout:
                raise GraphError(f"output {key}: the name is taken by {self.roles[key]} {known.node!r}")
        roots = [*updates.values(), *(node for node, _ in outputs.values())]
        if not roots:
            raise GraphError(f"plan {name} updates nothing and gives nothing out")
        if dynamic is None:
            dynamic = frozenset(updates) or frozenset(
                n.attrs["name"] for n in topological(roots) if n.op.name in ("input", "state"))
        self.plans.append(PlanSpec(name, dict(updates), {k: node for k, (node, _) in outputs.items()}, dynamic, steps,
                                   group or name))
