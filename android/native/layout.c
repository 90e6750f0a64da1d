/* A value's array and its image: docs/bundle-format.md, "values". Four bytes a channel in the array, as many or two in the image. */

#include "inside.h"

#include <stdio.h>
#include <string.h>

uint64_t entry_count(const Value *value) {
    uint64_t cell = (uint64_t)value->width * value->height;
    return value->layout == UNIT ? 1 : value->layout == TABLE ? value->count : value->layout == IMAGE ? cell : cell * value->count;
}

void describe_value(const Value *value, dressi_value *found) {
    dressi_role role = value->role == INPUT ? DRESSI_IN : value->role == STATE ? DRESSI_STATE : DRESSI_OUT;
    *found = (dressi_value){.name = value->name, .role = role,
                            .is_int = value->is_int, .channels = (int)value->channels,
                            .bytes = (size_t)(entry_count(value) * value->channels * 4)};
    if (value->layout == TABLE || value->layout == ATLAS) found->shape[found->rank++] = value->count;
    if (value->layout == IMAGE || value->layout == ATLAS) {
        found->shape[found->rank++] = value->height;
        found->shape[found->rank++] = value->width;
    }
    if (value->channels > 1) found->shape[found->rank++] = value->channels;
}

/* ---- Numbers of 16 bits ---- */

enum { LAST_FLOAT = 0x7f7fffff, LAST_HALF = 0x477fefff }; /* bits of the largest that is finite, as fp32 and once rounded to fp16 */

/* To nearest even, of bits that stay finite. */
static uint16_t to_half(uint32_t bits) {
    uint32_t sign = bits >> 16 & 0x8000, size = bits & 0x7fffffff;
    if (size >= 0x38800000) return (uint16_t)(sign | (size + 0xfff + (size >> 13 & 1) - 0x38000000) >> 13);
    if (size < 0x33000000) return (uint16_t)sign; /* below half of the least, 2^-24 */
    uint32_t shift = 126 - (size >> 23), mantissa = (size & 0x7fffff) | 0x800000; /* in steps of 2^-24 */
    uint32_t kept = mantissa >> shift, rest = mantissa & ((1u << shift) - 1), half = 1u << (shift - 1);
    return (uint16_t)(sign | (kept + (rest > half || (rest == half && (kept & 1)))));
}

static uint32_t from_half(uint16_t half) {
    uint32_t sign = (uint32_t)(half & 0x8000) << 16, exponent = half >> 10 & 31, mantissa = half & 1023;
    if (exponent) return sign | (exponent == 31 ? 255 : exponent + 112) << 23 | mantissa << 13;
    if (!mantissa) return sign;
    for (exponent = 113; !(mantissa & 1024); exponent--) mantissa <<= 1;
    return sign | exponent << 23 | (mantissa & 1023) << 13;
}

/* ---- Rows ---- */

/* Where in the image, in texels, entry e of the array lies; entries go on from there to the end of the row. */
static uint64_t place_of(const Value *value, uint64_t e) {
    if (value->layout != ATLAS) return e;
    uint64_t cell = (uint64_t)value->width * value->height, v = e / cell, y = e % cell / value->width, x = e % value->width;
    return (v / value->columns * value->height + y) * value->width * value->columns + v % value->columns * value->width + x;
}

static void say_place(const Value *value, uint64_t number, char *text, size_t size) {
    uint64_t parts[4], e = number / value->channels, cell = (uint64_t)value->width * value->height;
    int n = 0;
    if (value->layout == TABLE) parts[n++] = e;
    if (value->layout == ATLAS) parts[n++] = e / cell;
    if (value->layout == IMAGE || value->layout == ATLAS) parts[n++] = e % cell / value->width, parts[n++] = e % value->width;
    if (value->channels > 1) parts[n++] = number % value->channels;
    snprintf(text, size, "%s", n ? "[" : "");
    for (int k = 0; k < n; k++)
        snprintf(text + strlen(text), size - strlen(text), "%llu%s", (unsigned long long)parts[k], k + 1 < n ? ", " : "]");
}

static void check_numbers(Call *call, const Value *value, bool half, const uint8_t *array, uint64_t count) {
    uint64_t bad = 0, beyond = UINT64_MAX;
    for (uint64_t k = 0; k < count; k++) {
        uint32_t size;
        memcpy(&size, array + 4 * k, 4);
        size &= 0x7fffffff;
        bad += size > LAST_FLOAT;
        if (half && size > LAST_HALF && beyond == UINT64_MAX) beyond = k;
    }
    if (bad)
        fail(call, DRESSI_INPUT, "%.100s has %llu values that are NaN or Inf; finite numbers are needed", value->name,
             (unsigned long long)bad);
    if (beyond == UINT64_MAX) return;
    char where[80];
    float x;
    say_place(value, beyond, where, sizeof where);
    memcpy(&x, array + 4 * beyond, 4);
    fail(call, DRESSI_INPUT, "%.100s%s is %g, beyond the range of fp16 in which it is stored; at most 65504 is allowed, more with storage "
         "float", value->name, where, x);
}

static uint64_t row_of(const Value *value) { /* entries that lie side by side in array and image */
    return value->layout == ATLAS ? value->width : entry_count(value);
}

void to_texels(Call *call, const Value *value, uint32_t format, const void *array, uint8_t *texels) {
    uint64_t n = entry_count(value), row = row_of(value), channels = value->channels, stride = channels == 3 ? 4 : channels;
    bool half = is_half(format);
    const uint8_t *from = array;
    if (!value->is_int) check_numbers(call, value, half, from, n * channels);
    uint64_t width, height = 1, total = n;
    if (value->layout == TABLE) table_size(value->count, &width, &height), total = width * height;
    if (value->layout == ATLAS) total = (uint64_t)value->width * value->columns * value->height * divided(value->count, value->columns);
    if (total != n || channels == 3) memset(texels, 0, total * stride * (half ? 2 : 4));
    for (uint64_t first = 0; first < n; first += row) {
        uint8_t *to = texels + place_of(value, first) * stride * (half ? 2 : 4);
        if (!half && channels == stride) {
            memcpy(to, from + 4 * first * channels, 4 * row * channels);
            continue;
        }
        for (uint64_t k = 0; k < row; k++)
            for (uint64_t c = 0; c < channels; c++) {
                uint32_t bits;
                memcpy(&bits, from + 4 * ((first + k) * channels + c), 4);
                uint16_t small = half ? to_half(bits) : 0;
                if (half) memcpy(to + 2 * (k * stride + c), &small, 2);
                else memcpy(to + 4 * (k * stride + c), &bits, 4);
            }
    }
}

void from_texels(const Value *value, uint32_t format, const uint8_t *texels, void *array) {
    uint64_t n = entry_count(value), row = row_of(value), channels = value->channels, stride = channels == 3 ? 4 : channels;
    bool half = is_half(format);
    uint8_t *to = array;
    for (uint64_t first = 0; first < n; first += row) {
        const uint8_t *from = texels + place_of(value, first) * stride * (half ? 2 : 4);
        if (!half && channels == stride) {
            memcpy(to + 4 * first * channels, from, 4 * row * channels);
            continue;
        }
        for (uint64_t k = 0; k < row; k++)
            for (uint64_t c = 0; c < channels; c++) {
                uint32_t bits;
                uint16_t small;
                if (half) memcpy(&small, from + 2 * (k * stride + c), 2), bits = from_half(small);
                else memcpy(&bits, from + 4 * (k * stride + c), 4);
                memcpy(to + 4 * ((first + k) * channels + c), &bits, 4);
            }
    }
}

uint64_t count_not_finite(const Value *value, uint32_t format, const uint8_t *texels) {
    uint64_t n = entry_count(value), row = row_of(value), channels = value->channels, stride = channels == 3 ? 4 : channels, bad = 0;
    bool half = is_half(format);
    for (uint64_t first = 0; first < n; first += row) {
        const uint8_t *from = texels + place_of(value, first) * stride * (half ? 2 : 4);
        for (uint64_t k = 0; k < row; k++)
            for (uint64_t c = 0; c < channels; c++) {
                const uint8_t *p = from + (half ? 2 : 4) * (k * stride + c);
                bad += half ? (p[1] & 0x7c) == 0x7c : (little32(p) & 0x7f800000) == 0x7f800000;
            }
    }
    return bad;
}
