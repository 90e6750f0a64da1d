"""Texture sampling and its gradients: the exact transpose against the dense matrix, inverse UV against its expectation."""

import numpy as np
import pytest

from dressi_edge.cache.errors import GraphError, InputError
from dressi_edge.cache.layout import Layout
from dressi_edge.cache.profile import Profile
from dressi_edge.compiler import Program
from dressi_edge.compiler.backend.emit import hardware_filter
from dressi_edge.compiler.graph.autodiff import gradients
from dressi_edge.compiler.graph.functions import apply, constant, dot, mean, total
from dressi_edge.compiler.graph.ir import UNIT, image, topological
from dressi_edge.compiler.graph.ops.inverse_uv import inverse_uv
from dressi_edge.compiler.graph.ops.texture import footprint
from dressi_edge.compiler.graph.reference import evaluate
from dressi_edge.compiler.render.material import Texture
from dressi_edge.compiler.render.optimizer import Adam
from dressi_edge.compiler.render.texture import sample_texture

pytest_plugins = ["gpu"]

WIDTH, HEIGHT = 23, 19
SIZES = [(1, 1), (1, 7), (5, 3), (64, 64), (300, 7)]
KINDS = ["inside", "outside", "one_texel", "nothing"]


def fp32(array):
    return np.asarray(array).astype(np.float32).astype(np.float64)


def screen(kind, rng):
    """uv (h, w, 2) and covered (h, w, 1)."""
    uv = rng.uniform(*(-2, 3) if kind == "outside" else (0, 1), (HEIGHT, WIDTH, 2))
    if kind == "one_texel":
        uv[:] = 0.31, 0.77
    return fp32(uv), (rng.random((HEIGHT, WIDTH, 1)) < (0 if kind == "nothing" else 0.6)).astype(np.int64)


def matrix(uv, covered, width, height, wrap):
    """The dense matrix from texels to pixels."""
    xs, ys, fx, fy = footprint(uv, width, height, wrap)
    m = np.zeros((uv.shape[0] * uv.shape[1], width * height))
    for i, j in np.ndindex(2, 2):
        weight = (fx if i else 1 - fx) * (fy if j else 1 - fy) * covered
        np.add.at(m, (np.arange(len(m)), (ys[..., j] * width + xs[..., i]).ravel()), weight.ravel())
    return m


def picture(vtype, width=WIDTH, height=HEIGHT):
    return Layout("image", vtype, width, height)


class Sampling:
    """A program that samples a texture, and gives out the sample and the texture's gradient of <sample, g>."""

    def __init__(self, width, height, wrap="repeat", gradient="exact", channels="vec3", size=(WIDTH, HEIGHT), covered=True):
        self.program = p = Program()
        self.texture, self.uv = p.input("texture", picture(channels, width, height)), p.input("uv", picture("vec2", *size))
        self.g = p.input("g", picture(channels, *size))
        self.covered = p.input("covered", picture("int", *size)) if covered else None
        self.step = p.input("step", Layout("unit", "int")) if gradient == "inverse_uv" else None
        self.y = sample_texture(self.texture, self.uv, wrap, gradient, self.covered, self.step)
        self.gradient, = gradients(total(dot(self.y, self.g)), [self.texture])
        outputs = {"y": (self.y, picture(channels, *size)), "gradient": (self.gradient, picture(channels, width, height))}
        p.plan("p", {}, outputs, dynamic=frozenset({"texture", "g"}))


def values(s, kind, seed=0):
    rng = np.random.default_rng(seed)
    uv, covered = screen(kind, rng)
    e, c = s.texture.extent, s.texture.channels
    return {"texture": fp32(rng.normal(size=(e.height, e.width, c))), "g": fp32(rng.normal(size=(HEIGHT, WIDTH, c))), "uv": uv,
            "covered": covered}


# The exact transpose


@pytest.mark.parametrize("wrap", ["repeat", "clamp"])
@pytest.mark.parametrize("size", SIZES, ids=str)
def test_the_exact_gradient_is_the_dense_transpose(gpu, size, wrap):
    s = Sampling(*size, wrap)
    with gpu.open(s.program) as session:
        for kind in KINDS:
            feed = values(s, kind)
            m = matrix(feed["uv"], feed["covered"], *size, wrap)
            expected = (m.T @ feed["g"].reshape(-1, 3)).reshape(feed["texture"].shape)
            y, g = evaluate([s.y, s.gradient], feed)
            np.testing.assert_allclose(g, expected, atol=1e-12)
            np.testing.assert_allclose(y, (m @ feed["texture"].reshape(-1, 3)).reshape(y.shape), atol=1e-12)
            for name, array in feed.items():
                session.set(name, s.program.values[name].layout.from_image(array))
            device, sampled = session.get("gradient"), session.get("y")
            rounding = 6e-8 * max(size) * (4 if kind == "outside" else 1)  # of uv x size in fp32
            scale = rounding * abs(feed["g"]).max() + 5e-6 * max(1, abs(expected).max())
            np.testing.assert_allclose(device, expected, atol=scale)
            inner = (sampled.astype(float) * feed["g"]).sum(), (device.astype(float) * feed["texture"]).sum()
            np.testing.assert_allclose(*inner, rtol=1e-5, atol=5e-3)
    gpu.silent()


@pytest.mark.parametrize("channels", ["float", "vec2", "vec4"])
def test_every_channel_count_and_every_pixel_covered(gpu, channels):
    s = Sampling(6, 9, "clamp", channels=channels, covered=False)
    feed = values(s, "inside")
    m = matrix(feed["uv"], np.ones_like(feed.pop("covered")), 6, 9, "clamp")
    expected = (m.T @ feed["g"].reshape(len(m), -1)).reshape(feed["texture"].shape)
    device = gpu.run(s.program, feed)["gradient"].reshape(expected.shape)
    np.testing.assert_allclose(device, expected, atol=2e-5)


@pytest.mark.parametrize("size", [(5, 3), (64, 64), (300, 7)], ids=str)
@pytest.mark.parametrize("moving", [False, True])
def test_sorting_the_covered_pixels_alone_gives_the_same_bits(gpu, monkeypatch, size, moving):
    """What depends on coordinates is computed once, or, where they change every step, with the rest."""
    found = []
    for many in (1, 1 << 30):
        monkeypatch.setattr("dressi_edge.compiler.graph.ops.texture_gradient.MANY", many)
        s = Sampling(*size)
        assert ("merge_listed" in {n.op.name for n in topological([s.gradient])}) == (many == 1)
        if moving:
            spec = s.program.plans[0]
            s.program.plans[0] = type(spec)(**{**spec.__dict__, "dynamic": frozenset({"texture", "g", "uv", "covered"})})
        with gpu.open(s.program) as session:
            for kind in ("inside", "nothing", "outside", "one_texel"):  # fewer and more of them by turns
                feed = values(s, kind)
                for name, array in feed.items():
                    session.set(name, s.program.values[name].layout.from_image(array))
                found.append(session.get("gradient"))
                np.testing.assert_allclose(found[-1], evaluate([s.gradient], feed)[0], atol=2e-3)
    for a, b in zip(found[:4], found[4:]):
        np.testing.assert_array_equal(a, b)
    gpu.silent()


def test_two_runs_give_the_same_bits(gpu):
    runs = []
    for _ in range(2):
        s = Sampling(16, 16)
        runs.append(gpu.run(s.program, values(s, "inside"))["gradient"])
    np.testing.assert_array_equal(*runs)


def test_what_depends_on_uv_alone_is_computed_once(gpu):
    s = Sampling(16, 16)
    feed = values(s, "inside")
    with gpu.open(s.program) as session:
        for k in range(3):
            for name, array in feed.items():
                if k == 0 or name == "g":
                    session.set(name, s.program.values[name].layout.from_image(array * (1 + k)))
            session.get("gradient")
        assert session.report()["runs"] == {"p.prepare": 1, "p": 3}


def test_textures_of_one_size_share_their_lists():
    p = Program()
    uv = p.input("uv", picture("vec2"))
    textures = [p.input(name, picture(kind, 8, 8)) for name, kind in (("a", "vec3"), ("b", "float"))]
    loss = sum(total(dot(y, y)) for y in (sample_texture(t, uv) for t in textures))
    names = [n.op.name for n in topological(gradients(loss, textures))]
    assert names.count("texture_list") == 1 and names.count("texture_gather_lanes") == 2


def test_pixels_of_a_table_s_padding_do_not_count(gpu):
    p, rng = Program(), np.random.default_rng(3)
    uv, texture = p.input("uv", Layout("table", "vec2", count=13)), constant(np.zeros((4, 4, 3)))
    step = p.input("step", Layout("unit", "int"), 0)
    results = {}
    for gradient in ("exact", "inverse_uv"):
        g, = gradients(total(sample_texture(texture, uv, "clamp", gradient, step=step)).x, [texture])
        results[gradient] = g, picture("vec3", 4, 4)
    p.plan("p", {}, results)
    points = fp32(rng.uniform(0.5, 1, (13, 2)))
    with gpu.open(p) as session:
        session.set("uv", points)
        assert abs(session.get("exact")[..., 0].sum() - 13) < 1e-4
        assert session.get("inverse_uv")[0, 0, 0] == 0 < session.get("inverse_uv").sum()


# Inverse UV

# Point n times 2^k, from scipy.stats.qmc.Sobol(2, scramble=False) of SciPy 1.17
SOBOL_16 = [(0, 0), (8, 8), (12, 4), (4, 12), (6, 6), (14, 14), (10, 2), (2, 10), (3, 5), (11, 13), (15, 1), (7, 9), (5, 3),
            (13, 11), (9, 7), (1, 15)]
SOBOL_LATER = {1000: (10, 225, 99), 1001: (10, 737, 611), 1002: (10, 993, 355), 123456: (17, 3473, 23953)}


def test_sobol_points_are_scipy_s(gpu):
    index = np.array([*range(16), *SOBOL_LATER, 2 ** 30 - 1])
    p = Program()
    n = p.input("n", picture("int", len(index), 1))
    y = apply("sobol", n)
    p.plan("p", {}, {"y": (y, picture("vec2", len(index), 1))})
    expected = np.array([*(np.array(SOBOL_16) / 16), *(np.array(xy) / 2 ** k for k, *xy in SOBOL_LATER.values())])
    feed = {"n": index[None, :, None]}
    device, reference = gpu.run(p, feed)["y"][0], evaluate([y], feed)[0][0]
    np.testing.assert_array_equal(reference[:-1], expected)
    np.testing.assert_array_equal(device, reference)
    assert (reference < 1).all() and (reference >= 0).all()


@pytest.mark.parametrize("wrap", ["repeat", "clamp"])
@pytest.mark.parametrize("size", SIZES, ids=str)
def test_a_texel_holds_the_last_of_the_pixels_that_it_is_sampled_by(gpu, size, wrap):
    p = Program()
    uv, covered = p.input("uv", picture("vec2")), p.input("covered", picture("int"))
    step = p.input("step", Layout("unit", "int"))
    y = inverse_uv(uv, covered, step, image(*size), wrap)
    p.plan("p", {}, {"y": (y, picture("int", *size))})
    with gpu.open(p) as session:
        for kind in KINDS:
            points, mask = screen(kind, np.random.default_rng(5))
            session.set("uv", points)
            session.set("covered", mask[..., 0])
            m = matrix(points, mask, *size, wrap)
            for k in (0, 1, 2, 77):
                session.set("step", k)
                found = session.get("y")
                np.testing.assert_array_equal(found, evaluate([y], {"uv": points, "covered": mask, "step": [[[k]]]})[0][..., 0])
                texels = np.flatnonzero(found >= 0)
                assert (m[found.ravel()[texels], texels] > 0).all()
                assert bool(len(texels)) == (kind != "nothing")
    gpu.silent()


def test_inverse_uv_expects_the_bilinear_weights_over_256_steps(gpu):
    rng, steps = np.random.default_rng(8), 256
    cells = np.stack(np.meshgrid(np.arange(5), np.arange(4)), 2) * 4 + rng.uniform(0.5, 2.5, (4, 5, 2))  # footprints apart
    uv = fp32(cells / [20, 16])
    p = Program()
    step = p.state("step", Layout("unit", "int"), 0)
    summed = p.state("summed", picture("vec3", 20, 16))
    texture, weights = constant(np.zeros((16, 20, 3))), fp32(rng.normal(size=(4, 5, 3)))
    y = sample_texture(texture, constant(uv), "clamp", "inverse_uv", step=step)
    g, = gradients(total(dot(y, constant(weights))), [texture])
    p.plan("p", {"summed": summed + g, "step": step + 1})
    with gpu.open(p) as session:
        session.step(steps)
        device = session.get("summed") / steps
    m = matrix(uv, np.ones((4, 5, 1)), 20, 16, "clamp")
    exact = (m.T @ weights.reshape(-1, 3)).reshape(16, 20, 3)
    reference = np.mean([evaluate([g], {"step": np.array([[[k]]])})[0] for k in range(steps)], 0)
    np.testing.assert_allclose(device, reference, atol=1e-5)
    assert abs(device - exact).max() < 0.03 * abs(weights).max()


# Both


@pytest.mark.parametrize("gradient", ["exact", "inverse_uv"])
def test_a_texture_is_recovered(gpu, gradient):
    rng, side = np.random.default_rng(1), 16
    truth = fp32(rng.uniform(0, 1, (side, side, 3)))
    uv = fp32(rng.uniform(0, 1, (40, 40, 2)))
    target, = evaluate([sample_texture(constant(truth), constant(uv), gradient="none")])
    p = Program()
    texture, step = p.state("texture", picture("vec3", side, side), 0.5), p.state("step", Layout("unit", "int"), 0)
    difference = sample_texture(texture, constant(uv), gradient=gradient, step=step) - constant(target)
    loss = mean(dot(difference, difference))
    g, = gradients(loss, [texture])
    adam = Adam({"start": 0.05, "end": 0.0005, "steps": 400})
    p.plan("p", {**adam.update(p, "texture", texture, g, step), "step": step + 1}, {"loss": (loss, Layout("unit", "float"))})
    with gpu.open(p) as session:
        session.step(400)
        loss, error = float(session.get("loss")), abs(session.get("texture") - truth)
    assert loss < (1e-8 if gradient == "exact" else 1e-5)
    assert error.mean() < (1e-3 if gradient == "exact" else 1e-2)
    gpu.silent()


@pytest.mark.parametrize("wrap", ["repeat", "clamp"])
@pytest.mark.parametrize("channels", ["float", "vec2", "vec3", "vec4"])
def test_the_sampler_and_four_fetches_agree(gpu, wrap, channels):
    """On lavapipe to 2.4e-7 of the texture's range within [0, 1]; elsewhere the wrapping of the coordinate rounds."""
    rng = np.random.default_rng(2)
    p = Program()
    texture, uv = p.input("texture", picture(channels, 31, 17)), p.input("uv", picture("vec2"))
    p.plan("p", {}, {"y": (sample_texture(texture, uv, wrap, "none"), picture(channels))})
    points = rng.uniform(0, 1, (HEIGHT, WIDTH, 2))
    points[:, 12:] = points[:, 12:] * 7 - 3
    feed = {"uv": fp32(points), "texture": fp32(rng.uniform(0, 1, (17, 31, texture.channels)))}
    assert [hardware_filter(texture, Profile.load(profile)) for profile in ("lavapipe", "vulkan_min")] == [True, False]
    results = [gpu.run(p, feed, profile)["y"] for profile in ("lavapipe", "vulkan_min")]
    np.testing.assert_allclose(results[0][:, :12], results[1][:, :12], atol=2.4e-7)
    np.testing.assert_allclose(*results, atol=1e-5)


def test_wrong_arguments_are_named():
    p = Program()
    texture, uv = p.input("texture", picture("vec3", 4, 4)), p.input("uv", picture("vec2"))
    with pytest.raises(InputError, match="gradient is 'fast'; exact inverse_uv none are allowed"):
        sample_texture(texture, uv, gradient="fast")
    with pytest.raises(InputError, match="step is None; the 1x1 int that counts steps is needed"):
        sample_texture(texture, uv, gradient="inverse_uv")
    with pytest.raises(InputError, match="covered is uv: vec2 23x19; an int over 23x19 is needed"):
        sample_texture(texture, uv, covered=uv)
    with pytest.raises(InputError, match="wrap is 'border'; repeat clamp mirror are allowed"):
        sample_texture(texture, uv, "border")
    with pytest.raises(GraphError, match="coordinates must be vec2"):
        sample_texture(texture, apply("broadcast", apply("literal", value=0.5), extent=UNIT))


@pytest.mark.parametrize("image, shape", [(np.ones((2, 2, 5)), r"\(2, 2, 5\)"), (np.full((2, 2), np.nan), r"\(2, 2, 1\)"),
                                          (np.zeros((0, 2)), r"\(0, 2, 1\)"), ("wood.png", r"\(\)")])
def test_a_texture_of_an_array_is_a_constant_and_wrong_ones_are_named(image, shape):
    given = np.arange(60.0).reshape(4, 5, 3)
    np.testing.assert_array_equal(Texture(given).image.attrs["data"].array, given)
    with pytest.raises(InputError, match=f"a texture's image is of shape {shape} .* a node, or an array"):
        Texture(image)
