/* What a shader binds, takes and gives, read from its SPIR-V: dressi_edge/cache/spirv_interface.py in C, in its order and words. Takes
   n log n for n words. Numbers are those of the SPIR-V specification, version 1.6, chapter 3. */

#include "spirv.h"

#include <stdio.h>
#include <string.h>

enum { MAX_WORDS = 1 << 20, TYPES = 9, LOCAL_SIZE = 17, MAX_INVOCATIONS = 1 << 16, WORKGROUP_SIZE = 25 };
enum { RELAXED, BLOCK, BUILT_IN, NO_PERSPECTIVE, FLAT, CENTROID, INVARIANT, NON_READABLE, LOCATION, BINDING, SET, NO_CONTRACTION, ATTACHMENT, NO_MARK };

#define BIT(mark) (1u << (mark))
enum {
    FREE = 1u << RELAXED | 1u << NO_CONTRACTION, /* of results of instructions, too */
    INTERPOLATED = 1u << NO_PERSPECTIVE | 1u << FLAT | 1u << CENTROID,
    OF_IMAGES = 1u << BINDING | 1u << SET | 1u << ATTACHMENT,
    OF_VARYINGS = 1u << BUILT_IN | 1u << LOCATION | 1u << INVARIANT | INTERPOLATED,
    NUMBERED = 1u << BUILT_IN | 1u << LOCATION | 1u << BINDING | 1u << SET | 1u << ATTACHMENT
};

static uint32_t mark_of(uint32_t decoration) {
    static const uint8_t numbers[] = {0, 2, 11, 13, 14, 16, 18, 25, 30, 33, 34, 42, 43}; /* in the order of the marks */
    for (uint32_t k = 0; k < NO_MARK; k++)
        if (numbers[k] == decoration) return k;
    return NO_MARK;
}

#define O(k) op_at(m, o, k)

/* ---- Declarations ---- */

/* A string that ends in the last of the operands from `first` on, and nowhere before; its bytes. */
static const char *text_of(const Module *m, Ops o, uint32_t first, size_t *length) {
    const uint8_t *p = m->data + 4 * ((uint64_t)o.at + 1 + first);
    size_t size = 4 * (size_t)(o.n > first ? o.n - first : 0), n = 0;
    while (n < size && p[n]) n++;
    bool good = n < size && size - n <= 4;
    for (size_t k = n; good && k < size; k++) good = !p[k];
    if (!good) WRONG(m, o.at, "a text that does not end in its last word");
    *length = n;
    return (const char *)p;
}

static void mention(Mention *all, uint32_t *count, bool *seen, uint32_t id, uint32_t at) {
    if (!seen[id]) all[(*count)++] = (Mention){id, at};
    seen[id] = true;
}

static void name(Module *m, uint32_t id, uint32_t at) { mention(m->named, &m->named_count, m->is_named, check_id(m, id, at), at); }

/* Sources, names and lines: of no use here, but of sound form. */
static void told_of(Module *m, uint32_t op, Ops o) {
    static const uint8_t counts[] = {0, 0, 0, 2, 0, 1, 2, 1, 3}; /* words before the text */
    uint32_t numbers = op < COUNT(counts) ? counts[op] : 0;
    bool line = op == 8 || op == 317;
    size_t length;
    operands(m, o, numbers, line ? (int64_t)numbers : NO_LIMIT);
    if (op == 5 || op == 6 || op == 8) {
        name(m, O(0), o.at);
    } else if (op == 7) {
        define(m, O(0), o.at);
    } else if (op == 3 && o.n > 2) {
        name(m, O(2), o.at);
        numbers = 3;
    }
    if (!line && (op != 3 || o.n > 3)) text_of(m, o, numbers, &length);
}

static void entry_point(Module *m, Ops o) {
    operands(m, o, 4, NO_LIMIT);
    if (m->stage) WRONG(m, o.at, "a second entry point");
    if (O(0) != 0 && O(0) != 4 && O(0) != 5)
        WRONG(m, o.at, "execution model %u; vertex (0), fragment (4) and compute (5) are allowed", O(0));
    if (O(2) != 0x6e69616d || O(3)) WRONG(m, o.at, "the entry point must be called main");
    bool twice = false;
    m->entry = check_id(m, O(1), o.at);
    for (uint32_t k = 4; k < o.n; k++) check_id(m, O(k), o.at);
    for (uint32_t k = 4; k < o.n; k++) {
        twice |= m->listed[O(k)];
        m->listed[O(k)] = true;
    }
    m->stage = !O(0) ? VERTEX_STAGE : O(0) == 4 ? FRAGMENT_STAGE : COMPUTE_STAGE;
    if (twice) WRONG(m, o.at, "the entry point names a variable twice");
}

static void execution_mode(Module *m, Ops o) {
    bool local = o.n > 1 && O(1) == LOCAL_SIZE && m->stage == COMPUTE_STAGE;
    operands(m, o, local ? 5 : 2, local ? 5 : 2);
    mention(m->moded, &m->moded_count, m->is_moded, check_id(m, O(0), o.at), o.at);
    for (int k = 0; local && k < 3; k++) m->local_size[k] = O(2 + k);
    if (local) {
        uint64_t product = 1;
        for (int k = 0; k < 3 && product <= MAX_INVOCATIONS; k++) product *= m->local_size[k];
        bool none = !m->local_size[0] || !m->local_size[1] || !m->local_size[2];
        if (none || product > MAX_INVOCATIONS)
            WRONG(m, o.at, "workgroups of %u x %u x %u invocations; 1 to %d are allowed", O(2), O(3), O(4), MAX_INVOCATIONS);
    }
    uint32_t mode = O(1), depths = 1u << 14 | 1u << 15 | 1u << 16, known = 1u << 7 | 1u << 9 | 1u << 12 | depths;
    if (!local && (mode > 16 || !(known >> mode & 1))) WRONG(m, o.at, "execution mode %u is not allowed", mode);
    if (m->modes >> mode & 1 || (depths >> mode & 1 && m->modes & depths))
        WRONG(m, o.at, "execution mode %u is given twice, or with another of the kind", mode);
    m->modes |= 1u << mode;
}

static void variable(Module *m, Ops o) {
    operands(m, o, 3, 4);
    uint32_t storage = O(2);
    const Type *type = type_of(m, O(0), o.at);
    if (type->kind != POINTER || type->storage != storage) WRONG(m, o.at, "a variable whose type is no pointer to its storage class");
    if (storage != UNIFORM_CONSTANT && storage != IN && storage != OUT && storage != PRIVATE && storage != WORKGROUP)
        WRONG(m, o.at, "a variable of storage class %u; images, inputs, outputs, private and shared ones are allowed", storage);
    if (o.n == 4 && ((storage != OUT && storage != PRIVATE) || O(3) >= m->bound || !m->fixed[O(3)] || m->values[O(3)] != type->of))
        WRONG(m, o.at, "a variable that begins with what is no constant of its type, or may not");
    weigh(m, m->types + type->of, o.at);
    uint32_t *found = m->variables[m->variable_count++];
    found[0] = define(m, O(1), o.at), found[1] = storage, found[2] = type->of;
    m->values[O(1)] = O(0);
    m->storage_of[O(1)] = (uint8_t)(storage + 1);
}

static void decoration(Module *m, uint32_t op, Ops o) {
    uint32_t member = op == 72;
    operands(m, o, 2 + member, NO_LIMIT);
    name(m, O(0), o.at);
    uint32_t x = O(0), decorated = O(1 + member), mark = mark_of(decorated), numbered = NUMBERED >> mark & 1;
    if (mark == NO_MARK) WRONG(m, o.at, "decoration %u is not allowed", decorated);
    operands(m, (Ops){o.at, o.n - 2 - member}, numbered, numbered);
    if (member) {
        const Member *found = find_member(m, x, O(1));
        if (mark != BUILT_IN || !found || found->at != o.at)
            WRONG(m, o.at, "decoration %u of a member is not allowed, or there twice", decorated);
        m->closed[x] = true;
        return;
    }
    Marked *mine = m->marks + x;
    if (!mine->has) m->marked[m->marked_count++] = x;
    if (mine->has & BIT(mark)) WRONG(m, o.at, "decoration %u twice", decorated);
    mine->has |= BIT(mark);
    uint32_t *to = mark == BUILT_IN ? &mine->built_in : mark == LOCATION ? &mine->location : mark == BINDING ? &mine->binding
                 : mark == SET ? &mine->set : mark == ATTACHMENT ? &mine->attachment : NULL;
    if (to) *to = O(2);
}

static void declaration(Module *m, uint32_t op, Ops o) {
    size_t length;
    const char *text;
    if (declare_type(m, op, o)) return;
    if (is_constant_op(op)) {
        declare_constant(m, op, o);
        return;
    }
    switch (op) {
    case 59: variable(m, o); break;
    case 71: case 72: decoration(m, op, o); break;
    case 17:
        operands(m, o, 1, 1);
        if (O(0) > 1 && O(0) != 40 && O(0) != 50 && O(0) != 51) WRONG(m, o.at, "capability %u is not allowed", O(0));
        m->capabilities |= UINT64_C(1) << O(0);
        break;
    case 11:
        operands(m, o, 2, NO_LIMIT);
        text = text_of(m, o, 1, &length);
        if (length != 12 || memcmp(text, "GLSL.std.450", 12)) WRONG(m, o.at, "only the instructions of GLSL.std.450 are allowed");
        m->instructions = define(m, O(0), o.at);
        break;
    case 14:
        if (o.n != 2 || O(0) || O(1) != 1) WRONG(m, o.at, "the memory model must be Logical GLSL450");
        m->models++;
        break;
    case 15: entry_point(m, o); break;
    case 16: execution_mode(m, o); break;
    default: told_of(m, op, o);
    }
}

/* The order in which declarations come: the section of an opcode, or -1. Lines belong to any from types on. */
static int section_of(uint32_t op) {
    if (is_type_op(op) || is_constant_op(op) || op == 59 || op == 8 || op == 317) return TYPES;
    switch (op) {
    case 17: return 0;
    case 11: return 1;
    case 14: return 2;
    case 15: return 3;
    case 16: return 4;
    case 2: case 3: case 4: case 7: return 5;
    case 5: case 6: return 6;
    case 330: return 7;
    case 71: case 72: return 8;
    default: return -1;
    }
}

static uint32_t declarations(Module *m) {
    int section = 0;
    for (uint32_t at = 5, count; at < m->count; at += count) {
        uint32_t op = word(m, at) & 0xffff;
        count = word(m, at) >> 16;
        if (!count || count > m->count - at) WRONG(m, at, "an instruction of %u words; %u are left", count, m->count - at);
        if (op == 54) return at;
        int mine = section_of(op);
        if (mine < 0) WRONG(m, at, "opcode %u is not allowed before the functions", op);
        if (mine < section) WRONG(m, at, "opcode %u comes too late", op);
        section = mine;
        declaration(m, op, (Ops){at, count - 1});
    }
    FAIL(m, "has no function");
}

/* ---- What is there twice, found beforehand ---- */

/* Words of two instructions after their results, in order. */
static bool type_before(uint32_t a, uint32_t b, const void *context) {
    const Module *m = context;
    if (word(m, a) != word(m, b)) return word(m, a) < word(m, b);
    for (uint32_t k = 2; k < word(m, a) >> 16; k++)
        if (word(m, a + k) != word(m, b + k)) return word(m, a + k) < word(m, b + k);
    return false;
}

static bool member_before(uint32_t a, uint32_t b, const void *context) {
    const Module *m = context;
    for (uint32_t k = 1; k < 3; k++)
        if (word(m, a + k) != word(m, b + k)) return word(m, a + k) < word(m, b + k);
    return false;
}

/* Marks the types that one before is equal to, and sorts built-in members, of equal ones the first. */
static void find_repeated(Module *m) {
    Reader *r = m->r;
    uint32_t *types = make_scratch(r, m->count, 4), *members = make_scratch(r, m->count / 4 + 1, 4), *spare = make_scratch(r, m->count, 4);
    uint32_t type_count = 0, member_count = 0;
    m->again = make_scratch(r, m->count, 1);
    for (uint32_t at = 5, count; at < m->count; at += count) {
        uint32_t op = word(m, at) & 0xffff;
        count = word(m, at) >> 16;
        if (!count || count > m->count - at || op == 54) break;
        bool unique = (op >= 19 && op <= 25) || op == 27 || op == 33; /* two of them are one type */
        if (unique && count > 1) types[type_count++] = at;
        if (op == 72 && count == 5 && word(m, at + 3) == 11) members[member_count++] = at;
    }
    sort(types, spare, type_count, type_before, m);
    for (uint32_t k = 1; k < type_count; k++) m->again[types[k]] = !type_before(types[k - 1], types[k], m);
    sort(members, spare, member_count, member_before, m);
    m->members = make_scratch(r, member_count, sizeof *m->members);
    for (uint32_t k = 0; k < member_count; k++)
        if (!k || member_before(members[k - 1], members[k], m))
            m->members[m->member_count++] = (Member){word(m, members[k] + 1), word(m, members[k] + 2), word(m, members[k] + 4),
                members[k]};
}

/* ---- What it means ---- */

/* Whether a type is what a built-in is: a letter and how many, or an array of floats. */
static bool is_type(const Module *m, uint32_t x, const char *want) {
    const Type *type = m->types + x;
    if (*want == 'a') return type->kind == LIST && m->types[type->of].kind == FLOAT;
    bool letter = type->letter == want[0] || (want[0] == 'i' && type->letter == 'u');
    return *want && letter && type->components == (uint64_t)(want[1] - '0');
}

static const char *built_in_type(const Module *m, uint32_t storage, uint32_t number) {
    if (m->stage == VERTEX_STAGE && storage == IN) return number == 42 || number == 43 ? "i1" : "";
    if (m->stage == VERTEX_STAGE) return number == 0 ? "f4" : number == 1 ? "f1" : "";
    if (m->stage == COMPUTE_STAGE && storage == IN)
        return number == 24 || (number >= 26 && number <= 28) ? "u3" : number == 29 ? "u1" : "";
    if (m->stage == COMPUTE_STAGE) return "";
    if (storage == IN) return number == 15 ? "f4" : number == 16 ? "f2" : number == 17 ? "b1" : "";
    return number == 22 ? "f1" : "";
}

/* Whether a structure is the block of the built-ins of a vertex shader; which they are. */
static bool is_block(const Module *m, uint32_t storage, const Marked *marks, uint32_t pointee, uint64_t *found) {
    const Type *type = m->types + pointee;
    bool good = m->stage == VERTEX_STAGE && storage == OUT && !marks->has && m->marks[pointee].has & BIT(BLOCK) && type->count <= 4;
    for (uint32_t k = 0; good && k < type->count; k++) {
        const Member *member = find_member(m, pointee, k);
        static const char *const types[] = {"f4", "f1", "", "a", "a"};
        good = member && member->built_in <= 4 && !(*found >> member->built_in & 1) &&
               is_type(m, part_of(m, type, k), types[member->built_in]);
        if (good) *found |= UINT64_C(1) << member->built_in;
    }
    return good && !find_member(m, pointee, type->count) && type->count;
}

/* The built-ins that a variable stands for, as bits; none for those with a location. */
static uint64_t built_ins(const Module *m, uint32_t x, uint32_t storage, uint32_t pointee) {
    const Marked *marks = m->marks + x;
    uint64_t found = 0;
    if (m->closed[pointee]) {
        uint32_t last = m->member_count;
        while (last && m->members[last - 1].structure != pointee) last--;
        bool beyond = m->members[last - 1].member >= m->types[pointee].count; /* a member that it has not */
        if (beyond || !is_block(m, storage, marks, pointee, &found))
            FAIL(m, "id %u: a block that is not that of the built-ins of a vertex shader", x);
        return found;
    }
    if (!(marks->has & BIT(BUILT_IN))) return 0;
    const char *want = built_in_type(m, storage, marks->built_in);
    if (!*want || !is_type(m, pointee, want) || marks->has & BIT(LOCATION))
        FAIL(m, "id %u: built-in %u, which this stage has not, or not of this type", x, marks->built_in);
    if (marks->built_in == 22 && !(m->modes >> 12 & 1)) FAIL(m, "id %u: writes depth without execution mode DepthReplacing", x);
    return UINT64_C(1) << marks->built_in;
}

static void bind(const Module *m, uint32_t x, const Type *type, Interface *found, bool *seen) {
    const Marked *marks = m->marks + x;
    if (!(marks->has & BIT(SET)) || marks->set || !(marks->has & BIT(BINDING))) FAIL(m, "id %u: a descriptor needs set 0 and a binding", x);
    uint32_t number = marks->binding;
    bool twice = number < m->count && seen[number];
    for (uint32_t k = 0; number >= m->count && k < found->used_count; k++) twice |= found->used[k].number == number;
    if (twice) FAIL(m, "binding %u is declared twice", number);
    if (number < m->count) seen[number] = true;
    if (type->is_attachment != (marks->has >> ATTACHMENT & 1) || (type->is_attachment && m->stage != FRAGMENT_STAGE))
        FAIL(m, "binding %u: an input attachment, and nothing else, needs an index, in a fragment shader", number);
    found->used[found->used_count++] = (Used){number, type->kind == SAMPLED ? 1 : type->is_attachment ? 10 : type->format ? 3 : 2,
                                              type->is_attachment ? marks->attachment : type->format, type->is_integer};
}

static void locate(const Module *m, uint32_t x, const Type *type, Location *side, uint32_t storage) {
    const Marked *marks = m->marks + x;
    char at[12] = "None";
    if (marks->has & BIT(LOCATION)) snprintf(at, sizeof at, "%u", marks->location);
    if (!(marks->has & BIT(LOCATION)) || marks->location >= MAX_LOCATIONS)
        FAIL(m, "id %u: an input or output at location %s; 0 to %d are allowed", x, at, MAX_LOCATIONS - 1);
    if (side[marks->location].scalar) FAIL(m, "location %s is declared twice", at);
    if (!is_plain(type)) FAIL(m, "location %s: a scalar or vector of 32 bits is needed", at);
    bool fragment = m->stage == FRAGMENT_STAGE;
    if (fragment && storage == IN && type->letter != 'f' && !(marks->has & BIT(FLAT))) FAIL(m, "location %s: integers need Flat", at);
    if (fragment == (storage == OUT) && marks->has & INTERPOLATED) FAIL(m, "location %s: nothing is interpolated there", at);
    side[marks->location] = (Location){type->letter == 'f' ? 1 : type->letter == 'i' ? 2 : 3, (uint8_t)type->components};
}

static uint64_t components(const Location *side, uint64_t extra) {
    int top = MAX_LOCATIONS;
    while (top && !side[top - 1].scalar) top--;
    return 4 * (uint64_t)top + extra;
}

/* Whether an id is the constant of the size of a workgroup, and says what the execution mode does. */
static bool says_size(const Module *m, uint32_t x) {
    if (m->stage != COMPUTE_STAGE || !m->composites[x] || !is_type(m, m->values[x], "u3")) return false;
    for (uint32_t k = 0; k < 3; k++) {
        uint32_t part = word(m, m->composites[x] + k);
        if (!m->is_integer[part] || m->integers[part] != m->local_size[k]) return false;
    }
    return true;
}

/* What a variable of this type takes at most: three of a vector count four. */
static uint64_t bytes_of(const Module *m, uint32_t x) {
    const Type *type = m->types + x;
    uint64_t sum = 0;
    if (type->letter) return 4 * (type->components == 3 ? 4 : type->components);
    if (type->kind != STRUCT) return type->count * bytes_of(m, type->of);
    for (uint32_t k = 0; k < type->count; k++) sum += bytes_of(m, part_of(m, type, k));
    return sum;
}

static void check_marks(const Module *m) {
    if (m->stage == FRAGMENT_STAGE && !(m->modes >> 7 & 1)) FAIL(m, "is a fragment shader without OriginUpperLeft");
    if (m->stage == COMPUTE_STAGE && m->modes != 1u << LOCAL_SIZE) FAIL(m, "is a compute shader without LocalSize, or with another mode");
    for (uint32_t x = 0; x < m->bound; x++)
        if (m->listed[x] && m->storage_of[x] != IN + 1 && m->storage_of[x] != OUT + 1)
            FAIL(m, "has an entry point that names id %u, which is no input or output", x);
    for (uint32_t k = 0; k < m->marked_count; k++) {
        uint32_t x = m->marked[k], has = m->marks[x].has;
        if (has == BIT(BUILT_IN) && m->marks[x].built_in == WORKGROUP_SIZE && says_size(m, x)) continue;
        if ((has & BIT(BLOCK) && m->types[x].kind != STRUCT) || (has & ~(FREE | BIT(BLOCK)) && !m->storage_of[x]))
            FAIL(m, "id %u: a decoration of what it does not go with", x);
    }
}

static const Interface *interface_of(Module *m) {
    check_marks(m);
    Interface *found = make(m->r, 1, sizeof *found);
    uint64_t extra[2] = {0, 0}, built_in[2] = {0, 0};
    bool *seen = make_scratch(m->r, m->count, 1);
    found->stage = m->stage;
    found->used = make(m->r, m->variable_count, sizeof *found->used);
    for (uint32_t k = 0; k < m->variable_count; k++) {
        uint32_t x = m->variables[k][0], storage = m->variables[k][1], pointee = m->variables[k][2];
        const Type *type = m->types + pointee;
        bool varying = storage == IN || storage == OUT;
        if (m->touched[x] && varying && !m->listed[x])
            FAIL(m, "id %u: an input or output that is used and not named by the entry point", x);
        m->writes_size |= m->touched[x] && m->marks[x].has & BIT(BUILT_IN) && m->marks[x].built_in == 1;
        uint32_t allowed = FREE | (storage == UNIFORM_CONSTANT ? OF_IMAGES | (type->format ? BIT(NON_READABLE) : 0) : varying ? OF_VARYINGS : 0);
        if (m->marks[x].has & ~allowed) FAIL(m, "id %u: a decoration that variables of its storage class have not", x);
        if (storage == UNIFORM_CONSTANT) bind(m, x, type, found, seen);
        if (storage == WORKGROUP) found->shared_bytes += bytes_of(m, pointee);
        if (!varying) continue;
        if (m->stage == COMPUTE_STAGE && !(m->marks[x].has & BIT(BUILT_IN)))
            FAIL(m, "id %u: an input or output of a compute shader that is no built-in", x);
        uint64_t mine = built_ins(m, x, storage, pointee);
        if (mine & built_in[storage == OUT]) FAIL(m, "id %u: a built-in that there is already", x);
        built_in[storage == OUT] |= mine;
        if (mine) {
            extra[storage == OUT] += type->components;
            continue;
        }
        locate(m, x, type, storage == IN ? found->inputs : found->outputs, storage);
        if (storage == IN) found->order[found->input_count++] = (uint8_t)m->marks[x].location;
        else found->output_count++;
    }
    if (m->stage == VERTEX_STAGE && found->input_count) FAIL(m, "takes vertex attributes; a bundle has none");
    found->input_components = components(found->inputs, extra[0]);
    found->output_components = components(found->outputs, extra[1]);
    found->writes_size = m->writes_size;
    for (int k = 0; k < 3; k++) found->local_size[k] = m->local_size[k];
    return found;
}

/* ---- The whole ---- */

static void make_room(Module *m) {
    Reader *r = m->r;
    m->types = make_scratch(r, m->bound, sizeof *m->types);
    m->values = make_scratch(r, m->bound, 4);
    m->integers = make_scratch(r, m->bound, 4);
    m->composites = make_scratch(r, m->bound, 4);
    m->marks = make_scratch(r, m->bound, sizeof *m->marks);
    m->marked = make_scratch(r, m->bound, 4);
    m->named = make_scratch(r, m->bound, sizeof *m->named);
    m->moded = make_scratch(r, m->bound, sizeof *m->moded);
    m->variables = make_scratch(r, m->bound, sizeof *m->variables); /* each defines an id */
    bool **flags[] = {&m->is_integer, &m->fixed, &m->defined, &m->touched, &m->listed, &m->closed, &m->is_named, &m->is_moded};
    for (size_t k = 0; k < COUNT(flags); k++) *flags[k] = make_scratch(r, m->bound, 1);
    m->storage_of = make_scratch(r, m->bound, 1);
}

const Interface *parse_shader(Reader *r, const uint8_t *data, uint64_t size) {
    Module module = {.r = r, .data = data}, *m = &module;
    if (size % 4 || size < 20) FAIL(m, "%llu bytes are no SPIR-V module", (unsigned long long)size);
    if (size > 4 * MAX_WORDS) FAIL(m, "has %llu words; at most %d are allowed", (unsigned long long)size / 4, MAX_WORDS);
    m->count = (uint32_t)(size / 4);
    if (word(m, 0) != 0x07230203) FAIL(m, "begins with 0x%08x; SPIR-V begins with 0x07230203", word(m, 0));
    if (word(m, 1) != 0x00010000) FAIL(m, "is SPIR-V version 0x%x; 1.0 (0x10000) is allowed", word(m, 1));
    m->bound = word(m, 3);
    if (!m->bound || m->bound > m->count) FAIL(m, "has ids up to %u; at most one a word, %u, is allowed", m->bound, m->count);
    if (word(m, 4)) FAIL(m, "has the reserved word %u; 0 is allowed", word(m, 4));
    make_room(m);
    find_repeated(m);
    uint32_t at = declarations(m);
    if (!m->stage) FAIL(m, "has no entry point");
    if (m->models != 1 || !(m->capabilities >> 1 & 1)) FAIL(m, "lacks its memory model, or capability 1 (Shader)");
    read_functions(m, at);
    for (uint32_t k = 0; k < m->named_count; k++)
        if (!m->defined[m->named[k].id]) WRONG(m, m->named[k].at, "speaks of id %u, which nothing defines", m->named[k].id);
    for (uint32_t k = 0; k < m->moded_count; k++)
        if (m->moded[k].id != m->entry || (m->stage != FRAGMENT_STAGE && m->modes != 1u << LOCAL_SIZE))
            WRONG(m, m->moded[k].at, "an execution mode of what is no fragment shader");
    return interface_of(m);
}
