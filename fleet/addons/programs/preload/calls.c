/* Each system call, and who answers it. What is not in this table ends the program with a line that names it. */
#include "preload.h"
#include <stdio.h>
#include <stdlib.h>
#include <sys/auxv.h>

extern void begin_files(void);
enum { REFUSED, KERNEL, ABSENT, FILES, DESCRIPTOR, SOCKET, CLOCK, SIGNAL, PROCESS, FUTEX, RANDOM };
#define CALL(name, who) [SYS_##name] = who
static const u8 who[] = {
    /* memory, and what a thread says about itself */
    CALL(mmap, KERNEL), CALL(munmap, KERNEL), CALL(mprotect, KERNEL), CALL(mremap, KERNEL), CALL(brk, KERNEL), CALL(madvise, KERNEL),
    CALL(msync, KERNEL), CALL(mincore, KERNEL), CALL(mlock, KERNEL), CALL(munlock, KERNEL), CALL(mlockall, KERNEL), CALL(munlockall, KERNEL),
    CALL(mlock2, KERNEL), CALL(membarrier, KERNEL), CALL(arch_prctl, KERNEL), CALL(sigaltstack, KERNEL), CALL(set_robust_list, PROCESS),
    CALL(get_robust_list, ABSENT), CALL(rseq, ABSENT), CALL(restart_syscall, KERNEL), CALL(mbind, KERNEL), CALL(get_mempolicy, KERNEL),
    CALL(set_mempolicy, KERNEL), CALL(pkey_alloc, ABSENT), CALL(pkey_free, ABSENT), CALL(pkey_mprotect, ABSENT), CALL(personality, KERNEL),
    CALL(getpriority, PROCESS), CALL(setpriority, PROCESS), CALL(sched_setparam, PROCESS), CALL(sched_getparam, PROCESS),
    CALL(sched_setscheduler, PROCESS), CALL(sched_getscheduler, PROCESS), CALL(sched_get_priority_max, KERNEL), CALL(sched_get_priority_min, KERNEL),
    CALL(sched_rr_get_interval, KERNEL), CALL(sched_setattr, ABSENT), CALL(sched_getattr, ABSENT), CALL(ioprio_get, KERNEL), CALL(ioprio_set, KERNEL),
    CALL(memfd_create, KERNEL), CALL(rt_sigreturn, KERNEL), CALL(kcmp, ABSENT),
    /* who it is */
    CALL(getuid, KERNEL), CALL(geteuid, KERNEL), CALL(getgid, KERNEL), CALL(getegid, KERNEL), CALL(getresuid, KERNEL), CALL(getresgid, KERNEL),
    CALL(getgroups, KERNEL), CALL(setuid, KERNEL), CALL(setgid, KERNEL), CALL(setreuid, KERNEL), CALL(setregid, KERNEL), CALL(setresuid, KERNEL),
    CALL(setresgid, KERNEL), CALL(setgroups, KERNEL), CALL(setfsuid, KERNEL), CALL(setfsgid, KERNEL), CALL(capget, KERNEL), CALL(capset, KERNEL),
    CALL(umask, KERNEL),
    /* open files; those that wait are below */
    CALL(lseek, KERNEL), CALL(pread64, KERNEL), CALL(pwrite64, KERNEL), CALL(preadv, KERNEL), CALL(pwritev, KERNEL), CALL(preadv2, KERNEL),
    CALL(pwritev2, KERNEL), CALL(fsync, KERNEL), CALL(fdatasync, KERNEL), CALL(sync, KERNEL), CALL(syncfs, KERNEL), CALL(sync_file_range, KERNEL),
    CALL(ftruncate, KERNEL), CALL(fallocate, KERNEL), CALL(fadvise64, KERNEL), CALL(readahead, KERNEL), CALL(fchdir, KERNEL), CALL(fchmod, FILES),
    CALL(fchown, FILES), CALL(getdents, KERNEL), CALL(getdents64, KERNEL), CALL(fstatfs, KERNEL), CALL(fgetxattr, KERNEL), CALL(fsetxattr, FILES),
    CALL(flistxattr, KERNEL), CALL(fremovexattr, FILES), CALL(copy_file_range, KERNEL), CALL(pipe, KERNEL), CALL(pipe2, KERNEL), CALL(eventfd, KERNEL),
    CALL(eventfd2, KERNEL), CALL(epoll_create, KERNEL), CALL(epoll_create1, KERNEL), CALL(inotify_init, KERNEL), CALL(inotify_init1, KERNEL),
    CALL(inotify_rm_watch, KERNEL),
    /* what a program can do without, as with an older kernel */
    CALL(io_uring_setup, ABSENT), CALL(io_uring_enter, ABSENT), CALL(io_uring_register, ABSENT), CALL(io_setup, ABSENT), CALL(userfaultfd, ABSENT),
    CALL(pidfd_open, ABSENT), CALL(pidfd_send_signal, ABSENT), CALL(pidfd_getfd, ABSENT), CALL(bpf, ABSENT),
    CALL(perf_event_open, ABSENT), CALL(splice, ABSENT), CALL(tee, ABSENT), CALL(vmsplice, ABSENT), CALL(seccomp, ABSENT), CALL(ptrace, ABSENT),
    CALL(shmget, ABSENT), CALL(shmat, ABSENT), CALL(shmdt, ABSENT), CALL(shmctl, ABSENT), CALL(semget, ABSENT), CALL(semop, ABSENT), CALL(semctl, ABSENT),
    CALL(semtimedop, ABSENT), CALL(msgget, ABSENT), CALL(msgsnd, ABSENT), CALL(msgrcv, ABSENT), CALL(msgctl, ABSENT), CALL(mq_open, ABSENT), CALL(mq_unlink, ABSENT),
    CALL(unshare, ABSENT), CALL(setns, ABSENT), CALL(mount, ABSENT), CALL(umount2, ABSENT), CALL(chroot, ABSENT), CALL(pivot_root, ABSENT),
    CALL(add_key, ABSENT), CALL(request_key, ABSENT), CALL(keyctl, ABSENT), CALL(fanotify_init, ABSENT),
    CALL(process_vm_readv, ABSENT), CALL(process_vm_writev, ABSENT), CALL(open_by_handle_at, ABSENT), CALL(migrate_pages, ABSENT), CALL(move_pages, ABSENT),
    [435 + 4 /* faccessat2 */] = FILES, [440 /* process_madvise */] = ABSENT, [442 ... 451 /* to cachestat */] = ABSENT,
    [452 ... 475 /* what is newer than this library, such as fchmodat2 */] = ABSENT,
    /* ours */
    CALL(open, FILES), CALL(creat, FILES), CALL(openat, FILES), CALL(openat2, FILES), CALL(getcwd, FILES), CALL(stat, FILES), CALL(lstat, FILES),
    CALL(fstat, FILES), CALL(newfstatat, FILES), CALL(statx, FILES), CALL(access, FILES), CALL(readlink, FILES), CALL(chdir, FILES), CALL(statfs, FILES),
    CALL(getxattr, FILES), CALL(lgetxattr, FILES), CALL(listxattr, FILES), CALL(llistxattr, FILES), CALL(faccessat, FILES), CALL(readlinkat, FILES),
    CALL(name_to_handle_at, FILES), CALL(inotify_add_watch, FILES), CALL(unlink, FILES), CALL(rmdir, FILES), CALL(mkdir, FILES), CALL(mknod, FILES),
    CALL(chmod, FILES), CALL(chown, FILES), CALL(lchown, FILES), CALL(truncate, FILES), CALL(utime, FILES), CALL(utimes, FILES), CALL(setxattr, FILES),
    CALL(lsetxattr, FILES), CALL(removexattr, FILES), CALL(lremovexattr, FILES), CALL(unlinkat, FILES), CALL(mkdirat, FILES), CALL(mknodat, FILES),
    CALL(fchmodat, FILES), CALL(fchownat, FILES), CALL(futimesat, FILES), CALL(utimensat, FILES), CALL(rename, FILES), CALL(link, FILES),
    CALL(renameat, FILES), CALL(renameat2, FILES), CALL(linkat, FILES), CALL(symlink, FILES), CALL(symlinkat, FILES),
    CALL(read, DESCRIPTOR), CALL(readv, DESCRIPTOR), CALL(write, DESCRIPTOR), CALL(writev, DESCRIPTOR), CALL(close, DESCRIPTOR), CALL(close_range, DESCRIPTOR),
    CALL(dup, DESCRIPTOR), CALL(dup2, DESCRIPTOR), CALL(dup3, DESCRIPTOR), CALL(fcntl, DESCRIPTOR), CALL(flock, DESCRIPTOR), CALL(ioctl, DESCRIPTOR),
    CALL(poll, DESCRIPTOR), CALL(ppoll, DESCRIPTOR), CALL(select, DESCRIPTOR), CALL(pselect6, DESCRIPTOR), CALL(epoll_wait, DESCRIPTOR),
    CALL(epoll_pwait, DESCRIPTOR), CALL(epoll_pwait2, DESCRIPTOR), CALL(epoll_ctl, DESCRIPTOR), CALL(sendfile, DESCRIPTOR), CALL(prlimit64, DESCRIPTOR),
    CALL(getrlimit, DESCRIPTOR), CALL(setrlimit, DESCRIPTOR),
    CALL(socket, SOCKET), CALL(socketpair, SOCKET), CALL(bind, SOCKET), CALL(connect, SOCKET), CALL(listen, SOCKET), CALL(accept, SOCKET), CALL(accept4, SOCKET),
    CALL(getsockname, SOCKET), CALL(getpeername, SOCKET), CALL(setsockopt, SOCKET), CALL(getsockopt, SOCKET), CALL(shutdown, SOCKET), CALL(sendto, SOCKET),
    CALL(sendmsg, SOCKET), CALL(sendmmsg, SOCKET), CALL(recvfrom, SOCKET), CALL(recvmsg, SOCKET), CALL(recvmmsg, SOCKET),
    CALL(clock_gettime, CLOCK), CALL(gettimeofday, CLOCK), CALL(time, CLOCK), CALL(getcpu, CLOCK), CALL(nanosleep, CLOCK), CALL(clock_nanosleep, CLOCK),
    CALL(clock_getres, KERNEL), CALL(alarm, CLOCK), CALL(setitimer, CLOCK), CALL(getitimer, CLOCK), CALL(timerfd_create, CLOCK), CALL(timerfd_settime, CLOCK),
    CALL(timerfd_gettime, CLOCK), CALL(timer_create, CLOCK), CALL(timer_settime, CLOCK), CALL(timer_gettime, CLOCK), CALL(timer_getoverrun, CLOCK),
    CALL(timer_delete, CLOCK), CALL(times, CLOCK), CALL(getrusage, CLOCK), CALL(sysinfo, CLOCK), CALL(adjtimex, CLOCK), CALL(clock_adjtime, CLOCK),
    CALL(clock_settime, CLOCK), CALL(settimeofday, CLOCK),
    CALL(rt_sigaction, SIGNAL), CALL(rt_sigprocmask, SIGNAL), CALL(rt_sigpending, SIGNAL), CALL(rt_sigtimedwait, SIGNAL), CALL(pause, SIGNAL),
    CALL(rt_sigsuspend, SIGNAL), CALL(signalfd, SIGNAL), CALL(signalfd4, SIGNAL), CALL(tkill, SIGNAL), CALL(tgkill, SIGNAL),
    CALL(rt_sigqueueinfo, SIGNAL), CALL(rt_tgsigqueueinfo, SIGNAL),
    CALL(clone, PROCESS), CALL(clone3, PROCESS), CALL(fork, PROCESS), CALL(vfork, PROCESS), CALL(execve, PROCESS), CALL(execveat, PROCESS), CALL(exit, PROCESS),
    CALL(exit_group, PROCESS), CALL(wait4, PROCESS), CALL(waitid, PROCESS), CALL(kill, PROCESS), CALL(getpid, PROCESS), CALL(getppid, PROCESS),
    CALL(gettid, PROCESS), CALL(getpgrp, PROCESS), CALL(getpgid, PROCESS), CALL(getsid, PROCESS), CALL(setpgid, PROCESS), CALL(setsid, PROCESS),
    CALL(set_tid_address, PROCESS), CALL(sched_getaffinity, PROCESS), CALL(sched_setaffinity, PROCESS), CALL(sched_yield, PROCESS), CALL(uname, PROCESS),
    CALL(prctl, PROCESS), CALL(sethostname, PROCESS), CALL(setdomainname, PROCESS), CALL(syslog, PROCESS), CALL(vhangup, PROCESS),
    CALL(acct, PROCESS),
    CALL(futex, FUTEX), CALL(getrandom, RANDOM),
};

static long answer(ucontext_t *context, long n, const long a[6]) {
  switch (n >= 0 && n < (long)LENGTH(who) ? who[n] : REFUSED) {
    case KERNEL: return raw(n, a[0], a[1], a[2], a[3], a[4], a[5]);
    case ABSENT: return -ENOSYS;
    case FILES: return file_call(n, a);
    case DESCRIPTOR: return descriptor_call(n, a);
    case SOCKET: return socket_call(n, a);
    case CLOCK: return clock_call(n, a);
    case SIGNAL: return signal_call(context, n, a);
    case PROCESS: return process_call(context, n, a);
    case FUTEX: return futex((void *)a[0], a[1], a[2], (void *)a[3], (void *)a[4], a[5]);
    case RANDOM: draw_bytes((void *)a[0], a[1]); return a[1];
    default: give_up("system call %ld is not emulated in simulated time; on the wall clock: fleet netem", n);
  }
}

long on_call(ucontext_t *context, long number, const long arguments[6]) {
  long result = answer(context, number, arguments);
  if (number != SYS_rt_sigreturn) deliver_signals(context);
  return result;
}

/* It runs before what the program's libraries do at their beginning, and before the C library knows its environment. */
__attribute__((constructor)) static void begin(int n, char **words, char **environment) {
  (void)n, (void)words;
  const char *channel = 0;
  for (char **e = environment; *e; e++)
    if (!strncmp(*e, "FLEET_PROGRAM=", 14)) channel = *e + 14;
  if (!channel || atoi(channel) != CHANNEL) return; /* the library was preloaded by somebody else */
  setvbuf(stdout, 0, _IOLBF, BUFSIZ); /* a line is to be seen when it is printed, as on a terminal */
  say_hello();
  seed_chance(config.seed);
  limit_files(0);
  begin_files();
  begin_threads();
  u8 *chance = (u8 *)getauxval(AT_RANDOM);
  if (chance) draw_bytes(chance, 16);
  begin_signals();
  answer_fast_clocks();
  trap_calls();
}
