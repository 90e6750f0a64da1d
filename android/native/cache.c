/* Compiled pipelines kept from one process to the next: dressi_edge/cache/pipeline_cache.py in C. Files, keys and folder are the same, so
   that what one of them has compiled the other finds. A folder that cannot be read or written costs time, never an error.

   A driver takes its blob as it takes its own code, and no checksum tells who wrote it. So only what nobody but this user (and root)
   could have written reaches a driver: files of ours in a folder of ours, which others may neither write to nor exchange. */

#include "session.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

enum { HEAD = 88, DRIVER_HEAD = 32, MAX_FOLDER = 64 << 20, STALE_SECONDS = 3600 };
static const char SUFFIX[] = ".pipelines";

/* ---- Where, and under which name ---- */

static char *joined(const char *a, const char *b) {
    size_t size = strlen(a) + strlen(b) + 2;
    char *found = malloc(size);
    if (found) snprintf(found, size, "%s/%s", a, b);
    return found;
}

static char *find_folder(const char *chosen, const char **why) {
    const char *home = getenv("HOME"), *base = getenv("XDG_CACHE_HOME");
    bool asked = chosen;
    if (!chosen) chosen = getenv("DRESSI_CACHE");
    if (!chosen) chosen = "";
    *why = "no memory";
    if (!strcmp(chosen, "off")) *why = asked ? "as asked for" : "DRESSI_CACHE=off";
    else if (*chosen && strncmp(chosen, "~/", 2)) return strdup(chosen);
    else if (!*chosen && base && *base == '/') return joined(base, "dressi_edge");
    else if (home && *home) return joined(home, *chosen ? chosen + 2 : ".cache/dressi_edge");
    else *why = "there is no home folder";
    return NULL;
}

/* Why others could change or exchange a folder on the way to `path`, which is judged itself if `last`; true if they could. */
static bool is_open(const char *path, bool last, uid_t root, char *why, size_t room) {
    struct stat about;
    if (lstat(path, &about) || S_ISLNK(about.st_mode)) return false; /* not there yet; or as safe as the folder that it is in */
    bool mine = about.st_uid == geteuid() || (!last && (!about.st_uid || about.st_uid == root));
    bool private_group = !last && about.st_gid == about.st_uid; /* a group of the user alone, as many systems make them */
    bool exchanged = last || !(about.st_mode & S_ISVTX);
    if (!mine)
        snprintf(why, room, "%s belongs to another user (%u); set DRESSI_CACHE to a folder of your own", path, (unsigned)about.st_uid);
    else if (exchanged && about.st_mode & (private_group ? S_IWOTH : S_IWOTH | S_IWGRP))
        snprintf(why, room, "%s can be written to by others; chmod go-w it, or set DRESSI_CACHE to a folder of your own", path);
    else return false;
    return true;
}

/* Whether no driver is given a file of this folder, as `distrusted` in Python has it: both the way that its name goes and the way that it
   really lies. */
static bool distrusted(const char *folder, char *why, size_t room) {
    struct stat top;
    char *real = realpath(folder, NULL), *name = *folder == '/' ? strdup(folder) : NULL, *cwd = name ? NULL : realpath(".", NULL);
    if (!name && cwd) name = joined(cwd, folder);
    uid_t root = stat("/", &top) ? 0 : top.st_uid; /* who owns it may do anything; in a sandbox that is not 0 */
    bool found = !name;
    if (found) snprintf(why, room, "no memory");
    for (int k = 0; k < 2 && !found; k++) {
        char *at = k ? real : name;
        bool last = k || !real || !strcmp(name, real);
        while (at && *at && !found) {
            found = is_open(at, last, root, why, room);
            char *slash = strrchr(at, '/');
            last = false;
            if (slash == at && !at[1]) break;
            slash[slash == at] = 0; /* the root is the last of all */
        }
    }
    free(real);
    free(name);
    free(cwd);
    return found;
}

/* SHA-256 of the words in which Python writes the same key. */
static void make_key(Session *s, Call *call) {
    const dressi_device *d = s->device;
    char bundle[65], ids[2][2 * VK_UUID_SIZE + 1] = {"", ""};
    Text words = {0}, key = {0};
    hexadecimal(s->bundle.digest, 32, bundle);
    if (d->has_ids) hexadecimal(d->device_uuid, VK_UUID_SIZE, ids[0]), hexadecimal(d->driver_uuid, VK_UUID_SIZE, ids[1]);
    say(&words, "%s\n%s\n%s\n%s\n%s", d->properties.deviceName, d->driver_name, d->driver_info, ids[0], ids[1]);
    say(&key, "('%s', %u, %u, %u, ", bundle, d->properties.vendorID, d->properties.deviceID, d->properties.driverVersion);
    say_repr(&key, BINARY, d->properties.pipelineCacheUUID, VK_UUID_SIZE);
    say(&key, ", ");
    say_repr(&key, STRING, (const uint8_t *)words.at, words.length);
    say(&key, ")");
    bool sound = !words.broken && !key.broken;
    if (sound) sha256(key.at, key.length, s->cache.key);
    free(words.at);
    free(key.at);
    if (!sound) fail(call, DRESSI_MEMORY, "no memory for the key of compiled pipelines");
}

static char *file_of(const Session *s) {
    char name[40 + sizeof SUFFIX];
    hexadecimal(s->cache.key, 20, name);
    strcpy(name + 40, SUFFIX);
    return joined(s->cache.folder, name);
}

/* ---- Files ---- */

/* Whether a driver's blob begins with Vulkan's header, of this device. */
static bool belongs(const Session *s, const uint8_t *data, uint64_t size) {
    const VkPhysicalDeviceProperties *p = &s->device->properties;
    if (size < DRIVER_HEAD || little32(data) < DRIVER_HEAD || little32(data) > size || little32(data + 4) != 1) return false;
    if (little32(data + 8) != p->vendorID || little32(data + 12) != p->deviceID) return false;
    return !memcmp(data + 16, p->pipelineCacheUUID, VK_UUID_SIZE);
}

static void make_head(const Session *s, const uint8_t *data, uint64_t size, uint8_t head[HEAD]) {
    memset(head, 0, HEAD);
    memcpy(head, "DRESSIPC\1", 9);
    for (int k = 0; k < 8; k++) head[16 + k] = (uint8_t)(size >> 8 * k);
    memcpy(head + 24, s->cache.key, 32);
    sha256(data, size, head + 56);
}

/* The file's bytes, marked as used, if it is whole and of this device: the blob lies at HEAD. */
static uint8_t *load(const Session *s, size_t *size) {
    uint8_t *data = NULL, head[HEAD];
    uint64_t found;
    char *path = file_of(s);
    const char *wrong = path ? read_file(path, MAX_FOLDER, true, &data, &found) : "no memory";
    bool sound = !wrong && found >= HEAD && found <= MAX_FOLDER;
    if (sound) {
        make_head(s, data + HEAD, found - HEAD, head);
        sound = !memcmp(data, head, HEAD) && belongs(s, data + HEAD, found - HEAD);
    }
    if (sound) utimensat(AT_FDCWD, path, NULL, 0);
    free(path);
    if (sound) { *size = (size_t)(found - HEAD); return data; }
    free(data);
    return NULL;
}

typedef struct Entry { char *path; uint64_t size, time; } Entry;

/* Removes those used least recently until the folder has at most 64 MiB; other processes may do the same at the same time. */
static void trim_folder(const Session *s, const char *kept) {
    DIR *folder = opendir(s->cache.folder);
    Entry *entries = NULL;
    size_t count = 0;
    uint64_t total = 0;
    for (struct dirent *item; folder && (item = readdir(folder));) {
        size_t length = strlen(item->d_name);
        if (length < sizeof SUFFIX || (strcmp(item->d_name + length - sizeof SUFFIX + 1, SUFFIX) && item->d_name[0] != '.')) continue;
        if (item->d_name[0] == '.' && !strstr(item->d_name, SUFFIX)) continue; /* not ours */
        char *path = joined(s->cache.folder, item->d_name);
        struct stat about;
        Entry *more = path && !lstat(path, &about) && S_ISREG(about.st_mode) ? realloc(entries, (count + 1) * sizeof *entries) : NULL;
        if (more) entries = more;
        if (more && item->d_name[0] == '.') {
            if (time(NULL) - about.st_mtim.tv_sec > STALE_SECONDS) unlink(path);
        } else if (more) {
            total += (uint64_t)about.st_size;
            if (strcmp(path, kept)) {
                entries[count++] = (Entry){path, (uint64_t)about.st_size,
                    (uint64_t)about.st_mtim.tv_sec * 1000000000 + (uint64_t)about.st_mtim.tv_nsec};
                continue;
            }
        }
        free(path);
    }
    if (folder) closedir(folder);
    while (total > MAX_FOLDER && count) {
        size_t oldest = 0;
        for (size_t k = 1; k < count; k++)
            if (entries[k].time < entries[oldest].time) oldest = k;
        unlink(entries[oldest].path);
        total -= entries[oldest].size;
        free(entries[oldest].path);
        entries[oldest] = entries[--count];
    }
    while (count) free(entries[--count].path);
    free(entries);
}

static void make_folder(const char *path) {
    char *part = strdup(path);
    for (char *p = part; p && *p; p++)
        if (p[1] == '/' || !p[1]) {
            char end = p[1];
            p[1] = 0;
            mkdir(part, 0700);
            p[1] = end;
        }
    free(part);
}

static void store(Session *s, const uint8_t *data, size_t size, char *why, size_t room) {
    uint8_t head[HEAD];
    *why = 0;
    if (!belongs(s, data, size)) { snprintf(why, room, "the driver's blob is not of this device"); return; }
    if (size > MAX_FOLDER - HEAD) {
        snprintf(why, room, "the driver's blob has %zu bytes; %d are allowed", size, MAX_FOLDER - HEAD);
        return;
    }
    make_head(s, data, size, head);
    make_folder(s->cache.folder);
    if (distrusted(s->cache.folder, why, room)) return;
    char *path = file_of(s);
    const char *wrong = path ? replace_file(path, (Part[]){{head, HEAD}, {data, size}}, 2, true) : "no memory";
    if (wrong) snprintf(why, room, "%s: %s", s->cache.folder, wrong);
    else trim_folder(s, path);
    free(path);
}

/* ---- The driver's cache ---- */

void open_cache(Session *s, Call *call, const char *folder) {
    Cache *cache = &s->cache;
    const char *why;
    size_t size = 0;
    cache->size = DRIVER_HEAD;
    cache->folder = find_folder(folder, &why);
    char open[sizeof cache->state - 8];
    if (cache->folder && distrusted(cache->folder, open, sizeof open)) {
        free(cache->folder);
        cache->folder = NULL;
        why = open;
    }
    if (!cache->folder) {
        snprintf(cache->state, sizeof cache->state, "off (%s)", why);
        return;
    }
    make_key(s, call);
    uint8_t *data = load(s, &size);
    VkPipelineCacheCreateInfo info = {TYPE(PIPELINE_CACHE_CREATE_INFO), .initialDataSize = size, .pInitialData = data ? data + HEAD : NULL};
    VkResult result = s->device->vk.CreatePipelineCache(s->device->device, &info, NULL, &cache->handle);
    if (result != VK_SUCCESS) {
        cache->handle = VK_NULL_HANDLE;
        snprintf(cache->state, sizeof cache->state, "off (vkCreatePipelineCache failed with %s)", result_name(result));
    } else {
        strcpy(cache->state, data ? "hit" : "miss");
        if (data) cache->size = size;
    }
    free(data);
}

/* Writes the file if the driver's blob has grown: after pipelines were made, and after they first ran; some drivers compile that
   late. */
void keep_cache(Session *s) {
    Cache *cache = &s->cache;
    const Vulkan *vk = &s->device->vk;
    size_t size = 0;
    char why[sizeof cache->state - 8];
    if (!cache->handle || !cache->folder || vk->GetPipelineCacheData(s->device->device, cache->handle, &size, NULL) != VK_SUCCESS) return;
    if (size <= cache->size) {
        if (!strcmp(cache->state, "miss")) strcpy(cache->state, "empty (the driver puts nothing into it)");
        return;
    }
    uint8_t *data = malloc(size);
    if (data && vk->GetPipelineCacheData(s->device->device, cache->handle, &size, data) == VK_SUCCESS) {
        cache->size = size;
        store(s, data, size, why, sizeof why);
        if (*why) {
            free(cache->folder);
            cache->folder = NULL;
        }
        if (strcmp(cache->state, "hit")) snprintf(cache->state, sizeof cache->state, *why ? "off (%s)" : "stored", why);
    }
    free(data);
}

void close_cache(Session *s) {
    s->device->vk.DestroyPipelineCache(s->device->device, s->cache.handle, NULL);
    free(s->cache.folder);
    s->cache.handle = VK_NULL_HANDLE, s->cache.folder = NULL;
}
