"""Jobs of several parts: what is read, what is refused, and two parts from pictures to files."""
import json
from dataclasses import replace

import numpy as np
import pytest
from jobs import command

from dressi_edge import runtime
from dressi_edge.cache.errors import InputError
from dressi_edge.commands import run
from dressi_edge.compiler.graph.functions import compose, constant_table
from dressi_edge.compiler.graph.reference_session import ReferenceSession
from dressi_edge.compiler.io.meshes import load_parts
from dressi_edge.compiler.io.panorama import load_panorama, write_hdr
from dressi_edge.compiler.io.writers import save_mesh, save_png
from dressi_edge.compiler.scene import Scene, Texture, Unlit, Vertex, icosphere, orbit, pear, results
from dressi_edge.compiler.scene.job import parse_job
from dressi_edge.compiler.scene.pieces import parts_of, record

pytest_plugins = ["gpu"]
PEAR = pear(32)
BALL = replace(icosphere(2, 0.3), colors=0.5 + 0.4 * np.sin(9 * icosphere(2, 0.3).positions))
AT = np.array([0.5, 0.2, 0.5])


@pytest.fixture(scope="module")
def folder(tmp_path_factory, gpu):
    """Two pictures of a pear with a ball beside it, both as files, and the cameras."""
    folder, cams = tmp_path_factory.mktemp("parts"), orbit(2, [20, -15], 3.2, 40, (80, 60))
    s = Scene(cams, (0.2, 0.2, 0.2))
    s.add(PEAR, material=Unlit(Texture(s.parameter("texture", PEAR.texture))))
    s.add(replace(BALL, positions=BALL.positions + AT), material=Unlit(Vertex(s.parameter("colors", BALL.colors))))
    f = s.frame()
    s.output("look", pictures=compose(f.color, f.alpha))
    with runtime.load(gpu.compile(s.program), gpu.device) as session:
        pictures = session.get("look.pictures")
    frames = []
    for k, (camera, picture) in enumerate(zip(cams, pictures)):
        save_png(folder / f"{k}.png", picture)
        frames.append({"file_path": f"{k}.png", "transform_matrix": camera.camera_to_world.tolist()})
    c = cams[0]
    (folder / "transforms.json").write_text(json.dumps({"fl_x": c.fx, "fl_y": c.fy, "cx": c.cx, "cy": c.cy, "w": c.width, "h": c.height,
                                                        "frames": frames}))
    save_mesh(folder / "pear.glb", PEAR)
    save_mesh(folder / "ball.glb", BALL)
    return folder


def job(**changed):
    """A job as TOML reads it; the ball starts beside its place."""
    whole = {"part": [{"name": "pear", "path": "pear.glb"}, {"name": "ball", "path": "ball.glb", "translation": [0.42, 0.3, 0.42]}],
             "views": {"transforms": "."}, "render": {"background": [0.2, 0.2, 0.2]},
             "phase": [{"name": "pose", "steps": 60, "optimize": {"ball": {"translation": {"rate": 0.02}}},
                        "loss": [{"kind": "color"}, {"kind": "silhouette", "weight": 0.5}]}]}
    return whole | changed


def toml(x):
    """A job's text: inline tables for all but what is on top."""
    def inline(v):
        if isinstance(v, dict):
            return "{" + ", ".join(f'"{k}" = {inline(w)}' for k, w in v.items()) + "}"
        return "[" + ", ".join(map(inline, v)) + "]" if isinstance(v, list) else json.dumps(v)
    return "\n".join(f"{k} = {inline(v)}" for k, v in x.items()) + "\n"


def test_two_parts_from_pictures_to_files(folder, tmp_path):
    """compile, run: the ball finds its place, and both parts are written with their materials and with the vertices they came with."""
    (folder / "job.toml").write_text(toml(job()))
    assert "phases pose (60 steps)" in command("compile", folder / "job.toml", "-p", "vulkan_min", "-o", tmp_path / "x.dressi").stdout
    done = command("run", tmp_path / "x.dressi", "-o", tmp_path / "out.glb")
    assert done.returncode == 0, done.stderr
    metrics = json.loads((tmp_path / "out_metrics.json").read_text())
    np.testing.assert_allclose(metrics["parameters"]["ball.translation"], AT, atol=0.02)
    assert metrics["views"]["iou_min"] > 0.98 and metrics["views"]["psnr_min"] > 24
    found = {p.name: p for p in load_parts(tmp_path / "out.glb")}
    assert found.keys() == {"pear", "ball"} and all(p.material.unlit for p in found.values())
    np.testing.assert_allclose(found["ball"].mesh.positions.mean(0), AT, atol=0.02)
    assert len(found["ball"].mesh.positions) == len(BALL.positions)
    np.testing.assert_allclose(found["pear"].mesh.texture, PEAR.texture, atol=1 / 255)


@pytest.mark.parametrize("optimize", [{"ball": {"translation": {"rate": 0.02}, "scale": {"rate": 0.1}}},
                                      {"ball.translation": {"rate": 0.02}, "ball.scale": {"rate": 0.1}}])
def test_names_of_parameters_may_be_nested_or_not(folder, optimize):
    found = parse_job(job(phase=[job()["phase"][0] | {"optimize": optimize}]), folder / "job.toml")
    assert {"ball.translation", "ball.scale"} <= found.scene.parameters.keys()


@pytest.mark.parametrize("nested", [True, False])
def test_limits_hold_a_parameter_within_them(folder, gpu, nested):
    """The ball would go from 0.42 to 0.5 along x, and may not."""
    limits = {"low": 0.1, "high": 0.44}
    found = parse_job(job(limits={"ball": {"translation": limits}} if nested else {"ball.translation": limits}), folder / "job.toml")
    with runtime.load(gpu.compile(found.program), gpu.device) as session:
        session.step(60)
        at = session.get("ball.translation")
    assert at[0] == at[2] == np.float32(0.44) and 0.1 < at[1] < 0.44


def test_limits_of_a_material_are_narrowed_and_never_widened(folder):
    phase = job()["phase"][0] | {"optimize": {"ball.color": {"rate": 0.1}}}
    whole = job(part=[job()["part"][0], job()["part"][1] | {"material": {"color": [0.5, 0.4, 0.3]}}], phase=[phase],
                limits={"ball.color": {"low": -3, "high": 0.8}})
    color = parse_job(whole, folder / "job.toml").scene.parameters["ball.color"]
    assert (color.low, color.high) == (0.0, 0.8)


def test_every_parameter_can_be_named(folder):
    """One phase optimizes all there are; materials are lit and shine."""
    material = {"kind": "blinn_phong", "color": [0.5, 0.4, 0.3], "specular": 0.2, "gloss": 10.0}
    parts = [job()["part"][0], job()["part"][1] | {"material": material}]
    names = ["pear.texture", "pear.vertices", "ball.color", "ball.specular", "ball.gloss", "ball.rotation", "ball.translation",
             "ball.scale", "light0.power", "light0.vector", "camera.rotation", "camera.translation"]
    mesh_terms = [{"kind": k, "part": "pear"} for k in ("laplacian", "cotangent_laplacian", "normal_consistency", "edge_length")]
    terms = [{"kind": "color", "norm": norm} for norm in ("l1", "huber", "pyramid")] + mesh_terms
    whole = job(part=parts, light=[{"kind": "point", "power": 8, "vector": [2, 2, 2]}],
                phase=[{"name": "all", "steps": 3, "optimize": {k: {"rate": 0.001} for k in names},
                        "loss": [*terms, {"kind": "magnitude", "parameter": "ball.scale", "weight": 0.1},
                                 {"kind": "total_variation", "parameter": "pear.texture", "power": 2, "weight": 0.1},
                                 {"kind": "tint", "parameter": "pear.texture", "weight": 0.1}]}])
    found = parse_job(whole, folder / "job.toml")
    assert set(names) == found.scene.parameters.keys() and found.phases == ["all"]
    assert [p.name for p in found.program.plans] == ["all", "all.loss", "all.terms", "render"]


@pytest.mark.parametrize("change, what", [
    ({"part": []}, "part is empty"),
    ({"part": [{"name": "a", "path": "pear.glb"}] * 2}, "two parts are called 'a'"),
    ({"part": [{"path": "pear.glb"}]}, r"part\[0\].name is missing"),
    ({"part": [{"name": "a.b", "path": "pear.glb"}]}, r"part\[0\].name is 'a.b'; letters"),
    ({"part": [{"name": "a"}]}, r"part\[0\]: path, sphere or hull is needed"),
    ({"part": [{"name": "a", "path": "none.glb"}]}, "none.glb does not exist"),
    ({"part": [{"name": "a", "path": "pear.glb", "colour": 1}]}, r"part\[0\].colour is an unknown key"),
    ({"part": [{"name": "a", "path": "pear.glb", "material": {"kind": "glass"}}]}, r"material.kind is 'glass'.*allowed: unlit lambert"),
    ({"part": [{"name": "a", "path": "pear.glb", "material": {"gloss": 3}}]}, "gloss is no setting of unlit"),
    ({"part": [{"name": "a", "path": "pear.glb", "material": {"kind": "lambert"}}]}, r"there is no \[\[light\]\]"),
    ({"part": [{"name": "a", "path": "pear.glb", "scale": 0}]}, r"part\[0\].scale is 0"),
    ({"light": [{"kind": "ambient", "power": 1}]}, "no part's material has a use for it"),
    ({"mesh": {"path": "pear.glb"}}, "mesh is an unknown key"),
    ({"phase": []}, "phase is missing"),
    ({"environment": {"path": "sky.hdr", "radiance": [1, 1, 1]}}, "environment: path .* or radiance .* is needed, and not both"),
    ({"environment": {"radiance": [1, 1, 1], "size": 50}}, "environment.size is 50; allowed: 16 32"),
    ({"environment": {"radiance": [1, 1, 1], "background": False}}, "no part's material is of kind pbr, and it is not shown"),
    ({"render": {"tone": {"curve": "bright"}}}, "render.tone.curve is 'bright'; allowed: linear reinhard aces filmic"),
    ({"part": [job()["part"][0] | {"material": {"kind": "lambert", "roughness": 0.5}}]}, "roughness is no setting of lambert; drop it"),
    ({"part": [job()["part"][0] | {"material": {"kind": "pbr", "roughness": 2}}]}, "material.roughness is 2; a number from 0 to 1"),
    ({"part": [job()["part"][0] | {"material": {"two_sided": True}}]}, "two_sided is no setting of unlit"),
    ({"light": [{"kind": "point", "power": 1, "vector": [0, 0, 1], "cone": [1, 2]}]}, "cone is for spot lights; drop it"),
    ({"phase": [job()["phase"][0] | {"optimize": {"cube.vertices": {"rate": 1}}}]}, r"optimize.cube.vertices is no parameter.*ball.scale"),
    ({"limits": 3}, "limits is 3; a table is needed"),
    ({"limits": {"ball.translatoin": {"low": 0}}}, r"limits.ball.translatoin is an unknown key; did you mean ball.translation"),
    ({"limits": {"ball": {"translation": {}}}}, "limits.ball.translation: low or high is needed"),
    ({"limits": {"ball.translation": {"low": 0.45}}}, "ball.translation: it starts at 0.3, which is below 0.45"),
    ({"limits": {"ball.translation": {"low": 0.1, "high": 0.1}}}, "0.1 to 0.1; the first must be below the second"),
    ({"limits": {"ball.translation": {"low": float("nan")}}}, "limits.ball.translation.low is nan; a number is needed"),
    ({"phase": [job()["phase"][0] | {"optimize": {"pear.vertices": {"rate": 1}}}], "limits": {"pear.vertices": {"low": 0}}},
     "pear.vertices is a place, and places have no limits"),
    ({"phase": [job()["phase"][0] | {"loss": [{"kind": "laplacian"}]}]}, "part is missing; loss laplacian is of one part: pear ball"),
    ({"phase": [job()["phase"][0] | {"loss": [{"kind": "color", "power": 2}]}]}, "power is no setting of loss color"),
    ({"phase": [job()["phase"][0] | {"loss": [{"kind": "magnitude", "parameter": "x"}]}]}, "parameter is 'x'; there are: "),
    ({"phase": [job()["phase"][0] | {"loss": [{"kind": "total_variation", "parameter": "ball.translation"}]}]},
     "parameter ball.translation is no image; total_variation is of textures"),
    ({"phase": [job()["phase"][0] | {"loss": [{"kind": "tint", "parameter": "ball.translation"}]}]},
     "parameter ball.translation is no image; tint is of textures"),
    ({"phase": [job()["phase"][0] | {"loss": [{"kind": "tint", "parameter": "pear.texture", "power": 2}]}]},
     "power is no setting of loss tint"),
    ({"phase": [job()["phase"][0] | {"loss": [{"kind": "total_variation", "parameter": "ball.translation", "norm": "l1"}]}]},
     "norm is no setting of loss total_variation"),
    ({"phase": [job()["phase"][0] | {"loss": [{"kind": "laplacian", "part": "pear"}]}]},
     "optimizes ball.translation .* none of its terms depends on it"),
], ids=lambda x: x if isinstance(x, str) else "")
def test_mistakes_are_named(folder, change, what):
    with pytest.raises(InputError, match=what):
        parse_job(job(**change), folder / "job.toml")


def test_a_map_of_normals_begins_flat_where_it_is_said_or_optimized(folder, tmp_path):
    """And goes into the file."""
    light, whole = {"kind": "directional", "power": 2.0, "vector": [0.0, -1.0, -1.0]}, job()
    pear = whole["part"][0] | {"material": {"kind": "pbr", "texture_size": [12, 8], "mips": True, "anisotropy": 2}}
    phase = whole["phase"][0] | {"optimize": {"pear.normal": {"rate": 0.02}}}
    said = parse_job(job(part=[pear | {"material": pear["material"] | {"normal": "texture"}}], light=[light],
                         phase=[phase | {"optimize": {"pear.texture": {"rate": 0.02}}}]), folder / "job.toml")
    named = parse_job(job(part=[pear], light=[light], phase=[phase]), folder / "job.toml")
    for found in (said, named):
        start = found.program.values["pear.normal"].initial
        assert start.shape == (8, 12, 3) and (start == [0.5, 0.5, 1.0]).all()
        source = found.scene.parts[0].material.normal.source
        assert (source.mips, source.anisotropy) == (True, 2)
    assert parse_job(job(part=[pear], light=[light], phase=[phase | {"optimize": {"pear.roughness": {"rate": 0.02}}}]),
                     folder / "job.toml").scene.parts[0].material.normal is None
    named.program.meta.update(named.record())
    with ReferenceSession(named.program) as session:
        texels = results.parts_of(session)[0].material.normal_texture.picture.texels()
    np.testing.assert_allclose(texels, np.broadcast_to([0.5, 0.5, 1.0], (8, 12, 3)), atol=0.51 / 255)
    for change, what in (({"kind": "pbr", "normal": 3}, "material.normal is 3; allowed: texture"),
                         ({"kind": "lambert", "normal": "texture"}, "normal is no setting of lambert; drop it")):
        with pytest.raises(InputError, match=what):
            parse_job(job(part=[pear | {"material": change}], light=[light], phase=[phase]), folder / "job.toml")
    save_mesh(folder / "bare.ply", replace(BALL, uvs=None, uv_faces=None))
    ball = {"name": "ball", "path": "bare.ply", "material": {"kind": "pbr", "normal": "texture"}}
    with pytest.raises(InputError, match="material.normal is \"texture\", but the mesh has no texture coordinates; drop it"):
        parse_job(job(part=[whole["part"][0], ball], light=[light]), folder / "job.toml")


def test_a_job_has_metal_and_a_tone_curve(folder, gpu):
    """A part of kind pbr whose roughness is a texture, under a spot and ambient light, exposed: the phase lowers its loss."""
    shiny = {"name": "pear", "path": "pear.glb", "material": {"kind": "pbr", "roughness": "texture", "metallic": 0.4, "two_sided": True,
                                                              "emissive": [0.01, 0.0, 0.0], "texture_size": [24, 16]}}
    lights = [{"kind": "spot", "power": 30, "vector": [0, 2, 2], "direction": [0, -1, -1], "cone": [10, 40]},
              {"kind": "ambient", "power": 0.5}]
    optimize = {"exposure": {"rate": 0.1}, "pear": {"roughness": {"rate": 0.02}, "metallic": {"rate": 0.02}}}
    fit = {"name": "fit", "steps": 8, "optimize": optimize, "loss": [{"kind": "color"}]}
    render = {"background": [0.2, 0.2, 0.2], "srgb": True, "tone": {"curve": "aces", "exposure": -0.5}}
    problem = parse_job(job(part=[shiny, job()["part"][1]], light=lights, phase=[fit], render=render), folder / "job.toml")
    assert {"exposure", "pear.roughness", "pear.metallic", "light0.direction"} <= problem.scene.parameters.keys()
    with runtime.load(gpu.compile(problem.program), gpu.device) as session:
        assert session.get("pear.roughness").shape == (16, 24) and float(session.get("exposure")) == -0.5
        before = session.loss()
        session.step(8)
        assert session.loss() < before and float(session.get("exposure")) != -0.5
    gpu.silent()


def test_a_job_finds_the_light_around_a_part(folder, tmp_path):
    """compile, run: a metal ball under a panorama, of which map, turn and strength are looked for; what was found is written."""
    (folder / "sky.hdr").write_bytes(write_hdr(np.full((16, 32, 3), 0.4)))
    shiny = {"name": "ball", "sphere": {"vertices": 162, "radius": 0.5},
             "material": {"kind": "pbr", "color": [0.8, 0.8, 0.8], "metallic": 1}}
    fit = {"name": "fit", "steps": 3, "optimize": {"environment": {key: {"rate": 0.02} for key in ("map", "rotation", "strength")}},
           "loss": [{"kind": "color"}]}
    light = {"path": "sky.hdr", "size": 16, "background": True}
    (folder / "light.toml").write_text(toml(job(part=[shiny], environment=light, phase=[fit])))
    assert command("compile", folder / "light.toml", "-p", "lavapipe", "-o", tmp_path / "x.dressi").returncode == 0
    done = command("run", tmp_path / "x.dressi", "-o", tmp_path / "out.glb")
    assert done.returncode == 0, done.stderr
    metrics = json.loads((tmp_path / "out_metrics.json").read_text())
    assert metrics["files"]["environment"] == "out_environment.hdr" and metrics["losses"]["fit"][-1][1] < metrics["losses"]["fit"][0][1]
    found = load_panorama(tmp_path / "out_environment.hdr")
    assert found.shape == (32, 64, 3) and np.abs(found - 0.4).max() > 0.01


def test_parts_in_map_coordinates_come_back_there(folder, tmp_path, gpu):
    """Two parts, one of them with vertices that are fitted, 5000 km from the origin: seen as beside it, and written there."""
    utm = np.array([441547.3, 5121946.6, 2345.1])
    document = json.loads((folder / "transforms.json").read_text())
    for frame in document["frames"]:
        frame["file_path"] = str(folder / frame["file_path"])
        frame["transform_matrix"] = (np.array(frame["transform_matrix"]) + np.pad(utm[:, None], ((0, 1), (3, 0)))).tolist()
    (tmp_path / "transforms.json").write_text(json.dumps(document))
    for name, mesh in (("pear", PEAR), ("ball", BALL)):
        save_mesh(tmp_path / f"{name}.glb", replace(mesh, positions=mesh.positions + utm))
    fit = {"name": "fit", "steps": 1, "optimize": {"pear": {"vertices": {"rate": 1e-6}}, "ball": {"translation": {"rate": 1e-6}}},
           "loss": [{"kind": "silhouette"}]}
    parse_job(job(phase=[fit]), tmp_path / "job.toml").compile("lavapipe", tmp_path / "x.dressi")
    with runtime.load(tmp_path / "x.dressi", gpu.device) as session:
        session.step(1)
        metrics = results.write(session, tmp_path / "out.glb", {}, None, {})
        run._save_states(session, str(tmp_path / "out.npz"))
    assert metrics["views"]["iou_mean"] > 0.9
    pear_, ball = load_parts(tmp_path / "out.glb")
    assert np.abs(pear_.mesh.positions - PEAR.positions - utm).max() < 1e-4
    assert np.abs(ball.mesh.positions - BALL.positions - utm - job()["part"][1]["translation"]).max() < 1e-4
    assert np.abs(np.load(tmp_path / "out.npz")["pear.vertices"] - PEAR.positions - utm).max() < 1e-4


def test_a_part_is_looked_for_where_its_pose_puts_it(folder):
    far = [{"name": "pear", "path": "pear.glb", "translation": [0, 90, 0]}, {"name": "ball", "path": "ball.glb", "translation": [0, 90, 0]}]
    with pytest.raises(InputError, match="views: the mesh is in no view"):
        parse_job(job(part=far), folder / "job.toml")
    with pytest.raises(InputError, match="a.texture has 5000x2 texels; profile vulkan_min allows 4096x4096"):
        part = [{"name": "a", "sphere": {"vertices": 42}, "material": {"texture_size": [5000, 2]}}]
        phase = {"name": "p", "steps": 1, "optimize": {"a": {"texture": {"rate": 0.1}}}, "loss": [{"kind": "color"}]}
        parse_job(job(part=part, phase=[phase]), folder / "job.toml").compile("vulkan_min", folder / "x.dressi")


def test_a_part_of_two_materials_has_the_colours_of_both(folder):
    (folder / "two.mtl").write_text("newmtl r\nKd 1 0 0\nnewmtl b\nKd 0 0 1\n")
    (folder / "two.obj").write_text("mtllib two.mtl\nv 0 0 0\nv .3 0 0\nv .3 .3 0\nv 0 .3 0\nusemtl r\nf 1 2 3\nusemtl b\nf 1 3 4\n")
    parts = [job()["part"][0], {"name": "ball", "path": "two.obj", "translation": [0.42, 0.3, 0.42]}]
    problem = parse_job(job(part=parts), folder / "job.toml")
    problem.program.meta.update(problem.record())
    with ReferenceSession(problem.program) as session:
        mesh = results.parts_of(session)[1].mesh
    assert np.allclose(mesh.colors[mesh.color_faces], [[[1, 0, 0]] * 3, [[0, 0, 1]] * 3])


def test_what_a_reference_session_found_is_told_as_that_of_a_device(folder):
    problem = parse_job(job(), folder / "job.toml")
    problem.program.meta.update(problem.record())
    with ReferenceSession(problem.program) as session:
        assert np.allclose(results._found(session)["parameters"]["ball.translation"], [0.42, 0.3, 0.42])


def test_a_part_that_rests_elsewhere_than_its_mesh_is_written_where_it_is(gpu):
    """Constant positions are what the scene says, not what the mesh file said."""
    s = Scene(orbit(1, [20], 3.2, 40, (40, 30)))
    s.add(BALL, constant_table(BALL.positions + AT), name="ball")
    s.output("look", alpha=s.frame().alpha)
    s.program.meta.update(record(s))
    with runtime.load(gpu.compile(s.program), gpu.device) as session:
        ball, = parts_of(session)
    np.testing.assert_allclose(ball.mesh.positions, BALL.positions + AT, atol=1e-12)
