"""Lights of a glTF scene (KHR_lights_punctual): a .gltf or .glb file in; `PlacedLight`s in world space out."""
from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...cache.errors import InputError, note
from .gltf import placed_nodes
from .pieces import listed

EXTENSION = "KHR_lights_punctual"
KINDS = ("directional", "point", "spot")


@dataclass(frozen=True)
class PlacedLight:
    """kind: one of KINDS. power: colour times intensity, linear: of a directional light its irradiance (glTF's lux), else its intensity
    (candela). position: of what is not directional. direction: in which the light travels, of length 1. cone: of a spot, the angles from
    that in radians up to which it is whole, and from which on there is none."""

    name: str
    kind: str
    power: tuple[float, float, float]
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    direction: tuple[float, float, float] = (0.0, 0.0, -1.0)
    cone: tuple[float, float] = (0.0, math.pi / 4)


def gltf_lights(path: str | Path) -> tuple[PlacedLight, ...]:
    """The lights of the file's default scene, in the order of its nodes; none where it has none. Raises InputError, naming the file."""
    path, out, ranged = Path(path), [], []
    document, nodes = placed_nodes(path)
    lights = _extension(document.json, path).get("lights", [])
    for index, node, world in nodes:
        found = _extension(node, path)
        if not found:
            continue
        where = f"{path} node {index}"
        which = found.get("light")
        if type(which) is not int or not 0 <= which < len(lights):
            raise InputError(f"{where} names light {which!r:.20}, but there are {len(lights)}; export it again")
        entry = lights[which]
        kind, name = entry.get("type"), str(node.get("name") or entry.get("name") or f"light {len(out)}")
        if kind not in KINDS:
            raise InputError(f"{where} is a light of type {kind!r:.40}; {' '.join(KINDS)} are known; export it again")
        color = _numbers(entry.get("color", [1.0] * 3), 3, f"{where} color")
        intensity, = _numbers([entry.get("intensity", 1.0)], 1, f"{where} intensity")
        axis = -world[:3, 2]
        length = float(np.linalg.norm(axis))
        if not (math.isfinite(length) and length > 0.0):
            raise InputError(f"{where} is a light whose transform has no direction; export it again")
        cone = PlacedLight.cone
        if kind == "spot":
            spot = entry.get("spot", {})
            cone = tuple(_numbers([spot.get("innerConeAngle", 0.0), spot.get("outerConeAngle", math.pi / 4)], 2, f"{where} cone"))
            if not 0.0 <= cone[0] < cone[1] <= math.pi / 2 + 1e-6:
                raise InputError(f"{where} has a cone from {cone[0]:g} to {cone[1]:g}; 0 <= inner < outer <= pi / 2 is needed")
            cone = cone[0], min(cone[1], math.pi / 2)
        if "range" in entry:
            ranged.append(name)
        out.append(PlacedLight(name, kind, tuple(x * intensity for x in color), tuple(world[:3, 3].tolist()),
                               tuple((axis / length).tolist()), cone))
    if ranged:
        note(f"{path}: lights {listed(ranged)} have a range, beyond which some viewers end them; here they go on")
    return tuple(out)


def _extension(entry: dict, path: Path) -> dict:
    """What the extension says of an entry; nothing where it says nothing."""
    found = entry.get("extensions", {})
    found = found.get(EXTENSION, {}) if isinstance(found, dict) else None
    if not isinstance(found, dict):
        raise InputError(f"{path} is not well-formed glTF: extensions are no object; export it again")
    return found


def _numbers(values, count: int, what: str) -> list[float]:
    if not isinstance(values, (list, tuple)) or len(values) != count or not all(
            isinstance(x, (int, float)) and not isinstance(x, bool) and math.isfinite(x) and x >= 0.0 for x in values):
        raise InputError(f"{what} of a light is {values!r:.60}; {count} numbers from 0 are needed; export it again")
    return [float(x) for x in values]
