/* Pictures that come to the device as steps need them, and which view a step sees: docs/bundle-format.md, "Pictures" and "Views that are
   kept" (of which nothing is kept here). In: a bundle's meta, and a function that gives pictures. Out: slots filled, inputs set. */

#include "session.h"

#include <string.h>

enum { MAX_VIEWS = 1 << 20, TOGETHER = 1 << 24 }; /* bytes of pictures in one transfer */

/* ---- What a bundle says ---- */

/* The value of that name and kind: its number, or -1. */
static int64_t value_named(const Variant *v, const Node *name, Role role) {
    for (uint32_t k = 0; name && k < v->value_count; k++)
        if (v->values[k].role == role && same(name, v->values[k].name)) return k;
    return -1;
}

static int64_t counter_named(const Variant *v, const Node *name) {
    int64_t k = value_named(v, name, STATE);
    return k >= 0 && v->values[k].is_int && v->values[k].layout == UNIT ? k : -1;
}

/* The view of each step: numbers below `views`. */
static bool read_order(Reader *r, const Node *order, uint32_t views, Indices *found) {
    if (!order || order->kind != BINARY || !order->count || order->count % 4) return false;
    *found = (Indices){order->count / 4, make(r, order->count / 4, sizeof(uint32_t))};
    for (uint32_t k = 0; k < found->count; k++)
        if ((found->at[k] = little32(order->is.bytes + 4 * k)) >= views) return false;
    return true;
}

static bool read_pictures(Reader *r, const Node *meta, Window *w) {
    const Variant *v = r->v;
    const Node *views = find(meta, "views"), *bits = find(meta, "bits"), *order = find(meta, "order"), *steps = find(meta, "steps");
    int64_t k = value_named(v, find(meta, "value"), INPUT);
    if (k < 0 || !views || views->kind != INTEGER || views->is.integer < 1 || views->is.integer > MAX_VIEWS) return false;
    if (!bits || bits->kind != INTEGER || !order || !steps || steps->kind != MAP) return false;
    const Value *value = v->values + k;
    w->value = (uint32_t)k, w->views = (uint32_t)views->is.integer, w->bits = (uint32_t)bits->is.integer;
    bool fits = w->bits == 8 ? value->is_int && value->channels == 1 : w->bits == 16 ? value->is_int && value->channels == 2
        : w->bits == 32 && !value->is_int && value->channels == 4;
    if (value->layout != ATLAS || !fits) return false;
    if (order->kind == NIL ? value->count != w->views : !read_order(r, order, w->views, &w->order)) return false;
    w->counters = make(r, v->plan_count, sizeof *w->counters);
    for (uint32_t p = 0; p < v->plan_count; p++) w->counters[p] = -1;
    for (uint32_t j = 0; j < steps->count; j++) {
        int64_t counter = counter_named(v, steps->is.items + 2 * j + 1);
        if (counter < 0) return false;
        for (uint32_t p = 0; p < v->plan_count; p++)
            if (same(steps->is.items + 2 * j, v->plans[p].name)) w->counters[p] = (int32_t)counter;
    }
    return true;
}

static bool read_turns(Reader *r, const Node *kept, Window *w) {
    if (!kept) return true;
    if (kept->kind != ARRAY) return false;
    w->turns = make(r, kept->count, sizeof *w->turns);
    for (uint32_t j = 0; j < kept->count; j++) {
        const Node *one = kept->is.items + j;
        if (one->kind != MAP) return false;
        int64_t input = value_named(r->v, find(one, "input"), INPUT), counter = counter_named(r->v, find(one, "counter"));
        if (input < 0 || counter < 0 || !r->v->values[input].is_int || r->v->values[input].layout != UNIT) return false;
        w->turns[w->turn_count].input = (uint32_t)input, w->turns[w->turn_count].counter = (uint32_t)counter;
        if (!read_order(r, find(one, "order"), w->views, &w->turns[w->turn_count++].order)) return false;
    }
    return true;
}

void read_window(Reader *r) {
    const Node *meta = find(r->v->root, "meta"), *pictures = find(meta, "pictures");
    if (!pictures) return;
    Window *w = r->v->window = make(r, 1, sizeof *w);
    w->is_malformed = pictures->kind != MAP || !read_pictures(r, pictures, w) || !read_turns(r, find(meta, "kept"), w);
}

/* ---- Of a session ---- */

bool is_streamed(const Session *s, uint32_t value) {
    const Window *w = s->v->window;
    bool is = w && value == w->value;
    for (uint32_t j = 0; w && j < w->turn_count; j++) is |= value == w->turns[j].input;
    return is;
}

void open_window(Session *s, Call *call) {
    const Window *w = s->v->window;
    if (!w) return;
    if (w->is_malformed) fail(call, DRESSI_BUNDLE, "meta.pictures is malformed; compile the bundle again");
    s->held = grow(call, &s->bundle.arena, s->v->values[w->value].count, sizeof *s->held);
    s->shown = grow(call, &s->bundle.arena, w->turn_count, sizeof *s->shown);
    s->counted = grow(call, &s->bundle.arena, s->v->value_count, sizeof *s->counted);
    for (uint32_t k = 0; k < s->v->value_count; k++) s->counted[k] = -1;
    forget_window(s, UINT32_MAX);
}

/* Somebody else has set a value, or all of them. */
void forget_window(Session *s, uint32_t value) {
    const Window *w = s->v->window;
    if (!w) return;
    if (value == UINT32_MAX || value == w->value)
        for (uint32_t k = 0; k < s->v->values[w->value].count; k++) s->held[k] = -1;
    for (uint32_t j = 0; j < w->turn_count; j++)
        if (value == UINT32_MAX || value == w->turns[j].input) s->shown[j] = -1;
    for (uint32_t k = 0; k < s->v->value_count; k++)
        if (value == UINT32_MAX || value == k) s->counted[k] = -1;
}

/* The steps that a state counts, asked of the device where they are not known. */
static uint64_t counted(Session *s, Call *call, uint32_t counter) {
    if (s->counted[counter] < 0) {
        give_back(s, call, (Indices){1, &counter});
        reserve(s, call, image_bytes(s->v->images + s->v->values[counter].image));
        start(s, call);
        copy_out(s, &s->v->values[counter].image, 1);
        finish(s, call);
        int32_t steps;
        memcpy(&steps, s->staging.view, 4);
        s->counted[counter] = steps < 0 ? 0 : steps;
    }
    return (uint64_t)s->counted[counter];
}

static void show_view(Session *s, Call *call, uint32_t j, uint32_t view) {
    uint32_t input = s->v->window->turns[j].input;
    if (s->shown[j] == (int64_t)view) return;
    reserve(s, call, image_bytes(s->v->images + s->v->values[input].image));
    memcpy(s->staging.view, &view, 4);
    start(s, call);
    copy_in(s, &s->v->values[input].image, 1);
    finish(s, call);
    s->version[input]++;
    s->given[input] = true;
    s->shown[j] = view;
}

size_t picture_bytes(const Session *s) {
    const Value *value = s->v->values + s->v->window->value;
    return (size_t)value->width * value->height * 4 * (s->v->window->bits / 8);
}

/* One picture as texels of its slot; other: room for what was read, where that is not the same. */
static void read_picture(Session *s, Call *call, uint32_t view, uint8_t *texels, void *other) {
    const Window *w = s->v->window;
    const Value *value = s->v->values + w->value;
    if (s->read(s->context, view, w->bits == 32 ? other : texels))
        fail(call, DRESSI_INPUT, "%.100s: picture %u cannot be had", value->name, view);
    if (w->bits < 32) return;
    Value one = *value;
    one.layout = IMAGE, one.count = 1, one.columns = 1;
    to_texels(call, &one, s->v->images[value->image].format, other, texels);
}

/* Puts pictures into slots: `slots` and `views` of `count`. */
static void fill_slots(Session *s, Call *call, const uint32_t *slots, const uint32_t *views, uint32_t count) {
    const Value *value = s->v->values + s->v->window->value;
    uint64_t size = (uint64_t)value->width * value->height * texel_bytes(s->v->images[value->image].format);
    VkBufferImageCopy *copies = spare(s, call, count, sizeof *copies);
    void *other = s->v->window->bits == 32 ? spare(s, call, picture_bytes(s), 1) : NULL;
    settle(s, call);
    reserve(s, call, size * count);
    for (uint32_t k = 0; k < count; k++) {
        read_picture(s, call, views[k], s->staging.view + size * k, other);
        int32_t x = (int32_t)(slots[k] % value->columns * value->width), y = (int32_t)(slots[k] / value->columns * value->height);
        copies[k] = (VkBufferImageCopy){size * k, 0, 0, {VK_IMAGE_ASPECT_COLOR_BIT, 0, 0, 1}, {x, y, 0}, {value->width, value->height, 1}};
        s->held[slots[k]] = -1;
    }
    start(s, call);
    barrier(s, s->commands);
    s->device->vk.CmdCopyBufferToImage(s->commands, s->staging.buffer, current(s, value->image), VK_IMAGE_LAYOUT_GENERAL, count, copies);
    barrier(s, s->commands);
    finish(s, call);
    s->version[s->v->window->value]++;
    s->given[s->v->window->value] = true;
    for (uint32_t k = 0; k < count; k++) s->held[slots[k]] = views[k];
}

/* Pictures of n steps from `step` on, or of all views. */
static void fill_window(Session *s, Call *call, uint64_t step, uint64_t n) {
    const Window *w = s->v->window;
    uint32_t slots = s->v->values[w->value].count, count = 0, most = (uint32_t)(TOGETHER / picture_bytes(s));
    uint32_t *slot = spare(s, call, slots, 4), *view = spare(s, call, slots, 4);
    if (!most) most = 1;
    for (uint64_t k = 0; k < (w->order.count ? n : slots); k++) {
        uint32_t at = (uint32_t)((step + k) % slots), wanted = w->order.count ? w->order.at[(step + k) % w->order.count] : (uint32_t)k;
        if (s->held[at] == (int64_t)wanted) continue;
        slot[count] = at, view[count++] = wanted;
    }
    for (uint32_t first = 0; first < count; first += most)
        fill_slots(s, call, slot + first, view + first, count - first < most ? count - first : most);
}

uint64_t look(Session *s, Call *call, uint32_t plan, uint64_t n) {
    const Window *w = s->v->window;
    if (!w || !s->read) return n;
    if (has(s->plans[plan].inputs, w->value)) {
        if (w->order.count && w->counters[plan] < 0)
            fail(call, DRESSI_BUNDLE, "meta.pictures does not say which steps %.100s counts; compile the bundle again", s->v->plans[plan].name);
        if (w->order.count && n > s->v->values[w->value].count) n = s->v->values[w->value].count;
        fill_window(s, call, w->order.count ? counted(s, call, (uint32_t)w->counters[plan]) : 0, n);
    }
    for (uint32_t j = 0; j < w->turn_count; j++)
        if (has(s->plans[plan].inputs, w->turns[j].input)) {
            show_view(s, call, j, w->turns[j].order.at[counted(s, call, w->turns[j].counter) % w->turns[j].order.count]);
            n = 1; /* the next step sees another */
        }
    return n;
}

/* What states count once a plan has run n times, or nothing of it where it did not come to its end. */
static void count_steps(Session *s, uint32_t plan, const int64_t *before, uint64_t n) {
    Indices updates = s->v->plans[plan].updates;
    for (uint32_t k = 0; s->counted && k < updates.count; k++) {
        uint32_t x = updates.at[k];
        bool is_counter = before && before[k] >= 0 && before[k] + (int64_t)n <= INT32_MAX;
        s->counted[x] = is_counter ? before[k] + (int64_t)n : -1;
    }
}

void run_steps(Session *s, Call *call, uint32_t plan, uint64_t n) {
    Indices updates = s->v->plans[plan].updates;
    while (n) {
        uint64_t now = look(s, call, plan, n);
        int64_t *before = spare(s, call, updates.count, sizeof *before);
        for (uint32_t k = 0; k < updates.count; k++) before[k] = s->counted ? s->counted[updates.at[k]] : -1;
        count_steps(s, plan, NULL, 0);
        run_plan(s, call, plan, now, false);
        count_steps(s, plan, before, now);
        n -= now;
        drop(&s->scratch);
    }
}

/* ---- For callers ---- */

int dressi_picture_of(const dressi_session *s, dressi_picture *about) {
    const Window *w = s->v->window;
    if (!w) return 0;
    const Value *value = s->v->values + w->value;
    *about = (dressi_picture){w->views, value->width, value->height, (int)w->bits, picture_bytes(s)};
    return 1;
}

typedef struct Given { dressi_read read; void *context; } Given;

static void give_pictures(Session *s, Call *call, void *arguments) {
    const Given *given = arguments;
    if (!s->v->window) fail(call, DRESSI_INPUT, "the bundle has its pictures, all of them on the device; give others with dressi_set");
    s->read = given->read, s->context = given->context;
    forget_window(s, UINT32_MAX);
}

dressi_code dressi_pictures(dressi_session *s, dressi_read read, void *context, dressi_error *error) {
    return serial(s, give_pictures, &(Given){read, context}, error);
}
