"""Outputs of a `Scene.vjp` and gradients by parameters for gradients by outputs: which values of a session stand for what.

A bundle has for `vjp("back", ["skin"], color=...)` the output `back.color`, the input `back.color.grad`, and the output `back.skin.grad` of
the plan `back.vjp`. In: anything with the face of a session. Out: what to get and set.
"""
from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from .errors import InputError


def _outputs(session, plan: str) -> list[str]:
    values = session.bundle.description["values"]
    return [values[k]["name"] for k in session.plans[plan]["outputs"]]


def check(session, name: str) -> None:
    """Raises InputError unless the session has gradients of that name."""
    if f"{name}.vjp" not in session.plans or name not in session.plans:
        known = " ".join(plan for plan in session.plans if f"{plan}.vjp" in session.plans) or "none"
        raise InputError(f"{name!r:.60} is no vjp of this bundle; there are: {known}")


def forward(session, name: str) -> dict[str, np.ndarray]:
    """The outputs by their short names. Raises InputError."""
    check(session, name)
    return {key[len(name) + 1:]: session.get(key) for key in _outputs(session, name)}


def backward(session, name: str, gradients: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The gradients by parameter of what has these gradients by output, zero for those that are not given; each of its output's
    shape. Raises InputError before anything changes where one is not so."""
    check(session, name)
    outputs = [key[len(name) + 1:] for key in _outputs(session, name)]
    if unknown := [key for key in gradients if key not in outputs]:
        raise InputError(f"vjp {name} has no output {unknown[0]!r:.60}; there are: {' '.join(outputs)}")
    given = {key: np.asarray(gradients[key]) for key in outputs if key in gradients}
    for key, g in given.items():
        shape = session.shape(f"{name}.{key}.grad")
        if g.shape != shape or g.dtype.kind not in "biuf" or not np.isfinite(g.astype(np.float32)).all():
            raise InputError(f"the gradient by {key} has shape {g.shape}, type {g.dtype}; finite numbers of shape {shape} are needed")
    for key in outputs:
        session.set(f"{name}.{key}.grad", given.get(key, np.zeros(session.shape(f"{name}.{key}.grad"), np.float32)))
    return {key[len(name) + 1:-len(".grad")]: session.get(key) for key in _outputs(session, f"{name}.vjp")}
