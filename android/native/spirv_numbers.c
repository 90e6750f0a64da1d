/* Instructions whose operands and results are numbers and truth values: dressi_edge/cache/spirv_table.py and spirv_numbers.py in C. */

#include "spirv.h"

#include <string.h>

/* How operands go with the result: of its type; of its size, whatever the sign; of its size, and all of one type. */
typedef enum How { SAME, SIZE, ALIKE } How;
typedef struct Row { const char *made, *taken; uint8_t count; How how; } Row; /* letters, letters, operands */

static bool between(uint32_t x, uint32_t low, uint32_t high) { return x >= low && x <= high; }

static bool among(uint32_t x, const uint8_t *all, size_t count) { return memchr(all, (int)x, count) && x < 256; }
#define AMONG(x, ...) among(x, (const uint8_t[]){__VA_ARGS__}, sizeof((const uint8_t[]){__VA_ARGS__}))

static Row row_of(uint32_t op) {
    if (op == 109) return (Row){"u", "f", 1, SIZE};
    if (op == 110) return (Row){"iu", "f", 1, SIZE};
    if (op == 111 || op == 112) return (Row){"f", "iu", 1, SIZE};
    if (op == 116 || op == 127 || between(op, 207, 215)) return (Row){"f", "f", 1, SAME};
    if (op == 124) return (Row){"fiu", "fiu", 1, SIZE};
    if (op == 126 || op == 200 || op == 205) return (Row){"iu", "iu", 1, SIZE};
    if (op == 134 || op == 137) return (Row){"u", "u", 2, SAME};
    if (AMONG(op, 128, 130, 132, 135, 138, 139) || between(op, 194, 199)) return (Row){"iu", "iu", 2, SIZE};
    if (AMONG(op, 129, 131, 133, 136, 140, 141)) return (Row){"f", "f", 2, SAME};
    if (op == 156 || op == 157) return (Row){"b", "f", 1, SIZE};
    if (op == 168) return (Row){"b", "b", 1, SAME};
    if (between(op, 164, 167)) return (Row){"b", "b", 2, SAME};
    if (between(op, 170, 179)) return (Row){"b", "iu", 2, SIZE};
    if (between(op, 180, 191)) return (Row){"b", "f", 2, ALIKE};
    if (op == 204) return (Row){"iu", "iu", 1, SAME};
    return (Row){NULL, NULL, 0, SAME};
}

/* Of GLSL.std.450, by number. */
static Row extended_row(uint32_t n) {
    if (AMONG(n, 1, 2, 3, 4, 6, 69) || between(n, 8, 24) || between(n, 27, 32)) return (Row){"f", "f", 1, SAME};
    if (AMONG(n, 25, 26, 37, 40, 48, 71, 79, 80)) return (Row){"f", "f", 2, SAME};
    if (AMONG(n, 43, 46, 49, 50, 70, 81)) return (Row){"f", "f", 3, SAME};
    if (AMONG(n, 5, 7, 73, 74, 75)) return (Row){"iu", "iu", 1, SIZE};
    if (AMONG(n, 38, 39, 41, 42)) return (Row){"iu", "iu", 2, SIZE};
    if (AMONG(n, 44, 45)) return (Row){"iu", "iu", 3, SIZE};
    return (Row){NULL, NULL, 0, SAME};
}

/* Those whose operands are of other sizes: results and operands, each a letter and how many; n: of any, the same in all. */
typedef struct Shaped { uint8_t number; const char *made, *taken; } Shaped;
static const Shaped SHAPES[] = {{66, "f1", "fn"}, {67, "f1", "fnfn"}, {68, "f3", "f3f3"}, {72, "fn", "fnfnf1"}, {53, "fn", "fnin"},
    {36, "fnfn", "fn"}, {52, "fnin", "fn"}, {54, "u1", "f4"}, {55, "u1", "f4"}, {56, "u1", "f2"}, {57, "u1", "f2"}, {58, "u1", "f2"},
    {60, "f2", "u1"}, {61, "f2", "u1"}, {62, "f2", "u1"}, {63, "f4", "u1"}, {64, "f4", "u1"}};

static _Noreturn void do_not_go(const Module *m, uint32_t at) { WRONG(m, at, "operands whose types do not go with the result's"); }

static void together(Body *b, const Type *made, uint32_t number, const uint32_t *types, uint32_t count, Row row, uint32_t at) {
    const Module *m = b->m;
    if (!made->letter || !letter_in(made, row.made))
        WRONG(m, at, "a result of type %s %.*s; letters %s are allowed", kind_word(made), made->letter != 0, &made->letter, row.made);
    for (uint32_t k = 0; k < count; k++) {
        const Type *given = m->types + types[k];
        if ((row.how == SAME && types[k] != number) || !given->letter || !letter_in(given, row.taken) ||
            given->components != made->components || (row.how == ALIKE && types[k] != types[0])) do_not_go(m, at);
    }
}

bool number_instruction(Body *b, uint32_t op, const Ops *asked) {
    Row row = row_of(op);
    if (!row.made || !asked) return row.made != NULL;
    Module *m = b->m;
    Ops o = *asked;
    uint32_t types[2];
    operands(m, o, 2 + row.count, 2 + row.count);
    for (uint32_t k = 0; k < row.count; k++) types[k] = value(b, op_at(m, o, 2 + k), o.at);
    together(b, result(b, op_at(m, o, 0), op_at(m, o, 1), o.at), op_at(m, o, 0), types, row.count, row, o.at);
    if (between(op, 207, 215)) only_fragments(b, op, o.at);
    return true;
}

/* ---- GLSL.std.450 ---- */

/* modf and frexp: a result, and one more that is stored. */
static void pointed(Body *b, Ops o) {
    Module *m = b->m;
    operands(m, o, 6, 6);
    uint32_t given = value(b, op_at(m, o, 4), o.at);
    const Type *target = pointer(b, op_at(m, o, 5), o.at), *made = result(b, op_at(m, o, 0), op_at(m, o, 1), o.at);
    const Type *stored = m->types + target->of;
    if (made->letter != 'f' || given != op_at(m, o, 0) || target->storage == UNIFORM_CONSTANT || target->storage == IN || !stored->letter ||
        !letter_in(stored, op_at(m, o, 3) == 35 ? "f" : "iu") || stored->components != made->components) do_not_go(m, o.at);
}

static bool is_shaped(const Module *m, const Type *made, uint32_t number, const uint32_t *types, const Shaped *shape) {
    uint32_t results = (uint32_t)strlen(shape->made) / 2, taken = (uint32_t)strlen(shape->taken) / 2;
    uint64_t size = 0;
    if (results > 1 && made->member_count != results) return false;
    for (uint32_t k = 0; k < results + taken; k++) {
        const char *want = k < results ? shape->made + 2 * k : shape->taken + 2 * (k - results);
        uint32_t x = k >= results ? types[k - results] : results > 1 ? member_of(m, made, k) : number;
        const Type *found = m->types + x;
        if (!size && want[1] == 'n') size = found->components;
        if (found->letter != want[0] && !(want[0] == 'i' && found->letter == 'u')) return false;
        if (found->components != (want[1] == 'n' ? size : (uint64_t)(want[1] - '0'))) return false;
    }
    return true;
}

/* The determinant (33) or the inverse (34) of a square matrix. */
static bool is_square(const Module *m, uint32_t number, uint32_t given, uint32_t op) {
    const Type *x = m->types + given;
    if (x->kind != MATRIX || m->types[x->of].count != x->count) return false;
    return number == (op == 34 ? given : m->types[x->of].of);
}

void extended_instruction(Body *b, Ops o) {
    Module *m = b->m;
    operands(m, o, 4, NO_LIMIT);
    uint32_t n = op_at(m, o, 3), count = o.n - 4, types[3];
    if (op_at(m, o, 2) != m->instructions || !m->instructions) WRONG(m, o.at, "only the instructions of GLSL.std.450 are allowed");
    if (n == 35 || n == 51) {
        pointed(b, o);
        return;
    }
    for (uint32_t k = 0; k < count; k++) {
        uint32_t type = value(b, op_at(m, o, 4 + k), o.at);
        if (k < COUNT(types)) types[k] = type;
    }
    Row row = extended_row(n);
    const Shaped *shape = NULL;
    for (size_t k = 0; k < COUNT(SHAPES); k++)
        if (SHAPES[k].number == n) shape = SHAPES + k;
    bool square = n == 33 || n == 34;
    uint32_t needed = row.made ? row.count : shape ? (uint32_t)strlen(shape->taken) / 2 : 1;
    if (!(row.made || shape || square) || count != needed)
        WRONG(m, o.at, "instruction %u of GLSL.std.450 with %u operands is not allowed", n, count);
    const Type *made = result(b, op_at(m, o, 0), op_at(m, o, 1), o.at);
    if (row.made) together(b, made, op_at(m, o, 0), types, count, row, o.at);
    else if (!(shape ? is_shaped(m, made, op_at(m, o, 0), types, shape) : is_square(m, op_at(m, o, 0), types[0], n))) do_not_go(m, o.at);
}
