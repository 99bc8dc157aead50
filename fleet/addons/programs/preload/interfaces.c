/* Network interfaces: `lo` and `auv0`, as ioctl and as the kernel's routing socket (netlink) tell them. */
#include "preload.h"
#include <linux/if_addr.h>
#include <linux/netlink.h>
#include <linux/rtnetlink.h>
#include <net/if.h>
#include <netinet/in.h>
#include <sys/ioctl.h>

static const char *const names[] = {"lo", "auv0"};
static const unsigned flags_of[] = {IFF_UP | IFF_RUNNING | IFF_LOOPBACK, IFF_UP | IFF_RUNNING | IFF_BROADCAST | IFF_MULTICAST};
enum { MTU = 1500, LOOPBACK_MTU = 65536 };

static void hardware(int k, u8 to[6]) {
  memset(to, 0, 6);
  if (k) to[0] = 2, to[4] = config.agent >> 8, to[5] = config.agent; /* 2: given by ourselves, by no maker */
}

static void v4_of(int k, u8 to[4]) {
  static const u8 local[4] = {127, 0, 0, 1};
  u8 own[16];
  own_address(own, 0);
  memcpy(to, k ? own + 12 : local, 4);
}

static u32 mask_of(int k) { return k ? ~0u << (32 - config.prefix) : 0xff000000; }

static void put_v4(struct sockaddr *to, u32 ip) {
  struct sockaddr_in a = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(ip)};
  memcpy(to, &a, sizeof a);
}

static u32 number_of(const u8 ip[4]) { return (u32)ip[0] << 24 | ip[1] << 16 | ip[2] << 8 | ip[3]; }

long interface_ioctl(unsigned long request, void *argument) {
  struct ifreq *r = argument;
  u8 ip[4];
  if (request == SIOCGIFCONF) {
    struct ifconf *all = argument;
    if (!all->ifc_req) return all->ifc_len = 2 * sizeof *r, 0;
    int n = all->ifc_len / (int)sizeof *r;
    for (int k = 0; k < n && k < 2; k++) {
      memset(&all->ifc_req[k], 0, sizeof *r);
      strcpy(all->ifc_req[k].ifr_name, names[k]);
      v4_of(k, ip);
      put_v4(&all->ifc_req[k].ifr_addr, number_of(ip));
    }
    all->ifc_len = (n < 2 ? n : 2) * sizeof *r;
    return 0;
  }
  if (request == SIOCGIFNAME) {
    if (r->ifr_ifindex < 1 || r->ifr_ifindex > 2) return -ENODEV;
    strcpy(r->ifr_name, names[r->ifr_ifindex - 1]);
    return 0;
  }
  int k = 0;
  while (k < 2 && strncmp(r->ifr_name, names[k], IFNAMSIZ)) k++;
  if (k == 2) return -ENODEV;
  v4_of(k, ip);
  switch (request) {
    case SIOCGIFINDEX: r->ifr_ifindex = k + 1; return 0;
    case SIOCGIFFLAGS: r->ifr_flags = flags_of[k]; return 0;
    case SIOCGIFMTU: r->ifr_mtu = k ? MTU : LOOPBACK_MTU; return 0;
    case SIOCGIFADDR: put_v4(&r->ifr_addr, number_of(ip)); return 0;
    case SIOCGIFNETMASK: put_v4(&r->ifr_addr, mask_of(k)); return 0;
    case SIOCGIFBRDADDR: put_v4(&r->ifr_addr, number_of(ip) | ~mask_of(k)); return 0;
    case SIOCGIFHWADDR:
      r->ifr_hwaddr.sa_family = k ? 1 : 772; /* ARPHRD_ETHER, ARPHRD_LOOPBACK */
      hardware(k, (u8 *)r->ifr_hwaddr.sa_data);
      return 0;
    case SIOCGIFMETRIC: r->ifr_metric = 0; return 0;
    default: return -EPERM; /* to change an interface */
  }
}

/* A routing socket is one end of a pair; each question is answered at once into the other end. */
static int answers[DESCRIPTORS];

long open_routes(int flags) {
  int peer, fd = own_pair(SOCK_DGRAM, flags, &peer);
  if (fd < 0) return fd;
  new_descriptor(fd, ROUTES);
  if (answers[fd]) SYS(SYS_close, answers[fd]); /* of a socket that had this number before */
  answers[fd] = peer;
  return fd;
}

static u8 reply[4096];
static size_t n_reply;

static void attribute(int type, const void *data, size_t size) {
  struct rtattr head = {RTA_LENGTH(size), type};
  memcpy(reply + n_reply, &head, sizeof head);
  memcpy(reply + n_reply + RTA_LENGTH(0), data, size);
  memset(reply + n_reply + RTA_LENGTH(size), 0, RTA_ALIGN(size) - size);
  n_reply += RTA_SPACE(size);
}

static size_t begin(const struct nlmsghdr *asked, int type, const void *body, size_t size) {
  struct nlmsghdr head = {0, type, NLM_F_MULTI, asked->nlmsg_seq, config.pid};
  size_t at = n_reply;
  memcpy(reply + n_reply, &head, sizeof head);
  memcpy(reply + n_reply + NLMSG_HDRLEN, body, size);
  n_reply += NLMSG_HDRLEN + NLMSG_ALIGN(size);
  return at;
}

static void end(size_t at) { ((struct nlmsghdr *)(reply + at))->nlmsg_len = n_reply - at; }

static void tell_links(const struct nlmsghdr *asked) {
  for (int k = 0; k < 2; k++) {
    struct ifinfomsg link = {.ifi_family = AF_UNSPEC, .ifi_type = k ? 1 : 772, .ifi_index = k + 1, .ifi_flags = flags_of[k]};
    size_t at = begin(asked, RTM_NEWLINK, &link, sizeof link);
    u8 address[6];
    u32 mtu = k ? MTU : LOOPBACK_MTU;
    hardware(k, address);
    attribute(IFLA_IFNAME, names[k], strlen(names[k]) + 1);
    attribute(IFLA_ADDRESS, address, 6);
    attribute(IFLA_MTU, &mtu, 4);
    end(at);
  }
}

static void tell_addresses(const struct nlmsghdr *asked, int family) {
  for (int k = 0; k < 2; k++) {
    u8 own[16];
    if (family != AF_INET6) {
      struct ifaddrmsg a = {AF_INET, k ? config.prefix : 8, IFA_F_PERMANENT, k ? RT_SCOPE_UNIVERSE : RT_SCOPE_HOST, k + 1};
      size_t at = begin(asked, RTM_NEWADDR, &a, sizeof a);
      v4_of(k, own);
      attribute(IFA_ADDRESS, own, 4);
      attribute(IFA_LOCAL, own, 4);
      u32 broadcast = htonl(number_of(own) | ~mask_of(k));
      if (k) attribute(IFA_BROADCAST, &broadcast, 4);
      attribute(IFA_LABEL, names[k], strlen(names[k]) + 1);
      end(at);
    }
    if (family != AF_INET) {
      struct ifaddrmsg a = {AF_INET6, k ? 64 : 128, IFA_F_PERMANENT, k ? RT_SCOPE_UNIVERSE : RT_SCOPE_HOST, k + 1};
      size_t at = begin(asked, RTM_NEWADDR, &a, sizeof a);
      static const u8 local[16] = {[15] = 1};
      own_address(own, 1);
      attribute(IFA_ADDRESS, k ? own : local, 16);
      end(at);
    }
  }
}

long send_routes(int fd, const void *data, size_t size) {
  const struct nlmsghdr *asked = data;
  if (size < sizeof *asked) return -EINVAL;
  n_reply = 0;
  int family = size > NLMSG_HDRLEN ? ((const u8 *)data)[NLMSG_HDRLEN] : 0;
  if (asked->nlmsg_type == RTM_GETLINK) tell_links(asked);
  else if (asked->nlmsg_type == RTM_GETADDR) tell_addresses(asked, family);
  if (n_reply) SYS(SYS_sendto, answers[fd], reply, n_reply, MSG_DONTWAIT, 0, 0);
  int none = 0;
  n_reply = 0;
  end(begin(asked, NLMSG_DONE, &none, sizeof none));
  SYS(SYS_sendto, answers[fd], reply, n_reply, MSG_DONTWAIT, 0, 0);
  return size;
}
