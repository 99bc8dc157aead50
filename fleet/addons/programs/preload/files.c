/* Files: an agent sees a home, a /tmp and a /dev/shm of its own, and everything else as it is, to be read.

   Paths are translated, since a fresh folder has another name in each run: its length would already move the objects in
   the program's memory. (A mount name space does the same in the kernel, but many machines forbid it to users.) */
#include "preload.h"
#include <fcntl.h>
#include <linux/stat.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/stat.h>
#include <sys/sysmacros.h>
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
    {"/proc/self/schedstat", "empty"}, {"/proc/self/sched", "empty"}, {"/proc/vmstat", "empty"}, {"/proc/interrupts", "empty"},
    {"/proc/softirqs", "empty"}, {"/proc/diskstats", "empty"}, {"/proc/timer_list", "empty"}, {"/proc/pressure/cpu", "empty"},
    {"/proc/pressure/io", "empty"}, {"/proc/pressure/memory", "empty"}, {"/proc/sys/kernel/ns_last_pid", "processors"}, {"/proc/net/route", "route"}, {"/proc/net/dev", "dev"}, {"/proc/net/if_inet6", "empty"}};

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

int is_own_folder(const char *real) { return below(real, home, strlen(home)); }

/* A path as the program knows it, in its place; `buffer` has 4096 bytes. */
const char *shown_path(char *buffer) {
  size_t own = strlen(home);
  if (!is_own_folder(buffer)) return buffer;
  static const char *const names[] = {"/.shm", "/.tmp", "/.run", ""}, *const shown[] = {"/dev/shm", "/tmp", "/run", HOME};
  size_t k = 0;
  while (!below(buffer + own, names[k], strlen(names[k]))) k++;
  size_t was = own + strlen(names[k]), is = strlen(shown[k]);
  if (strlen(buffer) - was + is >= 4096) return buffer;
  memmove(buffer + is, buffer + was, strlen(buffer + was) + 1);
  memcpy(buffer, shown[k], is);
  return buffer;
}

static const char *current_folder(char *buffer) {
  long n = SYS(SYS_getcwd, buffer, 4096);
  return n <= 0 ? "/" : shown_path(buffer);
}

/* What a link holds, as the program has written it. */
static long read_link(int folder, const char *real, char *to, size_t size) {
  static char target[4096];
  long n = SYS(SYS_readlinkat, folder, real, target, sizeof target - 1);
  if (n < 0) return n;
  target[n] = 0;
  shown_path(target);
  n = strlen(target);
  if ((size_t)n > size) n = size;
  memcpy(to, target, n);
  return n;
}

static int is_ours(const char *whole) {
  for (size_t k = 0; k < LENGTH(folders); k++)
    if (below(whole, folders[k].from, strlen(folders[k].from))) return 1;
  return 0;
}

/* A folder that is open, as the program knows it. */
static const char *open_folder(int fd, char *buffer) {
  char name[40];
  snprintf(name, sizeof name, "/proc/self/fd/%d", fd);
  long n = SYS(SYS_readlink, name, buffer, 4095);
  if (n <= 0) return 0;
  buffer[n] = 0;
  return shown_path(buffer);
}

/* Where the kernel finds what the program calls `path` in a folder; `buffer` has 4096 bytes. */
const char *real_path_at(int at, const char *path, char *buffer) {
  static char whole[8192];
  if (!path) return path;
  if (*path != '/') {
    if (!strstr(path, "..")) return path;
    const char *folder = at == AT_FDCWD ? current_folder(whole) : open_folder(at, whole);
    if (!folder) return path;
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
  if (below(whole, "/proc/thread-self", 17)) memmove(whole + 6, whole + 13, strlen(whole + 13) + 1), path = whole;
  if (below(whole, number, digits)) { /* its own number is ours; the kernel knows it by another one */
    memmove(whole + strlen("/proc/self"), whole + digits, strlen(whole + digits) + 1);
    memcpy(whole, "/proc/self", strlen("/proc/self"));
    path = whole;
  } else if (!strncmp(whole, "/proc/", 6) && whole[6] >= '0' && whole[6] <= '9' && strtol(whole + 6, 0, 10) != real_pid()) {
    whole[6] = '0', whole[7] = 0; /* a process of the machine: this one never is */
    path = whole;
  }
  if (below(whole, "/proc/self/net", 14)) memmove(whole + 6, whole + 11, strlen(whole + 11) + 1), path = whole;
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
  if (path != whole && *path == '/' && !is_ours(path)) return path; /* ".." behind a link is the kernel's to follow */
  return joined(buffer, whole, "") ? buffer : path;
}
const char *real_path(const char *path, char *buffer) { return real_path_at(AT_FDCWD, path, buffer); }

/* Where a path leads when all links are followed, as the kernel sees it; 0: to nothing; "/": that cannot be told. */
static const char *leads_to(int folder, const char *real) {
  static char at[4096];
  long fd = SYS(SYS_openat, folder, real, O_PATH | O_CLOEXEC, 0);
  if (fd == -EMFILE) { /* the program's own limit */
    limit_files(1);
    fd = SYS(SYS_openat, folder, real, O_PATH | O_CLOEXEC, 0);
    limit_files(0);
  }
  if (fd < 0) return fd == -EMFILE || fd == -ENFILE || fd == -ENOMEM ? "/" : 0;
  char name[40];
  snprintf(name, sizeof name, "/proc/self/fd/%ld", fd);
  long n = SYS(SYS_readlink, name, at, sizeof at - 1);
  SYS(SYS_close, fd);
  if (n <= 0) return 0;
  at[n] = 0;
  return at;
}

/* A file that the kernel knows by this name may be changed: it is in the agent's folders, or no file of the disk. */
static int is_changeable(const char *at) {
  static const char *const devices[] = {"/dev/null", "/dev/zero", "/dev/full", "/dev/tty", "/dev/ptmx", "/dev/random", "/dev/urandom"};
  if (*at != '/' || is_own_folder(at) || !strncmp(at, "/memfd:", 7)) return 1; /* without a name: a pipe, a socket */
  for (size_t k = 0; k < LENGTH(devices); k++)
    if (!strcmp(at, devices[k])) return 1;
  char own[32];
  return below(at, own, snprintf(own, sizeof own, "/proc/%ld", real_pid())) || below(at, "/dev/pts", 8);
}

/* Whether a name in a folder may be made, removed or changed. */
static int may_change_name(int folder, const char *real) {
  static char parent[4096];
  size_t n = strlen(real);
  while (n > 1 && real[n - 1] == '/') n--;
  while (n && real[n - 1] != '/') n--;
  if (n >= sizeof parent) return 0;
  memcpy(parent, n ? real : ".", n ? n : 1);
  parent[n ? n : 1] = 0;
  const char *at = leads_to(folder, parent);
  return !at || is_own_folder(at); /* without a folder the kernel will say what is wrong */
}

static int may_change_open(int fd);

/* Whether a file may be changed that is there, or that is made by opening it. Links are followed, since a program makes
   links to wherever it likes. */
int may_change(int folder, const char *real) {
  static char target[4096], path[8192];
  if (!*real && folder != AT_FDCWD) return may_change_open(folder);
  for (int depth = 0; depth < 40; depth++) {
    const char *at = leads_to(folder, real);
    if (at) return is_changeable(at);
    if (!may_change_name(folder, real)) return 0;
    long n = SYS(SYS_readlinkat, folder, real, target, sizeof target - 1);
    if (n <= 0) return 1;
    target[n] = 0; /* a link to a file that is not there yet */
    const char *slash = strrchr(real, '/');
    size_t before = *target != '/' && slash ? (size_t)(slash + 1 - real) : 0;
    if (before + n >= sizeof path) return 0;
    memmove(path, real, before);
    memcpy(path + before, target, n + 1);
    real = path;
  }
  return 0;
}

static int may_change_open(int fd) {
  char name[40];
  snprintf(name, sizeof name, "/proc/self/fd/%d", fd);
  return SYS(SYS_fcntl, fd, F_GETFD) < 0 || may_change(AT_FDCWD, name); /* the kernel says that it is not open */
}

static int is_chance(const struct stat *s) { return s->st_rdev == makedev(1, 8) || s->st_rdev == makedev(1, 9); }

static int is_harmless_device(const struct stat *s) { /* null, zero, full; tty, ptmx; terminals */
  unsigned major = major(s->st_rdev), minor = minor(s->st_rdev);
  return S_ISCHR(s->st_mode) && (major == 1 ? minor == 3 || minor == 5 || minor == 7 : major == 5 ? minor == 0 || minor == 2 : major >= 136 && major < 144);
}

/* What a link is to hold: a path of the root as the kernel knows it; others are looked up beside the link, and stay. */
static const char *linked(const char *path, char *buffer) { return *path == '/' ? real_path(path, buffer) : path; }

/* A pipe with a name: the kernel would wait for the other end. Who reads waits when he reads instead. */
static long open_pipe(int folder, const char *real, long flags) {
  for (;;) {
    long fd = SYS(SYS_openat, folder, real, flags | O_NONBLOCK, 0);
    if (fd >= 0) {
      SYS(SYS_fcntl, fd, F_SETFL, flags & (O_APPEND | O_DIRECT));
      new_descriptor(fd, POLLABLE);
      something();
      return fd;
    }
    if (fd != -ENXIO || (flags & O_ACCMODE) != O_WRONLY) return fd;
    if (block(&descriptors_changed, NEVER) == SIGNALLED) return -EINTR;
  }
}

static long open_text(const char *text, size_t n, long flags) {
  long fd = SYS(SYS_memfd_create, "text", flags & O_CLOEXEC ? 1 : 0);
  if (fd < 0) return fd;
  SYS(SYS_pwrite64, fd, text, n, 0);
  new_descriptor(fd, UNKNOWN);
  return fd;
}

/* /proc/self/status, without the numbers that differ from run to run. */
static long open_status(long flags) {
  static char is[8192], shown[8192];
  long fd = SYS(SYS_openat, AT_FDCWD, "/proc/self/status", O_RDONLY, 0);
  if (fd < 0) return fd;
  long n = SYS(SYS_read, fd, is, sizeof is - 1), to = 0;
  SYS(SYS_close, fd);
  is[n < 0 ? 0 : n] = 0;
  for (const char *line = is; *line;) {
    size_t length = strcspn(line, "\n");
    length += line[length] == '\n';
    static const char *const dropped[] = {"NS", "Ngid", "FDSize", "SigQ", "Cpus_", "Mems_", "voluntary", "nonvoluntary", "Hugetlb"};
    int drops = 0;
    for (size_t k = 0; k < LENGTH(dropped); k++) drops |= !strncmp(line, dropped[k], strlen(dropped[k]));
    size_t key = strcspn(line, ":\n"), room = sizeof shown - to;
    if (length >= room || drops) key = 0;
    else if (!strncmp(line, "Vm", 2) || !strncmp(line, "Rss", 3)) to += snprintf(shown + to, room, "%.*s:\t   65536 kB\n", (int)key, line);
    else if (!strncmp(line, "Tgid:", 5) || !strncmp(line, "Pid:", 4)) to += snprintf(shown + to, room, "%.*s:\t%u\n", (int)key, line, config.pid);
    else if (!strncmp(line, "PPid:", 5)) to += snprintf(shown + to, room, "PPid:\t%u\n", config.parent);
    else memcpy(shown + to, line, length), to += length;
    line += length;
  }
  return open_text(shown, to, flags);
}

static long open_file(int folder, const char *path, long flags, long mode) {
  static char buffer[4096];
  const char *real = real_path_at(folder, path, buffer);
  struct stat s;
  int there = !SYS(SYS_newfstatat, folder, real, &s, flags & O_NOFOLLOW ? AT_SYMLINK_NOFOLLOW : 0);
  if (there && (S_ISCHR(s.st_mode) || S_ISBLK(s.st_mode)) && !(flags & O_PATH)) {
    if (is_chance(&s)) {
      long fd = SYS(SYS_openat, AT_FDCWD, "/dev/zero", O_RDWR | (flags & O_CLOEXEC), 0);
      if (fd >= 0) new_descriptor(fd, CHANCE);
      return fd;
    }
    if (!is_harmless_device(&s)) {
      say("%s is a device of the machine, which is refused in simulated time", path);
      return -EACCES;
    }
  }
  if (!strcmp(real, "/proc/sys/kernel/random/uuid")) { /* a new one each time */
    u8 b[16];
    char text[40];
    draw_bytes(b, sizeof b);
    int n = snprintf(text, sizeof text, "%02x%02x%02x%02x-%02x%02x-4%01x%02x-%02x%02x-%02x%02x%02x%02x%02x%02x\n", b[0], b[1], b[2], b[3], b[4],
                     b[5], b[6] & 15, b[7], (b[8] & 63) | 128, b[9], b[10], b[11], b[12], b[13], b[14], b[15]);
    return open_text(text, n, flags);
  }
  if (!strcmp(real, "/proc/self/status")) return open_status(flags);
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
  if (there && S_ISFIFO(s.st_mode) && !(flags & (O_NONBLOCK | O_PATH))) return open_pipe(folder, real, flags);
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
      long r = SYS(number, a[0], real_path_at(a[0], (void *)a[1], first), a[2], a[3]);
      if (!r) hide_times((void *)a[2]);
      return r;
    }
    case SYS_statx: {
      long r = SYS(number, a[0], real_path_at(a[0], (void *)a[1], first), a[2], a[3], a[4]);
      if (!r) hide_statx((void *)a[4]);
      return r;
    }
    case SYS_readlink: return read_link(AT_FDCWD, real_path((void *)a[0], first), (void *)a[1], a[2]);
    case SYS_readlinkat: return read_link(a[0], real_path_at(a[0], (void *)a[1], first), (void *)a[2], a[3]);
    /* One path that is only looked at. */
    case SYS_access: case SYS_chdir: case SYS_statfs: case SYS_getxattr: case SYS_lgetxattr: case SYS_listxattr: case SYS_llistxattr: {
      const char *real = real_path((void *)a[0], first);
      if (number == SYS_access && a[1] & 2 && !may_change(AT_FDCWD, real) && SYS(SYS_access, real, 0) == 0) return -EROFS;
      return SYS(number, real, a[1], a[2], a[3]);
    }
    case SYS_faccessat: case SYS_faccessat2: case SYS_name_to_handle_at:
      return SYS(number, a[0], real_path_at(a[0], (void *)a[1], first), a[2], a[3], a[4]);
    case SYS_inotify_add_watch: return SYS(number, a[0], real_path_at(a[0], (void *)a[1], first), a[2]);
    /* A name that is made or removed. */
    case SYS_unlink: case SYS_rmdir: case SYS_mkdir: case SYS_mknod: case SYS_lchown: case SYS_lsetxattr: case SYS_lremovexattr: {
      const char *real = real_path((void *)a[0], first);
      if (number == SYS_mknod && (S_ISCHR(a[1]) || S_ISBLK(a[1]))) return -EPERM;
      if (may_change_name(AT_FDCWD, real)) return SYS(number, real, a[1], a[2], a[3], a[4]);
      return number == SYS_mkdir && SYS(SYS_access, real, 0) == 0 ? -EEXIST : -EROFS;
    }
    case SYS_unlinkat: case SYS_mkdirat: case SYS_mknodat: {
      const char *real = real_path_at(a[0], (void *)a[1], first);
      if (number == SYS_mknodat && (S_ISCHR(a[2]) || S_ISBLK(a[2]))) return -EPERM;
      if (may_change_name(a[0], real)) return SYS(number, a[0], real, a[2], a[3]);
      return number == SYS_mkdirat && SYS(SYS_faccessat, a[0], real, 0) == 0 ? -EEXIST : -EROFS;
    }
    /* A file that is changed. */
    case SYS_chmod: case SYS_chown: case SYS_truncate: case SYS_utime: case SYS_utimes: case SYS_setxattr: case SYS_removexattr: {
      const char *real = real_path((void *)a[0], first);
      return may_change(AT_FDCWD, real) ? SYS(number, real, a[1], a[2], a[3], a[4]) : -EROFS;
    }
    case SYS_fchmodat: case SYS_fchownat: case SYS_futimesat: case SYS_utimensat: {
      const char *real = real_path_at(a[0], (void *)a[1], first);
      int itself = (number == SYS_fchownat && a[4] & AT_SYMLINK_NOFOLLOW) || (number == SYS_utimensat && a[3] & AT_SYMLINK_NOFOLLOW);
      int may = !real ? may_change_open(a[0]) : itself && *real ? may_change_name(a[0], real) : may_change(a[0], real);
      return may ? SYS(number, a[0], real, a[2], a[3], a[4]) : -EROFS;
    }
    case SYS_fchmod: case SYS_fchown: case SYS_fsetxattr: case SYS_fremovexattr:
      return may_change_open(a[0]) ? SYS(number, a[0], a[1], a[2], a[3], a[4]) : -EROFS;
    /* Two paths. */
    case SYS_rename: case SYS_link: {
      const char *from = real_path((void *)a[0], first), *to = real_path((void *)a[1], second);
      return may_change_name(AT_FDCWD, from) && may_change_name(AT_FDCWD, to) ? SYS(number, from, to) : -EROFS;
    }
    case SYS_renameat: case SYS_renameat2: case SYS_linkat: {
      const char *from = real_path_at(a[0], (void *)a[1], first), *to = real_path_at(a[2], (void *)a[3], second);
      int follows = number == SYS_linkat && (a[4] & AT_SYMLINK_FOLLOW || !*from);
      int may = follows ? may_change(a[0], from) : may_change_name(a[0], from);
      return may && may_change_name(a[2], to) ? SYS(number, a[0], from, a[2], to, a[4]) : -EROFS;
    }
    case SYS_symlink: {
      const char *to = real_path((void *)a[1], second);
      return may_change_name(AT_FDCWD, to) ? SYS(number, linked((void *)a[0], first), to) : -EROFS;
    }
    default: { /* symlinkat */
      const char *to = real_path_at(a[1], (void *)a[2], second);
      return may_change_name(a[1], to) ? SYS(number, linked((void *)a[0], first), a[1], to) : -EROFS;
    }
  }
}
