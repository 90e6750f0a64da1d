/* Running plans: what they need first, what is unchanged and skipped, copies and the states they stand for. docs/bundle-format.md, 7 to 9
   of "From bytes to results", and "Copies". */

#include "session.h"

#include <stdio.h>
#include <string.h>

/* ---- What a plan is, found once ---- */

static Indices gather(Session *s, Call *call, const uint32_t *items, uint32_t count) {
    Indices found = {count, grow(call, &s->bundle.arena, count, sizeof(uint32_t))};
    if (count) memcpy(found.at, items, count * sizeof *items);
    return found;
}

static void add(uint32_t *items, uint32_t *count, uint32_t *seen, uint32_t mark, Indices more) {
    for (uint32_t k = 0; k < more.count; k++)
        if (seen[more.at[k]] != mark) {
            seen[more.at[k]] = mark;
            items[(*count)++] = more.at[k];
        }
}

static void prepare_plan(Session *s, Call *call, uint32_t k, uint32_t *seen_value, uint32_t *seen_image) {
    const Variant *v = s->v;
    const Plan *plan = v->plans + k;
    PlanState *state = s->plans + k;
    uint32_t *items = spare(s, call, v->value_count > v->image_count ? v->value_count : v->image_count, 4), count = 0;
    add(items, &count, seen_value, 2 * k + 1, plan->reads);
    for (uint32_t n = 0; n < plan->needs.count; n++) add(items, &count, seen_value, 2 * k + 1, v->plans[plan->needs.at[n]].reads);
    state->reads = gather(s, call, items, count);
    state->seen = grow(call, &s->bundle.arena, count, sizeof *state->seen);
    uint32_t inputs = 0;
    for (uint32_t j = 0; j < count; j++)
        if (v->values[items[j]].role == INPUT) items[inputs++] = items[j];
    state->inputs = gather(s, call, items, inputs);
    count = 0;
    add(items, &count, seen_value, 2 * k + 2, plan->reads);
    add(items, &count, seen_value, 2 * k + 2, plan->updates);
    state->touches = gather(s, call, items, count);
    count = 0;
    for (uint32_t n = 0; n < plan->stage_count; n++) {
        const Stage *stage = plan->stages + n;
        for (uint32_t a = 0; a < stage->attachments.count; a++) {
            uint32_t image = stage->attachments.at[a] / 2;
            if (v->images[image].slots == 2) add(items, &count, seen_image, k + 1, (Indices){1, &image});
        }
        for (uint32_t j = 0; j < stage->subpass_count; j++)
            for (uint32_t d = 0; d < stage->subpasses[j].count; d++) {
                const Draw *draw = stage->subpasses[j].draws + d;
                for (uint32_t b = 0; b <= draw->images.count; b++) {
                    int64_t ref = b < draw->images.count ? draw->images.at[b] : draw->count;
                    uint32_t image = (uint32_t)(ref / 2);
                    if (ref >= 0 && v->images[image].slots == 2) add(items, &count, seen_image, k + 1, (Indices){1, &image});
                }
            }
    }
    state->slots = gather(s, call, items, count);
}

void prepare_plans(Session *s, Call *call) {
    const Variant *v = s->v;
    Arena *arena = &s->bundle.arena;
    uint32_t *seen_value = spare(s, call, v->value_count, 4), *seen_image = spare(s, call, v->image_count, 4);
    PlanState *plans = grow(call, arena, v->plan_count, sizeof *plans);
    s->phases.at = grow(call, arena, v->plan_count, sizeof(uint32_t));
    s->phase = -1;
    s->parity = grow(call, arena, v->image_count, 1);
    s->version = grow(call, arena, v->value_count, sizeof *s->version);
    s->given = grow(call, arena, v->value_count, 1);
    s->plans = plans;
    for (uint32_t k = 0; k < v->plan_count; k++) {
        prepare_plan(s, call, k, seen_value, seen_image);
        if (v->plans[k].purpose == PHASE) s->phases.at[s->phases.count++] = k, s->phase = 0;
    }
    for (uint32_t k = 0; k < v->value_count; k++) {
        uint64_t bytes = image_bytes(v->images + v->values[k].image);
        s->given[k] = v->values[k].role != INPUT || v->values[k].initial >= 0 || v->values[k].filled;
        if (v->values[k].role != COPY && bytes > s->largest) s->largest = bytes;
    }
}

/* ---- Running ---- */

static void check_inputs(Session *s, Call *call, uint32_t plan) {
    Indices inputs = s->plans[plan].inputs;
    char names[300] = "";
    for (uint32_t k = 0; k < inputs.count; k++)
        if (!s->given[inputs.at[k]])
            snprintf(names + strlen(names), sizeof names - strlen(names), "%s%s", *names ? " " : "", s->v->values[inputs.at[k]].name);
    if (*names) fail(call, DRESSI_INPUT, "%.100s needs %s; set it first", s->v->plans[plan].name, names);
}

static bool meet(Indices a, Indices b) {
    for (uint32_t k = 0; k < a.count; k++)
        if (has(b, a.at[k])) return true;
    return false;
}

void give_back(Session *s, Call *call, Indices values) {
    for (uint32_t k = 0; k + 1 < s->v->plan_count; k++) {
        if (!s->plans[k].out || !meet(s->v->plans[k + 1].updates, values)) continue;
        VkCommandBuffer commands = recording(s, call, k + 1, false);
        send(s, call, &commands, 1);
        settle(s, call);
        s->plans[k + 1].runs++;
        s->plans[k].out = false;
    }
}

static void remember(Session *s, uint32_t plan) {
    PlanState *state = s->plans + plan;
    for (uint32_t k = 0; k < state->reads.count; k++) state->seen[k] = s->version[state->reads.at[k]];
    state->has_seen = true;
}

/* Once a phase has new copies: the states have new values, and these copies are what an enter would make. */
static void take_out(Session *s, uint32_t plan) {
    const Variant *v = s->v;
    for (uint32_t k = 0; k + 1 < v->plan_count; k++) {
        if (v->plans[k].purpose != ENTER || !meet(v->plans[k].updates, v->plans[plan].updates)) continue;
        for (uint32_t j = 0; j < v->plans[k + 1].updates.count; j++) s->version[v->plans[k + 1].updates.at[j]]++;
        s->plans[k].out = true;
    }
    for (uint32_t k = 0; k + 1 < v->plan_count; k++)
        if (v->plans[k].purpose == ENTER && meet(v->plans[k].updates, v->plans[plan].updates)) remember(s, k);
}

void run_if_changed(Session *s, Call *call, uint32_t plan, bool prepared) {
    PlanState *state = s->plans + plan;
    bool same = state->has_seen;
    for (uint32_t k = 0; same && k < state->reads.count; k++) same = state->seen[k] == s->version[state->reads.at[k]];
    if (same) {
        state->skipped++;
        return;
    }
    check_inputs(s, call, plan);
    uint64_t *versions = spare(s, call, state->reads.count, sizeof *versions); /* those before it ran */
    for (uint32_t k = 0; k < state->reads.count; k++) versions[k] = s->version[state->reads.at[k]];
    run_plan(s, call, plan, 1, prepared);
    for (uint32_t k = 0; k < state->reads.count; k++) state->seen[k] = versions[k];
    state->has_seen = true;
}

void run_plan(Session *s, Call *call, uint32_t k, uint64_t n, bool prepared) {
    const Plan *plan = s->v->plans + k;
    PlanState *state = s->plans + k;
    check_inputs(s, call, k);
    for (uint32_t j = 0; j < plan->needs.count && !prepared; j++) run_if_changed(s, call, plan->needs.at[j], true);
    give_back(s, call, state->touches);
    VkCommandBuffer pair[2] = {recording(s, call, k, false), VK_NULL_HANDLE};
    pair[1] = plan->updates.count && n > 1 ? recording(s, call, k, true) : pair[0];
    VkCommandBuffer *commands = spare(s, call, n, sizeof *commands);
    for (uint64_t j = 0; j < n; j++) commands[j] = pair[j % 2];
    send(s, call, commands, (uint32_t)n);
    settle(s, call);
    state->runs += n;
    for (uint32_t j = 0; j < plan->updates.count; j++) {
        const Value *value = s->v->values + plan->updates.at[j];
        s->version[plan->updates.at[j]]++;
        s->parity[value->image] ^= n & 1;
    }
    if (plan->purpose == PHASE) take_out(s, k);
    if (!state->kept) {
        state->kept = true;
        keep_cache(s);
    }
}
