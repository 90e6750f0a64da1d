"""Poses, linear models, skinning, subdivision, smooth coordinates: values against NumPy, transposes against central differences, and each
in a scene, where it is found again from silhouettes."""

import numpy as np
import pytest

from dressi_edge.cache.errors import InputError
from dressi_edge.cache.layout import Layout
from dressi_edge.compiler.graph.autodiff import gradients
from dressi_edge.compiler.graph.program import Program
from dressi_edge.compiler.graph.reference import evaluate
from dressi_edge.compiler.graph.reference_session import ReferenceSession
from dressi_edge.compiler.io.cameras import look_at, rotation_matrix
from dressi_edge.compiler.io.shapes import icosphere
from dressi_edge.compiler.render.topology import Topology
from dressi_edge.compiler.scene import (
    Adam,
    AdamUniform,
    F,
    LargeSteps,
    Mesh,
    Outline,
    Scene,
    blend_shapes,
    l2,
    linear_model,
    rigid,
    similarity,
    skin,
    subdivide,
)

pytest_plugins = ["gpu"]

RNG = np.random.default_rng(4)
BALL = icosphere(1)
N = len(BALL.positions)


def parameters(**values):
    """Nodes of values by name: of up to four numbers one value, else a table; and their layouts."""
    program, nodes, layouts = Program(), {}, {}
    for name, array in values.items():
        array = np.asarray(array, float)
        unit = array.ndim == 0 or array.ndim == 1 and len(array) <= 4
        kind = {1: "float", 2: "vec2", 3: "vec3", 4: "vec4"}[(array.shape[-1] if array.ndim else 1) if unit or array.ndim == 2 else 1]
        layouts[name] = Layout("unit", kind) if unit else Layout("table", kind, count=len(array))
        nodes[name] = program.input(name, layouts[name])
    return nodes, layouts


def check(build, loop, h=1e-6, **values):
    """The table that `build` makes of nodes is the loop's of arrays; the gradient of a weighted sum of it by each is the loop's central
    difference."""
    values = {name: np.asarray(x, float) for name, x in values.items()}
    nodes, layouts = parameters(**values)
    table = build(**nodes)
    expected = loop(**values)
    w = np.random.default_rng(7).normal(size=expected.shape)
    inner = F.total(F.dot(table, F.constant_table(w)))
    feed = {name: layouts[name].to_image(x, name) for name, x in values.items()}
    found, *by = evaluate([table, *gradients(inner, list(nodes.values()))], feed)
    np.testing.assert_allclose(Layout("table", table.vtype, count=len(expected)).from_image(found), expected, rtol=1e-10, atol=1e-10)
    for (name, x), g in zip(values.items(), by):
        slope = np.zeros(x.shape)
        for k in np.ndindex(x.shape):
            high, low = x.copy(), x.copy()
            high[k] += h
            low[k] -= h
            slope[k] = ((loop(**{**values, name: high}) - loop(**{**values, name: low})) * w).sum() / (2 * h)
        np.testing.assert_allclose(layouts[name].from_image(g), slope, rtol=1e-5, atol=1e-6, err_msg=name)


@pytest.mark.parametrize("rotation", [(0.3, -0.7, 1.1), (0.0, 0.0, 0.0), (0.0, 3.1, 0.0)])
def test_a_pose_turns_about_its_pivot_and_moves(rotation):
    points, pivot = RNG.normal(size=(9, 3)), np.array([0.2, -0.1, 0.5])

    def loop(rotation, translation, scale, points, pivot):
        return scale * (points - pivot) @ rotation_matrix(rotation).T + pivot + translation

    check(lambda rotation, translation, scale, points, pivot: similarity(points, rotation, translation, scale, pivot), loop,
          rotation=rotation, translation=(0.5, 1.0, -2.0), scale=1.3, points=points, pivot=pivot)
    check(lambda rotation, translation: rigid(points, rotation, translation, (0.2, -0.1, 0.5)),
          lambda rotation, translation: loop(rotation, translation, 1.0, points, pivot), rotation=rotation, translation=(1, 2, 3))


@pytest.mark.parametrize("k", [1, 3, 5, 17])
def test_a_linear_model_is_mean_and_basis_times_coefficients(k):
    mean, basis = RNG.normal(size=(9, 3)), np.float32(RNG.normal(size=(9, 3, k))).astype(float)
    start = RNG.normal(size=k) if k > 1 else RNG.normal()
    check(lambda c, offsets: linear_model(mean, basis, c) + offsets,
          lambda c, offsets: mean + basis @ np.atleast_1d(c) + offsets, c=start, offsets=RNG.normal(size=(9, 3)))


def test_blend_shapes_move_few_vertices():
    vertex, shape = RNG.integers(0, 9, 20), RNG.integers(0, 6, 20)
    offset, mean = RNG.normal(size=(20, 3)), RNG.normal(size=(9, 3))

    def loop(c, mean):
        out = mean.copy()
        for v, s, o in zip(vertex, shape, offset):
            out[v] += o * c[s]
        return out

    check(lambda c, mean: blend_shapes(mean, vertex, shape, offset, c), loop, c=RNG.normal(size=6), mean=mean)


def weights_of(vertices, bones):
    w = RNG.uniform(size=(vertices, bones)) * (RNG.uniform(size=(vertices, bones)) < 0.6)
    w[:, 0] += 0.1
    return w / w.sum(1, keepdims=True)


@pytest.mark.parametrize("sparse", [False, True])
def test_skin_follows_its_bones(sparse):
    w, pivots = weights_of(9, 4), RNG.normal(size=(4, 3))
    where = np.nonzero(w)

    def loop(points, rotation, translation):
        out = np.zeros_like(points)
        for b in range(4):
            out += w[:, b:b + 1] * ((points - pivots[b]) @ rotation_matrix(rotation[b]).T + pivots[b] + translation[b])
        return out

    check(lambda points, rotation, translation: skin(points, (*where, w[where]) if sparse else w, rotation, translation, pivots), loop,
          points=RNG.normal(size=(9, 3)), rotation=RNG.normal(size=(4, 3)), translation=RNG.normal(size=(4, 3)))


# Subdivision


def loop_rules(mesh):
    """One level by the rules, vertex by vertex: the positions that the coarse vertices get, and those of edges by their ends."""
    faces_of, p = {}, mesh.positions
    for face in mesh.faces.tolist():
        for k in range(3):
            faces_of.setdefault(frozenset((face[k], face[(k + 1) % 3])), []).append(face)
    edges = {}
    for ends, faces in faces_of.items():
        a, b = ends
        edges[ends] = (p[a] + p[b]) / 2
        if len(faces) == 2:
            edges[ends] = 0.375 * (p[a] + p[b]) + 0.125 * sum(p[v] for f in faces for v in f if v not in ends)
    even = p.copy()
    for v in range(len(p)):
        around = [next(iter(ends - {v})) for ends in faces_of if v in ends]
        creases = [next(iter(ends - {v})) for ends, faces in faces_of.items() if v in ends and len(faces) != 2]
        if not creases and len(around) > 2:
            beta = 3 / 16 if len(around) == 3 else 3 / 8 / len(around)
            even[v] = (1 - len(around) * beta) * p[v] + beta * sum(p[u] for u in around)
        elif len(creases) == 2:
            even[v] = 0.75 * p[v] + 0.125 * (p[creases[0]] + p[creases[1]])
    return even, edges


def meshes():
    sheet = np.array([(x, y, 0.3 * np.sin(x + 2 * y)) for y in range(4) for x in range(4)], float)
    quads = [(4 * y + x, 4 * y + x + 1, 4 * y + x + 5, 4 * y + x + 4) for y in range(3) for x in range(3) if (x, y) != (1, 1)]
    tetrahedron = np.array([(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)], float)
    fins = np.array([(0, -1, 0), (0, 1, 0), (1, 0, 0), (-1, 0, 0.2), (0, 0, 1), (5, 5, 5)], float)
    return {"closed": BALL, "valence 3": Mesh(tetrahedron, [(0, 1, 2), (0, 3, 1), (0, 2, 3), (1, 3, 2)]),
            "open, with a hole": Mesh(sheet, [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]),
            "three at an edge, and a vertex of no face": Mesh(fins, [(0, 1, 2), (0, 1, 3), (0, 1, 4)])}


@pytest.mark.parametrize("mesh", meshes().values(), ids=meshes())
def test_a_level_of_loop_subdivision_follows_the_rules(mesh):
    fine, matrix = subdivide(mesh)
    even, edges = loop_rules(mesh)
    n = len(mesh.positions)
    assert len(fine.positions) == n + len(edges) and len(fine.faces) == 4 * len(mesh.faces)
    np.testing.assert_allclose(fine.positions[:n], even, atol=1e-12)
    flat, _ = subdivide(mesh, scheme="midpoint")
    np.testing.assert_array_equal(flat.faces, fine.faces)
    for f, face in enumerate(mesh.faces.tolist()):
        first, second, third, middle = fine.faces[4 * f:4 * f + 4].tolist()
        assert [first[0], second[1], third[2]] == face
        for k, v in enumerate(middle):  # of the edge from corner k to the next
            ends = (face[k], face[(k + 1) % 3])
            np.testing.assert_allclose(fine.positions[v], edges[frozenset(ends)], atol=1e-12)
            np.testing.assert_allclose(flat.positions[v], mesh.positions[list(ends)].mean(0), atol=1e-12)
        assert first[1] == second[0] == middle[0] and second[2] == third[1] == middle[1] and third[0] == first[2] == middle[2]
    np.testing.assert_allclose(matrix(np.ones(n)), 1.0)


def test_levels_are_one_matrix_with_its_transpose():
    coarse = icosphere(0)
    fine, matrix = subdivide(coarse, 2)
    once, first = subdivide(coarse)
    twice, second = subdivide(once)
    np.testing.assert_allclose(fine.positions, second(first(coarse.positions)), atol=1e-12)
    np.testing.assert_array_equal(fine.faces, twice.faces)
    assert len(np.unique(matrix.rows * matrix.source + matrix.cols)) == len(matrix.rows)
    check(lambda x: matrix(x), lambda x: matrix(x), x=coarse.positions)
    same, identity = subdivide(coarse, 0)
    assert same is coarse and (identity(coarse.positions) == coarse.positions).all()


def test_what_corners_have_is_halved_along_edges():
    fine, _ = subdivide(BALL, 2)
    assert fine.uv_faces.shape == fine.faces.shape
    corners = fine.uvs[fine.uv_faces]
    coarse = BALL.uvs[BALL.uv_faces]
    np.testing.assert_allclose(corners[0::16][:, 0], coarse[:, 0])  # the first child of the first child has the first corner
    areas = [np.abs(np.cross(c[:, 1] - c[:, 0], c[:, 2] - c[:, 0])).reshape(len(BALL.faces), -1).sum(1) for c in
             (np.concatenate([x, np.zeros((*x.shape[:2], 1))], 2)[..., :3] for x in (corners, coarse))]
    np.testing.assert_allclose(areas[0], areas[1], rtol=1e-9)
    painted = Mesh(BALL.positions, BALL.faces, colors=np.eye(3)[RNG.integers(0, 3, 3 * len(BALL.faces))],
                   color_faces=np.arange(3 * len(BALL.faces)).reshape(-1, 3), normals=np.eye(3), normal_faces=[[0, 1, 2]] * len(BALL.faces))
    finer, _ = subdivide(painted)
    np.testing.assert_allclose(finer.colors[finer.color_faces[3::4]][:, 0], painted.colors[painted.color_faces][:, :2].mean(1))
    np.testing.assert_allclose(np.linalg.norm(finer.normals, axis=1), 1.0)


# Smooth coordinates


def test_large_steps_are_the_inverse_of_the_laplacian_and_its_transpose():
    steps = LargeSteps(Topology(BALL.faces, N), 7.0)
    laplacian = np.zeros((N, N))
    for a, b in Topology(BALL.faces, N).edges:
        laplacian[[a, b], [a, b]] += 1
        laplacian[[a, b], [b, a]] -= 1
    matrix = np.eye(N) + 7 * laplacian
    u = steps.encode(BALL.positions)
    np.testing.assert_allclose(u, matrix @ BALL.positions, atol=1e-12)
    nodes, layouts = parameters(u=u)
    w = RNG.normal(size=(N, 3))
    found, by = evaluate([steps(nodes["u"]), *gradients(F.total(F.dot(steps(nodes["u"]), F.constant_table(w))), [nodes["u"]])],
                         {"u": layouts["u"].to_image(u, "u")})
    np.testing.assert_allclose(layouts["u"].from_image(found), BALL.positions, atol=1e-6)  # the matrix is kept in fp32
    np.testing.assert_allclose(layouts["u"].from_image(by), np.linalg.solve(matrix.T, w), atol=1e-6)


# In scenes

CAMERAS = [look_at(eye, (0, 0, 0), (0, 1, 0), 40.0, 24, 24) for eye in ((0.0, 0.3, 3.4), (3.2, 0.8, 0.3))]
WEIGHTS = 1 / (1 + np.exp(-4 * BALL.positions[:, :1] @ [[1.0]]))


def bump(size):
    """A basis of `size` smooth bumps of the ball."""
    centers = BALL.positions[np.linspace(0, N - 1, size).astype(int)]
    near = np.exp(-4 * ((BALL.positions[:, None] - centers) ** 2).sum(2))
    return BALL.positions[:, :, None] * near[:, None]


def pose(s):
    turn, move = s.parameter("turn", (0.0, 0.0, 0.0)), s.parameter("move", (0.0, 0.0, 0.0))
    return similarity(BALL.positions * (1.0, 0.6, 0.8), turn, move, s.parameter("scale", 1.0)), BALL, {
        "turn": (0.2, 0.1, 0.4), "move": (0.15, -0.1, 0.1), "scale": 0.9}


def model(s):
    c = s.parameter("shape", np.zeros(6), kind="table")
    return linear_model(BALL.positions * 0.7, bump(6), c), BALL, {"shape": np.array([0.3, -0.2, 0.4, 0.2, -0.3, 0.3])}


def face(s):
    c, vertex = s.parameter("shape", np.zeros(3)), np.arange(N)
    return blend_shapes(BALL.positions * 0.7, vertex, vertex % 3, 0.4 * BALL.positions, c), BALL, {"shape": np.array([0.3, -0.5, 0.6])}


def arm(s):
    w = np.hstack([WEIGHTS, 1 - WEIGHTS])
    turn, move = (s.parameter(name, np.zeros((2, 3)), kind="table") for name in ("turn", "move"))
    return skin(BALL.positions * (1.1, 0.4, 0.4), w, turn, move), BALL, {
        "turn": np.array([(0.0, 0.2, 0.5), (0.0, -0.1, 0.4)]), "move": np.array([(0.1, 0.2, 0.0), (0.0, 0.1, 0.0)])}


def cage(s):
    mesh, matrix = subdivide(icosphere(0), 1)
    x = s.parameter("cage", icosphere(0).positions)
    return matrix(x), mesh, {"cage": icosphere(0).positions * (1.2, 0.8, 1.0) + (0.1, 0.0, 0.1)}


def smooth(s):
    steps = LargeSteps(Topology(BALL.faces, N), 2.0)
    u = s.parameter("u", steps.encode(BALL.positions * 0.7))
    return steps(u), BALL, {"u": steps.encode(BALL.positions * (0.9, 0.6, 0.7))}


SCENES = {f.__name__: f for f in (pose, model, face, arm, cage, smooth)}


def fit(build):
    """A scene of that geometry; silhouettes of what it shall become; what that is."""
    s = Scene(CAMERAS)
    positions, mesh, true = build(s)
    s.add(mesh, positions)
    frame = s.frame(Outline(2.0))
    target = s.input("target", shape=(2, 24, 24))
    s.phase("fit", 60, {name: (AdamUniform if name == "u" else Adam)(0.05 if name == "u" else 0.02) for name in true},
            alpha=l2(frame.alpha, target))
    feed = {name: value.layout.to_image(true.get(name, value.initial), name) for name, value in s.program.values.items()
            if value.initial is not None}
    return s, s.program.values["target"].layout.from_image(evaluate([frame.alpha], feed)[0]), true


@pytest.mark.parametrize("build", SCENES.values(), ids=SCENES)
def test_what_a_geometry_is_made_of_is_found_from_silhouettes(build):
    s, target, _ = fit(build)
    with ReferenceSession(s.program) as session:
        session.set("target", target)
        before = session.loss()
        session.step(15)
        assert session.loss() < 0.3 * before


@pytest.mark.parametrize("build", [arm, model], ids=["arm", "model"])
def test_a_device_makes_the_references_first_step(gpu, build):
    s, target, true = fit(build)
    with ReferenceSession(s.program) as reference, gpu.open(s.program) as session:
        for each in (reference, session):
            each.set("target", target)
        np.testing.assert_allclose(session.loss(), reference.loss(), rtol=1e-4)
        for each in (reference, session):
            each.step(1)
        for name in true:
            expected = reference.get(f"{name}.adam_m")
            np.testing.assert_allclose(session.get(f"{name}.adam_m"), expected, atol=1e-3 * abs(expected).max(), err_msg=name)
    gpu.silent()


P = F.constant_table(np.zeros((N, 3)))
C = F.constant_table(np.zeros(5))
TURN = F.constant_table(np.zeros((2, 3)))


@pytest.mark.parametrize("make, message", [
    (lambda: rigid(P.x, (0, 0, 0), (0, 0, 0)), "positions are .*; a vec3 table"),
    (lambda: rigid(np.zeros((4, 2)), (0, 0, 0), (0, 0, 0)), r"positions has shape \(4, 2\); \(n, 3\)"),
    (lambda: rigid(P, P, (0, 0, 0)), "rotation is .*; a vec3 of extent 1x1"),
    (lambda: similarity(P, (0, 0, 0), (0, 0, 0), (1, 2, 3)), r"scale has shape \(3,\)"),
    (lambda: rigid(P, (0, 0, np.inf), (0, 0, 0)), "rotation has numbers that are not finite"),
    (lambda: linear_model(P, np.zeros((7, 3, 5)), C), r"the basis has shape \(7, 3, 5\); \(42, 3, k\)"),
    (lambda: linear_model(P, np.zeros((N, 3, 6)), C), "coefficients are .*; a table of 6 floats"),
    (lambda: blend_shapes(P, np.array([50]), np.array([0]), np.ones((1, 3)), C), "vertices are 50 to 50"),
    (lambda: blend_shapes(P, np.array([5]), np.array([5]), np.ones((1, 3)), C), "shapes are 5 to 5.*0 to 4"),
    (lambda: blend_shapes(P, np.array([5]), np.array([0]), np.ones((1, 3)), 3.0), "coefficients are 3.0"),
    (lambda: skin(P, np.ones((N, 2)), TURN, TURN), "weights of vertex 0 add up to 2; 1 is needed"),
    (lambda: skin(P, np.ones((N, 3)), TURN, TURN), r"weights has shape \(42, 3\); \(42, 2\)"),
    (lambda: skin(P, np.ones((N, 2)), TURN, P), "translation is .*; a vec3 table of one entry for each bone"),
    (lambda: skin(P, (np.arange(N), np.full(N, 2), np.ones(N)), TURN, TURN), "bones of weights are 2 to 2"),
    (lambda: skin(P, (np.arange(N), np.ones(N)), TURN, TURN), "weights are 2 arrays"),
    (lambda: subdivide(BALL, -1), "-1 levels of 80 faces; a whole number from 0 on"),
    (lambda: subdivide(BALL, 9), "9 levels of 80 faces; .* at most 4194304"),
    (lambda: subdivide(BALL, 1, "butterfly"), "scheme is 'butterfly'; allowed: loop midpoint"),
    (lambda: subdivide(Mesh(np.eye(3), [[0, 1, 2], [0, 1, 1]])), r"faces\[1\] is \[0, 1, 1\], which names a vertex twice"),
    (lambda: subdivide(BALL)[1](C), "has 5 entries; 42 are needed"),
    (lambda: subdivide(BALL)[1](np.zeros(5)), r"an array of shape \(5,\); \(42, c\)"),
    (lambda: LargeSteps(Topology(BALL.faces, N), -1.0), "weight is -1.0; a number from 0 on"),
    (lambda: LargeSteps(Topology(BALL.faces, 9000)), "9000 vertices; at most 8192"),
    (lambda: LargeSteps(Topology(BALL.faces, N))(C), "u is .*; a vec3 table of 42 entries"),
])
def test_what_a_geometry_cannot_be_made_of_is_named(make, message):
    with pytest.raises(InputError, match=message) as caught:
        make()
    assert "\n" not in str(caught.value)
