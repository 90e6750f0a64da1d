#ifndef UNISTD_H
#define UNISTD_H
#include <stddef.h>
typedef long ssize_t;
ssize_t read(int file, void *to, size_t size);
ssize_t write(int file, const void *from, size_t size);
int close(int file);
int fsync(int file);
int unlink(const char *path);
int getpid(void);
unsigned int geteuid(void);
#endif
