"""The generated Vulkan binding: layout, conversions, lifetimes, errors, and a driver that gets what was meant."""

import ctypes
import gc
import struct
import subprocess
import sys
from pathlib import Path

import pytest

from dressi_edge.cache.errors import DeviceError
from dressi_edge.runtime import vk
from dressi_edge.runtime.device import Device

# sizeof on every 64-bit platform
SIZES = {
    "VkExtent3D": 12, "VkApplicationInfo": 48, "VkInstanceCreateInfo": 64, "VkImageCreateInfo": 88, "VkBufferCreateInfo": 56,
    "VkPhysicalDeviceLimits": 504, "VkPhysicalDeviceProperties": 824, "VkPhysicalDeviceFeatures": 220,
    "VkPhysicalDeviceMemoryProperties": 520, "VkGraphicsPipelineCreateInfo": 144, "VkComputePipelineCreateInfo": 96,
    "VkPipelineShaderStageCreateInfo": 48, "VkSubpassDescription": 72, "VkRenderPassCreateInfo": 64, "VkWriteDescriptorSet": 64,
    "VkImageMemoryBarrier": 72, "VkClearValue": 16, "VkSubmitInfo": 72, "VkBufferImageCopy": 56, "VkSamplerCreateInfo": 80,
    "VkMemoryRequirements": 24, "VkClearAttachment": 24, "VkImageViewCreateInfo": 80, "VkFramebufferCreateInfo": 64,
}


def shader(entry):
    """SPIR-V of an empty compute shader of that entry point."""
    name = entry.encode() + b"\0" * (4 - len(entry) % 4)
    words = struct.unpack(f"<{len(name) // 4}I", name)

    def op(code, *operands):
        return [len(operands) + 1 << 16 | code, *operands]

    code = [0x07230203, 0x00010000, 0, 5, 0, *op(17, 1), *op(14, 0, 1), *op(15, 5, 3, *words), *op(16, 3, 17, 1, 1, 1),
            *op(19, 1), *op(33, 2, 1), *op(54, 1, 3, 0, 2), *op(248, 4), *op(253), *op(56)]
    return struct.pack(f"<{len(code)}I", *code)


def churn():
    """Frees what nothing holds and writes over it."""
    gc.collect()
    return [bytes([255 - i % 7]) * n for n in (5, 9, 17, 33, 65, 129) for i in range(2000)]


@pytest.mark.parametrize("name", SIZES)
def test_a_struct_has_the_size_it_has_in_c(name):
    assert ctypes.sizeof(getattr(vk, name)) == SIZES[name]


def test_the_file_is_what_the_generator_writes():
    import vkgen

    assert Path(vk.__file__).read_text(encoding="utf-8") == vkgen.generate()


def test_importing_loads_nothing_but_the_standard_library():
    code = "import sys; import dressi_edge.runtime.vk; print(*sorted({m.split('.')[0] for m in sys.modules}))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    bare = subprocess.run([sys.executable, "-c", "import sys; print(*sys.modules)"], capture_output=True, text=True, check=True)
    extra = set(loaded) - {m.split(".")[0] for m in bare.stdout.split()} - set(sys.stdlib_module_names)
    assert extra == {"dressi_edge"}


def test_importing_does_not_open_the_loader():
    code = "import dressi_edge.runtime.vk as vk; assert 'dll' not in vars(vk._lib)"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_struct_knows_its_type():
    assert vk.VkImageCreateInfo().sType == vk.VK_STRUCTURE_TYPE_IMAGE_CREATE_INFO == 14


def test_a_list_becomes_an_array_and_its_count():
    info = vk.VkInstanceCreateInfo(ppEnabledLayerNames=["one", b"two"], ppEnabledExtensionNames=[])
    assert info.enabledLayerCount == 2 and info.ppEnabledLayerNames[:2] == [b"one", b"two"]
    assert info.enabledExtensionCount == 0 and not info.ppEnabledExtensionNames


def test_a_count_that_is_given_is_kept():
    binding = vk.VkDescriptorSetLayoutBinding(binding=3, descriptorCount=7)
    assert (binding.descriptorCount, bool(binding.pImmutableSamplers)) == (7, False)
    assert vk.VkInstanceCreateInfo(enabledLayerCount=1, ppEnabledLayerNames=["one", "two"]).enabledLayerCount == 1


def test_lists_that_share_a_count_must_have_one_length():
    with pytest.raises(ValueError, match="waitSemaphoreCount is already 2"):
        vk.VkSubmitInfo(pWaitSemaphores=[1, 2], pWaitDstStageMask=[1])
    with pytest.raises(ValueError, match="one length"):
        vk.CmdBindVertexBuffers(1, 0, [1, 2], [0])


def test_an_unknown_member_is_a_type_error():
    with pytest.raises(TypeError, match="VkExtent2D has no member 'widht'"):
        vk.VkExtent2D(widht=3)
    with pytest.raises(TypeError, match="VkExtent2D has no member 'widht'"):
        vk.VkExtent2D().widht = 3
    with pytest.raises(TypeError, match="has 2 members, got 3 values"):
        vk.VkExtent2D(1, 2, 3)
    with pytest.raises(TypeError, match="keywords only"):
        vk.VkApplicationInfo(1)


def test_a_member_set_later_is_converted_too():
    info = vk.VkInstanceCreateInfo()
    info.ppEnabledLayerNames = ["one", "two"]
    kept = churn()
    assert kept and info.enabledLayerCount == 2 and info.ppEnabledLayerNames[:2] == [b"one", b"two"]


def test_a_struct_of_another_type_is_refused():
    with pytest.raises(TypeError):
        vk.VkInstanceCreateInfo(pApplicationInfo=vk.VkExtent2D())
    with pytest.raises(ctypes.ArgumentError):
        vk.CreateImage(1, vk.VkBufferCreateInfo())


def test_nested_values_may_be_tuples():
    info = vk.VkImageCreateInfo(extent=(4, 3, 1))
    assert (info.extent.width, info.extent.height, info.extent.depth) == (4, 3, 1)
    clear = vk.VkClearValue(color=vk.VkClearColorValue(float32=[0.5, 0, 0, 1]))
    assert list(clear.color.float32) == [0.5, 0, 0, 1]
    assert vk.VkRect2D((1, 2), (3, 4)).extent.height == 4
    regions = vk.array(vk.VkBufferCopy, [(0, 4, 8), (1, 5, 9)])
    assert (regions[1].srcOffset, regions[1].dstOffset, regions[1].size) == (1, 5, 9)


def test_code_and_data_are_measured_in_bytes():
    info = vk.VkShaderModuleCreateInfo(pCode=shader("main"))
    assert info.codeSize == len(shader("main")) and info.pCode[0] == 0x07230203
    assert vk.VkShaderModuleCreateInfo(pCode=[1, 2, 3]).codeSize == 12
    cache = vk.VkPipelineCacheCreateInfo(pInitialData=memoryview(b"12345"))
    assert cache.initialDataSize == 5 and ctypes.string_at(cache.pInitialData, 5) == b"12345"
    constants = vk.VkSpecializationInfo(pData=(ctypes.c_uint32 * 3)(1, 2, 3))
    assert constants.dataSize == 12 and constants.mapEntryCount == 0
    with pytest.raises(ValueError, match="32-bit words"):
        vk.VkShaderModuleCreateInfo(pCode=b"12345")


def test_nested_strings_live_as_long_as_the_outermost_array():
    """Nothing but `infos` holds the stages, and only they hold the entry points, the data and their pNext chain."""

    def stage(i):
        entries = [vk.VkSpecializationMapEntry(constantID=i, size=4)]
        return vk.VkPipelineShaderStageCreateInfo(
            pName=f"entry_point_{i}", pNext=vk.VkShaderModuleCreateInfo(pCode=struct.pack("<I", i) * 5),
            pSpecializationInfo=vk.VkSpecializationInfo(pMapEntries=entries, pData=b"data%d" % i))

    graphics = vk.array(vk.VkGraphicsPipelineCreateInfo, [
        vk.VkGraphicsPipelineCreateInfo(pStages=[stage(i), stage(i + 100)]) for i in range(50)])
    compute = vk.array(vk.VkComputePipelineCreateInfo, [vk.VkComputePipelineCreateInfo(stage=stage(i)) for i in range(50)])
    kept = churn()
    for i in range(50):
        for n, found in ((i, graphics[i].pStages[0]), (i + 100, graphics[i].pStages[1]), (i, compute[i].stage)):
            assert found.pName == b"entry_point_%d" % n
            special = found.pSpecializationInfo[0]
            assert ctypes.string_at(special.pData, special.dataSize) == b"data%d" % n
            assert special.pMapEntries[0].constantID == n
            chained = ctypes.cast(found.pNext, ctypes.POINTER(vk.VkShaderModuleCreateInfo))[0]
            assert chained.pCode[:5] == [n] * 5
    assert kept


def test_an_error_names_the_call_and_the_result():
    error = vk.VulkanError("vkAllocateMemory", -2)
    assert str(error) == "vkAllocateMemory failed with VK_ERROR_OUT_OF_DEVICE_MEMORY"
    assert isinstance(error, DeviceError) and error.result == vk.VK_ERROR_OUT_OF_DEVICE_MEMORY
    assert str(vk.VulkanError("vkX", -77)) == "vkX failed with VkResult -77"


def test_a_failing_call_raises():
    with pytest.raises(vk.VulkanError, match="vkCreateInstance failed with VK_ERROR_LAYER_NOT_PRESENT") as caught:
        vk.CreateInstance(vk.VkInstanceCreateInfo(ppEnabledLayerNames=["VK_LAYER_none"]))
    assert caught.value.result == -6


def test_a_missing_loader_is_one_clear_error(monkeypatch):
    monkeypatch.setattr(vk, "_lib", vk._Library())
    monkeypatch.setattr(vk, "candidates", lambda: ["libno_vulkan_here.so"])
    with pytest.raises(DeviceError, match=r"no Vulkan loader found \(tried libno_vulkan_here.so\): install libvulkan1"):
        Device.open()


def test_a_null_handle_is_refused_before_the_loader_crashes():
    for null in (None, 0):
        with pytest.raises(ctypes.ArgumentError, match="NULL handle"):
            vk.DeviceWaitIdle(null)


@pytest.fixture
def device():
    with Device.open(validation=True) as device:
        yield device
    assert device.messages == []


def test_the_driver_finds_an_entry_point_that_only_the_struct_holds(device):
    entry = "an_entry_point_with_a_long_name"
    module = vk.CreateShaderModule(device.device, vk.VkShaderModuleCreateInfo(pCode=shader(entry)))
    layout = vk.CreatePipelineLayout(device.device, vk.VkPipelineLayoutCreateInfo())
    cache = vk.CreatePipelineCache(device.device, vk.VkPipelineCacheCreateInfo())
    infos = [vk.VkComputePipelineCreateInfo(layout=layout, stage=vk.VkPipelineShaderStageCreateInfo(
        stage=vk.VK_SHADER_STAGE_COMPUTE_BIT, module=module, pName="".join(entry))) for _ in range(8)]
    kept = churn()
    pipelines = vk.CreateComputePipelines(device.device, cache, infos)
    assert kept and len(pipelines) == 8 and all(pipelines)
    assert vk.GetPipelineCacheData(device.device, cache)[16:32].hex() == device.pipeline_cache_uuid
    for pipeline in pipelines:
        vk.DestroyPipeline(device.device, pipeline)
    vk.DestroyPipelineCache(device.device, cache)
    vk.DestroyPipelineLayout(device.device, layout)
    vk.DestroyShaderModule(device.device, module)


def test_a_cleared_image_comes_back_through_a_buffer(device):
    gpu, width, height = device.device, 5, 3
    image = vk.CreateImage(gpu, vk.VkImageCreateInfo(
        imageType=vk.VK_IMAGE_TYPE_2D, format=vk.VK_FORMAT_R32_SFLOAT, extent=(width, height, 1), mipLevels=1, arrayLayers=1,
        samples=vk.VK_SAMPLE_COUNT_1_BIT, usage=vk.VK_IMAGE_USAGE_TRANSFER_DST_BIT | vk.VK_IMAGE_USAGE_TRANSFER_SRC_BIT))
    buffer = vk.CreateBuffer(gpu, vk.VkBufferCreateInfo(size=64, usage=vk.VK_BUFFER_USAGE_TRANSFER_DST_BIT))

    def backed(needs, flags):
        kind = next(i for i, (has, _) in enumerate(device.memory_types)
                    if needs.memoryTypeBits >> i & 1 and has & flags == flags)
        return vk.AllocateMemory(gpu, vk.VkMemoryAllocateInfo(allocationSize=needs.size, memoryTypeIndex=kind))

    visible = vk.VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT | vk.VK_MEMORY_PROPERTY_HOST_COHERENT_BIT
    memories = [backed(vk.GetImageMemoryRequirements(gpu, image), 0),
                backed(vk.GetBufferMemoryRequirements(gpu, buffer), visible)]
    vk.BindImageMemory(gpu, image, memories[0], 0)
    vk.BindBufferMemory(gpu, buffer, memories[1], 0)
    pool = vk.CreateCommandPool(gpu, vk.VkCommandPoolCreateInfo(queueFamilyIndex=device.queue_family))
    times = vk.CreateQueryPool(gpu, vk.VkQueryPoolCreateInfo(queryType=vk.VK_QUERY_TYPE_TIMESTAMP, queryCount=2))
    [commands] = vk.AllocateCommandBuffers(gpu, vk.VkCommandBufferAllocateInfo(commandPool=pool, commandBufferCount=1))

    whole = vk.VkImageSubresourceRange(vk.VK_IMAGE_ASPECT_COLOR_BIT, 0, 1, 0, 1)
    clear, copy = vk.VK_IMAGE_LAYOUT_TRANSFER_DST_OPTIMAL, vk.VK_IMAGE_LAYOUT_TRANSFER_SRC_OPTIMAL
    write, read = vk.VK_ACCESS_TRANSFER_WRITE_BIT, vk.VK_ACCESS_TRANSFER_READ_BIT
    transfer = vk.VK_PIPELINE_STAGE_TRANSFER_BIT

    def barrier(before, after, old, new):
        vk.CmdPipelineBarrier(commands, transfer, transfer, pImageMemoryBarriers=[vk.VkImageMemoryBarrier(
            srcAccessMask=before, dstAccessMask=after, oldLayout=old, newLayout=new, image=image, subresourceRange=whole,
            srcQueueFamilyIndex=vk.VK_QUEUE_FAMILY_IGNORED, dstQueueFamilyIndex=vk.VK_QUEUE_FAMILY_IGNORED)])

    vk.BeginCommandBuffer(commands, vk.VkCommandBufferBeginInfo())
    vk.CmdResetQueryPool(commands, times, 0, 2)
    vk.CmdWriteTimestamp(commands, vk.VK_PIPELINE_STAGE_TOP_OF_PIPE_BIT, times, 0)
    barrier(0, write, vk.VK_IMAGE_LAYOUT_UNDEFINED, clear)
    vk.CmdClearColorImage(commands, image, clear, vk.VkClearColorValue(float32=[0.25, 0, 0, 0]), [whole])
    barrier(write, read, clear, copy)
    vk.CmdCopyImageToBuffer(commands, image, copy, buffer, [vk.VkBufferImageCopy(
        imageSubresource=(vk.VK_IMAGE_ASPECT_COLOR_BIT, 0, 0, 1), imageExtent=(width, height, 1))])
    vk.CmdUpdateBuffer(commands, buffer, 60, b"tail")
    vk.CmdPipelineBarrier(commands, transfer, vk.VK_PIPELINE_STAGE_HOST_BIT,
                          pMemoryBarriers=[vk.VkMemoryBarrier(srcAccessMask=write, dstAccessMask=vk.VK_ACCESS_HOST_READ_BIT)])
    vk.CmdWriteTimestamp(commands, vk.VK_PIPELINE_STAGE_BOTTOM_OF_PIPE_BIT, times, 1)
    vk.EndCommandBuffer(commands)

    fence = vk.CreateFence(gpu, vk.VkFenceCreateInfo())
    assert vk.GetFenceStatus(gpu, fence) == vk.VK_NOT_READY
    assert vk.WaitForFences(gpu, [fence], True, 0) == vk.VK_TIMEOUT
    vk.QueueSubmit(device.queue, [vk.VkSubmitInfo(pCommandBuffers=[commands])], fence)
    assert vk.WaitForFences(gpu, [fence], True, 10**10) == vk.VK_SUCCESS
    data = ctypes.string_at(vk.MapMemory(gpu, memories[1], 0, vk.VK_WHOLE_SIZE), 64)
    vk.UnmapMemory(gpu, memories[1])
    assert data == struct.pack("<f", 0.25) * (width * height) + b"tail"
    ticks = (ctypes.c_uint64 * 2)()
    assert vk.GetQueryPoolResults(gpu, times, 0, 2, ticks, 8, vk.VK_QUERY_RESULT_64_BIT) == vk.VK_SUCCESS
    assert 0 < ticks[0] <= ticks[1]

    vk.DestroyFence(gpu, fence)
    vk.DestroyQueryPool(gpu, times)
    vk.DestroyCommandPool(gpu, pool)
    vk.DestroyImage(gpu, image)
    vk.DestroyBuffer(gpu, buffer)
    for memory in memories:
        vk.FreeMemory(gpu, memory)
