/* Unix sockets are the kernel's. Their names are files of the agent, or belong to this agent and run alone. */
#include "preload.h"
#include <fcntl.h>
#include <poll.h>
#include <stdio.h>
#include <sys/un.h>

/* The name as the kernel is to know it; its size, or an error below 0. */
static int mapped_socket(const struct sockaddr *from, socklen_t size, struct sockaddr *to_) {
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
  if (!may_change(AT_FDCWD, real)) return -EACCES; /* somebody of the machine may listen there */
  if (strlen(real) >= sizeof to->sun_path) { /* the folder of a run may have a long name: by its descriptor it is short */
    static int folder = -1;
    if (folder < 0) {
      long opened = SYS(SYS_openat, AT_FDCWD, home, O_PATH | O_DIRECTORY | O_CLOEXEC, 0);
      folder = own_descriptor(opened);
      SYS(SYS_close, opened);
    }
    if (!is_own_folder(real)) return -ENAMETOOLONG;
    if (snprintf(to->sun_path, sizeof to->sun_path, "/proc/self/fd/%d%s", folder, real + strlen(home)) >= (int)sizeof to->sun_path)
      return -ENAMETOOLONG;
  } else memcpy(to->sun_path, real, strlen(real) + 1);
  return head + strlen(to->sun_path) + 1;
}

/* The name of a Unix socket as the program knows it. */
void show_socket(struct sockaddr *name, socklen_t *size, socklen_t room) {
  static char path[4096];
  struct sockaddr_un *un = (void *)name;
  size_t head = offsetof(struct sockaddr_un, sun_path);
  if (!un || !size || *size <= head || *size > sizeof *un || *size > room || un->sun_family != AF_UNIX) return;
  size_t n = *size - head;
  if (!un->sun_path[0]) { /* without the mark of this run */
    if (n < 17) return;
    memmove(un->sun_path + 1, un->sun_path + 17, n - 17);
    *size -= 16;
    return;
  }
  memcpy(path, un->sun_path, n);
  path[n] = 0;
  int number, skip = 0;
  if (sscanf(path, "/proc/self/fd/%d%n", &number, &skip) == 1 && number >= FIRST_OWN) {
    n = strlen(path + skip);
    memmove(path + strlen(home), path + skip, n + 1);
    memcpy(path, home, strlen(home));
  }
  if (!is_own_folder(path)) return;
  shown_path(path);
  n = strlen(path) + 1;
  if (head + n > room) return;
  memcpy(un->sun_path, path, n);
  *size = head + n;
}

/* Whether a message hands over a descriptor of which this library knows more than the kernel. */
static int hands_over(const struct msghdr *m) {
  if (!m->msg_control || m->msg_controllen < sizeof(struct cmsghdr)) return 0;
  for (const struct cmsghdr *c = CMSG_FIRSTHDR(m); c; c = CMSG_NXTHDR((struct msghdr *)m, (struct cmsghdr *)c))
    if (c->cmsg_level == SOL_SOCKET && c->cmsg_type == SCM_RIGHTS)
      for (size_t k = 0; CMSG_LEN((k + 1) * sizeof(int)) <= c->cmsg_len; k++) {
        int fd;
        memcpy(&fd, CMSG_DATA(c) + k * sizeof fd, sizeof fd);
        if (is_own(fd) || (kind_of(fd) != PLAIN && kind_of(fd) != POLLABLE)) return 1;
      }
  return 0;
}

/* Calls that would wait in the kernel wait here. */
long unix_call(long number, const long a[6]) {
  static struct sockaddr_un to;
  switch (number) {
    case SYS_connect: {
      int size = mapped_socket((void *)a[1], a[2], (void *)&to);
      if (size < 0) return size;
      long r = SYS(SYS_connect, a[0], &to, size);
      something();
      return r;
    }
    case SYS_bind: {
      int size = mapped_socket((void *)a[1], a[2], (void *)&to);
      return size < 0 ? size : SYS(SYS_bind, a[0], &to, size);
    }
    case SYS_accept:
    case SYS_accept4: {
      int error = wait_ready(a[0], POLLIN, 0, NEVER);
      if (error) return error;
      socklen_t room = a[1] && a[2] ? *(socklen_t *)a[2] : 0;
      long fd = SYS(SYS_accept4, a[0], a[1], a[2], number == SYS_accept4 ? a[3] : 0);
      if (fd >= 0) new_descriptor(fd, POLLABLE);
      if (fd >= 0 && room) show_socket((void *)a[1], (void *)a[2], room);
      something();
      return fd;
    }
    case SYS_sendto:
    case SYS_sendmsg: {
      struct sockaddr *name = number == SYS_sendto ? (void *)a[4] : ((struct msghdr *)a[1])->msg_name;
      socklen_t n = number == SYS_sendto ? a[5] : ((struct msghdr *)a[1])->msg_namelen;
      int flags = number == SYS_sendto ? a[3] : a[2], size = 0;
      if (name && n && name->sa_family == AF_UNIX && (size = mapped_socket(name, n, (void *)&to)) < 0) return size;
      if (number == SYS_sendmsg && hands_over((void *)a[1])) {
        say("a socket of the network, a timer or a source of chance is sent to a process, which is refused in simulated time");
        return -EPERM;
      }
      for (;;) {
        struct msghdr m;
        if (number == SYS_sendmsg) m = *(struct msghdr *)a[1], m.msg_name = size ? &to : 0, m.msg_namelen = size;
        long r = number == SYS_sendto ? SYS(SYS_sendto, a[0], a[1], a[2], flags | MSG_DONTWAIT | MSG_NOSIGNAL, size ? &to : 0, size)
                                      : SYS(SYS_sendmsg, a[0], &m, flags | MSG_DONTWAIT | MSG_NOSIGNAL);
        something();
        if (r == -EPIPE && !(flags & MSG_NOSIGNAL)) raise_signal(SIGPIPE, me);
        if (r != -EAGAIN || flags & MSG_DONTWAIT || SYS(SYS_fcntl, a[0], F_GETFL) & O_NONBLOCK) return r;
        if (block(&descriptors_changed, NEVER) == SIGNALLED) return -EINTR;
      }
    }
    case SYS_recvfrom: {
      int error = wait_ready(a[0], POLLIN, a[3], NEVER);
      if (error) return error;
      socklen_t room = a[4] && a[5] ? *(socklen_t *)a[5] : 0;
      long r = SYS(SYS_recvfrom, a[0], a[1], a[2], a[3], a[4], a[5]);
      if (r >= 0 && room) show_socket((void *)a[4], (void *)a[5], room);
      something();
      return r;
    }
    case SYS_recvmsg: return receive_message(a[0], (void *)a[1], a[2]);
    case SYS_getsockname:
    case SYS_getpeername: {
      socklen_t room = *(socklen_t *)a[2];
      long r = SYS(number, a[0], a[1], a[2]);
      if (r == 0) show_socket((void *)a[1], (void *)a[2], room);
      return r;
    }
    default: {
      long r = SYS(number, a[0], a[1], a[2], a[3], a[4]);
      something();
      return r;
    }
  }
}
