"""Material files of OBJ: colours and maps in, `Material`s out.

After the MTL format's text and what exporters make of it: options before a name (and after it), quotes, backslashes, paths of another
machine. Kd is sRGB, as colour pickers show it, and times map_Kd. The PBR extension (Pr, Pm, norm) is read too.
"""
from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ...cache.errors import InputError, note
from ...cache.layout import beyond_fp32
from .images import srgb_to_linear
from .materials import IDENTITY, Material, TextureMap
from .pieces import decoded, listed, numbers
from .textures import Picture, find_file

OPTIONS = {"-blendu": 1, "-blendv": 1, "-boost": 1, "-bm": 1, "-cc": 1, "-clamp": 1, "-colorspace": 1, "-imfchan": 1, "-mm": 2, "-o": 3,
           "-s": 3, "-t": 3, "-texres": 1, "-type": 1}  # how many words follow each, at most
NUMERIC = ("-o", "-s", "-t")  # those may be followed by fewer
MAPS = {"map_kd": "base", "map_ke": "emissive", "norm": "normal"}
PLAIN = {"ka", "ks", "ns", "ni", "tf", "illum", "sharpness", "pc", "pcr", "ps", "aniso", "anisor", "km", "bsdf", "map_aat", "xr", "pfr"}


def read_mtl(path: Path) -> dict[str, Material]:
    """The materials of a file by name; warnings name what it has besides. Raises InputError, naming the line."""
    entries: dict[str, dict] = {}
    unread: dict[str, None] = {}
    entry: dict | None = None
    for number, line in enumerate(re.split(r"\r\n|\n|\r", decoded(path.read_bytes())), 1):
        words = line.strip(" \t\0\x1a").split(None, 1)
        if not words or words[0].startswith("#"):
            continue
        key, rest, where = words[0].lower(), words[1].strip() if len(words) > 1 else "", f"{path} line {number}"
        if key == "newmtl":
            entry = entries.setdefault(rest, {})
        elif entry is None:
            continue
        elif key in ("kd", "ke"):
            entry[key] = _color(rest, where, unread)
        elif key in ("d", "tr", "pr", "pm"):
            value = numbers(rest.replace("-halo", " ").split("#")[0].split()[:1] or ["?"], where)[0]
            entry["d" if key == "tr" else key] = float(np.clip(1.0 - value if key == "tr" else value, 0.0, 1.0))
        elif key in MAPS:
            if rest:
                entry[MAPS[key]] = _map(path, rest, where)
        elif key not in PLAIN:
            unread[words[0]] = None
    if unread:
        note(f"{path}: {listed(unread)} are not read")
    return {name: _material(path, name, entry) for name, entry in entries.items()}


def _color(rest: str, where: str, unread: dict) -> tuple[float, ...] | None:
    """Linear colour of `r g b`, or of one number for all three; None for a spectrum."""
    words = rest.split("#")[0].split()
    if words and words[0] in ("spectral", "xyz"):
        unread[f"colours as {words[0]}"] = None
        return None
    found = numbers(words[:3] or ["?"], where)
    stored = np.broadcast_to(found, 3) if len(found) == 1 else found
    if len(stored) != 3 or not np.isfinite(stored).all():
        raise InputError(f"{where}: {rest!r:.40} is no colour; three numbers are needed")
    if stored.max() > 1.0 and stored.max() <= 255.0 and (stored == np.floor(stored)).all() and stored.max() > 2.0:
        stored = stored / 255.0
    return tuple(srgb_to_linear(np.clip(stored, 0.0, 1.0)).tolist())


def _map(path: Path, rest: str, where: str) -> TextureMap:
    """A map's options and file. The file's name is the rest of the line; options behind it are those of programs that put them there."""
    options, name = _options(rest, where)
    file = find_file(path.parent, name)
    if file is None and (cut := re.search(r"\s+-[a-z]+\b", name)):
        behind, left = _options(name[cut.start():].strip() + " ", where)
        if not left and (file := find_file(path.parent, name[:cut.start()])):
            options, name = {**options, **behind}, name[:cut.start()]
    scale, offset = (_uv(options.get(key), default, f"{where}: option {key}") for key, default in (("-s", 1.0), ("-o", 0.0)))
    if ignored := [key for key in options if key in ("-mm", "-t", "-imfchan", "-bm", "-boost", "-cc")
                   and options[key] not in (["0", "1"], ["0", "0", "0"], ["on"] if key == "-cc" else ["1"], ["off"])]:
        note(f"{where}: options {listed(ignored)} of the map are not applied")
    # u' = s u + o counts v upwards; downwards v' = 1 - (s (1 - v) + o).
    transform = ((scale[0], 0.0, offset[0]), (0.0, scale[1], 1.0 - scale[1] - offset[1]))
    wrap = "clamp" if options.get("-clamp") == ["on"] else "repeat"
    return TextureMap(Picture(f"{name} (named in {path.name})", file), transform=IDENTITY if transform == IDENTITY else transform,
                      wrap=(wrap, wrap))


def _uv(words: list[str] | None, default: float, where: str) -> tuple[float, float]:
    found = [float(word) for word in words or ()][:2]
    if any(beyond_fp32(x) for x in found):
        raise InputError(f"{where} is {' '.join(words)!r:.60}; numbers that are finite in fp32 are needed")
    return tuple(found + [default] * (2 - len(found)))


def _options(text: str, where: str) -> tuple[dict[str, list[str]], str]:
    """Options at the start of a map's line, with their words, and what is left."""
    options: dict[str, list[str]] = {}
    while match := re.match(r"(-[a-zA-Z]+)\s+", text):
        key = match[1].lower()
        if key not in OPTIONS:
            break
        text, words = text[match.end():], []
        while len(words) < OPTIONS[key] and (word := re.match(r"(\S+)(?:\s+|$)", text)):
            if key in NUMERIC and not re.fullmatch(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", word[1]):
                break
            words.append(word[1])
            text = text[word.end():]
        options[key] = words
    return options, text.strip()


def _material(path: Path, name: str, entry: dict) -> Material:
    color, base = entry.get("kd"), entry.get("base")
    if base is not None and color == (0.0, 0.0, 0.0):
        note(f"{path}: material {name!r:.60} has Kd 0 0 0 and a map_Kd, which would be black; Kd counts as 1")
        color = None
    return Material(name, (*(color or (1.0, 1.0, 1.0)), entry.get("d", 1.0)), base, entry.get("pm", 0.0), entry.get("pr", 1.0),
                    normal_texture=entry.get("normal"), emissive=entry.get("ke") or ((1.0,) * 3 if "emissive" in entry else (0.0,) * 3),
                    emissive_texture=entry.get("emissive"), alpha_mode="BLEND" if entry.get("d", 1.0) < 1.0 else "OPAQUE",
                    stated=color is not None or base is not None)
