/* One plan as a command buffer, for one choice of current slots of the states; submitted any number of times. */

#include "session.h"

#include <stdlib.h>
#include <string.h>

enum { COMMAND = sizeof(VkDrawIndirectCommand) };

/* What recording one plan needs to know. */
typedef struct Tape {
    Session *s;
    Call *call;
    const Plan *plan;
    Recording *made;
    uint8_t *parity; /* by image */
    uint32_t used;   /* draw commands of `counts` */
} Tape;

static uint32_t slot_of(const Tape *t, uint32_t ref) {
    return t->s->v->images[ref / 2].slots == 2 ? (ref & 1) ^ t->parity[ref / 2] : 0;
}

static VkImageView view_of(const Tape *t, uint32_t ref) { return t->s->views[ref / 2][slot_of(t, ref)]; }

static VkDescriptorSet new_set(const Tape *t, const VkDescriptorSetLayout *layout) {
    VkDescriptorSet set;
    VkDescriptorSetAllocateInfo info = {TYPE(DESCRIPTOR_SET_ALLOCATE_INFO), .descriptorPool = t->made->sets, .descriptorSetCount = 1,
                                        .pSetLayouts = layout};
    MUST(t->call, &t->s->device->vk, AllocateDescriptorSets, t->s->device->device, &info, &set);
    return set;
}

static void bind_image(const Tape *t, VkDescriptorSet set, uint32_t number, uint32_t kind, VkSampler sampler, uint32_t ref) {
    VkDescriptorImageInfo image = {sampler, view_of(t, ref), VK_IMAGE_LAYOUT_GENERAL};
    VkWriteDescriptorSet write = {TYPE(WRITE_DESCRIPTOR_SET), .dstSet = set, .dstBinding = number, .descriptorCount = 1,
                                  .descriptorType = (VkDescriptorType)kind, .pImageInfo = &image};
    t->s->device->vk.UpdateDescriptorSets(t->s->device->device, 1, &write, 0, NULL);
}

/* Binds what is read. */
static void bind_images(const Tape *t, VkDescriptorSet set, const Binding *bindings, uint32_t count, Indices images) {
    for (uint32_t b = 0; b < count; b++)
        bind_image(t, set, b, bindings[b].kind, bindings[b].kind == 1 ? t->s->samplers[bindings[b].sampler] : VK_NULL_HANDLE, images.at[b]);
}

static VkDescriptorSet make_set(const Tape *t, const Draw *draw) {
    const Pipeline *p = t->s->v->pipelines + draw->pipeline;
    VkDescriptorSet set = new_set(t, t->s->set_layouts + t->s->shared[draw->pipeline]);
    bind_images(t, set, p->bindings, p->binding_count, draw->images);
    return set;
}

static void record_draw(Tape *t, const Draw *draw, uint32_t *counted) {
    const Vulkan *vk = &t->s->device->vk;
    VkCommandBuffer c = t->made->commands;
    vk->CmdBindPipeline(c, VK_PIPELINE_BIND_POINT_GRAPHICS, t->s->pipelines[draw->pipeline]);
    if (draw->images.count) {
        VkDescriptorSet set = make_set(t, draw);
        vk->CmdBindDescriptorSets(c, VK_PIPELINE_BIND_POINT_GRAPHICS, t->s->layouts[t->s->shared[draw->pipeline]], 0, 1, &set, 0, NULL);
    }
    for (uint32_t k = 0; k < draw->cell_count; k++) {
        const uint32_t *cell = draw->cells[k];
        VkViewport viewport = {(float)cell[0], (float)cell[1], (float)cell[2], (float)cell[3], draw->near, draw->far};
        VkRect2D scissor = {{(int32_t)cell[0], (int32_t)cell[1]}, {cell[2], cell[3]}};
        vk->CmdSetViewport(c, 0, 1, &viewport);
        vk->CmdSetScissor(c, 0, 1, &scissor);
        if (draw->count >= 0) vk->CmdDrawIndirect(c, t->made->counts, COMMAND * (VkDeviceSize)(*counted)++, 1, COMMAND);
        else vk->CmdDraw(c, draw->vertices, 1, 0, k);
    }
}

/* Copies what the counts of this stage's draws, or of its dispatch, are into their commands. */
static void copy_counts(Tape *t, const Stage *stage) {
    const Vulkan *vk = &t->s->device->vk;
    bool copied = false;
    for (uint32_t j = 0; j < stage->subpass_count; j++)
        for (uint32_t d = 0; d < stage->subpasses[j].count; d++) {
            int64_t ref = stage->subpasses[j].draws[d].count;
            if (ref < 0) continue;
            const Image *image = t->s->v->images + ref / 2;
            VkBufferImageCopy copy = {COMMAND * (VkDeviceSize)t->used++, 0, 0, {VK_IMAGE_ASPECT_COLOR_BIT, 0, 0, 1},
                                      {(int32_t)image->width - 1, (int32_t)image->height - 1, 0}, {1, 1, 1}};
            vk->CmdCopyImageToBuffer(t->made->commands, t->s->images[ref / 2][slot_of(t, (uint32_t)ref)], VK_IMAGE_LAYOUT_GENERAL,
                                     t->made->counts, 1, &copy);
            copied = true;
        }
    VkMemoryBarrier seen = {TYPE(MEMORY_BARRIER), .srcAccessMask = VK_ACCESS_TRANSFER_WRITE_BIT,
                            .dstAccessMask = VK_ACCESS_INDIRECT_COMMAND_READ_BIT};
    if (copied) vk->CmdPipelineBarrier(t->made->commands, VK_PIPELINE_STAGE_TRANSFER_BIT, VK_PIPELINE_STAGE_DRAW_INDIRECT_BIT, 0, 1, &seen,
                                       0, NULL, 0, NULL);
}

/* Clears the outputs that are to be; then the workgroups. */
static void record_dispatch(Tape *t, const Stage *stage) {
    Session *s = t->s;
    const Vulkan *vk = &s->device->vk;
    const Compute *compute = s->v->computes + stage->compute;
    VkCommandBuffer c = t->made->commands;
    VkDeviceSize at = COMMAND * (VkDeviceSize)t->used;
    VkImageSubresourceRange whole = {VK_IMAGE_ASPECT_COLOR_BIT, 0, 1, 0, 1};
    bool cleared = false;
    if (stage->wait) barrier(s, c);
    for (uint32_t k = 0; k < compute->output_count; k++) {
        if (compute->outputs[k].load != 1) continue;
        uint32_t ref = stage->attachments.at[k];
        VkClearColorValue value;
        for (int channel = 0; channel < 4; channel++) value.int32[channel] = compute->outputs[k].clear;
        vk->CmdClearColorImage(c, s->images[ref / 2][slot_of(t, ref)], VK_IMAGE_LAYOUT_GENERAL, &value, 1, &whole);
        cleared = true;
    }
    copy_counts(t, stage);
    if (cleared) barrier(s, c);
    VkDescriptorSet set = new_set(t, s->compute_sets + stage->compute);
    bind_images(t, set, compute->bindings, compute->binding_count, stage->subpasses->draws->images);
    for (uint32_t k = 0; k < compute->output_count; k++)
        bind_image(t, set, compute->binding_count + k, VK_DESCRIPTOR_TYPE_STORAGE_IMAGE, VK_NULL_HANDLE, stage->attachments.at[k]);
    vk->CmdBindPipeline(c, VK_PIPELINE_BIND_POINT_COMPUTE, s->computes[stage->compute]);
    vk->CmdBindDescriptorSets(c, VK_PIPELINE_BIND_POINT_COMPUTE, s->compute_layouts[stage->compute], 0, 1, &set, 0, NULL);
    if (stage->subpasses->draws->count >= 0) vk->CmdDispatchIndirect(c, t->made->counts, at);
    else vk->CmdDispatch(c, stage->groups[0], stage->groups[1], stage->groups[2]);
}

static void record_stage(Tape *t, uint32_t k) {
    Session *s = t->s;
    const Vulkan *vk = &s->device->vk;
    const Stage *stage = t->plan->stages + k;
    if (stage->compute >= 0) {
        record_dispatch(t, stage);
        return;
    }
    const Pass *pass = s->v->passes + stage->pass;
    VkCommandBuffer c = t->made->commands;
    uint32_t n = pass->attachment_count, counted = t->used;
    VkImageView *views = spare(s, t->call, n, sizeof *views);
    VkClearValue *clears = spare(s, t->call, n, sizeof *clears);
    for (uint32_t a = 0; a < n; a++) {
        views[a] = view_of(t, stage->attachments.at[a]);
        int clear = pass->attachments[a].clear;
        if (!pass->attachments[a].format) clears[a].depthStencil.depth = (float)clear;
        else for (int channel = 0; channel < 4; channel++) clears[a].color.int32[channel] = clear;
    }
    VkFramebufferCreateInfo framebuffer = {TYPE(FRAMEBUFFER_CREATE_INFO), .renderPass = s->passes[stage->pass], .attachmentCount = n,
                                           .pAttachments = views, .width = stage->width, .height = stage->height, .layers = 1};
    MUST(t->call, vk, CreateFramebuffer, s->device->device, &framebuffer, NULL, t->made->framebuffers + k);
    if (stage->wait) barrier(s, c);
    copy_counts(t, stage);
    VkRenderPassBeginInfo begin = {TYPE(RENDER_PASS_BEGIN_INFO), .renderPass = s->passes[stage->pass],
        .framebuffer = t->made->framebuffers[k],
                                   .renderArea = {{0, 0}, {stage->width, stage->height}}, .clearValueCount = n, .pClearValues = clears};
    vk->CmdBeginRenderPass(c, &begin, VK_SUBPASS_CONTENTS_INLINE);
    for (uint32_t j = 0; j < pass->subpass_count; j++) {
        if (j) vk->CmdNextSubpass(c, VK_SUBPASS_CONTENTS_INLINE);
        for (uint32_t d = 0; d < stage->subpasses[j].count; d++) record_draw(t, stage->subpasses[j].draws + d, &counted);
    }
    vk->CmdEndRenderPass(c);
}

/* ---- What a recording holds ---- */

static void create_sets(const Tape *t) {
    const Variant *v = t->s->v;
    VkDescriptorPoolSize sizes[] = {{VK_DESCRIPTOR_TYPE_COMBINED_IMAGE_SAMPLER, 1}, {VK_DESCRIPTOR_TYPE_SAMPLED_IMAGE, 1},
                                    {VK_DESCRIPTOR_TYPE_INPUT_ATTACHMENT, 1}, {VK_DESCRIPTOR_TYPE_STORAGE_IMAGE, 1}};
    uint32_t sets = 1;
    for (uint32_t k = 0; k < t->plan->stage_count; k++) {
        const Stage *stage = t->plan->stages + k;
        const Compute *compute = stage->compute < 0 ? NULL : v->computes + stage->compute;
        for (uint32_t j = 0; j < stage->subpass_count; j++)
            for (uint32_t d = 0; d < stage->subpasses[j].count; d++, sets++) {
                const Pipeline *p = compute ? NULL : v->pipelines + stage->subpasses[j].draws[d].pipeline;
                const Binding *bindings = compute ? compute->bindings : p->bindings;
                for (uint32_t b = 0; b < (compute ? compute->binding_count : p->binding_count); b++)
                    sizes[bindings[b].kind == 1 ? 0 : bindings[b].kind == 2 ? 1 : 2].descriptorCount++;
            }
        if (compute) sizes[3].descriptorCount += compute->output_count;
    }
    VkDescriptorPoolCreateInfo info = {TYPE(DESCRIPTOR_POOL_CREATE_INFO), .maxSets = sets, .poolSizeCount = v->compute_count ? 4 : 3,
                                       .pPoolSizes = sizes};
    MUST(t->call, &t->s->device->vk, CreateDescriptorPool, t->s->device->device, &info, NULL, &t->made->sets);
}

static void create_counts(const Tape *t) {
    Session *s = t->s;
    const Vulkan *vk = &s->device->vk;
    VkDevice device = s->device->device;
    uint32_t count = 0;
    for (uint32_t k = 0; k < t->plan->stage_count; k++)
        for (uint32_t j = 0; j < t->plan->stages[k].subpass_count; j++)
            for (uint32_t d = 0; d < t->plan->stages[k].subpasses[j].count;
                d++) count += t->plan->stages[k].subpasses[j].draws[d].count >= 0;
    if (!count) return;
    VkBufferCreateInfo info = {TYPE(BUFFER_CREATE_INFO), .size = COMMAND * (VkDeviceSize)count,
                               .usage = VK_BUFFER_USAGE_INDIRECT_BUFFER_BIT | VK_BUFFER_USAGE_TRANSFER_DST_BIT};
    MUST(t->call, vk, CreateBuffer, device, &info, NULL, &t->made->counts);
    VkMemoryRequirements needs;
    vk->GetBufferMemoryRequirements(device, t->made->counts, &needs);
    uint32_t kind = memory_type(t->call, s->device, needs.memoryTypeBits,
        VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT | VK_MEMORY_PROPERTY_HOST_COHERENT_BIT);
    VkMemoryAllocateInfo memory = {TYPE(MEMORY_ALLOCATE_INFO), .allocationSize = needs.size, .memoryTypeIndex = kind};
    MUST(t->call, vk, AllocateMemory, device, &memory, NULL, &t->made->count_memory);
    MUST(t->call, vk, BindBufferMemory, device, t->made->counts, t->made->count_memory, 0);
    void *view;
    MUST(t->call, vk, MapMemory, device, t->made->count_memory, 0, VK_WHOLE_SIZE, 0, &view);
    count = 0;
    for (uint32_t k = 0; k < t->plan->stage_count; k++) { /* a dispatch's command is x, y, z */
        const Stage *stage = t->plan->stages + k;
        for (uint32_t j = 0; j < stage->subpass_count; j++)
            for (uint32_t d = 0; d < stage->subpasses[j].count; d++)
                if (stage->subpasses[j].draws[d].count >= 0)
                    ((VkDrawIndirectCommand *)view)[count++] = stage->compute < 0 ? (VkDrawIndirectCommand){0, 1, 0, 0} :
                        (VkDrawIndirectCommand){0, stage->groups[1], stage->groups[2], 0};
    }
}

static void destroy(Session *s, Recording *made, uint32_t stages) {
    const Vulkan *vk = &s->device->vk;
    VkDevice device = s->device->device;
    if (made->commands) vk->FreeCommandBuffers(device, s->pool, 1, &made->commands);
    vk->DestroyDescriptorPool(device, made->sets, NULL);
    vk->DestroyBuffer(device, made->counts, NULL);
    vk->FreeMemory(device, made->count_memory, NULL);
    for (uint32_t k = 0; made->framebuffers && k < stages; k++) vk->DestroyFramebuffer(device, made->framebuffers[k], NULL);
    free(made->framebuffers);
    free(made->parity);
    free(made);
}

void destroy_recordings(Session *s, uint32_t plan) {
    while (s->plans[plan].recordings) {
        Recording *next = s->plans[plan].recordings->next;
        destroy(s, s->plans[plan].recordings, s->v->plans[plan].stage_count);
        s->plans[plan].recordings = next;
    }
}

static void record(Tape *t) {
    Session *s = t->s;
    VkCommandBufferAllocateInfo info = {TYPE(COMMAND_BUFFER_ALLOCATE_INFO), .commandPool = s->pool, .commandBufferCount = 1};
    VkCommandBufferBeginInfo begin = {TYPE(COMMAND_BUFFER_BEGIN_INFO), .flags = VK_COMMAND_BUFFER_USAGE_SIMULTANEOUS_USE_BIT};
    create_sets(t);
    create_counts(t);
    MUST(t->call, &s->device->vk, AllocateCommandBuffers, s->device->device, &info, &t->made->commands);
    MUST(t->call, &s->device->vk, BeginCommandBuffer, t->made->commands, &begin);
    for (uint32_t k = 0; k < t->plan->stage_count; k++) record_stage(t, k);
    MUST(t->call, &s->device->vk, EndCommandBuffer, t->made->commands);
}

VkCommandBuffer recording(Session *s, Call *call, uint32_t plan, bool flipped) {
    PlanState *state = s->plans + plan;
    const Plan *description = s->v->plans + plan;
    uint8_t *parity = spare(s, call, s->v->image_count, 1), *key = spare(s, call, state->slots.count, 1);
    memcpy(parity, s->parity, s->v->image_count);
    for (uint32_t k = 0; flipped && k < description->updates.count; k++) parity[s->v->values[description->updates.at[k]].image] ^= 1;
    for (uint32_t k = 0; k < state->slots.count; k++) key[k] = parity[state->slots.at[k]];
    for (Recording *r = state->recordings; r; r = r->next)
        if (!memcmp(r->parity, key, state->slots.count)) return r->commands;

    Call inner;
    Recording *made = calloc(1, sizeof *made);
    if (made) {
        made->parity = malloc(state->slots.count + 1);
        made->framebuffers = calloc(description->stage_count + 1, sizeof *made->framebuffers);
    }
    if (!made || !made->parity || !made->framebuffers) {
        if (made) destroy(s, made, 0);
        fail(call, DRESSI_MEMORY, "no memory to record %s", description->name);
    }
    memcpy(made->parity, key, state->slots.count);
    if (setjmp(inner.out)) {
        destroy(s, made, description->stage_count);
        fail(call, inner.error.code, "%s", inner.error.text);
    }
    Tape tape = {s, &inner, description, made, parity, 0};
    record(&tape);
    made->next = state->recordings;
    state->recordings = made;
    return made->commands;
}
