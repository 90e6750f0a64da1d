"""`bench`: where the time of a bundle goes on the device at hand."""
from __future__ import annotations

import time

from ..cache.summary import size, stage_bytes, substages, summary
from .files import print_json


def bench(args) -> None:
    """The command."""
    from .. import runtime
    with runtime.load(args.bundle, args.device, emulate=args.emulate, profile=args.profile, pin=args.pin) as session:
        d = session.bundle.description
        counts, results = summary(d), {}
        for plan in d["plans"]:
            name = plan["name"]
            if name in session.phases:
                session.step(1, name)  # drivers compile at the first draw
            ms = session.profile_stages(name, args.runs)
            results[name] = {**counts[name], "ms": sum(ms), "stage_ms": ms}
            if name in session.phases:
                results[name]["step_ms"] = _step(session, name, args.runs)
        report = {"device": session.device.name, "driver": session.device.driver, "profile": session.bundle.profile,
                  "plans": results}
    if args.json:
        print_json(report)
        return
    print(f"{report['device']}, {report['driver']}, profile {report['profile']}; medians of {args.runs} runs")
    for plan in d["plans"]:
        row = results[plan["name"]]
        whole = f"; a step takes {row['step_ms']:.2f} ms in all" if "step_ms" in row else ""
        print(f"\n{plan['name']}: {row['ms']:.2f} ms on the device, {row['bytes_per_step'] / 1e6:.2f} MB{whole}")
        for k, (stage, ms) in enumerate(zip(plan["stages"], row["stage_ms"])):
            share = 100 * ms / row["ms"] if row["ms"] else 0.0
            width, height = size(d, stage)
            print(f"  {k:3} {width:5} x {height:<5} {'compute    ' if 'compute' in stage else f'{substages(stage)} substages'} "
                  f"{stage_bytes(d, stage) / 1e6:8.2f} MB {ms:8.3f} ms {share:5.1f} %")


def _step(session, phase: str, runs: int) -> float:
    """Milliseconds of an iteration, host time included: the median of `runs` submissions."""
    times = []
    for _ in range(runs):
        start = time.perf_counter()
        session.step(1, phase)
        times.append((time.perf_counter() - start) * 1e3)
    return sorted(times)[len(times) // 2]
