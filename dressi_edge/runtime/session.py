"""A loaded bundle on a device: set inputs, step, get results. Everything is checked when it is loaded or given."""
from __future__ import annotations

import os
import threading
import time

import numpy as np

from ..cache import bundle as bundles
from ..cache import vulkan as v
from ..cache.errors import BundleError, DeviceError, InputError
from ..cache.layout import CHANNELS, Layout, is_int
from ..cache.profile import Profile, misfit
from ..cache.verify import violations
from . import vk
from .device import Device
from .emulate import EmulatedDevice, rules
from .memory import Images, Staging, image_bytes, region
from .pipeline_store import PipelineStore
from .pipelines import Pipelines
from .record import Recording, wait

DEPTH_BIT = vk.VK_FORMAT_FEATURE_DEPTH_STENCIL_ATTACHMENT_BIT


def load(path: str | os.PathLike, device: str | Device | EmulatedDevice | None = None, *, validation: bool = False,
         emulate: Profile | str | os.PathLike | None = None) -> Session:
    """Open a bundle on a device (an open one, or a part of its name; default $DRESSI_DEVICE or the best). `emulate`: a profile
    (or its name) whose limits, features and formats the device reports and enforces as if they were its own. BundleError if the
    file is wrong, DeviceError if there is no device or the bundle does not fit it, ProfileError if there is no such profile."""
    bundle = bundles.read(path)
    if emulate is not None and not isinstance(emulate, Profile):
        emulate = Profile.load(emulate)
    opened = device if isinstance(device, Device | EmulatedDevice) else Device.open(device, validation=validation)
    try:
        return Session(bundle, opened if emulate is None else EmulatedDevice(opened, emulate), owns_device=opened is not device)
    except BaseException:
        if opened is not device:
            opened.close()
        raise


def _layout(value: dict) -> Layout:
    return Layout(value["layout"], value["type"], value["width"], value["height"], value["count"], value["columns"])


class Session:
    """A context manager. Calls from several threads run one after another."""

    def __init__(self, bundle, device: Device | EmulatedDevice, owns_device: bool = False):
        self.bundle, self.device, self._owns_device = bundle, device, owns_device
        self._d = bundle.description
        self._lock = threading.RLock()
        self._closed = False
        self._images = self._pipelines = self._staging = self._store = None
        self._pool = self._fence = 0
        self._recordings: dict[tuple, Recording] = {}
        self._check_device()
        self.values = {value["name"]: value for value in self._d["values"]}
        self._layouts = {name: _layout(value) for name, value in self.values.items()}
        self.plans = {plan["name"]: plan for plan in self._d["plans"]}
        self.phases = [plan["name"] for plan in self._d["plans"] if plan["updates"]]
        self.phase = self.phases[0] if self.phases else None
        self._parity = {value["image"]: 0 for value in self._d["values"]}
        self._version = dict.fromkeys(self.values, 0)
        self._seen: dict[str, tuple] = {}
        self._unset = {n for n, x in self.values.items() if x["role"] == "input" and x["initial"] is None}
        self._runs: dict[str, int] = dict.fromkeys(self.plans, 0)
        try:
            self._open()
        except BaseException:
            self._release()
            raise

    # ---- opening and closing

    def _check_device(self) -> None:
        """What the bundle does, counted anew, and what it says it needs, against the device and the profile it emulates."""
        d, device = self._d, self.device
        for name in d["needs"]["formats"]:
            if name not in v.FORMATS:
                raise BundleError(f"needs.formats names {name}, which this reader does not know")
        self._depth_format, needs = 0, {**d["needs"]["limits"], **d["needs"]["formats"]}
        for profile in rules(device):
            lines = violations(d, profile, self.bundle.interfaces) or misfit(needs, profile)
            if lines:
                more = f"; and {len(lines) - 3} more" if len(lines) > 3 else ""
                raise DeviceError(f"the bundle, made for profile {d['profile']['name']}, does not fit {profile.name}: "
                                  f"{'; '.join(lines[:3])}{more}; compile it for a profile this device has")
        if any(image["format"] == 0 for image in d["images"]):
            views = {device, getattr(device, "real", device)}
            able = [f for f in d["depth_formats"] if all(view.format_features(f)[1] & DEPTH_BIT for view in views)]
            if not able:
                raise DeviceError(f"none of the depth formats {d['depth_formats']} is a depth attachment of {device.name}")
            self._depth_format = able[0]

    def _open(self) -> None:
        device = self.device.device
        self._pool = vk.CreateCommandPool(device, vk.VkCommandPoolCreateInfo(
            flags=vk.VK_COMMAND_POOL_CREATE_RESET_COMMAND_BUFFER_BIT, queueFamilyIndex=self.device.queue_family))
        self._fence = vk.CreateFence(device, vk.VkFenceCreateInfo())
        self._staging = Staging(self.device)
        self._images = Images(self.device, self._d["images"], self._depth_format)
        clearing = self._start(self._clear)  # the device does this while the driver compiles
        try:
            self._store = PipelineStore(self.device, self.bundle.digest)
            self._pipelines = Pipelines(self.device, self.bundle, self._depth_format, self._store.handle)
            self._store.keep()
        finally:
            self._finish(clearing)
        uploads = [(k, self.bundle.blob(image["data"])) for k, image in enumerate(self._d["images"]) if image["data"] is not None]
        uploads += [(value["image"], self.bundle.blob(value["initial"])) for value in self._d["values"] if value["initial"] is not None]
        for image, data in uploads:
            self._write(image, np.frombuffer(data, np.uint8))

    def _start(self, record) -> int:
        """Record and submit one command buffer, for `_finish` to wait for before anything else is submitted."""
        device = self.device.device
        commands = vk.AllocateCommandBuffers(device, vk.VkCommandBufferAllocateInfo(
            commandPool=self._pool, level=vk.VK_COMMAND_BUFFER_LEVEL_PRIMARY, commandBufferCount=1))[0]
        try:
            vk.BeginCommandBuffer(commands, vk.VkCommandBufferBeginInfo(flags=vk.VK_COMMAND_BUFFER_USAGE_ONE_TIME_SUBMIT_BIT))
            record(commands)
            vk.EndCommandBuffer(commands)
            vk.QueueSubmit(self.device.queue, [vk.VkSubmitInfo(pCommandBuffers=[commands])], self._fence)
        except BaseException:
            vk.FreeCommandBuffers(device, self._pool, [commands])
            raise
        return commands

    def _finish(self, commands: int) -> None:
        try:
            self._wait()
        finally:
            vk.FreeCommandBuffers(self.device.device, self._pool, [commands])

    def _once(self, record) -> None:
        """Record, submit and finish one command buffer."""
        self._finish(self._start(record))

    def _submit(self, commands: list[int]) -> None:
        vk.QueueSubmit(self.device.queue, [vk.VkSubmitInfo(pCommandBuffers=commands)], self._fence)
        self._wait()

    def _wait(self) -> None:
        while vk.WaitForFences(self.device.device, [self._fence], True, 1_000_000_000) == vk.VK_TIMEOUT:
            pass
        vk.ResetFences(self.device.device, [self._fence])

    def _clear(self, c: int) -> None:
        """Bring every image to GENERAL, zero."""
        barriers, wipes = [], []
        for record, handles in zip(self._d["images"], self._images.handles):
            aspect = vk.VK_IMAGE_ASPECT_COLOR_BIT if record["format"] else vk.VK_IMAGE_ASPECT_DEPTH_BIT
            for handle in handles:
                barriers.append(vk.VkImageMemoryBarrier(
                    srcAccessMask=0, dstAccessMask=vk.VK_ACCESS_TRANSFER_WRITE_BIT, oldLayout=vk.VK_IMAGE_LAYOUT_UNDEFINED,
                    newLayout=vk.VK_IMAGE_LAYOUT_GENERAL, srcQueueFamilyIndex=vk.VK_QUEUE_FAMILY_IGNORED,
                    dstQueueFamilyIndex=vk.VK_QUEUE_FAMILY_IGNORED, image=handle, subresourceRange=(aspect, 0, 1, 0, 1)))
                if record["format"]:
                    wipes.append(handle)
        if barriers:
            vk.CmdPipelineBarrier(c, vk.VK_PIPELINE_STAGE_TOP_OF_PIPE_BIT, vk.VK_PIPELINE_STAGE_ALL_COMMANDS_BIT, 0,
                                  pImageMemoryBarriers=barriers)
        for handle in wipes:
            vk.CmdClearColorImage(c, handle, vk.VK_IMAGE_LAYOUT_GENERAL, vk.VkClearColorValue(),
                                  [(vk.VK_IMAGE_ASPECT_COLOR_BIT, 0, 1, 0, 1)])
        wait(c)

    def _write(self, image: int, data: np.ndarray) -> None:
        self._staging.reserve(data.nbytes)
        self._staging.view[:data.nbytes] = data
        handle = self._images.handles[image][self._parity.get(image, 0)]

        def copy(c):
            wait(c)
            vk.CmdCopyBufferToImage(c, self._staging.buffer, handle, vk.VK_IMAGE_LAYOUT_GENERAL,
                                    [region(self._d["images"][image], 0)])
            wait(c)

        self._once(copy)

    def _read(self, image: int) -> bytes:
        record = self._d["images"][image]
        size = image_bytes(record)
        self._staging.reserve(size)
        handle = self._images.handles[image][self._parity.get(image, 0)]

        def copy(c):
            wait(c)
            vk.CmdCopyImageToBuffer(c, handle, vk.VK_IMAGE_LAYOUT_GENERAL, self._staging.buffer, [region(record, 0)])
            vk.CmdPipelineBarrier(c, vk.VK_PIPELINE_STAGE_TRANSFER_BIT, vk.VK_PIPELINE_STAGE_HOST_BIT, 0, pMemoryBarriers=[
                vk.VkMemoryBarrier(srcAccessMask=vk.VK_ACCESS_TRANSFER_WRITE_BIT, dstAccessMask=vk.VK_ACCESS_HOST_READ_BIT)])

        self._once(copy)
        return self._staging.view[:size].tobytes()

    def close(self) -> None:
        """Give everything back; safe to call twice."""
        with self._lock:
            if not self._closed:
                self._release()

    def _release(self) -> None:
        self._closed = True
        device = self.device.device
        if device:
            for recording in self._recordings.values():
                recording.close()
            for part in (self._pipelines, self._store, self._images, self._staging):
                if part is not None:
                    part.close()
            if self._fence:
                vk.DestroyFence(device, self._fence)
            if self._pool:
                vk.DestroyCommandPool(device, self._pool)
        self._recordings = {}
        self._pool = self._fence = 0
        if self._owns_device:
            self.device.close()

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *_) -> None:
        self.close()

    def _usable(self) -> None:
        if self._closed:
            raise DeviceError("the session is closed")

    # ---- values

    def _value(self, name: str, roles: tuple[str, ...]) -> dict:
        self._usable()
        value = self.values.get(name)
        if value is None or value["role"] not in roles:
            known = " ".join(n for n, x in self.values.items() if x["role"] in roles)
            raise InputError(f"{name!r:.60} is no {' or '.join(roles)} of this bundle; there are: {known}")
        return value

    def shape(self, name: str) -> tuple[int, ...]:
        """The array shape of a value."""
        self._value(name, ("input", "state", "output"))
        return self._layouts[name].shape

    def set(self, name: str, array) -> None:
        """Give an input or state a new value: an array of `shape(name)`. Raises InputError for a wrong shape, type, NaN or Inf."""
        with self._lock:
            value = self._value(name, ("input", "state"))
            pixels = self._layouts[name].to_image(array, name)
            kind = np.int32 if is_int(value["type"]) else np.float32
            if CHANNELS[value["type"]] == 3:
                pixels = np.concatenate([pixels, np.zeros_like(pixels[..., :1])], 2)
            with np.errstate(over="ignore"):
                data = np.ascontiguousarray(pixels, kind)
            if kind is np.float32 and not np.isfinite(data).all():
                raise InputError(f"{name} has values beyond the range of fp32")
            self._write(value["image"], data.reshape(-1).view(np.uint8))
            self._version[name] += 1
            self._unset.discard(name)

    def get(self, name: str) -> np.ndarray:
        """The value of an input, state or output now, float32 or int32; outputs are computed if something they need has changed."""
        with self._lock:
            value = self._value(name, ("input", "state", "output"))
            if value["role"] == "output":
                self._refresh(name)
            kind = np.int32 if is_int(value["type"]) else np.float32
            image = self._d["images"][value["image"]]
            pixels = np.frombuffer(self._read(value["image"]), kind).reshape(image["height"], image["width"], -1)
            return self._layouts[name].from_image(pixels[..., :CHANNELS[value["type"]]]).copy()

    def _refresh(self, name: str) -> None:
        index = self._d["values"].index(self.values[name])
        plan = next(plan for plan in self._d["plans"] if index in plan["outputs"])
        if plan["updates"]:
            if not self._runs[plan["name"]]:
                raise InputError(f"{name} is given out by {plan['name']}, which has not run yet")
        else:
            self._run_if_changed(plan)

    # ---- running

    def _versions(self, plan: dict) -> tuple:
        below = [self._versions(self._d["plans"][n]) for n in plan["needs"]]
        return tuple(self._version[self._d["values"][k]["name"]] for k in plan["reads"]), *below

    def _run_if_changed(self, plan: dict) -> None:
        if self._seen.get(plan["name"]) != self._versions(plan):
            self._run(plan, 1)
            self._seen[plan["name"]] = self._versions(plan)

    def _ready(self, plan: dict) -> None:
        missing = [self._d["values"][k]["name"] for k in plan["reads"] if self._d["values"][k]["name"] in self._unset]
        if missing:
            raise InputError(f"{plan['name']} needs {' '.join(missing)}; set it first")
        for n in plan["needs"]:
            self._ready(self._d["plans"][n])

    def _recording(self, plan: dict) -> Recording:
        used = {ref // 2 for stage in plan["stages"] for ref in stage["attachments"]}
        used |= {ref // 2 for stage in plan["stages"] for draws in stage["subpasses"] for draw in draws for ref in draw["images"]}
        parity = {k: self._parity.get(k, 0) for k in sorted(used) if self._d["images"][k]["slots"] == 2}
        key = (plan["name"], *parity.items())
        if key not in self._recordings:
            self._recordings[key] = Recording(self.device, self._pool, self.bundle, self._images, self._pipelines, plan, parity)
        return self._recordings[key]

    def _run(self, plan: dict, n: int) -> None:
        self._ready(plan)
        for k in plan["needs"]:
            self._run_if_changed(self._d["plans"][k])
        states = [self._d["values"][k] for k in plan["updates"]]
        pair = [self._recording(plan).commands]
        if states and n > 1:
            self._flip(states)
            pair.append(self._recording(plan).commands)
            self._flip(states)
        self._submit((pair * n)[:n])
        if not self._runs[plan["name"]]:
            self._store.keep()
        if n % 2:
            self._flip(states)
        for value in states:
            self._version[value["name"]] += 1
        self._runs[plan["name"]] += n

    def _flip(self, states: list[dict]) -> None:
        for value in states:
            self._parity[value["image"]] ^= 1

    def step(self, n: int = 1, phase: str | None = None) -> None:
        """Run n iterations of a phase (default: the current one) in one submission."""
        with self._lock:
            self._usable()
            if phase is not None:
                if phase not in self.phases:
                    raise InputError(f"{phase!r:.60} is no phase of this bundle; there are: {' '.join(self.phases)}")
                self.phase = phase
            if self.phase is None:
                raise InputError("this bundle updates nothing: there is no phase to step")
            if type(n) is not int or n < 0:
                raise InputError(f"step({n!r:.40}): a count of 0 or more is needed")
            if n:
                self._run(self.plans[self.phase], n)

    def loss(self) -> float:
        """The loss of the current phase at the current state."""
        return float(self.get(f"{self.phase}.loss"))

    def profile_stages(self, name: str, runs: int = 5) -> list[float]:
        """Median milliseconds of each stage of a plan by device timestamps; states advance as in `runs` steps."""
        with self._lock:
            self._usable()
            plan, device = self.plans[name], self.device.device
            self._ready(plan)
            count = len(plan["stages"]) + 1
            queries = vk.CreateQueryPool(device, vk.VkQueryPoolCreateInfo(queryType=vk.VK_QUERY_TYPE_TIMESTAMP, queryCount=count))
            rows = []
            try:
                for k in plan["needs"]:
                    self._run_if_changed(self._d["plans"][k])
                states = [self._d["values"][k] for k in plan["updates"]]
                for _ in range(runs):
                    parity = {k: p for k, p in self._parity.items() if self._d["images"][k]["slots"] == 2}
                    recording = Recording(self.device, self._pool, self.bundle, self._images, self._pipelines, plan, parity, queries)
                    try:
                        self._submit([recording.commands])
                    finally:
                        recording.close()
                    self._flip(states)
                    for value in states:
                        self._version[value["name"]] += 1
                    buffer = (vk.u64 * count)()
                    vk.GetQueryPoolResults(device, queries, 0, count, buffer, 8, vk.VK_QUERY_RESULT_64_BIT)
                    rows.append(np.diff(np.array(buffer[:], np.float64)) * self.device.timestamp_period * 1e-6)
            finally:
                vk.DestroyQueryPool(device, queries)
            return np.median(rows, axis=0).tolist()

    def report(self) -> dict:
        """What ran how often, and what the session occupies."""
        return {"device": self.device.name, "driver": self.device.driver_info, "profile": self._d["profile"]["name"],
                "runs": dict(self._runs), "image_bytes": self._images.bytes, "pipelines": len(self._d["pipelines"]),
                "pipeline_cache": self._store.state,
                "time": time.time()}
