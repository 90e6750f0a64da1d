"""On the device: load a bundle, set inputs, step, get results.

    with dressi_edge.runtime.load("x.dressi") as s:
        s.set("targets", images)
        s.step(100)
        vertices = s.get("vertices")

Imports the standard library, numpy and msgpack; never the compiler.
"""
from .session import Session, load

__all__ = ["Session", "load"]
