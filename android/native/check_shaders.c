/* Whether a bundle's pipelines offer what their shaders declare: dressi_edge/cache/shader_check.py in C, in its order and words. */

#include "inside.h"

#include <stdio.h>

static const char *stage_name(uint32_t stage) { return stage == 1 ? "vertex" : stage == 16 ? "fragment" : "compute"; }

static const char *kind_name(uint32_t kind) {
    return kind == 1 ? "combined image sampler" : kind == 2 ? "sampled image" : kind == 3 ? "storage image" : "input attachment";
}

static const char *words(Location x, char buffer[24]) {
    static const char *const scalars[] = {"", "float", "int", "uint"};
    if (!x.scalar) return "nothing";
    snprintf(buffer, 24, "%s x %u", scalars[x.scalar], x.components);
    return buffer;
}

enum { UNUSED = -1 };

/* What the shaders of a pipeline read from its bindings: UNUSED, floats (0) or integers (1); and which input attachment. */
typedef struct Reads { int8_t *is_integer; uint32_t *index; bool *of_fragment; } Reads;

static void check_stage(Reader *r, const Pipeline *p, const Interface *shader, uint32_t stage, const Subpass *subpass, Reads *reads) {
    const char *key = stage_name(stage);
    if (shader->stage != stage)
        refuse(r, ".%s: shader %u is for the %s stage", key, stage == 1 ? p->vertex : p->fragment, stage_name(shader->stage));
    if (shader->used_count > p->binding_count)
        refuse(r, ".%s: the shader uses %u bindings; the pipeline has %u", key, shader->used_count, p->binding_count);
    for (uint32_t k = 0; k < shader->used_count; k++) {
        const Used *used = shader->used + k;
        uint32_t n = used->number;
        if (n >= p->binding_count) refuse(r, ".%s: the shader uses binding %u; the pipeline has %u", key, n, p->binding_count);
        const Binding *binding = p->bindings + n;
        if (binding->kind != used->kind)
            refuse(r, ".bindings[%u] is a %s; the %s shader uses a %s", n, kind_name(binding->kind), key, kind_name(used->kind));
        if (!(binding->stages & stage)) refuse(r, ".bindings[%u] is not visible to the %s shader, which uses it", n, key);
        if (used->kind == 10 && used->index >= subpass->inputs.count)
            refuse(r, ".bindings[%u]: input attachment %u; the subpass has %u", n, used->index, subpass->inputs.count);
        if (reads->is_integer[n] != UNUSED && reads->is_integer[n] != used->is_integer)
            refuse(r, ".bindings[%u]: one shader reads integers, the other floats", n);
        reads->is_integer[n] = used->is_integer;
        reads->index[n] = used->index;
        reads->of_fragment[n] |= stage == 16;
    }
}

static Reads check_pipeline(Reader *r, const Pipeline *p) {
    const Variant *v = r->v;
    const Interface *vertex = v->interfaces[p->vertex], *fragment = v->interfaces[p->fragment];
    const Pass *pass = v->passes + p->pass;
    const Subpass *subpass = pass->subpasses + p->subpass;
    char a[24], b[24];
    Reads reads = {make_scratch(r, p->binding_count, 1), make_scratch(r, p->binding_count, 4), make_scratch(r, p->binding_count, 1)};
    for (uint32_t k = 0; k < p->binding_count; k++) reads.is_integer[k] = UNUSED;
    check_stage(r, p, vertex, 1, subpass, &reads);
    check_stage(r, p, fragment, 16, subpass, &reads);
    if (!p->topology && !vertex->writes_size) refuse(r, ".topology: points, of which the vertex shader gives no size");
    for (uint32_t k = 0; k < p->binding_count; k++)
        if (p->bindings[k].kind == 10 && (p->bindings[k].stages != 16 || !reads.of_fragment[k]))
            refuse(r, ".bindings[%u]: an input attachment belongs to the fragment shader, which must use it", k);
    if (fragment->output_count != subpass->colors.count)
        refuse(r, ": the fragment shader gives %u outputs; the subpass has %u colours", fragment->output_count, subpass->colors.count);
    for (uint32_t k = 0; k < subpass->colors.count; k++) {
        uint32_t format = pass->attachments[subpass->colors.at[k]].format;
        Location wanted = {is_integer(format) ? 2 : 1, (uint8_t)format_channels(format)};
        Location given = k < MAX_LOCATIONS ? fragment->outputs[k] : (Location){0, 0};
        if (given.scalar != wanted.scalar || given.components < wanted.components)
            refuse(r, ": colour %u needs %s; the fragment shader gives %s", k, words(wanted, a), words(given, b));
    }
    for (uint32_t k = 0; k < fragment->input_count; k++) {
        uint32_t at = fragment->order[k];
        Location wanted = fragment->inputs[at], given = vertex->outputs[at];
        if (given.scalar != wanted.scalar || given.components != wanted.components)
            refuse(r, ": the fragment shader takes %s at location %u; the vertex shader gives %s", words(wanted, a), at, words(given, b));
    }
    return reads;
}

static Reads check_compute(Reader *r, const Compute *c) {
    const Interface *shader = r->v->interfaces[c->shader];
    Reads reads = {make_scratch(r, c->binding_count, 1), NULL, NULL};
    bool *stored = make_scratch(r, c->output_count, 1);
    if (shader->stage != 32) refuse(r, ".shader: shader %u is for the %s stage", c->shader, stage_name(shader->stage));
    for (uint32_t k = 0; k < c->binding_count; k++) reads.is_integer[k] = UNUSED;
    for (uint32_t k = 0; k < shader->used_count; k++) {
        const Used *used = shader->used + k;
        uint32_t n = used->number, all = c->binding_count + c->output_count;
        if (n >= all) refuse(r, ".shader: the shader uses binding %u; the pipeline has %u", n, all);
        uint32_t kind = n < c->binding_count ? c->bindings[n].kind : 3;
        if (kind != used->kind) refuse(r, ": binding %u is a %s; the shader uses a %s", n, kind_name(kind), kind_name(used->kind));
        if (kind != 3) {
            reads.is_integer[n] = used->is_integer;
            continue;
        }
        uint32_t output = n - c->binding_count;
        if (used->index != c->outputs[output].format)
            refuse(r, ".outputs[%u].format is %u; the shader writes format %u", output, c->outputs[output].format, used->index);
        stored[output] = true;
    }
    for (uint32_t k = 0; k < c->output_count; k++)
        if (!stored[k]) refuse(r, ".outputs[%u]: the shader has no storage image at binding %u", k, c->binding_count + k);
    return reads;
}

/* What a draw or dispatch reads. */
static void check_read(Reader *r, uint32_t k, uint32_t ref, uint32_t kind, int wanted) {
    uint32_t format = r->v->images[ref / 2].format;
    if (!format || (wanted != UNUSED && wanted != is_integer(format)))
        refuse(r, ".images[%u]: image %u has format %u; the shader reads %s", k, ref / 2, format, wanted == 1 ? "integers" : "floats");
    if (kind == 1 && is_integer(format)) refuse(r, ".images[%u]: image %u holds integers, which no sampler filters", k, ref / 2);
}

static void check_draw(Reader *r, const Draw *draw, const Stage *stage, const Subpass *subpass, const Reads *reads) {
    const Pipeline *p = r->v->pipelines + draw->pipeline;
    for (uint32_t k = 0; k < draw->images.count; k++) {
        uint32_t ref = draw->images.at[k], format = r->v->images[ref / 2].format;
        int wanted = reads->is_integer[k];
        if (!format || (wanted != UNUSED && wanted != is_integer(format)))
            refuse(r, ".images[%u]: image %u has format %u; the shader reads %s", k, ref / 2, format, wanted == 1 ? "integers" : "floats");
        if (p->bindings[k].kind == 10 && ref != stage->attachments.at[subpass->inputs.at[reads->index[k]]])
            refuse(r, ".images[%u]: image %u is not input attachment %u of the subpass", k, ref / 2, reads->index[k]);
        if (p->bindings[k].kind == 1 && is_integer(format))
            refuse(r, ".images[%u]: image %u holds integers, which no sampler filters", k, ref / 2);
    }
}

void check_shaders(Reader *r) {
    Variant *v = r->v;
    r->depth = 0;
    v->interfaces = make(r, v->shaders.count, sizeof *v->interfaces);
    push(r, "shaders", 0);
    for EACH(r, k, v->shaders.count) {
        uint32_t blob = v->shaders.at[k];
        if (!r->parsed[blob]) r->parsed[blob] = parse_shader(r, blob_data(r->bundle, blob), r->bundle->blobs[blob].size);
        v->interfaces[k] = r->parsed[blob];
        if (v->interfaces[k]->stage == 32 && !v->has_computes)
            refuse(r, " is for the compute stage, of which this version of the format has none");
    }
    pop(r);
    Reads *reads = make_scratch(r, v->pipeline_count, sizeof *reads);
    push(r, "pipelines", 0);
    for EACH(r, k, v->pipeline_count) reads[k] = check_pipeline(r, v->pipelines + k);
    pop(r);
    Reads *computed = make_scratch(r, v->compute_count, sizeof *computed);
    push(r, "computes", 0);
    for EACH(r, k, v->compute_count) computed[k] = check_compute(r, v->computes + k);
    pop(r);
    push(r, "plans", 0);
    for EACH(r, k, v->plan_count) {
        push(r, "stages", 0);
        for EACH(r, s, v->plans[k].stage_count) {
            const Stage *stage = v->plans[k].stages + s;
            const Indices *images = stage->compute < 0 ? NULL : &stage->subpasses->draws->images;
            for (uint32_t n = 0; images && n < images->count; n++)
                check_read(r, n, images->at[n], v->computes[stage->compute].bindings[n].kind, computed[stage->compute].is_integer[n]);
            if (images) continue;
            const Pass *pass = v->passes + stage->pass;
            push(r, "subpasses", 0);
            for EACH(r, j, pass->subpass_count) {
                push(r, NULL, 0);
                for EACH(r, i, stage->subpasses[j].count) {
                    const Draw *draw = stage->subpasses[j].draws + i;
                    check_draw(r, draw, stage, pass->subpasses + j, reads + draw->pipeline);
                }
                pop(r);
            }
            pop(r);
        }
        pop(r);
    }
    pop(r);
}
