"""Optimized to the end, every profile's bundle comes to one answer: the loss, the distance to the true surface, the pictures.

All are run on lavapipe as that profile (emulate=), against lavapipe's own bundle. Profiles whose packing differs stand for the rest.
"""

import sys

import numpy as np
import pytest
from graphs import ROOT

from dressi_edge import runtime
from dressi_edge.compiler.io.cameras import orbit
from dressi_edge.compiler.io.meshes import load_mesh, normalize
from dressi_edge.compiler.io.shapes import icosphere, pear
from dressi_edge.compiler.render.optimizer import Adam
from dressi_edge.compiler.render.raster import Softness
from dressi_edge.compiler.scene.problem import Loss, Problem

sys.path.append(str(ROOT / "benchmarks"))
from metrics import Surface  # noqa: E402

pytest_plugins = ["gpu"]

PROFILES = ("unlimited", "limit8", "limit4", "vulkan_min", "mali_g76")
SPOT = ROOT.parent / "shared" / "meshes" / "spot" / "spot.obj"
SOFT = Softness(2.0)


def converges(gpu, target, start, size, steps, profiles=PROFILES):
    """Fit the silhouettes of a mesh with each profile; {profile: [loss, mean distance to the surface]}, all checked."""
    cameras, surface = orbit(6, (20.0, -20.0), 2.5, 50.0, (size, size)), Surface(target.positions, target.faces)
    picture = Problem(target, cameras, albedo="constant")
    picture.render(softness=SOFT)
    problem = Problem(start, cameras, albedo="constant")
    problem.phase("shape", steps, {"vertices": Adam(0.01)}, [Loss("silhouette"), Loss("laplacian", 0.05)], SOFT)
    problem.render(softness=SOFT)
    with gpu.open(picture.program) as session:
        targets = session.get("render.color")

    def fitted(profile, emulate):
        with runtime.load(gpu.compile(problem.program, profile), gpu.device, emulate=emulate) as session:
            session.set("targets", targets)
            first = session.loss()
            session.step(steps)
            distance = surface.vertex_distances(session.get("vertices")).mean()
            return first, [session.loss(), distance], session.get("render.color")

    first, expected, image = fitted("lavapipe", None)
    before = surface.vertex_distances(start.positions).mean()
    assert expected[0] < 0.2 * first and expected[1] < 0.4 * before, (first, before, expected)
    numbers = {}
    for profile in profiles:
        begun, numbers[profile], found = fitted(profile, profile)
        assert begun == pytest.approx(first, rel=0.01)
        np.testing.assert_allclose(numbers[profile], expected, rtol=0.01, err_msg=profile)
        np.testing.assert_allclose(found, image, rtol=0, atol=1e-3, err_msg=profile)
        print(f"{profile}: loss {first:.4g} -> {numbers[profile][0]:.6g}, distance {before:.4g} -> {numbers[profile][1]:.6g}, "
              f"images differ by {np.abs(found - image).max():.2g}")
    gpu.silent()


def test_every_profile_converges_to_the_same_shape(gpu):
    converges(gpu, pear(24), icosphere(2, 0.6), 64, 60, ("unlimited", "limit4", "mali_g76"))


@pytest.mark.full
def test_every_profile_converges_to_the_same_spot(gpu):
    """Six views of 256x256, 1280 faces against the silhouettes of Spot's 5856."""
    if not SPOT.is_file():
        pytest.skip(f"no Spot: {SPOT.relative_to(ROOT.parent)} is not there")
    converges(gpu, normalize(load_mesh(SPOT)), icosphere(3, 0.6), 256, 200)
