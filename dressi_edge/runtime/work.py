"""One thing at a time on the queue: what a session records, submits and waits for, safe to interrupt anywhere.

In: command buffers, and the assignments that become true once they have run. Out: those assignments, made exactly if the work
was done, even if whoever waited for it was interrupted: the next call finishes what was begun.
"""
from __future__ import annotations

from collections.abc import Callable, Sequence

from . import vk

INTERRUPT_NS = 100_000_000  # a wait returns to Python this often, where a KeyboardInterrupt is seen

Change = tuple[dict, object, object]  # mapping, key, value


class Work:
    """A command pool, a fence and one command buffer for transfers; `compute`: there may be dispatches before and after. Not
    thread-safe: the session's lock is around it; the queue, which sessions share, is under the device's lock."""

    def __init__(self, device, compute: bool = False):
        self.device, self.compute, self.pool, self.fence = device, compute, 0, 0
        self._changes: Sequence[Change] | None = None  # of what was submitted, or was about to be
        self._sent = False
        try:
            self.pool = vk.CreateCommandPool(device.device, vk.VkCommandPoolCreateInfo(
                flags=vk.VK_COMMAND_POOL_CREATE_RESET_COMMAND_BUFFER_BIT, queueFamilyIndex=device.queue_family))
            self.fence = vk.CreateFence(device.device, vk.VkFenceCreateInfo())
            self._commands = vk.AllocateCommandBuffers(device.device, vk.VkCommandBufferAllocateInfo(
                commandPool=self.pool, level=vk.VK_COMMAND_BUFFER_LEVEL_PRIMARY, commandBufferCount=1))[0]
        except BaseException:
            self.close()
            raise

    def begin(self, fill: Callable[[int], None], changes: Sequence[Change] = ()) -> None:
        """Record with `fill(command buffer)` and submit; `settle` waits for it."""
        self.settle()
        commands = self._commands
        vk.ResetCommandBuffer(commands, 0)  # an interrupt may have left it half recorded
        vk.BeginCommandBuffer(commands, vk.VkCommandBufferBeginInfo(flags=vk.VK_COMMAND_BUFFER_USAGE_ONE_TIME_SUBMIT_BIT))
        fill(commands)
        vk.EndCommandBuffer(commands)
        self.submit([commands], changes)

    def once(self, fill: Callable[[int], None], changes: Sequence[Change] = ()) -> None:
        """Record, submit and finish."""
        self.begin(fill, changes)
        self.settle()

    def submit(self, commands: list[int], changes: Sequence[Change] = ()) -> None:
        """Submit; `settle` waits for it and makes the `changes`."""
        self.settle()
        self._changes = changes
        try:
            with self.device.lock:
                vk.QueueSubmit(self.device.queue, [vk.VkSubmitInfo(pCommandBuffers=commands)], self.fence)
        except vk.VulkanError:
            self._changes = None
            raise
        self._sent = True

    def settle(self) -> None:
        """Wait for what was submitted and make its changes. Every order of the lines below survives an interrupt between any
        two: the changes can be made twice, and an unsignalled fence on an idle queue means that nothing was submitted or that
        everything here was done."""
        if self._changes is None:
            return
        device = self.device.device
        if self._sent:
            while vk.WaitForFences(device, [self.fence], True, INTERRUPT_NS) == vk.VK_TIMEOUT:
                pass
        else:
            with self.device.lock:
                vk.QueueWaitIdle(self.device.queue)
            if vk.GetFenceStatus(device, self.fence) == vk.VK_NOT_READY:
                self._changes = None
                return
        for mapping, key, value in self._changes:
            mapping[key] = value
        self._sent = False
        vk.ResetFences(device, [self.fence])
        self._changes = None

    def finish(self) -> None:
        """`settle`, and the queue is idle even if that fails: what was submitted may be destroyed."""
        try:
            self.settle()
        except vk.VulkanError:
            with self.device.lock:
                vk.QueueWaitIdle(self.device.queue)
            raise

    def close(self) -> None:
        """Destroy pool and fence; nothing may be running."""
        if self.fence:
            vk.DestroyFence(self.device.device, self.fence)
        if self.pool:
            vk.DestroyCommandPool(self.device.device, self.pool)
        self.pool = self.fence = 0
