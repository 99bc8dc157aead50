/* Sockets: datagrams of IPv4 and IPv6 between agents. Node N has the addresses 10.0.0.N and fd00::N.

   The program has one end of a pair of Unix sockets, and the library the other, a descriptor from 2048 on. What arrives is
   written into the library's end, behind a head that says from whom; the kernel keeps the queue, and its limit. */
#include "preload.h"
#include <arpa/inet.h>
#include <fcntl.h>
#include <linux/net_tstamp.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <netinet/udp.h>
#include <poll.h>

struct sock socks[SOCKETS];
struct head { struct address from, to; i64 at; } __attribute__((packed));
enum { MOST_PAYLOAD = 65507 };

const u8 v4_mapped[12] = {0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 255, 255};
static const u8 any[16], loopback6[16] = {[15] = 1};

struct sock *sock_of(int fd) { return fd >= 0 && fd < FIRST_OWN ? descriptors[fd].sock : 0; }

int is_v4(const u8 *ip) { return !memcmp(ip, v4_mapped, 12); }
static int is_any(const u8 *ip) { return !memcmp(ip, any, 16) || (is_v4(ip) && !memcmp(ip + 12, any, 4)); }
int is_loopback(const u8 *ip) { return is_v4(ip) ? ip[12] == 127 : !memcmp(ip, loopback6, 16); }
static int is_multicast(const u8 *ip) { return is_v4(ip) ? ip[12] >> 4 == 14 : ip[0] == 255; }
static int is_broadcast(const u8 *ip) {
  if (!is_v4(ip)) return 0;
  u32 v = (u32)ip[12] << 24 | ip[13] << 16 | ip[14] << 8 | ip[15], host = ~0u >> config.prefix;
  return v == ~0u || ((v & ~host) == 0x0a000000 && (v & host) == host);
}
int is_everybody(const u8 *ip) { return is_multicast(ip) || is_broadcast(ip); }

void own_address(u8 *ip, int v6) {
  static const u8 net[16] = {0xfd};
  memcpy(ip, net, 16);
  ip[14] = config.agent >> 8, ip[15] = config.agent;
  if (!v6) {
    memcpy(ip, v4_mapped, 12);
    ip[12] = 10, ip[13] = 0;
  }
}

int is_mine(const u8 *ip) {
  u8 own[16];
  own_address(own, !is_v4(ip));
  return !memcmp(ip, own, 16) || (!is_v4(ip) && ip[0] == 0xfe && ip[1] == 0x80 && ip[14] == own[14] && ip[15] == own[15]);
}

/* Whether there can be an agent: an address of the network that the agents share. */
static int is_inside(const u8 *ip) {
  if (config.flags & OTHER_ADDRESSES || is_loopback(ip) || is_everybody(ip) || is_any(ip)) return 1;
  if (is_v4(ip)) return ip[12] == 10 && ip[13] == 0 && (config.prefix == 16 || ip[14] == 0);
  return ip[0] == 0xfd || (ip[0] == 0xfe && ip[1] == 0x80);
}

int get_address(const struct sockaddr *from, socklen_t size, const struct sock *s, struct address *to) {
  if (from->sa_family == AF_INET && size >= sizeof(struct sockaddr_in)) {
    const struct sockaddr_in *v4 = (void *)from;
    memcpy(to->ip, v4_mapped, 12);
    memcpy(to->ip + 12, &v4->sin_addr, 4);
    to->port = ntohs(v4->sin_port);
    return 0;
  }
  if (from->sa_family == AF_INET6 && size >= 24) {
    if (!s->v6) return -EAFNOSUPPORT;
    const struct sockaddr_in6 *v6 = (void *)from;
    memcpy(to->ip, &v6->sin6_addr, 16);
    to->port = ntohs(v6->sin6_port);
    return 0;
  }
  return from->sa_family == AF_INET || from->sa_family == AF_INET6 ? -EINVAL : -EAFNOSUPPORT;
}

void put_address(struct sockaddr *to, socklen_t *size, const struct address *from, int v6) {
  if (!to || !size) return;
  struct sockaddr_in a4 = {.sin_family = AF_INET, .sin_port = htons(from->port)};
  struct sockaddr_in6 a6 = {.sin6_family = AF_INET6, .sin6_port = htons(from->port)};
  memcpy(&a4.sin_addr, from->ip + 12, 4);
  memcpy(&a6.sin6_addr, from->ip, 16);
  if (from->ip[0] == 0xfe && from->ip[1] == 0x80) a6.sin6_scope_id = 2;
  socklen_t full = v6 ? sizeof a6 : sizeof a4;
  memcpy(to, v6 ? (void *)&a6 : (void *)&a4, *size < full ? *size : full);
  *size = full;
}

/* A pair of sockets: the program's end is returned, and `peer` becomes ours. */
int own_pair(int type, int flags, int *peer) {
  int pair[2];
  long error = SYS(SYS_socketpair, AF_UNIX, type | flags, 0, pair);
  if (error) return error;
  long own = own_descriptor(pair[1]);
  SYS(SYS_close, pair[1]);
  if (own < 0) {
    SYS(SYS_close, pair[0]);
    return -EMFILE;
  }
  SYS(SYS_fcntl, own, F_SETFL, O_NONBLOCK);
  *peer = own;
  return pair[0];
}

static long open_socket(int domain, int type, int protocol) {
  int kind = type & 0xf, flags = type & (SOCK_CLOEXEC | SOCK_NONBLOCK);
  if (domain == AF_UNIX) {
    long fd = SYS(SYS_socket, domain, type, protocol);
    if (fd >= 0) new_descriptor(fd, POLLABLE);
    return fd;
  }
  if (domain == AF_NETLINK && protocol == 0) return open_routes(flags);
  if (domain != AF_INET && domain != AF_INET6) {
    if (domain != AF_NETLINK) say("a socket of family %d is refused: there is IPv4, IPv6 and Unix in simulated time", domain);
    return -EAFNOSUPPORT;
  }
  if (kind != SOCK_DGRAM && kind != SOCK_STREAM) {
    say("a raw socket is refused in simulated time; on the wall clock: fleet netem");
    return -EPERM;
  }
  if (protocol && protocol != (kind == SOCK_DGRAM ? IPPROTO_UDP : IPPROTO_TCP)) return -EPROTONOSUPPORT; /* ping, SCTP */
  struct sock *s = socks;
  while (s < socks + SOCKETS && s->used) s++;
  if (s == socks + SOCKETS) return -EMFILE;
  memset(s, 0, sizeof *s);
  int fd = own_pair(kind, flags, &s->peer);
  if (fd < 0) return fd;
  s->used = s->references = 1;
  s->type = kind, s->v6 = domain == AF_INET6, s->ttl = 1;
  s->receive_timeout = s->send_timeout = NEVER;
  s->id = (u64)config.pid << 16 | (s - socks);
  new_descriptor(fd, kind == SOCK_DGRAM ? DATAGRAMS : STREAM);
  descriptors[fd].sock = s;
  return fd;
}

static int taken(int type, u16 port, const struct sock *but, const u8 *ip) {
  for (struct sock *s = socks; s < socks + SOCKETS; s++)
    if (s->used && s != but && s->type == type && s->bound && s->own.port == port && !(s->connected && type == SOCK_STREAM)) {
      if (type == SOCK_DGRAM && s->reuse && but && but->reuse) continue;
      if (ip && !is_any(ip) && !is_any(s->own.ip) && memcmp(ip, s->own.ip, 16)) continue;
      if (ip && s->v6 != but->v6 && (s->v6_only || but->v6_only)) continue;
      if (type == SOCK_STREAM && s->reuse && but && but->reuse && !s->listening) continue;
      return 1;
    }
  return 0;
}

/* The processes of an agent share its ports, and so the controller keeps the book of them. Without a port it gives a free
   one. Returns the port; 0: another process has it. */
static u16 book_port(struct sock *s, const struct address *own) {
  int shares = 0;
  for (int k = 0; k < s->n_options; k++)
    shares |= s->options[k].level == SOL_SOCKET && s->options[k].option == SO_REUSEPORT && s->options[k].value;
  u8 flags = (s->type == SOCK_STREAM) | (s->reuse ? 2 : 0) | (shares ? 4 : 0) | (s->v6_only ? 8 : 0);
  struct { u16 index; u8 flags, v6; struct address own; } __attribute__((packed)) head = {s - socks, flags, s->v6, *own};
  tell('B', &head, sizeof head, 0, 0);
  u16 port;
  memcpy(&port, ask('U').data, sizeof port);
  s->booked = port != 0;
  return port;
}

void leave_port(struct sock *s) {
  u16 index = s - socks;
  if (s->booked && !s->borrowed) tell('C', &index, sizeof index, 0, 0);
}

static void bind_free(struct sock *s) {
  if (s->bound) return;
  struct address none = {.port = 0};
  s->own.port = book_port(s, &none), s->bound = 1;
}

static long bind_socket(struct sock *s, const struct sockaddr *to, socklen_t size) {
  struct address own;
  int error = get_address(to, size, s, &own);
  if (error) return error;
  if (s->bound) return -EINVAL;
  if (!is_any(own.ip) && !is_loopback(own.ip) && !is_mine(own.ip) && !is_everybody(own.ip)) return -EADDRNOTAVAIL;
  if (own.port && taken(s->type, own.port, s, own.ip)) return -EADDRINUSE;
  u16 port = book_port(s, &own);
  if (!port) return -EADDRINUSE;
  s->own = own, s->own.port = port, s->bound = 1;
  return 0;
}

static void outside(const struct address *to) {
  char text[64];
  inet_ntop(is_v4(to->ip) ? AF_INET : AF_INET6, is_v4(to->ip) ? to->ip + 12 : to->ip, text, sizeof text);
  say("%s port %d is not in the water: agents are 10.0.0.NUMBER; on the wall clock: fleet netem", text, to->port);
}

static long connect_socket(int fd, struct sock *s, const struct sockaddr *to, socklen_t size) {
  if (to->sa_family == AF_UNSPEC) {
    if (s->type == SOCK_DGRAM) s->connected = 0;
    return 0;
  }
  struct address peer;
  int error = get_address(to, size, s, &peer);
  if (error) return error;
  if (is_any(peer.ip)) memcpy(peer.ip, is_v4(peer.ip) ? (const u8[16]){0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 255, 255, 127, 0, 0, 1} : loopback6, 16);
  if (s->type == SOCK_STREAM) {
    if (s->connected && s->fresh) return s->fresh = 0;
    if (s->connected) return -EISCONN;
    if (s->connecting) return -EALREADY;
    if (s->error) {
      error = s->error, s->error = 0;
      return -error;
    }
    if (s->listening) return -EISCONN;
    if (!is_inside(peer.ip) || is_everybody(peer.ip)) {
      outside(&peer);
      return -ENETUNREACH;
    }
    s->to = peer;
    bind_free(s);
    return stream_connect(fd, s);
  }
  if (is_broadcast(peer.ip) && !s->broadcast) return -EACCES;
  s->to = peer, s->connected = 1; /* of an address outside, too: many programs ask so for their own address */
  bind_free(s);
  return 0;
}

static void local_name(const struct sock *s, struct address *to) {
  *to = s->own;
  if (!s->bound) memset(to->ip, 0, 16);
  if (s->connected && is_any(to->ip)) {
    if (is_loopback(s->to.ip)) memcpy(to->ip, s->to.ip, 16);
    else own_address(to->ip, !is_v4(s->to.ip));
  }
}

static int wants(const struct sock *s, const struct address *to, const struct address *from) {
  if (!s->used || s->borrowed || s->type != SOCK_DGRAM || !s->bound || s->own.port != to->port) return 0;
  if (s->connected && (s->to.port != from->port || (memcmp(s->to.ip, from->ip, 16) && !is_everybody(s->to.ip)))) return 0;
  if (is_v4(to->ip) ? s->v6 && s->v6_only : !s->v6) return 0;
  if (is_multicast(to->ip)) {
    for (int k = 0; k < s->n_groups; k++)
      if (!memcmp(s->groups[k], to->ip, 16)) return is_any(s->own.ip) || !memcmp(s->own.ip, to->ip, 16) || !is_multicast(s->own.ip);
    return 0;
  }
  if (is_any(s->own.ip)) return 1;
  if (is_broadcast(to->ip)) return is_broadcast(s->own.ip) || is_mine(s->own.ip);
  return !memcmp(s->own.ip, to->ip, 16);
}

/* Puts a datagram into the sockets of this process that want it; returns into how many. */
static int put_datagram(const struct address *from, const struct address *to, const void *data, size_t size) {
  int found = 0, full = 0;
  struct head head = {*from, *to, now};
  struct iovec parts[2] = {{&head, sizeof head}, {(void *)data, size}};
  struct msghdr message = {.msg_iov = parts, .msg_iovlen = 2};
  struct sock *best = 0;
  for (struct sock *s = socks; s < socks + SOCKETS; s++) {
    if (!wants(s, to, from)) continue;
    if (!is_everybody(to->ip)) { /* one socket gets it: the one that is connected, or bound to the very address, first */
      int better = !best || s->connected > best->connected || (s->connected == best->connected && is_any(best->own.ip) && !is_any(s->own.ip));
      if (better) best = s;
      continue;
    }
    found++;
    full += SYS(SYS_sendmsg, s->peer, &message, MSG_DONTWAIT) < 0;
  }
  if (best) found++, full += SYS(SYS_sendmsg, best->peer, &message, MSG_DONTWAIT) < 0;
  if (full) tell('L', 0, 0, 0, 0); /* it is lost, as in a kernel whose queue is full */
  if (found) wake_all(&descriptors_changed);
  return found;
}

void deliver(struct message m) {
  struct { struct address from, to; } __attribute__((packed)) head;
  did_something |= any_shared && m.kind != 'Q'; /* another process may wait for what is written here */
  switch (m.kind) {
    case 'D':
      memcpy(&head, m.data, sizeof head);
      put_datagram(&head.from, &head.to, m.data + sizeof head, m.size - sizeof head);
      return;
    case 'C': {
      u32 pid;
      memcpy(&pid, m.data, 4);
      child_gone(pid);
      return;
    }
    case 'G':
      raise_signal(m.data[0], 0);
      return;
    case 'B':
      show_threads();
      gdb_waits = 0;
      SYS(SYS_kill, real_pid(), SIGABRT);
      return;
    default:
      if (!is_about_shared(m)) deliver_stream(m);
  }
}

long send_message(int fd, const struct msghdr *message, int flags) {
  struct sock *s = sock_of(fd);
  if (kind_of(fd) == ROUTES) return send_routes(fd, message->msg_iov[0].iov_base, message->msg_iov[0].iov_len);
  if (!s) return -ENOTSOCK;
  if (s->type == SOCK_STREAM) return stream_send(fd, s, message, flags);
  if (s->error) {
    int error = s->error;
    s->error = 0;
    return -error;
  }
  struct address to = s->to;
  if (message->msg_name && message->msg_namelen) {
    int error = get_address(message->msg_name, message->msg_namelen, s, &to);
    if (error) return error;
  } else if (!s->connected) return -EDESTADDRREQ;
  if (!to.port) return -EINVAL;
  if (is_any(to.ip)) memcpy(to.ip, s->v6 && !is_v4(to.ip) ? loopback6 : (const u8[16]){0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 255, 255, 127, 0, 0, 1}, 16);
  if (is_broadcast(to.ip) && !s->broadcast) return -EACCES;
  if (s->stopped) {
    raise_signal(SIGPIPE, me);
    return -EPIPE;
  }
  bind_free(s);
  static u8 data[65536];
  size_t size = 0;
  for (size_t k = 0; k < (size_t)message->msg_iovlen; k++) {
    size_t n = message->msg_iov[k].iov_len;
    if (size + n > MOST_PAYLOAD) return -EMSGSIZE;
    memcpy(data + size, message->msg_iov[k].iov_base, n);
    size += n;
  }
  if (!is_inside(to.ip)) {
    outside(&to);
    return -ENETUNREACH;
  }
  struct { struct address from, to; } __attribute__((packed)) head = {s->own, to};
  if (is_loopback(to.ip)) memcpy(head.from.ip, to.ip, 16);
  else if (is_any(s->own.ip) || is_everybody(s->own.ip)) own_address(head.from.ip, !is_v4(to.ip));
  int here = is_loopback(to.ip) || is_mine(to.ip);
  int found = 0;
  if (here || (is_multicast(to.ip) && !s->no_loop) || is_broadcast(to.ip)) found = put_datagram(&head.from, &head.to, data, size);
  if (here && found) return size;
  if (is_multicast(to.ip) && is_v4(to.ip) && s->ttl == 0) return size;
  /* To others; or to another process of this agent, or to whom the scenario gives this address, which the controller knows. */
  tell('S', &head, sizeof head, data, size);
  if (here && ask('U').data[0] == 0 && s->connected) s->error = ECONNREFUSED;
  return size;
}

static void add_control(struct msghdr *m, size_t *used, int level, int type, const void *data, size_t size) {
  struct cmsghdr head = {.cmsg_len = CMSG_LEN(size), .cmsg_level = level, .cmsg_type = type};
  if (*used + CMSG_SPACE(size) > m->msg_controllen) {
    m->msg_flags |= MSG_CTRUNC;
    return;
  }
  memcpy((u8 *)m->msg_control + *used, &head, sizeof head);
  memcpy((u8 *)m->msg_control + *used + CMSG_LEN(0), data, size);
  *used += CMSG_SPACE(size);
}

static void add_information(struct sock *s, struct msghdr *m, const struct head *head) {
  size_t used = 0;
  m->msg_flags &= ~MSG_CTRUNC;
  struct timespec at = {(head->at + config.epoch) / SECOND, (head->at + config.epoch) % SECOND};
  struct timeval micro = {at.tv_sec, at.tv_nsec / 1000};
  if (s->stamps & 1) add_control(m, &used, SOL_SOCKET, SO_TIMESTAMP, &micro, sizeof micro);
  if (s->stamps & 2) add_control(m, &used, SOL_SOCKET, SO_TIMESTAMPNS, &at, sizeof at);
  int index = is_loopback(head->to.ip) ? 1 : 2, hops = 64, none = 0; /* the class of traffic is not carried */
  if (s->information & 1) {
    struct in_pktinfo info = {.ipi_ifindex = index};
    memcpy(&info.ipi_addr, head->to.ip + 12, 4);
    u8 own[16];
    own_address(own, 0);
    memcpy(&info.ipi_spec_dst, is_loopback(head->to.ip) ? head->to.ip + 12 : own + 12, 4);
    add_control(m, &used, IPPROTO_IP, IP_PKTINFO, &info, sizeof info);
  }
  if (s->information & 2) {
    struct in6_pktinfo info = {.ipi6_ifindex = index};
    memcpy(&info.ipi6_addr, head->to.ip, 16);
    add_control(m, &used, IPPROTO_IPV6, IPV6_PKTINFO, &info, sizeof info);
  }
  if (s->information & 4) add_control(m, &used, IPPROTO_IP, IP_TTL, &hops, sizeof hops);
  if (s->information & 32) add_control(m, &used, IPPROTO_IP, IP_TOS, &none, 1);
  if (s->information & 8) add_control(m, &used, IPPROTO_IPV6, IPV6_HOPLIMIT, &hops, sizeof hops);
  if (s->information & 16) add_control(m, &used, IPPROTO_IPV6, IPV6_TCLASS, &none, sizeof none);
  m->msg_controllen = used;
}

long receive_message(int fd, struct msghdr *message, int flags) {
  struct sock *s = sock_of(fd);
  if (!s) { /* a Unix socket, or answers about interfaces */
    int error = wait_ready(fd, POLLIN, flags, NEVER);
    if (error) return error;
    socklen_t room = message->msg_namelen;
    long r = SYS(SYS_recvmsg, fd, message, flags);
    if (r >= 0) show_socket(message->msg_name, &message->msg_namelen, room);
    something();
    if (kind_of(fd) == ROUTES && message->msg_name) { /* an answer of the kernel, whose number is 0 */
      struct { u16 family, pad; u32 pid, groups; } kernel = {AF_NETLINK, 0, 0, 0};
      memcpy(message->msg_name, &kernel, room < sizeof kernel ? room : sizeof kernel);
      message->msg_namelen = sizeof kernel;
    }
    return r;
  }
  if (s->type == SOCK_STREAM && !s->connected && !s->got_end && !s->error) return -ENOTCONN;
  if (s->error && !ready(fd, POLLIN)) {
    int error = s->error;
    s->error = 0;
    return -error;
  }
  if (s->type == SOCK_DGRAM) bind_free(s);
  int error = wait_ready(fd, POLLIN, flags, s->receive_timeout);
  if (error) return error;
  if (s->type == SOCK_STREAM) {
    long done = 0;
    for (;;) {
      struct msghdr rest = {.msg_iov = message->msg_iov, .msg_iovlen = message->msg_iovlen};
      struct iovec one;
      if (done) { /* MSG_WAITALL: only for one buffer, as recv uses it */
        one = (struct iovec){(u8 *)message->msg_iov[0].iov_base + done, message->msg_iov[0].iov_len - done};
        rest = (struct msghdr){.msg_iov = &one, .msg_iovlen = 1};
      }
      long r = SYS(SYS_recvmsg, fd, &rest, (flags & ~MSG_WAITALL) | MSG_DONTWAIT);
      if (r < 0) {
        if (s->error && r == -EAGAIN) r = -s->error, s->error = 0;
        return done ? done : r;
      }
      if (!(flags & MSG_PEEK)) stream_received(s);
      done += r;
      if (!r || !(flags & MSG_WAITALL) || message->msg_iovlen != 1 || done >= (long)message->msg_iov[0].iov_len || flags & MSG_PEEK) break;
      if (wait_ready(fd, POLLIN, flags, s->receive_timeout)) break;
    }
    if (!done && s->error && !(flags & MSG_PEEK)) {
      done = -s->error;
      s->error = 0;
      return done;
    }
    message->msg_namelen = message->msg_controllen = 0;
    message->msg_flags = 0;
    return done;
  }
  struct head head;
  static struct iovec parts[1025];
  size_t n = (size_t)message->msg_iovlen < LENGTH(parts) - 1 ? (size_t)message->msg_iovlen : LENGTH(parts) - 1;
  parts[0] = (struct iovec){&head, sizeof head};
  memcpy(parts + 1, message->msg_iov, n * sizeof *parts);
  struct msghdr got = {.msg_iov = parts, .msg_iovlen = n + 1};
  long r = SYS(SYS_recvmsg, fd, &got, (flags & (MSG_PEEK | MSG_TRUNC)) | MSG_DONTWAIT);
  if (r == -EAGAIN && s->deaf) return flags & MSG_DONTWAIT || SYS(SYS_fcntl, fd, F_GETFL) & O_NONBLOCK ? r : 0; /* shut down */
  if (r <= 0) return r;
  s->last_stamp = head.at + config.epoch;
  if (message->msg_name) put_address(message->msg_name, &message->msg_namelen, &head.from, s->v6);
  message->msg_flags = got.msg_flags & MSG_TRUNC;
  if (message->msg_control) add_information(s, message, &head);
  return r - (long)sizeof head;
}

static long many(long number, int fd, struct mmsghdr *all, unsigned n, int flags) {
  for (unsigned k = 0; k < n; k++) {
    int own = sock_of(fd) != 0 || kind_of(fd) == ROUTES;
    long a[6] = {fd, (long)&all[k].msg_hdr, flags};
    long r = number == SYS_sendmmsg ? (own ? send_message(fd, &all[k].msg_hdr, flags) : socket_call(SYS_sendmsg, a))
                                    : receive_message(fd, &all[k].msg_hdr, k ? flags | MSG_DONTWAIT : flags);
    if (r < 0) return k ? (long)k : r;
    all[k].msg_len = r;
  }
  return n;
}

long socket_call(long number, const long a[6]) {
  if (number == SYS_socket) return open_socket(a[0], a[1], a[2]);
  if (number == SYS_socketpair) return SYS(SYS_socketpair, a[0], a[1], a[2], a[3]);
  if (number == SYS_sendmmsg || number == SYS_recvmmsg) return many(number, a[0], (void *)a[1], a[2], a[3]);
  if (is_own(a[0])) return -EBADF;
  struct sock *s = sock_of(a[0]);
  if (!s) {
    if (kind_of(a[0]) == ROUTES && (number == SYS_sendto || number == SYS_sendmsg)) {
      if (number == SYS_sendto) return send_routes(a[0], (void *)a[1], a[2]);
      return send_message(a[0], (void *)a[1], a[2]);
    }
    if (kind_of(a[0]) == ROUTES && number == SYS_bind) return 0;
    if (kind_of(a[0]) == ROUTES && number == SYS_getsockname) {
      struct { u16 family, pad; u32 pid, groups; } own = {AF_NETLINK, 0, config.pid, 0};
      memcpy((void *)a[1], &own, *(socklen_t *)a[2] < sizeof own ? *(socklen_t *)a[2] : sizeof own);
      *(socklen_t *)a[2] = sizeof own;
      return 0;
    }
    if (kind_of(a[0]) == ROUTES && number == SYS_recvfrom) {
      struct iovec one = {(void *)a[1], a[2]};
      socklen_t *size = (void *)a[5];
      struct msghdr m = {.msg_iov = &one, .msg_iovlen = 1, .msg_name = (void *)a[4], .msg_namelen = size ? *size : 0};
      long r = receive_message(a[0], &m, a[3]);
      if (r >= 0 && size) *size = m.msg_namelen;
      return r;
    }
    return unix_call(number, a);
  }
  switch (number) {
    case SYS_bind: return bind_socket(s, (void *)a[1], a[2]);
    case SYS_connect: return connect_socket(a[0], s, (void *)a[1], a[2]);
    case SYS_listen: bind_free(s); return s->type == SOCK_STREAM ? stream_listen(a[0], s) : -EOPNOTSUPP;
    case SYS_accept: return stream_accept(a[0], s, (void *)a[1], (void *)a[2], 0);
    case SYS_accept4: return stream_accept(a[0], s, (void *)a[1], (void *)a[2], a[3]);
    case SYS_getsockname: {
      struct address own;
      local_name(s, &own);
      if (!s->v6 && !s->bound) memcpy(own.ip, v4_mapped, 12);
      put_address((void *)a[1], (void *)a[2], &own, s->v6);
      return 0;
    }
    case SYS_getpeername:
      if (!s->connected || (s->type == SOCK_STREAM && !s->connection)) return -ENOTCONN; /* also after a reset */
      put_address((void *)a[1], (void *)a[2], &s->to, s->v6);
      return 0;
    case SYS_setsockopt: return set_option(a[0], s, a[1], a[2], (void *)a[3], a[4]);
    case SYS_getsockopt: return get_option(s, a[1], a[2], (void *)a[3], (void *)a[4]);
    case SYS_shutdown:
      if (s->type == SOCK_STREAM) return stream_shutdown(s, a[1]);
      if (a[1] != SHUT_RD) s->stopped = 1;
      if (a[1] != SHUT_WR) s->deaf = 1, SYS(SYS_shutdown, a[0], SHUT_RD);
      something();
      return s->connected ? 0 : -ENOTCONN; /* it wakes who waits, all the same: programs end their threads so */
    case SYS_sendto: {
      struct iovec one = {(void *)a[1], a[2]};
      struct msghdr m = {.msg_iov = &one, .msg_iovlen = 1, .msg_name = (void *)a[4], .msg_namelen = a[4] ? a[5] : 0};
      return send_message(a[0], &m, a[3]);
    }
    case SYS_sendmsg: return send_message(a[0], (void *)a[1], a[2]);
    case SYS_recvfrom: {
      struct iovec one = {(void *)a[1], a[2]};
      socklen_t *size = (void *)a[5];
      struct msghdr m = {.msg_iov = &one, .msg_iovlen = 1, .msg_name = (void *)a[4], .msg_namelen = size ? *size : 0};
      long r = receive_message(a[0], &m, a[3]);
      if (r >= 0 && size) *size = m.msg_namelen;
      return r;
    }
    default: return receive_message(a[0], (void *)a[1], a[2]);
  }
}
