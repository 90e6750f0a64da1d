"""`Binned` with materials that are not linear on faces: what the heaviest faces of a pixel show is worked out there."""
import dataclasses

import brute_force_binned
import numpy as np
import pytest
from jobs import TINY, command, write_job
from test_binned import BACK, RANGE, settings

from dressi_edge import runtime
from dressi_edge.cache.errors import InputError
from dressi_edge.compiler.graph.functions import compose
from dressi_edge.compiler.graph.ir import topological
from dressi_edge.compiler.graph.reference_session import ReferenceSession
from dressi_edge.compiler.io.meshes import load_mesh
from dressi_edge.compiler.scene import (
    PBR,
    Adam,
    Binned,
    Lambert,
    Light,
    Mesh,
    NormalMap,
    Scene,
    Texture,
    Unlit,
    Vertex,
    icosphere,
    l2,
    orbit,
    pear,
)
from dressi_edge.compiler.scene.job import load_job

pytest_plugins = ["gpu"]
PLAIN = Binned(2.5, 0.4, 0.02, depth=RANGE, layers=8)
KINDS = {"plain": PLAIN, "squared": Binned(2.5, 0.8, 0.02, depth=RANGE, squared=True, layers=8),
         "over": dataclasses.replace(PLAIN, over=True), "hard": dataclasses.replace(PLAIN, hard=True)}
SIZE = 60, 44
CAMERAS = orbit(2, [20, -15], 3.0, 36, SIZE)
TEXTURE = 0.5 + 0.5 * np.sin(np.arange(6 * 7 * 3).reshape(6, 7, 3) ** 1.5)


def octahedron():
    """Eight faces, of which a pixel can see no more; each with texture coordinates of its own."""
    p = np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]) * (0.9, 0.7, 0.8)
    faces = [(a, b, c) if s > 0 else (a, c, b) for a, x in ((0, 1), (1, -1)) for b, y in ((2, 1), (3, -1)) for c, z in ((4, 1), (5, -1))
             for s in (x * y * z,)]
    uvs = np.random.default_rng(4).uniform(-0.3, 1.3, (24, 2))
    return Mesh(p, np.array(faces), uvs=uvs, uv_faces=np.arange(24).reshape(8, 3))


def sampled(texture, uv):
    """Bilinear, repeated, with centres at (k + 0.5) / size."""
    h, w = texture.shape[:2]
    x, y = uv[..., 0] * w - 0.5, uv[..., 1] * h - 0.5
    i, j = np.floor(x).astype(int), np.floor(y).astype(int)
    a, b = (x - i)[..., None], (y - j)[..., None]
    at = [texture[(j + n) % h, (i + m) % w] for n in (0, 1) for m in (0, 1)]
    return (at[0] * (1 - a) + at[1] * a) * (1 - b) + (at[2] * (1 - a) + at[3] * a) * b


def clip_of(camera, positions):
    x, y, z = (camera.world_to_camera @ np.column_stack([positions, np.ones(len(positions))]).T)[:3]
    w, (width, height) = -z, SIZE
    depth = camera.far * (w - camera.near) / (camera.far - camera.near)
    return np.stack([2 * (camera.cx * w + camera.fx * x) / width - w, 2 * (camera.cy * w - camera.fy * y) / height - w, depth, w], 1)


def textured(kind, mesh=None, material=None, cameras=CAMERAS):
    mesh = mesh or octahedron()
    s = Scene(cameras, BACK)
    at, texture = s.parameter("vertices", mesh.positions), s.parameter("texture", TEXTURE, kind="image")
    s.add(mesh, at, (material or (lambda texture: Unlit(Texture(texture))))(texture), name="thing")
    return s, s.frame(kind)


@pytest.mark.parametrize("kind", KINDS)
def test_a_textured_picture_is_that_of_the_formulas(kind, gpu):
    s, f = textured(KINDS[kind])
    s.output("look", color=f.color, alpha=f.alpha)
    mesh = octahedron()

    def shade(k, weights):
        return sampled(TEXTURE, weights @ mesh.uvs[mesh.uv_faces[k]])

    with ReferenceSession(s.program) as exact, runtime.load(gpu.compile(s.program), gpu.device) as d:
        found, device, alpha = exact.get("look.color"), d.get("look.color"), d.get("look.alpha")
    gpu.silent()
    for view, camera in enumerate(CAMERAS):
        expected = brute_force_binned.render(clip_of(camera, mesh.positions), mesh.faces, SIZE, camera.near, colors=shade, background=BACK,
                                             **settings(KINDS[kind]))
        sure = expected.margin > 1e-3
        assert sure.mean() > 0.97 and 0.1 < (expected.alpha > 0.5).mean() < 0.9
        np.testing.assert_allclose(found[view][sure], expected.color[sure], rtol=1e-6, atol=1e-7)
        np.testing.assert_allclose(device[view][sure], expected.color[sure], rtol=1e-3, atol=1e-3)
        np.testing.assert_allclose(alpha[view][sure], expected.alpha[sure], rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("layers", [0, 2, 8])
@pytest.mark.parametrize("kind", ["plain", "over"])
def test_a_gradient_through_a_texture_is_the_central_difference(kind, layers):
    s, f = textured(dataclasses.replace(KINDS[kind], layers=layers))
    s.vjp("look", ["vertices", "texture"], color=f.color)
    mesh = octahedron()
    margin = [brute_force_binned.render(clip_of(c, mesh.positions), mesh.faces, SIZE, c.near, **settings(KINDS[kind])).margin
              for c in CAMERAS]
    w = np.random.default_rng(1).normal(size=(2, *SIZE[::-1], 3)) * (np.stack(margin) > 1e-3)[..., None]
    with ReferenceSession(s.program) as exact:
        exact.forward("look")
        gradient = exact.backward("look", color=w)
        for name, start in (("vertices", octahedron().positions), ("texture", TEXTURE)):
            for seed in range(2):
                way = np.random.default_rng(seed).normal(size=start.shape)
                ends = []
                for sign in (1, -1):
                    exact.set(name, start + sign * 1e-6 * way)
                    ends.append((exact.get("look.color") * w).sum())
                exact.set(name, start)
                expected = (ends[0] - ends[1]) / 2e-6
                assert abs((gradient[name] * way).sum() - expected) < 1e-4 * abs(expected) + 1e-3, (name, seed)
                assert abs(expected) > 0.1


def test_what_is_linear_on_faces_is_the_same_at_pixels(gpu):
    """Colours of vertices, shaded at corners or at pixels; pictures and gradients."""
    found, mesh = [], icosphere(2, 0.7)
    for layers in (None, 0, 5):
        s = Scene(CAMERAS, BACK)
        at = s.parameter("vertices", mesh.positions)
        colors = s.parameter("colors", 0.5 + 0.4 * np.sin(5 * mesh.positions + [0, 1, 2]))
        s.add(mesh, at, Unlit(Vertex(colors)))
        f = s.frame(Binned(3.0, gamma=1e-3, layers=layers))
        s.vjp("look", ["vertices", "colors"], color=f.color)
        with runtime.load(gpu.compile(s.program), gpu.device) as d:
            seen = d.forward("look")["color"]
            found.append((seen, d.backward("look", color=np.cos(np.arange(seen.size)).reshape(seen.shape))))
        gpu.silent()
    np.testing.assert_array_equal(found[0][0], found[1][0])
    np.testing.assert_allclose(found[2][0], found[0][0], atol=2e-5)
    for name in ("vertices", "colors"):
        np.testing.assert_array_equal(found[0][1][name], found[1][1][name])
        scale = np.abs(found[0][1][name]).max()
        np.testing.assert_allclose(found[2][1][name], found[0][1][name], atol=1e-3 * scale)
        assert scale > 0.1


LIGHTS = [Light("directional", (3.0, 2.7, 2.4), (0.2, -0.4, -1.0)), Light("ambient", 0.2)]
MATERIALS = {
    "mips": lambda t: Unlit(Texture(t, mips=True)),
    "pbr": lambda t: PBR(Texture(t), 0.4, 0.2, lights=LIGHTS),
    "normal map": lambda t: Lambert(0.7, LIGHTS, normal=NormalMap(Texture(t))),
    "function": lambda t: lambda s: compose(s.normal.x * 0.5 + 0.5, s.pixel().x * 0.01, s.texture(t).y),
}


@pytest.mark.parametrize("material", [pytest.param(name, marks=[pytest.mark.full] if name in ("pbr", "normal map") else [])
                                      for name in MATERIALS])
def test_any_material_is_drawn_as_in_float64(material, gpu):
    """With normals of faces, so that nothing but the texture changes on a face; with several layers and gradients of both."""
    s, f = textured(Binned(2.0, gamma=1e-2, over=True), pear(8), MATERIALS[material], CAMERAS[:1])
    s.vjp("look", ["vertices", "texture"], color=f.color)
    with ReferenceSession(s.program) as exact, runtime.load(gpu.compile(s.program), gpu.device) as d:
        seen, expected = (x.forward("look")["color"] for x in (d, exact))
        w = np.cos(np.arange(seen.size)).reshape(seen.shape)
        device, reference = (x.backward("look", color=w) for x in (d, exact))
    gpu.silent()
    assert np.median(np.abs(seen - expected)) < 1e-4 and (np.abs(seen - expected).max(-1) > 1e-2).mean() < 1e-2
    assert expected.std() > 0.05
    for name in ("vertices", "texture"):
        off = np.linalg.norm(device[name] - reference[name]) / np.linalg.norm(reference[name])
        assert off < 0.05, (name, off)


def test_parts_of_both_kinds_are_blended_together(gpu):
    """A textured square before a plain one; each shows its own colours, and more layers change nothing where two faces are near."""
    square = np.array([(-0.5, -0.5, 0), (0.5, -0.5, 0), (0.5, 0.5, 0), (-0.5, 0.5, 0)], float)
    uv = np.array([(0, 1), (1, 1), (1, 0), (0, 0)], float)
    faces = np.array([(0, 1, 2), (0, 2, 3)])
    found = []
    for layers in (None, 8):
        s = Scene(orbit(1, [0], 3.0, 36, SIZE), BACK)
        s.add(Mesh(square, faces, uvs=uv, uv_faces=faces), material=Unlit(Texture(s.parameter("texture", TEXTURE, kind="image"))))
        s.add(Mesh(square * (2.4, 0.6, 1) + (0, 0, -0.5), faces), material=Unlit((0.0, 1.0, 0.0)))
        f = s.frame(Binned(1.5, layers=layers))
        s.output("look", color=f.color, part=f.part, sharp=s.frame().color)
        with runtime.load(gpu.compile(s.program), gpu.device) as d:
            color, part, sharp = (d.get(f"look.{x}")[0] for x in ("color", "part", "sharp"))
        gpu.silent()
        assert np.median(np.abs(color - sharp)[part == 0]) < 1e-4 and sharp[part == 0].std() > 0.2
        np.testing.assert_allclose(np.median(color[part == 1], axis=0), (0, 1, 0), atol=1e-3)
        found.append(color)
    assert (np.abs(found[0] - found[1]).max(-1) > 1e-5).mean() < 0.01


@pytest.mark.full
def test_a_fit_learns_a_texture(gpu):
    mesh = pear(16)
    cameras = orbit(2, [20, -15], 3.0, 36, (97, 75))

    def scene(texture):
        s = Scene(cameras, BACK)
        s.add(mesh, s.parameter("vertices", mesh.positions), Unlit(Texture(s.parameter("texture", texture, low=0.0, high=1.0))))
        return s, s.frame(Binned(1.5, gamma=1e-3, over=True))

    truth, f = scene(mesh.texture)
    truth.output("look", color=f.color)
    with runtime.load(gpu.compile(truth.program), gpu.device) as d:
        target = d.get("look.color")
    s, f = scene(np.full((32, 48, 3), 0.5))
    s.phase("fit", 60, {"texture": Adam(0.05)}, color=l2(f.color, s.input("photo", target)))
    with runtime.load(gpu.compile(s.program), gpu.device) as d:
        start = d.loss()
        d.step(60)
        assert d.loss() < 0.1 * start
    gpu.silent()


def test_layers_that_cannot_be_are_refused():
    for layers in (-1, 9, 2.0, True):
        with pytest.raises(InputError, match="layers is .*; a whole number from 0 to 8"):
            Binned(layers=layers)


JOB = TINY
for old, new in (("r = 2.0\n", 'r = 2.0\nrenderer = "binned"\ngamma = 0.001\n'), ("delta = 0.0\n", ""),
                 ("optimize.colors", "optimize.texture"), ('albedo = "colors"', 'albedo = "texture"\ntexture_size = [24, 16]')):
    JOB = JOB.replace(old, new)


def test_a_job_is_solved_with_every_face(tmp_path):
    """From the command line: shape, then a texture; the second phase is drawn in layers where it says so."""
    for text, every in ((JOB.replace('name = "paint"', 'name = "paint"\nrenderer = "layered"'), False), (JOB, True)):
        path = write_job(tmp_path, text)
        plans = {p.name: topological([*p.updates.values(), *p.outputs.values()]) for p in load_job(path).program.plans}
        ops = {name: {n.op.name for n in nodes} for name, nodes in plans.items()}
        assert "soft_alpha" in ops["shape"] and ("soft_blend" in ops["paint"]) == every and "soft_blend" not in ops["render"]
        assert ("soft_heaviest" in ops["paint"]) == every
    for step in (("compile", path, "-p", "vulkan_min", "-o", tmp_path / "a.dressi"),
                 ("run", tmp_path / "a.dressi", "-o", tmp_path / "out.glb")):
        done = command(*step)
        assert done.returncode == 0, done.stderr
    texture = load_mesh(tmp_path / "out.glb").texture
    assert texture.shape[:2] == (16, 24) and texture.std() > 0.001
