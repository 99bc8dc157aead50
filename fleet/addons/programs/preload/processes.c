/* Processes: a program may start others. Each has a channel of its own, and one process of an agent runs at a time.

   The controller knows all of them, gives them their numbers, and says which have ended. */
#include "preload.h"
#include <elf.h>
#include <fcntl.h>
#include <linux/sched.h>
#include <poll.h>
#include <sched.h>
#include <stdio.h>
#include <sys/prctl.h>
#include <sys/stat.h>
#include <sys/wait.h>
#ifndef CLONE_CLEAR_SIGHAND
#define CLONE_CLEAR_SIGHAND 0x100000000ULL
#endif

struct child { u32 number; int real, gone; };
static struct child children[1024];
enum { CHILDREN = 1024 };
extern char **environ;
static int niceness, leads_session; /* they are kept, and change nothing */

static struct child *by_number(u32 number) {
  for (int k = 0; k < CHILDREN; k++)
    if (children[k].number && children[k].number == number) return &children[k];
  return 0;
}

void child_gone(u32 number) {
  struct child *c = by_number(number);
  if (!c) return;
  siginfo_t information;
  SYS(SYS_waitid, P_PID, c->real, &information, WEXITED | WNOWAIT, 0); /* its channel is closed: it ends at once */
  c->gone = 1;
  raise_signal(SIGCHLD, 0);
  wake_all(&descriptors_changed);
}

/* A child that shares the memory of its parent (vfork, posix_spawn) is a copy here, too. Its parent waits until it
   executes something or ends, and then gets what the child has changed on its stack: there it tells why it failed. */
struct change { u64 *at, to; };
static u64 lent[2048]; /* what was on the stack: 16 kB, more than the frame of who calls */
static u64 *lent_from;
static size_t n_lent;
static int borrower = -1; /* where the child tells its changes */

static void tell_changes(void) {
  if (borrower < 0) return;
  for (size_t k = 0; k < n_lent; k++)
    if (lent_from[k] != lent[k]) {
      struct change change = {lent_from + k, lent_from[k]};
      SYS(SYS_write, borrower, &change, sizeof change);
      lent[k] = lent_from[k];
    }
}

static void close_all(const int pair[2], const int borrowed[2]) {
  for (int k = 0; k < 2; k++) {
    SYS(SYS_close, pair[k]);
    if (borrowed[k] >= 0) SYS(SYS_close, borrowed[k]);
  }
}

static void lend_stack(long from, int pipe) {
  struct iovec here = {lent, sizeof lent}, there = {(void *)(from & ~7L), sizeof lent};
  long n = SYS(SYS_process_vm_readv, real_pid(), &here, 1, &there, 1, 0); /* as much as there is */
  lent_from = there.iov_base, n_lent = n > 0 ? n / 8 : 0, borrower = pipe;
}

static void wait_borrower(int pipe) {
  while (!ready(pipe, POLLIN)) block(&descriptors_changed, NEVER);
  for (struct change change; SYS(SYS_read, pipe, &change, sizeof change) == sizeof change;) *change.at = change.to;
  SYS(SYS_close, pipe);
}

/* A copy of this process, with one thread. */
static long fork_process(u64 flags, long stack, int *parent_tid, int *child_tid, long tls, long parent_stack) {
  struct child *c = children;
  while (c < children + CHILDREN && c->number) c++;
  if (c == children + CHILDREN) return -EAGAIN;
  int pair[2], borrowed[2] = {-1, -1};
  limit_files(1);
  long error = SYS(SYS_socketpair, AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, pair);
  if (!error && flags & CLONE_VFORK && !SYS(SYS_pipe2, borrowed, O_CLOEXEC))
    for (int k = 0; k < 2; k++) {
      int own = SYS(SYS_fcntl, borrowed[k], F_DUPFD_CLOEXEC, FIRST_OWN);
      SYS(SYS_close, borrowed[k]);
      borrowed[k] = own;
    }
  limit_files(0);
  if (error) return error;
  tell_descriptor('N', 0, 0, pair[1]);
  struct configuration next;
  struct message answer = ask('J');
  memcpy(&next, answer.data, sizeof next);
  if (!next.pid) { /* the controller has no room for more */
    close_all(pair, borrowed);
    return -EAGAIN;
  }
  share_socks(next.pid);
  flush();
  u64 kept = (flags & (CLONE_SETTLS | CLONE_CHILD_SETTID | CLONE_CHILD_CLEARTID | CLONE_FS)) & ~(u64)(CLONE_CHILD_SETTID | CLONE_CHILD_CLEARTID | CLONE_FS);
  long real = SYS(SYS_clone, kept | SIGCHLD, 0, 0, 0, tls);
  if (real < 0) {
    close_all(pair, borrowed);
    return real;
  }
  if (real) {
    struct { u32 pid, real; } numbers = {next.pid, (u32)real};
    tell('Y', &numbers, sizeof numbers, 0, 0);
    SYS(SYS_close, pair[0]);
    SYS(SYS_close, pair[1]);
    if (borrowed[1] >= 0) SYS(SYS_close, borrowed[1]);
    *c = (struct child){next.pid, (int)real, 0};
    if (flags & CLONE_PARENT_SETTID) *parent_tid = next.pid;
    (void)stack;
    if (borrowed[0] >= 0) wait_borrower(borrowed[0]);
    return next.pid;
  }
  trap_calls();
  limit_files(1);
  SYS(SYS_dup3, pair[0], CHANNEL, 0);
  limit_files(0);
  if (borrower >= 0) SYS(SYS_close, borrower); /* that of its parent */
  borrower = -1;
  if (borrowed[0] >= 0) SYS(SYS_close, borrowed[0]), lend_stack(parent_stack, borrowed[1]);
  SYS(SYS_close, pair[0]);
  SYS(SYS_close, pair[1]);
  config = next, now = next.now;
  seed_chance(next.seed);
  memset(children, 0, sizeof children);
  leads_session = 0;
  forget_channel();
  forget_threads();
  forget_timers();
  borrow_socks();
  SYS(SYS_prctl, PR_SET_PDEATHSIG, 0);
  if (flags & CLONE_CHILD_SETTID) *child_tid = next.pid;
  for (struct message m; (m = hear()).kind != 'T';) deliver(m); /* until its first turn */
  return 0;
}

static long clone_process(ucontext_t *context, u64 flags, long stack, int *parent_tid, int *child_tid, long tls) {
  if (flags & CLONE_THREAD) return start_thread(context, flags, stack, parent_tid, child_tid, tls);
  if (flags & (CLONE_NEWNS | CLONE_NEWUTS | CLONE_NEWIPC | CLONE_NEWUSER | CLONE_NEWPID | CLONE_NEWNET | CLONE_NEWCGROUP))
    return -EPERM;
  if (flags & CLONE_VM && !(flags & CLONE_VFORK)) {
    say("a process that shares the memory of its parent is refused in simulated time");
    return -EPERM;
  }
  long r = fork_process(flags, stack, parent_tid, child_tid, tls, context->uc_mcontext.gregs[REG_RSP]);
  if (r == 0 && stack) context->uc_mcontext.gregs[REG_RSP] = stack;
  return r;
}

/* Whether the library will be loaded into a file that is executed: it is no static program, and nobody else's rights. */
static long executable(const char *path) {
  static u8 head[4096];
  for (int depth = 0; depth < 4; depth++) {
    struct stat s;
    if (SYS(SYS_stat, path, &s) == 0 && s.st_mode & (S_ISUID | S_ISGID) && (s.st_uid != (uid_t)SYS(SYS_getuid))) {
      say("%s runs with the rights of its owner, which is refused in simulated time", path);
      return -EACCES;
    }
    long fd = SYS(SYS_openat, AT_FDCWD, path, O_RDONLY | O_CLOEXEC, 0);
    if (fd < 0) return fd;
    long n = SYS(SYS_read, fd, head, sizeof head - 1);
    SYS(SYS_close, fd);
    if (n < 0) return n;
    head[n] = 0;
    if (n > 2 && head[0] == '#' && head[1] == '!') {
      static char interpreter[256], buffer[4096];
      size_t skip = 2 + strspn((char *)head + 2, " \t"), length = strcspn((char *)head + skip, " \t\n");
      if (length >= sizeof interpreter) return 0;
      memcpy(interpreter, head + skip, length);
      interpreter[length] = 0;
      path = real_path(interpreter, buffer);
      continue;
    }
    const Elf64_Ehdr *elf = (void *)head;
    if (n < (long)sizeof *elf || memcmp(elf->e_ident, ELFMAG, SELFMAG)) return 0; /* the kernel says what is wrong */
    int dynamic = 0;
    for (int k = 0; k < elf->e_phnum; k++) {
      size_t at = elf->e_phoff + (size_t)k * sizeof(Elf64_Phdr);
      if (at + sizeof(Elf64_Phdr) > (size_t)n) return 0;
      const Elf64_Phdr *part = (void *)(head + at);
      dynamic |= part->p_type == PT_INTERP;
      /* A note of the Go linker: Go's threads have stacks on which no trap fits. */
      if (part->p_type == PT_NOTE && part->p_offset + part->p_filesz <= (size_t)n &&
          memmem(head + part->p_offset, part->p_filesz, "Go\0\0", 4)) {
        say("%s is a program of Go, which is refused in simulated time; it runs on the wall clock: fleet netem", path);
        return -EACCES;
      }
    }
    if (dynamic) return 0;
    say("%s is a static program, which is refused in simulated time; it runs on the wall clock: fleet netem", path);
    return -EACCES;
  }
  return 0;
}

static long execute(const char *path, char *const *arguments, char *const *given) {
  static char buffer[4096], preload[4200], channel[40];
  static char *all[8192];
  const char *real = real_path(path, buffer);
  long error = executable(real);
  if (error) return error;
  for (int fd = 0; fd < 3; fd++)
    if (sock_of(fd)) { /* the new program's library would not know what it is */
      say("%s is given a socket of the network as its descriptor %d, which is refused in simulated time", path, fd);
      return -EPERM;
    }
  size_t n = 0;
  for (; given && given[n] && n < LENGTH(all) - 4; n++) all[n] = given[n];
  int has_preload = 0, has_channel = 0;
  for (size_t k = 0; k < n; k++) has_preload |= !strncmp(all[k], "LD_PRELOAD=", 11) && strstr(all[k], config.agent ? "fleet" : "") != 0,
                                has_channel |= !strncmp(all[k], "FLEET_PROGRAM=", 14);
  if (!has_preload)
    for (char **e = environ; *e; e++)
      if (!strncmp(*e, "LD_PRELOAD=", 11)) snprintf(preload, sizeof preload, "%s", *e), all[n++] = preload;
  if (!has_channel) snprintf(channel, sizeof channel, "FLEET_PROGRAM=%d", CHANNEL), all[n++] = channel;
  all[n] = 0;
  flush();
  tell_changes();
  hand_on_signals(0);
  SYS(SYS_prctl, PR_SET_TSC, PR_TSC_ENABLE); /* the new program begins before its library */
  long r = SYS(SYS_execve, real, arguments, all);
  SYS(SYS_prctl, PR_SET_TSC, PR_TSC_SIGSEGV);
  hand_on_signals(1);
  return r;
}

static long wait_child(long which, int options, struct child **found) {
  int handled = me->handled, restarts = me->restarts;
  for (;;) {
    int any = 0;
    for (int k = 0; k < CHILDREN; k++) {
      struct child *c = &children[k];
      if (!c->number || (which > 0 && c->number != (u32)which)) continue;
      any = 1;
      if (c->gone) {
        *found = c;
        return c->number;
      }
    }
    if (!any) return -ECHILD;
    if (options & WNOHANG) {
      spins();
      return 0;
    }
    if (me->handled - handled > me->restarts - restarts) return -EINTR;
    block(&descriptors_changed, NEVER);
  }
}

long kill_process(long which, int signal) {
  if (signal < 0 || signal > 64) return -EINVAL;
  if (which == (long)config.pid || which == 0 || which == -(long)config.pid) {
    if (signal) raise_signal(signal, 0);
    return 0;
  }
  struct { i64 which; u8 signal; } __attribute__((packed)) head = {which, signal};
  tell('G', &head, sizeof head, 0, 0);
  did_something = 1;
  return ask('U').data[0] ? 0 : -ESRCH;
}

long process_call(ucontext_t *context, long number, const long a[6]) {
  switch (number) {
    case SYS_clone: return clone_process(context, a[0], a[1], (void *)a[2], (void *)a[3], a[4]);
    case SYS_clone3: {
      const struct clone_args *c = (void *)a[0];
      if (c->flags & CLONE_PIDFD) return -ENOSYS; /* callers fall back to clone */
      return clone_process(context, c->flags, c->stack ? c->stack + c->stack_size : 0, (void *)c->parent_tid, (void *)c->child_tid, c->tls);
    }
    case SYS_fork: return fork_process(0, 0, 0, 0, 0, 0);
    case SYS_vfork: return fork_process(CLONE_VFORK, 0, 0, 0, 0, context->uc_mcontext.gregs[REG_RSP]);
    case SYS_execve: return execute((void *)a[0], (void *)a[1], (void *)a[2]);
    case SYS_execveat: {
      static char name[4200];
      const char *path = (void *)a[1];
      if ((a[4] & AT_EMPTY_PATH) && !*path) snprintf(name, sizeof name, "/proc/self/fd/%d", (int)a[0]);
      else if ((int)a[0] == AT_FDCWD || *path == '/') snprintf(name, sizeof name, "%s", path);
      else snprintf(name, sizeof name, "/proc/self/fd/%d/%s", (int)a[0], path);
      return execute(name, (void *)a[2], (void *)a[3]);
    }
    case SYS_exit: end_thread(a[0]);
    case SYS_exit_group:
      tell_changes();
      leave_locks();
      close_streams();
      flush();
      return SYS(SYS_exit_group, a[0]);
    case SYS_wait4: {
      struct child *c = 0;
      long r = wait_child((int)a[0], a[2], &c);
      if (r <= 0) return r;
      SYS(SYS_wait4, c->real, a[1], 0, 0);
      if (a[3]) memset((void *)a[3], 0, 144);
      c->number = 0;
      return r;
    }
    case SYS_waitid: {
      struct child *c = 0;
      int which = a[0];
      if (which != P_PID && which != P_ALL && which != P_PGID) return -ENOSYS;
      long r = wait_child(which == P_PID ? (int)a[1] : -1, a[3], &c);
      siginfo_t *to = (void *)a[2];
      if (r == 0 && to) memset(to, 0, sizeof *to);
      if (r <= 0) return r;
      SYS(SYS_waitid, P_PID, c->real, to, WEXITED | (a[3] & WNOWAIT), 0);
      if (to) to->si_pid = c->number;
      if (!(a[3] & WNOWAIT)) c->number = 0;
      return 0;
    }
    case SYS_kill: return kill_process((int)a[0], a[1]);
    case SYS_getpid: return config.pid;
    case SYS_getppid: return config.parent;
    case SYS_gettid: return me->number;
    case SYS_getpgrp:
    case SYS_getpgid:
    case SYS_getsid: return config.pid;
    case SYS_setpgid: return 0;
    case SYS_setsid: return leads_session++ ? (leads_session = 1, -EPERM) : config.pid;
    case SYS_set_robust_list: me->robust = a[0]; return a[1] == 24 ? 0 : -EINVAL;
    case SYS_set_tid_address: me->clear_tid = (void *)a[0]; return me->number;
    case SYS_sched_getaffinity: { /* as many processors as the scenario says, however many the machine has */
      if (a[1] < 8) return -EINVAL;
      memset((void *)a[2], 0, a[1] < 128 ? a[1] : 128);
      *(u64 *)a[2] = ~0ull >> (64 - (config.flags >> 8));
      return 8;
    }
    case SYS_sched_setaffinity: case SYS_sched_setparam: case SYS_sched_setscheduler: return 0; /* one thread runs at a time */
    case SYS_sched_getscheduler: return SCHED_OTHER;
    case SYS_sched_getparam: return *(int *)a[1] = 0;
    case SYS_setpriority: niceness = (int)a[2] < -20 ? -20 : (int)a[2] > 19 ? 19 : (int)a[2]; return 0;
    case SYS_getpriority: return 20 - niceness; /* as the kernel tells it */
    case SYS_sched_yield: yield(); return 0;
    case SYS_sethostname: case SYS_setdomainname: case SYS_syslog: case SYS_vhangup: case SYS_acct: return -EPERM;
    case SYS_uname: {
      long r = SYS(SYS_uname, a[0]);
      char *name = (char *)a[0] + 65; /* struct utsname: sysname, nodename, release ... of 65 bytes each */
      memset(name, 0, 65);
      snprintf(name, 65, "auv-%u", config.agent);
      return r;
    }
    case SYS_prctl:
      switch ((int)a[0]) {
        case PR_SET_NAME:
          memset(me->name, 0, sizeof me->name);
          strncpy(me->name, (char *)a[1], sizeof me->name - 1);
          return SYS(SYS_prctl, PR_SET_NAME, a[1]);
        case PR_SET_TSC:
        case PR_SET_PDEATHSIG: return 0;
        case PR_SET_SECCOMP:
        case 59 /* PR_SET_SYSCALL_USER_DISPATCH, which traps the calls */: return -EINVAL;
        default: return SYS(SYS_prctl, a[0], a[1], a[2], a[3], a[4]);
      }
    default: return -ENOSYS;
  }
}
