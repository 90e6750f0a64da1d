/* Files: read whole if they are regular, replaced whole or not at all. */

#include "inside.h"

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

const char TOO_LARGE[] = "it has more bytes than are allowed";

/* A pipe or a device would block when it is opened; what the name stands for is asked of the opened file, not before. */
const char *read_file(const char *path, uint64_t most, bool only_ours, uint8_t **data, uint64_t *size) {
    int file = open(path, O_RDONLY | O_CLOEXEC | O_NONBLOCK | O_NOCTTY | (only_ours ? O_NOFOLLOW : 0));
    if (file < 0) return strerror(errno);
    struct stat about;
    const char *wrong = NULL;
    *size = 0;
    if (fstat(file, &about)) wrong = strerror(errno);
    else if (S_ISDIR(about.st_mode)) wrong = "Is a directory; it is no regular file";
    else if (!S_ISREG(about.st_mode)) wrong = "it is no regular file";
    else if (only_ours && (about.st_uid != geteuid() || about.st_mode & (S_IWGRP | S_IWOTH)))
        wrong = "it belongs to another user, or others may write to it";
    else if ((uint64_t)about.st_size > most) wrong = TOO_LARGE;
    uint64_t room = wrong ? 0 : (uint64_t)about.st_size + 1;
    if (!wrong && (room > SIZE_MAX || !(*data = malloc((size_t)room)))) wrong = strerror(ENOMEM);
    while (!wrong && *size < room) {
        uint64_t left = room - *size;
        ssize_t count = read(file, *data + *size, left < 1 << 30 ? (size_t)left : 1 << 30);
        if (count < 0 && errno == EINTR) continue;
        if (count < 0) wrong = strerror(errno);
        if (count <= 0) break;
        *size += count;
    }
    close(file);
    return !wrong && *size > (uint64_t)about.st_size ? "it grew while it was read" : wrong;
}

static const char *write_parts(int file, const Part *parts, size_t count) {
    for (size_t k = 0; k < count; k++)
        for (uint64_t done = 0; done < parts[k].size;) {
            uint64_t left = parts[k].size - done;
            ssize_t step = write(file, (const char *)parts[k].data + done, left < 1 << 30 ? (size_t)left : 1 << 30);
            if (step < 0 && errno == EINTR) continue;
            if (step <= 0) return strerror(step ? errno : ENOSPC);
            done += step;
        }
    return fsync(file) ? strerror(errno) : NULL;
}

/* Written beside the file and put in its place, on the disk before its name is. A process killed here leaves at worst a hidden
   `.NAME.*.part`. */
const char *replace_file(const char *path, const Part *parts, size_t count, bool is_private) {
    static uint32_t counter;
    const char *slash = strrchr(path, '/'), *base = slash ? slash + 1 : path;
    int folder_length = (int)(base - path);
    size_t room = strlen(path) + 64;
    char *name = malloc(room);
    if (!name) return strerror(ENOMEM);
    unsigned unique = __atomic_add_fetch(&counter, 1, __ATOMIC_RELAXED) ^ (unsigned)(seconds_now() * 1e6) << 8;
    snprintf(name, room, "%.*s.%.100s.%d-%08x.part", folder_length, path, base, (int)getpid(), unique);
    int file = open(name, O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, is_private ? 0600 : 0666);
    const char *wrong = file < 0 ? strerror(errno) : write_parts(file, parts, count);
    if (file >= 0) {
        if (close(file) && !wrong) wrong = strerror(errno);
        if (!wrong && rename(name, path)) wrong = strerror(errno);
        if (wrong) unlink(name);
    }
    if (!wrong) { /* so that the new name survives a power cut; not every system can */
        snprintf(name, room, "%.*s", folder_length ? folder_length : 1, folder_length ? path : ".");
        int folder = open(name, O_RDONLY | O_CLOEXEC);
        if (folder >= 0) {
            fsync(folder);
            close(folder);
        }
    }
    free(name);
    return wrong;
}
