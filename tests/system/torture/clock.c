/* Adds an offset to the wall clock of the process that preloads this: eight bytes of ns in the file $TORTURE_CLOCK. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <pthread.h>
#include <semaphore.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/time.h>
#include <time.h>

static volatile int64_t *offset;

__attribute__((constructor)) static void begin(void) {
    const char *path = getenv("TORTURE_CLOCK");
    int file = path ? open(path, O_RDONLY) : -1;
    void *page = file < 0 ? MAP_FAILED : mmap(0, 8, PROT_READ, MAP_SHARED, file, 0);
    if (page != MAP_FAILED) offset = page;
}

static void shift(struct timespec *moment, int64_t ns) {
    int64_t all = moment->tv_sec * 1000000000LL + moment->tv_nsec + ns;
    moment->tv_sec = all / 1000000000LL;
    moment->tv_nsec = all % 1000000000LL;
}

static int ask(clockid_t id, struct timespec *moment) {
    static int (*real)(clockid_t, struct timespec *);
    if (!real) real = dlsym(RTLD_NEXT, "clock_gettime");
    return real(id, moment);
}

int clock_gettime(clockid_t id, struct timespec *moment) {
    int failed = ask(id, moment);
    if (!failed && offset && (id == CLOCK_REALTIME || id == CLOCK_REALTIME_COARSE)) shift(moment, *offset);
    return failed;
}

int gettimeofday(struct timeval *restrict moment, void *restrict zone) {
    struct timespec now;
    (void)zone;
    clock_gettime(CLOCK_REALTIME, &now);
    moment->tv_sec = now.tv_sec;
    moment->tv_usec = now.tv_nsec / 1000;
    return 0;
}

time_t time(time_t *moment) {
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    if (moment) *moment = now.tv_sec;
    return now.tv_sec;
}

/* The kernel waits by its own clock: a deadline on the wall clock is shifted back, one on the monotonic clock is not. */
static struct timespec kernel_time(const struct timespec *deadline) {
    struct timespec now, shifted = *deadline;
    ask(CLOCK_MONOTONIC, &now);
    if (offset && llabs(deadline->tv_sec - now.tv_sec) > 100000000LL) shift(&shifted, -*offset);
    return shifted;
}

int pthread_cond_timedwait(pthread_cond_t *restrict condition, pthread_mutex_t *restrict mutex,
                           const struct timespec *restrict deadline) {
    static int (*real)(pthread_cond_t *, pthread_mutex_t *, const struct timespec *);
    if (!real) real = dlvsym(RTLD_NEXT, "pthread_cond_timedwait", "GLIBC_2.3.2");
    struct timespec shifted = kernel_time(deadline);
    return real(condition, mutex, &shifted);
}

int sem_timedwait(sem_t *restrict semaphore, const struct timespec *restrict deadline) {
    static int (*real)(sem_t *, const struct timespec *);
    if (!real) real = dlsym(RTLD_NEXT, "sem_timedwait");
    struct timespec shifted = kernel_time(deadline);
    return real(semaphore, &shifted);
}
