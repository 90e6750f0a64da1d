/* The file: header, checksums, blobs, variants. In: bytes. Out: a `Bundle`, or what is wrong, in the order and words of
   dressi_edge/cache/bundle.py. Nothing of it calls a driver. */

#include "inside.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { HEAD = 56, BLOCK = 64, MAX_DESCRIPTION = 1 << 26 };
#define MAX_FILE (UINT64_C(1) << 32)

typedef unsigned long long ull;

const uint8_t *blob_data(const Bundle *bundle, uint32_t k) { return bundle->data + bundle->blobs[k].offset; }

static bool is_zero(const uint8_t *p, uint64_t count) {
    for (uint64_t k = 0; k < count; k++)
        if (p[k]) return false;
    return true;
}

static bool matches(const void *data, uint64_t size, const uint8_t *digest) {
    uint8_t found[32];
    sha256(data, size, found);
    return !memcmp(found, digest, 32);
}

/* ---- What the variants of a file have in common ---- */

static void check_alike(Reader *r, const Node *first, const Node *mine, const char *key, const char *const *fields, size_t count) {
    const Node *a = find(first, key), *b = find(mine, key);
    char one[SHOWN], other[SHOWN];
    push(r, key, -1);
    if (a->count != b->count) refuse(r, " is %s; variants[0] has %u", show(b, one), a->count);
    for EACH(r, k, b->count)
        for (size_t n = 0; n < count; n++) {
            const Node *x = find(b->is.items + k, fields[n]), *y = find(a->is.items + k, fields[n]);
            if (!equal(x, y)) refuse(r, ".%s is %s; that of variants[0] is %s", fields[n], show(x, one), show(y, other));
        }
    pop(r);
}

void check_variants(Reader *r, const Node *root) {
    static const char *const of_values[] = {"name", "role", "type", "layout", "width", "height", "count", "columns", "initial"};
    static const char *const of_plans[] = {"name", "updates", "outputs", "steps"};
    Bundle *bundle = r->bundle;
    char shown[SHOWN];
    keys(r, root, "variants blobs", "description");
    const Node *variants = open_list(r, root, "variants", -1, MAX_VARIANTS);
    if (variants->count < 2) refuse(r, " is %s; 2 to %d are needed", show(variants, shown), MAX_VARIANTS);
    for (uint32_t k = 0; k < variants->count; k++) {
        const Node *variant = variants->is.items + k;
        r->depth = 0;
        push(r, "variants", k);
        if (variant->kind != MAP || find(variant, "blobs")) refuse(r, " is %s; a map without blobs is needed", show(variant, shown));
        r->variant = k;
        r->v = bundle->variants + bundle->variant_count;
        check_description(r, variant);
        r->variant = -1;
        r->depth = 0;
        push(r, "variants", k);
        for (uint32_t j = 0; j < bundle->variant_count; j++)
            if (!strcmp(bundle->variants[j].profile, r->v->profile))
                refuse(r, ".profile.name %s is taken", show(find(find(variant, "profile"), "name"), shown));
        bundle->variant_count++;
        check_alike(r, variants->is.items, variant, "values", of_values, COUNT(of_values));
        check_alike(r, variants->is.items, variant, "plans", of_plans, COUNT(of_plans));
    }
}

static uint32_t version_of(const Bundle *bundle) {
    for (uint32_t n = 0; n < bundle->variant_count; n++) {
        const Variant *v = bundle->variants + n;
        for (uint32_t k = 0; k < v->value_count; k++)
            if (v->values[k].filled) return 5;
    }
    for (uint32_t n = 0; n < bundle->variant_count; n++) {
        const Variant *v = bundle->variants + n;
        if (v->compute_count) return 4;
    }
    for (uint32_t n = 0; n < bundle->variant_count; n++) {
        const Variant *v = bundle->variants + n;
        for (uint32_t k = 0; k < v->image_count; k++)
            if (is_half(v->images[k].format)) return 3;
        for (uint32_t k = 0; k < v->value_count; k++)
            if (v->values[k].role == COPY) return 3;
    }
    return bundle->variant_count > 1 ? 2 : 1;
}

/* ---- Blobs ---- */

static void check_layout(Reader *r, uint64_t at) {
    const Bundle *bundle = r->bundle;
    for (uint32_t k = 0; k < bundle->blob_count; k++) {
        const Blob *blob = bundle->blobs + k;
        uint64_t next = divided(at, BLOCK) * BLOCK;
        uint64_t end = next < bundle->size ? next : bundle->size; /* `at` lies within the file */
        if (blob->offset != next || !is_zero(bundle->data + at, end - at))
            refuse_plainly(r, "blobs[%u]: at %llu; %llu is needed, with zeros before it", k, (ull)blob->offset, (ull)next);
        at = next + blob->size;
        if (at > bundle->size) refuse_plainly(r, "truncated: blobs[%u] ends at %llu, the file at %llu", k, (ull)at, (ull)bundle->size);
        if (!matches(bundle->data + blob->offset, blob->size, blob->digest))
            refuse_plainly(r, "blobs[%u]: the checksum does not match; the file is damaged", k);
    }
    uint64_t end = divided(at, BLOCK) * BLOCK;
    if (bundle->size != end || !is_zero(bundle->data + at, end - at))
        refuse_plainly(r, "%llu bytes; %llu are needed, zeros after the last blob", (ull)bundle->size, (ull)end);
}

static void check_sizes(Reader *r) {
    const Bundle *bundle = r->bundle;
    const Variant *v = r->v;
    for (uint32_t k = 0; k < v->image_count; k++) {
        const Image *image = v->images + k;
        if (image->data >= 0 && bundle->blobs[image->data].size != image_bytes(image))
            refuse_plainly(r, "images[%u].data: blobs[%d] has %llu bytes; %llu are needed", k, image->data,
                           (ull)bundle->blobs[image->data].size, (ull)image_bytes(image));
    }
    for (uint32_t k = 0; k < v->value_count; k++) {
        const Value *value = v->values + k;
        uint64_t needed = image_bytes(v->images + value->image);
        if (value->initial >= 0 && bundle->blobs[value->initial].size != needed)
            refuse_plainly(r, "values[%u].initial: blobs[%d] has %llu bytes; %llu are needed", k, value->initial,
                           (ull)bundle->blobs[value->initial].size, (ull)needed);
    }
    for (uint32_t k = 0; k < v->shaders.count; k++) {
        uint64_t size = bundle->blobs[v->shaders.at[k]].size;
        if (size % 4 || size < 20) refuse_plainly(r, "shaders[%u]: %llu bytes are no SPIR-V module", k, (ull)size);
    }
}

/* ---- The whole ---- */

static void check_pin(Call *call, const Bundle *bundle, const char *pin) {
    char found[65], wanted[65] = {0};
    size_t length = strlen(pin);
    bool sound = length == 64;
    for (size_t k = 0; sound && k < 64; k++) {
        wanted[k] = pin[k] >= 'A' && pin[k] <= 'F' ? pin[k] + 32 : pin[k];
        sound = (wanted[k] >= '0' && wanted[k] <= '9') || (wanted[k] >= 'a' && wanted[k] <= 'f');
    }
    if (!sound) fail(call, DRESSI_BUNDLE, "pin '%.60s' is no SHA-256; 64 hexadecimal digits are needed", pin);
    hexadecimal(bundle->digest, 32, found);
    if (strcmp(found, wanted)) fail(call, DRESSI_BUNDLE, "the file's SHA-256 is %s; the pin is %s", found, wanted);
}

static uint64_t check_head(Call *call, const uint8_t *data, uint64_t size) {
    if (size < HEAD) fail(call, DRESSI_BUNDLE, "%llu bytes; a bundle has at least %d", (ull)size, HEAD);
    uint32_t version = little32(data + 8), reserved = little32(data + 12);
    uint64_t count = little64(data + 16);
    if (memcmp(data, "DRESSI\r\n", 8)) fail(call, DRESSI_BUNDLE, "not a bundle: the file does not begin with DRESSI");
    if (version < 1 || version > 5)
        fail(call, DRESSI_BUNDLE, "format version %u; this reader knows 1 to 5; compile the bundle again or update dressi_edge", version);
    if (reserved) fail(call, DRESSI_BUNDLE, "reserved field is %u; 0 is allowed", reserved);
    if (count > size - HEAD)
        fail(call, DRESSI_BUNDLE, "truncated: the description has %llu bytes, the file holds %llu of them", (ull)count, (ull)(size - HEAD));
    if (count > MAX_DESCRIPTION)
        fail(call, DRESSI_BUNDLE, "the description has %llu bytes; at most %d are allowed", (ull)count, MAX_DESCRIPTION);
    if (!matches(data + HEAD, count, data + 24))
        fail(call, DRESSI_BUNDLE, "the description's checksum does not match; the file is damaged");
    return count;
}

/* A description has the key of what is dispatched from version 4 on, and in none before. */
static void check_computes(Reader *r, const Node *root, uint32_t version) {
    if (root->kind != MAP || (version >= 4) == (find(root, "computes") != NULL)) return;
    refuse_plainly(r, "description %s", version >= 4 ? "lacks computes" : "has the unknown key 'computes'");
}

static void read_all(Reader *r, uint64_t count) {
    Bundle *bundle = r->bundle;
    uint32_t version = little32(bundle->data + 8);
    const Node *root = decode(r->call, &r->scratch, bundle->data + HEAD, count);
    bool several = version == 2 || (version > 2 && find(root, "variants"));
    const Node *variants = several ? find(root, "variants") : NULL;
    r->top = root;
    if (!several) check_computes(r, root, version);
    for (uint32_t k = 0; variants && variants->kind == ARRAY && k < variants->count; k++) {
        r->variant = (int)k;
        check_computes(r, variants->is.items + k, version);
    }
    r->variant = -1;
    if (several) {
        check_variants(r, root);
    } else {
        r->v = bundle->variants;
        check_description(r, root);
        bundle->variant_count = 1;
    }
    if (version != version_of(bundle))
        refuse_plainly(r, "format version %u; what the file holds is written as version %u", version, version_of(bundle));
    check_layout(r, HEAD + count);
    r->parsed = make_scratch(r, bundle->blob_count, sizeof *r->parsed);
    for (uint32_t k = 0; k < bundle->variant_count; k++) {
        r->variant = several ? (int)k : -1;
        r->v = bundle->variants + k;
        check_sizes(r);
        check_shaders(r);
        read_window(r);
        r->v->root = NULL; /* the nodes go with the reader */
    }
}

void read_bundle(Call *call, Bundle *bundle, const uint8_t *data, uint64_t size, const char *pin) {
    Call inner;
    Reader reader = {.call = &inner, .kept = &bundle->arena, .bundle = bundle, .variant = -1};
    bundle->data = data, bundle->size = size;
    if (pin) { /* before anything is decoded */
        sha256(data, size, bundle->digest);
        check_pin(call, bundle, pin);
    }
    uint64_t count = check_head(call, data, size);
    if (setjmp(inner.out)) {
        drop(&reader.scratch);
        fail(call, inner.error.code, "%s", inner.error.text);
    }
    read_all(&reader, count);
    drop(&reader.scratch);
    for (uint32_t k = 0; k < bundle->blob_count; k++) bundle->blobs[k].digest = NULL; /* within the file, which need not stay */
    if (!pin) sha256(data, size, bundle->digest);
}

void read_bundle_file(Call *call, Bundle *bundle, const char *path, const char *pin, uint8_t **data) {
    uint64_t size;
    const char *wrong = read_file(path, MAX_FILE, false, data, &size);
    if (wrong) fail(call, DRESSI_BUNDLE, "%s: cannot be read: %s", path, wrong);
    Call inner;
    if (setjmp(inner.out)) fail(call, inner.error.code, "%s: %s", path, inner.error.text);
    read_bundle(&inner, bundle, *data, size, pin);
}

/* ---- For callers ---- */

dressi_code dressi_check_memory(const void *bytes, size_t size, const char *pin, dressi_error *error) {
    Call call = {.error = {DRESSI_OK, ""}};
    Bundle bundle = {0};
    if (!setjmp(call.out)) read_bundle(&call, &bundle, bytes, size, pin);
    drop(&bundle.arena);
    return told(&call, error);
}

dressi_code dressi_check(const char *path, const char *pin, dressi_error *error) {
    Call call = {.error = {DRESSI_OK, ""}};
    Bundle bundle = {0};
    uint8_t *data = NULL;
    if (!setjmp(call.out)) read_bundle_file(&call, &bundle, path, pin, &data);
    drop(&bundle.arena);
    free(data);
    return told(&call, error);
}
