"""Offline: from a problem to a bundle for one device profile.

    graph -> differentiate -> simplify -> specialize (what is clean) -> pack -> plan -> GLSL -> SPIR-V -> bundle
"""
from __future__ import annotations

import os

from ..cache import bundle as _bundle
from ..cache import vulkan as _v
from ..cache.profile import Profile
from . import ops as _ops  # noqa: F401  (fills the op table)
from .inspect import count_functions, trace
from .needs import needs
from .plan import Assembler
from .program import Program

__all__ = ["Program", "compile_program", "describe"]


def describe(program: Program, profile: Profile, *, naive: bool = False, cache: bool = True,
             stage_packing: bool = True) -> tuple[dict, Assembler]:
    """The bundle's description without blobs, and the assembler that holds them and the stages."""
    assembler = Assembler(program, profile, naive, cache, stage_packing)
    description = assembler.assemble()
    description["meta"] = {**program.meta, "functions": count_functions(assembler)}
    description["profile"] = {"name": profile.name, "digest": profile.digest}
    description["needs"] = needs(description)
    description["depth_formats"] = [_v.DEPTH_FORMATS[name] for name in profile.depth_choice()]
    return description, assembler


def compile_program(program: Program, profile: Profile | str, path: str | os.PathLike, *, naive: bool = False,
                    cache: bool = True, stage_packing: bool = True) -> dict:
    """Compile for a profile (or its name) and write the bundle; its description. `naive`: one function a pass; `cache=False`: no
    reactive cache; `stage_packing=False`: one substage a pass. Raises GraphError, PackError, ProfileError, BundleError."""
    if not isinstance(profile, Profile):
        profile = Profile.load(profile)
    description, assembler = describe(program, profile, naive=naive, cache=cache, stage_packing=stage_packing)
    trace(description, assembler)
    _bundle.write(path, description, assembler.blobs)
    return description
