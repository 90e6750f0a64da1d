"""Results as .usdz, read back by Pixar's own library."""
import io
import sys
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from dressi_edge.cache.errors import InputError
from dressi_edge.commands.outputs import wanted
from dressi_edge.compiler.io.cameras import Camera, look_at
from dressi_edge.compiler.io.images import png_bytes
from dressi_edge.compiler.io.materials import Material, Part, TextureMap
from dressi_edge.compiler.io.shapes import icosphere, pear
from dressi_edge.compiler.io.textures import Picture
from dressi_edge.compiler.io.writers import save_mesh, save_parts

pxr = pytest.importorskip("pxr", reason="Pixar's USD is not installed: pip install 'dressi_edge[usd]'")
from pxr import Gf, Usd, UsdGeom, UsdShade, UsdValidation  # noqa: E402


def opened(path):
    """The stage of a file in which none of USD's own validators finds anything wrong."""
    stage = Usd.Stage.Open(str(path))
    found = UsdValidation.ValidationContext(UsdValidation.ValidationRegistry().GetOrLoadAllValidators()).Validate(stage)
    assert [(x.GetValidator().GetMetadata().name, x.GetMessage()) for x in found] == []
    return stage



def surface_of(stage, path):
    material, _ = UsdShade.MaterialBindingAPI(stage.GetPrimAtPath(path)).ComputeBoundMaterial()
    return UsdShade.Shader(material.GetSurfaceOutput().GetConnectedSource()[0].GetPrim())


def texture_of(surface, name):
    source, channel, _ = surface.GetInput(name).GetConnectedSource()
    return UsdShade.Shader(source.GetPrim()), channel


def test_a_textured_mesh_is_the_same_there(tmp_path):
    mesh = pear(64)
    save_mesh(tmp_path / "pear.usdz", mesh)
    stage = opened(tmp_path / "pear.usdz")
    prim = UsdGeom.Mesh(stage.GetPrimAtPath("/scene/surface"))
    np.testing.assert_allclose(prim.GetPointsAttr().Get(), mesh.positions, atol=1e-6)
    np.testing.assert_array_equal(np.reshape(prim.GetFaceVertexIndicesAttr().Get(), (-1, 3)), mesh.faces)
    st = UsdGeom.PrimvarsAPI(prim).GetPrimvar("st").ComputeFlattened()
    np.testing.assert_allclose(np.reshape(st, (-1, 3, 2)) * (1, -1) + (0, 1), mesh.uvs[mesh.uv_faces], atol=1e-6)
    assert prim.GetSubdivisionSchemeAttr().Get() == "none" and UsdGeom.GetStageUpAxis(stage) == "Y"
    texture, channel = texture_of(surface_of(stage, "/scene/surface"), "diffuseColor")
    assert channel == "rgb" and texture.GetInput("sourceColorSpace").Get() == "sRGB"
    with zipfile.ZipFile(tmp_path / "pear.usdz") as file:
        texels = np.asarray(Image.open(io.BytesIO(file.read(next(n for n in file.namelist() if n.endswith(".png"))))))
    np.testing.assert_allclose(texels / 255.0, mesh.texture, atol=0.51 / 255)


def test_materials_are_preview_surfaces(tmp_path):
    """Numbers, maps by channel, colours of vertices, and what glows; parts of one name have places of their own."""
    rng = np.random.default_rng(0)
    ball = pear(16)

    def picture(name):
        return TextureMap(Picture(name, png_bytes(rng.random((8, 8, 3)))))

    maps = {name: picture(name) for name in ("metallic_roughness_texture", "normal_texture", "occlusion_texture", "emissive_texture")}
    full = Material("full", (0.5, 0.6, 0.7, 1.0), metallic=0.8, roughness=0.4, emissive=(1.0, 2.0, 3.0),
                    stated=True, **maps)
    painted = icosphere(1, 0.5)
    colors = 0.5 + 0.4 * np.sin(painted.positions)
    parts = [Part("2 balls", ball, full), Part("2 balls", replace(painted, colors=colors), Material("glow", unlit=True)),
             Part("dull", painted, Material("dull", (0.2, 0.3, 0.4, 1.0), metallic=0.1, roughness=0.9, stated=True))]
    save_parts(tmp_path / "x.usdz", parts)
    stage = opened(tmp_path / "x.usdz")
    one, two, three = (surface_of(stage, f"/scene/{name}") for name in ("_2_balls", "_2_balls_2", "dull"))
    for name, channel, scale in (("metallic", "b", 0.8), ("roughness", "g", 0.4), ("normal", "rgb", 2.0), ("occlusion", "r", 1.0)):
        texture, found = texture_of(one, name)
        assert found == channel and texture.GetInput("scale").Get()[0] == np.float32(scale)
        assert texture.GetInput("sourceColorSpace").Get() == "raw"
    assert texture_of(one, "emissiveColor")[0].GetInput("scale").Get() == Gf.Vec4f(1, 2, 3, 1)
    assert two.GetInput("diffuseColor").Get() == Gf.Vec3f(0) and two.GetInput("useSpecularWorkflow").Get() == 1
    assert texture_of(two, "emissiveColor")[0].GetInput("varname").Get() == "displayColor"
    shown = UsdGeom.PrimvarsAPI(stage.GetPrimAtPath("/scene/_2_balls_2")).GetPrimvar("displayColor").Get()
    np.testing.assert_allclose(shown, ((colors + 0.055) / 1.055) ** 2.4, atol=1e-6)
    assert three.GetInput("diffuseColor").Get() == Gf.Vec3f(0.2, 0.3, 0.4) and abs(three.GetInput("roughness").Get() - 0.9) < 1e-6


def test_cameras_see_there_what_they_see_here(tmp_path):
    own = look_at((1, 2, 3), (0.1, 0, 0), (0, 1, 0), 40, 300, 200)
    cameras = {"off": Camera(own.world_to_camera, 310.0, 305.0, 140.0, 110.0, 300, 200),
               "flat": Camera(own.world_to_camera, 100.0, 100.0, 150.0, 100.0, 300, 200, 0.1, 50.0, "orthographic")}
    save_parts(tmp_path / "x.usdz", [Part("ball", icosphere(1, 0.5), Material())], cameras=list(cameras.items()))
    stage = Usd.Stage.Open(str(tmp_path / "x.usdz"))
    points = np.random.default_rng(1).uniform(-0.5, 0.5, (5, 3))
    for name, camera in cameras.items():
        frustum = UsdGeom.Camera(stage.GetPrimAtPath(f"/scene/{name}")).GetCamera().frustum
        matrix = frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix()
        for p in points:
            x, y, z = camera.world_to_camera[:3] @ np.append(p, 1.0)
            w = 1.0 if camera.kind == "orthographic" else -z
            there = matrix.Transform(Gf.Vec3d(*p))
            assert abs((there[0] + 1) / 2 * 300 - (camera.cx + camera.fx * x / w)) < 1e-2
            assert abs((1 - there[1]) / 2 * 200 - (camera.cy - camera.fy * y / w)) < 1e-2


def test_without_the_library_it_is_said_before_the_work(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "pxr", None)
    with pytest.raises(InputError, match="pip install 'dressi_edge.usd.'"):
        save_mesh(tmp_path / "x.usdz", icosphere(1, 0.5))
    assert not (tmp_path / "x.usdz").exists()
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(InputError, match="output .*x.usdz: writing .usdz takes Pixar's library"):
        wanted([str(tmp_path / "x.usdz")])
