"""`profiles`: list, show, check, merge, capture."""
from __future__ import annotations

import sys

from ..cache.errors import ProfileError
from ..cache.limits import FORMAT_FEATURES, FORMATS
from ..cache.profile import TABLE_WIDTHS, Profile, from_device, merge, profile_names
from ..cache.profile_check import check
from ..cache.profile_file import to_json
from .files import check_folder, print_json, write_file

SAMPLE = 1 << 14  # entries


def list_all(args) -> None:
    """The profiles that come with the product."""
    profiles = [Profile.load(name) for name in profile_names()]
    if args.json:
        print_json({p.name: {"description": p.description, "date": p.date, "digest": p.digest} for p in profiles})
        return
    for p in profiles:
        print(f"{p.name:22} {p.limit('maxPerStageDescriptorInputAttachments'):>10} input, "
              f"{p.limit('maxColorAttachments')} colour attachments  {p.description}")


def show(args) -> None:
    """A profile's file."""
    sys.stdout.write(to_json(Profile.load(args.profile)))


def check_all(args) -> None:
    """What is wrong with profiles."""
    lines = [(name, line) for name in args.profile or profile_names() for line in check(Profile.load(name))]
    faults = [line for _, line in lines if not line.startswith("note: ")]
    for _, line in lines:
        print(line)
    if faults:
        raise ProfileError(f"{len(faults)} faults; the first: {faults[0]}")
    print(f"OK {' '.join(args.profile or profile_names())}")


def merge_all(args) -> None:
    """What all of some profiles allow."""
    _give(merge([Profile.load(name) for name in args.profile], _named(args.name)), args.output)


def capture(args) -> None:
    """The profile of the device at hand."""
    import datetime

    from ..runtime import vk
    from ..runtime.device import Device
    name = _named(args.name)
    if args.output:
        check_folder(args.output)
    with Device.open(args.device) as device:
        bits = {flag: getattr(vk, flag) for flag in _format_flags()}
        formats = {}
        for short in FORMATS:
            found = device.format_features(getattr(vk, f"VK_FORMAT_{short}"))[1]
            formats[short] = [flag for flag, bit in bits.items() if found & bit]
        day = datetime.date.today().isoformat()
        profile = from_device(device.limits, device.features, formats, name,
                              description=f"{device.name}, {device.driver}, as found",
                              source=f"reported by {device.driver} for {device.name}, {day}", date=day,
                              api_version=".".join(map(str, device.api_version)), table_width=table_width(device), heap_bytes=heap(device))
    _give(profile, args.output)


def heap(device) -> int | None:
    """Bytes of the largest memory that is the device's own."""
    return max(device.local_heaps, default=None)


def table_width(device) -> int | None:
    """Texels a row from which on this driver does not pad a table of `SAMPLE` vec4s to more than half as much again; None for 4 texels, as
    wide as tables are by themselves. Nothing is allocated."""
    from ..cache.layout import table_size
    from ..cache.vulkan import FORMATS, TEXEL_BYTES, USAGE_COLOR, USAGE_SAMPLED, USAGE_TRANSFER_DST
    from ..runtime.memory import requirements
    own, _ = table_size(SAMPLE)
    number = FORMATS["R32G32B32A32_SFLOAT"]
    for width in (own, *TABLE_WIDTHS):
        record = {"format": number, "width": width, "height": SAMPLE // width, "usage": USAGE_COLOR | USAGE_SAMPLED | USAGE_TRANSFER_DST}
        if 2 * requirements(device, record).size <= 3 * SAMPLE * TEXEL_BYTES[number]:
            break
    return None if width == own else width


def _format_flags() -> tuple[str, ...]:
    return tuple(FORMAT_FEATURES.values())


def _named(name: str) -> str:
    import re
    if not re.fullmatch(r"[a-z0-9_]{1,64}", name):
        raise ProfileError(f"profile name {name!r:.80}: 1 to 64 of a-z, 0-9 and _ are allowed")
    return name


def _give(profile: Profile, path: str | None) -> None:
    if path is None:
        sys.stdout.write(to_json(profile))
    else:
        write_file(path, to_json(profile).encode())
        print(f"{path}: profile {profile.name}")
