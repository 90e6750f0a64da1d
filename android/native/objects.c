/* The objects of a variant: images in one allocation a memory type, render passes, shaders and pipelines, each distinct one once. */

#include "session.h"

#include <string.h>

void create_work(Session *s, Call *call) {
    const Vulkan *vk = &s->device->vk;
    VkDevice device = s->device->device;
    VkCommandPoolCreateInfo pool = {TYPE(COMMAND_POOL_CREATE_INFO), .flags = VK_COMMAND_POOL_CREATE_RESET_COMMAND_BUFFER_BIT,
                                    .queueFamilyIndex = s->device->family};
    MUST(call, vk, CreateCommandPool, device, &pool, NULL, &s->pool);
    VkFenceCreateInfo fence = {TYPE(FENCE_CREATE_INFO)};
    MUST(call, vk, CreateFence, device, &fence, NULL, &s->fence);
    VkCommandBufferAllocateInfo info = {TYPE(COMMAND_BUFFER_ALLOCATE_INFO), .commandPool = s->pool, .commandBufferCount = 1};
    MUST(call, vk, AllocateCommandBuffers, device, &info, &s->commands);
}

/* ---- Images ---- */

static VkFormat vulkan_format(const Session *s, uint32_t format) { return format ? (VkFormat)format : s->depth; }

static VkImageSubresourceRange whole(const Image *image) {
    return (VkImageSubresourceRange){image->format ? VK_IMAGE_ASPECT_COLOR_BIT : VK_IMAGE_ASPECT_DEPTH_BIT, 0, 1, 0, 1};
}

/* Fails before anything is allocated: a driver may promise more than it has, and fail at the first use. */
static void check_heaps(const Session *s, Call *call, const uint64_t *sizes) {
    const VkPhysicalDeviceMemoryProperties *m = &s->device->memory;
    uint64_t wanted[VK_MAX_MEMORY_HEAPS] = {0};
    for (uint32_t k = 0; k < m->memoryTypeCount; k++) wanted[m->memoryTypes[k].heapIndex] += sizes[k];
    for (uint32_t k = 0; k < m->memoryHeapCount; k++)
        if (wanted[k] > m->memoryHeaps[k].size)
            fail(call, DRESSI_DEVICE, "the images of this bundle need %.1f MB; %s has %.1f MB (heap %u); compile it with fewer or smaller "
                 "views", wanted[k] / 1e6, s->device->properties.deviceName, m->memoryHeaps[k].size / 1e6, k);
}

static void clear_images(Session *s, Call *call) {
    const Vulkan *vk = &s->device->vk;
    VkClearColorValue zero = {{0}};
    start(s, call);
    for (uint32_t k = 0; k < 2 * s->v->image_count; k++) {
        const Image *image = s->v->images + k / 2;
        VkImage handle = s->images[k / 2][k % 2];
        if (k % 2 >= image->slots) continue;
        VkImageMemoryBarrier first = {TYPE(IMAGE_MEMORY_BARRIER), .newLayout = VK_IMAGE_LAYOUT_GENERAL,
            .dstAccessMask = VK_ACCESS_TRANSFER_WRITE_BIT, .srcQueueFamilyIndex = VK_QUEUE_FAMILY_IGNORED,
            .dstQueueFamilyIndex = VK_QUEUE_FAMILY_IGNORED, .image = handle, .subresourceRange = whole(image)};
        vk->CmdPipelineBarrier(s->commands, VK_PIPELINE_STAGE_TOP_OF_PIPE_BIT, VK_PIPELINE_STAGE_ALL_COMMANDS_BIT, 0, 0, NULL, 0, NULL,
            1, &first);
        if (image->format) vk->CmdClearColorImage(s->commands, handle, VK_IMAGE_LAYOUT_GENERAL, &zero, 1, &first.subresourceRange);
    }
    barrier(s, s->commands);
    MUST(call, vk, EndCommandBuffer, s->commands);
    send(s, call, &s->commands, 1); /* the device does this while the driver compiles */
}

void create_images(Session *s, Call *call) {
    const Vulkan *vk = &s->device->vk;
    VkDevice device = s->device->device;
    uint32_t count = 2 * s->v->image_count;
    struct { uint32_t kind; uint64_t offset; } *places = spare(s, call, count, sizeof *places);
    uint64_t sizes[VK_MAX_MEMORY_TYPES] = {0};
    s->images = grow(call, &s->bundle.arena, s->v->image_count, sizeof *s->images);
    s->views = grow(call, &s->bundle.arena, s->v->image_count, sizeof *s->views);
    for (uint32_t k = 0; k < count; k++) {
        const Image *image = s->v->images + k / 2;
        if (k % 2 >= image->slots) continue;
        VkImageCreateInfo info = {TYPE(IMAGE_CREATE_INFO), .imageType = VK_IMAGE_TYPE_2D, .format = vulkan_format(s, image->format),
            .extent = {image->width, image->height, 1}, .mipLevels = 1, .arrayLayers = 1, .samples = VK_SAMPLE_COUNT_1_BIT,
            .usage = image->usage | (image->format ? VK_IMAGE_USAGE_TRANSFER_DST_BIT : 0)};
        VkMemoryRequirements needs;
        MUST(call, vk, CreateImage, device, &info, NULL, &s->images[k / 2][k % 2]);
        vk->GetImageMemoryRequirements(device, s->images[k / 2][k % 2], &needs);
        uint32_t kind = memory_type(call, s->device, needs.memoryTypeBits, VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT);
        places[k].kind = kind, places[k].offset = divided(sizes[kind], needs.alignment) * needs.alignment;
        sizes[kind] = places[k].offset + needs.size;
    }
    check_heaps(s, call, sizes);
    for (uint32_t k = 0; k < s->device->memory.memoryTypeCount; k++) {
        VkMemoryAllocateInfo info = {TYPE(MEMORY_ALLOCATE_INFO), .allocationSize = sizes[k], .memoryTypeIndex = k};
        if (sizes[k]) MUST(call, vk, AllocateMemory, device, &info, NULL, s->memory + k);
        s->image_bytes += sizes[k];
    }
    for (uint32_t k = 0; k < count; k++) {
        const Image *image = s->v->images + k / 2;
        VkImage handle = s->images[k / 2][k % 2];
        if (k % 2 >= image->slots) continue;
        MUST(call, vk, BindImageMemory, device, handle, s->memory[places[k].kind], places[k].offset);
        VkImageViewCreateInfo view = {TYPE(IMAGE_VIEW_CREATE_INFO), .image = handle, .viewType = VK_IMAGE_VIEW_TYPE_2D,
                                      .format = vulkan_format(s, image->format), .subresourceRange = whole(image)};
        if (image->usage & ~3u) MUST(call, vk, CreateImageView, device, &view, NULL, &s->views[k / 2][k % 2]); /* others are only copied */
    }
    clear_images(s, call);
}

/* ---- Render passes ---- */

static void create_pass(Session *s, Call *call, const Pass *pass, VkRenderPass *found) {
    uint32_t n = pass->attachment_count;
    VkAttachmentDescription *attachments = spare(s, call, n, sizeof *attachments);
    VkSubpassDescription *subpasses = spare(s, call, pass->subpass_count, sizeof *subpasses);
    VkSubpassDependency *dependencies = spare(s, call, pass->subpass_count, sizeof *dependencies);
    for (uint32_t k = 0; k < n; k++)
        attachments[k] = (VkAttachmentDescription){.format = vulkan_format(s, pass->attachments[k].format),
            .samples = VK_SAMPLE_COUNT_1_BIT,
            .loadOp = (VkAttachmentLoadOp)pass->attachments[k].load, .storeOp = (VkAttachmentStoreOp)pass->attachments[k].store,
            .stencilLoadOp = VK_ATTACHMENT_LOAD_OP_DONT_CARE, .stencilStoreOp = VK_ATTACHMENT_STORE_OP_DONT_CARE,
            .initialLayout = VK_IMAGE_LAYOUT_GENERAL, .finalLayout = VK_IMAGE_LAYOUT_GENERAL};
    for (uint32_t k = 0; k < pass->subpass_count; k++) {
        const Subpass *subpass = pass->subpasses + k;
        VkSubpassDescription *made = subpasses + k;
        VkAttachmentReference *refs = spare(s, call, subpass->colors.count + subpass->inputs.count + 1, sizeof *refs), *next = refs;
        uint32_t *kept = spare(s, call, n, sizeof *kept);
        bool *used = spare(s, call, n, 1);
        *made = (VkSubpassDescription){.pColorAttachments = refs, .colorAttachmentCount = subpass->colors.count,
            .pInputAttachments = refs + subpass->colors.count, .inputAttachmentCount = subpass->inputs.count};
        for (uint32_t c = 0; c < subpass->colors.count + subpass->inputs.count; c++) {
            uint32_t a = c < subpass->colors.count ? subpass->colors.at[c] : subpass->inputs.at[c - subpass->colors.count];
            *next++ = (VkAttachmentReference){a, VK_IMAGE_LAYOUT_GENERAL};
            used[a] = true;
        }
        if (subpass->depth >= 0) {
            *next = (VkAttachmentReference){subpass->depth, VK_IMAGE_LAYOUT_GENERAL};
            made->pDepthStencilAttachment = next;
            used[subpass->depth] = true;
        }
        for (uint32_t a = 0; a < n; a++)
            if (!used[a]) kept[made->preserveAttachmentCount++] = a;
        made->pPreserveAttachments = kept;
        if (k) dependencies[k - 1] = (VkSubpassDependency){k - 1, k, VK_PIPELINE_STAGE_COLOR_ATTACHMENT_OUTPUT_BIT,
            VK_PIPELINE_STAGE_COLOR_ATTACHMENT_OUTPUT_BIT | VK_PIPELINE_STAGE_FRAGMENT_SHADER_BIT, VK_ACCESS_COLOR_ATTACHMENT_WRITE_BIT,
            VK_ACCESS_INPUT_ATTACHMENT_READ_BIT | VK_ACCESS_COLOR_ATTACHMENT_WRITE_BIT, VK_DEPENDENCY_BY_REGION_BIT};
    }
    VkRenderPassCreateInfo info = {TYPE(RENDER_PASS_CREATE_INFO), .attachmentCount = n, .pAttachments = attachments,
        .subpassCount = pass->subpass_count, .pSubpasses = subpasses, .dependencyCount = pass->subpass_count - 1,
            .pDependencies = dependencies};
    MUST(call, &s->device->vk, CreateRenderPass, s->device->device, &info, NULL, found);
}

/* ---- Pipelines ---- */

/* Order of bindings, so that equal ones are neighbours. */
static bool bindings_before(uint32_t a, uint32_t b, const void *context) {
    const Pipeline *x = (const Pipeline *)context + a, *y = (const Pipeline *)context + b;
    if (x->binding_count != y->binding_count) return x->binding_count < y->binding_count;
    return x->binding_count && memcmp(x->bindings, y->bindings, x->binding_count * sizeof(Binding)) < 0;
}

static void create_layouts(Session *s, Call *call) {
    const Vulkan *vk = &s->device->vk;
    const Variant *v = s->v;
    uint32_t n = v->pipeline_count, *order = spare(s, call, n, 4), *other = spare(s, call, n, 4);
    for (uint32_t k = 0; k < n; k++) order[k] = k;
    sort(order, other, n, bindings_before, v->pipelines);
    for (uint32_t j = 0; j < n; j++) {
        uint32_t k = order[j];
        bool again = j && !bindings_before(order[j - 1], k, v->pipelines);
        s->shared[k] = again ? s->shared[order[j - 1]] : k;
        if (again) continue;
        const Pipeline *p = v->pipelines + k;
        VkDescriptorSetLayoutBinding *bindings = spare(s, call, p->binding_count, sizeof *bindings);
        for (uint32_t b = 0; b < p->binding_count; b++)
            bindings[b] = (VkDescriptorSetLayoutBinding){b, (VkDescriptorType)p->bindings[b].kind, 1, p->bindings[b].stages, NULL};
        VkDescriptorSetLayoutCreateInfo set = {TYPE(DESCRIPTOR_SET_LAYOUT_CREATE_INFO), .bindingCount = p->binding_count,
            .pBindings = bindings};
        MUST(call, vk, CreateDescriptorSetLayout, s->device->device, &set, NULL, s->set_layouts + k);
        VkPipelineLayoutCreateInfo layout = {TYPE(PIPELINE_LAYOUT_CREATE_INFO), .setLayoutCount = 1, .pSetLayouts = s->set_layouts + k};
        MUST(call, vk, CreatePipelineLayout, s->device->device, &layout, NULL, s->layouts + k);
    }
}

static void create_pipeline(Session *s, Call *call, uint32_t k) {
    const Pipeline *p = s->v->pipelines + k;
    uint32_t colors = s->v->passes[p->pass].subpasses[p->subpass].colors.count;
    VkPipelineShaderStageCreateInfo stages[2];
    for (int n = 0; n < 2; n++)
        stages[n] = (VkPipelineShaderStageCreateInfo){TYPE(PIPELINE_SHADER_STAGE_CREATE_INFO), .pName = "main",
            .stage = n ? VK_SHADER_STAGE_FRAGMENT_BIT : VK_SHADER_STAGE_VERTEX_BIT, .module = s->modules[n ? p->fragment : p->vertex]};
    VkPipelineVertexInputStateCreateInfo vertices = {TYPE(PIPELINE_VERTEX_INPUT_STATE_CREATE_INFO)};
    VkPipelineInputAssemblyStateCreateInfo assembly = {TYPE(PIPELINE_INPUT_ASSEMBLY_STATE_CREATE_INFO),
                                                       .topology = (VkPrimitiveTopology)p->topology};
    VkPipelineViewportStateCreateInfo viewport = {TYPE(PIPELINE_VIEWPORT_STATE_CREATE_INFO), .viewportCount = 1, .scissorCount = 1};
    VkPipelineRasterizationStateCreateInfo raster = {TYPE(PIPELINE_RASTERIZATION_STATE_CREATE_INFO), .frontFace = VK_FRONT_FACE_CLOCKWISE,
                                                     .lineWidth = 1};
    VkPipelineMultisampleStateCreateInfo samples = {TYPE(PIPELINE_MULTISAMPLE_STATE_CREATE_INFO),
        .rasterizationSamples = VK_SAMPLE_COUNT_1_BIT};
    VkPipelineDepthStencilStateCreateInfo depth = {TYPE(PIPELINE_DEPTH_STENCIL_STATE_CREATE_INFO), .depthTestEnable = p->depth,
                                                   .depthWriteEnable = p->depth, .depthCompareOp = VK_COMPARE_OP_LESS};
    VkPipelineColorBlendAttachmentState *masks = spare(s, call, colors, sizeof *masks);
    for (uint32_t c = 0; c < colors; c++) masks[c].colorWriteMask = 15;
    VkPipelineColorBlendStateCreateInfo blend = {TYPE(PIPELINE_COLOR_BLEND_STATE_CREATE_INFO), .attachmentCount = colors,
        .pAttachments = masks};
    VkDynamicState states[] = {VK_DYNAMIC_STATE_VIEWPORT, VK_DYNAMIC_STATE_SCISSOR};
    VkPipelineDynamicStateCreateInfo dynamic = {TYPE(PIPELINE_DYNAMIC_STATE_CREATE_INFO), .dynamicStateCount = 2, .pDynamicStates = states};
    VkGraphicsPipelineCreateInfo info = {TYPE(GRAPHICS_PIPELINE_CREATE_INFO), .stageCount = 2, .pStages = stages,
        .pVertexInputState = &vertices, .pInputAssemblyState = &assembly, .pViewportState = &viewport, .pRasterizationState = &raster,
        .pMultisampleState = &samples, .pDepthStencilState = &depth, .pColorBlendState = &blend, .pDynamicState = &dynamic,
        .layout = s->layouts[s->shared[k]], .renderPass = s->passes[p->pass], .subpass = p->subpass, .basePipelineIndex = -1};
    MUST(call, &s->device->vk, CreateGraphicsPipelines, s->device->device, s->cache.handle, 1, &info, NULL, s->pipelines + k);
}

static void create_compute(Session *s, Call *call, uint32_t k) {
    const Vulkan *vk = &s->device->vk;
    const Compute *c = s->v->computes + k;
    uint32_t n = c->binding_count + c->output_count;
    VkDescriptorSetLayoutBinding *bindings = spare(s, call, n, sizeof *bindings);
    for (uint32_t b = 0; b < n; b++)
        bindings[b] = (VkDescriptorSetLayoutBinding){b, b < c->binding_count ? (VkDescriptorType)c->bindings[b].kind :
            VK_DESCRIPTOR_TYPE_STORAGE_IMAGE, 1, VK_SHADER_STAGE_COMPUTE_BIT, NULL};
    VkDescriptorSetLayoutCreateInfo set = {TYPE(DESCRIPTOR_SET_LAYOUT_CREATE_INFO), .bindingCount = n, .pBindings = bindings};
    MUST(call, vk, CreateDescriptorSetLayout, s->device->device, &set, NULL, s->compute_sets + k);
    VkPipelineLayoutCreateInfo layout = {TYPE(PIPELINE_LAYOUT_CREATE_INFO), .setLayoutCount = 1, .pSetLayouts = s->compute_sets + k};
    MUST(call, vk, CreatePipelineLayout, s->device->device, &layout, NULL, s->compute_layouts + k);
    VkComputePipelineCreateInfo info = {TYPE(COMPUTE_PIPELINE_CREATE_INFO), .layout = s->compute_layouts[k], .basePipelineIndex = -1,
        .stage = {TYPE(PIPELINE_SHADER_STAGE_CREATE_INFO), .pName = "main", .stage = VK_SHADER_STAGE_COMPUTE_BIT,
                  .module = s->modules[c->shader]}};
    MUST(call, vk, CreateComputePipelines, s->device->device, s->cache.handle, 1, &info, NULL, s->computes + k);
}

void create_pipelines(Session *s, Call *call) {
    const Vulkan *vk = &s->device->vk;
    const Variant *v = s->v;
    Arena *arena = &s->bundle.arena;
    s->samplers = grow(call, arena, v->samplers.count, sizeof *s->samplers);
    s->modules = grow(call, arena, v->shaders.count, sizeof *s->modules);
    s->passes = grow(call, arena, v->pass_count, sizeof *s->passes);
    s->set_layouts = grow(call, arena, v->pipeline_count, sizeof *s->set_layouts);
    s->layouts = grow(call, arena, v->pipeline_count, sizeof *s->layouts);
    s->shared = grow(call, arena, v->pipeline_count, sizeof *s->shared);
    s->pipelines = grow(call, arena, v->pipeline_count, sizeof *s->pipelines);
    s->compute_sets = grow(call, arena, v->compute_count, sizeof *s->compute_sets);
    s->compute_layouts = grow(call, arena, v->compute_count, sizeof *s->compute_layouts);
    s->computes = grow(call, arena, v->compute_count, sizeof *s->computes);
    for (uint32_t k = 0; k < v->shaders.count; k++) {
        const Blob *blob = s->bundle.blobs + v->shaders.at[k];
        uint32_t *code = spare(s, call, blob->size / 4, 4); /* aligned, whatever the file in memory is */
        memcpy(code, blob_data(&s->bundle, v->shaders.at[k]), blob->size);
        VkShaderModuleCreateInfo info = {TYPE(SHADER_MODULE_CREATE_INFO), .codeSize = blob->size, .pCode = code};
        MUST(call, vk, CreateShaderModule, s->device->device, &info, NULL, s->modules + k);
    }
    for (uint32_t k = 0; k < v->samplers.count; k++) {
        VkSamplerAddressMode mode = (VkSamplerAddressMode)v->samplers.at[k];
        VkSamplerCreateInfo info = {TYPE(SAMPLER_CREATE_INFO), .magFilter = VK_FILTER_LINEAR, .minFilter = VK_FILTER_LINEAR,
                                    .addressModeU = mode, .addressModeV = mode, .addressModeW = mode};
        MUST(call, vk, CreateSampler, s->device->device, &info, NULL, s->samplers + k);
    }
    for (uint32_t k = 0; k < v->pass_count; k++) create_pass(s, call, v->passes + k, s->passes + k);
    create_layouts(s, call);
    for (uint32_t k = 0; k < v->pipeline_count; k++) create_pipeline(s, call, k);
    for (uint32_t k = 0; k < v->compute_count; k++) create_compute(s, call, k);
}

/* What was never made is a null handle, which Vulkan ignores; arrays that were never made are NULL. */
void destroy_objects(Session *s) {
    const Vulkan *vk = &s->device->vk;
    VkDevice device = s->device->device;
    const Variant *v = s->v;
    for (uint32_t k = 0; s->plans && k < v->plan_count; k++) destroy_recordings(s, k);
    for (uint32_t k = 0; s->pipelines && k < v->pipeline_count; k++) {
        vk->DestroyPipeline(device, s->pipelines[k], NULL);
        vk->DestroyPipelineLayout(device, s->layouts[k], NULL);
        vk->DestroyDescriptorSetLayout(device, s->set_layouts[k], NULL);
    }
    for (uint32_t k = 0; s->computes && k < v->compute_count; k++) {
        vk->DestroyPipeline(device, s->computes[k], NULL);
        vk->DestroyPipelineLayout(device, s->compute_layouts[k], NULL);
        vk->DestroyDescriptorSetLayout(device, s->compute_sets[k], NULL);
    }
    for (uint32_t k = 0; s->passes && k < v->pass_count; k++) vk->DestroyRenderPass(device, s->passes[k], NULL);
    for (uint32_t k = 0; s->samplers && k < v->samplers.count; k++) vk->DestroySampler(device, s->samplers[k], NULL);
    for (uint32_t k = 0; s->modules && k < v->shaders.count; k++) vk->DestroyShaderModule(device, s->modules[k], NULL);
    close_cache(s);
    for (uint32_t k = 0; s->views && k < 2 * v->image_count; k++) {
        vk->DestroyImageView(device, s->views[k / 2][k % 2], NULL);
        vk->DestroyImage(device, s->images[k / 2][k % 2], NULL);
    }
    for (uint32_t k = 0; k < VK_MAX_MEMORY_TYPES; k++) vk->FreeMemory(device, s->memory[k], NULL);
    vk->DestroyBuffer(device, s->staging.buffer, NULL);
    vk->FreeMemory(device, s->staging.memory, NULL);
    vk->DestroyFence(device, s->fence, NULL);
    vk->DestroyCommandPool(device, s->pool, NULL);
}
