"""What the graph keeps apart has passes of its own, in its tiles alone; parts that are made alike are shaded as one."""

import numpy as np
import pytest

from dressi_edge.cache.errors import InputError
from dressi_edge.cache.profile import Profile
from dressi_edge.compiler import build
from dressi_edge.compiler.graph.functions import apply, maximum, select, sigmoid
from dressi_edge.compiler.graph.ir import Extent, topological
from dressi_edge.compiler.graph.reference_session import ReferenceSession
from dressi_edge.compiler.passes.apart import find_apart
from dressi_edge.compiler.passes.known import Known
from dressi_edge.compiler.passes.substage import TILES
from dressi_edge.compiler.render.alike import runs
from dressi_edge.compiler.scene import (
    Adam,
    BlinnPhong,
    F,
    HardSoftRas,
    Light,
    Mesh,
    Outline,
    Scene,
    Unlit,
    Vertex,
    icosphere,
    l2,
    orbit,
)

pytest_plugins = ["gpu"]

BALL = icosphere(2, 0.8)
SHAPE = (2, 33, 40)


def halves():
    left = BALL.positions[BALL.faces].mean(1)[:, 0] > 0
    pieces = [np.unique(faces, return_inverse=True) for faces in (BALL.faces[left], BALL.faces[~left])]
    return [Mesh(BALL.positions[used], index.reshape(-1, 3)) for used, index in pieces]


def image(name, width=64, height=64, vtype="float"):
    return apply("input", name=name, vtype=vtype, extent=Extent(width, height, width * height))


# What belongs to tiles


def apart_of(*roots):
    order = topological(roots)
    return find_apart(order, set(roots), Known(order)).tiles


def test_work_before_a_gate_and_its_backward_belong_to_its_tiles():
    x, tiles, other = image("x"), image("tiles", 4, 4, "int"), image("other")
    work = sigmoid(sigmoid(sigmoid(x)))
    gate = apply("inside_tiles", work, tiles, tile=(16, 16), apart=True)
    back = apply("inside_tiles", other + 1.0, tiles, tile=(16, 16), apart=True) * work
    result = gate + other
    found = apart_of(result, back)
    for n in (work, gate, back):
        assert found[n] is tiles
    assert result not in found and other not in found


def test_what_others_read_and_what_is_not_worth_a_pass_stay():
    x, tiles = image("x"), image("tiles", 4, 4, "int")
    read = sigmoid(sigmoid(sigmoid(x)))
    cheap = x + 1.0
    one = apply("inside_tiles", read, tiles, tile=(16, 16), apart=True)
    two = apply("inside_tiles", cheap, tiles, tile=(16, 16), apart=True)
    found = apart_of(one, two, read * 2.0)
    assert one in found and two in found and read not in found and cheap not in found


def test_without_a_request_nothing_is_apart():
    x, tiles = image("x"), image("tiles", 4, 4, "int")
    assert apart_of(apply("inside_tiles", sigmoid(sigmoid(x)), tiles, tile=(16, 16))) == {}


def test_what_is_known_where_a_value_is_zero():
    by, x = image("by", vtype="int"), image("x")
    y = select(by, sigmoid(x), 0.0)
    z = maximum(y * x, 0.25)
    known = Known(topological([z + x])).where_zero(by, by.extent)
    assert known[y] == 0 and known[z] == 0.25 and x not in known and z + x not in known


# Passes


def unlike():
    """Two balls that cut each other, of materials that are not alike, with contours."""
    s = Scene(orbit(2, (20.0, -15.0), 3.0, 42.0, (40, 33)), background=(0.1, 0.2, 0.3))
    first, second = (s.parameter(name, BALL.positions * size + where) for name, size, where in
                     (("first", 0.7, (0.2, 0.0, 0.3)), ("second", 0.8, (-0.2, 0.1, -0.2))))
    paint, gloss = s.parameter("paint", np.full(BALL.positions.shape, 0.6), low=0.0, high=1.0), s.parameter("gloss", 20.0)
    s.add(BALL, first, BlinnPhong(Vertex(paint), 0.5, gloss, [Light("directional", 2.0, (0.0, -1.0, -1.0)), Light("ambient", 0.2)]))
    s.add(BALL, second, lambda x: F.maximum(F.sin(x.position * 9.0), 0.1) * F.maximum(F.dot(x.normal, x.to_eye), 0.2))
    return s, ["first", "second", "paint", "gloss"]


@pytest.mark.parametrize("renderer, profile", [(Outline(contours=True), "lavapipe"), (HardSoftRas(layers=2), "lavapipe"),
                                               pytest.param(Outline(contours=True), "vulkan_min", marks=pytest.mark.full)],
                         ids=["contours", "layers", "contours in more passes"])
def test_what_their_passes_leave_undrawn_changes_no_bit(gpu, renderer, profile):
    s, names = unlike()
    s.vjp("v", names, color=s.frame(renderer).color)
    given, found = np.random.default_rng(3).normal(size=(*SHAPE, 3)), []
    for how in ({}, {"domains": False}):
        with gpu.open(s.program, profile, **how) as session:
            found.append([session.forward("v")["color"].tobytes(), *(x.tobytes() for x in session.backward("v", color=given).values())])
    gpu.silent()
    assert found[0] == found[1]


def test_each_part_is_shaded_in_its_own_tiles():
    s, names = unlike()
    f = s.frame()
    s.phase("fit", 2, {name: Adam(0.01) for name in names}, color=l2(f.color, s.input("photo", np.full((*SHAPE, 3), 0.4))))
    made = build(s.program, Profile.load("lavapipe"))
    of_tiles = [x.domain.by for stage in made.stages["fit"] for x in stage.substages if x.domain.kind == TILES]
    assert len({n.serial for n in of_tiles}) >= 3  # of one part, of the other, of both


# Parts that are made alike


def two(materials, meshes=None, **how):
    s = Scene(orbit(2, (20.0, -15.0), 3.0, 42.0, (40, 33)))
    for mesh, material in zip(meshes or halves(), materials):
        s.add(mesh, material=material(s, mesh) if material.__code__.co_argcount == 2 else material, **how)
    return s


def test_a_mesh_in_two_pieces_that_are_alike_is_the_mesh(gpu):
    """Colours, normals, and gradients, but at the outline, where the edges of the cut are edges like others."""
    seen, sessions = [], []
    for parts in ([BALL], halves()):
        s = Scene(orbit(2, (20.0, -15.0), 3.0, 42.0, (40, 33)))
        for k, mesh in enumerate(parts):
            paint = s.parameter(f"paint{k}", 0.5 + 0.4 * np.sin(5 * mesh.positions))
            s.add(mesh, material=Unlit(Vertex(paint)), normals="flat")
        f = s.frame()
        s.vjp("v", list(s.parameters), color=f.color, normal=f.normal, alpha=f.alpha)
        sessions.append(gpu.open(s.program))
        seen.append(sessions[-1].forward("v"))
    sure = (seen[0]["alpha"] == seen[1]["alpha"]) & (seen[0]["alpha"] % 1.0 == 0.0)
    assert sure.mean() > 0.7
    given, pulled = np.random.default_rng(0).normal(size=(*SHAPE, 3)) * sure[..., None], []
    for session in sessions:
        with session:
            pulled.append(sum(x.sum(0) for x in session.backward("v", color=given).values()))
    gpu.silent()
    for name in ("color", "normal"):
        np.testing.assert_allclose(seen[1][name][sure], seen[0][name][sure], atol=2e-6)
    np.testing.assert_allclose(pulled[1], pulled[0], rtol=1e-4, atol=1e-4)


def test_parts_that_are_alike_have_the_gradients_of_the_reference(gpu):
    s = two([lambda s, m: Unlit(Vertex(s.parameter(f"paint{len(s.parts)}", 0.5 + 0.3 * np.cos(4 * m.positions))))] * 2)
    f = s.frame()
    s.vjp("v", list(s.parameters), color=f.color)
    given = np.random.default_rng(1).normal(size=(*SHAPE, 3))
    with ReferenceSession(s.program) as exact, gpu.open(s.program, "vulkan_min") as session:
        session.forward("v"), exact.forward("v")
        one, other = exact.backward("v", color=given), session.backward("v", color=given)
        for name in s.parameters:
            np.testing.assert_allclose(other[name], one[name], atol=1e-4 * np.abs(one[name]).max())
    gpu.silent()


def test_what_is_not_alike_is_not_put_together():
    a, b = (Light("ambient", power) for power in (0.2, 0.3))
    cases = {
        "numbers": [lambda s, m: Unlit(0.3), lambda s, m: Unlit(0.4)],
        "kinds": [lambda s, m: Unlit(0.3), lambda s, m: BlinnPhong(0.3, 0.3, 9.0, [a])],
        "lights": [lambda s, m: BlinnPhong(0.3, 0.3, 9.0, [a]), lambda s, m: BlinnPhong(0.3, 0.3, 9.0, [b])],
        "parameters": [lambda s, m: Unlit(s.parameter("a", 0.3)), lambda s, m: Unlit(s.parameter("b", 0.3))],
        "types": [lambda s, m: Unlit(Vertex(s.parameter("a", m.positions[:, 0]))),
                  lambda s, m: Unlit(Vertex(s.parameter("b", m.positions)))],
        "functions": [lambda s, m: (lambda x: x.normal), lambda s, m: (lambda x: x.normal)],
    }
    for name, materials in cases.items():
        assert len(runs(two(materials).parts)) == 2, name
    assert len(runs(two([lambda s, m: Unlit(0.3)] * 2).parts)) == 1
    assert len(runs(two([lambda s, m: Unlit(0.3)] * 2, [BALL, halves()[0]]).parts)) == 2  # one has texture coordinates


def test_a_table_of_another_mesh_is_named_with_parts_that_are_alike():
    wrong = BALL.positions
    s = two([lambda s, m: Unlit(Vertex(s.parameter("a", wrong))), lambda s, m: Unlit(Vertex(s.parameter("b", m.positions)))])
    with pytest.raises(InputError, match="part part0: .*a vertex attribute is .*; a table of its [0-9]+ vertices is needed"):
        s.output("look", color=s.frame().color)
