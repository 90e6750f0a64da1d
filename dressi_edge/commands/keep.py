"""What a run leaves on its way: chores done every so often between steps, and all of them at the end; and a checkpoint with its curves.

In: functions that write something. Out: their files, each whole or as it was. A checkpoint is `Session.checkpoint`'s file; beside it lies
FILE.json with what a session does not know: losses so far and seconds. It is written first, so that it is never behind; what it has beyond
the checkpoint is dropped when a run goes on.
"""
from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from ..cache.errors import InputError
from ..cache.files import read_regular
from .files import write_file
from .progress import Events
from .solve import Course

SHARE = 0.1  # of the time: what a chore may take at most
MAX_RECORD = 64 << 20


@dataclass
class Chore:
    """do() every so many seconds, seldomer where it takes longer than `SHARE` of them. quiet: nobody is told."""

    what: str
    file: str
    seconds: float
    do: Callable[[], object]
    due: float = 0.0
    quiet: bool = False

    def run(self, events: Events) -> None:
        start = time.monotonic()
        if not self.quiet:
            events.doing(f"writing {self.file}")
        self.do()
        end = time.monotonic()
        self.due = end + max(self.seconds, (end - start) / SHARE)
        if not self.quiet:
            events.tell("wrote", what=self.what, file=self.file)


@dataclass
class Keeper:
    """Chores, in the order in which they are done."""

    events: Events
    chores: Sequence[Chore]
    asked: set[str] = field(default_factory=set)

    def __post_init__(self):
        for chore in self.chores:
            chore.due = time.monotonic() + chore.seconds

    def ask(self, what: str) -> None:
        """Have the chores of that name done soon; from any thread."""
        self.asked.add(what)

    def between(self, course: Course) -> None:
        """Do what is due."""
        for chore in self.chores:
            if time.monotonic() >= chore.due or chore.what in self.asked:
                self.asked.discard(chore.what)
                chore.run(self.events)

    def finish(self) -> None:
        """Do all."""
        for chore in self.chores:
            chore.run(self.events)


def save_checkpoint(session, path: str, courses: Mapping[str, Course]) -> None:
    """The session's checkpoint, and the curves. Raises InputError."""
    record = {"bundle": session.bundle.digest,
              "courses": {name: {"curve": c.curve, "terms": c.terms, "seconds": c.seconds} for name, c in courses.items()}}
    write_file(record_path(path), json.dumps(record).encode())
    session.checkpoint(path)


def record_path(path: str) -> str:
    """Where the curves of a checkpoint lie."""
    return f"{path}.json"


def resume(session, path: str, todo: Sequence[tuple[str, int]], strict: bool = True) -> dict[str, Course]:
    """The phases with what of them a checkpoint has, which the session goes on from; none of it where there is no such file. strict: a
    phase that has run longer than is asked for is an error. Raises InputError, BundleError."""
    courses = {name: Course(name, steps) for name, steps in todo}
    if not os.path.exists(path):
        return courses
    session.restore(path)
    runs, known = session.report()["runs"], _record(session, path)
    for name, course in courses.items():
        course.first = course.done = runs[name]
        if course.done > course.steps and not strict:
            course.steps = course.done
        if course.done > course.steps:
            raise InputError(f"{path}: phase {name} has run {course.done} times, and {course.steps} are asked for; give more "
                             "--steps, or another checkpoint")
        if name in known:
            course.curve, course.terms, course.seconds = known[name]
            course.curve = [p for p in course.curve if p[0] <= course.done]
            course.terms = {key: [p for p in points if p[0] <= course.done] for key, points in course.terms.items()}
    return courses


def _record(session, path: str) -> dict[str, tuple]:
    """Curves, terms and seconds by phase; nothing where the file is gone or not of this bundle: they are not what a run goes on from."""
    def points(rows) -> list[tuple[int, float]]:
        return [(int(x), float(y)) for x, y in rows]

    try:
        found = json.loads(read_regular(record_path(path), MAX_RECORD))
        if found["bundle"] != session.bundle.digest:
            return {}
        return {name: (points(c["curve"]), {key: points(rows) for key, rows in c["terms"].items()}, float(c["seconds"]))
                for name, c in found["courses"].items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}
