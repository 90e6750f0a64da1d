"""Which variant of a bundle a session runs: the first that fits the device and the profile it emulates. Both what it does,
counted anew, and what it says it needs must fit, and its images the device's memory.
"""
from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from ..cache.bundle import Bundle
from ..cache.errors import DeviceError, InputError
from ..cache.profile import Profile, misfit
from ..cache.verify import violations
from . import vk
from .emulate import rules
from .memory import too_large

DEPTH_BIT = vk.VK_FORMAT_FEATURE_DEPTH_STENCIL_ATTACHMENT_BIT


class Choice(NamedTuple):
    """bundle: the variant taken. depth_format: the VkFormat of its depth images here, 0 if it has none. why: {profile of each
    variant: why it was taken or not}."""

    bundle: Bundle
    depth_format: int
    why: dict[str, str]


def choose(variants: Sequence[Bundle], device, profile: str | None = None) -> Choice:
    """The first variant that fits the device, or the one made for `profile` if it does. Raises InputError if none is made for
    it, DeviceError that names what does not fit."""
    if profile is not None and profile not in (names := [b.profile for b in variants]):
        raise InputError(f"profile {str(profile)!r:.60} is none of this bundle's; there are: {' '.join(names)}")
    kept, taken, depth, why, refused = list(rules(device)), None, 0, {}, []
    for bundle in variants:
        name = bundle.profile
        if profile not in (None, name):
            why[name] = f"not taken: {profile} was asked for"
        elif taken is not None:
            why[name] = f"not taken: {taken.profile} comes before it and fits"
        else:
            by, lines, depth = _misfits(bundle, device, kept)
            if lines:
                refused.append((name, by, lines))
                why[name] = f"does not fit {by}: {lines[0]}"
            else:
                taken = bundle
                why[name] = "taken: asked for" if profile else "taken: the first that fits"
    if taken is not None:
        return Choice(taken, depth, why)
    if len(refused) > 1:
        raise DeviceError(f"no variant of the bundle fits: {'; '.join(f'{name}: {lines[0]}' for name, _, lines in refused)}; "
                          "compile it for a profile this device has")
    (name, by, lines), = refused
    more = f"; and {len(lines) - 3} more" if len(lines) > 3 else ""
    raise DeviceError(f"the bundle, made for profile {name}, does not fit {by}: {'; '.join(lines[:3])}{more}; "
                      "compile it for a profile this device has")


def _misfits(bundle: Bundle, device, kept: Sequence[Profile]) -> tuple[str, list[str], int]:
    """The name of the first profile that the bundle does not keep, what breaks it, one line each, and the depth format."""
    d = bundle.description
    needs = {**d["needs"]["limits"], **d["needs"]["formats"]}
    for profile in kept:
        if lines := violations(d, profile, bundle.interfaces) or misfit(needs, profile):
            return profile.name, lines, 0
    if d.get("computes") and not device.compute:
        return device.name, [f"{device.name} has no queue that both draws and computes"], 0
    if line := too_large(d["images"], device):
        return device.name, [line], 0
    if all(image["format"] for image in d["images"]):
        return "", [], 0
    views = {device, getattr(device, "real", device)}
    able = [f for f in d["depth_formats"] if all(view.format_features(f)[1] & DEPTH_BIT for view in views)]
    if not able:
        return device.name, [f"none of the depth formats {d['depth_formats']} is a depth attachment of {device.name}"], 0
    return "", [], able[0]
