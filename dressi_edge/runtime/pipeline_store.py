"""The VkPipelineCache of a session: filled from the file of an earlier process, kept again when the driver put more into it.

In: a device and the bundle's digest. Out: `handle` for the creation of pipelines (0 where there is none) and `state` in words.
"""
from __future__ import annotations

from ..cache import pipeline_cache
from . import vk


class PipelineStore:
    """`state`: "hit" (an earlier process left a file), "miss", "stored" (for the next process), "empty (the driver puts nothing
    into it)", or "off (why)"."""

    def __init__(self, device, bundle_digest: str):
        self._device = device
        self._key = pipeline_cache.key(bundle_digest, device.vendor_id, device.device_id, device.driver_version,
                                       device.pipeline_cache_uuid, device.name, device.driver_name, device.driver_info,
                                       device.device_uuid, device.driver_uuid)
        self.handle, self.size = 0, pipeline_cache.DRIVER_HEADER.size
        self._folder, why = pipeline_cache.default_folder()
        why = why or pipeline_cache.distrusted(self._folder)
        self.state = f"off ({why})"
        if why:
            return
        data = pipeline_cache.load(self._folder, self._key)
        initial = {"pInitialData": data} if data else {}
        try:
            self.handle = vk.CreatePipelineCache(device.device, vk.VkPipelineCacheCreateInfo(**initial))
        except vk.VulkanError as error:
            self.state = f"off ({error})"
            return
        self.state = "hit" if data else "miss"
        self.size = len(data) if data else self.size

    def keep(self) -> None:
        """Write the file if the driver's blob has grown. To be called after pipelines were made, and after they first ran:
        some drivers compile that late."""
        if not self.handle or self._folder is None:
            return
        try:
            data = vk.GetPipelineCacheData(self._device.device, self.handle)
        except vk.VulkanError:  # out of memory: what was kept stays
            return
        if len(data) <= self.size:
            if self.state == "miss":
                self.state = "empty (the driver puts nothing into it)"
            return
        self.size = len(data)
        why = pipeline_cache.store(self._folder, self._key, data)
        if why:
            self._folder = None
        if self.state != "hit":
            self.state = f"off ({why})" if why else "stored"

    def close(self) -> None:
        """Destroy the driver's cache; the file stays."""
        if self.handle:
            vk.DestroyPipelineCache(self._device.device, self.handle)
        self.handle = 0
