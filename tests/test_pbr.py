"""The metallic-roughness material: against the same reflectance written in NumPy, its integral by Monte Carlo, central differences, and on
the device; where fp32 and zeros are dangerous; tone curves; what jobs say of it."""
import math

import numpy as np
import pytest
from shading import Given, brdf, dots, random_surfaces, reflected, unit

from dressi_edge import runtime
from dressi_edge.cache.errors import GraphError, InputError
from dressi_edge.compiler import Program
from dressi_edge.compiler.check_op import image_layout, layout_of
from dressi_edge.compiler.graph.autodiff import gradients
from dressi_edge.compiler.graph.functions import apply, compose, constant, dot, total
from dressi_edge.compiler.graph.reference import evaluate
from dressi_edge.compiler.graph.reference_session import ReferenceSession
from dressi_edge.compiler.render.brdf import diffuse_loss, reflectance, specular_integrals
from dressi_edge.compiler.scene import (
    PBR,
    Adam,
    BlinnPhong,
    Channel,
    Environment,
    Lambert,
    Light,
    Mesh,
    NormalMap,
    Product,
    Scene,
    Schedule,
    Texture,
    Tone,
    Vertex,
    icosphere,
    l2,
    look_at,
    orbit,
    sphere,
)

pytest_plugins = ["gpu"]
SUN, LAMP = Light("directional", (2.0, 1.5, 1.0), (-1.0, -2.0, -1.5)), Light("point", (6.0, 7.0, 8.0), (1.0, 2.0, 2.0))
SPOT = Light("spot", 9.0, (0.0, 0.0, 3.0), (0.1, 0.0, -1.0), (0.1, 0.5))


def grid(rng, shape=(9, 13)):
    """Surfaces and materials of all kinds."""
    return random_surfaces(rng, shape) | {"color": rng.uniform(0.1, 0.9, (*shape, 3)), "metallic": rng.uniform(0, 1, (*shape, 1)),
                                          "roughness": rng.uniform(0.1, 1, (*shape, 1))}


def lit(values, lights):
    """The radiance by hand."""
    n, v, out = values["normal"], values["to_eye"], 0.0
    for light in lights:
        at = np.asarray(light.vector)
        if light.kind == "directional":
            towards, power = np.broadcast_to(unit(-at), n.shape), np.asarray(light.power)
        else:
            towards = unit(at - values["position"])
            power = np.asarray(light.power) / dots(at - values["position"], at - values["position"])
        if light.kind == "spot":
            inner, outer = np.cos(light.cone)
            power = power * np.clip((-dots(towards, unit(light.direction)) - outer) / (inner - outer), 0, 1) ** 2
        out = out + brdf(n, v, towards, values["color"], values["metallic"], values["roughness"]) * np.maximum(dots(n, towards), 0) * power
    return out


@pytest.mark.parametrize("lights", [[SUN], [LAMP], [SPOT], [SUN, LAMP, SPOT]], ids=["sun", "lamp", "spot", "all"])
def test_a_surface_reflects_as_the_formula_says(gpu, lights):
    given = Given(**grid(np.random.default_rng(1)))
    x = given.nodes
    y = PBR(x["color"], x["roughness"], x["metallic"], lights=lights)(given.surface)
    given.program.plan("p", {}, {"y": (y, layout_of(y))})
    expected = lit(given.feed, lights)
    with ReferenceSession(given.program) as exact:
        np.testing.assert_allclose(exact.get("y"), expected, rtol=1e-9, atol=1e-12)
    found = gpu.run(given.program, {})["y"]
    np.testing.assert_allclose(found, expected, rtol=2e-4, atol=2e-5)
    assert (expected > 0.01).mean() > 0.1


def test_a_mirror_like_surface_keeps_its_digits(gpu):
    """At roughness 0.03 alpha squared is 8e-7, and the highlight 390,000 high: fp32 still has it to a thousandth."""
    rng, shape = np.random.default_rng(2), (8, 16)
    values = grid(rng, shape) | {"roughness": np.full((*shape, 1), 0.03), "metallic": np.ones((*shape, 1))}
    values["to_eye"] = unit(values["normal"] + 0.3 * rng.normal(size=(*shape, 3)))
    n, v = values["normal"], values["to_eye"]
    values["position"] = np.zeros((*shape, 3))
    towards = unit(2 * dots(n, v) * n - v + 1e-3 * rng.normal(size=(*shape, 3)))
    given = Given(**values, at=towards * 2)
    s, x = given.surface, given.nodes

    class Lamp(Light):  # a lamp for each pixel
        def arriving(self, position):
            d = x["at"] - position
            return compose(1.0, 1.0, 1.0), d / apply("sqrt", dot(d, d)), dot(d, d)

    y = PBR(x["color"], x["roughness"], x["metallic"], lights=[Lamp("point", 1.0, (0, 0, 0))])(s)
    given.program.plan("p", {}, {"y": (y, layout_of(y))})
    expected = brdf(n, v, towards, values["color"], values["metallic"], values["roughness"]) * np.maximum(dots(n, towards), 0) / 4
    found = gpu.run(given.program, {})["y"]
    keep = expected > expected.max() * 1e-3
    assert keep.mean() > 0.3
    np.testing.assert_allclose(found[keep], expected[keep], rtol=4e-3)


def test_ambient_light_is_the_integral_of_the_very_reflectance(gpu):
    """Radiance from everywhere, through the table, against Monte Carlo: to 0.3 % in the middle, to 1 % of white at worst."""
    rng = np.random.default_rng(3)
    values = grid(rng, (6, 8))
    values["to_eye"] = random_surfaces(rng, (6, 8), 0.1)["to_eye"]
    values["normal"] = unit(values["to_eye"] + rng.normal(size=(6, 8, 3)) * 0.6)
    values["normal"] = np.where(dots(values["normal"], values["to_eye"]) < 0.1, values["to_eye"], values["normal"])
    given = Given(**values)
    x = given.nodes
    y = PBR(x["color"], x["roughness"], x["metallic"], occlusion=0.5, emissive=(0.1, 0.2, 0.3),
            lights=[Light("ambient", (1.0, 2.0, 0.5))])(given.surface)
    given.program.plan("p", {}, {"y": (y, layout_of(y))})
    flat = {k: a.reshape(-1, a.shape[2]) for k, a in values.items()}
    truth = reflected(*(flat[k] for k in ("normal", "to_eye", "color", "metallic", "roughness")), lambda d: np.ones((len(d), 1)), rng)
    expected = truth * [0.5, 1.0, 0.25] + [0.1, 0.2, 0.3]
    found = gpu.run(given.program, {})["y"].reshape(-1, 3)
    error = np.abs(found - expected) / expected
    assert np.median(error) < 3e-3 and error.max() < 1e-2
    assert (truth < 1.0).all()


def test_no_surface_reflects_more_than_arrives():
    nv, roughness = (a.ravel() for a in np.meshgrid(np.linspace(0.01, 1, 25), np.linspace(0.03, 1, 25)))
    a, b = specular_integrals(nv, roughness)
    assert (a >= 0).all() and (b >= 0).all() and (a + b <= 1.0005).all()
    np.testing.assert_allclose((a + b)[(roughness < 0.1) & (nv > 0.3)], 1, atol=5e-3)  # a smooth metal loses nothing
    some = slice(None, None, 23)
    np.testing.assert_allclose([a[some], b[some]], specular_integrals(nv[some], roughness[some], (512, 64)), atol=1e-3)
    assert np.abs(diffuse_loss(nv[:25]) - diffuse_loss(nv[:25], (256, 256))).max() < 2e-3
    assert (np.diff(diffuse_loss(np.linspace(0.01, 1, 9))) < 0).all()


def test_the_table_is_the_integrals():
    rng = np.random.default_rng(0)
    nv, roughness = rng.uniform(0.05, 1, (10, 12, 1)), rng.uniform(0.05, 1, (10, 12, 1))
    found = evaluate([reflectance(constant(nv), constant(roughness))])[0]
    exact = np.stack([*specular_integrals(nv.ravel(), roughness.ravel(), (256, 64)), diffuse_loss(nv.ravel(), (128, 128))], 1)
    error = np.abs(found.reshape(-1, 3) - exact)
    assert error.max() < 5e-3 and np.median(error) < 5e-4


def slopes(node, of, feed, direction, h):
    """The central difference of a node's sum along a direction of one input, in float64."""
    out = []
    for sign in (1, -1):
        out.append(float(evaluate([total(node)], feed | {of.attrs["name"]: feed[of.attrs["name"]] + sign * h * direction})[0].ravel()[0]))
    return (out[0] - out[1]) / (2 * h)


CASES = {"all sorts": {}, "roughness 0.03": {"roughness": 0.03}, "metal": {"metallic": 1.0}, "black": {"color": 0.0}, "grazing": {}}


@pytest.mark.parametrize("case", CASES, ids=lambda c: c.replace(" ", "_"))
def test_every_gradient_is_the_central_difference(case):
    """In float64, surface by surface: what one surface shows depends on its own values alone, so all are moved at once, and differences
    are compared entry by entry: relative L2 error at most 1e-4."""
    rng, values = np.random.default_rng(5), grid(np.random.default_rng(4))
    shape = values["roughness"].shape
    for key, x in CASES[case].items():
        values[key] = np.full_like(values[key], x)
    values |= {"power": rng.uniform(1, 3, (*shape[:2], 3)), "at": rng.normal(size=(*shape[:2], 3)) + [0, 0, 3.0],
               "emissive": rng.uniform(0, 1, (*shape[:2], 3)), "occlusion": rng.uniform(0.2, 1, shape)}
    if case == "roughness 0.03":  # the lamp is in the highlight
        n, v = values["normal"], values["to_eye"]
        values["at"] = values["position"] + 2 * unit(2 * dots(n, v) * n - v + 2e-3 * rng.normal(size=n.shape))
    if case == "grazing":  # cosines of the eye of 0.002 to 0.05
        n = values["normal"]
        values["to_eye"] = unit(unit(np.cross(n, rng.normal(size=n.shape))) + rng.uniform(0.002, 0.05, shape) * n)
    given = Given(**values)
    x = given.nodes

    class Own(Light):
        def arriving(self, position):
            d = x["at"] - position
            return x["power"], d / apply("sqrt", dot(d, d)), dot(d, d)

    lights = [Own("point", 1.0, (0, 0, 0)), Light("ambient", 0.3)]
    y = PBR(x["color"], x["roughness"], x["metallic"], x["occlusion"], x["emissive"], lights)(given.surface)
    weights = rng.normal(size=(*shape[:2], 3))
    inner = total(dot(y, constant(weights)))
    wrt = list(x)
    found = dict(zip(wrt, evaluate(gradients(inner, [x[k] for k in wrt]), values)))
    for key in wrt:
        direction = rng.normal(size=values[key].shape) * (1.0 if case != "black" or key != "color" else 0.0)
        h = 1e-6 if case != "roughness 0.03" else 1e-7
        after = [(evaluate([y], values | {key: values[key] + sign * h * direction})[0] * weights).sum(-1) for sign in (1, -1)]
        numeric, exact = (after[0] - after[1]) / (2 * h), (found[key] * direction).sum(-1)
        far = 1e-3 * (np.abs(numeric) + np.abs(exact)) + 1e-6 * np.abs(exact).max()
        kink = np.abs(numeric - exact) > far  # a surface that just turns from the light
        assert kink.mean() < 0.03, key
        assert np.linalg.norm((numeric - exact)[~kink]) <= 1e-4 * max(np.linalg.norm(numeric[~kink]), 1e-3), key


def scene_of(material_of, mesh=None, size=(32, 24), **how):
    """Two views of a ball whose material is made with the scene; gradients of the picture by all parameters."""
    s = Scene(orbit(2, [20, -15], 2.6, 40, size), (0.1, 0.1, 0.1), **how)
    mesh = mesh or sphere(162, 0.8)
    s.add(mesh, material=material_of(s, mesh))
    f = s.frame()
    s.vjp("back", list(s.parameters), color=f.color)
    return s


def everything(s, mesh):
    rng = np.random.default_rng(6)
    maps = Texture(s.parameter("maps", rng.uniform(0.2, 0.9, (8, 12, 3)), 0.0, 1.0, kind="image"))
    tint = Vertex(s.parameter("tint", rng.uniform(0.2, 1, mesh.positions.shape)))
    glow = s.parameter("glow", [0.1, 0.0, 0.05])
    return PBR(Product((Channel(maps, "xyz"), tint)), Channel(maps, "y"), Channel(maps, "z"), Channel(maps, "x"), glow,
               s.lit([SUN, LAMP, SPOT, Light("ambient", 0.2)]), two_sided=True)


def test_the_device_gives_the_gradients_of_the_reference(gpu):
    scene, rng = scene_of(everything), np.random.default_rng(7)
    with ReferenceSession(scene.program) as exact, runtime.load(gpu.compile(scene.program, "vulkan_min"), gpu.device) as s:
        g = rng.normal(size=s.shape("back.color.grad"))
        np.testing.assert_allclose(s.forward("back")["color"], exact.forward("back")["color"], atol=3e-4)
        one, two = exact.backward("back", color=g), s.backward("back", color=g)
        assert one.keys() == set(scene.parameters)
        for name, x in one.items():
            assert np.linalg.norm(two[name] - x) <= 1e-3 * np.linalg.norm(x), name
            assert np.linalg.norm(x) > 0, name
    gpu.silent()


SETTINGS = {"color": 3, "roughness": 1, "metallic": 1, "occlusion": 1, "emissive": 3, "normal": 3}  # channels
SIZES = ((6, 9), (4, 5), (3, 8), (10, 7), (5, 5), (16, 12))  # of their textures


def set_by(kind):
    """A material each of whose settings is a parameter: one value, a value of each vertex, or a texture of a size of its own."""
    def make(s, mesh):
        rng, found = np.random.default_rng(8), {}
        for (key, channels), size in zip(SETTINGS.items(), SIZES):
            shape = {"one": (), "vertices": (len(mesh.positions),), "textures": size}[kind]
            value = rng.uniform(0.3, 0.8, (*shape, channels) if channels > 1 or kind == "textures" else shape)
            node = s.parameter(f"m.{key}", value, kind={"one": None, "vertices": "table", "textures": "image"}[kind])
            found[key] = {"one": lambda x: x, "vertices": Vertex, "textures": Texture}[kind](node)
        found["normal"] = NormalMap(found["normal"])
        return PBR(**found, lights=[SUN, LAMP, SPOT, Light("ambient", 0.2)], environment=Environment(SKY))
    return make


SKY = np.random.default_rng(9).uniform(0.0, 1.0, (16, 16, 3))


@pytest.mark.parametrize("kind", [*(pytest.param(k, marks=pytest.mark.full) for k in ("one", "vertices")), "textures"])
def test_each_setting_may_be_one_value_one_of_each_vertex_or_a_texture(gpu, kind):
    """Under all kinds of light together: gradients are central differences, relative 1e-4, and the device's are the reference's."""
    scene, rng = scene_of(set_by(kind), sphere(42, 0.8), (24, 20)), np.random.default_rng(7)
    assert set(scene.parameters) == {f"m.{key}" for key in SETTINGS}
    with ReferenceSession(scene.program) as exact, runtime.load(gpu.compile(scene.program), gpu.device) as s:
        g = rng.normal(size=s.shape("back.color.grad"))
        np.testing.assert_allclose(s.forward("back")["color"], exact.forward("back")["color"], rtol=1e-4, atol=3e-4)
        one, two = exact.backward("back", color=g), s.backward("back", color=g)
        for name, x in one.items():
            assert np.linalg.norm(two[name] - x) <= 1e-3 * np.linalg.norm(x) and np.linalg.norm(x) > 0, name
            start, direction, after = exact.get(name), rng.normal(size=exact.shape(name)), []
            for sign in (1, -1):
                exact.set(name, start + sign * 1e-6 * direction)
                after.append((exact.forward("back")["color"] * g).sum())
            exact.set(name, start)
            assert (after[0] - after[1]) / 2e-6 == pytest.approx((x * direction).sum(), rel=1e-4), name
    gpu.silent()


def test_light_of_all_kinds_adds_up():
    """What lamps give, what comes from everywhere and what the surroundings give: the picture under all is the sum of three."""
    lamps, ambient, around = {"lights": [SUN, LAMP, SPOT]}, {"lights": [Light("ambient", 0.3)]}, {"environment": Environment(SKY)}

    def picture(**light):
        s = Scene(orbit(2, [20, -15], 2.6, 40, (40, 30)))
        s.add(sphere(162, 0.8), material=PBR((0.7, 0.5, 0.3), 0.4, 0.3, 0.8, **light))
        s.output("o", color=s.frame().color)
        with ReferenceSession(s.program) as session:
            return session.get("o.color")

    parts = [picture(**x) for x in (lamps, ambient, around)]
    assert all(x.max() > 0.05 for x in parts)
    both = picture(lights=[*lamps["lights"], *ambient["lights"]], **around)
    np.testing.assert_allclose(both, sum(parts), atol=1e-12)


def test_what_cannot_be_shaded_stays_finite(gpu):
    """Zero normals, an eye along the surface and below it, a light opposite to the eye, roughness 0: finite, and so are gradients."""
    up, shape = np.array([0.0, 0.0, 1.0]), (1, 6, 3)
    n = np.array([[np.zeros(3), up, up, up, up, up]])
    v = np.array([[up, [1, 0, 0], [0.8, 0, -0.6], up, up, unit([1, 0, 1e-5])]])
    roughness, metallic = (np.array(a, float).reshape(1, 6, 1) for a in ((0, 0, 0.03, 0, 1, 0.03), (0, 1, 0.5, 1, 0, 1)))
    given = Given(normal=n, to_eye=v, position=np.zeros(shape), color=np.full(shape, 0.5), roughness=roughness, metallic=metallic)
    x = given.nodes
    lights = [Light("directional", 3.0, (0, 0, 1)), Light("directional", 3.0, (0, 0, -1)), Light("directional", 3.0, (1, 0, 0)),
              Light("point", 1.0, (0, 0, 0)), Light("spot", 1.0, (0, 0, 0), (0, 0, 1)), Light("ambient", 1.0)]
    y = PBR(x["color"], x["roughness"], x["metallic"], lights=lights, two_sided=True)(given.surface)
    g = gradients(total(dot(y, y)), list(x.values()))
    given.program.plan("p", {}, {f"y{k}": (node, layout_of(node)) for k, node in enumerate([y, *g])})
    for values in (gpu.run(given.program, {}), {"reference": np.concatenate([a.ravel() for a in evaluate([y, *g], given.feed)])}):
        for name, a in values.items():
            assert np.isfinite(a).all(), name


AHEAD = [Light("directional", math.pi, (0.1, 0.0, -1.0))]
LEAVES = {"pbr": lambda **k: PBR((0.6, 0.5, 0.4), 0.4, lights=AHEAD, **k), "lambert": lambda **k: Lambert((0.6, 0.5, 0.4), AHEAD, **k),
          "blinn_phong": lambda **k: BlinnPhong((0.6, 0.5, 0.4), 0.3, 10.0, AHEAD, **k)}


@pytest.mark.parametrize("material", LEAVES.values(), ids=LEAVES)
def test_a_leaf_is_lit_on_the_side_that_one_sees(gpu, material):
    """A square seen from behind: black when it has one side, as bright as from the front when it has two."""
    corners = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], float)
    looks = []
    for faces, options in (([(0, 1, 2), (0, 2, 3)], {}), ([(2, 1, 0), (3, 2, 0)], {}), ([(2, 1, 0), (3, 2, 0)], {"two_sided": True})):
        s = Scene([look_at((0, 0, 3), (0, 0, 0), (0, 1, 0), 45.0, 31, 23)])
        s.add(Mesh(corners, np.array(faces)), material=material(**options))
        s.output("look", color=s.frame().color)
        with runtime.load(gpu.compile(s.program), gpu.device) as session:
            looks.append(session.get("look.color")[0, 11, 15])
    front, behind, turned = looks
    assert (front > 0.1).all() and (behind == 0).all()
    np.testing.assert_allclose(turned, front, rtol=1e-6)


# Tone curves

CURVES = {  # of radiance 0.18, 1 and 4 by hand
    "linear": [0.18, 1.0, 4.0],
    "reinhard": [0.18 * (1 + 0.18 / 16) / 1.18, (1 + 1 / 16) / 2, 1.0],
    "aces": [(0.18 * (2.51 * 0.18 + 0.03)) / (0.18 * (2.43 * 0.18 + 0.59) + 0.14), 2.54 / 3.16, 4 * 10.07 / (4 * 10.31 + 0.14)],
    "filmic": [0.093062 / 0.725129, 0.357430 / 0.725129, 0.665690 / 0.725129],
}


@pytest.mark.parametrize("curve", CURVES)
def test_a_tone_curve_is_what_is_computed_by_hand(gpu, curve):
    shape = (1, 5, 3)
    x = np.array([0.18, 1.0, 4.0, 0.0, -1.0])[None, :, None] * np.ones(3)
    program = Program()
    layout = image_layout(x)
    radiance, exposure = program.input("x", layout, layout.from_image(x)), program.state("exposure", image_layout(np.zeros((1, 1, 1))), 0.0)
    plain, coded = Tone(curve, srgb=False)(radiance), Tone(curve, exposure)(radiance)
    program.plan("p", {}, {"plain": (plain, layout_of(plain)), "coded": (coded, layout_of(coded))})
    found = gpu.run(program, {})
    np.testing.assert_allclose(found["plain"][0, :3, 0], CURVES[curve], rtol=2e-4)
    np.testing.assert_allclose(found["plain"][0, 3:, 0], [0, -1 if curve == "linear" else 0], atol=1e-7)
    y = np.clip(found["plain"], 0, 1)
    np.testing.assert_allclose(found["coded"], np.where(y <= 0.0031308, 12.92 * y, 1.055 * y ** (1 / 2.4) - 0.055), atol=2e-6)
    bright = evaluate([Tone(curve, 1.0, srgb=False)(radiance)], {"x": x})[0]
    np.testing.assert_allclose(bright, evaluate([Tone(curve, srgb=False)(radiance)], {"x": 2 * x})[0], rtol=1e-12)
    rising = evaluate([Tone(curve)(radiance)], {"x": np.linspace(0, 0.9, 5).reshape(1, 5, 1) * np.ones(3)})[0][0, :, 0]
    assert (np.diff(rising) > 0).all()
    loss = total(dot(coded, constant(np.ones(shape))))
    inside = {"x": x.clip(0.05, 0.4), "exposure": np.full((1, 1, 1), 0.3)}
    for node, h in ((radiance, 1e-5), (exposure, 1e-5)):
        name, g = node.attrs["name"], evaluate(gradients(loss, [node]), inside)[0].sum()
        after = [evaluate([loss], inside | {name: inside[name] + sign * h})[0].ravel()[0] for sign in (1, -1)]
        assert g == pytest.approx((after[0] - after[1]) / (2 * h), rel=1e-6) and g > 0


def test_a_picture_is_exposed_and_its_exposure_found(gpu):
    s = Scene(orbit(2, [20, -15], 2.6, 40, (64, 48)))
    s.encode = Tone("aces", s.parameter("exposure", 0.0))
    s.add(icosphere(2, 0.8), material=PBR((0.7, 0.5, 0.3), 0.4, lights=[SUN, Light("ambient", 0.2)]))
    f = s.frame()
    photo = s.input("photo", np.zeros((2, 48, 64, 3)))
    s.phase("fit", 60, {"exposure": Adam(Schedule(0.1, 0.003, 60, "exponential"))}, color=l2(f.color, photo))
    s.output("look", color=f.color)
    with runtime.load(gpu.compile(s.program), gpu.device) as session:
        session.set("exposure", 1.2)
        session.set("photo", session.get("look.color"))
        session.set("exposure", 0.0)
        session.step(60)
        assert float(session.get("exposure")) == pytest.approx(1.2, abs=0.02)
    gpu.silent()


# What is wrong is said before any work

@pytest.mark.parametrize("make, what", [
    (lambda: PBR(0.5, lights=[3.0]), "lights are .*a sequence of Lights"),
    (lambda: Light("spot", 1.0, (0, 0, 1)), "spot light: direction is None; three numbers"),
    (lambda: Light("spot", 1.0, (0, 0, 1), (0, 0, 0)), "spot light: direction is zero"),
    (lambda: Light("point", 1.0, (0, 0, 1), (0, 0, 1)), "point light: direction is .*only a spot has one"),
    (lambda: Light("spot", 1.0, (0, 0, 1), (0, 0, 1), (0.5, 0.2)), "cone is .*0 <= inner < outer"),
    (lambda: Tone("bright"), "tone curve 'bright'; linear reinhard aces filmic are allowed"),
    (lambda: Tone(exposure=float("nan")), "exposure is nan; stops from -60 to 60"),
    (lambda: Tone(exposure=constant(np.ones((2, 2, 1)))), "exposure is .*extent 1x1"),
    (lambda: Tone("reinhard", white=0.0), "white is 0.0; a number above 0"),
    (lambda: scene_of(lambda s, m: PBR("red")), "'red' is no source of a material"),
])
def test_what_is_wrong_is_named(make, what):
    with pytest.raises((InputError, GraphError), match=what):
        make()
