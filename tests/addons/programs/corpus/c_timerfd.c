// C: epoll over a timerfd, an eventfd from a thread, a signalfd and a UDP socket with the kernel's time stamps.
#define _GNU_SOURCE
#include <arpa/inet.h>
#include <pthread.h>
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/eventfd.h>
#include <sys/signalfd.h>
#include <sys/socket.h>
#include <sys/timerfd.h>
#include <time.h>
#include <unistd.h>
static int ev; static void *raise_(void *x) { usleep(1700000); uint64_t one = 1; write(ev, &one, 8); usleep(500000); kill(getpid(), SIGUSR1); return 0; }
int main(int n, char **v) {
    int me = atoi(v[1]), e = epoll_create1(0), s = socket(AF_INET, SOCK_DGRAM | SOCK_NONBLOCK, 0), t = timerfd_create(CLOCK_MONOTONIC, TFD_NONBLOCK), on = 1, ticks = 0; ev = eventfd(0, 0);
    sigset_t set; sigemptyset(&set); sigaddset(&set, SIGUSR1); pthread_sigmask(SIG_BLOCK, &set, 0); int g = signalfd(-1, &set, 0);
    struct sockaddr_in a = {.sin_family = AF_INET, .sin_port = htons(5071)}, to = {.sin_family = AF_INET, .sin_port = htons(5071), .sin_addr.s_addr = htonl(0x0A000003 - me)}; bind(s, (void *)&a, sizeof a); setsockopt(s, SOL_SOCKET, SO_TIMESTAMPNS, &on, sizeof on);
    struct itimerspec i = {{0, 500000000}, {1, 0}}; timerfd_settime(t, 0, &i, 0); int fd[] = {s, t, ev, g}; for (int k = 0; k < 4; k++) { struct epoll_event x = {.events = EPOLLIN, .data.fd = fd[k]}; epoll_ctl(e, EPOLL_CTL_ADD, fd[k], &x); }
    pthread_t th; pthread_create(&th, 0, raise_, 0);
    while (ticks < 8) { struct epoll_event x[4]; int k = epoll_wait(e, x, 4, 2000); for (int j = 0; j < k; j++) { uint64_t u; struct signalfd_siginfo si;
        if (x[j].data.fd == t) { read(t, &u, 8); ticks += u; char b[20]; sendto(s, b, sprintf(b, "tick %d", ticks), 0, (void *)&to, sizeof to); }
        if (x[j].data.fd == ev) { read(ev, &u, 8); printf("event\n"); } if (x[j].data.fd == g) { read(g, &si, sizeof si); printf("signal %d\n", si.ssi_signo == SIGUSR1); }
        if (x[j].data.fd == s) { char b[100], c[200]; struct iovec io = {b, 99}; struct msghdr h = {.msg_iov = &io, .msg_iovlen = 1, .msg_control = c, .msg_controllen = sizeof c}; int q = recvmsg(s, &h, 0); if (q < 0) continue; b[q] = 0;
            struct cmsghdr *m = CMSG_FIRSTHDR(&h); struct timespec w, st = {0}; clock_gettime(CLOCK_REALTIME, &w); if (m && m->cmsg_type == SCM_TIMESTAMPNS) memcpy(&st, CMSG_DATA(m), sizeof st); printf("heard %s, stamp %s\n", b, labs(w.tv_sec - st.tv_sec) <= 1 ? "right" : "wrong"); } fflush(stdout); } }
    pthread_join(th, 0); printf("done\n"); return 0; }
