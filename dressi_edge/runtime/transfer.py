"""Between NumPy and images: clearing, uploading and downloading whole images, several in one submission.

In: `Work`, `Staging`, and for each image its handle, its record in the bundle and its bytes, or who writes or reads them in place. Out:
the bytes of images.
"""
from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from . import vk
from .memory import Images, Staging, image_bytes, region
from .record import wait
from .work import Change, Work

ALIGN = 64  # of each image in the staging buffer; Vulkan asks for 4 and the size of a texel
BATCH_BYTES = 8 << 20

Fill = Callable[[np.ndarray], None]  # writes, or reads, the bytes of an image where they lie in the staging buffer
Copy = tuple[int, dict, np.ndarray | Fill]  # image handle, its record, its bytes or a texel's as uint8


def clear(images: Images, c: int, compute: bool = False) -> None:
    """Bring every image to GENERAL, zero; `compute`: dispatches may follow."""
    to_general(images, c)
    for handle in (handle for record, handles in zip(images.records, images.handles) if record["format"] for handle in handles):
        vk.CmdClearColorImage(c, handle, vk.VK_IMAGE_LAYOUT_GENERAL, vk.VkClearColorValue(),
                              [(vk.VK_IMAGE_ASPECT_COLOR_BIT, 0, 1, 0, 1)])
    wait(c, compute)


def to_general(images: Images, c: int) -> None:
    """Bring every image to GENERAL; what it held is lost."""
    barriers = []
    for record, handles in zip(images.records, images.handles):
        aspect = vk.VK_IMAGE_ASPECT_COLOR_BIT if record["format"] else vk.VK_IMAGE_ASPECT_DEPTH_BIT
        for handle in handles:
            barriers.append(vk.VkImageMemoryBarrier(
                srcAccessMask=0, dstAccessMask=vk.VK_ACCESS_TRANSFER_WRITE_BIT, oldLayout=vk.VK_IMAGE_LAYOUT_UNDEFINED,
                newLayout=vk.VK_IMAGE_LAYOUT_GENERAL, srcQueueFamilyIndex=vk.VK_QUEUE_FAMILY_IGNORED,
                dstQueueFamilyIndex=vk.VK_QUEUE_FAMILY_IGNORED, image=handle, subresourceRange=(aspect, 0, 1, 0, 1)))
    if barriers:
        vk.CmdPipelineBarrier(c, vk.VK_PIPELINE_STAGE_TOP_OF_PIPE_BIT, vk.VK_PIPELINE_STAGE_ALL_COMMANDS_BIT, 0,
                              pImageMemoryBarriers=barriers)


def _offsets(sizes: list[int]) -> tuple[list[int], int]:
    """Where each lies in the staging buffer, and what they occupy together."""
    offsets, at = [], 0
    for size in sizes:
        offsets.append(at)
        at += size + -size % ALIGN
    return offsets, at


def upload(work: Work, staging: Staging, copies: Sequence[Copy], changes: Sequence[Change] = ()) -> None:
    """Fill images in one submission: all of them or, after an error, none."""
    work.settle()  # an interrupted transfer may still use the staging buffer
    sizes = [image_bytes(record) for _, record, _ in copies]
    offsets, total = _offsets(sizes)
    staging.reserve(total)
    for offset, size, (_, _, data) in zip(offsets, sizes, copies):
        place = staging.view[offset:offset + size]
        if callable(data):
            data(place)
        else:
            place.reshape(-1, data.size)[...] = data

    def copy(c: int) -> None:
        wait(c, work.compute)
        for offset, (handle, record, _) in zip(offsets, copies):
            vk.CmdCopyBufferToImage(c, staging.buffer, handle, vk.VK_IMAGE_LAYOUT_GENERAL, [region(record, offset)])
        wait(c, work.compute)

    work.once(copy, changes)


def batches(copies: Sequence[Copy]) -> list[list[Copy]]:
    """Copies in groups of `BATCH_BYTES` or one image, so that staging stays small."""
    groups, size = [[]], 0
    for copy in copies:
        if groups[-1] and size + image_bytes(copy[1]) > BATCH_BYTES:
            groups.append([])
            size = 0
        groups[-1].append(copy)
        size += image_bytes(copy[1])
    return [group for group in groups if group]


def download(work: Work, staging: Staging, images: Sequence[tuple[int, dict]]) -> list[bytes]:
    """The bytes of images (handle, record), all at one moment."""
    kept: list[bytes] = []
    read(work, staging, [(*image, lambda place: kept.append(place.tobytes())) for image in images])
    return kept


def read(work: Work, staging: Staging, images: Sequence[tuple[int, dict, Fill]]) -> None:
    """Show each reader the bytes of its image (handle, record, reader), all at one moment."""
    work.settle()
    sizes = [image_bytes(record) for _, record, _ in images]
    offsets, total = _offsets(sizes)
    staging.reserve(total)

    def copy(c: int) -> None:
        wait(c, work.compute)
        for offset, (handle, record, _) in zip(offsets, images):
            vk.CmdCopyImageToBuffer(c, handle, vk.VK_IMAGE_LAYOUT_GENERAL, staging.buffer, [region(record, offset)])
        vk.CmdPipelineBarrier(c, vk.VK_PIPELINE_STAGE_TRANSFER_BIT, vk.VK_PIPELINE_STAGE_HOST_BIT, 0, pMemoryBarriers=[
            vk.VkMemoryBarrier(srcAccessMask=vk.VK_ACCESS_TRANSFER_WRITE_BIT, dstAccessMask=vk.VK_ACCESS_HOST_READ_BIT)])

    work.once(copy)
    for offset, size, (_, _, reader) in zip(offsets, sizes, images):
        reader(staging.view[offset:offset + size])
