"""Mip maps: levels, trilinear samples and their exact transpose, wraps of each axis, and that fine textures do not alias."""

from dataclasses import replace

import numpy as np
import pytest

from dressi_edge import runtime
from dressi_edge.cache.errors import GraphError, InputError
from dressi_edge.cache.layout import Layout
from dressi_edge.compiler import Program
from dressi_edge.compiler.graph.autodiff import gradients
from dressi_edge.compiler.graph.functions import constant, dot, total
from dressi_edge.compiler.graph.ops.mip_lists import RUN, run_length
from dressi_edge.compiler.graph.ops.mip_pyramid import Pyramid
from dressi_edge.compiler.graph.ops.mips import levels
from dressi_edge.compiler.graph.reference import evaluate
from dressi_edge.compiler.graph.reference_session import ReferenceSession
from dressi_edge.compiler.render.texture import WRAPS, sample_texture
from dressi_edge.compiler.scene import (
    Adam,
    Coordinates,
    F,
    HardSoftRas,
    Mesh,
    Product,
    Scene,
    Texture,
    Unlit,
    Vertex,
    l2,
    look_at,
    orbit,
    sphere,
)

pytest_plugins = ["gpu"]

WIDTH, HEIGHT = 23, 19


def fp32(array):
    return np.asarray(array).astype(np.float32).astype(np.float64)


def picture(vtype, width=WIDTH, height=HEIGHT):
    return Layout("image", vtype, width, height)


def pyramid(texture):
    """Every level of a texture, each texel the mean of what it stands for, by the definition."""
    out = [texture]
    while max(out[-1].shape[:2]) > 1:
        x = out[-1]
        h, w = -(-x.shape[0] // 2), -(-x.shape[1] // 2)
        out.append(np.array([[x[2 * j:2 * j + 2, 2 * i:2 * i + 2].mean((0, 1)) for i in range(w)] for j in range(h)]))
    return out


# Levels


@pytest.mark.parametrize("size", [(4, 1), (8, 8), (64, 16), (128, 256)], ids=str)
def test_levels_are_means_down_to_one_texel(size):
    w, h = size
    texture = np.random.default_rng(0).normal(size=(h, w, 3))
    half, rest = evaluate(levels(constant(texture)))
    expected, p = pyramid(texture), Pyramid(w, h)
    assert p.size(p.last) == (1, 1) and len(expected) == p.last + 1
    np.testing.assert_allclose(half, expected[1], atol=1e-12)
    for level in range(2, p.last + 1):
        np.testing.assert_allclose(p.part(rest, level), expected[level], atol=1e-12)


@pytest.mark.parametrize("size", [(100, 75), (5, 3), (333, 217), (4, 1), (256, 3), (3, 256)], ids=str)
def test_each_texel_of_a_level_is_the_mean_of_the_texels_that_it_stands_for(gpu, size):
    """Of any size, on the device, too: of 100 x 75 texels level 5 has 4 x 3; its last column is the mean of texels 96 to 99."""
    w, h = size
    texture, p = fp32(np.random.default_rng(0).normal(size=(h, w, 3))), Pyramid(w, h)
    program = Program()
    half, rest = levels(program.input("texture", picture("vec3", w, h)))
    program.plan("p", {}, {"half": (half, picture("vec3", *p.size(1))), "rest": (rest, picture("vec3", p.rest.width, p.rest.height))})
    device, exact = gpu.run(program, {"texture": texture}), evaluate([half, rest], {"texture": texture})
    rows = set()
    for level in range(1, p.last + 1):
        by = 1 << level
        expected = [[texture[y:y + by, x:x + by].mean((0, 1)) for x in range(0, w, by)] for y in range(0, h, by)]
        for found, atol in ((exact, 1e-12), ((device["half"], device["rest"]), 1e-5)):
            np.testing.assert_allclose(p.part(found[1], level) if level > 1 else found[0], expected, atol=atol)
        if level > 1:  # levels do not lie on one another
            own = set(range(p.row(level), p.row(level) + p.size(level)[1]))
            assert not own & rows and max(own) < p.rest.height
            rows |= own


# Samples and their transpose


class Sampling:
    def __init__(self, width, height, wrap):
        self.program = p = Program()
        self.texture, self.uv = p.input("texture", picture("vec3", width, height)), p.input("uv", picture("vec2"))
        self.lod, self.g, covered = p.input("lod", picture("float")), p.input("g", picture("vec3")), p.input("covered", picture("int"))
        self.y = sample_texture(self.texture, self.uv, wrap, covered=covered, lod=self.lod)
        self.flat = sample_texture(self.texture, self.uv, wrap, covered=covered)
        self.gradient, = gradients(total(dot(self.y, self.g)), [self.texture])
        outputs = {"y": (self.y, picture("vec3")), "flat": (self.flat, picture("vec3")),
                   "gradient": (self.gradient, picture("vec3", width, height))}
        p.plan("p", {}, outputs, dynamic=frozenset({"texture", "g"}))


def values(width, height, seed=0, lod=(-1.0, 9.0), uv=(-1.0, 2.0)):
    rng = np.random.default_rng(seed)
    return {"texture": fp32(rng.normal(size=(height, width, 3))), "uv": fp32(rng.uniform(*uv, (HEIGHT, WIDTH, 2))),
            "lod": fp32(rng.uniform(*lod, (HEIGHT, WIDTH, 1))), "g": fp32(rng.normal(size=(HEIGHT, WIDTH, 3))),
            "covered": (rng.random((HEIGHT, WIDTH, 1)) < 0.6).astype(np.int64)}


def given(session, program, feed):
    for name, array in feed.items():
        session.set(name, program.values[name].layout.from_image(array))


@pytest.mark.parametrize("wrap", ["repeat", "clamp", "mirror", ("repeat", "clamp"), ("mirror", "repeat")], ids=str)
@pytest.mark.parametrize("size", [(4, 2), (16, 16), (37, 21)], ids=str)
def test_the_gradient_is_the_transpose_of_the_sample(gpu, size, wrap):
    """<sample(t), g> = <t, gradient(g)> for several textures, and the device has the reference's numbers."""
    s, feed = Sampling(*size, wrap), values(*size)
    y, g = evaluate([s.y, s.gradient], feed)
    for seed in range(3):
        other = np.random.default_rng(seed + 9).normal(size=feed["texture"].shape)
        product = (evaluate([s.y], {**feed, "texture": other})[0] * feed["g"]).sum()
        assert (other * g).sum() == pytest.approx(product, rel=1e-10, abs=1e-10)
    device = gpu.run(s.program, feed)
    np.testing.assert_allclose(device["y"], y, atol=4e-5)
    np.testing.assert_allclose(device["gradient"], g, atol=4e-5 * max(1, abs(g).max()))


@pytest.mark.parametrize("wrap", ["repeat", "clamp"])
def test_samples_and_gradients_at_the_bounds_of_levels(gpu, wrap):
    """At whole levels, a hair beside them, at the first and the last and beyond: the transpose, on the device as in float64, and a sample
    that goes from one level to the next without a step."""
    s, feed = Sampling(37, 21, wrap), values(37, 21)
    last = Pyramid(37, 21).last
    whole = np.random.default_rng(5).integers(-1, last + 2, feed["lod"].shape).astype(float)
    beside = [evaluate([s.y], {**feed, "lod": whole + h})[0] for h in (-1e-9, 0.0, 1e-9)]
    np.testing.assert_allclose(beside[0], beside[1], atol=1e-7)
    np.testing.assert_allclose(beside[2], beside[1], atol=1e-7)
    for lod in (whole, fp32(np.nextafter(np.float32(whole), np.float32(-9))), fp32(np.nextafter(np.float32(whole), np.float32(99)))):
        at = {**feed, "lod": lod}
        y, g = evaluate([s.y, s.gradient], at)
        other = np.random.default_rng(9).normal(size=feed["texture"].shape)
        product = (evaluate([s.y], {**at, "texture": other})[0] * feed["g"]).sum()
        assert (other * g).sum() == pytest.approx(product, rel=1e-10, abs=1e-10)
        device = gpu.run(s.program, at)
        np.testing.assert_allclose(device["y"], y, atol=4e-5)
        np.testing.assert_allclose(device["gradient"], g, atol=4e-5 * max(1, abs(g).max()))


@pytest.mark.parametrize("size", [(4, 4), pytest.param((5, 2), marks=pytest.mark.full), (300, 200)], ids=str)
def test_many_pixels_on_few_texels_are_summed_in_runs(gpu, size):
    """72,261 pixels: of 4 x 4 texels each gets thousands, in sums of at least 128 each."""
    wide, high = 333, 217
    rng, p = np.random.default_rng(1), Program()
    feed = {"texture": fp32(rng.normal(size=(size[1], size[0], 3))), "uv": fp32(rng.uniform(-0.5, 1.5, (high, wide, 2))),
            "lod": fp32(rng.uniform(-1, 3, (high, wide, 1))), "g": fp32(rng.normal(size=(high, wide, 3)))}
    texture, uv = p.input("texture", picture("vec3", *size)), p.input("uv", picture("vec2", wide, high))
    lod, g = p.input("lod", picture("float", wide, high)), p.input("g", picture("vec3", wide, high))
    gradient, = gradients(total(dot(sample_texture(texture, uv, "repeat", lod=lod), g)), [texture])
    p.plan("p", {}, {"gradient": (gradient, picture("vec3", *size))})
    exact, = evaluate([gradient], feed)
    found = gpu.run(p, feed)["gradient"]
    assert np.linalg.norm(found - exact) < 1e-4 * np.linalg.norm(exact)
    product = (evaluate([sample_texture(texture, uv, "repeat", lod=lod)], feed)[0] * feed["g"]).sum()
    assert (feed["texture"] * exact).sum() == pytest.approx(product, rel=1e-9)


def test_a_sum_grows_with_the_pixels_of_a_texel():
    assert run_length(100, 1000) == RUN and run_length(1 << 25, 21) == 2048
    assert (1 << 25) / run_length(1 << 25, 21) < 65536  # turns of a loop that llvmpipe does


def test_two_runs_give_the_same_bits(gpu):
    runs = [gpu.run(Sampling(33, 20, "repeat").program, values(33, 20)) for _ in range(2)]
    np.testing.assert_array_equal(runs[0]["gradient"], runs[1]["gradient"])


@pytest.mark.parametrize("wrap", ["repeat", "clamp"])
def test_a_magnified_texture_is_the_bilinear_sample_to_the_bit(gpu, wrap):
    s, feed = Sampling(24, 17, wrap), values(24, 17, lod=(-9.0, 0.0), uv=(0.0, 1.0))
    device = gpu.run(s.program, feed)
    np.testing.assert_array_equal(device["y"], device["flat"])
    with gpu.open(s.program) as session:  # a whole level reads that level alone
        given(session, s.program, {**feed, "lod": np.full_like(feed["lod"], 2.0)})
        expected = pyramid(feed["texture"][:16])[2]
        one = Sampling(24, 16, wrap)
        two = evaluate([one.y], {**feed, "texture": feed["texture"][:16], "lod": np.full_like(feed["lod"], 2.0)})[0]
        plain = evaluate([sample_texture(constant(expected), constant(feed["uv"]), wrap)])[0]
        np.testing.assert_allclose(two, np.where(feed["covered"], plain, 0), atol=1e-12)


def test_far_away_one_sees_the_mean():
    s, feed = Sampling(32, 32, "repeat"), values(32, 32, lod=(5.0, 30.0))
    expected = np.broadcast_to(feed["texture"].mean((0, 1)), (HEIGHT, WIDTH, 3))
    np.testing.assert_allclose(evaluate([s.y], feed)[0], np.where(feed["covered"], expected, 0), atol=1e-12)


@pytest.mark.parametrize("mips", [False, True])
@pytest.mark.parametrize("wrap", [("repeat", "clamp"), ("clamp", "mirror"), ("mirror", "mirror"), ("repeat", "mirror")], ids=str)
def test_each_axis_goes_on_as_it_is_told(gpu, wrap, mips):
    """Against the sample of a texture that is laid out 5 x 5 times as its wraps say."""
    rng, n = np.random.default_rng(4), 8
    texture = fp32(rng.normal(size=(n, n, 3)))
    index = {"repeat": np.arange(-2 * n, 3 * n) % n, "clamp": np.clip(np.arange(-2 * n, 3 * n), 0, n - 1),
             "mirror": np.minimum(np.arange(-2 * n, 3 * n) % (2 * n), 2 * n - 1 - np.arange(-2 * n, 3 * n) % (2 * n))}
    wide = texture[index[wrap[1]]][:, index[wrap[0]]]
    uv = fp32(rng.uniform(-1.6, 2.6, (HEIGHT, WIDTH, 2)))
    p = Program()
    lod = {"lod": constant(np.zeros((HEIGHT, WIDTH, 1)))} if mips else {}
    y = sample_texture(p.input("texture", picture("vec3", n, n)), p.input("uv", picture("vec2")), wrap, **lod)
    p.plan("p", {}, {"y": (y, picture("vec3"))})
    expected = evaluate([sample_texture(constant(wide), constant((uv + 2) / 5), "clamp")])[0]
    feed = {"texture": texture, "uv": uv}
    np.testing.assert_allclose(evaluate([y], feed)[0], expected, atol=1e-10)
    np.testing.assert_allclose(gpu.run(p, feed)["y"], expected, atol=2e-5)


def test_wraps_and_ways_that_there_are_not_are_named():
    t, uv = constant(np.zeros((8, 8, 3))), constant(np.zeros((4, 4, 2)))
    for wrap in ("border", ("repeat",), ("repeat", "mirrored"), 3):
        with pytest.raises(InputError, match="wrap is .*repeat clamp mirror are allowed"):
            sample_texture(t, uv, wrap)
        with pytest.raises(InputError, match="wrap is"):
            Texture(t, wrap)
    step, lod = constant(np.zeros((1, 1, 1), int)), constant(np.zeros((4, 4, 1)))
    with pytest.raises(InputError, match="a texture with mips has none"):
        sample_texture(t, uv, gradient="inverse_uv", step=step, lod=lod)
    with pytest.raises(InputError, match="the mesh's own coordinates or Coordinates"):
        Texture(t, uv=lambda s: s.uv * 2.0, mips=True)
    with pytest.raises(InputError, match="two rows of three finite numbers"):
        Texture(t, transform=((1.0, 0.0), (0.0, 1.0)))
    with pytest.raises(GraphError, match="at least 4 on one side"):
        levels(constant(np.zeros((2, 3, 1))))
    assert set(WRAPS) == {"repeat", "clamp", "mirror"}


# What pixels see of it


def tilted(size=(40, 30)):
    corners = np.array([[0, 2, 1], [0, 3, 2]])
    mesh = Mesh([[-3.0, 0, -6], [3, 0, -6], [3, 0, 1.5], [-3, 0, 1.5]], corners, [[0.0, 0], [1.5, 0], [1, 1], [0, 1.2]], corners)
    return mesh, [look_at([0.3, 0.6, 2.5], [0, 0, -0.5], [0, 1, 0], 50, *size)]


def test_slopes_are_the_derivatives_of_coordinates_by_pixels():
    """Against differences between cameras that look a thousandth of a pixel beside."""
    mesh, (camera,) = tilted()

    def see(dx=0.0, dy=0.0):
        scene = Scene([replace(camera, cx=camera.cx - dx, cy=camera.cy - dy)])
        scene.add(mesh)
        frame = scene.frame(HardSoftRas(r=1.0, delta=0.0))
        across, down = frame.surface().slopes(frame.surface().uv_corners)
        scene.output("o", uv=frame.uv, across=across, down=down, mask=frame.mask)
        with ReferenceSession(scene.program) as session:
            return [np.asarray(session.get(f"o.{key}"))[0] for key in ("uv", "across", "down", "mask")]

    uv, across, down, mask = see()
    h = 1e-3
    right, left, below, above = see(h), see(-h), see(0.0, h), see(0.0, -h)
    inside = (mask * right[3] * left[3] * below[3] * above[3] > 0) & (abs(right[0] - left[0]).max(-1) < 0.1)
    assert inside.sum() > 500
    np.testing.assert_allclose(across[inside], ((right[0] - left[0]) / (2 * h))[inside], rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(down[inside], ((below[0] - above[0]) / (2 * h))[inside], rtol=1e-4, atol=1e-6)


def fine(n):
    y, x = np.mgrid[:n, :n]
    return np.stack([(x // 2 + y // 2) % 2 * 0.8 + 0.1, 0.5 + 0.4 * np.sin(1.3 * x), np.random.default_rng(0).random((n, n))], -1)


@pytest.mark.parametrize("kind", ["plane", "ball"])
def test_a_fine_texture_does_not_alias(gpu, tmp_path, kind):
    """Root mean square difference from 64 samples a pixel: less than half of the bilinear sample's."""
    by = 8

    def draw(size, mips):
        mesh, cameras = tilted(size) if kind == "plane" else (sphere(642, 1.0), orbit(1, [20], 3.0, 40, size))
        scene = Scene(cameras)
        scene.add(mesh, material=Unlit(Texture(constant(fine(512)), mips=mips)))
        seen = scene.frame(HardSoftRas(r=1.0, delta=0.0))
        scene.output("o", color=seen.color, mask=seen.mask)
        scene.compile("lavapipe", tmp_path / "a.dressi")
        with runtime.load(tmp_path / "a.dressi", gpu.device) as session:
            return session.get("o.color")[0].astype(float), session.get("o.mask")[0]

    big, hit = draw((80 * by, 60 * by), False)
    truth, inside = big.reshape(60, by, 80, by, 3).mean((1, 3)), hit.reshape(60, by, 80, by).min((1, 3)) > 0
    bilinear, mips = (np.sqrt(((draw((80, 60), m)[0] - truth)[inside] ** 2).mean()) for m in (False, True))
    assert mips < 0.5 * bilinear, (mips, bilinear)
    gpu.silent()


def scene_with(texture_of, size=(32, 26), cameras=2):  # even: no pixel lies on an edge of the ball, between two faces
    scene, ball = Scene(orbit(cameras, [20, -15][:cameras], 3.0, 40, size)), sphere(162, 1.0)
    texture = scene.parameter("texture", 0.2 + 0.6 * fine(64)[..., :3], 0.0, 1.0, kind="image")
    scene.add(ball, material=Unlit(texture_of(texture)))
    return scene


def test_the_gradient_of_a_texture_through_a_picture_is_exact(gpu, tmp_path):
    """Device against float64, and float64 against central differences along a direction: relative L2 below 1e-4."""
    scene = scene_with(lambda t: Texture(t, mips=True, wrap=("repeat", "clamp"), transform=((2.0, 0.1, 0.2), (0.0, 1.5, 0.0))))
    check_gradient(gpu, scene, tmp_path, 1e-4)


def check_gradient(gpu, scene, tmp_path, tolerance):
    """A scene's gradient by its texture: device against float64, relative L2, and float64 against central differences."""
    scene.vjp("render", ["texture"], color=scene.frame().color)
    scene.compile("vulkan_min", tmp_path / "a.dressi")
    rng = np.random.default_rng(0)
    with ReferenceSession(scene.program) as exact, runtime.load(tmp_path / "a.dressi", gpu.device) as session:
        weights = rng.normal(size=exact.shape("render.color.grad"))
        g, device = (x.backward("render", color=weights)["texture"] for x in (exact, session))
        assert np.linalg.norm(device - g) < tolerance * np.linalg.norm(g)
        start, direction, ends = exact.get("texture"), rng.normal(size=g.shape), []
        for sign in (1, -1):
            exact.set("texture", start + sign * 1e-4 * direction)
            ends.append((exact.forward("render")["color"] * weights).sum())
        assert (ends[0] - ends[1]) / 2e-4 == pytest.approx((g * direction).sum(), rel=1e-8)
    gpu.silent()


def test_a_texture_with_mips_is_fitted_and_the_report_says_how_texels_are_updated(gpu, tmp_path):
    scene = scene_with(lambda t: Texture(t, mips=True))
    seen = scene.frame(HardSoftRas(r=1.0, delta=0.0))
    photo = scene.input("photo", shape=(2, 26, 32, 3))
    scene.phase("fit", 40, {"texture": Adam(0.03)}, color=l2(seen.color, photo, mask=seen.mask))
    scene.compile("lavapipe", tmp_path / "a.dressi", sparse_texels=1)
    with runtime.load(tmp_path / "a.dressi", gpu.device) as session:
        session.set("photo", np.full((2, 26, 32, 3), 0.5))
        session.step(1)
        before = session.loss()
        session.step(39)
        assert session.loss() < 0.01 * before
        assert "every texel is updated, with moments kept once for texels that are always moved alike" in str(session.report())
    scene.compile("lavapipe", tmp_path / "a.dressi")
    with runtime.load(tmp_path / "a.dressi", gpu.device) as session:  # too small
        assert "every texel is updated: its mip levels are means of all its texels" in str(session.report())
    gpu.silent()


def test_a_phase_at_rest_reads_lists_and_has_the_bits_of_one_that_does_not(gpu, tmp_path):
    """With nothing computed beforehand the sample reads the images; the steps, and the loss, are the same to the bit."""
    found, size = [], (50, 33)
    for cache in (True, False):
        scene = Scene(orbit(2, [20, -15], 3.0, 40, (100, 75)))
        texture = scene.parameter("texture", 0.2 + 0.6 * fine(64)[:size[1], :size[0]], 0.0, 1.0, kind="image")
        scene.add(sphere(162, 1.0), material=Unlit(Texture(texture, mips=True, wrap=("repeat", "clamp"))))
        seen = scene.frame(HardSoftRas(r=1.0, delta=0.0))
        photo = scene.input("photo", np.random.default_rng(3).random((2, 75, 100, 3)))
        scene.phase("fit", 40, {"texture": Adam(0.03)}, color=l2(seen.color, photo, mask=seen.mask))
        description = scene.compile("vulkan_min", tmp_path / "a.dressi", cache=cache)
        assert any("sample_touched" in ops for ops in description["meta"]["holds"]["fit"]) == cache
        with runtime.load(tmp_path / "a.dressi", gpu.device) as session:
            session.step(5)
            found.append((session.get("texture"), session.loss()))
    np.testing.assert_array_equal(found[0][0], found[1][0])
    assert found[0][1] == found[1][1]
    gpu.silent()


def test_srgb_is_decoded_before_it_is_averaged_and_colours_multiply(gpu, tmp_path):
    """A fine black and white board seen from afar is 0.5 in linear light, not 0.21; colours of vertices multiply it."""
    y, x = np.mgrid[:64, :64]
    board = np.repeat(((x + y) % 2)[..., None], 3, -1).astype(float)
    ball = sphere(162, 1.0)
    found, half = {}, F.constant_table(np.full((162, 3), 0.5))
    for name, source in {"srgb": lambda t: Texture(t, mips=True, srgb=True, bias=3.0),
                         "times": lambda t: Product([Texture(t, mips=True, bias=3.0), Vertex(half), 0.5]),
                         "other": lambda t: Texture(t, mips=True, bias=3.0, uv=Coordinates(ball.uvs * 3, ball.uv_faces))}.items():
        scene = Scene(orbit(1, [20], 3.0, 40, (20, 20)))
        scene.add(ball, material=Unlit(source(constant(board))))
        seen = scene.frame(HardSoftRas(r=1.0, delta=0.0))
        scene.output("o", color=seen.color, mask=seen.mask)
        scene.compile("lavapipe", tmp_path / "a.dressi")
        with runtime.load(tmp_path / "a.dressi", gpu.device) as session:
            found[name] = session.get("o.color")[session.get("o.mask") > 0]
    np.testing.assert_allclose(found["srgb"], 0.5, atol=0.02)
    np.testing.assert_allclose(found["times"], 0.125, atol=0.005)
    np.testing.assert_allclose(found["other"], 0.5, atol=0.02)


def test_small_and_single_texels_have_nothing_to_alias(gpu, tmp_path):
    scene = Scene(orbit(1, [20], 3.0, 40, (20, 20)))
    scene.add(sphere(42, 1.0), material=Unlit(Texture(constant(np.full((1, 3, 3), 0.25)), mips=True)))
    seen = scene.frame(HardSoftRas(r=1.0, delta=0.0))
    scene.output("o", color=seen.color, mask=seen.mask)
    scene.compile("vulkan_min", tmp_path / "a.dressi")
    with runtime.load(tmp_path / "a.dressi", gpu.device) as session:
        np.testing.assert_allclose(session.get("o.color")[session.get("o.mask") > 0], 0.25, atol=1e-6)
