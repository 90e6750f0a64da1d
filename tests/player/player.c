/* What the tests drive libdressi with, through dressi.h alone.

   player check FILE                        accept or refuse, without any Vulkan
   player stream                            for each bundle on standard input (u64 of bytes, bytes) a line: its code and the sentence
   player cut FILE                          refuse every beginning of the file; how many there are
   player run FILE [DO WITH WHAT]...        in order:
       set NAME FILE, get NAME FILE         the array of a value, row-major, little-endian fp32 or int32
       step PHASE COUNT                     so many iterations; prints nothing
       bound PHASE COUNT:SECONDS            the same with a bound; prints how many were run
       cancel PHASE COUNT:CALLS             the same, cancelled at that call of the function
       threads NAME COUNT                   so many threads that get the value while another steps; prints how many bytes differ
       pictures . FILE                      pictures come from the file, one after another, until a call of the same without FILE (".")
       loss . .                             prints the loss of the current phase
       save . FILE, load . FILE             a checkpoint
       report . .                           prints the report
       values . .                           prints the values and phases
       fork NAME .                          prints what a child's get says, and goes on
       try DO:WITH WHAT                     any of them; prints code and sentence, and goes on

   PLAYER_MEMORY: the bundle is read from memory, at an odd address. DRESSI_PROFILE names the variant to play;
       DRESSI_PIN the file's SHA-256. Exit status: the code of the error. */

#include <pthread.h>
#include <setjmp.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#include "dressi.h"

static dressi_error error;

static int trying;
static jmp_buf tried;

static void must(dressi_code code) {
    if (!code) return;
    if (trying) longjmp(tried, code);
    fprintf(stderr, "%s\n", error.text);
    exit(code);
}

static void die(const char *what) {
    fprintf(stderr, "player: %s\n", what);
    exit(9);
}

static unsigned char *load_file(const char *name, size_t *size) {
    FILE *f = fopen(name, "rb");
    if (!f || fseek(f, 0, SEEK_END)) die(name);
    *size = ftell(f);
    unsigned char *data = malloc(*size + 1);
    rewind(f);
    if (!data || fread(data, 1, *size, f) != *size) die(name);
    fclose(f);
    return data;
}

/* ---- Reading ---- */

static int stream(void) {
    unsigned char head[8];
    while (fread(head, 1, 8, stdin) == 8) {
        size_t size = 0;
        for (int k = 8; k--;) size = size << 8 | head[k];
        unsigned char *data = malloc(size ? size : 1); /* of this size: the sanitizer sees a byte beyond */
        if (!data || fread(data, 1, size, stdin) != size) die("the stream ends");
        dressi_code code = dressi_check_memory(data, size, NULL, &error);
        printf("%d %s\n", code, error.text);
        free(data);
    }
    return 0;
}

static int cut(const char *name) {
    size_t size;
    unsigned char *data = load_file(name, &size);
    for (size_t n = 0; n < size; n++) {
        unsigned char *part = malloc(n ? n : 1);
        memcpy(part, data, n);
        if (dressi_check_memory(part, n, NULL, &error) != DRESSI_BUNDLE) die("a beginning of the file was accepted");
        free(part);
    }
    must(dressi_check_memory(data, size, NULL, &error));
    printf("%zu\n", size);
    free(data);
    return 0;
}

/* ---- Running ---- */

static dressi_session *s;

static void set(const char *name, const char *path) {
    size_t size;
    unsigned char *data = load_file(path, &size);
    dressi_code code = dressi_set(s, name, data, size, &error);
    free(data);
    must(code);
}

static dressi_code get(const char *name, const char *path) {
    dressi_value value;
    dressi_code code = dressi_find(s, name, &value, &error);
    if (code) return code;
    unsigned char *data = malloc(value.bytes);
    code = dressi_get(s, name, data, value.bytes, &error);
    FILE *f = code ? NULL : fopen(path, "wb");
    if (!code && (!f || fwrite(data, 1, value.bytes, f) != value.bytes || fclose(f))) die(path);
    free(data);
    return code;
}

static int countdown(void *context) { return --*(int *)context <= 0; }

typedef struct Watch { const char *name; int stop, calls, wrong; pthread_t thread; } Watch;

static void *watch(void *context) {
    Watch *w = context;
    dressi_value value;
    dressi_error mine;
    if (dressi_find(s, w->name, &value, &mine)) return NULL;
    unsigned char *data = malloc(value.bytes);
    while (!__atomic_load_n(&w->stop, __ATOMIC_RELAXED)) {
        w->wrong += dressi_get(s, w->name, data, value.bytes, &mine) != DRESSI_OK;
        w->calls++;
    }
    free(data);
    return NULL;
}

static void threads(const char *name, int count) {
    Watch watches[8] = {{0}};
    uint64_t done;
    if (count > 8) die("at most 8 threads");
    for (int k = 0; k < count; k++) {
        watches[k].name = name;
        if (pthread_create(&watches[k].thread, NULL, watch, watches + k)) die("no thread");
    }
    must(dressi_step(s, 1 << 20, NULL, &(dressi_bound){0.5, NULL, NULL}, &done, &error));
    int calls = 1 << 30, wrong = 0;
    for (int k = 0; k < count; k++) __atomic_store_n(&watches[k].stop, 1, __ATOMIC_RELAXED);
    for (int k = 0; k < count; k++) {
        pthread_join(watches[k].thread, NULL);
        calls = watches[k].calls < calls ? watches[k].calls : calls;
        wrong += watches[k].wrong;
    }
    printf("%llu %d %d\n", (unsigned long long)done, calls, wrong); /* iterations, the fewest calls of a thread, failed ones */
}

static void step(const char *phase, const char *what, const char *how) {
    char *rest;
    uint64_t n = strtoull(what, &rest, 10), done = 0;
    int calls = *rest ? atoi(rest + 1) : 0;
    dressi_bound bound = {-1, NULL, &calls};
    if (*how == 'b') bound.seconds = atof(rest + 1);
    if (*how == 'c') bound.cancel = countdown;
    dressi_code code = dressi_step(s, n, *phase == '.' ? NULL : phase, *how == 's' ? NULL : &bound, &done, &error);
    if (*how != 's') printf("%llu\n", (unsigned long long)done);
    must(code);
}

/* A file of all pictures, one after another; a view beyond its end cannot be had. */
static int picture(void *context, uint32_t view, void *pixels) {
    dressi_picture about;
    FILE *f = fopen(context, "rb");
    int wrong = !f || !dressi_picture_of(s, &about) || fseek(f, (long)(about.bytes * view), SEEK_SET) ||
                fread(pixels, 1, about.bytes, f) != about.bytes;
    if (f) fclose(f);
    return wrong;
}

static void pictures(const char *path) {
    dressi_picture about;
    if (dressi_picture_of(s, &about)) printf("%u %ux%u %d %zu\n", about.views, about.width, about.height, about.bits, about.bytes);
    must(dressi_pictures(s, strcmp(path, ".") ? picture : NULL, (void *)path, &error));
}

static void values(void) {
    static const char *const roles[] = {"input", "state", "output"};
    dressi_value value;
    uint64_t steps;
    for (uint32_t k = 0; k < dressi_value_count(s) && dressi_value_at(s, k, &value); k++) {
        printf("%s %s %s %d %zu:", roles[value.role], value.name, value.is_int ? "int" : "float", value.channels, value.bytes);
        for (int n = 0; n < value.rank; n++) printf(" %u", value.shape[n]);
        printf("\n");
    }
    for (uint32_t k = 0; dressi_phase_at(s, k, &steps); k++) printf("phase %s %llu\n", dressi_phase_at(s, k, NULL),
        (unsigned long long)steps);
}

static void in_a_child(const char *name) {
    fflush(stdout);
    pid_t child = fork();
    if (!child) {
        float x;
        dressi_code code = dressi_get(s, name, &x, sizeof x, &error);
        dressi_close(s); /* does nothing */
        printf("%d %s\n", code, error.text);
        fflush(stdout);
        _exit(0);
    }
    int status;
    if (waitpid(child, &status, 0) != child || status) die("the child failed");
}

static void perform(const char *what, const char *with, const char *path) {
    float loss;
    char *report;
    if (!strcmp(what, "set")) set(with, path);
    else if (!strcmp(what, "get")) must(get(with, path));
    else if (!strcmp(what, "step") || !strcmp(what, "bound") || !strcmp(what, "cancel")) step(with, path, what);
    else if (!strcmp(what, "threads")) threads(with, atoi(path));
    else if (!strcmp(what, "loss")) { must(dressi_loss(s, &loss, &error)); printf("%.9g\n", loss); }
    else if (!strcmp(what, "save")) must(dressi_checkpoint(s, path, &error));
    else if (!strcmp(what, "load")) must(dressi_restore(s, path, &error));
    else if (!strcmp(what, "pictures")) pictures(path);
    else if (!strcmp(what, "values")) values();
    else if (!strcmp(what, "fork")) in_a_child(with);
    else if (!strcmp(what, "report")) {
        if (!(report = dressi_report(s, &error))) must(error.code);
        puts(report);
        dressi_free(report);
    } else die(what);
}

static void try_to(const char *what, const char *path) {
    char verb[200];
    snprintf(verb, sizeof verb, "%s", what);
    char *with = strchr(verb, ':');
    if (!with) die(what);
    *with++ = 0;
    trying = 1;
    int code = setjmp(tried);
    if (!code) perform(verb, with, path);
    trying = 0;
    printf("%d %s\n", code, code ? error.text : "");
}

int main(int count, char **words) {
    if (count == 2 && !strcmp(words[1], "stream")) return stream();
    if (count == 3 && !strcmp(words[1], "cut")) return cut(words[2]);
    if (count == 3 && !strcmp(words[1], "check")) {
        must(dressi_check(words[2], getenv("DRESSI_PIN"), &error));
        return 0;
    }
    if (count < 3 || count % 3 || strcmp(words[1], "run")) die("see the first lines of player.c");
    dressi_options options = {.profile = getenv("DRESSI_PROFILE"), .pin = getenv("DRESSI_PIN")};
    if (getenv("PLAYER_MEMORY")) {
        size_t size;
        unsigned char *data = load_file(words[2], &size), *odd = malloc(size + 1);
        memcpy(odd + 1, data, size);
        s = dressi_open_memory(odd + 1, size, &options, &error);
        memset(odd, 0, size + 1);
        free(odd);
        free(data);
    } else {
        s = dressi_open(words[2], &options, &error);
    }
    if (!s) must(error.code);
    for (int k = 3; k < count; k += 3) {
        if (!strcmp(words[k], "try")) try_to(words[k + 1], words[k + 2]);
        else perform(words[k], words[k + 1], words[k + 2]);
        fflush(stdout);
    }
    dressi_close(s);
    return 0;
}
