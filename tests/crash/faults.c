/* Makes the n-th call that changes a file fail, or kill the process: for LD_PRELOAD.
 *
 * fault_arm(n, mode, error): from now on, calls are counted; at the n-th (from 1)
 *   mode 0: nothing happens, they are only counted;
 *   mode 1: it fails with `error`, and so does every later one (a full or broken disk);
 *   mode 2: it fails once;
 *   mode 3: the process is killed before it;
 *   mode 4: half of a write is done, then the process is killed: a torn page.
 * fault_count() is how many calls there were. The standard streams are left alone.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <signal.h>
#include <sys/types.h>
#include <unistd.h>

static long counter, target;
static int mode, error_number;

void fault_arm(long n, int how, int error) { counter = 0; target = n; mode = how; error_number = error; }
void fault_disarm(void) { target = 0; mode = 0; }
long fault_count(void) { return counter; }

enum { PASS, FAIL, TEAR };

static int verdict(void) {
    long now = __sync_add_and_fetch(&counter, 1);
    if (target == 0 || mode == 0 || now < target) return PASS;
    if (mode == 1 || (mode == 2 && now == target)) return FAIL;
    if (mode == 3) { kill(getpid(), SIGKILL); for (;;) pause(); }
    if (mode == 4) return TEAR;
    return PASS;
}

static int die_or_fail(int v) {
    if (v == TEAR) { kill(getpid(), SIGKILL); for (;;) pause(); }
    errno = error_number;
    return -1;
}

#define REAL(type, name) static type real; if (!real) real = (type)dlsym(RTLD_NEXT, name)

typedef ssize_t (*pwrite_t)(int, const void *, size_t, off64_t);
typedef ssize_t (*write_t)(int, const void *, size_t);
typedef int (*fd_t)(int);
typedef int (*truncate_t)(int, off64_t);
typedef int (*path_t)(const char *);
typedef int (*paths_t)(const char *, const char *);

ssize_t pwrite64(int fd, const void *data, size_t size, off64_t at) {
    REAL(pwrite_t, "pwrite64");
    int v = verdict();
    if (v == PASS) return real(fd, data, size, at);
    if (v == TEAR) real(fd, data, size / 2, at);
    return die_or_fail(v);
}
ssize_t pwrite(int fd, const void *data, size_t size, off_t at) { return pwrite64(fd, data, size, at); }

ssize_t write(int fd, const void *data, size_t size) {
    REAL(write_t, "write");
    if (fd <= 2) return real(fd, data, size);
    int v = verdict();
    if (v == PASS) return real(fd, data, size);
    if (v == TEAR) real(fd, data, size / 2);
    return die_or_fail(v);
}

int fsync(int fd) { REAL(fd_t, "fsync"); int v = verdict(); return v == PASS ? real(fd) : die_or_fail(v); }
int fdatasync(int fd) { REAL(fd_t, "fdatasync"); int v = verdict(); return v == PASS ? real(fd) : die_or_fail(v); }
int ftruncate64(int fd, off64_t size) {
    REAL(truncate_t, "ftruncate64"); int v = verdict(); return v == PASS ? real(fd, size) : die_or_fail(v);
}
int ftruncate(int fd, off_t size) { return ftruncate64(fd, size); }
int unlink(const char *path) { REAL(path_t, "unlink"); int v = verdict(); return v == PASS ? real(path) : die_or_fail(v); }
int rename(const char *from, const char *to) {
    REAL(paths_t, "rename"); int v = verdict(); return v == PASS ? real(from, to) : die_or_fail(v);
}
int link(const char *from, const char *to) {
    REAL(paths_t, "link"); int v = verdict(); return v == PASS ? real(from, to) : die_or_fail(v);
}
