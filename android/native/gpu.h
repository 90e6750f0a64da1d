/* Vulkan as libdressi uses it: the calls, loaded at run time, and a device with one queue. */

#ifndef DRESSI_GPU_H
#define DRESSI_GPU_H

#define VK_NO_PROTOTYPES
#include <vulkan/vulkan_core.h>

#include <pthread.h>

#include "inside.h"

#define INSTANCE_CALLS(X) X(DestroyInstance) X(EnumeratePhysicalDevices) X(GetPhysicalDeviceProperties) X(GetPhysicalDeviceFeatures) \
    X(GetPhysicalDeviceFormatProperties) X(GetPhysicalDeviceMemoryProperties) X(GetPhysicalDeviceQueueFamilyProperties) \
    X(EnumerateDeviceExtensionProperties) X(CreateDevice) X(GetDeviceProcAddr)
#define DEVICE_CALLS(X) X(DestroyDevice) X(DeviceWaitIdle) X(GetDeviceQueue) X(QueueSubmit) X(QueueWaitIdle) X(AllocateMemory) \
    X(FreeMemory) X(MapMemory) X(CreateBuffer) X(DestroyBuffer) X(GetBufferMemoryRequirements) X(BindBufferMemory) X(CreateImage) \
    X(DestroyImage) X(GetImageMemoryRequirements) X(BindImageMemory) X(CreateImageView) X(DestroyImageView) X(CreateSampler) \
    X(DestroySampler) X(CreateShaderModule) X(DestroyShaderModule) X(CreateRenderPass) X(DestroyRenderPass) \
    X(CreateDescriptorSetLayout) X(DestroyDescriptorSetLayout) X(CreatePipelineLayout) X(DestroyPipelineLayout) \
    X(CreateGraphicsPipelines) X(DestroyPipeline) X(CreatePipelineCache) X(DestroyPipelineCache) X(GetPipelineCacheData) \
    X(CreateFramebuffer) X(DestroyFramebuffer) X(CreateDescriptorPool) X(DestroyDescriptorPool) X(AllocateDescriptorSets) \
    X(UpdateDescriptorSets) X(CreateCommandPool) X(DestroyCommandPool) X(AllocateCommandBuffers) X(FreeCommandBuffers) \
    X(BeginCommandBuffer) X(EndCommandBuffer) X(ResetCommandBuffer) X(CreateFence) X(DestroyFence) X(ResetFences) X(WaitForFences) \
    X(CmdPipelineBarrier) X(CmdClearColorImage) X(CmdCopyBufferToImage) X(CmdCopyImageToBuffer) X(CmdBeginRenderPass) \
    X(CmdNextSubpass) X(CmdEndRenderPass) X(CmdBindPipeline) X(CmdBindDescriptorSets) X(CmdSetViewport) X(CmdSetScissor) X(CmdDraw) \
    X(CmdDrawIndirect) X(CreateComputePipelines) X(CmdDispatch) X(CmdDispatchIndirect)

typedef struct Vulkan {
#define X(name) PFN_vk##name name;
    INSTANCE_CALLS(X) DEVICE_CALLS(X)
#undef X
} Vulkan;

#define TYPE(name) .sType = VK_STRUCTURE_TYPE_##name

struct dressi_device {
    Vulkan vk;
    VkInstance instance;
    VkPhysicalDevice physical;
    VkDevice device;
    VkQueue queue;
    uint32_t family, number, instance_version;
    bool has_driver, has_ids, has_compute; /* has_compute: the queue takes dispatches, too */
    int process;          /* that opened it */
    pthread_mutex_t lock; /* around every use of the queue, which sessions share */
    VkPhysicalDeviceProperties properties;
    VkPhysicalDeviceFeatures features;
    VkPhysicalDeviceMemoryProperties memory;
    uint8_t device_uuid[VK_UUID_SIZE], driver_uuid[VK_UUID_SIZE];
    char driver_name[VK_MAX_DRIVER_NAME_SIZE], driver_info[VK_MAX_DRIVER_INFO_SIZE],
        driver[VK_MAX_DRIVER_NAME_SIZE + VK_MAX_DRIVER_INFO_SIZE];
};

const char *result_name(VkResult result);

/* Fails with DRESSI_LOST, DRESSI_MEMORY or DRESSI_DEVICE unless the result is VK_SUCCESS. */
void must(Call *call, VkResult result, const char *name);
#define MUST(call, vk_, name, ...) must(call, (vk_)->name(__VA_ARGS__), "vk" #name)

VkFormatFeatureFlags features_of(const dressi_device *device, VkFormat format); /* of optimal tiling */

/* The first memory type among `bits` with these properties, or without; fails if there is none. */
uint32_t memory_type(Call *call, const dressi_device *device, uint32_t bits, VkMemoryPropertyFlags wanted);

/* fit.c: the first variant that the device can play, or that made for `profile`; of each why it was taken or not, in the arena. */
Variant *choose(Call *call, Arena *arena, Bundle *bundle, const dressi_device *device, const char *profile, VkFormat *depth, char **why);

#endif
