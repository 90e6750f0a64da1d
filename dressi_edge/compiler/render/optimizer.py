"""Optimizers as graph: from a parameter and its gradient, the next parameter and moments.

The moments are states of the program beside the parameter. What depends on the step alone (rates, bias corrections) is 1x1,
computed once a step. Step 0 decays the stored moments by a factor of 0, so that a later phase starts afresh on the same states.
"""
from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

from ...cache.errors import InputError
from ..graph.functions import clamp, compose, maximum, minimum, select, sqrt, to_float
from ..graph.ir import UNIT, Node
from ..graph.optable import apply, as_node
from ..graph.program import Program
from .schedule import Schedule


def _fraction(name: str, x) -> None:
    if isinstance(x, bool) or not isinstance(x, (int, float)) or not 0 <= x < 1:
        raise InputError(f"{name} is {x!r}; a number from 0 up to but not including 1 is needed")


def _check(program: Program, name: str, parameter: Node, gradient: Node, step: Node) -> None:
    if program.roles.get(name) != "state" or program.values[name].node is not parameter:
        raise InputError(f"optimizer: {name} is not the state of {parameter!r}")
    if (gradient.vtype, gradient.extent) != (parameter.vtype, parameter.extent):
        raise InputError(f"optimizer: the gradient of {name} is {gradient!r}; one like {parameter!r} is needed")
    if step.vtype != "int" or step.extent != UNIT:
        raise InputError(f"optimizer: step counter {step!r}; a 1x1 int is needed")


def state(program: Program, name: str, like: str) -> Node:
    """What an optimizer keeps: the state `name`, zero at first, laid out as the state `like`; phases that optimize the same parameter
    share it."""
    layout, known = program.values[like].layout, program.values.get(name)
    if known is not None and program.roles[name] == "state" and known.layout == layout:
        return known.node
    return program.state(name, layout)


def limited(x: Node, low, high) -> Node:
    """x within [low, high], either of which may be None."""
    if low is not None and high is not None:
        return clamp(x, low, high)
    return maximum(x, low) if low is not None else minimum(x, high) if high is not None else x


def _decay(step: Node, factor: float, like: Node) -> Node:
    """The factor of a moment, compared at every texel: cheaper than one more image between two passes."""
    return select(apply("broadcast", step, extent=like.extent) > 0, factor, 0.0)


def one_minus_power(base: float, t: Node) -> Node:
    """1 - base^t of a float t >= 1 and 0 <= base < 1, to about 1e-6 relative in fp32.

    For base 0.999 and t = 1, fp32 keeps only four digits of the difference 0.001. So log(base) is taken at compile time, and
    -expm1(x) of x = t log(base) is its series near 0: nine terms leave 0.5^9 / 10! at most. Further out nothing cancels.
    """
    if base == 0.0:
        return as_node(1.0)
    x = t * math.log(base)
    near = maximum(x, -0.5)
    series = as_node(1.0)
    for k in range(9, 1, -1):
        series = near * (1.0 / k) * series + 1.0
    return select(x > -0.5, -(near * series), 1.0 - apply("exp", x))


class Optimizer(Protocol):
    """What updates a parameter. One of your own has this method; `state` makes what it keeps from step to step."""

    def update(self, program: Program, name: str, parameter: Node, gradient: Node, step: Node, *, low=None, high=None,
               mask: Node | None = None) -> dict[str, Node]:
        """See `Adam.update`."""


@dataclass(frozen=True)
class Sgd:
    """p - rate d, where d is the gradient g; with momentum the buffer b = momentum b + g; with nesterov g + momentum b.

    rate: a number, a `Schedule` or its table. momentum in [0, 1). Raises InputError.
    """

    rate: Schedule | float
    momentum: float = 0.0
    nesterov: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "rate", Schedule.parse(self.rate, "rate"))
        _fraction("momentum", self.momentum)
        if self.nesterov and not self.momentum:
            raise InputError("nesterov needs a momentum over 0")

    def update(self, program: Program, name: str, parameter: Node, gradient: Node, step: Node, *, low=None, high=None,
               mask: Node | None = None) -> dict[str, Node]:
        """See `Adam.update`; the state is `<name>.momentum`."""
        _check(program, name, parameter, gradient, step)
        g = gradient if mask is None else gradient * mask
        rate, updates = self.rate.node(step), {}
        if self.momentum:
            key = f"{name}.momentum"
            updates[key] = buffer = state(program, key, name) * _decay(step, self.momentum, g) + g
            g = g + buffer * self.momentum if self.nesterov else buffer
        return {name: limited(parameter - g * rate, low, high), **updates}


@dataclass(frozen=True)
class Adam:
    """Adam (Kingma and Ba, 2015, algorithm 1). rate: a number, a `Schedule` or its table; betas in [0, 1); epsilon >= 1e-15.

    A texel whose gradient and moments are zero keeps its bits. Raises InputError.
    """

    rate: Schedule | float = 0.01
    betas: tuple[float, float] = (0.9, 0.999)
    epsilon: float = 1e-8

    def __post_init__(self) -> None:
        object.__setattr__(self, "rate", Schedule.parse(self.rate, "rate"))
        if not isinstance(self.betas, (tuple, list)) or len(self.betas) != 2:
            raise InputError(f"betas is {self.betas!r}; two numbers are needed")
        object.__setattr__(self, "betas", tuple(self.betas))
        for beta in self.betas:
            _fraction("betas", beta)
        # Squares of gradients under 1e-19 are zero in fp32, and the step is then m / epsilon: with a smaller one it would leap.
        if isinstance(self.epsilon, bool) or not isinstance(self.epsilon, (int, float)) or not 1e-15 <= self.epsilon < math.inf:
            raise InputError(f"epsilon is {self.epsilon!r}; at least 1e-15 is needed")

    def update(self, program: Program, name: str, parameter: Node, gradient: Node, step: Node, *, low=None, high=None,
               mask: Node | None = None) -> dict[str, Node]:
        """Updates by state name: the parameter `name` and its moments `<name>.adam_m`, `<name>.adam_v`, made where missing.

        step: 1x1 int, finished steps of this phase (0 at the first); advancing it is the caller's. low, high: limits of the new
        parameter. mask: float in [0, 1] over the parameter's extent, times the gradient. Raises InputError, GraphError.
        """
        _check(program, name, parameter, gradient, step)
        (beta1, beta2), (m_name, v_name) = self.betas, (f"{name}.adam_m", f"{name}.adam_v")
        g = gradient if mask is None else gradient * mask
        t, later = to_float(step + 1), step > 0
        # rate (m / c1) / (sqrt(v / c2) + epsilon), with the scalars drawn together
        root = sqrt(one_minus_power(beta2, t))
        size = self.rate.node(step) * root / one_minus_power(beta1, t)
        # one image of one texel, not four: every texel of the parameter reads it
        decays = select(later, beta1, 0.0), select(later, beta2, 0.0)
        scalars = apply("broadcast", compose(*decays, size, root * self.epsilon), extent=g.extent)
        m = state(program, m_name, name) * scalars.x + g * (1.0 - beta1)
        v = state(program, v_name, name) * scalars.y + g * g * (1.0 - beta2)
        moved = parameter - m * scalars.z / (sqrt(v) + scalars.w)
        return {name: limited(moved, low, high), m_name: m, v_name: v}
