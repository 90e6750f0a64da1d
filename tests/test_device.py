"""Choosing and opening a Vulkan device. A machine without a driver fails here: nothing is skipped."""

import gc

import pytest

from dressi_edge.cache.errors import DeviceError
from dressi_edge.runtime import device as module
from dressi_edge.runtime import vk
from dressi_edge.runtime.device import Device


@pytest.fixture(autouse=True)
def no_environment(monkeypatch):
    monkeypatch.delenv("DRESSI_DEVICE", raising=False)


def test_the_list_names_every_device():
    listed = Device.list()
    assert [row[0] for row in listed] == list(range(len(listed)))
    assert all(name and kind in module.RANK and driver for _, name, kind, driver in listed)


def test_opening_and_closing_twenty_times_with_validation_has_nothing_to_say():
    before = dict(module._CALLBACKS)
    for _ in range(20):
        with Device.open(validation=True) as device:
            assert device.device and device.queue
        assert device.messages == []
    assert module._CALLBACKS == before


def test_limits_are_numbers_or_lists_of_numbers_by_khronos_name():
    with Device.open() as device:
        limits = device.limits
    assert len(limits) == len(vk.VkPhysicalDeviceLimits._fields_)
    for value in limits.values():
        assert type(value) in (int, float) or (type(value) is list and all(type(v) in (int, float) for v in value))
    # what Vulkan 1.0 requires of every device
    assert type(limits["maxPerStageDescriptorInputAttachments"]) is int and limits["maxPerStageDescriptorInputAttachments"] >= 4
    assert limits["maxImageDimension2D"] >= 4096
    assert type(limits["timestampPeriod"]) is float and len(limits["maxComputeWorkGroupCount"]) == 3


def test_a_device_tells_who_it_is():
    with Device.open() as device:
        assert device.name and device.kind in module.RANK and device.api_version >= (1, 0, 0)
        assert len(bytes.fromhex(device.pipeline_cache_uuid)) == 16
        assert isinstance(device.driver_version, int) and device.driver
        assert device.api_version < (1, 2) or device.driver_name and len(bytes.fromhex(device.driver_uuid)) == 16
        assert device.vendor_id and device.device_id >= 0 and device.timestamp_period >= 0
        assert device.features["robustBufferAccess"] is True  # required of every device
        assert all(0 <= heap < len(device.heaps) for _, heap in device.memory_types)
        assert any(flags & vk.VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT for flags, _ in device.memory_types)
        assert device.timestamp_bits in range(65) and device.queue_family >= 0 and device.enabled == ()


def test_format_features_are_those_every_device_must_have():
    with Device.open() as device:
        linear, optimal, buffer = device.format_features(vk.VK_FORMAT_R8G8B8A8_UNORM)
        assert optimal & vk.VK_FORMAT_FEATURE_COLOR_ATTACHMENT_BLEND_BIT and isinstance(linear | buffer, int)
        assert device.format_features(vk.VK_FORMAT_R32G32B32A32_SFLOAT)[1] & vk.VK_FORMAT_FEATURE_COLOR_ATTACHMENT_BIT
        assert device.format_features(vk.VK_FORMAT_UNDEFINED) == (0, 0, 0)


def test_a_device_is_chosen_by_index_or_by_a_part_of_its_name():
    index, name, *_ = Device.list()[0]
    for select in (index, str(index), name, name[1:6].upper()):
        with Device.open(select) as device:
            assert device.name == name


def test_the_environment_chooses_where_the_caller_does_not(monkeypatch):
    monkeypatch.setenv("DRESSI_DEVICE", "no such thing")
    with pytest.raises(DeviceError, match=r"'no such thing' \(from DRESSI_DEVICE\)"):
        Device.open()
    with Device.open(0) as device:
        assert device.device


def test_an_unknown_device_is_an_error_that_lists_what_there_is():
    name = Device.list()[0][1]
    for select in ("no such thing", 99):
        with pytest.raises(DeviceError) as caught:
            Device.open(select)
        assert repr(str(select)) in str(caught.value) and f"0: {name}" in str(caught.value)


def test_a_discrete_device_is_preferred_and_one_without_graphics_is_not_chosen(monkeypatch):
    kinds = ["cpu", "integrated", "discrete", "virtual"]

    class Named(Device):
        def __init__(self, instance, physical):
            self.kind, self.name, self.queue_family = physical, f"the {physical} one", -1 if physical == "discrete" else 0

    class There:
        physical = kinds

    assert Named._chosen(There, None).kind == "integrated"
    assert Named._chosen(There, 0).kind == "cpu"
    assert Named._chosen(There, "THE VIRT").kind == "virtual"
    with pytest.raises(DeviceError, match="no graphics queue on the discrete one"):
        Named._chosen(There, "discrete")


def test_only_features_asked_for_are_enabled():
    with Device.open(features=("robustBufferAccess",), validation=True) as device:
        assert device.enabled == ("robustBufferAccess",)
    assert device.messages == []


def test_a_feature_that_is_not_there_is_an_error():
    with pytest.raises(DeviceError, match="feature warpDrive .* there is no such feature"):
        Device.open(features=("warpDrive",))
    with Device.open() as device:
        missing = next(name for name, there in device.features.items() if not there)
    with pytest.raises(DeviceError, match=f"feature {missing} was asked for of .*: does not have it"):
        Device.open(features=(missing,))


def test_validation_without_the_layer_is_an_error(monkeypatch):
    monkeypatch.setattr(module, "VALIDATION_LAYER", "VK_LAYER_not_here")
    with pytest.raises(DeviceError, match="VK_LAYER_not_here is not installed"):
        Device.open(validation=True)


def test_a_leaked_object_is_reported_when_the_device_goes():
    before = len(module.MESSAGES)
    device = Device.open(validation=True)
    vk.CreateFence(device.device, vk.VkFenceCreateInfo())
    assert device.messages == []
    device.close()
    assert len(device.messages) == 1 and "VkFence" in device.messages[0] and device.messages[0].startswith("error: VUID-")
    assert module.MESSAGES[before:] == device.messages
    del module.MESSAGES[before:]


def test_an_unsynchronized_write_is_reported():
    device = Device.open(validation=True)
    before, gpu = len(module.MESSAGES), device.device
    buffer = vk.CreateBuffer(gpu, vk.VkBufferCreateInfo(size=64, usage=vk.VK_BUFFER_USAGE_TRANSFER_DST_BIT))
    needs = vk.GetBufferMemoryRequirements(gpu, buffer)
    kind = next(i for i in range(32) if needs.memoryTypeBits >> i & 1)
    memory = vk.AllocateMemory(gpu, vk.VkMemoryAllocateInfo(allocationSize=needs.size, memoryTypeIndex=kind))
    vk.BindBufferMemory(gpu, buffer, memory, 0)
    pool = vk.CreateCommandPool(gpu, vk.VkCommandPoolCreateInfo(queueFamilyIndex=device.queue_family))
    [commands] = vk.AllocateCommandBuffers(gpu, vk.VkCommandBufferAllocateInfo(commandPool=pool, commandBufferCount=1))
    vk.BeginCommandBuffer(commands, vk.VkCommandBufferBeginInfo())
    vk.CmdFillBuffer(commands, buffer, 0, 64, 1)
    vk.CmdFillBuffer(commands, buffer, 0, 64, 2)
    vk.EndCommandBuffer(commands)
    vk.DestroyCommandPool(gpu, pool)
    vk.DestroyBuffer(gpu, buffer)
    vk.FreeMemory(gpu, memory)
    device.close()
    assert len(device.messages) == 1 and "SYNC-HAZARD-WRITE" in device.messages[0]
    del module.MESSAGES[before:]


def test_a_message_that_cannot_be_read_does_not_escape_the_callback():
    messages, before = [], len(module.MESSAGES)
    callback = module._callback(messages)
    assert callback(vk.VK_DEBUG_UTILS_MESSAGE_SEVERITY_ERROR_BIT_EXT, 0, None, None) == 0
    assert len(messages) == 1 and "could not be read" in messages[0]
    data = vk.VkDebugUtilsMessengerCallbackDataEXT(pMessage=b"\xff!")
    callback(vk.VK_DEBUG_UTILS_MESSAGE_SEVERITY_WARNING_BIT_EXT, 0, data, None)
    assert messages[1] == "warning: : \N{REPLACEMENT CHARACTER}!"
    del module.MESSAGES[before:]


def test_closing_twice_is_fine_and_a_closed_device_cannot_be_used():
    device = Device.open()
    device.close()
    device.close()
    assert device.device is None and "closed" in repr(device)
    with pytest.raises(Exception, match="NULL handle"):
        device.format_features(vk.VK_FORMAT_R8_UNORM)


def test_a_device_that_was_forgotten_keeps_its_callback():
    before = dict(module._CALLBACKS)
    device = Device.open(validation=True)
    gpu, instance, messenger = device.device, device.instance, device._instance.messenger
    del device
    gc.collect()
    try:
        vk.DestroyFence(gpu, vk.CreateFence(gpu, vk.VkFenceCreateInfo()))
        assert len(module._CALLBACKS) == len(before) + 1
    finally:
        vk.DestroyDevice(gpu)
        vk.DestroyDebugUtilsMessengerEXT(instance, messenger)
        vk.DestroyInstance(instance)
        for key in set(module._CALLBACKS) - set(before):
            del module._CALLBACKS[key]
