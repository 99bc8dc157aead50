/* Starts a program in simulated time: launch CHANNEL OUT ERR HOME LIBRARY MEMORY_MB CONTROLLER -- COMMAND ...
   MEMORY_MB is the most that a file may hold, since files may be memory; CONTROLLER is a process.

   What must hold before the program's first instruction is set here, in a process of its own: between fork and exec of
   Python, other threads may hold locks. */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <sched.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/personality.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <unistd.h>

enum { CHANNEL = 4095 };

static void fail(const char *what) {
  dprintf(2, "uuv-fleet: %s: %s\n", what, strerror(errno));
  _exit(96);
}

static void set_limit(int which, rlim_t to) {
  struct rlimit limit;
  getrlimit(which, &limit);
  if (limit.rlim_max != RLIM_INFINITY && limit.rlim_max < to) to = limit.rlim_max;
  limit.rlim_cur = to;
  setrlimit(which, &limit);
}

static void put(const char *path, const char *text) {
  int fd = open(path, O_WRONLY);
  if (fd < 0) return;
  if (write(fd, text, strlen(text)) < 0) perror(path);
  close(fd);
}

/* A network without interfaces: should a program ever get round the library, it reaches nobody. Where the machine forbids
   it, the library alone must hold. */
static void leave_network(void) {
  uid_t uid = getuid();
  gid_t gid = getgid();
  if (uid == 0 && unshare(CLONE_NEWNET) == 0) return;
  if (unshare(CLONE_NEWUSER | CLONE_NEWNET)) return;
  char map[64];
  put("/proc/self/setgroups", "deny");
  snprintf(map, sizeof map, "%u %u 1", uid, uid);
  put("/proc/self/uid_map", map);
  snprintf(map, sizeof map, "%u %u 1", gid, gid);
  put("/proc/self/gid_map", map);
}

/* A process beside the program that waits until the controller ends, however it ends, and then kills all that is left:
   the kernel would end the first process alone, and a child that computes does not notice that its channel is closed. */
static void watch(pid_t controller) {
  int fd = syscall(SYS_pidfd_open, controller, 0);
  if (getppid() != controller) _exit(96); /* it has ended already, and its number may be another's */
  if (fd < 0 || fork()) {
    close(fd);
    return;
  }
  prctl(PR_SET_NAME, "fleet_watch");
  fd = dup2(fd, CHANNEL - 1);
  for (int k = 0; k < CHANNEL - 1; k++) close(k);
  struct pollfd ends = {fd, POLLIN, 0};
  while (poll(&ends, 1, -1) < 0 && errno == EINTR) {}
  kill(0, SIGKILL);
  _exit(0);
}

int main(int n, char **a) {
  if (n < 10) return 96;
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  setpgid(0, 0);
  int attached = !strcmp(a[2], "-"); /* it has the terminal, and Ctrl-C is its own */
  if (attached) {
    signal(SIGTTOU, SIG_IGN);
    tcsetpgrp(0, getpgrp());
    signal(SIGTTOU, SIG_DFL);
  }
  prctl(PR_SET_PTRACER, PR_SET_PTRACER_ANY); /* a debugger that is not its parent */
  signal(SIGPIPE, SIG_DFL); /* Python ignores it, and a program inherits that */
  sigset_t none;
  sigemptyset(&none);
  sigprocmask(SIG_SETMASK, &none, 0);
  leave_network();
  personality(ADDR_NO_RANDOMIZE); /* where it is forbidden, addresses differ from run to run */
  set_limit(RLIMIT_NOFILE, CHANNEL + 1);
  set_limit(RLIMIT_STACK, 8 << 20); /* where memory begins depends on it */
  set_limit(RLIMIT_CORE, 0);
  set_limit(RLIMIT_FSIZE, (rlim_t)atol(a[6]) << 20);
  watch(atoi(a[7]));
  if (dup2(atoi(a[1]), CHANNEL) < 0) fail("4096 open files are needed, see ulimit -n");
  if (!attached) {
    dup2(open("/dev/null", O_RDWR), 0);
    dup2(atoi(a[2]), 1);
    dup2(atoi(a[3]), 2);
  }
  for (int fd = 3; fd < 1024; fd++) close(fd);
  if (chdir(a[4])) fail(a[4]);
  setenv("LD_PRELOAD", a[5], 1);
  setenv("FLEET_PROGRAM", "4095", 1);
  execvp(a[9], a + 9);
  fail(a[9]);
}
