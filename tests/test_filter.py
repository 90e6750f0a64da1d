"""Bilinear filtering in fp32: values by hand, weights finer than the 8 bits of a sampler, with and without a sampler of the device."""

import numpy as np
import pytest
from graphs import image_layout, layout_of

from dressi_edge.cache.profile import Profile
from dressi_edge.compiler import Options, Program, build
from dressi_edge.compiler.graph.functions import apply
from dressi_edge.compiler.graph.reference import evaluate

pytest_plugins = ["gpu"]
TEXTURE = np.array([[0.0, 1.0], [2.0, 4.0]])[..., None]
# (u, v): value with wrap repeat, with clamp. Texel centres are at 1/4 and 3/4.
BY_HAND = {(0.25, 0.25): (0.0, 0.0), (0.75, 0.25): (1.0, 1.0), (0.25, 0.75): (2.0, 2.0), (0.75, 0.75): (4.0, 4.0),
           (0.5, 0.5): (1.75, 1.75), (0.375, 0.25): (0.25, 0.25), (0.25, 0.625): (1.5, 1.5), (0.625, 0.375): (1.4375, 1.4375),
           (0.0, 0.25): (0.5, 0.0), (1.0, 0.75): (3.0, 4.0), (0.5, 0.0): (1.75, 0.5), (1.25, -0.25): (2.0, 1.0), (-3.25, 0.25): (1.0, 0.0)}


def sampled(uv, texture=TEXTURE):
    """{op and wrap: (function of the program, texture node)}: outputs of a program that samples in every way there is."""
    program, feed = Program(), {"uv": uv, "texture": texture, "covered": np.ones((*uv.shape[:2], 1), np.int64)}
    t, at, covered = (program.input(name, image_layout(feed[name])) for name in ("texture", "uv", "covered"))
    outputs = {}
    for wrap in ("repeat", "clamp"):
        outputs[f"sample.{wrap}"] = apply("sample", t, at, wrap=wrap)
        outputs[f"sample_exact.{wrap}"] = apply("sample_exact", t, at, covered, wrap=wrap)
    program.plan("p", {}, {name: (y, layout_of(y)) for name, y in outputs.items()})
    return program, feed, outputs


@pytest.mark.parametrize("profile", ["lavapipe", "vulkan_min"])
def test_values_by_hand(gpu, profile):
    program, feed, outputs = sampled(np.array(list(BY_HAND))[None])
    device = gpu.run(program, feed, profile)
    for name, y in outputs.items():
        expected = np.array([pair[name.endswith("clamp")] for pair in BY_HAND.values()])[None]
        np.testing.assert_allclose(evaluate([y], feed)[0][..., 0], expected, atol=1e-12, err_msg=name)
        np.testing.assert_allclose(device[name], expected, atol=2e-6, err_msg=f"{name} {profile}")


def test_profiles_differ_in_the_sampler_and_exact_sampling_uses_none():
    program, _, _ = sampled(np.array(list(BY_HAND))[None])

    def samplers(profile):
        return sum("sampler2D" in text for _, text in build(program, Profile.load(profile), Options()).shaders)
    assert samplers("lavapipe") > 0 and samplers("vulkan_min") == 0


@pytest.mark.parametrize("profile", ["lavapipe", "vulkan_min"])
def test_weights_are_finer_than_eight_bits_where_no_sampler_is_used(gpu, profile):
    """A ramp of 1,001 steps between two texels: a sampler with weights of 8 bits would give 257 values, off by up to 1/512."""
    uv = np.stack([np.linspace(0.25, 0.75, 1001), np.full(1001, 0.25)], 1)[None]
    program, feed, _ = sampled(uv)
    device = gpu.run(program, feed, profile)
    expected = (np.float32(uv[..., 0]).astype(float) - 0.25) * 2
    for name in [f"sample_exact.{w}" for w in ("repeat", "clamp")] + ([] if profile == "lavapipe" else ["sample.repeat", "sample.clamp"]):
        assert len(np.unique(device[name])) > 990
        np.testing.assert_allclose(device[name], expected, atol=3e-7, err_msg=name)
