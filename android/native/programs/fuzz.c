/* A target of libFuzzer: whatever the bytes are, the reader accepts or refuses them. `make -C android/native build/fuzz`, with clang-16.

   Bytes that begin as SPIR-V are read as a shader. Of all others the checksum of the description is made right, so that what lies behind
   it is reached. */

#include "inside.h"

#include <stdlib.h>
#include <string.h>

static void read_shader(const uint8_t *data, size_t size) {
    Call call;
    Bundle bundle = {0};
    Reader reader = {.call = &call, .kept = &bundle.arena, .bundle = &bundle, .variant = -1};
    push(&reader, "shader", -1);
    if (!setjmp(call.out)) parse_shader(&reader, data, size);
    drop(&reader.scratch);
    drop(&bundle.arena);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    if (size >= 4 && little32(data) == 0x07230203) {
        read_shader(data, size);
        return 0;
    }
    uint8_t *copy = malloc(size ? size : 1);
    memcpy(copy, data, size);
    if (size >= 56 && little64(copy + 16) <= size - 56) sha256(copy + 56, little64(copy + 16), copy + 24);
    dressi_error error;
    dressi_check_memory(copy, size, NULL, &error);
    free(copy);
    return 0;
}
