/* Whether the blocks of a function make structured control flow: dressi_edge/cache/spirv_flow.py in C, in its order and words. */

#include "spirv.h"

enum { MAX_NESTING = 64, SELECT = 's', SWITCH = 'w', LOOP = 'l', CONTINUE = 'c' };

/* What a header heads, or a continue target within its loop. around: the construct it lies in, or -1. */
typedef struct Construct { int header, around, depth; char kind; } Construct;

/* Edges of every block, one after another: those of block b from first[b] on. */
typedef struct Graph { uint32_t count; const uint32_t *first, *to; } Graph;

typedef struct Flow {
    Module *m;
    const Block *blocks;
    int count;
    Graph edges;
    Dominators values, whole;
    Construct *constructs;
    int construct_count, *before, *inside; /* by block: what it lies in, and what it opens or lies in; or -1 */
    bool *merges;                          /* by block + 1 */
    int *going_on;                         /* by block: the header of the loop that goes on there, or -1 */
} Flow;

static _Noreturn void unstructured(const Flow *f, int block, const char *what) {
    WRONG(f->m, f->blocks[block].at, "the control flow of the block here is not structured: %s", what);
}

/* ---- Dominators ---- */

static void *numbers(Reader *r, uint32_t count, int fill) {
    int *found = make_scratch(r, count, sizeof *found);
    for (uint32_t k = 0; fill && k < count; k++) found[k] = fill;
    return found;
}

/* The blocks that the first one leads to, each after those it leads to. */
static uint32_t postorder(Reader *r, Graph g, uint32_t *found) {
    uint32_t count = 0, depth = 0, *stack = numbers(r, g.count, 0), *next = numbers(r, g.count, 0);
    bool *seen = make_scratch(r, g.count, 1);
    stack[depth++] = 0, seen[0] = true, next[0] = g.first[0];
    while (depth) {
        uint32_t at = stack[depth - 1], x = UINT32_MAX;
        while (next[at] < g.first[at + 1] && x == UINT32_MAX) {
            uint32_t to = g.to[next[at]++];
            if (!seen[to]) x = to;
        }
        if (x == UINT32_MAX) {
            found[count++] = at;
            depth--;
        } else {
            seen[x] = true, next[x] = g.first[x];
            stack[depth++] = x;
        }
    }
    return count;
}

static int common(const Dominators *d, int a, int b) {
    if (d->depth[a] < d->depth[b]) {
        int other = a;
        a = b, b = other;
    }
    while (d->depth[a] > d->depth[b]) a = d->depth[d->jump[a]] >= d->depth[b] ? d->jump[a] : d->parent[a];
    while (a != b) {
        bool far = d->jump[a] != d->jump[b];
        a = far ? d->jump[a] : d->parent[a], b = far ? d->jump[b] : d->parent[b];
    }
    return a;
}

bool dominates(const Dominators *d, int a, int b) {
    while (d->depth[b] > d->depth[a]) b = d->depth[d->jump[b]] >= d->depth[a] ? d->jump[b] : d->parent[b];
    return a == b;
}

static Dominators find_dominators(Reader *r, Graph g) {
    Dominators d = {numbers(r, g.count, -1), numbers(r, g.count, 0), numbers(r, g.count, 0), numbers(r, g.count, -1), numbers(r,
        g.count, 0), 0, -1};
    d.order_count = postorder(r, g, d.order);
    for (uint32_t k = 0; k < d.order_count / 2; k++) {
        uint32_t other = d.order[k];
        d.order[k] = d.order[d.order_count - 1 - k], d.order[d.order_count - 1 - k] = other;
    }
    for (uint32_t k = 0; k < d.order_count; k++) d.number[d.order[k]] = (int)k;
    for (uint32_t k = 0; k < g.count; k++) d.jump[k] = (int)k;
    for (uint32_t k = 0; k < d.order_count; k++) { /* who comes before a block is done before it: its parent grows meanwhile */
        uint32_t b = d.order[k];
        if (k) {
            int p = d.parent[b], far = d.jump[p];
            d.depth[b] = d.depth[p] + 1;
            d.jump[b] = d.depth[p] - d.depth[far] == d.depth[far] - d.depth[d.jump[far]] ? d.jump[far] : p;
        }
        for (uint32_t e = g.first[b]; e < g.first[b + 1]; e++) {
            uint32_t x = g.to[e];
            if (d.number[x] > d.number[b]) d.parent[x] = d.parent[x] < 0 ? (int)b : common(&d, d.parent[x], (int)b);
        }
    }
    for (uint32_t k = 0; k < d.order_count && d.strange < 0; k++) {
        uint32_t b = d.order[k];
        for (uint32_t e = g.first[b]; e < g.first[b + 1]; e++)
            if (d.number[g.to[e]] <= d.number[b] && !dominates(&d, (int)g.to[e], (int)b)) d.strange = (int)b;
    }
    return d;
}

/* ---- Constructs ---- */

static int open_construct(Flow *f, char kind, int header, int around) {
    int depth = around >= 0 ? f->constructs[around].depth + 1 : 1;
    if (depth > MAX_NESTING) unstructured(f, header, "constructs are nested deeper than 64");
    f->constructs[f->construct_count] = (Construct){header, around, depth, kind};
    return f->construct_count++;
}

static void find_constructs(Flow *f) {
    const int *parent = f->whole.parent;
    for (uint32_t k = 0; k < f->whole.order_count; k++) {
        int b = (int)f->whole.order[k], around = parent[b] < 0 ? -1 : f->inside[parent[b]];
        const Block *block = f->blocks + b;
        if (parent[b] >= 0 && f->blocks[parent[b]].merge == b) around = f->constructs[around].around;
        f->before[b] = around;
        if (f->going_on[b] >= 0) around = open_construct(f, CONTINUE, f->going_on[b], around);
        if (block->kind) {
            if (b == block->merge || block->merge == block->goes_on || f->merges[block->merge + 1] ||
                (block->merge >= 0 && f->going_on[block->merge] >= 0))
                unstructured(f, b, "its merge block is itself, its continue target, or another's");
            for (int n = 0; n < 2; n++) {
                int x = n ? block->goes_on : block->merge;
                if (x >= 0 && x != b && parent[x] != b)
                    unstructured(f, b, "it does not dominate the block that its merge instruction names, or not first");
            }
            f->merges[block->merge + 1] = true;
            around = open_construct(f, block->kind, b, around);
            if (block->goes_on >= 0 && block->goes_on != b) {
                if (f->going_on[block->goes_on] >= 0 || f->merges[block->goes_on + 1])
                    unstructured(f, b, "its continue target is another's, or a merge block");
                f->going_on[block->goes_on] = b;
            }
        }
        f->inside[b] = around;
    }
}

/* ---- Edges ---- */

static bool leads_to(const Flow *f, int b, int x) {
    for (uint32_t e = f->edges.first[b]; e < f->edges.first[b + 1]; e++)
        if ((int)f->edges.to[e] == x) return true;
    return false;
}

/* A branch back: to a loop header, from where its loop goes on, and from no construct within that. */
static void check_back(const Flow *f, int b, int header) {
    const Block *target = f->blocks + header;
    const Construct *mine = f->inside[b] >= 0 ? f->constructs + f->inside[b] : NULL;
    bool alone = target->goes_on == header && header == b;
    if (target->kind != LOOP || !(alone || (mine && mine->kind == CONTINUE && mine->header == header)))
        unstructured(f, b, "it branches back to what is not the header of the loop that goes on here");
}

/* Whether the branch goes to where a construct around it ends, or a loop goes on; fails where it may not go there. */
static bool leaves(const Flow *f, int b, int x) {
    int low = f->before[x], c = f->inside[b], left = 0, last = -1, floor = low >= 0 ? f->constructs[low].depth : 0;
    bool switches = false, loops = false, continues = false; /* kinds of all that are left but the last */
    while (c >= 0 && f->constructs[c].depth > floor) {
        if (last >= 0) {
            char kind = f->constructs[last].kind;
            switches |= kind == SWITCH, loops |= kind == LOOP, continues |= kind == CONTINUE;
        }
        last = c;
        left++;
        c = f->constructs[c].around;
    }
    if (c != low) unstructured(f, b, "it branches into a construct, past its header");
    bool goes_on = low >= 0 && f->constructs[low].kind == LOOP && x == f->blocks[f->constructs[low].header].goes_on;
    if (!left) return goes_on;
    const Construct *outer = f->constructs + last;
    if (x == f->blocks[outer->header].merge && outer->kind != CONTINUE) {
        if (outer->kind == LOOP && left == 2 && continues) {
            if (!leads_to(f, b, outer->header)) unstructured(f, b, "it leaves a loop from where it goes on, and does not go on");
        } else if (loops || continues || switches || (left > 1 && outer->kind == SELECT)) {
            unstructured(f, b, "it leaves several constructs at once");
        }
        return true;
    }
    if (goes_on && !loops && !continues && !switches && outer->kind == SELECT) return true;
    unstructured(f, b, "it leaves a construct to where that does not end");
}

static bool goes_on_around(const Flow *f, int b) {
    int c = f->inside[b];
    while (c >= 0 && f->constructs[c].kind != CONTINUE) c = f->constructs[c].around;
    return c >= 0;
}

/* A case is entered by its switch alone, and is not where a loop around it ends or goes on. */
static void check_cases(const Flow *f) {
    const Dominators *d = &f->whole;
    int *case_of = numbers(f->m->r, (uint32_t)f->count, -1);
    uint32_t *cases = numbers(f->m->r, (uint32_t)f->count, 0), count = 0;
    for (uint32_t k = 0; k < d->order_count; k++) {
        int b = (int)d->order[k];
        for (uint32_t e = f->edges.first[b]; f->blocks[b].kind == SWITCH && e < f->edges.first[b + 1]; e++) {
            int x = (int)f->edges.to[e];
            if (x == f->blocks[b].merge) continue;
            if (case_of[x] < 0) cases[count++] = (uint32_t)x;
            case_of[x] = b;
        }
    }
    for (uint32_t k = 0; k < count; k++)
        if (d->parent[cases[k]] != case_of[cases[k]]) unstructured(f, case_of[cases[k]], "it has a case that others lead to");
    for (uint32_t k = 0; k < d->order_count; k++) {
        int b = (int)d->order[k];
        for (uint32_t e = f->edges.first[b]; e < f->edges.first[b + 1]; e++) {
            int x = (int)f->edges.to[e];
            if (case_of[x] >= 0 && case_of[x] != b && d->number[x] > d->number[b]) unstructured(f, b, "it branches to a case of a switch");
        }
    }
}

static void check_edges(Flow *f) {
    const Dominators *d = &f->whole;
    uint32_t *back = numbers(f->m->r, (uint32_t)f->count, 0);
    int *seen = numbers(f->m->r, (uint32_t)f->count, -1);
    for (uint32_t k = 0; k < d->order_count; k++) {
        int b = (int)d->order[k];
        const Block *block = f->blocks + b;
        uint32_t plain = 0;
        for (uint32_t e = f->edges.first[b]; e < f->edges.first[b + 1]; e++) {
            int x = (int)f->edges.to[e];
            if (seen[x] == b) continue;
            seen[x] = b;
            if (d->number[x] <= d->number[b]) check_back(f, b, x), back[x]++;
            else plain += !leaves(f, b, x);
        }
        if ((block->end == 251 && block->kind != SWITCH) || (block->end == 250 && !block->kind && plain > 1))
            unstructured(f, b, "it branches to several blocks without a merge instruction");
        if (block->end >= 252 && goes_on_around(f, b)) unstructured(f, b, "it leaves the function from where a loop goes on");
    }
    for (uint32_t k = 0; k < d->order_count; k++) {
        int b = (int)d->order[k];
        if (f->blocks[b].kind == LOOP && back[b] != 1)
            WRONG(f->m, f->blocks[b].at, "the control flow of the block here is not structured: %u blocks branch back to this loop header; "
                  "one is needed", back[b]);
    }
    check_cases(f);
}

/* ---- The whole ---- */

/* The edges, or with them those to what merge instructions name. */
static Graph graph_of(Module *m, const Block *blocks, uint32_t count, const uint32_t *edges, uint32_t edge_count, bool whole) {
    uint32_t *first = make_scratch(m->r, count + 1, 4), *to = make_scratch(m->r, edge_count + (whole ? 2 * (uint64_t)count : 0), 4), n = 0;
    for (uint32_t b = 0; b < count; b++) {
        first[b] = n;
        for (uint32_t e = 0; e < blocks[b].to_count; e++) to[n++] = edges[blocks[b].to + e];
        if (whole && blocks[b].merge >= 0) to[n++] = (uint32_t)blocks[b].merge;
        if (whole && blocks[b].goes_on >= 0) to[n++] = (uint32_t)blocks[b].goes_on;
    }
    first[count] = n;
    return (Graph){count, first, to};
}

Dominators check_structure(Module *m, const Block *blocks, uint32_t count, const uint32_t *edges, uint32_t edge_count) {
    Flow f = {.m = m, .blocks = blocks, .count = (int)count, .edges = graph_of(m, blocks, count, edges, edge_count, false)};
    bool headed = false;
    for (uint32_t b = 0; b < count; b++) headed |= blocks[b].kind != 0;
    f.values = f.whole = find_dominators(m->r, f.edges);
    if (headed) f.whole = find_dominators(m->r, graph_of(m, blocks, count, edges, edge_count, true));
    int strange = f.values.strange >= 0 ? f.values.strange : f.whole.strange;
    if (strange >= 0) unstructured(&f, strange, "it branches back to a block that does not dominate it");
    for (int b = 0; b < f.count; b++) {
        if (leads_to(&f, b, 0)) unstructured(&f, b, "it branches to the first block of the function");
        if (f.whole.number[b] < 0) unstructured(&f, b, "nothing leads to it");
        if (f.whole.parent[b] >= b) unstructured(&f, b, "it comes before the block that dominates it");
    }
    f.constructs = make_scratch(m->r, 2 * (uint64_t)count, sizeof *f.constructs);
    f.before = numbers(m->r, count, -1), f.inside = numbers(m->r, count, -1), f.going_on = numbers(m->r, count, -1);
    f.merges = make_scratch(m->r, count + 1, 1);
    find_constructs(&f);
    check_edges(&f);
    return f.values;
}
