"""The file of a profile. In: JSON in the layout of Khronos profiles with a block of ours, or what vulkaninfo and gpuinfo.org write. Out: a
`Profile`; and the file of one, the same bytes whenever it is written."""

from __future__ import annotations

import errno
import os
import re

from .errors import ProfileError
from .files import read_regular
from .limits import COMPUTE, FEATURES, FORMAT_FEATURES, FORMATS, FROM_VK, LIMITS, an_object, limit_value, nearest, number, show, typed
from .profile import BLOCK, STATUS, TABLE_WIDTHS, Profile, from_device

SCHEMA = "https://schema.khronos.org/vulkan/profiles-0.8-latest.json#"
MAX_FILE_BYTES = 1 << 20


def read(path, where: str) -> bytes:
    """The bytes of a file, or of a resource of the package, of at most `MAX_FILE_BYTES`. Raises ProfileError."""
    try:
        if isinstance(path, os.PathLike):
            return read_regular(path, MAX_FILE_BYTES)
        return path.read_bytes()  # of a package in an archive
    except OSError as e:
        if e.errno == errno.EFBIG:
            raise ProfileError(f"{where}: larger than {MAX_FILE_BYTES} bytes, the most a profile may have") from None
        raise ProfileError(f"{where}: cannot be read: {e.strerror}") from None


def decode(data: bytes, where: str) -> dict:
    """The object in a JSON text, each key once. Raises ProfileError."""
    import json

    def unique(pairs):
        if len(out := dict(pairs)) < len(pairs):
            keys = [k for k, _ in pairs]
            raise ValueError(f"key {next(k for k in keys if keys.count(k) > 1)[:60]!r} appears twice")
        return out

    def constant(word):
        raise ValueError(f"{word} is not a number of JSON")

    try:
        value = json.loads(data.decode("utf-8"), object_pairs_hook=unique, parse_constant=constant)
    except (ValueError, RecursionError) as e:
        why = "nested too deeply" if isinstance(e, RecursionError) else str(e).partition("\n")[0][:200]
        raise ProfileError(f"{where}: not JSON: {why}") from None
    return an_object(value, where)


def parse(data: bytes, where: str) -> Profile:
    """The profile in this text; `where` names it in errors."""
    top = an_object(decode(data, where), where, ("$schema", "capabilities", "profiles", "dressi_edge"), True)
    if not typed(top["$schema"], str, f"{where}: $schema").startswith("https://schema.khronos.org/vulkan/profiles-"):
        raise ProfileError(f"{where}: $schema: must be a Khronos profile schema such as {SCHEMA}, found "
                           f"{show(top['$schema'])}")
    capabilities, profiles = an_object(top["capabilities"], f"{where}: capabilities"), an_object(top["profiles"], f"{where}: profiles")
    if len(capabilities) != 1:
        raise ProfileError(f"{where}: capabilities: must hold one entry, the device, found {len(capabilities)}")
    (name, block), = capabilities.items()
    if not re.fullmatch(r"[a-z0-9_]{1,64}", name):
        raise ProfileError(f"{where}: capabilities: a name has 1 to 64 of a-z, 0-9 and _, found {show(name)}")
    an_object(block, f"{where}: {name}", ("properties", "features", "formats"))
    at = f"{where}: VkPhysicalDeviceProperties"
    properties = an_object(block.get("properties", {}), f"{where}: properties", ("VkPhysicalDeviceProperties",))
    limits = an_object(properties.get("VkPhysicalDeviceProperties", {}), at, ("limits",)).get("limits", {})
    limits = {k: limit_value(k, v, f"{where}: {k}") for k, v in an_object(limits, f"{where}: limits", LIMITS).items()}

    features = {}
    for struct, members in an_object(block.get("features", {}), f"{where}: features", sorted(set(FEATURES.values()))).items():
        allowed = [f for f, s in FEATURES.items() if s == struct]
        for k, v in an_object(members, f"{where}: {struct}", allowed).items():
            features[k] = typed(v, bool, f"{where}: {k}")

    formats = {}
    known = [f"VK_FORMAT_{f}" for f in FORMATS]
    for k, v in an_object(block.get("formats", {}), f"{where}: formats", known).items():
        kinds = ("linearTilingFeatures", "optimalTilingFeatures", "bufferFeatures")
        v = an_object(an_object(v, f"{where}: {k}", ("VkFormatProperties",), True)["VkFormatProperties"], f"{where}: {k}", kinds, True)
        for kind, flags in v.items():
            for flag in typed(flags, list, f"{where}: {k}: {kind}"):
                if typed(flag, str, f"{where}: {k}: {kind}") not in FROM_VK or kind != "optimalTilingFeatures":
                    raise ProfileError(f"{where}: {k}: {kind}: unknown flag {flag[:60]!r}; {nearest(flag, FROM_VK)}")
        formats[k.removeprefix("VK_FORMAT_")] = frozenset(FROM_VK[f] for f in v["optimalTilingFeatures"])

    about = an_object(profiles.get(_profile_key(name)), f"{where}: profiles: {_profile_key(name)}")
    if len(profiles) != 1 or about.get("capabilities") != [name]:
        raise ProfileError(f"{where}: profiles: must hold only {_profile_key(name)}, of the capabilities [{name!r}]")
    version = typed(about.get("api-version"), str, f"{where}: api-version")
    history = about.get("history")
    date = history[-1].get("date") if isinstance(history, list) and history and isinstance(history[-1], dict) else None
    if not re.fullmatch(r"\d{1,4}\.\d{1,4}\.\d{1,6}", version) or not re.fullmatch(r"\d{4}-\d\d-\d\d", typed(
            date, str, f"{where}: history: date")):
        raise ProfileError(f"{where}: api-version must be like 1.1.0 and a date like 2025-01-31, "
                           f"found {show(version)} and {show(date)}")
    return Profile(name=name, limits=limits, features=features, formats=formats, api_version=version, date=date,
                   **_own(top["dressi_edge"], f"{where}: dressi_edge"))


def _own(block, where: str) -> dict:
    block = an_object(block, where, BLOCK)
    out = {}
    for k, v in block.items():
        at = f"{where}: {k}"
        if k in ("tile_bits", "max_merged_attachments", "max_live", "heap_bytes"):
            out[k] = None if v is None else number(v, at, 1)
        elif k == "table_width":
            if v is not None and number(v, at) not in TABLE_WIDTHS:
                raise ProfileError(f"{at}: must be one of {' '.join(map(str, TABLE_WIDTHS))}, or null, found {show(v)}")
            out[k] = v
        elif k == "prefer_fp16":
            out[k] = typed(v, bool, at)
        elif k == "compute":
            if (word := typed(v, str, at)) not in COMPUTE:
                raise ProfileError(f"{at}: must be one of {' '.join(COMPUTE)}, found {show(word)}")
            out[k] = word
        elif k == "description":
            out[k] = typed(v, str, at)
        else:
            out[k] = an_object(v, at, ("*", *LIMITS, *FEATURES, *FORMATS, *BLOCK[:-1]))
            for name, entry in out[k].items():
                an_object(entry, f"{at}: {name}", ("source", "status"), True)
                if typed(entry["status"], str, f"{at}: {name}: status") not in STATUS:
                    raise ProfileError(f"{at}: {name}: status must be one of {' '.join(STATUS)}, "
                                       f"found {show(entry['status'])}")
                typed(entry["source"], str, f"{at}: {name}: source")
    return out


def _profile_key(name: str) -> str:
    return f"VP_DRESSI_{name}"


def to_json(profile: Profile) -> str:
    """The file of a profile: sorted, two spaces, one newline at the end. Loading and writing it again gives the same bytes."""
    import json

    structs = {}
    for name, on in profile.features.items():
        structs.setdefault(FEATURES[name], {})[name] = on
    capability = {}
    if profile.limits:
        capability["properties"] = {"VkPhysicalDeviceProperties": {"limits": {
            k: list(v) if isinstance(v, tuple) else v for k, v in profile.limits.items()}}}
    if structs:
        capability["features"] = {k: structs[k] for k in sorted(structs)}
    if profile.formats:
        capability["formats"] = {f"VK_FORMAT_{k}": {"VkFormatProperties": {
            "linearTilingFeatures": [], "optimalTilingFeatures": sorted(FORMAT_FEATURES[f] for f in v), "bufferFeatures": []}}
            for k, v in profile.formats.items()}
    own = {k: getattr(profile, k) for k in BLOCK[:-1]
           if (k != "compute" or profile.compute != "none") and (k not in ("table_width", "heap_bytes") or getattr(profile, k) is not None)}
    own["sources"] = {k: dict(v) for k, v in profile.sources.items()}
    about = {"version": 1, "api-version": profile.api_version, "label": profile.name, "description": profile.description,
             "contributors": {}, "history": [{"revision": 1, "date": profile.date, "author": "dressi_edge", "comment": ""}],
             "capabilities": [profile.name]}
    top = {"$schema": SCHEMA, "capabilities": {profile.name: capability}, "profiles": {_profile_key(profile.name): about},
           "dressi_edge": own}
    text = json.dumps(top, indent=2, ensure_ascii=False)
    # one flag or one pair of numbers a line would make the files five times as long
    return re.sub(r"\[\s+([^][{}]*?)\s+\]", lambda m: "[" + re.sub(r",\s+", ", ", m[1]) + "]", text) + "\n"


def from_khronos(data: bytes | str, name: str, **own) -> Profile:
    """The profile in a file of vulkaninfo --json or gpuinfo.org: like `from_device`, from all its capabilities together."""
    top = decode(data.encode() if isinstance(data, str) else data, name)
    limits, features, formats = {}, {}, {}
    for block in an_object(top.get("capabilities"), f"{name}: capabilities").values():
        block = an_object(block, f"{name}: capabilities")
        properties = an_object(block.get("properties", {}), f"{name}: properties").get("VkPhysicalDeviceProperties", {})
        limits |= an_object(an_object(properties, f"{name}: properties").get("limits", {}), f"{name}: limits")
        for members in an_object(block.get("features", {}), f"{name}: features").values():
            features |= an_object(members, f"{name}: features")
        for k, v in an_object(block.get("formats", {}), f"{name}: formats").items():
            formats[k] = an_object(an_object(v, k).get("VkFormatProperties", {}), k).get("optimalTilingFeatures", [])
    return from_device(limits, features, formats, name, **own)
