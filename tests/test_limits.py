"""What is too large for a profile is said in the words of the job, before the work: never a bundle that its own profile refuses."""

import numpy as np
import pytest
from jobs import SIZE, TINY, write_job
from PIL import Image

from dressi_edge.cache.errors import InputError
from dressi_edge.cache.profile import Profile
from dressi_edge.compiler.io.cameras import orbit
from dressi_edge.compiler.io.meshes import Mesh
from dressi_edge.compiler.io.shapes import icosphere
from dressi_edge.compiler.render.atlas import COMMON_SIDE, Atlas
from dressi_edge.compiler.render.optimizer import Adam
from dressi_edge.compiler.scene import limits
from dressi_edge.compiler.scene.job import load_job
from dressi_edge.compiler.scene.problem import Loss, Problem

MIN, LAVAPIPE = Profile.load("vulkan_min"), Profile.load("lavapipe")


def refused(call, *args, **kwargs):
    with pytest.raises(InputError) as error:
        call(*args, **kwargs)
    assert "\n" not in str(error.value)
    return str(error.value)


def test_an_atlas_is_made_wider_where_it_would_be_too_high():
    assert Atlas.of(600, 600, 7).extent.width <= COMMON_SIDE and Atlas.of(600, 600, 7).extent.height <= COMMON_SIDE
    for width, height, n in ((400, 400, 100), (256, 256, 6), (4096, 10, 400), (64, 64, 13), (1000, 3, 17)):
        extent = Atlas.of(width, height, n).extent
        assert max(extent.width, extent.height) <= COMMON_SIDE and extent.width * extent.height >= width * height * n
    assert max(Atlas.of(400, 400, 110).extent.width, Atlas.of(400, 400, 110).extent.height) == 4400, "none fits 4096: the shortest side"


@pytest.mark.parametrize("count, size, told", [
    (110, (400, 400), "110 views of 400x400 lie side by side in one image of 4000x4400; profile vulkan_min allows 4096x4096; "
                      "use at most 100 views or views.size = [372, 372] or smaller, or views.order = \"shuffle\" or "
                      "\"accumulate\": one at a time on the device"),
    (1, (6000, 4000), "1 view of 6000x4000 needs an image of 6000x4000; profile vulkan_min allows 4096x4096; "
                      "use views.size = [4096, 2730] or smaller"),
    (10 ** 6, (100, 100), "use at most 1600 views or views.size = [4, 4] or smaller")])
def test_views_that_do_not_fit_are_told_with_what_would(count, size, told):
    assert told in refused(limits.fits_views([MIN]), count, *size)
    if "[372" in told:
        limits.fits_views([MIN])(100, *size)
        limits.fits_views([MIN])(110, 372, 372)
        limits.fits_views([LAVAPIPE])(count, *size)
        assert told in refused(limits.fits_views([LAVAPIPE, MIN]), count, *size)


def test_what_no_bundle_or_no_machine_can_hold_is_told(monkeypatch):
    big = Profile(name="big", limits={k: 1 << 16 for k in ("maxImageDimension2D", "maxFramebufferWidth", "maxFramebufferHeight")}
                  | {"maxViewportDimensions": (1 << 16, 1 << 16)})
    assert "are 16.0 GB in a bundle; at most 4.3 GB are allowed" in refused(limits.fits_views([big]), 1000, 1000, 1000)
    monkeypatch.setattr(limits.os, "sysconf", lambda name: 1 << 14)
    assert "need about 1.1 GB of memory to be compiled; this machine has 0.3 GB" in refused(limits.fits_views([big]), 10, 1000, 1000)


@pytest.mark.parametrize("change, told", [
    ({"texture": (8192, 8)}, "a texture of 8192x8; profile vulkan_min allows 4096x4096; scale it down"),
    ({"texture": (16384, 16384)}, "a texture of 16384x16384; at most 67108864 texels are allowed, such as 8192x8192"),
    ({"vertices": 700_000, "views": 30}, "30 views of 700000 vertices need a table of 21000000 entries; profile vulkan_min allows "
                                         "16777216; use fewer views or vertices"),
    ({"faces": 20_000_000}, "20000000 faces need a table"),
    ({"texture": (64, 64), "optimized": {"texture"}, "views": 9}, "four texels each, need a table of 36000000 entries; profile vulkan_min "
                                                                  "allows 16777216; set views.order = \"cycle\" or \"shuffle\", or use"),
    ({"texture": (64, 64), "optimized": {"texture"}, "views": 20}, "20000000 pixels; at most 16777216 are allowed; set views.order")])
def test_a_scene_that_does_not_fit_is_told_in_its_words(change, told):
    scene = {"views": 6, "pixels": 1_000_000, "order": "batch", "vertices": 100, "faces": 100, "texture": None} | change
    assert told in refused(limits.fits_scene, [MIN], **scene)
    if "order" in told:
        limits.fits_scene([MIN], **scene | {"order": "cycle"})
        limits.fits_scene([MIN], **scene, texture_grad="inverse_uv")


def test_a_job_is_refused_before_its_pictures_are_decoded(tmp_path, monkeypatch):
    path = write_job(tmp_path)
    big = Image.new("RGBA", (4097, 1))
    for k in range(2):
        big.save(tmp_path / "photos" / f"{k}.png")
    monkeypatch.setattr(Image.Image, "convert", None)
    told = refused(load_job, path, [LAVAPIPE, MIN])
    assert told.startswith(f"{path}: views: 2 views of 4097x1") and "profile vulkan_min allows" in told


def test_a_texture_of_a_job_is_refused_before_anything_is_built(tmp_path, monkeypatch):
    text = TINY.replace('albedo = "colors"', "texture_size = [8192, 4]").replace("optimize.colors", "optimize.texture")
    monkeypatch.setattr("dressi_edge.compiler.scene.job.Problem", None)
    assert "render: a texture of 8192x4; profile vulkan_min allows 4096x4096" in refused(load_job, write_job(tmp_path, text), [MIN])


def test_a_problem_is_checked_before_it_is_compiled(tmp_path, monkeypatch):
    monkeypatch.setattr("dressi_edge.compiler.compile_program", None)
    ball = icosphere(1, 0.5)
    mesh = Mesh(ball.positions, ball.faces, ball.uvs, ball.uv_faces, texture=np.zeros((2, 5000, 3)))
    problem = Problem(mesh, orbit(2, (20.0,), 2.5, 50.0, (SIZE, SIZE)))
    problem.render()
    assert "a texture of 5000x2; profile vulkan_min" in refused(problem.compile, ["lavapipe", "vulkan_min"], tmp_path / "x.dressi")
    small = Profile(name="small", limits={"maxFramebufferHeight": 16})
    problem = Problem(ball, orbit(2, (20.0,), 2.5, 50.0, (SIZE, 8)), albedo="constant")
    problem.phase("p", 1, {"vertices": Adam(0.1)}, [Loss("silhouette")])
    assert "2 views of 24x8 and 80 faces need a table of" in refused(problem.compile, small, tmp_path / "x.dressi")
    assert not (tmp_path / "x.dressi").exists()
