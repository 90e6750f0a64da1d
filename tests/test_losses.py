"""Losses of images, landmarks, lengths of edges: values against NumPy, gradients against central differences of that."""

import numpy as np
import pytest
from corpus import icosahedron
from test_objective import check, differences

from dressi_edge.cache.errors import GraphError, InputError
from dressi_edge.cache.layout import Layout
from dressi_edge.compiler.graph.autodiff import gradients
from dressi_edge.compiler.graph.program import Program
from dressi_edge.compiler.graph.reference import evaluate
from dressi_edge.compiler.graph.reference_session import ReferenceSession
from dressi_edge.compiler.io.cameras import look_at
from dressi_edge.compiler.io.meshes import Mesh
from dressi_edge.compiler.io.shapes import icosphere
from dressi_edge.compiler.render.topology import Topology
from dressi_edge.compiler.scene import (
    Adam,
    F,
    Outline,
    Scene,
    Sgd,
    charbonnier,
    depth_loss,
    edge_length,
    face_points,
    huber,
    l1,
    l2,
    landmarks,
    mean_square,
    normal_loss,
    pyramid_l1,
    ssim,
    ssim_loss,
    tint,
    total_variation,
)

pytest_plugins = ["gpu"]

CELL = (7, 6)


def numbers(vtype, seed=5, size=(14, 12), low=0.0):
    """An image of cells of 7 x 6, its layout and node."""
    layout = Layout("image", vtype, *size)
    return np.random.default_rng(seed).uniform(low, 1.0, layout.shape), layout, Program().input(f"a{seed}", layout)


def agrees(loss, loop, vtype="vec3", low=0.0, size=(14, 12)):
    """The loss of two images is the loop's, its gradient by both the loop's central difference. loss, loop: of image and target."""
    (a, layout, x), (b, _, y) = numbers(vtype, 5, size, low), numbers(vtype, 6, size, low)
    node = loss(x, y)
    feed = {"a5": layout.to_image(a, "a"), "a6": layout.to_image(b, "b")}
    value, by_a, by_b = evaluate([node, *gradients(node, [x, y])], feed)
    np.testing.assert_allclose(value.item(), loop(a, b), rtol=1e-11, atol=1e-13)
    np.testing.assert_allclose(layout.from_image(by_a), differences(lambda q: loop(q, b), a), rtol=2e-5, atol=1e-8)
    np.testing.assert_allclose(layout.from_image(by_b), differences(lambda q: loop(a, q), b), rtol=2e-5, atol=1e-8)


def huber_loop(d, delta):
    size = abs(d)
    return np.where(size <= delta, d * d / 2, delta * (size - delta / 2))


MASK = np.random.default_rng(9).uniform(size=(12, 14))


def weigh(term, masked):
    """The mean of (h, w) or (h, w, c) terms, weighted."""
    return (term * ((MASK if term.ndim == 2 else MASK[..., None]) if masked else 1.0)).mean()


@pytest.mark.parametrize("vtype", ["float", "vec3", "vec4"])
@pytest.mark.parametrize("masked", [False, True])
def test_huber_and_charbonnier_are_means_over_texels_and_channels(vtype, masked):
    mask = F.constant(MASK[..., None]) if masked else None
    agrees(lambda a, b: huber(a, b, 0.3, mask), lambda a, b: weigh(huber_loop(a - b, 0.3), masked), vtype)
    agrees(lambda a, b: charbonnier(a, b, 0.05, mask), lambda a, b: weigh(np.sqrt((a - b) ** 2 + 0.0025) - 0.05, masked), vtype)


def test_charbonnier_keeps_small_differences():
    x = F.constant(np.full((1, 1, 1), 1e-9))
    assert np.isclose(evaluate([charbonnier(x, 0.0, 1.0)], {})[0].item(), 5e-19, rtol=1e-12)


def test_mean_square_is_of_entries_and_channels_without_padding():
    k = np.random.default_rng(1).normal(size=(37, 3))
    node = Program().state("k", layout := Layout("table", "vec3", count=37))
    pixels = layout.to_image(k, "k")
    pixels.reshape(-1, 3)[37:] = 1e6
    value, gradient = evaluate([r := mean_square(node), *gradients(r, [node])], {"k": pixels})
    np.testing.assert_allclose(value.item(), (k * k).mean())
    np.testing.assert_allclose(layout.from_image(gradient), 2 * k / k.size)


@pytest.mark.parametrize("power", [1, 2])
@pytest.mark.parametrize("cell", [None, CELL])
@pytest.mark.parametrize("vtype, masked", [("float", True), ("vec3", False), ("vec3", True)])
def test_total_variation_compares_texels_with_those_beside_and_below_in_their_cell(power, cell, vtype, masked):
    w, h = cell or (14, 12)

    def loop(a, b):
        x, weights = (a * b).reshape(12, 14, -1), MASK if masked else np.ones((12, 14))
        return sum((abs(x.take(k + 1, axis) - x.take(k, axis)) ** power * weights.take(k, axis)[..., None]).sum()
                   for axis, size in ((1, w), (0, h)) for k in range(x.shape[axis]) if (k + 1) % size) / x.size

    agrees(lambda a, b: total_variation(a * b, power, cell, F.constant(MASK[..., None]) if masked else None), loop, vtype)


@pytest.mark.parametrize("vtype, masked", [("vec2", False), ("vec3", True), ("vec4", True)])
def test_tint_is_how_far_a_texel_is_from_the_mean_of_its_channels(vtype, masked):
    def loop(a, b):
        x = (a * b).reshape(12, 14, -1)
        return (abs(x - x.mean(axis=-1, keepdims=True)).sum(axis=-1) * (MASK if masked else 1.0)).sum() / x.size

    agrees(lambda a, b: tint(a * b, F.constant(MASK[..., None]) if masked else None), loop, vtype)


def test_grey_of_any_brightness_has_no_tint():
    grey = F.constant(np.repeat(np.array([0.0, 0.25, 1.0, 8.0]).reshape(2, 2, 1), 3, -1))
    assert evaluate([tint(grey)], {})[0].item() == 0.0


def cells_of(x, cell=CELL):
    """The cells of an image (h, w, ...), row by row."""
    w, h = cell
    return [x[j:j + h, i:i + w] for j in range(0, x.shape[0], h) for i in range(0, x.shape[1], w)]


def ssim_loop(a, b, window, sigma, peak):
    """Of two images (h, w), texel by texel, with weights that add up to 1 within the image."""
    out, reach = np.zeros(a.shape), window // 2
    for y, x in np.ndindex(a.shape):
        ys, xs = (np.arange(max(p - reach, 0), min(p + reach + 1, n)) for p, n in ((y, a.shape[0]), (x, a.shape[1])))
        w = np.exp(-((ys - y)[:, None] ** 2 + (xs - x) ** 2) / (2 * sigma ** 2))
        w /= w.sum()
        p, q = a[np.ix_(ys, xs)], b[np.ix_(ys, xs)]
        mp, mq = (w * p).sum(), (w * q).sum()
        pp, qq, pq = (w * (p - mp) ** 2).sum(), (w * (q - mq) ** 2).sum(), (w * (p - mp) * (q - mq)).sum()
        c1, c2 = (0.01 * peak) ** 2, (0.03 * peak) ** 2
        out[y, x] = (2 * mp * mq + c1) * (2 * pq + c2) / ((mp ** 2 + mq ** 2 + c1) * (pp + qq + c2))
    return out


def ssim_cells(a, b, window=5, sigma=1.1, peak=1.0, cell=CELL):
    out = np.zeros(a.shape)
    for image, p, q in zip(*(cells_of(x, cell) for x in (out, a, b))):
        for c in map((slice(None), slice(None)).__add__, np.ndindex(a.shape[2:])):
            image[c] = ssim_loop(p[c], q[c], window, sigma, peak)
    return out


@pytest.mark.parametrize("vtype", ["float", "vec2"])
def test_ssim_is_that_of_wang_within_each_cell(vtype):
    (a, layout, x), (b, _, y) = numbers(vtype, 5), numbers(vtype, 6)
    feed = {"a5": layout.to_image(a, "a"), "a6": layout.to_image(b, "b")}
    for settings in ({"window": 5, "sigma": 1.1}, {"window": 11, "sigma": 1.5, "peak": 2.0}):
        found, = evaluate([ssim(x, y, CELL, **settings)], feed)
        np.testing.assert_allclose(layout.from_image(found), ssim_cells(a, b, **settings), rtol=1e-9, atol=1e-12)
    same, = evaluate([ssim(x, x, CELL)], feed)
    np.testing.assert_allclose(same, 1.0, rtol=1e-12)


def test_the_loss_of_ssim_has_its_gradient():
    mask, small = MASK[:4, :6], {"cell": (3, 4), "window": 3, "sigma": 0.8}
    agrees(lambda a, b: ssim_loss(a, b, F.constant(mask[..., None]), **small),
           lambda a, b: ((1 - ssim_cells(a, b, **small)) * mask).mean(), "float", size=(6, 4))


def test_ssim_beside_one_colour_is_that_beside_an_image_of_it():
    a, layout, x = numbers("vec3")
    one, many = evaluate([ssim(x, F.compose(0.2, 0.4, 0.6), CELL), ssim(x, F.constant(np.full((12, 14, 3), (0.2, 0.4, 0.6))), CELL)],
                         {"a5": layout.to_image(a, "a")})
    np.testing.assert_allclose(one, many, rtol=1e-12)


def halves(x):
    """Cells of x, each as its half by means of up to 2 x 2 texels."""
    return [np.array([[c[j:j + 2, i:i + 2].mean((0, 1)) for i in range(0, c.shape[1], 2)] for j in range(0, c.shape[0], 2)]) for c in x]


@pytest.mark.parametrize("levels, masked", [(1, False), (2, False), (4, True)])
def test_the_pyramid_is_the_mean_of_the_l1_of_each_half(levels, masked):
    def loop(a, b):
        cells, found = cells_of((a - b) * (mask[..., None] if masked else 1.0)), []
        for _ in range(levels):
            found.append(np.mean([abs(c).mean() for c in cells]))
            cells = halves(cells)
        return np.mean(found)

    mask = MASK[:6]
    agrees(lambda a, b: pyramid_l1(a, b, levels, CELL, F.constant(mask[..., None]) if masked else None), loop, size=(14, 6))


def test_the_pyramid_draws_a_blob_to_where_it_should_be_though_they_do_not_meet():
    """Where an L1 of texels has no slope, its coarse levels have."""
    target = np.zeros((1, 16, 1))
    target[0, 12:14] = 1

    def at(k):
        image = np.zeros((1, 16, 1))
        image[0, k:k + 2] = 1
        return [x.item() for x in evaluate([f(F.constant(image), F.constant(target)) for f in (l1, lambda a, b: pyramid_l1(a, b, 5))], {})]

    (far, far_pyramid), (near, near_pyramid) = at(2), at(8)
    assert far == near and near_pyramid < 0.95 * far_pyramid


def test_depths_are_compared_where_both_see_something():
    def loop(a, b):
        return np.where((a > 0) & (b > 0), huber_loop(a - b, 0.2), 0.0).mean()

    agrees(lambda a, b: depth_loss(a, b, 0.2), loop, "float", low=-0.4)
    agrees(lambda a, b: depth_loss(a, b, 0.2, F.constant(MASK[..., None])),
           lambda a, b: (np.where((a > 0) & (b > 0), huber_loop(a - b, 0.2), 0.0) * MASK).mean(), "float", low=-0.4)
    nothing, far = F.constant(np.zeros((2, 2, 1))), F.constant(np.full((2, 2, 1), 3.0))
    assert evaluate([depth_loss(nothing, far), depth_loss(far, nothing)], {}) == [0.0, 0.0]


def test_normals_are_compared_by_the_cosine_where_neither_is_zero():
    (a, layout, x), (b, _, y) = numbers("vec3", 5, low=-1.0), numbers("vec3", 6, low=-1.0)
    a[2, 3] = b[4, 5] = 0.0
    a[5], b[6] = -b[5] * 2.0, a[6] * 3.0

    def loop(p, q):
        size = np.linalg.norm(p, axis=2) * np.linalg.norm(q, axis=2)
        return np.where(size > 1e-9, 1 - (p * q).sum(2) / np.maximum(size, 1e-12), 0).mean()

    node = normal_loss(x, y)
    value, gradient = evaluate([node, *gradients(node, [x])], {"a5": layout.to_image(a, "a"), "a6": layout.to_image(b, "b")})
    np.testing.assert_allclose(value.item(), loop(a, b), rtol=1e-12)
    expected = differences(lambda q: loop(q, b), a)
    expected[2, 3] = 0.0
    np.testing.assert_allclose(layout.from_image(gradient), expected, rtol=1e-5, atol=1e-8)


def edges_loop(p, f, rest):
    """rest: a number, or by pairs of vertices."""
    pairs = sorted({(min(a, b), max(a, b)) for t in f for a, b in ((t[0], t[1]), (t[1], t[2]), (t[2], t[0]))})
    return np.mean([(np.linalg.norm(p[a] - p[b]) - (rest[a, b] if isinstance(rest, dict) else rest)) ** 2 for a, b in pairs])


def test_edge_lengths_are_compared_with_a_rest_or_one_for_each():
    p, f = icosahedron()
    p = p + np.random.default_rng(3).normal(scale=0.1, size=p.shape)
    topology = Topology(f, len(p))
    lengths = np.random.default_rng(4).uniform(0.5, 1.5, len(topology.edges))
    each = {tuple(e): x for e, x in zip(topology.edges.tolist(), lengths)}
    check(lambda x: edge_length(x, topology), lambda q: edges_loop(q, f, 0.0), p)
    check(lambda x: edge_length(x, topology, 0.9), lambda q: edges_loop(q, f, 0.9), p)
    check(lambda x: edge_length(x, topology, lengths), lambda q: edges_loop(q, f, each), p)


# Landmarks, and all of it in a scene

BALL = icosphere(1)
CAMERAS = [look_at(eye, (0.1, 0.0, 0.0), (0, 1, 0), 40.0, 24, 20) for eye in ((0.3, 0.4, 3.0), (2.5, 1.0, 1.5), (-2.0, 0.5, 2.2))]


def pixels_of(points):
    """(views, P, 2), by the camera's definition."""
    out = []
    for c in CAMERAS:
        q = points @ c.world_to_camera[:3, :3].T + c.world_to_camera[:3, 3]
        out.append(np.stack([c.cx + c.fx * q[:, 0] / -q[:, 2], c.cy - c.fy * q[:, 1] / -q[:, 2]], 1))
    return np.array(out)


PLACES = {"face": np.array([0, 7, 33, 60]), "weights": np.array([[0.2, 0.3, 0.5], [1, 0, 0], [0.1, 0.8, 0.1], [0.3, 0.3, 0.4]])}


def points_loop(positions):
    return (positions[BALL.faces[PLACES["face"]]] * PLACES["weights"][..., None]).sum(1)


@pytest.fixture
def scene():
    s = Scene(CAMERAS)
    x = s.parameter("vertices", BALL.positions)
    s.add(BALL, x)
    return s, x, face_points(x, BALL.faces, PLACES["face"], PLACES["weights"])


@pytest.mark.parametrize("delta", [None, 1.5])
@pytest.mark.parametrize("weighted", [False, True])
def test_landmarks_are_distances_in_pixels_of_points_of_faces(scene, delta, weighted):
    s, x, points = scene
    rng = np.random.default_rng(2)
    targets = pixels_of(points_loop(BALL.positions)) + rng.normal(scale=2.0, size=(3, 4, 2))
    weights = rng.uniform(size=(3, 4)) if weighted else None

    def loop(p):
        d = pixels_of(points_loop(p)) - targets
        term = d * d if delta is None else huber_loop(d, delta)
        return (term * (1.0 if weights is None else weights[..., None])).mean()

    loss = landmarks(s.frame(), points, targets, weights, delta=delta)
    layout = s.program.values["vertices"].layout
    value, gradient = evaluate([loss, *gradients(loss, [x])], {"vertices": layout.to_image(BALL.positions, "p")})
    np.testing.assert_allclose(value.item(), loop(BALL.positions), rtol=1e-9)
    np.testing.assert_allclose(layout.from_image(gradient), differences(loop, BALL.positions.copy()), rtol=1e-5, atol=1e-7)


def test_landmarks_behind_the_part_are_left_out_on_request(scene):
    s, x, _ = scene
    towards = np.array(CAMERAS[0].position) / np.linalg.norm(CAMERAS[0].position)
    side = BALL.positions @ towards
    chosen = np.array([side.argmax(), side.argmin(), side.argsort()[-2]])
    points, targets = F.lookup(x, chosen), pixels_of(BALL.positions[chosen]) + 1.0
    frame, feed = s.frame(Outline(1.0)), {"vertices": s.program.values["vertices"].layout.to_image(BALL.positions, "p")}
    only_first = np.array([[1.0, 1, 1], [0, 0, 0], [0, 0, 0]])
    every, seen = (x.item() for x in evaluate([landmarks(frame, points, targets, only_first),
                                               landmarks(frame, points, targets, only_first, hidden=0.1)], feed))
    np.testing.assert_allclose((every, seen), (3 / 9, 2 / 9), rtol=1e-9)


def test_landmarks_behind_the_eye_count_for_nothing():
    s = Scene([look_at((0, 0, 1.0), (0, 0, 0), (0, 1, 0), 40.0, 24, 20)])
    s.add(BALL, x := s.parameter("vertices", BALL.positions * [1, 1, 3]))
    back = np.array([int(BALL.positions[:, 2].argmax())])
    loss = landmarks(s.frame(), F.lookup(x, back), np.zeros((1, 1, 2)))
    value, gradient = evaluate([loss, *gradients(loss, [x])], {"vertices": s.program.values["vertices"].layout.to_image(
        BALL.positions * [1, 1, 3], "p")})
    assert value.item() == 0 and not gradient.any()


def test_one_view_a_step_has_its_own_landmarks(scene):
    s, x, points = scene
    targets = pixels_of(points_loop(BALL.positions)) + np.arange(3)[:, None, None]
    t = s.input("targets", targets.reshape(-1, 2), kind="table")
    frame = s.frame(phase="fit", order="cycle")
    s.phase("fit", 3, {"vertices": Sgd(0.0)}, points=landmarks(frame, points, t, np.ones((3, 4))))
    with ReferenceSession(s.program) as session:
        found = []
        for _ in range(3):
            found.append(session.loss())
            session.step()
    np.testing.assert_allclose(found, [0, 1, 4], atol=1e-9)


def test_weights_of_views_lie_over_their_pixels(scene):
    s, x, _ = scene
    feed = {"vertices": s.program.values["vertices"].layout.to_image(BALL.positions, "p"), "fit.step": np.full((1, 1, 1), 2)}
    every, one = s.frame(), s.frame(phase="fit", order="cycle")
    colours = np.arange(9.0).reshape(3, 3)
    over, own = evaluate([every.per_view([1.0, 2.0, 5.0]), one.per_view(colours)], feed)
    found = s.pictures_layout("float").from_image(over)
    assert [set(np.unique(cell)) for cell in found] == [{1.0}, {2.0}, {5.0}]
    assert one.cell == (24, 20) and (own == colours[2]).all()
    with pytest.raises(InputError, match=r"shape \(2,\); \(3,\)"):
        every.per_view([1.0, 2.0])


def several(cameras):
    """A scene with targets of every kind and a mask that is an image of its own, and what they would be of the shape as it is."""
    s = Scene(cameras)
    x = s.parameter("vertices", BALL.positions)
    s.add(BALL, x)
    frame, targets = s.frame(Outline(2.0)), {}
    seen = {"color": frame.color, "mask": frame.mask, "depth": frame.depth, "normal": frame.normal}
    for key, node in seen.items():
        targets[key] = s.input(key, shape=s.pictures_layout(node.vtype).shape)
    weigh = targets["mask"] * frame.per_view(np.linspace(1.0, 0.5, len(cameras)))
    marks = landmarks(frame, F.lookup(x, [0, 5, 9]), s.input("marks", np.zeros((3 * len(cameras), 2)), kind="table"), hidden=0.2)
    s.phase("fit", 10, {"vertices": Adam(0.01)}, paint=huber(frame.color, targets["color"], 0.1, weigh),
            similar=(0.2, ssim_loss(frame.color, targets["color"], targets["mask"], frame.cell, 5)),
            far=depth_loss(frame.depth, targets["depth"], 0.1), turned=(0.1, normal_loss(frame.normal, targets["normal"])),
            points=(1e-4, marks))
    return s, seen


def test_a_device_has_the_references_terms_and_first_step(gpu):
    s, seen = several(CAMERAS[:2])
    values, shifted = s.program.values, BALL.positions * 1.1 + (0.05, 0.02, 0.0)
    drawn = evaluate(list(seen.values()), {"vertices": values["vertices"].layout.to_image(shifted, "p")})
    targets = {key: values[key].layout.from_image(image) for key, image in zip(seen, drawn)}
    targets["marks"] = pixels_of(shifted[[0, 5, 9]])[:2].reshape(-1, 2) + np.random.default_rng(0).normal(size=(6, 2))
    with ReferenceSession(s.program) as reference, gpu.open(s.program) as session:
        for each in (reference, session):
            for name, array in targets.items():
                each.set(name, array)
        for term in ("paint", "similar", "far", "turned", "points"):
            assert reference.get(f"fit.{term}") > 0
            np.testing.assert_allclose(session.get(f"fit.{term}"), reference.get(f"fit.{term}"), rtol=2e-4, err_msg=term)
        reference.step(1, "fit")
        session.step(1, "fit")
        moved, expected = (each.get("vertices.adam_m") for each in (session, reference))
        np.testing.assert_allclose(moved, expected, atol=1e-3 * abs(expected).max())
    gpu.silent()


IMAGE = F.constant(np.zeros((12, 14, 3)))
GREY = F.constant(np.zeros((12, 14, 1)))
P = F.constant_table(np.zeros((42, 3)))


@pytest.mark.parametrize("make, message", [
    (lambda: huber(IMAGE, IMAGE, 0.0), "huber: delta is 0.0; a number above 0"),
    (lambda: huber(IMAGE, F.constant(np.zeros((12, 14, 2)))), "has 3 channels, its target .* has 2"),
    (lambda: charbonnier(IMAGE, IMAGE, "small"), "charbonnier: epsilon is 'small'"),
    (lambda: charbonnier(3.0, IMAGE), "charbonnier: the image is 3.0"),
    (lambda: mean_square(4), "mean_square: 4; a float"),
    (lambda: tint(F.constant(np.zeros((2, 2, 1)))), "tint: the image is .* a vec image is needed"),
    (lambda: tint(0.5), "tint: the image is 0.5"),
    (lambda: total_variation(IMAGE, 3), "total_variation: power is 3; 1 or 2"),
    (lambda: total_variation([1.0]), r"total_variation: the image is \[1.0\]"),
    (lambda: total_variation(IMAGE, cell=(5, 6)), "not made of whole cells of 5 x 6"),
    (lambda: pyramid_l1(IMAGE, IMAGE, 6), r"pyramid_l1: 6 levels of cells of 14 x 12; 1 to 5"),
    (lambda: pyramid_l1(IMAGE, IMAGE, 2, (5, 6)), "not made of whole cells of 5 x 6"),
    (lambda: ssim(IMAGE, IMAGE, CELL, window=4), "the window is 4 texels wide; an odd number"),
    (lambda: ssim(IMAGE, IMAGE, CELL, sigma=-1), "ssim: sigma is -1"),
    (lambda: ssim_loss(IMAGE, IMAGE, IMAGE), "mask .* is not a float image"),
    (lambda: depth_loss(IMAGE, IMAGE), "the depth is .*; a float image"),
    (lambda: normal_loss(IMAGE, GREY), "normal_loss: .* vec3 images are needed"),
    (lambda: edge_length(P, Topology(BALL.faces, 42), -1.0), "edge_length: rest is -1.0; a length from 0 on"),
    (lambda: edge_length(P, Topology(BALL.faces, 42), np.ones(7)), "one for each of 120 edges"),
    (lambda: face_points(P, BALL.faces, np.array([99]), np.ones((1, 3))), "faces 99 to 99; 0 to 79"),
    (lambda: face_points(P, BALL.faces, np.array([1]), np.ones((2, 3))), r"barycentrics \(2, 3\)"),
])
def test_what_a_loss_cannot_take_is_named(make, message):
    with pytest.raises(GraphError, match=message) as caught:
        make()
    assert "\n" not in str(caught.value)


def test_landmarks_of_the_wrong_shape_are_named(scene):
    s, x, points = scene
    frame = s.frame()
    for arguments, message in (((IMAGE.x, np.zeros((3, 4, 2))), "points are"), ((points, np.zeros((3, 5, 2))), r"\(3, 4, 2\), are needed"),
                               ((points, np.zeros((3, 4, 2)), np.ones(4)), r"weights have shape \(4,\)"),
                               ((points, P.xy), "targets are .* 3 views x 4 points")):
        with pytest.raises(GraphError, match=message):
            landmarks(frame, *arguments)


def test_a_mesh_is_pulled_to_its_landmarks():
    """Three corners of a triangle, known in two pictures only."""
    s = Scene(CAMERAS[:2])
    true = np.array([[0.0, 0, 0], [0.7, 0.1, 0.1], [0.1, 0.6, -0.2]])
    x = s.parameter("vertices", true + [[0.2, 0, 0.1], [0, -0.2, 0], [0.1, 0.1, 0.1]])
    s.add(Mesh(true, [[0, 1, 2]]), x)
    s.phase("fit", 200, {"vertices": Adam(0.02)}, marks=landmarks(s.frame(), x, pixels_of(true)[:2]))
    with ReferenceSession(s.program) as session:
        session.step(200)
        assert abs(session.get("vertices") - true).max() < 0.01


def test_l1_and_l2_refuse_what_they_cannot_compare():
    for loss in (l1, l2):
        with pytest.raises(GraphError, match="has 3 channels"):
            loss(IMAGE, F.constant(np.zeros((12, 14, 4))))
