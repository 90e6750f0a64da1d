"""One Vulkan device: choosing it, what it can do, its queue, and what the validation layer says about it.

In: a selection (an index, a part of a name, or the environment variable DRESSI_DEVICE). Out: a `Device`, whose handles the
other runtime modules use and whose limits and features a device profile is made from.
"""

import os
from _thread import allocate_lock  # as threading.Lock, whose module takes a millisecond

from dressi_edge.cache.errors import DeviceError
from dressi_edge.runtime import vk

# The kind that is preferred comes first.
KINDS = {vk.VK_PHYSICAL_DEVICE_TYPE_DISCRETE_GPU: "discrete", vk.VK_PHYSICAL_DEVICE_TYPE_INTEGRATED_GPU: "integrated",
         vk.VK_PHYSICAL_DEVICE_TYPE_VIRTUAL_GPU: "virtual", vk.VK_PHYSICAL_DEVICE_TYPE_CPU: "cpu",
         vk.VK_PHYSICAL_DEVICE_TYPE_OTHER: "other"}
RANK = {kind: rank for rank, kind in enumerate(KINDS.values())}

VALIDATION_LAYER = "VK_LAYER_KHRONOS_validation"
SEVERITIES = {vk.VK_DEBUG_UTILS_MESSAGE_SEVERITY_WARNING_BIT_EXT: "warning",
              vk.VK_DEBUG_UTILS_MESSAGE_SEVERITY_ERROR_BIT_EXT: "error"}

# Every message of the validation layer since this module was imported, those of devices that failed to open included.
MESSAGES: list[str] = []

# Callbacks the driver may still call: those of instances that were never closed stay here for good.
_CALLBACKS = {}


class _Instance:
    """A Vulkan instance, with a debug messenger if validation is on. `messages` grows while it lives."""

    def __init__(self, validation=False):
        self.handle, self.messenger, self.messages, self._callback = None, 0, [], None
        try:
            self.version = vk.EnumerateInstanceVersion()
        except DeviceError:  # a loader of Vulkan 1.0 has no such command; having no loader fails again below
            self.version = vk.VK_API_VERSION_1_0
        listed = _names(vk.EnumerateInstanceExtensionProperties())
        extensions, layers, flags, chain = [], [], 0, None
        if vk.VK_KHR_PORTABILITY_ENUMERATION_EXTENSION_NAME in listed:  # or MoltenVK is not enumerated
            extensions.append(vk.VK_KHR_PORTABILITY_ENUMERATION_EXTENSION_NAME)
            flags |= vk.VK_INSTANCE_CREATE_ENUMERATE_PORTABILITY_BIT_KHR
        if vk.VK_KHR_GET_PHYSICAL_DEVICE_PROPERTIES2_EXTENSION_NAME in listed:
            extensions.append(vk.VK_KHR_GET_PHYSICAL_DEVICE_PROPERTIES2_EXTENSION_NAME)
        self.properties2 = (self.version >= vk.VK_API_VERSION_1_1
                            or vk.VK_KHR_GET_PHYSICAL_DEVICE_PROPERTIES2_EXTENSION_NAME in extensions)
        if validation:
            if VALIDATION_LAYER not in _names(vk.EnumerateInstanceLayerProperties(), "layerName"):
                raise DeviceError(f"validation was asked for, but {VALIDATION_LAYER} is not installed: "
                                  "on Debian install vulkan-validationlayers")
            layers.append(VALIDATION_LAYER)
            extensions.append(vk.VK_EXT_DEBUG_UTILS_EXTENSION_NAME)
            extensions.append(vk.VK_EXT_VALIDATION_FEATURES_EXTENSION_NAME)
            chain = self._messenger_info(vk.VkValidationFeaturesEXT(
                pEnabledValidationFeatures=[vk.VK_VALIDATION_FEATURE_ENABLE_SYNCHRONIZATION_VALIDATION_EXT]))
        # 1.0 is all that is used; a newer number makes the driver's name and the UUIDs readable
        application = vk.VkApplicationInfo(pApplicationName="dressi_edge", pEngineName="dressi_edge",
                                           apiVersion=min(self.version, vk.VK_API_VERSION_1_2))
        info = vk.VkInstanceCreateInfo(pNext=chain, flags=flags, pApplicationInfo=application, ppEnabledLayerNames=layers,
                                       ppEnabledExtensionNames=extensions)
        try:
            self.handle = vk.CreateInstance(info)
            if validation:
                self.messenger = vk.CreateDebugUtilsMessengerEXT(self.handle, self._messenger_info())
            self.physical = vk.EnumeratePhysicalDevices(self.handle)
        except vk.VulkanError as error:
            self.close()
            if error.result in (vk.VK_ERROR_INCOMPATIBLE_DRIVER, vk.VK_ERROR_INITIALIZATION_FAILED):
                raise DeviceError(f"no Vulkan driver found ({error}): install one, on Debian mesa-vulkan-drivers") from error
            raise

    def _messenger_info(self, chain=None):
        severities = 0
        for bit in SEVERITIES:
            severities |= bit
        # no performance hints: images stay in one layout on purpose
        types = vk.VK_DEBUG_UTILS_MESSAGE_TYPE_GENERAL_BIT_EXT | vk.VK_DEBUG_UTILS_MESSAGE_TYPE_VALIDATION_BIT_EXT
        if self._callback is None:
            self._callback = _callback(self.messages)
            _CALLBACKS[id(self._callback)] = self._callback
        return vk.VkDebugUtilsMessengerCreateInfoEXT(pNext=chain, messageSeverity=severities, messageType=types,
                                                     pfnUserCallback=self._callback)

    def close(self):
        """Give back the messenger and the instance."""
        handle, self.handle = self.handle, None
        if handle:
            if self.messenger:
                vk.DestroyDebugUtilsMessengerEXT(handle, self.messenger)
            vk.DestroyInstance(handle)  # the layer may still report here
        _CALLBACKS.pop(id(self._callback), None)


class Device:
    """A logical Vulkan device with one queue. Open it with `Device.open`, preferably in a `with` statement.

    name, kind                    as the driver calls it; "discrete", "integrated", "virtual", "cpu" or "other"
    vendor_id, device_id          int
    api_version                   (major, minor, patch) of the device
    driver_name, driver_info      str, empty where the driver does not tell
    driver_version                int, encoded as the vendor likes
    pipeline_cache_uuid, device_uuid, driver_uuid      hex; the last two empty where the driver does not tell
    limits                        VkPhysicalDeviceLimits: Khronos' name -> int, float or list
    features, enabled             Khronos' name -> supported; the names of those switched on
    extensions                    names of the device extensions that the driver has
    statistics                    whether it keeps what its compiler says of pipelines: `commands/statistics.py`
    timestamp_period, timestamp_bits                   ns a tick; valid bits of a timestamp, 0 if the queue has none
    memory_types, heaps           [(flags, heap index)]; [(bytes, flags)]
    instance, physical, device, queue, queue_family    handles and the family's index
    compute                       whether the queue takes dispatches, too
    messages                      what the validation layer said; still there after `close`
    lock, process                 around every use of the queue, which sessions share; the process that opened it
    """

    def __init__(self, instance, physical):
        """Reads what the device can do. `Device.open` makes it usable."""
        self._instance, self.instance, self.physical, self.messages = instance, instance.handle, physical, instance.messages
        self.device = self.queue = None
        self.lock, self.process = allocate_lock(), os.getpid()
        self.queue_family, self.timestamp_bits, self.enabled, self.statistics = -1, 0, (), False
        properties = vk.GetPhysicalDeviceProperties(physical)
        self.name = properties.deviceName.decode(errors="replace")
        self.kind = KINDS.get(properties.deviceType, "other")
        self.vendor_id, self.device_id = properties.vendorID, properties.deviceID
        self.driver_version = properties.driverVersion
        version = properties.apiVersion
        self.api_version = version >> 22 & 127, version >> 12 & 1023, version & 4095
        self.pipeline_cache_uuid = bytes(properties.pipelineCacheUUID).hex()
        self.limits = _plain(properties.limits)
        self.timestamp_period = properties.limits.timestampPeriod
        self.features = {name: bool(on) for name, on in _plain(vk.GetPhysicalDeviceFeatures(physical)).items()}
        self.extensions = _names(vk.EnumerateDeviceExtensionProperties(physical))
        memory = vk.GetPhysicalDeviceMemoryProperties(physical)
        self.memory_types = [(t.propertyFlags, t.heapIndex) for t in memory.memoryTypes[:memory.memoryTypeCount]]
        self.heaps = [(h.size, h.flags) for h in memory.memoryHeaps[:memory.memoryHeapCount]]
        self._read_driver(version)
        self.compute = False
        for index, family in enumerate(vk.GetPhysicalDeviceQueueFamilyProperties(physical)):
            compute = bool(family.queueFlags & vk.VK_QUEUE_COMPUTE_BIT)
            if family.queueFlags & vk.VK_QUEUE_GRAPHICS_BIT and (self.queue_family < 0 or compute > self.compute):
                self.queue_family, self.timestamp_bits, self.compute = index, family.timestampValidBits, compute

    def _read_driver(self, version):
        self.driver_name = self.driver_info = self.device_uuid = self.driver_uuid = ""
        version = min(version, self._instance.version)
        ids = driver = None
        if version >= vk.VK_API_VERSION_1_1:
            ids = vk.VkPhysicalDeviceIDProperties()
        if version >= vk.VK_API_VERSION_1_2 or vk.VK_KHR_DRIVER_PROPERTIES_EXTENSION_NAME in self.extensions:
            driver = vk.VkPhysicalDeviceDriverProperties(pNext=ids)
        if self._instance.properties2 and (ids or driver):
            vk.GetPhysicalDeviceProperties2(self.instance, self.physical, vk.VkPhysicalDeviceProperties2(pNext=driver or ids))
            if driver:
                self.driver_name = driver.driverName.decode(errors="replace")
                self.driver_info = driver.driverInfo.decode(errors="replace")
            if ids:
                self.device_uuid, self.driver_uuid = bytes(ids.deviceUUID).hex(), bytes(ids.driverUUID).hex()

    @classmethod
    def list(cls):
        """[(index, name, kind, driver)] of the devices there are, in the driver's order."""
        instance = _Instance()
        try:
            return [(i, d.name, d.kind, d.driver) for i, d in enumerate(cls(instance, p) for p in instance.physical)]
        finally:
            instance.close()

    @classmethod
    def open(cls, select=None, *, validation=False, features=(), statistics=False):
        """Opens a device.

        select      an index, a part of the device's name in any case, or None for DRESSI_DEVICE or else the best there is:
                    discrete before integrated before virtual before cpu
        validation  loads the Khronos validation layer, with synchronization validation; see `messages`
        features    names of VkPhysicalDeviceFeatures to switch on; no other is
        statistics  keep what the driver's compiler says of pipelines, where it says anything

        Raises DeviceError: no loader, driver or such device, no graphics queue, a feature it does not have.
        """
        instance = _Instance(validation)
        device = None
        try:
            device = cls._chosen(instance, select)
            device.statistics = statistics and vk.VK_KHR_PIPELINE_EXECUTABLE_PROPERTIES_EXTENSION_NAME in device.extensions
            device._connect(tuple(features))
            return device
        except BaseException:
            instance.close() if device is None else device.close()
            raise

    @classmethod
    def _chosen(cls, instance, select):
        devices = [cls(instance, physical) for physical in instance.physical]
        if not devices:
            raise DeviceError("no Vulkan device found: install a driver, on Debian mesa-vulkan-drivers")
        there = "; ".join(f"{i}: {d.name} ({d.kind})" for i, d in enumerate(devices))
        source = "" if select is not None else " (from DRESSI_DEVICE)"
        if select is None:
            select = os.environ.get("DRESSI_DEVICE", "")
        select = str(select).strip()
        if select.isdecimal() and int(select) < len(devices):
            found = [devices[int(select)]]
        else:
            found = [d for d in devices if select.lower() in d.name.lower()]
        if not found:
            raise DeviceError(f"no Vulkan device is called {select!r}{source}; there are {there}")
        able = [d for d in found if d.queue_family >= 0]
        if not able:
            raise DeviceError(f"no graphics queue on {', '.join(d.name for d in found)}; there are {there}")
        return min(able, key=lambda d: RANK[d.kind])

    def _connect(self, features):
        for name in features:
            if not self.features.get(name):
                why = "does not have it" if name in self.features else "there is no such feature in VkPhysicalDeviceFeatures"
                raise DeviceError(f"feature {name} was asked for of {self.name}: {why}")
        self.enabled = features
        # a device that has it is not wholly conformant, and must be told that we know
        extensions = [name for name in [vk.VK_KHR_PORTABILITY_SUBSET_EXTENSION_NAME] if name in self.extensions]
        chain = None
        if self.statistics:
            extensions.append(vk.VK_KHR_PIPELINE_EXECUTABLE_PROPERTIES_EXTENSION_NAME)
            chain = vk.VkPhysicalDevicePipelineExecutablePropertiesFeaturesKHR(pipelineExecutableInfo=vk.VK_TRUE)
        queues = [vk.VkDeviceQueueCreateInfo(queueFamilyIndex=self.queue_family, pQueuePriorities=[1.0])]
        self.device = vk.CreateDevice(self.physical, vk.VkDeviceCreateInfo(
            pNext=chain, pQueueCreateInfos=queues, ppEnabledExtensionNames=extensions,
            pEnabledFeatures=vk.VkPhysicalDeviceFeatures(**dict.fromkeys(features, vk.VK_TRUE))))
        self.queue = vk.GetDeviceQueue(self.device, self.queue_family, 0)

    @property
    def local_heaps(self):
        """Bytes of each heap that is the device's own."""
        return [size for size, flags in self.heaps if flags & vk.VK_MEMORY_HEAP_DEVICE_LOCAL_BIT]

    @property
    def driver(self):
        """The driver's name and version in words, as far as it tells."""
        return f"{self.driver_name} {self.driver_info}".strip() or f"driver {self.driver_version:#x}"

    def format_features(self, format):
        """VkFormatFeatureFlags of a VkFormat: (linear tiling, optimal tiling, buffer)."""
        properties = vk.GetPhysicalDeviceFormatProperties(self.physical, format)
        return properties.linearTilingFeatures, properties.optimalTilingFeatures, properties.bufferFeatures

    def close(self):
        """Waits until the device is idle and destroys it; what was made from it must be gone by then. May be called twice. In a
        forked child, which owns nothing on the device, it does nothing."""
        if os.getpid() != self.process:
            return
        device, self.device, self.queue = self.device, None, None
        try:
            if device:
                try:
                    with self.lock:
                        vk.DeviceWaitIdle(device)
                finally:
                    vk.DestroyDevice(device)
        except vk.VulkanError as error:
            if error.result != vk.VK_ERROR_DEVICE_LOST:  # whoever lost it has been told
                raise
        finally:
            self._instance.close()
            self.instance = self.physical = None

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        self.close()

    def __repr__(self):
        return f"<Device {self.name} ({self.kind}), {self.driver}{'' if self.device else ', closed'}>"


def _callback(messages):
    """A C callback that appends to `messages` and MESSAGES. Nothing it raises may reach the driver."""

    def report(severity, types, data, user):
        try:
            told = data.contents
            identity, message = ((s or b"").decode(errors="replace") for s in (told.pMessageIdName, told.pMessage))
            line = f"{SEVERITIES.get(severity, severity)}: {identity}: {message}"
        except Exception as error:  # noqa: BLE001
            line = f"error: a validation message could not be read: {error!r}"
        messages.append(line)
        MESSAGES.append(line)
        return vk.VK_FALSE  # go on with the call that caused it

    return vk.PFN_vkDebugUtilsMessengerCallbackEXT(report)


def _names(properties, member="extensionName"):
    return {getattr(p, member).decode(errors="replace") for p in properties}


def _plain(struct):
    """A struct of numbers and arrays of numbers as a dict."""
    values = ((name, getattr(struct, name)) for name, _ in struct._fields_)
    return {name: value if isinstance(value, (int, float)) else list(value) for name, value in values}
