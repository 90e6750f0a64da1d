"""The ops, by family. Importing this package fills the table."""
# ruff: noqa: F401
from .. import operators
from . import (
    arithmetic,
    bins,
    compact,
    contour,
    half,
    inverse_uv,
    join,
    leaf,
    lookup,
    matrix,
    mip_gradient,
    mips,
    packed,
    pixels,
    raster,
    reduce,
    scan,
    soft,
    stencil,
    tables,
    texture,
    texture_gradient,
    transcendental,
    vector,
)
