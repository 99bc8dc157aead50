/* Threads: one runs at a time, first come first served, and a futex is a name to wait at.

   All locks, conditions, semaphores and barriers of the C library, of C++, Rust and Python wait by `futex`, so they
   need nothing here. A thread that gives its turn away does so inside of its trapped call, on its own stack. */
#include "preload.h"
#include <linux/futex.h>
#include <sched.h>

struct thread threads[THREADS];
int last_thread;
__thread struct thread *me __attribute__((tls_model("initial-exec")));
char descriptors_changed;
u8 did_something;
static u64 tickets;
static int looks;
static int numbers = 1;
static struct thread *dying; /* it has given its turn away and still uses its stack */

static void wake_up(struct thread *t, int timed_out) {
  t->state = RUNS, t->timed_out = timed_out, t->ticket = ++tickets;
  t->shared = 0;
}
void wake_thread(struct thread *t) { wake_up(t, 0); }

static struct thread *first(int state, const void *object, u32 bits) {
  struct thread *found = 0;
  for (int k = 0; k <= last_thread; k++) {
    struct thread *t = &threads[k];
    if (t->used && t->state == state && (!object || (t->object == object && (!bits || t->bits & bits))) &&
        (!found || t->ticket < found->ticket))
      found = t;
  }
  return found;
}

void wake_one(const void *object) {
  struct thread *t = first(WAITS, object, 0);
  if (t) wake_up(t, 0);
}

void wake_all(const void *object) {
  for (struct thread *t; (t = first(WAITS, object, 0));) wake_up(t, 0);
}

void something(void) {
  did_something = 1;
  wake_all(&descriptors_changed);
}

/* Until when everybody waits, and whether what they wait for may come from outside. */
static i64 soonest(u8 *flags) {
  i64 deadline = next_timer();
  int inside = deadline == NEVER;
  for (int k = 0; k <= last_thread; k++) {
    struct thread *t = &threads[k];
    if (!t->used || t->state != WAITS) continue;
    if (t->deadline < deadline) deadline = t->deadline;
    if (t->net) inside = 0;
  }
  if (deadline != NEVER) inside = 0;
  *flags = did_something | (inside ? 2 : 0);
  return deadline;
}

/* Memory that processes share may be mapped at two places of one process, and so a lock has two names. */
static int shared_changed(void) {
  int found = 0;
  for (int k = 0; k <= last_thread; k++) {
    struct thread *t = &threads[k];
    if (t->used && t->state == WAITS && t->shared && *t->shared != t->held) wake_up(t, 0), found = 1;
  }
  return found;
}

/* Nobody can run: the turn is over, and goes on at the next moment that the controller grants. */
static void idle(void) {
  if (did_something && shared_changed()) return;
  struct { i64 deadline; u8 flags; } __attribute__((packed)) message;
  message.deadline = soonest(&message.flags);
  tell('I', &message, sizeof message, 0, 0);
  flush();
  did_something = 0;
  for (struct message m; (m = hear()).kind != 'T' || (memcpy(&now, m.data, 8), 0);) deliver(m);
  looks = 0;
  pour_shared();
  fire_timers();
  shared_changed();
  for (;;) {
    struct thread *next = 0;
    for (int k = 0; k <= last_thread; k++) {
      struct thread *t = &threads[k];
      if (!t->used || t->state != WAITS) continue;
      if (t->deadline <= now && (!next || t->deadline < next->deadline ||
                                      (t->deadline == next->deadline && t->ticket < next->ticket)))
        next = t;
    }
    if (!next) break;
    wake_up(next, 1);
  }
  wake_all(&descriptors_changed);
}

static void take(struct thread *own) {
  while (!__atomic_exchange_n(&own->baton, 0, __ATOMIC_SEQ_CST))
    SYS(SYS_futex, &own->baton, FUTEX_WAIT_PRIVATE, 0, 0, 0, 0);
  struct thread *before = dying;
  if (before) { /* somebody may free its stack as soon as its number is zero */
    for (int gone; (gone = __atomic_load_n(&before->gone, __ATOMIC_SEQ_CST));)
      SYS(SYS_futex, &before->gone, FUTEX_WAIT, gone, 0, 0, 0);
    if (before->clear_tid) *before->clear_tid = 0;
    before->used = 0;
    dying = 0;
  }
}

static void give(struct thread *to) {
  __atomic_store_n(&to->baton, 1, __ATOMIC_SEQ_CST);
  SYS(SYS_futex, &to->baton, FUTEX_WAKE_PRIVATE, 1, 0, 0, 0);
}

static void schedule(void) {
  struct thread *own = me, *next;
  while (!(next = first(RUNS, 0, 0))) idle();
  if (next == own) return;
  give(next);
  take(own);
}

static int wait_for(const void *object, i64 deadline, int net) {
  me->state = WAITS, me->object = object, me->deadline = deadline, me->timed_out = 0, me->net = net;
  me->ticket = ++tickets;
  schedule();
  me->bits = 0;
  if (deliver_signals(0)) return SIGNALLED;
  return me->timed_out ? TIMED_OUT : WOKEN;
}

/* Waits at an object. WOKEN may also mean nothing: whoever waits looks again. */
int block(const void *object, i64 deadline) { return wait_for(object, deadline, 0); }
int block_net(const void *object, i64 deadline) { return wait_for(object, deadline, 1); }

void yield(void) {
  if (spins()) return;
  me->state = RUNS, me->ticket = ++tickets;
  schedule();
}

/* A loop that looks at the clock, or at a socket that has nothing, never waits. After so many looks it waits for the next
   tick, as time passes for it on a real machine, too. 10,000 is a choice: a program that prints some thousand lines with
   a time each is not to lose a tick. */
int spins(void) {
  if (!me || ++looks <= 10000) return 0;
  looks = 0;
  block(&looks, later(config.tick));
  return 1;
}

void begin_threads(void) {
  me = &threads[0];
  me->used = 1, me->state = RUNS, me->number = config.pid;
  me->gone = 1;
  SYS(SYS_set_tid_address, &me->gone);
}

void forget_threads(void) {
  struct thread *own = me;
  for (int k = 0; k <= last_thread; k++)
    if (&threads[k] != own) threads[k].used = 0;
  own->number = config.pid, own->clear_tid = 0, own->robust = 0, own->gone = 1, own->pending = 0;
  numbers = 1, dying = 0;
  SYS(SYS_set_tid_address, &own->gone);
}

/* Called from `raw_thread`, on the new thread's stack. */
__attribute__((used, visibility("hidden"))) void begin_thread(struct thread *own) {
  trap_calls();
  me = own;
  take(own);
  resume(own->registers);
}

static int new_number(void) { /* below the bits that a futex has for a number */
  for (;;) {
    int number = config.pid + 100000 * numbers, taken = 0;
    numbers = numbers % 9999 + 1;
    for (int k = 0; k <= last_thread; k++) taken |= threads[k].used && threads[k].number == number;
    if (!taken) return number;
  }
}

long start_thread(ucontext_t *context, u64 flags, long stack, int *parent_tid, int *child_tid, long tls) {
  int k = 0;
  while (k < THREADS && threads[k].used) k++;
  if (k == THREADS) return -EAGAIN;
  if (k > last_thread) last_thread = k;
  struct thread *t = &threads[k];
  *t = (struct thread){.used = 1, .gone = 1, .mask = me->mask, .number = new_number()};
  memcpy(t->name, me->name, sizeof t->name);
  if (flags & CLONE_CHILD_CLEARTID) t->clear_tid = child_tid;
  if (flags & CLONE_PARENT_SETTID) *parent_tid = t->number;
  if (flags & CLONE_CHILD_SETTID) *child_tid = t->number;
  save_registers(context, stack, t->registers);
  u64 kept = (flags & ~(u64)(CLONE_PARENT_SETTID | CLONE_CHILD_SETTID)) | CLONE_CHILD_CLEARTID;
  long real = raw_thread(kept, stack, 0, (long)&t->gone, tls, t);
  if (real < 0) {
    t->used = 0;
    return real;
  }
  wake_up(t, 0);
  return t->number;
}

/* Locks that are robust know the thread which has ended. The kernel would look for its own number in them. */
void leave_locks(void) {
  struct robust_list_head *head = (void *)me->robust;
  if (!head) return;
  uintptr_t own = (uintptr_t)&head->list, each = (uintptr_t)head->list.next & ~1UL; /* the last bit: it inherits priority */
  for (int k = 0; k < 2048 && each != own; k++) {
    uintptr_t next = (uintptr_t)((struct robust_list *)each)->next & ~1UL;
    u32 *at = (u32 *)(each + head->futex_offset);
    if ((*at & FUTEX_TID_MASK) == (u32)me->number) {
      *at = (*at & FUTEX_WAITERS) | FUTEX_OWNER_DIED;
      did_something = 1;
      wake_one(at);
    }
    each = next;
  }
  me->robust = 0;
}

void end_thread(int status) {
  struct thread *own = me, *next;
  leave_locks();
  int others = 0;
  for (int k = 0; k <= last_thread; k++) others += threads[k].used && &threads[k] != own;
  if (!others) {
    close_streams();
    flush();
    SYS(SYS_exit_group, status);
  }
  own->state = ENDED;
  if (own->clear_tid) wake_all(own->clear_tid); /* it runs after `take` has cleared the number */
  while (!(next = first(RUNS, 0, 0))) idle();
  dying = own;
  give(next);
  for (;;) SYS(SYS_exit, status);
}

static int wake_futex(const u32 *at, u32 bits, u32 most) {
  u32 woken = 0;
  for (struct thread *t; woken < most && (t = first(WAITS, at, bits)); woken++) wake_up(t, 0);
  return woken;
}

static long lock_inherited(u32 *at, i64 deadline, int tries) {
  u32 others = 0;
  while (*at & FUTEX_TID_MASK) {
    if ((*at & FUTEX_TID_MASK) == (u32)me->number) return -EDEADLK;
    if (tries) return -EAGAIN;
    *at |= FUTEX_WAITERS;
    me->shared = at, me->held = *at; /* another process of the agent may have it */
    int how = block(at, deadline);
    me->shared = 0;
    if (how == TIMED_OUT) return -ETIMEDOUT;
    others = FUTEX_WAITERS; /* perhaps in another process: who unlocks is to tell us */
  }
  *at = me->number | (*at & FUTEX_OWNER_DIED) | (first(WAITS, at, 0) ? FUTEX_WAITERS : others);
  return 0;
}

static long wake_by_operation(u32 *at, u32 most, u32 most_second, u32 *second, u32 code) {
  u32 old = *second, argument = (int)(code << 8) >> 20, compared = (int)(code << 20) >> 20;
  if (code >> 28 & FUTEX_OP_OPARG_SHIFT) argument = 1u << (argument & 31);
  switch (code >> 28 & 7) {
    case FUTEX_OP_SET: *second = argument; break;
    case FUTEX_OP_ADD: *second += argument; break;
    case FUTEX_OP_OR: *second |= argument; break;
    case FUTEX_OP_ANDN: *second &= ~argument; break;
    case FUTEX_OP_XOR: *second ^= argument; break;
    default: return -ENOSYS;
  }
  int holds;
  switch (code >> 24 & 15) {
    case FUTEX_OP_CMP_EQ: holds = old == compared; break;
    case FUTEX_OP_CMP_NE: holds = old != compared; break;
    case FUTEX_OP_CMP_LT: holds = (int)old < (int)compared; break;
    case FUTEX_OP_CMP_LE: holds = (int)old <= (int)compared; break;
    case FUTEX_OP_CMP_GT: holds = (int)old > (int)compared; break;
    default: holds = (int)old >= (int)compared;
  }
  return wake_futex(at, 0, most) + (holds ? wake_futex(second, 0, most_second) : 0);
}

long futex(u32 *at, int operation, u32 value, const struct timespec *timeout, u32 *second, u32 bits) {
  int shared = !(operation & FUTEX_PRIVATE_FLAG);
  clockid_t clock = operation & FUTEX_CLOCK_REALTIME ? CLOCK_REALTIME : CLOCK_MONOTONIC;
  switch (operation & FUTEX_CMD_MASK) {
    case FUTEX_WAIT:
    case FUTEX_WAIT_BITSET: {
      int absolute = (operation & FUTEX_CMD_MASK) == FUTEX_WAIT_BITSET;
      if (*at != value) return -EAGAIN;
      i64 deadline = !timeout ? NEVER : absolute ? time_of(clock, timeout) : later(span(timeout));
      me->bits = absolute ? bits : ~0u;
      if (shared) me->shared = at, me->held = value; /* another process of the agent may change it */
      int how = block(at, deadline);
      me->shared = 0;
      return how == TIMED_OUT ? -ETIMEDOUT : how == SIGNALLED ? -EINTR : 0;
    }
    case FUTEX_WAKE:
    case FUTEX_WAKE_BITSET:
      if (shared) did_something = 1;
      return wake_futex(at, (operation & FUTEX_CMD_MASK) == FUTEX_WAKE ? 0 : bits, value);
    case FUTEX_CMP_REQUEUE:
      if (*at != bits) return -EAGAIN;
      /* fall through */
    case FUTEX_REQUEUE: {
      long n = wake_futex(at, 0, value);
      u32 most = (u32)(uintptr_t)timeout; /* the fourth argument is a number here */
      for (struct thread *t; most && (t = first(WAITS, at, 0)); most--, n++) t->object = second;
      return n;
    }
    case FUTEX_WAKE_OP: return wake_by_operation(at, value, (u32)(uintptr_t)timeout, second, bits);
    case FUTEX_LOCK_PI:
    case 13 /* FUTEX_LOCK_PI2 */: return lock_inherited(at, timeout ? time_of((operation & FUTEX_CMD_MASK) == 13 ? clock : CLOCK_REALTIME, timeout) : NEVER, 0);
    case FUTEX_TRYLOCK_PI: return lock_inherited(at, NEVER, 1);
    case FUTEX_UNLOCK_PI:
      *at = 0;
      did_something |= shared;
      wake_futex(at, 0, 1);
      return 0;
    default: return -ENOSYS;
  }
}

void show_threads(void) {
  for (int k = 0; k <= last_thread; k++) {
    struct thread *t = &threads[k];
    if (!t->used) continue;
    const char *what = t->state != WAITS ? "could run" : t->object == &descriptors_changed ? "waits for a file, a pipe or a socket"
                       : "waits for a lock, a condition or another thread";
    if (t->deadline != NEVER && t->state == WAITS)
      say("thread %d %s%s%s%s until %.3f s", t->number, t->name[0] ? "(" : "", t->name, t->name[0] ? ") " : "", what, t->deadline / 1e9);
    else say("thread %d %s%s%s%s", t->number, t->name[0] ? "(" : "", t->name, t->name[0] ? ") " : "", what);
  }
}
