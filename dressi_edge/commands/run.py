"""`run`: step the phases of a bundle, show how it goes, and write the result. Without an output it needs the runtime alone."""
from __future__ import annotations

import io
import os
import sys
import time

from ..cache.errors import BundleError, InputError
from .files import check_folder, print_json, write_file

POINTS = 60  # of a loss curve, about
QUIET_SECONDS = 3.0  # between lines where stderr is no terminal
MESHES = (".glb", ".gltf", ".obj", ".ply")


class Progress:
    """Loss and ms a step on stderr: a bar on a terminal, else a line every few seconds."""

    def __init__(self, name: str, steps: int):
        self.name, self.steps, self.last = name, steps, time.monotonic()
        self.bar = sys.stderr.isatty()

    def show(self, done: int, loss: float | None, ms: float) -> None:
        """Draw the bar, or write a line if one is due."""
        now, end = time.monotonic(), done == self.steps
        text = f"{self.name} {done}/{self.steps}" + (f" loss {loss:.5g}" if loss is not None else "") + f" {ms:.1f} ms a step"
        if self.bar:
            full = 24 * done // self.steps
            sys.stderr.write(f"\r[{'#' * full}{' ' * (24 - full)}] {text}\x1b[K" + ("\n" if end else ""))
        elif end or now - self.last >= QUIET_SECONDS:
            sys.stderr.write(text + "\n")
            self.last = now
        sys.stderr.flush()


def solve(session, phase: str, steps: int, curve: list) -> dict:
    """Step a phase, appending (iterations done, loss) to `curve`, each count once; what is known of it then. KeyboardInterrupt ends it
    early; the iterations that were on their way then have run, and count."""
    has_loss = f"{phase}.loss" in session.values
    progress, every = Progress(phase, steps), max(1, steps // POINTS)
    session.step(0, phase)
    before = _runs(session, phase)

    def measure(done: int) -> float | None:
        if has_loss and (not curve or curve[-1][0] != done):
            curve.append((done, session.loss()))
        return curve[-1][1] if curve else None

    loss, done, spent, chunk, timed, stopped = measure(0), 0, 0.0, 1, [], False
    start = time.perf_counter()
    try:
        while done < steps:
            n = min(chunk, every - done % every, steps - done)
            start = time.perf_counter()
            session.step(n)
            took = time.perf_counter() - start
            done, spent = done + n, spent + took
            if done > n:  # the first chunk holds the driver's compilation
                timed.append((took, n))
            if done % every == 0 or done == steps:
                loss = measure(done)
            each = took / n
            chunk = max(1, min(every, int(0.5 / max(each, 1e-6))))
            progress.show(done, loss, each * 1e3)
    except KeyboardInterrupt:
        stopped, known = True, done
        done = _runs(session, phase) - before  # waits for what was submitted
        spent += (time.perf_counter() - start) * (done > known)
        sys.stderr.write(f"\nstopped {phase} after {done} of {steps} steps\n")
        measure(done)
    count = sum(n for _, n in timed)
    each = sum(t for t, _ in timed) / count if count else spent / max(done, 1)
    out = {"steps": done, "seconds": spent, "ms_per_step": each * 1e3}
    if curve:
        out |= {"loss_first": curve[0][1], "loss_last": curve[-1][1]}
    return out | ({"interrupted": True} if stopped else {})


def _runs(session, phase: str) -> int:
    """Iterations of the phase that have run, an interrupted step's included."""
    return session.report()["runs"][phase]


def _open(args):
    if args.device == "reference":
        if not args.bundle.endswith(".toml"):
            raise InputError(f"{args.bundle}: --device reference runs a job (.toml), for a bundle holds no graph; give the job")
        if args.pin is not None:
            raise InputError("--pin: a job has no digest; give a bundle, or leave --pin away")
        from ..compiler.graph.reference_session import ReferenceSession
        from ..compiler.scene.job import load_job
        from ..compiler.scene.targets import Carried
        problem = load_job(args.bundle, carried=Carried(whole=True))
        problem.program.meta.update(problem.record())
        return ReferenceSession(problem.program)
    if args.bundle.endswith(".toml"):
        raise InputError(f"{args.bundle} is a job; make a bundle of it first: "
                         f"dressi-edge compile {args.bundle} -p PROFILE -o X.dressi")
    from .. import runtime
    session = runtime.load(args.bundle, args.device, emulate=args.emulate, profile=args.profile, pin=args.pin)
    try:
        if args.views is not None:
            from ..compiler.io.again import reader
            meta = session.bundle.description["meta"]
            session.pictures(reader(args.views, meta.get("pictures"), bool(meta.get("linear_images"))))
        return session
    except BaseException:
        session.close()
        raise


def _todo(session, args) -> list[tuple[str, int]]:
    """Phases and their steps."""
    if not session.phases:
        raise InputError(f"{args.bundle} updates nothing: there is no phase to run")
    if args.phase is not None and args.phase not in session.phases:
        raise InputError(f"--phase {args.phase!r:.60} is no phase of {args.bundle}; there are: {' '.join(session.phases)}")
    todo = [(name, args.steps or session.plans[name]["steps"]) for name in session.phases if args.phase in (None, name)]
    if missing := [name for name, steps in todo if not steps]:
        raise InputError(f"phase {missing[0]} of {args.bundle} says no number of steps; give --steps")
    return todo


def _check_output(path: str) -> str:
    """The kind of output, "mesh" or "arrays". Raises InputError."""
    suffix = os.path.splitext(path)[1].lower()
    if suffix not in (*MESHES, ".npz"):
        raise InputError(f"output {path}: extension {suffix or 'none'} is unknown; known are {' '.join(MESHES)} .npz")
    check_folder(path)
    return "arrays" if suffix == ".npz" else "mesh"


def run(args) -> int:
    """The command; its exit code."""
    kind = args.output and _check_output(args.output)
    if args.scene and not (args.output or "").lower().endswith((".glb", ".gltf")):
        raise InputError(f"--scene writes lights and cameras into glTF; -o {args.output} is none: give a .glb or .gltf")
    results = None
    if kind == "mesh":
        from ..compiler.scene import results
    with _open(args) as session:
        todo = _todo(session, args)
        session.ready()
        if kind == "arrays":
            _check_names(_states(session))
        before = None
        if results:
            results.check(session)  # fails now rather than after the work
            before = results.snapshot(session, results.SHOWN)
        curves, phases = {}, {}
        for name, steps in todo:
            phases[name] = solve(session, name, steps, curves.setdefault(name, []))
            if phases[name].get("interrupted"):
                break
        metrics = {"device": session.device.name, "driver": session.device.driver,
                   "profile": session.report()["profile"], "phases": phases}
        if results:
            metrics = results.write(session, args.output, curves, before, metrics, scene=args.scene)
        elif kind:
            _save_states(session, args.output)
        if args.explain:
            metrics["report"] = session.report()
    _tell(metrics, args)
    return 130 if any(p.get("interrupted") for p in phases.values()) else 0


def _states(session) -> list[str]:
    """The names of the states of a session."""
    return [name for name, value in session.values.items() if value["role"] == "state"]


def _check_names(names: list[str]) -> None:
    """Raises InputError unless an .npz can have an array of each name: NumPy gives it back under that name, and unpacked it lies in
    the folder."""
    import inspect

    import numpy as np
    taken = {p.name for p in inspect.signature(np.savez).parameters.values() if p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD)}
    for name in names:
        if name in taken or name.lower().endswith(".npy"):
            raise InputError(f"state {name!r:.60} cannot be an array of an .npz: NumPy uses the name otherwise; write a mesh, or get it "
                             "with Session.get")
        if any(part in ("", ".", "..") for part in name.split("/")) or set(name) & {"\\", ":"}:
            raise InputError(f"state {name!r:.60} cannot be an array of an .npz: unpacked, its file would lie outside the folder; write a "
                             "mesh, or get it with Session.get")


def _save_states(session, path: str) -> None:
    """Every state of the bundle as an array of its user's shape, points in float64 where the bundle has a frame of its own; and where the
    mesh file has more vertices than `vertices` has rows, as some are at one position, `vertex_map`: the row of each of the file's."""
    import numpy as np
    data, arrays = io.BytesIO(), {name: session.get(name) for name in _states(session)}
    meta, key = session.bundle.description["meta"], "points"
    try:
        for name in meta.get("points", ()):
            arrays[name] = arrays[name] + np.array(meta["origin"], np.float64).reshape(3)
        if (entry := meta.get(key := "vertex_map")) is not None:
            arrays.setdefault("vertex_map", np.frombuffer(entry["data"], "<i4"))
    except (KeyError, TypeError, ValueError) as error:
        raise BundleError(f"meta.{key} is malformed ({error}); compile the bundle again") from None
    np.savez(data, **arrays)
    write_file(path, data.getvalue())


def _tell(metrics: dict, args) -> None:
    if args.json:
        print_json({k: x for k, x in metrics.items() if k != "losses"})
        return
    for name, p in metrics["phases"].items():
        loss = f"loss {p['loss_first']:.5g} -> {p['loss_last']:.5g}, " if p.get("loss_last") is not None else ""
        print(f"{name}: {p['steps']} steps, {loss}{p['ms_per_step']:.2f} ms a step, {p['seconds']:.1f} s")
    if views := metrics.get("views"):
        print("views: " + ", ".join(f"{key.replace('_', ' ')} {x:.4g}" for key, x in views.items()))
    for key, x in metrics.get("report", {}).items():
        print(f"  {key}: {x}")
    if args.output:
        names = metrics.get("files", {"states": os.path.basename(args.output)})
        print(f"in {os.path.dirname(args.output) or '.'}: {' '.join(names.values())}")
