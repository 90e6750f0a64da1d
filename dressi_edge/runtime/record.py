"""One plan as a command buffer, for one choice of current slots (parity) of the states.

In: the plan's record and the device objects. Out: a `Recording`, submitted any number of times.
"""
from __future__ import annotations

from . import vk

WAIT_STAGES = (vk.VK_PIPELINE_STAGE_VERTEX_SHADER_BIT | vk.VK_PIPELINE_STAGE_FRAGMENT_SHADER_BIT
               | vk.VK_PIPELINE_STAGE_EARLY_FRAGMENT_TESTS_BIT | vk.VK_PIPELINE_STAGE_LATE_FRAGMENT_TESTS_BIT
               | vk.VK_PIPELINE_STAGE_COLOR_ATTACHMENT_OUTPUT_BIT | vk.VK_PIPELINE_STAGE_TRANSFER_BIT)
WRITES = (vk.VK_ACCESS_COLOR_ATTACHMENT_WRITE_BIT | vk.VK_ACCESS_DEPTH_STENCIL_ATTACHMENT_WRITE_BIT | vk.VK_ACCESS_TRANSFER_WRITE_BIT)
READS = (vk.VK_ACCESS_SHADER_READ_BIT | vk.VK_ACCESS_INPUT_ATTACHMENT_READ_BIT | vk.VK_ACCESS_COLOR_ATTACHMENT_READ_BIT
         | vk.VK_ACCESS_DEPTH_STENCIL_ATTACHMENT_READ_BIT | vk.VK_ACCESS_TRANSFER_READ_BIT)


def wait(commands: int) -> None:
    """Everything after sees everything before."""
    vk.CmdPipelineBarrier(commands, WAIT_STAGES, WAIT_STAGES, 0, pMemoryBarriers=[
        vk.VkMemoryBarrier(srcAccessMask=WRITES, dstAccessMask=READS | WRITES)])


class Recording:
    """A recorded plan. `timestamps`: a query pool to write 1 + stages timestamps to, or 0."""

    def __init__(self, device, pool: int, bundle, images, pipelines, plan: dict, parity: dict[int, int], timestamps: int = 0):
        self.device, self.d, self.images, self.pipelines, self.parity = device, bundle.description, images, pipelines, parity
        self.framebuffers: list[int] = []
        self.descriptor_pool = 0
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
        draws = [draw for stage in plan["stages"] for subpass in stage["subpasses"] for draw in subpass]
        counts: dict[int, int] = {}
        for draw in draws:
            for kind, _, _ in self.d["pipelines"][draw["pipeline"]]["bindings"]:
                counts[kind] = counts.get(kind, 0) + 1
        self.descriptor_pool = vk.CreateDescriptorPool(device, vk.VkDescriptorPoolCreateInfo(
            maxSets=max(1, len(draws)), pPoolSizes=[(kind, n) for kind, n in counts.items()] or [(2, 1)]))
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
        width, height = stage["width"], stage["height"]
        framebuffer = vk.CreateFramebuffer(device, vk.VkFramebufferCreateInfo(
            renderPass=self.pipelines.passes[stage["pass"]], pAttachments=[self._view(ref) for ref in stage["attachments"]],
            width=width, height=height, layers=1))
        self.framebuffers.append(framebuffer)
        if stage["wait"]:
            wait(c)
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
                self._draw(draw)
        vk.CmdEndRenderPass(c)

    def _draw(self, draw: dict) -> None:
        c, number = self.commands, draw["pipeline"]
        vk.CmdBindPipeline(c, vk.VK_PIPELINE_BIND_POINT_GRAPHICS, self.pipelines.pipelines[number])
        if draw["images"]:
            vk.CmdBindDescriptorSets(c, vk.VK_PIPELINE_BIND_POINT_GRAPHICS, self.pipelines.layouts[number], 0, [self._set(draw)])
        low, high = draw["depth_range"]
        for view, (x, y, w, h) in enumerate(draw["cells"]):
            vk.CmdSetViewport(c, 0, [vk.VkViewport(x, y, w, h, low, high)])
            vk.CmdSetScissor(c, 0, [vk.VkRect2D((x, y), (w, h))])
            vk.CmdDraw(c, draw["vertices"], 1, 0, view)

    def _set(self, draw: dict) -> int:
        device, number = self.device.device, draw["pipeline"]
        descriptors = vk.AllocateDescriptorSets(device, vk.VkDescriptorSetAllocateInfo(
            descriptorPool=self.descriptor_pool, pSetLayouts=[self.pipelines.set_layouts[number]]))[0]
        vk.UpdateDescriptorSets(device, [vk.VkWriteDescriptorSet(
            dstSet=descriptors, dstBinding=k, descriptorType=kind, pImageInfo=[vk.VkDescriptorImageInfo(
                self.pipelines.samplers[sampler] if sampler >= 0 else 0, self._view(ref), vk.VK_IMAGE_LAYOUT_GENERAL)])
            for k, (ref, (kind, _, sampler)) in enumerate(zip(draw["images"], self.d["pipelines"][number]["bindings"]))])
        return descriptors

    def close(self) -> None:
        device = self.device.device
        if self.commands:
            vk.FreeCommandBuffers(device, self.pool, [self.commands])
        if self.descriptor_pool:
            vk.DestroyDescriptorPool(device, self.descriptor_pool)
        for framebuffer in self.framebuffers:
            vk.DestroyFramebuffer(device, framebuffer)
        self.commands, self.descriptor_pool, self.framebuffers = 0, 0, []
