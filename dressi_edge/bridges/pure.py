"""A `Scene.vjp` of a session as a pure function of arrays, and its transpose: what a framework with gradients of its own wants to call.

In: arrays by the names of parameters and inputs. Out: pictures by the names of outputs; later, for gradients by pictures, gradients by
parameters, at the arrays that the call was given, whatever else the session was told in between. Knows no framework, and only the face of a
session (`runtime.Session`, `compiler.graph.reference_session.ReferenceSession`).
"""
from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from ..cache import vjp
from ..cache.errors import InputError

FEW = 16  # numbers that are compared sooner than sent


@dataclass(eq=False)
class Call:
    """One call of `Pure.forward`. arrays: what it was given, held, not copied: they must stay as they are until `backward`. versions: of
    all values that it read, when the session last had them so."""

    arrays: Mapping[str, np.ndarray]
    versions: dict[str, int]


class Pure:
    """name: of the vjp; may be left out where the bundle has one. outputs: the shape of each picture. parameters: of which there are
    gradients, with their shapes. given: the shapes of all values that a call may be given: parameters, and what else the pictures depend
    on; what a call is not given is as the session has it. Calls of several threads run one after another. Raises InputError."""

    def __init__(self, session, name: str | None = None):
        if name is None:
            found = [plan for plan in session.plans if f"{plan}.vjp" in session.plans]
            if len(found) != 1:
                raise InputError(f"the bundle has {len(found)} vjps ({' '.join(found) or 'Scene.vjp() makes one'}); name the one to use")
            name = found[0]
        vjp.check(session, name)
        self.session, self.name = session, name
        self.outputs = {key[len(name) + 1:]: session.shape(key) for key in vjp.outputs(session, name)}
        gradients = vjp.outputs(session, f"{name}.vjp")
        self.parameters = {key: session.shape(key) for key in (g[len(name) + 1:-len(".grad")] for g in gradients)}
        self._reads = [key for key in dict.fromkeys((*session.reads(name), *session.reads(f"{name}.vjp")))
                       if key not in {self._gradient(output) for output in self.outputs}]
        self.given = self.parameters | {key: session.shape(key) for key in self._reads}
        self.real = session.real
        self._seen: dict[str, tuple[int, np.ndarray]] = {}  # of steady values: the version that has these numbers
        self._zero: dict[str, int] = {}  # of gradients by outputs: the version that is zero

    def __deepcopy__(self, memo) -> Pure:
        return self  # it has no numbers of its own: a copy of what calls it may call it, too

    def __reduce__(self):
        raise InputError(f"the function {self.name} belongs to an open session, which cannot be pickled or sent to another process; load "
                         "the bundle there")

    def _gradient(self, key: str) -> str:
        return f"{self.name}.{key}.grad"

    def check(self, names: Iterable[str]) -> None:
        """Raises InputError unless a call may be given these."""
        if unknown := [key for key in names if key not in self.given]:
            raise InputError(f"{self.name} has no parameter or input {unknown[0]!r:.60}; there are: {' '.join(self.given)}")

    def at(self, arrays: Mapping[str, np.ndarray], steady: Collection[str] = ()) -> Call:
        """Give the session these arrays, and draw nothing yet: gradients are of them. Arguments as of `forward`."""
        self.check(arrays)
        with self.session.alone():
            self._set(arrays, steady)
            return Call(arrays, {key: self.session.version(key) for key in self._reads})

    def forward(self, arrays: Mapping[str, np.ndarray], steady: Collection[str] = (), into: Mapping[str, np.ndarray] | None = None,
                ) -> tuple[dict[str, np.ndarray], Call]:
        """The pictures by name, and the call to give to `backward`. arrays: each of its value's shape. steady: those that are often the
        same as last time: they are compared with a copy, and what depends on them alone is not computed again. into: arrays of `real` to
        write pictures to. Raises InputError before anything changes."""
        with self.session.alone():
            call = self.at(arrays, steady)
            into = {f"{self.name}.{key}": out for key, out in (into or {}).items()}
            found = self.session.get_all([f"{self.name}.{key}" for key in self.outputs], into)
        return dict(zip(self.outputs, found.values())), call

    def backward(self, call: Call, gradients: Mapping[str, np.ndarray], wanted: Iterable[str] | None = None) -> dict[str, np.ndarray]:
        """By parameter (all, or those wanted), the gradient of what has these gradients by the pictures of a call; of pictures that are
        not named it is zero. What was drawn for the call is used if the session still has it, else drawn again. Raises InputError where an
        array has another shape, NaN or Inf, or where a value that the call was not given has changed since."""
        if unknown := [key for key in gradients if key not in self.outputs]:
            raise InputError(f"vjp {self.name} has no output {unknown[0]!r:.60}; there are: {' '.join(self.outputs)}")
        with self.session.alone():
            version = self.session.version
            moved = [key for key, seen in call.versions.items() if version(key) != seen]
            if lost := [key for key in moved if key not in call.arrays]:
                raise InputError(f"{lost[0]} has changed in the session since {self.name} was called, and was not given to the call, so "
                                 "its gradient is lost; pass it to the call, or ask for gradients before you change it")
            self._set({key: call.arrays[key] for key in moved})
            call.versions.update((key, version(key)) for key in moved)
            missing = [key for key in self.outputs if key not in gradients and self._zero.get(key) != version(self._gradient(key))]
            given = {self._gradient(key): g for key, g in gradients.items()}
            given |= {self._gradient(key): np.zeros(self.outputs[key], self.real) for key in missing}
            self._set(given, [key for key, g in given.items() if np.size(g) <= FEW])  # mostly the 1 by a loss
            self._zero = {key: version(self._gradient(key)) for key in self.outputs if key not in gradients}
            names = list(self.parameters if wanted is None else wanted)
            found = self.session.get_all([self._gradient(key) for key in names])
        return dict(zip(names, found.values()))

    def _set(self, arrays: Mapping[str, np.ndarray], steady: Collection[str] = ()) -> None:
        """Give the session what it does not have."""
        new = {key: array for key, array in arrays.items() if not (key in steady and self._has(key, array))}
        if new:
            self.session.set_all(new)
        for key, array in new.items():
            if key in steady:
                self._seen[key] = self.session.version(key), np.array(array)

    def _has(self, key: str, array: np.ndarray) -> bool:
        """Whether the session has these numbers, to the bit."""
        seen, known = self._seen.get(key, (None, None))
        return (seen == self.session.version(key) and known.dtype == array.dtype and known.shape == array.shape
                and np.array_equal(known.reshape(-1).view(np.uint8), np.ascontiguousarray(array).reshape(-1).view(np.uint8)))
