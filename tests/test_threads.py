"""Sessions in other people's programs: several threads, several sessions on a device, bounded and cancelled steps, a preview
while it runs, and forks."""

import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from graphs import python
from test_session import STATES, bits, cacheable
from undertest import DEVICE

from dressi_edge import runtime
from dressi_edge.cache import steps
from dressi_edge.cache.errors import DeviceError, InputError
from dressi_edge.runtime import vk

pytest_plugins = ["gpu", "sessions"]

SECONDS = 60  # a hang is a failure


def together(*works):
    """Run functions at the same time; their results, or the first error."""
    with ThreadPoolExecutor(len(works)) as pool:
        return [f.result(SECONDS) for f in [pool.submit(work) for work in works]]


# Threads


def test_calls_of_many_threads_on_one_session_run_one_after_another(gpu, bundle, session):
    def work():
        for _ in range(10):
            session.step(2, "walk")
            assert np.isfinite(session.get("picture")).all()
            session.set("rate", 0.1)

    together(*[work] * 4)
    with runtime.load(bundle, gpu.device) as alone:
        alone.step(80)
        assert bits(session) == bits(alone)


def test_sessions_on_one_device_do_not_disturb_each_other(gpu, bundle):
    other = gpu.compile(cacheable())

    def run(path, phase, names):
        with runtime.load(path, gpu.device) as s:
            for _ in range(5):
                s.step(3, phase)
            return bits(s, names)

    walked, went = ("a", "b", "picture", "loss"), ("v", "shown", "still", "loss")
    expected = run(bundle, "walk", walked), run(other, "go", went)
    assert together(*[lambda: run(bundle, "walk", walked), lambda: run(other, "go", went)] * 2) == [*expected] * 2
    gpu.silent()


def test_the_queue_is_used_by_one_thread_at_a_time(gpu, bundle, monkeypatch):
    inside, overlaps = [], []

    def alone(name):
        real = getattr(vk, name)

        def call(*args, **options):
            overlaps.extend(inside)
            inside.append(name)
            time.sleep(0.0005)
            try:
                return real(*args, **options)
            finally:
                inside.remove(name)

        monkeypatch.setattr(vk, name, call)

    for name in ("QueueSubmit", "QueueWaitIdle", "DeviceWaitIdle"):
        alone(name)

    def run():
        with runtime.load(bundle, gpu.device) as s:
            for _ in range(10):
                s.step(1)
                s.get("a")

    together(run, run, run)
    assert overlaps == []
    gpu.silent()


def test_sessions_on_devices_of_their_own(bundle):
    def run():
        with runtime.load(bundle, DEVICE) as s:
            s.step(5)
            return bits(s)

    first, second = together(run, run)
    assert first == second


def test_a_session_closed_by_another_thread_ends_a_bounded_step(gpu, bundle):
    s = runtime.load(bundle, gpu.device)
    s.step(1)
    started = threading.Event()

    def step():
        with pytest.raises(DeviceError, match="the session is closed"):
            s.step(10 ** 9, seconds=SECONDS, cancel=lambda: started.set())

    def close():
        assert started.wait(SECONDS)
        s.close()

    together(step, close)
    gpu.silent()


# Bounded and cancelled


def test_a_plain_step_is_one_submission(session, monkeypatch):
    session.step(2)
    submits, real = [], vk.QueueSubmit
    monkeypatch.setattr(vk, "QueueSubmit", lambda *args: submits.append(args) or real(*args))
    assert session.step(100) == 100 and len(submits) == 1
    assert session.step(0) == 0 and len(submits) == 1
    assert session.step(100, seconds=SECONDS) == 100 and len(submits) > 2


def test_a_bounded_step_is_the_plain_one_as_far_as_it_goes(gpu, bundle, session):
    done = session.step(10 ** 9, seconds=0.3)
    assert session.step(0, seconds=1) == session.step(5, seconds=0) == 0
    more = session.step(7, "walk", seconds=SECONDS)
    assert done > 1 and more == 7 and session.get("t") == done + 7
    with runtime.load(bundle, gpu.device) as plain:
        plain.step(done + 7)
        assert bits(session, STATES) == bits(plain, STATES)


def test_time_is_kept(session):
    session.step(1)
    start = time.perf_counter()
    session.step(10 ** 9, seconds=0.2)
    assert time.perf_counter() - start < 10  # a generous multiple: the machine may be busy


def test_no_iteration_begins_that_would_end_too_late():
    now, ran = [0.0], []

    def run(k):
        ran.append(k)
        now[0] += k * 0.3
        return 0.3

    class Clock:
        perf_counter = staticmethod(lambda: now[0])

    real, steps.time = steps.time, Clock
    try:
        assert steps.bounded(100, run, 1.0, lambda: False) == 3 and ran == [1, 1, 1]
        assert steps.bounded(100, run, 0.1, lambda: False) == 1
        assert steps.bounded(2, run, 1.0, lambda: False) == 2
    finally:
        steps.time = real


def test_cancel_is_an_event_or_a_function(session):
    event = threading.Event()
    event.set()
    assert session.step(10, cancel=event) == 0
    answers = iter([False, False, False, True])
    done = session.step(10 ** 9, cancel=lambda: next(answers))
    assert 3 <= done < 10 ** 9 and session.get("t") == done

    event.clear()
    threading.Timer(0.2, event.set).start()
    assert session.step(10 ** 9, cancel=event) > 0
    with pytest.raises(ZeroDivisionError):
        session.step(10, cancel=lambda: 1 / 0)
    t = session.get("t")
    session.step(1)
    assert session.get("t") == t + 1


def test_cancel_may_use_the_session(session):
    seen = []
    session.step(10 ** 9, seconds=0.2, cancel=lambda: seen.append(int(session.get("t"))))
    assert seen == sorted(set(seen)) and len(seen) > 1


@pytest.mark.parametrize("options, message", [({"seconds": -1}, "seconds=-1"), ({"seconds": float("nan")}, "seconds=nan"),
                                              ({"seconds": "1"}, "0 or more"), ({"cancel": 1}, "a threading.Event or a function")])
def test_wrong_bounds_are_refused(session, options, message):
    with pytest.raises(InputError, match=message):
        session.step(1, **options)
    assert session.get("t") == 0


def test_images_can_be_watched_while_it_runs(session):
    session.step(1)
    stop, seen, waits = threading.Event(), [], []

    def watch():
        try:
            for _ in range(20):
                start = time.perf_counter()
                seen.append((int(session.get("t")), session.get("picture").tobytes()))
                waits.append(time.perf_counter() - start)
        finally:
            stop.set()

    done, _ = together(lambda: session.step(10 ** 9, seconds=SECONDS, cancel=stop), watch)
    steps = [t for t, _ in seen]
    assert steps == sorted(steps) and steps[-1] > steps[0] and session.get("t") == done + 1
    assert np.median(waits) < 2


# What ran


def test_the_report_counts_what_was_skipped(gpu):
    with gpu.open(cacheable()) as s:
        prepared = [name for name in s.plans if name.endswith("prepare")]
        s.step(1, "go")
        before = s.report()
        s.step(5, "go")
        s.step(5, "go")
        s.get("level")
        s.get("level")
        after = s.report()
        assert any(after["skipped"][name] >= before["skipped"][name] + 2 for name in prepared)
        assert after["runs"]["level"] == after["skipped"]["level"] == 1
        assert after["runs"]["go"] == 11 and "go" not in after["skipped"]
    gpu.silent()


# Forks


FORK = """
import os, sys, threading, time
from dressi_edge import runtime
from dressi_edge.cache.errors import DeviceError
s = runtime.load(sys.argv[1])
s.step(3)
stop = threading.Event()
runner = threading.Thread(target=s.step, args=(10 ** 9,), kwargs={"cancel": stop})  # holds the lock at the fork
runner.start()
time.sleep(0.1)
child = os.fork()
if not child:
    refused = 0
    for work in (lambda: s.step(1), lambda: s.get("a"), lambda: s.set("rate", 1.0), lambda: s.shape("a"), s.report, s.loss,
                 lambda: s.checkpoint("c"), lambda: s.restore("c"), lambda: runtime.Session(s.bundle, s.device)):
        try:
            work()
        except DeviceError as error:
            refused += "fork" in str(error)
    s.close()
    s.device.close()
    os._exit(refused)
end = time.time() + 30
status = None
while status is None and time.time() < end:
    done, code = os.waitpid(child, os.WNOHANG)
    status = os.waitstatus_to_exitcode(code) if done else time.sleep(0.01)
if status is None:
    os.kill(child, 9)
stop.set()
runner.join()
t = int(s.get("t"))
s.step(1)
print(status, int(s.get("t")) - t)
s.close()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no fork")
def test_a_forked_child_is_told_and_the_parent_goes_on(bundle):
    assert python(FORK, bundle, PYTHONWARNINGS="ignore").split() == ["9", "1"]
