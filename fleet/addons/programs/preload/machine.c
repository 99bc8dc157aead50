/* What depends on the processor (x86-64): calls of the kernel, threads, the trap, and clocks that need no kernel. */
#include "preload.h"
#include <elf.h>
#include <sys/auxv.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#ifndef PR_SET_SYSCALL_USER_DISPATCH
#define PR_SET_SYSCALL_USER_DISPATCH 59
#endif

/* The kernel does not trap calls from this section. `own_return` ends our handlers, and those of the program. */
__asm__(
    ".pushsection own_calls,\"ax\",@progbits\n"
    ".globl raw\n.hidden raw\n.type raw,@function\n"
    "raw: mov %rdi,%rax; mov %rsi,%rdi; mov %rdx,%rsi; mov %rcx,%rdx; mov %r8,%r10; mov %r9,%r8; mov 8(%rsp),%r9\n"
    "  syscall\n  ret\n"
    ".globl own_return\n.hidden own_return\n"
    "own_return: mov $15,%rax\n  syscall\n" /* these very bytes are known to who unwinds a stack, as for pthread_cancel */
    /* The child begins on its own stack in `begin_thread`. */
    ".globl raw_thread\n.hidden raw_thread\n.type raw_thread,@function\n"
    "raw_thread: push %r12; mov %r9,%r12; mov %rcx,%r10; mov $56,%eax\n"
    "  syscall\n  test %rax,%rax\n  jz 1f\n  pop %r12\n  ret\n"
    "1: xor %ebp,%ebp; mov %r12,%rdi; and $-16,%rsp; sub $256,%rsp\n  call begin_thread\n  ud2\n"
    ".globl resume\n.hidden resume\n.type resume,@function\n"
    "resume: mov 120(%rdi),%rsp; push 128(%rdi)\n"
    "  mov 0(%rdi),%r8; mov 8(%rdi),%r9; mov 16(%rdi),%r10; mov 24(%rdi),%r11; mov 32(%rdi),%r12; mov 40(%rdi),%r13\n"
    "  mov 48(%rdi),%r14; mov 56(%rdi),%r15; mov 72(%rdi),%rsi; mov 80(%rdi),%rbp; mov 88(%rdi),%rbx\n"
    "  mov 96(%rdi),%rdx; mov 104(%rdi),%rax; mov 112(%rdi),%rcx; mov 64(%rdi),%rdi\n  ret\n"
    ".popsection\n");
extern char __start_own_calls[], __stop_own_calls[];
extern void own_return(void);

void save_registers(const ucontext_t *from, long stack, long to[REGISTERS]) {
  /* The order of REG_R8 ... REG_RIP of <ucontext.h>, which `resume` knows. A new thread sees 0 as the call's result. */
  memcpy(to, from->uc_mcontext.gregs, REGISTERS * sizeof *to);
  to[REG_RAX] = 0;
  to[REG_RSP] = stack;
}

void own_handler(int signal, void (*handler)(int, siginfo_t *, void *), int flags) {
  struct { void *handler; unsigned long flags; void *restorer; u64 mask; } action = {
      (void *)handler, (unsigned long)flags | SA_SIGINFO | 0x04000000 /* SA_RESTORER */, (void *)own_return, 0};
  SYS(SYS_rt_sigaction, signal, &action, 0, 8);
}

static void trapped(int signal, siginfo_t *information, void *context_) {
  (void)signal;
  ucontext_t *context = context_;
  greg_t *g = context->uc_mcontext.gregs;
  long arguments[6] = {g[REG_RDI], g[REG_RSI], g[REG_RDX], g[REG_R10], g[REG_R8], g[REG_R9]};
  g[REG_RAX] = on_call(context, information->si_syscall, arguments);
}

void trap_calls(void) {
  own_handler(SIGSYS, trapped, SA_NODEFER);
  long start = (long)__start_own_calls;
  long error = SYS(SYS_prctl, PR_SET_SYSCALL_USER_DISPATCH, 1, start, (long)__stop_own_calls - start, 0);
  if (error) give_up("this kernel traps no system calls (error %ld): Linux 5.11 or newer is needed", -error);
  SYS(SYS_prctl, PR_SET_TSC, PR_TSC_SIGSEGV);
}

/* Overwrites the beginning of a function with a jump to one of ours. */
static void redirect(u8 *function, void *to) {
  static const u8 jump[] = {0x48, 0xb8, 0, 0, 0, 0, 0, 0, 0, 0, 0xff, 0xe0}; /* mov $to,%rax; jmp *%rax */
  memcpy(function, jump, sizeof jump);
  memcpy(function + 2, &to, sizeof to);
}

void answer_fast_clocks(void) {
  /* The C library has taken the addresses of these functions before this library was loaded, and calls them from within;
     so nothing helps but to write into them. The pages become this process's own. */
  static const struct { const char *name; void *to; } ours[] = {
      {"__vdso_clock_gettime", fast_clock_gettime}, {"__vdso_gettimeofday", fast_gettimeofday},
      {"__vdso_time", fast_time}, {"__vdso_getcpu", fast_getcpu}, {"__vdso_getrandom", fast_getrandom}};
  u8 *base = (u8 *)getauxval(AT_SYSINFO_EHDR);
  if (!base) return;
  const Elf64_Ehdr *elf = (void *)base;
  const Elf64_Phdr *segment = (void *)(base + elf->e_phoff);
  const Elf64_Dyn *dynamic = 0;
  u64 load = 0, size = 0;
  for (int k = 0; k < elf->e_phnum; k++) {
    if (segment[k].p_type == PT_LOAD) load = segment[k].p_offset - segment[k].p_vaddr, size = segment[k].p_memsz;
    if (segment[k].p_type == PT_DYNAMIC) dynamic = (void *)(base + segment[k].p_offset);
  }
  const Elf64_Sym *symbols = 0;
  const char *names = 0;
  const u32 *hash = 0;
  for (; dynamic && dynamic->d_tag; dynamic++) {
    u8 *at = base + load + dynamic->d_un.d_ptr;
    if (dynamic->d_tag == DT_SYMTAB) symbols = (void *)at;
    if (dynamic->d_tag == DT_STRTAB) names = (void *)at;
    if (dynamic->d_tag == DT_HASH) hash = (void *)at;
  }
  if (!symbols || !names) return;
  size = (size + 4095) & ~4095ULL;
  if (SYS(SYS_mprotect, base, size, PROT_READ | PROT_WRITE | PROT_EXEC)) return;
  u32 count = hash ? hash[1] : (u32)(((u8 *)names - (u8 *)symbols) / sizeof *symbols);
  for (u32 k = 0; k < count; k++)
    for (size_t j = 0; j < LENGTH(ours); j++)
      if (symbols[k].st_value && !strcmp(names + symbols[k].st_name, ours[j].name))
        redirect(base + load + symbols[k].st_value, ours[j].to);
  SYS(SYS_mprotect, base, size, PROT_READ | PROT_EXEC);
}
