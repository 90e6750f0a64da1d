"""A device under a profile: what it reports, what it refuses, and that every profile's bundle gives lavapipe's image there."""

import dataclasses

import numpy as np
import pytest
from profile_bundles import NAMES, hardsoftras
from undertest import DEVICE

from dressi_edge import runtime
from dressi_edge.cache import bundle
from dressi_edge.cache import vulkan as v
from dressi_edge.cache.errors import DeviceError, ProfileError
from dressi_edge.cache.limits import FORMATS, LIMITS
from dressi_edge.cache.profile import Profile, profile_names
from dressi_edge.compiler import compile_program
from dressi_edge.runtime import vk
from dressi_edge.runtime.emulate import EmulatedDevice, reported, rules

pytest_plugins = ["gpu", "profile_bundles"]

OUTPUTS = ("alpha", "color", "by_clip", "by_attributes")


@pytest.fixture(scope="module")
def native(gpu, profile_bundle):
    """native(K): the results of lavapipe's own bundle on lavapipe as it is."""
    made = {}

    def get(layers):
        if layers not in made:
            with runtime.load(profile_bundle("lavapipe", layers), gpu.device) as session:
                made[layers] = {name: session.get(name) for name in OUTPUTS}
        return made[layers]

    return get


# ---- what runs

@pytest.mark.parametrize("layers", [1, 3])
@pytest.mark.parametrize("name", NAMES)
def test_every_profile_runs_its_bundle_and_gives_the_same_answer(gpu, profile_bundle, native, name, layers):
    path = profile_bundle(name, layers)
    limit = "maxPerStageDescriptorInputAttachments"
    most, asked = gpu.device.limits[limit], bundle.read(path).description["needs"]["limits"].get(limit, 0)
    if asked > most:  # no emulation gives this device what it does not have
        with pytest.raises(DeviceError, match=f"needs {asked} input attachments in its fragment shader; .* allows {most}"):
            runtime.load(path, gpu.device, emulate=name)
        return
    with runtime.load(path, gpu.device, emulate=name) as session:
        found = {output: session.get(output) for output in OUTPUTS}
        assert session.report()["device"] == f"{gpu.device.name} as {name}"
    gpu.silent()
    expected = native(layers)
    assert expected["alpha"].max() > 0.9 and np.abs(expected["by_clip"]).max() > 0.1
    for image in ("alpha", "color"):
        np.testing.assert_allclose(found[image], expected[image], rtol=0, atol=1e-5)
    for gradient in ("by_clip", "by_attributes"):
        scale = np.abs(expected[gradient]).max()
        np.testing.assert_allclose(found[gradient] / scale, expected[gradient] / scale, rtol=0, atol=1e-4)


def test_a_session_closes_the_device_it_opened_and_no_other(gpu, profile_bundle):
    path = profile_bundle("limit4", 1)
    with runtime.load(path, DEVICE, emulate="limit4") as session:
        device = session.device
    assert device.real.device is None
    with runtime.load(path, gpu.device, emulate="limit4"):
        pass
    assert gpu.device.device is not None
    with runtime.load(path, EmulatedDevice(gpu.device, "limit4")) as session:
        assert session.get("alpha").max() > 0.9
    with runtime.load(path, EmulatedDevice(gpu.device, "unlimited"), emulate="limit4") as session:
        assert session.device.profile.name == "limit4" and session.device.real is gpu.device


# ---- what is refused

def test_a_bundle_for_more_is_refused_with_one_clear_line(gpu, profile_bundle):
    with pytest.raises(DeviceError) as error:
        runtime.load(profile_bundle("unlimited", 3), gpu.device, emulate="limit4")
    line = str(error.value)
    assert "\n" not in line
    assert line.startswith("the bundle, made for profile unlimited, does not fit limit4: shape")
    assert "profile limit4 allows 4 (maxColorAttachments)" in line
    assert line.endswith("more; compile it for a profile this device has")
    gpu.silent()


def test_a_refusal_closes_the_device_that_load_opened(profile_bundle, monkeypatch):
    opened = []
    real_open = runtime.session.Device.open
    monkeypatch.setattr(runtime.session.Device, "open", lambda *a, **k: opened.append(real_open(*a, **k)) or opened[-1])
    with pytest.raises(DeviceError):
        runtime.load(profile_bundle("unlimited", 3), DEVICE, emulate="limit4")
    assert len(opened) == 1 and opened[0].device is None


def test_an_unknown_profile_is_refused_before_a_device_is_opened(profile_bundle):
    with pytest.raises(ProfileError, match="mali_g67"):
        runtime.load(profile_bundle("limit4", 1), "no such device", emulate="mali_g67")


@pytest.mark.parametrize("limit", ["maxColorAttachments", "maxPerStageResources", "maxFramebufferWidth",
                                   "maxVertexOutputComponents"])
def test_one_limit_of_the_profile_is_enough_to_refuse(gpu, profile_bundle, limit):
    profile = Profile.load("lavapipe")
    low = dataclasses.replace(profile, name="low", limits={**profile.limits, limit: 1})
    with pytest.raises(DeviceError, match=rf"does not fit low: .*profile low allows 1 \({limit}\)"):
        runtime.load(profile_bundle("lavapipe", 3), gpu.device, emulate=low)
    runtime.load(profile_bundle("lavapipe", 3), gpu.device, emulate=dataclasses.replace(low, limits=profile.limits)).close()


def test_what_the_device_at_hand_cannot_do_is_refused_whatever_the_profile_says(gpu, tmp_path):
    unlimited = Profile.load("unlimited")
    more = dict.fromkeys(("maxColorAttachments", "maxFragmentOutputAttachments"), 64)
    dreamt = dataclasses.replace(unlimited, name="dreamt", limits={**unlimited.limits, **more})
    compile_program(hardsoftras(3), dreamt, tmp_path / "dreamt.dressi")
    have = gpu.device.limits["maxColorAttachments"]
    with pytest.raises(DeviceError) as error:
        runtime.load(tmp_path / "dreamt.dressi", gpu.device, emulate=dreamt)
    assert f"does not fit {gpu.device.name}: " in str(error.value)
    assert f"allows {have} (maxColorAttachments)" in str(error.value)
    gpu.silent()


def test_a_bundle_that_hides_what_it_needs_is_counted_all_the_same(gpu, profile_bundle, tmp_path):
    b = bundle.read(profile_bundle("unlimited", 3))
    d = {**b.description, "needs": {"limits": {}, "formats": {}}}
    blobs = [bytes(b.blob(k)) for k in range(len(d.pop("blobs")))]
    bundle.write(tmp_path / "x.dressi", d, blobs)
    with pytest.raises(DeviceError, match="maxColorAttachments"):
        runtime.load(tmp_path / "x.dressi", gpu.device, emulate="limit4")


# ---- what is reported

@pytest.mark.parametrize("name", profile_names())
def test_an_emulated_device_reports_the_profile(gpu, name):
    profile, device = Profile.load(name), EmulatedDevice(gpu.device, name)
    told = reported(device)
    assert {k: told.limit(k) for k in LIMITS} == {k: profile.limit(k) for k in LIMITS}
    assert all(on == (k in profile.features and profile.features[k] or k == "robustBufferAccess" and profile.feature(k))
               for k, on in device.features.items())
    for fmt in FORMATS:
        extra = told.format_features(fmt) - profile.format_features(fmt)
        assert profile.format_features(fmt) <= told.format_features(fmt)
        assert not extra or extra == {"depth"} and len(profile.depth_choice()) > 1
    assert any(told.format_has(fmt, "depth") for fmt in v.DEPTH_FORMATS)
    assert [p.name for p in rules(device)] == [name, gpu.device.name]
    assert [p.name for p in rules(gpu.device)] == [gpu.device.name]


def test_what_no_profile_speaks_of_is_absent_or_the_devices_own(gpu):
    device = EmulatedDevice(gpu.device, "rtx2080")
    assert device.format_features(vk.VK_FORMAT_R5G6B5_UNORM_PACK16) == (0, 0, 0)
    assert not device.features["sparseBinding"]
    assert device.limits["timestampPeriod"] == gpu.device.limits["timestampPeriod"]
    assert device.limits["viewportBoundsRange"] == [-65536, 65536] and device.limits["maxColorAttachments"] == 8
    assert device.queue is gpu.device.queue and "rtx2080" in repr(device)
