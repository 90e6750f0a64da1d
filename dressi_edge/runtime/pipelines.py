"""Render passes, shader modules, layouts and pipelines of a bundle; each distinct one once."""
from __future__ import annotations

from typing import NamedTuple

from ..cache import vulkan as v
from ..cache.progress import tell
from . import vk

_ALL_PIPELINE_STAGES = (vk.VK_PIPELINE_STAGE_COLOR_ATTACHMENT_OUTPUT_BIT | vk.VK_PIPELINE_STAGE_FRAGMENT_SHADER_BIT)


class Compute(NamedTuple):
    """One of the bundle's computes: handles, and (kind, sampler or -1) of each binding, the outputs after the rest."""

    pipeline: int
    layout: int
    set_layout: int
    bindings: tuple[tuple[int, int], ...]


class Pipelines:
    """`passes[k]`, `pipelines[k]`, `layouts[k]` (pipeline layout), `set_layouts[k]` for the bundle's pipeline k; `computes[k]`."""

    def __init__(self, device, bundle, depth_format: int, cache: int = 0):
        self.device, self.d = device, bundle.description
        self.modules, self.samplers, self.passes = [], [], []
        self.set_layouts, self.layouts, self.pipelines = [], [], []
        self.computes: list[Compute] = []
        self._shared: dict[tuple, tuple[int, int]] = {}
        try:
            for k in self.d["shaders"]:
                self.modules.append(vk.CreateShaderModule(device.device, vk.VkShaderModuleCreateInfo(pCode=bytes(bundle.blob(k)))))
            for mode in self.d["samplers"]:
                self.samplers.append(vk.CreateSampler(device.device, vk.VkSamplerCreateInfo(
                    magFilter=vk.VK_FILTER_LINEAR, minFilter=vk.VK_FILTER_LINEAR, mipmapMode=vk.VK_SAMPLER_MIPMAP_MODE_NEAREST,
                    addressModeU=mode, addressModeV=mode, addressModeW=mode)))
            for p in self.d["passes"]:
                self.passes.append(self._pass(p, depth_format))
            for p in self.d["pipelines"]:
                set_layout, layout = self._layout(tuple(map(tuple, p["bindings"])))
                self.set_layouts.append(set_layout)
                self.layouts.append(layout)
            for k, p in enumerate(self.d["pipelines"]):
                tell(f"the driver of {device.name} makes pipelines", k, len(self.d["pipelines"]))
                self.pipelines.append(self._pipeline(p, self.layouts[k], cache))
            for c in self.d.get("computes", ()):
                self.computes.append(self._compute(c, cache))
        except BaseException:
            self.close()
            raise

    def _pass(self, p: dict, depth_format: int) -> int:
        general = vk.VK_IMAGE_LAYOUT_GENERAL
        attachments = [vk.VkAttachmentDescription(
            format=a["format"] or depth_format, samples=vk.VK_SAMPLE_COUNT_1_BIT, loadOp=a["load"], storeOp=a["store"],
            stencilLoadOp=v.LOAD_DONT_CARE, stencilStoreOp=v.STORE_DONT_CARE, initialLayout=general, finalLayout=general)
            for a in p["attachments"]]
        subpasses = []
        for s in p["subpasses"]:
            depth = {} if s["depth"] < 0 else {"pDepthStencilAttachment": vk.VkAttachmentReference(s["depth"], general)}
            unused = set(range(len(attachments))) - {*s["colors"], *s["inputs"], s["depth"]}
            subpasses.append(vk.VkSubpassDescription(
                pipelineBindPoint=vk.VK_PIPELINE_BIND_POINT_GRAPHICS, pColorAttachments=[(a, general) for a in s["colors"]],
                pInputAttachments=[(a, general) for a in s["inputs"]], pPreserveAttachments=sorted(unused), **depth))
        dependencies = [vk.VkSubpassDependency(
            k, k + 1, vk.VK_PIPELINE_STAGE_COLOR_ATTACHMENT_OUTPUT_BIT, _ALL_PIPELINE_STAGES, vk.VK_ACCESS_COLOR_ATTACHMENT_WRITE_BIT,
            vk.VK_ACCESS_INPUT_ATTACHMENT_READ_BIT | vk.VK_ACCESS_COLOR_ATTACHMENT_WRITE_BIT, vk.VK_DEPENDENCY_BY_REGION_BIT)
            for k in range(len(subpasses) - 1)]
        return vk.CreateRenderPass(self.device.device, vk.VkRenderPassCreateInfo(
            pAttachments=attachments, pSubpasses=subpasses, pDependencies=dependencies))

    def _layout(self, bindings: tuple) -> tuple[int, int]:
        if bindings not in self._shared:
            set_layout = vk.CreateDescriptorSetLayout(self.device.device, vk.VkDescriptorSetLayoutCreateInfo(pBindings=[
                vk.VkDescriptorSetLayoutBinding(binding=k, descriptorType=kind, descriptorCount=1, stageFlags=stages)
                for k, (kind, stages, _) in enumerate(bindings)]))
            layout = vk.CreatePipelineLayout(self.device.device, vk.VkPipelineLayoutCreateInfo(pSetLayouts=[set_layout]))
            self._shared[bindings] = (set_layout, layout)
        return self._shared[bindings]

    def _pipeline(self, p: dict, layout: int, cache: int) -> int:
        colors = len(self.d["passes"][p["pass"]]["subpasses"][p["subpass"]]["colors"])
        stages = [vk.VkPipelineShaderStageCreateInfo(stage=stage, module=self.modules[p[key]], pName="main")
                  for stage, key in ((v.STAGE_VERTEX, "vertex"), (v.STAGE_FRAGMENT, "fragment"))]
        info = vk.VkGraphicsPipelineCreateInfo(
            flags=vk.VK_PIPELINE_CREATE_CAPTURE_STATISTICS_BIT_KHR * self.device.statistics,
            pStages=stages, pVertexInputState=vk.VkPipelineVertexInputStateCreateInfo(),
            pInputAssemblyState=vk.VkPipelineInputAssemblyStateCreateInfo(topology=p["topology"]),
            pViewportState=vk.VkPipelineViewportStateCreateInfo(viewportCount=1, scissorCount=1),
            pRasterizationState=vk.VkPipelineRasterizationStateCreateInfo(
                polygonMode=vk.VK_POLYGON_MODE_FILL, cullMode=vk.VK_CULL_MODE_NONE, frontFace=vk.VK_FRONT_FACE_CLOCKWISE, lineWidth=1.0),
            pMultisampleState=vk.VkPipelineMultisampleStateCreateInfo(rasterizationSamples=vk.VK_SAMPLE_COUNT_1_BIT),
            pDepthStencilState=vk.VkPipelineDepthStencilStateCreateInfo(
                depthTestEnable=p["depth"], depthWriteEnable=p["depth"], depthCompareOp=vk.VK_COMPARE_OP_LESS),
            pColorBlendState=vk.VkPipelineColorBlendStateCreateInfo(pAttachments=[
                vk.VkPipelineColorBlendAttachmentState(colorWriteMask=15) for _ in range(colors)]),
            pDynamicState=vk.VkPipelineDynamicStateCreateInfo(
                pDynamicStates=[vk.VK_DYNAMIC_STATE_VIEWPORT, vk.VK_DYNAMIC_STATE_SCISSOR]),
            layout=layout, renderPass=self.passes[p["pass"]], subpass=p["subpass"], basePipelineIndex=-1)
        return vk.CreateGraphicsPipelines(self.device.device, cache, [info])[0]

    def _compute(self, c: dict, cache: int) -> Compute:
        bindings = (*map(tuple, c["bindings"]), *((v.DESCRIPTOR_STORAGE_IMAGE, -1) for _ in c["outputs"]))
        set_layout, layout = self._layout(tuple((kind, v.STAGE_COMPUTE, -1) for kind, _ in bindings))
        info = vk.VkComputePipelineCreateInfo(
            flags=vk.VK_PIPELINE_CREATE_CAPTURE_STATISTICS_BIT_KHR * self.device.statistics,
            stage=vk.VkPipelineShaderStageCreateInfo(stage=v.STAGE_COMPUTE, module=self.modules[c["shader"]], pName="main"),
            layout=layout, basePipelineIndex=-1)
        return Compute(vk.CreateComputePipelines(self.device.device, cache, [info])[0], layout, set_layout, bindings)

    def close(self) -> None:
        """Destroy pipelines, layouts, passes and samplers."""
        d = self.device.device
        for pipeline in (*self.pipelines, *(c.pipeline for c in self.computes)):
            vk.DestroyPipeline(d, pipeline)
        for set_layout, layout in self._shared.values():
            vk.DestroyPipelineLayout(d, layout)
            vk.DestroyDescriptorSetLayout(d, set_layout)
        for render_pass in self.passes:
            vk.DestroyRenderPass(d, render_pass)
        for sampler in self.samplers:
            vk.DestroySampler(d, sampler)
        for module in self.modules:
            vk.DestroyShaderModule(d, module)
        self.pipelines, self.computes, self._shared, self.passes, self.samplers, self.modules = [], [], {}, [], [], []
