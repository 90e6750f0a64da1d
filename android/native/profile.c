/* What a device allows, as the JSON of a device profile: the bytes that `dressi-edge profiles capture` writes. */

#include "gpu.h"

#include <stdlib.h>
#include <string.h>

typedef unsigned long long ull;
/* u32, VkDeviceSize, VkBool32, u32 of three or two axes, float low and high */
typedef enum Sort { WORD, SIZE, FLAG, TRIPLE, PAIR, RANGE } Sort;

/* By name, as in the file. */
#define LIMIT(name, sort) {#name, offsetof(VkPhysicalDeviceLimits, name), sort}
static const struct { const char *name; size_t at; Sort sort; } LIMITS[] = {
    LIMIT(bufferImageGranularity, SIZE), LIMIT(maxBoundDescriptorSets, WORD), LIMIT(maxColorAttachments, WORD),
    LIMIT(maxComputeSharedMemorySize, WORD), LIMIT(maxComputeWorkGroupCount, TRIPLE), LIMIT(maxComputeWorkGroupInvocations, WORD),
    LIMIT(maxComputeWorkGroupSize, TRIPLE), LIMIT(maxDescriptorSetInputAttachments, WORD), LIMIT(maxDescriptorSetSampledImages, WORD),
    LIMIT(maxDescriptorSetSamplers, WORD), LIMIT(maxDescriptorSetStorageBuffers, WORD), LIMIT(maxDescriptorSetStorageImages, WORD),
    LIMIT(maxDescriptorSetUniformBuffers, WORD), LIMIT(maxDescriptorSetUniformBuffersDynamic, WORD), LIMIT(maxDrawIndexedIndexValue, WORD),
    LIMIT(maxDrawIndirectCount, WORD), LIMIT(maxFragmentCombinedOutputResources, WORD), LIMIT(maxFragmentInputComponents, WORD),
    LIMIT(maxFragmentOutputAttachments, WORD), LIMIT(maxFramebufferHeight, WORD), LIMIT(maxFramebufferLayers, WORD),
    LIMIT(maxFramebufferWidth, WORD), LIMIT(maxImageArrayLayers, WORD), LIMIT(maxImageDimension2D, WORD),
    LIMIT(maxMemoryAllocationCount, WORD), LIMIT(maxPerStageDescriptorInputAttachments, WORD),
    LIMIT(maxPerStageDescriptorSampledImages, WORD), LIMIT(maxPerStageDescriptorSamplers, WORD),
    LIMIT(maxPerStageDescriptorStorageBuffers, WORD), LIMIT(maxPerStageDescriptorStorageImages, WORD),
    LIMIT(maxPerStageDescriptorUniformBuffers, WORD), LIMIT(maxPerStageResources, WORD), LIMIT(maxPushConstantsSize, WORD),
    LIMIT(maxSamplerAllocationCount, WORD), LIMIT(maxStorageBufferRange, WORD), LIMIT(maxUniformBufferRange, WORD),
    LIMIT(maxVertexOutputComponents, WORD), LIMIT(maxViewportDimensions, PAIR), LIMIT(maxViewports, WORD),
    LIMIT(minStorageBufferOffsetAlignment, SIZE), LIMIT(minUniformBufferOffsetAlignment, SIZE), LIMIT(mipmapPrecisionBits, WORD),
    LIMIT(nonCoherentAtomSize, SIZE), LIMIT(subPixelPrecisionBits, WORD), LIMIT(subTexelPrecisionBits, WORD),
    LIMIT(timestampComputeAndGraphics, FLAG), LIMIT(viewportBoundsRange, RANGE)};

#define FEATURE(name) {#name, offsetof(VkPhysicalDeviceFeatures, name)}
static const struct { const char *name; size_t at; } KNOWN_FEATURES[] = {
    FEATURE(depthClamp), FEATURE(drawIndirectFirstInstance), FEATURE(fragmentStoresAndAtomics), FEATURE(fullDrawIndexUint32),
    FEATURE(geometryShader), FEATURE(imageCubeArray), FEATURE(independentBlend), FEATURE(multiDrawIndirect), FEATURE(multiViewport),
    FEATURE(robustBufferAccess), FEATURE(samplerAnisotropy), FEATURE(shaderClipDistance), FEATURE(shaderInt16),
    FEATURE(shaderSampledImageArrayDynamicIndexing), FEATURE(shaderStorageImageExtendedFormats),
    FEATURE(shaderStorageImageReadWithoutFormat), FEATURE(shaderStorageImageWriteWithoutFormat),
    FEATURE(shaderUniformBufferArrayDynamicIndexing), FEATURE(vertexPipelineStoresAndAtomics), FEATURE(wideLines)};

#define FORMAT(name) {#name, VK_FORMAT_##name}
static const struct { const char *name; VkFormat format; } KNOWN_FORMATS[] = {
    FORMAT(D16_UNORM), FORMAT(D32_SFLOAT), FORMAT(R16G16B16A16_SFLOAT), FORMAT(R16G16_SFLOAT), FORMAT(R16_SFLOAT),
    FORMAT(R32G32B32A32_SFLOAT), FORMAT(R32G32B32A32_SINT), FORMAT(R32G32_SFLOAT), FORMAT(R32G32_SINT), FORMAT(R32_SFLOAT),
    FORMAT(R32_SINT), FORMAT(R8G8B8A8_UNORM), FORMAT(R8_UNORM), FORMAT(X8_D24_UNORM_PACK32)};

static const struct { const char *name; VkFormatFeatureFlags bit; } FLAGS[] = {
    {"COLOR_ATTACHMENT", VK_FORMAT_FEATURE_COLOR_ATTACHMENT_BIT}, {"COLOR_ATTACHMENT_BLEND", VK_FORMAT_FEATURE_COLOR_ATTACHMENT_BLEND_BIT},
    {"DEPTH_STENCIL_ATTACHMENT", VK_FORMAT_FEATURE_DEPTH_STENCIL_ATTACHMENT_BIT}, {"SAMPLED_IMAGE", VK_FORMAT_FEATURE_SAMPLED_IMAGE_BIT},
    {"SAMPLED_IMAGE_FILTER_LINEAR", VK_FORMAT_FEATURE_SAMPLED_IMAGE_FILTER_LINEAR_BIT}, {"STORAGE_IMAGE",
        VK_FORMAT_FEATURE_STORAGE_IMAGE_BIT}};

static void say_number(Text *text, double x) { /* whole ones as such */
    if (x == (double)(int64_t)x) say(text, "%lld", (long long)x);
    else say(text, "%.17g", x);
}

static void say_limit(Text *text, const char *at, Sort sort) {
    uint32_t words[3];
    uint64_t size;
    float range[2];
    memcpy(words, at, sort == TRIPLE ? 12 : sort == PAIR ? 8 : 4);
    switch (sort) {
    case WORD: say(text, "%u", words[0]); break;
    case SIZE: memcpy(&size, at, 8); say(text, "%llu", (ull)size); break;
    case FLAG: say(text, words[0] ? "true" : "false"); break;
    case TRIPLE: say(text, "[%u, %u, %u]", words[0], words[1], words[2]); break;
    case PAIR: say(text, "[%u, %u]", words[0], words[1]); break;
    case RANGE:
        memcpy(range, at, sizeof range);
        say(text, "[");
        say_number(text, range[0]);
        say(text, ", ");
        say_number(text, range[1]);
        say(text, "]");
    }
}

static void say_capabilities(Text *text, const dressi_device *d) {
    say(text, "      \"properties\": {\n        \"VkPhysicalDeviceProperties\": {\n          \"limits\": {");
    for (size_t k = 0; k < COUNT(LIMITS); k++) {
        say(text, "%s\n            \"%s\": ", k ? "," : "", LIMITS[k].name);
        say_limit(text, (const char *)&d->properties.limits + LIMITS[k].at, LIMITS[k].sort);
    }
    say(text, "\n          }\n        }\n      },\n      \"features\": {\n        \"VkPhysicalDeviceFeatures\": {");
    for (size_t k = 0; k < COUNT(KNOWN_FEATURES); k++) {
        VkBool32 has_it;
        memcpy(&has_it, (const char *)&d->features + KNOWN_FEATURES[k].at, sizeof has_it);
        say(text, "%s\n          \"%s\": %s", k ? "," : "", KNOWN_FEATURES[k].name, has_it ? "true" : "false");
    }
    say(text, "\n        }\n      },\n      \"formats\": {");
    for (size_t k = 0; k < COUNT(KNOWN_FORMATS); k++) {
        VkFormatFeatureFlags flags = features_of(d, KNOWN_FORMATS[k].format);
        bool first = true;
        say(text, "%s\n        \"VK_FORMAT_%s\": {\n          \"VkFormatProperties\": {\n            \"linearTilingFeatures\": [],\n"
            "            \"optimalTilingFeatures\": [", k ? "," : "", KNOWN_FORMATS[k].name);
        for (size_t j = 0; j < COUNT(FLAGS); j++) {
            if (!(flags & FLAGS[j].bit)) continue;
            say(text, "%s\"VK_FORMAT_FEATURE_%s_BIT\"", first ? "" : ", ", FLAGS[j].name);
            first = false;
        }
        say(text, "],\n            \"bufferFeatures\": []\n          }\n        }");
    }
    say(text, "\n      }\n");
}

/* Texels a row from which on the driver does not pad a table of 2^14 vec4s to more than half as much again; 4, or 8 to 64. As `table_width` of
   dressi_edge/commands/profiles.py. */
static uint32_t table_width(Call *call, const dressi_device *d) {
    const uint32_t entries = 1 << 14;
    uint32_t width = 4;
    for (;; width *= 2) {
        VkImageCreateInfo info = {TYPE(IMAGE_CREATE_INFO), .imageType = VK_IMAGE_TYPE_2D, .format = VK_FORMAT_R32G32B32A32_SFLOAT,
            .extent = {width, entries / width, 1}, .mipLevels = 1, .arrayLayers = 1, .samples = VK_SAMPLE_COUNT_1_BIT,
            .usage = VK_IMAGE_USAGE_COLOR_ATTACHMENT_BIT | VK_IMAGE_USAGE_SAMPLED_BIT | VK_IMAGE_USAGE_TRANSFER_DST_BIT};
        VkImage image;
        VkMemoryRequirements needs;
        MUST(call, &d->vk, CreateImage, d->device, &info, NULL, &image);
        d->vk.GetImageMemoryRequirements(d->device, image, &needs);
        d->vk.DestroyImage(d->device, image, NULL);
        if (width == 64 || 2 * needs.size <= (VkDeviceSize)3 * 16 * entries) return width;
    }
}

/* Bytes of the largest memory that is the device's own; 0: it has none. */
static VkDeviceSize own_heap(const dressi_device *d) {
    VkDeviceSize most = 0;
    for (uint32_t k = 0; k < d->memory.memoryHeapCount; k++) {
        const VkMemoryHeap *heap = &d->memory.memoryHeaps[k];
        if (heap->flags & VK_MEMORY_HEAP_DEVICE_LOCAL_BIT && heap->size > most) most = heap->size;
    }
    return most;
}

static void say_profile(Text *text, const dressi_device *d, const char *name, const char *date, uint32_t width) {
    uint32_t version = d->properties.apiVersion;
    Text about = {0}, source = {0};
    say(&about, "%s, %s, as found", d->properties.deviceName, d->driver);
    say(&source, "reported by %s for %s, %s", d->driver, d->properties.deviceName, date);
    text->broken = about.broken || source.broken;
    say(text, "{\n  \"$schema\": \"https://schema.khronos.org/vulkan/profiles-0.8-latest.json#\",\n  \"capabilities\": {\n");
    say(text, "    \"%s\": {\n", name);
    say_capabilities(text, d);
    say(text, "    }\n  },\n  \"profiles\": {\n    \"VP_DRESSI_%s\": {\n      \"version\": 1,\n", name);
    say(text, "      \"api-version\": \"%u.%u.%u\",\n", version >> 22 & 127, version >> 12 & 1023, version & 4095);
    say(text, "      \"label\": \"%s\",\n      \"description\": ", name);
    if (!text->broken) say_json(text, about.at);
    say(text, ",\n      \"contributors\": {},\n      \"history\": [\n        {\n          \"revision\": 1,\n");
    say(text, "          \"date\": \"%s\",\n", date);
    say(text, "          \"author\": \"dressi_edge\",\n          \"comment\": \"\"\n        }\n      ],\n");
    say(text, "      \"capabilities\": [\"%s\"]\n    }\n  },\n  \"dressi_edge\": {\n    \"description\": ", name);
    if (!text->broken) say_json(text, about.at);
    say(text, ",\n    \"tile_bits\": null,\n    \"max_merged_attachments\": null,\n    \"max_live\": null,\n");
    if (width > 4) say(text, "    \"table_width\": %u,\n", width);
    if (own_heap(d)) say(text, "    \"heap_bytes\": %llu,\n", (unsigned long long)own_heap(d));
    say(text, "    \"prefer_fp16\": false,\n");
    say(text, "    \"sources\": {\n      \"*\": {\n        \"source\": ");
    if (!text->broken) say_json(text, source.at);
    say(text, ",\n        \"status\": \"measured\"\n      }\n    }\n  }\n}\n");
    free(about.at);
    free(source.at);
}

static bool is_name(const char *name) {
    size_t length = strspn(name, "abcdefghijklmnopqrstuvwxyz0123456789_");
    return length >= 1 && length <= 64 && !name[length];
}

static bool is_date(const char *date) {
    for (int k = 0; k < 10; k++)
        if (k == 4 || k == 7 ? date[k] != '-' : date[k] < '0' || date[k] > '9') return false;
    return !date[10];
}

char *dressi_device_profile(const dressi_device *device, const char *name, const char *date, dressi_error *error) {
    Call call = {.error = {DRESSI_OK, ""}};
    Text text = {0};
    if (!setjmp(call.out)) {
        if (!is_name(name)) fail(&call, DRESSI_INPUT, "profile name '%.78s': 1 to 64 of a-z, 0-9 and _ are allowed", name);
        if (!is_date(date)) fail(&call, DRESSI_INPUT, "date '%.78s': one like 2025-01-31 is needed", date);
        say_profile(&text, device, name, date, table_width(&call, device));
        if (text.broken) fail(&call, DRESSI_MEMORY, "no memory for the profile");
    }
    if (!told(&call, error)) return text.at;
    free(text.at);
    return NULL;
}
