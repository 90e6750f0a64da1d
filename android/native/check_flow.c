/* The flow of data: plans read what a constant, an input, a state, an earlier stage or a plan that they need has filled; they write what
   is theirs, wait where they must, and say what they read. As `check_dataflow` in dressi_edge/cache/bundle_plans.py. */

#include "inside.h"

typedef struct Flow {
    uint8_t *given;         /* by ref: constants, inputs, the current slots of states and copies */
    uint32_t *owned;        /* by ref: the plan, counted from 1, that may write it */
    uint32_t *mine;         /* by ref: the plan, counted from 1, that attached it last */
    int *kept;              /* by ref: the plan whose result others read, or -1 */
    uint32_t *read, *wrote; /* by ref: the last stage that did, counted from 1 through all plans */
    uint32_t *listed, now;  /* by ref: the stage whose list of samples it is in */
    Indices *writes;        /* by plan: the refs that it attaches, sorted */
} Flow;

/* What a stage samples and does not attach, sorted. */
static Indices samples_of(Reader *r, const Stage *stage, Flow *f, const uint32_t *attached, uint32_t mark) {
    uint32_t count = 0, found = 0, subpasses = stage->subpass_count;
    for (uint32_t s = 0; s < subpasses; s++)
        for (uint32_t d = 0; d < stage->subpasses[s].count; d++) count += stage->subpasses[s].draws[d].images.count + 1;
    uint32_t *at = make_scratch(r, count, sizeof *at), *spare = make_scratch(r, count, sizeof *spare);
    for (uint32_t s = 0; s < subpasses; s++)
        for (uint32_t d = 0; d < stage->subpasses[s].count; d++) {
            const Draw *draw = stage->subpasses[s].draws + d;
            for (uint32_t k = 0; k <= draw->images.count; k++) {
                int64_t ref = k < draw->images.count ? draw->images.at[k] : draw->count;
                if (ref < 0 || attached[ref] == mark || f->listed[ref] == mark) continue;
                f->listed[ref] = mark;
                at[found++] = (uint32_t)ref;
            }
        }
    sort_numbers(at, spare, found);
    return (Indices){found, at};
}

static bool contains(Indices sorted, uint32_t x) {
    uint32_t low = 0, high = sorted.count;
    while (low < high) {
        uint32_t middle = low + (high - low) / 2;
        if (sorted.at[middle] < x) low = middle + 1;
        else high = middle;
    }
    return low < sorted.count && sorted.at[low] == x;
}

static void check_samples(Reader *r, uint32_t k, Indices sampled, Flow *f, const Marks *reads) {
    const Variant *v = r->v;
    const Plan *plan = v->plans + k;
    char shown[SHOWN];
    for (uint32_t j = 0; j < sampled.count; j++) {
        uint32_t ref = sampled.at[j];
        int value = v->images[ref / 2].value;
        if (f->given[ref] && f->owned[ref] != k + 1) {
            if (value >= 0 && reads->of_value[value] != reads->now_value)
                refuse(r, " reads %s, which plans[%u].reads lacks", show_name(r, value, shown), k);
        } else if (f->mine[ref] != k + 1) {
            int source = -1;
            for (uint32_t n = 0; n < plan->needs.count && source < 0; n++)
                if (contains(f->writes[plan->needs.at[n]], ref)) source = plan->needs.at[n];
            if (source < 0) refuse(r, " reads image %u, which nothing has written", ref / 2);
            f->kept[ref] = source;
        }
    }
}

static void check_stage_flow(Reader *r, uint32_t k, const Stage *stage, Flow *f, Marks *reads, uint32_t *attached, uint32_t *waited) {
    const Variant *v = r->v;
    bool first = !*waited, hazard = first, leave = v->plans[k].purpose == LEAVE;
    const char *key = stage->compute < 0 ? "attachments" : "outputs";
    uint32_t now = ++f->now;
    for (uint32_t n = 0; n < stage->attachments.count; n++) {
        uint32_t ref = stage->attachments.at[n];
        bool own = f->owned[ref] == k + 1;
        if ((f->given[ref] && !own) || (v->images[ref / 2].value >= 0 && !own))
            refuse(r, ".%s[%u]: image %u is not for this plan to write", key, n, ref / 2);
        if (leave && own && load_of(v, stage, n)) refuse(r, ".%s[%u]: what comes after an enter loads the states that it updates", key, n);
        attached[ref] = now;
        hazard |= f->wrote[ref] >= *waited || f->read[ref] >= *waited;
    }
    int64_t outside = -1;
    for (uint32_t s = 0; s < stage->subpass_count; s++)
        for (uint32_t d = 0; d < stage->subpasses[s].count; d++) {
            int64_t ref = stage->subpasses[s].draws[d].count;
            if (ref >= 0 && f->given[ref] && (outside < 0 || ref < outside)) outside = ref;
        }
    if (outside >= 0)
        refuse(r, " draws as often as image %lld says, which is given from outside; what a stage makes is allowed",
               (long long)outside / 2);
    Indices sampled = samples_of(r, stage, f, attached, now);
    check_samples(r, k, sampled, f, reads);
    for (uint32_t j = 0; j < sampled.count; j++) hazard |= f->wrote[sampled.at[j]] >= *waited;
    if (hazard && !stage->wait)
        refuse(r, ".wait is false; the stage touches what was written, or writes what was read, since the last wait");
    if (stage->wait) *waited = now;
    for (uint32_t j = 0; j < sampled.count; j++) f->read[sampled.at[j]] = now;
    for (uint32_t n = 0; n < stage->attachments.count; n++) f->wrote[stage->attachments.at[n]] = now,
        f->mine[stage->attachments.at[n]] = k + 1;
}

/* All that a plan attaches, sorted, each once. */
static Indices written_by(Reader *r, const Plan *plan, uint32_t mark, uint32_t *seen) {
    uint32_t count = 0, found = 0;
    for (uint32_t s = 0; s < plan->stage_count; s++) count += plan->stages[s].attachments.count;
    uint32_t *at = make_scratch(r, count, sizeof *at), *spare = make_scratch(r, count, sizeof *spare);
    for (uint32_t s = 0; s < plan->stage_count; s++)
        for (uint32_t n = 0; n < plan->stages[s].attachments.count; n++) {
            uint32_t ref = plan->stages[s].attachments.at[n];
            if (seen[ref] != mark) at[found++] = ref;
            seen[ref] = mark;
        }
    sort_numbers(at, spare, found);
    return (Indices){found, at};
}

void check_flow(Reader *r, Marks *marks) {
    const Variant *v = r->v;
    uint64_t refs = 2 * (uint64_t)v->image_count;
    char shown[SHOWN];
    Flow f = {.given = make_scratch(r, refs, 1), .owned = make_scratch(r, refs, 4), .mine = make_scratch(r, refs, 4),
              .kept = make_scratch(r, refs, 4), .read = make_scratch(r, refs, 4), .wrote = make_scratch(r, refs, 4),
              .listed = make_scratch(r, refs, 4), .writes = make_scratch(r, v->plan_count, sizeof(Indices))};
    uint32_t *attached = make_scratch(r, refs, 4), *seen = make_scratch(r, refs, 4);
    for (uint64_t ref = 0; ref < refs; ref++) {
        const Image *image = v->images + ref / 2;
        f.given[ref] = !(ref & 1) && (image->data >= 0 || (image->value >= 0 && value_of(r, image->value)->role != OUTPUT));
        f.kept[ref] = -1;
    }
    push(r, "plans", 0);
    for EACH(r, k, v->plan_count) {
        const Plan *plan = v->plans + k;
        uint32_t own_count = plan->updates.count + plan->outputs.count, waited = 0;
        uint32_t *own = make_scratch(r, own_count, 4), *spare = make_scratch(r, own_count, 4);
        marks->now_value++;
        for (uint32_t j = 0; j < plan->reads.count; j++) marks->of_value[plan->reads.at[j]] = marks->now_value;
        for (uint32_t j = 0; j < own_count; j++) {
            bool updated = j < plan->updates.count;
            uint32_t x = updated ? plan->updates.at[j] : plan->outputs.at[j - plan->updates.count];
            own[j] = 2 * value_of(r, x)->image + (updated && plan->purpose != LEAVE);
            f.owned[own[j]] = k + 1;
        }
        push(r, "stages", 0);
        for EACH(r, s, plan->stage_count) check_stage_flow(r, k, plan->stages + s, &f, marks, attached, &waited);
        pop(r);
        sort_numbers(own, spare, own_count);
        for (uint32_t j = 0; j < own_count; j++)
            if (f.mine[own[j]] != k + 1) refuse(r, " does not write %s", show_name(r, v->images[own[j] / 2].value, shown));
        f.writes[k] = written_by(r, plan, k + 1, seen);
    }
    for EACH(r, k, v->plan_count)
        for (uint32_t j = 0; j < f.writes[k].count; j++) {
            uint32_t ref = f.writes[k].at[j];
            if (f.kept[ref] >= 0 && f.kept[ref] != (int)k)
                refuse(r, " writes image %u, which plans[%d] keeps for others", ref / 2, f.kept[ref]);
        }
    pop(r);
}
