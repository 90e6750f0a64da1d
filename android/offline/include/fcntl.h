#ifndef FCNTL_H
#define FCNTL_H
#define O_RDONLY 0
#define O_WRONLY 1
#define O_CREAT 0100
#define O_EXCL 0200
#define O_NOCTTY 0400
#define O_NONBLOCK 04000
#define O_NOFOLLOW 0100000
#define O_CLOEXEC 02000000
#define AT_FDCWD (-100)
int open(const char *path, int flags, ...);
#endif
