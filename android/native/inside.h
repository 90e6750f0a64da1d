/* What the parts of libdressi share. A bundle is read into a `Bundle` of plain records; a session makes objects of one `Variant`. */

#ifndef DRESSI_INSIDE_H
#define DRESSI_INSIDE_H

#include <setjmp.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "dressi.h"

#define COUNT(array) (sizeof(array) / sizeof *(array))

/* ---- base.c: errors, memory, texts, digests ---- */

/* A call that may fail: `fail` fills the error and goes back to where `out` was set. What was made meanwhile belongs to an arena
   or to an object that whoever set `out` cleans up. */
typedef struct Call {
    jmp_buf out;
    dressi_error error;
} Call;

_Noreturn void fail(Call *call, dressi_code code, const char *format, ...);

/* The end of a call: gives the error to the caller; its code. */
dressi_code told(const Call *call, dressi_error *error);

/* Memory that goes all at once. */
typedef struct Arena { struct Chunk *last; } Arena;

void *grow(Call *call, Arena *arena, uint64_t count, size_t size); /* zeroed */
void drop(Arena *arena);

/* A text that grows, always ended by a 0. Without memory it becomes `broken`. */
typedef struct Text { char *at; size_t length, room; bool broken; } Text;

void say(Text *text, const char *format, ...);
void say_json(Text *text, const char *word); /* in quotes */

typedef struct Sha { uint32_t h[8]; uint64_t size; uint8_t block[64]; } Sha;

void sha_begin(Sha *sha);
void sha_add(Sha *sha, const void *data, uint64_t size);
void sha_end(Sha *sha, uint8_t digest[32]);
void sha256(const void *data, uint64_t size, uint8_t digest[32]);
void hexadecimal(const uint8_t *bytes, size_t count, char *text); /* 2 count + 1 characters */

/* Sorts by `before`, equal ones in their order, in n log n whatever the input; `spare` has as many items. */
void sort(uint32_t *items, uint32_t *spare, uint32_t count, bool (*before)(uint32_t a, uint32_t b, const void *context),
          const void *context);
void sort_numbers(uint32_t *items, uint32_t *spare, uint32_t count);

double seconds_now(void);
void rest(double seconds);

static inline uint64_t divided(uint64_t a, uint64_t b) { return a / b + (a % b != 0); }
static inline uint32_t little32(const uint8_t *p) { return p[0] | p[1] << 8 | p[2] << 16 | (uint32_t)p[3] << 24; }
static inline uint64_t little64(const uint8_t *p) { return little32(p) | (uint64_t)little32(p + 4) << 32; }

/* ---- files.c ---- */

typedef struct Part { const void *data; uint64_t size; } Part;

/* Bytes of a regular file of at most `most`; NULL, or what is wrong: TOO_LARGE, or what `strerror` says. `only_ours`: no link, and
   nobody else's to write. The caller frees `*data`, also after an error. */
extern const char TOO_LARGE[];
const char *read_file(const char *path, uint64_t most, bool only_ours, uint8_t **data, uint64_t *size);
const char *replace_file(const char *path, const Part *parts, size_t count, bool is_private);

/* ---- msgpack.c ---- */

typedef enum Kind { NIL, BOOLEAN, INTEGER, HUGE, REAL, STRING, BINARY, ARRAY, MAP } Kind;

typedef struct Node {
    Kind kind;
    uint32_t count; /* bytes, items, or pairs */
    union { int64_t integer; uint64_t huge; double real; const uint8_t *bytes; struct Node *items; } is;
} Node; /* HUGE: an integer of 2^63 or more */

/* The tree of a description; fails with what the Python reader says. */
const Node *decode(Call *call, Arena *arena, const uint8_t *bytes, uint64_t size);
bool same(const Node *node, const char *word);
bool equal(const Node *a, const Node *b);
const Node *find(const Node *map, const char *key); /* NULL if it is not there */

enum { SHOWN = 160 };
const char *show(const Node *node, char buffer[SHOWN]); /* short, in Python's words */
void say_repr(Text *text, Kind kind, const uint8_t *bytes, size_t count); /* of a STRING or BINARY, in Python's words */

/* What packs; `at` NULL counts bytes. */
typedef struct Packed { uint8_t *at; uint64_t size; } Packed;

void pack_head(Packed *packed, Kind kind, uint64_t count); /* of STRING, ARRAY, MAP; or an INTEGER of 0 or more; or NIL */
void pack_text(Packed *packed, const char *text);

/* ---- A bundle ---- */

enum { MAX_VARIANTS = 16, MAX_SIDE = 1 << 16, MAX_ITEMS = 1 << 20, MAX_OBJECTS = 1 << 16, MAX_LOCATIONS = 64, LIMIT_COUNT = 21, FORMAT_COUNT = 9, FEATURE_COUNT = 4 };

typedef struct Indices { uint32_t count, *at; } Indices;
typedef struct Blob { uint64_t offset, size; const uint8_t *digest; } Blob;
typedef struct Image { uint32_t format, width, height, slots, usage; int data, value; } Image; /* a blob and a value, or -1 */
typedef struct Attachment { uint32_t format, load, store; int clear; } Attachment;
typedef struct Subpass { Indices colors, inputs; int depth; } Subpass;
typedef struct Pass { uint32_t attachment_count, subpass_count; Attachment *attachments; Subpass *subpasses; } Pass;
typedef struct Binding { uint32_t kind, stages; int sampler; } Binding;
typedef struct Pipeline {
    uint32_t vertex, fragment, pass, subpass, topology, binding_count;
    bool depth;
    Binding *bindings;
} Pipeline;
typedef struct Compute { uint32_t shader, binding_count, output_count; Binding *bindings; Attachment *outputs; } Compute;
typedef enum Role { INPUT, STATE, OUTPUT, COPY } Role;
typedef enum Layout { UNIT, TABLE, IMAGE, ATLAS } Layout;
typedef struct Value {
    const char *name;
    Role role;
    Layout layout;
    uint32_t image, channels, width, height, count, columns;
    bool is_int;
    int initial; /* a blob, or -1 */
    bool filled; /* starts as one texel */
    uint8_t texel[16];
} Value;
typedef struct Draw {
    uint32_t pipeline, vertices, cell_count;
    int64_t count; /* a ref, or -1 */
    Indices images;
    uint32_t (*cells)[4];
    float near, far;
} Draw;
typedef struct Draws { uint32_t count; Draw *draws; } Draws;
typedef struct Stage {
    int64_t compute; /* index, or -1: it draws */
    uint32_t pass, width, height, subpass_count, groups[3];
    Indices attachments; /* of compute: the images that it writes */
    bool wait;
    Draws *subpasses; /* of compute: one, of one draw that has its images and count */
} Stage;
typedef enum Purpose { GIVES, PHASE, ENTER, LEAVE } Purpose;
typedef struct Plan {
    const char *name;
    Purpose purpose;
    Indices updates, reads, outputs, needs;
    uint64_t steps;
    uint32_t stage_count;
    Stage *stages;
} Plan;

/* What a shader binds, takes and gives. Scalars of a location: 0 none, 1 float, 2 int, 3 uint. */
typedef struct Location { uint8_t scalar, components; } Location;
typedef struct Used { uint32_t number, kind, index; bool is_integer; } Used; /* index of an input attachment, format of a storage image */
typedef struct Interface {
    uint32_t stage; /* 1 vertex, 16 fragment, 32 compute */
    uint32_t used_count, input_count, output_count;
    Used *used;
    Location inputs[MAX_LOCATIONS], outputs[MAX_LOCATIONS];
    uint8_t order[MAX_LOCATIONS]; /* of the inputs, as declared */
    uint64_t input_components, output_components;
    bool writes_size; /* of points */
    uint32_t local_size[3]; /* invocations of a workgroup */
    uint64_t shared_bytes;  /* of what they share, at most */
} Interface;

/* What a bundle says of pictures that are not all on the device. counters: by plan the state that counts its steps, or -1. turns: inputs
   that say which view a step sees. */
typedef struct Turn { uint32_t input, counter; Indices order; } Turn;
typedef struct Window {
    bool is_malformed;
    uint32_t value, views, bits, turn_count;
    Indices order; /* empty: every view has a slot of its own */
    int32_t *counters;
    Turn *turns;
} Window;

typedef struct Variant {
    const char *profile;
    const Node *root; /* while the bundle is read */
    int64_t needs_limits[LIMIT_COUNT];
    uint8_t needs_formats[FORMAT_COUNT]; /* bits of FEATURES */
    Indices depth_formats, samplers, shaders;
    uint32_t image_count, pass_count, pipeline_count, compute_count, value_count, plan_count;
    bool has_computes; /* the key */
    Image *images;
    Pass *passes;
    Pipeline *pipelines;
    Compute *computes;
    Value *values;
    Plan *plans;
    const Interface **interfaces; /* one a shader */
    Window *window;               /* NULL: all pictures are on the device */
} Variant;

typedef struct Bundle {
    const uint8_t *data;
    uint64_t size;
    uint8_t digest[32];
    Arena arena;
    uint32_t blob_count, variant_count;
    Blob *blobs;
    Variant variants[MAX_VARIANTS];
} Bundle;

/* bundle.c: fails with DRESSI_BUNDLE and what the Python reader says; `bundle` is zeros, and its arena the caller's to drop. */
void read_bundle(Call *call, Bundle *bundle, const uint8_t *data, uint64_t size, const char *pin);
const uint8_t *blob_data(const Bundle *bundle, uint32_t k);

/* The file at a path, with the path before what is wrong with it. The caller frees `*data`, also after a failure. */
void read_bundle_file(Call *call, Bundle *bundle, const char *path, const char *pin, uint8_t **data);

/* ---- Reading: fields.c, check.c, check_plans.c, check_flow.c, spirv.c, check_shaders.c ---- */

typedef struct Reader {
    Call *call;
    Arena *kept, scratch;
    Bundle *bundle;
    Variant *v;
    const Node *top; /* the file's map, which has the blobs */
    int variant; /* of several, or -1 */
    struct { const char *key; int64_t index; } path[24];
    int depth;
    const Interface **parsed; /* by blob */
} Reader;

_Noreturn void refuse(Reader *r, const char *format, ...); /* after the path */
_Noreturn void refuse_plainly(Reader *r, const char *format, ...); /* without the path */

static inline void push(Reader *r, const char *key, int64_t index) {
    r->path[r->depth].key = key;
    r->path[r->depth++].index = index;
}
static inline void pop(Reader *r) { r->depth--; }

/* Item k of the list on top of the path. */
#define EACH(r, k, count_) (uint32_t k = 0; k < (count_) && ((r)->path[(r)->depth - 1].index = k, true); k++)

static inline const Value *value_of(const Reader *r, uint32_t x) { return r->v->values + x; }

void *make(Reader *r, uint64_t count, size_t size);         /* as long as the bundle */
void *make_scratch(Reader *r, uint64_t count, size_t size); /* until it is read */
void keys(Reader *r, const Node *map, const char *names, const char *where);
int64_t integer(Reader *r, const Node *node, int64_t low, int64_t high);
int64_t number(Reader *r, const Node *map, const char *key, int64_t low, int64_t high);
const Node *list(Reader *r, const Node *node, int64_t length, uint32_t most);
const Node *open_list(Reader *r, const Node *map, const char *key, int64_t length, uint32_t most); /* pushes its key */
const char *text(Reader *r, const Node *map, const char *key);
uint32_t number_of(Reader *r, const Node *node, const char *allowed);
uint32_t word_of(Reader *r, const Node *map, const char *key, const char *allowed); /* its place in the list */
bool *repeated(Reader *r, const Node *list); /* of each item: a map whose name an item before has */

void check_description(Reader *r, const Node *root);
void check_variants(Reader *r, const Node *root);
void check_plans(Reader *r);
typedef struct Marks { /* by value and by ref: who was there last; nobody is 0 */
    uint32_t *of_value, *of_ref, now_value, now_ref;
} Marks;
const char *show_name(const Reader *r, uint32_t value, char shown[SHOWN]);
void check_flow(Reader *r, Marks *marks);
void check_shaders(Reader *r);
void read_window(Reader *r); /* window.c */
const Interface *parse_shader(Reader *r, const uint8_t *data, uint64_t size);

/* ---- tables.c: the numbers of Vulkan in a bundle ---- */

extern const char *const LIMIT_NAMES[LIMIT_COUNT];   /* sorted */
extern const char *const FORMAT_NAMES[FORMAT_COUNT]; /* sorted, without VK_FORMAT_ */
extern const uint32_t FORMATS[FORMAT_COUNT];
extern const char *const FEATURES[FEATURE_COUNT]; /* sampled color filter storage, bit k each; the last of compute alone */
bool of_compute(int limit); /* one that only a description with computes may name */
bool can_store(uint32_t format); /* a shader may write it without a feature */
uint32_t load_of(const Variant *v, const Stage *stage, uint32_t k); /* of what it writes */

const char *format_name(uint32_t format); /* "depth" for 0 */
bool is_half(uint32_t format);
bool is_integer(uint32_t format);
uint32_t format_channels(uint32_t format);
uint32_t texel_bytes(uint32_t format); /* depth takes 4 */
uint64_t image_bytes(const Image *image);
bool has(Indices all, uint32_t x);

/* layout.c: a value's array and its image */
uint64_t entry_count(const Value *value);
void describe_value(const Value *value, dressi_value *found);
void to_texels(Call *call, const Value *value, uint32_t format, const void *array, uint8_t *texels);
uint64_t count_not_finite(const Value *value, uint32_t format, const uint8_t *texels); /* NaN or Inf, of what is no padding */
void from_texels(const Value *value, uint32_t format, const uint8_t *texels, void *array);
void table_size(uint64_t count, uint64_t *width, uint64_t *height);

#endif
