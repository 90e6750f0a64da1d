"""The jobs of docs/examples/ that find what a surface is made of, as they stand but for fewer steps, on photographs of a lumpy ball, from
files to files."""
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from jobs import ROOT
from shading import dots, unit

from dressi_edge import runtime
from dressi_edge.compiler.graph.functions import compose
from dressi_edge.compiler.io.panorama import write_hdr
from dressi_edge.compiler.scene import (
    PBR,
    Channel,
    Environment,
    HardSoftRas,
    Light,
    NormalMap,
    Scene,
    Texture,
    corner_normals,
    encode_srgb,
    load_parts,
    octahedral,
    orbit,
    save_mesh,
    save_png,
    sphere,
)
from dressi_edge.compiler.scene.job import load_job
from dressi_edge.compiler.scene.results import save_result

pytest_plugins = ["gpu"]
BALL = sphere(642, 0.6)
TRUE = replace(BALL, positions=BALL.positions * (1 + 0.15 * np.sin(5 * BALL.positions[:, :1]) * np.cos(5 * BALL.positions[:, 1:2])))
SIDE = 64
LIGHTS = [Light("directional", power, way) for way, power in (((-1.0, -0.6, -0.5), (2.0, 0.4, 0.4)), ((1.0, -0.6, -0.5), (0.4, 2.0, 0.4)),
                                                              ((0.0, -1.0, 1.0), (0.4, 0.4, 2.0)))]


def sky():
    """(32, 64, 3): windows of all brightnesses, none so bright that a photograph is white."""
    rng = np.random.default_rng(3)
    return np.kron(rng.uniform(0.0, 1.0, (8, 16, 1)) ** 3 * rng.uniform(0.6, 1.0, (8, 16, 3)), np.ones((4, 4, 1)))


def maps():
    """(32, 48, 3): colours; and roughness and metal as y and z of another."""
    y, x = np.mgrid[:32, :48] / np.array([32, 48])[:, None, None]
    patch = ((np.floor(x * 6) + np.floor(y * 4)) % 2)[..., None]
    return np.where(patch, [0.8, 0.55, 0.3], [0.25, 0.4, 0.6]), np.concatenate([0 * patch, 0.25 + 0.4 * y[..., None], patch], 2)


def bumps():
    """(32, 48, 3) normals of length 1 along the surface's own axes."""
    y, x = np.mgrid[:32, :48]
    return unit(np.stack([0.5 * np.sin(x * 0.7), 0.5 * np.cos(y * 0.6), np.ones(x.shape)], -1))


def write(folder, gpu, material, mesh=TRUE, views=8):
    """object.glb, sky.hdr, and photographs of what is true with their cameras; the panorama as it comes back."""
    cameras, frames = orbit(views, [25, -25, 5], 2.4, 40, (SIDE, SIDE)), []
    scene = Scene(cameras, encode=encode_srgb)
    scene.add(mesh, material=material, normals="smooth")
    seen = scene.frame(HardSoftRas(1.0, delta=0.0))
    scene.output("o", color=compose(seen.color, seen.alpha))
    with runtime.load(gpu.compile(scene.program), gpu.device) as session:
        photos = session.get("o.color")
    (folder / "photos").mkdir()
    for k, (camera, photo) in enumerate(zip(cameras, photos)):
        save_png(folder / "photos" / f"{k}.png", np.clip(photo, 0, 1))
        frames.append({"file_path": f"{k}.png", "transform_matrix": camera.camera_to_world.tolist()})
    c = cameras[0]
    (folder / "photos" / "transforms.json").write_text(json.dumps({"fl_x": c.fx, "fl_y": c.fy, "cx": c.cx, "cy": c.cy, "w": SIDE, "h": SIDE,
                                                                   "frames": frames}))
    normals = corner_normals(mesh, "smooth").reshape(-1, 3)  # a file without any is flat
    save_mesh(folder / "object.glb", replace(mesh, normals=normals, normal_faces=np.arange(len(normals)).reshape(-1, 3)))
    (folder / "sky.hdr").write_bytes(write_hdr(sky()))


def solve(folder, gpu, name, steps, **changes):
    """What the example's job finds in so many steps a phase: losses of the last phase before and after, the session's values, the file."""
    text = re.sub(r"steps = \d+", f"steps = {steps}", (ROOT / "docs" / "examples" / f"{name}.toml").read_text())
    for old, new in changes.values():
        assert old in text
        text = text.replace(old, new)
    (folder / f"{name}.toml").write_text(text)
    problem = load_job(folder / f"{name}.toml")
    problem.compile("lavapipe", folder / "x.dressi")
    with runtime.load(folder / "x.dressi", gpu.device) as session:
        values = {key: [session.get(key)] for key in problem.scene.parameters}
        pictures = [session.get("render.color")]
        for phase in problem.phases:
            session.step(steps, phase)
        for key in values:
            values[key].append(session.get(key))
        pictures.append(session.get("render.color"))
        save_result(session, folder / "out.glb")
        targets = session.get("targets")
    inside = targets[..., 3] > 0.5
    error = [np.sqrt(((p[..., :3] - targets[..., :3])[inside] ** 2).mean()) for p in pictures]
    gpu.silent()
    return error, values, load_parts(folder / "out.glb")[0].material


@pytest.mark.full
def test_detail_becomes_a_map_of_normals(gpu, tmp_path):
    wanted = bumps()
    write(tmp_path, gpu, PBR((0.7,) * 3, 0.5, normal=NormalMap(Texture(wanted * 0.5 + 0.5)), lights=LIGHTS), views=5)
    error, values, material = solve(tmp_path, gpu, "normal_map", 60, size=("[1024, 1024]", "[48, 32]"))
    start, found = values["thing.normal"]
    angle = [np.median(np.degrees(np.arccos(np.clip(dots(unit(x * 2 - 1), wanted), -1, 1)))) for x in (start, found)]
    assert error[1] < 0.35 * error[0] and angle[1] < 0.5 * angle[0], (error, angle)
    np.testing.assert_allclose(material.normal_texture.picture.texels(), np.clip(found, 0, 1), atol=0.51 / 255)


@pytest.mark.full
def test_light_and_roughness_are_found_together(gpu, tmp_path):
    truth = octahedral(sky(), 32)
    write(tmp_path, gpu, PBR((0.9, 0.85, 0.8), 0.25, 1.0, environment=Environment(truth)))
    error, values, material = solve(tmp_path, gpu, "light_and_roughness", 200)
    off = [np.sqrt(((x - truth) ** 2).mean()) for x in values["environment.map"]]
    rough = float(values["thing.roughness"][1])
    assert error[1] < 0.1 * error[0] and abs(rough - 0.25) < 0.08 and off[1] < 0.4 * off[0], (error, rough, off)
    assert material.roughness == pytest.approx(rough)


def surface_of(size):
    """The true material under the true sky, and its maps."""
    color, rest = maps()
    source = Texture(rest)
    return PBR(Texture(color), Channel(source, "y"), Channel(source, "z"), environment=Environment(octahedral(sky(), size))), color, rest


@pytest.mark.full
def test_a_material_is_found_under_a_known_panorama(gpu, tmp_path):
    true, color, rest = surface_of(64)
    write(tmp_path, gpu, true)
    error, values, material = solve(tmp_path, gpu, "material", 400, size=("[512, 512]", "[48, 32]"))
    start, found = values["thing.texture"]
    shown = abs(found - start).max(-1) > 1e-6
    off = [abs(x - color)[shown].mean() for x in (start, found)]
    metal = [abs(x.reshape(32, 48) - rest[..., 2])[shown].mean() for x in values["thing.metallic"]]
    assert error[1] < 0.4 * error[0] and off[1] < 0.6 * off[0] and metal[1] < 0.85 * metal[0], (error, off, metal)
    assert material.metallic_roughness_texture is not None and material.base_texture is not None


def radius(directions):
    """Of the true surface along directions of length 1."""
    x = 0.6 * directions
    return 0.6 * (1 + 0.15 * np.sin(5 * x[:, 0]) * np.cos(5 * x[:, 1]))


@pytest.mark.full
def test_shape_material_and_light_are_found_together(gpu, tmp_path):
    true, _, _ = surface_of(32)
    write(tmp_path, gpu, true)
    error, values, _ = solve(tmp_path, gpu, "shape_material_light", 120, ball=("vertices = 2562", "vertices = 642"),
                             size=("[768, 512]", "[48, 32]"))
    apart = [abs(np.linalg.norm(x, axis=1) - radius(unit(x))).mean() for x in values["thing.vertices"]]
    off = [np.sqrt(((x - octahedral(sky(), 32)) ** 2).mean()) for x in values["environment.map"]]
    assert error[1] < 0.25 * error[0] and apart[1] < 0.5 * apart[0] and off[1] < 0.9 * off[0], (error, apart, off)
