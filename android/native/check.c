/* Checks a description and takes it apart: meta to values. In: its nodes. Out: the records of a `Variant`, or the first thing wrong by
   its path. Order and words of the checks are those of dressi_edge/cache/bundle_check.py, so that both readers say the same. */

#include "inside.h"

#include <stdio.h>
#include <string.h>

enum { MAX_PARTS = 1024, MAX_COLORS = 128, MAX_META_DEPTH = 16 };

/* ---- What a bundle has ---- */

static const char ALL_FORMATS[] = "0 76 83 97 99 100 102 103 108 109";

static void check_meta(Reader *r, const Node *meta) {
    char shown[SHOWN];
    if (meta->kind != MAP) refuse_plainly(r, "meta is %s; a map is needed", show(meta, shown));
    const Node **layer = make_scratch(r, 1, sizeof *layer);
    *layer = meta;
    uint64_t count = 1;
    for (int depth = 0; depth < MAX_META_DEPTH && count; depth++) {
        uint64_t below = 0;
        for (uint64_t k = 0; k < count; k++) {
            below += layer[k]->count;
            for (uint32_t j = 0; layer[k]->kind == MAP && j < layer[k]->count; j++)
                if (layer[k]->is.items[2 * j].kind != STRING) refuse_plainly(r, "meta has a map with a key that is no text");
        }
        const Node **next = make_scratch(r, below, sizeof *next);
        uint64_t found = 0;
        for (uint64_t k = 0; k < count; k++)
            for (uint32_t j = 0; j < layer[k]->count; j++) {
                const Node *item = layer[k]->is.items + (layer[k]->kind == MAP ? 2 * (uint64_t)j + 1 : j);
                if (item->kind == ARRAY || item->kind == MAP) next[found++] = item;
            }
        layer = next, count = found;
    }
    if (count) refuse_plainly(r, "meta is nested deeper than %d", MAX_META_DEPTH);
}

static void check_blobs(Reader *r, const Node *root) {
    char shown[SHOWN];
    const Node *rows = open_list(r, root, "blobs", -1, MAX_ITEMS);
    Blob *blobs = make(r, rows->count, sizeof *blobs);
    for EACH(r, k, rows->count) {
        const Node *row = list(r, rows->is.items + k, 3, MAX_ITEMS);
        push(r, NULL, 0);
        blobs[k].offset = integer(r, row->is.items, 0, INT64_C(1) << 40);
        r->path[r->depth - 1].index = 1;
        blobs[k].size = integer(r, row->is.items + 1, 0, INT64_C(1) << 40);
        r->path[r->depth - 1].index = 2;
        const Node *digest = row->is.items + 2;
        if (digest->kind != BINARY || digest->count != 32) refuse(r, " is %s; 32 bytes are needed", show(digest, shown));
        blobs[k].digest = digest->is.bytes;
        pop(r);
    }
    pop(r);
    r->bundle->blobs = blobs, r->bundle->blob_count = rows->count;
}

static int place_among(const char *const *names, int count, const Node *name) {
    for (int k = 0; k < count; k++)
        if (same(name, names[k])) return k;
    return -1;
}

static void check_needs(Reader *r, const Node *root) {
    const Node *needs = find(root, "needs");
    char shown[SHOWN];
    push(r, "needs", -1);
    keys(r, needs, "limits formats", NULL);
    const Node *limits = find(needs, "limits"), *formats = find(needs, "formats");
    if (limits->kind != MAP || formats->kind != MAP) refuse(r, " is %s; maps are needed", show(needs, shown));
    for (uint32_t k = 0; k < limits->count; k++) {
        int limit = place_among(LIMIT_NAMES, LIMIT_COUNT, limits->is.items + 2 * k);
        if (limit < 0 || (of_compute(limit) && !r->v->has_computes)) refuse(r, ".limits names %s, which this reader does not know", show(limits->is.items + 2 * k, shown));
        push(r, "limits", -1), push(r, LIMIT_NAMES[limit], -1);
        r->v->needs_limits[limit] = integer(r, limits->is.items + 2 * k + 1, 0, INT64_C(1) << 40);
        pop(r), pop(r);
    }
    for (uint32_t k = 0; k < formats->count; k++) {
        int format = place_among(FORMAT_NAMES, FORMAT_COUNT, formats->is.items + 2 * k);
        if (format < 0) refuse(r, ".formats names %s, which this reader does not know", show(formats->is.items + 2 * k, shown));
        push(r, "formats", -1), push(r, FORMAT_NAMES[format], -1);
        const Node *features = list(r, formats->is.items + 2 * k + 1, -1, MAX_ITEMS);
        push(r, NULL, 0);
        for EACH(r, j, features->count) {
            int feature = place_among(FEATURES, r->v->has_computes ? FEATURE_COUNT : FEATURE_COUNT - 1, features->is.items + j);
            if (feature < 0)
                refuse(r, " is %s; allowed: sampled color filter%s", show(features->is.items + j, shown), r->v->has_computes ? " storage" : "");
            r->v->needs_formats[format] |= 1 << feature;
        }
        pop(r), pop(r), pop(r);
    }
    pop(r);
}

/* A list of numbers, each of those allowed. */
static Indices numbers(Reader *r, const Node *root, const char *key, uint32_t most, const char *allowed) {
    const Node *items = open_list(r, root, key, -1, most);
    Indices found = {items->count, make(r, items->count, sizeof(uint32_t))};
    for EACH(r, k, items->count) found.at[k] = number_of(r, items->is.items + k, allowed);
    pop(r);
    return found;
}

static uint32_t format_of(Reader *r, const Node *map) {
    push(r, "format", -1);
    uint32_t format = number_of(r, find(map, "format"), ALL_FORMATS);
    pop(r);
    return format;
}

static void check_image(Reader *r, const Node *node, Image *image) {
    char shown[SHOWN];
    keys(r, node, "format width height slots usage data", NULL);
    image->format = format_of(r, node);
    image->width = number(r, node, "width", 1, MAX_SIDE);
    image->height = number(r, node, "height", 1, MAX_SIDE);
    image->slots = number(r, node, "slots", 1, 2);
    image->usage = number(r, node, "usage", 1, 255);
    uint32_t allowed = !image->format ? 32 : r->v->has_computes ? 159 : 151;
    if (image->usage & ~allowed) refuse(r, ".usage is %s; bits of %u are allowed", show(find(node, "usage"), shown), allowed);
    image->value = image->data = -1;
    if (find(node, "data")->kind == NIL) return;
    image->data = number(r, node, "data", 0, (int64_t)r->bundle->blob_count - 1);
    if (!(image->usage & 2) || !image->format || image->slots != 1) refuse(r, ".data needs a colour format, one slot and usage 2");
}

static Indices colors_of(Reader *r, const Node *node, const char *key, const Pass *pass) {
    const Node *items = open_list(r, node, key, -1, MAX_COLORS);
    Indices found = {items->count, make(r, items->count, sizeof(uint32_t))};
    for EACH(r, k, items->count) {
        found.at[k] = integer(r, items->is.items + k, 0, (int64_t)pass->attachment_count - 1);
        if (!pass->attachments[found.at[k]].format) refuse(r, " is a depth attachment");
    }
    pop(r);
    return found;
}

static void check_subpass(Reader *r, const Node *node, const Pass *pass, Subpass *subpass, bool *written) {
    keys(r, node, "colors inputs depth", NULL);
    subpass->colors = colors_of(r, node, "colors", pass);
    subpass->inputs = colors_of(r, node, "inputs", pass);
    uint8_t used[MAX_PARTS] = {0};
    bool twice = false;
    for (uint32_t k = 0; k < subpass->colors.count; k++) twice |= used[subpass->colors.at[k]]++ > 0;
    for (uint32_t k = 0; k < subpass->inputs.count; k++) twice |= used[subpass->inputs.at[k]] > 0;
    if (twice) refuse(r, ": an attachment is used twice");
    for (uint32_t k = 0; k < subpass->inputs.count; k++)
        if (!written[subpass->inputs.at[k]])
            refuse(r, ".inputs[%u]: attachment %u was neither loaded nor written by an earlier subpass", k, subpass->inputs.at[k]);
    for (uint32_t k = 0; k < subpass->colors.count; k++) written[subpass->colors.at[k]] = true;
    subpass->depth = number(r, node, "depth", -1, (int64_t)pass->attachment_count - 1);
    if (subpass->depth >= 0 && pass->attachments[subpass->depth].format) refuse(r, ".depth is no depth attachment");
    for (const Subpass *other = pass->subpasses; subpass->depth >= 0 && other < subpass; other++)
        if (other->depth >= 0) refuse(r, ".depth: a second subpass with depth; nothing orders the two");
}

static void check_pass(Reader *r, const Node *node, Pass *pass) {
    char shown[SHOWN];
    bool written[MAX_PARTS] = {0};
    keys(r, node, "attachments subpasses", NULL);
    const Node *attachments = open_list(r, node, "attachments", -1, MAX_PARTS);
    pass->attachment_count = attachments->count;
    pass->attachments = make(r, attachments->count, sizeof(Attachment));
    for EACH(r, k, attachments->count) {
        const Node *item = attachments->is.items + k;
        Attachment *a = pass->attachments + k;
        keys(r, item, "format load store clear", NULL);
        a->format = format_of(r, item);
        a->load = number(r, item, "load", a->format ? 0 : 1, a->format ? 2 : 1);
        a->store = number(r, item, "store", 0, 1);
        a->clear = number(r, item, "clear", is_integer(a->format) ? -1 : 0, !a->format || is_integer(a->format));
        written[k] = a->load == 0;
    }
    pop(r);
    const Node *subpasses = open_list(r, node, "subpasses", -1, MAX_PARTS);
    if (!subpasses->count) refuse(r, " is %s; at least one is needed", show(subpasses, shown));
    pass->subpass_count = subpasses->count;
    pass->subpasses = make(r, subpasses->count, sizeof(Subpass));
    for EACH(r, k, subpasses->count) check_subpass(r, subpasses->is.items + k, pass, pass->subpasses + k, written);
    pop(r);
}

static void check_pipeline(Reader *r, const Node *node, Pipeline *p) {
    const Variant *v = r->v;
    char shown[SHOWN];
    keys(r, node, "vertex fragment pass subpass bindings depth topology", NULL);
    push(r, "topology", -1);
    p->topology = number_of(r, find(node, "topology"), "0 3");
    pop(r);
    p->vertex = number(r, node, "vertex", 0, (int64_t)v->shaders.count - 1);
    p->fragment = number(r, node, "fragment", 0, (int64_t)v->shaders.count - 1);
    p->pass = number(r, node, "pass", 0, (int64_t)v->pass_count - 1);
    const Pass *pass = v->passes + p->pass;
    p->subpass = number(r, node, "subpass", 0, (int64_t)pass->subpass_count - 1);
    const Node *depth = find(node, "depth");
    if (depth->kind != BOOLEAN || (depth->is.integer && pass->subpasses[p->subpass].depth < 0))
        refuse(r, ".depth is %s; false, or true with a depth attachment", show(depth, shown));
    p->depth = depth->is.integer;
    const Node *bindings = open_list(r, node, "bindings", -1, MAX_PARTS);
    p->binding_count = bindings->count;
    p->bindings = make(r, bindings->count, sizeof(Binding));
    for EACH(r, k, bindings->count) {
        const Node *row = list(r, bindings->is.items + k, 3, MAX_ITEMS)->is.items;
        Binding *b = p->bindings + k;
        push(r, NULL, 0);
        b->kind = number_of(r, row, "1 2 10");
        r->path[r->depth - 1].index = 1;
        b->stages = number_of(r, row + 1, "1 16 17");
        r->path[r->depth - 1].index = 2;
        b->sampler = integer(r, row + 2, b->kind == 1 ? 0 : -1, b->kind == 1 ? (int64_t)v->samplers.count - 1 : -1);
        pop(r);
    }
    pop(r);
}

static void check_compute(Reader *r, const Node *node, Compute *c) {
    const Variant *v = r->v;
    char shown[SHOWN];
    keys(r, node, "shader bindings outputs", NULL);
    c->shader = number(r, node, "shader", 0, (int64_t)v->shaders.count - 1);
    const Node *bindings = open_list(r, node, "bindings", -1, MAX_PARTS);
    c->binding_count = bindings->count;
    c->bindings = make(r, bindings->count, sizeof(Binding));
    for EACH(r, k, bindings->count) {
        const Node *row = list(r, bindings->is.items + k, 2, MAX_ITEMS)->is.items;
        Binding *b = c->bindings + k;
        push(r, NULL, 0);
        b->kind = number_of(r, row, "1 2");
        b->stages = 32;
        r->path[r->depth - 1].index = 1;
        b->sampler = integer(r, row + 1, b->kind == 1 ? 0 : -1, b->kind == 1 ? (int64_t)v->samplers.count - 1 : -1);
        pop(r);
    }
    pop(r);
    const Node *outputs = open_list(r, node, "outputs", -1, MAX_COLORS);
    if (!outputs->count) refuse(r, " is %s; at least one is needed", show(outputs, shown));
    c->output_count = outputs->count;
    c->outputs = make(r, outputs->count, sizeof(Attachment));
    for EACH(r, k, outputs->count) {
        const Node *item = outputs->is.items + k;
        Attachment *a = c->outputs + k;
        keys(r, item, "format load clear", NULL);
        push(r, "format", -1);
        a->format = number_of(r, find(item, "format"), "97 99 100 108 109");
        pop(r);
        a->load = number(r, item, "load", 0, 2);
        a->clear = number(r, item, "clear", is_integer(a->format) ? -1 : 0, is_integer(a->format));
    }
    pop(r);
}

/* ---- Values ---- */

void table_size(uint64_t count, uint64_t *width, uint64_t *height) {
    for (*width = count < 3 ? count : 4; divided(count, *width) > 4096;) *width *= 2;
    *height = divided(count, *width);
}

static void check_value(Reader *r, const Node *node, Value *value) {
    Variant *v = r->v;
    static const char *const types[] = {"float", "vec2", "vec3", "vec4", "int", "ivec2", "ivec3", "ivec4"};
    keys(r, node, "name role image type layout width height count columns initial", NULL);
    value->name = text(r, node, "name");
    value->role = word_of(r, node, "role", "input state output copy");
    uint32_t type = word_of(r, node, "type", "float vec2 vec3 vec4 int ivec2 ivec3 ivec4");
    value->channels = type % 4 + 1;
    value->is_int = type > 3;
    value->layout = word_of(r, node, "layout", "unit table image atlas");
    value->width = number(r, node, "width", 1, 1 << 30);
    value->height = number(r, node, "height", 1, 1 << 30);
    value->count = number(r, node, "count", 1, 1 << 30);
    value->columns = number(r, node, "columns", 1, 1 << 30);
    value->image = number(r, node, "image", 0, (int64_t)v->image_count - 1);
    const Image *image = v->images + value->image;
    uint64_t width = 1, height = 1;
    if (value->layout == TABLE && value->count > 4096 * MAX_SIDE) width = height = 0; /* no image is so large */
    else if (value->layout == TABLE) table_size(value->count, &width, &height);
    else if (value->layout == IMAGE) width = value->width, height = value->height;
    else if (value->layout == ATLAS)
        width = (uint64_t)value->width * value->columns, height = value->height * divided(value->count, value->columns);
    if (image->width != width || image->height != height)
        refuse(r, ": its image is %u x %u; %llu x %llu is needed", image->width, image->height, (unsigned long long)width,
               (unsigned long long)height);
    if (!image->format || format_channels(image->format) != (value->channels == 3 ? 4 : value->channels) ||
        is_integer(image->format) != value->is_int)
        refuse(r, ": its image has format %u, which does not hold %s", image->format, types[type]);
    if (is_half(image->format) && value->role != INPUT)
        refuse(r, ": its image has format %u; only inputs may have 16 bits a channel", image->format);
    uint32_t usage = value->role == COPY ? 0 : value->role == OUTPUT ? 1 : 3;
    if ((image->usage & usage) != usage) refuse(r, ": its image lacks usage %u", usage);
    if (image->data >= 0) refuse(r, ": its image %u is a constant", value->image);
    value->initial = -1;
    const Node *start = find(node, "initial");
    if (start->kind == NIL) return;
    if (start->kind == BINARY) {
        uint32_t texel = texel_bytes(image->format);
        if (start->count != texel) refuse(r, ".initial: %u bytes; a texel of its image has %u", start->count, texel);
        memcpy(value->texel, start->is.bytes, texel);
        value->filled = true;
    } else {
        value->initial = number(r, node, "initial", 0, (int64_t)r->bundle->blob_count - 1);
    }
    if (value->role == OUTPUT || value->role == COPY) refuse(r, ".initial: %s has none", value->role == OUTPUT ? "an output" : "a copy");
}

static void check_values(Reader *r, const Node *root) {
    Variant *v = r->v;
    char shown[SHOWN];
    const Node *values = open_list(r, root, "values", -1, MAX_ITEMS);
    const bool *taken = repeated(r, values);
    v->value_count = values->count;
    v->values = make(r, values->count, sizeof(Value));
    for EACH(r, k, values->count) {
        check_value(r, values->is.items + k, v->values + k);
        if (taken[k]) refuse(r, ".name %s is taken", show(find(values->is.items + k, "name"), shown));
        Image *image = v->images + v->values[k].image;
        if (image->value >= 0) refuse(r, ".image %u is that of values[%d]", v->values[k].image, image->value);
        image->value = k;
    }
    pop(r);
    push(r, "images", 0);
    for EACH(r, k, v->image_count) {
        Role role = v->images[k].value < 0 ? OUTPUT : v->values[v->images[k].value].role;
        if (v->images[k].slots == 2 && role != STATE && role != COPY) refuse(r, ".slots is 2; only the image of a state or copy has two");
    }
    pop(r);
}

static const char VARIANT_KEYS[] = "meta profile needs depth_formats images samplers shaders passes pipelines";

void check_description(Reader *r, const Node *root) {
    Variant *v = r->v;
    char names[sizeof VARIANT_KEYS + 32];
    v->has_computes = find(root, "computes") != NULL;
    snprintf(names, sizeof names, "%s%s values plans%s", VARIANT_KEYS, v->has_computes ? " computes" : "", root == r->top ? " blobs" : "");
    r->depth = 0;
    v->root = root;
    keys(r, root, names, "description");
    check_meta(r, find(root, "meta"));
    const Node *profile = find(root, "profile");
    push(r, "profile", -1);
    keys(r, profile, "name digest", NULL);
    v->profile = text(r, profile, "name");
    text(r, profile, "digest");
    pop(r);
    if (!r->bundle->blobs) check_blobs(r, r->top);
    check_needs(r, root);
    v->depth_formats = numbers(r, root, "depth_formats", MAX_ITEMS, "126 125");
    const Node *images = open_list(r, root, "images", -1, MAX_OBJECTS);
    v->images = make(r, v->image_count = images->count, sizeof(Image));
    for EACH(r, k, images->count) check_image(r, images->is.items + k, v->images + k);
    pop(r);
    v->samplers = numbers(r, root, "samplers", MAX_OBJECTS, "0 2");
    const Node *shaders = open_list(r, root, "shaders", -1, MAX_OBJECTS);
    v->shaders = (Indices){shaders->count, make(r, shaders->count, sizeof(uint32_t))};
    for EACH(r, k, shaders->count) v->shaders.at[k] = integer(r, shaders->is.items + k, 0, (int64_t)r->bundle->blob_count - 1);
    pop(r);
    const Node *passes = open_list(r, root, "passes", -1, MAX_OBJECTS);
    v->passes = make(r, v->pass_count = passes->count, sizeof(Pass));
    for EACH(r, k, passes->count) check_pass(r, passes->is.items + k, v->passes + k);
    pop(r);
    const Node *pipelines = open_list(r, root, "pipelines", -1, MAX_OBJECTS);
    v->pipelines = make(r, v->pipeline_count = pipelines->count, sizeof(Pipeline));
    for EACH(r, k, pipelines->count) check_pipeline(r, pipelines->is.items + k, v->pipelines + k);
    pop(r);
    if (v->has_computes) {
        const Node *computes = open_list(r, root, "computes", -1, MAX_OBJECTS);
        v->computes = make(r, v->compute_count = computes->count, sizeof(Compute));
        for EACH(r, k, computes->count) check_compute(r, computes->is.items + k, v->computes + k);
        pop(r);
    }
    check_values(r, root);
    check_plans(r);
}
