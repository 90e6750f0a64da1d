/* Instructions that look into composites, through pointers and at images, and those of matrices: dressi_edge/cache/spirv_values.py in C. */

#include "spirv.h"

enum { BIAS = 1, LOD = 2, GRAD = 4, OFFSET = 8, QUERY = 50 }; /* what follows the operands of an image instruction; the capability */

#define O(k) op_at(b->m, o, k)

static void finish(Body *b, Ops o) { result(b, O(0), O(1), o.at); }

static const Type *scalar(Body *b, uint32_t x, const char *letters, uint32_t at) {
    const Type *type = value_type(b, x, at);
    if (type->components != 1 || !type->letter || !letter_in(type, letters))
        WRONG(b->m, at, "id %u is no scalar of letters %s", x, letters);
    return type;
}

/* The id of the type of a part of a composite. */
static uint32_t part(Body *b, uint32_t kind, uint32_t index, uint32_t at) {
    const Module *m = b->m;
    const Type *found = m->types + kind;
    if (index >= found->count) WRONG(m, at, "part %u of %s with %u", index, kind_word(found), found->count);
    if (m->closed[kind]) {
        const Member *member = find_member(m, kind, index);
        if (member && (member->built_in == 3 || member->built_in == 4)) WRONG(m, at, "built-in member %u, which needs a feature", index);
        b->m->writes_size |= member && member->built_in == 1;
    }
    return part_of(m, found, index);
}

/* ---- Composites and pointers ---- */

static void copy_memory(Body *b, Ops o) {
    operands(b->m, o, 2, 2);
    const Type *to = pointer(b, O(0), o.at), *from = pointer(b, O(1), o.at);
    if (to->of != from->of || b->m->closed[to->of] || to->storage == UNIFORM_CONSTANT || to->storage == IN)
        WRONG(b->m, o.at, "a copy between other types, or to where nothing may be stored");
}

static void access_chain(Body *b, Ops o) {
    Module *m = b->m;
    operands(m, o, 3, 3 + 255);
    const Type *base = pointer(b, O(2), o.at);
    uint32_t kind = base->of;
    for (uint32_t k = 3; k < o.n; k++) {
        uint32_t x = O(k);
        scalar(b, x, "iu", o.at);
        bool known = m->is_integer[x];
        if (!known && m->types[kind].kind == STRUCT) WRONG(m, o.at, "a member of a structure that is no constant (id %u)", x);
        kind = part(b, kind, known ? m->integers[x] : 0, o.at);
    }
    const Type *made = type_of(m, O(0), o.at);
    if (made->kind != POINTER || made->storage != base->storage || made->of != kind)
        WRONG(m, o.at, "a pointer to another type than what is there, or of another storage class");
    finish(b, o);
}

static void shuffle(Body *b, Ops o) {
    Module *m = b->m;
    operands(m, o, 6, NO_LIMIT);
    const Type *made = type_of(m, O(0), o.at), *x = value_type(b, O(2), o.at), *y = value_type(b, O(3), o.at);
    bool good = made->kind == VECTOR && x->kind == VECTOR && y->kind == VECTOR && x->of == made->of && y->of == made->of &&
                o.n - 4 == made->count;
    for (uint32_t k = 4; good && k < o.n; k++) good = O(k) < x->count + y->count || O(k) == UINT32_MAX;
    if (!good) WRONG(m, o.at, "a shuffle of what is no vector of the result's scalars, or of scalars that they have not");
    finish(b, o);
}

static void construct(Body *b, Ops o) {
    Module *m = b->m;
    operands(m, o, 3, NO_LIMIT);
    const Type *made = holds(m, O(0), o.at);
    bool good = made->kind == VECTOR ? o.n > 3 : made->count == o.n - 2;
    uint64_t sum = 0;
    for (uint32_t k = 2; k < o.n; k++) {
        uint32_t type = value(b, O(k), o.at);
        const Type *x = m->types + type;
        sum += x->components;
        if (made->kind == VECTOR) good &= x->letter == made->letter && (made->of == type || made->of == x->of);
        else good = good && type == part_of(m, made, k - 2);
    }
    if (!good || (made->kind == VECTOR && sum != made->count)) WRONG(m, o.at, "a composite of what its type has not");
    finish(b, o);
}

static void extract(Body *b, Ops o) {
    operands(b->m, o, 4, NO_LIMIT);
    uint32_t kind = value(b, O(2), o.at);
    for (uint32_t k = 3; k < o.n; k++) kind = part(b, kind, O(k), o.at);
    if (kind != O(0)) WRONG(b->m, o.at, "a part of another type than the result's");
    finish(b, o);
}

static void insert(Body *b, Ops o) {
    operands(b->m, o, 5, NO_LIMIT);
    uint32_t given = value(b, O(2), o.at), kind = value(b, O(3), o.at), whole = kind;
    for (uint32_t k = 4; k < o.n; k++) kind = part(b, kind, O(k), o.at);
    if (kind != given || whole != O(0)) WRONG(b->m, o.at, "a part of another type than what is there");
    finish(b, o);
}

static void copy(Body *b, Ops o) {
    operands(b->m, o, 3, 3);
    if (value(b, O(2), o.at) != O(0) || !b->m->types[O(0)].components)
        WRONG(b->m, o.at, "a copy of another type, or of what holds no numbers");
    finish(b, o);
}

static uint32_t rows(const Module *m, const Type *matrix) { return m->types[matrix->of].count; }

static void transpose(Body *b, Ops o) {
    Module *m = b->m;
    operands(m, o, 3, 3);
    const Type *made = type_of(m, O(0), o.at), *x = value_type(b, O(2), o.at);
    if (made->kind != MATRIX || x->kind != MATRIX || made->count != rows(m, x) || rows(m, made) != x->count)
        WRONG(m, o.at, "a transposed matrix of another size");
    finish(b, o);
}

/* ---- Images ---- */

/* Bias, level of detail, gradients and offset, from operand `first` on. */
static void image_operands(Body *b, Ops o, uint32_t first, uint32_t allowed) {
    static const struct { uint8_t bit, size; const char *letters; } rows[] = {{BIAS, 1, "f"}, {LOD, 1, "fiu"}, {GRAD, 2, "f"}, {GRAD, 2,
        "f"},
                                                                              {OFFSET, 2, "iu"}};
    const Module *m = b->m;
    if (o.n <= first) return;
    uint32_t mask = O(first), next = first + 1;
    if (mask & ~allowed || (!mask && next < o.n)) WRONG(m, o.at, "image operands %u; %u are allowed", mask, allowed);
    for (size_t k = 0; k < COUNT(rows); k++) {
        if (!(mask & rows[k].bit)) continue;
        const Type *type = next < o.n ? value_type(b, O(next), o.at) : NULL;
        if (!type || !type->letter || !letter_in(type, rows[k].letters) || type->components != rows[k].size ||
            (rows[k].bit == OFFSET && !m->fixed[O(next)])) WRONG(m, o.at, "an image operand that is missing or of another type");
        next++;
    }
    if (next < o.n) WRONG(m, o.at, "more image operands than are named");
}

/* The result of a read: four numbers of the image's. */
static void texel(Body *b, Ops o, const Type *image) {
    Module *m = b->m;
    const Type *made = type_of(m, O(0), o.at), *sampled = image->kind == PICTURE ? image : m->types + image->of;
    if (made->kind != VECTOR || made->count != 4 || made->of != sampled->of)
        WRONG(m, o.at, "a read of an image that gives another type than four of its numbers");
    finish(b, o);
}

const Type *image_operand(Body *b, uint32_t x, TypeKind kind, uint32_t at, bool attachment, bool storage) {
    const Type *found = value_type(b, x, at);
    if (found->kind != kind || found->is_attachment != attachment || (found->format != 0) != storage)
        WRONG(b->m, at, "id %u is no %s%s", x, kind == SAMPLED ? "sampled" : "image",
              attachment ? " of a subpass" : storage ? " to write" : "");
    return found;
}

void place_in(Body *b, uint32_t x, const char *letters, uint32_t least, uint32_t at, uint32_t most) {
    const Type *type = value_type(b, x, at);
    if (!type->letter || !letter_in(type, letters) || type->components < least || type->components > most)
        WRONG(b->m, at, "id %u is no place in an image", x);
}

/* Opcodes 87, 88, 91, 92. */
static void sample(Body *b, Ops o, uint32_t op) {
    Module *m = b->m;
    bool is_explicit = op == 88 || op == 92, projective = op > 90;
    operands(m, o, 4, NO_LIMIT);
    const Type *image = image_operand(b, O(2), SAMPLED, o.at, false, false);
    if (!is_explicit) only_fragments(b, op, o.at);
    place_in(b, O(3), "f", 2 + projective, o.at, 4);
    uint32_t which = o.n > 4 ? O(4) & (LOD | GRAD) : 0;
    if (is_explicit && which != LOD && which != GRAD) WRONG(m, o.at, "a sample with neither a level of detail nor gradients");
    if (is_explicit && which == LOD && o.n > 5) scalar(b, O(5), "f", o.at);
    image_operands(b, o, 4, OFFSET | (is_explicit ? LOD | GRAD : BIAS));
    texel(b, o, image);
}

static void fetch(Body *b, Ops o) {
    operands(b->m, o, 4, NO_LIMIT);
    const Type *image = image_operand(b, O(2), PICTURE, o.at, false, false);
    place_in(b, O(3), "iu", 2, o.at, 4);
    if (o.n > 5 && O(4) & LOD) scalar(b, O(5), "iu", o.at);
    image_operands(b, o, 4, LOD | OFFSET);
    texel(b, o, image);
}

static void gather(Body *b, Ops o) {
    operands(b->m, o, 5, NO_LIMIT);
    const Type *image = image_operand(b, O(2), SAMPLED, o.at, false, false);
    place_in(b, O(3), "f", 2, o.at, 4);
    scalar(b, O(4), "iu", o.at);
    image_operands(b, o, 5, OFFSET);
    texel(b, o, image);
}

static void read_subpass(Body *b, Ops o) {
    operands(b->m, o, 4, 4);
    const Type *image = image_operand(b, O(2), PICTURE, o.at, true, false);
    if (b->m->stage != FRAGMENT_STAGE) WRONG(b->m, o.at, "a subpass input belongs to fragment shaders");
    place_in(b, O(3), "iu", 2, o.at, 4);
    texel(b, o, image);
}

static void image_of(Body *b, Ops o) {
    operands(b->m, o, 3, 3);
    if (image_operand(b, O(2), SAMPLED, o.at, false, false)->of != O(0)) WRONG(b->m, o.at, "the image of a combined sampler, of another type");
    finish(b, o);
}

/* Opcodes 103 (size at a level), 105 (level of a place), 106 (levels). */
static void query(Body *b, Ops o, uint32_t op) {
    Module *m = b->m;
    uint32_t needed = op == 106 ? 3 : 4;
    operands(m, o, needed, needed);
    image_operand(b, O(2), op == 105 ? SAMPLED : PICTURE, o.at, false, false);
    if (op == 105) only_fragments(b, op, o.at);
    if (op == 103) place_in(b, O(3), "iu", 1, o.at, 1);
    if (op == 105) place_in(b, O(3), "f", 2, o.at, 4);
    const Type *made = type_of(m, O(0), o.at);
    if (!(m->capabilities >> QUERY & 1) || !made->letter || !letter_in(made, op == 105 ? "f" : "iu") || made->components != (op == 106
        ? 1 : 2))
        WRONG(m, o.at, "a query without capability %d, or of another type", QUERY);
    finish(b, o);
}

/* ---- Matrices, and numbers of several sizes ---- */

static bool floats(const Type *type, uint32_t count) { return type->kind == VECTOR && type->letter == 'f' && type->count == count; }

/* Opcodes 142 to 148: vector and matrix times scalar, vector and matrix in each order, outer and dot product. */
static void product(Body *b, Ops o, uint32_t op) {
    Module *m = b->m;
    operands(m, o, 4, 4);
    uint32_t p = value(b, O(2), o.at), q = value(b, O(3), o.at);
    const Type *made = type_of(m, O(0), o.at), *x = m->types + p, *y = m->types + q;
    bool is_scalar = y->kind == FLOAT, column = x->kind == VECTOR && x->letter == 'f', good = false;
    switch (op) {
    case 142: good = column && is_scalar && p == O(0); break;
    case 143: good = x->kind == MATRIX && is_scalar && p == O(0); break;
    case 144: good = column && y->kind == MATRIX && y->of == p && floats(made, y->count); break;
    case 145: good = x->kind == MATRIX && floats(y, x->count) && x->of == O(0); break;
    case 146: good = x->kind == MATRIX && y->kind == MATRIX && made->kind == MATRIX && rows(m, y) == x->count && made->of == x->of &&
                     made->count == y->count; break;
    case 147: good = column && y->letter == 'f' && made->kind == MATRIX && made->of == p && made->count == y->count && y->count > 1; break;
    case 148: good = column && p == q && made->kind == FLOAT; break;
    }
    if (!good) WRONG(m, o.at, "a product of types that do not go together");
    finish(b, o);
}

/* Opcodes 149 to 152: results of twice the bits, as a structure of two. */
static void wide(Body *b, Ops o, uint32_t op) {
    Module *m = b->m;
    operands(m, o, 4, 4);
    uint32_t p = value(b, O(2), o.at), q = value(b, O(3), o.at);
    const Type *made = type_of(m, O(0), o.at);
    bool good = made->kind == STRUCT && made->count == 2 && p == q && member_of(m, made, 0) == p && member_of(m, made, 1) == p;
    if (!good || !m->types[p].letter || !letter_in(m->types + p, op == 152 ? "iu" : "u"))
        WRONG(m, o.at, "a result that is no structure of two of the operands' type");
    finish(b, o);
}

static void any_all(Body *b, Ops o) {
    operands(b->m, o, 3, 3);
    const Type *x = value_type(b, O(2), o.at);
    if (type_of(b->m, O(0), o.at)->kind != BOOL || x->kind != VECTOR || x->letter != 'b')
        WRONG(b->m, o.at, "any or all of what is no vector of truth values");
    finish(b, o);
}

static void choice(Body *b, Ops o) {
    operands(b->m, o, 5, 5);
    const Type *made = type_of(b->m, O(0), o.at), *which = value_type(b, O(2), o.at);
    if (!made->letter || which->letter != 'b' || which->components != made->components || value(b, O(3), o.at) != O(0) ||
        value(b, O(4), o.at) != O(0)) WRONG(b->m, o.at, "a choice among other types, or by what is no truth value for each number");
    finish(b, o);
}

/* Of the result's type, `count` operands; then offset and number of bits. */
static void bit_field(Body *b, Ops o, uint32_t count) {
    operands(b->m, o, 4 + count, 4 + count);
    const Type *made = type_of(b->m, O(0), o.at);
    bool good = made->letter == 'i' || made->letter == 'u';
    for (uint32_t k = 0; good && k < count; k++) good = value(b, O(2 + k), o.at) == O(0);
    if (!good) WRONG(b->m, o.at, "bits of what is no integer of the result's type");
    for (uint32_t k = 2 + count; k < o.n; k++) scalar(b, O(k), "iu", o.at);
    finish(b, o);
}

bool value_instruction(Body *b, uint32_t op, const Ops *asked) {
    bool known = op == 1 || op == 63 || op == 65 || op == 66 || (op >= 79 && op <= 84) || op == 87 || op == 88 || op == 91 || op == 92 ||
                 op == 95 || op == 96 || op == 98 || op == 100 || op == 103 || op == 105 || op == 106 || (op >= 142 && op <= 152) ||
                 op == 154 || op == 155 || op == 169 || (op >= 201 && op <= 203);
    if (!known || !asked) return known;
    Ops o = *asked;
    switch (op) {
    case 1: operands(b->m, o, 2, 2); holds(b->m, O(0), o.at); finish(b, o); break;
    case 63: copy_memory(b, o); break;
    case 65: case 66: access_chain(b, o); break;
    case 79: shuffle(b, o); break;
    case 80: construct(b, o); break;
    case 81: extract(b, o); break;
    case 82: insert(b, o); break;
    case 83: copy(b, o); break;
    case 84: transpose(b, o); break;
    case 87: case 88: case 91: case 92: sample(b, o, op); break;
    case 95: fetch(b, o); break;
    case 96: gather(b, o); break;
    case 98: read_subpass(b, o); break;
    case 100: image_of(b, o); break;
    case 103: case 105: case 106: query(b, o, op); break;
    case 154: case 155: any_all(b, o); break;
    case 169: choice(b, o); break;
    case 201: case 202: case 203: bit_field(b, o, op == 201 ? 2 : 1); break;
    default: op < 149 ? product(b, o, op) : wide(b, o, op);
    }
    return true;
}
