"""What long work is at, told to whoever listens: a compiler's passes, a driver's pipelines.

In: `tell("pipelines", 3, 80)` from wherever it happens. Out: calls of the function given to `listening`, in the same thread. Nobody
listens by default, and then nothing happens.
"""
from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from contextvars import ContextVar

Listener = Callable[[str, int, int], None]

_listener: ContextVar[Listener | None] = ContextVar("listener", default=None)


def tell(what: str, done: int = 0, total: int = 0) -> None:
    """`what` begins, or is `done` of `total` through (0: it cannot be counted)."""
    if (listener := _listener.get()) is not None:
        listener(what, done, total)


@contextlib.contextmanager
def listening(listener: Listener) -> Iterator[None]:
    """Calls `listener(what, done, total)` for all that is told in here."""
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)
