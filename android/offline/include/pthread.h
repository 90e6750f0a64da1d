#ifndef PTHREAD_H
#define PTHREAD_H
typedef union { char room[64]; long align; } pthread_mutex_t; /* 40 bytes in Android's library, 48 in glibc */
int pthread_mutex_init(pthread_mutex_t *mutex, const void *attributes);
int pthread_mutex_destroy(pthread_mutex_t *mutex);
int pthread_mutex_lock(pthread_mutex_t *mutex);
int pthread_mutex_unlock(pthread_mutex_t *mutex);
#endif
