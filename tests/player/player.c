/* A second player of bundles, written from docs/bundle-format.md alone: C11, libvulkan and libc.

   player check FILE                        accept or refuse, without any Vulkan
   player run FILE [DO NAME WHAT]...        in order: `set NAME FILE`, `step NAME COUNT`, `get NAME FILE`

   The files of set and get are a value's array in row-major order, little-endian fp32 or int32. DRESSI_DEVICE is a part of the
   name of the device to run on, DRESSI_PROFILE the name of the variant to play. Exit status: 0 done, 1 the device or the user,
   2 the bundle is refused.

   It checks the file, every field, index and size, the flow of data, and that shaders are whole instructions of the list; what
   their ids mean, and shaders against pipelines, it leaves to whoever verified the bundle. What it holds is freed by the end of
   the process, but for objects of Vulkan. A big-endian machine would need its swaps. */

#include <math.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <vulkan/vulkan.h>

/* ---- Errors: a refusal names the path of what is wrong ---- */

enum { MAX_DEPTH = 32, MAX_LIST = 1 << 20, MAX_ITEMS = 1 << 22, MAX_DESCRIPTION = 1 << 26, BLOCK = 64 };

static struct { const char *key; int64_t index; } path[MAX_DEPTH];
static int path_length;

static void push(const char *key, int64_t index) { path[path_length].key = key; path[path_length++].index = index; }
static void pop(void) { path_length--; }
#define AT(k) (path[path_length - 1].index = (k))

static _Noreturn void refuse(const char *format, ...) {
    for (int k = 0; k < path_length; k++) {
        if (path[k].key) fprintf(stderr, "%s%s", k ? "." : "", path[k].key);
        if (path[k].index >= 0) fprintf(stderr, "[%lld]", (long long)path[k].index);
    }
    va_list rest;
    va_start(rest, format);
    if (path_length) fputs(": ", stderr);
    vfprintf(stderr, format, rest);
    fputc('\n', stderr);
    exit(2);
}

static _Noreturn void die(const char *format, ...) {
    va_list rest;
    va_start(rest, format);
    vfprintf(stderr, format, rest);
    fputc('\n', stderr);
    exit(1);
}

static void *make(size_t count, size_t size) {
    void *p = calloc(count ? count : 1, size);
    if (!p) die("out of memory");
    return p;
}

/* ---- Bytes, SHA-256 ---- */

static uint8_t *file;
static uint64_t file_size;

static uint8_t *load_file(const char *name, uint64_t *size) {
    FILE *f = fopen(name, "rb");
    if (!f || fseek(f, 0, SEEK_END)) die("%s cannot be read", name);
    long n = ftell(f);
    if (n < 0 || n > INT64_C(1) << 32) die("%s has no size, or more than 2^32 bytes", name);
    uint8_t *data = make(n, 1);
    rewind(f);
    if (fread(data, 1, n, f) != (size_t)n) die("%s cannot be read", name);
    fclose(f);
    *size = n;
    return data;
}

static uint64_t little(const uint8_t *p, int bytes) {
    uint64_t x = 0;
    while (bytes--) x = x << 8 | p[bytes];
    return x;
}

static uint32_t turn(uint32_t x, int n) { return x >> n | x << (32 - n); }

/* The round constants are the first 32 bits of the fractional parts of cube roots of primes (FIPS 180-4, 4.2.2), made here. */
static void sha256(const uint8_t *data, uint64_t size, uint8_t digest[32]) {
    static uint32_t constants[64], first[8];
    for (int k = 0, n = 2; k < 64; n++) {
        bool prime = true;
        for (int d = 2; d * d <= n; d++) prime &= n % d != 0;
        if (!prime) continue;
        constants[k] = (uint32_t)(int64_t)floorl(fmodl(cbrtl(n), 1) * 4294967296.0L);
        if (k < 8) first[k] = (uint32_t)(int64_t)floorl(fmodl(sqrtl(n), 1) * 4294967296.0L);
        k++;
    }
    uint32_t h[8];
    memcpy(h, first, sizeof h);
    uint64_t blocks = (size + 8) / 64 + 1;
    for (uint64_t b = 0; b < blocks; b++) {
        uint32_t w[64], v[8];
        for (int k = 0; k < 64; k++) {
            uint64_t at = b * 64 + k;
            uint8_t byte = at < size ? data[at] : at == size ? 0x80 : b == blocks - 1 && k >= 56 ? size * 8 >> 8 * (63 - k) : 0;
            w[k / 4] = w[k / 4] << 8 | byte;
        }
        for (int k = 16; k < 64; k++) {
            uint32_t x = w[k - 15], y = w[k - 2];
            w[k] = w[k - 16] + w[k - 7] + (turn(x, 7) ^ turn(x, 18) ^ x >> 3) + (turn(y, 17) ^ turn(y, 19) ^ y >> 10);
        }
        memcpy(v, h, sizeof v);
        for (int k = 0; k < 64; k++) {
            uint32_t e = v[4], a = v[0];
            uint32_t one = v[7] + (turn(e, 6) ^ turn(e, 11) ^ turn(e, 25)) + ((e & v[5]) ^ (~e & v[6])) + constants[k] + w[k];
            uint32_t two = (turn(a, 2) ^ turn(a, 13) ^ turn(a, 22)) + ((a & v[1]) ^ (a & v[2]) ^ (v[1] & v[2]));
            memmove(v + 1, v, 7 * sizeof *v);
            v[4] += one;
            v[0] = one + two;
        }
        for (int k = 0; k < 8; k++) h[k] += v[k];
    }
    for (int k = 0; k < 32; k++) digest[k] = h[k / 4] >> 8 * (3 - k % 4);
}

static void check_digest(const uint8_t *data, uint64_t size, const uint8_t *expected, const char *what) {
    uint8_t found[32];
    sha256(data, size, found);
    if (memcmp(found, expected, 32)) refuse("the checksum of %s is wrong", what);
}

/* ---- MessagePack: a tree of nodes, 16 bytes each, no more than bytes, nor than 2^22 ---- */

typedef enum { NIL, BOOLEAN, INTEGER, REAL, STRING, BINARY, ARRAY, MAP } Kind;
static const char *KINDS[] = {"nil", "a boolean", "an integer", "a float", "a str", "a bin", "a list", "a map"};

typedef struct Node {
    Kind kind;
    uint32_t count;  /* bytes, items, or pairs */
    union { int64_t integer; double real; const uint8_t *bytes; struct Node *items; } is;
} Node;

static struct { const uint8_t *at, *end; Node *free, *limit; } text;

static const uint8_t *take(uint64_t n) {
    if ((uint64_t)(text.end - text.at) < n) refuse("the description ends within an item");
    text.at += n;
    return text.at - n;
}

static uint64_t big(int bytes) {
    const uint8_t *p = take(bytes);
    uint64_t x = 0;
    while (bytes--) x = x << 8 | *p++;
    return x;
}

static bool is_utf8(const uint8_t *p, uint32_t n) {
    for (uint32_t k = 0; k < n;) {
        int more = p[k] < 0x80 ? 0 : p[k] >> 5 == 6 ? 1 : p[k] >> 4 == 14 ? 2 : p[k] >> 3 == 30 ? 3 : -1;
        if (more < 0 || k + more >= n) return false;
        uint32_t code = more ? p[k] & 0x3f >> more : p[k];
        for (int j = 1; j <= more; j++) {
            if (p[k + j] >> 6 != 2) return false;
            code = code << 6 | (p[k + j] & 0x3f);
        }
        if (code < (uint32_t[]){0, 0x80, 0x800, 0x10000}[more] || code > 0x10ffff || code >> 11 == 0x1b) return false;
        k += more + 1;
    }
    return true;
}

static void read_node(Node *node, int depth) {
    if (depth > MAX_DEPTH) refuse("the description is nested deeper than %d", MAX_DEPTH);
    uint8_t tag = *take(1);
    *node = (Node){NIL, 0, {0}};
    uint64_t bits;
    if (tag < 0x80 || tag >= 0xe0) { node->kind = INTEGER; node->is.integer = (int8_t)tag; }
    else if (tag < 0x90) { node->kind = MAP; node->count = tag & 15; }
    else if (tag < 0xa0) { node->kind = ARRAY; node->count = tag & 15; }
    else if (tag < 0xc0) { node->kind = STRING; node->count = tag & 31; }
    else switch (tag) {
    case 0xc0: break;
    case 0xc2: case 0xc3: node->kind = BOOLEAN; node->is.integer = tag & 1; break;
    case 0xc4: case 0xc5: case 0xc6: node->kind = BINARY; node->count = big(1 << (tag - 0xc4)); break;
    case 0xcb: node->kind = REAL; bits = big(8); memcpy(&node->is.real, &bits, 8); break;
    case 0xcc: case 0xcd: case 0xce: case 0xcf:
        bits = big(1 << (tag - 0xcc));
        node->kind = INTEGER; node->is.integer = bits > INT64_MAX ? INT64_MAX : bits; break;  /* beyond every range but meta's */
    case 0xd0: node->kind = INTEGER; node->is.integer = (int8_t)big(1); break;
    case 0xd1: node->kind = INTEGER; node->is.integer = (int16_t)big(2); break;
    case 0xd2: node->kind = INTEGER; node->is.integer = (int32_t)big(4); break;
    case 0xd3: node->kind = INTEGER; node->is.integer = (int64_t)big(8); break;
    case 0xd9: case 0xda: case 0xdb: node->kind = STRING; node->count = big(1 << (tag - 0xd9)); break;
    case 0xdc: case 0xdd: node->kind = ARRAY; node->count = big(2 << (tag - 0xdc)); break;
    case 0xde: case 0xdf: node->kind = MAP; node->count = big(2 << (tag - 0xde)); break;
    default: refuse("the description has the byte 0x%02x, which is not allowed there", tag);
    }
    if (node->kind == STRING || node->kind == BINARY) {
        node->is.bytes = take(node->count);
        if (node->kind == STRING && !is_utf8(node->is.bytes, node->count)) refuse("the description has a str that is not UTF-8");
    } else if (node->kind == ARRAY || node->kind == MAP) {
        uint64_t n = node->kind == MAP ? UINT64_C(2) * node->count : node->count;
        if (n > (uint64_t)(text.limit - text.free)) refuse("the description claims more items than it has bytes, or than are allowed");
        node->is.items = text.free;
        text.free += n;
        for (uint64_t k = 0; k < n; k++) {
            read_node(node->is.items + k, depth + 1);
            if (node->kind == MAP && !(k & 1) && node->is.items[k].kind != STRING) refuse("the description has a key that is no str");
        }
    }
}

static Node read_description(const uint8_t *bytes, uint64_t size) {
    uint64_t most = size < MAX_ITEMS ? size : MAX_ITEMS;
    Node *pool = make(most, sizeof *pool), root;
    text.at = bytes, text.end = bytes + size, text.free = pool, text.limit = pool + most;
    read_node(&root, 0);
    if (text.at != text.end) refuse("bytes follow the description's map");
    return root;
}

/* ---- Reading fields: each checks what it returns ---- */

static bool same(const Node *node, const char *word) {
    return node->kind == STRING && node->count == strlen(word) && !memcmp(node->is.bytes, word, node->count);
}

static const Node *field(const Node *map, const char *key) {
    for (uint32_t k = 0; k < map->count; k++)
        if (same(map->is.items + 2 * k, key)) return map->is.items + 2 * k + 1;
    refuse("lacks %s", key);
}

/* Exactly these keys: as many, and each there. */
static void keys(const Node *map, const char *names) {
    if (map->kind != MAP) refuse("is %s; a map is needed", KINDS[map->kind]);
    uint32_t count = 0;
    for (char word[32]; *names; count++) {
        int n = strcspn(names, " ");
        snprintf(word, sizeof word, "%.*s", n, names);
        names += n + (names[n] == ' ');
        field(map, word);
    }
    if (map->count != count) refuse("has %u keys; %u are allowed", map->count, count);
}

static int64_t integer(const Node *node, int64_t low, int64_t high) {
    if (node->kind != INTEGER || node->is.integer < low || node->is.integer > high)
        refuse("is no integer from %lld to %lld", (long long)low, (long long)high);
    return node->is.integer;
}

static int64_t number(const Node *map, const char *key, int64_t low, int64_t high) {
    push(key, -1);
    int64_t x = integer(field(map, key), low, high);
    pop();
    return x;
}

static bool boolean(const Node *map, const char *key) {
    const Node *node = field(map, key);
    if (node->kind != BOOLEAN) refuse("%s is %s; a boolean is needed", key, KINDS[node->kind]);
    return node->is.integer;
}

static const Node *list(const Node *node, uint32_t most) {
    if (node->kind != ARRAY || node->count > most) refuse("is no list of at most %u", most);
    return node;
}

/* A list of map[key], with its key on the path until the caller pops it. */
static const Node *open_list(const Node *map, const char *key, uint32_t most) {
    push(key, -1);
    return list(field(map, key), most);
}

#define EACH(k, node) (uint32_t k = 0; k < (node)->count && (AT(k), true); k++)

static char *word(const Node *map, const char *key) {
    const Node *node = field(map, key);
    push(key, -1);
    uint32_t characters = 0;
    if (node->kind != STRING) refuse("is %s; a text is needed", KINDS[node->kind]);
    for (uint32_t k = 0; k < node->count; k++) {
        const uint8_t *p = node->is.bytes + k;
        if (*p < 0x20 || *p == 0x7f || (*p == 0xc2 && p[1] < 0xa0)) refuse("has a control character");
        characters += *p >> 6 != 2;
    }
    if (characters < 1 || characters > 200) refuse("has %u characters; 1 to 200 are allowed", characters);
    char *copy = make(node->count + 1, 1);
    memcpy(copy, node->is.bytes, node->count);
    pop();
    return copy;
}

static int choice(const Node *map, const char *key, const char *const *words, int count) {
    const Node *node = field(map, key);
    for (int k = 0; k < count; k++)
        if (same(node, words[k])) return k;
    refuse("%s is not one of the %d words allowed", key, count);
}

static uint32_t one_of(const Node *node, const int *allowed, int count) {
    for (int k = 0; k < count; k++)
        if (node->kind == INTEGER && node->is.integer == allowed[k]) return allowed[k];
    refuse("is not one of the %d numbers allowed", count);
}
#define ONE_OF(node, ...) one_of(node, (const int[]){__VA_ARGS__}, sizeof((const int[]){__VA_ARGS__}) / sizeof(int))

typedef struct { uint32_t count, *at; } Indices;

static Indices indices(const Node *map, const char *key, uint32_t most, int64_t below) {
    const Node *node = open_list(map, key, most);
    Indices found = {node->count, make(node->count, sizeof(uint32_t))};
    for EACH(k, node) found.at[k] = integer(node->is.items + k, 0, below - 1);
    pop();
    return found;
}

static bool has(Indices all, uint32_t x) {
    for (uint32_t k = 0; k < all.count; k++)
        if (all.at[k] == x) return true;
    return false;
}

/* ---- What a bundle has ---- */

typedef struct { const uint8_t *data; uint64_t size; } Blob;
typedef struct {
    uint32_t format, width, height, slots, usage, parity;
    int data, value;  /* a blob and a value, or -1 */
    VkImage handle[2];
    VkImageView view[2];
} Image;
typedef struct { uint32_t format, load, store; int clear; } Attachment;
typedef struct { Indices colors, inputs; int depth; } Subpass;
typedef struct { uint32_t attachment_count, subpass_count; Attachment *attachments; Subpass *subpasses; VkRenderPass handle; } Pass;
typedef struct { uint32_t kind, stages; int sampler; } Binding;
typedef struct {
    uint32_t vertex, fragment, pass, subpass, binding_count, topology;
    Binding *bindings;
    bool depth;
    VkDescriptorSetLayout set_layout;
    VkPipelineLayout layout;
    VkPipeline handle;
} Pipeline;
typedef enum { INPUT, STATE, OUTPUT, COPY } Role;
typedef enum { UNIT, TABLE, IMAGE, ATLAS } Layout;
typedef struct {
    char *name;
    Role role;
    Layout layout;
    uint32_t image, channels, width, height, count, columns;
    bool is_int, has_value;
    int initial, enter;  /* a blob; of a copy the plan that fills it; or -1 */
    uint64_t version;
} Value;
typedef struct { uint32_t pipeline, vertices, cell_count; int64_t count; Indices images; int (*cells)[4]; float near, far; } Draw;
typedef struct { uint32_t count; Draw *draws; } Draws;
typedef struct { uint32_t pass, width, height; Indices attachments; bool wait; Draws *subpasses; } Stage;
typedef struct Recording {
    uint8_t *parities;  /* of all images, as they were when it was made */
    VkCommandBuffer commands;
    VkDescriptorPool sets;
    VkFramebuffer *framebuffers;
    struct Recording *next;
} Recording;
typedef enum { GIVES, PHASE, ENTER, LEAVE } Purpose;
typedef struct {
    char *name;
    Purpose purpose;
    Indices updates, reads, outputs, needs;
    uint32_t stage_count;
    Stage *stages;
    bool has_run, out;  /* out: of an enter, that its copies are newer than the states */
    uint64_t seen;  /* versions() when it last ran */
    Recording *recordings;
} Plan;

enum { MAX_VARIANTS = 16 };

typedef struct {
    const Node *root;
    char *profile;
    Image *images; uint32_t image_count;
    Indices samplers, shaders;
    Pass *passes; uint32_t pass_count;
    Pipeline *pipelines; uint32_t pipeline_count;
    Value *values; uint32_t value_count;
    Plan *plans; uint32_t plan_count;
} Variant;

static Blob *blobs;
static uint32_t blob_count, variant_count;
static Variant variants[MAX_VARIANTS], bundle;  /* `bundle` is the variant being read or played */

static bool is_half(uint32_t format) { return format == 76 || format == 83 || format == 97; }
static uint32_t texel_bytes(uint32_t format) {
    if (is_half(format)) return format == 76 ? 2 : format == 83 ? 4 : 8;
    return format == 99 || format == 100 ? 4 : format == 102 || format == 103 ? 8 : 16;
}
static bool is_integer(uint32_t format) { return format == 99 || format == 102 || format == 108; }
static uint64_t image_bytes(const Image *image) { return (uint64_t)image->width * image->height * texel_bytes(image->format); }
static uint64_t rounded(uint64_t n) { return (n + BLOCK - 1) / BLOCK * BLOCK; }

#define FORMATS 0, 76, 83, 97, 99, 100, 102, 103, 108, 109
static const char *FORMAT_NAMES[] = {"R16_SFLOAT", "R16G16_SFLOAT", "R16G16B16A16_SFLOAT", "R32_SINT", "R32_SFLOAT", "R32G32_SINT",
                                     "R32G32_SFLOAT", "R32G32B32A32_SINT", "R32G32B32A32_SFLOAT"};
static const int FORMAT_NUMBERS[] = {76, 83, 97, 99, 100, 102, 103, 108, 109};
enum { FORMAT_COUNT = sizeof FORMAT_NUMBERS / sizeof *FORMAT_NUMBERS };
static const char *FEATURES[] = {"sampled", "color", "filter"};
static const VkFormatFeatureFlags FEATURE_BITS[] = {VK_FORMAT_FEATURE_SAMPLED_IMAGE_BIT, VK_FORMAT_FEATURE_COLOR_ATTACHMENT_BIT,
                                                    VK_FORMAT_FEATURE_SAMPLED_IMAGE_FILTER_LINEAR_BIT};
#define LIMIT(name) {#name, offsetof(VkPhysicalDeviceLimits, name)}
static const struct { const char *name; size_t offset; } LIMITS[] = {
    LIMIT(maxImageDimension2D), LIMIT(maxFramebufferWidth), LIMIT(maxFramebufferHeight), LIMIT(maxColorAttachments),
    LIMIT(maxFragmentOutputAttachments), LIMIT(maxFragmentCombinedOutputResources), LIMIT(maxPerStageResources),
    LIMIT(maxDescriptorSetSamplers), LIMIT(maxDescriptorSetSampledImages), LIMIT(maxDescriptorSetInputAttachments),
    LIMIT(maxPerStageDescriptorSamplers), LIMIT(maxPerStageDescriptorSampledImages), LIMIT(maxPerStageDescriptorInputAttachments)};
enum { LIMIT_COUNT = sizeof LIMITS / sizeof *LIMITS };

/* ---- SPIR-V: whole instructions, and none but those of the list ---- */

static bool opcode_allowed(uint32_t op, bool in_function) {
    static const uint8_t function[][2] = {{1, 1}, {8, 8}, {12, 12}, {54, 57}, {59, 59}, {61, 63}, {65, 66}, {79, 84}, {86, 88}, {91, 92},
        {95, 96}, {98, 98}, {100, 100}, {103, 106}, {109, 116}, {124, 124}, {126, 152}, {154, 191}, {194, 205}, {207, 215}, {245, 255}};
    static const uint8_t before[][2] = {{1, 8}, {11, 11}, {14, 17}, {19, 25}, {27, 28}, {30, 30}, {32, 33}, {41, 44}, {46, 46}, {59, 59},
        {71, 72}};
    if (op == 317 || op == 330) return op == 317 || !in_function;
    for (uint32_t k = 0; k < (in_function ? sizeof function : sizeof before) / 2; k++) {
        const uint8_t *range = in_function ? function[k] : before[k];
        if (op >= range[0] && op <= range[1]) return true;
    }
    return false;
}

/* The execution model: 0 vertex, 4 fragment. */
static uint32_t check_shader(const uint8_t *data, uint64_t size) {
    if (size % 4 || size < 20) refuse("%llu bytes are no SPIR-V module", (unsigned long long)size);
    const uint32_t *words = (const uint32_t *)data;  /* blobs begin at multiples of 64 of an allocation */
    uint64_t count = size / 4, model = 99;
    if (words[0] != 0x07230203 || words[1] != 0x00010000 || words[4] || words[3] > count)
        refuse("is no SPIR-V 1.0 module, or binds more ids than it has words");
    bool in_function = false;
    for (uint64_t at = 5; at < count;) {
        uint32_t op = words[at] & 0xffff, length = words[at] >> 16;
        const uint32_t *operands = words + at + 1;
        if (!length || at + length > count) refuse("word %llu: instruction %u leaves the module", (unsigned long long)at, op);
        if (op == 54) in_function = true;
        if (!opcode_allowed(op, in_function)) refuse("word %llu: instruction %u is not allowed", (unsigned long long)at, op);
        if (op == 17 && (length != 2 || (operands[0] > 1 && operands[0] != 40 && operands[0] != 50 && operands[0] != 51)))
            refuse("capability %u is not allowed", length > 1 ? operands[0] : 0);
        if (op == 11 && (length != 6 || memcmp(operands + 1, "GLSL.std.450\0\0\0", 16))) refuse("imports another set than GLSL.std.450");
        if (op == 14 && (length != 3 || operands[0] != 0 || operands[1] != 1)) refuse("the memory model is not Logical GLSL450");
        if (op == 15) {
            if (model != 99 || length < 5 || (operands[0] != 0 && operands[0] != 4) || memcmp(operands + 2, "main\0\0\0", 8))
                refuse("needs one entry point main, vertex or fragment");
            model = operands[0];
        }
        at += length;
    }
    if (model == 99) refuse("has no entry point");
    return model;
}

/* ---- The description ---- */

static void read_blobs(const Node *root, uint64_t end) {
    const Node *rows = open_list(root, "blobs", MAX_LIST);
    blobs = make(blob_count = rows->count, sizeof(Blob));
    for EACH(k, rows) {
        const Node *row = list(rows->is.items + k, 3), *digest = row->is.items + 2;
        if (row->count != 3 || digest->kind != BINARY || digest->count != 32) refuse("is no [offset, size, SHA-256]");
        uint64_t offset = integer(row->is.items, rounded(end), rounded(end));
        uint64_t size = integer(row->is.items + 1, 0, file_size);
        if (offset + size > file_size) refuse("lies beyond the end of the file");
        for (; end < offset; end++) if (file[end]) refuse("the padding before it is not zero");
        blobs[k] = (Blob){file + offset, size};
        check_digest(file + offset, size, digest->is.bytes, "the blob");
        end = offset + size;
    }
    pop();
    if (rounded(end) != file_size) refuse("the file has %llu bytes; %llu are needed", (unsigned long long)file_size,
                                          (unsigned long long)rounded(end));
    for (; end < file_size; end++) if (file[end]) refuse("the last padding is not zero");
}

static int blob_or_nil(const Node *map, const char *key, uint64_t bytes) {
    const Node *node = field(map, key);
    if (node->kind == NIL) return -1;
    int k = number(map, key, 0, (int64_t)blob_count - 1);
    if (blobs[k].size != bytes) refuse("%s: blob %d has %llu bytes; %llu are needed", key, k,
                                              (unsigned long long)blobs[k].size, (unsigned long long)bytes);
    return k;
}

static void check_meta(const Node *node, int depth) {
    if (node->kind != ARRAY && node->kind != MAP) return;
    if (depth > 16) refuse("is nested deeper than 16");
    for (uint64_t k = 0; k < node->count * (node->kind == MAP ? UINT64_C(2) : 1); k++) check_meta(node->is.items + k, depth + 1);
}

static void read_needs(void) {
    const Node *needs = field(bundle.root, "needs");
    keys(needs, "limits formats");
    const Node *limits = field(needs, "limits"), *formats = field(needs, "formats");
    if (limits->kind != MAP || formats->kind != MAP) refuse("limits and formats must be maps");
    uint32_t known = 0;
    for (uint32_t k = 0; k < LIMIT_COUNT; k++)
        for (uint32_t j = 0; j < limits->count; j++)
            if (same(limits->is.items + 2 * j, LIMITS[k].name)) {
                known++;
                integer(limits->is.items + 2 * j + 1, 0, INT64_C(1) << 40);
            }
    if (known != limits->count) refuse("limits names what this player does not know");
    known = 0;
    for (uint32_t k = 0; k < FORMAT_COUNT; k++)
        for (uint32_t j = 0; j < formats->count; j++)
            if (same(formats->is.items + 2 * j, FORMAT_NAMES[k])) {
                const Node *wanted = list(formats->is.items + 2 * j + 1, MAX_LIST);
                for (uint32_t f = 0; f < wanted->count; f++)
                    if (!same(wanted->is.items + f, FEATURES[0]) && !same(wanted->is.items + f, FEATURES[1]) &&
                        !same(wanted->is.items + f, FEATURES[2]))
                        refuse("formats.%s has an unknown feature", FORMAT_NAMES[k]);
                known++;
            }
    if (known != formats->count) refuse("formats names what this player does not know");
}

static void read_images(void) {
    const Node *images = open_list(bundle.root, "images", MAX_LIST);
    bundle.images = make(bundle.image_count = images->count, sizeof(Image));
    for EACH(k, images) {
        const Node *node = images->is.items + k;
        Image *image = bundle.images + k;
        keys(node, "format width height slots usage data");
        image->format = ONE_OF(field(node, "format"), FORMATS);
        image->width = number(node, "width", 1, 65536);
        image->height = number(node, "height", 1, 65536);
        image->slots = number(node, "slots", 1, 2);
        image->usage = number(node, "usage", 1, 255);
        if (image->usage & ~(image->format ? 151u : 32u)) refuse("usage is %u", image->usage);
        image->value = -1;
        image->data = blob_or_nil(node, "data", image_bytes(image));
        if (image->data >= 0 && (!image->format || image->slots != 1 || !(image->usage & 2)))
            refuse("data needs a colour format, one slot and usage 2");
    }
    pop();
}

static void read_passes(void) {
    const Node *passes = open_list(bundle.root, "passes", MAX_LIST);
    bundle.passes = make(bundle.pass_count = passes->count, sizeof(Pass));
    for EACH(k, passes) {
        const Node *node = passes->is.items + k;
        Pass *pass = bundle.passes + k;
        keys(node, "attachments subpasses");
        const Node *attachments = open_list(node, "attachments", 1024);
        pass->attachments = make(pass->attachment_count = attachments->count, sizeof(Attachment));
        bool *written = make(pass->attachment_count, 1);
        for EACH(a, attachments) {
            const Node *item = attachments->is.items + a;
            keys(item, "format load store clear");
            Attachment *attachment = pass->attachments + a;
            attachment->format = ONE_OF(field(item, "format"), FORMATS);
            attachment->load = number(item, "load", attachment->format ? 0 : 1, attachment->format ? 2 : 1);
            attachment->store = number(item, "store", 0, 1);
            bool whole = is_integer(attachment->format);
            attachment->clear = number(item, "clear", whole ? -1 : 0, whole || !attachment->format ? 1 : 0);
            written[a] = attachment->load == 0;
        }
        pop();
        const Node *subpasses = open_list(node, "subpasses", 1024);
        if (!subpasses->count) refuse("is empty; at least one is needed");
        pass->subpasses = make(pass->subpass_count = subpasses->count, sizeof(Subpass));
        for EACH(s, subpasses) {
            const Node *item = subpasses->is.items + s;
            Subpass *subpass = pass->subpasses + s;
            keys(item, "colors inputs depth");
            subpass->colors = indices(item, "colors", 128, pass->attachment_count);
            subpass->inputs = indices(item, "inputs", 128, pass->attachment_count);
            subpass->depth = number(item, "depth", -1, (int64_t)pass->attachment_count - 1);
            if (subpass->depth >= 0 && pass->attachments[subpass->depth].format) refuse("depth is no depth attachment");
            for (uint32_t c = 0; c < subpass->colors.count; c++) {
                uint32_t a = subpass->colors.at[c];
                Indices before = {c, subpass->colors.at};
                if (!pass->attachments[a].format) refuse("colors[%u] is a depth attachment", c);
                if (has(before, a) || has(subpass->inputs, a)) refuse("an attachment is used twice");
            }
            for (uint32_t i = 0; i < subpass->inputs.count; i++) {
                uint32_t a = subpass->inputs.at[i];
                if (!pass->attachments[a].format) refuse("inputs[%u] is a depth attachment", i);
                if (!written[a]) refuse("inputs[%u]: attachment %u was neither loaded nor written by an earlier subpass", i, a);
            }
            for (uint32_t c = 0; c < subpass->colors.count; c++) written[subpass->colors.at[c]] = true;
        }
        pop();
        free(written);
    }
    pop();
}

static void read_pipelines(const uint32_t *models) {
    const Node *pipelines = open_list(bundle.root, "pipelines", MAX_LIST);
    bundle.pipelines = make(bundle.pipeline_count = pipelines->count, sizeof(Pipeline));
    for EACH(k, pipelines) {
        const Node *node = pipelines->is.items + k;
        Pipeline *pipeline = bundle.pipelines + k;
        keys(node, "vertex fragment pass subpass bindings depth topology");
        pipeline->vertex = number(node, "vertex", 0, (int64_t)bundle.shaders.count - 1);
        pipeline->fragment = number(node, "fragment", 0, (int64_t)bundle.shaders.count - 1);
        if (models[pipeline->vertex] != 0 || models[pipeline->fragment] != 4) refuse("a shader is for another stage");
        pipeline->pass = number(node, "pass", 0, (int64_t)bundle.pass_count - 1);
        const Pass *pass = bundle.passes + pipeline->pass;
        pipeline->subpass = number(node, "subpass", 0, (int64_t)pass->subpass_count - 1);
        pipeline->depth = boolean(node, "depth");
        if (pipeline->depth && pass->subpasses[pipeline->subpass].depth < 0) refuse("depth needs a depth attachment in the subpass");
        pipeline->topology = ONE_OF(field(node, "topology"), 0, 3);
        const Node *bindings = open_list(node, "bindings", 1024);
        pipeline->bindings = make(pipeline->binding_count = bindings->count, sizeof(Binding));
        for EACH(b, bindings) {
            const Node *row = list(bindings->is.items + b, 3);
            if (row->count != 3) refuse("is no [kind, stages, sampler]");
            Binding *binding = pipeline->bindings + b;
            binding->kind = ONE_OF(row->is.items, 1, 2, 10);
            binding->stages = ONE_OF(row->is.items + 1, 1, 16, 17);
            bool sampler = binding->kind == 1;
            binding->sampler = integer(row->is.items + 2, sampler ? 0 : -1, sampler ? (int64_t)bundle.samplers.count - 1 : -1);
        }
        pop();
    }
    pop();
}

static uint64_t divided(uint64_t a, uint64_t b) { return (a + b - 1) / b; }

static void read_values(void) {
    static const char *const roles[] = {"input", "state", "output", "copy"}, *const layouts[] = {"unit", "table", "image", "atlas"};
    static const char *const types[] = {"float", "vec2", "vec3", "vec4", "int", "ivec2", "ivec3", "ivec4"};
    const Node *values = open_list(bundle.root, "values", MAX_LIST);
    bundle.values = make(bundle.value_count = values->count, sizeof(Value));
    for EACH(k, values) {
        const Node *node = values->is.items + k;
        Value *value = bundle.values + k;
        keys(node, "name role image type layout width height count columns initial");
        value->name = word(node, "name");
        for (uint32_t j = 0; j < k; j++)
            if (!strcmp(bundle.values[j].name, value->name)) refuse("name '%s' is taken", value->name);
        value->role = choice(node, "role", roles, 4);
        value->image = number(node, "image", 0, (int64_t)bundle.image_count - 1);
        int type = choice(node, "type", types, 8);
        value->channels = type % 4 + 1;
        value->is_int = type > 3;
        value->layout = choice(node, "layout", layouts, 4);
        value->width = number(node, "width", 1, 1 << 30);
        value->height = number(node, "height", 1, 1 << 30);
        value->count = number(node, "count", 1, 1 << 30);
        value->columns = number(node, "columns", 1, 1 << 30);
        uint64_t w = 1, h = 1;
        if (value->layout == TABLE) {
            for (w = value->count < 3 ? value->count : 4; divided(value->count, w) > 4096;) w *= 2;
            h = divided(value->count, w);
        } else if (value->layout == IMAGE) {
            w = value->width, h = value->height;
        } else if (value->layout == ATLAS) {
            w = (uint64_t)value->width * value->columns, h = value->height * divided(value->count, value->columns);
        }
        Image *image = bundle.images + value->image;
        if (image->width != w || image->height != h) refuse("its image is %u x %u; %llu x %llu is needed", image->width, image->height,
                                                            (unsigned long long)w, (unsigned long long)h);
        uint32_t format = (value->is_int ? 99 : 100) + (value->channels == 1 ? 0 : value->channels == 2 ? 3 : 9);
        uint32_t half = value->is_int || value->role != INPUT ? format : value->channels == 1 ? 76 : value->channels == 2 ? 83 : 97;
        if (image->format != format && image->format != half) refuse("its image has another format than its type");
        if (image->value >= 0 || image->data >= 0) refuse("its image is another value's, or a constant");
        if (image->slots != 1 && value->role != STATE && value->role != COPY) refuse("its image has two slots");
        uint32_t usage = value->role == COPY ? 0 : value->role == OUTPUT ? 1 : 3;
        if ((image->usage & usage) != usage) refuse("its image cannot be set or got");
        image->value = k;
        value->initial = blob_or_nil(node, "initial", image_bytes(image));
        if ((value->role == OUTPUT || value->role == COPY) && value->initial >= 0) refuse("an output or a copy has no initial");
        value->has_value = value->role == STATE || value->role == COPY || value->initial >= 0;
        value->enter = -1;
    }
    pop();
    push("images", 0);
    for (uint32_t k = 0; k < bundle.image_count; k++) {
        AT(k);
        const Image *image = bundle.images + k;
        if (image->slots != 2) continue;
        Role role = image->value < 0 ? OUTPUT : bundle.values[image->value].role;
        if (role != STATE && role != COPY) refuse("only the image of a state or copy has two slots");
    }
    pop();
}

static void check_refs(Indices refs) {
    for (uint32_t k = 0; k < refs.count; k++)
        if (refs.at[k] % 2 >= bundle.images[refs.at[k] / 2].slots) refuse("ref %u is a slot that the image has not", refs.at[k]);
}

static void read_draw(const Node *node, Draw *draw, const Stage *stage, uint32_t subpass) {
    keys(node, "pipeline images vertices cells depth_range count");
    draw->pipeline = number(node, "pipeline", 0, (int64_t)bundle.pipeline_count - 1);
    const Pipeline *pipeline = bundle.pipelines + draw->pipeline;
    if (pipeline->pass != stage->pass || pipeline->subpass != subpass) refuse("its pipeline was made for another subpass");
    draw->images = indices(node, "images", 1024, INT64_C(2) * bundle.image_count);
    check_refs(draw->images);
    if (draw->images.count != pipeline->binding_count) refuse("has %u images for %u bindings", draw->images.count, pipeline->binding_count);
    for (uint32_t k = 0; k < draw->images.count; k++) {
        uint32_t ref = draw->images.at[k], usage = bundle.images[ref / 2].usage;
        bool attached = has(stage->attachments, ref);
        if (pipeline->bindings[k].kind == 10 ? !(usage & 128) || !attached : !(usage & 4) || attached)
            refuse("images[%u] has not the usage of its binding, or is sampled and attached at once", k);
    }
    draw->vertices = number(node, "vertices", 1, INT32_MAX);
    const Node *cells = open_list(node, "cells", MAX_LIST);
    draw->cells = make(draw->cell_count = cells->count, sizeof *draw->cells);
    for EACH(c, cells) {
        const Node *cell = list(cells->is.items + c, 4);
        if (cell->count != 4) refuse("is no [x, y, width, height]");
        for (int k = 0; k < 4; k++) draw->cells[c][k] = integer(cell->is.items + k, k > 1, k % 2 ? stage->height : stage->width);
        if (draw->cells[c][0] + draw->cells[c][2] > (int)stage->width || draw->cells[c][1] + draw->cells[c][3] > (int)stage->height)
            refuse("leaves the stage");
    }
    pop();
    const Node *range = open_list(node, "depth_range", 2);
    if (range->count != 2) refuse("is no two floats");
    for (int k = 0; k < 2; k++)
        if (range->is.items[k].kind != REAL || !(range->is.items[k].is.real >= 0 && range->is.items[k].is.real <= 1))
            refuse("is no float from 0 to 1");
    draw->near = range->is.items[0].is.real, draw->far = range->is.items[1].is.real;
    pop();
    draw->count = number(node, "count", -1, INT64_C(2) * bundle.image_count - 1);  /* this player draws all vertices */
    if (draw->count < 0) return;
    const Image *image = bundle.images + draw->count / 2;
    if (draw->count % 2 >= image->slots || image->format != 99 || !(image->usage & 1) || has(stage->attachments, draw->count))
        refuse("count is no integer image to copy from");
    if (draw->cell_count != 1) refuse("has a count and more or less than one cell");
}

static void read_stage(const Node *node, Stage *stage, const Plan *plan) {
    keys(node, "pass width height attachments wait subpasses");
    stage->pass = number(node, "pass", 0, (int64_t)bundle.pass_count - 1);
    stage->width = number(node, "width", 1, 65536);
    stage->height = number(node, "height", 1, 65536);
    stage->wait = boolean(node, "wait");
    const Pass *pass = bundle.passes + stage->pass;
    stage->attachments = indices(node, "attachments", 1024, INT64_C(2) * bundle.image_count);
    check_refs(stage->attachments);
    if (stage->attachments.count != pass->attachment_count) refuse("has not the attachments of its pass");
    for (uint32_t k = 0; k < stage->attachments.count; k++) {
        uint32_t ref = stage->attachments.at[k];
        const Image *image = bundle.images + ref / 2;
        Indices before = {k, stage->attachments.at};
        if (has(before, ref)) refuse("attachments[%u] is attached twice", k);
        if (image->format != pass->attachments[k].format || !(image->usage & (image->format ? 16 : 32)) ||
            image->width != stage->width || image->height != stage->height)
            refuse("attachments[%u] has another format, usage or size", k);
        bool back = plan->purpose == LEAVE && image->value >= 0 && has(plan->updates, image->value);
        if (!(ref & 1) && back && pass->attachments[k].load) refuse("attachments[%u] is a state to update in place, and not loaded", k);
        if (!(ref & 1) && !back && (image->data >= 0 || (image->value >= 0 && bundle.values[image->value].role != OUTPUT)))
            refuse("attachments[%u] is only read", k);
    }
    const Node *subpasses = open_list(node, "subpasses", 1024);
    if (subpasses->count != pass->subpass_count) refuse("has %u items for %u subpasses", subpasses->count, pass->subpass_count);
    stage->subpasses = make(subpasses->count, sizeof(Draws));
    for EACH(s, subpasses) {
        const Node *draws = list(subpasses->is.items + s, MAX_LIST);
        stage->subpasses[s].draws = make(stage->subpasses[s].count = draws->count, sizeof(Draw));
        push(NULL, 0);
        for EACH(d, draws) read_draw(draws->is.items + d, stage->subpasses[s].draws + d, stage, s);
        pop();
    }
    pop();
}

static void check_once(Indices all, const char *what) {
    for (uint32_t k = 1; k < all.count; k++) {
        Indices before = {k, all.at};
        if (has(before, all.at[k])) refuse("%s names %u twice", what, all.at[k]);
    }
}

static bool updates_copies(const Plan *plan) {
    for (uint32_t k = 0; k < plan->updates.count; k++)
        if (bundle.values[plan->updates.at[k]].role == COPY) return true;
    return false;
}

/* What plan k is for, and whether it is whole as that. */
static void find_purpose(uint32_t k) {
    Plan *plan = bundle.plans + k, *enter = plan - 1;
    bool fills = updates_copies(plan);
    plan->purpose = plan->updates.count ? PHASE : GIVES;
    for (uint32_t j = 0; j < plan->needs.count; j++) fills &= bundle.plans[plan->needs.at[j]].purpose != ENTER;
    if (k && enter->purpose == ENTER) {
        plan->purpose = LEAVE;
        bool same = plan->updates.count == enter->updates.count && plan->needs.count == enter->needs.count + 1 && !plan->outputs.count;
        for (uint32_t j = 0; same && j < plan->needs.count; j++)
            same = plan->needs.at[j] == (j < enter->needs.count ? enter->needs.at[j] : k - 1);
        for (uint32_t j = 0; same && j < plan->updates.count; j++) {
            const Value *a = bundle.values + plan->updates.at[j], *b = bundle.values + enter->updates.at[j];
            same = a->role == STATE && a->channels == b->channels && a->is_int == b->is_int;
        }
        for (uint32_t j = 0; same && j < plan->reads.count; j++) same = has(enter->updates, plan->reads.at[j]);
        if (!same) refuse("does not give back what the plan before it fills");
    } else if (fills) {
        plan->purpose = ENTER;
        for (uint32_t j = 0; j < plan->updates.count; j++) {
            Value *value = bundle.values + plan->updates.at[j];
            if (value->role != COPY || value->enter >= 0) refuse("fills what is no copy, or one that another plan fills");
            value->enter = k;
        }
        if (k + 1 == bundle.plan_count) refuse("fills copies, and no plan gives them back");
    }
    Indices both[] = {plan->updates, plan->reads};
    for (int b = 0; b < 2; b++)
        for (uint32_t j = 0; j < both[b].count; j++) {
            const Value *value = bundle.values + both[b].at[j];
            if (value->role != COPY || value->enter == (int)k) continue;
            if (value->enter < 0 || !has(plan->needs, value->enter))
                refuse("has to do with copy '%s', and needs no plan that fills it", value->name);
            for (uint32_t n = 0; !b && n < bundle.plans[value->enter].updates.count; n++)
                if (!has(plan->updates, bundle.plans[value->enter].updates.at[n])) refuse("updates copy '%s' without others", value->name);
        }
    for (uint32_t j = 0; j < plan->updates.count && plan->purpose != LEAVE; j++)
        if (bundle.images[bundle.values[plan->updates.at[j]].image].slots != 2) refuse("updates what has not two slots");
}

static void read_plans(void) {
    const Node *plans = open_list(bundle.root, "plans", 4096);
    bundle.plans = make(bundle.plan_count = plans->count, sizeof(Plan));
    for EACH(k, plans) {
        const Node *node = plans->is.items + k;
        Plan *plan = bundle.plans + k;
        keys(node, "name updates reads outputs needs steps stages");
        plan->name = word(node, "name");
        for (uint32_t j = 0; j < k; j++)
            if (!strcmp(bundle.plans[j].name, plan->name)) refuse("name '%s' is taken", plan->name);
        number(node, "steps", 0, INT64_C(1) << 40);
        plan->updates = indices(node, "updates", MAX_LIST, bundle.value_count);
        plan->reads = indices(node, "reads", MAX_LIST, bundle.value_count);
        plan->outputs = indices(node, "outputs", MAX_LIST, bundle.value_count);
        plan->needs = indices(node, "needs", 16, k);
        check_once(plan->updates, "updates"), check_once(plan->reads, "reads"), check_once(plan->outputs, "outputs");
        for (uint32_t j = 0; j < plan->updates.count; j++) {
            const Value *value = bundle.values + plan->updates.at[j];
            if (value->role != STATE && value->role != COPY) refuse("updates what is no state and no copy");
        }
        for (uint32_t j = 0; j < plan->reads.count; j++)
            if (bundle.values[plan->reads.at[j]].role == OUTPUT) refuse("reads an output");
        for (uint32_t j = 0; j < plan->outputs.count; j++)
            if (bundle.values[plan->outputs.at[j]].role != OUTPUT) refuse("outputs what is no output");
        for (uint32_t j = 0; j < plan->needs.count; j++) {
            const Plan *other = bundle.plans + plan->needs.at[j];
            if (other->purpose != GIVES && other->purpose != ENTER) refuse("needs a plan that updates something");
            for (uint32_t n = 0; n < other->needs.count; n++) {
                uint32_t before = 0;
                while (before < j && plan->needs.at[before] != other->needs.at[n]) before++;
                if (before == j) refuse("needs a plan without what that needs");
            }
            if (j && plan->needs.at[j] <= plan->needs.at[j - 1]) refuse("needs must rise");
        }
        find_purpose(k);
        const Node *stages = open_list(node, "stages", MAX_LIST);
        plan->stages = make(plan->stage_count = stages->count, sizeof(Stage));
        for EACH(s, stages) read_stage(stages->is.items + s, plan->stages + s, plan);
        pop();
    }
    pop();
}

/* ---- The flow of data ---- */

static bool attaches(const Plan *plan, uint32_t ref) {
    for (uint32_t s = 0; s < plan->stage_count; s++)
        if (has(plan->stages[s].attachments, ref)) return true;
    return false;
}

/* By ref: the last stage that attached or sampled it, stages numbered through all plans from 1, and how many plans attach it. */
static uint32_t *wrote, *sampled, *plans_of;

static void check_sample(const Plan *plan, uint32_t ref, uint32_t first) {
    const Image *image = bundle.images + ref / 2;
    if (!(ref & 1) && image->data >= 0) return;
    bool back = plan->purpose == LEAVE && image->value >= 0 && has(plan->updates, image->value);
    if (!(ref & 1) && !back && image->value >= 0 && bundle.values[image->value].role != OUTPUT) {
        if (!has(plan->reads, image->value)) refuse("reads '%s', which reads lacks", bundle.values[image->value].name);
        return;
    }
    if (wrote[ref] >= first) return;
    for (uint32_t k = 0; k < plan->needs.count; k++)
        if (attaches(bundle.plans + plan->needs.at[k], ref)) {
            if (plans_of[ref] > 1) refuse("reads image %u, which two plans write", ref / 2);
            return;
        }
    refuse("reads image %u, which nothing has written", ref / 2);
}

static void check_stage(const Plan *plan, const Stage *stage, uint32_t now, uint32_t first, uint32_t *waited) {
    bool hazard = now == first;
    for (uint32_t a = 0; a < stage->attachments.count; a++) {
        uint32_t ref = stage->attachments.at[a];
        const Image *image = bundle.images + ref / 2;
        if (image->value >= 0 && !has((ref & 1) != (plan->purpose == LEAVE) ? plan->updates : plan->outputs, image->value))
            refuse("attachments[%u] is not for this plan", a);
        hazard |= wrote[ref] >= *waited || sampled[ref] >= *waited;
    }
    for (uint32_t s = 0; s < bundle.passes[stage->pass].subpass_count; s++)
        for (uint32_t d = 0; d < stage->subpasses[s].count; d++) {
            const Draw *draw = stage->subpasses[s].draws + d;
            for (uint32_t b = 0; b < draw->images.count; b++)
                if (bundle.pipelines[draw->pipeline].bindings[b].kind != 10) {
                    check_sample(plan, draw->images.at[b], first);
                    hazard |= wrote[draw->images.at[b]] >= *waited;
                }
            if (draw->count >= 0) {
                check_sample(plan, draw->count, first);
                hazard |= wrote[draw->count] >= *waited;
            }
        }
    if (hazard && !stage->wait) refuse("wait is false");
    if (stage->wait) *waited = now;
    for (uint32_t a = 0; a < stage->attachments.count; a++) wrote[stage->attachments.at[a]] = now;
    for (uint32_t s = 0; s < bundle.passes[stage->pass].subpass_count; s++)
        for (uint32_t d = 0; d < stage->subpasses[s].count; d++) {
            Indices images = stage->subpasses[s].draws[d].images;
            for (uint32_t b = 0; b < images.count; b++) sampled[images.at[b]] = now;
            if (stage->subpasses[s].draws[d].count >= 0) sampled[stage->subpasses[s].draws[d].count] = now;
        }
}

static void check_flow(void) {
    wrote = make(2 * bundle.image_count, sizeof *wrote);
    sampled = make(2 * bundle.image_count, sizeof *sampled);
    plans_of = make(2 * bundle.image_count, sizeof *plans_of);
    uint32_t *last = make(2 * bundle.image_count, sizeof *last), now = 0;
    for (uint32_t k = 0; k < bundle.plan_count; k++)
        for (uint32_t s = 0; s < bundle.plans[k].stage_count; s++)
            for (uint32_t a = 0; a < bundle.plans[k].stages[s].attachments.count; a++) {
                uint32_t ref = bundle.plans[k].stages[s].attachments.at[a];
                plans_of[ref] += last[ref] != k + 1;
                last[ref] = k + 1;
            }
    push("plans", 0);
    for (uint32_t k = 0; k < bundle.plan_count; k++) {
        const Plan *plan = bundle.plans + k;
        uint32_t first = now + 1, waited = first;
        AT(k);
        push("stages", 0);
        for (uint32_t s = 0; s < plan->stage_count; s++) {
            AT(s);
            check_stage(plan, plan->stages + s, ++now, first, &waited);
        }
        pop();
        for (uint32_t j = 0; j < plan->updates.count; j++)
            if (!attaches(plan, 2 * bundle.values[plan->updates.at[j]].image + (plan->purpose != LEAVE))) refuse("does not write a state that it updates");
        for (uint32_t j = 0; j < plan->outputs.count; j++)
            if (!attaches(plan, 2 * bundle.values[plan->outputs.at[j]].image)) refuse("does not write an output that it lists");
    }
    pop();
    free(wrote), free(sampled), free(plans_of), free(last);
}

#define VARIANT_KEYS "meta profile needs depth_formats images samplers shaders passes pipelines values plans"

static void read_variant(void) {
    push("meta", -1);
    if (field(bundle.root, "meta")->kind != MAP) refuse("is no map");
    check_meta(field(bundle.root, "meta"), 1);
    pop();
    push("profile", -1);
    keys(field(bundle.root, "profile"), "name digest");
    bundle.profile = word(field(bundle.root, "profile"), "name");
    word(field(bundle.root, "profile"), "digest");
    pop();
    push("needs", -1);
    read_needs();
    pop();
    const Node *depth = open_list(bundle.root, "depth_formats", MAX_LIST);
    for EACH(k, depth) ONE_OF(depth->is.items + k, 125, 126);
    pop();
    read_images();
    bundle.samplers = indices(bundle.root, "samplers", MAX_LIST, 3);
    for (uint32_t k = 0; k < bundle.samplers.count; k++) if (bundle.samplers.at[k] == 1) refuse("samplers[%u] is 1", k);
    bundle.shaders = indices(bundle.root, "shaders", MAX_LIST, blob_count);
    uint32_t *models = make(bundle.shaders.count, sizeof *models);
    push("shaders", 0);
    for (uint32_t k = 0; k < bundle.shaders.count; k++) {
        AT(k);
        const Blob *blob = blobs + bundle.shaders.at[k];
        models[k] = check_shader(blob->data, blob->size);
    }
    pop();
    read_passes();
    read_pipelines(models);
    read_values();
    read_plans();
    check_flow();
    free(models);
}

static bool equal(const Node *a, const Node *b) {
    if (a->kind != b->kind || a->count != b->count) return false;
    if (a->kind == STRING || a->kind == BINARY) return !memcmp(a->is.bytes, b->is.bytes, a->count);
    if (a->kind != ARRAY) return a->kind == NIL || a->is.integer == b->is.integer;
    for (uint32_t k = 0; k < a->count; k++)
        if (!equal(a->is.items + k, b->is.items + k)) return false;
    return true;
}

/* What a user sees of a list is that of the first variant. */
static void check_alike(const char *key, const char *const *names, int count) {
    const Node *mine = field(bundle.root, key), *first = field(variants[0].root, key);
    push(key, -1);
    if (mine->count != first->count) refuse("has %u items; the first variant has %u", mine->count, first->count);
    for EACH(k, mine)
        for (int n = 0; n < count; n++)
            if (!equal(field(mine->is.items + k, names[n]), field(first->is.items + k, names[n])))
                refuse("%s differs from that of the first variant", names[n]);
    pop();
}

/* What only version 3 has: images of 16 bits a channel, copies. */
static bool has_more(void) {
    for (uint32_t k = 0; k < bundle.image_count; k++) if (is_half(bundle.images[k].format)) return true;
    for (uint32_t k = 0; k < bundle.value_count; k++) if (bundle.values[k].role == COPY) return true;
    return false;
}

static void read_bundle(const char *name) {
    static const char *const seen_of_values[] = {"name", "role", "type", "layout", "width", "height", "count", "columns", "initial"};
    static const char *const seen_of_plans[] = {"name", "updates", "outputs", "steps"};
    file = load_file(name, &file_size);
    if (file_size < 56 || memcmp(file, "DRESSI\r\n", 8)) refuse("is no bundle");
    uint64_t version = little(file + 8, 4), size = little(file + 16, 8);
    if (version < 1 || version > 3) refuse("format version %llu", (unsigned long long)version);
    if (little(file + 12, 4)) refuse("the reserved field is not 0");
    if (size > MAX_DESCRIPTION || size > file_size - 56) refuse("the description lies beyond the end of the file, or is too large");
    check_digest(file + 56, size, file + 24, "the description");
    static Node root;
    root = read_description(file + 56, size);
    bool several = version == 2, more = false;
    for (uint32_t k = 0; version == 3 && root.kind == MAP && k < root.count; k++) several |= same(root.is.items + 2 * k, "variants");
    keys(&root, several ? "variants blobs" : VARIANT_KEYS " blobs");
    read_blobs(&root, 56 + size);
    if (!several) {
        bundle.root = &root;
        read_variant();
        variants[variant_count++] = bundle;
        if (has_more() != (version == 3)) refuse("format version %llu is not that of what it holds", (unsigned long long)version);
        return;
    }
    const Node *list = open_list(&root, "variants", MAX_VARIANTS);
    if (list->count < 2) refuse("has %u items; at least 2 are needed", list->count);
    for EACH(k, list) {
        bundle = (Variant){.root = list->is.items + k};
        keys(bundle.root, VARIANT_KEYS);
        read_variant();
        for (uint32_t j = 0; j < k; j++)
            if (!strcmp(variants[j].profile, bundle.profile)) refuse("profile.name '%s' is taken", bundle.profile);
        variants[variant_count++] = bundle;
        more |= has_more();
        check_alike("values", seen_of_values, sizeof seen_of_values / sizeof *seen_of_values);
        check_alike("plans", seen_of_plans, sizeof seen_of_plans / sizeof *seen_of_plans);
    }
    pop();
    if (more != (version == 3)) refuse("format version %llu is not that of what it holds", (unsigned long long)version);
}

/* ---- Vulkan: a device that offers what is needed ---- */

#define TYPE(name) .sType = VK_STRUCTURE_TYPE_##name

static struct {
    VkInstance instance;
    VkPhysicalDevice physical;
    VkDevice device;
    VkQueue queue;
    VkCommandPool pool;
    VkFormat depth;
    uint32_t family;
    VkPhysicalDeviceMemoryProperties memory;
    VkDeviceMemory blocks[VK_MAX_MEMORY_TYPES];
    VkSampler *samplers;
    VkShaderModule *shaders;
} gpu;

static void must(VkResult result, const char *what) {
    if (result != VK_SUCCESS) die("%s: VkResult %d", what, result);
}
#define MUST(call) must(call, #call)

static VkFormatFeatureFlags features(VkFormat format) {
    VkFormatProperties properties;
    vkGetPhysicalDeviceFormatProperties(gpu.physical, format, &properties);
    return properties.optimalTilingFeatures;
}

/* Whether the device offers what the variant in `bundle` says that it needs; if not, says what is missing. */
static bool fits(void) {
    VkPhysicalDeviceProperties properties;
    vkGetPhysicalDeviceProperties(gpu.physical, &properties);
    const Node *needs = field(bundle.root, "needs"), *limits = field(needs, "limits"), *formats = field(needs, "formats");
    bool fit = true;
    for (uint32_t k = 0; k < LIMIT_COUNT; k++) {
        uint32_t offered;
        memcpy(&offered, (char *)&properties.limits + LIMITS[k].offset, sizeof offered);
        for (uint32_t j = 0; j < limits->count; j++) {
            int64_t needed = limits->is.items[2 * j + 1].is.integer;
            if (!same(limits->is.items + 2 * j, LIMITS[k].name) || needed <= offered) continue;
            fprintf(stderr, "%s: %s is %u; %lld is needed\n", bundle.profile, LIMITS[k].name, offered, (long long)needed);
            fit = false;
        }
    }
    for (uint32_t k = 0; k < FORMAT_COUNT; k++)
        for (uint32_t j = 0; j < formats->count; j++)
            for (uint32_t f = 0; same(formats->is.items + 2 * j, FORMAT_NAMES[k]) && f < formats->is.items[2 * j + 1].count; f++)
                for (int bit = 0; bit < 3; bit++)
                    if (same(formats->is.items[2 * j + 1].is.items + f, FEATURES[bit]) &&
                        !(features(FORMAT_NUMBERS[k]) & FEATURE_BITS[bit])) {
                        fprintf(stderr, "%s: %s is not offered as %s\n", bundle.profile, FORMAT_NAMES[k], FEATURES[bit]);
                        fit = false;
                    }
    bool wanted = false;
    for (uint32_t k = 0; k < bundle.image_count; k++) wanted |= !bundle.images[k].format;
    const Node *depth = field(bundle.root, "depth_formats");
    gpu.depth = VK_FORMAT_UNDEFINED;
    for (uint32_t k = depth->count; k--;) {
        VkFormat format = depth->is.items[k].is.integer;
        if (features(format) & VK_FORMAT_FEATURE_DEPTH_STENCIL_ATTACHMENT_BIT) gpu.depth = format;
    }
    if (wanted && !gpu.depth) fprintf(stderr, "%s: none of its depth formats is offered\n", bundle.profile);
    return fit && (!wanted || gpu.depth);
}

/* The first that fits, or that of the profile in DRESSI_PROFILE. */
static void choose_variant(void) {
    const char *profile = getenv("DRESSI_PROFILE");
    for (uint32_t k = 0; k < variant_count; k++) {
        bundle = variants[k];
        if ((!profile || !strcmp(profile, bundle.profile)) && fits()) {
            printf("profile: %s\n", bundle.profile);
            return;
        }
    }
    die("no variant of the bundle fits the device%s%s", profile ? " and is for " : "", profile ? profile : "");
}

static void open_device(void) {
    VkApplicationInfo about = {TYPE(APPLICATION_INFO), .apiVersion = VK_API_VERSION_1_0};
    VkInstanceCreateInfo instance = {TYPE(INSTANCE_CREATE_INFO), .pApplicationInfo = &about};
    MUST(vkCreateInstance(&instance, NULL, &gpu.instance));
    uint32_t count = 16, queues = 16;
    VkPhysicalDevice devices[16];
    VkResult result = vkEnumeratePhysicalDevices(gpu.instance, &count, devices);
    if (result != VK_INCOMPLETE) must(result, "vkEnumeratePhysicalDevices");
    const char *name = getenv("DRESSI_DEVICE");
    for (uint32_t k = 0; k < count && !gpu.physical; k++) {
        VkPhysicalDeviceProperties properties;
        VkQueueFamilyProperties families[16];
        vkGetPhysicalDeviceProperties(devices[k], &properties);
        queues = 16;
        vkGetPhysicalDeviceQueueFamilyProperties(devices[k], &queues, families);
        for (gpu.family = 0; gpu.family < queues && !(families[gpu.family].queueFlags & VK_QUEUE_GRAPHICS_BIT);) gpu.family++;
        if (gpu.family < queues && (!name || strstr(properties.deviceName, name))) gpu.physical = devices[k];
    }
    if (!gpu.physical) die("no Vulkan device with graphics%s%s", name ? " of the name " : "", name ? name : "");
    choose_variant();
    vkGetPhysicalDeviceMemoryProperties(gpu.physical, &gpu.memory);
    VkDeviceQueueCreateInfo queue = {TYPE(DEVICE_QUEUE_CREATE_INFO), .queueFamilyIndex = gpu.family, .queueCount = 1,
                                     .pQueuePriorities = (float[]){1}};
    VkDeviceCreateInfo info = {TYPE(DEVICE_CREATE_INFO), .queueCreateInfoCount = 1, .pQueueCreateInfos = &queue};
    MUST(vkCreateDevice(gpu.physical, &info, NULL, &gpu.device));
    vkGetDeviceQueue(gpu.device, gpu.family, 0, &gpu.queue);
    VkCommandPoolCreateInfo pool = {TYPE(COMMAND_POOL_CREATE_INFO), .queueFamilyIndex = gpu.family};
    MUST(vkCreateCommandPool(gpu.device, &pool, NULL, &gpu.pool));
}

static uint32_t memory_type(uint32_t allowed, VkMemoryPropertyFlags wanted) {
    for (int tries = 0; tries < 2; tries++, wanted &= ~VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT)
        for (uint32_t k = 0; k < gpu.memory.memoryTypeCount; k++)
            if (allowed >> k & 1 && (gpu.memory.memoryTypes[k].propertyFlags & wanted) == wanted) return k;
    die("no memory type of the kind needed");
}

static VkDeviceMemory allocate(uint64_t size, uint32_t type) {
    VkDeviceMemory memory;
    VkMemoryAllocateInfo info = {TYPE(MEMORY_ALLOCATE_INFO), .allocationSize = size, .memoryTypeIndex = type};
    MUST(vkAllocateMemory(gpu.device, &info, NULL, &memory));
    return memory;
}

/* ---- Vulkan: one-off commands, transfers, and the one barrier ---- */

static void barrier(VkCommandBuffer commands) {
    VkPipelineStageFlags stages = VK_PIPELINE_STAGE_VERTEX_SHADER_BIT | VK_PIPELINE_STAGE_FRAGMENT_SHADER_BIT |
        VK_PIPELINE_STAGE_EARLY_FRAGMENT_TESTS_BIT | VK_PIPELINE_STAGE_LATE_FRAGMENT_TESTS_BIT |
        VK_PIPELINE_STAGE_COLOR_ATTACHMENT_OUTPUT_BIT | VK_PIPELINE_STAGE_TRANSFER_BIT;
    VkAccessFlags writes = VK_ACCESS_COLOR_ATTACHMENT_WRITE_BIT | VK_ACCESS_DEPTH_STENCIL_ATTACHMENT_WRITE_BIT |
        VK_ACCESS_TRANSFER_WRITE_BIT;
    VkMemoryBarrier all = {TYPE(MEMORY_BARRIER), .srcAccessMask = writes, .dstAccessMask = writes |
        VK_ACCESS_SHADER_READ_BIT | VK_ACCESS_INPUT_ATTACHMENT_READ_BIT | VK_ACCESS_COLOR_ATTACHMENT_READ_BIT |
        VK_ACCESS_DEPTH_STENCIL_ATTACHMENT_READ_BIT | VK_ACCESS_TRANSFER_READ_BIT};
    vkCmdPipelineBarrier(commands, stages, stages, 0, 1, &all, 0, NULL, 0, NULL);
}

static VkCommandBuffer begin(void) {
    VkCommandBuffer commands;
    VkCommandBufferAllocateInfo info = {TYPE(COMMAND_BUFFER_ALLOCATE_INFO), .commandPool = gpu.pool, .commandBufferCount = 1};
    MUST(vkAllocateCommandBuffers(gpu.device, &info, &commands));
    MUST(vkBeginCommandBuffer(commands, &(VkCommandBufferBeginInfo){TYPE(COMMAND_BUFFER_BEGIN_INFO)}));
    return commands;
}

static void submit(VkCommandBuffer commands) {
    VkSubmitInfo info = {TYPE(SUBMIT_INFO), .commandBufferCount = 1, .pCommandBuffers = &commands};
    MUST(vkQueueSubmit(gpu.queue, 1, &info, VK_NULL_HANDLE));
    MUST(vkQueueWaitIdle(gpu.queue));
}

static void end(VkCommandBuffer commands) {
    MUST(vkEndCommandBuffer(commands));
    submit(commands);
    vkFreeCommandBuffers(gpu.device, gpu.pool, 1, &commands);
}

/* Texels of the whole image, to the device or from it. */
static void transfer(const Image *image, uint32_t slot, void *texels, bool to_device) {
    VkBuffer buffer;
    VkMemoryRequirements needs;
    void *mapped;
    VkBufferCreateInfo info = {TYPE(BUFFER_CREATE_INFO), .size = image_bytes(image),
                               .usage = to_device ? VK_BUFFER_USAGE_TRANSFER_SRC_BIT : VK_BUFFER_USAGE_TRANSFER_DST_BIT};
    MUST(vkCreateBuffer(gpu.device, &info, NULL, &buffer));
    vkGetBufferMemoryRequirements(gpu.device, buffer, &needs);
    VkDeviceMemory memory = allocate(needs.size, memory_type(needs.memoryTypeBits,
        VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT | VK_MEMORY_PROPERTY_HOST_COHERENT_BIT));
    MUST(vkBindBufferMemory(gpu.device, buffer, memory, 0));
    MUST(vkMapMemory(gpu.device, memory, 0, VK_WHOLE_SIZE, 0, &mapped));
    VkBufferImageCopy region = {.imageSubresource = {VK_IMAGE_ASPECT_COLOR_BIT, 0, 0, 1}, .imageExtent = {image->width, image->height, 1}};
    VkCommandBuffer commands = begin();
    barrier(commands);
    if (to_device) {
        memcpy(mapped, texels, image_bytes(image));
        vkCmdCopyBufferToImage(commands, buffer, image->handle[slot], VK_IMAGE_LAYOUT_GENERAL, 1, &region);
    } else {
        vkCmdCopyImageToBuffer(commands, image->handle[slot], VK_IMAGE_LAYOUT_GENERAL, buffer, 1, &region);
        VkMemoryBarrier host = {TYPE(MEMORY_BARRIER), .srcAccessMask = VK_ACCESS_TRANSFER_WRITE_BIT,
                                .dstAccessMask = VK_ACCESS_HOST_READ_BIT};
        vkCmdPipelineBarrier(commands, VK_PIPELINE_STAGE_TRANSFER_BIT, VK_PIPELINE_STAGE_HOST_BIT, 0, 1, &host, 0, NULL, 0, NULL);
    }
    barrier(commands);
    end(commands);
    if (!to_device) memcpy(texels, mapped, image_bytes(image));
    vkDestroyBuffer(gpu.device, buffer, NULL);
    vkFreeMemory(gpu.device, memory, NULL);
}

/* ---- Vulkan: the objects of the bundle ---- */

static VkFormat vulkan_format(uint32_t format) { return format ? (VkFormat)format : gpu.depth; }

static void create_images(void) {
    uint64_t sizes[VK_MAX_MEMORY_TYPES] = {0};
    struct { uint32_t type; uint64_t offset; } *places = make(2 * bundle.image_count, sizeof *places);
    VkCommandBuffer commands = begin();
    for (uint32_t k = 0; k < 2 * bundle.image_count; k++) {
        Image *image = bundle.images + k / 2;
        if (k % 2 >= image->slots) continue;
        VkImageCreateInfo info = {TYPE(IMAGE_CREATE_INFO), .imageType = VK_IMAGE_TYPE_2D,
            .format = vulkan_format(image->format), .extent = {image->width, image->height, 1}, .mipLevels = 1, .arrayLayers = 1,
            .samples = VK_SAMPLE_COUNT_1_BIT,
            .usage = image->usage | (image->format ? VK_IMAGE_USAGE_TRANSFER_DST_BIT : 0)};
        VkMemoryRequirements needs;
        MUST(vkCreateImage(gpu.device, &info, NULL, &image->handle[k % 2]));
        vkGetImageMemoryRequirements(gpu.device, image->handle[k % 2], &needs);
        places[k].type = memory_type(needs.memoryTypeBits, VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT);
        places[k].offset = divided(sizes[places[k].type], needs.alignment) * needs.alignment;
        sizes[places[k].type] = places[k].offset + needs.size;
    }
    for (uint32_t k = 0; k < gpu.memory.memoryTypeCount; k++) {
        uint64_t heap = gpu.memory.memoryHeaps[gpu.memory.memoryTypes[k].heapIndex].size;
        if (sizes[k] > heap) die("the images need %.1f MB; the device has %.1f MB", sizes[k] / 1e6, heap / 1e6);
        if (sizes[k]) gpu.blocks[k] = allocate(sizes[k], k);
    }
    for (uint32_t k = 0; k < 2 * bundle.image_count; k++) {
        Image *image = bundle.images + k / 2;
        VkImage handle = image->handle[k % 2];
        if (k % 2 >= image->slots) continue;
        MUST(vkBindImageMemory(gpu.device, handle, gpu.blocks[places[k].type], places[k].offset));
        VkImageSubresourceRange whole = {image->format ? VK_IMAGE_ASPECT_COLOR_BIT : VK_IMAGE_ASPECT_DEPTH_BIT, 0, 1, 0, 1};
        VkImageViewCreateInfo view = {TYPE(IMAGE_VIEW_CREATE_INFO), .image = handle, .viewType = VK_IMAGE_VIEW_TYPE_2D,
                                      .format = vulkan_format(image->format), .subresourceRange = whole};
        if (image->usage & ~3u) MUST(vkCreateImageView(gpu.device, &view, NULL, &image->view[k % 2]));
        VkImageMemoryBarrier first = {TYPE(IMAGE_MEMORY_BARRIER), .newLayout = VK_IMAGE_LAYOUT_GENERAL,
            .dstAccessMask = VK_ACCESS_TRANSFER_WRITE_BIT, .srcQueueFamilyIndex = VK_QUEUE_FAMILY_IGNORED,
            .dstQueueFamilyIndex = VK_QUEUE_FAMILY_IGNORED, .image = handle, .subresourceRange = whole};
        vkCmdPipelineBarrier(commands, VK_PIPELINE_STAGE_TOP_OF_PIPE_BIT, VK_PIPELINE_STAGE_TRANSFER_BIT, 0, 0, NULL, 0, NULL, 1, &first);
        if (image->format) vkCmdClearColorImage(commands, handle, VK_IMAGE_LAYOUT_GENERAL, &(VkClearColorValue){{0}}, 1, &whole);
    }
    barrier(commands);
    end(commands);
    free(places);
    for (uint32_t k = 0; k < bundle.image_count; k++) {
        const Image *image = bundle.images + k;
        int blob = image->data >= 0 ? image->data : image->value >= 0 ? bundle.values[image->value].initial : -1;
        if (blob >= 0) transfer(image, 0, (void *)blobs[blob].data, true);
    }
}

static void create_pass(Pass *pass) {
    uint32_t n = pass->attachment_count;
    VkAttachmentDescription *attachments = make(n, sizeof *attachments);
    VkSubpassDescription *subpasses = make(pass->subpass_count, sizeof *subpasses);
    VkSubpassDependency *dependencies = make(pass->subpass_count, sizeof *dependencies);
    for (uint32_t k = 0; k < n; k++)
        attachments[k] = (VkAttachmentDescription){.format = vulkan_format(pass->attachments[k].format), .samples = VK_SAMPLE_COUNT_1_BIT,
            .loadOp = (VkAttachmentLoadOp)pass->attachments[k].load, .storeOp = (VkAttachmentStoreOp)pass->attachments[k].store,
            .stencilLoadOp = VK_ATTACHMENT_LOAD_OP_DONT_CARE, .stencilStoreOp = VK_ATTACHMENT_STORE_OP_DONT_CARE,
            .initialLayout = VK_IMAGE_LAYOUT_GENERAL, .finalLayout = VK_IMAGE_LAYOUT_GENERAL};
    for (uint32_t k = 0; k < pass->subpass_count; k++) {
        const Subpass *subpass = pass->subpasses + k;
        VkAttachmentReference *refs = make(subpass->colors.count + subpass->inputs.count + 1, sizeof *refs), *next = refs;
        VkSubpassDescription *made = subpasses + k;
        uint32_t *kept = make(n, sizeof *kept);
        *made = (VkSubpassDescription){.pColorAttachments = refs, .colorAttachmentCount = subpass->colors.count,
            .pInputAttachments = refs + subpass->colors.count, .inputAttachmentCount = subpass->inputs.count};
        for (uint32_t c = 0; c < subpass->colors.count; c++)
            *next++ = (VkAttachmentReference){subpass->colors.at[c], VK_IMAGE_LAYOUT_GENERAL};
        for (uint32_t i = 0; i < subpass->inputs.count; i++)
            *next++ = (VkAttachmentReference){subpass->inputs.at[i], VK_IMAGE_LAYOUT_GENERAL};
        *next = (VkAttachmentReference){subpass->depth, VK_IMAGE_LAYOUT_GENERAL};
        if (subpass->depth >= 0) made->pDepthStencilAttachment = next;
        for (uint32_t a = 0; a < n; a++)
            if (!has(subpass->colors, a) && !has(subpass->inputs, a) && (int)a != subpass->depth) kept[made->preserveAttachmentCount++] = a;
        made->pPreserveAttachments = kept;
        if (k) dependencies[k - 1] = (VkSubpassDependency){k - 1, k, VK_PIPELINE_STAGE_COLOR_ATTACHMENT_OUTPUT_BIT,
            VK_PIPELINE_STAGE_COLOR_ATTACHMENT_OUTPUT_BIT | VK_PIPELINE_STAGE_FRAGMENT_SHADER_BIT, VK_ACCESS_COLOR_ATTACHMENT_WRITE_BIT,
            VK_ACCESS_INPUT_ATTACHMENT_READ_BIT | VK_ACCESS_COLOR_ATTACHMENT_WRITE_BIT, VK_DEPENDENCY_BY_REGION_BIT};
    }
    VkRenderPassCreateInfo info = {TYPE(RENDER_PASS_CREATE_INFO), .attachmentCount = n, .pAttachments = attachments,
        .subpassCount = pass->subpass_count, .pSubpasses = subpasses,
        .dependencyCount = pass->subpass_count - 1, .pDependencies = dependencies};
    MUST(vkCreateRenderPass(gpu.device, &info, NULL, &pass->handle));
}

static void create_pipeline(Pipeline *pipeline) {
    uint32_t n = pipeline->binding_count, colors = bundle.passes[pipeline->pass].subpasses[pipeline->subpass].colors.count;
    VkDescriptorSetLayoutBinding *bindings = make(n, sizeof *bindings);
    for (uint32_t k = 0; k < n; k++) {
        const Binding *binding = pipeline->bindings + k;
        bindings[k] = (VkDescriptorSetLayoutBinding){k, (VkDescriptorType)binding->kind, 1, binding->stages, NULL};
    }
    VkDescriptorSetLayoutCreateInfo set = {TYPE(DESCRIPTOR_SET_LAYOUT_CREATE_INFO), .bindingCount = n, .pBindings = bindings};
    MUST(vkCreateDescriptorSetLayout(gpu.device, &set, NULL, &pipeline->set_layout));
    VkPipelineLayoutCreateInfo layout = {TYPE(PIPELINE_LAYOUT_CREATE_INFO), .setLayoutCount = 1, .pSetLayouts = &pipeline->set_layout};
    MUST(vkCreatePipelineLayout(gpu.device, &layout, NULL, &pipeline->layout));
    VkPipelineShaderStageCreateInfo stages[2];
    for (int k = 0; k < 2; k++)
        stages[k] = (VkPipelineShaderStageCreateInfo){TYPE(PIPELINE_SHADER_STAGE_CREATE_INFO), .pName = "main",
            .stage = k ? VK_SHADER_STAGE_FRAGMENT_BIT : VK_SHADER_STAGE_VERTEX_BIT,
            .module = gpu.shaders[k ? pipeline->fragment : pipeline->vertex]};
    VkPipelineVertexInputStateCreateInfo vertices = {TYPE(PIPELINE_VERTEX_INPUT_STATE_CREATE_INFO)};
    VkPipelineInputAssemblyStateCreateInfo assembly = {TYPE(PIPELINE_INPUT_ASSEMBLY_STATE_CREATE_INFO),
                                                       .topology = (VkPrimitiveTopology)pipeline->topology};
    VkPipelineViewportStateCreateInfo viewport = {TYPE(PIPELINE_VIEWPORT_STATE_CREATE_INFO), .viewportCount = 1, .scissorCount = 1};
    VkPipelineRasterizationStateCreateInfo raster = {TYPE(PIPELINE_RASTERIZATION_STATE_CREATE_INFO), .lineWidth = 1};
    VkPipelineMultisampleStateCreateInfo samples = {TYPE(PIPELINE_MULTISAMPLE_STATE_CREATE_INFO),
                                                    .rasterizationSamples = VK_SAMPLE_COUNT_1_BIT};
    VkPipelineDepthStencilStateCreateInfo depth = {TYPE(PIPELINE_DEPTH_STENCIL_STATE_CREATE_INFO),
        .depthTestEnable = pipeline->depth, .depthWriteEnable = pipeline->depth, .depthCompareOp = VK_COMPARE_OP_LESS};
    VkPipelineColorBlendAttachmentState *masks = make(colors, sizeof *masks);
    for (uint32_t k = 0; k < colors; k++) masks[k].colorWriteMask = 15;
    VkPipelineColorBlendStateCreateInfo blend = {TYPE(PIPELINE_COLOR_BLEND_STATE_CREATE_INFO), .attachmentCount = colors,
                                                 .pAttachments = masks};
    VkPipelineDynamicStateCreateInfo dynamic = {TYPE(PIPELINE_DYNAMIC_STATE_CREATE_INFO), .dynamicStateCount = 2,
        .pDynamicStates = (VkDynamicState[]){VK_DYNAMIC_STATE_VIEWPORT, VK_DYNAMIC_STATE_SCISSOR}};
    VkGraphicsPipelineCreateInfo info = {TYPE(GRAPHICS_PIPELINE_CREATE_INFO), .stageCount = 2, .pStages = stages,
        .pVertexInputState = &vertices, .pInputAssemblyState = &assembly, .pViewportState = &viewport, .pRasterizationState = &raster,
        .pMultisampleState = &samples, .pDepthStencilState = &depth, .pColorBlendState = &blend, .pDynamicState = &dynamic,
        .layout = pipeline->layout, .renderPass = bundle.passes[pipeline->pass].handle, .subpass = pipeline->subpass};
    MUST(vkCreateGraphicsPipelines(gpu.device, VK_NULL_HANDLE, 1, &info, NULL, &pipeline->handle));
    free(bindings);
    free(masks);
}

static void create_objects(void) {
    create_images();
    gpu.samplers = make(bundle.samplers.count, sizeof *gpu.samplers);
    for (uint32_t k = 0; k < bundle.samplers.count; k++) {
        VkSamplerAddressMode mode = (VkSamplerAddressMode)bundle.samplers.at[k];
        VkSamplerCreateInfo info = {TYPE(SAMPLER_CREATE_INFO), .magFilter = VK_FILTER_LINEAR, .minFilter = VK_FILTER_LINEAR,
                                    .addressModeU = mode, .addressModeV = mode, .addressModeW = mode};
        MUST(vkCreateSampler(gpu.device, &info, NULL, gpu.samplers + k));
    }
    gpu.shaders = make(bundle.shaders.count, sizeof *gpu.shaders);
    for (uint32_t k = 0; k < bundle.shaders.count; k++) {
        const Blob *blob = blobs + bundle.shaders.at[k];
        VkShaderModuleCreateInfo info = {TYPE(SHADER_MODULE_CREATE_INFO), .codeSize = blob->size, .pCode = (const uint32_t *)blob->data};
        MUST(vkCreateShaderModule(gpu.device, &info, NULL, gpu.shaders + k));
    }
    for (uint32_t k = 0; k < bundle.pass_count; k++) create_pass(bundle.passes + k);
    for (uint32_t k = 0; k < bundle.pipeline_count; k++) create_pipeline(bundle.pipelines + k);
}

/* ---- Recording a plan ---- */

static VkImageView view_of(uint32_t ref) {
    const Image *image = bundle.images + ref / 2;
    return image->view[image->slots == 2 ? (ref & 1) ^ image->parity : 0];
}

static VkDescriptorPool create_sets(const Plan *plan) {
    VkDescriptorPoolSize sizes[] = {{VK_DESCRIPTOR_TYPE_COMBINED_IMAGE_SAMPLER, 1}, {VK_DESCRIPTOR_TYPE_SAMPLED_IMAGE, 1},
                                    {VK_DESCRIPTOR_TYPE_INPUT_ATTACHMENT, 1}};
    uint32_t sets = 1;
    for (uint32_t s = 0; s < plan->stage_count; s++)
        for (uint32_t p = 0; p < bundle.passes[plan->stages[s].pass].subpass_count; p++)
            for (uint32_t d = 0; d < plan->stages[s].subpasses[p].count; d++, sets++) {
                const Pipeline *pipeline = bundle.pipelines + plan->stages[s].subpasses[p].draws[d].pipeline;
                for (uint32_t b = 0; b < pipeline->binding_count; b++)
                    sizes[pipeline->bindings[b].kind == 1 ? 0 : pipeline->bindings[b].kind == 2 ? 1 : 2].descriptorCount++;
            }
    VkDescriptorPool pool;
    VkDescriptorPoolCreateInfo info = {TYPE(DESCRIPTOR_POOL_CREATE_INFO), .maxSets = sets, .poolSizeCount = 3, .pPoolSizes = sizes};
    MUST(vkCreateDescriptorPool(gpu.device, &info, NULL, &pool));
    return pool;
}

static void record_draw(VkCommandBuffer commands, VkDescriptorPool pool, const Draw *draw) {
    const Pipeline *pipeline = bundle.pipelines + draw->pipeline;
    vkCmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_GRAPHICS, pipeline->handle);
    if (pipeline->binding_count) {
        VkDescriptorSet set;
        VkDescriptorSetAllocateInfo info = {TYPE(DESCRIPTOR_SET_ALLOCATE_INFO), .descriptorPool = pool, .descriptorSetCount = 1,
                                            .pSetLayouts = &pipeline->set_layout};
        MUST(vkAllocateDescriptorSets(gpu.device, &info, &set));
        for (uint32_t b = 0; b < pipeline->binding_count; b++) {
            const Binding *binding = pipeline->bindings + b;
            VkSampler sampler = binding->kind == 1 ? gpu.samplers[binding->sampler] : VK_NULL_HANDLE;
            VkDescriptorImageInfo image = {sampler, view_of(draw->images.at[b]), VK_IMAGE_LAYOUT_GENERAL};
            VkWriteDescriptorSet write = {TYPE(WRITE_DESCRIPTOR_SET), .dstSet = set, .dstBinding = b, .descriptorCount = 1,
                                          .descriptorType = (VkDescriptorType)binding->kind, .pImageInfo = &image};
            vkUpdateDescriptorSets(gpu.device, 1, &write, 0, NULL);
        }
        vkCmdBindDescriptorSets(commands, VK_PIPELINE_BIND_POINT_GRAPHICS, pipeline->layout, 0, 1, &set, 0, NULL);
    }
    for (uint32_t v = 0; v < draw->cell_count; v++) {
        const int *cell = draw->cells[v];
        vkCmdSetViewport(commands, 0, 1, &(VkViewport){cell[0], cell[1], cell[2], cell[3], draw->near, draw->far});
        vkCmdSetScissor(commands, 0, 1, &(VkRect2D){{cell[0], cell[1]}, {cell[2], cell[3]}});
        vkCmdDraw(commands, draw->vertices, 1, 0, v);
    }
}

static VkFramebuffer record_stage(VkCommandBuffer commands, VkDescriptorPool pool, const Stage *stage) {
    const Pass *pass = bundle.passes + stage->pass;
    uint32_t n = pass->attachment_count;
    VkImageView *views = make(n, sizeof *views);
    VkClearValue *clears = make(n, sizeof *clears);
    for (uint32_t k = 0; k < n; k++) {
        const Attachment *attachment = pass->attachments + k;
        views[k] = view_of(stage->attachments.at[k]);
        if (!attachment->format) clears[k].depthStencil.depth = attachment->clear;
        else for (int c = 0; c < 4; c++) clears[k].color.int32[c] = attachment->clear;  /* of a float format 0, whose bits are 0 */
    }
    VkFramebuffer framebuffer;
    VkFramebufferCreateInfo info = {TYPE(FRAMEBUFFER_CREATE_INFO), .renderPass = pass->handle, .attachmentCount = n,
                                    .pAttachments = views, .width = stage->width, .height = stage->height, .layers = 1};
    MUST(vkCreateFramebuffer(gpu.device, &info, NULL, &framebuffer));
    if (stage->wait) barrier(commands);
    VkRenderPassBeginInfo start = {TYPE(RENDER_PASS_BEGIN_INFO), .renderPass = pass->handle, .framebuffer = framebuffer,
                                   .renderArea = {{0, 0}, {stage->width, stage->height}}, .clearValueCount = n, .pClearValues = clears};
    vkCmdBeginRenderPass(commands, &start, VK_SUBPASS_CONTENTS_INLINE);
    for (uint32_t s = 0; s < pass->subpass_count; s++) {
        if (s) vkCmdNextSubpass(commands, VK_SUBPASS_CONTENTS_INLINE);
        for (uint32_t d = 0; d < stage->subpasses[s].count; d++) record_draw(commands, pool, stage->subpasses[s].draws + d);
    }
    vkCmdEndRenderPass(commands);
    free(views);
    free(clears);
    return framebuffer;
}

/* The commands of a plan for the parities of now. Two serve a phase that runs on; more come where phases alternate. */
static VkCommandBuffer recording(Plan *plan) {
    uint8_t *parities = make(bundle.image_count, 1);
    for (uint32_t k = 0; k < bundle.image_count; k++) parities[k] = bundle.images[k].parity;
    for (Recording *r = plan->recordings; r; r = r->next)
        if (!memcmp(r->parities, parities, bundle.image_count)) {
            free(parities);
            return r->commands;
        }
    Recording *made = make(1, sizeof *made);
    *made = (Recording){parities, begin(), create_sets(plan), make(plan->stage_count, sizeof(VkFramebuffer)), plan->recordings};
    for (uint32_t s = 0; s < plan->stage_count; s++) made->framebuffers[s] = record_stage(made->commands, made->sets, plan->stages + s);
    MUST(vkEndCommandBuffer(made->commands));
    plan->recordings = made;
    return made->commands;
}

/* ---- Run, set, get ---- */

static uint64_t versions_of(Indices values) {
    uint64_t sum = 0;
    for (uint32_t k = 0; k < values.count; k++) sum += bundle.values[values.at[k]].version;
    return sum;
}

/* Versions only grow, so that their sum tells whether any has. */
static uint64_t versions(const Plan *plan) {
    uint64_t sum = versions_of(plan->reads);
    for (uint32_t k = 0; k < plan->needs.count; k++) sum += versions_of(bundle.plans[plan->needs.at[k]].reads);
    return sum;
}

static void check_inputs(const Plan *plan) {
    for (uint32_t k = 0; k < plan->reads.count; k++)
        if (!bundle.values[plan->reads.at[k]].has_value)
            die("%s reads %s, which has no value", plan->name, bundle.values[plan->reads.at[k]].name);
}

static void run_plan(Plan *plan, uint64_t count);

static void bring_up_to_date(Plan *plan) {
    if (!plan->has_run || plan->seen != versions(plan)) run_plan(plan, 1);
}

/* The states among these take what a phase has in newer copies. */
static void give_back(Indices values) {
    for (uint32_t k = 0; k + 1 < bundle.plan_count; k++) {
        Plan *enter = bundle.plans + k, *leave = enter + 1;
        for (uint32_t j = 0; j < values.count && enter->out; j++)
            if (has(leave->updates, values.at[j])) {
                submit(recording(leave));
                enter->out = false;
            }
    }
}

/* The phase has run: the states it has copies of have new values, and the copies are what filling them would make. */
static void take_out(const Plan *phase) {
    for (uint32_t k = 0; k + 1 < bundle.plan_count; k++) {
        Plan *enter = bundle.plans + k, *leave = enter + 1;
        if (enter->purpose != ENTER || !has(phase->updates, enter->updates.at[0])) continue;
        for (uint32_t j = 0; j < leave->updates.count; j++) bundle.values[leave->updates.at[j]].version++;
        enter->seen = versions(enter);
        enter->out = true;
    }
}

static void run_plan(Plan *plan, uint64_t count) {
    check_inputs(plan);
    for (uint32_t k = 0; k < plan->needs.count; k++) check_inputs(bundle.plans + plan->needs.at[k]);
    for (uint32_t k = 0; k < plan->needs.count && count; k++) bring_up_to_date(bundle.plans + plan->needs.at[k]);
    if (count) give_back(plan->reads), give_back(plan->updates);
    for (; count; count--) {
        submit(recording(plan));
        plan->has_run = true;
        plan->seen = versions(plan);
        for (uint32_t k = 0; k < plan->updates.count; k++) {
            Value *value = bundle.values + plan->updates.at[k];
            bundle.images[value->image].parity ^= 1;
            value->version++;
        }
        if (plan->purpose == PHASE) take_out(plan);
    }
}

static Value *find_value(const char *name) {
    for (uint32_t k = 0; k < bundle.value_count; k++)
        if (!strcmp(bundle.values[k].name, name) && bundle.values[k].role != COPY) return bundle.values + k;
    die("the bundle has no value %s", name);
}

static uint64_t entries(const Value *value) {
    uint64_t cell = (uint64_t)value->width * value->height;
    return value->layout == UNIT ? 1 : value->layout == TABLE ? value->count : value->layout == IMAGE ? cell : cell * value->count;
}

/* Where in the image, in texels in rows, entry e of the user's array lies. */
static uint64_t place(const Value *value, uint64_t e) {
    if (value->layout != ATLAS) return e;
    uint64_t cell = (uint64_t)value->width * value->height, v = e / cell, y = e % cell / value->width, x = e % value->width;
    return (v / value->columns * value->height + y) * value->width * value->columns + v % value->columns * value->width + x;
}

/* The bits of an fp32 number below 65520 as fp16, to nearest even; and back. */
static uint16_t to_half(uint32_t bits) {
    uint32_t sign = bits >> 16 & 0x8000, size = bits & 0x7fffffff;
    if (size < 0x38800000) {  /* below 2^-14: in steps of 2^-24 */
        float x;
        memcpy(&x, &size, 4);
        return sign | (uint32_t)lrintf(x * 16777216.0f);
    }
    return sign | (size + 0xfff + (size >> 13 & 1) - 0x38000000) >> 13;
}

static uint32_t from_half(uint16_t half) {
    uint32_t sign = (uint32_t)(half & 0x8000) << 16, exponent = half >> 10 & 31, bits;
    float x = (half & 1023) / 16777216.0f;
    memcpy(&bits, &x, 4);
    if (exponent) bits = (exponent == 31 ? 255 : exponent + 112) << 23 | (uint32_t)(half & 1023) << 13;
    return sign | bits;
}

/* Between the user's array, of four bytes a channel, and a whole image, of as many or two. */
static void arrange(const Value *value, uint32_t *array, void *texels, bool to_texels) {
    uint32_t stride = value->channels == 3 ? 4 : value->channels;
    bool half = is_half(bundle.images[value->image].format);
    for (uint64_t e = 0, n = entries(value); e < n; e++)
        for (uint32_t c = 0; c < value->channels; c++) {
            uint32_t *a = array + e * value->channels + c;
            uint64_t at = place(value, e) * stride + c;
            if (half && to_texels) ((uint16_t *)texels)[at] = to_half(*a);
            else if (half) *a = from_half(((uint16_t *)texels)[at]);
            else if (to_texels) ((uint32_t *)texels)[at] = *a;
            else *a = ((uint32_t *)texels)[at];
        }
}

static void set_value(Value *value, const char *name) {
    if (value->role == OUTPUT) die("%s is an output", value->name);
    uint64_t size, wanted = entries(value) * value->channels * 4;
    uint32_t *array = (uint32_t *)load_file(name, &size);
    if (size != wanted) die("%s has %llu bytes; %s needs %llu", name, (unsigned long long)size, value->name, (unsigned long long)wanted);
    Image *image = bundle.images + value->image;
    uint32_t most = is_half(image->format) ? 0x477fefff : 0x7f7fffff;  /* the last that is not infinite once rounded */
    for (uint64_t k = 0; k < wanted / 4 && !value->is_int; k++)
        if ((array[k] & 0x7fffffff) > most) die("%s: number %llu is not finite as stored", name, (unsigned long long)k);
    void *texels = make(image_bytes(image), 1);
    give_back((Indices){1, (uint32_t[]){value - bundle.values}});
    arrange(value, array, texels, true);
    transfer(image, image->parity, texels, true);
    value->has_value = true;
    value->version++;
    free(array);
    free(texels);
}

static void get_value(Value *value, const char *name) {
    Image *image = bundle.images + value->image;
    if (value->role == INPUT && !value->has_value) die("%s has no value", value->name);
    if (value->role == OUTPUT) {
        Plan *plan = bundle.plans;
        while (plan < bundle.plans + bundle.plan_count && !has(plan->outputs, value - bundle.values)) plan++;
        if (plan == bundle.plans + bundle.plan_count) die("no plan writes %s", value->name);
        if (!plan->updates.count) bring_up_to_date(plan);
        else if (!plan->has_run) die("%s, which writes %s, has not run", plan->name, value->name);
    }
    uint64_t size = entries(value) * value->channels * 4;
    uint32_t *array = make(size, 1);
    void *texels = make(image_bytes(image), 1);
    give_back((Indices){1, (uint32_t[]){value - bundle.values}});
    transfer(image, image->parity, texels, false);
    arrange(value, array, texels, false);
    FILE *f = fopen(name, "wb");
    if (!f || fwrite(array, 1, size, f) != size || fclose(f)) die("%s cannot be written", name);
    free(array);
    free(texels);
}

static void step(const char *name, const char *times) {
    char *rest;
    unsigned long long count = strtoull(times, &rest, 10);
    if (*rest || !*times) die("%s is no number of steps", times);
    for (uint32_t k = 0; k < bundle.plan_count; k++)
        if (!strcmp(bundle.plans[k].name, name) && bundle.plans[k].purpose != ENTER && bundle.plans[k].purpose != LEAVE) {
            run_plan(bundle.plans + k, count);
            return;
        }
    die("the bundle has no plan %s", name);
}

static void close_device(void) {
    for (uint32_t k = 0; k < bundle.plan_count; k++)
        for (Recording *r = bundle.plans[k].recordings; r; r = r->next) {
            for (uint32_t s = 0; s < bundle.plans[k].stage_count; s++) vkDestroyFramebuffer(gpu.device, r->framebuffers[s], NULL);
            vkDestroyDescriptorPool(gpu.device, r->sets, NULL);
        }
    for (uint32_t k = 0; k < bundle.pipeline_count; k++) {
        vkDestroyPipeline(gpu.device, bundle.pipelines[k].handle, NULL);
        vkDestroyPipelineLayout(gpu.device, bundle.pipelines[k].layout, NULL);
        vkDestroyDescriptorSetLayout(gpu.device, bundle.pipelines[k].set_layout, NULL);
    }
    for (uint32_t k = 0; k < bundle.pass_count; k++) vkDestroyRenderPass(gpu.device, bundle.passes[k].handle, NULL);
    for (uint32_t k = 0; k < bundle.shaders.count; k++) vkDestroyShaderModule(gpu.device, gpu.shaders[k], NULL);
    for (uint32_t k = 0; k < bundle.samplers.count; k++) vkDestroySampler(gpu.device, gpu.samplers[k], NULL);
    for (uint32_t k = 0; k < 2 * bundle.image_count; k++) {
        vkDestroyImageView(gpu.device, bundle.images[k / 2].view[k % 2], NULL);
        vkDestroyImage(gpu.device, bundle.images[k / 2].handle[k % 2], NULL);
    }
    for (uint32_t k = 0; k < VK_MAX_MEMORY_TYPES; k++) vkFreeMemory(gpu.device, gpu.blocks[k], NULL);
    vkDestroyCommandPool(gpu.device, gpu.pool, NULL);
    vkDestroyDevice(gpu.device, NULL);
    vkDestroyInstance(gpu.instance, NULL);
}

int main(int count, char **words) {
    bool check = count == 3 && !strcmp(words[1], "check");
    if (!check && (count < 3 || count % 3 || strcmp(words[1], "run")))
        die("usage: player check FILE | player run FILE [set NAME FILE | step NAME COUNT | get NAME FILE]...");
    read_bundle(words[2]);
    if (check) return 0;
    open_device();
    create_objects();
    for (int k = 3; k < count; k += 3) {
        const char *what = words[k], *name = words[k + 1], *with = words[k + 2];
        if (!strcmp(what, "set")) set_value(find_value(name), with);
        else if (!strcmp(what, "get")) get_value(find_value(name), with);
        else if (!strcmp(what, "step")) step(name, with);
        else die("%s is none of set, step, get", what);
    }
    close_device();
    return 0;
}
