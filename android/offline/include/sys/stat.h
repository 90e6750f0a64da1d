#ifndef SYS_STAT_H
#define SYS_STAT_H
#include <time.h>
typedef unsigned int uid_t;
struct stat { /* of the kernel, for 64-bit ARM */
    unsigned long st_dev, st_ino;
    unsigned int st_mode, st_nlink, st_uid, st_gid;
    unsigned long st_rdev, pad1;
    long st_size;
    int st_blksize, pad2;
    long st_blocks;
    struct timespec st_atim, st_mtim, st_ctim;
    unsigned int unused[2];
};
#define S_IFMT 0170000
#define S_ISDIR(mode) (((mode) & S_IFMT) == 0040000)
#define S_ISREG(mode) (((mode) & S_IFMT) == 0100000)
#define S_ISLNK(mode) (((mode) & S_IFMT) == 0120000)
#define S_ISVTX 01000
#define S_IWGRP 00020
#define S_IWOTH 00002
int stat(const char *path, struct stat *about);
int lstat(const char *path, struct stat *about);
int fstat(int file, struct stat *about);
int mkdir(const char *path, unsigned int mode);
int utimensat(int folder, const char *path, const struct timespec times[2], int flags);
#endif
