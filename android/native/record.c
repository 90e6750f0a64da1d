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

static VkDescriptorSet make_set(const Tape *t, const Draw *draw) {
    Session *s = t->s;
    const Pipeline *p = s->v->pipelines + draw->pipeline;
    VkDescriptorSet set;
    VkDescriptorSetAllocateInfo info = {TYPE(DESCRIPTOR_SET_ALLOCATE_INFO), .descriptorPool = t->made->sets, .descriptorSetCount = 1,
                                        .pSetLayouts = s->set_layouts + s->shared[draw->pipeline]};
    MUST(t->call, &s->device->vk, AllocateDescriptorSets, s->device->device, &info, &set);
    for (uint32_t b = 0; b < p->binding_count; b++) {
        const Binding *binding = p->bindings + b;
        VkSampler sampler = binding->kind == 1 ? s->samplers[binding->sampler] : VK_NULL_HANDLE;
        VkDescriptorImageInfo image = {sampler, view_of(t, draw->images.at[b]), VK_IMAGE_LAYOUT_GENERAL};
        VkWriteDescriptorSet write = {TYPE(WRITE_DESCRIPTOR_SET), .dstSet = set, .dstBinding = b, .descriptorCount = 1,
                                      .descriptorType = (VkDescriptorType)binding->kind, .pImageInfo = &image};
        s->device->vk.UpdateDescriptorSets(s->device->device, 1, &write, 0, NULL);
    }
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

/* Copies what the counts of this stage's draws are into their commands. */
static void copy_counts(Tape *t, const Stage *stage) {
    const Vulkan *vk = &t->s->device->vk;
    bool copied = false;
    for (uint32_t j = 0; j < t->s->v->passes[stage->pass].subpass_count; j++)
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

static void record_stage(Tape *t, uint32_t k) {
    Session *s = t->s;
    const Vulkan *vk = &s->device->vk;
    const Stage *stage = t->plan->stages + k;
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
                                    {VK_DESCRIPTOR_TYPE_INPUT_ATTACHMENT, 1}};
    uint32_t sets = 1;
    for (uint32_t k = 0; k < t->plan->stage_count; k++)
        for (uint32_t j = 0; j < v->passes[t->plan->stages[k].pass].subpass_count; j++)
            for (uint32_t d = 0; d < t->plan->stages[k].subpasses[j].count; d++, sets++) {
                const Pipeline *p = v->pipelines + t->plan->stages[k].subpasses[j].draws[d].pipeline;
                for (uint32_t b = 0; b < p->binding_count; b++)
                    sizes[p->bindings[b].kind == 1 ? 0 : p->bindings[b].kind == 2 ? 1 : 2].descriptorCount++;
            }
    VkDescriptorPoolCreateInfo info = {TYPE(DESCRIPTOR_POOL_CREATE_INFO), .maxSets = sets, .poolSizeCount = 3, .pPoolSizes = sizes};
    MUST(t->call, &t->s->device->vk, CreateDescriptorPool, t->s->device->device, &info, NULL, &t->made->sets);
}

static void create_counts(const Tape *t) {
    Session *s = t->s;
    const Vulkan *vk = &s->device->vk;
    VkDevice device = s->device->device;
    uint32_t count = 0;
    for (uint32_t k = 0; k < t->plan->stage_count; k++)
        for (uint32_t j = 0; j < s->v->passes[t->plan->stages[k].pass].subpass_count; j++)
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
    for (uint32_t k = 0; k < count; k++) ((VkDrawIndirectCommand *)view)[k] = (VkDrawIndirectCommand){0, 1, 0, 0};
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
