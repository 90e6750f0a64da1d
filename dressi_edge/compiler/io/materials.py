"""What a mesh file says of its surfaces, in one form for all formats: `Material` and `Part`.

Colours of materials are linear light, as glTF has them; pictures are as stored (sRGB for base colour and emission).
"""
from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .mesh import Mesh
from .textures import Picture

IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))


@dataclass(frozen=True)
class TextureMap:
    """A picture on a surface. uv_set: which of the part's texture coordinates; transform: 2 x 3, texture (u, v) = transform (u, v, 1),
    v down; wrap: beyond the edges, by u and by v, "repeat", "clamp" or "mirror"."""

    picture: Picture
    uv_set: int = 0
    transform: tuple[tuple[float, float, float], tuple[float, float, float]] = IDENTITY
    wrap: tuple[str, str] = ("repeat", "repeat")

    def applied(self, uvs: np.ndarray) -> np.ndarray:
        """Texture coordinates (n, 2) of the part's uvs (n, 2)."""
        if self.transform == IDENTITY:
            return uvs
        matrix = np.array(self.transform)
        return uvs @ matrix[:, :2].T + matrix[:, 2]


@dataclass(frozen=True)
class Material:
    """A surface after glTF 2.0 (section 3.9); the defaults are glTF's, but for `metallic`, which is 0 unless a file says otherwise.

    base_color: linear RGBA, times base_texture (and times the colours of corners). metallic and roughness times the blue and green of
    metallic_roughness_texture. normal_texture by normal_scale; occlusion_texture (red) by occlusion_strength. emissive: linear, times
    emissive_texture. alpha_mode: "OPAQUE", "MASK" (at alpha_cutoff) or "BLEND". unlit: the base colour is what one sees.
    stated: whether the file gives a base colour at all.
    """

    name: str = ""
    base_color: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)
    base_texture: TextureMap | None = None
    metallic: float = 0.0
    roughness: float = 1.0
    metallic_roughness_texture: TextureMap | None = None
    normal_texture: TextureMap | None = None
    normal_scale: float = 1.0
    occlusion_texture: TextureMap | None = None
    occlusion_strength: float = 1.0
    emissive: tuple[float, float, float] = (0.0, 0.0, 0.0)
    emissive_texture: TextureMap | None = None
    alpha_mode: str = "OPAQUE"
    alpha_cutoff: float = 0.5
    double_sided: bool = False
    unlit: bool = False
    stated: bool = False

    @property
    def extra_maps(self) -> dict[str, TextureMap]:
        """The maps besides the base colour's, by what they are."""
        maps = {"metallic-roughness": self.metallic_roughness_texture, "normal": self.normal_texture,
                "occlusion": self.occlusion_texture, "emissive": self.emissive_texture}
        return {name: found for name, found in maps.items() if found is not None}


@dataclass(frozen=True, eq=False)
class Part:
    """One piece of a scene with one material, in world space.

    mesh: its positions, faces, colours and normals; its uvs are those of the base colour texture, transformed, and its texture is
    that picture as stored, without base_color; without such a texture the uvs are the first set. uv_sets: by number, all texture
    coordinates of the file, (n, 2) v down and (F, 3), as the file has them: `TextureMap.applied` gives those of a map.
    """

    name: str
    mesh: Mesh
    material: Material
    uv_sets: dict[int, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)
