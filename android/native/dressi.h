/* libdressi: plays a bundle on a Vulkan device. In: a .dressi file and arrays. Out: arrays, files of checkpoints, words.

   C11; of the system it uses the C library, pthread and dlopen, and loads Vulkan (1.0 suffices) when a device is first asked for.

       dressi_error error;
       dressi_session *s = dressi_open("pear.dressi", NULL, &error);
       if (!s || dressi_set(s, "targets", pixels, bytes, &error) || dressi_step(s, 100, NULL, NULL, NULL, &error)
              || dressi_get(s, "vertices", vertices, sizeof vertices, &error))
           puts(error.text);
       dressi_close(s);

   Arrays are packed, in row-major order, of float (IEEE 754, 32 bits) or int32_t in the order of bytes of the machine; their
   shapes are those of docs/bundle-format.md: (), (channels), (count, channels), (height, width, channels) or (count, height,
   width, channels), without the last axis where there is one channel. Rows of pictures go from the top. Texts are UTF-8.

   Errors. A function that can fail returns a code, or a pointer that is NULL, and fills `*error` (which may be NULL): the code and
   a sentence that says what is wrong, what was found, what is allowed. After an error the session is as if the call had not been
   made, but for DRESSI_LOST, and iterations that were run stay.

   Threads. Calls on a session from several threads run one after another; while one is in dressi_step with a bound, the others'
   begin between its chunks, in about 20 ms. Sessions are independent; several may share a device. dressi_close and
   dressi_device_close must be the last call on their object. After a fork an object belongs to the parent: in the child calls
   give DRESSI_DEVICE, and closing does nothing. */

#ifndef DRESSI_H
#define DRESSI_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#if defined(__GNUC__) && !defined(DRESSI_HIDDEN)
#define DRESSI_API __attribute__((visibility("default")))
#else
#define DRESSI_API
#endif

typedef enum dressi_code {
    DRESSI_OK = 0,
    DRESSI_MEMORY = 1, /* of the host or the device; the session is usable */
    DRESSI_BUNDLE = 2, /* a bundle or checkpoint that is malformed, damaged, or does not belong here */
    DRESSI_INPUT = 3,  /* a name, array, number or path that cannot be used */
    DRESSI_DEVICE = 4, /* no Vulkan, no such device, one too small for the bundle, a call of Vulkan that failed */
    DRESSI_LOST = 5    /* the device is gone, and with it the session: close both, open them again and restore a checkpoint */
} dressi_code;

typedef struct dressi_error {
    dressi_code code;
    char text[1000];
} dressi_error;

typedef struct dressi_device dressi_device;
typedef struct dressi_session dressi_session;

/* ---- Bundles, without a device ---- */

/* Whether a file is a sound bundle: every check of docs/bundle-format.md, and no call of Vulkan. `pin`: NULL, or the SHA-256 (64
   hexadecimal digits) that the file must have. The text of an error is that of the Python reader. */
DRESSI_API dressi_code dressi_check(const char *path, const char *pin, dressi_error *error);

/* The same of `size` bytes in memory, of any alignment. */
DRESSI_API dressi_code dressi_check_memory(const void *bytes, size_t size, const char *pin, dressi_error *error);

/* ---- Devices ---- */

/* Opens a device. `select`: its number or a part of its name, in any case; NULL: $DRESSI_DEVICE, or the best there is (discrete
   before integrated, virtual, CPU). The caller closes it, after the sessions on it. */
DRESSI_API dressi_device *dressi_device_open(const char *select, dressi_error *error);
DRESSI_API void dressi_device_close(dressi_device *device);

/* Name and driver, for people; valid until the device is closed. */
DRESSI_API const char *dressi_device_name(const dressi_device *device);
DRESSI_API const char *dressi_device_driver(const dressi_device *device);

/* What the device allows, as the JSON of a device profile: what `dressi-edge compile -p FILE` takes. `name`: 1 to 64 of a-z, 0-9
   and _; `date`: like 2025-01-31. Returns a text that the caller gives to dressi_free. */
DRESSI_API char *dressi_device_profile(const dressi_device *device, const char *name, const char *date, dressi_error *error);

/* The devices there are, one a line: number, name, kind and driver. Returns a text that the caller gives to dressi_free. */
DRESSI_API char *dressi_devices(dressi_error *error);

DRESSI_API void dressi_free(char *text);

/* ---- Sessions ---- */

typedef struct dressi_options {
    dressi_device *device; /* borrowed; NULL: the session opens one by `select` and closes it */
    const char *select;    /* as of dressi_device_open */
    const char *profile;   /* of several variants the one made for it; NULL: the first that fits */
    const char *cache;     /* a folder for compiled pipelines, or "off"; NULL: $DRESSI_CACHE, $XDG_CACHE_HOME/dressi_edge or
                              ~/.cache/dressi_edge */
    const char *pin;       /* as of dressi_check */
} dressi_options;

/* Opens a bundle; `options` may be NULL, and are not kept. Everything is checked before a driver sees it. */
DRESSI_API dressi_session *dressi_open(const char *path, const dressi_options *options, dressi_error *error);

/* The same of bytes in memory, which need not outlast the call. */
DRESSI_API dressi_session *dressi_open_memory(const void *bytes, size_t size, const dressi_options *options, dressi_error *error);

/* Gives everything back; waits for what runs. NULL is fine. */
DRESSI_API void dressi_close(dressi_session *session);

typedef enum dressi_role { DRESSI_IN, DRESSI_STATE, DRESSI_OUT } dressi_role;

typedef struct dressi_value {
    const char *name; /* lives as long as the session */
    dressi_role role; /* inputs are set; states are updated by steps, set and got; outputs are got */
    int is_int;       /* int32_t, else float */
    int channels;     /* 1 to 4 */
    int rank;         /* how many of `shape` there are, 0 to 4 */
    uint32_t shape[4];
    size_t bytes;     /* of the whole array */
} dressi_value;

/* How many values there are, and the k-th, in the bundle's order; 0 if there is no such. */
DRESSI_API uint32_t dressi_value_count(const dressi_session *session);
DRESSI_API int dressi_value_at(const dressi_session *session, uint32_t k, dressi_value *value);
DRESSI_API dressi_code dressi_find(const dressi_session *session, const char *name, dressi_value *value, dressi_error *error);

/* Names of the phases, in the order of their schedule, and how often that wants them run (0: no wish); NULL if there is no such. */
DRESSI_API const char *dressi_phase_at(const dressi_session *session, uint32_t k, uint64_t *steps);

/* A new value for an input or state: `bytes` must be those of the value. Floats must be finite; where the bundle stores 16 bits a
   channel they are rounded to fp16, and must be finite there, too. */
DRESSI_API dressi_code dressi_set(dressi_session *session, const char *name, const void *array, size_t bytes, dressi_error *error);

/* The value of an input, state or output now, into `bytes` at `array`; outputs are computed if what they need has changed. */
DRESSI_API dressi_code dressi_get(dressi_session *session, const char *name, void *array, size_t bytes, dressi_error *error);

typedef struct dressi_bound {
    double seconds;               /* no iteration begins that the one before says would end later; below 0: no bound */
    int (*cancel)(void *context); /* asked between chunks, without the session's lock: not 0 stops. NULL: never */
    void *context;
} dressi_bound;

/* Runs n iterations of a phase (NULL: the current one, at first the first). Without a bound they are one submission (one per
   65,536); with one, chunks of about 20 ms. `*done` (may be NULL) is how many were run, after an error, too. */
DRESSI_API dressi_code dressi_step(dressi_session *session, uint64_t n, const char *phase, const dressi_bound *bound, uint64_t *done,
                                   dressi_error *error);

/* ---- Many views: pictures that come to the device as steps need them (docs/job.md, "Many views") ---- */

typedef struct dressi_picture {
    uint32_t views, width, height; /* how many pictures there are, and the size of each */
    int bits;                      /* a channel: 8 (uint8_t), 16 (uint16_t) or 32 (float) */
    size_t bytes;                  /* of one */
} dressi_picture;

/* Whether the bundle is one of those, and what its pictures are: rows from the top, of R G B A, straight colour as in the file. */
DRESSI_API int dressi_picture_of(const dressi_session *session, dressi_picture *about);

/* Writes picture `view` to `pixels`. Not 0: it cannot be had, and the call that needs it fails with DRESSI_INPUT. It is called by
   dressi_step, dressi_get and dressi_loss, on their thread, and must not call the session. */
typedef int (*dressi_read)(void *context, uint32_t view, void *pixels);

/* Where pictures come from, from now on (NULL: from dressi_set, as does the view of each step, PHASE.view). The session then keeps the
   window filled and says which view a step sees; what it had is forgotten, so the same call says that pictures have changed. */
DRESSI_API dressi_code dressi_pictures(dressi_session *session, dressi_read read, void *context, dressi_error *error);

/* The loss of the current phase at the current state: the output "PHASE.loss". */
DRESSI_API dressi_code dressi_loss(dressi_session *session, float *loss, dressi_error *error);

/* What the session did and occupies, as a JSON object with the keys of the Python session's report(): device, driver, profile,
   variants (of each why it was taken or not), phase, runs, skipped, image_bytes, staging_bytes (bytes), pipelines, pipeline_cache.
   Returns a text that the caller gives to dressi_free. */
DRESSI_API char *dressi_report(dressi_session *session, dressi_error *error);

/* Writes states, inputs and counters to a file, atomically: after an error, a kill or a power cut the old one or the new one is
   there. Restores those of the same bundle, written by this library or by Python: what follows is what followed there, on the same
   device and variant bit for bit. */
DRESSI_API dressi_code dressi_checkpoint(dressi_session *session, const char *path, dressi_error *error);
DRESSI_API dressi_code dressi_restore(dressi_session *session, const char *path, dressi_error *error);

#ifdef __cplusplus
}
#endif

#endif
