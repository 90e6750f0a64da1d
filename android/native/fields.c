/* Reading fields of a description: each function checks what it gives, and refuses the rest with the path of what is wrong. */

#include "inside.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* ---- Refusing, with the path of what is wrong ---- */

static _Noreturn void refuse_at(Reader *r, bool with_path, const char *format, va_list rest) {
    Text text = {0};
    char line[sizeof r->call->error.text] = "no memory";
    if (r->variant >= 0) say(&text, "variants[%d]: ", r->variant);
    for (int k = 0; with_path && k < r->depth; k++) {
        if (r->path[k].key) say(&text, "%s%s", k ? "." : "", r->path[k].key);
        if (r->path[k].index >= 0) say(&text, "[%lld]", (long long)r->path[k].index);
    }
    if (!text.broken) {
        snprintf(line, sizeof line, "%s", text.at ? text.at : "");
        vsnprintf(line + strlen(line), sizeof line - strlen(line), format, rest);
    }
    free(text.at);
    fail(r->call, DRESSI_BUNDLE, "%s", line);
}

_Noreturn void refuse(Reader *r, const char *format, ...) {
    va_list rest;
    va_start(rest, format);
    refuse_at(r, true, format, rest);
}

_Noreturn void refuse_plainly(Reader *r, const char *format, ...) {
    va_list rest;
    va_start(rest, format);
    refuse_at(r, false, format, rest);
}

void *make(Reader *r, uint64_t count, size_t size) { return grow(r->call, r->kept, count, size); }
void *make_scratch(Reader *r, uint64_t count, size_t size) { return grow(r->call, &r->scratch, count, size); }

/* ---- Fields: each checks what it gives ---- */

/* A map of exactly these keys, in this order of complaints. `where` NULL: what the path says. */
void keys(Reader *r, const Node *map, const char *names, const char *where) {
    char shown[SHOWN], word[32];
    const char *said = where ? where : "";
    if (where) r->depth = 0;
    if (map->kind != MAP) refuse(r, "%s is %s; a map is needed", said, show(map, shown));
    for (const char *p = names; *p;) {
        int n = (int)strcspn(p, " ");
        snprintf(word, sizeof word, "%.*s", n, p);
        p += n + (p[n] == ' ');
        if (!find(map, word)) refuse(r, "%s lacks %s", said, word);
    }
    for (uint32_t k = 0; k < map->count; k++) {
        const Node *key = map->is.items + 2 * k;
        bool known = false;
        for (const char *p = names; *p && key->kind == STRING;) {
            size_t n = strcspn(p, " ");
            known |= key->count == n && !memcmp(key->is.bytes, p, n);
            p += n + (p[n] == ' ');
        }
        if (!known) refuse(r, "%s has the unknown key %s", said, show(key, shown));
    }
}

int64_t integer(Reader *r, const Node *node, int64_t low, int64_t high) {
    char shown[SHOWN];
    if (node->kind != INTEGER || node->is.integer < low || node->is.integer > high)
        refuse(r, " is %s; an integer from %lld to %lld is allowed", show(node, shown), (long long)low, (long long)high);
    return node->is.integer;
}

int64_t number(Reader *r, const Node *map, const char *key, int64_t low, int64_t high) {
    push(r, key, -1);
    int64_t x = integer(r, find(map, key), low, high);
    pop(r);
    return x;
}

const Node *list(Reader *r, const Node *node, int64_t length, uint32_t most) {
    char shown[SHOWN];
    if (node->kind != ARRAY || node->count > most || (length >= 0 && node->count != length)) {
        if (length >= 0) refuse(r, " is %s; a list of %lld is needed", show(node, shown), (long long)length);
        refuse(r, " is %s; a list of at most %u is allowed", show(node, shown), most);
    }
    return node;
}

const Node *open_list(Reader *r, const Node *map, const char *key, int64_t length, uint32_t most) {
    push(r, key, -1);
    return list(r, find(map, key), length, most);
}

const char *text(Reader *r, const Node *map, const char *key) {
    const Node *node = find(map, key);
    char shown[SHOWN];
    uint32_t characters = 0;
    bool sound = node->kind == STRING;
    for (uint32_t k = 0; sound && k < node->count; k++) {
        const uint8_t *p = node->is.bytes + k;
        sound = *p >= 0x20 && *p != 0x7f && !(*p == 0xc2 && p[1] < 0xa0);
        characters += *p >> 6 != 2;
    }
    push(r, key, -1);
    if (!sound || characters < 1 || characters > 200)
        refuse(r, " is %s; a text of 1 to 200 characters, none of control, is needed", show(node, shown));
    pop(r);
    char *copy = make(r, node->count + 1, 1);
    memcpy(copy, node->is.bytes, node->count);
    return copy;
}

/* Where in the list of words this one is, or -1. */
static int place_of(const char *words, const uint8_t *word, size_t length) {
    int k = 0;
    for (const char *p = words; *p; k++) {
        size_t n = strcspn(p, " ");
        if (n == length && !memcmp(p, word, n)) return k;
        p += n + (p[n] == ' ');
    }
    return -1;
}

uint32_t number_of(Reader *r, const Node *node, const char *allowed) {
    char shown[SHOWN], word[24];
    int n = node->kind == INTEGER ? snprintf(word, sizeof word, "%lld", (long long)node->is.integer) : 0;
    if (!n || place_of(allowed, (uint8_t *)word, n) < 0) refuse(r, " is %s; allowed: %s", show(node, shown), allowed);
    return (uint32_t)node->is.integer;
}

uint32_t word_of(Reader *r, const Node *map, const char *key, const char *allowed) {
    const Node *node = find(map, key);
    char shown[SHOWN];
    int k = node->kind == STRING ? place_of(allowed, node->is.bytes, node->count) : -1;
    push(r, key, -1);
    if (k < 0) refuse(r, " is %s; allowed: %s", show(node, shown), allowed);
    pop(r);
    return k;
}

static bool name_before(uint32_t a, uint32_t b, const void *context) {
    const Node *x = ((const Node *const *)context)[a], *y = ((const Node *const *)context)[b];
    if (!x || !y) return !x && y;
    if (x->count != y->count) return x->count < y->count;
    return x->count && memcmp(x->is.bytes, y->is.bytes, x->count) < 0;
}

bool *repeated(Reader *r, const Node *list) {
    uint32_t n = list->count, *order = make_scratch(r, n, sizeof *order), *spare = make_scratch(r, n, sizeof *spare);
    const Node **names = make_scratch(r, n, sizeof *names);
    bool *found = make_scratch(r, n, 1);
    for (uint32_t k = 0; k < n; k++) {
        const Node *name = find(list->is.items + k, "name");
        names[k] = name && name->kind == STRING ? name : NULL;
        order[k] = k;
    }
    sort(order, spare, n, name_before, names); /* keeps equal ones in their order */
    for (uint32_t k = 1; k < n; k++)
        found[order[k]] = names[order[k]] && !name_before(order[k - 1], order[k], names);
    return found;
}
