#ifndef SETJMP_H
#define SETJMP_H
typedef struct { long room[64]; } __attribute__((aligned(16))) jmp_buf[1]; /* 32 words in Android's library, 39 in glibc */
int _setjmp(jmp_buf place) __attribute__((returns_twice));
void longjmp(jmp_buf place, int value) __attribute__((noreturn));
#define setjmp(place) _setjmp(place)
#endif
