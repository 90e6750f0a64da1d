"""A real GPU in eight minutes, on a machine without network: devices, vectors, steps, textures, scaling, start; JSON out.

    python benchmarks/gpu.py prepare FOLDER [--quick]     anywhere: bundles, and a copy of what runs them (gpu.sh adds wheels and loader)
    python gpu.py run OUT.json [--device NAME] [--seconds N] [--validation]     there, in FOLDER; needs numpy and msgpack
    python gpu.py tables OUT.json                                               the tables of such a file

Bundles have three variants, navi21 (large shaders), limit8 and vulkan_min; the first that fits runs, of drawn ones named "step" each.
Triangles and sizes are those of the paper's Tables 4 and 5, near enough: spheres of 20 n^2 faces (682, 14208 and 51414 there) at 256
to 2048, and textures of 1024 to 4096 at 2048. Some are there again with work dispatched to compute shaders. What does not fit into the
seconds is left out and named, the largest files first.

start     from the file to a session that can step, without and with compiled pipelines in the cache
first     the first step; a driver may compile in it
ms        a step, submitted and waited for in tens: median, and quartiles
losses    before, and after all steps
error     relative L2 of what was fitted, and of the loss, to what the machine that prepared it came to after as many steps; where it tried
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

PROFILES = ("navi21", "limit8", "vulkan_min")
LOWERED = ("pixel", "all")  # dispatched instead of drawn: Options.compute
FACES, SIZES, TEXTURES = (6, 27, 51), (256, 512, 1024, 2048), (1024, 2048, 4096)  # 720, 14580 and 52020 faces
STEPS, LEAST, BATCH = 30, 3, 10  # of a bundle; batches of which at least so many; steps of one
FEW = 1 << 19  # pixels of all views up to which the machine that prepares runs a bundle, too
MOST = 1 << 14  # numbers of a state that are compared
CARRIED = ("dressi_edge/__init__.py", "dressi_edge/cli.py", "dressi_edge/cache", "dressi_edge/commands", "dressi_edge/runtime",
           "device_profiles", "tests/vectors")


def problems(quick: bool) -> dict:
    """Name -> a function that makes the problem: one view, silhouettes or a texture, targets to be set; and how it is compiled."""
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
        drawn = {"step six views 720 faces 32": shape(6, 32, 6), "scaling 720 faces 64": shape(6, 64), "texture 64 at 64": texture(64, 64)}
        lowered = tuple(drawn)
    else:
        drawn = {"step six views 1280 faces 256": shape(8, 256, 6), "step six views K = 3 256": shape(8, 256, 6, 3),
                 **{f"scaling {20 * n * n} faces {size}": shape(n, size) for n in FACES for size in SIZES},
                 **{f"texture {texels} at 2048": texture(texels, 2048) for texels in TEXTURES}}
        lowered = ("step six views 1280 faces 256", "step six views K = 3 256", "scaling 14580 faces 1024", "texture 2048 at 2048")
    return {name: (make, {}) for name, make in drawn.items()} | {
        f"{name} compute {kind}": (drawn[name], {"compute": kind}) for name in lowered for kind in LOWERED}


def prepare(folder: Path, quick: bool) -> None:
    from dressi_edge.compiler import compile_program
    from dressi_edge.runtime.device import Device

    (folder / "bundles").mkdir(parents=True, exist_ok=True)
    wanted = {}
    with Device.open() as device:
        for name, (make, options) in problems(quick).items():
            path, problem = folder / "bundles" / f"{name.replace(' ', '_')}.dressi", make()
            compile_program(problem.program, PROFILES, path, **options)
            if not options and problem.width * problem.height * len(problem.views) <= FEW:
                wanted[name] = {"device": f"{device.name}, {device.driver}", **fitted(device, path)}
            print(name, flush=True)
    (folder / "wanted.json").write_text(json.dumps(wanted) + "\n")
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


def results(session) -> dict:
    """The loss, and what was fitted."""
    states = {value["name"] for value in session.bundle.description["values"] if value["role"] == "state"}
    fitted = {name: session.get(name).ravel().tolist() for name in ("vertices", "colors", "texture") if name in states}
    return {"loss": session.loss(), "fitted": {name: x for name, x in fitted.items() if len(x) <= MOST}}


def fitted(device, path: Path) -> dict:
    """What a device comes to after as many steps as `measured` makes."""
    from dressi_edge import runtime

    with runtime.load(path, device) as session:
        session.set("targets", target(session.shape("targets")))
        session.step(1 + LEAST * BATCH)
        return results(session)


def error(found: dict, wanted: dict) -> dict:
    """By how much two results differ."""
    import numpy as np

    pairs = {"loss": (found["loss"], wanted["loss"])} | {name: (found["fitted"][name], x) for name, x in wanted["fitted"].items()}
    return {name: float(np.linalg.norm(np.subtract(a, b)) / max(np.linalg.norm(b), 1e-30)) for name, (a, b) in pairs.items()}


def measured(device, path: Path, profile: str | None = None, wanted: dict | None = None) -> dict:
    """One bundle, or its variant for that profile: start twice, the first step, steps, losses, errors, shaders."""
    from dressi_edge import runtime
    from dressi_edge.commands.statistics import compiled

    starts, told = [], {}
    for _ in range(2):
        start = time.perf_counter()
        with runtime.load(path, device, profile=profile) as session:
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
            off = error(results(session), wanted) if wanted else None
            taken, report = session.bundle, session.report()
            quartiles = statistics.quantiles(spans, n=4)
            told = {"variant": taken.profile, "start_ms": starts, "first_ms": round(first, 2), "ms": round(quartiles[1], 4),
                    "quartiles_ms": [round(quartiles[0], 4), round(quartiles[2], 4)], "losses": losses, "error": off,
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
    jobs: list[tuple] = []
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
        wanted = Path(options.bundles).with_name("wanted.json")
        out["wanted"] = wanted = json.loads(wanted.read_text()) if wanted.exists() else {}
        for path in sorted(Path(options.bundles).glob("*.dressi"), key=lambda p: p.stat().st_size):
            bundle = path.stem.replace("_", " ")
            for profile in [None, *(PROFILES[1:] if bundle.startswith("step") and "compute" not in bundle else ())]:
                jobs.append((path, profile, bundle.partition(" compute ")[0], bundle + (f", {profile}" if profile else "")))
        for path, profile, bundle, name in jobs:
            if time.monotonic() > end:
                left.append(name)
                continue
            try:
                out.setdefault("bundles", {})[name] = told = measured(device, path, profile, wanted.get(bundle))
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


def tables(out: dict) -> str:
    """Markdown: shapes by faces and size, textures, drawn against dispatched and by variant, errors."""
    found = out.get("bundles", {})

    def ms(name: str) -> str:
        return f"{found[name]['ms']:.3f}" if name in found else "-"

    lines = [f"{out['device']}, {out['driver']}; milliseconds a step.", ""]
    scaling = [name.split()[1:4:2] for name in found if name.startswith("scaling") and "," not in name and "compute" not in name]
    counts, sizes = (sorted({int(words[k]) for words in scaling}) for k in (0, 1))
    lines += [f"| faces | {' | '.join(map(str, sizes))} |", "|---:|" + "---:|" * len(sizes)]
    lines += [f"| {n} | " + " | ".join(ms(f"scaling {n} faces {size}") for size in sizes) + " |" for n in counts]
    textures = [name for name in found if name.startswith("texture") and "compute" not in name]
    lines += ["", "| texture | ms |", "|---|---:|", *(f"| {name} | {ms(name)} |" for name in textures)]
    again = [name for name in found if f"{name} compute pixel" in found]
    lines += ["", "| | drawn | " + " | ".join(LOWERED) + " | " + " | ".join(PROFILES[1:]) + " |", "|---|" + "---:|" * (2 + len(PROFILES))]
    lines += [f"| {name} | " + " | ".join([ms(name), *(ms(f"{name} compute {kind}") for kind in LOWERED),
                                           *(ms(f"{name}, {profile}") for profile in PROFILES[1:])]) + " |" for name in again]
    lines += ["", "| | start, again, first step, ms | error of |", "|---|---|---|"]
    lines += [f"| {name} | {told['start_ms'][0]:.0f}, {told['start_ms'][1]:.0f}, {told['first_ms']:.0f} | "
              + (", ".join(f"{of} {x:.2g}" for of, x in (told["error"] or {}).items()) or "-") + " |" for name, told in found.items()]
    exact = sum(not r["error"] and r["deviation"] == 0 for r in out["vectors"])
    lines += ["", f"Vectors: {exact} of {len(out['vectors'])} to the bit, the others within "
              f"{max((r['deviation'] for r in out['vectors'] if not r['error']), default=0):.2g} of their tolerance. Messages of the "
              f"validation layer: {len(out['messages'])}. Left out for time: {', '.join(out['left_out']) or 'nothing'}."]
    return "\n".join(lines) + "\n"


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
    sub = kinds.add_parser("tables")
    sub.add_argument("out")
    options = parser.parse_args()
    if options.kind == "prepare":
        prepare(options.folder, options.quick)
        return 0
    if options.kind == "tables":
        print(tables(json.loads(Path(options.out).read_text())), end="")
        return 0
    return run(options)


if __name__ == "__main__":
    sys.exit(main())
