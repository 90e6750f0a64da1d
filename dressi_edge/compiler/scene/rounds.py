"""The gradient of all views, taken one view a step: order "accumulate" (docs/job.md, "Many views").

In: the gradients of the view that a step sees. Out: sums of them over a round of all views, and updates that change something in the
last step of a round alone. What comes out is what order "batch" gives, up to the order of sums (docs/numerics.md): image terms are means
over the pixels of all views, terms of meshes are the same in each step.
"""
from __future__ import annotations

from collections.abc import Mapping

from ..graph.functions import apply, select
from ..graph.ir import Node
from ..graph.program import Program


class Round:
    """Of a phase whose steps `step` counts; `views` of them make a round. turn: the number of rounds before, an int: what optimizers and
    schedules count. sums: updates of the sums."""

    def __init__(self, program: Program, phase: str, step: Node, views: int):
        self.program, self.phase, self.step, self.views, self.sums = program, phase, step, views, {}
        self.turn = step if views == 1 else apply("idiv", step, views)
        place = apply("imod", step, views)
        self._first, self._last = apply("equal", place, 0), apply("equal", place, views - 1)

    def mean(self, key: str, gradient: Node) -> Node:
        """The mean of the gradients by a parameter in this round so far, over all its views."""
        if self.views == 1:
            return gradient
        name = f"{self.phase}.{key}.sum"
        before = self.program.state(name, self.program.values[key].layout)
        self.sums[name] = select(self._first, gradient, before + gradient)
        return self.sums[name] * (1.0 / self.views)

    def updates(self, new: Mapping[str, Node]) -> dict[str, Node]:
        """Of states, by name: as they are until the last step of a round."""
        if self.views == 1:
            return dict(new)
        return {name: select(self._last, node, self.program.values[name].node) for name, node in new.items()}
