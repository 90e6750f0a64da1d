/* Errors, memory that goes at once, texts that grow, SHA-256, a sort that nobody can make slow, the clock. */

#include "inside.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

/* ---- Errors ---- */

_Noreturn void fail(Call *call, dressi_code code, const char *format, ...) {
    va_list rest;
    va_start(rest, format);
    call->error.code = code;
    vsnprintf(call->error.text, sizeof call->error.text, format, rest);
    va_end(rest);
    longjmp(call->out, 1);
}

dressi_code told(const Call *call, dressi_error *error) {
    if (error) *error = call->error;
    return call->error.code;
}

/* ---- Memory ---- */

typedef struct Chunk { struct Chunk *before; size_t used, size; } Chunk;

enum { CHUNK = 1 << 14, ALIGN = 16, HEAD = (sizeof(Chunk) + ALIGN - 1) / ALIGN * ALIGN };

void *grow(Call *call, Arena *arena, uint64_t count, size_t size) {
    if (count > (SIZE_MAX / 4 - ALIGN) / size)
        fail(call, DRESSI_MEMORY, "no memory for %llu items of %zu bytes", (unsigned long long)count, size);
    size_t wanted = (size_t)(count * size + ALIGN - 1) / ALIGN * ALIGN;
    Chunk *last = arena->last;
    if (!last || wanted > last->size - last->used) {
        size_t room = wanted > CHUNK / 4 ? wanted : CHUNK; /* what is large has a chunk of its own */
        Chunk *chunk = calloc(1, HEAD + room);
        if (!chunk) fail(call, DRESSI_MEMORY, "no memory for %zu bytes", room);
        *chunk = (Chunk){last, 0, room};
        arena->last = last = chunk;
    }
    void *found = (char *)last + HEAD + last->used;
    last->used += wanted;
    return found;
}

void drop(Arena *arena) {
    while (arena->last) {
        Chunk *before = arena->last->before;
        free(arena->last);
        arena->last = before;
    }
}

/* ---- Texts ---- */

void say(Text *text, const char *format, ...) {
    for (int tries = 0; tries < 2 && !text->broken; tries++) {
        va_list rest;
        va_start(rest, format);
        int length = vsnprintf(text->at ? text->at + text->length : NULL, text->room - text->length, format, rest);
        va_end(rest);
        if (length < 0) { text->broken = true; return; }
        if (text->room - text->length > (size_t)length) { text->length += length; return; }
        size_t room = 2 * (text->length + length + 128);
        char *at = realloc(text->at, room);
        if (!at) { text->broken = true; return; }
        text->at = at, text->room = room;
    }
}

void say_json(Text *text, const char *word) {
    say(text, "\"");
    for (const unsigned char *p = (const unsigned char *)word; *p; p++)
        if (*p < 0x20 || *p == 0x7f) say(text, "\\u%04x", *p);
        else say(text, *p == '"' || *p == '\\' ? "\\%c" : "%c", *p);
    say(text, "\"");
}

void hexadecimal(const uint8_t *bytes, size_t count, char *text) {
    for (size_t k = 0; k < count; k++) {
        text[2 * k] = "0123456789abcdef"[bytes[k] >> 4];
        text[2 * k + 1] = "0123456789abcdef"[bytes[k] & 15];
    }
    text[2 * count] = 0;
}

/* ---- SHA-256, FIPS 180-4 ---- */

static const uint32_t ROUND[64] = {
    0x428a2f98, 0x71374491, 0xb5c0fbcf, 0xe9b5dba5, 0x3956c25b, 0x59f111f1, 0x923f82a4, 0xab1c5ed5, 0xd807aa98, 0x12835b01, 0x243185be,
    0x550c7dc3, 0x72be5d74, 0x80deb1fe, 0x9bdc06a7, 0xc19bf174, 0xe49b69c1, 0xefbe4786, 0x0fc19dc6, 0x240ca1cc, 0x2de92c6f, 0x4a7484aa,
    0x5cb0a9dc, 0x76f988da, 0x983e5152, 0xa831c66d, 0xb00327c8, 0xbf597fc7, 0xc6e00bf3, 0xd5a79147, 0x06ca6351, 0x14292967, 0x27b70a85,
    0x2e1b2138, 0x4d2c6dfc, 0x53380d13, 0x650a7354, 0x766a0abb, 0x81c2c92e, 0x92722c85, 0xa2bfe8a1, 0xa81a664b, 0xc24b8b70, 0xc76c51a3,
    0xd192e819, 0xd6990624, 0xf40e3585, 0x106aa070, 0x19a4c116, 0x1e376c08, 0x2748774c, 0x34b0bcb5, 0x391c0cb3, 0x4ed8aa4a, 0x5b9cca4f,
    0x682e6ff3, 0x748f82ee, 0x78a5636f, 0x84c87814, 0x8cc70208, 0x90befffa, 0xa4506ceb, 0xbef9a3f7, 0xc67178f2};

static uint32_t turn(uint32_t x, int n) { return x >> n | x << (32 - n); }

static void sha_block(uint32_t h[8], const uint8_t *p) {
    uint32_t w[64], a = h[0], b = h[1], c = h[2], d = h[3], e = h[4], f = h[5], g = h[6], i = h[7];
    for (int k = 0; k < 16; k++) w[k] = (uint32_t)p[4 * k] << 24 | p[4 * k + 1] << 16 | p[4 * k + 2] << 8 | p[4 * k + 3];
    for (int k = 16; k < 64; k++) {
        uint32_t x = w[k - 15], y = w[k - 2];
        w[k] = w[k - 16] + w[k - 7] + (turn(x, 7) ^ turn(x, 18) ^ x >> 3) + (turn(y, 17) ^ turn(y, 19) ^ y >> 10);
    }
    for (int k = 0; k < 64; k++) {
        uint32_t one = i + (turn(e, 6) ^ turn(e, 11) ^ turn(e, 25)) + ((e & f) ^ (~e & g)) + ROUND[k] + w[k];
        uint32_t two = (turn(a, 2) ^ turn(a, 13) ^ turn(a, 22)) + ((a & b) ^ (a & c) ^ (b & c));
        i = g, g = f, f = e, e = d + one, d = c, c = b, b = a, a = one + two;
    }
    h[0] += a, h[1] += b, h[2] += c, h[3] += d, h[4] += e, h[5] += f, h[6] += g, h[7] += i;
}

void sha_begin(Sha *sha) {
    *sha = (Sha){{0x6a09e667, 0xbb67ae85, 0x3c6ef372, 0xa54ff53a, 0x510e527f, 0x9b05688c, 0x1f83d9ab, 0x5be0cd19}, 0, {0}};
}

void sha_add(Sha *sha, const void *data, uint64_t size) {
    const uint8_t *p = data;
    while (size) {
        size_t held = sha->size % 64, step = 64 - held < size ? 64 - held : (size_t)size;
        if (!held && size >= 64) {
            sha_block(sha->h, p);
        } else {
            memcpy(sha->block + held, p, step);
            if (held + step == 64) sha_block(sha->h, sha->block);
        }
        p += step, size -= step, sha->size += step;
    }
}

void sha_end(Sha *sha, uint8_t digest[32]) {
    uint64_t bits = sha->size * 8;
    uint8_t end[8];
    for (int k = 0; k < 8; k++) end[k] = bits >> 8 * (7 - k);
    sha_add(sha, "\x80", 1);
    while (sha->size % 64 != 56) sha_add(sha, "", 1);
    sha_add(sha, end, 8);
    for (int k = 0; k < 32; k++) digest[k] = sha->h[k / 4] >> 8 * (3 - k % 4);
}

void sha256(const void *data, uint64_t size, uint8_t digest[32]) {
    Sha sha;
    sha_begin(&sha);
    sha_add(&sha, data, size);
    sha_end(&sha, digest);
}

/* ---- Sorting ---- */

void sort(uint32_t *items, uint32_t *spare, uint32_t count, bool (*before)(uint32_t, uint32_t, const void *), const void *context) {
    uint32_t *from = items, *to = spare;
    for (uint64_t width = 1; width < count; width *= 2) {
        for (uint64_t first = 0; first < count; first += 2 * width) {
            uint64_t middle = first + width < count ? first + width : count, end = first + 2 * width < count ? first + 2 * width : count;
            for (uint64_t k = first, a = first, b = middle; k < end; k++)
                to[k] = a < middle && (b == end || !before(from[b], from[a], context)) ? from[a++] : from[b++];
        }
        uint32_t *other = from;
        from = to, to = other;
    }
    if (from != items && count) memcpy(items, from, count * sizeof *items);
}

static bool less(uint32_t a, uint32_t b, const void *context) {
    (void)context;
    return a < b;
}

void sort_numbers(uint32_t *items, uint32_t *spare, uint32_t count) { sort(items, spare, count, less, NULL); }

/* ---- The clock ---- */

double seconds_now(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec + now.tv_nsec * 1e-9;
}

void rest(double seconds) {
    struct timespec time = {(time_t)seconds, (long)((seconds - (time_t)seconds) * 1e9)};
    nanosleep(&time, NULL);
}
