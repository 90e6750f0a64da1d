"""Whether a bundle fits a device: what it does, counted anew, and what it says it needs, against the device and the profile it
emulates."""
from __future__ import annotations

from ..cache import vulkan as v
from ..cache.errors import BundleError, DeviceError
from ..cache.profile import misfit
from ..cache.verify import violations
from . import vk
from .emulate import rules

DEPTH_BIT = vk.VK_FORMAT_FEATURE_DEPTH_STENCIL_ATTACHMENT_BIT


def fit(bundle, device) -> int:
    """The VkFormat of the bundle's depth images on this device, 0 if it has none. Raises BundleError or DeviceError."""
    d = bundle.description
    for name in d["needs"]["formats"]:
        if name not in v.FORMATS:
            raise BundleError(f"needs.formats names {name}, which this reader does not know")
    needs = {**d["needs"]["limits"], **d["needs"]["formats"]}
    for profile in rules(device):
        lines = violations(d, profile, bundle.interfaces) or misfit(needs, profile)
        if lines:
            more = f"; and {len(lines) - 3} more" if len(lines) > 3 else ""
            raise DeviceError(f"the bundle, made for profile {d['profile']['name']}, does not fit {profile.name}: "
                              f"{'; '.join(lines[:3])}{more}; compile it for a profile this device has")
    if all(image["format"] for image in d["images"]):
        return 0
    views = {device, getattr(device, "real", device)}
    able = [f for f in d["depth_formats"] if all(view.format_features(f)[1] & DEPTH_BIT for view in views)]
    if not able:
        raise DeviceError(f"none of the depth formats {d['depth_formats']} is a depth attachment of {device.name}")
    return able[0]
