"""Materials in a bundle's meta, so that results can be written with them: a material's sources in, plain values out; and back as what a
file has.

A source is a table: {"numbers"}, {"value": name in the session}, {"texture", "wrap", ...}, {"vertices"}, {"corners", "faces"},
{"product": sources}, {"channel", "of": source}; empty where a function of the user's gives it.
"""
from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ...cache.errors import BundleError, note
from ..graph.ir import UNIT, Node
from ..io.images import linear_to_srgb, png_bytes, srgb_to_linear
from ..io.materials import Material, TextureMap
from ..io.mesh import Mesh
from ..io.textures import Picture
from ..render.material import (
    BlinnPhong,
    Channel,
    Coordinates,
    Corner,
    Lambert,
    NormalMap,
    Occlusion,
    Product,
    Texture,
    Unlit,
    Vertex,
    moved,
)
from ..render.pbr import PBR
from ..render.texture import wraps_of

FIELDS = ("color", "roughness", "metallic", "occlusion", "emissive")


def pack(array: np.ndarray, kind: str) -> dict:
    """An array as a bundle's meta holds it; kind: a NumPy type of stated byte order."""
    return {"type": kind, "shape": list(array.shape), "data": np.asarray(array, kind).tobytes()}


def unpack(entry, name: str, kind: str, columns: int) -> np.ndarray:
    """The (n, columns) array of an entry of a bundle's meta. Raises BundleError, naming it."""
    try:
        if entry["type"] != kind:
            raise ValueError(f"type {entry['type']!r:.20}, not {kind}")
        array = np.frombuffer(entry["data"], kind).reshape(-1, columns)
        if list(array.shape if columns > 1 else array.shape[:1]) != entry["shape"]:
            raise ValueError(f"shape {entry['shape']!r:.40}, not {list(array.shape)}")
        return array
    except (KeyError, TypeError, ValueError) as error:
        raise BundleError(f"meta.{name} is malformed ({error}); compile the bundle again") from None


def described(material, names: Mapping[Node, str]) -> dict:
    """The table of a material: kind "pbr", "unlit" or "diffuse" (of lights of its own, such as `Lambert`), and its sources; empty for
    others, and where its colour is a function alone. names: of the session's values."""
    if isinstance(material, PBR):
        found = {key: _source(getattr(material, key), names) for key in FIELDS}
        if isinstance(material.normal, NormalMap):
            found |= {"normal": _source(material.normal.source, names), "normal_scale": _source(material.normal.scale, names)}
        if isinstance(material.occlusion, Occlusion):
            found |= {"occlusion": _source(material.occlusion.source, names),
                      "occlusion_strength": _source(material.occlusion.strength, names)}
        return {"kind": "pbr", "two_sided": material.two_sided, **found}
    if isinstance(material, (Unlit, Lambert, BlinnPhong)) and (color := _source(material.color, names)):
        two_sided = {} if isinstance(material, Unlit) else {"two_sided": material.two_sided}
        return {"kind": "unlit" if isinstance(material, Unlit) else "diffuse", **two_sided, "color": color}
    return {}


def _source(source, names: Mapping[Node, str]) -> dict:
    if isinstance(source, (int, float)):
        return {"numbers": [float(source)]}
    if isinstance(source, (tuple, list)):
        return {"numbers": [float(x) for x in source]}
    if isinstance(source, Product):
        return {"product": [_source(x, names) for x in source.sources]}
    if isinstance(source, Channel):
        return {"channel": source.name, "of": _source(source.source, names)}
    if isinstance(source, Texture) and (source.uv is None or isinstance(source.uv, Coordinates)):
        found = _image(source, names)
        if source.uv is not None:
            found |= {"uvs": pack(np.asarray(source.uv.values, float), "<f8"), "uv_faces": pack(np.asarray(source.uv.faces), "<i4")}
        inner = source.uv.transform if source.uv is not None else ()
        moves = [[list(map(float, row)) for row in m] for m in (inner, source.transform) if len(m)]
        return found and {**found, "wrap": list(wraps_of(source.wrap)), "moves": moves}
    if isinstance(source, (Vertex, Corner)):
        found = _table(source.table, names)
        kind = "vertices" if isinstance(source, Vertex) else "corners"
        return found and {kind: found, **({"faces": pack(source.faces, "<i4")} if kind == "corners" else {})}
    if isinstance(source, Node):
        if source in names:
            return {"value": names[source]}
        if source.op.name == "constant" and source.extent == UNIT:
            return {"numbers": source.attrs["data"].array.reshape(-1).tolist()}
    return {}


def _image(source: Texture, names: Mapping[Node, str]) -> dict:
    """Where the texels of a texture are: in the session, or here as PNG, as they are sampled or, if `srgb`, sRGB encoded."""
    if source.image in names:
        return {"texture": names[source.image], "srgb": source.srgb}
    if source.image.op.name != "constant":
        return {}
    texels = np.clip(source.image.attrs["data"].array[..., :3], 0.0, 1.0)
    texels = np.repeat(texels, 3, -1) if texels.shape[2] == 1 else np.concatenate([texels, np.zeros_like(texels[..., :1])], -1) \
        if texels.shape[2] == 2 else texels
    return {"texture": png_bytes(texels if source.srgb else linear_to_srgb(texels)), "raw": png_bytes(texels), "srgb": source.srgb}


def _table(table: Node, names: Mapping[Node, str]):
    if table in names:
        return names[table]
    if table.op.name != "constant":
        return {}
    array = table.attrs["data"].array.reshape(-1, table.channels)[:table.extent.count]
    return pack(array if table.channels > 1 else array[:, 0], "<f8")


def _columns(table) -> int:
    """Of a table of a bundle's meta."""
    shape = table.get("shape") if isinstance(table, Mapping) else None
    return shape[1] if isinstance(shape, list) and len(shape) == 2 and shape[1] in (2, 3, 4) else 1


# ---- and back

class Sources:
    """The sources of a part's material, read with care. value: of the session by name; linear: whether the colours that are drawn are,
    and not shown as they are. Raises BundleError."""

    def __init__(self, entry: Mapping, where: str, value: Callable[[str], np.ndarray], mesh: Mesh, linear: bool = True):
        self.entry, self.where, self.value, self.mesh = entry, where, value, mesh
        self.linear = linear or entry.get("kind") == "pbr"
        self.uv_sets: dict[int, tuple[np.ndarray, np.ndarray]] = {} if mesh.uvs is None else {0: (mesh.uvs, mesh.uv_faces)}

    def _flat(self, key: str) -> list[Mapping]:
        """The factors of a source."""
        found, stack = [], [self.entry.get(key)]
        while stack:
            source = stack.pop(0)
            if not isinstance(source, Mapping) or len(found) > 99:
                raise BundleError(f"{self.where}.{key} is malformed; compile the bundle again")
            if "product" in source:
                stack = [*source["product"], *stack]
            else:
                found.append(source)
        if not all(found):
            note(f"{self.where}.{key} is worked out by a function, and is left out")
        return [x for x in found if x]

    def factor(self, key: str, count: int) -> np.ndarray:
        """The product of the numbers of a source, (count,)."""
        total = np.ones(count)
        for x in self._flat(key):
            if "numbers" in x or "value" in x:
                number = np.asarray(x["numbers"] if "numbers" in x else self.value(x["value"]), float).reshape(-1)
                if len(number) not in (1, count):
                    raise BundleError(f"{self.where}.{key} has {len(number)} numbers; {count} are needed; compile the bundle again")
                total = total * number
        return total

    def textures(self, key: str) -> list[tuple[Mapping, str]]:
        """The textures of a source, each with the channels that are taken of it ("" for all)."""
        out = []
        for x in self._flat(key):
            inner, channel = (x["of"], x["channel"]) if "of" in x else (x, "")
            if isinstance(inner, Mapping) and "texture" in inner:
                out.append((inner, channel))
        return out

    def colors(self, key: str) -> tuple[np.ndarray, np.ndarray | None] | None:
        """Colours (n, 3) of vertices (None) or corners (their faces) of a source, linear."""
        factors = self._flat(key)
        found = [(x, kind) for x in factors for kind in ("vertices", "corners") if kind in x]
        if len(found) > 1 or any("vertices" in x["of"] or "corners" in x["of"] for x in factors if isinstance(x.get("of"), Mapping)):
            note(f"{self.where}.{key} has more of vertices or corners than one colour, which is all that files have; the rest is left out")
        if not found:
            return None
        (x, kind), *_ = found
        table, where = x[kind], f"{self.where}.{key}"
        values = self.value(table) if isinstance(table, str) else unpack(table, where, "<f8", _columns(table))
        values = np.asarray(values, float).reshape(len(values), -1)
        values = np.repeat(values, 3, -1) if values.shape[1] == 1 else values[:, :3]
        if values.shape[1] != 3:
            note(f"{where} has {values.shape[1]} numbers for each of vertices or corners, which are no colour, and is left out")
            return None
        return values, unpack(x["faces"], f"{where}.faces", "<i4", 3) if kind == "corners" else None

    def mean(self, key: str, count: int) -> np.ndarray:
        """(count,) of a source that is of vertices or corners: the mean over them, which is what a file can have of it; ones of others."""
        total = np.ones(count)
        for x in self._flat(key):
            inner, channels = (x["of"], x["channel"]) if "of" in x else (x, "xyzw")
            table = inner.get("vertices", inner.get("corners")) if isinstance(inner, Mapping) else None
            if table is None:
                continue
            values = self.value(table) if isinstance(table, str) else unpack(table, f"{self.where}.{key}", "<f8", _columns(table))
            means = np.asarray(values, float).reshape(len(values), -1).mean(0)
            total = total * [means[k] for k in map("xyzw".find, channels) if 0 <= k < len(means)]
            note(f"{self.where}.{key} is of vertices or corners, which files have of colours alone; its mean is written")
        return total

    def texels(self, found: Mapping, encoded: bool) -> np.ndarray:
        """(h, w, c) of a texture: sRGB encoded, or as it is sampled."""
        image, srgb = found["texture"], bool(found.get("srgb"))
        if isinstance(image, str):
            texels = np.clip(np.asarray(self.value(image), float), 0.0, 1.0)
            texels = texels[..., None] if texels.ndim == 2 else texels
            return (texels if srgb else linear_to_srgb(texels)) if encoded else (srgb_to_linear(texels) if srgb else texels)
        data = image if encoded else found.get("raw", image)
        if not isinstance(data, bytes):
            raise BundleError(f"{self.where} has a texture of {type(data).__name__}; compile the bundle again")
        texels = Picture("texture", data).texels()[..., :3]
        return srgb_to_linear(texels) if srgb and not encoded else texels

    def coordinates(self, found: Mapping) -> tuple[np.ndarray, np.ndarray]:
        """Texture coordinates (n, 2) and their faces, moved."""
        if "uvs" in found:
            uvs, faces = unpack(found["uvs"], f"{self.where}.uvs", "<f8", 2), unpack(found["uv_faces"], f"{self.where}.uv_faces", "<i4", 3)
        elif self.mesh.uvs is not None:
            uvs, faces = self.mesh.uvs, self.mesh.uv_faces
        else:
            raise BundleError(f"{self.where} has a texture, but its mesh no texture coordinates; compile the bundle again")
        for transform in found.get("moves", ()):
            uvs = moved(uvs, transform)
        return uvs, faces

    def map(self, found: Mapping, texels: np.ndarray, name: str) -> TextureMap:
        """A map of a file with coordinates of its own."""
        number = len(self.uv_sets)
        self.uv_sets[number] = self.coordinates(found)
        return TextureMap(Picture(name, png_bytes(texels)), number, wrap=tuple(found.get("wrap", ("repeat", "repeat"))))

    def material(self, name: str) -> tuple[Material, Mesh]:
        """What a file has of it, and the mesh with the base colour's texture, coordinates and colours of vertices."""
        mesh, m = self.mesh, Material(name, unlit=self.entry.get("kind") == "unlit", double_sided=bool(self.entry.get("two_sided")))
        color = np.clip(self.factor("color", 3), 0.0, 1.0)
        color = color if self.linear else srgb_to_linear(color)
        m = replace(m, base_color=(*map(float, color), 1.0), stated=True)
        if found := self.textures("color"):
            uvs, faces = self.coordinates(found[0][0])
            wrap, texels = tuple(found[0][0].get("wrap", ("repeat",) * 2)), self._shown(*found[0])
            mesh = replace(mesh, uvs=uvs, uv_faces=faces, texture=texels)
            m = replace(m, base_texture=TextureMap(Picture(f"{name} base colour", None), wrap=wrap))
            if len(found) > 1:
                note(f"{self.where}: of {len(found)} textures of its colour the first is written")
        if colors := self.colors("color"):
            values, faces = colors
            values = np.clip(values, 0.0, 1.0)
            mesh = replace(mesh, colors=linear_to_srgb(values) if self.linear else values, color_faces=faces)
        if self.entry.get("kind") == "pbr":
            m = self._physical(m, name)
        return m, mesh

    def _shown(self, found: Mapping, channels: str) -> np.ndarray:
        """(h, w, 3): the channels of a texture as files have colours, sRGB encoded; one is a grey."""
        texels = self.texels(found, self.linear)
        picked = ["xyzw".find(c) for c in channels or "xyzw"[:texels.shape[2]]][:3]
        if len(picked) not in (1, 3) or not all(0 <= k < texels.shape[2] for k in picked):
            note(f"{self.where}: its colour takes {channels or len(picked)} of a texture of {texels.shape[2]} channels, which is no "
                 "colour; the texture is written as it is")
            picked = [min(k, texels.shape[2] - 1) for k in range(3)]
        return texels[..., picked if len(picked) == 3 else picked * 3]

    def _physical(self, m: Material, name: str) -> Material:
        rough, metal = self.textures("roughness"), self.textures("metallic")
        m = replace(m, **{key: _one(self.factor(key, 1) * self.mean(key, 1)) for key in ("roughness", "metallic")})
        if rough or metal:
            m = replace(m, metallic_roughness_texture=self._packed(rough, metal, name))
        if found := self.textures("occlusion"):
            texels = self._channel(*found[0])
            strength = _one(self.factor("occlusion_strength", 1)) if "occlusion_strength" in self.entry else 1.0
            m = replace(m, occlusion_texture=self.map(found[0][0], np.repeat(texels, 3, -1), f"{name} occlusion"),
                        occlusion_strength=strength)
        if "normal" in self.entry and (found := self.textures("normal")):
            m = replace(m, normal_texture=self.map(found[0][0], self.texels(found[0][0], False), f"{name} normals"),
                        normal_scale=float(self.factor("normal_scale", 1)[0]))
        glow = self.textures("emissive")
        emissive = self.factor("emissive", 3) * self.mean("emissive", 3)
        m = replace(m, emissive=tuple(float(max(x, 0.0)) for x in emissive))
        if glow:
            m = replace(m, emissive_texture=self.map(glow[0][0], self.texels(glow[0][0], True), f"{name} emission"))
        return m

    def _channel(self, found: Mapping, channel: str) -> np.ndarray:
        """(h, w, 1): the channel of a texture, its first if none is named."""
        texels, k = self.texels(found, False), "xyzw".find(channel or "x")
        if not 0 <= k < texels.shape[2]:
            raise BundleError(f"{self.where} takes channel {channel!r:.20} of a texture of {texels.shape[2]}; compile the bundle again")
        return texels[..., k:k + 1]

    def _packed(self, rough: Sequence, metal: Sequence, name: str) -> TextureMap:
        """Roughness in green and metallic in blue, in the coordinates of the first that there is."""
        green, blue = (self._channel(*found[0]) if found else None for found in (rough, metal))
        if green is not None and blue is not None and green.shape != blue.shape:
            note(f"{self.where}: its roughness has {green.shape[1]}x{green.shape[0]} texels and its metallic "
                 f"{blue.shape[1]}x{blue.shape[0]}, which glTF has in one picture; of metallic the mean is written")
            blue = np.full_like(green, blue.mean())
        one = np.ones_like(green if green is not None else blue)
        texels = np.concatenate([one, one if green is None else green, one if blue is None else blue], -1)
        return self.map((rough or metal)[0][0], texels, f"{name} metallic roughness")


def _one(x: np.ndarray) -> float:
    return float(np.clip(x[0], 0.0, 1.0))
