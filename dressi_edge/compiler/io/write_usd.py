"""USD out: parts and cameras in, the bytes of a .usdz, by Pixar's own library (`pip install 'dressi_edge[usd]'`).

Meshes are polygons without subdivision, texture coordinates have v upwards, materials are UsdPreviewSurface: base colour, metal, roughness,
normals, occlusion, emission, each a number or a picture. What glTF calls unlit is a surface that reflects nothing and glows.
Specification: openusd.org, "UsdPreviewSurface" and "Usdz File Format".
"""
from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Sequence

import numpy as np

from ...cache.errors import InputError
from .cameras import Camera, inverse_rigid
from .images import png_bytes, srgb_to_linear
from .materials import Part, TextureMap
from .mesh import Mesh, corner_normals

APERTURE = 36.0  # of a camera, tenths of a unit across, as USD's millimetres of film are


def _library():
    """(Gf, Sdf, Usd, UsdGeom, UsdShade, UsdUtils, Vt). Raises InputError where USD is not installed."""
    try:
        from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, UsdUtils, Vt
    except ImportError:
        raise InputError("writing .usdz takes Pixar's library: pip install 'dressi_edge[usd]', or write another format") from None
    return Gf, Sdf, Usd, UsdGeom, UsdShade, UsdUtils, Vt


class _Stage:
    """A scene that grows in a folder."""

    def __init__(self, folder: str):
        self.gf, self.sdf, usd, self.geom, self.shade, self.utils, self.vt = _library()
        self.folder, self.path = folder, os.path.join(folder, "scene.usdc")
        self.stage = usd.Stage.CreateNew(self.path)
        self.geom.SetStageUpAxis(self.stage, self.geom.Tokens.y)
        self.geom.SetStageMetersPerUnit(self.stage, 1.0)
        self.stage.SetDefaultPrim(self.geom.Xform.Define(self.stage, "/scene").GetPrim())
        self.pictures: dict[object, str] = {}

    def place(self, name: str) -> str:
        """A path of its own, of letters that USD allows."""
        base = re.sub(r"\W", "_", name, flags=re.ASCII) or "part"
        base = f"_{base}" if base[0].isdigit() else base
        path, k = f"/scene/{base}", 1
        while self.stage.GetPrimAtPath(path):
            k += 1
            path = f"/scene/{base}_{k}"
        return path

    def picture(self, texels: np.ndarray, key: object) -> str:
        """The file of a picture; one for each key."""
        if key not in self.pictures:
            self.pictures[key] = f"{len(self.pictures)}.png"
            with open(os.path.join(self.folder, self.pictures[key]), "wb") as file:
                file.write(png_bytes(texels))
        return self.pictures[key]

    def values(self, prim, name: str, kind, values: np.ndarray, faces: np.ndarray | None) -> None:
        """A primvar of vertices, or with faces (F, 3) of their corners."""
        own = self.geom.PrimvarsAPI(prim).CreatePrimvar(
            name, kind, self.geom.Tokens.vertex if faces is None else self.geom.Tokens.faceVarying)
        array = np.ascontiguousarray(values, np.float32)
        own.Set(self.vt.Vec2fArray.FromNumpy(array) if array.shape[1] == 2 else self.vt.Vec3fArray.FromNumpy(array))
        if faces is not None:
            own.SetIndices(self.vt.IntArray.FromNumpy(np.ascontiguousarray(faces.reshape(-1), np.int32)))

    def part(self, part: Part) -> None:
        mesh, path = part.mesh, self.place(part.name)
        prim = self.geom.Mesh.Define(self.stage, path)
        prim.CreateSubdivisionSchemeAttr(self.geom.Tokens.none)
        prim.CreatePointsAttr(self.vt.Vec3fArray.FromNumpy(np.ascontiguousarray(mesh.positions, np.float32)))
        prim.CreateFaceVertexCountsAttr(self.vt.IntArray.FromNumpy(np.full(len(mesh.faces), 3, np.int32)))
        prim.CreateFaceVertexIndicesAttr(self.vt.IntArray.FromNumpy(np.ascontiguousarray(mesh.faces.reshape(-1), np.int32)))
        prim.CreateExtentAttr([self.gf.Vec3f(*map(float, f(mesh.positions, 0))) for f in (np.min, np.max)])
        prim.CreateDoubleSidedAttr(part.material.double_sided)
        prim.CreateNormalsAttr(self.vt.Vec3fArray.FromNumpy(np.ascontiguousarray(_normals(mesh).reshape(-1, 3), np.float32)))
        prim.SetNormalsInterpolation(self.geom.Tokens.faceVarying)
        kinds = self.sdf.ValueTypeNames
        if mesh.colors is not None:
            self.values(prim, "displayColor", kinds.Color3fArray, srgb_to_linear(mesh.colors), mesh.color_faces)
        sets: dict[tuple, str] = {}
        if mesh.uvs is not None:
            self.values(prim, "st", kinds.TexCoord2fArray, mesh.uvs * (1, -1) + (0, 1), mesh.uv_faces)
        for found in part.material.extra_maps.values():
            key = found.uv_set, found.transform
            values, faces = part.uv_sets.get(found.uv_set, (mesh.uvs, mesh.uv_faces))
            if key not in sets and values is not None:
                sets[key] = f"st{len(sets) + 1}"
                self.values(prim, sets[key], kinds.TexCoord2fArray, found.applied(values) * (1, -1) + (0, 1), faces)
        self.shade.MaterialBindingAPI.Apply(prim.GetPrim()).Bind(self.material(part, f"{path}/material", sets))

    def material(self, part: Part, path: str, sets: dict[tuple, str]):
        m, mesh, kinds = part.material, part.mesh, self.sdf.ValueTypeNames
        own = self.shade.Material.Define(self.stage, path)
        surface = self.shader(f"{path}/surface", "UsdPreviewSurface")
        own.CreateSurfaceOutput().ConnectToSource(surface.ConnectableAPI(), "surface")
        base = tuple(m.base_color[:3]) if m.stated else (1.0, 1.0, 1.0)

        def number(name: str, kind, value) -> None:
            surface.CreateInput(name, kind).Set(value)

        def sampled(name: str, kind, file: str, wrap: tuple[str, str], st: str, channel: str, scale, color: bool, bias=None) -> None:
            reader = self.shader(f"{path}/{name}_st", "UsdPrimvarReader_float2")
            reader.CreateInput("varname", kinds.String).Set(st)
            texture = self.shader(f"{path}/{name}", "UsdUVTexture")
            texture.CreateInput("file", kinds.Asset).Set(file)
            texture.CreateInput("sourceColorSpace", kinds.Token).Set("sRGB" if color else "raw")
            texture.CreateInput("wrapS", kinds.Token).Set(wrap[0])
            texture.CreateInput("wrapT", kinds.Token).Set(wrap[1])
            texture.CreateInput("scale", kinds.Float4).Set(self.gf.Vec4f(*map(float, scale)))
            if bias is not None:
                texture.CreateInput("bias", kinds.Float4).Set(self.gf.Vec4f(*map(float, bias)))
            texture.CreateInput("st", kinds.Float2).ConnectToSource(reader.ConnectableAPI(), "result")
            surface.CreateInput(name, kind).ConnectToSource(texture.ConnectableAPI(), channel)

        shown = "emissiveColor" if m.unlit else "diffuseColor"
        if mesh.texture is not None and mesh.uvs is not None:
            wrap = m.base_texture.wrap if m.base_texture else (mesh.wrap,) * 2
            sampled(shown, kinds.Color3f, self.picture(mesh.texture, id(mesh)), wrap, "st", "rgb", (*base, 1.0), True)
        elif mesh.colors is not None:
            reader = self.shader(f"{path}/{shown}", "UsdPrimvarReader_float3")
            reader.CreateInput("varname", kinds.String).Set("displayColor")
            surface.CreateInput(shown, kinds.Color3f).ConnectToSource(reader.ConnectableAPI(), "result")
        else:
            number(shown, kinds.Color3f, self.gf.Vec3f(*base))
        if m.unlit:
            for name in ("diffuseColor", "specularColor"):
                number(name, kinds.Color3f, self.gf.Vec3f(0.0))
            number("useSpecularWorkflow", kinds.Int, 1)
            return own

        def mapped(name: str, kind, found: TextureMap | None, channel: str, scale, color: bool, bias=None) -> bool:
            st = None if found is None else sets.get((found.uv_set, found.transform))
            if st is not None:
                file = self.picture(found.picture.texels(), id(found.picture))
                sampled(name, kind, file, found.wrap, st, channel, scale, color, bias)
            return st is not None

        both = m.metallic_roughness_texture
        if not mapped("metallic", kinds.Float, both, "b", (m.metallic,) * 4, False):
            number("metallic", kinds.Float, float(m.metallic))
        if not mapped("roughness", kinds.Float, both, "g", (m.roughness,) * 4, False):
            number("roughness", kinds.Float, float(m.roughness))
        if not mapped("emissiveColor", kinds.Color3f, m.emissive_texture, "rgb", (*m.emissive, 1.0), True):
            number("emissiveColor", kinds.Color3f, self.gf.Vec3f(*map(float, m.emissive)))
        flat = (2.0 * m.normal_scale, 2.0 * m.normal_scale, 2.0, 1.0)
        mapped("normal", kinds.Normal3f, m.normal_texture, "rgb", flat, False, (-m.normal_scale, -m.normal_scale, -1.0, 0.0))
        how = m.occlusion_strength
        mapped("occlusion", kinds.Float, m.occlusion_texture, "r", (how,) * 4, False, (1.0 - how,) * 4)
        return own

    def shader(self, path: str, kind: str):
        made = self.shade.Shader.Define(self.stage, path)
        made.CreateIdAttr(kind)
        return made

    def camera(self, name: str, camera: Camera) -> None:
        own = self.geom.Camera.Define(self.stage, self.place(name))
        own.AddTransformOp().Set(self.gf.Matrix4d(*inverse_rigid(camera.world_to_camera).T.reshape(-1).tolist()))
        unit = APERTURE / camera.width  # of film for a pixel
        if camera.kind == "orthographic":
            own.CreateProjectionAttr(self.geom.Tokens.orthographic)
            unit = 10.0 / camera.fx  # tenths of a unit of the scene
        own.CreateHorizontalApertureAttr(unit * camera.width)
        own.CreateVerticalApertureAttr(unit * camera.height * (camera.fx / camera.fy))
        own.CreateHorizontalApertureOffsetAttr(unit * (camera.width / 2 - camera.cx))
        own.CreateVerticalApertureOffsetAttr(unit * (camera.cy - camera.height / 2) * (camera.fx / camera.fy))
        if camera.kind != "orthographic":
            own.CreateFocalLengthAttr(unit * camera.fx)
        own.CreateClippingRangeAttr(self.gf.Vec2f(camera.near, camera.far))


def _normals(mesh: Mesh) -> np.ndarray:
    """(F, 3, 3), of each face's corners."""
    return corner_normals(mesh, "smooth") if mesh.normals is None else mesh.normals[mesh.normal_faces]


def encode_usdz(parts: Sequence[Part], cameras: Sequence[tuple[str, Camera]] = ()) -> bytes:
    """A .usdz with everything inside. Raises InputError."""
    with tempfile.TemporaryDirectory() as folder:
        stage = _Stage(folder)
        for part in parts:
            stage.part(part)
        for name, camera in cameras:
            stage.camera(name, camera)
        stage.stage.GetRootLayer().Save()
        out = os.path.join(folder, "out.usdz")
        if not stage.utils.CreateNewUsdzPackage(stage.sdf.AssetPath(stage.path), out):
            raise InputError("USD's library could not make a .usdz of the scene; write .glb instead")
        with open(out, "rb") as file:
            return file.read()


