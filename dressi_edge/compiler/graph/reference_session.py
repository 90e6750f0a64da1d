"""The program of a problem run in NumPy float64, with the face of a runtime session: what `--device reference` runs.

In: a `Program`. Out: set, get, step and loss as `dressi_edge.runtime.Session` has them. Nothing is cached, packed or
rounded; slow.
"""
from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np

from ...cache import vjp
from ...cache.errors import InputError
from ...cache.steps import bounded, check_step
from .ir import Node, topological
from .program import PlanSpec, Program
from .reference import evaluate


class _Now(NamedTuple):
    """feed: inputs and states as images. given: what phases gave out when they last ran. runs: iterations of each plan. One object, so
    that an interrupt finds all of an iteration or nothing of it."""

    feed: dict[str, np.ndarray]
    given: dict[str, np.ndarray]
    runs: dict[str, int]


class ReferenceSession:
    """A context manager. Values are kept as images (height, width, channels). real: the type of its numbers."""

    real = np.float64

    def __init__(self, program: Program):
        self.program = program
        self.values = {name: {"name": name, "role": role, "layout": program.values[name].layout.kind}
                       for name, role in program.roles.items()}
        names = list(self.values)
        self.specs = {spec.name: spec for spec in program.plans}
        self.plans = {spec.name: {"name": spec.name, "steps": spec.steps, "updates": [names.index(n) for n in spec.updates],
                                  "outputs": [names.index(n) for n in spec.outputs]} for spec in program.plans}
        self.bundle = SimpleNamespace(description={"meta": program.meta,
                                                   "profile": {"name": "reference", "digest": "reference"},
                                                   "values": list(self.values.values()), "plans": list(self.plans.values())})
        self.device = SimpleNamespace(name="NumPy float64", driver="reference")
        self.phases = [spec.name for spec in program.plans if spec.updates]
        self.phase = self.phases[0] if self.phases else None
        self._lock, self._versions = threading.RLock(), Counter()
        self._now = _Now({name: value.layout.to_image(value.initial, name, value.node.half is not None)
                          for name, value in program.values.items() if value.initial is not None}, {}, dict.fromkeys(self.specs, 0))

    def __enter__(self) -> ReferenceSession:
        return self

    def __exit__(self, *_) -> None:
        self.close()

    def ready(self) -> None:
        """There is nothing to wait for."""

    def close(self) -> None:
        """There is nothing to give back."""

    def _known(self, name: str, roles: tuple[str, ...]) -> None:
        if self.program.roles.get(name) not in roles:
            known = " ".join(n for n, role in self.program.roles.items() if role in roles)
            raise InputError(f"{name!r:.60} is no {' or '.join(roles)} of this problem; there are: {known}")

    def shape(self, name: str) -> tuple[int, ...]:
        """The shape of a value's array. Raises InputError."""
        self._known(name, ("input", "state", "output"))
        return self.program.values[name].layout.shape

    def set(self, name: str, array, view: int | None = None) -> None:
        """Give an input or a state an array, or pictures one of them, as `Session.set`."""
        if view is not None:
            array = np.concatenate([(now := self.get(name))[:view], np.asarray(array)[None], now[view + 1:]])
        self.set_all({name: array})

    def set_all(self, arrays: Mapping[str, object]) -> None:
        """`set` of several: all of them or, after an error, none."""
        found = {}
        for name, array in arrays.items():
            self._known(name, ("input", "state"))
            value = self.program.values[name]
            found[name] = value.layout.to_image(array, name, value.node.half is not None)
        self._now.feed.update(found)
        self._versions.update(found.keys())

    def get(self, name: str, view: int | None = None) -> np.ndarray:
        """The value of an input, state or output now; what a phase gives out is that of its last iteration, of the states before it.
        view: of pictures one alone."""
        found = self.get_all([name])[name]
        return found if view is None else found[view]

    def get_all(self, names: Iterable[str], into: Mapping[str, np.ndarray] | None = None) -> dict[str, np.ndarray]:
        """`get` of several; into: arrays to write some of them to."""
        names, now = list(dict.fromkeys(names)), self._now
        for name in names:
            self._known(name, ("input", "state", "output"))
        images, asked = {}, {}
        for name in names:
            if self.program.roles[name] == "output":
                asked.setdefault(next(s.name for s in self.program.plans if name in s.outputs), []).append(name)
            elif name in now.feed:
                images[name] = now.feed[name]
            else:
                raise InputError(f"{name} has no value yet; set it first")
        for spec, given in ((self.specs[key], given) for key, given in asked.items()):
            if not spec.updates:
                images |= zip(given, self._evaluated(spec, [spec.outputs[name] for name in given]))
            elif now.runs[spec.name]:
                images |= {name: now.given[name] for name in given}
            else:
                raise InputError(f"{given[0]} is given out by {spec.name}, which has not run yet")
        found = {name: self.program.values[name].layout.from_image(np.asarray(images[name])) for name in names}
        for name in found.keys() & (into or {}):
            into[name][...] = found[name]
            found[name] = into[name]
        return found

    @contextmanager
    def alone(self) -> Iterator[None]:
        """As a session of the runtime has it."""
        with self._lock:
            yield

    def reads(self, plan: str) -> tuple[str, ...]:
        """The inputs and states that a plan depends on."""
        spec = self.specs[plan]
        leaves = [n for n in topological([*spec.updates.values(), *spec.outputs.values()]) if n.op.name in ("input", "state")]
        return tuple(dict.fromkeys(n.attrs["name"] for n in leaves))

    def version(self, name: str) -> int:
        """Of an input or a state: another number after each change."""
        return self._versions[name]

    def _evaluated(self, spec: PlanSpec, roots: list[Node]) -> list[np.ndarray]:
        """These nodes of a plan, now. Raises InputError where an input that any of the plan's depends on is not set."""
        whole = topological([*spec.updates.values(), *spec.outputs.values()])
        if missing := sorted({n.attrs["name"] for n in whole if n.op.name == "input"}.difference(self._now.feed)):
            raise InputError(f"{spec.name} needs {' '.join(missing)}; set it first")
        return evaluate(roots, self._now.feed)

    def step(self, n: int = 1, phase: str | None = None, seconds: float | None = None, cancel=None) -> int:
        """Run a phase n times, or for so many seconds, as `Session.step`; how often it ran."""
        stop = check_step(n, seconds, cancel)
        if phase is not None and phase not in self.phases:
            raise InputError(f"{phase!r:.60} is no phase of this problem; there are: {' '.join(self.phases)}")
        self.phase = phase or self.phase
        if self.phase is None:
            raise InputError("this problem updates nothing: there is no phase to step")
        spec: PlanSpec = self.specs[self.phase]
        roots = [*spec.updates.values(), *spec.outputs.values()]

        def run(count: int) -> float:
            start = time.perf_counter()
            for _ in range(count):
                images, now = iter(self._evaluated(spec, roots)), self._now
                self._now = _Now(now.feed | dict(zip(spec.updates, images)), now.given | dict(zip(spec.outputs, images)),
                                 now.runs | {spec.name: now.runs[spec.name] + 1})
                self._versions.update(spec.updates.keys())
            return (time.perf_counter() - start) / max(count, 1)

        return bounded(n, run, seconds, stop)

    def forward(self, name: str) -> dict[str, np.ndarray]:
        """As a session of the runtime has it."""
        return vjp.forward(self, name)

    def backward(self, name: str, **gradients) -> dict[str, np.ndarray]:
        """As a session of the runtime has it."""
        return vjp.backward(self, name, gradients)

    def loss(self) -> float:
        """The loss of the phase."""
        return float(self.get(f"{self.phase}.loss"))

    def report(self) -> dict:
        """What ran, and on what."""
        return {"device": self.device.name, "driver": self.device.driver, "profile": "reference", "runs": dict(self._now.runs)}
