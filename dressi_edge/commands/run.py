"""`run`: step the phases of a bundle, show how it goes, and write the result, on the way too. Without a mesh it needs the runtime alone."""
from __future__ import annotations

import io
import os

from ..cache.errors import BundleError, InputError
from .files import check_folder, print_json, write_file
from .keep import Chore, Keeper, record_path, resume, save_checkpoint
from .outputs import Wanted, wanted
from .progress import Events, JsonLines, Terminal
from .solve import Course, Terminated, run_course, solve, terminable

__all__ = ["run", "solve"]

PICTURES = 12  # views whose start is kept, for sheets and pages
LIVE_SECONDS = 2.0  # between pictures of the live page


def open_session(args):
    """The session that a command's arguments ask for: of a bundle, or of a job on the reference. Raises InputError and others."""
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


def run(args) -> int:
    """The command; its exit code."""
    files = wanted(args.output or [])
    if args.scene and not any(w.path.lower().endswith((".glb", ".gltf", ".usdz")) for w in files):
        raise InputError("--scene writes lights and cameras into glTF; "
                         f"-o {' '.join(args.output or ['nothing'])} is none: give a .glb, .gltf or .usdz")
    _check_paths(args)
    live = None
    if args.serve is not None:
        from .serve import Live
        live = Live(args.serve, os.path.basename(args.bundle))
    try:
        with Events(JsonLines() if args.json_lines else Terminal(), *filter(None, [live])) as events, terminable():
            return _Run(args, files, events, live).whole()
    except BaseException:
        if live:
            live.close("the run has failed or was interrupted")
        raise


def _check_paths(args) -> None:
    for path in filter(None, (args.checkpoint, args.preview)):
        check_folder(path)
    if args.preview and not args.preview.lower().endswith(".png"):
        raise InputError(f"--preview {args.preview}: a .png is written; name it so")
    if args.report:
        try:
            os.makedirs(args.report, exist_ok=True)
        except OSError as error:
            raise InputError(f"--report {args.report}: cannot be made a folder: {error.strerror}; choose another path") from None
    if args.checkpoint and args.device == "reference":
        raise InputError("--checkpoint: the reference keeps none; run a bundle")


class _Run:
    """One run of the command."""

    def __init__(self, args, files: list[Wanted], events: Events, live=None):
        self.args, self.wanted, self.events, self.live = args, files, events, live
        self.results = None
        if any(w.kind == "mesh" for w in self.wanted) or args.preview or args.report or live:
            from ..compiler.scene import results
            self.results = results
        self.courses: dict[str, Course] = {}
        self.before = None
        self.over = ""  # what the last pages may take their time for
        self.written: dict = {}  # the metrics of the results, with what was measured

    def whole(self) -> int:
        """Load, step, write; the exit code."""
        args = self.args
        if self.live:
            self.events.tell("serving", address=self.live.address)
        self.events.doing(f"loading {args.bundle}")
        with open_session(args) as session:
            self.session, todo = session, _todo(session, args)
            session.ready()
            self._check_wanted()
            if self.results:
                self.before = self.results.snapshot(session, PICTURES)
            self.courses = (resume(session, args.checkpoint, todo) if args.checkpoint
                            else {name: Course(name, steps) for name, steps in todo})
            keeper = Keeper(self.events, self._chores())
            if self.live:
                if args.checkpoint:
                    self.live.keep = lambda: keeper.ask("checkpoint")
                self.live.begin(session, self.courses, self.before)
            stopped = self._step(keeper)
            self.over = "" if stopped else "complete"
            keeper.finish()
            if self.live:
                self.live.close(f"ended early by {stopped}" if stopped else "done")
            metrics = self.written or self._facts()
            if args.explain:
                metrics["report"] = session.report()
        if args.json_lines:
            self.events.tell("done", metrics={k: x for k, x in metrics.items() if k not in ("losses", "terms")})
        else:
            _tell(metrics, args, self.wanted)
        return {"": 0, "SIGTERM": 143}.get(stopped, 130)

    def _check_wanted(self) -> None:
        """Fails now rather than after the work."""
        for w in self.wanted:
            if w.kind == "mesh":
                self.results.check(self.session)
            elif w.kind == "arrays":
                _check_names(_states(self.session))
            else:
                w.check(self.session)
        if self.args.preview and self.results.snapshot(self.session, 1) is None:
            raise InputError(f"--preview: {self.args.bundle} draws no pictures (it has no plan `render`); leave it out")

    def _step(self, keeper: Keeper) -> str:
        """Step all phases; why that ended early, or nothing."""
        done: list[Course] = []
        try:
            for course in self.courses.values():
                if course.first:
                    self.events.tell("resumed", phase=course.phase, done=course.first, steps=course.steps)
                if course.first < course.steps or not course.curve:
                    run_course(self.session, course, self.events, keeper.between, self.live and self.live.stop)
                done.append(course)
                if course.stopped:
                    break
        except KeyboardInterrupt as error:  # between two phases
            return "SIGTERM" if isinstance(error, Terminated) else "Ctrl-C"
        complete = all(course.done == course.steps for course in self.courses.values())
        return "" if complete else done[-1].stopped

    # ---- what is written

    def _chores(self) -> list[Chore]:
        args, often = self.args, 60.0 * self.args.every
        chores = [Chore("live", "", LIVE_SECONDS, lambda: self.live.refresh(self.session), quiet=True)] if self.live else []
        if args.preview:
            chores.append(Chore("preview", args.preview, args.preview_every, self._preview))
        if args.checkpoint:
            chores.append(Chore("checkpoint", args.checkpoint, often,
                                lambda: save_checkpoint(self.session, args.checkpoint, self.courses)))
        if args.report:
            chores.append(Chore("report", os.path.join(args.report, "index.html"), often, self._report))
        full = next((w for w in self.wanted if w.kind == "mesh"), None)  # with pictures and numbers beside it
        for w in self.wanted:
            chores.append(Chore("results", w.path, often, self._writer(w, w is full)))
        return chores

    def _writer(self, w: Wanted, full: bool):
        def write() -> None:
            if full:
                curves = {name: c.curve for name, c in self._begun().items()}
                self.written = self.results.write(self.session, w.path, curves, self.before, self._facts(), scene=self.args.scene)
            elif w.kind == "mesh":
                self.results.save_result(self.session, w.path, self.args.scene, self.args.scene)
            elif w.kind == "arrays":
                _save_states(self.session, w.path)
            else:
                w.write(self.session)
        return write

    def _report(self) -> None:
        from ..page import result
        from ..page.html import page
        data = result.run_data(self.session, os.path.basename(self.args.bundle), list(self._begun().values()), self.before,
                               times=bool(self.over))
        write_file(os.path.join(self.args.report, "index.html"), page(data, result.model(self.session)))

    def _preview(self) -> None:
        self.results.save_sheet(self.session, self.args.preview, self.before)

    def _begun(self) -> dict[str, Course]:
        return {name: c for name, c in self.courses.items() if c.done or c.curve or c.stopped}

    def _facts(self) -> dict:
        terms = {name: c.terms for name, c in self._begun().items() if c.terms}
        return {"device": self.session.device.name, "driver": self.session.device.driver, "profile": self.session.report()["profile"],
                "phases": {name: c.record() for name, c in self._begun().items()}} | ({"terms": terms} if terms else {})


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
            arrays[name] = arrays[name] * float(meta.get("scale", 1.0)) + np.array(meta["origin"], np.float64).reshape(3)
        if (entry := meta.get(key := "vertex_map")) is not None:
            arrays.setdefault("vertex_map", np.frombuffer(entry["data"], "<i4"))
    except (KeyError, TypeError, ValueError) as error:
        raise BundleError(f"meta.{key} is malformed ({error}); compile the bundle again") from None
    np.savez(data, **arrays)
    write_file(path, data.getvalue())


def _tell(metrics: dict, args, files: list[Wanted]) -> None:
    if args.json:
        print_json({k: x for k, x in metrics.items() if k not in ("losses", "terms")})
        return
    for name, p in metrics["phases"].items():
        loss = f"loss {p['loss_first']:.5g} -> {p['loss_last']:.5g}, " if p.get("loss_last") is not None else ""
        print(f"{name}: {p['steps']} steps, {loss}{p['ms_per_step']:.2f} ms a step, {p['seconds']:.1f} s")
    if views := metrics.get("views"):
        print("views: " + ", ".join(f"{key.replace('_', ' ')} {x:.4g}" for key, x in views.items()))
    for key, x in metrics.get("report", {}).items():
        print(f"  {key}: {x}")
    beside = dict.fromkeys(metrics.get("files", {}).values())
    for k, w in enumerate(files):
        names = list(beside) if k == 0 and beside and w.kind == "mesh" else w.names
        print(f"in {os.path.dirname(w.path) or '.'}: {' '.join(names)}")
    if args.report:
        print(f"in {args.report}: index.html")
    if args.checkpoint:
        print(f"in {os.path.dirname(args.checkpoint) or '.'}: {os.path.basename(args.checkpoint)} "
              f"{os.path.basename(record_path(args.checkpoint))}")
