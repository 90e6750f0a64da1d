/* One thing at a time on the queue: submissions, and transfers of whole images through a staging buffer. */

#include "session.h"

#include <string.h>

enum { ALIGN = 64 }; /* of each image in the staging buffer; Vulkan asks for 4 and the size of a texel */

/* ---- Submissions ---- */

void start(Session *s, Call *call) {
    settle(s, call);
    MUST(call, &s->device->vk, ResetCommandBuffer, s->commands, 0);
    VkCommandBufferBeginInfo info = {TYPE(COMMAND_BUFFER_BEGIN_INFO), .flags = VK_COMMAND_BUFFER_USAGE_ONE_TIME_SUBMIT_BIT};
    MUST(call, &s->device->vk, BeginCommandBuffer, s->commands, &info);
}

void send(Session *s, Call *call, const VkCommandBuffer *commands, uint32_t count) {
    const Vulkan *vk = &s->device->vk;
    settle(s, call);
    MUST(call, vk, ResetFences, s->device->device, 1, &s->fence);
    VkSubmitInfo info = {TYPE(SUBMIT_INFO), .commandBufferCount = count, .pCommandBuffers = commands};
    pthread_mutex_lock(&s->device->lock);
    VkResult result = vk->QueueSubmit(s->device->queue, 1, &info, s->fence);
    pthread_mutex_unlock(&s->device->lock);
    must(call, result, "vkQueueSubmit");
    s->is_busy = true;
}

/* A wait that fails leaves nobody knowing what ran: the session is lost with it. */
void settle(Session *s, Call *call) {
    if (!s->is_busy) return;
    VkResult result = s->device->vk.WaitForFences(s->device->device, 1, &s->fence, VK_TRUE, UINT64_MAX);
    s->is_busy = false;
    if (result != VK_SUCCESS) fail(call, DRESSI_LOST, "vkWaitForFences failed with %s (%d)", result_name(result), result);
}

void finish(Session *s, Call *call) {
    MUST(call, &s->device->vk, EndCommandBuffer, s->commands);
    send(s, call, &s->commands, 1);
    settle(s, call);
}

/* Everything after sees everything before. */
void barrier(const Session *s, VkCommandBuffer commands) {
    VkPipelineStageFlags stages = VK_PIPELINE_STAGE_DRAW_INDIRECT_BIT | VK_PIPELINE_STAGE_VERTEX_SHADER_BIT |
        VK_PIPELINE_STAGE_FRAGMENT_SHADER_BIT | VK_PIPELINE_STAGE_EARLY_FRAGMENT_TESTS_BIT | VK_PIPELINE_STAGE_LATE_FRAGMENT_TESTS_BIT |
        VK_PIPELINE_STAGE_COLOR_ATTACHMENT_OUTPUT_BIT | VK_PIPELINE_STAGE_TRANSFER_BIT;
    VkAccessFlags writes = VK_ACCESS_COLOR_ATTACHMENT_WRITE_BIT | VK_ACCESS_DEPTH_STENCIL_ATTACHMENT_WRITE_BIT |
        VK_ACCESS_TRANSFER_WRITE_BIT;
    if (s->v->compute_count) stages |= VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT, writes |= VK_ACCESS_SHADER_WRITE_BIT;
    VkMemoryBarrier all = {TYPE(MEMORY_BARRIER), .srcAccessMask = writes, .dstAccessMask = writes | VK_ACCESS_SHADER_READ_BIT |
        VK_ACCESS_INPUT_ATTACHMENT_READ_BIT | VK_ACCESS_COLOR_ATTACHMENT_READ_BIT | VK_ACCESS_DEPTH_STENCIL_ATTACHMENT_READ_BIT |
        VK_ACCESS_TRANSFER_READ_BIT};
    s->device->vk.CmdPipelineBarrier(commands, stages, stages, 0, 1, &all, 0, NULL, 0, NULL);
}

/* ---- The staging buffer ---- */

void trim(Session *s, uint64_t size) {
    if (s->staging.size <= size) return;
    s->device->vk.DestroyBuffer(s->device->device, s->staging.buffer, NULL);
    s->device->vk.FreeMemory(s->device->device, s->staging.memory, NULL);
    s->staging = (Staging){0};
}

void reserve(Session *s, Call *call, uint64_t size) {
    const Vulkan *vk = &s->device->vk;
    VkDevice device = s->device->device;
    Staging *staging = &s->staging;
    if (size <= staging->size) return;
    vk->DestroyBuffer(device, staging->buffer, NULL);
    vk->FreeMemory(device, staging->memory, NULL);
    *staging = (Staging){0};
    VkBufferCreateInfo info = {TYPE(BUFFER_CREATE_INFO), .size = size,
                               .usage = VK_BUFFER_USAGE_TRANSFER_SRC_BIT | VK_BUFFER_USAGE_TRANSFER_DST_BIT};
    MUST(call, vk, CreateBuffer, device, &info, NULL, &staging->buffer);
    VkMemoryRequirements needs;
    vk->GetBufferMemoryRequirements(device, staging->buffer, &needs);
    VkMemoryPropertyFlags visible = VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT | VK_MEMORY_PROPERTY_HOST_COHERENT_BIT;
    uint32_t kind = memory_type(call, s->device, needs.memoryTypeBits, visible | VK_MEMORY_PROPERTY_HOST_CACHED_BIT);
    if ((s->device->memory.memoryTypes[kind].propertyFlags & visible) != visible)
        kind = memory_type(call, s->device, needs.memoryTypeBits, visible);
    VkMemoryAllocateInfo memory = {TYPE(MEMORY_ALLOCATE_INFO), .allocationSize = needs.size, .memoryTypeIndex = kind};
    MUST(call, vk, AllocateMemory, device, &memory, NULL, &staging->memory);
    MUST(call, vk, BindBufferMemory, device, staging->buffer, staging->memory, 0);
    void *view;
    MUST(call, vk, MapMemory, device, staging->memory, 0, VK_WHOLE_SIZE, 0, &view);
    staging->view = view;
    staging->size = size; /* last: what failed on the way is made anew, and destroyed with the session */
}

/* ---- Transfers ---- */

uint64_t place(uint64_t *at, const Image *image) {
    uint64_t found = *at;
    *at += divided(image_bytes(image), ALIGN) * ALIGN;
    return found;
}

VkImage current(const Session *s, uint32_t image) { return s->images[image][s->v->images[image].slots == 2 ? s->parity[image] : 0]; }

static VkBufferImageCopy region(const Image *image, uint64_t offset) {
    return (VkBufferImageCopy){offset, 0, 0, {VK_IMAGE_ASPECT_COLOR_BIT, 0, 0, 1}, {0, 0, 0}, {image->width, image->height, 1}};
}

void copy_in(Session *s, const uint32_t *images, uint32_t count) {
    uint64_t at = 0;
    barrier(s, s->commands);
    for (uint32_t k = 0; k < count; k++) {
        const Image *image = s->v->images + images[k];
        VkBufferImageCopy copy = region(image, place(&at, image));
        s->device->vk.CmdCopyBufferToImage(s->commands, s->staging.buffer, current(s, images[k]), VK_IMAGE_LAYOUT_GENERAL, 1, &copy);
    }
    barrier(s, s->commands);
}

void copy_out(Session *s, const uint32_t *images, uint32_t count) {
    uint64_t at = 0;
    barrier(s, s->commands);
    for (uint32_t k = 0; k < count; k++) {
        const Image *image = s->v->images + images[k];
        VkBufferImageCopy copy = region(image, place(&at, image));
        s->device->vk.CmdCopyImageToBuffer(s->commands, current(s, images[k]), VK_IMAGE_LAYOUT_GENERAL, s->staging.buffer, 1, &copy);
    }
    VkMemoryBarrier host = {TYPE(MEMORY_BARRIER), .srcAccessMask = VK_ACCESS_TRANSFER_WRITE_BIT, .dstAccessMask = VK_ACCESS_HOST_READ_BIT};
    s->device->vk.CmdPipelineBarrier(s->commands, VK_PIPELINE_STAGE_TRANSFER_BIT, VK_PIPELINE_STAGE_HOST_BIT, 0, 1, &host, 0, NULL, 0,
        NULL);
}

void upload(Session *s, Call *call, const Copy *copies, uint32_t count) {
    uint64_t total = 0, at = 0;
    uint32_t *images = spare(s, call, count, sizeof *images);
    for (uint32_t k = 0; k < count; k++) {
        images[k] = copies[k].image;
        place(&total, s->v->images + images[k]);
    }
    if (!count) return;
    reserve(s, call, total);
    for (uint32_t k = 0; k < count; k++) {
        const Image *image = s->v->images + images[k];
        uint8_t *to = s->staging.view + place(&at, image);
        uint64_t size = copies[k].texel ? texel_bytes(image->format) : image_bytes(image);
        for (uint64_t n = 0; n < image_bytes(image); n += size) memcpy(to + n, copies[k].data, size);
    }
    start(s, call);
    copy_in(s, images, count);
    finish(s, call);
}
