"""Device profiles. In: device_profiles/NAME.json (Khronos profile layout and our block). Out: a frozen `Profile`.

A profile states what a device, driver and version allow. What it does not state is the minimum that the Vulkan 1.0
specification requires ("Required Limits" and the mandatory format tables): unknown stays unknown. The compiler packs for
a profile, the runtime compares one with the device at hand; standard library only, for both import it. What its file looks like:
`profile_file.py`; whether it is sound: `profile_check.py`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING

from .errors import ProfileError
from .limits import (
    COMPUTE,
    FEATURES,
    FORMAT_FEATURES,
    FORMATS,
    FROM_VK,
    LIMITS,
    REQUIRED_FEATURES,
    RESOURCES,
    close,
    enough,
    limit_value,
    nearest,
    show,
    stricter,
    text_of,
    typed,
)

if TYPE_CHECKING:  # files, JSON and suggestions are imported where they are used: a session makes do without
    from pathlib import Path

STATUS = ("measured", "specified", "assumed")  # best first
BLOCK = ("description", "tile_bits", "max_merged_attachments", "max_live", "table_width", "heap_bytes", "prefer_fp16", "compute",
         "sources")
TABLE_WIDTHS = (8, 16, 32, 64)


@dataclass(frozen=True)
class Profile:
    """What a device allows. `limits`, `features` and `formats` hold only what is stated; ask `limit`, `feature` and
    `format_has` for the value in force. `tile_bits`: colour bits a pixel that fit in tile memory; `max_merged_attachments`:
    attachments over merged subpasses; `max_live`: 32-bit numbers that a shader may hold at once before its compiler spills them;
    `table_width`: texels a row in which tables are best kept, since narrower rows are padded to about that; None means no such rule is
    known. `heap_bytes`: of the memory that is nearest to the device; None where it is not known. `compute`: what is best dispatched, not
    drawn, one of `limits.COMPUTE`."""

    name: str
    description: str = ""
    limits: Mapping[str, int | float | tuple | bool] = field(default_factory=dict)
    features: Mapping[str, bool] = field(default_factory=dict)
    formats: Mapping[str, frozenset[str]] = field(default_factory=dict)
    tile_bits: int | None = None
    max_merged_attachments: int | None = None
    max_live: int | None = None
    table_width: int | None = None
    heap_bytes: int | None = None
    prefer_fp16: bool = False
    compute: str = "none"
    sources: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    api_version: str = "1.0.0"
    date: str = "1970-01-01"

    def __post_init__(self):
        limits = {k: tuple(v) if isinstance(v, list | tuple) else v for k, v in self.limits.items()}
        sources = {k: MappingProxyType(dict(v)) for k, v in self.sources.items()}
        formats = {k: frozenset(v) for k, v in self.formats.items()}
        frozen = dict(limits=limits, features=dict(self.features), formats=formats, sources=sources)
        for key, value in frozen.items():
            object.__setattr__(self, key, MappingProxyType({k: value[k] for k in sorted(value)}))

    def __hash__(self):
        return hash((self.name, self.digest))

    @classmethod
    def load(cls, name_or_path: str | Path) -> Profile:
        """The profile of that name (`profile_names()`) or in that .json file. ProfileError if unknown or malformed."""
        from .profile_file import parse, read

        text = str(name_or_path)
        if text.endswith(".json") or "/" in text or "\\" in text:
            from pathlib import Path

            return parse(read(Path(text), text), text)
        if text not in (names := profile_names()):
            near = close(text, names, 0.4)
            hint = f"did you mean {near[0]}? " if near else ""
            raise ProfileError(f"profile {text[:80]!r} is unknown; {hint}known: {' '.join(names)}")
        return parse(read(folder() / f"{text}.json", f"{text}.json"), f"{text}.json")

    @classmethod
    def loads(cls, data: bytes | str, where: str = "profile") -> Profile:
        """The profile in this JSON text; `where` names it in errors."""
        from .profile_file import parse

        return parse(data.encode() if isinstance(data, str) else data, where)

    def limit(self, name: str):
        """The value in force of a limit: the stated one or the specification's minimum."""
        if name in self.limits:
            return self.limits[name]
        kind_floor = LIMITS.get(name)
        if kind_floor is None:
            raise ProfileError(f"limit {name!r} is unknown; {nearest(name, LIMITS)}")
        if name == "maxPerStageResources":  # footnote in the specification: the smaller of 128 and this sum
            return min(kind_floor[1], sum(self.limit(k) for k in RESOURCES))
        if name == "maxDrawIndexedIndexValue" and self.feature("fullDrawIndexUint32"):
            return (1 << 32) - 1
        return kind_floor[1]

    def feature(self, name: str) -> bool:
        """Whether the device has a feature; False where nothing is stated and the specification does not require it."""
        if name not in FEATURES:
            raise ProfileError(f"feature {name!r} is unknown; {nearest(name, FEATURES)}")
        return self.features.get(name, name in REQUIRED_FEATURES)

    def format_features(self, name: str) -> frozenset[str]:
        """What an optimally tiled image of this format can do, of: sampled filter color blend depth storage."""
        name = name.removeprefix("VK_FORMAT_")
        if name not in FORMATS:
            raise ProfileError(f"format {name!r} is unknown; {nearest(name, FORMATS)}")
        return self.formats.get(name, FORMATS[name])

    def format_has(self, name: str, *features: str) -> bool:
        """Whether the format has all of these features: `profile.format_has("R32G32_SFLOAT", "blend")`."""
        for f in features:
            if f not in FORMAT_FEATURES:
                raise ProfileError(f"format feature {f!r} is unknown; {nearest(f, FORMAT_FEATURES)}")
        return self.format_features(name) >= set(features)

    def depth_choice(self) -> tuple[str, ...]:
        """Depth formats to try at load, best first. One entry if the profile is certain, else the two of which the
        specification promises at least one."""
        both = ("D32_SFLOAT", "X8_D24_UNORM_PACK32")
        certain = [f for f in both if self.format_has(f, "depth")]
        return (certain[0],) if certain else both

    def source(self, name: str) -> Mapping[str, str]:
        """Where a value comes from: {"source", "status"}; the entry "*" speaks for the values not named."""
        floor = {"source": "Vulkan 1.0 specification, required minimum", "status": "specified"}
        stated = name in self.limits or name in self.features or name in self.formats or name in BLOCK
        return self.sources.get(name, self.sources.get("*", floor)) if stated else floor

    @property
    def digest(self) -> str:
        """SHA-256 of `canonical(self)`, hexadecimal: equal for profiles that the packer cannot tell apart (`heap_bytes` is for
        whoever chooses how many pictures lie on the device, before there is anything to pack)."""
        import json

        text = json.dumps(canonical(self), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()


def folder():
    """Where the profiles are: the package data dressi_edge.device_profiles, or device_profiles/ of the checkout."""
    import importlib.resources
    from pathlib import Path

    try:
        found = importlib.resources.files("dressi_edge.device_profiles")
        if any(f.name.endswith(".json") for f in found.iterdir()):
            return found
    except (ModuleNotFoundError, OSError):
        pass
    return Path(__file__).resolve().parents[2] / "device_profiles"


def profile_names() -> list[str]:
    """The names of the profiles that come with the product, sorted."""
    try:
        return sorted(f.name[:-5] for f in folder().iterdir() if f.name.endswith(".json"))
    except OSError:
        raise ProfileError("no device_profiles folder beside the package; reinstall, or name a .json file") from None


def canonical(profile: Profile) -> dict:
    """All values in force that say how to pack, in plain lists, dicts and numbers, without name, description and sources."""
    return {
        "limits": {k: list(v) if isinstance(v := profile.limit(k), tuple) else v for k in LIMITS},
        "features": {k: profile.feature(k) for k in FEATURES},
        "formats": {k: sorted(profile.format_features(k)) for k in FORMATS},
        "tile_bits": profile.tile_bits,
        "max_merged_attachments": profile.max_merged_attachments,
        **({} if profile.max_live is None else {"max_live": profile.max_live}),
        **({} if profile.table_width is None else {"table_width": profile.table_width}),
        "prefer_fp16": profile.prefer_fp16,
        **({} if profile.compute == "none" else {"compute": profile.compute}),
    }


def merge(profiles: Iterable[Profile], name: str) -> Profile:
    """The intersection: what is allowed on every one of the profiles, in any order. `sources` says whose
    value binds."""
    members = sorted(profiles, key=lambda p: (p.name, p.digest))
    if not members:
        raise ProfileError(f"profile {name!r}: nothing to merge; give at least one profile")
    limits, sources = {}, {}
    for key, (kind, _) in LIMITS.items():
        value = members[0].limit(key)
        for p in members[1:]:
            value = stricter(kind, value, p.limit(key))
        limits[key] = value
        binding = next((p for p in members if p.limits.get(key) == value), None)
        if binding is not None:
            source = binding.source(key)
            sources[key] = {"source": f"{binding.name}: {source['source']}", "status": source["status"]}
    names = " ".join(dict.fromkeys(p.name for p in members))
    worst = max((e["status"] for p in members for e in p.sources.values()), key=STATUS.index, default="specified")
    return Profile(
        name=name, description=f"What is allowed on all of: {names}", limits=limits,
        features={k: all(p.feature(k) for p in members) for k in FEATURES},
        formats={k: frozenset.intersection(*(p.format_features(k) for p in members)) for k in FORMATS},
        tile_bits=min((p.tile_bits for p in members if p.tile_bits is not None), default=None),
        max_merged_attachments=min(
            (p.max_merged_attachments for p in members if p.max_merged_attachments is not None), default=None),
        max_live=min((p.max_live for p in members if p.max_live is not None), default=None),
        table_width=max((p.table_width for p in members if p.table_width is not None), default=None),
        heap_bytes=min((p.heap_bytes for p in members if p.heap_bytes is not None), default=None),
        prefer_fp16=all(p.prefer_fp16 for p in members),
        compute=min((p.compute for p in members), key=COMPUTE.index),
        sources=sources | {"*": {"source": f"merged from {names}", "status": worst}},
        api_version=min((p.api_version for p in members), key=lambda v: tuple(map(int, v.split(".")))),
        date=max(p.date for p in members))


def misfit(needs: Mapping, profile: Profile) -> list[str]:
    """Why `needs` do not fit, one line each; empty if they do. `needs` maps a limit to a value, a feature to
    True, a format to the format features it must have: {"maxColorAttachments": 6, "R32_SFLOAT": ["blend"]}."""
    out, name = [], profile.name
    for key in sorted(needs, key=str):
        need = needs[key]
        plain = str(key).removeprefix("VK_FORMAT_")
        if key in LIMITS:
            kind, have = LIMITS[key][0], profile.limit(key)
            need = limit_value(key, need, f"needs: {key}")
            if kind == "flag":
                out += [f"{key}: needed, {name} has none"] if need and not have else []
            elif not enough(kind, need, have):
                out.append(f"{key}: needs {text_of(need)}, {name} has {text_of(have)}")
        elif key in FEATURES:
            if typed(need, bool, f"needs: {key}") and not profile.feature(key):
                out.append(f"{key}: needed, {name} has none")
        elif plain in FORMATS:
            need = {need} if isinstance(need, str) else set(need) if isinstance(need, Iterable) else {None}
            if not all(isinstance(f, str) for f in need):
                raise ProfileError(f"needs: {plain}: must be a list of format features, found {show(needs[key])}")
            have = profile.format_features(plain)
            if not need <= have:
                out.append(f"{plain}: needs {' '.join(sorted(need))}, {name} has {' '.join(sorted(have)) or 'nothing'}")
        else:
            out.append(f"{str(key)[:60]}: needs {show(need)}, {name} says nothing of it")
    return out


def from_device(limits: Mapping, features: Mapping, formats: Mapping[str, Iterable[str]], name: str, *,
                description: str = "", source: str = "", **own) -> Profile:
    """The profile of a device at hand. Takes all that a driver reports (keys not known here are left out); `formats` maps a
    format to optimal-tiling features, by Vulkan's names or ours; `own` are further fields of Profile."""
    names = {f.removeprefix("VK_FORMAT_"): v for f, v in formats.items()}
    return Profile(
        name=name, description=description,
        limits={k: limit_value(k, _plain(k, limits[k]), f"{name}: {k}") for k in LIMITS if k in limits},
        features={k: bool(features[k]) for k in FEATURES if k in features},
        formats={k: frozenset(FROM_VK.get(f, f) for f in names[k] if f in FROM_VK or f in FORMAT_FEATURES)
                 for k in FORMATS if k in names},
        **{"sources": {"*": {"source": source or f"reported by the driver of {name}", "status": "measured"}}, **own})


def _plain(name: str, value):
    """A limit as a driver gives it (VkBool32, C array) in Python's types."""
    kind = LIMITS[name][0]
    return bool(value) if kind == "flag" else tuple(value) if kind in ("size", "range") else value
