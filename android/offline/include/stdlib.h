#ifndef STDLIB_H
#define STDLIB_H
#include <stddef.h>
void *malloc(size_t size);
void *calloc(size_t count, size_t size);
void *realloc(void *from, size_t size);
void free(void *at);
char *getenv(const char *name);
char *realpath(const char *path, char *to);
int atoi(const char *text);
double strtod(const char *text, char **end);
unsigned long strtoul(const char *text, char **end, int base);
#endif
