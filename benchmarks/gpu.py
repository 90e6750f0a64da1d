"""A real GPU in eight minutes, on a machine without network: devices, vectors, steps, textures, scaling, start; JSON out.

    python benchmarks/gpu.py prepare FOLDER [--quick]     anywhere: bundles, and a copy of what runs them (gpu.sh adds wheels and loader)
    python gpu.py run OUT.json [--device NAME] [--seconds N] [--validation]     there, in FOLDER; needs numpy and msgpack

Bundles have two variants, limit8 and vulkan_min; the first that fits runs. Triangles and sizes are those of the paper's Tables 4 and 5,
near enough: spheres of 20 n^2 faces at 256 to 2048, and textures of 1024 to 4096 at 2048. What does not fit into the seconds is left
out and named.

start     from the file to a session that can step, without and with compiled pipelines in the cache
first     the first step; a driver may compile in it
ms        a step, submitted and waited for in tens: median, and quartiles
losses    before, and after all steps
compiled  what the driver's compiler tells of each shader, where it tells anything: commands/statistics.py
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import statistics
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE if (HERE / "bundles").is_dir() else HERE.parent
sys.path[:0] = [str(ROOT)]

PROFILES = ("limit8", "vulkan_min")
FACES, SIZES, TEXTURES = (6, 27, 51), (256, 512, 1024, 2048), (1024, 2048, 4096)  # 720, 14580 and 52020 faces
STEPS, LEAST, BATCH = 30, 3, 10  # of a bundle; batches of which at least so many; steps of one
CARRIED = ("dressi_edge/__init__.py", "dressi_edge/cli.py", "dressi_edge/cache", "dressi_edge/commands", "dressi_edge/runtime",
           "device_profiles", "tests/vectors")


def problems(quick: bool) -> dict:
    """Name -> a function that makes the problem: one view, silhouettes or a texture, targets to be set."""
    from dressi_edge.compiler.io.cameras import orbit
    from dressi_edge.compiler.io.shapes import sphere
    from dressi_edge.compiler.render.optimizer import Adam
    from dressi_edge.compiler.render.raster import Softness
    from dressi_edge.compiler.scene.problem import Loss, Problem

    def shape(n, size, views=1, layers=1):
        def make():
            made = Problem(sphere(10 * n * n + 2, 0.5), orbit(views, (20.0, -20.0), 2.5, 50.0, (size, size)),
                           albedo="colors" if layers > 1 else "constant")
            losses = [Loss("silhouette"), Loss("laplacian", 0.05)] + [Loss("color")] * (layers > 1)
            made.phase("fit", STEPS, {"vertices": Adam(0.002)} | ({"colors": Adam(0.01)} if layers > 1 else {}), losses,
                       Softness(2.0, layers=layers))
            return made
        return make

    def texture(texels, size):
        def make():
            made = Problem(sphere(10 * 27 * 27 + 2, 0.5), orbit(1, (20.0,), 2.5, 50.0, (size, size)), texture_size=(texels, texels))
            made.phase("fit", STEPS, {"texture": Adam(0.01)}, [Loss("color")], Softness(1.0, delta=0.0))
            return made
        return make

    if quick:
        return {"step six views 720 faces 32": shape(6, 32, 6), "scaling 720 faces 64": shape(6, 64), "texture 64 at 64": texture(64, 64)}
    return {"step six views 1280 faces 256": shape(8, 256, 6), "step six views K = 3 256": shape(8, 256, 6, 3),
            **{f"scaling {20 * n * n} faces {size}": shape(n, size) for n in FACES for size in SIZES},
            **{f"texture {texels} at 2048": texture(texels, 2048) for texels in TEXTURES}}


def prepare(folder: Path, quick: bool) -> None:
    from dressi_edge.compiler import compile_program

    (folder / "bundles").mkdir(parents=True, exist_ok=True)
    for name, make in problems(quick).items():
        compile_program(make().program, PROFILES, folder / "bundles" / f"{name.replace(' ', '_')}.dressi")
        print(name, flush=True)
    for path in CARRIED:
        source = ROOT / path
        if source.is_dir():
            shutil.copytree(source, folder / path, dirs_exist_ok=True, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(source, folder / path)
    shutil.copy(ROOT / "tests" / "drivers" / "replay.py", folder)
    shutil.copy(__file__, folder)


def target(shape):
    """A disk, coloured by place, (views, height, width, 4)."""
    import numpy as np

    y, x = (np.mgrid[:shape[1], :shape[2]] + 0.5) / np.reshape(shape[1:3], (2, 1, 1)) * 2 - 1
    image = np.stack([x * 0.5 + 0.5, y * 0.5 + 0.5, 0.5 + 0 * x, np.hypot(x, y) < 0.55], -1)
    return np.broadcast_to(image, shape).astype(np.float32)


def measured(device, path: Path) -> dict:
    """One bundle: start twice, the first step, steps, losses, shaders."""
    from dressi_edge import runtime
    from dressi_edge.commands.statistics import compiled

    starts, told = [], {}
    for _ in range(2):
        start = time.perf_counter()
        with runtime.load(path, device) as session:
            starts.append(round((time.perf_counter() - start) * 1e3, 1))
            session.set("targets", target(session.shape("targets")))
            losses, start = [session.loss()], time.perf_counter()
            session.step(1)
            first, spans = (time.perf_counter() - start) * 1e3, []
            while len(spans) < LEAST:
                start = time.perf_counter()
                session.step(BATCH)
                spans.append((time.perf_counter() - start) * 1e3 / BATCH)
            losses.append(session.loss())
            taken, report = session.bundle, session.report()
            quartiles = statistics.quantiles(spans, n=4)
            told = {"variant": taken.profile, "start_ms": starts, "first_ms": round(first, 2), "ms": round(quartiles[1], 4),
                    "quartiles_ms": [round(quartiles[0], 4), round(quartiles[2], 4)], "losses": losses,
                    "image_bytes": report["image_bytes"], "pipeline_cache": report["pipeline_cache"]}
    told["compiled"] = [one.record() for one in compiled(device, taken)] if device.statistics else []
    return told


def run(options) -> int:
    os.environ.setdefault("DRESSI_CACHE", tempfile.mkdtemp(prefix="dressi_gpu_"))
    import platform
    import subprocess

    from dressi_edge.cache.limits import LIMITS
    from dressi_edge.runtime.device import Device

    end, out, left = time.monotonic() + options.seconds, {"devices": Device.list(), "machine": platform.platform()}, []
    print(*out["devices"], sep="\n", flush=True)
    with Device.open(options.device, validation=options.validation, statistics=True) as device:
        out |= {"device": device.name, "driver": device.driver, "api": device.api_version, "statistics": device.statistics,
                "limits": {name: device.limits[name] for name in LIMITS if name in device.limits}}
        own = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]), "DRESSI_DEVICE": device.name}
        capture = subprocess.run([sys.executable, "-m", "dressi_edge.cli", "profiles", "capture", "-n", "captured"],
                                 capture_output=True, text=True, env=own)
        out["profile"] = json.loads(capture.stdout) if capture.returncode == 0 else capture.stderr.strip()
        program = HERE / "replay.py" if (HERE / "replay.py").exists() else ROOT / "tests/drivers/replay.py"
        replay = subprocess.run([sys.executable, str(program), str(ROOT), str(ROOT / "tests/vectors")],
                                capture_output=True, text=True, env=own)
        records = [json.loads(line) for line in replay.stdout.splitlines() if line.startswith("{")]
        out["vectors"] = [{k: x for k, x in r.items() if k != "statistics"} for r in records if "name" in r]
        out["vectors_failed"] = replay.stderr.strip()[-500:] if replay.returncode else ""
        for r in out["vectors"]:
            print(f"vector {r['name']}: {r['error'] or format(r['deviation'], '.3g') + ' of its tolerance'}, {len(r['messages'])} messages",
                  flush=True)
        for path in sorted(Path(options.bundles).glob("*.dressi"), key=lambda p: p.stat().st_size):
            name = path.stem.replace("_", " ")
            if time.monotonic() > end:
                left.append(name)
                continue
            try:
                out.setdefault("bundles", {})[name] = told = measured(device, path)
                print(f"{name}: {told['ms']:.3f} ms a step, start {told['start_ms'][0]:.0f} and {told['start_ms'][1]:.0f} ms, first step "
                      f"{told['first_ms']:.1f} ms, loss {told['losses'][0]:.5g} -> {told['losses'][1]:.5g}, {told['variant']}", flush=True)
            except Exception as error:  # noqa: BLE001  (what went wrong is the result)
                out.setdefault("failed", {})[name] = f"{type(error).__name__}: {error}"
                print(f"{name}: {out['failed'][name]}", flush=True)
        out["messages"] = sorted(set(device.messages))
    out["left_out"] = left
    Path(options.out).write_text(json.dumps(out, indent=1) + "\n")
    print(f"left out for time: {', '.join(left) or 'nothing'}; {len(out['messages'])} messages of the validation layer; {options.out}")
    return 1 if out.get("failed") or out["vectors_failed"] or any(r["error"] for r in out["vectors"]) else 0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    kinds = parser.add_subparsers(dest="kind", required=True)
    sub = kinds.add_parser("prepare")
    sub.add_argument("folder", type=Path)
    sub.add_argument("--quick", action="store_true")
    sub = kinds.add_parser("run")
    sub.add_argument("out")
    sub.add_argument("--device")
    sub.add_argument("--seconds", type=float, default=360)
    sub.add_argument("--validation", action="store_true")
    sub.add_argument("--bundles", default=str(ROOT / "bundles"))
    options = parser.parse_args()
    if options.kind == "prepare":
        prepare(options.folder, options.quick)
        return 0
    return run(options)


if __name__ == "__main__":
    sys.exit(main())
