"""Pictures that must be equal whatever draws them: one colour in several forms, moved and scaled scenes, permuted views, crops, views
alone and together, with and without what leaves work out. Nothing here is compared with a picture drawn by the same request: a bug in
all of them would have to be the same bug. Sizes are those people use: not multiples of tiles, larger than one.
"""

import dataclasses
import itertools

import numpy as np
import pytest

from dressi_edge import runtime
from dressi_edge.compiler.scene import Camera, Light, Loss, Problem, Sgd, Softness, orbit, pear

pytest_plugins = ["gpu"]
PEAR = pear(40)
COLOR = (0.3, 0.6, 0.45)
SOFT = {"outline": Softness(2.0), "hard": Softness(1.0, delta=0.0), "layers": Softness(2.0, layers=3)}
FORMS = {"constant": dataclasses.replace(PEAR, texture=None),
         "colors": dataclasses.replace(PEAR, texture=None, colors=np.tile(COLOR, (len(PEAR.positions), 1))),
         "texture": dataclasses.replace(PEAR, texture=np.tile(np.array(COLOR), (32, 32, 1)))}
PAINTED = dataclasses.replace(PEAR, texture=None, colors=0.5 + 0.4 * np.sin(7 * PEAR.positions + np.array([0.0, 1.0, 2.0])))


def cameras(views, size, distance=2.7):
    return tuple(orbit(views, (20.0, -15.0), distance, 45.0, size))


def picture(gpu, mesh, views, soft="outline", albedo="colors", compiled=None, **settings):
    """RGBA (views, height, width, 4) in float64."""
    problem = Problem(mesh, views, albedo=albedo, albedo_color=COLOR, **settings)
    problem.render("look", SOFT[soft])
    with runtime.load(gpu.compile(problem.program, **(compiled or {})), gpu.device) as session:
        found = session.get("look.color").astype(float)
    gpu.silent()
    return found


def nearly(a, b, pixels, tolerance=2e-3):
    """Equal to the tolerance but for so many pixels: corners are rounded to 1/256 of a pixel, and may fall on another side of a centre."""
    off = np.abs(a - b).max(-1) > tolerance
    assert off.sum() <= pixels, f"{off.sum()} pixels of {off.size} differ, by up to {np.abs(a - b).max():.4f}"
    assert (a[..., 3] > 0.5).mean() > 0.03, "the picture is empty"


# One colour in three forms


AMBIENT = {"shading": "lambert", "lights": [Light("ambient", 0.7)]}
SUN = {"shading": "lambert", "lights": [Light("ambient", 0.2), Light("directional", 1.5, (-0.4, -0.7, -0.6))]}


@pytest.mark.parametrize("size, views, soft, light, expected", [
    ((200, 150), 2, "outline", {}, COLOR), ((333, 217), 1, "hard", AMBIENT, [0.7 * c for c in COLOR]),
    ((200, 150), 1, "layers", SUN, None)], ids=["200x150 unlit", "333x217 ambient", "200x150 three layers in the sun"])
def test_a_colour_is_drawn_alike_as_a_constant_at_vertices_and_as_a_texture(gpu, size, views, soft, light, expected):
    drawn = {form: picture(gpu, mesh, cameras(views, size), soft, form, **light) for form, mesh in FORMS.items()}
    for a, b in itertools.combinations(drawn, 2):
        np.testing.assert_allclose(drawn[a], drawn[b], atol=1e-5, err_msg=f"{a} and {b}")
    inside = drawn["constant"][..., 3] == 1
    assert inside.mean() > 0.05
    if expected is not None:  # by hand, not by the other forms: unlit it is the colour, under ambient light the colour times its power
        np.testing.assert_allclose(drawn["constant"][inside][:, :3], np.broadcast_to(expected, (inside.sum(), 3)), atol=1e-6)


# Views


def test_views_alone_permuted_and_together_are_the_same_pictures(gpu):
    views = cameras(3, (113, 87))
    together = picture(gpu, PAINTED, views)
    permuted = picture(gpu, PAINTED, [views[k] for k in (2, 0, 1)])
    nearly(permuted, together[[2, 0, 1]], 3)
    nearly(picture(gpu, PAINTED, views[1:2])[0], together[1], 3)


def test_a_batch_has_the_mean_of_its_views_gradients(gpu):
    views = cameras(2, (97, 75))
    targets = np.random.default_rng(0).random((2, 75, 97, 4)).astype(np.float32)

    def gradients(some, images):
        problem = Problem(PAINTED, some, albedo="colors", judged=True)
        problem.phase("fit", 1, {"vertices": Sgd(1000.0), "colors": Sgd(1.0)}, [Loss("color")], SOFT["outline"])
        with runtime.load(gpu.compile(problem.program), gpu.device) as session:
            session.set("targets", images)
            before = {key: session.get(key).astype(float) for key in ("vertices", "colors")}
            session.step(1)
            return {key: array - session.get(key) for key, array in before.items()}

    batch = gradients(views, targets)
    alone = [gradients(views[k:k + 1], targets[k:k + 1]) for k in range(2)]
    for key, g in batch.items():
        mean = (alone[0][key] + alone[1][key]) / 2
        assert np.linalg.norm(mean) > 1e-4
        assert np.linalg.norm(g - mean) < 2e-3 * np.linalg.norm(mean), key


# Scenes


def moved(camera: Camera, rotation: np.ndarray, translation: np.ndarray, scale: float) -> Camera:
    """The camera that sees scale (R x + t) as the given one sees x."""
    pose = camera.world_to_camera.copy()
    pose[:3, :3] = pose[:3, :3] @ rotation.T
    pose[:3, 3] = scale * (camera.world_to_camera[:3, 3] - pose[:3, :3] @ translation)
    return dataclasses.replace(camera, world_to_camera=pose, near=scale * camera.near, far=scale * camera.far)


def test_a_scene_moved_turned_and_scaled_with_its_camera_is_the_same_picture(gpu):
    camera, = cameras(1, (200, 150))
    plain = picture(gpu, PAINTED, [camera])
    turn = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    for rotation, translation, scale in ((np.eye(3), np.zeros(3), 4.0), (turn, np.array([0.5, -0.25, 1.0]), 0.5)):
        mesh = dataclasses.replace(PAINTED, positions=scale * (PAINTED.positions @ rotation.T + translation))
        nearly(picture(gpu, mesh, [moved(camera, rotation, translation, scale)]), plain, 0 if scale == 4.0 else 8)


@pytest.mark.parametrize("soft", ["outline", pytest.param("hard", marks=pytest.mark.full)])
def test_a_crop_by_the_principal_point_is_the_crop_of_the_picture(gpu, soft):
    camera, = cameras(1, (200, 150))
    x, y, w, h = 71, 38, 83, 67
    crop = dataclasses.replace(camera, cx=camera.cx - x, cy=camera.cy - y, width=w, height=h)
    whole, part = picture(gpu, PAINTED, [camera], soft)[0, y:y + h, x:x + w], picture(gpu, PAINTED, [crop], soft)[0]
    inner = slice(4, -4)  # what is outline at the border of a picture depends on what is beyond it
    nearly(part[inner, inner], whole[inner, inner], 8)


def test_an_image_twice_as_large_is_made_of_the_same_shape(gpu):
    """Four pixels for one: their mean is the coarse picture but at the outline, and every coarse pixel well inside is inside."""
    camera, = cameras(1, (111, 83))
    coarse, fine = picture(gpu, PAINTED, [camera], "hard")[0], picture(gpu, PAINTED, [camera.resized(222, 166)], "hard")[0]
    mean = fine.reshape(83, 2, 111, 2, 4).mean((1, 3))
    full = (mean[..., 3] == 1) & (coarse[..., 3] == 1)
    assert full.mean() > 0.05 and np.abs(mean - coarse)[full].mean() < 5e-3
    assert np.abs(mean[..., 3].sum() - coarse[..., 3].sum()) < 0.02 * coarse[..., 3].sum()


# What leaves work out


HOW = [{"domains": False}, {"cache": False}, {"stage_packing": False}, pytest.param({"naive": True}, marks=pytest.mark.full)]


@pytest.mark.parametrize("how", HOW, ids=lambda how: next(iter(how)))
def test_how_it_is_compiled_changes_no_bit_of_a_picture(gpu, how):
    views = cameras(1, (200, 150))
    np.testing.assert_array_equal(picture(gpu, PAINTED, views, compiled=how, **SUN), picture(gpu, PAINTED, views, **SUN))
