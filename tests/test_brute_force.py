"""Claims that pin the oracle of the renderer tests to cases known without it."""

import numpy as np
import pytest
from brute_force import Rendered, gradient, render, select
from corpus import scenes

SCENES = scenes()
each_scene = pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)


def from_screen(points, size, w=1.0, depth=0.5):
    """Clip coordinates of points in pixels."""
    points = np.array(points, np.float64)
    w, depth = np.broadcast_to(w, len(points)), np.broadcast_to(depth, len(points))
    ndc = points / np.array(size) * 2 - 1
    return np.concatenate([ndc * w[:, None], (depth * w)[:, None], w[:, None]], axis=1)


def centres(size):
    return np.stack(np.meshgrid(np.arange(size[0]) + 0.5, np.arange(size[1]) + 0.5), axis=-1)


def logistic(x):
    return 1 / (1 + np.exp(-x))


@pytest.mark.parametrize("w", [1.0, (0.5, 2.0, 3.0)], ids=["flat", "tilted"])
@pytest.mark.parametrize("face", [(0, 1, 2), (2, 1, 0)], ids=["clockwise", "counterclockwise"])
def test_the_distance_to_a_right_triangle_is_that_to_its_lines_and_corners(w, face):
    size, low, high = (24, 20), 4.2, 16.2
    out = render(from_screen([(low, low), (high, low), (low, high)], size, w), [face], size, r=30)
    x, y = np.moveaxis(centres(size), -1, 0)
    inside = np.minimum(np.minimum(x - low, y - low), (low + high - x - y) / np.sqrt(2))
    dist = out.dist[..., 0]
    assert np.array_equal(out.hard, inside >= 0)
    assert np.allclose(dist[out.hard], inside[out.hard])
    corner, left, diagonal = (x < low) & (y < low), (x < low) & (y > low) & (y < high), (x > low) & (y > low) & (abs(x - y) < 8)
    assert np.allclose(dist[corner], -np.hypot(low - x, low - y)[corner])
    assert np.allclose(dist[left], (x - low)[left])
    assert np.allclose(dist[diagonal & ~out.hard], inside[diagonal & ~out.hard])


def test_the_two_halves_of_a_square_tile_it():
    size, low, high = (24, 24), 5.3, 17.3
    clip = from_screen([(low, low), (high, low), (high, high), (low, high)], size)
    out = render(clip, [(0, 1, 2), (0, 2, 3)], size, r=5, layers=2)
    x, y = np.moveaxis(centres(size), -1, 0)
    box = np.minimum(np.minimum(x - low, high - x), np.minimum(y - low, high - y))
    off_diagonal = np.abs(x - y) > 0.1
    assert np.array_equal(out.hard, box > 0)
    assert out.hard.sum() == 144
    assert np.allclose(out.dist[..., 0][out.hard], np.minimum(box, np.abs(x - y) / np.sqrt(2))[out.hard])
    second = out.hard & off_diagonal & (np.abs(x - y) / np.sqrt(2) < 5)
    assert (out.dist[second][:, 1] < 0).all(), "the other half lies behind as a soft face"
    assert np.array_equal(out.face[..., 0][out.hard & off_diagonal], np.where(x > y, 0, 1)[out.hard & off_diagonal])


def test_a_fan_covers_its_disc_and_fades_with_the_distance_to_it():
    size, radius, n, r = (40, 40), 12.0, 128, 4.0
    centre = np.array([20.1, 19.8])
    angle = np.arange(n) * 2 * np.pi / n
    rim = centre + radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    faces = [(0, 1 + i, 1 + (i + 1) % n) for i in range(n)]
    out = render(from_screen([centre, *rim], size), faces, size, r)
    distance = radius - np.linalg.norm(centres(size) - centre, axis=-1)
    sagitta = radius * (1 - np.cos(np.pi / n))
    sure = np.abs(distance) > sagitta
    assert abs(out.hard.sum() / (np.pi * radius**2) - 1) < 0.02
    assert np.array_equal(out.hard[sure], distance[sure] > 0)
    ring = sure & (distance < 0) & (distance > -r)
    assert np.allclose(out.dist[ring][:, 0], distance[ring], atol=sagitta)
    assert np.allclose(out.silhouette[ring], logistic(distance[ring] / (r / 7)), atol=sagitta * 7 / r / 4)
    assert (out.silhouette[distance < -r - sagitta] == 0).all()


def test_layers_are_hard_by_depth_then_soft_by_distance_then_by_index():
    size = (16, 16)
    big = [(1.1, 1.1), (15.1, 1.1), (1.1, 15.1)]
    near_by, further = [(10.2, 10.2), (15.2, 10.2), (10.2, 15.2)], [(11.2, 11.2), (15.2, 11.2), (11.2, 15.2)]
    clip = from_screen([*further, *near_by, *big, *big, *big], size, depth=np.repeat([0.1, 0.2, 0.9, 0.5, 0.5], 3))
    out = render(clip, np.arange(15).reshape(5, 3), size, r=9, layers=6)
    assert out.face[5, 5].tolist() == [3, 4, 2, 1, 0, -1]
    assert (out.dist[5, 5, :3] > 0).all()
    assert (out.dist[5, 5, 3:5] < 0).all()
    assert out.dist[5, 5, 5] == -np.inf


def test_the_silhouette_and_colour_of_a_layer_are_the_equations():
    s, r, sigma = SCENES["overlapping"], 5.0, 0.8
    out = render(s.clip, s.faces, s.size, r, sigma, layers=2, near=s.near, attributes=s.attributes, background=(0.1, 0.2, 0.3))
    d = np.where(np.isfinite(out.dist), logistic(out.dist / sigma), 0)
    assert np.allclose(out.silhouette, np.where(out.edge_mask, d[..., 0] + d[..., 1] - d[..., 0] * d[..., 1], out.hard))
    assert np.allclose(out.color[out.silhouette == 0], (0.1, 0.2, 0.3))
    flat = render(s.clip, s.faces, s.size, r, sigma, layers=2, near=s.near, attributes=np.ones((6, 1)))
    assert np.allclose(flat.color[..., 0], out.silhouette)


def test_the_edge_mask_is_a_square_neighbourhood_of_the_outline():
    size = (20, 20)
    clip = from_screen([(6.2, -50), (120, 6.2), (6.2, 120)], size)  # the half plane x > 6.2
    for delta, first, last in ((0.0, 0, 0), (0.5, 5, 7), (1.0, 5, 7), (2.5, 3, 9)):
        out = render(clip, [(0, 1, 2)], size, r=3, delta=delta)
        assert np.array_equal(np.flatnonzero(out.edge_mask[10]), np.arange(first, last))


def test_a_pixel_whose_edge_mask_hangs_on_a_doubtful_neighbour_has_a_small_margin():
    size = (20, 20)
    clip = from_screen([(6.501, -50), (120, 6.2), (6.501, 120)], size)  # passes the centres of column 6 by 0.001
    margin = render(clip, [(0, 1, 2)], size, r=2.3, delta=1.0).margin[10]
    assert np.flatnonzero(margin < 0.0011).tolist() == [5, 6, 7]
    quad = from_screen([(-50, -50), (90, -50.5), (90, 90), (-50.5, 90)], size)
    quad_margin = render(quad, [(0, 1, 2), (0, 2, 3)], size, r=2.3, delta=1.0, layers=2).margin
    x, y = np.moveaxis(centres(size), -1, 0)
    assert (quad_margin[np.abs(x - y) == 1] > 0.1).all(), "an inner edge is no outline"


def test_the_silhouette_is_continuous_while_an_edge_passes_a_pixel():
    size, r, step = (24, 24), 3.0, 0.01
    values = []
    for x in np.arange(9.1, 12.1, step):
        out = render(from_screen([(x, -20.3), (x, 44.2), (60.0, 12.1)], size), [(0, 1, 2)], size, r)
        values.append(out.silhouette[12, 10])
    assert np.abs(np.diff(values)).max() <= step / (4 * r / 7) + 1e-12, "the slope of the sigmoid is at most 1 / (4 sigma)"
    assert values[0] > 0.9
    assert values[-1] < 0.1
    assert abs(values[140] - 0.5) < 1e-6, "x = 10.5 is on the pixel's centre"


@pytest.mark.parametrize("order", [(0, 1, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)], ids=str)
@pytest.mark.parametrize("name", ["acute", "one_behind", "two_behind", "near_cut"])
def test_a_face_through_the_near_plane_is_its_clipped_polygon_without_the_side_of_the_cut(name, order):
    s, r = SCENES[name], 3.0
    clip = s.clip[list(order)]
    polygon = []
    for a, b in zip(clip, np.roll(clip, -1, axis=0), strict=True):  # Sutherland and Hodgman
        if a[3] >= s.near:
            polygon.append((*a, 0))
        if (a[3] < s.near) != (b[3] < s.near):
            polygon.append((*(a + (s.near - a[3]) / (b[3] - a[3]) * (b - a)), 1))
    polygon = np.array(polygon)
    on_cut = polygon[:, 4] == 1
    polygon = (polygon[:, :2] / polygon[:, 3:4] + 1) / 2 * s.size
    p = centres(s.size)
    sides, distances, cut = [], [], np.full(p.shape[:2], np.inf)
    for i in range(len(polygon)):
        j = (i + 1) % len(polygon)
        along, to = polygon[j] - polygon[i], p - polygon[i]
        sides.append(along[0] * to[..., 1] - along[1] * to[..., 0])
        t = np.clip(to @ along / (along @ along), 0, 1)
        distance = np.linalg.norm(to - t[..., None] * along, axis=-1)
        if on_cut[i] and on_cut[j]:
            cut = distance
        else:
            distances.append(distance)
    covered = (np.array(sides) > 0).all(axis=0) | (np.array(sides) < 0).all(axis=0)
    d = np.min(distances, axis=0)
    out = render(clip, [(0, 1, 2)], s.size, r, near=s.near)
    assert 0 < covered.sum() < covered.size
    assert np.array_equal(out.hard, covered)
    assert np.array_equal(out.face[..., 0] == 0, covered | (d <= r))
    assert np.allclose(out.dist[..., 0], np.where(covered, d, np.where(d <= r, -d, -np.inf)))
    bound = np.minimum(np.minimum(d, cut), np.where(covered, np.inf, np.abs(d - r)))
    assert (out.margin <= bound + 1e-9).all()
    own = out.margin >= bound - 1e-9  # elsewhere a neighbour decides, by the edge mask
    assert own.mean() > 0.3


def test_a_face_behind_the_camera_or_off_screen_draws_nothing():
    for name in ("behind", "off_screen"):
        s = SCENES[name]
        assert (render(s.clip, s.faces, s.size, r=4, near=s.near).face == -1).all()


def test_colour_is_perspective_correct():
    s = SCENES["larger_than_screen"]
    out = render(s.clip, s.faces, s.size, r=2, near=s.near, attributes=s.clip[:, [3, 0]])
    assert out.hard.all()
    ndc_x = (centres(s.size) / s.size * 2 - 1)[..., 0]
    w, x = np.moveaxis(out.color, -1, 0)
    assert np.allclose(x / w, ndc_x), "a point of the face projects to the pixel that shows it"
    plane = np.linalg.lstsq(s.clip[:, [0, 1, 3]], np.ones(3), rcond=None)[0]  # plane . (x, y, w) = 1
    p = centres(s.size) / s.size * 2 - 1
    assert np.allclose(w, 1 / (p @ plane[:2] + plane[2]))


def test_a_soft_fragment_takes_the_colour_of_the_nearest_point():
    size = (24, 24)
    points = np.array([(6.2, 6.3), (17.1, 7.7), (9.3, 16.4)])
    out = render(from_screen(points, size), [(0, 1, 2)], size, r=4, attributes=points)
    soft = out.edge_mask & ~out.hard & (out.face[..., 0] >= 0)
    nearest = out.color[soft] / out.silhouette[soft][:, None]
    assert soft.sum() > 50
    assert np.allclose(np.linalg.norm(nearest - centres(size)[soft], axis=-1), -out.dist[soft][:, 0])


def test_the_gradient_of_one_pixel_by_an_edge_is_the_sigmoid_slope_shared_by_lever():
    size, r, edge_x, top, bottom = (24, 24), 4.0, 8.3, -10.0, 40.0
    sigma = r / 7
    clip = from_screen([(edge_x, top), (edge_x, bottom), (70.0, 12.0)], size, w=(1.0, 2.0, 1.5))
    for x in (5, 7, 8, 10):
        for y in (3, 17):
            got = gradient(lambda out, x=x, y=y: out.silhouette[y, x], clip, [(0, 1, 2)], size, r).clip
            d = logistic((x + 0.5 - edge_x) / sigma)
            share = (y + 0.5 - top) / (bottom - top)
            by_pixel = -d * (1 - d) / sigma * np.array([1 - share, share, 0])
            assert np.allclose(got[:, 0], by_pixel * size[0] / 2 / clip[:, 3], atol=1e-7)
            assert np.allclose(got[:, 1], 0, atol=1e-7)
            assert np.allclose(got[:, 3], -got[:, 0] * clip[:, 0] / clip[:, 3], atol=1e-7), "screen x is x / w"


@pytest.mark.parametrize("name", ["quad", "icosphere", "intersecting", "one_behind", "near_cut", "odd_size"])
def test_the_gradient_is_that_of_the_whole_render_where_the_margin_allows(name):
    s, r, h, rng = SCENES[name], 3.0, 1e-5, np.random.default_rng(0)
    fixed = dict(faces=s.faces, size=s.size, r=r, layers=3, near=s.near)
    base = render(s.clip, attributes=s.attributes, **fixed)
    weight = rng.normal(size=base.color.shape) * (base.margin_gradient > 0.01)[..., None]

    def loss(out: Rendered):
        return float((weight * out.color).sum() + (weight[..., 0] * out.silhouette**2).sum())

    got = gradient(loss, s.clip, attributes=s.attributes, **fixed)
    for _ in range(5):
        by_clip, by_attributes = rng.normal(size=s.clip.shape), rng.normal(size=s.attributes.shape)
        ends = [render(s.clip + t * by_clip, attributes=s.attributes + t * by_attributes, **fixed) for t in (h, -h)]
        slope = (loss(ends[0]) - loss(ends[1])) / (2 * h)
        assert np.isclose(slope, (got.clip * by_clip).sum() + (got.attributes * by_attributes).sum(), rtol=1e-4, atol=1e-4)


@each_scene
def test_nothing_beyond_its_margin_changes_when_vertices_shake(scene):
    s, rng, shake = scene, np.random.default_rng(1), 1e-4
    fixed = dict(faces=s.faces, size=s.size, r=4.0, layers=3, near=s.near)
    base = render(s.clip, **fixed)
    for _ in range(5):
        moved = s.clip.copy()
        moved[:, :2] += shake * rng.uniform(-1, 1, size=(len(moved), 2)) * 2 / np.array(s.size) * moved[:, 3:]
        out = render(moved, **fixed)
        sure, surest = base.margin > 1e-2, base.margin_color > 1e-2
        assert np.array_equal(out.hard[sure], base.hard[sure])
        assert np.array_equal(out.edge_mask[sure], base.edge_mask[sure])
        assert np.abs(out.silhouette - base.silhouette)[sure].max(initial=0) < 1e-2
        assert np.array_equal(out.face[surest], base.face[surest])


@each_scene
def test_the_picture_does_not_depend_on_the_order_of_corners(scene):
    s, rng = scene, np.random.default_rng(2)
    faces = np.array([rng.permutation(face) for face in s.faces])
    outs = [render(s.clip, f, s.size, r=4, layers=2, near=s.near, attributes=s.attributes) for f in (s.faces, faces)]
    for a, b in zip(*outs, strict=True):
        assert np.array_equal(a, b)


@each_scene
def test_results_are_finite_and_in_range(scene):
    s = scene
    out = render(s.clip, s.faces, s.size, r=4, layers=3, near=s.near, attributes=s.attributes)
    assert out.silhouette.shape == s.size[::-1]
    assert (out.silhouette >= 0).all()
    assert (out.silhouette <= 1).all()
    assert (out.color >= -1e-12).all()
    assert (out.color <= 1 + 1e-12).all()
    assert not np.isnan(out.dist).any()
    assert (out.margin_color <= out.margin).all()
    assert (out.margin_gradient <= out.margin + 1e-9).all()


def test_no_faces_is_the_background():
    out = render(
        np.zeros((0, 4)), np.zeros((0, 3), int), (5, 4), r=2, layers=2, attributes=np.zeros((0, 3)), background=(1, 0, 0.5)
    )
    assert np.array_equal(out.color, np.broadcast_to((1, 0, 0.5), (4, 5, 3)))
    assert (out.face == -1).all()


def test_more_layers_than_faces_are_empty():
    s = SCENES["acute"]
    one, many = (select(s.clip, s.faces, s.size, 4.0, layers=k, near=s.near) for k in (1, 4))
    assert np.array_equal(one.face[..., 0], many.face[..., 0])
    assert (many.face[..., 1:] == -1).all()
