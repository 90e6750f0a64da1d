"""Storage half: what is rounded and how, that the device does what the reference says, and what becomes of numbers beyond fp16."""

import json

import jobs
import numpy as np
import pytest
from test_profile_matrix import fitted, problem, target

from dressi_edge import runtime
from dressi_edge.cache import bundle
from dressi_edge.cache.errors import InputError, ProfileError
from dressi_edge.cache.layout import Layout, halved
from dressi_edge.cache.profile import Profile
from dressi_edge.cache.verify import violations
from dressi_edge.cache.vulkan import HALF_FORMATS
from dressi_edge.cli import main
from dressi_edge.compiler import Options, Program, build
from dressi_edge.compiler.graph.functions import apply, constant_table, dot, lookup, total
from dressi_edge.compiler.graph.ir import topological
from dressi_edge.compiler.graph.ops.half import LARGEST
from dressi_edge.compiler.graph.ops.pixels import sum_named
from dressi_edge.compiler.graph.optable import OPS
from dressi_edge.compiler.graph.reference import evaluate
from dressi_edge.compiler.graph.reference_session import ReferenceSession
from dressi_edge.compiler.io.cameras import orbit
from dressi_edge.compiler.io.meshes import Mesh
from dressi_edge.compiler.io.shapes import icosphere
from dressi_edge.compiler.passes.store import halve
from dressi_edge.compiler.render.light import Light
from dressi_edge.compiler.render.optimizer import Adam, Sgd
from dressi_edge.compiler.render.raster import Softness
from dressi_edge.compiler.scene.problem import Loss, Problem

pytest_plugins = ["gpu"]


def awkward(count, half):
    """fp32 numbers at which rounding goes wrong, times 2^-half: ties, subnormals, what rounds to infinity, both signs."""
    rng = np.random.default_rng(0)
    bits = rng.integers(0, 0x7c00, count).astype(np.uint16).view(np.float16).astype(np.float64)
    above = np.nextafter(bits.astype(np.float16), np.float16(np.inf)).astype(np.float64)
    between = bits + (np.where(np.isfinite(above), above, bits) - bits) * rng.choice([0, 0.25, 0.5, 0.5, 0.75], count)
    extremes = [0.0, -0.0, 2.0 ** -24, 2.0 ** -25, 1.5 * 2 ** -25, 2.0 ** -14, 2.0 ** -14 * (1 - 2.0 ** -12), 1e-30, 65504.0, 65519.0,
                65520.0, 1e6, 1e30]
    x = np.concatenate([between * rng.choice([-1, 1], count), extremes, np.negative(extremes)])[-count:]
    return (x * 2.0 ** -half).astype(np.float32).astype(np.float64)


def relative(a, b):
    return float(np.linalg.norm(np.asarray(a, np.float64) - b) / np.linalg.norm(b))


def halves(program):
    """The `half` nodes of a program in storage half."""
    return [n for n in topological([n for s in halve(program).plans for n in (*s.updates.values(), *s.outputs.values())])
            if n.op.name == "half"]


# Rounding


@pytest.mark.parametrize("half", [0, 19, -9])
@pytest.mark.parametrize("vtype", ["float", "vec2", "vec3", "vec4"])
def test_the_device_rounds_and_stores_to_the_bit_as_numpy_does(gpu, vtype, half):
    program, table = Program(), Layout("table", vtype, count=500)
    x = program.input("x", table)
    rounded = apply("half", x, half=half)
    program.plan("round", {}, {"own": (rounded + 0.0, table), "stored": (lookup(rounded, np.arange(500)[::-1]), table)})
    data = np.stack([awkward(500, half)] * 4, -1)[:, :int(vtype[-1])] if vtype != "float" else awkward(500, half)
    image = table.to_image(data, "x")
    want = table.from_image(evaluate([rounded], {"x": image})[0])
    scaled = np.clip(data * 2.0 ** half, -LARGEST, LARGEST)
    np.testing.assert_array_equal(want, scaled.astype(np.float16).astype(np.float64) * 2.0 ** -half)
    got = gpu.run(program, {"x": image})
    np.testing.assert_array_equal(got["own"], want.astype(np.float32))
    np.testing.assert_array_equal(got["stored"], want[::-1].astype(np.float32))


@pytest.mark.parametrize("o", [o for o in OPS.values() if o.sums], ids=lambda o: o.name)
def test_an_op_that_sums_is_linear_in_it(o):
    """Then errors of rounding add up like the values, and its size is that of what it sums."""
    arguments, attrs = o.sample(np.random.default_rng(1))
    args = [x if isinstance(x, np.ndarray) else x.attrs["data"].array for x in arguments]
    once = o.ref(*args, **attrs)
    more = [x * 3.0 if k in o.sums else x for k, x in enumerate(args)]  # of several inputs in all of them together
    np.testing.assert_allclose(o.ref(*more, **attrs), 3.0 * once, rtol=1e-12, atol=1e-14)
    assert all(o.read(k) == "texel" for k in o.sums)


# What is stored in half


@pytest.mark.parametrize("scene", ["silhouette", "texture", "colors"])
def test_gradients_of_pixels_and_targets_are_halved_and_nothing_else(scene):
    program = problem(scene, 1)
    new = halve(program)
    assert [name for name, value in new.values.items() if value.node.half is not None] == ["targets"]
    roots = [n for s in new.plans for n in (*s.updates.values(), *s.outputs.values())]
    users = {n: [(u, k) for u in topological(roots) for k, x in enumerate(u.inputs) if x is n] for n in halves(program)}
    assert users and all(k in u.op.sums for found in users.values() for u, k in found)
    d = build(program, Profile.load("lavapipe"), Options(storage="half")).description
    values = {value["image"]: value["name"] for value in d["values"]}
    assert {values[k] for k, image in enumerate(d["images"]) if image["format"] in HALF_FORMATS and k in values} == {"targets"}
    assert not violations(d, Profile.load("lavapipe"))


@pytest.mark.parametrize("weight", [1e-4, 1.0, 1e4])
@pytest.mark.parametrize("sigma", [0.01, 0.3])
def test_the_power_of_two_keeps_gradients_within_fp16(weight, sigma):
    """Whatever the loss weighs and however sharp the edge is, what a gradient is made of is far from both ends."""
    ball = icosphere(1, 0.5)
    colors = np.random.default_rng(0).uniform(size=(len(ball.positions), 3))
    made = Problem(Mesh(ball.positions, ball.faces, colors=colors), orbit(2, (20.0, -20.0), 2.5, 50.0, (32, 32)), albedo="colors")
    made.phase("fit", 1, {"vertices": Adam(0.01), "colors": Adam(0.03)}, [Loss("silhouette", weight), Loss("color", weight)],
               Softness(2.0, sigma))
    program = halve(made.program)
    feed = {n: v.layout.to_image(v.initial, n) for n, v in program.values.items() if v.initial is not None}
    feed["targets"] = program.values["targets"].layout.to_image(target(), "targets", half=True)
    found = halves(made.program)
    assert len(found) >= 7
    for n, value in zip(found, evaluate([n.inputs[0] for n in found], feed)):
        scaled = np.abs(value) * 2.0 ** n.half
        assert 2.0 ** -14 < np.sqrt((scaled[scaled > 0] ** 2).mean()) and scaled.max() < LARGEST / 4, (n.inputs[0], n.half)


# On the device


@pytest.mark.parametrize("layers", [1, 3])
@pytest.mark.parametrize("scene", ["silhouette", "colors"])
def test_a_step_is_that_of_the_reference_with_the_same_rounding(gpu, scene, layers):
    program = problem(scene, layers)
    names = [name for name in program.values if name.endswith(".adam_m")]
    found = {}
    for storage in ("float", "half"):
        reference = ReferenceSession(halve(program) if storage == "half" else program)
        with gpu.open(program, storage=storage) as session:
            for s in (session, reference):
                s.set("targets", target())
                s.step(1)
            found[storage] = [(session.get(n).astype(np.float64), reference.get(n)) for n in names]
    gpu.silent()
    for (_, exact), (device, rounded), name in zip(found["float"], found["half"], names):
        assert 1e-6 < relative(rounded, exact) < 2e-3, name
        assert relative(device, rounded) < 1.1 * relative(rounded, exact) + 1e-4, name


def test_profiles_give_the_same_bits_with_and_without_the_cache(gpu):
    found = []
    for profile, cache in (("lavapipe", True), ("mali_g76", True), ("lavapipe", False)):
        with gpu.open(problem("silhouette", 1), profile, storage="half", cache=cache) as session:
            session.set("targets", target())
            session.step(5)
            found.append(session.get("vertices").tobytes())
    gpu.silent()
    assert found[1:] == found[:-1]


def test_what_is_known_beforehand_is_stored_in_half_too(gpu):
    """A gradient of pixels that no step changes is kept in an image of 16 bits."""
    program, image, table = Program(), Layout("image", "float", 8, 8), Layout("table", "float", count=4)
    weights, scale = program.input("weights", image, 0.0), program.state("scale", Layout("unit", "float"), 1.0)
    index = apply("imod", apply("texel_index", extent=weights.extent), 4)
    box = constant_table(np.tile([0, 0, 8, 8], (4, 1)))
    kept = apply("sin", apply("exp", apply("cos", weights)))
    g = sum_named(kept, index, box)
    program.plan("step", {"scale": scale * 0.5}, {"g": (g * lookup(scale, np.zeros(4, int)), table)})
    d = build(program, Profile.load("lavapipe"), Options(storage="half")).description
    assert sum(i["format"] in HALF_FORMATS for i in d["images"]) == 1
    data = np.random.default_rng(2).uniform(0, 3, (8, 8))
    with gpu.open(program, storage="half") as session:
        session.set("weights", data)
        session.step(1)
        want, = evaluate([halve(program).plans[0].outputs["g"]], {"weights": image.to_image(data, "w"), "scale": np.ones((1, 1, 1))})
        np.testing.assert_allclose(session.get("g"), table.from_image(want), rtol=2e-3)
    gpu.silent()


def test_a_fit_comes_as_near_as_with_float(gpu):
    found = {}
    for storage in ("float", "half"):
        with gpu.open(problem("colors", 1), storage=storage) as session:
            found[storage] = fitted(session)
    gpu.silent()
    (before, after), image = found["float"]
    assert after < 0.8 * before
    assert found["half"][0][1] == pytest.approx(after, rel=0.02)
    assert np.abs(found["half"][1] - image).mean() < 0.01


# Numbers in and out


def test_what_is_set_comes_back_rounded_and_what_is_beyond_is_named(gpu):
    good = target() * np.float32(0.7)
    program = problem("silhouette", 1)
    with gpu.open(program, storage="half") as session:
        for s in (session, ReferenceSession(halve(program))):
            s.set("targets", good)
            np.testing.assert_array_equal(s.get("targets"), halved(good).astype(np.float32))
            for bad, told in ((1e6, r"targets\[1, 2, 3, 0\] is 1e\+06, beyond the range of fp16"), (-65520, "at most 65504 is allowed"),
                              (np.nan, "1 values that are NaN or Inf"), (np.inf, "NaN or Inf"), (1e39, "range of fp32")):
                array = good.astype(np.float64)
                array[1, 2, 3, 0] = bad
                with pytest.raises(InputError, match=told):
                    s.set("targets", array)
            np.testing.assert_array_equal(s.get("targets"), halved(good).astype(np.float32))
            array[1, 2, 3, 0] = 65519
            s.set("targets", array)
            assert s.get("targets")[1, 2, 3, 0] == 65504
        assert session.get("targets").dtype == np.float32
    gpu.silent()


def test_a_default_beyond_fp16_is_named_when_compiled(gpu):
    program, layout = Program(), Layout("image", "float", 2, 2)
    x = program.input("x", layout, np.full((2, 2), 1e5), narrow=True)
    program.plan("look", {}, {"y": (x * 2.0, layout)})
    with pytest.raises(InputError, match=r"x\[0, 0\] is 100000, beyond the range of fp16 in which it is stored; .* storage float"):
        gpu.compile(program, storage="half")
    assert gpu.run(program, {})["y"][0, 0] == 2e5


def test_colours_of_a_million_stay_finite(gpu):
    """The power of two follows the light; and where it is set later, beyond what was foreseen, gradients end at the largest number."""
    made = Problem(icosphere(1, 0.5), orbit(2, (20.0, -20.0), 2.5, 50.0, (32, 32)), albedo="colors", shading="lambert",
                   lights=[Light("ambient", (1e6,) * 3)])
    made.phase("fit", 5, {"vertices": Adam(0.01), "colors": Sgd(1e-12)}, [Loss("color")])
    with gpu.open(made.program, storage="half") as session:
        session.set("targets", target())
        for power in (1e6, 1e12):
            session.set("light0.power", np.full(3, power))
            session.step(5)
            for name in ("vertices", "vertices.adam_m", "colors"):
                assert np.isfinite(session.get(name)).all(), (name, power)
        assert np.abs(session.get("vertices.adam_m")).max() > 0
    gpu.silent()


def test_a_run_goes_on_from_a_checkpoint_bit_for_bit(gpu, tmp_path):
    path = gpu.compile(problem("colors", 1), storage="half")
    with runtime.load(path, gpu.device) as session, runtime.load(path, gpu.device) as other:
        session.set("targets", target())
        session.step(3)
        session.checkpoint(tmp_path / "c")
        other.restore(tmp_path / "c")
        for s in (session, other):
            s.step(3)
        for name in ("targets", "vertices", "colors", "fit.loss"):
            assert session.get(name).tobytes() == other.get(name).tobytes(), name
    gpu.silent()


# The choice


def without_half(folder):
    """A profile's file that has no R16G16_SFLOAT."""
    raw = json.loads((jobs.ROOT / "device_profiles" / "lavapipe.json").read_text())
    block, = raw["capabilities"].values()
    block.setdefault("formats", {})["VK_FORMAT_R16G16_SFLOAT"] = {"VkFormatProperties": {
        "linearTilingFeatures": [], "optimalTilingFeatures": ["VK_FORMAT_FEATURE_SAMPLED_IMAGE_BIT"], "bufferFeatures": []}}
    path = folder / "without.json"
    path.write_text(json.dumps(raw))
    return path


def small():
    program, layout = Program(), Layout("image", "vec3", 4, 3)
    x = program.input("x", layout, 0.5, narrow=True)
    program.plan("look", {}, {"y": (total(dot(x, x)), Layout("unit", "float"))})
    return program


def formats(path):
    return {image["format"] for one in bundle.read(path).variants for image in one.description["images"]}


def test_float_unless_asked_for_or_preferred_by_all(gpu, tmp_path):
    prefers = [Profile("one", prefer_fp16=True), Profile("two", prefer_fp16=True)]
    for profiles, storage, half in ((prefers, None, True), (prefers, "float", False), ([*prefers, "lavapipe"], None, False),
                                    ([*prefers, "lavapipe"], "half", True), ("lavapipe", None, False), (prefers[:1], None, True)):
        path = gpu.compile(small(), profiles, storage=storage)
        assert bool(formats(path) & HALF_FORMATS) == half
        assert path.read_bytes()[8] == (3 if half else 2 if len(profiles) in (2, 3) else 1)
    assert gpu.compile(small()).read_bytes() == gpu.compile(small(), storage="float").read_bytes()


def test_a_file_of_several_variants_in_half_runs(gpu):
    with gpu.open(small(), ["limit8", "vulkan_min"], storage="half") as session:
        assert session.get("y") == pytest.approx(9.0)
    gpu.silent()


def test_a_wrong_storage_or_a_profile_without_the_formats_is_one_error(gpu, tmp_path):
    with pytest.raises(InputError, match="storage is 'quarter'; allowed: float half"):
        gpu.compile(small(), storage="quarter")
    with pytest.raises(ProfileError, match="storage half needs R16G16_SFLOAT with color and sampled; profile lavapipe has sampled; choose"):
        gpu.compile(small(), str(without_half(tmp_path)), storage="half")
    gpu.compile(small(), str(without_half(tmp_path)))


def test_the_command_line_compiles_in_half(tmp_path, capsys):
    job = str(jobs.write_job(tmp_path))
    made = [str(tmp_path / f"{storage}.dressi") for storage in ("float", "half")]
    for path, more in zip(made, ([], ["--storage", "half"])):
        assert main(["compile", job, "-p", "mali_g76", "-o", path, *more]) == 0
        assert main(["verify", path, "-p", "mali_g76"]) == 0
    assert not formats(made[0]) & HALF_FORMATS and formats(made[1]) & HALF_FORMATS
    capsys.readouterr()
    assert main(["compile", job, "-p", str(without_half(tmp_path)), "-o", made[1], "--storage", "half"]) == 3
    assert "storage half needs R16G16_SFLOAT" in capsys.readouterr().err
    with pytest.raises(SystemExit) as ended:
        main(["compile", job, "-p", "mali_g76", "-o", made[1], "--storage", "quarter"])
    assert ended.value.code == 2 and "invalid choice: 'quarter'" in capsys.readouterr().err
