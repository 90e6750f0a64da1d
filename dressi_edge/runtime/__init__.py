"""On the device: load a bundle, set inputs, step, get results.

    with dressi_edge.runtime.load("x.dressi") as s:
        s.set("targets", images)
        s.step(100)
        vertices = s.get("vertices")

Imports the standard library, numpy and msgpack; never the compiler.
"""
TYPE_CHECKING = False  # as typing.TYPE_CHECKING, whose module takes milliseconds
if TYPE_CHECKING:
    from .session import Session, load

__all__ = ["Session", "load"]


def __getattr__(name: str):
    """Session and load when first asked for: the binding and the list of devices need the standard library alone."""
    if name in __all__:
        from . import session

        return getattr(session, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
