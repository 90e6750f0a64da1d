/* dressi.Session and dressi.Device for Java: each native method is one call of dressi.h. Buffers are direct and in the machine's order of
   bytes; an error becomes a dressi.DressiException. */

#include <jni.h>
#include <stdlib.h>
#include <string.h>

#include "dressi.h"

#define METHOD(type, name) JNIEXPORT type JNICALL Java_dressi_##name
#define SESSION(handle) ((dressi_session *)(intptr_t)(handle))
#define DEVICE(handle) ((dressi_device *)(intptr_t)(handle))

/* ---- Texts: UTF-8 here, UTF-16 there. JNI's own functions take and give another form of UTF-8. ---- */

/* The next character of a text that is UTF-8 but may be cut off at its end. */
static uint32_t next(const unsigned char **p) {
    uint32_t c = *(*p)++, more = c < 0x80 ? 0 : c >> 5 == 6 ? 1 : c >> 4 == 14 ? 2 : 3;
    if (more) c &= 0x3f >> more;
    for (; more && **p >> 6 == 2; more--) c = c << 6 | (*(*p)++ & 0x3f);
    return more ? 0xfffd : c;
}

static jstring to_java(JNIEnv *env, const char *text) {
    jchar *wide = malloc((strlen(text) + 1) * sizeof *wide);
    jsize length = 0;
    if (!wide) return NULL;
    for (const unsigned char *p = (const unsigned char *)text; *p;) {
        uint32_t c = next(&p);
        if (c >= 0x10000) wide[length++] = (jchar)(0xd800 + ((c - 0x10000) >> 10)), c = 0xdc00 + (c & 0x3ff);
        wide[length++] = (jchar)c;
    }
    jstring found = (*env)->NewString(env, wide, length);
    free(wide);
    return found;
}

/* Allocated; NULL stays NULL. */
static char *from_java(JNIEnv *env, jstring string) {
    if (!string) return NULL;
    jsize length = (*env)->GetStringLength(env, string);
    const jchar *wide = (*env)->GetStringChars(env, string, NULL);
    char *text = wide ? malloc(3 * (size_t)length + 1) : NULL, *to = text;
    for (jsize k = 0; text && k < length; k++) {
        uint32_t c = wide[k];
        if (c >> 10 == 0x36 && k + 1 < length && wide[k + 1] >> 10 == 0x37) c = 0x10000 + ((c & 0x3ff) << 10 | (wide[++k] & 0x3ff));
        if (c < 0x80) *to++ = (char)c;
        else if (c < 0x800) *to++ = (char)(0xc0 | c >> 6), *to++ = (char)(0x80 | (c & 63));
        else if (c < 0x10000) *to++ = (char)(0xe0 | c >> 12), *to++ = (char)(0x80 | (c >> 6 & 63)), *to++ = (char)(0x80 | (c & 63));
        else {
            *to++ = (char)(0xf0 | c >> 18), *to++ = (char)(0x80 | (c >> 12 & 63));
            *to++ = (char)(0x80 | (c >> 6 & 63)), *to++ = (char)(0x80 | (c & 63));
        }
    }
    if (text) *to = 0;
    if (wide) (*env)->ReleaseStringChars(env, string, wide);
    return text;
}

static void raise(JNIEnv *env, const dressi_error *error) {
    jclass type = (*env)->FindClass(env, "dressi/DressiException");
    if (!type) return; /* that it is not found is raised */
    jmethodID make = (*env)->GetMethodID(env, type, "<init>", "(ILjava/lang/String;)V");
    jstring text = make ? to_java(env, error->text) : NULL;
    jobject made = text ? (*env)->NewObject(env, type, make, (jint)error->code, text) : NULL;
    if (made) (*env)->Throw(env, (jthrowable)made);
}

static void check(JNIEnv *env, dressi_code code, const dressi_error *error) {
    if (code) raise(env, error);
}

/* Gives a text of the library to Java, or raises. */
static jstring give(JNIEnv *env, char *text, const dressi_error *error) {
    jstring found = text ? to_java(env, text) : NULL;
    if (!text) raise(env, error);
    dressi_free(text);
    return found;
}

/* `bytes` from `offset` on of a direct buffer, or NULL after raising. */
static char *bytes_of(JNIEnv *env, jobject buffer, jint offset, jint bytes) {
    char *at = buffer ? (*env)->GetDirectBufferAddress(env, buffer) : NULL;
    if (at && offset >= 0 && bytes >= 0 && (jlong)offset + bytes <= (*env)->GetDirectBufferCapacity(env, buffer)) return at + offset;
    raise(env, &(dressi_error){DRESSI_INPUT, "the buffer is not direct, or is shorter than its limit"});
    return NULL;
}

/* ---- dressi.Device ---- */

METHOD(jlong, Device_open)(JNIEnv *env, jclass type, jstring select) {
    (void)type;
    dressi_error error;
    char *w = from_java(env, select);
    dressi_device *device = dressi_device_open(w, &error);
    free(w);
    if (!device) raise(env, &error);
    return (jlong)(intptr_t)device;
}

METHOD(void, Device_close)(JNIEnv *env, jclass type, jlong device) {
    (void)env, (void)type;
    dressi_device_close(DEVICE(device));
}

METHOD(jstring, Device_name)(JNIEnv *env, jclass type, jlong device) {
    (void)type;
    return to_java(env, dressi_device_name(DEVICE(device)));
}

METHOD(jstring, Device_driver)(JNIEnv *env, jclass type, jlong device) {
    (void)type;
    return to_java(env, dressi_device_driver(DEVICE(device)));
}

METHOD(jstring, Device_profile)(JNIEnv *env, jclass type, jlong device, jstring name, jstring date) {
    (void)type;
    dressi_error error;
    char *n = from_java(env, name), *d = from_java(env, date);
    char *text = dressi_device_profile(DEVICE(device), n ? n : "", d ? d : "", &error);
    free(n), free(d);
    return give(env, text, &error);
}

/* ---- dressi.Session ---- */

METHOD(jlong, Session_open)(JNIEnv *env, jclass type, jstring path, jobject bytes, jint offset, jint size, jlong device, jstring profile,
                            jstring cache, jstring pin) {
    (void)type;
    dressi_error error;
    const char *data = path ? NULL : bytes_of(env, bytes, offset, size);
    if (!path && !data) return 0;
    char *p = from_java(env, path), *v = from_java(env, profile), *c = from_java(env, cache), *s = from_java(env, pin);
    dressi_options options = {.device = DEVICE(device), .profile = v, .cache = c, .pin = s};
    dressi_session *session = path ? dressi_open(p, &options, &error) : dressi_open_memory(data, (size_t)size, &options, &error);
    free(p), free(v), free(c), free(s);
    if (!session) raise(env, &error);
    return (jlong)(intptr_t)session;
}

METHOD(void, Session_close)(JNIEnv *env, jclass type, jlong session) {
    (void)env, (void)type;
    dressi_close(SESSION(session));
}

/* Of value k: role, whether it holds integers, channels, and its shape; its name is in names[0]. NULL if there is none. */
METHOD(jintArray, Session_value)(JNIEnv *env, jclass type, jlong session, jint k, jobjectArray names) {
    (void)type;
    dressi_value value;
    if (k < 0 || !dressi_value_at(SESSION(session), (uint32_t)k, &value)) return NULL;
    jint about[7] = {(jint)value.role, value.is_int, value.channels};
    for (int n = 0; n < value.rank; n++) about[3 + n] = (jint)value.shape[n];
    jintArray found = (*env)->NewIntArray(env, 3 + value.rank);
    jstring name = found ? to_java(env, value.name) : NULL;
    if (!name) return NULL;
    (*env)->SetIntArrayRegion(env, found, 0, 3 + value.rank, about);
    (*env)->SetObjectArrayElement(env, names, 0, name);
    return found;
}

METHOD(jstring, Session_phase)(JNIEnv *env, jclass type, jlong session, jint k, jlongArray steps) {
    (void)type;
    uint64_t count = 0;
    const char *name = k < 0 ? NULL : dressi_phase_at(SESSION(session), (uint32_t)k, &count);
    if (!name) return NULL;
    (*env)->SetLongArrayRegion(env, steps, 0, 1, &(jlong){(jlong)count});
    return to_java(env, name);
}

METHOD(void, Session_set)(JNIEnv *env, jclass type, jlong session, jstring name, jobject buffer, jint offset, jint bytes) {
    (void)type;
    dressi_error error;
    char *data = bytes_of(env, buffer, offset, bytes);
    if (!data) return;
    char *w = from_java(env, name);
    dressi_code code = dressi_set(SESSION(session), w ? w : "", data, (size_t)bytes, &error);
    free(w);
    check(env, code, &error);
}

METHOD(void, Session_get)(JNIEnv *env, jclass type, jlong session, jstring name, jobject buffer, jint offset, jint bytes) {
    (void)type;
    dressi_error error;
    char *data = bytes_of(env, buffer, offset, bytes);
    if (!data) return;
    char *w = from_java(env, name);
    dressi_code code = dressi_get(SESSION(session), w ? w : "", data, (size_t)bytes, &error);
    free(w);
    check(env, code, &error);
}

typedef struct Asked { JNIEnv *env; jobject stop; jmethodID method; } Asked;

/* Whether the AtomicBoolean is true, or something was raised. */
static int is_cancelled(void *context) {
    Asked *a = context;
    return (*a->env)->CallBooleanMethod(a->env, a->stop, a->method) || (*a->env)->ExceptionCheck(a->env);
}

METHOD(jlong, Session_step)(JNIEnv *env, jclass type, jlong session, jlong n, jstring phase, jdouble seconds, jobject stop) {
    (void)type;
    dressi_error error;
    uint64_t ran = 0;
    Asked asked = {env, stop, NULL};
    if (stop) {
        jclass atomic = (*env)->GetObjectClass(env, stop);
        asked.method = (*env)->GetMethodID(env, atomic, "get", "()Z");
        if (!asked.method) return 0;
    }
    if (n < 0) {
        raise(env, &(dressi_error){DRESSI_INPUT, "step: a count of 0 or more is needed"});
        return 0;
    }
    dressi_bound bound = {seconds, stop ? is_cancelled : NULL, &asked};
    char *w = from_java(env, phase);
    dressi_code code = dressi_step(SESSION(session), (uint64_t)n, w, seconds >= 0 || stop ? &bound : NULL, &ran, &error);
    free(w);
    if (!(*env)->ExceptionCheck(env)) check(env, code, &error);
    return (jlong)ran;
}

METHOD(jfloat, Session_loss)(JNIEnv *env, jclass type, jlong session) {
    (void)type;
    dressi_error error;
    float loss = 0;
    check(env, dressi_loss(SESSION(session), &loss, &error), &error);
    return loss;
}

METHOD(jstring, Session_report)(JNIEnv *env, jclass type, jlong session) {
    (void)type;
    dressi_error error;
    char *text = dressi_report(SESSION(session), &error);
    return give(env, text, &error);
}

METHOD(void, Session_checkpoint)(JNIEnv *env, jclass type, jlong session, jstring path) {
    (void)type;
    dressi_error error;
    char *w = from_java(env, path);
    dressi_code code = dressi_checkpoint(SESSION(session), w ? w : "", &error);
    free(w);
    check(env, code, &error);
}

METHOD(void, Session_restore)(JNIEnv *env, jclass type, jlong session, jstring path) {
    (void)type;
    dressi_error error;
    char *w = from_java(env, path);
    dressi_code code = dressi_restore(SESSION(session), w ? w : "", &error);
    free(w);
    check(env, code, &error);
}
