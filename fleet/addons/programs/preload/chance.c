/* Chance: all random numbers come from the run's seed, the agent's number and its life. */
#include "preload.h"

static u64 state;

void seed_chance(u64 seed) { state = seed; }

u64 draw(void) { /* SplitMix64, Steele, Lea and Flood 2014 */
  u64 z = state += 0x9e3779b97f4a7c15ULL;
  z = (z ^ z >> 30) * 0xbf58476d1ce4e5b9ULL;
  z = (z ^ z >> 27) * 0x94d049bb133111ebULL;
  return z ^ z >> 31;
}

void draw_bytes(void *to, size_t size) {
  for (size_t k = 0; k < size; k += 8) {
    u64 drawn = draw();
    memcpy((u8 *)to + k, &drawn, size - k < 8 ? size - k : 8);
  }
}

long fast_getrandom(void *to, size_t size, unsigned flags, void *own, size_t own_size) {
  (void)flags, (void)own;
  if (own_size == ~0UL) return -ENOSYS; /* it asks how much memory the generator needs: it is to ask the kernel */
  draw_bytes(to, size);
  return size;
}

/* C++'s std::random_device reads the processor's generator by an instruction that nobody can trap. So these methods of
   libstdc++ stand before the library's own. */
void _ZNSt13random_device7_M_initERKNSt7__cxx1112basic_stringIcSt11char_traitsIcESaIcEEE(void *self, void *token) { (void)self, (void)token; }
void _ZNSt13random_device7_M_initERKSs(void *self, void *token) { (void)self, (void)token; }
void _ZNSt13random_device7_M_initEPKcm(void *self, const char *token, size_t size) { (void)self, (void)token, (void)size; }
void _ZNSt13random_device16_M_init_pretr1ERKNSt7__cxx1112basic_stringIcSt11char_traitsIcESaIcEEE(void *self, void *token) { (void)self, (void)token; }
void _ZNSt13random_device7_M_finiEv(void *self) { (void)self; }
unsigned _ZNSt13random_device9_M_getvalEv(void *self) { (void)self; return draw() >> 16; }
unsigned _ZNSt13random_device16_M_getval_pretr1Ev(void *self) { (void)self; return draw() >> 16; }
double _ZNKSt13random_device13_M_getentropyEv(const void *self) { (void)self; return 32; }
