"""Counting and running sums alone: bincount and exclusive_scan with and without shared memory, against NumPy's bincount and cumsum.

    python benchmarks/scan.py [--quick] [--device NAME] [--profile NAME] [--json FILE]

Entries fall into bins as faces into tiles: their number in each bin, and where each bin begins in a list by bin. "drawn" is without
compute, "kernels" with; both are compared with NumPy, and the program stops if one entry differs. ms and cpu_ms: medians of runs that are
submitted and waited for one by one, entries and results already on the device; of NumPy, of one call of each. It has one thread.
ratio: of processor time to NumPy's.
"""

from __future__ import annotations

import argparse
import tempfile
from contextlib import ExitStack
from pathlib import Path

import numpy as np
from step import Meter, options_of, rounded, table, take_turns, write

from dressi_edge import runtime
from dressi_edge.cache import bundle as bundles
from dressi_edge.cache.layout import Layout
from dressi_edge.cache.profile import Profile
from dressi_edge.compiler import Options, Program, build
from dressi_edge.compiler.graph.functions import bincount, exclusive_scan, lookup
from dressi_edge.runtime.device import Device

SIZES = ((10_000, 1024), (100_000, 4096), (1_000_000, 4096), (1_000_000, 65536))
KINDS = {"drawn": "none", "kernels": "ops"}
COLUMNS = ("entries", "bins", "how", "stages", "ms", "cpu_ms", "ratio")


def counting(n: int, bins: int, scan: bool) -> Program:
    """A phase that computes all of it whenever it is stepped (without the cache): counts and where they begin, or running sums."""
    p = Program()
    index = p.input("index", Layout("table", "int", count=n))
    made = exclusive_scan(index) if scan else bincount(index, bins)
    last = lookup(made, np.array([made.extent.count - 1]))  # nothing else is taken from the device
    if not scan:
        begins = exclusive_scan(made)
        last = lookup(begins, np.array([bins - 1])) + last
    p.plan("count", {"sum": p.state("sum", Layout("unit", "int")) * 0 + last},
           {"made": (made, Layout("table", "int", count=made.extent.count))})
    return p


def measure(n: int, bins: int, scan: bool, device: Device, folder: Path, options) -> list[dict]:
    index = np.random.default_rng(0).integers(0, bins, n).astype(np.int32)
    right = np.cumsum(index, dtype=np.int32) - index if scan else np.bincount(index, minlength=bins)
    rows, meters = [], []
    with ExitStack() as stack:
        for how, kind in KINDS.items():
            built = build(counting(n, bins, scan), Profile.load(options.profile), Options(compute=kind, cache=False))
            path = folder / f"{how}.dressi"
            bundles.write(path, built.description, built.blobs)
            session = stack.enter_context(runtime.load(path, device))
            session.set("index", index)
            session.step(1)
            if not np.array_equal(session.get("made"), right):
                raise SystemExit(f"{how}: other numbers than NumPy's for {n} entries")
            rows.append({"entries": n, "bins": "scan" if scan else bins, "how": how, "stages": len(built.stages["count"])})
            meters.append(Meter(lambda s=session: s.step(1)))

        def numpy() -> None:
            counts = index if scan else np.bincount(index, minlength=bins)
            np.cumsum(counts, dtype=np.int32) - counts

        rows.append({"entries": n, "bins": "scan" if scan else bins, "how": "NumPy", "stages": ""})
        meters.append(Meter(numpy))
        take_turns(meters, options.seconds, 5)
    for row, meter in zip(rows, meters):
        row |= meter.row
    for row in rows:
        row["ratio"] = rounded(row["cpu_ms"] / rows[-1]["cpu_ms"])
    return rows


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options = options_of(parser, arguments)
    results = []
    with tempfile.TemporaryDirectory(prefix="dressi-scan-") as name, Device.open(options.device) as device:
        for n, bins in SIZES[:2] if options.quick else SIZES:
            for scan in (False, True) if bins == 4096 else (False,):
                results += measure(n, bins, scan, device, Path(name), options)
                print(table(results[-3:], COLUMNS), flush=True)
        report = {"device": device.name, "driver": device.driver, "profile": options.profile}
    write(options.json, report, results)


if __name__ == "__main__":
    main()
