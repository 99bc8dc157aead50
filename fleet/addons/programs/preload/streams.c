/* Streams (TCP): what a program sees of a connection. Its segments, their loss and their repetition are the controller's.

   The program has one end of a pair of stream sockets; the library writes into the other end what arrives, and keeps what
   does not fit. What a program sends goes to the controller at once, which says later how much has been acknowledged. */
#include "preload.h"
#include <fcntl.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/mman.h>

enum { MOST_UNSENT = 1 << 18, PART = 1 << 15 };
static u64 connections;
struct call { u64 connection; struct address from, to; } __attribute__((packed));
struct queued { struct call call; u16 sock; u64 id; } __attribute__((packed)); /* a call that nobody has taken yet */

/* Memory of our own: malloc may be what was interrupted. */
static u8 *more_room(u8 *old, size_t had, size_t wanted) {
  long at = old ? SYS(SYS_mremap, old, had, wanted, MREMAP_MAYMOVE)
                : SYS(SYS_mmap, 0, wanted, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
  if (at < 0) give_up("no memory is left for what arrives on a stream");
  return (u8 *)at;
}

static void free_room(struct sock *s) {
  if (s->waiting) SYS(SYS_munmap, s->waiting, s->room);
  s->waiting = 0, s->room = s->n_waiting = 0;
}

/* While a socket must not look writable, the program's end is full of bytes that nobody reads. */
static void congest(int fd, struct sock *s) {
  static u8 junk[65536];
  if (s->congested) return;
  s->congested = 1;
  while (SYS(SYS_sendto, fd, junk, sizeof junk, MSG_DONTWAIT | MSG_NOSIGNAL, 0, 0) > 0) {}
  while (SYS(SYS_sendto, fd, junk, 1, MSG_DONTWAIT | MSG_NOSIGNAL, 0, 0) > 0) {}
}

static void relieve(struct sock *s) {
  static u8 junk[65536];
  if (!s->congested) return;
  s->congested = 0;
  while (SYS(SYS_recvfrom, s->peer, junk, sizeof junk, MSG_DONTWAIT, 0, 0) > 0) {}
}

static size_t most_unsent(const struct sock *s) { return s->most_unsent ? s->most_unsent : MOST_UNSENT; }

/* Writes into the pair what has come, as far as it fits. */
static void pour(struct sock *s) {
  size_t done = 0;
  while (done < s->n_waiting) {
    long r = SYS(SYS_sendto, s->peer, s->waiting + done, s->n_waiting - done, MSG_DONTWAIT | MSG_NOSIGNAL, 0, 0);
    if (r <= 0) break;
    done += r;
  }
  if (done) memmove(s->waiting, s->waiting + done, s->n_waiting -= done);
  if (!s->n_waiting && s->got_end == 1) {
    SYS(SYS_shutdown, s->peer, SHUT_WR);
    s->got_end = 2;
  }
  if (!s->n_waiting) free_room(s);
}

void stream_received(struct sock *s) {
  size_t had = s->n_waiting;
  pour(s);
  if (had && s->n_waiting != had && s->connection) { /* the sender may send more */
    struct { u64 connection; u32 waiting; } __attribute__((packed)) head = {s->connection, (u32)s->n_waiting};
    tell('V', &head, sizeof head, 0, 0);
  }
}

static void end_sending(struct sock *s) {
  if (s->sent_end || !s->connection) return;
  s->sent_end = 1;
  tell('F', &s->connection, 8, 0, 0);
}

void stream_close(struct sock *s) {
  /* What was sent and not acknowledged is still sent by the controller. Unread bytes, or bytes that still come, are
     answered by a reset, as in TCP. */
  if (s->connection && !s->borrowed) {
    u8 unread = s->n_waiting > 0 || s->resets;
    struct { u64 connection; u8 unread; } __attribute__((packed)) head = {s->connection, unread};
    tell('K', &head, sizeof head, 0, 0);
  }
  if (s->listening) { /* calls that nobody took */
    for (struct sock *n = socks; n < socks + SOCKETS; n++)
      if (n->used && n->type == SOCK_STREAM && n->listener == s - socks + 1) {
        SYS(SYS_close, n->own_end);
        stream_close(n);
      }
  }
  free_room(s);
  leave_port(s);
  SYS(SYS_close, s->peer);
  s->used = 0;
}

long stream_listen(int fd, struct sock *s) {
  (void)fd;
  if (s->connected || s->connecting) return -EINVAL;
  if (s->listening) return 0;
  /* The pair carries calls from now on, each of the same length. It stays the same pair: an epoll may know it already. */
  s->listening = 1;
  return 0;
}

long stream_connect(int fd, struct sock *s) {
  if (!connections) connections = now / 1000000 % (1 << 30); /* a life after a kill is to have other numbers */
  s->connection = (u64)config.agent << 48 | (u64)(config.pid / 1000 & 0xffff) << 32 | ++connections << 1; /* a process's number grows by 1000 */
  s->connecting = 1;
  struct call call = {s->connection, s->own, s->to};
  int v6 = !is_v4(s->to.ip);
  if (is_loopback(s->to.ip)) memcpy(call.from.ip, s->to.ip, 16);
  else own_address(call.from.ip, v6);
  if (is_mine(s->to.ip)) memcpy(call.from.ip, s->to.ip, 16);
  tell('A', &call, sizeof call, 0, 0);
  congest(fd, s);
  if (SYS(SYS_fcntl, fd, F_GETFL) & O_NONBLOCK) {
    s->fresh = 1;
    /* To an own address it stands, or is refused, in this moment. */
    for (int k = 0; k < 4 && s->connecting && (is_mine(s->to.ip) || is_loopback(s->to.ip)); k++) block_net(s, now);
    return -EINPROGRESS;
  }
  i64 deadline = s->send_timeout == NEVER ? NEVER : later(s->send_timeout);
  while (s->connecting) {
    int how = block_net(s, deadline);
    if (how == TIMED_OUT && s->connecting) return -EINPROGRESS;
    if (how == SIGNALLED && s->connecting) return -EINTR;
  }
  int error = s->error;
  s->error = 0;
  return -error;
}

/* A call in the queue has both ends of its pair with it, since any process that has the socket may take it. */
union ends { struct cmsghdr header; char space[CMSG_SPACE(2 * sizeof(int))]; };

static long send_call(int to, const struct queued *queued, const int ends[2]) {
  struct iovec part = {(void *)queued, sizeof *queued};
  union ends control = {.header = {.cmsg_len = CMSG_LEN(2 * sizeof(int)), .cmsg_level = SOL_SOCKET, .cmsg_type = SCM_RIGHTS}};
  memcpy(CMSG_DATA(&control.header), ends, 2 * sizeof *ends);
  struct msghdr m = {.msg_iov = &part, .msg_iovlen = 1, .msg_control = &control, .msg_controllen = sizeof control};
  return SYS(SYS_sendmsg, to, &m, MSG_DONTWAIT | MSG_NOSIGNAL);
}

static long receive_call(int from, struct queued *queued, int ends[2]) {
  struct iovec part = {queued, sizeof *queued};
  union ends control;
  struct msghdr m = {.msg_iov = &part, .msg_iovlen = 1, .msg_control = &control, .msg_controllen = sizeof control};
  long r = SYS(SYS_recvmsg, from, &m, MSG_DONTWAIT);
  if (r < 0) return r;
  if (m.msg_controllen < CMSG_LEN(2 * sizeof(int))) return -EMFILE;
  memcpy(ends, CMSG_DATA(&control.header), 2 * sizeof *ends);
  return r;
}

static void connect_call(struct sock *n, const struct sock *listener, const struct call *call, u64 id) {
  memset(n, 0, sizeof *n);
  n->used = 1, n->type = SOCK_STREAM, n->v6 = listener->v6;
  n->bound = n->connected = 1, n->own = call->to, n->to = call->from, n->connection = call->connection;
  n->receive_timeout = n->send_timeout = NEVER;
  n->id = id;
}

static struct sock *take_call(const struct sock *listener, const struct queued *queued, int peer) {
  struct sock *n = socks;
  while (n < socks + SOCKETS && n->used) n++;
  int own = n == socks + SOCKETS ? -EMFILE : own_descriptor(peer);
  SYS(SYS_close, peer);
  if (own < 0) return 0;
  connect_call(n, listener, &queued->call, queued->id);
  n->peer = own, n->shared = n->borrowed = 1;
  struct { u64 id, connection; } head = {n->id, n->connection};
  tell('a', &head, sizeof head, 0, 0);
  did_something = 1;
  return n;
}

long stream_accept(int fd, struct sock *s, struct sockaddr *to, socklen_t *size, int flags) {
  if (!s->listening) return -EINVAL;
  int error = wait_ready(fd, POLLIN, 0, s->receive_timeout);
  if (error) return error;
  struct queued queued;
  int ends[2] = {-1, -1}; /* the program's, and ours */
  long r = receive_call(fd, &queued, ends);
  if (r < 0) return r;
  struct sock *n = &socks[queued.sock];
  if (queued.id >> 16 != config.pid) n = take_call(s, &queued, ends[1]); /* another process has answered it */
  else SYS(SYS_close, ends[1]), SYS(SYS_close, n->own_end);
  if (!n) {
    SYS(SYS_close, ends[0]);
    return -EMFILE;
  }
  long made = ends[0];
  if (flags & SOCK_CLOEXEC) SYS(SYS_fcntl, made, F_SETFD, FD_CLOEXEC);
  if (flags & SOCK_NONBLOCK) SYS(SYS_fcntl, made, F_SETFL, O_NONBLOCK);
  n->listener = 0, n->references = 1;
  new_descriptor(made, STREAM);
  descriptors[made].sock = n;
  put_address(to, size, &n->to, n->v6);
  return made;
}

/* A connection stands as soon as its call is in the queue of a socket that listens, before anybody takes it. */
static int queue_call(struct sock *s, const struct call *call) {
  struct sock *n = socks;
  while (n < socks + SOCKETS && n->used) n++;
  if (n == socks + SOCKETS) return 0;
  int peer, end = own_pair(SOCK_STREAM, 0, &peer);
  if (end < 0) return 0;
  connect_call(n, s, call, (u64)config.pid << 16 | (n - socks));
  n->peer = peer, n->listener = s - socks + 1;
  n->own_end = own_descriptor(end);
  SYS(SYS_close, end);
  struct queued queued = {*call, n - socks, n->id};
  if (send_call(s->peer, &queued, (int[2]){n->own_end, n->peer}) > 0) return 1;
  SYS(SYS_close, n->own_end);
  SYS(SYS_close, n->peer);
  n->used = 0;
  return 0;
}

static struct sock *by_connection(u64 connection) {
  for (struct sock *s = socks; s < socks + SOCKETS; s++)
    if (s->used && s->type == SOCK_STREAM && s->connection == connection) return s;
  return 0;
}

static int called(const struct call *call) {
  for (struct sock *s = socks; s < socks + SOCKETS; s++)
    if (s->used && !s->borrowed && s->listening && s->own.port == call->to.port &&
        (is_v4(call->to.ip) ? !(s->v6 && s->v6_only) : s->v6)) {
      static const u8 none[16];
      int everywhere = !memcmp(s->own.ip, none, 16) || (is_v4(s->own.ip) && !memcmp(s->own.ip + 12, none, 4));
      if (everywhere || !memcmp(s->own.ip, call->to.ip, 16)) return queue_call(s, call);
    }
  return 0;
}

void deliver_stream(struct message m) {
  u64 connection;
  memcpy(&connection, m.data, 8);
  if (m.kind == 'A') {
    struct call call;
    memcpy(&call, m.data, sizeof call);
    tell(called(&call) ? 'P' : 'X', &call.connection, 8, 0, 0); /* X: refused */
    return;
  }
  struct sock *s = by_connection(connection);
  if (!s) return;
  switch (m.kind) {
    case 'O': /* it stands */
      s->connecting = 0, s->connected = 1;
      relieve(s);
      break;
    case 'E': { /* it failed: refused, timed out, reset */
      int error;
      memcpy(&error, m.data + 8, 4);
      relieve(s);
      if (s->connecting || !s->closing) s->error = error;
      s->connecting = 0, s->stopped = 1, s->got_end = 2;
      s->connection = 0;
      SYS(SYS_shutdown, s->peer, SHUT_RDWR);
      break;
    }
    case 'R':
      if (s->got_end || s->borrowed) return;
      if (s->n_waiting + m.size - 8 > s->room) {
        size_t room = (s->n_waiting + m.size - 8 + 65535) & ~65535UL;
        s->waiting = more_room(s->waiting, s->room, room);
        s->room = room;
      }
      memcpy(s->waiting + s->n_waiting, m.data + 8, m.size - 8);
      s->n_waiting += m.size - 8;
      pour(s);
      if (s->n_waiting) {
        struct { u64 connection; u32 waiting; } __attribute__((packed)) head = {s->connection, (u32)s->n_waiting};
        tell('V', &head, sizeof head, 0, 0);
      }
      break;
    case 'Z':
      if (s->borrowed) break;
      if (!s->got_end) s->got_end = 1;
      pour(s);
      break;
    case 'Q': { /* so many bytes were acknowledged */
      u32 n;
      memcpy(&n, m.data + 8, 4);
      s->unsent -= n < s->unsent ? n : s->unsent;
      if (s->unsent < most_unsent(s) / 2) relieve(s);
      break;
    }
  }
  wake_all(s);
}

long stream_send(int fd, struct sock *s, const struct msghdr *message, int flags) {
  if (s->error) {
    int error = s->error;
    s->error = 0;
    return -error;
  }
  if (s->connecting) return -EAGAIN;
  if (!s->connected || s->stopped) {
    if (s->connected && !(flags & MSG_NOSIGNAL)) raise_signal(SIGPIPE, me);
    return s->connected ? -EPIPE : -ENOTCONN;
  }
  int waits = !(flags & MSG_DONTWAIT || SYS(SYS_fcntl, fd, F_GETFL) & O_NONBLOCK);
  size_t done = 0;
  for (size_t k = 0; k < (size_t)message->msg_iovlen; k++)
    for (size_t at = 0; at < message->msg_iov[k].iov_len;) {
      while (s->unsent >= most_unsent(s)) {
        congest(fd, s);
        if (!waits) {
          spins();
          return done ? (long)done : -EAGAIN;
        }
        if (block_net(s, NEVER) == SIGNALLED) return done ? (long)done : -EINTR;
        if (s->stopped) return done ? (long)done : -EPIPE;
      }
      size_t n = message->msg_iov[k].iov_len - at, room = most_unsent(s) - s->unsent;
      if (n > PART) n = PART;
      if (n > room) n = room;
      tell('W', &s->connection, 8, (u8 *)message->msg_iov[k].iov_base + at, n);
      s->unsent += n, at += n, done += n;
    }
  return done;
}

long stream_shutdown(struct sock *s, int how) {
  if (!s->connected) return -ENOTCONN;
  if (how != SHUT_RD) {
    end_sending(s);
    s->stopped = 1;
  }
  if (how != SHUT_WR) {
    s->got_end = 2;
    SYS(SYS_shutdown, s->peer, SHUT_WR);
  }
  something();
  return 0;
}

void close_streams(void) {
  for (struct sock *s = socks; s < socks + SOCKETS; s++) {
    if (!s->used) continue;
    struct { u64 id, connection; } shared = {s->id, s->connection};
    struct { u64 connection; u8 unread; } __attribute__((packed)) head = {s->connection, s->n_waiting > 0 || s->resets};
    if (s->shared) {
      for (size_t at = 0; !s->borrowed && at < s->n_waiting; at += PART)
        tell('x', &shared, sizeof shared, s->waiting + at, s->n_waiting - at < PART ? s->n_waiting - at : PART);
    } else if (s->type == SOCK_STREAM && s->connection && !s->borrowed) tell('K', &head, sizeof head, 0, 0);
  }
}
