/* Time: clocks, sleep, and timers of all kinds. Time stands still while the program computes. */
#include "preload.h"
#include <fcntl.h>
#include <sys/eventfd.h>
#include <sys/resource.h>
#include <sys/sysinfo.h>
#include <sys/time.h>
#include <sys/timerfd.h>
#include <sys/times.h>
#include <sys/timex.h>

/* The monotonic clock of a machine that was started a while before: some programs take 0 for "never". */
static const i64 UPTIME = 1000 * SECOND;

struct timer {
  int used, descriptor, signal, overrun;
  struct thread *thread;
  clockid_t clock;
  long value;
  i64 deadline, interval;
};
enum { FREE = 3, TIMERS = 512 };
static struct timer timers[TIMERS]; /* the first three are those of setitimer and alarm */

static int is_real(clockid_t clock) {
  return clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE || clock == CLOCK_TAI || clock == CLOCK_REALTIME_ALARM;
}

static i64 origin(clockid_t clock) {
  if (is_real(clock)) return config.epoch;
  /* Computing takes no time. So a clock of the processor's time would stand still, and a loop that waits for it would
     never end: it goes with the simulated time. */
  return clock == CLOCK_PROCESS_CPUTIME_ID || clock == CLOCK_THREAD_CPUTIME_ID || clock < 0 ? 0 : UPTIME;
}

i64 clock_at(clockid_t clock) { return origin(clock) + now; }
i64 later(i64 by) { return by >= NEVER - now ? NEVER : now + (by > 0 ? by : 0); }
i64 span(const struct timespec *t) {
  return !t ? NEVER : t->tv_sec >= NEVER / SECOND ? NEVER : t->tv_sec * SECOND + t->tv_nsec;
}
i64 time_of(clockid_t clock, const struct timespec *at) {
  i64 ns = span(at);
  return ns == NEVER ? NEVER : ns - origin(clock);
}
static struct timespec parts(i64 ns) { return (struct timespec){ns / SECOND, ns % SECOND}; }
static struct timeval micros(i64 ns) { return (struct timeval){ns / SECOND, ns % SECOND / 1000}; }
static i64 of_micros(const struct timeval *t) { return t->tv_sec * SECOND + t->tv_usec * 1000; }

static int is_wrong(i64 seconds, i64 ns) { return seconds < 0 || ns < 0 || ns >= SECOND; }
static int is_wrong_span(const struct timespec *t) { return t && is_wrong(t->tv_sec, t->tv_nsec); }
static int is_wrong_clock(clockid_t clock) { return clock > CLOCK_TAI || clock == 10 /* unused */; }

u64 counter(void) {
  spins();
  return UPTIME + now; /* of a processor with 1 GHz */
}

int fast_clock_gettime(clockid_t clock, struct timespec *to) {
  if (is_wrong_clock(clock)) return -EINVAL;
  spins();
  *to = parts(clock_at(clock));
  return 0;
}
int fast_gettimeofday(void *to, void *zone) {
  spins();
  if (to) *(struct timeval *)to = micros(clock_at(CLOCK_REALTIME));
  if (zone) memset(zone, 0, sizeof(struct timezone));
  return 0;
}
time_t fast_time(time_t *to) {
  spins();
  time_t t = clock_at(CLOCK_REALTIME) / SECOND;
  if (to) *to = t;
  return t;
}
int fast_getcpu(unsigned *cpu, unsigned *node, void *unused) {
  (void)unused;
  if (cpu) *cpu = 0;
  if (node) *node = 0;
  return 0;
}

/* Moves a deadline beyond now; returns how often it has passed. */
static u64 passed(struct timer *t) {
  if (t->deadline > now) return 0;
  u64 times = 1;
  if (t->interval > 0) {
    times += (now - t->deadline) / t->interval;
    t->deadline += times * t->interval;
  } else t->deadline = NEVER;
  return times;
}

i64 next_timer(void) {
  i64 next = NEVER;
  for (int k = 0; k < TIMERS; k++)
    if (timers[k].used && timers[k].deadline < next) next = timers[k].deadline;
  return next;
}

void fire_timers(void) {
  for (int k = 0; k < TIMERS; k++) {
    struct timer *t = &timers[k];
    u64 times = t->used ? passed(t) : 0;
    if (!times) continue;
    t->overrun = times - 1;
    if (t->descriptor >= 0) SYS(SYS_write, t->descriptor, &times, sizeof times);
    else if (t->signal) {
      siginfo_t information = {.si_signo = t->signal, .si_code = k < FREE ? SI_KERNEL : SI_TIMER};
      if (k >= FREE) information.si_timerid = k, information.si_overrun = t->overrun, information.si_ptr = (void *)t->value;
      raise_with(t->signal, t->thread, &information);
    }
  }
}

void forget_timers(void) { /* a child inherits those that are files */
  for (int k = 0; k < TIMERS; k++)
    if (timers[k].used && timers[k].descriptor < 0) timers[k].used = 0;
}

static int new_timer(void) {
  for (int k = FREE; k < TIMERS; k++)
    if (!timers[k].used) {
      timers[k] = (struct timer){.used = 1, .descriptor = -1, .deadline = NEVER};
      return k;
    }
  return -EAGAIN;
}

static struct itimerspec shown(const struct timer *t) {
  i64 left = t->deadline == NEVER ? 0 : t->deadline - now;
  return (struct itimerspec){parts(t->interval), parts(left)};
}

static void set_timer(struct timer *t, const struct itimerspec *to, int absolute) {
  i64 value = span(&to->it_value);
  t->interval = span(&to->it_interval);
  t->deadline = value == 0 ? NEVER : absolute ? time_of(t->clock, &to->it_value) : later(value);
}

static long set_alarm(int which, const struct itimerval *to, struct itimerval *before) {
  static const u8 signals[] = {SIGALRM, SIGVTALRM, SIGPROF}; /* the processor's time goes with the simulated time */
  if (which < 0 || which >= FREE) return -EINVAL;
  struct timer *t = &timers[which];
  i64 left = t->used && t->deadline != NEVER ? t->deadline - now : 0;
  if (before) *before = (struct itimerval){micros(t->used ? t->interval : 0), micros(left)};
  if (!to) return 0;
  if (is_wrong(to->it_value.tv_sec, to->it_value.tv_usec * 1000) || is_wrong(to->it_interval.tv_sec, to->it_interval.tv_usec * 1000)) return -EINVAL;
  i64 value = of_micros(&to->it_value);
  *t = (struct timer){.used = 1, .descriptor = -1, .signal = signals[which], .interval = of_micros(&to->it_interval),
                      .deadline = value ? later(value) : NEVER};
  return 0;
}

static struct timer *by_descriptor(int descriptor) {
  for (int k = FREE; k < TIMERS; k++)
    if (timers[k].used && timers[k].descriptor == descriptor) return &timers[k];
  return 0;
}

void close_timer(int descriptor) {
  struct timer *t = by_descriptor(descriptor);
  if (t) t->used = 0;
}

/* A timer that is a file is an event file, to which we write how often it has passed: both are read in the same way. */
static long open_timer(clockid_t clock, int flags) {
  int k = new_timer();
  if (k < 0) return k;
  long descriptor = SYS(SYS_eventfd2, 0, (flags & TFD_CLOEXEC ? EFD_CLOEXEC : 0) | (flags & TFD_NONBLOCK ? EFD_NONBLOCK : 0));
  if (descriptor < 0) {
    timers[k].used = 0;
    return descriptor;
  }
  timers[k].descriptor = descriptor, timers[k].clock = clock;
  new_descriptor(descriptor, TIMER);
  return descriptor;
}

static long set_file_timer(int descriptor, int flags, const struct itimerspec *to, struct itimerspec *before) {
  struct timer *t = by_descriptor(descriptor);
  if (!t) return -EINVAL;
  if (before) *before = shown(t);
  set_timer(t, to, flags & TFD_TIMER_ABSTIME);
  u64 old;
  if (ready(descriptor, 1 /* POLLIN */)) SYS(SYS_read, descriptor, &old, sizeof old);
  u64 times = passed(t);
  if (times) SYS(SYS_write, descriptor, &times, sizeof times);
  return 0;
}

static long make_signal_timer(clockid_t clock, const struct sigevent *how, int *number) {
  int k = new_timer();
  if (k < 0) return k;
  struct timer *t = &timers[k];
  t->clock = clock, t->signal = SIGALRM, t->value = k;
  if (how) {
    t->signal = how->sigev_notify == SIGEV_NONE ? 0 : how->sigev_signo;
    t->value = (long)how->sigev_value.sival_ptr;
    if (how->sigev_notify == SIGEV_THREAD_ID)
      for (int j = 0; j <= last_thread; j++)
        if (threads[j].used && threads[j].number == how->_sigev_un._tid) t->thread = &threads[j];
  }
  *number = k;
  return 0;
}

static long sleep_until(i64 deadline, i64 asked, struct timespec *left) {
  if (asked <= 0) {
    yield();
    return 0;
  }
  int before = me->handled;
  while (now < deadline) {
    block(&now, deadline);
    if (me->handled != before) {
      if (left) *left = parts(deadline > now ? deadline - now : 0);
      return -EINTR;
    }
  }
  return 0;
}

long clock_call(long number, const long a[6]) {
  switch (number) {
    case SYS_clock_gettime: return fast_clock_gettime(a[0], (void *)a[1]);
    case SYS_gettimeofday: return fast_gettimeofday((void *)a[0], (void *)a[1]);
    case SYS_time: return fast_time((void *)a[0]);
    case SYS_getcpu: return fast_getcpu((void *)a[0], (void *)a[1], 0);
    case SYS_nanosleep: {
      if (is_wrong_span((void *)a[0])) return -EINVAL;
      i64 by = span((void *)a[0]);
      return sleep_until(later(by), by, (void *)a[1]);
    }
    case SYS_clock_nanosleep: {
      if (is_wrong_clock(a[0]) || is_wrong_span((void *)a[2])) return -EINVAL;
      int absolute = a[1] & TIMER_ABSTIME;
      i64 until = absolute ? time_of(a[0], (void *)a[2]) : later(span((void *)a[2]));
      return sleep_until(until, until - now, absolute ? 0 : (void *)a[3]);
    }
    case SYS_alarm: {
      struct itimerval before, to = {{0, 0}, {(unsigned)a[0], 0}};
      set_alarm(ITIMER_REAL, &to, &before);
      return before.it_value.tv_sec + (before.it_value.tv_usec > 0);
    }
    case SYS_setitimer: return set_alarm(a[0], (void *)a[1], (void *)a[2]);
    case SYS_getitimer: return set_alarm(a[0], 0, (void *)a[1]);
    case SYS_timerfd_create: return open_timer(a[0], a[1]);
    case SYS_timerfd_settime: return set_file_timer(a[0], a[1], (void *)a[2], (void *)a[3]);
    case SYS_timerfd_gettime: {
      struct timer *t = by_descriptor(a[0]);
      if (!t) return -EINVAL;
      *(struct itimerspec *)a[1] = shown(t);
      return 0;
    }
    case SYS_timer_create: if (is_wrong_clock(a[0])) return -EINVAL; return make_signal_timer(a[0], (void *)a[1], (void *)a[2]);
    case SYS_times: {
      clock_t ticks = now / 10000000;
      if (a[0]) *(struct tms *)a[0] = (struct tms){ticks, 0, 0, 0};
      return (UPTIME + now) / 10000000;
    }
    case SYS_getrusage: {
      struct rusage *to = (void *)a[1];
      memset(to, 0, sizeof *to);
      to->ru_utime = micros(now);
      return 0;
    }
    case SYS_sysinfo: {
      struct sysinfo *to = (void *)a[0];
      memset(to, 0, sizeof *to);
      to->uptime = (UPTIME + now) / SECOND, to->totalram = 4UL << 30, to->freeram = 2UL << 30, to->procs = 1, to->mem_unit = 1;
      return 0;
    }
    case SYS_adjtimex:
    case SYS_clock_adjtime: return -EPERM;
    case SYS_clock_settime:
    case SYS_settimeofday: return -EPERM;
  }
  int k = a[0];
  if (k < FREE || k >= TIMERS || !timers[k].used) return -EINVAL;
  struct timer *t = &timers[k];
  switch (number) {
    case SYS_timer_settime:
      if (is_wrong_span(&((struct itimerspec *)a[2])->it_value)) return -EINVAL;
      if (a[3]) *(struct itimerspec *)a[3] = shown(t);
      set_timer(t, (void *)a[2], a[1] & TIMER_ABSTIME);
      return 0;
    case SYS_timer_gettime:
      *(struct itimerspec *)a[1] = shown(t);
      return 0;
    case SYS_timer_getoverrun: return t->overrun;
    default: t->used = 0; /* timer_delete */
  }
  return 0;
}
