/* Signals: none comes from outside. They come from timers, from `kill` within the agent, and from children that end.

   So the program's mask and handlers are kept here, and a handler is called as a function, when its thread has its turn.
   Only what a thread does to itself (a wrong address, an abort) is the kernel's. */
#include "preload.h"
#include <sys/prctl.h>
#include <sys/wait.h>
#include <sched.h>

struct action { void *handler; unsigned long flags; void *restorer; u64 mask; };
static struct action actions[65];
static siginfo_t details[65];
static u64 pending; /* for any thread */
int gdb_waits;
extern void own_return(void);

static u64 bit(int signal) { return 1ULL << (signal - 1); }
u64 without_own(u64 mask) { return mask & ~(bit(SIGKILL) | bit(SIGSTOP)); }
static int is_kernels(int signal) {
  return signal == SIGSEGV || signal == SIGBUS || signal == SIGFPE || signal == SIGILL || signal == SIGABRT || signal == SIGTRAP;
}
static int is_harmless(int signal) { return signal == SIGCHLD || signal == SIGURG || signal == SIGWINCH || signal == SIGCONT; }

/* A wrong address: it may be the processor's counter, which is forbidden. */
static void fault(int signal, siginfo_t *information, void *context_) {
  ucontext_t *context = context_;
  greg_t *g = context->uc_mcontext.gregs;
  const u8 *at = (const u8 *)g[REG_RIP];
  if (information->si_code == SI_KERNEL && at[0] == 0x0f && (at[1] == 0x31 || (at[1] == 0x01 && at[2] == 0xf9))) {
    u64 value = counter();
    g[REG_RAX] = (u32)value, g[REG_RDX] = value >> 32;
    if (at[1] == 0x01) g[REG_RCX] = 0;
    g[REG_RIP] += at[1] == 0x31 ? 2 : 3;
    return;
  }
  struct action *a = &actions[signal];
  if ((long)a->handler > 1) {
    void *handler = a->handler;
    if (a->flags & SA_RESETHAND) a->handler = 0;
    if (a->flags & SA_SIGINFO) ((void (*)(int, siginfo_t *, void *))handler)(signal, information, context);
    else ((void (*)(int))handler)(signal);
    return;
  }
  struct action plain = {0, 0x04000000, (void *)own_return, 0};
  SYS(SYS_rt_sigaction, signal, &plain, 0, 8); /* it happens again, and ends the program */
}

static void spun(int signal, siginfo_t *information, void *context) {
  (void)information, (void)context, (void)signal;
  show_threads();
  SYS(SYS_kill, real_pid(), SIGABRT);
}

void begin_signals(void) {
  own_handler(SIGSEGV, fault, SA_NODEFER);
  own_handler(SIGXCPU, spun, SA_NODEFER); /* the controller sends it to a program that computes without an end */
}

static long set_action(int signal, const struct action *to, struct action *before) {
  if (signal < 1 || signal > 64 || signal == SIGKILL || signal == SIGSTOP) return -EINVAL;
  if (before) *before = actions[signal];
  if (!to) return 0;
  actions[signal] = *to;
  if (is_kernels(signal) && signal != SIGSEGV) {
    struct action real = *to;
    real.mask &= ~bit(SIGSYS); /* a call that is trapped while this is blocked ends the program */
    real.flags |= 0x04000000, real.restorer = (void *)own_return;
    return SYS(SYS_rt_sigaction, signal, &real, 0, 8);
  }
  if (to->handler == SIG_IGN) pending &= ~bit(signal);
  return 0;
}

static struct thread *taker(int signal) {
  for (int k = 0; k <= last_thread; k++)
    if (threads[k].used && threads[k].state != ENDED && !(threads[k].mask & bit(signal))) return &threads[k];
  return 0;
}

static void die_of(int signal) {
  struct action plain = {0, 0x04000000, (void *)own_return, 0};
  SYS(SYS_rt_sigaction, signal, &plain, 0, 8);
  flush();
  SYS(SYS_kill, real_pid(), signal);
  u64 all = 0;
  SYS(SYS_rt_sigprocmask, SIG_SETMASK, &all, 0, 8);
}

/* Signals that are read from a file: one end of a pair is the program's, and we write into the other. */
static struct { int own, peer; u64 mask; } files[64];

static long open_signals(int fd, u64 mask, int flags) {
  for (size_t k = 0; k < LENGTH(files); k++)
    if (fd >= 0 && files[k].peer && files[k].own == fd) return files[k].mask = mask, fd;
  for (size_t k = 0; fd < 0 && k < LENGTH(files); k++)
    if (!files[k].peer) {
      int made = own_pair(SOCK_DGRAM, flags, &files[k].peer); /* the flags of both calls have the same numbers */
      if (made >= 0) files[k].own = made, files[k].mask = mask, new_descriptor(made, POLLABLE);
      return made;
    }
  return fd < 0 ? -EMFILE : -EINVAL;
}

static int read_from_file(int signal) {
  for (size_t k = 0; k < LENGTH(files); k++)
    if (files[k].peer && files[k].mask & bit(signal)) {
      u32 record[32] = {signal, 0, 0, config.pid}; /* struct signalfd_siginfo: number, errno, code, process */
      if (SYS(SYS_sendto, files[k].peer, record, sizeof record, MSG_DONTWAIT | MSG_NOSIGNAL, 0, 0) > 0) {
        wake_all(&descriptors_changed);
        return 1;
      }
    }
  return 0;
}

void raise_signal(int signal, struct thread *directed) {
  struct action *a = &actions[signal];
  if (signal == SIGKILL || (is_kernels(signal) && (long)a->handler != 1)) {
    flush();
    if (directed == me && me) SYS(SYS_tgkill, real_pid(), raw(SYS_gettid, 0, 0, 0, 0, 0, 0), signal);
    else SYS(SYS_kill, real_pid(), signal);
    return;
  }
  if ((directed ? directed->mask & bit(signal) : !taker(signal)) && read_from_file(signal)) return;
  if (!a->handler && is_harmless(signal) && !(directed ? directed->mask & bit(signal) : !taker(signal))) return;
  if (a->handler == SIG_IGN) return;
  details[signal] = (siginfo_t){.si_signo = signal, .si_code = SI_USER};
  details[signal].si_pid = config.pid;
  *(directed ? &directed->pending : &pending) |= bit(signal);
  wake_all(&pending); /* those that wait for signals by sigwait */
  struct thread *t = directed ? directed : taker(signal);
  if (t && t->state == WAITS && !(t->mask & bit(signal))) wake_thread(t);
}

/* Calls the handlers of what is pending for this thread; returns whether there was one. */
int deliver_signals(ucontext_t *context) {
  static ucontext_t nothing;
  int called = 0;
  for (;;) {
    u64 here = (me->pending | pending) & ~me->mask;
    if (!here) return called;
    int signal = __builtin_ctzll(here) + 1;
    me->pending &= ~bit(signal), pending &= ~bit(signal);
    struct action a = actions[signal];
    if (a.handler == SIG_IGN) continue;
    if (!a.handler) {
      if (is_harmless(signal)) continue;
      if (signal == SIGTSTP || signal == SIGTTIN || signal == SIGTTOU) continue; /* there is no terminal that stops it */
      die_of(signal);
    }
    if (a.flags & SA_RESETHAND) actions[signal].handler = 0;
    u64 mask = me->mask;
    me->mask |= without_own(a.mask | (a.flags & SA_NODEFER ? 0 : bit(signal)));
    me->handled++, called = 1;
    if (a.flags & SA_RESTART) me->restarts++;
    siginfo_t information = details[signal];
    if (a.flags & SA_SIGINFO) ((void (*)(int, siginfo_t *, void *))a.handler)(signal, &information, context ? context : &nothing);
    else ((void (*)(int))a.handler)(signal);
    me->mask = mask;
  }
}

static long wait_signal(u64 set, siginfo_t *to, i64 deadline) {
  set = without_own(set);
  for (;;) {
    u64 here = (me->pending | pending) & set;
    if (here) {
      int signal = __builtin_ctzll(here) + 1;
      me->pending &= ~bit(signal), pending &= ~bit(signal);
      if (to) *to = details[signal];
      return signal;
    }
    if (now >= deadline) return -EAGAIN;
    int handled = me->handled;
    block_net(&pending, deadline); /* a program may wait for the signal that ends it: that is no deadlock */
    if (me->handled != handled) return -EINTR;
  }
}

long signal_call(ucontext_t *context, long number, const long a[6]) {
  switch (number) {
    case SYS_rt_sigaction: return set_action(a[0], (void *)a[1], (void *)a[2]);
    case SYS_rt_sigprocmask: {
      u64 before = me->mask, set = a[1] ? without_own(*(u64 *)a[1]) : 0;
      if (a[1]) switch ((int)a[0]) {
          case SIG_BLOCK: me->mask |= set; break;
          case SIG_UNBLOCK: me->mask &= ~set; break;
          case SIG_SETMASK: me->mask = set; break;
          default: return -EINVAL;
        }
      if (a[2]) *(u64 *)a[2] = before;
      return 0;
    }
    case SYS_rt_sigpending: *(u64 *)a[0] = pending | me->pending; return 0;
    case SYS_rt_sigtimedwait: return wait_signal(*(u64 *)a[0], (void *)a[1], a[2] ? later(span((void *)a[2])) : NEVER);
    case SYS_signalfd: return open_signals(a[0], *(u64 *)a[1], 0);
    case SYS_signalfd4: return open_signals(a[0], *(u64 *)a[1], a[3] & (SOCK_CLOEXEC | SOCK_NONBLOCK));
    case SYS_pause:
    case SYS_rt_sigsuspend: {
      u64 mask = me->mask;
      if (number == SYS_rt_sigsuspend) me->mask = without_own(*(u64 *)a[0]);
      int handled = me->handled;
      deliver_signals(context);
      while (me->handled == handled) block_net(&handled, NEVER);
      me->mask = mask;
      return -EINTR;
    }
    case SYS_tkill:
    case SYS_tgkill: {
      int tid = number == SYS_tkill ? a[0] : a[1], signal = number == SYS_tkill ? a[1] : a[2];
      if (signal < 0 || signal > 64) return -EINVAL;
      for (int k = 0; k <= last_thread; k++)
        if (threads[k].used && (threads[k].number == tid || (k == 0 && tid == real_pid()))) {
          if (signal) raise_signal(signal, &threads[k]);
          return 0;
        }
      return -ESRCH;
    }
    default: return -ENOSYS;
  }
}
