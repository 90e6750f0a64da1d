"""Losses, regularizers and normals: values against NumPy loops, gradients against central differences."""

import numpy as np
import pytest
from corpus import icosahedron

from dressi_edge.cache.errors import GraphError
from dressi_edge.cache.layout import Layout
from dressi_edge.compiler.graph import functions as F
from dressi_edge.compiler.graph.autodiff import gradients
from dressi_edge.compiler.graph.ir import image, topological
from dressi_edge.compiler.graph.optable import apply
from dressi_edge.compiler.graph.program import Program
from dressi_edge.compiler.graph.reference import evaluate
from dressi_edge.compiler.render.loss import COTANGENTS, cotangent_laplacian, l1, l2, normal_consistency, uniform_laplacian
from dressi_edge.compiler.render.normals import face_normals, vertex_normals
from dressi_edge.compiler.render.topology import Topology


def meshes() -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Positions and faces: closed; open with an isolated vertex; with degenerate faces and an edge of three faces; one face; 70
    faces around a vertex."""
    rng = np.random.default_rng(3)
    p, f = icosahedron()
    p = p + rng.normal(scale=0.1, size=p.shape)
    isolated = np.vstack([p, [[3.0, 1.0, 2.0]]])
    middle = np.vstack([p, [0.25 * p[0] + 0.75 * p[11]], p[5:6]])  # on an edge, on a vertex
    bad = np.vstack([f, [[0, 12, 11], [5, 13, 4], [0, 5, 9]]])
    one = p[:3], np.array([[0, 1, 2]])
    k, angle = np.arange(70), np.linspace(0, 2 * np.pi, 70, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle), 0.2 * np.cos(3 * angle)], 1)
    fan = np.vstack([ring, [[0.1, 0.2, 0.5]]]), np.stack([k, (k + 1) % 70, 0 * k + 70], 1)
    return {"closed": (p, f), "open": (isolated, f[:13]), "degenerate": (middle, bad), "triangle": one, "fan": fan}


MESHES = meshes()
DEGENERATE = {"degenerate": {20, 21}}


@pytest.fixture(params=MESHES)
def mesh(request):
    p, f = MESHES[request.param]
    return p, f, DEGENERATE.get(request.param, set())


def positions_of(p):
    layout = Layout("table", "vec3", count=len(p))
    return Program().input("p", layout), layout


def differences(function, p, h=1e-6):
    out = np.zeros_like(p)
    for k in np.ndindex(p.shape):
        high, low = p.copy(), p.copy()
        high[k] += h
        low[k] -= h
        out[k] = (function(high) - function(low)) / (2 * h)
    return out


def check(build, loop, p, tolerance=2e-7):
    """The graph's value is the loop's, its gradient the loop's central difference, and its padding stays out."""
    node, layout = positions_of(p)
    loss = build(node)
    value, gradient = evaluate([loss, *gradients(loss, [node])], {"p": layout.to_image(p, "p")})
    assert np.isfinite(gradient).all()
    np.testing.assert_allclose(value.item(), loop(p), rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(layout.from_image(gradient), differences(loop, p), rtol=1e-5, atol=tolerance)
    assert not gradient.reshape(-1, 3)[len(p):].any()
    return layout.from_image(gradient)


def neighbours_loop(f, count):
    near = [set() for _ in range(count)]
    for face in f:
        for a in face:
            near[a] |= {b for b in face if b != a}
    return near


def uniform_loop(p, f, power):
    total = 0.0
    for v, near in enumerate(neighbours_loop(f, len(p))):
        if near:
            total += np.linalg.norm(p[v] - sum(p[n] for n in near) / len(near)) ** power
    return total / len(p)


def cotangent_weights(p, f, skip):
    """{(i, j): weight} from angles, limited as documented."""
    weights = {}
    for number, face in enumerate(f):
        if number in skip:
            continue
        for k in range(3):
            c, i, j = face[k], face[(k + 1) % 3], face[(k + 2) % 3]
            u, v = p[i] - p[c], p[j] - p[c]
            cosine = u @ v / np.linalg.norm(u) / np.linalg.norm(v)
            w = np.clip(1 / np.tan(np.arccos(cosine)), *COTANGENTS)
            weights[i, j] = weights.get((i, j), 0) + w / 2
            weights[j, i] = weights.get((j, i), 0) + w / 2
    return weights


def cotangent_loop(p, weights, power):
    total, rows = 0.0, {}
    for (i, j), w in weights.items():
        rows.setdefault(i, {})[j] = w
    for i, near in rows.items():
        total += np.linalg.norm(p[i] - sum(w * p[j] for j, w in near.items()) / sum(near.values())) ** power
    return total / len(p)


def consistency_loop(p, f, skip=frozenset()):
    faces_of, total, count = {}, 0.0, 0
    for number, face in enumerate(f):
        for k in range(3):
            a, b = face[k], face[(k + 1) % 3]
            faces_of.setdefault((min(a, b), max(a, b)), []).append((number, a < b))
    for pair in faces_of.values():
        if len(pair) != 2:
            continue
        count += 1
        (m, along_m), (n, along_n) = pair
        if m in skip or n in skip:
            continue
        u, v = (np.cross(p[f[k][1]] - p[f[k][0]], p[f[k][2]] - p[f[k][0]]) for k in (m, n))
        cosine = u @ v / np.linalg.norm(u) / np.linalg.norm(v)
        total += 1 - (cosine if along_m != along_n else -cosine)
    return total / count if count else 0.0


@pytest.mark.parametrize("power", [1, 2])
def test_uniform_laplacian_is_the_mean_distance_from_the_neighbours_mean(mesh, power):
    p, f, _ = mesh
    check(lambda x: uniform_laplacian(x, Topology(f, len(p)), power), lambda q: uniform_loop(q, f, power), p)


@pytest.mark.parametrize("power", [1, 2])
def test_cotangent_laplacian_weighs_neighbours_by_frozen_cotangents(mesh, power):
    p, f, skip = mesh
    weights = cotangent_weights(p, f, skip)
    check(lambda x: cotangent_laplacian(x, Topology(f, len(p)), power), lambda q: cotangent_loop(q, weights, power), p)


def test_cotangents_are_limited():
    p = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, 0.01, 0], [0.4, -1, 0.2]])
    f = np.array([[0, 1, 2], [1, 0, 3]])
    weights = cotangent_weights(p, f, set())
    assert weights[0, 2] == COTANGENTS[1] / 2 and weights[0, 1] < 0.5
    check(lambda x: cotangent_laplacian(x, Topology(f, 4), 2), lambda q: cotangent_loop(q, weights, 2), p)


def test_normal_consistency_is_the_mean_of_one_minus_cosine_over_edges_of_two_faces(mesh):
    p, f, skip = mesh
    check(lambda x: normal_consistency(x, Topology(f, len(p))), lambda q: consistency_loop(q, f, skip), p)


def test_normal_consistency_does_not_depend_on_the_faces_winding():
    p, f = MESHES["closed"]
    mixed = f.copy()
    mixed[::3] = mixed[::3, ::-1]
    g, h = (check(lambda x, f=f: normal_consistency(x, Topology(f, len(p))), lambda q, f=f: consistency_loop(q, f), p)
            for f in (f, mixed))
    np.testing.assert_allclose(g, h, atol=1e-12)


def test_consistent_winding_needs_no_table_of_signs():
    p, f = MESHES["closed"]
    node, _ = positions_of(p)
    nodes = topological([normal_consistency(node, Topology(f, len(p)))])
    assert not [n for n in nodes if n.op.name == "constant" and n.vtype == "float"]


@pytest.mark.parametrize("regularizer", [uniform_laplacian, cotangent_laplacian, normal_consistency])
def test_a_mesh_shrunk_to_a_point_has_zero_loss_and_gradient(regularizer):
    p, f = MESHES["closed"]
    node, layout = positions_of(p)
    loss = regularizer(node, Topology(f, len(p)))
    value, gradient = evaluate([loss, *gradients(loss, [node])], {"p": layout.to_image(np.zeros_like(p), "p")})
    assert value.item() == 0 and not gradient.any()


@pytest.mark.parametrize("regularizer", [uniform_laplacian, cotangent_laplacian, normal_consistency])
def test_a_flat_grid_is_flat(regularizer):
    x, y = np.meshgrid(np.arange(4.0), np.arange(4.0))
    p = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], 1)
    quads = np.array([[i, i + 1, i + 5, i + 4] for r in range(3) for i in range(4 * r, 4 * r + 3)])
    f = np.vstack([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    node, layout = positions_of(p)
    loss = regularizer(node, Topology(f, 16))
    value, gradient = evaluate([loss, *gradients(loss, [node])], {"p": layout.to_image(p, "p")})
    assert not layout.from_image(gradient)[:, 2].any()
    if regularizer is normal_consistency:
        assert value.item() == 0 and not gradient.any()


def test_without_shared_edges_normal_consistency_is_zero():
    node, layout = positions_of(np.zeros((3, 3)))
    loss = normal_consistency(node, Topology(np.array([[0, 1, 2]]), 3))
    value, gradient = evaluate([loss, *gradients(loss, [node])], {"p": layout.to_image(np.zeros((3, 3)), "p")})
    assert value.item() == 0 and not gradient.any()


def test_regularizers_name_a_wrong_table_and_a_wrong_power():
    p, f = MESHES["closed"]
    node, _ = positions_of(p)
    with pytest.raises(GraphError, match="table of 13"):
        uniform_laplacian(node, Topology(f, 13))
    with pytest.raises(GraphError, match="power 3"):
        uniform_laplacian(node, Topology(f, 12), 3)


def depth(node):
    """Passes that lookups by index force, one after another."""
    at = {}
    for n in topological([node]):
        elsewhere = any(read == "texel" and x.op.name != "constant" for x, read in zip(n.inputs, n.op.reads))
        at[n] = max((at[x] for x in n.inputs), default=0) + (elsewhere and n.op.name != "sum")
    return at[node]


@pytest.mark.parametrize("regularizer, levels", [(uniform_laplacian, (1, 2)), (cotangent_laplacian, (2, 4)),
                                                 (normal_consistency, (2, 4))])
def test_regularizers_need_few_levels_of_lookups(regularizer, levels):
    p, f = MESHES["closed"]
    node, _ = positions_of(p)
    loss = regularizer(node, Topology(f, len(p)))
    assert (depth(loss), depth(gradients(loss, [node])[0])) == levels


# Normals


def face_normals_loop(p, f):
    return np.array([np.cross(p[b] - p[a], p[c] - p[a]) for a, b, c in f])


def vertex_normals_loop(p, f):
    out = np.zeros_like(p)
    for face, n in zip(f, face_normals_loop(p, f)):
        for v in face:
            out[v] += n
    size = np.linalg.norm(out, axis=1, keepdims=True)
    return np.where(size > 1e-9, out / np.where(size > 1e-9, size, 1), 0)


@pytest.mark.parametrize("build, loop", [(lambda x, t: face_normals(x, t.faces), face_normals_loop),
                                         (vertex_normals, vertex_normals_loop)], ids=["faces", "vertices"])
def test_normals_equal_the_loops(mesh, build, loop):
    p, f, _ = mesh
    node, layout = positions_of(p)
    result = build(node, Topology(f, len(p)))
    value, = evaluate([result], {"p": layout.to_image(p, "p")})
    np.testing.assert_allclose(Layout("table", "vec3", count=result.extent.count).from_image(value), loop(p, f), atol=1e-12)
    w = np.random.default_rng(1).normal(size=(result.extent.count, 3))
    if build is vertex_normals:
        w *= loop(p, f).any(1, keepdims=True)  # where no normal is defined its difference is not either
    topology = Topology(f, len(p))
    check(lambda x: F.total(F.dot(build(x, topology), F.constant_table(w))), lambda q: (loop(q, f) * w).sum(), p, 1e-6)


@pytest.mark.parametrize("p, f", [(np.random.default_rng(0).normal(size=(3, 3)), [[0, 1, 2], [0, 2, 1]]),
                                  ([[0.1, 0.2, 0.3], [0.2, 0.4, 0.6], [0.7, 1.4, 2.1]], [[0, 1, 2]])],
                         ids=["two sides", "line"])
def test_vertices_whose_normal_is_not_defined_have_zero_normal_and_gradient(p, f):
    p = np.array(p)
    node, layout = positions_of(p)
    normals = vertex_normals(node, Topology(np.array(f), 3))
    loss = F.total(F.dot(normals, F.constant_table(np.random.default_rng(1).normal(size=(3, 3)))))
    value, gradient = evaluate([normals, *gradients(loss, [node])], {"p": layout.to_image(p, "p")})
    assert not value.any() and not gradient.any()


# Image losses


@pytest.mark.parametrize("loss, power", [(l1, 1), (l2, 2)])
@pytest.mark.parametrize("vtype", ["float", "vec2", "vec3", "vec4"])
@pytest.mark.parametrize("masked", [False, True])
def test_image_losses_are_means_over_texels_and_channels(loss, power, vtype, masked):
    rng = np.random.default_rng(5)
    layout = Layout("image", vtype, width=5, height=4)
    a, b, m = rng.normal(size=layout.shape), rng.normal(size=layout.shape), rng.random((4, 5))
    node = Program().input("a", layout)
    mask = F.constant(m[..., None]) if masked else None
    result = loss(node, F.constant(layout.to_image(b, "b")), mask)
    weights = (m if a.ndim == 2 else m[..., None]) if masked else 1.0

    def loop(x):
        return (abs(x - b) ** power * weights).mean()

    value, gradient = evaluate([result, *gradients(result, [node])], {"a": layout.to_image(a, "a")})
    np.testing.assert_allclose(value.item(), loop(a), rtol=1e-12)
    np.testing.assert_allclose(layout.from_image(gradient), differences(loop, a), rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("loss, expected", [(l1, 1.0), (l2, 1.5)])
def test_image_losses_leave_padding_out(loss, expected):
    layout = Layout("table", "float", count=37)
    node = Program().input("a", layout)
    assert node.extent.width * node.extent.height > 37
    pixels = layout.to_image(np.where(np.arange(37) < 36, np.arange(37) % 2 + 0.5, 0.0) * np.sqrt(1.2) ** (loss is l2), "a")
    pixels.reshape(-1)[37:] = 1e9
    value, = evaluate([loss(node, 0.0)], {"a": pixels})
    np.testing.assert_allclose(value.item(), expected * 36 / 37, rtol=1e-12)


def test_equal_images_have_zero_loss_and_gradient():
    layout = Layout("image", "vec3", width=3, height=2)
    node = Program().input("a", layout)
    a = np.random.default_rng(0).random((2, 3, 3))
    for loss in (l1, l2):
        value, gradient = evaluate([r := loss(node, F.constant(a)), *gradients(r, [node])], {"a": a})
        assert value.item() == 0 and not gradient.any()


def test_a_mask_of_the_wrong_type_is_named():
    node = apply("input", name="a", vtype="vec3", extent=image(3, 2))
    with pytest.raises(GraphError, match="mask"):
        l1(node, 0.0, node)
