/* Options of sockets: groups, time-outs, what comes with a datagram. Those without an effect here are kept, to be read. */
#include "preload.h"
#include <netinet/in.h>
#include <netinet/tcp.h>

static int join(struct sock *s, const u8 *group, int joins) {
  for (int k = 0; k < s->n_groups; k++)
    if (!memcmp(s->groups[k], group, 16)) {
      if (joins) return -EADDRINUSE;
      memmove(s->groups[k], s->groups[k + 1], (--s->n_groups - k) * 16);
      return 0;
    }
  if (!joins) return -EADDRNOTAVAIL;
  if (s->n_groups == 16) return -ENOBUFS;
  memcpy(s->groups[s->n_groups++], group, 16);
  return 0;
}

static i64 timeout_of(const void *value) {
  const struct timeval *t = value;
  i64 ns = t->tv_sec * SECOND + t->tv_usec * 1000;
  return ns ? ns : NEVER;
}

static int *kept_option(struct sock *s, int level, int option, int add) {
  for (int k = 0; k < s->n_options; k++)
    if (s->options[k].level == level && s->options[k].option == option) return &s->options[k].value;
  if (!add || s->n_options == (int)LENGTH(s->options)) return 0;
  s->options[s->n_options].level = level, s->options[s->n_options].option = option;
  return &s->options[s->n_options++].value;
}

long set_option(int fd, struct sock *s, int level, int option, const void *value, socklen_t size) {
  int v = 0;
  if (value) memcpy(&v, value, size < 4 ? size : 4);
  int *kept = kept_option(s, level, option, 1);
  if (kept) *kept = v;
  u8 group[16];
  memcpy(group, v4_mapped, 12);
  if (level == SOL_SOCKET) switch (option) {
      case SO_RCVTIMEO: s->receive_timeout = timeout_of(value); return 0;
      case SO_SNDTIMEO: s->send_timeout = timeout_of(value); return 0;
      case SO_LINGER: s->resets = size >= 8 && v && !((const int *)value)[1]; return 0;
      case SO_BROADCAST: s->broadcast = v != 0; return 0;
      case SO_REUSEADDR:
      case SO_REUSEPORT: s->reuse = v != 0; return 0;
      case SO_TIMESTAMP: s->stamps = (s->stamps & ~1) | (v ? 1 : 0); return 0;
      case SO_TIMESTAMPNS: s->stamps = (s->stamps & ~2) | (v ? 2 : 0); return 0;
      case SO_RCVBUF:
      case SO_SNDBUF:
        if (option == SO_SNDBUF && s->type == SOCK_STREAM) s->most_unsent = v < 2304 ? 4608 : v > 1 << 17 ? 1 << 18 : 2 * (size_t)v; /* as Linux doubles it */
        return SYS(SYS_setsockopt, option == SO_RCVBUF ? fd : s->peer, level, SO_SNDBUF, value, size) * 0;
      default: return 0;
    }
  if (level == IPPROTO_IP) switch (option) {
      case IP_ADD_MEMBERSHIP:
      case IP_DROP_MEMBERSHIP:
        if (size < 8) return -EINVAL;
        memcpy(group + 12, value, 4);
        return join(s, group, option == IP_ADD_MEMBERSHIP);
      case IP_ADD_SOURCE_MEMBERSHIP:
        memcpy(group + 12, value, 4);
        return join(s, group, 1);
      case IP_MULTICAST_LOOP: s->no_loop = size == 1 ? !*(u8 *)value : !v; return 0;
      case IP_MULTICAST_TTL: s->ttl = v; return 0;
      case IP_PKTINFO: s->information = (s->information & ~1) | (v ? 1 : 0); return 0;
      case IP_RECVTTL: s->information = (s->information & ~4) | (v ? 4 : 0); return 0;
      case IP_RECVTOS: s->information = (s->information & ~32) | (v ? 32 : 0); return 0;
      case 42: /* MCAST_JOIN_GROUP */
      case 45: { /* MCAST_LEAVE_GROUP */
        const struct group_req *r = value;
        struct address a;
        int error = get_address((void *)&r->gr_group, sizeof r->gr_group, s, &a);
        return error ? error : join(s, a.ip, option == 42);
      }
      default: return 0;
    }
  if (level == IPPROTO_IPV6) switch (option) {
      case IPV6_JOIN_GROUP:
      case IPV6_LEAVE_GROUP: return join(s, value, option == IPV6_JOIN_GROUP);
      case IPV6_MULTICAST_LOOP: s->no_loop = !v; return 0;
      case IPV6_V6ONLY: s->v6_only = v != 0; return 0;
      case IPV6_RECVPKTINFO: s->information = (s->information & ~2) | (v ? 2 : 0); return 0;
      case IPV6_RECVHOPLIMIT: s->information = (s->information & ~8) | (v ? 8 : 0); return 0;
      case IPV6_RECVTCLASS: s->information = (s->information & ~16) | (v ? 16 : 0); return 0;
      case 42:
      case 45: {
        const struct group_req *r = value;
        struct address a;
        int error = get_address((void *)&r->gr_group, sizeof r->gr_group, s, &a);
        return error ? error : join(s, a.ip, option == 42);
      }
      default: return 0;
    }
  return 0;
}

long get_option(struct sock *s, int level, int option, void *value, socklen_t *size) {
  int *kept = kept_option(s, level, option, 0), v = kept ? *kept : 0;
  if (level == SOL_SOCKET) switch (option) {
      case SO_TYPE: v = s->type; break;
      case SO_DOMAIN: v = s->v6 ? AF_INET6 : AF_INET; break;
      case SO_PROTOCOL: v = s->type == SOCK_STREAM ? IPPROTO_TCP : IPPROTO_UDP; break;
      case SO_ERROR: v = s->error, s->error = 0; break;
      case SO_ACCEPTCONN: v = s->listening; break;
      case SO_RCVBUF:
      case SO_SNDBUF: v = 212992; break; /* Linux' default */
      case SO_BROADCAST: v = s->broadcast; break;
      case SO_RCVTIMEO:
      case SO_SNDTIMEO: {
        i64 t = option == SO_RCVTIMEO ? s->receive_timeout : s->send_timeout;
        struct timeval to = {t == NEVER ? 0 : t / SECOND, t == NEVER ? 0 : t % SECOND / 1000};
        memcpy(value, &to, *size < sizeof to ? *size : sizeof to);
        return 0;
      }
    }
  else if (level == IPPROTO_TCP && option == TCP_MAXSEG) v = 1460; /* some programs divide by it */
  else if (level == IPPROTO_TCP && option == TCP_INFO) {
    memset(value, 0, *size);
    return 0;
  } else if (level == IPPROTO_IPV6 && option == IPV6_V6ONLY) v = s->v6_only;
  else if (level == IPPROTO_IP && option == IP_MULTICAST_LOOP) v = !s->no_loop;
  else if (level == IPPROTO_IP && option == IP_MULTICAST_TTL) v = s->ttl;
  else if (level == IPPROTO_IP && option == IP_TTL) v = 64;
  memcpy(value, &v, *size < 4 ? *size : 4);
  if (*size > 4) *size = 4;
  return 0;
}
