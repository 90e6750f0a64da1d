"""Writes runtime/vk.py, the ctypes binding: the commands listed here, and what they reach, out of Khronos' registry.

In: COMMANDS, CHAINED and EXTRA below, and the registry as the PyPI package `vulkan-object` reads it (a development tool,
not needed to run anything). Out: one Python module that imports only the standard library.

    python -m tests.vkgen            writes dressi_edge/runtime/vk.py
    python -m tests.vkgen --print    writes to standard output instead

How a C parameter becomes a Python one is decided here and nowhere else:

    const VkAllocationCallbacks*         gone, always NULL
    dispatchable handle                  an int, not 0
    count + const T* array               one list (or ctypes array, or None); a T may be a tuple of its members
    size + const void*                   one bytes-like object
    size + void*                         one ctypes array to be filled
    last T*, void** or T* array          the return value
    count* + T* array                    the return value, a list (bytes for void*)
    T* whose T has sType                 a struct the caller makes, to be filled: it may carry a pNext chain
    trailing optional ones               get a default of 0 or None
    VkResult                             raises VulkanError when negative; returned where there is more than one success

Commands younger than Vulkan 1.0 are looked up in an instance, which is their first parameter.
"""

import sys
import textwrap
from pathlib import Path

# Commands by name, without "vk", in the order of the specification. Structs, handles and enums they reach come along.
COMMANDS = """
    CreateInstance DestroyInstance EnumerateInstanceVersion EnumerateInstanceLayerProperties
    EnumerateInstanceExtensionProperties CreateDebugUtilsMessengerEXT DestroyDebugUtilsMessengerEXT
    EnumeratePhysicalDevices GetPhysicalDeviceProperties GetPhysicalDeviceProperties2 GetPhysicalDeviceFeatures
    GetPhysicalDeviceFeatures2 GetPhysicalDeviceMemoryProperties GetPhysicalDeviceQueueFamilyProperties
    GetPhysicalDeviceFormatProperties GetPhysicalDeviceImageFormatProperties EnumerateDeviceExtensionProperties
    CreateDevice DestroyDevice GetDeviceQueue DeviceWaitIdle QueueSubmit QueueWaitIdle
    AllocateMemory FreeMemory MapMemory UnmapMemory FlushMappedMemoryRanges InvalidateMappedMemoryRanges
    GetDeviceMemoryCommitment
    CreateBuffer DestroyBuffer GetBufferMemoryRequirements BindBufferMemory
    CreateImage DestroyImage GetImageMemoryRequirements BindImageMemory CreateImageView DestroyImageView
    CreateSampler DestroySampler CreateShaderModule DestroyShaderModule
    CreatePipelineCache DestroyPipelineCache GetPipelineCacheData CreatePipelineLayout DestroyPipelineLayout
    DestroyPipeline CreateGraphicsPipelines CreateComputePipelines
    CreateDescriptorSetLayout DestroyDescriptorSetLayout CreateDescriptorPool DestroyDescriptorPool ResetDescriptorPool
    AllocateDescriptorSets FreeDescriptorSets UpdateDescriptorSets
    CreateRenderPass DestroyRenderPass CreateFramebuffer DestroyFramebuffer
    CreateCommandPool DestroyCommandPool ResetCommandPool
    AllocateCommandBuffers FreeCommandBuffers BeginCommandBuffer EndCommandBuffer ResetCommandBuffer
    CmdBindPipeline CmdBindDescriptorSets CmdBindVertexBuffers CmdBindIndexBuffer CmdSetViewport CmdSetScissor
    CmdPushConstants CmdBeginRenderPass CmdNextSubpass CmdEndRenderPass CmdExecuteCommands
    CmdDraw CmdDrawIndexed CmdDrawIndirect CmdDispatch CmdDispatchIndirect
    CmdPipelineBarrier CmdCopyBuffer CmdCopyImage CmdCopyBufferToImage CmdCopyImageToBuffer CmdBlitImage
    CmdClearColorImage CmdClearDepthStencilImage CmdClearAttachments CmdFillBuffer CmdUpdateBuffer
    CmdResetQueryPool CmdWriteTimestamp CmdBeginQuery CmdEndQuery
    CreateQueryPool DestroyQueryPool GetQueryPoolResults
    CreateFence DestroyFence ResetFences GetFenceStatus WaitForFences
    GetPipelineExecutablePropertiesKHR GetPipelineExecutableStatisticsKHR
"""

# Structs that no command names, because they travel in a pNext chain.
CHAINED = ["VkPhysicalDeviceDriverProperties", "VkPhysicalDeviceIDProperties", "VkPhysicalDevicePipelineExecutablePropertiesFeaturesKHR",
           "VkValidationFeaturesEXT"]

# Constants that are not fields of a reached Vulkan 1.0 enum.
EXTRA = [
    "VK_INSTANCE_CREATE_ENUMERATE_PORTABILITY_BIT_KHR",
    "VK_PIPELINE_CREATE_CAPTURE_STATISTICS_BIT_KHR",
    "VK_VALIDATION_FEATURE_ENABLE_SYNCHRONIZATION_VALIDATION_EXT",
]
NUMBERS = """
    VK_MAX_MEMORY_TYPES VK_MAX_MEMORY_HEAPS VK_REMAINING_MIP_LEVELS VK_REMAINING_ARRAY_LAYERS VK_WHOLE_SIZE
    VK_ATTACHMENT_UNUSED VK_TRUE VK_FALSE VK_QUEUE_FAMILY_IGNORED VK_SUBPASS_EXTERNAL VK_LOD_CLAMP_NONE
"""
EXTENSIONS = """
    VK_EXT_debug_utils VK_EXT_validation_features VK_KHR_driver_properties VK_KHR_get_physical_device_properties2
    VK_KHR_pipeline_executable_properties VK_KHR_portability_enumeration VK_KHR_portability_subset
"""

# Enums nobody reads by name here.
SKIPPED = {"VkStructureType", "VkObjectType", "VkSystemAllocationScope", "VkInternalAllocationType", "VkDriverId",
           "VkValidationFeatureEnableEXT", "VkValidationFeatureDisableEXT", "VkBlendFactor", "VkBlendOp", "VkBorderColor",
           "VkComponentSwizzle", "VkImageCreateFlagBits", "VkIndexType", "VkLogicOp", "VkQueryPipelineStatisticFlagBits", "VkStencilOp"}
# Newer versions add fields to old enums: only results of later versions are of use, to name an error.
VERSIONS = {"VkResult": {"VK_VERSION_1_0", "VK_VERSION_1_1", "VK_VERSION_1_2"}}

BASIC = {"uint32_t": "u32", "int32_t": "i32", "uint64_t": "u64", "float": "f32", "size_t": "usize", "char": "char",
         "uint8_t": "u8", "int64_t": "i64", "double": "f64", "VkBool32": "u32", "VkFlags": "u32", "VkDeviceSize": "u64",
         "VkSampleMask": "u32", "VkDeviceAddress": "u64", "void": "void"}

PRELUDE = '''
# ruff: noqa: RUF012
"""Vulkan in ctypes: the structs, constants and commands that the runtime uses.

Generated by `python -m tests.vkgen` from Khronos' registry: edit that, not this.

Structs and constants have their Vulkan names. A struct is made from keywords: sType is set, a list becomes an array and its
count, a str becomes UTF-8, a struct in place of a pointer is pointed to, and whatever is pointed to lives as long as the
struct, or any struct or array it was put into, does. An unknown member is a TypeError.

    info = VkApplicationInfo(pApplicationName="demo", apiVersion=VK_API_VERSION_1_0)
    instance = CreateInstance(VkInstanceCreateInfo(pApplicationInfo=info, ppEnabledLayerNames=[]))

Commands have their Vulkan names less "vk". Allocators and counts are left out, outputs are returned, handles are ints, and
an error is raised as VulkanError.
"""

from ctypes import CDLL, CFUNCTYPE, POINTER, Array, Structure, Union, _Pointer, cast, create_string_buffer, pointer, sizeof
from ctypes import c_char as char
from ctypes import c_char_p as text
from ctypes import c_double as f64
from ctypes import c_float as f32
from ctypes import c_int32 as i32
from ctypes import c_int64 as i64
from ctypes import c_size_t as usize
from ctypes import c_uint8 as u8
from ctypes import c_uint32 as u32
from ctypes import c_uint64 as u64
from ctypes import c_void_p as ptr

from dressi_edge.cache.errors import DeviceError
from dressi_edge.runtime.loader import candidates, missing


class VulkanError(DeviceError):
    """A Vulkan call that failed: `call` is its name, `result` the VkResult, `name` its name."""

    def __init__(self, call, result):
        self.call, self.result, self.name = call, result, RESULTS.get(result, f"VkResult {result}")
        super().__init__(f"{call} failed with {self.name}")


def VK_MAKE_API_VERSION(variant, major, minor, patch):
    return variant << 29 | major << 22 | minor << 12 | patch


def _convert(kind, value):
    """What ctypes takes for a member of this type, and the value's length where it has one."""
    if isinstance(value, str):
        value = value.encode()
    if isinstance(value, (bytes, bytearray, memoryview)):
        value = bytes(value)
        if kind is ptr:
            return cast(create_string_buffer(value, len(value)), ptr), len(value)
        if issubclass(kind, _Pointer) and kind._type_ is u32:  # SPIR-V
            if len(value) % 4:
                raise ValueError(f"{len(value)} bytes are not a whole number of 32-bit words")
            return (u32 * (len(value) // 4)).from_buffer_copy(value), len(value)
    elif isinstance(value, (list, tuple)):
        if issubclass(kind, _Pointer):
            return array(kind._type_, value), len(value)
        if issubclass(kind, (Array, Structure)):
            return kind(*value), None
    elif isinstance(value, Array):
        return (cast(value, ptr), sizeof(value)) if kind is ptr else (value, len(value))
    elif isinstance(value, (Structure, Union)) and not isinstance(value, kind):
        if kind is ptr:
            return cast(pointer(value), ptr), None
        if issubclass(kind, _Pointer):
            return pointer(value), 1
    return value, None


def _set(self, values):
    kinds, counted = self._kinds_, {}
    for name, value in values.items():
        if name not in kinds:
            raise TypeError(f"{type(self).__name__} has no member {name!r}")
        if type(value) is int:
            object.__setattr__(self, name, value)
            continue
        value, length = _convert(kinds[name], value)
        object.__setattr__(self, name, value)
        count = self._counts_.get(name)
        if count and count not in values and length is not None:
            if count.endswith("Size") and isinstance(value, Array):  # a size in bytes
                length = sizeof(value)
            if counted.setdefault(count, length) != length:
                raise ValueError(f"{type(self).__name__}: {name} has length {length}, but {count} is already {counted[count]}")
            object.__setattr__(self, count, length)


class _Members:
    """What structs and unions share: members by keyword, or in order where there is no sType."""

    __slots__ = ()
    _sType_, _counts_ = None, {}

    def __init_subclass__(cls):
        cls._kinds_ = dict(getattr(cls, "_fields_", ()))

    def __init__(self, *args, **values):
        if self._sType_ is not None:
            object.__setattr__(self, "sType", self._sType_)
            if args:
                raise TypeError(f"{type(self).__name__} takes keywords only")
        elif len(args) > len(self._kinds_):
            raise TypeError(f"{type(self).__name__} has {len(self._kinds_)} members, got {len(args)} values")
        _set(self, {**dict(zip(self._kinds_, args)), **values} if args else values)

    def __setattr__(self, name, value):
        _set(self, {name: value})


class Struct(_Members, Structure):
    def __repr__(self):
        return f"{type(self).__name__}({', '.join(f'{name}={getattr(self, name)!r}' for name in self._kinds_)})"


class Variant(_Members, Union):
    pass


def array(kind, items):
    """A ctypes array of a list or tuple; None where it is empty; a ctypes array as it is."""
    if isinstance(items, Array):
        return items
    if not items:
        return None
    if kind is text:
        items = [item.encode() if isinstance(item, str) else item for item in items]
    return (kind * len(items))(*items)


class handle(ptr):
    """A parameter that must not be NULL: a loader handed a closed device would crash."""

    @classmethod
    def from_param(cls, value):
        if not value:
            raise TypeError("a NULL handle: the instance, device, queue or command buffer is closed or was never made")
        return ptr.from_param(value)


def _count(first, *others):
    count = 0 if first is None else len(first)
    for other in others:
        if other is not None and len(other) != count:
            raise ValueError(f"lists of {count} and {len(other)} entries must have one length")
    return count


def _text(value):
    return value.encode() if isinstance(value, str) else value


def _check(result, call):
    if result < 0:
        raise VulkanError(call, result)
    return result


def _enumerate(call, kind, function, *args):
    """Vulkan's two calls, count then contents, until the contents are complete."""
    while True:
        count = u32()
        _check(function(*args, count, None) or 0, call)
        out = (kind * count.value)(*([kind()] * count.value if getattr(kind, "_sType_", None) else ()))
        if _check(function(*args, count, out) or 0, call) != VK_INCOMPLETE:
            return out[:count.value]


class _Library:
    """The loader library; opened, and each command looked up in it, when first used."""

    def __getattr__(self, name):
        if name == "dll":
            self.dll = _open()
            return self.dll
        try:
            function = self.dll[name]
        except AttributeError:
            raise DeviceError(f"the Vulkan library {self.dll._name} has no {name}") from None
        function.restype, *function.argtypes = _signature(name)
        setattr(self, name, function)
        return function


def _open():
    tried = candidates()
    for name in tried:
        try:
            return CDLL(name)
        except OSError:
            continue
    raise DeviceError(missing(tried))


def _signature(name):
    restype, *kinds = _SIGNATURES[name].split()
    return [None if restype == "void" else globals()[restype],
            *(POINTER(globals()[kind[:-1]]) if kind.endswith("*") else globals()[kind] for kind in kinds)]


def _entry(instance, name):
    """A command of a later version or an extension; `name` or its KHR twin."""
    for candidate in (name, name + "KHR"):
        address = _lib.vkGetInstanceProcAddr(instance, candidate.encode())
        if address:
            return CFUNCTYPE(*_signature(name))(address)
    raise DeviceError(f"this Vulkan instance has no {name}")


_lib = _Library()
VK_NULL_HANDLE = 0
VK_API_VERSION_1_0, VK_API_VERSION_1_1, VK_API_VERSION_1_2 = (VK_MAKE_API_VERSION(0, 1, minor, 0) for minor in range(3))
'''


class Generator:
    def __init__(self, registry):
        self.registry = registry
        self.structs, self.enums = [], set()  # structs in an order in which each comes after what it holds
        for name in COMMANDS.split():
            for param in registry.commands["vk" + name].params:
                if param.type != "VkAllocationCallbacks":
                    self.reach(param.type)
            if registry.commands["vk" + name].returnType == "VkResult":
                self.enums.add("VkResult")
        for name in CHAINED:
            self.reach(name)

    def reach(self, name):
        registry = self.registry
        if name in registry.structs:
            if name not in self.structs:
                for member in registry.structs[name].members:
                    if member.type != name:
                        self.reach(member.type)
                self.structs.append(name)
        elif name in registry.enums or name in registry.bitmasks:
            self.enums.add(name)
        elif name in registry.flags and registry.flags[name].bitmaskName:
            self.enums.add(registry.flags[name].bitmaskName)
        elif name in registry.funcPointers:
            for param in registry.funcPointers[name].params:
                self.reach(param.type)

    def constants(self):
        registry, rows = self.registry, []
        for name in NUMBERS.split():
            rows.append((name, registry.constants[name].value))
        for name in sorted(self.enums - SKIPPED):
            is_enum = name in registry.enums
            fields = registry.enums[name].fields if is_enum else registry.bitmasks[name].flags
            versions = VERSIONS.get(name, {"VK_VERSION_1_0"})
            rows += [(f.name, f.value) for f in fields if f.name in EXTRA or not f.definingRequirements and not f.extensions
                     or not f.extending or versions & set(f.definingRequirements)]
        sTypes = {f.name: f.value for f in registry.enums["VkStructureType"].fields}
        rows += [(s, sTypes[s]) for s in (registry.structs[name].sType for name in self.structs) if s]
        have = {name for name, _ in rows}
        everything = {f.name: f.value for e in registry.enums.values() for f in e.fields}
        everything.update({f.name: f.value for b in registry.bitmasks.values() for f in b.flags})
        rows += [(name, everything[name]) for name in EXTRA if name not in have]
        lines = [f"{name} = {value}" for name, value in rows]
        lines += [f'{name.upper()}_EXTENSION_NAME = "{name}"' for name in EXTENSIONS.split()]
        lines.append('RESULTS = {value: name for name, value in globals().items() if name.startswith("VK_ERROR_")}')
        return lines

    def scalar(self, name):
        registry = self.registry
        if name in BASIC:
            return BASIC[name]
        if name in registry.flags:
            return "u32" if registry.flags[name].bitWidth == 32 else "u64"
        if name in registry.handles:
            return "ptr" if registry.handles[name].dispatchable else "u64"
        if name in registry.enums:
            return "i32"
        if name in registry.bitmasks:
            return "u32"
        return name  # a struct or a function pointer

    def kind(self, item, own=""):
        """The ctypes type of a member or parameter, as written in the C-like short form: `u32`, `VkExtent2D`, `u64*`."""
        stars = item.fullType.count("*")
        if item.type == "VkAllocationCallbacks" or item.type == own:
            return "ptr"
        base = self.scalar(item.type)
        if base == "void":
            return "ptr" if stars == 1 else "ptr*"
        if base == "char" and stars:
            return "text" if stars == 1 else "text*"
        return base + "*" * stars

    def struct(self, name):
        struct = self.registry.structs[name]
        fields, counts, members = [], {}, {m.name: m for m in struct.members}
        for member in struct.members:
            kind = self.kind(member, name)
            if kind.endswith("*"):
                kind = f"POINTER({kind[:-1]})"
            for size in member.fixedSizeArray:
                kind += f" * {self.registry.constants[size].value if size in self.registry.constants else size}"
            fields.append(f'("{member.name}", {kind})')
            length = (member.length or "").split(" / ")[0]  # pCode has codeSize / 4
            if "*" in member.fullType and length in members:
                counts[member.name] = length
        lines = [f"class {name}({'Variant' if struct.union else 'Struct'}):"]
        if struct.sType:
            lines.append(f"    _sType_ = {struct.sType}")
        if counts:
            lines += wrapped("    _counts_ = {", [f'"{p}": "{c}"' for p, c in counts.items()], "}")
        return "\n".join(lines + wrapped("    _fields_ = [", fields, "]"))

    def callback(self, name):
        pointer = self.registry.funcPointers[name]
        kinds = []
        for param in pointer.params:
            kind = self.kind(param)
            kinds.append(f"POINTER({kind[:-1]})" if kind.endswith("*") else kind)
        return f"{name} = CFUNCTYPE({self.scalar(pointer.returnType)}, {', '.join(kinds)})"

    def signature(self, name):
        command = self.registry.commands[name]
        result = {"void": "void", "VkResult": "i32", "PFN_vkVoidFunction": "ptr"}[command.returnType]
        kinds = ["handle" if p.type in self.registry.handles and self.kind(p) == "ptr" and not p.optional else self.kind(p)
                 for p in command.params]
        line = f'    "{name}": "{" ".join([result, *kinds])}",'
        if len(line) <= 128:
            return line
        cut = line.rindex(" ", 0, 126)
        return line[:cut + 1] + '"\n' + " " * (line.index(": ") + 2) + '"' + line[cut + 1:]

    def command(self, name):
        """One Python function; the rules are in the first lines of this file."""
        command = self.registry.commands[name]
        params = {p.name: p for p in command.params}
        result = command.returnType == "VkResult"
        inputs, before, values, output, lists = [], [], [], None, {}
        for p in command.params:  # a list stands for its count
            if p.length in params and not params[p.length].pointer and p.pointer and (p.const or p.type == "void"):
                lists.setdefault(p.length, []).append(p.name)
        for p in command.params:
            kind, optional = self.kind(p), "None" if "*" in p.fullType else "0"
            if p.type == "VkAllocationCallbacks":
                values.append("None")
            elif p.name in lists:
                values.append(p.name)
            elif p.length in lists and p.const:
                if p.type == "void":
                    before += [f"{p.name} = bytes({p.name})", f"{p.length} = len({p.name})"]
                else:
                    before.append(f"{p.name} = array({kind[:-1]}, {p.name})")
                    if p.name == lists[p.length][-1]:
                        before.append(f"{p.length} = _count({', '.join(lists[p.length])})")
                values.append(p.name)
                inputs.append((p.name, params[p.length].optional and "None"))
            elif p.length in lists and p.type == "void":
                before.append(f"{p.length} = sizeof({p.name})")
                values.append(p.name)
                inputs.append((p.name, False))
            elif "*" in p.fullType and not p.const and (p.length or not self.chained(p)):
                output = output or p
                values.append(p.name)
            elif kind == "text":
                values.append(f"_text({p.name})")
                inputs.append((p.name, p.optional and "None"))
            else:
                values.append(p.name)
                inputs.append((p.name, p.optional and optional))
        function = f"_lib.{name}"
        if command.version or command.extensions:
            if command.params[0].type == "VkInstance":
                function = f'_entry({command.params[0].name}, "{name}")'
            elif name == "vkEnumerateInstanceVersion":
                function = f'_entry(None, "{name}")'
            else:
                function, inputs = f'_entry(instance, "{name}")', [("instance", False), *inputs]
        call = f"{function}({', '.join(values)})"
        checked = f'_check({call}, "{name}")' if result else call
        if output is None:
            lines = [*before, f"return {checked}" if result and len(command.successCodes) > 1 else checked]
        elif output.length is None and output.name.endswith("Count"):  # count, then contents
            kind = self.kind(command.params[-1])[:-1]
            lines = [*before, f'return _enumerate({", ".join([chr(34) + name + chr(34), kind, function, *values[:-2]])})']
        elif output.name == "pDataSize":
            sized = [*values[:-2], "pDataSize", "None"]
            filled = [*values[:-2], "pDataSize", "pData"]
            lines = ["pDataSize = usize()", f'_check({function}({", ".join(sized)}), "{name}")',
                     "pData = create_string_buffer(pDataSize.value)", f'_check({function}({", ".join(filled)}), "{name}")',
                     "return pData.raw[:pDataSize.value]"]
        else:
            kind = self.kind(output)[:-1]
            if output.length:
                count = output.length.replace("->", ".")
                made, given = f"({kind} * {count})()", f"list({output.name})"
            else:
                made, given = f"{kind}()", output.name if kind in self.registry.structs else f"{output.name}.value"
            lines = [*before, f"{output.name} = {made}"]
            if output.length in lists:  # several objects: when one fails, none is left behind
                lines += [f"result = {call}", "if result < 0:", f"    for made in filter(None, {output.name}):",
                          f"        Destroy{output.type[2:]}({command.params[0].name}, made)", f'_check(result, "{name}")']
            else:
                lines.append(checked)
            lines.append(f"return {given}")
        arguments, trailing = [], not name.startswith(("vkDestroy", "vkFree"))
        for argument, default in reversed(inputs):
            trailing = trailing and bool(default) and not argument.endswith("StageMask")
            arguments.insert(0, f"{argument}={default}" if trailing else argument)
        lines = [f"def {name[2:]}({', '.join(arguments)}):", *("    " + line for line in lines)]
        return "\n".join(part for line in lines for part in folded(line))

    def chained(self, param):
        return param.type in self.registry.structs and bool(self.registry.structs[param.type].sType)

    def module(self):
        callbacks = {m.type for name in self.structs for m in self.registry.structs[name].members if m.type.startswith("PFN_")}
        classes, later = [], {name: self.callback(name) for name in callbacks}
        for name in self.structs:
            for callback in [m.type for m in self.registry.structs[name].members if m.type in later]:
                classes.append(later.pop(callback))
            classes.append(self.struct(name))
        names = ["vk" + name for name in COMMANDS.split()]
        signatures = "\n".join(["_SIGNATURES = {", *(self.signature(n) for n in ["vkGetInstanceProcAddr", *names]), "}"])
        parts = [PRELUDE.strip(), *classes, signatures, *(self.command(name) for name in names)]
        parts.insert(1, "\n".join(self.constants()))
        parts.insert(0, parts.pop(0) + "\n" + parts.pop(0))
        return "\n\n\n".join(parts) + "\n"


def wrapped(head, items, tail):
    """`head` item, item, ... `tail` on lines of at most 128 columns."""
    body = textwrap.wrap(", ".join(item.replace(" ", "\0") for item in items) + tail, 128 - len(head), break_long_words=False,
                         break_on_hyphens=False)
    return (head + ("\n" + " " * len(head)).join(body)).replace("\0", " ").splitlines()


def folded(line):
    """A line of code as lines of at most 128 columns, broken after commas."""
    start = line.index("(") + 1 if "(" in line else 0
    return [line] if len(line) <= 128 else wrapped(line[:start], line[start:].split(", "), "")


def generate():
    """The text of runtime/vk.py."""
    from vulkan_object import get_vulkan_object

    return Generator(get_vulkan_object()).module()


if __name__ == "__main__":
    if "--print" in sys.argv[1:]:
        sys.stdout.write(generate())
    else:
        (Path(__file__).parents[1] / "dressi_edge" / "runtime" / "vk.py").write_text(generate(), encoding="utf-8")
