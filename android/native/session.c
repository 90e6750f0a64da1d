/* A loaded bundle on a device: open, set, get, step, close. Calls run one after another, under the session's lock. */

#include "session.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { MAX_SUBMIT = 1 << 16, BATCH = 8 << 20 }; /* iterations in one submission; bytes of uploads in one */
static const double CHUNK_SECONDS = 0.02;        /* of a bounded step: about what other calls wait for */

void *spare(Session *s, Call *call, uint64_t count, size_t size) { return grow(call, &s->scratch, count, size); }

/* ---- One call after another ---- */

static void release(Session *s, const char *why) {
    const Vulkan *vk = &s->device->vk;
    pthread_mutex_lock(&s->device->lock);
    vk->QueueWaitIdle(s->device->queue); /* lost or not: what was submitted may be destroyed */
    pthread_mutex_unlock(&s->device->lock);
    destroy_objects(s);
    s->is_closed = true;
    snprintf(s->closed, sizeof s->closed, "%s", why);
}

dressi_code serial(Session *s, void (*work)(Session *, Call *, void *), void *arguments, dressi_error *error) {
    Call call = {.error = {DRESSI_OK, ""}};
    if (s->process != (int)getpid()) { /* before the lock, which a fork may have left locked */
        call.error.code = DRESSI_DEVICE;
        snprintf(call.error.text, sizeof call.error.text, "the session belongs to process %d, of which this one is a fork; load the bundle "
                 "in this process", s->process);
        return told(&call, error);
    }
    __atomic_add_fetch(&s->arrived, 1, __ATOMIC_ACQ_REL);
    pthread_mutex_lock(&s->lock);
    __atomic_add_fetch(&s->entered, 1, __ATOMIC_ACQ_REL);
    if (!setjmp(call.out)) {
        if (s->is_closed) fail(&call, DRESSI_LOST, "%s", s->closed);
        work(s, &call, arguments);
    } else if (call.error.code == DRESSI_LOST && !s->is_closed) {
        char why[sizeof s->closed];
        snprintf(why, sizeof why, "the session is closed: %.100s was lost (%.200s); open device and bundle again, and restore the last "
                 "checkpoint there", s->device->properties.deviceName, call.error.text);
        release(s, why);
        snprintf(call.error.text, sizeof call.error.text, "%s", why);
    }
    drop(&s->scratch);
    pthread_mutex_unlock(&s->lock);
    return told(&call, error);
}

/* Lets those calls begin that are waiting now: the lock alone would mostly come back to whoever just gave it up. */
static void let_in(Session *s) {
    uint32_t arrived = __atomic_load_n(&s->arrived, __ATOMIC_ACQUIRE);
    double end = seconds_now() + 1;
    while ((int32_t)(__atomic_load_n(&s->entered, __ATOMIC_ACQUIRE) - arrived) < 0 && seconds_now() < end) rest(1e-4);
}

/* ---- Opening and closing ---- */

static void upload_data(Session *s, Call *call) {
    const Variant *v = s->v;
    Copy *copies = spare(s, call, v->image_count, sizeof *copies);
    uint32_t count = 0;
    uint64_t bytes = 0;
    for (uint32_t k = 0; k < v->image_count; k++) {
        const Image *image = v->images + k;
        const Value *value = image->value >= 0 ? v->values + image->value : NULL;
        int blob = value ? value->initial : image->data;
        bool filled = value && value->filled;
        if (blob < 0 && !filled) continue;
        if (count && bytes + image_bytes(image) > BATCH) {
            upload(s, call, copies, count);
            count = 0, bytes = 0;
        }
        copies[count++] = (Copy){k, filled ? value->texel : blob_data(&s->bundle, (uint32_t)blob), filled};
        bytes += image_bytes(image);
    }
    upload(s, call, copies, count);
}

static void open_session(Session *s, Call *call, const dressi_options *options) {
    s->why = grow(call, &s->bundle.arena, s->bundle.variant_count, sizeof *s->why);
    s->v = choose(call, &s->bundle.arena, &s->bundle, s->device, options->profile, &s->depth, s->why);
    prepare_plans(s, call);
    open_window(s, call);
    create_work(s, call);
    create_images(s, call);
    open_cache(s, call, options->cache);
    create_pipelines(s, call);
    keep_cache(s);
    settle(s, call);
    upload_data(s, call);
    trim(s, s->largest);
}

typedef struct Source { const char *path; const void *bytes; size_t size; } Source;

/* Closes what was opened so far, and forgets it. */
static void discard(Session *s) {
    if (s->v) release(s, "");
    if (s->owns_device) dressi_device_close(s->device);
    drop(&s->scratch);
    drop(&s->bundle.arena);
    pthread_mutex_destroy(&s->lock);
    free(s);
}

static void open_all(Session *s, Call *call, Source source, const dressi_options *options, uint8_t **data) {
    dressi_error inner;
    if (source.path) read_bundle_file(call, &s->bundle, source.path, options->pin, data);
    else read_bundle(call, &s->bundle, source.bytes, source.size, options->pin);
    s->device = options->device;
    if (s->device && s->device->process != s->process)
        fail(call, DRESSI_DEVICE, "the device was opened before this process was forked; open another");
    if (!s->device) {
        s->device = dressi_device_open(options->select, &inner);
        if (!s->device) fail(call, inner.code, "%s", inner.text);
        s->owns_device = true;
    }
    open_session(s, call, options);
    s->bundle.data = NULL; /* all that is needed is on the device */
    drop(&s->scratch);
}

/* What goes wrong is in `call`; `*data` is the file. */
static dressi_code try_to_open(Session *s, Call *call, Source source, const dressi_options *options, uint8_t **data) {
    if (!setjmp(call->out)) open_all(s, call, source, options, data);
    if (call->error.code == DRESSI_LOST) {
        char why[sizeof call->error.text];
        snprintf(why, sizeof why, "%.100s was lost (%.200s); open it again", s->device->properties.deviceName, call->error.text);
        memcpy(call->error.text, why, sizeof why);
    }
    return call->error.code;
}

static dressi_session *opened(Source source, const dressi_options *options, dressi_error *error) {
    static const dressi_options none;
    Call call = {.error = {DRESSI_OK, ""}};
    uint8_t *data = NULL;
    Session *s = calloc(1, sizeof *s);
    if (!s) {
        if (error) *error = (dressi_error){DRESSI_MEMORY, "no memory for a session"};
        return NULL;
    }
    pthread_mutex_init(&s->lock, NULL);
    s->process = (int)getpid();
    if (try_to_open(s, &call, source, options ? options : &none, &data)) {
        discard(s);
        s = NULL;
    }
    free(data);
    told(&call, error);
    return s;
}

dressi_session *dressi_open(const char *path, const dressi_options *options, dressi_error *error) {
    return opened((Source){path, NULL, 0}, options, error);
}

dressi_session *dressi_open_memory(const void *bytes, size_t size, const dressi_options *options, dressi_error *error) {
    return opened((Source){NULL, bytes, size}, options, error);
}

void dressi_close(dressi_session *s) {
    if (!s || s->process != (int)getpid()) return;
    if (s->is_closed) s->v = NULL; /* lost: its objects are gone */
    discard(s);
}

/* ---- Values ---- */

static const char *const ROLE_WORDS[] = {"input or state", "input or state or output"};

/* The number of a value; `outputs`: outputs are meant, too. */
static uint32_t find_value(const Session *s, Call *call, const char *name, bool outputs) {
    Text names = {0};
    char line[300];
    for (uint32_t k = 0; k < s->v->value_count; k++) {
        const Value *value = s->v->values + k;
        if (value->role == COPY || (value->role == OUTPUT && !outputs)) continue;
        if (!strcmp(value->name, name)) {
            free(names.at);
            return k;
        }
        say(&names, "%s%s", names.length ? " " : "", value->name);
    }
    snprintf(line, sizeof line, "%s", names.at ? names.at : "none");
    free(names.at);
    fail(call, DRESSI_INPUT, "'%.58s' is no %s of this bundle; there are: %s", name, ROLE_WORDS[outputs], line);
}

uint32_t dressi_value_count(const dressi_session *s) {
    uint32_t count = 0;
    for (uint32_t k = 0; k < s->v->value_count; k++) count += s->v->values[k].role != COPY;
    return count;
}

int dressi_value_at(const dressi_session *s, uint32_t n, dressi_value *value) {
    for (uint32_t k = 0; k < s->v->value_count; k++)
        if (s->v->values[k].role != COPY && !n--) {
            describe_value(s->v->values + k, value);
            return 1;
        }
    return 0;
}

dressi_code dressi_find(const dressi_session *s, const char *name, dressi_value *value, dressi_error *error) {
    Call call = {.error = {DRESSI_OK, ""}};
    if (!setjmp(call.out)) describe_value(s->v->values + find_value(s, &call, name, true), value);
    return told(&call, error);
}

const char *dressi_phase_at(const dressi_session *s, uint32_t k, uint64_t *steps) {
    if (k >= s->phases.count) return NULL;
    if (steps) *steps = s->v->plans[s->phases.at[k]].steps;
    return s->v->plans[s->phases.at[k]].name;
}

typedef struct Transfer { const char *name; const void *from; void *to; size_t bytes; } Transfer;

static uint32_t check_transfer(Session *s, Call *call, const Transfer *t) {
    uint32_t k = find_value(s, call, t->name, t->to);
    dressi_value about;
    describe_value(s->v->values + k, &about);
    if (about.bytes == t->bytes) return k;
    char shape[64] = "";
    for (int n = 0; n < about.rank; n++)
        snprintf(shape + strlen(shape), sizeof shape - strlen(shape), "%s%u", n ? ", " : "", about.shape[n]);
    fail(call, DRESSI_INPUT, "%.100s: the array has %zu bytes; %zu are needed, of shape (%s) and type %s", t->name, t->bytes,
        about.bytes, shape,
         about.is_int ? "int32" : "float");
}

static void set_value(Session *s, Call *call, void *arguments) {
    const Transfer *t = arguments;
    uint32_t k = check_transfer(s, call, t);
    const Value *value = s->v->values + k;
    const Image *image = s->v->images + value->image;
    settle(s, call);
    reserve(s, call, image_bytes(image));
    to_texels(call, value, image->format, t->from, s->staging.view);
    give_back(s, call, (Indices){1, &k});
    start(s, call);
    copy_in(s, &value->image, 1);
    finish(s, call);
    s->version[k]++;
    s->given[k] = true;
    forget_window(s, k);
    trim(s, s->largest);
}

dressi_code dressi_set(dressi_session *s, const char *name, const void *array, size_t bytes, dressi_error *error) {
    return serial(s, set_value, &(Transfer){name, array, NULL, bytes}, error);
}

static void get_value(Session *s, Call *call, void *arguments) {
    const Transfer *t = arguments;
    uint32_t k = check_transfer(s, call, t), giver = 0;
    const Value *value = s->v->values + k;
    const Image *image = s->v->images + value->image;
    if (value->role == OUTPUT) {
        while (giver < s->v->plan_count && !has(s->v->plans[giver].outputs, k)) giver++;
        if (giver == s->v->plan_count) fail(call, DRESSI_INPUT, "%.100s is given out by no plan", t->name);
        if (!s->v->plans[giver].updates.count) {
            look(s, call, giver, 1);
            run_if_changed(s, call, giver, false);
        }
        else if (!s->plans[giver].runs)
            fail(call, DRESSI_INPUT, "%.100s is given out by %.100s, which has not run yet", t->name, s->v->plans[giver].name);
    } else if (!s->given[k]) {
        fail(call, DRESSI_INPUT, "%.100s has no value yet; set it first", t->name);
    }
    give_back(s, call, (Indices){1, &k});
    reserve(s, call, image_bytes(image));
    start(s, call);
    copy_out(s, &value->image, 1);
    finish(s, call);
    from_texels(value, image->format, s->staging.view, t->to);
}

dressi_code dressi_get(dressi_session *s, const char *name, void *array, size_t bytes, dressi_error *error) {
    return serial(s, get_value, &(Transfer){name, NULL, array, bytes}, error);
}

/* ---- Steps ---- */

typedef struct Steps { uint64_t n, done; const char *phase; double seconds; bool warm; } Steps;

static void choose_phase(Session *s, Call *call, void *arguments) {
    const Steps *steps = arguments;
    char names[300] = "";
    uint32_t k = 0;
    for (; steps->phase && k < s->phases.count && strcmp(s->v->plans[s->phases.at[k]].name, steps->phase); k++)
        snprintf(names + strlen(names), sizeof names - strlen(names), "%s%s", k ? " " : "", s->v->plans[s->phases.at[k]].name);
    if (steps->phase && k == s->phases.count)
        fail(call, DRESSI_INPUT, "'%.58s' is no phase of this bundle; there are: %s", steps->phase, names);
    if (steps->phase) s->phase = (int)k;
    if (s->phase < 0) fail(call, DRESSI_INPUT, "this bundle updates nothing: there is no phase to step");
}

static void step_all(Session *s, Call *call, void *arguments) {
    Steps *steps = arguments;
    choose_phase(s, call, steps);
    while (steps->done < steps->n) {
        uint64_t left = steps->n - steps->done, now = left < MAX_SUBMIT ? left : MAX_SUBMIT;
        run_steps(s, call, s->phases.at[s->phase], now);
        steps->done += now;
        drop(&s->scratch);
    }
}

/* Of a bounded step: `done` holds the phase's plan, so that it stays the same whatever other calls choose. */
static void step_chunk(Session *s, Call *call, void *arguments) {
    Steps *steps = arguments;
    double begin = seconds_now();
    steps->warm = s->plans[steps->done].kept; /* in the first run of all the driver may compile */
    run_steps(s, call, (uint32_t)steps->done, steps->n);
    steps->seconds = seconds_now() - begin;
}

static void find_phase(Session *s, Call *call, void *arguments) {
    choose_phase(s, call, arguments);
    ((Steps *)arguments)->done = s->phases.at[s->phase];
}

dressi_code dressi_step(dressi_session *s, uint64_t n, const char *phase, const dressi_bound *bound, uint64_t *done, dressi_error *error) {
    Steps steps = {.n = n, .phase = phase};
    dressi_code code;
    if (done) *done = 0;
    if (!bound) {
        code = serial(s, step_all, &steps, error);
        if (done) *done = steps.done;
        return code;
    }
    code = serial(s, find_phase, &steps, error);
    double end = seconds_now() + bound->seconds, pace = 0;
    uint64_t ran = 0, size = 1;
    while (!code && ran < n && !(bound->cancel && bound->cancel(bound->context))) {
        double left = bound->seconds < 0 ? 1e9 : end - seconds_now();
        if (left <= pace) break;
        if (pace > 0) {
            double fits = (left < CHUNK_SECONDS ? left : CHUNK_SECONDS) / pace;
            size = fits < 2.0 * size ? (uint64_t)fits : 2 * size;
            size = size < 1 ? 1 : size > MAX_SUBMIT ? MAX_SUBMIT : size;
        }
        steps.n = size = size < n - ran ? size : n - ran;
        let_in(s);
        code = serial(s, step_chunk, &steps, error);
        if (code) break;
        pace = steps.warm ? steps.seconds / size : 0;
        ran += size;
        if (done) *done = ran;
    }
    return code;
}

static void get_loss(Session *s, Call *call, void *arguments) {
    char name[240];
    if (s->phase < 0) fail(call, DRESSI_INPUT, "this bundle updates nothing: there is no phase with a loss");
    snprintf(name, sizeof name, "%s.loss", s->v->plans[s->phases.at[s->phase]].name);
    get_value(s, call, &(Transfer){name, NULL, arguments, sizeof(float)});
}

dressi_code dressi_loss(dressi_session *s, float *loss, dressi_error *error) { return serial(s, get_loss, loss, error); }
