"""Outputs of a `Scene.vjp` and gradients by parameters for gradients by outputs: which values of a session stand for what.

A bundle has for `vjp("back", ["skin"], color=...)` the output `back.color`, the input `back.color.grad`, and the output `back.skin.grad` of
the plan `back.vjp`. In: anything with the face of a session. Out: what to get and set.
"""
from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from .errors import InputError


def outputs(session, plan: str) -> list[str]:
    """The names of the values that a plan gives out."""
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
    return {key[len(name) + 1:]: array for key, array in session.get_all(outputs(session, name)).items()}


def backward(session, name: str, gradients: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The gradients by parameter of what has these gradients by output, zero for those that are not given; each of its output's
    shape. Raises InputError before anything changes where one is not so."""
    check(session, name)
    keys = [key[len(name) + 1:] for key in outputs(session, name)]
    if unknown := [key for key in gradients if key not in keys]:
        raise InputError(f"vjp {name} has no output {unknown[0]!r:.60}; there are: {' '.join(keys)}")
    given = {key: np.asarray(gradients[key]) for key in keys if key in gradients}
    for key, g in given.items():
        shape = session.shape(f"{name}.{key}.grad")
        if g.shape != shape or g.dtype.kind not in "biuf" or not np.isfinite(g.astype(np.float32)).all():
            raise InputError(f"the gradient by {key} has shape {g.shape}, type {g.dtype}; finite numbers of shape {shape} are needed")
    session.set_all({f"{name}.{key}.grad": given.get(key, np.zeros(session.shape(f"{name}.{key}.grad"), np.float32)) for key in keys})
    return {key[len(name) + 1:-len(".grad")]: array for key, array in session.get_all(outputs(session, f"{name}.vjp")).items()}
