"""How many iterations a step makes: what its arguments may be, and the loop that time and a caller can end.

Used by the session on a device and by the reference, so that both take and refuse the same.
"""
from __future__ import annotations

import numbers
import time
from collections.abc import Callable

from .errors import InputError

CHUNK_SECONDS = 0.02  # of a step that is bounded in time or can be cancelled: about what others wait for


def check_step(n, seconds, cancel) -> Callable[[], object]:
    """`step(n, seconds=, cancel=)`: the function that says when to stop. Raises InputError."""
    if type(n) is not int or n < 0:
        raise InputError(f"step({n!r:.40}): a count of 0 or more is needed")
    if seconds is not None and not (isinstance(seconds, numbers.Real) and seconds >= 0):
        raise InputError(f"step(seconds={seconds!r:.40}): 0 or more is needed")
    stop = bool if cancel is None else getattr(cancel, "is_set", cancel)
    if not callable(stop):
        raise InputError(f"step(cancel={cancel!r:.40}): a threading.Event or a function is needed")
    return stop


def bounded(n: int, run: Callable[[int], float], seconds: float | None, stop: Callable[[], object]) -> int:
    """Up to n iterations in chunks of about `CHUNK_SECONDS`; how many were run. `run(k)` runs k and gives the seconds of one, 0
    where that tells nothing of the next; `stop()` is asked between chunks."""
    end, done, size, pace = time.perf_counter() + (float("inf") if seconds is None else float(seconds)), 0, 1, 0.0
    while done < n and not stop():
        left = end - time.perf_counter()
        if left <= pace:
            break
        if pace:
            size = max(1, min(2 * size, int(min(CHUNK_SECONDS, left) / pace)))
        size = min(size, n - done)
        pace = run(size)
        done += size
    return done
