/* A loader of Vulkan for tests, found before the real one by LD_LIBRARY_PATH: passes everything on to $SHIM_REAL and

   SHIM_FAIL=CALL:N:RESULT   the N-th call of vkCALL, counted from 1, gives this VkResult and does nothing
   SHIM_HEAP=BYTES           every heap has so many
   SHIM_COLORS=N             so many colour attachments, outputs and output resources
   SHIM_CACHE=FILE           pipeline caches give out a blob that grows until they have compiled; FILE gets the bytes each begins with
   SHIM_LOADED=FILE          is made when the library is loaded */

#define VK_NO_PROTOTYPES
#include <vulkan/vulkan.h>

#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef long (*Call)(long, long, long, long, long, long);

/* Calls that can fail: at most six arguments, each in a register. */
#define CALLS(X) X(EnumeratePhysicalDevices) X(CreateDevice) X(QueueSubmit) X(WaitForFences) X(ResetFences) X(AllocateMemory) X(MapMemory) \
    X(CreateBuffer) X(BindBufferMemory) X(CreateImage) X(BindImageMemory) X(CreateImageView) X(CreateSampler) X(CreateShaderModule) \
    X(CreateRenderPass) X(CreateDescriptorSetLayout) X(CreatePipelineLayout) X(CreateGraphicsPipelines) X(CreateFramebuffer) \
    X(CreateDescriptorPool) X(AllocateDescriptorSets) X(CreateCommandPool) X(AllocateCommandBuffers) X(BeginCommandBuffer) \
    X(EndCommandBuffer) X(ResetCommandBuffer) X(CreateFence)

static int fails(const char *name, long *result) {
    static int seen;
    const char *told = getenv("SHIM_FAIL");
    char call[64];
    int number;
    if (!told || sscanf(told, "%63[^:]:%d:%ld", call, &number, result) != 3 || strcmp(call, name)) return 0;
    return ++seen == number;
}

#define X(name) \
    static Call real_##name; \
    static long my_##name(long a, long b, long c, long d, long e, long f) { \
        long result; \
        return fails(#name, &result) ? result : real_##name(a, b, c, d, e, f); \
    }
CALLS(X)
#undef X

static PFN_vkGetPhysicalDeviceMemoryProperties real_memory;
static PFN_vkGetPhysicalDeviceProperties real_properties;
static PFN_vkCreatePipelineCache real_create;
static PFN_vkGetPipelineCacheData real_data;
static VkPhysicalDeviceProperties seen;

static VKAPI_ATTR void VKAPI_CALL my_memory(VkPhysicalDevice device, VkPhysicalDeviceMemoryProperties *p) {
    real_memory(device, p);
    for (uint32_t k = 0; getenv("SHIM_HEAP") && k < p->memoryHeapCount; k++) p->memoryHeaps[k].size = strtoull(getenv("SHIM_HEAP"),
        NULL, 10);
}

static VKAPI_ATTR void VKAPI_CALL my_properties(VkPhysicalDevice device, VkPhysicalDeviceProperties *p) {
    real_properties(device, p);
    seen = *p;
    if (!getenv("SHIM_COLORS")) return;
    p->limits.maxColorAttachments = p->limits.maxFragmentOutputAttachments = p->limits.maxFragmentCombinedOutputResources =
        atoi(getenv("SHIM_COLORS"));
}

static VKAPI_ATTR VkResult VKAPI_CALL my_create(VkDevice device, const VkPipelineCacheCreateInfo *info,
    const VkAllocationCallbacks *with, VkPipelineCache *made) {
    FILE *f = fopen(getenv("SHIM_CACHE"), "ab");
    fprintf(f, "%zu\n", info->initialDataSize);
    fclose(f);
    VkPipelineCacheCreateInfo mine = *info;
    mine.initialDataSize = 0;
    return real_create(device, &mine, with, made);
}

static VKAPI_ATTR VkResult VKAPI_CALL my_data(VkDevice device, VkPipelineCache cache, size_t *size, void *data) {
    uint32_t head[4] = {32, 1, seen.vendorID, seen.deviceID};
    (void)device, (void)cache;
    if (data) {
        memset(data, 7, *size);
        memcpy(data, head, 16);
        memcpy((char *)data + 16, seen.pipelineCacheUUID, 16);
    } else {
        *size = 1000;
    }
    return VK_SUCCESS;
}

static PFN_vkGetInstanceProcAddr real_get;
static PFN_vkGetDeviceProcAddr real_device_get;

static PFN_vkVoidFunction wrapped(const char *name, PFN_vkVoidFunction found) {
#define X(call) if (!strcmp(name, "vk" #call)) { real_##call = (Call)found; return (PFN_vkVoidFunction)my_##call; }
    CALLS(X)
#undef X
#define INSTEAD(call, real, mine) if (!strcmp(name, "vk" #call)) { real = (PFN_vk##call)found; return (PFN_vkVoidFunction)mine; }
    INSTEAD(GetPhysicalDeviceMemoryProperties, real_memory, my_memory)
    INSTEAD(GetPhysicalDeviceProperties, real_properties, my_properties)
    if (getenv("SHIM_CACHE")) {
        INSTEAD(CreatePipelineCache, real_create, my_create)
        INSTEAD(GetPipelineCacheData, real_data, my_data)
    }
    return found;
}

static VKAPI_ATTR PFN_vkVoidFunction VKAPI_CALL get_of_device(VkDevice device, const char *name) { return wrapped(name,
    real_device_get(device, name)); }

VKAPI_ATTR PFN_vkVoidFunction VKAPI_CALL vkGetInstanceProcAddr(VkInstance instance, const char *name) {
    if (!real_get) {
        void *library = dlopen(getenv("SHIM_REAL"), RTLD_NOW);
        real_get = (PFN_vkGetInstanceProcAddr)dlsym(library, "vkGetInstanceProcAddr");
    }
    PFN_vkVoidFunction found = real_get(instance, name);
    if (!strcmp(name, "vkGetDeviceProcAddr")) {
        real_device_get = (PFN_vkGetDeviceProcAddr)found;
        return (PFN_vkVoidFunction)get_of_device;
    }
    return found ? wrapped(name, found) : NULL;
}

__attribute__((constructor)) static void loaded(void) {
    FILE *f = getenv("SHIM_LOADED") ? fopen(getenv("SHIM_LOADED"), "w") : NULL;
    if (f) fclose(f);
}
