"""The tables of docs/drivers.md.

    python -m tests.drivers.tables [GROUP or names of drivers]

Every driver runs what `make test-drivers` runs, and the whole problems once more as they are compiled for `AGAINST`, the profile that
one would take for a desktop of which one knows nothing. Drivers on an emulated processor compile the shaders of one step of the whole
problems as they are compiled for these two, the latter without the validation layer, and no more: ten minutes each. Results of drivers
that are not named stay in benchmarks/results/drivers.json.
"""

from __future__ import annotations

import datetime
import json
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from dressi_edge.cache.profile import Profile

from . import catalog, fetch, session, whole

RESULTS = session.ROOT / "benchmarks" / "results" / "drivers.json"
DOCS = session.ROOT / "docs" / "drivers.md"
AGAINST = "limit8"
MARKS = "<!-- drivers -->\n", "<!-- /drivers -->\n"
PROBLEMS = [name for name in whole.CASES if name != "behind"]


def measure(name: str, bundles: dict[str, list[Path]]) -> Iterator[dict]:
    """What a driver did with the bundles of its own profile, and once more, with those of AGAINST, too."""
    driver, packages = catalog.DRIVERS[name], fetch.ready(name)

    def folders(profile: Profile) -> list[Path]:
        if profile.digest not in bundles:
            bundles[profile.digest] = [Path(tempfile.mkdtemp(prefix="dressi_drivers_")) for _ in range(2)]
            whole.vectors(profile, bundles[profile.digest][0])
            for problem in whole.CASES:
                whole.write(problem, profile, bundles[profile.digest][1])
        return bundles[profile.digest]

    def sums(outcome: session.Outcome) -> dict[str, dict]:
        return {r["name"]: _sums(r) for r in outcome.results if r["name"] in PROBLEMS}

    shaders = driver.group == "arm"
    own = session.run(name, packages, folders(Profile.load(driver.profile))[shaders:], shaders, tell=_told)
    found = {"device": own.device.get("device", "?"), "driver": own.device.get("driver", "?"), "profile": driver.profile,
             "bundles": len(own.results), "shaders_alone": shaders, "faults": list(own.faults), "executes": driver.executes,
             "deviation": max((r["deviation"] for r in own.results), default=None) if driver.executes else None,
             "own": sums(own), "against": {}, "date": datetime.date.today().isoformat()}
    yield found
    yield found | {"against": sums(session.run(name, packages, folders(Profile.load(AGAINST))[1:], shaders, not shaders, _told))}


def _told(r: dict) -> None:
    """A line for each bundle as soon as it is done."""
    sums = _sums(r)
    print(f"  {r['name']}: {r['error'] or 'done'} in {r['seconds']:.0f} s; {sums['pipelines']} pipelines of fit, spills {sums['spills']}, "
          f"cycles {sums['cycles']}, instructions {sums['instructions']}", flush=True)


def _sums(r: dict) -> dict:
    """Of a problem's steps: the most registers, the fewest waves, all spills, instructions and cycles times pixels."""
    rows = [(pixels, told) for place, pixels, told, _ in r["statistics"] if place.startswith("fit[")]

    def over(what: str, pick):
        found = [(pixels, told[what]) for pixels, told in rows if what in told]
        return pick(found) if found else None

    return {"pipelines": len(rows), "registers": over("registers", lambda x: max(n for _, n in x)), "bytes": r["bytes"],
            "waves": over("waves", lambda x: min(n for _, n in x)), "spills": over("spills", lambda x: sum(n for _, n in x)),
            **{what: over(what, lambda x: sum(pixels * n for pixels, n in x)) for what in ("instructions", "cycles")}}


def text(results: dict[str, dict]) -> str:
    """Four tables: what ran, all together, shaders, memory."""
    lines = ["| driver | device | profile | bundles | faults | largest deviation |", "|---|---|---|---:|---:|---:|"]
    for name, r in results.items():
        nothing = "its shaders alone" if r.get("shaders_alone") else "draws nothing"
        deviation = f"{r['deviation']:.2g} of its tolerance" if r["executes"] else nothing
        cells = name, f"{r['device'].strip()}, {r['driver']}", r["profile"], str(r["bundles"]), str(len(r["faults"])), deviation
        lines.append(f"| {' | '.join(cells)} |")
    lines += ["", f"All problems together, compiled for {AGAINST} and for the device's own profile: spills of a step; what the compiler",
              "estimates for a step, relative to the former; MB of all images.", "",
              "| driver | spills | estimate | MB |", "|---|---:|---:|---:|"]
    lines += [f"| {name} | {' | '.join(_together(r))} |" for name, r in results.items() if not r["executes"]]
    lines += ["", f"Shaders of one step, compiled for the device's own profile: spills (compiled for {AGAINST}), most registers, fewest",
              f"waves, and what the compiler estimates for the step relative to that for {AGAINST}: cycles, or where it gives none",
              "instructions, times pixels.", "",
              "| driver | " + " | ".join(PROBLEMS) + " |", "|---|" + "---|" * len(PROBLEMS)]
    for name, r in results.items():
        if any(x["instructions"] for x in r["own"].values()):
            lines.append(f"| {name} | " + " | ".join(_cell(r["own"].get(p), r["against"].get(p)) for p in PROBLEMS) + " |")
    lines += ["", f"kB of the images, small as these problems are: their texels, what the device takes compiled for {AGAINST}, and for its",
              "own profile:", "",
              "| driver | " + " | ".join(PROBLEMS) + " |", "|---|" + "---|" * len(PROBLEMS)]
    for name, r in results.items():
        lines.append(f"| {name} | " + " | ".join(_bytes(r["own"].get(p), r["against"].get(p)) for p in PROBLEMS) + " |")
    return "\n".join(lines) + "\n"


def _together(r: dict) -> list[str]:
    """Of all problems: spills before and after, the ratio of estimates, bytes before and after; what is not known is a dash."""
    own, other = list(r["own"].values()), list(r["against"].values())
    what = "cycles" if all(x["cycles"] for x in own) else "instructions"

    def total(of: list[dict], pick) -> float | None:
        found = [pick(x) for x in of]
        return sum(found) if found and None not in found else None

    def told(of: list[dict], pick, form: str) -> str:
        found = total(of, pick)
        return "-" if found is None else format(found, form)

    sums = [total(of, lambda x: x[what] or None) for of in (own, other)]
    return [f"{told(other, lambda x: x['spills'], 'g')} -> {told(own, lambda x: x['spills'], 'g')}",
            f"{sums[0] / sums[1]:.2f}" if all(sums) else "-",
            f"{told(other, lambda x: x['bytes'][1] / 1e6, '.1f')} -> {told(own, lambda x: x['bytes'][1] / 1e6, '.1f')}"]


def _cell(own: dict | None, other: dict | None) -> str:
    if not own or not own["instructions"]:
        return "-"
    what = "cycles" if own["cycles"] else "instructions"
    ratio = f", {own[what] / other[what]:.2f}" if other and other.get(what) else ""
    before = "" if not other or other["spills"] is None else f" ({other['spills']:g})"
    return f"{own['spills'] or 0:g}{before}, {own['registers'] or '-'}, {own['waves'] or 0:g}{ratio}"


def _bytes(own: dict | None, other: dict | None) -> str:
    if not own or not own["bytes"][1]:
        return "-"
    before = f", {other['bytes'][1] / 1e3:.0f}" if other and other["bytes"][1] else ""
    return f"{own['bytes'][0] / 1e3:.0f}{before}, {own['bytes'][1] / 1e3:.0f}"


def keep(results: dict[str, dict]) -> None:
    """The JSON and the page, drivers in the catalog's order."""
    results = {name: results[name] for name in catalog.DRIVERS if name in results}
    RESULTS.write_text(json.dumps(results, indent=1) + "\n")
    before, _, rest = DOCS.read_text().partition(MARKS[0])
    DOCS.write_text(before + MARKS[0] + "\n" + text(results) + "\n" + MARKS[1] + rest.partition(MARKS[1])[2])


def main() -> int:
    results = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
    bundles: dict[str, list[Path]] = {}
    for name in catalog.chosen(" ".join(sys.argv[1:]) or "all"):
        try:
            for found in measure(name, bundles):
                results[name] = found
                keep(results)  # as soon as there is something
                print(f"{name}: {found['bundles']} bundles, {len(found['faults'])} faults", flush=True)
        except fetch.Missing as why:
            print(f"{name}: left out: {why}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
