"""Claims that pin the oracle of distance "outline" to cases known without it."""

import brute_force
import numpy as np
import pytest
from brute_force import Rendered
from brute_force_outline import gradient, render, select
from corpus import scenes
from test_brute_force import centres, from_screen, logistic

SCENES = scenes()
SIZE = (24, 24)
each_scene = pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)


def box(x0, y0, x1, y1):
    return [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]


BOX_FACES = [(0, 1, 2), (0, 2, 3)]


def boxes(*corners, depth):
    """Clip coordinates and faces of upright boxes of two faces each."""
    points = np.concatenate([box(*c) for c in corners])
    faces = np.concatenate([np.array(BOX_FACES) + 4 * k for k in range(len(corners))])
    return from_screen(points, SIZE, depth=np.repeat(depth, 4)), faces


def test_a_disc_fades_on_both_sides_of_its_rim_and_its_spokes_do_not_count():
    size, radius, n, r = (40, 40), 12.0, 128, 4.0
    centre = np.array([20.1, 19.8])
    angle = np.arange(n) * 2 * np.pi / n
    rim = centre + radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    faces = [(0, 1 + i, 1 + (i + 1) % n) for i in range(n)]
    out = render(from_screen([centre, *rim], size), faces, size, r)
    distance = radius - np.linalg.norm(centres(size) - centre, axis=-1)
    sagitta = radius * (1 - np.cos(np.pi / n))
    near = np.abs(distance) < r - sagitta
    assert np.allclose(out.silhouette[near], logistic(distance[near] / (r / 7)), atol=sagitta * 7 / r / 4)
    assert np.allclose(np.abs(out.dist[..., 0][near]), np.abs(distance[near]), atol=sagitta)
    assert (out.silhouette[distance > r] == 1).all()
    assert (out.silhouette[distance < -r - sagitta] == 0).all()


def test_the_line_between_the_halves_of_a_square_does_not_count():
    low, high, r = 5.3, 17.3, 3.0
    clip, faces = boxes((low, low, high, high), depth=[0.5])
    out = render(clip, faces, SIZE, r)
    x, y = np.moveaxis(centres(SIZE), -1, 0)
    inside = np.minimum(np.minimum(x - low, high - x), np.minimum(y - low, high - y))
    assert np.array_equal(out.hard, inside > 0)
    assert np.allclose(out.silhouette[out.hard], np.where(inside <= r, logistic(inside * 7 / r), 1)[out.hard])


def test_an_edge_in_front_of_another_face_is_no_outline():
    clip, faces = boxes((8.2, 8.3, 15.1, 15.4), (2.2, 2.2, 21.8, 21.8), depth=[0.3, 0.6])
    out = render(clip, faces, SIZE, 3.0)
    x, y = np.moveaxis(centres(SIZE), -1, 0)
    middle = (np.abs(x - 12) < 6) & (np.abs(y - 12) < 6)
    assert (out.silhouette[middle] == 1).all()
    assert not out.edge_mask[middle].any()
    assert set(out.face[middle].ravel()) == {0, 1, 2, 3}


def test_a_hidden_edge_that_is_nearer_leaves_the_outline_its_place():
    clip, faces = boxes((4.3, 4.3, 19.3, 19.3), (5.2, 2.2, 12.2, 21.3), depth=[0.3, 0.6])
    hidden = select(clip, faces, SIZE, 3.0)
    assert hidden.front[10, 5] in (0, 1)
    nearest = sorted(hidden.ends[hidden.edge[10, 5]])
    assert nearest == [0, 3], "0.7 pixels left of x = 5.2, the side of the box behind, lies the box in front; left of x = 4.3 nothing"


@pytest.mark.parametrize("left, beside", [(12.4, False), (12.6, True)], ids=["covered", "uncovered"])
def test_the_pixel_that_holds_the_point_one_pixel_beyond_the_edge_decides(left, beside):
    clip, faces = boxes((2.2, 2.2, 11.6, 21.7), (left, 2.2, 21.8, 21.7), depth=[0.5, 0.5])
    out = render(clip, faces, SIZE, 3.0)
    assert out.hard[12, 12] != beside, "x = 11.6 + 1 lies in pixel 12, whose centre the other box covers or not"
    assert out.edge_mask[12, 10] == beside
    assert np.isclose(out.silhouette[12, 10], logistic((11.6 - 10.5) * 7 / 3) if beside else 1)


def test_beyond_the_border_of_the_image_lies_what_lies_at_the_border():
    clip, faces = boxes((-0.7, 2.2, 12.3, 25.0), depth=[0.5])  # its left side is outside the image, 0.7 pixels from it
    out = render(clip, faces, SIZE, 3.0)
    assert out.hard[10, 0]
    assert not out.edge_mask[10, :9].any()
    assert (out.silhouette[10, :9] == 1).all()


def test_a_fold_counts_and_an_edge_between_two_sides_does_not():
    third, size = {"fold": (17.0, 12.4), "flat": (7.1, 12.4)}, SIZE
    for name, corner in third.items():
        clip = from_screen([(12.3, 3.2), (12.3, 21.1), (20.4, 12.2), corner], size, depth=[0.5, 0.5, 0.5, 0.7])
        out = render(clip, [(0, 1, 2), (0, 1, 3)], size, 3.0)
        assert out.edge_mask[12, 12] == out.edge_mask[12, 11] == (name == "fold")
        assert np.isclose(out.silhouette[12, 12], logistic(0.2 * 7 / 3) if name == "fold" else 1)


def test_an_edge_of_three_faces_counts():
    clip = from_screen([(12.3, 3.2), (12.3, 21.1), (20.4, 12.2), (4.1, 12.4), (4.2, 20.0)], SIZE)
    sheet = [(0, 1, 2), (0, 1, 3)]
    two, three = (select(clip, faces, SIZE, 3.0) for faces in (sheet, [*sheet, (0, 1, 4)]))
    assert two.edge[12, 12] == -1
    assert three.edge[12, 12] == -1, "both sides of it are covered"
    flat = [(12.3, 3.2), (12.3, 21.1), (20.4, 12.2), (16.0, 12.4), (18.2, 20.0)]
    one_sided = select(from_screen(flat, SIZE), [*sheet, (0, 1, 4)], SIZE, 3.0)
    assert one_sided.ends[one_sided.edge[12, 12]].tolist() == [0, 1]


def test_an_uncovered_pixel_has_the_lowest_face_of_its_edge_and_the_colour_of_the_nearest_point():
    points = np.array([(6.2, 6.3), (17.1, 7.7), (9.3, 16.4), (20.0, 19.0)])
    out = render(from_screen(points, SIZE), [(3, 1, 2), (0, 1, 2)], SIZE, r=4, attributes=points)
    soft = ~out.hard & (out.face[..., 0] >= 0)
    nearest = out.color[soft] / out.silhouette[soft][:, None]
    assert soft.sum() > 50
    assert np.allclose(np.linalg.norm(nearest - centres(SIZE)[soft], axis=-1), -out.dist[soft][:, 0])
    assert out.face[4, 12, 0] == 1
    assert out.face[18, 13, 0] == 0


def test_of_equal_edges_the_first_is_taken():
    clip, faces = boxes((6.2, 6.2, 17.2, 17.2), (6.2, 6.2, 17.2, 17.2), depth=[0.5, 0.5])
    out = render(clip, faces, SIZE, 3.0)
    assert set(out.face[out.face >= 0]) == {0, 1}


@each_scene
def test_uncovered_pixels_near_covered_ones_are_those_of_face_distance(scene):
    s, r = scene, 3.0
    how = dict(faces=s.faces, size=s.size, r=r, near=s.near, attributes=s.attributes)
    ours, paper = render(s.clip, **how), brute_force.render(s.clip, **how)
    cut = [brute_force.distance_to_near_cut(s.clip[f], centres(s.size), s.size, s.near) for f in s.faces]
    soft = ~paper.hard & paper.edge_mask & (np.min(cut, axis=0) > r)  # the near cut is no edge, nor does it hide the ones behind it
    assert np.allclose(ours.silhouette[soft], paper.silhouette[soft])
    assert np.array_equal(ours.hard, paper.hard)
    sure = soft & (paper.margin_color > 1e-6) & (ours.margin_color > 1e-6)
    assert np.allclose(ours.color[sure], paper.color[sure])
    inside = ours.hard & ~ours.edge_mask
    assert (ours.silhouette[inside] == 1).all()


@pytest.mark.parametrize("name", ["quad", "icosphere", "intersecting", "one_behind", "near_cut", "odd_size"])
def test_the_gradient_is_that_of_the_whole_render_where_the_margin_allows(name):
    s, r, h, rng = SCENES[name], 3.0, 1e-5, np.random.default_rng(0)
    fixed = dict(faces=s.faces, size=s.size, r=r, near=s.near)
    base = render(s.clip, attributes=s.attributes, **fixed)
    weight = rng.normal(size=base.color.shape) * (base.margin_gradient > 0.01)[..., None]
    assert (base.margin_gradient > 0.01)[base.edge_mask].mean() > 0.8

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
    fixed = dict(faces=s.faces, size=s.size, r=4.0, near=s.near)
    base, chosen = render(s.clip, **fixed), select(s.clip, **fixed)
    for _ in range(5):
        moved = s.clip.copy()
        moved[:, :2] += shake * rng.uniform(-1, 1, size=(len(moved), 2)) * 2 / np.array(s.size) * moved[:, 3:]
        out, again = render(moved, **fixed), select(moved, **fixed)
        sure, surest = base.margin > 1e-2, base.margin_color > 1e-2
        assert np.array_equal(out.hard[sure], base.hard[sure])
        assert np.array_equal(out.edge_mask[sure], base.edge_mask[sure])
        assert np.abs(out.silhouette - base.silhouette)[sure].max(initial=0) < 1e-2
        assert np.array_equal(out.face[surest & base.hard], base.face[surest & base.hard])
        smooth = (base.margin_gradient > 1e-2) & base.edge_mask
        before, after = chosen.ends[chosen.edge[smooth]], again.ends[again.edge[smooth]]
        assert (before[:, :, None] == after[:, None]).any(axis=(1, 2)).all(), "the same edge, or one that has its nearest vertex too"


@each_scene
def test_the_picture_does_not_depend_on_the_order_of_corners(scene):
    s, rng = scene, np.random.default_rng(2)
    faces = np.array([rng.permutation(face) for face in s.faces])
    outs = [render(s.clip, f, s.size, r=4, near=s.near, attributes=s.attributes) for f in (s.faces, faces)]
    for a, b in zip(*outs, strict=True):
        assert np.array_equal(a, b)


@each_scene
def test_results_are_finite_and_in_range(scene):
    s = scene
    out = render(s.clip, s.faces, s.size, r=4, near=s.near, attributes=s.attributes)
    assert out.silhouette.shape == s.size[::-1]
    assert (out.silhouette >= 0).all() and (out.silhouette <= 1).all()
    assert (out.color >= -1e-12).all() and (out.color <= 1 + 1e-12).all()
    assert not np.isnan(out.dist).any()
    assert (out.margin_color <= out.margin).all() and (out.margin_gradient <= out.margin).all()


def test_no_faces_is_the_background():
    out = render(np.zeros((0, 4)), np.zeros((0, 3), int), (5, 4), r=2, attributes=np.zeros((0, 3)), background=(1, 0, 0.5))
    assert np.array_equal(out.color, np.broadcast_to((1, 0, 0.5), (4, 5, 3)))
    assert (out.face == -1).all()
