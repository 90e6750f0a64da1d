"""Offline: from a program to a bundle for one device profile, or several. `build` is the compiler, pass by pass."""
from __future__ import annotations

import functools
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from ..cache import bundle as _bundle
from ..cache import vulkan as _v
from ..cache.bundle_check import MAX_VARIANTS as _MAX_VARIANTS
from ..cache.errors import GraphError, InputError, PackError, ProfileError
from ..cache.profile import Profile
from ..cache.progress import tell
from ..cache.spirv_interface import parse
from ..cache.summary import image_bytes
from ..cache.verify import violations
from .backend import dump, spirv
from .backend.allocate import allocate, kept_lists
from .backend.check import Sound, check, check_kinds
from .backend.describe import describe, shaders
from .backend.emit import emit
from .backend.needs import needs
from .backend.rows import wide_rows
from .graph import ops as _ops  # noqa: F401  (fills the op table)
from .graph.program import Program
from .passes.bands import banded
from .passes.blocks import find_blocks, late
from .passes.columns import laid
from .passes.compute import choose as choose_compute
from .passes.compute import find_compute, room
from .passes.domains import find_domains
from .passes.groups import grouped, lowered
from .passes.lists import MIN_TEXELS, find_lists, rows_of
from .passes.ordered import in_order
from .passes.pack import pack
from .passes.plans import PackedPlan, plan_graphs, stored
from .passes.still import find_still
from .passes.store import choose, halve

__all__ = ["Built", "Options", "Program", "build", "compile_program"]


@dataclass(frozen=True)
class Options:
    """How to compile. naive: one function a pass; cache=False: nothing is computed beforehand; stage_packing=False: one substage a pass;
    domains=False: everything is drawn that need not keep what it does not write. These are twins of the same bits, for comparison.
    storage: "half" stores targets and gradients of pixels in 16 bits a channel (docs/numerics.md), "float" does not; by default half
    if all profiles prefer it. compute: what is dispatched instead of drawn, where the profile allows it: "none"; "ops", those that do
    better where workgroups share memory; "pixel", pixelwise work, too, that leaves nothing undrawn; "all", the rest of it, too; by
    default as the profile prefers. The bits are the same.
    sparse_texels: of images of so many texels or more the optimizer updates the touched ones alone, of none where it is None.
    memory: bytes that all images may take, None for any. rows: of lists of texels at the most, None for what the profile allows: lists are
    values, in which variants agree."""

    naive: bool = False
    cache: bool = True
    stage_packing: bool = True
    storage: str | None = None
    memory: int | None = None
    sparse_texels: int | None = MIN_TEXELS
    domains: bool = True
    compute: str | None = None
    rows: int | None = None

    @property
    def lists(self) -> int | None:
        """`sparse_texels`, where lists can be: they are filled by plans of the cache."""
        return self.sparse_texels if self.cache and not self.naive else None


@dataclass(frozen=True)
class Built:
    """description and blobs: the bundle. plans: as packed, with `stages`; shaders: the GLSL of each, ("vert", "frag" or "comp", text)."""

    description: dict
    blobs: list[bytes]
    plans: tuple[PackedPlan, ...]
    shaders: list[tuple[str, str]]

    @property
    def stages(self) -> dict:
        """Plan -> its stages."""
        return {plan.graph.name: plan.stages for plan in self.plans}


def build(program: Program, profile: Profile, options: Options = Options(),  # noqa: B008  (frozen)
          see: Callable[[str, object], None] = dump.nowhere) -> Built:
    """The compiler. Each line is a pass; what it gives is shown to `see` under a name and checked by the verifier of its level. Gradients
    are graph like the rest before it comes here (`graph/autodiff.py`); the first text says which nodes they are. Raises GraphError,
    PackError, ProfileError, InputError, ShaderError."""
    sound = Sound()

    def checked(name: str, value):
        see(name, value)
        tell(f"compiling for {profile.name}: {name}")
        check(value, profile, options.naive, sound)
        return value

    checked("built", program)
    if choose(options.storage, [profile]):
        program = checked("halved", halve(program))
    kind = choose_compute(options.compute, profile)
    groups = checked("simplified", lowered(grouped(program), room(kind, profile)))
    groups = checked("banded", banded(groups, program))
    rows = options.rows or rows_of(profile)
    groups = tuple(laid(group, rows) for group in groups)
    if options.lists is not None:
        for find in (find_lists, find_blocks):
            groups = tuple(find(group, program, rows, options.lists) for group in groups)
    groups = tuple(map(late, groups))
    if options.cache and not options.naive:
        groups = checked("listed", tuple(laid(find_still(group), rows) for group in groups))
        groups = checked("ordered", tuple(in_order(group, program, profile) for group in groups))
    graphs = checked("specialized", plan_graphs(groups, program, options.cache))
    graphs = checked("stored", tuple(stored(plan, program) for plan in graphs))
    packed = [PackedPlan(plan, tuple(pack(plan.roots, profile, options.naive, options.stage_packing))) for plan in graphs]
    packed = [replace(plan, stages=find_domains(plan.graph, plan.stages, options.domains)) for plan in packed]
    packed = checked("packed", tuple(replace(plan, stages=find_compute(plan.stages, profile, kind)) for plan in packed))
    wide = wide_rows(packed, profile)
    places = checked("placed", allocate(program, packed, wide))
    code = [emit(plan.stages, profile, wide) for plan in packed]
    see("shaders", glsl := shaders(code))
    description, blobs = describe(program, packed, code, places, spirv.compile_all(glsl))
    texels = {name: how for group in groups for name, how in group.told.items()}
    description["meta"] = {**program.meta, "functions": {plan.graph.name: dump.functions(plan) for plan in packed},
                           "holds": {plan.graph.name: dump.holds(plan) for plan in packed}}
    if texels:
        description["meta"]["texels"] = texels
    if profile.table_width is not None:
        description["meta"]["table_width"] = profile.table_width
    if "kept" in program.meta:
        lists = list(map(list, kept_lists(packed, places)))
        description["meta"]["kept"] = [{**x, "lists": lists} for x in program.meta["kept"]]
    if options.memory is not None and (size := sum(image_bytes(x) * x["slots"] for x in description["images"])) > options.memory:
        raise InputError(f"the images of the bundle need {size / 1e6:.1f} MB for profile {profile.name}; memory allows "
                         f"{options.memory / 1e6:.1f} MB; use smaller views, a smaller texture, or more memory")
    interfaces = [parse(blobs[k], f"shaders[{n}]") for n, k in enumerate(description["shaders"])]
    grid = any(draw.grid for plan in code for stage in plan for substage in stage for draw in substage.draws)
    description |= {"profile": {"name": profile.name, "digest": profile.digest}, "needs": needs(description, profile, interfaces, grid),
                    "depth_formats": [_v.DEPTH_FORMATS[name] for name in profile.depth_choice()]}
    check_kinds(checked("described", description), packed)
    return Built(description, blobs, packed, glsl)


def compile_program(program: Program, profile: Profile | str | Sequence[Profile | str], path: str | os.PathLike, **options) -> dict:
    """Compile for a profile (or its name) and write the bundle; its description. For a list of profiles, best first, one bundle
    with a variant for each: {"variants": [description]}. options: the fields of `Options`. Raises GraphError, PackError, ProfileError,
    BundleError, InputError."""
    options = Options(**options)
    chosen = [profile] if isinstance(profile, Profile | str | os.PathLike) else profile
    profiles = [p if isinstance(p, Profile) else Profile.load(p) for p in chosen]
    names = [p.name for p in profiles]
    if not 0 < len(names) <= _MAX_VARIANTS:
        raise ProfileError(f"{len(names)} profiles; a bundle is compiled for 1 to {_MAX_VARIANTS}")
    if twice := [name for k, name in enumerate(names) if name in names[:k]]:
        raise ProfileError(f"profile {twice[0]} is given twice; each variant of a bundle needs one of another name")
    if not program.plans:
        raise GraphError("the program has no plan; add one with Program.plan before it is compiled")
    options = replace(options, storage="half" if choose(options.storage, profiles) else "float", rows=min(map(rows_of, profiles)))
    made = [build(program, p, options, dump.watcher(p.name if len(profiles) > 1 else "")) for p in profiles]
    description, blobs = ((made[0].description, made[0].blobs) if len(made) == 1 else
                          _bundle.combine([(x.description, x.blobs) for x in made]))
    for key, extra in program.attached.items():
        for d in description.get("variants", [description]) if extra else ():
            d["meta"] = {**d["meta"], key: {**d["meta"][key], "blobs": list(range(len(blobs), len(blobs) + len(extra)))}}
        blobs = [*blobs, *extra]
    _bundle.write(path, description, blobs, functools.partial(_keeps, profiles))
    return description


def _keeps(profiles: Sequence[Profile], found: _bundle.Bundle) -> None:
    """Raises PackError unless each variant keeps the profile it was made for."""
    for b, p in zip(found.variants, profiles):
        if lines := violations(b.description, p, b.interfaces):
            more = f"; and {len(lines) - 1} more" if len(lines) > 1 else ""
            raise PackError(f"the bundle does not fit the profile it is made for: {lines[0]}{more}; take less, or a profile that allows "
                            "more")
