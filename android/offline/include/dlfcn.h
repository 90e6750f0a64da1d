#ifndef DLFCN_H
#define DLFCN_H
#define RTLD_NOW 2
#define RTLD_LOCAL 0
void *dlopen(const char *name, int how);
void *dlsym(void *library, const char *name);
#endif
