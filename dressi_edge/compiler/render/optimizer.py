"""Optimizers as graph: from a parameter and its gradient, the next parameter and moments.

The moments are states of the program beside the parameter. What depends on the step alone (rates, bias corrections) is 1x1,
computed once a step. Step 0 decays the stored moments by a factor of 0, so that a later phase starts afresh on the same states.
"""
from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from ...cache.errors import InputError
from ...cache.layout import beyond_fp32
from ..graph.functions import absolute, channels, clamp, compose, constant, dot, largest, maximum, minimum, select, sqrt, to_float, total
from ..graph.ir import UNIT, Node
from ..graph.optable import apply, as_node
from ..graph.program import Program
from .schedule import Schedule

SHARED = ("parameter", "vector")


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


def state(program: Program, name: str, like: str, vtype: str | None = None) -> Node:
    """What an optimizer keeps: the state `name`, zero at first, laid out as the state `like`, or with another type; phases that optimize
    the same parameter share it."""
    layout, known = program.values[like].layout, program.values.get(name)
    layout = layout if vtype is None else replace(layout, vtype=vtype)
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


def _check_adam(optimizer) -> None:
    """Of Adam and its kin: rate, betas, epsilon."""
    object.__setattr__(optimizer, "rate", Schedule.parse(optimizer.rate, "rate"))
    betas, epsilon = optimizer.betas, optimizer.epsilon
    if not isinstance(betas, (tuple, list)) or len(betas) != 2:
        raise InputError(f"betas is {betas!r}; two numbers are needed")
    object.__setattr__(optimizer, "betas", tuple(betas))
    for beta in betas:
        _fraction("betas", beta)
    # Squares of gradients under 1e-19 are zero in fp32, and the step is then m / epsilon: with a smaller one it would leap.
    if isinstance(epsilon, bool) or not isinstance(epsilon, (int, float)) or not 1e-15 <= epsilon < math.inf:
        raise InputError(f"epsilon is {epsilon!r}; at least 1e-15 is needed")


def _top(x: Node) -> Node:
    """The largest number of all entries and channels."""
    first, *rest = channels(largest(x))
    for channel in rest:
        first = maximum(first, channel)
    return first


def _size(name: str, x, least: float = 0.0) -> None:
    if isinstance(x, bool) or not isinstance(x, (int, float)) or not least < x or beyond_fp32(x):
        raise InputError(f"{name} is {x!r:.40}; a number above {least:g}, finite in fp32, is needed")


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
        _check_adam(self)

    def _kept(self, parameter: Node, step: Node, mask: Node | None) -> Node:
        """What a step starts from."""
        return parameter

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
        moved = self._kept(parameter, step, mask) - m * scalars.z / (sqrt(v) + scalars.w)
        return {name: limited(moved, low, high), m_name: m, v_name: v}


@dataclass(frozen=True)
class AdamW(Adam):
    """Adam, and each step takes rate x decay of the parameter away, beside the gradient and not through it (Loshchilov and Hutter 2019,
    algorithm 2). decay from 0 on. Entries that are not free do not decay. Raises InputError."""

    decay: float = 0.01

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.decay != 0:
            _size("decay", self.decay)

    def _kept(self, parameter: Node, step: Node, mask: Node | None) -> Node:
        part = self.rate.node(step) * self.decay
        return parameter * (1.0 - (part if mask is None else mask * part))


@dataclass(frozen=True)
class AdamUniform:
    """Adam with one second moment for all numbers of a vector, or for a whole parameter, so that a step keeps the direction of the first
    moment: smooth gradients make smooth steps (Nicolet et al. 2021, section 4).

    shared "parameter": the largest second moment of all its numbers, as theirs; "vector": in each entry that of |g|^2, whatever the
    axes, so that no entry moves much further than the rate. rate, betas, epsilon as of `Adam`. Raises InputError.
    """

    rate: Schedule | float = 0.01
    betas: tuple[float, float] = (0.9, 0.999)
    epsilon: float = 1e-8
    shared: str = "parameter"

    def __post_init__(self) -> None:
        _check_adam(self)
        if self.shared not in SHARED:
            raise InputError(f"shared is {self.shared!r:.40}; {' or '.join(SHARED)} is allowed")

    def update(self, program: Program, name: str, parameter: Node, gradient: Node, step: Node, *, low=None, high=None,
               mask: Node | None = None) -> dict[str, Node]:
        """See `Adam.update`; the states are `<name>.adam_m` and `<name>.uniform_v`, or where a vector shares it `<name>.vector_v`,
        a float for each."""
        _check(program, name, parameter, gradient, step)
        g = gradient if mask is None else gradient * mask
        t, vector = to_float(step + 1), self.shared == "vector"
        (beta1, beta2), (m_name, v_name) = self.betas, (f"{name}.adam_m", f"{name}.{'vector' if vector else 'uniform'}_v")
        root = sqrt(one_minus_power(beta2, t))
        size = self.rate.node(step) * root / one_minus_power(beta1, t)
        m = state(program, m_name, name) * _decay(step, beta1, g) + g * (1.0 - beta1)
        v = state(program, v_name, name, "float" if vector else None) * _decay(step, beta2, g)
        v = v + (dot(g, g) if vector else g * g) * (1.0 - beta2)
        top = v
        if self.shared == "parameter":
            top = _top(v)
        factor = size / (sqrt(top) + root * self.epsilon)
        return {name: limited(parameter - m * factor, low, high), m_name: m, v_name: v}


@dataclass(frozen=True)
class Clipped:
    """An optimizer that is given a smaller gradient: each number within [-value, value], then all of the parameter's together no longer
    than `norm`, which keeps their direction. Either may be None. One parameter at a time. Raises InputError."""

    optimizer: Optimizer
    value: float | None = None
    norm: float | None = None

    def __post_init__(self) -> None:
        _check_inner("Clipped", self.optimizer)
        if self.value is None and self.norm is None:
            raise InputError("Clipped limits nothing; give it a value, a norm, or both")
        for key in ("value", "norm"):
            if getattr(self, key) is not None:
                _size(f"Clipped: {key}", getattr(self, key))

    def update(self, program: Program, name: str, parameter: Node, gradient: Node, step: Node, *, low=None, high=None,
               mask: Node | None = None) -> dict[str, Node]:
        """See `Adam.update`; the states are the optimizer's. Entries that are not free are no part of the norm."""
        g = gradient if self.value is None else clamp(gradient, -self.value, self.value)
        if self.norm is not None:
            free = g if mask is None else g * mask
            top = maximum(_top(absolute(free)), 1e-30)  # its square may be beyond fp32, or vanish
            length = sqrt(total(dot(free / top, free / top)))  # of the gradient, in units of its largest number
            g = g * minimum(self.norm / top / maximum(length, 1e-30), 1.0)
        return self.optimizer.update(program, name, parameter, g, step, low=low, high=high, mask=mask)


@dataclass(frozen=True, eq=False)
class Scaled:
    """An optimizer whose steps are multiplied, entry by entry: a rate of its own for each. scale: an array like the parameter without its
    channels, or a float node of its extent or 1x1. An entry of scale 0 stays. Raises InputError."""

    optimizer: Optimizer
    scale: np.ndarray | Node | float

    def __post_init__(self) -> None:
        _check_inner("Scaled", self.optimizer)
        if not isinstance(self.scale, Node):
            try:
                scale = np.asarray(self.scale, np.float64)
            except (TypeError, ValueError):
                raise InputError(f"Scaled: scale is {self.scale!r:.60}; numbers are needed") from None
            if beyond_fp32(scale).any():
                raise InputError("Scaled: scale has numbers that are not finite in fp32")
            object.__setattr__(self, "scale", scale)

    def update(self, program: Program, name: str, parameter: Node, gradient: Node, step: Node, *, low=None, high=None,
               mask: Node | None = None) -> dict[str, Node]:
        """See `Adam.update`; the states are the optimizer's."""
        layout, scale = replace(program.values[name].layout, vtype="float"), self.scale
        if not isinstance(scale, Node):
            if scale.ndim == 0:
                scale = as_node(float(scale))
            else:
                image = layout.to_image(scale, f"optimizer of {name}: scale")
                scale = constant(image, parameter.extent)
        if scale.vtype != "float" or scale.extent not in (UNIT, parameter.extent):
            raise InputError(f"optimizer of {name}: scale is {scale!r}; a float for each entry of {parameter!r} is needed")
        updates = self.optimizer.update(program, name, parameter, gradient, step, mask=mask)
        return {**updates, name: limited(parameter + (updates[name] - parameter) * scale, low, high)}


def _check_inner(who: str, optimizer) -> None:
    if not callable(getattr(optimizer, "update", None)):
        raise InputError(f"{who}: {optimizer!r:.60} is no optimizer; something with an update method, such as Adam, is needed")
