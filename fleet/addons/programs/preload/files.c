/* Files: an agent sees a home, a /tmp and a /dev/shm of its own, and everything else as it is, to be read.

   Paths are translated, since a fresh folder has another name in each run: its length would already move the objects in
   the program's memory. (A mount name space does the same in the kernel, but many machines forbid it to users.) */
#include "preload.h"
#include <fcntl.h>
#include <linux/stat.h>
#include <stdio.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <sys/xattr.h>

#define HOME "/home/auv"
static const struct { const char *from, *to; } folders[] = {
    {HOME, ""}, {"/dev/shm", "/.shm"}, {"/tmp", "/.tmp"}, {"/var/tmp", "/.tmp"}, {"/run", "/.run"}, {"/var/run", "/.run"}};
/* Files whose contents are the host's, or change with time. */
static const struct { const char *path, *name; } written[] = {
    {"/etc/hosts", "hosts"}, {"/etc/resolv.conf", "resolv.conf"}, {"/etc/hostname", "hostname"},
    {"/etc/nsswitch.conf", "nsswitch.conf"}, {"/etc/host.conf", "host.conf"}, {"/etc/machine-id", "machine-id"},
    {"/etc/localtime", "localtime"}, {"/etc/timezone", "timezone"},
    {"/proc/meminfo", "meminfo"}, {"/proc/uptime", "uptime"}, {"/proc/loadavg", "loadavg"}, {"/proc/stat", "stat"},
    {"/proc/sys/kernel/hostname", "hostname"}, {"/proc/sys/kernel/random/boot_id", "boot_id"},
    {"/sys/devices/system/cpu/online", "processors"}, {"/sys/devices/system/cpu/possible", "processors"},
    {"/proc/self/stat", "self_stat"}, {"/proc/self/statm", "self_statm"}, {"/proc/self/io", "self_io"},
    {"/proc/self/schedstat", "empty"}, {"/proc/net/route", "route"}, {"/proc/net/dev", "dev"}, {"/proc/net/if_inet6", "empty"}};

static int below(const char *path, const char *folder, size_t n) {
  return !strncmp(path, folder, n) && (path[n] == '/' || !path[n]);
}

static int is_visible(const char *path) {
  for (const char *each = visible; *each; each += strlen(each) + 1)
    if (below(path, each, strlen(each)) || (below(each, path, strlen(path)) && strchr(path + 1, '/'))) return 1; /* or on the way to one */
  return 0;
}

static const char *joined(char *buffer, const char *folder, const char *rest) {
  size_t n = strlen(folder), m = strlen(rest);
  if (n + m >= 4096) return 0;
  memcpy(buffer, folder, n);
  memcpy(buffer + n, rest, m + 1);
  return buffer;
}

/* Takes "." and ".." out of an absolute path, in its place. */
static void normalise(char *path) {
  char *to = path;
  for (const char *from = path; *from;) {
    while (*from == '/') from++;
    size_t n = strcspn(from, "/");
    if (n == 2 && from[0] == '.' && from[1] == '.') {
      while (to > path && *--to != '/') {}
    } else if (n && !(n == 1 && from[0] == '.')) {
      *to++ = '/';
      memmove(to, from, n);
      to += n;
    }
    from += n;
  }
  if (to == path) *to++ = '/';
  *to = 0;
}

static int is_own_folder(const char *real) { return below(real, home, strlen(home)); }

/* The current folder as the program knows it. */
static const char *current_folder(char *buffer) {
  long n = SYS(SYS_getcwd, buffer, 4096);
  if (n <= 0) return "/";
  size_t own = strlen(home);
  if (!is_own_folder(buffer)) return buffer;
  static const char *const names[] = {"/.shm", "/.tmp", "/.run"}, *const shown[] = {"/dev/shm", "/tmp", "/run"};
  for (size_t k = 0; k < LENGTH(names); k++)
    if (below(buffer + own, names[k], strlen(names[k]))) {
      size_t was = own + strlen(names[k]), is = strlen(shown[k]);
      memmove(buffer + is, buffer + was, strlen(buffer + was) + 1);
      memcpy(buffer, shown[k], is);
      return buffer;
    }
  size_t is = strlen(HOME);
  if (strlen(buffer) - own + is >= 4096) return buffer;
  memmove(buffer + is, buffer + own, strlen(buffer + own) + 1);
  memcpy(buffer, HOME, is);
  return buffer;
}

/* Where the kernel finds what the program calls `path`; `buffer` has 4096 bytes. */
const char *real_path(const char *path, char *buffer) {
  static char whole[8192];
  if (!path) return path;
  if (*path != '/') {
    if (!strstr(path, "..")) return path;
    const char *folder = current_folder(whole);
    if (folder != whole) memcpy(whole, folder, strlen(folder) + 1);
    size_t n = strlen(whole);
    if (n + strlen(path) + 2 > sizeof whole) return path;
    whole[n] = '/';
    memcpy(whole + n + 1, path, strlen(path) + 1);
    normalise(whole);
  } else {
    if (strlen(path) + 1 > sizeof whole) return path;
    memcpy(whole, path, strlen(path) + 1);
    if (strstr(path, "//") || strstr(path, "/.")) normalise(whole);
  }
  char number[32];
  int digits = snprintf(number, sizeof number, "/proc/%u", config.pid);
  if (below(whole, number, digits)) { /* its own number is ours; the kernel knows it by another one */
    memmove(whole + strlen("/proc/self"), whole + digits, strlen(whole + digits) + 1);
    memcpy(whole, "/proc/self", strlen("/proc/self"));
    path = whole;
  }
  for (size_t k = 0; k < LENGTH(written); k++)
    if (!strcmp(whole, written[k].path)) {
      static char name[64];
      snprintf(name, sizeof name, "/.host/%s", written[k].name);
      return joined(buffer, home, name);
    }
  if (!is_visible(whole) && !is_own_folder(whole)) /* a program may have got a real name, of a file that it was given */
    for (size_t k = 0; k < LENGTH(folders); k++) {
      size_t n = strlen(folders[k].from);
      if (!below(whole, folders[k].from, n)) continue;
      static char rest[8192];
      snprintf(rest, sizeof rest, "%s%s", folders[k].to, whole + n);
      const char *found = joined(buffer, home, rest);
      return found ? found : path;
    }
  if (path == whole) return joined(buffer, whole, "") ? buffer : path;
  if (*path == '/') return path;
  return joined(buffer, whole, "") ? buffer : path;
}

/* Whether a file may be changed: it is in the agent's folders, or no file of the disk. */
static int may_change(int folder, const char *real) {
  if (*real == '/') return is_own_folder(real) || (below(real, "/dev", 4) && !below(real, "/dev/shm", 8)) || below(real, "/proc/self", 10);
  char name[40];
  static char at[4096];
  if (folder == AT_FDCWD) snprintf(name, sizeof name, "/proc/self/cwd");
  else snprintf(name, sizeof name, "/proc/self/fd/%d", folder);
  long n = SYS(SYS_readlink, name, at, sizeof at - 1);
  if (n <= 0) return 1; /* the kernel will say what is wrong */
  at[n] = 0;
  return is_own_folder(at);
}

static long open_file(int folder, const char *path, long flags, long mode) {
  static char buffer[4096];
  const char *real = real_path(path, buffer);
  if (!strcmp(real, "/dev/urandom") || !strcmp(real, "/dev/random") || !strcmp(real, "/dev/hwrng")) {
    long fd = SYS(SYS_openat, AT_FDCWD, "/dev/zero", O_RDWR | (flags & O_CLOEXEC), 0);
    if (fd >= 0) new_descriptor(fd, CHANCE);
    return fd;
  }
  if (!strcmp(real, "/proc/sys/kernel/random/uuid")) { /* a new one each time */
    u8 b[16];
    char text[40];
    draw_bytes(b, sizeof b);
    int n = snprintf(text, sizeof text, "%02x%02x%02x%02x-%02x%02x-4%01x%02x-%02x%02x-%02x%02x%02x%02x%02x%02x\n", b[0], b[1], b[2], b[3], b[4],
                     b[5], b[6] & 15, b[7], (b[8] & 63) | 128, b[9], b[10], b[11], b[12], b[13], b[14], b[15]);
    long fd = SYS(SYS_memfd_create, "uuid", flags & O_CLOEXEC ? 1 : 0);
    if (fd < 0) return fd;
    SYS(SYS_pwrite64, fd, text, n, 0);
    new_descriptor(fd, UNKNOWN);
    return fd;
  }
  static const char *const standard[] = {"/dev/stdin", "/dev/stdout", "/dev/stderr"};
  for (int k = 0; k < 3; k++) { /* opened by its name, a file of ours would be written from its beginning */
    static char name[24];
    snprintf(name, sizeof name, "/proc/self/fd/%d", k);
    if (!strcmp(real, standard[k]) || !strcmp(real, name)) {
      long fd = SYS(SYS_fcntl, k, flags & O_CLOEXEC ? F_DUPFD_CLOEXEC : F_DUPFD, 0);
      if (fd >= 0) new_descriptor(fd, UNKNOWN);
      return fd;
    }
  }
  int writes = (flags & O_ACCMODE) != O_RDONLY || flags & (O_CREAT | O_TRUNC) || (flags & O_TMPFILE) == O_TMPFILE;
  if (writes && !may_change(folder, real)) {
    if (!(flags & O_CREAT) || SYS(SYS_faccessat, folder, real, 0) == 0 || !(flags & O_ACCMODE)) {
      if (!(flags & (O_TRUNC | O_EXCL)) && (flags & O_ACCMODE) == O_RDONLY) return SYS(SYS_openat, folder, real, flags & ~O_CREAT, mode);
    }
    return -EROFS;
  }
  long fd = SYS(SYS_openat, folder, real, flags, mode);
  if (fd >= 0) new_descriptor(fd, UNKNOWN);
  return fd;
}

/* A file that is written in a run has the host's time; the program sees the beginning of the run. */
static void hide_time(struct timespec *t, i64 begin) {
  if (t->tv_sec * SECOND > begin) t->tv_sec = config.epoch / SECOND, t->tv_nsec = 0;
}
static i64 began; /* on the host's clock */
void begin_files(void) {
  struct timespec t;
  SYS(SYS_clock_gettime, CLOCK_REALTIME, &t);
  began = t.tv_sec * SECOND - 5 * SECOND; /* what was written just before belongs to the run, too: its own copies */
}
static void hide_times(struct stat *s) {
  hide_time(&s->st_atim, began), hide_time(&s->st_mtim, began), hide_time(&s->st_ctim, began);
}
static void hide_statx(struct statx *s) {
  struct statx_timestamp *all[] = {&s->stx_atime, &s->stx_mtime, &s->stx_ctime, &s->stx_btime};
  for (size_t k = 0; k < LENGTH(all); k++)
    if (all[k]->tv_sec * SECOND > began) all[k]->tv_sec = config.epoch / SECOND, all[k]->tv_nsec = 0;
}

int mapped_socket(const struct sockaddr *from, socklen_t size, struct sockaddr *to_) {
  const struct sockaddr_un *given = (void *)from;
  struct sockaddr_un *to = (void *)to_;
  memset(to, 0, sizeof *to);
  to->sun_family = AF_UNIX;
  size_t head = offsetof(struct sockaddr_un, sun_path);
  if (size <= head) return size;
  if (!given->sun_path[0]) { /* a name without a file is the machine's: agents and runs must not meet there */
    u64 mark = 14695981039346656037ULL;
    for (const char *c = home; *c; c++) mark = (mark ^ (u8)*c) * 1099511628211ULL;
    int n = snprintf(to->sun_path + 1, 20, "%016lx", (unsigned long)mark);
    size_t more = size - head - 1, room = sizeof to->sun_path - 1 - n;
    memcpy(to->sun_path + 1 + n, given->sun_path + 1, more < room ? more : room);
    return head + 1 + n + (more < room ? more : room);
  }
  static char path[200], buffer[4096];
  size_t n = size - head < sizeof path - 1 ? size - head : sizeof path - 1;
  memcpy(path, given->sun_path, n);
  path[n] = 0;
  const char *real = real_path(path, buffer);
  if (strlen(real) >= sizeof to->sun_path) { /* the folder of a run may have a long name: by its descriptor it is short */
    static int folder = -1;
    if (folder < 0) {
      long opened = SYS(SYS_openat, AT_FDCWD, home, O_PATH | O_DIRECTORY | O_CLOEXEC, 0);
      folder = SYS(SYS_fcntl, opened, F_DUPFD_CLOEXEC, FIRST_OWN);
      SYS(SYS_close, opened);
    }
    if (!is_own_folder(real)) return -ENAMETOOLONG;
    if (snprintf(to->sun_path, sizeof to->sun_path, "/proc/self/fd/%d%s", folder, real + strlen(home)) >= (int)sizeof to->sun_path)
      return -ENAMETOOLONG;
  } else memcpy(to->sun_path, real, strlen(real) + 1);
  return head + strlen(to->sun_path) + 1;
}

long file_call(long number, const long a[6]) {
  static char first[4096], second[4096];
  switch (number) {
    case SYS_open: return open_file(AT_FDCWD, (void *)a[0], a[1], a[2]);
    case SYS_creat: return open_file(AT_FDCWD, (void *)a[0], O_CREAT | O_WRONLY | O_TRUNC, a[1]);
    case SYS_openat: return open_file(a[0], (void *)a[1], a[2], a[3]);
    case SYS_openat2: return -ENOSYS; /* callers fall back to openat */
    case SYS_getcwd: {
      const char *folder = current_folder(first);
      size_t n = strlen(folder) + 1;
      if (n > (size_t)a[1]) return -ERANGE;
      memcpy((void *)a[0], folder, n);
      return n;
    }
    case SYS_stat:
    case SYS_lstat: {
      long r = SYS(number, real_path((void *)a[0], first), a[1]);
      if (!r) hide_times((void *)a[1]);
      return r;
    }
    case SYS_fstat: {
      long r = SYS(number, a[0], a[1]);
      if (!r) hide_times((void *)a[1]);
      return r;
    }
    case SYS_newfstatat: {
      long r = SYS(number, a[0], real_path((void *)a[1], first), a[2], a[3]);
      if (!r) hide_times((void *)a[2]);
      return r;
    }
    case SYS_statx: {
      long r = SYS(number, a[0], real_path((void *)a[1], first), a[2], a[3], a[4]);
      if (!r) hide_statx((void *)a[4]);
      return r;
    }
    /* One path that is only looked at. */
    case SYS_access: case SYS_readlink: case SYS_chdir: case SYS_statfs: case SYS_getxattr: case SYS_lgetxattr:
    case SYS_listxattr: case SYS_llistxattr:
      if (number == SYS_access && a[1] & 2 && !may_change(AT_FDCWD, real_path((void *)a[0], first)) && SYS(SYS_access, first, 0) == 0) return -EROFS;
      return SYS(number, real_path((void *)a[0], first), a[1], a[2], a[3]);
    case SYS_faccessat: case SYS_faccessat2: case SYS_readlinkat: case SYS_name_to_handle_at:
      return SYS(number, a[0], real_path((void *)a[1], first), a[2], a[3], a[4]);
    case SYS_inotify_add_watch: return SYS(number, a[0], real_path((void *)a[1], first), a[2]);
    /* One path that is changed. */
    case SYS_unlink: case SYS_rmdir: case SYS_mkdir: case SYS_mknod: case SYS_chmod: case SYS_chown: case SYS_lchown:
    case SYS_truncate: case SYS_utime: case SYS_utimes: case SYS_setxattr: case SYS_lsetxattr: case SYS_removexattr:
    case SYS_lremovexattr: {
      const char *real = real_path((void *)a[0], first);
      if (number == SYS_mkdir && !may_change(AT_FDCWD, real) && SYS(SYS_access, real, 0) == 0) return -EEXIST;
      return may_change(AT_FDCWD, real) ? SYS(number, real, a[1], a[2], a[3], a[4]) : -EROFS;
    }
    case SYS_unlinkat: case SYS_mkdirat: case SYS_mknodat: case SYS_fchmodat: case SYS_fchownat: case SYS_futimesat: {
      const char *real = real_path((void *)a[1], first);
      if (number == SYS_mkdirat && !may_change(a[0], real) && SYS(SYS_faccessat, a[0], real, 0) == 0) return -EEXIST;
      return may_change(a[0], real) ? SYS(number, a[0], real, a[2], a[3], a[4]) : -EROFS;
    }
    case SYS_utimensat:
      if (!a[1]) return SYS(number, a[0], a[1], a[2], a[3]);
      return may_change(a[0], real_path((void *)a[1], first)) ? SYS(number, a[0], real_path((void *)a[1], first), a[2], a[3]) : -EROFS;
    /* Two paths. */
    case SYS_rename: case SYS_link: {
      const char *from = real_path((void *)a[0], first), *to = real_path((void *)a[1], second);
      return may_change(AT_FDCWD, from) && may_change(AT_FDCWD, to) ? SYS(number, from, to) : -EROFS;
    }
    case SYS_renameat: case SYS_renameat2: case SYS_linkat: {
      const char *from = real_path((void *)a[1], first), *to = real_path((void *)a[3], second);
      return may_change(a[0], from) && may_change(a[2], to) ? SYS(number, a[0], from, a[2], to, a[4]) : -EROFS;
    }
    case SYS_symlink: {
      const char *to = real_path((void *)a[1], second);
      return may_change(AT_FDCWD, to) ? SYS(number, real_path((void *)a[0], first), to) : -EROFS;
    }
    default: { /* symlinkat */
      const char *to = real_path((void *)a[2], second);
      return may_change(a[1], to) ? SYS(number, real_path((void *)a[0], first), a[1], to) : -EROFS;
    }
  }
}
