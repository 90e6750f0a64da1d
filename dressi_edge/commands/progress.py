"""How a command's work goes: events in, told to a terminal, to programs as JSON lines, to whoever else listens.

An event is a name and facts: `doing` (what, done, total, seconds), `resumed` and `phase` (phase, done, steps), `step` (those, loss,
ms_per_step, seconds_left), `wrote` (what, file), `stopped` (phase, done, steps), `serving` (address), `done` (metrics). Nothing is silent
for long: what goes on for `SILENCE` seconds without an event is told again, with the seconds that it has taken.
"""
from __future__ import annotations

import json
import math
import sys
import threading
import time
from collections.abc import Callable, Mapping

from ..cache.progress import listening

SILENCE = 2.0  # seconds, at most
PACE = 0.2  # seconds between events of work that counts itself

Sink = Callable[[str, Mapping], None]


class Events:
    """A context manager that tells all sinks in the order in which they are given, and listens to compiler and runtime."""

    def __init__(self, *sinks: Sink):
        self._sinks = sinks
        self._lock, self._wake = threading.RLock(), threading.Event()
        self._what, self._began, self._told = {"what": "starting"}, time.monotonic(), time.monotonic()
        self._thread: threading.Thread | None = None

    def __enter__(self) -> Events:
        self._listening = listening(self.doing)
        self._listening.__enter__()
        self._thread = threading.Thread(target=self._beat, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_) -> None:
        self._wake.set()
        self._thread.join()
        self._listening.__exit__(None, None, None)
        self._send("end", {})

    def doing(self, what: str, done: int = 0, total: int = 0) -> None:
        """`what` has begun, or is so far; told at most every `PACE` seconds while it counts."""
        with self._lock:
            now, same = time.monotonic(), what == self._what["what"]
            if not same:
                self._began = now
            self._what = {"what": what} | ({"done": done, "total": total} if total else {})
            if not same or now - self._told >= PACE:
                self._send("doing", self._what)

    def tell(self, event: str, **facts) -> None:
        """An event with its facts."""
        with self._lock:
            if event in ("phase", "step"):
                name, done, steps = facts["phase"], facts["done"], facts["steps"]
                self._what = {"what": f"{name}: step {done + 1} of {steps}" if done < steps else f"results of {name}"}
                self._began = time.monotonic()
            self._send(event, facts)

    def _send(self, event: str, facts: Mapping) -> None:
        with self._lock:
            self._told = time.monotonic()
            for sink in self._sinks:
                sink(event, facts)

    def _beat(self) -> None:
        while not self._wake.wait(max(0.05, SILENCE - 0.1 - (time.monotonic() - self._told))):
            with self._lock:
                now = time.monotonic()
                if now - self._told >= SILENCE - 0.1 and not self._wake.is_set():
                    self._send("doing", {**self._what, "seconds": round(now - self._began, 1)})


class Terminal:
    """For people, on stderr: a bar where that is a terminal, else a line when there was none for a while."""

    def __init__(self, stream=None):
        self.stream = sys.stderr if stream is None else stream
        self.bar, self.last, self.open = self.stream.isatty(), time.monotonic(), False

    def __call__(self, event: str, facts: Mapping) -> None:
        if event == "doing":
            so_far = f" {facts['done']}/{facts['total']}" if "total" in facts else ""
            took = f", {facts['seconds']:.0f} s" if "seconds" in facts else ""
            self._show(f"{facts['what']}{so_far}{took}", False)
        elif event == "step":
            self._step(facts)
        elif event == "resumed":
            self._line(f"going on with {facts['phase']} after {facts['done']} of {facts['steps']} steps")
        elif event == "serving":
            self._line(f"live at {facts['address']}")
        elif event == "stopped":
            self._line(f"stopped {facts['phase']} after {facts['done']} of {facts['steps']} steps")
        elif event == "end" and self.open:
            self._write("\r\x1b[K")
            self.open = False

    def _step(self, facts: Mapping) -> None:
        done, steps, loss = facts["done"], facts["steps"], facts["loss"]
        text = (f"{facts['phase']} {done}/{steps}" + (f" loss {loss:.5g}" if loss is not None else "")
                + f" {facts['ms_per_step']:.1f} ms a step")
        if done < steps:
            text += f", {duration(facts['seconds_left'])} left"
        full = 24 * done // steps
        self._show(f"[{'#' * full}{' ' * (24 - full)}] {text}" if self.bar else text, done == steps)

    def _show(self, text: str, end: bool) -> None:
        now = time.monotonic()
        if self.bar:
            self._write(f"\r{text}\x1b[K" + ("\n" if end else ""))
            self.open = not end
        elif end or now - self.last >= SILENCE - 0.2:
            self._write(text + "\n")
            self.last = now

    def _line(self, text: str) -> None:
        self._write(("\r\x1b[K" if self.open else "") + text + "\n")
        self.open, self.last = False, time.monotonic()

    def _write(self, text: str) -> None:
        self.stream.write(text)
        self.stream.flush()


class JsonLines:
    """For programs, on stdout: one JSON object a line, its first key `event`. Numbers that are not finite are null. Who reads them may go
    away; the work goes on."""

    def __init__(self, stream=None):
        self.stream = sys.stdout if stream is None else stream

    def __call__(self, event: str, facts: Mapping) -> None:
        if event == "end" or self.stream is None:
            return
        try:
            self.stream.write(json.dumps({"event": event, **finite(facts)}, allow_nan=False) + "\n")
            self.stream.flush()
        except BrokenPipeError:
            self.stream = None


def finite(value):
    """The value with None for numbers that JSON does not have."""
    if isinstance(value, Mapping):
        return {key: finite(x) for key, x in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(x) for x in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def duration(seconds: float) -> str:
    """Seconds as people say them: 8 s, 1:36, 2:05:10."""
    whole = int(math.ceil(seconds))
    if whole < 60:
        return f"{whole} s"
    hours, rest = divmod(whole, 3600)
    return f"{hours}:{rest // 60:02}:{rest % 60:02}" if hours else f"{rest // 60}:{rest % 60:02}"
