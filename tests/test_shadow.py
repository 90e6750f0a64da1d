"""Shadow maps: against rays through the mesh, without self-shadowing, with exact gradients of everything else."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import SHARED
from jobs import write_job

from dressi_edge import runtime
from dressi_edge.cache.errors import InputError
from dressi_edge.compiler.graph.reference_session import ReferenceSession
from dressi_edge.compiler.scene import (
    PBR,
    Adam,
    BlinnPhong,
    F,
    HardSoftRas,
    Lambert,
    Light,
    Mesh,
    Scene,
    Shadow,
    icosphere,
    l2,
    load_mesh,
    load_views,
    orbit,
)
from dressi_edge.compiler.scene.job import parse_job

pytest_plugins = ["gpu"]

GROUND = Mesh([[-2.0, -0.6, -2], [2, -0.6, -2], [2, -0.6, 2], [-2, -0.6, 2]], [[0, 2, 1], [0, 3, 2]])
BALL = icosphere(2, 0.5)
LIGHTS = {"directional": Light("directional", 3.0, (-0.5, -1.0, -0.4)),
          "spot": Light("spot", 12.0, (1.2, 2.0, 1.0), (-0.5, -1.0, -0.4), (0.5, 0.7)),
          "point": Light("point", 9.0, (0.9, 1.2, 0.9))}


def blocked(points, towards, mesh):
    """(n,) whether the ray from each point towards the light, up to length 1 of `towards`, meets a face (Moeller and Trumbore 1997)."""
    a, b, c = (mesh.positions[mesh.faces[:, k]] for k in range(3))
    out = np.zeros(len(points), bool)
    for k, (p, d) in enumerate(zip(points, towards)):
        h = np.cross(d, c - a)
        det = ((b - a) * h).sum(-1)
        s = p - a
        u = (s * h).sum(-1) / det
        q = np.cross(s, b - a)
        v, t = (d * q).sum(-1) / det, ((c - a) * q).sum(-1) / det
        out[k] = ((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 1e-6) & (t < 1)).any()
    return out


def share_of(scene, light):
    """A material that shows the share of the light in red, the cosine towards it in green."""
    def material(s):
        towards = light.arriving(s.position)[1]
        return F.compose(light.share(s.position), F.maximum(F.dot(s.geometric_normal, towards), 0.0), 0.0)
    return material


def seen_shares(light, shadow, session_of, size=(80, 60)):
    scene = Scene(orbit(1, [30], 4.5, 40, size))
    light = scene.shadow(light, shadow)
    for mesh in (BALL, GROUND):
        scene.add(mesh, material=share_of(scene, light))
    seen = scene.frame(HardSoftRas(1.0, delta=0.0))
    scene.output("o", color=seen.color, position=seen.position, part=seen.part)
    with session_of(scene) as session:
        return tuple(np.asarray(session.get(f"o.{key}"))[0] for key in ("color", "position", "part"))


@pytest.mark.parametrize("kind", LIGHTS)
def test_shadows_are_where_rays_say(gpu, tmp_path, kind):
    """All pixels but those within two texels of the map of a shadow's edge; and nothing that faces the light shadows itself."""
    light = LIGHTS[kind]

    def on_device(scene):
        scene.compile("vulkan_min", tmp_path / "a.dressi")
        return runtime.load(tmp_path / "a.dressi", gpu.device)

    color, position, part = seen_shares(light, Shadow(512, 2), on_device)
    hit = part >= 0
    points, share, cosine = position[hit].astype(float), color[hit][:, 0], color[hit][:, 1]
    towards = np.broadcast_to(-10.0 * np.array(light.vector), points.shape) if kind == "directional" else np.array(light.vector) - points
    unit = towards / np.linalg.norm(towards, axis=1, keepdims=True)
    lift = points + 0.02 * unit
    dark = blocked(lift, towards, BALL)
    step, sure = 0.03, np.ones(len(points), bool)  # more than two texels of these maps where the ground is
    side = np.cross(unit, [0.3, 0.5, 0.8])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    for turn in (side, -side, np.cross(unit, side), -np.cross(unit, side)):
        sure &= blocked(lift + step * turn, towards, BALL) == dark
    sure &= cosine > 0.15
    assert dark[sure].sum() > 40 and (~dark)[sure].sum() > 800
    np.testing.assert_array_equal(share[sure & dark], 0.0)
    np.testing.assert_allclose(share[sure & ~dark], 1.0, atol=1e-6)
    assert ((share > 0) & (share < 1)).any(), "an edge is soft"
    gpu.silent()


@pytest.mark.parametrize("kind", LIGHTS)
def test_the_device_draws_what_the_reference_does(gpu, tmp_path, kind):
    def on_device(scene):
        scene.compile("lavapipe", tmp_path / "a.dressi")
        return runtime.load(tmp_path / "a.dressi", gpu.device)

    shadow = Shadow(128, 3)
    device, reference = (seen_shares(LIGHTS[kind], shadow, session_of, (40, 30))[0][..., 0]
                         for session_of in (on_device, lambda scene: ReferenceSession(scene.program)))
    off = abs(device - reference)
    assert (off > 1e-3).mean() < 0.01 and off.max() < 0.5  # texels that lie on an edge of a face as the light sees it


def test_everything_but_visibility_has_an_exact_gradient():
    """The sun's power, a colour and roughness through the shadowed picture: central differences."""
    scene = Scene(orbit(1, [30], 4.5, 40, (24, 18)))
    power = scene.parameter("power", [2.0, 2.5, 3.0])
    sun = scene.shadow(replace(LIGHTS["directional"], power=power), Shadow(64))
    tint, rough = scene.parameter("tint", [0.5, 0.4, 0.3]), scene.parameter("rough", 0.4)
    scene.add(BALL, material=PBR(tint, rough, lights=[sun, Light("ambient", 0.1)]))
    scene.add(GROUND, material=BlinnPhong((0.6, 0.6, 0.6), 0.3, 10.0, [sun]))
    scene.vjp("render", ["power", "tint", "rough"], color=scene.frame().color)
    with ReferenceSession(scene.program) as session:
        weights = np.random.default_rng(0).normal(size=session.shape("render.color.grad"))
        found = session.backward("render", color=weights)
        for name in ("power", "tint", "rough"):
            start = session.get(name)
            for k in np.ndindex(np.shape(start)):
                ends = []
                for h in (1e-5, -1e-5):
                    moved = np.array(start, float)
                    moved[k] += h
                    session.set(name, moved)
                    ends.append((session.forward("render")["color"] * weights).sum())
                session.set(name, start)
                assert (ends[0] - ends[1]) / 2e-5 == pytest.approx(float(np.asarray(found[name])[k]), rel=1e-4, abs=1e-7)


def test_a_map_is_drawn_once_and_again_when_something_moves(gpu, tmp_path):
    scene = Scene(orbit(1, [30], 4.5, 40, (60, 45)))
    sun = scene.shadow(LIGHTS["directional"], Shadow(128))
    at, tint = scene.parameter("at", np.zeros(3)), scene.parameter("tint", [0.5, 0.5, 0.5])
    ground = scene.add(GROUND, material=Lambert(tint, [sun]))
    scene.add(BALL, F.constant_table(BALL.positions) + at, Lambert((0.6, 0.6, 0.6), [sun]))
    seen = scene.frame(HardSoftRas(1.0, delta=0.0))
    photo = scene.input("photo", np.zeros((1, 45, 60, 3)))
    scene.phase("fit", 5, {"tint": Adam(0.01)}, color=l2(seen.color, photo))
    scene.output("o", color=seen.color, part=seen.part)
    assert ground.name == "part0"
    scene.compile("lavapipe", tmp_path / "a.dressi")
    with runtime.load(tmp_path / "a.dressi", gpu.device) as session:
        session.step(5)
        runs = session.report()["runs"]
        assert max(n for name, n in runs.items() if "prepare" in name and name.startswith("fit")) == 1 and runs["fit"] == 5
        before, part = session.get("o.color"), session.get("o.part")
        session.set("at", [0.6, 0.0, 0.3])
        after, again = session.get("o.color"), session.get("o.part")
    ground = (part == 0) & (again == 0)
    changed = abs(after - before).max(-1)[ground]
    assert 20 < (changed > 0.1).sum() < 0.4 * len(changed)
    gpu.silent()


def test_one_light_s_shadow_leaves_the_others_alone():
    """A pixel in the shadow of one light is what the other lights make of it."""
    def draw(lights):
        scene = Scene(orbit(1, [30], 4.5, 40, (40, 30)))
        lights = [scene.shadow(x, Shadow(128)) if x.kind == "directional" and shadowed else x for x, shadowed in lights]
        scene.add(BALL, material=Lambert((0.7, 0.7, 0.7), lights))
        scene.add(GROUND, material=Lambert((0.7, 0.7, 0.7), lights))
        seen = scene.frame(HardSoftRas(1.0, delta=0.0))
        scene.output("o", color=seen.color)
        with ReferenceSession(scene.program) as session:
            return session.get("o.color")[0]

    lamp, sun = LIGHTS["point"], LIGHTS["directional"]
    both, lit, alone = draw([(lamp, False), (sun, True)]), draw([(lamp, False), (sun, False)]), draw([(lamp, False)])
    dark = abs(both - alone).max(-1) < 1e-12
    assert (both <= lit + 1e-12).all() and (dark & (lit - alone > 0.05).all(-1)).sum() > 10


def test_what_cannot_be_is_named():
    scene = Scene(orbit(1, [30], 4.5, 40, (20, 15)))
    for numbers, message in (({"size": 8}, "size is 8; a whole number from 16 to 4096"), ({"size": 99.5}, "size is 99.5"),
                             ({"filter": 6}, "filter is 6; a whole number from 1 to 5"), ({"bias": -1.0}, "bias is -1.0; a number from 0"),
                             ({"limit": "x"}, "limit is 'x'")):
        with pytest.raises(InputError, match=message):
            Shadow(**numbers)
    with pytest.raises(InputError, match="of an ambient light, which comes from everywhere, none"):
        scene.shadow(Light("ambient", 1.0))
    with pytest.raises(InputError, match="ball is .*a positive radius"):
        scene.shadow(LIGHTS["directional"], ball=((0, 0, 0), -1.0))
    with pytest.raises(InputError, match="shadow is of no scene yet; give materials what scene.shadow"):
        scene.add(BALL, material=Lambert((0.5,) * 3, [replace(LIGHTS["point"], shadow=Shadow())]))
        scene.output("o", color=scene.frame().color)


def job(**light):
    return {"mesh": {"sphere": {"vertices": 162, "radius": 0.5}}, "views": {"transforms": "photos"}, "render": {"shading": "lambert"},
            "light": [{"kind": "directional", "vector": [-0.4, -0.7, -0.6], "power": 2.4, **light}],
            "phase": [{"name": "p", "steps": 2, "optimize": {"vertices": {"rate": 0.01}}, "loss": [{"kind": "color"}]}]}


def test_a_job_says_that_a_light_casts_shadows(tmp_path):
    write_job(tmp_path)
    problem = parse_job(job(shadow={"size": 128, "filter": 3}), tmp_path / "job.toml")
    light, = problem.part.material.lights
    assert callable(light.shadow)
    plain = parse_job(job(shadow=False), tmp_path / "job.toml")
    assert plain.part.material.lights[0].shadow is None
    for wrong, message in ((7, "shadow is 7; a table is needed"), ({"size": 5}, "light.*size is 5"),
                           ({"soft": 1}, "shadow.soft is an unknown key")):
        with pytest.raises(InputError, match=message):
            parse_job(job(shadow=wrong), tmp_path / "job.toml")


def test_photographs_with_cast_shadows_are_nearer_with_a_map(gpu, tmp_path):
    """The true bunny in four of the views by another renderer: in the pixels that a map shadows the error is less than half."""
    if not SHARED.is_dir():
        pytest.skip("no folder shared/ beside the checkout: its photographs are not in the repository; rays are the tests above")
    folder = SHARED / "datasets" / "bunny_lambert"
    views, mesh = load_views(folder), load_mesh(folder / "mesh.ply")
    chosen, found = [2, 8, 14, 18], {}
    for name in ("none", "map"):
        scene = Scene([views.cameras[k] for k in chosen])
        sun = Light("directional", 2.4, (-0.4, -0.7, -0.6))
        lights = [scene.shadow(sun) if name == "map" else sun, Light("ambient", 0.25)]
        scene.add(Mesh(mesh.positions, mesh.faces), material=Lambert((0.75, 0.72, 0.68), lights))
        scene.output("o", color=scene.frame(HardSoftRas(1.0, delta=0.0)).color)
        scene.compile("lavapipe", tmp_path / "a.dressi")
        with runtime.load(tmp_path / "a.dressi", gpu.device) as session:
            found[name] = session.get("o.color").astype(float)
    wanted = np.asarray(views.linear().images, float)[chosen]
    shadowed = (abs(found["none"] - found["map"]).max(-1) > 0.05) & (wanted[..., 3] > 0.99)
    error = {name: np.sqrt(((x - wanted[..., :3])[shadowed] ** 2).mean()) for name, x in found.items()}
    assert shadowed.sum() > 1000 and error["map"] < 0.5 * error["none"], error
