"""HardSoftRas on lavapipe against the brute-force oracle: the whole image, and its gradient by clip coordinates and attributes.

Pixels nearer than 1/64 of a pixel, or a step of the device's grid, to another discrete choice are left out of values and weights;
`test_brute_force` shows what the margins mean. Camera poses are differentiated against central differences of the float64 reference.
"""

import brute_force
import brute_force_outline
import numpy as np
import pytest
from corpus import Scene, icosahedron, project, rotation, scenes
from graphs import layout_of, rounded
from undertest import margin

from dressi_edge.cache.errors import InputError
from dressi_edge.cache.layout import Layout
from dressi_edge.compiler import Program
from dressi_edge.compiler.graph.autodiff import gradients
from dressi_edge.compiler.graph.functions import constant, dot, total
from dressi_edge.compiler.graph.reference import evaluate
from dressi_edge.compiler.io.cameras import Camera
from dressi_edge.compiler.io.shapes import sphere
from dressi_edge.compiler.render.atlas import Atlas
from dressi_edge.compiler.render.camera import fixed_views, posed_views, rotation_rows, to_clip
from dressi_edge.compiler.render.raster import Softness, rasterized
from dressi_edge.compiler.render.topology import Topology

pytest_plugins = ["gpu"]

MARGIN = margin()
SCENES = scenes()
THOROUGH = "sliver_in_front"  # where layers tell most


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
    alpha = rasterized(clip, topology, atlas, softness, near, faces=False).silhouette()
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


def oracle_of(softness):
    """The module, and what it needs of a Softness."""
    if softness.distance == "outline":
        return brute_force_outline, {"sigma": softness.sigma}
    return brute_force, {"sigma": softness.sigma, "delta": softness.delta, "layers": softness.layers,
                         "edges": softness.edges}


def check(gpu, s, softness, profile="lavapipe"):
    """Scene `s` is what the oracle says."""
    clip, attributes = rounded(s.clip), rounded(s.attributes)
    oracle, how = oracle_of(softness)
    how |= {"near": s.near, "attributes": attributes, "background": np.full(3, 0.25)}
    expected = oracle.render(clip, s.faces, s.size, softness.r, **how)
    rng = np.random.default_rng(0)
    smooth = (expected.margin_gradient > MARGIN) & (expected.margin > MARGIN)
    by_alpha = rounded(rng.normal(size=smooth.shape)) * smooth
    by_color = rounded(rng.normal(size=(*smooth.shape, 3))) * (smooth & (expected.margin_color > MARGIN))[..., None]
    gradient = oracle.gradient(lambda image: (image.silhouette * by_alpha).sum() + (image.color * by_color).sum(),
                               clip, s.faces, s.size, softness.r, **how)
    with gpu.open(renderer(Topology(s.faces, len(clip)), s.size, softness, s.near), profile) as session:
        found = render(session, clip=clip, attributes=attributes, by_alpha=by_alpha[None], by_color=by_color[None])
    gpu.silent()
    sure, sure_color = expected.margin > MARGIN, expected.margin_color > MARGIN
    assert sure.mean() > (0.85 if MARGIN <= 1 / 64 else 0.75), "the margins leave out too much for a test"
    np.testing.assert_allclose(found["alpha"][0][sure], expected.silhouette[sure], rtol=0, atol=1e-5)
    np.testing.assert_allclose(found["color"][0][sure_color], expected.color[sure_color], rtol=0, atol=1e-5)
    assert not found["by_clip"][:, 2].any(), "depth only orders"
    if not (expected.face >= 0).any():
        assert not found["alpha"].any() and not found["by_clip"].any() and not found["by_attributes"].any()
    assert relative(found["by_clip"], gradient.clip) < 1e-4
    assert relative(found["by_attributes"], gradient.attributes) < 1e-4


def cases():
    """Every scene x outline distance, and face distance with K in 1..5; most in the default run."""
    for name in SCENES:
        yield pytest.param(name, Softness(3.0), id=f"{name}-outline")
        for k in range(1, 6):
            default = k in (1, 3) or k == 5 and name == THOROUGH
            yield pytest.param(name, Softness(3.0, layers=k, distance="face"), id=f"{name}-{k}",
                               marks=[] if default else [pytest.mark.full])


@pytest.mark.parametrize("name, softness", list(cases()))
def test_image_and_gradient_are_those_of_the_brute_force_oracle(gpu, name, softness):
    check(gpu, SCENES[name], softness)


@pytest.mark.parametrize("softness", [Softness(0.7), Softness(4.5, sigma=2.0), Softness(0.7, distance="face"),
                                      Softness(4.5, sigma=2.0, delta=1.0, layers=2), Softness(1.5, delta=5.0)],
                         ids=["narrow", "wide", "narrow_face", "wide_sigma", "wide_delta"])
def test_r_sigma_and_delta_mean_what_the_oracle_says(gpu, softness):
    check(gpu, SCENES["tetrahedron"], softness)


@pytest.mark.parametrize("name", ["sliver_in_front", "two_depths"])
@pytest.mark.parametrize("softness", [Softness(2.0, layers=3, edges="depth"), Softness(2.0, layers=3, edges="all"),
                                      Softness(3.0, delta=1.0, edges="depth")], ids=["depth", "all", "depth_narrow"])
def test_the_edge_mask_may_have_edges_within_the_shape(gpu, name, softness):
    """The oracle's mask, and more than that of coverage."""
    s = SCENES[name] if name in SCENES else two_depths()
    check(gpu, s, softness)
    masks = [brute_force.render(s.clip, s.faces, s.size, softness.r, delta=softness.delta, near=s.near, edges=edges).edge_mask.sum()
             for edges in ("coverage", softness.edges)]
    assert masks[1] > masks[0] or name != "two_depths"


def two_depths():
    """A small square before a large one."""
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    points = np.concatenate([np.column_stack([corners * 1.1, np.zeros(4)]), np.column_stack([corners * 0.4 + 0.1, np.ones(4)])])
    faces = np.array([(0, 1, 2), (0, 2, 3), (4, 5, 6), (4, 6, 7)])
    return Scene(project(points - (0, 0, 4), (28, 26)), faces, (28, 26), np.random.default_rng(3).uniform(0, 1, (8, 3)))


@pytest.mark.parametrize("profile, softness", [
    ("limit4", Softness(3.0)), ("raspberry_pi_4", Softness(3.0)), ("limit4", Softness(3.0, distance="face")),
    ("limit8", Softness(3.0, layers=2)), pytest.param("limit4", Softness(3.0, layers=3), marks=pytest.mark.full),
    pytest.param("raspberry_pi_4", Softness(3.0, layers=3), marks=pytest.mark.full)], ids=lambda x: getattr(x, "distance", x))
def test_a_small_device_profile_gives_the_same_image_and_gradient(gpu, profile, softness):
    check(gpu, SCENES["icosphere"], softness, profile)


@pytest.mark.parametrize("bad", [
    {"r": 0.0}, {"r": np.nan}, {"sigma": 0.0}, {"sigma": np.inf}, {"delta": -1.0}, {"layers": 0}, {"layers": 6},
    {"distance": "edge"}, {"edges": "faces"}, {"edges": "depth", "distance": "outline"},
    {"distance": "outline", "layers": 2}, {"distance": "outline", "delta": 2.0}], ids=str)
def test_softness_that_cannot_be_drawn_is_an_error(bad):
    with pytest.raises(InputError, match="needed|allowed|one layer"):
        Softness(**bad)


def test_the_distance_is_to_the_outline_where_that_is_defined():
    assert Softness().distance == Softness(sigma=1.0).distance == "outline"
    assert Softness(layers=2).distance == Softness(delta=2.0).distance == Softness(distance="face").distance == "face"


# Outline distance


def torus(rings=9, sides=7, small=0.35):
    u, v = (np.arange(n) * 2 * np.pi / n for n in (rings, sides))
    u, v = (x.ravel() for x in np.meshgrid(u, v, indexing="ij"))
    wide = 0.65 + small * np.cos(v)
    i, j = (x.ravel() for x in np.meshgrid(np.arange(rings), np.arange(sides), indexing="ij"))
    a, b = i * sides + j, (i + 1) % rings * sides + j
    c, d = (i + 1) % rings * sides + (j + 1) % sides, i * sides + (j + 1) % sides
    return np.stack([wide * np.cos(u), wide * np.sin(u), small * np.sin(v)], 1), np.concatenate([np.stack(x, 1) for x in
                                                                                                ((a, b, c), (a, c, d))])


def shapes():
    """Scenes in which hidden folds, boundaries, the image's border or the near plane decide."""
    out = {}

    def add(name, points, faces, size=(28, 26), near=0.1):
        attributes = np.random.default_rng(len(out)).uniform(size=(len(points), 3))
        out[name] = Scene(project(points, size, near), np.asarray(faces), size, attributes, near)

    ball, faces = icosahedron()
    ring, ring_faces = torus()
    add("ring", ring @ rotation(5).T + (0.02, 0.01, -3.2), ring_faces)
    add("ring_on_edge", ring @ rotation(7).T + (0.3, -0.2, -2.8), ring_faces)
    add("open_ball", 0.9 * ball @ rotation(2).T + (0.02, 0.04, -3.4), faces[3:])
    ys, xs = (x.ravel() for x in np.mgrid[:5, :5])
    quads = [(5 * y + x, 5 * y + x + 1, 5 * y + x + 6, 5 * y + x + 5) for y in range(4) for x in range(4) if (x, y) != (1, 2)]
    sheet = np.stack([0.45 * xs - 0.9, 0.44 * ys - 0.85, -3.1 + 0.3 * np.sin(xs + 0.7 * ys)], 1)
    add("sheet_with_hole", sheet, [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    add("leaves_the_cell", 0.9 * ball @ rotation(4).T + (-1.2, 0.9, -3.3), faces)
    add("larger_than_the_cell", 3.1 * ball @ rotation(4).T + (2.6, 1.9, -6.3), faces)
    add("cut_by_near", 0.9 * ball @ rotation(6).T + (0.1, 0.1, -3.2), faces, near=3.0)
    add("around_the_eye", 2.0 * ball @ rotation(8).T + (0.3, 0.1, -1.1), faces[:14], near=0.2)
    fins = np.array([(0.0, -0.9, -3.0), (0.05, 0.9, -3.1), (0.9, 0.1, -2.8), (-0.8, 0.0, -3.3), (0.6, 0.5, -3.6)])
    add("three_at_an_edge", fins, [(0, 1, 2), (0, 1, 3), (0, 1, 4)])
    return out


SHAPES = shapes()


@pytest.mark.parametrize("scene", SHAPES.values(), ids=SHAPES)
def test_outline_distance_is_the_oracles_where_folds_borders_and_the_near_plane_decide(gpu, scene):
    check(gpu, scene, Softness(2.6))


@pytest.mark.parametrize("name", ["icosphere", "overlapping", "random", "sliver_in_front"])
def test_uncovered_pixels_beside_covered_ones_are_those_of_face_distance(gpu, name):
    s, found = SCENES[name], []
    clip, attributes = rounded(s.clip), rounded(s.attributes)
    expected = [oracle_of(x)[0].render(clip, s.faces, s.size, 3.0, near=s.near) for x in (Softness(3.0), Softness(3.0, distance="face"))]
    soft = (expected[1].edge_mask & ~expected[1].hard)[None] & np.all([e.margin > MARGIN for e in expected], axis=0)
    none = np.zeros((1, *s.size[::-1]))
    for softness in (Softness(3.0), Softness(3.0, distance="face")):
        with gpu.open(renderer(Topology(s.faces, len(clip)), s.size, softness, s.near)) as session:
            found.append(render(session, clip=clip, attributes=attributes, by_alpha=soft * (expected[0].margin_gradient > MARGIN)[None],
                                by_color=np.zeros((*none.shape, 3))))
    gpu.silent()
    assert soft.sum() > 20
    np.testing.assert_allclose(found[0]["alpha"][soft], found[1]["alpha"][soft], rtol=0, atol=1e-6)
    assert relative(found[0]["by_clip"], found[1]["by_clip"]) < 1e-4


@pytest.mark.parametrize("r", [1.0, 3.0])
def test_inside_a_closed_mesh_alpha_is_one_however_many_edges_there_are(gpu, r):
    ball, size, radius = sphere(2562), (64, 64), 24.0
    clip = project(ball.positions / np.linalg.norm(ball.positions, axis=1)[:, None] + (0, 0, -12.0), size, focal=radius * 12 / 64)
    with gpu.open(renderer(Topology(ball.faces, len(clip)), size, Softness(r), 0.1)) as session:
        alpha = render(session, clip=clip, attributes=np.zeros_like(ball.positions), by_alpha=np.ones((1, 64, 64)),
                       by_color=np.zeros((1, 64, 64, 3)))["alpha"][0]
    gpu.silent()
    centre = ((clip[:, :2] / clip[:, 3:] + 1) * 32).mean(0)
    ys, xs = np.mgrid[:64, :64] + 0.5
    inside = radius * 12 / np.sqrt(143) - np.hypot(xs - centre[0], ys - centre[1])
    assert (alpha[inside > r + 0.1] == 1).all()
    assert (alpha[inside < -r - 0.1] == 0).all()
    rim = np.abs(inside) < r - 0.1
    np.testing.assert_allclose(alpha[rim], 1 / (1 + np.exp(-inside[rim] * 7 / r)), atol=0.06 * 7 / r / 4)


def test_of_coincident_edges_and_faces_the_lowest_face_is_shown(gpu):
    size, square = (20, 20), np.array([(-0.5, -0.5, 0.5, 1), (0.52, -0.5, 0.5, 1), (0.5, 0.51, 0.5, 1), (-0.5, 0.5, 0.5, 1)])
    clip, faces = np.concatenate([square, square]), np.array([(0, 1, 2), (0, 2, 3), (4, 5, 6), (4, 6, 7)])
    attributes = np.repeat([(1.0, 0.0, 0.5), (0.0, 1.0, 0.5)], 4, axis=0)
    with gpu.open(renderer(Topology(faces, 8), size, Softness(3.0), 0.1)) as session:
        found = render(session, clip=clip, attributes=attributes, by_alpha=np.ones((1, 20, 20)), by_color=np.ones((1, 20, 20, 3)))
    gpu.silent()
    alpha = found["alpha"][0]
    assert ((alpha > 0) & (alpha < 0.5)).sum() > 50
    np.testing.assert_allclose(found["color"][0], attributes[0] * alpha[..., None] + 0.25 * (1 - alpha[..., None]), atol=1e-5)
    assert not found["by_clip"][4:].any() and found["by_clip"][:4].any()


@pytest.mark.parametrize("width", [0.0, 1e-6, 1e-3])
def test_beside_a_face_seen_edge_on_the_colour_is_that_of_its_edge(gpu, width):
    """However thin it is, as seen; the attribute is linear in space, so that it tells the place on the edge."""
    a, b = np.array([(-0.7, -0.6, 0.5, 1.0), (1.6, 1.0, 0.9, 2.0)])
    clip = np.array([a, b, (a + b) / 2 + (0, width, 0, 0)])
    attributes = clip[:, [0, 1, 3]] / 2 + (0.5, 0.5, 0.0)
    with gpu.open(renderer(Topology([(0, 1, 2)], 3), (20, 20), Softness(3.0), 0.1)) as session:
        found = render(session, clip=clip, attributes=attributes, by_alpha=np.ones((1, 20, 20)), by_color=np.ones((1, 20, 20, 3)))
    gpu.silent()
    soft = (found["alpha"][0] > 1e-3) & (found["alpha"][0] < 0.5)
    assert soft.sum() > 60
    _, _, t = brute_force.segment_distance(brute_force.pixel_centres((20, 20)), *((x[:2] / x[3] + 1) * 10 for x in (a, b)))
    on_edge = brute_force_outline.along_edge(a, b, *attributes[:2], t, 0.1)
    alpha = found["alpha"][0][..., None]
    np.testing.assert_allclose(found["color"][0][soft], (on_edge * alpha + 0.25 * (1 - alpha))[soft], atol=max(width, 1e-5))


def test_a_view_does_not_reach_into_the_cells_beside_it(gpu):
    size, near = (22, 18), 0.1
    ball, faces = icosahedron()
    away = project(0.5 * ball + (0, 0, 5.0), size, near)
    overlapping = project(1.4 * ball @ rotation(3).T + (0.1, 0.0, -3.0), size, near)  # larger than its cell on every side
    with gpu.open(renderer(Topology(faces, len(ball)), size, Softness(4.0), near, 9, 3)) as session:
        for view in (0, 4, 8):
            clip = np.array([overlapping if v == view else away for v in range(9)])
            found = render(session, clip=clip.reshape(-1, 4), attributes=np.ones((len(ball), 3)), by_alpha=np.ones((9, 18, 22)),
                           by_color=np.ones((9, 18, 22, 3)))
            others = np.arange(9) != view
            assert found["alpha"][view].mean() > 0.7
            assert not found["alpha"][others].any()
            assert not found["by_clip"].reshape(9, -1)[others].any()
    gpu.silent()


def test_what_lies_beyond_far_is_drawn_at_either_distance(gpu):
    """Depth only orders: a vertex with z > w is no further than the last."""
    s = SCENES["quad"]
    clip = rounded(s.clip)
    clip[:, 2] = clip[:, 3] * 1.1
    for softness in (Softness(3.0), Softness(3.0, distance="face")):
        check(gpu, s._replace(clip=clip), softness)


# Views


@pytest.mark.parametrize("softness", [Softness(2.5), Softness(2.5, distance="face"), Softness(2.5, layers=2)],
                         ids=["outline", "face", "layers"])
def test_an_atlas_of_views_is_the_views_one_by_one(gpu, softness):
    size, near = (22, 18), 0.1
    ball, faces = icosahedron()
    topology = Topology(faces, len(ball))
    rng = np.random.default_rng(4)
    clips = np.array([project(0.9 * ball @ rotation(k).T + (0.4 * k - 1, 0.04, -3.3), size, near) for k in (2, 3, 4)])
    attributes, by_alpha = rng.uniform(size=(len(ball), 3)), rng.normal(size=(3, 18, 22))
    by_color = rng.normal(size=(3, 18, 22, 3))
    with gpu.open(renderer(topology, size, softness, near, 3, 2)) as session:
        atlas = render(session, clip=clips.reshape(-1, 4), attributes=attributes, by_alpha=by_alpha, by_color=by_color)
    with gpu.open(renderer(topology, size, softness, near)) as session:
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
