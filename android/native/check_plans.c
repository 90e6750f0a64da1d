/* Checks plans and takes them apart: their stages and draws, what each is for, and that nothing is read that was never written. Order
   and words are those of dressi_edge/cache/bundle_plans.py. What Python holds in sets are stamps here: a number by value or ref. */

#include "inside.h"

#include <string.h>

enum { MAX_PLANS = 4096, MAX_NEEDS = 16, MAX_PARTS = 1024, MAX_GROUPS = INT32_MAX };

static const char *const ROLES[] = {"input", "state", "output", "copy"};

const char *show_name(const Reader *r, uint32_t value, char shown[SHOWN]) {
    const Node *values = find(r->v->root, "values");
    return show(find(values->is.items + value, "name"), shown);
}

static Indices indices(Reader *r, const Node *items) {
    return (Indices){items->count, make(r, items->count, sizeof(uint32_t))};
}

/* ---- Draws and stages ---- */

static Image *ref_image(Reader *r, const Node *node, int64_t *ref, int64_t low) {
    *ref = integer(r, node, low, 2 * (int64_t)r->v->image_count - 1);
    if (*ref < 0) return NULL;
    Image *image = r->v->images + *ref / 2;
    if (*ref % 2 && image->slots != 2) refuse(r, " is %lld: the second slot of an image that has one", (long long)*ref);
    return image;
}

static void check_cells(Reader *r, const Node *node, const Stage *stage, Draw *draw) {
    const Node *cells = open_list(r, node, "cells", -1, MAX_ITEMS);
    draw->cell_count = cells->count;
    draw->cells = make(r, cells->count, sizeof *draw->cells);
    for EACH(r, k, cells->count) {
        const Node *row = list(r, cells->is.items + k, 4, MAX_ITEMS);
        uint32_t *cell = draw->cells[k];
        push(r, NULL, 0);
        for EACH(r, j, 4) cell[j] = integer(r, row->is.items + j, j > 1, MAX_SIDE);
        pop(r);
        if (cell[0] + cell[2] > stage->width || cell[1] + cell[3] > stage->height)
            refuse(r, " leaves the stage of %u x %u", stage->width, stage->height);
    }
    pop(r);
}

/* An image that says how much of a draw or dispatch there is to do: whether there is one. */
static bool check_count(Reader *r, const Node *node, const Marks *written, Draw *draw) {
    int64_t ref;
    push(r, "count", -1);
    const Image *image = ref_image(r, find(node, "count"), &ref, -1);
    draw->count = ref;
    if (image && (image->format != 99 || !(image->usage & 1))) refuse(r, ": image %lld is not R32_SINT with usage 1", (long long)ref / 2);
    if (image && written->of_ref[ref] == written->now_ref) refuse(r, ": image %lld is written by the same stage", (long long)ref / 2);
    pop(r);
    return image != NULL;
}

static void check_draw(Reader *r, const Node *node, const Stage *stage, uint32_t subpass, const Marks *attached, Draw *draw) {
    const Variant *v = r->v;
    char shown[SHOWN];
    int64_t ref;
    keys(r, node, "pipeline images vertices cells depth_range count", NULL);
    draw->pipeline = number(r, node, "pipeline", 0, (int64_t)v->pipeline_count - 1);
    const Pipeline *pipeline = v->pipelines + draw->pipeline;
    if (pipeline->pass != stage->pass || pipeline->subpass != subpass) refuse(r, ".pipeline %u is made for another pass", draw->pipeline);
    const Node *images = open_list(r, node, "images", pipeline->binding_count, MAX_ITEMS);
    draw->images = indices(r, images);
    for EACH(r, k, images->count) {
        const Image *image = ref_image(r, images->is.items + k, &ref, 0);
        uint32_t usage = pipeline->bindings[k].kind == 10 ? 128 : 4;
        if (!(image->usage & usage)) refuse(r, ": image %lld lacks usage %u", (long long)ref / 2, usage);
        if (usage == 4 && attached->of_ref[ref] == attached->now_ref)
            refuse(r, ": image %lld is written by the same stage", (long long)ref / 2);
        draw->images.at[k] = (uint32_t)ref;
    }
    pop(r);
    draw->vertices = number(r, node, "vertices", 1, INT32_MAX);
    check_cells(r, node, stage, draw);
    if (check_count(r, node, attached, draw) && draw->cell_count != 1)
        refuse(r, ".count is %lld; -1, or a draw of one cell", (long long)draw->count);
    const Node *range = open_list(r, node, "depth_range", 2, MAX_ITEMS);
    for (int k = 0; k < 2; k++) {
        const Node *x = range->is.items + k;
        if (x->kind != REAL || !(x->is.real >= 0 && x->is.real <= 1))
            refuse(r, " is %s; two floats from 0 to 1 are needed", show(range, shown));
    }
    pop(r);
    draw->near = (float)range->is.items[0].is.real, draw->far = (float)range->is.items[1].is.real;
}

/* The refs of what a stage writes fit what writes them, each once; they are marked. */
static void check_written(Reader *r, const Node *refs, const Attachment *wanted, const char *what, uint32_t usage, Stage *stage, Marks *marks) {
    stage->attachments = indices(r, refs);
    marks->now_ref++;
    bool twice = false;
    for EACH(r, k, refs->count) {
        int64_t ref;
        const Image *image = ref_image(r, refs->is.items + k, &ref, 0);
        if (image->format != wanted[k].format || !(image->usage & (image->format ? usage : 32)))
            refuse(r, ": image %lld of format %u and usage %u does not fit the %s", (long long)ref / 2, image->format, image->usage, what);
        if (stage->compute < 0 && (image->width != stage->width || image->height != stage->height))
            refuse(r, ": image %lld is %u x %u, the stage is %u x %u", (long long)ref / 2, image->width, image->height, stage->width,
                stage->height);
        twice |= marks->of_ref[ref] == marks->now_ref;
        marks->of_ref[ref] = marks->now_ref;
        stage->attachments.at[k] = (uint32_t)ref;
    }
    if (twice) r->path[r->depth - 1].index = -1, refuse(r, " names something twice");
}

static void check_dispatch(Reader *r, const Node *node, Stage *stage, Marks *marks) {
    const Variant *v = r->v;
    char shown[SHOWN];
    keys(r, node, "compute groups images outputs count wait", NULL);
    stage->compute = number(r, node, "compute", 0, (int64_t)v->compute_count - 1);
    const Compute *compute = v->computes + stage->compute;
    const Node *groups = open_list(r, node, "groups", 3, MAX_ITEMS);
    for EACH(r, k, 3) stage->groups[k] = (uint32_t)integer(r, groups->is.items + k, 1, MAX_GROUPS);
    pop(r);
    const Node *wait = find(node, "wait");
    if (wait->kind != BOOLEAN) refuse(r, ".wait is %s; a boolean is needed", show(wait, shown));
    stage->wait = wait->is.integer;
    check_written(r, open_list(r, node, "outputs", compute->output_count, MAX_ITEMS), compute->outputs, "compute pipeline", 8, stage, marks);
    pop(r);
    const Node *images = open_list(r, node, "images", compute->binding_count, MAX_ITEMS);
    Draw *draw = make(r, 1, sizeof *draw);
    draw->images = indices(r, images);
    for EACH(r, k, images->count) {
        int64_t ref;
        const Image *image = ref_image(r, images->is.items + k, &ref, 0);
        if (!(image->usage & 4)) refuse(r, ": image %lld lacks usage 4", (long long)ref / 2);
        if (marks->of_ref[ref] == marks->now_ref) refuse(r, ": image %lld is written by the same stage", (long long)ref / 2);
        draw->images.at[k] = (uint32_t)ref;
    }
    pop(r);
    check_count(r, node, marks, draw);
    stage->subpass_count = 1;
    stage->subpasses = make(r, 1, sizeof(Draws));
    *stage->subpasses = (Draws){1, draw};
}

static void check_stage(Reader *r, const Node *node, Stage *stage, Marks *marks) {
    const Variant *v = r->v;
    char shown[SHOWN];
    if (v->has_computes && node->kind == MAP && find(node, "compute")) {
        check_dispatch(r, node, stage, marks);
        return;
    }
    stage->compute = -1;
    keys(r, node, "pass width height attachments wait subpasses", NULL);
    stage->pass = number(r, node, "pass", 0, (int64_t)v->pass_count - 1);
    const Pass *pass = v->passes + stage->pass;
    stage->width = number(r, node, "width", 1, MAX_SIDE);
    stage->height = number(r, node, "height", 1, MAX_SIDE);
    const Node *wait = find(node, "wait");
    if (wait->kind != BOOLEAN) refuse(r, ".wait is %s; a boolean is needed", show(wait, shown));
    stage->wait = wait->is.integer;
    check_written(r, open_list(r, node, "attachments", pass->attachment_count, MAX_ITEMS), pass->attachments, "pass", 16, stage, marks);
    pop(r);
    const Node *subpasses = open_list(r, node, "subpasses", pass->subpass_count, MAX_ITEMS);
    stage->subpass_count = subpasses->count;
    stage->subpasses = make(r, subpasses->count, sizeof(Draws));
    for EACH(r, k, subpasses->count) {
        const Node *draws = list(r, subpasses->is.items + k, -1, MAX_ITEMS);
        stage->subpasses[k] = (Draws){draws->count, make(r, draws->count, sizeof(Draw))};
        push(r, NULL, 0);
        for EACH(r, j, draws->count) check_draw(r, draws->is.items + j, stage, k, marks, stage->subpasses[k].draws + j);
        pop(r);
    }
    pop(r);
}

/* ---- Plans ---- */

/* Values of these roles (bits), none twice. */
static Indices check_list(Reader *r, const Node *plan, const char *key, uint32_t roles, const char *allowed, bool two_slots, Marks *marks) {
    char shown[SHOWN];
    const Node *items = open_list(r, plan, key, -1, MAX_ITEMS);
    Indices found = indices(r, items);
    bool twice = false;
    marks->now_value++;
    for EACH(r, k, items->count) {
        uint32_t x = (uint32_t)integer(r, items->is.items + k, 0, (int64_t)r->v->value_count - 1);
        const Value *value = value_of(r, x);
        if (!(roles >> value->role & 1))
            refuse(r, " is %s %s; %s is allowed", ROLES[value->role], show_name(r, x, shown), allowed);
        if (two_slots && r->v->images[value->image].slots != 2)
            refuse(r, ": the image of %s has one slot; two are needed", show_name(r, x, shown));
        twice |= marks->of_value[x] == marks->now_value;
        marks->of_value[x] = marks->now_value;
        found.at[k] = x;
    }
    if (twice) r->path[r->depth - 1].index = -1, refuse(r, " names something twice");
    pop(r);
    return found;
}

static void check_leave(Reader *r, const Plan *plan, uint32_t k, Marks *marks) {
    const Plan *enter = plan - 1;
    char shown[SHOWN];
    for (uint32_t j = 0; j < plan->updates.count; j++)
        if (value_of(r, plan->updates.at[j])->role != STATE)
            refuse(r, ".updates[%u] is copy %s; what comes after an enter updates states", j, show_name(r, plan->updates.at[j], shown));
    bool alike = plan->updates.count == enter->updates.count && !plan->outputs.count && plan->needs.count == enter->needs.count + 1;
    for (uint32_t j = 0; alike && j < plan->updates.count; j++) {
        const Value *a = value_of(r, plan->updates.at[j]), *b = value_of(r, enter->updates.at[j]);
        alike = a->channels == b->channels && a->is_int == b->is_int;
    }
    for (uint32_t j = 0; alike && j < plan->needs.count; j++)
        alike = plan->needs.at[j] == (j < enter->needs.count ? enter->needs.at[j] : k - 1);
    if (!alike)
        refuse(r, ": after the enter plans[%u] a plan is needed that updates states of the same types, gives nothing out, and needs it "
               "and what it needs", k - 1);
    marks->now_value++;
    for (uint32_t j = 0; j < enter->updates.count; j++) marks->of_value[enter->updates.at[j]] = marks->now_value;
    uint32_t strange = UINT32_MAX;
    for (uint32_t j = 0; j < plan->reads.count; j++)
        if (marks->of_value[plan->reads.at[j]] != marks->now_value && plan->reads.at[j] < strange) strange = plan->reads.at[j];
    if (strange != UINT32_MAX)
        refuse(r, " reads %s; what comes after an enter reads its copies alone", show_name(r, strange, shown));
}

static void check_plan_needs(Reader *r, const Node *node, uint32_t k, Plan *plan) {
    const Node *needs = open_list(r, node, "needs", -1, MAX_NEEDS);
    plan->needs = indices(r, needs);
    int64_t low = 0;
    for EACH(r, j, needs->count) {
        uint32_t x = plan->needs.at[j] = (uint32_t)integer(r, needs->is.items + j, low, (int64_t)k - 1);
        const Plan *other = r->v->plans + x;
        low = x + 1;
        if (other->purpose != GIVES && other->purpose != ENTER) refuse(r, ": plans[%u] updates something", x);
        for (uint32_t n = 0; n < other->needs.count; n++) /* rising: the first missing is the least */
            if (!has((Indices){j, plan->needs.at}, other->needs.at[n]))
                refuse(r, ": plans[%u] needs plans[%u], which is not among them", x, other->needs.at[n]);
    }
    pop(r);
}

static void check_plan(Reader *r, const Node *node, uint32_t k, Marks *marks) {
    Plan *plan = r->v->plans + k;
    bool leave = k && plan[-1].purpose == ENTER;
    keys(r, node, "name stages updates reads outputs needs steps", NULL);
    plan->name = text(r, node, "name");
    plan->steps = number(r, node, "steps", 0, INT64_C(1) << 40);
    plan->updates = check_list(r, node, "updates", 1 << STATE | 1 << COPY, "state or copy", !leave, marks);
    plan->reads = check_list(r, node, "reads", 1 << INPUT | 1 << STATE | 1 << COPY, "input or state or copy", false, marks);
    plan->outputs = check_list(r, node, "outputs", 1 << OUTPUT, "output", false, marks);
    check_plan_needs(r, node, k, plan);
    bool fills = false;
    for (uint32_t j = 0; j < plan->updates.count; j++) fills |= value_of(r, plan->updates.at[j])->role == COPY;
    for (uint32_t j = 0; j < plan->needs.count; j++) fills &= r->v->plans[plan->needs.at[j]].purpose != ENTER;
    plan->purpose = leave ? LEAVE : fills ? ENTER : plan->updates.count ? PHASE : GIVES;
    if (leave) check_leave(r, plan, k, marks);
    const Node *stages = open_list(r, node, "stages", -1, MAX_ITEMS);
    plan->stage_count = stages->count;
    plan->stages = make(r, stages->count, sizeof(Stage));
    for EACH(r, j, stages->count) check_stage(r, stages->is.items + j, plan->stages + j, marks);
    pop(r);
}

/* Each copy is filled by one enter, which whatever else touches it needs. */
static void check_copies(Reader *r) {
    const Variant *v = r->v;
    char shown[SHOWN];
    int *enter_of = make_scratch(r, v->value_count, sizeof *enter_of);
    for (uint32_t x = 0; x < v->value_count; x++) enter_of[x] = -1;
    push(r, "plans", 0);
    for EACH(r, k, v->plan_count) {
        const Plan *plan = v->plans + k;
        if (plan->purpose != ENTER) continue;
        bool only = k + 1 < v->plan_count && plan[1].purpose == LEAVE;
        for (uint32_t j = 0; j < plan->updates.count; j++) only &= value_of(r, plan->updates.at[j])->role == COPY;
        if (!only) refuse(r, " fills copies; it updates nothing else, and the plan after it gives them back");
        for (uint32_t j = 0; j < plan->updates.count; j++) {
            uint32_t x = plan->updates.at[j];
            if (enter_of[x] >= 0) refuse(r, " fills copy %s, as plans[%d] does", show_name(r, x, shown), enter_of[x]);
            enter_of[x] = k;
        }
    }
    uint32_t *counts = make_scratch(r, v->plan_count, sizeof *counts);
    for EACH(r, k, v->plan_count) {
        const Plan *plan = v->plans + k;
        for (uint32_t j = 0; j < plan->updates.count + plan->reads.count; j++) {
            uint32_t x = j < plan->updates.count ? plan->updates.at[j] : plan->reads.at[j - plan->updates.count];
            if (value_of(r, x)->role == COPY && enter_of[x] != (int)k && (enter_of[x] < 0 || !has(plan->needs, enter_of[x])))
                refuse(r, " has to do with copy %s, and needs no plan that fills it", show_name(r, x, shown));
        }
        for (int pass = 0; pass < 3; pass++) /* count, compare, and forget again */
            for (uint32_t j = 0; j < plan->updates.count; j++) {
                int n = enter_of[plan->updates.at[j]];
                if (n < 0) continue;
                if (pass == 0) counts[n]++;
                else if (pass == 2) counts[n] = 0;
                else if (counts[n] != v->plans[n].updates.count)
                    refuse(r, " updates %u of the %u copies that plans[%d] fills; all or none is allowed", counts[n],
                           v->plans[n].updates.count, n);
            }
    }
    pop(r);
}

void check_plans(Reader *r) {
    Variant *v = r->v;
    char shown[SHOWN];
    Marks marks = {make_scratch(r, v->value_count, 4), make_scratch(r, 2 * (uint64_t)v->image_count, 4), 0, 0};
    const Node *plans = open_list(r, v->root, "plans", -1, MAX_PLANS);
    const bool *taken = repeated(r, plans);
    v->plan_count = plans->count;
    v->plans = make(r, plans->count, sizeof(Plan));
    for EACH(r, k, plans->count) {
        check_plan(r, plans->is.items + k, k, &marks);
        if (taken[k]) refuse(r, ".name %s is taken", show(find(plans->is.items + k, "name"), shown));
    }
    pop(r);
    check_copies(r);
    check_flow(r, &marks);
}
