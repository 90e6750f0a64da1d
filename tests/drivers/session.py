"""One driver's run over folders of bundles. In: a driver's name. Out: `Outcome`, what it did and what is wrong with that."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Sequence
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


def run(name: str, packages: Path, folders: Sequence[Path], shaders: bool = False) -> Outcome:
    """Every bundle of these folders on this driver, under the validation layer. packages: the folder that `fetch` keeps. shaders: the
    pipelines of `fit` are made, and nothing else."""
    driver = catalog.DRIVERS[name]
    words, environment = catalog.command(driver, packages, str(Path(__file__).with_name("replay.py")), str(ROOT),
                                         *["--shaders"] * shaders, *map(str, folders))
    wanted = [path.stem for folder in folders for path in sorted(folder.glob("*.dressi"))]
    try:
        done = subprocess.run(words, env=environment, capture_output=True, text=True, timeout=SECONDS[driver.group], cwd=ROOT)
        lines, ended = done.stdout.splitlines(), f"with exit code {done.returncode}"
    except subprocess.TimeoutExpired as late:
        done, lines, ended = late, (late.stdout or b"").decode().splitlines(), f"after {SECONDS[driver.group]} seconds"
    records = [json.loads(line) for line in lines if line.startswith("{")]
    device = records[0] if records else {}
    results = tuple(r for r in records if "name" in r)
    faults = [line for r in results for line in _faults(driver, r)]
    if not records or "closed" not in records[-1]:
        last = (done.stderr or b"" if isinstance(done.stderr, bytes) else done.stderr or "")
        last = last.decode(errors="replace") if isinstance(last, bytes) else last
        at = wanted[len(results)] if len(results) < len(wanted) else "closing"
        faults.append(f"{at}: the process ended {ended}: {' | '.join(last.strip().splitlines()[-3:])}")
    else:
        faults += [f"closing: layer: {line}" for line in records[-1]["closed"]]
    return Outcome(device, results, tuple(faults))


def _faults(driver: catalog.Driver, r: dict) -> list[str]:
    lines = [f"{r['name']}: {r['error']}"] if r["error"] else []
    lines += [f"{r['name']}: layer: {line}" for line in r["messages"]]
    if driver.executes and r["deviation"] > 1:
        lines.append(f"{r['name']}: {r['where']} is off by {r['deviation']:.3g} times its tolerance")
    return lines
