"""What a photograph tells of roughness and metal: how much our picture of the truth changes with them.

    python benchmarks/gloss.py [--data DIR] [--size 128] [--samples 64] [--quick] [--json FILE]

The thing, its light and its photographs are those of inverse.py (Mitsuba's where it is installed, else ours). Root mean square differences
of colours, clipped to 0 to 1, over pixels of metal and of the rest: photographs against our picture of the truth; that against pictures
of the same thing with roughness or metal changed. What changes a picture less than photographs differ from it anyway cannot be found by it.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import tempfile
from pathlib import Path

import numpy as np
from inverse import ELEVATIONS, ROOT, Texture, Thing, Unlit, drawn, mitsuba_photographs, orbit, shaded, thing


def changed(of: Thing, what: str, by: float) -> Thing:
    """Everything rougher by so much, or what is metal less so."""
    maps = of.maps.copy()
    if what == "roughness":
        maps[..., 1] = np.clip(maps[..., 1] + by, 0.02, 1.0)
    else:
        maps[..., 2] = np.where(maps[..., 2] > 0.5, by, maps[..., 2])
    return Thing(of.mesh, of.color, maps, of.sky)


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=ROOT.parent / "shared")
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--samples", type=int, default=64, help="of Mitsuba, a pixel")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--profile", default="lavapipe")
    parser.add_argument("--device")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args(arguments)
    size = 32 if options.quick else options.size
    true, cameras = thing(options.data, 256), orbit(6, ELEVATIONS, 2.7, 42.0, (size, size))
    theirs = importlib.util.find_spec("mitsuba") is not None and not options.quick
    with tempfile.TemporaryDirectory(prefix="dressi-gloss-") as name:
        def look(of: Thing, material=None):
            return drawn(of.mesh, cameras, material or shaded(of, of.sky), Path(name), options)
        ours, alpha = look(true)
        photos, masks = mitsuba_photographs(true, cameras, options.samples) if theirs else (ours, alpha)
        inside, metal = (masks > 0.99) & (alpha > 0.99), look(true, Unlit(Texture(true.maps)))[0][..., 2]
        places = {"metal": inside & (metal > 0.9), "rest": inside & (metal < 0.1)}

        def row(case: str, a: np.ndarray, b: np.ndarray) -> dict:
            off = (np.clip(a, 0, 1) - np.clip(b, 0, 1)) ** 2
            return {"case": case, **{key: round(float(np.sqrt(off[where].mean())), 4) for key, where in places.items()}}
        rows = [row("photographs" if theirs else "ours", photos, ours)]
        for what, steps in (("roughness", (0.1, 0.15, 0.3)), ("metal", (0.7, 0.43, 0.2))):
            rows += [row(f"{what} {'+' if what == 'roughness' else ''}{by}", look(changed(true, what, by))[0], ours) for by in steps]
    print(json.dumps(rows, indent=1))
    if options.json:
        options.json.write_text(json.dumps({"size": size, "results": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
