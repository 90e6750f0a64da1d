/* dressi-play: bundles on boards without Python.

   dressi-play run FILE [--phase P] [--steps N] [--seconds S] [--set NAME=ARRAY]... [--get NAME=ARRAY]... [--restore CHECKPOINT]
                        [--checkpoint CHECKPOINT] [--explain]
   dressi-play bench FILE [--steps N]
   dressi-play inspect FILE
   dressi-play verify FILE
   dressi-play capture --name NAME [--output FILE]
   dressi-play devices

   With all that plays: --device NAME, --profile NAME, --pin SHA256, --cache FOLDER. ARRAY is a file of the value's array, row-major,
   little-endian fp32 or int32. Exit status: 0, or the code of the error as in dressi.h; 3 is a word that is not understood. */

#include "inspect.h"

#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

enum { MOST_ARRAYS = 64, POINTS = 60 };

typedef struct Words {
    const char *file, *phase, *name, *output, *restore, *checkpoint, *set[MOST_ARRAYS], *get[MOST_ARRAYS];
    int set_count, get_count;
    uint64_t steps;
    double seconds;
    bool explain;
    dressi_options options;
} Words;

static volatile sig_atomic_t stopped;

static void stop(int number) {
    (void)number;
    stopped = 1;
}

static int is_stopped(void *context) {
    (void)context;
    return stopped;
}

/* ---- Words ---- */

static uint64_t count_of(Call *call, const char *what, const char *word) {
    char *end;
    uint64_t n = strtoull(word, &end, 10);
    if (*end || !*word || *word == '-' || !n) fail(call, DRESSI_INPUT, "%s %.60s: a number of 1 or more is needed", what, word);
    return n;
}

static void understand(Call *call, Words *w, int count, char **words) {
    const struct { const char *name; const char **to; } texts[] = {
        {"--phase", &w->phase}, {"--name", &w->name}, {"--output", &w->output}, {"--restore", &w->restore},
        {"--checkpoint", &w->checkpoint}, {"--device", &w->options.select}, {"--profile", &w->options.profile}, {"--pin", &w->options.pin},
        {"--cache", &w->options.cache}};
    w->seconds = -1;
    for (int k = 0; k < count; k++) {
        const char *word = words[k], *next = k + 1 < count ? words[k + 1] : NULL;
        if (word[0] != '-') {
            if (w->file) fail(call, DRESSI_INPUT, "%.200s: one bundle is enough", word);
            w->file = word;
            continue;
        }
        if (!strcmp(word, "--explain")) { w->explain = true; continue; }
        if (!next) fail(call, DRESSI_INPUT, "%.60s needs a word after it", word);
        k++;
        bool known = false;
        for (size_t n = 0; n < COUNT(texts) && !known; n++)
            if (!strcmp(word, texts[n].name)) *texts[n].to = next, known = true;
        if (known) continue;
        if (!strcmp(word, "--steps")) w->steps = count_of(call, word, next);
        else if (!strcmp(word, "--seconds")) w->seconds = (double)count_of(call, word, next);
        else if (!strcmp(word, "--set") || !strcmp(word, "--get")) {
            int *many = word[2] == 's' ? &w->set_count : &w->get_count;
            if (!strchr(next, '=')) fail(call, DRESSI_INPUT, "%s %.100s: NAME=FILE is needed", word, next);
            if (*many == MOST_ARRAYS) fail(call, DRESSI_INPUT, "%s: at most %d are allowed", word, MOST_ARRAYS);
            (word[2] == 's' ? w->set : w->get)[(*many)++] = next;
        } else fail(call, DRESSI_INPUT, "%.60s is not understood", word);
    }
}

static void check(Call *call, dressi_code code, const dressi_error *error) {
    if (code) fail(call, code, "%s", error->text);
}

/* ---- Arrays in files ---- */

static void set_array(Call *call, dressi_session *s, const char *word) {
    const char *file = strchr(word, '=') + 1;
    char name[256];
    dressi_error error;
    uint8_t *data = NULL;
    uint64_t size;
    snprintf(name, sizeof name, "%.*s", (int)(file - word - 1), word);
    const char *wrong = read_file(file, UINT64_C(1) << 32, false, &data, &size);
    dressi_code code = wrong ? DRESSI_INPUT : dressi_set(s, name, data, (size_t)size, &error);
    free(data);
    if (wrong) fail(call, DRESSI_INPUT, "%.200s cannot be read: %s", file, wrong);
    check(call, code, &error);
}

static void get_array(Call *call, dressi_session *s, const char *word) {
    const char *file = strchr(word, '=') + 1, *wrong = NULL;
    char name[256];
    dressi_error error;
    dressi_value value;
    snprintf(name, sizeof name, "%.*s", (int)(file - word - 1), word);
    check(call, dressi_find(s, name, &value, &error), &error);
    void *data = malloc(value.bytes);
    if (!data) fail(call, DRESSI_MEMORY, "no memory for %zu bytes of %.100s", value.bytes, name);
    dressi_code code = dressi_get(s, name, data, value.bytes, &error);
    if (!code) wrong = replace_file(file, &(Part){data, value.bytes}, 1, false);
    free(data);
    check(call, code, &error);
    if (wrong) fail(call, DRESSI_INPUT, "%.200s cannot be written: %s", file, wrong);
}

/* ---- Running ---- */

static bool has_loss(dressi_session *s, const char *phase) {
    char name[256];
    dressi_value value;
    snprintf(name, sizeof name, "%.240s.loss", phase);
    return !dressi_find(s, name, &value, NULL);
}

static void show_progress(const char *phase, uint64_t done, uint64_t steps, const float *loss, double each) {
    fprintf(stderr, "\r%s %llu/%llu", phase, (unsigned long long)done, (unsigned long long)steps);
    if (loss) fprintf(stderr, " loss %.5g", *loss);
    fprintf(stderr, " %.2f ms a step\033[K", each * 1e3);
}

/* Steps a phase and says how it goes on a terminal; false if it was stopped. */
static bool run_phase(Call *call, dressi_session *s, const char *phase, uint64_t steps, double end) {
    dressi_error error;
    bool lossy = has_loss(s, phase), shown = isatty(2);
    uint64_t done = 0, every = !shown ? steps : steps / POINTS ? steps / POINTS : 1, timed = 0;
    double spent = 0;
    float loss = 0, first = 0;
    check(call, dressi_step(s, 0, phase, NULL, NULL, &error), &error);
    if (lossy) check(call, dressi_loss(s, &first, &error), &error);
    while (done < steps && !stopped) {
        uint64_t ran, wanted = !done ? 1 : every < steps - done ? every : steps - done;
        double begin = seconds_now();
        dressi_bound bound = {end > 0 ? (end > begin ? end - begin : 0) : -1, is_stopped, NULL};
        check(call, dressi_step(s, wanted, phase, &bound, &ran, &error), &error);
        if (done) spent += seconds_now() - begin, timed += ran; /* the first holds the driver's compilation */
        done += ran;
        if (lossy && shown) check(call, dressi_loss(s, &loss, &error), &error);
        if (shown) show_progress(phase, done, steps, lossy ? &loss : NULL, timed ? spent / (double)timed : 0);
        if (ran < wanted) break;
    }
    if (lossy && !shown) check(call, dressi_loss(s, &loss, &error), &error);
    if (shown) fprintf(stderr, "\n");
    printf("%s: %llu steps", phase, (unsigned long long)done);
    if (lossy) printf(", loss %.6g -> %.6g", first, loss);
    printf(", %.3f ms a step\n", timed ? spent / (double)timed * 1e3 : 0.0);
    return done == steps;
}

static void run(Call *call, const Words *w, dressi_session *s) {
    dressi_error error;
    double end = w->seconds < 0 ? 0 : seconds_now() + w->seconds;
    bool found = false, whole = true;
    if (w->restore) check(call, dressi_restore(s, w->restore, &error), &error);
    for (int k = 0; k < w->set_count; k++) set_array(call, s, w->set[k]);
    signal(SIGINT, stop);
    for (uint32_t k = 0; dressi_phase_at(s, k, NULL) && whole; k++) {
        uint64_t steps;
        const char *phase = dressi_phase_at(s, k, &steps);
        if (w->phase && strcmp(w->phase, phase)) continue;
        found = true;
        if (w->steps) steps = w->steps;
        if (!steps) fail(call, DRESSI_INPUT, "phase %.100s says no number of steps; give --steps", phase);
        whole = run_phase(call, s, phase, steps, end);
    }
    if (w->phase && !found) fail(call, DRESSI_INPUT, "--phase %.60s is no phase of this bundle", w->phase);
    for (int k = 0; k < w->get_count; k++) get_array(call, s, w->get[k]);
    if (w->checkpoint) check(call, dressi_checkpoint(s, w->checkpoint, &error), &error);
    if (w->explain) {
        char *report = dressi_report(s, &error);
        if (!report) check(call, error.code, &error);
        printf("%s\n", report);
        dressi_free(report);
    }
}

static int by_size(const void *a, const void *b) {
    double x = *(const double *)a, y = *(const double *)b;
    return x < y ? -1 : x > y;
}

/* Host and device together: the time to the first step, and the median of single steps. */
static void bench(Call *call, const Words *w, dressi_session *s, double began) {
    uint64_t runs = w->steps ? w->steps : 20;
    double *times = malloc(runs * sizeof *times);
    dressi_error error;
    uint64_t steps;
    if (!times) fail(call, DRESSI_MEMORY, "no memory for %llu times", (unsigned long long)runs);
    printf("opened in %.1f ms\n", (seconds_now() - began) * 1e3);
    for (uint32_t k = 0; dressi_phase_at(s, k, &steps); k++) {
        const char *phase = dressi_phase_at(s, k, NULL);
        dressi_code code = DRESSI_OK;
        double begin = seconds_now();
        code = dressi_step(s, 1, phase, NULL, NULL, &error);
        double first = seconds_now() - begin;
        for (uint64_t n = 0; n < runs && !code; n++) {
            begin = seconds_now();
            code = dressi_step(s, 1, phase, NULL, NULL, &error);
            times[n] = seconds_now() - begin;
        }
        if (code) free(times);
        check(call, code, &error);
        qsort(times, runs, sizeof *times, by_size);
        printf("%s: the first step %.2f ms, then %.3f ms, the median of %llu (%.3f to %.3f)\n", phase, first * 1e3, times[runs / 2] * 1e3,
               (unsigned long long)runs, times[0] * 1e3, times[runs - 1] * 1e3);
    }
    free(times);
}

static void play(Call *call, const Words *w, bool benching) {
    double began = seconds_now();
    dressi_error error;
    Call inner;
    if (!w->file) fail(call, DRESSI_INPUT, "a bundle is needed");
    dressi_session *s = dressi_open(w->file, &w->options, &error);
    if (!s) check(call, error.code, &error);
    inner.error.code = DRESSI_OK;
    if (!setjmp(inner.out)) {
        if (benching) bench(&inner, w, s, began);
        else run(&inner, w, s);
    }
    dressi_close(s);
    if (inner.error.code) fail(call, inner.error.code, "%s", inner.error.text);
}

/* ---- Devices ---- */

static void capture(Call *call, const Words *w) {
    dressi_error error;
    char date[16];
    time_t now = time(NULL);
    if (!w->name) fail(call, DRESSI_INPUT, "--name is needed: 1 to 64 of a-z, 0-9 and _");
    strftime(date, sizeof date, "%Y-%m-%d", gmtime(&now));
    dressi_device *device = dressi_device_open(w->options.select, &error);
    if (!device) check(call, error.code, &error);
    char *text = dressi_device_profile(device, w->name, date, &error);
    dressi_device_close(device);
    if (!text) check(call, error.code, &error);
    const char *wrong = NULL;
    if (w->output) wrong = replace_file(w->output, &(Part){text, strlen(text)}, 1, false);
    else printf("%s", text);
    dressi_free(text);
    if (wrong) fail(call, DRESSI_INPUT, "%.200s cannot be written: %s", w->output, wrong);
    if (w->output) printf("%s: profile %s\n", w->output, w->name);
}

static void devices(Call *call) {
    dressi_error error;
    char *text = dressi_devices(&error);
    if (!text) check(call, error.code, &error);
    printf("%s", text);
    bool none = !*text;
    dressi_free(text);
    if (none) fail(call, DRESSI_DEVICE, "no Vulkan device found: install a driver, on Debian mesa-vulkan-drivers");
}

int main(int count, char **words) {
    static Words w;
    static Call call;
    const char *what = count > 1 ? words[1] : "";
    if (setjmp(call.out)) {
        fprintf(stderr, "dressi-play: %s\n", call.error.text);
        return call.error.code;
    }
    if (count > 1) understand(&call, &w, count - 2, words + 2);
    if (!strcmp(what, "run")) play(&call, &w, false);
    else if (!strcmp(what, "bench")) play(&call, &w, true);
    else if (!strcmp(what, "capture")) capture(&call, &w);
    else if (!strcmp(what, "devices")) devices(&call);
    else if (!w.file) fail(&call, DRESSI_INPUT, "needed: run, bench, inspect or verify with a bundle, capture --name NAME, or devices");
    else if (!strcmp(what, "inspect")) inspect(&call, w.file, w.options.pin);
    else if (!strcmp(what, "verify")) verify(&call, w.file, w.options.pin);
    else fail(&call, DRESSI_INPUT, "%.60s is none of run, bench, inspect, verify, capture, devices", what);
    return fflush(stdout) ? DRESSI_INPUT : 0;
}
