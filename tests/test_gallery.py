"""The programs of docs/examples/ as they stand, with fewer pixels and steps: each recovers what it says, and leaves its picture."""
import importlib.util
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
PROGRAMS = sorted((ROOT / "docs" / "examples").glob("*.py"))
SLOW = ("hidden", "inverse_rendering", "normal_map", "slant")  # a quarter of a minute each
SMALL = {  # what is given to main(), and what its numbers must say
    "antialiasing": ({"size": (80, 60), "samples": 8}, lambda r: r["contours"] > r["outline"] + 4 > r["sharp"] + 6 > r["paper_c"] + 6),
    "slant": ({"size": 48, "texels": 128, "steps": 30}, lambda r: r["anisotropy"]["rms"] < 0.5 * r["mips"]["rms"]
              < 0.4 * r["bilinear"]["rms"] and r["anisotropy"]["psnr"] > r["mips"]["psnr"] + 2 > r["bilinear"]["psnr"] + 3),
    "image_fit": ({"steps": 150}, lambda r: r["psnr"] > 28),
    "pose": ({"size": 64, "steps": 200}, lambda r: r["start"]["degrees"] > 25 and r["end"]["degrees"] < 1 and r["end"]["shift"] < 0.02),
    "two_objects": ({"size": 64, "steps": 150}, lambda r: min(r["start"].values()) > 0.15 and max(r["end"].values()) < 0.03),
    "gloss": ({"size": 64, "steps": 150}, lambda r: r["start"] > 0.4 and r["end"] < 0.05 and r["texels"] > 0.3),
    "material": ({"size": 64, "steps": 120}, lambda r: r["psnr"] > 32 and all(b < 0.9 * a for a, b in (r["roughness"], r["metal"]))),
    "normal_map": ({"size": 48, "steps": 60, "texels": (72, 48)}, lambda r: r["end"]["degrees"] < 0.6 * r["start"]["degrees"]),
    "blend_shapes": ({"size": 64, "steps": 120}, lambda r: r["end"] < r["start"] / 5),
    "depth_normals": ({"size": 64, "steps": 120}, lambda r: r["end"] < r["start"] / 8),
    "own_optimizer": ({"size": 48, "steps": 100}, lambda r: r["rmsprop"] < r["start"] / 50 and r["adam"] < r["start"] / 50),
    "own_op": ({"size": 48, "steps": 120}, lambda r: abs(r["end"]["height"] - 0.25) < 0.01 and abs(r["end"]["width"] - 0.2) < 0.02),
    "forward": ({"size": 96, "views": 4}, lambda r: 0.2 < r["covered"] < 0.6 and 1.5 < r["nearest"] < r["furthest"] < 3.0),
    "lbfgs": ({"size": 48, "steps": 60}, lambda r: r["start"]["degrees"] > 50 and r["end"]["degrees"] < 6 and r["end"]["colors"] < 0.12),
    "hidden": ({"size": 40, "steps": 100}, lambda r: r["behind"]["binned"] < 0.6 < 1.5 < min(r["behind"]["outline"], r["behind"]["K3"])
               and r["far"]["outline"] < 0.2 * r["far"]["start"]),
    "inverse_rendering": ({"size": 32, "steps": 25, "rounds": 1}, lambda r: all(
        x["psnr"][1] > x["psnr"][0] + 4 and x["metal"][1] < 0.97 * x["metal"][0] for x in r.values())
        and r["together"]["shape"][1] < 0.6 * r["together"]["shape"][0]),
    "numpy_loop": ({"size": 48, "steps": 40}, lambda r: r["end"] < r["start"] / 500),
}


def load(path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("path", [pytest.param(p, marks=pytest.mark.full if p.stem in SLOW else ()) for p in PROGRAMS],
                         ids=lambda p: p.stem)
def test_a_program_recovers_what_it_says(path, tmp_path, own_ops):
    options, right = SMALL[path.stem]
    found = load(path).main(str(tmp_path), **options)
    assert right(found), found
    picture = np.asarray(Image.open(tmp_path / f"{path.stem}.png"))
    assert picture.ndim == 3 and picture.std() > 5  # not one colour


def test_the_page_shows_every_program():
    page = (ROOT / "docs" / "gallery.md").read_text()
    assert [p.stem for p in PROGRAMS if not (f"(examples/{p.name})" in page and f"(gallery/{p.stem}.png)" in page)] == []
    assert [name for name in re.findall(r"\((gallery/\w+\.png)\)", page) if not (ROOT / "docs" / name).exists()] == []
