/* A program in simulated time: what the rooms of this library know of each other.

   The library is preloaded into a program. Each system call of the program, wherever it comes from, is trapped by the
   kernel (syscall user dispatch) and answered here: time, chance, sockets, waiting and processes are ours, everything
   else goes on to the kernel. So the C library, its locks, its resolver and its standard input and output are the real
   ones. (The rejected way is to replace functions of the C library one by one: whoever calls the kernel himself escapes,
   as Rust, Go and the C library itself do.)

   One thread of the program runs at a time. It gives up its turn only where it would wait. When all threads wait, the
   library tells the controller until when, over a channel, and the controller grants the next moment.

   Nothing here may call what allocates or calls the kernel in the C library: a trap may have interrupted malloc. Static
   buffers are safe, because only one thread runs, and needed, because some threads have stacks of 16 kB. */
#ifndef PRELOAD_H
#define PRELOAD_H
#define _GNU_SOURCE
#include <errno.h>
#include <signal.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <time.h>
#include <ucontext.h>

typedef uint8_t u8;
typedef uint16_t u16;
typedef uint32_t u32;
typedef uint64_t u64;
typedef int64_t i64;
#define NEVER INT64_MAX
#define SECOND 1000000000LL
#define LENGTH(array) (sizeof(array) / sizeof *(array))

/* machine.c: what depends on the processor, and the only places from which a system call is not trapped */
long raw(long number, long a, long b, long c, long d, long e, long f);
#define SYS(number, ...) SYS_6(number, ##__VA_ARGS__, 0, 0, 0, 0, 0, 0)
#define SYS_6(number, a, b, c, d, e, f, ...) raw(number, (long)(a), (long)(b), (long)(c), (long)(d), (long)(e), (long)(f))
enum { REGISTERS = 17 };

static inline long real_pid(void) { return raw(SYS_getpid, 0, 0, 0, 0, 0, 0); }
long raw_thread(long flags, long stack, long parent_tid, long child_tid, long tls, void *begins);
void save_registers(const ucontext_t *from, long stack, long to[REGISTERS]);
void resume(const long registers[REGISTERS]) __attribute__((noreturn));
void trap_calls(void);          /* from now on, of this thread */
void own_handler(int signal, void (*handler)(int, siginfo_t *, void *), int flags);
void answer_fast_clocks(void);  /* the functions that the kernel maps into each process: they call no kernel */
long on_call(ucontext_t *context, long number, const long arguments[6]);

/* channel.c: to and from the controller */
enum { CHANNEL = 4095, FIRST_OWN = 2048, DESCRIPTORS = 4096, MOST_FILES = 1024, MOST_MESSAGE = 1 << 17 };
struct configuration {
  i64 now, tick, epoch;
  u64 seed;
  u32 pid, parent, agent, prefix, agents, flags;
} __attribute__((packed));
extern struct configuration config;
enum { OTHER_ADDRESSES = 1, ATTACHED = 2 }; /* its flags */
extern char home[], visible[]; /* the agent's folder; folders that are not hidden, each ended by a zero */
extern i64 now;
void tell(u8 kind, const void *head, size_t head_size, const void *body, size_t size);
void flush(void);
struct message { u8 kind; u8 *data; size_t size; };
struct message hear(void);
struct message ask(u8 answer);
void tell_descriptor(u8 kind, const void *head, size_t size, int descriptor);
void say(const char *format, ...) __attribute__((format(printf, 1, 2))); /* a line of ours on its standard error */
void give_up(const char *format, ...) __attribute__((noreturn, format(printf, 1, 2)));
void say_hello(void);
void forget_channel(void); /* in a child, whose channel is another one */

/* threads.c */
enum { RUNS, WAITS, ENDED };
enum { WOKEN, TIMED_OUT, SIGNALLED };
struct thread {
  int state, timed_out, used, number;
  const void *object; /* what it waits for; its address is the name */
  u32 bits;           /* of a futex */
  const u32 *shared;  /* a futex that another process may change, and what it held */
  u32 held;
  i64 deadline;
  u64 ticket;
  int baton, gone;
  int *clear_tid;
  u64 mask, pending;
  int handled, restarts, in_call;
  u64 robust; /* the list of the locks that it holds */
  char net; /* what it waits for may come from outside */
  char name[16];
  long registers[REGISTERS];
};
enum { THREADS = 4096 };
extern struct thread threads[];
extern int last_thread;
extern __thread struct thread *me;
extern char descriptors_changed; /* its address: the object of all that wait for descriptors */
int block(const void *object, i64 deadline);
int block_net(const void *object, i64 deadline);
void wake_one(const void *object);
void wake_all(const void *object);
void wake_thread(struct thread *thread);
void something(void); /* a descriptor may have become ready, here or in another process of the agent */
int spins(void);      /* to be called where a program may look again and again without waiting */
void yield(void);
void begin_threads(void);
void forget_threads(void); /* in a child, which has one */
long start_thread(ucontext_t *context, u64 flags, long stack, int *parent_tid, int *child_tid, long tls);
void end_thread(int status) __attribute__((noreturn));
void leave_locks(void); /* at the end of this thread */
long futex(u32 *at, int operation, u32 value, const struct timespec *timeout, u32 *second, u32 bits);
void show_threads(void);
extern u8 did_something;

/* clock.c */
i64 clock_at(clockid_t clock);
i64 time_of(clockid_t clock, const struct timespec *at); /* run time of a moment on a clock */
i64 span(const struct timespec *t);                      /* ns; NEVER without one */
i64 later(i64 by);
i64 next_timer(void);
void fire_timers(void);
void forget_timers(void);
long clock_call(long number, const long a[6]);
void close_timer(int descriptor);
int fast_clock_gettime(clockid_t clock, struct timespec *to);
int fast_gettimeofday(void *to, void *zone);
time_t fast_time(time_t *to);
int fast_getcpu(unsigned *cpu, unsigned *node, void *unused);
long fast_getrandom(void *to, size_t size, unsigned flags, void *state, size_t state_size);
u64 counter(void); /* what the processor's counter would show */

/* chance.c */
u64 draw(void);
void draw_bytes(void *to, size_t size);
void seed_chance(u64 seed);

/* files.c */
long file_call(long number, const long a[6]);
int is_own_folder(const char *real);
int may_change(int folder, const char *real);
const char *shown_path(char *buffer);
const char *real_path_at(int folder, const char *path, char *buffer);
const char *real_path(const char *path, char *buffer);

/* descriptors.c */
enum { UNKNOWN, PLAIN, POLLABLE, DATAGRAMS, STREAM, TIMER, ROUTES, CHANCE, SIGNALS };
struct descriptor { u8 kind, net; struct sock *sock; };
extern struct descriptor descriptors[];
int is_own(int descriptor);
int ready(int descriptor, int events);
int wait_ready(int descriptor, int events, int flags, i64 timeout);
long descriptor_call(long number, const long a[6]);
int kind_of(int descriptor);
void new_descriptor(int descriptor, int kind);
long own_descriptor(int descriptor); /* a copy of it that is ours */
void limit_files(int lifted);

/* sockets.c and streams.c */
struct address { u8 ip[16]; u16 port; } __attribute__((packed)); /* IPv4 as ::ffff:a.b.c.d; the port as a number */
struct sock {
  int used, references, peer, type, v6, borrowed;
  struct address own, to;
  u8 bound, connected, connecting, listening, closing, sent_end, got_end, stopped, congested, resets, fresh; /* fresh: it stands, and no call has said so */
  u8 broadcast, no_loop, ttl, reuse, information, stamps, v6_only, booked, deaf;
  int error;
  i64 receive_timeout, send_timeout, last_stamp;
  u8 groups[16][16];
  int n_groups, n_options;
  struct { int level, option, value; } options[24]; /* those that have no effect here: a program may look whether they were set */
  int listener, own_end; /* of a call that nobody has taken yet: where it waits (a number from 1), the program's end */
  u64 connection;
  u64 id;    /* of the process that has made it, and its place there */
  u8 shared; /* another process has it, too: the controller knows who. `borrowed`: another one writes what arrives */
  u8 *waiting; /* what came and does not fit into the pair yet */
  size_t n_waiting, room;
  size_t unsent, most_unsent; /* bytes that the controller holds and has not sent */
};
enum { SOCKETS = 2000 };
extern struct sock socks[];
struct sock *sock_of(int descriptor);
long socket_call(long number, const long a[6]);
long send_message(int descriptor, const struct msghdr *message, int flags);
long receive_message(int descriptor, struct msghdr *message, int flags);
void release_sock(struct sock *sock);
void share_socks(u32 child); /* in a parent, before there is the child */
void borrow_socks(void);     /* in a child: what arrives is written by the parent */
extern int any_shared;
int is_about_shared(struct message message);
void pour_shared(void); /* somebody may have read from a socket that several processes have */
void deliver(struct message message);
int own_pair(int type, int flags, int *peer);
void deliver_stream(struct message message);
long stream_connect(int descriptor, struct sock *sock);
long stream_accept(int descriptor, struct sock *sock, struct sockaddr *to, socklen_t *size, int flags);
long stream_listen(int descriptor, struct sock *sock);
long stream_send(int descriptor, struct sock *sock, const struct msghdr *message, int flags);
long stream_shutdown(struct sock *sock, int how);
void stream_received(struct sock *sock);
void stream_close(struct sock *sock);
void close_streams(void); /* at the end of the process, as the kernel does */
void put_address(struct sockaddr *to, socklen_t *size, const struct address *from, int v6);
int is_v4(const u8 *ip);
int is_loopback(const u8 *ip);
int is_everybody(const u8 *ip);
void own_address(u8 *ip, int v6);
void leave_port(struct sock *sock); /* it is closed */
int is_mine(const u8 *ip);

/* unix.c */
long unix_call(long number, const long a[6]);
void show_socket(struct sockaddr *name, socklen_t *size, socklen_t room);

/* options.c */
long set_option(int descriptor, struct sock *sock, int level, int option, const void *value, socklen_t size);
long get_option(struct sock *sock, int level, int option, void *value, socklen_t *size);
extern const u8 v4_mapped[12];
int get_address(const struct sockaddr *from, socklen_t size, const struct sock *sock, struct address *to);

/* interfaces.c */
long interface_ioctl(unsigned long request, void *argument);
long open_routes(int flags);
long send_routes(int descriptor, const void *data, size_t size);

/* processes.c and signals.c */
long process_call(ucontext_t *context, long number, const long a[6]);
long signal_call(ucontext_t *context, long number, const long a[6]);
void child_gone(u32 pid);
long kill_process(long which, int signal);
void raise_signal(int signal, struct thread *directed);
int raise_with(int signal, struct thread *directed, const siginfo_t *information); /* -EAGAIN: too many are queued */
void hand_on_signals(int back);
void close_signals(int descriptor);
int deliver_signals(ucontext_t *context);
void begin_signals(void);
u64 without_own(u64 mask);
extern int gdb_waits;
#endif
