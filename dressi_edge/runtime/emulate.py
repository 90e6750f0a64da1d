"""A device that says it is another one: it reports a profile's limits, features and formats; a session holds bundles to them.

In: an open `Device` and a `Profile`. Out: an `EmulatedDevice`, which works wherever a `Device` does. What the profile allows
beyond the device at hand is reported, too; a bundle runs if what it really does fits both.
"""
from __future__ import annotations

import os
from collections.abc import Iterator

from ..cache.limits import FEATURES, FORMAT_FEATURES, FORMATS, LIMITS
from ..cache.profile import Profile, from_device
from . import vk
from .device import Device

BITS = {name: getattr(vk, constant) for name, constant in FORMAT_FEATURES.items()}
NUMBERS = {getattr(vk, f"VK_FORMAT_{name}"): name for name in FORMATS}
TRANSFERS = 0x4000 | 0x8000  # VK_FORMAT_FEATURE_TRANSFER_SRC_BIT and _DST_BIT, of Vulkan 1.1: the device's own


def reported(device: Device | EmulatedDevice) -> Profile:
    """The profile of what a device reports, of those formats that a profile knows."""
    formats = {}
    for number, name in NUMBERS.items():
        bits = device.format_features(number)[1]
        formats[name] = [feature for feature, bit in BITS.items() if bits & bit]
    return from_device(device.limits, device.features, formats, device.name)


def rules(device: Device | EmulatedDevice) -> Iterator[Profile]:
    """Every profile that a bundle on this device must keep: the emulated one, then that of the device itself."""
    if isinstance(device, EmulatedDevice):
        yield device.profile
        device = device.real
    yield reported(device)


class EmulatedDevice:
    """`real` seen through `profile` (a Profile, or a name or .json file for `Profile.load`). `limits`, `features` and
    `format_features` are the profile's, and what no profile speaks of is absent; closing it closes `real`; everything else is
    `real`'s. Raises ProfileError."""

    def __init__(self, real: Device | EmulatedDevice, profile: Profile | str | os.PathLike):
        self.real = real.real if isinstance(real, EmulatedDevice) else real
        self.profile = profile if isinstance(profile, Profile) else Profile.load(profile)
        self.name = f"{self.real.name} as {self.profile.name}"
        self.limits = {**self.real.limits, **{k: _as_driver(self.profile.limit(k)) for k in LIMITS}}
        self.features = {k: k in FEATURES and self.profile.feature(k) for k in self.real.features}

    def __getattr__(self, name: str):
        return getattr(self.real, name)

    def format_features(self, number: int) -> tuple[int, int, int]:
        """VkFormatFeatureFlags as `Device.format_features` gives them. Of the two depth formats of which Vulkan promises at
        least one, a profile that is certain of neither leaves the choice to the device at hand."""
        if number not in NUMBERS:
            return 0, 0, 0
        name, own = NUMBERS[number], self.real.format_features(number)[1]
        bits = sum(BITS[feature] for feature in self.profile.format_features(name)) | own & TRANSFERS
        if name in self.profile.depth_choice() and len(self.profile.depth_choice()) > 1:
            bits |= own & BITS["depth"]
        return 0, bits, 0

    def __enter__(self) -> EmulatedDevice:
        return self

    def __exit__(self, *_) -> None:
        self.real.close()

    def __repr__(self) -> str:
        return f"<EmulatedDevice {self.profile.name} on {self.real!r}>"


def _as_driver(value):
    """A profile's value as `Device.limits` has it: VkBool32 and C arrays."""
    return int(value) if isinstance(value, bool) else list(value) if isinstance(value, tuple) else value
