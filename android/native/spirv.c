/* What a shader binds, takes and gives, read from its SPIR-V: dressi_edge/cache/spirv_interface.py in C, in its order and words. Linear
   in the bytes. Numbers are those of the SPIR-V specification, version 1.6, chapter 3. */

#include "inside.h"

#include <stdio.h>
#include <string.h>

enum { OF_NOTHING, OF_FLOAT, OF_INT, OF_UINT, OF_IMAGE, OF_SAMPLED, OF_STRUCT, OF_POINTER, OF_OTHER };
enum { UNIFORM_CONSTANT = 0, IN = 1, OUT = 3, PRIVATE = 6, FUNCTION = 7, MOST_COMPONENTS = 1 << 20, ALL = 9 };
enum { HAS_BUILTIN = 1, HAS_LOCATION = 2, HAS_BINDING = 4, HAS_SET = 8, HAS_ATTACHMENT = 16, HAS_FLAT = 32, IS_BUILTIN_BLOCK = 64 };

typedef struct Type { /* of: 0 where an id is no type; scalars, images and so on */
    uint8_t of;
    bool plain, is_integer, is_attachment; /* plain: a scalar or vector of 32 bits */
    uint32_t components, pointee, storage;
} Type;

typedef struct Marked { uint32_t has, location, binding, set, attachment; } Marked;

typedef struct Module {
    Reader *r;
    const uint8_t *data;
    uint32_t count, bound, stage, entry, modes;
    Type *types;
    uint32_t *constants;
    bool *defined;
    Marked *marks;
    uint32_t variable_count, (*variables)[3]; /* id, storage class, pointee */
} Module;

static uint32_t word(const Module *m, uint32_t at) { return little32(m->data + 4 * (uint64_t)at); }

#define FAIL(...) refuse(m->r, ": " __VA_ARGS__)

/* ---- Ids ---- */

static uint32_t check_id(const Module *m, uint32_t x, uint32_t at) {
    if (!x || x >= m->bound) FAIL("word %u: id %u; ids from 1 to %u are allowed", at, x, m->bound - 1);
    return x;
}

static void define(Module *m, uint32_t x, uint32_t at) {
    if (m->defined[check_id(m, x, at)]) FAIL("word %u: id %u is defined twice", at, x);
    m->defined[x] = true;
}

static const Type *type_of(const Module *m, uint32_t x, uint32_t at) {
    if (x >= m->bound || !m->types[x].of) FAIL("word %u: id %u is no type defined before", at, x);
    return m->types + x;
}

static void operands(const Module *m, uint32_t count, uint32_t least, uint32_t at) {
    if (count < least) FAIL("word %u: opcode %u has %u operands; %u are needed", at, word(m, at) & 0xffff, count, least);
}

/* ---- Declarations ---- */

static uint32_t bounded(uint64_t x) { return x < MOST_COMPONENTS ? (uint32_t)x : MOST_COMPONENTS; }

static Type new_type(Module *m, uint32_t op, uint32_t at, uint32_t n) {
    uint32_t a = n > 1 ? word(m, at + 2) : 0, b = n > 2 ? word(m, at + 3) : 0; /* the operands after the result */
    const Type *x;
    uint64_t sum = 0;
    switch (op) {
    case 19: case 20: return (Type){.of = OF_OTHER};
    case 21: operands(m, n, 3, at); return (Type){b ? OF_INT : OF_UINT, a == 32, .components = 1};
    case 22: operands(m, n, 2, at); return (Type){OF_FLOAT, a == 32, .components = 1};
    case 23:
        operands(m, n, 3, at);
        x = type_of(m, a, at);
        return (Type){x->of, x->plain && x->components == 1 && b >= 2 && b <= 4, .components = bounded((uint64_t)x->components * b)};
    case 24: case 28:
        operands(m, n, 3, at);
        x = type_of(m, a, at);
        if (op == 28) b = b < m->bound ? m->constants[b] : 0;
        return (Type){.of = OF_OTHER, .components = bounded((uint64_t)x->components * b)};
    case 25: {
        operands(m, n, 8, at);
        x = type_of(m, a, at);
        uint32_t dim = b, depth = word(m, at + 4), arrayed = word(m, at + 5), samples = word(m, at + 6), sampled = word(m, at + 7);
        if (!x->plain || x->components != 1 || x->of == OF_UINT) FAIL("word %u: an image of what is neither float nor int", at);
        if (!((dim == 1 && sampled == 1) || (dim == 6 && sampled == 2)) || depth == 1 || arrayed || samples || word(m, at + 8))
            FAIL("word %u: an image that is neither sampled 2D nor subpass input", at);
        return (Type){OF_IMAGE, .is_integer = x->of == OF_INT, .is_attachment = dim == 6};
    }
    case 27:
        operands(m, n, 2, at);
        x = type_of(m, a, at);
        if (x->of != OF_IMAGE || x->is_attachment) FAIL("word %u: a combined sampler of what is no sampled image", at);
        return (Type){OF_SAMPLED, .is_integer = x->is_integer};
    case 30:
        for (uint32_t k = 1; k < n; k++) sum += type_of(m, word(m, at + 1 + k), at)->components;
        return (Type){.of = OF_STRUCT, .components = bounded(sum)};
    case 32: operands(m, n, 3, at); type_of(m, b, at); return (Type){.of = OF_POINTER, .pointee = b, .storage = a};
    case 33:
        operands(m, n, 2, at);
        for (uint32_t k = 1; k < n; k++) type_of(m, word(m, at + 1 + k), at);
        return (Type){.of = OF_OTHER};
    default: FAIL("word %u: opcode %u makes a type that is not allowed", at, op);
    }
}

static void variable(Module *m, uint32_t at, uint32_t n) {
    operands(m, n, 3, at);
    uint32_t storage = word(m, at + 3);
    const Type *pointer = type_of(m, word(m, at + 1), at);
    if (pointer->of != OF_POINTER || pointer->storage != storage)
        FAIL("word %u: a variable whose type is no pointer to its storage class", at);
    if (storage != UNIFORM_CONSTANT && storage != IN && storage != OUT && storage != PRIVATE)
        FAIL("word %u: a variable of storage class %u; images, inputs, outputs and private ones are allowed", at, storage);
    for (uint32_t k = 3; k < n; k++) check_id(m, word(m, at + 1 + k), at);
    define(m, word(m, at + 2), at);
    uint32_t *found = m->variables[m->variable_count++];
    found[0] = word(m, at + 2), found[1] = storage, found[2] = pointer->pointee;
}

static void decoration(Module *m, uint32_t op, uint32_t at, uint32_t n) {
    uint32_t member = op == 72;
    operands(m, n, 2 + member, at);
    Marked *mine = m->marks + check_id(m, word(m, at + 1), at);
    uint32_t kind = word(m, at + 2 + member), left = n - 2 - member, bit = 0, *to = NULL;
    switch (kind) {
    case 11: bit = HAS_BUILTIN; break;
    case 30: bit = HAS_LOCATION, to = &mine->location; break;
    case 33: bit = HAS_BINDING, to = &mine->binding; break;
    case 34: bit = HAS_SET, to = &mine->set; break;
    case 43: bit = HAS_ATTACHMENT, to = &mine->attachment; break;
    }
    bool once = bit || kind == 31 || kind == 32; /* Component and Index are refused */
    if (member) {
        if (kind == 11) mine->has |= IS_BUILTIN_BLOCK;
        else if (once) FAIL("word %u: decoration %u of a member is not allowed", at, kind);
        return;
    }
    if (once) {
        operands(m, left, 1, at);
        if (mine->has & bit || !bit) FAIL("word %u: decoration %u %s", at, kind, mine->has & bit ? "twice" : "is not allowed");
    }
    mine->has |= kind == 14 ? HAS_FLAT : bit;
    if (to) *to = word(m, at + 3);
}

static void entry_point(Module *m, uint32_t at, uint32_t n) {
    operands(m, n, 3, at);
    if (m->stage) FAIL("word %u: a second entry point", at);
    uint32_t model = word(m, at + 1);
    if (model != 0 && model != 4) FAIL("word %u: execution model %u; vertex (0) and fragment (4) are allowed", at, model);
    if (n < 4 || word(m, at + 3) != 0x6e69616d || word(m, at + 4)) FAIL("word %u: the entry point must be called main", at);
    m->entry = check_id(m, word(m, at + 2), at);
    for (uint32_t k = 4; k < n; k++) check_id(m, word(m, at + 1 + k), at);
    m->stage = model ? 16 : 1;
}

/* `n` operands of the instruction at a word. */
static void declaration(Module *m, uint32_t op, uint32_t at, uint32_t n) {
    static const char glsl[] = "GLSL.std.450";
    uint32_t first = n ? word(m, at + 1) : 0;
    if (op >= 19 && op <= 33) {
        operands(m, n, 1, at);
        Type made = new_type(m, op, at, n);
        define(m, first, at);
        m->types[first] = made;
    } else if (op == 1 || (op >= 41 && op <= 44) || op == 46) {
        operands(m, n, op == 43 ? 3 : 2, at);
        type_of(m, first, at);
        for (uint32_t k = 1; k < (op == 44 ? n : 2); k++) check_id(m, word(m, at + 1 + k), at);
        define(m, word(m, at + 2), at);
        if (op == 43) m->constants[word(m, at + 2)] = word(m, at + 3);
    } else if (op == 59) {
        variable(m, at, n);
    } else if (op == 71 || op == 72) {
        decoration(m, op, at, n);
    } else if (op == 17) {
        operands(m, n, 1, at);
        if (first > 1 && first != 40 && first != 50 && first != 51) FAIL("word %u: capability %u is not allowed", at, first);
    } else if (op == 11) {
        operands(m, n, 2, at);
        define(m, first, at);
        if ((n - 1) * 4 < sizeof glsl - 1 || memcmp(m->data + 4 * ((uint64_t)at + 2), glsl, sizeof glsl - 1) ||
            ((n - 1) * 4 > sizeof glsl - 1 && m->data[4 * ((uint64_t)at + 2) + sizeof glsl - 1]))
            FAIL("word %u: only the instructions of GLSL.std.450 are allowed", at);
    } else if (op == 14) {
        if (n != 2 || first || word(m, at + 2) != 1) FAIL("word %u: the memory model must be Logical GLSL450", at);
    } else if (op == 15) {
        entry_point(m, at, n);
    } else if (op == 16) {
        operands(m, n, 2, at);
        check_id(m, first, at);
        uint32_t mode = word(m, at + 2);
        if (mode != 7 && mode != 9 && mode != 12 && mode != 14 && mode != 15 &&
            mode != 16) FAIL("word %u: execution mode %u is not allowed", at, mode);
        m->modes |= 1 << mode;
    } else {
        FAIL("word %u: opcode %u is not allowed before the functions", at, op);
    }
}

static uint32_t declarations(Module *m) {
    for (uint32_t at = 5; at < m->count;) {
        uint32_t count = word(m, at) >> 16, op = word(m, at) & 0xffff;
        if (!count || count > m->count - at) FAIL("word %u: an instruction of %u words; %u are left", at, count, m->count - at);
        if (op == 54) return at;
        if (!((op >= 2 && op <= 8) || op == 317 || op == 330)) declaration(m, op, at, count - 1); /* the others are names and lines */
        at += count;
    }
    FAIL("has no function");
}

/* ---- Functions ---- */

/* How many of an instruction's first operands are ids, ALL, or -1 where it is not allowed. */
static int ids_of(uint32_t op) {
    static const int8_t single[][2] = {{1, 2}, {8, 1}, {12, 3}, {54, 2}, {55, 2}, {56, 0}, {57, 3}, {59, 3}, {61, 3}, {62, 2}, {63, 2},
        {65, ALL}, {66, ALL}, {79, 4}, {80, ALL}, {81, 3}, {82, 4}, {83, 3}, {84, 3}, {86, 4}, {87, 4}, {88, 4}, {91, 4}, {92, 4}, {95, 4},
        {96, 5}, {98, 4}, {100, 3}, {103, 4}, {104, 3}, {105, 4}, {106, 3}};
    static const int8_t last[] = {ALL, 2, 1, 1, 1, 3, 2, 0, 0, 1, 0}; /* from 245 on */
    if ((op >= 109 && op <= 116) || op == 124 || (op >= 126 && op <= 152) || (op >= 154 && op <= 191) || (op >= 194 && op <= 205) ||
        (op >= 207 && op <= 215)) return ALL;
    if (op >= 245 && op <= 255) return last[op - 245];
    if (op == 317) return 0;
    for (uint32_t k = 0; k < COUNT(single); k++)
        if ((uint32_t)single[k][0] == op) return single[k][1];
    return -1;
}

static void functions(Module *m, uint32_t start) {
    if (!m->stage) FAIL("has no entry point");
    bool *made = make_scratch(m->r, m->bound, 1), *called = make_scratch(m->r, m->bound, 1);
    uint32_t step = 0, strange = 0;
    for (uint32_t at = start; at < m->count; at += step) {
        uint32_t op = word(m, at) & 0xffff, top = 0;
        step = word(m, at) >> 16;
        if (!step || step > m->count - at) FAIL("word %u: an instruction of %u words; %u are left", at, step, m->count - at);
        int ids = ids_of(op);
        if (ids < 0) FAIL("word %u: opcode %u is not allowed in a function", at, op);
        if (ids != ALL && (uint32_t)ids >= step) FAIL("word %u: opcode %u has %u operands; %d are needed", at, op, step - 1, ids);
        for (uint32_t k = 1; k < (ids == ALL ? step : 1 + (uint32_t)ids); k++)
            if (word(m, at + k) > top) top = word(m, at + k);
        if (top >= m->bound) FAIL("word %u: id %u; ids below %u are allowed", at, top, m->bound);
        if (op == 59 && word(m, at + 3) != FUNCTION && !strange) strange = at;
        if (op == 54) made[word(m, at + 2)] = true;
        if (op == 57) called[word(m, at + 3)] = true;
    }
    if (word(m, m->count - 1) != 0x10038 || step != 1) FAIL("ends within a function");
    if (strange) FAIL("word %u: a variable in a function that is not its own", strange);
    if (!made[m->entry]) FAIL("lacks the entry point's function");
    for (uint32_t x = 0; x < m->bound; x++)
        if (called[x] && !made[x]) FAIL("calls a function that is not there");
}

/* ---- What it means ---- */

static bool *bindings_seen(Module *m) { return make_scratch(m->r, m->count, 1); }

static void bind(Module *m, uint32_t x, const Type *type, Interface *found, bool *seen) {
    const Marked *marks = m->marks + x;
    if (type->of != OF_IMAGE && type->of != OF_SAMPLED) FAIL("id %u: a descriptor that is neither image nor combined sampler", x);
    if (!(marks->has & HAS_SET) || marks->set || !(marks->has & HAS_BINDING)) FAIL("id %u: a descriptor needs set 0 and a binding", x);
    uint32_t number = marks->binding;
    bool twice = number < m->count && seen[number];
    for (uint32_t k = 0; number >= m->count && k < found->used_count; k++) twice |= found->used[k].number == number;
    if (twice) FAIL("binding %u is declared twice", number);
    if (number < m->count) seen[number] = true;
    if (type->is_attachment && (m->stage != 16 || !(marks->has & HAS_ATTACHMENT)))
        FAIL("binding %u: an input attachment needs an index, in a fragment shader", number);
    found->used[found->used_count++] = (Used){number, type->of == OF_SAMPLED ? 1 : type->is_attachment ? 10 : 2,
                                              type->is_attachment ? marks->attachment : 0, type->is_integer};
}

static void locate(const Module *m, uint32_t x, const Type *type, Location *side, bool flat) {
    const Marked *marks = m->marks + x;
    char at[12] = "None";
    if (marks->has & HAS_LOCATION) snprintf(at, sizeof at, "%u", marks->location);
    if (!(marks->has & HAS_LOCATION) || marks->location >= MAX_LOCATIONS)
        FAIL("id %u: an input or output at location %s; 0 to %d are allowed", x, at, MAX_LOCATIONS - 1);
    if (side[marks->location].scalar) FAIL("location %s is declared twice", at);
    if (!type->plain) FAIL("location %s: a scalar or vector of 32 bits is needed", at);
    if (flat && type->of != OF_FLOAT && !(marks->has & HAS_FLAT)) FAIL("location %s: integers need Flat", at);
    side[marks->location] = (Location){type->of, (uint8_t)type->components};
}

static uint64_t components(const Location *side, uint64_t extra) {
    int top = MAX_LOCATIONS;
    while (top && !side[top - 1].scalar) top--;
    return 4 * (uint64_t)top + extra;
}

static const Interface *interface_of(Module *m) {
    if (m->stage == 16 && !(m->modes & 1 << 7)) FAIL("is a fragment shader without OriginUpperLeft");
    Interface *found = make(m->r, 1, sizeof *found);
    uint64_t extra[2] = {0, 0};
    bool *seen = bindings_seen(m);
    found->stage = m->stage;
    found->used = make(m->r, m->variable_count, sizeof *found->used);
    for (uint32_t k = 0; k < m->variable_count; k++) {
        uint32_t x = m->variables[k][0], storage = m->variables[k][1], pointee = m->variables[k][2];
        const Type *type = m->types + pointee;
        if (storage == UNIFORM_CONSTANT) bind(m, x, type, found, seen);
        if (storage != IN && storage != OUT) continue;
        bool built_in = m->marks[x].has & HAS_BUILTIN || (type->of == OF_STRUCT && m->marks[pointee].has & IS_BUILTIN_BLOCK);
        if (built_in) {
            extra[storage == OUT] += type->components;
            continue;
        }
        locate(m, x, type, storage == IN ? found->inputs : found->outputs, m->stage == 16 && storage == IN);
        if (storage == IN) found->order[found->input_count++] = (uint8_t)m->marks[x].location;
        else found->output_count++;
    }
    if (m->stage == 1 && found->input_count) FAIL("takes vertex attributes; a bundle has none");
    found->input_components = components(found->inputs, extra[0]);
    found->output_components = components(found->outputs, extra[1]);
    return found;
}

const Interface *parse_shader(Reader *r, const uint8_t *data, uint64_t size) {
    Module module = {.r = r, .data = data}, *m = &module;
    if (size % 4 || size < 20) FAIL("%llu bytes are no SPIR-V module", (unsigned long long)size);
    m->count = (uint32_t)(size / 4);
    if (word(m, 0) != 0x07230203) FAIL("begins with 0x%08x; SPIR-V begins with 0x07230203", word(m, 0));
    if (word(m, 1) != 0x00010000) FAIL("is SPIR-V version 0x%x; 1.0 (0x10000) is allowed", word(m, 1));
    m->bound = word(m, 3);
    if (!m->bound || m->bound > m->count) FAIL("has ids up to %u; at most one a word, %u, is allowed", m->bound, m->count);
    if (word(m, 4)) FAIL("has the reserved word %u; 0 is allowed", word(m, 4));
    m->types = make_scratch(r, m->bound, sizeof *m->types);
    m->constants = make_scratch(r, m->bound, sizeof *m->constants);
    m->defined = make_scratch(r, m->bound, 1);
    m->marks = make_scratch(r, m->bound, sizeof *m->marks);
    m->variables = make_scratch(r, m->bound, sizeof *m->variables); /* each defines an id */
    functions(m, declarations(m));
    return interface_of(m);
}
