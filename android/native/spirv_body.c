/* The functions of a module: every instruction, its types, what it uses and where that was made; calls as drivers follow them, who put
   functions into each other. dressi_edge/cache/spirv_body.py in C, in its order and words. */

#include "spirv.h"

enum { MAX_WORK = 1 << 18, MAX_CALLS = 64, SELECT = 's', SWITCH = 'w', LOOP = 'l' };
enum { VARIABLE = 59, PHI = 245, LOOP_MERGE = 246, SELECTION_MERGE = 247, LABEL = 248 };

typedef unsigned long long ull;

#define O(k) op_at(b->m, o, k)

static bool is_line(uint32_t op) { return op == 8 || op == 317; }
static bool is_end(uint32_t op) { return op >= 249 && op <= 255; }

/* ---- Ids ---- */

uint32_t value(Body *b, uint32_t x, uint32_t at) {
    const Module *m = b->m;
    if (x >= m->bound) WRONG(m, at, "id %u; ids below %u are allowed", x, m->bound);
    if (!m->values[x]) WRONG(m, at, "id %u is no value made before", x);
    uint32_t made = b->local_of[x];
    if (made && made - 1 != (uint32_t)b->block) {
        Use use = {(uint32_t)b->block, made - 1};
        const Use *last = b->use_count ? b->uses + b->use_count - 1 : NULL;
        if (!last || last->block != use.block || last->made != use.made) b->uses[b->use_count++] = use;
    }
    return m->values[x];
}

const Type *value_type(Body *b, uint32_t x, uint32_t at) { return b->m->types + value(b, x, at); }

const Type *pointer(Body *b, uint32_t x, uint32_t at) {
    const Type *found = value_type(b, x, at);
    if (found->kind != POINTER || found->storage == TEXEL) WRONG(b->m, at, "id %u is no pointer", x);
    b->m->touched[x] = true;
    return found;
}

const Type *shared_pointer(Body *b, uint32_t x, uint32_t at) {
    const Type *found = value_type(b, x, at);
    if (found->kind != POINTER) WRONG(b->m, at, "id %u is no pointer", x);
    b->m->touched[x] = true;
    return found;
}

static void keep_local(Body *b, uint32_t x, uint32_t type, uint32_t block) {
    b->m->values[x] = type;
    b->local_of[x] = block + 1;
    b->locals[b->local_count++] = x;
}

const Type *result(Body *b, uint32_t kind, uint32_t x, uint32_t at) {
    const Type *found = type_of(b->m, kind, at);
    keep_local(b, define(b->m, x, at), kind, (uint32_t)b->block);
    if (!found->letter && found->components) weigh(b->m, found, at);
    return found;
}

void only_fragments(Body *b, uint32_t op, uint32_t at) {
    if (b->m->stage != FRAGMENT_STAGE) WRONG(b->m, at, "opcode %u belongs to fragment shaders", op);
    if (op >= 210 && op <= 215 && !(b->m->capabilities >> 51 & 1)) WRONG(b->m, at, "opcode %u needs capability 51", op);
}

/* ---- Instructions in a block ---- */

static void check_access(Body *b, Ops o, uint32_t k) {
    if (o.n > k && O(k) & ~5u) WRONG(b->m, o.at, "memory access %u; 0, 1, 4 and 5 are allowed", O(k));
}

static void load(Body *b, Ops o) {
    operands(b->m, o, 3, 4);
    check_access(b, o, 3);
    if (pointer(b, O(2), o.at)->of != O(0) || b->m->closed[O(0)]) WRONG(b->m, o.at, "a load of another type than id %u points to", O(2));
    result(b, O(0), O(1), o.at);
}

static void store(Body *b, Ops o) {
    operands(b->m, o, 2, 3);
    check_access(b, o, 2);
    const Type *target = pointer(b, O(0), o.at);
    if (target->of != value(b, O(1), o.at) || b->m->closed[target->of] || target->storage == UNIFORM_CONSTANT || target->storage == IN)
        WRONG(b->m, o.at, "a store into id %u, of another type, or where nothing may be stored", O(0));
}

static void variable(Body *b, Ops o) {
    Module *m = b->m;
    operands(m, o, 3, 4);
    const Type *type = type_of(m, O(0), o.at);
    if (O(2) != LOCAL || type->kind != POINTER || type->storage != LOCAL) WRONG(m, o.at, "a variable in a function that is not its own");
    if (b->block || b->begun) WRONG(m, o.at, "a variable that is not at the beginning of its function");
    if (o.n == 4 && (O(3) >= m->bound || !m->fixed[O(3)] || m->values[O(3)] != type->of))
        WRONG(m, o.at, "a variable that begins with what is no constant of its type");
    result(b, O(0), O(1), o.at);
    weigh(m, m->types + type->of, o.at);
    b->work += m->types[type->of].components;
}

static void phi(Body *b, Ops o) {
    operands(b->m, o, 4, NO_LIMIT);
    if (o.n % 2 || b->begun || !b->block)
        WRONG(b->m, o.at, "a phi that is not at the beginning of a later block, with a parent for each value");
    holds(b->m, O(0), o.at);
    result(b, O(0), O(1), o.at);
    b->phis[b->phi_count].at = o.at;
    b->phis[b->phi_count++].block = (uint32_t)b->block;
}

static void call(Body *b, Ops o) {
    Module *m = b->m;
    operands(m, o, 3, NO_LIMIT);
    uint32_t callee = O(2), first = b->argument_count;
    for (uint32_t k = 3; k < o.n; k++) b->arguments[b->argument_count++] = value(b, O(k), o.at);
    for (uint32_t k = 3; k < o.n; k++) m->touched[O(k)] = true;
    check_id(m, callee, o.at);
    const Type *type = type_of(m, O(0), o.at);
    keep_local(b, define(m, O(1), o.at), O(0), (uint32_t)b->block);
    if (!type->letter) weigh(m, type, o.at);
    Routine *mine = b->functions + b->function_count - 1;
    if (b->link_by[callee] == b->function_count) {
        b->links[b->link_of[callee]].times++;
    } else { /* in the order of first calls */
        uint32_t number = ++b->link_count, *last = &mine->links; /* 0 is the end */
        while (*last) last = &b->links[*last].next;
        *last = number;
        b->links[number] = (Link){callee, 1, 0};
        b->link_by[callee] = b->function_count, b->link_of[callee] = number;
    }
    b->called[b->called_count++] = (Called){o.at, callee, O(0), first, o.n - 3};
}

static void merge(Body *b, Ops o, uint32_t op) {
    uint32_t needed = op == LOOP_MERGE ? 3 : 2;
    operands(b->m, o, needed, needed);
    if (O(needed - 1) > 3) WRONG(b->m, o.at, "merge control %u; at most 3 is allowed", O(needed - 1));
    b->blocks[b->block].kind = op == LOOP_MERGE ? LOOP : SELECT;
    b->blocks[b->block].merge_at = o.at;
}

/* Whether a switch names a number twice. */
static bool case_twice(Body *b, Ops o) {
    uint32_t count = (o.n - 2) / 2, *cases = make_scratch(b->m->r, count, 4), *spare = make_scratch(b->m->r, count, 4);
    for (uint32_t k = 0; k < count; k++) cases[k] = O(2 + 2 * k);
    sort_numbers(cases, spare, count);
    for (uint32_t k = 1; k < count; k++)
        if (cases[k] == cases[k - 1]) return true;
    return false;
}

static void end_block(Body *b, Ops o, uint32_t op) {
    static const int8_t least[] = {1, 3, 2, 0, 0, 1, 0}, most[] = {1, 5, NO_LIMIT, 0, 0, 1, 0};
    Module *m = b->m;
    Block *block = b->blocks + b->block;
    operands(m, o, least[op - 249], most[op - 249]);
    if (op == 250) {
        if (o.n == 4 || value_type(b, O(0), o.at)->kind != BOOL) WRONG(m, o.at, "a branch on what is no truth value");
    } else if (op == 251) {
        const Type *type = value_type(b, O(0), o.at);
        if (o.n % 2 || !letter_in(type, "iu") || type->components != 1 || case_twice(b, o))
            WRONG(m, o.at, "a switch on what is no integer, or with a case twice");
    } else if (op == 252) {
        only_fragments(b, op, o.at);
    } else if (op == 253 || op == 254) {
        uint32_t given = o.n ? value(b, O(0), o.at) : 0;
        if (given != b->made->of && (op == 254 || m->types[b->made->of].kind != VOID))
            WRONG(m, o.at, "a return of another type than the function's");
    }
    if (block->kind && op != (block->kind == LOOP ? 249 : 251) && op != 250)
        WRONG(m, o.at, "a merge instruction before what it does not go with");
    if (op == 251 && block->kind) block->kind = SWITCH;
    block->end = op, block->end_at = o.at;
    b->block = -1;
}

/* False if the opcode is not allowed in a block. */
static bool instruction(Body *b, uint32_t op, Ops o) {
    if (is_line(op)) return true;
    if (is_end(op)) end_block(b, o, op);
    else switch (op) {
    case 12: extended_instruction(b, o); break;
    case 57: call(b, o); break;
    case 61: load(b, o); break;
    case 62: store(b, o); break;
    case VARIABLE: variable(b, o); break;
    case PHI: phi(b, o); break;
    case LOOP_MERGE: case SELECTION_MERGE: merge(b, o, op); break;
    default: return number_instruction(b, op, &o) || value_instruction(b, op, &o) || shared_instruction(b, op, &o);
    }
    return true;
}

static bool is_known(Body *b, uint32_t op) {
    return is_line(op) || is_end(op) || op == 12 || op == 57 || op == 61 || op == 62 || op == VARIABLE || op == PHI || op == LOOP_MERGE ||
           op == SELECTION_MERGE || number_instruction(b, op, NULL) || value_instruction(b, op, NULL) || shared_instruction(b, op, NULL);
}

/* ---- Functions ---- */

static void begin_function(Body *b, Ops o) {
    Module *m = b->m;
    operands(m, o, 4, 4);
    const Type *made = type_of(m, O(3), o.at);
    if (made->kind != FUNCTION || made->of != O(0) || O(2) > 15) WRONG(m, o.at, "a function that is not of its type");
    uint32_t id = define(m, O(1), o.at);
    b->functions[b->function_count] = (Routine){.id = id, .type = O(3)};
    b->function_of[id] = ++b->function_count;
    b->inside = true, b->made = made;
    b->next_param = 0, b->params_left = made->member_count;
    b->block_count = b->edge_count = b->local_count = b->use_count = b->phi_count = 0;
    b->work = 0;
}

static void parameter(Body *b, Ops o) {
    Module *m = b->m;
    operands(m, o, 2, 2);
    if (!b->params_left || member_of(m, b->made, b->next_param) != O(0)) WRONG(m, o.at, "a parameter that the function's type has not");
    b->params_left--, b->next_param++;
    keep_local(b, define(m, O(1), o.at), O(0), 0);
}

static void label(Body *b, Ops o) {
    operands(b->m, o, 1, 1);
    if (b->params_left) WRONG(b->m, o.at, "a function that lacks parameters of its type");
    uint32_t id = define(b->m, O(0), o.at);
    b->block = (int)b->block_count;
    b->label_of[id] = b->block_count + 1;
    b->blocks[b->block_count++] = (Block){.at = o.at, .label = id, .merge = -1, .goes_on = -1};
    b->begun = false;
}

static uint32_t block_of(const Body *b, uint32_t x, uint32_t at) {
    const Module *m = b->m;
    if (x >= m->bound || !b->label_of[x])
        WRONG(m, at, "a branch to id %u, which is no block of this function", check_id(m, x, at));
    return b->label_of[x] - 1;
}

/* What branches and merge instructions name, by numbers of blocks. */
static void resolve(Body *b) {
    const Module *m = b->m;
    for (uint32_t n = 0; n < b->block_count; n++) {
        Block *block = b->blocks + n;
        if (block->merge_at) {
            Ops o = {block->merge_at, 0};
            bool loop = (word(m, o.at) & 0xffff) == LOOP_MERGE;
            if (O(0)) block->merge = (int)block_of(b, O(0), o.at);
            if (loop && O(1)) block->goes_on = (int)block_of(b, O(1), o.at);
        }
        Ops o = {block->end_at, (word(m, block->end_at) >> 16) - 1};
        block->to = b->edge_count;
        if (block->end == 249) b->edges[b->edge_count++] = block_of(b, O(0), o.at);
        if (block->end == 250 || block->end == 251) b->edges[b->edge_count++] = block_of(b, O(1), o.at);
        if (block->end == 250) b->edges[b->edge_count++] = block_of(b, O(2), o.at);
        for (uint32_t k = 3; block->end == 251 && k < o.n; k += 2) b->edges[b->edge_count++] = block_of(b, O(k), o.at);
        block->to_count = b->edge_count - block->to;
    }
}

/* Every phi has each block that leads to its own, once, and a value of its type from there. */
static void check_phis(Body *b) {
    Reader *r = b->m->r;
    uint32_t n = b->block_count;
    uint32_t *first = make_scratch(r, n + 2, 4), *from = make_scratch(r, b->edge_count, 4), *seen = make_scratch(r, n, 4);
    for (int pass = 0; pass < 2; pass++) { /* count, then fill */
        for (uint32_t k = 0; k < n; k++) seen[k] = 0;
        for (uint32_t k = 0; k < n; k++)
            for (uint32_t e = 0; e < b->blocks[k].to_count; e++) {
                uint32_t x = b->edges[b->blocks[k].to + e];
                if (seen[x] == k + 1) continue;
                seen[x] = k + 1;
                if (pass) from[first[x + 1]++] = k;
                else first[x + 2]++;
            }
        for (uint32_t k = 2; !pass && k < n + 2; k++) first[k] += first[k - 1];
    }
    for (uint32_t k = 0; k < n; k++) seen[k] = 0;
    for (uint32_t p = 0; p < b->phi_count; p++) {
        uint32_t at = b->phis[p].at, block = b->phis[p].block, before = first[block + 1] - first[block];
        Ops o = {at, (word(b->m, at) >> 16) - 1};
        uint32_t count = (o.n - 2) / 2;
        for (uint32_t k = 0; k < count; k++) block_of(b, O(3 + 2 * k), at);
        bool good = count == before;
        for (uint32_t e = first[block]; e < first[block + 1]; e++) seen[from[e]] = 2 * p + 1;
        for (uint32_t k = 0; good && k < count; k++) {
            uint32_t parent = block_of(b, O(3 + 2 * k), at);
            good = seen[parent] == 2 * p + 1;
            seen[parent] = 2 * p + 2;
        }
        if (!good) WRONG(b->m, at, "a phi whose parents are not the blocks that lead to it");
        for (uint32_t k = 0; k < count; k++) {
            b->block = (int)block_of(b, O(3 + 2 * k), at);
            if (value(b, O(2 + 2 * k), at) != O(0)) WRONG(b->m, at, "a phi of id %u, which is of another type", O(2 + 2 * k));
        }
    }
    b->block = -1;
}

/* The function is whole: what its branches name is there, and what it uses comes before. */
static void finish_function(Body *b, Ops o) {
    Module *m = b->m;
    operands(m, o, 0, 0);
    if (!b->block_count) WRONG(m, o.at, "a function without a block");
    resolve(b);
    Dominators d = check_structure(m, b->blocks, b->block_count, b->edges, b->edge_count);
    if (b->phi_count) check_phis(b);
    for (uint32_t k = 0; k < b->use_count; k++) {
        Use use = b->uses[k];
        if (d.number[use.block] >= 0 && !(d.number[use.made] >= 0 && dominates(&d, (int)use.made, (int)use.block)))
            WRONG(m, b->blocks[use.block].at, "the block here uses what a block makes that need not run before it");
    }
    for (uint32_t k = 0; k < b->local_count; k++) m->values[b->locals[k]] = b->local_of[b->locals[k]] = 0;
    for (uint32_t k = 0; k < b->block_count; k++) b->label_of[b->blocks[k].label] = 0;
    b->functions[b->function_count - 1].work = b->work;
    b->inside = false, b->block = -1;
}

static void between_blocks(Body *b, uint32_t op, Ops o) {
    const Module *m = b->m;
    if (!b->inside) {
        if (op != 54) WRONG(m, o.at, "opcode %u is not allowed between functions", op);
        begin_function(b, o);
    } else if (op == LABEL) {
        label(b, o);
    } else if (op == 55 && !b->block_count) {
        parameter(b, o);
    } else if (op == 56) {
        finish_function(b, o);
    } else if (!is_line(op)) {
        bool elsewhere = is_end(op) || number_instruction(b, op, NULL) || value_instruction(b, op, NULL);
        WRONG(m, o.at, "opcode %u is not allowed %s", op, elsewhere ? "outside a block" : "in a function");
    }
}

/* ---- Calls ---- */

/* Nothing calls itself; put into each other the functions are not too much. */
static void check_work(Body *b) {
    const Module *m = b->m;
    uint32_t *stack = make_scratch(m->r, b->function_count + b->link_count + 1, 4), depth = 0;
    for (uint32_t first = 0; first < b->function_count; first++) {
        stack[depth++] = first;
        while (depth) {
            Routine *f = b->functions + stack[depth - 1];
            if (f->known) {
                depth--;
                continue;
            }
            f->open = true;
            uint32_t pushed = depth;
            uint64_t total = f->work;
            uint32_t deep = 0;
            for (uint32_t k = f->links; k; k = b->links[k].next) {
                Routine *other = b->functions + b->function_of[b->links[k].callee] - 1;
                if (!other->known && other->open) FAIL(m, "has a function that calls itself");
                if (!other->known) stack[depth++] = b->function_of[b->links[k].callee] - 1;
                total += b->links[k].times * other->total;
                if (other->deep > deep) deep = other->deep;
            }
            if (depth > pushed) continue;
            deep++;
            if (total > MAX_WORK || deep > MAX_CALLS)
                FAIL(m, "has functions that, put into each other, are %llu instructions and numbers, %u deep; %d and %d are allowed",
                     (ull)total, deep, MAX_WORK, MAX_CALLS);
            f->total = total, f->deep = deep, f->known = true, f->open = false;
            depth--;
        }
    }
}

static void check_calls(Body *b) {
    const Module *m = b->m;
    for (uint32_t k = 0; k < b->called_count; k++) {
        const Called *c = b->called + k;
        if (!b->function_of[c->function]) WRONG(m, c->at, "calls a function that is not there");
        const Type *made = m->types + b->functions[b->function_of[c->function] - 1].type;
        bool good = c->function != m->entry && made->of == c->type && c->count == made->member_count;
        for (uint32_t n = 0; good && n < c->count; n++) good = b->arguments[c->first + n] == member_of(m, made, n);
        if (!good) WRONG(m, c->at, "a call of id %u that does not go with its type, or of the entry point", c->function);
    }
    if (!b->function_of[m->entry]) FAIL(m, "lacks the entry point's function");
    const Type *entry = m->types + b->functions[b->function_of[m->entry] - 1].type;
    if (m->types[entry->of].kind != VOID || entry->member_count) FAIL(m, "has an entry point that takes or returns something");
    check_work(b);
}

/* ---- The whole ---- */

/* Room for what there can be: no more of anything than there are words or ids. */
static void make_room(Body *b, uint32_t at) {
    const Module *m = b->m;
    Reader *r = m->r;
    uint32_t counts[256] = {0};
    uint64_t phi_words = 0;
    for (uint32_t step; at < m->count; at += step) {
        uint32_t op = word(m, at) & 0xffff;
        step = word(m, at) >> 16;
        if (!step) break; /* the reader says so when it comes there */
        if (op < COUNT(counts)) counts[op]++;
        if (op == PHI) phi_words += step;
    }
    b->functions = make_scratch(r, counts[54] + 1, sizeof *b->functions);
    b->blocks = make_scratch(r, counts[LABEL] + 1, sizeof *b->blocks);
    b->phis = make_scratch(r, counts[PHI] + 1, sizeof *b->phis);
    b->called = make_scratch(r, counts[57] + 1, sizeof *b->called);
    b->links = make_scratch(r, counts[57] + 2, sizeof *b->links);
    b->arguments = make_scratch(r, m->count, 4);
    b->edges = make_scratch(r, m->count, 4);
    b->uses = make_scratch(r, m->count + phi_words, sizeof *b->uses);
    b->function_of = make_scratch(r, m->bound, 4);
    b->link_of = make_scratch(r, m->bound, 4);
    b->link_by = make_scratch(r, m->bound, 4);
    b->label_of = make_scratch(r, m->bound, 4);
    b->local_of = make_scratch(r, m->bound, 4);
    b->locals = make_scratch(r, m->bound, 4);
}

void read_functions(Module *m, uint32_t at) {
    Body body = {.m = m, .block = -1}, *b = &body;
    make_room(b, at);
    for (uint32_t step; at < m->count; at += step) {
        uint32_t op = word(m, at) & 0xffff;
        step = word(m, at) >> 16;
        if (!step || step > m->count - at) WRONG(m, at, "an instruction of %u words; %u are left", step, m->count - at);
        Ops o = {at, step - 1};
        if (b->block < 0) {
            between_blocks(b, op, o);
            continue;
        }
        if (!is_known(b, op)) WRONG(m, at, "opcode %u is not allowed in a function", op);
        if (b->blocks[b->block].kind && !is_end(op)) WRONG(m, at, "a merge instruction that is not the last but one of its block");
        b->work++;
        instruction(b, op, o);
        if (op != VARIABLE && op != PHI && !is_line(op)) b->begun = true;
    }
    if (b->inside) FAIL(m, "ends within a function");
    check_calls(b);
}
