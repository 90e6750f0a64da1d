/* Which variant of a bundle runs: the first that the device can play. What it does is counted anew, then what it says it needs, then
   its memory: dressi_edge/cache/verify.py and runtime/fit.py in C, in their order and words. */

#include "gpu.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { SHOWN_LINES = 3, LINE = 300 };

/* What does not fit: how many lines, and the first of them. */
typedef struct Count {
    Call *call;
    Arena *arena;
    const dressi_device *device;
    const Variant *v;
    const char *name; /* of the device */
    uint32_t lines;
    char line[SHOWN_LINES][LINE];
    struct { uint32_t plan, stage, subpass; bool known; } *pass_at, *pipeline_at, *compute_at; /* where each is used first */
    bool *filtered;                                                               /* by image */
} Count;

#define LINE_OF(c, ...) ((c)->lines++ < SHOWN_LINES ? (void)snprintf((c)->line[(c)->lines - 1], LINE, __VA_ARGS__) : (void)0)

static void limit(Count *c, const char *where, uint64_t found, const char *what, uint32_t allowed, const char *name) {
    if (found > allowed)
        LINE_OF(c, "%s needs %llu %s; profile %s allows %u (%s)", where, (unsigned long long)found, what, c->name, allowed, name);
}
#define LIMIT(c, where, found, what, name) limit(c, where, found, what, (c)->device->properties.limits.name, #name)

static void find_places(Count *c) {
    const Variant *v = c->v;
    c->pass_at = grow(c->call, c->arena, v->pass_count, sizeof *c->pass_at);
    c->pipeline_at = grow(c->call, c->arena, v->pipeline_count, sizeof *c->pipeline_at);
    c->compute_at = grow(c->call, c->arena, v->compute_count, sizeof *c->compute_at);
    c->filtered = grow(c->call, c->arena, v->image_count, 1);
    for (uint32_t p = 0; p < v->plan_count; p++)
        for (uint32_t s = 0; s < v->plans[p].stage_count; s++) {
            const Stage *stage = v->plans[p].stages + s;
            if (stage->compute >= 0) {
                const Indices images = stage->subpasses->draws->images;
                if (!c->compute_at[stage->compute].known) {
                    c->compute_at[stage->compute].plan = p, c->compute_at[stage->compute].stage = s;
                    c->compute_at[stage->compute].known = true;
                }
                for (uint32_t k = 0; k < images.count; k++)
                    if (v->computes[stage->compute].bindings[k].kind == 1) c->filtered[images.at[k] / 2] = true;
                continue;
            }
            if (!c->pass_at[stage->pass].known) {
                c->pass_at[stage->pass].plan = p, c->pass_at[stage->pass].stage = s;
                c->pass_at[stage->pass].known = true;
            }
            for (uint32_t j = 0; j < v->passes[stage->pass].subpass_count; j++)
                for (uint32_t d = 0; d < stage->subpasses[j].count; d++) {
                    const Draw *draw = stage->subpasses[j].draws + d;
                    if (!c->pipeline_at[draw->pipeline].known) {
                        c->pipeline_at[draw->pipeline].plan = p, c->pipeline_at[draw->pipeline].stage = s;
                        c->pipeline_at[draw->pipeline].subpass = j, c->pipeline_at[draw->pipeline].known = true;
                    }
                    for (uint32_t k = 0; k < draw->images.count; k++)
                        if (v->pipelines[draw->pipeline].bindings[k].kind == 1) c->filtered[draw->images.at[k] / 2] = true;
                }
        }
}

/* ---- Images ---- */

static const struct { const char *name; VkFormatFeatureFlags bit; } FORMAT_FEATURES[] = { /* sorted, and all that a profile knows */
    {"blend", VK_FORMAT_FEATURE_COLOR_ATTACHMENT_BLEND_BIT}, {"color", VK_FORMAT_FEATURE_COLOR_ATTACHMENT_BIT},
    {"depth", VK_FORMAT_FEATURE_DEPTH_STENCIL_ATTACHMENT_BIT}, {"filter", VK_FORMAT_FEATURE_SAMPLED_IMAGE_FILTER_LINEAR_BIT},
    {"sampled", VK_FORMAT_FEATURE_SAMPLED_IMAGE_BIT}, {"storage", VK_FORMAT_FEATURE_STORAGE_IMAGE_BIT}};

static const char *feature_words(const Count *c, uint32_t format, char buffer[64]) {
    VkFormatFeatureFlags flags = features_of(c->device, (VkFormat)format);
    buffer[0] = 0;
    for (size_t k = 0; k < COUNT(FORMAT_FEATURES); k++)
        if (flags & FORMAT_FEATURES[k].bit) {
            if (*buffer) strcat(buffer, " ");
            strcat(buffer, FORMAT_FEATURES[k].name);
        }
    return *buffer ? buffer : strcpy(buffer, "nothing");
}

static void count_feature(Count *c, uint32_t k, VkFormatFeatureFlags wanted, const char *feature) {
    char words[64];
    uint32_t format = c->v->images[k].format;
    if (!(features_of(c->device, (VkFormat)format) & wanted))
        LINE_OF(c, "images[%u] needs %s with %s; profile %s has %s", k, format_name(format), feature, c->name, feature_words(c, format,
            words));
}

static const char *depth_name(uint32_t format) { return format == 126 ? "D32_SFLOAT" : "X8_D24_UNORM_PACK32"; }

static void count_depth(Count *c) {
    Indices offered = c->v->depth_formats;
    char words[256] = "";
    bool able = false, both[2];
    for (uint32_t k = 0; k < offered.count; k++) {
        able |= (features_of(c->device, (VkFormat)offered.at[k]) & VK_FORMAT_FEATURE_DEPTH_STENCIL_ATTACHMENT_BIT) != 0;
        if (k < 8) snprintf(words + strlen(words), sizeof words - strlen(words), "%s%s", k ? " " : "", depth_name(offered.at[k]));
    }
    for (int k = 0; k < 2; k++) both[k] = features_of(c->device, k ? 125 : 126) & VK_FORMAT_FEATURE_DEPTH_STENCIL_ATTACHMENT_BIT;
    bool certain = both[0] || both[1], promised = certain ? has(offered, both[0] ? 126 : 125) : has(offered, 126) && has(offered, 125);
    if (!able && !promised)
        LINE_OF(c, "depth_formats needs a depth attachment, of %s; profile %s promises one of %s", *words ? words : "none", c->name,
                certain ? depth_name(both[0] ? 126 : 125) : "D32_SFLOAT X8_D24_UNORM_PACK32");
}

static void count_images(Count *c) {
    const Variant *v = c->v;
    bool kinds[128][256] = {{0}}, depth = false;
    uint32_t kind_count = 0;
    for (uint32_t k = 0; k < v->image_count; k++) {
        const Image *image = v->images + k;
        char where[24];
        snprintf(where, sizeof where, "images[%u]", k);
        LIMIT(c, where, image->width > image->height ? image->width : image->height, "texels a side", maxImageDimension2D);
        if (image->format && image->usage & 4) count_feature(c, k, VK_FORMAT_FEATURE_SAMPLED_IMAGE_BIT, "sampled");
        if (image->format && image->usage & (16 | 128)) count_feature(c, k, VK_FORMAT_FEATURE_COLOR_ATTACHMENT_BIT, "color");
        if (image->format && image->usage & 8) count_feature(c, k, VK_FORMAT_FEATURE_STORAGE_IMAGE_BIT, "storage");
        if (image->format && c->filtered[k]) count_feature(c, k, VK_FORMAT_FEATURE_SAMPLED_IMAGE_FILTER_LINEAR_BIT, "filter");
        depth |= !image->format;
        kind_count += !kinds[image->format][image->usage];
        kinds[image->format][image->usage] = true;
    }
    if (depth) count_depth(c);
    LIMIT(c, "samplers", v->samplers.count, "samplers", maxSamplerAllocationCount);
    if (kind_count > VK_MAX_MEMORY_TYPES) kind_count = VK_MAX_MEMORY_TYPES; /* a session allocates once a type, and once for transfers */
    LIMIT(c, "images", kind_count + 1, "memory allocations", maxMemoryAllocationCount);
}

/* ---- Passes, pipelines, stages ---- */

static void count_pass(Count *c, uint32_t k) {
    const Pass *pass = c->v->passes + k;
    for (uint32_t j = 0; j < pass->subpass_count; j++) {
        char at[LINE] = "unused", where[LINE];
        if (c->pass_at[k].known) snprintf(at, sizeof at, "%.200s.stages[%u]", c->v->plans[c->pass_at[k].plan].name, c->pass_at[k].stage);
        snprintf(where, sizeof where, "%.240s.subpasses[%u] (pass %u)", at, j, k);
        uint32_t colors = pass->subpasses[j].colors.count;
        LIMIT(c, where, colors, "colour attachments", maxColorAttachments);
        LIMIT(c, where, colors, "fragment outputs", maxFragmentOutputAttachments);
        LIMIT(c, where, colors, "fragment output resources", maxFragmentCombinedOutputResources);
    }
}

static void count_pipeline(Count *c, uint32_t k) {
    const Variant *v = c->v;
    const Pipeline *p = v->pipelines + k;
    char at[LINE] = "unused", where[LINE];
    if (c->pipeline_at[k].known)
        snprintf(at, sizeof at, "%.200s.stages[%u].subpasses[%u]", v->plans[c->pipeline_at[k].plan].name, c->pipeline_at[k].stage,
                 c->pipeline_at[k].subpass);
    snprintf(where, sizeof where, "%.260s (pipeline %u)", at, k);
    LIMIT(c, where, p->binding_count > 0, "descriptor sets", maxBoundDescriptorSets);
    uint32_t counts[3][4] = {{0}}; /* of the set, the vertex and the fragment shader: samplers, images, attachments, all */
    for (uint32_t b = 0; b < p->binding_count; b++)
        for (int stage = 0; stage < 3; stage++) {
            uint32_t kind = p->bindings[b].kind;
            if (stage && !(p->bindings[b].stages & (stage == 1 ? 1u : 16u))) continue;
            counts[stage][0] += kind == 1, counts[stage][1] += kind != 10, counts[stage][2] += kind == 10, counts[stage][3]++;
        }
    LIMIT(c, where, counts[0][0], "samplers in its set", maxDescriptorSetSamplers);
    LIMIT(c, where, counts[0][1], "sampled images in its set", maxDescriptorSetSampledImages);
    LIMIT(c, where, counts[0][2], "input attachments in its set", maxDescriptorSetInputAttachments);
    for (int stage = 1; stage < 3; stage++) {
        const char *name = stage == 1 ? "vertex" : "fragment";
        char words[64];
        uint32_t colors = v->passes[p->pass].subpasses[p->subpass].colors.count;
        snprintf(words, sizeof words, "samplers in its %s shader", name);
        LIMIT(c, where, counts[stage][0], words, maxPerStageDescriptorSamplers);
        snprintf(words, sizeof words, "sampled images in its %s shader", name);
        LIMIT(c, where, counts[stage][1], words, maxPerStageDescriptorSampledImages);
        snprintf(words, sizeof words, "input attachments in its %s shader", name);
        LIMIT(c, where, counts[stage][2], words, maxPerStageDescriptorInputAttachments);
        snprintf(words, sizeof words, "resources in its %s shader", name);
        LIMIT(c, where, counts[stage][3] + (stage == 2 ? colors : 0), words, maxPerStageResources);
    }
    LIMIT(c, where, v->interfaces[p->vertex]->output_components, "vertex output components", maxVertexOutputComponents);
    LIMIT(c, where, v->interfaces[p->fragment]->input_components, "fragment input components", maxFragmentInputComponents);
}

/* A line if there is more along an axis than the limit allows. */
static void sizes(Count *c, const char *where, const uint32_t found[3], const char *what, const uint32_t allowed[3], const char *name) {
    if (found[0] > allowed[0] || found[1] > allowed[1] || found[2] > allowed[2])
        LINE_OF(c, "%s needs %u x %u x %u %s; profile %s allows %u x %u x %u (%s)", where, found[0], found[1], found[2], what, c->name,
                allowed[0], allowed[1], allowed[2], name);
}
#define SIZES(c, where, found, what, name) sizes(c, where, found, what, (c)->device->properties.limits.name, #name)

static void count_compute(Count *c, uint32_t k) {
    const Variant *v = c->v;
    const Compute *compute = v->computes + k;
    const Interface *shader = v->interfaces[compute->shader];
    char at[LINE] = "unused", where[LINE];
    if (c->compute_at[k].known)
        snprintf(at, sizeof at, "%.200s.stages[%u]", v->plans[c->compute_at[k].plan].name, c->compute_at[k].stage);
    snprintf(where, sizeof where, "%.260s (compute %u)", at, k);
    uint32_t samplers = 0, images = compute->binding_count, stored = compute->output_count;
    const uint32_t *n = shader->local_size;
    for (uint32_t b = 0; b < images; b++) samplers += compute->bindings[b].kind == 1;
    LIMIT(c, where, 1, "descriptor sets", maxBoundDescriptorSets);
    LIMIT(c, where, samplers, "samplers in its set", maxDescriptorSetSamplers);
    LIMIT(c, where, samplers, "samplers in its shader", maxPerStageDescriptorSamplers);
    LIMIT(c, where, images, "sampled images in its set", maxDescriptorSetSampledImages);
    LIMIT(c, where, images, "sampled images in its shader", maxPerStageDescriptorSampledImages);
    LIMIT(c, where, stored, "storage images in its set", maxDescriptorSetStorageImages);
    LIMIT(c, where, stored, "storage images in its shader", maxPerStageDescriptorStorageImages);
    LIMIT(c, where, images + stored, "resources in its shader", maxPerStageResources);
    SIZES(c, where, n, "invocations in a workgroup", maxComputeWorkGroupSize);
    LIMIT(c, where, (uint64_t)n[0] * n[1] * n[2], "invocations in a workgroup", maxComputeWorkGroupInvocations);
    LIMIT(c, where, shader->shared_bytes, "bytes of memory that a workgroup shares", maxComputeSharedMemorySize);
}

static void count_draw(Count *c, const char *where, const Draw *draw) {
    const VkPhysicalDeviceLimits *l = &c->device->properties.limits;
    for (uint32_t k = 0; k < draw->cell_count; k++) {
        const uint32_t *cell = draw->cells[k];
        if (cell[2] > l->maxViewportDimensions[0] || cell[3] > l->maxViewportDimensions[1]) {
            LINE_OF(c, "%s needs a viewport of %u x %u; profile %s allows %u x %u (maxViewportDimensions)", where, cell[2], cell[3],
                c->name,
                    l->maxViewportDimensions[0], l->maxViewportDimensions[1]);
            return;
        }
        uint32_t low = cell[0] < cell[1] ? cell[0] : cell[1], right = cell[0] + cell[2], bottom = cell[1] + cell[3];
        uint32_t high = right > bottom ? right : bottom;
        if ((float)low < l->viewportBoundsRange[0] || (float)high > l->viewportBoundsRange[1]) {
            LINE_OF(c, "%s needs a viewport from %u to %u; profile %s allows %g to %g (viewportBoundsRange)", where, low, high, c->name,
                    l->viewportBoundsRange[0], l->viewportBoundsRange[1]);
            return;
        }
    }
}

static void count_stage(Count *c, const char *where, const Stage *stage) {
    if (stage->compute >= 0) {
        SIZES(c, where, stage->groups, "workgroups", maxComputeWorkGroupCount);
        return;
    }
    LIMIT(c, where, stage->width, "pixels of framebuffer width", maxFramebufferWidth);
    LIMIT(c, where, stage->height, "pixels of framebuffer height", maxFramebufferHeight);
    for (uint32_t j = 0; j < c->v->passes[stage->pass].subpass_count; j++)
        for (uint32_t d = 0; d < stage->subpasses[j].count; d++) {
            char at[LINE];
            snprintf(at, sizeof at, "%.240s.subpasses[%u] (pipeline %u)", where, j, stage->subpasses[j].draws[d].pipeline);
            count_draw(c, at, stage->subpasses[j].draws + d);
        }
}

/* ---- What it says it needs; its memory; its depth format ---- */

static uint32_t limit_of(const dressi_device *device, int k) {
    const VkPhysicalDeviceLimits *l = &device->properties.limits;
    const uint32_t found[LIMIT_COUNT] = { /* as LIMIT_NAMES */
        l->maxColorAttachments, l->maxComputeSharedMemorySize, l->maxComputeWorkGroupInvocations, l->maxDescriptorSetInputAttachments,
        l->maxDescriptorSetSampledImages, l->maxDescriptorSetSamplers, l->maxDescriptorSetStorageImages,
        l->maxFragmentCombinedOutputResources, l->maxFragmentInputComponents, l->maxFragmentOutputAttachments, l->maxFramebufferHeight,
        l->maxFramebufferWidth, l->maxImageDimension2D, l->maxPerStageDescriptorInputAttachments, l->maxPerStageDescriptorSampledImages,
        l->maxPerStageDescriptorSamplers, l->maxPerStageDescriptorStorageImages, l->maxPerStageResources, l->maxVertexOutputComponents,
        l->subPixelPrecisionBits, l->subTexelPrecisionBits};
    return found[k];
}

static void compare_needs(Count *c) {
    static const VkFormatFeatureFlags bits[] = {VK_FORMAT_FEATURE_SAMPLED_IMAGE_BIT, VK_FORMAT_FEATURE_COLOR_ATTACHMENT_BIT,
                                                VK_FORMAT_FEATURE_SAMPLED_IMAGE_FILTER_LINEAR_BIT, VK_FORMAT_FEATURE_STORAGE_IMAGE_BIT};
    static const int sorted[] = {1, 2, 0, 3}; /* color filter sampled storage */
    for (int k = 0; k < FORMAT_COUNT; k++) {
        char wanted[64] = "", words[64];
        bool lacks = false;
        for (int j = 0; j < FEATURE_COUNT; j++) {
            if (!(c->v->needs_formats[k] >> sorted[j] & 1)) continue;
            lacks |= !(features_of(c->device, (VkFormat)FORMATS[k]) & bits[sorted[j]]);
            snprintf(wanted + strlen(wanted), sizeof wanted - strlen(wanted), "%s%s", *wanted ? " " : "", FEATURES[sorted[j]]);
        }
        if (lacks) LINE_OF(c, "%s: needs %s, %s has %s", FORMAT_NAMES[k], wanted, c->name, feature_words(c, FORMATS[k], words));
    }
    for (int k = 0; k < LIMIT_COUNT; k++)
        if (c->v->needs_limits[k] > limit_of(c->device, k))
            LINE_OF(c, "%s: needs %lld, %s has %u", LIMIT_NAMES[k], (long long)c->v->needs_limits[k], c->name, limit_of(c->device, k));
}

static void compare_memory(Count *c) {
    const VkPhysicalDeviceMemoryProperties *m = &c->device->memory;
    uint64_t local = 0, all = 0, need = 0;
    for (uint32_t k = 0; k < m->memoryHeapCount; k++) {
        all += m->memoryHeaps[k].size;
        if (m->memoryHeaps[k].flags & VK_MEMORY_HEAP_DEVICE_LOCAL_BIT) local += m->memoryHeaps[k].size;
    }
    for (uint32_t k = 0; k < c->v->image_count; k++) need += image_bytes(c->v->images + k) * c->v->images[k].slots;
    uint64_t have = local ? local : all;
    if (need > have) LINE_OF(c, "its images need %.1f MB; %s has %.1f MB of memory for them", need / 1e6, c->name, have / 1e6);
}

static VkFormat choose_depth(Count *c) {
    bool wanted = false;
    Indices formats = c->v->depth_formats;
    for (uint32_t k = 0; k < c->v->image_count; k++) wanted |= !c->v->images[k].format;
    if (!wanted) return VK_FORMAT_UNDEFINED;
    for (uint32_t k = 0; k < formats.count; k++)
        if (features_of(c->device, (VkFormat)formats.at[k]) & VK_FORMAT_FEATURE_DEPTH_STENCIL_ATTACHMENT_BIT)
            return (VkFormat)formats.at[k];
    char words[64] = "";
    for (uint32_t k = 0; k < formats.count && k < 4; k++)
        snprintf(words + strlen(words), sizeof words - strlen(words), "%s%u", k ? ", " : "", formats.at[k]);
    LINE_OF(c, "none of the depth formats [%s] is a depth attachment of %s", words, c->name);
    return VK_FORMAT_UNDEFINED;
}

static VkFormat misfits(Count *c) {
    const Variant *v = c->v;
    find_places(c);
    count_images(c);
    for (uint32_t k = 0; k < v->pass_count; k++) count_pass(c, k);
    for (uint32_t k = 0; k < v->pipeline_count; k++) count_pipeline(c, k);
    for (uint32_t k = 0; k < v->compute_count; k++) count_compute(c, k);
    for (uint32_t p = 0; p < v->plan_count; p++)
        for (uint32_t s = 0; s < v->plans[p].stage_count; s++) {
            char where[LINE];
            snprintf(where, sizeof where, "%.200s.stages[%u]", v->plans[p].name, s);
            count_stage(c, where, v->plans[p].stages + s);
        }
    LIMIT(c, "what its shaders do", (uint64_t)v->needs_limits[LIMIT_COUNT - 2], "bits of the grid to which corners are rounded",
          subPixelPrecisionBits);
    LIMIT(c, "what its shaders do", (uint64_t)v->needs_limits[LIMIT_COUNT - 1], "bits of the weights of a filter", subTexelPrecisionBits);
    if (!c->lines) compare_needs(c);
    if (!c->lines && v->compute_count && !c->device->has_compute) LINE_OF(c, "%s has no queue that both draws and computes", c->name);
    if (!c->lines) compare_memory(c);
    return c->lines ? VK_FORMAT_UNDEFINED : choose_depth(c);
}

/* ---- The choice ---- */

static char *keep(Call *call, Arena *arena, const char *first, const char *second, const char *third) {
    size_t size = strlen(first) + strlen(second) + strlen(third) + 1;
    char *found = grow(call, arena, size, 1);
    snprintf(found, size, "%s%s%s", first, second, third);
    return found;
}

Variant *choose(Call *call, Arena *arena, Bundle *bundle, const dressi_device *device, const char *profile, VkFormat *depth, char **why) {
    const char *name = device->properties.deviceName;
    Variant *taken = NULL;
    char names[200] = "", refused[800] = "";
    uint32_t known = 0, refused_count = 0;
    for (uint32_t k = 0; k < bundle->variant_count; k++) {
        snprintf(names + strlen(names), sizeof names - strlen(names), "%s%.60s", k ? " " : "", bundle->variants[k].profile);
        known += profile && !strcmp(profile, bundle->variants[k].profile);
    }
    if (profile && !known) fail(call, DRESSI_INPUT, "profile '%.60s' is none of this bundle's; there are: %s", profile, names);
    for (uint32_t k = 0; k < bundle->variant_count; k++) {
        Variant *v = bundle->variants + k;
        if (profile && strcmp(profile, v->profile)) {
            why[k] = keep(call, arena, "not taken: ", profile, " was asked for");
            continue;
        }
        if (taken) {
            why[k] = keep(call, arena, "not taken: ", taken->profile, " comes before it and fits");
            continue;
        }
        Count *c = grow(call, arena, 1, sizeof *c);
        *c = (Count){.call = call, .arena = arena, .device = device, .v = v, .name = name};
        VkFormat format = misfits(c);
        if (!c->lines) {
            taken = v, *depth = format;
            why[k] = keep(call, arena, profile ? "taken: asked for" : "taken: the first that fits", "", "");
            continue;
        }
        char by[300];
        snprintf(by, sizeof by, "does not fit %.255s: ", name);
        why[k] = keep(call, arena, by, c->line[0], "");
        if (bundle->variant_count == 1 || profile) {
            char all[SHOWN_LINES * LINE + 40] = "";
            for (uint32_t n = 0; n < c->lines && n < SHOWN_LINES; n++)
                snprintf(all + strlen(all), sizeof all - strlen(all), "%s%s", n ? "; " : "", c->line[n]);
            if (c->lines > SHOWN_LINES) snprintf(all + strlen(all), sizeof all - strlen(all), "; and %u more", c->lines - SHOWN_LINES);
            snprintf(refused, sizeof refused, "%s", all);
        } else {
            snprintf(refused + strlen(refused), sizeof refused - strlen(refused), "%s%.60s: %s", refused_count ? "; " : "", v->profile,
                c->line[0]);
        }
        refused_count++;
    }
    if (taken) return taken;
    if (refused_count > 1)
        fail(call, DRESSI_DEVICE, "no variant of the bundle fits: %s; compile it for a profile this device has", refused);
    fail(call, DRESSI_DEVICE, "the bundle, made for profile %.60s, does not fit %.60s: %s; compile it for a profile this device has",
         profile ? profile : bundle->variants[0].profile, name, refused);
}
