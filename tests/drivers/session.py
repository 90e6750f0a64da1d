"""One driver's run over folders of bundles. In: a driver's name. Out: `Outcome`, what it did and what is wrong with that."""

from __future__ import annotations

import json
import subprocess
import tempfile
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from . import catalog

ROOT = Path(__file__).resolve().parents[2]
SECONDS = {"quick": 300, "rest": 300, "arm": 3600}


@dataclass(frozen=True)
class Outcome:
    """device: what the driver says of itself. results: a record a bundle, as `replay.py` has it. faults: a line each."""

    device: dict
    results: tuple[dict, ...]
    faults: tuple[str, ...]


def run(name: str, packages: Path, folders: Sequence[Path], shaders: bool = False, checked: bool = True,
        tell: Callable[[dict], None] | None = None) -> Outcome:
    """Every bundle of these folders on this driver, under the validation layer if `checked`. packages: the folder that `fetch` keeps.
    shaders: the pipelines of `fit` are made, and nothing else. tell: hears of every bundle as soon as it is done."""
    driver = catalog.DRIVERS[name]
    words, environment = catalog.command(driver, packages, str(Path(__file__).with_name("replay.py")), str(ROOT),
                                         *["--shaders"] * shaders, *["--unchecked"] * (not checked), *map(str, folders))
    wanted = [path.stem for folder in folders for path in sorted(folder.glob("*.dressi"))]
    records, late = [], threading.Event()
    with tempfile.TemporaryFile("w+", errors="replace") as errors, subprocess.Popen(
            words, env=environment, stdout=subprocess.PIPE, stderr=errors, text=True, cwd=ROOT) as process:
        patience = threading.Timer(SECONDS[driver.group], lambda: (late.set(), process.kill()))
        patience.start()
        for line in process.stdout:
            if line.startswith("{") and line.endswith("}\n"):
                records.append(json.loads(line))
                if tell is not None and "name" in records[-1]:
                    tell(records[-1])
        code = process.wait()
        patience.cancel()
        errors.seek(0)
        last = errors.read().strip().splitlines()[-3:]
    device = records[0] if records else {}
    results = tuple(r for r in records if "name" in r)
    faults = [line for r in results for line in _faults(driver, r)]
    if not records or "closed" not in records[-1]:
        at = wanted[len(results)] if len(results) < len(wanted) else "closing"
        ended = f"after {SECONDS[driver.group]} seconds" if late.is_set() else f"with exit code {code}"
        faults.append(f"{at}: the process ended {ended}: {' | '.join(last)}")
    else:
        faults += [f"closing: layer: {line}" for line in records[-1]["closed"]]
    return Outcome(device, results, tuple(faults))


def _faults(driver: catalog.Driver, r: dict) -> list[str]:
    lines = [f"{r['name']}: {r['error']}"] if r["error"] else []
    lines += [f"{r['name']}: layer: {line}" for line in r["messages"]]
    if driver.executes and r["deviation"] > 1:
        lines.append(f"{r['name']}: {r['where']} is off by {r['deviation']:.3g} times its tolerance")
    return lines
