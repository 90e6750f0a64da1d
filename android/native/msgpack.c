/* MessagePack: a description as a tree of nodes of 16 bytes, none more than it has bytes; and back, as far as checkpoints need it.

   Headers claim sizes: they are added up before anything is made. What is refused, and in which words, is as in
   dressi_edge/cache/bundle.py. */

#include "inside.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { MAX_DEPTH = 1024, MOST = 1 << 22 };

/* What a first byte announces: bytes of a number after it, or of a length or count, or the count itself. */
typedef struct Token { Kind kind; uint8_t number, length; uint32_t count; bool known; } Token;

static Token token(uint8_t tag) {
    Token t = {.known = true};
    if (tag < 0x80 || tag >= 0xe0) t.kind = INTEGER;
    else if (tag < 0x90) t.kind = MAP, t.count = tag & 15;
    else if (tag < 0xa0) t.kind = ARRAY, t.count = tag & 15;
    else if (tag < 0xc0) t.kind = STRING, t.count = tag & 31;
    else switch (tag) {
    case 0xc0: t.kind = NIL; break;
    case 0xc2: case 0xc3: t.kind = BOOLEAN; break;
    case 0xc4: case 0xc5: case 0xc6: t.kind = BINARY, t.length = 1 << (tag - 0xc4); break;
    case 0xcb: t.kind = REAL, t.number = 8; break;
    case 0xcc: case 0xcd: case 0xce: case 0xcf: t.kind = INTEGER, t.number = 1 << (tag - 0xcc); break;
    case 0xd0: case 0xd1: case 0xd2: case 0xd3: t.kind = INTEGER, t.number = 1 << (tag - 0xd0); break;
    case 0xd9: case 0xda: case 0xdb: t.kind = STRING, t.length = 1 << (tag - 0xd9); break;
    case 0xdc: case 0xdd: t.kind = ARRAY, t.length = 2 << (tag - 0xdc); break;
    case 0xde: case 0xdf: t.kind = MAP, t.length = 2 << (tag - 0xde); break;
    default: t.known = false;
    }
    return t;
}

/* Big-endian; what lies beyond the end counts as zero bytes that are not there. */
static uint64_t big(const uint8_t *p, const uint8_t *end, int bytes) {
    uint64_t x = 0;
    for (; bytes && p < end; bytes--) x = x << 8 | *p++;
    return x;
}

/* How many values the text claims to hold. */
static uint64_t check_claims(Call *call, const uint8_t *text, uint64_t size) {
    uint64_t at = 0, claimed = 1, seen = 0, most = size < MOST ? size : MOST;
    while (at < size && claimed <= most) {
        Token t = token(text[at]);
        uint64_t left = size - at - 1, short_text = t.kind == STRING && !t.length ? t.count : 0;
        bool digest = text[at] == 0xc4 && left > 32 && text[at + 1] == 32;
        bool whole = t.known && t.number <= left && short_text <= left;
        if ((!whole || (t.length && !digest)) && ++seen > claimed) fail(call, DRESSI_BUNDLE, "the description goes on after its end");
        if (!whole)
            fail(call, DRESSI_BUNDLE, "the description has the byte %#x at %llu; nil, booleans, integers, float 64, text, bytes, "
                 "arrays and maps are allowed", text[at], (unsigned long long)at);
        at++;
        uint64_t count = t.length ? big(text + at, text + size, t.length) : t.count;
        at += t.length + t.number;
        if (t.kind == STRING || t.kind == BINARY) at += count;
        else claimed += t.kind == MAP ? 2 * count : t.kind == ARRAY ? count : 0;
    }
    if (claimed > size) fail(call, DRESSI_BUNDLE, "the description claims more than its %llu bytes can hold", (unsigned long long)size);
    if (claimed > most) fail(call, DRESSI_BUNDLE, "the description has more than %d items; a bundle has no need of so many", MOST);
    if (at > size) fail(call, DRESSI_BUNDLE, "the description ends within a value");
    return claimed;
}

static _Noreturn void no_msgpack(Call *call, const char *why) {
    fail(call, DRESSI_BUNDLE, "the description is no msgpack: %s", why);
}

static bool is_utf8(const uint8_t *p, uint32_t n) {
    static const uint32_t least[] = {0, 0x80, 0x800, 0x10000};
    for (uint32_t k = 0; k < n;) {
        int more = p[k] < 0x80 ? 0 : p[k] >> 5 == 6 ? 1 : p[k] >> 4 == 14 ? 2 : p[k] >> 3 == 30 ? 3 : -1;
        if (more < 0 || (uint32_t)more >= n - k) return false;
        uint32_t code = more ? p[k] & 0x3f >> more : p[k];
        for (int j = 1; j <= more; j++) {
            if (p[k + j] >> 6 != 2) return false;
            code = code << 6 | (p[k + j] & 0x3f);
        }
        if (code < least[more] || code > 0x10ffff || code >> 11 == 0x1b) return false;
        k += more + 1;
    }
    return true;
}

/* Order of keys, whatever they are: by kind, length and bytes. */
static bool key_before(uint32_t a, uint32_t b, const void *context) {
    const Node *x = (const Node *)context + 2 * (uint64_t)a, *y = (const Node *)context + 2 * (uint64_t)b;
    if (x->kind != y->kind) return x->kind < y->kind;
    if (x->count != y->count) return x->count < y->count;
    return x->count && memcmp(x->is.bytes, y->is.bytes, x->count) < 0;
}

static bool is_unique(Call *call, Arena *scratch, const Node *map) {
    const Node *items = map->is.items;
    uint32_t n = map->count;
    if (n <= 16) {
        for (uint32_t a = 1; a < n; a++)
            for (uint32_t b = 0; b < a; b++)
                if (items[2 * a].kind == items[2 * b].kind && equal(items + 2 * a, items + 2 * b)) return false;
        return true;
    }
    uint32_t *order = grow(call, scratch, 2 * (uint64_t)n, sizeof *order);
    for (uint32_t k = 0; k < n; k++) order[k] = k;
    sort(order, order + n, n, key_before, items);
    for (uint32_t k = 1; k < n; k++)
        if (!key_before(order[k - 1], order[k], items)) return false;
    return true;
}

static void read_leaf(Call *call, Node *node, uint8_t tag, Token t, const uint8_t **at, const uint8_t *end) {
    uint64_t bits = big(*at, end, t.number), count = t.length ? big(*at, end, t.length) : t.count;
    *at += t.number + t.length;
    *node = (Node){t.kind, (uint32_t)count, {0}};
    if (t.kind == INTEGER) {
        if (!t.number) node->is.integer = (int8_t)tag;
        else if (tag < 0xd0) node->is.huge = bits, node->kind = bits > INT64_MAX ? HUGE : INTEGER;
        else node->is.integer = tag == 0xd0 ? (int8_t)bits : tag == 0xd1 ? (int16_t)bits : tag == 0xd2 ? (int32_t)bits : (int64_t)bits;
        node->count = 0;
    } else if (t.kind == BOOLEAN) {
        node->is.integer = tag & 1;
    } else if (t.kind == REAL) {
        memcpy(&node->is.real, &bits, 8);
    } else if (t.kind == STRING || t.kind == BINARY) {
        node->is.bytes = *at;
        *at += count;
        if (t.kind == STRING && !is_utf8(node->is.bytes, node->count)) no_msgpack(call, "UnicodeDecodeError");
    }
}

typedef struct Open { Node *node; uint64_t next, count; } Open;

static const Node *read_tree(Call *call, Arena *arena, Arena *scratch, const uint8_t *text, uint64_t size, uint64_t claimed) {
    const uint8_t *at = text, *end = text + size;
    Node *pool = grow(call, arena, claimed, sizeof *pool), *free_node = pool + 1;
    Open *open = grow(call, scratch, MAX_DEPTH, sizeof *open);
    int depth = 0;
    for (Node *node = pool;;) {
        if (at == end) no_msgpack(call, "ValueError");
        uint8_t tag = *at++;
        Token t = token(tag);
        bool holds = t.kind == ARRAY || t.kind == MAP;
        if (holds && depth == MAX_DEPTH) no_msgpack(call, "StackError");
        read_leaf(call, node, tag, t, &at, end);
        if (holds && node->count) {
            node->is.items = free_node;
            open[depth++] = (Open){node, 0, (uint64_t)node->count * (t.kind == MAP ? 2 : 1)};
            free_node += open[depth - 1].count;
        } else {
            for (;;) { /* the node is whole, and with it what it is the last of */
                if (!depth) {
                    if (at != end) no_msgpack(call, "ExtraData");
                    return pool;
                }
                Open *top = open + depth - 1;
                const Node *key = top->node->is.items + (top->next & ~UINT64_C(1)); /* seen when its value is whole */
                if (top->node->kind == MAP && top->next & 1 && key->kind != STRING && key->kind != BINARY) no_msgpack(call, "ValueError");
                if (++top->next < top->count) break;
                if (top->node->kind == MAP && !is_unique(call, scratch, top->node))
                    fail(call, DRESSI_BUNDLE, "a map of the description names a key twice");
                depth--;
            }
        }
        node = open[depth - 1].node->is.items + open[depth - 1].next;
    }
}

const Node *decode(Call *call, Arena *arena, const uint8_t *bytes, uint64_t size) {
    Arena *scratch = arena; /* what sorting takes is at most half of the nodes */
    return read_tree(call, arena, scratch, bytes, size, check_claims(call, bytes, size));
}

bool same(const Node *node, const char *word) {
    return node->kind == STRING && node->count == strlen(word) && !memcmp(node->is.bytes, word, node->count);
}

const Node *find(const Node *map, const char *key) {
    for (uint32_t k = 0; map->kind == MAP && k < map->count; k++)
        if (same(map->is.items + 2 * k, key)) return map->is.items + 2 * k + 1;
    return NULL;
}

/* Of what was checked: no maps, and lists of no lists. */
bool equal(const Node *a, const Node *b) {
    if (a->kind != b->kind || a->count != b->count) return false;
    if (a->kind == STRING || a->kind == BINARY) return !a->count || !memcmp(a->is.bytes, b->is.bytes, a->count);
    if (a->kind != ARRAY) return a->kind == NIL || a->is.integer == b->is.integer;
    for (uint32_t k = 0; k < a->count; k++)
        if (a->is.items[k].kind != b->is.items[k].kind || a->is.items[k].is.integer != b->is.items[k].is.integer) return false;
    return true;
}

/* ---- As Python writes them ---- */

void say_repr(Text *text, Kind kind, const uint8_t *bytes, size_t count) {
    bool quote = memchr(bytes, '\'', count) && !memchr(bytes, '"', count);
    char mark = quote ? '"' : '\'';
    say(text, kind == BINARY ? "b%c" : "%c", mark);
    for (size_t k = 0; k < count;) {
        uint32_t c = bytes[k++];
        if (kind == STRING && c >= 0x80) {
            int more = c >> 5 == 6 ? 1 : c >> 4 == 14 ? 2 : 3;
            for (c &= 0x3f >> more; more && k < count; more--) c = c << 6 | (bytes[k++] & 0x3f);
        }
        if (c == (uint8_t)mark || c == '\\') say(text, "\\%c", (int)c);
        else if (c == '\n' || c == '\r' || c == '\t') say(text, "\\%c", c == '\n' ? 'n' : c == '\r' ? 'r' : 't');
        else if (c < 0x20 || (c >= 0x7f && c < 0x100)) say(text, "\\x%02x", c);
        else if (c >= 0x100) say(text, c < 0x10000 ? "\\u%04x" : "\\U%08x", c); /* Python leaves letters as they are */
        else say(text, "%c", (int)c);
    }
    say(text, "%c", mark);
}

/* The fewest digits that give the number back. */
static void say_real(Text *text, double x) {
    char digits[40];
    if (x != x) { say(text, "nan"); return; }
    if (x - x != 0) { say(text, x > 0 ? "inf" : "-inf"); return; }
    int precision = 0;
    do snprintf(digits, sizeof digits, "%.*e", precision, x);
    while (strtod(digits, NULL) != x && ++precision < 17);
    int exponent = atoi(strchr(digits, 'e') + 1);
    if (exponent < -4 || exponent >= 16) {
        char *mark = strchr(digits, 'e');
        *mark = 0;
        say(text, "%se%c%02d", digits, exponent < 0 ? '-' : '+', exponent < 0 ? -exponent : exponent);
    } else {
        int after = precision - exponent;
        say(text, "%.*f", after > 0 ? after : 1, x);
    }
}

const char *show(const Node *node, char buffer[SHOWN]) {
    Text text = {0};
    size_t most = 60, bytes = 0;
    switch (node->kind) {
    case NIL: say(&text, "None"); break;
    case BOOLEAN: say(&text, node->is.integer ? "True" : "False"); break;
    case INTEGER: say(&text, "%lld", (long long)node->is.integer); break;
    case HUGE: say(&text, "%llu", (unsigned long long)node->is.huge); break;
    case REAL: say_real(&text, node->is.real); break;
    case ARRAY: say(&text, "a list of %u", node->count), most = SHOWN - 1; break;
    case MAP: say(&text, "a map of %u", node->count), most = SHOWN - 1; break;
    case STRING: case BINARY: /* the first 60 characters */
        for (size_t seen = 0; bytes < node->count; bytes++) {
            seen += node->kind == BINARY || node->is.bytes[bytes] >> 6 != 2;
            if (seen > 60) break;
        }
        say_repr(&text, node->kind, node->is.bytes, bytes);
    }
    snprintf(buffer, SHOWN, "%.*s", (int)most, text.at && !text.broken ? text.at : "?");
    free(text.at);
    return buffer;
}

/* ---- Packing, in the fewest bytes ---- */

static void put(Packed *packed, uint8_t tag, uint64_t count, int bytes) {
    if (packed->at) {
        packed->at[packed->size] = tag;
        for (int k = 0; k < bytes; k++) packed->at[packed->size + 1 + k] = (uint8_t)(count >> 8 * (bytes - 1 - k));
    }
    packed->size += 1 + bytes;
}

void pack_head(Packed *packed, Kind kind, uint64_t n) {
    int size = n < 1 << 8 ? 0 : n < 1 << 16 ? 1 : n <= UINT32_MAX ? 2 : 3; /* of 1, 2, 4 or 8 bytes */
    if (kind == NIL) put(packed, 0xc0, 0, 0);
    else if (kind == INTEGER) n < 0x80 ? put(packed, (uint8_t)n, 0, 0) : put(packed, 0xcc + size, n, 1 << size);
    else if (kind == STRING) n < 32 ? put(packed, 0xa0 | n, 0, 0) : put(packed, 0xd9 + size, n, 1 << size);
    else if (n < 16) put(packed, (kind == MAP ? 0x80 : 0x90) | n, 0, 0);
    else put(packed, (kind == MAP ? 0xde : 0xdc) + (n > UINT16_MAX), n, n > UINT16_MAX ? 4 : 2);
}

void pack_text(Packed *packed, const char *text) {
    size_t length = strlen(text);
    pack_head(packed, STRING, length);
    if (packed->at) memcpy(packed->at + packed->size, text, length);
    packed->size += length;
}
