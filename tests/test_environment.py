"""Light from all directions: the octahedral map, what lobes see of it against integrals in float64, the shaded surface against Monte Carlo
of the very reflectance, gradients of map, rotation, strength and roughness, the background, and panoramas that are none."""
import struct
import sys
import warnings
import zlib

import numpy as np
import pytest
from PIL import Image
from shading import Given, random_surfaces, reflected, unit

from dressi_edge import runtime
from dressi_edge.cache.errors import GraphError, InputError, InputWarning
from dressi_edge.compiler.check_op import layout_of
from dressi_edge.compiler.graph.autodiff import gradients
from dressi_edge.compiler.graph.functions import constant, dot, total
from dressi_edge.compiler.graph.reference import evaluate
from dressi_edge.compiler.graph.reference_session import ReferenceSession
from dressi_edge.compiler.io.panorama import checked, load_panorama, write_hdr
from dressi_edge.compiler.render.brdf import diffuse_loss, specular_integrals
from dressi_edge.compiler.render.octahedron import cells, folded, octahedral, panorama, panorama_directions, place, places, rim
from dressi_edge.compiler.render.prefilter import ROUGHNESSES, layout, lobe, matrix
from dressi_edge.compiler.scene import PBR, Adam, Environment, Scene, Tone, icosphere, l2, orbit

pytest_plugins = ["gpu"]


def sky(direction):
    """A smooth environment with a low sun: radiance (..., 3)."""
    d = unit(direction)
    sun = np.exp(30 * (d @ unit([0.6, 0.5, -0.62]) - 1))[..., None] * [9.0, 7.0, 4.0]
    window = np.exp(8 * (d @ unit([-0.8, 0.2, 0.3]) - 1))[..., None] * [0.5, 1.0, 2.0]
    return 0.2 + (0.4 + 0.3 * d[..., 1:2]) * [0.6, 0.8, 1.0] + sun + window


def mapped(n, light=sky):
    """The octahedral map of a function."""
    directions, angles = cells(n, 4)
    return ((light(directions) * angles[..., None]).sum(1) / angles.sum(1)[:, None]).reshape(n, n, 3)


def directions(rng, count):
    return unit(rng.normal(size=(count, 3)))


# The map

def test_the_square_is_the_sphere():
    d = directions(np.random.default_rng(0), 500)
    np.testing.assert_allclose(unit(folded(places(d) * 2 - 1)), d, atol=1e-12)
    found = evaluate([place(constant(d[None] * 3.0))])[0][0]
    np.testing.assert_allclose(found, places(d), atol=1e-12)
    np.testing.assert_allclose(places(np.array([[0, 1, 0], [1, 0, 0], [0, 0, 1]])), [[0.5, 0.5], [1, 0.5], [0.5, 1]], atol=1e-12)
    for n in (16, 64):
        assert cells(n, 2)[1].sum() == pytest.approx(4 * np.pi, rel=3e-4)
        middle = cells(n)[0][:, 0].reshape(n, n, 3)
        rimmed = middle.reshape(-1, 3)[rim(n)]
        steps = [np.linalg.norm(np.diff(rimmed, axis=a), axis=-1) for a in (0, 1)]
        assert max(s.max() for s in steps) < 5.0 / n and all((s > 0)[1:-1, 1:-1].all() for s in steps)  # neighbours are neighbours


def test_a_panorama_keeps_its_light_and_its_directions():
    rng = np.random.default_rng(1)
    wide = rng.lognormal(0, 1, (24, 48, 3))
    theta = (np.arange(24) + 0.5) * np.pi / 24
    power = (wide * np.sin(theta)[:, None, None]).sum((0, 1)) / np.sin(theta).sum() / 48
    for n in (16, 64):
        square = octahedral(wide, n)
        angle = cells(n, 2)[1].sum(1).reshape(n, n, 1)
        np.testing.assert_allclose((square * angle).sum((0, 1)) / angle.sum(), power, rtol=0.02)
    for column, row, towards in ((24, 12, (0, 0, -1)), (36, 12, (1, 0, 0)), (0, 12, (0, 0, 1)), (5, 0, (0, 1, 0))):
        spot = np.zeros((24, 48, 3))
        spot[max(row - 1, 0):row + 1, (np.arange(-1, 2) + column) % 48 if row else slice(None)] = 1.0
        bright = octahedral(spot, 32)[..., 0].ravel()
        seen = unit((cells(32)[0][:, 0] * bright[:, None]).sum(0))
        assert seen @ np.array(towards) > 0.99
    smooth = mapped(64)
    back = panorama(smooth, 48)
    truth = sky(panorama_directions((np.arange(48) + 0.5) * np.pi / 48, 96))
    assert np.median(np.abs(back - truth) / truth) < 2e-3
    np.testing.assert_allclose(back, truth, rtol=0.1)


def test_all_levels_are_means():
    """Each row of the matrix adds to 1 and has no negative weight: a white sky stays white, and no light is made."""
    for n in (16, 32):
        rows, cols, weights = matrix(n)
        sums = np.add.reduceat(np.append(weights, 0), rows[..., 0].ravel().clip(max=len(weights)))
        filled = (rows[..., 1] > rows[..., 0]).ravel()
        np.testing.assert_allclose(sums[filled], 1, rtol=1e-9)
        assert (weights > 0).all() and filled.sum() == sum((x.n + 2) ** 2 for x in (*layout(n).levels, layout(n).diffuse))


def lights(environment, at, roughness):
    """Graph: what lobes about directions (h, w, 3) see, and diffuse light."""
    d = constant(at)
    return environment.specular(d, constant(roughness)), environment.diffuse(d)


def test_lobes_see_the_integral():
    """At any roughness, between levels too: at most 1 % off in the middle against the lobe's integral over a fine sphere in float64."""
    rng, count = np.random.default_rng(2), 60
    at, roughness = directions(rng, count)[None], rng.uniform(0.08, 1, (1, count, 1))
    found, diffuse = evaluate(list(lights(Environment(mapped(64)), at, roughness)))
    fine, angle = (a.reshape(-1, *a.shape[2:]) for a in cells(256, 2))
    light = sky(fine)
    for k, name in ((0, "lobe"), (1, "diffuse")):
        truth = []
        for d, r in zip(at[0], roughness[0, :, 0]):
            w = lobe(r if k == 0 else None)(fine @ d) * angle
            truth.append(w @ light / w.sum())
        error = np.abs((found, diffuse)[k][0] - truth) / truth
        assert np.median(error) < 0.01 and np.quantile(error, 0.95) < 0.05, (name, np.median(error))


def test_a_surface_under_a_sky_is_the_split_sum_and_near_the_integral(gpu):
    """Against the split sum in float64 at most 1 % off in the middle; what the split itself leaves out is stated, and bounded, beside."""
    rng, count = np.random.default_rng(3), 40
    values = random_surfaces(rng, (1, count), 0.3) | {"color": rng.uniform(0.1, 0.9, (1, count, 3)),
                                                     "metallic": rng.integers(0, 2, (1, count, 1)).astype(float),
                                                     "roughness": rng.uniform(0.1, 1, (1, count, 1))}
    given = Given(**values)
    x = given.nodes
    y = PBR(x["color"], x["roughness"], x["metallic"], environment=Environment(mapped(64)))(given.surface)
    given.program.plan("p", {}, {"y": (y, layout_of(y))})
    found = gpu.run(given.program, {})["y"][0]
    n, v, color, metallic, roughness = (values[k][0] for k in ("normal", "to_eye", "color", "metallic", "roughness"))
    nv = (n * v).sum(1)
    mirror = 2 * nv[:, None] * n - v
    fine, angle = (a.reshape(-1, *a.shape[2:]) for a in cells(128, 2))
    light, a, b = sky(fine), *specular_integrals(nv, roughness[:, 0], (256, 64))
    f0 = 0.04 * (1 - metallic) + color * metallic
    split = np.empty_like(found)
    for k in range(count):
        weight, cosine = lobe(float(roughness[k, 0]))(fine @ mirror[k]) * angle, lobe(None)(fine @ n[k]) * angle
        shine = (weight @ light) / weight.sum() * (f0[k] * a[k] + b[k])
        body = color[k] * (1 - metallic[k]) * (1 - f0[k]) * (1 - diffuse_loss(nv[k:k + 1])[0])
        split[k] = shine + (cosine @ light) / cosine.sum() * body
    ours = np.abs(found - split) / split
    assert np.median(ours) < 0.01 and np.quantile(ours, 0.95) < 0.05
    truth = reflected(n, v, color, metallic, roughness, sky, rng, 40000)
    theirs = np.abs(split - truth) / truth
    assert np.median(theirs) < 0.08  # of the split sum, not of ours: lobes are not round away from the mirror's direction
    white = PBR(x["color"], x["roughness"], x["metallic"], environment=Environment(np.ones((16, 16, 3))))(given.surface)
    np.testing.assert_allclose(evaluate([white], values)[0][0], reflected(n, v, color, metallic, roughness,
                                                                         lambda d: np.ones((len(d), 1)), rng), rtol=0.015)


def test_both_gradients_give_the_same_light():
    rng = np.random.default_rng(4)
    at, roughness = directions(rng, 50)[None], np.append(rng.uniform(0, 1, 42), ROUGHNESSES).reshape(1, 50, 1)
    light = mapped(32)
    one, two = (evaluate(list(lights(Environment(constant(light), (0.3, -0.2, 0.5), 1.5, gradient), at, roughness)))
                for gradient in ("exact", "none"))
    for a, b in zip(one, two):
        np.testing.assert_allclose(a, b, rtol=1e-10)
    for r in (0.0, 0.1, 0.33, 1.0, 2.0):
        fixed = Environment(constant(light), (0.3, -0.2, 0.5), 1.5).specular(constant(at), r)
        np.testing.assert_allclose(evaluate([fixed])[0], evaluate([lights(Environment(constant(light), (0.3, -0.2, 0.5), 1.5), at,
                                                                          np.full((1, 50, 1), min(r, 1.0)))[0]])[0], rtol=1e-10)


# Gradients

def scene(gradient="exact", size=(20, 16), n=16, **material):
    s = Scene(orbit(2, [20, -15], 2.6, 40, size))
    s.encode = Tone("reinhard", 0.5)
    around = Environment(s.parameter("sky", mapped(n), low=0.0, kind="image"), s.parameter("turn", [0.2, -0.5, 0.1]),
                         s.parameter("strength", 0.8), gradient)
    roughness = s.parameter("roughness", 0.35, low=0.02, high=1.0)
    s.add(icosphere(2, 0.8), material=PBR((0.8, 0.6, 0.4), roughness, 0.7, 0.9, environment=around, **material))
    s.surroundings = around
    f = s.frame()
    s.vjp("back", [k for k in s.parameters if gradient == "exact" or k != "sky"], color=f.color)
    return s


@pytest.mark.parametrize("gradient", ["exact", "none"])
def test_gradients_of_everything_are_central_differences(gradient):
    s, rng = scene(gradient), np.random.default_rng(5)
    with ReferenceSession(s.program) as session:
        g = rng.normal(size=session.shape("back.color.grad"))
        session.forward("back")
        found = session.backward("back", color=g)
        for name, x in found.items():
            start, direction = session.get(name), rng.normal(size=session.shape(name))
            h, after = 1e-6 if name == "turn" else 1e-5, []
            for sign in (1, -1):
                session.set(name, start + sign * h * direction)
                after.append((session.forward("back")["color"] * g).sum())
            session.set(name, start)
            slope = (after[0] - after[1]) / (2 * h)
            assert abs(slope) > 1e-4 and slope == pytest.approx((x * direction).sum(), rel=2e-3 if name == "turn" else 1e-4), name


def test_a_black_sky_has_the_gradient_of_light_that_may_come():
    """Of the map central differences; roughness, strength and rotation change nothing there."""
    s, rng = Scene(orbit(1, [20], 2.6, 40, (12, 10))), np.random.default_rng(7)
    around = Environment(s.parameter("sky", np.zeros((16, 16, 3)), low=0.0, kind="image"), s.parameter("turn", [0.2, -0.5, 0.1]),
                         s.parameter("strength", 0.8))
    s.add(icosphere(1, 0.8), material=PBR((0.8, 0.6, 0.4), s.parameter("roughness", 0.35), 0.7, environment=around))
    s.surroundings = around
    s.vjp("back", list(s.parameters), color=s.frame().color)
    with ReferenceSession(s.program) as exact:
        g, direction = rng.normal(size=exact.shape("back.color.grad")), rng.normal(size=(16, 16, 3))
        assert (exact.forward("back")["color"] == 0).all()
        one, after = exact.backward("back", color=g), []
        assert all((one[name] == 0).all() for name in ("turn", "strength", "roughness"))
        for sign in (1, -1):
            exact.set("sky", sign * 1e-3 * direction)
            after.append((exact.forward("back")["color"] * g).sum())
        assert (after[0] - after[1]) / 2e-3 == pytest.approx((one["sky"] * direction).sum(), rel=1e-8)


def test_the_device_agrees_with_the_reference(gpu):
    s, rng = scene(), np.random.default_rng(6)
    with ReferenceSession(s.program) as exact, runtime.load(gpu.compile(s.program), gpu.device) as session:
        g = rng.normal(size=session.shape("back.color.grad"))
        np.testing.assert_allclose(session.forward("back")["color"], exact.forward("back")["color"], atol=2e-4)
        one, two = exact.backward("back", color=g), session.backward("back", color=g)
        for name, x in one.items():
            assert np.linalg.norm(two[name] - x) <= 2e-3 * np.linalg.norm(x), name
    gpu.silent()


def test_a_sky_and_a_roughness_are_found_together(gpu):
    """From grey, both: the picture's loss falls, and the roughness comes home."""
    s = Scene(orbit(3, [20, -15, 40], 2.6, 40, (64, 48)))
    around = Environment(s.parameter("sky", mapped(16), low=0.0, kind="image"))
    s.add(icosphere(3, 0.8), material=PBR((0.9, 0.85, 0.8), s.parameter("roughness", 0.3, low=0.05, high=1.0), 1.0, environment=around))
    f = s.frame()
    photo = s.input("photo", np.zeros((3, 48, 64, 3)))
    s.phase("fit", 60, {"sky": Adam(0.05), "roughness": Adam(0.02)}, color=l2(f.color, photo))
    s.output("look", color=f.color)
    with runtime.load(gpu.compile(s.program), gpu.device) as session:
        session.set("photo", session.get("look.color"))
        session.set("sky", np.full((16, 16, 3), 0.8))
        session.set("roughness", 0.6)
        first = session.loss()
        session.step(60)
        assert session.loss() < first / 20 and abs(float(session.get("roughness")) - 0.3) < 0.15
        assert session.get("sky").min() >= 0
        before = session.report()["runs"]
        session.step(5)
        assert [k for k, x in session.report()["runs"].items() if x != before[k]] == ["fit"]  # places are sorted once
    gpu.silent()


def test_a_resting_sky_is_filtered_once(gpu):
    """With gradient none the levels are prepared: a step of roughness alone runs none of the filter."""
    s = Scene(orbit(1, [20], 2.6, 40, (32, 24)))
    around = Environment(mapped(16))
    s.add(icosphere(2, 0.8), material=PBR(0.8, s.parameter("roughness", 0.3, low=0.05, high=1.0), 1.0, environment=around))
    s.phase("fit", 5, {"roughness": Adam(0.01)}, color=l2(s.frame().color, s.input("photo", np.zeros((1, 24, 32, 3)))))
    with runtime.load(gpu.compile(s.program), gpu.device) as session:
        assert len(session.plans["fit"]["stages"]) <= 4
        session.step(3)
        assert np.isfinite(session.loss())


def test_the_background_is_what_cameras_see(gpu):
    """Where nothing is in front, a pixel has the radiance along its ray; black skies are black and have finite gradients."""
    cams = orbit(2, [20, -65], 3.0, 60, (48, 40))
    s = Scene(cams)
    around = Environment(s.parameter("sky", mapped(64), low=0.0, kind="image"))
    s.add(icosphere(1, 0.2), material=PBR(0.8, 0.3, 0.5, environment=around))
    s.surroundings = around
    f = s.frame()
    s.output("look", color=f.color, alpha=f.alpha, ray=f.ray)
    s.vjp("back", ["sky"], color=f.color)
    with runtime.load(gpu.compile(s.program), gpu.device) as session:
        look = {k: session.get(f"look.{k}") for k in ("color", "alpha", "ray")}
        session.set("sky", np.zeros((64, 64, 3)))
        assert (session.get("look.color") == 0).all()
        gradient = session.backward("back", color=np.ones(session.shape("back.color.grad")))["sky"]
        assert np.isfinite(gradient).all() and gradient.min() >= 0 and gradient.max() > 0
    gpu.silent()
    for view, c in enumerate(cams):
        y, x = np.mgrid[:40, :48] + 0.5
        ray = unit(np.stack([(x - c.cx) / c.fx, -(y - c.cy) / c.fy, -np.ones_like(x)], -1) @ c.world_to_camera[:3, :3])
        np.testing.assert_allclose(look["ray"][view], ray, atol=2e-6)
        free = look["alpha"][view] == 0
        error = np.abs(look["color"][view] - sky(ray)) / sky(ray)
        assert free.mean() > 0.8 and np.median(error[free]) < 0.01 and error[free].max() < 0.15


# Files

def runs(b):
    """Bytes packed by OpenEXR's RLE: runs, and stretches of up to nine bytes as they are."""
    out, k = b"", 0
    while k < len(b):
        n = 1
        while k + n < len(b) and b[k + n] == b[k] and n < 100:
            n += 1
        if n > 2:
            out, k = out + bytes([n - 1, b[k]]), k + n
        else:
            out, k = out + bytes([256 - len(b[k:k + 9])]) + b[k:k + 9], k + len(b[k:k + 9])
    return out


def exr(image, compression, half):
    """An OpenEXR file of scan lines, B, G, R."""
    h, w, _ = image.shape
    kind = np.dtype("<f2" if half else "<f4")
    channels = b"".join(c + b"\0" + struct.pack("<iB3xii", 1 if half else 2, 0, 1, 1) for c in (b"B", b"G", b"R")) + b"\0"
    box = struct.pack("<4i", 0, 0, w - 1, h - 1)
    head = b"\x76\x2f\x31\x01\x02\0\0\0"
    for name, type_, value in ((b"channels", b"chlist", channels), (b"compression", b"compression", bytes([compression])),
                               (b"dataWindow", b"box2i", box), (b"displayWindow", b"box2i", box), (b"lineOrder", b"lineOrder", b"\0")):
        head += name + b"\0" + type_ + b"\0" + struct.pack("<i", len(value)) + value
    head += b"\0"
    lines = 16 if compression == 3 else 1
    chunks = []
    for y in range(0, h, lines):
        raw = b"".join(image[row, :, c].astype(kind).tobytes() for row in range(y, min(y + lines, h)) for c in (2, 1, 0))
        if compression:
            b = np.frombuffer(raw, np.uint8)
            b = np.concatenate([b[0::2], b[1::2]]).astype(int)
            b = np.append(b[:1], (np.diff(b) + 128) & 255).astype(np.uint8).tobytes()
            packed = zlib.compress(b) if compression > 1 else runs(b)
            raw = packed if len(packed) < len(raw) else raw
        chunks.append(struct.pack("<ii", y, len(raw)) + raw)
    at = len(head) + 8 * len(chunks)
    offsets = np.cumsum([at, *(len(c) for c in chunks[:-1])])
    return head + struct.pack(f"<{len(chunks)}Q", *offsets) + b"".join(chunks)


def hdr_runs(image):
    """A Radiance picture in runs, as writers make it."""
    flat = write_hdr(image)
    head, pixels = flat[:flat.index(b"+X") + 2] + flat[flat.index(b"+X") + 2:].split(b"\n")[0] + b"\n", None
    pixels = np.frombuffer(flat[len(head):], np.uint8).reshape(*image.shape[:2], 4)
    body = b""
    for row in pixels:
        body += bytes([2, 2, len(row) >> 8, len(row) & 255])
        for c in range(4):
            values, k = row[:, c], 0
            while k < len(values):
                run = 1
                while k + run < len(values) and values[k + run] == values[k] and run < 100:
                    run += 1
                body += bytes([128 + run, values[k]]) if run > 2 else bytes([1, values[k]])
                k += run if run > 2 else 1
    return head + body


WIDE = np.abs(np.random.default_rng(7).lognormal(0, 2, (20, 40, 3)))
WIDE[3:9] = 0.25  # runs
FILES = {"hdr": (write_hdr, 0.01), "hdr in runs": (hdr_runs, 0.01), "exr float": (lambda x: exr(x, 0, False), 1e-6),
         "exr half ZIP": (lambda x: exr(x, 3, True), 1e-3), "exr float ZIPS": (lambda x: exr(x, 2, False), 1e-6),
         "exr half RLE": (lambda x: exr(x, 1, True), 1e-3)}


@pytest.mark.parametrize("kind", FILES, ids=lambda k: k.replace(" ", "_"))
def test_panoramas_are_read(kind, tmp_path):
    make, tolerance = FILES[kind]
    path = tmp_path / f"sky.{kind.split()[0]}"
    data = make(WIDE)
    path.write_bytes(data)
    found = load_panorama(path)
    assert np.abs(found - WIDE).max(-1).max() <= tolerance * WIDE.max() and found.shape == WIDE.shape
    np.testing.assert_allclose(found.max(-1), WIDE.max(-1), rtol=max(tolerance, 1e-6) * 1.5)
    rng = np.random.default_rng(8)
    for _ in range(60):  # broken ones are named, whatever is broken
        broken = bytearray(data[:rng.integers(1, len(data))] if rng.uniform() < 0.5 else data)
        for k in rng.integers(0, len(broken), 3):
            broken[k] = rng.integers(0, 256)
        path.write_bytes(broken)
        try:
            load_panorama(path)
        except InputError as error:
            assert "panorama" in str(error)


@pytest.mark.parametrize("compression", ["PIZ", "PXR24", "DWAA", "DWAB"])
def test_what_the_reader_does_not_unpack_a_library_reads(compression, tmp_path):
    """Against the numbers that went in: DWA loses up to about two percent, PXR24 8 bits of 32."""
    library = pytest.importorskip("OpenEXR", reason="OpenEXR is not installed: pip install 'dressi_edge[exr]'")
    y, x = np.mgrid[:40, :80]
    wide = np.stack([np.exp(np.sin(x / 9)), 1 + y / 10, 0.5 + 0 * x], -1).astype(np.float32)
    header = {"compression": getattr(library, f"{compression}_COMPRESSION"), "type": library.scanlineimage}
    library.File(header, {"RGB": wide}).write(str(tmp_path / "sky.exr"))
    np.testing.assert_allclose(load_panorama(tmp_path / "sky.exr"), wide, rtol=0.03 if "DWA" in compression else 1e-4)
    (tmp_path / "half.exr").write_bytes((tmp_path / "sky.exr").read_bytes()[:-200])
    with pytest.raises(InputError, match="panorama"):
        load_panorama(tmp_path / "half.exr")


@pytest.mark.parametrize("change, what", [
    ((b"compression\0\1\0\0\0\0", b"compression\0\1\0\0\0\4"), "compression PIZ, which the package OpenEXR reads"),
    ((b"compression\0\1\0\0\0\0", b"compression\0\1\0\0\0\x0b"), "compression number 11"),
    ((b"\x76\x2f\x31\x01\x02\0", b"\x76\x2f\x31\x01\x02\x02"), "tiles, which the package OpenEXR reads"),
    ((b"\x76\x2f\x31\x01\x02\0", b"\x76\x2f\x31\x01\x02\x10"), "several parts or deep data"),
])
def test_without_the_library_the_refusal_names_it(change, what, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "OpenEXR", None)
    data = exr(WIDE, 0, False)
    assert change[0] in data
    (tmp_path / "sky.exr").write_bytes(data.replace(*change))
    with pytest.raises(InputError, match=what) as refused:
        load_panorama(tmp_path / "sky.exr")
    assert "parts" in what or "pip install 'dressi_edge[exr]'" in str(refused.value)


def test_a_picture_of_8_bits_is_taken_with_a_note(tmp_path):
    Image.fromarray(np.full((10, 20, 3), 188, np.uint8)).save(tmp_path / "sky.png")
    with pytest.warns(InputWarning, match="is no HDR picture: radiance above its white is lost"):
        found = load_panorama(tmp_path / "sky.png")
    np.testing.assert_allclose(found, 0.503, atol=2e-3)


def with_texel(value):
    wide = np.ones((8, 16, 3))
    wide[2, 5, 1] = value
    return wide


@pytest.mark.parametrize("make, what", [
    (lambda: checked(with_texel(np.nan), "panorama x"), "panorama x has 1 NaN texels, the first at row 2, column 5"),
    (lambda: checked(with_texel(np.inf), "panorama x"), "1 infinite texels"),
    (lambda: checked(with_texel(-0.1), "panorama x"), "1 negative texels"),
    (lambda: checked(np.ones((8, 8, 3)), "panorama x"), r"shape \(8, 8, 3\); \(height, 2 height, 3\) is needed"),
    (lambda: octahedral(np.ones((8, 16, 3)), 50), "50 texels a side; allowed: 16 32"),
    (lambda: octahedral(np.ones((8, 8, 3)), 16), "the whole sphere"),
    (lambda: Environment(np.ones((16, 32, 3))), "vec3 image of n x n texels"),
    (lambda: Environment(-np.ones((16, 16, 3))), "finite and not negative"),
    (lambda: Environment(np.ones((16, 16, 3)), gradient="some"), "gradient is 'some'; exact or none"),
    (lambda: Environment(np.ones((16, 16, 3)), rotation=(1, 2)), r"rotation is \(1, 2\)"),
    (lambda: Environment(np.ones((16, 16, 3)), strength="bright"), "strength is 'bright'"),
    (lambda: PBR(0.5, environment=np.ones((16, 16, 3))), "an Environment is needed"),
])
def test_what_is_wrong_is_named(make, what):
    with warnings.catch_warnings(), pytest.raises((InputError, GraphError), match=what):
        warnings.simplefilter("error")
        make()


def test_a_sum_over_all_surfaces_reaches_every_texel():
    """The transpose of the filter is exact: the map's gradient adds to the sum of all weights."""
    rng = np.random.default_rng(9)
    at, roughness = directions(rng, 80)[None], rng.uniform(0, 1, (1, 80, 1))
    given = Given(sky=mapped(16))
    light = Environment(given.nodes["sky"]).specular(constant(at), constant(roughness))
    g, = evaluate(gradients(total(dot(light, constant(np.ones((1, 80, 3))))), [given.nodes["sky"]]), given.feed)
    np.testing.assert_allclose(g.sum((0, 1)), 80, rtol=1e-9)
    assert (g >= 0).all() and (g > 0).mean() > 0.9
