"""Numbers that change with the step: learning rates, radii, weights.

In: a number or a table of a job file. Out: a `Schedule`, whose node is a 1x1 float computed on the device from a step counter.
"""
from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields

from ...cache.errors import InputError
from ...cache.layout import beyond_fp32
from ..graph.functions import maximum, minimum, select, to_float
from ..graph.ir import UNIT, Node, is_int
from ..graph.optable import apply, as_node

KINDS = ("constant", "exponential", "linear", "cosine", "piecewise")


def _number(name: str, x) -> float:
    if isinstance(x, bool) or not isinstance(x, (int, float)) or beyond_fp32(x):
        raise InputError(f"{name} is {x!r}; a finite number of fp32 is needed")
    return float(x)


def _count(name: str, x, least: int) -> int:
    if isinstance(x, bool) or not isinstance(x, int) or not least <= x < 2 ** 31:
        raise InputError(f"{name} is {x!r}; a whole number from {least} on is needed")
    return x


@dataclass(frozen=True)
class Schedule:
    """A number as a function of the step t = 0, 1, ...; held at its last value from step `steps` on.

    kind: "constant" start; "exponential" start (end / start)^(t / steps); "linear"; "cosine" (half a wave from start to end);
    "piecewise": values[k], k being how many of the ascending steps `at` are <= t (one value more than `at`). warmup: that many
    steps come first, in which the start is multiplied by (t + 1) / warmup; t counts from their end. Raises InputError.
    """

    start: float = 0.0
    end: float | None = None
    steps: int = 0
    kind: str = "constant"
    at: tuple[int, ...] = ()
    values: tuple[float, ...] = ()
    warmup: int = 0

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise InputError(f"schedule kind is {self.kind!r}; {', '.join(KINDS)} are allowed")
        _count("schedule warmup", self.warmup, 0)
        if self.kind == "piecewise":
            if not isinstance(self.at, (list, tuple)) or not isinstance(self.values, (list, tuple)):
                raise InputError(f"piecewise schedule: at is {self.at!r}, values is {self.values!r}; lists are needed")
            self._set("at", tuple(_count("schedule at", t, 1) for t in self.at))
            self._set("values", tuple(_number("schedule values", v) for v in self.values))
            if len(self.values) != len(self.at) + 1 or any(a >= b for a, b in zip(self.at, self.at[1:])):
                raise InputError(f"piecewise schedule: {len(self.values)} values for steps {list(self.at)}; ascending steps "
                                 "and one value more are needed")
            self._set("start", self.values[0])
            return
        if self.at or self.values:
            raise InputError(f"{self.kind} schedule: at and values belong to kind piecewise")
        self._set("start", _number("schedule start", self.start))
        if self.kind == "constant":
            if self.end not in (None, self.start):
                raise InputError(f"constant schedule from {self.start} to {self.end}; set kind and steps, or leave end out")
            return
        _count("schedule steps", self.steps, 1)
        self._set("end", _number("schedule end", self.end))
        if self.kind == "exponential" and not self.start * self.end > 0:
            raise InputError(f"exponential schedule from {self.start} to {self.end}; numbers of one sign, not 0, are needed")

    def _set(self, name: str, value) -> None:
        object.__setattr__(self, name, value)

    @classmethod
    def parse(cls, value, name: str = "schedule") -> Schedule:
        """From a number, a schedule, or a table such as {start = 0.1, end = 0.001, steps = 500, kind = "exponential"}, where an
        `end` without kind means exponential, and `values` piecewise. Errors begin with `name`."""
        if isinstance(value, Schedule):
            return value
        if not isinstance(value, Mapping):
            return cls(_number(name, value))
        allowed = [f.name for f in fields(cls)]
        unknown = [key for key in value if key not in allowed]
        if unknown:
            raise InputError(f"{name}: no key {', '.join(map(str, unknown))}; {', '.join(allowed)} are allowed")
        given = dict(value)
        if "start" not in given and "values" not in given:
            raise InputError(f"{name}: start is missing; {', '.join(allowed)} are allowed")
        given.setdefault("kind", "piecewise" if "values" in given else "exponential" if "end" in given else "constant")
        try:
            return cls(**given)
        except InputError as error:
            raise InputError(f"{name}: {error}") from None

    def node(self, step: Node) -> Node:
        """The value at `step`, an int or float 1x1 node: a 1x1 float. Raises InputError."""
        if step.channels != 1 or step.extent != UNIT:
            raise InputError(f"step counter {step!r}; a 1x1 int or float is needed")
        if not self.warmup:
            return self._after_warmup(step)
        ramp = _float(minimum(step, self.warmup - 1)) + 1.0
        return self._after_warmup(maximum(step - self.warmup, 0)) * (ramp / self.warmup)

    def _after_warmup(self, step: Node) -> Node:
        if self.kind == "constant":
            return as_node(self.start)
        if self.kind == "piecewise":
            value = as_node(self.values[0])
            for t, v in zip(self.at, self.values[1:]):
                value = select(step >= t, v, value)
            return value
        t = _float(minimum(step, self.steps))
        if self.kind == "exponential":
            return apply("exp", t * (math.log(self.end / self.start) / self.steps)) * self.start
        if self.kind == "linear":
            return t * ((self.end - self.start) / self.steps) + self.start
        # Vulkan's cos may be off by 2^-11: the fade stays in [0, 1], and the end is the end.
        fade = minimum(maximum(apply("cos", t * (math.pi / self.steps)) * 0.5 + 0.5, 0.0), 1.0)
        return select(step >= self.steps, self.end, fade * (self.start - self.end) + self.end)


def _float(step: Node) -> Node:
    return to_float(step) if is_int(step.vtype) else step
