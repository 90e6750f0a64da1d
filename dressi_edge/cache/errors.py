"""Every error the product raises on purpose, and its one warning. One line each: what, where, what is allowed, what to do."""

import warnings


class DressiError(Exception):
    """Base of all named errors; `exit_code` is what the command line returns."""

    exit_code = 1


class InputError(DressiError, ValueError):
    """A mesh, image, camera, job or array that cannot be used."""

    exit_code = 3


class InputWarning(UserWarning):
    """Something in an input that was left out, changed or looks wrong, and that the result can do without. One line: what, and what
    was or can be done. The command line prints it as `dressi-edge: note: ...`."""


def note(text: str) -> None:
    """Warns the caller's caller of an input: an InputWarning."""
    warnings.warn(InputWarning(text), stacklevel=3)


class GraphError(InputError):
    """A graph that is not well formed: types, extents, or a gradient through an op that has none."""


class ProfileError(InputError):
    """A device profile that is malformed, unknown or contradicts itself."""


class PackError(InputError):
    """A graph that does not fit a device profile."""


class BundleError(InputError):
    """A bundle that is malformed, truncated, of another version, or does not fit the device."""


class DeviceError(DressiError, RuntimeError):
    """No Vulkan device, a device too small, or a Vulkan call that failed."""

    exit_code = 4
