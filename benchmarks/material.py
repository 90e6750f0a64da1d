"""What a material costs a step: one view, textures of 1024 x 1024, geometry and light at rest; and light and roughness together.

    python benchmarks/material.py [--size PIXELS] [--turns N] [--profile NAME]

A ball of 5120 faces. Milliseconds of wall clock and of processor time a step, medians of turns in which the cases alternate; ratios to the
unlit texture within a turn. Stages of a step and distinct pipelines of each profile of the matrix with --profiles.
"""
from __future__ import annotations

import argparse
import json
import os
import resource
import tempfile
import time
from pathlib import Path

import numpy as np

from dressi_edge import runtime
from dressi_edge.compiler.scene import (
    PBR,
    Adam,
    Channel,
    Environment,
    Lambert,
    Light,
    NormalMap,
    Scene,
    Texture,
    Unlit,
    l2,
    octahedral,
    orbit,
    sphere,
)

RESULTS = Path(__file__).resolve().parent / "results" / "material.json"
SUN = [Light("directional", 3.0, (-1.0, -1.0, -0.6))]


def sky(n: int = 64) -> np.ndarray:
    """An octahedral map of a bright upper half with a sun."""
    y, x = np.mgrid[:64, :128]
    sun = 9.0 * np.exp(-((x - 90) ** 2 + (y - 20) ** 2) / 30.0)
    return octahedral(np.where(y < 32, 0.9, 0.3)[..., None] * [0.8, 0.9, 1.0] + sun[..., None], n)


def case(name: str, size: int, texels: int) -> Scene:
    """A scene with a phase "fit"."""
    s = Scene(orbit(1, [20], 2.2, 45, (size, size)))
    ball = sphere(2562, 0.8)

    def image(key: str, start) -> Texture:
        return Texture(s.parameter(key, np.full((texels, texels, 3), start), 0.02, 1.0, kind="image"))

    if name == "environment, roughness":
        around = Environment(s.parameter("sky", sky(), low=0.0, kind="image"))
        material = PBR((0.9, 0.8, 0.6), s.parameter("roughness", 0.3, low=0.02, high=1.0), 1.0, environment=around)
    else:
        base = image("base", 0.5)
        if name == "unlit":
            material = Unlit(base)
        elif name == "lambert":
            material = Lambert(base, SUN)
        else:
            maps = image("maps", 0.5)
            around = Environment(sky()) if "environment" in name else None
            bent = NormalMap(image("normals", (0.5, 0.5, 1.0))) if "normals" in name else None
            material = PBR(base, Channel(maps, "y"), Channel(maps, "z"), normal=bent, lights=SUN, environment=around)
    s.add(ball, material=material)
    seen, photo = s.frame(), s.input("photo", np.full((1, size, size, 3), 0.3))
    s.phase("fit", 10, {key: Adam(1e-3) for key in s.parameters}, color=l2(seen.color, photo))
    return s


CASES = ("unlit", "lambert", "pbr", "pbr, normals", "pbr, normals, environment", "environment, roughness")


def spent() -> float:
    """Seconds of processor time of this process so far."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    arguments.add_argument("--size", type=int, default=256)
    arguments.add_argument("--texels", type=int, default=1024)
    arguments.add_argument("--turns", type=int, default=9)
    arguments.add_argument("--profile", default="lavapipe")
    arguments.add_argument("--profiles", nargs="*", help="only count stages and pipelines of these profiles")
    options = arguments.parse_args()
    if options.profiles:
        return counts(options.profiles, options.size, options.texels)
    with tempfile.TemporaryDirectory() as folder:
        sessions, wall, cpu = {}, {name: [] for name in CASES}, {name: [] for name in CASES}
        for k, name in enumerate(CASES):
            path = Path(folder) / f"{k}.dressi"
            case(name, options.size, options.texels).compile(options.profile, path)
            sessions[name] = runtime.load(path)
            sessions[name].step(3)
            sessions[name].loss()
        for _ in range(options.turns):
            for name, session in sessions.items():
                start, used = time.perf_counter(), spent()
                session.step(4)
                session.report()  # which waits
                wall[name].append((time.perf_counter() - start) / 4 * 1e3)
                cpu[name].append((spent() - used) / 4 * 1e3)
        rows = {name: {"wall_ms": float(np.median(wall[name])), "least_ms": float(np.min(wall[name])),
                       "cpu_ms": float(np.median(cpu[name])),
                       "ratio": float(np.median(np.divide(cpu[name], cpu["unlit"]))), "stages": len(sessions[name].plans["fit"]["stages"])}
                for name in CASES}
        report = {"size": options.size, "texels": options.texels, "profile": options.profile, "load": os.getloadavg()[0],
                  "cases": rows}
        for session in sessions.values():
            session.close()
    print(f"load {report['load']:.1f}\n{'case':28} {'wall ms':>8} {'least':>6} {'cpu ms':>7} {'ratio':>6} {'stages':>6}")
    for name, row in rows.items():
        print(f"{name:28} {row['wall_ms']:8.1f} {row['least_ms']:6.1f} {row['cpu_ms']:7.1f} {row['ratio']:6.2f} {row['stages']:6}")
    RESULTS.write_text(json.dumps(report, indent=1) + "\n")


def counts(profiles: list[str], size: int, texels: int) -> None:
    """Stages of a step and distinct pipelines of all plans, by profile and case."""
    shown = ("pbr, normals", "pbr, normals, environment", "environment, roughness")
    print(f"| profile | {' | '.join(shown)} |\n|---|{'---|' * len(shown)}")
    with tempfile.TemporaryDirectory() as folder:
        for profile in profiles:
            cells = []
            for name in shown:
                d = case(name, size, texels).compile(profile, Path(folder) / "x.dressi")
                stages = next(len(plan["stages"]) for plan in d["plans"] if plan["name"] == "fit")
                cells.append(f"{stages}, {len(d['pipelines'])}")
            print(f"| {profile} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
