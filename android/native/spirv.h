/* The words of a SPIR-V module, and what its declarations have made so far: dressi_edge/cache/spirv_module.py in C. What Python holds in
   dictionaries by id are arrays here: no module has more ids than words. */

#ifndef DRESSI_SPIRV_H
#define DRESSI_SPIRV_H

#include "inside.h"

typedef enum TypeKind { NO_TYPE, VOID, BOOL, INT, UINT, FLOAT, VECTOR, MATRIX, LIST, STRUCT, PICTURE, SAMPLED, POINTER, FUNCTION } TypeKind;
enum { UNIFORM_CONSTANT = 0, IN = 1, OUT = 3, WORKGROUP = 4, PRIVATE = 6, LOCAL = 7, TEXEL = 11 };
enum { VERTEX_STAGE = 1, FRAGMENT_STAGE = 16, COMPUTE_STAGE = 32, NO_LIMIT = -1 };

typedef struct Type {
    uint8_t kind, depth, storage;
    char letter;                      /* b i u f of a scalar or vector, else 0 */
    bool is_integer, is_attachment;   /* of images: what a read gives; a subpass input */
    uint8_t format;                   /* the VkFormat of a storage image, else 0 */
    uint64_t components;              /* scalars in all */
    uint32_t count, of;               /* immediate parts; the type of parts, of what is pointed to, of the image, or returned */
    uint32_t members, member_count;   /* of a structure its parts, of a function its parameters: words from `members` on */
} Type;

typedef struct Member { uint32_t structure, member, built_in, at; } Member; /* a built-in member, sorted */
typedef struct Marked { uint32_t has, built_in, location, binding, set, attachment; } Marked; /* has: bits of `mark_bit` */
typedef struct Mention { uint32_t id, at; } Mention;

typedef struct Module {
    Reader *r;
    const uint8_t *data;
    uint32_t count, bound, stage, entry, instructions; /* words; ids; of GLSL.std.450 */
    Type *types;
    uint32_t *values;           /* id -> the id of its type, or 0 */
    uint32_t *integers;         /* id of a constant integer -> its bits */
    uint32_t *composites;       /* id of a constant -> the word of its first part, or 0 */
    uint32_t local_size[3];
    bool *is_integer, *fixed, *defined, *touched, *listed, *closed; /* fixed: constants; closed: structures of built-ins */
    uint8_t *storage_of;        /* of variables outside functions: storage class + 1 */
    uint32_t variable_count, (*variables)[3]; /* id, storage class, type */
    uint64_t capabilities;      /* bits */
    uint64_t weight;
    Member *members;
    uint32_t member_count;
    bool *again;                /* by word: a type that there is already */
    Marked *marks;
    uint32_t *marked, marked_count, modes, models; /* marked: ids with decorations, in order */
    Mention *named, *moded;
    uint32_t named_count, moded_count;
    bool *is_named, *is_moded;
    bool writes_size;           /* of points */
} Module;

/* The operands of the instruction at a word: n of them, after the first word. */
typedef struct Ops { uint32_t at, n; } Ops;

static inline uint32_t word(const Module *m, uint32_t at) { return little32(m->data + 4 * (uint64_t)at); }
static inline uint32_t op_at(const Module *m, Ops o, uint32_t k) { return word(m, o.at + 1 + k); }

#define FAIL(m, ...) refuse((m)->r, ": " __VA_ARGS__)
#define WRONG(m, at, format, ...) refuse((m)->r, ": word %u: " format, at, ##__VA_ARGS__)

/* spirv_types.c */
const char *kind_word(const Type *type);
uint32_t check_id(const Module *m, uint32_t x, uint32_t at);
uint32_t define(Module *m, uint32_t x, uint32_t at);
const Type *type_of(const Module *m, uint32_t x, uint32_t at);
const Type *holds(const Module *m, uint32_t x, uint32_t at);
void operands(const Module *m, Ops o, int64_t least, int64_t most);
void weigh(Module *m, const Type *type, uint32_t at);
uint32_t part_of(const Module *m, const Type *type, uint32_t k); /* the id of the type of an immediate part */
static inline uint32_t member_of(const Module *m, const Type *type, uint32_t k) { return word(m, type->members + k); }
static inline bool is_plain(const Type *type) { return type->letter && type->letter != 'b'; }
static inline bool letter_in(const Type *type, const char *letters) {
    for (const char *p = letters; *p; p++)
        if (*p == type->letter) return true;
    return false;
}
const Member *find_member(const Module *m, uint32_t structure, uint32_t member);
bool declare_type(Module *m, uint32_t op, Ops o); /* false if the opcode makes none */
void declare_constant(Module *m, uint32_t op, Ops o);
bool is_type_op(uint32_t op);
bool is_constant_op(uint32_t op);

/* spirv_flow.c: the blocks of a function, in their order */
typedef struct Block {
    uint32_t at, label, merge_at, end_at, end; /* words of its label, its merge instruction or 0, and its end; the opcode that ends it */
    int merge, goes_on;                        /* blocks that the merge instruction names, or -1 */
    uint32_t to, to_count;                     /* in `edges`: those it may branch to */
    char kind;                                 /* of the construct it heads: s selection, w switch, l loop; or 0 */
} Block;

typedef struct Dominators { int *parent, *depth, *jump, *number; uint32_t *order, order_count; int strange; } Dominators;

bool dominates(const Dominators *d, int a, int b);
Dominators check_structure(Module *m, const Block *blocks, uint32_t count, const uint32_t *edges, uint32_t edge_count);

/* spirv_body.c */
typedef struct Use { uint32_t block, made; } Use;
typedef struct Called { uint32_t at, function, type, first, count; } Called; /* arguments' types from `first` on */
typedef struct Link { uint32_t callee, times, next; } Link;
typedef struct Routine { uint32_t id, type, links; uint64_t work, total; uint32_t deep; bool known, open; } Routine;

typedef struct Body {
    Module *m;
    Routine *functions;
    uint32_t function_count, *function_of; /* id -> number + 1 */
    uint32_t called_count, link_count, argument_count, *arguments, *link_of, *link_by; /* by callee: its link, and of which function + 1 */
    Called *called;
    Link *links;
    /* the function that is read */
    bool inside, begun;
    const Type *made;
    uint32_t params_left, next_param, block_count, edge_count, local_count, use_count, phi_count;
    int block; /* that is open, or -1 */
    Block *blocks;
    uint32_t *edges, *label_of, *local_of, *locals; /* by id: number of the block of a label, and that makes a value, + 1 */
    Use *uses;
    struct { uint32_t at, block; } *phis;
    uint64_t work;
} Body;

void read_functions(Module *m, uint32_t at);
uint32_t value(Body *b, uint32_t x, uint32_t at);              /* the id of the type of a value that there is */
const Type *value_type(Body *b, uint32_t x, uint32_t at);
const Type *pointer(Body *b, uint32_t x, uint32_t at);
const Type *shared_pointer(Body *b, uint32_t x, uint32_t at);  /* to a texel, too */
const Type *image_operand(Body *b, uint32_t x, TypeKind kind, uint32_t at, bool attachment, bool storage);
void place_in(Body *b, uint32_t x, const char *letters, uint32_t least, uint32_t at, uint32_t most);
const Type *result(Body *b, uint32_t kind, uint32_t x, uint32_t at);
void only_fragments(Body *b, uint32_t op, uint32_t at);

/* spirv_numbers.c, spirv_values.c and spirv_shared.c: false if they do not know the opcode; `o` NULL asks no more than that */
bool number_instruction(Body *b, uint32_t op, const Ops *o);
bool value_instruction(Body *b, uint32_t op, const Ops *o);
bool shared_instruction(Body *b, uint32_t op, const Ops *o);
void extended_instruction(Body *b, Ops o);

#endif
