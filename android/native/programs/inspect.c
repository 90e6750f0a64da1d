/* `dressi-play inspect` and `verify`: what a bundle's plans are made of, counted from its description as dressi_edge/cache/summary.py
   does. */

#include "inspect.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char *size_text(double count, char buffer[24]) {
    static const char *const units[] = {"B", "kB", "MB", "GB"};
    int k = 0;
    for (; k < 3 && count >= 1000; k++) count /= 1000;
    snprintf(buffer, 24, "%.3g %s", count, units[k]);
    return buffer;
}

/* Bytes a render pass moves between images and the GPU: every attachment it loads, every one it stores, and once a subpass every image
   that is sampled there. `seen` is by ref; `*mark` tells subpasses apart. */
static uint64_t stage_bytes(const Variant *v, const Stage *stage, uint32_t *seen, uint32_t *mark) {
    uint64_t total = 0;
    for (uint32_t k = 0; k < stage->attachments.count; k++) {
        bool stored = stage->compute >= 0 || v->passes[stage->pass].attachments[k].store == 0;
        total += ((load_of(v, stage, k) == 0) + stored) * image_bytes(v->images + stage->attachments.at[k] / 2);
    }
    for (uint32_t j = 0; j < stage->subpass_count; j++, ++*mark)
        for (uint32_t d = 0; d < stage->subpasses[j].count; d++) {
            const Draw *draw = stage->subpasses[j].draws + d;
            for (uint32_t k = 0; k < draw->images.count; k++) {
                uint32_t ref = draw->images.at[k];
                if ((stage->compute < 0 && v->pipelines[draw->pipeline].bindings[k].kind == 10) || seen[ref] == *mark) continue;
                seen[ref] = *mark;
                total += image_bytes(v->images + ref / 2);
            }
        }
    return total;
}

static void show_stage(const Variant *v, const Stage *stage, uint32_t number, uint64_t bytes) {
    char size[24];
    uint32_t draws = 0, n = stage->attachments.count;
    for (uint32_t j = 0; j < stage->subpass_count; j++)
        for (uint32_t d = 0; d < stage->subpasses[j].count; d++) draws += stage->subpasses[j].draws[d].cell_count;
    if (stage->compute < 0) {
        printf("  %3u %5u x %-5u %u substages, %u draws, %s, attachments ", number, stage->width, stage->height, stage->subpass_count, draws,
               size_text((double)bytes, size));
    } else {
        const Image *image = v->images + *stage->attachments.at / 2;
        printf("  %3u %5u x %-5u 1 substages, compute, %u x %u x %u workgroups, %s, outputs ", number, image->width, image->height,
               stage->groups[0], stage->groups[1], stage->groups[2], size_text((double)bytes, size));
    }
    bool first = true;
    for (uint32_t k = 0; k < n; k++) {
        uint32_t format = v->images[stage->attachments.at[k] / 2].format, count = 0, before = 0;
        for (uint32_t j = 0; j < n; j++) {
            bool same = v->images[stage->attachments.at[j] / 2].format == format;
            count += same, before += same && j < k;
        }
        if (before) continue;
        printf("%s%ux%s", first ? "" : " ", count, format_name(format));
        first = false;
    }
    printf("\n");
}

static void show_plan(const Variant *v, const Plan *plan, uint32_t *seen, uint32_t *mark) {
    char size[24];
    bool *used = calloc((uint64_t)v->pipeline_count + v->compute_count + 1, 1);
    uint64_t *bytes = calloc(plan->stage_count + 1, sizeof *bytes), total = 0;
    uint32_t substages = 0, pipelines = 0;
    if (!used || !bytes) exit(DRESSI_MEMORY);
    for (uint32_t s = 0; s < plan->stage_count; s++) {
        const Stage *stage = plan->stages + s;
        substages += stage->subpass_count;
        total += bytes[s] = stage_bytes(v, stage, seen, mark);
        for (uint32_t j = 0; j < stage->subpass_count; j++)
            for (uint32_t d = 0; d < stage->subpasses[j].count; d++) {
                uint32_t pipeline = stage->compute < 0 ? stage->subpasses[j].draws[d].pipeline : v->pipeline_count + (uint32_t)stage->compute;
                pipelines += !used[pipeline];
                used[pipeline] = true;
            }
    }
    printf("%s: %u substages, %u stages, %u pipelines, %s a step", plan->name, substages, plan->stage_count, pipelines,
        size_text((double)total, size));
    if (plan->steps) printf(", %llu steps", (unsigned long long)plan->steps);
    printf("\n");
    for (uint32_t s = 0; s < plan->stage_count; s++) show_stage(v, plan->stages + s, s, bytes[s]);
    free(used);
    free(bytes);
}

static void show_variant(const Variant *v) {
    char size[24];
    uint64_t bytes = 0;
    uint32_t *seen = calloc(2 * (uint64_t)v->image_count + 1, sizeof *seen), mark = 1;
    if (!seen) exit(DRESSI_MEMORY);
    for (uint32_t k = 0; k < v->image_count; k++) bytes += image_bytes(v->images + k) * v->images[k].slots;
    printf("profile %s: %u plans, %u pipelines, %u shaders, %u images of %s\n\n", v->profile, v->plan_count, v->pipeline_count + v->compute_count,
        v->shaders.count,
           v->image_count, size_text((double)bytes, size));
    for (uint32_t k = 0; k < v->plan_count; k++) show_plan(v, v->plans + k, seen, &mark);
    printf("\nvalues:\n");
    for (uint32_t k = 0; k < v->value_count; k++) {
        static const char *const roles[] = {"input", "state", "output", "copy"};
        dressi_value about;
        describe_value(v->values + k, &about);
        printf("  %-6s %s: %s (", roles[v->values[k].role], about.name, about.is_int ? "int32" : "float");
        for (int n = 0; n < about.rank; n++) printf("%s%u", n ? ", " : "", about.shape[n]);
        printf(")\n");
    }
    printf("\nneeds of the device:");
    for (int k = 0; k < LIMIT_COUNT; k++)
        if (v->needs_limits[k]) printf(" %s=%lld", LIMIT_NAMES[k], (long long)v->needs_limits[k]);
    printf("\n");
    free(seen);
}

static void read_and(Call *call, const char *path, const char *pin, void (*show)(const Bundle *bundle, const char *path)) {
    Bundle bundle = {0};
    uint8_t *data = NULL;
    Call inner;
    if (!setjmp(inner.out)) {
        read_bundle_file(&inner, &bundle, path, pin, &data);
        inner.error.code = DRESSI_OK;
        show(&bundle, path);
    }
    drop(&bundle.arena);
    free(data);
    if (inner.error.code) fail(call, inner.error.code, "%s", inner.error.text);
}

static void show_all(const Bundle *bundle, const char *path) {
    (void)path;
    for (uint32_t k = 0; k < bundle->variant_count; k++) {
        if (k) printf("\n");
        show_variant(bundle->variants + k);
    }
}

static void say_sound(const Bundle *bundle, const char *path) {
    char digest[65];
    hexadecimal(bundle->digest, 32, digest);
    printf("OK %s: profile", path);
    for (uint32_t k = 0; k < bundle->variant_count; k++) printf(" %s", bundle->variants[k].profile);
    printf(", %u plans, %u blobs, sha256 %s\n", bundle->variants[0].plan_count, bundle->blob_count, digest);
}

void inspect(Call *call, const char *path, const char *pin) { read_and(call, path, pin, show_all); }
void verify(Call *call, const char *path, const char *pin) { read_and(call, path, pin, say_sound); }
