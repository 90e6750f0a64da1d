"""The device that tests run on: lavapipe, or the one that DRESSI_TEST_DEVICE names (a part of its name), and the grid it draws on."""

import functools
import os

from dressi_edge.cache.errors import DeviceError
from dressi_edge.runtime.device import Device

DEVICE = os.environ.get("DRESSI_TEST_DEVICE", "llvmpipe")
GRIDS = ("subPixelPrecisionBits", "subTexelPrecisionBits")


@functools.cache
def grid_bits() -> int:
    """Of the device under test: a pixel has 2 to this many places across for a corner. Lavapipe's 8 where there is no device: tests then
    fail by themselves."""
    try:
        with Device.open(DEVICE) as device:
            return device.limits["subPixelPrecisionBits"]
    except DeviceError:
        return 8


def margin() -> float:
    """Pixels nearer than this to an edge may be on either side of it."""
    return max(1 / 64, 2.0 ** -grid_bits())
