"""Maps of normals: tangents against a surface that is known by formula, mirrored and degenerate texture coordinates, gradients."""
from dataclasses import replace

import numpy as np
import pytest
from shading import dots, unit

from dressi_edge import runtime
from dressi_edge.cache.errors import InputError
from dressi_edge.compiler.graph.functions import compose
from dressi_edge.compiler.graph.reference_session import ReferenceSession
from dressi_edge.compiler.scene import (
    PBR,
    Adam,
    Lambert,
    Light,
    Mesh,
    NormalMap,
    Scene,
    Texture,
    icosphere,
    l2,
    load_scene,
    look_at,
    orbit,
    sphere,
)
from dressi_edge.compiler.scene.results import save_result

pytest_plugins = ["gpu"]
LIGHTS = [Light("directional", 2.0, (-1.0, -1.0, -2.0)), Light("directional", 1.5, (1.0, -0.3, -1.0))]


def tilted(shape, rng, much=0.5):
    """A picture of normals, and the normals."""
    n = unit(np.concatenate([rng.uniform(-much, much, (*shape, 2)), np.ones((*shape, 1))], -1))
    return n * 0.5 + 0.5, n


def square(turn=0.0, mirrored=False):
    """Two triangles before the camera, the picture on them upright, turned or mirrored."""
    corners = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], float)
    uv = corners[:, :2] @ np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]) * [0.35, -0.35] + 0.5
    if mirrored:
        uv[:, 0] = 1 - uv[:, 0]
    faces = np.array([(0, 1, 2), (0, 2, 3)])
    return Mesh(corners, faces, uv, faces)


@pytest.mark.parametrize("turn, mirrored", [(0.0, False), (0.7, False), (0.0, True), (2.0, True)])
def test_a_tangent_goes_with_u_and_a_bitangent_against_v(gpu, turn, mirrored):
    """On a square in the plane z = 0 a map that says (x, y, z) everywhere is the normal x T + y B + z N, with T along growing u and B along
    falling v, mirrored or not."""
    mesh = square(turn, mirrored)
    s = Scene([look_at((0, 0, 3), (0, 0, 0), (0, 1, 0), 45.0, 33, 25)])
    wanted = unit([0.3, 0.5, 0.8])
    part = s.add(mesh, material=NormalMap(tuple(wanted * 0.5 + 0.5)))
    f = s.frame()
    s.output("look", color=f.color, tangent=f.of(lambda x: x.tangent))
    with runtime.load(gpu.compile(s.program), gpu.device) as session:
        normal, tangent = session.get("look.color")[0, 12, 16], session.get("look.tangent")[0, 12, 16]
    gpu.silent()
    across = mesh.positions[[1, 2]] - mesh.positions[0]
    slopes = np.linalg.solve(across[:, :2], mesh.uvs[[1, 2]] - mesh.uvs[0])  # d(u, v) / d(x, y), columns u and v
    t, b = unit(np.append(np.linalg.inv(slopes)[0], 0)), unit(np.append(-np.linalg.inv(slopes)[1], 0))
    np.testing.assert_allclose(tangent, [*t, -1 if mirrored else 1], atol=1e-5)
    np.testing.assert_allclose(normal, wanted @ np.stack([t, b, [0, 0, 1]]), atol=1e-5)
    assert part.name


def test_a_map_of_a_flat_blue_is_no_map(gpu):
    ball, colors = sphere(162, 0.8), []
    for kind in ("none", "numbers", "texture"):
        s = Scene(orbit(2, [20, -15], 2.6, 40, (40, 32)))
        blue = Texture(s.parameter("map", np.full((8, 12, 3), (0.5, 0.5, 1.0)))) if kind == "texture" else (0.5, 0.5, 1.0)
        s.add(ball, material=PBR(0.6, 0.4, 0.5, normal=None if kind == "none" else NormalMap(blue), lights=LIGHTS))
        s.output("look", color=s.frame().color)
        with runtime.load(gpu.compile(s.program), gpu.device) as session:
            colors.append(session.get("look.color"))
    for other in colors[1:]:
        np.testing.assert_allclose(other, colors[0], atol=1e-4)
    gpu.silent()


def bent(mesh, start, material=PBR, moving=True, **how):
    s = Scene(orbit(2, [20, -15], 2.6, 40, (24, 20)))
    x = s.parameter("vertices", mesh.positions) if moving else None
    picture = s.parameter("map", start, 0.0, 1.0, kind="image")
    s.add(mesh, x, material(color=(0.7, 0.6, 0.5), lights=LIGHTS, normal=NormalMap(Texture(picture), s.parameter("scale", 0.8)), **how))
    f = s.frame()
    s.vjp("back", list(s.parameters), color=f.color)
    return s


@pytest.mark.parametrize("material, how", [(PBR, {"roughness": 0.4, "metallic": 0.3}), (Lambert, {})], ids=["pbr", "lambert"])
def test_gradients_are_central_differences_and_the_devices(gpu, material, how):
    rng = np.random.default_rng(1)
    s = bent(sphere(42, 0.8), tilted((6, 9), rng)[0], material, **how)
    with ReferenceSession(s.program) as exact, runtime.load(gpu.compile(s.program), gpu.device) as session:
        g = rng.normal(size=exact.shape("back.color.grad"))
        exact.forward("back")
        one = exact.backward("back", color=g)
        session.forward("back")
        two = session.backward("back", color=g)
        for name in ("map", "scale"):
            start, direction, after = exact.get(name), rng.normal(size=exact.shape(name)), []
            for sign in (1, -1):
                exact.set(name, np.clip(start + sign * 1e-6 * direction, 0, 1))
                after.append((exact.forward("back")["color"] * g).sum())
            exact.set(name, start)
            assert (after[0] - after[1]) / 2e-6 == pytest.approx((one[name] * direction).sum(), rel=1e-4), name
        for name, x in one.items():
            assert np.linalg.norm(two[name] - x) <= 3e-3 * np.linalg.norm(x), name
    gpu.silent()


def test_degenerate_coordinates_and_zero_texels_leave_the_normal(gpu):
    """All uvs on a line, and a map that is zero: the surface's own normal, and gradients that are finite."""
    ball = sphere(162, 0.8)
    line = replace(ball, uvs=np.column_stack([ball.uvs[:, 0], np.full(len(ball.uvs), 0.5)]))
    for mesh, start in ((line, tilted((4, 6), np.random.default_rng(2))[0]), (ball, np.full((4, 6, 3), 0.5))):
        s, plain = bent(mesh, start, roughness=0.4), Scene(orbit(2, [20, -15], 2.6, 40, (24, 20)))
        plain.add(mesh, plain.parameter("vertices", mesh.positions), PBR((0.7, 0.6, 0.5), 0.4, lights=LIGHTS))
        plain.output("look", color=plain.frame().color)
        with runtime.load(gpu.compile(s.program), gpu.device) as session, runtime.load(gpu.compile(plain.program), gpu.device) as other:
            picture = session.forward("back")["color"]
            assert all(np.isfinite(x).all() for x in session.backward("back", color=np.ones_like(picture)).values())
            np.testing.assert_allclose(picture, other.get("look.color"), atol=2e-4 if mesh is line else 1e-5)
    gpu.silent()


def test_a_map_of_normals_is_found_again(gpu):
    rng = np.random.default_rng(3)
    ball, (truth, normals) = sphere(162, 0.8), tilted((8, 12), rng, 0.4)
    s = Scene(orbit(4, [20, -20], 2.6, 40, (56, 56)))
    picture = s.parameter("map", truth, 0.0, 1.0, kind="image")
    s.add(ball, material=PBR(0.7, 0.5, 0.0, normal=NormalMap(Texture(picture)), lights=[*LIGHTS, Light("directional", 1.5, (0.2, 1, 0.4))]))
    f = s.frame()
    photo = s.input("photo", np.zeros((4, 56, 56, 3)))
    s.phase("fit", 120, {"map": Adam(0.02)}, color=l2(f.color, photo))
    s.output("look", color=f.color)
    with runtime.load(gpu.compile(s.program), gpu.device) as session:
        session.set("photo", session.get("look.color"))
        session.set("map", np.full((8, 12, 3), (0.5, 0.5, 1.0)))
        first = session.loss()
        session.step(120)
        found = session.get("map") * 2 - 1
        assert session.loss() < first / 30
    angle = np.degrees(np.arccos(np.clip(dots(unit(found), normals), -1, 1)))
    start = np.degrees(np.arccos(normals[..., 2]))
    assert np.median(angle) < 0.4 * np.median(start)
    gpu.silent()


def test_a_mesh_without_coordinates_has_no_tangents():
    s = Scene(orbit(1, [20], 2.6, 40, (16, 12)))
    s.add(replace(icosphere(1), uvs=None, uv_faces=None), material=PBR(0.5, normal=NormalMap((0.5, 0.5, 1.0)), lights=LIGHTS), name="ball")
    with pytest.raises(InputError, match="ball.*no texture coordinates, and its material reads tangents"):
        s.output("look", color=compose(s.frame().color, 1.0))


def test_a_map_goes_into_a_file_and_comes_back(gpu, tmp_path):
    """Written by results, read by load_scene: the same pictures."""
    rng, cams = np.random.default_rng(4), orbit(2, [20, -15], 2.6, 40, (40, 32))
    s = Scene(cams)
    picture = Texture(s.parameter("map", tilted((8, 12), rng)[0], 0.0, 1.0, kind="image"))
    s.add(sphere(162, 0.8), material=PBR(0.7, 0.5, 0.2, normal=NormalMap(picture, 0.7), lights=LIGHTS), name="ball", normals="smooth")
    s.output("look", color=s.frame().color)
    s.compile("lavapipe", tmp_path / "x.dressi")
    with runtime.load(tmp_path / "x.dressi", gpu.device) as session:
        first = session.get("look.color")
        save_result(session, tmp_path / "x.glb")
    again = load_scene(tmp_path / "x.glb", cams, lights=LIGHTS, mips=False, encode=None)
    again.output("look", color=again.frame().color)
    with runtime.load(gpu.compile(again.program), gpu.device) as session:
        second = session.get("look.color")
    gpu.silent()
    error = np.abs(second - first)
    assert np.median(error) < 5e-3 and np.quantile(error, 0.99) < 0.08 and first.max() > 0.3
