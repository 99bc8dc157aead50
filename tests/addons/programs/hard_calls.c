/* What programs do with the kernel that is easily emulated wrongly. Each line is what Linux says, too. */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <semaphore.h>
#include <setjmp.h>
#include <signal.h>
#include <spawn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/signalfd.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

static int values[9], n_values;
static void take(int signal, siginfo_t *information, void *context) {
  (void)signal, (void)context;
  values[n_values++] = information->si_value.sival_int;
}

static void signals(void) {
  struct sigaction action = {.sa_sigaction = take, .sa_flags = SA_SIGINFO};
  sigaction(SIGRTMIN, &action, 0);
  sigset_t set;
  sigemptyset(&set);
  sigaddset(&set, SIGRTMIN);
  sigprocmask(SIG_BLOCK, &set, 0);
  for (int k = 0; k < 3; k++) sigqueue(getpid(), SIGRTMIN, (union sigval){.sival_int = k + 5});
  sigprocmask(SIG_UNBLOCK, &set, 0);
  printf("queued %d: %d %d %d\n", n_values, values[0], values[1], values[2]);
  int failed = 0;
  for (int k = 0; k < 200; k++) {
    int fd = signalfd(-1, &set, 0);
    failed += fd < 0;
    close(fd);
  }
  printf("signalfd failed %d times\n", failed);
  signal(SIGPIPE, SIG_IGN);
  int ends[2];
  pipe(ends);
  close(ends[0]);
  int wrong = read(ends[1], &failed, 1);
  printf("wrong end %d, broken pipe %zd", wrong, write(ends[1], "x", 1));
  printf(" %s\n", strerror(errno));
  int status = system("kill -PIPE $$; exit 7"); /* what is ignored stays so in a child */
  printf("ignored in a child: %d\n", WEXITSTATUS(status));
}

static void *hold(void *lock) {
  pthread_mutex_lock(lock);
  return 0;
}

static void *sleep_long(void *unused) {
  sleep(100);
  return unused;
}

static void *end(void *unused) { return unused; }

static sem_t *shared;
static void *post(void *unused) {
  usleep(1000);
  sem_post(shared);
  return unused;
}

static void locks(void) {
  pthread_t thread;
  for (int inherits = 0; inherits < 2; inherits++) {
    pthread_mutex_t *lock = mmap(0, 4096, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    pthread_mutexattr_t attributes;
    pthread_mutexattr_init(&attributes);
    pthread_mutexattr_setpshared(&attributes, 1);
    if (inherits) pthread_mutexattr_setprotocol(&attributes, PTHREAD_PRIO_INHERIT);
    pthread_mutex_init(lock, &attributes);
    if (!fork()) {
      pthread_mutex_lock(lock);
      usleep(5000);
      pthread_mutex_unlock(lock);
      _exit(0);
    }
    usleep(1000);
    printf("held by a child: %s\n", strerror(pthread_mutex_lock(lock)));
    wait(0);
    pthread_mutexattr_setrobust(&attributes, PTHREAD_MUTEX_ROBUST);
    pthread_mutex_init(lock, &attributes);
    pthread_create(&thread, 0, hold, lock);
    pthread_join(thread, 0);
    printf("held by a thread that ended: %s\n", strerror(pthread_mutex_lock(lock)));
  }
  int fd = memfd_create("shared", 0);
  ftruncate(fd, 4096);
  shared = mmap(0, 4096, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
  sem_t *same = mmap(0, 4096, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
  sem_init(shared, 1, 0);
  pthread_create(&thread, 0, post, 0);
  printf("at another address: %d\n", sem_wait(same));
  pthread_join(thread, 0);
  void *result;
  pthread_create(&thread, 0, sleep_long, 0);
  usleep(1000);
  pthread_cancel(thread);
  pthread_join(thread, &result);
  printf("cancelled: %d\n", result == PTHREAD_CANCELED);
  int n = 0;
  while (n < 25000 && !pthread_create(&thread, 0, end, 0)) pthread_join(thread, 0), n++;
  printf("threads, one after the other: %d\n", n);
}

static sigjmp_buf back;
static char stack[1 << 16];
static void overflown(int signal) {
  char here;
  siglongjmp(back, 1 + (&here > stack && &here < stack + sizeof stack) + (signal != SIGSEGV));
}
static int deep(int n) {
  volatile char frame[4096] = {n};
  return deep(n + 1) + frame[0];
}

static void children(void) {
  extern char **environ;
  char *arguments[] = {"none", 0};
  pid_t child;
  printf("no such program: %s\n", strerror(posix_spawn(&child, "/bin/none", 0, 0, arguments, environ)));
  volatile int x = 1;
  if (!(child = vfork())) {
    x = 2;
    _exit(0);
  }
  waitpid(child, 0, 0);
  printf("vfork: %d\n", x);
  int status;
  if (!(child = fork())) pause();
  kill(child, SIGKILL);
  waitpid(child, &status, 0);
  printf("killed: %d\n", WIFSIGNALED(status) && WTERMSIG(status) == SIGKILL);
  stack_t other = {.ss_sp = stack, .ss_size = sizeof stack};
  sigaltstack(&other, 0);
  struct sigaction action = {.sa_handler = overflown, .sa_flags = SA_ONSTACK};
  sigaction(SIGSEGV, &action, 0);
  int how = sigsetjmp(back, 1);
  printf("stack overflow: %d\n", how ? how : deep(0));
}

static void wrong(void) {
  struct timespec t = {-1, 0};
  printf("wrong time: %d %d, clock %d\n", nanosleep(&t, 0), errno == EINVAL, clock_gettime(99, &t));
  int files = 0;
  while (open("/dev/null", O_RDONLY) >= 0) files++;
  printf("at most 1024 files: %d %s\n", files > 1000 && files < 1024, strerror(errno));
  for (int k = 3; k < 5000; k++) close(k);
  printf("the channel: %d %d %d\n", (int)write(4095, "x", 1), fcntl(4095, F_SETFD, FD_CLOEXEC), dup2(1, 4095));
  printf("untrapped: %d\n", prctl(59, 0, 0, 0, 0));
}

int main(void) {
  setvbuf(stdout, 0, _IOLBF, 0);
  signals();
  locks();
  children();
  wrong();
  return 0;
}
