"""Input that tries to break the renderer: each kind has a defined answer, and nothing is ever NaN or Inf. See docs/numerics.md.

Scenes of six vertices and two faces share a few bundles: they differ by what the session is given. Expected images and gradients
are the brute-force oracle's. It has no faces without area: those are its thin faces in the limit.
"""

import hashlib
from functools import partial
from types import SimpleNamespace

import brute_force
import brute_force_outline
import fuzz_scenes
import numpy as np
import pytest
from corpus import icosahedron, project
from graphs import python, rounded
from test_hardsoftras import MARGIN, relative, render, renderer

from dressi_edge import runtime
from dressi_edge.cache.errors import InputError
from dressi_edge.cache.layout import Layout
from dressi_edge.compiler import Program
from dressi_edge.compiler.graph.autodiff import gradients
from dressi_edge.compiler.graph.functions import constant_table, dot, total
from dressi_edge.compiler.graph.optable import apply
from dressi_edge.compiler.graph.reference import evaluate
from dressi_edge.compiler.io.meshes import Mesh
from dressi_edge.compiler.io.shapes import sphere
from dressi_edge.compiler.io.views import Views
from dressi_edge.compiler.render.light import Light
from dressi_edge.compiler.render.loss import cotangent_laplacian, normal_consistency, uniform_laplacian
from dressi_edge.compiler.render.optimizer import Adam
from dressi_edge.compiler.render.raster import Softness
from dressi_edge.compiler.render.texture import sample_texture
from dressi_edge.compiler.render.topology import Topology
from dressi_edge.compiler.scene.problem import Loss, Problem

pytest_plugins = ["gpu"]

SIZE, NEAR = (24, 24), 0.1
PAIR = np.array([(0, 1, 2), (3, 4, 5)])
BASE = np.array([(-0.71, -0.62, -3.1), (0.83, -0.54, -2.7), (0.04, 0.77, -3.4)])
BEHIND = np.array([(-0.7, -0.6, 3.1), (0.8, -0.5, 2.7), (0.0, 0.8, 3.4)])
ATTRIBUTES = np.random.default_rng(0).uniform(size=(6, 3))
SOFT = {"K=1": Softness(3.0), "face": Softness(3.0, distance="face"), "K=3": Softness(3.0, layers=3)}


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


def reference_of(softness):
    """The oracle of this distance, as functions of a scene."""
    if softness.distance == "outline":
        return brute_force_outline
    more = {"delta": softness.delta, "layers": softness.layers}
    return SimpleNamespace(render=partial(brute_force.render, **more), gradient=partial(brute_force.gradient, **more))


def oracle(session, clip, softness, faces=PAIR, size=SIZE, near=NEAR, attributes=ATTRIBUTES, like=None, least=0.6, tolerance=1e-4):
    """Image and gradient of `clip` are the oracle's at `like` (default: there)."""
    clip = rounded(clip)
    like = clip if like is None else like
    attributes = rounded(attributes[:len(clip)])
    how = {"sigma": softness.sigma, "near": near, "attributes": attributes, "background": np.full(3, 0.25)}
    reference = reference_of(softness)
    expected = reference.render(like, faces, size, softness.r, **how)
    sure, sure_color = expected.margin > MARGIN, expected.margin_color > MARGIN
    smooth = sure & (expected.margin_gradient > MARGIN)
    assert sure.mean() >= least, sure.mean()
    rng = np.random.default_rng(3)
    by_alpha = rounded(rng.normal(size=smooth.shape)) * smooth
    by_color = rounded(rng.normal(size=(*smooth.shape, 3))) * (smooth & sure_color)[..., None]
    found = render(session, clip=clip, attributes=attributes, by_alpha=by_alpha[None], by_color=by_color[None])
    np.testing.assert_allclose(found["alpha"][0][sure], expected.silhouette[sure], rtol=0, atol=2e-5)
    np.testing.assert_allclose(found["color"][0][sure_color], expected.color[sure_color], rtol=0, atol=5e-5)
    gradient = reference.gradient(lambda image: (image.silhouette * by_alpha).sum() + (image.color * by_color).sum(),
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
    expected = reference_of(softness).render(thin, PAIR, SIZE, 3.0, near=NEAR, attributes=ATTRIBUTES, background=np.full(3, 0.25))
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


def test_all_vertices_in_one_point_draw_nothing_or_a_faint_dot(pair):
    """An outline of no extent has a distance; without a covered pixel the edge mask of face distance is empty."""
    session, softness = pair
    for point in ((0.0, 0.0, -3.0), (0, 0, 0), (0.4, 0.2, -NEAR)):
        found = draw(session, project(np.array([point] * 6), SIZE, NEAR))
        if softness.distance == "outline" and point[2] < -NEAR:
            assert 0 < found["alpha"].max() <= 0.5 and (found["alpha"] > 0).sum() < 40 and np.isfinite(found["by_clip"]).all()
        else:
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
    if softness.distance == "outline":  # where an edge of the repeated vertices ends at the outline a pixel may take it for outline
        assert (np.abs(apart["alpha"] - found["alpha"]) > 1e-6).sum() < 3
        return
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
            assert relative(found, layout.from_image(value) if "." in name else value.item()) < 2e-5, name


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
        elif softness.distance == "outline":
            alpha = oracle(session, clip, softness, least=0.5)["alpha"]
            assert 0 < alpha.max() < 0.5, "an outline around no pixel is faint"
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
    one_layer = softness if softness.layers == 1 else SOFT["face"]
    with gpu.open(renderer(Topology(np.array([(0, 1, 2)]), 6), SIZE, one_layer, NEAR)) as one:
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
    folds = apply("fold_segments", clip, constant_table(topology.edge_vertices), edge_count=30, vertices=12, views=1, near=NEAR,
                  cell_w=SIZE[0], cell_h=SIZE[1])
    program.plan("all", {}, {"folds": (folds, Layout("table", "vec4", count=30))})
    with gpu.open(program) as session:
        for scale in (1.0, 1e-2, 1e-4):
            at = rounded(project(ball * scale + (0.7, 0.5, -3.0), SIZE, NEAR))
            at[:, :2] = rounded(at[:, :2])
            session.set("clip", at)
            expected, = evaluate([folds], {"clip": Layout("table", "vec4", count=12).to_image(at, "clip")})
            found = session.get("folds")[:, 0] > 1e8
            np.testing.assert_array_equal(found, expected.reshape(-1, 4)[:30, 0] > 1e8)
            assert 5 < found.sum() < 29


# Targets and textures


def small_problem(**how):
    mesh = Mesh(0.8 * fuzz_scenes.BALL, fuzz_scenes.FACES, np.random.default_rng(1).uniform(-2, 3, (30, 2)),
                np.random.default_rng(2).integers(0, 30, (len(fuzz_scenes.FACES), 3)), texture=how.pop("texture", np.full((4, 4, 3), 0.5)))
    return Problem(mesh, how.pop("views", fuzz_scenes.cameras()), **how)


def test_transparent_targets_push_the_mesh_away_and_teach_no_colour(gpu):
    problem = small_problem()
    problem.phase("colour", 2, {"vertices": Adam(0.1), "texture": Adam(0.1)}, [Loss("color", masked=True)])
    problem.phase("shape", 2, {"vertices": Adam(0.01)}, [Loss("silhouette")])
    problem.render("view")
    with gpu.open(problem.program) as session:
        session.set("targets", np.zeros(session.shape("targets")))
        before = {name: session.get(name) for name in ("vertices", "texture")}
        session.step(3, "colour")
        assert session.loss() == 0
        for name, array in before.items():
            assert session.get(name).tobytes() == array.tobytes(), name
        area = session.get("view.color")[..., 3].sum()
        session.step(30, "shape")
        assert np.isfinite(session.get("vertices")).all() and session.get("view.color")[..., 3].sum() < 0.8 * area


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_targets_that_are_not_numbers_are_an_error_before_any_work(gpu, bad):
    images = np.zeros((2, 17, 20, 4), np.float32)
    images[1, 3, 4, 2] = bad
    with pytest.raises(InputError, match="view b has values outside"):
        Views(images, tuple(fuzz_scenes.cameras()), ("a", "b"))
    problem = small_problem()
    problem.phase("go", 1, {"vertices": Adam(0.1)}, [Loss("silhouette")])
    with gpu.open(problem.program) as session:
        with pytest.raises(InputError, match="targets has 1 values that are NaN or Inf"):
            session.set("targets", images)
        with pytest.raises(InputError, match="go needs targets"):
            session.step()
        with pytest.raises(InputError, match="vertices has 36 values that are NaN or Inf"):
            session.set("vertices", np.full((12, 3), bad))


def test_numbers_that_fp32_does_not_hold_are_an_error_before_anything_is_compiled():
    with pytest.raises(InputError, match="light: power is .*finite in fp32"):
        Light("ambient", (1.0, 1e39, 1.0))
    with pytest.raises(InputError, match="rate is 1e.39; a finite number of fp32"):
        Adam(1e39)
    with pytest.raises(InputError, match=r"targets\[1, 3, 4, 2\] is -1e\+39, beyond the range of fp32"):
        targets = np.zeros((2, 17, 20, 4))
        targets[1, 3, 4, 2] = -1e39
        Program().input("targets", Layout("atlas", "vec4", 20, 17, 2), targets)
    with pytest.raises(InputError, match="background has 1e.39 in it; numbers that are finite in fp32"):
        small_problem(background=(0.0, 1e39, 0.0))


@pytest.mark.parametrize("gradient", ["exact", "inverse_uv"])
def test_a_texture_of_one_texel_is_one_colour_for_any_coordinates(gpu, gradient):
    program, image = Program(), Layout("image", "vec2", 9, 7)
    texture, uv = program.state("texture", Layout("image", "vec3", 1, 1), np.full((1, 1, 3), 0.5)), program.input("uv", image)
    step = program.state("step", Layout("unit", "int"))
    color = sample_texture(texture, uv, gradient=gradient, step=step)
    g = gradients(total(dot(color, color)), [texture, uv])
    program.plan("all", {}, {"color": (color, Layout("image", "vec3", 9, 7)), "by_texture": (g[0], Layout("image", "vec3", 1, 1)),
                             "by_uv": (g[1], image)})
    with gpu.open(program) as session:
        session.set("texture", np.array([[[0.25, 0.5, 0.75]]]))
        for scale in (1.0, -30.0, 1e6, 1e30):
            session.set("uv", np.random.default_rng(0).uniform(size=(7, 9, 2)) * scale)
            np.testing.assert_array_equal(session.get("color"), np.broadcast_to([0.25, 0.5, 0.75], (7, 9, 3)))
            assert not session.get("by_uv").any()
            count = 63 if gradient == "exact" else 1  # Algorithm 1 takes one pixel a texel
            np.testing.assert_allclose(session.get("by_texture")[0, 0], np.array([0.5, 1.0, 1.5]) * count, rtol=1e-6)


@pytest.mark.parametrize("wrap", ["repeat", "clamp"])
def test_coordinates_outside_wrap_or_clamp_with_their_gradient(gpu, wrap):
    program, image = Program(), Layout("image", "vec2", 9, 7)
    texture, uv = program.input("texture", Layout("image", "vec3", 8, 4)), program.input("uv", image)
    color = sample_texture(texture, uv, wrap=wrap)
    g = gradients(total(dot(color, color)), [texture])
    program.plan("all", {}, {"color": (color, Layout("image", "vec3", 9, 7)), "by_texture": (g[0], Layout("image", "vec3", 8, 4))})
    rng = np.random.default_rng(5)
    inside = rng.integers(1, 63, (7, 9, 2)) / 64  # dyadic: adding a whole number is exact
    with gpu.open(program) as session:
        session.set("texture", rng.uniform(size=(4, 8, 3)))

        def at(coordinates):
            session.set("uv", coordinates)
            return session.get("color"), session.get("by_texture")

        if wrap == "repeat":
            for a, b in zip(at(inside + rng.integers(-9, 10, (7, 9, 2))), at(inside)):
                np.testing.assert_allclose(a, b, atol=1e-5)
        else:
            for a, b in zip(at(rng.normal(size=(7, 9, 2)) * 10), at(np.clip(rng.normal(size=(7, 9, 2)) * 0 + session.get("uv"), 0, 1))):
                np.testing.assert_allclose(a, b, atol=1e-5)
        for huge in (1e9, 1e30):
            assert all(np.isfinite(x).all() for x in at((inside - 0.5) * huge))


# Many faces


@pytest.mark.parametrize("vertices, size", [(25_000, 96), pytest.param(250_000, 512, marks=pytest.mark.full)])
def test_many_faces_are_a_disc(gpu, vertices, size):
    ball = sphere(vertices, 0.8)
    assert abs(len(ball.faces) - 2 * vertices) < 0.03 * vertices
    topology = Topology(ball.faces, len(ball.positions))
    clip = project(ball.positions + (0, 0, -3), (size, size), NEAR)
    with gpu.open(renderer(topology, (size, size), Softness(2.0), NEAR)) as session:
        found = render(session, clip=clip, attributes=np.ones((len(clip), 3)), by_alpha=np.ones((1, size, size)),
                       by_color=np.zeros((1, size, size, 3)))
    assert all(np.isfinite(x).all() for x in found.values())
    focal = 1.2 * size
    area = np.pi * (focal * 0.8 / np.sqrt(9 - 0.64)) ** 2  # a sphere's outline is a cone
    # Not the sum of alpha: faces smaller than a pixel make every covered pixel of the edge mask near an edge (docs/numerics.md).
    np.testing.assert_allclose((found["alpha"] >= 0.5).sum(), area, rtol=1e-2)
    assert found["by_clip"].any()


# Whatever is given


FOUND = (2571,)  # by the longer run: a pixel nearer than 1e-4 to a light


@pytest.mark.parametrize("name", fuzz_scenes.PROBLEMS)
def test_random_scenes_are_finite(gpu, name):
    with gpu.open(fuzz_scenes.PROBLEMS[name]().program) as session:
        bad = {seed: found for seed in (*FOUND, *range(20 if name == "K=3" else 50)) if (found := fuzz_scenes.broken(session, seed))}
    gpu.silent()
    assert not bad


@pytest.mark.full
@pytest.mark.parametrize("name", fuzz_scenes.PROBLEMS)
def test_ten_thousand_random_scenes_are_finite(gpu, name):
    with gpu.open(fuzz_scenes.PROBLEMS[name]().program) as session:
        bad = {seed: found for seed in range(1000, 4334) if (found := fuzz_scenes.broken(session, seed))}
    gpu.silent()
    assert not bad


# Long runs


def states(session):
    return {name: session.get(name).tobytes() for name, value in session.values.items() if value["role"] == "state"}


def finite(session):
    return [name for name, value in session.values.items() if value["role"] == "state" and not np.isfinite(session.get(name)).all()]


@pytest.fixture(scope="module")
def everything(gpu):
    return gpu.compile(fuzz_scenes.PROBLEMS["K=1"]().program)


STEPS = [200, pytest.param(20_000, marks=pytest.mark.full)]


@pytest.mark.parametrize("steps", STEPS)
def test_aggressive_rates_stay_finite(gpu, everything, steps):
    with runtime.load(everything, gpu.device) as session:
        session.set("targets", fuzz_scenes.scene(3)["targets"])
        for _ in range(steps // 100):
            session.step(100)
            assert not finite(session)
        assert np.isfinite(session.loss())


@pytest.mark.parametrize("steps", STEPS)
def test_a_collapsed_mesh_stays_finite(gpu, everything, steps):
    with runtime.load(everything, gpu.device) as session:
        session.set("targets", fuzz_scenes.scene(3)["targets"])
        session.set("vertices", np.zeros((12, 3)))
        session.step(steps)
        assert not finite(session)
        assert np.isfinite(session.loss())


@pytest.mark.parametrize("steps", STEPS)
def test_a_converged_scene_keeps_its_bits(gpu, steps):
    silhouette = small_problem()
    silhouette.phase("go", 1, {"vertices": Adam(0.1)}, [Loss("silhouette")])
    silhouette.render("view", color=False)
    with gpu.open(silhouette.program) as session:
        target = np.zeros(session.shape("targets"))
        target[..., 3] = session.get("view.silhouette")
        session.set("targets", target)
        before = session.get("vertices").tobytes()
        session.step(steps)
        assert session.loss() == 0 and session.get("vertices").tobytes() == before
        assert not session.get("vertices.adam_m").any() and not session.get("vertices.adam_v").any()


@pytest.mark.parametrize("steps", [33, pytest.param(2_001, marks=pytest.mark.full)])
def test_single_steps_are_one_call(gpu, everything, steps):
    with runtime.load(everything, gpu.device) as one, runtime.load(everything, gpu.device) as many:
        for session in (one, many):
            session.set("targets", fuzz_scenes.scene(3)["targets"])
        for _ in range(steps):
            one.step(1)
        many.step(steps)
        assert states(one) == states(many)


def test_a_resumed_run_is_the_run(gpu, everything):
    with runtime.load(everything, gpu.device) as whole, runtime.load(everything, gpu.device) as first, \
            runtime.load(everything, gpu.device) as second:
        for session in (whole, first, second):
            session.set("targets", fuzz_scenes.scene(3)["targets"])
        whole.step(25)
        first.step(12)
        for name in states(first):
            second.set(name, first.get(name))
        second.step(13)
        assert states(second) == states(whole)


@pytest.mark.parametrize("step", [10 ** 6, 2 ** 31 - 10])
def test_adam_at_a_late_step_moves_as_adam(gpu, everything, step):
    with runtime.load(everything, gpu.device) as session:
        session.set("targets", fuzz_scenes.scene(3)["targets"])
        session.set("go.step", np.array(step))
        before = session.get("vertices").astype(np.float64)
        session.step(1)
        m, v = (session.get(f"vertices.adam_{k}").astype(np.float64) for k in "mv")
        moved = session.get("vertices") - before
        np.testing.assert_allclose(moved, -0.5 * m / (np.sqrt(v) + 1e-8), rtol=1e-4, atol=1e-6)
        assert session.get("go.step") == step + 1


# The same bits

RUN = """
import hashlib, sys
import numpy as np
from dressi_edge import runtime
with runtime.load(sys.argv[1]) as session:
    session.set("targets", np.random.default_rng(3).uniform(size=session.shape("targets")))
    session.step(5)
    names = [name for name, value in session.values.items() if value["role"] in ("state", "output")]
    print(*(hashlib.sha256(session.get(name).tobytes()).hexdigest()[:16] for name in names))
"""


def test_bits_do_not_depend_on_the_process_or_on_the_driver_s_threads(gpu, everything):
    with runtime.load(everything, gpu.device) as session:
        session.set("targets", np.random.default_rng(3).uniform(size=session.shape("targets")))
        session.step(5)
        names = [name for name, value in session.values.items() if value["role"] in ("state", "output")]
        here = " ".join(hashlib.sha256(session.get(name).tobytes()).hexdigest()[:16] for name in names)
    for threads in ("0", "1", "2"):
        assert python(RUN, everything, LP_NUM_THREADS=threads).split() == here.split(), f"LP_NUM_THREADS={threads}"
