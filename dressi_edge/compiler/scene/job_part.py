"""One [[part]] table of a job, read and checked (docs/job.md)."""
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ..io.mesh import NORMALS, Mesh
from ..io.views import Views
from ..render.texture import Wrap
from .sections import SAMPLED, mesh_of, sampled, wrap_of
from .tables import Table

MATERIALS = {"unlit": ("color",), "lambert": ("color",), "blinn_phong": ("color", "specular", "gloss"),
             "pbr": ("color", "roughness", "metallic", "emissive", "normal")}
NUMBERS = {"specular": (0.3, 0.0), "gloss": (20.0, 1.0), "roughness": (0.5, 0.0, 1.0), "metallic": (0.0, 0.0, 1.0)}  # default, limits
MAPS = ("roughness", "metallic")  # which may be a texture
COLORS = ("texture", "colors")


@dataclass(frozen=True)
class PartTable:
    """What it says. load: of the views, the mesh; settings: of its material."""

    table: Table
    name: str
    load: Callable[[Callable[[], Views]], Mesh]
    normals: str | None
    kind: str
    settings: dict
    texture_size: tuple[int, int]
    wrap: Wrap | None
    sampled: dict
    pose: dict


def part_of(t: Table, folder: Path) -> PartTable:
    """Raises InputError."""
    name = t.word("name")
    if not name.replace("_", "").isalnum():
        raise t.wrong("name", name, "letters, digits and _ are allowed")
    keys = ("kind", "color", "texture_size", "wrap", *SAMPLED, "two_sided", *NUMBERS, "emissive", "normal")
    material = t.table("material", keys) if t.has("material") else Table({}, f"{t.where}.material", (), t.source)
    kind = material.word("kind", "unlit", tuple(MATERIALS))
    lit = () if kind == "unlit" else ("two_sided",)
    if wrong := [key for key in material.has(*NUMBERS, "emissive", "two_sided", "normal") if key not in (*MATERIALS[kind], *lit)]:
        raise material.conflict(f"{wrong[0]} is no setting of {kind}; drop it")
    color = material.get("color", None)
    if isinstance(color, list):
        color = material.numbers("color", 3, low=0, high=1)
    elif color is not None:
        color = material.word("color", allowed=COLORS)
    settings = {"color": color}
    for key in (key for key in MATERIALS[kind] if key in NUMBERS):
        default, *limits = NUMBERS[key]
        mapped = key in MAPS and material.get(key, None) == "texture"
        settings[key] = "texture" if mapped else material.number(key, default, *limits)
    if kind == "pbr":
        settings["emissive"] = material.numbers("emissive", 3, (0.0, 0.0, 0.0), low=0)
        settings["normal"] = material.word("normal", None, ("texture",))
    if lit:
        settings["two_sided"] = material.flag("two_sided", False)
    pose = {key: t.numbers(key, 3) for key in t.has("rotation", "translation")}
    pose |= {"scale": t.number("scale", low=0.0, above=True)} if t.has("scale") else {}
    return PartTable(t, name, mesh_of(t, folder), t.word("normals", None, NORMALS), kind, settings,
                      material.numbers("texture_size", 2, (512, 512), 1, 16384, whole=True), wrap_of(material),
                      sampled(material), pose)
