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
/* Signals of real time are queued: each comes as often as it was sent, with its own value. */
static struct { struct thread *directed; siginfo_t details; } queue[256];
static size_t n_queue;
int gdb_waits;
extern void own_return(void);

static u64 bit(int signal) { return 1ULL << (signal - 1); }
u64 without_own(u64 mask) { return mask & ~(bit(SIGKILL) | bit(SIGSTOP)); }
static int is_kernels(int signal) {
  return signal == SIGSEGV || signal == SIGBUS || signal == SIGFPE || signal == SIGILL || signal == SIGABRT || signal == SIGTRAP;
}
static int is_harmless(int signal) { return signal == SIGCHLD || signal == SIGURG || signal == SIGWINCH || signal == SIGCONT; }

/* Takes a signal that is pending for this thread, or for any. */
static siginfo_t take_signal(int signal) {
  int own = (me->pending & bit(signal)) != 0, others = 0;
  siginfo_t taken = details[signal];
  size_t found = n_queue;
  for (size_t k = 0; k < n_queue; k++)
    if (queue[k].details.si_signo == signal && queue[k].directed == (own ? me : 0)) {
      if (found == n_queue) found = k;
      else others = 1;
    }
  if (found < n_queue) {
    taken = queue[found].details;
    memmove(queue + found, queue + found + 1, (--n_queue - found) * sizeof *queue);
  }
  if (!others) *(own ? &me->pending : &pending) &= ~bit(signal);
  return taken;
}

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
  if (information->si_code <= 0) SYS(SYS_kill, real_pid(), signal); /* it was sent, and happens no more by itself */
}

static void spun(int signal, siginfo_t *information, void *context) {
  (void)information, (void)context, (void)signal;
  show_threads();
  SYS(SYS_kill, real_pid(), SIGABRT);
}

static void nothing_happens(int signal, siginfo_t *information, void *context) { (void)signal, (void)information, (void)context; }

/* The kernel raises SIGPIPE and SIGXFSZ, too, but they come from us. What is ignored is to be seen in /proc/self/status. */
static void silence(int signal) {
  struct action ignore = {SIG_IGN, 0, 0, 0};
  if (actions[signal].handler == SIG_IGN) SYS(SYS_rt_sigaction, signal, &ignore, 0, 8);
  else own_handler(signal, nothing_happens, 0);
}

void begin_signals(void) {
  struct action was;
  for (int k = 1; k <= 64; k++) /* what the program before this one ignored (nohup), and what it had blocked */
    if (k != SIGSYS && !SYS(SYS_rt_sigaction, k, 0, &was, 8) && was.handler == SIG_IGN) actions[k].handler = SIG_IGN;
  u64 none = 0, mask = 0;
  SYS(SYS_rt_sigprocmask, SIG_SETMASK, &none, &mask, 8);
  me->mask = without_own(mask);
  own_handler(SIGSEGV, fault, SA_NODEFER | SA_ONSTACK);
  own_handler(SIGXCPU, spun, SA_NODEFER); /* the controller sends it to a program that computes without an end */
  silence(SIGPIPE), silence(SIGXFSZ);
}

/* Before another program is executed, and if that failed: the kernel hands on what is ignored and blocked. */
void hand_on_signals(int back) {
  struct action ignore = {SIG_IGN, 0, 0, 0}, plain = {0, 0, 0, 0};
  for (int k = 1; k <= 64; k++)
    if (actions[k].handler == SIG_IGN && k != SIGSYS && k != SIGSEGV && k != SIGXCPU && k != SIGCHLD)
      SYS(SYS_rt_sigaction, k, back ? &plain : &ignore, 0, 8);
  u64 mask = back ? 0 : me->mask & ~(bit(SIGSYS) | bit(SIGSEGV) | bit(SIGXCPU) | bit(SIGABRT));
  SYS(SYS_rt_sigprocmask, SIG_SETMASK, &mask, 0, 8);
  if (back) silence(SIGPIPE), silence(SIGXFSZ);
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
  if (signal == SIGPIPE || signal == SIGXFSZ) silence(signal);
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
  close_streams();
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
      if (made >= 0) files[k].own = made, files[k].mask = mask, new_descriptor(made, SIGNALS);
      return made;
    }
  return fd < 0 ? -EMFILE : -EINVAL;
}

void close_signals(int fd) {
  for (size_t k = 0; k < LENGTH(files); k++)
    if (files[k].peer && files[k].own == fd) SYS(SYS_close, files[k].peer), files[k].peer = 0;
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
  siginfo_t information = {.si_signo = signal, .si_code = SI_USER};
  information.si_pid = config.pid;
  raise_with(signal, directed, &information);
}

int raise_with(int signal, struct thread *directed, const siginfo_t *information) {
  struct action *a = &actions[signal];
  if (signal == SIGSTOP) {
    say("SIGSTOP is refused in simulated time: nobody would continue the program");
    return 0;
  }
  if (signal == SIGKILL || (is_kernels(signal) && (long)a->handler != 1)) {
    if (!a->handler) close_streams();
    flush();
    if (directed == me && me) SYS(SYS_tgkill, real_pid(), raw(SYS_gettid, 0, 0, 0, 0, 0, 0), signal);
    else SYS(SYS_kill, real_pid(), signal);
    return 0;
  }
  if ((directed ? directed->mask & bit(signal) : !taker(signal)) && read_from_file(signal)) return 0;
  if (!a->handler && is_harmless(signal) && !(directed ? directed->mask & bit(signal) : !taker(signal))) return 0;
  if (a->handler == SIG_IGN) return 0;
  u64 before = directed ? directed->pending : pending;
  if (signal >= 32) {
    if (n_queue == LENGTH(queue)) return -EAGAIN;
    queue[n_queue].directed = directed, queue[n_queue++].details = *information;
  } else if (!(before & bit(signal))) details[signal] = *information;
  *(directed ? &directed->pending : &pending) |= bit(signal);
  wake_all(&pending); /* those that wait for signals by sigwait */
  struct thread *t = directed ? directed : taker(signal);
  if (t && t->state == WAITS && !(t->mask & bit(signal))) wake_thread(t);
  return 0;
}

/* Calls the handlers of what is pending for this thread; returns whether there was one. */
int deliver_signals(ucontext_t *context) {
  static ucontext_t nothing;
  int called = 0;
  for (;;) {
    u64 here = (me->pending | pending) & ~me->mask;
    if (!here) return called;
    int signal = __builtin_ctzll(here) + 1;
    siginfo_t information = take_signal(signal);
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
      siginfo_t taken = take_signal(signal);
      if (to) *to = taken;
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
    case SYS_rt_sigqueueinfo: {
      int signal = a[1];
      siginfo_t information = *(siginfo_t *)a[2];
      if (signal < 0 || signal > 64) return -EINVAL;
      if ((u32)a[0] != config.pid) return kill_process((int)a[0], signal); /* without its value */
      information.si_pid = config.pid;
      return signal ? raise_with(signal, 0, &information) : 0;
    }
    case SYS_rt_tgsigqueueinfo:
    case SYS_tkill:
    case SYS_tgkill: {
      int tid = number == SYS_tkill ? a[0] : a[1], signal = number == SYS_tkill ? a[1] : a[2];
      if (signal < 0 || signal > 64) return -EINVAL;
      for (int k = 0; k <= last_thread; k++)
        if (threads[k].used && (threads[k].number == tid || (k == 0 && tid == real_pid()))) {
          if (number == SYS_rt_tgsigqueueinfo && signal) return raise_with(signal, &threads[k], (void *)a[3]);
          siginfo_t information = {.si_signo = signal, .si_code = SI_TKILL};
          information.si_pid = config.pid;
          return signal ? raise_with(signal, &threads[k], &information) : 0;
        }
      return -ESRCH;
    }
    default: return -ENOSYS;
  }
}
