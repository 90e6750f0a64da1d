"""One plan as a command buffer, for one choice of current slots (parity) of the states.

In: the plan's record and the device objects. Out: a `Recording`, submitted any number of times.
"""
from __future__ import annotations

import ctypes
import struct

from ..cache import vulkan as v
from . import vk
from .memory import find_memory

WAIT_STAGES = (vk.VK_PIPELINE_STAGE_DRAW_INDIRECT_BIT | vk.VK_PIPELINE_STAGE_VERTEX_SHADER_BIT | vk.VK_PIPELINE_STAGE_FRAGMENT_SHADER_BIT
               | vk.VK_PIPELINE_STAGE_EARLY_FRAGMENT_TESTS_BIT | vk.VK_PIPELINE_STAGE_LATE_FRAGMENT_TESTS_BIT
               | vk.VK_PIPELINE_STAGE_COLOR_ATTACHMENT_OUTPUT_BIT | vk.VK_PIPELINE_STAGE_TRANSFER_BIT)
WRITES = (vk.VK_ACCESS_COLOR_ATTACHMENT_WRITE_BIT | vk.VK_ACCESS_DEPTH_STENCIL_ATTACHMENT_WRITE_BIT | vk.VK_ACCESS_TRANSFER_WRITE_BIT)
READS = (vk.VK_ACCESS_SHADER_READ_BIT | vk.VK_ACCESS_INPUT_ATTACHMENT_READ_BIT | vk.VK_ACCESS_COLOR_ATTACHMENT_READ_BIT
         | vk.VK_ACCESS_DEPTH_STENCIL_ATTACHMENT_READ_BIT | vk.VK_ACCESS_TRANSFER_READ_BIT)


def wait(commands: int, compute: bool = False) -> None:
    """Everything after sees everything before, `compute` shaders among it."""
    stages = WAIT_STAGES | vk.VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT * compute
    writes = WRITES | vk.VK_ACCESS_SHADER_WRITE_BIT * compute
    vk.CmdPipelineBarrier(commands, stages, stages, 0, pMemoryBarriers=[
        vk.VkMemoryBarrier(srcAccessMask=writes, dstAccessMask=READS | writes)])


class _Counts:
    """A buffer of one command for each draw or dispatch of which the device finds how much there is to do: its number of vertices, or of
    workgroups along x."""

    SIZE = 16  # VkDrawIndirectCommand: vertices, instances, first vertex, first instance; VkDispatchIndirectCommand: x, y, z

    def __init__(self, device, commands: list[tuple[int, int, int, int]]):
        draws = len(commands)
        self.device, self.used = device, 0
        self.buffer = vk.CreateBuffer(device.device, vk.VkBufferCreateInfo(
            size=self.SIZE * draws, usage=vk.VK_BUFFER_USAGE_INDIRECT_BUFFER_BIT | vk.VK_BUFFER_USAGE_TRANSFER_DST_BIT,
            sharingMode=vk.VK_SHARING_MODE_EXCLUSIVE))
        self.memory = 0
        try:
            q = vk.GetBufferMemoryRequirements(device.device, self.buffer)
            kind = find_memory(device, q.memoryTypeBits, vk.VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT | vk.VK_MEMORY_PROPERTY_HOST_COHERENT_BIT)
            self.memory = vk.AllocateMemory(device.device, vk.VkMemoryAllocateInfo(allocationSize=q.size, memoryTypeIndex=kind))
            vk.BindBufferMemory(device.device, self.buffer, self.memory, 0)
            address = vk.MapMemory(device.device, self.memory, 0, self.SIZE * draws)
            ctypes.memmove(address, b"".join(struct.pack("<4I", *command) for command in commands), self.SIZE * draws)
            vk.UnmapMemory(device.device, self.memory)
        except BaseException:
            self.close()
            raise

    def copy(self, commands: int, image: int, record: dict) -> int:
        """Copy the last texel of an image to the next command; its offset."""
        offset = self.SIZE * self.used
        self.used += 1
        last = (record["width"] - 1, record["height"] - 1, 0)
        vk.CmdCopyImageToBuffer(commands, image, vk.VK_IMAGE_LAYOUT_GENERAL, self.buffer, [vk.VkBufferImageCopy(
            offset, 0, 0, (vk.VK_IMAGE_ASPECT_COLOR_BIT, 0, 0, 1), last, (1, 1, 1))])
        return offset

    def close(self) -> None:
        """Destroy what the commands use, which must have run."""
        vk.DestroyBuffer(self.device.device, self.buffer)
        if self.memory:
            vk.FreeMemory(self.device.device, self.memory)


class Recording:
    """A recorded plan. `timestamps`: a query pool to write 1 + stages timestamps to, or 0."""

    def __init__(self, device, pool: int, bundle, images, pipelines, plan: dict, parity: dict[int, int], timestamps: int = 0):
        self.device, self.d, self.images, self.pipelines, self.parity = device, bundle.description, images, pipelines, parity
        self.compute = bool(self.d.get("computes"))
        self.framebuffers: list[int] = []
        self.descriptor_pool = 0
        self.counts: _Counts | None = None
        self.pool = pool
        self.commands = 0
        try:
            self._record(plan, timestamps)
        except BaseException:
            self.close()
            raise

    def _slot(self, ref: int) -> tuple[int, int]:
        image = ref // 2
        return (image, ref % 2 ^ self.parity.get(image, 0)) if self.d["images"][image]["slots"] == 2 else (image, 0)

    def _view(self, ref: int) -> int:
        image, slot = self._slot(ref)
        return self.images.views[image][slot]

    def _record(self, plan: dict, timestamps: int) -> None:
        device = self.device.device
        dispatches = [stage for stage in plan["stages"] if "compute" in stage]
        draws = [draw for stage in plan["stages"] if "compute" not in stage for subpass in stage["subpasses"] for draw in subpass]
        counts: dict[int, int] = {}
        for kind in (*(kind for draw in draws for kind, _, _ in self.d["pipelines"][draw["pipeline"]]["bindings"]),
                     *(kind for stage in dispatches for kind, _ in self.pipelines.computes[stage["compute"]].bindings)):
            counts[kind] = counts.get(kind, 0) + 1
        self.descriptor_pool = vk.CreateDescriptorPool(device, vk.VkDescriptorPoolCreateInfo(
            maxSets=max(1, len(draws) + len(dispatches)), pPoolSizes=[(kind, n) for kind, n in counts.items()] or [(2, 1)]))
        commands = []
        for stage in plan["stages"]:
            commands += [(0, *stage["groups"][1:], 0)] if "compute" in stage and stage["count"] >= 0 else [] if "compute" in stage else \
                [(0, 1, 0, 0) for draws in stage["subpasses"] for draw in draws if draw["count"] >= 0]
        if commands:
            self.counts = _Counts(self.device, commands)
        self.commands = vk.AllocateCommandBuffers(device, vk.VkCommandBufferAllocateInfo(
            commandPool=self.pool, level=vk.VK_COMMAND_BUFFER_LEVEL_PRIMARY, commandBufferCount=1))[0]
        vk.BeginCommandBuffer(self.commands, vk.VkCommandBufferBeginInfo(flags=vk.VK_COMMAND_BUFFER_USAGE_SIMULTANEOUS_USE_BIT))
        if timestamps:
            vk.CmdResetQueryPool(self.commands, timestamps, 0, len(plan["stages"]) + 1)
            vk.CmdWriteTimestamp(self.commands, vk.VK_PIPELINE_STAGE_BOTTOM_OF_PIPE_BIT, timestamps, 0)
        for k, stage in enumerate(plan["stages"]):
            self._stage(stage)
            if timestamps:
                vk.CmdWriteTimestamp(self.commands, vk.VK_PIPELINE_STAGE_BOTTOM_OF_PIPE_BIT, timestamps, k + 1)
        vk.EndCommandBuffer(self.commands)

    def _stage(self, stage: dict) -> None:
        device, c = self.device.device, self.commands
        if stage["wait"]:
            wait(c, self.compute)
        if "compute" in stage:
            self._dispatch(stage)
            return
        width, height = stage["width"], stage["height"]
        framebuffer = vk.CreateFramebuffer(device, vk.VkFramebufferCreateInfo(
            renderPass=self.pipelines.passes[stage["pass"]], pAttachments=[self._view(ref) for ref in stage["attachments"]],
            width=width, height=height, layers=1))
        self.framebuffers.append(framebuffer)
        offsets = self._copy_counts([draw for draws in stage["subpasses"] for draw in draws])
        clears = []
        for a in self.d["passes"][stage["pass"]]["attachments"]:
            value = vk.VkClearValue()
            if a["format"] == 0:
                value.depthStencil.depth = float(a["clear"])
            else:
                for channel in range(4):
                    value.color.int32[channel] = a["clear"]
            clears.append(value)
        vk.CmdBeginRenderPass(c, vk.VkRenderPassBeginInfo(
            renderPass=self.pipelines.passes[stage["pass"]], framebuffer=framebuffer, renderArea=((0, 0), (width, height)),
            pClearValues=clears), vk.VK_SUBPASS_CONTENTS_INLINE)
        for k, draws in enumerate(stage["subpasses"]):
            if k:
                vk.CmdNextSubpass(c, vk.VK_SUBPASS_CONTENTS_INLINE)
            for draw in draws:
                self._draw(draw, offsets)
        vk.CmdEndRenderPass(c)

    def _dispatch(self, stage: dict) -> None:
        """The outputs that are to be, cleared; then the workgroups."""
        c, compute = self.commands, self.pipelines.computes[stage["compute"]]
        cleared = False
        for ref, output in zip(stage["outputs"], self.d["computes"][stage["compute"]]["outputs"]):
            if output["load"] == v.LOAD_CLEAR:
                image, slot = self._slot(ref)
                value = vk.VkClearColorValue()
                for channel in range(4):
                    value.int32[channel] = output["clear"]
                vk.CmdClearColorImage(c, self.images.handles[image][slot], vk.VK_IMAGE_LAYOUT_GENERAL, value,
                                      [(vk.VK_IMAGE_ASPECT_COLOR_BIT, 0, 1, 0, 1)])
                cleared = True
        offsets = self._copy_counts([stage])
        if cleared:
            wait(c, True)
        vk.CmdBindPipeline(c, vk.VK_PIPELINE_BIND_POINT_COMPUTE, compute.pipeline)
        descriptors = self._descriptors(compute.set_layout, compute.bindings, [*stage["images"], *stage["outputs"]])
        vk.CmdBindDescriptorSets(c, vk.VK_PIPELINE_BIND_POINT_COMPUTE, compute.layout, 0, [descriptors], [])
        if offsets:
            vk.CmdDispatchIndirect(c, self.counts.buffer, offsets[0])
        else:
            vk.CmdDispatch(c, *stage["groups"])

    def _copy_counts(self, draws: list[dict]) -> list[int]:
        """Where the commands of the counted ones of these draws or dispatches are, in order, each filled from its image."""
        offsets = []
        for draw in (draw for draw in draws if draw["count"] >= 0):
            image, slot = self._slot(draw["count"])
            offsets.append(self.counts.copy(self.commands, self.images.handles[image][slot], self.d["images"][image]))
        if offsets:
            copied = vk.VkMemoryBarrier(srcAccessMask=vk.VK_ACCESS_TRANSFER_WRITE_BIT, dstAccessMask=vk.VK_ACCESS_INDIRECT_COMMAND_READ_BIT)
            vk.CmdPipelineBarrier(self.commands, vk.VK_PIPELINE_STAGE_TRANSFER_BIT, vk.VK_PIPELINE_STAGE_DRAW_INDIRECT_BIT, 0,
                                  pMemoryBarriers=[copied])
        return offsets

    def _draw(self, draw: dict, offsets: list[int]) -> None:
        c, number = self.commands, draw["pipeline"]
        vk.CmdBindPipeline(c, vk.VK_PIPELINE_BIND_POINT_GRAPHICS, self.pipelines.pipelines[number])
        if draw["images"]:
            vk.CmdBindDescriptorSets(c, vk.VK_PIPELINE_BIND_POINT_GRAPHICS, self.pipelines.layouts[number], 0, [self._set(draw)])
        low, high = draw["depth_range"]
        for view, (x, y, w, h) in enumerate(draw["cells"]):
            vk.CmdSetViewport(c, 0, [vk.VkViewport(x, y, w, h, low, high)])
            vk.CmdSetScissor(c, 0, [vk.VkRect2D((x, y), (w, h))])
            if draw["count"] >= 0:
                vk.CmdDrawIndirect(c, self.counts.buffer, offsets.pop(0), 1, _Counts.SIZE)
            else:
                vk.CmdDraw(c, draw["vertices"], 1, 0, view)

    def _set(self, draw: dict) -> int:
        number = draw["pipeline"]
        bindings = [(kind, sampler) for kind, _, sampler in self.d["pipelines"][number]["bindings"]]
        return self._descriptors(self.pipelines.set_layouts[number], bindings, draw["images"])

    def _descriptors(self, layout: int, bindings, refs: list[int]) -> int:
        """A set of these images; a binding is its kind and its sampler or -1."""
        device = self.device.device
        descriptors = vk.AllocateDescriptorSets(device, vk.VkDescriptorSetAllocateInfo(
            descriptorPool=self.descriptor_pool, pSetLayouts=[layout]))[0]
        vk.UpdateDescriptorSets(device, [vk.VkWriteDescriptorSet(
            dstSet=descriptors, dstBinding=k, descriptorType=kind, pImageInfo=[vk.VkDescriptorImageInfo(
                self.pipelines.samplers[sampler] if sampler >= 0 else 0, self._view(ref), vk.VK_IMAGE_LAYOUT_GENERAL)])
            for k, (ref, (kind, sampler)) in enumerate(zip(refs, bindings))])
        return descriptors

    def close(self) -> None:
        """Destroy what the commands use, which must have run."""
        device = self.device.device
        if self.commands:
            vk.FreeCommandBuffers(device, self.pool, [self.commands])
        if self.descriptor_pool:
            vk.DestroyDescriptorPool(device, self.descriptor_pool)
        if self.counts:
            self.counts.close()
        for framebuffer in self.framebuffers:
            vk.DestroyFramebuffer(device, framebuffer)
        self.commands, self.descriptor_pool, self.framebuffers, self.counts = 0, 0, [], None
