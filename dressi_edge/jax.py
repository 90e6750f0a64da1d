"""JAX: a `Scene.vjp` of a session as a function that `jax.grad`, `jax.jit` and `jax.vmap` take. docs/bridges.md.

    render = dressi_edge.jax.function(runtime.load("render.dressi"))
    loss = lambda x: jnp.square(render(vertices=x)["color"] - photo).mean()
    slope = jax.jit(jax.grad(loss))(x)

In: arrays. Out: arrays of float32 (of a `ReferenceSession` float64 where JAX has that switched on). The device is called back from what JAX
compiles (`pure_callback`), so it draws outside of JAX's own devices; under `vmap` one picture after another. JAX is needed
(`pip install 'dressi_edge[jax]'`); the runtime does not import this module.
"""
from __future__ import annotations

from collections.abc import Callable, Mapping

import jax
import jax.numpy as jnp
import numpy as np

from .bridges.pure import Pure
from .cache.errors import InputError

__all__ = ["function"]


def function(session, name: str | None = None) -> Callable[..., dict[str, jax.Array]]:
    """`f(vertices=x)` gives pictures by name; what is not given is as the session has it when it runs, and must stay so until gradients
    are computed. Gradients are those of parameters; of other inputs they are zero. session: an open one, or a `Pure`; name: of the vjp,
    where there are several. Raises InputError."""
    pure = session if isinstance(session, Pure) else Pure(session, name)
    real = jnp.zeros(0, pure.real).dtype

    def types(shapes: Mapping[str, tuple[int, ...]]) -> dict[str, jax.ShapeDtypeStruct]:
        return {key: jax.ShapeDtypeStruct(shape, real) for key, shape in shapes.items()}

    def draw(arrays):
        return _typed(pure.forward(_host(arrays), arrays.keys())[0], real)

    def transpose(arrays, gradients):
        with pure.session.alone():
            call = pure.at(_host(arrays), arrays.keys())  # mostly what was drawn last: then nothing is drawn again
            return _typed(pure.backward(call, _host(gradients), [key for key in pure.parameters if key in arrays]), real)

    @jax.custom_vjp
    def render(arrays):
        return jax.pure_callback(draw, types(pure.outputs), arrays, vmap_method="sequential")

    def backward(arrays, gradients):
        own = {key: pure.parameters[key] for key in arrays if key in pure.parameters}
        found = jax.pure_callback(transpose, types(own), arrays, gradients, vmap_method="sequential") if own else {}
        return {key: found[key] if key in found else _nothing(x) for key, x in arrays.items()},

    render.defvjp(lambda arrays: (render(arrays), arrays), backward)

    def call(**arrays) -> dict[str, jax.Array]:
        pure.check(arrays)
        given = {key: jnp.asarray(x) for key, x in arrays.items()}
        for key, x in given.items():
            if x.shape != pure.given[key]:
                raise InputError(f"{key} has shape {x.shape}; {pure.given[key]} is needed (jax.vmap draws several)")
            if jnp.issubdtype(x.dtype, jnp.complexfloating):
                raise InputError(f"{key} is of {x.dtype}; real numbers are needed")
        return render({key: x.astype(real) if jnp.issubdtype(x.dtype, jnp.floating) else x for key, x in given.items()})

    call.pure = pure
    return call


def _host(arrays: Mapping) -> dict[str, np.ndarray]:
    return {key: np.asarray(x) for key, x in arrays.items()}


def _typed(arrays: Mapping[str, np.ndarray], real) -> dict[str, np.ndarray]:
    return {key: np.asarray(x, real) for key, x in arrays.items()}


def _nothing(x: jax.Array):
    """The gradient of what has none."""
    return jnp.zeros_like(x) if jnp.issubdtype(x.dtype, jnp.floating) else np.zeros(x.shape, jax.dtypes.float0)
