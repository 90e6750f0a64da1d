"""Offline: from a problem to a bundle for one device profile.

    graph -> differentiate -> store in half -> simplify -> specialize (what is clean) -> pack -> plan -> GLSL -> SPIR-V -> bundle
"""
from __future__ import annotations

import os
from collections.abc import Sequence

from ..cache import bundle as _bundle
from ..cache import vulkan as _v
from ..cache.bundle_check import MAX_VARIANTS as _MAX_VARIANTS
from ..cache.errors import ProfileError
from ..cache.profile import Profile
from .backend.assembler import Assembler
from .backend.inspect import count_functions, trace
from .backend.needs import needs
from .graph import ops as _ops  # noqa: F401  (fills the op table)
from .graph.program import Program
from .passes.lists import MIN_TEXELS
from .passes.store import choose, halve

__all__ = ["Program", "compile_program", "describe"]


def describe(program: Program, profile: Profile, *, naive: bool = False, cache: bool = True, stage_packing: bool = True,
             storage: str | None = None, sparse_texels: int | None = MIN_TEXELS) -> tuple[dict, Assembler]:
    """The bundle's description without blobs, and the assembler that holds them and the stages."""
    if choose(storage, [profile]):
        program = halve(program)
    assembler = Assembler(program, profile, naive, cache, stage_packing, sparse_texels)
    description = assembler.assemble()
    description["meta"] = {**program.meta, "functions": count_functions(assembler)}
    if assembler.texels:
        description["meta"]["texels"] = assembler.texels
    description["profile"] = {"name": profile.name, "digest": profile.digest}
    description["needs"] = needs(description)
    description["depth_formats"] = [_v.DEPTH_FORMATS[name] for name in profile.depth_choice()]
    return description, assembler


def compile_program(program: Program, profile: Profile | str | Sequence[Profile | str], path: str | os.PathLike, *,
                    naive: bool = False, cache: bool = True, stage_packing: bool = True, storage: str | None = None,
                    sparse_texels: int | None = MIN_TEXELS) -> dict:
    """Compile for a profile (or its name) and write the bundle; its description. For a list of profiles, best first, one bundle
    with a variant for each: {"variants": [description]}. `naive`: one function a pass; `cache=False`: no reactive cache;
    `stage_packing=False`: one substage a pass. `storage`: "half" stores targets and gradients of pixels in 16 bits a channel
    (docs/numerics.md), "float" does not; by default half if all profiles prefer it. `sparse_texels`: of images of so many texels or
    more the optimizer updates the touched ones alone, of none where it is None. Raises GraphError, PackError, ProfileError,
    BundleError, InputError."""
    chosen = [profile] if isinstance(profile, Profile | str | os.PathLike) else profile
    profiles = [p if isinstance(p, Profile) else Profile.load(p) for p in chosen]
    names = [p.name for p in profiles]
    if not 0 < len(names) <= _MAX_VARIANTS:
        raise ProfileError(f"{len(names)} profiles; a bundle is compiled for 1 to {_MAX_VARIANTS}")
    if twice := [name for k, name in enumerate(names) if name in names[:k]]:
        raise ProfileError(f"profile {twice[0]} is given twice; each variant of a bundle needs one of another name")
    storage = "half" if choose(storage, profiles) else "float"
    made = []
    for p in profiles:
        description, assembler = describe(program, p, naive=naive, cache=cache, stage_packing=stage_packing, storage=storage,
                                          sparse_texels=sparse_texels)
        trace(description, assembler, p.name if len(profiles) > 1 else "")
        made.append((description, assembler.blobs))
    description, blobs = made[0] if len(made) == 1 else _bundle.combine(made)
    _bundle.write(path, description, blobs)
    return description
