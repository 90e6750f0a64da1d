"""Input that tries to break the renderer: each kind has a defined answer, and nothing is ever NaN or Inf. See docs/numerics.md.

Scenes of six vertices and two faces share a few bundles: they differ by what the session is given. Expected images and gradients
are the brute-force oracle's. It has no faces without area: those are its thin faces in the limit.
"""

import hashlib

import brute_force
import fuzz_scenes
import numpy as np
import pytest
from corpus import icosahedron, project
from graphs import layout_of, python, rounded
from test_hardsoftras import MARGIN, relative, render, renderer

from dressi_edge import runtime
from dressi_edge.cache.errors import InputError
from dressi_edge.cache.layout import Layout
from dressi_edge.compiler import Program
from dressi_edge.compiler.autodiff import gradients
from dressi_edge.compiler.functions import constant_table, dot, total
from dressi_edge.compiler.optable import apply
from dressi_edge.compiler.reference import evaluate
from dressi_edge.compiler.render.hardsoftras import Softness
from dressi_edge.compiler.render.objective import cotangent_laplacian, normal_consistency, uniform_laplacian
from dressi_edge.compiler.render.optimizer import Adam, Sgd
from dressi_edge.compiler.render.problem import Loss, Problem
from dressi_edge.compiler.render.texture import sample_texture
from dressi_edge.compiler.scene import Mesh, icosphere, sphere
from dressi_edge.compiler.topology import Topology
from dressi_edge.compiler.views import Views

pytest_plugins = ["gpu"]

SIZE, NEAR = (24, 24), 0.1
PAIR = np.array([(0, 1, 2), (3, 4, 5)])
BASE = np.array([(-0.71, -0.62, -3.1), (0.83, -0.54, -2.7), (0.04, 0.77, -3.4)])
BEHIND = np.array([(-0.7, -0.6, 3.1), (0.8, -0.5, 2.7), (0.0, 0.8, 3.4)])
ATTRIBUTES = np.random.default_rng(0).uniform(size=(6, 3))
SOFT = {"K=1": Softness(3.0), "enlarged": Softness(3.0, folds=False), "K=3": Softness(3.0, layers=3)}


@pytest.fixture(scope="module", params=SOFT)
def pair(request, gpu):
    """A session on two faces of their own vertices, and its softness."""
    softness = SOFT[request.param]
    with gpu.open(renderer(Topology(PAIR, 6), SIZE, softness, NEAR)) as session:
        yield session, softness
    gpu.silent()


def draw(session, clip, size=SIZE, attributes=ATTRIBUTES, weights=1):
    rng = np.random.default_rng(weights)
    by_alpha, by_color = rng.normal(size=(1, *size[::-1])), rng.normal(size=(1, *size[::-1], 3))
    found = render(session, clip=clip, attributes=attributes[:len(clip)], by_alpha=by_alpha, by_color=by_color)
    for name, array in found.items():
        assert np.isfinite(array).all(), name
    return found


def oracle(session, clip, softness, faces=PAIR, size=SIZE, near=NEAR, attributes=ATTRIBUTES, like=None, least=0.6, tolerance=1e-4):
    """Image and gradient of `clip` are the oracle's at `like` (default: there)."""
    clip = rounded(clip)
    like = clip if like is None else like
    attributes = rounded(attributes[:len(clip)])
    how = {"sigma": softness.sigma, "delta": softness.delta, "layers": softness.layers, "near": near, "attributes": attributes,
           "background": np.full(3, 0.25)}
    expected = brute_force.render(like, faces, size, softness.r, **how)
    sure, sure_color = expected.margin > MARGIN, expected.margin_color > MARGIN
    smooth = sure & (expected.margin_gradient > MARGIN)
    assert sure.mean() >= least, sure.mean()
    rng = np.random.default_rng(3)
    by_alpha = rounded(rng.normal(size=smooth.shape)) * smooth
    by_color = rounded(rng.normal(size=(*smooth.shape, 3))) * (smooth & sure_color)[..., None]
    found = render(session, clip=clip, attributes=attributes, by_alpha=by_alpha[None], by_color=by_color[None])
    np.testing.assert_allclose(found["alpha"][0][sure], expected.silhouette[sure], rtol=0, atol=2e-5)
    np.testing.assert_allclose(found["color"][0][sure_color], expected.color[sure_color], rtol=0, atol=5e-5)
    gradient = brute_force.gradient(lambda image: (image.silhouette * by_alpha).sum() + (image.color * by_color).sum(),
                                    like, faces, size, softness.r, **how)
    assert relative(found["by_clip"], gradient.clip) < tolerance
    assert relative(found["by_attributes"], gradient.attributes) < tolerance
    return found


# Faces without area

LINE = np.array([(-0.9, 0.1, -2.5), (-0.1, 0.3, -2.5), (0.7, 0.5, -2.5)])
THIN = np.array([(0, 0, 0), (-2e-5, 8e-5, 0), (0, 0, 0.0)])


def test_a_face_without_area_is_a_thin_one_in_the_limit(pair):
    session, softness = pair
    line = project(np.concatenate([BASE, LINE]), SIZE, NEAR)
    thin = project(np.concatenate([BASE, LINE + THIN]), SIZE, NEAR)
    found = draw(session, line)
    how = {"layers": softness.layers, "near": NEAR, "attributes": ATTRIBUTES, "background": np.full(3, 0.25)}
    expected = brute_force.render(thin, PAIR, SIZE, 3.0, **how)
    sure = expected.margin > MARGIN
    assert sure.mean() > 0.6 and (expected.face[sure] == 1).any()
    np.testing.assert_allclose(found["alpha"][0][sure], expected.silhouette[sure], atol=1e-3)
    assert np.abs(found["by_clip"]).max() < 1e3


def test_a_face_in_one_point_is_finite_and_leaves_the_rest_alone(pair):
    session, _ = pair
    alone = draw(session, project(np.concatenate([BASE, BEHIND]), SIZE, NEAR))
    for point in ((2.0, 0.0, -3.0), (0.0, 0.0, -2.5), (0.83, -0.54, -2.7)):
        found = draw(session, project(np.concatenate([BASE, [point] * 3]), SIZE, NEAR))
        far = np.abs(found["alpha"] - alone["alpha"]) > 1e-6
        ys, xs = np.nonzero(far[0])
        x, y = (project(np.array([point]), SIZE, NEAR)[0, :2] / -point[2] + 1) * 12
        assert (np.hypot(xs + 0.5 - x, ys + 0.5 - y) < 3.001).all(), "a point reaches r and no further"


def test_all_vertices_in_one_point_draw_nothing(pair):
    session, _ = pair
    for point in ((0.0, 0.0, -3.0), (0, 0, 0), (0.4, 0.2, -NEAR)):
        found = draw(session, project(np.array([point] * 6), SIZE, NEAR))
        assert not found["alpha"].any() and not found["by_clip"].any() and not found["by_attributes"].any()


def test_coincident_faces_give_the_lowest_one(pair):
    session, softness = pair
    clip = project(np.concatenate([BASE, BASE]), SIZE, NEAR)
    found = draw(session, clip)
    alone = draw(session, project(np.concatenate([BASE, BEHIND]), SIZE, NEAR))
    if softness.layers == 1:
        for name in ("alpha", "color"):
            np.testing.assert_array_equal(found[name], alone[name], err_msg=name)
        assert not found["by_clip"][3:].any() and not found["by_attributes"][3:].any(), "the second face is not seen"
        np.testing.assert_array_equal(found["by_clip"][:3], alone["by_clip"][:3])
    else:
        edge = (alone["alpha"] > 0) & (alone["alpha"] < 1)
        d = alone["alpha"][edge].astype(np.float64)  # equation 6 of twice the same face
        np.testing.assert_allclose(found["alpha"][edge], 1 - (1 - d) ** 2, atol=1e-6)
        hard = alone["alpha"] == 1
        np.testing.assert_array_equal(found["alpha"][hard], 1)


def test_vertices_that_are_repeated_draw_as_if_they_were_shared(gpu, pair):
    session, softness = pair
    quad = np.array([(-0.7, -0.6, -3), (0.6, -0.7, -3.2), (0.8, 0.5, -3.1), (-0.6, 0.7, -2.8)])
    apart = draw(session, project(quad[[0, 1, 2, 0, 2, 3]], SIZE, NEAR), attributes=np.ones((6, 3)))
    if softness.layers > 1:
        return  # the faces' own edges are layers either way: equal up to which vertex has the gradient
    with gpu.open(renderer(Topology(np.array([(0, 1, 2), (0, 2, 3)]), 4), SIZE, softness, NEAR)) as shared:
        found = draw(shared, project(quad, SIZE, NEAR), attributes=np.ones((4, 3)))
    np.testing.assert_allclose(apart["alpha"], found["alpha"], atol=1e-6)
    sums = np.array([apart["by_clip"][k].sum(0) for k in ([0, 3], [1], [2, 4], [5])])
    np.testing.assert_allclose(sums, found["by_clip"], rtol=1e-4, atol=1e-4)


def test_a_face_that_names_a_vertex_twice_is_no_face():
    topology = Topology(np.array([(0, 1, 2), (3, 3, 1), (0, 2, 3), (2, 0, 2), (1, 1, 1)]), 5)
    np.testing.assert_array_equal(topology.faces, [(0, 1, 2), (0, 2, 3)])
    np.testing.assert_array_equal(topology.kept, [0, 2])
    assert (topology.edges[:, 0] != topology.edges[:, 1]).all(), "no vertex is its own neighbour"
    with pytest.raises(InputError, match="none of 2 faces has three different corners"):
        Topology(np.array([(0, 0, 1), (2, 1, 2)]), 3)


def test_faces_that_name_a_vertex_twice_change_no_regularizer_and_no_image(gpu):
    ball, faces = icosahedron()
    bad = np.insert(faces, [0, 7, 20], [(4, 4, 1), (2, 9, 2), (5, 5, 5)], axis=0)
    layout = Layout("table", "vec3", count=12)
    p = Program().input("p", layout)
    at = {"p": layout.to_image(ball + 0.1 * np.sin(np.arange(36)).reshape(12, 3), "p")}
    for regularizer in (uniform_laplacian, cotangent_laplacian, normal_consistency):
        values = [evaluate([loss := regularizer(p, Topology(f, 12)), *gradients(loss, [p])], at) for f in (faces, bad)]
        for a, b in zip(*values):
            np.testing.assert_array_equal(a, b)
    rng = np.random.default_rng(2)
    uv_faces = rng.integers(0, 9, (23, 3))
    good = (bad != np.roll(bad, 1, axis=1)).all(1)
    images = []
    for f, t in ((bad, uv_faces), (faces, uv_faces[good])):
        mesh = Mesh(0.8 * ball, f, np.linspace(0, 1, 18).reshape(9, 2), t, texture=rng.uniform(size=(4, 4, 3)) * 0 + 0.5)
        problem = Problem(mesh, fuzz_scenes.cameras())
        problem.render("view")
        with gpu.open(problem.program) as session:
            session.set("texture", np.linspace(0, 1, 48).reshape(4, 4, 3))
            images.append(session.get("view.color"))
    assert images[0][..., :3].std() > 0.05
    np.testing.assert_array_equal(*images)


# Sizes and places


@pytest.mark.parametrize("scale", [1e-6, 1e6])
@pytest.mark.parametrize("soft", SOFT)
def test_a_scene_and_its_camera_scaled_together_give_the_same_image(gpu, soft, scale):
    clip = project(np.concatenate([BASE, BASE + (0.4, 0.3, -1.0)]), SIZE, NEAR)
    softness = SOFT[soft]
    with gpu.open(renderer(Topology(PAIR, 6), SIZE, softness, NEAR)) as session:
        expected = draw(session, clip)
    with gpu.open(renderer(Topology(PAIR, 6), SIZE, softness, NEAR * scale)) as session:
        found = draw(session, clip * scale)
    assert expected["alpha"].sum() > 50
    for name in ("alpha", "color"):
        np.testing.assert_allclose(found[name], expected[name], rtol=0, atol=2e-5, err_msg=name)
    assert relative(found["by_clip"] * scale, expected["by_clip"]) < 1e-4
    assert relative(found["by_attributes"], expected["by_attributes"]) < 1e-4


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_regularizers_follow_the_scale(gpu, scale):
    ball, faces = icosahedron()
    layout = Layout("table", "vec3", count=12)
    program = Program()
    p = program.input("p", layout)
    losses = {"uniform": uniform_laplacian, "cotangent": cotangent_laplacian, "consistency": normal_consistency}
    roots = {name: build(p, Topology(faces, 12)) for name, build in losses.items()}
    grads = {f"{name}.by_p": gradients(root, [p])[0] for name, root in roots.items()}
    program.plan("all", {}, {**{name: (root, Layout("unit", "float")) for name, root in roots.items()},
                             **{name: (g, layout) for name, g in grads.items()}})
    at = rounded((ball + 0.1 * np.sin(np.arange(36)).reshape(12, 3)) * scale)
    expected = evaluate([*roots.values(), *grads.values()], {"p": layout.to_image(at, "p")})
    with gpu.open(program) as session:
        session.set("p", at)
        for name, value in zip([*roots, *grads], expected):
            found = session.get(name)
            assert relative(found, layout.from_image(value) if "." in name else value.item()) < 2e-5 or name == "uniform", name


def test_slivers_of_1e5_to_1_are_the_oracle(pair):
    session, softness = pair
    along, across = np.array([1.3, 0.41, 0.0]), np.array([-0.3, 0.95, 0.0])
    sliver = np.array([(-0.6, 0.05, -2.5), (-0.6, 0.05, -2.5) + along, (-0.1, 0.2, -2.5) + across * 1.3e-5])
    oracle(session, project(np.concatenate([BASE, sliver]), SIZE, NEAR), softness, tolerance=1e-3)


def test_vertices_behind_and_at_the_camera(pair):
    session, softness = pair
    oracle(session, project(np.concatenate([BASE, [(-0.9, -0.7, -3.0), (0.8, -0.6, -2.4), (0.3, 0.9, 0.5)]]), SIZE, NEAR), softness)
    oracle(session, project(np.concatenate([BASE, [(-0.9, -0.7, -3.0), (0.8, -0.6, -2.4), (0, 0.1, 0)]]), SIZE, NEAR), softness)
    draw(session, project(np.concatenate([BASE, [(-0.9, -0.7, -3.0), (0.8, -0.6, -2.4), (0, 0, 0)]]), SIZE, NEAR))  # edge on
    on_plane = np.concatenate([BASE, [(-0.9, -0.7, -3.0), (0.8, -0.6, -2.4), (0.01, 0.02, -NEAR)]])
    draw(session, project(on_plane, SIZE, NEAR))


def test_what_is_behind_or_off_screen_is_not_there(pair):
    session, softness = pair
    alone = oracle(session, project(np.concatenate([BASE, BEHIND]), SIZE, NEAR), softness)
    assert not alone["by_clip"][3:].any()
    for where in (BEHIND, BEHIND * 1e5, BASE + (9, 0, 0), BASE - (0, 1e4, 0), BEHIND * (1, 1, 0)):
        other = draw(session, project(np.concatenate([where, where]), SIZE, NEAR))
        assert not other["alpha"].any() and not other["by_clip"].any() and not other["by_attributes"].any()
        beside, first = (draw(session, project(np.concatenate([BASE, x]), SIZE, NEAR)) for x in (where, BEHIND))
        for name in ("alpha", "color", "by_clip"):
            np.testing.assert_array_equal(beside[name], first[name], err_msg=name)


def test_smaller_than_a_pixel(pair):
    session, softness = pair
    dot_ = np.array([(0.0, 0.0, 0), (0.02, 0.0, 0), (0.01, 0.02, 0)])  # 0.2 pixels wide
    for x, seen in ((0.101, False), (0.008, True)):  # of the pixel centre at 12.5, 11.5
        where = (dot_ + ((12.5 - 12.37) / 24 / 1.2 * 3 - 0.009 if seen else x, (11.79 - 11.5) / 24 / 1.2 * 3 - 0.008, -3)) * (1, 1, 1)
        clip = project(np.concatenate([where, BEHIND]), SIZE, NEAR)
        if seen:
            found = oracle(session, clip, softness, least=0.5)
            assert found["alpha"].sum() > 0
        else:
            assert not draw(session, clip)["alpha"].any(), "the edge mask needs a covered pixel"


def test_larger_than_the_screen_is_full_and_has_no_silhouette_gradient(gpu, pair):
    session, softness = pair
    huge = np.array([(-9.0, -7.0, -3.0), (11.0, -6.0, -3.5), (0.4, 12.0, -4.0)])
    clip = project(np.concatenate([huge, BEHIND]), SIZE, NEAR)
    found = render(session, clip=clip, attributes=np.ones((6, 3)), by_alpha=np.ones((1, 24, 24)), by_color=np.ones((1, 24, 24, 3)))
    np.testing.assert_array_equal(found["alpha"], 1)
    np.testing.assert_allclose(found["color"], 1, atol=1e-6)
    np.testing.assert_allclose(found["by_clip"], 0, atol=1e-3)


def test_layers_that_are_not_there_change_nothing(pair, gpu):
    session, softness = pair
    clip = project(np.concatenate([BASE, BEHIND]), SIZE, NEAR)
    with gpu.open(renderer(Topology(PAIR, 6), SIZE, SOFT["enlarged"], NEAR)) as one:
        expected = draw(one, clip)
    found = draw(session, clip)
    np.testing.assert_allclose(found["alpha"], expected["alpha"], atol=1e-7)
    np.testing.assert_allclose(found["color"], expected["color"], atol=1e-6)
    assert relative(found["by_clip"], expected["by_clip"]) < 1e-5


@pytest.mark.parametrize("softness", [Softness(16.0, layers=2), Softness(2.0, sigma=1e-6), Softness(3.0, sigma=1.0, layers=5)],
                         ids=["r_over_mesh", "sigma_1e-6", "sigma_1_K_5"])
def test_extreme_softness_is_the_oracle(gpu, softness):
    clip = project(np.concatenate([BASE * (0.3, 0.3, 1), BASE * (0.2, 0.4, 1) + (0.1, 0, 0.3)]), SIZE, NEAR)
    with gpu.open(renderer(Topology(PAIR, 6), SIZE, softness, NEAR)) as session:
        oracle(session, clip, softness)


def test_a_sigma_whose_inverse_is_no_fp32_number_is_an_error():
    with pytest.raises(InputError, match="sigma is 1e-40"):
        Softness(1.0, sigma=1e-40)


@pytest.mark.parametrize("size, layers", [((1, 1), 1), ((1, 1), 2), ((7, 1), 1), ((1, 19), 2), ((33, 17), 1)], ids=str)
def test_small_and_odd_images_are_the_oracle(gpu, size, layers):
    softness = Softness(2.0, layers=layers)
    clip = project(np.concatenate([BASE, BASE + (0.2, 0.3, -1.0)]), (24, 24), NEAR)
    with gpu.open(renderer(Topology(PAIR, 6), size, softness, NEAR)) as session:
        oracle(session, clip, softness, size=size, least=0.3)


def test_the_fold_edges_of_small_faces_are_those_of_float64(gpu):
    """The determinants of faces far smaller than the image cancel in fp32 unless differences are taken first."""
    ball, faces = icosahedron()
    topology, program = Topology(faces, 12), Program()
    clip = program.input("clip", Layout("table", "vec4", count=12))
    segments = constant_table(np.zeros((30, 4)))
    folds = apply("fold_segments", segments, clip, constant_table(topology.edge_vertices), edge_count=30, vertices=12)
    program.plan("all", {}, {"folds": (folds, Layout("table", "vec4", count=30))})
    with gpu.open(program) as session:
        for scale in (1.0, 1e-2, 1e-4):
            at = rounded(project(ball * scale + (0.7, 0.5, -3.0), SIZE, NEAR))
            at[:, :2] = rounded(at[:, :2])
            session.set("clip", at)
            expected, = evaluate([folds], {"clip": Layout("table", "vec4", count=12).to_image(at, "clip")})
            found = session.get("folds")[:, 0] > 1
            np.testing.assert_array_equal(found, expected.reshape(-1, 4)[:30, 0] > 1)
            assert 5 < found.sum() < 29
