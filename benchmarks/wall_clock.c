/* Sets the wall clock of one process: a library that is loaded before the C library (LD_PRELOAD).
 *
 * The file that HE3_WALL_CLOCK names holds the step in nanoseconds, a signed 64-bit integer. It is mapped, so a change
 * holds at once and whole for every process that maps it. Only the wall clock is stepped. Monotonic clocks, sleeps and
 * waits are left to the system, as on a machine whose wall clock is set.
 */
#define _GNU_SOURCE
#include <fcntl.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

static const volatile int64_t *step_ns;

__attribute__((constructor)) static void map_step(void) {
    const char *path = getenv("HE3_WALL_CLOCK");
    int file = path == NULL ? -1 : open(path, O_RDONLY | O_CLOEXEC);
    if (file < 0) return;
    void *page = mmap(NULL, sizeof *step_ns, PROT_READ, MAP_SHARED, file, 0);
    close(file);
    if (page != MAP_FAILED) step_ns = page;
}

int clock_gettime(clockid_t clock, struct timespec *now) {
    int failed = (int)syscall(SYS_clock_gettime, clock, now);
    if (failed == 0 && step_ns != NULL && (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE)) {
        int64_t all_ns = now->tv_sec * INT64_C(1000000000) + now->tv_nsec + *step_ns;
        now->tv_sec = all_ns / 1000000000;
        now->tv_nsec = all_ns % 1000000000;
    }
    return failed;
}

int gettimeofday(struct timeval *restrict now, void *restrict zone) {
    struct timespec fine;
    (void)zone;
    if (clock_gettime(CLOCK_REALTIME, &fine) != 0) return -1;
    now->tv_sec = fine.tv_sec;
    now->tv_usec = fine.tv_nsec / 1000;
    return 0;
}

time_t time(time_t *also) {
    struct timespec fine;
    if (clock_gettime(CLOCK_REALTIME, &fine) != 0) return (time_t)-1;
    if (also != NULL) *also = fine.tv_sec;
    return fine.tv_sec;
}
