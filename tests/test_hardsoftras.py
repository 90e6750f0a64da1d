"""HardSoftRas on lavapipe against the brute-force oracle: the whole image, and its gradient by clip coordinates and attributes.

Pixels nearer than 1/64 of a pixel to another discrete choice are left out of values and weights; `test_brute_force` shows what
the margins mean. Camera poses are differentiated against central differences of the float64 reference.
"""

import brute_force
import numpy as np
import pytest
from corpus import icosahedron, project, rotation, scenes
from graphs import layout_of, rounded

from dressi_edge.cache.errors import InputError
from dressi_edge.cache.layout import Layout
from dressi_edge.compiler import Program
from dressi_edge.compiler.autodiff import gradients
from dressi_edge.compiler.cameras import Camera
from dressi_edge.compiler.functions import constant, dot, total
from dressi_edge.compiler.reference import evaluate
from dressi_edge.compiler.render.camera import fixed_views, posed_views, rotation_rows, to_clip
from dressi_edge.compiler.render.hardsoftras import Atlas, Softness, rasterized
from dressi_edge.compiler.topology import Topology

pytest_plugins = ["gpu"]

MARGIN = 1 / 64
SCENES = scenes()
EMPTY = {"behind", "off_screen"}
THOROUGH = {"sliver_in_front", "coincident", "random"}  # where layers tell most


def renderer(topology, size, softness, near, views=1, columns=1):
    """A program from clip coordinates, attributes and weights of the image to image and gradients."""
    w, h = size
    program, atlas = Program(), Atlas(w, h, views, columns)
    count = topology.vertex_count
    clip = program.input("clip", Layout("table", "vec4", count=count * views))
    attributes = program.input("attributes", Layout("table", "vec3", count=count))
    kind = {"width": w, "height": h, "count": views, "columns": columns}
    by_alpha, by_color = (program.input(name, Layout("atlas", vtype, **kind)) for name, vtype in
                          (("by_alpha", "float"), ("by_color", "vec3")))
    layers = rasterized(clip, topology, atlas, softness, near)
    alpha = layers.silhouette()
    color = layers.color([layers.interpolate(layer, attributes) for layer in layers.layers], 0.25)
    g = gradients(total(alpha * by_alpha) + total(dot(color, by_color)), [clip, attributes])
    program.plan("render", {}, {"alpha": (alpha, Layout("atlas", "float", **kind)),
                                "color": (color, Layout("atlas", "vec3", **kind)),
                                "by_clip": (g[0], Layout("table", "vec4", count=count * views)),
                                "by_attributes": (g[1], Layout("table", "vec3", count=count))})
    return program


def render(session, **inputs):
    for name, array in inputs.items():
        session.set(name, array)
    return {name: session.get(name) for name in ("alpha", "color", "by_clip", "by_attributes")}


def relative(a, b):
    return np.linalg.norm(a - b) / max(np.linalg.norm(b), 1e-9)


def check(gpu, name, softness, profile="lavapipe"):
    s = SCENES[name]
    clip, attributes = rounded(s.clip), rounded(s.attributes)
    how = {"sigma": softness.sigma, "delta": softness.delta, "layers": softness.layers, "near": s.near,
           "attributes": attributes, "background": np.full(3, 0.25)}
    expected = brute_force.render(clip, s.faces, s.size, softness.r, **how)
    rng = np.random.default_rng(0)
    smooth = (expected.margin_gradient > MARGIN) & (expected.margin > MARGIN)
    by_alpha = rounded(rng.normal(size=smooth.shape)) * smooth
    by_color = rounded(rng.normal(size=(*smooth.shape, 3))) * (smooth & (expected.margin_color > MARGIN))[..., None]
    gradient = brute_force.gradient(lambda image: (image.silhouette * by_alpha).sum() + (image.color * by_color).sum(),
                                    clip, s.faces, s.size, softness.r, **how)
    with gpu.open(renderer(Topology(s.faces, len(clip)), s.size, softness, s.near), profile) as session:
        found = render(session, clip=clip, attributes=attributes, by_alpha=by_alpha[None], by_color=by_color[None])
    gpu.silent()
    sure, sure_color = expected.margin > MARGIN, expected.margin_color > MARGIN
    assert sure.mean() > 0.85, "the margins leave out too much for a test"
    np.testing.assert_allclose(found["alpha"][0][sure], expected.silhouette[sure], rtol=0, atol=1e-5)
    np.testing.assert_allclose(found["color"][0][sure_color], expected.color[sure_color], rtol=0, atol=1e-5)
    assert not found["by_clip"][:, 2].any(), "depth only orders"
    if name in EMPTY:
        assert not found["alpha"].any() and not found["by_clip"].any() and not found["by_attributes"].any()
    assert relative(found["by_clip"], gradient.clip) < 1e-4
    assert relative(found["by_attributes"], gradient.attributes) < 1e-4


def cases():
    """Every scene x K in 1..5, and for K = 1 with and without the fold edges; most in the default run."""
    for name in SCENES:
        for layers, folds in ((1, True), (1, False), (2, True), (3, True), (4, True), (5, True)):
            default = folds and layers == 1 or layers == 3 or layers == 5 and name in THOROUGH
            yield pytest.param(name, layers, folds, marks=[] if default else [pytest.mark.full],
                               id=f"{name}-{layers}{'' if folds else '-enlarged'}")


@pytest.mark.parametrize("name, layers, folds", list(cases()))
def test_image_and_gradient_are_those_of_the_brute_force_oracle(gpu, name, layers, folds):
    check(gpu, name, Softness(3.0, layers=layers, folds=folds))


@pytest.mark.parametrize("softness", [Softness(0.7), Softness(4.5, sigma=2.0, delta=1.0, layers=2), Softness(1.5, delta=5.0)],
                         ids=["narrow", "wide_sigma", "wide_delta"])
def test_r_sigma_and_delta_mean_what_the_oracle_says(gpu, softness):
    check(gpu, "tetrahedron", softness)


@pytest.mark.parametrize("profile, layers", [("limit4", 1), ("limit8", 2), pytest.param("limit4", 3, marks=pytest.mark.full),
                                             pytest.param("raspberry_pi_4", 3, marks=pytest.mark.full)])
def test_a_small_device_profile_gives_the_same_image_and_gradient(gpu, profile, layers):
    check(gpu, "icosphere", Softness(3.0, layers=layers), profile)


def test_softness_that_cannot_be_drawn_is_an_error():
    for bad in ({"r": 0.0}, {"r": np.nan}, {"sigma": 0.0}, {"sigma": np.inf}, {"delta": -1.0}, {"layers": 0}, {"layers": 6}):
        with pytest.raises(InputError, match="needed|allowed"):
            Softness(**bad)


# Views


@pytest.mark.parametrize("layers", [1, 2])
def test_an_atlas_of_views_is_the_views_one_by_one(gpu, layers):
    size, near = (22, 18), 0.1
    ball, faces = icosahedron()
    topology = Topology(faces, len(ball))
    rng = np.random.default_rng(4)
    clips = np.array([project(0.9 * ball @ rotation(k).T + (0.4 * k - 1, 0.04, -3.3), size, near) for k in (2, 3, 4)])
    attributes, by_alpha = rng.uniform(size=(len(ball), 3)), rng.normal(size=(3, 18, 22))
    by_color = rng.normal(size=(3, 18, 22, 3))
    with gpu.open(renderer(topology, size, Softness(2.5, layers=layers), near, 3, 2)) as session:
        atlas = render(session, clip=clips.reshape(-1, 4), attributes=attributes, by_alpha=by_alpha, by_color=by_color)
    with gpu.open(renderer(topology, size, Softness(2.5, layers=layers), near)) as session:
        single = [render(session, clip=clips[v], attributes=attributes, by_alpha=by_alpha[v][None], by_color=by_color[v][None])
                  for v in range(3)]
    gpu.silent()
    assert atlas["alpha"].std() > 0.1
    for name in ("alpha", "color"):
        np.testing.assert_array_equal(atlas[name], np.concatenate([s[name] for s in single]), err_msg=name)
    np.testing.assert_allclose(atlas["by_clip"], np.concatenate([s["by_clip"] for s in single]), rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(atlas["by_attributes"], sum(s["by_attributes"] for s in single), rtol=1e-5, atol=1e-4)


def test_an_atlas_is_near_a_square_and_wastes_little():
    assert Atlas.of(256, 256, 6) in (Atlas(256, 256, 6, 3), Atlas(256, 256, 6, 2))
    for views in range(1, 30):
        atlas = Atlas.of(64, 64, views)
        assert atlas.columns * -(-views // atlas.columns) >= views


# Cameras


def rodrigues(v):
    angle = np.linalg.norm(v)
    if angle == 0:
        return np.eye(3)
    x, y, z = v / angle
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def cameras(count=3, size=(24, 20)):
    result = []
    for k in range(count):
        pose = np.eye(4)
        pose[:3, :3] = rotation(k + 11)
        pose[:3, 3] = (0.05 * k, -0.1, -3.4)  # world to camera: the object is in front
        result.append(Camera(pose, 26.0 + k, 27.0, 12.3, 9.6, *size, near=0.1, far=20.0))
    return result


POSES = {"zero": np.zeros((3, 3)), "series": np.array([[0.05, -0.02, 0.03], [0.0, 0.0, 1e-4], [-0.06, 0.05, 0.05]]),
         "turned": np.array([[0.9, -0.4, 0.3], [0.0, 0.0, -1.7], [2.0, 1.0, -1.5]])}


@pytest.mark.parametrize("vector", [*POSES["series"], *POSES["turned"], np.zeros(3), np.array([0.1, 0, 0]),
                                    np.array([0.0999, 0, 0])], ids=str)
def test_a_rotation_vector_is_rodrigues_rotation(vector):
    rows = rotation_rows(constant(vector[None, None]))
    np.testing.assert_allclose(np.concatenate(evaluate(rows), 0)[:, 0], rodrigues(vector), atol=1e-9)


@pytest.mark.parametrize("rotations", POSES.values(), ids=POSES)
def test_posed_views_turn_the_base_poses(rotations):
    rng = np.random.default_rng(5)
    table = Layout("table", "vec3", count=3)
    points, moves = rng.normal(size=(7, 3)), rng.normal(scale=0.1, size=(3, 3))
    program = Program()
    p = program.input("p", Layout("table", "vec3", count=7))
    turn, move = program.input("turn", table), program.input("move", table)
    base = cameras()
    clip = to_clip(p, posed_views(fixed_views(base), turn, move))
    feed = {"p": Layout("table", "vec3", count=7).to_image(points, "p"), "turn": table.to_image(rotations, "turn"),
            "move": table.to_image(moves, "move")}
    found = layout_of(clip).from_image(evaluate([clip], feed)[0]).reshape(3, 7, 4)
    for k, camera in enumerate(base):
        x = np.c_[points, np.ones(7)] @ camera.world_to_camera[:3].T @ rodrigues(rotations[k]).T + moves[k]
        np.testing.assert_allclose(found[k], np.c_[x, np.ones(7)] @ camera.projection_rows().T, atol=1e-9)


def test_one_view_chosen_on_the_device_is_that_view():
    points = np.random.default_rng(6).normal(size=(7, 3))
    table, unit = Layout("table", "vec3", count=7), Layout("unit", "int")
    program = Program()
    p, view = program.input("p", table), program.input("view", unit)
    views = fixed_views(cameras())
    one, position = to_clip(p, views.choose(view)), views.choose(view).position()
    for k, camera in enumerate(cameras()):
        clip, centre = evaluate([one, position], {"p": table.to_image(points, "p"), "view": np.array([[[k]]])})
        np.testing.assert_allclose(clip.reshape(-1, 4)[:7], np.c_[points, np.ones(7)] @ camera.clip_rows().T, atol=1e-12)
        np.testing.assert_allclose(centre[0, 0], camera.position, atol=1e-12)


def pose_problem(layers=2):
    """Image, loss and its gradient by vertex positions, rotation vectors and translations of three views in an atlas."""
    ball, faces = icosahedron()
    size, views = (24, 20), cameras()
    program, atlas = Program(), Atlas.of(*size, 3)
    table = Layout("table", "vec3", count=3)
    x = program.input("positions", Layout("table", "vec3", count=len(ball)))
    turn, move = program.input("turn", table), program.input("move", table)
    clip = to_clip(x, posed_views(fixed_views(views), turn, move))
    shape = rasterized(clip, Topology(faces, len(ball)), atlas, Softness(2.5, layers=layers), 0.1)
    kind = {"width": size[0], "height": size[1], "count": 3, "columns": atlas.columns}
    weights = program.input("weights", Layout("atlas", "float", **kind))
    color = shape.color([shape.interpolate(layer, x) for layer in shape.layers], 0.0)
    loss = total((shape.silhouette() + color.x * 0.7) * weights)
    g = gradients(loss, [x, turn, move])
    names = ("positions", "turn", "move")
    program.plan("p", {}, {f"by_{n}": (node, program.values[n].layout) for n, node in zip(names, g)})
    feed = {"positions": rounded(program.values["positions"].layout.to_image(ball, "x")), "weights": None}
    return program, clip, loss, dict(zip(names, g)), feed


def test_gradients_reach_poses_and_positions_through_the_image(gpu):
    program, clip, loss, by, feed = pose_problem()
    layouts = {name: value.layout for name, value in program.values.items()}
    rng = np.random.default_rng(8)
    near = []
    for rotations in (POSES["series"], POSES["turned"]):
        feed["turn"] = rounded(layouts["turn"].to_image(rotations, "turn"))
        feed["move"] = rounded(layouts["move"].to_image(rng.normal(scale=0.1, size=(3, 3)), "move"))
        clips = layout_of(clip).from_image(evaluate([clip], feed)[0]).reshape(3, -1, 4)
        chosen = [brute_force.select(c, icosahedron()[1], (24, 20), 2.5, layers=2, near=0.1).margins for c in clips]
        sure = np.array([(m.gradient > MARGIN) & (m.color > MARGIN) for m in chosen])
        assert sure.mean() > 0.4
        feed["weights"] = rounded(layouts["weights"].to_image(rng.normal(size=sure.shape) * sure, "weights"))
        gradient = evaluate(by.values(), feed)
        for name, expected in zip(by, gradient):
            shape = layouts[name].from_image(expected).shape
            for _ in range(2):  # directions
                direction = layouts[name].to_image(rng.normal(size=shape), name)
                ends = [evaluate([loss], {**feed, name: feed[name] + h * direction})[0].item() for h in (1e-6, -1e-6)]
                np.testing.assert_allclose((expected * direction).sum(), (ends[0] - ends[1]) / 2e-6, rtol=1e-6, atol=1e-6)
        near.append((dict(feed), gradient))
    with gpu.open(program) as session:
        for values, expected in near:
            for name, array in values.items():
                session.set(name, layouts[name].from_image(array))
            for name, g in zip(by, expected):
                assert relative(session.get(f"by_{name}"), layouts[name].from_image(g)) < 1e-4
    gpu.silent()


def test_clip_coordinates_are_the_cameras(gpu):
    points = rounded(np.random.default_rng(9).normal(size=(50, 3)))
    program = Program()
    p = program.input("p", Layout("table", "vec3", count=50))
    clip = to_clip(p, fixed_views(cameras()))
    program.plan("p", {}, {"clip": (clip, Layout("table", "vec4", count=150))})
    with gpu.open(program) as session:
        session.set("p", points)
        found = session.get("clip").reshape(3, 50, 4)
    expected = np.array([np.c_[points, np.ones(50)] @ c.clip_rows().T for c in cameras()])
    np.testing.assert_allclose(found, expected, rtol=2e-6, atol=4e-6)
