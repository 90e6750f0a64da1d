/* Instructions of compute shaders alone: texels that are written, sums that several invocations add to, and where they wait for each other.
   dressi_edge/cache/spirv_shared.py in C, in its order and words; there is why nothing may use what an atomic gives back. */

#include "spirv.h"

enum { DEVICE = 1, GROUP = 2, RELAXED = 0, GROUP_MEMORY = 0x108 }; /* scopes; memory semantics: none, acquire and release of what is shared */

#define O(k) op_at(b->m, o, k)

static void only_compute(Body *b, uint32_t op, uint32_t at) {
    if (b->m->stage != COMPUTE_STAGE) WRONG(b->m, at, "opcode %u belongs to compute shaders", op);
}

static void constant(Body *b, uint32_t x, uint32_t wanted, uint32_t at) {
    value(b, x, at);
    if (!b->m->is_integer[x] || b->m->integers[x] != wanted)
        WRONG(b->m, at, "id %u is no constant %u, as scopes, memory semantics and samples must be here", x, wanted);
}

static void write_texel(Body *b, Ops o) {
    operands(b->m, o, 3, 3);
    const Type *image = image_operand(b, O(0), PICTURE, o.at, false, true);
    place_in(b, O(1), "iu", 2, o.at, 2);
    const Type *texel = value_type(b, O(2), o.at);
    if (texel->kind != VECTOR || texel->count != 4 || texel->of != image->of)
        WRONG(b->m, o.at, "a write to an image of what is not four of its numbers");
}

static void texel_pointer(Body *b, Ops o) {
    Module *m = b->m;
    operands(m, o, 5, 5);
    const Type *made = type_of(m, O(0), o.at), *image = m->types + pointer(b, O(2), o.at)->of;
    place_in(b, O(3), "iu", 2, o.at, 2);
    constant(b, O(4), 0, o.at);
    if (image->kind != PICTURE || image->format != 99 || made->kind != POINTER || made->storage != TEXEL || made->of != image->of)
        WRONG(m, o.at, "a pointer to a texel of what is no storage image of one integer");
    result(b, O(0), O(1), o.at);
}

/* Atomically; of the result there is an id, and no value. */
static void add(Body *b, Ops o) {
    Module *m = b->m;
    operands(m, o, 6, 6);
    const Type *target = shared_pointer(b, O(2), o.at);
    constant(b, O(3), DEVICE, o.at);
    constant(b, O(4), RELAXED, o.at);
    const Type *type = type_of(m, O(0), o.at);
    if ((target->storage != TEXEL && target->storage != WORKGROUP) || type->kind != INT || target->of != O(0) || value(b, O(5), o.at) != O(0))
        WRONG(m, o.at, "a sum of what is no int that invocations share");
    define(m, O(1), o.at);
}

static void wait_for_group(Body *b, Ops o) {
    operands(b->m, o, 3, 3);
    constant(b, O(0), GROUP, o.at);
    constant(b, O(1), GROUP, o.at);
    constant(b, O(2), GROUP_MEMORY, o.at);
}

bool shared_instruction(Body *b, uint32_t op, const Ops *asked) {
    bool known = op == 60 || op == 99 || op == 224 || op == 234;
    if (!known || !asked) return known;
    only_compute(b, op, asked->at);
    switch (op) {
    case 60: texel_pointer(b, *asked); break;
    case 99: write_texel(b, *asked); break;
    case 224: wait_for_group(b, *asked); break;
    default: add(b, *asked);
    }
    return true;
}
