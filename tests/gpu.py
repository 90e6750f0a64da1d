"""Programs on lavapipe under the validation layer: a pytest plugin, `pytest_plugins = ["gpu"]` in a module that wants `gpu`.

The device is opened once for the whole session with synchronization validation, and every run leaves it with nothing to say.
A machine without lavapipe or without the layer fails here: nothing is skipped. DRESSI_TEST_DEVICE names another device (a part of its
name); what depends on a device, its grid of sub-pixels above all, is asked of it.
"""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from undertest import DEVICE, GRIDS

from dressi_edge import runtime
from dressi_edge.cache.profile import Profile
from dressi_edge.compiler import compile_program
from dressi_edge.runtime.device import Device


class Gpu:
    """Compiles to a bundle on disk, reads it back, runs it."""

    def __init__(self, folder):
        self.folder, self.numbers = folder, itertools.count()
        self.device = Device.open(DEVICE, validation=True)

    def compile(self, program, profile="lavapipe", **how):
        """The path of the bundle, made for that profile on the grids of the device where these are coarser."""
        path = self.folder / f"{next(self.numbers)}.dressi"
        profiles = [self.at_hand(p) for p in profile] if isinstance(profile, (list, tuple)) else self.at_hand(profile)
        compile_program(program, profiles, path, **how)
        return path

    def at_hand(self, profile):
        """The profile, with the device's grids where those are coarser."""
        profile = profile if isinstance(profile, Profile) else Profile.load(profile)
        coarser = {name: self.device.limits[name] for name in GRIDS if self.device.limits[name] < profile.limit(name)}
        return replace(profile, limits={**profile.limits, **coarser}) if coarser else profile

    def open(self, program, profile="lavapipe", **how):
        """A session on the bundle, to close by the caller."""
        return runtime.load(self.compile(program, profile, **how), self.device)

    def run(self, program, feed, profile="lavapipe", **how):
        """{name: array in the user's shape} of every output, with the inputs given as images (h, w, c)."""
        with self.open(program, profile, **how) as session:
            for name, array in feed.items():
                session.set(name, program.values[name].layout.from_image(np.asarray(array)))
            results = {name: session.get(name) for name, role in program.roles.items() if role == "output"}
        self.silent()
        return results

    def silent(self):
        """The layer has said nothing since the last call."""
        said = self.device.messages[:]
        self.device.messages.clear()
        assert said == []


@pytest.fixture(scope="session")
def gpu(tmp_path_factory):
    """The one `Gpu` of a test session."""
    shared = Gpu(tmp_path_factory.mktemp("bundles"))
    yield shared
    shared.device.close()
    shared.silent()
