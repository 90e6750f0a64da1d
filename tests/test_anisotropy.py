"""Anisotropy: samples along the longer axis of what a pixel sees of a texture."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from test_mips import check_gradient, fine, fp32, picture, scene_with, tilted

from dressi_edge import runtime
from dressi_edge.cache.errors import InputError, InputWarning
from dressi_edge.compiler import Program
from dressi_edge.compiler.graph.functions import compose, constant
from dressi_edge.compiler.graph.ir import image
from dressi_edge.compiler.graph.reference import evaluate
from dressi_edge.compiler.graph.reference_session import ReferenceSession
from dressi_edge.compiler.io.images import srgb_to_linear
from dressi_edge.compiler.io.materials import Material, Part, TextureMap
from dressi_edge.compiler.io.meshes import load_parts
from dressi_edge.compiler.io.textures import Picture
from dressi_edge.compiler.io.writers import save_png
from dressi_edge.compiler.passes.blocks import TOLD
from dressi_edge.compiler.render.texture import probes
from dressi_edge.compiler.scene import (
    Adam,
    HardSoftRas,
    Loss,
    Mesh,
    Outline,
    Problem,
    Scene,
    Softness,
    Texture,
    Unlit,
    encode_srgb,
    l2,
    load_mesh,
    load_views,
    look_at,
    results,
    save_parts,
    sphere,
)
from dressi_edge.compiler.scene.job import parse_job

pytest_plugins = ["gpu"]


def test_probes_share_the_longer_axis_of_the_ellipse(gpu):
    """Against the singular values of the derivatives, in float64; circles, lines and what lies far away among them."""
    rng, (w, h), count = np.random.default_rng(0), (64, 32), 4
    a, b = fp32(rng.normal(size=(19, 23, 2)) * 10.0 ** rng.uniform(-6, 6, (19, 23, 1))), fp32(rng.normal(size=(19, 23, 2)))
    b[:5] = a[:5, :, ::-1] * (-w / h, h / w)  # at right angles and as long: circles
    b[5:8] = a[5:8] * 0.5
    a[8, :3], b[8, :3] = 0.0, 0.0
    p = Program()
    apart, lod = probes(p.input("a", picture("vec2")), p.input("b", picture("vec2")), image(w, h), count)
    p.plan("p", {}, {"apart": (apart, picture("vec2")), "lod": (lod, picture("float"))})
    _, s, v = np.linalg.svd(np.stack([a * (w, h), b * (w, h)], -2))
    longest, other = s[..., 0], s[..., 1]
    expected = np.log2(np.maximum(np.sqrt((other ** 2 + (longest / count) ** 2) / 2), 1e-30))
    exact, device = evaluate([apart, lod], {"a": a, "b": b}), gpu.run(p, {"a": a, "b": b})
    for apart, lod, tolerance in ((*exact, 1e-6), (device["apart"], device["lod"], 2e-3)):
        lod = lod.reshape(19, 23)
        seen = np.ones((19, 23), bool)
        seen[8, :3] = False  # nothing moves: any level below 0
        np.testing.assert_allclose(lod[seen], expected[seen], atol=tolerance)
        assert (lod[8, :3] < -20).all()
        texels = apart * (w, h) * count
        np.testing.assert_allclose(np.linalg.norm(texels, axis=-1), longest, rtol=tolerance, atol=1e-12)
        clear = longest > 1.2 * other
        along = abs((texels * v[..., 0, :]).sum(-1)) / np.maximum(longest, 1e-30)
        np.testing.assert_allclose(along[clear & seen], 1.0, atol=tolerance)


def test_a_plane_at_a_slant_is_neither_blurred_nor_does_it_alias(gpu, tmp_path):
    """Root mean square difference from 64 samples a pixel: 4 probes have less than 0.6 of that of one."""
    by = 8

    def draw(size, **how):
        mesh, cameras = tilted(size)
        scene = Scene(cameras)
        scene.add(mesh, material=Unlit(Texture(constant(fine(256)), **how)))
        seen = scene.frame(HardSoftRas(r=1.0, delta=0.0))
        scene.output("o", color=seen.color, mask=seen.mask)
        scene.compile("lavapipe", tmp_path / "a.dressi")
        with runtime.load(tmp_path / "a.dressi", gpu.device) as session:
            return session.get("o.color")[0].astype(float), session.get("o.mask")[0]

    big, hit = draw((80 * by, 60 * by))
    truth, inside = big.reshape(60, by, 80, by, 3).mean((1, 3)), hit.reshape(60, by, 80, by).min((1, 3)) > 0
    one, four = (np.sqrt(((draw((80, 60), mips=True, anisotropy=n)[0] - truth)[inside] ** 2).mean()) for n in (1, 4))
    assert four < 0.6 * one, (four, one)
    gpu.silent()


def test_the_gradient_through_probes_is_exact(gpu, tmp_path):
    """Device against float64, and float64 against central differences along a direction."""
    how = {"wrap": ("repeat", "clamp"), "transform": ((2.0, 0.1, 0.2), (0.0, 1.5, 0.0))}
    scene = scene_with(lambda t: Texture(t, mips=True, anisotropy=3, **how), cameras=1)
    check_gradient(gpu, scene, tmp_path, 2e-4)


def test_all_samples_of_a_pixel_are_in_one_list(gpu, tmp_path):
    """Moments are then kept by blocks; what is kept of places that rest changes no bit, nor does that."""
    fits = []
    for how in ({"sparse_texels": 1}, {}, {"cache": False}):
        scene = scene_with(lambda t: Texture(t, mips=True, anisotropy=4), cameras=2)
        seen = scene.frame(HardSoftRas(r=1.0, delta=0.0))
        photo = scene.input("photo", np.random.default_rng(1).random((2, *seen.cell[::-1], 3)))
        scene.phase("fit", 10, {"texture": Adam(0.05)}, color=l2(seen.color, photo))
        d = scene.compile("lavapipe", tmp_path / "a.dressi", **how)
        with runtime.load(tmp_path / "a.dressi", gpu.device) as session:
            session.step(5, "fit")
            fits.append(session.get("texture"))
        if how.get("sparse_texels"):
            assert d["meta"]["texels"]["fit"]["texture"] == TOLD
    np.testing.assert_array_equal(fits[0], fits[1])
    np.testing.assert_array_equal(fits[0], fits[2])
    gpu.silent()


def test_what_anisotropy_cannot_be_is_named():
    t = constant(np.zeros((8, 8, 3)))
    for wrong in (0, 17, 2.0, True, None, "4"):
        with pytest.raises(InputError, match="a whole number from 1 to 16 is needed"):
            Texture(t, mips=True, anisotropy=wrong)
    with pytest.raises(InputError, match="has no mips; give it mips=True, or 1"):
        Texture(t, anisotropy=2)


# Several parts and views


def standing(at, uvs):
    """A wall of two faces before the floor, a corner of it towards the eye, with these texture coordinates of its corners."""
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    return Mesh(np.array([[0.0, 0, 0], [0.5, 0, -3.0], [0.5, 0.8, -3.0], [0, 0.8, 0]]) + at, faces, np.asarray(uvs, float), faces)


def crowd(cameras):
    """A floor with mirrored coordinates, 3 samples a pixel; a ball, mips alone; walls that share the ball's texture or have the floor's
    with other settings; one with all coordinates at a point, one on a line; textures are parameters."""
    scene, rng, (floor, _) = Scene(cameras, background=(0.2, 0.3, 0.5)), np.random.default_rng(2), tilted()
    ground = scene.parameter("ground", 0.1 + 0.8 * fine(64)[:48], 0.0, 1.0, kind="image")
    waves = np.sin(np.arange(40)[:, None, None] * [1.1, 0.7, 0.4] + rng.normal(size=(40, 56, 3)))
    skin = scene.parameter("skin", 0.5 + 0.4 * waves, 0.0, 1.0, kind="image")
    scene.add(replace(floor, uvs=floor.uvs * [-1.7, 1.0]), material=Unlit(Texture(ground, ("mirror", "repeat"), mips=True, anisotropy=3)))
    ball = sphere(162, 0.35)
    scene.add(replace(ball, positions=ball.positions + [0.3, 0.4, 0.3]), material=Unlit(Texture(skin, mips=True)), name="ball")
    square = np.array([[0, 1], [1, 1], [1, 0], [0, 0.0]])
    for k, (at, uvs, texture, how) in enumerate([
            ([-0.9, 0, 0.9], square, skin, {"mips": True, "anisotropy": 4}), ([1.1, 0, 0.9], square[::-1], ground, {"mips": True}),
            ([-0.6, 0, 0.2], square, ground, {}), ([0.8, 0, 0.2], square * 0.0 + 0.4, skin, {"mips": True, "anisotropy": 2}),
            ([-0.2, 0, -0.8], square * [0, 1] + 0.3, skin, {"mips": True, "anisotropy": 2})]):
        scene.add(standing(at, uvs), material=Unlit(Texture(texture, **how)), name=f"wall{k}")
    return scene


def two(size):
    return [look_at(eye, [0, 0.2, -0.5], [0, 1, 0], 50, *size) for eye in ([0.3, 0.6, 2.5], [-0.5, 0.4, 2.4])]


@pytest.mark.full
def test_parts_that_sample_in_different_ways_stand_in_one_picture(gpu, tmp_path):
    """Picture and gradients of both textures: device against float64, and float64 against central differences."""
    scene = crowd(two((60, 44))[:1])
    scene.vjp("render", ["ground", "skin"], color=scene.frame(HardSoftRas(r=1.0, delta=0.0)).color)
    scene.compile("vulkan_min", tmp_path / "a.dressi")
    rng = np.random.default_rng(0)
    with ReferenceSession(scene.program) as exact, runtime.load(tmp_path / "a.dressi", gpu.device) as session:
        wanted, picture = (x.forward("render")["color"] for x in (exact, session))
        off = abs(picture - wanted).max(-1)
        assert (off > 2e-3).mean() < 2e-3 and np.median(off) < 1e-5  # what lies on an edge between two faces may be either's
        weights = rng.normal(size=wanted.shape) * (off < 2e-3)[..., None]
        by = [x.backward("render", color=weights) for x in (exact, session)]
        start = {name: exact.get(name) for name in by[0]}
        for name, g in by[0].items():
            assert np.isfinite(by[1][name]).all() and np.linalg.norm(by[1][name] - g) < 3e-4 * np.linalg.norm(g), name
            direction, ends = rng.normal(size=g.shape), []
            for sign in (1, -1):
                exact.set(name, start[name] + sign * 1e-4 * direction)
                ends.append((exact.forward("render")["color"] * weights).sum())
            exact.set(name, start[name])
            assert (ends[0] - ends[1]) / 2e-4 == pytest.approx((g * direction).sum(), rel=1e-7), name
    gpu.silent()


def test_a_view_among_others_has_the_bits_of_one_alone(gpu, tmp_path):
    """Pictures of 333x217, of two views together and of each alone; a wall whose coordinates are one point is one colour."""

    def draw(cameras):
        scene = crowd(cameras)
        seen = scene.frame(HardSoftRas(r=1.0, delta=0.0))
        scene.output("look", color=seen.color, part=seen.part)
        scene.compile("lavapipe", tmp_path / "a.dressi")
        with runtime.load(tmp_path / "a.dressi", gpu.device) as session:
            return session.get("look.color"), session.get("look.part")

    cameras = two((333, 217))
    both, part = draw(cameras)
    for k, camera in enumerate(cameras):
        np.testing.assert_array_equal(draw([camera])[0][0], both[k])
    point = both[part == 5]  # wall3
    assert len(point) > 300 and np.ptp(point, 0).max() < 1e-5
    gpu.silent()


# Jobs

SIZE = (80, 60)
FLOOR = {"path": "floor.glb"}
HOW = {"mips": True, "anisotropy": 2}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A floor to the horizon with a fine texture, as a file, and two photographs of noise with their cameras."""
    folder, rng, (mesh, (one,)) = tmp_path_factory.mktemp("floor"), np.random.default_rng(1), tilted(SIZE)
    mesh = replace(mesh, texture=fine(128))
    other = look_at([-0.4, 0.5, 2.5], [0, 0, -0.5], [0, 1, 0], 50, *SIZE)
    save_parts(folder / "floor.glb", [Part("floor", mesh, Material("m", base_texture=TextureMap(Picture("t", None)), unlit=True))])
    frames = []
    for k, camera in enumerate((one, other)):
        photo = rng.random((*SIZE[::-1], 4))
        photo[..., 3] = np.arange(SIZE[1])[:, None] > 5
        save_png(folder / f"{k}.png", photo)
        frames.append({"file_path": f"{k}.png", "transform_matrix": camera.camera_to_world.tolist()})
    (folder / "transforms.json").write_text(json.dumps({"fl_x": one.fx, "fl_y": one.fy, "cx": one.cx, "cy": one.cy, "w": SIZE[0],
                                                        "h": SIZE[1], "frames": frames}))
    return folder


def job(kind, **how):
    """A job of the floor as TOML reads it: of one mesh, of a part or of a whole file; how: its texture is sampled."""
    name = "texture" if kind == "mesh" else "floor.texture"
    head = {"mesh": {"mesh": FLOOR, "render": how}, "part": {"part": [{"name": "floor", **FLOOR, "material": how}]},
            "scene": {"scene": {**FLOOR, **how}}}[kind]
    return {**head, "views": {"transforms": "."},
            "phase": [{"name": "fit", "steps": 3, "optimize": {name: {"rate": 0.05}}, "loss": [{"kind": "color"}]}]}


def by_hand(kind, folder, **how):
    """The same in Python."""
    views, mesh = load_views(folder), load_mesh(folder / "floor.glb")
    if kind == "mesh":
        problem = Problem(mesh, views, normals="file" if mesh.normals is not None else "smooth", **how)
        problem.phase("fit", 3, {"texture": Adam(0.05)}, [Loss("color")])
        problem.render("render", Softness(1.0, delta=0.0))
        return problem
    lit = kind == "scene"
    scene = Scene(views.cameras, encode=encode_srgb if lit else None)
    texture = scene.parameter("floor.texture", srgb_to_linear(mesh.texture) if lit else mesh.texture, 0.0, 1.0, kind="image")
    scene.add(mesh, material=Unlit(Texture(texture, **{"wrap": mesh.wrap, **how})), name="floor")
    seen, target = scene.frame(Outline(r=2.0)), scene.input("targets", views.images)
    scene.phase("fit", 3, {"floor.texture": Adam(0.05)}, color=l2(seen.color, target.xyz * target.w))
    sharp = scene.frame(HardSoftRas(r=1.0, delta=0.0))
    scene.output("render", color=compose(sharp.color, sharp.alpha))
    return scene


@pytest.mark.parametrize("kind", [pytest.param("mesh", marks=pytest.mark.full), "part", "scene"])
def test_a_job_samples_as_it_says(gpu, folder, tmp_path, kind):
    """Through a bundle: the bits of the same scene in Python, after steps, too."""

    def found(problem, name):
        problem.compile("lavapipe", tmp_path / name)
        with runtime.load(tmp_path / name, gpu.device) as session:
            start = session.get("render.color")
            session.step(3, "fit")
            return start, session.get("texture" if kind == "mesh" else "floor.texture"), session.get("render.color")

    said, wanted = parse_job(job(kind, **HOW), folder / "job.toml"), by_hand(kind, folder, **HOW)
    for a, b in zip(found(said, "job.dressi"), found(wanted, "hand.dressi"), strict=True):
        np.testing.assert_array_equal(a, b)
    gpu.silent()


WHERE = {"mesh": "render", "part": r"part\[0\].material", "scene": "scene"}


@pytest.mark.parametrize("kind", WHERE)
def test_a_job_s_anisotropy_that_cannot_be_is_named(folder, kind):
    for wrong in (0, 17, 1000, 3.5, "4", True):
        with pytest.raises(InputError, match=f"{WHERE[kind]}.anisotropy is {wrong!r}; a whole number from 1 to 16 is needed"):
            parse_job(job(kind, mips=True, anisotropy=wrong), folder / "job.toml")
    with pytest.raises(InputError, match=f"{WHERE[kind]}: anisotropy is 4, but there are no mips; set mips = true, or drop it"):
        parse_job(job(kind, mips=False, anisotropy=4), folder / "job.toml")
    with pytest.raises(InputError, match=f"{WHERE[kind]}.mips is 1; true or false is needed"):
        parse_job(job(kind, mips=1), folder / "job.toml")


def test_one_pixel_a_texel_is_not_for_mips(folder):
    with pytest.raises(InputError, match="render: texture_grad is inverse_uv, which a texture with mips does not have; use exact"):
        parse_job(job("mesh", mips=True, texture_grad="inverse_uv"), folder / "job.toml")


@pytest.mark.parametrize("kind, wrap", [("mesh", ["repeat", "clamp"]), ("part", ["clamp", "mirror"]), ("part", "mirror")])
def test_a_job_s_texture_goes_on_as_it_says(gpu, folder, tmp_path, kind, wrap):
    """Through a bundle: the bits of the same scene in Python; and what is written of it goes on in the same way."""
    pair = (wrap, wrap) if isinstance(wrap, str) else tuple(wrap)
    found = []
    for k, problem in enumerate((parse_job(job(kind, wrap=wrap), folder / "job.toml"),
                                 by_hand(kind, folder, wrap=wrap if isinstance(wrap, str) else pair))):
        problem.compile("lavapipe", tmp_path / f"{k}.dressi")
        with runtime.load(tmp_path / f"{k}.dressi", gpu.device) as session:
            session.step(2, "fit")
            found.append((session.get("texture" if kind == "mesh" else "floor.texture"), session.get("render.color")))
            results.save_result(session, tmp_path / f"{k}.glb")
            written, = load_parts(tmp_path / f"{k}.glb")
            assert written.material.base_texture.wrap == pair
            with pytest.warns(InputWarning, match="but OBJ knows repeat or clamp, alike for u and v; repeat is written"):
                results.save_result(session, tmp_path / f"{k}.obj")
    for a, b in zip(*found, strict=True):
        np.testing.assert_array_equal(a, b)
    gpu.silent()


@pytest.mark.parametrize("kind", ["mesh", "part"])
def test_a_job_s_wrap_that_cannot_be_is_named(folder, kind):
    words = "allowed: repeat clamp mirror"
    for wrong, said in (("mirorr", rf"did you mean mirror\? {words}"), (3, words), ("", words), ({}, words)):
        with pytest.raises(InputError, match=rf"{WHERE[kind]}.wrap is {re.escape(repr(wrong))}; {said}"):
            parse_job(job(kind, wrap=wrong), folder / "job.toml")
    for wrong in ([], ["repeat"], ["repeat"] * 3, ["repeat", "border"], ["clamp", 1], [["clamp"], "clamp"]):
        with pytest.raises(InputError, match=rf"{WHERE[kind]}.wrap is {re.escape(repr(wrong))}; a list of two is needed, for u and"):
            parse_job(job(kind, wrap=wrong), folder / "job.toml")


def test_a_file_s_own_wrap_stays_and_a_problem_s_is_checked(folder):
    mesh, views = replace(load_mesh(folder / "floor.glb"), wrap="clamp"), load_views(folder)
    assert Problem(mesh, views).wrap == "clamp" and Problem(mesh, views, wrap=["mirror", "mirror"]).wrap == "mirror"
    for wrong in ("", "border", ("repeat",), 3):
        with pytest.raises(InputError, match="wrap is .*; repeat clamp mirror are allowed, or a pair of them for u and v"):
            Problem(mesh, views, wrap=wrong)
