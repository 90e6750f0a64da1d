"""A loaded bundle on a device: set inputs, step, get results. Everything is checked when it is loaded or given."""
from __future__ import annotations

import functools
import os
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager

import numpy as np

from ..cache import bundle as bundles
from ..cache import vjp
from ..cache.copies import ENTER, OUTPUT, PHASE
from ..cache.errors import DeviceError, InputError
from ..cache.layout import Layout
from ..cache.profile import Profile
from ..cache.reactive import Reactive
from ..cache.steps import bounded, check_step
from . import checkpoint as checkpoints
from . import running, saved, values, vk
from .counters import Counters
from .device import Device
from .emulate import EmulatedDevice
from .fed import Fed
from .fit import choose
from .kept import Kept
from .memory import Images, Staging, image_bytes
from .pipeline_store import PipelineStore
from .pipelines import Pipelines
from .plans import Plan, profile_stages
from .record import Recording
from .serial import serial
from .transfer import batches, clear, upload
from .work import Work


def load(path: str | os.PathLike, device: str | Device | EmulatedDevice | None = None, *, validation: bool = False,
         emulate: Profile | str | os.PathLike | None = None, profile: str | None = None, pin: str | None = None) -> Session:
    """Open a bundle on a device (an open one, or a part of its name; default $DRESSI_DEVICE or the best). `emulate`: a profile
    (or its name) whose limits, features and formats the device reports and enforces as if they were its own. Of several
    variants the first that fits is taken, or the one made for `profile`. `pin`: the SHA-256 (64 hexadecimal digits) that the file
    must have; the bytes that have it are those that are loaded. BundleError if the file is wrong, DeviceError if there is no device
    or the bundle does not fit it, ProfileError if there is no such profile, InputError if no variant is made for it."""
    bundle = bundles.read(path, pin)
    if emulate is not None and not isinstance(emulate, Profile):
        emulate = Profile.load(emulate)
    opened = device if isinstance(device, Device | EmulatedDevice) else Device.open(device, validation=validation)
    try:
        seen = opened if emulate is None else EmulatedDevice(opened, emulate)
        return Session(bundle, seen, owns_device=opened is not device, profile=profile)
    except BaseException:
        if opened is not device:
            opened.close()
        raise


def _layout(value: dict) -> Layout:
    return Layout(value["layout"], value["type"], value["width"], value["height"], value["count"], value["columns"])


class Session:
    """A context manager. Calls from several threads run one after another; docs/embedding.md tells what each error leaves.
    `bundle`: the variant that runs, of those of the one that was given. real: the type of its numbers."""

    real = np.float32

    def __init__(self, bundle: bundles.Bundle, device: Device | EmulatedDevice, owns_device: bool = False,
                 profile: str | None = None):
        self.device, self._owns_device = device, owns_device
        self._process = os.getpid()
        self._lock, self._waiting, self._closed = threading.RLock(), set(), ""  # why it is closed
        self._images = self._pipelines = self._staging = self._store = self._work = None
        if device.process != self._process:
            raise DeviceError("the device was opened before this process was forked; open another")
        self.bundle, self._depth_format, self._why = choose(bundle.variants, device, profile)
        self._d = self.bundle.description
        self.values = {value["name"]: value for value in self._d["values"] if value["role"] != "copy"}
        self._layouts = {name: _layout(value) for name, value in self.values.items()}
        self.plans = {plan["name"]: plan for plan in self._d["plans"]}
        self._reactive = Reactive(self._d)
        self._fed, self._kept = Fed(self), Kept(self)
        self._counters = Counters(self, self._fed.counters() | self._kept.counters())
        self._plans = {plan["name"]: Plan(plan, self._d, self._reactive.rules[plan["name"]]) for plan in self._d["plans"]}
        self._giver = {name: plan for plan in reversed(self._plans.values()) for name in plan.rule.outputs}
        self.phases = [plan.name for plan in self._plans.values() if plan.rule.kind == PHASE]
        self.phase = self.phases[0] if self.phases else None
        self._parity = {value["image"]: 0 for value in self._d["values"]}
        self._largest = max((image_bytes(self._d["images"][x["image"]]) for x in self.values.values()), default=0)
        self._runs: dict[str, int] = dict.fromkeys(self.plans, 0)
        self._skipped: dict[str, int] = dict.fromkeys(self.plans, 0)
        try:
            self._open()
        except BaseException as error:
            self._release("the session did not open")
            if isinstance(error, vk.VulkanError) and error.result == vk.VK_ERROR_DEVICE_LOST:
                raise DeviceError(f"{device.name} was lost ({error}); open it again") from error
            raise

    # ---- opening and closing

    def _open(self) -> None:
        self._work, self._staging = Work(self.device, bool(self._d.get("computes"))), Staging(self.device)
        self._images = Images(self.device, self._kept.copied(self._d["images"]), self._depth_format)
        self._work.begin(functools.partial(clear, self._images, compute=self._work.compute))
        # the device does this while the driver compiles
        try:
            self._store = PipelineStore(self.device, self.bundle.digest)
            self._pipelines = Pipelines(self.device, self.bundle, self._depth_format, self._store.handle)
            self._store.keep()
        finally:
            self._work.finish()
        data = [(k, image["data"]) for k, image in enumerate(self._d["images"]) if image["data"] is not None]
        data += [(value["image"], value["initial"]) for value in self._d["values"] if value["initial"] is not None]
        for batch in batches([self._copy(k, start) for k, start in data]):
            upload(self._work, self._staging, batch)

    def _handle(self, image: int) -> tuple[int, dict]:
        """The current image and its record."""
        return self._images.handles[image][self._parity.get(image, 0)], self._d["images"][image]

    def _copy(self, image: int, start: int | bytes) -> tuple[int, dict, np.ndarray]:
        return *self._handle(image), np.frombuffer(start if type(start) is bytes else self.bundle.blob(start), np.uint8)

    def close(self) -> None:
        """Give everything back; safe to call twice. In a forked child, which owns nothing on the device, it does nothing."""
        if os.getpid() == self._process:
            with self._lock:
                if not self._closed:
                    self._release("the session is closed")

    def _release(self, why: str) -> None:
        if self._work is not None:
            try:
                self._work.finish()  # interrupted here, the session is still open
            except vk.VulkanError:  # lost: nothing runs any more
                pass
        self._closed = why
        if self.device.device:
            for plan in self._plans.values():
                for recording in plan.recordings.values():
                    recording.close()
                plan.recordings = {}
            for part in (self._fed, self._kept, self._pipelines, self._store, self._images, self._staging, self._work):
                if part is not None:
                    part.close()
        if self._owns_device:
            self.device.close()

    def _lost(self, error: vk.VulkanError) -> DeviceError:
        with self._lock:
            if not self._closed:
                self._release(f"the session is closed: {self.device.name} was lost ({error}); open device and bundle again, and "
                              "restore the last checkpoint there")
            return DeviceError(self._closed)

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *_) -> None:
        self.close()

    def _usable(self) -> None:
        if os.getpid() != self._process:
            raise DeviceError(f"the session belongs to process {self._process}, of which this one is a fork; "
                              "load the bundle in this process")
        if self._closed:
            raise DeviceError(self._closed)

    # ---- values

    def shape(self, name: str) -> tuple[int, ...]:
        """The array shape of a value."""
        values.known(self, name, ("input", "state", "output"))
        shape = self._layouts[name].shape
        return self._fed.shape(name, shape) if self._fed.has(name) else shape

    def set(self, name: str, array, view: int | None = None) -> None:
        """Give an input or state a new value: an array of `shape(name)`; view: of pictures one, which costs that one alone. InputError for
        a wrong shape, type, NaN, Inf, or numbers that are infinite in fp32, or in fp16 if it is stored so."""
        if view is None:
            self.set_all({name: array})
        else:
            self._fed.set(name, array, view)

    def pictures(self, read: Callable[[int], np.ndarray]) -> None:
        """Where the pictures come from that the bundle does not have: `read(k)` gives picture k, (height, width, 4), as its file has it
        (uint8) or as shaders see it (float); called on other threads, for each when it is needed. Raises InputError where all of them are
        on the device from the start."""
        self._usable()
        self._fed.pictures(read)

    def ready(self) -> None:
        """Raises InputError where the bundle needs pictures that nobody has given, rather than at the first step."""
        self._usable()
        self._fed.ready()

    def set_all(self, arrays: Mapping[str, object]) -> None:
        """`set` of several in one submission: all of them or, after an error, none."""
        values.set_all(self, arrays)

    def get(self, name: str, view: int | None = None) -> np.ndarray:
        """The value of an input, state or output now, float32 or int32; outputs are computed if what they need has changed. view: of
        pictures one alone, (height, width[, channels])."""
        return self.get_all([name])[name] if view is None else self._fed.get(name, view)

    def get_all(self, names: Iterable[str], into: Mapping[str, np.ndarray] | None = None) -> dict[str, np.ndarray]:
        """`get` of several in one submission. into: arrays of their shapes to write some of them to, float32 or int32."""
        return values.get_all(self, names, into)

    # ---- for bridges into other people's loops (dressi_edge/bridges)

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Calls of other threads wait until this context ends."""
        self._usable()
        with self._lock:
            yield

    def reads(self, plan: str) -> tuple[str, ...]:
        """The inputs and states that a plan, and all that runs for it, depends on."""
        return tuple(name for name in self._reactive.rules[plan].reads if name in self.values)

    def version(self, name: str) -> int:
        """Of an input or a state: another number after each change."""
        return self._reactive.version[name]

    # ---- running

    def step(self, n: int = 1, phase: str | None = None, seconds: float | None = None, cancel=None) -> int:
        """Run n iterations of a phase (default: the current one) in one submission; how many were run.

        seconds   stop after about that long: no iteration begins that the one before says would end later, the first excepted
        cancel    a threading.Event or a function without arguments; asked between iterations, true stops

        With either, work is submitted in chunks of about 20 ms, and other threads' calls run between them.
        """
        stop = check_step(n, seconds, cancel)
        if seconds is None and cancel is None:
            return self._step(n, phase)
        plan = self._choose(phase)
        return bounded(n, lambda k: self._chunk(plan, k), seconds, stop)

    @serial
    def _choose(self, phase: str | None) -> Plan:
        if phase is not None:
            if phase not in self.phases:
                raise InputError(f"{phase!r:.60} is no phase of this bundle; there are: {' '.join(self.phases)}")
            self.phase = phase
        if self.phase is None:
            raise InputError("this bundle updates nothing: there is no phase to step")
        return self._plans[self.phase]

    @serial
    def _step(self, n: int, phase: str | None) -> int:
        plan = self._choose(phase)
        running.run(self, plan, n)
        return n

    def _chunk(self, plan: Plan, n: int) -> float:
        """n iterations, after what waits; seconds of each, 0 for the first run of all, in which the driver may have compiled."""
        self._let_in()
        warm = plan.kept
        return warm * self._timed(plan, n) / n

    @serial
    def _timed(self, plan: Plan, n: int) -> float:
        start = time.perf_counter()
        running.run(self, plan, n)
        return time.perf_counter() - start

    def _let_in(self) -> None:
        """Let those calls begin that are waiting now: the lock alone would mostly come back to whoever just gave it up."""
        waiting, end = set(self._waiting), time.perf_counter() + 1.0
        while waiting & self._waiting and time.perf_counter() < end:
            time.sleep(1e-4)

    @serial
    def forward(self, name: str) -> dict[str, np.ndarray]:
        """The outputs of `Scene.vjp(name)` with the parameters as they are, by their short names. Raises InputError."""
        return vjp.forward(self, name)

    @serial
    def backward(self, name: str, **gradients) -> dict[str, np.ndarray]:
        """By parameter, the gradient of whatever has these gradients by the outputs of `name` (arrays of their shapes; none: zero).
        What was drawn for `forward` is not drawn again. Raises InputError."""
        return vjp.backward(self, name, gradients)

    def loss(self) -> float:
        """The loss of the current phase at the current state."""
        return float(self.get(f"{self.phase}.loss"))

    @serial
    def profile_stages(self, name: str, runs: int = 5) -> list[float]:
        """Median milliseconds of each stage of a plan by device timestamps; states advance as in `runs` steps, of one view where views
        are kept."""
        plan = self._plans[name]
        running.ready(self, plan, runs)
        self._kept.prepare(plan)

        def record(timestamps: int) -> Recording:
            return running.record(self, plan, {k: self._parity.get(k, 0) for k in plan.slots}, timestamps)

        count = len(plan.record["stages"])
        return profile_stages(self.device, self._work, count, record, lambda: running.stepped(self, plan, 1), runs)

    # ---- checkpoints and report

    def checkpoint(self, path: str | os.PathLike) -> None:
        """Write all states, inputs and counters to a file, atomically. Raises InputError if it cannot be written, or if a state is no
        longer finite, which no `restore` would take; the file that was there before is then untouched."""
        saved.checkpoint(self, path)

    def restore(self, path: str | os.PathLike) -> None:
        """Take the values and counters of a checkpoint of the same bundle, of whichever variant; what follows is bit-identical
        to what followed there on the same device and variant. Raises InputError if there is no such file, BundleError if it is
        damaged, of another bundle, or holds numbers that `set` would refuse; nothing has changed then."""
        saved.restore(self, path)

    @serial
    def _snapshot(self) -> checkpoints.Checkpoint:
        return saved.snapshot(self)

    @serial
    def report(self) -> dict:
        """Which variant was taken and why, what ran how often and how often it did not need to, what the session occupies."""
        self._work.settle()
        skipped = {name: k for name, k in self._skipped.items() if self._plans[name].rule.kind in (OUTPUT, ENTER)}
        return {"device": self.device.name, "driver": self.device.driver_info, "profile": self.bundle.profile,
                "variants": dict(self._why),
                "runs": dict(self._runs), "skipped": skipped,
                "texels": self._d["meta"].get("texels", {}),
                "views_kept": self._kept.report(),
                "image_bytes": self._images.bytes + self._kept.bytes, "staging_bytes": self._staging.size,
                "pipelines": len(self._d["pipelines"]) + len(self._d.get("computes", ())), "pipeline_cache": self._store.state,
                "time": time.time()}
