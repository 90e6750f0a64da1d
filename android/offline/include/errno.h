#ifndef ERRNO_H
#define ERRNO_H
int *__errno(void); /* glibc calls it otherwise: offline/shims */
#define errno (*__errno())
#define EINTR 4
#define ENOMEM 12
#define ENOSPC 28
#endif
