#ifndef STDIO_H
#define STDIO_H
#include <stdarg.h>
#include <stddef.h>
int snprintf(char *to, size_t size, const char *format, ...) __attribute__((format(printf, 3, 4)));
int vsnprintf(char *to, size_t size, const char *format, va_list rest);
int rename(const char *from, const char *to);
#endif
