"""Profiles of devices that are not there, as their drivers report them.

    python -m tests.drivers.capture [NAME..]    writes device_profiles/NAME.json anew, of catalog.CAPTURED

What a driver says of a GPU whose kernel does nothing is what it knows from the GPU's number: limits, features and formats are the real
ones; sizes of memory are not, and are in no profile.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

from dressi_edge.cache.errors import DeviceError
from dressi_edge.cache.profile import Profile
from dressi_edge.cache.profile_file import to_json

from . import catalog, fetch
from .session import ROOT

OWN = {"prefer_fp16": {"source": "dressi_edge: our choice, not a property of the device", "status": "assumed"},
       "tile_bits": {"source": "not reported: whether this driver merges subpasses is not known", "status": "assumed"}}


def capture(name: str) -> Profile:
    """The profile of that name. Raises `fetch.Missing`, DeviceError."""
    number, what = catalog.CAPTURED[name]
    driver, packages = catalog.DRIVERS[number], fetch.ready(number)
    with tempfile.TemporaryDirectory() as temporary:
        path = Path(temporary) / f"{name}.json"
        code = f"import sys; sys.path.insert(0, {str(ROOT)!r}); from dressi_edge.cli import main; sys.exit(main(sys.argv[1:]))"
        words, environment = catalog.command(driver, packages, "-c", code, "profiles", "capture", "-n", name, "-o", str(path))
        done = subprocess.run(words, env=environment, capture_output=True, text=True, timeout=300)
        if done.returncode:
            raise DeviceError(f"{number}: {done.stderr.strip()}")
        found = Profile.load(path)
    source = found.sources["*"]["source"] + ("" if driver.executes else ", without hardware (mesa-drm-shim)")
    kept = Profile.load(name) if (ROOT / "device_profiles" / f"{name}.json").exists() else found
    own = {key: value for key, value in kept.sources.items() if key not in ("*", *OWN)}
    limits = {**found.limits, **{key: kept.limits[key] for key in own if key in found.limits}}  # lower than the device's, with a reason
    return replace(kept, description=what, limits=limits, features=found.features, formats=found.formats, date=found.date,
                   table_width=found.table_width, api_version=found.api_version,
                   sources={"*": {"source": source, "status": "measured"}} | OWN | own)


def main() -> None:
    for name in sys.argv[1:] or catalog.CAPTURED:
        try:
            path = ROOT / "device_profiles" / f"{name}.json"
            path.write_text(to_json(capture(name)), encoding="utf-8")
            print(f"{name}: {path}")
        except fetch.Missing as why:
            print(f"{name}: left out: {why}")


if __name__ == "__main__":
    main()
