/* Descriptors: reading, writing, and waiting for any of several.

   All descriptors are the kernel's, also those of emulated sockets, of which the program has one end of a pair. So `poll`,
   `select` and `epoll` are the kernel's, too: they are called with a time-out of zero, and again after each moment. */
#include "preload.h"
#include <fcntl.h>
#include <poll.h>
#include <sys/epoll.h>
#include <sys/ioctl.h>
#include <sys/resource.h>
#include <sys/select.h>
#include <sys/stat.h>

struct descriptor descriptors[DESCRIPTORS];

int is_own(int fd) { return fd >= FIRST_OWN && fd < DESCRIPTORS; }
static int in_table(int fd) { return fd >= 0 && fd < FIRST_OWN; }

int kind_of(int fd) {
  if (!in_table(fd)) return PLAIN;
  struct descriptor *d = &descriptors[fd];
  if (d->kind == UNKNOWN) {
    struct stat s;
    if (SYS(SYS_fstat, fd, &s)) return PLAIN;
    d->kind = S_ISREG(s.st_mode) || S_ISDIR(s.st_mode) || S_ISBLK(s.st_mode) ? PLAIN : POLLABLE;
  }
  return d->kind;
}

void new_descriptor(int fd, int kind) {
  if (in_table(fd)) descriptors[fd] = (struct descriptor){.kind = kind};
}

static void forget(int fd) {
  if (!in_table(fd)) return;
  struct descriptor *d = &descriptors[fd];
  if (d->kind == TIMER) close_timer(fd);
  if (d->kind == SIGNALS) close_signals(fd);
  if (d->sock && !--d->sock->references) release_sock(d->sock);
  *d = (struct descriptor){0};
}

static long closed(int fd) {
  if (is_own(fd)) return -EBADF;
  forget(fd);
  long r = SYS(SYS_close, fd);
  something(); /* the other end of a pipe may wait for this */
  return r;
}

static long duplicated(long fd, int from) {
  if (fd < 0 || !in_table(fd) || fd == from) return fd;
  if (in_table(from)) {
    descriptors[fd] = descriptors[from];
    if (descriptors[fd].sock) descriptors[fd].sock->references++;
    if (descriptors[fd].kind == TIMER || descriptors[fd].kind == SIGNALS) descriptors[fd].kind = POLLABLE; /* the timer is that of the first */
  }
  return fd;
}

int ready(int fd, int events) {
  struct pollfd p = {fd, events, 0};
  struct timespec zero = {0, 0};
  return SYS(SYS_ppoll, &p, 1, &zero, 0, 8) > 0;
}

static int is_net(int fd) { /* what comes to it may come from outside the agent; standard input is the terminal */
  return in_table(fd) && (fd == 0 || descriptors[fd].sock || descriptors[fd].net);
}

/* `fleet run --attach` gives the program a terminal. Who waits for what is typed there waits in the kernel, and nobody
   else goes on: so time stands still while the user thinks. */
static int is_terminal(int fd) {
  static dev_t terminal;
  struct stat s;
  if (!(config.flags & ATTACHED)) return 0;
  if (!terminal) terminal = SYS(SYS_fstat, 0, &s) || !S_ISCHR(s.st_mode) ? (dev_t)-1 : s.st_rdev;
  return !SYS(SYS_fstat, fd, &s) && S_ISCHR(s.st_mode) && s.st_rdev == terminal;
}

static void await_terminal(int fd) {
  struct pollfd p = {fd, POLLIN, 0};
  SYS(SYS_ppoll, &p, 1, 0, 0, 8);
}

/* Waits until a descriptor can be read or written. 0: it can, or it must not wait; else an error. */
int wait_ready(int fd, int events, int flags, i64 timeout) {
  if (ready(fd, events)) return 0;
  if (events == POLLIN && is_terminal(fd)) {
    await_terminal(fd);
    return 0;
  }
  long mode = SYS(SYS_fcntl, fd, F_GETFL);
  if ((mode & O_ACCMODE) == (events & POLLIN ? O_WRONLY : O_RDONLY)) return 0; /* the kernel says that it is the wrong end */
  if (flags & MSG_DONTWAIT || mode & O_NONBLOCK) {
    spins();
    return 0;
  }
  i64 deadline = timeout == NEVER ? NEVER : later(timeout);
  int handled = me->handled, restarts = me->restarts;
  do {
    int how = is_net(fd) ? block_net(&descriptors_changed, deadline) : block(&descriptors_changed, deadline);
    if (ready(fd, events)) return 0; /* as in the kernel, what can be done goes before a signal */
    if (me->handled - handled > me->restarts - restarts) return -EINTR;
    if (how == TIMED_OUT) return -EAGAIN;
  } while (1);
}

static long read_from(long number, int fd, void *to, size_t size) {
  int kind = kind_of(fd);
  if (kind == PLAIN) return SYS(number, fd, to, size);
  if (kind == CHANCE) {
    if (number == SYS_read) return draw_bytes(to, size), size;
    long all = 0;
    const struct iovec *v = to;
    for (size_t k = 0; k < size; all += v[k++].iov_len) draw_bytes(v[k].iov_base, v[k].iov_len);
    return all;
  }
  if (kind == DATAGRAMS || kind == STREAM || kind == ROUTES) {
    struct iovec one = {to, size};
    struct msghdr message = {.msg_iov = number == SYS_read ? &one : to, .msg_iovlen = number == SYS_read ? 1 : size};
    return receive_message(fd, &message, 0);
  }
  int error = wait_ready(fd, POLLIN, 0, NEVER);
  if (error) return error;
  long r = SYS(number, fd, to, size);
  something(); /* there is room in a pipe again */
  return r;
}

static long write_some(int fd, const void *from, size_t size) {
  /* A pipe that can be written takes at least PIPE_BUF bytes; with more at once the kernel would make us wait. */
  size_t done = 0;
  int waits = !(SYS(SYS_fcntl, fd, F_GETFL) & O_NONBLOCK);
  while (done < size || !size) {
    int error = wait_ready(fd, POLLOUT, 0, NEVER);
    if (error) return done ? (long)done : error;
    size_t part = waits && size - done > 4096 ? 4096 : size - done;
    long r = SYS(SYS_write, fd, (const u8 *)from + done, part);
    if (r < 0) return done ? (long)done : r;
    something();
    done += r;
    if (!waits || !size) break;
  }
  return done;
}

static long write_to(long number, int fd, const void *from, size_t size) {
  int kind = kind_of(fd);
  if (kind == PLAIN || kind == CHANCE) {
    long r = SYS(number, fd, from, size);
    if (r == -EFBIG) raise_signal(SIGXFSZ, me);
    return r;
  }
  const struct iovec one = {(void *)from, size}, *parts = number == SYS_write ? &one : from;
  size_t n = number == SYS_write ? 1 : size;
  if (kind == DATAGRAMS || kind == STREAM || kind == ROUTES) {
    struct msghdr message = {.msg_iov = (void *)parts, .msg_iovlen = n};
    return send_message(fd, &message, 0);
  }
  long done = 0;
  for (size_t k = 0; k < n; k++) {
    if (!parts[k].iov_len && n > 1) continue;
    long r = write_some(fd, parts[k].iov_base, parts[k].iov_len);
    if (r < 0) {
      if (r == -EPIPE && !done) raise_signal(SIGPIPE, me);
      return done ? done : r;
    }
    done += r;
    if ((size_t)r < parts[k].iov_len) break;
  }
  return done;
}

static long wait_poll(struct pollfd *p, size_t n, i64 timeout) {
  struct timespec zero = {0, 0};
  i64 deadline = timeout == NEVER ? NEVER : later(timeout);
  int net = 0, handled = me->handled;
  for (size_t k = 0; k < n; k++) net |= is_net(p[k].fd);
  for (;;) {
    long r = SYS(SYS_ppoll, p, n, &zero, 0, 8);
    if (r) return r;
    if (me->handled != handled) return -EINTR;
    if (timeout == 0) spins();
    if (timeout != NEVER && now >= deadline) return 0;
    if (timeout == NEVER && n == 1 && is_terminal(p->fd)) await_terminal(p->fd);
    else if (net) block_net(&descriptors_changed, deadline);
    else block(&descriptors_changed, deadline);
  }
}

static long wait_select(int n, fd_set *sets[3], i64 timeout) {
  i64 deadline = timeout == NEVER ? NEVER : later(timeout);
  int net = 0, handled = me->handled;
  size_t size = (n + 63) / 64 * 8;
  for (int fd = 0; fd < n; fd++)
    for (int k = 0; k < 3; k++) net |= sets[k] && FD_ISSET(fd, sets[k]) && is_net(fd);
  for (;;) {
    fd_set found[3];
    struct timespec zero = {0, 0};
    for (int k = 0; k < 3; k++)
      if (sets[k]) memcpy(&found[k], sets[k], size);
    long r = SYS(SYS_pselect6, n, sets[0] ? &found[0] : 0, sets[1] ? &found[1] : 0, sets[2] ? &found[2] : 0, &zero, 0);
    if (r == 0 && timeout == 0) spins();
    if (r || (timeout != NEVER && now >= deadline)) {
      for (int k = 0; k < 3 && r >= 0; k++)
        if (sets[k]) memcpy(sets[k], &found[k], size);
      return r;
    }
    if (me->handled != handled) return -EINTR;
    if (timeout == NEVER && n == 1 && is_terminal(0)) await_terminal(0);
    else if (net) block_net(&descriptors_changed, deadline);
    else block(&descriptors_changed, deadline);
  }
}

static long wait_epoll(int epoll, struct epoll_event *to, int most, i64 timeout) {
  i64 deadline = timeout == NEVER ? NEVER : later(timeout);
  int handled = me->handled;
  for (;;) {
    long r = SYS(SYS_epoll_pwait, epoll, to, most, 0, 0, 8);
    if (r) return r;
    if (me->handled != handled) return -EINTR;
    if (timeout == 0) spins();
    if (timeout != NEVER && now >= deadline) return 0;
    if (is_net(epoll)) block_net(&descriptors_changed, deadline);
    else block(&descriptors_changed, deadline);
  }
}

static long lock_file(long number, int fd, int operation, void *lock) {
  for (;;) {
    long r = number == SYS_flock ? SYS(SYS_flock, fd, operation | 4 /* LOCK_NB */)
                                 : SYS(SYS_fcntl, fd, operation == F_SETLKW ? F_SETLK : F_OFD_SETLK, lock);
    int waits = number == SYS_fcntl || !(operation & 4);
    if (!waits || (r != -EAGAIN && r != -EACCES)) {
      something();
      return r;
    }
    if (block(&descriptors_changed, NEVER) == SIGNALLED) return -EINTR;
  }
}

static long control(int fd, int command, long argument) {
  switch (command) {
    case F_DUPFD:
    case F_DUPFD_CLOEXEC: return duplicated(SYS(SYS_fcntl, fd, command, argument), fd);
    case F_SETLKW:
    case F_OFD_SETLKW: return lock_file(SYS_fcntl, fd, command, (void *)argument);
    case F_SETLK:
    case F_OFD_SETLK: {
      long r = SYS(SYS_fcntl, fd, command, argument);
      something();
      return r;
    }
    case F_SETOWN:
    case F_SETSIG: return 0; /* no signal comes from a descriptor: they come from us alone */
    case F_SETFL: return SYS(SYS_fcntl, fd, command, argument & ~O_ASYNC);
    default: return SYS(SYS_fcntl, fd, command, argument);
  }
}

static long close_many(unsigned first, unsigned last, unsigned flags) {
  for (unsigned fd = first; fd <= last && fd < FIRST_OWN; fd++) {
    if (flags & 4 /* CLOSE_RANGE_CLOEXEC */) {
      long was = SYS(SYS_fcntl, fd, F_GETFD);
      if (was >= 0) SYS(SYS_fcntl, fd, F_SETFD, was | FD_CLOEXEC);
    } else if (descriptors[fd].kind != UNKNOWN || SYS(SYS_fcntl, fd, F_GETFD) >= 0) closed(fd);
  }
  return 0;
}

/* The program opens descriptors below its limit, and we above it: the limit is lifted while we make one of ours. */
static struct rlimit files_limit = {MOST_FILES, MOST_FILES};

void limit_files(int lifted) {
  struct rlimit most = {lifted ? DESCRIPTORS : files_limit.rlim_cur, DESCRIPTORS};
  SYS(SYS_prlimit64, 0, RLIMIT_NOFILE, &most, 0);
}

long own_descriptor(int fd) {
  limit_files(1);
  long own = SYS(SYS_fcntl, fd, F_DUPFD_CLOEXEC, FIRST_OWN);
  limit_files(0);
  return own;
}

static long limit(long pid, int resource, const struct rlimit *to, struct rlimit *before) {
  int own = pid == 0 || pid == (long)config.pid;
  if (resource == RLIMIT_NOFILE) {
    if (before) *before = files_limit;
    if (!to || !own) return 0;
    if (to->rlim_cur > to->rlim_max) return -EINVAL;
    if (to->rlim_max > files_limit.rlim_max) return -EPERM;
    files_limit = *to;
    limit_files(0);
    return 0;
  }
  /* Memory begins where the stack's limit says; the two others depend on the host and its other processes. */
  int kept = resource == RLIMIT_STACK || resource == RLIMIT_CPU || resource == RLIMIT_NPROC;
  return SYS(SYS_prlimit64, own ? 0 : pid, resource, kept ? 0 : to, before);
}

/* Calls whose first argument is a descriptor: none of ours may be read, written or closed. */
static int names_own(long number, const long a[6]) {
  switch (number) {
    case SYS_read: case SYS_readv: case SYS_write: case SYS_writev: case SYS_dup: case SYS_dup2: case SYS_dup3: case SYS_fcntl: case SYS_ioctl:
    case SYS_flock: case SYS_epoll_wait: case SYS_epoll_pwait: case SYS_epoll_pwait2: return is_own(a[0]);
    case SYS_sendfile: return is_own(a[0]) || is_own(a[1]);
    case SYS_epoll_ctl: return is_own(a[0]) || is_own(a[2]);
    default: return 0;
  }
}

long descriptor_call(long number, const long a[6]) {
  if (names_own(number, a)) return -EBADF;
  switch (number) {
    case SYS_read:
    case SYS_readv: return read_from(number, a[0], (void *)a[1], a[2]);
    case SYS_write:
    case SYS_writev: return write_to(number, a[0], (void *)a[1], a[2]);
    case SYS_close: return closed(a[0]);
    case SYS_close_range: return close_many(a[0], a[1], a[2]);
    case SYS_dup: return duplicated(SYS(SYS_dup, a[0]), a[0]);
    case SYS_dup2:
    case SYS_dup3: {
      if (is_own(a[1])) return -EBADF;
      if ((int)a[0] != (int)a[1] && SYS(SYS_fcntl, a[0], F_GETFD) >= 0) forget(a[1]);
      long r = duplicated(SYS(number, a[0], a[1], a[2]), a[0]);
      something();
      return r;
    }
    case SYS_fcntl: return control(a[0], a[1], a[2]);
    case SYS_flock: return lock_file(SYS_flock, a[0], a[1], 0);
    case SYS_ioctl: {
      int kind = kind_of(a[0]);
      unsigned request = a[1];
      if (request == FIONREAD && kind == DATAGRAMS) {
        struct iovec none = {0, 0};
        struct msghdr message = {.msg_iov = &none, .msg_iovlen = 0};
        long n = ready(a[0], POLLIN) ? receive_message(a[0], &message, MSG_PEEK | MSG_TRUNC | MSG_DONTWAIT) : 0;
        *(int *)a[2] = n < 0 ? 0 : n;
        return 0;
      }
      if (request == 0x8906 /* SIOCGSTAMP */ || request == 0x8907 /* SIOCGSTAMPNS */) {
        struct sock *s = sock_of(a[0]);
        if (!s || !s->last_stamp) return -ENOENT;
        i64 at = s->last_stamp;
        ((long *)a[2])[0] = at / SECOND, ((long *)a[2])[1] = request == 0x8906 ? at % SECOND / 1000 : at % SECOND;
        return 0;
      }
      if (request == FIOASYNC || request == TIOCSCTTY || request == TIOCNOTTY) return 0; /* sessions are not the kernel's */
      if ((request & 0xff00) == 0x8900) return interface_ioctl(request, (void *)a[2]);
      return SYS(SYS_ioctl, a[0], a[1], a[2]);
    }
    case SYS_poll: return wait_poll((void *)a[0], a[1], (int)a[2] < 0 ? NEVER : (int)a[2] * 1000000LL);
    case SYS_ppoll: return wait_poll((void *)a[0], a[1], span((void *)a[2]));
    case SYS_select: {
      struct timespec t, *given = 0;
      const i64 *micro = (void *)a[4];
      if (micro) t = (struct timespec){micro[0], micro[1] * 1000}, given = &t;
      return wait_select(a[0], (fd_set *[3]){(void *)a[1], (void *)a[2], (void *)a[3]}, span(given));
    }
    case SYS_pselect6: return wait_select(a[0], (fd_set *[3]){(void *)a[1], (void *)a[2], (void *)a[3]}, span((void *)a[4]));
    case SYS_epoll_wait:
    case SYS_epoll_pwait: return wait_epoll(a[0], (void *)a[1], a[2], (int)a[3] < 0 ? NEVER : (int)a[3] * 1000000LL);
    case SYS_epoll_pwait2: return wait_epoll(a[0], (void *)a[1], a[2], span((void *)a[3]));
    case SYS_epoll_ctl: {
      long r = SYS(SYS_epoll_ctl, a[0], a[1], a[2], a[3]);
      if (!r && in_table(a[0]) && is_net(a[2])) descriptors[a[0]].net = 1;
      something(); /* another thread may wait there for what was added */
      return r;
    }
    case SYS_sendfile: { /* by reading and writing: either end may be ours */
      static u8 part[16384];
      size_t done = 0;
      while (done < (size_t)a[3]) {
        size_t n = a[3] - done < sizeof part ? a[3] - done : sizeof part;
        long got = a[2] ? SYS(SYS_pread64, a[1], part, n, *(i64 *)a[2]) : read_from(SYS_read, a[1], part, n);
        if (got <= 0) return done ? (long)done : got;
        long put = write_to(SYS_write, a[0], part, got);
        if (put < 0) return done ? (long)done : put;
        if (a[2]) *(i64 *)a[2] += put;
        done += put;
        if (put < got) break;
      }
      return done;
    }
    case SYS_prlimit64: return limit((int)a[0], a[1], (void *)a[2], (void *)a[3]);
    case SYS_getrlimit: return limit(0, a[0], 0, (void *)a[1]);
    default: return limit(0, a[0], (void *)a[1], 0); /* setrlimit */
  }
}
