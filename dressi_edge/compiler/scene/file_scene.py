"""Whole scenes from glTF files: parts with their materials, lights, cameras; a file in, a `Scene` out.

Textures are decoded to linear light and sampled between mip levels; the scene's pictures are sRGB encoded, as a viewer's are.
"""
from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np

from ...cache.errors import InputError, note
from ..graph.functions import constant, constant_table
from ..io.cameras import Camera
from ..io.gltf_cameras import gltf_cameras, has_cameras
from ..io.gltf_lights import PlacedLight, gltf_lights
from ..io.images import srgb_to_linear
from ..io.materials import Part, TextureMap
from ..io.meshes import load_parts
from ..io.pieces import listed
from ..render.environment import Environment
from ..render.light import Light, Shadow
from ..render.material import Channel, Coordinates, Corner, NormalMap, Occlusion, Product, Texture, Unlit, Vertex
from ..render.pbr import PBR
from ..render.tone import Tone, encode_srgb
from .scene import Scene

NAME = re.compile(r"\W+", re.ASCII)


def load_scene(path: str | Path, cameras: Sequence[Camera] = (), size: tuple[int, int] = (512, 512), *, parameters: Sequence[str] = (),
               lights: Sequence[Light] | None = None, mips: bool = True, background=(0.0, 0.0, 0.0), encode=encode_srgb,
               anisotropy: int = 1, environment: Environment | None = None, shown: bool = True) -> Scene:
    """The scene of a .gltf or .glb file: every part with its material (PBR, or Unlit for KHR_materials_unlit), its lights and, unless
    others are given, its cameras for pictures of `size` = (width, height).

    parameters: patterns ("*", "pot.*") of what phases may optimize, the rest being constant: `<part>.vertices`, `.color`, `.metallic`,
    `.roughness`, `.emissive`, `.texture` (of the base colour, linear), `.metallic_roughness_texture` (green: roughness, blue: metallic),
    `.normal_texture`, `.occlusion_texture`, `.emissive_texture`, `.colors` (of vertices or corners, linear); `light<k>.power`, ...
    A part's name is its node's, of letters, digits and _. lights: in place of the file's; where it has none, and there is no environment,
    a white ambient one. environment: a map that is an array, for PBR, and behind all if `shown`; `environment.map`, `.rotation` and
    `.strength` may be parameters, and so may `exposure` where encode is a `Tone`.
    mips, anisotropy: of all textures, as in `Texture`. What is not drawn (transparency) is noted. Raises InputError, naming the file."""
    path = Path(path)
    if not cameras:
        if not has_cameras(path):
            raise InputError(f"{path} has no camera; give cameras")
        cameras, _ = gltf_cameras(path, *size)
    builder = _Builder(Scene(cameras, background, encode), tuple(parameters), {"mips": mips, "anisotropy": anisotropy})
    builder.lights = builder.lit([light_of(x) for x in gltf_lights(path)] if lights is None else list(lights))
    builder.surround(environment, shown)
    if isinstance(encode, Tone):
        builder.scene.encode = replace(encode, exposure=builder.exposure(encode.exposure))
    parts = load_parts(path)
    lit = any(not part.material.unlit for part in parts)
    if environment is not None and not (lit or shown):
        raise InputError(f"{path}: environment is given, but all parts are unlit, and it is not shown; drop it")
    if not builder.lights and environment is None and lit:
        note(f"{path} has no light; a white ambient one of radiance 1 is used")
        builder.lights = [Light("ambient", 1.0)]
    for part, name in zip(parts, names_of(parts)):
        try:
            builder.add(part, name)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
    if clear := [part.name for part in parts if part.material.alpha_mode != "OPAQUE"]:
        note(f"{path}: {listed(clear)}: transparency is not drawn")
    if unused := [p for p in builder.patterns if not any(fnmatchcase(name, p) for name in builder.asked)]:
        raise InputError(f"{path}: parameters: {unused[0]!r:.60} is nothing of it; there are: {' '.join(builder.asked)}")
    return builder.scene


def light_of(x: PlacedLight) -> Light:
    """A light of a file as the renderer has it."""
    if x.kind == "directional":
        return Light(x.kind, x.power, x.direction)
    return Light(x.kind, x.power, x.position, x.direction, x.cone) if x.kind == "spot" else Light(x.kind, x.power, x.position)


def names_of(parts: Sequence[Part]) -> list[str]:
    """A name for each part that can stand before a dot: letters, digits and _, each once."""
    names: list[str] = []
    for k, part in enumerate(parts):
        name = NAME.sub("_", part.name).strip("_") or f"part{k}"
        names.append(name if name not in names else next(n for n in (f"{name}_{i}" for i in range(2, len(parts) + 2)) if n not in names))
    return names


class _Builder:
    """Adds the parts of a file to a scene. how: textures are sampled. asked: the names of all that could be a parameter."""

    def __init__(self, scene: Scene, patterns: tuple[str, ...], how: dict):
        self.scene, self.patterns, self.how = scene, patterns, how
        self.asked: dict[str, None] = {}
        self.lights: list[Light] = []
        self.environment: Environment | None = None

    def _wanted(self, name: str) -> bool:
        self.asked[name] = None
        return any(fnmatchcase(name, p) for p in self.patterns)

    def lit(self, lights: list[Light]) -> list[Light]:
        """The lights, those that may change with parameters."""
        out = []
        for k, light in enumerate(lights):
            own = {}
            for key in ("power", "vector", "direction"):
                if getattr(light, key) is not None and self._wanted(f"light{k}.{key}"):
                    own[key] = self.scene.parameter(f"light{k}.{key}", getattr(light, key))
            out.append(replace(light, **own))
        return [self.scene.shadow(light) if isinstance(light.shadow, Shadow) else light for light in out]

    def surround(self, environment: Environment | None, shown: bool) -> None:
        """Light of all parts, and what is behind them. Raises InputError."""
        if environment is None:
            return
        if environment.map.op.name != "constant":
            raise InputError("the environment's map is no array; give one, and name environment.map among the parameters")
        array, own = environment.map.attrs["data"].array, {}
        if self._wanted("environment.map"):
            own["map"] = self.scene.parameter("environment.map", array, 0.0, kind="image")
            own["gradient"] = None
        for key, low in (("rotation", None), ("strength", 0.0)):
            if self._wanted(f"environment.{key}"):
                own[key] = self.scene.parameter(f"environment.{key}", getattr(environment, key), low)
        self.environment = replace(environment, **own) if own else environment
        self.scene.surroundings = self.environment if shown else None

    def exposure(self, stops):
        """In stops, of the picture."""
        return self._number("exposure", stops, None, None)

    def _number(self, name: str, value, low: float | None = 0.0, high: float | None = 1.0):
        return self.scene.parameter(name, value, low, high) if self._wanted(name) else value

    def _image(self, name: str, texels: np.ndarray, low: float = 0.0, high: float = 1.0):
        return self.scene.parameter(name, texels, low, high, kind="image") if self._wanted(name) else constant(texels)

    def _map(self, part: Part, name: str, found: TextureMap | None, encoded: bool = False) -> Texture | None:
        """A map of the part as a source; encoded: its picture has sRGB."""
        if found is None:
            return None
        uvs = part.uv_sets.get(found.uv_set)
        if uvs is None:
            note(f"{part.name}: no texture coordinates {found.uv_set} for its {name.rpartition('.')[2]}; it is left out")
            return None
        texels = found.picture.texels()[..., :3]
        image = self._image(name, srgb_to_linear(texels) if encoded else texels)
        return Texture(image, found.wrap, uv=Coordinates(*uvs, found.transform), **self.how)

    def add(self, part: Part, name: str) -> None:
        """Add a part of the file. Raises InputError."""
        m, mesh = part.material, part.mesh
        moves = self._wanted(f"{name}.vertices")
        positions = self.scene.parameter(f"{name}.vertices", mesh.positions, kind="table") if moves else None
        sources = [self._map(part, f"{name}.texture", m.base_texture, True)]
        if mesh.colors is not None:
            colors, key = srgb_to_linear(mesh.colors), f"{name}.colors"
            table = self.scene.parameter(key, colors, 0.0, 1.0, kind="table") if self._wanted(key) else constant_table(colors)
            sources.append(Vertex(table) if mesh.color_faces is None else Corner(table, mesh.color_faces))
        color = self._number(f"{name}.color", m.base_color[:3])
        color = _product([x for x in sources if x is not None], color)
        normals = "file" if mesh.normals is not None and not moves else "smooth"
        material = Unlit(color) if m.unlit else self._pbr(part, name, color)
        self.scene.add(mesh, positions, material, name, normals)

    def _pbr(self, part: Part, name: str, color) -> PBR:
        m = part.material
        packed = self._map(part, f"{name}.metallic_roughness_texture", m.metallic_roughness_texture)
        metallic, roughness = self._number(f"{name}.metallic", m.metallic), self._number(f"{name}.roughness", m.roughness)
        if packed is not None:
            roughness, metallic = _product([Channel(packed, "y")], roughness), _product([Channel(packed, "z")], metallic)
        more = {}
        if (occlusion := self._map(part, f"{name}.occlusion_texture", m.occlusion_texture)) is not None:
            more["occlusion"] = Occlusion(occlusion, m.occlusion_strength)
        glow = self._map(part, f"{name}.emissive_texture", m.emissive_texture, True)
        if any(m.emissive):
            emissive = self._number(f"{name}.emissive", m.emissive, 0.0, None)
            more["emissive"] = emissive if glow is None else _product([glow], emissive)
        more |= self._normal(part, name)
        return PBR(color, roughness, metallic, lights=self.lights, environment=self.environment, two_sided=m.double_sided, **more)

    def _normal(self, part: Part, name: str) -> dict:
        """The map of normals, along tangents of the mesh's own texture coordinates."""
        found = self._map(part, f"{name}.normal_texture", part.material.normal_texture)
        return {} if found is None or part.mesh.uvs is None else {"normal": NormalMap(found, part.material.normal_scale)}


def _product(sources: list, factor):
    """Sources times a factor, which is left away where it is 1."""
    plain = isinstance(factor, (int, float, tuple))
    if sources and plain and np.all(np.asarray(factor) == 1.0):
        return sources[0] if len(sources) == 1 else Product(tuple(sources))
    return Product((*sources, factor)) if sources else factor
