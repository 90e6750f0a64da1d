"""The ops, by family. Importing this package fills the table."""
from . import arithmetic, leaf, lookup, raster, reduce, texture, vector  # noqa: F401
