/* Calls of the kernel without the C library, the processor's counter, and what is refused. */
#include <stdio.h>
#include <stdint.h>
#include <string.h>
#include <sys/syscall.h>
#include <time.h>
#include <x86intrin.h>

static long call(long n, long a, long b, long c) {
  long r;
  __asm__ volatile("syscall" : "=a"(r) : "a"(n), "D"(a), "S"(b), "d"(c) : "rcx", "r11", "memory");
  return r;
}

int main(int n, char **arguments) {
  struct timespec t, half = {0, 500000000};
  unsigned char chance[4];
  call(SYS_clock_gettime, CLOCK_REALTIME, (long)&t, 0);
  printf("%ld %ld\n", (long)t.tv_sec, (long)t.tv_nsec);
  uint64_t before = __rdtsc();
  call(SYS_nanosleep, (long)&half, 0, 0);
  printf("slept %ld ms\n", (long)((__rdtsc() - before) / 1000000));
  call(SYS_getrandom, (long)chance, 4, 0);
  printf("chance %02x%02x%02x%02x\n", chance[0], chance[1], chance[2], chance[3]);
  printf("io_uring %ld, raw socket %ld\n", call(425, 1, 0, 0), call(SYS_socket, 2, 3, 1));
  if (n > 2 && !strcmp(arguments[2], "reboot")) call(SYS_reboot, 0, 0, 0);
  return 0;
}
