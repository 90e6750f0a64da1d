"""The ops, by family. Importing this package fills the table."""
from . import arithmetic, compact, half, inverse_uv, join, leaf, lookup, raster, reduce, texture, texture_gradient, vector  # noqa: F401
