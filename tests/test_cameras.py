"""Cameras of a scene: orthographic ones, principal points off the centre, pictures of different sizes, backgrounds; against rays cast
through pixel centres and the brute-force oracle, which know cameras by their definition alone."""

import warnings
from dataclasses import replace

import brute_force
import brute_force_outline
import numpy as np
import pytest
from corpus import icosahedron, rotation

from dressi_edge.cache.errors import InputError
from dressi_edge.compiler.graph.autodiff import gradients
from dressi_edge.compiler.graph.reference import evaluate
from dressi_edge.compiler.io.cameras import Camera, look_along, look_at
from dressi_edge.compiler.scene import (
    BlinnPhong,
    F,
    HardSoftRas,
    Light,
    Mesh,
    Outline,
    Scene,
    Unlit,
    Vertex,
    l2,
    landmarks,
)
from dressi_edge.compiler.scene.sense import check, sight

pytest_plugins = ["gpu"]

BALL, FACES = icosahedron()
RNG = np.random.default_rng(3)


def two_balls():
    """Two that cut through each other, a third behind, all one mesh."""
    points = np.concatenate([0.6 * BALL @ rotation(1).T, 0.5 * BALL @ rotation(2).T + (0.5, 0.3, 0.2), 0.7 * BALL + (-0.4, 0.2, -1.6)])
    return Mesh(points, np.concatenate([FACES + 12 * k for k in range(3)]), colors=RNG.uniform(size=(36, 3)))


MESH = two_balls()
POSE = look_at((0.4, 0.7, 4.0), (0.1, 0.1, 0), (0, 1, 0), 40.0, 24, 20).world_to_camera
FLAT = Camera(POSE, 8.0, 7.0, 13.3, 8.2, 24, 20, 1.0, 8.0, "orthographic")
OFF = Camera(POSE, 30.0, 27.0, 17.4, 5.1, 24, 20)


def clip_of(camera, positions):
    """Clip coordinates by docs/conventions.md."""
    c = camera
    x, y, z = (positions @ c.world_to_camera[:3, :3].T + c.world_to_camera[:3, 3]).T
    w = np.ones(len(x)) if c.kind == "orthographic" else -z
    depth = (-z - c.near) / (c.far - c.near) if c.kind == "orthographic" else c.far * (w - c.near) / (c.far - c.near)
    return np.stack([2 * (c.cx * w + c.fx * x) / c.width - w, 2 * (c.cy * w - c.fy * y) / c.height - w, depth, w], 1)


def cast(camera, mesh):
    """Depth along the axis, face and barycentrics of the first hit of a ray through each pixel's centre; depth 0 and face -1 without."""
    c = camera
    p = mesh.positions @ c.world_to_camera[:3, :3].T + c.world_to_camera[:3, 3]
    ys, xs = np.mgrid[:c.height, :c.width] + 0.5
    u, v = ((xs - c.cx) / c.fx).ravel(), ((c.cy - ys) / c.fy).ravel()
    flat = c.kind == "orthographic"
    depth, face, weights = np.full(len(u), np.inf), np.full(len(u), -1), np.zeros((len(u), 3))
    for number, t in enumerate(mesh.faces):
        for k in range(len(u)):  # corners times weights - direction times depth = origin
            origin, way = (np.array([u[k], v[k], 0]), np.array([0, 0, -1])) if flat else (np.zeros(3), np.array([u[k], v[k], -1]))
            system = np.vstack([np.column_stack([p[t].T, -way]), [1, 1, 1, 0]])
            if abs(np.linalg.det(system)) < 1e-12:
                continue
            *b, t_hit = np.linalg.solve(system, [*origin, 1])
            if min(b) >= 0 and t_hit < depth[k] and (flat or t_hit > c.near):
                depth[k], face[k], weights[k] = t_hit, number, b
    shape = (c.height, c.width)
    return np.where(face < 0, 0, depth).reshape(shape), face.reshape(shape), weights.reshape(*shape, 3)


def scene_of(cameras, material=None, background=(0.0, 0.0, 0.0), mesh=MESH):
    s = Scene(cameras, background)
    x = s.parameter("vertices", mesh.positions)
    s.add(mesh, x, material or Unlit(Vertex(F.constant_table(mesh.colors))))
    return s, x


def fed(s, **more):
    return {"vertices": s.program.values["vertices"].layout.to_image(s.program.values["vertices"].initial, "p"), **more}


def seen(s, *nodes, **more):
    """Values of nodes in the shape (views, height, width[, c])."""
    return [s.pictures_layout(n.vtype).from_image(x) for n, x in zip(nodes, evaluate(list(nodes), fed(s, **more)))]


@pytest.mark.parametrize("camera", [FLAT, OFF, replace(FLAT, cx=-3.0, fx=12.0)], ids=["orthographic", "off centre", "far off centre"])
def test_a_picture_is_what_rays_through_its_pixels_meet(camera):
    s, _ = scene_of([camera])
    frame = s.frame(Outline(1.0))
    depth, face, weights = cast(camera, MESH)
    assert 30 < (face >= 0).sum() < 400
    found_depth, found_face, mask, color = (x[0] for x in seen(s, frame.depth, frame.face, frame.mask, frame.of(
        lambda surface: surface.vertex(F.constant_table(MESH.colors)))))
    np.testing.assert_array_equal(found_face, face)
    np.testing.assert_array_equal(mask, face >= 0)
    np.testing.assert_allclose(found_depth, depth, rtol=1e-9)
    expected = (MESH.colors[MESH.faces[face]] * weights[..., None]).sum(2) * (face >= 0)[..., None]
    np.testing.assert_allclose(color, expected, atol=1e-9)


@pytest.mark.parametrize("renderer, oracle, settings", [(Outline(2.3), brute_force_outline, {}),
                                                        (HardSoftRas(2.3, 2), brute_force, {"layers": 2})], ids=["outline", "face"])
def test_orthographic_silhouettes_colours_and_gradients_are_the_oracles(renderer, oracle, settings):
    s, x = scene_of([FLAT])
    frame = s.frame(renderer)
    by_alpha, by_color = RNG.normal(size=(20, 24)), RNG.normal(size=(20, 24, 3))
    settings = {"r": 2.3, "near": 0.5, "attributes": MESH.colors, "background": np.zeros(3), **settings}
    expected = oracle.render(clip_of(FLAT, MESH.positions), MESH.faces, (24, 20), **settings)
    alpha, color = (p[0] for p in seen(s, frame.alpha, frame.color))
    np.testing.assert_allclose(alpha, expected.silhouette, atol=1e-9)
    np.testing.assert_allclose(color, expected.color, atol=1e-9)

    def loss_of(rendered):
        return (rendered.silhouette * by_alpha).sum() + (rendered.color * by_color).sum()

    slope = oracle.gradient(loss_of, clip_of(FLAT, MESH.positions), MESH.faces, (24, 20), **settings).clip
    jacobian = np.array([clip_of(FLAT, MESH.positions + step) - clip_of(FLAT, MESH.positions) for step in np.eye(3)])  # clip is linear
    loss = F.total(frame.alpha * F.constant(by_alpha[..., None])) + F.total(F.dot(frame.color, F.constant(by_color)))
    found = s.program.values["vertices"].layout.from_image(evaluate(gradients(loss, [x]), fed(s))[0])
    np.testing.assert_allclose(found, np.einsum("avk,vk->va", jacobian[..., [0, 1, 3]], slope[:, [0, 1, 3]]), rtol=1e-4, atol=2e-5)


def test_an_orthographic_camera_sees_along_its_axis_whatever_the_distance():
    s, _ = scene_of([FLAT], BlinnPhong((0.5, 0.5, 0.5), 0.5, 8.0, [Light("directional", 1.0, (0.3, -0.5, -1.0))]))
    frame = s.frame(Outline(1.0))
    mask, depth, distance, towards, color = (x[0] for x in seen(s, frame.mask, frame.depth, frame.distance,
                                                               frame.of(lambda surface: surface.to_eye), frame.color))
    np.testing.assert_allclose(distance, depth)
    np.testing.assert_allclose(towards[mask > 0], np.tile(POSE[2, :3], (int(mask.sum()), 1)), atol=1e-12)
    back = POSE.copy()
    back[2, 3] -= 2.0
    moved, _ = scene_of([replace(FLAT, world_to_camera=back, near=3.0, far=10.0)], s.parts[0].material)
    again = moved.frame(Outline(1.0))
    further, same = (x[0] for x in seen(moved, again.depth, again.color))
    np.testing.assert_allclose(further, depth + 2.0 * mask)
    np.testing.assert_allclose(same, color, atol=1e-12)


@pytest.mark.parametrize("near, far", [(4.4, 8.0), (-9.0, 4.0)], ids=["in front of near", "beyond far"])
def test_neither_plane_of_an_orthographic_camera_cuts(near, far):
    found = []
    for camera in (FLAT, replace(FLAT, near=near, far=far)):
        s, _ = scene_of([camera])
        frame = s.frame(Outline(1.5))
        found.append(seen(s, frame.alpha, frame.mask))
    for a, b in zip(*found):
        np.testing.assert_array_equal(a, b)


def test_landmarks_and_poses_of_orthographic_cameras():
    s, x = scene_of([FLAT, OFF])
    turn, move = (s.parameter(name, np.zeros((2, 3)), kind="table") for name in ("turn", "move"))
    s.pose_cameras(turn, move)
    pixels = []
    for c in s.cameras:
        clip = clip_of(c, MESH.positions[[3, 20]])
        pixels.append((clip[:, :2] / clip[:, 3:] + 1) / 2 * (24, 20))
    loss = landmarks(s.frame(), F.lookup(x, [3, 20]), np.array(pixels) + (1.0, 0.0))
    zero = s.program.values["turn"].layout.to_image(np.zeros((2, 3)), "t")
    value, by_move = evaluate([loss, *gradients(loss, [move])], fed(s, turn=zero, move=zero))
    np.testing.assert_allclose(value.item(), 0.5)
    by_move = by_move.reshape(-1, 3)[:2]
    np.testing.assert_allclose(by_move[0], (-FLAT.fx / 2, 0, 0), atol=1e-9)  # two points of four, each twice its distance of 1, over 8
    assert by_move[1, 2] != 0


# Pictures of different sizes

SMALL = [look_at((0.3, 0.4, 5.0), (0, 0, -0.3), (0, 1, 0), 40.0, 14, 18), look_along((3, 1, 2), (0, 0, -0.3), (0, 1, 0), 4.0, 22, 11),
         look_at((-3.4, 0.5, 3.2), (0, 0, -0.3), (0, 1, 0), 44.0, 16, 16)]


def test_each_picture_is_as_if_it_were_alone_in_the_upper_left_of_its_view():
    s, _ = scene_of(SMALL)
    frame = s.frame(Outline(1.2))
    assert (s.width, s.height) == (22, 18) and frame.cell == (22, 18)
    together = seen(s, frame.valid, frame.alpha, frame.color, frame.depth, frame.face)
    for k, camera in enumerate(SMALL):
        alone, _ = scene_of([camera])
        own = alone.frame(Outline(1.2))
        w, h = camera.width, camera.height
        valid = together[0][k]
        assert (valid[:h, :w] == 1).all() and valid.sum() == w * h
        for a, b in zip(together[1:], seen(alone, own.alpha, own.color, own.depth, own.face)):
            np.testing.assert_allclose(a[k, :h, :w], b[0], atol=1e-9)
    assert (seen(alone, own.valid)[0] == 1).all()


def test_beside_its_picture_a_view_is_drawn_on():
    """What lies there is the picture of the same camera with a larger size."""
    wide = replace(SMALL[0], width=22, fx=60.0)
    s, _ = scene_of([replace(wide, width=7), SMALL[1], replace(wide, height=9)])
    frame, (whole, _) = s.frame(Outline(1.2)), scene_of([wide])
    expected = seen(whole, whole.frame(Outline(1.2)).alpha)[0][0]
    found = seen(s, frame.alpha)[0]
    np.testing.assert_allclose(found[0], expected, atol=1e-9)
    np.testing.assert_allclose(found[2], expected, atol=1e-9)
    assert expected[:, 7:].any() and expected[9:].any()


def test_a_loss_masked_by_what_is_valid_is_that_of_the_pictures():
    s, _ = scene_of(SMALL)
    pictures = [RNG.uniform(size=(c.height, c.width)) for c in SMALL]
    target = F.constant(s.pictures_layout("float").to_image(s.padded(pictures, fill=9.0), "t"))
    frame = s.frame(Outline(1.2))
    value, = evaluate([l2(frame.alpha, target, frame.valid)], fed(s))
    alpha, = seen(s, frame.alpha)
    cut = [a[:c.height, :c.width] for a, c in zip(alpha, SMALL)]
    np.testing.assert_allclose(value.item(), sum(((a - p) ** 2).sum() for a, p in zip(cut, pictures)) / s.atlas.extent.count)


def test_one_view_a_step_has_its_own_size_and_background():
    pictures = [RNG.uniform(size=(c.height, c.width, 3)) for c in SMALL]
    s, _ = scene_of(SMALL, background=pictures)
    frame, every = s.frame(Outline(1.2), phase="fit", order="cycle"), s.frame(Outline(1.2))
    all_valid, all_color, all_alpha = seen(s, every.valid, every.color, every.alpha)
    for k, c in enumerate(SMALL):
        valid, color = evaluate([frame.valid, frame.color], fed(s, **{"fit.step": np.full((1, 1, 1), k)}))
        np.testing.assert_array_equal(valid[..., 0], all_valid[k])
        np.testing.assert_allclose(color, all_color[k], atol=1e-12)
        clear = all_alpha[k, :c.height, :c.width] == 0
        assert clear.any()
        np.testing.assert_array_equal(all_color[k, :c.height, :c.width][clear], pictures[k][clear])


@pytest.mark.parametrize("background", [(0.2, 0.5, 0.9), RNG.uniform(size=(2, 20, 24, 3))], ids=["colour", "pictures"])
def test_colours_lie_over_the_background(background):
    s, _ = scene_of([FLAT, OFF], Unlit(0.25), background)
    frame = s.frame(Outline(2.0))
    alpha, color = seen(s, frame.alpha, frame.color)
    behind = np.broadcast_to(background, color.shape)
    assert ((alpha > 0.01) & (alpha < 0.99)).sum() > 20
    np.testing.assert_allclose(color, 0.25 * alpha[..., None] + behind * (1 - alpha[..., None]), atol=1e-12)


def test_a_device_draws_cameras_of_all_kinds_and_sizes_in_one_scene(gpu):
    """One of them orthographic, with its near plane within what it sees and its eye in front of nothing."""
    cameras = [SMALL[0], replace(SMALL[1], near=3.7, far=6.0), replace(OFF, width=21)]
    pictures = [RNG.uniform(size=(c.height, c.width, 3)) for c in cameras]
    s, x = scene_of(cameras, background=pictures)
    frame = s.frame(Outline(1.7))
    loss = l2(frame.color, 0.5, frame.valid)
    s.output("seen", alpha=frame.alpha, color=frame.color, depth=frame.depth, valid=frame.valid, mask=frame.mask,
             by=gradients(loss, [x])[0])
    expected = evaluate(list(s.program.plans[-1].outputs.values()), fed(s))
    with gpu.open(s.program) as session:
        for name, image in zip(s.program.plans[-1].outputs, expected):
            layout = s.program.values[name].layout
            size = abs(image).max()
            np.testing.assert_allclose(session.get(name), layout.from_image(image), atol=3e-4 * size, err_msg=name)
    gpu.silent()


@pytest.mark.parametrize("make, message", [
    (lambda: replace(FLAT, kind="fisheye"), "camera kind is 'fisheye'; allowed: perspective orthographic"),
    (lambda: replace(FLAT, fx=0.0), "camera fx is 0.0; it must be above 0"),
    (lambda: replace(FLAT, near=9.0), "camera far is 8.0; it must be above near, 9.0"),
    (lambda: replace(OFF, near=-1.0), "camera near is -1.0; it must be above 0"),
    (lambda: look_along((0, 0, 1), (0, 0, 0), (0, 1, 0), 0.0, 8, 8), "look_along: span is 0.0; a number above 0"),
    (lambda: look_along((0, 1, 0), (0, 0, 0), (0, 1, 0), 1.0, 8, 8), "give another up or move the eye"),
    (lambda: Scene(SMALL).padded([np.zeros((18, 14))]), "1 pictures for 3 cameras"),
    (lambda: Scene(SMALL).padded([np.zeros((18, 14)), np.zeros((11, 22)), np.zeros((16, 17))]), r"2 has shape \(16, 17\); .*\(16, 16"),
    (lambda: Scene(SMALL).padded([np.zeros((18, 14, 3)), np.zeros((11, 22)), np.zeros((16, 16))]), "1 has shape .* as many channels"),
    (lambda: Scene(SMALL, np.zeros((3, 16, 16, 3))), "background has shape"),
    (lambda: Scene(SMALL, [np.zeros((c.height, c.width)) for c in SMALL]), "three numbers, or pictures of three channels"),
])
def test_what_a_camera_or_its_picture_cannot_be_is_named(make, message):
    with pytest.raises(InputError, match=message) as caught:
        make()
    assert "\n" not in str(caught.value)


def test_an_orthographic_start_makes_sense_by_its_own_depths():
    """With clip coordinates whose w is 1, before a near plane of 2 and far from fields of view."""
    camera = look_along((0, 0, 5), (0, 0, 0), (0, 1, 0), 400.0, 32, 32, near=2.0, far=9.0)
    big = Mesh(MESH.positions * (80, 80, 1), MESH.faces)
    found = sight(big, [camera])
    assert found.seen.all() and found.nearer[0] == found.beyond[0] == 0
    np.testing.assert_allclose(found.depth, (5 - MESH.positions[:, 2].max(), 5 - MESH.positions[:, 2].min()))
    assert sight(big, [replace(camera, far=6.0)]).beyond[0] > 0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check(big, [camera])
    with pytest.raises(InputError, match="the mesh is in no view"):
        check(Mesh(MESH.positions + (900, 0, 0), MESH.faces), [camera])


def test_look_along_is_as_high_as_its_span():
    c = look_along((3, 1, 2), (0.5, 0, 0), (0, 1, 0), 4.0, 22, 11)
    assert np.allclose(c.clip_rows() @ (0.5, 0, 0, 1), [0, 0, c.clip_rows()[2] @ (0.5, 0, 0, 1), 1])
    up = c.world_to_camera[1, :3]
    np.testing.assert_allclose((c.clip_rows() @ (*(np.array([0.5, 0, 0]) + 2.0 * up), 1))[:2], (0, -1), atol=1e-12)
    np.testing.assert_allclose(np.concatenate([MESH.positions, np.ones((36, 1))], 1) @ FLAT.clip_rows().T, clip_of(FLAT, MESH.positions))
