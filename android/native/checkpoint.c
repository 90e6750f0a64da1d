/* A session's values and counters as a file, and back: dressi_edge/runtime/checkpoint.py in C; each restores what the other wrote. */

#include "session.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { HEAD = 80, MAX_DESCRIPTION = 1 << 20 };

typedef unsigned long long ull;

/* Whether a checkpoint holds a value: states, inputs that were set, and what phases that have run gave out. */
static bool holds(const Session *s, uint32_t k, const uint64_t *runs, const bool *inputs) {
    const Value *value = s->v->values + k;
    if (value->role == STATE) return true;
    if (value->role == INPUT) return inputs[k] && !is_streamed(s, k); /* pictures are known by the bundle, or whoever gives them */
    for (uint32_t n = 0; value->role == OUTPUT && n < s->phases.count; n++)
        if (runs[n] && has(s->v->plans[s->phases.at[n]].outputs, k)) return true;
    return false;
}

/* Which inputs and states have numbers that `set` would refuse; false and words for the first of them. */
static bool is_finite(const Session *s, uint32_t k, const uint8_t *texels, char *words, size_t room) {
    const Value *value = s->v->values + k;
    if (value->is_int || value->role == OUTPUT) return true;
    uint64_t bad = count_not_finite(value, s->v->images[value->image].format, texels);
    if (bad) snprintf(words, room, "%.100s has %llu values that are NaN or Inf", value->name, (ull)bad);
    return !bad;
}

/* ---- Writing ---- */

static void pack_all(const Session *s, Packed *packed, const uint64_t *runs, Indices kept) {
    pack_head(packed, MAP, 3);
    pack_text(packed, "phase");
    if (s->phase < 0) pack_head(packed, NIL, 0);
    else pack_text(packed, s->v->plans[s->phases.at[s->phase]].name);
    pack_text(packed, "runs");
    pack_head(packed, MAP, s->phases.count);
    for (uint32_t n = 0; n < s->phases.count; n++) {
        pack_text(packed, s->v->plans[s->phases.at[n]].name);
        pack_head(packed, INTEGER, runs[n]);
    }
    pack_text(packed, "values");
    pack_head(packed, ARRAY, kept.count);
    for (uint32_t n = 0; n < kept.count; n++) {
        const Value *value = s->v->values + kept.at[n];
        pack_head(packed, ARRAY, 2);
        pack_text(packed, value->name);
        pack_head(packed, INTEGER, image_bytes(s->v->images + value->image));
    }
}

static void save(Session *s, Call *call, void *arguments) {
    const char *path = arguments;
    uint64_t *runs = spare(s, call, s->phases.count, sizeof *runs), total = 0, at = 0;
    uint32_t *images = spare(s, call, s->v->value_count, 4);
    Indices kept = {0, spare(s, call, s->v->value_count, 4)};
    settle(s, call);
    for (uint32_t n = 0; n < s->phases.count; n++) runs[n] = s->plans[s->phases.at[n]].runs;
    for (uint32_t k = 0; k < s->v->value_count; k++)
        if (holds(s, k, runs, s->given)) {
            images[kept.count] = s->v->values[k].image;
            kept.at[kept.count++] = k;
            place(&total, s->v->images + s->v->values[k].image);
        }
    give_back(s, call, kept);
    if (kept.count) {
        reserve(s, call, total);
        start(s, call);
        copy_out(s, images, kept.count);
        finish(s, call);
    }
    char bad[160];
    for (uint32_t n = 0; n < kept.count; n++)
        if (!is_finite(s, kept.at[n], s->staging.view + place(&at, s->v->images + images[n]), bad, sizeof bad))
            fail(call, DRESSI_INPUT, "%.160s: the checkpoint is not written: %s, and what goes on from there is of no use; restore an "
                 "earlier one, and lower the rates", path, bad);
    at = 0;
    Packed packed = {NULL, 0};
    pack_all(s, &packed, runs, kept);
    packed.at = spare(s, call, packed.size, 1);
    packed.size = 0;
    pack_all(s, &packed, runs, kept);
    uint8_t head[HEAD] = "DRESSICP\1";
    Part *parts = spare(s, call, kept.count + 2, sizeof *parts);
    parts[0] = (Part){head, HEAD};
    parts[1] = (Part){packed.at, packed.size};
    for (uint32_t n = 0; n < kept.count; n++) {
        const Image *image = s->v->images + images[n];
        parts[n + 2] = (Part){s->staging.view + place(&at, image), image_bytes(image)};
    }
    Sha sha;
    sha_begin(&sha);
    for (uint32_t n = 1; n < kept.count + 2; n++) sha_add(&sha, parts[n].data, parts[n].size);
    for (int k = 0; k < 4; k++) head[12 + k] = (uint8_t)(packed.size >> 8 * k);
    memcpy(head + 16, s->bundle.digest, 32);
    sha_end(&sha, head + 48);
    const char *wrong = replace_file(path, parts, kept.count + 2, false);
    trim(s, s->largest);
    if (wrong) fail(call, DRESSI_INPUT, "%.200s: the checkpoint cannot be written: %s", path, wrong);
}

dressi_code dressi_checkpoint(dressi_session *s, const char *path, dressi_error *error) { return serial(s, save, (void *)path, error); }

/* ---- Reading ---- */

typedef struct Restore {
    const char *path;
    uint8_t *data;
    uint64_t size;
    int phase;
    uint64_t *runs;
    bool *inputs;
    uint32_t count;
    Copy *copies;
    uint32_t *values;
} Restore;

static const Node *read_description(Session *s, Call *call, const Restore *r, uint64_t *start_of_data) {
    uint8_t digest[32];
    char mine[65], other[65];
    if (r->size < HEAD) fail(call, DRESSI_BUNDLE, "%llu bytes; a checkpoint has at least %d", (ull)r->size, HEAD);
    if (memcmp(r->data, "DRESSICP", 8)) fail(call, DRESSI_BUNDLE, "not a checkpoint: the file does not begin with DRESSICP");
    if (little32(r->data + 8) != 1) fail(call, DRESSI_BUNDLE, "checkpoint version %u; this reader knows 1", little32(r->data + 8));
    uint64_t left = r->size - HEAD, size = little32(r->data + 12);
    sha256(r->data + HEAD, left, digest);
    if (memcmp(r->data + 48, digest, 32)) fail(call, DRESSI_BUNDLE, "the checksum does not match: the checkpoint is damaged");
    hexadecimal(r->data + 16, 32, other);
    hexadecimal(s->bundle.digest, 32, mine);
    if (strcmp(mine, other))
        fail(call, DRESSI_BUNDLE, "the checkpoint belongs to the bundle with SHA-256 %s; this one has %s", other, mine);
    uint64_t most = left < MAX_DESCRIPTION ? left : MAX_DESCRIPTION;
    if (size > most) fail(call, DRESSI_BUNDLE, "a description of %llu bytes; %llu are allowed", (ull)size, (ull)most);
    *start_of_data = HEAD + size;
    Call inner;
    if (setjmp(inner.out)) fail(call, inner.error.code, "the description is not that of a checkpoint");
    return decode(&inner, &s->scratch, r->data + HEAD, size);
}

/* Whether the nodes are those of a checkpoint; how many bytes its values have together. */
static bool check_types(const Node *d, uint64_t *total) {
    const Node *phase = find(d, "phase"), *runs = find(d, "runs"), *values = find(d, "values");
    bool typed = phase && runs && values && d->count == 3 && (phase->kind == NIL || phase->kind == STRING) && runs->kind == MAP &&
                 values->kind == ARRAY;
    for (uint32_t k = 0; typed && k < runs->count; k++) {
        const Node *pair = runs->is.items + 2 * k;
        typed = pair[0].kind == STRING && pair[1].kind == INTEGER && pair[1].is.integer >= 0;
    }
    *total = 0;
    for (uint32_t k = 0; typed && k < values->count; k++) {
        const Node *row = values->is.items + k;
        typed = row->kind == ARRAY && row->count == 2 && row->is.items[0].kind == STRING && row->is.items[1].kind == INTEGER &&
                row->is.items[1].is.integer >= 0 && row->is.items[1].is.integer <= INT64_MAX / MAX_ITEMS;
        if (typed) *total += (uint64_t)row->is.items[1].is.integer;
    }
    return typed;
}

/* Takes the description apart; false if its values are not those of this bundle. */
static bool take_apart(Session *s, Call *call, Restore *r, const Node *d, uint64_t at) {
    const Node *phase = find(d, "phase"), *runs = find(d, "runs"), *values = find(d, "values");
    r->runs = spare(s, call, s->phases.count, sizeof *r->runs);
    r->inputs = spare(s, call, s->v->value_count, 1);
    r->copies = spare(s, call, values->count, sizeof *r->copies);
    r->values = spare(s, call, values->count, sizeof *r->values);
    if (runs->count != s->phases.count) return false;
    r->phase = -1;
    for (uint32_t n = 0; n < s->phases.count; n++) {
        const char *name = s->v->plans[s->phases.at[n]].name;
        if (!same(runs->is.items + 2 * n, name)) return false;
        r->runs[n] = (uint64_t)runs->is.items[2 * n + 1].is.integer;
        if (same(phase, name)) r->phase = (int)n;
    }
    if ((r->phase < 0) != !s->phases.count || (phase->kind == NIL) != !s->phases.count) return false;
    for (uint32_t n = 0, k = 0; n < values->count; n++, k++) { /* in the order of the bundle */
        const Node *row = values->is.items[n].is.items;
        while (k < s->v->value_count && (s->v->values[k].role == COPY || !same(row, s->v->values[k].name))) k++;
        if (k == s->v->value_count) return false;
        const Value *value = s->v->values + k;
        if ((uint64_t)row[1].is.integer != image_bytes(s->v->images + value->image)) return false;
        r->inputs[k] = value->role == INPUT;
        r->values[r->count] = k;
        r->copies[r->count++] = (Copy){value->image, r->data + at, false};
        at += (uint64_t)row[1].is.integer;
    }
    for (uint32_t n = 0, k = 0; k < s->v->value_count; k++) {
        bool there = n < r->count && r->values[n] == k;
        n += there;
        if (there != holds(s, k, r->runs, r->inputs)) return false;
    }
    return true;
}

/* Bytes that a checkpoint of this bundle can have. */
static uint64_t limit_of(const Session *s) {
    uint64_t limit = HEAD + MAX_DESCRIPTION;
    for (uint32_t k = 0; k < s->v->value_count; k++)
        if (s->v->values[k].role != COPY) limit += image_bytes(s->v->images + s->v->values[k].image);
    return limit;
}

static void read_checkpoint(Session *s, Call *call, Restore *r) {
    uint64_t at, total;
    const Node *d = read_description(s, call, r, &at);
    if (!check_types(d, &total)) fail(call, DRESSI_BUNDLE, "the description is not that of a checkpoint");
    if (total != r->size - at)
        fail(call, DRESSI_BUNDLE, "values of %llu bytes are named, %llu are there, each once", (ull)total, (ull)(r->size - at));
    if (!take_apart(s, call, r, d, at)) fail(call, DRESSI_BUNDLE, "the checkpoint's values are not those of this bundle");
    char bad[160];
    for (uint32_t n = 0; n < r->count; n++)
        if (!is_finite(s, r->values[n], r->copies[n].data, bad, sizeof bad))
            fail(call, DRESSI_BUNDLE, "%s; finite numbers are needed", bad);
}

static void load(Session *s, Call *call, void *arguments) {
    Restore *r = arguments;
    Call inner;
    const char *wrong = read_file(r->path, limit_of(s), false, &r->data, &r->size);
    if (wrong == TOO_LARGE)
        fail(call, DRESSI_BUNDLE, "%.200s: more than the %llu bytes that a checkpoint of this bundle can have", r->path, (ull)limit_of(s));
    if (wrong) fail(call, DRESSI_INPUT, "%.200s: the checkpoint cannot be read: %s", r->path, wrong);
    if (setjmp(inner.out)) fail(call, inner.error.code, "%.200s: %s", r->path, inner.error.text);
    read_checkpoint(s, &inner, r);
    give_back(s, call, (Indices){r->count, r->values});
    upload(s, call, r->copies, r->count);
    for (uint32_t n = 0; n < r->count; n++) s->version[r->values[n]]++;
    for (uint32_t k = 0; k < s->v->value_count; k++)
        if (s->v->values[k].role == INPUT && !is_streamed(s, k)) {
            s->version[k] += !r->inputs[k]; /* what was made from it is no more */
            s->given[k] = r->inputs[k];
        }
    for (uint32_t n = 0; n < r->count; n++) forget_window(s, r->values[n]);
    for (uint32_t n = 0; n < s->phases.count; n++) s->plans[s->phases.at[n]].runs = r->runs[n];
    s->phase = r->phase;
    trim(s, s->largest);
}

dressi_code dressi_restore(dressi_session *s, const char *path, dressi_error *error) {
    Restore *r = calloc(1, sizeof *r);
    if (!r) {
        if (error) *error = (dressi_error){DRESSI_MEMORY, "no memory to restore a checkpoint"};
        return DRESSI_MEMORY;
    }
    r->path = path;
    dressi_code code = serial(s, load, r, error);
    free(r->data);
    free(r);
    return code;
}
