/* Lets one call of a process fail: the N-th of its kind after the first one below the folder FAIL_BELOW. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

extern void *__libc_malloc(size_t), *__libc_calloc(size_t, size_t), *__libc_realloc(void *, size_t);

static const char *below, *kind;
static long left;
static int begun;

__attribute__((constructor)) static void begin(void) {
    const char *n = getenv("FAIL_NTH");
    kind = getenv("FAIL_KIND"), below = getenv("FAIL_BELOW"), left = n ? atol(n) : 0;
}

/* Whether this call is the one that fails; whoever reads the file knows that it was reached. */
static int fails(const char *what, int error) {
    if (!begun || left <= 0 || strcmp(what, kind) || __sync_sub_and_fetch(&left, 1)) return 0;
    int seen = open(getenv("FAIL_SEEN"), O_WRONLY | O_CREAT | O_CLOEXEC, 0600);
    if (seen >= 0) close(seen);
    errno = error;
    return 1;
}

static int ours(const char *path) {
    char whole[4096];
    if (!below || !kind || !path) return 0;
    if (*path != '/' && getcwd(whole, sizeof whole)) path = whole;
    return begun |= !strncmp(path, below, strlen(below)), !strncmp(path, below, strlen(below));
}

static int written_to(int fd) {
    char link[64], path[4096];
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t size = readlink(link, path, sizeof path - 1);
    return size > 0 && (path[size] = 0, *path == '/') && ours(path);
}

#define NEXT(name) ((typeof(&name))dlsym(RTLD_NEXT, #name))
#define OPEN(name)                                                  \
    int name(const char *path, int flags, ...) {                    \
        va_list rest;                                               \
        va_start(rest, flags);                                      \
        int mode = va_arg(rest, int);                               \
        va_end(rest);                                               \
        if (ours(path) && fails("open", EMFILE)) return -1;         \
        return ((int (*)(const char *, int, ...))dlsym(RTLD_NEXT, #name))(path, flags, mode); \
    }
OPEN(open64)
#define WRITE(name, more, ...)                                                  \
    ssize_t name(int fd, const void *data, size_t size more) {                  \
        if (begun | 1 && written_to(fd) && fails("write", ENOSPC)) return -1;   \
        return ((ssize_t (*)(int, const void *, size_t, ...))dlsym(RTLD_NEXT, #name))(fd, data, size __VA_ARGS__); \
    }
#define COMMA ,
WRITE(write, )
WRITE(pwrite64, COMMA off64_t at, COMMA at)

int rename(const char *from, const char *to) {
    if (ours(to) && fails("rename", EIO)) return -1;
    return ((int (*)(const char *, const char *))dlsym(RTLD_NEXT, "rename"))(from, to);
}

int fsync(int fd) {
    if (fails("fsync", EIO)) return -1;
    return ((int (*)(int))dlsym(RTLD_NEXT, "fsync"))(fd);
}

void *mmap64(void *at, size_t size, int protection, int flags, int fd, off64_t offset) {
    if (fails("mmap", ENOMEM)) return MAP_FAILED;
    return ((void *(*)(void *, size_t, int, int, int, off64_t))dlsym(RTLD_NEXT, "mmap64"))(
        at, size, protection, flags, fd, offset);
}

void *malloc(size_t size) { return fails("malloc", ENOMEM) ? NULL : __libc_malloc(size); }
void *calloc(size_t count, size_t size) { return fails("malloc", ENOMEM) ? NULL : __libc_calloc(count, size); }
void *realloc(void *old, size_t size) { return fails("malloc", ENOMEM) ? NULL : __libc_realloc(old, size); }
