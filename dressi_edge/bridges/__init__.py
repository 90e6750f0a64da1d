"""Into other people's loops: what PyTorch, JAX and SciPy need of a session, in NumPy. docs/bridges.md."""
from .pure import Call, Pure

__all__ = ["Call", "Pure"]
