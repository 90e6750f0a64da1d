"""The loop around a phase: steps in chunks, its losses on the way, and what is true of it when it ends or is stopped.

In: a session and a phase. Out: a `Course`: how far it is, how long that took, its curves. Whoever wants something between chunks is called
there; a KeyboardInterrupt anywhere ends the phase after the step in flight, with the right count.
"""
from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from .progress import Events, Terminal

POINTS = 60  # of a loss curve, about
CHUNK_SECONDS = 0.5


class Terminated(KeyboardInterrupt):
    """SIGTERM, handled as Ctrl-C is."""


@dataclass
class Course:
    """A phase on its way. done: iterations that have run, of `steps`; first: those before this process began. curve: (done, loss), each
    count once. terms: the same by term. stopped: what ended it early, or nothing."""

    phase: str
    steps: int
    first: int = 0
    curve: list[tuple[int, float]] = field(default_factory=list)
    terms: dict[str, list[tuple[int, float]]] = field(default_factory=dict)
    seconds: float = 0.0
    done: int = 0
    stopped: str = ""
    timed: list[tuple[float, int]] = field(default_factory=list)

    def record(self) -> dict:
        """For metrics."""
        count = sum(n for _, n in self.timed)
        each = sum(t for t, _ in self.timed) / count if count else self.seconds / max(self.done, 1)
        out = {"steps": self.done, "seconds": self.seconds, "ms_per_step": each * 1e3}
        if self.curve:
            out |= {"loss_first": self.curve[0][1], "loss_last": self.curve[-1][1]}
        if self.first:
            out["resumed_at"] = self.first
        return out | ({"interrupted": True} if self.stopped else {})


def solve(session, phase: str, steps: int, curve: list, **more) -> dict:
    """Step a phase, appending to `curve`, told on stderr; what is known of it then."""
    with Events(Terminal()) as events:
        return run_course(session, Course(phase, steps, curve=curve), events, **more).record()


def run_course(session, course: Course, events: Events, between: Callable[[Course], None] | None = None,
               stop: Callable[[], str] | None = None) -> Course:
    """Step the phase from where it is to its end. between: called after each chunk of half a second at most, where a step does not take
    longer. stop: asked there why to stop, or "". Gives the course."""
    phase, steps = course.phase, course.steps
    every = max(1, steps // POINTS)
    session.step(0, phase)
    before = _runs(session, phase) - course.first
    course.done, spent = course.first, course.seconds
    names = _measured(session, phase)
    events.tell("phase", phase=phase, done=course.done, steps=steps)

    def measure() -> float | None:
        if names and (not course.curve or course.curve[-1][0] != course.done):
            values = [float(session.get(name)) for name in names[1:]]  # an interrupt leaves no point with half of its values
            course.curve.append((course.done, session.loss()))
            for name, value in zip(names[1:], values):
                course.terms.setdefault(name.partition(".")[2], []).append((course.done, value))
        return course.curve[-1][1] if course.curve else None

    chunk, start = 1, time.perf_counter()
    try:
        loss = measure()
        while course.done < steps and not course.stopped:
            n = min(chunk, every - course.done % every, steps - course.done)
            start = time.perf_counter()
            session.step(n)
            took = time.perf_counter() - start
            if course.done > course.first:  # the first chunk holds the driver's compilation
                course.timed.append((took, n))
            course.done, course.seconds = course.done + n, course.seconds + took
            if course.done % every == 0 or course.done == steps:
                loss = measure()
            chunk = max(1, min(every, int(CHUNK_SECONDS / max(took / n, 1e-6))))
            events.tell("step", phase=phase, done=course.done, steps=steps, loss=loss, ms_per_step=took / n * 1e3,
                        seconds_left=_left(course, took / n))
            if between is not None:
                between(course)
            course.stopped = stop() if stop is not None else ""
    except KeyboardInterrupt as error:
        course.stopped = "SIGTERM" if isinstance(error, Terminated) else "Ctrl-C"
        known, course.done = course.done, _runs(session, phase) - before  # waits for what was submitted
        course.seconds += (time.perf_counter() - start) * (course.done > known)
    if course.stopped and course.done < steps:
        events.tell("stopped", phase=phase, done=course.done, steps=steps)
        measure()
    course.seconds = max(course.seconds, spent)
    return course


def _measured(session, phase: str) -> list[str]:
    """The loss of the phase and its terms by name; nothing where there is no loss."""
    if f"{phase}.loss" not in session.values:
        return []
    terms = session.plans.get(f"{phase}.terms")
    if terms is None:
        return [f"{phase}.loss"]
    values = session.bundle.description["values"]
    return [f"{phase}.loss", *(values[k]["name"] for k in terms["outputs"])]


def _left(course: Course, each: float) -> float:
    """Seconds to the end of the phase, by the last chunks."""
    recent = course.timed[-8:]
    count = sum(n for _, n in recent)
    return (course.steps - course.done) * (sum(t for t, _ in recent) / count if count else each)


def _runs(session, phase: str) -> int:
    """Iterations of the phase that have run, an interrupted step's included."""
    return session.report()["runs"][phase]


@contextlib.contextmanager
def terminable():
    """SIGTERM in here raises `Terminated`, where this is the main thread."""
    import signal
    import threading

    def end(*_):
        raise Terminated

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
