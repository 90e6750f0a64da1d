"""What a problem will need of a device that is known before anything is built or compiled, in the words of the job.

In: numbers of views, vertices and pixels, and the profiles to compile for. Out: nothing, or an InputError that says what is too large,
for which profile, what it allows, and what helps.
"""
from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence

from ...cache.bundle import MAX_FILE_BYTES
from ...cache.errors import InputError
from ...cache.layout import MAX_TABLE_ROWS, table_size
from ...cache.profile import Profile
from ..graph.ir import topological
from ..graph.ops.texture_sort import MAX_PIXELS
from ..graph.program import Program
from ..io.images import MAX_PIXELS as MAX_TEXELS
from ..render.atlas import Atlas
from .targets import at_once

BYTES_PER_PIXEL = 110  # of all views together, at the peak of a compilation: measured for 4 to 18 million pixels
BYTES_PER_TEXEL = 16  # in a bundle


def profiles_of(given: Profile | str | os.PathLike | Sequence[Profile | str]) -> list[Profile]:
    """The profiles that are meant by one or several, or their names. Raises ProfileError."""
    several = [given] if isinstance(given, Profile | str | os.PathLike) else given
    return [p if isinstance(p, Profile) else Profile.load(p) for p in several]


def side(profile: Profile) -> tuple[int, int]:
    """The largest image (width, height) that a profile lets be drawn into and read."""
    limit, viewport = profile.limit, profile.limit("maxViewportDimensions")
    return (min(limit("maxImageDimension2D"), limit("maxFramebufferWidth"), viewport[0]),
            min(limit("maxImageDimension2D"), limit("maxFramebufferHeight"), viewport[1]))


def entries(profile: Profile) -> int:
    """The longest table that a profile allows."""
    width, height = side(profile)
    return (1 << width.bit_length() - 1) * min(height, MAX_TABLE_ROWS)


def fits_views(profiles: Sequence[Profile]) -> Callable[[int, int, int], None]:
    """A check of n views of width x height for all of the profiles: they lie side by side in one image."""
    def check(count: int, width: int, height: int) -> None:
        extent = Atlas.of(width, height, count).extent
        what = f"{count} view{'s' if count > 1 else ''} of {width}x{height}"
        for profile in profiles:
            across, down = side(profile)
            if extent.width > across or extent.height > down:
                scale = max(min(across / (c * width), down / (-(-count // c) * height)) for c in range(1, count + 1))
                small, fewer = (int(width * scale), int(height * scale)), (across // width) * (down // height)
                help_ = [f"at most {fewer} view{'s' if fewer > 1 else ''}"] if fewer else []
                help_ += [f"views.size = [{small[0]}, {small[1]}] or smaller"] if min(small) > 0 else []
                needs = "lie side by side in one image" if count > 1 else "needs an image"
                raise InputError(f"{what} {needs} of {extent.width}x{extent.height}; profile {profile.name} allows {across}x{down}; "
                                 f"use {' or '.join(help_) or 'fewer and smaller views'}"
                                 + (", or views.order = \"shuffle\" or \"accumulate\": one at a time on the device" if count > 1 else ""))
        _fits_host(what, count * width * height)
    return check


def _fits_host(what: str, pixels: int) -> None:
    size = pixels * BYTES_PER_TEXEL
    if size > MAX_FILE_BYTES:
        raise InputError(f"{what} are {size / 1e9:.1f} GB in a bundle; at most {MAX_FILE_BYTES / 1e9:.1f} GB are allowed; use fewer or "
                         "smaller views")
    try:
        memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, OSError, ValueError):
        return
    if pixels * BYTES_PER_PIXEL > memory:
        raise InputError(f"{what} need about {pixels * BYTES_PER_PIXEL / 1e9:.1f} GB of memory to be compiled; this machine has "
                         f"{memory / 1e9:.1f} GB; use fewer or smaller views")


def fits_scene(profiles: Sequence[Profile], views: int, pixels: int, order: str, vertices: int, faces: int,
               texture: tuple[int, int] | None, optimized: Iterable[str] = (), texture_grad: str = "exact") -> None:
    """Checks a mesh of so many vertices and faces, its texture (width, height) if it is drawn with one, and `views` of `pixels` each, drawn
    all at once with order "batch", for all of the profiles. optimized: the parameters that phases optimize. Raises InputError."""
    at_once = views if order == "batch" else 1
    one_by_one = "set views.order = \"cycle\" or \"shuffle\", or " if at_once > 1 else ""
    drawn = f"{views} views of {vertices} vertices"
    rows = [(vertices * views, drawn, "use fewer views or vertices"), (faces, f"{faces} faces", "use fewer faces")]
    if texture is not None and texture[0] * texture[1] > MAX_TEXELS:
        raise InputError(f"a texture of {texture[0]}x{texture[1]}; at most {MAX_TEXELS} texels are allowed, such as 8192x8192; "
                         "scale it down")
    if texture is not None and "texture" in optimized and texture_grad == "exact":
        lookups = at_once * pixels
        what = f"a texture that is fitted to {at_once} view{'s' if at_once > 1 else ''} of {pixels} pixels at a time"
        if lookups > MAX_PIXELS:
            raise InputError(f"{what}: {lookups} pixels; at most {MAX_PIXELS} are allowed; {one_by_one}use smaller views")
        rows.append((4 * lookups, f"{what}, four texels each,", f"{one_by_one}use smaller views"))
    for profile in profiles:
        across, down = side(profile)
        if texture is not None and (texture[0] > across or texture[1] > down):
            raise InputError(f"a texture of {texture[0]}x{texture[1]}; profile {profile.name} allows {across}x{down}; scale it down")
        for count, what, help_ in rows:
            if count > (most := entries(profile)):
                raise InputError(f"{what} need a table of {count} entries; profile {profile.name} allows {most}; {help_}")


def fits(problem, profiles: Sequence[Profile]) -> None:
    """Checks all of a `Problem` that is known before anything is compiled. Raises InputError."""
    views, pixels = len(problem.cameras), problem.width * problem.height
    drawn = at_once(problem.order, views, problem.width, problem.height, problem.whole)
    fits_views(profiles)(drawn, problem.width, problem.height)
    texture = problem.program.values.get("texture")
    optimized = {name for spec in problem.program.plans for name in spec.updates}
    fits_scene(profiles, drawn, pixels, problem.order, len(problem.mesh.positions), len(problem.mesh.faces),
               None if texture is None else texture.layout.size, optimized, problem.texture_grad)
    fits_program(problem.program, profiles, f"{views} views of {problem.width}x{problem.height} and {len(problem.mesh.faces)} faces")


def fits_program(program: Program, profiles: Sequence[Profile], what: str) -> None:
    """Checks every image of a program's values and graph. what: what it is made of, for errors. Raises InputError."""
    for name, value in program.values.items():
        width, height = value.layout.size
        for profile in profiles:
            across, down = side(profile)
            if value.layout.kind == "image" and (width > across or height > down):
                raise InputError(f"{name} has {width}x{height} texels; profile {profile.name} allows {across}x{down}; scale it down")
    for node in topological([node for spec in program.plans for node in (*spec.updates.values(), *spec.outputs.values())]):
        for profile in profiles:
            across, down = side(profile)
            if node.extent.width > across or node.extent.height > down:
                extent = node.extent
                table = (extent.width, extent.height) == table_size(extent.count)
                raise InputError(f"{what} need {f'a table of {extent.count} entries' if table else 'an image'}, "
                                 f"{extent.width}x{extent.height} in {node.op.name}; profile {profile.name} allows {across}x{down}; "
                                 "use fewer or smaller views, or fewer faces")
