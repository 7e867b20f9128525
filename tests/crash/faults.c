/* Makes the n-th call that changes a file fail, or kill the process: for LD_PRELOAD.
 *
 * fault_arm(n, mode, error): from now on, calls are counted; at the n-th (from 1)
 *   mode 0: nothing happens, they are only counted;
 *   mode 1: it fails with `error`, and so does every later one (a full or broken disk);
 *   mode 2: it fails once;
 *   mode 3: the process is killed before it;
 *   mode 4: half of a write is done, then the process is killed: a torn page.
 * fault_count() is how many calls there were. The standard streams are left alone.
 *
 * fault_record(fd): from now on, each call is written down there, for a model of a power cut: a head
 * of numbers (kind, inode, offset, length of the data, of the path, of the second path), the paths,
 * the data. fault_record(-1) ends it.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
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

typedef int (*open_t)(const char *, int, ...);
typedef ssize_t (*pwrite_t)(int, const void *, size_t, off64_t);
typedef ssize_t (*write_t)(int, const void *, size_t);
typedef int (*fd_t)(int);
typedef int (*truncate_t)(int, off64_t);
typedef int (*path_t)(const char *);
typedef int (*paths_t)(const char *, const char *);

static int log_fd = -1;
void fault_record(int fd) { log_fd = fd; }

enum { WRITE = 1, TRUNCATE, SYNC, UNLINK, RENAME, LINK, CREATE };

static void put(const void *data, size_t size) {
    REAL(write_t, "write");
    const char *at = data;
    while (size > 0) {
        ssize_t done = real(log_fd, at, size);
        if (done <= 0) _exit(99);
        at += done;
        size -= done;
    }
}

static void record(int kind, uint64_t inode, uint64_t offset, const char *path, const char *to,
                   const void *data, size_t size) {
    if (log_fd < 0) return;
    uint64_t head[6] = {kind, inode, offset, size, strlen(path), strlen(to)};
    put(head, sizeof head);
    put(path, head[4]);
    put(to, head[5]);
    put(data, size);
}

static void record_fd(int kind, int fd, uint64_t offset, const void *data, size_t size) {
    if (log_fd < 0) return;
    struct stat found;
    char link[64], path[4096];
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t length = readlink(link, path, sizeof path - 1);
    path[length < 0 ? 0 : length] = 0;
    if (fstat(fd, &found) == 0) record(kind, found.st_ino, offset, path, "", data, size);
}

static int opened(open_t real, const char *path, int flags, mode_t mode) {
    int is_new = log_fd >= 0 && (flags & O_CREAT) && access(path, F_OK) != 0;
    int fd = real(path, flags, mode);
    if (is_new && fd >= 0) record_fd(CREATE, fd, 0, "", 0);
    return fd;
}

int open(const char *path, int flags, ...) {
    REAL(open_t, "open");
    va_list rest; va_start(rest, flags); mode_t mode = va_arg(rest, mode_t); va_end(rest);
    return opened(real, path, flags, mode);
}
int open64(const char *path, int flags, ...) {
    REAL(open_t, "open64");
    va_list rest; va_start(rest, flags); mode_t mode = va_arg(rest, mode_t); va_end(rest);
    return opened(real, path, flags, mode);
}

ssize_t pwrite64(int fd, const void *data, size_t size, off64_t at) {
    REAL(pwrite_t, "pwrite64");
    int v = verdict();
    if (v == PASS) {
        ssize_t done = real(fd, data, size, at);
        if (done > 0) record_fd(WRITE, fd, at, data, done);
        return done;
    }
    if (v == TEAR) real(fd, data, size / 2, at);
    return die_or_fail(v);
}
ssize_t pwrite(int fd, const void *data, size_t size, off_t at) { return pwrite64(fd, data, size, at); }

ssize_t write(int fd, const void *data, size_t size) {
    REAL(write_t, "write");
    if (fd <= 2) return real(fd, data, size);
    int v = verdict();
    if (v == PASS) {
        off_t at = log_fd < 0 ? 0 : lseek(fd, 0, SEEK_CUR);
        ssize_t done = real(fd, data, size);
        if (done > 0 && at >= 0) record_fd(WRITE, fd, at, data, done);
        return done;
    }
    if (v == TEAR) real(fd, data, size / 2);
    return die_or_fail(v);
}

int fsync(int fd) {
    REAL(fd_t, "fsync");
    int v = verdict();
    if (v != PASS) return die_or_fail(v);
    record_fd(SYNC, fd, 0, "", 0);
    return real(fd);
}
int fdatasync(int fd) {
    REAL(fd_t, "fdatasync");
    int v = verdict();
    if (v != PASS) return die_or_fail(v);
    record_fd(SYNC, fd, 0, "", 0);
    return real(fd);
}
int ftruncate64(int fd, off64_t size) {
    REAL(truncate_t, "ftruncate64");
    int v = verdict();
    if (v != PASS) return die_or_fail(v);
    record_fd(TRUNCATE, fd, size, "", 0);
    return real(fd, size);
}
int ftruncate(int fd, off_t size) { return ftruncate64(fd, size); }
int unlink(const char *path) {
    REAL(path_t, "unlink");
    int v = verdict();
    if (v != PASS) return die_or_fail(v);
    int done = real(path);
    if (done == 0) record(UNLINK, 0, 0, path, "", "", 0);
    return done;
}
int rename(const char *from, const char *to) {
    REAL(paths_t, "rename");
    int v = verdict();
    if (v != PASS) return die_or_fail(v);
    int done = real(from, to);
    if (done == 0) record(RENAME, 0, 0, from, to, "", 0);
    return done;
}
int link(const char *from, const char *to) {
    REAL(paths_t, "link");
    int v = verdict();
    if (v != PASS) return die_or_fail(v);
    int done = real(from, to);
    if (done == 0) record(LINK, 0, 0, from, to, "", 0);
    return done;
}
/* Kill points only: no command on a map makes links or folders, so the model of a power cut has none. */
int symlink(const char *to, const char *path) {
    REAL(paths_t, "symlink");
    int v = verdict();
    return v == PASS ? real(to, path) : die_or_fail(v);
}
int mkdir(const char *path, mode_t how) {
    typedef int (*mkdir_t)(const char *, mode_t);
    REAL(mkdir_t, "mkdir");
    int v = verdict();
    return v == PASS ? real(path, how) : die_or_fail(v);
}
int rmdir(const char *path) {
    REAL(path_t, "rmdir");
    int v = verdict();
    return v == PASS ? real(path) : die_or_fail(v);
}
int unlinkat(int folder, const char *path, int flags) {
    typedef int (*unlinkat_t)(int, const char *, int);
    REAL(unlinkat_t, "unlinkat");
    int v = verdict();
    return v == PASS ? real(folder, path, flags) : die_or_fail(v);
}
int renameat2(int from, const char *old, int to, const char *new, unsigned int flags) {
    typedef int (*renameat2_t)(int, const char *, int, const char *, unsigned int);
    REAL(renameat2_t, "renameat2");
    int v = verdict();
    return v == PASS ? real(from, old, to, new, flags) : die_or_fail(v);
}
