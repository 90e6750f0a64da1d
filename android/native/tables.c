/* The numbers of Vulkan that a bundle holds, and what follows from them. */

#include "inside.h"

const char *const LIMIT_NAMES[LIMIT_COUNT] = {
    "maxColorAttachments", "maxComputeSharedMemorySize", "maxComputeWorkGroupInvocations", "maxDescriptorSetInputAttachments",
    "maxDescriptorSetSampledImages", "maxDescriptorSetSamplers", "maxDescriptorSetStorageImages", "maxFragmentCombinedOutputResources",
    "maxFragmentInputComponents", "maxFragmentOutputAttachments", "maxFramebufferHeight", "maxFramebufferWidth", "maxImageDimension2D",
    "maxPerStageDescriptorInputAttachments", "maxPerStageDescriptorSampledImages", "maxPerStageDescriptorSamplers",
    "maxPerStageDescriptorStorageImages", "maxPerStageResources", "maxVertexOutputComponents", "subPixelPrecisionBits",
    "subTexelPrecisionBits"};
const char *const FORMAT_NAMES[FORMAT_COUNT] = {"R16G16B16A16_SFLOAT", "R16G16_SFLOAT", "R16_SFLOAT", "R32G32B32A32_SFLOAT",
    "R32G32B32A32_SINT", "R32G32_SFLOAT", "R32G32_SINT", "R32_SFLOAT", "R32_SINT"};
const uint32_t FORMATS[FORMAT_COUNT] = {97, 83, 76, 109, 108, 103, 102, 100, 99};
const char *const FEATURES[FEATURE_COUNT] = {"sampled", "color", "filter", "storage"};

bool of_compute(int limit) { return limit == 1 || limit == 2 || limit == 6 || limit == 16; }

bool can_store(uint32_t format) { return format == 97 || format == 99 || format == 100 || format == 108 || format == 109; }

uint32_t load_of(const Variant *v, const Stage *stage, uint32_t k) {
    return (stage->compute < 0 ? v->passes[stage->pass].attachments : v->computes[stage->compute].outputs)[k].load;
}

const char *format_name(uint32_t format) {
    for (int k = 0; k < FORMAT_COUNT; k++)
        if (FORMATS[k] == format) return FORMAT_NAMES[k];
    return "depth";
}

bool is_half(uint32_t format) { return format == 76 || format == 83 || format == 97; }

bool is_integer(uint32_t format) { return format == 99 || format == 102 || format == 108; }

uint32_t format_channels(uint32_t format) {
    return format == 76 || format == 99 || format == 100 ? 1 : format == 83 || format == 102 || format == 103 ? 2 : 4;
}

uint32_t texel_bytes(uint32_t format) { return format ? format_channels(format) * (is_half(format) ? 2 : 4) : 4; }

uint64_t image_bytes(const Image *image) { return (uint64_t)texel_bytes(image->format) * image->width * image->height; }

bool has(Indices all, uint32_t x) {
    for (uint32_t k = 0; k < all.count; k++)
        if (all.at[k] == x) return true;
    return false;
}
