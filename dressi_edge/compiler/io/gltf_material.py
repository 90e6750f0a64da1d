"""Materials of a glTF document: entry in, `Material` out, with samplers, texture coordinates' sets and KHR_texture_transform."""
from __future__ import annotations

import math

import numpy as np

from ...cache.errors import InputError, note
from .gltf_file import Document
from .materials import IDENTITY, Material, TextureMap

WRAPS = {10497: "repeat", 33071: "clamp", 33648: "mirror"}
SOURCES = ("EXT_texture_webp",)  # extensions that name an image that is read


def material_of(document: Document, index: int | None) -> Material:
    """The material of that number; without one the default, whose base colour is not stated."""
    if index is None:
        return Material(metallic=1.0)
    entry = document.get("materials", index)
    extensions = entry.get("extensions", {})
    pbr, glossy = entry.get("pbrMetallicRoughness", {}), extensions.get("KHR_materials_pbrSpecularGlossiness")
    name = str(entry.get("name", ""))
    where = f"{document.path} material {index}"
    if glossy is not None and "pbrMetallicRoughness" not in entry:
        factor, base = glossy.get("diffuseFactor"), glossy.get("diffuseTexture")
        metallic, roughness = 0.0, 1.0 - _one(glossy, "glossinessFactor", 1.0)
    else:
        factor, base = pbr.get("baseColorFactor"), pbr.get("baseColorTexture")
        metallic, roughness = _one(pbr, "metallicFactor", 1.0), _one(pbr, "roughnessFactor", 1.0)
    color = (1.0,) * 4 if factor is None else _numbers(factor, 4, f"{where} base colour")
    normal, occlusion = entry.get("normalTexture"), entry.get("occlusionTexture")
    strength = _one(extensions.get("KHR_materials_emissive_strength", {}), "emissiveStrength", 1.0)
    emissive = np.array(_numbers(entry.get("emissiveFactor", [0.0] * 3), 3, f"{where} emissiveFactor")) * strength
    mode = entry.get("alphaMode", "OPAQUE")
    if mode not in ("OPAQUE", "MASK", "BLEND"):
        raise InputError(f"{where}: alphaMode {mode!r:.20}; OPAQUE, MASK or BLEND is needed")
    base_map = _map(document, base, where)
    return Material(
        name, tuple(min(max(x, 0.0), 1.0) for x in color), base_map, metallic, roughness,
        _map(document, pbr.get("metallicRoughnessTexture"), where), _map(document, normal, where), _one(normal or {}, "scale", 1.0),
        _map(document, occlusion, where), _one(occlusion or {}, "strength", 1.0), tuple(emissive.tolist()),
        _map(document, entry.get("emissiveTexture"), where), mode, _one(entry, "alphaCutoff", 0.5), bool(entry.get("doubleSided", False)),
        "KHR_materials_unlit" in extensions, factor is not None or base_map is not None)


def _numbers(value, count: int, what: str) -> tuple[float, ...]:
    if not isinstance(value, list) or len(value) != count or not all(
            isinstance(x, (int, float)) and not isinstance(x, bool) and math.isfinite(x) for x in value):
        raise InputError(f"{what} is {value!r:.60}; {count} numbers are needed")
    return tuple(map(float, value))


def _one(entry: dict, key: str, default: float) -> float:
    return _numbers([entry.get(key, default)], 1, key)[0]


def _map(document: Document, info: dict | None, where: str) -> TextureMap | None:
    """The map of a textureInfo; None, with a warning, where only an extension that is not read has its image."""
    if info is None:
        return None
    texture = document.get("textures", info["index"])
    extensions = texture.get("extensions", {})
    source = next((extensions[name].get("source") for name in SOURCES if name in extensions), texture.get("source"))
    if source is None:
        note(f"{where}: a texture has its image in {' '.join(map(str, extensions)) or 'no place'}, which is not read; it is left out")
        return None
    sampler = document.get("samplers", texture["sampler"]) if "sampler" in texture else {}
    wrap = tuple(WRAPS.get(sampler.get(key, 10497)) for key in ("wrapS", "wrapT"))
    if None in wrap:
        raise InputError(f"{where}: a sampler's wrap mode is none of {' '.join(map(str, WRAPS))}; export it again")
    moved = info.get("extensions", {}).get("KHR_texture_transform", {})
    uv_set, transform = moved.get("texCoord", info.get("texCoord", 0)), IDENTITY
    if type(uv_set) is not int or uv_set < 0:
        raise InputError(f"{where}: texCoord is {uv_set!r:.20}; a whole number from 0 is needed")
    if set(moved) & {"offset", "rotation", "scale"}:
        (ou, ov), (su, sv) = (_numbers(moved.get(key, default), 2, f"{where} KHR_texture_transform {key}")
                              for key, default in (("offset", [0.0, 0.0]), ("scale", [1.0, 1.0])))
        turn = _one(moved, "rotation", 0.0)  # anticlockwise as one sees it, which is with v down from v to u
        c, s = math.cos(turn), math.sin(turn)
        transform = ((c * su, s * sv, ou), (-s * su, c * sv, ov))
    return TextureMap(document.picture(source), uv_set, transform, wrap)
