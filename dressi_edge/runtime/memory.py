"""Device memory: the bundle's images in one allocation a memory type, and a staging buffer for what goes in and out."""
from __future__ import annotations

import ctypes

import numpy as np

from ..cache import vulkan as v
from ..cache.errors import DeviceError
from . import vk

ASPECT = {False: vk.VK_IMAGE_ASPECT_COLOR_BIT, True: vk.VK_IMAGE_ASPECT_DEPTH_BIT}

OUT_OF_MEMORY = (vk.VK_ERROR_OUT_OF_DEVICE_MEMORY, vk.VK_ERROR_OUT_OF_HOST_MEMORY)


def find_memory(device, bits: int, wanted: int) -> int:
    """The first memory type among `bits` with the wanted properties, or without them if none has."""
    for need in (wanted, 0):
        for k, (flags, _) in enumerate(device.memory_types):
            if bits >> k & 1 and flags & need == need:
                return k
    raise DeviceError(f"{device.name} has no memory for an image of type bits {bits:#x}")


class Images:
    """Every image of a bundle: `views[image][slot]`, `handles[image][slot]`; `bytes` is what they occupy."""

    def __init__(self, device, records: list[dict], depth_format: int):
        self.device, self.records, self.bytes = device, records, 0
        self.handles: list[list[int]] = []
        self.views: list[list[int]] = []
        self.memory: list[int] = []
        try:
            self._create(depth_format)
        except BaseException as error:
            self.close()
            if isinstance(error, vk.VulkanError) and error.result in OUT_OF_MEMORY:
                raise DeviceError(f"{device.name} has no memory for the images of this bundle ({error}); close other sessions, "
                                  "or compile it with fewer or smaller views") from error
            raise

    def _create(self, depth_format: int) -> None:
        self._weigh(depth_format)
        pools: dict[int, list[tuple[int, int]]] = {}
        sizes: dict[int, int] = {}
        for r in self.records:
            self.handles.append([])
            for _ in range(r["slots"]):
                image = self._image(r, depth_format)
                self.handles[-1].append(image)
                q = vk.GetImageMemoryRequirements(self.device.device, image)
                kind = find_memory(self.device, q.memoryTypeBits, vk.VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT)
                offset = -(-sizes.get(kind, 0) // q.alignment) * q.alignment
                sizes[kind] = offset + q.size
                pools.setdefault(kind, []).append((image, offset))
        self._check_heaps(sizes)
        for kind, size in sizes.items():
            memory = vk.AllocateMemory(self.device.device, vk.VkMemoryAllocateInfo(allocationSize=size, memoryTypeIndex=kind))
            self.memory.append(memory)
            self.bytes += size
            for image, offset in pools[kind]:
                vk.BindImageMemory(self.device.device, image, memory, offset)
        for r, handles in zip(self.records, self.handles):
            depth = r["format"] == 0
            self.views.append([vk.CreateImageView(self.device.device, vk.VkImageViewCreateInfo(
                image=h, viewType=vk.VK_IMAGE_VIEW_TYPE_2D, format=r["format"] or depth_format,
                subresourceRange=(ASPECT[depth], 0, 1, 0, 1))) for h in handles
                if r["usage"] & ~(v.USAGE_TRANSFER_SRC | v.USAGE_TRANSFER_DST)])  # a value that no plan reads has none

    def _image(self, r: dict, depth_format: int) -> int:
        return make_image(self.device, r, depth_format)

    def _weigh(self, depth_format: int) -> None:
        """What all images take, of one of each kind: a driver aligns the smallest to kilobytes. Before there are many of them."""
        kinds: dict[tuple, list[dict]] = {}
        for r in self.records:
            kinds.setdefault(tuple(r[key] for key in ("format", "width", "height", "usage")), []).append(r)
        sizes: dict[int, int] = {}
        for records in kinds.values():
            q = requirements(self.device, records[0], depth_format)
            kind = find_memory(self.device, q.memoryTypeBits, vk.VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT)
            whole = sum(r["slots"] for r in records) * (-(-q.size // q.alignment) * q.alignment)
            sizes[kind] = sizes.get(kind, 0) + whole - (q.alignment - 1)  # the last of each kind may lie closer
        self._check_heaps(sizes)

    def _check_heaps(self, sizes: dict[int, int]) -> None:
        """Before anything is allocated: a driver may promise more than it has, and fail at the first use."""
        wanted: dict[int, int] = {}
        for kind, size in sizes.items():
            heap = self.device.memory_types[kind][1]
            wanted[heap] = wanted.get(heap, 0) + size
        for heap, size in wanted.items():
            if size > self.device.heaps[heap][0]:
                raise DeviceError(f"the images of this bundle need {megabytes(size)}; {self.device.name} has "
                                  f"{megabytes(self.device.heaps[heap][0])} (heap {heap}); compile it with fewer or smaller views")

    def close(self) -> None:
        """Give everything back."""
        for views in self.views:
            for view in views:
                vk.DestroyImageView(self.device.device, view)
        for handles in self.handles:
            for handle in handles:
                vk.DestroyImage(self.device.device, handle)
        for memory in self.memory:
            vk.FreeMemory(self.device.device, memory)
        self.views, self.handles, self.memory = [], [], []


def make_image(device, record: dict, depth_format: int = 0) -> int:
    """One slot of an image of a bundle, without memory. depth_format: what stands for the format 0."""
    return vk.CreateImage(device.device, vk.VkImageCreateInfo(
        imageType=vk.VK_IMAGE_TYPE_2D, format=record["format"] or depth_format, extent=(record["width"], record["height"], 1),
        mipLevels=1, arrayLayers=1, samples=vk.VK_SAMPLE_COUNT_1_BIT, tiling=vk.VK_IMAGE_TILING_OPTIMAL,
        usage=record["usage"] | (0 if record["format"] == 0 else v.USAGE_TRANSFER_DST),
        sharingMode=vk.VK_SHARING_MODE_EXCLUSIVE, initialLayout=vk.VK_IMAGE_LAYOUT_UNDEFINED))


def requirements(device, record: dict, depth_format: int = 0):
    """What the driver asks for one slot of an image of a bundle: size, alignment, memoryTypeBits."""
    image = make_image(device, record, depth_format)
    try:
        return vk.GetImageMemoryRequirements(device.device, image)
    finally:
        vk.DestroyImage(device.device, image)


def image_bytes(record: dict) -> int:
    """Of one slot; depth takes four bytes in both its formats."""
    return v.TEXEL_BYTES[record["format"]] * record["width"] * record["height"]


def megabytes(size: int) -> str:
    """A size as people read it."""
    return f"{size / 1e6:.1f} MB"


def too_large(records: list[dict], device) -> str:
    """What to say if the texels alone are more than the device's memory; else nothing. Drivers take more, for alignment."""
    have = sum(device.local_heaps or [size for size, _ in device.heaps])
    need = sum(image_bytes(r) * r["slots"] for r in records)
    return f"its images need {megabytes(need)}; {device.name} has {megabytes(have)} of memory for them" if need > have else ""


class Staging:
    """A host-visible buffer that grows to the largest transfer."""

    def __init__(self, device):
        self.device, self.size, self.buffer, self.memory, self.view = device, 0, 0, 0, None

    def reserve(self, size: int) -> None:
        """Have room for so many bytes; what was in the buffer is lost."""
        if size <= self.size:
            return
        self.close()
        self.buffer = vk.CreateBuffer(self.device.device, vk.VkBufferCreateInfo(
            size=size, usage=vk.VK_BUFFER_USAGE_TRANSFER_SRC_BIT | vk.VK_BUFFER_USAGE_TRANSFER_DST_BIT,
            sharingMode=vk.VK_SHARING_MODE_EXCLUSIVE))
        q = vk.GetBufferMemoryRequirements(self.device.device, self.buffer)
        wanted = vk.VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT | vk.VK_MEMORY_PROPERTY_HOST_COHERENT_BIT
        kind = find_memory(self.device, q.memoryTypeBits, wanted)
        self.memory = vk.AllocateMemory(self.device.device, vk.VkMemoryAllocateInfo(
            allocationSize=q.size, memoryTypeIndex=kind))
        vk.BindBufferMemory(self.device.device, self.buffer, self.memory, 0)
        address = vk.MapMemory(self.device.device, self.memory, 0, size)
        self.view = np.frombuffer((ctypes.c_uint8 * size).from_address(address), np.uint8)
        self.size = size

    def trim(self, size: int) -> None:
        """Give back a buffer of more than this."""
        if self.size > size:
            self.close()

    def close(self) -> None:
        """Give everything back."""
        if self.buffer:
            vk.DestroyBuffer(self.device.device, self.buffer)
        if self.memory:
            vk.FreeMemory(self.device.device, self.memory)
        self.size, self.buffer, self.memory, self.view = 0, 0, 0, None


def region(record: dict, offset: int):
    """The copy of an image, or of the part of it that lies at x, y, to or from the staging buffer."""
    return vk.VkBufferImageCopy(offset, 0, 0, (vk.VK_IMAGE_ASPECT_COLOR_BIT, 0, 0, 1), (record.get("x", 0), record.get("y", 0), 0),
                                (record["width"], record["height"], 1))
