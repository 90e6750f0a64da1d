/* Ids, types and constants of a SPIR-V module: dressi_edge/cache/spirv_types.py in C, in its order and words. */

#include "spirv.h"

#include <string.h>

enum { MAX_COMPONENTS = 1 << 14, MAX_NESTED = 16, MAX_WEIGHT = 1 << 16 };

typedef unsigned long long ull;

const char *kind_word(const Type *type) {
    static const char *const words[] = {"none", "void", "bool", "int", "uint", "float", "vector", "matrix", "array", "struct", "image",
                                        "sampled", "pointer", "function"};
    return words[type->kind];
}

/* ---- Ids ---- */

uint32_t check_id(const Module *m, uint32_t x, uint32_t at) {
    if (!x || x >= m->bound) WRONG(m, at, "id %u; ids from 1 to %u are allowed", x, m->bound - 1);
    return x;
}

uint32_t define(Module *m, uint32_t x, uint32_t at) {
    if (m->defined[check_id(m, x, at)]) WRONG(m, at, "id %u is defined twice", x);
    m->defined[x] = true;
    return x;
}

const Type *type_of(const Module *m, uint32_t x, uint32_t at) {
    if (x >= m->bound || m->types[x].kind == NO_TYPE) WRONG(m, at, "id %u is no type defined before", x);
    return m->types + x;
}

const Type *holds(const Module *m, uint32_t x, uint32_t at) {
    const Type *found = type_of(m, x, at);
    if (!found->components || m->closed[x]) WRONG(m, at, "a value of a type that holds no numbers (id %u, %s)", x, kind_word(found));
    return found;
}

void operands(const Module *m, Ops o, int64_t least, int64_t most) {
    if (o.n >= least && (most == NO_LIMIT || o.n <= most)) return;
    uint32_t op = word(m, o.at) & 0xffff;
    if (most == NO_LIMIT || most == least) WRONG(m, o.at, "opcode %u has %u operands; %lld are needed", op, o.n, (long long)least);
    WRONG(m, o.at, "opcode %u has %u operands; %lld to %lld are needed", op, o.n, (long long)least, (long long)most);
}

void weigh(Module *m, const Type *type, uint32_t at) {
    m->weight += type->components;
    if (m->weight > MAX_WEIGHT) WRONG(m, at, "variables and composite values of more than %d numbers in all", MAX_WEIGHT);
}

uint32_t part_of(const Module *m, const Type *type, uint32_t k) { return type->kind == STRUCT ? member_of(m, type, k) : type->of; }

const Member *find_member(const Module *m, uint32_t structure, uint32_t member) {
    uint32_t low = 0, high = m->member_count;
    while (low < high) {
        uint32_t middle = low + (high - low) / 2;
        const Member *x = m->members + middle;
        if (x->structure < structure || (x->structure == structure && x->member < member)) low = middle + 1;
        else high = middle;
    }
    const Member *found = m->members + low;
    return low < m->member_count && found->structure == structure && found->member == member ? found : NULL;
}

/* ---- Types ---- */

static const struct { uint8_t op, least; int16_t most; bool unique; } LENGTHS[] = {
    {19, 1, 1, true}, {20, 1, 1, true}, {21, 3, 3, true}, {22, 2, 2, true}, {23, 3, 3, true}, {24, 3, 3, true}, {25, 8, 8, true},
    {27, 2, 2, true}, {28, 3, 3, false}, {30, 1, NO_LIMIT, false}, {32, 3, 3, false}, {33, 2, 257, true}};

bool is_type_op(uint32_t op) {
    for (size_t k = 0; k < COUNT(LENGTHS); k++)
        if (LENGTHS[k].op == op) return true;
    return false;
}

static Type image_type(Module *m, Ops o) {
    const Type *x = type_of(m, op_at(m, o, 1), o.at);
    uint32_t dim = op_at(m, o, 2), depth = op_at(m, o, 3), sampled = op_at(m, o, 6);
    if (x->kind != FLOAT && x->kind != INT) WRONG(m, o.at, "an image of what is neither float nor int");
    uint32_t format = op_at(m, o, 7), storage = 0;
    if (m->stage == COMPUTE_STAGE && dim == 1 && sampled == 2)
        storage = format == 1 ? 109 : format == 2 ? 97 : format == 3 ? 100 : format == 21 ? 108 : format == 24 ? 99 : 0;
    bool fits = ((dim == 1 && sampled == 1) || (dim == 6 && sampled == 2)) && !format;
    if ((!fits && !storage) || (depth != 0 && depth != 2) || op_at(m, o, 4) || op_at(m, o, 5))
        WRONG(m, o.at, "an image that is neither sampled 2D nor subpass input nor, of a compute shader, storage of a format for it");
    if (storage && is_integer(storage) != (x->kind == INT)) WRONG(m, o.at, "a storage image whose format does not hold its numbers");
    if (dim == 6 && !(m->capabilities >> 40 & 1)) WRONG(m, o.at, "a subpass input without capability 40");
    return (Type){.kind = PICTURE, .of = op_at(m, o, 1), .is_integer = x->kind == INT, .is_attachment = dim == 6, .format = (uint8_t)storage};
}

static Type struct_type(Module *m, Ops o) {
    Type made = {.kind = STRUCT, .depth = 0, .count = o.n - 1, .members = o.at + 2, .member_count = o.n - 1};
    for (uint32_t k = 1; k < o.n; k++) {
        const Type *x = holds(m, op_at(m, o, k), o.at);
        made.components += x->components;
        if (x->depth > made.depth) made.depth = x->depth;
    }
    made.depth++;
    return made;
}

static Type pointer_type(Module *m, Ops o) {
    uint32_t storage = op_at(m, o, 1), of = op_at(m, o, 2);
    bool shared = m->stage == COMPUTE_STAGE && (storage == WORKGROUP || storage == TEXEL);
    if (storage != UNIFORM_CONSTANT && storage != IN && storage != OUT && storage != PRIVATE && storage != LOCAL && !shared)
        WRONG(m, o.at, "a pointer to storage class %u; images, inputs, outputs, private and local variables, and those that the invocations "
              "of a compute shader share, are allowed", storage);
    const Type *x = type_of(m, of, o.at);
    if (storage == UNIFORM_CONSTANT ? x->kind != PICTURE && x->kind != SAMPLED : !x->components)
        WRONG(m, o.at, "a pointer of storage class %u to %s", storage, kind_word(x));
    if (m->closed[of] && storage != OUT)
        WRONG(m, o.at, "a structure of built-ins in storage class %u; outputs are allowed", storage);
    if (storage == TEXEL && x->kind != INT) WRONG(m, o.at, "a pointer to texels that are %s; int is allowed", kind_word(x));
    return (Type){.kind = POINTER, .of = of, .storage = (uint8_t)storage};
}

static Type function_type(Module *m, Ops o) {
    uint32_t given = op_at(m, o, 1);
    bool takes_given = false;
    for (uint32_t k = 1; k < o.n; k++) {
        const Type *x = type_of(m, op_at(m, o, k), o.at);
        if (x->kind == FUNCTION || x->kind == PICTURE || x->kind == SAMPLED || (op_at(m, o, k) != given && x->kind == VOID))
            WRONG(m, o.at, "a function that takes or returns %s", kind_word(x));
        if (x->kind == POINTER && (x->storage == WORKGROUP || x->storage == TEXEL))
            WRONG(m, o.at, "a function that takes a pointer to what invocations share");
        takes_given |= k > 1 && op_at(m, o, k) == given;
    }
    if (m->types[given].kind == POINTER) WRONG(m, o.at, "a function that returns a pointer");
    if (takes_given && m->types[given].kind == VOID) WRONG(m, o.at, "a function that takes void");
    return (Type){.kind = FUNCTION, .of = given, .members = o.at + 3, .member_count = o.n - 2};
}

static Type new_type(Module *m, uint32_t op, Ops o) {
    uint32_t a = o.n > 1 ? op_at(m, o, 1) : 0, b = o.n > 2 ? op_at(m, o, 2) : 0;
    const Type *x;
    switch (op) {
    case 19: return (Type){.kind = VOID};
    case 20: return (Type){.kind = BOOL, .components = 1, .letter = 'b'};
    case 21:
        if (a != 32 || b > 1) WRONG(m, o.at, "integers of %u bits and signedness %u; 32 bits, and 0 or 1, are allowed", a, b);
        return (Type){.kind = b ? INT : UINT, .components = 1, .letter = b ? 'i' : 'u'};
    case 22:
        if (a != 32) WRONG(m, o.at, "floats of %u bits; 32 are allowed", a);
        return (Type){.kind = FLOAT, .components = 1, .letter = 'f'};
    case 23:
        x = type_of(m, a, o.at);
        if (!x->letter || x->components != 1 || b < 2 || b > 4)
            WRONG(m, o.at, "a vector of %u of %s; 2 to 4 scalars are allowed", b, kind_word(x));
        return (Type){.kind = VECTOR, .components = b, .depth = 1, .letter = x->letter, .count = b, .of = a};
    case 24:
        x = type_of(m, a, o.at);
        if (x->kind != VECTOR || x->letter != 'f' || b < 2 || b > 4)
            WRONG(m, o.at, "a matrix of %u columns of %s; 2 to 4 vectors of floats are allowed", b, kind_word(x));
        return (Type){.kind = MATRIX, .components = x->components * b, .depth = 2, .count = b, .of = a};
    case 25: return image_type(m, o);
    case 27:
        x = type_of(m, a, o.at);
        if (x->kind != PICTURE || x->is_attachment || x->format) WRONG(m, o.at, "a combined sampler of what is no sampled image");
        return (Type){.kind = SAMPLED, .of = a, .is_integer = x->is_integer};
    case 28: {
        x = holds(m, a, o.at);
        uint32_t length = b < m->bound && m->is_integer[b] ? m->integers[b] : 0;
        if (!length || length >> 31) WRONG(m, o.at, "an array whose length (id %u) is no constant integer above 0", check_id(m, b, o.at));
        return (Type){.kind = LIST, .components = x->components * length, .depth = x->depth + 1, .count = length, .of = a};
    }
    case 30: return struct_type(m, o);
    case 32: return pointer_type(m, o);
    default: return function_type(m, o);
    }
}

bool declare_type(Module *m, uint32_t op, Ops o) {
    size_t k = 0;
    while (k < COUNT(LENGTHS) && LENGTHS[k].op != op) k++;
    if (k == COUNT(LENGTHS)) return false;
    operands(m, o, LENGTHS[k].least, LENGTHS[k].most);
    if (m->again[o.at]) WRONG(m, o.at, "a type that there is already (opcode %u)", op);
    Type made = new_type(m, op, o);
    if (made.components > MAX_COMPONENTS)
        WRONG(m, o.at, "a type of %llu numbers; at most %d are allowed", (ull)made.components, MAX_COMPONENTS);
    if (made.depth > MAX_NESTED) WRONG(m, o.at, "a type nested %u deep; at most %d is allowed", made.depth, MAX_NESTED);
    m->types[define(m, op_at(m, o, 0), o.at)] = made;
    return true;
}

/* ---- Constants ---- */

bool is_constant_op(uint32_t op) { return op == 1 || (op >= 41 && op <= 44) || op == 46; }

void declare_constant(Module *m, uint32_t op, Ops o) {
    operands(m, o, op == 43 ? 3 : 2, op == 44 ? NO_LIMIT : op == 43 ? 3 : 2);
    const Type *type = holds(m, op_at(m, o, 0), o.at);
    uint32_t x = op_at(m, o, 1);
    if ((op == 41 || op == 42) && type->kind != BOOL) WRONG(m, o.at, "a truth value of type %s", kind_word(type));
    if (op == 43 && (!is_plain(type) || type->components != 1)) WRONG(m, o.at, "a number of type %s", kind_word(type));
    if (op == 44) {
        if (!type->count || o.n - 2 != type->count) WRONG(m, o.at, "a constant of %u parts; its type has %u", o.n - 2, type->count);
        for (uint32_t k = 0; k < type->count; k++) {
            uint32_t part = op_at(m, o, 2 + k);
            if (part >= m->bound || !m->fixed[part] || m->values[part] != part_of(m, type, k))
                WRONG(m, o.at, "a part (id %u) that is no constant of the type of the part", check_id(m, part, o.at));
        }
        if (x < m->bound) m->composites[x] = o.at + 3;
    }
    if (!type->letter) weigh(m, type, o.at);
    m->fixed[define(m, x, o.at)] = true;
    m->values[x] = op_at(m, o, 0);
    if (op == 43 && type->letter != 'f') m->is_integer[x] = true, m->integers[x] = op_at(m, o, 2);
}
